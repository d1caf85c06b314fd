"""What the audit warns of and assumes, how strictness changes it, and that its codes are documented."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from drives import robot_of
from places import ROOT
from test_urdf_bad import BAD, DYNAMICS, GOOD, HINGE, LIMIT, LINK, SHAPE, end, joint, of

from mmnn_pin.errors import RobotError
from mmnn_pin.model.base.report import CODES as UNDERSTOOD
from mmnn_pin.model.loading import require_sane
from mmnn_pin.model.urdf.audit import lumped, parts_of
from mmnn_pin.model.urdf.finding import CODES, Finding
from mmnn_pin.model.urdf.meshes import damage_of, vertices_of
from mmnn_pin.model.urdf.packages import locate
from mmnn_pin.model.urdf.reading import audit_file, parse

DOCUMENT = ROOT / "docs" / "reference" / "urdf-audit.md"
TETRAHEDRON = b"solid\nfacet normal 0 0 1\nendfacet\nendsolid\n"

# What is replaced by what, then the severity, the line, the code and the words.
SUSPECT = {
    "colour": (SHAPE + "</geometry>", SHAPE + '</geometry><material name="m"><color rgba="1 1 1"/></material>',
               "warning", 10, "color", "rgba of <color>.*taken as grey"),
    "negative effort": ('effort="5"', 'effort="-1"', "warning", 16, "limit-negative", "is negative: taken as no limit"),
    "negative velocity": ('velocity="1"', 'velocity="-1"', "warning", 16, "limit-negative", "velocity is negative"),
    "huge effort": ('effort="5"', 'effort="1e308"', "warning", 16, "limit-huge", "limit is 1e.308: taken as no limit"),
    "huge speed": ('velocity="1"', 'velocity="2e9"', "warning", 16, "limit-huge", "velocity limit is 2e.09"),
    "zero velocity": ('velocity="1"', 'velocity="0"', "note", 16, "zero-velocity", "assumed: no limit"),
    "zero effort": ('effort="5"', 'effort="0"', "warning", 16, "zero-effort", "assumed: no limit"),
    "transposed": ('ixy="0"', 'iyx="0"', "warning", 8, "transposed-inertia", "'iyx' of <inertia> is taken as 'ixy'"),
    "no effort of a wheel": (HINGE, HINGE.replace("revolute", "continuous").replace('effort="5" ', ""), "warning", 16,
                             "no-effort", "effort of <limit> is missing: assumed: no limit"),
    "empty scale": (SHAPE, '<mesh filename="a.stl" scale=""/>', "warning", 10, "mesh-scale", "taken as 1 1 1"),
    "long axis": ('"0 1 0"', '"0 2 0"', "warning", 15, "axis-not-unit", "length 2: assumed: its direction alone"),
    "no axis": ('<axis xyz="0 1 0"/>', "", "note", 12, "no-axis", "assumed 1 0 0"),
    "no room": ('lower="-2" upper="2" ', "", "warning", 16, "limit-empty", "both 0: taken as it is: the joint cannot"),
    "frame": (*end('<link name="tip"/>' + joint("w", "rod", "tip", "fixed")), "warning", 3, "no-inertial",
              r"2 link\(s\) without <inertial>: 'stand', 'tip': assumed: massless"),
    "second inertial": (*end(LINK.replace("</link>", "<inertial><mass value='9'/><inertia ixx='1' ixy='0'"
                        " ixz='0' iyy='1' iyz='0' izz='1'/></inertial></link>") + joint("w", "rod", "tip", "fixed")),
                        "warning", 19, "repeated-tag", "a second <inertial> in <link>: the first one counts"),
    "misspelt shape": ("visual>", "visaul>", "warning", 10, "misspelt-shape", "<visaul>, one edit away from <visual>"),
    "second shape": (SHAPE, SHAPE + '<sphere radius="9"/>', "warning", 10, "repeated-tag",
                     "a second shape, <sphere>, in <geometry>: the first one counts"),
    "second origin": ('<origin xyz="0 0 -0.5"/>', '<origin xyz="0 0 -0.5"/><origin/>', "warning", 6, "repeated-tag",
                      "a second <origin>"),
    "zero radius": ('radius="0.02"', 'radius="0"', "warning", 10, "zero-size", "radius of <cylinder> is '0': zero"),
    "zero scale": (SHAPE, '<mesh filename="package://p/a.stl" scale="1 0 1"/>', "warning", 10, "zero-size", "scale"),
    "no shape": (SHAPE, "<plane/>", "warning", 10, "no-shape", "it is left out"),
    "mass in a link": ("<inertial>", '<mass value="7"/><inertial>', "warning", 5, "misplaced-tag",
                       "<mass> in <link> is ignored.*move it into an <inertial> with <mass> and <inertia>"),
    "inertia in a frame": (*end('<link name="tip"><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></link>'
                                + joint("w", "rod", "tip", "fixed")), "warning", 19, "misplaced-tag",
                           "<inertia> in <link> is ignored.*delete it"),
    "link in a link": (SHAPE + "</geometry></visual>", SHAPE + "</geometry></visual><link name='l'/>", "warning", 10,
                       "misplaced-tag", "<link> in <link> is ignored.*move it into <robot>"),
    "joint in a joint": ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><joint/>', "warning", 15, "misplaced-tag",
                         "<joint> in <joint>"),
    "undeclared prefix": (*end('<sensor:camera name="c"/>'), "warning", 19, "namespace", "unknown extension"),
    "loop in gazebo": (*end('<gazebo><joint name="c" type="ball"><parent>rod</parent><child>stand</child></joint>'
                            "</gazebo>"), "warning", 19, "gazebo-loop",
                       "joint 'c' closes a loop: it holds 'stand' to 'rod'"),
    "triangle": ('izz="0.01"', 'izz="0.3"', "strict", 4, "inertia-triangle",
                 "joint 'hinge' moves violates.*0.1, 0.1, 0.3"),
    "triangle of a weld": (*end(LINK.replace('izz="1"', 'izz="50"') + joint("w", "rod", "tip", "fixed")),
                           "strict", 19, "inertia-triangle", "link 'tip'"),
    "millimetres": ('"0 0 -0.5"', '"0 0 -500"', "strict", 6, "millimetres", "'0 0 -500' m: is the file in millimetres"),
    "large box": (SHAPE, '<box size="20 400 30"/>', "strict", 10, "millimetres", "size of <box>"),
    "limits in degrees": ('upper="2"', 'upper="180"', "strict", 16, "limit-degrees", "28.6 turns: is it in degrees"),
    "angles in degrees": ('"0 0 -0.5"', '"0 0 -0.5" rpy="0 90 0"', "strict", 6, "rpy-degrees", "'0 90 0' is more than"),
    "grams": ('"1.5"', '"15000"', "strict", 4, "odd-mass", "15[0-9e+]* kg|1.5e.04 kg"),
    "inertia in kg mm^2": ('ixx="0.1" ixy="0" ixz="0" iyy="0.1"', 'ixx="1e5" ixy="0" ixz="0" iyy="1e5"', "strict", 4,
                           "odd-inertia", "kg mm"),
    "missing mesh": (SHAPE, '<mesh filename="a.stl"/>', "warning", 10, "mesh-missing", "'a.stl' does not exist"),
    "mesh without a name": (SHAPE, '<mesh filename=" "/>', "warning", 10, "mesh-missing", "names no file"),
    "missing package": (SHAPE, '<mesh filename="package://nowhere/a.stl"/>', "warning", 10, "mesh-missing",
                        "package 'nowhere' of 1 mesh.*--package-dir"),
    "remote mesh": (SHAPE, '<mesh filename="http://localhost/a.stl"/>', "warning", 10, "mesh-remote", "never fetched"),
    "mesh outside": (SHAPE, '<mesh filename="../../../../etc/passwd"/>', "warning", 10, "mesh-outside", "never opened"),
    "absolute mesh": (SHAPE, '<mesh filename="/etc/passwd"/>', "warning", 10, "mesh-outside", "never opened"),
    "device": (SHAPE, '<mesh filename="file:///dev/zero"/>', "warning", 10, "mesh-outside", "never opened"),
}  # fmt: skip


@pytest.mark.parametrize("name", SUSPECT)
def test_suspect_file_is_accepted_with_a_finding(name):
    old, new, severity, line, code, words = SUSPECT[name]
    assert old in GOOD
    text = GOOD.replace(old, new)
    found = [f for f in of(text) if (f.code, f.line) == (code, line)]
    assert [f.severity for f in found] == ["warning" if severity == "strict" else severity]
    assert re.search(words, str(found[0]))
    assert not of(text, "error")
    strictly = [f.code for f in of(text, "error", strict=True)]
    assert strictly == ([code] if severity == "strict" else [])


def test_every_code_is_documented_with_its_severity():
    rows = re.findall(r"^\| (`[a-z`, -]+`) \| ([a-z]+) *\|", DOCUMENT.read_text(), re.M)
    documented = [(code, severity) for codes, severity in rows for code in re.findall(r"[a-z-]+", codes)]
    assert sorted(documented) == sorted((CODES | UNDERSTOOD).items())


def test_every_code_has_a_file_that_shows_it():
    shown = {row[3] for row in BAD.values()} | {row[4] for row in SUSPECT.values()}
    elsewhere = {
        "file",
        "encoding",
        "too-many",
        "mesh-corrupt",
        "expanded",
        "xacro-package",
        "xacro-prefix",
    }  # tests of their own
    assert set(CODES) - elsewhere == shown - elsewhere
    assert len(BAD) + len(SUSPECT) >= 60


# -- bodies -----------------------------------------------------------------------------------------------------------


def test_fixed_links_are_judged_as_one_body():
    heavy = GOOD.replace('"1.5"', '"0"').replace(
        'ixx="0.1" ixy="0" ixz="0" iyy="0.1"', 'ixx="0" ixy="0" ixz="0" iyy="0"'
    )
    found = of(heavy.replace(*end(LINK + joint("w", "rod", "tip", "fixed"))))
    assert [f.code for f in found] == ["no-inertial"]


def test_lumped_bodies_agree_with_pinocchio():
    tip = LINK.replace("<inertial>", '<inertial><origin xyz="0.3 0.1 -0.2" rpy="0.4 -0.3 1.2"/>').replace(
        'ixx="1"', 'ixx="0.7"'
    )
    weld = joint("w", "rod", "tip", "fixed").replace("<parent", '<origin xyz="0.2 0.5 1" rpy="1 2 3"/><parent')
    document = parse(GOOD.replace(*end(tip + weld)).encode(), "robot.urdf")
    parts = parts_of(document, "rod")
    mass = sum(part.mass for part in parts)
    body = pin.buildModelFromXML(document.text).inertias[1]
    assert mass == pytest.approx(body.mass)
    assert lumped(parts) == pytest.approx(body.inertia)


INERTIA = 'ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.01"'
NEXT_TO_NOTHING = 'ixx="1e-210" ixy="0" ixz="0" iyy="1e-210" iyz="0" izz="1e-210"'


@pytest.mark.parametrize("text", [
    GOOD.replace(INERTIA, NEXT_TO_NOTHING).replace('"1.5"', '"1e-15"').replace(
        *end(LINK + joint("j", "stand", "tip"))),
    GOOD.replace(INERTIA, NEXT_TO_NOTHING).replace("0 0 -0.5", "0 0 0"),  # nothing else moves
    GOOD.replace('"1.5"', '"1e300"').replace("-0.5", "-1e10"),
])  # fmt: skip
def test_models_that_a_double_cannot_hold_are_refused_with_the_body(text):
    document = parse(text.encode(), "robot.urdf")
    with pytest.raises(RobotError, match="link 'rod', moved by joint 'hinge': the mass matrix is") as error:
        require_sane(document, pin.buildModelFromXML(document.text), set())
    assert error.value.line == 4


ROUND = '<inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>'


def virtual(axes: list[tuple[str, str]], mass: float) -> str:
    """A chain of joints of which only the last may carry mass."""
    text = '<robot name="r"><link name="l0"/>'
    for i, (kind, axis) in enumerate(axes):
        heavy = i == len(axes) - 1 and mass > 0
        inertial = f'<inertial><mass value="{mass}"/>{ROUND}</inertial>' if heavy else ""
        text += f'<link name="l{i + 1}">{inertial}</link><joint name="j{i}" type="{kind}"><parent link="l{i}"/>'
        text += (
            f'<child link="l{i + 1}"/><axis xyz="{axis}"/><limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
        )
    return text + "</robot>"


PLANE = [("prismatic", "1 0 0"), ("prismatic", "0 1 0"), ("continuous", "0 0 1")]
GIMBAL = [("revolute", "0 0 1"), ("revolute", "0 1 0"), ("revolute", "1 0 0")]


def test_massless_links_are_legal_where_what_they_carry_gives_them_inertia():
    robot = robot_of(virtual(PLANE, 3.0), free=("all",))
    M = pin.crba(robot.model, robot.model.createData(), np.zeros(robot.model.nq))
    np.testing.assert_allclose(np.diag(M), [3.0, 3.0, 0.02], atol=1e-12)
    assert robot_of(virtual(GIMBAL, 3.0), free=("all",)).dimensions.arm == 3


@pytest.mark.parametrize("axes", [[PLANE[2]] * 2, [PLANE[0]] * 2, [PLANE[1], *PLANE]])
def test_massless_links_that_move_without_what_they_carry_are_named(axes):
    with pytest.raises(RobotError, match=r"link 'l\d', moved by joint 'j\d': the mass matrix is singular"):
        robot_of(virtual(axes, 3.0))


@pytest.mark.parametrize("count", [1, 3])
def test_chains_that_carry_no_mass_at_all_are_told_joint_by_joint(count):
    assert [f.code for f in of(virtual(PLANE[:count], 0.0), "error")] == ["zero-mass"] * count


def test_a_singular_chain_of_sound_bodies_is_refused():
    text = GOOD.replace(*end(LINK + joint("j", "rod", "tip")))
    document = parse(text.encode(), "robot.urdf")
    model = pin.buildModelFromXML(document.text)
    require_sane(document, model, set())
    model.inertias[2] = pin.Inertia(0.0, np.zeros(3), np.zeros((3, 3)))
    with pytest.raises(RobotError, match="link 'tip', moved by joint 'j': the mass matrix is singular"):
        require_sane(document, model, set())


# -- meshes -----------------------------------------------------------------------------------------------------------


def mesh_findings(folder: Path, name: str, **options) -> list[Finding]:
    """Findings about the mesh of a file in a folder."""
    folder.mkdir(exist_ok=True, parents=True)
    file = folder / "robot.urdf"
    file.write_text(GOOD.replace(SHAPE, f'<mesh filename="{name}"/>'))
    return [f for f in audit_file(file, **options)[1] if f.code.startswith("mesh")]


def test_meshes_that_are_whole_and_bad_are_told(tmp_path):
    import trimesh

    data = bytearray(trimesh.creation.box((1, 1, 1)).export(file_type="stl"))
    assert mesh_findings(tmp_path, put(tmp_path / "box.stl", bytes(data)).name) == []
    data[84:96] = np.full(3, np.nan, "<f4").tobytes()  # a normal, which nothing reads
    assert mesh_findings(tmp_path, put(tmp_path / "normal.stl", bytes(data)).name) == []
    data[96:100] = np.float32("nan").tobytes()
    [told] = mesh_findings(tmp_path, put(tmp_path / "corner.stl", bytes(data)).name)
    assert told.code == "mesh-corrupt" and "not finite" in told.message
    bomb = b'<!DOCTYPE r [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><COLLADA>&b;</COLLADA>'
    [told] = mesh_findings(tmp_path, put(tmp_path / "bomb.dae", bomb).name)
    assert told.code == "mesh-corrupt" and "DOCTYPE" in told.message


def put(file: Path, data: bytes = TETRAHEDRON) -> Path:
    """Write a file."""
    file.parent.mkdir(exist_ok=True, parents=True)
    file.write_bytes(data)
    return file


@pytest.mark.parametrize("name", ["package://arm/meshes/a.stl", "../meshes/a.stl", "package:///arm/meshes/a.stl"])
def test_meshes_are_found_in_the_package_of_the_urdf(tmp_path, name):
    file = put(tmp_path / "arm" / "meshes" / "a.stl")
    assert mesh_findings(tmp_path / "arm" / "urdf", name) == []
    assert locate(name, tmp_path / "arm" / "urdf" / "robot.urdf").file == file.resolve()


def test_models_of_gazebo_are_found_in_the_package_of_the_urdf(tmp_path):
    file, urdf = put(tmp_path / "arm" / "models" / "jaw" / "meshes" / "a.stl"), tmp_path / "arm" / "urdf" / "robot.urdf"
    assert locate("model://jaw/meshes/a.stl", urdf).file == file.resolve()
    assert locate("model://jaw/../../secret.stl", urdf).file is None


@pytest.mark.parametrize("given", ["packages", "packages/arm"])
def test_meshes_are_found_in_package_folders(tmp_path, given):
    put(tmp_path / "packages" / "arm" / "meshes" / "a.stl")
    folder = tmp_path / "downloads"
    assert [f.code for f in mesh_findings(folder, "package://arm/meshes/a.stl")] == ["mesh-missing"]
    assert mesh_findings(folder, "package://arm/meshes/a.stl", package_dirs=[tmp_path / given]) == []


def test_meshes_named_by_their_place_on_another_machine_are_found_in_the_package_that_is_here(tmp_path):
    own = tmp_path / "far" / "from" / "here" / "all" / "arm"
    file = put(own / "meshes" / "a.stl")
    put(own / "package.xml", b"<package><name>arm</name></package>")
    name, urdf = "file:///home/them/ws/src/arm/meshes/a.stl", own / "urdf" / "robot.urdf"
    assert mesh_findings(urdf.parent, name) == [] and locate(name, urdf).file == file.resolve()
    assert locate(name.replace("a.stl", "../../secret.stl"), urdf).file is None
    far = tmp_path / "downloads"
    far.mkdir()
    (far / "robot.urdf").write_text(GOOD.replace(SHAPE, f'<mesh filename="{name}"/>').replace(
        "</link>", f'<visual><geometry><mesh filename="{name[:-5]}b.stl"/></geometry></visual></link>', 1))  # fmt: skip
    [told] = [f for f in audit_file(far / "robot.urdf")[1] if f.code.startswith("mesh")]
    assert "and 1 more lie outside" in told.message and "folder of package 'arm' with --package-dir" in told.fix
    assert mesh_findings(far, name, package_dirs=[own]) == []  # as it says


def test_a_mesh_of_another_machine_is_found_by_its_end_in_a_package_of_another_name(tmp_path):
    own = tmp_path / "far" / "from" / "here" / "all" / "copied"
    file = put(own / "meshes" / "a.stl")
    put(own / "package.xml", b"<package><name>renamed</name></package>")
    put(own / "a.stl")
    urdf = own / "urdf" / "robot.urdf"
    assert locate("file:///home/them/ws/src/arm/meshes/a.stl", urdf).file == file.resolve()
    for name in ("/home/them/a.stl", "/home/them/meshes/../../a.stl", "/home/them/meshes/b.stl"):
        assert locate(name, urdf).file is None  # a name without its folder may be any other file


def test_a_way_out_of_the_package_is_not_taken(tmp_path):
    secret = put(tmp_path / "secret.stl")
    (tmp_path / "arm").mkdir()
    os.symlink(secret, tmp_path / "arm" / "link.stl")
    for name in (
        "package://arm/../secret.stl",
        "package://../secret.stl",
        "../secret.stl",
        f"file://{secret}",
        "link.stl",
    ):
        assert [f.code for f in mesh_findings(tmp_path / "arm", name)] == ["mesh-outside"], name
        assert locate(name, tmp_path / "arm" / "robot.urdf").file is None
    assert mesh_findings(tmp_path / "arm", "../secret.stl", package_dirs=[tmp_path]) == []


@pytest.mark.parametrize(("name", "data", "words"), [
    ("a.stl", b"", "it is empty"),
    ("a.stl", b"\0" * 50, "at least 84 bytes"),
    ("a.stl", b"\0" * 80 + (12).to_bytes(4, "little") + b"\0" * 100, "12 triangles take 684 bytes, it has 184"),
    ("a.stl", TETRAHEDRON[:-12], "ends before endsolid"),
    ("a.DAE", b"<COLLADA><asset>", "not a whole Collada file"),
    ("a.obj", b"# nothing\n", "no vertices"),
])  # fmt: skip
def test_corrupt_meshes_are_told(tmp_path, name, data, words):
    put(tmp_path / name, data)
    found = mesh_findings(tmp_path, name)
    assert [(f.code, f.line, f.severity) for f in found] == [("mesh-corrupt", 10, "warning")]
    assert words in found[0].message


@pytest.mark.parametrize("name", ["a.stl", "a.dae", "a.obj", "a.fbx"])
def test_a_pointer_of_git_lfs_is_told_as_such(tmp_path, name):
    put(tmp_path / name, b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
    (found,) = mesh_findings(tmp_path, name)
    assert (found.code, found.fix) == ("mesh-missing", "git lfs pull")
    assert found.message == f"mesh '{name}' is a git-LFS pointer, its content was not downloaded"
    assert not len(vertices_of(tmp_path / name, 0))


@pytest.mark.parametrize(("name", "data"), [
    ("a.stl", TETRAHEDRON),
    ("a.stl", b"solid by an exporter".ljust(80) + (1).to_bytes(4, "little") + b"\0" * 50),
    ("a.dae", b"<?xml?><COLLADA></COLLADA>"),
    ("a.obj", b"v 0 0 0\n"),
    ("a.ply", b"anything"),
])  # fmt: skip
def test_whole_meshes_are_not(tmp_path, name, data):
    put(tmp_path / name, data)
    assert mesh_findings(tmp_path, name) == []


def test_a_mesh_that_cannot_be_read(tmp_path):
    assert damage_of(tmp_path / "gone.stl") == "cannot be read (No such file or directory)"


def test_meshes_of_one_missing_package_are_one_finding():
    shapes = "".join(
        f'<visual><geometry><mesh filename="package://nowhere/{i}.stl"/></geometry></visual>' for i in range(9)
    )
    found = of(GOOD.replace(*end(f'<link name="l">{shapes}</link>' + joint("w", "rod", "l", "fixed"))))
    assert [f.message for f in found if f.code == "mesh-missing"] == [
        "package 'nowhere' of 9 mesh file(s) is not found ('package://nowhere/0.stl')"
    ]


# -- robots of others -------------------------------------------------------------------------------------------------

# Real defects: massless bodies that move, impossible inertias, mimics of joints that do not exist, nothing at all.
DEFECTIVE = {
    "alex_psyonic_hands.urdf": {"mimic-ghost"},
    "icub.urdf": {"inertia-not-positive"},
    "icub_reduced.urdf": {"inertia-not-positive"},
    "romeo.urdf": {"zero-mass"},
    "romeo_laas_small.urdf": {"zero-mass", "inertia-not-positive"},
    "ur3.urdf": {"empty-name", "no-links"},
}
ROBOTS = Path(os.environ.get("EXAMPLE_ROBOT_DATA", "/nowhere"))


@pytest.mark.skipif(not ROBOTS.is_dir(), reason="EXAMPLE_ROBOT_DATA is not set")
def test_robots_of_example_robot_data_pass_but_for_real_defects():
    files = sorted(ROBOTS.rglob("*.urdf"))
    assert len(files) > 50
    refused = {}
    for file in files:
        document, findings = audit_file(file)
        assert not [f for f in findings if f.code in ("mesh-missing", "mesh-corrupt")]
        if document is None:
            refused[file.name] = {f.code for f in findings if f.severity == "error"}
    assert refused == DEFECTIVE


@pytest.mark.parametrize("text", [
    GOOD.replace(HINGE, joint("float", "stand", "rod", "floating")),
    GOOD.replace(HINGE, joint("plane", "stand", "rod", "planar")),
    GOOD.replace(HINGE, joint("turn", "stand", "rod")),
    GOOD.replace(LIMIT, LIMIT.replace('"-2"', '"-1e16"').replace('"2"', '"1e16"')),
    GOOD.replace(DYNAMICS, "").replace(*end(LINK + joint("k", "rod", "tip").replace(
        "</joint>", '<mimic joint="hinge" multiplier="-1"/></joint>'))),
])  # fmt: skip
def test_kinds_of_joints_that_are_legal(text):
    assert {f.severity for f in of(text)} <= {"warning", "note"}
    assert not {f.code for f in of(text)} & {"limit-degrees", "no-limit"}
