"""The truth that an adaptive controller estimates: the robot's parameters, and how far its estimate is from them.

    V_theta = sum over bodies of D(P || P_hat) / gamma_b + sum over the rest of theta_tilde_j^2 / (2 gamma_j)

with `D(P || Q) = log |Q| / |P| + tr(Q^-1 P) - 4` of the pseudo-inertias (see `torque.adaptive`), and
`theta_tilde' Lambda theta_tilde / 2` where it began with a fit. The other learners
that know how the robot moves have these parameters as the truth of their weights, too; of all weights that say the same
Psi on every motion, those are the ones nearest to their start, measured by their prior.

The weights' part of adaptive control is `V_theta / a`.

a is the factor on the gradient of the tracking error, `tracking`, 1 without a prediction error. A gradient g moves the
estimate by `Gamma g`, which takes `g' theta~` out of V_theta, whatever g is (docs/explanation/learners.md).
With `g = eta Y' s` in
every sample, eta < a where the sample's update was cut,

    d/dt V_theta / a = -s' Y theta~ + (1 - eta / a) s' Y theta~ + leakage:        pull, cut, leakage.

A composite one (`adaptive_composite`) also makes, once in a period tau, an implicit step down the prediction error
`b - Q theta_hat = Q theta~ + d`, d what the filtered equations have wrong. It is a step along `Gamma g` with

    g = c tau (1 + c tau Q Gamma)^-1 (Q theta~ + d)

so that to first order it takes `g' theta~` out of V_theta. The first part is the term `prediction`,

    -c tau / a  theta~' (1 + c tau Q Gamma)^-1 Q theta~ = -c tau / a  y' (1 + c tau R Gamma R)^-1 y <= 0

with `R = Q^1/2`, `y = R theta~`, which is `-c theta~' Q theta~ tau / a` for short periods; the second, with d, is
`noise`. What the step has of second order, what its conjugate gradients have not reached and what the bounds clip is in
`step`. Parameters with the rate 0 are not learned: they have no part in V, and what their errors do is in the remainder
and in d.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmnn_pin.errors import InputError, RecordingError
from mmnn_pin.lab.psi.learner import Learner, LearnerStepper
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.settings import finite
from mmnn_pin.signals import Array, IntArray
from mmnn_pin.torque.adaptive import Adaptation
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.pseudo_inertia import BODY, LARGEST, Bodies, pseudo_inertias, to_matrix, vector_of

from .claims import TellsTruth
from .weights_part import WITHOUT, Progress, WeightsPart, part_of, step_again


@dataclass(frozen=True, eq=False)
class Truth:
    """The true parameters of a run's robot."""

    theta: Array  # (k,) the parameters
    known: int  # how many combinations of them change Psi
    # (p,) largest `|Psi - Y theta|` on the run [N, N m]: of friction not linear in theta, of sensors that err
    eps: Array
    distance: Array  # (2,) V_theta at the start and at the end of the run
    parts: dict[str, Array]  # the same of bodies and friction, name to (2,)

    def to_dict(self) -> dict[str, Any]:
        """The parameters and the estimate's distance from them, for JSON."""
        parts = {name: {"start": finite(v[0]), "end": finite(v[1])} for name, v in self.parts.items()}
        eps = [finite(value) for value in self.eps]
        return {"parameters": {"theta": self.theta.tolist(), "known": self.known, "eps": eps, "distance": parts}}


@dataclass(frozen=True, eq=False)
class Estimates:
    """An adaptive controller stepped again over the rows of its run."""

    theta: Array  # (N, k) its estimate before the update of every row
    Y: Array  # (k', p, k) its regressor at the rows that were asked for
    missed: float  # how far it was from the recorded Psi_hat, as `step_again` returns it


