"""The settings file: errors with their lines, what `--check` says, the example that `--example` writes."""

from __future__ import annotations

import json
import shlex
import tomllib
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import pytest
import yaml
from graph import SETTINGS
from places import ROOT
from robots import robot_of

from mmnn_pin import Stepper, load
from mmnn_pin.cli import main
from mmnn_pin.cli.ros2 import asked
from mmnn_pin.deploy.ros2.reading import line_of, load_settings
from mmnn_pin.deploy.ros2.wiring import controllers, example, interfaces
from mmnn_pin.errors import InputError
from mmnn_pin.loop.latency import Latency
from mmnn_pin.safety import Safety

GOOD = SETTINGS.format(domain=3, reliability="reliable")


def said(folder: Path, capsys: Any, text: str, *options: str) -> tuple[int, str]:
    file = folder / "robot.toml"
    file.write_text(text)
    code = main(["ros2", str(file), "--check", *options])
    out = capsys.readouterr()
    return code, (out.out + out.err).replace(str(file), "FILE")


WRONG = {
    "domain = 3": ("domain = 300", "FILE:9:network.domain: error: 300: use 0 to 232, as ROS_DOMAIN_ID"),
    "age = 0.3\nrel": ("ages = 0.3\nrel", "FILE:11:joint_states: error: unknown key 'ages': did you mean 'age'?"),
    'reliability = "reliable"': ('reliability = "exact"', "FILE:12:joint_states.reliability: error: "),
    'topic = "/cmd_vel"': ('topic = "/cmd vel"', "FILE:17:velocity.topic: error: '/cmd vel' is no name of a topic"),
    '"TwistStamped"': ('"Twisted"', "FILE:24:commands.0.type: error: "),
    '"arm_2_joint"]': ('"arm_3_joint"]', "FILE:27:commands.1.joints: error: unknown joint 'arm_3_joint'"),
    ', "arm_2_joint"]': ("]", "error: nothing commands arm_2_joint: add them to a table [[commands]]"),
    "rate = 100.0": ("rate = 1e5", "FILE:2:rate: error: 100000.0 /s: use 1 to 2000"),
    'robot = "platform_arm"': ('robot = "nobody"', "unknown robot 'nobody'"),
    "base = 10.0": ("bass = 10.0", "FILE:5:set.feedback.bass: error: unknown key 'bass'"),
    "[network]": ("[network", "FILE:8: error: not valid TOML"),
}


@pytest.mark.parametrize("good", WRONG)
def test_what_is_wrong_is_named_with_its_line(tmp_path: Path, capsys: Any, good: str) -> None:
    bad, told = WRONG[good]
    assert good in GOOD
    code, text = said(tmp_path, capsys, GOOD.replace(good, bad, 1))
    assert code == 2 and told in text and len(text.strip().splitlines()) == 1, text


def test_a_missing_file_is_named_and_the_fix_works(tmp_path: Path, capsys: Any) -> None:
    assert main(["ros2", str(tmp_path / "none.toml")]) == 2
    assert "mmnn ros2 --example > robot.toml" in capsys.readouterr().err
    assert main(["ros2", "--example"]) == 0
    code, text = said(tmp_path, capsys, capsys.readouterr().out)
    assert code == 0 and "publishes   /effort_controller/commands" in text


def test_check_says_every_topic(tmp_path: Path, capsys: Any) -> None:
    code, text = said(tmp_path, capsys, GOOD, "--json")
    rows = {row["name"]: row for row in json.loads(text)["topics"]}
    assert code == 0
    assert {name: row["way"] for name, row in rows.items()} == {
        "/joint_states": "subscribes", "/odom": "subscribes", "/cmd_vel": "subscribes",
        "/mmnn/joint_trajectory": "subscribes", "/mmnn/follow_joint_trajectory": "serves",
        "/diff_drive_controller/cmd_vel": "publishes", "/effort_controller/commands": "publishes",
        "/diagnostics": "publishes",
    }  # fmt: skip
    assert rows["/joint_states"]["qos"] == "reliable, depth 4"


def test_changes_and_namespaces(tmp_path: Path, capsys: Any) -> None:
    text = GOOD.replace("[network]", '[network]\nnamespace = "/robot_1"').replace(
        "[odometry]", '[odometry]\ntopic = "odom"'
    )
    code, told = said(tmp_path, capsys, text, "--set", "velocity.topic=drive", "--set", "rate=50")
    assert code == 0 and "/robot_1/odom" in told and "/robot_1/drive" in told


@pytest.mark.parametrize("robot", ["platform_arm", "two_axis_arm"])
def test_the_example_fits_its_robot(tmp_path: Path, robot: str) -> None:
    file = tmp_path / "robot.toml"
    made = load(robot)
    file.write_text(example(made, robot))
    found = interfaces(made, load_settings(file))
    assert set(found) == set(made.actuator_names)
    assert {found[name] for name in made.joint_names} == {"effort"}


