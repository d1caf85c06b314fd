"""Twins of descriptions that strangers wrote badly: what is silently dropped, guessed or turned, and its way out."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from drives import ARM, CYLINDER, LIMIT, LYING_CYLINDER, SPHERE, joint, link, origin, robot_of, words
from hypothesis import given, settings
from hypothesis import strategies as st
from lxml import etree
from test_base import drone, four, rollers, three
from test_strange import ROBOT, chassis, followed, pair, ways_of, wheel, xacro
from test_wild import codes, drive_of

from mmnn_pin.errors import ConfigError, RobotError
from mmnn_pin.model.base.report import Undecided, Unsupported
from mmnn_pin.model.base.wheels import Candidate, radius_by_inertia
from mmnn_pin.model.loading import load
from mmnn_pin.model.urdf.finding import AuditError
from mmnn_pin.model.urdf.reading import parse
from mmnn_pin.model.urdf.shapes import AtRest

BALL = link("ball", 0.1, 1e-4, SPHERE.format(r=0.05)) + joint("ball_j", "fixed", "base", "ball", p=(-0.2, 0, 0.05))
GONE = '<visual><geometry><mesh filename="package://gone/tyre.stl"/></geometry></visual>'


def hubs(radius: float, height: float = 0.1) -> str:
    """Two wheels whose tyres are a missing mesh, with a collision shape of this radius."""
    shape = f"{GONE}<collision>{LYING_CYLINDER}<geometry>{CYLINDER.format(r=radius)}</geometry></collision>"
    return "".join(
        link(f"{name}_link", 1.0).replace("</link>", f"{shape}</link>")
        + joint(name, "continuous", "base", f"{name}_link", p=(0, y, height))
        for name, y in (("left", 0.2), ("right", -0.2))
    )


# --- What is left of a wheel ------------------------------------------------------------------------------------------


def test_a_collision_shape_whose_visual_mesh_is_missing_may_be_a_hub():
    with pytest.raises(Undecided, match="meshes are missing, none is measured from what is left") as error:
        robot_of(chassis(hubs(0.03)))  # it is: the wheel has 0.1
    assert "--radius METRES, or --package-dir FOLDER" in error.value.fix
    told = codes(robot_of(chassis(hubs(0.1) + BALL)))["base-shapes"]  # it reaches the ball's floor
    assert "0.1 m is that of the collision shapes of left, right" in told
    assert "base-shapes" not in codes(robot_of(chassis(hubs(0.1).replace(GONE, ""))))
    with pytest.raises(RobotError, match=r"heights of the hubs.*'left' 0.1 m"):
        robot_of(chassis(hubs(0.03) + BALL))
    robot = robot_of(chassis(hubs(0.03) + BALL), radius=0.1)
    assert [w.radius for w in robot.base.wheels] == [0.1, 0.1] and robot.base.floor == pytest.approx(0)


@given(st.floats(0.04, 0.19), st.sampled_from([0.0, 0.02]))
@settings(max_examples=10, deadline=None)
def test_a_collision_cylinder_is_the_wheel_whose_mesh_is_missing(radius, above):
    robot = robot_of(chassis(hubs(radius, radius + above)))
    assert [w.radius for w in robot.base.wheels] == [radius] * 2 and robot.base.floor == pytest.approx(above)
    assert "a mesh of them is missing" in codes(robot)["base-shapes"]


def weighing(moment: float, others: float, radius: float = 0.05) -> str:
    """Two collision cylinders whose meshes are missing, of 1 kg, with moments of inertia about the axle and across."""
    tensor = 'ixx="0.02" iyy="0.02" izz="0.02"'
    return chassis(hubs(radius).replace(tensor, f'ixx="{others}" iyy="{moment}" izz="{others}"'))


def test_a_cylinder_that_has_no_room_for_its_inertia_is_a_hub():
    disc = 0.5 * 0.1**2  # of the wheel that it would be the hub of
    with pytest.raises(Undecided, match=r"radius unknown, 0.05 m without it"):
        robot_of(weighing(disc, 0.6 * disc))
    assert robot_of(weighing(0.24 * disc, 0.14 * disc)).base.wheels[0].radius == 0.05
    ring = robot_of(weighing(0.99 * 0.05**2, 0.5 * 0.05**2))  # all its mass on the rim: it has just room
    assert "its inertia, a disc's of 0.0704 m" in next(f.why for f in ring.findings if f.code == "base-shapes")
    assert robot_of(weighing(disc, disc)).base.wheels[0].radius == 0.05  # a number that nobody measured tells nothing


def test_another_radius_that_is_stated_counts_more_than_a_cylinder():
    plugin = "<gazebo><plugin name='d' filename='x'><wheel_radius>{}</wheel_radius></plugin></gazebo>"
    for stated, radius in ((0.1, 0.1), (0.051, 0.05)):
        assert robot_of(chassis(hubs(0.05) + plugin.format(stated))).base.wheels[0].radius == radius


@given(st.floats(0.04, 0.09), st.floats(1.1, 2.0))
@settings(max_examples=10, deadline=None)
def test_a_cylinder_that_reaches_the_floor_counts_more_than_a_radius_that_is_stated(radius, times):
    plugin = f"<gazebo><plugin name='d' filename='x'><wheel_radius>{radius * times}</wheel_radius></plugin></gazebo>"
    robot = robot_of(chassis(hubs(radius, radius) + BALL + plugin))
    assert [w.radius for w in robot.base.wheels] == [radius] * 2
    assert f"states a radius of {radius * times:.4g} m, its geometry {radius:.4g} m" in codes(robot)["base-stated"]


@given(st.floats(0.03, 0.3), st.floats(0.1, 20), st.floats(0.01, 0.9), st.floats(-3, 3), st.floats(0.0, 0.05))
@settings(max_examples=25, deadline=None)
def test_the_radius_by_inertia_is_that_of_a_disc_however_it_is_written(radius, mass, share, turn, apart):
    """A disc in two parts along the axle, the inertia of one in axes of its own."""
    axle, across = 0.5 * radius**2, 0.25 * radius**2
    text = ""
    for part, at, angle in ((share, apart, turn), (1 - share, -apart, 0.0)):
        m = mass * part
        moments = f'ixx="{m * across!r}" iyy="{m * axle!r}" izz="{m * across!r}" ixy="0" ixz="0" iyz="0"'
        body = f'<inertial>{origin(pin.rpy.rpyToMatrix(0, angle, 0), (0, at, 0))}<mass value="{m!r}"/>'
        text += f'<link name="w{len(text)}">{body}<inertia {moments}/></inertial></link>'
    names = re.findall(r'link name="(\w+)"', text)
    text += joint("tyre", "fixed", *names) + joint("axle", "continuous", "base", names[0])
    rest = AtRest(parse(f'<robot name="r">{link("base")}{text}</robot>'.encode(), "r.urdf"))
    wheel = Candidate(rest.document.joints["axle"], np.array([0.0, 1.0, 0.0]), np.zeros(3), math.nan, "unknown")
    assert radius_by_inertia(rest, wheel) == pytest.approx(radius, rel=1e-9)
    aside = replace(wheel, centre=np.array([0.0, 0.0, 0.1]))  # Steiner: the mass 0.1 m beside the axle
    assert radius_by_inertia(rest, aside) == pytest.approx(math.sqrt(radius**2 + 2 * 0.1**2), rel=1e-9)


# --- Calls of macros that xacro leaves out ----------------------------------------------------------------------------


def test_a_macro_that_is_called_without_its_prefix_is_called_and_told(tmp_path):
    arm = ARM.replace('parent link="base"', 'parent link="${on}"')
    defined = f'<xacro:macro name="my_arm" params="on">{arm}</xacro:macro>'
    (tmp_path / "arm.xacro").write_text(f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{defined}</robot>')
    body = ROBOT.replace(ARM, "")
    file = xacro(tmp_path, f'<xacro:include filename="arm.xacro"/>\n{body}\n<my_arm on="base"/>')
    robot = load(file)
    assert robot.joint_names == ("shoulder", "elbow") and "<my_arm>" in codes(robot)["xacro-prefix"]
    assert load(file, without=("my_arm",)).dimensions.arm == 0
    file.write_text(file.read_text().replace("<my_arm", "<xacro:my_arm"))
    assert "xacro-prefix" not in codes(load(file))


def test_all_that_old_xacro_had_without_its_prefix_is_done(tmp_path):
    (tmp_path / "arm.xacro").write_text(f"<robot>{ARM}</robot>")
    old = ROBOT.replace(ARM, "") + '<include filename="arm.xacro"/>'
    assert load(xacro(tmp_path, old)).joint_names == ("shoulder", "elbow")
    assert load(xacro(tmp_path, ROBOT + '<property name="a" value="1"/>')).base.kind == "differential_drive"
    arm = ARM.replace('lower="0.2"', 'lower="${low}"')
    old = f'<property name="low" value="0.3"/><macro name="my_arm" params="">{arm}</macro>'
    robot = load(xacro(tmp_path, f"{old}{ROBOT.replace(ARM, '')}<my_arm/>"))
    assert robot.joint_names == ("shoulder", "elbow") and robot.lower[-1] == 0.3
    one = f'{ROBOT.replace(ARM, "")}<unless value="1">{ARM}</unless>'
    assert load(xacro(tmp_path, one)).dimensions.arm == 0


def test_lines_of_a_xacro_file_are_those_of_what_it_expands_to(tmp_path):
    file = xacro(tmp_path, ROBOT.replace('effort="9"', 'effort="0"') + '<xacro:property name="a" value="1"/>')
    told = next(f for f in load(file).findings if f.code == "zero-effort")
    assert told.line > 1


def test_a_call_that_nobody_expanded_is_told_in_a_plain_file():
    call = '<robot_arm name="a" parent="base"/>'
    assert "<robot_arm> in <robot> is ignored" in codes(robot_of(chassis(pair() + call)))["misplaced-tag"]
    assert "misplaced-tag" not in codes(robot_of(chassis(pair() + '<company name="none"/>')))


# --- Machines -----------------------------------------------------------------------------------------------------


def test_wheels_welded_to_their_steering_joints_are_no_rotors():
    modules = "".join(
        link(f"m{i}_link", 2.0, 0.006, '<mesh filename="wheel.stl"/>')
        + joint(f"m{i}", "continuous", "base", f"m{i}_link", p=(x, y, 0.1), axis=(0, 0, 1))
        for i, (x, y) in enumerate(((0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2)))
    )
    with pytest.raises(Unsupported, match="a swerve drive perhaps") as error:
        robot_of(chassis(modules))
    robot = followed(chassis(modules), ways_of(error.value.fix)[0])
    assert robot.base.pushes and set(robot.base.casters) == {"m0", "m1", "m2", "m3"}
    with pytest.raises(Unsupported, match="drone"):
        robot_of(chassis(modules.replace("wheel.stl", "blade.stl")).replace(ARM, ""))


def test_a_tracked_machine_that_is_all_one_body_is_called_so():
    track = link("left_track_link", 5.0) + joint("t", "fixed", "base", "left_track_link", p=(0, 0.2, 0.1))
    with pytest.raises(Unsupported, match="tracked machine perhaps: 'left_track_link'") as error:
        robot_of(chassis(track).replace(ARM, ""))
    assert followed(chassis(track).replace(ARM, ""), ways_of(error.value.fix)[0]).base.pushes


# --- Low joints of an arm ---------------------------------------------------------------------------------------------


def low_arm(joints: int, axis=(0, 1, 0)) -> str:
    text, parent, at = "", "base", (0.25, 0, 0.15)
    for i in range(joints):
        text += link(f"u{i}", 1.0, 0.01, '<box size="0.3 0.04 0.04"/>', origin(p=(0.15, 0, 0)))
        text += joint(f"u{i}j", "continuous", parent, f"u{i}", p=at, axis=axis)
        parent, at = f"u{i}", (0.3, 0, 0)
    return text


@given(st.integers(1, 4), st.sampled_from([(0, 1, 0), (1, 0, 0)]))
@settings(max_examples=8, deadline=None)
def test_an_endless_shoulder_low_on_the_base_is_an_arms(joints, axis):
    text = chassis(pair() + low_arm(joints, axis)).replace(ARM, "")
    if joints == 1 and axis[1]:  # nothing tells it from a third wheel: it stands still, and the way out is printed
        told = next(f for f in robot_of(text).findings if f.code == "base-stray")
        robot = followed(text, ways_of(told.fix)[-1])
    elif joints == 1:  # alone on a base it is hardly one: it stands still, too
        robot = robot_of(text, free=("u0j",))
        assert "u0j" in robot_of(text).arm.locked
    else:
        robot = robot_of(text)
    assert robot.joint_names == tuple(f"u{i}j" for i in range(joints))


# --- Wheels that follow others ----------------------------------------------------------------------------------------


def chained(multiplier: float, flip: int = 1, radius: float = 0.1) -> str:
    """A skid-steer base whose rear wheels follow the front ones, about axes that may point the other way."""
    text = "".join(wheel(n, (0.2, y, 0.1)) for n, y in (("fl", 0.25), ("fr", -0.25)))
    for name, y in (("l", 0.25), ("r", -0.25)):
        shape = CYLINDER.format(r=radius)
        text += link(f"r{name}_link", 1.0, 0.01, shape, LYING_CYLINDER)
        more = f'<mimic joint="f{name}" multiplier="{multiplier!r}"/>'
        text += joint(
            f"r{name}", "continuous", "base", f"r{name}_link", p=(-0.2, y, radius), axis=(0, flip, 0), more=more
        )
    return chassis(text)


@given(st.sampled_from([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0]), st.sampled_from([1, -1]), st.sampled_from([0.05, 0.1]))
@settings(max_examples=30, deadline=None)
def test_wheels_of_a_chain_roll_at_one_speed_or_are_asked_about(multiplier, flip, radius):
    text = chained(multiplier, flip, radius)
    if math.isclose(multiplier * flip * radius, 0.1):  # speed of the rear rim where the front one has 0.1 m/s
        assert robot_of(text).base.kind == "skid_steer"
        return
    with pytest.raises(Undecided, match="<mimic> rolls wheel 'rl'") as error:
        robot_of(text)
    right = float(error.value.fix.split('"')[1])
    assert robot_of(chained(right, flip, radius)).base.kind == "skid_steer"
    with pytest.raises(Undecided, match="<mimic> rolls"):  # what is said of the base does not make them roll
        robot_of(text, base="skid_steer")


def test_a_wheel_that_follows_the_other_side_has_a_way_out():
    left, _, right = pair().rpartition("</joint>")
    text = chassis(f'{left}<mimic joint="left"/></joint>{right}')
    with pytest.raises(Undecided, match="follows 'left'") as error:
        robot_of(text)
    assert [followed(text, way).base.kind for way in ways_of(error.value.fix)] == ["holonomic", "fixed"]


# --- Joints that stand the robot in the world -------------------------------------------------------------------------


def in_world(more: str) -> str:
    """A robot on virtual x, y and yaw joints."""
    empty = "".join(f'<link name="{name}"/>' for name in ("world", "vx", "vy"))
    slide = LIMIT.format(-10, 10)
    joints = joint("px", "prismatic", "world", "vx", axis=(1, 0, 0), more=slide)
    joints += joint("py", "prismatic", "vx", "vy", axis=(0, 1, 0), more=slide)
    return chassis(more + empty + joints + joint("yaw", "continuous", "vy", "base", axis=(0, 0, 1)))


def test_virtual_joints_of_the_root_are_no_part_of_the_robot():
    robot = robot_of(in_world(pair()))
    assert robot.base.kind == "differential_drive" and robot.joint_names == ("shoulder", "elbow")
    assert [f.element for f in robot.findings if f.code == "welded"] == ["joint 'px'", "joint 'py'", "joint 'yaw'"]
    with pytest.raises(Undecided, match="its root moves in the plane by px, py, yaw") as error:
        robot_of(in_world(""))
    assert [followed(in_world(""), way).base.kind for way in ways_of(error.value.fix)] == ["holonomic", "fixed"]
    portal = in_world("").replace('<link name="vy"/>', link("vy", 5.0))  # a gantry has masses on its slides
    assert robot_of(portal).joint_names == ("px", "py", "yaw", "shoulder", "elbow")


# --- Axles that are not what they seem --------------------------------------------------------------------------------


@given(st.floats(0.15, 0.4), st.floats(0.03, 0.06))
@settings(max_examples=10, deadline=None)
def test_twin_tyres_make_two_sides_of_one_axle(y, apart):
    twins = "".join(wheel(f"{n}{i}", (0, s * (y + i * apart), 0.1)) for n, s in (("l", 1), ("r", -1)) for i in (0, 1))
    robot = robot_of(chassis(twins))
    assert robot.base.kind == "skid_steer" and "twin tyres" in codes(robot)["base-evidence"]
    assert robot.base.track == pytest.approx(2 * y + apart)  # between the middles of the twins
    assert robot.base.turning == pytest.approx(mean_scrub(robot, apart), rel=1e-6)
    assert robot_of(chassis(twins), base="holonomic").base.pushes


def mean_scrub(robot, apart: float) -> float:
    """Friction of wheels that slide along themselves by half the distance of the twins, under the whole weight."""
    return 9.81 * sum(body.mass for body in robot.model.inertias) * apart / 2


def turned(axis, angle: float) -> str:
    """Two wheels whose joints are turned, the right one the other way."""
    return "".join(
        link(f"{n}_link", 1.0, 0.01, CYLINDER.format(r=0.1), LYING_CYLINDER)
        + joint(
            n, "continuous", "base", f"{n}_link", pin.AngleAxis(s * angle, np.array(axis)).matrix(), (0, s * 0.2, 0.1)
        )
        for n, s in (("left", 1), ("right", -1))
    )


TOE, CAMBER = turned((0.0, 0.0, 1.0), 0.15), turned((1.0, 0.0, 0.0), 0.0873)


@pytest.mark.parametrize(
    ("text", "kinds"),
    [
        (TOE, ["holonomic", "fixed"]),
        (CAMBER, ["holonomic", "fixed"]),
        (wheel("left", (0, 0.2, 0.1)) + BALL, ["holonomic", "fixed"]),
        (pair() + wheel("back", (-0.25, 0, 0.1)), ["differential_drive", "holonomic", "fixed"]),
    ],
)
def test_every_way_out_of_odd_wheels_is_a_way(text, kinds):
    with pytest.raises(Undecided) as error:
        robot_of(chassis(text))
    assert "LEFT,RIGHT" not in error.value.fix
    assert [followed(chassis(text), way).base.kind for way in ways_of(error.value.fix)] == kinds


def test_two_wheels_that_are_nearly_on_one_axle_are_told():
    text = chassis(wheel("left", (0, 0.2, 0.1)) + wheel("right", (0.01, -0.2, 0.1)))
    robot = robot_of(text)
    assert "0.01 m apart" in codes(robot)["base-pair"] and robot.base.frame[0] == pytest.approx(0.005)
    assert [w.x for w in robot.base.wheels] == [0.0, 0.0]
    far = text.replace("0.01 -0.2", "0.1 -0.2")
    with pytest.raises(ConfigError, match="not two wheels on one axle"):
        robot_of(far, wheels=("left", "right"))


def test_a_third_wheel_that_cannot_swivel_is_not_sent_to_a_skid_steer_base():
    text = chassis(pair() + wheel("back", (-0.25, 0, 0.1)))
    told = next(f for f in robot_of(text, wheels=("left", "right")).findings if f.code == "base-pair")
    assert "no base here has them" in told.why and "skid_steer" not in told.fix
    told = next(f for f in robot_of(four(), wheels=("fl", "fr")).findings if f.code == "base-pair")
    assert followed(four(), ways_of(told.fix)[0]).base.kind == "skid_steer"


def test_a_robot_on_its_head_is_not_driven_by_wheels_in_the_air():
    over = '<link name="foot"/>' + joint("up", "fixed", "foot", "base", R=np.diag([1.0, -1.0, -1.0]))
    text = chassis(pair() + over)
    with pytest.raises(Undecided, match="in its upper half: turn it over") as error:
        robot_of(text)
    assert [followed(text, way).base.kind for way in ways_of(error.value.fix)] == ["fixed"]
    assert "m below the floor" in codes(robot_of(text, wheels=("right", "left")))["base-floor"]


@pytest.mark.parametrize(("depth", "shape", "taken"), [
    (0.01, "cylinder", True), (0.06, "cylinder", True), (0.2, "cylinder", False), (0.06, "mesh", False)])  # fmt: skip
def test_wheels_less_than_their_radius_over_what_reaches_deepest_are_taken_and_it_is_told(
    tmp_path, depth, shape, taken
):
    """A mesh may be a toothed drum of a belt; those and higher ones are asked about, with a way out."""
    keel = link("keel", shape='<box size="0.1 0.1 0.02"/>') + joint("under", "fixed", "base", "keel", p=(0, 0, -depth))
    wheels = pair()
    if shape == "mesh":
        trimesh.creation.cylinder(radius=0.1, height=0.03, sections=64).export(tmp_path / "disc.stl")
        wheels = wheels.replace(CYLINDER.format(r=0.1), '<mesh filename="disc.stl"/>')
    text = f'<robot name="r">{link("base", 20.0, 0.8)}{wheels}{keel}</robot>'
    (tmp_path / "r.urdf").write_text(text)
    if taken:
        robot = robot_of(text)
        assert robot.base.kind == "differential_drive" and robot.base.floor == pytest.approx(0.0, abs=1e-9)
        assert ("m below the floor" in codes(robot).get("base-floor", "")) == (depth > 0.02)
        return
    with pytest.raises(Undecided, match="above the robot's lowest point") as error:
        load(tmp_path / "r.urdf")
    assert ("upper half" in error.value.why) == (depth > 0.1)
    if depth > 0.1:
        return
    names = error.value.fix.partition("--wheels ")[2].split()[0].split(",")
    assert load(tmp_path / "r.urdf", wheels=names).base.kind == "differential_drive"


# --- Plugins that name other joints -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("left", "right", "code", "words"),
    [
        ("left", "right", "", ""),
        ("right", "left", "base-heading", "does the robot drive along x"),
        ("wheel_l", "wheel_r", "base-stated", "names 'wheel_r', which the robot does not have"),
        ("left, left", "right", "base-stated", "names 'left, left', which a simulator takes as one joint"),
    ],
)
def test_a_plugin_that_swaps_the_sides_or_names_nothing_is_told(left, right, code, words):
    plugin = f"<plugin name='d' filename='x'><leftJoint>{left}</leftJoint><rightJoint>{right}</rightJoint></plugin>"
    text = chassis(f"{pair()}<gazebo>{plugin}</gazebo>")
    if code == "base-heading":
        with pytest.raises(AuditError, match=words):
            robot_of(text)
        return
    found = codes(robot_of(text))
    assert words in found[code] if code else not {"base-sides", "base-stated"} & found.keys()


# --- What robots of the eighth sample have in common ------------------------------------------------------------------


def shifted(text: str, by: tuple[float, float, float]) -> str:
    """The same robot, its root link's origin elsewhere in its body."""
    root = etree.fromstring(text)
    on_root = [j for j in root.iterchildren("joint") if j.find("parent").get("link") == "base"]
    for holder in (*on_root, *root.find("link[@name='base']")):
        place = holder.find("origin")
        place = etree.SubElement(holder, "origin", xyz="0 0 0") if place is None else place
        place.set("xyz", words(np.array(place.get("xyz").split(), float) + by))
    return etree.tostring(root, encoding="unicode")


