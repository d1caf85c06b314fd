"""The contest's plant: its step decides no error; and the study that repeats the contest on a plant of its own."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from test_sensing import measured

from mmnn_pin import load
from mmnn_pin.lab.experiments.cases import chosen_cases
from mmnn_pin.loop.before_run import Start
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robot import carrying
from mmnn_pin.plant.contact.plant import SLIPPING
from mmnn_pin.sensing import Sensor
from research.contest.settings import load_contest
from research.contest.task import tasks_of
from research.studies.contest_plant.__main__ import CHANGES, published
from research.studies.contest_plant.drive import Changes, errors_of, follow, new_stepper, rms, unexplained, world_of
from research.studies.contest_plant.plant import (
    LUGRE,
    NU,
    POSE,
    SMOOTH,
    STATES,
    STEP,
    STICK,
    TURNED,
    Q,
    advance,
    equations,
    inverse,
    read,
    to_motors,
)
from research.studies.contest_plant.sensors import Sensors

SHORT = ("time.duration=3.0", "windows=[[0.0, 1.0], [2.0, 3.0]]")
numbers = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6)


def task_named(name, *overrides):
    return tasks_of(chosen_cases(load_contest("contest", overrides), [name]), ("pd",))[0]


TASKS = ["friction", "lag", "late1", "late3", "drop", "arm7", "eight", "chapter4", "rig", "tiago", "velocity", "wheels"]


@pytest.mark.parametrize("name", TASKS)
def test_a_shorter_step_of_the_plant_changes_no_error(name):
    """Half of it changes the oracle's errors with exact sensors by 2 um or urad, and 5 %, at most."""
    if name == "wheels":
        pytest.importorskip("mujoco")
    task = task_named(name)
    found = []
    for share in (1.0, 0.5):
        loop = task.training(task.controller("computed_torque"), 1)
        timing = msgspec.structs.replace(loop.timing, duration=3.0, plant_step=share * loop.timing.plant_step)
        floor = msgspec.structs.replace(loop.contact, step=share * loop.contact.step)
        run = replace(loop, timing=timing, contact=floor, sensor=Sensor(), disturbances=()).run()
        late = run.time > 2.0
        found.append(np.sqrt((run["true_e"][late] ** 2).mean(axis=0)))
        if "true_pose_error" in run:
            found[-1] = np.append(found[-1], np.sqrt((run["true_pose_error"][late][:, :2] ** 2).sum(axis=1).mean()))
    assert (np.abs(found[0] - found[1]) < 2e-6 + 0.05 * found[1]).all()


def test_on_the_held_out_motion_wheels_slip_and_the_robot_goes_on():
    pytest.importorskip("mujoco")
    task = task_named("wheels")
    loop = task.held_out_loop(task.controller("computed_torque"), 1, "wide", True)
    run = replace(loop, timing=msgspec.structs.replace(loop.timing, duration=4.0)).run()
    assert run.outcome.status == "completed"
    assert run["slip"][run.time > 1.0].max() > SLIPPING
    assert np.abs(run["true_pose_error"][-1][:2]).max() < 0.03 * 1.4 / 3.0  # a velocity of 1.4 m/s by radii 3 % off, kx


@settings(max_examples=50, deadline=None)
@given(numbers, st.sampled_from([0.0, 3.0]))
def test_the_equations_are_those_of_pinocchio(values, mass):
    nu, q = np.array(values[:4]), np.array(values[4:])
    robot = load("platform_arm")
    robot = carrying(robot, mass, "arm_2_joint", (0.4, 0.0, 0.04)) if mass else robot
    position, _ = Start().state(robot, np.concatenate((np.zeros(7), q, np.zeros(4))))
    M, bias, theirs = np.zeros((4, 4)), np.zeros(4), Dynamics(robot)
    equations(read(), mass, 0.4, nu, q, M, bias)
    assert np.allclose(M, theirs.mass_matrix(position), atol=1e-11)
    assert np.allclose(bias, theirs.psi(position, nu, nu, np.zeros(4)), atol=1e-10)


