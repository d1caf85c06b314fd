"""More twins of robots of the wild, each with one thing that could make a loader silently wrong."""

from __future__ import annotations

import math
import re
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from drives import ARM, CYLINDER, LIMIT, LYING_CYLINDER, SPHERE, joint, link, origin, robot_of
from hypothesis import given, settings
from hypothesis import strategies as st
from test_base import MOVE, four, wheel
from test_wild import codes, drive_of, star, tyre

from mmnn_pin.errors import ConfigError, InputError, RobotError, UnknownName
from mmnn_pin.model.base.report import Undecided, Unsupported
from mmnn_pin.model.loading import load
from mmnn_pin.model.urdf.meshes import BrokenMesh, meshes_of, vertices_of

READ = {"wheels": lambda text: tuple(text.split(",")), "radius": float, "track": float, "mu": float}
REPEATED = ("without", "lock", "free")
OPTION = r"--(base|wheels|radius|track|lock|free) ([\w.,-]*\w)"


def ways_of(fix: str) -> list[dict[str, str]]:
    """The options of every command in a fix."""
    ways = re.split("; |, or |, | or | if ", fix)
    return [options for way in ways if (options := dict(re.findall(OPTION, way)))]


def followed(text: str, options: dict[str, str], **said):
    """The robot that a command leads to."""
    read = {k: (v,) if k in REPEATED else READ.get(k, str)(v) for k, v in options.items()}
    return robot_of(text, **{**said, **read})


# --- Units and sizes --------------------------------------------------------------------------------------------------


PLACES = st.sampled_from([
    "<translate>1 2 {v}</translate>", "<scale>1 {v} 2</scale>", "<rotate>0 0 1 {v}</rotate>",
    "<matrix>0 -1 0 {v} 1 0 0 0 0 0 1 -1 0 0 0 1</matrix>",
])  # fmt: skip
FACES = st.sampled_from([
    '<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>{0} {1} {2}</p></triangles>',
    '<polylist count="1"><input semantic="VERTEX" source="#v" offset="0"/><vcount>4</vcount>'
    "<p>{0} {1} {2} {3}</p></polylist>",
    '<lines count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>{0} {3}</p></lines>',
])  # fmt: skip


@given(
    st.lists(st.tuples(FACES, st.permutations(range(6))), min_size=1, max_size=3),
    st.lists(st.tuples(PLACES, st.integers(1, 90), st.booleans()), min_size=1, max_size=4),
)
@settings(max_examples=30, deadline=None)
def test_corners_of_a_collada_file_are_those_that_trimesh_has(tmp_path_factory, faces, places):
    numbers = " ".join(str((7 * k % 11) / 3) for k in range(18))
    source = f'<source id="p"><float_array id="a" count="18">{numbers}</float_array><technique_common>'
    source += '<accessor source="#a" count="6" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>'
    source += '<param name="Z" type="float"/></accessor></technique_common></source>'
    body = source + '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
    body += "".join(face.format(*order) for face, order in faces)
    nodes, own = "", '<instance_geometry url="#g"/>'
    for k, (place, value, shown) in enumerate(places):
        nodes = f'<node id="n{k}">{place.format(v=value)}{own if shown or not nodes else ""}{nodes}</node>'
    file = tmp_path_factory.mktemp("dae") / "m.dae"
    file.write_text(
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        '<asset><unit meter="0.5"/></asset>'
        f'<library_geometries><geometry id="g"><mesh>{body}</mesh></geometry></library_geometries>'
        f'<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/>'
        "</scene></COLLADA>"
    )
    found = vertices_of(file, 0)
    try:
        theirs = np.concatenate([np.array(mesh.vertices) for mesh in meshes_of(file)]) * 0.5
    except BrokenMesh:
        assert all("<lines" in face for face, _ in faces) and not len(found)
        return
    as_set = [{tuple(row) for row in np.round(corners, 4).tolist()} for corners in (found, theirs)]
    assert as_set[0] == as_set[1]


