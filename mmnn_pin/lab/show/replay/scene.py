"""What the page draws: the robots, each once, and the runs that move them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import RecordingError
from ....model.robot import Robot
from ....model.urdf.parsing import parse
from ....recording.recording import Recording, recorded_robot
from ..figure import scale_rows, styles_of
from .blob import Blob
from .bodies import Tree
from .events import events_of
from .motion import drawable, frames_of, packed
from .shapes import Shapes


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
        self._shapes = Shapes(self.blob, package_dirs)
        self._robots: dict[str, tuple[int, Robot, Tree]] = {}
        self._for_page: list[dict[str, Any]] = []
        self._runs: list[dict[str, Any]] = []

    @classmethod
    def of(cls, recordings: Mapping[str, Recording], fps: float, package_dirs: Sequence[str | Path] = ()) -> Scene:
        """Scene of runs by name; each has the colour that it has in the plots.

        Raises:
            RecordingError: No run, one without anything to show, or one that does not tell its robot.
            InputError: The robot of a run cannot be built.
        """
        if not recordings:
            raise RecordingError("no recording to replay")
        scene, styles = cls(package_dirs), styles_of(recordings)
        for name, recording in recordings.items():
            scene.add(name, recording, styles[name].color, fps)
        return scene

    def add(self, name: str, recording: Recording, color: str, fps: float) -> None:
        """Add a run.

        Args:
            name: For the legend.
            recording: The run.
            color: As `#RRGGBB`.
            fps: Frames per second that are kept.

        Raises:
            RecordingError: It has nothing to show, or does not tell its robot.
            InputError: Its robot cannot be built.
        """
        rows = frames_of(recording, fps)
        index, robot, tree = self._robot(recording)
        bodies = {body.joint.name: i for i, body in enumerate(tree.bodies) if body.joint}
        events = [event.for_page(bodies) for event in events_of(recording)]
        about = {"name": name, "label": label(name, recording), "robot": index, "color": color, "events": events}
        self._runs.append(about | packed(recording, robot, rows, self.blob))
        self.frames += len(rows)
        self.samples += len(recording)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is not shown as the URDF says, one line each."""
        return self._shapes.warnings

    def header(self, extent: list[float]) -> dict[str, Any]:
        """All but the arrays, as the page reads it; `extent` as from `extent_of`."""
        scene = {"geometries": self._shapes.geometries, "robots": self._for_page, "runs": self._runs}
        return scene | {"extent": extent, "warnings": list(self.warnings)}

    def _robot(self, recording: Recording) -> tuple[int, Robot, Tree]:
        robot = recorded_robot(recording)
        key = f"{robot.frame.tolist()} {robot.urdf}"
        if key not in self._robots:
            tree = Tree.of(parse(robot.urdf.encode(), robot.path))
            self._robots[key] = len(self._robots), robot, tree
            self._for_page.append(
                {
                    "name": robot.name,
                    "mobile": robot.layout.pose > 0,
                    "frame": [*robot.frame.tolist(), robot.base.floor],
                    "bodies": [body.for_page(robot) for body in tree.bodies],
                    "visuals": self._shapes.visuals(robot, tree),
                    "tips": tree.tips(robot),
                }
            )
        index, _, tree = self._robots[key]
        return index, robot, tree


def label(name: str, recording: Recording) -> str:
    """Name of a run, with how it ended if it ended early."""
    outcome = recording.outcome
    return name if outcome.status == "completed" else f"{name} ({outcome.status} at {outcome.time:.3g} s)"


def extent_of(recordings: Mapping[str, Recording]) -> list[float]:
    """Where the bases were and should be: least x and y, largest x and y [m]; what diverged counts little."""
    points = [np.zeros((1, 2))]
    for recording, rows in scale_rows(recordings.values()):
        for signal in {"pose", "pose_ref"} & set(recording):
            part = recording[signal][rows, :2]
            points.append(part[drawable(part)])
    every = np.vstack(points)
    return [*every.min(axis=0).tolist(), *every.max(axis=0).tolist()]
