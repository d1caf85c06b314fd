"""A covariance kept as factors, `P = U D U'`: positive definite for ever, whatever is measured. Compiled.

U is unit upper triangular and D diagonal. A measurement multiplies every D_j with a ratio of positive numbers and never
subtracts (Bierman 1977, Factorization Methods for Discrete Sequential Estimation); variance is added by the algorithm
of Agee and Turner that he gives. So no number of updates makes P indefinite, which rounding does to P itself. Column j
of U stands in row j of the array: `U[j, i] = U_ij` for i < j; the rest of the array is not used.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import compiled, internal
from ..signals import Array

NEGLIGIBLE = 1e-24  # of a variance, or of the largest mean square of a feature, below which it is none
CERTAIN = 1e12  # an equation that would lower its own variance by more than this is not taken: the data are no data


@compiled
def left(Phi: Array, U: Array, D: Array, f: Array) -> float:
    """`sum over rows of phi' P phi` of features (rows, k); f (k,) is room to work in."""
    total = 0.0
    for i in range(Phi.shape[0]):
        for j in range(D.size):
            f[j] = Phi[i, j] + dot(U[j], Phi[i], j)
            total += f[j] * D[j] * f[j]
    return total


@compiled
def dot(a: Array, b: Array, size: int) -> float:
    """`a' b` over the first `size` numbers, in four sums at a time."""
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    whole = size - size % 4
    for i in range(0, whole, 4):
        s0 += a[i] * b[i]
        s1 += a[i + 1] * b[i + 1]
        s2 += a[i + 2] * b[i + 2]
        s3 += a[i + 3] * b[i + 3]
    for i in range(whole, size):
        s0 += a[i] * b[i]
    return (s0 + s1) + (s2 + s3)


@internal
def measure(U: Array, D: Array, phi: Array, noise: float, f: Array, b: Array) -> float:
    """P after `y = phi' w + v` was measured, `P - P phi phi' P / (noise + phi' P phi)`, in place.

    Args:
        U: (k, k) factors, see above.
        D: (k,) factors.
        phi: (k,) features.
        noise: Variance of v, > 0.
        f: (k,) room to work in.
        b: (k,) written: `P phi` of the P before; divided by what is returned it is the Kalman gain.

    Returns:
        `noise + phi' P phi` of the P before; 0 for an equation that was not taken.
    """
    total = noise
    for j in range(D.size):
        f[j] = phi[j] + dot(U[j], phi, j)
        total += f[j] * D[j] * f[j]
    if not total < CERTAIN * noise:
        return 0.0
    alpha = noise
    for j in range(D.size):
        v, before, u = D[j] * f[j], alpha, U[j]
        alpha += f[j] * v
        D[j] *= before / alpha
        share = f[j] / before
        for i in range(j):
            old, bi = u[i], b[i]
            u[i] = old - share * bi
            b[i] = bi + v * old
        b[j] = v
    return alpha


@compiled
def add(U: Array, D: Array, place: int, variance: float, x: Array) -> None:
    """P with a variance >= 0 added at one place of its diagonal, in place; x (k,) is room to work in."""
    for i in range(place):
        x[i] = 0.0
    x[place] = 1.0
    for j in range(place, -1, -1):
        s, u, before = x[j], U[j], D[j]
        after = before + variance * s * s
        if not after > 0.0:
            continue
        share = variance * s / after
        D[j] = after
        variance *= before / after
        for i in range(j):
            x[i] -= s * u[i]
            u[i] += share * x[i]


@compiled
def times(U: Array, D: Array, g: Array, out: Array) -> None:
    """`P g` (k,) into out."""
    for j in range(D.size):
        t = D[j] * (g[j] + dot(U[j], g, j))
        u = U[j]
        for i in range(j):
            out[i] += t * u[i]
        out[j] = t


@internal
def covariance(Phi: Array, U: Array, D: Array, image: Array, S: Array) -> None:
    """`Phi P Phi'` (p, p) of features (p, k) into S; image (k,) is room to work in."""
    for i in range(Phi.shape[0]):
        times(U, D, Phi[i], image)
        for j in range(Phi.shape[0]):
            S[i, j] = dot(Phi[j], image, D.size)


@compiled
def variance(U: Array, D: Array, place: int) -> float:
    """P at one place of its diagonal."""
    total = D[place]
    for j in range(place + 1, D.size):
        total += U[j, place] * U[j, place] * D[j]
    return total


@compiled
def quadratic(a: Array, scale: Array) -> float:
    """`sum a_j^2 scale_j`; inf where that is too large for a number."""
    total = 0.0
    for j in range(a.size):
        total += a[j] * a[j] * scale[j]
    return total if not math.isnan(total) else math.inf


def factors(P: Array) -> tuple[Array, Array]:
    """U (k, k) and D (k,) of `P = U D U'`, U as `torque.linear` keeps it; P is positive semidefinite."""
    rest, k = P.copy(), len(P)
    U, D = np.zeros((k, k)), np.zeros(k)
    for j in range(k - 1, -1, -1):
        if rest[j, j] <= NEGLIGIBLE * P[j, j]:
            continue
        D[j] = rest[j, j]
        U[j, :j] = rest[:j, j] / D[j]
        rest[:j, :j] -= D[j] * np.outer(U[j, :j], U[j, :j])
    return U, D
