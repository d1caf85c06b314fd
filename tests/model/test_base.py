"""Bases of every kind are told apart, from geometry first and from the rest of the file where that cannot decide.

The second answers: textbook inverse kinematics of mecanum and omni wheels, and Pinocchio's velocity of the point of a
wheel that touches the floor, which a roller lets go across its axis only.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
from drives import ARM, CYLINDER, LIMIT, SPHERE, UP, Drive, joint, link, moving, origin, random_state, robot_of
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.model import Undecided, load
from mmnn_pin.model.base.report import Unsupported

LYING = origin(pin.rpy.rpyToMatrix(np.pi / 2, 0, 0))
CORNERS = {"fl": (1, 1), "fr": (1, -1), "rl": (-1, 1), "rr": (-1, -1)}
MOVE = '<gazebo>\n<plugin name="p" filename="libgazebo_ros_planar_move.so"/></gazebo>'


def wheel(name, p, axis=(0, 1, 0), radius=0.1, yaw=0.0, parent="base", more="") -> str:
    lying = origin(pin.rpy.rpyToMatrix(0, 0, yaw) @ pin.rpy.rpyToMatrix(np.pi / 2, 0, 0))
    return link(f"{name}_link", shape=CYLINDER.format(r=radius), at=lying) + joint(
        name, "continuous", parent, f"{name}_link", p=p, axis=axis, more=more
    )


def four(lx=0.2, ly=0.3, radius=0.1, flips=(1, 1, 1, 1), more="", arm=ARM, at=(0.0, 0.0)) -> str:
    text = link("base", 20.0, 0.8, '<box size="0.3 0.2 0.1"/>', origin(p=(0, 0, 0.2)))
    for (name, (fore, side)), flip in zip(CORNERS.items(), flips, strict=True):
        text += wheel(name, (at[0] + fore * lx, at[1] + side * ly, radius), (0, flip, 0), radius)
    return f'<robot name="r">{text}{arm}{more}</robot>'


def three(angles, distance=0.25, radius=0.06) -> str:
    text = link("base", 20.0, 0.8, '<box size="0.3 0.2 0.1"/>', origin(p=(0, 0, 0.2)))
    for i, a in enumerate(angles):
        p = (distance * np.cos(a), distance * np.sin(a), radius)
        text += wheel(f"w{i}", p, (np.cos(a), np.sin(a), 0), radius, yaw=a + np.pi / 2)
    return f'<robot name="r">{text}{ARM}</robot>'


def rim_velocity(robot, name, radius, data) -> np.ndarray:
    """Of the point of a wheel's body that touches the floor, in the world."""
    frame = robot.model.getFrameId(f"{name}_link", pin.FrameType.BODY)
    velocity = pin.getFrameVelocity(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
    return velocity.linear + np.cross(velocity.angular, -radius * UP)


# --- Holonomic --------------------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(
    lx=st.floats(0.1, 0.5), ly=st.floats(0.1, 0.5), radius=st.floats(0.03, 0.09),
    flips=st.tuples(*[st.sampled_from([1, -1])] * 4), seed=st.integers(0, 99),
)  # fmt: skip
def test_mecanum_wheels_turn_as_the_textbook_says(lx, ly, radius, flips, seed):
    robot = robot_of(four(lx, ly, radius, flips, MOVE, at=(0.1, -0.05)))
    assert robot.base.kind == "holonomic" and robot.velocity_names[:3] == ("vx", "vy", "w")
    vx, vy, w = nu = np.random.default_rng(seed).normal(size=3)
    rates = dict(zip(robot.full_velocity_names, robot.T[:, :3] @ nu, strict=True))
    for (name, (fore, side)), flip in zip(CORNERS.items(), flips, strict=True):
        textbook = (vx - fore * side * vy - side * (lx + ly) * w) / radius
        assert rates[name] == pytest.approx(flip * textbook, abs=1e-9)
    np.testing.assert_allclose(robot.frame, [0.1, -0.05, 0], atol=1e-9)
    assert robot.base.track == pytest.approx(2 * ly)
    assert robot.E[:3].shape == (3, 6) and np.linalg.matrix_rank(robot.E[:3, :4]) == 3