OMNI = [k * 2 * math.pi / 3 for k in range(3)]
MECANUM = "".join(rollers(name, a) for name, a in {"fl": -0.6, "fr": 0.6, "rl": 0.6, "rr": -0.6}.items())
PLACES = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
TREADS = "".join(
    link(f"{n}_track", 1.0) + joint(f"{n}_weld", "fixed", "base", f"{n}_track", p=(0, y, 0.1))
    for n, y in (("left", 0.3), ("right", -0.3))
)


@pytest.mark.parametrize(
    "text",
    [chassis(pair() + BALL), four(more=MECANUM), four(more=TREADS), three(OMNI)],
    ids=["drive", "mecanum", "tracks", "omni"],
)
@given(PLACES)
@settings(max_examples=10, deadline=None)
def test_a_robot_reads_the_same_wherever_its_root_has_its_origin(text, by):
    here, there = robot_of(text), robot_of(shifted(text, by))
    assert there.base.kind == here.base.kind and there.joint_names == here.joint_names
    assert [w.joint for w in there.base.wheels] == [w.joint for w in here.base.wheels]
    assert [(w.x, w.y, w.radius) for w in there.base.wheels] == [
        pytest.approx((w.x, w.y, w.radius), abs=1e-9) for w in here.base.wheels
    ]
    assert there.base.casters == here.base.casters and there.base.locked == here.base.locked
    assert np.subtract(there.base.frame, here.base.frame) == pytest.approx((*by[:2], 0.0), abs=1e-9)


