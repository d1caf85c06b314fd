"""The truth that an adaptive controller estimates: the robot's parameters, and how far its estimate is from them.

    V_theta = sum over bodies of D(P || P_hat) / gamma + sum over the rest of theta_tilde_j^2 / (2 gamma_j)

with `D(P || Q) = log |Q| / |P| + tr(Q^-1 P) - 4` of the pseudo-inertias (see `torque.adaptation`); how it changes along
a run is told in `estimate_part`. The other learners that know how the robot moves have these parameters as the truth of
their weights, too; of all weights that say the same Psi on every motion, those are the ones nearest to their start,
measured by their prior.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...errors import RecordingError
from ...model.tree.body import parameters
from ...signals import Array, IntArray
from ...torque.adaptation import Adaptation
from ...torque.adaptive import Adaptive, pseudo_inertias
from ...torque.concurrent import ConcurrentLearner
from ...torque.controller import ControllerState
from ...torque.kalman import KalmanLearner
from ...torque.pseudo_inertia import to_matrix
from .learner import Learner, Stepper
from .subject import Subject
from .weights_part import Missed

BODY = 10


@dataclass(frozen=True, eq=False)
class Truth:
    """The true parameters of a run's robot.

    Attributes:
        theta: (k,) the parameters.
        known: How many combinations of them change Psi.
        eps: (p,) largest `|Psi - Y theta|` on the run [N, N m]: of friction not linear in theta, of sensors that err.
        distance: (2,) V_theta at the start and at the end of the run.
        parts: The same of bodies and friction, name to (2,).
    """

    theta: Array
    known: int
    eps: Array
    distance: Array
    parts: dict[str, Array]


@dataclass(frozen=True, eq=False)
class Estimates:
    """An adaptive controller stepped again over the rows of its run.

    Attributes:
        theta: (N, k) its estimate before the update of every row.
        Y: (k', p, k) its regressor at the rows that were asked for.
        missed: How far it was from the recorded Psi_hat, as of `Missed.share`.
    """

    theta: Array
    Y: Array
    missed: float


def true_parameters(subject: Subject, learner: Learner) -> Truth:
    """The parameters of a run's robot, before it picks up a payload.

    Raises:
        RecordingError: A body without a density, so that no estimate can come to it, or a robot whose friction on the
            base's motion is of another kind.
    """
    controller: Adaptive = learner.controller
    theta, numbers = parameters(subject.robot), adaptation_of(learner)
    bodies = controller.regressor.bodies
    for name, P in zip(bodies, pseudo_inertias(theta[: controller.regressor.inertial]), strict=True):
        if np.linalg.eigvalsh(P)[0] <= 1e-12 * np.trace(P):
            why = f"the body at '{name}' has no density: flat, a point, or with impossible inertias"
            raise RecordingError("no true parameters", why=why, file=subject.recording.path)
    some = np.unique(np.linspace(0, len(subject.rows) - 1, 500).astype(int))
    eps = subject.signal("psi")[some] - regressors(learner, subject.rows[some]) @ theta
    ends = np.array([learner.start["theta"], learner.end["theta"]])
    first = controller.regressor.inertial
    parts = {
        "bodies": distances(numbers, theta, ends, slice(0, first)),
        "friction": distances(numbers, theta, ends, slice(first, None)),
    }
    known = controller.unit.shape[1]
    return Truth(theta, known, np.abs(eps).max(axis=0), parts["bodies"] + parts["friction"], parts)


def adaptation_of(learner: Learner) -> Adaptation:
    """The numbers of an adaptive law."""
    found = learner.controller.law(learner.context).adaptation
    assert found is not None
    return found


def regressors(learner: Learner, rows: Array) -> Array:
    """Y of an adaptive controller at rows (N, width), (N, p, k), which no estimate changes."""
    stepper = Stepper(learner, learner.start.snapshot(), learning=False)
    adaptation = stepper.torque.law.adaptation
    assert adaptation is not None
    Y = np.zeros((len(rows), *adaptation.known.Y.shape))
    for n, row in enumerate(rows):
        stepper.step(row)
        Y[n] = adaptation.known.Y
    return Y


def stepped(
    learner: Learner,
    rows: Array,
    at: IntArray,
    progress: Callable[[float], None] | None = None,
    visit: Callable[[int, ControllerState], None] = lambda n, state: None,
) -> Estimates:
    """Estimates along rows (N, width) from the start of a run, and regressors at some of them, ascending.

    `visit` is called after every row with its number and the memory.
    """
    stepper = Stepper(learner, learner.start.snapshot())
    adaptation = stepper.torque.law.adaptation
    assert adaptation is not None
    theta, Y = np.zeros((len(rows), stepper.state["theta"].size)), np.zeros((len(at), *adaptation.known.Y.shape))
    missed, wanted = Missed(rows[:, learner.context.layout.where("psi_hat")]), {n: i for i, n in enumerate(at)}
    for n, row in enumerate(rows):
        theta[n] = stepper.state["theta"]
        if missed.lost(n, stepper.step(row)):
            break
        if n in wanted:
            Y[wanted[n]] = adaptation.known.Y
        visit(n, stepper.state)
        if progress is not None and n % 500 == 0:
            progress(n / len(rows))
    return Estimates(theta, Y, missed.share)


def true_weights(subject: Subject, learner: Learner) -> Array | None:
    """The weights (k,) of a learner with a regressor that say the robot's parameters; None for another learner.

    Raises:
        RobotError: A joint that cannot be flattened.
    """
    controller = learner.controller
    if isinstance(controller, ConcurrentLearner):
        basis, deviation = controller.basis, controller.deviation
        scaled = (parameters(subject.robot) - controller.start()) / deviation
        return np.asarray((basis / deviation[:, None]).T @ scaled)
    if isinstance(controller, KalmanLearner) and controller.regressor is not None and controller.drawn is None:
        matters = controller.regressor.identifiable()
        spread = learner.start["prior"][:, None] * matters
        return np.asarray(spread @ np.linalg.solve(matters.T @ spread, matters.T @ parameters(subject.robot)))
    return None


def distances(a: Adaptation, theta: Array, estimates: Array, part: slice = slice(None)) -> Array:
    """V_theta of estimates (N, k), or the part of some of the parameters, (N,)."""
    first, total = BODY * len(a.roots), np.zeros(len(estimates))
    wanted = np.zeros(len(theta), bool)
    wanted[part] = True
    for b in range(len(a.roots) if a.gamma > 0 else 0):
        if wanted[BODY * b]:
            here = slice(BODY * b, BODY * b + BODY)
            total += divergence(matrix(theta[here]), matrices(estimates[:, here])) / a.gamma
    learned = (a.rates > 0) & wanted[first:]
    error = (theta[first:] - estimates[:, first:])[:, learned]
    return np.asarray(total + (error**2 / (2 * a.rates[learned])).sum(axis=1))


def divergence(P: Array, Q: Array) -> Array:
    """D(P || Q) for many Q (N, 4, 4), (N,)."""
    ratio = np.linalg.slogdet(Q)[1] - np.linalg.slogdet(P)[1]
    return np.asarray(ratio + np.trace(np.linalg.solve(Q, np.broadcast_to(P, Q.shape)), axis1=1, axis2=2) - 4.0)


def matrix(numbers: Array, side: float = 1.0) -> Array:
    """The symmetric matrix of ten numbers, those beside its diagonal times a factor."""
    found = np.zeros((4, 4))
    to_matrix(np.ascontiguousarray(numbers), side, found)
    return found


def matrices(numbers: Array, side: float = 1.0) -> Array:
    """The same of many, (N, 10) to (N, 4, 4)."""
    basis = np.array([matrix(e, side) for e in np.eye(BODY)])
    return np.asarray(np.einsum("nk,kij->nij", numbers, basis))
