"""Messages of ROS 2 as DDS types: names, fields and type hashes as `rosidl` makes them.

A message `sensor_msgs/msg/JointState` is `sensor_msgs::msg::dds_::JointState_` on the wire, in plain CDR. From
Jazzy on a writer also tells the hash of its type (REP 2016): SHA-256 of its description as JSON.
"""

import hashlib
import json
import re
from dataclasses import dataclass
from typing import Any, get_type_hints

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, byte, float64, int8, int32, sequence, uint8, uint16, uint32

# Numbers of plain types in a description, of arrays and of sequences of them (type_description_interfaces/FieldType).
NESTED, ARRAY_OF, SEQUENCE_OF = 1, 48, 144
PLAIN = {"int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9}
PLAIN |= {"float32": 10, "float64": 11, "bool": 15, "byte": 16, "str": 17}


def dds(name: str) -> str:
    """The name on the wire of `package/msg/Name`."""
    return "{}::{}::dds_::{}_".format(*name.split("/"))


def ros(kind: type[Any]) -> str:
    """The name in ROS 2 of a type."""
    return str(kind.__idl_typename__).replace("::dds_::", "/").replace("::", "/").removesuffix("_")


@dataclass
class Time(IdlStruct, typename=dds("builtin_interfaces/msg/Time")):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Duration(IdlStruct, typename=dds("builtin_interfaces/msg/Duration")):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename=dds("std_msgs/msg/Header")):
    stamp: Time
    frame_id: str = ""


@dataclass
class MultiArrayDimension(IdlStruct, typename=dds("std_msgs/msg/MultiArrayDimension")):
    label: str
    size: uint32
    stride: uint32


@dataclass
class MultiArrayLayout(IdlStruct, typename=dds("std_msgs/msg/MultiArrayLayout")):
    dim: sequence[MultiArrayDimension]
    data_offset: uint32


@dataclass
class Float64MultiArray(IdlStruct, typename=dds("std_msgs/msg/Float64MultiArray")):
    layout: MultiArrayLayout
    data: sequence[float64]


@dataclass
class Vector3(IdlStruct, typename=dds("geometry_msgs/msg/Vector3")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Point(IdlStruct, typename=dds("geometry_msgs/msg/Point")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename=dds("geometry_msgs/msg/Quaternion")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Pose(IdlStruct, typename=dds("geometry_msgs/msg/Pose")):
    position: Point
    orientation: Quaternion


@dataclass
class PoseStamped(IdlStruct, typename=dds("geometry_msgs/msg/PoseStamped")):
    header: Header
    pose: Pose


@dataclass
class PoseWithCovariance(IdlStruct, typename=dds("geometry_msgs/msg/PoseWithCovariance")):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class Twist(IdlStruct, typename=dds("geometry_msgs/msg/Twist")):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistStamped(IdlStruct, typename=dds("geometry_msgs/msg/TwistStamped")):
    header: Header
    twist: Twist


@dataclass
class TwistWithCovariance(IdlStruct, typename=dds("geometry_msgs/msg/TwistWithCovariance")):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Transform(IdlStruct, typename=dds("geometry_msgs/msg/Transform")):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename=dds("geometry_msgs/msg/TransformStamped")):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename=dds("tf2_msgs/msg/TFMessage")):
    transforms: sequence[TransformStamped]


@dataclass
class Clock(IdlStruct, typename=dds("rosgraph_msgs/msg/Clock")):
    clock: Time


@dataclass
class JointState(IdlStruct, typename=dds("sensor_msgs/msg/JointState")):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class Odometry(IdlStruct, typename=dds("nav_msgs/msg/Odometry")):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class Path(IdlStruct, typename=dds("nav_msgs/msg/Path")):
    header: Header
    poses: sequence[PoseStamped]


@dataclass
class JointTrajectoryPoint(IdlStruct, typename=dds("trajectory_msgs/msg/JointTrajectoryPoint")):
    positions: sequence[float64]
    velocities: sequence[float64]
    accelerations: sequence[float64]
    effort: sequence[float64]
    time_from_start: Duration


@dataclass
class JointTrajectory(IdlStruct, typename=dds("trajectory_msgs/msg/JointTrajectory")):
    header: Header
    joint_names: sequence[str]
    points: sequence[JointTrajectoryPoint]


@dataclass
class MultiDOFJointTrajectoryPoint(IdlStruct, typename=dds("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint")):
    transforms: sequence[Transform]
    velocities: sequence[Twist]
    accelerations: sequence[Twist]
    time_from_start: Duration


@dataclass
class MultiDOFJointTrajectory(IdlStruct, typename=dds("trajectory_msgs/msg/MultiDOFJointTrajectory")):
    header: Header
    joint_names: sequence[str]
    points: sequence[MultiDOFJointTrajectoryPoint]


@dataclass
class KeyValue(IdlStruct, typename=dds("diagnostic_msgs/msg/KeyValue")):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename=dds("diagnostic_msgs/msg/DiagnosticStatus")):
    level: byte
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename=dds("diagnostic_msgs/msg/DiagnosticArray")):
    header: Header
    status: sequence[DiagnosticStatus]


# -- actions -----------------------------------------------------------------------------------------------------------


@dataclass
class UUID(IdlStruct, typename=dds("unique_identifier_msgs/msg/UUID")):
    uuid: array[uint8, 16]


@dataclass
class GoalInfo(IdlStruct, typename=dds("action_msgs/msg/GoalInfo")):
    goal_id: UUID
    stamp: Time


@dataclass
class GoalStatus(IdlStruct, typename=dds("action_msgs/msg/GoalStatus")):
    goal_info: GoalInfo
    status: int8