@pytest.mark.parametrize(("unit", "metres"), [("millimeter", 0.001), ("inch", 0.0254), ("meter", 1.0)])
def test_a_collada_file_is_in_the_unit_that_it_states(tmp_path, unit, metres):
    file, radius = tmp_path / "wheel.dae", 0.08
    shape = tyre(tmp_path / "wheel.stl", radius / metres, 0.03 / metres, 0.05 / metres)
    trimesh.load_mesh(tmp_path / "wheel.stl").export(file)
    text = file.read_text()
    stated = f'<unit name="{unit}" meter="{metres:g}"/>'
    text = re.sub(r"<unit[^>]*/>", stated, text) if "<unit" in text else text.replace("</asset>", stated + "</asset>")
    assert stated in text
    file.write_text(text)
    robot = robot_of(drive_of(shape.replace("stl", "dae"), 0.2, radius), tmp_path / "robot.urdf")
    assert [w.radius for w in robot.base.wheels] == pytest.approx([radius] * 2, rel=1e-4)
    assert robot.base.track == pytest.approx(0.4, rel=1e-4)


@given(st.sampled_from([0.0254, 0.01, 0.001]))
@settings(max_examples=3, deadline=None)
def test_a_wheel_far_too_large_for_its_track_is_no_wheel(metres):
    text = drive_of(CYLINDER.format(r=0.05 / metres), 0.2, 0.05 / metres)
    with pytest.raises(RobotError, match=r"on a track of 0.4 m.*--radius"):
        robot_of(text)
    assert robot_of(text, radius=0.05).base.wheels[0].radius == 0.05


def test_mirrored_wheels_of_one_mesh_roll_the_same_way(tmp_path):
    shape = tyre(tmp_path / "wheel.stl", 0.1, 0.04, 0.09)
    text = link("base", 20.0, 0.8, '<box size="0.3 0.2 0.1"/>', origin(p=(0, 0, 0.5)))
    for name, side in (("left", 1), ("right", -1)):
        lying = origin(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))
        mirrored = shape.replace("/>", f' scale="1 1 {side}"/>')  # a negative scale turns the mesh inside out
        text += link(f"{name}_link", 1.0, 0.01, mirrored, lying)
        text += joint(name, "continuous", "base", f"{name}_link", p=(0, side * 0.25, 0.1))
    robot = robot_of(f'<robot name="r">{text}{ARM}</robot>', tmp_path / "r.urdf")
    assert robot.base.track == pytest.approx(0.5, rel=1e-4) and [w.sign for w in robot.base.wheels] == [1, 1]
    assert [w.radius for w in robot.base.wheels] == pytest.approx([0.1, 0.1], rel=1e-4)


def test_collision_and_visual_shapes_that_disagree_are_told():
    text = drive_of(CYLINDER.format(r=0.09), 0.2, 0.09)
    seen = f"<visual>{LYING_CYLINDER}<geometry>{CYLINDER.format(r='{r}')}</geometry></visual>"
    for radius, told in ((0.0905, False), (0.0975, True)):
        robot = robot_of(
            text.replace("</collision></link>", f"</collision>{seen.replace(repr('{r}'), str(radius))}</link>")
        )
        assert robot.base.wheels[0].radius == 0.09
        assert ("0.0975 m by sight" in codes(robot).get("base-shapes", "")) == told


@pytest.mark.parametrize(("inset", "told"), [(0.0, False), (0.04, True)])
def test_a_track_that_is_another_by_sight_is_told(inset, told):
    text = drive_of(CYLINDER.format(r=0.09), 0.2, 0.09)
    for name, side in (("left", 1), ("right", -1)):
        seen = f'<visual><origin xyz="0 {-side * inset} 0" rpy="1.5707963 0 0"/><geometry>{CYLINDER.format(r=0.09)}'
        head, tail = text.split(f'<link name="{name}_link">')
        text = f'{head}<link name="{name}_link">{seen}</geometry></visual>{tail}'
    robot = robot_of(text)
    assert robot.base.track == pytest.approx(0.4)
    assert ("0.4 m apart by their collision shapes, 0.32 m by sight" in codes(robot).get("base-shapes", "")) == told


def test_the_track_of_wheels_that_cannot_be_seen_is_said_to_be_that_of_the_joints():
    text = drive_of('<mesh filename="package://gone/tyre.stl"/>', 0.2, 0.05)
    robot = robot_of(text, radius=0.05)
    assert "track of 0.4 m is that of the joints" in codes(robot)["base-joints"]
    assert "base-joints" not in codes(robot_of(text, radius=0.05, track=0.42))