@settings(max_examples=20, deadline=None)
@given(lx=st.floats(0.1, 0.5), ly=st.floats(0.1, 0.5), roller=st.floats(-1.0, 1.0).filter(lambda a: abs(a) > 0.2),
       seed=st.integers(0, 99))  # fmt: skip
def test_rims_slip_only_across_the_rollers(lx, ly, roller, seed):
    if abs(lx * np.tan(roller) + ly) < 0.05:
        return  # the rollers' axes meet in the middle: turning is not driven
    robot = robot_of(four(lx, ly, 0.1), base="holonomic", roller=roller)
    position, nu = random_state(robot, seed)
    data, phi = moving(robot, position, nu), position[2]
    for name, (fore, side) in CORNERS.items():
        angle = phi - fore * side * roller
        slip = rim_velocity(robot, name, 0.1, data)
        assert slip @ [np.cos(angle), np.sin(angle), 0] == pytest.approx(0, abs=1e-9)
    assert np.abs(robot.A @ robot.T).max() < 1e-12
    assert np.linalg.matrix_rank(robot.A) == len(robot.A) == robot.model.nv - robot.dimensions.dof


@settings(max_examples=20, deadline=None)
@given(turn=st.floats(-3, 3), distance=st.floats(0.15, 0.5), seed=st.integers(0, 99))
def test_omni_wheels_on_crossed_axles_need_no_hint(turn, distance, seed):
    angles = turn + np.arange(3) * 2 * np.pi / 3
    robot = robot_of(three(angles, distance))
    assert robot.base.kind == "holonomic" and "base-omni" in [f.code for f in robot.findings]
    vx, vy, w = nu = np.random.default_rng(seed).normal(size=3)
    rates = dict(zip(robot.full_velocity_names, robot.T[:, :3] @ nu, strict=True))
    for i, a in enumerate(angles):  # the axle points outward: a positive turn rolls the wheel clockwise
        assert rates[f"w{i}"] == pytest.approx((np.sin(a) * vx - np.cos(a) * vy - distance * w) / 0.06, abs=1e-9)
    assert np.abs(robot.A @ robot.T).max() < 1e-12


def test_the_mass_of_a_holonomic_base_feels_its_wheels_spin():
    robot = robot_of(four(0.2, 0.3, more=MOVE, arm=""))
    M = pin.crba(robot.model, robot.model.createData(), robot.configuration(np.zeros(7)))
    M = robot.T.T @ (np.triu(M) + np.triu(M, 1).T) @ robot.T
    spin = 4 * 0.02 / 0.1**2
    turn = 0.8 + 4 * (0.02 + 0.2**2 + 0.3**2) + spin * 0.5**2
    np.testing.assert_allclose(M, np.diag([24 + spin, 24 + spin, turn]), atol=1e-12)


# --- Four parallel wheels: what decides -------------------------------------------------------------------------------


def friction(mu1, mu2, fdirs=(), attribute="") -> str:
    tags = f"<mu1>{mu1}</mu1><mu2>{mu2}</mu2>"
    more = [f"<fdir1{attribute}>{fdir}</fdir1>" for fdir in fdirs] or [""] * 4
    return "".join(
        f'<gazebo reference="{name}_link">{tags}{fdir}</gazebo>' for name, fdir in zip(CORNERS, more, strict=True)
    )


def commanded(*names) -> str:
    entry = {True: '<command_interface name="velocity"/>', False: '<state_interface name="velocity"/>'}
    joints = "".join(f'<joint name="{name}">{entry[name in names]}</joint>' for name in CORNERS)
    return f'<ros2_control name="c" type="system">{joints}</ros2_control>'


