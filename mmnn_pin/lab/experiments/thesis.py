"""The thesis's figures and numbers beside our runs.

Its figures survive as intervals read off their axes, twelve a chapter; chapter 5 also prints the largest errors of both
joints, one-layer and two-layer. Those are what its encoders saw, so they are compared with the measured errors `e` of a
run, not with the true ones, which no hardware knows.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ...recording.recording import Recording, as_columns
from ...signals import Array

FILE = Path(__file__).with_name("figure_ranges.csv")
# Section 5.2, (joint 1, joint 2) [deg].
PRINTED = {"one_layer": (1.7789, 1.7463), "two_layer": (1.6394, 1.6091)}


class Signals(Protocol):
    """A run's signals by name, each (samples, size): a `Recording` or a dict of arrays."""

    def __getitem__(self, name: str, /) -> Array: ...
    def __contains__(self, name: object, /) -> bool: ...


@dataclass(frozen=True)
class FigureRange:
    """Interval in which an extreme of a figure's curves lies."""

    figure: str  # figure of the thesis and which of its two plots
    curve: str  # what it shows
    statistic: str  # `max` or `min` of these curves over the run
    lower: float  # lower end of the last tick interval, in `unit`
    upper: float  # upper end
    unit: str  # unit
    signal: str  # signal of a recording
    column: int | None  # its column, from 0; None for all
    controllers: tuple[str, ...]  # controllers whose curves share the plot

    @property
    def scale(self) -> float:
        """Factor from SI to `unit`."""
        return 180.0 / math.pi if self.unit == "deg" else 1.0

    def extreme(self, runs: Mapping[str, Signals]) -> float | None:
        """The statistic over the plot's curves, in `unit`; None if a controller or the signal's column is missing."""
        found = []
        for controller in self.controllers:
            run = runs.get(controller)
            if run is None or self.signal not in run or not len(run[self.signal]):
                return None
            table = run[self.signal].reshape(len(run[self.signal]), -1)
            if self.column is not None and self.column >= table.shape[1]:
                return None
            found.append(table if self.column is None else table[:, self.column])
        return self.scale * float(
            getattr(np, self.statistic)([getattr(np, self.statistic)(values) for values in found])
        )


@cache
def figure_intervals(chapter: int = 4) -> tuple[FigureRange, ...]:
    """The twelve intervals of a chapter, in the order of its figures."""
    lines = [line for line in FILE.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return tuple(interval(row) for row in csv.DictReader(lines) if row["figure"].startswith(f"{chapter}."))


def interval(row: dict[str, str]) -> FigureRange:
    """Interval from a row of the file."""
    return FigureRange(
        **{name: row[name] for name in ("figure", "curve", "statistic", "unit", "signal")},
        lower=float(row["lower"]),
        upper=float(row["upper"]),
        column=None if row["column"] == "all" else int(row["column"]),
        controllers=tuple(row["controllers"].split()),
    )


def figure_ranges(runs: Mapping[str, Signals]) -> list[dict[str, Any]]:
    """The figures' intervals beside what runs give, for the intervals that these runs can be compared with.

    Args:
        runs: Controller to its recording, or to a dict of arrays `pose_error` (N, 3) [m, m, rad], `z` (N, 2)
            [m/s, rad/s], `e` and `q` (N, 2) [rad]; `one_layer` counts, with `two_layer` for chapter 4 and with
            `two_layer_zero` for chapter 5.

    Returns:
        Per interval `figure, curve, statistic, value, lower, upper, unit, inside`. The value of a run that is not
        finite is None, and not inside.
    """
    rows = []
    for known in (*figure_intervals(4), *figure_intervals(5)):
        value = known.extreme(runs)
        if value is not None:
            about = {name: text for name, text in asdict(known).items() if name in ("figure", "curve", "statistic")}
            about["value"] = value if np.isfinite(value) else None
            limits = {"lower": known.lower, "upper": known.upper, "unit": known.unit}
            rows.append(about | limits | {"inside": bool(known.lower <= value <= known.upper)})
    return rows


def largest_errors(recordings: Mapping[str, Recording], signal: str = "e") -> dict[str, list[float]]:
    """Largest magnitude of every joint's error [deg] by controller; of a run that reached its end.

    Args:
        recordings: Controller to recording.
        signal: "e" as measured, or "true_e".
    """
    return {
        name: np.degrees(np.abs(as_columns(recording[signal])).max(axis=0)).tolist()
        for name, recording in recordings.items()
        if recording.outcome.status == "completed" and signal in recording
    }


def ratios(errors: Mapping[str, list[float]]) -> dict[str, list[float]]:
    """Largest errors of every controller but the one-layer one divided by its; empty without it, or where it is 0."""
    one = errors.get("one_layer", [])
    if not one or not min(one) > 0:
        return {}
    return {
        name: [value / base for value, base in zip(found, one, strict=True)]
        for name, found in errors.items()
        if name != "one_layer"
    }


def mean_ratio(joints: list[float] | tuple[float, ...]) -> float:
    """Geometric mean of the joints' ratios."""
    return math.exp(math.fsum(map(math.log, joints)) / len(joints)) if min(joints) > 0 else 0.0


def thesis_ratios() -> tuple[float, ...]:
    """Two-layer to one-layer of the thesis, (joint 1, joint 2)."""
    return tuple(two / one for two, one in zip(PRINTED["two_layer"], PRINTED["one_layer"], strict=True))


def beside_the_thesis(recordings: Mapping[str, Recording]) -> dict[str, Any]:
    """Measured and true largest errors [deg], their ratios to one_layer, and the thesis's, for JSON."""
    measured = largest_errors(recordings)
    return {
        "largest_errors_deg": measured,
        "true_largest_errors_deg": largest_errors(recordings, "true_e"),
        "thesis_largest_errors_deg": {name: list(values) for name, values in PRINTED.items()},
        "largest_error_ratios": ratios(measured),
        "thesis_largest_error_ratios": list(thesis_ratios()),
    }
