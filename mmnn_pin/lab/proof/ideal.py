"""Ideal weights: those with which a learner says Psi best on the visited set, found offline, or the true parameters.

*Networks.* The theorem supposes that `Psi = W*' sigma(V*' x) + eps` with `|eps| <= eps_N`, `|Z*| <= ZB` (before
(3.26)). Here they are found, so that W*, V*, eps_N and ZB are numbers: least squares with a penalty on the weights,

    sum over components of FVU + PENALTY |Z|_F^2   ->   min over Z = (W, V)

where a nominal model is added with `Psi - Psi_0` in the place of Psi. W in closed form for every V, V by L-BFGS from
the weights that the run started with. The minimum is a local one and the penalty a choice: with a smaller one eps_N
falls and the norm grows.

*Learners that are linear in their weights*, `Psi_hat = Psi_0 + Phi W`. With a regressor of the robot the ideal weights
are its true parameters (`truth.true_weights`), where the weights are those. Otherwise they are found by least squares
of the true Psi on the features of the run, every component over its variance. Where all components share the weights it
is the shortest of all that are best; where each has its own, as random features have, far more of them than a run tells
apart, there is a small penalty as for networks,

    FVU_i + PENALTY mean over j of (W_ij / unit_ij)^2   ->   min over W_i

with the standard deviations of the learner's prior as units, or, without a prior, those that bring all features and Psi
to one size. What ideal weights leave is what no learning could explain there; outside the visited set it bounds
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import expit

from ...errors import InputError, RecordingError
from ...signals import Array
from ...torque.controller import CompiledController
from ...torque.learning_law import LearningLaw
from .excitation import hidden_learns
from .features import along
from .learner import Learner, Networks, seen
from .subject import Subject
from .truth import Truth, true_parameters, true_weights

PENALTY = 1e-6
MOST = 2000  # rows that the fit sees, evenly spread
ITERATIONS = 300
CUT = 1e-9  # singular values below this share of the largest count as zero


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


def best_weights(subject: Subject) -> IdealWeights:
    """Ideal weights of networks, true parameters for an adaptive controller, best ones of another linear learner.

    Raises:
        RecordingError: The controller has none of these, or its law is not at hand.
    """
    learner = subject.learner
    if isinstance(learner, Networks):
        return ideal_weights(subject, learner)
    if learner is not None and learner.controller.lyapunov_part == "estimate":
        return true_parameters(subject, learner)
    if learner is not None and (fit := linear_fit(subject, learner)) is not None:
        return fit
    why = f"{subject.controller} does not give the features that its weights are multiplied with"
    if learner is not None and isinstance(learner.controller, LearningLaw):
        why += "; write methods features(sample, state) and gain(state), and V has its weights' part"
    raise RecordingError("no ideal weights", why=why, file=subject.recording.path)


def ideal_weights(subject: Subject, learner: Networks) -> dict[int, Ideal]:
    """Ideal weights of every network on the rows of a run, network (1 the base's, 2 the arm's) to weights."""
    two_layer = hidden_learns(learner.own.network)
    samples, psi = seen(learner, learner.start, subject.rows), subject.signal("psi")
    some = slice(None, None, -(-len(psi) // MOST))
    scale, result = learner.own.network_scales(subject.layout)[1], {}
    for i, part in learner.networks:
        network = scale[part] * (samples.activations[i] @ learner.start[f"W{i}"])
        nominal = samples.psi_hat[:, part] - network  # what a nominal model says
        target, V = (psi[:, part] - nominal) / scale[part], np.array(learner.start[f"V{i}"])
        if two_layer:
            V = hidden_weights(samples.inputs[some], target[some], spread(V))
            hidden = expit(samples.inputs @ V)
        else:
            hidden = samples.activations[i]
        W = output_weights(hidden[some], target[some])
        result[i] = ideal_network(learner, i, W, V, target, hidden, scale[part])
    return result


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

    result = minimize(cost, V.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS, "maxcor": 20})
    return np.asarray(result.x.reshape(V.shape))


def output_weights(hidden: Array, target: Array) -> Array:
    """W (h, m) of least penalised squares for hidden outputs (N, h)."""
    units = np.ones((hidden.shape[1], target.shape[1]))
    return penalised(hidden, target, PENALTY * variances(target), units)


def variances(target: Array) -> Array:
    """Variance of every component, at least a trace of its mean square: a constant is a target, too."""
    return np.maximum(target.var(axis=0), 1e-6 * (target**2).mean(axis=0) + 1e-300)


def spread(V: Array) -> Array:
    """A start whose units differ: V itself, or numbers from a fixed seed where all units are equal."""
    if (np.ptp(V, axis=1) > 0).any():
        return V
    return np.random.default_rng(0).uniform(-1.0, 1.0, V.shape)


def ideal_network(learner: Networks, i: int, W: Array, V: Array, target: Array, hidden: Array, scale: Array) -> Ideal:
    """Ideal weights with what they leave and how far the run's weights are from them."""
    error = target - hidden @ W
    both = hidden_learns(learner.own.network)

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


