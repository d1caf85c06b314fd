"""The thesis's two-layer network: its arithmetic, its update law and its settings. It knows no robot.

    Psi_hat = W' sigma(V' x),      sigma(a) = 1 / (1 + exp(-a))                                          (3.23)-(3.28)
    W' = F sigma s' - F sigma' V'x s' - kappa F |s| W                                                           (3.48)
    V' = G x (sigma'' W s)' - kappa G |s| V                                                                     (3.49)

with `sigma' = diag(sigma) (I - diag(sigma))` and `sigma''` its transpose: the network of Lewis with e-modification. The
base has one and the arm another; `torque.neural` makes the controller of them, `torque.law` calls them at every sample.
Weights are updated in place; `s` is the error that drives the learning (z or r).
"""

from __future__ import annotations

import math
from typing import ClassVar, Literal

import numpy as np

from ..compiled import compiled, internal
from ..elementary import sigmoids
from ..errors import ConfigError
from ..settings import Settings, require_at_most, require_gains
from ..signals import Array

TWO_LAYER = 2  # kind of law
MOST_HIDDEN = 10_000  # hidden units of a network


class TwoLayer(Settings, frozen=True):
    """Two-layer network with sigmoid units; both layers learn (3.23)-(3.28), (3.48), (3.49).

    Args:
        hidden: Hidden units per network.
        F: Rates of the output weights, (base, arm).
        G: Rates of the hidden weights, (base, arm).
        kappa: Leakage, e-modification.
        initial: "random" draws V uniform in +-v_range and sets W = 0 (Lewis's practice); "zero" is the thesis's
            section 5.2 and keeps both layers at rank one for ever.
        v_range: Half-width of the initial V.

    Raises:
        ConfigError: A rate is negative or not finite, or there are no hidden units or too many.
    """

    hidden: int = 22
    F: tuple[float, float] = (1.0, 0.2)
    G: tuple[float, float] = (1.0, 0.2)
    kappa: float = 1.0
    initial: Literal["random", "zero"] = "random"
    v_range: float = 1.0

    kind: ClassVar[int] = TWO_LAYER
    name: ClassVar[str] = "two_layer"
    hidden_learns: ClassVar[bool] = True

    def __post_init__(self) -> None:
        require_hidden(self, self.hidden, "two_layer")
        require_gains(self, "two_layer", "F", "G", "kappa", "v_range")
        require_width(self.v_range, "two_layer.v_range")

    def rates(self, which: int, leakage: bool) -> tuple[float, float, float]:
        """Rate of W, rate of V, leakage of the base's (0) or the arm's (1) network."""
        return self.F[which], self.G[which], self.kappa if leakage else 0.0

    def initialise(self, W: Array, V: Array, rng: np.random.Generator) -> None:
        """Initial weights, in place."""
        W[:] = 0.0
        V[:] = rng.uniform(-self.v_range, self.v_range, V.shape) if self.initial == "random" else 0.0


@internal
def two_layer_output(W: Array, V: Array, x: Array, net: Array, sigma: Array, psi_hat: Array) -> float:
    """Output `Psi_hat = W' sigma(V' x)` (3.25).

    Args:
        W: (h, m) output weights.
        V: (nx, h) hidden weights.
        x: (nx,) input.
        net: (h,) written: `V' x`.
        sigma: (h,) written: hidden outputs.
        psi_hat: (m,) written.

    Returns:
        The norm of the weights, `(|W|_F^2 + |V|_F^2)^(1/2)`.
    """
    hidden_input(V, x, net)
    squares = sum_of_squares(V, sigma)
    sigmoids(net, sigma)
    return math.sqrt(squares + weighted_sum(W, sigma, psi_hat))


@compiled
def hidden_input(V: Array, x: Array, net: Array) -> None:
    """`V' x` for V (nx, h), written to net (h,); two rows at a time, so that net is read and written half as often."""
    for j in range(net.size):
        net[j] = 0.0
    paired = x.size - x.size % 2
    for i in range(0, paired, 2):
        for j in range(net.size):
            net[j] += V[i, j] * x[i] + V[i + 1, j] * x[i + 1]
    for i in range(paired, x.size):
        for j in range(net.size):
            net[j] += V[i, j] * x[i]


@compiled
def sum_of_squares(V: Array, scratch: Array) -> float:
    """`|V|_F^2` for V (nx, h); one sum per column in scratch (h,): the processor works on several at a time."""
    for j in range(scratch.size):
        scratch[j] = 0.0
    paired = V.shape[0] - V.shape[0] % 2
    for i in range(0, paired, 2):
        for j in range(scratch.size):
            one, other = V[i, j], V[i + 1, j]
            scratch[j] += one * one + other * other
    for i in range(paired, V.shape[0]):
        for j in range(scratch.size):
            scratch[j] += V[i, j] * V[i, j]
    total = 0.0
    for j in range(scratch.size):
        total += scratch[j]
    return total


