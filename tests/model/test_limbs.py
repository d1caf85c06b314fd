"""Roles of joints by signs: random robots of arms, jaws, heads and torsos whose names tell nothing, and what files say.

The second answer is how the test built each robot: it knows what is a jaw.
"""

from __future__ import annotations

import random
import re
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
import pytest
from drives import LIMIT, Drive, joint, link, robot_of
from hypothesis import given, settings
from hypothesis import strategies as st
from test_arm import chain, finger, two_armed
from test_base import wheel

from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.model import Robot
from mmnn_pin.model.limbs import STILL, WEIGHTS, role_named
from mmnn_pin.model.loading import load
from mmnn_pin.model.robots import extra
from mmnn_pin.model.urdf.finding import AuditError, Finding

X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)


@dataclass
class Built:
    """A robot that is put together of pieces, and what each joint is."""

    pieces: list[str] = field(default_factory=list)
    moves: set[str] = field(default_factory=set)
    still: set[str] = field(default_factory=set)
    seed: int = 0
    lidar: str = ""

    def add(self, parent: str, kind="revolute", p=(0, 0, 0.3), axis=Y, moves=True, limits=(-2, 2), more="", mass=1.0):
        """A joint with its link, by neutral names; the link."""
        name = f"n{len(self.pieces)}"
        (self.moves if moves else self.still).add(f"{name}j")
        limit = LIMIT.format(*limits) if kind != "continuous" else ""
        text = joint(f"{name}j", kind, parent, name, p=p, axis=axis, more=limit + more)
        self.pieces.append(link(name, mass, mass * 1e-3) + text)
        return name

    def arm(self, parent: str, y: float, count: int, z=0.3) -> str:
        """An arm of joints that turn about all axes in turn, 0.25 m each."""
        for i in range(count):
            p = (0, y, z) if i == 0 else (0, 0, 0.25)
            parent = self.add(parent, p=p, axis=(Z, Y, Y, X)[i % 4])
        return parent

    def jaws(self, parent: str, kind: str) -> None:
        """A gripper of two jaws at the end of an arm."""
        if kind == "linkage":  # a knuckle with a tip, and the other one; all but the first follow
            sizes = {"moves": False, "limits": (-0.8, 0.8), "mass": 0.05, "axis": X}
            first = self.add(parent, p=(0, 0.03, 0.06), **sizes)
            follow = '<mimic joint="{}j" multiplier="{}"/>'.format
            self.add(first, p=(0, 0.01, 0.04), more=follow(first, -1), **sizes)
            other = self.add(parent, p=(0, -0.03, 0.06), more=follow(first, -1), **sizes)
            self.add(other, p=(0, -0.01, 0.04), more=follow(first, 1), **sizes)
            return
        turns = kind == "turn"
        sizes = {"kind": "revolute" if turns else "prismatic", "limits": (0, 0.8) if turns else (0, 0.04), "mass": 0.05}
        master = self.add(parent, p=(0, 0.02, 0.08), axis=X if turns else Y, moves=False, **sizes)
        mimic = f'<mimic joint="{master}j"/>' if kind == "mimic" else ""
        self.add(parent, p=(0, -0.02, 0.08), axis=(-1, 0, 0) if turns else (0, -1, 0), moves=False, more=mimic, **sizes)

    def head(self, parent: str) -> None:
        """A pan and a tilt."""
        pan = self.add(parent, p=(0.05, 0, 0.4), axis=Z, moves=False, mass=0.3)
        self.add(pan, p=(0, 0, 0.08), moves=False, mass=0.3)

    def urdf(self) -> str:
        """It on a differential drive, its pieces shuffled."""
        pieces = list(self.pieces)
        random.Random(self.seed).shuffle(pieces)
        return Drive(names=("wl", "wr")).urdf("".join(pieces))