def true_parameters(subject: Subject, learner: Learner) -> Truth:
    """The parameters of a run's robot, before it picks up a payload.

    Raises:
        RecordingError: A body without a density, so that no estimate can come to it, or a robot whose friction on the
            base's motion is of another kind.
    """
    controller, theta = learner.controller, parameters(subject.robot)
    metric = numbers_of(learner)[0].bodies
    bodies = controller.regressor.bodies
    for name, P in zip(bodies, pseudo_inertias(theta[: controller.regressor.inertial]), strict=True):
        if np.linalg.eigvalsh(P)[0] <= 1e-12 * np.trace(P):
            raise RecordingError(
                "no true parameters",
                why=f"the body at '{name}' has no density: flat, a point, or with impossible inertias",
                file=subject.recording.path,
            )
    some = np.unique(np.linspace(0, len(subject.rows) - 1, 500).astype(int))
    eps = np.abs(subject.signal("psi")[some] - regressors(learner, subject.rows[some]) @ theta).max(axis=0)
    ends, first = np.array([learner.start["theta"], learner.end["theta"]]), controller.regressor.inertial
    which = {"bodies": slice(0, first), "friction": slice(first, None)}
    parts = {name: distances(metric, theta, ends, part) for name, part in which.items()}
    return Truth(theta, controller.unit.shape[1], eps, parts["bodies"] + parts["friction"], parts)


def numbers_of(learner: Learner) -> tuple[Adaptation, Any]:
    """The numbers of an adaptive law, and of its prediction error where it has one."""
    return parts_of(learner.controller.law(learner.context).learner)


def parts_of(numbers: Any) -> tuple[Adaptation, Any]:
    """The numbers of an adaptive law out of those of a law with or without a prediction error."""
    return (numbers.adaptation, numbers) if hasattr(numbers, "adaptation") else (numbers, None)


def regressors(learner: Learner, rows: Array) -> Array:
    """Y of an adaptive controller at rows (N, width), (N, p, k), which no estimate changes."""
    stepper, Y = LearnerStepper(learner, learner.start.snapshot(), learning=False), list[Array]()
    for row in rows:
        stepper.step(row)
        Y.append(parts_of(stepper.torque.learner)[0].known.Y.copy())
    return np.array(Y)


def stepped(
    learner: Learner,
    rows: Array,
    at: IntArray,
    progress: Progress = None,
    visit: Callable[[int, ControllerState], None] = lambda n, state: None,
) -> Estimates:
    """Estimates along rows (N, width) from the start of a run, and regressors at some of them, ascending.

    `visit` is called after every row with its number and the state.
    """
    theta, Y, wanted = np.zeros((len(rows), learner.start["theta"].size)), dict[int, Array](), set(at.tolist())

    def before(n: int, row: Array, stepper: LearnerStepper) -> None:
        theta[n] = stepper.state["theta"]

    def after(n: int, row: Array, stepper: LearnerStepper, kept: None) -> None:
        if n in wanted:
            Y[n] = parts_of(stepper.torque.learner)[0].known.Y.copy()
        visit(n, stepper.state)

    missed, none = step_again(learner, rows, before, after, progress), np.zeros_like(regressors(learner, rows[:1])[0])
    return Estimates(theta, np.array([Y.get(n, none) for n in at.tolist()]), missed)


def true_weights(subject: Subject, learner: Learner) -> Array | None:
    """The weights (k,) of a learner with a regressor that say the robot's parameters; None where there are none."""
    law = learner.controller
    if not isinstance(law, TellsTruth):
        return None
    try:
        return law.true_weights(parameters(subject.robot), learner.start)
    except InputError:  # such as a joint that cannot be flattened
        return None


def distances(a: Bodies, theta: Array, estimates: Array, part: slice = slice(None)) -> Array:
    """V_theta of estimates (N, k), or the part of some of the parameters, (N,)."""
    first, total = BODY * len(a.roots), np.zeros(len(estimates))
    wanted = np.zeros(len(theta), bool)
    wanted[part] = True
    for b, gamma in enumerate(a.gamma):
        if gamma > 0 and wanted[BODY * b]:
            here = slice(BODY * b, BODY * b + BODY)
            total += divergence(matrix(theta[here]), matrices(estimates[:, here])) / gamma
    learned = (a.rates > 0) & wanted[first:]
    error = (theta[first:] - estimates[:, first:])[:, learned]
    total = total + (error**2 / (2 * a.rates[learned])).sum(axis=1)
    every = theta - estimates
    return np.asarray(total + ((every @ a.known) * every * wanted).sum(axis=1) / 2 if a.known.size else total)