@dataclass(frozen=True, eq=False)
class LinearFit:
    """The best fixed weights of a linear learner on the visited set.

    Attributes:
        W: (k, m) weights; m is 1 where all components share them, else p.
        norm: |W|.
        eps: (p,) largest `|Psi - Psi_0 - Phi W|` on the visited set [N, N m].
        unexplained: (p,) fraction of variance that they leave.
        true: Whether they are the robot's parameters, not a fit.
        distance: How far the run's weights are from them at its start and end, (2,): RMS of `Phi (W - W_run)` over the
            standard deviation of Psi; NaN where the weights are kept otherwise.
    """

    W: Array
    norm: float
    eps: Array
    unexplained: Array
    distance: Array
    true: bool = False


IdealWeights = dict[int, Ideal] | Truth | LinearFit


def linear_fit(subject: Subject, learner: Learner) -> LinearFit | None:
    """The best fixed weights of a run's learner, its true ones where they are known; None without features."""
    samples = along(learner, subject.rows)
    if samples is None:
        return None
    psi, rows = subject.signal("psi")[samples.at], samples.Phi.shape[1]
    m = 1 if rows > 1 else psi.shape[1]
    weights = map(learner.controller.weights, (learner.start, learner.end))
    ends = [of_shape(arrays, samples.Phi.shape[2], m) for arrays in weights]
    nominal = 0.0 if ends[1] is None else samples.psi_hat - (samples.Phi @ ends[1]).reshape(psi.shape)
    target, scale = psi - nominal, np.sqrt(variances(psi))
    true = true_or_none(subject, learner)
    if true is not None:
        W = true[:, None]
    elif rows == 1:
        Phi = samples.Phi[:, 0]
        W = penalised(Phi, target, PENALTY * variances(psi) / Phi.shape[1], units(learner, Phi, scale))
    else:
        table = (samples.Phi / scale[:, None]).reshape(-1, samples.Phi.shape[2])
        W = least_squares(table, (target / scale).reshape(-1, 1))
    left = target - (samples.Phi @ W).reshape(psi.shape)
    return LinearFit(
        W=W,
        norm=float(np.linalg.norm(W)),
        eps=np.abs(left).max(axis=0),
        unexplained=(left**2).mean(axis=0) / variances(psi),
        true=true is not None,
        distance=np.array([np.nan if W_run is None else away(samples.Phi @ (W - W_run), scale) for W_run in ends]),
    )


def true_or_none(subject: Subject, learner: Learner) -> Array | None:
    """The true weights (k,), where they are known."""
    try:
        return true_weights(subject, learner)
    except InputError:
        return None


def units(learner: Learner, Phi: Array, scale: Array) -> Array:
    """What a weight of every feature and component counts as one, (k, p); 0 for one that the prior does not let be."""
    controller = learner.controller
    deviation = controller.prior_deviation(learner.start) if isinstance(controller, CompiledController) else None
    if deviation is not None:
        return np.asarray(deviation)
    size = np.sqrt((Phi**2).mean(axis=0))
    return np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)[:, None] * scale


def penalised(Phi: Array, target: Array, penalties: Array, unit: Array) -> Array:
    """Weights (k, p) of least penalised squares for features (n, k), target (n, p), penalties (p,) and units (k, p)."""
    gram, cross = Phi.T @ Phi / len(Phi), Phi.T @ target / len(Phi)
    columns = []
    for i, one in enumerate(unit.T):
        factor = cho_factor(gram * np.outer(one, one) + penalties[i] * np.eye(len(gram)))
        columns.append(one * cho_solve(factor, one * cross[:, i]))
    return np.column_stack(columns)


def away(difference: Array, scale: Array) -> float:
    """RMS of a difference in Psi_hat (n, rows, m), each component over its scale (p,)."""
    return float(np.sqrt(((difference.reshape(-1, scale.size) / scale) ** 2).mean()))


def least_squares(table: Array, target: Array) -> Array:
    """The shortest weights (k, m) of least squares, in units in which all features are of one size."""
    size = np.sqrt((table**2).mean(axis=0))
    size[size == 0] = 1.0
    return np.asarray(np.linalg.lstsq(table / size, target, rcond=CUT)[0] / size[:, None])


def of_shape(weights: dict[str, Array], k: int, m: int) -> Array | None:
    """The one array of weights with k m numbers, as (k, m); None without exactly one."""
    result = [array for array in weights.values() if array.size == k * m]
    if len(result) != 1:
        return None
    return result[0].T if result[0].shape == (m, k) and m > 1 else result[0].reshape(k, m)
