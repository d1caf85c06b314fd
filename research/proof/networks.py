"""Networks: ideal weights, found offline, and the weights' part of the Lyapunov function (3.53).

*Ideal weights.* The theorem supposes that `Psi = W*' sigma(V*' x) + eps` with `|eps| <= eps_N`, `|Z*| <= ZB` (before
(3.26)). Here they are found, so that W*, V*, eps_N and ZB are numbers: least squares with a penalty on the weights,

    sum over components of FVU + PENALTY |Z|_F^2   ->   min over Z = (W, V)

where a nominal model is added with `Psi - Psi_0` in the place of Psi. W in closed form for every V, V by L-BFGS from
the weights that the run started with. The minimum is a local one and the penalty a choice: with a smaller one eps_N
falls and the norm grows.

*The weights' part* is `tr(Wt' F^-1 Wt)/2 + tr(Vt' G^-1 Vt)/2`, `Wt = W* - W`, `Vt = V* - V`. Rates per control sample
are `F/h` per second, and scaled networks (see `Neural.network_scales`) see `s' Psi` divided by c, so that the part of
one network is

    c h / (2 F dt) |Wt|_F^2 + c h / (2 G dt) |Vt|_F^2        dt = 1 for rates per sample, h for rates per second

Along a run `s' (Psi - Psi_hat) + d/dt` of it is what learning leaves: with the error taken apart as

    Psi - Psi_hat = Wt' (sigma - sigma' V' x) + W' sigma' Vt' x + w,    w = Wt' sigma' V*' x + W*' O(Vt' x)^2 + eps

the update cancels all but `s' w + kappa |s| tr(Zt' Z)` (3.54). A network on a nominal model (`two_layer_residual`) has
`Psi - Psi_0` in the place of Psi, and nothing else changes. Where weights are scaled back onto a bound
(`Neural.projection`), what that does to the part is the term `projection`: the same sample once more without the bound
tells it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import expit

from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.psi.learner import LearnerStepper, NetworkLearner, seen
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.settings import finite
from mmnn_pin.signals import Array, IntArray
from mmnn_pin.torque.controller import ControllerState

from .linear import PENALTY, penalised, variances
from .weights_part import Progress, WeightsPart, step_again

MOST = 2000  # rows that the fit sees, evenly spread
ITERATIONS = 300
LARGEST = 1e100  # of a number whose square is summed
Weights = dict[int, tuple[Array, Array]]


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

    def to_dict(self) -> dict[str, Any]:
        """Norms and errors for JSON."""
        return {
            "norm": finite(self.norm),
            "learned_norm": finite(self.learned_norm),
            "Z_tilde_start": finite(self.start_distance),
            "Z_tilde_end": finite(self.distance),
            "W_tilde_end": finite(self.distance_W),
            "V_tilde_end": finite(self.distance_V),
            "ZB": finite(self.assumed),
            "eps": [finite(value) for value in self.eps],
            "eps_N": finite(self.eps_N),
            "fvu": [finite(value) for value in self.unexplained],
        }


def ideal_weights(subject: Subject, learner: NetworkLearner) -> dict[int, Ideal]:
    """Ideal weights of every network on the rows of a run, network (1 the base's, 2 the arm's) to weights.

    Raises:
        RecordingError: Numbers too large to compute with.
    """
    samples, psi = seen(learner, learner.start, subject.rows), subject.signal("psi")
    some = slice(None, None, -(-len(psi) // MOST))
    scale, result = learner.own.network_scales(subject.layout)[1], {}
    for i, part in learner.networks:
        nominal = samples.psi_hat[:, part] - scale[part] * (samples.activations[i] @ learner.start[f"W{i}"])
        target, V = (psi[:, part] - nominal) / scale[part], np.array(learner.start[f"V{i}"])
        if not all(np.abs(one).max(initial=0.0) < LARGEST for one in (target, V, samples.inputs)):
            why = f"weights of network {i}, what it sees or what it has to learn are not below {LARGEST:g}"
            raise RecordingError("no ideal weights", why=why, file=subject.recording.path)
        if learner.own.network.hidden_learns:
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
        return value, (x.T @ (2 * (error / variance) @ W.T * hidden * (1 - hidden) / len(x)) + 2 * PENALTY * V).ravel()

    result = minimize(cost, V.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS, "maxcor": 20})
    return np.asarray(result.x.reshape(V.shape))


def output_weights(hidden: Array, target: Array) -> Array:
    """W (h, m) of least penalised squares for hidden outputs (N, h)."""
    return penalised(hidden, target, PENALTY * variances(target), np.ones((hidden.shape[1], target.shape[1])))


def spread(V: Array) -> Array:
    """A start whose units differ: V itself, or numbers from a fixed seed where all units are equal."""
    if (np.ptp(V, axis=1) > 0).any():
        return V
    return np.random.default_rng(0).uniform(-1.0, 1.0, V.shape)


def ideal_network(
    learner: NetworkLearner, i: int, W: Array, V: Array, target: Array, hidden: Array, scale: Array
) -> Ideal:
    """Ideal weights with what they leave and how far the run's weights are from them."""
    error = target - hidden @ W
    both = learner.own.network.hidden_learns

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


