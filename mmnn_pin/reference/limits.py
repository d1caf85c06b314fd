"""Limits of the references that are made while the robot runs, as settings."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from ..elementary import cos, cos_sin
from ..errors import ConfigError
from ..model.base import kind_of
from ..model.base.steered import SteeredBase
from ..model.robot import Robot, speed_limits
from ..model.robot import limits as limits_of
from ..settings import Numbers, Settings, one_or_each, require_numbers
from ..signals import Array, Dimensions

USUAL = (1.0, 2.0, 5.0)  # accelerations where none is stated [m/s^2, rad/s^2, rad/s^2 or m/s^2]


OCTAGON = 4  # directions, up to their sense, in which the speed of a wheel that steers is looked at

OF_STOPS, OF_RATE = 0.95, 0.9  # shares that a reference may need: of the way between stops, of the largest rate


class Limits(Settings, frozen=True):
    """Limits of a reference that is made while the robot runs.

    Accelerations that are stated hold for motions handed in, too: one beyond them is refused. Where they are not
    stated, a motion brings its own, and what is made here keeps to the usual ones.

    Args:
        speed: Largest speed of the base [m/s].
        yaw_rate: Largest yaw rate [rad/s].
        acceleration: Largest acceleration of the base [m/s^2]; None for 1 in motions made here.
        yaw_acceleration: Largest yaw acceleration [rad/s^2]; None for 2 in motions made here.
        joint_speed: Largest speed of the joints, one number or one per joint [rad/s or m/s]; "urdf" for the velocity
            limits of the URDF, 1 if it states none.
        joint_acceleration: Largest acceleration of the joints, one number or one per joint [rad/s^2 or m/s^2]; None for
            5 in motions made here.
        joint_jerk: Largest jerk of motions to a goal, one number or one per joint [rad/s^3 or m/s^3].
        joint_margin: Distance that is kept from the joints' stops [rad or m].
        samples: What is done with full samples that jump or are too fast: "limited" leads the reference to them within
            the limits, "exact" takes them unchanged except at the joints' stops.

    Raises:
        ConfigError: A number that is not positive and finite.
    """

    speed: float = 1.0
    yaw_rate: float = 1.5
    acceleration: float | None = None
    yaw_acceleration: float | None = None
    joint_speed: str | Numbers = "urdf"
    joint_acceleration: Numbers | None = None
    joint_jerk: Numbers = 50.0
    joint_margin: float = 0.0
    samples: Literal["limited", "exact"] = "limited"

    def __post_init__(self) -> None:
        require_numbers(self, "limits", set(self.__struct_fields__) - {"joint_margin"})
        if isinstance(self.joint_speed, str) and self.joint_speed != "urdf":
            fix = 'give numbers, or "urdf"'
            raise ConfigError(f"'{self.joint_speed}'", fix=fix, key="limits.joint_speed")

    @property
    def accelerations(self) -> tuple[float, float]:
        """Of the base, along and about [m/s^2, rad/s^2]."""
        along, about = self.acceleration, self.yaw_acceleration
        return USUAL[0] if along is None else along, USUAL[1] if about is None else about

    def of_base(self, dimensions: Dimensions) -> Array:
        """Speeds, accelerations, and those that a motion may bring along, of a twist's velocities, (3, twist)."""
        per_velocity, none = kind_of(dimensions).per_velocity, math.inf
        brought = (none if a is None else a for a in (self.acceleration, self.yaw_acceleration))
        rows = [(self.speed, self.yaw_rate), self.accelerations, brought]
        return np.array([per_velocity(*row) for row in rows], float).reshape(3, dimensions.twist)

    def of_arm(self, robot: Robot) -> Array:
        """Speed, acceleration, jerk, and the acceleration that a motion may bring along of the joints, (4, n).

        Raises:
            ConfigError: Neither one number nor as many as joints.
        """
        n, stated = robot.dimensions.arm, self.joint_acceleration
        urdf = speed_limits(robot)[robot.dimensions.motors - n :]
        speed = limits_of(self.joint_speed, np.where(np.isfinite(urdf), urdf, 1.0), "joint", "limits.joint_speed")  # type: ignore[arg-type]
        bend = one_or_each(USUAL[2] if stated is None else stated, n, "joint", "limits.joint_acceleration")
        jerk = one_or_each(self.joint_jerk, n, "joint", "limits.joint_jerk")
        return np.array([speed, bend, jerk, np.full(n, math.inf) if stated is None else bend]).reshape(4, n)


def rims(robot: Robot) -> tuple[Array, Array]:
    """Rows (m, twist) by which drive wheels turn with a twist, and their largest speeds (m,) [rad/s].

    The speed of a wheel that steers is looked at in some directions; its row is as much longer as it may be between
    them.
    """
    d, speeds = robot.dimensions, speed_limits(robot)
    if not isinstance(robot.base, SteeredBase):
        wheels = d.motors - d.arm
        return robot.E.T[:wheels, : d.twist], speeds[:wheels]
    base, rows, most = robot.base, list[Array](), list[float]()
    for wheel, fastest in zip((w for w in base.wheels if w.driven), speeds, strict=False):
        ways, size = [wheel.heading], wheel.radius
        if wheel.pivot >= 0:
            ways, size = [math.pi * i / OCTAGON for i in range(OCTAGON)], wheel.radius * cos(math.pi / (2 * OCTAGON))
        x, y = base.place(wheel)
        for c, s in map(cos_sin, ways):
            rows.append(np.array([c, s, s * x - c * y])[base.columns] / size)
            most.append(float(fastest))
    return np.array(rows).reshape(-1, d.twist), np.array(most)
