"""Weighted least squares in the base parameters, with standard deviations that hold.

Base parameters are the combinations of parameters that the torques depend on (Gautier 1991, J. Robotic Systems 8(4)):
`Y = Y_b (1 C)`, so `beta = theta_b + C theta_d`. Every row is weighted by its residual variance, equations far off
count less (Huber). The residuals of filtered torques are correlated in time, so the covariance of the estimate is not
`(X' W X)^-1` but

    A^-1 B A^-1,     A = sum_i X_i' X_i / s_i^2,     B = sum_i X_i' R_i X_i / s_i^4,

with R_i the autocovariance of row i's residuals, estimated from them and tapered (Parzen).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from ...signals import Array
from .equations import Bools, Equations, Unknowns

RANK = 1e-9  # relative size of a column's new part under which it depends on the others
NAMED = 1e-7  # coefficient of a combination, relative, under which it is rounding
UNSEEN = 1e-10  # relative eigenvalue of the information under which a direction was not moved
HUBER = 4.0  # deviations from which an equation counts less
ROUNDS = 5  # of weights
LAGS = 4.0  # reach of the taper over the residuals' correlation time


@dataclass(frozen=True, eq=False)
class Base:
    """Base parameters of some rows.

    Attributes:
        independent: Parameters that lead a combination, (b,).
        combination: (b, k) beta = combination theta.
    """

    independent: NDArray[np.int64]
    combination: Array

    def name(self, i: int, labels: Sequence[str], most: int = 6) -> str:
        """A combination in words: `a.m + 0.5 b.mx`."""
        row = self.combination[i]
        lead = self.independent[i]
        order = [j for j in np.argsort(-np.abs(row), kind="stable") if j != lead and abs(row[j]) > NAMED]
        parts = [labels[lead]]
        for j in order[:most]:
            size = "" if abs(abs(row[j]) - 1) < NAMED else f"{abs(row[j]):.4g} "
            parts.append(f"{'-' if row[j] < 0 else '+'} {size}{labels[j]}")
        return " ".join(parts) + (f" + {len(order) - most} more" if len(order) > most else "")


def base_parameters(unknowns: Unknowns, rows: Bools, moves: Bools, samples: int = 300, seed: int = 0) -> Base:
    """The combinations that some rows depend on, whatever the motion.

    Args:
        unknowns: What is fitted.
        rows: (r,) whether a row counts.
        moves: (p,) whether a velocity ever moves; the others stand still.
        samples: Random states that are looked at.
        seed: Their seed.
    """
    rng, robot = np.random.default_rng(seed), unknowns.robot
    nu, nudot = rng.standard_normal((2, samples, len(moves))) * moves
    q = np.where(
        moves[robot.dimensions.base :],
        rng.uniform(-np.pi, np.pi, (samples, robot.dimensions.arm)),
        robot.rest[robot.arm_index],
    )
    Y = unknowns.matrix(q, nu, nudot)[:, rows].reshape(-1, unknowns.size)
    size = np.linalg.norm(Y, axis=0)
    active = np.flatnonzero(size > RANK * size.max(initial=0.0))
    R, pivot = qr(Y[:, active] / size[active], mode="r", pivoting=True)
    rank = int(np.sum(np.abs(np.diag(R)) > RANK * abs(R[0, 0])))
    relation = np.linalg.solve(R[:rank, :rank], R[:rank, rank:])
    lead, rest = active[pivot[:rank]], active[pivot[rank:]]
    combination = np.zeros((rank, unknowns.size))
    combination[np.arange(rank), lead] = 1.0
    combination[:, rest] = relation * size[rest] / size[lead][:, None]
    order = np.argsort(lead)
    return Base(lead[order], combination[order])


@dataclass(frozen=True, eq=False)
class Fit:
    """A weighted fit.

    Attributes:
        base: The combinations.
        value: (b,) their estimates.
        covariance: (b, b) of the estimates.
        seen: (b,) whether the motion determines each at all.
        condition: Condition number of the weighted regressor, columns of length 1.
        deviation: (r,) residual standard deviation of every row; nan for those that do not count.
        weights: (M, r) of the equations, between 0 and 1.
        inflation: How many equations as correlated as these say as much as one of their own.
    """

    base: Base
    value: Array
    covariance: Array
    seen: Bools
    condition: float
    deviation: Array
    weights: Array
    inflation: float

    @property
    def sd(self) -> Array:
        """Standard deviations, (b,); inf for what is not seen."""
        return np.where(self.seen, np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), np.inf)

    def theta(self, size: int) -> Array:
        """Parameters with these base parameters, (k,), of the combinations' leaders alone."""
        theta = np.zeros(size)
        theta[self.base.independent] = self.value
        return theta