@st.composite
def robots(draw) -> Built:
    built, grippers = (
        Built(seed=draw(st.integers(0, 99))),
        st.sampled_from(["slide", "turn", "mimic", "linkage", "none"]),
    )
    on, count = "base", draw(st.integers(2, 7))
    if draw(st.booleans()):
        on = built.add("base", "prismatic", axis=Z, limits=(0, 0.3))
    for side in draw(st.sampled_from([(0.0,), (0.25, -0.25)])):
        end = built.arm(on, side, count)
        if (gripper := draw(grippers)) != "none":
            built.jaws(end, gripper)
    if draw(st.booleans()):
        built.head(on)
    if draw(st.booleans()):
        built.lidar = built.add("base", "continuous", p=(0.1, 0.1, 0.4), axis=Z, moves=False, mass=0.1)
    return built


def answered(text: str, moves: set[str]) -> Robot:
    """A robot after its questions about joints of the arm, answered by the options that they print."""
    said: dict[str, tuple[str, ...]] = {"free": (), "lock": ()}
    for _ in range(3):
        try:
            return robot_of(text, **said)
        except AuditError as error:
            told = next(f for f in error.errors if f.code == "arm-doubt")
            printed = re.findall(r"--(free|lock) (\S+)", told.fix)
            answers = [(key, name) for key, name in printed if (key == "free") == (name in moves)]
            assert answers and {name for _, name in answers} == {name for _, name in printed}
            said = {key: (*old, *(name for k, name in answers if k == key)) for key, old in said.items()}
    raise AssertionError("asked again and again")


def doubted(text: str) -> Finding:
    """The question about joints of the arm."""
    with pytest.raises(AuditError) as error:
        robot_of(text)
    (told,) = (f for f in error.value.errors if f.code == "arm-doubt")
    return told


@settings(max_examples=40, deadline=None)
@given(robots())
def test_structure_alone_tells_arms_from_jaws_heads_and_lidars_or_asks_and_the_options_tell(built: Built):
    robot = answered(built.urdf(), built.moves)
    assert set(robot.joint_names) == built.moves
    assert set(robot.arm.locked) == built.still
    lidar = robot.arm.reasons[f"{built.lidar}j"] if built.lidar else "locked as you said"
    assert lidar in ("taken as a sensor that turns", "locked as you said")
    assert len(robot.hands) == len(set(robot.hands)) == sum("arm" not in h for h in robot.hands)


@settings(max_examples=15, deadline=None)
@given(robots(), st.integers(0, 99))
def test_the_order_of_the_file_does_not_matter(built: Built, seed: int):
    first = answered(built.urdf(), built.moves)
    built.seed = seed
    again = answered(built.urdf(), built.moves)
    assert set(first.joint_names) == set(again.joint_names) and set(first.hands) == set(again.hands)
    assert {d.joints[0]: d.margin for d in first.arm.doubts} == pytest.approx(
        {d.joints[0]: d.margin for d in again.arm.doubts}
    )


def one_jaw(name: str, count: int = 5) -> str:
    """An arm whose last joint is a jaw in line: across the wrist, which rolls."""
    built = Built()
    end = built.arm("base", 0.0, count - 1)
    wrist = built.add(end, p=(0, 0, 0.06), axis=Z, mass=0.2)
    built.pieces.append(
        link(f"{name}_link", 0.05, 1e-5)
        + joint(name, "revolute", wrist, f"{name}_link", p=(0.02, 0, 0.03), axis=Y, more=LIMIT.format(0, 1.5))
    )
    return built.urdf()


JAWS = ("gripper", "jaw", "left_claw_joint", "finger_joint1", "griffe", "pinza_izquierda", "backe", "garra", "zhua_1")


@pytest.mark.parametrize("name", JAWS)
def test_a_jaw_in_line_stands_still_where_it_is_named_so(name: str):
    robot = robot_of(one_jaw(name))
    assert name in robot.arm.locked and "jaw" in robot.arm.reasons[name] and not robot.arm.doubts


@pytest.mark.parametrize("name", ["joint6", "m_6", "Revolute-57"])
def test_a_jaw_in_line_without_a_name_is_asked_about_and_the_option_is_one(name: str):
    told = doubted(one_jaw(name))
    assert f"'{name}' is part of the arm or a jaw" in told.message
    assert told.fix == f"--lock {name} for a jaw, --free {name} for part of the arm"
    for moves in ({name}, set[str]()):
        robot = answered(one_jaw(name), moves)
        assert (name in robot.joint_names, robot.arm.doubts) == (bool(moves), ())


