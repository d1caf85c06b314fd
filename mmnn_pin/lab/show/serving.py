"""Pages served on this machine, to this machine alone; and a page that is told what goes on, by a process of its own.

    stepper ─▶ [memory shared by two processes] ─▶ server ─▶ server-sent events ─▶ page

A stepper must never wait for a browser. So it writes samples into shared memory, and the process that answers browsers
reads them there: neither a slow page nor Python's lock reaches the loop. This module imports next to nothing, so that
process is small. It ends when its standard input does, whatever ended the one that started it.
"""

from __future__ import annotations

import json
import math
import mmap
import os
import sys
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from ...errors import ConfigError

HOST = "127.0.0.1"
PORTS_TRIED = 50
VIEWERS = 8  # browsers that may look at once
ALIVE = 1.0  # a page that hears nothing for so long is sent a line, to see whether it is there [s]
SEQUENCE, TIME, TRIPPED, FIRST = range(4)  # what a frame begins with; then positions and what was wanted


class Server(ThreadingHTTPServer):
    """A silent server of one page.

    Attributes:
        data: The page.
        frames: What goes on; None for a page that stands still.
        rate: Frames per second that a page is sent at most [Hz].
        viewers: Browsers that look.
    """

    daemon_threads = True
    data: bytes
    frames: SharedFrames | None = None
    rate: float = 20.0
    viewers: int = 0

    def handle_error(self, request: object, client_address: object) -> None:
        """A browser that leaves in the middle of a page is no error."""


class Handler(BaseHTTPRequestHandler):
    """Answers `/` with the page, `/live` with what goes on, anything else with 404, and 403 to a page of elsewhere.

    Such a page comes by a name of its own that leads to this machine (DNS rebinding), or names its origin.
    """

    server: Server
    timeout = 20.0  # of a request that does not go on, and of a browser that takes nothing [s]

    def do_GET(self) -> None:
        """Answer."""
        path = self.path.partition("?")[0]
        asked = {self.headers.get("Host", ""), (self.headers.get("Origin") or f"//{HOST}").partition("//")[2]}
        ours = all(place.partition(":")[0] in (HOST, "localhost") for place in asked)
        if ours and path == "/live" and self.server.frames is not None:
            self.tell(self.server.frames)
            return
        data = self.server.data if ours and path == "/" else b""
        self.send_response((200 if data else 404) if ours else 403)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("X-Frame-Options", "SAMEORIGIN")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def tell(self, frames: SharedFrames) -> None:
        """Send frames until the browser leaves."""
        if self.server.viewers >= VIEWERS:
            self.send_error(503)
            return
        self.server.viewers += 1
        try:
            self.send_response(200)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            last, told = 0.0, 0.0
            while True:
                frame, now = frames.read(), time.monotonic()
                if frame[SEQUENCE] != last:
                    self.wfile.write(b"data: " + as_json(frame) + b"\n\n")
                    last, told = frame[SEQUENCE], now
                elif now - told > ALIVE:
                    self.wfile.write(b": still here\n\n")
                    told = now
                time.sleep(1 / self.server.rate)
        finally:
            self.server.viewers -= 1

    def log_message(self, format: str, *arguments: object) -> None:
        """Say nothing."""


def as_json(frame: list[float]) -> bytes:
    """A frame as the page reads it."""
    half = (len(frame) - FIRST) // 2
    told = {"time": frame[TIME], "tripped": bool(frame[TRIPPED])}
    return json.dumps(
        told | {"position": frame[FIRST : FIRST + half], "reference": frame[FIRST + half :]}, separators=(",", ":")
    ).encode()


def first_free(port: int, data: bytes) -> Server:
    """Server of a page on a port or on the next that is free.

    Raises:
        ConfigError: There is none.
    """
    for candidate in range(port, min(port + PORTS_TRIED, 65536)):
        try:
            server = Server((HOST, candidate), Handler)
            server.data = data
            return server
        except OSError as error:
            why = error.strerror or str(error)
    fix = "choose another with --port, or write the page with --html"
    raise ConfigError(f"no free port in the {PORTS_TRIED} from {port}", why=why, fix=fix, key="--port")


class SharedFrames:
    """The last frame, in memory that two processes share: one writes, the other reads; nobody waits.

    Its first number is odd while it is written, so a reader knows a frame that is half old.

    Args:
        file: Descriptor of the memory.
        numbers: Of a frame.
    """

    def __init__(self, file: int, numbers: int) -> None:
        self.memory = mmap.mmap(file, 8 * numbers)
        self.numbers = memoryview(self.memory).cast("d")

    def read(self) -> list[float]:
        """The last whole frame; without one, numbers of 0."""
        while True:
            before = self.numbers[SEQUENCE]
            frame = self.numbers.tolist()
            if before == self.numbers[SEQUENCE] and math.fmod(before, 2) == 0:
                return [value if math.isfinite(value) else 0.0 for value in frame]
            time.sleep(0)


def new_memory(numbers: int) -> int:
    """Descriptor of new memory for a frame, without a name where the system has such."""
    if hasattr(os, "memfd_create"):
        file = os.memfd_create("mmnn_live")
    else:
        import tempfile

        file = os.dup(tempfile.TemporaryFile().fileno())  # noqa: SIM115 (the descriptor stays)
    os.ftruncate(file, 8 * numbers)
    return file


def child() -> None:
    """Serve the page on standard input until that ends; its first line is a job, the answer is the port."""
    source = sys.stdin.buffer
    job: dict[str, Any] = json.loads(source.readline())
    server = first_free(job["port"], source.read(job["bytes"]))
    server.frames, server.rate = SharedFrames(job["file"], job["numbers"]), job["rate"]
    print(server.server_address[1], flush=True)
    import threading

    threading.Thread(target=server.serve_forever, daemon=True).start()
    source.read()
    os._exit(0)
