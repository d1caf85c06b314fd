"""What figures show of motors and supervisor: the torque that arrived beside the commanded one, and stops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...recording.recording import Recording, as_columns
from ...safety import STOPPING
from .figure import Look, Style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GIVEN: Look = {"linewidth": 0.8, "alpha": 0.65}
STOP: Look = {"color": "#d62728", "alpha": 0.12}


def gives_other(recording: Recording) -> bool:
    """Whether motors gave something else than what was commanded."""
    return "applied" in recording and not np.array_equal(recording["applied"], recording["motor_torque"])


def looks_of_given(recordings: Mapping[str, Recording]) -> list[tuple[str, Look]]:
    """Entry of a legend for what motors gave, where that is something else."""
    return [("given by the motors", {"color": "0.3", **GIVEN})] if any(map(gives_other, recordings.values())) else []


def draw_given(axes: Axes, label: str, recordings: Mapping[str, Recording], styles: Mapping[str, Style]) -> None:
    """Torque that a motor gave, thin, in the colour of its run."""
    for name, recording in recordings.items():
        if gives_other(recording) and label in (labels := recording.labels("applied")):
            given = as_columns(recording["applied"])[:, labels.index(label)]
            axes.plot(recording.time, given, color=styles[name].color, drawstyle="steps-post", zorder=2.5, **GIVEN)


def shade_stops(every: Sequence[Axes], recordings: Mapping[str, Recording]) -> list[tuple[str, Look]]:
    """Shade the time in which a supervisor stops a run; the entry of a legend for that, if there is any."""
    stops = [
        recording.time[recording["safety"] >= STOPPING] for recording in recordings.values() if "safety" in recording
    ]
    for times in filter(len, stops):
        for axes in every:
            axes.axvspan(times[0], times[-1], linewidth=0, zorder=0, **STOP)
    return [("stopped by the supervisor", {"linewidth": 7, **STOP})] if any(map(len, stops)) else []
