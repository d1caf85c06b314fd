"""Weighted least squares in the base parameters, with standard deviations that hold.

Base parameters are the combinations of parameters that the torques depend on (Gautier 1991, J. Robotic Systems 8(4)):
`Y = Y_b (1 C)`, so `beta = theta_b + C theta_d`. Every row is weighted by its residual variance; what is far
off does not count. The residuals of filtered torques are correlated in time, so the covariance of the estimate is not
`(X' W X)^-1` but

    A^-1 B A^-1,     A = sum_i X_i' X_i / s_i^2,     B = sum_i X_i' R_i X_i / s_i^4,

with R_i the autocovariance of row i's noise: that of white noise behind the filter, and what the residuals show beyond.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from ...signals import Array
from .equations import ORDER, Bools, Equations, Unknowns

RANK = 1e-9  # relative size of a column under which it is rounding
DISTINCT = 5e-3  # new part of a column, of its length, under which it counts as depending on the others; see below
NAMED = 1e-7  # coefficient of a combination, relative, under which it is rounding
UNSEEN = 1e-10  # relative eigenvalue of the information under which a direction was not moved
FAR = 4.0  # deviations (of the median) from which an equation counts less; from twice that not at all
ROUNDS = 8  # of weights
FINEST = 1e-5  # least deviation, of a row's RMS
LAGS = 4.0  # reach of the taper over the correlation time of what residuals have beyond white noise
LONGEST = 60  # lags that are looked at
FEWEST = 20  # pairs of rows that a lag needs


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """Base parameters of some rows."""

    independent: NDArray[np.int64]  # parameters that lead a combination, (b,)
    combination: Array  # (b, k) beta = combination theta

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


def base_parameters(unknowns: Unknowns, rows: Bools, moves: Bools, samples: int = 300, seed: int = 0) -> BaseParameters:
    """The combinations that some rows depend on, whatever the motion.

    A parameter that adds less than `DISTINCT` of its effect to what others do counts as theirs: no noisy motion tells
    it apart. Axes that a file makes parallel with `rpy="1.57 0 0"`, which misses a right angle by 8e-4, leave such
    parameters (a Kinova Gen3 lite: 1e-3; with 1.5708, 6e-6); those that are a robot's own add 0.1 and more.

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
    R, pivot = scipy.linalg.qr(Y[:, active] / size[active], mode="r", pivoting=True)
    rank = int(np.sum(np.abs(np.diag(R)) > DISTINCT * abs(R[0, 0])))
    relation = np.linalg.solve(R[:rank, :rank], R[:rank, rank:])
    lead, rest = active[pivot[:rank]], active[pivot[rank:]]
    combination = np.zeros((rank, unknowns.size))
    combination[np.arange(rank), lead] = 1.0
    combination[:, rest] = relation * size[rest] / size[lead][:, None]
    order = np.argsort(lead)
    return BaseParameters(lead[order], combination[order])


@dataclass(frozen=True, eq=False)
class WeightedFit:
    """A weighted fit."""

    base: BaseParameters  # the combinations
    value: Array  # (b,) their estimates
    covariance: Array  # (b, b) of the estimates
    seen: Bools  # (b,) whether the motion determines each at all
    condition: float  # condition number of the weighted regressor, columns of length 1
    deviation: Array  # (r,) residual standard deviation of every row; nan for those that do not count
    weights: Array  # (M, r) of the equations, between 0 and 1
    inflation: float  # how many equations as correlated as these say as much as one of their own

    @property
    def sd(self) -> Array:
        """Standard deviations, (b,); inf for what is not seen."""
        return np.where(self.seen, np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), np.inf)

    def theta(self, size: int) -> Array:
        """Parameters with these base parameters, (k,), of the combinations' leaders alone."""
        theta = np.zeros(size)
        theta[self.base.independent] = self.value
        return theta