def test_names_say_roles_in_their_last_word():
    said = {
        "left_arm_gripper": "jaw", "head_pan_joint": "head", "shoulder_pan": "arm", "gripper_wrist_roll": "arm",
        "LHand": "jaw", "lidar_mast": "sensor", "torso_lift": "arm", "jointGripper": "jaw", "joint_3": "",
        "HeadYaw": "head", "kopf_dreh": "head", "tete": "head", "cabeza": "head", "l_zhua": "jaw",
    }  # fmt: skip
    assert {name: role_named(name)[0] for name in said} == said


def test_words_that_all_names_share_tell_nothing():
    text = chain("head_arm", 6, "base").replace("head_arm", "head_x")
    robot = robot_of(Drive().urdf(text))
    assert robot.dimensions.arm == 6


def test_a_word_of_all_joints_of_an_arm_says_less_than_one_of_a_joint():
    fingers = finger("finger_a", 1.0) + finger("finger_b", -1.0)
    text = re.sub(r'(name|link)="(?!base)(\w+)"', r'\1="\2_second_arm"', chain("arm", 6, "base") + fingers)
    robot = robot_of(Drive().urdf(text))
    assert robot.dimensions.arm == 6 and all("arm_joint" in name for name in robot.joint_names)
    names = {"finger1_joint_second_arm": "jaw", "joint1_second_arm": "arm"}
    assert {name: role_named(name, {"second", "arm"})[0] for name in names} == names


def test_what_only_pans_and_tilts_is_the_arm_of_a_stand_and_stands_still_on_a_base():
    built = Built()
    built.head("base")
    named = built.urdf().replace("n0j", "neck").replace("n1j", "head")
    assert robot_of(named, base="fixed").joint_names == ("neck", "head")
    assert {"neck", "head"} <= set(robot_of(named).arm.locked)
    assert robot_of(built.urdf()).joint_names == ("n0j", "n1j")  # without a name it is a short arm


@pytest.mark.parametrize(("kind", "axis"), [("continuous", Z), ("revolute", Y)])
def test_what_turns_alone_on_a_base_stands_still_and_is_told_unless_an_arm_is_named(kind, axis):
    built = Built()
    built.add("base", kind, p=(0.1, 0, 0.4), axis=axis, mass=0.1)
    robot = robot_of(built.urdf())
    assert "n0j" in robot.arm.locked and "arm-locked" in {f.code for f in robot.findings}
    assert robot_of(built.urdf(), free=("n0j",)).joint_names == ("n0j",)
    assert robot_of(built.urdf().replace("n0j", "shoulder")).joint_names == ("shoulder",)
    assert robot_of(built.urdf(), base="fixed").joint_names == ("n0j",)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_what_lifts_two_jaws_is_an_arm_though_it_is_called_a_gripper(kind):
    text = link("claw") + joint("j0", kind, "base", "claw", more=LIMIT.format(0, 0.2))
    for name, y in (("finger_left", 0.03), ("finger_right", -0.03)):
        more = LIMIT.format(-0.1, 0.1)  # as far as it reaches: neither size nor travel tell
        text += link(name) + joint(f"{name}_joint", "prismatic", "claw", name, p=(0.1, y, 0), axis=Y, more=more)
        text += link(f"tip_{name}") + joint(f"tip_{name}", "fixed", name, f"tip_{name}", p=(0.2, 0, 0))
    told = doubted(Drive().urdf(text))  # of its jaws, whose size and travel tell nothing
    assert "'finger_left_joint', 'finger_right_joint' are each a jaw or part of the arm" in told.message
    jaws = ("finger_left_joint", "finger_right_joint")
    assert robot_of(Drive().urdf(text), lock=jaws).joint_names == ("j0",)


# --- What files say ---------------------------------------------------------------------------------------------------