# --- What is no wheel, and what is ------------------------------------------------------------------------------------


def on_swivel(name: str, p, trail: float = 0.0, radius: float = 0.1) -> str:
    """A wheel on an endless upright joint, so far behind it."""
    text = link(f"{name}_fork", 0.3, 0.002) + joint(
        f"{name}_swivel", "continuous", "base", f"{name}_fork", p=p, axis=(0, 0, 1)
    )
    return text + wheel(name, (-trail, 0, 0), radius=radius, parent=f"{name}_fork")


def pair(radius: float = 0.1) -> str:
    return "".join(wheel(n, (0, y, radius), radius=radius) for n, y in (("left", 0.25), ("right", -0.25)))


def chassis(more: str, name: str = "r") -> str:
    body = link("base", 20.0, 0.8, '<box size="0.3 0.2 0.1"/>', origin(p=(0, 0, 0.3)))
    return f'<robot name="{name}">{body}{more}{ARM}</robot>'


def test_a_front_axle_of_wheels_without_trail_is_a_cars():
    front = "".join(on_swivel(n, (0.5, y, 0.1)) for n, y in (("fl", 0.25), ("fr", -0.25)))
    assert robot_of(chassis(pair() + front)).base.kind == "car_like"
    robot = robot_of(chassis(pair() + front), wheels=("left", "right"))
    assert robot.base.kind == "differential_drive" and [w.joint for w in robot.base.wheels] == ["left", "right"]
    trailing = "".join(on_swivel(n, (0.5, y, 0.1), trail=0.05) for n, y in (("fl", 0.25), ("fr", -0.25)))
    assert robot_of(chassis(pair() + trailing)).base.kind == "differential_drive"  # casters


def test_four_casters_at_the_corners_are_no_front_axle():
    corners = "".join(on_swivel(f"c{x}{y}", (x, y, 0.1)) for x in (0.4, -0.4) for y in (0.2, -0.2))
    with pytest.raises(Undecided, match="no trail"):
        robot_of(chassis(pair() + corners))


def test_a_lidar_that_spins_and_fingers_without_end_are_no_wheels():
    lidar = link("lidar", 0.2, 1e-4, CYLINDER.format(r=0.05)) + joint(
        "spin", "continuous", "base", "lidar", p=(0, 0, 0.5), axis=(0, 0, 1)
    )
    fingers = "".join(
        link(n, 0.05, 1e-5, SPHERE.format(r=0.01)) + joint(f"{n}_j", "continuous", "fore", n, p=(0.2, y, 0))
        for n, y in (("f1", 0.03), ("f2", -0.03))
    )
    robot = robot_of(chassis(pair() + lidar + fingers))
    assert robot.base.kind == "differential_drive" and {w.joint for w in robot.base.wheels} == {"left", "right"}


def test_bumpers_are_no_arm():
    bumpers = "".join(
        link(f"b{i}", 0.05, 1e-5)
        + joint(f"bump{i}", "prismatic", "base", f"b{i}", p=(0.3, 0.1 * i, 0.1), more=LIMIT.format(0, 0.005))
        for i in range(3)
    )
    robot = robot_of(chassis(pair() + bumpers))
    assert robot.joint_names == ("shoulder", "elbow") and "bump0" in codes(robot)["arm-locked"]
    assert "bump1" in robot_of(chassis(pair() + bumpers), free=("bump1",)).joint_names
    lift = bumpers.replace('upper="0.005"', 'upper="0.3"')
    assert "button" not in " ".join(robot_of(chassis(pair() + lift)).arm.reasons.values())


def test_nothing_that_moves_is_no_robot():
    hand = link("base", 2.0) + link("cam", 0.1) + joint("pan", "revolute", "base", "cam", more=LIMIT.format(-1, 1))
    text = f'<robot name="r">{hand}</robot>'
    with pytest.raises(Unsupported, match="no joint of it moves"):
        robot_of(text, lock=("pan",))
    assert robot_of(text).joint_names == ("pan",)


