"""The one-layer Gaussian network of Lin and Goldenberg: its arithmetic, its update law and its settings.

    Psi_hat = W' phi(x),      phi_j = exp(-|x - c_j|^2 / (2 width^2)),      W' = beta phi s' - mu beta |s| W

It is reference [9] of the thesis, which does not print the law: it is reconstructed from the names of its parameters.
The centres c_j stay; they stand where a two-layer network has its hidden weights V.
"""

from __future__ import annotations

import math
from typing import ClassVar, Literal

import numpy as np

from ..compiled import compiled, internal
from ..elementary import exp
from ..errors import ConfigError
from ..settings import Settings, require_gains
from ..signals import Array
from .two_layer import require_hidden, require_width, weighted_sum

ONE_LAYER = 3  # kind of law


class OneLayer(Settings, frozen=True):
    """One-layer network with fixed Gaussian units: reference [9] of the thesis, reconstructed.

    Args:
        hidden: Gaussian units per network.
        beta: Rates of the output weights, (base, arm).
        mu: Leakage.
        width: Width of the Gaussians.
        centre_range: Centres lie in [-centre_range, centre_range] in every input.
        centres: "diagonal" spaces them evenly along the diagonal of the input space, "random" draws them uniformly.

    Raises:
        ConfigError: A rate is negative or not finite, the width is not positive, or there are no units or too many.
    """

    hidden: int = 22
    beta: tuple[float, float] = (0.5, 0.5)
    mu: float = 0.35
    width: float = 4.5
    centre_range: float = 10.0
    centres: Literal["diagonal", "random"] = "diagonal"

    kind: ClassVar[int] = ONE_LAYER
    name: ClassVar[str] = "one_layer"
    hidden_learns: ClassVar[bool] = False

    def __post_init__(self) -> None:
        require_hidden(self, self.hidden, "one_layer")
        require_gains(self, "one_layer", "beta", "mu", "width", "centre_range")
        if self.width == 0:
            raise ConfigError("width 0", why="Gaussians need one", fix="use a number > 0", key="one_layer.width")
        require_width(self.centre_range, "one_layer.centre_range")

    def rates(self, which: int, leakage: bool) -> tuple[float, float, float]:
        """Rate of W, width, leakage of the base's (0) or the arm's (1) network."""
        return self.beta[which], self.width, self.mu if leakage else 0.0

    def initialise(self, W: Array, V: Array, rng: np.random.Generator) -> None:
        """Zero weights and the fixed centres, in place."""
        W[:] = 0.0
        if self.centres == "diagonal":
            V[:] = np.linspace(-self.centre_range, self.centre_range, V.shape[1])
        else:
            V[:] = rng.uniform(-self.centre_range, self.centre_range, V.shape)


@internal
def one_layer_output(W: Array, centres: Array, width: float, x: Array, phi: Array, psi_hat: Array) -> float:
    """Output `Psi_hat = W' phi(x)`, `phi_j = exp(-|x - c_j|^2 / (2 width^2))`.

    Args:
        W: (h, m) output weights.
        centres: (nx, h) centres of the Gaussians, fixed.
        width: Their common width.
        x: (nx,) input.
        phi: (h,) written: activations.
        psi_hat: (m,) written.

    Returns:
        The norm of the weights, `|W|_F`.
    """
    phi[:] = 0.0
    for i in range(x.size):
        for j in range(phi.size):
            away = x[i] - centres[i, j]
            phi[j] += away * away
    for j in range(phi.size):
        phi[j] = exp(-phi[j] / (2.0 * width * width))
    return math.sqrt(weighted_sum(W, phi, psi_hat))


@compiled
def one_layer_answer(phi: Array, s: Array, beta: float) -> float:
    """Answer of an update to s, `s' (Psi_hat_next - Psi_hat) = beta phi'phi s's`, for dt = 1, without leakage."""
    units, squares = 0.0, 0.0
    for j in range(phi.size):
        units += phi[j] * phi[j]
    for i in range(s.size):
        squares += s[i] * s[i]
    return beta * units * squares


@internal
def one_layer_update(W: Array, phi: Array, s: Array, beta: float, mu: float, dt: float) -> None:
    """One step of `Wdot = beta phi s' - mu beta |s| W` (reconstructed); shapes as in `one_layer_output`."""
    norm = 0.0
    for i in range(s.size):
        norm += s[i] * s[i]
    leak = mu * math.sqrt(norm)
    for j in range(phi.size):
        for i in range(s.size):
            W[j, i] += dt * beta * (phi[j] * s[i] - leak * W[j, i])
