"""The settings of a run that are fixed before it: where it starts, and where its state counts as lost.

Refused are a nominal robot of another shape and a first sample without a measurement; `sampled` judges the gains.
"""

from __future__ import annotations

import numpy as np

from ..elementary import cos_sin
from ..elementary.matrices import product
from ..errors import ConfigError
from ..model.base import kind_of
from ..model.robot import Robot
from ..settings import LARGEST, Numbers, Settings, Timing, one_or_each, require_gains
from ..settings.arguments import shortly
from ..signals import Array, Dimensions, Setpoint


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

    def state(self, robot: Robot, first: Array, angles: Array | None = None) -> tuple[Array, Array]:
        """Position (nv,) and nu (p,) for the first setpoint, its six arrays side by side.

        Args:
            robot: The robot.
            first: The setpoint.
            angles: (shape,) of the pivots of a base that steers [rad]; None for those along the setpoint's motion.

        Raises:
            ConfigError: Neither one joint offset nor as many as arm joints.
        """
        layout = robot.dimensions
        joint_offset = one_or_each(self.joint_offset, layout.arm, "joint", "start.joint_offset")
        position, nu = robot.neutral_position(), np.zeros(layout.dof)
        setpoint = Setpoint.side_by_side(first, layout)
        if layout.base:
            x, y, phi = setpoint.pose
            dx, dy, dphi = self.pose_offset
            c, s = cos_sin(phi)
            position[:3] = x + c * dx - s * dy, y + s * dx + c * dy, phi + dphi
        position[robot.arm_index] = setpoint.q + joint_offset
        if angles is None:
            robot.steered_along(position, setpoint.velocity)
        else:
            position[robot.shape_index] = angles
        if self.moving:
            nu[: layout.base] = robot.base_velocity(position, setpoint.velocity)
            nu[layout.base :] = setpoint.qdot
        return robot.follow(position), nu


class Bounds(Settings, frozen=True):
    """Largest velocities; a run that passes one ends as diverged.

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

    def vector(self, layout: Dimensions) -> Array:
        """Bounds on |nu|, (p,)."""
        base = kind_of(layout).per_base_velocity(self.speed, self.yaw_rate, layout.base)
        return np.array(base + [self.joint_speed] * layout.arm, float)


def viscous_friction(robot: Robot) -> Array:
    """Viscous friction of a robot's joints and base on nu, (p, p); Coulomb friction has none once it slides."""
    T = robot.T_at(robot.rest)
    return product(T.T, robot.damping[:, None] * T) + np.diag(robot.viscous)


def lags(robot: Robot, lag: Numbers) -> Array:
    """Time constants of the motors, seen from the velocities (p,); the longest of those that move one [s]."""
    motors = one_or_each(lag, robot.dimensions.motors, "motor", "lag", 0.0)
    return np.array([motors[np.abs(row) > 0].max(initial=0.0) for row in robot.E_at(robot.rest)])


def require_nominal(nominal: Robot, robot: Robot) -> None:
    """Refuse a nominal robot of another shape (`ConfigError`)."""
    if nominal.dimensions != robot.dimensions:
        raise ConfigError(
            f"the nominal robot has {nominal.dimensions}, the robot {robot.dimensions}",
            fix="use one with the same base and the same joints",
            key="nominal",
        )


def require_first(timing: Timing, first: int) -> None:
    """Refuse to start at a control sample at which there is no measurement (`ConfigError`)."""
    if not 0 <= first < timing.samples or first * timing.steps_per_control % timing.steps_per_measurement:
        raise ConfigError(
            f"cannot start at control sample {first}",
            why=f"the run has {timing.samples}, and a held measurement is not part of the state",
            fix="choose one of them at which there is a measurement",
            key="first",
        )


def samples_between(interval: float, period: float) -> int:
    """Control samples between two records of the weights.

    Raises:
        ConfigError: The interval is no number of seconds > 0.
    """
    if not 0 < interval <= LARGEST:
        raise ConfigError(f"{interval} s", fix="use a finite number of seconds > 0", key="weights_interval")
    return max(1, round(interval / period))


def require_seed(seed: int) -> None:
    """Refuse a seed that a recording cannot hold (`ConfigError`)."""
    if not 0 <= seed < 2**63:
        raise ConfigError(f"{shortly(seed)}", fix="use an integer from 0 to 2^63 - 1", key="seed")
