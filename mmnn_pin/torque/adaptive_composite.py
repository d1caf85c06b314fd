"""Composite adaptive control: `torque.adaptive` with the prediction error of filtered torque beside that of tracking.

The filtered regressor and torque of `torque.filtered` obey `Y_f theta = y_f` whatever the motion, so what they leave,
`y_f - Y_f theta_hat`, tells of theta without any tracking error. Kreisselmeier's integrals (1977, IEEE TAC 22(1))

    Q' = (Y_f' R Y_f - Q) / T,      b' = (Y_f' R y_f - b) / T,      so that      b - Q theta_hat = Q (theta - theta_hat)

keep what has been seen for a time T. With R = K^-1 a torque counts as the velocity error that it costs under the
feedback, `Q theta_tilde` has the unit of `Y' s`, and one factor c suits newtons and newton metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Self

import msgspec
import numpy as np

from ..by_address import by_address
from ..compiled import compiled, internal, linked
from ..elementary import exp
from ..model.regressor import measured, regress
from ..parts import Matrix, Vector, layout_of, views
from ..settings import Settings, plain, require_numbers
from ..signals import Array, IntArray
from .adaptive import Adaptation, Adaptive, Estimate, adapt, look
from .controller import Context, ControllerSettings, ControllerState, Law, Told
from .filtered import Filter, Filtered, low_pass, new_filter, parts, period, remember
from .law import KERNELS, Kernels, constant_gain
from .pseudo_inertia import LARGEST, Bodies, factor, inform, move, sandwich, to_matrix, to_vector, transposed_sandwich

ITERATIONS = 12  # of conjugate gradients in a step
ENOUGH = 1e-8  # share of the residual's square at which they end


class AdaptiveCompositeSettings(Settings, frozen=True):
    """The prediction error's term of a composite adaptive controller.

    Args:
        weight: c, its factor; dimensionless. Large is safe: a step never overshoots.
        tracking: a, the factor on the gradient of the tracking error, which is 1 without a prediction error.
        pole: Of the low-pass of regressor and torque [1/s].
        forgetting_time: T, how long samples count [s].
        every: Time between two steps [s].

    Raises:
        ConfigError: A number that is negative or not finite, or a forgetting time or period of 0.
    """

    weight: float = 1000.0
    tracking: float = 0.1
    pole: float = 3.0
    forgetting_time: float = 30.0
    every: float = 0.01

    def __post_init__(self) -> None:
        require_numbers(self, "adaptive_composite", ("forgetting_time", "every"))


@by_address
class Prediction(NamedTuple):
    """The numbers of a composite adaptive controller."""

    adaptation: Adaptation  # those of the adaptive controller that it is
    filter: Filter  # the filter of regressor and torque
    trust: Array  # (p,) diagonal of R
    weight: float  # c times the time between two steps [s]
    keep: float  # `exp(-period / T)` of the period between two steps
    every: int  # samples between two steps
    gradient: Array  # (k,) room to work in
    velocity: Array  # (k,) room to work in
    step: Array  # (16 bodies + rest,) written: y
    work: Array  # (3, 16 bodies + rest) room to work in
    layout: IntArray  # of `Composite` in the state


class Composite(NamedTuple):
    """State of a composite adaptive controller: its estimate, that of the filter, Q (k, k) and b (k,)."""

    estimate: Estimate
    filtered: Filtered
    Q: Matrix
    b: Vector


composite_of = views(Composite)


@linked
def estimate(row: Array, at: IntArray, p: Prediction, state: Array) -> None:
    """Take in the last control period, write Psi_hat, and update theta along s and down the prediction error."""
    a, o = p.adaptation, composite_of(state, p.layout)
    f, known, nb = p.filter, a.known, a.known.base
    now = int(o.estimate.samples[0]) % p.every == 0
    if period(row, at, f, o.filtered):
        measured(known, f.pose, f.nu[:nb], f.q, f.nu[nb:], f.shape)
        regress(known, f.nu, f.nudot)
        low_pass(f, known.Y, o.filtered)
        if now:
            gather(p, o)
    look(row, at, known)
    adapt(row, at, a, o.estimate)
    if now:
        follow(p, o)


@linked
def settle(row: Array, at: IntArray, p: Prediction, state: Array) -> None:
    """Keep the torque that is held from this sample on."""
    remember(row, at, composite_of(state, p.layout).filtered)


@internal
def gather(p: Prediction, o: Composite) -> None:
    """Take the filtered regressor and torque into Q and b."""
    Y, y, k = o.filtered.Phi_f, o.filtered.Y_f, p.gradient.size
    Q, b = o.Q, o.b
    for j in range(k):
        b[j] *= p.keep
        for c in range(k):
            Q[j, c] *= p.keep
    for i in range(p.trust.size):
        share = (1.0 - p.keep) * p.trust[i]
        for j in range(k):
            if Y[i, j] != 0.0:
                b[j] += share * Y[i, j] * y[i]
                for c in range(k):
                    Q[j, c] += share * Y[i, j] * Y[i, c]


@internal
def follow(p: Prediction, o: Composite) -> None:
    """One step down the prediction error."""
    a, theta = p.adaptation.bodies, o.estimate.theta
    for b in range(len(a.roots)):
        factor(theta[10 * b : 10 * b + 10], a, b)
    if a.known.size:
        left(p, o)
        inform(theta, p.gradient, p.weight, a, o.Q, p.weight)
    else:
        descend(p, a, o)
        taken(p.step, a)
    move(theta, shortened(a), 0.0, a)


@internal
def left(p: Prediction, o: Composite) -> None:
    """The rest of the integrals that the estimate leaves, `b - Q theta_hat`, into p.gradient."""
    times(o.Q, o.estimate.theta, p.gradient)
    for j in range(p.gradient.size):
        p.gradient[j] = o.b[j] - p.gradient[j]


@internal
def descend(p: Prediction, a: Bodies, o: Composite) -> None:
    """One step down the prediction error, into p.step; `a.factors` belong to the theta in the state.

    With `Gamma = S S'` it is the implicit Euler step of `theta' = c Gamma (b - Q theta)` over the time tau since the
    last, `theta+ = theta + S y`, `(1 + c tau S' Q S) y = c tau S' (b - Q theta)`, by conjugate gradients from y = 0.
    It does not overshoot for any c tau, and excited directions of all sizes take their full part in it.
    """
    n, Q = p.step.size, o.Q
    y, residual, direction, image = p.step, p.work[0], p.work[1], p.work[2]
    left(p, o)
    pulled(p.gradient, a, residual)
    square = 0.0
    for i in range(n):
        residual[i] *= p.weight
        y[i], direction[i] = 0.0, residual[i]
        square += residual[i] * residual[i]
    enough = ENOUGH * square
    for _ in range(ITERATIONS):
        if not square > enough:
            break
        pushed(direction, a, p.velocity)
        times(Q, p.velocity, p.gradient)
        pulled(p.gradient, a, image)
        bend = 0.0
        for i in range(n):
            image[i] = direction[i] + p.weight * image[i]
            bend += direction[i] * image[i]
        length, before, square = square / bend, square, 0.0
        for i in range(n):
            y[i] += length * direction[i]
            residual[i] -= length * image[i]
            square += residual[i] * residual[i]
        for i in range(n):
            direction[i] = residual[i] + square / before * direction[i]


@compiled
def times(Q: Array, x: Array, out: Array) -> None:
    """`Q x` of a symmetric Q (k, k)."""
    for j in range(x.size):
        out[j] = 0.0
    for i in range(x.size):
        if x[i] != 0.0:
            for j in range(x.size):
                out[j] += Q[i, j] * x[i]


@compiled
def pushed(y: Array, a: Bodies, theta: Array) -> None:
    """`S y`: sixteen numbers of a symmetric matrix per body and one per parameter of the rest, to (k,)."""
    half, X = a.work[0], a.work[1]
    for b in range(len(a.roots)):
        root = math.sqrt(a.gamma[b])
        sandwich(a.factors[b], y[16 * b : 16 * b + 16].reshape((4, 4)), half, X)
        sandwich(a.roots[b], X, half, a.work[2])
        to_vector(a.work[2], theta[10 * b : 10 * b + 10])
        for j in range(10 * b, 10 * b + 10):
            theta[j] *= root
    for j in range(a.rates.size):
        theta[10 * len(a.roots) + j] = math.sqrt(a.rates[j]) * y[16 * len(a.roots) + j]


@compiled
def pulled(gradient: Array, a: Bodies, y: Array) -> None:
    """`S' gradient`, of the shape that `pushed` takes."""
    half, L, X = a.work[0], a.work[1], a.work[2]
    for b in range(len(a.roots)):
        root = math.sqrt(a.gamma[b])
        to_matrix(gradient[10 * b : 10 * b + 10], 0.5, L)
        transposed_sandwich(a.roots[b], L, half, X)
        out = y[16 * b : 16 * b + 16].reshape((4, 4))
        transposed_sandwich(a.factors[b], X, half, out)
        for i in range(4):
            for j in range(4):
                out[i, j] *= root
    for j in range(a.rates.size):
        y[16 * len(a.roots) + j] = math.sqrt(a.rates[j]) * gradient[10 * len(a.roots) + j]


@compiled
def taken(y: Array, a: Bodies) -> None:
    """The step y as `a.steps` and `a.rest`."""
    for b in range(len(a.roots)):
        root = math.sqrt(a.gamma[b])
        for i in range(4):
            for j in range(4):
                a.steps[b, i, j] = root * y[16 * b + 4 * i + j]
    for j in range(a.rates.size):
        a.rest[j] = math.sqrt(a.rates[j]) * y[16 * len(a.roots) + j]


@compiled
def shortened(a: Bodies) -> float:
    """The factor that lets no body change by more than `LARGEST` in a step `a.steps`."""
    eta = 1.0
    for b in range(len(a.roots)):
        square = 0.0
        for i in range(4):
            for j in range(4):
                square += a.steps[b, i, j] * a.steps[b, i, j]
        eta = min(eta, LARGEST / math.sqrt(square) if square > 0.0 else 1.0)
    return eta


KERNELS[Prediction] = Kernels(estimate, settle)


@dataclass(frozen=True, eq=False)
class AdaptiveComposite(Adaptive):
    """`Adaptive` whose estimate also follows a prediction error: with excitation it is knowledge."""

    # the prediction error's numbers
    composite: AdaptiveCompositeSettings = field(default_factory=AdaptiveCompositeSettings)
    name: str = "adaptive_composite"

    @classmethod
    def build(cls, given: ControllerSettings) -> Self:
        """With the settings of `adaptive`, and its own."""
        adaptive, own = given.settings
        return replace(super().build(replace(given, settings=adaptive)), composite=own)

    @classmethod
    def from_facts(cls, name: str, facts: dict[str, Any], told: Told) -> Self | None:
        """From gains, settings and start."""
        found = super().from_facts(name, facts, told)
        if found is None or "composite" not in facts:
            return None
        return replace(found, composite=msgspec.convert(facts["composite"], AdaptiveCompositeSettings))

    def law(self, context: Context) -> Law:
        """The numbers of the law, with room of its own to work in; without learning those of `Adaptive`."""
        if not self.learning:
            return super().law(context)
        own, k, h = self.composite, self.regressor.size, float(context.control_period)
        K, every = self.positive_gains(context.layout, "adaptation needs all > 0"), max(1, round(own.every / h))
        size = 16 * len(self.regressor.bodies) + k - self.regressor.inertial
        prediction = Prediction(
            adaptation=self.adaptation(context, K, float(own.tracking)),
            filter=new_filter(context, own.pole),
            trust=1.0 / K,
            weight=float(own.weight) * every * h,
            keep=float(exp(-every * h / own.forgetting_time)),
            every=every,
            gradient=np.zeros(k),
            velocity=np.zeros(k),
            step=np.zeros(size),
            work=np.zeros((3, size)),
            layout=layout_of(Composite, self.shapes(context)),
        )
        return Law(constant_gain(K), prediction)

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """The estimate, what the filter remembers, and the integrals."""
        k = self.regressor.size
        return {**super().shapes(context), **parts(context, context.layout.dof, k), "Q": (k, k), "b": (k,)}

    def facts(self) -> dict[str, Any]:
        """The facts of `Adaptive`, and the prediction error's."""
        return super().facts() | {"composite": plain(self.composite)}

    def features(self, law: Law, state: ControllerState) -> Array | None:
        """Y, (p, k)."""
        learner: Adaptation | Prediction = law.learner
        return (learner.adaptation if isinstance(learner, Prediction) else learner).known.Y
