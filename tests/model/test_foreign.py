"""Twins of descriptions in the manner of other packages, their truth written down before the loader saw them."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from drives import CYLINDER, LIMIT, LYING_CYLINDER, SPHERE, UP, joint, link, origin, robot_of
from hypothesis import given, settings
from hypothesis import strategies as st
from test_base import LYING, four
from test_strange import ROBOT, chassis, followed, pair, ways_of, wheel, xacro
from test_twins import BALL, GONE, hubs, in_world
from test_wild import codes

from mmnn_pin.errors import ConfigError, RobotError
from mmnn_pin.model.base.report import Undecided, Unsupported
from mmnn_pin.model.loading import load
from mmnn_pin.model.urdf import expansion
from mmnn_pin.model.urdf.expanding import asked_first

# --- Wheels of which a mesh is missing --------------------------------------------------------------------------------


def floor_at(height: float) -> str:
    """A frame by custom on the floor, as the root."""
    return '<link name="base_footprint"/>' + joint("foot", "fixed", "base_footprint", "base", p=(0, 0, -height))


@given(st.floats(0.02, 0.095), st.sampled_from(["", "ball", "frame"]))
@settings(max_examples=12, deadline=None)
def test_a_wheel_is_measured_from_what_is_left_only_where_nothing_contradicts_it(left, witness):
    more = {"": "", "ball": BALL, "frame": floor_at(0.0)}[witness]
    text = chassis(hubs(left) + more)  # the tyre, which is missing, has 0.1
    slim = left < 0.036  # for wheels 0.4 m apart
    if not witness and slim:
        with pytest.raises(Undecided, match="none is measured from what is left") as error:
            robot_of(text)
        assert ways_of(error.value.fix)[0].keys() == {"radius"} and "--package-dir FOLDER" in error.value.fix
    hidden = witness and abs(left - 0.1) > 0.005
    if hidden:
        with pytest.raises(RobotError, match=r"heights of the hubs.*'left' 0.1 m.*--radius 0.1 if so"):
            robot_of(text)
    robot = followed(text, {"radius": "0.1"}) if hidden or (slim and not witness) else robot_of(text)
    radius = [w.radius for w in robot.base.wheels]
    if not witness and not slim:  # told as the collision shape's
        assert radius == pytest.approx([left, left]) and "base-shapes" in codes(robot)
    elif hidden or slim:
        assert radius == pytest.approx([0.1, 0.1])  # as it was said
    else:
        assert radius == pytest.approx([left, left]) or radius == pytest.approx([0.1, 0.1])


def test_four_hubs_without_a_floor_are_asked_about():
    shape = f"{GONE}<collision>{LYING_CYLINDER}<geometry>{CYLINDER.format(r=0.03)}</geometry></collision>"
    own = re.compile(r"<collision>.*?</collision>")
    text = "".join(own.sub(shape, wheel(f"w{i}", (x, y, 0.1))) for i, (x, y) in enumerate(CORNERS))
    text = chassis(text + "<gazebo><plugin name='skid_steer_drive'/></gazebo>")
    with pytest.raises(Undecided, match="none is measured from what is left"):
        robot_of(text)
    robot = robot_of(text, radius=0.1)
    assert robot.base.kind == "skid_steer" and {w.radius for w in robot.base.wheels} == {0.1}


CORNERS = [(0.2, 0.25), (0.2, -0.25), (-0.2, 0.25), (-0.2, -0.25)]


def test_a_wheel_that_is_named_is_not_measured_from_its_hub_either():
    with pytest.raises(ConfigError, match=r"no shape of it can be read whole.*give --radius"):
        robot_of(chassis(hubs(0.03)), wheels=("left", "right"))
    with pytest.raises(RobotError, match=r"--radius 0.1 if so"):
        robot_of(chassis(hubs(0.03) + BALL), wheels=("left", "right"))


@pytest.mark.parametrize(("stated", "radius"), [(0.1, 0.1), (0.029, 0.03), (0.01, None)])
def test_a_stated_radius_counts_where_it_is_not_less_than_the_hub(stated, radius):
    text = chassis(f"{hubs(0.03)}<gazebo><plugin name='d'><wheel_radius>{stated}</wheel_radius></plugin></gazebo>")
    if radius is None:
        with pytest.raises(Undecided, match="none is measured"):
            robot_of(text)
        return
    assert robot_of(text).base.wheels[0].radius == pytest.approx(radius)


@given(st.floats(0.02, 0.06), st.sampled_from([0.0, 0.005]))
@settings(max_examples=8, deadline=None)
def test_a_motor_on_the_axle_is_no_caster(radius, above):
    lying = CYLINDER.format(r=radius)
    motor = link("motor", 1.0, 0.01, lying, LYING_CYLINDER) + joint(
        "m", "fixed", "base", "motor", p=(0, 0, 0.1 + above)
    )
    text = chassis(re.sub(r"<collision>.*?</collision>", "", hubs(0.03)) + motor)
    with pytest.raises(Undecided, match="nothing tells where the floor is") as error:
        robot_of(text)
    assert "--radius METRES" in error.value.fix and robot_of(text, radius=0.1).base.wheels[0].radius == 0.1


# --- Shapes that do not suit their joints -----------------------------------------------------------------------------


def test_a_forgotten_axis_is_named_with_the_one_that_is_right():
    text = chassis(pair().replace('<axis xyz="0.0 1.0 0.0"/>', ""))
    with pytest.raises(Undecided, match=r"lies along 0 1 0 in its link, and its joint turns about 1 0 0") as error:
        robot_of(text)
    assert "LEFT" not in error.value.fix and ways_of(error.value.fix) == [{"base": "fixed"}]
    assert robot_of(chassis(pair())).base.kind == "differential_drive"  # as it says, with the axis along the cylinders


def test_an_upright_cylinder_on_a_lying_axle_is_told():
    text = chassis(pair().replace(LYING, ""))
    with pytest.raises(Undecided, match="lies along 0 0 1 in its link, and its joint turns about 0 1 0") as error:
        robot_of(text)
    wheels = next(way for way in ways_of(error.value.fix) if "wheels" in way)["wheels"]
    assert robot_of(text, wheels=tuple(wheels.split(",")), radius=0.1).base.track > 0


@pytest.mark.parametrize("unit", [1000.0, 100.0])
def test_a_whole_file_in_millimetres_or_centimetres_is_refused(unit):
    def larger(hit: re.Match) -> str:
        return f'{hit[1]}="{" ".join(repr(float(v) * unit) for v in hit[2].split())}"'

    text = re.sub(r'(?<!axis )(xyz|size|radius|length)="([^"]*)"', larger, chassis(pair() + BALL))
    for said in ({}, {"radius": 0.1}):  # a right radius does not mend the track
        with pytest.raises(RobotError, match=r"m apart: is the whole file in millimetres or centimetres.*in metres"):
            robot_of(text, **said)


# --- Bases ------------------------------------------------------------------------------------------------------------


@given(st.floats(0.4, 1.1), st.sampled_from([3, 4]))
@settings(max_examples=8, deadline=None)
def test_tilted_wheels_around_the_base_are_no_heads_of_an_arm(tilt, count):
    text = ""
    for i in range(count):
        turn = 2 * math.pi * i / count
        axis = np.array([math.cos(turn) * math.cos(tilt), math.sin(turn) * math.cos(tilt), -math.sin(tilt)])
        text += link(f"w{i}_link", 0.3, 0.001, SPHERE.format(r=0.03))
        at = (0.1 * math.cos(turn), 0.1 * math.sin(turn), 0.1)
        text += joint(f"w{i}", "continuous", "base", f"w{i}_link", p=at, axis=axis)
    with pytest.raises(Undecided, match="about tilted axes") as error:
        robot_of(chassis(text))
    for way, kind in zip(ways_of(error.value.fix), ("holonomic", "fixed"), strict=True):
        robot = followed(chassis(text), way)
        assert robot.base.kind == kind and robot.joint_names == ("shoulder", "elbow")


def sides(name: str) -> str:
    """Two bodies welded to the sides of the base."""
    text = "".join(
        link(f"{side}_{name}", 5.0) + joint(f"{side}_j", "fixed", "base", f"{side}_{name}", p=(0, y, 0.05))
        for side, y in (("left", 0.2), ("right", -0.2))
    )
    return re.sub("<axis[^>]*>", "", text)


def test_an_arm_on_welded_tracks_is_a_tracked_machine():
    with pytest.raises(Unsupported, match="tracked machine perhaps: 'left_track' and 'right_track'") as error:
        robot_of(chassis(sides("track")))
    assert [followed(chassis(sides("track")), way).base.kind for way in ways_of(error.value.fix)] == [
        "holonomic",
        "fixed",
    ]
    assert robot_of(chassis(sides("armrest"))).base.kind == "fixed"
    rail = sides("track").partition('<link name="right')[0]  # of a linear axis, on one side
    assert robot_of(chassis(rail)).base.kind == "fixed"


@given(st.floats(0.0, 0.3))
@settings(max_examples=8, deadline=None)
def test_an_arm_that_hangs_below_the_floor_at_rest_lifts_no_wheels(below):
    hanging = link("drop", 1.0, 0.01, '<box size="0.03 0.03 0.4"/>', origin(p=(0, 0, -0.2)))
    hanging += joint("hang", "revolute", "base", "drop", p=(0.3, 0, 0.4 - below), more=LIMIT.format(-1, 1))
    robot = robot_of(chassis(pair() + BALL + hanging))
    assert robot.base.kind == "differential_drive" and robot.base.floor == pytest.approx(0)
    told = [f.message for f in robot.findings if f.code == "base-floor"]
    assert bool(told) == (below > 0.02) or 0.015 < below < 0.025
    if below > 0.03:  # two wheels alone stand on no floor: what is lowest by more than their radius counts
        with pytest.raises(Undecided, match="above the robot's lowest point"):
            robot_of(chassis(pair() + hanging.replace("0.03 0.03 0.4", "0.03 0.03 0.6")))


@pytest.mark.parametrize(("mass", "kind"), [(1e-3, "differential_drive"), (1.0, "differential_drive"), (5.0, None)])
def test_virtual_joints_may_weigh_as_little_as_a_simulator_asks(mass, kind):
    text = (
        in_world(pair()).replace('<link name="vx"/>', link("vx", mass)).replace('<link name="vy"/>', link("vy", mass))
    )
    if kind:
        robot = robot_of(text)
        assert robot.base.kind == kind and robot.joint_names == ("shoulder", "elbow")
        return
    with pytest.raises(RobotError):
        robot_of(text)


def test_wheels_beside_others_with_limits_are_offered_by_name():
    text = ""
    for i, y in enumerate((0.1, -0.1)):
        text += link(f"c{i}_link", 0.3, 0.001, CYLINDER.format(r=0.05), LYING_CYLINDER)
        limits = LIMIT.format(-3, 3)
        text += joint(f"c{i}", "revolute", "base", f"c{i}_link", p=(-0.25, y, 0.05), more=limits)
    text = chassis(pair() + text)
    with pytest.raises(Undecided, match="revolute with limits") as error:
        robot_of(text)
    robot = followed(text, ways_of(error.value.fix)[0])
    assert robot.base.kind == "differential_drive" and robot.base.track == robot_of(chassis(pair())).base.track


def test_wheels_of_a_skid_steer_base_that_have_no_motors_are_told():
    named = "<left_joint>rl</left_joint><right_joint>rr</right_joint>"
    plugin = f"<gazebo><plugin name='diff_drive' filename='x'>{named}</plugin></gazebo>"
    told = next(f for f in robot_of(four(more=plugin)).findings if f.code == "base-driven")
    assert "only rl, rr have motors" in told.message
    assert followed(four(more=plugin), ways_of(told.fix)[0]).base.kind == "differential_drive"
    every = named.replace("<left", "<left_joint>fl</left_joint><right_joint>fr</right_joint><left", 1)
    assert "base-driven" not in codes(robot_of(four(more=plugin.replace(named, every))))


def test_joints_whose_limits_are_one_value_are_asked_about():
    stiff = LIMIT.format(0, 0)
    caster = link("fork", 0.3) + joint("turn", "revolute", "base", "fork", p=(-0.2, 0.1, 0.13), axis=UP, more=stiff)
    caster += link("roll", 0.1) + joint("rolls", "revolute", "fork", "roll", p=(-0.05, 0, -0.08), more=stiff)
    with pytest.raises(RobotError, match="turn, rolls have limits of one value") as error:
        robot_of(chassis(pair() + caster))
    assert error.value.fix == "--free turn --free rolls if so, --lock turn --lock rolls if not"
    assert robot_of(chassis(pair() + caster), lock=("turn", "rolls")).joint_names == ("shoulder", "elbow")
    assert {"turn", "rolls"} <= {*robot_of(chassis(pair() + caster), free=("turn", "rolls")).joint_names}


# --- xacro ------------------------------------------------------------------------------------------------------------


def packed(folder, name: str, **files: str):
    """A package with some xacro files."""
    (folder / name).mkdir()
    (folder / name / "package.xml").write_text(f"<package><name>{name}</name></package>")
    for file, text in files.items():
        inside = f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{text}</robot>'
        (folder / name / f"{file}.xacro").write_text(inside)


def test_a_file_that_a_package_lacks_is_left_out_and_told(tmp_path):
    packed(tmp_path, "cams", here='<xacro:macro name="cam"><link name="eye"/></xacro:macro>')
    file = xacro(tmp_path, '<xacro:include filename="$(find cams)/gone.xacro"/>' + ROBOT)
    assert "cams/gone.xacro" in codes(load(file))["xacro-package"]
    used = xacro(tmp_path, '<xacro:include filename="$(find cams)/gone.xacro"/><xacro:dog/>' + ROBOT)
    with pytest.raises(RobotError, match=r"unknown macro name: xacro:dog.*\(cams/gone.xacro\).*--without dog"):
        load(used)
    assert load(used, without=("dog",)).base.kind == "differential_drive"


def test_a_macro_in_a_comment_is_none(tmp_path):
    """What is called as it is then is an element that nothing defines, which is left as it is."""
    macro = '<!--\n<xacro:macro name="weigh" params="m"><inertial/></xacro:macro>\n-->'
    assert load(xacro(tmp_path, f'{macro}<weigh m="1"/>{ROBOT}')).base.kind == "differential_drive"


def test_a_call_with_a_parameter_of_another_version_names_the_macro(tmp_path):
    packed(tmp_path, "cams", here='<xacro:macro name="cam" params="on"><link name="${on}_eye"/></xacro:macro>')
    call = '<xacro:include filename="$(find cams)/here.xacro"/>\n<xacro:cam on="base" topics_ns="a"/>'
    file = xacro(tmp_path, call + ROBOT)
    with pytest.raises(RobotError, match=r'Invalid parameter "topics_ns".*version.*--without cam') as error:
        load(file)
    assert file.read_text().splitlines()[error.value.line - 1].startswith("<xacro:cam")
    assert load(file, without=("cam",)).base.kind == "differential_drive"


def test_a_macro_without_which_nothing_is_left_is_not_offered_to_be_left_out(tmp_path):
    call = '<xacro:include filename="$(find far_base)/body.xacro"/><xacro:body/>'
    file = xacro(tmp_path, call + '<link name="top"/>' + joint("t", "fixed", "base", "top"))
    with pytest.raises(RobotError, match=r"\(far_base\)\? Give the folder of the package with --package-dir$"):
        load(file)


def test_what_hangs_on_a_macro_that_is_left_out_is_left_out_on_both_sides(tmp_path):
    packed(tmp_path, "cams", here="")
    mount = '<link name="mount"/>' + joint("m", "fixed", "base", "mount") + joint("e", "fixed", "mount", "eye")
    file = xacro(tmp_path, f'<xacro:include filename="$(find cams)/gone.xacro"/><xacro:eye on="mount"/>{mount}{ROBOT}')
    assert load(file, without=("eye",)).base.kind == "differential_drive"


def test_a_missing_relative_include_and_variable_are_named_with_what_to_do(tmp_path):
    with pytest.raises(RobotError, match=r"bring 'arm.xacro' to that place"):
        load(xacro(tmp_path, '<xacro:include filename="parts/arm.xacro"/>' + ROBOT))
    with pytest.raises(RobotError, match=r"set it where you start: NO_SUCH_NAME=VALUE mmnn"):
        load(xacro(tmp_path, '<xacro:include filename="$(env NO_SUCH_NAME)"/>' + ROBOT))


def test_a_simulators_include_is_no_call_of_xacro(tmp_path):
    sdf = "<gazebo><include><uri>model://sun</uri></include></gazebo>"
    robot = load(xacro(tmp_path, ROBOT + sdf + '<xacro:property name="a" value="1"/>'))
    assert "xacro-prefix" not in codes(robot)


def test_a_file_is_expanded_again_just_when_something_that_it_reads_has_changed(tmp_path, monkeypatch):
    part = tmp_path / "part.xacro"
    part.write_text('<robot><link name="a"/></robot>')
    (tmp_path / "sizes.yaml").write_text("name: b\n")
    text = '<xacro:include filename="part.xacro"/><xacro:property name="t" value="${xacro.load_yaml(\'sizes.yaml\')}"/>'
    name = "${t['name']}"
    more = f'<link name="{name}"/>' + joint("to_a", "fixed", "base", "a") + joint("to_b", "fixed", "base", name)
    file, runs, run = xacro(tmp_path, text + more + ROBOT), [], expansion.run
    monkeypatch.setattr(expansion, "run", lambda *given: (runs.append(1), run(*given))[1])
    first = expansion.expand(file).data
    assert expansion.expand(file).data == first and len(runs) == 1 and b'"b"' in first
    (tmp_path / "sizes.yaml").write_text("name: other\n")
    assert b'"other"' in expansion.expand(file).data and len(runs) == 2
    part.unlink()
    with pytest.raises(RobotError, match="part"):
        expansion.expand(file)


# --- Rovers -----------------------------------------------------------------------------------------------------------


def rover(hang: float, steered: bool = False) -> str:
    """Six wheels, two of them on a bogie that hangs on a rocker; at rest those of the right rear hang in the air."""
    text = ""
    for side, y in (("l", 0.3), ("r", -0.3)):
        more, up = LIMIT.format(-0.5, 0.5), hang * (side == "r")
        text += link(f"{side}_rocker", 1.0) + joint(
            f"{side}_r", "revolute", "base", f"{side}_rocker", p=(0, y, 0.2), axis=(0, 1, 0), more=more
        )
        text += link(f"{side}_bogie", 0.5) + joint(
            f"{side}_b", "revolute", f"{side}_rocker", f"{side}_bogie", p=(-0.2, 0, 0), axis=(0, 1, 0), more=more
        )
        for name, parent, at in (
            ("front", "rocker", (0.3, 0, -0.1)),
            ("middle", "bogie", (0.2, 0, -0.1)),
            ("rear", "bogie", (-0.15, 0, -0.1 + up)),
        ):
            above = f"{side}_{parent}"
            if steered and name != "middle":
                text += link(f"{side}_{name}_fork", 0.3) + joint(
                    f"{side}_{name}_s", "revolute", above, f"{side}_{name}_fork", p=at, axis=(0, 0, 1), more=more
                )
                above, at = f"{side}_{name}_fork", (0, 0, 0)
            text += wheel(f"{side}_{name}", at, parent=above)
    return chassis(text)


@given(st.floats(0.0, 0.09))
@settings(max_examples=8, deadline=None)
def test_wheels_of_a_rover_sink_to_the_floor_on_their_rockers_and_bogies(hang):
    try:
        robot = robot_of(rover(hang))
    except Undecided as error:
        robot = followed(rover(hang), next(way for way in ways_of(error.fix) if way.get("base") == "skid_steer"))
    assert robot.base.kind == "skid_steer" and len(robot.base.wheels) == 6
    assert robot.base.track == pytest.approx(0.6) and robot.joint_names == ("shoulder", "elbow")


def test_a_wheel_that_nothing_lets_sink_stays_in_the_air():
    text = rover(0.09).replace('type="revolute"', 'type="fixed"')
    with pytest.raises(Undecided) as error:
        robot_of(text)
    assert "'r_rear'" not in error.value.what


def test_a_rover_that_steers_is_no_legged_machine():
    base = robot_of(rover(0.0, steered=True)).base
    assert base.kind == "car_like" and {p.role for p in base.pivots} == {"master", "follower"}


# --- Faults that do not matter ----------------------------------------------------------------------------------------


def test_limits_of_a_finger_that_stands_still_may_be_in_the_wrong_order():
    finger = link("finger", 0.1) + joint(
        "left_finger", "prismatic", "base", "finger", p=(0.2, 0, 0.3), more=LIMIT.format(0, -0.08)
    )
    robot = robot_of(chassis(pair() + finger), lock=("left_finger",))
    assert [f.severity for f in robot.findings if f.code == "limit-order"] == ["warning"]
    with pytest.raises(RobotError, match="or --lock left_finger"):
        robot_of(chassis(pair() + finger), free=("left_finger",))


@pytest.mark.parametrize("tag", ["colision", "visaul"])
def test_a_shape_whose_tag_is_misspelt_is_missed_as_other_loaders_miss_it(tag):
    shape = f"<{tag}><geometry><box size='1 1 1'/></geometry></{tag}></link>"
    robot = robot_of(chassis(pair()).replace("</link>", shape, 1))
    assert [f.severity for f in robot.findings if f.code == "misspelt-shape"] == ["warning"]


def test_an_argument_that_the_first_tag_asks_for_has_the_default_that_stands_below(tmp_path):
    file, text = tmp_path / "arm.urdf.xacro", chassis(pair())
    head = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="$(arg name)">'
    told = "<xacro:arg default='two' name='other'/><xacro:arg name='name' default='cart'/>"
    file.write_text(re.sub(r"<robot[^>]*>", head + told, text, count=1))
    assert asked_first(file.read_text()) == {"name": "cart"}
    assert b'name="cart"' in expansion.expand(file).data
    assert b'name="mine"' in expansion.expand(file, given=("name:=mine",)).data
    file.write_text(re.sub(r"<robot[^>]*>", head, text, count=1))
    with pytest.raises(RobotError, match="give it: --xacro name:=VALUE"):
        load(file)
