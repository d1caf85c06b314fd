"""Motions in bags: joint states, odometry and a reference pose, read by rosbags without ROS (extra `identify`).

Messages are read as ROS defines their types. A bag's own definitions are not: rosbags makes programs of them.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

import numpy as np

from ...elementary.arrays import unwrapped
from ...errors import InputError, RecordingError
from ...files import DENSEST, ROOM, opened
from ...model.robot import Robot
from ...signals import Array
from .log import Columns, Log, from_signals, is_angle

JOINTS, ODOMETRY = "sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry"
POSES = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")
AGAIN = "record it again, or export CSV"
PART = 1 << 20  # bytes that are unpacked at once
ONE_AT_A_TIME = threading.Lock()  # who has put something in the place of functions of rosbags
TRANSFORMED = "geometry_msgs/msg/TransformStamped"
READ = {JOINTS, ODOMETRY, *POSES, TRANSFORMED}


def read_bag(path: Path, robot: Robot, columns: Columns) -> Log:
    """The motion of a bag: what its joint states say, its odometry, and a reference pose.

    Joints of one topic may come in messages of their own; those that are not of the fullest kind are interpolated.

    Raises:
        RecordingError: rosbags is not there, the bag cannot be read, or has no joint states of the robot.
    """
    names = {columns.get(f"joint.{joint}", joint): joint for joint in robot.full_velocity_names}
    with reader(path) as bag:
        topics: dict[str, list[str]] = {}
        for connection in bag.connections:
            topics.setdefault(connection.msgtype, []).append(connection.topic)
        wanted = {
            "joints": one_topic(path, topics, (JOINTS,), "joints", columns),
            "odometry": one_topic(path, topics, (ODOMETRY,), "odometry", columns),
            "reference": one_topic(path, topics, (*POSES, TRANSFORMED, ODOMETRY), "reference", columns),
        }
        if not wanted["joints"]:
            there = ", ".join(f"{topic} ({kind})" for kind, some in topics.items() for topic in some) or "nothing"
            fix = "record sensor_msgs/JointState"
            raise RecordingError("a bag without joint states", why=f"it has {there}", fix=fix, file=path)
        series = collected(bag, {topic: kind for kind, topic in wanted.items() if topic}, names, path)
    return merged(str(path), series, wanted["joints"], path, robot)


@contextmanager
def bounded(most: int) -> Iterator[None]:
    """Have rosbags unpack at most so many bytes in all: a kilobyte may be a gigabyte, wherever in a bag it lies.

    The functions by which it unpacks chunks, messages and files count what comes out, and raise `ValueError`.
    """
    from rosbags.rosbag1 import reader as first
    from rosbags.rosbag2 import reader as second
    from rosbags.rosbag2 import storage_mcap

    left = most

    def counted(part: bytes) -> bytes:
        nonlocal left
        left -= len(part)
        if left < 0:
            raise ValueError(f"it unpacks to more than {most:,} bytes")
        return part

    def whole(form: str) -> Callable[..., bytes]:
        def unpacked(data: bytes, _: int = 0) -> bytes:
            with decoder(form).open(BytesIO(data), "rb") as file:
                return b"".join(iter(lambda: counted(file.read(PART)), b""))

        return unpacked

    @contextmanager
    def in_parts(packed: BinaryIO, mode: str) -> Iterator[Any]:
        with decoder("zstd").open(packed, mode) as file:
            yield SimpleNamespace(read=lambda size: counted(file.read(size)))

    of = {form: whole(form) for form in ("bz2", "lz4", "zstd")}
    places: list[tuple[dict[str, Any], dict[str, Any]]] = [
        (first.decompressors, {form: of[form] for form in ("bz2", "lz4")}),
        (storage_mcap.DECOMPRESSORS, {form: of[form] for form in ("lz4", "zstd")}),
        (vars(second), {"zstd": SimpleNamespace(open=in_parts, decompress=of["zstd"])}),
    ]
    with ONE_AT_A_TIME:
        before = [(place, {name: place[name] for name in ours}) for place, ours in places]
        try:
            for place, ours in places:
                place.update(ours)
            yield
        finally:
            for place, theirs in before:
                place.update(theirs)


def decoder(form: str) -> Any:
    """The module that unpacks `bz2`, `lz4` or `zstd`, as rosbags brings them."""
    zstd = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
    return import_module({"lz4": "lz4.frame", "zstd": zstd}.get(form, form))


@contextmanager
def reader(path: Path) -> Iterator[Any]:
    """A bag, open: `connections`, `messages` as rosbags has them, and `deserialize(data, type)`.

    Raises:
        RecordingError: rosbags is not there, or the bag cannot be read.
    """
    try:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        fix = "pip install 'mmnn_pin[identify]'"
        raise RecordingError("bags need rosbags", why=f"no {error.name}", fix=fix, file=path) from None
    try:
        size = 0
        for file in path.iterdir() if path.is_dir() else [path]:
            with opened(file):  # nothing but plain files
                size += file.stat().st_size
        is_first = path.suffix == ".bag"
        types = get_typestore(Stores.ROS1_NOETIC if is_first else Stores.ROS2_HUMBLE)
        deserialize = types.deserialize_ros1 if is_first else types.deserialize_cdr
        hash_of = (lambda name: types.generate_msgdef(name)[1]) if is_first else types.hash_rihs01
        with bounded(DENSEST * size + ROOM), (rosbag1 if is_first else rosbag2).Reader(path) as bag:
            for one in bag.connections:
                if one.msgtype in READ and one.digest and one.digest != hash_of(one.msgtype):
                    raise ValueError(f"its {one.msgtype} is another than that of ROS")
            yield SimpleNamespace(connections=bag.connections, messages=bag.messages, deserialize=deserialize)
    except InputError:
        raise
    except Exception as error:  # rosbags, sqlite and the decoders each have their own
        why = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError("the bag cannot be read", why=why, fix=AGAIN, file=path) from None


def one_topic(path: Path, topics: dict[str, list[str]], kinds: tuple[str, ...], what: str, columns: Columns) -> str:
    """The topic to read, as the user says or the only one of its kind; empty for none.

    Raises:
        RecordingError: The topic named is not there, or there are several.
    """
    there = sorted({topic for kind in kinds for topic in topics.get(kind, [])})
    if named := columns.get(f"topic.{what}"):
        if named not in there:
            fix = f"there is: {', '.join(there) or 'none of that kind'}"
            raise RecordingError(f"no topic '{named}' for {what}", fix=fix, file=path, key=f"topic.{what}")
        return named
    if what == "reference":
        there = sorted({topic for kind in (*POSES, TRANSFORMED) for topic in topics.get(kind, [])})
    if len(there) > 1 and what == "joints":
        fix = f"choose with --columns topic.{what}={there[0]}"
        raise RecordingError(f"several topics for {what}: {', '.join(there)}", fix=fix, file=path)
    return there[0] if len(there) == 1 else ""


def collected(
    bag: Any, topics: dict[str, str], names: dict[str, str], path: Path
) -> dict[str, list[tuple[float, float]]]:
    """(time, value) of every signal of some topics, topic to `joints`, `odometry` or `reference`."""
    series: dict[str, list[tuple[float, float]]] = {}

    def add(signal: str, time: float, value: float) -> None:
        series.setdefault(signal, []).append((time, value))

    first = None
    for connection, received, raw in bag.messages([c for c in bag.connections if c.topic in topics]):
        message = bag.deserialize(raw, connection.msgtype)
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        stamped = stamp or received
        first = stamped if first is None else first
        time, kind = (stamped - first) * 1e-9, topics[connection.topic]  # of integers: a double has no ns since 1970
        if kind == "joints":
            add_joints(add, time, message, names, path)
        elif kind == "odometry" and hasattr(message, "twist"):
            linear, w = message.twist.twist.linear, message.twist.twist.angular.z
            for signal, value in (("v", linear.x), ("vx", linear.x), ("vy", linear.y), ("w", w)):
                add(f"base.{signal}", time, float(value))
            add_pose(add, "base", time, message.pose.pose.position, message.pose.pose.orientation)
        else:
            where = message.transform if hasattr(message, "transform") else message.pose
            where = where.pose if hasattr(where, "pose") else where
            point = where.translation if hasattr(where, "translation") else where.position
            add_pose(add, "reference", time, point, where.rotation if hasattr(where, "rotation") else where.orientation)
    return series


def add_joints(add: Any, time: float, message: Any, names: dict[str, str], path: Path) -> None:
    """Add what a `JointState` says of the joints that have a name here.

    Raises:
        RecordingError: More or fewer numbers than joints.
    """
    for signal in ("position", "velocity", "effort"):
        values = getattr(message, signal)
        if len(values) not in (0, len(message.name)):
            what = f"{len(values)} numbers of {signal} for {len(message.name)} joints at t = {time:.6g} s"
            raise RecordingError(what, fix="record it again", file=path)
        for name, value in zip(message.name, values, strict=False):
            if name in names:
                add(f"{signal}.{names[name]}", time, float(value))


def add_pose(add: Any, kind: str, time: float, at: Any, turned: Any) -> None:
    """Add x, y and the heading of a pose in space."""
    heading = np.arctan2(2 * (turned.w * turned.z + turned.x * turned.y), 1 - 2 * (turned.y**2 + turned.z**2))
    for signal, value in (("x", at.x), ("y", at.y), ("phi", heading)):
        add(f"{kind}.{signal}", time, float(value))


def merged(name: str, series: dict[str, list[tuple[float, float]]], topic: str, path: Path, robot: Robot) -> Log:
    """The series at the times of the positions that came most often.

    Raises:
        RecordingError: No positions of the robot's joints.
    """
    tables = {signal: np.array(pairs) for signal, pairs in series.items()}
    positions = {signal: table for signal, table in tables.items() if signal.startswith("position.")}
    if not positions:
        fix = "name the robot that was recorded, or map joints with --columns joint.OURS=THEIRS"
        raise RecordingError(f"no joint of the robot in {topic}", fix=fix, file=path)
    time = max(positions.values(), key=len)[:, 0]
    others = [signal for signal, table in tables.items() if not np.array_equal(table[:, 0], time)]
    signals = {signal: at_times(time, table, is_angle(signal, robot)) for signal, table in tables.items()}
    log = from_signals(name, {"time": time, **signals})
    joints = sorted({signal.partition(".")[2] for signal in others if signal.startswith(("position", "effort"))})
    note = (f"{', '.join(joints)}: in messages of their own, interpolated",) if joints else ()
    return log.with_signals(log.signals, None, *note)


def at_times(time: Array, table: Array, angle: bool) -> Array:
    """A series (k, 2) at other times; angles are unwrapped first."""
    values = unwrapped(table[:, 1]) if angle else table[:, 1]
    return values if np.array_equal(table[:, 0], time) else np.interp(time, table[:, 0], values)
