"""Messages on the wire: byte for byte as `rosbags` encodes them, types and hashes as ROS 2 has them."""

from __future__ import annotations

from typing import Any, get_type_hints

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="pip install 'mmnn_pin[ros2]'")
rosbags = pytest.importorskip("rosbags.typesys", reason="pip install rosbags")

from cyclonedds.idl import IdlStruct  # noqa: E402
from random_messages import made  # noqa: E402

from mmnn_pin.deploy.ros2 import messages as msg  # noqa: E402

STORE = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
POINT = "trajectory_msgs/msg/JointTrajectoryPoint"
FOLLOW = {
    "control_msgs/msg/JointTolerance": "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration",
    "control_msgs/msg/JointComponentTolerance": "string joint_name\nuint16 component\nfloat64 position\n"
    "float64 velocity\nfloat64 acceleration",
    f"{msg.FOLLOW}_Goal": "trajectory_msgs/JointTrajectory trajectory\n"
    "trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory\ncontrol_msgs/JointTolerance[] path_tolerance\n"
    "control_msgs/JointComponentTolerance[] component_path_tolerance\ncontrol_msgs/JointTolerance[] goal_tolerance\n"
    "control_msgs/JointComponentTolerance[] component_goal_tolerance\nbuiltin_interfaces/Duration goal_time_tolerance",
    f"{msg.FOLLOW}_Result": "int32 error_code\nstring error_string",
    f"{msg.FOLLOW}_Feedback": "std_msgs/Header header\nstring[] joint_names\n"
    "trajectory_msgs/JointTrajectoryPoint desired\ntrajectory_msgs/JointTrajectoryPoint actual\n"
    "trajectory_msgs/JointTrajectoryPoint error\nint32 index\nstring[] multi_dof_joint_names\n"
    "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired\n"
    "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual\n"
    "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error\nint32 multi_dof_index",
}
for name, text in FOLLOW.items():
    STORE.register(rosbags.get_types_from_msg(text, name))
KINDS = {
    msg.ros(kind): kind
    for kind in vars(msg).values()
    if isinstance(kind, type) and issubclass(kind, IdlStruct) and kind is not IdlStruct and msg.ros(kind) in STORE.types
}


def theirs(message: Any) -> Any:
    """The same message as `rosbags` has it."""
    if isinstance(message, IdlStruct):
        kind = STORE.types[msg.ros(type(message))]
        hints = get_type_hints(type(message), include_extras=True)
        values = {name: theirs(getattr(message, name)) for name in hints}
        for name, given in hints.items():
            element, shift, _ = msg.taken_apart(given)
            word = getattr(element, "__metadata__", ("",))[0]
            if shift and word:
                values[name] = np.array(values[name], np.uint8 if word == "byte" else word)
        return kind(**values)
    return [theirs(one) for one in message] if isinstance(message, list) else message


@pytest.mark.parametrize("name", sorted(KINDS))
def test_bytes_are_those_of_another_encoder(name: str) -> None:
    rng = np.random.default_rng(7)
    for _ in range(40):
        message = made(KINDS[name], rng)
        ours = message.serialize(use_version_2=False)
        assert ours == bytes(STORE.serialize_cdr(theirs(message), name))
        assert KINDS[name].deserialize(ours).serialize(use_version_2=False) == ours


@pytest.mark.parametrize("name", sorted(KINDS))
def test_hashes_are_those_of_another_implementation(name: str) -> None:
    assert msg.type_hash(KINDS[name]) == STORE.hash_rihs01(name)


def test_the_types_that_the_node_speaks_are_among_them() -> None:
    spoken = "JointState Odometry Twist TwistStamped JointTrajectory Path TFMessage Float64MultiArray DiagnosticArray"
    assert {*spoken.split(), "Clock", "GoalStatusArray"} <= {name.rpartition("/")[2] for name in KINDS}
    assert KINDS["sensor_msgs/msg/JointState"].__idl_typename__ == "sensor_msgs::msg::dds_::JointState_"


def test_older_clients_read_our_feedback() -> None:
    """control_msgs before 6 has no indices; the bytes read the same where nothing has several degrees of freedom."""
    old = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
    for name, text in FOLLOW.items():
        text = "\n".join(line for line in text.splitlines() if not line.endswith("index"))
        old.register(rosbags.get_types_from_msg(text, name))
    none = msg.MultiDOFJointTrajectoryPoint([], [], [], msg.Duration())
    points = [msg.JointTrajectoryPoint([0.1 * i, -2.0], [0.5, i + 0.0], [], [], msg.Duration()) for i in range(3)]
    ours = msg.FollowFeedback(msg.Header(msg.Time(3, 4), "x"), ["a", "bc"], *points, 0, [], none, none, none, 0)
    whole = ours.serialize(use_version_2=False)[:-8]  # what Fast DDS leaves unread, and rosbags refuses
    read = old.deserialize_cdr(whole, f"{msg.FOLLOW}_Feedback")
    assert read.joint_names == ["a", "bc"] and read.error.positions.tolist() == [0.2, -2.0]
    assert read.multi_dof_joint_names == [] and len(read.multi_dof_error.transforms) == 0
