"""Pseudo-inertias `P = [Sigma, mc; mc', m]` of bodies: their arithmetic, and the geometry in which estimates move.

Mass and density of a body are possible just where P > 0 (Wensing, Kim, Slotine 2018, IEEE RA-L 3(1)). An estimate moves
along `P L P` (Lee, Kwon, Park 2018, IEEE/RSJ IROS), with L the symmetric matrix of `tr(dP L) = gradient' dtheta`: no
constant matrix is needed, and no projection onto the cone. A step multiplies, it never subtracts: `P = B B'`,
`P+ = B E^2 B'` with `E = 1 + X / 2 + X^2 / 8`, positive for every symmetric X, which agrees with the geodesic
`B exp(X) B'` to second order in X. Bounds are `least P_0 <= P <= most P_0`: the eigenvalues of `P_0^-1/2 P P_0^-1/2`
are clipped. Compiled, and it knows no robot; parameters that are of no body follow the plain gradient, clipped to
`0 <= theta_j <= top_j`.

With N, the inverse of this metric Gamma, and a constant information Lambda of the parameters, an estimate that begins
with a fit moves along `(N + Lambda)^-1 gradient`: the metric of the sum of both potentials, see `torque.adaptive`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compiled import compiled, internal
from ..elementary import matrices
from ..signals import Array

BODY = 10  # numbers of a body
SWEEPS = 12  # of Jacobi's eigenvalue iteration, of which a 4 x 4 matrix needs about 5
LARGEST = 0.3  # by which an implicit step may change a body, relative to itself
ROW, COLUMN = (3, 0, 1, 2, 0, 0, 0, 1, 1, 2), (3, 3, 3, 3, 0, 1, 2, 1, 2, 2)  # of a body's numbers in P
FLOOR = 1e-4  # least share of the prior that a nominal body keeps: massless and flat ones have no density


class Bodies(NamedTuple):
    """The metric in which an estimate theta (k,) of bodies and other parameters moves."""

    h: float  # control period [s]
    gamma: Array  # (bodies,) rates of the pseudo-inertias [1/J]
    least: float  # bound below on the ratio of P to P_0
    most: Array  # (bodies,) bound above on it
    roots: Array  # (bodies, 4, 4) lower triangular `P_0 = C C'` [root of kg, kg m, kg m^2]
    inverses: Array  # (bodies, 4, 4) `C^-1` [the inverse of these]
    rates: Array  # (k - 10 bodies,) gamma_j of the rest of theta [units of theta_j^2 over J]
    start: Array  # (k - 10 bodies,) where leakage pulls the rest of theta
    top: Array  # (k - 10 bodies,) its upper bounds [kg m^2 or kg; N s/m, N m s/rad; N m, N]
    steps: Array  # (bodies, 4, 4) written: where a gradient takes the bodies
    rest: Array  # (k - 10 bodies,) written: and the rest
    factors: Array  # (bodies, 4, 4) written: B of every body, in the coordinates where P_0 is the identity
    work: Array  # (3, 4, 4) room to work in
    known: Array  # (k, k) Lambda; (0, 0) where nothing is known of the start
    system: Array  # (k, k) room to work in, like known
    column: Array  # (k,) room to work in


@internal
def directions(theta: Array, gradient: Array, a: Bodies) -> float:
    """Where a gradient (k,) takes theta in a sample, into `a.steps` and `a.rest`.

    Returns:
        `h gradient' Gamma gradient`.
    """
    total, first = 0.0, BODY * len(a.roots)
    if a.known.size:
        for b in range(len(a.roots)):
            factor(theta[BODY * b : BODY * b + BODY], a, b)
        inform(theta, gradient, a.h, a, a.known, 0.0)
        for j in range(theta.size):
            total += gradient[j] * a.column[j]
        return total
    for b in range(len(a.roots)):
        total += direction(theta[BODY * b : BODY * b + BODY], gradient[BODY * b : BODY * b + BODY], a, b)
    for j in range(a.rates.size):
        a.rest[j] = a.h * a.rates[j] * gradient[first + j]
        total += a.rest[j] * gradient[first + j]
    return total


@internal
def inform(theta: Array, gradient: Array, size: float, a: Bodies, Q: Array, weight: float) -> None:
    """`(N + Lambda + weight Q)^-1 size gradient` into `a.column`, `a.steps` and `a.rest`; `a.factors` belong to theta.

    Parameters with the rate 0 stay.
    """
    k, first, S = theta.size, BODY * len(a.roots), a.system
    for i in range(k):
        a.column[i] = size * gradient[i]
        for j in range(k):
            S[i, j] = a.known[i, j] + weight * Q[i, j]
    for b in range(len(a.roots)):
        P = a.work[0]
        inward(a, b)
        product(a.work[1].T, a.work[1], P)  # P^-1
        for i in range(BODY):
            for j in range(BODY):
                one = P[ROW[i], COLUMN[j]] * P[COLUMN[i], ROW[j]] + P[ROW[i], ROW[j]] * P[COLUMN[i], COLUMN[j]]
                half = (0.5 if ROW[i] == COLUMN[i] else 1.0) * (0.5 if ROW[j] == COLUMN[j] else 1.0)
                S[BODY * b + i, BODY * b + j] += 2.0 * half * one / a.gamma[b]
    for j in range(a.rates.size):
        if a.rates[j] > 0.0:
            S[first + j, first + j] += 1.0 / a.rates[j]
        else:
            a.column[first + j] = 0.0
            for i in range(k):
                S[first + j, i] = S[i, first + j] = 1.0 if i == first + j else 0.0
    solved(S, a.column)
    for b in range(len(a.roots)):
        inward(a, b)
        to_matrix(a.column[BODY * b : BODY * b + BODY], 1.0, a.work[0])
        sandwich(a.work[1], a.work[0], a.work[2], a.steps[b])
    for j in range(a.rates.size):
        a.rest[j] = a.column[first + j]


@compiled
def inward(a: Bodies, b: int) -> None:
    """`B^-1 C^-1` of body b, `P = C B B' C'`, into `a.work[1]`."""
    M, B = a.work[1], a.factors[b]
    for j in range(4):
        for i in range(4):
            total = a.inverses[b, i, j]
            for c in range(i):
                total -= B[i, c] * M[c, j]
            M[i, j] = total / B[i, i]


@compiled
def solved(S: Array, x: Array) -> None:
    """`S^-1 x` in place for a symmetric positive definite S (k, k), by Cholesky's factor, which is written into S."""
    k = x.size
    for j in range(k):
        pivot = math.sqrt(S[j, j])
        for c in range(j, k):
            S[j, c] /= pivot
        for i in range(j + 1, k):
            share = S[j, i]
            for c in range(i, k):
                S[i, c] -= share * S[j, c]
    for i in range(k):
        x[i] /= S[i, i]
        for c in range(i + 1, k):
            x[c] -= S[i, c] * x[i]
    for i in range(k - 1, -1, -1):
        for c in range(i + 1, k):
            x[i] -= S[i, c] * x[c]
        x[i] /= S[i, i]


