"""Runs that an average hides: an error that peaks far above those of the other runs, a torque that chatters.

RMS errors after a transient rank controllers. One that throws a joint about while it learns, or that shakes its motors,
may rank first all the same: a robot does not forget it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from statistics import median

import numpy as np

from ...recording.metrics import judged
from ...recording.recording import Recording, as_columns
from ...signals import Array

ERRORS, POSITIONS = ("pose_error.", "z.", "e."), ("pose_error.", "e.")  # signals that runs are ranked by; of places
FAR = 5.0  # times the median of the others, from which a run is told
THROWN = 0.05  # least peak that is told [rad or m]
SEEN = 1e-3  # least RMS error that a headline tells [rad or m]
LOST = 1.0  # error of a joint [rad or m], or of the base along an axis [m], by which a run is lost, as the judge counts
FAST = 10.0  # frequency above which a torque shakes its motor rather than moves it [Hz]
CHATTER = 0.1  # share of the RMS of a motor's torque that is that fast, from which it is told


def outliers(recordings: Mapping[str, Recording], metrics: Mapping[str, Mapping[str, float]]) -> list[str]:
    """A sentence for every completed run whose error peaks, or whose torque chatters, far above those of the others.

    Args:
        recordings: The runs by name.
        metrics: Their numbers.
    """
    runs = {name: run for name, run in recordings.items() if run.outcome.status == "completed" and len(run) > 1}
    if len(runs) < 2:
        return []
    errors = {name: {k: v for k, v in metrics[name].items() if k.startswith(ERRORS)} for name in runs}
    return [*far_peaks(errors), *chattering({name: chatter(run) for name, run in runs.items()})]


def far_peaks(errors: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Sentences on runs that peak far above the others and rank before a run that does not: the worst peak of each.

    Args:
        errors: Run to metric of an error to its value [rad or m].
    """
    worst = {}
    for name, own in errors.items():
        far = {key: own[key] / max(of_others(errors, name, key), 1e-12) for key in own if is_far(errors, name, key)}
        if far:
            worst[name] = max(far, key=far.__getitem__)
    found, ranks = [], {name: rank(own) for name, own in errors.items()}
    for name, key in worst.items():
        behind = [other for other in errors if other not in worst and ranks[other] > ranks[name]]
        if behind:
            what, peak = key.partition(".")[2].removesuffix(".peak"), errors[name][key]
            usual = of_others(errors, name, key)
            times = shown(peak / max(usual, 1e-12))
            found.append(
                f"{name} throws {what} about: its error peaks at {peak:.2g}, {times} times the others' {usual:.2g} "
                f"[rad or m]; by RMS errors it ranks before {' and '.join(behind)} all the same"
            )
    return found


def farthest(errors: Mapping[str, Mapping[str, float]], name: str, window: str) -> tuple[str, float] | None:
    """The pose or joint in which a run errs farthest above the others, and how many times; None where nowhere far.

    Args:
        errors: Run to metric to its value [rad or m].
        name: The run.
        window: End of the names of RMS errors that count, as peaks do.
    """
    far = {
        key: value / max(of_others(errors, name, key), 1e-12)
        for key, value in errors[name].items()
        if is_far(errors, name, key)
        or (
            key.startswith(POSITIONS) and key.endswith(window) and value > max(SEEN, FAR * of_others(errors, name, key))
        )
    }
    if not far:
        return None
    worst = max(far, key=far.__getitem__)
    return worst.partition(".")[2].removesuffix(".peak").removesuffix(window), far[worst]


def is_far(errors: Mapping[str, Mapping[str, float]], name: str, key: str) -> bool:
    """Whether a metric of a run is the peak of a position's error, large, and far above those of the others."""
    of_position = key.startswith(POSITIONS) and key.endswith(".peak")
    return of_position and errors[name][key] > max(THROWN, FAR * of_others(errors, name, key))


def lost_places(errors: Mapping[str, float]) -> dict[str, float]:
    """Metric to peak of the joints and axes of the base that err by `LOST` or more: no run that does so tracks.

    Args:
        errors: The metrics of a run [rad or m].
    """
    peaks = {key: value for key, value in errors.items() if key.startswith(POSITIONS) and key.endswith(".peak")}
    return {key: value for key, value in peaks.items() if value >= LOST and key != "pose_error.phi.peak"}


