"""What can go wrong with the packets of a sensor, from the middle of a run on."""

import os
import random
import signal
import struct

from link import HEADER

FAULTS = ("kill", "late", "nan", "shuffle", "short")
DELAY = 0.7  # of late packets [s]


class Faults:
    """Some faults, one after the other.

    Args:
        kinds: Of `FAULTS`.
        start: From when on [s].
    """

    def __init__(self, kinds, start):
        self.kinds, self.start, self.random = kinds, start, random.Random(1)
        self.delayed, self.gathered = [], []

    def packets(self, time, packet):
        """What is sent at a time [s] in place of a packet."""
        packets = [bytes(packet)]
        for kind in self.kinds if time >= self.start else ():
            packets = [out for one in packets for out in getattr(self, kind)(time, one)]
        return packets

    def kill(self, time, packet):
        """The process dies."""
        os.kill(os.getpid(), signal.SIGKILL)

    def late(self, time, packet):
        """Every packet comes later than the supervisor waits."""
        self.delayed.append((time + DELAY, packet))
        due = [held for at, held in self.delayed if at <= time]
        self.delayed = self.delayed[len(due) :]
        return due

    def nan(self, time, packet):
        """Two packets of three hold a number that is none."""
        broken = packet[: HEADER.size] + struct.pack("<d", float("nan")) + packet[HEADER.size + 8 :]
        return [broken if self.random.random() < 2 / 3 else packet]

    def shuffle(self, time, packet):
        """Packets come four at a time, in any order."""
        self.gathered.append(packet)
        if len(self.gathered) < 4:
            return []
        due, self.gathered = self.gathered, []
        self.random.shuffle(due)
        return due

    def short(self, time, packet):
        """Every packet comes with a torn one and one that is too long."""
        return [packet[: self.random.randrange(len(packet))], packet + b"?", packet]
