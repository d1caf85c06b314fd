"""Dynamic regressor extension and mixing (DREM): every parameter gets an equation of its own, whatever the others are.

The law is `Psi_hat = Psi_0 + Phi w`, as of `torque.concurrent`. Kreisselmeier's integrals (1977, IEEE TAC 22(1)) of the
equations y = Phi_f w of filtered torque (`torque.filtered`), with R by the noise, extend them to a square system,

    Omega' = Phi_f' R^-1 Phi_f - Omega / memory,     b' = Phi_f' R^-1 y - b / memory,     Omega w = b.

DREM (Aranovskiy, Bobtsov, Ortega, Pyrkin 2017, IEEE TAC 62(7); for robots, beside a tracking term, Glushchenko and
Lastochkin 2024, arXiv:2406.19838) multiplies it with the adjugate of Omega: det(Omega) w_j = (adj(Omega) b)_j. For
dozens of parameters the determinant is no number to compute with: it is the product of all eigenvalues, and zero where
one direction is not excited. So row j is divided by the cofactor of Omega_jj, which any row of a mixing may be:

    Delta_j w_j = Delta_j (Omega^-1 b)_j,      Delta_j = det(Omega) / cofactor_jj = 1 / (Omega^-1)_jj,

the Schur complement of Omega_jj: what the equations say of w_j that no other parameters explain, in one over the
variance of w_j. With P = (Omega + FAINT)^-1 in the place of the inverse it exists for any Omega, and a direction that
is not excited takes Delta from those parameters alone that it is a direction of. The gradient is normalised,

    w_j' = rate Delta_j^2 / (Delta_j^2 + unsure^-4) ((P b)_j - w_j) + Gamma (Phi' s)_j,    Delta_j = 1 / P_jj - FAINT,

and 0 in place of the first term where FAINT P_jj > OPEN: the motion has not told w_j from others.

With a true w and exact equations (P b)_j = w_j - FAINT (P w)_j, which is off by at most |w| (FAINT P_jj)^1/2. Without
the last term the error of every parameter so falls monotonically until it is as small as that, and what the motion does
not say stays as it is: no parameter is moved for another. With it, V = s' M s / 2 + |w~|^2 / (2 Gamma) has

    V' <= -s' K s - rate / Gamma sum_j share_j |w~_j| (|w~_j| - |w| (FAINT P_jj)^1/2)

in continuous time: a constant metric, where `concurrent` has a V that jumps as its stack changes. Gamma answers s by
`tracking` over K on random motion of unit speed; a sample's answer stays below a share of the feedback, as in
`torque.adaptive`. The bounds |w_j| <= BOUND are of each parameter alone: they move none of them away from a w within.
Coarse encoders make equations that say of any motion that it excites everything, and a w by which velocities weigh less
than nothing, or more than their loop bears (`Bears`). So w is moved to where the diagonal of M_hat is in between at
some postures, along the normal of each bound: that brings it nearer to every w within all of them.
Noise in Phi_f biases Omega; the instrumental variables of the paper of 2024, which are there for that, are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import internal, linked
from ..elementary import exp
from ..elementary.matrices import product
from ..model.regressor import Massless
from ..parts import Matrix, Vector, layout_of, views
from ..settings import Settings, require_numbers
from ..signals import INDEX, Array, IntArray
from .concurrent import SHARE, CombinationLearner, has_equation, respond
from .controller import Context, ControllerState, Law
from .filtered import Filter, Filtered, new_filter, parts, remember
from .history import inverse
from .law import KERNELS, Kernels, constant_gain
from .prior import require_one_start

Z, R = (INDEX[name] for name in ("z", "r"))
FAINT = 0.01  # information of a prior of ten times the size, that makes Omega invertible
OPEN = 0.1  # share of that prior variance which, where it is left of a parameter, leaves it as it is
POSTURES = 20  # at which inertias are bounded
BOUND = 10.0  # on every w, in standard deviations of the prior


class DremSettings(Settings, frozen=True):
    """How DREM learns.

    Args:
        rate: How fast a parameter goes to what its equation says, where that is sure [1/s].
        tracking: How fast all of them answer the tracking error, over K, on random motion of unit speed [1/s].
        memory: Time constant of Kreisselmeier's integrals [s]; 0 for ever.
        noise: Standard deviation of what equations say in a second, over K: a velocity error [m/s, rad/s].
        unsure: Standard deviation of a parameter, over that of its prior, at which it learns at half the rate.
        pole: Of the low-pass of regressor and torque [1/s].
        every: Time between two equations [s].
        spread: Standard deviation of the prior, as of `concurrent`.
        initial: "prior" or "nominal", as of `concurrent`.
        start: A file `NAME.identified.json` of `mmnn identify` in place of both.

    Raises:
        ConfigError: A number that is negative, not finite or 0 where it must not be.
    """

    rate: float = 5.0
    tracking: float = 5.0
    memory: float = 20.0
    noise: float = 0.005
    unsure: float = 2.0
    pole: float = 3.0
    every: float = 0.02
    spread: float = 1.0
    initial: Literal["prior", "nominal"] = "prior"
    start: str = ""

    def __post_init__(self) -> None:
        require_numbers(self, "drem", ("noise", "unsure", "every", "spread"))
        require_one_start(self, "drem")


@by_address
class Mixing(NamedTuple):
    """The numbers of DREM, and room to work in."""

    known: Massless  # the robot without its masses
    basis: Array  # (k0, k) `theta = theta_0 + basis w`, scaled so that the prior of w is 1
    theta0: Array  # (k0,) parameters to start from
    filter: Filter  # of torque and features
    gain: Array  # (p,) K of `tau = K s + Psi_hat` [N s/m, N m s/rad; N m s/rad or N s/m]
    precision: Array  # (p,) R^-1 times the time between two equations
    learning: bool  # off keeps w and the integrals
    h: float  # control period [s]
    every: int  # samples between two equations
    keep: float  # what memory leaves of the integrals in that time
    rate: float  # what a sure parameter makes good of its error in that time
    doubt: float  # `unsure^-4`
    gamma: float  # Gamma [1/J]
    share: float  # largest answer of a sample to s, as a share of the feedback
    heavy: Array  # (c, k) unit rows, how the inertia of a velocity at a posture grows with w
    least: Array  # (c,) at least that of it times w
    most: Array  # (c,) at most
    Phi: Array  # (p, k) room to work in
    psi0: Array  # (p,) room to work in
    gradient: Array  # (k,) room to work in
    column: Array  # (k,) room to work in
    A: Array  # (k, k) room to work in
    factor: Array  # (k, k) room to work in
    layout: IntArray  # of `Mixed` in the state


class Mixed(NamedTuple):
    """State of DREM."""

    w: Vector  # (k,) the estimate
    samples: Vector  # (1,) how many
    filtered: Filtered  # what the filter remembers
    Omega: Matrix  # (k, k) extended regressor
    b: Vector  # (k,) its other side
    P: Matrix  # (k, k) inverse of `Omega + FAINT`


mixed_of = views(Mixed)


@linked
def estimate(row: Array, at: IntArray, a: Mixing, state: Array) -> None:
    """Psi_hat and gain of one sample, then the update of w and of the integrals; arguments as of `law.estimate`."""
    o = mixed_of(state, a.layout)
    respond(row, at, a, o.w)
    if not a.learning:
        return
    follow(row, at, a, o.w)
    if has_equation(row, at, a, o.samples, o.filtered):
        extend(a, o)
        mix(a, o)
        weigh(a, o.w)


@internal
def follow(row: Array, at: IntArray, a: Mixing, w: Array) -> None:
    """One sample of `w' = Gamma Phi' s`, its answer to s kept below a share of the feedback."""
    z, r, feedback, answer = row[at[Z] : at[Z + 1]], row[at[R] : at[R + 1]], 0.0, 0.0
    for j in range(w.size):
        a.gradient[j] = 0.0
    for i in range(a.gain.size):
        s = z[i] if i < z.size else r[i - z.size]
        feedback += a.gain[i] * s * s
        for j in range(w.size):
            a.gradient[j] += a.Phi[i, j] * s
    for j in range(w.size):
        answer += a.h * a.gamma * a.gradient[j] * a.gradient[j]
    if not (math.isfinite(answer) and math.isfinite(feedback)):
        return
    eta = a.share * feedback / answer if answer > a.share * feedback else 1.0
    for j in range(w.size):
        w[j] = min(max(w[j] + eta * a.h * a.gamma * a.gradient[j], -BOUND), BOUND)


@internal
def extend(a: Mixing, o: Mixed) -> None:
    """One equation per velocity into Kreisselmeier's integrals."""
    Phi_f, Y_f, k = o.filtered.Phi_f, o.filtered.Y_f, o.b.size
    for j in range(k):
        o.b[j] *= a.keep
        for c in range(k):
            o.Omega[j, c] *= a.keep
    for i in range(a.gain.size):
        for j in range(k):
            o.b[j] += a.precision[i] * Phi_f[i, j] * Y_f[i]
            for c in range(k):
                o.Omega[j, c] += a.precision[i] * Phi_f[i, j] * Phi_f[i, c]


