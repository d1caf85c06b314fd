"""The YAML that we print for a base's controller, put through that controller's own formula, gives our wheel speeds.

The formulas are written from ros-controls/ros2_controllers, release 6.9.0 (master at 94e74de): `diff_drive_controller/
src/diff_drive_controller.cpp` (`update_and_write_commands`) and `src/odometry.cpp` (`update_from_vel`),
`mecanum_drive_controller/src/mecanum_drive_controller.cpp` and `src/odometry.cpp` (`update`),
`omni_wheel_drive_controller/src/omni_wheel_drive_controller.cpp` (`compute_and_set_wheel_velocities`) and
`src/odometry.cpp` (`compute_robot_velocity`). What a parameter may be is in their `src/*_parameter*.yaml`.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from drives import ARM, UP, joint, link, origin, robot_of, rotation
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mmnn_pin.deploy.ros2.settings import Node, Output
from mmnn_pin.deploy.ros2.wiring import controllers, topic_of
from mmnn_pin.errors import ConfigError
from mmnn_pin.model import Robot

yaml = pytest.importorskip("yaml", reason="pip install pyyaml")

LENGTHS, RATES = st.floats(0.05, 0.2), st.floats(-2.0, 2.0)
SIGNS = st.sampled_from([-1, 1])
ANGLES = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
KIND = {"diff_drive": "cmd_vel", "mecanum_drive": "reference", "omni_wheel_drive": "cmd_vel"}


def on_wheels(wheels: dict[str, tuple], angles: tuple = (0.0, 0.0, 0.0), **said) -> Robot:
    """A base with an arm; a wheel is its place (x, y), radius [m], and the direction of its joint's axis.

    Args:
        wheels: By the name of their joint.
        angles: Roll, pitch, yaw of the joints' own frames, which the axes are written in.
        said: What is said about it.
    """
    R = rotation(*angles)
    text = link("base", 20.0, 0.8, '<box size="0.1 0.1 0.1"/>', origin(p=(0, 0, 0.4)))
    for name, (x, y, radius, axis) in wheels.items():
        own = R.T @ np.array(axis)
        lying = pin.Quaternion.FromTwoVectors(UP, own).matrix()
        text += link(f"{name}_link", 1.5, 0.02, f'<cylinder radius="{radius!r}" length="0.03"/>', origin(lying))
        text += joint(name, "continuous", "base", f"{name}_link", R, (x, y, radius), own)
    return robot_of(f'<robot name="r">{text}{ARM}</robot>', **said)


def printed(robot: Robot, kind: str) -> dict:
    """The parameters that we print for its base's controller."""
    commands = {"drive": Output("TwistStamped"), "arm": Output(joints=robot.joint_names)}
    assert topic_of(robot, "drive", commands["drive"]) == f"drive/{KIND[kind]}"
    found = yaml.safe_load(controllers(robot, Node("r", commands)))
    assert found["controller_manager"]["ros__parameters"]["drive"]["type"].startswith(f"{kind}_controller/")
    return found["drive"]["ros__parameters"]


def ours(robot: Robot, velocity) -> dict[str, float]:
    """Rates of the motors at a velocity of the base with the arm at rest [rad/s]."""
    nu = np.zeros(robot.dimensions.dof)
    nu[: len(velocity)] = velocity
    rates = dict(zip(robot.actuator_names, robot.E.T @ nu, strict=True))
    return {wheel.joint: rates[wheel.joint] for wheel in robot.base.wheels}


def turned_in(error: ConfigError) -> set[str]:
    """The joints whose axis a refusal asks to turn."""
    return set(error.fix.partition(" in the URDF")[0].removeprefix("turn the <axis> of ").split(", "))


# -- diff_drive_controller ---------------------------------------------------------------------------------------------


def diff_drive_rates(p: dict, v: float, w: float) -> dict[str, float]:
    separation = p.get("wheel_separation_multiplier", 1.0) * p["wheel_separation"]
    left = p["left_wheel_radius_multiplier"] * p["wheel_radius"]
    right = p["right_wheel_radius_multiplier"] * p["wheel_radius"]
    rates = dict.fromkeys(p["left_wheel_names"], (v - w * separation / 2.0) / left)
    return rates | dict.fromkeys(p["right_wheel_names"], (v + w * separation / 2.0) / right)


