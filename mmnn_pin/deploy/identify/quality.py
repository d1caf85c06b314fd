"""Faults of a recorded motion, found before it is fitted: mended where that is safe, reported, or refused.

Times are those of `times`. Signals: numbers that are none, spikes, seams of encoders, jumps, stairs, saturation. Rates
against the derivative of the positions: unit, sign, exchanged joints. What the physics of the whole robot says is the
`doctor`'s.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from fnmatch import fnmatchcase

import numpy as np
import scipy
from numpy.typing import NDArray

from ...elementary.arrays import unwrapped
from ...errors import RecordingError
from ...model.robot import Robot, speed_limits
from ...signals import Array
from .log import Log, LogFinding, is_angle, revolves
from .mends import without_seam
from .times import GAP, cut_at, sound_times

Bools = NDArray[np.bool_]
SPIKE = 10.0  # deviations from the median of five that count as a spike
SATURATED = 0.02  # share of rows at one extreme
CLEAR, OPPOSITE = 0.5, 0.8  # correlation from which a comparison counts; from which a signal is another one's negative
HOLED = 0.5  # share of a signal's rows without a number from which it is left out
TURNS = (2 * np.pi, 360.0, 1.0, 2.0, 400.0, 6400.0, *(2.0**bits for bits in range(7, 33)))  # periods of encoders
HELD = 0.9  # share of changes that come at every so many rows from which a signal is held in between
TOO_FAST, TOO_FAR = 2.5, 1.5  # times a joint's limits of speed and position that no radians are


def sound(log: Log, robot: Robot, told: Collection[str] = ()) -> Log:
    """A log with its times in order, without what cannot be a measurement; its notes and findings say what was seen.

    Args:
        log: As it was read.
        robot: Whose signals count.
        told: Signals that the user mended, patterns.

    Raises:
        RecordingError: Times out of order, a motion too short, efforts that are all zero.
    """
    log = sound_times(numbers_only(log, robot), "time" in told)
    measured = [values for name, values in log.effort.items() if name in robot.actuator_names]
    if measured and not any(values.any() for values in measured):
        raise RecordingError("all efforts are zero", fix="record torques or currents of the motors", file=log.name)
    log = without_jumps(without_turns(without_stairs(despiked(log, robot)), robot, told), robot)
    notes = []
    for name, effort in log.effort.items():
        if name in robot.actuator_names and np.ptp(effort) == 0:
            notes.append(f"effort.{name} is {effort[0]:g} all the time")
        elif name in robot.actuator_names and (share := saturated(effort).mean()) > SATURATED:
            notes.append(f"effort.{name} is saturated in {100 * share:.0f} % of the rows: they are left out")
    log = log.with_signals(log.signals, None, *notes)
    return log.with_findings(*beyond_positions(log, robot, told), *rates_against_positions(log, robot))


def is_used(signal: str, robot: Robot) -> bool:
    """Whether a fit uses a signal; rates of joints are only compared."""
    kind, _, name = signal.partition(".")
    wheels = [wheel.joint for wheel in robot.base.wheels]
    joints = {"position": (*robot.joint_names, *wheels), "effort": robot.actuator_names}
    return kind in ("base", "reference") or name in joints.get(kind, ())


def numbers_only(log: Log, robot: Robot) -> Log:
    """The log without what is no number: signals that nothing uses, or rows; a reference may have holes."""
    signals, findings, holes = log.signals, [], np.zeros(len(log.time), bool)
    for signal, values in log.signals.items():
        bad = ~np.isfinite(values)
        share = float(bad.mean())
        if share == 0 or signal.startswith("reference."):
            continue
        where = f"{signal} has {np.count_nonzero(bad)} values that are no numbers"
        used = is_used(signal, robot)
        if not used or share > HOLED:
            del signals[signal]
            changes = "the signal is left out" + ("" if used else ": the fit does not use it")
            if used and signal.startswith("position."):
                mends, changes = ((signal, "dropped"),), "all torques that depend on where it stands"
                findings.append(LogFinding("refused", where, "", changes, mends, "which takes it as still", 50.0))
            else:
                findings.append(LogFinding("warned" if used else "mended", where, "", changes))
        else:
            holes |= bad
            findings.append(LogFinding("mended", where, "", "these rows are left out"))
    made = log.with_signals(signals).with_findings(*findings)
    return made.rows(~holes) if holes.any() else made


# -- positions ---------------------------------------------------------------------------------------------------------


def without_turns(log: Log, robot: Robot, told: Collection[str] = ()) -> Log:
    """A log whose positions go on where their encoders turned over, whatever the period.

    Of the periods that encoders have, the one is taken that holds all values, that the jumps are, and after which
    nothing jumps; of others their own mean, where three jumps agree.
    """
    signals, findings = log.signals, []
    for signal, values in signals.items():
        if not (signal.startswith("position.") or is_angle(signal, robot)) or any(fnmatchcase(signal, p) for p in told):
            if is_angle(signal, robot):
                signals[signal] = unwrapped(values)
            continue
        period, why = seam_of(values)
        if period and period != 2 * np.pi:
            signals[signal] = without_seam(values, period)
            what = f"{signal} turns over after {period:.6g}"
            unit = "deg" if period == 360 else "rev" if period == 1 else f"counts:{period:.6g}"
            fix = f"if a turn is that: --mend '{signal}={unit}'"
            findings.append(LogFinding("warned", what, why, "it goes on there", fix=fix))
        elif is_angle(signal, robot) and not np.array_equal(found := unwrapped(values), values, equal_nan=True):
            signals[signal] = found
            findings.append(LogFinding("mended", f"{signal}: whole turns taken out", "", "it goes on there"))
    return log.with_signals(signals).with_findings(*findings)


def seam_of(values: Array) -> tuple[float, str]:
    """The period after which a series turns over, and how that is seen; 0 for none."""
    x = values[np.isfinite(values)]
    jump, size = jumps_of(x)
    if not jump.size:
        return 0.0, ""
    span, count = float(np.ptp(x)), len(jump)
    for period in sorted(TURNS):
        if 0.6 * period <= span <= 1.02 * period and np.abs(np.abs(size) - period).max() < 0.1 * period:
            return period, f"{count} jumps of that size"
    mean = float(np.abs(size).mean())
    if count >= 3 and np.abs(size).std() < 0.05 * mean and span < 1.1 * mean:
        return mean, f"{count} jumps of {mean:.6g} +- {1.96 * np.abs(size).std() / np.sqrt(count):.2g}"
    return 0.0, ""


def jumps_of(x: Array) -> tuple[NDArray[np.int64], Array]:
    """Rows (k,) before which a series jumps by more than its speed explains, and by how much (k,)."""
    step = np.diff(x)
    if len(step) < 10:
        return np.zeros(0, np.int64), np.zeros(0)
    off = step - scipy.ndimage.median_filter(step, 5, mode="nearest")
    usual = max(3.0 * float(np.percentile(np.abs(step), 75)), 30.0 * float(np.median(np.abs(off))), 1e-9)
    rows = np.flatnonzero((np.abs(off) > usual) & (np.abs(off) > 0.02 * np.ptp(x)))
    return rows + 1, off[rows]


def without_jumps(log: Log, robot: Robot) -> Log:
    """The log cut where a joint is at once somewhere else: two recordings in one."""
    rows, step = set[int](), np.diff(log.time, prepend=log.time[0])
    near = step <= GAP * np.median(step)
    for signal, values in log.signals.items():
        kind, _, name = signal.partition(".")
        least = 0.1 if name in robot.full_velocity_names and revolves(robot, name) else 0.05
        if kind == "position" and is_used(signal, robot):
            at, size = jumps_of(values)
            far = near[at] & (np.abs(size) > least + 6 * np.median(np.abs(np.diff(values))))
            rows |= {int(k) for k in at[far]} if far.sum() <= 5 else set()
    cut = [k for k in sorted(rows) if 5 < k < len(log.time) - 5]
    if not cut:
        return log
    what = f"positions jump at t = {', '.join(f'{log.time[k]:.4g}' for k in cut)} s"
    found = LogFinding("warned", what, "faster than the joint moves elsewhere", "cut there, as between two recordings")
    return cut_at(log, np.array(cut)).with_findings(found)


def without_stairs(log: Log) -> Log:
    """The log with values that are held for some rows drawn on from one to the next, by a cubic spline."""
    signals, told = log.signals, dict[int, list[str]]()
    for signal, values in signals.items():
        kind = signal.partition(".")[0]
        if kind in ("position", "effort", "base") and (rows := held_rows(values)):
            at = np.arange(np.bincount(changes(values) % rows).argmax(), len(values), rows)
            inside = slice(at[0], at[-1] + 1)
            drawn = scipy.interpolate.make_interp_spline(log.time[at], values[at], 3)(log.time[inside])
            signals[signal] = np.concatenate((values[: at[0]], drawn, values[at[-1] + 1 :]))
            told.setdefault(rows, []).append(signal)
    findings = [
        LogFinding("mended", f"{', '.join(names)} are held for {rows} rows", "", "drawn on from one value to the next")
        for rows, names in told.items()
    ]
    return log.with_signals(signals).with_findings(*findings)


def held_rows(values: Array) -> int:
    """For how many rows a series is held, as by a slower clock; 0 for one that is not, or has the steps of counts."""
    at = changes(values)
    if len(at) < 20 or len(at) > 0.6 * len(values):
        return 0
    for rows in range(min(50, len(values) // 20), 1, -1):
        if len(at) > 0.3 * len(values) / rows and np.bincount(at % rows).max() > HELD * len(at):
            return rows
    return 0


def changes(values: Array) -> NDArray[np.int64]:
    """Rows at which a series has another value than before."""
    return np.flatnonzero(np.diff(values)) + 1


def beyond_positions(log: Log, robot: Robot, told: Collection[str]) -> Iterator[LogFinding]:
    """Findings of positions that are no radians by the limits of their joints."""
    limit = dict(zip(robot.actuator_names, speed_limits(robot), strict=True))
    names, found = robot.full_velocity_names, []
    for name, q in log.position.items():
        signal = f"position.{name}"
        if name not in names or not revolves(robot, name) or any(fnmatchcase(signal, one) for one in told):
            continue
        low, high = robot.lower[names.index(name)], robot.upper[names.index(name)]
        speed = float(np.percentile(np.abs(np.gradient(q, log.time)), 95))
        far = np.ptp(q) > TOO_FAR * (high - low) and np.ptp(q) < TOO_FAR * np.rad2deg(high - low)
        fast = speed > TOO_FAST * limit.get(name, np.inf) and speed < np.rad2deg(limit.get(name, np.inf))
        if (np.isfinite(high - low) and far) or fast:
            why = f"it runs from {q.min():.4g} to {q.max():.4g}, its limits are {low:.4g} to {high:.4g} rad"
            why = why if far else f"it moves at {speed:.3g} a second, its limit is {limit[name]:.3g} rad/s"
            found.append((signal, why))
    if not found:
        return
    every = {f"position.{name}" for name in log.position if name in names and revolves(robot, name)}
    mends = tuple((signal, "deg") for signal, _ in found)
    if len(found) == len(every) and len(every) == len(log.position):
        mends = (("position.*", "deg"),)
    signals = ", ".join(signal for signal, _ in found)
    looks = "look" if len(found) > 1 else "looks"
    changes = "all torques, by 57 and more"
    yield LogFinding("refused", f"{signals} {looks} like degrees", found[0][1], changes, mends, "--degrees", 57.0)


# -- rates against positions -------------------------------------------------------------------------------------------


def rates_against_positions(log: Log, robot: Robot) -> Iterator[LogFinding]:
    """Findings of rates that are not those of their positions: exchanged, negated, in another unit."""
    names = [name for name in log.velocity if name in log.position]
    period = float(np.median(np.diff(log.time)))
    width = np.ones(max(3, round(0.1 / period)))
    width /= width.sum()
    every = max(1, len(log.time) // 6000)
    smooth = {n: np.convolve(np.gradient(log.position[n], log.time), width, "same")[::every] for n in names}
    given = {n: np.convolve(log.velocity[n], width, "same")[::every] for n in names}
    names = [n for n in names if np.sqrt((smooth[n] ** 2).mean() * (given[n] ** 2).mean()) > 1e-4]
    if not names:
        return
    A, B = np.array([smooth[n] for n in names]), np.array([given[n] for n in names])
    like = np.array([[likeness(a, b, every * period) for a in A] for b in B])
    best = scipy.optimize.linear_sum_assignment(-np.abs(like))[1]
    swapped = [(names[i], names[j]) for i, j in enumerate(best) if i != j and abs(like[i, j]) > abs(like[i, i]) + 0.3]
    if swapped:
        mends = tuple((f"velocity.{theirs}", f"velocity.{own}") for own, theirs in swapped)
        what = ", ".join(f"velocity.{own} is the rate of position.{theirs}" for own, theirs in swapped)
        fix = "the same with position in place of velocity, if these are exchanged"
        yield LogFinding("refused", what, "by their likeness", "which joint is which", mends, fix, 20.0)
    for i, name in enumerate(names):
        if best[i] == i:
            ratio = float(np.sqrt((B[i] ** 2).mean() / (A[i] ** 2).mean()))
            yield from against_its_position(name, float(like[i, i]), ratio, log, robot)


def against_its_position(name: str, like: float, ratio: float, log: Log, robot: Robot) -> Iterator[LogFinding]:
    """Findings of a rate with a likeness to, and a ratio over, the rate of its position."""
    signal = f"velocity.{name}"
    if like < -OPPOSITE:
        what, fix = f"{signal} has the opposite sign of its position's rate", f"--mend 'position.{name}=negated'"
        yield LogFinding("refused", what, f"correlation {like:.2f}", "signs", ((signal, "negated"),), fix, 10.0)
    elif like < CLEAR:
        what, why = f"{signal} is not the rate of position.{name}", f"correlation {like:.2f}"
        yield LogFinding("refused", what, why, "one of the two", ((signal, "dropped"),), "if it is the rate", 5.0)
    elif abs(ratio * np.pi / 180 - 1) < 0.1:
        what = f"{name}: the velocity in degrees, the position in radians"
        yield LogFinding("warned", what, f"ratio {ratio:.3g}", "positions are used", ((signal, "deg"),))
    elif abs(ratio * 180 / np.pi - 1) < 0.1:
        what = f"{name}: the position in degrees, the velocity in radians"
        mend = ((f"position.{name}", "deg"),)
        yield LogFinding("refused", what, f"ratio {ratio:.3g}", "all torques, by 57 and more", mend, "", 57.0)
    elif not 0.7 < ratio < 1.4:
        yield LogFinding("warned", f"{signal} is {ratio:.3g} times the rate of its position", "", "positions are used")


def likeness(a: Array, b: Array, period: float, most: float = 0.3) -> float:
    """Correlation of two signals, the largest in size over shifts."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    reach = min(round(most / period), len(a) // 4)
    found = 0.0
    for shift in np.unique(np.linspace(-reach, reach, 41).astype(int)):
        one = float(a[max(0, -shift) : len(a) - max(0, shift)] @ b[max(0, shift) : len(b) + min(0, shift) or None])
        found = max((found, one / max(size, 1e-300)), key=abs)
    return found


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
        middle = scipy.ndimage.median_filter(values, 5, mode="nearest")
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
