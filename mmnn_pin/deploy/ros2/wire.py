"""The wire of DDS: packets, their parts, lists of parameters (DDS Interoperability Wire Protocol 2.3, 8.3 and 9).

A packet has a head of 20 bytes and parts; a part has a kind, flags and a body. Numbers are in the order of bytes that a
flag says. A writer that is reliable keeps what it sent; who reads it tells what came. Functions that read raise
`struct.error` or `ValueError` where a packet is torn.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

CYCLONE = b"\x01\x10"
HEAD = b"RTPS\x02\x03\x00\x00"  # protocol 2.3, a vendor without a number
# Entities that every participant has: writers and readers of participants, of writers, of readers.
PARTICIPANT, NOBODY = bytes.fromhex("000001c1"), bytes(4)
SPDP_WRITER, SPDP_READER = bytes.fromhex("000100c2"), bytes.fromhex("000100c7")
SEDP = {bytes.fromhex("000003c2"): bytes.fromhex("000003c7"), bytes.fromhex("000004c2"): bytes.fromhex("000004c7")}
OF_WRITERS, OF_READERS = SEDP
ALL_BUILT_IN = 0x3F
ACKNACK, HEARTBEAT, GAP, INFO_SRC, INFO_DST, DATA, DATA_FRAG = 0x06, 0x07, 0x08, 0x0C, 0x0E, 0x15, 0x16
LITTLE, INLINE, WITH_DATA, FINAL = 1, 2, 4, 2
# Parameters.
LEASE, TOPIC, TYPE, VERSION, VENDOR, RELIABILITY, DURABILITY = 0x02, 0x05, 0x07, 0x15, 0x16, 0x1A, 0x1D
USER, UNICAST, DEFAULT_UNICAST, META_UNICAST, OWNER, BUILT_IN = 0x2C, 0x2F, 0x31, 0x32, 0x50, 0x58
ENDPOINT, KEY, STATUS, RELATED, RELATED_BEFORE, END = 0x5A, 0x70, 0x71, 0x83, 0x800F, 0x01
MOST_KEPT, MOST_AHEAD, MOST_HALVES = 64, 256, 4  # messages of a writer
Guid = bytes  # prefix of the participant (12) and entity (4)
Address = tuple[str, int]


@dataclass
class Sample:
    """One message of a writer of ours, for one participant or for all."""

    data: bytes
    inline: bytes = b""
    only: bytes = b""


@dataclass
class Writer:
    """A reliable writer of ours: what it sent, and to which number each reader has it."""

    entity: bytes
    kept: dict[int, Sample] = field(default_factory=dict)
    last: int = 0
    readers: dict[Guid, int] = field(default_factory=dict)
    count: int = 0

    def add(self, sample: Sample) -> int:
        """Keep a message; its number."""
        self.last += 1
        self.kept[self.last] = sample
        while len(self.kept) > MOST_KEPT:
            del self.kept[min(self.kept)]
        return self.last

    @property
    def first(self) -> int:
        """Number of the oldest message kept."""
        return min(self.kept, default=self.last + 1)


@dataclass
class Source:
    """A reliable writer of somebody else: the next number, what came before its turn, and halves."""

    next: int = 1
    ahead: dict[int, tuple[bytes, bytes]] = field(default_factory=dict)
    halves: dict[int, tuple[bytearray, set[int]]] = field(default_factory=dict)
    count: int = 0

    def join(self, number: int, order: str, body: bytes, at: int, largest: int) -> bytes | None:
        """Take parts of a message, up to a largest size; the message once it is whole."""
        first, count, size, total = struct.unpack_from(order + "IHHI", body, 20)
        if number < self.next or not (0 < total <= largest and size and first):
            return None
        if number not in self.halves and len(self.halves) >= MOST_HALVES:
            return None
        whole, parts = self.halves.setdefault(number, (bytearray(total), set()))
        for i in range(count):
            begin = (first - 1 + i) * size
            part = body[at + i * size : at + (i + 1) * size][: max(len(whole) - begin, 0)]
            if part and len(part) == min(size, len(whole) - begin):
                whole[begin : begin + len(part)] = part
                parts.add(first + i)
        return bytes(whole) if len(parts) == -(-len(whole) // size) else None

    def lacking(self, last: int) -> list[int]:
        """Numbers up to the last that have not come, as many as one packet asks for."""
        return [
            number for number in range(self.next, min(last, self.next + MOST_AHEAD - 1) + 1) if number not in self.ahead
        ]


def submessages(packet: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Kind, flags and body of the parts of a packet."""
    at = 20
    while at + 4 <= len(packet):
        kind, flags = packet[at], packet[at + 1]
        size = struct.unpack_from("<H" if flags & LITTLE else ">H", packet, at + 2)[0]
        end = at + 4 + size if size or kind in (0x01, 0x09) else len(packet)
        if end > len(packet):
            raise ValueError("a part that is longer than its packet")
        yield kind, flags, packet[at + 4 : end]
        at = end


