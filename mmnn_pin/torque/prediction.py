"""The prediction error of filtered torque, with a memory, compiled. It knows no robot: Y is a matrix.

The filtered regressor and torque of `filtered` obey `Y_f theta = y_f` whatever the motion, so what they leave,
`y_f - Y_f theta_hat`, tells of theta without any tracking error. Kreisselmeier's integrals (1977, IEEE TAC 22(1))

    Q' = (Y_f' R Y_f - Q) / T,      b' = (Y_f' R y_f - b) / T,      so that      b - Q theta_hat = Q (theta - theta_hat)

keep what has been seen for a time T. With R = K^-1 a torque counts as the velocity error that it costs under the
feedback, `Q theta_tilde` has the unit of `Y' s`, and one factor c suits newtons and newton metres.
"""

from __future__ import annotations

from typing import NamedTuple

from ..compiled import compiled
from ..signals import Array
from .filtered import Filter


class Prediction(NamedTuple):
    """The numbers of a prediction error's term.

    Attributes:
        filter: The filter of regressor and torque.
        first: Where its memory starts; behind it stand Q (k, k) and b (k,).
        trust: (p,) diagonal of R.
        weight: c.
        keep: `exp(-period / T)` of the period between two steps.
        every: Samples between two steps.
        gradient: (k,) written: `Q (theta - theta_hat)`.
        velocity: (k,) memory to work in.
    """

    filter: Filter
    first: int
    trust: Array
    weight: float
    keep: float
    every: int
    gradient: Array
    velocity: Array


@compiled
def gather(p: Prediction, memory: Array) -> None:
    """Take the filtered regressor and torque into Q and b."""
    k, m = p.gradient.size, p.trust.size
    start = places(p)
    Y, y = memory[start - m * (k + 1) : start - m].reshape((m, k)), memory[start - m : start]
    Q, b = memory[start : start + k * k].reshape((k, k)), memory[start + k * k : start + k * k + k]
    for j in range(k):
        b[j] *= p.keep
        for c in range(k):
            Q[j, c] *= p.keep
    for i in range(m):
        share = (1.0 - p.keep) * p.trust[i]
        for j in range(k):
            if Y[i, j] != 0.0:
                b[j] += share * Y[i, j] * y[i]
                for c in range(k):
                    Q[j, c] += share * Y[i, j] * Y[i, c]


@compiled
def places(p: Prediction) -> int:
    """Where Q starts in the memory."""
    m, n, k = p.trust.size, p.filter.q.size, p.gradient.size
    return p.first + 2 + 4 * m + 2 * n + m * k + m


@compiled
def remaining(p: Prediction, theta: Array, memory: Array) -> None:
    """`b - Q theta`, into p.gradient."""
    k, start = theta.size, places(p)
    for j in range(k):
        total = memory[start + k * k + j]
        for c in range(k):
            total -= memory[start + j * k + c] * theta[c]
        p.gradient[j] = total


@compiled
def curvature(p: Prediction, memory: Array) -> float:
    """`v' Q v` of p.velocity."""
    k, start, total = p.velocity.size, places(p), 0.0
    for j in range(k):
        for c in range(k):
            total += p.velocity[j] * memory[start + j * k + c] * p.velocity[c]
    return total
