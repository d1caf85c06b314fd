"""The weights' part of the Lyapunov function along a run, `W~' Gamma^-1 W~ / 2` and its kin, and what changes it.

`W~ = W* - W` is the distance from ideal weights. With them `Psi - Psi_hat = Phi W~ + w`, and a law that follows s takes
`s' Phi W~` out of V again, whatever W* is: this is the *pull*. So along a run

    s' (Psi - Psi_hat) + d/dt (weights' part) = s' w + what else moves the weights

Every kind of weights has a part of its own and says what else moves them: `networks`, `linear`, `truth`. The learner is
stepped again over the recorded rows, which gives its weights at every sample; what a change of the part has beyond its
terms is `step`, so that all add up exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mmnn_pin.lab.psi.learner import Learner, LearnerStepper
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.signals import Array, IntArray

WITHOUT = "V is without the weights' part"
LOST = 1e-3  # relative difference of Psi_hat beyond which stepping again makes no sense
Progress = Callable[[float], None] | None


@dataclass(frozen=True, eq=False)
class WeightsPart:
    """The weights' part at (k,) rows, and what learning leaves of `s' (Psi - Psi_hat)` and of its derivative."""

    value: Array  # the part itself
    terms: dict[str, Array]  # name in `lyapunov.TERMS` to that term over the period that begins at the row [W]
    arrived: dict[str, Array]  # the same over the period that led to the row
    missed: float  # as `step_again` returns it; one beyond `LOST` ends the steps, and the rest is 0


def part_of(
    subject: Subject, at: IntArray, value: Array, pull: Array, terms: dict[str, Array], missed: float
) -> WeightsPart:
    """The part of a learner whose law takes the pull out of V: remainder and step from the rest.

    Args:
        subject: The run.
        at: (k,) rows, ascending.
        value: (k,) the part at these rows, before their update.
        pull: (k,) `s' Phi W~` of the weights that are learned [W].
        terms: Name to (k,): what the update of the row does to the part beyond taking the pull out [W].
        missed: As of `WeightsPart`.
    """
    error = (subject.s * (subject.signal("psi") - subject.signal("psi_hat"))).sum(axis=1)[at]
    rate = np.sum(list(terms.values()), axis=0) - pull
    step, follows = np.zeros(len(at)), np.flatnonzero(np.diff(at) == 1)
    step[follows + 1] = (value[follows + 1] - value[follows]) / subject.timing.control_period - rate[follows]
    return WeightsPart(value, {**terms, "remainder": error - pull}, {"step": step}, missed)


def step_again(
    learner: Learner,
    rows: Array,
    before: Callable[[int, Array, LearnerStepper], Any],
    after: Callable[[int, Array, LearnerStepper, Any], None],
    progress: Progress = None,
) -> float:
    """Step a learner over the rows of its run, from its start on, as long as it says what it said in the run.

    Args:
        learner: The learner.
        rows: (N, width) all rows of the run.
        before: Called before every step with the number of the row and the row; gives what is kept of the state.
        after: Called after every step with the same and what was kept.
        progress: Called now and then with the fraction done.

    Returns:
        Largest difference of its Psi_hat from the recorded one, relative to the largest of the run; inf where one is no
        number.
    """
    stepper = LearnerStepper(learner, learner.start.snapshot())
    recorded = rows[:, learner.context.layout.where("psi_hat")]
    missed, largest = np.zeros(()), float(np.abs(recorded).max()) or 1.0
    for n, row in enumerate(rows):
        kept = before(n, row, stepper)
        missed = np.maximum(missed, np.abs(stepper.step(row) - recorded[n]).max())
        if not missed <= LOST * largest:
            break
        after(n, row, stepper, kept)
        if progress is not None and n % 500 == 0:
            progress(n / len(rows))
    return float(missed if np.isfinite(missed) else np.inf) / largest
