"""Forward: what signs say of it one by one and together, and that the user's word counts more than all of them."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from drives import ARM, CYLINDER, SPHERE, Drive, joint, link, origin, robot_of
from hypothesis import given, settings
from hypothesis import strategies as st
from test_base import four, wheel
from test_strange import chassis
from test_wheels import caster, swerve
from test_wild import codes, star

from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.model.base.heading import left_first
from mmnn_pin.model.base.overrides import FORWARD
from mmnn_pin.model.base.report import Undecided
from mmnn_pin.model.base.wheels import wheel_of
from mmnn_pin.model.urdf.finding import AuditError, Finding
from mmnn_pin.model.urdf.reading import parse
from mmnn_pin.model.urdf.shapes import AtRest

ACROSS = Drive(frame=(0.0, 0.0, math.pi / 2), names=("a", "b"), flips=(1, -1))  # nothing tells +y from -y
PLAIN = ARM.replace('xyz="0.1 0.0 1.0"', 'xyz="0.0 0.0 1.0"')  # an arm in the middle of the axle
BALL = SPHERE.format(r=0.05)


def heading(robot) -> float:
    """Of the control frame, in degrees."""
    return round(math.degrees(robot.base.frame[2]), 6)


def asked(text: str, **said: Any) -> Finding:
    """The question where forward is; what it prints for each direction leads there."""
    with pytest.raises(AuditError) as error:
        robot_of(text, **said)
    (told,) = (f for f in error.value.errors if f.code == "base-heading")
    ways = re.findall(r"--forward (-?[xy])", told.fix)
    assert len({heading(robot_of(text, **said, forward=way)) for way in ways}) == len(ways) == 2
    return told


def held(name: str, at: tuple[float, float, float], shape: str = "", R=None) -> str:
    """A body on the base."""
    return link(name, 0.1, 1e-4, shape) + joint(f"{name}_j", "fixed", "base", name, R, at)


# --- Signs one by one -------------------------------------------------------------------------------------------------


def test_where_nothing_tells_it_asks_and_what_it_prints_is_the_way_out():
    assert asked(ACROSS.urdf(PLAIN)).fix == "--forward y, or --forward -y"
    other = robot_of(ACROSS.urdf(PLAIN), forward="-y")
    assert heading(other) == -90


PLUGIN = "<gazebo><plugin name='d' filename='x'><{0}>a</{0}><{1}>b</{1}></plugin></gazebo>"
TELLING = {
    "a caster": held("ball", (0.0, 0.2, 0.05), BALL),
    "the place of a camera": held("camera", (0.0, -0.2, 0.5)),
    "the view of a camera": held("camera_optical_frame", (0, 0, 0.5), R=np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])),
    "the place of an arm": ARM.replace('xyz="0.1 0.0 1.0"', 'xyz="0.0 -0.1 1.0"')
    + link("hand") + joint("wrist", "continuous", "fore", "hand", p=(0.2, 0, 0)),
    "a bumper": held("front_bumper", (0.0, -0.2, 0.2)),
    "a rear bumper": held("rear_bumper", (0.0, 0.2, 0.2)),
    "two arms": held("left_mount", (0.2, 0, 0.5)) + held("right_mount", (-0.2, 0, 0.5)),
    "a plugin": PLUGIN.format("right_joint", "left_joint"),
    "a plugin in camel case": PLUGIN.format("rightWheelJoint", "leftWheelJoint"),
}  # fmt: skip
WEAK = ("a caster", "the place of a camera", "the place of an arm")


@pytest.mark.parametrize("name", TELLING)
def test_each_sign_alone_turns_a_base_that_could_drive_either_way_and_a_weak_one_asks_for_it_first(name):
    text = ACROSS.urdf((PLAIN if "shoulder" not in TELLING[name] else "") + TELLING[name])
    if name in WEAK:
        assert asked(text).fix == "--forward -y, or --forward y"
    else:
        assert heading(robot_of(text)) == -90


@pytest.mark.parametrize(("left", "right"), [
    ("left", "right"), ("wheel_l", "wheel_r"), ("WheelLeft", "WheelRight"), ("lft_wheel", "rgt_wheel"),
    ("roue_gauche", "roue_droite"), ("rueda_izquierda", "rueda_derecha"), ("ruota_sinistra", "ruota_destra"),
    ("linkes_rad", "rechtes_rad"), ("roda_esquerda", "roda_direita"), ("bl_wheel", "br_wheel"), ("wheel_1", "right_2"),
])  # fmt: skip
@pytest.mark.parametrize("turn", [90, -90])
def test_names_of_sides_say_where_a_base_drives_whose_axle_is_along_x(left, right, turn):
    drive = Drive(frame=(0.0, 0.0, math.radians(turn)), names=(left, right), flips=(1, -1))
    robot = robot_of(drive.urdf(PLAIN))
    assert heading(robot) == turn and [w.joint for w in robot.base.wheels] == [left, right]
    assert not {"base-heading", "base-sides"} & codes(robot).keys()


def test_controllers_say_left_and_right(tmp_path):
    file = tmp_path / "c.yaml"
    file.write_text("base:\n  left_wheel_names: ['b']\n  right_wheel_names: ['a']\n")
    robot = robot_of(ACROSS.urdf(PLAIN), controllers_file=str(file))
    assert heading(robot) == -90
    again = robot_of(robot.urdf, **robot.facts()["overrides"])  # without the file
    assert heading(again) == -90 and np.array_equal(again.T, robot.T)


# --- Signs together ---------------------------------------------------------------------------------------------------


def test_names_alone_against_x_are_asked_about_and_with_more_for_x_they_are_told():
    text = Drive(names=("right_wheel", "left_wheel")).urdf(PLAIN)
    told = asked(text)
    assert told.fix == "--forward x, or --forward -x" and "names of left and right wheels" in told.why
    robot = robot_of(text.replace("</robot>", held("camera", (0.2, 0, 0.5)) + "</robot>"))
    assert heading(robot) == 0 and "base-sides" in codes(robot)


def test_names_rates_and_a_plugin_together_do():
    """As a simulator would drive it: both rates positive, the joint that it calls left on the left."""
    drive = Drive(names=("right_wheel", "left_wheel"), flips=(-1, -1))
    plugin = PLUGIN.format("left_joint", "right_joint").replace(">a<", ">left_wheel<").replace(">b<", ">right_wheel<")
    told = asked(drive.urdf(PLAIN + plugin))
    assert told.fix == "--forward -x, or --forward x"
    robot = robot_of(drive.urdf(PLAIN + plugin), forward="-x")
    assert heading(robot) == 180 and [w.joint for w in robot.base.wheels] == ["left_wheel", "right_wheel"]
    assert [w.sign for w in robot.base.wheels] == [1, 1]


def test_a_base_that_looks_along_minus_y_is_found_so():
    """Wheels on an axle along x, the left one at +x, a ball behind, the arm ahead: nothing is left in doubt."""
    drive = Drive(frame=(0.0, 0.0, -math.pi / 2), names=("lft_wheel", "rgt_wheel"))
    ahead = ARM.replace('xyz="0.1 0.0 1.0"', 'xyz="0.0 -0.1 1.0"')
    robot = robot_of(drive.urdf(ahead + held("ball", (0.0, 0.2, 0.05), BALL)))
    assert heading(robot) == -90 and [w.y for w in robot.base.wheels] == pytest.approx([0.2, -0.2])
    assert not {"base-heading", "base-sides"} & codes(robot).keys()


@pytest.mark.parametrize(("names", "flips", "forward"), [
    (("a", "b"), (1, 1), 90), (("a", "b"), (-1, -1), -90), (("left", "right"), (-1, -1), 90)])  # fmt: skip
def test_where_rates_alone_tell_or_stand_against_names_nothing_is_asked_and_it_is_told(names, flips, forward):
    robot = robot_of(Drive(frame=(0.0, 0.0, math.pi / 2), names=names, flips=flips).urdf(PLAIN))
    assert heading(robot) == forward and "base-heading" not in codes(robot)
    assert "positive rates of the wheels" in next(f for f in robot.findings if f.code == "base-sides").why


@pytest.mark.parametrize(("base", "asks"), [("skid_steer", False), ("holonomic", True)])
def test_rates_tell_no_forward_of_what_moves_sideways_too(base, asks):
    wheels = [wheel(f"w{x}{y}", (x, y, 0.1), (1, 0, 0), yaw=math.pi / 2) for x in (-0.2, 0.2) for y in (-0.3, 0.3)]
    text = f'<robot name="r">{link("base", 20.0, 0.8)}{PLAIN}{"".join(wheels)}</robot>'
    assert asked(text, base=base) if asks else heading(robot_of(text, base=base)) == -90


def test_wheels_on_crossed_axles_look_where_names_and_eyes_say():
    half = held("front_plate", (0.0, 0.3, 0.2)) + held("rear_plate", (0.0, -0.3, 0.2))
    more = half + held("camera", (0.0, 0.3, 0.4), R=np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    assert heading(robot_of(star(3, CYLINDER.format(r=0.05), more=PLAIN))) == 0
    robot = robot_of(star(3, CYLINDER.format(r=0.05), more=PLAIN + more))
    assert heading(robot) == 90
    assert asked(star(3, CYLINDER.format(r=0.05), more=PLAIN + half))
    assert np.abs(robot.A @ robot.T).max() < 1e-12


# --- What the user says -----------------------------------------------------------------------------------------------


@given(st.floats(-math.pi, math.pi), st.sampled_from([*FORWARD]), st.booleans())
@settings(max_examples=40, deadline=None)
def test_what_the_user_says_wins_against_all_signs(turn, forward, swapped):
    text = Drive(frame=(0.1, -0.2, turn), names=("left", "right")[:: -1 if swapped else 1]).urdf()
    along = np.array([math.cos(turn), math.sin(turn)]) @ FORWARD[forward]
    if abs(along) < 0.1:
        with pytest.raises(ConfigError, match=f"{forward} cannot be forward: its wheels roll along [xy]: --forward"):
            robot_of(text, forward=forward)
        return
    frame = robot_of(text, forward=forward).base.frame
    assert np.cos(frame[2] - turn) == pytest.approx(np.sign(along))
    assert frame[:2] == pytest.approx([0.1, -0.2])


@given(st.floats(-math.pi, math.pi), st.booleans(), st.tuples(*[st.sampled_from([1, -1])] * 2))
@settings(max_examples=20, deadline=None)
def test_the_wheel_that_is_named_first_is_the_left_one(turn, swapped, flips):
    text = Drive(frame=(0.0, 0.0, turn), flips=flips).urdf()
    names = ("right", "left") if swapped else ("left", "right")
    robot = robot_of(text, wheels=names)
    assert [w.joint for w in robot.base.wheels] == [*names] and robot.base.wheels[0].y > 0
    assert np.cos(robot.base.frame[2] - turn) == pytest.approx(-1 if swapped else 1)


@pytest.mark.parametrize("names", [("left", "right"), ("right", "left")])
@pytest.mark.parametrize("shape", [CYLINDER.format(r=0.1), '<box size="0.2 0.1 0.03"/>'])
def test_a_printed_way_names_the_left_wheel_first_whatever_the_order_in_the_file(names, shape):
    at = {"left": 0.2, "right": -0.2}
    ends = "".join(wheel(n, (0.0, at[n], 0.1)).replace(CYLINDER.format(r=0.1), shape) for n in names)
    with pytest.raises(Undecided) as error:
        robot_of(chassis(ends + wheel("back", (-0.25, 0, 0.1)).replace(CYLINDER.format(r=0.1), shape)))
    assert "--wheels left,right" in error.value.fix and "right,left" not in error.value.fix


def test_wheels_without_a_partner_stay_in_their_order():
    rest = AtRest(parse(chassis(wheel("a", (0, 0.2, 0.1)) + wheel("b", (0.3, -0.2, 0.1))).encode(), "r.urdf"))
    wheels = [wheel_of(rest, rest.document.joints[name]) for name in ("b", "a")]
    assert [left_first(rest, some) for some in ([], wheels[:1], wheels)] == [[], wheels[:1], wheels]


def test_a_base_that_is_turned_rolls_as_before():
    """Forward the other way round: v changes its sign, w does not; the wheels' rates are the same."""
    ahead, astern = robot_of(four(), wheels=("fl", "fr")), robot_of(four(), wheels=("fr", "fl"))
    rows = [[r.full_velocity_names.index(name) for name in ("fl", "fr")] for r in (ahead, astern)]
    np.testing.assert_allclose(ahead.T[rows[0], :2], astern.T[rows[1], :2] * (-1, 1), atol=1e-12)
    told = next(f for f in astern.findings if f.code == "base-sides")
    assert "'fr' is the left wheel as you said" in told.message and told.fix == "--forward -x, or --forward x"
    assert "base-sides" not in codes(ahead)
    assert heading(robot_of(four(), wheels=("fr", "fl"), forward="x")) == 0  # the plainer word


