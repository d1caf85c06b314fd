"""Whether a learner is worse than plain control: the feedback and the gravity of the URDF, nothing learned.

A learner is no gain, however it ranks among others, if it errs more than plain control, shakes the motors, or spends
many times the effort of a plain control that is not lost: one that is lost spends less than the motion takes. The
errors are of the base's place, of its heading, and of the arm, each by its RMS after the first fifth of a run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ...recording.metrics import metrics
from ...recording.recording import Recording, as_columns
from ...torque.entries import CONTROLLERS
from .outliers import FAR, fast_share, worst_loss

YARDSTICKS = ("pd_gravity", "pd")  # plain controls, the first that ran counts
SKIPPED = 0.2  # of a run, at its start
TWICE = 2.0  # times the error of plain control in one part that count, whatever the others are
SAME = 1.02  # times it on average, up to which errors are alike
LEAST = 1e-4  # error that counts [m, rad]
SPENT = 10.0  # times its effort
SHAKEN = 0.5  # share of the RMS of a motor's torque that is fast, from which the motor is shaken
PARTS = {
    "the base's place": ("pose_error", slice(0, 2)),
    "its heading": ("pose_error", slice(2, 3)),
    "the arm": ("e", slice(None)),
}


def learners(names: Mapping[str, Recording]) -> list[str]:
    """The runs of controllers that are neither plain nor oracles: those of learners, and of a user's own."""
    return [
        name
        for name in names
        if not (entry := CONTROLLERS.get(name)) or not (entry.baseline or entry.oracle or entry.gain_of)
    ]


def yardstick(recordings: Mapping[str, Recording], beside: Recording | None = None) -> tuple[str, Recording] | None:
    """Name and run of the plain control that learners are measured by; None without one that reached its end."""
    runs = {YARDSTICKS[0]: beside} if beside is not None else recordings
    for name in YARDSTICKS:
        if name in runs and runs[name].outcome.status == "completed" and len(runs[name]) > 1:
            return name, runs[name]
    return None


def worse_than_plain(recordings: Mapping[str, Recording], beside: Recording | None = None) -> dict[str, str]:
    """Learner to why its run is worse than plain control, for those whose completed run is.

    Args:
        recordings: The runs by name.
        beside: The run of plain control where none of these is one.
    """
    found = yardstick(recordings, beside)
    if found is None:
        return {}
    name, plain = found
    told = {}
    for learner in learners(recordings):
        run = recordings[learner]
        if run.outcome.status == "completed" and len(run) > 1 and (reasons := compared(run, plain)):
            told[learner] = f"{learner} is worse than plain control ({name}): {'; '.join(reasons)}"
    return told


def compared(run: Recording, plain: Recording) -> list[str]:
    """In what a run is worse than another."""
    reasons, ratios = [], {}
    ours, theirs = errors_of(run), errors_of(plain)
    for part, error in ours.items():
        ratios[part] = max(error, LEAST) / max(theirs[part], LEAST)
    worst = max(ratios, key=lambda part: ratios[part], default="")
    average = math.exp(math.fsum(map(math.log, ratios.values())) / len(ratios)) if ratios else 1.0
    if ratios and (ratios[worst] > TWICE or average > SAME):
        reasons.append(
            f"{worst} errs {times(ratios[worst])} as much ({ours[worst]:.2g} for {theirs[worst]:.2g} m or rad)"
        )
    effort, usual = (float(np.sum(as_columns(one["motor_torque"]) ** 2) / len(one)) for one in (run, plain))
    if effort > SPENT * usual and not worst_loss(plain, metrics(plain, ())):
        reasons.append(f"its effort is {times(effort / max(usual, 1e-12))} as large")
    motors = run.labels("motor_torque")
    shaken, calm = shaking(run), shaking(plain)
    least = np.maximum(np.maximum(calm[0], 1e-3 * shaken[1]), 1e-12)
    far = np.where((shaken[0] > SHAKEN * shaken[1]), shaken[0] / least, 0.0)
    if far.size and far.max() > FAR:
        reasons.append(f"it shakes {motors[int(far.argmax())]}, {times(float(far.max()))} as much")
    return reasons


def errors_of(run: Recording) -> dict[str, float]:
    """RMS error of every part of a run after its start."""
    found = {}
    for part, (signal, columns) in PARTS.items():
        if signal in run and (values := as_columns(run[signal])[int(SKIPPED * len(run)) :, columns]).size:
            found[part] = float(np.sqrt(np.mean(np.sum(values * values, axis=1))))
    return found


def shaking(run: Recording) -> tuple[np.ndarray, np.ndarray]:
    """RMS of every motor's torque that is fast (`outliers.fast_share`), and of all of it, (motors,) each."""
    torque, time = as_columns(run["motor_torque"])[int(SKIPPED * len(run)) :], run.time
    rms = np.sqrt(np.mean(torque * torque, axis=0))
    return rms * fast_share(torque, (time[-1] - time[0]) / (len(run) - 1)), rms


def times(ratio: float) -> str:
    """A factor in words."""
    if ratio < 100:
        return f"{ratio:.{2 + (0.95 < ratio < 1.95)}g} times"
    return f"{round(ratio, -math.floor(math.log10(ratio)) + 1):,.0f} times"
