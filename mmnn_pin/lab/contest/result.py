"""One run of the contest as numbers: errors, torques, FVU, what it did on the held-out trajectories."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from statistics import median
from typing import Any

import msgspec
import numpy as np

from ...recording.recording import Recording, as_columns
from ...signals import Array
from ..proof.held_out import START
from ..proof.psi import fvu

ERRORS = ("true_pose_error", "true_e")
KEPT = (*ERRORS, "psi", "psi_hat", "motor_torque")  # of a training run
Number = float | None


class Tracking(msgspec.Struct, frozen=True):
    """How a held-out trajectory was followed.

    Attributes:
        outcome: How the run ended.
        rms: RMS error per axis after the first 0.5 s, None for a run that was lost [m, rad].
    """

    outcome: str
    rms: dict[str, Number]


class TrialResult(msgspec.Struct, frozen=True, kw_only=True):
    """One run: a task, a controller, a seed. Errors are the true ones, by axis `x`, `y`, `phi` and joint.

    Attributes:
        task: Which task.
        controller: Which controller.
        seed: Which seed.
        outcome: How the training ended.
        ended: When [s].
        rms: RMS errors in the last window of the training, per axis [m, rad].
        peak: Largest errors there.
        peak_of_all: Largest errors of the whole training, the start included.
        effort: Time integral of the squared motor torques [N^2 m^2 s].
        torque: Largest torque asked of a motor over its limit.
        kick: The same in the first moments.
        online_fvu: FVU in the last window, mean over the components.
        online_worst: Of the worst component.
        frozen_fvu: With the final weights held fixed, mean over the components, on the worst held-out trajectory; None
            for weights that cannot be held fixed.
        frozen_worst: Of the worst component there.
        frozen_on: Per held-out trajectory, mean over the components.
        held_out: Held-out trajectory to "frozen" and "learning" to how it was followed.
        findings: What the controller's state showed at the end.
        since: When the last change of the task happened [s].
        curve: Mean squared error per window and axis.
    """

    task: str
    controller: str
    seed: int
    outcome: str
    ended: float
    rms: dict[str, Number]
    peak: dict[str, Number]
    peak_of_all: dict[str, Number]
    effort: Number
    torque: Number
    kick: Number
    online_fvu: Number
    online_worst: Number
    frozen_fvu: Number
    frozen_worst: Number
    frozen_on: dict[str, Number]
    held_out: dict[str, dict[str, Tracking]]
    findings: tuple[str, ...]
    since: float
    curve: list[list[float]]

    @property
    def completed(self) -> bool:
        """Whether the training reached its end."""
        return self.outcome == "completed"


class Trial(msgspec.Struct, frozen=True, rename={"results": "rows"}):
    """All results of one controller on one task; in files `results` is called `rows`.

    Attributes:
        fingerprint: Of all that decides them.
        step_time: Processor time of the controller's step [s]; None where it was not measured.
        results: One per seed.
    """

    fingerprint: str
    step_time: float | None
    results: list[TrialResult]


def base_of(numbers: dict[str, Number]) -> float:
    """Error of the base's position out of errors per axis [m]; nan without a base."""
    return math.hypot(*(nan(numbers.get(axis)) for axis in ("x", "y")))


def arm_of(numbers: dict[str, Number]) -> float:
    """Root of the mean squared error of the joints out of errors per axis [rad or m]; nan without an arm."""
    joints = [nan(value) for axis, value in numbers.items() if axis not in ("x", "y", "phi")]
    return math.sqrt(sum(value**2 for value in joints) / len(joints)) if joints else math.nan


def nan(value: Number) -> float:
    """A number that may be missing."""
    return math.nan if value is None else value


def middle(values: Sequence[float]) -> float:
    """Median; nan where a value is missing or there is none."""
    return math.nan if not values or any(map(math.isnan, values)) else median(values)


def known(value: float) -> Number:
    """A number for JSON: None where there is none."""
    return float(value) if math.isfinite(value) else None


def errors_of(recording: Recording) -> tuple[tuple[str, ...], Array]:
    """Axes and their true errors (N, axes) [m, rad]."""
    names = [name for name in ERRORS if name in recording]
    labels = tuple(label for name in names for label in recording.labels(name))
    return labels, np.hstack([as_columns(recording[name]) for name in names])


