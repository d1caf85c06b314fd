"""Rows of the table about the wheels on the contact plant: how fast, how long they slipped, how much grip they used."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.text import Text

from ...plant.contact.slip import SLIPPING
from ...recording.recording import Recording, as_columns
from ..experiments.runner import Result


def rows(result: Result) -> Iterator[list[str | Text]]:
    """Peak slip and traction use of every wheel, and the time of slipping; nothing on the ideal plant."""
    recording = next(iter(result.recordings.values()))
    if "slip" not in recording:
        return
    for signal, words, scale in (("slip", "slip [mm/s]", 1e3), ("traction", "traction use", 1.0)):
        for wheel in recording.labels(signal):
            peaks = (scale * numbers[f"{signal}.{wheel}.peak"] for numbers in result.metrics.values())
            yield [Text(f"{words} {wheel}"), "peak", *(f"{peak:.3g}  " for peak in peaks)]
    yield [Text("time slipping [s]"), "", *(f"{slipping(r):.3g}  " for r in result.recordings.values())]


def slipping(recording: Recording) -> float:
    """Time in which a wheel's contact point moved faster than it can creep [s]."""
    fast = as_columns(recording["slip"]) > SLIPPING
    return float(np.count_nonzero(fast.any(axis=1)) * recording.meta["control_period"])