@dataclass
class GoalStatusArray(IdlStruct, typename=dds("action_msgs/msg/GoalStatusArray")):
    status_list: sequence[GoalStatus]


@dataclass
class CancelRequest(IdlStruct, typename=dds("action_msgs/srv/CancelGoal_Request")):
    goal_info: GoalInfo


@dataclass
class CancelResponse(IdlStruct, typename=dds("action_msgs/srv/CancelGoal_Response")):
    return_code: int8
    goals_canceling: sequence[GoalInfo]


@dataclass
class TriggerRequest(IdlStruct, typename=dds("std_srvs/srv/Trigger_Request")):
    structure_needs_at_least_one_member: uint8 = 0


@dataclass
class TriggerResponse(IdlStruct, typename=dds("std_srvs/srv/Trigger_Response")):
    success: bool
    message: str


@dataclass
class JointTolerance(IdlStruct, typename=dds("control_msgs/msg/JointTolerance")):
    name: str
    position: float64
    velocity: float64
    acceleration: float64


@dataclass
class JointComponentTolerance(IdlStruct, typename=dds("control_msgs/msg/JointComponentTolerance")):
    joint_name: str
    component: uint16
    position: float64
    velocity: float64
    acceleration: float64


FOLLOW = "control_msgs/action/FollowJointTrajectory"


@dataclass
class FollowGoal(IdlStruct, typename=dds(f"{FOLLOW}_Goal")):
    trajectory: JointTrajectory
    multi_dof_trajectory: MultiDOFJointTrajectory
    path_tolerance: sequence[JointTolerance]
    component_path_tolerance: sequence[JointComponentTolerance]
    goal_tolerance: sequence[JointTolerance]
    component_goal_tolerance: sequence[JointComponentTolerance]
    goal_time_tolerance: Duration


@dataclass
class FollowResult(IdlStruct, typename=dds(f"{FOLLOW}_Result")):
    error_code: int32 = 0
    error_string: str = ""


@dataclass
class FollowFeedback(IdlStruct, typename=dds(f"{FOLLOW}_Feedback")):
    """The layout of control_msgs 6.

    Older ones have neither index; as zeros, with nothing of several degrees of freedom, they read the same.
    """

    header: Header
    joint_names: sequence[str]
    desired: JointTrajectoryPoint
    actual: JointTrajectoryPoint
    error: JointTrajectoryPoint
    index: int32
    multi_dof_joint_names: sequence[str]
    multi_dof_desired: MultiDOFJointTrajectoryPoint
    multi_dof_actual: MultiDOFJointTrajectoryPoint
    multi_dof_error: MultiDOFJointTrajectoryPoint
    multi_dof_index: int32


@dataclass
class FollowSendRequest(IdlStruct, typename=dds(f"{FOLLOW}_SendGoal_Request")):
    goal_id: UUID
    goal: FollowGoal


@dataclass
class SendResponse(IdlStruct, typename=dds(f"{FOLLOW}_SendGoal_Response")):
    accepted: bool
    stamp: Time


@dataclass
class ResultRequest(IdlStruct, typename=dds(f"{FOLLOW}_GetResult_Request")):
    goal_id: UUID


@dataclass
class FollowResultResponse(IdlStruct, typename=dds(f"{FOLLOW}_GetResult_Response")):
    status: int8
    result: FollowResult


@dataclass
class FollowFeedbackMessage(IdlStruct, typename=dds(f"{FOLLOW}_FeedbackMessage")):
    goal_id: UUID
    feedback: FollowFeedback


# -- hashes ------------------------------------------------------------------------------------------------------------


def type_hash(kind: type[Any]) -> str:
    """The hash that ROS 2 gives a message type, `RIHS01_` and 64 hexadecimal digits."""
    used = {ros(other): description(other) for other in parts(kind)}
    whole = {
        "type_description": description(kind),
        "referenced_type_descriptions": [used[name] for name in sorted(used)],
    }
    return "RIHS01_" + hashlib.sha256(json.dumps(whole, separators=(", ", ": ")).encode()).hexdigest()


def parts(kind: type[Any]) -> set[type[Any]]:
    """All message types that a message type is made of, without itself."""
    own = {element for element, _, _ in map(taken_apart, get_type_hints(kind, include_extras=True).values())}
    own = {element for element in own if isinstance(element, type) and issubclass(element, IdlStruct)}
    return own.union(*map(parts, own))


def description(kind: type[Any]) -> dict[str, Any]:
    """A message type as REP 2016 describes it."""
    fields = []
    for name, given in get_type_hints(kind, include_extras=True).items():
        element, shift, capacity = taken_apart(given)
        nested = ros(element) if isinstance(element, type) and issubclass(element, IdlStruct) else ""
        word = getattr(element, "__metadata__", (getattr(element, "__name__", ""),))[0]
        number = (NESTED if nested else PLAIN[word]) + shift
        told = {"type_id": number, "capacity": capacity, "string_capacity": 0, "nested_type_name": nested}
        fields.append({"name": name, "type": told})
    return {"type_name": ros(kind), "fields": fields}


def taken_apart(given: Any) -> tuple[Any, int, int]:
    """What a field consists of, what that adds to its number, and the length of an array."""
    how = str(getattr(given, "__metadata__", ("",))[0])
    if not (found := re.match(r"(sequence|array)\[", how)):
        return given, 0, 0
    element = given.__metadata__[0].subtype
    return element, *((SEQUENCE_OF, 0) if found[1] == "sequence" else (ARRAY_OF, given.__metadata__[0].length))
