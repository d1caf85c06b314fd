"""Meshcat's server in a thread of this process, for this machine alone, with a page of ours around its viewer.

Drawing commands come through a socket in a folder that is ours (Pinocchio's visualizer sends them), pages and the
wishes of their sliders over HTTP. Meshcat's own server listens to the whole network and as a process of its own.
"""

from __future__ import annotations

import asyncio
import json
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from meshcat.servers.zmqserver import VIEWER_ROOT, SceneTree, WebSocketHandler, ZMQWebSocketBridge
from tornado.ioloop import IOLoop
from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler

from ....errors import ConfigError
from ..serving import HOST, PORTS_TRIED

LIMITS: dict[str, Any] = {"max_body_size": 65_536, "max_header_size": 65_536, "body_timeout": 20.0}
LIMITS |= {"idle_connection_timeout": 60.0}  # [s]


class Ours(RequestHandler):
    """Answers this machine's own pages alone, and says nothing: who asks wrongly has the answer."""

    def prepare(self) -> None:
        """Refuse what a page of elsewhere asks: by another name of this machine, or from another origin.

        Raises:
            HTTPError: 403.
        """
        origin = (self.request.headers.get("Origin") or f"//{HOST}").partition("//")[2]
        for place in (self.request.host, origin):
            if place.partition(":")[0] not in (HOST, "localhost"):
                raise HTTPError(403)

    def log_exception(self, *args: object) -> None:
        """Say nothing."""


class Viewer(Ours, WebSocketHandler):
    """A browser that looks, without a line on standard error."""

    def open(self) -> None:
        """Send it the scene."""
        self.bridge.websocket_pool.add(self)
        self.bridge.send_scene(self)

    def on_message(self, message: str | bytes) -> None:
        """Meshcat's pages send nothing that is asked for here."""

    def on_close(self) -> None:
        """It left."""
        self.bridge.websocket_pool.discard(self)


class Scripts(Ours, StaticFileHandler):
    """Meshcat's own files."""


class Page(Ours):
    """Our page, and the wishes of its sliders; what they ask for is answered with how it is."""

    def initialize(self, html: str, asked: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
        """Take the page, and whom to ask."""
        self.html, self.asked = html, asked

    def prepare(self) -> None:
        """See who asks."""
        super().prepare()
        self.set_header("X-Frame-Options", "ALLOWALL")  # a notebook shows it in a frame
        self.set_header("Cache-Control", "no-store")

    def get(self) -> None:
        """The page."""
        self.write(self.html)

    async def post(self) -> None:
        """A wish, as JSON."""
        if not self.request.headers.get("Content-Type", "").endswith("json"):
            raise HTTPError(400)
        try:
            wish = json.loads(self.request.body)
            answer = await asyncio.get_running_loop().run_in_executor(None, self.asked, dict(wish))
        except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
            raise HTTPError(400) from error
        self.write(answer)


class MeshcatServer(ZMQWebSocketBridge):
    """Meshcat's server on the loopback alone.

    Args:
        folder: Of the socket for drawing commands.
        port: To listen on, or the next one that is free; 0 takes any.
        html: The page.
        asked: Answers its wishes, in a thread of its own.

    Raises:
        ConfigError: No port is free.
    """

    def __init__(self, folder: Path, port: int, html: str, asked: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
        self.websocket_pool: set[Viewer] = set()
        self.ioloop, self.tree = IOLoop.current(), SceneTree()
        app = Application(
            [
                ("/static/(.*)", Scripts, {"path": VIEWER_ROOT, "default_filename": "index.html"}),
                ("/", Viewer, {"bridge": self}),
                ("/view", Page, {"html": html, "asked": asked}),
            ],
            log_function=lambda handler: None,
        )
        for candidate in range(port, min(port + PORTS_TRIED, 65536)):
            try:
                server = app.listen(candidate, address=HOST, **LIMITS)
                break
            except OSError as error:
                why = error.strerror or str(error)
        else:
            fix = "choose another with --port"
            raise ConfigError(f"no free port in the {PORTS_TRIED} from {port}", why=why, fix=fix, key="--port")
        self.port = next(iter(server._sockets.values())).getsockname()[1]
        self.zmq_socket, self.zmq_stream, self.zmq_url = self.setup_zmq(f"ipc://{folder}/meshcat")
        self.web_url = f"http://{HOST}:{self.port}/static/"


class ServerThread:
    """The server as long as this process lives, or until it is closed.

    Args:
        port: See `MeshcatServer`.
        html: See `MeshcatServer`.
        asked: See `MeshcatServer`.

    Attributes:
        url: Of the page.
        zmq_url: Where drawing commands go.

    Raises:
        ConfigError: No port is free.
    """

    def __init__(self, port: int, html: str, asked: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="mmnn_")
        self._started, self._error = threading.Event(), None
        self._job = Path(self._folder.name), port, html, asked
        threading.Thread(target=self._run, daemon=True).start()
        self._started.wait()
        if self._error is not None:
            self._folder.cleanup()
            raise self._error
        self.url, self.zmq_url = f"http://{HOST}:{self._bridge.port}/view", self._bridge.zmq_url

    def _run(self) -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        try:
            self._bridge = MeshcatServer(*self._job)
        except ConfigError as error:
            self._error = error
            return
        finally:
            self._started.set()
        self._bridge.run()
        self._bridge.zmq_stream.close()

    def close(self) -> None:
        """End the server."""
        self._bridge.ioloop.add_callback(self._bridge.ioloop.stop)
        self._folder.cleanup()