GROUPS = {
    "srdf": '<robot name="r"><group name="arm"><chain base_link="base" tip_link="{wrist}"/></group>'
    '<group name="gripper"><link name="{wrist}"/><joint name="{jaw}"/></group>'
    '<end_effector name="e" parent_link="{wrist}" group="gripper"/></robot>',
    "yaml": "gripper_controller:\n  ros__parameters:\n    joints:\n      - {jaw}\n",
    "ros2_control": '<ros2_control name="GripperSystem" type="system"><joint name="{jaw}"/></ros2_control>',
}


@pytest.mark.parametrize("kind", GROUPS)
def test_groups_of_files_tell_a_jaw(tmp_path, kind):
    text, file = one_jaw("joint6"), tmp_path / "robot.urdf"
    wrist = re.search(r'<parent link="(n\d+)"/><child link="joint6_link"/>', text)[1]
    said = GROUPS[kind].format(jaw="joint6", wrist=wrist)
    if kind == "ros2_control":
        text = text.replace("</robot>", f"{said}</robot>")
    else:
        (tmp_path / f"robot.{kind}").write_text(said)
    file.write_text(text)
    robot = load(file)
    assert "joint6" in robot.arm.locked and not robot.arm.doubts
    if kind == "srdf":
        assert robot.hands == (wrist,) and "'gripper' is mounted on it" in robot.arm.hands[0].why


OTHER = '<robot name="r"><group name="gripper"><joint name="joint6"/><joint name="x"/></group></robot>'


@pytest.mark.parametrize(("text", "warned"), [("<robot", True), ("", True), (OTHER, False)])
def test_an_srdf_that_is_broken_is_told_and_one_of_another_robot_says_nothing(tmp_path, text, warned):
    (tmp_path / "robot.urdf").write_text(one_jaw("joint6"))
    (tmp_path / "robot.srdf").write_text(text)
    robot = load(tmp_path / "robot.urdf", free=("joint6",))
    told = [f.message for f in robot.findings if f.code == "arm-srdf"]
    assert "joint6" in robot.joint_names and len(told) == warned == any("robot.srdf" in message for message in told)


# --- Linkages ---------------------------------------------------------------------------------------------------------


def rover() -> Built:
    """Six wheels on two rockers, with a bar that couples these; an arm with a cylinder beside its second link."""
    built = Built()
    bar = built.add("base", p=(-0.2, 0, 0.3), axis=X, moves=False)
    for y in (0.3, -0.3):
        end = built.add(bar, p=(0, y, 0), axis=X, moves=False, mass=0.1)
        built.add(end, p=(0, 0, 0), moves=False, mass=0.1)
        rocker = built.add("base", p=(0, y, 0.3), moves=False)
        for x in (-0.3, 0.0, 0.3):
            built.pieces.append(wheel(f"w{len(built.pieces)}", (x, np.sign(y) * 0.1, -0.2), parent=rocker))
        built.add(rocker, p=(0.05, 0, 0.15), moves=False, mass=0.2)
    first = built.add("base", p=(0.1, 0, 0.4), axis=Z)
    built.arm(first, 0.0, 4)
    tube = built.add(first, p=(0.05, 0, 0.1), moves=False, mass=0.1)
    built.add(tube, "prismatic", p=(0, 0, 0.2), axis=Z, limits=(0, 0.2), moves=False, mass=0.1)
    return built


def test_what_couples_rockers_and_cylinders_beside_an_arm_stand_still_and_nothing_is_asked():
    built = rover()
    robot = robot_of(f'<robot name="r">{link("base", 20.0)}{"".join(built.pieces)}</robot>', base="skid_steer")
    assert set(robot.joint_names) == built.moves and not robot.arm.doubts
    still = {name for name, why in robot.arm.reasons.items() if "a linkage" in why}
    assert still == built.still - set(robot.base.suspensions)


