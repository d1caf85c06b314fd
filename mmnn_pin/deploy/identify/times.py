"""Times of a log put in order: their unit, counters that roll over, recordings one after the other, gaps, jitter."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...signals import Array
from .log import Log, LogFinding

GAP = 4.0  # median periods without a row that count as a gap
JITTER = 0.05  # share of the period above which it is told
SHORTEST = 2.0  # [s] of motion
COARSEST = 3.0  # rows per time
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
PERIODS = 2e-5, 0.55  # that a log can have [s]
USUAL = 0.7  # [rad/s] a speed as robots have them, where no rate is recorded
ROUND = (7 * 86400.0, 86400.0, 3600.0, 60.0)  # [s] after which clocks begin anew
MANY = 300  # rows per recording from which a time that goes back begins another one


def sound_times(log: Log, told: bool = False) -> Log:
    """The log in seconds, from zero, without rows that come twice, its recordings apart.

    Args:
        log: As it was read.
        told: Whether the user said in which unit its times are.

    Raises:
        RecordingError: Times that are no numbers, or in no order, or a motion too short.
    """
    if not np.isfinite(log.time).all():
        raise RecordingError("the time has values that are no numbers", fix="cut them out", file=log.name)
    if not (np.diff(log.time) > 0).any():
        raise RecordingError("the time stands still", fix="map the column of times with --columns", file=log.name)
    log = rolled_on(log.with_signals(log.signals, log.time - log.time[0]))
    if (each := len(log.time) / len(np.unique(log.time))) > COARSEST:
        what = f"the times are too coarse: {each:.0f} rows have the same one"
        fix = "write them with more digits, or leave them out and give --rate HZ"
        raise RecordingError(what, why="what happened between these rows is lost", fix=fix, file=log.name)
    if not told:
        log = in_seconds(log)
    if twice := np.count_nonzero(np.diff(log.time) == 0):
        keep = np.concatenate(([True], np.diff(log.time) > 0))
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
        why, fix = f"at least {SHORTEST:g} s are needed", "record a minute, or name the times' unit: --mend time=ms"
        raise RecordingError(what, why=why, fix=fix, file=log.name)
    return log.with_signals(log.signals, None, *more)


def spans(time: Array) -> list[slice]:
    """Stretches of rows without gaps."""
    step = np.diff(time)
    ends = [0, *(np.flatnonzero(step > GAP * np.median(step)) + 1), len(time)]
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def cut_at(log: Log, rows: NDArray[np.int64]) -> Log:
    """The log with a gap of time before some rows, so that nothing is made of what lies on both sides."""
    step = np.diff(log.time)
    pause = np.zeros(len(log.time))
    pause[rows] = 3 * GAP * float(np.median(step[step > 0]))
    return log.with_signals(log.signals, log.time + np.cumsum(pause))


# -- times that go back ------------------------------------------------------------------------------------------------


def rolled_on(log: Log) -> Log:
    """The log with times that go on where a counter rolled over, and apart where another recording begins.

    Raises:
        RecordingError: Rows in no order.
    """
    time, step = log.time, np.diff(log.time)
    back = np.flatnonzero(step < 0)
    if not back.size:
        return log
    period = float(np.median(step[step > 0]))
    turns = period - step[back]
    turn = round_number(float(turns.max()), 0.5 * period) or round_number(float(np.median(turns)), 0.5 * period)
    rolls = bool(turn) and bool((turns - turn).max() < GAP * period)  # fewer where rows are missing there
    if not rolls and back.size > max(1, len(time) // MANY):
        why = f"{time[back[0] + 1]:.6g} after {time[back[0]]:.6g}"
        what = f"the time goes back {back.size} times, first at row {back[0] + 2}"
        raise RecordingError(what, why=why, fix="sort the rows by their time", file=log.name)
    if rolls:
        added = np.concatenate(([0.0], np.cumsum(np.where(step < 0, turn, 0.0))))
        what = f"the time rolls over {back.size} times, after {turn:.10g} of its units"
        found = LogFinding("mended", what, "the next row follows by one period", "rows go on")
        return log.with_signals(log.signals, time + added).with_findings(found)
    begins = np.concatenate(([0.0], np.cumsum(np.where(step < 0, period - step, 0.0))))
    what = f"{back.size + 1} recordings in one: the time begins anew at row {', '.join(str(k + 2) for k in back[:5])}"
    found = LogFinding("mended", what, "by no turn of a counter", "nothing is made across their border")
    return cut_at(log.with_signals(log.signals, time + begins), back + 1).with_findings(found)


def round_number(turn: float, tolerance: float) -> float:
    """The period of a counter, a power of two or of a clock, that a turn is within a tolerance; 0 for none."""
    powers = [2.0**bits for bits in range(8, 65)]
    known = [power * unit for power in powers for unit in UNITS.values()]
    known += [span / unit for span in ROUND for unit in UNITS.values()]
    near = [one for one in known if abs(one - turn) <= tolerance and one > 4 * tolerance]
    return min(near, key=lambda one: abs(one - turn), default=0.0)


# -- their unit --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Unit:
    """A unit that times may have."""

    name: str  # of it
    off: float  # how far the motion is from what it would be, in factors of ten
    why: str  # by what


def in_seconds(log: Log) -> Log:
    """The log in seconds, by the rates that it has, or by what robots' speeds and periods are."""
    step = np.diff(log.time)
    period = float(np.median(step[step > 0]))
    speed, ratio = speeds(log)
    likely = []
    for name, factor in UNITS.items():
        if not PERIODS[0] <= period * factor <= PERIODS[1]:
            continue
        if np.isfinite(ratio):
            likely.append(Unit(name, abs(float(np.log10(ratio / factor))), "recorded rates are those of the positions"))
        else:
            size = float(np.log10(speed / factor / USUAL)) if speed > 0 else 0.0
            likely.append(Unit(name, abs(size), f"speeds of {speed / factor:.3g} rad/s"))
    best = min(likely, key=lambda one: one.off, default=Unit("s", 0.0, ""))
    if best.name == "s":
        return log
    factor = UNITS[best.name]
    found = LogFinding(
        "mended", f"the time counts {best.name}: one row every {1e3 * period * factor:.4g} ms", best.why,
        "all rates", fix="if not so: --mend time=s",
    )  # fmt: skip
    return log.with_signals(log.signals, log.time * factor).with_findings(found)


def speeds(log: Log) -> tuple[float, float]:
    """The fastest position's speed per unit of time, and recorded rates over those of positions; nan without.

    A rate in degrees per second beside radians is a factor of 57, far less than the step of a unit of time.
    """
    step = np.maximum(np.diff(log.time), 1e-300)
    fastest, ratios = 0.0, []
    for name, values in log.position.items():
        every = max(1, len(values) // 2000)
        x, t = values[::every], log.time[::every]
        rate = np.abs(np.diff(x) / np.maximum(np.diff(t), 1e-300))
        rate = rate[np.isfinite(rate)]
        size = float(np.percentile(rate, 90)) if rate.size else 0.0
        fastest = max(fastest, size)
        measured = log.velocity.get(name)
        if measured is not None and size * float(np.median(step)) > 1e-9 and np.isfinite(measured).any():
            given = float(np.nanpercentile(np.abs(measured), 90))
            if given > 0:
                ratios.append(size / given)
    return fastest, float(np.median(ratios)) if ratios else np.nan