@given(PLACES)
@settings(max_examples=10, deadline=None)
def test_a_drone_and_two_endless_joints_are_refused_wherever_the_root_has_its_origin(by):
    with pytest.raises(Unsupported, match="drone"):
        robot_of(shifted(drone().replace("frame", "base"), by))
    odd = drive_of("", 0.2, 0.1).replace('<axis xyz="0.0 1.0 0.0"/>', '<axis xyz="1 0 0"/>')
    with pytest.raises(Undecided, match="2 wheel"):
        robot_of(shifted(odd.replace('xyz="0 1 0"', 'xyz="1 0 0"'), by))


def test_three_wheels_with_rollers_stand_on_the_floor_though_the_body_and_its_frame_are_lower():
    rims = "".join(rollers(f"w{i}", 0.0, radius=0.06) for i in range(3))
    text = (
        three(OMNI)
        .replace("</robot>", f"{rims}</robot>")
        .replace('<box size="0.3 0.2 0.1"/>', '<mesh filename="gone.stl"/>')
    )
    low = shifted(text.replace("<inertial>", '<inertial><origin xyz="0 0 -0.3"/>', 1), (0.0, 0.0, 0.1))
    robot = robot_of(low)
    assert robot.base.kind == "holonomic" and len(robot.base.wheels) == 3 and robot.joint_names == ("shoulder", "elbow")


