"""Arithmetic of 4 x 4 pseudo-inertias `[Sigma, mc; mc', m]`, compiled; it knows no robot."""

from __future__ import annotations

import math

from ..compiled import compiled
from ..signals import Array

SWEEPS = 12  # of Jacobi's eigenvalue iteration, of which a 4 x 4 matrix needs about 5


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


@compiled
def exponential(X: Array, E: Array) -> None:
    """`1 + X / 2 + X^2 / 8`, positive definite for every symmetric X (4 x 4), about `exp(X / 2)`."""
    product(X, X, E)
    for i in range(4):
        for j in range(4):
            E[i, j] = (1.0 if i == j else 0.0) + 0.5 * X[i, j] + 0.125 * E[i, j]


@compiled
def within(Q: Array, rho: float, shifted: Array, B: Array) -> bool:
    """Whether all eigenvalues of Q lie between 1 / rho and rho."""
    for i in range(4):
        for j in range(4):
            shifted[i, j] = Q[i, j] - (1.0 / rho if i == j else 0.0)
    if not cholesky(shifted, B):
        return False
    for i in range(4):
        for j in range(4):
            shifted[i, j] = (rho if i == j else 0.0) - Q[i, j]
    return bool(cholesky(shifted, B))


@compiled
def clip(Q: Array, rho: float, U: Array, half: Array) -> None:
    """Put the eigenvalues of Q between 1 / rho and rho, by Jacobi's rotations."""
    for i in range(4):
        for j in range(4):
            U[i, j] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        for i in range(3):
            for j in range(i + 1, 4):
                rotate(Q, U, i, j)
    for i in range(4):
        value = min(max(Q[i, i], 1.0 / rho), rho)
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
