"""A recording as MCAP, in the messages of ROS 2, for Foxglove, PlotJuggler, Rerun and `ros2 bag`.

CDR with ros2msg definitions is the one encoding whose joint states, transforms and odometry all of these read: joint
states and odometry have no counterpart in Foxglove's own JSON schemas, and PlotJuggler's parsers are those of ROS.

    /joint_states, /tf, /tf_static, /robot_description     where the robot truly was
    /odom                                                  what the sensors say of the base
    /joint_states_reference, /odom_reference               what was asked for
    /signals/NAME                                          every signal, a number per column

Time is the run's own and starts at 0; of a run of the ROS 2 node it is that of ROS 2. Config, URDF and facts are
attached.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2.writer import Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from ...errors import RecordingError
from ...model.robot import Robot
from ...model.urdf.document import Document, Joint
from ...model.urdf.reading import parse
from ...recording.recording import Recording, as_columns, recorded_position, recorded_robot
from ...signals import Array
from .curves import column_units


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame in its parent's."""

    parent: str  # name of the parent frame
    name: str  # name of the frame
    translation: Array  # (N, 3) [m], or (1, 3) for one that stands still
    rotation: Array  # (N, 4) or (1, 4) quaternion x, y, z, w

    @property
    def moves(self) -> bool:
        """Whether it is not the same at every sample."""
        return len(self.translation) > 1


def frames_of(recording: Recording, robot: Robot) -> list[Frame]:
    """All frames of a robot in a run, parents first; where the robot truly was, if the recording knows."""
    document = parse(robot.urdf.encode(), robot.path)
    position = dict(zip(robot.position_names, recorded_position(recording, robot).T, strict=True))
    base = base_frames(document, robot, position) if robot.dimensions.pose else []
    joints = (joint_frame(joint, position.get(joint.name)) for joint in document.joints.values())
    return [*base, *joints]


def world_names(document: Document) -> tuple[str, str]:
    """Names of the world's and of the base's control frame that no link has: with underscores as needed."""
    links = {document.root_link, *(joint.child for joint in document.joints.values())}
    world, control = (
        next(name for k in itertools.count() if (name := stem + "_" * k) not in links)
        for stem in ("world", "control_frame")
    )
    return world, control


def base_frames(document: Document, robot: Robot, position: dict[str, Array]) -> list[Frame]:
    """The control frame in the world, and the root link in the control frame."""
    world, control = world_names(document)
    x, y, phi = (position[name] for name in ("x", "y", "phi"))
    turn = np.stack([0 * phi, 0 * phi, np.sin(phi / 2), np.cos(phi / 2)], axis=1)
    moving = Frame(world, control, np.stack([x, y, 0 * x], axis=1), turn)
    heading = Rotation.from_rotvec([[0.0, 0.0, -robot.frame[2]]])
    root = heading.apply(-np.array([[robot.frame[0], robot.frame[1], robot.base.floor]]))
    return [moving, Frame(control, document.root_link, root, heading.as_quat())]


def joint_frame(joint: Joint, position: Array | None) -> Frame:
    """The link that a joint carries, at its positions (N,); None or a joint that stays where it is stands still.

    Where a position is not finite, the frame is NaN.
    """
    values = np.zeros(1) if position is None else position
    values = values[:1] if len(values) and np.all(values == values[0]) else values
    known = np.isfinite(values)
    along = np.where(known, values, 0.0)[:, None] * joint.axis
    placed, origin = Rotation.from_matrix(joint.origin[:3, :3]), joint.origin[:3, 3]
    slides = joint.type == "prismatic"
    translation = origin + slides * placed.apply(along)
    rotation = (placed * Rotation.from_rotvec(0.0 * along if slides else along)).as_quat()
    translation[~known] = rotation[~known] = np.nan
    return Frame(joint.parent, joint.child, translation, rotation)


STORE = get_typestore(Stores.ROS2_HUMBLE)


def definition(name: str) -> tuple[str, str]:
    """A message of ROS 2: its name, and its definition followed by those of all messages in it."""
    return name, STORE.generate_msgdef(name, ros_version=2)[0]


JOINT_STATE, ODOMETRY = definition("sensor_msgs/msg/JointState"), definition("nav_msgs/msg/Odometry")
TRANSFORMS, TEXT = definition("tf2_msgs/msg/TFMessage"), definition("std_msgs/msg/String")


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
        numbered = itertools.chain([name], (f"{name}_{number}" for number in itertools.count(2)))
        names.append(next(each for each in numbered if each not in names))
    return names


Message = dict[str, Any]
At = Callable[[int, Message], Message]  # of a row and its stamp
Topic = tuple[str, tuple[str, str], At]


def write_bag(recording: Recording, path: Path, about: dict[str, Any]) -> None:
    """Write a recording as MCAP, with what there is to know of it (`export.about`).

    Raises:
        RecordingError: It does not hold its robot, or begins before time 0.
    """
    if len(recording) and recording.time[0] < 0:
        why = f"it begins at {recording.time[0]:g} s, and a log has no times before 0"
        raise RecordingError("cannot be written as MCAP", why=why, fix="use another format", file=recording.path)
    robot = recorded_robot(recording)
    frames = frames_of(recording, robot)
    begin = round(1e9 * float(np.ravel(recording.final.get("began", 0.0))[0]))  # by ROS 2
    still = [transform(frame, 0, stamp(begin)) for frame in frames if not frame.moves]
    once = (("/robot_description", TEXT, {"data": recording.urdf}), ("/tf_static", TRANSFORMS, {"transforms": still}))
    nanoseconds = (begin + np.rint(1e9 * recording.time).astype(np.int64)).tolist()
    with path.open("wb") as file, Writer(file) as writer:
        for topic, schema, message in once:
            writer.write_message(topic, writer.register_msgdef(*schema), message, begin)
        topics = [
            (name, writer.register_msgdef(*schema), at) for name, schema, at in topics_of(recording, robot, frames)
        ]
        for row, at in enumerate(nanoseconds):
            for name, registered, message_at in topics:
                writer.write_message(name, registered, message_at(row, stamp(at)), at, sequence=row)
        attach(writer, about)


