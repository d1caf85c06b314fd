"""The ROS 2 messages that Foxglove, PlotJuggler and rosbag2 know, as definitions, and messages for our own signals."""

from __future__ import annotations

import re
from collections.abc import Sequence

RULE = "\n" + "=" * 80 + "\n"
TIME = "int32 sec\nuint32 nanosec"
HEADER = "builtin_interfaces/Time stamp\nstring frame_id"
VECTOR = "float64 x\nfloat64 y\nfloat64 z"
QUATERNION = f"{VECTOR}\nfloat64 w"
PARTS = {
    "builtin_interfaces/Time": TIME,
    "std_msgs/Header": HEADER,
    "geometry_msgs/Vector3": VECTOR,
    "geometry_msgs/Point": VECTOR,
    "geometry_msgs/Quaternion": QUATERNION,
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
}


def definition(text: str) -> str:
    """A definition followed by those of all messages in it, as the files of rosbag2 have it."""
    found: list[str] = []
    pending = text
    while names := [name for name in PARTS if re.search(rf"\b{name}\b", pending) and name not in found]:
        found += names
        pending = "\n".join(PARTS[name] for name in names)
    return text + "".join(f"{RULE}MSG: {name}\n{PARTS[name]}" for name in found)


JOINT_STATE = (
    "sensor_msgs/msg/JointState",
    definition("std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"),
)
ODOMETRY = (
    "nav_msgs/msg/Odometry",
    definition(
        "std_msgs/Header header\nstring child_frame_id\n"
        "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist"
    ),
)
TRANSFORMS = "tf2_msgs/msg/TFMessage", definition("geometry_msgs/TransformStamped[] transforms")
TEXT = "std_msgs/msg/String", "string data"


def signal_message(signal: str, fields: Sequence[str], units: Sequence[str]) -> tuple[str, str]:
    """Name and definition of a message with one number per column of a signal, units as comments."""
    name = "".join(part.capitalize() for part in signal.split("_"))
    lines = [f"float64 {field}  # [{unit}]" for field, unit in zip(fields, units, strict=True)]
    return f"mmnn_pin/msg/{name}", "\n".join(lines)


def field_names(labels: Sequence[str]) -> list[str]:
    """Labels as names of ROS: small letters, digits and single underscores, each name once."""
    names: list[str] = []
    for label in labels:
        name = re.sub(r"[^a-z0-9]+", "_", label.lower()).strip("_")
        name = name if name[:1].isalpha() else f"joint_{name}".rstrip("_")
        same, number = name, 2
        while name in names:
            name, number = f"{same}_{number}", number + 1
        names.append(name)
    return names