@internal
def move(theta: Array, eta: float, sigma: float, a: Bodies) -> None:
    """One sample of theta, along `a.steps` and `a.rest` times eta and back by the leakage."""
    first = BODY * len(a.roots)
    for b in range(len(a.roots)):
        update_body(theta[BODY * b : BODY * b + BODY], eta, sigma, a, b)
    for j in range(a.rates.size):
        value = theta[first + j]
        value += eta * a.rest[j] - a.h * sigma * (value - a.start[j])
        theta[first + j] = min(max(value, 0.0), a.top[j])


@compiled
def factor(theta: Array, a: Bodies, b: int) -> None:
    """Lower triangular B of body b, `P = C B B' C'` with `P_0 = C C'`."""
    Q, half = a.work[0], a.work[1]
    to_matrix(theta, 1.0, a.factors[b])
    sandwich(a.inverses[b], a.factors[b], half, Q)
    cholesky(Q, a.factors[b])


@internal
def direction(theta: Array, gradient: Array, a: Bodies, b: int) -> float:
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
            X[i, j] *= a.h * a.gamma[b]
    return a.h * a.gamma[b] * total


@internal
def update_body(theta: Array, eta: float, sigma: float, a: Bodies, b: int) -> None:
    """One sample of body b, along its direction times eta and back by the leakage."""
    Q, L, X, B, half = a.work[0], a.work[1], a.steps[b], a.factors[b], a.work[2]
    product(B.T, B, L)
    for i in range(4):
        for j in range(4):
            X[i, j] = eta * X[i, j] - a.h * sigma * (L[i, j] - (1.0 if i == j else 0.0))
    exponential(X, L)
    product(B, L, X)
    product(X, X.T, Q)
    if not within(Q, a.least, a.most[b], L, half):
        clip(Q, a.least, a.most[b], L, half)
    sandwich(a.roots[b], Q, L, X)
    to_vector(X, theta)


@compiled
def to_matrix(theta: Array, share: float, P: Array) -> None:
    """`[Sigma, mc; mc', m]` of `m, mc, xx xy xz yy yz zz`; entries beside the diagonal times share."""
    P[3, 3], P[0, 0], P[1, 1], P[2, 2] = theta[0], theta[4], theta[7], theta[9]
    for i in range(3):
        P[i, 3] = P[3, i] = share * theta[1 + i]
    P[0, 1] = P[1, 0] = share * theta[5]
    P[0, 2] = P[2, 0] = share * theta[6]
    P[1, 2] = P[2, 1] = share * theta[8]


@compiled
def to_vector(P: Array, theta: Array) -> None:
    """The ten numbers of a pseudo-inertia."""
    theta[0] = P[3, 3]
    theta[1], theta[2], theta[3] = P[0, 3], P[1, 3], P[2, 3]
    theta[4], theta[5], theta[6] = P[0, 0], P[0, 1], P[0, 2]
    theta[7], theta[8], theta[9] = P[1, 1], P[1, 2], P[2, 2]


