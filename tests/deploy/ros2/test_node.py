"""The node as ROS 2 manages it: transitions, live parameters, Ctrl-C, a second node, a full disk, a clock set back."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from graph import LONG, SETTINGS, drive, mmnn, said, start

EFFORTS = slice(12, 14)  # of a row of the robot: what its arm's motors were told last


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_ctrl_c_brakes_and_is_130(tmp_path: Path, domain: int, number: int) -> None:
    """Control is the main thread, before all ordinary ones where that may be had."""
    policies = []

    def press(node: subprocess.Popen[str]) -> None:
        policies.append(os.sched_getscheduler(node.pid))
        node.send_signal(number)

    run = drive(tmp_path, "kilted", domain, "no_plan", seconds=90.0, when_it_drives=press)
    assert run.code == 130 and f"stopped by {signal.Signals(number).name}" in run.lines, run.lines
    is_told = "control runs as an ordinary thread" in run.lines
    assert policies == [os.SCHED_OTHER if is_told else os.SCHED_FIFO | os.SCHED_RESET_ON_FORK], run.lines
    assert np.abs(run.rows[:, 4]).max() > 0.1  # it drove
    assert np.abs(run.rows[-1, 4:6]).max() < 0.02 and np.abs(run.rows[-1, EFFORTS]).max() < 1e-6


def test_settings_of_fast_dds_that_lie_where_one_stands_are_not_read(tmp_path: Path, domain: int) -> None:
    """They would keep one waiting for ever, as does everything that reads a pipe."""
    (tmp_path / "robot.yaml").write_text(SETTINGS)
    os.mkfifo(tmp_path / "DEFAULT_FASTDDS_PROFILES.xml")
    node = mmnn("kilted", domain, tmp_path / "robot.yaml", "--check", cwd=tmp_path)
    out, err = node.communicate(timeout=LONG)
    assert node.returncode == 0 and "joint_states" in out, err


def test_a_full_disk_lets_the_efforts_fade(tmp_path: Path, domain: int) -> None:
    def fill(node: subprocess.Popen[str]) -> None:
        resource.prlimit(node.pid, resource.RLIMIT_FSIZE, (4096, 4096))

    run = drive(tmp_path, "kilted", domain, "no_plan", seconds=90.0, when_it_drives=fill)
    assert run.code not in (0, 2) and "run.h5: error: cannot write" in run.lines, run.lines  # HDF5 may crash at exit
    assert "Traceback" not in run.lines
    assert np.abs(run.rows[-1, 4:6]).max() < 0.02 and np.abs(run.rows[-1, EFFORTS]).max() < 1e-6


def test_a_managed_node_is_configured_changed_stopped_and_started_again(tmp_path: Path, domain: int) -> None:
    """By the services of the lifecycle and of parameters; a second node of the same robot is refused meanwhile."""
    file = tmp_path / "robot.yaml"
    file.write_text(SETTINGS)
    robot = start("kilted", domain, "robot_node.py", 900.0, "no_plan")
    own = [file, "--out", tmp_path / "run.h5", "--force"]
    remapped = ["--ros-args", "-r", "diff_drive_controller/odom:=odom"]
    node, manager = mmnn("kilted", domain, *own, "--managed", *remapped), start("kilted", domain, "manager_node.py", 0)
    try:
        told = json.loads(manager.stdout.readline())  # type: ignore[union-attr]
        own = [file, "--out", tmp_path / "second.h5", "--wait", 3]
        second = said("kilted", domain, *own, *remapped, "-r", "__node:=second")
        goes_on = start("kilted", domain, "manager_node.py", 1)
        told |= json.loads(goes_on.communicate(timeout=LONG)[0])
        node.send_signal(signal.SIGINT)
        lines = "".join(node.communicate(timeout=LONG))
    finally:
        for one in (robot, node, manager):
            one.kill()
    assert told["states"] == ["unconfigured", "inactive", "active"]
    assert told["range"] == [0.0, 1e6] and "Largest speed of the base" in told["description"]
    assert told["speed"] == [True, ""] and told["driven"] < 0.11  # the joystick asks for 0.2 m/s
    assert told["gains"][0] and told["learning"][0]
    assert not told["unstable"][0] and "the sampled PD loop is unstable" in told["unstable"][1]
    assert not told["robot"][0] and "robot cannot change now" in told["robot"][1]
    assert not told["wrong"][0] and "limits.speed" in told["wrong"][1]
    assert second[0] in (1, 2) and "publishes it, too: one node controls a robot" in second[1], second
    assert told["after"] == ["inactive", "active", "inactive", "unconfigured", "inactive"]
    assert told["stands"] < 0.02 and told["drives again"] > 0.05, lines
    assert node.returncode == 130, lines


def test_a_node_that_was_killed_is_started_again(tmp_path: Path, domain: int) -> None:
    """The graph forgets who was killed after a lease, 20 s of Fast DDS: until then its commands count as another's."""
    for code, number in ((-signal.SIGKILL, signal.SIGKILL), (130, signal.SIGINT)):
        end = partial(subprocess.Popen.send_signal, sig=number)
        run = drive(tmp_path, "kilted", domain, "no_plan", seconds=90.0, wait=90.0, when_it_drives=end)
        assert run.code == code and np.abs(run.rows[:, 4]).max() > 0.15, run.lines