def divergence(P: Array, Q: Array) -> Array:
    """D(P || Q) for many Q (N, 4, 4), (N,); inf for a singular one."""
    size = np.linalg.slogdet(Q)[1]
    sound = np.isfinite(size)
    ratio, Q = size - np.linalg.slogdet(P)[1], np.where(sound[:, None, None], Q, np.eye(4))
    found = ratio + np.trace(np.linalg.solve(Q, np.broadcast_to(P, Q.shape)), axis1=1, axis2=2) - 4.0
    return np.where(sound, found, np.inf)


def matrix(numbers: Array, side: float = 1.0) -> Array:
    """The symmetric matrix of ten numbers, those beside its diagonal times a factor."""
    found = np.zeros((4, 4))
    to_matrix(np.ascontiguousarray(numbers), side, found)
    return found


def matrices(numbers: Array, side: float = 1.0) -> Array:
    """The same of many, (N, 10) to (N, 4, 4)."""
    return np.asarray(np.einsum("nk,kij->nij", numbers, np.array([matrix(e, side) for e in np.eye(BODY)])))


def estimate_part(
    subject: Subject, learner: Learner, truth: Truth, at: IntArray, progress: Progress = None
) -> WeightsPart:
    """`V_theta / a` at some rows of a run, (k,) ascending, and what learning leaves of its derivative.

    Raises:
        RecordingError: `tracking` is 0, so that nothing takes the pull out.
    """
    (a, p), rows, h, theta = numbers_of(learner), subject.rows, learner.context.control_period, truth.theta
    if not a.tracking > 0:
        raise RecordingError(WITHOUT, why="the estimate does not follow s: tracking is 0")
    m = a.bodies
    learned = np.concatenate((np.repeat(m.gamma > 0, BODY), m.rates > 0)) & a.learning
    before, steps = learner.start["theta"].copy(), np.zeros((2, len(rows)))

    def visit(n: int, state: ControllerState) -> None:
        if p is not None and int(state["samples"][0] - 1) % p.every == 0:
            steps[:, n] = prediction_step(m, p, before, theta, learned, state)
        before[:] = state["theta"]

    found = stepped(learner, rows, at, progress, visit)
    estimate, s = found.theta[at], subject.s[at]
    g = np.einsum("npk,np->nk", found.Y, s)
    pull = (g * (theta - estimate))[:, learned].sum(axis=1)  # s' Y theta_tilde of what is learned
    eta = shares_of_update(a, estimate, found.Y, s, subject.signal("z").shape[1], h)
    leak = leakage_of(a, theta, estimate, s) if a.learning else np.zeros(len(at))
    prediction, noise = steps[:, at] / h
    terms = {"leakage": leak, "cut": (a.tracking - eta) * pull, "prediction": prediction, "noise": noise}
    terms = {name: values / a.tracking for name, values in terms.items()}
    return part_of(subject, at, distances(m, theta, estimate) / a.tracking * a.learning, pull, terms, found.missed)


def prediction_step(
    a: Bodies, p: Any, estimate: Array, theta: Array, learned: NDArray[np.bool_], state: ControllerState
) -> tuple[float, float]:
    """What a step down the prediction error does to V_theta, to first order: prediction and noise.

    Args:
        a: The metric of the estimate.
        p: The numbers of its prediction error.
        estimate: (k,) the estimate before.
        theta: (k,) the truth.
        learned: (k,) which parameters are.
        state: The state after, with Q and b.
    """
    Q, b, error = state["Q"], state["b"], np.where(learned, theta - estimate, 0.0)
    Gamma = metric(a, estimate)
    wanted = p.weight * np.column_stack((Q @ error, b - Q @ (estimate + error)))
    known, wrong = np.linalg.solve(np.eye(len(Q)) + p.weight * Q @ Gamma, wanted).T
    share = shortening(a, estimate, Gamma @ (known + wrong))
    return -share * float(error @ known), -share * float(error @ wrong)