def test_doubts_of_one_kind_are_one_line_whose_option_ends_them():
    built = Built()
    for side in (0.4, -0.4):
        end = built.arm("base", side, 5)
        wrist = built.add(end, p=(0, 0, 0.06), axis=Z, mass=0.2)
        built.add(wrist, p=(0.02, 0, 0.03), limits=(0, 0.8), mass=0.05)
    told = doubted(built.urdf())
    assert "are each part of the arm or a jaw" in told.message
    names = tuple(re.findall(r"--lock (\S+)", told.fix))
    assert len(names) == 2 and not robot_of(built.urdf(), lock=names).arm.doubts


@pytest.mark.parametrize("count", [1, 3])
def test_joints_of_an_arm_with_limits_of_one_value_are_asked_about(count: int):
    """An exporter writes 0 and 0 where nobody said more, and some write a rigid joint so."""
    text = chain("arm", 6, "base")
    for i in range(count):
        head, tail = text.split(f'name="arm_joint_{i}"')
        text = (
            head
            + f'name="arm_joint_{i}"'
            + re.sub(r'lower="[^"]*" upper="[^"]*"', 'lower="0" upper="0"', tail, count=1)
        )
    names = {f"arm_joint_{i}" for i in range(count)}
    every = {f"arm_joint_{i}" for i in range(6)}
    told = doubted(Drive().urdf(text))
    assert "limits of one value" in told.message and {*re.findall(r"--lock (\S+)", told.fix)} == names
    assert set(answered(Drive().urdf(text), every).joint_names) == every
    assert set(answered(Drive().urdf(text), every - names).joint_names) == every - names


# --- Hands and arms of two --------------------------------------------------------------------------------------------


def test_a_hand_is_the_frame_of_a_tool_else_the_middle_of_the_jaws_else_the_last_link():
    fingers, text = finger("a", 1.0) + finger("b", -1.0), chain("arm", 6, "base")
    tool = link("tcp", 0.0) + joint("t", "fixed", "arm_5", "tcp", p=(0, 0, 0.07))
    assert robot_of(Drive().urdf(text + fingers + tool)).hands == ("tcp",)
    assert robot_of(Drive().urdf(text)).hands == ("arm_5",)
    robot = robot_of(Drive().urdf(text + fingers))
    assert robot.hands == ("arm_5_hand",)
    q = robot.configuration(robot.neutral_position())
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    at = {f.name: data.oMf[i].translation for i, f in enumerate(robot.model.frames)}
    np.testing.assert_allclose(at["arm_5_hand"], (at["a"] + at["b"]) / 2, atol=1e-12)
    assert robot_of(Drive().urdf(text + fingers), arm_tip="arm_3").hands == ("arm_3",)


@pytest.mark.parametrize("heading", [0.0, 0.6, 1.2])
@pytest.mark.parametrize(("arm", "names"), [("left", "abc"), ("right", "xyz"), ("both", "abcxyz")])
def test_one_arm_of_two_moves_with_what_both_share(heading, arm, names):
    side = np.array([-np.sin(heading), np.cos(heading)]) * 0.3
    torso = link("torso") + joint("lift", "prismatic", "base", "torso", axis=Z, more=LIMIT.format(0, 0.3))
    arms = chain("abc", 5, "torso", (*side, 0.2)) + chain("xyz", 5, "torso", (*-side, 0.2))
    text = Drive(frame=(0.0, 0.0, heading)).urdf(torso + arms)
    robot = robot_of(text, arm=arm)
    assert {n.partition("_")[0] for n in robot.joint_names} == {"lift", *re.findall("abc|xyz", names)}
    assert {h.partition("_")[0] for h in robot.hands} == {*re.findall("abc|xyz", names)}
    if arm != "both":
        assert "the other arm" in next(why for n, why in robot.arm.reasons.items() if n.endswith("joint_0"))


def test_names_of_sides_count_more_than_places():
    swapped = two_armed().replace('"arm_', '"right_')  # 'right' is on the left
    assert robot_of(swapped, arm="left").joint_names[1:] == tuple(f"left_joint_{i}" for i in range(6))


