"""The page: scene, viewer and controls in one HTML text that opens anywhere, also from a file, and how it is served.

The viewer is meshcat's bundle, compressed to a quarter and unpacked by the browser itself. A content security policy in
the page forbids every request. The server is a thread of this process, so nothing is left behind whatever ends it, a
kill included.
"""

from __future__ import annotations

import importlib.util
import os
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import RecordingError
from ....model.robot import Robot
from ....model.urdf.reading import parse
from ....recording.recording import Recording, recorded_robot
from ....signals import Array
from ...experiments.controllers import CONTROLLERS
from ..figure import in_the_dark, run_label, scale_rows, styles_of
from ..files import Blob, HtmlPage, compressed, fill_template, web_file
from ..serving import HOST, first_free
from .motion import ReplayTree, drawable, events_of, frames_of, packed
from .shapes import Shapes

FPS = 60.0
LARGE = 50_000_000  # bytes of a page that the user is warned of
LOOK = 0.5  # how often it is looked whether the parent lives [s]
SCRIPTS = ("unpack.js", "geometry.js", "robot.js", "stage.js", "run.js", "player.js", "main.js")


class Scene:
    """Robots and runs as the page reads them.

    Args:
        package_dirs: Folders to look for meshes in before those that the recordings know.

    Attributes:
        blob: The arrays.
        frames: Frames of all runs.
        samples: Samples of all runs.
    """

    def __init__(self, package_dirs: Sequence[str | Path] = ()) -> None:
        self.blob, self.frames, self.samples = Blob(), 0, 0
        self._shapes, self._package_dirs = Shapes(self.blob, package_dirs), tuple(package_dirs)
        self._robots: dict[str, tuple[int, ReplayTree]] = {}
        self._for_page: list[dict[str, Any]] = []
        self._runs: list[dict[str, Any]] = []

    def add(self, name: str, recording: Recording, color: str, fps: float) -> None:
        """Add a run.

        Args:
            name: For the legend.
            recording: The run.
            color: As `#RRGGBB`.
            fps: Frames per second that are kept.

        Raises:
            RecordingError: It has nothing to show, or does not hold its robot.
            InputError: Its robot cannot be built.
        """
        rows = frames_of(recording, fps)
        robot = recorded_robot(recording, self._package_dirs)
        index, tree = self._robot(robot)
        bodies = {body.joint.name: i for i, body in enumerate(tree.bodies) if body.joint}
        events = [event.for_page(bodies) for event in events_of(recording)]
        about = {"name": name, "label": run_label(name, recording), "robot": index, "events": events}
        about |= {"color": color, "dark": in_the_dark(color)}
        self._runs.append(about | packed(recording, robot, rows, self.blob))
        self.frames += len(rows)
        self.samples += len(recording)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Differences between the page and the URDF, one line each."""
        return self._shapes.warnings

    def header(self, extent: list[float], first: int = 0) -> dict[str, Any]:
        """All but the arrays, as the page reads it; `extent` as from `extent_of`, `first` the run to show alone."""
        scene = {"geometries": self._shapes.geometries, "robots": self._for_page, "runs": self._runs, "first": first}
        return scene | {"extent": extent, "warnings": list(self.warnings)}

    def stand(self, robot: Robot, position: Array) -> None:
        """Add a robot that stands at a position (nv,), and its ghost: one frame, which others replace."""
        index, _ = self._robot(robot)
        still = {name: self.blob.add(position[None], "f4") for name in ("position", "reference")}
        about = {"name": robot.name, "label": robot.name, "robot": index, "events": []}
        about |= {"color": "#000000", "dark": in_the_dark("#000000")}
        time = self.blob.add(np.zeros(1), "f4")
        self._runs.append(about | {"frames": 1, "width": position.size, "time": time} | still)
        self.frames += 1

    def _robot(self, robot: Robot) -> tuple[int, ReplayTree]:
        key = f"{robot.frame.tolist()} {robot.urdf}"
        if key not in self._robots:
            tree = ReplayTree.of(parse(robot.urdf.encode(), robot.path))
            self._robots[key] = len(self._robots), tree
            self._for_page.append(
                {
                    "name": robot.name,
                    "mobile": robot.dimensions.pose > 0,
                    "frame": [*robot.frame.tolist(), robot.base.floor],
                    "bodies": [body.for_page(robot) for body in tree.bodies],
                    "visuals": self._shapes.visuals(robot, tree),
                    "tips": tree.tips(robot),
                }
            )
        return self._robots[key]


def extent_of(recordings: Mapping[str, Recording]) -> list[float]:
    """The area of the bases and their references: least x and y, largest x and y [m]; diverged runs count little."""
    points = [np.zeros((1, 2))]
    for recording, rows in scale_rows(recordings.values()):
        for signal in {"pose", "pose_ref"} & set(recording):
            part = recording[signal][rows, :2]
            points.append(part[drawable(part)])
    every = np.vstack(points)
    return [*every.min(axis=0).tolist(), *every.max(axis=0).tolist()]


@dataclass(frozen=True, repr=False)
class ReplayPage(HtmlPage):
    """A replay, in a notebook at rest until it is played; the last warning is that of a page that is large."""

    what: str = "replay"
    height: str = "520px"
    frames: int = 0  # frames shown, of all runs
    samples: int = 0  # samples recorded, of all runs

    @contextmanager
    def served(self, port: int) -> Iterator[str]:
        """Serve the page on this machine; gives its address.

        Args:
            port: Port to listen on; when it is busy, the next one that is free. 0 takes any.

        Raises:
            ConfigError: None of the next ports is free.
        """
        server = first_free(port, self.html.encode())
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"http://{HOST}:{server.server_address[1]}/"
        finally:
            server.shutdown()
            server.server_close()
            thread.join()


def page(
    recordings: Mapping[str, Recording],
    *,
    title: str = "",
    fps: float = FPS,
    package_dirs: Sequence[str | Path] = (),
    best: str = "",
) -> ReplayPage:
    """The replay of one run, or of several in one scene.

    Args:
        recordings: The runs by the name that the legend shows.
        title: Heading of the page; by default the robots and the experiment.
        fps: Frames per second that are kept; the page interpolates between them.
        package_dirs: Folders to look for meshes in before those that the recordings know.
        best: Of many runs the one that is shown alone at first, unless one is of a controller of the user's own.

    Raises:
        RecordingError: No run, one without anything to show, or one that does not hold its robot.
        InputError: The robot of a run cannot be built.
    """
    if not recordings:
        raise RecordingError("no recording to replay")
    scene, styles = Scene(package_dirs), styles_of(recordings)
    for name, recording in recordings.items():
        scene.add(name, recording, styles[name].color, fps)
    own = [name for name, recording in recordings.items() if recording.meta.get("controller") not in CONTROLLERS]
    first = next(name for name in (*own, best, *recordings) if name in recordings)
    text = rendered(scene, title or title_of(recordings), extent_of(recordings), [*recordings].index(first))
    warnings = scene.warnings
    if len(text) > LARGE:
        fix = "show fewer runs, keep fewer frames per second (--fps), or use simpler meshes"
        warnings += (f"the page is large, {len(text) / 1e6:.0f} MB: {fix}",)
    return ReplayPage(text, warnings, frames=scene.frames, samples=scene.samples)


def live_page(robot: Robot, position: Array, package_dirs: Sequence[str | Path] = ()) -> bytes:
    """The page of a robot that stands at a position (nv,), until the server that it came from tells of others."""
    scene = Scene(package_dirs)
    scene.stand(robot, position)
    x, y = position[:2].tolist() if robot.dimensions.pose else (0.0, 0.0)
    return rendered(scene, f"{robot.name}, live", [x - 1, y - 1, x + 1, y + 1], more=("live.js",)).encode()


def rendered(scene: Scene, title: str, extent: list[float], first: int = 0, more: Sequence[str] = ()) -> str:
    """The HTML of a scene; with more scripts it may ask the server that it came from."""
    return fill_template(
        "page.html",
        __package__,
        title=title,
        scripts="\n".join(web_file(name, __package__) for name in (*more, *SCRIPTS)),
        style=web_file("page.css", __package__),
        connect="; connect-src 'self'" if more else "",
        viewer=viewer(),
        data=scene.blob.pack(scene.header(extent, first)),
    )


def title_of(recordings: Mapping[str, Recording]) -> str:
    """Experiment and robot of some runs."""
    metas = [recording.meta for recording in recordings.values()]
    what = dict.fromkeys(str(meta[key]) for key in ("experiment", "robot") for meta in metas if key in meta)
    return ", ".join(what) or "replay"


@cache
def viewer() -> str:
    """Meshcat's viewer with its licences, compressed; meshcat itself is not imported.

    Raises:
        RecordingError: Meshcat is not installed, or holds no viewer.
    """
    found = importlib.util.find_spec("meshcat")
    folder = Path(found.origin).parent / "viewer" if found and found.origin else Path()
    try:
        licences = [(folder / name).read_text("utf-8") for name in ("LICENSE", "dist/main.min.js.LICENSE.txt")]
        code = (folder / "dist/main.min.js").read_text("utf-8")
    except OSError as error:
        raise RecordingError("no viewer", why=f"meshcat's is not at {folder}", fix="pip install meshcat") from error
    return compressed(f"/*\n{licences[0]}*/\n{licences[1]}\n{code}".encode())


# -- the server --------------------------------------------------------------------------------------------------------


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
