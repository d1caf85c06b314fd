"""Twins of robots of the wild, with answers known in closed form: treads, rollers, missing meshes, omni wheels."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from drives import ARM, CYLINDER, LIMIT, SPHERE, joint, link, origin, robot_of
from hypothesis import given, settings
from hypothesis import strategies as st
from test_base import MOVE, four

from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError, RobotError, UnknownName
from mmnn_pin.lab.show.robots import interfaces
from mmnn_pin.lab.show.table import terminal_text
from mmnn_pin.model.base.report import Undecided, Unsupported
from mmnn_pin.model.checks.properties import check
from mmnn_pin.model.inspection import interfaces_of
from mmnn_pin.model.loading import load

LYING = origin(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))  # z of a shape along y


def codes(robot) -> dict[str, str]:
    return {f.code: f.message for f in robot.findings}


def tyre(file: Path, radius: float, width: float, hub: float) -> str:
    """A wheel about z: a tyre of this width at z = 0, and a motor of 0.6 of its radius that reaches to -hub."""
    rim = trimesh.creation.cylinder(radius=radius, height=width, sections=64)
    motor = trimesh.creation.cylinder(radius=0.6 * radius, height=hub, sections=32)
    motor.apply_translation([0, 0, -hub / 2])
    trimesh.util.concatenate([rim, motor]).export(file)
    return f'<mesh filename="{file.name}"/>'


def drive_of(shape: str, y: float, radius: float, tag: str = "collision", more: str = ARM) -> str:
    """Two wheels at +-y whose meshes have their motors inwards."""
    text = link("base", 20.0, 0.8, '<box size="0.3 0.2 0.1"/>', origin(p=(0, 0, 0.5)))
    for name, side in (("left", 1), ("right", -1)):
        turned = np.array([[1.0, 0, 0], [0, 0, side], [0, -side, 0]])  # z of the mesh points outwards
        text += link(f"{name}_link", 1.0, 0.01, shape, origin(turned), tag)
        text += joint(name, "continuous", "base", f"{name}_link", p=(0, side * y, radius))
    return f'<robot name="drive">{text}{more}</robot>'


# --- The contact is where the tread is --------------------------------------------------------------------------------


@given(st.floats(0.03, 0.3), st.floats(0.1, 0.5), st.floats(0.2, 3.0), st.sampled_from(["collision", "visual"]))
@settings(max_examples=15, deadline=None)
def test_a_hub_moves_neither_radius_nor_track(tmp_path_factory, radius, y, hub, tag):
    folder = tmp_path_factory.mktemp("wheels")
    shape = tyre(folder / "wheel.stl", radius, 0.3 * radius, hub * radius)
    robot = robot_of(drive_of(shape, y, radius, tag), folder / "robot.urdf")
    assert robot.base.track == pytest.approx(2 * y, rel=1e-5)
    assert [w.radius for w in robot.base.wheels] == pytest.approx([radius] * 2, rel=1e-5)


def test_second_opinions_are_told_when_they_differ(tmp_path):
    shape = tyre(tmp_path / "wheel.stl", 0.1, 0.03, 0.1).replace("/>", ' scale="1 1 1"/>')
    far = drive_of(shape, 0.25, 0.1).replace('xyz="0.0 0.0 0.0" rpy', 'xyz="0.0 0.03 0.0" rpy', 0)
    plugin = "<gazebo><plugin name='d'><wheel_separation>{}</wheel_separation><wheelDiameter>{}</wheelDiameter>"
    text = far.replace("</robot>", plugin.format(0.5, 0.2) + "</plugin></gazebo></robot>")
    assert not {"base-stated", "base-joints"} & codes(robot_of(text, tmp_path / "r.urdf")).keys()
    text = far.replace("</robot>", plugin.format(0.592, 0.22) + "</plugin></gazebo></robot>")
    told = [f for f in robot_of(text, tmp_path / "r.urdf").findings if f.code == "base-stated"]
    assert [f.fix for f in told] == ["--track 0.592", "--radius 0.11"] and "<wheel_separation> (line " in told[
        0
    ].message
    assert robot_of(text, tmp_path / "r.urdf", track=0.592, radius=0.11).base.track == pytest.approx(0.592)
    assert "base-stated" not in codes(robot_of(text, tmp_path / "r.urdf", track=0.592, radius=0.11))
    file = tmp_path / "drive.yaml"
    file.write_text("base:\n  # wheel_radius: 9\n  wheel_separation: 0.45  # [m]\n  'wheel_radius' : 0.1\n")
    told = [
        f for f in robot_of(far, tmp_path / "r.urdf", controllers_file=str(file)).findings if f.code == "base-stated"
    ]
    assert [f.message.split(" states")[0] for f in told] == ["wheel_separation (drive.yaml, line 3)"]
    with pytest.raises(ConfigError, match="cannot be read"):
        robot_of(far, controllers_file=str(tmp_path / "none.yaml"))
    (study := tmp_path / "study.toml").write_text('base = "track"\n[factors]\n"feedback.base" = [1.0, 2.0]\n')
    with pytest.raises(ConfigError, match="names no controller: none of its keys"):
        robot_of(far, controllers_file=str(study))


def test_joints_that_stand_inside_their_wheels_are_told():
    text = drive_of(CYLINDER.format(r=0.1), 0.2, 0.1)
    shifted = text.replace('<origin xyz="0.0 0.0 0.0"', '<origin xyz="0.0 0.05 0.0"', 1)  # the left wheel's shape alone
    robot = robot_of(shifted)
    assert (
        robot.base.track == pytest.approx(0.45)
        and "0.45 m apart, their joints are 0.4 m" in codes(robot)["base-joints"]
    )


def test_what_a_controllers_file_led_to_stands_alone(tmp_path):
    urdf, file = tmp_path / "r.urdf", tmp_path / "c.yaml"
    urdf.write_text(four())
    file.write_text("base:\n  type: diff_drive_controller/D\n")
    (tmp_path / "r.mmnn.toml").write_text('controllers_file = "c.yaml"\n')  # from its own folder
    robot = load(urdf)
    file.unlink()
    again = robot_of(robot.urdf, **robot.facts()["overrides"])
    assert again.base.kind == "skid_steer" and np.array_equal(again.T, robot.T) and np.array_equal(again.A, robot.A)


def test_controllers_are_evidence(tmp_path):
    file = tmp_path / "c.yaml"
    for kind, words in (("skid_steer", "diff_drive_controller/D"), ("holonomic", "mecanum_drive/M")):
        file.write_text(f"base:\n  type: {words}\n")
        robot = robot_of(four(), controllers_file=str(file))
        assert robot.base.kind == kind and "(line 2)" in codes(robot)["base-evidence"]


# --- Nothing is measured from what is left ----------------------------------------------------------------------------


def test_a_hub_is_no_wheel_where_the_mesh_of_the_tyre_is_missing():
    hub = f"<collision>{LYING}<geometry>{CYLINDER.format(r=0.028)}</geometry></collision>"
    gone = drive_of('<mesh filename="package://gone/tyre.stl"/>', 0.2, 0.05)
    chassis, wheel, others = gone.partition('<link name="left_link">')
    text = chassis + wheel + others.replace("</inertial><collision>", f"</inertial>{hub}<collision>")
    with pytest.raises(Undecided, match=r"mesh missing, radius unknown.*--radius METRES, or --package-dir"):
        robot_of(text)
    assert [w.radius for w in robot_of(text, radius=0.05).base.wheels] == [0.05, 0.05]
    plugin = "<gazebo><plugin name='d'><wheel_diameter>0.1</wheel_diameter></plugin></gazebo></robot>"
    robot = robot_of(text.replace("</robot>", plugin))  # the file states it
    assert [w.radius for w in robot.base.wheels] == [0.05, 0.05] and "is what the file states" in codes(robot)[
        "base-stated"
    ]


def test_a_radius_that_cannot_be_is_told_as_such_and_in_metres_it_can():
    text = drive_of('<mesh filename="package://gone/tyre.stl"/>', 0.2, 0.05)
    with pytest.raises(
        ConfigError, match=r"radius: error: 98 m cannot be their radius: the wheels .* are 0\.\d+ m apart"
    ) as error:
        robot_of(text, radius=98.0)
    (metres,) = re.findall(r"--radius ([\d.]+) if these are millimetres", error.value.fix)
    assert [w.radius for w in robot_of(text, radius=float(metres)).base.wheels] == [0.098, 0.098]
    with pytest.raises(ConfigError, match="cannot be their radius"):  # where shapes tell it, and where they are named
        robot_of(drive_of(CYLINDER.format(r=0.05), 0.2, 0.05), radius=98.0)
    with pytest.raises(ConfigError, match="cannot be their radius"):
        robot_of(text, radius=98.0, wheels=("left", "right"))


def test_a_package_folder_that_does_not_hold_the_meshes_is_acknowledged(tmp_path):
    text = drive_of('<mesh filename="package://gone/tyre.stl"/>', 0.2, 0.05)
    with pytest.raises(Undecided) as error:
        robot_of(text, package_dirs=(str(tmp_path),))
    assert f"--package-dir FOLDER where their meshes are (not in {tmp_path})" in error.value.fix
    (tmp_path / "r.urdf").write_text(text)
    robot = load(tmp_path / "r.urdf", package_dirs=(str(tmp_path),), radius=0.05)
    (finding,) = (f for f in robot.findings if f.code == "mesh-missing")
    assert finding.fix.endswith(f"--package-dir; {tmp_path} does not hold it")


def star(
    count: int, shape: str, radius: float = 0.05, distance: float = 0.2, tilt: float = 0.0, more: str = ARM
) -> str:
    """A base on omni wheels around its middle."""
    text = link("base", 20.0, 0.8, '<box size="0.1 0.1 0.1"/>', origin(p=(0, 0, 0.3)))
    for i in range(count):
        at = 2 * math.pi * i / count + tilt
        axis = (math.cos(at), math.sin(at), 0.0)
        z = np.array(axis)
        turned = np.column_stack((np.cross([0, 0, 1.0], z), [0, 0, 1.0], z))
        text += link(f"w{i}_link", 0.5, 0.001, shape, origin(turned))
        text += joint(f"w{i}", "continuous", "base", f"w{i}_link", p=(*(distance * z[:2]), radius), axis=axis)
    return f'<robot name="star">{text}{more}</robot>'


@pytest.mark.parametrize("count", [3, 4, 5])
@given(tilt=st.floats(0, 2))
@settings(max_examples=8, deadline=None)
def test_omni_wheels_at_any_angle_roll_exactly(count, tilt):
    robot = robot_of(star(count, CYLINDER.format(r=0.05), tilt=tilt))
    assert robot.base.kind == "holonomic" and np.abs(robot.A @ robot.T).max() < 1e-12
    rates = dict(zip(robot.full_velocity_names, robot.T[:, :3] @ [0.3, -0.2, 0.7], strict=True))
    for i in range(count):
        at = 2 * math.pi * i / count + tilt
        speed = -math.sin(at) * 0.3 + math.cos(at) * -0.2 + 0.2 * 0.7  # of the hub along the wheel, counterclockwise
        assert abs(rates[f"w{i}"]) * 0.05 == pytest.approx(abs(speed), abs=1e-9)


@pytest.mark.parametrize("shape", ["", '<mesh filename="package://gone/omni.stl"/>', '<box size="0.1 0.03 0.02"/>'])
def test_wheels_all_around_are_never_an_arm(shape):
    with pytest.raises(Undecided) as error:
        robot_of(star(3, shape))
    assert len(error.value.candidates) == 3 and "--radius" in error.value.fix
    robot = robot_of(star(3, shape), wheels=("w0", "w1", "w2"), radius=0.05)  # as it says
    assert robot.base.kind == "holonomic" and robot.joint_names == ("shoulder", "elbow")
    assert robot_of(star(3, shape), base="fixed").joint_names == ("shoulder", "elbow")
    assert robot_of(star(3, shape), base="holonomic").joint_names == ("shoulder", "elbow")


def test_rollers_reach_further_than_the_rim_that_carries_them():
    text = star(3, CYLINDER.format(r=0.0175), radius=0.019)
    for i in range(3):
        at = 2 * math.pi * i / 3
        for k in range(6):
            turn = 2 * math.pi * k / 6
            along = np.array([-math.sin(at), math.cos(at), 0])
            place = 0.015 * (math.cos(turn) * np.array([0, 0, 1.0]) + math.sin(turn) * along)
            name = f"r{i}{k}"
            spin = tuple(np.cross(place, (math.cos(at), math.sin(at), 0)))
            roller = link(name, 0.01, 1e-6, SPHERE.format(r=0.004))
            roller += joint(name, "continuous", f"w{i}_link", name, p=tuple(place), axis=spin)
            text = text.replace("</robot>", roller + "</robot>")
    robot = robot_of(text)
    assert [w.radius for w in robot.base.wheels] == pytest.approx([0.019] * 3) and robot.base.kind == "holonomic"


def test_wheels_under_a_torso_that_is_the_root_are_a_base():
    text = link("torso", 20.0, 0.8) + link("shin", 5.0, 0.2)
    text += joint("knee", "revolute", "torso", "shin", p=(0, 0, -0.4), more=LIMIT.format(-1, 1))
    for name, at in (("a", (0.1, 0.15)), ("b", (0.1, -0.15)), ("c", (-0.2, 0.0))):
        text += link(f"{name}_link", 0.3, 0.001, '<mesh filename="package://gone/w.stl"/>')
        text += joint(name, "continuous", "shin", f"{name}_link", p=(*at, -0.3), axis=(1, 0, 0))
    text = f'<robot name="p">{text}{ARM.replace("base", "torso")}</robot>'
    with pytest.raises(Undecided):
        robot_of(text)
    robot = robot_of(text, base="holonomic")
    assert robot.base.pushes and robot.joint_names == ("shoulder", "elbow") and "knee" in robot.base.casters


@pytest.mark.parametrize("moving", [True, False])
def test_wheels_that_are_welded_on_are_said(moving):
    text = link("base", 20.0, 0.8, '<box size="0.1 0.1 0.1"/>', origin(p=(0, 0, 0.3)))
    for i in range(3):
        at = 2 * math.pi * i / 3
        text += link(f"wheel{i}_link", 0.5, 0.001, '<mesh filename="package://gone/omni.stl"/>')
        text += joint(f"w{i}", "fixed", "base", f"wheel{i}_link", p=(0.2 * math.cos(at), 0.2 * math.sin(at), 0.05))
    text = f'<robot name="r">{text}{ARM if moving else ""}</robot>'
    with pytest.raises(Undecided, match=r"3 wheels are welded on.*--base holonomic") as error:
        robot_of(text)
    assert ("--base fixed" in error.value.fix) == moving  # without an arm nothing is left of it
    assert robot_of(text, base="holonomic").base.pushes


def test_two_mirrored_endless_joints_are_no_arm_though_their_axes_are_wrong():
    text = (
        drive_of("", 0.2, 0.1)
        .replace('<axis xyz="0.0 1.0 0.0"/>', '<axis xyz="1 0 0"/>')
        .replace('xyz="0 1 0"', 'xyz="1 0 0"')
    )
    with pytest.raises(Undecided, match="2 wheel"):
        robot_of(text)
    assert robot_of(text, base="fixed").joint_names == ("shoulder", "elbow")


def test_two_of_three_wheels_that_have_motors_drive():
    third = link("third_link", 1.0, 0.01, CYLINDER.format(r=0.05), LYING) + joint(
        "third", "continuous", "base", "third_link", p=(0.2, 0, 0.05)
    )
    text = drive_of(CYLINDER.format(r=0.1), 0.2, 0.1).replace("</robot>", third + "</robot>")
    with pytest.raises(Undecided, match="--wheels left,right"):
        robot_of(text)
    assert robot_of(text, wheels=("left", "right")).base.casters == ("third",)
    motors = "".join(f'<transmission name="t{n}"><joint name="{n}"/></transmission>' for n in ("left", "right"))
    robot = robot_of(text.replace("</robot>", motors + "</robot>"))
    assert robot.base.casters == ("third",) and "<transmission>" in codes(robot)["base-evidence"]


# --- Locked means locked ----------------------------------------------------------------------------------------------

JAWS = "".join(
    link(name, mass, inertia)
    + joint(name, "prismatic", "fore", name, p=(0.1, side * 0.02, 0), more=LIMIT.format(0, 0.03))
    for name, side, mass, inertia in (("jaw_l", 1, 0.05, 1e-5), ("jaw_r", -1, 0.0, 0.0))
)


def test_faults_of_joints_that_stand_still_are_warnings():
    wrist = link("wrist", 0.3, 1e-3) + joint("w", "revolute", "fore", "wrist", p=(0.2, 0, 0), more=LIMIT.format(-1, 1))
    text = four(more=MOVE + wrist + JAWS.replace('"fore"', '"wrist"'))
    robot = robot_of(text)
    assert {"jaw_l", "jaw_r"} <= set(robot.arm.locked)
    told = next(f for f in robot.findings if f.code == "zero-mass")
    assert told.severity == "warning" and told.joint == "jaw_r" and "stands still" in told.why
    with pytest.raises(RobotError, match="'jaw_r' moves has no mass"):
        robot_of(text, free=("all",))
    assert check(robot, samples=3).passed
    bare = text.replace('effort="9" velocity="2"', 'velocity="2"').replace('effort="9"', "")
    with pytest.raises(RobotError, match="joint 'elbow': effort of <limit> is missing"):
        robot_of(bare)
    assert "missing-value" in codes(robot_of(bare, lock=("elbow", "w")))


def test_locked_joints_stand_with_what_follows_them_when_the_model_is_checked():
    jaws = JAWS.replace('"jaw_r"><inertial><mass value="0.0"', "").replace(
        '<joint name="jaw_r" type="prismatic">', '<joint name="jaw_r" type="prismatic"><mimic joint="jaw_l"/>'
    )
    wrist = link("wrist", 0.3, 1e-3) + joint("w", "revolute", "fore", "wrist", p=(0.2, 0, 0), more=LIMIT.format(-1, 1))
    robot = robot_of(four(more=MOVE + wrist + jaws.replace('"fore"', '"wrist"')), lock=("jaw_l=0.01",))
    assert {"jaw_l": 0.01, "jaw_r": 0.01}.items() <= robot.arm.locked.items()
    report = check(robot, samples=5)
    assert report.properties["forward_kinematics"].passed and report.passed


def test_an_inertia_is_symmetric_whichever_way_its_letters_stand():
    text = four(more=MOVE).replace('ixy="0" ixz="0" iyz="0"', 'iyx="0" izx="0" izy="0"')
    assert "transposed-inertia" in codes(robot_of(text))
    told = codes(robot_of(four(more=MOVE).replace('ixy="0"', 'ixy="0.001" iyx="0.002"', 1)))
    assert "'iyx' and 'ixy' of <inertia> differ" in told["transposed-inertia"]


def test_the_triangle_inequality_is_checked_for_the_root_too():
    base = '<inertia ixx="0.8" iyy="0.8" izz="0.8" '
    text = drive_of(CYLINDER.format(r=0.1), 0.2, 0.1)
    assert base in text and "inertia-triangle" not in codes(robot_of(text))
    text = text.replace(base, '<inertia ixx="0.8" iyy="0.8" izz="8" ')
    assert "the root's body violates the triangle" in codes(robot_of(text))["inertia-triangle"]


def test_huge_limits_are_not_taken_at_their_word():
    text = four(more=MOVE).replace('lower="0.2" upper="2"', 'lower="-1e16" upper="1e16"')
    report = check(robot_of(text), samples=5)
    assert report.passed and "elbow" in report.notes[0] and "+-pi" in report.notes[0]
    assert not any("+-pi" in note for note in check(robot_of(four(more=MOVE)), samples=2).notes)


# --- Interfaces -------------------------------------------------------------------------------------------------------


def test_interfaces_are_those_of_the_tags():
    control = (
        '<ros2_control name="c" type="system"><joint name="fl"><command_interface name="velocity"/></joint>'
        '<joint name="elbow"><command_interface name="position"/><command_interface name="effort"/></joint>'
        "</ros2_control>"
        '<transmission name="t"><joint name="shoulder"><hardwareInterface>hardware_interface/PositionJointInterface'
        "</hardwareInterface></joint></transmission>"
    )
    wheels = ("fl", "fr", "rl", "rr")  # three of them without a motor, unless they are named
    found = interfaces_of(robot_of(four(more=control), base="holonomic", wheels=wheels))
    assert found["interfaces_offered"]["elbow"] == ["effort", "position"] and found["interfaces_offered"]["fr"] == []
    used = {"fl": "velocity", "fr": "effort", "rl": "effort", "rr": "effort", "shoulder": "position", "elbow": "effort"}
    assert found["interfaces"] == used


def test_a_table_of_interfaces_folds_and_cuts_no_name():
    names = [f"arm-of-many_joints_{index}" for index in range(30)]
    offered = {name: ["effort"] for name in names}
    content = {"interfaces": dict.fromkeys(names, "effort"), "interfaces_offered": offered}
    text = terminal_text(interfaces(content))
    assert max(map(len, text.splitlines())) <= 100
    assert [word for word in text.split() if word.startswith("arm-")] == ", ".join(names).split()


# --- Files as people have them ----------------------------------------------------------------------------------------

XACRO = """<?xml version="1.0"?>
<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="length" default="1"/>
  <xacro:include filename="$(find my_parts)/urdf/parts.xacro"/>
  {more}
  <xacro:rod length="$(arg length)"/>