def test_the_example_takes_what_the_urdf_offers(tmp_path: Path) -> None:
    """One joint without an effort, in the tags of ros2_control."""
    offers = {"arm_1_joint": ("effort", "position"), "arm_2_joint": ("position", "velocity")}
    joints = "".join(
        f'<joint name="{name}">' + "".join(f'<command_interface name="{one}"/>' for one in ones) + "</joint>"
        for name, ones in offers.items()
    )
    told = f'<ros2_control name="arm" type="system">{joints}</ros2_control></robot>'
    robot = robot_of(load("platform_arm").urdf.replace("</robot>", told))
    file = tmp_path / "robot.toml"
    file.write_text(example(robot, "platform_arm"))
    found = interfaces(robot, load_settings(file))
    assert found == dict.fromkeys(robot.actuator_names[:2], "velocity") | {
        "arm_1_joint": "effort",
        "arm_2_joint": "velocity",
    }


def test_every_motor_is_commanded_once(tmp_path: Path) -> None:
    file, robot = tmp_path / "robot.toml", load("platform_arm")
    file.write_text(GOOD + '[[commands]]\ntopic = "/b"\njoints = ["arm_1_joint"]\n')
    with pytest.raises(InputError, match="arm_1_joint is commanded twice"):
        interfaces(robot, load_settings(file))
    file.write_text(
        GOOD.replace('type = "TwistStamped"', 'joints = ["L", "wheel_right_joint"]\ninterface = "velocity"')
    )
    named = load_settings(file, ['joint_states.names={wheel_left_joint = "L"}'])
    assert interfaces(robot, named)["wheel_left_joint"] == "velocity"


def test_lines_of_keys() -> None:
    text = 'a = 1\n[b]\nc = 2\n"d.e" = 3\n[[f]]\ng = 1\n[[f]]\ng = 2\n'
    assert [line_of(text, key) for key in ("a", "b.c", "f.1.g", "f.1", "b.x", "h")] == [1, 3, 8, 7, 2, None]


def test_gains_too_high_for_the_rate_are_refused_with_the_settings_that_cure_it(tmp_path: Path, capsys: Any) -> None:
    pytest.importorskip("cyclonedds")
    file, out = tmp_path / "robot.toml", tmp_path / "run.h5"
    velocity = 'type = "Float64MultiArray"\ninterface = "velocity"'
    text = GOOD.replace("rate = 100.0", "rate = 12.5").replace("K = 3.0", "K = 30.0", 1)
    file.write_text(text.replace('type = "Float64MultiArray"', velocity))
    assert main(["ros2", str(file), "--out", str(out), "--seconds", "0.1"]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert (
        line.startswith(f"{file}:") and "too high for servos with a bandwidth of 30 1/s: lower them, --set set." in line
    )
    changes = shlex.split(line.partition("lower them, ")[2].partition(", or shorten")[0])[1::2]
    settings = load_settings(file, changes)
    experiment, robot = asked(settings, file)
    loop = experiment.loop(robot, experiment.controller("pd", robot=robot))
    assert f"set.kinematic.K={loop.kinematic.K:.4g}" in changes
    with Stepper.of(loop, interfaces=interfaces(robot, settings), safety=Safety()) as stepper:
        assert stepper.delay_margin() > 0.0


@pytest.mark.parametrize(
    ("said", "found"),
    [
        ("", Latency(sensing=0.004, command=0.001, margin=0.007, predict=True)),
        ("latency = 0.006", Latency(sensing=0.006, margin=0.007, predict=True)),
        ("latency = 0.006\npredict = false", Latency(command=0.006, margin=0.007)),
        ("predict = false", Latency(sensing=0.004, command=0.001, margin=0.007)),
    ],
)
def test_an_experiments_latency_keeps_what_the_settings_do_not_say(said: str, found: Latency, tmp_path: Path) -> None:
    own = "latency = { sensing = 0.004, command = 0.001, margin = 0.007, predict = true }"
    file = tmp_path / "robot.toml"
    file.write_text(GOOD.replace("latency = 0.005", said, 1).replace("[set]", f"[set]\n{own}", 1))
    experiment, robot = asked(load_settings(file, []), file)
    assert experiment.latency == found
    with Stepper.of(experiment.loop(robot, "pd"), safety=Safety(torque="urdf")) as stepper:
        assert stepper.setup.known == found


STRANGE = ("]\n[set] # ", 'a"b', "yes", "{x}: [a, b]", "\u202ered\\", "\U0001f916", "a # b", "é")


@pytest.mark.parametrize("name", STRANGE)
def test_names_of_joints_are_names_in_the_files_that_are_written(name: str, tmp_path: Path) -> None:
    """Tomllib and PyYAML read them."""
    text = (ROOT / "urdf" / "platform_arm.urdf").read_text()
    attribute = quoteattr(name, {"\n": "&#10;", '"': "&quot;"})
    robot = tmp_path / "robot.urdf"
    robot.write_text(text.replace('"arm_1_joint"', attribute))
    robot = robot.rename(tmp_path / 'a"b.urdf')
    file = tmp_path / "settings.toml"
    file.write_text(example(load(robot), str(robot)))
    table = tomllib.loads(file.read_text())
    assert table["robot"] == str(robot) and set(table["set"]) == {"feedback", "safety"}
    assert [one["joints"] for one in table["commands"] if "joints" in one] == [[name, "arm_2_joint"]]
    settings = load_settings(file)
    made = controllers(asked(settings, file)[1], settings)
    nodes = [node["ros__parameters"] for node in yaml.safe_load(made).values()]
    (joints,) = (node["joints"] for node in nodes if "joints" in node)
    assert joints == [name, "arm_2_joint"] and made.replace("\n", "").isprintable()