@pytest.mark.parametrize("rows", [(0.3, 0.1, -0.1, -0.3), (0.4, 0.2, 0.0, -0.2, -0.4)])
def test_many_wheels_on_rockers_run_in_tracks(rows):
    text = ""
    for i, x in enumerate(rows):
        text += link(f"rocker{i}", 1.0) + joint(
            f"rock{i}", "revolute", "base", f"rocker{i}", p=(x, 0, 0.1), more=LIMIT.format(-0.2, 0.2)
        )
        text += "".join(wheel(f"{s}{i}", (0, y, 0), parent=f"rocker{i}") for s, y in (("l", 0.3), ("r", -0.3)))
    plugin = '<gazebo><plugin name="p" filename="libgazebo_ros_skid_steer_drive.so"/></gazebo>'
    robot = robot_of(chassis(text + plugin))
    assert robot.base.kind == "tracked" and len(robot.base.wheels) == 2 * len(rows)
    assert "base-evidence" in codes(robot) and robot.joint_names == ("shoulder", "elbow")


def test_a_name_of_tracks_can_be_overruled():
    text = four().replace('name="base"', 'name="base"', 1).replace("fl_link", "flipper_fl")
    with pytest.raises(Undecided, match="'flipper_fl' among its names") as error:
        robot_of(text)
    kinds = [followed(text, way).base.kind for way in ways_of(error.value.fix)]
    assert kinds == ["tracked", "skid_steer", "fixed"]  # holonomic would be mecanum wheels, not forces


# --- Bases without wheels ---------------------------------------------------------------------------------------------


def test_an_arm_on_a_stand_is_said_to_be_one():
    text = chassis("")
    robot = robot_of(text)
    told = next(f for f in robot.findings if f.code == "base-none")
    assert robot.base.kind == "fixed" and told.severity == "note"
    assert followed(text, ways_of(told.fix)[0]).base.pushes
    assert "base-none" not in codes(robot_of(text, base="fixed"))


@pytest.mark.parametrize("plugin", ["libgazebo_ros_planar_move.so", "libgazebo_ros_diff_drive.so"])
def test_a_base_that_a_plugin_drives_is_no_stand(plugin):
    text = chassis(f'<gazebo><plugin name="p" filename="{plugin}"/></gazebo>')
    with pytest.raises(Undecided, match="a plugin drives a base") as error:
        robot_of(text)
    kinds = [followed(text, way).base.kind for way in ways_of(error.value.fix)]
    assert kinds == ["holonomic", "fixed"]


def test_a_single_body_may_be_a_base():
    text = f'<robot name="r">{link("base", 20.0, 0.8)}</robot>'
    with pytest.raises(Unsupported, match="single rigid body") as error:
        robot_of(text)
    assert followed(text, ways_of(error.value.fix)[0]).velocity_names == ("vx", "vy", "w")
    with pytest.raises(Unsupported, match="drone"):
        robot_of(text.replace('name="base"', 'name="prop0_link"'))


# --- Every refusal's command ------------------------------------------------------------------------------------------


def steered(i: int, x: float, y: float, limit: float) -> str:
    """A wheel on an upright joint with limits."""
    fork = link(f"fork{i}", 0.5) + wheel(f"w{i}", (0, 0, 0), parent=f"fork{i}")
    more = LIMIT.format(-limit, limit)
    return fork + joint(f"steer{i}", "revolute", "base", f"fork{i}", p=(x, y, 0.1), axis=(0, 0, 1), more=more)


WELDED = chassis("".join(
    link(f"wheel{i}_link", 0.5, 0.001, CYLINDER.format(r=0.05), LYING_CYLINDER)
    + joint(f"w{i}", "fixed", "base", f"wheel{i}_link", p=(0, y, 0.05)) for i, y in enumerate((0.2, -0.2))
))  # fmt: skip
THREE = chassis(pair() + wheel("third", (0.4, 0, 0.05), radius=0.05))
LIMITED = chassis(
    pair().replace('type="continuous"', 'type="revolute"').replace("</joint>", LIMIT.format(-1, 1) + "</joint>")
)