def metric(a: Bodies, estimate: Array) -> Array:
    """Gamma, (k, k): where a gradient takes the estimate, `gamma P L P` of a body and `gamma_j` of the rest.

    With information of the start it is `(Gamma^-1 + Lambda)^-1`.
    """
    Gamma, L = np.diag(np.concatenate((np.zeros(BODY * len(a.roots)), a.rates))), matrices(np.eye(BODY), 0.5)
    for gamma, here in zip(a.gamma, bodies(a), strict=True):
        P = matrix(estimate[here])
        Gamma[here, here] = gamma * np.array([vector_of(one) for one in P @ L @ P]).T
    return Gamma if not a.known.size else Gamma @ np.linalg.inv(np.eye(len(Gamma)) + a.known @ Gamma)


def shortening(a: Bodies, estimate: Array, step: Array) -> float:
    """The factor that lets no body change by more than `LARGEST` of itself."""
    share = 1.0
    for here in bodies(a):
        X = np.linalg.solve(matrix(estimate[here]), matrix(step[here]))
        size = np.sqrt(max(np.trace(X @ X), 0.0))
        share = min(share, LARGEST / size if size > 0 else 1.0)
    return share


def bodies(a: Bodies) -> list[slice]:
    """Where the numbers of every body stand in theta."""
    return [slice(BODY * b, BODY * b + BODY) for b in range(len(a.roots))]


def shares_of_update(a: Adaptation, estimate: Array, Y: Array, s: Array, base: int, h: float) -> Array:
    """Eta, (N,): with which factor each sample moves; base, arm and all of them answer within their share.

    Args:
        a: The numbers of the law.
        estimate: (N, k) of the samples.
        Y: (N, p, k) regressors.
        s: (N, p) errors.
        base: How many velocities are the base's.
        h: Control period [s].
    """
    p, eta = s.shape[1], np.full(len(s), a.tracking)
    for part in (slice(0, base), slice(base, p), slice(0, p)) if 0 < base < p else (slice(0, p),):
        answer = h * lengths(a.bodies, estimate, np.einsum("npk,np->nk", Y[:, part], s[:, part]))
        most = a.share * (s[:, part] ** 2 @ a.gain[part])
        eta = np.where(eta * answer > most, most / np.where(answer > 0, answer, 1.0), eta)
    return eta


def lengths(m: Bodies, estimate: Array, g: Array) -> Array:
    """`g' Gamma g` of gradients (N, k), (N,)."""
    if m.known.size:
        return np.array([one @ metric(m, theta) @ one for one, theta in zip(g, estimate, strict=True)])
    found = (m.rates * g[:, BODY * len(m.roots) :] ** 2).sum(axis=1)
    for gamma, here in zip(m.gamma, bodies(m), strict=True):
        PL = matrices(estimate[:, here]) @ matrices(g[:, here], 0.5)
        found += gamma * np.einsum("nij,nji->n", PL, PL)
    return np.asarray(found)


def leakage_of(a: Adaptation, theta: Array, estimate: Array, s: Array) -> Array:
    """What leakage does to V_theta, (N,) [W]."""
    m = a.bodies
    sigma, first = a.sigma * (np.linalg.norm(s, axis=1) if a.by_error else np.ones(len(s))), BODY * len(m.roots)
    learned = m.rates > 0
    error, moved = (theta - estimate)[:, first:], estimate[:, first:] - m.start
    found = (error * moved)[:, learned] @ (1 / m.rates[learned])
    for b, here in enumerate(bodies(m) if (m.gamma > 0).all() else ()):
        P, P0, Q = matrix(theta[here]), m.roots[b] @ m.roots[b].T, matrices(estimate[:, here])
        back = np.array([divergence(one, P0[None])[0] for one in Q])
        found -= (divergence(P, Q) + back - divergence(P, P0[None])[0]) / m.gamma[b]
    return np.asarray(sigma * found)
