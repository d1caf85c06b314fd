"""Which joints are the arm: mimic joints follow through T, heads and fingers stand still, what is said counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from drives import LIMIT, Drive, joint, link, moving, robot_of
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config
from robots import feedback

from mmnn_pin import PD, Circle, Loop, Sine, Timing, Trajectory
from mmnn_pin.errors import ConfigError, RobotError, UnknownName
from mmnn_pin.loop.before_run import Start
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.inspection import NamedState


def chain(name: str, count: int, parent: str, p=(0, 0, 0.3), length=0.3, more="") -> str:
    text = ""
    for i in range(count):
        limit = LIMIT.format(-2, 2)
        text += link(f"{name}_{i}") + joint(
            f"{name}_joint_{i}", "revolute", parent, f"{name}_{i}", p=p if i == 0 else (0, 0, length), more=limit + more
        )
        parent = f"{name}_{i}"
    return text


def mimic(master: str, multiplier: float = 1.0, offset: float = 0.0) -> str:
    return f'<mimic joint="{master}" multiplier="{multiplier!r}" offset="{offset!r}"/>'


def finger(name: str, side: float, more: str = "") -> str:
    limit = LIMIT.format(0.01, 0.05)
    return link(name, 0.05, 1e-5) + joint(
        f"{name}_joint", "prismatic", "arm_5", name, p=(0, side, 0.1), axis=(0, side, 0), more=limit + more
    )


def two_armed(more: str = "") -> str:
    head = chain("head", 2, "torso", (0.05, 0, 0.3), 0.1)
    torso = link("torso") + joint("lift", "prismatic", "base", "torso", axis=(0, 0, 1), more=LIMIT.format(0, 0.3))
    arms = chain("arm", 6, "torso", (0, 0.2, 0.2)) + chain("left", 6, "torso", (0, -0.2, 0.2))
    return Drive().urdf(torso + head + arms + finger("a", 1.0) + finger("b", -1.0) + more)


def test_heads_and_fingers_stand_still_and_second_arms_move():
    robot = robot_of(two_armed())
    assert set(robot.arm.locked) == {"head_joint_0", "head_joint_1", "a_joint", "b_joint"}
    assert len(robot.joint_names) == 13 and "lift" in robot.joint_names
    note = next(f for f in robot.findings if f.code == "arm-locked")
    assert "head_joint_0" in note.message and "--free" in note.fix
    rest = dict(zip(robot.position_names, robot.neutral_position(), strict=True))
    assert rest["a_joint"] == 0.01  # 0 clipped into its limits


def test_what_a_following_finger_carries_stands_still_too():
    tip = link("tip", 0.01, 1e-6) + joint("tip_joint", "revolute", "b", "tip", p=(0, 0, 0.05), more=LIMIT.format(-1, 1))
    follows = finger("b", -1.0, '<mimic joint="a_joint"/>')
    torso = link("torso") + joint("lift", "prismatic", "base", "torso", axis=(0, 0, 1), more=LIMIT.format(0, 0.3))
    text = torso + chain("arm", 6, "torso", (0, 0.2, 0.2)) + finger("a", 1.0) + follows + tip
    robot = robot_of(Drive().urdf(text), lock=("tip_joint",))  # it is asked about
    assert robot.joint_names == ("lift", *(f"arm_joint_{i}" for i in range(6)))


def test_what_the_user_says_counts_more():
    assert not robot_of(two_armed(), free=("all",)).arm.locked
    assert set(robot_of(two_armed(), free=("a_joint", "b_joint")).arm.locked) == {"head_joint_0", "head_joint_1"}
    robot = robot_of(two_armed(), lock=("lift=0.2", "arm_joint_0"))
    rest = dict(zip(robot.position_names, robot.neutral_position(), strict=True))
    assert rest["lift"] == 0.2 and {"lift", "arm_joint_0"} <= set(robot.arm.locked)
    robot = robot_of(two_armed(), arm_tip="left_5")
    assert robot.joint_names == ("lift", *(f"left_joint_{i}" for i in range(6)))
    assert "tip" in robot.arm.reasons["arm_joint_0"]


def test_the_map_knows_only_what_moves_and_the_model_feels_where_locks_are():
    heights = []
    for at in (0.0, 0.3):
        robot = robot_of(two_armed(), lock=(f"lift={at}",))
        assert np.abs(robot.A @ robot.T).max() < 1e-12
        assert np.linalg.matrix_rank(robot.A) == len(robot.A) == robot.model.nv - robot.dimensions.dof
        data = moving(robot, robot.neutral_position(), np.zeros(robot.dimensions.dof))
        heights.append(pin.centerOfMass(robot.model, data, robot.configuration(robot.neutral_position()))[2])
    assert heights[1] > heights[0] + 0.1


@pytest.mark.parametrize(("said", "error", "words"), [
    ({"lock": ("lift=0.4",)}, ConfigError, r"within \[0, 0.3\]"),
    ({"lock": ("lift=high",)}, ConfigError, "no position"),
    ({"lock": ("lift=nan",)}, ConfigError, "no position"),
    ({"lock": ("left",)}, ConfigError, "part of the base"),
    ({"lock": ("lifft",)}, UnknownName, "did you mean 'lift'"),
    ({"free": ("heat_joint_0",)}, UnknownName, "did you mean 'head_joint_0'"),
    ({"arm_tip": "left_6"}, UnknownName, "did you mean 'left_5'"),
    ({"arm_tip": "base"}, ConfigError, "no joint leads"),
])  # fmt: skip
def test_what_cannot_be_is_refused(said, error, words):
    with pytest.raises(error, match=words):
        robot_of(two_armed(), **said)


# --- Mimic joints -----------------------------------------------------------------------------------------------------


def slaves(multiplier: float, offset: float) -> str:
    more = link("slave", 0.4) + joint("follow", "revolute", "arm_1", "slave", p=(0.1, 0, 0.2),
                                      more=LIMIT.format(-9, 9) + mimic("arm_joint_1", multiplier, offset))  # fmt: skip
    more += link("second", 0.3) + joint("chained", "revolute", "slave", "second", p=(0, 0, 0.2),
                                        more=LIMIT.format(-9, 9) + mimic("follow", 0.5, 0.1))  # fmt: skip
    return Drive().urdf(chain("arm", 3, "base") + more)


@settings(max_examples=20, deadline=None)
@given(multiplier=st.floats(-2, 2), offset=st.floats(-1, 1), q=st.floats(-1, 1))
def test_slaves_follow_their_masters_at_rest_in_motion_and_in_states_by_name(multiplier, offset, q):
    robot = robot_of(slaves(multiplier, offset))
    assert robot.joint_names == ("arm_joint_0", "arm_joint_1", "arm_joint_2")
    position, _ = NamedState(joints={"arm_joint_1": q}).of(robot)
    at = dict(zip(robot.position_names, position, strict=True))
    assert at["follow"] == pytest.approx(multiplier * q + offset)
    assert at["chained"] == pytest.approx(0.5 * (multiplier * q + offset) + 0.1)
    nu = np.zeros(robot.dimensions.dof)
    nu[robot.velocity_names.index("arm_joint_1")] = 1.0
    rates = dict(zip(robot.full_velocity_names, robot.T @ nu, strict=True))
    assert rates["follow"] == pytest.approx(multiplier) and rates["chained"] == pytest.approx(0.5 * multiplier)
    assert np.abs(robot.A @ robot.T).max() < 1e-12
    assert np.linalg.matrix_rank(robot.A) == robot.model.nv - robot.dimensions.dof


def test_slaves_weigh_on_their_master_as_in_the_energy_of_the_motion():
    robot = robot_of(slaves(-1.5, 0.3))
    position, nu = robot.neutral_position(), np.random.default_rng(0).normal(size=robot.dimensions.dof)
    energy = pin.computeKineticEnergy(
        robot.model, robot.model.createData(), robot.configuration(position), robot.T @ nu
    )
    assert nu @ Dynamics(robot).mass_matrix(position) @ nu / 2 == pytest.approx(energy)


def test_the_slaves_of_a_locked_master_stand_where_it_puts_them():
    robot = robot_of(slaves(2.0, 0.3), lock=("arm_joint_1=0.5",))
    assert robot.arm.locked == pytest.approx({"arm_joint_1": 0.5, "follow": 1.3, "chained": 0.75})
    assert not robot.arm.slaves and np.abs(robot.A @ robot.T).max() < 1e-12


@pytest.mark.parametrize("master", ["ghost", "follow", "chained"])
def test_slaves_of_ghosts_and_circles_are_refused(master):
    with pytest.raises(RobotError):
        robot_of(slaves(1.0, 0.0).replace('<mimic joint="arm_joint_1"', f'<mimic joint="{master}"'))


def test_with_masses_and_friction_keep_what_is_locked():
    robot = robot_of(two_armed(), lock=("lift=0.2",)).with_masses(1.5).with_friction(1.0)
    assert robot.neutral_position()[robot.position_names.index("lift")] == 0.2
    assert robot.arm.locked["lift"] == 0.2


@pytest.mark.parametrize("text", [slaves(-1.5, 0.3), two_armed()], ids=["slaves", "two_armed"])
def test_compiled_and_ordinary_loops_agree_on_slaves_and_locks(text):
    robot = robot_of(text, lock=("arm_joint_0=0.4",))
    arm = tuple(Sine(0.1, 2.0, phase=0.4 * i) for i in range(robot.dimensions.arm))
    loop = Loop(
        robot,
        Trajectory(Circle(1.0, 0.4, ramp=0.5), arm),
        PD(feedback(robot, 0.002)),
        timing=Timing(duration=0.01 if config.DISABLE_JIT else 0.2, control_period=0.002, plant_step=0.001),
        start=Start(joint_offset=0.04),
    )
    ordinary, compiled = (replace(loop, engine=engine).run() for engine in ("ordinary", "compiled"))
    assert ordinary.outcome.status == "completed", ordinary.outcome.message
    for name in ordinary.names:
        np.testing.assert_allclose(compiled[name], ordinary[name], atol=1e-8, err_msg=name)
