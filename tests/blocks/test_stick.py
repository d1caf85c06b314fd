"""Dry friction that sticks, slides and breaks away, against closed forms, a linear program and a second solver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config
from robots import fixed_arm, mobile_arm
from scipy.optimize import lsq_linear

from mmnn_pin import PD, Feedback, Hold, Line, Loop, Timing, Trajectory, load, load_experiment
from mmnn_pin.errors import ConfigError
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.recording.recording import recorded_robot

AXES = load("two_axis_arm")
LEVEL = np.array([0.4, 0.3])
patient = settings(max_examples=8 if config.DISABLE_JIT else 30, deadline=None)


def moved(robot, tau, steps=200, dt=0.001, position=None, nu=None, method="stick"):
    """Plant after some steps under a held torque."""
    plant = IdealPlant(robot, dt, method)
    plant.start(
        robot.neutral_position() if position is None else position, np.zeros(robot.dimensions.dof) if nu is None else nu
    )
    for _ in range(steps):
        plant.step(np.asarray(tau, float))
        plant.refresh()
    return plant


def hanging(robot):
    """Torque that gravity asks for at rest."""
    return Dynamics(robot).gravity(robot.neutral_position())


@pytest.mark.parametrize("share", [-0.999, -0.5, 0.0, 0.7, 0.999])
def test_a_joint_that_friction_can_hold_does_not_move_at_all(share):
    robot = AXES.with_joint_friction(coulomb=LEVEL)
    plant = moved(robot, hanging(robot) + share * LEVEL)
    assert np.abs(plant.nu).max() < 1e-12 and np.abs(plant.position - robot.neutral_position()).max() < 1e-12
    smooth = moved(robot, hanging(robot) + share * LEVEL, method="implicit_friction")
    assert share == 0 or np.abs(smooth.position - robot.neutral_position()).max() > 1e-5  # it creeps


def test_beyond_the_level_it_accelerates_with_what_is_left():
    robot = AXES.with_joint_friction(coulomb=LEVEL)
    wanted = np.array([0.8, -1.1])  # [rad/s^2]
    M = Dynamics(robot).mass_matrix(robot.neutral_position())
    plant = moved(robot, hanging(robot) + M @ wanted + LEVEL * np.sign(wanted), steps=1)
    np.testing.assert_allclose(plant.nu, 0.001 * wanted, rtol=1e-9)


def test_a_sliding_joint_stops_after_its_stopping_distance():
    """One joint without gravity: v^2 = 2 a d, a = level / inertia; then it stays."""
    robot = load("two_axis_arm").with_joint_friction(coulomb=(0.2, 50.0))  # the second joint holds
    robot.model.gravity.linear[:] = 0.0
    inertia = Dynamics(robot).mass_matrix(robot.neutral_position())[0, 0]
    speed, start = 0.5, robot.neutral_position()
    duration = speed * inertia / 0.2
    steps = int(1.5 * duration / 0.0005)
    plant = moved(robot, np.zeros(2), steps, 0.0005, start, np.array([speed, 0.0]))
    free = plant.position[robot.arm_index] - start[robot.arm_index]
    assert free[0] == pytest.approx(0.5 * speed * duration, rel=5e-3)
    assert np.abs(plant.nu).max() < 1e-12 and abs(free[1]) < 1e-9


def by_least_squares(robot, position, nu, tau, dt):
    """New velocity by a second solver: of all impulses in the box the ones with the least kinetic energy afterwards."""
    d = Dynamics(robot)
    M, F = d.mass_matrix(position), np.diag(robot.viscous) + robot.T.T @ (robot.damping[:, None] * robot.T)
    h = d.coriolis_matrix(position, nu) @ nu + d.gravity(position) + F @ nu
    stiff = M + dt * F
    free = nu + dt * np.linalg.solve(stiff, tau - h)
    rows = np.flatnonzero(robot.coulomb)
    J = robot.T[rows]
    L = np.linalg.cholesky(stiff)
    level = robot.dry_friction(robot.T @ nu)[rows] * dt
    found = lsq_linear(np.linalg.solve(L, J.T), -L.T @ free, (-level, level), tol=1e-15, method="bvls")
    return free + np.linalg.solve(stiff, J.T @ found.x)


@patient
@given(st.integers(0, 10_000), st.booleans(), st.floats(0.0, 3.0))
def test_impulses_are_those_of_a_second_solver(seed, mobile, strength):
    rng = np.random.default_rng(seed)
    robot = (mobile_arm if mobile else fixed_arm)(3, seed)
    level = strength * rng.uniform(0.1, 3.0, 3)
    robot = robot.with_joint_friction(viscous=0.1, coulomb=level, breakaway=1.4, stribeck=0.2)
    position, nu = robot.neutral_position(), rng.normal(0, 0.1, robot.dimensions.dof) * rng.integers(0, 2)
    tau = hanging(robot) + rng.normal(0, 3.0, robot.dimensions.dof)
    plant = moved(robot, tau, 1, 0.001, position, nu)
    expected = by_least_squares(robot, position, nu, tau, 0.001)
    np.testing.assert_allclose(plant.nu, expected, rtol=1e-6, atol=1e-8)


def test_static_friction_holds_more_than_coulomb_friction():
    robot = AXES.with_joint_friction(coulomb=LEVEL, breakaway=1.5, stribeck=0.05)
    np.testing.assert_allclose(robot.dry_friction(np.zeros(robot.dimensions.full))[robot.arm_index], 1.5 * LEVEL)
    np.testing.assert_allclose(robot.dry_friction(np.full(robot.dimensions.full, 9.0))[robot.arm_index], LEVEL)
    tau = hanging(robot) + 1.4 * LEVEL
    assert np.abs(moved(robot, tau).nu).max() < 1e-12
    assert np.abs(moved(AXES.with_joint_friction(coulomb=LEVEL), tau).nu).max() > 1e-2


def test_friction_only_takes_energy():
    robot = mobile_arm(3, 4).with_joint_friction(coulomb=1.0)
    robot.model.gravity.linear[:] = 0.0
    dynamics, nu = Dynamics(robot), np.random.default_rng(0).normal(0, 0.5, robot.dimensions.dof)
    plant, energy = IdealPlant(robot, 0.0005, "stick"), []
    plant.start(robot.neutral_position(), nu)
    for _ in range(100 if config.DISABLE_JIT else 1000):
        energy.append(dynamics.energy(plant.position, plant.nu))
        plant.step(np.zeros(robot.dimensions.dof))
        plant.refresh()
    assert np.diff(energy).max() < 1e-6 * energy[0]


@pytest.mark.compiled
@pytest.mark.parametrize("make", [lambda: AXES, mobile_arm], ids=["axes", "mobile"])
def test_both_engines_stick_alike(make):
    robot = make().with_joint_friction(viscous=0.05, coulomb=0.3, breakaway=1.3)
    duration = 0.05 if config.DISABLE_JIT else 1.0
    nb, n = robot.dimensions.base, robot.dimensions.arm
    loop = Loop(
        robot,
        Trajectory(Line(0.2) if nb else None, tuple(Hold(0.1) for _ in range(n))),
        PD(Feedback(50.0, 0.2)),
        timing=Timing(duration, 0.002, 0.001, None, "stick"),
        check_gains=False,
    )
    runs = [replace(loop, engine=engine).run() for engine in ("ordinary", "compiled")]
    assert [run.outcome.status for run in runs] == ["completed"] * 2
    for name in runs[0].names:
        np.testing.assert_allclose(runs[0][name], runs[1][name], rtol=1e-7, atol=1e-8, err_msg=name)


def test_an_experiment_has_gears_that_stick_and_its_recording_tells_them():
    settings = ["friction.coulomb=0.8", "friction.breakaway=1.2", 'time.integrator="stick"', "time.duration=0.02"]
    experiment = load_experiment("chapter4", settings)
    robot = experiment.load_robot()
    np.testing.assert_allclose(robot.coulomb[robot.arm_index], 0.8)
    run = experiment.loop(robot, experiment.controller("pd")).run()
    again = recorded_robot(run)
    for name in ("damping", "coulomb", "viscous", "dry"):
        np.testing.assert_array_equal(getattr(again, name), getattr(robot, name))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"coulomb": -1.0}, "friction.coulomb"),
        ({"viscous": (1.0, 2.0, 3.0)}, "friction.viscous"),
        ({"breakaway": 0.5}, "friction.breakaway"),
        ({"stribeck": 0.0}, "friction.stribeck"),
    ],
)
def test_bad_friction_is_refused(arguments, text):
    with pytest.raises(ConfigError, match=text):
        AXES.with_joint_friction(**arguments)
