"""Metrics of a run: peak and RMS of every error, torque effort, learned share, effective gain.

A `Reducer` takes rows as they come, so that a run in a batch needs no memory for its signals; `metrics` puts a whole
recording through the same reducer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..compiled import compiled
from ..signals import Array, IntArray, Layout
from .recording import Recording, as_columns

ERRORS = ("pose_error", "z", "e")
CONTACT = ("slip", "traction", "constraint_residual")  # of the contact plant
# Judged by what the robot does, not by what its sensors say; recordings without these signals had exact sensors.
TRUE = {"pose_error": "true_pose_error", "z": "true_z", "e": "true_e"}
TORQUES = ("motor_torque", "torque", "psi_hat", "effective_gain")  # no run is judged without them
TRACKED = (*ERRORS, *TORQUES, "energy_residual", *CONTACT)
Windows = Sequence[tuple[float, float]]


class Reducer:
    """Sums over the samples of one run; a sink for `Loop.stream`.

    Args:
        labels: Labels of the columns of every tracked signal that the robot has.
        windows: Intervals [a, b) for the RMS errors [s].
        control_period: Time between two samples [s].
        columns: Places of the tracked columns in a row.
    """

    def __init__(
        self, labels: Mapping[str, Sequence[str]], windows: Windows, control_period: float, columns: IntArray
    ) -> None:
        self.labels, self.windows, self.h, self.columns = labels, windows, control_period, columns
        size = columns.size
        self.bounds = np.array(windows, float).reshape(len(windows), 2)
        self.count, self.inside = 0, np.zeros(len(windows))
        self.peak, self.total, self.squares = np.zeros(size), np.zeros(size), np.zeros(size)
        self.window_squares = np.zeros((len(windows), size))

    @classmethod
    def of(cls, layout: Layout, facts: Mapping[str, Any], windows: Windows) -> Reducer:
        """Reducer for the rows of a robot; facts as in `Loop.facts`."""
        velocities, nb = tuple(facts["velocity_names"]), layout.base
        labels = {
            "pose_error": ("x", "y", "phi")[: layout.pose],
            "z": velocities[:nb],
            "e": velocities[nb:],
            "motor_torque": tuple(facts["actuator_names"]),
            **dict.fromkeys(("torque", "psi_hat", "effective_gain"), velocities),
            "energy_residual": ("energy_residual",),
        }
        wheels = tuple(facts.get("wheel_names", facts["actuator_names"]))[: layout.wheels]
        labels |= {"slip": wheels, "traction": wheels, "constraint_residual": ("constraint_residual",) * bool(wheels)}
        labels = {name: names for name, names in labels.items() if names}
        places = [np.arange(layout.width)[layout.where(TRUE.get(name, name))] for name in labels]
        return cls(labels, windows, facts["control_period"], np.concatenate(places))

    def append_block(self, rows: Array, step_times: ArrayLike = 0.0) -> None:
        """Take rows (k, width); the first column is the time."""
        self.count += len(rows)
        accumulate(
            rows, self.columns, self.bounds, self.peak, self.total, self.squares, self.inside, self.window_squares
        )

    def weights(self, time: float, arrays: Mapping[str, ArrayLike]) -> None:
        """Weights are not reduced."""

    def result(self) -> dict[str, float]:
        """Flat table of numbers in SI units, keyed `signal.label.statistic`.

        Statistics: `peak` (largest magnitude), `rms_a_b` over each window [a, b) that the run reached (nan otherwise);
        `effort` is the time integral of the squared motor torques [N²m²s]; `learned_share` the RMS of Psi_hat over
        the RMS of the applied torque (base and arm apart), `effective_gain` its mean; where energy was recorded the
        peak of `energy_residual`. On the contact plant also the peaks of slip [m/s], traction use and constraint
        residual [m/s].
        """
        ends = np.cumsum([0, *(len(names) for names in self.labels.values())])
        where = {name: np.arange(ends[i], ends[i + 1]) for i, name in enumerate(self.labels)}
        nb, numbers = len(self.labels.get("z", ())), {}
        for name in ERRORS:
            for i, label in zip(where.get(name, ()), self.labels.get(name, ()), strict=True):
                numbers[f"{name}.{label}.peak"] = float(self.peak[i]) if self.count else np.nan
                for w, (start, end) in enumerate(self.windows):
                    squares = self.window_squares[w, i] / self.inside[w] if self.inside[w] else np.nan
                    numbers[f"{name}.{label}.rms_{start:g}_{end:g}"] = float(np.sqrt(squares))
        numbers["effort"] = float(self.squares[where["motor_torque"]].sum() * self.h)
        for part, half in (("base", slice(0, nb)), ("arm", slice(nb, None))):
            if not len(where["torque"][half]):
                continue
            torque, learned = (self.squares[where[name][half]].sum() for name in ("torque", "psi_hat"))
            numbers[f"learned_share.{part}"] = float(np.sqrt(learned / torque)) if torque > 0 else 0.0
            gain = self.total[where["effective_gain"][half]]
            numbers[f"effective_gain.{part}"] = float(gain.mean() / self.count) if self.count else np.nan
        for name in ("energy_residual", "slip", "traction", "constraint_residual"):
            for i, label in zip(where.get(name, ()), self.labels.get(name, ()), strict=True):
                numbers[name if label == name else f"{name}.{label}.peak"] = float(self.peak[i])
        return numbers


@compiled
def accumulate(
    rows: Array,
    columns: IntArray,
    windows: Array,
    peak: Array,
    total: Array,
    squares: Array,
    inside: Array,
    window_squares: Array,
) -> None:
    """Take rows into the sums, one after the other, so that blocks of any size give the same bits.

    Args:
        rows: (k, width), the first column is the time.
        columns: (c,) places of what is summed.
        windows: (w, 2) intervals [a, b).
        peak: (c,) largest magnitudes.
        total: (c,) sums.
        squares: (c,) sums of squares.
        inside: (w,) samples in each window.
        window_squares: (w, c) sums of squares in each window.
    """
    for k in range(rows.shape[0]):
        for i in range(columns.size):
            value = rows[k, columns[i]]
            peak[i] = max(peak[i], abs(value))
            total[i] += value
            squares[i] += value * value
        for w in range(windows.shape[0]):
            if windows[w, 0] <= rows[k, 0] < windows[w, 1]:
                inside[w] += 1.0
                for i in range(columns.size):
                    window_squares[w, i] += rows[k, columns[i]] * rows[k, columns[i]]


def metrics(recording: Recording, windows: Windows) -> dict[str, float]:
    """Numbers of a recording; see `Reducer.result`.

    Raises:
        RecordingError: It is damaged.
        UnknownName: It has no torques.
    """
    recording.require_whole()
    labels = {name: recording.labels(name) for name in TRACKED if name in recording or name in TORQUES}
    rows = np.hstack([as_columns(recording[judged(recording, name)]) for name in ("time", *labels)])
    reducer = Reducer(labels, windows, recording.fact("control_period", float), np.arange(1, rows.shape[1]))
    reducer.append_block(rows)
    return reducer.result()


def judged(recording: Recording, name: str) -> str:
    """The signal that a metric of this name is taken from."""
    return TRUE[name] if TRUE.get(name) in recording else name


def halves(recording: Recording) -> dict[str, slice]:
    """Columns of the base and of the arm in signals of all p velocities."""
    base, total = len(recording.labels("z")) if "z" in recording else 0, len(recording.labels("torque"))
    parts = {"base": slice(0, base), "arm": slice(base, total)}
    return {name: part for name, part in parts.items() if part.stop > part.start}
