"""The weights' part of adaptive control, `V_theta / a` (see `truth`), along a run, and what changes it.

a is the factor on the gradient of the tracking error, `tracking`, 1 without a prediction error. A gradient g moves the
estimate by `Gamma g`, which takes `g' theta~` out of V_theta, whatever g is (docs/learners.md). With `g = eta Y' s` in
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

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...signals import Array, IntArray
from ...torque.adaptation import Adaptation
from ...torque.adaptive import vector_of
from ...torque.controller import ControllerState
from ...torque.prediction import LARGEST, Prediction
from .learner import Learner
from .subject import Subject
from .truth import BODY, Truth, adaptation_of, distances, divergence, matrices, matrix, stepped
from .weights_part import WITHOUT, WeightsPart, part_of


def estimate_part(
    subject: Subject, learner: Learner, truth: Truth, at: IntArray, progress: Callable[[float], None] | None = None
) -> WeightsPart:
    """`V_theta / a` at some rows of a run, (k,) ascending, and what learning leaves of its derivative.

    Raises:
        RecordingError: `tracking` is 0, so that nothing takes the pull out.
    """
    a, rows, h, theta = adaptation_of(learner), subject.rows, learner.context.control_period, truth.theta
    if not a.tracking > 0:
        raise RecordingError(WITHOUT, why="the estimate does not follow s: tracking is 0")
    first = BODY * len(a.roots)
    learned = np.concatenate((np.full(first, a.gamma > 0), a.rates > 0)) & a.learning
    before, steps = learner.start["theta"].copy(), np.zeros((2, len(rows)))

    def visit(n: int, state: ControllerState) -> None:
        p = a.prediction
        if p is not None and int(state["samples"][0] - 1) % p.every == 0:
            steps[:, n] = prediction_step(a, p, before, theta, learned, state)
        before[:] = state["theta"]

    found = stepped(learner, rows, at, progress, visit)
    estimate, s = found.theta[at], np.hstack((subject.signal("z"), subject.signal("r")))[at]
    g = np.einsum("npk,np->nk", found.Y, s)
    pull = (g * (theta - estimate))[:, learned].sum(axis=1)  # s' Y theta_tilde of what is learned
    eta = shares_of_update(a, estimate, g, (s**2 @ a.gain), h)
    leak = leakage_of(a, theta, estimate, s) if a.learning else np.zeros(len(at))
    prediction, noise = steps[:, at] / h
    terms = {"leakage": leak, "cut": (a.tracking - eta) * pull, "prediction": prediction, "noise": noise}
    terms = {name: values / a.tracking for name, values in terms.items()}
    return part_of(subject, at, distances(a, theta, estimate) / a.tracking * a.learning, pull, terms, found.missed)


def prediction_step(
    a: Adaptation, p: Prediction, estimate: Array, theta: Array, learned: NDArray[np.bool_], state: ControllerState
) -> tuple[float, float]:
    """What a step down the prediction error does to V_theta, to first order: prediction and noise.

    Args:
        a: The numbers of the law.
        p: Those of its prediction error.
        estimate: (k,) the estimate before.
        theta: (k,) the truth.
        learned: (k,) which parameters are.
        state: The memory after, with Q and b.
    """
    Q, b, error = state["Q"], state["b"], np.where(learned, theta - estimate, 0.0)
    Gamma = metric(a, estimate)
    wanted = p.weight * np.column_stack((Q @ error, b - Q @ (estimate + error)))
    known, wrong = np.linalg.solve(np.eye(len(Q)) + p.weight * Q @ Gamma, wanted).T
    share = shortening(a, estimate, Gamma @ (known + wrong))
    return -share * float(error @ known), -share * float(error @ wrong)


def metric(a: Adaptation, estimate: Array) -> Array:
    """Gamma, (k, k): where a gradient takes the estimate, `gamma P L P` of a body and `gamma_j` of the rest."""
    first = BODY * len(a.roots)
    Gamma = np.diag(np.concatenate((np.zeros(first), a.rates)))
    L = matrices(np.eye(BODY), 0.5)
    for here in bodies(a):
        P = matrix(estimate[here])
        Gamma[here, here] = a.gamma * np.array([vector_of(one) for one in P @ L @ P]).T
    return Gamma


def shortening(a: Adaptation, estimate: Array, step: Array) -> float:
    """The factor that lets no body change by more than `LARGEST` of itself."""
    share = 1.0
    for here in bodies(a):
        X = np.linalg.solve(matrix(estimate[here]), matrix(step[here]))
        size = np.sqrt(max(np.trace(X @ X), 0.0))
        share = min(share, LARGEST / size if size > 0 else 1.0)
    return share


def bodies(a: Adaptation) -> list[slice]:
    """Where the numbers of every body stand in theta."""
    return [slice(BODY * b, BODY * b + BODY) for b in range(len(a.roots))]


def shares_of_update(a: Adaptation, estimate: Array, g: Array, feedback: Array, h: float) -> Array:
    """Eta, (N,): with which factor each sample moves, for gradients `Y' s` (N, k) and `s' K s` (N,)."""
    answer = (a.rates * g[:, BODY * len(a.roots) :] ** 2).sum(axis=1)
    for here in bodies(a):
        PL = matrices(estimate[:, here]) @ matrices(g[:, here], 0.5)
        answer += a.gamma * np.einsum("nij,nji->n", PL, PL)
    answer *= h
    most = a.share * feedback
    return np.where(a.tracking * answer > most, most / np.where(answer > 0, answer, 1.0), a.tracking)


def leakage_of(a: Adaptation, theta: Array, estimate: Array, s: Array) -> Array:
    """What leakage does to V_theta, (N,) [W]."""
    sigma, first = a.sigma * (np.linalg.norm(s, axis=1) if a.by_error else np.ones(len(s))), BODY * len(a.roots)
    learned = a.rates > 0
    error, moved = (theta - estimate)[:, first:], estimate[:, first:] - a.start
    found = (error * moved)[:, learned] @ (1 / a.rates[learned])
    for b, here in enumerate(bodies(a) if a.gamma > 0 else ()):
        P, P0, Q = matrix(theta[here]), a.roots[b] @ a.roots[b].T, matrices(estimate[:, here])
        back = np.array([divergence(one, P0[None])[0] for one in Q])
        found -= (divergence(P, Q) + back - divergence(P, P0[None])[0]) / a.gamma
    return np.asarray(sigma * found)
