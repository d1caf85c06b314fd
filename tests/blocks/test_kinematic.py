"""Kinematic layer: the command, its derivative and the errors, against sympy, homogeneous transforms and motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp  # type: ignore[import-untyped]
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from mmnn_pin.errors import ConfigError
from mmnn_pin.kinematic import Kinematic, body_error, command, wrap
from mmnn_pin.model.base.differential import kanayama
from mmnn_pin.signals import Array, Dimensions, Layout, Measurement, Setpoint, VelocityCommand

THESIS = np.array([10.0, 64.0, 16.0])
VIEWS = (Setpoint, Measurement, VelocityCommand)
patient = settings(deadline=None)  # the first call may compile


def between(low: float, high: float, size: int) -> SearchStrategy[Array]:
    return st.tuples(*[st.floats(low, high)] * size).map(np.array)


errors = st.tuples(between(-1, 1, 2), between(-3.1, 3.1, 1)).map(np.concatenate)
poses = st.tuples(between(-3, 3, 2), between(-20, 20, 1)).map(np.concatenate)
gains = between(0.1, 20, 3)
# The speed keeps its sign over the short times of the differences below: |vr| has a kink at 0.
speeds = (st.floats(0.05, 2) | st.floats(-2, -0.05)).flatmap(
    lambda vr: st.floats(-2, 2).map(lambda wr: np.array([vr, wr]))
)
velocities = between(-2, 2, 2)


def law(error: Array, v_ref: Array, a_ref: Array, velocity: Array, gains: Array) -> tuple[Array, Array]:
    alpha, alphadot = np.full(2, np.nan), np.full(2, np.nan)
    kanayama(error, v_ref, a_ref, velocity, gains, alpha, alphadot)
    return alpha, alphadot


def error_between(pose_ref: Array, pose: Array) -> Array:
    error = np.full(3, np.nan)
    body_error(pose_ref, pose, error)
    return error


# --- the command and its derivative


@cache
def derived() -> Callable[..., Array]:
    """Alpha (3.3) and its derivative along (3.2), by sympy; |vr| = side * vr with a side of 1 or -1."""
    t = sp.Symbol("t")
    ex, ey, ephi, vr, wr = (sp.Function(name)(t) for name in ("ex", "ey", "ephi", "vr", "wr"))
    v, w, ar, br, kx, ky, kth, side = sp.symbols("v w ar br kx ky kth side")
    alpha = sp.Matrix(
        [vr * sp.cos(ephi) + kx * ex, wr + vr * ky * ey + side * vr * kth * sp.sin(ephi)],
    )
    rates = {
        ex.diff(t): w * ey - v + vr * sp.cos(ephi),
        ey.diff(t): -w * ex + vr * sp.sin(ephi),
        ephi.diff(t): wr - w,
        vr.diff(t): ar,
        wr.diff(t): br,
    }
    both = sp.Matrix.vstack(alpha, alpha.diff(t).subs(rates))
    plain = both.subs(dict(zip((ex, ey, ephi, vr, wr), sp.symbols("a b c d e"), strict=True)))
    names = (*sp.symbols("a b c d e"), ar, br, v, w, kx, ky, kth, side)
    return sp.lambdify(names, plain)


@patient
@given(errors, speeds, velocities, velocities, gains)
def test_command_and_derivative_equal_the_symbolic_ones(
    error: Array, v_ref: Array, a_ref: Array, velocity: Array, gains: Array
) -> None:
    expected = derived()(*error, *v_ref, *a_ref, *velocity, *gains, np.sign(v_ref[0])).ravel()
    alpha, alphadot = law(error, v_ref, a_ref, velocity, gains)
    np.testing.assert_allclose(np.concatenate((alpha, alphadot)), expected, rtol=1e-12, atol=1e-10)


def test_command_for_known_errors() -> None:
    """On the path it is the reference; 1 cm behind, 1 cm to the right, turned away: speed up, turn left."""
    v_ref, rest = np.array([0.3, 0.2]), np.zeros(2)
    assert law(np.zeros(3), v_ref, rest, v_ref, THESIS)[0] == pytest.approx([0.3, 0.2])
    assert law(np.array([0.01, 0, 0]), v_ref, rest, v_ref, THESIS)[0] == pytest.approx([0.4, 0.2])
    assert law(np.array([0, 0.01, 0]), v_ref, rest, v_ref, THESIS)[0] == pytest.approx([0.3, 0.2 + 0.3 * 64 * 0.01])
    turned = law(np.array([0, 0, np.pi / 2]), v_ref, rest, v_ref, THESIS)[0]
    assert turned == pytest.approx([0, 0.2 + 0.3 * 16])


def moved(pose: Array, velocity: Array, acceleration: Array, t: float) -> Array:
    """Pose of a base after t seconds of `velocity + acceleration t`: one step of RK4, for short times."""

    def rate(pose: Array, t: float) -> Array:
        v, w = velocity + acceleration * t
        return np.array([v * np.cos(pose[2]), v * np.sin(pose[2]), w])

    k1 = rate(pose, 0)
    k2 = rate(pose + t / 2 * k1, t / 2)
    k3 = rate(pose + t / 2 * k2, t / 2)
    return pose + t / 6 * (k1 + 2 * k2 + 2 * k3 + rate(pose + t * k3, t))


@patient
@given(poses, errors, speeds, velocities, velocities, gains)
def test_derivative_equals_differences_along_a_motion_in_the_world(
    pose: Array, offset: Array, v_ref: Array, a_ref: Array, velocity: Array, gains: Array
) -> None:
    """Robot and reference drive in the world; nothing of the error kinematics is assumed."""
    pose_ref, h = pose + offset, 1e-4

    def alpha_at(t: float) -> Array:
        error = error_between(moved(pose_ref, v_ref, a_ref, t), moved(pose, velocity, np.zeros(2), t))
        return law(error, v_ref + a_ref * t, a_ref, velocity, gains)[0]

    alphadot = law(error_between(pose_ref, pose), v_ref, a_ref, velocity, gains)[1]
    difference = (alpha_at(h) - alpha_at(-h)) / (2 * h)
    np.testing.assert_allclose(alphadot, difference, rtol=1e-5, atol=1e-4)


# --- Lyapunov function of the kinematic loop


def energy(error: Array, ky: float) -> float:
    """The V1 that works: the function printed as (3.4) has an indefinite derivative."""
    return float((error[0] ** 2 + error[1] ** 2) / 2 + (1 - np.cos(error[2])) / ky)


@patient
@given(poses, errors, speeds, gains)
def test_lyapunov_function_decreases_forward_and_in_reverse(
    pose: Array, offset: Array, v_ref: Array, gains: Array
) -> None:
    """With v, w = alpha: V1dot = -kx ex^2 - |vr| kth / ky sin^2 ephi, as a motion in the world shows."""
    pose_ref, none, h = pose + offset, np.zeros(2), 1e-4
    kx, ky, kth = gains
    error = error_between(pose_ref, pose)
    alpha, _ = law(error, v_ref, none, none, gains)
    after = error_between(moved(pose_ref, v_ref, none, h), moved(pose, alpha, none, h))
    before = error_between(moved(pose_ref, v_ref, none, -h), moved(pose, alpha, none, -h))
    expected = -kx * error[0] ** 2 - abs(v_ref[0]) * kth / ky * np.sin(error[2]) ** 2
    rate = (energy(after, ky) - energy(before, ky)) / (2 * h)
    assert rate == pytest.approx(expected, rel=1e-4, abs=1e-3)
    assert expected <= 0


def driven(v_ref: Array, gains: Array, seconds: float) -> tuple[Array, Array]:
    """First and last error of a base that follows alpha exactly."""
    h, none = 0.01, np.zeros(2)
    pose_ref, pose = np.zeros(3), np.array([-0.1, 0.1, 0.3])
    first = error_between(pose_ref, pose)
    for _ in range(round(seconds / h)):
        alpha, _ = law(error_between(pose_ref, pose), v_ref, none, none, gains)
        pose, pose_ref = moved(pose, alpha, none, h), moved(pose_ref, v_ref, none, h)
    return first, error_between(pose_ref, pose)


@pytest.mark.parametrize("vr", [0.3, -0.3])
def test_all_errors_vanish_in_both_directions(vr: float) -> None:
    first, last = driven(np.array([vr, 0.1]), THESIS, 6.0)
    assert np.abs(last).max() < 1e-3 * np.abs(first).max()


def test_the_printed_law_does_not_track_in_reverse() -> None:
    """`vr kth` as printed is `|vr| kth` with a negative kth when vr < 0: the heading runs away."""
    printed = THESIS * [1, 1, -1]
    first, last = driven(np.array([-0.3, 0.1]), printed, 6.0)
    assert np.abs(last).max() > np.abs(first).max()


def test_nothing_is_stabilised_sideways_at_rest() -> None:
    alpha, _ = law(np.array([0.0, 0.4, 0.3]), np.zeros(2), np.zeros(2), np.zeros(2), THESIS)
    assert alpha == pytest.approx([0, 0])


# --- errors


@patient
@given(st.floats(-1e4, 1e4))
def test_wrapped_angle_is_the_same_direction_within_half_a_turn(angle: float) -> None:
    wrapped = wrap(angle)
    assert -math.pi <= wrapped <= math.pi
    assert math.remainder(wrapped - angle, 2 * math.pi) == pytest.approx(0, abs=1e-11)


@pytest.mark.parametrize("turns", [0, 1, -1, 5])
def test_half_a_turn_is_plus_pi(turns: int) -> None:
    assert wrap(math.pi + turns * 2 * math.pi) == pytest.approx(math.pi, abs=1e-14)
    assert wrap(-math.pi) == math.pi
    assert wrap(math.pi - 1e-9) == pytest.approx(math.pi - 1e-9, abs=1e-15)
    assert wrap(-math.pi + 1e-9) == pytest.approx(-math.pi + 1e-9, abs=1e-15)


def transform(pose: Array) -> Array:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0, 0, 1]])


@patient
@given(poses, poses)
def test_pose_error_is_the_reference_seen_from_the_base(pose_ref: Array, pose: Array) -> None:
    seen = np.linalg.inv(transform(pose)) @ transform(pose_ref)
    error = error_between(pose_ref, pose)
    np.testing.assert_allclose(error[:2], seen[:2, 2], atol=1e-12)
    assert math.remainder(error[2] - np.arctan2(seen[1, 0], seen[0, 0]), 2 * np.pi) == pytest.approx(0, abs=1e-12)
    assert abs(error[2]) <= np.pi  # the poses are unwrapped, the error is not


# --- a whole sample


def filled(layout: Layout, seed: int) -> tuple[Array, dict[str, Array]]:
    """A row of random signals, and views into it by name."""
    row = np.random.default_rng(seed).uniform(-1, 1, layout.width)
    names = [*(field.name + view.suffix for view in VIEWS for field in fields(view)), "nu"]
    return row, {name: row[layout.where(name)] for name in names}


def sample(row: Array, layout: Layout, K: Array) -> None:
    offsets: Any = layout.offsets
    command(row, offsets, THESIS, K, np.zeros(0), None)


@pytest.mark.parametrize("layout", [Layout(2, 2, 7, 4), Layout(2, 3, 8, 5), Layout(2, 0, 5, 2), Layout(0, 2, 2, 2)])
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_sample_has_the_errors_of_the_thesis(layout: Dimensions, seed: int) -> None:
    row, signal = filled(layout, seed)
    K = np.random.default_rng(seed + 1).uniform(1, 9, layout.arm)
    truth = signal["nu"].copy()
    sample(row, layout, K)
    nu = np.concatenate((signal["velocity"], signal["qdot"]))
    np.testing.assert_allclose(signal["e"], signal["q_ref"] - signal["q"])  # Eqn. 3.10
    np.testing.assert_allclose(signal["edot"], signal["qdot_ref"] - signal["qdot"])
    np.testing.assert_allclose(signal["r"], signal["edot"] + K * signal["e"])  # Eqn. 3.11
    np.testing.assert_allclose(signal["z"], signal["alpha"] - signal["velocity"])  # Eqn. 3.6
    s = np.concatenate((signal["z"], signal["r"]))
    np.testing.assert_allclose(signal["nu_ref"] - nu, s, atol=1e-14)
    ahead = np.concatenate((signal["alphadot"], signal["qddot_ref"] + K * signal["edot"]))
    np.testing.assert_allclose(signal["nudot_ref"], ahead)
    np.testing.assert_array_equal(signal["nu"], truth)
    if layout.base:
        error = error_between(signal["pose_ref"], signal["pose"])
        np.testing.assert_array_equal(signal["pose_error"], error)
        v_ref, a_ref = signal["velocity_ref"], signal["acceleration_ref"]
        alpha, alphadot = law(error, v_ref, a_ref, signal["velocity"], THESIS)
        np.testing.assert_array_equal(np.concatenate((signal["alpha"], signal["alphadot"])), [*alpha, *alphadot])


def test_sample_uses_the_measurement_only() -> None:
    """The true state may be anything: the command stays the same."""
    layout = Layout(2, 2, 7, 4)
    row, signal = filled(layout, 3)
    blind = row.copy()
    for name in ("position", "nu", "psi", "energy"):
        blind[layout.where(name)] = np.nan
    for one in (row, blind):
        sample(one, layout, np.array([7.0, 7.0]))
    commanded = slice(layout.where("alpha").start, layout.where("nudot_ref").stop)
    np.testing.assert_array_equal(blind[commanded], row[commanded])
    assert np.isfinite(signal["nudot_ref"]).all()


# --- settings


@pytest.mark.parametrize("name", ["kx", "ky", "kth", "K"])
@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_impossible_gains_are_refused(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"^kinematic.{name}: error: .*negative or not finite"):
        Kinematic(**{name: value})


def test_one_gain_serves_all_joints_or_each_has_its_own() -> None:
    layout = Layout(2, 2, 7, 4)
    np.testing.assert_array_equal(Kinematic(K=3.0).arm_gains(layout), [3, 3])
    np.testing.assert_array_equal(Kinematic(K=(3.0, 4.0)).arm_gains(layout), [3, 4])
    np.testing.assert_array_equal(
        Kinematic(1.0, 2.0, 3.0).base_gains(Layout(2, 2, 7, 4, "differential_drive")), [1, 2, 3]
    )
    with pytest.raises(ConfigError, match=r"3 numbers for 2 joints.*one number or one per joint"):
        Kinematic(K=(1.0, 2.0, 3.0)).arm_gains(layout)
