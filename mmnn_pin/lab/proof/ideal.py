"""Ideal weights: those with which a network says Psi best on the visited set, found offline.

The theorem supposes that `Psi = W*' sigma(V*' x) + eps` with `|eps| <= eps_N`, `|Z*| <= ZB` (before (3.26)).
Here they are found, so that W*, V*, eps_N and ZB are numbers: least squares with a penalty on the weights,

    sum over components of FVU + PENALTY |Z|_F^2   ->   min over Z = (W, V)

where a nominal model is added with `Psi - Psi_0` in the place of Psi. W in closed form for every V, V by L-BFGS from
the weights that the run started with. The minimum is a local one and the penalty a choice: with a smaller one eps_N
falls and the norm grows. They bound nothing outside the visited set.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import expit

from ...signals import Array
from ...torque.two_layer import TwoLayer
from .learner import Networks, seen
from .subject import Subject

PENALTY = 1e-6
MOST = 2000  # rows that the fit sees, evenly spread
ITERATIONS = 300


@dataclass(frozen=True, eq=False)
class Ideal:
    """Ideal weights of one network, in the network's own coordinates (see `Neural.network_scales`).

    Attributes:
        W: (h, m) output weights W*.
        V: (nx, h) hidden weights V*; those that are fixed, for a one-layer network.
        norm: `|Z*|_F` of the weights that are learned: what ZB bounds.
        distance: `|Z* - Z|_F` at the end of the run.
        distance_W: `|W* - W|_F` at the end of the run.
        distance_V: `|V* - V|_F` at the end of the run; 0 for hidden weights that are fixed.
        start_distance: The same at its start.
        learned_norm: `|Z|_F` at the end of the run.
        assumed: The ZB that the run's robust term counts with; NaN without a robust term.
        eps: (m,) largest |Psi - W*' sigma(V*' x)| on the visited set per component [N, N m].
        eps_N: Largest Euclidean norm of the same in the network's coordinates.
        unexplained: (m,) fraction of variance that they leave.
    """

    W: Array
    V: Array
    norm: float
    distance: float
    distance_W: float
    distance_V: float
    start_distance: float
    learned_norm: float
    assumed: float
    eps: Array
    eps_N: float
    unexplained: Array


def ideal_weights(subject: Subject, learner: Networks) -> dict[int, Ideal]:
    """Ideal weights of every network on the rows of a run, network (1 the base's, 2 the arm's) to weights."""
    two_layer = isinstance(learner.own.network, TwoLayer)
    told, psi = seen(learner, learner.start, subject.rows), subject.signal("psi")
    some = slice(None, None, -(-len(psi) // MOST))
    scale, found = learner.own.network_scales(subject.layout)[1], {}
    for i, part in learner.networks:
        network = scale[part] * (told.activations[i] @ learner.start[f"W{i}"])
        known = told.psi_hat[:, part] - network  # what a nominal model says
        target, V = (psi[:, part] - known) / scale[part], np.array(learner.start[f"V{i}"])
        if two_layer:
            V = hidden_weights(told.inputs[some], target[some], spread(V))
            hidden = expit(told.inputs @ V)
        else:
            hidden = told.activations[i]
        W = output_weights(hidden[some], target[some])
        found[i] = judged(learner, i, W, V, target, hidden, scale[part])
    return found


def output_weights(hidden: Array, target: Array) -> Array:
    """W (h, m) of least penalised squares for hidden outputs (N, h)."""
    gram, cross = hidden.T @ hidden / len(hidden), hidden.T @ target / len(hidden)
    columns = []
    for i, variance in enumerate(variances(target)):
        factor = cho_factor(gram + PENALTY * variance * np.eye(len(gram)))
        columns.append(cho_solve(factor, cross[:, i]))
    return np.column_stack(columns)


def variances(target: Array) -> Array:
    """Variance of every component, at least a trace of its mean square: a constant is a target, too."""
    return np.maximum(target.var(axis=0), 1e-6 * (target**2).mean(axis=0) + 1e-300)


def hidden_weights(x: Array, target: Array, V: Array) -> Array:
    """V (nx, h) of least penalised squares from a start, W following from it (variable projection)."""
    from scipy.optimize import minimize  # slow to import

    variance = variances(target)

    def cost(values: Array) -> tuple[float, Array]:
        V = values.reshape(x.shape[1], -1)
        hidden = expit(x @ V)
        W = output_weights(hidden, target)
        error = hidden @ W - target
        value = ((error**2).mean(axis=0) / variance).sum() + PENALTY * ((W**2).sum() + (V**2).sum())
        slope = 2 * (error / variance) @ W.T * hidden * (1 - hidden) / len(x)
        return value, (x.T @ slope + 2 * PENALTY * V).ravel()

    found = minimize(cost, V.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS, "maxcor": 20})
    return np.asarray(found.x.reshape(V.shape))


def spread(V: Array) -> Array:
    """A start whose units differ: V itself, or numbers from a fixed seed where all units are equal."""
    if (np.ptp(V, axis=1) > 0).any():
        return V
    return np.random.default_rng(0).uniform(-1.0, 1.0, V.shape)


def judged(learner: Networks, i: int, W: Array, V: Array, target: Array, hidden: Array, scale: Array) -> Ideal:
    """Ideal weights with what they leave and how far the run's weights are from them."""
    error = target - hidden @ W
    both = isinstance(learner.own.network, TwoLayer)

    def norm(W: Array, V: Array) -> float:
        return float(np.sqrt((W**2).sum() + ((V**2).sum() if both else 0.0)))

    start, end = learner.start, learner.end
    return Ideal(
        W=W,
        V=V,
        norm=norm(W, V),
        distance=norm(W - end[f"W{i}"], V - end[f"V{i}"]),
        distance_W=float(np.linalg.norm(W - end[f"W{i}"])),
        distance_V=float(np.linalg.norm(V - end[f"V{i}"])) if both else 0.0,
        start_distance=norm(W - start[f"W{i}"], V - start[f"V{i}"]),
        learned_norm=norm(end[f"W{i}"], end[f"V{i}"]),
        assumed=float("nan") if learner.own.robust is None else learner.own.robust.ZB[i - 1],
        eps=np.abs(error).max(axis=0) * scale,
        eps_N=float(np.linalg.norm(error, axis=1).max()),
        unexplained=(error**2).mean(axis=0) / variances(target),
    )