class Network:
    """What one network's part is made of.

    Attributes:
        ideal: Its ideal weights.
        part: Its velocities.
        leakage: kappa, or mu.
        weigh_W: Factor of |Wt|^2; 0 where W is not learned.
        weigh_V: Factor of |Vt|^2; 0 where V is not learned.
        sigmoid: Whether it is a two-layer network, whose update of W subtracts `sigma' V' x`.
        c: `s' Psi` over the product that the network sees.
        scale_out: (m,) torque over the network's output.
    """

    def __init__(self, learner: NetworkLearner, i: int, part: slice, ideal: Ideal) -> None:
        controller, h = learner.own, learner.context.control_period
        rate_W, rate_V, leakage = controller.network.rates(i - 1, controller.leakage)
        scale_in, self.scale_out = (scale[part] for scale in controller.network_scales(learner.context.layout))
        dt = 1.0 if controller.rates == "per_sample" else h
        self.ideal, self.part, self.c = ideal, part, float((self.scale_out / scale_in)[0])
        self.sigmoid = controller.network.hidden_learns
        rates = [rate * controller.learning for rate in (rate_W, rate_V * self.sigmoid)]
        self.weigh_W, self.weigh_V = (self.c * h / (2 * rate * dt) if rate > 0 else 0.0 for rate in rates)
        self.leakage = leakage if any(rates) else 0.0

    def distance(self, one: tuple[Array, Array], other: tuple[Array, Array]) -> float:
        """What the part says of two sets of weights: the part itself for the ideal ones, second order of an update."""
        return float(self.weigh_W * ((one[0] - other[0]) ** 2).sum() + self.weigh_V * ((one[1] - other[1]) ** 2).sum())

    def value(self, weights: tuple[Array, Array]) -> float:
        """Its part of V."""
        return self.distance((self.ideal.W, self.ideal.V), weights)

    def left(self, W: Array, V: Array, sigma: Array, x: Array, s: Array, error: Array) -> tuple[float, float]:
        """Leakage and remainder [W]: x (nx,), sigma (h,), s and `Psi - Psi_hat` (m,) as the network sees them."""
        Wt, Vt, w = self.ideal.W - W, self.ideal.V - V, error
        slope = sigma * (1 - sigma) if self.sigmoid else np.zeros_like(sigma)
        if self.weigh_V > 0:
            w = w - W.T @ (slope * (Vt.T @ x))
        if self.weigh_W > 0:
            w = w - Wt.T @ (sigma - slope * (V.T @ x))
        inner = (Wt * W).sum() * (self.weigh_W > 0) + (Vt * V).sum() * (self.weigh_V > 0)
        return self.c * self.leakage * float(np.sqrt(s @ s) * inner), self.c * float(s @ w)


def network_part(
    subject: Subject, learner: NetworkLearner, ideal: dict[int, Ideal], at: IntArray, progress: Progress = None
) -> WeightsPart:
    """The part at some rows of a run, (k,) ascending, for ideal weights of every network."""
    ledger = Ledger(subject, learner, ideal, at)
    missed = step_again(learner, subject.rows, ledger.before, ledger.after, progress)
    value, leakage, remainder, step, projection = ledger.found[:, at]
    terms, arrived = {"leakage": leakage, "remainder": remainder}, {"step": step, "projection": projection}
    return WeightsPart(value, terms, arrived, missed)


class Ledger:
    """What every sample does to the part.

    The output of a sample uses the weights from before its step, or from after it (Appendix B). So a sample has weights
    that it uses, and would have without the projection.

    Args:
        subject: The run.
        learner: Its learner.
        ideal: Ideal weights of its networks.
        at: (k,) the rows that are asked for.

    Attributes:
        found: (5, rows) value, leakage, remainder, step, projection of the rows that are asked for.
    """

    def __init__(self, subject: Subject, learner: NetworkLearner, ideal: dict[int, Ideal], at: IntArray) -> None:
        self.psi, self.h, self.wanted = subject.signal("psi"), learner.context.control_period, set(at.tolist())
        self.networks = {i: Network(learner, i, part, ideal[i]) for i, part in learner.networks}
        self.first, self.found = learner.own.update == "before_output", np.zeros((5, len(subject.rows)))
        self.last = self.weights(learner.start)
        self.freed: Weights | None = None
        self.free: LearnerStepper | None = None
        if learner.own.projection is not None:
            free = replace(learner, controller=replace(learner.controller, projection=None))
            self.free = LearnerStepper(free, learner.start.snapshot())

    def weights(self, state: ControllerState) -> Weights:
        """W and V of every network in a state, copies."""
        return {i: (state[f"W{i}"].copy(), state[f"V{i}"].copy()) for i in self.networks}

    def before(self, n: int, row: Array, stepper: LearnerStepper) -> tuple[Weights, Weights | None]:
        """Weights that a sample begins with, and that it ends with without the projection."""
        began, freed = self.weights(stepper.state), None
        if self.free is not None and n + (not self.first) in self.wanted:
            self.free.state.values[:] = stepper.state.values
            self.free.step(row)
            freed = self.weights(self.free.state)
        return began, freed

    def after(self, n: int, row: Array, stepper: LearnerStepper, kept: tuple[Weights, Weights | None]) -> None:
        """Value and terms of a sample; an update counts where its weights are used."""
        (used, freed), arrived, state = kept, self.freed, stepper.state
        if self.first:
            used, arrived = self.weights(state), freed
        for i, network in self.networks.items() if n in self.wanted else ():
            error = (self.psi[n] - stepper.psi_hat)[network.part] / network.scale_out
            left = network.left(*used[i], state[f"sigma{i}"], state["x"], state[f"s{i}"], error)
            taken = used[i] if arrived is None else arrived[i]
            self.found[:, n] += (
                network.value(used[i]),
                *left,
                network.distance(taken, self.last[i]) / self.h,
                (network.value(used[i]) - network.value(taken)) / self.h,
            )
        self.last, self.freed = used, freed