def rms_of(axes: tuple[str, ...], errors: Array) -> dict[str, Number]:
    """RMS per axis; None without samples."""
    values = np.sqrt((errors**2).mean(axis=0)) if len(errors) else np.full(len(axes), np.nan)
    return {axis: known(value) for axis, value in zip(axes, values, strict=True)}


def peak_of(axes: tuple[str, ...], errors: Array) -> dict[str, Number]:
    """Largest magnitude per axis; None without samples."""
    values = np.abs(errors).max(axis=0) if len(errors) else np.full(len(axes), np.nan)
    return {axis: known(value) for axis, value in zip(axes, values, strict=True)}


def tracking(recording: Recording | None, status: str) -> Tracking:
    """How a held-out trajectory was followed."""
    if recording is None or not len(recording):
        return Tracking(status, {})
    axes, errors = errors_of(recording)
    if status != "completed":
        return Tracking(status, dict.fromkeys(axes))
    return Tracking(status, rms_of(axes, errors[recording.time >= START - 1e-9]))


def training_numbers(
    recording: Recording, limits: Array, window: tuple[float, float], bins: float, start: float
) -> dict[str, Any]:
    """What a result says of its training run.

    Args:
        recording: The run.
        limits: (motors,) effort limits [N m or N].
        window: The last window, in which the errors count [s].
        bins: Length of the windows of the curve [s].
        start: Length of the start in which a kick is looked for [s].
    """
    time, (axes, errors) = recording.time, errors_of(recording)
    period = float(recording.meta["control_period"])
    late = (time >= window[0] - 1e-9) & (time < window[1] - 1e-9)
    late &= recording.outcome.status == "completed"
    motors = as_columns(recording["motor_torque"])
    share = (np.abs(motors) / limits).max(axis=1)
    psi, psi_hat = as_columns(recording["psi"])[late], as_columns(recording["psi_hat"])[late]
    mean, worst = summary(fvu(psi, psi_hat))
    per = max(1, round(bins / period))
    full = len(errors) // per
    squares = (errors[: full * per] ** 2).reshape(full, per, len(axes)).mean(axis=1)
    return {
        "rms": rms_of(axes, errors[late]),
        "peak": peak_of(axes, errors[late]),
        "peak_of_all": peak_of(axes, errors),
        "effort": known(float((motors**2).sum() * period)),
        "torque": known(share.max(initial=0.0)),
        "kick": known(share[time < start - 1e-9].max(initial=0.0)),
        "online_fvu": known(mean),
        "online_worst": known(worst),
        "curve": squares[np.isfinite(squares).all(axis=1)].tolist(),
    }


def summary(values: Array) -> tuple[float, float]:
    """Mean and worst of the components that have an FVU; nan where none has."""
    finite = values[np.isfinite(values)]
    return (float(finite.mean()), float(finite.max())) if len(finite) else (math.nan, math.nan)


def as_csv(results: Sequence[TrialResult]) -> str:
    """Results as a table, one line per run, a column per number; empty where there is none."""
    tables = [flat(result) for result in results]
    columns = list(dict.fromkeys(name for table in tables for name in table))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(tables)
    return text.getvalue()


def flat(result: TrialResult) -> dict[str, Any]:
    """A result without its curve, one number per key."""
    table: dict[str, Any] = {}
    for name, value in as_json(result).items():
        spread(table, name, value)
    return table


def spread(table: dict[str, Any], name: str, value: Any) -> None:
    """Put a value into a flat table, what is inside it under `name.inner`."""
    if isinstance(value, dict):
        for inner, one in value.items():
            spread(table, f"{name}.{inner}", one)
    else:
        table[name] = "; ".join(value) if isinstance(value, list | tuple) else value


def as_json(result: TrialResult) -> dict[str, Any]:
    """A result for JSON: without its curve, with the errors of base, heading and arm."""
    table: dict[str, Any] = {k: v for k, v in msgspec.to_builtins(result).items() if k != "curve"}
    for word in ("rms", "peak"):
        numbers = getattr(result, word)
        table[f"{word}_base"], table[f"{word}_arm"] = known(base_of(numbers)), known(arm_of(numbers))
        table[f"{word}_heading"] = numbers.get("phi")
    return table
