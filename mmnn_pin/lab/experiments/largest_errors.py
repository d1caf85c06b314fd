"""The four numbers that chapter 5 prints: the largest errors of both joints, one-layer and two-layer, beside runs.

The thesis's numbers are what its encoders saw; compared with them are the measured errors `e` of a run, not the true
ones, which no rig knows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...recording.recording import Recording, as_columns

# Section 5.2, (joint 1, joint 2) [deg].
THESIS = {"one_layer": (1.7789, 1.7463), "two_layer": (1.6394, 1.6091)}


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
    return tuple(two / one for two, one in zip(THESIS["two_layer"], THESIS["one_layer"], strict=True))


def beside_the_thesis(recordings: Mapping[str, Recording]) -> dict[str, Any]:
    """Measured and true largest errors [deg], their ratios to one_layer, and the thesis's, for JSON."""
    measured = largest_errors(recordings)
    return {
        "largest_errors_deg": measured,
        "true_largest_errors_deg": largest_errors(recordings, "true_e"),
        "thesis_largest_errors_deg": {name: list(values) for name, values in THESIS.items()},
        "largest_error_ratios": ratios(measured),
        "thesis_largest_error_ratios": list(thesis_ratios()),
    }
