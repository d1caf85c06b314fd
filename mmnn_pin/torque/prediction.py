"""The prediction error of filtered torque, with a memory, compiled. It knows no robot: Y is a matrix.

The filtered regressor and torque of `filtered` obey `Y_f theta = y_f` whatever the motion, so what they leave,
`y_f - Y_f theta_hat`, tells of theta without any tracking error. Kreisselmeier's integrals (1977, IEEE TAC 22(1))

    Q' = (Y_f' R Y_f - Q) / T,      b' = (Y_f' R y_f - b) / T,      so that      b - Q theta_hat = Q (theta - theta_hat)

keep what has been seen for a time T. With R = K^-1 a torque counts as the velocity error that it costs under the
feedback, `Q theta_tilde` has the unit of `Y' s`, and one factor c suits newtons and newton metres.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from ..compiled import compiled
from ..signals import Array
from .filtered import Filter
from .pseudo_inertia import sandwich, to_matrix, to_vector, transposed_sandwich

if TYPE_CHECKING:
    from .adaptation import Adaptation

ITERATIONS = 12  # of conjugate gradients in a step
ENOUGH = 1e-8  # share of the residual's square at which they end
LARGEST = 0.3  # by which a step may change a body, relative to itself


class Prediction(NamedTuple):
    """The numbers of a prediction error's term.

    Attributes:
        filter: The filter of regressor and torque.
        first: Where its memory starts; behind it stand Q (k, k) and b (k,).
        trust: (p,) diagonal of R.
        weight: c times the time between two steps [s].
        keep: `exp(-period / T)` of the period between two steps.
        every: Samples between two steps.
        gradient: (k,) memory to work in.
        velocity: (k,) memory to work in.
        step: (16 bodies + rest,) written: y.
        work: (3, 16 bodies + rest) memory to work in.
    """

    filter: Filter
    first: int
    trust: Array
    weight: float
    keep: float
    every: int
    gradient: Array
    velocity: Array
    step: Array
    work: Array


@compiled
def gather(p: Prediction, state: Array) -> None:
    """Take the filtered regressor and torque into Q and b."""
    k, m = p.gradient.size, p.trust.size
    start = places(p)
    Y, y = state[start - m * (k + 1) : start - m].reshape((m, k)), state[start - m : start]
    Q, b = state[start : start + k * k].reshape((k, k)), state[start + k * k : start + k * k + k]
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
def descend(p: Prediction, a: Adaptation, state: Array) -> None:
    """One step down the prediction error, into p.step; `a.factors` belong to the theta in the memory.

    With `Gamma = S S'` it is the implicit Euler step of `theta' = c Gamma (b - Q theta)` over the time tau since the
    last, `theta+ = theta + S y`, `(1 + c tau S' Q S) y = c tau S' (b - Q theta)`, by conjugate gradients from y = 0.
    It does not overshoot for any c tau, and excited directions of all sizes take their full part in it.
    """
    k, n = p.gradient.size, p.step.size
    y, residual, direction, image = p.step, p.work[0], p.work[1], p.work[2]
    start = places(p)
    Q, b = state[start : start + k * k].reshape((k, k)), state[start + k * k : start + k * k + k]
    times(Q, state[:k], p.gradient)
    for j in range(k):
        p.gradient[j] = b[j] - p.gradient[j]
    pulled(p.gradient, a, residual)
    square = 0.0
    for i in range(n):
        residual[i] *= p.weight
        y[i], direction[i] = 0.0, residual[i]
        square += residual[i] * residual[i]
    enough = ENOUGH * square
    for _ in range(ITERATIONS):
        if not square > enough:
            break
        pushed(direction, a, p.velocity)
        times(Q, p.velocity, p.gradient)
        pulled(p.gradient, a, image)
        bend = 0.0
        for i in range(n):
            image[i] = direction[i] + p.weight * image[i]
            bend += direction[i] * image[i]
        length, before, square = square / bend, square, 0.0
        for i in range(n):
            y[i] += length * direction[i]
            residual[i] -= length * image[i]
            square += residual[i] * residual[i]
        for i in range(n):
            direction[i] = residual[i] + square / before * direction[i]


@compiled
def times(Q: Array, x: Array, out: Array) -> None:
    """`Q x` of a symmetric Q (k, k)."""
    for j in range(x.size):
        out[j] = 0.0
    for i in range(x.size):
        if x[i] != 0.0:
            for j in range(x.size):
                out[j] += Q[i, j] * x[i]


@compiled
def pushed(y: Array, a: Adaptation, theta: Array) -> None:
    """`S y`: sixteen numbers of a symmetric matrix per body and one per parameter of the rest, to (k,)."""
    half, X, root = a.work[0], a.work[1], math.sqrt(a.gamma)
    for b in range(len(a.roots)):
        sandwich(a.factors[b], y[16 * b : 16 * b + 16].reshape((4, 4)), half, X)
        sandwich(a.roots[b], X, half, a.work[2])
        to_vector(a.work[2], theta[10 * b : 10 * b + 10])
        for j in range(10 * b, 10 * b + 10):
            theta[j] *= root
    for j in range(a.rates.size):
        theta[10 * len(a.roots) + j] = math.sqrt(a.rates[j]) * y[16 * len(a.roots) + j]


@compiled
def pulled(gradient: Array, a: Adaptation, y: Array) -> None:
    """`S' gradient`, of the shape that `pushed` takes."""
    half, L, X, root = a.work[0], a.work[1], a.work[2], math.sqrt(a.gamma)
    for b in range(len(a.roots)):
        to_matrix(gradient[10 * b : 10 * b + 10], 0.5, L)
        transposed_sandwich(a.roots[b], L, half, X)
        out = y[16 * b : 16 * b + 16].reshape((4, 4))
        transposed_sandwich(a.factors[b], X, half, out)
        for i in range(4):
            for j in range(4):
                out[i, j] *= root
    for j in range(a.rates.size):
        y[16 * len(a.roots) + j] = math.sqrt(a.rates[j]) * gradient[10 * len(a.roots) + j]


@compiled
def shortened(y: Array, a: Adaptation) -> float:
    """The step y as `a.steps` and `a.rest`, and the factor that lets no body change by more than `LARGEST`."""
    eta, root = 1.0, math.sqrt(a.gamma)
    for b in range(len(a.roots)):
        square = 0.0
        for i in range(4):
            for j in range(4):
                a.steps[b, i, j] = root * y[16 * b + 4 * i + j]
                square += a.steps[b, i, j] ** 2
        eta = min(eta, LARGEST / math.sqrt(square) if square > 0.0 else 1.0)
    for j in range(a.rates.size):
        a.rest[j] = math.sqrt(a.rates[j]) * y[16 * len(a.roots) + j]
    return eta
