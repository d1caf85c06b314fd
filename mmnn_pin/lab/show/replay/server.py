"""Show a page at a local address for as long as this process, and the one that started it, live.

The server is a thread of this process, so nothing is left behind whatever ends it, a kill included.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from ....errors import ConfigError

HOST = "127.0.0.1"
PORT = 7007
PORTS_TRIED = 50
LOOK = 0.5  # how often it is looked whether the parent lives [s]


@contextmanager
def served(html: str, port: int = PORT) -> Iterator[str]:
    """Serve a page; gives its address.

    Args:
        html: The page.
        port: Port to listen on; when it is busy, the next one that is free. 0 takes any.

    Raises:
        ConfigError: None of the next ports is free.
    """
    server = first_free(port, handler_of(html.encode()))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://{HOST}:{server.server_address[1]}/"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def wait_until_left(parent: int) -> None:
    """Return on Ctrl-C, and when the process that started this one is gone.

    Args:
        parent: What `os.getppid()` gave when this process started.
    """
    try:
        while os.getppid() == parent:
            time.sleep(LOOK)
    except KeyboardInterrupt:
        return


def handler_of(data: bytes) -> type[BaseHTTPRequestHandler]:
    """A handler that knows one page."""

    class Handler(BaseHTTPRequestHandler):
        """Answers `/` with the page, anything else with 404."""

        def do_GET(self) -> None:
            """Answer."""
            found = self.path.partition("?")[0] == "/"
            self.send_response(200 if found else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(data) if found else 0))
            self.end_headers()
            if found:
                self.wfile.write(data)

        def log_message(self, format: str, *arguments: object) -> None:
            """Say nothing."""

    return Handler


class Server(ThreadingHTTPServer):
    """A server that is silent."""

    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """A browser that leaves in the middle of a page is no error."""


def first_free(port: int, handler: type[BaseHTTPRequestHandler]) -> Server:
    """Server on a port or on the next that is free.

    Raises:
        ConfigError: There is none.
    """
    for candidate in range(port, min(port + PORTS_TRIED, 65536)):
        try:
            return Server((HOST, candidate), handler)
        except OSError as error:
            why = error.strerror or str(error)
    fix = "choose another with --port, or write the page with --html"
    raise ConfigError(f"no free port in the {PORTS_TRIED} from {port}", why=why, fix=fix, key="--port")
