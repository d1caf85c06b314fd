"""Faults of a recorded motion, found before it is fitted: mended where that is safe, reported, or refused.

Times: unit, order, duplicates, gaps, jitter. Signals: NaN, constants, saturation, spikes. Velocities against the
derivative of the positions: unit, sign, lag. Efforts against the robot's own prediction: signs and exchanged joints
(`misnamed`).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.optimize import linear_sum_assignment

from ...errors import RecordingError
from ...model.robot import Robot
from ...signals import Array
from .log import Log, revolves

Bools = NDArray[np.bool_]
GAP = 4.0  # median periods without a row that count as a gap
JITTER = 0.05  # share of the period above which it is told
SHORTEST = 2.0  # [s] of motion
UNITS = ((1e6, 1e-9, "nanoseconds"), (1e3, 1e-6, "microseconds"), (0.9, 1e-3, "milliseconds"))  # median period from
SPIKE = 10.0  # deviations from the median of five that count as a spike
SATURATED = 0.02  # share of rows at one extreme
CLEAR, OPPOSITE = 0.5, 0.8  # correlation from which a comparison counts; from which a signal is another one's negative


def sound(log: Log, robot: Robot) -> Log:
    """A log with its times in order, without what cannot be a measurement; its notes say what was done.

    Raises:
        RecordingError: Times out of order, NaN, a motion too short, efforts that are all zero.
    """
    log = sound_times(log)
    for signal, values in log.signals.items():
        if bad := np.count_nonzero(~np.isfinite(values)):
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            what = f"{signal} has {bad} values that are no numbers, the first at t = {log.time[row]:.6g} s"
            raise RecordingError(what, fix="cut them out, or record it again", file=log.name)
    measured = [values for name, values in log.effort.items() if name in robot.actuator_names]
    if measured and not any(values.any() for values in measured):
        raise RecordingError("all efforts are zero", fix="record torques or currents of the motors", file=log.name)
    return despiked(sound_signals(log, robot), robot)


# -- times -------------------------------------------------------------------------------------------------------------


def sound_times(log: Log) -> Log:
    """The log in seconds, from zero, without rows that come twice.

    Raises:
        RecordingError: Times that are no numbers, or go back, or a motion too short.
    """
    if not np.isfinite(log.time).all():
        raise RecordingError("the time has values that are no numbers", fix="cut them out", file=log.name)
    time, notes = log.time - log.time[0], []
    step = np.diff(time)
    if (step < 0).any():
        row = int(np.argmax(step < 0)) + 1
        what = f"the time goes back {np.count_nonzero(step < 0)} times, first at row {row + 1}"
        raise RecordingError(what, why=f"{time[row]:.6g} s after {time[row - 1]:.6g} s", fix="sort it", file=log.name)
    if not (step > 0).any():
        raise RecordingError("the time stands still", fix="map the column of times with --columns", file=log.name)
    period = float(np.median(step[step > 0]))
    for least, factor, unit in UNITS:
        if period > least:
            time, period = time * factor, period * factor
            notes.append(f"the time counts {unit}: one row every {1e3 * period:.4g} ms")
            break
    log = log.with_signals(log.signals, time, *notes)
    if twice := np.count_nonzero(np.diff(time) == 0):
        keep = np.concatenate(([True], np.diff(time) > 0))
        log = log.rows(keep, f"{twice} rows repeat the time of the row before: left out")
    step = np.diff(log.time)
    period, gaps = float(np.median(step)), np.flatnonzero(step > GAP * np.median(step))
    more = [f"{1 / period:.4g} rows per second, {log.time[-1]:.4g} s"]
    if gaps.size:
        more.append(
            f"{gaps.size} gaps, the longest {step.max():.3g} s at t = {log.time[step.argmax()]:.4g} s: cut there"
        )
    jitter = float(np.std(step[step <= GAP * period])) / period
    if jitter > JITTER:
        more.append(f"the period jitters by {100 * jitter:.0f} %: interpolated to even times")
    if log.time[-1] < SHORTEST:
        what = f"{log.time[-1]:.6g} s of motion"
        raise RecordingError(what, why=f"at least {SHORTEST:g} s are needed", fix="record a minute", file=log.name)
    return log.with_signals(log.signals, None, *more)


def spans(time: Array) -> list[slice]:
    """Stretches of rows without gaps."""
    step = np.diff(time)
    ends = [0, *(np.flatnonzero(step > GAP * np.median(step)) + 1), len(time)]
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


# -- joints ------------------------------------------------------------------------------------------------------------


def sound_signals(log: Log, robot: Robot) -> Log:
    """The log as it is; its notes say what velocities, constants and saturation tell.

    Raises:
        RecordingError: Positions or velocities that are in degrees, or have another sign.
    """
    notes = []
    names = robot.full_velocity_names
    for name, q in log.position.items():
        if name in names and revolves(robot, name) and np.ptp(q) > 8 * np.pi and np.abs(q).max() <= 800:
            low, high = robot.lower[names.index(name)], robot.upper[names.index(name)]
            if np.isfinite(high - low) and np.ptp(q) > 1.5 * (high - low):
                why = f"it runs from {q.min():.4g} to {q.max():.4g}, its limits are {low:.4g} to {high:.4g} rad"
                fix = "convert it to radians, or give --degrees"
                raise RecordingError(f"position.{name} looks like degrees", why=why, fix=fix, file=log.name)
        if name in log.velocity:
            notes += list(compared(log, name, q, log.velocity[name]))
    for name, effort in log.effort.items():
        if name in robot.actuator_names and np.ptp(effort) == 0:
            notes.append(f"effort.{name} is {effort[0]:g} all the time")
        elif name in robot.actuator_names and (share := saturated(effort).mean()) > SATURATED:
            notes.append(f"effort.{name} is saturated in {100 * share:.0f} % of the rows: they are left out")
    return log.with_signals(log.signals, None, *notes)


def compared(log: Log, name: str, q: Array, velocity: Array) -> Iterator[str]:
    """Notes on a velocity that is not the derivative of its position: another size, a lag.

    Raises:
        RecordingError: It has another sign or another unit.
    """
    rate = np.gradient(q, log.time)
    period = float(np.median(np.diff(log.time)))
    width = max(3, round(0.1 / period))
    smooth = np.convolve(rate, np.ones(width) / width, "same")
    given = np.convolve(velocity, np.ones(width) / width, "same")
    size = float(np.sqrt((smooth**2).mean() * (given**2).mean()))
    if not size > 1e-4:
        return
    correlation = float((smooth * given).mean()) / size
    ratio = float(np.sqrt((given**2).mean() / (smooth**2).mean()))
    if correlation < -OPPOSITE:
        fix = "negate one of the two: is the joint's direction that of the URDF?"
        raise RecordingError(f"velocity.{name} has the opposite sign of its position's rate", fix=fix, file=log.name)
    if correlation < CLEAR:
        why, fix = f"correlation {correlation:.2f}", "are two joints exchanged? map them with --columns"
        raise RecordingError(f"velocity.{name} is not the rate of position.{name}", why=why, fix=fix, file=log.name)
    for factor, unit in ((180 / np.pi, "velocity in degrees"), (np.pi / 180, "position in degrees")):
        if abs(ratio / factor - 1) < 0.1:
            fix = "convert it to radians, or give --degrees for both"
            raise RecordingError(f"{name}: the {unit}, the other in radians", fix=fix, file=log.name)
    if not 0.7 < ratio < 1.4:
        yield f"velocity.{name} is {ratio:.3g} times the rate of its position: positions are used"
    lag = delay(smooth, given, period)
    if abs(lag) > 1.5 * period:
        yield f"velocity.{name} lags its position by {1e3 * lag:.0f} ms: positions are used"


def delay(first: Array, second: Array, period: float, most: float = 0.3) -> float:
    """How much later a signal comes than another one that is like it [s]."""
    reach = min(round(most / period), len(first) // 4)
    shifts = range(-reach, reach + 1)
    middle = slice(reach, len(first) - reach)
    parts = [second[reach + k : len(second) - reach + k] for k in shifts]
    like = [float(first[middle] @ part) / (float(np.linalg.norm(part)) or 1.0) for part in parts]
    return (int(np.argmax(like)) - reach) * period


def saturated(effort: Array) -> Bools:
    """Rows at an extreme that comes in runs of three or more, (N,) of bool."""
    flat = np.zeros(len(effort), bool)
    if np.ptp(effort) == 0:
        return flat
    for extreme in (effort.min(), effort.max()):
        at = effort == extreme
        runs = at[:-2] & at[1:-1] & at[2:]
        flat[:-2] |= runs
        flat[1:-1] |= runs
        flat[2:] |= runs
    return flat if np.abs(effort[flat]).min(initial=np.inf) > 0.5 * np.abs(effort).max() else np.zeros_like(flat)


def despiked(log: Log, robot: Robot) -> Log:
    """The log with single rows that stand out of their neighbours replaced by the median of five."""
    signals, notes = log.signals, []
    for signal, values in signals.items():
        kind, _, name = signal.partition(".")
        if kind not in ("position", "effort") or name not in robot.full_velocity_names:
            continue
        middle = median_filter(values, 5, mode="nearest")
        off = np.abs(values - middle)
        spread = 1.4826 * float(np.median(off[off > 0])) if (off > 0).any() else 0.0
        steep = 3 * np.median(np.abs(np.diff(values)))  # a fast motion is no spike
        spikes = off > max(SPIKE * spread, steep)
        if spread > 0 and spikes.any() and spikes.mean() < 0.01:
            signals[signal] = np.where(spikes, middle, values)
            notes.append(
                f"{signal}: {np.count_nonzero(spikes)} spikes replaced, the first at t = "
                f"{log.time[np.argmax(spikes)]:.4g} s"
            )
    return log.with_signals(signals, None, *notes)


# -- efforts against the prediction ------------------------------------------------------------------------------------


def misnamed(names: tuple[str, ...], measured: Array, predicted: Array, speed: Array, use: Bools) -> Iterator[str]:
    """Efforts with another sign, and efforts of exchanged joints.

    Each measured effort is explained by every joint's predicted torque, viscous and dry friction, and a constant. The
    best assignment of efforts to joints (Hungarian algorithm) says which are exchanged. A joint whose friction drives
    it and whose torque has the wrong sign is negated.

    Args:
        names: Of the r joints.
        measured: (M, r) efforts.
        predicted: (M, r) torques of the robot without friction.
        speed: (M, r) of the joints.
        use: (M, r) rows that count, of bool.
    """
    count = len(names)
    explained, sign = np.zeros((count, count)), np.zeros((count, count))
    for i in range(count):
        for j in range(count):
            explained[i, j], sign[i, j] = share_explained(measured[:, i], predicted[:, j], speed[:, j], use[:, j])
    best = linear_sum_assignment(-explained)[1]
    for i, j in enumerate(best):
        if i != j and explained[i, j] > 0.7 and explained[i, j] - explained[i, i] > 0.3:
            yield (
                f"effort.{names[i]} fits {names[j]}: it explains {100 * explained[i, j]:.0f} % of it, "
                f"{names[i]} only {100 * explained[i, i]:.0f} %: are the two exchanged?"
            )
    for i, name in enumerate(names):
        if best[i] == i and sign[i, i] < 0 and explained[i, i] > CLEAR:
            yield f"effort.{name} has the opposite sign of the predicted torque and friction: negate it"


def share_explained(y: Array, torque: Array, speed: Array, use: Bools) -> tuple[float, float]:
    """Share of the variance of an effort that torque, friction and a constant explain; and the sign that they have.

    The sign is negative where the effort falls with the predicted torque and with the speed, as far as they matter.
    """
    if np.count_nonzero(use) < 20 or not np.ptp(y[use]) > 0:
        return 0.0, 0.0
    y, torque, speed = y[use], torque[use], speed[use]
    scale = np.abs(speed).max() or 1.0
    A = np.column_stack((np.ones_like(y), torque, speed, np.tanh(10 * speed / scale)))
    solution = np.linalg.lstsq(A, y, rcond=None)[0]
    left = float(np.var(y - A @ solution) / np.var(y))
    rubs = A[:, 2:] @ solution[2:]
    sizes = np.array([solution[1] * np.std(torque), np.sign(rubs @ speed) * np.std(rubs)])
    clear = sizes[np.abs(sizes) > 0.1 * np.abs(sizes).max(initial=0.0)]
    return 1 - left, -1.0 if clear.size and (clear < 0).all() else 1.0
