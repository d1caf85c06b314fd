"""Runs of draws, and the errors that they are judged by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .choices import Choice, with_choice
from .draws import Draw, loop
from .rollouts import Rollout, roll_out

KEPT = ("pose_error", "e", "effective_gain")
WINDOWS = {"whole": 0.0, "tracking": 1.0}  # from when on an error counts [s]
PARTS = ("base", "arm")
Wanted = tuple[Draw, str, str, Choice | None]  # a draw, its motion, a controller, what was chosen of it


def run_all(wanted: Sequence[Wanted], finer: int = 1) -> list[Rollout]:
    """Runs of `pd` or a learner, so many plant steps per control sample."""
    loops = []
    for d, reference, name, chosen in wanted:
        experiment = with_choice(d.experiment(finer), name, chosen)
        loops.append(loop(experiment, d.robot, reference, experiment.controller(name)))
    return roll_out(loops, KEPT)


def error(run: Rollout, part: str, start: float, period: float) -> float:
    """RMS distance of base [m] or arm [rad] from the reference, from a time on; inf for a run that was lost."""
    if not run.completed:
        return float("inf")
    table = run.signals["pose_error"][:, :2] if part == "base" else run.signals["e"]
    return float(np.sqrt(np.mean(np.sum(table[round(start / period) :] ** 2, axis=1))))


def errors(run: Rollout, period: float) -> dict[str, float]:
    """All errors of a run."""
    return {f"{part}.{name}": error(run, part, start, period) for part in PARTS for name, start in WINDOWS.items()}