</robot>
"""
PARTS = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="rod" params="length">
  <link name="base"/><link name="rod"><inertial><origin xyz="0 0 ${length / 2}"/><mass value="2"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><geometry><mesh filename="$(find my_parts)/meshes/a.stl"/></geometry></visual></link>
  <joint name="j" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></xacro:macro></robot>
"""


def workspace(folder: Path, more: str = "", parts: str = PARTS, name: str = "checkout") -> Path:
    """Two packages side by side; the folder of one has another name than its package.xml."""
    own, other = folder / "my_robot" / "urdf", folder / name
    own.mkdir(parents=True)
    (other / "urdf").mkdir(parents=True)
    (other / "meshes").mkdir()
    trimesh.creation.box((1, 1, 1)).export(other / "meshes" / "a.stl")
    (other / "package.xml").write_text("<package format='2'>\n  <name>my_parts</name>\n</package>")
    (other / "urdf" / "parts.xacro").write_text(parts)
    (own / "robot.urdf.xacro").write_text(XACRO.format(more=more))
    return own / "robot.urdf.xacro"


def test_a_urdf_that_xacro_made_is_read_as_it_is(tmp_path, monkeypatch):
    """What xacro writes keeps its namespace, and macros in comments: it loads without the extra `xacro`, too."""
    monkeypatch.setattr("mmnn_pin.model.urdf.expansion.find_spec", lambda name: None)
    rest = '<!-- <xacro:wheel rpy="${90 * deg_to_rad} 0 0"/> -->'
    made = drive_of(SPHERE.format(r=0.1), 0.2, 0.1).replace(">", f' xmlns:xacro="http://ros.org/wiki/xacro">{rest}', 1)
    file = tmp_path / "robot.urdf"
    file.write_text(made)
    assert "expanded" not in codes(load(file))
    file.write_text(made.replace("<!-- ", "").replace(" -->", ""))
    with pytest.raises(RobotError, match=r"not yet a URDF.*pip install"):
        load(file)


