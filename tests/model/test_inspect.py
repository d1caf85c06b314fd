"""`mmnn inspect`: what it prints for people and for programs, its exit codes, and the robots of example-robot-data."""

from __future__ import annotations

import json
import os
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from drives import ARM, Drive
from hypothesis import given
from hypothesis import strategies as st
from test_base import MOVE, drone, four, welded

from mmnn_pin import Feedback, load_experiment
from mmnn_pin.cli import main
from mmnn_pin.errors import RobotError
from mmnn_pin.lab.experiments.runner import interface_notes
from mmnn_pin.lab.show.robots import names_in, options_in
from mmnn_pin.model import Undecided, load
from mmnn_pin.model.base.report import Unsupported
from mmnn_pin.model.robots import FILES, extra, robot_data

needs_data = pytest.mark.skipif(robot_data() is None, reason="example-robot-data is not installed")


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, str, str]:
        code = main(arguments)
        return code, *capsys.readouterr()

    return run


def written(text: str) -> str:
    Path("r.urdf").write_text(text)
    return "r.urdf"


# --- The contract -----------------------------------------------------------------------------------------------------


def test_json_of_a_robot_that_was_understood(call):
    code, out, err = call("inspect", written(Drive(track=0.5, frame=(0.1, 0, 0)).urdf()), "--json")
    found = json.loads(out)
    assert (code, err, out.count("\n")) == (0, "", 1)
    assert set(found) >= {"file", "sha256", "ok", "findings", "base", "arm", "locked", "mass"}
    assert found["ok"] and len(found["sha256"]) == 64 and found["mass"] == pytest.approx(20 + 2 * 1.5 + 3)
    base = found["base"]
    assert base["kind"] == "differential_drive" and base["track"] == pytest.approx(0.5)
    assert base["axle_x"] == pytest.approx(0.1) and base["casters"] == []
    assert [(w["joint"], w["radius"], w["sign"]) for w in base["wheels"]] == [("left", 0.1, 1), ("right", 0.1, 1)]
    assert found["arm"]["joints"] == ["shoulder", "elbow"] and found["locked"] == []
    assert found["arm"]["limits"]["elbow"] == {"lower": 0.2, "upper": 2.0, "effort": 9.0}


def test_wheels_and_pivots_of_a_base_that_steers(call):
    """Places in the control frame, whatever carries them; roles, stops and motors as the file has them."""
    code, out, err = call("inspect", "truck_trailer_arm", "--json")
    base = json.loads(out)["base"]
    assert (code, err) == (0, "") and base["length"] == pytest.approx(0.6)
    pivots = {p["joint"]: p for p in base["pivots"]}
    left, right, hitch = (pivots[f"{n}_joint"] for n in ("front_left_steering", "front_right_steering", "hitch"))
    assert (left["role"], right["role"], hitch["role"]) == ("master", "follower", "passive")
    assert (left["motor"], right["motor"], hitch["motor"]) == (True, False, False)
    assert (left["lower"], left["upper"], left["rate"], hitch["lower"]) == (-0.75, 0.75, 4.0, None)
    assert hitch["x"] == pytest.approx(-0.14) and hitch["on"] is None
    wheels = {w["joint"]: w for w in base["wheels"]}
    assert len(wheels) == 6 and [w for w, one in wheels.items() if one["driven"]] == [
        "rear_left_wheel_joint",
        "rear_right_wheel_joint",
    ]
    trailing, front = wheels["trailer_left_wheel_joint"], wheels["front_right_wheel_joint"]
    assert (trailing["x"], trailing["y"]) == pytest.approx((-0.84, 0.22)) and trailing["on"] == "hitch_joint"
    assert (front["x"], front["y"]) == pytest.approx((0.6, -0.22))
    text = call("inspect", "truck_trailer_arm")[1]
    (row,) = [line.split() for line in text.splitlines() if line.startswith(" trailer_left_wheel_joint")]
    assert row[-2:] == ["-", "hitch_joint"] and "follower" in text