@internal
def mix(a: Mixing, o: Mixed) -> None:
    """One step of every parameter along the gradient of its own equation."""
    k = o.b.size
    for j in range(k):
        for c in range(k):
            a.A[j, c] = o.Omega[j, c] + (FAINT if j == c else 0.0)
    inverse(a.A, a.factor, a.column, o.P)
    for j in range(k):
        said, Delta = 0.0, 1.0 / o.P[j, j] - FAINT
        for c in range(k):
            said += o.P[j, c] * o.b[c]
        share = a.rate * Delta * Delta / (Delta * Delta + a.doubt)
        if FAINT * o.P[j, j] <= OPEN and math.isfinite(said) and math.isfinite(share):
            o.w[j] = min(max(o.w[j] + share * (said - o.w[j]), -BOUND), BOUND)


@internal
def weigh(a: Mixing, w: Array) -> None:
    """Move w to where velocities weigh no less than nothing, and no more than their loop bears."""
    for i in range(a.least.size):
        felt = 0.0
        for j in range(w.size):
            felt += a.heavy[i, j] * w[j]
        step = min(max(felt, a.least[i]), a.most[i]) - felt
        if step != 0.0:
            for j in range(w.size):
                w[j] += step * a.heavy[i, j]


@linked
def settle(row: Array, at: IntArray, a: Mixing, state: Array) -> None:
    """Keep the torque that is held from this sample on."""
    if a.learning:
        remember(row, at, mixed_of(state, a.layout).filtered)


