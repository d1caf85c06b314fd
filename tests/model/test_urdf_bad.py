"""Bad files: one per promise of the audit, each refused with its code, line and reason; awkward but legal ones load."""

from __future__ import annotations

import os
import re
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pinocchio as pin
import pytest

from mmnn_pin.errors import RobotError
from mmnn_pin.model import load
from mmnn_pin.model.loading import build, pinocchio_model
from mmnn_pin.model.urdf.audit import one_edit
from mmnn_pin.model.urdf.document import number_problem
from mmnn_pin.model.urdf.finding import Finding
from mmnn_pin.model.urdf.reading import audit_data, parse, read

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


LIMIT = '<limit lower="-2" upper="2" effort="5" velocity="1"/>'
MASS, AXIS, DYNAMICS = '<mass value="1.5"/>', '<axis xyz="0 1 0"/>', '<dynamics damping="0.1" friction="0"/>'
SHAPE = '<cylinder radius="0.02" length="1"/>'
HINGE = GOOD[GOOD.index("  <joint") : GOOD.index("</robot>")]

# What is replaced by what, then the line, the code and the words of the error.
BAD = {
    # the file
    "truncated": ("</joint>\n</robot>", "", 19, "truncated", "not well-formed XML.*ends before </robot>"),
    "truncated in a tag": (GOOD[GOOD.index("<child") + 9 :], "", 14, "truncated", "cut off"),
    "damaged": ("</inertial>", "</inertia>", 9, "not-xml", "not well-formed XML"),
    "damaged and undeclared": ("</inertial>", "<s:a/></inertia>", 9, "not-xml", "not well-formed XML"),
    "two documents": ("</robot>", "</robot>\n<robot name='b'/>", 20, "not-xml", "Extra content"),
    "bare ampersand": ('"hinge"', '"a&b"', 12, "not-xml", "not well-formed"),
    "undefined entity": ('"1.5"', '"&m;"', 7, "not-xml", "Entity 'm' not defined"),
    "nul byte": ('"hinge"', '"a\0b"', 12, "not-xml", "invalid character|0x0"),
    "doctype": ("<robot", '<!DOCTYPE robot [<!ENTITY m "1">]>\n<robot', 2, "doctype", "has a DOCTYPE.*entities"),
    "doctype and broken": ("<robot", "<!DOCTYPE robot>\n<robot>", 2, "doctype", "delete it"),
    "other root": ("robot", "machine", 2, "not-urdf", "root is <machine>, not a URDF"),
    "xacro element": (*end("<xacro:arm/>"), 19, "xacro", "xacro:arm.*not yet a URDF.*xacro FILE > robot.urdf"),
    "xacro namespace": (*end('<x:arm xmlns:x="http://www.ros.org/wiki/xacro"/>'), 19, "xacro", "<xacro:arm>"),
    "xacro expression": ('"1.5"', '"${m}"', 7, "xacro", r"unexpanded xacro.*xacro FILE > robot.urdf"),
    "xacro substitution": ('name="rod"', 'name="$(arg a)"', 4, "xacro", "unexpanded"),
    "version": ('name="pendulum"', 'name="pendulum" version="7"', 2, "version", "version '7'"),
    # numbers
    "decimal comma": ('"1.5"', '"1,5"', 7, "number", r"link 'rod': value of <mass> is '1,5'.*decimal comma"),
    "unit": ('"1.5"', '"1.5kg"', 7, "number", "'1.5kg' is not a finite number"),
    "nan mass": ('"1.5"', '"nan"', 7, "number", "'nan' is not a finite number"),
    "infinite mass": ('"1.5"', '"inf"', 7, "number", "'inf' is not a finite number"),
    "overflow": ('"1.5"', '"1e400"', 7, "number", "beyond what a double holds"),
    "python number": ('"1.5"', '"1_5"', 7, "number", "'1_5' is not a finite number"),
    "hexadecimal": ('"1.5"', '"0x10"', 7, "number", "not a finite number"),
    "arabic digit": ('"1.5"', '"١"', 7, "number", "not a finite number"),
    "bad inertia": ('ixx="0.1"', 'ixx="a"', 8, "number", "ixx of <inertia>.*whole inertial would be dropped"),
    "bad axis": ('"0 1 0"', '"0 y 0"', 15, "number", "xyz of <axis>"),
    "bad limit": ('upper="2"', 'upper="90deg"', 16, "number", "upper of <limit>"),
    "bad damping": ('damping="0.1"', 'damping="--"', 17, "number", "damping of <dynamics>"),
    "bad radius": ('radius="0.02"', 'radius="thin"', 10, "number", "radius of <cylinder>"),
    "bad scale": (SHAPE, '<mesh filename="a.stl" scale="1 1 x"/>', 10, "number", "scale of <mesh>"),
    "bad multiplier": (DYNAMICS, '<mimic joint="hinge" multiplier="2x"/>', 17, "number", "multiplier of <mimic>"),
    "commas in a vector": ('"0 0 -0.5"', '"0, 0, -0.5"', 6, "number", "commas between numbers"),
    "short origin": ('"0 0 -0.5"', '"0 0"', 6, "vector-length", "xyz of <origin> is '0 0': 2 number"),
    "long origin": ('"0 0 -0.5"', '"0 0 0 0"', 6, "vector-length", "4 number"),
    "empty origin": ('"0 0 -0.5"', '""', 6, "vector-length", "0 number"),
    "empty mass": ('"1.5"', '""', 7, "vector-length", "0 number"),
    "short axis": ('"0 1 0"', '"0 1"', 15, "vector-length", "3 are needed"),
    "scale of one number": (SHAPE, '<mesh filename="a.stl" scale="2"/>', 10, "vector-length", "1 number"),
    "no mass value": (MASS, "<mass/>", 7, "missing-value", "value of <mass> is missing: the whole inertial"),
    "no ixy": ('ixy="0" ', "", 8, "missing-value", "ixy of <inertia> is missing"),
    "no mass": (MASS, "", 5, "missing-value", "<mass> is missing"),
    "no inertia": (GOOD.splitlines()[7], "", 5, "missing-value", "<inertia> is missing"),
    "no effort": ('effort="5" ', "", 16, "missing-value", "effort of <limit> is missing"),
    "no velocity": (' velocity="1"', "", 16, "missing-value", "velocity of <limit> is missing"),
    "axis without numbers": (AXIS, "<axis/>", 15, "missing-value", "xyz of <axis> is missing"),
    "no length": (' length="1"', "", 10, "missing-value", "length of <cylinder> is missing"),
    "mesh without file": (SHAPE, "<mesh/>", 10, "missing-value", "filename of <mesh> is missing"),
    "mimic of nothing": (DYNAMICS, "<mimic/>", 17, "missing-value", "joint of <mimic> is missing"),
    "empty dynamics": (DYNAMICS, "<dynamics/>", 17, "missing-value", "<dynamics> states nothing"),
    "negative radius": ('radius="0.02"', 'radius="-0.02"', 10, "negative-size", "radius of <cylinder>.*negative"),
    "negative box": (SHAPE, '<box size="1 -1 1"/>', 10, "negative-size", "size of <box>"),
    # tags
    "misspelt inertial": ("inertial>", "inertal>", 5, "misspelt-tag", "<inertal>, one edit away from <inertial>"),
    "capital letter": ("<axis", "<Axis", 15, "misspelt-tag", "<Axis>.*<axis>"),
    "plural": ("<limit", "<limits", 16, "misspelt-tag", "write <limit>"),
    "inertia of a link": (*end('<link name="l"><inertia><mass value="1"/></inertia></link>'
                               + joint("j", "rod", "l", "fixed")), 19, "misspelt-tag", "<inertia>.*<inertial>"),
    "misspelt attribute": ('"0 0 -0.5"', '"0 0 -0.5" rpi="0 0 1"', 6, "misspelt-attribute", "'rpi'.*'rpy'"),
    "material twice": (*end('<material name="m"/><material name="m"/>'), 19, "duplicate-material", "defined twice"),
    # names and tree
    "robot without name": (' name="pendulum"', "", 2, "empty-name", "robot: has no name"),
    "no name": ('name="rod"', "", 4, "empty-name", "<link>: has no name"),
    "name of a space": ('name="hinge"', 'name=" "', 12, "empty-name", "<joint>: has no name"),
    "duplicate link": (*end(LINK.replace("tip", "rod")), 19, "duplicate-name",
                       r"'rod' appears twice \(first in line 4"),
    "duplicate joint": (*end(LINK + joint("hinge", "rod", "tip")), 19, "duplicate-name", "joint 'hinge' appears twice"),
    "no links": (GOOD[GOOD.index("  <link") : GOOD.index("</robot>")], "", 2, "no-links", "has no links"),
    "missing parent": ('link="stand"', 'link="wall"', 13, "missing-link", "parent link 'wall' does not exist"),
    "missing child": ('<child link="rod"/>', "", 12, "missing-link", "child link is missing"),
    "two parents": (*end(joint("again", "stand", "rod")), 19, "two-parents", "'rod' already hangs on joint 'hinge'"),
    "two roots": (*end('<link name="island"/>'), 19, "two-roots", "'island' hangs on nothing.*one root"),
    "loop": (*end(LINK + LINK.replace("tip", "a") + joint("j", "tip", "a") + joint("k", "a", "tip")), 19, "loop",
             "in a circle of joints: 'a', 'tip'"),
    "self loop": ('<parent link="stand"/>', '<parent link="rod"/>', 12, "loop", "'rod' hangs on itself"),
    # joints
    "unknown type": ('type="revolute"', 'type="hinge"', 12, "joint-type", "type 'hinge' is unknown.*revolute, conti"),
    "misspelt type": ('type="revolute"', 'type="revolut"', 12, "joint-type", "did you mean 'revolute'"),
    "no type": (' type="revolute"', "", 12, "joint-type", "has no type"),
    "zero axis": ('"0 1 0"', '"0 0 0"', 15, "zero-axis", "joint 'hinge': axis is zero"),
    "reversed limits": ('lower="-2"', 'lower="3"', 16, "limit-order", "lower limit 3 is above the upper one, 2"),
    "no limits": (LIMIT, "", 12, "no-limit", "<limit> is missing.*revolute joint needs it"),
    "no limits of a slide": (HINGE, HINGE.replace("revolute", "prismatic").replace(LIMIT, ""), 12,
                             "no-limit", "prismatic"),
    "negative damping": ('damping="0.1"', 'damping="-0.1"', 17, "negative-friction", "damping is negative"),
    "negative friction": ('friction="0"', 'friction="-1"', 17, "negative-friction", "friction is negative"),
    "mimic of a ghost": (DYNAMICS, '<mimic joint="ghost"/>', 17, "mimic-ghost", "'ghost', which does not exist"),
    "mimic of itself": (DYNAMICS, '<mimic joint="hinge"/>', 17, "mimic-self", "mimics itself"),
    "mimic in a circle": (DYNAMICS + "\n  </joint>\n", '<mimic joint="k"/></joint>' + LINK
                          + joint("k", "rod", "tip").replace("</joint>", '<mimic joint="hinge"/></joint>'),
                          17, "mimic-circle", "circle: 'hinge', 'k'"),
    # bodies
    "zero mass": ('"1.5"', '"0"', 4, "zero-mass", "link 'rod': the body that joint 'hinge' moves has no mass"),
    "dust": ('"1.5"', '"1e-300"', 4, "tiny-mass", "link 'rod': mass 1e-300 kg is less than dust has"),
    "no inertial": (GOOD[GOOD.index("    <inertial>") : GOOD.index("    <visual")], "", 4, "zero-mass", "has no mass"),
    "negative mass": ('"1.5"', '"-1.5"', 4, "negative-mass", "mass -1.5 kg is negative"),
    "negative mass of a weld": (
        *end(LINK.replace('value="1"', 'value="-1"') + joint("w", "rod", "tip", "fixed")),
                                19, "negative-mass", "link 'tip': mass -1 kg"),
    "negative inertia": ('ixx="0.1"', 'ixx="-0.1"', 4, "inertia-not-positive", "not positive definite.*-0.1"),
    "zero inertia": ('ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.01"',
                     'ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"', 4, "zero-inertia", "is zero"),
    "products too large": ('ixy="0"', 'ixy="0.2"', 4, "inertia-not-positive", "not positive definite"),
}  # fmt: skip


