"""What a YAML of the robot's own controllers corrects reaches the model, and the YAML that we print for it.

The second answer is `diff_drive_controller`'s formula, as `test_drivers` has it from its source: put through it, the
robot's own file and the one that we print give the same rates of the wheels.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drives import robot_of
from hypothesis import given, settings
from hypothesis import strategies as st
from test_drivers import diff_drive_rates, on_wheels, ours, printed

from mmnn_pin.deploy.ros2.settings import Node, Output
from mmnn_pin.deploy.ros2.wiring import controllers
from mmnn_pin.errors import ConfigError, RobotError, UnknownName
from mmnn_pin.model import Robot
from mmnn_pin.model.base.report import Undecided
from mmnn_pin.model.loading import load

PLACES = {"fl": (0.25, 0.2), "fr": (0.25, -0.2), "rl": (-0.25, 0.2), "rr": (-0.25, -0.2)}
TWO = {"l": (0.0, 0.2, 0.1, (0, 1, 0)), "r": (0.0, -0.2, 0.1, (0, 1, 0))}
PLAIN = {
    "wheel_separation": 0.4, "wheel_radius": 0.1, "wheel_separation_multiplier": 1.0,
    "left_wheel_radius_multiplier": 1.0, "right_wheel_radius_multiplier": 1.0,
}  # fmt: skip
LEFT, RIGHT = ["l"], ["r"]
RATES, FACTORS = st.floats(-2.0, 2.0), st.floats(0.5, 2.0)


def yaml_of(
    left=LEFT, right=RIGHT, kind="diff_drive_controller/DiffDriveController", **keys: float
) -> tuple[str, dict]:
    """A file of a robot's controllers, and the parameters in it."""
    told = PLAIN | keys
    lines = "\n".join(f"    {key}: {value!r}  # [m]" for key, value in told.items())
    names = "".join(f"    {side}_wheel_names: [{', '.join(n)}]\n" for side, n in (("left", left), ("right", right)))
    head = f"controller_manager:\n  ros__parameters:\n    base: {{type: {kind}}}\n"
    return f"{head}base:\n  ros__parameters:\n{names}{lines}\n", told | {
        "left_wheel_names": left, "right_wheel_names": right
    }  # fmt: skip


def stated(robot: Robot, code: str = "base-stated") -> list[str]:
    return [f"{f.message}: {f.fix}" for f in robot.findings if f.code == code]


@given(st.tuples(FACTORS, FACTORS, FACTORS), st.tuples(*[st.sampled_from([-1, 1])] * 2), st.booleans(), RATES, RATES)
@settings(max_examples=40, deadline=None)
def test_the_files_of_the_robot_and_ours_roll_its_wheels_alike(tmp_path_factory, factors, signs, skids, v, w):
    file = tmp_path_factory.mktemp("own") / "c.yaml"
    sides = [["fl", "rl"], ["fr", "rr"]] if skids else [LEFT, RIGHT]
    turning = {name: sign for names, sign in zip(sides, signs, strict=True) for name in names}
    at = PLACES if skids else {name: one[:2] for name, one in TWO.items()}
    keys = ("wheel_separation_multiplier", "left_wheel_radius_multiplier", "right_wheel_radius_multiplier")
    text, own = yaml_of(*sides, **dict(zip(keys, np.multiply(factors, (1, *signs)).tolist(), strict=True)))
    file.write_text(text)
    wheels = {name: (*place, 0.1, (0, turning[name], 0)) for name, place in at.items()}
    robot = on_wheels(wheels, controllers_file=str(file))
    assert robot.base.kind == ("skid_steer" if skids else "differential_drive")
    rates = diff_drive_rates(own, v, w)
    assert diff_drive_rates(printed(robot, "diff_drive"), v, w) == pytest.approx(rates, rel=1e-6, abs=1e-6)
    assert ours(robot, (v, w)) == pytest.approx(rates, rel=1e-6, abs=1e-6)
    file.unlink()  # a recording stands alone
    said = {
        key: tuple(value) if isinstance(value, list) else value for key, value in robot.facts()["overrides"].items()
    }
    again = robot_of(robot.urdf, **said)
    np.testing.assert_array_equal(again.T, robot.T)
    assert again.base.turning == robot.base.turning and again.base.floor == robot.base.floor


def files(folder: Path, text: str) -> tuple[Path, Path]:
    """A URDF in a package, and a YAML in the package's `config`."""
    urdf, file = folder / "bot_description" / "bot.urdf", folder / "bot_description" / "config" / "drive.yaml"
    file.parent.mkdir(parents=True)
    (folder / "bot_description" / "package.xml").write_text("<package><name>bot_description</name></package>")
    urdf.write_text(on_wheels(TWO).urdf)
    file.write_text(text)
    return urdf, file