@pytest.mark.parametrize(("text", "machine", "kind"), [
    (WELDED, "", "fixed"),
    (THREE, "", "differential_drive"),
    (four(), "", "skid_steer"),
    (star(3, ""), "", "holonomic"),
    (LIMITED, "", "fixed"),
])  # fmt: skip
def test_the_command_of_every_refusal_leads_to_a_right_answer(text, machine, kind):
    with pytest.raises((Undecided, Unsupported)) as error:
        robot_of(text)
    assert getattr(error.value, "machine", "") == machine
    ways = ways_of(error.value.fix.replace("METRES", "0.05"))
    kinds = [followed(text, way).base.kind for way in ways if "LEFT,RIGHT" not in way.values()]  # all are accepted
    assert kind in kinds, error.value.fix


# --- Planar, floating, lifted, prefixed -------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_a_robot_that_stands_in_a_world(kind):
    world = '<link name="world"/>' + joint("stand", kind, "world", "base", axis=(0, 0, 1))
    robot = robot_of(chassis(pair() + world))
    assert (
        robot.base.kind == "differential_drive" and robot.base.track == pytest.approx(0.5) and "welded" in codes(robot)
    )


@pytest.mark.parametrize(("up", "told"), [(0.0, False), (0.1, True), (-0.05, True)])
def test_a_footprint_above_or_below_the_floor_is_told(up, told):
    foot = '<link name="base_footprint"/>' + joint("foot", "fixed", "base_footprint", "base", p=(0, 0, up))
    robot = robot_of(chassis(pair() + foot))
    assert robot.base.floor == pytest.approx(up) and ("base-floor" in codes(robot)) == told
    assert [w.radius for w in robot.base.wheels] == [0.1, 0.1]


def test_an_arm_on_a_lift_and_prefixed_names():
    lift = link("mast", 3.0) + joint(
        "lift", "prismatic", "base", "mast", p=(0, 0, 0.3), axis=(0, 0, 1), more=LIMIT.format(0.1, 0.6)
    )
    text = chassis(pair() + lift).replace(
        'parent link="base"/><child link="upper"', 'parent link="mast"/><child link="upper"'
    )
    text = re.sub(r'(name|link|child link|parent link)="(?!r")', r'\1="robot_1/', text)
    robot = robot_of(text)
    assert robot.joint_names == ("robot_1/lift", "robot_1/shoulder", "robot_1/elbow")
    assert robot.base.track == pytest.approx(0.5)


@pytest.mark.parametrize("above", ["prismatic", "revolute"])
def test_wheels_under_a_suspension(above):
    text = ""
    for name, y in (("left", 0.25), ("right", -0.25)):
        text += link(f"{name}_arm", 0.5) + joint(
            f"{name}_s",
            above,
            "base",
            f"{name}_arm",
            p=(0, y, 0.1),
            axis=(0, 0, 1) if above == "prismatic" else (0, 1, 0),
            more=LIMIT.format(-0.01, 0.01),
        )
        text += wheel(name, (0, 0, 0), parent=f"{name}_arm")
    robot = robot_of(chassis(text))
    assert robot.base.suspensions == ("left_s", "right_s") and robot.base.track == pytest.approx(0.5)


def test_two_pairs_of_which_one_is_driven():
    rear = "".join(wheel(n, (-0.4, y, 0.06), radius=0.06) for n, y in (("rl", 0.25), ("rr", -0.25)))
    motors = "".join(f'<transmission name="t{n}"><joint name="{n}"/></transmission>' for n in ("left", "right"))
    robot = robot_of(chassis(pair() + rear + motors))
    assert [w.joint for w in robot.base.wheels] == ["left", "right"] and robot.base.casters == ("rl", "rr")
    assert "alone with motors, by <transmission>" in codes(robot)["base-doubt"]


