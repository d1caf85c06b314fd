"""Refusals and what they print: followed, it leads to the right robot."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from drives import ARM, CYLINDER, LIMIT, LYING_CYLINDER, SPHERE, joint, link, robot_of
from hypothesis import given, settings
from hypothesis import strategies as st
from test_base import four
from test_foreign import packed
from test_strange import ROBOT, chassis, followed, pair, ways_of, wheel, xacro
from test_wild import codes

from mmnn_pin.errors import RobotError
from mmnn_pin.model.base.overrides import Overrides
from mmnn_pin.model.base.report import NO_FRICTION, Undecided, Unsupported
from mmnn_pin.model.base.understanding import NO_WAY, leading_on
from mmnn_pin.model.checks.properties import check
from mmnn_pin.model.inspection import refusal_of
from mmnn_pin.model.loading import load
from mmnn_pin.model.urdf.reading import parse
from mmnn_pin.model.urdf.shapes import AtRest

EYE = '<xacro:macro name="eye" params="on"><link name="eye"/>{}</xacro:macro>'.format(
    joint("see", "fixed", "base", "eye").replace('"base"', '"${on}"')
)
CALL = '<xacro:eye on="base"/>'

# --- What is printed --------------------------------------------------------------------------------------------------


def test_ways_that_lead_to_another_refusal_are_not_printed():
    text = chassis(pair())
    rest = AtRest(parse(text.encode(), "made.urdf"))
    lost, leads = ("--base swerve for a swerve drive", "--wheels gone,left"), ("--base tracked if belts run over them",)
    leads += ("--wheels left,right --radius METRES where these drive", "turn it over")
    for fix in ("; ".join([*lost, *leads]), ", or ".join([leads[0], *lost, *leads[1:]])):
        kept = leading_on(rest, {}, Overrides(), fix)
        assert all(way in kept for way in leads) and not any(way in kept for way in lost)
    assert leading_on(rest, {}, Overrides(), ", or ".join(lost)) == NO_WAY


@pytest.mark.parametrize(("text", "kind"), [
    ("A robot with mecanum wheels.", "holonomic"), ("It has a differential drive.", "skid_steer"),
    ("It is non-holonomic: differential-drive.", "skid_steer"),
])  # fmt: skip
@pytest.mark.parametrize("deep", [True, False])
def test_the_readme_of_a_package_tells_mecanum_wheels_from_plain_ones(tmp_path, text, kind, deep):
    package(tmp_path / "src" / "own", "own", "urdf/none.xacro", "")
    file = tmp_path / "src" / "own" / "urdf" / "robot.urdf"
    file.write_text(four())
    with pytest.raises(Undecided):
        load(file)
    (tmp_path / "src" / ("." if deep else "own") / "README.md").write_text(text)
    assert load(file).base.kind == kind
    (tmp_path / "src" / ("." if deep else "own") / "README.md").write_text(f"{text} Mecanum or diff drive.")
    with pytest.raises(Undecided):
        load(file)


def test_what_is_called_wheels_and_lies_across_its_axis_is_told_with_both_directions():
    text = chassis("".join(wheel(n, (0, y, 0.1), (0, 0, 1), 0.1) for n, y in (("wheel_l", 0.25), ("wheel_r", -0.25))))
    with pytest.raises(Undecided, match=r"lies along 0 1 0 in its link, and its joint turns about 0 0 1"):
        robot_of(text)
    assert robot_of(text.replace('<axis xyz="0.0 0.0 1.0"/>', '<axis xyz="0 1 0"/>', 2)).base.track == 0.5


# --- Packages ---------------------------------------------------------------------------------------------------------


def package(folder: Path, name: str, file: str, text: str) -> Path:
    """A package with one xacro file."""
    place = folder / file
    place.parent.mkdir(parents=True, exist_ok=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    place.write_text(f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{text}</robot>')
    return folder


def test_a_package_whose_name_was_changed_is_taken_as_its_files_call_it_and_told(tmp_path):
    own = package(tmp_path / "new", "new_robot", "urdf/parts/eye.xacro", EYE)
    include = '<xacro:include filename="$(find old_robot)/urdf/parts/{}.xacro"/>'
    robot = load(xacro(own / "urdf", include.format("eye") + CALL + ROBOT))
    assert '"eye"' in robot.urdf and "package 'old_robot' is not found" in codes(robot)["xacro-package"]
    assert str(own) in next(f for f in robot.findings if f.code == "xacro-package").why
    with pytest.raises(RobotError, match=r"\(old_robot\).*--package-dir"):
        load(xacro(own / "urdf", include.format("nose") + CALL + ROBOT))


def test_a_file_of_another_version_of_a_package_leads_to_that_version(tmp_path):
    package(tmp_path / "cams", "cams", "urdf/old.xacro", "")
    units = '<xacro:property name="deg" value="0.5"/>'
    newer = package(tmp_path / "far" / "a" / "b" / "c" / "cams", "cams", "urdf/units.xacro", units)
    text = '<xacro:include filename="$(find cams)/urdf/units.xacro"/><link name="${deg}"/>'
    file = xacro(tmp_path, text + joint("j", "fixed", "base", "${deg}") + ROBOT)
    with pytest.raises(RobotError, match=r"cams/urdf/units.xacro.*in the version that has it with --package-dir$"):
        load(file)
    assert 'name="0.5"' in load(file, package_dirs=[newer]).urdf


def test_a_macro_of_another_version_leads_to_that_version(tmp_path):
    package(tmp_path / "cams", "cams", "urdf/eye.xacro", EYE)
    other = EYE.replace('"on"', '"on fake"')
    newer = package(tmp_path / "far" / "a" / "b" / "c" / "cams", "cams", "urdf/eye.xacro", other)
    call = CALL.replace("/>", ' fake="1"/>')
    file = xacro(tmp_path, '<xacro:include filename="$(find cams)/urdf/eye.xacro"/>' + call + ROBOT)
    with pytest.raises(RobotError, match=r"no 'fake': give the version .* with --package-dir, or .*--without eye"):
        load(file)
    assert '"eye"' in load(file, package_dirs=[newer]).urdf


@pytest.mark.parametrize("marked", [True, False])
def test_packages_of_the_same_workspace_are_seen_however_deep_the_file_is(tmp_path, marked):
    top = tmp_path / ("src" if marked else "other")
    package(top / "group" / "deep_parts", "deep_parts", "urdf/eye.xacro", EYE)
    own = package(top / "a" / "b" / "c" / "d" / "own_robot", "own_robot", "urdf/none.xacro", "")
    text = '<xacro:include filename="$(find deep_parts)/urdf/eye.xacro"/>' + CALL
    mesh = '<visual><geometry><mesh filename="package://deep_parts/eye.stl"/></geometry></visual>'
    file = xacro(own / "urdf", text + ROBOT.replace("</link>", f"{mesh}</link>", 1))
    if marked:
        robot = load(file)
        assert '"eye"' in robot.urdf and "eye.stl' does not exist" in codes(robot)["mesh-missing"]
        return
    with pytest.raises(RobotError, match=r"deep_parts.*--package-dir"):
        load(file)


# --- Macros, properties and arguments ---------------------------------------------------------------------------------


def test_a_macro_that_no_file_defines_can_be_left_out(tmp_path):
    file = xacro(tmp_path, '<!-- <xacro:macro name="plugin"/> --><xacro:plugin/>' + ROBOT)
    with pytest.raises(RobotError, match=r"unknown macro name: xacro:plugin.*--without plugin") as error:
        load(file)
    assert load(file, without=(re.search("--without (.*)", error.value.fix)[1],)).base.kind == "differential_drive"


CHOICE = "<xacro:if value=\"${{kind == '{0}'}}\"><xacro:property name='span' value='{1}'/></xacro:if>"


@pytest.mark.parametrize("kinds", [["dvt"], ["mk2", "beta", "dvt"]])
def test_an_argument_that_decides_what_is_defined_is_named_with_its_values(tmp_path, kinds):
    text = '<xacro:arg name="kind" default="none"/><xacro:property name="kind" value="$(arg kind)"/>'
    text += "".join(CHOICE.format(kind, f"span_{kind}") for kind in kinds) + '<link name="${span}"/>'
    file = xacro(tmp_path, text + joint("j", "fixed", "base", "${span}") + ROBOT)
    with pytest.raises(RobotError, match="name 'span' is not defined") as error:
        load(file)
    offered = re.findall(r"--xacro (\S+)", error.value.fix)
    assert offered == [f"kind:={kind}" for kind in kinds]
    for kind, option in zip(kinds, offered, strict=True):
        assert f"span_{kind}" in load(file, xacro=(option,)).urdf


def test_a_macro_that_uses_what_is_not_there_can_be_left_out(tmp_path):
    packed(tmp_path, "cams", here="")
    cam = '<xacro:macro name="cam"><link name="${MISSING}"/></xacro:macro>'
    cam += '<xacro:macro name="all"><xacro:cam/></xacro:macro>'
    file = xacro(tmp_path, f'<xacro:include filename="$(find cams)/gone.xacro"/>{cam}<xacro:all/>{ROBOT}')
    with pytest.raises(
        RobotError,
        match=r"'MISSING' is not defined, in macro 'cam' in 'all': .*--package-dir, or leave it out: --without cam$",
    ):
        load(file)
    assert load(file, without=("cam",)).base.kind == "differential_drive"


def test_macros_that_call_each_other_without_end_are_named_once(tmp_path):
    text = "".join(f'<xacro:macro name="{a}"><xacro:{b}/></xacro:macro>' for a, b in ("pq", "qp"))
    with pytest.raises(RobotError, match=r"recursion.*, in macro '[pq]' in '[pq]'") as error:
        load(xacro(tmp_path, text + "<xacro:p/>" + ROBOT))
    assert len(str(error.value)) < 500


def test_a_link_that_leads_to_itself_is_not_offered_in_its_place(tmp_path):
    (tmp_path / "robot.urdf").symlink_to(tmp_path / "robot.urdf")
    with pytest.raises(RobotError, match="name a URDF or xacro file"):
        load(tmp_path / "robot.urdf")


def test_a_file_that_was_missed_is_seen_once_it_is_there(tmp_path):
    packed(tmp_path, "cams", here="")
    file = xacro(tmp_path, '<xacro:include filename="$(find cams)/late.xacro"/>' + ROBOT)
    assert "xacro-package" in codes(load(file))
    inside = link("late", 0.1) + joint("comes", "fixed", "base", "late")
    (tmp_path / "cams" / "late.xacro").write_text(
        f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{inside}</robot>'
    )
    robot = load(file)
    assert "xacro-package" not in codes(robot) and '"late"' in robot.urdf


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            '<xacro:macro name="a" params="x"><link name="${x}"/></xacro:macro><xacro:a/>',
            "in macro 'a': give x where the macro is",
        ),
        ('<xacro:if value="maybe"/>', "write true or false there"),
        ('<link name="$(env NO_SUCH_NAME)"/>', r": environment variable 'NO_SUCH_NAME' is not set: set it"),
    ],
)
def test_xacro_s_own_errors_are_said_once_with_what_to_do(tmp_path, text, words):
    file = xacro(tmp_path, text + ROBOT)
    with pytest.raises(RobotError, match=words) as error:
        load(file)
    with pytest.raises(RobotError, match=words):
        refusal_of(error.value, file, Overrides())


def test_parts_of_one_name_lead_to_a_prefix(tmp_path):
    text = '<xacro:arg name="prefix" default=""/><link name="$(arg prefix)base"/>'
    file = xacro(tmp_path, text + ROBOT + joint("on_top", "fixed", "base", "$(arg prefix)base"))
    with pytest.raises(RobotError, match=r"appears twice.*--xacro prefix:=arm_"):
        load(file)
    assert '"arm_base"' in load(file, xacro=("prefix:=arm_",)).urdf


def test_leaving_out_is_not_offered_where_it_leads_nowhere(tmp_path):
    packed(tmp_path, "cams", here="")
    text = '<xacro:include filename="$(find cams)/gone.xacro"/><xacro:dog/><link name="${height}"/>'
    with pytest.raises(RobotError, match="unknown macro name: xacro:dog") as error:
        load(xacro(tmp_path, text + ROBOT))
    assert "--without" not in error.value.fix and "--package-dir" in error.value.fix


# --- Inertias ---------------------------------------------------------------------------------------------------------


def massless(count: int) -> str:
    """A chain of so many bodies without mass, on the base."""
    limit, ends = LIMIT.format(-1, 1), ["base", *(f"b{i}" for i in range(count))]
    return "".join(
        link(f"b{i}", 0.0) + joint(f"m{i}", "revolute", ends[i], f"b{i}", p=(0, 0, 0.3), more=limit)
        for i in range(count)
    )


@pytest.mark.parametrize("count", [2, 5, 12])
def test_bodies_without_mass_are_told_in_one_line(count):
    with pytest.raises(RobotError, match=f"each of {count} bodies that joints move has no mass") as error:
        robot_of(chassis(pair() + massless(count)))
    assert len([line for line in str(error.value).splitlines() if " error: " in line]) == 1
    locks = re.findall(r"--lock (\S+)", error.value.fix)
    assert locks == ([f"m{i}" for i in range(count)] if count <= 8 else ["JOINT"])
    robot = robot_of(chassis(pair() + massless(count)), lock=tuple(f"m{i}" for i in range(count)))
    assert robot.joint_names == ("shoulder", "elbow")


def test_an_arm_without_any_mass_cannot_be_locked_whole():
    text = f'<robot name="r">{link("base", 5.0)}{massless(3)}</robot>'
    with pytest.raises(RobotError, match="each of 3 bodies that joints move has no mass") as error:
        robot_of(text)
    assert "--lock" not in error.value.fix


@pytest.mark.parametrize("other", ["-0.00046237", "-0.0004", "0.0004624"])
def test_an_inertia_written_twice_with_other_numbers_is_taken_as_urdf_has_it_and_told(other):
    robot = robot_of(chassis(pair()).replace('ixy="0"', f'ixy="-4.624e-4" iyx="{other}"', 1))
    assert 'ixy="-4.624e-4"' in robot.urdf and "iyx" not in robot.urdf
    assert "'iyx' and 'ixy' of <inertia> differ" in codes(robot)["transposed-inertia"]


# --- Wheels -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rolls", ["0 1 0", "0 0 1"])
def test_an_axis_that_is_left_out_is_printed_as_it_is_to_be_written(rolls):
    text = chassis(pair())
    if rolls == "0 0 1":  # the frame of the link is turned, not the cylinder in it
        text = re.sub(r'(<collision><origin xyz="[^"]*" rpy=")1[^"]*', r"\g<1>0 0 0", text)
        at = re.compile(r'(<joint name="(?:left|right)".*?<origin xyz="[^"]*" rpy=")[^"]*')
        text = at.sub(r"\g<1>-1.5707963267948966 0 0", text)
    bare = re.sub(r'(<joint name="(?:left|right)".*?)<axis[^>]*/>', r"\1", text)
    with pytest.raises(Undecided, match="an <axis> that is left out is x") as error:
        robot_of(bare)
    element, names = re.search(r"write (<axis [^>]*/>) in ((?:'\w+'(?:, )?)+)", error.value.fix).groups()
    assert f'xyz="{rolls}"' in element and names.startswith("'left', 'right'")
    mended = robot_of(re.sub(r'(<joint name="(?:left|right)"[^>]*>)', rf"\1{element}", bare))
    assert mended.base.kind == "differential_drive" and mended.base.track == pytest.approx(0.5)
    assert [w.joint for w in mended.base.wheels] == ["left", "right"]


@given(st.floats(0.02, 0.05), st.floats(0.06, 0.09))
@settings(max_examples=6, deadline=None)
def test_two_pairs_of_stubs_are_asked_about_pair_by_pair(small, large):
    """Wheels whose shapes do not reach the floor together: what drives must be said, and every answer works."""
    text, sizes = "", {"fl": large / 5, "fr": large, "rl": small, "rr": small}
    for name, radius in sizes.items():
        x, y, height = (0.2, -0.2)[name[0] == "r"], (0.2, -0.2)[name[1] == "r"], (large, small)[name[0] == "r"]
        text += link(f"{name}_link", 1.0, 0.01, CYLINDER.format(r=radius), LYING_CYLINDER)
        text += joint(name, "continuous", "base", f"{name}_link", p=(x, y, height))
    with pytest.raises(Undecided) as error:
        robot_of(chassis(text))
    ways = re.findall(r"--wheels (\S+) --radius METRES where these drive", error.value.fix)
    assert {frozenset(way.split(",")) for way in ways} == {frozenset({"fl", "fr"}), frozenset({"rl", "rr"})}
    for way in ways:
        robot = followed(chassis(text), {"wheels": way, "radius": str(large if "f" in way else small)})
        assert {w.joint for w in robot.base.wheels} == {*way.split(",")} and robot.base.track == pytest.approx(0.4)


def test_an_axle_at_the_end_of_a_leg_is_a_legged_machine():
    limit, text = LIMIT.format(-1, 1), ""
    ends = ["base", "hip", "thigh", "shin", "foot"]
    for i, axis in enumerate(((0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 1, 0))):
        text += link(ends[i + 1], 1.0)
        text += joint(f"leg{i}", "revolute", ends[i], ends[i + 1], p=(0, 0, -0.2), axis=axis, more=limit)
    text += "".join(wheel(name, (0, y, 0), parent="foot") for name, y in (("left", 0.2), ("right", -0.2)))
    with pytest.raises(Unsupported, match="legged machine"):
        robot_of(chassis(text))


def test_welded_wheels_by_short_names_are_asked_about():
    text = f'<robot name="r">{link("base", 20.0)}{ARM}'
    for i in range(3):
        text += f'<link name="drivewhl{i}_link"/>' + joint(
            f"d{i}", "fixed", "base", f"drivewhl{i}_link", p=(0.1 * i, 0, 0)
        )
    with pytest.raises(Undecided, match="3 wheels are welded on") as error:
        robot_of(f"{text}</robot>")
    assert {way["base"] for way in ways_of(error.value.fix)} == {"fixed", "holonomic"}


def test_a_tyre_that_turns_on_its_rim_is_part_of_the_wheel():
    text = pair(0.08)
    for side in ("left", "right"):
        text += link(f"{side}_tyre", 0.2, 0.001, CYLINDER.format(r=0.1), LYING_CYLINDER)
        text += joint(f"{side}_on_rim", "continuous", f"{side}_link", f"{side}_tyre")
    robot = robot_of(chassis(text.replace(" 0.08)", " 0.1)")))
    assert robot.base.kind == "differential_drive" and [w.joint for w in robot.base.wheels] == ["left", "right"]
    assert [w.radius for w in robot.base.wheels] == pytest.approx([0.1, 0.1])
    assert robot.joint_names == ("shoulder", "elbow")
    beside = chassis(text.replace("left_on_rim", "hub").replace("right_on_rim", "hub2"))
    assert robot_of(beside).base.track == robot.base.track  # names decide nothing


@given(st.floats(0.02, 0.5), st.booleans())
@settings(max_examples=8, deadline=None)
def test_balls_that_turn_about_any_axis_on_swivels_are_no_arm(tilt, named):
    balls = ""
    for name, x in (("front", 0.2), ("rear", -0.2)):
        balls += link(f"{name}_fork", 0.1, 0.001)
        balls += joint(f"{name}_turns", "continuous", "base", f"{name}_fork", p=(x, 0, 0.06), axis=(0, 0, 1))
        balls += link(f"{name}_ball", 0.1, 0.001, SPHERE.format(r=0.03))
        rolls = (0.577, 0.577, 0.577 + tilt) if named else (0.6, 0, 0.8)
        balls += joint(f"{name}_rolls", "continuous", f"{name}_fork", f"{name}_ball", p=(-0.015, 0, -0.03), axis=rolls)
    robot = robot_of(chassis(pair() + balls).replace(ARM, ""))
    assert robot.base.kind == "differential_drive" and robot.joint_names == ()
    assert {"front_turns", "front_rolls", "rear_turns", "rear_rolls"} <= {*robot.base.casters}


@given(st.integers(1, 4), st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda axis: np.linalg.norm(axis) > 0.1))
@settings(max_examples=12, deadline=None)
def test_balls_on_the_floor_are_casters_about_whatever_axis_they_turn(count, axis):
    places = ((0.25, 0.15), (0.25, -0.15), (-0.25, 0.15), (-0.25, -0.15))[:count]
    balls = "".join(
        link(f"b{i}_ball", 0.1, 0.001, SPHERE.format(r=0.03))
        + joint(
            f"b{i}",
            "continuous",
            "base",
            f"b{i}_ball",
            p=(*at, 0.03),
            axis=tuple(np.array(axis) / np.linalg.norm(axis)),
        )
        for i, at in enumerate(places)
    )
    robot = robot_of(chassis(pair() + balls))
    assert robot.base.kind == "differential_drive" and robot.joint_names == ("shoulder", "elbow")
    assert {f"b{i}" for i in range(count)} <= {*robot.base.casters}


@pytest.mark.parametrize("steered", [True, False])
def test_four_wheels_tell_the_floor_though_a_centre_of_mass_is_below_it(steered):
    limit, text = LIMIT.format(-0.5, 0.5), ""
    for name, x, y in (("fl", 0.4, 0.3), ("fr", 0.4, -0.3), ("rl", -0.4, 0.3), ("rr", -0.4, -0.3)):
        parent, at = "base", (x, y, 0.5)
        if steered and x > 0:
            text += link(f"{name}_fork", 0.5)
            text += joint(f"{name}_steers", "revolute", "base", f"{name}_fork", p=at, axis=(0, 0, 1), more=limit)
            parent, at = f"{name}_fork", (0, 0, 0)
        text += wheel(name, at, parent=parent)
    ballast = link("ballast", 5.0).replace("<inertial>", '<inertial><origin xyz="0 0 0.1"/>')
    text = chassis(text + ballast + joint("b", "fixed", "base", "ballast"))
    if steered:
        assert robot_of(text).base.kind == "car_like" and robot_of(text).base.length == pytest.approx(0.8)
        return
    robot = followed(text, {"base": "skid_steer"})
    assert robot.base.kind == "skid_steer" and robot.base.track == pytest.approx(0.6)


@pytest.mark.parametrize("named", ["thruster", "propeller"])
@pytest.mark.parametrize("low", [True, False])
def test_what_swims_by_propellers_is_refused_by_name(named, low):
    text = ""
    for side, y in (("left", 0.3), ("right", -0.3)):
        text += link(f"{side}_{named}", 0.5, 0.01, CYLINDER.format(r=0.1), '<origin rpy="0 1.5707963267948966 0"/>')
        height = 0.1 if low else 0.6
        text += joint(
            f"{side}_{named}_joint", "continuous", "base", f"{side}_{named}", p=(-0.4, y, height), axis=(1, 0, 0)
        )
    with pytest.raises(Unsupported, match="vehicle with propellers"):
        robot_of(chassis(text))
    if not low:  # a robot on wheels with a fan
        assert robot_of(chassis(pair() + text)).base.kind == "differential_drive"


# --- Heads ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("antennas", [0, 2])
def test_antennas_make_no_arm_of_a_head(antennas):
    limit, text, parent = LIMIT.format(-1, 1), "", "base"
    for i, axis in enumerate(((1, 0, 0), (0, 1, 0), (0, 0, 1))):
        text += link(f"n{i}", 0.2, 0.001)
        text += joint(f"neck{i}", "revolute", parent, f"n{i}", p=(0, 0, 0.01), axis=axis, more=limit)
        parent = f"n{i}"
    for i in range(antennas):
        text += link(f"a{i}", 0.01, 1e-4)
        text += joint(f"antenna{i}", "revolute", "n2", f"a{i}", p=(0, 0.02 * (2 * i - 1), 0.05), more=limit)
    robot = robot_of(chassis(pair() + text))
    assert robot.joint_names == ("shoulder", "elbow")
    assert {f"neck{i}" for i in range(3)} <= robot.arm.locked.keys()


# --- Motors -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("effort", "weak"), [(170.0, True), (180.0, False), (0.0, False)])
def test_a_motor_that_cannot_hold_its_load_is_told_with_both_numbers(effort, weak):
    """A lift with 18 kg needs 18 times 9.81 N; an effort of 0 is no limit."""
    limit = f'<limit lower="0" upper="0.5" effort="{effort}" velocity="1"/>'
    text = link("carriage", 18.0, 0.1) + joint(
        "lift", "prismatic", "base", "carriage", None, (0, 0, 0.5), (0, 0, 1), limit
    )
    text = chassis(pair() + text).replace(ARM, "")
    found = [f for f in robot_of(text).findings if f.code == "arm-weak"]
    assert len(found) == weak
    if weak:
        assert "effort of 'lift' is 170 N, and gravity takes 177 N" in str(found[0]) and "--lock lift" in found[0].fix
        locked = followed(text, ways_of(found[0].fix)[0])
        assert "lift" in locked.arm.locked and "arm-weak" not in codes(locked)


@pytest.mark.parametrize("dynamics", ["", '<dynamics damping="0.1"/>', '<dynamics friction="0.1"/>'])
def test_a_robot_without_any_friction_is_told_so_in_one_line(dynamics):
    """By inspect and by check; a joint with some is enough for none to be said."""
    robot = robot_of(chassis(pair()).replace("</joint>", f"{dynamics}</joint>", 1))
    found = [f for f in robot.findings if f.code == "no-friction"]
    assert [f.severity for f in found] == ["note"] * (not dynamics)
    assert len([note for note in check(robot, samples=2).notes if NO_FRICTION in note]) == (not dynamics)
    assert not found or ("--set friction.arm=0.1" in found[0].fix and "\n" not in str(found[0]))


def test_a_ball_that_reaches_beneath_two_wheels_is_not_named_with_what_drives():
    ball = link("ball_link", 0.1, 1e-4, SPHERE.format(r=0.025))
    ball += joint("ball", "continuous", "base", "ball_link", p=(-0.3, 0, -0.05), axis=(1, 0, 0))
    with pytest.raises(Undecided) as error:
        robot_of(chassis(pair() + ball))
    way = re.search(r"--wheels (\S+) --radius METRES", error.value.fix)[1]
    robot = followed(chassis(pair() + ball), {"wheels": way, "radius": "0.1"})
    assert {w.joint for w in robot.base.wheels} == {"left", "right"} == {*way.split(",")}
