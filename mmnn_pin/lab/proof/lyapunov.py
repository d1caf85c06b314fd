"""The Lyapunov function along a run: V of (3.53) with the corrected V1, its derivative term by term, and when it grows.

    V = V1(pose error) + s' M s / 2 + weights' part            (see `errors`, `weights_part`)
    Vdot = pose + coupling + feedback + robust + leakage + prediction + remainder + ...   continuous loop, predicted

What the measured change of V over a control period adds to that is told apart: `step`, the second order of the update
of the weights, and `hold`, the rest: torque and weights are held while the errors move on. With sensors that err,
`sensors` is what the controller's error in s does. The terms add up to the measured change exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...signals import Array, IntArray
from .errors import motion_energy, pose_of
from .limited import taken
from .subject import Subject
from .weights_part import WeightsPart

MOST = 5000  # samples that are looked at, evenly spread
TERMS = {
    "pose": "-kx ex^2 - (vr kth/ky) sin^2 ephi: the kinematic law",
    "coupling": "ex z1 + (sin ephi/ky) z2: the velocity error drives the pose; (3.19) drops it",
    "feedback": "-s' k s",
    "robust": "-s' Kz (|Z| + ZB) s",
    "leakage": "weights are pulled to zero, an estimate to its start or prior; kappa |s| tr(Zt' Z)",
    "cut": "updates by s that are cut to a share of the feedback",
    "limits": "s' (Psi_hat of the weights - Psi_hat): what the motors' limits take from it",
    "prediction": "filtered torque or kept samples teach the weights, as far as they tell the truth",
    "noise": "what filtered torque has wrong: sensors, motors, what the ideal weights leave",
    "memory": "what was learned counts less, or a stack of equations changes",
    "projection": "weights beyond learning.projection are scaled back: never up with ideal weights within it",
    "own": "what the law does beside W' = Gamma Phi' s",
    "remainder": "s' w: what of Psi - Psi_hat no update of the weights cancels",
    "sensors": "the controller's s is not the true one",
    "motors": "-s' (torque of the motors - torque asked for)",
    "push": "-s' f: external forces",
    "step": "the update of the weights is a step, not a flow",
    "hold": "torque and weights are held over a control period",
}
PREDICTED = tuple(name for name in TERMS if name not in ("step", "hold"))
Part = Callable[[IntArray, Callable[[float], None] | None], WeightsPart]


@dataclass(frozen=True, eq=False)
class Lyapunov:
    """V at (k,) control samples, and its change over the period that begins there.

    Attributes:
        time: [s].
        period: The control period, or that of a learner that updates its weights less often [s].
        pose: V1 [m^2].
        motion: s' M s / 2 [J].
        weights: The weights' part; zeros without a learner.
        measured: Change of V over the period, divided by it [SI/s].
        terms: Name to the term's share in that (k,) [SI/s]; they add up to `measured`.
        missed: How well stepping the learner again met the recorded Psi_hat, relative; 0 without a learner.
        every: Control periods in one of these periods.
    """

    time: Array
    period: float
    pose: Array
    motion: Array
    weights: Array
    measured: Array
    terms: dict[str, Array]
    missed: float
    every: int = 1

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
    part: Part | None = None,
    most: float = MOST,
    progress: Callable[[float], None] | None = None,
    every: int = 1,
) -> Lyapunov:
    """V along a run and the terms of its derivative.

    Args:
        subject: The run.
        part: Gives the weights' part at rows (`weights_of`); without it that is left out, and `remainder` is all of
            `s' (Psi - Psi_hat)`.
        most: Samples to look at.
        progress: Called with the fraction done.
        every: Control periods from one update of the weights to the next. Of a learner that moves them in lumps all
            samples are looked at, and V over its own periods.

    Raises:
        RecordingError: `ky` is 0: there is no V1.
    """
    every = min(every, len(subject.rows) - 1)
    count, h = (len(subject.rows) - 1) // every * every, subject.timing.control_period
    starts = np.arange(0, count, int(-(-count // most)) if every == 1 else 1)
    at = np.unique(np.concatenate((starts, starts + 1)))
    here, there = np.searchsorted(at, starts), np.searchsorted(at, starts + 1)
    rows = subject.rows[at]
    true = subject.truth(rows)
    pose, motion = pose_of(subject, true), motion_energy(subject, true)
    weights = None if part is None else part(at, progress)
    values = (pose.value, motion, np.zeros(len(at)) if weights is None else weights.value)
    measured = sum((value[there] - value[here]) / h for value in values)
    rates = powers(subject, rows[here], true[here], subject.given.torque[starts], subject.given.push[starts])
    terms = {"pose": pose.decay[here], "coupling": pose.coupling[here]} | rates
    if weights is not None:
        terms |= {name: values[here] for name, values in weights.terms.items()}
        terms |= {name: values[there] for name, values in weights.arrived.items()}
        assert subject.learner is not None
        terms["limits"] = taken(subject.learner, subject.rows, starts)
        terms["remainder"] = terms["remainder"] - terms["limits"]
    terms = {name: terms.get(name, np.zeros(len(here))) for name in TERMS if name != "hold"}
    terms["hold"] = measured - np.sum(list(terms.values()), axis=0)
    missed = 0.0 if weights is None else weights.missed
    time = subject.signal("time")[starts[::every], 0]
    at_pose, at_motion, at_weights = (value[here][::every] for value in values)
    terms = {name: means(values, every) for name, values in terms.items()}
    measured = means(np.asarray(measured), every)
    return Lyapunov(time, h * every, at_pose, at_motion, at_weights, measured, terms, missed, every)


def means(values: Array, every: int) -> Array:
    """Means over so many samples each."""
    return np.asarray(values.reshape(-1, every).mean(axis=1))


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