def walker(hinges: int) -> str:
    """Two limbs of so many hinges, four wheels under each."""
    text = ""
    for side, y in (("left", 0.2), ("right", -0.2)):
        above = "base"
        for k in range(hinges):
            text += link(f"{side}{k}", 0.5)
            text += joint(
                f"{side}_hinge{k}", "revolute", above, f"{side}{k}", p=(0, 0 if k else y, 0.1), more=LIMIT.format(-1, 1)
            )
            above = f"{side}{k}"
        height = 0.05 - 0.1 * hinges
        text += "".join(
            wheel(f"{side}_w{i}", (x, 0, height), radius=0.05, parent=above)
            for i, x in enumerate((-0.3, -0.1, 0.1, 0.3))
        )
    return chassis(text)


def test_limbs_of_three_hinges_with_wheels_under_their_feet_are_legs_and_rockers_are_none():
    with pytest.raises(Unsupported, match="its wheels hang on legs"):
        robot_of(walker(3))
    assert robot_of(walker(1), base="tracked").base.kind == "tracked"


def test_a_hinge_with_stops_is_no_rotor_whatever_it_is_called():
    text = f'<robot name="r">{link("base", 5.0)}{ARM}</robot>'
    swings = text.replace("fore", "fore_rotor")
    assert robot_of(swings).joint_names == ("shoulder", "elbow")
    with pytest.raises(Unsupported, match="drone"):
        robot_of(swings.replace('"revolute"', '"continuous"'))