def submessage(kind: int, flags: int, body: bytes) -> bytes:
    """A part of a packet."""
    return struct.pack("<BBH", kind, flags, len(body)) + body


def data_of(reader: bytes, writer: bytes, number: int, data: bytes, inline: bytes) -> bytes:
    """A message as a part of a packet."""
    flags = LITTLE | (INLINE if inline else 0) | (WITH_DATA if data else 0)
    head = struct.pack("<HH", 0, 16) + reader + writer + struct.pack("<iI", number >> 32, number & 0xFFFFFFFF)
    return submessage(DATA, flags, head + inline + data + bytes(-len(data) % 4))


def gap(reader: bytes, writer: bytes, first: int, last: int) -> bytes:
    """That some numbers will not come; nothing where there are none."""
    if last < first:
        return b""
    return submessage(GAP, LITTLE, reader + writer + struct.pack("<iIiII", 0, first, 0, last + 1, 0))


def number_at(order: str, body: bytes, at: int) -> int:
    """A sequence number."""
    high, low = struct.unpack_from(order + "iI", body, at)
    return int(high << 32 | low)


def numbers_at(order: str, body: bytes, at: int) -> Iterator[int]:
    """The members of a set of sequence numbers."""
    base, size = number_at(order, body, at), struct.unpack_from(order + "I", body, at + 8)[0]
    if size > 256:
        raise ValueError("a set of more than 256 numbers")
    for i in range(size):
        if struct.unpack_from(order + "I", body, at + 12 + 4 * (i // 32))[0] >> (31 - i % 32) & 1:
            yield base + i


def set_of(base: int, numbers: list[int]) -> bytes:
    """Numbers from a base on as a set."""
    size = numbers[-1] + 1 - base if numbers else 0
    words = [0] * -(-size // 32)
    for number in numbers:
        words[(number - base) // 32] |= 1 << 31 - (number - base) % 32
    return struct.pack(f"<iII{len(words)}I", base >> 32, base & 0xFFFFFFFF, size, *words)


def parameters(order: str, body: bytes, at: int) -> tuple[dict[int, bytes], int]:
    """A list of parameters, and where it ends."""
    found: dict[int, bytes] = {}
    while True:
        kind, size = struct.unpack_from(order + "HH", body, at)
        at += 4
        if kind == END:
            return found, at
        if at + size > len(body):
            raise ValueError("a parameter that is longer than its list")
        found.setdefault(kind, body[at : at + size])
        at += size


def plist(*given: tuple[int, bytes]) -> bytes:
    """Parameters as a message."""
    return b"\0\3\0\0" + b"".join(parameter(kind, value) for kind, value in given) + parameter(END, b"")


def participant(prefix: bytes, here: Address) -> bytes:
    """What a participant tells of itself."""
    return plist(
        (VERSION, HEAD[4:6] + bytes(2)),
        (VENDOR, bytes(4)),
        (OWNER, prefix + PARTICIPANT),
        (META_UNICAST, locator(here)),
        (DEFAULT_UNICAST, locator(here)),
        (LEASE, struct.pack("<iI", 20, 0)),
        (BUILT_IN, struct.pack("<I", ALL_BUILT_IN)),
        (USER, octets(b"enclave=/;")),
    )


def endpoint(prefix: bytes, here: Address, entity: bytes, topic: str, kind: str) -> bytes:
    """What a participant tells of a reliable writer or reader."""
    return plist(
        (ENDPOINT, prefix + entity),
        (OWNER, prefix + PARTICIPANT),
        (TOPIC, text(topic)),
        (TYPE, text(kind)),
        (RELIABILITY, struct.pack("<IiI", 2, 0, 1 << 28)),
        (DURABILITY, bytes(4)),
        (UNICAST, locator(here)),
    )


def parameter(kind: int, value: bytes) -> bytes:
    """A parameter."""
    value += bytes(-len(value) % 4)
    return struct.pack("<HH", kind, len(value)) + value


def order_of(data: bytes) -> str:
    """Order of the bytes of a message."""
    return "<" if data[1] & 1 else ">"


def text(value: str) -> bytes:
    """A text as CDR has it."""
    return octets(value.encode() + b"\0")


def octets(value: bytes) -> bytes:
    """Bytes with their number."""
    return struct.pack("<I", len(value)) + value


def locator(address: Address) -> bytes:
    """Where we listen."""
    return struct.pack("<iI", 1, address[1]) + bytes(12) + socket.inet_aton(address[0])


def locators(value: bytes) -> list[Address]:
    """Where somebody listens: the address of a locator, if it is one of UDP and IPv4."""
    if len(value) < 24:
        return []
    kind, port = struct.unpack_from("<iI", value)
    return [(socket.inet_ntoa(value[20:24]), port)] if kind == 1 and 0 < port < 65536 else []
