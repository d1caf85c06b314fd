"""How a run pushed on what its hand touched: the force on a surface, and the way of a door."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...model.chain import chain_of, hands_of, pushing
from ...model.robot import Robot
from ...recording.recording import Recording, as_columns, recorded_position
from ...settings import finite
from ...signals import Array

SETTLED = 1.0  # after a force has grown, from when on it is judged [s]
OPEN = 60.0  # a door that is open [deg]


def pushing_numbers(recording: Recording, robot: Robot) -> dict[str, float | None]:
    """Numbers of one run that touched something; none of others.

    Of a surface mean and RMS error of the force on it [N], of a door its largest angle [deg], when it was at 60 degrees
    [s], and until then the largest force across the handle's way and along it [N].

    Args:
        recording: The run.
        robot: The robot that ran.
    """
    if "hand_force" not in recording or not len(recording):
        return {}
    found: dict[str, float | None] = {}
    for one in recording.meta.get("disturbances", ()):
        if one.get("type") == "surface":
            found |= on_surface(recording, surface_normal(one, recording, robot))
        elif one.get("type") == "door":
            found |= on_door(recording, one)
    return found


def surface_normal(surface: dict[str, Any], recording: Recording, robot: Robot) -> Array:
    """(3,) where a surface faces in the world."""
    if surface["normal"] is not None:
        normal = np.array(surface["normal"], float)
        return np.asarray(normal / np.linalg.norm(normal))
    chain = chain_of(robot, surface["frame"] or hands_of(robot)[0])
    return -pushing(chain, recorded_position(recording, robot)[0], robot.dimensions.arm)


def on_surface(recording: Recording, normal: Array) -> dict[str, float | None]:
    """Mean and RMS error of the force on a surface that faces along `normal` (3,), once it should be there."""
    force = recording.meta.get("force") or {"start": 0.0, "rise": 0.0, "newtons": 0.0}
    kept = recording.time >= force["start"] + force["rise"] + SETTLED
    if not kept.any():
        return {}
    pressed = recording["hand_force"][kept] @ normal
    error = float(np.sqrt(np.mean((pressed - force["newtons"]) ** 2)))
    return {"force_mean_N": finite(float(pressed.mean())), "force_error_rms_N": finite(error)}


def handle_way(recording: Recording, door: dict[str, Any]) -> tuple[Array, Array]:
    """Directions (N, 3) in which a door's handle moves as it opens, and its places (N, 3) relative to the hinge."""
    x, y = -np.array(door["hinge"], float)
    heading = float(recording["pose"][0, 2]) if "pose" in recording else 0.0
    sense = np.copysign(1.0, y if door["opens"] == "pull" else -y)
    turned = heading + sense * as_columns(recording["opening"])[:, 0]
    c, s = np.cos(turned), np.sin(turned)
    arm = np.stack((c * x - s * y, s * x + c * y, np.zeros_like(c)), axis=1)
    way = sense * np.stack((-arm[:, 1], arm[:, 0], arm[:, 2]), axis=1) / np.hypot(x, y)
    return way, arm


def on_door(recording: Recording, door: dict[str, Any]) -> dict[str, float | None]:
    """How far a door came, and the forces on its handle until it stood open."""
    angle, force = np.degrees(as_columns(recording["opening"])[:, 0]), recording["hand_force"]
    way, _ = handle_way(recording, door)
    along = np.sum(force * way, axis=1)
    across = np.linalg.norm(force - along[:, None] * way, axis=1)
    is_open = np.flatnonzero(angle >= OPEN)
    until = int(is_open[0]) + 1 if is_open.size else len(angle)
    return {
        "door_deg": finite(float(angle.max())),
        "open_after_s": finite(float(recording.time[until - 1])) if is_open.size else None,
        "side_force_peak_N": finite(float(across[:until].max())),
        "pull_peak_N": finite(float(np.abs(along[:until]).max())),
    }
