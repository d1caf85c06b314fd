"""Limits of a supervisor as settings, and as numbers for one robot."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from ..model.base import BY_SIZE
from ..model.dynamics import Dynamics
from ..model.robot import Robot, limits, speed_limits
from ..settings import Numbers, Settings, one_or_each, require_numbers
from ..signals import Array, Layout
from .supervisor import BLIND, COMMANDED, HEARD, MEMORY

MAY_BE_ZERO = ("torque_time", "stop_time", "settle", "hold_rate", "ramp")
FRESH = 5.5  # measurements that fail to come before a stop does without


class Safety(Settings, frozen=True):
    """Limits of a run on hardware, and what happens when one is passed. None is no limit.

    Args:
        torque: Largest motor torque, clipped; one number or one per motor [N m or N], "urdf" for the URDF's limits.
        torque_time: How long a motor may ask for more before that trips [s].
        speed: Largest speed of the base [m/s].
        yaw_rate: Largest yaw rate of the base [rad/s].
        joint_speed: Largest speed of an arm joint, one number or one per joint [rad/s or m/s], "urdf" for the URDF's.
        position_error: Largest distance of the base from its reference [m].
        heading_error: Largest heading error [rad].
        joint_error: Largest error of an arm joint, one number or one per joint [rad or m].
        weights: Largest Frobenius norm of every array of weights; larger ones are scaled back at every sample.
        timeout: Age of the measurement or of the command at which it trips [s]; that of ros2_controllers by default.
        ramp: Time in which torque goes to zero: all of it without measurements, the last command without commands [s].
        stop_time: How long a tripped run goes on, to show the stop [s].
        settle: Time in which feedback has to bring the robot to rest, where shorted windings are the alternative: after
            it the stop does without feedback [s].
        rest: Measured speed that counts as rest then [m/s, rad/s].
        hold_rate: Rate of the integral that holds the arm against gravity, slower where the feedback is too weak for it
            [1/s].

    Raises:
        ConfigError: A number that is negative or not finite, or a limit of 0, with the key path.
    """

    torque: Literal["urdf"] | Numbers | None = None
    torque_time: float = 0.5
    speed: float | None = None
    yaw_rate: float | None = None
    joint_speed: Literal["urdf"] | Numbers | None = None
    position_error: float | None = None
    heading_error: float | None = None
    joint_error: Numbers | None = None
    weights: float | None = None
    timeout: float = 0.5
    ramp: float = 0.25
    stop_time: float = 1.5
    settle: float = 0.5
    rest: float = 0.1
    hold_rate: float = 2.0

    def __post_init__(self) -> None:
        require_numbers(self, "safety", set(self.__struct_fields__) - set(MAY_BE_ZERO))

    def numbers(
        self, robot: Robot, period: float, gains: Array, K: Array, short: bool = False, arrivals: float = 0.0
    ) -> Array:
        """Settings as numbers for one robot.

        Args:
            robot: The robot.
            period: Control period [s].
            gains: (p,) feedback that brakes and holds, on the velocities.
            K: (n,) gain of the filtered arm error.
            short: Whether shorted windings brake the base.
            arrivals: Time between two measurements [s]; 0 for the control period.

        Raises:
            ConfigError: Not one number per motor or per joint.
        """
        layout = robot.layout
        own = [self.timeout, self.ramp, self.stop_time, self.torque_time]
        own += [
            some(self.position_error),
            some(self.heading_error),
            some(self.weights),
            self._calm_rate(robot, gains),
            period,
        ]
        own += [self.settle, self.rest, float(short), FRESH * (arrivals or period)]
        base = BY_SIZE[layout.base].per_velocity(some(self.speed), some(self.yaw_rate))
        urdf = speed_limits(robot)[layout.motors - layout.arm :]
        joint_speed = limits(self.joint_speed, urdf, "joint", "safety.joint_speed")
        torque = limits(self.torque, robot.effort_limits, "motor", "safety.torque")
        most = math.inf if self.joint_error is None else self.joint_error
        error = one_or_each(most, layout.arm, "joint", "safety.joint_error")
        return np.concatenate((own, torque, base, joint_speed, gains, error, K)).astype(float)

    def _calm_rate(self, robot: Robot, gains: Array) -> float:
        """`M qddot = g (K (e + I) - qdot)`, `Idot = rate e` is stable for `rate < g / M` (Routh); half at most."""
        nb = robot.layout.base
        inertias = np.diag(Dynamics(robot).mass_matrix(robot.neutral_position()))[nb:]
        return min(self.hold_rate, float(np.min(0.5 * gains[nb:] / inertias, initial=math.inf)))


def some(value: float | None) -> float:
    """A limit, or inf."""
    return math.inf if value is None else value


def new_state(layout: Layout, start: float = 0.0) -> Array:
    """What the supervisor remembers, before its first measurement at a time [s]."""
    message = layout.pose + layout.base + 2 * layout.arm
    state = np.zeros(MEMORY + message + 2 * layout.dof + layout.motors + 2 * layout.arm)
    state[HEARD] = state[COMMANDED] = start
    state[BLIND] = -1.0
    return state
