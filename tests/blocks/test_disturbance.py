"""Disturbances: pushes against momentum and energy, a payload against a robot built with it, faults one by one.

Both engines are compared in test_hardware.py.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from builders import THESIS
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config
from robots import fixed_arm, mobile_arm, robot_of
from test_safety import heavy_arm

from mmnn_pin import PD, Feedback, Hold, Line, Loop, Sine, Timing, TorqueController, Trajectory, load, load_experiment
from mmnn_pin.disturbance import (
    BlockedJoint,
    CommandFault,
    DeadMotor,
    Forces,
    FrozenEncoder,
    Messages,
    Payload,
    Push,
    pushes,
)
from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.loop.before_run import Start
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robot import carrying
from mmnn_pin.sensing import Sensor

ROBOT = load("platform_arm")
LEFT, RIGHT = (wheel.joint for wheel in ROBOT.base.wheels)
H, DT = 0.002, 0.001
REACH = Trajectory(Line(0.3), (Sine(0.5, 2.0), Hold(0.4)))
patient = settings(max_examples=10 if config.DISABLE_JIT else 50, deadline=None)


class Given(TorqueController):
    """A torque that does not care."""

    def __init__(self, torque):
        self.torque = np.array(torque, float)

    def step(self, time, reference, measurement, command, state):
        return self.torque.copy()


def loop_of(*events, duration=0.1, robot=ROBOT, trajectory=REACH, controller=None, integrator="rk4", **more):
    controller = controller or PD(Feedback(200.0, 3.0))
    timing = Timing(duration, H, DT, None, integrator)
    start = more.pop("start", Start(moving=True))
    return Loop(robot, trajectory, controller, timing=timing, start=start, disturbances=events, **more)


def run_of(*events, **more):
    return loop_of(*events, **more).run()


# --- Pushes -----------------------------------------------------------------------------------------------------------


def forces(event, duration=0.3, dt=DT, robot=ROBOT):
    """What a push gives in every step of the plant, (steps, p)."""
    effect = pushes((event,), robot, dt, 1, np.random.default_rng(0))
    rows = np.zeros((round(duration / dt), robot.dimensions.dof))
    for n, force in enumerate(rows):
        effect.act(Forces(force), 0, n * dt)
    return rows


times = st.integers(0, 200).map(lambda n: n * DT)


@patient
@given(times, st.integers(1, 100), st.floats(-50, 50), st.sampled_from([DT, 0.0005, 0.002]))
def test_a_step_is_there_from_start_to_end(start, length, force, dt):
    end = start + 2 * length * DT
    got = forces(Push(on="w", force=force, start=start, end=end), dt=dt)[:, 1]
    n = np.arange(got.size) * dt + 0.5 * dt + 1e-9  # a step counts when its middle does
    np.testing.assert_array_equal(got, np.where((n > start) & (n < end), force, 0.0))
    if end <= 0.3:
        assert got.sum() * dt == pytest.approx(force * (end - start), abs=1.01 * abs(force) * dt)


@patient
@given(st.floats(0, 0.29), st.floats(-50, 50), st.sampled_from([DT, 0.0005, 0.002]), st.sampled_from([math.inf, 1e-3]))
def test_an_impulse_is_given_once_whatever_start_step_and_end_are(start, impulse, dt, length):
    got = forces(Push(on="v", shape="impulse", force=impulse, start=start, end=start + length), dt=dt)[:, 0]
    assert got.sum() * dt == pytest.approx(impulse, rel=1e-12, abs=1e-15)
    assert np.count_nonzero(got) == (impulse != 0)
    if impulse:
        n = int(np.flatnonzero(got)[0])
        assert abs(n * dt + 0.5 * dt - start) <= dt + 1e-9


def test_a_sine_begins_with_phase_zero():
    got = forces(Push(on="v", shape="sine", force=3.0, frequency=5.0, start=0.1, end=0.25))[:, 0]
    middle = np.arange(got.size) * DT + 0.5 * DT
    inside = (middle > 0.1) & (middle < 0.25)
    np.testing.assert_allclose(got, np.where(inside, 3.0 * np.sin(2 * np.pi * 5.0 * (middle - 0.1)), 0.0), atol=1e-12)


@pytest.mark.compiled
def test_noise_has_its_deviation_is_held_over_a_period_and_follows_the_seed():
    duration = 0.1 if config.DISABLE_JIT else 2.0
    event = Push(on="w", shape="noise", force=4.0)
    arguments = {"duration": duration, "controller": PD(Feedback(200.0, 3.0))}
    a, b, c = (replace(loop_of(event, **arguments), seed=seed).run() for seed in (1, 1, 2))
    np.testing.assert_array_equal(a["disturbance"], b["disturbance"])
    assert (a["disturbance"][:, 1] != c["disturbance"][:, 1]).all() and not a["disturbance"][:, [0, 2, 3]].any()
    assert np.std(a["disturbance"][:, 1]) == pytest.approx(4.0, rel=0.5 if config.DISABLE_JIT else 0.08)
    two = run_of(event, Push(on="v", shape="noise", force=1.0), **arguments)
    assert abs(np.corrcoef(two["disturbance"][:, 0], two["disturbance"][:, 1])[0, 1]) < 0.5


@pytest.mark.parametrize("shape", ["step", "impulse", "sine", "noise"])
@pytest.mark.parametrize("integrator", ["rk4", "stick"])
def test_pushes_change_momentum_and_energy_by_what_they_are(shape, integrator):
    """A base alone on a line: M dv = f dt; and for a whole robot, work and energy still balance."""
    event = Push(on="v", shape=shape, force=5.0 if shape == "impulse" else 50.0, frequency=20.0, start=0.02, end=0.06)
    still = Trajectory(Line(0.0), (Hold(0.0), Hold(0.0)))
    run = run_of(event, trajectory=still, controller=Given(np.zeros(4)), integrator=integrator, start=Start())
    M = Dynamics(ROBOT).mass_matrix(ROBOT.neutral_position())
    momentum = run["nu"] @ M[0]  # the arm lies along x: it stays there
    given_by = np.concatenate(([0.0], np.cumsum(run["disturbance"][:-1, 0]) * H))
    np.testing.assert_allclose(momentum, given_by, rtol=1e-6, atol=1e-9)
    assert np.abs(run["nu"][-1, 0]) > 1e-3
    busy = run_of(event, Push(on=ROBOT.joint_names[0], force=3.0, shape=shape, start=0.02), integrator=integrator)
    scale = np.abs(busy["energy"] - busy["energy"][0]).max()
    most = 0.02 if integrator == "stick" else 1e-5 if shape == "impulse" else 1e-7
    assert np.abs(busy["energy_residual"]).max() < most * scale


def test_without_pushes_nothing_is_recorded_of_them():
    assert "disturbance" not in run_of().names
    assert not run_of(CommandFault(fault="lost", start=0.09))["disturbance"].any()


# --- A payload --------------------------------------------------------------------------------------------------------


def loaded(text, link, mass, at):
    """A URDF with a link of that mass fixed to another."""
    inertia = f'<inertial><mass value="{mass}"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>'
    place = f'<origin xyz="{" ".join(map(str, at))}" rpy="0 0 0"/>'
    ends = f'<parent link="{link}"/><child link="load"/>'
    grip = f'<joint name="grip" type="fixed">{place}{ends}</joint>'
    return text.replace("</robot>", f'<link name="load">{inertia}</link>{grip}</robot>')


@pytest.mark.parametrize(
    "make", [lambda: mobile_arm(3, 2), lambda: fixed_arm(3, 1), heavy_arm, lambda: ROBOT], ids=range(4)
)
@pytest.mark.parametrize("which", [-1, 0])
def test_a_payload_is_the_robot_whose_urdf_has_it(make, which):
    robot, at, rng = make(), (0.1, -0.05, 0.2), np.random.default_rng(0)
    name = robot.joint_names[which]
    link = re.search(rf'<joint name="{name}".*?<child link="(\w+)"', robot.urdf, re.S)[1]
    built, carried = robot_of(loaded(robot.urdf, link, 2.5, at)), carrying(robot, 2.5, name, at)
    for _ in range(5):
        position, nu = rng.uniform(-1, 1, robot.dimensions.full), rng.normal(size=robot.dimensions.dof)
        one, other = (Dynamics(r) for r in (built, carried))
        np.testing.assert_allclose(one.mass_matrix(position), other.mass_matrix(position), atol=1e-9)
        np.testing.assert_allclose(one.gravity(position), other.gravity(position), atol=1e-9)
        one.refresh(position, nu), other.refresh(position, nu)
        np.testing.assert_allclose(one.h, other.h, atol=1e-9)


def test_after_it_was_picked_up_the_run_is_that_of_the_heavier_robot():
    at, start = (0.3, 0.1, 0.0), 0.04
    run = run_of(Payload(mass=2.0, start=start, at=at))
    k = round(start / H)
    heavy = replace(loop_of(), robot=carrying(ROBOT, 2.0, "", at))
    rest = heavy.run(plant_state=(run["position"][k], run["nu"][k]), first=k)
    light = run_of(duration=0.1)
    for name in ("position", "nu", "torque"):
        np.testing.assert_allclose(run[name][k:], rest[name], atol=1e-9)
        np.testing.assert_allclose(run[name][: k + 1], light[name][: k + 1], atol=1e-9)
    assert np.abs(run["nu"][-1] - light["nu"][-1]).max() > 1e-3
    np.testing.assert_allclose(run["psi"][k:], rest["psi"], atol=1e-8)


@pytest.mark.parametrize("engine", ["compiled", "ordinary"])
def test_once_it_was_put_down_the_run_is_that_of_the_robot_without_it(engine):
    load = Payload(mass=2.0, start=0.02, end=0.06, at=(0.3, 0.1, 0.0))
    run, k = replace(loop_of(load), engine=engine).run(), round(load.end / H)
    rest = loop_of().run(plant_state=(run["position"][k], run["nu"][k]), first=k)
    for name in ("position", "nu", "torque", "psi"):
        np.testing.assert_allclose(run[name][k:], rest[name], atol=1e-8)
    assert np.abs(run["nu"][k] - run_of(duration=0.1)["nu"][k]).max() > 1e-3


@pytest.mark.parametrize("end", [float("inf"), 0.08])
def test_picking_something_up_and_putting_it_down_is_no_error_of_the_energy_balance(end):
    robot = heavy_arm()
    still = Trajectory(None, (Hold(0.3), Hold(0.2)))
    load = Payload(mass=2.0, start=0.05, end=end)
    run = run_of(load, robot=robot, trajectory=still, controller=PD(Feedback(arm=10.0)))
    jumps = np.abs(np.diff(run["energy"]))
    assert (jumps > 1.0).sum() == (1 if end > 1.0 else 2)
    assert np.abs(run["energy_residual"]).max() < 1e-6 * jumps.max()


def test_what_is_put_down_before_it_is_picked_up_is_refused():
    with pytest.raises(ConfigError, match=r"disturbances.end: error: put down at 1 s, picked up at 2 s"):
        Payload(mass=1.0, start=2.0, end=1.0)


def test_a_base_without_an_arm_can_be_loaded_too():
    heavy = carrying(ROBOT, 10.0, "root", (0.0, 0.0, 0.5))
    assert Dynamics(heavy).mass_matrix(ROBOT.neutral_position())[0, 0] == pytest.approx(
        Dynamics(ROBOT).mass_matrix(ROBOT.neutral_position())[0, 0] + 10.0
    )


# --- Joints that fail -------------------------------------------------------------------------------------------------


def test_a_base_with_a_blocked_wheel_pivots_about_it():
    pushing, block = Given([60.0, 0.0, 0.0, 0.0]), BlockedJoint(joint=LEFT, start=0.1)
    run = run_of(block, duration=0.3, controller=pushing, integrator="stick", start=Start())
    blocked = run.time > 0.1 + 2 * H
    wheel = ROBOT.position_names.index(LEFT)
    turned = run["nu"] @ ROBOT.T[wheel]
    assert np.abs(turned[blocked]).max() < 1e-9 and np.abs(turned[~blocked]).max() > 1e-3
    assert np.ptp(run["position"][blocked, wheel]) < 1e-9
    left = ROBOT.base.wheels[0]
    phi = run["pose"][blocked, 2]
    x = run["pose"][blocked, 0] - np.sin(phi) * left.y + np.cos(phi) * left.x
    y = run["pose"][blocked, 1] + np.cos(phi) * left.y + np.sin(phi) * left.x
    assert np.ptp(phi) > 1e-3 and max(np.ptp(x), np.ptp(y)) < 1e-4 * np.ptp(phi) + 1e-6  # it stays where it stands
    free = run_of(duration=0.3, controller=pushing, integrator="stick", start=Start())
    assert abs(free["pose"][-1, 2]) < 1e-2 * np.ptp(phi)
    assert np.abs(run["energy_residual"]).max() < 0.05 * np.abs(run["work"]).max()


def test_a_blocked_joint_stays_and_comes_free_again():
    name = ROBOT.joint_names[0]
    run = run_of(BlockedJoint(joint=name, start=0.02, end=0.06), integrator="stick", controller=PD(THESIS))
    held = (run.time > 0.02 + 2 * H) & (run.time < 0.06 + 1e-9)
    assert np.abs(run["qdot"][held, 0]).max() < 1e-9 and np.abs(run["qdot"][held, 1]).max() > 1e-3
    assert np.abs(run["qdot"][~held, 0]).max() > 0.1 and abs(run["qdot"][-1, 0]) > 0.1


def test_a_dead_motor_gives_nothing_while_it_is_dead():
    run = run_of(DeadMotor(joint=RIGHT, start=0.04, end=0.06))
    dead = (run.time > 0.04 - 1e-9) & (run.time < 0.06 - 1e-9)
    i = ROBOT.actuator_names.index(RIGHT)
    others = [j for j in range(4) if j != i]
    assert not run["applied"][dead, i].any() and run["motor_torque"][dead, i].any()
    np.testing.assert_allclose(run["applied"][~dead], run["motor_torque"][~dead], atol=1e-12)
    np.testing.assert_allclose(run["applied"][:, others], run["motor_torque"][:, others], atol=1e-12)
    assert np.abs(run["nu"][-1] - run_of()["nu"][-1]).max() > 1e-4


def test_a_frozen_encoder_keeps_its_reading_and_its_rate_is_zero():
    run = run_of(FrozenEncoder(joint=ROBOT.joint_names[0], start=0.03, end=0.07))
    frozen = (run.time > 0.03 - 1e-9) & (run.time < 0.07 - 1e-9)
    kept = run["position"][int(np.argmax(frozen)) - 1, ROBOT.arm_index[0]]
    np.testing.assert_array_equal(run["q"][frozen, 0], kept)
    np.testing.assert_array_equal(run["qdot"][frozen, 0], 0.0)
    np.testing.assert_array_equal(run["q"][~frozen], run["position"][~frozen][:, ROBOT.arm_index])
    np.testing.assert_array_equal(run["q"][:, 1], run["position"][:, ROBOT.arm_index[1]])


def test_a_frozen_wheel_encoder_halves_what_the_base_thinks_it_does():
    sensor = Sensor(velocity="difference", pose="odometry")
    run = run_of(FrozenEncoder(joint=LEFT, start=0.05), sensor=sensor)
    late = run.time > 0.06
    right = run["nu"][late] @ ROBOT.T[ROBOT.position_names.index(RIGHT)] * ROBOT.base.wheels[1].radius
    np.testing.assert_allclose(run["velocity"][late, 0], 0.5 * right, rtol=0.05, atol=2e-3)
    with pytest.raises(ConfigError, match=r"disturbances\.0.*nobody reads the encoder"):
        run_of(FrozenEncoder(joint=LEFT, start=0.05))


# --- Messages and commands --------------------------------------------------------------------------------------------


def received(*events, **more):
    """Number of the measurement that the controller has at every sample: the time at which it was the truth."""
    run = run_of(*events, **more)
    at = [int(np.flatnonzero(run["position"][: k + 1, 0] == x)[-1]) for k, x in enumerate(run["pose"][:, 0])]
    return run, np.array(at), np.arange(len(run))


def test_lost_messages_leave_the_last_one():
    _, at, k = received(Messages(fault="lost", start=0.04, end=0.06))
    np.testing.assert_array_equal(at, np.where((k >= 20) & (k < 30), 19, k))


def test_late_messages_are_late_by_as_much_as_they_say():
    _, at, k = received(Messages(fault="late", delay=3, start=0.04, end=0.06))
    inside = (k >= 20) & (k < 30)
    np.testing.assert_array_equal(at, np.where(inside, np.maximum(k - 3, 19), k))


def test_messages_out_of_order_are_dropped_where_a_newer_one_was_there():
    _, at, k = received(Messages(fault="shuffled", delay=3, start=0.04, end=0.06))
    np.testing.assert_array_equal(at, np.where((k >= 20) & (k < 30) & (k % 2 == 1), k - 1, k))


def test_a_spike_is_in_every_tenth_message():
    run = run_of(Messages(fault="spike", size=0.05, start=0.02, end=0.08))
    off = run["pose"][:, 0] - run["position"][:, 0]
    k = np.arange(len(run))
    np.testing.assert_allclose(off, np.where((k >= 10) & (k < 40) & (k % 10 == 0), 0.05, 0.0), atol=1e-12)


@pytest.mark.parametrize("event", [Messages(fault="nan", start=0.04), CommandFault(fault="nan", start=0.04)])
def test_what_is_no_number_ends_an_unsupervised_run_and_is_not_recorded(event):
    run = run_of(event)
    assert run.outcome.status == "diverged" and run.outcome.time == pytest.approx(0.04) and len(run) == 20
    assert all(np.isfinite(run[name]).all() for name in run.names)


def test_lost_commands_leave_the_torque_that_was_there():
    run = run_of(CommandFault(fault="lost", start=0.04, end=0.06))
    k = np.arange(len(run))
    lost = (k >= 20) & (k < 30)
    np.testing.assert_array_equal(run["torque"][lost], np.tile(run["torque"][19], (10, 1)))
    assert (run["torque"][30] != run["torque"][19]).any()


# --- Bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Push(on="v", force=1.0, start=-1.0), r"disturbances\.start.*0 <= start < end"),
        (lambda: Push(on="v", force=1.0, start=2.0, end=1.0), r"disturbances\.start"),
        (lambda: BlockedJoint(joint="a", start=math.nan), r"disturbances\.start"),
        (lambda: FrozenEncoder(joint="a", start=math.inf), r"disturbances\.start"),
        (lambda: Push(on="v", force=math.nan), r"disturbances\.force"),
        (lambda: Push(on="v", force=1e12), r"disturbances\.force"),
        (lambda: Push(on="v", force=1.0, frequency=0.0), r"disturbances\.frequency"),
        (lambda: Payload(mass=0.0), r"disturbances\.mass"),
        (lambda: Payload(mass=math.inf), r"disturbances\.mass"),
        (lambda: Payload(mass=1.0, start=-1.0), r"disturbances\.start"),
        (lambda: Payload(mass=1.0, at=(0.0, math.nan, 0.0)), r"disturbances\.at"),
        (lambda: Messages(fault="late", delay=0), r"disturbances\.delay"),
        (lambda: Messages(fault="late", delay=20_000), r"disturbances\.delay"),
        (lambda: Messages(fault="spike", size=math.inf), r"disturbances\.size"),
    ],
)
def test_numbers_out_of_range_are_refused(make, text):
    with pytest.raises(ConfigError, match=text):
        make()


@pytest.mark.parametrize(
    ("event", "text"),
    [
        (Push(on="elbow", force=1.0), r"disturbances\.1\.on: error: unknown velocity 'elbow'.*there is: v, w"),
        (Payload(mass=1.0, joint="elbow"), r"disturbances\.1\.joint: error: unknown joint 'elbow'"),
        (DeadMotor(joint="elbow"), r"disturbances\.1\.joint.*unknown joint 'elbow'.*wheel_left_joint"),
        (BlockedJoint(joint="elbow"), r"disturbances\.1\.joint"),
        (FrozenEncoder(joint="elbow"), r"disturbances\.1\.joint"),
        (Push(on="v", force=1.0, start=0.01, end=0.0105), r"disturbances\.1\.end.*the plant's step"),
        (BlockedJoint(joint=LEFT), r"time\.integrator.*a blocked joint.*'stick'"),
    ],
)
def test_what_does_not_fit_the_robot_or_the_run_is_refused(event, text):
    with pytest.raises((ConfigError, UnknownName), match=text):
        run_of(CommandFault(fault="lost", start=0.05), event)


@pytest.mark.parametrize("event", ["type='push', on='v', force=1", "type='payload', mass=1", "type='block', joint='a'"])
def test_what_begins_after_the_run_is_refused(event):
    events = f"disturbances=[{{type='commands', fault='lost'}}, {{{event}, start=5.0}}]"
    with pytest.raises(ConfigError, match=r"^--set disturbances\.1\.start.*the run ends at 5 s"):
        load_experiment("chapter4", [events])


def test_a_second_payload_is_refused():
    with pytest.raises(ConfigError, match=r"disturbances\.1: error: a second payload"):
        run_of(Payload(mass=1.0), Payload(mass=2.0))


def test_a_payload_in_the_middle_of_nowhere_is_refused():
    with pytest.raises(ConfigError, match="mass"):
        carrying(ROBOT, 1.0, "", (0.0, math.nan, 0.0))