@given(st.lists(st.floats(0.4, 2.4), min_size=3, max_size=3), st.floats(0, 6))
@settings(max_examples=10, deadline=None)
def test_omni_wheels_at_unequal_angles(gaps, start):
    angles = start + np.cumsum(np.array(gaps) / sum(gaps) * 2 * math.pi)
    text = ""
    for i, a in enumerate(angles):
        z = np.array([math.cos(a), math.sin(a), 0.0])
        text += link(
            f"w{i}_link",
            0.5,
            0.001,
            CYLINDER.format(r=0.05),
            origin(np.column_stack((np.cross([0, 0, 1.0], z), [0, 0, 1.0], z))),
        )
        text += joint(f"w{i}", "continuous", "base", f"w{i}_link", p=(0.2 * z[0], 0.2 * z[1], 0.05), axis=z)
    robot = robot_of(chassis(text))
    x, y, psi = robot.base.frame
    twist = np.array([0.3, -0.2, 0.7])  # of the control frame; each hub's speed along its wheel by rigid motion
    rates = dict(zip(robot.full_velocity_names, robot.T[:, :3] @ twist, strict=True))
    c, s = math.cos(psi), math.sin(psi)
    for i, a in enumerate(angles):
        arm = np.array([0.2 * math.cos(a) - x, 0.2 * math.sin(a) - y])
        hub = np.array([c * 0.3 + s * 0.2, s * 0.3 - c * 0.2]) + 0.7 * np.array([-arm[1], arm[0]])
        assert abs(rates[f"w{i}"]) * 0.05 == pytest.approx(abs(-math.sin(a) * hub[0] + math.cos(a) * hub[1]), abs=1e-9)


# --- Files beside it --------------------------------------------------------------------------------------------------


def test_controllers_beside_the_file_are_told_where_none_agrees(tmp_path):
    for name in ("bot_description", "bot_control", "other_control"):
        (tmp_path / name / "config").mkdir(parents=True)
        (tmp_path / name / "package.xml").write_text(f"<package><name>{name}</name></package>")
    urdf = tmp_path / "bot_description" / "bot.urdf"
    urdf.write_text(drive_of(CYLINDER.format(r=0.1), 0.2, 0.1))
    yaml = tmp_path / "bot_control" / "config" / "drive.yaml"
    (tmp_path / "other_control" / "config" / "c.yaml").write_text("wheel_separation: 0.7\n")
    assert "base-stated" not in codes(load(urdf))
    yaml.write_text("base:\n  wheel_separation: 0.46\n")
    told = next(f for f in load(urdf).findings if f.code == "base-stated")
    assert "0.46 m, the geometry has 0.4 m" in told.message and f"--controllers {yaml}" in told.fix
    assert "states a track of 0.46 m" in codes(load(urdf, controllers_file=yaml))["base-stated"]  # as it says
    assert load(urdf, track=0.46).base.track == pytest.approx(0.46)
    (tmp_path / "bot_control" / "config" / "sim.yaml").write_text("wheel_separation: 0.4\n")
    assert "base-stated" not in codes(load(urdf))  # one of them agrees


# --- xacro ------------------------------------------------------------------------------------------------------------

HEAD = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'


def xacro(folder: Path, text: str, name: str = "r.urdf.xacro") -> Path:
    pytest.importorskip("xacrodoc", reason="pip install 'mmnn_pin[xacro]'")
    file = folder / name
    file.write_text(f"{HEAD}{text}</robot>")
    return file


ROBOT = drive_of(CYLINDER.format(r=0.1), 0.2, 0.1).removeprefix('<robot name="drive">').removesuffix("</robot>")


def test_a_macro_of_a_package_that_is_missing_can_be_left_out(tmp_path):
    camera = '<xacro:include filename="$(find cams)/c.xacro"/><xacro:cam parent="base"/>'
    lens = link("lens", 0.1) + joint("lens_joint", "fixed", "cam_link", "lens")
    file = xacro(tmp_path, ROBOT + camera + lens)
    with pytest.raises(RobotError, match=r"unknown macro name: xacro:cam.*cams.*--without cam"):
        load(file)
    robot = load(file, without=("cam",))
    assert robot.base.kind == "differential_drive" and "left out: cam" in str(robot.findings)
    assert "the robot lacks what these macros make, and what hangs on it: lens_joint" in str(robot.findings)
    assert "lens" not in robot.urdf  # it hung on what was left out
    with pytest.raises(UnknownName, match=r"unknown macro 'dog': there is: cam$"):
        load(file, without=("cam", "dog"))
    with pytest.raises(ConfigError, match="nothing to expand"):
        plain = tmp_path / "plain.urdf"
        plain.write_text(f'<robot name="r">{ROBOT}</robot>')
        load(plain, without=("cam",))


