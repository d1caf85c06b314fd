"""A robot in Pinocchio's MeshcatVisualizer: its joints by sliders, its parts in colours of what was understood of them.

with robot.view() as shown:      # a notebook shows it as it stands; in a script open shown.url
    shown.display(q)
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pinocchio.visualize import MeshcatVisualizer

from ....model.inspection import inspection_of
from ....model.robot import Robot
from ....recording.recording import Recording, recorded_position, recorded_robot
from ....signals import Array
from ..files import fill_template, web_file
from ..replay.motion import frames_of
from ..robots import summary
from ..solids import BODY, Solid, legend, placements, roles_of, solids_of
from .server import ServerThread

PORT = 7007
FPS = 30.0
PAUSE = 1.0  # at the end of a run, before it begins again [s]
FRAME_AXES = 0.1  # length of the axes of links' frames [m]
ARROW = 0xD00000
CELLS, CELL = 10, 0.5  # of the floor, to every side, and their width [m]
FROM = np.array([1.0, 0.6, 0.5])  # of the eye, for a robot of size 1


class RobotView:
    """A robot as meshcat shows it, in a browser or a notebook.

    Args:
        robot: The robot.
        q: Where it stands, as `Robot` has it; where it rests by default.
        port: Port to listen on, on this machine alone, or the next one that is free.
        package_dirs: Folders to look for meshes in before those that it knows.

    Attributes:
        url: Of the page, with sliders and legend.
        viewer: Pinocchio's visualizer.
        position: (nv,) where the robot is.
        warnings: A line for every shape that is not shown as the file says.

    Raises:
        ConfigError: A q of another size or not finite, or no free port.
    """

    def __init__(
        self,
        robot: Robot,
        q: ArrayLike | None = None,
        port: int = PORT,
        package_dirs: Sequence[str | Path] = (),
    ) -> None:
        self.robot = robot
        self.position = robot.neutral_position() if q is None else robot.position(q)
        self._lock = threading.Lock()
        self._run = Playback(np.zeros(1), self.position[None])
        solids, self.warnings = solids_of(robot, package_dirs)
        self._sliders = list(sliders_of(robot, self.position))
        middle, eye = camera_of(robot, self.position, solids)
        self._server = ServerThread(port, page_of(robot, self._sliders, middle, eye), self._asked)
        self.url = self._server.url
        geometry = geometry_of(robot, solids)
        self.viewer = MeshcatVisualizer(robot.model, pin.GeometryModel(), geometry)
        with contextlib.redirect_stdout(io.StringIO()):  # meshcat prints its own address
            self.viewer.initViewer(zmq_url=self._server.zmq_url)
        self.viewer.loadViewerModel(robot.name)
        self.viewer.viewer["/Grid"].set_object(floor())
        self._forward(robot)
        self.viewer.setBackgroundColor("gray")
        self._show(self.position)

    def display(self, q: ArrayLike) -> None:
        """Move the robot to a q, as `Robot` has it.

        Raises:
            ConfigError: It is of another size, or not finite.
        """
        self._show(self.robot.position(q))

    def play(self, time: Array, positions: Array) -> None:
        """Play positions (k, nv) at their times (k,) [s], again and again; the page has a slider for it."""
        self._run.stop()
        self._run = Playback(time, positions)
        self._run.start(self._show)

    def close(self) -> None:
        """End the server."""
        self._run.stop()
        self._server.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<RobotView of {self.robot.name} at {self.url}>"

    def _repr_html_(self) -> str:
        return f'<iframe title="{self.robot.name}" src="{self.url}" style="width:100%;height:520px;border:0"></iframe>'

    def _show(self, position: Array) -> None:
        with self._lock:
            self.position = position
            self.viewer.display(self.robot.configuration(position))
            if self.robot.dimensions.pose:
                x, y, phi = position[:3]
                place = np.eye(4)
                place[:2, :2] = [[math.cos(phi), -math.sin(phi)], [math.sin(phi), math.cos(phi)]]
                place[:2, 3] = x, y
                self.viewer.viewer["control frame"].set_transform(place)

    def _forward(self, robot: Robot) -> None:
        """Draw the control frame, with an arrow along forward."""
        import meshcat.geometry as shapes

        if not robot.dimensions.pose:
            return
        node, red = self.viewer.viewer["control frame"], shapes.MeshLambertMaterial(color=ARROW)
        node["axes"].set_object(shapes.triad(0.3))
        along = pin.rpy.rpyToMatrix(0.0, 0.0, -math.pi / 2)  # meshcat's cylinders stand along y
        for name, solid, x in (
            ("shaft", shapes.Cylinder(0.5, 0.01), 0.25),
            ("tip", shapes.Cylinder(0.1, radiusTop=0.0, radiusBottom=0.03), 0.55),
        ):
            place = np.eye(4)
            place[:3, :3], place[:3, 3] = along, (x, 0.0, 0.01)
            node[name].set_object(solid, red)
            node[name].set_transform(place)

    def _asked(self, wish: Mapping[str, Any]) -> dict[str, Any]:
        """Do what the page asks, and tell how it is.

        Raises:
            KeyError: A joint that there is not.
            ValueError: A number that is not finite.
        """
        moves = {str(name): float(value) for name, value in wish.get("joints", {}).items()}
        if not all(map(math.isfinite, moves.values())):
            raise ValueError("not finite")
        if moves:
            position = self.position.copy()
            for name, value in moves.items():
                position[self.robot.position_names.index(name)] = value
            self._run.playing = False
            self._show(self.robot.follow(position))
        if "frames" in wish:
            with self._lock:
                self.viewer.displayFrames(bool(wish["frames"]), axis_length=FRAME_AXES)
            self._show(self.position)
        if "playing" in wish:
            self._run.playing = bool(wish["playing"])
        if "time" in wish:
            self._show(self._run.seek(float(wish["time"])))
        names = self.robot.position_names
        joints = {entry["name"]: float(self.position[names.index(entry["name"])]) for entry in self._sliders}
        return {"joints": joints, **self._run.state()}


class Playback:
    """Positions in time, played by a thread.

    Args:
        time: (k,) [s].
        positions: (k, nv).

    Attributes:
        playing: Whether it goes on.
    """

    def __init__(self, time: Array, positions: Array) -> None:
        self.time, self.positions, self.playing, self._ended = time, positions, False, threading.Event()
        self.now = float(time[0])

    def state(self) -> dict[str, Any]:
        """How it stands, for the page."""
        return {"time": self.now, "start": float(self.time[0]), "end": float(self.time[-1]), "playing": self.playing}

    def seek(self, now: float) -> Array:
        """Go to a time; the position then.

        Raises:
            ValueError: It is not finite.
        """
        if not math.isfinite(now):
            raise ValueError("not finite")
        self.now = min(max(now, float(self.time[0])), float(self.time[-1]))
        return self.positions[min(int(np.searchsorted(self.time, self.now)), len(self.time) - 1)]

    def start(self, show: Callable[[Array], None]) -> None:
        """Begin to play, in a thread."""
        self.playing = True
        threading.Thread(target=self._play, args=(show,), daemon=True).start()

    def stop(self) -> None:
        """End it."""
        self._ended.set()

    def _play(self, show: Callable[[Array], None]) -> None:
        last, waited = time.monotonic(), 0.0
        while not self._ended.wait(1 / FPS):
            now = time.monotonic()
            passed, last = now - last, now
            if not self.playing:
                continue
            over = self.now >= self.time[-1]
            waited = waited + passed if over else 0.0
            if not over or waited > PAUSE:
                show(self.seek(float(self.time[0]) if over else self.now + passed))


def sliders_of(robot: Robot, position: Array) -> Iterator[dict[str, Any]]:
    """Sliders of a page: name, words, limits and value of everything that moves and follows nothing."""
    roles, d = roles_of(robot), robot.dimensions
    for i, name in enumerate(robot.position_names):
        if name in robot.arm.slaves:
            continue
        low, high = (float(limit) for limit in (robot.lower[i], robot.upper[i]))
        if i < d.pose:
            low, high = (-math.pi, math.pi) if name == "phi" else (-2.0, 2.0)
        elif not math.isfinite(high - low):
            low, high = -math.pi, math.pi
        role = roles.get(name, BODY)
        yield {
            "name": name, "low": min(low, position[i]), "high": max(high, position[i]), "value": float(position[i]),
            "role": "base" if i < d.pose else role.name, "color": role.color,
        }  # fmt: skip


def camera_of(robot: Robot, position: Array, solids: Sequence[Solid]) -> tuple[Array, Array]:
    """Point (3,) to look at, and eye (3,) that sees all of a robot from its front left [m]."""
    places = placements(robot, position, solids)
    points = np.vstack([s.vertices @ at[:3, :3].T + at[:3, 3] for s, at in zip(solids, places, strict=True)])
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2, (low + high) / 2 + FROM * float(np.linalg.norm(high - low))


def page_of(robot: Robot, sliders: Sequence[Mapping[str, Any]], middle: Array, eye: Array) -> str:
    """The page around meshcat's viewer, which looks from an eye (3,) at a middle (3,)."""
    groups = dict[str, list[Mapping[str, Any]]]()
    for slider in sliders:
        groups.setdefault(slider["role"], []).append(slider)
    first = ("arm", "base", "steering")
    ordered = sorted(groups.items(), key=lambda item: first.index(item[0]) if item[0] in first else len(first))
    return fill_template(
        "view.html",
        __package__,
        title=robot.name,
        lines=summary(inspection_of(robot)),
        legend=[(role.name, role.color, names) for role, names in legend(robot)],
        arrow=f"#{ARROW:06x}" if robot.dimensions.pose else "",
        groups=ordered,
        camera=json.dumps([middle.tolist(), eye.tolist()]),
        script=web_file("view.js", __package__),
        style=web_file("view.css", __package__),
    )


