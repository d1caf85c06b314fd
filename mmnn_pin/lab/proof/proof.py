"""All that is told of one run: each part when it is first asked for, and why a part cannot be had."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from ...errors import InputError, RecordingError
from ...recording.recording import Recording
from ...torque.learning_law import LearningLaw
from .balance import BUDGET, Balance, balance
from .growth import Growth, growth
from .ideal import Ideal, ideal_weights
from .learner import Networks
from .linear_fit import LinearFit, linear_fit
from .lyapunov import Lyapunov, lyapunov
from .parts import weights_of
from .psi import WINDOWS, Psi, how_to_know, psi_of
from .subject import Subject
from .truth import Truth, true_parameters
from .weights_part import WITHOUT

PARTS = ("psi", "ideal", "lyapunov", "balance")
MISSED = 1e-6  # relative difference of Psi_hat beyond which the weights of a run are not its weights


class Proof:
    """What a run proves. Every part is computed once, when it is first asked for, and may raise an `InputError`.

    Args:
        recording: The run.
        payload: Load for the frozen weights [kg]; None for a usual one.
        windows: Number of windows of the online FVU.
        budget: Evaluations of the dynamics that the balance may take; inf looks at every control period.
        progress: Called with what is being done and the fraction done.

    Raises:
        InputError: The run's robot cannot be built, or its recording does not hold what all parts need.
    """

    def __init__(
        self,
        recording: Recording,
        *,
        payload: float | None = None,
        windows: int = WINDOWS,
        budget: float = BUDGET,
        progress: Callable[[str, float], None] | None = None,
    ) -> None:
        self.subject, self.payload, self.windows, self.budget = Subject.of(recording), payload, windows, budget
        self._progress, self.left_out = progress, ""

    @cached_property
    def psi(self) -> Psi:
        """Psi_hat against the truth, see `psi_of`."""
        return psi_of(self.subject, self.payload, self.windows, self._progress)

    @cached_property
    def ideal(self) -> dict[int, Ideal] | Truth | LinearFit:
        """Ideal weights of networks, true parameters for an adaptive controller, best ones of another linear learner.

        Raises:
            RecordingError: The controller has none of these, or its law is not at hand.
        """
        subject, learner = self.subject, self.subject.learner
        if isinstance(learner, Networks):
            return ideal_weights(subject, learner)
        if learner is not None and learner.controller.lyapunov_part == "estimate":
            return true_parameters(subject, learner)
        fit = None if learner is None else linear_fit(subject, learner)
        if fit is not None:
            return fit
        why = f"{subject.controller} does not tell what its weights are multiplied with"
        if learner is not None and isinstance(learner.controller, LearningLaw):
            why += "; write methods features(sample, state) and gain(state), and V has its weights' part"
        raise RecordingError("no ideal weights", why=why, file=subject.recording.path)

    @cached_property
    def lyapunov(self) -> Lyapunov:
        """V along the run and the terms of its derivative, with the weights' part where there are ideal weights."""
        show = self._show("Lyapunov function")
        kept = weights_of(self.subject, self.ideal) if self.has("ideal") else None
        if kept is not None:
            try:
                found = lyapunov(self.subject, kept.part, kept.most, show, kept.every)
            except RecordingError as error:
                if error.what != WITHOUT:
                    raise
                self.left_out = sentence(error)
            else:
                if found.missed <= MISSED:
                    return found
                what = (
                    f"stepped again, the learner misses the recorded Psi_hat by {found.missed:.1e} of its largest value"
                )
                self.left_out = f"{WITHOUT}: {what}, as under a supervisor or another version"
        return lyapunov(self.subject, progress=show)

    @cached_property
    def growth(self) -> Growth:
        """When and why V grows."""
        return growth(self.lyapunov)

    @cached_property
    def balance(self) -> Balance:
        """Whether the energy of the errors changes as the model says, see `balance`."""
        return balance(self.subject, self.budget, self._show("equality"))

    @cached_property
    def missing(self) -> dict[str, InputError]:
        """The parts that cannot be had, and why; computes all of them."""
        return {name: error for name in PARTS if (error := self._try(name)) is not None}

    def has(self, part: str) -> bool:
        """Whether a part can be had; computes it."""
        return self._try(part) is None

    def remarks(self) -> list[str]:
        """What to know before believing the numbers, one line each."""
        subject, found = self.subject, []
        outcome = subject.recording.outcome
        if outcome.status != "completed":
            found.append(f"the run was {outcome.status}; told is the time before {subject.signal('time')[-1, 0]:.3g} s")
        # one line says it: of a controller without Psi_hat, of a law that is not at hand
        idle = {"psi", "ideal"} <= self.missing.keys() or bool(how_to_know(subject))
        found += [sentence(error) for name, error in self.missing.items() if not (idle and name == "ideal")]
        if subject.plant != "ideal":
            found.append(f"Psi is that of wheels that roll; on the {subject.plant} plant they may slip")
        if self.has("psi"):
            found += self.psi.remarks
            if self.psi.frozen and self.psi.weights_time < outcome.time - subject.timing.control_period / 2:
                found.append(f"frozen weights are those of t = {self.psi.weights_time:.3g} s, the last that are known")
        if self.left_out:
            found.append(self.left_out)
        if np.isfinite(subject.given.pick) and subject.given.pick < subject.signal("time")[-1, 0]:
            found.append(f"M and with it V jump where the payload is picked up, at {subject.given.pick:g} s")
        if self.has("balance") and subject.given.varies:
            what = "motors or pushes may vary within control periods, of which the recording has the means"
            found.append(f"{what}: only model and command are held to the equality")
        return found

    @property
    def holds(self) -> bool:
        """False only where the equality was checked and failed."""
        return not self.has("balance") or self.balance.holds

    def _try(self, part: str) -> InputError | None:
        errors: dict[str, InputError | None] = self.__dict__.setdefault("_errors", {})
        if part not in errors:
            try:
                getattr(self, part)
                errors[part] = None
            except InputError as error:
                errors[part] = error
        return errors[part]

    def _show(self, what: str) -> Callable[[float], Any] | None:
        show = self._progress
        return None if show is None else lambda fraction: show(what, min(1.0, fraction))


def sentence(error: InputError) -> str:
    """What and why of an error, on one line."""
    return " ".join(": ".join(part for part in (error.what, error.why) if part).split())