def test_xacro_is_expanded_with_packages_by_their_names_and_arguments(tmp_path):
    file = workspace(tmp_path)
    robot = load(file, xacro=("length:=3",))
    assert robot.model.inertias[1].lever[2] == pytest.approx(1.5) and "mesh-missing" not in codes(robot)
    assert "expanded" in codes(robot) and robot.overrides.xacro == ("length:=3",)
    assert load(file).model.inertias[1].lever[2] == pytest.approx(0.5)
    with pytest.raises(ConfigError, match="write NAME:=VALUE"):
        load(file, xacro=("length=3",))


def test_folders_of_a_xacro_file_may_have_brackets(tmp_path):
    """Where xacro sees a `[`, it looks for a pattern, and goes on without the file that it does not find."""
    robot = load(workspace(tmp_path / "[1] work*space"))
    assert robot.model.inertias[1].lever[2] == pytest.approx(0.5) and "xacro-package" not in codes(robot)


def test_a_misspelt_argument_of_a_xacro_file_is_refused_with_the_one_that_is_meant(tmp_path, capsys):
    """Xacro takes it in silence, and the robot is another one than was asked for."""
    file = workspace(tmp_path, '<xacro:arg name="gripper_mass"\n default="1"/>')
    with pytest.raises(UnknownName) as refused:
        load(file, xacro=("lenght:=3", "gripper_mass:=2"))
    where = f"{file}:xacro: error: unknown argument 'lenght': did you mean 'length'? there is: gripper_mass, length"
    assert str(refused.value) == where
    assert main(["inspect", str(file), "--xacro", "lenght:=3"]) == 2
    assert "did you mean 'length'?" in capsys.readouterr().err
    assert load(file, xacro=("length:=3", "gripper_mass:=2")).model.inertias[1].lever[2] == pytest.approx(1.5)
    (bare := tmp_path / "bare.xacro").write_text(drive_of(SPHERE.format(r=0.1), 0.2, 0.1))
    with pytest.raises(UnknownName, match="there is: no argument at all"):
        load(bare, xacro=("length:=3",))


