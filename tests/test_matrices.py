"""Small matrices in plain arithmetic against numpy's and scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

from mmnn_pin.elementary import matrices

sizes = st.integers(1, 9)
seeds = st.integers(0, 2**32 - 1)


def drawn(seed: int, rows: int, columns: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((rows, columns))


@given(seeds, sizes, sizes, sizes)
@settings(max_examples=60, deadline=None)
def test_products_are_those_of_numpy(seed: int, i: int, j: int, k: int) -> None:
    A, B, x = drawn(seed, i, j), drawn(seed + 1, j, k), drawn(seed, k, 1)[:, 0]
    np.testing.assert_allclose(matrices.product(A, B), A @ B, atol=1e-13)
    np.testing.assert_allclose(matrices.product(A, B, x), A @ B @ x, atol=1e-13)
    np.testing.assert_allclose(matrices.product(A[0], B), A[0] @ B, atol=1e-13)
    assert matrices.length(x) == pytest.approx(np.linalg.norm(x), rel=1e-15)


@given(seeds, sizes, sizes)
@settings(max_examples=60, deadline=None)
def test_equations_are_solved(seed: int, size: int, columns: int) -> None:
    A, B = drawn(seed, size, size) + 0.1 * np.eye(size), drawn(seed + 1, size, columns)
    condition = np.linalg.cond(A)
    np.testing.assert_allclose(A @ matrices.solve(A, B), B, atol=1e-14 * condition)
    np.testing.assert_allclose(A @ matrices.solve(A, B[:, 0]), B[:, 0], atol=1e-14 * condition)
    np.testing.assert_allclose(A @ matrices.inverse(A), np.eye(size), atol=1e-14 * condition)
    L = matrices.cholesky(A @ A.T + np.eye(size))
    np.testing.assert_allclose(L @ L.T, A @ A.T + np.eye(size), atol=1e-12)
    assert np.array_equal(L, np.tril(L)) and (np.diag(L) > 0).all()


def test_a_matrix_that_is_not_positive_definite_has_no_root() -> None:
    assert np.isnan(matrices.cholesky([[1.0, 2.0], [2.0, 1.0]])).any()


@given(seeds, st.integers(1, 20), st.integers(1, 12), st.integers(1, 12))
@settings(max_examples=60, deadline=None)
def test_singular_values_and_directions_are_those_of_lapack(seed: int, rows: int, columns: int, rank: int) -> None:
    A = drawn(seed, rows, rank) @ drawn(seed + 1, rank, columns) / rank
    images, values, V = matrices.svd(A)
    theirs = np.zeros(columns)
    theirs[: min(rows, columns)] = np.linalg.svd(A, compute_uv=False)
    np.testing.assert_allclose(values, theirs, atol=1e-13 * theirs[0])
    np.testing.assert_allclose(V.T @ V, np.eye(columns), atol=1e-13)
    np.testing.assert_allclose(A @ V, images, atol=1e-13 * theirs[0])
    gram = images.T @ images - np.diag(values**2)
    np.testing.assert_allclose(gram, 0.0, atol=1e-12 * theirs[0] ** 2)
    np.testing.assert_allclose(
        matrices.pseudo_inverse(A), np.linalg.pinv(A, 1e-13), atol=1e-9 * abs(np.linalg.pinv(A, 1e-13)).max()
    )


@given(seeds, st.integers(1, 12), st.integers(0, 30))
@settings(max_examples=40, deadline=None)
def test_the_triangle_has_the_same_directions(seed: int, columns: int, more: int) -> None:
    A = drawn(seed, columns + more, columns)
    R = matrices.triangle(A)
    assert np.array_equal(R, np.triu(R)) and R.shape == (columns, columns)
    np.testing.assert_allclose(R.T @ R, A.T @ A, atol=1e-12)


@given(seeds, sizes, st.floats(-3, 3))
@settings(max_examples=40, deadline=None)
def test_the_exponential_is_that_of_scipy(seed: int, size: int, decade: float) -> None:
    A = drawn(seed, size, size)
    A = 10**decade * (A - A.T) - A @ A.T  # turns, and decays
    np.testing.assert_allclose(matrices.exponential(A), linalg.expm(A), atol=1e-11 * max(1.0, np.abs(A).max()))


def test_simple_matrices_are_exact() -> None:
    for n in range(4):
        one = np.eye(n)
        for function in (matrices.inverse, matrices.pseudo_inverse, matrices.cholesky):
            assert np.array_equal(function(one), one)
        assert np.array_equal(matrices.exponential(np.zeros((n, n))), one)
    assert np.array_equal(matrices.pseudo_inverse(np.zeros((2, 3))), np.zeros((3, 2)))
