"""Services of ROS 2, answered by RTPS itself: DDS's interface in Python cannot say to which request a reply belongs.

A participant of its own with a reader for requests and a writer for replies per service, in the plain protocol (DDS
Interoperability Wire Protocol 2.3): participants find each other (SPDP), tell their endpoints (SEDP), and reliable
writers repeat what was lost. Fast DDS and Connext tell the request of a reply in its inline QoS, as DDS-RPC does;
rmw_cyclonedds puts 16 bytes before both messages. What a client speaks is seen by the vendor of its packets.

Packets of addresses that are no peers are dropped, and so are torn ones; all that is remembered is bounded.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import threading
import time as clock
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from .settings import Network
from .wire import (
    ACKNACK,
    CYCLONE,
    DATA,
    DATA_FRAG,
    DEFAULT_UNICAST,
    END,
    ENDPOINT,
    FINAL,
    GAP,
    HEAD,
    HEARTBEAT,
    INFO_DST,
    INFO_SRC,
    INLINE,
    KEY,
    LITTLE,
    META_UNICAST,
    MOST_AHEAD,
    MOST_KEPT,
    NOBODY,
    OF_READERS,
    OF_WRITERS,
    PARTICIPANT,
    RELATED,
    RELATED_BEFORE,
    SEDP,
    SPDP_WRITER,
    STATUS,
    TOPIC,
    Address,
    Guid,
    Sample,
    Source,
    Writer,
    data_of,
    endpoint,
    gap,
    locators,
    number_at,
    numbers_at,
    order_of,
    parameter,
    parameters,
    participant,
    set_of,
    submessage,
    submessages,
)

MOST_PEERS, MOST_WAITING = 64, 32
ANNOUNCE, REPEAT, FORGET = 1.0, 0.1, 30.0  # [s]


class Caller(NamedTuple):
    """Who asked: which service, the identity of the request, how its packets look."""

    service: int
    writer: Guid
    number: int
    vendor: bytes
    header: bytes


class Request(NamedTuple):
    """A request: the message in CDR with its head of 4 bytes."""

    caller: Caller
    data: bytes


@dataclass
class Peer:
    """Another participant: where it listens, and when it was heard last."""

    meta: list[Address]
    default: list[Address]
    heard: float


class Services:
    """Answers requests on some services, in a thread of its own.

    Args:
        network: Where it speaks.
        addresses: Of the peers.
        services: Name, type of the request and type of the reply of each, as they are in DDS.

    Attributes:
        foreign: Packets dropped because their address is no peer's.
        malformed: Packets dropped because they were torn.
    """

    def __init__(self, network: Network, addresses: Iterable[str], services: Iterable[tuple[str, str, str]]) -> None:
        self.network, self.addresses, self.services = network, list(addresses), list(services)
        self.prefix = b"\0\0" + os.urandom(10)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        here = "127.0.0.1" if self.addresses == ["127.0.0.1"] else address_towards(self.addresses)
        self.socket.bind((here, 0))
        self.socket.setblocking(False)
        self.here: Address = self.socket.getsockname()
        self.foreign = self.malformed = 0
        self.peers: dict[bytes, Peer] = {}
        self.writers = {entity: Writer(entity) for entity in SEDP}
        self.sources: dict[Guid, tuple[int, Source]] = {}  # of requests by service, of endpoints by -1
        self.requests: deque[Request] = deque(maxlen=MOST_WAITING)
        self.replies: deque[tuple[Caller, bytes]] = deque(maxlen=MOST_WAITING)
        for i, (name, request, reply) in enumerate(self.services):
            self.writers[replier(i)] = Writer(replier(i))
            told = (requester(i), f"rq{name}Request", request), (replier(i), f"rr{name}Reply", reply)
            self.writers[OF_READERS].add(Sample(endpoint(self.prefix, self.here, *told[0])))
            self.writers[OF_WRITERS].add(Sample(endpoint(self.prefix, self.here, *told[1])))
        self.wake, self.woken = socket.socketpair()
        self.open = True
        self.thread = threading.Thread(target=self._run, name="services", daemon=True)
        self.thread.start()

    def take(self) -> list[Request]:
        """The requests that came."""
        found = []
        while self.requests:
            found.append(self.requests.popleft())
        return found

    def reply(self, caller: Caller, data: bytes) -> None:
        """Answer a request with a message in CDR."""
        self.replies.append((caller, data))
        self.wake.send(b"r")

    def close(self) -> None:
        """Say good-bye and end."""
        self.open = False
        self.wake.send(b"e")
        self.thread.join(1.0)
        for one in (self.socket, self.wake, self.woken):
            one.close()

    # -- the thread ----------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        announced = repeated = 0.0
        while self.open:
            ready, _, _ = select.select([self.socket, self.woken], [], [], REPEAT)
            now = clock.monotonic()
            if self.woken in ready:
                self.woken.recv(64)
            while self.replies:
                self._send_reply(*self.replies.popleft())
            if self.socket in ready:
                for _ in range(100):  # a flood does not keep it from its other duties
                    try:
                        packet, sender = self.socket.recvfrom(65536)
                    except OSError:
                        break
                    self.receive(packet, sender, now)
            if now - announced > ANNOUNCE:
                announced = now
                self._announce()
                for prefix in [prefix for prefix, peer in self.peers.items() if now - peer.heard > FORGET]:
                    self._forget(prefix)
            if now - repeated > REPEAT:
                repeated = now
                for writer in self.writers.values():
                    for reader in [one for one, has in writer.readers.items() if has < writer.last]:
                        self._to(reader[:12], self._heartbeat(writer, reader[12:]), writer.entity in SEDP)
        self._announce(gone=True)

    def _announce(self, gone: bool = False) -> None:
        """Tell the peers that we are there, at the ports at which participants are found."""
        data = b"" if gone else participant(self.prefix, self.here)
        status = parameter(STATUS, b"\0\0\0\3") if gone else b""
        key = parameter(KEY, self.prefix + PARTICIPANT) + status + parameter(END, b"")
        packet = HEAD + self.prefix + data_of(NOBODY, SPDP_WRITER, 1, data, key if gone else b"")
        first = 7410 + 250 * self.network.domain
        for address in self.addresses:
            for i in range(self.network.participants):
                self._put(packet, (address, first + 2 * i))

    def receive(self, packet: bytes, sender: Address, now: float) -> None:
        """Read one packet; one that is torn is dropped from where it is torn."""
        if sender[0] not in self.addresses:
            self.foreign += 1
            return
        if packet[:4] != b"RTPS" or len(packet) < 20 or packet[8:20] == self.prefix:
            self.malformed += packet[:4] != b"RTPS" or len(packet) < 20
            return
        vendor, prefix, ours = packet[6:8], packet[8:20], True
        try:
            for kind, flags, body in submessages(packet):
                if kind == INFO_DST:
                    ours = body[:12] in (self.prefix, bytes(12))
                elif kind == INFO_SRC:
                    vendor, prefix = body[6:8], body[8:20]
                elif ours:
                    self._submessage(kind, flags, body, prefix, vendor, now)
        except (struct.error, IndexError, ValueError, UnicodeDecodeError):
            self.malformed += 1

    def _submessage(self, kind: int, flags: int, body: bytes, prefix: bytes, vendor: bytes, now: float) -> None:
        order = "<" if flags & LITTLE else ">"
        if kind in (DATA, DATA_FRAG):
            _, to_inline = struct.unpack_from(order + "HH", body)
            writer, number = prefix + body[8:12], number_at(order, body, 12)
            self._expect(writer, body[4:8])
            at = 4 + to_inline
            inline, at = parameters(order, body, at) if flags & INLINE else ({}, at)
            if kind == DATA:
                self._came(writer, number, body[at:], inline, vendor, now)
            elif (known := self.sources.get(writer)) is not None:
                whole = known[1].join(number, order, body, at, self.network.largest)
                if whole is not None:
                    self._came(writer, number, whole, inline, vendor, now)
        elif kind == HEARTBEAT:
            first, last = number_at(order, body, 8), number_at(order, body, 16)
            self._expect(prefix + body[4:8], body[:4])
            if (known := self.sources.get(prefix + body[4:8])) is not None:
                known[1].next = max(known[1].next, first)
                self._deliver(prefix + body[4:8], vendor)
                self._acknowledge(prefix + body[4:8], last, bool(flags & FINAL))
        elif kind == GAP and (known := self.sources.get(prefix + body[4:8])) is not None:
            start, numbers = number_at(order, body, 8), list(numbers_at(order, body, 16))
            base = number_at(order, body, 16)
            for number in [*range(start, min(base, start + MOST_AHEAD)), *numbers]:
                known[1].ahead.setdefault(number, (b"", vendor))
            if start <= known[1].next < base:
                known[1].next = base
            self._deliver(prefix + body[4:8], vendor)
        elif kind == ACKNACK and (mine := self.writers.get(body[4:8])) is not None:
            self._asked(mine, prefix + body[0:4], number_at(order, body, 8), list(numbers_at(order, body, 8)))

    # -- what comes ----------------------------------------------------------------------------------------------------

    def _expect(self, writer: Guid, reader: bytes) -> None:
        """A writer that speaks to our reader of requests before it was announced is known by that."""
        service = reader[2] - 0x10
        known = writer in self.sources or writer[:12] not in self.peers or len(self.sources) >= 4 * MOST_PEERS
        if not known and 0 <= service < len(self.services) and reader == requester(service):
            self.sources[writer] = service, Source()

    def _came(
        self, writer: Guid, number: int, data: bytes, inline: dict[int, bytes], vendor: bytes, now: float
    ) -> None:
        """A message of another participant."""
        if writer[12:] == SPDP_WRITER:
            if inline.get(STATUS, b"\0")[-1] & 3:
                self._forget(writer[:12])
            elif data:
                self._meet(writer[:12], parameters(order_of(data), data, 4)[0], now)
            return
        if (known := self.sources.get(writer)) is None:
            return
        source = known[1]
        if number >= source.next and len(source.ahead) < MOST_AHEAD:
            gone = writer[12:] in SEDP and inline.get(STATUS, b"\0")[-1] & 3
            source.ahead[number] = (inline.get(KEY, b"")[:16], b"gone") if gone else (data, vendor)
            self._deliver(writer, vendor)

    def _deliver(self, writer: Guid, vendor: bytes) -> None:
        """Hand on what is next in line."""
        service, source = self.sources[writer]
        while source.next in source.ahead:
            data, kind = source.ahead.pop(source.next)
            number, source.next = source.next, source.next + 1
            if writer[12:] in SEDP and data:
                self._match(writer, data, kind == b"gone")
            elif service >= 0 and len(data) >= 4:
                header, body = (data[4:20], data[:4] + data[20:]) if kind == CYCLONE else (b"", data)
                self.requests.append(Request(Caller(service, writer, number, kind, header), body))
        for table in (source.ahead, source.halves):
            for number in [number for number in table if number < source.next]:
                del table[number]

    def _meet(self, prefix: bytes, told: dict[int, bytes], now: float) -> None:
        """A participant is there: exchange endpoints."""
        known = self.peers.get(prefix)
        if known is not None:
            known.heard = now
            return
        meta, default = (locators(told.get(kind, b"")) for kind in (META_UNICAST, DEFAULT_UNICAST))
        if not meta or len(self.peers) >= MOST_PEERS:
            return
        self.peers[prefix] = Peer(meta, default or meta, now)
        us = data_of(NOBODY, SPDP_WRITER, 1, participant(self.prefix, self.here), b"")
        self._put(HEAD + self.prefix + us, meta[0])
        for writer, reader in SEDP.items():
            self.sources[prefix + writer] = -1, Source()
            self.writers[writer].readers[prefix + reader] = 0
            self._to(prefix, self._all(self.writers[writer], reader, prefix), True)

    def _match(self, writer: Guid, data: bytes, gone: bool) -> None:
        """An endpoint of another participant is there, or gone."""
        told = {} if gone else parameters(order_of(data), data, 4)[0]
        guid = data[:16] if gone else told.get(ENDPOINT, b"")[:16]
        if gone:
            self.sources.pop(guid, None)
            for mine in self.writers.values():
                mine.readers.pop(guid, None)
            return
        topic = told.get(TOPIC, b"\0" * 4)[4:].rstrip(b"\0").decode()
        for i, (name, _, _) in enumerate(self.services):
            if writer[12:] == OF_WRITERS and topic == f"rq{name}Request" and len(self.sources) < 4 * MOST_PEERS:
                self.sources.setdefault(guid, (i, Source()))
                self._acknowledge(guid, 0, False)  # some writers wait for it
            elif writer[12:] == OF_READERS and topic == f"rr{name}Reply" and len(self.writers[replier(i)].readers) < 64:
                mine = self.writers[replier(i)]
                if guid not in mine.readers:
                    theirs = [number for number, sample in mine.kept.items() if sample.only == guid[:12]]
                    mine.readers[guid] = before = min(theirs, default=mine.last + 1) - 1  # it may be late for a reply
                    self._to(guid[:12], gap(guid[12:], mine.entity, 1, before) + self._heartbeat(mine, guid[12:]))

    def _forget(self, prefix: bytes) -> None:
        """A participant is gone."""
        self.peers.pop(prefix, None)
        self.sources = {guid: one for guid, one in self.sources.items() if guid[:12] != prefix}
        for writer in self.writers.values():
            writer.readers = {guid: has for guid, has in writer.readers.items() if guid[:12] != prefix}

    # -- what is sent --------------------------------------------------------------------------------------------------

    def _send_reply(self, caller: Caller, data: bytes) -> None:
        identity = caller.writer + struct.pack("<iI", caller.number >> 32, caller.number & 0xFFFFFFFF)
        inline = b"" if caller.header else parameter(RELATED, identity) + parameter(RELATED_BEFORE, identity)
        writer = self.writers[replier(caller.service)]
        whole = data[:4] + caller.header + data[4:]
        number = writer.add(Sample(whole, inline + parameter(END, b"") if inline else b"", caller.writer[:12]))
        for reader in writer.readers:
            self._to(
                reader[:12], self._one(writer, reader[12:], reader[:12], number) + self._heartbeat(writer, reader[12:])
            )

    def _asked(self, writer: Writer, reader: Guid, base: int, missing: list[int]) -> None:
        """A reader of ours tells what it has, and what it lacks."""
        if reader not in writer.readers:
            return
        writer.readers[reader] = max(writer.readers[reader], base - 1)
        for number in missing[:MOST_KEPT]:
            if number <= writer.last:
                self._to(reader[:12], self._one(writer, reader[12:], reader[:12], number), writer.entity in SEDP)

    def _one(self, writer: Writer, reader: bytes, prefix: bytes, number: int) -> bytes:
        """A message again, or that it is none of theirs."""
        sample = writer.kept.get(number)
        if sample is None or sample.only not in (b"", prefix):
            return gap(reader, writer.entity, number, number)
        return data_of(reader, writer.entity, number, sample.data, sample.inline)

    def _all(self, writer: Writer, reader: bytes, prefix: bytes) -> bytes:
        parts = [self._one(writer, reader, prefix, number) for number in writer.kept]
        return b"".join(parts) + self._heartbeat(writer, reader)

    def _heartbeat(self, writer: Writer, reader: bytes) -> bytes:
        writer.count += 1
        numbers = (0, writer.first, 0, writer.last, writer.count)
        return submessage(HEARTBEAT, LITTLE, reader + writer.entity + struct.pack("<iIiIi", *numbers))

    def _acknowledge(self, writer: Guid, last: int, final: bool) -> None:
        """Tell a writer what we have and what we lack."""
        service, source = self.sources[writer]
        lacking = source.lacking(last)
        if final and not lacking:
            return
        source.count += 1
        reader = SEDP[writer[12:]] if service < 0 else requester(service)
        body = reader + writer[12:] + set_of(source.next, lacking) + struct.pack("<i", source.count)
        self._to(writer[:12], submessage(ACKNACK, LITTLE | (0 if lacking else FINAL), body), service < 0)

    def _to(self, prefix: bytes, submessages: bytes, meta: bool = False) -> None:
        """Send to a participant."""
        if (peer := self.peers.get(prefix)) is not None:
            packet = HEAD + self.prefix + submessage(INFO_DST, LITTLE, prefix) + submessages
            self._put(packet, (peer.meta if meta else peer.default)[0])

    def _put(self, packet: bytes, address: Address) -> None:
        try:
            self.socket.sendto(packet, address)
        except OSError:  # nobody is there, or the buffer is full: what matters is repeated
            return


def requester(service: int) -> bytes:
    """Our reader of a service's requests."""
    return bytes((0, 0, 0x10 + service, 0x04))


def replier(service: int) -> bytes:
    """Our writer of a service's replies."""
    return bytes((0, 0, 0x20 + service, 0x03))


def address_towards(addresses: list[str]) -> str:
    """Our address on the way to the first peer that is not this machine."""
    others = [address for address in addresses if not address.startswith("127.")]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((others[0] if others else addresses[0], 7400))  # sends nothing
        return str(probe.getsockname()[0]) if others else "127.0.0.1"