def test_what_steers_is_ahead_unless_the_user_says_otherwise():
    text = Drive().urdf(PLAIN + caster("revolute", (-0.6, 0.6), 0.0))
    assert heading(robot_of(text)) == 0  # steered from behind, as a forklift: x of the root link counts more
    turned = robot_of(text, forward="-x").base
    assert turned.frame[2] == pytest.approx(math.pi) and turned.pivots[0].x > 0 and turned.kind == "tricycle"
    fork = caster("revolute", (-0.6, 0.6), 0.0)
    fork = fork.replace('xyz="-0.3 0.0 0.1" rpy="0.0 -0.0 0.0"', 'xyz="{}" rpy="0 0 1.5708"')
    for y, forward in ((0.3, 90), (-0.3, -90)):
        text = ACROSS.urdf(PLAIN + fork.format(f"0 {y} 0.1"))
        assert asked(text).fix.startswith(f"--forward {'y' if y > 0 else '-y'},")
        robot = robot_of(text, forward="y" if y > 0 else "-y")
        assert heading(robot) == forward and robot.base.kind == "tricycle"


@pytest.mark.parametrize(("y", "forward"), [(0.5, -90), (-0.5, 90)])
def test_a_trailer_is_behind(y, forward):
    text = link("cart", 5.0) + joint("hitch", "continuous", "base", "cart", p=(0, y / 2, 0.1), axis=(0, 0, 1))
    standing = origin(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]))  # a cylinder's z along x
    for name, x in (("near", 0.2), ("far", -0.2)):
        text += link(name, 1.0, 0.01, CYLINDER.format(r=0.1), standing)
        text += joint(f"{name}_j", "continuous", "cart", name, p=(x, y / 2, 0), axis=(1, 0, 0))
    robot = robot_of(ACROSS.urdf(PLAIN + text), hitch=("hitch",))
    assert robot.base.kind == "drive_trailer" and heading(robot) == forward and robot.base.pivots[0].x < 0


