"""Delays and lags between the signals of a log: the shift that lets one signal explain the other best, with a band.

Of an effort y and the columns X of everything that a rigid body with friction may ask for, with all parameters free,

    RSS(d, T) / |y|^2,     RSS = min over theta |y_{d,T} - X theta|^2 = |y_{d,T}|^2 - |Q' y_{d,T}|^2,     X = Q R,

y_{d,T} the effort behind a motor of time constant T, and d later. Its least value is looked for, so masses and friction
need not be known; the curvature there gives the standard deviation, widened where residuals are correlated. A recorded
rate of a joint is compared in the same way with the derivative of its position.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from ...signals import Array
from .equations import Equations, Unknowns, efforts, evenly, low_pass, stretches_of
from .log import Log
from .mends import lagged

LONGEST, COARSE, FINEST = 0.3, 31, 5e-5  # [s] that is looked at, steps of it, [s] at which the search ends
LAGS = tuple(float(x) for x in np.geomspace(1e-3, 0.5, 14))  # [s] that are tried
RANKED = 1e-6  # part of a column, of its length, under which it says what others say
UNSEEN = 0.1  # [s] standard deviation of a delay that says nothing
SAMPLED = 0.25  # periods: least standard deviation of a delay between signals that are sampled and held
PARTS = 5  # of a motion, one left out at a time
MOST, FOLLOWED = 4000, 1000  # equations, and rows of a rate or a command, that are looked at
LAGGING = 25.0  # times the residual variance that a lag has to explain before it is believed

Signal = Callable[[Array, float], Array]  # values at times, behind a first-order lag


@dataclass(frozen=True)
class Delay:
    """How much later one signal comes than another one."""

    value: float  # [s]; negative for earlier
    sd: float  # [s]
    lag: float  # time constant of a first-order lag beside it [s]
    lag_sd: float  # [s]
    error: float  # RMS of what is left, over the RMS of the signal
    error_before: float  # the same without delay and lag

    @property
    def whole(self) -> float:
        """Delay and lag together, as slow signals feel them [s]."""
        return self.value + self.lag

    @property
    def clear(self) -> bool:
        """Whether it is not zero by more than its band, and explains the signal better."""
        away = abs(self.value) > 3 * self.sd or self.lag > 3 * self.lag_sd
        return away and self.error < self.error_before

    def to_dict(self) -> dict[str, float]:
        """For JSON."""
        return {"delay": self.value, "sd": self.sd, "lag": self.lag, "lag_sd": self.lag_sd}


def delay_of(Q: Array, curve: Signal, time: Array, lags: bool = False) -> Delay | None:
    """The delay, and the lag where asked for, with which a curve is best explained.

    Args:
        Q: (M, k) orthonormal columns that may explain it at `time`.
        curve: The signal at any times.
        time: (M,) [s].
        lags: Whether first-order lags are tried.

    Returns:
        None where the signal is zero, or where everything explains it.
    """
    free = len(Q) - Q.shape[1]

    def left(delay: float, lag: float) -> float:
        y = curve(time - (max(delay, 0.0) if lag else delay), lag)  # what lags does not come earlier
        size = float(y @ y)
        return 1.0 - float(((y @ Q) ** 2).sum()) / size if size > 0 else 1.0

    if free < 20 or left(0.0, 0.0) in (0.0, 1.0):
        return None
    value, least = least_of(lambda d: left(d, 0.0), 0.0, LONGEST)
    lag, found, best = 0.0, 0.0, 1.0
    for tried in LAGS if lags else ():
        at, share = least_of(lambda d, T=tried: left(d, T), value - tried, 0.5 * tried + 0.01)  # type: ignore[misc]
        if share < least / (1 + LAGGING / free) and share < best:
            lag, best, found = tried, share, at
    if lag:
        for width in (0.4, 0.15, 0.05, 0.02, 0.006):
            tries = [lag * (1 + width * step) for step in (-1.0, 0.0, 1.0)]
            made = [least_of(lambda d, T=T: left(d, T), found + lag - T, 0.3 * lag + 0.004) for T in tries]  # type: ignore[misc]
            k = int(np.argmin([share for _, share in made]))
            lag, (found, best) = tries[k], made[k]
        value, least = max(found, 0.0), best
    residual = residual_of(Q, curve(time - value, lag))
    variance = max(least, 1e-12) / free * correlated(residual)
    sd, lag_sd = bands(left, value, lag, variance)
    return Delay(value, sd, lag, lag_sd, float(np.sqrt(max(least, 0.0))), float(np.sqrt(max(left(0.0, 0.0), 0.0))))


def least_of(f: Callable[[float], float], centre: float, reach: float) -> tuple[float, float]:
    """Where a function is least around a centre, on ever finer grids, and its value there."""
    count = COARSE
    while True:
        grid = centre + reach * np.linspace(-1.0, 1.0, count)
        values = [f(float(x)) for x in grid]
        k = int(np.argmin(values))
        centre, reach, count = float(grid[k]), 2.0 * reach / (count - 1), 9
        if reach < FINEST:
            return centre, float(values[k])


def bands(left: Callable[[float, float], float], delay: float, lag: float, variance: float) -> tuple[float, float]:
    """Standard deviations of delay and lag, by the curvature of what is left."""
    h, g = 5e-4, max(0.05 * lag, 5e-4)
    steps = [(h, 0.0), (0.0, g)] if lag else [(h, 0.0)]
    middle, H = left(delay, lag), np.zeros((len(steps), len(steps)))
    for i, (a, b) in enumerate(steps):
        for j, (c, e) in enumerate(steps):
            quarter = [
                s * r * left(delay + s * a + r * c, max(lag + s * b + r * e, 0.0)) for s in (1, -1) for r in (1, -1)
            ]
            H[i, j] = sum(quarter) / (4 * max(a, b) * max(c, e))
    one = max(H[0, 0], 1e-300)
    if len(steps) == 1 or np.linalg.det(H) <= 0:
        return float(np.sqrt(2 * variance / one)), float(np.sqrt(2 * variance / max(H[-1, -1], 1e-300))) * bool(lag)
    found = np.sqrt(np.maximum(np.diag(np.linalg.inv(H)), 0.0) * 2 * variance)
    assert middle >= 0
    return float(found[0]), float(found[1])


def residual_of(Q: Array, y: Array) -> Array:
    """Rest of a signal (M,) that orthonormal columns do not explain."""
    return np.asarray(y - Q @ (Q.T @ y))


def correlated(residual: Array) -> float:
    """How many residuals (M,) say as much as one: 1 and twice their autocorrelation, up to where noise begins."""
    power, total = float(residual @ residual), 1.0
    for step in range(1, len(residual) // 4):
        rho = float(residual[step:] @ residual[:-step]) / max(power, 1e-300)
        if rho < 2 / np.sqrt(len(residual)):
            break
        total += 2 * rho
    return total


# -- efforts and rates of a log ----------------------------------------------------------------------------------------


def effort_delays(log: Log, unknowns: Unknowns, equations: Equations) -> list[Delay | None]:
    """How much later the efforts of every row are recorded than the motion needs them, (r,); see the module.

    Negative for efforts that act later than they are recorded, as commands do; those may have a motor's lag, too.

    Args:
        log: A sound one.
        unknowns: What is fitted.
        equations: Those of the log.
    """
    curves = [curve_of(part, unknowns, equations.cutoff) for part in stretches_of(log, equations.cutoff)]
    found: list[Delay | None] = []
    for i in range(len(unknowns.rows)):
        use = np.flatnonzero(equations.use[:, i])
        use = use[:: max(1, len(use) // MOST)]
        X = equations.Y[use, i]
        Q = basis(X)
        if len(use) < 3 * max(Q.shape[1], 10):
            found.append(None)
            continue
        runs = [np.flatnonzero(equations.run[use] == k) for k in range(len(curves))]

        def curve(time: Array, lag: float, i: int = i, runs: Sequence[NDArray[np.int64]] = runs) -> Array:
            made = np.zeros(len(time))
            for rows, one in zip(runs, curves, strict=True):
                made[rows] = one(time[rows], lag)[:, i]
            return made

        # the logged effort is the curve; read later by d it is what the motion needs
        one = delay_of(Q, lambda t, lag, curve=curve: curve(t, lag), equations.time[use])  # type: ignore[misc]
        if one is not None and one.clear:
            one = replace(one, sd=max(one.sd, jackknife(X, curve, equations.time[use])))
        if one is not None and one.clear and one.value > 0:
            one = delay_of(Q, lambda t, lag, curve=curve: curve(t, lag), equations.time[use], lags=True)  # type: ignore[misc]
        unseen = one is None or one.sd > UNSEEN
        found.append(None if unseen or one is None else replace(one, value=-one.value))
    return found


def jackknife(X: Array, curve: Signal, time: Array) -> float:
    """Standard deviation of a delay by its scatter where a part of the motion is left out: models are never exact."""
    part = np.arange(len(X)) * PARTS // len(X)
    found = []
    for k in range(PARTS):
        rest = np.flatnonzero(part != k)
        Q = basis(X[rest])

        def left(delay: float, rest: NDArray[np.int64] = rest, Q: Array = Q) -> float:
            y = curve(time - delay, 0.0)[rest]
            return 1.0 - float(((y @ Q) ** 2).sum()) / max(float(y @ y), 1e-300)

        found.append(least_of(left, 0.0, LONGEST)[0])
    return float(np.sqrt((PARTS - 1) / PARTS * np.sum((np.array(found) - np.mean(found)) ** 2)))


def curve_of(log: Log, unknowns: Unknowns, cutoff: float) -> Callable[[Array, float], Array]:
    """The efforts of a stretch behind the filters of its equations, at any times, behind a lag."""
    period = float(np.median(np.diff(log.time)))
    time = np.arange(log.time[0], log.time[-1], period)
    tau, _ = efforts(log, unknowns.robot, unknowns.rows)
    tau, made = evenly(log.time, tau, time), dict[float, Any]()

    def at(when: Array, lag: float) -> Array:
        if lag not in made:
            smooth = low_pass(low_pass(lagged(tau, lag, period), cutoff, 1 / period), cutoff, 1 / period)
            made[lag] = scipy.interpolate.make_interp_spline(time, smooth, 3)
        return np.asarray(made[lag](np.clip(when - log.effort_delay, time[0], time[-1])))

    return at


def basis(X: Array) -> Array:
    """Orthonormal columns that span those of X (M, k), without what is rounding."""
    size = np.linalg.norm(X, axis=0)
    used = np.flatnonzero(size > 1e-9 * size.max(initial=0.0))
    if not used.size or len(X) < 2:
        return np.zeros((len(X), 0))
    Q, R, _ = scipy.linalg.qr(X[:, used] / size[used], mode="economic", pivoting=True)
    return np.asarray(Q[:, np.abs(np.diag(R)) > RANKED * abs(R[0, 0])])


def recorded_delays(log: Log, cutoff: float) -> tuple[dict[str, Delay], dict[str, Delay]]:
    """Delays and lags of recorded rates behind the derivatives of their positions, and of efforts behind commands."""
    period = float(np.median(np.diff(log.time)))
    parts = [part for part in stretches_of(log, cutoff) if len(part.time) > 50]
    rates, motors = dict[str, Delay](), dict[str, Delay]()
    if not parts:
        return rates, motors
    part = max(parts, key=lambda one: len(one.time))
    time = np.arange(part.time[0], part.time[-1], period)
    cutoff = min(3 * cutoff, 0.3 / period)
    for name, measured in part.velocity.items():
        if name in part.position:
            q = low_pass(evenly(part.time, part.position[name][:, None], time), cutoff, 1 / period)[:, 0]
            one = follower_delay(
                time, scipy.interpolate.make_interp_spline(time, q, 5)(time, 1), measured, part.time, cutoff
            )
            rates |= {} if one is None else {name: one}
    for name, command in part.command.items():
        if name in part.effort:
            u = low_pass(evenly(part.time, command[:, None], time), cutoff, 1 / period)[:, 0]
            one = follower_delay(time, u, part.effort[name], part.time, cutoff)
            motors |= {} if one is None else {name: one}
    return rates, motors


def follower_delay(time: Array, first: Array, measured: Array, at: Array, cutoff: float) -> Delay | None:
    """Delay and lag of a signal behind another one.

    Args:
        time: (N,) even times [s].
        first: (N,) the other one, low-passed.
        measured: (M,) the signal at its own times.
        at: (M,) these [s].
        cutoff: Of the low-pass [Hz].
    """
    period, made = float(time[1] - time[0]), dict[float, Any]()
    y = low_pass(evenly(at, measured[:, None], time), cutoff, 1 / period)[:, 0]
    if not np.ptp(first) > 1e-3 or not np.ptp(y) > 1e-3:
        return None

    def curve(when: Array, lag: float) -> Array:
        if lag not in made:
            made[lag] = scipy.interpolate.make_interp_spline(time, lagged(first, lag, period), 3)
        return np.asarray(made[lag](np.clip(when, time[0], time[-1])))

    keep = np.flatnonzero((time > time[0] + LONGEST) & (time < time[-1] - LONGEST))[:: max(1, len(time) // FOLLOWED)]
    X = np.column_stack((y, np.ones(len(y))))[keep]
    found = delay_of(basis(X), curve, time[keep], lags=True) if len(keep) > 50 else None
    if found is not None and found.lag:  # a lag takes noise away, too: it has to explain more than one on both sides
        both = lagged(np.column_stack((y, np.ones(len(y)))), found.lag, period)[keep]
        smoothed = curve(time[keep], found.lag)
        if np.linalg.norm(residual_of(basis(both), smoothed)) < 2 * found.error * np.linalg.norm(smoothed):
            found = delay_of(basis(X), curve, time[keep])
    least = SAMPLED * period
    return found and replace(found, sd=max(found.sd, least), lag_sd=max(found.lag_sd, least) * bool(found.lag))
