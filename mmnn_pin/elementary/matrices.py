"""Small matrices in plain arithmetic: the same bits on every processor.

A BLAS chooses its kernels by the processor, and what numpy, scipy and LAPACK build on it (`@` among them) differs in
the last places. What reaches a run's motion is computed here, once before the run, by numpy's arithmetic on single
numbers, which rounds every product and every sum. What is only judged or printed may use `numpy.linalg`.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import Array

SWEEPS = 60  # of Jacobi's rotations at most; about ten are needed
ALIGNED = 1e-15  # cosine of the angle between two columns that counts as orthogonal
TERMS = 18  # of the exponential's series, at a norm of 1/2 to 1e-23


def product(*factors: ArrayLike) -> Array:
    """`A B C ...` from left to right, the last one a matrix or a vector; sums run in the order of the index."""
    total = np.asarray(factors[0], float)
    for factor in factors[1:]:
        other = np.asarray(factor, float)
        left = total[..., None] if other.ndim > 1 else total
        total = np.zeros(total.shape[:-1] + other.shape[1:])
        for k in range(len(other)):
            total = total + (left[..., k, :] if other.ndim > 1 else left[..., k]) * other[k]
    return total


def length(vector: ArrayLike) -> float:
    """`sqrt(x' x)`."""
    x = np.ravel(vector)
    return math.sqrt(float(product(x, x)))


def cholesky(A: ArrayLike) -> Array:
    """Lower triangular L with `L L' = A`, of a symmetric positive definite matrix; nan where it is none."""
    rest = np.array(A, float)
    L = np.zeros_like(rest)
    with np.errstate(invalid="ignore", divide="ignore"):
        for j in range(len(rest)):
            L[j:, j] = rest[j:, j] / np.sqrt(rest[j, j])
            rest[j:, j:] -= L[j:, j, None] * L[j:, j]
    return L


def solve(A: ArrayLike, B: ArrayLike) -> Array:
    """`A^-1 B` of a square matrix, by Gaussian elimination with pivots; inf or nan where it is singular."""
    left, right = np.array(A, float), np.array(B, float)
    size = len(left)
    with np.errstate(invalid="ignore", divide="ignore"):
        for j in range(size):
            pivot = j + int(np.argmax(np.abs(left[j:, j])))
            left[[j, pivot]], right[[j, pivot]] = left[[pivot, j]], right[[pivot, j]]
            share = left[:, j] / left[j, j]
            share[j] = 0.0
            left -= share[:, None] * left[j]
            right -= share.reshape(-1, *[1] * (right.ndim - 1)) * right[j]
        diagonal = np.diag(left)
        return np.asarray(right / diagonal.reshape(-1, *[1] * (right.ndim - 1)))


def inverse(A: ArrayLike) -> Array:
    """`A^-1` of a square matrix; inf or nan where it is singular."""
    return solve(A, np.eye(len(np.asarray(A))))


def svd(A: ArrayLike) -> tuple[Array, Array, Array]:
    """`(B, sigma, V)` with `A V = B`, the columns of B orthogonal and sigma long, the longest first; V orthogonal.

    Jacobi's rotations on pairs of columns (Hestenes 1958), half of all pairs at a time in the order of a round robin
    (Brent and Luk 1985). Of a symmetric positive semidefinite A these are its eigenvalues and eigenvectors.
    """
    B = np.array(A, float)
    n = B.shape[1]
    V = np.eye(n)
    order = np.arange(n + n % 2)  # an odd one out rests
    for _ in range(SWEEPS if n > 1 else 0):
        turned = False
        for _ in range(len(order) - 1):
            p, q = order[: len(order) // 2], order[len(order) // 2 :][::-1]
            both = (p < n) & (q < n)
            turned |= rotated(B, V, p[both], q[both])
            order = np.concatenate((order[:1], order[-1:], order[1:-1]))
        if not turned:
            break
    sigma = np.sqrt((B * B).sum(axis=0))
    place = np.argsort(-sigma, kind="stable")
    return B[:, place], sigma[place], V[:, place]


def rotated(B: Array, V: Array, p: NDArray[np.int64], q: NDArray[np.int64]) -> bool:
    """Make the columns p of B orthogonal to the columns q, one by one; whether any of them was not."""
    one, other = B[:, p], B[:, q]
    a, b, c = (one * one).sum(axis=0), (other * other).sum(axis=0), (one * other).sum(axis=0)
    there = np.minimum(a, b) > 1e-32 * max(a.max(initial=0.0), b.max(initial=0.0))
    there &= np.abs(c) > ALIGNED * np.sqrt(a) * np.sqrt(b)
    if not there.any():
        return False
    p, q, a, b, c = p[there], q[there], a[there], b[there], c[there]
    slope = (b - a) / (2.0 * c)
    t = np.where(slope < 0.0, -1.0, 1.0) / (np.abs(slope) + np.sqrt(1.0 + slope * slope))
    cosine = 1.0 / np.sqrt(1.0 + t * t)
    sine = cosine * t
    for matrix in (B, V):
        one, other = matrix[:, p], matrix[:, q]
        matrix[:, p], matrix[:, q] = cosine * one - sine * other, sine * one + cosine * other
    return True


def triangle(A: ArrayLike) -> Array:
    """R of `A = Q R` of a tall matrix, by Householder's reflections: it has the singular values and directions of A."""
    R = np.array(A, float)
    for j in range(R.shape[1]):
        v = R[j:, j].copy()
        v[0] += math.copysign(math.sqrt(float((v * v).sum())), v[0])
        size = float((v * v).sum())
        if size > 0.0:
            R[j:, j:] -= v[:, None] * ((v[:, None] * R[j:, j:]).sum(axis=0) * (2.0 / size))
    return np.triu(R[: R.shape[1]])


def pseudo_inverse(A: ArrayLike) -> Array:
    """Moore and Penrose's inverse, (n, m) of (m, n); columns below 1e-15 of the longest count as none."""
    A = np.asarray(A, float)
    return _pseudo_inverse(A.shape, A.tobytes()).copy()


@lru_cache(maxsize=256)  # the runs of a batch share the matrices of their motors
def _pseudo_inverse(shape: tuple[int, int], numbers: bytes) -> Array:
    A = np.frombuffer(numbers).reshape(shape)
    if A.shape[0] < A.shape[1]:
        return np.ascontiguousarray(pseudo_inverse(A.T).T)
    B, sigma, V = svd(A)
    kept = sigma > 1e-15 * sigma.max(initial=0.0)
    return np.ascontiguousarray(product(V[:, kept] / sigma[kept] ** 2, B[:, kept].T))


def exponential(A: ArrayLike) -> Array:
    """`e^A` of a square matrix: its series at a norm of 1/2 or less, then squared."""
    A = np.asarray(A, float)
    norm = float(np.abs(A).sum(axis=1).max(initial=0.0))
    halvings = max(0, math.frexp(norm)[1] + 1)
    part = total = np.eye(len(A))
    for k in range(1, TERMS + 1):
        part = product(part, A * 0.5**halvings) / k
        total = total + part
    for _ in range(halvings):
        total = product(total, total)
    return total