@pytest.mark.parametrize("trail", [0.0, 0.03])
def test_a_base_that_moves_all_ways_has_its_forward_where_it_is_said(trail):
    plain, turned = robot_of(swerve(trail)), robot_of(swerve(trail), forward="-y")
    assert (heading(plain), heading(turned)) == (0, -90) and plain.base.kind == turned.base.kind
    moved = [(-p.y, p.x) for p in plain.base.pivots]
    np.testing.assert_allclose([(p.x, p.y) for p in turned.base.pivots], moved, atol=1e-12)


@pytest.mark.parametrize(("said", "error", "words"), [
    ({"forward": "north"}, UnknownName, "unknown direction 'north'"),
    ({"forward": "x", "base": "fixed"}, ConfigError, "a forward for a base 'fixed'"),
    ({"forward": "y"}, ConfigError, "y cannot be forward: its wheels roll along x: --forward x or -x"),
])  # fmt: skip
def test_a_direction_that_nothing_would_use_is_refused(said, error, words):
    with pytest.raises(error, match=words):
        robot_of(Drive().urdf(), **said)


# --- The order of wheels ----------------------------------------------------------------------------------------------


@given(st.floats(-0.03, 0.03), st.floats(-0.03, 0.03))
@settings(max_examples=15, deadline=None)
def test_wheels_of_a_row_are_listed_left_before_right_wherever_they_are_placed(front, rear):
    text = four(more="<gazebo><plugin name='d' filename='libgazebo_ros_skid_steer_drive.so'/></gazebo>")
    for name, by in (("fr", front), ("rr", rear)):
        head, tail = text.split(f'<joint name="{name}"', 1)
        x = float(tail.split('xyz="', 1)[1].split()[0])
        text = head + f'<joint name="{name}"' + tail.replace(f'xyz="{x!r}', f'xyz="{x + by!r}', 1)
    robot = robot_of(text)
    assert [w.joint for w in robot.base.wheels] == ["fl", "fr", "rl", "rr"] and "base-sides" not in codes(robot)
