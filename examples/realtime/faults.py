"""What can go wrong with the packets of a sensor, from the middle of a run on."""

import os
import random
import signal
import struct

from link import HEADER

FAULTS = ("kill", "late", "nan", "shuffle", "short")
DELAY = 0.7  # of late packets [s]


class Fault:
    """A fault of one kind.

    Args:
        kind: One of `FAULTS`, or None.
        start: From when on [s].
    """

    def __init__(self, kind, start):
        self.kind, self.start, self.held, self.random = kind, start, [], random.Random(1)

    def packets(self, time, packet):
        """What is sent at a time [s] in place of a packet."""
        if self.kind is None or time < self.start:
            return [packet]
        return getattr(self, self.kind)(time, bytes(packet))

    def kill(self, time, packet):
        """The process dies."""
        os.kill(os.getpid(), signal.SIGKILL)

    def late(self, time, packet):
        """Every packet comes later than the supervisor waits."""
        self.held.append((time + DELAY, packet))
        due = [held for at, held in self.held if at <= time]
        self.held = self.held[len(due) :]
        return due

    def nan(self, time, packet):
        """Two packets of three hold a number that is none."""
        broken = packet[: HEADER.size] + struct.pack("<d", float("nan")) + packet[HEADER.size + 8 :]
        return [broken if self.random.random() < 2 / 3 else packet]

    def shuffle(self, time, packet):
        """Packets come four at a time, in any order."""
        self.held.append(packet)
        if len(self.held) < 4:
            return []
        due, self.held = self.held, []
        self.random.shuffle(due)
        return due

    def short(self, time, packet):
        """Every packet comes with a torn one and one that is too long."""
        return [packet[: self.random.randrange(len(packet))], packet + b"?", packet]
