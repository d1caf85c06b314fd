"""A linear learner stepped again over its run, with its features at every row and its memory before and after."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...signals import Array
from ...torque.controller import ControllerState
from ...torque.learning_law import LearningLaw
from .learner import Learner, Stepper
from .weights_part import Missed


@dataclass(frozen=True, eq=False)
class Row:
    """One sample of a learner.

    Attributes:
        number: Which.
        values: (width,) the recorded row.
        s: (p,) the error that it was told.
        Phi: (rows, k) features at it, with the memory before.
        before: What was kept of the memory before.
        state: The memory after.
    """

    number: int
    values: Array
    s: Array
    Phi: Array
    before: dict[str, Array]
    state: ControllerState


def together(
    learner: Learner,
    rows: Array,
    keep: Callable[[ControllerState], dict[str, Array]],
    visit: Callable[[Row], None],
    progress: Callable[[float], None] | None = None,
) -> float:
    """Step a learner over the rows (N, width) of its run.

    Args:
        learner: The learner; one that tells its features.
        rows: All rows of the run.
        keep: What is kept of its memory before each, copies by name.
        visit: Called with every row.
        progress: Called now and then with the fraction done.

    Returns:
        How far it was from the recorded Psi_hat, as of `Missed.share`.
    """
    stepper = Stepper(learner, learner.start.snapshot())
    still = Stepper(learner, learner.start.snapshot(), learning=False)
    where, own = learner.context.layout.where, isinstance(learner.controller, LearningLaw)
    missed = Missed(rows[:, where("psi_hat")])
    for n, row in enumerate(rows):
        if own:  # features of a user's law may be learned
            still.state.values[:] = stepper.state.values
        still.step(row)
        Phi = still.features()
        assert Phi is not None
        before = keep(stepper.state)
        if missed.lost(n, stepper.step(row)):
            break
        s = np.concatenate((row[where("z")], row[where("r")]))
        visit(Row(n, row, s, Phi, before, stepper.state))
        if progress is not None and n % 500 == 0:
            progress(n / len(rows))
    return missed.share


def copies(state: ControllerState, *parts: str) -> dict[str, Array]:
    """Parts of a memory, by name."""
    return {name: state[name].copy() for name in parts}
