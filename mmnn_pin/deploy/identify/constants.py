"""Torque constants that nobody knows, from a motion in which other joints' torques are known.

Bodies beyond a joint are felt by the joints before it, too. So a joint whose effort y is a current says the same as the
others but for a factor: `y = g Y theta`, g the effort per torque, and of all rows

    minimize   sum over known rows |y - X beta|^2 / s^2  +  sum over the others |y - g X beta|^2 / s^2

over base parameters beta and all g, by Gauss and Newton: noise is in y alone, so that nothing is drawn towards 0, as it
would be in the linear equations `X beta - y / g = 0`, from which it starts. With no torque known only ratios could be
told, and the masses would be in the unit of a current.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import ConfigError, RecordingError
from ...signals import Array
from .equations import Bools, Equations
from .least_squares import BaseParameters, inverted, weighted_fit

STEPS = 60  # of Gauss and Newton
ENDED = 1e-10  # relative change of a factor at which they end
SEEN = 0.1  # largest relative standard deviation of a constant that is believed


@dataclass(frozen=True, eq=False)
class Constants:
    """Torque constants that were found."""

    rows: tuple[int, ...]  # (f,) places of their joints among the rows
    value: Array  # (f,) torque per effort
    sd: Array  # (f,) their standard deviations

    def applied(self, equations: Equations) -> Equations:
        """The equations with torques in the place of efforts."""
        scale = np.ones(equations.y.shape[1])
        scale[list(self.rows)] = self.value
        return replace(equations, y=equations.y * scale)


def constants_of(equations: Equations, base: BaseParameters, rows: Sequence[int], names: Sequence[str]) -> Constants:
    """Torque constants of some rows.

    Args:
        equations: Of all rows, efforts as they were recorded.
        base: Combinations that they depend on.
        rows: Those whose constants are looked for.
        names: Of all rows.

    Raises:
        ConfigError: No other row has a torque.
        RecordingError: The motion does not tell one of them.
    """
    there: Bools = np.asarray(equations.use.any(axis=0))
    known = [i for i in range(len(there)) if there[i] and i not in rows]
    fix = "give one more with --torque-constant JOINT=NUMBER"
    if not known:
        why = "a motion tells their ratios only: twice the masses with half the constants moves alike"
        raise ConfigError("no torque constant is known", why=why, fix=fix, key="--torque-constant")
    if still := [names[i] for i in rows if not there[i]]:
        raise RecordingError(f"no torque constant of {still[0]}", why="it hardly moves", fix="give it, or move it")
    X, y, use = equations.Y[:, :, base.independent], equations.y, equations.use
    grams = {i: (X[use[:, i], i], y[use[:, i], i]) for i in (*known, *rows)}
    moments = {i: (A.T @ A, A.T @ b, float(b @ b), len(b)) for i, (A, b) in grams.items()}
    beta, g = start(moments, known, rows)
    for _ in range(STEPS):
        step, covariance = improved(moments, rows, beta, g)
        beta, g = beta + step[: len(beta)], g + step[len(beta) :]
        if np.abs(step[len(beta) :]).max() <= ENDED * np.abs(g).max():
            break
    value = 1.0 / g
    found = Constants(tuple(rows), value, np.zeros(len(rows)))
    spread = weighted_fit(found.applied(equations), base).inflation
    sd = np.sqrt(spread * np.maximum(np.diag(covariance)[len(beta) :], 0.0)) * value * value
    for i, one, doubt in zip(rows, value, sd, strict=True):
        if not doubt <= SEEN * abs(one):
            why = (
                f"{one:.3g} with a standard deviation of {doubt:.2g}: the other joints feel too little of what it moves"
            )
            raise RecordingError(f"no torque constant of {names[i]}", why=why, fix=f"{fix}, or record a faster motion")
    return replace(found, sd=sd)


Moments = dict[int, tuple[Array, Array, float, int]]


def start(moments: Moments, known: Sequence[int], rows: Sequence[int]) -> tuple[Array, Array]:
    """Base parameters and efforts per torque from the linear equations, every row over its own size."""
    b, f = len(moments[known[0]][1]), len(rows)
    A, right = np.zeros((b + f, b + f)), np.zeros(b + f)
    for i, (S, h, square, _) in moments.items():
        scale = 1.0 / max(square, 1e-300)
        A[:b, :b] += scale * S
        if i in rows:
            k = b + list(rows).index(i)
            A[:b, k] = A[k, :b] = -scale * h
            A[k, k] = 1.0
        else:
            right[:b] += scale * h
    x = inverted(A)[0] @ right
    return x[:b], 1.0 / np.where(np.abs(x[b:]) > 1e-12, x[b:], 1e-12)


def improved(moments: Moments, rows: Sequence[int], beta: Array, g: Array) -> tuple[Array, Array]:
    """A step of Gauss and Newton, and the covariance of what it stands at; rows weigh by their residual variance."""
    b, f = len(beta), len(g)
    A, right = np.zeros((b + f, b + f)), np.zeros(b + f)
    for i, (S, h, square, count) in moments.items():
        k = list(rows).index(i) if i in rows else -1
        factor = g[k] if k >= 0 else 1.0
        through = S @ beta
        variance = max((square - 2 * factor * beta @ h + factor**2 * beta @ through) / count, 1e-10 * square / count)
        A[:b, :b] += factor**2 / variance * S
        right[:b] += factor / variance * (h - factor * through)
        if k >= 0:
            A[:b, b + k] = A[b + k, :b] = factor / variance * through
            A[b + k, b + k] = beta @ through / variance
            right[b + k] = (beta @ h - factor * (beta @ through)) / variance
    covariance = inverted(A)[0]
    return covariance @ right, covariance
