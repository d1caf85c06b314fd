"""Networks: outputs against matrices, the update law against its derivation from a Lyapunov function."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
import sympy as sp  # type: ignore[import-untyped]
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist
from scipy.special import expit

from mmnn_pin.signals import Array
from mmnn_pin.torque.one_layer import one_layer_answer, one_layer_output, one_layer_update
from mmnn_pin.torque.two_layer import numerical_rank, project, two_layer_answer, two_layer_output, two_layer_update

patient = settings(deadline=None)  # the first call may compile
seeds = st.integers(0, 2**31)


class Network(NamedTuple):
    """Weights, input and error of one network at one instant."""

    W: Array
    V: Array
    x: Array
    s: Array


def network(seed: int, nx: int = 5, h: int = 4, m: int = 2) -> Network:
    rng = np.random.default_rng(seed)
    return Network(*(rng.normal(size=shape) for shape in ((h, m), (nx, h), nx, m)))


def output(W: Array, V: Array, x: Array) -> tuple[Array, Array, Array]:
    """Net inputs, hidden outputs and Psi_hat of the compiled two-layer network."""
    net, sigma, psi_hat = (np.full(size, np.nan) for size in (V.shape[1], V.shape[1], W.shape[1]))
    two_layer_output(W, V, x, net, sigma, psi_hat)
    return net, sigma, psi_hat


def updated(n: Network, F: float, G: float, kappa: float, dt: float = 1.0) -> tuple[Array, Array]:
    """Weights after one compiled update."""
    W, V = n.W.copy(), n.V.copy()
    net, sigma, _ = output(n.W, n.V, n.x)
    two_layer_update(W, V, n.x, net, sigma, n.s, np.array([F, G, kappa]), dt)
    return W, V


def by_matrices(n: Network, F: float, G: float, kappa: float) -> tuple[Array, Array]:
    """Wdot and Vdot as (3.48), (3.49) stand in the thesis."""
    sigma = expit(n.V.T @ n.x)
    slope = np.diag(sigma) @ (np.eye(sigma.size) - np.diag(sigma))
    norm = np.linalg.norm(n.s)
    Wdot = F * np.outer(sigma, n.s) - F * np.outer(slope @ n.V.T @ n.x, n.s) - kappa * F * norm * n.W
    Vdot = G * np.outer(n.x, slope.T @ n.W @ n.s) - kappa * G * norm * n.V
    return Wdot, Vdot


# --- two layers


@patient
@given(seeds)
def test_two_layer_output_equals_the_matrix_formula(seed: int) -> None:
    n = network(seed)
    net, sigma, psi_hat = output(n.W, n.V, n.x)
    np.testing.assert_allclose(net, n.V.T @ n.x, atol=1e-13)
    np.testing.assert_allclose(sigma, expit(n.V.T @ n.x), atol=1e-15)
    np.testing.assert_allclose(psi_hat, n.W.T @ expit(n.V.T @ n.x), atol=1e-13)


@patient
@given(seeds, st.floats(0, 3), st.floats(0, 3), st.floats(0, 2), st.floats(1e-4, 1))
def test_update_equals_the_matrix_formula(seed: int, F: float, G: float, kappa: float, dt: float) -> None:
    n = network(seed)
    Wdot, Vdot = by_matrices(n, F, G, kappa)
    W, V = updated(n, F, G, kappa, dt)
    np.testing.assert_allclose(W, n.W + dt * Wdot, atol=1e-12)
    np.testing.assert_allclose(V, n.V + dt * Vdot, atol=1e-12)


def test_both_layers_move_with_the_old_weights() -> None:
    """Vdot contains W: taking the new one is another law, and the difference is not a rounding error."""
    n = network(1)
    Wdot, Vdot = by_matrices(n, 1.0, 1.0, 0.5)
    _, V = updated(n, 1.0, 1.0, 0.5)
    _, other = by_matrices(n._replace(W=n.W + Wdot), 1.0, 1.0, 0.5)
    np.testing.assert_allclose(V, n.V + Vdot, atol=1e-13)
    assert np.abs(n.V + other - V).max() > 0.01


@cache
def lyapunov() -> tuple[Callable[..., Array], sp.Expr, sp.Expr]:
    """The update law derived from `V = s'Ms/2 + tr(Wt'F^-1 Wt)/2 + tr(Vt'G^-1 Vt)/2`, Wt = W - What, Vt = V - Vhat.

    Along `M sdot = -k s + W'sigma(V'x) - What'sigma(Vhat'x)` the network enters Vdot as `s'(...)`. Expand sigma to
    first order about Vhat'x. What is linear in Wt, Vt and known weights, and what stays with the unknown V, add up to
    it; the adaptation can only use the known part.

    Returns:
        The law `(What, Vhat, x, s, F, G) -> (Wdot, Vdot)` in one column; what is left of the network's share of Vdot
        with that law; and what should be left, `s' Wt' sigma' V'x`.
    """
    nx, h, m = 3, 2, 2
    What, Wt = (sp.Matrix(h, m, sp.symbols(f"{name}:{h * m}")) for name in ("a", "b"))
    Vhat, Vt = (sp.Matrix(nx, h, sp.symbols(f"{name}:{nx * h}")) for name in ("c", "d"))
    x, s = sp.Matrix(sp.symbols(f"x:{nx}")), sp.Matrix(sp.symbols(f"s:{m}"))
    F, G, a = sp.symbols("F G a", positive=True)
    act = 1 / (1 + sp.exp(-a))
    net = Vhat.T * x
    sigma = net.applyfunc(lambda value: act.subs(a, value))
    slope = sp.diag(*[act.diff(a).subs(a, value) for value in net])
    W, V = What + Wt, Vhat + Vt
    expanded = W.T * (sigma + slope * Vt.T * x) - What.T * sigma  # Taylor, first order in Vt'x
    share = (s.T * expanded)[0]
    unknown = (s.T * Wt.T * slope * V.T * x)[0]
    linear = sp.expand(share - unknown)
    law_W = F * sp.Matrix(h, m, [linear.diff(w) for w in Wt])  # so that the trace terms cancel the linear ones
    law_V = G * sp.Matrix(nx, h, [linear.diff(v) for v in Vt])
    assert not law_W.free_symbols & {*Wt, *Vt}, "the law would need what it does not know"
    assert not law_V.free_symbols & {*Wt, *Vt}
    left = share - (Wt.T * law_W).trace() / F - (Vt.T * law_V).trace() / G  # Wtdot = -Wdot, Vtdot = -Vdot
    law = sp.lambdify((*What, *Vhat, *x, *s, F, G), sp.Matrix([*law_W, *law_V]))
    return law, left, unknown


@patient
@given(seeds, st.floats(0.1, 3), st.floats(0.1, 3))
def test_update_is_the_one_that_cancels_in_the_lyapunov_function(seed: int, F: float, G: float) -> None:
    n = network(seed, nx=3, h=2, m=2)
    derived = lyapunov()[0](*n.W.ravel(), *n.V.ravel(), *n.x, *n.s, F, G).ravel()
    W, V = updated(n, F, G, kappa=0.0)
    np.testing.assert_allclose([*(W - n.W).ravel(), *(V - n.V).ravel()], derived, atol=1e-12)


def test_that_law_cancels_all_but_the_term_with_the_unknown_weights() -> None:
    _, left, unknown = lyapunov()
    point = {symbol: 0.1 + 0.13 * i * (-1) ** i for i, symbol in enumerate(sorted(left.free_symbols, key=str))}
    assert sp.simplify(sp.expand(left - unknown)) == 0
    assert abs(float(unknown.subs(point))) > 1e-4  # and that term is not nothing


class Ideal(NamedTuple):
    """A plant `M sdot = W'sigma(V'x) - What'sigma(Vhat'x) - k s` that a network of equal size could cancel."""

    W: Array
    V: Array
    M: Array
    k: float
    F: float
    G: float

    def energy(self, What: Array, Vhat: Array, s: Array) -> float:
        Wt, Vt = self.W - What, self.V - Vhat
        return float(s @ self.M @ s / 2 + np.sum(Wt**2) / (2 * self.F) + np.sum(Vt**2) / (2 * self.G))

    def sdot(self, What: Array, Vhat: Array, x: Array, s: Array) -> Array:
        mismatch = self.W.T @ expit(self.V.T @ x) - What.T @ expit(Vhat.T @ x)
        return np.linalg.solve(self.M, mismatch - self.k * s)


@patient
@given(seeds)
def test_rate_of_the_lyapunov_function_is_the_predicted_one(seed: int) -> None:
    """-k |s|^2, plus what cannot cancel: the term with V and the second-order rest of the expansion."""
    n, ideal = network(seed), network(seed + 1)
    plant = Ideal(ideal.W, ideal.V, np.array([[2.0, 0.3], [0.3, 1.0]]), 1.5, 0.8, 1.2)
    dt = 1e-6
    W, V = updated(n, plant.F, plant.G, 0.0, dt)
    s = n.s + dt * plant.sdot(n.W, n.V, n.x, n.s)
    rate = (plant.energy(W, V, s) - plant.energy(n.W, n.V, n.s)) / dt
    sigma, slope = expit(n.V.T @ n.x), expit(n.V.T @ n.x) * (1 - expit(n.V.T @ n.x))
    Vt = plant.V - n.V
    rest = plant.W.T @ (expit(plant.V.T @ n.x) - sigma - slope * (Vt.T @ n.x))
    left = n.s @ ((plant.W - n.W).T @ (slope * (plant.V.T @ n.x)) + rest)
    assert rate == pytest.approx(-plant.k * n.s @ n.s + left, rel=1e-3, abs=2e-3)


def learned(plant: Ideal, direction: float) -> tuple[float, float]:
    """Lyapunov function before and after two seconds of learning, its rates multiplied by `direction`."""
    rng, dt = np.random.default_rng(7), 2e-3
    W, V, s = plant.W + 0.3, plant.V + rng.normal(scale=0.05, size=plant.V.shape), np.zeros(2)
    before = plant.energy(W, V, s)
    for i in range(1000):
        x = 0.3 * np.array([np.sin(3 * i * dt), np.cos(5 * i * dt), np.sin(11 * i * dt), 1.0, -1.0])
        old = Network(W, V, x, s)
        W, V = updated(old, direction * plant.F, direction * plant.G, 0.0, dt)
        s = s + dt * plant.sdot(old.W, old.V, x, s)
    return before, plant.energy(W, V, s)


def test_learning_lowers_the_lyapunov_function_and_its_opposite_does_not() -> None:
    ideal = network(3)
    plant = Ideal(ideal.W, ideal.V, np.eye(2), 1.0, 5.0, 5.0)
    before, after = learned(plant, 1.0)
    assert after < 0.5 * before
    before, after = learned(plant, -1.0)
    assert after > before


def test_slope_of_the_sigmoid_against_differences() -> None:
    """The update of V shows sigma': with W picking out one unit at a time, `Vdot_ij = x_i sigma'_j`."""
    nx, h, step = 4, 3, 1e-5
    rng = np.random.default_rng(5)
    V, x = rng.normal(size=(nx, h)), rng.normal(size=nx)
    W, s = np.ones((h, 1)), np.array([1.0])
    _, moved = updated(Network(W, V, x, s), 0.0, 1.0, 0.0)
    for i in range(nx):
        shifted = [V.copy(), V.copy()]
        shifted[0][i] += step
        shifted[1][i] -= step
        difference = (output(W, shifted[0], x)[1] - output(W, shifted[1], x)[1]) / (2 * step)  # x_i sigma'
        np.testing.assert_allclose(moved[i] - V[i], difference, atol=1e-9)


@patient
@given(seeds, st.floats(1e-4, 0.1))
def test_rates_per_second_are_the_rates_per_sample_times_the_period(seed: int, h: float) -> None:
    n = network(seed)
    per_sample, per_second = updated(n, 1.0, 0.7, 0.3, 1.0), updated(n, 1.0, 0.7, 0.3, h)
    for old, sample, second in zip((n.W, n.V), per_sample, per_second, strict=True):
        np.testing.assert_allclose(second - old, h * (sample - old), atol=1e-13)


def test_leakage_pulls_by_kappa_times_the_error_and_bounds_the_weights() -> None:
    n, F, G, kappa = network(2), 0.5, 0.25, 0.8
    leak = kappa * np.linalg.norm(n.s)
    plain, leaking = updated(n, F, G, 0.0), updated(n, F, G, kappa)
    np.testing.assert_allclose(leaking[0] - plain[0], -F * leak * n.W, atol=1e-13)
    np.testing.assert_allclose(leaking[1] - plain[1], -G * leak * n.V, atol=1e-13)
    norms = {}
    for kappa in (0.0, 1.0):
        m = n
        for _ in range(2000):
            W, V = updated(m, 0.05, 0.05, kappa)
            m = m._replace(W=W, V=V)
        norms[kappa] = np.linalg.norm(m.W)
    assert norms[1.0] < 5
    assert norms[0.0] > 10 * norms[1.0]


@pytest.mark.compiled
@patient
@given(seeds, st.floats(0.01, 10.0), st.floats(0.0, 10.0))
def test_the_projection_comes_closer_to_every_point_of_the_ball(seed: int, radius: float, size: float) -> None:
    """It is the nearest point of the ball; a difference of two norms as second answer to what the proof needs of it."""
    rng = np.random.default_rng(seed)
    A, ideal = rng.standard_normal((2, 4, 3))
    A *= size / np.linalg.norm(A)
    ideal *= radius * rng.uniform() / np.linalg.norm(ideal)
    after = A.copy()
    project(after, radius)
    np.testing.assert_allclose(after, A * min(1.0, radius / size) if size > 0 else A, rtol=1e-12)
    assert np.linalg.norm(after) <= radius * (1 + 1e-12)
    assert np.linalg.norm(ideal - after) <= np.linalg.norm(ideal - A) * (1 + 1e-12)


def test_the_projection_has_an_end_whatever_comes() -> None:
    for bad in (np.nan, np.inf, 1e200):
        A = np.array([[bad, 1.0]])
        with np.errstate(over="ignore"):
            project(A, 2.0)
        assert np.linalg.norm(A) <= 2.0
        B = np.array([[bad, 1.0]])
        project(B, np.inf)
        np.testing.assert_array_equal(B, [[bad, 1.0]])


def test_no_error_no_learning() -> None:
    n = network(4)._replace(s=np.zeros(2))
    W, V = updated(n, 1.0, 1.0, 1.0)
    np.testing.assert_array_equal(W, n.W)
    np.testing.assert_array_equal(V, n.V)


@pytest.mark.parametrize("size", [1e3, 1e8, 1e150])
def test_huge_inputs_saturate(size: float) -> None:
    n = network(6)
    with np.errstate(over="ignore"):  # exp overflows to inf, as it should: 1 / inf = 0
        for x in (n.x * size, -n.x * size):
            _, sigma, psi_hat = output(n.W, n.V, x)
            assert np.isfinite(psi_hat).all()
            assert ((sigma >= 0) & (sigma <= 1)).all()
            moved = updated(n._replace(x=x), 1.0, 1.0, 1.0)
            assert all(np.isfinite(weights).all() for weights in moved)


# --- rank


def trained(W: Array, V: Array, kappa: float) -> tuple[Array, Array]:
    rng = np.random.default_rng(11)
    for _ in range(60):
        now = Network(W, V, rng.normal(size=len(V)), rng.normal(size=W.shape[1:]))
        W, V = updated(now, 0.3, 0.3, kappa)
    return W, V


@pytest.mark.parametrize("kappa", [0.0, 0.1])
def test_weights_from_zero_keep_rank_one(kappa: float) -> None:
    W, V = trained(np.zeros((4, 2)), np.zeros((5, 4)), kappa)
    assert np.linalg.norm(W) > 0.1
    assert np.linalg.norm(V) > 0.1
    assert (numerical_rank(W), numerical_rank(V)) == (1, 1)
    assert np.ptp(V, axis=1).max() < 1e-12  # all units see the same
    assert np.ptp(W, axis=0).max() < 1e-12  # and count the same


def test_weights_from_random_V_keep_full_rank() -> None:
    W, V = trained(np.zeros((4, 2)), np.random.default_rng(1).uniform(-1, 1, (5, 4)), 0.0)
    assert (numerical_rank(W), numerical_rank(V)) == (2, 4)


def test_leakage_forgets_that_V_was_random() -> None:
    """Every update shrinks the differences between the units by 1 - kappa G |s|: in the end they are equal again."""
    V = np.random.default_rng(1).uniform(-1, 1, (5, 4))
    spread = {kappa: np.ptp(trained(np.zeros((4, 2)), V, kappa)[1], axis=1).max() for kappa in (0.0, 0.1, 1.0)}
    assert spread[1.0] < 1e-3 * spread[0.1] < 1e-3 * spread[0.0]


@pytest.mark.parametrize("rank", [0, 1, 2, 3])
def test_numerical_rank(rank: int) -> None:
    rng = np.random.default_rng(rank)
    A = rng.normal(size=(6, rank)) @ rng.normal(size=(rank, 3))
    assert numerical_rank(A) == np.linalg.matrix_rank(A) == rank
    assert numerical_rank(A + 1e-13 * rng.normal(size=A.shape)) in ((3,) if rank == 0 else (rank,))


@pytest.mark.parametrize("nx", [1, 2, 5, 6])
def test_outputs_return_the_norm_of_the_weights(nx: int) -> None:
    n, h, m = network(nx, nx), 4, 2
    net, sigma, psi_hat = np.zeros(h), np.zeros(h), np.zeros(m)
    norm = two_layer_output(n.W, n.V, n.x, net, sigma, psi_hat)
    assert norm == pytest.approx(np.hypot(np.linalg.norm(n.W), np.linalg.norm(n.V)), rel=1e-14)
    np.testing.assert_allclose(net, n.V.T @ n.x, atol=1e-13)
    assert one_layer_output(n.W, n.V, 1.0, n.x, sigma, psi_hat) == pytest.approx(np.linalg.norm(n.W), rel=1e-14)


# --- one layer


def gaussian(W: Array, centres: Array, width: float, x: Array) -> tuple[Array, Array]:
    phi, psi_hat = np.full(W.shape[0], np.nan), np.full(W.shape[1], np.nan)
    one_layer_output(W, centres, width, x, phi, psi_hat)
    return phi, psi_hat


@patient
@given(seeds, st.floats(0.3, 10))
def test_one_layer_output_equals_the_matrix_formula(seed: int, width: float) -> None:
    n = network(seed)
    expected = np.exp(-cdist(n.x[None], n.V.T, "sqeuclidean")[0] / (2 * width**2))
    phi, psi_hat = gaussian(n.W, n.V, width, n.x)
    np.testing.assert_allclose(phi, expected, rtol=1e-12)
    np.testing.assert_allclose(psi_hat, n.W.T @ expected, atol=1e-12)


def test_gaussian_at_its_centre_and_one_width_away() -> None:
    W, centres = np.eye(2), np.array([[1.0, 4.0], [2.0, 2.0]])
    phi, _ = gaussian(W, centres, 3.0, np.array([1.0, 2.0]))
    np.testing.assert_allclose(phi, [1.0, np.exp(-0.5)])


@patient
@given(seeds, st.floats(0.01, 1), st.floats(0, 1), st.floats(1e-3, 1))
def test_one_layer_update_equals_the_matrix_formula(seed: int, beta: float, mu: float, dt: float) -> None:
    n = network(seed)
    phi, _ = gaussian(n.W, n.V, 2.0, n.x)
    W = n.W.copy()
    one_layer_update(W, phi, n.s, beta, mu, dt)
    expected = beta * np.outer(phi, n.s) - mu * beta * np.linalg.norm(n.s) * n.W
    np.testing.assert_allclose(W, n.W + dt * expected, atol=1e-12)


@patient
@given(seeds)
def test_one_layer_update_cancels_in_its_lyapunov_function(seed: int) -> None:
    """With tr(Wt' Wt) / (2 beta) the adaptation takes away all of `s' Wt' phi`."""
    n, ideal = network(seed), network(seed + 1).W
    phi, _ = gaussian(n.W, n.V, 2.0, n.x)
    W, beta, dt = n.W.copy(), 0.6, 1e-6
    one_layer_update(W, phi, n.s, beta, 0.0, dt)
    rate = (np.sum((ideal - W) ** 2) - np.sum((ideal - n.W) ** 2)) / (2 * beta * dt)
    assert rate + n.s @ (ideal - n.W).T @ phi == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_what_an_update_answers_is_the_slope_of_the_output_against_the_step(seed: int) -> None:
    """`s' (Psi_hat_next - Psi_hat) / dt` for a small dt, from the updates and outputs themselves; both networks."""
    rng = np.random.default_rng(seed)
    h, nx, m, dt, rates = 7, 5, 3, 1e-7, np.array([0.6, 0.3, 0.0])
    W, V, x, s = rng.normal(size=(h, m)), rng.normal(size=(nx, h)), rng.normal(size=nx), rng.normal(size=m)
    net, sigma, before, after = np.zeros(h), np.zeros(h), np.zeros(m), np.zeros(m)
    two_layer_output(W, V, x, net, sigma, before)
    answer = two_layer_answer(W, x, net, sigma, s, rates)
    two_layer_update(W, V, x, net, sigma, s, rates, dt)
    two_layer_output(W, V, x, net, sigma, after)
    assert answer == pytest.approx(s @ (after - before) / dt, rel=1e-5)
    one_layer_output(W, V, 2.0, x, sigma, before)
    answer = one_layer_answer(sigma, s, 0.6)
    one_layer_update(W, sigma, s, 0.6, 0.0, dt)
    one_layer_output(W, V, 2.0, x, sigma, after)
    assert answer == pytest.approx(s @ (after - before) / dt, rel=1e-6)