def weighted_fit(equations: Equations, base: Base) -> Fit:
    """Least squares with weights by residual variance, and Huber's on what is far off."""
    X, y, use = equations.Y[:, :, base.independent], equations.y, equations.use
    there: Bools = np.asarray(use.any(axis=0))
    deviation, weights = np.where(there, 1.0, np.nan), use.astype(float)
    value, seen = np.zeros(X.shape[2]), np.ones(X.shape[2], bool)
    for _ in range(ROUNDS):
        A, b = normal(X, y, weights, deviation)
        inverse, seen, condition = inverted(A)
        value = inverse @ b
        residual = np.where(use, y - X @ value, 0.0)
        used = np.array([np.sum(inverse * gram(X[:, i], weights[:, i])) for i in range(len(there))])
        used = used / np.where(there, deviation, 1.0) ** 2
        free = np.maximum(weights.sum(axis=0) - used, 1.0)
        deviation = np.where(there, np.sqrt((weights * residual**2).sum(axis=0) / free), np.nan)
        deviation = np.where(there, np.maximum(deviation, 1e-12 * (1 + np.abs(y).max(axis=0))), np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.abs(residual) / np.where(there, deviation, 1.0)
        weights = use * np.minimum(1.0, HUBER / np.maximum(far, 1e-12))
    A, _ = normal(X, y, weights, deviation)
    inverse, seen, condition = inverted(A)
    B = meat(X, residual, weights, deviation, equations.run, free)
    covariance = inverse @ B @ inverse
    inflation = float(np.trace(covariance @ A) / max(1, np.count_nonzero(seen)))
    return Fit(base, value, covariance, seen, condition, deviation, weights, max(1.0, inflation))


def gram(X: Array, weights: Array) -> Array:
    """`X' W X` of one row."""
    return np.asarray(X.T @ (weights[:, None] * X))


def normal(X: Array, y: Array, weights: Array, deviation: Array) -> tuple[Array, Array]:
    """Normal equations of all rows, each over its residual variance."""
    size = X.shape[2]
    A, b = np.zeros((size, size)), np.zeros(size)
    for i in np.flatnonzero(np.isfinite(deviation)):
        scale = weights[:, i] / deviation[i] ** 2
        A += gram(X[:, i], scale)
        b += X[:, i].T @ (scale * y[:, i])
    return A, b


def inverted(A: Array) -> tuple[Array, Bools, float]:
    """Inverse of an information matrix, which parameters it determines, and the condition number of its root."""
    diagonal = np.diag(A)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(A * np.outer(scale, scale))
    kept = values > UNSEEN * values[-1]
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    seen = (diagonal > 0) & ((vectors[:, ~kept] ** 2).sum(axis=1) < 1e-6)
    condition = float(np.sqrt(values[-1] / max(values[0], 1e-300))) if kept.all() else np.inf
    return inverse * np.outer(scale, scale), seen, condition


def meat(X: Array, residual: Array, weights: Array, deviation: Array, run: NDArray[np.int64], free: Array) -> Array:
    """B: what residuals that are correlated in time do to the normal equations, see the module."""
    B = np.zeros((X.shape[2], X.shape[2]))
    for i in np.flatnonzero(np.isfinite(deviation)):
        Z = X[:, i] * (weights[:, i] / deviation[i] ** 2)[:, None]
        covariance = autocovariance(residual[:, i], weights[:, i] > 0, run, float(free[i]))
        B += covariance[0] * gram(X[:, i], (weights[:, i] / deviation[i] ** 2) ** 2)
        for lag in range(1, len(covariance)):
            pairs = run[lag:] == run[:-lag]
            cross = Z[lag:][pairs].T @ Z[:-lag][pairs]
            B += covariance[lag] * (cross + cross.T)
    return B


def autocovariance(residual: Array, use: Bools, run: NDArray[np.int64], free: float) -> Array:
    """Autocovariance of residuals at lags 0, 1, ..., tapered where it is lost in noise.

    Args:
        residual: (M,) zero where not used.
        use: (M,) which count.
        run: (M,) stretches without gaps.
        free: Degrees of freedom that the residuals have.
    """
    count = max(1.0, float(use.sum()))
    variance = float((residual[use] ** 2).sum()) / free
    longest = max(1, min(len(residual) // 10, 200))
    found = [1.0]
    for lag in range(1, longest):
        both = use[lag:] & use[:-lag] & (run[lag:] == run[:-lag])
        n = int(both.sum())
        if n < 20:
            break
        found.append(float((residual[lag:] * residual[:-lag])[both].sum()) / n / max(variance * free / count, 1e-300))
    rho = np.array(found)
    quiet = np.flatnonzero(np.abs(rho) < 2 / np.sqrt(count))
    last = int(quiet[0]) if quiet.size else len(rho)
    reach = min(len(rho), max(2, int(np.ceil(LAGS * last))))
    u = np.arange(reach) / reach
    taper = np.where(u < 0.5, 1 - 6 * u**2 + 6 * u**3, 2 * (1 - u) ** 3)
    return np.asarray(variance * rho[:reach] * taper)