def weighted_fit(equations: Equations, base: BaseParameters, prior: Array | None = None) -> WeightedFit:
    """Least squares with weights by residual variance, and less weight on what is far off.

    Args:
        equations: Those that count.
        base: What is fitted.
        prior: (b,) how sure it is beforehand that each is 0, 1 / sd^2; by default nothing is known.
    """
    X, y, use = equations.Y[:, :, base.independent], equations.y, equations.use
    rows = [np.ascontiguousarray(X[:, i]) for i in range(X.shape[1])]
    there: Bools = np.asarray(use.any(axis=0))
    deviation, weights = np.where(there, 1.0, np.nan), use.astype(float)
    value, seen = np.zeros(X.shape[2]), np.ones(X.shape[2], bool)
    grams, sure = np.array([gram(row, w) for row, w in zip(rows, weights.T, strict=True)]), np.zeros((1, 1))
    sure = sure if prior is None else np.diag(prior)
    for _ in range(ROUNDS):
        inverse, seen, condition = inverted(summed(grams, deviation) + sure)
        value = inverse @ summed(
            np.array([row.T @ (w * one) for row, w, one in zip(rows, weights.T, y.T, strict=True)]), deviation
        )
        residual = np.where(use, y - np.column_stack([row @ value for row in rows]), 0.0)
        used = (inverse * grams).sum(axis=(1, 2))
        used = used / np.where(there, deviation, 1.0) ** 2
        free = np.maximum(weights.sum(axis=0) - used, 1.0)
        deviation = np.where(there, np.sqrt((weights * residual**2).sum(axis=0) / free), np.nan)
        deviation = np.where(there, np.maximum(deviation, FINEST * np.sqrt((y**2).mean(axis=0))), np.nan)
        middle = [1.4826 * np.median(np.abs(residual[use[:, i], i])) if there[i] else 1.0 for i in range(len(there))]
        far = np.abs(residual) / np.maximum(np.minimum(middle, np.where(there, deviation, 1.0)), 1e-300)
        before, weights = weights, np.asarray(use * np.clip(2.0 - far / FAR, 0.0, 1.0), float)
        for i in np.flatnonzero((weights != before).any(axis=0)):
            grams[i] = gram(rows[i], weights[:, i])
    A = summed(grams, deviation)
    inverse, seen, condition = inverted(A + sure)
    B = meat(X, residual, weights, deviation, equations, inverse)
    covariance = inverse @ (B + sure) @ inverse
    inflation = float((inverse * B).sum() / max(1.0, float((inverse * A).sum())))
    return WeightedFit(base, value, covariance, seen, condition, deviation, weights, max(1.0, inflation))


def gram(X: Array, weights: Array) -> Array:
    """`X' W X` of one row."""
    return np.asarray(X.T @ (weights[:, None] * X))


def summed(parts: Array, deviation: Array) -> Array:
    """Parts (r, ...) of all rows that count, each over its residual variance."""
    there = np.isfinite(deviation)
    return np.asarray(np.tensordot(deviation[there] ** -2, parts[there], (0, 0)))


def inverted(A: Array) -> tuple[Array, Bools, float]:
    """Inverse of an information matrix, which parameters it determines, and the condition number of its root."""
    diagonal = np.diag(A)
    there = diagonal > 0
    scale = np.where(there, 1 / np.sqrt(np.where(there, diagonal, 1.0)), 0.0)
    values, vectors = scipy.linalg.eigh(
        A * np.outer(scale, scale) + np.diag(~there)
    )  # by RRR: numpy's divides, and may not end
    kept = values > UNSEEN * values[-1]
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    seen = there & ((vectors[:, ~kept] ** 2).sum(axis=1) < 1e-6)
    condition = float(np.sqrt(values[-1] / max(values[0], 1e-300))) if kept.all() and there.all() else np.inf
    return inverse * np.outer(scale, scale), seen, condition


# -- residuals that are correlated in time -----------------------------------------------------------------------------