@pytest.mark.parametrize("use", ["$(arg speed)", "${xacro.arg('speed')}"])
def test_an_argument_without_a_default_counts_as_declared(use, tmp_path):
    file = workspace(tmp_path, f'<xacro:property name="s" value="{use}"/><xacro:arg name="${{\'a\'}}b" default="1"/>')
    assert load(file, xacro=("speed:=3",)).dimensions.arm == 1


@pytest.mark.parametrize("variable", ["ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", ""])
def test_packages_are_found_where_ros_has_them(tmp_path, monkeypatch, variable):
    file = workspace(tmp_path / "a")
    place = tmp_path / "far" / "away" / "from" / "it" / "share"
    place.mkdir(parents=True)
    (tmp_path / "a" / "checkout").rename(place / "my_parts")
    for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    if variable:
        monkeypatch.setenv(variable, str(place if variable == "ROS_PACKAGE_PATH" else place.parent))
        assert load(file).dimensions.arm == 1
        return
    with pytest.raises(RobotError, match=r"my_parts.*--package-dir"):
        load(file)
    assert load(file, package_dirs=[place]).dimensions.arm == 1  # as it says


def test_what_is_not_used_of_a_missing_package_is_left_out_and_told(tmp_path):
    file = workspace(tmp_path, '<xacro:include filename="$(find laser_description)/urdf/laser.xacro"/>')
    robot = load(file)
    assert "laser_description" in codes(robot)["xacro-package"] and robot.dimensions.arm == 1
    file = workspace(tmp_path / "b", '<xacro:include filename="$(find laser)/l.xacro"/><xacro:laser parent="rod"/>')
    with pytest.raises(RobotError, match=r"unknown macro name: xacro:laser.*laser.*--package-dir") as error:
        load(file)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("more", "parts", "words"), [
    ('<xacro:include filename="none.xacro"/>', PARTS, r"robot.urdf.xacro:5: error: .*No such file.*none.xacro"),
    ('<a b="$(arg speed)"/>', PARTS, r"xacro:5: error: .*Undefined substitution argument speed.*--xacro speed:=VALUE"),
    ('<a b="${1/0}"/>', PARTS, "division by zero"),
    ("", PARTS.replace("<xacro:macro", '<xacro:include filename="parts.xacro"/><xacro:macro'), "open the circle"),
    ('<xacro:macro name="m" params=""><xacro:m/></xacro:macro><xacro:m/>', PARTS, "open the circle"),
    ("<unclosed>", PARTS, "xacro cannot expand it.*mismatched tag"),
])  # fmt: skip
def test_a_xacro_file_that_cannot_be_expanded_is_one_line(tmp_path, more, parts, words):
    with pytest.raises(RobotError, match=words) as error:
        load(workspace(tmp_path, more, parts))
    assert "\n" not in str(error.value) and error.value.line