def test_an_arm_of_two_is_refused_where_there_are_not_two():
    for text, count in ((Drive().urdf(chain("arm", 4, "base")), "1"), (Drive().urdf(""), "none")):
        with pytest.raises(ConfigError, match=rf"'left' of two arms: 'robot' has {count}.*--arm-tip LINK"):
            robot_of(text, arm="left")
    with pytest.raises(UnknownName, match="did you mean 'left'"):
        robot_of(two_armed(), arm="lefft")


# --- Robots of makers -------------------------------------------------------------------------------------------------

# How many joints the arms have by what their makers say, torsos included.
MAKERS = {
    "tiago": 8, "tiago_no_hand": 8, "tiago_dual": 15, "tiago_pro": 15, "panda": 7, "ur3": 6, "ur5": 6, "ur10": 6,
    "ur3_gripper": 6, "ur5_gripper": 6, "kinova": 6, "xarm7": 7, "z1": 6, "so100": 5, "so101": 5, "baxter": 14,
    "talos_left_arm": 6, "two_dofs": 2, "double_pendulum": 2, "finger_edu": 3,
    "allegro_left_hand": 16, "allegro_right_hand": 16,
}  # fmt: skip


@pytest.mark.parametrize("name", MAKERS)
def test_arms_are_those_of_their_makers_and_nothing_is_asked(name):
    if name not in extra():
        pytest.skip("example-robot-data is not installed")
    robot: Robot = load(name)
    assert robot.dimensions.arm == MAKERS[name] and not robot.arm.doubts and robot.hands


@pytest.mark.parametrize(("name", "role"), [("camera_arm2_joint", "sensor"), ("arm_camera_joint", "sensor"),
                                           ("camera_joint", "sensor"), ("forearm_joint", "arm")])  # fmt: skip
def test_the_arm_of_a_sensor_is_the_sensors(name, role):
    assert role_named(name)[0] == role


def test_little_is_a_finger_only_beside_other_words_of_hands():
    slides = Drive().urdf(chain("bar", 3, "base") + chain("little", 3, "bar_2", length=0.001))
    assert len(robot_of(slides).joint_names) == 6
    palm = slides.replace("</robot>", link("palm", 0.1) + joint("palm_mount", "fixed", "bar_2", "palm") + "</robot>")
    assert "little_joint_0" in robot_of(palm).arm.locked


def test_a_neck_on_which_much_stands_still_is_asked_about():
    """What the names of a face say for it speaks for the head, and not for what carries it."""
    neck = chain("neck", 2, "base", (0, 0.3, 0.3), 0.1)
    for i in range(5):
        for side in (0.04, -0.04):
            at = (0, side, 0.01 * i)
            face = joint(f"f{i}{side}_lid", "revolute", "neck_1", f"f{i}{side}", p=at, more=LIMIT.format(-1, 1))
            neck += link(f"f{i}{side}", 0.01, 1e-6) + face
    text = Drive().urdf(chain("arm", 5, "base") + neck)
    told = doubted(text)
    names = tuple(re.findall(r"--lock (\S+)", told.fix))
    assert "'neck_joint_0'" in told.message and {"neck_joint_0", "neck_joint_1"} <= {*names}
    assert robot_of(text, lock=names).joint_names == tuple(f"arm_joint_{i}" for i in range(5))


@pytest.mark.parametrize(("limits", "asks"), [((-1.57, 1.57), True), ((0.0, 0.8), False)])
def test_a_last_hinge_that_turns_a_gripper_to_either_side_is_asked_about(limits, asks):
    built = Built()
    end = built.arm("base", 0.0, 4)
    hinge = link("n_gripper", 0.05, 1e-5) + joint(
        "x", "revolute", end, "n_gripper", p=(0, 0, 0.05), axis=Y, more=LIMIT.format(*limits)
    )
    built.pieces.append(hinge)
    if asks:
        assert "--free x for part of the arm" in doubted(built.urdf()).fix
    else:
        assert "x" in robot_of(built.urdf()).arm.locked


def test_every_sign_has_a_weight_for_every_role():
    assert all(len(weights) == len(STILL) and any(weights) for weights in WEIGHTS.values())
