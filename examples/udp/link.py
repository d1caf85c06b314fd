"""Numbered packets of float64 over UDP between the two processes; what is old or malformed is dropped and counted.

A packet is a magic word, its kind, its number, when it was sent (CLOCK_MONOTONIC, ns: one machine, or synchronised
clocks) and its values, little endian.
"""

import os
import socket
import struct
import time
from contextlib import suppress

import numpy as np

from mmnn_pin.errors import ConfigError

HEADER = struct.Struct("<4sIQq")
MAGIC = b"mmnn"
HELLO, COMMAND, MEASUREMENT, BYE = range(4)
MOST = 1000  # packets read at a time: a flood does not hang the loop


class Channel:
    """One end of the link.

    Args:
        sends, receives: How many values a packet has, in each direction.
        port: Port to bind, 0 for any free one.
        peer: Address of the other end; None for the first one that sends a packet of the right size.
    """

    def __init__(self, sends, receives, port=0, peer=None):
        if not 0 <= port <= 65535:
            raise ConfigError(f"port {port}", fix="use one from 1024 to 65535, or 0 for any free one", key="--port")
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self.socket.bind(("127.0.0.1", port))
        except OSError as error:
            self.socket.close()
            fix = "choose another one with --port, 0 for any free one"
            raise ConfigError(f"cannot use port {port}", why=os.strerror(error.errno), fix=fix, key="--port") from error
        self.port, self.peer = self.socket.getsockname()[1], peer
        self.socket.setblocking(False)
        self.outgoing, self.incoming = bytearray(HEADER.size + 8 * sends), bytearray(HEADER.size + 8 * receives + 1)
        self.to_send = np.frombuffer(self.outgoing, "<f8", offset=HEADER.size)
        self.arrived = np.frombuffer(self.incoming, "<f8", receives, HEADER.size)
        self.values = np.zeros(receives)  # of the newest packet
        self.sent = self.newest = self.received = self.out_of_order = self.malformed = 0
        self.stamp = 0  # when the newest was sent [ns]

    def pack(self, kind, values=()):
        """The next packet, with the time."""
        self.sent += 1
        HEADER.pack_into(self.outgoing, 0, MAGIC, kind, self.sent, time.monotonic_ns())
        self.to_send[:] = values if len(values) else 0.0
        return self.outgoing

    def send(self, kind, values=()):
        """Send a packet; where nobody listens it is lost, as on any wire."""
        self.put(self.pack(kind, values))

    def put(self, packet):
        """Send bytes as they are."""
        if self.peer is not None:
            with suppress(OSError):  # a full buffer, a network that is down
                self.socket.sendto(packet, self.peer)

    def receive(self):
        """Kind of the newest packet that came since the last call, its values in `values`; None without one."""
        found = None
        for _ in range(MOST):
            try:
                size, sender = self.socket.recvfrom_into(self.incoming)
            except OSError:  # nothing more
                break
            if self.peer is not None and sender != self.peer:
                continue
            magic, kind, number, stamp = HEADER.unpack_from(self.incoming)
            if size != len(self.incoming) - 1 or magic != MAGIC:
                self.malformed += 1
            elif number <= self.newest:
                self.out_of_order += 1
            else:
                self.peer = sender
                self.newest, self.stamp, found = number, stamp, kind
                self.received += 1
                self.values[:] = self.arrived
        return found