def test_a_file_that_the_build_would_install_elsewhere_is_taken_where_it_is(tmp_path):
    file = workspace(tmp_path)
    folder = tmp_path / "checkout"
    (folder / "description").mkdir()
    (folder / "urdf").rename(folder / "description" / "urdf")
    assert load(file).dimensions.arm == 1


@pytest.mark.parametrize(("name", "data", "words"), [
    ("r.usda", b"#usda 1.0\n(\n)\n", "this is USD, not a URDF: export it as URDF"),
    ("r.usd", b"PXR-USDC\0\0\0\1\2\3", r"this is USD \(binary\), not a URDF"),
    ("r.usdz", b"PK\x03\x04\0\0", "zip archive"),
    ("r.xml", b"<mujoco model='r'/>", r"MJCF \(MuJoCo\), not a URDF: convert it.*mjcf-urdf-simple-converter"),
    ("r.sdf", b"<sdf version='1.6'/>", r"SDF \(Gazebo\), not a URDF: convert it.*sdf2urdf"),
    ("r.urdf", b"version https://git-lfs.github.com/spec/v1\noid sha256:1\n", "git lfs pull"),
    ("package.xml", b"<package><name>r</name></package>", "ROS package manifest, not a URDF: give a URDF or xacro"),
])  # fmt: skip
def test_other_formats_are_named_with_the_way_out(tmp_path, name, data, words):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(RobotError, match=words):
        load(tmp_path / name)


