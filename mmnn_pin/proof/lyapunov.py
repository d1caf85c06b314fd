"""The Lyapunov function along a run: V of (3.53) with the corrected V1, its derivative term by term, and when it grows.

    V = V1(pose error) + s' M s / 2 + weights' part            (see `errors`, `weights_part`)
    Vdot = pose + coupling + feedback + robust + leakage + remainder        for the continuous loop, predicted

What the measured change of V over a control period adds to that is told apart: `step`, the second order of the update
of the weights, and `hold`, the rest: torque and weights are held while the errors move on. With sensors that err,
`sensors` is what the controller's error in s does. The terms add up to the measured change exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..signals import Array
from .errors import motion_energy, pose_of
from .ideal import Ideal
from .limited import taken
from .subject import Subject
from .truth import Truth, estimate_part
from .weights_part import weights_part

MOST = 5000  # samples that are looked at, evenly spread
TERMS = {
    "pose": "-kx ex^2 - (vr kth/ky) sin^2 ephi: the kinematic law",
    "coupling": "ex z1 + (sin ephi/ky) z2: the velocity error drives the pose; (3.19) drops it",
    "feedback": "-s' k s",
    "robust": "-s' Kz (|Z| + ZB) s",
    "leakage": "kappa |s| tr(Zt' Z): the weights are pulled to zero, an estimate to its start",
    "cut": "updates of the estimate that are cut to a share of the feedback",
    "limits": "s' (Psi_hat of the weights - Psi_hat): what the motors' limits take from it",
    "remainder": "s' w: what of Psi - Psi_hat no update of the weights cancels",
    "sensors": "the controller's s is not the true one",
    "motors": "-s' (torque of the motors - torque asked for)",
    "push": "-s' f: external forces",
    "step": "the update of the weights is a step, not a flow",
    "hold": "torque and weights are held over a control period",
}
PREDICTED = (
    *("pose", "coupling", "feedback", "robust", "leakage", "cut", "limits"),
    *("remainder", "sensors", "motors", "push"),
)


@dataclass(frozen=True, eq=False)
class Lyapunov:
    """V at (k,) control samples, and its change over the control period that begins there.

    Attributes:
        time: [s].
        period: Control period [s].
        pose: V1 [m^2].
        motion: s' M s / 2 [J].
        weights: The weights' part; zeros without a learner.
        measured: Change of V over the period, divided by it [SI/s].
        terms: Name to the term's share in that (k,) [SI/s]; they add up to `measured`.
        missed: How well stepping the learner again met the recorded Psi_hat, relative; 0 without a learner.
    """

    time: Array
    period: float
    pose: Array
    motion: Array
    weights: Array
    measured: Array
    terms: dict[str, Array]
    missed: float

    @property
    def total(self) -> Array:
        """V, whose parts the thesis adds as numbers in SI units."""
        return self.pose + self.motion + self.weights

    @property
    def predicted(self) -> Array:
        """The derivative that the continuous loop has [SI/s]."""
        return np.sum([self.terms[name] for name in PREDICTED], axis=0)


def lyapunov(
    subject: Subject,
    ideal: dict[int, Ideal] | Truth | None = None,
    most: int = MOST,
    progress: Callable[[float], None] | None = None,
) -> Lyapunov:
    """V along a run and the terms of its derivative.

    Args:
        subject: The run.
        ideal: Ideal weights of its networks, or the true parameters of an adaptive controller; without them the
            weights' part is left out, and `remainder` is all of `s' (Psi - Psi_hat)`.
        most: Samples to look at.
        progress: Called with the fraction done.

    Raises:
        RecordingError: `ky` is 0: there is no V1.
    """
    count, h = len(subject.rows) - 1, subject.timing.control_period
    starts = np.arange(0, count, -(-count // most))
    at = np.unique(np.concatenate((starts, starts + 1)))
    here, there = np.searchsorted(at, starts), np.searchsorted(at, starts + 1)
    rows = subject.rows[at]
    true = subject.truth(rows)
    pose, motion = pose_of(subject, true), motion_energy(subject, true)
    weights = None
    if isinstance(ideal, Truth) and subject.learner is not None:
        weights = estimate_part(subject, subject.learner, ideal, at, progress)
    elif isinstance(ideal, dict) and subject.networks is not None:
        weights = weights_part(subject.networks, ideal, subject.rows, at, progress)
    values = (pose.value, motion, np.zeros(len(at)) if weights is None else weights.value)
    measured = sum((value[there] - value[here]) / h for value in values)
    rates = powers(subject, rows[here], true[here], subject.given.torque[starts], subject.given.push[starts])
    terms = {"pose": pose.decay[here], "coupling": pose.coupling[here]} | rates
    if weights is not None:
        cut = np.broadcast_to(weights.cut, len(at))[here]
        terms |= {"leakage": weights.leakage[here], "remainder": weights.remainder[here], "cut": cut}
        terms["step"] = weights.step[there]
        assert subject.learner is not None
        terms["limits"] = taken(subject.learner, subject.rows, starts)
    terms = {name: terms.get(name, np.zeros(len(here))) for name in TERMS if name != "hold"}
    terms["hold"] = measured - np.sum(list(terms.values()), axis=0)
    missed = 0.0 if weights is None else weights.missed
    time = subject.signal("time")[starts, 0]
    at_start = [value[here] for value in values]
    return Lyapunov(time, h, at_start[0], at_start[1], at_start[2], np.asarray(measured), terms, missed)


def powers(subject: Subject, rows: Array, true: Array, torque: Array, push: Array) -> dict[str, Array]:
    """`s' (Psi - tau - f)` taken apart [W].

    Args:
        subject: The run.
        rows: (k, width) rows of it.
        true: The same rows of the truth.
        torque: (k, p) what the motors gave.
        push: (k, p) external forces f.
    """
    where = subject.layout.where

    def s(table: Array) -> Array:
        return table[:, where("nu_ref")] - np.hstack((table[:, where("velocity")], table[:, where("qdot")]))

    psi, psi_hat, robust, tau = (rows[:, where(name)] for name in ("psi", "psi_hat", "robust", "torque"))
    told, really = s(rows), s(true)
    truly = (really * (true[:, where("psi")] - tau)).sum(axis=1)
    return {
        "feedback": -(told * (tau - psi_hat - robust)).sum(axis=1),
        "robust": -(told * robust).sum(axis=1),
        "remainder": (told * (psi - psi_hat)).sum(axis=1),
        "sensors": truly - (told * (psi - tau)).sum(axis=1),
        "motors": -(really * (torque - tau)).sum(axis=1),
        "push": -(really * push).sum(axis=1),
    }
