"""Mends of a log: `SIGNAL=HOW`, told by the user or advised by the doctor; one way for both.

SIGNAL is a signal's name, with `*` for several. HOW is

    s ms us ns, rad deg rev, m cm mm, Nm mNm    the unit that it has in the log
    counts:4096                                 counts of an encoder, so many a turn
    negated                                     its sign is the other one
    late:0.02                                   recorded so much later than it was [s]; negative: it acts later
    lag:0.005                                   a command that a motor of this time constant follows [s]
    seam:4096                                   jumps by this period where its encoder turns over, in its own unit
    effort.elbow                                another signal's numbers
    dropped                                     leave it out

`LOG:SIGNAL=HOW` mends one log of several, by its name without folder and ending.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import scipy

from ...errors import InputError, UnknownName
from ...signals import Array
from .log import Log

UNITS = {
    "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "rad": 1.0, "deg": np.pi / 180, "rev": 2 * np.pi, "m": 1.0,
    "cm": 1e-2, "mm": 1e-3, "Nm": 1.0, "mNm": 1e-3, "negated": -1.0,
}  # fmt: skip
WITH_NUMBER = ("counts", "late", "lag", "seam")
KEY = "--mend"

Mend = tuple[tuple[str, str], ...]


def mended(log: Log, mends: Mapping[str, str] | Iterable[tuple[str, str]]) -> Log:
    """A log with its signals mended, one mend after the other.

    Args:
        log: It.
        mends: SIGNAL and HOW, see the module.

    Raises:
        UnknownName: A signal that the log does not have.
        InputError: No such mend, or a number that cannot be.
    """
    pairs = list(mends.items() if isinstance(mends, Mapping) else mends)
    before, signals, time = log.signals, log.signals, log.time
    for pattern, how in pairs:
        if pattern == "time":
            time = (time - time[0]) * unit_of(how)
            continue
        names = [name for name in signals if fnmatchcase(name, pattern)]
        if not names:
            raise UnknownName("signal", pattern, tuple(before), key=KEY, file=log.name)
        for name in names:
            if how == "dropped":
                del signals[name]
            elif how in before:
                signals[name] = before[how]
            else:
                signals[name] = made_of(how, signals[name], time)
    late = np.zeros(len(time), bool)
    for _, how in pairs:
        if how.startswith("late:"):
            late |= ~np.isfinite(np.interp(time + number_of(how), time, time, np.nan, np.nan))
    made = log.with_signals(signals, time, *(f"{pattern}: {how}, as told" for pattern, how in pairs))
    return made.rows(~late) if late.any() else made


def mends_of(log: Log, mends: Mend) -> Mend:
    """The mends of a log among those of several: its own, and those of signals that it has."""
    names, found = ("time", *log.signals), []
    for pattern, how in mends:
        name, colon, signal = pattern.rpartition(":")
        if colon and name not in (log.name, Path(log.name).stem):
            continue
        if any(fnmatchcase(one, signal) for one in names):
            found.append((signal, how))
    return tuple(found)


def told_delays(mends: Mend, motors: Sequence[str]) -> dict[str, tuple[float, float]]:
    """By how much efforts of motors were told to be late, and the lags of these [s]."""
    found: dict[str, tuple[float, float]] = {}
    for pattern, how in mends:
        word = how.partition(":")[0]
        for name in motors if word in ("late", "lag") and ":" in how else ():
            if fnmatchcase(f"effort.{name}", pattern):
                late, lag = found.get(name, (0.0, 0.0))
                x = number_of(how)
                found[name] = (late + x, lag) if word == "late" else (late, lag + x)
    return found


def require_signals(logs: Sequence[Log], mends: Mend) -> None:
    """Refuse a mend that no log has a signal for (`UnknownName`)."""
    for mend in mends:
        if not any(mends_of(log, (mend,)) for log in logs):
            names = dict.fromkeys(name for log in logs for name in log.signals)
            raise UnknownName("signal", mend[0], tuple(names), key=KEY)


def unit_of(how: str) -> float:
    """Factor of a unit.

    Raises:
        InputError: There is none of that name.
    """
    if how not in UNITS:
        fix = (
            f"give a unit ({', '.join(UNITS)}), {', '.join(f'{word}:NUMBER' for word in WITH_NUMBER)}, a signal's name"
        )
        raise InputError(f"'{how}' mends nothing", fix=f"{fix} or 'dropped'", key=KEY)
    return UNITS[how]


def number_of(how: str) -> float:
    """The number behind a colon.

    Raises:
        InputError: It is none, or cannot be.
    """
    word, _, text = how.partition(":")
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value) or (word != "late" and value <= 0):
        raise InputError(f"'{how}'", why=f"'{text}' is no number above 0", fix=f"write {word}:0.02", key=KEY)
    return value


def made_of(how: str, values: Array, time: Array) -> Array:
    """Numbers of a signal, mended."""
    word = how.partition(":")[0]
    if word not in WITH_NUMBER or ":" not in how:
        return values * unit_of(how)
    x = number_of(how)
    if word == "counts":
        return values * (2 * np.pi / x)
    if word == "seam":
        return without_seam(values, x)
    if word == "late":
        return np.interp(time + x, time, values)
    return lagged(values, x, float(np.median(np.diff(time))))


def lagged(values: Array, lag: float, period: float) -> Array:
    """Columns behind a first-order lag [s]."""
    if lag <= 0:
        return values
    a = float(np.exp(-period / lag))
    start = a * values[:1] if values.ndim > 1 else np.array([a * values[0]])
    return np.asarray(scipy.signal.lfilter([1 - a], [1, -a], values, axis=0, zi=start)[0])


def without_seam(values: Array, period: float) -> Array:
    """A series (N,) that goes on where its encoder turns over after a period; what is not finite stays so."""
    found, there = np.array(values), np.isfinite(values)
    found[there] = np.unwrap(values[there], period=period)
    return found


def read_mends(given: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """The pairs of `--mend`, each checked.

    Raises:
        InputError: One that is none.
    """
    found: list[tuple[str, str]] = []
    for text in given:
        signal, equals, how = text.partition("=")
        if not (signal and equals and how):
            raise InputError(f"'{text}' is no mend", fix="write SIGNAL=HOW, such as position.wheel=negated", key=KEY)
        checks: dict[str, Callable[[str], float]] = dict.fromkeys(WITH_NUMBER, number_of)
        word = how.partition(":")[0]
        if word in checks:
            checks[word](how)
        elif how != "dropped" and "." not in how:
            unit_of(how)
        found.append((signal, how))
    return tuple(found)


def words_of(mends: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Faults that mends mend, in words."""
    for signal, how in mends:
        if how == "negated":
            yield f"{signal} has the other sign"
        elif how.startswith("late:"):
            yield f"{signal} is {1e3 * float(how[5:]):.3g} ms late"
        else:
            yield f"{signal} is in {how}" if "." not in how else f"{signal} is {how}"