def diff_drive_odometry(p: dict, rates: dict[str, float]) -> tuple[float, float]:
    separation = p.get("wheel_separation_multiplier", 1.0) * p["wheel_separation"]
    left, right = (
        np.mean([rates[name] for name in p[f"{side}_wheel_names"]])
        * p[f"{side}_wheel_radius_multiplier"]
        * p["wheel_radius"]
        for side in ("left", "right")
    )
    return (left + right) * 0.5, (right - left) / separation


def judge_diff_drive(robot: Robot, v: float, w: float) -> None:
    p = printed(robot, "diff_drive")
    assert p["wheel_separation"] > 0.0 and p["wheel_radius"] > 0.0  # its `gt<>: [0.0]`
    assert len(p["left_wheel_names"]) == len(p["right_wheel_names"]) > 0  # else `on_configure` fails
    rates = ours(robot, (v, w))
    assert diff_drive_rates(p, v, w) == pytest.approx(rates, rel=1e-6, abs=1e-7)
    assert diff_drive_odometry(p, rates) == pytest.approx((v, w), rel=1e-6, abs=1e-7)


@given(st.tuples(SIGNS, SIGNS), st.tuples(LENGTHS, LENGTHS), st.floats(0.2, 0.8), ANGLES, RATES, RATES)
@settings(max_examples=40, deadline=None)
def test_two_wheels_with_axes_either_way(signs, radii, track, angles, v, w):
    sides = zip(("l", "r"), (track / 2, -track / 2), radii, signs, strict=True)
    robot = on_wheels({name: (0.1, y, r, (0, sign, 0)) for name, y, r, sign in sides}, angles)
    judge_diff_drive(robot, v, w)


@given(st.tuples(SIGNS, SIGNS), st.tuples(LENGTHS, LENGTHS), st.floats(0.3, 0.8), st.floats(0.3, 2.0), RATES, RATES)
@settings(max_examples=40, deadline=None)
def test_four_wheels_that_skid_on_any_effective_track(signs, radii, wide, track, v, w):
    wheels = {
        f"{end}{side}": (x, y, r, (0, sign, 0))
        for end, x in (("f", 0.25), ("r", -0.25))
        for side, y, r, sign in (("l", wide / 2, radii[0], signs[0]), ("r", -wide / 2, radii[0], signs[1]))
    }
    judge_diff_drive(on_wheels(wheels, base="skid_steer", track=track), v, w)


def test_wheels_that_follow_others_are_not_commanded():
    places = {"fl": (0.25, 0.2), "fr": (0.25, -0.2), "rl": (-0.25, 0.2), "rr": (-0.25, -0.2)}
    text = on_wheels({name: (*at, 0.1, (0, 1, 0)) for name, at in places.items()}, base="skid_steer").urdf
    for slave, master in (("rl", "fl"), ("rr", "fr")):
        head, tag, tail = text.partition(f'<joint name="{slave}"')
        text = head + tag + tail.replace("</joint>", f'<mimic joint="{master}"/></joint>', 1)
    robot = robot_of(text, base="skid_steer")
    p = printed(robot, "diff_drive")
    assert (p["left_wheel_names"], p["right_wheel_names"]) == (["fl"], ["fr"])
    nu = np.array([0.3, -1.0, *[0.0] * robot.dimensions.arm])
    own = dict(zip(robot.full_velocity_names, robot.T @ nu, strict=True))
    assert diff_drive_rates(p, 0.3, -1.0) == pytest.approx({name: own[name] for name in ("fl", "fr")})