@pytest.mark.parametrize(("more", "words"), [
    (MOVE, "planar_move"),
    ('<gazebo><plugin name="mecanum_controller" filename="x.so"/></gazebo>', "mecanum"),
    (friction(0, 0), "contact friction is 0"),
    (friction(1, 0, ["1 -1 0", "1 1 0", "1 1 0", "1 -1 0"]), "oblique"),
])  # fmt: skip
def test_evidence_for_mecanum_wheels_is_cited(more, words):
    robot = robot_of(four(more=more))
    note = next(f for f in robot.findings if f.code == "base-evidence")
    assert robot.base.kind == "holonomic" and words in note.message and "line " in note.message
    assert [w.roller for w in robot.base.wheels] == pytest.approx([-np.pi / 4, np.pi / 4, np.pi / 4, -np.pi / 4])
    assumed = any(f.code == "base-roller" and "45 degrees" in f.message for f in robot.findings)
    assert assumed == ("1 -1 0" not in more)  # friction along a diagonal states the angle


@pytest.mark.parametrize("more", [
    '<gazebo><plugin name="p" filename="libgazebo_ros_diff_drive.so"/></gazebo>', friction(1, 1), commanded("fl", "fr"),
])  # fmt: skip
def test_evidence_for_a_skid_steer_is_cited(more):
    robot = robot_of(four(more=more))
    cited = next(f.message for f in robot.findings if f.code in ("base-evidence", "base-doubt"))
    assert robot.base.kind == "skid_steer" and cited.startswith("taken as skid_steer") and "line " in cited


@pytest.mark.parametrize("more", ["", MOVE + friction(1, 1), commanded(*CORNERS)])
def test_without_evidence_or_with_two_minds_it_asks(more):
    with pytest.raises(Undecided, match=r"--base (holonomic|skid_steer) for .* wheels; --base (skid|holo)") as error:
        robot_of(four(more=more))
    assert [robot_of(four(more=more), base=kind).base.kind for kind in ("skid_steer", "holonomic")] == [
        "skid_steer", "holonomic"
    ]  # fmt: skip
    kinds = [r.kind for r in error.value.readings]
    assert {*kinds[:2]} == {"holonomic", "skid_steer"} and {*kinds} == {*kinds[:2], "tracked", "differential_drive"}
    assert len(error.value.candidates) == 4
    if more.startswith("<gazebo>"):
        rolls, skids = sorted(error.value.readings[:2], key=lambda r: r.kind)
        assert any("planar_move" in text for text in rolls.told(1))
        assert any("friction" in text for text in skids.told(1))


def test_wheels_drawn_as_plain_cylinders_have_no_rollers_unless_all_else_is_drawn_as_meshes():
    """Who draws the rest as meshes may have left the rollers out."""
    drawn = four().replace("collision", "visual")
    robot = robot_of(drawn)
    told = next(f for f in robot.findings if f.code == "base-doubt")
    assert robot.base.kind == "skid_steer" and told.fix == "--base holonomic for the other"
    plate = '<link name="plate{0}"><visual><geometry><mesh filename="plate.stl"/></geometry></visual></link>'
    held = '<joint name="held{0}" type="fixed"><parent link="base"/><child link="plate{0}"/></joint>'
    with pytest.raises(Undecided, match="--base holonomic for mecanum wheels"):
        robot_of(drawn.replace("</robot>", "".join((plate + held).format(i) for i in range(6)) + "</robot>"))


def test_names_alone_do_not_decide():
    with pytest.raises(Undecided):
        robot_of(four().replace("_link", "_mecanum_link"))


def rollers(name: str, angle: float, count: int = 8, radius: float = 0.1) -> str:
    """Rollers around a wheel, the lowest with its axis at `angle` from the rolling direction."""
    text = ""
    for i in range(count):
        R = pin.rpy.rpyToMatrix(0, 2 * np.pi * i / count, 0)
        at = R @ np.array([0, 0, -0.8 * radius])
        axis = R @ np.array([np.cos(angle), np.sin(angle), 0])
        text += link(f"{name}_roller_{i}", 0.05, 1e-5, SPHERE.format(r=0.2 * radius))
        text += joint(f"{name}_{i}", "continuous", f"{name}_link", f"{name}_roller_{i}", p=at, axis=axis)
    return text


def test_modelled_rollers_decide_and_state_their_angle():
    angles = {"fl": -0.6, "fr": 0.6, "rl": 0.6, "rr": -0.6}
    robot = robot_of(four(more="".join(rollers(name, a) for name, a in angles.items())))
    assert {w.joint: w.roller for w in robot.base.wheels} == pytest.approx(angles)
    assert "base-roller" not in [f.code for f in robot.findings]
    assert len(robot.arm.locked) == 32 and robot.joint_names == ("shoulder", "elbow")