@compiled
def product(A: Array, B: Array, out: Array) -> None:
    """`A B`, 4 x 4."""
    for i in range(4):
        for j in range(4):
            total = 0.0
            for c in range(4):
                total += A[i, c] * B[c, j]
            out[i, j] = total


@compiled
def sandwich(A: Array, S: Array, half: Array, out: Array) -> None:
    """`A S A'`, 4 x 4."""
    product(A, S, half)
    product(half, A.T, out)


@compiled
def transposed_sandwich(A: Array, S: Array, half: Array, out: Array) -> None:
    """`A' S A`, 4 x 4."""
    product(S, A, half)
    product(A.T, half, out)


@compiled
def cholesky(S: Array, B: Array) -> bool:
    """Lower triangular `S = B B'`, 4 x 4; False, and B is incomplete, where S is not positive definite."""
    for i in range(4):
        for j in range(i + 1, 4):
            B[i, j] = 0.0
    for j in range(4):
        total = S[j, j]
        for c in range(j):
            total -= B[j, c] * B[j, c]
        if not total > 0.0:
            return False
        B[j, j] = math.sqrt(total)
        for i in range(j + 1, 4):
            total = S[i, j]
            for c in range(j):
                total -= B[i, c] * B[j, c]
            B[i, j] = total / B[j, j]
    return True


@internal
def exponential(X: Array, E: Array) -> None:
    """`1 + X / 2 + X^2 / 8`, positive definite for every symmetric X (4 x 4), about `exp(X / 2)`."""
    product(X, X, E)
    for i in range(4):
        for j in range(4):
            E[i, j] = (1.0 if i == j else 0.0) + 0.5 * X[i, j] + 0.125 * E[i, j]


@compiled
def within(Q: Array, least: float, most: float, shifted: Array, B: Array) -> bool:
    """Whether all eigenvalues of Q lie between two bounds."""
    for i in range(4):
        for j in range(4):
            shifted[i, j] = Q[i, j] - (least if i == j else 0.0)
    if not cholesky(shifted, B):
        return False
    for i in range(4):
        for j in range(4):
            shifted[i, j] = (most if i == j else 0.0) - Q[i, j]
    return bool(cholesky(shifted, B))


@internal
def clip(Q: Array, least: float, most: float, U: Array, half: Array) -> None:
    """Put the eigenvalues of Q between two bounds, by Jacobi's rotations."""
    for i in range(4):
        for j in range(4):
            U[i, j] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        for i in range(3):
            for j in range(i + 1, 4):
                rotate(Q, U, i, j)
    for i in range(4):
        value = min(max(Q[i, i], least), most)
        for j in range(4):
            half[j, i] = U[j, i] * value
    product(half, U.T, Q)


@compiled
def rotate(Q: Array, U: Array, i: int, j: int) -> None:
    """Rotation in the plane i, j that makes `Q_ij` zero; U collects the rotations."""
    if Q[i, j] == 0.0:
        return
    slope = (Q[j, j] - Q[i, i]) / (2.0 * Q[i, j])
    t = (1.0 if slope >= 0.0 else -1.0) / (abs(slope) + math.sqrt(slope * slope + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    for n in range(4):
        a, b = Q[n, i], Q[n, j]
        Q[n, i], Q[n, j] = c * a - s * b, s * a + c * b
        a, b = U[n, i], U[n, j]
        U[n, i], U[n, j] = c * a - s * b, s * a + c * b
    for n in range(4):
        a, b = Q[i, n], Q[j, n]
        Q[i, n], Q[j, n] = c * a - s * b, s * a + c * b


def pseudo_inertias(theta: Array) -> Array:
    """Pseudo-inertias of the inertial parameters, (bodies, 4, 4)."""
    matrices = np.zeros((theta.size // BODY, 4, 4))
    for P, numbers in zip(matrices, theta.reshape(-1, BODY), strict=True):
        to_matrix(numbers, 1.0, P)
    return matrices


def vector_of(P: Array) -> Array:
    """The ten numbers of a pseudo-inertia."""
    theta = np.zeros(BODY)
    to_vector(P, theta)
    return theta


def natural(P: Array) -> Array:
    """The metric of a body at its pseudo-inertia, (10, 10): `P L P` of every gradient."""
    r, c = ROW, COLUMN
    return np.asarray(0.5 * (P[np.ix_(r, r)] * P[np.ix_(c, c)] + P[np.ix_(r, c)] * P[np.ix_(c, r)]))


def lifted(P: Array, prior: Array) -> Array:
    """A pseudo-inertia with at least `FLOOR` times a prior, in every direction in which it has less."""
    root = matrices.cholesky(prior)
    inward = matrices.inverse(root)
    Q = matrices.product(inward, P, inward.T)
    image, _, vectors = matrices.svd((Q + Q.T) / 2)
    values = np.maximum((vectors * image).sum(axis=0), FLOOR)
    back = matrices.product(root, vectors)
    return matrices.product(back * values, back.T)
