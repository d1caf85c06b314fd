"""All that a run proves: what was learned of Psi, and beside it ideal weights, Lyapunov function and balance."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from mmnn_pin.errors import InputError, RecordingError
from mmnn_pin.lab.psi.judgement import Judgement, judgement_of, keep, sentence, with_part
from mmnn_pin.lab.psi.learner import NAMES, NetworkLearner
from mmnn_pin.lab.psi.psi import WINDOWS, ProgressCallback, how_to_know
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.recording.recording import Recording
from mmnn_pin.torque.learning_law import LearningLaw

from .balance import BUDGET, Balance, balance
from .claims import weights_part_of
from .linear import LinearFit, covariance_part, gain_part, linear_fit, stack_part
from .load import Carried, carried
from .lyapunov import MOST, Growth, Lyapunov, Part, growth, lyapunov
from .networks import Ideal, ideal_weights, network_part
from .truth import Truth, estimate_part, true_parameters
from .weights_part import WITHOUT, WeightsPart

MISSED = 1e-6  # relative difference of Psi_hat beyond which the weights of a run are not its weights
QUICK = 5_000  # evaluations of the dynamics for one of several runs: a fraction of a second
IdealWeights = dict[int, Ideal] | Truth | LinearFit
# What gives the weights' part at rows, by its name in `claims`.
WEIGHTS_PARTS: dict[str, Callable[..., WeightsPart]] = {
    "networks": network_part,
    "estimate": estimate_part,
    "stack": stack_part,
    "covariance": covariance_part,
    "gain": gain_part,
}
LUMPS = ("estimate", "stack", "covariance")  # parts of learners that may move their weights less often than they act


class Proof(Judgement):
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

    PARTS = ("psi", "ideal", "lyapunov", "balance")

    def __init__(
        self,
        recording: Recording,
        *,
        payload: float | None = None,
        windows: int = WINDOWS,
        budget: float = BUDGET,
        progress: ProgressCallback | None = None,
    ) -> None:
        super().__init__(recording, payload=payload, windows=windows, progress=progress)
        self.budget, self.left_out = budget, ""

    @classmethod
    def beyond(cls, judgement: Judgement) -> Proof:
        """The proof of a run that was judged: what is known of it is not computed again."""
        proof = cls.__new__(cls)
        proof.__dict__.update(judgement.__dict__ | {"_errors": dict(judgement.__dict__.get("_errors", {}))})
        proof.__dict__.pop("missing", None)
        proof.budget, proof.left_out = QUICK, ""
        return proof

    @cached_property
    def ideal(self) -> IdealWeights:
        """The best weights that there are, see `best_weights`."""
        return best_weights(self.subject)

    @cached_property
    def lyapunov(self) -> Lyapunov:
        """V along the run and the terms of its derivative, with the weights' part where there are ideal weights."""
        show = self.progress_of("Lyapunov function")
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
    def load(self) -> Carried | None:
        """What the learner knows of a load that was picked up, see `carried`."""
        return carried(self.subject)

    @cached_property
    def growth(self) -> Growth:
        """When and why V grows."""
        return growth(self.lyapunov)

    @cached_property
    def balance(self) -> Balance:
        """Whether the energy of the errors changes as the model says, see `balance`."""
        return balance(self.subject, self.budget, self.progress_of("equality"))

    @property
    def worth_telling(self) -> dict[str, InputError]:
        """Of the parts that cannot be had, those of which a remark says why: one of a controller without Psi_hat."""
        idle = {"psi", "ideal"} <= self.missing.keys() or bool(how_to_know(self.subject))
        return {name: error for name, error in self.missing.items() if not (idle and name == "ideal")}

    def remarks(self) -> list[str]:
        """What to know before believing the numbers, one line each."""
        subject, result = self.subject, super().remarks()
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

    def to_dict(self) -> dict[str, Any]:
        """Everything that `mmnn prove` tells, for JSON; a part that cannot be had is null, and `remarks` say why."""
        return super().to_dict() | {
            "load": self.load.to_dict() if self.has("load") and self.load is not None else None,
            "ideal": ideal_dict(self.ideal) if self.has("ideal") else None,
            "lyapunov": self.lyapunov.to_dict() | self.growth.to_dict() if self.has("lyapunov") else None,
            "equality": self.balance.to_dict() if self.has("balance") else None,
            "holds": self.holds,
        }

    def progress_of(self, what: str) -> Callable[[float], Any] | None:
        """Where the share that is done of something is told; None where nobody listens."""
        show = self.progress
        return None if show is None else lambda fraction: show(what, min(1.0, fraction))


def proof_of(recording: Recording) -> Proof:
    """The proof of a recording; errors as of `Proof`."""
    kept = judgement_of(recording)
    if not isinstance(kept, Proof):
        kept = Proof.beyond(kept)
        keep(kept)
    return kept


def proofs_with(recordings: Mapping[str, Recording], part: str) -> tuple[dict[str, Proof], list[str]]:
    """The proofs that have a part, by name, and why the others have none."""
    return with_part(recordings, part, proof_of)


def best_weights(subject: Subject) -> IdealWeights:
    """Ideal weights of networks, true parameters for an adaptive controller, best ones of another linear learner.

    Raises:
        RecordingError: The controller has none of these, or its law is not at hand.
    """
    learner = subject.learner
    if isinstance(learner, NetworkLearner):
        return ideal_weights(subject, learner)
    if learner is not None and weights_part_of(learner.controller) == "estimate":
        return true_parameters(subject, learner)
    if learner is not None and (fit := linear_fit(subject, learner)) is not None:
        return fit
    why = f"{subject.controller} does not give the features that its weights are multiplied with"
    if learner is not None and isinstance(learner.controller, LearningLaw):
        why += "; write methods features(sample, state) and gain(state), and V has its weights' part"
    raise RecordingError("no ideal weights", why=why, file=subject.recording.path)


def ideal_dict(ideal: IdealWeights) -> dict[str, Any]:
    """Ideal weights for JSON: by network; true parameters; best fixed weights."""
    if isinstance(ideal, dict):
        return {NAMES[i]: weights.to_dict() for i, weights in ideal.items()}
    return ideal.to_dict()


class Kept(NamedTuple):
    """The weights' part of a learner."""

    part: Part  # what gives it at rows
    most: float = math.inf  # samples to look at
    every: int = 1  # control periods from one update of the weights to the next


def weights_of(subject: Subject, ideal: IdealWeights) -> Kept | None:
    """The weights' part of a run's learner with its ideal weights; None where nothing was learned."""
    learner = subject.learner
    if learner is None or not learner.controller.learning or (name := weights_part_of(learner.controller)) is None:
        return None
    return Kept(
        partial(WEIGHTS_PARTS[name], subject, learner, ideal.W if isinstance(ideal, LinearFit) else ideal),
        MOST if name in ("networks", "estimate") else math.inf,
        getattr(learner.controller.law(learner.context).learner, "every", 1) if name in LUMPS else 1,
    )
