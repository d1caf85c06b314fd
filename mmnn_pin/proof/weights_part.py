"""The weights' part of the Lyapunov function (3.53), `tr(Wt' F^-1 Wt)/2 + tr(Vt' G^-1 Vt)/2`, along a run.

`Wt = W* - W`, `Vt = V* - V` with the ideal weights of `ideal`. Rates per control sample are `F/h` per second, and
scaled networks (see `Neural.network_scales`) see `s' Psi` divided by c, so that the part of one network is

    c h / (2 F dt) |Wt|_F^2 + c h / (2 G dt) |Vt|_F^2        dt = 1 for rates per sample, h for rates per second

Along a run `s' (Psi - Psi_hat) + d/dt` of it is what learning leaves: with the error taken apart as

    Psi - Psi_hat = Wt' (sigma - sigma' V' x) + W' sigma' Vt' x + w,    w = Wt' sigma' V*' x + W*' O(Vt' x)^2 + eps

the update cancels all but `s' w + kappa |s| tr(Zt' Z)` (3.54). The learner is stepped again over the recorded rows,
which gives its weights at every sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..signals import Array, IntArray
from ..torque.neural import TwoLayer
from .ideal import Ideal
from .learner import Stepper
from .networks import Networks

LOST = 1e-3  # relative difference of Psi_hat beyond which stepping again makes no sense


@dataclass(frozen=True, eq=False)
class WeightsPart:
    """The weights' part at (k,) rows, all networks together, and what learning leaves of its derivative.

    Attributes:
        value: The part itself.
        leakage: `kappa |s| tr(Zt' Z)` [W].
        remainder: `s' w` [W].
        step: Second order of the update that led to the row, `|dW|^2 / (2 F)` and so on, over the period [W].
        missed: Largest difference between the Psi_hat of these steps and the recorded one, relative to the largest; one
            beyond `LOST` ends the steps, and the rest is 0.
        cut: What updates that are cut leave of `s' Y theta_tilde` [W]; of an adaptive controller, else 0.
    """

    value: Array
    leakage: Array
    remainder: Array
    step: Array
    missed: float
    cut: Array | float = 0.0


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
        controller, h = learner.controller, learner.wiring.control_period
        rate_W, rate_V, leakage = controller.network.rates(i - 1, controller.leakage)
        scale_in, scale_out = (scale[part] for scale in controller.network_scales(learner.wiring.layout))
        c, dt = float((scale_out / scale_in)[0]), 1.0 if controller.rates == "per_sample" else h
        both = isinstance(controller.network, TwoLayer)
        rates = [rate if controller.learning and learned else 0.0 for rate, learned in ((rate_W, True), (rate_V, both))]
        weigh_W, weigh_V = (c * h / (2 * rate * dt) if rate > 0 else 0.0 for rate in rates)
        return cls(ideal, part, leakage if any(rates) else 0.0, weigh_W, weigh_V, both, c, scale_out)

    def value(self, W: Array, V: Array) -> float:
        """Its part of V."""
        return float(self.weigh_W * ((self.ideal.W - W) ** 2).sum() + self.weigh_V * ((self.ideal.V - V) ** 2).sum())

    def left(self, W: Array, V: Array, sigma: Array, x: Array, s: Array, psi: Array) -> tuple[float, float]:
        """Leakage and remainder [W]: x (nx,), sigma (h,), s and psi (m,) as the network sees them."""
        Wt, Vt = self.ideal.W - W, self.ideal.V - V
        w = psi - W.T @ sigma
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


def weights_part(
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
    layout, controller, h = learner.wiring.layout, learner.controller, learner.wiring.control_period
    stepper = Stepper(learner, learner.start.snapshot())
    memory, first = stepper.memory, controller.update == "before_output"
    networks = {i: Network.of(learner, i, part, ideal[i]) for i, part in learner.networks}
    psi, recorded = layout.where("psi"), rows[:, layout.where("psi_hat")]
    largest = float(np.abs(recorded).max())
    wanted, found, missed = set(at.tolist()), np.zeros((4, len(at))), 0.0
    weights = {i: (memory[f"W{i}"], memory[f"V{i}"]) for i in networks}
    seen = {i: (memory[f"sigma{i}"], memory["x"], memory[f"s{i}"]) for i in networks}
    before = {i: (W.copy(), V.copy()) for i, (W, V) in weights.items()}
    k = 0
    for n, row in enumerate(rows):
        # weights that this sample's output uses: those from before the step, or from after it (Appendix B)
        look = n in wanted
        used = {i: (W.copy(), V.copy()) for i, (W, V) in weights.items()} if not first else {}
        missed = float(np.maximum(missed, np.abs(stepper.step(row) - recorded[n]).max()))
        if missed > LOST * largest:  # these are not the weights of the run
            break
        if first and (look or n + 1 in wanted):
            used = {i: (W.copy(), V.copy()) for i, (W, V) in weights.items()}
        if look:
            for i, network in networks.items():
                W, V = used[i]
                sigma, x, s = seen[i]
                found[0, k] += network.value(W, V)
                left = network.left(W, V, sigma, x, s, row[psi][network.part] / network.scale_out)
                found[1:3, k] += left
                found[3, k] += network.step(W, V, *before[i]) / h
            k += 1
        before = used or before
        if progress is not None and n % 500 == 0:
            progress(n / len(rows))
    missed = missed if np.isfinite(missed) else np.inf
    value, leakage, remainder, step = found
    return WeightsPart(value, leakage, remainder, step, missed / largest if largest else missed)