def test_hostile_files_are_one_line(tmp_path):
    file = workspace(tmp_path, '<xacro:macro name="m" params="n"><a/><xacro:if value="${n}"><xacro:m n="${n-1}"/>'
                               '<xacro:m n="${n-1}"/></xacro:if></xacro:macro><xacro:m n="6"/>')  # fmt: skip
    assert load(file).dimensions.arm == 1
    mesh = tmp_path / "checkout" / "meshes" / "a.stl"
    with mesh.open("r+b") as stream:
        stream.truncate(60_000_001)  # sparse: takes no room
    told = codes(load(file))
    assert "more than 60 MB" in told["mesh-corrupt"]


def test_a_mesh_by_find_is_a_mesh_of_a_package(tmp_path):
    file = workspace(tmp_path).with_name("plain.urdf")
    shape = '<mesh filename="$(find my_parts)/meshes/{}.stl"/>'
    file.write_text(drive_of(shape.format("a"), 0.2, 0.1))
    with pytest.raises(Undecided, match="not round"):  # found, and a cube
        load(file)
    file.write_text(drive_of(shape.format("b"), 0.2, 0.1))
    with pytest.raises(Undecided, match="mesh missing"):
        load(file)


def test_machines_with_vertical_wheels_are_asked_about():
    text = link("base", 20.0, 0.8)
    for i, at in enumerate(((0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.15))):
        text += link(f"l{i}", 1.0, 0.01) + joint(
            f"j{i}", "continuous", "base", f"l{i}", p=(*at, 0.01 * i), axis=(0, 0, 1)
        )
    text = f'<robot name="r">{text}{ARM}</robot>'
    with pytest.raises((Undecided, Unsupported)) as error:
        robot_of(text)
    assert isinstance(error.value, Unsupported) or "y up" in error.value.why