# --- Refused by name --------------------------------------------------------------------------------------------------


def steering(sides) -> str:
    text = link("base", 20.0, 0.8)
    for name, (fore, side) in CORNERS.items():
        parent = "base"
        if name in sides:
            parent = f"{name}_knuckle"
            text += link(parent) + joint(
                f"{name}_steer", "revolute", "base", parent, p=(0.2 * fore, 0.3 * side, 0.1), axis=(0, 0, 1),
                more=LIMIT.format(-0.5, 0.5),
            )  # fmt: skip
        text += wheel(name, (0, 0, 0) if name in sides else (0.2 * fore, 0.3 * side, 0.1), parent=parent)
    return f'<robot name="r">{text}{ARM}</robot>'


def legged(hips, torso="") -> str:
    text = link("base", 5.0)
    for i, (x, y) in enumerate(hips):
        limit = LIMIT.format(-1, 1)
        text += link(f"thigh{i}") + joint(f"hip{i}", "revolute", "base", f"thigh{i}", p=(x, y, 0), more=limit)
        text += link(f"shank{i}", shape=SPHERE.format(r=0.02), at=origin(p=(0, 0, -0.3)))
        text += joint(f"knee{i}", "revolute", f"thigh{i}", f"shank{i}", p=(0, 0, -0.3), more=limit)
    return f'<robot name="r">{text}{torso}</robot>'


def with_waist(below: int) -> str:
    """A trunk with two arms of three joints, and a waist that carries so many more limbs, which hang to the ground."""
    text, limit = link("base", 5.0) + link("pelvis", 2.0), LIMIT.format(-1, 1)
    text += joint("waist", "revolute", "base", "pelvis", p=(0, 0, -0.2), axis=(0, 0, 1), more=limit)
    limbs = [("arm", "base", side, 0.2) for side in (1, -1)] + [("leg", "pelvis", side, 0.0) for side in (1, -1)][
        :below
    ]
    for name, parent, side, z in limbs:
        at = (0, 0.1 * side, z)
        for part in "abc":
            child = f"{name}{side}{part}"
            text += link(child) + joint(f"{child}_joint", "revolute", parent, child, p=at, more=limit)
            parent, at = child, (0, 0, -0.1 if name == "arm" else -0.3)
    return f'<robot name="r">{text}</robot>'


def along_y(limbs) -> str:
    """A body with limbs of three joints that go up or down y, as body models are drawn: name to direction."""
    text = link("base", 5.0)
    for k, (name, way) in enumerate(limbs.items()):
        parent, limit = "base", LIMIT.format(-1, 1)
        for part in ("a", "b", "c"):
            text += link(name + part) + joint(
                f"{name}_{part}", "revolute", parent, name + part, p=(0.1 * k, 0.3 * way, 0), more=limit
            )
            parent = name + part
    return f'<robot name="r">{text}</robot>'


def stretched(ways) -> str:
    """A body with level limbs of three joints that point so many ways [rad]."""
    text, limit = link("base", 5.0), LIMIT.format(-1, 1)
    for k, way in enumerate(ways):
        parent, far = "base", 0.05
        for part in "abc":
            at = (far * math.cos(way), far * math.sin(way), 0.0)
            child, parent, far = f"limb{k}{part}", parent, 0.1
            text += link(child) + joint(f"{child}_joint", "revolute", parent, child, p=at, more=limit)
            parent = child
    return f'<robot name="r">{text}</robot>'


CRAB = [k * math.pi / 3 for k in range(6)]


def drone() -> str:
    text = link("frame", 1.5)
    for i, (x, y) in enumerate(itertools.product((-0.2, 0.2), repeat=2)):
        text += link(f"r{i}", 0.01, 1e-5) + joint(f"j{i}", "continuous", "frame", f"r{i}", p=(x, y, 0), axis=(0, 0, 1))
    return f'<robot name="r">{text}</robot>'