TIAGO = {
    "torso_lift_joint": 0.15, "arm_1_joint": 0.5, "arm_2_joint": -0.5, "arm_3_joint": -1.0, "arm_4_joint": 1.0,
    "arm_5_joint": 0.0, "arm_6_joint": 0.0, "arm_7_joint": 0.0,
}  # fmt: skip
SERVOS = f"""/**:
  ros__parameters:
    robot: tiago
    rate: 100.0
    latency: 0.005
    controller: pd_gravity
    set:
      overrides: {{lock: ["head_1_joint=0.0", "head_2_joint=0.0"]}}
      safety: {{torque: urdf, timeout: 0.8, stop_time: 1.0}}
    joint_states: {{age: 0.3}}
    odometry: {{age: 0.3, at: [0.0, 0.0, 0.0]}}
    path: {{speed: 0.25}}
    commands:
      diff_drive_controller: {{type: TwistStamped}}
      arm_controller: {{type: JointTrajectory, interface: position, joints: [{", ".join(TIAGO)}]}}
"""


@pytest.mark.long
@pytest.mark.parametrize("distribution", ["kilted", "jazzy"])
@pytest.mark.parametrize(("text", "joints"), [(SETTINGS, {}), (SERVOS, TIAGO)], ids=["platform_arm", "tiago"])
def test_a_session(tmp_path: Path, domain: int, distribution: str, text: str, joints: dict[str, float]) -> None:
    """Teleoperation, goals of arm and base, a path, live parameters, e-stop, reset; then killed and started again."""
    servos, goes_on = [f"{name}={q}" for name, q in joints.items()], ("end_after_trip:=false",)
    faults = (*servos, "no_plan", "no_joystick")
    run = drive(
        tmp_path, distribution, domain, *faults, seconds=900.0, planner="session_node.py", text=text, changes=goes_on
    )
    assert run.code == 130 and "planner" in run.robot, run.lines
    told = run.robot["planner"]
    assert told["teleoperation"], told
    for name in ("arm", "again"):
        assert told[name][0] == [4, 0, ""] and told[name][1] < 0.05, (name, told)
    for name in ("whole", "path"):
        result, (aside, turned) = told[name]
        assert result == [4, 0, ""] and aside < 0.05 and turned < 0.05, (name, told)
    assert told["parameters"] == [True, False] and told["stop"] and told["reset"], told
    assert told["stopped"][0] == 6, told  # aborted: it does not move while it is stopped
    for code, number in ((-signal.SIGKILL, signal.SIGKILL), (130, signal.SIGINT)):
        end = partial(subprocess.Popen.send_signal, sig=number)
        run = drive(
            tmp_path, distribution, domain, *servos, "no_plan", seconds=90.0, wait=90.0, text=text, when_it_drives=end
        )
        assert run.code == code, run.lines


def test_a_clock_that_was_set_back_is_a_stop_and_a_reset_goes_on(tmp_path: Path, domain: int) -> None:
    asked = "use_sim_time:=true", "end_after_trip:=false"
    faults = "sim_time", "sim_back@2.0", "no_plan"
    run = drive(tmp_path, "kilted", domain, *faults, seconds=600.0, changes=asked, planner="switch_node.py")
    told = run.robot["planner"]
    assert told["tripped"] and told["reset"][0] and told["runs"], (told, run.lines)
    assert "/clock jumped by -" in run.lines


@pytest.mark.parametrize("given", ["rate:=-5.0", "latency:=.nan", "limits.speed:=-1.0"])
def test_a_parameter_out_of_its_range_is_one_line_with_its_name(tmp_path: Path, domain: int, given: str) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(SETTINGS)
    code, lines = said("kilted", domain, file, "--check", "--ros-args", "-p", given)
    name, _, value = given.partition(":=")
    assert code == 2 and f"{name}: error: {value.lstrip('.')} is out of range: give a number from " in lines, lines


def test_an_rmw_that_is_not_there_is_one_line(tmp_path: Path, domain: int) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(SETTINGS)
    code, lines = said("kilted", domain, file, "--check", RMW_IMPLEMENTATION="rmw_other_cpp")
    assert code == 2 and len(lines.splitlines()) == 1, lines
    assert "no RMW 'rmw_other_cpp' here" in lines and "apt install ros-$ROS_DISTRO-rmw-other-cpp" in lines
