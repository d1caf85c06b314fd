"""Services by RTPS: a client as rmw_cyclonedds makes it, torn and foreign packets, halves, repeated messages."""

import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="pip install 'mmnn_pin[ros2]'")

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import int64, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic as DdsTopic

from mmnn_pin.deploy.ros2.link import Link, quality
from mmnn_pin.deploy.ros2.services import Services
from mmnn_pin.deploy.ros2.settings import Network, Topic
from mmnn_pin.deploy.ros2.wire import Source, data_of, numbers_at, parameters, set_of, submessages

DOMAINS = iter((101, 102))
NAMES = "std_srvs::srv::dds_::SetBool_Request_", "std_srvs::srv::dds_::SetBool_Response_"


@dataclass
class Ask(IdlStruct, typename=NAMES[0]):
    """A request of rmw_cyclonedds: whose it is and its number, then the message."""

    guid: uint64
    number: int64
    data: bool


@dataclass
class Answer(IdlStruct, typename=NAMES[1]):
    guid: uint64
    number: int64
    success: bool
    message: str


@pytest.fixture
def services() -> Iterator[Services]:
    made = Services(Network(domain=next(DOMAINS), participants=4), ["127.0.0.1"], [("/switch", *NAMES)])
    yield made
    made.close()


def test_a_client_of_cyclone_is_answered_in_order(services: Services) -> None:
    link = Link(services.network)
    reliable = quality(Topic("/switch", "reliable", 50))
    ask = DataWriter(link.participant, DdsTopic(link.participant, "rq/switchRequest", Ask), reliable)
    hear = DataReader(link.participant, DdsTopic(link.participant, "rr/switchReply", Answer), reliable)
    deadline = time.monotonic() + 20.0
    while not (ask.get_matched_subscriptions() and hear.get_matched_publications()):
        assert time.monotonic() < deadline, "they did not find each other"
        time.sleep(0.02)
    for number in range(20):
        ask.write(Ask(77, number, bool(number % 2)))
    heard, asked = [], []
    while len(heard) < 20 and time.monotonic() < deadline:
        for caller, data in services.take():
            asked.append(data[4])
            text = f"{len(asked) - 1}\0".encode()
            services.reply(caller, data[:4] + b"\1\0\0\0" + struct.pack("<I", len(text)) + text)
        heard += [(one.guid, one.number, one.success, one.message) for one in hear.take(20) if hasattr(one, "message")]
        time.sleep(0.005)
    link.close()
    assert asked == [0, 1] * 10 and heard == [(77, i, True, str(i)) for i in range(20)]


def test_torn_and_foreign_packets_are_counted_and_do_nothing(services: Services) -> None:
    rng, here = np.random.default_rng(3), ("127.0.0.1", 4000)
    services.receive(b"RTPS" + bytes(40), ("10.0.0.9", 4000), 0.0)
    assert services.foreign == 1 and not services.peers
    head = b"RTPS\2\3\1\x0f" + bytes(range(12))
    whole = head + data_of(b"\0\0\x10\4", b"\0\0\x11\3", 1, b"\0\1\0\0" + bytes(30), b"")
    for _ in range(3000):
        packet = bytearray(whole if rng.integers(2) else head + rng.bytes(int(rng.integers(0, 120))))
        for at in rng.integers(20, max(len(packet), 21), 4):
            if at < len(packet):
                packet[at] = rng.integers(256)
        services.receive(bytes(packet[: int(rng.integers(0, len(packet) + 1))]), here, 0.0)
    assert services.malformed > 100 and not services.peers and not services.take()
    assert len(services.sources) == 0 and services.thread.is_alive()


def test_halves_make_a_whole_in_any_order_and_large_ones_are_refused() -> None:
    rng, source = np.random.default_rng(5), Source()
    message = rng.bytes(10_000)

    def part(first: int, size: int = 1000, total: int = len(message)) -> bytes:
        return bytes(20) + struct.pack("<IHHI", first, 1, size, total) + message[(first - 1) * size : first * size]

    for first in rng.permutation(10)[:9] + 1:
        source.join(1, "<", part(int(first)), 32, 20_000)
    missing = next(i for i in range(1, 11) if i not in source.halves[1][1])
    assert source.join(1, "<", part(missing), 32, 20_000) == message
    assert source.join(2, "<", part(1, total=30_000), 32, 20_000) is None and 2 not in source.halves
    for number in range(2, 20):
        source.join(number, "<", part(1), 32, 20_000)
    assert len(source.halves) <= 4


def test_sets_and_lists_are_read_as_they_are_written() -> None:
    rng = np.random.default_rng(6)
    for _ in range(50):
        base = int(rng.integers(1, 2**40))
        numbers = sorted({base + int(i) for i in rng.integers(0, 256, 9)})
        assert list(numbers_at("<", set_of(base, numbers), 0)) == numbers
    with pytest.raises(ValueError, match="longer than its list"):
        parameters("<", struct.pack("<HH", 5, 40) + bytes(8), 0)
    with pytest.raises(ValueError, match="longer than its packet"):
        list(submessages(bytes(20) + struct.pack("<BBH", 0x15, 1, 400) + bytes(8)))
