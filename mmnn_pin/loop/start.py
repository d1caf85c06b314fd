"""Where a run starts, and where its state counts as lost."""

from __future__ import annotations

import numpy as np

from ..errors import ConfigError
from ..model.base import BY_SIZE
from ..model.robot import Robot
from ..settings import Settings, one_or_each, require_gains
from ..signals import INDEX, Array, Layout

FIRST_REFERENCE = INDEX["pose_ref"]


class Start(Settings, frozen=True):
    """Where a run starts, relative to the reference at t = 0.

    Args:
        pose_offset: Start minus reference, in the reference's frame (x, y, phi) [m, m, rad].
        joint_offset: Start minus reference of every arm joint, one number or one per joint [rad or m].
        moving: Start with the reference's velocity instead of at rest.

    Raises:
        ConfigError: An offset is not finite.
    """

    pose_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    joint_offset: float | tuple[float, ...] = 0.0
    moving: bool = False

    def __post_init__(self) -> None:
        for name in ("pose_offset", "joint_offset"):
            if not np.all(np.isfinite(getattr(self, name))):
                raise ConfigError(f"{getattr(self, name)} is not finite", fix="use finite numbers", key=f"start.{name}")

    def state(self, robot: Robot, first: Array) -> tuple[Array, Array]:
        """Position (nv,) and nu (p,) for the first row of a reference table.

        Raises:
            ConfigError: Neither one joint offset nor as many as arm joints.
        """
        layout = robot.layout
        joint_offset = one_or_each(self.joint_offset, layout.arm, "joint", "start.joint_offset")
        position, nu = robot.neutral_position(), np.zeros(layout.dof)
        at = layout.offsets - layout.offsets[FIRST_REFERENCE]
        values = {name: first[at[INDEX[name]] : at[INDEX[name] + 1]] for name in REFERENCE_NAMES}
        if layout.base:
            x, y, phi = values["pose_ref"]
            dx, dy, dphi = self.pose_offset
            c, s = np.cos(phi), np.sin(phi)
            position[:3] = x + c * dx - s * dy, y + s * dx + c * dy, phi + dphi
        position[robot.arm_index] = values["q_ref"] + joint_offset
        if self.moving:
            nu[: layout.base], nu[layout.base :] = values["velocity_ref"], values["qdot_ref"]
        return robot.follow(position), nu


REFERENCE_NAMES = ("pose_ref", "velocity_ref", "acceleration_ref", "q_ref", "qdot_ref", "qddot_ref")


class Bounds(Settings, frozen=True):
    """Where a state counts as lost; leaving them ends the run as diverged.

    Args:
        speed: Largest speed of the base [m/s].
        yaw_rate: Largest yaw rate of the base [rad/s].
        joint_speed: Largest speed of an arm joint [rad/s or m/s].
    """

    speed: float = 20.0
    yaw_rate: float = 100.0
    joint_speed: float = 200.0

    def __post_init__(self) -> None:
        require_gains(self, "bounds")

    def vector(self, layout: Layout) -> Array:
        """Bounds on |nu|, (p,)."""
        base = BY_SIZE[layout.base].per_velocity(self.speed, self.yaw_rate)
        return np.array(base + [self.joint_speed] * layout.arm, float)
