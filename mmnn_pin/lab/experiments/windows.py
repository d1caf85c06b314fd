"""Windows for the errors that a run does not reach: what to tell a user who shortened the run and not the windows."""

from __future__ import annotations

from collections.abc import Sequence

from .experiment import Experiment

Window = tuple[float, float]


def window_notes(experiment: Experiment) -> list[str]:
    """What to know of windows that lie beyond the end of a run or go on after it; nothing where all are within."""
    end = experiment.time.duration
    beyond = [window for window in experiment.windows if window[0] >= end]
    cut = [window for window in experiment.windows if window[0] < end < window[1]]
    found = []
    if beyond:
        found.append(f"no errors in {words(beyond)}: the run is over after {end:g} s; --set windows=... for others")
    if cut:
        found.append(f"errors in {words(cut)} count to the end of the run, {end:g} s")
    return found


def words(windows: Sequence[Window]) -> str:
    """Windows in words."""
    return "the window" + "s" * (len(windows) > 1) + " " + ", ".join(f"{start:g}-{stop:g} s" for start, stop in windows)
