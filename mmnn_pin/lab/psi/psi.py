"""Psi_hat against the Psi of Pinocchio: online while the weights adapt, and frozen, with the final weights held fixed.

The measure is the fraction of variance unexplained (FVU) of every component, after the first 0.5 s. A learner that
adapts fast follows Psi without knowing it: its error online is small, and the weights of any instant say little about
the next. Frozen weights show what it knows: along the same trajectory, along one that it never saw (`held_out`), and
after a change of the robot that it was not told of (docs/explanation/proof.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np

from ...errors import InputError, RecordingError
from ...model.dynamics import Dynamics
from ...model.robot import Robot
from ...recording.metrics import halves
from ...settings import finite
from ...signals import Array, Layout
from ...torque.learning_law import origin_of
from ..experiments.controllers import CONTROLLERS
from ..experiments.laws import GIVEN
from .excitation import Network, features_of
from .held_out import START, held_out, loaded, recorded_under_computed_torque, usual_payload
from .learner import Learner, frozen_psi_hat
from .subject import Subject

FLAT = 1e-9  # spread of Psi, relative to its size, below which it has no variance to explain
PARTS = ("feedback", "network", "robust")
WINDOWS = 5
MOST = 20_000  # rows of a run along which frozen weights are evaluated, evenly spread
FEW = 1_000  # of these, those at which Pinocchio tells the Psi of the robot with a payload
ProgressCallback = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Frozen:
    """Psi and the Psi_hat of the final weights, held fixed, along some rows."""

    about: str  # which rows, in words
    time: Array  # (N,) [s]
    psi: Array  # (N, p) the truth [N, N m]
    psi_hat: Array  # (N, p) what they say

    @property
    def fvu(self) -> Array:
        """FVU of every component after the first 0.5 s, (p,)."""
        counts = self.time >= START - 1e-9
        return fvu(self.psi[counts], self.psi_hat[counts])


@dataclass(frozen=True, eq=False)
class Psi:
    """The share of Psi that a run's Psi_hat followed, and that its final weights know.

    Attributes:
        labels: Names of the p components.
        halves: Components of the base and of the arm.
        online: FVU online after the first 0.5 s, (p,).
        edges: Edges of the windows, (n + 1,) [s].
        windows: FVU online in each of them, (n, p), with the variance that Psi has there.
        errors: Error online in each of them over the variance of the whole run, (n, p); their mean is `online`.
        shares: Part of the torque to its share, (p,) each.
        sizes: Part of the torque to its RMS over that of the torque, (p,) each.
        frozen: Final weights held fixed, by name: `same`, `held_out`, `payload`; empty for a controller that learns
            nothing.
        features: Makes `networks`.
        weights_time: When the weights were taken [s].
        remarks: What is left out, and why.
    """

    labels: tuple[str, ...]
    halves: dict[str, slice]
    online: Array
    edges: Array
    windows: Array
    errors: Array
    shares: dict[str, Array]
    sizes: dict[str, Array]
    frozen: dict[str, Frozen]
    features: Callable[[], list[Network]]
    weights_time: float
    remarks: tuple[str, ...]

    @cached_property
    def networks(self) -> list[Network]:
        """The learner's networks, or its regressor; empty as `frozen` is, and where it gives no features."""
        return self.features()

    def to_dict(self) -> dict[str, Any]:
        """FVU online and frozen per component with the worst of base and arm, shares of the torque, the networks."""

        def each(values: Array) -> dict[str, float | None]:
            return {label: finite(value) for label, value in zip(self.labels, values, strict=True)}

        def judged(values: Array) -> dict[str, Any]:
            halves = {part: finite(worst(values[where])) for part, where in self.halves.items()}
            return {"components": each(values), **halves}

        return {
            "online": judged(self.online),
            "windows": [
                {"from": finite(a), "to": finite(b), **judged(row), "of_run_variance": each(error)}
                for (a, b), row, error in zip(pairwise(self.edges), self.windows, self.errors, strict=True)
            ],
            "frozen": {name: {"about": frozen.about, **judged(frozen.fvu)} for name, frozen in self.frozen.items()},
            "weights_time": finite(self.weights_time),
            "torque_share": {part: each(values) for part, values in self.shares.items()},
            "torque_rms_ratio": {part: each(values) for part, values in self.sizes.items()},
            "networks": {network.name: network.to_dict() for network in self.networks},
        }


