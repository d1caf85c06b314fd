"""The parameters: errors with their names, the package of `--example`, what `--check` and `--controllers` say."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import pytest
from graph import SETTINGS, of_ros, python_of, said
from places import ROOT
from robots import robot_of

yaml = pytest.importorskip("yaml", reason="pip install pyyaml")

from mmnn_pin import Stepper, load  # noqa: E402
from mmnn_pin.cli import main  # noqa: E402
from mmnn_pin.cli.ros2 import Making, asked  # noqa: E402
from mmnn_pin.deploy.ros2.example import parameters  # noqa: E402
from mmnn_pin.deploy.ros2.settings import Node, leaves, settings_of  # noqa: E402
from mmnn_pin.deploy.ros2.wiring import controllers, interfaces  # noqa: E402
from mmnn_pin.errors import ConfigError, InputError  # noqa: E402
from mmnn_pin.loop.latency import Latency  # noqa: E402
from mmnn_pin.safety import Safety  # noqa: E402

DOMAIN = 60


def table_of(text: str) -> dict[str, Any]:
    """Parameters by their full names, as ROS 2 reads a file."""
    return dict(leaves(yaml.safe_load(text)["/**"]["ros__parameters"]))


def read(text: str, **changes: Any) -> Node:
    """Settings of a file, with changes; a double underscore stands for a point."""
    return settings_of(table_of(text) | {name.replace("__", "."): value for name, value in changes.items()})


WRONG = {
    "rate": (1e5, "rate: error: 100000.0 /s: use 1 to 2000"),
    "thread_priority": (100, "thread_priority: error: 100: use 0 to 99"),
    "joint_states.ages": (0.3, "unknown parameter 'joint_states.ages': did you mean 'joint_states.age'?"),
    "joint_states.age": (-1.0, "joint_states.age: error: -1.0: use a number > 0"),
    "joint_states.names": (["elbow"], "joint_states.names: error: 'elbow': write \"urdf=theirs\""),
    "odometry.source": ("wheels", "odometry.source: error: "),
    "odometry.at": ([0.0, 0.0], "odometry.at: error: "),
    "limits.speed": (0.0, "limits.speed: error: 0.0: use a number > 0"),
    "commands.diff_drive_controller.type": ("Twisted", "commands.diff_drive_controller.type: error: "),
    "commands.effort_controller.joints": ([], "commands.effort_controller.joints: error: a Float64MultiArray with 0"),
    "controler": ("pd", "unknown parameter 'controler': did you mean 'controller'?"),
    "robot": ("", "robot: error: no robot: mmnn ros2 --example FOLDER --robot ROBOT"),
    "robot.name": ("x", "robot.name: error: 'robot' is a value and a table"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_named_by_its_parameter(name: str) -> None:
    value, told = WRONG[name]
    with pytest.raises(InputError) as error:
        settings_of(table_of(SETTINGS) | {name: value})
    assert told in str(error.value) and len(str(error.value).splitlines()) == 1


NOT_FITTING = {
    "commands.effort_controller.joints": (["arm_1_joint", "arm_3_joint"], "unknown joint 'arm_3_joint'"),
    "set.feedback.bass": (1.0, "set.feedback.bass: error: unknown key 'bass'"),
    "robot": ("nobody", "unknown robot 'nobody'"),
}


@pytest.mark.parametrize("name", NOT_FITTING)
def test_what_does_not_fit_the_robot_is_named_by_its_parameter(name: str) -> None:
    value, told = NOT_FITTING[name]
    with pytest.raises(InputError) as error:
        asked(settings_of(table_of(SETTINGS) | {name: value}))
    assert told in str(error.value)


@pytest.mark.parametrize("robot", ["platform_arm", "two_axis_arm"])
def test_the_example_fits_its_robot(robot: str) -> None:
    made = load(robot)
    settings = read(parameters(made, robot))
    found = interfaces(made, settings)
    assert set(found) == set(made.actuator_names) and settings.controller == "pd_gravity"
    assert {found[name] for name in made.joint_names} == {"effort"}


def test_the_example_is_a_package(tmp_path: Path, capsys: Any) -> None:
    folder = tmp_path / "my_robot_control"
    assert main(["ros2", "--example", str(folder), "--robot", "platform_arm"]) == 0
    files = {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}
    assert files == {
        "package.xml", "setup.py", "setup.cfg", "resource/my_robot_control", "my_robot_control/__init__.py",
        "launch/my_robot_control.launch.py", "config/mmnn.yaml", "config/controllers.yaml",
    }  # fmt: skip
    assert read((folder / "config/mmnn.yaml").read_text()).robot == "platform_arm"
    for file in ("setup.py", "launch/my_robot_control.launch.py"):
        compile((folder / file).read_text(), file, "exec")
    assert main(["ros2", "--example", str(folder)]) == 2  # it is there
    assert main(["ros2", "--example", str(tmp_path / "My-robot")]) == 2
    assert "'My-robot' is no name of a package" in capsys.readouterr().err


def test_the_example_takes_what_the_urdf_offers() -> None:
    """One joint without an effort, in the tags of ros2_control."""
    offers = {"arm_1_joint": ("effort", "position"), "arm_2_joint": ("position", "velocity")}
    joints = "".join(
        f'<joint name="{name}">' + "".join(f'<command_interface name="{one}"/>' for one in ones) + "</joint>"
        for name, ones in offers.items()
    )
    told = f'<ros2_control name="arm" type="system">{joints}</ros2_control></robot>'
    robot = robot_of(load("platform_arm").urdf.replace("</robot>", told))
    found = interfaces(robot, read(parameters(robot, "platform_arm")))
    assert found == dict.fromkeys(robot.actuator_names[:2], "velocity") | {
        "arm_1_joint": "effort",
        "arm_2_joint": "velocity",
    }


def test_every_motor_is_commanded_once() -> None:
    robot = load("platform_arm")
    with pytest.raises(InputError, match="arm_1_joint is commanded twice"):
        interfaces(robot, read(SETTINGS, commands__b__joints=["arm_1_joint"]))
    with pytest.raises(InputError, match="nothing commands arm_2_joint: add them to one of `commands`"):
        interfaces(robot, read(SETTINGS, commands__effort_controller__joints=["arm_1_joint"]))
    wheels = {"type": "Float64MultiArray", "joints": ["L", "wheel_right_joint"], "interface": "velocity"}
    changes = {f"commands.diff_drive_controller.{name}": value for name, value in wheels.items()}
    named = settings_of(table_of(SETTINGS) | changes | {"joint_states.names": ["wheel_left_joint=L"]})
    assert interfaces(robot, named)["wheel_left_joint"] == "velocity"


def test_gains_too_high_for_the_rate_are_refused_with_parameters_that_cure_it() -> None:
    wheels = {"type": "Float64MultiArray", "interface": "velocity"}
    text = SETTINGS.replace("rate: 100.0", "rate: 12.5").replace("K: 3.0", "K: 30.0")
    changes = {f"commands.effort_controller.{name}": value for name, value in wheels.items()}
    high = table_of(text) | changes
    with pytest.raises(ConfigError, match="too high for servos with a bandwidth of 30 1/s") as error:
        Making(1.0, None, False, keep=False).stepper(settings_of(high), 0)
    cure = {name: yaml.safe_load(value) for name, value in re.findall(r"`(\S+): (.*?)`", error.value.fix)}
    assert "set.kinematic.K" in cure
    with Making(1.0, None, False, keep=False).stepper(settings_of(high | cure), 0) as stepper:
        assert stepper.delay_margin() > 0.0


@pytest.mark.parametrize(
    ("said", "found"),
    [
        ({}, Latency(sensing=0.004, command=0.001, margin=0.007, predict=True)),
        ({"latency": 0.006}, Latency(sensing=0.006, margin=0.007, predict=True)),
        ({"latency": 0.006, "predict": False}, Latency(command=0.006, margin=0.007)),
        ({"predict": False}, Latency(sensing=0.004, command=0.001, margin=0.007)),
    ],
)
def test_an_experiments_latency_keeps_what_the_settings_do_not_say(said: dict[str, Any], found: Latency) -> None:
    own = {"sensing": 0.004, "command": 0.001, "margin": 0.007, "predict": True}
    given = table_of(SETTINGS) | {f"set.latency.{name}": value for name, value in own.items()} | {"latency": None}
    experiment, robot = asked(settings_of(given | said))
    assert experiment.latency == found
    with Stepper.of(experiment.loop(robot, "pd"), safety=Safety(torque="urdf")) as stepper:
        assert stepper.setup.known == found


STRANGE = ("]\n[set] # ", 'a"b', "yes", "{x}: [a, b]", "\u202ered\\", "\U0001f916", "a # b", "é")


@pytest.mark.parametrize("name", STRANGE)
def test_names_of_joints_are_names_in_the_files_that_are_written(name: str, tmp_path: Path) -> None:
    text = (ROOT / "urdf" / "platform_arm.urdf").read_text()
    attribute = quoteattr(name, {"\n": "&#10;", '"': "&quot;"})
    file = tmp_path / 'a"b.urdf'
    file.write_text(text.replace('"arm_1_joint"', attribute))
    settings = read(parameters(load(file), str(file)))
    assert settings.robot == str(file) and settings.commands["effort_controller"].joints == (name, "arm_2_joint")
    made = controllers(load(file), settings)
    nodes = [node["ros__parameters"] for node in yaml.safe_load(made).values()]
    (joints,) = (node["joints"] for node in nodes if "joints" in node)
    assert joints == [name, "arm_2_joint"] and made.replace("\n", "").isprintable()


# -- with rclpy --------------------------------------------------------------------------------------------------------


def test_check_says_every_topic_and_refuses_what_starting_does(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(SETTINGS)
    ros = ("--ros-args", "-r", "__ns:=/robot_1", "-r", "cmd_vel:=drive", "-p", "rate:=50")
    ros += ("-p", "qos_overrides./robot_1/joint_states.subscription.reliability:=reliable")
    ros += ("-p", "publish.odometry:=20.0")
    code, text = said("kilted", DOMAIN, file, "--check", "--json", *ros)
    rows = {row["name"]: row for row in json.loads(text.splitlines()[-1])["topics"]}
    assert code == 0
    assert {name: row["way"] for name, row in rows.items()} == {
        "/robot_1/joint_states": "subscribes", "/robot_1/diff_drive_controller/odom": "subscribes",
        "/tf": "subscribes", "/tf_static": "subscribes", "/robot_1/drive": "subscribes", "/robot_1/plan": "subscribes",
        "/robot_1/mmnn/joint_trajectory": "subscribes", "/robot_1/mmnn/follow_joint_trajectory": "serves",
        "/robot_1/mmnn/speed_scaling_input": "subscribes", "/robot_1/follow_path": "serves",
        "/robot_1/mmnn/controller_state": "publishes", "/robot_1/mmnn/odom": "publishes",
        "/robot_1/mmnn/stop": "serves", "/robot_1/mmnn/reset": "serves",
        "/robot_1/diff_drive_controller/cmd_vel": "publishes", "/robot_1/effort_controller/commands": "publishes",
        "/diagnostics": "publishes",
    }  # fmt: skip
    assert rows["/robot_1/joint_states"]["qos"] == "reliable, depth 4"
    assert rows["/robot_1/diff_drive_controller/odom"]["qos"] == "best_effort, depth 4"
    code, text = said("kilted", DOMAIN, file, "--check", "--ros-args", "-p", "set.feedback.arm:=400.0")
    assert code == 2 and "the sampled PD loop is unstable" in text
    file.write_text(SETTINGS.replace("scaling: inertia, base: 10.0, arm: 10.0", given_by(text)))
    code, text = said("kilted", DOMAIN, file, "--check")
    assert code == 0, text


def given_by(text: str) -> str:
    """The feedback that the fix in a message gives."""
    found = re.findall(r"`set\.feedback\.(\S+: .*?)`", text)
    assert len(found) == 3
    return ", ".join(found)


def test_arguments_that_are_none_are_one_line(tmp_path: Path) -> None:
    for arguments, told in (
        (["none.yaml"], "mmnn ros2 --example FOLDER"),
        (["--chek"], "no option --chek"),
        (["--ros-args", "-r", "nonsense"], "ROS 2 does not take this"),
        ([], "no robot: mmnn ros2 --example FOLDER"),
    ):
        code, text = said("kilted", DOMAIN, *arguments)
        assert code == 2 and told in text, text


def test_controllers_are_printed_for_the_file(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(SETTINGS)
    code, text = said("kilted", DOMAIN, file, "--controllers")
    assert code == 0 and text.strip() == controllers(load("platform_arm"), read(SETTINGS)).strip()


def test_plain_messages_have_the_fields_of_the_real_ones() -> None:
    command = [str(python_of("kilted")), str(Path(__file__).parent / "plain_messages.py")]
    run = subprocess.run(command, env=of_ros("kilted", DOMAIN), capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_without_rclpy_one_line_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rclpy", None)
    assert main(["ros2", "my.yaml"]) == 2
    assert re.match(r"error: no rclpy for this Python 3\.\d+: .*: source /opt/ros/", capsys.readouterr().err)