def test_prefixes_that_nobody_declared_harm_nothing(call):
    more = '<sensor:camera name="c" a:b="1"/><transmission name="t"><joint name="shoulder"/></transmission>'
    code, out, err = call("inspect", written(Drive().urdf(ARM + more)), "--json")
    found = json.loads(out)
    assert (code, err) == (0, "") and found["ok"] and found["base"]["kind"] == "differential_drive"
    assert "namespace" in {finding["code"] for finding in found["findings"]}
    assert found["interfaces"]["shoulder"] == "effort"


TAGS = """<ros2_control name="c" type="system">
<joint name="left"><command_interface name="velocity"/></joint>
<joint name="right"><command_interface name="velocity"/></joint>
<joint name="elbow"><command_interface name="position"/><command_interface name="effort"/></joint></ros2_control>"""


def test_it_tells_how_to_run_a_robot_on_its_hardware_and_the_line_works_as_it_stands(call):
    file = written(Drive().urdf(ARM + TAGS))
    out = call("inspect", file)[1]
    said = next(line for line in out.splitlines() if line.startswith("  mmnn run track")).split(maxsplit=1)[1]
    options = ("--controller", "two_layer", "--set", "time.duration=0.1", "--set", "plots=[]")
    code, out, err = call(*shlex.split(said), *options)
    assert said.endswith("--hardware unknown") and code == 0, err
    assert "note: driven left, right by velocity; elbow by position; no torque of a controller reaches any of" in out
    assert "did not run" not in out  # rivals would move alike
    track = load_experiment("track", [f'robot="{file}"'])
    [unoffered] = interface_notes(track, track.load_robot())
    assert unoffered.startswith("the URDF offers no torque at left and 1 more, this run uses it; --hardware unknown")
    assert interface_notes(load_experiment("track"), load("platform_arm")) == []  # its URDF offers nothing


@needs_data
@pytest.mark.parametrize("name", ["tiago", "so101", "ur5", "xarm7"])
def test_a_note_on_torques_names_the_hardware_that_inspect_proposes_and_that_drives_each_as_offered(name, call):
    track = load_experiment("track", [f'robot="{name}"'])
    [told] = interface_notes(track, track.load_robot())
    hardware = json.loads(call("inspect", name, "--json")[1])["hardware"]["profile"]
    assert told.endswith(f"--hardware {hardware} drives each as offered")
    followed = load_experiment("track", [f'robot="{name}"', f'hardware="{hardware}"'])
    assert not [note for note in interface_notes(followed, followed.load_robot()) if "offers no torque" in note]


def test_the_first_lines_say_what_was_understood_and_a_run_says_them_too(call):
    file = written(Drive(track=0.5).urdf())
    said = ["base: differential drive, left left, right right, radius 0.1 m, track 0.5 m, forward x"]
    said.append("arm: 2 joints: shoulder, elbow; hand: fore")
    assert call("inspect", file)[1].splitlines()[:3] == [*said, ""]
    assert json.loads(call("inspect", file, "--json")[1])["understood"] == said
    options = ("--robot", file, "--controller", "pd", "--set", "time.duration=0.02", "--set", "plots=[]")
    code, out, err = call("run", "track", *options)
    told = [
        line for line in err.splitlines() if not re.match(r"compiling|first run |pd: ", line)
    ]  # progress, where it is slow
    assert code == 0 and not told and out.splitlines()[:3] == [*said, ""]
    assert json.loads(call("run", "track", *options, "--force", "--json")[1])["experiment"]
    turned = call("inspect", file, "--forward", "-x", "--lock", "elbow")[1].splitlines()
    assert turned[0].endswith("left right, right left, radius 0.1 m, track 0.5 m, forward -x")
    assert turned[1] == "arm: 1 joint: shoulder; hand: upper; locked: elbow"
    assert call("inspect", file, "--base", "fixed")[1].splitlines()[0] == "base: fixed"


def test_a_reading_in_doubt_is_marked_with_how_to_say_it_otherwise(call):
    plugin = "<gazebo><plugin filename='p' name='p'><wheelSeparation>0.5</wheelSeparation></plugin></gazebo>"
    file = written(Drive().urdf(ARM + plugin))
    lines = call("inspect", file)[1].splitlines()
    assert lines[2:4] == ["in doubt: dimensions, which a file states otherwise (--track 0.5)", ""]
    options = ("--robot", file, "--controller", "pd", "--set", "time.duration=0.02", "--set", "plots=[]")
    assert call("run", "track", *options)[1].splitlines()[:4] == lines[:4]
    assert call("inspect", file, "--track", "0.5")[1].splitlines()[2] == ""