def test_a_side_that_turns_against_itself_is_refused_with_the_joint_to_turn():
    wheels = {
        f"{end}{side}": (x, y, 0.1, (0, sign, 0))
        for end, x, sign in (("f", 0.25, 1), ("r", -0.25, -1))
        for side, y in (("l", 0.2), ("r", -0.2))
    }
    with pytest.raises(ConfigError, match=r"one sign for all wheels of a side.*turn the <axis> of rl in the URDF"):
        printed(on_wheels(wheels, base="skid_steer"), "diff_drive")
    turned = {name: (*one[:3], (0, 1, 0)) if name == "rl" else one for name, one in wheels.items()}
    with pytest.raises(ConfigError, match="turn the <axis> of rr in the URDF"):  # the other side's
        printed(on_wheels(turned, base="skid_steer"), "diff_drive")
    judge_diff_drive(on_wheels(turned | {"rr": (*wheels["rr"][:3], (0, 1, 0))}, base="skid_steer"), 0.3, -1.0)


def test_the_other_way_out_of_a_refusal_is_one():
    places = {"fl": (0.25, 0.2), "fr": (0.25, -0.2), "rl": (-0.25, 0.2), "rr": (-0.25, -0.2)}
    wheels = {name: (*at, 0.1 if name == "rl" else 0.12, (0, 1, 0)) for name, at in places.items()}
    robot = on_wheels(wheels, base="skid_steer")
    with pytest.raises(ConfigError, match=r"one radius for all wheels of a side, not fl 0\.12 m, rl 0\.1 m") as error:
        printed(robot, "diff_drive")
    assert error.value.fix.endswith('interface: velocity, joints: ["fl", "fr", "rl", "rr"]}')
    single = Output(joints=("fl", "fr", "rl", "rr"), interface="velocity")
    text = controllers(robot, Node("r", {"wheels": single, "arm": Output(joints=robot.joint_names)}))
    assert yaml.safe_load(text)["wheels"]["ros__parameters"]["interface_name"] == "velocity"


# -- mecanum_drive_controller ------------------------------------------------------------------------------------------

SLOTS = ("front_left", "front_right", "rear_right", "rear_left")


def mecanum_rates(p: dict, vx: float, vy: float, w: float) -> dict[str, float]:
    k, offset = p["kinematics"], p["kinematics"]["base_frame_offset"]
    c, s = math.cos(offset["theta"]), math.sin(offset["theta"])
    x = c * vx - s * vy + offset["y"] * w
    y = s * vx + c * vy - offset["x"] * w
    turn = k["sum_of_robot_center_projection_on_X_Y_axis"] * w
    rims = (x - y - turn, x + y + turn, x - y + turn, x + y - turn)
    return {
        p[f"{slot}_wheel_command_joint_name"]: rim / k["wheels_radius"] for slot, rim in zip(SLOTS, rims, strict=True)
    }


def mecanum_odometry(p: dict, rates: dict[str, float]) -> tuple[float, float, float]:
    k, offset = p["kinematics"], p["kinematics"]["base_frame_offset"]
    fl, fr, rr, rl = (0.25 * k["wheels_radius"] * rates[p[f"{slot}_wheel_command_joint_name"]] for slot in SLOTS)
    x, y = fl + rl + rr + fr, -fl + rl - rr + fr
    w = (-fl - rl + rr + fr) / k["sum_of_robot_center_projection_on_X_Y_axis"]
    c, s = math.cos(-offset["theta"]), math.sin(-offset["theta"])
    lx, ly = -c * offset["x"] + s * offset["y"], -s * offset["x"] - c * offset["y"]
    return c * x - s * y + ly * w, s * x + c * y - lx * w, w


def four(signs, x: float, y: float, radius: float, angles=(0.0, 0.0, 0.0), **said) -> Robot:
    places = {"fl": (x, y), "fr": (x, -y), "rr": (-x, -y), "rl": (-x, y)}
    wheels = {n: (*p, radius, (0, s, 0)) for (n, p), s in zip(places.items(), signs, strict=True)}
    return on_wheels(wheels, angles, base="holonomic", **said)


