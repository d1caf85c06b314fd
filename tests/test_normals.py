"""The normal distribution: numpy's own numbers, mpmath's quantiles; the elementary functions over arrays."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin import elementary
from mmnn_pin.elementary import arrays, normals


@given(st.integers(0, 2**63), st.integers(0, 3000))
@settings(max_examples=30, deadline=None)
def test_the_numbers_are_numpys_and_so_is_what_follows(seed: int, count: int) -> None:
    ours, theirs = np.random.default_rng(seed), np.random.default_rng(seed)
    np.testing.assert_allclose(normals.standard_normal(ours, count), theirs.standard_normal(count), rtol=4e-16)
    assert ours.random() == theirs.random()
    np.testing.assert_allclose(
        normals.standard_normal(ours, (count, 2)), theirs.standard_normal((count, 2)), rtol=4e-16
    )


def test_the_tail_is_numpys() -> None:
    """Of a million numbers, the 260 or so that only the tail gives."""
    ours = normals.standard_normal(np.random.default_rng(5), 1_000_000)
    theirs = np.random.default_rng(5).standard_normal(1_000_000)
    far = np.abs(theirs) > 3.6541528853610088
    assert far.sum() > 150
    assert np.array_equal(ours[~far], theirs[~far])
    np.testing.assert_allclose(ours[far], theirs[far], rtol=4e-16)


@given(st.floats(-300, -1e-9) | st.floats(-1, -1e-9))
@settings(max_examples=100, deadline=None)
def test_quantiles_are_those_of_mpmath(decade: float) -> None:
    p = 10.0**decade
    with mpmath.workdps(40):
        ours = normals.quantile(p)
        # one step of Newton's method from our answer says how far off it is
        x = mpmath.mpf(ours)
        below = mpmath.erfc(-x / mpmath.sqrt(2)) / 2
        step = (below - p) / mpmath.npdf(x)
        assert abs(step) <= 1e-15 * max(abs(x), mpmath.mpf(1e-3)) + abs(mpmath.mpf(math.ulp(p)) / mpmath.npdf(x))
        assert normals.quantile(1.0 - 0.25) == -normals.quantile(0.25)


@given(st.floats(-37, 9))
@settings(max_examples=100, deadline=None)
def test_probabilities_are_those_of_mpmath(x: float) -> None:
    with mpmath.workdps(40):
        exact = mpmath.ncdf(mpmath.mpf(x))
        assert abs(normals.probability(x) - exact) <= 4e-13 * exact if x < -10 else 4e-15 * exact + 1e-16


def test_ends_of_the_distribution() -> None:
    assert normals.quantile(0.0) == -math.inf and normals.quantile(1.0) == math.inf
    assert normals.probability(-math.inf) == 0.0 and normals.probability(math.inf) == 1.0
    assert math.isnan(normals.quantile(-0.1)) and math.isnan(normals.quantile(math.nan))


@pytest.mark.parametrize("name", ["sin", "cos", "exp", "tanh", "hypot", "atan2"])
def test_arrays_have_the_bits_of_single_numbers(name: str) -> None:
    rng = np.random.default_rng(2)
    given = [rng.uniform(-9, 9, (5, 7)) for _ in range(2 if name in ("hypot", "atan2") else 1)]
    found = getattr(arrays, name)(*given)
    assert found.shape == (5, 7)
    for i in np.ndindex(5, 7):
        assert found[i] == getattr(elementary, name)(*(float(one[i]) for one in given))


def test_cosine_and_sine_together_have_the_same_bits() -> None:
    rng = np.random.default_rng(4)
    for x in (*rng.uniform(-10, 10, 300), *(10 ** rng.uniform(-20, 300, 200)), 0.0, -0.0, 1e-9, math.inf, math.nan):
        both = elementary.cos_sin(float(x))
        assert np.array_equal(both, (elementary.cos(float(x)), elementary.sin(float(x))), equal_nan=True)
        assert math.copysign(1.0, both[1]) == math.copysign(1.0, elementary.sin(float(x)))
