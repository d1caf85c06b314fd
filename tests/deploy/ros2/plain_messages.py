"""Messages of ROS 2 as plain records with the same fields, for what reads them without rclpy.

`python plain_messages.py`, with rclpy, compares them with the real ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass
class Time:
    """Of `builtin_interfaces`."""

    sec: int = 0
    nanosec: int = 0


@dataclass
class Duration(Time):
    """Of `builtin_interfaces`."""


@dataclass
class Header:
    """Of `std_msgs`."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class Vector3:
    """Of `geometry_msgs`."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass
class Point(Vector3):
    """Of `geometry_msgs`."""


@dataclass
class Quaternion:
    """Of `geometry_msgs`."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


@dataclass
class Pose:
    """Of `geometry_msgs`."""

    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class PoseStamped:
    """Of `geometry_msgs`."""

    header: Header
    pose: Pose


@dataclass
class PoseWithCovariance:
    """Of `geometry_msgs`."""

    pose: Pose
    covariance: list[float]


@dataclass
class Twist:
    """Of `geometry_msgs`."""

    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass
class TwistWithCovariance:
    """Of `geometry_msgs`."""

    twist: Twist
    covariance: list[float]


@dataclass
class Transform:
    """Of `geometry_msgs`."""

    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@dataclass
class TransformStamped:
    """Of `geometry_msgs`."""

    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage:
    """Of `tf2_msgs`."""

    transforms: list[TransformStamped]


@dataclass
class Clock:
    """Of `rosgraph_msgs`."""

    clock: Time


@dataclass
class JointState:
    """Of `sensor_msgs`."""

    header: Header
    name: list[str]
    position: list[float]
    velocity: list[float]
    effort: list[float]


@dataclass
class Odometry:
    """Of `nav_msgs`."""

    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class Path:
    """Of `nav_msgs`."""

    header: Header
    poses: list[PoseStamped]


@dataclass
class JointTrajectoryPoint:
    """Of `trajectory_msgs`."""

    positions: list[float]
    velocities: list[float] = field(default_factory=list)
    accelerations: list[float] = field(default_factory=list)
    effort: list[float] = field(default_factory=list)
    time_from_start: Duration = field(default_factory=Duration)


@dataclass
class JointTrajectory:
    """Of `trajectory_msgs`."""

    header: Header
    joint_names: list[str]
    points: list[JointTrajectoryPoint]


@dataclass
class MultiDOFJointTrajectoryPoint:
    """Of `trajectory_msgs`."""

    transforms: list[Transform]
    velocities: list[Twist] = field(default_factory=list)
    accelerations: list[Twist] = field(default_factory=list)
    time_from_start: Duration = field(default_factory=Duration)


@dataclass
class MultiDOFJointTrajectory:
    """Of `trajectory_msgs`."""

    header: Header
    joint_names: list[str]
    points: list[MultiDOFJointTrajectoryPoint]


@dataclass
class JointTolerance:
    """Of `control_msgs`."""

    name: str
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


@dataclass
class JointComponentTolerance:
    """Of `control_msgs`."""

    joint_name: str
    component: int
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


def differences() -> list[str]:
    """Messages whose real fields are others."""
    from importlib import import_module

    kinds: list[Any] = [kind for kind in globals().values() if hasattr(kind, "__dataclass_fields__")]
    real = {kind: getattr(import_module(f"{kind.__doc__.split('`')[1]}.msg"), kind.__name__) for kind in kinds}
    return [
        kind.__name__
        for kind, other in real.items()
        if list(kind.__dataclass_fields__) != list(other.get_fields_and_field_types())
    ]


if __name__ == "__main__":
    print(differences())