@compiled
def weighted_sum(W: Array, sigma: Array, psi_hat: Array) -> float:
    """`W' sigma` for W (h, m), written to psi_hat (m,), and the sum of the squares of W."""
    squares = 0.0
    for i in range(psi_hat.size):
        total = 0.0
        for j in range(sigma.size):
            total += W[j, i] * sigma[j]
            squares += W[j, i] * W[j, i]
        psi_hat[i] = total
    return squares


@internal
def two_layer_update(W: Array, V: Array, x: Array, net: Array, sigma: Array, s: Array, rates: Array, dt: float) -> None:
    """One step of the update law (3.48), (3.49), both lines with the weights as they were before.

    Args:
        W: (h, m) updated.
        V: (nx, h) updated.
        x: (nx,) input.
        net: (h,) `V' x`.
        sigma: (h,) hidden outputs.
        s: (m,) error.
        rates: F of W, G of V, kappa of the leakage (e-modification); what follows them is not read.
        dt: 1 for rates per sample (Appendix B), the control period for rates per second.
    """
    F, G, kappa, norm = rates[0], rates[1], rates[2], 0.0
    for i in range(s.size):
        norm += s[i] * s[i]
    leak = kappa * math.sqrt(norm)
    keep_W, keep_V = 1.0 - dt * F * leak, 1.0 - dt * G * leak
    for j in range(sigma.size):
        slope = sigma[j] * (1.0 - sigma[j])
        gain, back = dt * F * (sigma[j] - slope * net[j]), 0.0
        for i in range(s.size):
            back += W[j, i] * s[i]
            W[j, i] = keep_W * W[j, i] + gain * s[i]
        net[j] = slope * back  # from here on sigma'' W s
    for i in range(x.size):
        gain = dt * G * x[i]
        for j in range(sigma.size):
            V[i, j] = keep_V * V[i, j] + gain * net[j]


@internal
def two_layer_answer(W: Array, x: Array, net: Array, sigma: Array, s: Array, rates: Array) -> float:
    """Answer of an update to s, to first order, `s' (Psi_hat_next - Psi_hat)`, for dt = 1 and without leakage.

    `(F sigma' (sigma - sigma' V'x) s's + G x'x |sigma' W s|^2`; arguments as in `two_layer_update`, nothing changes.
    """
    outer, inner, inputs, squares = 0.0, 0.0, 0.0, 0.0
    for i in range(s.size):
        squares += s[i] * s[i]
    for i in range(x.size):
        inputs += x[i] * x[i]
    for j in range(sigma.size):
        slope, back = sigma[j] * (1.0 - sigma[j]), 0.0
        for i in range(s.size):
            back += W[j, i] * s[i]
        outer += sigma[j] * (sigma[j] - slope * net[j])
        inner += slope * back * slope * back
    return rates[0] * outer * squares + rates[1] * inputs * inner


@compiled
def project(A: Array, radius: float) -> None:
    """A onto the ball |A|_F <= radius, in place; inf leaves it as it is.

    The nearest point of a ball is not farther from any point within it, so with ideal weights there
    `tr(Wt' F^-1 Wt)` never grows by it (projection of adaptive control: Ioannou and Sun 1996, Robust Adaptive Control).
    """
    if radius < math.inf:
        square = 0.0
        for i in range(A.shape[0]):
            for j in range(A.shape[1]):
                square += A[i, j] * A[i, j]
        shrink(A, square, radius)


@compiled
def shrink(A: Array, square: float, radius: float) -> None:
    """A into a ball, given the square of its norm there; zero where that is no number."""
    if square <= radius * radius:
        return
    share = radius / math.sqrt(square) if math.isfinite(square) else 0.0
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            A[i, j] = share * A[i, j] if share > 0.0 else 0.0


def numerical_rank(W: Array, tolerance: float = 1e-9) -> int:
    """Number of singular values above `tolerance` times the largest; 0 for a zero matrix.

    Weights that start from zero keep rank one for ever: all hidden units of the network stay equal.
    """
    singular = np.linalg.svd(np.asarray(W), compute_uv=False)
    return int(np.sum(singular > tolerance * singular[0])) if singular.size and singular[0] > 0 else 0


def require_hidden(network: Settings, hidden: int, section: str) -> None:
    """Refuse a network without hidden units, and one too large for any machine (`ConfigError`)."""
    if hidden < 1:
        raise ConfigError(f"{hidden} hidden units", fix="use at least one", key=f"{section}.hidden")
    require_at_most(network, section, {"hidden": MOST_HIDDEN})


def require_width(half: float, key: str) -> None:
    """Refuse a range from -half to half whose width is not finite (`ConfigError`)."""
    if not np.isfinite(2 * half):
        raise ConfigError(f"{half}", why="the range's width is no finite number", fix="use a smaller one", key=key)