def meat(X: Array, residual: Array, weights: Array, deviation: Array, equations: Equations, inverse: Array) -> Array:
    """B of the module's formula: what residuals that are correlated in time do to the normal equations.

    The fit takes more out of slow residuals than of fast ones, as motions are slow. So what the fit leaves of noise
    that is white ahead of the filter is computed (`expected`), its variance matched, and only what the residuals have
    beyond that is estimated from them.

    Args:
        X: (M, r, b) base regressor.
        residual: (M, r).
        weights: (M, r) of the equations.
        deviation: (r,) of the rows; nan for those that do not count.
        equations: For times and runs.
        inverse: (b, b) A^-1.
    """
    rows, run = np.flatnonzero(np.isfinite(deviation)), equations.run
    spacing = float(np.median(np.diff(equations.time)[np.diff(run) == 0]))
    white = echo(equations.cutoff, spacing, min(LONGEST, len(run) // 10))
    Z = {i: X[:, i] * (weights[:, i] / deviation[i] ** 2)[:, None] for i in rows}
    smeared = {i: toeplitz(white * deviation[i] ** 2, Z[i], run) for i in rows}
    B: Array = np.sum([Z[i].T @ smeared[i] for i in rows], axis=0)
    total = np.zeros_like(B)
    for i in rows:
        use = weights[:, i] > 0
        found, count = products(residual[:, i], residual[:, i], use, run, len(white))
        model = white * deviation[i] ** 2
        left = model + expected(X[:, i], smeared[i], inverse, B, use, run, len(white))
        scale = found[0] / max(left[0], 1e-300)
        total += Z[i].T @ toeplitz(scale * model + beyond(found - scale * left, found[0], count), Z[i], run)
    return total


def echo(cutoff: float, spacing: float, lags: int) -> Array:
    """Autocorrelation of white noise behind the filters of `equations`, at multiples of a spacing [s], (lags,)."""
    f = np.linspace(0.0, 3.0 * cutoff, 2000)
    power = (1.0 + (f / cutoff) ** (2 * ORDER)) ** -4
    waves = np.cos(2 * np.pi * np.outer(np.arange(max(lags, 2)) * spacing, f))
    return np.asarray(waves @ power / power.sum())


def toeplitz(covariance: Array, Z: Array, run: NDArray[np.int64]) -> Array:
    """`R Z` with R_ts = covariance[|t - s|] within a run, (M, b)."""
    kernel, out = np.concatenate((covariance[:0:-1], covariance))[:, None], np.empty_like(Z)
    for part in stretches(run):
        out[part] = scipy.signal.oaconvolve(Z[part], kernel, "full", axes=0)[
            len(covariance) - 1 : len(covariance) - 1 + len(Z[part])
        ]
    return out


def stretches(run: NDArray[np.int64]) -> list[slice]:
    """Where every run stands among the rows, one after the other."""
    edges = [0, *(np.flatnonzero(np.diff(run)) + 1), len(run)]
    return [slice(a, b) for a, b in pairwise(edges)]


def products(a: Array, b: Array, use: Bools, run: NDArray[np.int64], lags: int) -> tuple[Array, float]:
    """Mean of `a_t b_t+l` over rows that both count, for every lag, (lags,), and how many count.

    a and b may have columns, whose products are summed.
    """
    total, count = np.zeros(lags), np.zeros(lags)
    mask = use.astype(float)[:, None]
    for part in stretches(run):
        m = mask[part]
        total += correlated(a.reshape(len(a), -1)[part] * m, b.reshape(len(b), -1)[part] * m, lags)
        count += np.round(correlated(m, m, lags))
    few = np.flatnonzero(count < FEWEST)
    count[few[0] if few.size else lags :] = np.inf
    return total / count, float(use.sum())


def correlated(a: Array, b: Array, lags: int) -> Array:
    """Sum of `a_t' b_t+l` of columns (n, c), for every lag, (lags,)."""
    size = scipy.fft.next_fast_len(len(a) + lags, True)
    spectrum = (np.conj(scipy.fft.rfft(a, size, axis=0)) * scipy.fft.rfft(b, size, axis=0)).sum(axis=1)
    return np.asarray(scipy.fft.irfft(spectrum, size)[:lags])


def expected(
    X: Array, smeared: Array, inverse: Array, B: Array, use: Bools, run: NDArray[np.int64], lags: int
) -> Array:
    """The part of the autocovariance of a row's noise that the fit takes out, at every lag, (lags,).

    Of `e = n - X A^-1 sum_j Z_j' n_j` it is `-X A^-1 Z' R` and its transpose, and `X A^-1 B A^-1 X'`.
    """
    half = X @ inverse
    one, _ = products(half, smeared, use, run, lags)
    other, _ = products(smeared, half, use, run, lags)
    both, _ = products(half @ B, half, use, run, lags)
    return np.asarray(both - one - other)


def beyond(excess: Array, variance: float, count: float) -> Array:
    """An excess of autocovariance, tapered (Parzen) where it is lost in noise, (lags,)."""
    quiet = np.flatnonzero(np.abs(excess[1:]) < 2 * variance / np.sqrt(count))
    last = int(quiet[0]) if quiet.size else len(excess) - 1
    if last == 0:
        return np.zeros_like(excess)
    reach = min(len(excess), int(np.ceil(LAGS * last)) + 1)
    u = np.arange(len(excess)) / reach
    taper = np.where(u < 0.5, 1 - 6 * u**2 + 6 * u**3, np.where(u < 1, 2 * np.maximum(1 - u, 0) ** 3, 0.0))
    return np.asarray(excess * taper)