def of(text: str | bytes, severity: str = "", **options) -> list[Finding]:
    """Findings about a file, of one severity."""
    data = text.encode() if isinstance(text, str) else text
    return [f for f in audit_data(data, "robot.urdf", **options)[1] if severity in ("", f.severity)]


@pytest.mark.parametrize("name", BAD)
def test_bad_file_is_refused_with_its_line_code_and_reason(name):
    old, new, line, code, reason = BAD[name]
    assert old in GOOD
    errors = of(GOOD.replace(old, new), "error")
    assert (code, line) in [(f.code, f.line) for f in errors]
    told = next(str(f) for f in errors if (f.code, f.line) == (code, line))
    assert re.search(reason, told) and "\n" not in told
    assert told.startswith(f"robot.urdf:{line}: error: ") and told.endswith(f"[{code}]")


def test_load_refuses_with_all_lines(tmp_path):
    file = tmp_path / "bad.urdf"
    file.write_text(GOOD.replace('"1.5"', '"1,5"').replace('"0 1 0"', '"0 0 0"'))
    with pytest.raises(RobotError, match="decimal comma") as error:
        load(file)
    assert (error.value.file, error.value.line) == (file, 7)
    findings = [f for f in error.value.findings if f.severity == "error"]
    assert [(f.code, f.line) for f in findings] == [("number", 7), ("zero-axis", 15)]
    assert str(error.value).splitlines()[:2] == [str(f) for f in findings]
    assert str(error.value).startswith(f"{file}:7: error: link 'rod': value of <mass>")


