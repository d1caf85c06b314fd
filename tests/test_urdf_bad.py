"""Bad files are refused with the line and the reason; awkward but legal ones load."""

from __future__ import annotations

import os

import pytest

from mmnn_pin.errors import RobotError
from mmnn_pin.model import load
from mmnn_pin.model.urdf import audit, number_problem, parse, parse_xml, read

GOOD = """\
<?xml version="1.0"?>
<robot name="pendulum">
  <link name="stand"/>
  <link name="rod">
    <inertial>
      <origin xyz="0 0 -0.5"/>
      <mass value="1.5"/>
      <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.01"/>
    </inertial>
    <visual><geometry><cylinder radius="0.02" length="1"/></geometry></visual>
  </link>
  <joint name="hinge" type="revolute">
    <parent link="stand"/>
    <child link="rod"/>
    <axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="5" velocity="1"/>
    <dynamics damping="0.1" friction="0"/>
  </joint>
</robot>
"""
LINK = '<link name="tip"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
LINK += "</inertial></link>"


def joint(name: str, parent: str, child: str, kind: str = "continuous") -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/></joint>'


def end(text: str) -> tuple[str, str]:
    """Put text into the last line."""
    return "</robot>", f"{text}</robot>"


BAD = {
    "decimal comma": ('"1.5"', '"1,5"', 7, r"link 'rod': value of <mass> is '1,5'.*decimal comma"),
    "unit": ('"1.5"', '"1.5kg"', 7, "'1.5kg' is not a finite number"),
    "nan mass": ('"1.5"', '"nan"', 7, "'nan' is not a finite number"),
    "infinite mass": ('"1.5"', '"inf"', 7, "'inf' is not a finite number"),
    "overflow": ('"1.5"', '"1e400"', 7, "beyond what a double holds"),
    "python number": ('"1.5"', '"1_5"', 7, "'1_5' is not a finite number"),
    "arabic digit": ('"1.5"', '"١"', 7, "not a finite number"),
    "empty mass": ('"1.5"', '""', 7, "0 number"),
    "no mass value": ('<mass value="1.5"/>', "<mass/>", 7, "value of <mass> is missing: the whole inertial"),
    "no ixy": ('ixy="0" ', "", 8, "ixy of <inertia> is missing"),
    "no mass": ('<mass value="1.5"/>', "", 5, "<mass> is missing"),
    "bad inertia": ('ixx="0.1"', 'ixx="a"', 8, "ixx of <inertia>"),
    "short origin": ('"0 0 -0.5"', '"0 0"', 6, "xyz of <origin> is '0 0': 2 number"),
    "bad axis": ('"0 1 0"', '"0 y 0"', 15, "xyz of <axis>"),
    "short axis": ('"0 1 0"', '"0 1"', 15, "3 are needed"),
    "bad limit": ('upper="2"', 'upper="90deg"', 16, "upper of <limit>"),
    "bad damping": ('damping="0.1"', 'damping="--"', 17, "damping of <dynamics>"),
    "bad radius": ('radius="0.02"', 'radius="thin"', 10, "radius of <cylinder>"),
    "zero axis": ('"0 1 0"', '"0 0 0"', 15, "joint 'hinge': axis is zero"),
    "zero mass": ('"1.5"', '"0"', 4, "body that joint 'hinge' moves has no mass"),
    "negative mass": ('"1.5"', '"-1.5"', 4, "mass -1.5 kg is negative"),
    "no inertial": ("inertial>", "inertal>", 4, "has no mass"),
    "reversed limits": ('lower="-2"', 'lower="3"', 16, "lower limit is above"),
    "no limits": ('<limit lower="-2" upper="2" effort="5" velocity="1"/>', "", 12, "<limit> is missing"),
    "no effort": ('effort="5" ', "", 16, "effort of <limit> is missing"),
    "negative effort": ('effort="5"', 'effort="-5"', 16, "effort is negative"),
    "negative damping": ('damping="0.1"', 'damping="-0.1"', 17, "damping is negative"),
    "unknown type": ('type="revolute"', 'type="hinge"', 12, "type 'hinge' is unknown.*revolute, continuous"),
    "no type": (' type="revolute"', "", 12, "type 'None' is unknown"),
    "same link": ('name="stand"', 'name="rod"', 4, "link 'rod' appears twice .first in line 3"),
    "same joint": (*end(LINK + joint("hinge", "rod", "tip")), 19, "joint 'hinge' appears twice"),
    "no name": ('<link name="stand"/>', "<link/>", 3, "<link> has no name"),
    "missing parent": ('<parent link="stand"/>', '<parent link="stnd"/>', 13, "parent link 'stnd' does not exist"),
    "missing child": ('<child link="rod"/>', '<child link="rood"/>', 14, "child link 'rood' does not exist"),
    "no parent": ('<parent link="stand"/>', "", 12, "parent link is missing"),
    "two parents": (*end(joint("again", "stand", "rod")), 19, "'rod' already hangs on 'stand'"),
    "two roots": (*end(LINK), 19, "link 'tip' hangs on nothing, and neither does 'stand'"),
    "loop": (*end(joint("back", "rod", "stand")), 4, "link 'rod' hangs on itself"),
    "self loop": ('<parent link="stand"/>', '<parent link="rod"/>', 4, "hangs on nothing|hangs on itself"),
    "xacro expression": ('"1.5"', '"${m}"', 7, r"unexpanded xacro.*xacro FILE > robot.urdf"),
    "xacro element": (*end("<xacro:arm/>"), 19, "this is xacro.*xacro FILE > robot.urdf"),
    "xacro namespace": (*end('<x:arm xmlns:x="http://www.ros.org/wiki/xacro"/>'), 19, "<xacro:arm> is xacro"),
    "doctype": ("<robot", '<!DOCTYPE robot [<!ENTITY m "1">]>\n<robot', 2, "has a DOCTYPE.*entities"),
    "truncated": ("</joint>\n</robot>", "", 19, "not well-formed XML"),
    "other root": ("robot", "machine", 2, "root is <machine>, not a URDF"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_file_is_refused_with_its_line_and_reason(tmp_path, name):
    old, new, line, reason = BAD[name]
    assert old in GOOD
    file = tmp_path / "bad.urdf"
    file.write_text(GOOD.replace(old, new), encoding="utf-8")
    with pytest.raises(RobotError, match=reason) as error:
        load(file)
    assert (error.value.file, error.value.line) == (file, line)
    assert str(error.value).startswith(f"{file}:{line}: error: ") and "\n" not in str(error.value)


def test_the_good_file_is_good(tmp_path):
    file = tmp_path / "good.urdf"
    file.write_text(GOOD)
    assert load(file).joint_names == ("hinge",)


@pytest.mark.parametrize(("data", "reason"), [
    (b"", "not well-formed"),
    (b"\x7fELF\x00\x01", "not well-formed"),
    (b"just words", "not well-formed"),
    (b'<mujoco model="x"/>', r"MJCF \(MuJoCo\), not a URDF"),
    (b'<sdf version="1.7"/>', r"SDF \(Gazebo\)"),
    (b'<robot name="r"/>', "has no links"),
    ('<robot name="é"/>'.encode("latin-1"), "not well-formed"),
])  # fmt: skip
def test_what_is_no_urdf_is_said_to_be_none(data, reason):
    with pytest.raises(RobotError, match=reason):
        parse(data, "x.urdf")


def test_entities_are_never_opened(tmp_path):
    (tmp_path / "secret").write_text("<opened")
    text = f'<!DOCTYPE robot [<!ENTITY s SYSTEM "{tmp_path}/secret">]><robot name="a">&s;</robot>'
    with pytest.raises(RobotError, match="has a DOCTYPE"):  # opening it would fail with another message
        parse(text.encode(), "x.urdf")


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(RobotError, match="no such file"):
        read(tmp_path / "none.urdf")
    with pytest.raises(RobotError, match="is a folder"):
        read(tmp_path)
    with pytest.raises(RobotError, match=r"cannot be read \(Not a directory"):
        (tmp_path / "file").touch()
        read(tmp_path / "file" / "x.urdf")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_file_without_permission(tmp_path):
    file = tmp_path / "closed.urdf"
    file.write_text(GOOD)
    file.chmod(0)
    with pytest.raises(RobotError, match="cannot be read"):
        read(file)


def test_too_many_joints_are_refused_before_pinocchio_sees_them():
    links = "".join(f'<link name="l{i}"/>' for i in range(202))
    joints = "".join(joint(f"j{i}", f"l{i}", f"l{i + 1}") for i in range(201))
    with pytest.raises(RobotError, match="201 moving joints: more than 200"):
        parse(f'<robot name="a">{links}{joints}</robot>'.encode(), "x.urdf")


def test_audit_finds_all_problems_of_a_file_at_once(tmp_path):
    text = GOOD.replace('"1.5"', '"1,5"').replace('"0 1 0"', '"0 0 0"').replace('effort="5"', 'effort="-5"')
    findings = audit(parse_xml(text.encode(), tmp_path))
    assert [(f.code, f.line) for f in findings] == [("number", 7), ("axis", 15), ("limit", 16)]


@pytest.mark.parametrize("text", ["0", "-0.5", "+1", "1.", ".5", "1e-3", "1E+3", " 2 "])
def test_numbers_are_read(text):
    assert number_problem(text, 1) == ""


@pytest.mark.parametrize("text", ["0x10", "1e", ".", "1 2", "1,2", "infinity", "1d0", "-"])
def test_other_writings_are_not(text):
    assert number_problem(text, 1)


AWKWARD = {
    "byte order mark": b"\xef\xbb\xbf" + GOOD.encode(),
    "windows lines": GOOD.replace("\n", "\r\n").encode(),
    "utf-16": GOOD.replace('"1.0"', '"1.0" encoding="utf-16"').encode("utf-16"),
    "latin-1": GOOD.replace('"1.0"', '"1.0" encoding="iso-8859-1"').replace("hinge", "hängel").encode("latin-1"),
    "odd names": GOOD.replace("hinge", "&lt;b&gt; 机 &amp;").encode(),
    "default namespace": GOOD.replace("<robot", '<robot xmlns="http://drake.mit.edu"').encode(),
    "declared xacro": GOOD.replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"').encode(),
    "comments": GOOD.replace("<axis", "<!-- ${comment} --><?odd instruction?><axis").encode(),
    "extensions": GOOD.replace(*end('<gazebo><mass value="any"/></gazebo><transmission name="t"/>')).encode(),
    "tabs in numbers": GOOD.replace('"0 1 0"', '"0\t1\n 0"').encode(),
    "axis of a weld": GOOD.replace(*end(LINK + joint("weld", "rod", "tip", "fixed").replace(
        "</joint>", '<axis xyz="0 0 0"/></joint>'))).encode(),
    "mass on a welded link": GOOD.replace('"1.5"', '"0"').replace(
        *end(LINK + joint("weld", "rod", "tip", "fixed"))).encode(),
}  # fmt: skip


@pytest.mark.parametrize("name", AWKWARD)
def test_awkward_but_legal_files_load(tmp_path, name):
    file = tmp_path / "awkward.urdf"
    file.write_bytes(AWKWARD[name])
    robot = load(file)
    assert robot.layout.arm == robot.model.nv == 1
    assert robot.joint_names[0] in ("hinge", "hängel", "<b> 机 &")
    assert robot.damping.tolist() == [0.1] and robot.effort_limits.tolist() == [5.0]
