"""The ideal plant: its order, its energy, and an independent integration of the model worked out by hand."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from builders import step_feedback
from closed_form import Planar
from numba import config
from scipy.integrate import solve_ivp

from mmnn_pin.errors import UnknownName
from mmnn_pin.model import Robot, load
from mmnn_pin.model.base.differential import kanayama
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.plant.integrators import METHODS, ORDER

VISCOUS = np.array([30.0, 5.0, 0.5, 0.7])
ROBOT = load("platform_arm").with_friction(VISCOUS)
HAND = Planar()
POSE, JOINTS = slice(0, 3), ROBOT.arm_index  # in a position
START = np.zeros(7)
START[POSE], START[JOINTS] = (0.1, -0.2, 0.3), (0.4, -0.9)
NU = np.array([0.5, 1.5, -3.0, 5.0])
NEAR, NEAR_NU = np.zeros(7), np.array([0.2, 0.3, 1.0, -0.3])  # near the reference of `tracking`
NEAR[POSE], NEAR[JOINTS] = (-0.01, 0.01, 0.05), (0.02, 0.78)
TAU = np.array([40.0, -6.0, 5.0, -3.0])
GAINS = np.array([500.0, 500.0, 30.0, 30.0])
FEEDBACK_TIME = 0.02 if config.DISABLE_JIT else 0.2  # [s]
HELD_TIME = 0.16  # [s]


# --- The same motion without this package: x, y, phi, q1, q2, nu, work ------------------------------------------------


def by_hand(torque, duration: float, start: np.ndarray = START, nu: np.ndarray = NU) -> np.ndarray:
    """(10,) end of the motion: pose, joints, nu and work, by DOP853 on the model worked out by hand."""

    def derivative(t: float, y: np.ndarray) -> np.ndarray:
        pose, q, nu = y[:3], y[3:5], y[5:9]
        tau = torque(t, pose, q, nu)
        turning = [nu[0] * np.cos(pose[2]), nu[0] * np.sin(pose[2]), nu[1]]
        power = nu @ (tau - VISCOUS * nu)
        return np.concatenate((turning, nu[2:], HAND.acceleration(q, nu, tau, VISCOUS), [power]))

    y = np.concatenate((start[POSE], start[JOINTS], nu, [0.0]))
    return solve_ivp(derivative, (0.0, duration), y, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]


def held(t: float, pose: np.ndarray, q: np.ndarray, nu: np.ndarray) -> np.ndarray:
    return TAU


def tracking(t: float, pose: np.ndarray, q: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """Kanayama's law and PD on a line at 0.3 m/s while the arm swings, written out once more."""
    vr, kx, ky, kth, K = 0.3, 10.0, 64.0, 16.0, 7.0
    dx, dy, phi = vr * t - pose[0], -pose[1], pose[2]
    ex, ey = np.cos(phi) * dx + np.sin(phi) * dy, np.cos(phi) * dy - np.sin(phi) * dx
    alpha = [vr * np.cos(-phi) + kx * ex, vr * (ky * ey + kth * np.sin(-phi))]
    q_ref = np.array([0.8 * np.sin(1.5 * t), 0.8])
    qdot_ref = np.array([1.2 * np.cos(1.5 * t), 0.0])
    return GAINS * (np.concatenate((alpha, qdot_ref + K * (q_ref - q))) - nu)


def swinging(t: float, pose: np.ndarray, q: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """A gentle feedback on everything, and on time."""
    return np.array([90 * np.sin(40 * t), 20 * np.cos(30 * t) * q[0], 5 * np.sin(50 * t), -3 * q[1]]) - 2 * nu + pose[2]


def ends(plant: IdealPlant) -> np.ndarray:
    """The plant's state as `by_hand` gives it."""
    return np.concatenate((plant.position[POSE], plant.position[JOINTS], plant.nu, plant.y[-1:]))


def run_held(dt: float, method: str, duration: float = HELD_TIME, robot: Robot = ROBOT) -> IdealPlant:
    plant = IdealPlant(robot, dt, method)
    plant.start(START, NU)
    for _ in range(round(duration / dt)):
        plant.step(TAU)
        plant.refresh()
    return plant


def run_feedback(dt: float, torque, duration: float, start: np.ndarray = START, nu: np.ndarray = NU) -> IdealPlant:
    plant = IdealPlant(ROBOT, dt)
    plant.start(start, nu)
    for k in range(round(duration / dt)):
        step_feedback(plant, k * dt, lambda t, position, nu: torque(t, position[POSE], position[JOINTS], nu))
    return plant


def measured_order(errors: list[float]) -> list[float]:
    return [float(np.log2(coarse / fine)) for coarse, fine in pairwise(errors)]


# --- Order ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("method", "dts"), [
    ("rk4", (0.02, 0.01, 0.005)),
    ("implicit_friction", (0.004, 0.002, 0.001)),
    ("semi_implicit_euler", (0.002, 0.001, 0.0005)),
])  # fmt: skip
def test_order_of_the_integrators_under_a_held_torque(method, dts):
    exact = by_hand(held, HELD_TIME)
    errors = [float(np.abs(ends(run_held(dt, method)) - exact).max()) for dt in dts]
    assert measured_order(errors) == pytest.approx([ORDER[method]] * 2, abs=0.25)
    assert errors[-1] > 1e-10  # still the method's error, not rounding


@pytest.mark.parametrize("part", [slice(0, 3), slice(3, 5), slice(5, 9), slice(9, 10)], ids=["pose", "q", "nu", "work"])
def test_order_holds_for_each_part_of_the_state(part):
    exact = by_hand(held, HELD_TIME)[part]
    errors = [float(np.abs(ends(run_held(dt, "rk4"))[part] - exact).max()) for dt in (0.01, 0.005)]
    assert measured_order(errors) == pytest.approx([4], abs=0.4)


