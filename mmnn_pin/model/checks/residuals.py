"""Residuals of the properties that the thesis's proof rests on: functions that return a number.

Every residual is scale-free. Mass matrices are judged as `D M D` with `D = diag(M)^(-1/2)`, which has ones on its
diagonal whatever the masses and units are, and rates of them are divided by the rate of the motion. So one tolerance
serves a robot of 3 kg and one of 300 kg.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from ...signals import Array, IntArray

EXACT = 1e-9  # of residuals of algebra
DEFINITE = 1e-12  # least eigenvalue of a mass matrix with ones on its diagonal
STEP = 1e-3  # of differences along a motion, times its largest rate
STENCIL = ((-2, 1 / 12), (-1, -8 / 12), (1, 8 / 12), (2, -1 / 12))  # fourth-order central difference


def asymmetry(M: Array) -> float:
    """Largest `|M - M'|`, M scaled to ones on its diagonal."""
    return largest((M - M.T) * weights(M))


def smallest_eigenvalue(M: Array) -> float:
    """Smallest eigenvalue of M scaled to ones on its diagonal; negative where M is not positive definite."""
    if not (np.isfinite(M).all() and np.all(np.diag(M) > 0)):
        return -np.inf
    scaled = M * weights(M)
    return float(np.linalg.eigvalsh((scaled + scaled.T) / 2).min(initial=1.0))


def skewness(M: Array, Mdot: Array, C: Array, speed: float) -> float:
    """Largest `|Mdot - (C + C')|` per speed, scaled as M: zero if and only if `Mdot - 2C` is skew (Mdot symmetric)."""
    return largest((Mdot - C - C.T) * weights(M)) / speed


def block_residual(M: Array, Mdot: Array, C: Array, speed: float, part: IntArray) -> float:
    """Properties 1 and 2 of one block: asymmetry, skewness, and 1 where it is not positive definite."""
    at = np.ix_(part, part)
    if smallest_eigenvalue(M[at]) <= DEFINITE:
        return 1.0
    return max(asymmetry(M[at]), skewness(M[at], Mdot[at], C[at], speed))


def cross_residual(M: Array, Mdot: Array, C: Array, speed: float, first: IntArray, second: IntArray) -> float:
    """Property 4 for two sets of velocities: `M_vr = M_rv'` and `Mdot_rv = C_rv + C_vr'`, scaled as M."""
    W = weights(M)[np.ix_(second, first)]
    rate = Mdot[np.ix_(second, first)] - C[np.ix_(second, first)] - C[np.ix_(first, second)].T
    return max(largest(rate * W) / speed, largest((M[np.ix_(first, second)].T - M[np.ix_(second, first)]) * W))


def nonlinearity(C: Callable[[Array], Array], v: Array, M: Array, speed: float) -> float:
    """Largest `|C(2 v) - 2 C(v)|`, scaled as M: with zero, `||C|| <= C_b ||v||` holds for some C_b (property 1)."""
    return largest((C(2 * v) - 2 * C(v)) * weights(M)) / speed


def annihilation(A: Array, T: Array) -> float:
    """Largest `|A T|`, each entry over the sum of the magnitudes that should cancel in it: `A S = 0` (2.17)."""
    return largest(A @ T / np.maximum(abs(A) @ abs(T), np.finfo(float).tiny)) if len(A) else 0.0


def independence(T: Array) -> float:
    """Smallest singular value of T with columns of unit length: above zero if and only if S has full rank."""
    length = np.linalg.norm(T, axis=0)
    if not (T.size and length.all()):
        return 1.0 if not T.size else 0.0
    return float(np.linalg.svd(T / length, compute_uv=False).min())


def missing_constraints(A: Array, T: Array) -> float:
    """How far rank A is from nv - p, in rows: fewer would permit motions that T does not know."""
    rows = A / np.maximum(np.linalg.norm(A, axis=1, keepdims=True), np.finfo(float).tiny)
    found = int(np.linalg.matrix_rank(rows, tol=EXACT)) if A.size else 0
    return float(abs(T.shape[0] - T.shape[1] - found))


def rate_along(function: Callable[[Array], Array], model: pin.Model, q: Array, v: Array, speed: float) -> Array:
    """Time derivative of a matrix along the motion from q with velocity v, by differences of fourth order."""
    h = STEP / speed
    return np.sum([weight * function(pin.integrate(model, q, i * h * v)) for i, weight in STENCIL], axis=0) / h


def weights(M: Array) -> Array:
    """What scales M, and rates of it, to ones on the diagonal: `1 / sqrt(M_ii M_jj)`, (p, p)."""
    diagonal = np.sqrt(abs(np.diag(M)))
    return 1.0 / np.maximum(np.outer(diagonal, diagonal), np.finfo(float).tiny)


def largest(values: Array) -> float:
    """Largest magnitude, nan where there is one; 0 of nothing."""
    return float(np.max(abs(values), initial=0.0))
