"""What moved in a run, at the rate of a display: rows of positions, and those that the reference asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....errors import RecordingError
from ....model.robot import Robot
from ....recording.recording import Recording, as_columns, recorded_position
from ....signals import Array, IntArray
from .blob import Blob

FAR = 1e6  # a coordinate beyond this is as good as infinite: it is not drawn [m or rad]


def drawable(table: Array) -> NDArray[np.bool_]:
    """Which rows of a table (k, n) can be drawn."""
    return np.asarray((np.abs(table) < FAR).all(axis=1))


def frames_of(recording: Recording, fps: float) -> IntArray:
    """Rows to show: those nearest to an even grid of times, the first and the last; finite ones only.

    Args:
        recording: The run.
        fps: Frames per second.

    Raises:
        RecordingError: There are none.
    """
    known = ("position",) if "position" in recording else ("pose", "q")
    table = np.hstack([as_columns(recording[name]) for name in known if name in recording])
    good = np.flatnonzero(drawable(table)) if len(recording) else np.array([], int)
    if not len(good):
        why = "it ended before its first sample" if not len(recording) else "no position in it is finite"
        raise RecordingError("nothing to replay", why=why, file=recording.path)
    times = recording.time[good]
    grid = np.append(np.arange(times[0], times[-1], 1 / fps), times[-1])
    return good[np.unique(np.searchsorted((times[1:] + times[:-1]) / 2, grid))]


def wanted(recording: Recording, robot: Robot, rows: IntArray) -> Array | None:
    """Positions (k, nv) that the reference asked for; None where the run has none.

    What no reference speaks of (wheels, locked joints) is where the robot has it; mimic joints follow.
    """
    if "q_ref" not in recording and "pose_ref" not in recording:
        return None
    table = recorded_position(recording, robot)[rows]
    if "pose_ref" in recording:
        table[:, :3] = recording["pose_ref"][rows]
    if "q_ref" in recording:
        table[:, robot.arm_index] = as_columns(recording["q_ref"])[rows]
    robot.follow(table.T)
    return table if drawable(table).all() else None


def packed(recording: Recording, robot: Robot, rows: IntArray, blob: Blob) -> dict[str, Any]:
    """Frames of a run as the page reads them: times (k,), positions (k, nv), wanted positions (k, nv) or None."""
    position, reference = recorded_position(recording, robot)[rows], wanted(recording, robot, rows)
    return {
        "frames": len(rows),
        "width": position.shape[1],
        "time": blob.add(recording.time[rows], "f4"),
        "position": blob.add(position, "f4"),
        "reference": None if reference is None else blob.add(reference, "f4"),
    }