KERNELS[Mixing] = Kernels(estimate, settle)


@dataclass(frozen=True, eq=False)
class Drem(CombinationLearner):
    """`tau = Y theta_hat + K s`, theta_hat by dynamic regressor extension and mixing; see above for what holds.

    Args and errors are those of `ParameterLearner`.
    """

    settings: DremSettings = field(default_factory=DremSettings)
    name: str = "drem"

    def law(self, context: Context) -> Law:
        """The numbers of the law, with room of its own to work in; errors as of `positive_gains`."""
        K, own, h = self._gains, self.settings, float(context.control_period)
        p, k, every = K.size, self.dimension, max(1, round(own.every / h))
        heavy, least, most = self._weights
        mixing = Mixing(
            known=self.regressor.workspace(),
            basis=self.basis,
            theta0=self.start(),
            filter=new_filter(context, own.pole),
            gain=K,
            precision=every * h / (own.noise * K) ** 2,
            learning=self.learning,
            h=h,
            every=every,
            keep=exp(-every * h / own.memory) if own.memory else 1.0,
            rate=1.0 - exp(-own.rate * every * h),
            doubt=own.unsure**-4,
            gamma=self.gamma,
            share=self.answer(context, SHARE),
            heavy=heavy,
            least=least,
            most=most,
            Phi=np.zeros((p, k)),
            psi0=np.zeros(p),
            gradient=np.zeros(k),
            column=np.zeros(k),
            A=np.zeros((k, k)),
            factor=np.zeros((k, k)),
            layout=layout_of(Mixed, self.shapes(context)),
        )
        return Law(constant_gain(K), mixing)

    @cached_property
    def _weights(self) -> tuple[Array, Array, Array]:
        """Bounds of `weigh`, (c, k), (c,) and (c,)."""
        rng, K = np.random.default_rng(0), self._gains
        still, inertia = np.zeros(K.size), []
        for _ in range(POSTURES):
            position = self.regressor.random_position(rng)
            gravity = self.regressor.matrix(position, still, still, still)
            inertia += [
                (self.regressor.matrix(position, still, still, e) - gravity)[i] for i, e in enumerate(np.eye(K.size))
            ]
        by_w, start = product(np.array(inertia), self.basis), product(np.array(inertia), self.start())
        norm = np.sqrt((by_w * by_w).sum(axis=1))
        bearable = np.inf if self.bears is None else np.tile(self.bears.weight * K, POSTURES)
        most = np.maximum(bearable, start)
        return by_w / norm[:, None], -start / norm, (most - start) / norm

    @property
    def gamma(self) -> float:
        """Gamma [1/J], with which the mean answer to s of all velocities on random motion is `tracking` K."""
        Phi = product(self.random_motion().reshape(-1, self.regressor.size), self.basis)
        square = (Phi * Phi).sum(axis=1).reshape(-1, self._gains.size) / self._gains
        return float(self.settings.tracking / square.mean())

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """The estimate, what the filter remembers, and the integrals."""
        p, k = context.layout.dof, self.dimension
        return {"w": (k,), "samples": (1,), **parts(context, p, k), "Omega": (k, k), "b": (k,), "P": (k, k)}

    def init(self, context: Context) -> ControllerState:
        """The estimate at its start, and nothing seen."""
        state = super().init(context)
        state["P"] = np.eye(self.dimension) / FAINT
        return state

    def known(self, state: ControllerState) -> Array:
        """`(Omega + 1)^-1`, (k, k)."""
        return np.asarray(np.linalg.inv(state["Omega"] + np.eye(self.dimension)))

    def learning_gain(self, state: ControllerState, context: Context) -> float:
        """Gamma [1/J]."""
        return self.gamma
