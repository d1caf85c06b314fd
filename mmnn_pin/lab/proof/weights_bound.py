"""How large the weights of a learner may become, updated once per control period (docs/theory.md, section 3).

With `y = kappa F |s|`, F per sample, one update of the output weights is `W <- (1 - y) W + F phi s'`, where

    phi = sigma - sigma' V'x  in (0, 1) for every unit: `a -> sigma(a) - a sigma'(a)` rises from 0 to 1,

so that `|W| <= max(|W(0)|, c(y) sqrt(h)/kappa)` for ever, `c = 1` while y <= 1 and `y / (2 - y)` below 2; from y = 2 on
nothing holds it. A one-layer network has the Gaussians in (0, 1] for phi. The hidden weights follow, as
`|x (sigma'' W s)'| <= |x| |W| |s| / 4`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...signals import Array
from ...torque.two_layer import TwoLayer
from .learner import Networks


@dataclass(frozen=True, eq=False)
class WeightsBound:
    """Bounds on one network's weights and output.

    Attributes:
        leak: Largest y = kappa F |s| per sample, of W.
        leak_V: The same of V, with G; 0 for a one-layer network.
        W: Largest |W|_F; inf where there is no bound.
        V: Largest |V|_F of hidden weights that learn; 0 where they are fixed.
        output: (m,) largest |Psi_hat| [N, N m].
        why: What holds the weights, in words.
        projected: Whether a projection does, whatever `leak` is.
    """

    leak: float
    leak_V: float
    W: float
    V: float
    output: Array
    why: str
    projected: bool = False

    @property
    def norm(self) -> float:
        """Largest |Z|_F of the weights that learn."""
        return math.hypot(self.W, self.V)


def weights_bound(learner: Networks, i: int, s: Array, x: float, projection: float | None = None) -> WeightsBound:
    """Bounds for the i-th network (1 the base's, 2 the arm's).

    Args:
        learner: The learner.
        i: Which network.
        s: (p,) largest |s_i| at any control sample.
        x: Largest norm of the networks' input; may be inf.
        projection: Largest norm that a supervisor scales every array of weights back to, None without one.
    """
    controller, layout = learner.own, learner.context.layout
    part = dict(learner.networks)[i]
    two_layer = isinstance(controller.network, TwoLayer)
    per = 1.0 if controller.rates == "per_sample" else learner.context.control_period
    rate, rate_V, kappa = controller.network.rates(i - 1, controller.leakage)
    scale_in, scale_out = (scale[part] for scale in controller.network_scales(layout))
    size = float(np.linalg.norm(scale_in * s[part]))
    hidden = math.sqrt(controller.network.hidden)
    W0, V0 = (float(np.linalg.norm(learner.start[f"{letter}{i}"])) for letter in "WV")
    if not controller.learning:
        return WeightsBound(0, 0, W0, V0 * two_layer, scale_out * W0 * hidden, "they are held fixed")
    leak, leak_V = kappa * per * rate * size, kappa * per * rate_V * size * two_layer
    W = max(W0, growth(leak) * hidden / kappa) if kappa > 0 else math.inf
    V = max(V0, growth(leak_V) * x * W / (4 * kappa)) if kappa > 0 else math.inf
    why = "e-modification" if kappa > 0 else "nothing: there is no leakage"
    radii = [min(radius, math.inf if projection is None else projection) for radius in controller.radii(layout)[i]]
    projected = math.isfinite(radii[0])
    if projected:
        W, V = min(W, max(W0, radii[0])), min(V, max(V0, radii[1]))
        why = f"{why}, projection" if kappa > 0 else "projection"
    output = scale_out * W * hidden
    return WeightsBound(leak, leak_V, W, V if two_layer else 0.0, output, why, projected)


def growth(y: float) -> float:
    """C with `|W| <= c a / kappa` for updates `W <- (1 - y) W + (y/kappa) phi`, |phi| <= a; inf from y = 2 on."""
    if y <= 1:
        return 1.0
    return y / (2 - y) if y < 2 else math.inf
