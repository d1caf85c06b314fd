"""Small dense matrices, compiled and without allocation: products, Cholesky factors, determinants, inverses."""

from __future__ import annotations

import math

from ..compiled import compiled
from ..signals import Array


@compiled
def product(A: Array, B: Array, out: Array) -> None:
    """`A B` (n, m) of A (n, k) and B (k, m)."""
    for i in range(len(A)):
        for j in range(B.shape[1]):
            total = 0.0
            for c in range(len(B)):
                total += A[i, c] * B[c, j]
            out[i, j] = total


@compiled
def factored(A: Array, F: Array) -> bool:
    """Lower triangular `A = F F'`, the other half of F untouched; False where A is not positive definite."""
    for j in range(len(A)):
        for i in range(j, len(A)):
            total = A[i, j]
            for c in range(j):
                total -= F[i, c] * F[j, c]
            if i > j:
                F[i, j] = total / F[j, j]
            elif total > 0.0:
                F[j, j] = math.sqrt(total)
            else:
                return False
    return True


@compiled
def solved(factor: Array, C: Array) -> None:
    """`C F'^-1` in place for a lower triangular F, so that `C C'` becomes `C (F F')^-1 C'`."""
    for a in range(len(C)):
        for j in range(len(factor)):
            total = C[a, j]
            for c in range(j):
                total -= C[a, c] * factor[j, c]
            C[a, j] = total / factor[j, j]


@compiled
def log_det(X: Array, factor: Array) -> float:
    """Logarithm of a determinant, -inf where the matrix is not positive definite; the factor is written."""
    if not factored(X, factor):
        return -math.inf
    total = 0.0
    for i in range(len(X)):
        total += 2.0 * math.log(factor[i, i])
    return total


@compiled
def inverse(L: Array, factor: Array, column: Array, P: Array) -> None:
    """`L^-1` into P, by way of a factor (k, k) and a column (k,); P stays where L is not positive definite."""
    if not factored(L, factor):
        return
    for j in range(len(L)):
        for i in range(j, len(L)):
            total = 1.0 if i == j else 0.0
            for c in range(j, i):
                total -= factor[i, c] * column[c]
            column[i] = total / factor[i, i]
        for i in range(len(L) - 1, j - 1, -1):
            total = column[i]
            for c in range(i + 1, len(L)):
                total -= factor[c, i] * column[c]
            column[i] = total / factor[i, i]
            P[i, j] = P[j, i] = column[i]
