"""All that is known of one run: each part computed when it is first asked for, and why a part cannot be had."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ...errors import InputError, RecordingError
from ...recording.recording import Recording
from .balance import BUDGET, Balance, balance
from .ideal import IdealWeights, best_weights
from .lyapunov import Growth, Lyapunov, growth, lyapunov
from .parts import weights_of
from .psi import WINDOWS, Psi, how_to_know, psi_of
from .subject import Subject
from .weights_part import WITHOUT

PARTS = ("psi", "ideal", "lyapunov", "balance")
MISSED = 1e-6  # relative difference of Psi_hat beyond which the weights of a run are not its weights
QUICK = 5_000  # evaluations of the dynamics for one of several runs: a fraction of a second
PROOFS: WeakKeyDictionary[Recording, Proof] = WeakKeyDictionary()


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
    def ideal(self) -> IdealWeights:
        """The best weights that there are, see `best_weights`."""
        return best_weights(self.subject)

    @cached_property
    def lyapunov(self) -> Lyapunov:
        """V along the run and the terms of its derivative, with the weights' part where there are ideal weights."""
        show = self._show("Lyapunov function")
        kept = weights_of(self.subject, self.ideal) if self.has("ideal") else None
        if kept is not None:
            try:
                result = lyapunov(self.subject, kept.part, kept.most, show, kept.every)
            except RecordingError as error:
                if error.what != WITHOUT:
                    raise
                self.left_out = sentence(error)
            else:
                if result.missed <= MISSED:
                    return result
                what = f"stepped again, the learner misses the recorded Psi_hat by {result.missed:.1e} of its largest"
                self.left_out = f"{WITHOUT}: {what} value, as under a supervisor or another version"
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
        subject, result = self.subject, []
        outcome = subject.recording.outcome
        if outcome.status != "completed":
            result.append(
                f"the run was {outcome.status}; this is about the time before {subject.signal('time')[-1, 0]:.3g} s"
            )
        # one line says it: of a controller without Psi_hat, of a law that is not at hand
        idle = {"psi", "ideal"} <= self.missing.keys() or bool(how_to_know(subject))
        result += [sentence(error) for name, error in self.missing.items() if not (idle and name == "ideal")]
        if subject.plant != "ideal":
            result.append(f"Psi is that of wheels that roll; on the {subject.plant} plant they may slip")
        if self.has("psi"):
            result += self.psi.remarks
            if self.psi.frozen and self.psi.weights_time < outcome.time - subject.timing.control_period / 2:
                result.append(f"frozen weights are those of t = {self.psi.weights_time:.3g} s, the last that are known")
        if self.left_out:
            result.append(self.left_out)
        if np.isfinite(subject.hardware.pick) and subject.hardware.pick < subject.signal("time")[-1, 0]:
            result.append(f"M and with it V jump where the payload is picked up, at {subject.hardware.pick:g} s")
        if self.has("balance") and subject.hardware.varies:
            what = "motors or pushes may vary within control periods, of which the recording has the means"
            result.append(f"{what}: only model and command are held to the equality")
        return result

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


def keep(proof: Proof) -> None:
    """Remember a proof for the figures of its recording."""
    PROOFS[proof.subject.recording] = proof


def proof_of(recording: Recording) -> Proof:
    """The proof of a recording; errors as of `Proof`."""
    if recording not in PROOFS:
        PROOFS[recording] = Proof(recording, budget=QUICK)
    return PROOFS[recording]


def proofs_with(recordings: Mapping[str, Recording], part: str) -> tuple[dict[str, Proof], list[str]]:
    """The proofs that have a part, by name, and why the others have none."""
    result, reasons = {}, []
    for name, recording in recordings.items():
        if not len(recording):
            continue
        try:
            proof = proof_of(recording)
            getattr(proof, part)
            result[name] = proof
        except InputError as error:
            reasons.append(f"{name}: {' '.join(str(error).split())}")
    return result, reasons