def test_order_under_continuous_feedback_that_depends_on_time():
    exact = by_hand(swinging, 0.08)
    errors = [float(np.abs(ends(run_feedback(dt, swinging, 0.08)) - exact).max()) for dt in (0.008, 0.004, 0.002)]
    assert measured_order(errors) == pytest.approx([4, 4], abs=0.3)


def test_semi_implicit_euler_moves_with_the_new_velocity():
    plant = IdealPlant(ROBOT, 0.002, "semi_implicit_euler")
    plant.start(START, NU)
    plant.step(TAU)
    np.testing.assert_allclose(plant.nu, NU + 0.002 * Dynamics(ROBOT).acceleration(START, NU, TAU), rtol=1e-12)
    np.testing.assert_allclose((plant.position - START)[3:], 0.002 * (ROBOT.T @ plant.nu)[3:], rtol=1e-9)
    assert plant.position[2] - START[2] == pytest.approx(0.002 * plant.nu[1])
    assert np.abs(plant.nu - NU).min() > 1e-3


# --- The independent integration --------------------------------------------------------------------------------------


def test_continuous_feedback_at_a_tenth_of_a_millisecond_agrees_with_dop853():
    end = ends(run_feedback(1e-4, tracking, FEEDBACK_TIME, NEAR, NEAR_NU))
    np.testing.assert_allclose(end, by_hand(tracking, FEEDBACK_TIME, NEAR, NEAR_NU), rtol=0, atol=1e-8)
    start = np.concatenate((NEAR[POSE], NEAR[JOINTS], NEAR_NU, [0.0]))
    assert np.all(np.abs(end - start) > 1e-4)


def test_the_kinematic_law_written_out_here_is_the_packages():
    rng = np.random.default_rng(0)
    pose, q, nu = rng.normal(size=3), rng.normal(size=2), rng.normal(size=4)
    time = 0.7
    dx, dy = 0.3 * time - pose[0], -pose[1]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    error = np.array([c * dx + s * dy, c * dy - s * dx, -pose[2]])
    alpha, alphadot = np.zeros(2), np.zeros(2)
    kanayama(error, np.array([0.3, 0.0]), np.zeros(2), nu[:2], np.array([10.0, 64.0, 16.0]), alpha, alphadot)
    np.testing.assert_allclose(tracking(time, pose, q, nu)[:2], 500 * (alpha - nu[:2]), rtol=1e-12)


def test_wheels_turn_as_far_as_the_robot_drives():
    plant = run_held(0.002, "rk4")
    left, right = (ROBOT.full_velocity_names.index(f"wheel_{side}_joint") for side in ("left", "right"))
    turned = 0.075 * (plant.position[right] - plant.position[left]) / (2 * 0.171)
    assert turned == pytest.approx(plant.position[2] - START[2], abs=1e-12)


# --- Energy -----------------------------------------------------------------------------------------------------------


def residual(plant: IdealPlant) -> float:
    energy = Dynamics(ROBOT).energy
    return energy(plant.position, plant.nu) - energy(START, NU) - plant.y[-1]


def test_energy_balance_closes_at_the_order_of_the_method():
    residuals = [abs(residual(run_held(dt, "rk4"))) for dt in (0.02, 0.01, 0.005)]
    assert all(order > 3.5 for order in measured_order(residuals)), residuals
    assert residuals[-1] < 1e-6 * Dynamics(ROBOT).energy(START, NU)


@pytest.mark.compiled
def test_work_is_that_of_the_torque_less_that_of_friction():
    rubbing, free = run_held(0.001, "rk4"), run_held(0.001, "rk4", robot=ROBOT.with_friction(0.0))
    assert rubbing.y[-1] == pytest.approx(by_hand(held, HELD_TIME)[-1], abs=1e-8)
    # A held torque's work is the torque times the way; the way of v is what the wheels' mean turn says.
    wheels = [free.position[ROBOT.full_velocity_names.index(f"wheel_{side}_joint")] for side in ("left", "right")]
    way = [0.075 * np.mean(wheels), *(free.position - START)[[2, *JOINTS]]]
    assert free.y[-1] == pytest.approx(TAU @ way, abs=1e-7)
    assert free.y[-1] > rubbing.y[-1]


def test_robot_without_torque_or_friction_keeps_its_energy():
    free = ROBOT.with_friction(0.0)
    plant = IdealPlant(free, 0.001)
    plant.start(START, NU)
    before = Dynamics(free).energy(START, NU)
    for _ in range(100):
        plant.step(np.zeros(4))
        plant.refresh()
    assert Dynamics(free).energy(plant.position, plant.nu) == pytest.approx(before, rel=1e-9)
    assert plant.y[-1] == 0.0
    assert not np.allclose(plant.nu, NU, atol=0.01)


def test_start_takes_back_the_work():
    plant = run_held(0.01, "rk4")
    assert plant.y[-1] != 0.0
    plant.start(START, NU)
    assert plant.y[-1] == 0.0 and np.array_equal(plant.position, START) and np.array_equal(plant.nu, NU)


# --- Input ------------------------------------------------------------------------------------------------------------


def test_unknown_integrator_lists_those_there_are():
    with pytest.raises(UnknownName, match="'euler'") as error:
        IdealPlant(ROBOT, 0.001, "euler")
    assert all(name in str(error.value) for name in METHODS)
    assert error.value.key == "time.integrator"
    assert set(METHODS) == set(ORDER)
