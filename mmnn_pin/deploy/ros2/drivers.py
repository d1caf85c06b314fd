"""The controller of `ros2_control` that drives a base, and its parameters for the joints as the URDF has them.

A driver turns the velocity of the base into rates of its wheels. Signs, radii and places go into its parameters, until
its own formula gives the rates that roll these wheels; where no parameters do, it is refused. The formulas are those
of ros-controls/ros2_controllers, release 6.9.0 (master at 94e74de):

    diff_drive_controller        left  = (v - w b / 2) / (multiplier r)      right = (v + w b / 2) / (multiplier r)
    mecanum_drive_controller     front left = (vx - vy - L w) / r            front right = (vx + vy + L w) / r
                                 rear right = (vx - vy + L w) / r            rear left   = (vx + vy - L w) / r
    omni_wheel_drive_controller  wheel i = (sin t vx - cos t vy - R w) / r,  t = wheel_offset + 2 pi i / n

Multipliers may be negative: no check of theirs forbids it, and the odometry multiplies by them. `(vx, vy)` of the
mecanum controller are turned by `base_frame_offset.theta`, so that wheels may all run backwards.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...elementary import atan2, cos_sin
from ...errors import ConfigError
from ...files import quoted
from ...model.base.base import Base, Wheel
from ...model.base.steered import CarLike, SteeredBase, Tricycle
from ...signals import Array

SAME = 1e-3  # lengths and rates that differ by less than this fraction are one
SLOTS = {"front_left": (-1, -1), "front_right": (1, 1), "rear_right": (-1, 1), "rear_left": (1, -1)}  # signs of vy, L w
ONE_BY_ONE = "command its wheels one by one: {{type: Float64MultiArray, interface: velocity, joints: [{}]}}"


class Driver(NamedTuple):
    """A controller for bases."""

    kind: str  # its class
    takes: str  # last part of the topic of its command
    tells: str  # last part of the topic of its odometry
    timeout: str  # its parameter for the age of a command
    geometry: Callable[[Base, list[Wheel]], dict[str, Any]]  # its parameters for a base with these driven wheels

    @property
    def name(self) -> str:
        """The driver's name."""
        return self.kind.partition("/")[0]


def driver_of(base: Base) -> Driver | None:
    """The controller for a base, None for one that no wheels move, or that steers and is no car."""
    if not base.wheels or isinstance(base, SteeredBase):
        return ACKERMANN if isinstance(base, CarLike) else TRICYCLE if isinstance(base, Tricycle) else None
    if base.two_sided:
        return DIFF_DRIVE
    return MECANUM if all(wheel.heading == 0.0 for wheel in base.wheels) else OMNI


def diff_drive(base: Base, wheels: list[Wheel]) -> dict[str, Any]:
    """Parameters of `diff_drive_controller`: a side has one rate, so its wheels have one sign and radius.

    Raises:
        ConfigError: They have not, or the sides differ in number.
    """
    sides = [[wheel for wheel in wheels if side * wheel.y > 0.0] for side in (1, -1)]
    for side in sides:
        if len({wheel.sign for wheel in side}) > 1:
            raise refusal(wheels, "it has one sign for all wheels of a side", [w for w in side if w.sign < 0.0])
        if not all(math.isclose(wheel.radius, side[0].radius, rel_tol=SAME) for wheel in side):
            raise refusal(wheels, f"it has one radius for all wheels of a side, not {sizes(side)}")
    if len(sides[0]) != len(sides[1]):
        raise refusal(wheels, f"it takes as many wheels on the left ({len(sides[0])}) as right ({len(sides[1])})")
    left, right = (float(np.mean([wheel.sign * wheel.radius for wheel in side])) for side in sides)
    return {
        "left_wheel_names": [wheel.joint for wheel in sides[0]],
        "right_wheel_names": [wheel.joint for wheel in sides[1]],
        "wheel_separation": base.track, "wheel_radius": abs(left),
        "left_wheel_radius_multiplier": math.copysign(1.0, left), "right_wheel_radius_multiplier": right / abs(left),
    }  # fmt: skip


