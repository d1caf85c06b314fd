"""Wheels that are hard to see: without shapes, on tilted axles, steered or trailing, in files with y up."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from drives import ARM, CYLINDER, LIMIT, SPHERE, Drive, joint, link, origin, robot_of
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from test_base import CORNERS, MOVE, four, friction, wheel

from mmnn_pin.errors import ConfigError, RobotError
from mmnn_pin.model.base.report import Undecided
from mmnn_pin.model.base.wheels import Candidates, wheel_candidates
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.urdf.reading import parse
from mmnn_pin.model.urdf.shapes import AtRest

FOOT = joint("foot", "fixed", "footprint", "base") + '<link name="footprint"/>'
BALL = link("ball", 0.1, 1e-4, SPHERE.format(r=0.05)) + joint("b", "fixed", "base", "ball", p=(-0.2, 0, 0.05))
LYING = origin(pin.rpy.rpyToMatrix(math.pi / 2, 0, 0))


def codes(robot) -> list[str]:
    return [f.code for f in robot.findings]


def blind(more: str = "", box: float | None = 0.2, mesh: str = "") -> str:
    """A drive with wheels of 0.1 m without a shape that can be read, and a chassis with its middle this high."""
    text = link("base", 20.0, 0.8, "" if box is None else '<box size="0.3 0.2 0.1"/>', origin(p=(0, 0, box or 0)))
    for name, y in (("left", 0.2), ("right", -0.2)):
        text += link(f"{name}_link", 1.5, 0.02, f'<mesh filename="{mesh}"/>' if mesh else "")
        text += joint(name, "continuous", "base", f"{name}_link", p=(0, y, 0.1))
    return f'<robot name="r">{text}{ARM}{more}</robot>'


# --- The radius of wheels without a shape -----------------------------------------------------------------------------


@pytest.mark.parametrize("mesh", ["", "package://gone/wheel.stl", "http://nowhere/wheel.stl"])
@pytest.mark.parametrize(("more", "box"), [(FOOT, None), (FOOT, 0.2), (FOOT, 0.11), (BALL, 0.2), (FOOT + BALL, None)])
def test_hub_height_above_a_footprint_or_a_ball_is_asked_about(more, box, mesh):
    with pytest.raises(RobotError, match=r"'left' 0.1 m, 'right' 0.1 m\?.*--radius 0.1 if so, else --radius METRES"):
        robot_of(blind(more, box, mesh))
    robot = robot_of(blind(more, box, mesh), radius=0.1)
    assert robot.base.kind == "differential_drive" and [w.radius for w in robot.base.wheels] == pytest.approx([0.1] * 2)


@pytest.mark.parametrize("mesh", ["", "package://gone/wheel.stl"])
@pytest.mark.parametrize("box", [None, 0.2, 0.11, 0.4])
def test_where_nothing_tells_the_floor_it_asks_for_the_radius(box, mesh):
    with pytest.raises(Undecided, match=r"radius unknown.*nothing tells where the floor is.*--radius") as error:
        robot_of(blind("", box, mesh))
    assert len(error.value.candidates) == 2
    robot = robot_of(blind("", box, mesh), radius=0.1)
    assert robot.base.kind == "differential_drive" and "base-hub-height" not in codes(robot)
    assert [w.radius for w in robot.base.wheels] == [0.1, 0.1] and robot.base.floor == pytest.approx(0.0)
    with pytest.raises(ConfigError, match="radius of wheel 'left' is unknown"):
        robot_of(blind("", box, mesh), wheels=("left", "right"))
    assert robot_of(blind("", box, mesh), base="fixed").arm.reasons["left"] == "part of the base"


def test_a_tool_that_turns_does_not_tell_the_floor():
    spinner = link("tool", 0.2, 1e-3, SPHERE.format(r=0.03)) + joint("t", "continuous", "fore", "tool", p=(0.2, 0, 0))
    with pytest.raises(Undecided, match="radius unknown"):
        robot_of(blind(spinner, 0.4))


def test_what_is_not_round_is_no_finger():
    box = '<box size="0.2 0.03 0.2"/>'
    with pytest.raises(Undecided, match="not round"):
        robot_of(Drive(shape=box).urdf())
    assert [w.radius for w in robot_of(Drive(shape=box).urdf(), wheels=("left", "right"), radius=0.1).base.wheels] == [
        0.1,
        0.1,
    ]


def test_a_base_that_is_said_and_not_found_is_not_ignored():
    table = f'<robot name="r">{link("base", 5.0)}{ARM}</robot>'
    with pytest.raises(Undecided, match=r"it could be differential_drive: .*--wheels"):
        robot_of(table, base="differential_drive")
    assert robot_of(table, base="holonomic").base.kind == "holonomic"


@pytest.mark.parametrize("scale", ["", ' scale="1 1 1"'])
def test_a_wheel_mesh_in_millimetres_is_refused(tmp_path: Path, scale: str):
    import trimesh

    trimesh.creation.cylinder(100.0, 30.0).export(tmp_path / "wheel.stl")
    text = Drive(shape=f'<mesh filename="wheel.stl"{scale}/>').urdf()
    with pytest.raises(RobotError, match=r"radius of 100 m.*millimetres.*\[base-size\]"):
        robot_of(text, tmp_path / "r.urdf")
    assert robot_of(text, tmp_path / "r.urdf", radius=0.1).base.wheels[0].radius == 0.1  # as it says
    right = robot_of(text.replace('stl"', 'stl" scale="0.001 0.001 0.001"').replace(scale + "/>", "/>"),
                     tmp_path / "r.urdf", strict=True)  # fmt: skip
    assert right.base.wheels[0].radius == pytest.approx(0.1)


@pytest.mark.filterwarnings("error")
def test_a_mesh_that_its_scale_blows_up_is_no_shape(tmp_path: Path):
    import trimesh

    trimesh.creation.cylinder(100.0, 30.0).export(tmp_path / "wheel.stl")
    drive = Drive(shape='<mesh filename="wheel.stl" scale="1e308 1e308 1e308"/>')
    with pytest.raises(Undecided, match="radius unknown"):
        robot_of(drive.urdf(), tmp_path / "r.urdf")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("word", ["nan", "inf"])
def test_a_mesh_that_is_not_finite_is_no_shape(tmp_path: Path, word: str):
    facet = f"facet normal 0 0 1\nouter loop\nvertex {word} 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    (tmp_path / "wheel.stl").write_text(f"solid\n{facet}endsolid\n")
    with pytest.raises(Undecided):
        robot_of(Drive(shape='<mesh filename="wheel.stl"/>').urdf(), tmp_path / "r.urdf")


# --- Axles that are not level -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("camber", [1.5, 3.0, 10.0])
def test_cambered_wheels_are_not_taken_for_fingers(camber):
    text = link("base", 20.0, 0.8, '<box size="0.3 0.2 0.1"/>', origin(p=(0, 0, 0.2)))
    for name, side in (("left", 1), ("right", -1)):
        R = pin.rpy.rpyToMatrix(side * math.radians(camber), 0, 0)
        text += link(f"{name}_link", 1.5, 0.02, CYLINDER.format(r=0.1), LYING)
        text += joint(name, "continuous", "base", f"{name}_link", R, (0, 0.2 * side, 0.1))
    with pytest.raises(Undecided, match=f"tilted by {camber:.2g} degrees.*camber"):
        robot_of(f'<robot name="r">{text}{ARM}</robot>')


def test_a_file_with_y_up_is_told():
    text = link("base", 20.0, 0.8, '<box size="0.3 0.1 0.2"/>', origin(p=(0, 0.2, 0)))
    for name, z in (("left", -0.2), ("right", 0.2)):
        text += link(f"{name}_link", 1.5, 0.02, CYLINDER.format(r=0.1))
        text += joint(name, "continuous", "base", f"{name}_link", p=(0, 0.1, z), axis=(0, 0, 1))
    with pytest.raises(Undecided, match=r"axle is vertical.*y up"):
        robot_of(f'<robot name="r">{text}{ARM}</robot>')


# --- What hangs on a vertical joint -----------------------------------------------------------------------------------


def caster(kind: str, limits: tuple[float, float] | None, trail: float) -> str:
    more = LIMIT.format(*limits) if limits else ""
    text = link("fork") + joint("swivel", kind, "base", "fork", p=(-0.3, 0, 0.1), axis=(0, 0, 1), more=more)
    text += link("small", 0.2, 1e-3, CYLINDER.format(r=0.05), LYING)
    return text + joint("roll", "continuous", "fork", "small", p=(-trail, 0, -0.05))


@pytest.mark.parametrize(("kind", "limits", "trail"), [
    ("continuous", None, 0.03), ("continuous", None, 0.002), ("revolute", (-math.pi, math.pi), 0.03),
    ("revolute", (-30.0, 30.0), 0.03),
])  # fmt: skip
def test_what_swivels_all_the_way_round_is_a_caster(kind, limits, trail):
    robot = robot_of(Drive().urdf(ARM + caster(kind, limits, trail)))
    assert robot.base.kind == "differential_drive" and robot.base.casters == ("swivel", "roll")


@pytest.mark.parametrize(("height", "casters"), [(0.05, ("b",)), (0.4, ())])
def test_a_ball_on_the_floor_whose_limits_are_one_value_is_a_caster(height, casters):
    ball = link("ball", 0.1, 1e-4, SPHERE.format(r=0.05))
    ball += joint("b", "revolute", "base", "ball", p=(-0.2, 0, height), more=LIMIT.format(0, 0))
    said = {} if casters else {"lock": ("b",)}  # it is asked about
    robot = robot_of(Drive().urdf(ARM + ball), **said)
    assert robot.base.casters == casters and "b" in robot.arm.locked


@pytest.mark.parametrize(("limits", "trail"), [((-0.6, 0.6), 0.03), ((-math.pi, math.pi), 0.0)])
def test_what_turns_within_limits_or_without_trail_steers(limits, trail):
    base = robot_of(Drive().urdf(ARM + caster("revolute", limits, trail))).base
    assert base.kind == "tricycle" and base.pivots[0].wheel[0] == pytest.approx(-trail) and base.casters == ()


FRONT = '<joint name="swivel">{0}</joint><joint name="roll">{0}</joint>'
PAIR = '<joint name="left">{0}</joint><joint name="right">{0}</joint>'
COMMAND = '<ros2_control name="c" type="system">{}</ros2_control>'
MOTORS = "<transmission name='t'>{}</transmission>"
PLUGIN = '<gazebo><plugin name="p" filename="lib{}.so"/></gazebo>'


def commands(joints: str) -> str:
    return COMMAND.format(joints.format('<command_interface name="velocity"/>'))


@pytest.mark.parametrize(
    "more",
    [commands(FRONT), commands(FRONT + PAIR), MOTORS.format(FRONT.format("")), PLUGIN.format("tricycle_drive")],
)
def test_a_wheel_without_trail_that_the_file_drives_is_a_tricycles(more):
    base = robot_of(Drive().urdf(ARM + caster("continuous", None, 0.0) + more)).base
    assert base.kind == "tricycle" and [p.joint for p in base.pivots] == ["swivel"]


@pytest.mark.parametrize("more", [commands(PAIR), MOTORS.format(PAIR.format("")), PLUGIN.format("diff-drive")])
def test_a_wheel_without_trail_is_a_caster_where_the_file_drives_the_two_others(more):
    robot = robot_of(Drive().urdf(ARM + caster("continuous", None, 0.0) + more))
    assert robot.base.casters == ("swivel", "roll") and [w.joint for w in robot.base.wheels] == ["left", "right"]


@pytest.mark.parametrize("more", ["", commands(PAIR) + PLUGIN.format("ackermann_drive")])
def test_a_wheel_without_trail_is_asked_for_where_nothing_decides(more):
    text = Drive().urdf(ARM + caster("continuous", None, 0.0) + more)
    with pytest.raises(Undecided, match="--wheels") as error:
        robot_of(text)
    assert [r.kind for r in error.value.readings] == ["differential_drive", "tricycle"]
    assert robot_of(text, wheels=("left", "right")).base.kind == "differential_drive"
    assert "--steer swivel" in error.value.fix and robot_of(text, steer=("swivel",)).base.kind == "tricycle"


def test_a_plugin_that_steers_contradicts_two_wheels():
    with pytest.raises(Undecided, match="speaks of steering: <gazebo> names 'ackermann'"):
        robot_of(Drive().urdf(ARM + PLUGIN.format("ackermann_drive")))


def swerve(trail: float) -> str:
    text = link("base", 20.0, 0.8)
    for name, (fore, side) in CORNERS.items():
        text += link(f"{name}_knuckle")
        text += joint(f"{name}_steer", "continuous", "base", f"{name}_knuckle", p=(0.2 * fore, 0.3 * side, 0.1),
                      axis=(0, 0, 1))  # fmt: skip
        text += link(f"{name}_link", 1.0, 0.02, CYLINDER.format(r=0.1), LYING)
        text += joint(name, "continuous", f"{name}_knuckle", f"{name}_link", p=(-trail, 0, 0))
    return f'<robot name="r">{text}{ARM}</robot>'


def test_a_swerve_drive_without_limits_steers_all_its_wheels_and_casters_follow():
    steers, trails = robot_of(swerve(0.0)), robot_of(swerve(0.03))
    assert steers.base.kind == "swerve" and {p.role for p in steers.base.pivots} == {"master"}
    assert trails.base.kind == "casters" and {p.role for p in trails.base.pivots} == {"passive"}
    assert steers.joint_names == trails.joint_names == ("shoulder", "elbow")
    robot = robot_of(swerve(0.0), base="holonomic")
    assert robot.base.pushes and robot.base.kind == robot_of(swerve(0.03), base="holonomic").base.kind == "holonomic"
    assert robot.joint_names == ("shoulder", "elbow")


# --- Wheels that follow others, have limits or are welded -------------------------------------------------------------


def following(text: str, masters: dict[str, str]) -> str:
    for slave, master in masters.items():
        at = text.index("</joint>", text.index(f'<joint name="{slave}"'))
        text = text[:at] + f'<mimic joint="{master}"/>' + text[at:]
    return text


SIDES = {"rl": "fl", "rr": "fr"}


@pytest.mark.parametrize("more", ["", PLUGIN.format("gazebo_ros_skid_steer_drive")])
def test_wheels_that_turn_with_the_one_in_front_are_a_skid_steers(more):
    skids = robot_of(following(four(more=more), SIDES))
    assert (
        skids.base.kind == "skid_steer"
        and skids.actuator_names[:2] == ("fl", "fr")
        and "rl" not in skids.actuator_names
    )
    cited = next(f.message for f in skids.findings if f.code == "base-evidence")
    assert "'rl' follows 'fl' (<mimic>, line " in cited and not skids.arm.slaves
    assert np.abs(skids.A @ skids.T).max() < 1e-12 and np.linalg.matrix_rank(skids.A) == len(skids.A)
    assert robot_of(following(four(more=more), SIDES), base="fixed").dimensions.base == 0
    robot = robot_of(following(four(more=more), SIDES), wheels=("fl", "fr"))
    assert robot.base.casters == ("rl", "rr")
    with pytest.raises(ConfigError, match="'rl' cannot be a drive wheel: it follows 'fl'"):
        robot_of(following(four(more=more), SIDES), wheels=("rl", "rr"))


@pytest.mark.parametrize(("text", "masters"), [
    (four(), {"rl": "fl"} | {"rr": "rl"}), (Drive().urdf(), {"right": "left"}),
    (four(lx=0.0), {"rl": "fl"}),
])  # fmt: skip
def test_other_wheels_that_follow_are_asked_for(text, masters):
    with pytest.raises(Undecided, match=r"follows '\w+' \(<mimic>") as error:
        robot_of(following(text, masters))
    assert len(error.value.candidates) >= 2


def bounded(names: tuple[str, ...], limits: tuple[float, float]) -> str:
    text = Drive().urdf()
    for name in names:
        text = text.replace(f'name="{name}" type="continuous"', f'name="{name}" type="revolute"')
        at = text.index("</joint>", text.index(f'<joint name="{name}"'))
        text = text[:at] + LIMIT.format(*limits) + text[at:]
    return text


@pytest.mark.parametrize("names", [("left", "right"), ("left",)])
@pytest.mark.parametrize("limits", [(-math.pi, math.pi), (-6.28, 6.28), (0, 0)])
@pytest.mark.parametrize("said", [{}, {"base": "differential_drive"}])
def test_wheels_with_limits_are_no_arm(names, limits, said):
    with pytest.raises(Undecided, match=r"'left'.*: revolute with limits.*type=\"continuous\"") as error:
        robot_of(bounded(names, limits), **said)
    assert len(error.value.candidates) == 2
    assert set(robot_of(bounded(names, limits), base="fixed").arm.locked) == {"left", "right"}
    pushed = robot_of(bounded(("left", "right"), limits), base="holonomic")
    assert not pushed.base.wheels and set(pushed.arm.locked) == {"left", "right"}


@given(st.floats(1.3, 6.0), st.sampled_from(["revolute", "continuous"]), st.booleans())
@settings(max_examples=20, deadline=None)
def test_a_track_that_turns_about_one_of_its_ends_is_no_wheel(apart, kind, backward):
    """Its rounds of 0.1 m and 0.05 m stand this many radii apart."""
    assume(abs(apart - 1.5) > 1e-9)  # where rounding decides
    end = CYLINDER.format(r=0.05)
    there = f"<collision>{origin(pin.rpy.rpyToMatrix(np.pi / 2, 0, 0), ((-1) ** backward * 0.1 * apart, 0, 0))}"
    there += f"<geometry>{end}</geometry></collision></link>"
    text = bounded(("left", "right"), (-1.6, 1.6)) if kind == "revolute" else Drive().urdf()
    for name in ("left_link", "right_link"):
        at = text.index("</link>", text.index(f'<link name="{name}"'))
        text = text[:at] + there + text[at + len("</link>") :]
    found = {c.joint.name for c in (*seen_in(text).wheels, *seen_in(text).limited)}
    assert found == ({"left", "right"} if apart + 0.5 < 2.0 else set())


def seen_in(text: str) -> Candidates:
    return wheel_candidates(AtRest(parse(text.encode(), "r.urdf")))


def test_travel_of_ten_turns_is_no_limit():
    assert robot_of(bounded(("left", "right"), (-50, 50))).base.kind == "differential_drive"


def fixed_pair(text: str, x: float, radius: float = 0.1, axis: str = "") -> str:
    more = "".join(
        link(f"{name}_link", shape=CYLINDER.format(r=radius), at=LYING)
        + joint(name, "fixed", "base", f"{name}_link", p=(x, y, radius)).replace('<axis xyz="0.0 1.0 0.0"/>', axis)
        for name, y in (("w_l", 0.2), ("w_r", -0.2))
    )
    return text.replace("</robot>", more + "</robot>")


@pytest.mark.parametrize("axis", ["", '<axis xyz="0 0 0"/>'])
def test_cylinders_that_are_welded_on_the_floor_are_wheels(axis):
    chassis = link("base", 20.0, 0.8, '<box size="0.3 0.2 0.1"/>', origin(p=(0, 0, 0.2)))
    with pytest.raises(Undecided, match=r"welded on \(fixed joints\): 'w_l', 'w_r'.*--base fixed"):
        robot_of(fixed_pair(f'<robot name="r">{chassis}{ARM}</robot>', 0.0, axis=axis))
    robot = robot_of(fixed_pair(Drive().urdf(), -0.3, axis=axis))
    told = next(f for f in robot.findings if f.code == "base-welded")
    assert robot.base.kind == "differential_drive" and told.severity == "warning" and "w_l, w_r" in told.message
    raised = fixed_pair(Drive().urdf(), -0.3, 0.1, axis).replace('xyz="-0.3 0.2 0.1"', 'xyz="-0.3 0.2 0.3"')
    assert "base-welded" not in codes(robot_of(raised))


# --- Names and evidence -----------------------------------------------------------------------------------------------


def test_names_on_the_wrong_side_are_told():
    with pytest.raises(RobotError, match="does the robot drive along x of the root link 'base', or along -x"):
        robot_of(Drive(names=("right_wheel", "left_wheel")).urdf())
    assert "base-sides" not in codes(robot_of(Drive(names=("left_wheel", "right_wheel")).urdf()))
    assert "base-sides" not in codes(robot_of(Drive(names=("a", "b")).urdf()))


X, O = ["1 -1 0", "1 1 0", "1 1 0", "1 -1 0"], ["1 1 0", "1 -1 0", "1 -1 0", "1 1 0"]  # noqa: E741


@pytest.mark.parametrize(("fdirs", "sign"), [(X, -1), (O, 1)])
@pytest.mark.parametrize("attribute", ["", ' expressed_in="base"', ' xmlns:gz="http://gz" gz:expressed_in="base"'])
def test_friction_directions_state_the_rollers_with_their_sign(fdirs, sign, attribute):
    robot = robot_of(four(more=friction(1, 0, fdirs, attribute)))
    assert [w.roller for w in robot.base.wheels] == pytest.approx(sign * np.pi / 4 * np.array([1, -1, -1, 1]))
    assert "base-roller" not in codes(robot)
    named = robot_of(four(more=friction(1, 0, fdirs, attribute)), wheels=tuple(CORNERS))
    assert "base-roller" not in codes(named) and (named.T == robot.T).all()


def yawed(yaw: float, more: str) -> str:
    """Four wheels whose links are turned about the vertical."""
    R = pin.rpy.rpyToMatrix(0, 0, yaw)
    text = link("base", 20.0, 0.8, '<box size="0.3 0.2 0.1"/>', origin(p=(0, 0, 0.2)))
    for name, (fore, side) in CORNERS.items():
        lying = origin(R.T @ pin.rpy.rpyToMatrix(math.pi / 2, 0, 0))
        text += link(f"{name}_link", 1.0, 0.02, CYLINDER.format(r=0.1), lying)
        text += joint(name, "continuous", "base", f"{name}_link", R, (0.2 * fore, 0.3 * side, 0.1), R.T @ [0, 1, 0])
    return f'<robot name="r">{text}{ARM}{more}</robot>'


@pytest.mark.parametrize("yaw", [0.5, -1.2])
def test_friction_directions_are_in_the_frame_of_the_link_or_the_one_they_name(yaw):
    turned = pin.rpy.rpyToMatrix(0, 0, -yaw)
    in_link = [" ".join(map(str, turned @ [float(word) for word in fdir.split()])) for fdir in O]
    for more in (friction(1, 0, in_link), friction(1, 0, O, ' expressed_in="base"')):
        rollers = [w.roller for w in robot_of(yawed(yaw, more)).base.wheels]
        assert rollers == pytest.approx(np.pi / 4 * np.array([1, -1, -1, 1]))


@pytest.mark.parametrize("fdir", ["1 0 0", "0 1 0", "0 0 1", "0 0 0", "1 x 0"])
def test_friction_along_or_across_a_wheel_says_nothing(fdir):
    with pytest.raises(Undecided):
        robot_of(four(more=friction(1, 0, [fdir] * 4)))


def test_rollers_that_leave_a_direction_undriven_are_refused():
    with pytest.raises(Undecided, match=r"leave a direction undriven.*--roller"):
        robot_of(four(more=friction(1, 0, ["1 1 0"] * 4)))
    assert robot_of(four(more=friction(1, 0, ["1 1 0"] * 4)), roller=0.7).base.kind == "holonomic"


@given(st.floats(0.3, 0.58), st.sampled_from(["", MOVE]), st.integers(0, 3))
@settings(max_examples=15, deadline=None)
def test_small_wheels_that_cannot_swivel_stand_in_for_casters_of_the_large_pair(size, plugin, wider):
    r, text = 0.1 * size, ""
    for name, (fore, side) in CORNERS.items():
        text += wheel(name, (0.25 * fore, side * (0.15 + 0.05 * wider), r), radius=r)
    text = Drive().urdf(ARM + text + plugin)
    robot = robot_of(text)
    assert robot.base.kind == "differential_drive" and {w.joint for w in robot.base.wheels} == {"left", "right"}
    assert {*robot.base.casters} == {*CORNERS} and robot.base.track == pytest.approx(0.4)
    told = next(f for f in robot.findings if f.code == "base-pair")
    assert "would have to slide: fl, fr, rl, rr" in told.message and told.fix.startswith("--base skid_steer")
    assert len(robot_of(text, base="skid_steer").base.wheels) == 6


def test_controllers_that_leave_wheels_out_speak_for_a_skid_steer():
    entry = '<joint name="{}"><command_interface name="velocity"/></joint>'
    control = f'<ros2_control name="c" type="system">{entry.format("fl")}{entry.format("fr")}</ros2_control>'
    robot = robot_of(four(more=control))
    cited = next(f.message for f in robot.findings if f.code == "base-evidence")
    assert robot.base.kind == "skid_steer" and "commands only fl, fr" in cited


def test_wheels_of_which_some_have_motors_skid():
    parts = "".join(f'<transmission name="t_{n}"><joint name="{n}"/></transmission>' for n in ("fl", "fr"))
    robot = robot_of(four(more=parts))
    assert robot.base.kind == "skid_steer" and "base-driven" in codes(robot)
    cited = next(f.message for f in robot.findings if f.code == "base-evidence")
    assert "transmissions only of fl, fr (line" in cited
    whole = "".join(f'<transmission name="t_{n}"><joint name="{n}"/></transmission>' for n in CORNERS)
    assert robot_of(four(more=whole + MOVE)).base.kind == "holonomic"


# --- Options that nothing would use -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("said", "words"), [
    ({"base": "fixed", "wheels": ("fl", "fr")}, "drive wheels for a fixed base"),
    ({"base": "fixed", "radius": 0.1}, "a radius for a base 'fixed'"),
    ({"base": "fixed", "track": 0.1}, "a track for a base 'fixed'"),
    ({"wheels": ("fl", "fr"), "roller": 0.7}, "a roller for a base 'differential_drive'"),
    ({"wheels": ("fl", "fr"), "lock": ("elbow=0.5", "elbow=1")}, "locked twice"),
    ({"wheels": ("fl", "fr"), "lock": ("elbow",), "free": ("elbow",)}, "locked and freed"),
    ({"wheels": ("fl", "fr"), "free": ("fl",)}, "'fl' cannot be freed: it is part of the base"),
    ({"wheels": ("fl", "fr"), "free": ("rl",)}, "'rl' cannot be freed: it is part of the base"),
    ({"wheels": ("fl", "fr"), "track": 1e300}, "cannot be a track"),
    ({"wheels": ("fl", "fr"), "radius": 1e-300}, "cannot be a radius"),
    ({"wheels": ("fl", "fr"), "package_dirs": ("/nowhere/at/all",)}, "no such folder"),
])  # fmt: skip
def test_what_nothing_would_use_is_refused(said, words):
    with pytest.raises(ConfigError, match=words):
        robot_of(four(), **said)


def test_a_slave_cannot_be_freed():
    slave = link("jaw") + joint("jaw", "prismatic", "fore", "jaw", more=LIMIT.format(0, 1) + '<mimic joint="elbow"/>')
    with pytest.raises(ConfigError, match="'jaw' cannot be freed: it follows another joint"):
        robot_of(four(more=MOVE + slave), free=("jaw",))


def test_what_moves_anyhow_is_not_freed_and_a_slave_is_not_locked():
    slave = link("jaw") + joint("jaw", "prismatic", "fore", "jaw", more=LIMIT.format(0, 1) + '<mimic joint="elbow"/>')
    with pytest.raises(ConfigError, match="'elbow' need not be freed"):
        robot_of(four(more=MOVE), free=("elbow",))
    assert robot_of(four(more=MOVE), free=("all",)).arm == robot_of(four(more=MOVE)).arm  # whatever there is
    with pytest.raises(ConfigError, match="'jaw' cannot be locked: it follows another joint"):
        robot_of(four(more=MOVE + slave), lock=("jaw=0.1",))
    assert robot_of(four(more=MOVE + slave), lock=("elbow=0.5",)).arm.locked == {"elbow": 0.5, "jaw": 0.5}


def test_numbers_that_only_the_map_multiplies_are_held_to_be_finite():
    slave = link("jaw") + joint("jaw", "prismatic", "fore", "jaw", more=LIMIT.format(0, 1)
                                + '<mimic joint="elbow" multiplier="1e200"/>')  # fmt: skip
    with pytest.raises(RobotError, match="base and arm are not finite"):
        robot_of(four(more=MOVE + slave))


@pytest.mark.parametrize("wheels", [None, ("left", "right")])
def test_the_floor_is_where_wheels_of_the_stated_radius_touch_it(wheels):
    hubs = robot_of(Drive(floor=0.05).urdf())
    robot = robot_of(Drive(floor=0.05).urdf(), radius=0.13, wheels=wheels)
    assert hubs.base.floor == pytest.approx(0.05) and robot.base.floor == pytest.approx(0.05 + 0.1 - 0.13)
    assert {wheel.radius for wheel in robot.base.wheels} == {0.13}


# --- Friction that no floor gives -------------------------------------------------------------------------------------


@given(st.floats(0.0, 2.0), st.floats(0.0, 10.0), st.floats(0.05, 0.2))
@settings(max_examples=40, deadline=None)
def test_friction_above_the_weight_is_told(damping, dry, radius):
    dynamics = f'<dynamics damping="{damping}" friction="{dry}"/></joint>'
    body, arm, more = Drive(radii=(radius, radius)).urdf().partition(ARM)
    robot = robot_of(body.replace("</joint>", dynamics) + arm + more)
    rolling = np.zeros(robot.dimensions.dof)
    rolling[0] = 1.0
    force = Dynamics(robot).friction(rolling)[0]
    weight = 9.81 * pin.computeTotalMass(robot.model)
    assume(abs(force / weight - 1) > 1e-6)
    told = [f for f in robot.findings if f.code == "base-friction"]
    assert bool(told) == (force > weight)
    for finding in told:
        assert f"{force:.3g} N" in finding.message and f"{force / weight:.2g} times" in finding.message
        assert f'damping="{damping:g}"' in finding.fix
