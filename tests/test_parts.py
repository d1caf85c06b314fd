"""Elements and signals in compiled code are those of numpy, whatever the index, the shape and the order in memory."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from mmnn_pin.compiled import compiled
from mmnn_pin.parts import view

Array = npt.NDArray[np.float64]


@compiled
def moved(a: Array, b: Array, c: Array, i: int, j: int, k: int, to: npt.NDArray[np.int64]) -> None:
    """Change one element of each array, by the others."""
    a[i] += b[j, -1] * c[i, j, k]
    b[i, j] = to[k] - 1
    c[0, -1, k] = a[-2]
    to[i] = 3 * to[-1] + i


@compiled
def second(A: Array, j: int) -> float:
    """The sum of an element and of another one, of arrays in any order."""
    return float(A[1, j] + A[-1, 0])


@njit
def sorted_copy(a: Array) -> Array:
    """What allocates keeps numba's own elements."""
    b = a.copy()
    for i in range(b.size - 1):
        if b[i + 1] < b[i]:
            b[i], b[i + 1] = b[i + 1], b[i]
    return b


@compiled
def doubled(row: Array, at: npt.NDArray[np.int64], signal: int) -> int:
    """Double the signal in a row; its size."""
    part = view(row, at, signal)
    for i in range(part.size):
        part[i] *= 2.0
    return int(part.shape[0])


@given(i=st.integers(-3, 2), j=st.integers(-3, 2), k=st.integers(-3, 2), seed=st.integers(0, 1000))
def test_elements_are_those_of_numpy(i: int, j: int, k: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ours = rng.standard_normal(3), rng.standard_normal((3, 3)), rng.standard_normal((3, 3, 3))
    numbers = rng.integers(-5, 5, 3)
    theirs, whole = [one.copy() for one in ours], numbers.copy()
    moved(*ours, i, j, k, numbers)
    a, b, c = theirs
    a[i] += b[j, -1] * c[i, j, k]
    b[i, j] = whole[k] - 1
    c[0, -1, k] = a[-2]
    whole[i] = 3 * whole[-1] + i
    for one, other in zip((*ours, numbers), (*theirs, whole), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("order", ["C", "F", "strided", "single"])
def test_other_orders_and_other_numbers_are_read_as_well(order: str) -> None:
    A = np.arange(24.0).reshape(4, 6)
    A = {"C": A, "F": np.asfortranarray(A), "strided": A[:, ::2], "single": A.astype(np.float32)}[order]
    assert second(A, 2) == A[1, 2] + A[-1, 0]
    assert second(A, -1) == A[1, -1] + A[-1, 0]


def test_functions_that_allocate_keep_numbas_own_elements() -> None:
    np.testing.assert_array_equal(sorted_copy(np.array([2.0, 1.0, 3.0])), [1.0, 2.0, 3.0])


def test_a_signal_is_its_part_of_the_row_and_nothing_else() -> None:
    row, at = np.arange(6.0), np.array([0, 2, 2, 5])
    assert [doubled(row, at, signal) for signal in range(3)] == [2, 0, 3]
    np.testing.assert_array_equal(row, [0.0, 2.0, 4.0, 6.0, 8.0, 5.0])
