"""Factors of a covariance against numpy's matrices, over a million updates, and with data that are no data."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin.torque.factored import add, dot, measure, quadratic, times, variance

seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 9)


def factors(rng, k):
    """Random factors, the unused part of U not zero."""
    return rng.standard_normal((k, k)), np.exp(rng.standard_normal(k))


def matrix(U, D):
    upper = np.eye(len(D)) + np.tril(U, -1).T
    return upper @ np.diag(D) @ upper.T


@settings(max_examples=60, deadline=None)
@given(seeds, sizes, st.floats(1e-6, 1e3))
def test_a_measurement_is_the_formula_of_kalman(seed, k, noise):
    rng = np.random.default_rng(seed)
    (U, D), phi = factors(rng, k), rng.standard_normal(k)
    P, f, b = matrix(U, D), np.zeros(k), np.zeros(k)
    alpha = measure(U, D, phi, noise, f, b)
    assert alpha == pytest.approx(noise + phi @ P @ phi)
    np.testing.assert_allclose(b, P @ phi, rtol=1e-9, atol=1e-9 * np.abs(P).max())
    expected = np.linalg.inv(np.linalg.inv(P) + np.outer(phi, phi) / noise)  # information adds up
    np.testing.assert_allclose(matrix(U, D), expected, atol=1e-6 * np.abs(P).max())


@settings(max_examples=60, deadline=None)
@given(seeds, sizes, st.floats(0.0, 1e3), st.data())
def test_variance_is_added_at_one_place(seed, k, added, data):
    rng, place = np.random.default_rng(seed), data.draw(st.integers(0, k - 1))
    U, D = factors(rng, k)
    P = matrix(U, D)
    assert variance(U, D, place) == pytest.approx(P[place, place])
    add(U, D, place, added, np.zeros(k))
    P[place, place] += added
    np.testing.assert_allclose(matrix(U, D), P, atol=1e-9 * np.abs(P).max())


@settings(max_examples=40, deadline=None)
@given(seeds, sizes)
def test_products(seed, k):
    rng = np.random.default_rng(seed)
    (U, D), g, out = factors(rng, k), rng.standard_normal(k), np.zeros(k)
    times(U, D, g, out)
    np.testing.assert_allclose(out, matrix(U, D) @ g, atol=1e-9 * np.abs(matrix(U, D)).max())
    assert dot(g, D, k) == pytest.approx(g @ D)
    assert quadratic(g, D) == pytest.approx(g @ np.diag(D) @ g)


def test_a_place_without_variance_gets_some():
    U, D = np.zeros((3, 3)), np.array([1.0, 0.0, 2.0])
    measure(U, D, np.array([1.0, 0.5, -1.0]), 0.1, np.zeros(3), np.zeros(3))
    P = matrix(U, D)
    add(U, D, 1, 0.7, np.zeros(3))
    P[1, 1] += 0.7
    np.testing.assert_allclose(matrix(U, D), P, atol=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200, 1e9])
def test_what_is_no_equation_changes_nothing(bad):
    U, D = factors(np.random.default_rng(0), 4)
    before = U.copy(), D.copy()
    assert measure(U, D, np.array([1.0, bad, 0.0, 1.0]), 1e-4, np.zeros(4), np.zeros(4)) == 0.0
    np.testing.assert_array_equal(U, before[0])
    np.testing.assert_array_equal(D, before[1])
    assert quadratic(np.array([bad * 1e200, 1.0]), np.ones(2)) > 1e300


@numba.njit
def many(U, D, phis, noise, drift, prior, steps, f, b):
    """Updates with drift, as the learners have them; the lowest `phi' P phi` of P updated by itself, beside it."""
    k = D.size
    P, lowest = np.diag(prior), 0.0
    for n in range(steps):
        phi = phis[n % len(phis)]
        measure(U, D, phi, noise, f, b)
        g = P @ phi
        lowest = min(lowest, phi @ g)
        P = P - np.outer(g, g) / (noise + phi @ g)
        place = n % k
        room = prior[place] - variance(U, D, place)
        if min(drift, room) > 0.0:
            add(U, D, place, min(drift, room), f)
    return lowest


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="a million updates")
@pytest.mark.parametrize("drift", [0.0, 1e-12])
def test_a_million_updates_leave_it_positive_definite(drift):
    """Features of very different size, some alike, little noise: P updated by itself turns indefinite on the way."""
    rng, k = np.random.default_rng(1), 6
    phis = rng.standard_normal((500, k)) * np.array([1.0, 1.0, 1.0, 1.0, 1e-2, 1e-4])
    phis[:, 3] = phis[:, 2] + 1e-7 * phis[:, 3]
    prior, U = np.ones(k), np.zeros((k, k))
    D = prior.copy()
    lowest = many(U, D, phis, 1e-11, drift, prior, 1_000_000, np.zeros(k), np.zeros(k))
    assert lowest < 0
    assert (D > 0).all() and np.isfinite(U).all()
    assert (np.array([variance(U, D, i) for i in range(k)]) <= prior).all()


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="a million updates")
def test_a_million_updates_are_the_sum_of_their_information():
    rng, k = np.random.default_rng(2), 6
    phis, U, D = rng.standard_normal((500, k)), np.zeros((k, k)), np.ones(k)
    many(U, D, phis, 0.01, 0.0, np.ones(k), 1_000_000, np.zeros(k), np.zeros(k))
    expected = np.linalg.inv(np.eye(k) + 2000 * phis.T @ phis / 0.01)
    np.testing.assert_allclose(matrix(U, D), expected, atol=1e-9 * expected.max())