@given(st.tuples(*[SIGNS] * 4), st.floats(0.2, 0.4), st.floats(0.15, 0.35), LENGTHS, ANGLES, SIGNS, *[RATES] * 3)
@settings(max_examples=60, deadline=None)
def test_mecanum_wheels_roll_as_ours_or_are_refused_by_name(signs, x, y, radius, angles, rollers, vx, vy, w):
    """Both ways of mounting the rollers, axes all ahead or all back; mixed ones have no parameters."""
    assume(rollers > 0 or abs(x - y) > 0.01)  # else nothing turns it, and the loader says so
    robot = four(signs, x, y, radius, angles, roller=rollers * math.pi / 4)
    if len(set(signs)) > 1:
        with pytest.raises(ConfigError, match="run ahead at positive rates, or all back") as error:
            printed(robot, "mecanum_drive")
        assert turned_in(error.value) == {n for n, s in zip(("fl", "fr", "rr", "rl"), signs, strict=True) if s < 0}
        return
    p = printed(robot, "mecanum_drive")
    assert p["kinematics"]["wheels_radius"] > 0.0 and len({p[f"{s}_wheel_command_joint_name"] for s in SLOTS}) == 4
    if rollers > 0 and signs[0] > 0:
        assert [p[f"{s}_wheel_command_joint_name"] for s in SLOTS] == ["fl", "fr", "rr", "rl"]
        assert p["kinematics"]["sum_of_robot_center_projection_on_X_Y_axis"] == pytest.approx(x + y)
    rates = ours(robot, (vx, vy, w))
    assert mecanum_rates(p, vx, vy, w) == pytest.approx(rates, rel=1e-5, abs=1e-6)
    assert mecanum_odometry(p, rates) == pytest.approx((vx, vy, w), rel=1e-5, abs=1e-6)


def test_mecanum_wheels_of_two_radii_or_another_angle_are_refused():
    with pytest.raises(ConfigError, match="45 degrees"):
        printed(four((1, 1, 1, 1), 0.3, 0.2, 0.1, roller=0.6), "mecanum_drive")
    robot = four((1, 1, 1, 1), 0.3, 0.2, 0.1, roller=math.pi / 4).with_radii({"fl": 0.98})
    with pytest.raises(ConfigError, match=r"one radius for all wheels, not fl 0\.098 m, fr 0\.1 m"):
        printed(robot, "mecanum_drive")


# -- omni_wheel_drive_controller ---------------------------------------------------------------------------------------


def omni_matrix(p: dict) -> np.ndarray:
    n = len(p["wheel_names"])
    angles = [2 * math.pi / n * i + p["wheel_offset"] for i in range(n)]
    return np.array([(math.sin(t), -math.cos(t), -p["robot_radius"]) for t in angles])


@given(st.integers(3, 5), st.floats(-3.0, 3.0), st.floats(0.15, 0.4), LENGTHS, SIGNS, *[RATES] * 3)
@settings(max_examples=40, deadline=None)
def test_omni_wheels_roll_as_ours_or_are_refused_by_name(n, first, reach, radius, sign, vx, vy, w):
    angles = [first + 2 * math.pi * i / n for i in range(n)]
    axes = {f"w{i}": (math.cos(t), math.sin(t)) for i, t in enumerate(angles)}
    wheels = {name: (reach * c, reach * s, radius, (sign * c, sign * s, 0)) for name, (c, s) in axes.items()}
    robot = on_wheels(wheels, base="holonomic")
    rates = ours(robot, (vx, vy, w))
    if min(ours(robot, (0.0, 0.0, 1.0)).values()) > 0.0:  # they turn the base to the left
        with pytest.raises(ConfigError, match="turns the base to the right") as error:
            printed(robot, "omni_wheel_drive")
        assert turned_in(error.value) == set(wheels)
        return
    p = printed(robot, "omni_wheel_drive")
    assert p["wheel_radius"] > 0.0 and p["robot_radius"] > 0.0
    asked = omni_matrix(p) @ (vx, vy, w) / p["wheel_radius"]
    assert dict(zip(p["wheel_names"], asked, strict=True)) == pytest.approx(rates, rel=1e-5, abs=1e-6)
    told = np.linalg.lstsq(omni_matrix(p), np.array([rates[n] for n in p["wheel_names"]]) * p["wheel_radius"])[0]
    assert told == pytest.approx((vx, vy, w), rel=1e-5, abs=1e-6)