def test_a_motion_is_that_of_an_adaptive_integrator():
    """Against DOP853 on the inverse dynamics, a held command, smooth friction."""
    world = world_of(task_named("eight"), Changes())
    body, command = read(), np.array([4.0, 6.0, 3.0, -2.0])
    state = np.zeros(STATES)
    advance(body, world, state, command, 0.0, 5000, STEP)
    b, r = body.wheel[4], body.wheel[3]
    force = np.array([command[:2].sum() / r, (command[1] - command[0]) * b / r, *command[2:]])

    def flow(t, y):
        nu, q = y[3:7], y[7:]
        M = np.array([inverse(body, world, 0.0, nu, e, q) for e in np.eye(4)]) - inverse(
            body, world, 0.0, nu, np.zeros(4), q
        )
        nudot = np.linalg.solve(M.T, force - inverse(body, world, 0.0, nu, np.zeros(4), q))
        return np.concatenate(([nu[0] * np.cos(y[2]), nu[0] * np.sin(y[2]), nu[1]], nudot, nu[2:]))

    exact = solve_ivp(flow, (0.0, 5000 * STEP), np.zeros(9), "DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
    assert np.allclose(state[: len(exact)], exact, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("law", [STICK, LUGRE])
def test_a_joint_holds_below_its_friction_and_slides_above(law):
    world = world_of(task_named("eight"), Changes())._replace(law=law)
    for torque, moves in ((0.4, False), (0.8, True)):
        state = np.zeros(STATES)
        advance(read(), world, state, np.array([0.0, 0.0, 0.0, torque]), 0.0, 10_000, STEP)
        assert (abs(state[Q + 1]) > 0.1) == moves


def test_a_wheel_that_resists_stops_the_base_for_good():
    world = world_of(task_named("eight"), Changes(rolling=0.8))
    state = np.zeros(STATES)
    state[NU] = 0.1
    advance(read(), world, state, np.zeros(4), 0.0, 20_000, STEP)
    assert state[NU] == pytest.approx(0.0, abs=1e-9)
    assert state[POSE] > 0.01


@pytest.mark.parametrize("gain", [0.97, (0.5, 0.7, 1.1, 0.9)])
def test_weak_motors_are_motors_that_are_asked_for_less(gain):
    world, command = world_of(task_named("lag"), Changes()), np.array([4.0, 6.0, 3.0, -2.0])
    weak, plain = np.zeros((2, STATES))
    advance(read(), world._replace(gain=gain * np.ones(4)), weak, command, 0.0, 1000, STEP)
    advance(read(), world, plain, gain * command, 0.0, 1000, STEP)
    assert np.array_equal(weak, plain)
    assert plain[POSE] > 1e-3


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0.0, 0.0015, 0.02]))
def test_encoders_read_as_those_of_the_package(seed, step):
    """Along any motion, whose wheels turn as the base rolls."""
    task = task_named("encoders", f"cases.encoders.set.sensor.resolution={step}")
    body, h, nu = read(), task.experiment.time.control_period, np.random.default_rng(seed).normal(size=(50, 4))
    states = np.zeros((50, STATES))
    states[:, NU : NU + 4] = nu
    states[:, TURNED : TURNED + 2] = h * np.cumsum(nu, axis=0) @ to_motors(body)[:2].T
    states[:, Q : Q + 2] = h * np.cumsum(nu[:, 2:], axis=0)
    sensors = Sensors.of(task, body, 1.0, np.random.default_rng(0))
    ours = np.array([sensors.read(state) for state in states])
    position = np.tile(task.robot.neutral_position(), (50, 1))
    for wheel, j in zip(task.robot.base.wheels, (0, 1), strict=True):
        position[:, task.robot.position_names.index(wheel.joint)] = states[:, TURNED + j]
    position[:, task.robot.arm_index] = states[:, Q : Q + 2]
    theirs = measured(task.experiment.sensor, position, nu, task.robot, h)
    assert np.allclose(ours[:, 3:], np.hstack([theirs[name] for name in ("velocity", "q", "qdot")]), atol=1e-9)


def test_what_motors_cannot_give_is_no_lack_of_knowledge():
    """The true model explains everything, also where Psi is beyond the motors (payload on the tight eight)."""
    task = task_named("eight")
    model = task.robot.model.copy()
    model.effortLimit = 0.2 * model.effortLimit
    task, controller = replace(task, robot=replace(task.robot, model=model)), task.controller("computed_torque")
    known, world = task.held_out["tight"], world_of(task, Changes())
    assert unexplained(task, controller, 1, None, read(), world, known) < 1e-6
    state = new_stepper(task, controller, 1).snapshot()
    assert unexplained(task, task.controller("pd"), 1, state, read(), world, known) > 0.1


@pytest.mark.parametrize("name", ["eight", "encoders", "observed", "wheels"])
def test_on_it_pd_errs_as_on_the_packages_plant(name):
    """PD's errors hardly depend on the noise, which is drawn otherwise, and no wheel of it slips."""
    task = task_named(name)
    controller = task.controller("pd")
    path = task.experiment.trajectory_of(task.robot)
    rng, world = np.random.default_rng(0), world_of(task, Changes())
    body = read(radii=task.experiment.radii)
    run = follow(new_stepper(task, controller, 1), task, body, world, path, 6.0, rng, False, 1.0)
    loop = task.training(controller, 1)
    theirs = replace(loop, timing=msgspec.structs.replace(loop.timing, duration=6.0), plant="ideal").run()
    late = theirs.time >= 2.0
    base = np.sqrt((theirs["true_pose_error"][late][:, :2] ** 2).sum(axis=1).mean())
    arm = np.sqrt((theirs["true_e"][late] ** 2).mean())
    assert rms(run, 2.0, 6.0) == pytest.approx([1e3 * base, 1e3 * arm], rel=0.01)


def test_what_is_published_is_read():
    assert published("eight", "pd").base > published("eight", "computed_torque").base > 0.0


def test_changes_of_the_robot_are_felt():
    task = task_named("eight", *SHORT)
    plain = errors_of(task, "pd", CHANGES["contest"], 1)
    for name in ("masses", "lengths", "rolling"):
        assert errors_of(task, "pd", CHANGES[name], 1).base != pytest.approx(plain.base, rel=1e-3)
    assert world_of(task, CHANGES["contest"]).law == SMOOTH