@pytest.mark.parametrize("shape", ["ball", "roll"])
def test_a_ball_of_a_mesh_does_not_drive_though_a_transmission_turns_it(tmp_path, shape):
    body = trimesh.creation.icosphere(3, 0.03) if shape == "ball" else trimesh.creation.cylinder(0.03, height=0.03)
    body.apply_transform(trimesh.transformations.rotation_matrix(math.pi / 2, (1, 0, 0)))
    body.export(tmp_path / "b.stl")
    third = link("b_link", 0.1, 1e-4, '<mesh filename="b.stl"/>') + joint(
        "b", "continuous", "base", "b_link", p=(0.3, 0, 0.03)
    )
    motors = "".join(f'<transmission name="t{n}"><joint name="{n}"/></transmission>' for n in ("left", "right", "b"))
    text = chassis(pair() + third + motors)
    if shape == "ball":
        robot = robot_of(text, tmp_path / "r.urdf")
        assert [w.joint for w in robot.base.wheels] == ["left", "right"] and "b" in robot.base.casters
        return
    with pytest.raises(Undecided, match="with motors, and would not drive: 'b'"):
        robot_of(text, tmp_path / "r.urdf")


def test_where_wheels_roll_along_no_axis_of_the_root_left_and_right_are_asked_for():
    def turned_by(yaw: float) -> str:
        c, s, lying = (
            math.cos(yaw),
            math.sin(yaw),
            origin(pin.rpy.rpyToMatrix(0, 0, yaw) @ pin.rpy.rpyToMatrix(math.pi / 2, 0, 0)),
        )
        drives = "".join(
            link(f"{n}_link", 1.0, 0.02, CYLINDER.format(r=0.1), lying)
            + joint(n, "continuous", "base", f"{n}_link", p=(0, y, 0.1), axis=(-s, c, 0))
            for n, y in (("left", -0.2), ("right", 0.2))
        )
        return chassis(drives + BALL)

    assert robot_of(turned_by(0.0)).base.frame[2] == 0.0  # x of the root link weighs more than names
    with pytest.raises(AuditError, match="does the robot drive along x") as error:
        robot_of(turned_by(0.07))
    robot = followed(turned_by(0.07), {"forward": "-x"})
    assert [w.joint for w in robot.base.wheels] == ["left", "right"] and "--forward -x" in error.value.fix
