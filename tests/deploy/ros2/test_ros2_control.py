"""The YAML for ros2_control, against what its controllers declare.

Facts are those of the repositories ros-controls/ros2_controllers, branches jazzy (ed360c97), kilted (0f8eb14e) and
master (94e74de, 6.9.0), and ros-controls/ros2_control (9ffbf97f, cbe7d2c3): names and types of parameters in
`*/src/*_parameter*.yaml`, classes in `*_plugin*.xml`, topics in the controllers' sources. They agree, but that master
has no `publish_rate` (it always publishes) and no group controllers of one interface any more.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

yaml = pytest.importorskip("yaml", reason="pip install pyyaml")

from places import ROOT  # noqa: E402

from mmnn_pin import load  # noqa: E402
from mmnn_pin.deploy.ros2.example import commands_of, write_package  # noqa: E402
from mmnn_pin.deploy.ros2.settings import Joints, Node, Output  # noqa: E402
from mmnn_pin.deploy.ros2.wiring import controllers, odometry_topic, topic_of  # noqa: E402
from mmnn_pin.errors import ConfigError  # noqa: E402

MANAGER = {"update_rate": int}
STRINGS, NUMBERS = list[str], list[float]
DIFF_DRIVE = {
    "left_wheel_names": STRINGS, "right_wheel_names": STRINGS, "wheel_separation": float, "wheel_radius": float,
    "wheel_separation_multiplier": float, "left_wheel_radius_multiplier": float, "right_wheel_radius_multiplier": float,
    "tf_frame_prefix_enable": bool, "tf_frame_prefix": str, "odom_frame_id": str, "base_frame_id": str,
    "pose_covariance_diagonal": NUMBERS, "twist_covariance_diagonal": NUMBERS, "open_loop": bool,
    "position_feedback": bool, "enable_odom_tf": bool, "cmd_vel_timeout": float, "publish_limited_velocity": bool,
    "velocity_rolling_window_size": int, "publish_rate": float,
}  # fmt: skip
MECANUM = {
    **{f"{end}_{side}_wheel_command_joint_name": str for end in ("front", "rear") for side in ("left", "right")},
    "reference_timeout": float, "kinematics": dict, "odom_frame_id": str, "base_frame_id": str,
}  # fmt: skip
OMNI = {
    "wheel_names": STRINGS, "wheel_offset": float, "robot_radius": float, "wheel_radius": float,
    "cmd_vel_timeout": float, "odom_frame_id": str, "base_frame_id": str,
}  # fmt: skip
GROUP = {"joints": STRINGS, "interface_name": str}
TRAJECTORY = {"joints": STRINGS, "command_joints": STRINGS, "command_interfaces": STRINGS, "state_interfaces": STRINGS}
STATES = {"use_local_topics": bool, "joints": STRINGS, "extra_joints": STRINGS, "interfaces": STRINGS, "frame_id": str}
CLASSES: dict[str, tuple[dict[str, Any], str]] = {  # their parameters, and the topic that they take
    "joint_state_broadcaster/JointStateBroadcaster": (STATES, ""),
    "diff_drive_controller/DiffDriveController": (DIFF_DRIVE, "cmd_vel"),
    "mecanum_drive_controller/MecanumDriveController": (MECANUM, "reference"),
    "omni_wheel_drive_controller/OmniWheelDriveController": (OMNI, "cmd_vel"),
    "forward_command_controller/ForwardCommandController": (GROUP, "commands"),
    "joint_trajectory_controller/JointTrajectoryController": (TRAJECTORY, "joint_trajectory"),
}
COMMANDS = {
    "base": Output("TwistStamped"),
    "first": Output(joints=("shoulder",), interface="velocity"),
    "second": Output("JointTrajectory", joints=("arm_2_joint",), interface="position"),
}
NAMES = Joints(names=("arm_1_joint=shoulder",))


def is_a(value: Any, kind: Any) -> bool:
    """Whether YAML gives ROS 2 a parameter of a type: 1 is no double there, and an empty list has no type."""
    if kind in (STRINGS, NUMBERS):
        inner = str if kind == STRINGS else float
        return isinstance(value, list) and len(value) > 0 and all(type(one) is inner for one in value)
    return type(value) is kind


def judged(text: str) -> dict[str, Any]:
    """What a YAML tells ros2_control, every key and value held to what is declared; parameters by class."""
    whole, found = yaml.safe_load(text), {}
    manager = dict(whole.pop("controller_manager")["ros__parameters"])
    kinds = {name: manager.pop(name)["type"] for name in list(manager) if isinstance(manager[name], dict)}
    assert all(is_a(value, MANAGER[name]) for name, value in manager.items())
    for key, table in whole.items():
        kind = kinds.pop(key.rpartition("/")[2])
        given = table["ros__parameters"]
        for name, value in given.items():
            assert name in CLASSES[kind][0], f"{kind} has no parameter {name}"
            assert is_a(value, CLASSES[kind][0][name]), f"{kind}: {name}: {value!r}"
        found[kind] = given | {"key": key}
    assert set(kinds.values()) <= {"joint_state_broadcaster/JointStateBroadcaster"}  # it needs none
    return found | {"update_rate": manager["update_rate"]}


def test_the_example_gets_controllers_that_speak_on_its_topics(tmp_path: Path) -> None:
    """`diff_drive_controller` tells the odometry on `~/odom`: the node listens there."""
    robot = load("platform_arm")
    write_package(tmp_path / "example", robot, "platform_arm")
    found = judged((tmp_path / "example/config/controllers.yaml").read_text())
    drive = found["diff_drive_controller/DiffDriveController"]
    assert drive["wheel_separation"] == 0.342 and drive["wheel_radius"] == 0.075
    assert drive["left_wheel_names"] == ["wheel_left_joint"] and drive["base_frame_id"] == "base_footprint"
    assert drive["publish_rate"] == found["update_rate"] == 200 and drive["velocity_rolling_window_size"] == 1
    commands = commands_of(robot)
    settings = Node("platform_arm", commands)
    assert odometry_topic(robot, settings) == "diff_drive_controller/odom"
    topics = {topic_of(robot, name, output) for name, output in commands.items()}
    for kind, (_, topic) in CLASSES.items():
        if kind in found and topic:
            assert f"{found[kind]['key']}/{topic}" in topics


def test_names_and_every_interface() -> None:
    robot, settings = load("platform_arm"), Node("platform_arm", COMMANDS, joint_states=NAMES, rate=250.0)
    found = judged(controllers(robot, settings))
    assert found["diff_drive_controller/DiffDriveController"]["key"] == "base"
    group = found["forward_command_controller/ForwardCommandController"]
    assert group["joints"] == ["shoulder"] and group["interface_name"] == "velocity"
    trajectory = found["joint_trajectory_controller/JointTrajectoryController"]
    assert trajectory["command_interfaces"] == ["position"] and trajectory["key"] == "second"
    assert topic_of(robot, "second", COMMANDS["second"]) == "second/joint_trajectory"


def test_what_no_controller_takes_is_named() -> None:
    settings = Node("platform_arm", COMMANDS | {"base": Output("Twist")}, joint_states=NAMES)
    with pytest.raises(ConfigError, match=r"commands\.base\.type: error: no controller of ros2_controllers takes this"):
        controllers(load("platform_arm"), settings)


def test_the_page_shows_what_is_declared() -> None:
    page = (ROOT / "docs/how-to/ros2.md").read_text()
    blocks = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    assert blocks
    for block in blocks:
        assert len(judged(block)) > 2