def test_a_base_that_steers_is_said_by_what_steers_and_what_drives(call):
    said, arm = call("inspect", "car_arm")[1].splitlines()[:2]
    found = json.loads(call("inspect", "car_arm", "--json")[1])["base"]
    assert said.startswith("base: car like, steered front_left_steering_joint and 1 more, driven rear_left_wheel_joint")
    assert f"wheelbase {found['length']:.4g} m, forward x" in said and arm.startswith("arm: 4 joints: ")


def test_options_of_a_fix_are_named_with_their_values_however_long():
    steer = f"--steer {','.join(['knuckle'] * 9)}"
    fix = f"--wheels a,b where these drive; --radius 0.1, or --package-dir FOLDER; {steer} if"
    assert options_in(fix) == ["--wheels a,b", "--radius 0.1", "--package-dir FOLDER", steer]
    assert options_in("--controllers 'my robot/a.yaml' where it is this robot's, --radius 0.1 to use it") == [
        "--controllers 'my robot/a.yaml'",
        "--radius 0.1",
    ]
    assert options_in("--radius, or --package-dir where their meshes are; --track for another") == [
        "--radius",
        "--package-dir",
        "--track",
    ]
    assert options_in("--track, or --package-dir where they are; --track 0.44 to use it") == [
        "--package-dir",
        "--track 0.44",
    ]


@given(st.lists(st.text("abc_", min_size=1, max_size=12), min_size=1, max_size=30), st.integers(5, 90))
def test_names_in_a_line_keep_to_their_room_and_are_counted(names, room):
    text = names_in(names, room)
    shown, _, more = text.partition(" and ")
    kept = shown.split(", ")
    assert kept == names[: len(kept)] and (len(kept) == 1 or len(shown) <= room)
    assert (f"{len(names) - len(kept)} more" == more) if len(kept) < len(names) else not more


def test_gains_are_those_of_a_run_and_can_be_copied(call):
    file = written(Drive().urdf(ARM))
    assert "track" not in json.loads(call("inspect", file, "--json")[1])
    found = json.loads(call("inspect", file, "--gains", "--json")[1])["track"]
    experiment = load_experiment("track", [f'robot="{file}"'])
    robot = experiment.load_robot()
    gains = experiment.controller("pd", robot=robot).feedback.vector(robot.dimensions)
    np.testing.assert_array_equal(list(found["gains"].values()), gains)
    assert list(found["gains"]) == list(robot.velocity_names)
    products = [found["inertia"][name] * found["bandwidth"][name] for name in found["gains"]]
    np.testing.assert_allclose(products, gains)
    text = call("inspect", file, "--gains")[1]
    options = shlex.split(next(line for line in text.splitlines() if "--set feedback" in line or "'feedback" in line))
    copied = load_experiment("track", [f'robot="{file}"', *options[1::2]]).controller("pd", robot=robot)
    np.testing.assert_allclose(copied.feedback.vector(robot.dimensions), gains, rtol=1e-3)
    python = next(line for line in text.splitlines() if line.startswith("  Feedback(")).removesuffix(" in Python")
    np.testing.assert_allclose(eval(python.strip(), {"Feedback": Feedback}).vector(robot.dimensions), gains, rtol=1e-3)


def test_a_negative_limit_is_none(call):
    text = Drive().urdf().replace('effort="9.0"', 'effort="-9.0"').replace('effort="9"', 'effort="-9"')
    code, out, _ = call("inspect", written(text), "--json")
    found = json.loads(out)
    assert code == 0 and found["ok"] and found["arm"]["limits"]["elbow"]["effort"] is None
    assert "limit-negative" in {finding["code"] for finding in found["findings"]}


def test_the_axis_of_a_fixed_joint_is_not_read(call):
    plate = '<link name="plate"/><joint name="j" type="fixed"><parent link="base"/><child link="plate"/>{}</joint>'
    wrong = plate.format('<axis xzy="0 0 1"/>')
    assert "xzy" not in call("inspect", written(Drive().urdf(ARM + wrong)))[2]
    code, _, err = call("inspect", written(Drive().urdf(ARM + wrong.replace("fixed", "continuous"))))
    assert code == 2 and "unknown attribute 'xzy'" in err


