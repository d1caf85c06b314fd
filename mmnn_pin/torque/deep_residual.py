"""A deep residual network of which all layers learn: the successor of the thesis's network.

    kappa_0 = V'x,   kappa_b+1 = kappa_b + B_b' tanh(A_b' kappa_b),   Psi_hat = c^1/2 K^1/2 u W' tanh(kappa_last)
    theta_hat' = proj(Gamma J(x, theta_hat)' (K/c)^1/2 s / u - leakage (W, B)),            J = d(W' tanh) / d theta

after Patil, Le, Griffis, Dixon 2024 (Lyapunov-Based Deep Residual Neural Network (ResNet) Adaptive Control,
arXiv:2404.07385); the first layer, which brings the inputs to the width of the blocks, as in Nino, Patil, Insinger,
Eisman, Dixon 2025 (arXiv:2503.14372). J is never formed: J's is one pass backward through the blocks. The base has one
network and the arm another, as in `torque.neural`; c is the mean of the network's gains K. The scales are a change of
coordinates in which every gain is 1, so one setting suits robots of any size. Blocks begin as their shortcuts, B = 0.

With ideal weights theta in the balls, theta~ = theta - theta_hat, and Psi within second order of theta~ (Taylor)

    V = s' M s / 2 + sum over networks u^2 c theta~' Gamma^-1 theta~ / 2,
    V' <= -s' K s + s' delta + sum over networks u^2 c leakage (W, B)~' Gamma^-1 (W, B)_hat,
    |delta| <= (what no such network can say) + u (c max K)^1/2 L |theta~|^2 / 2,

L a bound on the second derivative in the balls, which is finite as tanh is smooth. The paper's sign of s, which outdoes
delta and makes s go to zero, is left out: held for a control period it chatters. What is proved without it is a bound:
W' tanh is at most |W| hidden^1/2 whatever the other layers are, so Psi - Psi_hat is bounded, and s with it. Leakage
(sigma-modification: Ioannou and Kokotovic 1984), which the paper does not have, takes back what only noise and delays
have taught; of W and B, which begin at zero: V and A would lose what was drawn.

Sampling: a sample moves theta_hat by eta h Gamma J's. To first order Psi_hat answers s at the next one with a torque
against s of eta h g' Gamma g in the units above, g = J's, and eta keeps that below the share `answer` h of s' K s: the
network is an integral action of at most `answer` over K, and no faster than known delays permit. The second order is at
most L eta^2 h^2 |Gamma g|^2 |s| / 2, which is to the first as h |s| L max Gamma / 2 at most. The weights are bounded by
the balls, whatever is measured; the balls are in the metric of Gamma, so projection never raises V.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import compiled, internal, linked
from ..elementary import exp, tanh
from ..parts import Cube, Matrix, layout_of, views
from ..settings import Settings, require_at_most, require_numbers
from ..signals import INDEX, Array, IntArray
from .controller import Bears, CompiledController, Context, ControllerState, Feedback, Law
from .law import KERNELS, Kernels, constant_gain, input_of, nothing_to_keep
from .neural import SEEN, channels
from .two_layer import hidden_input, require_hidden, shrink

Z, R, PSI_HAT = INDEX["z"], INDEX["r"], INDEX["psi_hat"]
EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["effective_gain"], INDEX["weight_norm"]


class DeepResidualSettings(Settings, frozen=True):
    """How a deep residual network learns; measured by the feedback, so one set suits robots of any size.

    Args:
        hidden: Width of the blocks.
        blocks: Residual blocks of every network; 0 for a network of two layers.
        rate: Of the output weights: how fast they answer s, over K, where all units are at 1 [1/s].
        inner: Of all other weights, likewise for a unit of weight between input and output [1/s].
        leakage: How fast W and B are forgotten [1/s].
        answer: Fastest answer to s, over K; less with known delays [1/s].
        unit: Torque that counts as one, over K [m/s, rad/s].
        bound: Bound on |W| in units, and on the norm of all other weights.
        v_range: Half-width of the initial V and A.

    Raises:
        ConfigError: A number that is negative, not finite or 0 where it must not be, or a network that is too large.
    """

    hidden: int = 16
    blocks: int = 2
    rate: float = 1000.0
    inner: float = 1.0
    leakage: float = 0.5
    answer: float = 60.0
    unit: float = 0.1
    bound: float = 100.0
    v_range: float = 0.1

    def __post_init__(self) -> None:
        require_numbers(self, "deep_residual", ("answer", "unit", "bound"))
        require_hidden(self, self.hidden, "deep_residual")
        require_at_most(self, "deep_residual", {"hidden": 1000, "blocks": 100})


@by_address
class Deep(NamedTuple):
    """The numbers of the networks, and room to work in."""

    K: Array  # (p,) feedback gains
    scale_in: Array  # (p,) what s is multiplied with, `(K / c)^1/2 / u`
    scale_out: Array  # (p,) what outputs are multiplied with, `(K c)^1/2 u`
    rows: IntArray  # (nx,) where the inputs stand in a row
    inputs: Array  # (2, nx) or (3, nx) as of `LawNumbers`
    learning: bool  # off keeps the weights
    h: float  # control period [s]
    rates: Array  # (2,) Gamma of W, and of all other weights [1/s]
    keep: float  # what leakage leaves of W and B in a sample
    share: float  # largest answer of a sample to s, as a share of the feedback
    bound: float  # on |W|, and on the norm of all other weights
    x: Array  # (nx,) input of the last sample
    s: Array  # (p,) scaled error
    kappa: Array  # (blocks + 1, hidden) what goes into the blocks, and what comes out of the last
    units: Array  # (blocks + 1, hidden) tanh within the blocks, and of what comes out of the last
    back: Array  # (blocks + 1, hidden) derivative of `s' W' tanh` by kappa
    within: Array  # (blocks, hidden) and by `A' kappa`
    layout: IntArray  # of `Weights` in the state


class Weights(NamedTuple):
    """State: the weights of the base's (1) and the arm's (2) network, those of all blocks one after the other."""

    V1: Matrix
    A1: Cube
    B1: Cube
    W1: Matrix
    V2: Matrix
    A2: Cube
    B2: Cube
    W2: Matrix


class Layers(NamedTuple):
    """One network: V (nx, hidden), A and B (blocks, hidden, hidden), W (hidden, m)."""

    V: Array
    A: Array
    B: Array
    W: Array


weights_of = views(Weights)


@linked
def estimate(row: Array, at: IntArray, a: Deep, state: Array) -> None:
    """Psi_hat and gain of one sample, then the update of the weights; arguments as of `law.estimate`."""
    o, first = weights_of(state, a.layout), 0
    for i in range(a.x.size):
        a.x[i] = input_of(row[a.rows[i]], a.inputs, i)
    for which in range(2):
        begin, end = (at[Z], at[Z + 1]) if which == 0 else (at[R], at[R + 1])
        m = end - begin
        if m == 0:
            continue
        n = Layers(o.V1, o.A1, o.B1, o.W1) if which == 0 else Layers(o.V2, o.A2, o.B2, o.W2)
        s, psi_hat = a.s[first : first + m], row[at[PSI_HAT] + first : at[PSI_HAT] + first + m]
        forward(a, n, psi_hat)
        row[at[WEIGHT_NORM] + which] = math.sqrt(squares(n.W) + inner_squares(n))
        for i in range(m):
            s[i] = a.scale_in[first + i] * row[begin + i]
            psi_hat[i] *= a.scale_out[first + i]
            row[at[EFFECTIVE_GAIN] + first + i] = a.K[first + i]
        if a.learning:
            backward(a, n, s)
            learn(a, n, s)
        first += m


@internal
def forward(a: Deep, n: Layers, out: Array) -> None:
    """`W' tanh(kappa)` of the input a.x into out (m,); what goes through the blocks into a.kappa and a.units."""
    blocks = len(n.A)
    hidden_input(n.V, a.x, a.kappa[0])
    for b in range(blocks):
        hidden_input(n.A[b], a.kappa[b], a.units[b])
        for j in range(a.units.shape[1]):
            a.units[b, j] = tanh(a.units[b, j])
        hidden_input(n.B[b], a.units[b], a.kappa[b + 1])
        for j in range(a.units.shape[1]):
            a.kappa[b + 1, j] += a.kappa[b, j]
    for j in range(a.units.shape[1]):
        a.units[blocks, j] = tanh(a.kappa[blocks, j])
    hidden_input(n.W, a.units[blocks], out)


@internal
def backward(a: Deep, n: Layers, s: Array) -> None:
    """Derivatives of `s' W' tanh(kappa)` for a scaled error s (m,), through all blocks, into a.back and a.within."""
    blocks = len(n.A)
    through(n.W, s, a.units[blocks], a.back[blocks])
    for b in range(blocks - 1, -1, -1):
        through(n.B[b], a.back[b + 1], a.units[b], a.within[b])
        for j in range(a.units.shape[1]):
            a.back[b, j] = a.back[b + 1, j]
            for i in range(a.units.shape[1]):
                a.back[b, j] += n.A[b, j, i] * a.within[b, i]


@compiled
def through(M: Array, behind: Array, unit: Array, out: Array) -> None:
    """`(1 - unit^2) M behind` of M (h, m): a derivative (m,) behind M taken back through M and units (h,) of tanh."""
    for j in range(out.size):
        total = 0.0
        for i in range(behind.size):
            total += M[j, i] * behind[i]
        out[j] = (1.0 - unit[j] * unit[j]) * total


@internal
def learn(a: Deep, n: Layers, s: Array) -> None:
    """One sample of the law, its answer to s below a share of the feedback, and the weights back into their balls.

    Every derivative is a product of what enters a layer and what comes back to it; what is no number teaches nothing.
    """
    blocks, feedback = len(n.A), square(s)
    answer = a.rates[0] * square(a.units[blocks]) * feedback + a.rates[1] * square(a.x) * square(a.back[0])
    for b in range(blocks):
        answer += a.rates[1] * square(a.kappa[b]) * square(a.within[b])
        answer += a.rates[1] * square(a.units[b]) * square(a.back[b + 1])
    answer *= a.h
    if not (math.isfinite(answer) and math.isfinite(feedback)):
        return
    step = a.h * (a.share * feedback / answer if answer > a.share * feedback else 1.0)
    add(n.W, a.keep, step * a.rates[0], a.units[blocks], s)
    add(n.V, 1.0, step * a.rates[1], a.x, a.back[0])
    for b in range(blocks):
        add(n.A[b], 1.0, step * a.rates[1], a.kappa[b], a.within[b])
        add(n.B[b], a.keep, step * a.rates[1], a.units[b], a.back[b + 1])
    shrink(n.W, squares(n.W), a.bound)
    total = inner_squares(n)
    shrink(n.V, total, a.bound)
    for b in range(blocks):
        shrink(n.A[b], total, a.bound)
        shrink(n.B[b], total, a.bound)


@compiled
def square(v: Array) -> float:
    """`v' v`."""
    total = 0.0
    for i in range(v.size):
        total += v[i] * v[i]
    return total


@compiled
def squares(M: Array) -> float:
    """`|M|_F^2`."""
    total = 0.0
    for i in range(len(M)):
        total += square(M[i])
    return total


@compiled
def inner_squares(n: Layers) -> float:
    """The squares of all weights but W."""
    total = squares(n.V)
    for b in range(len(n.A)):
        total += squares(n.A[b]) + squares(n.B[b])
    return total


@compiled
def add(M: Array, keep: float, size: float, ahead: Array, behind: Array) -> None:
    """M becomes `keep M + size ahead behind'`."""
    for i in range(ahead.size):
        for j in range(behind.size):
            M[i, j] = keep * M[i, j] + size * ahead[i] * behind[j]


KERNELS[Deep] = Kernels(estimate, nothing_to_keep)


@dataclass(frozen=True, eq=False)
class DeepResidual(CompiledController):
    """`tau = K s + Psi_hat`, Psi_hat a deep residual network for the base and one for the arm."""

    feedback: Feedback = field(default_factory=Feedback)  # K
    settings: DeepResidualSettings = field(default_factory=DeepResidualSettings)  # sizes, rates and bounds
    learning: bool = True  # off keeps the weights
    name: str = "deep_residual"
    bears: Bears | None = None  # as of `CompiledController`

    within_limits: ClassVar[bool] = True

    def law(self, context: Context) -> Law:
        """The numbers of the law, with room of its own to work in; errors as of `positive_gains`."""
        K, layout, own = self.positive_gains(context.layout), context.layout, self.settings
        h = float(context.control_period)
        parts = (K[: layout.base], K[layout.base :])
        c = np.concatenate([np.full(part.size, part.mean()) for part in parts if part.size])
        inputs, room = SEEN.numbers(layout), (own.blocks + 1, own.hidden)
        deep = Deep(
            K=K,
            scale_in=np.sqrt(K / c) / own.unit,
            scale_out=np.sqrt(K * c) * own.unit,
            rows=SEEN.rows(layout),
            inputs=inputs,
            learning=self.learning,
            h=h,
            rates=np.array([own.rate / own.hidden, own.inner / own.hidden]),
            keep=exp(-own.leakage * h),
            share=self.answer(context, h * own.answer),
            bound=float(own.bound),
            x=np.zeros(inputs.shape[1]),
            s=np.zeros(K.size),
            kappa=np.zeros(room),
            units=np.zeros(room),
            back=np.zeros(room),
            within=np.zeros(room),
            layout=layout_of(Weights, self.shapes(context)),
        )
        return Law(constant_gain(K), deep)

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """The weights."""
        hidden, blocks, nx = self.settings.hidden, self.settings.blocks, SEEN.rows(context.layout).size
        found: dict[str, tuple[int, ...]] = {}
        for i, m in channels(context.layout):
            inner = (blocks, hidden, hidden)
            found |= {f"V{i}": (nx, hidden), f"A{i}": inner, f"B{i}": inner, f"W{i}": (hidden, m)}
        return found

    def init(self, context: Context) -> ControllerState:
        """V and A at random, B and W zero: the blocks are their shortcuts, and Psi_hat is zero."""
        state, half = super().init(context), self.settings.v_range
        for i, _ in channels(context.layout):
            for name in (f"V{i}", f"A{i}"):
                state[name] = context.rng.uniform(-half, half, state[name].shape)
        return state

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """V, A, B and W of the base's (1) and the arm's (2) network."""
        return {name: state[name] for name in state.shapes}

    def findings(self, state: ControllerState) -> list[str]:
        """Which weights ended on their bound."""
        if not np.isfinite(state.values).all():
            return []
        most, held = (1 - 1e-9) * self.settings.bound, []
        for i in (name[1:] for name in state.shapes if name[0] == "W"):
            inner = math.sqrt(sum(float(np.sum(state[f"{part}{i}"] ** 2)) for part in "VAB"))
            held += [f"W{i}"] * bool(np.linalg.norm(state[f"W{i}"]) >= most) + [f"V{i}, A{i}, B{i}"] * (inner >= most)
        return [f"{self.name}: {', '.join(held)} ended on deep_residual.bound"] if held else []