def worst_loss(recording: Recording, errors: Mapping[str, float]) -> str:
    """The metric by which a run is lost most; empty where it is not: what begins as far off is no loss.

    Args:
        recording: The run.
        errors: Its metrics [rad or m].
    """
    places = {k: peak for k, peak in lost_places(errors).items() if abs(error_of(recording, k)[0]) < LOST}
    return max(places, key=places.__getitem__, default="")


def error_of(recording: Recording, key: str) -> Array:
    """The error that a peak is of, `SIGNAL.LABEL.peak`, (k,)."""
    signal, label = key.removesuffix(".peak").split(".", 1)
    return as_columns(recording[judged(recording, signal)])[:, recording.labels(signal).index(label)]


def rank(own: Mapping[str, float]) -> float:
    """Mean logarithm of a run's RMS errors in the last window, by which runs are ranked; inf without one."""
    last = [key.rpartition(".rms_")[2] for key in own if ".rms_" in key][-1:]
    logs = [math.log(value) for key, value in own.items() for end in last if key.endswith(f".rms_{end}") and value > 0]
    return math.fsum(logs) / len(logs) if logs else math.inf


def chattering(shares: Mapping[str, Mapping[str, float]]) -> list[str]:
    """A sentence for every motor that runs shake: of each run that shakes some, the one that it shakes most.

    Args:
        shares: Run to motor to what `chatter` says.
    """
    shaken: dict[str, dict[str, float]] = {}  # motor to run to how many times as much as the others
    for name, own in shares.items():
        motor = max(own, key=own.__getitem__)
        usual = of_others(shares, name, motor)
        if own[motor] > max(CHATTER, FAR * usual):
            shaken.setdefault(motor, {})[name] = own[motor] / max(usual, 1e-12)
    found = []
    for motor, times in shaken.items():
        names, several = ", ".join(times), len(times) > 1
        who = f"{len(times)} runs shake {motor} ({names})" if several else f"{names} shakes {motor}"
        parts = sorted(shares[name][motor] for name in times)
        ends = " to ".join(dict.fromkeys(f"{100 * part:.0f}" for part in (parts[0], parts[-1])))
        most = f"{'up to ' * several}{shown(max(times.values()))} times"
        found.append(
            f"{who}: {ends} % of the RMS of its torque is faster than {FAST:g} Hz, {most} as much as the others'"
        )
    return found


def of_others(table: Mapping[str, Mapping[str, float]], name: str, key: str) -> float:
    """The median of a number over the other runs; inf where none has it."""
    return median([own[key] for other, own in table.items() if other != name and key in own] or [math.inf])


def chatter(run: Recording) -> dict[str, float]:
    """Share of every motor's torque that is fast (`fast_share`), after the first fifth of a run."""
    torque, time = as_columns(run["motor_torque"])[len(run) // 5 :], run.time
    share = fast_share(torque, (time[-1] - time[0]) / (len(run) - 1))
    return dict(zip(run.labels("motor_torque"), share.tolist(), strict=True))


def fast_share(torque: Array, period: float) -> Array:
    """Share of the RMS of torques that is faster than `FAST`.

    A ring at 30 Hz changes a torque little from one sample to the next where samples are 1 ms apart, and shakes a motor
    all the same: so frequencies are looked at, of the torque under a Hann window.

    Args:
        torque: (k, motors).
        period: Between rows [s].
    """
    power = np.abs(np.fft.rfft(torque * np.hanning(len(torque))[:, None], axis=0)) ** 2
    power[1:] *= 2.0  # of negative frequencies, too
    quick = np.fft.rfftfreq(len(torque), period) > FAST
    return np.sqrt(power[quick].sum(axis=0) / np.maximum(power.sum(axis=0), 1e-24))


def shown(ratio: float) -> str:
    """A ratio in words."""
    return f"{ratio:.2g}" if ratio < 100 else "over 100"