FOUR_HIPS = [(0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1)]
UPPER = ARM + link("hand") + joint("wrist", "continuous", "fore", "hand", p=(0.3, 0, 0))


@pytest.mark.parametrize(("text", "name"), [
    (legged(FOUR_HIPS), "legged machine"),
    (legged(FOUR_HIPS[:2]), "legged machine"),
    (legged([(0, 0.1), (0, -0.1)], UPPER), "humanoid"),
    (along_y({"left": -1, "right": -1, "spine": 1}), "humanoid"),
    (with_waist(2), "humanoid"),
    (stretched(CRAB), "legged machine"),
    (drone(), "drone"),
    (f'<robot name="r">{link("quadrotor_base")}</robot>', "drone"),
    (f'<robot name="r">{link("base")}</robot>', "single rigid body"),
])  # fmt: skip
def test_machines_of_other_kinds_are_refused_by_name(text, name):
    with pytest.raises(Unsupported, match=f"a {name} perhaps") as error:
        robot_of(text)
    assert error.value.machine == name and error.value.line


@pytest.mark.parametrize("limbs", [{"left": -1, "right": 1}, {"left": -1, "right": -1}, {"arm": 1}])
def test_arms_along_y_are_no_legs(limbs):
    assert robot_of(along_y(limbs)).base.kind == "fixed"


@pytest.mark.parametrize("ways", [CRAB[:3], [-0.3, -0.1, 0.1, 0.3]])
def test_few_limbs_and_fingers_that_point_one_way_are_no_legs(ways):
    assert robot_of(stretched(ways)).base.kind == "fixed"


def test_what_hangs_alone_on_a_waist_is_no_leg():
    assert robot_of(with_waist(1)).base.kind == "fixed"


# --- Overrides --------------------------------------------------------------------------------------------------------


def test_named_wheels_drive_and_the_others_are_free():
    robot = robot_of(four(), wheels=("rl", "rr"))
    assert robot.base.kind == "differential_drive" and [w.joint for w in robot.base.wheels] == ["rl", "rr"]
    assert robot.base.casters == ("fl", "fr") and robot.base.frame[0] == pytest.approx(-0.2)
    assert robot.velocity_names[:2] == ("v", "w")


def test_radius_and_track_are_taken_as_said():
    robot = robot_of(four(), wheels=("fl", "fr"), radius=0.11, track=0.5)
    assert {w.radius for w in robot.base.wheels} == {0.11} and robot.base.track == 0.5
    rows = [robot.full_velocity_names.index(name) for name in ("fl", "fr")]
    np.testing.assert_allclose(robot.T[rows, :2] * 0.11, [[1, -0.25], [1, 0.25]])


def test_a_base_that_is_taken_as_fixed_is_parked():
    robot = robot_of(four(), base="fixed")
    assert robot.base.kind == "fixed" and robot.joint_names == ("shoulder", "elbow")
    assert set(robot.arm.locked) == set(CORNERS) and np.linalg.matrix_rank(robot.A) == len(robot.A) == 4


@pytest.mark.parametrize(("said", "words"), [
    ({"wheels": ("fl", "rl")}, "not two wheels on one axle"),
    ({"wheels": ("fl",)}, "1 wheel"),
    ({"wheels": ("fl", "elbow")}, "'elbow' cannot be a wheel"),
    ({"wheels": ("fl", "shoulder")}, "not horizontal"),
    ({"wheels": ("fl", "fr"), "base": "holonomic"}, "at least three"),
    ({"radius": -1.0}, "radius"), ({"track": float("nan")}, "track"),
    ({"wheels": ("fl", "fl")}, "twice"),
])  # fmt: skip
def test_overrides_that_do_not_suit_are_refused(said, words):
    with pytest.raises(ConfigError, match=words):
        robot_of(four(), **said)


def test_unknown_wheels_and_bases_name_what_there_is():
    with pytest.raises(UnknownName, match="did you mean 'fl'"):
        robot_of(four(), wheels=("fll", "fr"))
    with pytest.raises(UnknownName, match="holonomic"):
        robot_of(four(), base="omni")