def test_bodies_are_judged_beside_bad_numbers():
    found = of(GOOD.replace('"1.5"', '"0"').replace('upper="2"', 'upper="2,0"'), "error")
    assert [f.code for f in found] == ["zero-mass", "number"]


def test_the_line_is_where_a_tag_starts():
    text = GOOD.replace('<limit lower="-2" ', '<limit\n  lower="a"\n  ')
    assert [(f.code, f.line) for f in of(text, "error")] == [("number", 16)]


def test_the_good_file_is_good(tmp_path):
    file = tmp_path / "good.urdf"
    file.write_text(GOOD)
    assert load(file).joint_names == ("hinge",)
    assert [f.code for f in of(GOOD)] == ["no-inertial"]


@pytest.mark.parametrize(("data", "reason"), [
    (b"", "file is empty"),
    (b"\n  \n", "file is empty"),
    (b"\x7fELF\x00\x01", "not in the encoding"),
    (b"just words", "not well-formed"),
    (b'<mujoco model="x"/>', r"MJCF \(MuJoCo\), not a URDF"),
    (b'<sdf version="1.7"/>', r"SDF \(Gazebo\)"),
    (b'<robot name="r"/>', "has no links"),
    (b"<a>" * 10_000, "Excessive depth"),
    ('<robot\nname="é"/>'.encode("latin-1"), r":2: error: its bytes are not in the encoding.*\[encoding\]"),
    (b'<?xml version="1.0" encoding="klingon"?><robot name="a"/>', "not in the encoding it declares"),
    ('<robot name="é"/>'.encode("utf-16-le"), "not in the encoding"),
    (b'<mujoco model="x"><worldbody/></mujoco>', r"\[not-urdf\]"),
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
    with pytest.raises(RobotError, match="no such file: name a URDF or xacro file; `mmnn list` has robots"):
        read(tmp_path / "none.urdf")
    (tmp_path / "robot.urdf").write_text("<robot name='a'><link name='b'/></robot>")
    with pytest.raises(RobotError, match=r"no such file: did you mean '.*/robot\.urdf'\?"):
        read(tmp_path / "robto.urdf")
    with pytest.raises(RobotError, match=r"is a folder, not a URDF file: did you mean '.*/robot\.urdf'\?"):
        read(tmp_path)
    below = tmp_path / "stack" / "description" / "urdf"
    below.mkdir(parents=True)
    (tmp_path / "robot.urdf").rename(below / "robot.urdf")
    (below.parent / "arm.xacro").touch()
    with pytest.raises(RobotError, match=r"a folder.*: did you mean '.*/arm\.xacro' or '.*/urdf/robot\.urdf'\?"):
        read(tmp_path)
    with pytest.raises(RobotError, match="no such file: name a URDF"):  # a file is looked for beside it alone
        read(tmp_path / "robot.urdf")
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


@pytest.mark.parametrize(("count", "kind", "what"), [
    (202, "continuous", "201 moving joints: more than 200"),
    (2002, "fixed", "2002 links: more than 2000"),
])  # fmt: skip
def test_too_many_joints_or_links_are_refused_before_pinocchio_sees_them(count, kind, what):
    links = "".join(f'<link name="l{i}"/>' for i in range(count))
    joints = "".join(joint(f"j{i}", f"l{i}", f"l{i + 1}", kind) for i in range(count - 1))
    found = of(f'<robot name="a">{links}{joints}</robot>')
    assert [(f.code, f.line) for f in found if what in str(f)] == [("too-many", 1)]


def test_far_too_large_files_are_refused_without_looking_further():
    links = "".join(f'<link name="l{i}"/>' for i in range(5000)) + "".join(
        joint(f"j{i}", f"l{i}", f"l{i + 1}", "fixed") for i in range(4999)
    )
    started = time.process_time()
    found = audit_data(f'<robot name="r">{links}</robot>'.encode(), "r.urdf")[1]
    assert [f.code for f in found] == ["too-many"] and time.process_time() - started < 2


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "r.urdf")
    with pytest.raises(RobotError, match="no plain file"):
        read(tmp_path / "r.urdf")


BLANKS = (" ", "  ", "&#9;", "&#10;", "&#13;", "&#160;", "&#8195;")


@pytest.mark.parametrize("blank", BLANKS)
@pytest.mark.parametrize("where", ["before", "after", "both"])
def test_blanks_around_numbers_lose_nothing(where, blank):
    """Pinocchio's parser drops a whole <inertial> over a blank after its mass, and refuses limits and multipliers."""

    def spaced(match: re.Match[str]) -> str:
        words = match[2].replace(" ", blank)
        return f'{match[1]}="{blank * (where != "after")}{words}{blank * (where != "before")}"'

    keys = "value|xyz|rpy|i[xyz]{2}|lower|upper|effort|velocity|damping|friction|multiplier|offset"
    slave = joint("slave", "rod", "tip").replace(
        "</joint>", '<mimic joint="hinge" multiplier="2" offset="0.5"/></joint>'
    )
    text = GOOD.replace(*end(LINK + slave))
    blown = re.sub(rf'({keys})="([^"]*)"', spaced, text)
    assert blown != text
    plain, robot = (build(parse(t.encode(), "r.urdf")) for t in (text, blown))
    assert plain.model.nv == robot.model.nv == 2 and robot.arm.slaves == plain.arm.slaves
    for a, b in zip(plain.model.inertias, robot.model.inertias, strict=True):
        assert a.mass == b.mass and (a.lever == b.lever).all() and (a.inertia == b.inertia).all()
    assert sum(body.mass for body in robot.model.inertias) == pytest.approx(2.5)
    assert (robot.effort_limits == plain.effort_limits).all() and (robot.upper == plain.upper).all()


def test_what_pinocchio_prints_is_captured_and_attached_in_every_thread(capfd, monkeypatch):
    """Its file descriptor is redirected under a lock: no thread sees another's text, and nothing reaches the user."""
    names, parser = [f"ghost_{i}" for i in range(16)], pin.buildModelFromXML

    def slow(*arguments):
        time.sleep(1e-3)  # lets the others run
        return parser(*arguments)

    def told(name: str) -> str:
        document = parse(GOOD.encode(), "r.urdf")
        broken = replace(document, text=document.text.replace('child link="rod"', f'child link="{name}"'))
        with pytest.raises(RobotError, match="Pinocchio cannot build the model") as error:
            pinocchio_model(broken, mobile=False)
        return error.value.why

    monkeypatch.setattr(pin, "buildModelFromXML", slow)
    with ThreadPoolExecutor(8) as pool:
        whys = list(pool.map(told, names))
    for name, why in zip(names, whys, strict=True):
        assert f"[{name}]" in why and not [other for other in names if other != name and f"[{other}]" in why]
    print("still here", file=sys.stderr)
    assert capfd.readouterr().err == "still here\n"


def test_a_mass_that_pinocchio_loses_is_told():
    """Should its parser drop an inertial for a reason that the audit does not know."""
    document = parse(GOOD.replace(*end(LINK + joint("t", "rod", "tip", "fixed"))).encode(), "r.urdf")
    lossy = replace(document, text=document.text.replace('value="1.5"', 'value="1.5 "'))
    with pytest.raises(RobotError, match=r"has 1 kg where the file states 2.5 kg.*Could not parse inertial") as error:
        pinocchio_model(lossy, mobile=False)
    assert "\n" not in str(error.value)


def test_a_huge_file_and_an_endless_one_are_refused(tmp_path):
    with (tmp_path / "huge.urdf").open("wb") as file:
        file.truncate(50_000_001)
    with pytest.raises(RobotError, match="more than 50 MB"):
        read(tmp_path / "huge.urdf")
    with pytest.raises(RobotError, match="no plain file"):
        read("/dev/zero")


def test_a_path_that_no_file_can_have():
    with pytest.raises(RobotError, match="cannot be read"):
        read("a\0b")


@pytest.mark.parametrize("text", ["0", "-0.5", "+1", "1.", ".5", "1e-3", "1E+3", " 2 "])
def test_numbers_are_read(text):
    assert number_problem(text, 1) == ""


@pytest.mark.parametrize("text", ["0x10", "1e", ".", "1 2", "1,2", "infinity", "1d0", "-"])
def test_other_writings_are_not(text):
    assert number_problem(text, 1)


@pytest.mark.parametrize(("a", "b", "answer"), [
    ("orgin", "origin", True), ("visaul", "visual", True), ("limits", "limit", True), ("axes", "axis", True),
    ("origin", "origin", False), ("robot", "joint", False), ("gazebo", "joint", False), ("ac", "abc", False),
])  # fmt: skip
def test_one_edit(a, b, answer):
    assert one_edit(a, b) == one_edit(b, a) == answer


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
    "nested extensions": GOOD.replace(*end(
        '<ros2_control name="c" type="system"><joint name="hinge"><param name="p">${x}</param></joint></ros2_control>'
        '<sensor name="s"><parent link="rod"/><ray><mass value="a"/></ray></sensor>')).encode(),
    "extension inside a link": GOOD.replace("<visual", '<self_collision_checking><origin xyz="a"/>'
        "</self_collision_checking><visual", 1).encode(),
    "undeclared prefix": GOOD.replace(*end('<sensor:camera name="c"/>')).encode(),
    "doctype in a comment": GOOD.replace("<axis", "<!-- <!DOCTYPE x> --><axis").encode(),
    "spaces in names": GOOD.replace('"rod"', '"the rod / 1"').encode(),
    "script in a name": GOOD.replace('"rod"', '"&lt;script&gt;alert(1)&lt;/script&gt;"').encode(),
    "name of joint and link": GOOD.replace('"stand"', '"hinge"').encode(),
    "link named universe": GOOD.replace('"stand"', '"universe"').encode(),
    "no declaration": GOOD.partition("\n")[2].encode(),
    "exponents": GOOD.replace('"1.5"', '"+15.e-1"').encode(),
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
    assert robot.dimensions.arm == robot.model.nv == 1
    assert robot.joint_names[0] in ("hinge", "hängel", "<b> 机 &")
    assert robot.damping.tolist() == [0.1] and robot.effort_limits.tolist() == [5.0]