def floor() -> Any:
    """A grid, of lines as short as its cells: a browser may leave out one that goes on behind the eye."""
    import meshcat.geometry as shapes

    line, start = np.meshgrid(np.arange(-CELLS, CELLS + 1), np.arange(-CELLS, CELLS))
    still = np.zeros_like(line)
    along = np.stack([start, line, still, start + 1, line, still], axis=-1).reshape(-1, 3)
    points = CELL * np.vstack([along, along[:, [1, 0, 2]]]).T.astype(np.float32)
    return shapes.LineSegments(shapes.PointsGeometry(points), shapes.LineBasicMaterial(color=0xA0A0A0))


def geometry_of(robot: Robot, solids: Sequence[Solid]) -> pin.GeometryModel:
    """The shapes of a robot as Pinocchio has them, in the colours of their roles."""
    model, made = pin.GeometryModel(), dict[int, coal.BVHModelOBBRSS]()
    for i, solid in enumerate(solids):
        if id(solid.vertices) not in made:
            mesh = coal.BVHModelOBBRSS()
            mesh.beginModel(len(solid.triangles), len(solid.vertices))
            mesh.addVertices(solid.vertices)
            mesh.addTriangles(solid.triangles.astype(np.uint32))
            mesh.endModel()
            made[id(solid.vertices)] = mesh
        frame = robot.model.frames[robot.model.getFrameId(solid.frame)]
        place = frame.placement * pin.SE3(solid.place)
        shape = pin.GeometryObject(f"{solid.frame}_{i}", frame.parentJoint, place, made[id(solid.vertices)])
        color = [int(solid.role.color[j : j + 2], 16) / 255 for j in (1, 3, 5)]
        shape.meshColor = np.array([*color, 1.0])
        model.addGeometryObject(shape)
    return model


def played(recording: Recording, port: int = PORT, package_dirs: Sequence[str | Path] = ()) -> RobotView:
    """A run in meshcat, played again and again.

    Raises:
        RecordingError: It has nothing to show, or does not hold its robot.
        ConfigError: No port is free.
    """
    rows, robot = frames_of(recording, FPS), recorded_robot(recording, package_dirs)
    shown = RobotView(robot, port=port, package_dirs=package_dirs)
    shown.play(recording.time[rows], recorded_position(recording, robot)[rows])
    return shown