def welded() -> str:
    text = link("base", 20.0, 0.8, '<box size="0.3 0.2 0.1"/>', origin(p=(0, 0, 0.2)))
    for name, (fore, side) in CORNERS.items():
        text += link(f"{name}_link", shape=CYLINDER.format(r=0.1), at=LYING)
        text += joint(name, "fixed", "base", f"{name}_link", p=(0.2 * fore, 0.3 * side, 0.1))
    return f'<robot name="r">{text}{ARM}</robot>'


def test_welded_wheels_are_told_and_the_user_says_how_to_go_on():
    with pytest.raises(Undecided, match="welded on") as error:
        robot_of(welded())
    assert [r.kind for r in error.value.readings] == ["holonomic", "fixed"] and "--base fixed" in error.value.fix
    assert robot_of(welded(), base="fixed").base.kind == "fixed"
    robot = robot_of(welded(), base="holonomic")
    assert robot.actuator_names[:3] == ("base_x", "base_y", "base_turn")
    np.testing.assert_array_equal(robot.E, np.eye(5))
    np.testing.assert_array_equal(robot.T, np.eye(5))


def test_overrides_stand_beside_the_urdf_and_a_call_counts_more(tmp_path):
    file = tmp_path / "r.urdf"
    file.write_text(four())
    (tmp_path / "r.mmnn.toml").write_text('wheels = ["fl", "fr"]\nradius = 0.2\nlock = ["elbow=0.5"]\n')
    robot = load(file)
    assert robot.base.wheels[0].radius == 0.2 and robot.arm.locked["elbow"] == 0.5
    assert "overrides" in [f.code for f in robot.findings]
    assert load(file, radius=0.3).base.wheels[0].radius == 0.3


@pytest.mark.parametrize(("text", "error", "words"), [
    ("whels = ['fl', 'fr']", UnknownName, "did you mean 'wheels'"),
    ("radius = '0.1'", ConfigError, "radius"),
    ("radius = -1.0", ConfigError, "radius"),
    ("base = 'omni'", UnknownName, "holonomic"),
    ("radius = ", ConfigError, "TOML"),
])  # fmt: skip
def test_bad_files_of_overrides_say_what_is_wrong(tmp_path, text, error, words):
    (tmp_path / "r.urdf").write_text(four())
    (tmp_path / "r.mmnn.toml").write_text(text)
    with pytest.raises(error, match=words) as raised:
        load(tmp_path / "r.urdf")
    assert str(raised.value.file).endswith("r.mmnn.toml")


# --- What is told -----------------------------------------------------------------------------------------------------


def test_radii_that_differ_are_used_with_a_warning():
    robot = robot_of(Drive(radii=(0.1, 0.103)).urdf())
    assert [w.radius for w in robot.base.wheels] == [0.1, 0.103]
    assert [f.severity for f in robot.findings if f.code == "base-radius"] == ["warning"]
    assert "base-radius" not in [f.code for f in robot_of(Drive(radii=(0.1, 0.1005)).urdf()).findings]


@pytest.mark.parametrize(("floor", "word"), [(-0.03, "below"), (0.03, "above")])
def test_wheels_below_or_above_the_footprint_are_told(floor, word):
    foot = joint("foot", "fixed", "footprint", "base") + '<link name="footprint"/>'
    robot = robot_of(Drive(floor=floor).urdf(ARM + foot))
    told = [f for f in robot.findings if f.code == "base-floor"]
    assert len(told) == 1 and word in told[0].message and robot.base.floor == pytest.approx(floor)
    assert "base-floor" not in [f.code for f in robot_of(Drive().urdf(ARM + foot)).findings]


def test_a_wheel_on_a_swing_arm_is_suspended():
    swing = link("swing") + joint("spring", "revolute", "base", "swing", more=LIMIT.format(-0.1, 0.1))
    text = Drive().urdf(ARM + swing).replace(
        '<parent link="base"/><child link="left_link"/>', '<parent link="swing"/><child link="left_link"/>'
    )  # fmt: skip
    robot = robot_of(text)
    assert robot.base.kind == "differential_drive" and robot.base.suspensions == ("spring",)
