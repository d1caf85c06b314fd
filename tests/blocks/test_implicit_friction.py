"""Implicit friction: its equation, its order, and a stiff solver of scipy's on the same motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config
from robots import tiny_arm
from scipy.integrate import solve_ivp

from mmnn_pin import load, load_experiment
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robot import Robot
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.plant.integrators import implicit_euler
from mmnn_pin.recording.metrics import metrics
from mmnn_pin.signals import Array

patient = settings(max_examples=10 if config.DISABLE_JIT else 200, deadline=None)
STIFF = tiny_arm(damping=1.0, coulomb=1.0)  # its last link stops within 4 us, near a standstill within 40 ns
P = STIFF.dimensions.dof


def friction(robot: Robot, nu: Array) -> Array:
    """Friction of joints through T, and on nu, written out once more (p,)."""
    v = robot.T @ nu
    return np.asarray(robot.T.T @ (robot.damping * v + robot.coulomb * np.tanh(v / 0.01)) + robot.viscous * nu)


def pulling(time: float) -> Array:
    """Torque that is held for 5 ms at a time, and turns joints about within 40 ms, (p,)."""
    begun = 0.005 * np.floor(time / 0.005 + 1e-9)
    return np.sin(160.0 * begun + np.arange(P)) * np.array([60.0, 20.0, 9.0, 20.0, 8.0, 5.0, 3.0, 2.0, 1.5])


def by_steps(dt: float, duration: float) -> Array:
    """Position and nu after a pulled motion, by the plant."""
    plant = IdealPlant(STIFF, dt, "implicit_friction")
    plant.start(STIFF.neutral_position(), np.zeros(P))
    for k in range(round(duration / dt)):
        plant.step(pulling(k * dt))
        plant.refresh()
    return plant.y[:-1].copy()


def by_radau(duration: float) -> Array:
    """The same by scipy's Radau and Pinocchio, from one change of the torque to the next."""
    dynamics, nv = Dynamics(STIFF), STIFF.dimensions.full

    def derivative(time: float, y: Array, tau: Array) -> Array:
        nu, phi = y[nv:], y[2]
        rate = STIFF.T @ nu
        rate[:3] = nu[0] * np.cos(phi), nu[0] * np.sin(phi), nu[1]
        return np.concatenate((rate, dynamics.acceleration(y[:nv], nu, tau)))

    y = np.concatenate((STIFF.neutral_position(), np.zeros(P)))
    for k in range(round(duration / 0.005)):
        span, tau = (0.005 * k, 0.005 * (k + 1)), pulling(0.005 * k)
        y = solve_ivp(derivative, span, y, "Radau", rtol=1e-9, atol=1e-11, args=(tau,)).y[:, -1]
    return np.asarray(y)


@pytest.mark.compiled
def test_a_stiff_motion_is_that_of_radau_and_its_error_falls_faster_than_the_step():
    """A link of 4e-6 kg m^2 and a base of 40 kg, stuck, sliding and turned about, which costs a part of the order."""
    exact = by_radau(0.04)
    coarse, fine = (np.abs(by_steps(dt, 0.04) - exact)[:-P].max() for dt in (1e-3, 6.25e-5))
    assert np.abs(exact - np.concatenate((STIFF.neutral_position(), np.zeros(P))))[:-P].max() > 1e-2
    assert coarse < 1e-3 and fine < coarse / 50


@patient
@given(st.integers(0, 2**32 - 1), st.floats(-3, 3), st.floats(-6, -2), st.booleans())
def test_a_step_ends_where_its_equation_holds(seed: int, size: float, step: float, sticks: bool):
    """`M (new - nu) / dt + F(new) = tau - C nu - gravity`, from whatever velocity, under whatever torque."""
    rng, dt = np.random.default_rng(seed), 10.0**step
    plant, dynamics = IdealPlant(STIFF, dt, "implicit_friction"), Dynamics(STIFF)
    position, nu = rng.uniform(-1, 1, STIFF.dimensions.full), 10.0**size * rng.uniform(-1, 1, P)
    still = dynamics.coriolis_matrix(position, nu) @ nu + dynamics.gravity(position)
    tau = still + (0.5 if sticks else 10.0 ** rng.uniform(-2, 3)) * rng.uniform(-1, 1, P)
    plant.start(position, nu)
    implicit_euler(dt, plant.joints, plant.terms, tau, plant.y, plant.trial)
    new = plant.trial[-1 - P : -1]
    M = dynamics.mass_matrix(position)
    lacking = tau - still - friction(STIFF, new) - M @ (new - nu) / dt
    slopes = M / dt + STIFF.T.T @ np.diag(STIFF.damping) @ STIFF.T
    scale = np.abs(M) @ np.abs(new - nu) / dt + np.abs(tau) + np.abs(still) + np.abs(friction(STIFF, new))
    assert (np.abs(np.linalg.solve(slopes, lacking)) < 1e-9 * (1 + np.abs(new).max())).all() or (
        np.abs(lacking) < 1e-9 * scale
    ).all()


@pytest.mark.compiled
@pytest.mark.parametrize("robot", [load("platform_arm"), STIFF], ids=["platform_arm", "stiff"])
@pytest.mark.parametrize("controller", ["two_layer", "pd", "computed_torque"])
def test_no_number_of_track_moves_by_a_tenth_when_the_step_is_halved(robot: Robot, controller: str):
    """Those of the oracle neither, which are the smallest."""
    numbers = []
    for step in (load_experiment("track").time.plant_step, 0.00025):
        experiment = load_experiment("track", ["time.duration=3.0", f"time.plant_step={step}"])
        run = experiment.loop(robot, experiment.controller(controller, robot=robot)).run()
        numbers.append(metrics(run, [(0.0, 3.0)]))
    keys = [key for key in numbers[0] if key != "energy_residual"]
    assert len(keys) > 18
    coarse, fine = (np.array([one[key] for key in keys]) for one in numbers)
    np.testing.assert_allclose(coarse, fine, rtol=0.1, err_msg=str(keys))


@pytest.mark.parametrize("coulomb", [0.0, 1.0])
def test_implicit_friction_is_stable_where_explicit_is_not(coulomb):
    robot, h = tiny_arm(damping=1.0, coulomb=coulomb), 0.001
    tau = np.zeros(robot.dimensions.dof)
    nu = np.full(robot.dimensions.dof, 0.5)
    ends = {}
    for method in ("implicit_friction", "semi_implicit_euler"):
        plant = IdealPlant(robot, h, method)
        plant.start(robot.neutral_position(), nu)
        with np.errstate(all="ignore"):
            for _ in range(30):
                plant.step(tau)
                plant.refresh()
        ends[method] = plant.nu.copy()
    assert np.abs(ends["implicit_friction"]).max() < 3
    assert not np.abs(ends["semi_implicit_euler"]).max() < 1e3


def test_implicit_friction_settles_where_force_and_friction_balance():
    robot = replace(tiny_arm(damping=1.0), coulomb=np.zeros(12))
    model = robot.model.copy()
    model.gravity.linear = np.zeros(3)
    plant = IdealPlant(replace(robot, model=model), 0.001, "implicit_friction")
    plant.start(robot.neutral_position(), np.zeros(9))
    tau = np.zeros(9)
    tau[8] = 0.25
    for _ in range(60):
        plant.step(tau)
        plant.refresh()
    assert plant.nu[8] == pytest.approx(0.25, abs=2e-3)
    balance = Dynamics(plant.robot).energy(plant.position, plant.nu) - plant.y[-1]
    assert abs(balance) < 0.05 * 0.25 * 0.25 * 0.06