def psi_of(
    subject: Subject, payload: float | None = None, count: int = WINDOWS, progress: ProgressCallback | None = None
) -> Psi:
    """Psi_hat of a run against the truth.

    Args:
        subject: The run.
        payload: Load put on the robot [kg]; None for `usual_payload`.
        count: Number of windows of the online FVU.
        progress: Called with what is being done and the fraction done.

    Raises:
        RecordingError: The controller gave no Psi_hat, or the run is not longer than 0.5 s.
    """
    psi, psi_hat, torque, robust = (subject.signal(name) for name in ("psi", "psi_hat", "torque", "robust"))
    if not psi_hat.any():
        own = "a controller of your own whose step returns a torque alone; let it return (torque, Psi_hat)"
        raise RecordingError(
            f"{subject.controller} gives no Psi_hat",
            why=own if subject.controller not in CONTROLLERS else "it estimates nothing",
            file=subject.recording.path,
        )
    time = subject.signal("time")[:, 0]
    edges = windows(time, count)
    if not edges.size:
        raise RecordingError(
            "too short for Psi",
            why=f"it ends at {time[-1]:.3g} s, and FVU counts from {START} s on",
            fix="run longer",
            file=subject.recording.path,
        )
    counts = time >= START - 1e-9
    learner = subject.learner
    frozen, remarks = frozen_weights(subject, learner, payload, progress) if learner else ({}, [])
    return Psi(
        labels=subject.robot.velocity_names,
        halves=halves(subject.recording),
        online=fvu(psi[counts], psi_hat[counts]),
        edges=edges,
        windows=fvu_in(edges, time, psi, psi_hat),
        errors=error_in(edges, time, psi, psi_hat),
        shares=shares(torque[counts], subject.applied[counts], robust[counts]),
        sizes=sizes(torque[counts], subject.applied[counts], robust[counts]),
        frozen=frozen,
        features=partial(features_of, learner, subject.rows[:: thinned(subject.rows, MOST)]) if learner else list,
        weights_time=learner.end_time if learner else float("nan"),
        remarks=(*remarks, *remarks_on_law(subject)),
    )


def remarks_on_law(subject: Subject) -> list[str]:
    """How to hear more of a learning law of a user, or that another file than the run's was used for it."""
    if how := how_to_know(subject):
        return [how]
    about = subject.recording.meta.get("law")
    if about is None or subject.learner is None:
        return []
    used = origin_of(type(subject.learner.controller))
    if used["sha256"] == about["sha256"]:
        return []
    return [f"{used['file'] or used['class']} is not what it was in the run: its SHA-256 differs"]


def how_to_know(subject: Subject) -> str:
    """How to hear what the weights of a user's law know, where its class is not at hand; else empty."""
    about = subject.recording.meta.get("law")
    if about is None or subject.learner is not None:
        return ""
    if not set(GIVEN) <= (subject.recording.meta.get("controller_settings") or {}).keys():
        return ""
    file = about["file"] or "FILE.py"
    return f"what the weights of {subject.controller} know is judged with --law {file}, which runs that file"


def frozen_weights(
    subject: Subject, learner: Learner, payload: float | None, progress: ProgressCallback | None
) -> tuple[dict[str, Frozen], list[str]]:
    """Psi_hat of the final weights by the name of the motion; remarks on what is left out, and why."""
    show = progress or (lambda what, fraction: None)
    robot, remarks, where = subject.robot, list[str](), subject.layout.where
    every = thinned(subject.rows, MOST)
    rows = subject.rows[::every]
    time = rows[:, where("time")][:, 0]
    show("frozen weights", 0.1)
    visited = frozen_psi_hat(learner, learner.end, subject.rows, every)
    frozen = {"same": Frozen("the run's own trajectory", time, rows[:, where("psi")], visited)}
    show("frozen weights", 0.3)
    try:
        wanted = held_out(subject)
        seen = recorded_under_computed_torque(
            robot, wanted, learner.controller.feedback, subject.kinematic, subject.timing
        )
        show("frozen weights", 0.7)
        estimate = frozen_psi_hat(learner, learner.end, seen)
        frozen["held_out"] = Frozen(wanted.about, seen[:, where("time")][:, 0], seen[:, where("psi")], estimate)
    except InputError as error:
        remarks.append(f"no held-out trajectory: {' '.join(str(error).split())}")
    mass = usual_payload(robot) if payload is None else payload
    place = "at the arm's tip" if robot.joint_names else "on the base"
    some = slice(None, None, thinned(rows, FEW))
    truth = psi_along(loaded(robot, mass), rows[some], subject.layout)
    frozen["payload"] = Frozen(f"the same with {mass:.3g} kg {place}", time[some], truth, visited[some])
    show("frozen weights", 1.0)
    return frozen, remarks


