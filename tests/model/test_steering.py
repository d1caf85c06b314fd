"""Bases that steer, found in files: what `steered.urdf_of` wrote is what is found, and Pinocchio says that it rolls.

The second answer is the contact point of every wheel by the spatial Jacobians of the file's own model.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from drives import CYLINDER, LIMIT, joint, link, robot_of
from hypothesis import given, settings
from hypothesis import strategies as st
from steered import LAYOUTS, Made, car, contact_rows, state, swerve, urdf_of
from test_base import LYING, wheel
from test_strange import chassis, followed, on_swivel, pair, steered, ways_of
from test_wild import codes

from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.model.base.report import Undecided, Unsupported
from mmnn_pin.model.base.steered import SteeredBase

SAID = {"loader": {"steer": ("waist",)}, "drive with trailer": {"hitch": ("hitch_0",)}}
CLOSE = {"abs": 1e-12, "rel": 1e-12}


def told(robot, code: str) -> str:
    return " ".join(f"{f.what} {f.why} {f.fix}" for f in robot.findings if f.code == code)


def compared(found: SteeredBase, made: SteeredBase) -> None:
    """Hold a base that was found against the one whose file it is."""
    assert found.kind == made.kind and found.frame == pytest.approx(made.frame, **CLOSE)
    assert [p.joint for p in found.pivots] == [p.joint for p in made.pivots]
    for one, other in zip(found.pivots, made.pivots, strict=True):
        assert (one.role, one.parent, one.sign, one.motor) == (other.role, other.parent, other.sign, other.motor)
        assert (one.x, one.y, *one.wheel) == pytest.approx((other.x, other.y, *other.wheel), **CLOSE)
        assert (one.lower, one.upper) == (other.lower, other.upper) and one.rate == 4.0
    wheels = {w.joint: w for w in made.wheels}
    assert wheels.keys() == {w.joint for w in found.wheels}
    for one in found.wheels:
        other = wheels[one.joint]
        assert (one.pivot, one.sign) == (other.pivot, other.sign)
        values = (one.radius, one.x, one.y, one.heading), (other.radius, other.x, other.y, other.heading)
        assert values[0] == pytest.approx(values[1], **CLOSE)


@pytest.mark.parametrize("name", LAYOUTS)
def test_what_is_found_is_what_the_file_was_made_of(name):
    made = LAYOUTS[name]()
    robot = robot_of(urdf_of(made), **SAID.get(name, {}))
    compared(robot.base, made)
    assert robot.joint_names == ("arm_1", "arm_2", "arm_3") and robot.base.locked == ()
    if robot.base.masters and not robot.base.sideways:
        assert robot.base.length == pytest.approx(made.length)


frames = st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-1.4, 1.4)).map(np.array)
cars = st.builds(car, st.floats(0.4, 2.0), st.floats(0.15, 0.6), st.floats(-0.05, 0.05))
corners = st.lists(st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)), min_size=2, max_size=6).filter(
    lambda c: (
        min(np.hypot(a - x, b - y) for i, (a, b) in enumerate(c) for x, y in c[:i]) > 0.25
        and np.ptp([x for x, _ in c]) > 0.1
    )
)


@settings(max_examples=25, deadline=None)
@given(cars, frames, st.integers(0, 9))
def test_a_car_anywhere_on_its_root_link_rolls(made, frame, seed):
    made = replace(made, frame=frame)
    found = robot_of(urdf_of(made)).base
    compared(found, made)
    rolls(Made(found, Made.of(made).model), seed)


@settings(max_examples=25, deadline=None)
@given(corners, st.integers(0, 9))
def test_wheels_that_all_steer_are_masters_about_their_middle(places, seed):
    middle = np.mean(places, axis=0)
    made = replace(swerve(tuple((x - middle[0], y - middle[1]) for x, y in places)), frame=np.array([*middle, 0.0]))
    found = robot_of(urdf_of(made)).base
    compared(found, made)
    assert found.length == pytest.approx(np.sqrt(np.mean(np.square(np.array(places) - middle).sum(axis=1))))


@pytest.mark.parametrize("name", LAYOUTS)
def test_the_wheels_of_what_is_found_neither_slip_nor_slide(name):
    made = LAYOUTS[name]()
    rolls(Made(robot_of(urdf_of(made), **SAID.get(name, {})).base, Made.of(made).model), 3)


def rolls(made: Made, seed: int) -> None:
    """Hold the motion of a base against the contact points of its file."""
    position, nu, n = state(made, np.random.default_rng(seed))
    velocity = made.T(position, n) @ nu
    slip = contact_rows(made, position) @ velocity
    assert np.abs(slip).max() < 1e-11 * np.abs(velocity).max()


# --- Masters and followers --------------------------------------------------------------------------------------------

MOTORS = '<ros2_control name="c" type="system">{}</ros2_control>'
MOTOR = '<joint name="{}"><command_interface name="position"/></joint>'
CAR = chassis(pair() + steered(0, 0.5, 0.2, 1) + steered(1, 0.5, -0.2, 1))


def with_motors(text: str, *names: str) -> str:
    return text.replace("</robot>", MOTORS.format("".join(map(MOTOR.format, names))) + "</robot>")


def roles(robot) -> dict[str, tuple[str, bool]]:
    return {p.joint: (p.role, p.motor) for p in robot.base.pivots}


def test_the_left_one_is_the_master_and_a_linkage_turns_the_other():
    assert roles(robot_of(CAR)) == {"steer0": ("master", True), "steer1": ("follower", False)}


def test_the_only_one_with_a_motor_is_the_master():
    robot = robot_of(with_motors(CAR, "steer1", "left", "right"))
    assert roles(robot) == {"steer0": ("follower", False), "steer1": ("master", True)}
    assert [w.joint for w in robot.base.wheels if w.driven] == ["left", "right"]
    assert robot.actuator_names == ("left", "right", "steer1", "shoulder", "elbow")


def test_a_follower_has_the_motor_that_the_file_gives_it():
    robot = robot_of(with_motors(CAR, "steer0", "steer1", "left", "right"))
    assert roles(robot) == {"steer0": ("master", True), "steer1": ("follower", True)}


def test_the_master_of_a_mimic_is_the_master():
    at = CAR.index("</joint>", CAR.index('name="steer0"'))
    robot = robot_of(with_motors(CAR[:at] + '<mimic joint="steer1"/>' + CAR[at:], "steer0", "steer1"))
    assert roles(robot) == {"steer0": ("follower", False), "steer1": ("master", True)}
    assert robot.arm.slaves == {}


def test_one_motor_on_an_axle_that_turns_as_a_whole_steers_both_wheels():
    fork = link("bogie", 2.0) + joint(
        "wagon", "revolute", "base", "bogie", p=(0.6, 0, 0.1), axis=(0, 0, 1), more=LIMIT.format(-1, 1)
    )
    robot = robot_of(chassis(pair() + fork + "".join(wheel(n, (0, y, 0), parent="bogie") for n, y in SIDES)))
    assert robot.base.kind == "tricycle" and robot.base.pivots[0].wheel == pytest.approx((0.0, 0.0, 0.0))
    assert {w.joint for w in robot.base.wheels} == {"left", "right", "front_left", "front_right"}


SIDES = (("front_left", 0.2), ("front_right", -0.2))


# --- Wheels without a joint, joints of bicycle models -----------------------------------------------------------------


def spinless(name: str, x: float, y: float, more: str = LIMIT.format(-0.6, 0.6)) -> str:
    body = link(f"{name}_link", 0.5, 0.002, CYLINDER.format(r=0.1), LYING)
    return body + joint(name, "revolute", "base", f"{name}_link", p=(x, y, 0.1), axis=(0, 0, 1), more=more)


def test_steered_wheels_without_a_joint_to_spin_about_only_steer():
    robot = robot_of(chassis(pair() + spinless("a", 0.5, 0.2) + spinless("b", 0.5, -0.2)))
    assert robot.base.kind == "car_like" and robot.base.shape == ("a", "b")
    assert [w.joint for w in robot.base.wheels] == ["left", "right"]
    assert "have no joint to spin about" in told(robot, "base-steered")


@given(st.floats(0.05, 0.6), st.floats(0.0, 0.3))
@settings(max_examples=8, deadline=None)
def test_steering_that_hangs_on_what_spins_is_refused_and_the_other_order_is_a_car(ahead, out):
    rolled, right = pair(), pair()
    for n, side in (("a", 1.0), ("b", -1.0)):
        body = link(f"{n}_link", 0.5, 0.002, CYLINDER.format(r=0.1), LYING) + link(f"{n}_carrier", 0.5, 0.002)
        near, far = (0.3, 0.2 * side, 0.1), (ahead, out * side, 0)
        turn = {"axis": (0, 0, 1), "more": LIMIT.format(-0.6, 0.6)}
        rolled += body + joint(f"{n}_spin", "continuous", "base", f"{n}_carrier", p=near)
        rolled += joint(f"{n}_steer", "revolute", f"{n}_carrier", f"{n}_link", p=far, **turn)
        right += body + joint(f"{n}_steer", "revolute", "base", f"{n}_carrier", p=near, **turn)
        right += joint(f"{n}_spin", "continuous", f"{n}_carrier", f"{n}_link")
    with pytest.raises(Unsupported, match="'a_steer' hangs on 'a_spin', which turns without end about a level axis"):
        robot_of(chassis(rolled))
    assert robot_of(chassis(right)).base.kind == "car_like"


def test_powered_pivots_that_are_called_casters_steer_pairs_and_are_asked_about_above_one_wheel():
    names = ("caster_fl", "caster_fr", "caster_rl", "caster_rr")
    places = {n: (x, y, 0.1) for n, x, y in zip(names, (0.3, 0.3, -0.3, -0.3), (0.2, -0.2, 0.2, -0.2), strict=True)}
    motor = '<transmission name="t_{0}"><joint name="{0}"/></transmission>'
    single = "".join(on_swivel(n, p) + motor.format(n) + motor.format(f"{n}_swivel") for n, p in places.items())
    with pytest.raises(Undecided) as error:
        robot_of(chassis(single))
    steer = error.value.fix.split()[1].split(",")
    assert error.value.fix.startswith("--steer ") and robot_of(chassis(single), steer=steer).base.kind == "swerve"
    kinds = [followed(chassis(single), way).base.kind for way in ways_of(error.value.fix)]
    assert kinds == ["holonomic", "fixed"]
    assert robot_of(chassis(single.replace("caster", "module"))).base.kind == "swerve"
    pairs = "".join(
        link(f"{n}_fork", 0.3, 0.002)
        + joint(f"{n}_swivel", "continuous", "base", f"{n}_fork", p=p, axis=(0, 0, 1))
        + "".join(wheel(f"{n}_{k}", (0, y, 0), parent=f"{n}_fork") + motor.format(f"{n}_{k}") for k, y in SIDES_OF)
        + motor.format(f"{n}_swivel")
        for n, p in places.items()
    )
    assert robot_of(chassis(pairs)).base.kind == "swerve"


def test_four_pivots_that_do_not_trail_may_all_steer_though_motors_tell_two_apart():
    corners = zip(("fl", "fr", "rl", "rr"), (0.3, 0.3, -0.3, -0.3), (0.2, -0.2, 0.2, -0.2), strict=True)
    text = "".join(on_swivel(f"steer_{n}", (x, y, 0.1)) for n, x, y in corners)
    motors = '<transmission name="t_{0}"><joint name="{0}"/></transmission>'
    text = chassis(text + motors.format("steer_fl") + motors.format("steer_fr"))
    with pytest.raises(Undecided, match="no trail: casters could not follow") as error:
        robot_of(text)
    assert "--wheels" not in error.value.fix and error.value.fix.startswith("--steer ")
    robot = robot_of(text, steer=error.value.fix.split()[1].split(","))
    assert robot.base.kind == "swerve" and len(robot.base.pivots) == 4


SIDES_OF = (("l", 0.05), ("r", -0.05))


def test_a_virtual_wheel_that_others_mimic_is_the_master():
    virtual = link("v_link", 0.1) + joint(
        "virtual", "revolute", "base", "v_link", p=(0.5, 0, 0.1), axis=(0, 0, 1), more=LIMIT.format(-0.6, 0.6)
    )
    follow = LIMIT.format(-0.6, 0.6) + '<mimic joint="virtual"/>'
    text = chassis(pair() + virtual + spinless("a", 0.5, 0.2, follow) + spinless("b", 0.5, -0.2, follow))
    robot = robot_of(text)
    assert robot.base.shape == ("virtual",) and robot.base.length == pytest.approx(0.5)
    assert {*robot.arm.slaves} == {"a", "b"}
    T = robot.T_at(robot.rest)
    row = {name: T[i] for i, name in enumerate(robot.full_velocity_names)}
    assert np.array_equal(row["a"], row["virtual"]) and row["virtual"].any()


def test_virtual_joints_in_the_middle_of_the_axles_stand_still():
    ends = "".join(
        link(f"{n}_link", 0.1) + joint(n, "continuous", "base", f"{n}_link", p=p, axis=axis)
        for n, p, axis in (("middle", (0, 0, 0.1), (0, 1, 0)), ("between", (0.5, 0, 0.1), (0, 0, 1)))
    )
    robot = robot_of(CAR.replace("</robot>", ends + "</robot>"))
    assert {*robot.arm.locked} >= {"middle", "between"} and robot.joint_names == ("shoulder", "elbow")


# --- Limits, wheelbase ------------------------------------------------------------------------------------------------


def test_steering_without_limits_is_told_with_the_option_that_sets_them():
    robot = robot_of(with_motors(chassis(pair() + "".join(on_swivel(n, (0.5, y, 0.1)) for n, y in SIDES)), "x"))
    assert robot.base.kind == "car_like" and "--steering-limit RAD" in told(robot, "base-limit")
    text = chassis(pair() + "".join(on_swivel(n, (0.5, y, 0.1)) for n, y in SIDES))
    limited = robot_of(text, steering_limit=0.5)
    assert {(p.lower, p.upper) for p in limited.base.pivots} == {(-0.5, 0.5)} and "base-limit" not in codes(limited)


def test_a_linkage_that_stands_in_simulator_elements_is_told():
    corners = [(x, y) for x in (0.5, -0.5) for y in (0.2, -0.2)]
    text = chassis("".join(steered(i, x, y, 0.6) for i, (x, y) in enumerate(corners)))
    rod = (
        '<gazebo><joint name="rod" type="revolute"><parent>fork0</parent><child>fork{}</child></joint></gazebo></robot>'
    )
    robot = robot_of(text.replace("</robot>", rod.format(1)))
    assert robot.base.kind == "swerve" and "hold steer0, steer1: here each" in told(robot, "base-linkage")
    assert "base-linkage" not in codes(robot_of(text)) | codes(robot_of(text.replace("</robot>", rod.format("x"))))


def test_equal_limits_are_refused_with_a_fix_that_works():
    text = chassis(pair() + steered(0, 0.5, 0.2, 0.0) + steered(1, 0.5, -0.2, 0.0))
    with pytest.raises(Unsupported, match="'steer0', 'steer1' are one value") as error:
        robot_of(text)
    assert "--steering-limit RAD" in error.value.fix
    assert robot_of(text, steering_limit=0.5).base.pivots[0].upper == 0.5


def test_a_wheelbase_that_is_stated_otherwise_is_told_and_can_be_taken():
    plugin = '<gazebo><plugin name="p" filename="libackermann.so"><wheel_base>0.55</wheel_base></plugin></gazebo>'
    robot = robot_of(CAR.replace("</robot>", plugin + "</robot>"))
    assert robot.base.length == pytest.approx(0.5) and "--wheelbase 0.55" in told(robot, "base-stated")
    taken = robot_of(CAR.replace("</robot>", plugin + "</robot>"), wheelbase=0.55)
    assert taken.base.length == 0.55 and [p.x for p in taken.base.pivots] == pytest.approx([0.55, 0.55])
    assert "base-stated" not in codes(taken)


@pytest.mark.parametrize(("said", "wrong"), [
    ({"wheelbase": 0.5}, "a wheelbase for a base 'differential_drive'"),
    ({"steering_limit": 0.5}, "a steering limit for a base 'differential_drive'"),
    ({"steer": ("shoulder",)}, "joint 'shoulder' cannot be a pivot"),
    ({"base": "car_like"}, "this is no 'car_like'"),
])  # fmt: skip
def test_what_is_said_of_steering_must_suit_the_robot(said, wrong):
    with pytest.raises(ConfigError, match=re.escape(wrong)):
        robot_of(chassis(pair()), **said)
    with pytest.raises(UnknownName):
        robot_of(CAR, hitch=("nowhere",))


def test_what_steers_cannot_be_locked_or_freed():
    with pytest.raises(ConfigError, match="cannot be locked: it is part of the base"):
        robot_of(CAR, lock=("steer0",))
    with pytest.raises(ConfigError, match="part of the base"):
        robot_of(CAR, free=("steer0",))
    assert {"steer0", "steer1", "left"} <= {*robot_of(CAR, base="fixed").arm.locked}
    pushed = robot_of(CAR, base="holonomic")
    assert pushed.base.pushes and "steers them stands still" in told(pushed, "base-pushed")


# --- Trailers and loaders ---------------------------------------------------------------------------------------------


def trailer(name: str = "hitch", parent: str = "base", at=(-0.3, 0, 0.1), rows=(-0.8,), radius: float = 0.1) -> str:
    text = link(f"{name}_body", 8.0, 0.5) + joint(name, "continuous", parent, f"{name}_body", p=at, axis=(0, 0, 1))
    for i, x in enumerate(rows):
        sides = (("l", 0.3), ("r", -0.3))
        text += "".join(wheel(f"{name}_{s}{i}", (x, y, 0), parent=f"{name}_body", radius=radius) for s, y in sides)
    return text


@pytest.mark.parametrize("turn", (1.5708, -1.5708))
def test_a_car_drawn_along_y_faces_what_steers_and_its_trailer_is_behind(turn):
    ends = '<parent link="top"/><child link="base"/>'
    top = f'<link name="top"/><joint name="turn" type="fixed">{ends}<origin rpy="0 0 {turn}"/></joint>'
    for text in (CAR, CAR.replace("</robot>", trailer() + "</robot>")):
        base = robot_of(text.replace("</robot>", top + "</robot>")).base
        assert base.frame[2] == pytest.approx(turn, abs=1e-3) and base.pivots[0].x == pytest.approx(0.5)
    pulled = [p for p in base.pivots if p.joint == "hitch"]
    assert [(p.role, p.x) for p in pulled] == [("passive", pytest.approx(-0.3))]


def test_two_axles_with_a_vertical_joint_between_are_asked_for_and_the_ways_lead_on():
    with pytest.raises(
        Undecided, match="--hitch hitch if it follows freely; --steer hitch if a motor turns it"
    ) as error:
        robot_of(chassis(pair() + trailer()))
    assert "--steer hitch" in error.value.fix and "--hitch hitch" in error.value.fix
    assert robot_of(chassis(pair() + trailer()), steer=("hitch",)).base.kind == "articulated"
    assert robot_of(chassis(pair() + trailer()), base="articulated").base.kind == "articulated"
    behind = robot_of(chassis(pair() + trailer()), hitch=("hitch",))
    assert behind.base.kind == "drive_trailer" and behind.velocity_names[:2] == ("v", "w")


def test_a_loader_on_wheels_larger_than_its_tread_is_asked_for_too():
    text = chassis(pair(0.35) + trailer(at=(-0.8, 0, 0.35), radius=0.35))
    with pytest.raises(Undecided, match="--hitch hitch if it follows freely; --steer hitch if a motor turns it"):
        robot_of(text)
    assert robot_of(text, steer=("hitch",)).base.kind == "articulated"


def test_casters_with_motors_behind_two_wheels_are_casters_with_a_doubt():
    trailing = "".join(on_swivel(n, (-0.5, y, 0.1), trail=0.08) for n, y in (("bl", 0.2), ("br", -0.2)))
    text = with_motors(chassis(pair() + trailing), "bl_swivel", "br_swivel")
    robot = robot_of(text)
    assert robot.base.kind == "differential_drive" and "not car_like" in told(robot, "base-doubt")
    with pytest.raises(Unsupported, match="wheels off their pivots") as error:
        robot_of(text, steer=("bl_swivel", "br_swivel"))
    assert "--wheels left,right if they are casters" in error.value.fix


def test_motors_tell_a_loader_from_a_drive_with_a_trailer():
    loader = robot_of(with_motors(chassis(pair() + trailer()), "left", "right", "hitch"))
    pulls = robot_of(with_motors(chassis(pair() + trailer()), "left", "right"))
    assert roles(loader) == {"hitch": ("master", True)} and loader.base.length == pytest.approx(1.1)
    assert roles(pulls) == {"hitch": ("passive", False)}
    assert [w.joint for w in pulls.base.wheels if w.driven] == ["left", "right"]


def test_a_skid_steer_base_pulls_a_trailer_with_its_effective_track():
    four = pair() + "".join(wheel(n, (-0.4, y, 0.1)) for n, y in (("bl", 0.25), ("br", -0.25)))
    plugin = '<gazebo><plugin name="p" filename="libskid_steer_drive.so"/></gazebo>'
    robot = robot_of(chassis(four + trailer(at=(-0.8, 0, 0.1)) + plugin), hitch=("hitch",), track=0.7)
    assert robot.base.kind == "drive_trailer" and robot.base.turning > 0
    assert {abs(w.y) for w in robot.base.wheels if w.pivot < 0} == {0.35}


def test_the_axles_of_a_long_trailer_slide_about_their_middle():
    robot = robot_of(CAR.replace("</robot>", trailer(rows=(-0.7, -0.9)) + "</robot>"))
    assert robot.base.kind == "trailer" and robot.base.pivots[-1].wheel[0] == pytest.approx(-0.8)
    assert {w.grips for w in robot.base.wheels if w.pivot == 2} == {False} and "several axles" in told(
        robot, "base-scrub"
    )


def test_a_caster_that_trails_stays_one_beside_wheels_that_steer():
    robot = robot_of(CAR.replace("</robot>", on_swivel("c", (-0.4, 0, 0.1), 0.04) + "</robot>"))
    assert robot.base.kind == "car_like" and {*robot.base.casters} == {"c_swivel", "c"}


# --- What is refused, and what its fix leads to -----------------------------------------------------------------------


def test_several_vehicles_are_no_base():
    front = trailer("link", at=(-1.0, 0, 0.1)).replace(
        "</robot>", ""
    ) + "".join(
        link(f"k{i}", 0.5)
        + joint(f"s{i}", "revolute", "link_body", f"k{i}", p=(-1.6, y, 0), axis=(0, 0, 1), more=LIMIT.format(-1, 1))
        + wheel(f"t{i}", (0, 0, 0), parent=f"k{i}")
        for i, y in enumerate((0.3, -0.3))
    )  # fmt: skip
    with pytest.raises(Unsupported, match=r"several vehicles, linked perhaps: .*'s0' on 'link'"):
        robot_of(CAR.replace("</robot>", front + "</robot>"))


def test_two_steered_wheels_on_one_line_are_refused_and_drive_with_their_steering_locked_by_request_alone():
    text = chassis(steered(0, 0.0, 0.2, 1) + steered(1, 0.0, -0.2, 1) + on_swivel("c", (-0.4, 0, 0.1), 0.04))
    with pytest.raises(Unsupported, match="stand on one line") as error:
        robot_of(text)
    assert "--wheels" not in error.value.fix and followed(text, ways_of(error.value.fix)[0]).base.pushes
    robot = robot_of(text, wheels=("w0", "w1"))
    assert robot.base.kind == "differential_drive" and {"steer0", "steer1"} <= {*robot.base.suspensions}


def test_one_steered_wheel_alone_is_no_base():
    with pytest.raises(Unsupported, match="one wheel steers and nothing else holds it"):
        robot_of(chassis(steered(0, 0.5, 0.0, 1)))


def test_of_fixed_wheels_on_several_lines_those_hold_that_the_user_names():
    text = chassis(pair() + "".join(wheel(n, (-0.4, y, 0.1)) for n, y in (("bl", 0.25), ("br", -0.25))))
    text = text.replace("</robot>", steered(0, 0.5, 0.2, 1) + steered(1, 0.5, -0.2, 1) + "</robot>")
    with pytest.raises(Unsupported, match="stand on several lines") as error:
        robot_of(text)
    found = [followed(text, way) for way in ways_of(error.value.fix) if "wheels" in way]
    assert {round(robot.base.length, 6) for robot in found} == {0.5, 0.9}
    assert {robot.base.casters for robot in found} == {("bl", "br"), ("left", "right")}


def test_an_axis_of_a_steering_joint_that_lies_is_told_as_it_should_be():
    level = CAR.replace('<axis xyz="0.0 0.0 1.0"/>' + LIMIT.format(-1, 1), '<axis xyz="1 0 0"/>' + LIMIT.format(-1, 1))
    assert level != CAR
    with pytest.raises(Unsupported, match="'steer0', 'steer1' steer by their names") as error:
        robot_of(level)
    axis = re.search(r"write (<axis [^>]*/>) in 'steer0', 'steer1'", error.value.fix)[1]
    assert robot_of(level.replace('<axis xyz="1 0 0"/>', axis)).base.kind == "car_like"


def test_a_wheel_that_trails_under_a_stop_beside_others_is_refused():
    fork = link("fork9", 0.5) + wheel("w9", (-0.06, 0, 0), parent="fork9")
    fork += joint("steer9", "revolute", "base", "fork9", p=(0.5, -0.2, 0.1), axis=(0, 0, 1), more=LIMIT.format(-1, 1))
    with pytest.raises(Unsupported, match=r"the wheel under 'steer9' stands 0.06 m behind its axis"):
        robot_of(chassis(pair() + steered(0, 0.5, 0.2, 1) + fork))


def test_welded_modules_are_named_with_what_makes_them_turn():
    text = "".join(
        link(f"k{i}", 0.5) + joint(f"s{i}", "fixed", "base", f"k{i}", p=(x, y, 0.1), axis=(0, 0, 1))
        + link(f"r{i}", 0.5, 0.002, CYLINDER.format(r=0.1), LYING)
        + joint(f"w{i}", "fixed", f"k{i}", f"r{i}", axis=(0, 1, 0))
        for i, (x, y) in enumerate(((0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2)))
    )  # fmt: skip
    with pytest.raises(Undecided, match="are welded on") as error:
        robot_of(chassis(text))
    names = re.search(r'write type="continuous" in ((?:\'\w+\'(?:, )?)+)', error.value.fix)[1]
    turning = chassis(text)
    for name in re.findall(r"'(\w+)'", names):
        turning = turning.replace(f'name="{name}" type="fixed"', f'name="{name}" type="continuous"')
    assert robot_of(turning).base.kind == "swerve" and len(robot_of(turning).base.masters) == 4


def test_pivots_that_lean_make_wheels_slide_and_that_is_told():
    upright, leans = robot_of(CAR), robot_of(CAR.replace('<axis xyz="0.0 0.0 1.0"/>' + LIMIT.format(-1, 1), '<axis xyz="0.12 0.1 1"/>' + LIMIT.format(-1, 1)))  # fmt: skip # noqa: E501
    assert "base-scrub" not in codes(upright)
    assert "slide sideways" in told(leans, "base-scrub")


# --- The controllers' file --------------------------------------------------------------------------------------------


def test_controllers_tell_what_drives_and_what_steers(tmp_path):
    file = tmp_path / "controllers.yaml"
    file.write_text(
        "bicycle_steering_controller:\n  ros__parameters:\n    traction_joints_names: [left, right]\n"
        "    steering_joints_names: [swivel_swivel]\n    wheelbase: 0.6\n    traction_wheel_radius: 0.1\n"
        "controller_manager:\n  ros__parameters:\n    steering:\n"
        "      type: bicycle_steering_controller/BicycleSteeringController\n"
    )
    text = chassis(pair() + on_swivel("swivel", (0.5, 0, 0.1)))
    with pytest.raises(Undecided):
        robot_of(text)
    robot = robot_of(text, controllers_file=str(file))
    assert robot.base.kind == "tricycle" and roles(robot) == {"swivel_swivel": ("master", True)}
    assert [w.joint for w in robot.base.wheels if w.driven] == ["left", "right"]
    assert "--wheelbase 0.6" in told(robot, "base-stated")
    again = robot_of(text, **{k: v for k, v in robot.overrides.stated().items() if k != "controllers_file"})
    assert again.base.kind == "tricycle" and again.actuator_names == robot.actuator_names  # a recording stands alone


# --- Where joints do not rest at 0 ------------------------------------------------------------------------------------


def test_a_pivot_that_cannot_be_at_zero_is_placed_as_if_it_were_there():
    stops = LIMIT.format(-1, 1), LIMIT.format(0.2, 1.2)
    turned = robot_of(CAR.replace(*stops)).base
    compared_at_zero = [(p.x, p.y, *p.wheel) for p in robot_of(CAR).base.pivots]
    assert [(p.x, p.y, *p.wheel) for p in turned.pivots] == [pytest.approx(each) for each in compared_at_zero]
    assert {(p.lower, p.upper) for p in turned.pivots} == {(0.2, 1.2)}
    assert [w.heading for w in turned.wheels] == pytest.approx([0.0] * 4)


def test_wheels_far_above_a_footprint_are_asked_for_and_may_be_named():
    foot = '<link name="base_footprint"/>' + joint("foot", "fixed", "base_footprint", "base", p=(0, 0, 0.25))
    with pytest.raises(Undecided, match=r"0\.25 m above the root link 'base_footprint'") as error:
        robot_of(chassis(pair() + foot))
    kinds = [followed(chassis(pair() + foot), way).base.kind for way in ways_of(error.value.fix)]
    assert kinds == ["tracked", "differential_drive", "holonomic", "fixed"]