def test_all_macros_to_leave_out_are_named_at_once_and_that_leads_to_a_robot(tmp_path):
    includes = "".join(f'<xacro:include filename="$(find {name}s)/{name}.xacro"/>' for name in ("cam", "lidar"))
    file = xacro(
        tmp_path, ROBOT + includes + '<xacro:cam parent="base"/><xacro:lidar/><xacro:cam parent="lens"/><xacro:imu/>'
    )
    with pytest.raises(RobotError, match="leave them out") as error:
        load(file)
    names = re.findall(r"--without (\S+)", str(error.value))
    assert names == ["cam", "lidar", "imu"]
    assert load(file, without=tuple(names)).base.kind == "differential_drive"


def test_all_arguments_without_a_value_are_named(tmp_path):
    uses = "".join(f'<xacro:if value="$(arg {name})"/>' for name in "abc")
    file = xacro(tmp_path, '<xacro:arg name="c" default="1"/>' + uses + ROBOT)
    with pytest.raises(RobotError, match="--xacro a:=VALUE --xacro b:=VALUE"):
        load(file)
    assert load(file, xacro=("a:=0", "b:=0")).base.kind == "differential_drive"


def test_a_file_of_macros_names_one_that_calls_them(tmp_path):
    (tmp_path / "package.xml").write_text("<package><name>p</name></package>")
    file = xacro(tmp_path, f'<xacro:macro name="body" params="">{ROBOT}</xacro:macro>', "body.xacro")
    caller = xacro(tmp_path, '<xacro:include filename="body.xacro"/><xacro:body/>', "whole.urdf.xacro")
    with pytest.raises(RobotError, match="it only defines macros: body") as error:
        load(file)
    assert error.value.fix == f"give a file that calls them, such as {caller}"
    assert load(caller).base.kind == "differential_drive"  # as it says
    bare = xacro(tmp_path, "<body/>", "bare.urdf.xacro")  # it does not include the file that has the macro
    with pytest.raises(RobotError, match="write <xacro:body>"):
        load(bare)


def test_memory_that_libraries_reserve_is_not_that_of_a_file(tmp_path, monkeypatch):
    reserve = "import mmap\nkept = mmap.mmap(-1, 3 << 30, 0x4022, mmap.PROT_READ)"  # private, anonymous, without swap
    (tmp_path / "sitecustomize.py").write_text(reserve)
    monkeypatch.syspath_prepend(tmp_path)  # as OpenBLAS does for every core
    assert load(xacro(tmp_path, ROBOT)).base.kind == "differential_drive"


AGAIN = '<xacro:m n="${n-1}"/>'
MACRO = '<xacro:macro name="m" params="n"><a/>{}</xacro:macro><xacro:m n="40"/>'


@pytest.mark.parametrize(("text", "words"), [
    (MACRO.format(2 * AGAIN), "circle"),
    (MACRO.format(f'<xacro:if value="${{n}}">{2 * AGAIN}</xacro:if>'), r"more than (8|30) s"),
    ('<a b="${len(\'x\' * 10**11)}"/>', "GB"),
    ('<a b="${9**9**9**9}"/>', r"more than (8|30) s"),
])  # fmt: skip
@pytest.mark.long
def test_a_xacro_file_without_end_is_ended(tmp_path, text, words):
    begun = time.perf_counter()
    with pytest.raises(InputError, match=words) as error:
        load(xacro(tmp_path, text + ROBOT))
    assert time.perf_counter() - begun < 40 and "\n" not in str(error.value)


def test_an_inertia_written_twice_with_two_zeros():
    text = four(more=MOVE).replace('ixy="0"', 'ixy="-0.000" iyx="0.0"', 1)
    assert "transposed-inertia" in codes(robot_of(text))


def test_what_could_be_locked_is_offered():
    lift = joint("lift", "prismatic", "base", "mast", axis=(0, 0, 1), more=LIMIT.format(0, 1))
    text = chassis(pair() + link("mast", 0.0) + lift).replace(ARM, "")
    with pytest.raises(RobotError, match=r"has no mass.*--lock lift"):
        robot_of(text)
    assert "lift" in robot_of(text, lock=("lift",)).arm.locked
