"""The elementary functions for every number of an array; numpy's vectorised ones differ by processor."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..compiled import compiled
from . import angles, exponentials, two_doubles

Array = NDArray[np.float64]


@compiled
def fill_cos_sin(x: Array, cosine: Array, sine: Array) -> None:
    """Cosines and sines of x."""
    for i in range(x.size):
        cosine[i], sine[i] = angles.cos_sin(x[i])


@compiled
def fill_exp(x: Array, out: Array) -> None:
    """Exponentials of x."""
    for i in range(x.size):
        out[i] = exponentials.exp(x[i])


@compiled
def fill_tanh(x: Array, out: Array) -> None:
    """Hyperbolic tangents of x."""
    for i in range(x.size):
        out[i] = exponentials.tanh(x[i])


@compiled
def fill_hypot(x: Array, y: Array, out: Array) -> None:
    """Lengths of (x, y)."""
    for i in range(x.size):
        out[i] = two_doubles.hypot(x[i], y[i])


@compiled
def fill_atan2(y: Array, x: Array, out: Array) -> None:
    """Angles of (x, y)."""
    for i in range(x.size):
        out[i] = angles.atan2(y[i], x[i])


def filled(fill: Callable[..., None], count: int, *given: ArrayLike) -> list[Array]:
    """New arrays, `count` of them in the broadcast shape of the given ones, filled by a loop over their numbers."""
    arrays = np.broadcast_arrays(*(np.asarray(one, float) for one in given))
    out = [np.empty(arrays[0].shape) for _ in range(count)]
    fill(*(np.array(one).ravel() for one in arrays), *(one.reshape(-1) for one in out))
    return out


def cos_sin(x: ArrayLike) -> tuple[Array, Array]:
    """Cosines and sines of angles [rad]."""
    cosine, sine = filled(fill_cos_sin, 2, x)
    return cosine, sine


def cos(x: ArrayLike) -> Array:
    """Cosines of angles [rad]."""
    return cos_sin(x)[0]


def sin(x: ArrayLike) -> Array:
    """Sines of angles [rad]."""
    return cos_sin(x)[1]


def exp(x: ArrayLike) -> Array:
    """`e^x`."""
    return filled(fill_exp, 1, x)[0]


def tanh(x: ArrayLike) -> Array:
    """Hyperbolic tangents."""
    return filled(fill_tanh, 1, x)[0]


def hypot(x: ArrayLike, y: ArrayLike) -> Array:
    """`sqrt(x^2 + y^2)`."""
    return filled(fill_hypot, 1, x, y)[0]


def atan2(y: ArrayLike, x: ArrayLike) -> Array:
    """Angles of the points (x, y) [rad]."""
    return filled(fill_atan2, 1, y, x)[0]


@compiled
def is_below(x: Array, most: float) -> bool:
    """Whether all numbers are smaller than one, whatever their signs; false where one is none."""
    fine = True
    for i in range(x.size):
        fine = fine and abs(x[i]) < most
    return fine


@compiled
def fill_unwrapped(x: Array, out: Array) -> None:
    """Every angle of a series at the turn nearest to the last finite one before it."""
    near = math.nan
    for i in range(x.size):
        out[i] = angles.nearest_turn(x[i], near) if math.isfinite(near) else x[i]
        near = out[i] if math.isfinite(out[i]) else near


def unwrapped(x: ArrayLike) -> Array:
    """A series of angles (N,) without the turns that an encoder leaves out [rad]; what is not finite stays so."""
    given = np.array(x, float)
    out = np.empty_like(given)
    fill_unwrapped(given, out)
    return out
