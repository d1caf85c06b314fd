"""What one axes shows: a column of a signal, of all recordings that have it, in the unit that people read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...recording.metrics import TRUE
from ...recording.recording import Recording
from ...signals import Array
from .units import column_units, milli


@dataclass(frozen=True)
class Panel:
    """What one axes shows: a column of a signal, scaled from SI."""

    signal: str
    label: str
    title: str
    unit: str
    scale: float

    def values(self, recording: Recording, rows: slice = slice(None)) -> Array:
        """The column in the panel's unit, shape (rows,); empty where the recording does not have it."""
        if not len(recording) or self.signal not in recording or self.label not in recording.labels(self.signal):
            return np.empty(0)
        table = recording[self.signal].reshape(len(recording), -1)
        return self.scale * table[rows, recording.labels(self.signal).index(self.label)]


def panels_of(recordings: Mapping[str, Recording], signal: str) -> list[Panel]:
    """Panels of a signal's columns, of all that any recording has, in their order; errors in thousandths."""
    panels: dict[str, Panel] = {}
    for recording in recordings.values():
        if signal not in recording:
            continue
        for label, unit in zip(recording.labels(signal), column_units(recording, signal), strict=True):
            error = signal.removeprefix("true_")
            title = "heading" if (error, label) == ("pose_error", "phi") else label
            scaled = (milli(unit), 1e3) if error in TRUE else (unit, 1.0)
            panels.setdefault(label, Panel(signal, label, title, *scaled))
    return list(panels.values())


def error_panels(recordings: Mapping[str, Recording], error: str) -> list[Panel]:
    """Panels of a tracking error: the true one, by which runs are judged, where all recordings have it."""
    known = all(TRUE[error] in recording for recording in recordings.values() if error in recording)
    return panels_of(recordings, TRUE[error] if known else error)


def base_labels(recording: Recording) -> tuple[str, ...]:
    """Names of the base velocities; none for a fixed arm."""
    return recording.labels("velocity") if "velocity" in recording else ()