def test_a_file_beside_counts_where_it_names_the_wheels(tmp_path):
    text, _ = yaml_of(wheel_separation_multiplier=1.1, right_wheel_radius_multiplier=0.98)
    urdf, file = files(tmp_path, text)
    robot = load(urdf)
    assert robot.base.track == pytest.approx(0.44)
    assert [w.radius for w in robot.base.wheels] == pytest.approx([0.1, 0.098])
    told = stated(robot)
    assert len(told) == 2 and "wheel_separation_multiplier 1.1" in told[0] and "--track 0.4" in told[0]
    commands = {"drive": Output("TwistStamped"), "arm": Output(joints=robot.joint_names)}
    ours = file.with_name("a.yaml")  # what we print for it, beside it
    ours.write_text(controllers(robot, Node("r", commands)))
    np.testing.assert_allclose(load(urdf).T, robot.T, rtol=1e-8)
    ours.unlink()
    again = load(urdf, track=0.4, radius=0.1)  # as it says
    assert again.base.track == 0.4 and {w.radius for w in again.base.wheels} == {0.1} and stated(again) == []
    file.write_text(text.replace("[r]", "[other]"))  # another robot's
    other = load(urdf)
    assert (
        other.base.track == pytest.approx(0.4)
        and "states a track of 0.44 m, the geometry has 0.4 m" in stated(other)[0]
    )
    assert f"--controllers {file} where it is this robot's" in stated(other)[0]
    assert load(urdf, controllers_file=file).base.track == pytest.approx(0.44)


def told_of(folder: Path, text: str, **said) -> list[str]:
    (folder / "c.yaml").write_text(text)
    robot = on_wheels(TWO, controllers_file=str(folder / "c.yaml"), **said)
    assert robot.base.track == pytest.approx(0.4) and {w.radius for w in robot.base.wheels} == {0.1}
    return stated(robot) + stated(robot, "base-sides")


def test_what_contradicts_the_urdf_is_told_and_not_taken(tmp_path):
    assert told_of(tmp_path, yaml_of()[0]) == []
    far = told_of(tmp_path, yaml_of(wheel_separation=0.3, wheel_separation_multiplier=1.5)[0])
    assert len(far) == 1 and "states a track of 0.45 m, its geometry 0.4 m" in far[0]
    slow = yaml_of(wheel_separation_multiplier=1.2)[0].partition("\nbase:")[2]
    two = told_of(tmp_path, f"{yaml_of(wheel_separation_multiplier=1.5)[0]}slow:{slow}")
    assert [text.partition("states ")[2][:17] for text in two] == ["a track of 0.6 m,", "a track of 0.48 m"]
    backward = told_of(tmp_path, yaml_of(right_wheel_radius_multiplier=-1.0)[0])
    assert len(backward) == 1 and "rolls 'r' backward" in backward[0]
    assert "write right_wheel_radius_multiplier: 1.0" in backward[0]
    swapped = yaml_of(RIGHT, LEFT)[0]
    for text in (swapped, swapped.replace("_wheel_names", "_wheel").replace("  ros__parameters:\n", "")):  # ROS 1
        with pytest.raises(RobotError, match="drive along x of the root link 'base', or along -x"):
            told_of(tmp_path, text)
    with pytest.raises(Undecided, match=r"names 'ackermann' \(line 3\)"):
        told_of(tmp_path, yaml_of(kind="ackermann_steering_controller/AckermannSteeringController")[0])


@pytest.mark.parametrize("text", [
    "base:\n  ros__parameters: {wheel_separation: 0.4, 'wheel_separation_multiplier' : 1.5}\n",
    "base:\n  ros__parameters:\n    wheel_separation: 0.4\n    other:\n      wheel_radius: 0.1\n"
    "    wheel_separation_multiplier: 1.5\n",
    "/**:\n  ros__parameters:\n    base.wheel_separation: 0.4\n    base.wheel_separation_multiplier: 1.5\n",
])  # fmt: skip
def test_ways_to_write_it(tmp_path, text):
    (tmp_path / "c.yaml").write_text(text)
    assert on_wheels(TWO, controllers_file=str(tmp_path / "c.yaml")).base.track == pytest.approx(0.6)


@pytest.mark.parametrize(("length", "told"), [(0.45, 0), (0.9, 1)])
def test_a_mecanum_controllers_lengths_are_told_where_they_differ(tmp_path, length, told):
    kind = "mecanum_drive_controller/MecanumDriveController"
    kinematics = f"wheels_radius: 0.1, sum_of_robot_center_projection_on_X_Y_axis: {length}"
    text = (
        f"controller_manager:\n  base:\n    type: {kind}\nbase:\n  ros__parameters:\n    kinematics: {{{kinematics}}}\n"
    )
    (tmp_path / "c.yaml").write_text(text)
    wheels = {name: (*place, 0.1, (0, 1, 0)) for name, place in PLACES.items()}
    robot = on_wheels(wheels, controllers_file=str(tmp_path / "c.yaml"))
    assert robot.base.kind == "holonomic" and len(stated(robot)) == told
    (tmp_path / "c.yaml").write_text(text.replace("wheels_radius: 0.1,", "wheels_radius: 0.3,"))
    assert "states a radius of 0.3 m" in stated(on_wheels(wheels, controllers_file=str(tmp_path / "c.yaml")))[0]


def test_radii_of_single_wheels():
    assert [w.radius for w in on_wheels(TWO, wheel_radii=("r=0.09",)).base.wheels] == [0.1, 0.09]
    with pytest.raises(UnknownName, match="drive wheel 'q'"):
        on_wheels(TWO, wheel_radii=("q=0.09",))
    for text, why in (
        ("r", "'r' is no radius"),
        ("r=x", "'r=x' is no"),
        ("=1", "'=1' is no"),
        ("r=9e9", "cannot be a ra"),
    ):
        with pytest.raises(ConfigError, match=why):
            on_wheels(TWO, wheel_radii=(text,))
