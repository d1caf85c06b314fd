"""Slotine-Li adaptation with estimates that stay physical, compiled. It knows no robot: Y is a matrix.

    tau = Y theta_hat + K s,      V = s' M s / 2 + sum_b D(P_b || P_hat_b) / gamma + sum_j theta_tilde_j^2 / (2 gamma_j)

For each body P = [Sigma, mc; mc', m] is its pseudo-inertia: mass and density are possible just where P > 0 (Wensing,
Kim, Slotine 2018, IEEE RA-L 3(1)). With the log-det Bregman divergence `D(P || Q) = log |Q| / |P| + tr(Q^-1 P) - 4`
and L the symmetric matrix of `tr(dP L) = s' Y dtheta`, the natural law of Lee, Kwon, Park 2018 (IEEE/RSJ IROS) is

    P_hat' = gamma P_hat L P_hat,       so that      d/dt D(P || P_hat) = -gamma s' Y (theta - theta_hat)

and V' = -s' K s. Unlike a gradient with a constant matrix it needs no projection onto the cone, one number gamma [1/J]
suits bodies of grams and of tons, and it does not depend on frames or units. The rest, rotors and friction, follows the
plain gradient `theta_hat_j' = gamma_j Y_j' s`, clipped to `0 <= theta_j <= top_j`.

A sample multiplies, it never subtracts: `P = B B'`, `P+ = B E^2 B'` with `E = 1 + X / 2 + X^2 / 8`, which is positive
for every symmetric X, `X = h gamma B' L B`, and agrees with the geodesic `B exp(X) B'` to second order in X.

Leakage (sigma-modification, Ioannou and Kokotovic 1984; times |s| the e-modification of Narendra and Annaswamy 1987)
pulls the dual variable to its start, `d/dt P_hat^-1 = -gamma L + sigma (P_0^-1 - P_hat^-1)`: by the three-point
identity V' gains exactly `-sigma / gamma (D(P || P_hat) + D(P_hat || P_0) - D(P || P_0))`.

Sampling: within one sample the estimate answers s with the torque `h Y Gamma Y' s`, a feedback that is late. All rates
of a sample are multiplied with `eta = min(1, share s' K s / (h s' Y Gamma Y' s))`, so that it stays below a share of
the feedback proper: a normalisation (Ioannou and Sun 1996, Robust Adaptive Control) that is 1 for short samples. Where
it is less, V' = -s' K s + (1 - eta) s' Y theta_tilde, and what holds are the bounds.

Bounds: `P_0 / rho <= P_hat <= rho P_0`. Clipping the eigenvalues of `P_0^-1/2 P_hat P_0^-1/2` is the projection in D,
so it never raises D(P || P_hat) for a P within the bounds.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from ..compiled import compiled
from ..signals import INDEX, Array
from .prediction import Prediction, descend, shortened
from .pseudo_inertia import (
    cholesky,
    clip,
    exponential,
    product,
    sandwich,
    to_matrix,
    to_vector,
    transposed_sandwich,
    within,
)

if TYPE_CHECKING:
    from ..model.regressor import Massless
    from ..signals import IntArray

Z, R, PSI_HAT = INDEX["z"], INDEX["r"], INDEX["psi_hat"]
EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["effective_gain"], INDEX["weight_norm"]
BODY = 10


class Adaptation(NamedTuple):
    """The numbers of an adaptive controller.

    Attributes:
        known: The robot without its masses; `known.Y` (p, k) is written by `model.tree_regressor.regress`.
        gain: (p,) K.
        learning: Off keeps the estimate.
        h: Control period [s].
        tracking: Factor on the gradient of the tracking error, 1 without a prediction error.
        gamma: Rate of the pseudo-inertias [1/J].
        sigma: Leakage [1/s].
        by_error: Whether leakage is multiplied with |s|.
        rho: Bound on the ratio of P_hat to P_0.
        roots: (bodies, 4, 4) lower triangular `P_0 = C C'`.
        inverses: (bodies, 4, 4) `C^-1`.
        rates: (k - 10 bodies,) gamma_j.
        start: (k - 10 bodies,) where leakage pulls the rest of theta.
        top: (k - 10 bodies,) its upper bounds.
        share: Largest answer of a sample, as a share of the feedback.
        stride: Every how many samples `Y' Y` is added to the memory.
        gradient: (k,) memory to work in.
        steps: (bodies, 4, 4) memory to work in.
        rest: (k - 10 bodies,) memory to work in.
        factors: (bodies, 4, 4) memory to work in.
        work: (3, 4, 4) memory to work in.
        prediction: The numbers of the prediction error's term; None without it.
    """

    known: Massless
    gain: Array
    learning: bool
    h: float
    tracking: float
    gamma: float
    sigma: float
    by_error: bool
    rho: float
    roots: Array
    inverses: Array
    rates: Array
    start: Array
    top: Array
    share: float
    stride: int
    gradient: Array
    steps: Array
    rest: Array
    factors: Array
    work: Array
    prediction: Prediction | None


@compiled
def adapt(row: Array, at: IntArray, a: Adaptation, state: Array) -> None:
    """Psi_hat and gain of one sample, then the update of theta.

    Args:
        row: (width,) row of signals; psi_hat, effective_gain and weight_norm are written.
        at: Offsets of the signals.
        a: The numbers of the law.
        state: theta (k,), the number of samples, the sum of `Y' Y` (k, k).
    """
    Y, g = a.known.Y, a.gradient
    p, k = Y.shape
    theta, z, r = state[:k], row[at[Z] : at[Z + 1]], row[at[R] : at[R + 1]]
    square, feedback, first = 0.0, 0.0, BODY * len(a.roots)
    for j in range(k):
        g[j] = 0.0
    for i in range(p):
        s = z[i] if i < z.size else r[i - z.size]
        square += s * s
        feedback += a.gain[i] * s * s
        psi_hat = 0.0
        for j in range(k):
            psi_hat += Y[i, j] * theta[j]
            g[j] += Y[i, j] * s
        row[at[PSI_HAT] + i], row[at[EFFECTIVE_GAIN] + i] = psi_hat, a.gain[i]
    row[at[WEIGHT_NORM]], row[at[WEIGHT_NORM] + 1] = norm(theta[:first]), norm(theta[first:])
    if not a.learning:
        return
    answer = directions(theta, g, a)
    eta = a.tracking
    if eta * answer > a.share * feedback:
        eta = a.share * feedback / answer
    move(theta, eta, a.sigma * math.sqrt(square) if a.by_error else a.sigma, a)
    follow(a.prediction, a, state)
    if int(state[k]) % a.stride == 0:
        gram = state[k + 1 : k + 1 + k * k].reshape((k, k))
        for i in range(p):
            for j in range(k):
                if Y[i, j] != 0.0:
                    for c in range(k):
                        gram[j, c] += Y[i, j] * Y[i, c]
    state[k] += 1.0


@compiled
def directions(theta: Array, gradient: Array, a: Adaptation) -> float:
    """Where a gradient (k,) takes theta in a sample, into `a.steps` and `a.rest`.

    Returns:
        `h gradient' Gamma gradient`.
    """
    total, first = 0.0, BODY * len(a.roots)
    for b in range(len(a.roots)):
        total += direction(theta[BODY * b : BODY * b + BODY], gradient[BODY * b : BODY * b + BODY], a, b)
    for j in range(a.rates.size):
        a.rest[j] = a.h * a.rates[j] * gradient[first + j]
        total += a.rest[j] * gradient[first + j]
    return total


@compiled
def move(theta: Array, eta: float, sigma: float, a: Adaptation) -> None:
    """One sample of theta, along `a.steps` and `a.rest` times eta and back by the leakage."""
    first = BODY * len(a.roots)
    for b in range(len(a.roots)):
        update_body(theta[BODY * b : BODY * b + BODY], eta, sigma, a, b)
    for j in range(a.rates.size):
        value = theta[first + j]
        value += eta * a.rest[j] - a.h * sigma * (value - a.start[j])
        theta[first + j] = min(max(value, 0.0), a.top[j])


@compiled
def follow(prediction: Prediction | None, a: Adaptation, state: Array) -> None:
    """One step down the prediction error, where there is one and it is time for it."""
    if prediction is not None:
        k = a.gradient.size
        if int(state[k]) % prediction.every == 0:
            theta = state[:k]
            for b in range(len(a.roots)):
                factor(theta[BODY * b : BODY * b + BODY], a, b)
            descend(prediction, a, state)
            move(theta, shortened(prediction.step, a), 0.0, a)


@compiled
def norm(vector: Array) -> float:
    """Length of a vector."""
    total = 0.0
    for i in range(vector.size):
        total += vector[i] * vector[i]
    return math.sqrt(total)


@compiled
def factor(theta: Array, a: Adaptation, b: int) -> None:
    """Lower triangular B of body b, `P = C B B' C'` with `P_0 = C C'`."""
    Q, half = a.work[0], a.work[1]
    to_matrix(theta, 1.0, a.factors[b])
    sandwich(a.inverses[b], a.factors[b], half, Q)
    cholesky(Q, a.factors[b])


@compiled
def direction(theta: Array, gradient: Array, a: Adaptation, b: int) -> float:
    """Where body b goes, `X = h gamma B' L B` with `P = B B'` in the coordinates where P_0 is the identity.

    Returns:
        `|X|^2 / (h gamma)`, its part in `h s' Y Gamma Y' s`.
    """
    Q, L, X = a.work[0], a.work[1], a.steps[b]
    factor(theta, a, b)
    to_matrix(gradient, 0.5, X)
    transposed_sandwich(a.roots[b], X, Q, L)
    transposed_sandwich(a.factors[b], L, Q, X)
    total = 0.0
    for i in range(4):
        for j in range(4):
            total += X[i, j] * X[i, j]
            X[i, j] *= a.h * a.gamma
    return a.h * a.gamma * total


@compiled
def update_body(theta: Array, eta: float, sigma: float, a: Adaptation, b: int) -> None:
    """One sample of body b, along its direction times eta and back by the leakage."""
    Q, L, X, B, half = a.work[0], a.work[1], a.steps[b], a.factors[b], a.work[2]
    product(B.T, B, L)
    for i in range(4):
        for j in range(4):
            X[i, j] = eta * X[i, j] - a.h * sigma * (L[i, j] - (1.0 if i == j else 0.0))
    exponential(X, L)
    product(B, L, X)
    product(X, X.T, Q)
    if not within(Q, a.rho, L, half):
        clip(Q, a.rho, L, half)
    sandwich(a.roots[b], Q, L, X)
    to_vector(X, theta)