def test_findings_have_all_their_fields(call):
    _, out, _ = call("inspect", written(four(more=MOVE)), "--json")
    findings = json.loads(out)["findings"]
    assert {"base-evidence", "base-roller"} <= {finding["code"] for finding in findings}
    for finding in findings:
        assert set(finding) >= {"severity", "code", "file", "line", "element", "message", "fix"}


def test_an_undecided_base_exits_2_with_the_candidates(call):
    code, out, err = call("inspect", written(four()), "--json")
    found = json.loads(out)
    assert code == 2 and not found["ok"] and found["base"]["kind"] == "undecided"
    kinds = [c["kind"] for c in found["base"]["candidates"]]
    assert kinds == ["skid_steer", "holonomic", "tracked", "differential_drive"]
    assert any(c["for"] or c["against"] for c in found["base"]["candidates"])
    assert [f["code"] for f in found["findings"] if f["severity"] == "error"] == ["base-undecided"]
    assert err.count("\n") == 1 and "r.urdf:" in err and "--base skid_steer" in err
    code, out, _ = call("inspect", "r.urdf")
    assert code == 2 and "candidate: skid steer" in out and "against" in out


def test_a_refused_machine_exits_2_with_its_name(call):
    code, out, err = call("inspect", written(drone()), "--json")
    found = json.loads(out)
    assert code == 2 and found["base"] == {"kind": "unsupported", "machine": "drone"} and "drone" in err


def test_all_errors_of_a_bad_file_are_told(call):
    text = Drive().urdf().replace('value="1.0"', 'value="1,0"').replace('upper="2"', 'upper="x"')
    code, out, err = call("inspect", written(text), "--json")
    errors = [f for f in json.loads(out)["findings"] if f["severity"] == "error"]
    assert code == 2 and len(errors) == err.count("\n") >= 2
    assert all(f"r.urdf:{f['line']}: error: " in err for f in errors)


@pytest.mark.parametrize(("options", "words"), [
    (["--wheels", "fl,fr"], ["differential drive", "casters", "rl, rr"]),
    (["--base", "holonomic", "--roller", "-0.7"], ["holonomic", "-40.1"]),
    (["--base", "fixed", "--lock", "elbow=0.5"], ["fixed", "elbow", "0.5", "locked as you said"]),
    (["--wheels", "fl,fr", "--radius", "0.2", "--track", "0.7"], ["0.2", "0.7 m", "0.35"]),
    (["--wheels", "fl,fr", "--arm-tip", "upper"], ["shoulder", "it does not lead to the arm's tip"]),
])  # fmt: skip
def test_options_say_what_the_file_does_not(call, options, words):
    code, out, err = call("inspect", written(four()), *options)
    assert code == 0 and err == "", err
    for word in words:
        assert word in out


def test_welded_wheels_say_how_to_go_on(call):
    code, out, err = call("inspect", written(welded()))
    assert code == 2 and "--base fixed" in err and "candidate: holonomic" in out
    assert call("inspect", "r.urdf", "--base", "holonomic")[0] == 0


@pytest.mark.parametrize("options", [["--wheels", "fl,nope"], ["--base", "omni"], ["--radius", "-1"],
                                     ["--wheels", "fl,fr", "--lock", "x"]])  # fmt: skip
def test_options_that_do_not_suit_exit_2_in_one_line(call, options):
    code, out, err = call("inspect", written(four()), *options)
    assert (code, out) == (2, "") and err.count("\n") == 1


@pytest.mark.parametrize(("options", "words"), [
    (["--base", "holonomic", "--roller", "0"], "leave a direction undriven"),  # four parallel omni wheels
    (["--wheels", "fl,fr", "--roller", "0.0"], "a roller for a base 'differential_drive'"),
    (["--wheels", "fl,fr", "--radius", "0"], "cannot be a radius"),
    (["--wheels", "fl,fr", "--track", "0"], "cannot be a track"),
])  # fmt: skip
def test_an_option_of_0_is_said_too(call, options, words):
    code, _, err = call("inspect", written(four()), *options)
    assert code == 2 and words in err and err.count("\n") == 1