def thinned(rows: Array, most: int) -> int:
    """Every how many rows leave at most so many."""
    return -(-len(rows) // most)


def psi_along(robot: Robot, rows: Array, layout: Layout) -> Array:
    """Psi of a robot at the states and commands of rows, (N, p) [N, N m]."""
    dynamics, result = Dynamics(robot), np.zeros((len(rows), layout.dof))
    names = ("position", "nu", "nu_ref", "nudot_ref")
    for psi, position, nu, nu_ref, nudot_ref in zip(
        result, *(np.ascontiguousarray(rows[:, layout.where(name)]) for name in names), strict=True
    ):
        dynamics.refresh(position, nu)
        dynamics.refresh_psi(nu_ref, nudot_ref, psi)
    return result


def fvu(psi: Array, psi_hat: Array) -> Array:
    """Fraction of variance unexplained of every component, `sum (Psi - Psi_hat)^2 / sum (Psi - mean Psi)^2`, (p,).

    0 is perfect; the best constant has 1; saying nothing at all has `1 + mean(Psi)^2 / var(Psi)`; there is no upper
    bound. NaN where Psi does not vary, or without samples.

    Args:
        psi: (N, p) the truth [N, N m].
        psi_hat: (N, p) what a controller says of it.
    """
    if not len(psi):
        return np.full(psi.shape[1], np.nan)
    error = ((psi - psi_hat) ** 2).sum(axis=0)
    variance = ((psi - psi.mean(axis=0)) ** 2).sum(axis=0)
    flat = variance <= len(psi) * (FLAT * np.abs(psi).max(axis=0)) ** 2
    return np.where(flat, np.nan, error / np.where(flat, 1.0, variance))


def windows(time: Array, count: int) -> Array:
    """Edges (count + 1,) of equal windows from `START` to the end of a run [s]; empty for a run that ends before."""
    period = time[1] - time[0]
    end = time[-1] + period
    return np.linspace(START, end, count + 1) if end > START + period else np.zeros(0)


def error_in(edges: Array, time: Array, psi: Array, psi_hat: Array) -> Array:
    """Mean squared error in every window over the variance of Psi in all of them together, (count, p).

    Unlike `fvu_in` it does not explode where Psi hardly varies; the mean over equal windows is the FVU of the whole.
    """
    places = np.searchsorted(time, edges - 1e-9)
    span = slice(places[0], places[-1])
    variance = fvu(psi[span], psi[span] + 1.0)  # 1 / variance, NaN where Psi does not vary
    return np.array([((psi[a:b] - psi_hat[a:b]) ** 2).mean(axis=0) * variance for a, b in pairwise(places)])


def fvu_in(edges: Array, time: Array, psi: Array, psi_hat: Array) -> Array:
    """FVU in every window [a, b), (count, p); see `fvu`."""
    places = np.searchsorted(time, edges - 1e-9)
    return np.array([fvu(psi[a:b], psi_hat[a:b]) for a, b in pairwise(places)])


def worst(values: Array) -> float:
    """The worst component, which counts; NaN where none has a number."""
    return float(np.nanmax(values)) if np.isfinite(values).any() else float("nan")


def shares(torque: Array, psi_hat: Array, robust: Array) -> dict[str, Array]:
    """Share of every part in the torque, (p,) each: `sum part tau / sum tau^2`; they add up to 1.

    A part that works against the others has a share below 0. NaN where there is no torque.

    Args:
        torque: (N, p) applied torque [N, N m].
        psi_hat: (N, p) of it the network's.
        robust: (N, p) of it the robust term's.
    """
    total = (torque**2).sum(axis=0)
    return {name: ratio((part * torque).sum(axis=0), total) for name, part in parts(torque, psi_hat, robust).items()}


def sizes(torque: Array, psi_hat: Array, robust: Array) -> dict[str, Array]:
    """RMS of every part over RMS of the torque, (p,) each; the network's is its learned share."""
    total = (torque**2).sum(axis=0)
    result = parts(torque, psi_hat, robust)
    return {name: np.sqrt(ratio((part**2).sum(axis=0), total)) for name, part in result.items()}


def parts(torque: Array, psi_hat: Array, robust: Array) -> dict[str, Array]:
    """The torque taken apart, (N, p) each: `tau = feedback + network + robust` (3.39)."""
    return {"feedback": torque - psi_hat - robust, "network": psi_hat, "robust": robust}


def ratio(value: Array, total: Array) -> Array:
    """Value over total, NaN where the total is 0."""
    return np.where(total > 0, value / np.where(total > 0, total, 1.0), np.nan)