def mecanum(base: Base, wheels: list[Wheel]) -> dict[str, Any]:
    """Parameters of `mecanum_drive_controller`: whose formula has a wheel's row takes the wheel, wherever it is.

    Raises:
        ConfigError: No four rows of its are those of the wheels.
    """
    if len(wheels) != 4:
        raise refusal(wheels, f"it has four wheels, not {len(wheels)}")
    radius = one_radius(wheels)
    for theta, c in ((0.0, 1.0), (math.pi, -1.0)):
        rows = [radius * (w.sign / w.radius) * w.grip * (c, c, 1.0) for w in wheels]
        length = float(np.mean([abs(row[2]) for row in rows]))
        slots = {
            slot: wheel.joint
            for slot, (aside, turning) in SLOTS.items()
            for wheel, row in zip(wheels, rows, strict=True)
            if np.allclose(row, (1.0, aside, turning * length), rtol=SAME, atol=SAME)
        }
        if len(set(slots.values())) == 4 and length > SAME:
            names = {f"{slot}_wheel_command_joint_name": joint for slot, joint in slots.items()}
            frame = {"x": 0.0, "y": 0.0, "theta": theta}
            lengths = {"wheels_radius": radius, "sum_of_robot_center_projection_on_X_Y_axis": length}
            return names | {"kinematics": {"base_frame_offset": frame} | lengths}
    backward = [w for w in wheels if w.sign < 0.0]
    if 0 < len(backward) < 4:
        raise refusal(wheels, "its wheels all run ahead at positive rates, or all back", backward)
    raise refusal(wheels, "its rollers lie at 45 degrees across the diagonals of a rectangle")


def omni(base: Base, wheels: list[Wheel]) -> dict[str, Any]:
    """Parameters of `omni_wheel_drive_controller`: wheels evenly around a circle, all turning the base to the right.

    Raises:
        ConfigError: They stand otherwise, or some turn it to the left.
    """
    radius = one_radius(wheels)
    rows = {w.joint: radius * (w.sign / w.radius) * w.grip for w in wheels}
    if others := [w for w in wheels if rows[w.joint][2] > 0.0]:
        raise refusal(wheels, "a positive rate of any of its wheels turns the base to the right", others)
    angles = {name: atan2(float(row[0]), -float(row[1])) for name, row in rows.items()}
    names = sorted(angles, key=lambda name: angles[name])
    reach = -float(np.mean([row[2] for row in rows.values()]))
    for i, name in enumerate(names):
        t = angles[names[0]] + 2 * math.pi * i / len(names)
        if not np.allclose(rows[name], omni_row(t, reach), rtol=SAME, atol=SAME):
            raise refusal(wheels, "its wheels stand evenly around a circle, their axles through its middle")
    return {
        "wheel_names": names, "wheel_offset": angles[names[0]], "robot_radius": reach, "wheel_radius": radius,
    }  # fmt: skip


def omni_row(t: float, reach: float) -> Array:
    """(3,) rim speed of an omni wheel at an angle [rad], `reach` from the middle [m], by `(vx, vy, w)`."""
    c, s = cos_sin(t)
    return np.array([s, -c, -reach])


def steering(base: Base, wheels: list[Wheel]) -> dict[str, Any]:
    """Parameters of the steering controllers, whose names are others in every release.

    Raises:
        ConfigError: Always.
    """
    why = "the names of their parameters are others in every release"
    raise ConfigError("parameters of steering controllers are not written", why=why, fix="write its YAML by hand")


def one_radius(wheels: list[Wheel]) -> float:
    """The radius of all wheels [m].

    Raises:
        ConfigError: They have several.
    """
    if not all(math.isclose(wheel.radius, wheels[0].radius, rel_tol=SAME) for wheel in wheels):
        raise refusal(wheels, f"it has one radius for all wheels, not {sizes(wheels)}")
    return float(np.mean([wheel.radius for wheel in wheels]))


def sizes(wheels: list[Wheel]) -> str:
    """Wheels with their radii."""
    return ", ".join(f"{wheel.joint} {wheel.radius:.4g} m" for wheel in wheels)


def refusal(wheels: list[Wheel], why: str, turned: list[Wheel] | None = None) -> ConfigError:
    """The error for wheels that a driver's formula does not roll.

    Args:
        wheels: All of them.
        why: What the driver takes.
        turned: Those whose axis points the other way.
    """
    fix = ONE_BY_ONE.format(", ".join(quoted(wheel.joint) for wheel in wheels))
    if turned:
        joints = ", ".join(wheel.joint for wheel in turned)
        fix = f"turn the <axis> of {joints} in the URDF and its motor's sign with it, or {fix}"
    return ConfigError("no parameters roll these wheels", why=why, fix=fix)


DIFF_DRIVE = Driver("diff_drive_controller/DiffDriveController", "cmd_vel", "odom", "cmd_vel_timeout", diff_drive)
MECANUM = Driver(
    "mecanum_drive_controller/MecanumDriveController", "reference", "odometry", "reference_timeout", mecanum
)
OMNI = Driver("omni_wheel_drive_controller/OmniWheelDriveController", "cmd_vel", "odom", "cmd_vel_timeout", omni)
ACKERMANN = Driver(
    "ackermann_steering_controller/AckermannSteeringController", "reference", "odometry", "reference_timeout", steering
)
TRICYCLE = Driver(
    "tricycle_steering_controller/TricycleSteeringController", "reference", "odometry", "reference_timeout", steering
)