def test_model_takes_the_same_options(call):
    code, out, _ = call("model", written(four(more=MOVE)), "--lock", "elbow=0.3", "--json")
    found = json.loads(out)
    assert code == 0 and found["velocity_names"] == ["vx", "vy", "w", "shoulder"]
    np.testing.assert_allclose(np.array(found["A"]) @ np.array(found["T"]), 0, atol=1e-12)
    assert np.shape(found["E"]) == (4, 5)


# --- Robots by name ---------------------------------------------------------------------------------------------------


def test_without_the_extra_a_line_says_how_to_get_it(monkeypatch, tmp_path, call):
    monkeypatch.setattr("mmnn_pin.model.robots.robot_data", lambda: None)
    code, _, err = call("inspect", "tiago")
    assert code == 2 and "mmnn_pin[robots]" in err and err.count("\n") == 1


def test_names_of_the_extra_are_found_where_it_is_installed(monkeypatch, tmp_path):
    folder = tmp_path / "cmeel.prefix/share/example-robot-data/robots"
    file = folder / FILES["ur5"]
    file.parent.mkdir(parents=True)
    file.write_text(f'<robot name="a"><link name="base"/>{ARM}</robot>')
    monkeypatch.delenv("EXAMPLE_ROBOT_DATA", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    assert extra() == {"ur5": file} or os.environ.get("EXAMPLE_ROBOT_DATA")
    assert load("ur5").base.kind == "fixed"
    monkeypatch.setenv("EXAMPLE_ROBOT_DATA", str(folder))
    assert load("ur5").path == file


@needs_data
@pytest.mark.parametrize(("name", "kind", "wheels", "arm"), [
    ("tiago", "differential_drive", 2, 8), ("tiago_no_hand", "differential_drive", 2, 8),
    ("tiago_dual", "differential_drive", 2, 15), ("tiago_pro", "holonomic", 4, 15),
])  # fmt: skip
def test_four_mobile_robots_are_understood_without_a_hint(name, kind, wheels, arm):
    robot = load(name)
    assert (robot.base.kind, len(robot.base.wheels), robot.dimensions.arm) == (kind, wheels, arm)
    radius, track = (0.0762, 0.44635) if name == "tiago_pro" else (0.0985, 0.4044)
    assert {w.radius for w in robot.base.wheels} == {radius} and robot.base.track == pytest.approx(track)
    assert np.abs(robot.A @ robot.T).max() < 1e-12
    assert len(robot.A) == np.linalg.matrix_rank(robot.A) == robot.model.nv - robot.dimensions.dof
    if name == "tiago_dual":
        assert len(robot.base.casters) == 8 and len(robot.base.suspensions) == 2


@needs_data
def test_the_mimic_joints_of_tiago_pro_follow_when_its_fingers_move():
    robot = load("tiago_pro", free=("gripper_left_finger_joint",))
    assert len(robot.arm.slaves) == 5 and np.abs(robot.A @ robot.T).max() < 1e-12


@needs_data
def test_pr2_is_undecided_and_the_message_says_how_to_go_on():
    with pytest.raises(Undecided, match="--base fixed") as error:
        load("pr2")
    assert "caster" in str(error.value)
    assert load("pr2", base="fixed").dimensions.base == 0
    assert load("pr2", base="holonomic").velocity_names[:3] == ("vx", "vy", "w")


MOBILE = {"tiago", "tiago_no_hand", "tiago_dual", "tiago_pro", "pr2"}


@needs_data
@pytest.mark.parametrize("name", sorted(FILES.keys() - MOBILE))
def test_every_fixed_arm_is_fixed(name):
    robot = load(name)
    assert robot.base.kind == "fixed" and robot.dimensions.arm > 0


@needs_data
@pytest.mark.parametrize(("name", "machine"), [
    ("a1_description/urdf/a1.urdf", "legged machine"), ("solo_description/robots/solo12.urdf", "legged machine"),
    ("bolt_description/robots/bolt.urdf", "legged machine"),
    ("centauro_description/urdf/centauro.urdf", "legged machine"),
    ("anymal_c_simple_description/urdf/anymal.urdf", "legged machine"),
    ("talos_data/robots/talos_reduced.urdf", "humanoid"), ("g1_description/urdf/g1_29dof_rev_1_0.urdf", "humanoid"),
    ("simple_humanoid_description/urdf/simple_humanoid.urdf", "humanoid"),
    ("human_description/robots/human.urdf", "humanoid"),
    ("iris_description/robots/iris.urdf", "drone"), ("iris_description/robots/iris_simple.urdf", "drone"),
    ("hector_description/robots/quadrotor_base.urdf", "drone"),
    ("borinot_description/urdf/borinot_flying_arm_2.urdf", "drone"),
])  # fmt: skip
def test_legged_machines_humanoids_and_drones_are_refused_by_that_name(name, machine):
    with pytest.raises(RobotError) as error:
        load(robot_data() / name)
    assert isinstance(error.value, Unsupported) and error.value.machine == machine


@pytest.mark.parametrize("command", ["inspect", "model", "check"])
@pytest.mark.parametrize("robot", ["/", "x" * 5000, "y" * 300 + ".urdf", "a\0b.urdf", "/proc/self/mem", "."])
def test_paths_that_are_no_file_are_bad_input_in_one_line(call, command, robot):
    code, _, err = call(command, robot)
    assert code == 2 and err.count("\n") == 1 and "internal error" not in err and "error: " in err


@pytest.mark.parametrize("command", ["inspect", "model", "check"])
def test_every_command_tells_all_errors(call, command):
    text = Drive().urdf().replace('value="1.0"', 'value="1,0"').replace('upper="2"', 'upper="x"')
    code, _, err = call(command, written(text))
    assert code == 2 and err.count(" error: ") == err.count("\n") == 2
    _, out, _ = call(command, "r.urdf", "--json")
    found = json.loads(out)
    told = [f for f in found["findings"] if f["severity"] == "error"] if command == "inspect" else found["errors"]
    assert len(told) == 2


def test_names_steer_no_terminal(call):
    """Control characters, line breaks and bidirectional overrides in names."""
    odd = "e&#155;2J&#10;l&#8238;bow"
    code, out, err = call("inspect", written(Drive().urdf().replace('"elbow"', f'"{odd}"')))
    assert code == 0 and not [c for c in out if not c.isprintable() and c != "\n"]
    short, row = (line for line in out.splitlines() if "bow" in line)
    assert short.startswith("arm: 2 joints: shoulder, ") and "0.2" in row
    assert call("model", "r.urdf")[0] == 0
    code, _, err = call("inspect", "r.urdf", "--wheels", "left,\x9b31mright")
    assert code == 2 and all(c.isprintable() for c in err.rstrip("\n"))


@pytest.mark.parametrize("state", ['{"base_velocity": [1e308, 0]}',
                                   '{"pose": [1e308, 1e308, 0], "base_velocity": [1e200, 1e200]}'])  # fmt: skip
def test_states_beyond_a_double_are_bad_input(call, state):
    Path("s.json").write_text(state)
    code, _, err = call("model", written(Drive().urdf()), "--at", "s.json", "--json")
    assert code == 2 and err.count("\n") == 1 and "not finite" in err and "RuntimeWarning" not in err


@pytest.mark.parametrize(
    ("joints", "pose", "told"),
    [
        ({"arm_1_joint": 45.0}, [0, 0, 0], ["arm_1_joint = 45 rad is beyond its limits -3.142 to 3.142 rad", "0.7854"]),
        ({"arm_1_joint": 3.3}, [0, 0, 0], ["arm_1_joint = 3.3 rad is beyond its limits -3.142 to 3.142 rad"]),
        ({}, [0, 0, 90], ["phi = 90 rad is more than a turn: if these are degrees, give 1.571"]),
        ({"arm_1_joint": 2.6, "wheel_left_joint": 60.0}, [100, -100, 6.2], []),
    ],
)
def test_a_state_that_a_robot_can_hardly_mean_is_warned_of(joints, pose, told, tmp_path, call):
    """Angles in degrees, or beyond limits; the answer is given all the same."""
    (tmp_path / "s.json").write_text(json.dumps({"joints": joints, "pose": pose}))
    code, out, err = call("model", "platform_arm", "--at", str(tmp_path / "s.json"), "--json")
    assert code == 0 and "M" in json.loads(out)
    assert err.count("warning: ") == (told != []) and all(text in err for text in told)
