"""The weights' part of the Lyapunov function along a run, `W~' Gamma^-1 W~ / 2` and its kin, and what changes it.

`W~ = W* - W` is the distance from ideal weights. With them `Psi - Psi_hat = Phi W~ + w`, and a law that follows s takes
`s' Phi W~` out of V again, whatever W* is: this is the *pull*. So along a run

    s' (Psi - Psi_hat) + d/dt (weights' part) = s' w + what else moves the weights

Every kind of learner has a part of its own and says what else moves its weights: `parts` has the list. The learner is
stepped again over the recorded rows, which gives its weights at every sample; what a change of the part has beyond its
terms is `step`, so that all add up exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...signals import Array, IntArray
from ...torque.controller import ControllerState
from ...torque.learning_law import LearningLaw
from .learner import Learner, Stepper
from .subject import Subject

WITHOUT = "V is without the weights' part"
LOST = 1e-3  # relative difference of Psi_hat beyond which stepping again makes no sense


@dataclass(frozen=True, eq=False)
class WeightsPart:
    """The weights' part at (k,) rows, and what learning leaves of `s' (Psi - Psi_hat)` and of its derivative.

    Attributes:
        value: The part itself.
        terms: Name in `lyapunov.TERMS` to that term over the period that begins at the row [W].
        arrived: The same over the period that led to the row.
        missed: As of `Missed.share`; one beyond `LOST` ends the steps, and the rest is 0.
    """

    value: Array
    terms: dict[str, Array]
    arrived: dict[str, Array]
    missed: float


class Missed:
    """How far a learner that is stepped again is from what it said in its run.

    Args:
        recorded: (N, p) Psi_hat of the run.
    """

    def __init__(self, recorded: Array) -> None:
        self._recorded, self._most = recorded, 0.0
        self._largest = float(np.abs(recorded).max()) or 1.0

    def lost(self, n: int, psi_hat: Array) -> bool:
        """Whether its weights, that say psi_hat (p,) at row n, are no longer those of the run."""
        self._most = float(np.maximum(self._most, np.abs(psi_hat - self._recorded[n]).max()))
        return not self._most <= LOST * self._largest

    @property
    def share(self) -> float:
        """Largest difference so far, relative to the largest Psi_hat of the run; inf where one is no number."""
        return (self._most if np.isfinite(self._most) else np.inf) / self._largest


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
    rows, where = subject.rows[at], subject.layout.where
    s = np.hstack((rows[:, where("z")], rows[:, where("r")]))
    error = (s * (rows[:, where("psi")] - rows[:, where("psi_hat")])).sum(axis=1)
    rate = np.sum(list(terms.values()), axis=0) - pull
    step, follows = np.zeros(len(at)), np.flatnonzero(np.diff(at) == 1)
    step[follows + 1] = (value[follows + 1] - value[follows]) / subject.timing.control_period - rate[follows]
    return WeightsPart(value, {**terms, "remainder": error - pull}, {"step": step}, missed)


@dataclass(frozen=True, eq=False)
class Row:
    """One sample of a learner.

    Attributes:
        number: Which.
        values: (width,) the recorded row.
        s: (p,) the error that it was told.
        Phi: (rows, k) features at it, with the state before.
        before: What was kept of the state before.
        state: The state after.
    """

    number: int
    values: Array
    s: Array
    Phi: Array
    before: dict[str, Array]
    state: ControllerState


def step_again(
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
        keep: What is kept of its state before each, copies by name.
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
    """Parts of a state, by name."""
    return {name: state[name].copy() for name in parts}
