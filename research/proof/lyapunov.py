"""The Lyapunov function along a run: V of (3.53) with the corrected V1, its derivative term by term, when it grows.

    V = V1(pose error) + s' M s / 2 + weights' part            s = [z; r]; the weights' part: see `weights_part`
    Vdot = pose + coupling + feedback + robust + leakage + prediction + remainder + ...   continuous loop, predicted

`V1 = (ex^2 + ey^2)/2 + (1 - cos ephi)/ky` for a differential drive: the corrected form of (3.4), which as printed is
indefinite. For a holonomic base the heading counts as `1 - cos ephi`; a fixed arm has no V1. Along a motion

    V1dot = -kx ex^2 - (|vr| kth/ky) sin^2 ephi + ex z1 + (sin ephi/ky) z2        z is the input; (3.19) drops it
    d/dt (s' M s/2) = s' (Psi - torque)                                           by skew symmetry

What the measured change of V over a control period adds to the prediction is split in two: `step`, the second order of
the update of the weights, and `hold`, the rest: torque and weights are held while the errors move on. With sensors that
err, `sensors` is what the controller's error in s does. The weights' part speaks of what the weights say; the torque
has the Psi_hat that `torque.law` leaves of that, which is the term `limits`, and where it leads (`loop.lead`) that of
a later instant, which is the term `lead`. The terms add up to the measured change exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.psi.learner import Learner, LearnerStepper
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.model.base.base import Base, PoseEnergy
from mmnn_pin.settings import finite
from mmnn_pin.signals import Array, IntArray

from .weights_part import WeightsPart

MOST = 5000  # samples that are looked at, evenly spread
TERMS = {
    "pose": "-kx ex^2 - (vr kth/ky) sin^2 ephi: the kinematic law",
    "coupling": "ex z1 + (sin ephi/ky) z2: the velocity error drives the pose; (3.19) drops it",
    "feedback": "-s' k s",
    "robust": "-s' Kz (|Z| + ZB) s",
    "leakage": "weights are pulled to zero, an estimate to its start or prior; kappa |s| tr(Zt' Z)",
    "cut": "updates by s that are cut to a share of the feedback",
    "lead": "s' (Psi_hat - what is sent of it): it is said for the middle of the time in which it acts",
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
SPANS = 3


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

    def to_dict(self) -> dict[str, Any]:
        """V and its parts at start and end, for JSON."""
        parts = {part: getattr(self, part) for part in ("pose", "motion", "weights")}

        def ends(values: Array) -> dict[str, float | None]:
            return {"start": finite(values[0]), "end": finite(values[-1])}

        return {"V": ends(self.total), "parts": {part: ends(values) for part, values in parts.items()}}


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
    applied = subject.applied[at][here]
    hardware = subject.hardware
    rates = powers(subject, rows[here], true[here], applied, hardware.torque[starts], hardware.push[starts])
    terms = {"pose": pose.decay[here], "coupling": pose.coupling[here]} | rates
    if weights is not None:
        terms |= {name: values[here] for name, values in weights.terms.items()}
        terms |= {name: values[there] for name, values in weights.arrived.items()}
        assert subject.learner is not None
        terms["limits"] = limited_power(subject.learner, subject.rows, starts)
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


def powers(subject: Subject, rows: Array, true: Array, applied: Array, torque: Array, push: Array) -> dict[str, Array]:
    """`s' (Psi - tau - f)` taken apart [W].

    Args:
        subject: The run.
        rows: (k, width) rows of it.
        true: The same rows of the truth.
        applied: (k, p) what was sent of Psi_hat.
        torque: (k, p) what the motors gave.
        push: (k, p) external forces f.
    """
    where = subject.layout.where

    def s(table: Array) -> Array:
        return table[:, where("nu_ref")] - np.hstack((table[:, where("velocity")], table[:, where("qdot")]))

    psi, psi_hat, robust, tau = (rows[:, where(name)] for name in ("psi", "psi_hat", "robust", "torque"))
    seen, true_s = s(rows), s(true)
    truly = (true_s * (true[:, where("psi")] - tau)).sum(axis=1)
    return {
        "feedback": -(seen * (tau - applied - robust)).sum(axis=1),
        "lead": (seen * (psi_hat - applied)).sum(axis=1),
        "robust": -(seen * robust).sum(axis=1),
        "remainder": (seen * (psi - psi_hat)).sum(axis=1),
        "sensors": truly - (seen * (psi - tau)).sum(axis=1),
        "motors": -(true_s * (torque - tau)).sum(axis=1),
        "push": -(true_s * push).sum(axis=1),
    }


def pose_part(base: type[Base], error: Array, z: Array, v_ref: Array, gains: Array) -> PoseEnergy:
    """V1 of a kind of base and its derivative from the pose error (k, 3), z and the reference's velocity (k, nb).

    Raises:
        RecordingError: `ky` is 0: there is no V1.
    """
    energy = base.pose_energy(error, z, v_ref, gains)
    if energy is None:
        raise RecordingError("no Lyapunov function of the pose", why="ky is 0")
    return energy


def pose_of(subject: Subject, rows: Array) -> PoseEnergy:
    """V1 along rows of the truth (k, width); errors as in `pose_part`."""
    where, z = subject.layout.where, slice(0, subject.layout.base)
    kind, gains = type(subject.robot.base), subject.kinematic.base_gains(subject.layout)
    s = rows[:, where("nu_ref")] - rows[:, where("nu")]
    try:
        return pose_part(kind, rows[:, where("pose_error")], s[:, z], rows[:, where("velocity_ref")], gains)
    except RecordingError as error:
        raise error.but(file=subject.recording.path) from error


def motion_energy(subject: Subject, rows: Array) -> Array:
    """`s' M s / 2` along rows of the truth (k, width) [J]."""
    where, times = subject.layout.where, rows[:, subject.layout.where("time")][:, 0].tolist()
    positions, velocities = (np.ascontiguousarray(rows[:, where(name)]) for name in ("position", "nu"))
    s, result = rows[:, where("nu_ref")] - velocities, np.zeros(len(rows))
    for k, (time, position, nu) in enumerate(zip(times, positions, velocities, strict=True)):
        dynamics = subject.dynamics(time)
        dynamics.refresh(position, nu)
        result[k] = s[k] @ dynamics.M @ s[k] / 2
    return result


def limited_power(learner: Learner, rows: Array, at: IntArray) -> Array:
    """What the motors' limits take from Psi_hat: `s' (Psi_hat of the weights - Psi_hat)` at some rows, (k,) [W].

    Zeros for a learner that is not limited.

    Args:
        learner: The learner; it is stepped over all rows once more.
        rows: (N, width) rows of its run.
        at: (k,) which of them.
    """
    layout, limits, result = learner.context.layout, learner.context.limits, np.zeros(len(rows))
    if limits is None:
        return result[at]
    stepper = LearnerStepper(learner, learner.start.snapshot())
    for n, row in enumerate(rows):
        psi_hat = stepper.step(row)
        result[n] = np.concatenate((row[layout.where("z")], row[layout.where("r")])) @ (stepper.known - psi_hat)
    return result[at]


@dataclass(frozen=True)
class Span:
    """A stretch of time in which V grows without a break."""

    start: float  # [s]
    end: float  # [s]
    rise: float  # by how much V grows
    why: str  # term with the largest positive sum over it


@dataclass(frozen=True)
class Growth:
    """When and why V grows."""

    samples: float  # share of the control periods in which it does
    rise: float  # sum of its growth
    fall: float  # sum of its decrease, a number >= 0
    why: dict[str, float]  # term to the share of the growing periods in which it is the largest, largest first
    work: dict[str, float]  # term to its sum over the run: what it adds to V
    spans: tuple[Span, ...]  # those of most growth, largest first

    def to_dict(self) -> dict[str, Any]:
        """What each term adds, when and why V grows, for JSON."""
        return {
            "terms": {name: finite(value) for name, value in self.work.items()},
            "growing_share": finite(self.samples),
            "rise": finite(self.rise),
            "fall": finite(self.fall),
            "largest_where_growing": self.why,
            "spans": [{"from": s.start, "to": s.end, "rise": finite(s.rise), "term": s.why} for s in self.spans],
        }


def growth(v: Lyapunov) -> Growth:
    """When and why V grows along a run; over the samples that were looked at, each standing for those it skips."""
    stride = (v.time[1] - v.time[0]) if len(v.time) > 1 else v.period
    change, names = v.measured * stride, list(v.terms)
    table = np.array([v.terms[name] for name in names]) * stride
    grows = change > 0
    largest = table[:, grows].argmax(axis=0)
    counts = {name: float((largest == i).mean()) for i, name in enumerate(names)} if grows.any() else {}
    why = {name: share for name, share in sorted(counts.items(), key=lambda item: -item[1]) if share}
    edges = np.flatnonzero(np.diff(np.concatenate(([0], grows.astype(int), [0]))))
    result = [
        Span(
            float(v.time[a]),
            float(v.time[b - 1] + stride),
            float(change[a:b].sum()),
            names[int(table[:, a:b].sum(axis=1).argmax())],
        )
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    return Growth(
        samples=float(grows.mean()),
        rise=float(change[grows].sum()),
        fall=float(-change[~grows].sum()),
        why=why,
        work=dict(zip(names, table.sum(axis=1).tolist(), strict=True)),
        spans=tuple(sorted(result, key=lambda span: -span.rise)[:SPANS]),
    )
