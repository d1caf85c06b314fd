"""The weights' part of a two- or one-layer network (3.53), `tr(Wt' F^-1 Wt)/2 + tr(Vt' G^-1 Vt)/2`, along a run.

`Wt = W* - W`, `Vt = V* - V` with the ideal weights of `ideal`. Rates per control sample are `F/h` per second, and
scaled networks (see `Neural.network_scales`) see `s' Psi` divided by c, so that the part of one network is

    c h / (2 F dt) |Wt|_F^2 + c h / (2 G dt) |Vt|_F^2        dt = 1 for rates per sample, h for rates per second

Along a run `s' (Psi - Psi_hat) + d/dt` of it is what learning leaves: with the error taken apart as

    Psi - Psi_hat = Wt' (sigma - sigma' V' x) + W' sigma' Vt' x + w,    w = Wt' sigma' V*' x + W*' O(Vt' x)^2 + eps

the update cancels all but `s' w + kappa |s| tr(Zt' Z)` (3.54). A network on a nominal model (`two_layer_residual`) has
`Psi - Psi_0` in the place of Psi, and nothing else changes. One that also learns from filtered torque
(`two_layer_composite`) moves its weights a second time in every sample: what that does to the part is the term
`prediction`, the difference of the part before and after, of either sign, as the prediction error is not linear in V.
Where weights are scaled back onto a bound (`Neural.projection`), that difference is the term `projection`: the same
sample once more without the bound tells it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...signals import Array, IntArray
from ...torque.controller import ControllerState
from ...torque.law import estimate
from ...torque.two_layer import TwoLayer
from .ideal import Ideal
from .learner import Networks, Stepper
from .weights_part import Missed, WeightsPart

Weights = dict[int, tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
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

    ideal: Ideal
    part: slice
    leakage: float
    weigh_W: float
    weigh_V: float
    sigmoid: bool
    c: float
    scale_out: Array

    @classmethod
    def of(cls, learner: Networks, i: int, part: slice, ideal: Ideal) -> Network:
        """The i-th network of a learner."""
        controller, h = learner.own, learner.context.control_period
        rate_W, rate_V, leakage = controller.network.rates(i - 1, controller.leakage)
        scale_in, scale_out = (scale[part] for scale in controller.network_scales(learner.context.layout))
        c, dt = float((scale_out / scale_in)[0]), 1.0 if controller.rates == "per_sample" else h
        both = isinstance(controller.network, TwoLayer)
        rates = [rate if controller.learning and learned else 0.0 for rate, learned in ((rate_W, True), (rate_V, both))]
        weigh_W, weigh_V = (c * h / (2 * rate * dt) if rate > 0 else 0.0 for rate in rates)
        return cls(ideal, part, leakage if any(rates) else 0.0, weigh_W, weigh_V, both, c, scale_out)

    def value(self, W: Array, V: Array) -> float:
        """Its part of V."""
        return float(self.weigh_W * ((self.ideal.W - W) ** 2).sum() + self.weigh_V * ((self.ideal.V - V) ** 2).sum())

    def left(self, W: Array, V: Array, sigma: Array, x: Array, s: Array, error: Array) -> tuple[float, float]:
        """Leakage and remainder [W]: x (nx,), sigma (h,), s and `Psi - Psi_hat` (m,) as the network sees them."""
        Wt, Vt = self.ideal.W - W, self.ideal.V - V
        w = error
        slope = sigma * (1 - sigma) if self.sigmoid else np.zeros_like(sigma)
        if self.weigh_V > 0:
            w = w - W.T @ (slope * (Vt.T @ x))
        if self.weigh_W > 0:
            w = w - Wt.T @ (sigma - slope * (V.T @ x))
        inner = (Wt * W).sum() * (self.weigh_W > 0) + (Vt * V).sum() * (self.weigh_V > 0)
        return self.c * self.leakage * float(np.sqrt(s @ s) * inner), self.c * float(s @ w)

    def step(self, W: Array, V: Array, W_before: Array, V_before: Array) -> float:
        """Second order of an update."""
        return float(self.weigh_W * ((W - W_before) ** 2).sum() + self.weigh_V * ((V - V_before) ** 2).sum())


def network_part(
    learner: Networks,
    ideal: dict[int, Ideal],
    rows: Array,
    at: IntArray,
    progress: Callable[[float], None] | None = None,
) -> WeightsPart:
    """The weights' part at some rows of a run.

    Args:
        learner: The learner.
        ideal: Ideal weights of its networks.
        rows: (N, width) all rows of the run.
        at: (k,) which of them, ascending.
        progress: Called now and then with the fraction done.
    """
    layout, controller, h = learner.context.layout, learner.own, learner.context.control_period
    stepper = Stepper(learner, learner.start.snapshot())
    state, first = stepper.state, controller.update == "before_output"
    networks = {i: Network.of(learner, i, part, ideal[i]) for i, part in learner.networks}
    replayed, unbounded = Replayed.of(stepper), Unbounded.of(learner)
    psi, missed, wanted = layout.where("psi"), Missed(rows[:, layout.where("psi_hat")]), set(at.tolist())
    value, leakage, remainder, step, prediction, projection = np.zeros((6, len(at)))
    weights = views(networks, state)
    seen = {i: (state[f"sigma{i}"], state["x"], state[f"s{i}"]) for i in networks}
    before = copied(weights)
    free: Weights | None = None
    k = 0
    for n, row in enumerate(rows):
        # weights that this sample's output uses: those from before the step, or from after it (Appendix B); those of
        # a prediction error are changed ahead of the output
        look = n in wanted
        moved = copied(weights)
        used = moved if replayed is None or first else replayed.step(row, state, networks)
        arrived, free = free, None
        if unbounded is not None and (n if first else n + 1) in wanted:
            free = unbounded.step(row, state, networks)
        psi_hat = stepper.step(row)
        if missed.lost(n, psi_hat):
            break
        if first and (look or n + 1 in wanted):
            used = copied(weights)
            arrived = free
        if look:
            for i, network in networks.items():
                W, V = used[i]
                sigma, x, s = seen[i]
                value[k] += network.value(W, V)
                error = (row[psi] - psi_hat)[network.part] / network.scale_out
                left = network.left(W, V, sigma, x, s, error)
                leakage[k] += left[0]
                remainder[k] += left[1]
                end = moved[i] if not first else used[i]
                taken = end if arrived is None else arrived[i]
                step[k] += network.step(*taken, *before[i]) / h
                projection[k] += (network.value(*end) - network.value(*taken)) / h
                prediction[k] += (network.value(W, V) - network.value(*end)) / h
            k += 1
        before = used
        if progress is not None and n % 500 == 0:
            progress(n / len(rows))
    terms, led = {"leakage": leakage, "remainder": remainder}, {"step": step, "prediction": prediction}
    return WeightsPart(value, terms, {**led, "projection": projection}, missed.share)


@dataclass(frozen=True, eq=False)
class Unbounded:
    """A learner whose weights are bounded by a projection, stepped without it.

    Attributes:
        stepper: The learner without it.
    """

    stepper: Stepper

    @classmethod
    def of(cls, learner: Networks) -> Unbounded | None:
        """None for a learner without a projection."""
        if learner.own.projection is None:
            return None
        controller: Any = learner.controller
        free = replace(learner, controller=replace(controller, projection=None))
        return cls(Stepper(free, learner.start.snapshot()))

    def step(self, row: Array, state: ControllerState, networks: dict[int, Network]) -> Weights:
        """The weights after a row, from the state before its step."""
        self.stepper.state.values[:] = state.values
        self.stepper.step(row)
        return copied(views(networks, self.stepper.state))


@dataclass(frozen=True, eq=False)
class Replayed:
    """The prediction error of a composite network, done once more beside the learner.

    Attributes:
        stepper: The learner, about to be stepped.
        state: What its state is after the prediction error of a sample, and before its output.
    """

    stepper: Stepper
    state: ControllerState

    @classmethod
    def of(cls, stepper: Stepper) -> Replayed | None:
        """None for a network without a prediction error."""
        return None if stepper.torque.learner is None else cls(stepper, stepper.state.snapshot())

    def step(self, row: Array, state: ControllerState, networks: dict[int, Network]) -> Weights:
        """The weights that the output of a row uses, from the state before its step."""
        torque = self.stepper.torque
        self.state.values[:] = state.values
        estimate(row, torque.at, torque.learner, self.state.values)
        return copied(views(networks, self.state))


def views(networks: dict[int, Network], state: ControllerState) -> Weights:
    """W and V of every network, as they are in a state."""
    return {i: (state[f"W{i}"], state[f"V{i}"]) for i in networks}


def copied(weights: Weights) -> Weights:
    """The same, as copies."""
    return {i: (W.copy(), V.copy()) for i, (W, V) in weights.items()}
