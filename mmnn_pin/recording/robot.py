"""The robot of a recording, built again from what the recording holds: URDF, overrides, masses, rotors, friction.

And where that robot was, as well as the recording knows.
"""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

from ..errors import RecordingError
from ..model.base.overrides import Overrides
from ..model.loading import build
from ..model.robot import Robot
from ..model.urdf.reading import parse
from ..signals import Array
from .metrics import as_columns
from .recording import Recording


def recorded_robot(recording: Recording) -> Robot:
    """The true robot of a recording.

    Meshes are looked for where the file was; wheels whose radius came from one need it.

    Args:
        recording: The recording.

    Raises:
        RecordingError: It does not hold these facts, or another robot comes out of them.
        InputError: As `load`.
    """
    meta = recording.meta
    try:
        said = msgspec.convert(meta["overrides"], Overrides)
        document = parse(recording.urdf.encode(), meta["urdf_file"], said.strict, said.package_dirs)
        masses, viscous, gears = meta["mass_factors"], meta["viscous"], meta["joint_friction"]
    except KeyError as error:
        what = f"the recording does not tell {error} of its robot"
        raise RecordingError(what, why="an older mmnn_pin wrote it", file=recording.path) from None
    robot = build(document, said)
    if robot.position_names != meta["position_names"] or robot.velocity_names != meta["velocity_names"]:
        why = f"it moves by {', '.join(robot.velocity_names)}, not by {', '.join(meta['velocity_names'])}"
        raise RecordingError("another robot comes out of the recording's facts", why=why, file=recording.path)
    gears = {name: np.array(value) if isinstance(value, list) else value for name, value in gears.items()}
    robot = robot.with_masses(masses).with_armature(meta.get("armature", 0.0)).with_friction(viscous)
    return replace(robot, **gears)


def recorded_position(recording: Recording, robot: Robot) -> Array:
    """Where a robot was, (N, nv): the true position, or without one what was measured, the other joints at rest."""
    if "position" in recording:
        return as_columns(recording["position"])
    table = np.tile(robot.neutral_position(), (len(recording), 1))
    if "pose" in recording:
        table[:, :3] = recording["pose"]
    if "q" in recording:
        table[:, robot.arm_index] = as_columns(recording["q"])
    robot.follow(table.T)
    return table