def attach(writer: Writer, about: dict[str, Any]) -> None:
    """Add config, URDF and facts."""
    config, urdf = about["config"], about["urdf"]
    for name, kind, text in (("config.json", "application/json", config), ("robot.urdf", "application/xml", urdf)):
        if text:
            writer.add_attachment(0, 0, name, kind, text.encode())
    facts = {**about["meta"], **{f"outcome_{name}": value for name, value in about["outcome"].items()}}
    writer.add_metadata("mmnn_pin", {k: v if isinstance(v, str) else json.dumps(v) for k, v in facts.items()})


def topics_of(recording: Recording, robot: Robot, frames: Sequence[Frame]) -> Iterator[Topic]:
    """The topics of every row: name, message type, and the message of a row at its stamp."""
    moving = [frame for frame in frames if frame.moves]
    yield ("/tf", TRANSFORMS, lambda row, at: {"transforms": [transform(frame, row, at) for frame in moving]})
    yield "/joint_states", JOINT_STATE, joint_states(recording, robot)
    if "q_ref" in recording:
        labels = list(recording.labels("q_ref"))
        wanted = {"position": as_columns(recording["q_ref"]), "velocity": as_columns(recording["qdot_ref"])}
        yield "/joint_states_reference", JOINT_STATE, partial(joint_state, labels, wanted)
    if "pose" in recording:
        names = frames[0].parent, frames[0].name
        for topic, suffix in (("/odom", ""), ("/odom_reference", "_ref")):
            velocity = as_columns(recording[f"velocity{suffix}"])
            if velocity.shape[1] != 3:  # a differential drive has no vy
                velocity = np.insert(velocity, 1, 0.0, axis=1)
            child = f"{names[1]}_reference" if suffix else names[1]
            yield (topic, ODOMETRY, partial(odometry, (names[0], child), recording[f"pose{suffix}"], velocity))
    for signal in recording.names[1:]:  # all but the time
        fields, table = field_names(recording.labels(signal)), as_columns(recording[signal])
        schema = signal_message(signal, fields, column_units(recording, signal))
        yield f"/signals/{signal}", schema, partial(numbers, fields, table)


def joint_states(recording: Recording, robot: Robot) -> At:
    """All joints: positions, rates, and the torques of those with a motor (NaN for the others).

    The rates of joints that nu does not hold are central differences of their positions.
    """
    root = len(recording.labels("pose")) if "pose" in recording else 0
    names, table = list(robot.position_names[root:]), recorded_position(recording, robot)[:, root:]
    rates = np.gradient(table, recording.time, axis=0) if len(table) > 1 else np.zeros_like(table)
    torques = np.full(table.shape, np.nan)
    known = "nu" if "nu" in recording else "qdot"
    for target, signal in ((rates, known), (torques, "motor_torque")):
        if signal not in recording:
            continue
        for label, values in zip(recording.labels(signal), as_columns(recording[signal]).T, strict=True):
            if label in names:
                target[:, names.index(label)] = values
    return partial(joint_state, names, {"position": table, "velocity": rates, "effort": torques})


def joint_state(names: list[str], tables: Mapping[str, Array], row: int, at: Message) -> Message:
    """A `sensor_msgs/JointState`."""
    known = {key: table[row].tolist() for key, table in tables.items()}
    return {"header": {"stamp": at, "frame_id": ""}, "name": names, "velocity": [], "effort": [], **known}


def odometry(frames: tuple[str, str], pose: Array, velocity: Array, row: int, at: Message) -> Message:
    """A `nav_msgs/Odometry`: pose of the second frame in the first, velocity in the second; covariances unknown."""
    x, y, phi = pose[row].tolist()
    vx, vy, w = velocity[row].tolist()
    placed = {"position": xyzw(x, y, 0.0), "orientation": xyzw(0.0, 0.0, np.sin(phi / 2), np.cos(phi / 2))}
    unknown = [0.0] * 36
    return {
        "header": {"stamp": at, "frame_id": frames[0]},
        "child_frame_id": frames[1],
        "pose": {"pose": placed, "covariance": unknown},
        "twist": {"twist": {"linear": xyzw(vx, vy, 0.0), "angular": xyzw(0.0, 0.0, w)}, "covariance": unknown},
    }


def transform(frame: Frame, row: int, at: Message) -> Message:
    """A `geometry_msgs/TransformStamped`."""
    placed = {"translation": xyzw(*frame.translation[row].tolist()), "rotation": xyzw(*frame.rotation[row].tolist())}
    return {"header": {"stamp": at, "frame_id": frame.parent}, "child_frame_id": frame.name, "transform": placed}


def numbers(fields: Sequence[str], table: Array, row: int, at: Message) -> Message:
    """One number per field."""
    return dict(zip(fields, table[row].tolist(), strict=True))


def stamp(nanoseconds: int) -> Message:
    """A `builtin_interfaces/Time`."""
    return dict(zip(("sec", "nanosec"), divmod(nanoseconds, 1_000_000_000), strict=True))


def xyzw(*numbers: float) -> Message:
    """A `geometry_msgs/Vector3` or `Point` of three numbers, a `Quaternion` of four."""
    return dict(zip("xyzw", numbers, strict=False))
