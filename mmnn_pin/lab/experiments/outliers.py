"""Runs that an average hides: an error that peaks far above those of the other runs, a torque that chatters.

RMS errors after a transient rank controllers. One that throws a joint about while it learns, or that shakes its motors,
may rank first all the same: a robot does not forget it.
"""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median

import numpy as np

from ...recording.recording import Recording, as_columns

FAR = 5.0  # times the median of the others, from which a run is told
THROWN = 0.05  # least peak that is told [rad or m]
CHATTER = 0.1  # RMS change of a motor's torque from sample to sample, of its RMS, from which it is told


def outliers(recordings: Mapping[str, Recording], metrics: Mapping[str, Mapping[str, float]]) -> list[str]:
    """A sentence for every completed run whose error peaks, or whose torque chatters, far above those of the others.

    Args:
        recordings: The runs by name.
        metrics: Their numbers.
    """
    runs = {name: run for name, run in recordings.items() if run.outcome.status == "completed" and len(run) > 1}
    if len(runs) < 2:
        return []
    peaks = {name: {k: v for k, v in metrics[name].items() if is_peak(k)} for name in runs}
    return [*far_peaks(peaks), *chattering({name: chatter(run) for name, run in runs.items()})]


def is_peak(key: str) -> bool:
    """Whether a metric is the peak of an error of a position."""
    return key.startswith(("pose_error.", "e.")) and key.endswith(".peak")


def far_peaks(peaks: Mapping[str, Mapping[str, float]]) -> list[str]:
    """What peaks farthest above the others in every run in which something does.

    Args:
        peaks: Run to metric to peak [rad or m].
    """
    found = []
    for name, own in peaks.items():
        usual = {key: of_others(peaks, name, key) for key in own}
        far = {key: peak / max(usual[key], 1e-12) for key, peak in own.items() if peak > THROWN}
        key = max(far, key=far.__getitem__, default="")
        if key and far[key] > FAR:
            what, times = key.partition(".")[2].removesuffix(".peak"), shown(far[key])
            found.append(
                f"{name} throws {what} about: its error peaks at {own[key]:.2g}, {times} times the others' "
                f"{usual[key]:.2g} [rad or m]; RMS errors of a later window do not show it"
            )
    return found


def chattering(shares: Mapping[str, Mapping[str, float]]) -> list[str]:
    """The motor that is shaken most in every run that shakes one.

    Args:
        shares: Run to motor to what `chatter` says.
    """
    found = []
    for name, own in shares.items():
        motor = max(own, key=own.__getitem__)
        usual = of_others(shares, name, motor)
        if own[motor] > max(CHATTER, FAR * usual):
            times = shown(own[motor] / max(usual, 1e-12))
            found.append(
                f"{name} shakes {motor}: its torque changes by {100 * own[motor]:.0f} % of its RMS from sample to "
                f"sample, {times} times as much as the others'"
            )
    return found


def of_others(table: Mapping[str, Mapping[str, float]], name: str, key: str) -> float:
    """The median of a number over the other runs."""
    return median(own[key] for other, own in table.items() if other != name and key in own)


def chatter(run: Recording) -> dict[str, float]:
    """RMS change of every motor's torque from sample to sample over its RMS, after the first fifth of a run."""
    torque = as_columns(run["motor_torque"])[len(run) // 5 :]
    change, size = (np.sqrt(np.mean(part**2, axis=0)) for part in (np.diff(torque, axis=0), torque))
    return dict(zip(run.labels("motor_torque"), (change / np.maximum(size, 1e-12)).tolist(), strict=True))


def shown(ratio: float) -> str:
    """A ratio in words."""
    return f"{ratio:.2g}" if ratio < 100 else "over 100"
