"""Concurrent learning of the parameters of a robot whose kinematics are known: knowledge that outlasts the excitation.

The law is `Psi_hat = Psi_0 + Phi w`, w drawn to what a history stack of equations (`torque.history`) says:

    w' = rate (w_L - w) + tracking P Phi' s,      P = L^-1 of the stack

The gain of least squares makes all excited directions converge at the same rate [1/s], however ill conditioned the
stack is. Between two changes of the stack, with a true w and exact equations, V = s' M s / 2 + w~' L w~ / 2 / tracking
has

    V' = -s' K s - rate / tracking w~' (L - 1) w~ - rate / tracking w~' (w - w_0),

the last term being the pull of the prior, which vanishes beside what was seen. A change of the stack makes V jump, but
there are finitely many of them. A sample's answer to s is kept below a share of the feedback, as in `torque.adaptive`.

Bounds, whatever the sensors say: |w| <= radius, as w_L is put into that ball, which is convex, and so is w after the
tracking term; Psi_hat is bounded by the motors' limits (`torque.law`).
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
from ..elementary.matrices import cholesky, product, solve, svd, triangle
from ..elementary.normals import standard_normal
from ..errors import ConfigError
from ..model.regressor import Massless, measured, regress
from ..parts import Vector, layout_of, views
from ..settings import Settings, require_at_most, require_numbers
from ..signals import INDEX, Array, IntArray, Layout
from .adaptive import AdaptiveSettings
from .controller import Context, ControllerState, Law
from .filtered import Filter, Filtered, low_pass, new_filter, parts, period, remember
from .history import HALF, Scratch, Stack, consider, estimate_of, scratch
from .history import shapes as stack_shapes
from .law import KERNELS, Kernels, constant_gain
from .prior import ParameterLearner, prior_of, require_one_start, scales, sizes_of, within_prior
from .random_features import Movement

TIME, POSE, VELOCITY, Q, QDOT, SHAPE = (INDEX[n] for n in ("time", "pose", "velocity", "q", "qdot", "shape"))
Z, R, NU_REF, NUDOT_REF = INDEX["z"], INDEX["r"], INDEX["nu_ref"], INDEX["nudot_ref"]
PSI_HAT, EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["psi_hat"], INDEX["effective_gain"], INDEX["weight_norm"]
SHARE = 0.2  # largest answer of a sample to s, as a share of the feedback
RADIUS = 10.0  # bound on w, as root mean square in standard deviations of the prior
MOST = 5000  # places of the stack
UNKNOWN = 0.1  # share of the prior variance of Psi left on random motion, above which a run did not excite
RANK = 1e-9  # relative size under which a singular value of stacked regressors counts as zero
FRICTION = 0.3  # size of friction, in c_j (see `AdaptiveSettings`): small joints have little gain and much friction
SAMPLES = 300  # of random motion


class ConcurrentSettings(Settings, frozen=True):
    """How a concurrent learner learns.

    Args:
        entries: Places of the history stack, 5000 at most; each holds one equation per velocity.
        rate: How fast the estimate goes to what the stack says [1/s].
        tracking: How fast it follows the tracking error where nothing is known yet [1/J].
        noise: Standard deviation of an equation, divided by K: the velocity error that would hide it [m/s, rad/s].
        growth: Least gain of log det of the information for which an entry is replaced.
        lifetime: Of an entry [s]; 0 for ever. With a lifetime the learner forgets what is not excited again, and learns
            a robot that has changed.
        floor: Whether no exchange takes what is known below a floor, which only rises: then `mmnn prove --tube` proves
            that it stays known. It learns more slowly, on robots of many joints much more. Without a lifetime only.
        pole: Of the low-pass of regressor and torque [1/s].
        every: Time between two candidates [s].
        spread: Standard deviation of the prior, in sizes of the typical robot; of friction in `FRICTION` c_j.
        initial: "prior" starts from balls without friction, "nominal" from a nominal robot (in an experiment the one
            of `[nominal]`).
        start: A file `NAME.identified.json` of `mmnn identify` in place of both: it begins with the parameters found
            there, and their covariance is the prior where that is smaller.

    Raises:
        ConfigError: A number that is negative, not finite or 0 where it must not be.
    """

    entries: int = 60
    rate: float = 2.0
    tracking: float = 10.0
    noise: float = 0.005
    growth: float = 0.05
    lifetime: float = 0.0
    floor: bool = False
    pole: float = 3.0
    every: float = 0.02
    spread: float = 1.0
    initial: Literal["prior", "nominal"] = "prior"
    start: str = ""

    def __post_init__(self) -> None:
        require_numbers(self, "concurrent", ("entries", "noise", "growth", "every", "spread"))
        require_one_start(self, "concurrent")
        require_at_most(self, "concurrent", {"entries": MOST})
        if self.floor and self.lifetime > 0:
            why = "entries end after their lifetime, whatever they tell"
            raise ConfigError("true", why=why, fix="use concurrent.lifetime = 0", key="concurrent.floor")


@by_address
class History(NamedTuple):
    """The numbers of a concurrent learner, and room to work in."""

    known: Massless  # the robot without its masses
    basis: Array  # (k0, k) `theta = theta_0 + basis w`, scaled so that the prior of w is 1
    theta0: Array  # (k0,) parameters to start from
    filter: Filter  # of torque and features
    gain: Array  # (p,) K of `tau = K s + Psi_hat` [N s/m, N m s/rad; N m s/rad or N s/m]
    precision: Array  # (p,) one over the noise of the equations
    learning: bool  # off keeps w and the stack
    h: float  # control period [s]
    every: int  # samples between two candidates
    rate: float  # of w towards what the stack says [1/s]
    tracking: float  # of w along the tracking error [1/J]
    share: float  # largest answer of a sample to s, as a share of the feedback
    radius: float  # bound on |w|
    growth: float  # least gain of log det L of a replacement
    lifetime: float  # of an entry [s]
    floor: bool  # whether the stack has one
    Phi: Array  # (p, k) room to work in
    psi0: Array  # (p,) room to work in
    y: Array  # (p,) room to work in
    gradient: Array  # (k,) room to work in
    target: Array  # (k,) room to work in
    scratch: Scratch  # room to work in
    layout: IntArray  # of `Recalled` in the state


class Recalled(NamedTuple):
    """State of a concurrent learner: w (k,), the number of samples, that of the filter, the stack."""

    w: Vector
    samples: Vector
    filtered: Filtered
    stack: Stack


recalled_of = views(Recalled)


@linked
def estimate(row: Array, at: IntArray, a: History, state: Array) -> None:
    """Psi_hat and gain of one sample, then the update of w and of the stack.

    Args:
        row: (width,) row of signals; psi_hat, effective_gain and weight_norm are written.
        at: Offsets of the signals.
        a: The numbers of the law.
        state: The controller's state, see `Recalled`.
    """
    p, k = a.Phi.shape
    o = recalled_of(state, a.layout)
    w, seen = o.w, o.filtered
    respond(row, at, a, w)
    if not a.learning:
        return
    answer(row, at, a, w, o.stack.P)
    if not has_equation(row, at, a, o.samples, seen):
        return
    for i in range(p):
        a.y[i] = a.precision[i] * seen.Y_f[i]
        for j in range(k):
            a.Phi[i, j] = a.precision[i] * seen.Phi_f[i, j]
    consider(o.stack, a.scratch, a.Phi, a.y, row[at[TIME]], a.growth, a.lifetime, a.floor)
    estimate_of(o.stack, a.target)
    into_ball(a.target, a.radius)
    share = 1.0 - exp(-a.rate * a.every * a.h)
    for j in range(k):
        w[j] += share * (a.target[j] - w[j])


@internal
def respond(row: Array, at: IntArray, a: History, w: Array) -> None:
    """Psi_hat, gain and |w| of one sample."""
    nu_ref, nudot_ref = row[at[NU_REF] : at[NU_REF + 1]], row[at[NUDOT_REF] : at[NUDOT_REF + 1]]
    velocity, qdot = row[at[VELOCITY] : at[Q]], row[at[QDOT] : at[QDOT + 1]]
    pose, q, shape = row[at[POSE] : at[VELOCITY]], row[at[Q] : at[QDOT]], row[at[SHAPE] : at[SHAPE + 1]]
    features(a.known, a.basis, a.theta0, Movement(pose, q, velocity, qdot, nu_ref, nudot_ref, shape), a.Phi, a.psi0)
    say(row, at, a.gain, a.Phi, a.psi0, w)


@internal
def has_equation(row: Array, at: IntArray, a: History, samples: Array, seen: Filtered) -> bool:
    """Take the last period into the filter of torque and features; whether an equation is due that it gives."""
    f, now = a.filter, int(samples[0]) % a.every == 0
    samples[0] += 1.0
    if not period(row, at, f, seen):
        return False
    nb = a.gain.size - f.q.size
    movement = Movement(f.pose, f.q, f.nu[:nb], f.nu[nb:], f.nu, f.nudot, f.shape)
    features(a.known, a.basis, a.theta0, movement, a.Phi, a.psi0)
    for i in range(a.gain.size):
        f.torque[i] -= a.psi0[i]
    low_pass(f, a.Phi, seen)
    return now


@internal
def features(known: Massless, basis: Array, theta0: Array, m: Movement, Phi: Array, psi0: Array) -> None:
    """Phi (p, k) and Psi_0 (p,) of a movement, for parameters `theta_0 + basis w`."""
    measured(known, m.pose, m.velocity, m.q, m.qdot, m.shape)
    regress(known, m.nu_ref, m.nudot_ref)
    Y, p, k = known.Y, Phi.shape[0], Phi.shape[1]
    for i in range(p):
        psi0[i] = 0.0
        for j in range(k):
            Phi[i, j] = 0.0
        for c in range(theta0.size):
            if Y[i, c] != 0.0:
                psi0[i] += Y[i, c] * theta0[c]
                for j in range(k):
                    Phi[i, j] += Y[i, c] * basis[c, j]


@internal
def say(row: Array, at: IntArray, gain: Array, Phi: Array, psi0: Array, w: Array) -> None:
    """Psi_hat, the gain, and the norm of w."""
    psi_hat, square = row[at[PSI_HAT] : at[PSI_HAT + 1]], 0.0
    for j in range(w.size):
        square += w[j] * w[j]
    row[at[WEIGHT_NORM]], row[at[WEIGHT_NORM] + 1] = math.sqrt(square), 0.0
    for i in range(psi_hat.size):
        row[at[EFFECTIVE_GAIN] + i], psi_hat[i] = gain[i], psi0[i]
        for j in range(w.size):
            psi_hat[i] += Phi[i, j] * w[j]


@internal
def answer(row: Array, at: IntArray, a: History, w: Array, P: Array) -> None:
    """One sample of `w' = tracking P Phi' s`, its answer to s kept below a share of the feedback."""
    p, k = a.Phi.shape
    z, r = row[at[Z] : at[Z + 1]], row[at[R] : at[R + 1]]
    feedback, late = 0.0, 0.0
    for j in range(k):
        a.gradient[j] = 0.0
    for i in range(p):
        s = z[i] if i < z.size else r[i - z.size]
        feedback += a.gain[i] * s * s
        for j in range(k):
            a.gradient[j] += a.Phi[i, j] * s
    for j in range(k):
        a.target[j] = 0.0
        for c in range(k):
            a.target[j] += P[j, c] * a.gradient[c]
        late += a.h * a.tracking * a.target[j] * a.gradient[j]
    eta = a.share * feedback / late if late > a.share * feedback else 1.0
    for j in range(k):
        w[j] += eta * a.h * a.tracking * a.target[j]
    into_ball(w, a.radius)


@internal
def into_ball(w: Array, radius: float) -> None:
    """The nearest point with |w| <= radius; zero for what is no number."""
    square = 0.0
    for j in range(w.size):
        square += w[j] * w[j]
    if square <= radius * radius:
        return
    share = radius / math.sqrt(square) if math.isfinite(square) else 0.0
    for j in range(w.size):
        w[j] = share * w[j] if share > 0.0 else 0.0


@linked
def settle(row: Array, at: IntArray, a: History, state: Array) -> None:
    """Keep the torque that is held from this sample on."""
    if a.learning:
        remember(row, at, recalled_of(state, a.layout).filtered)


KERNELS[History] = Kernels(estimate, settle)


@dataclass(frozen=True, eq=False)
class Concurrent(ParameterLearner):
    """`tau = Y theta_hat + K s`, theta_hat by concurrent learning; see above for what holds.

    Args and errors are those of `ParameterLearner`.
    """

    settings: ConcurrentSettings = field(default_factory=ConcurrentSettings)
    name: str = "concurrent"

    def law(self, context: Context) -> Law:
        """The numbers of the law, with room of its own to work in.

        Raises:
            ConfigError: A gain of 0: noise is measured by the gains.
        """
        K, own, h = self._gains, self.settings, float(context.control_period)
        p, k = K.size, self.dimension
        history = History(
            known=self.regressor.workspace(),
            basis=self.basis,
            theta0=self.start(),
            filter=new_filter(context, own.pole),
            gain=K,
            precision=1.0 / (own.noise * K),
            learning=self.learning,
            h=h,
            every=max(1, round(own.every / h)),
            rate=float(own.rate),
            tracking=float(own.tracking),
            share=self.answer(context, SHARE),
            radius=RADIUS * float(np.sqrt(k)),
            growth=float(own.growth),
            lifetime=float(own.lifetime) if own.lifetime else np.inf,
            floor=own.floor,
            Phi=np.zeros((p, k)),
            psi0=np.zeros(p),
            y=np.zeros(p),
            gradient=np.zeros(k),
            target=np.zeros(k),
            scratch=scratch(own.entries, p, k),
            layout=layout_of(Recalled, self.shapes(context)),
        )
        return Law(constant_gain(K), history)

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """The estimate, what the filter remembers, and the stack."""
        p, k = context.layout.dof, self.dimension
        stack = stack_shapes(self.settings.entries, p, k)
        return {"w": (k,), "samples": (1,), **parts(context, p, k), **stack}

    def init(self, context: Context) -> ControllerState:
        """The estimate at its start, and an empty stack."""
        state = super().init(context)
        state["L"] = state["P"] = np.eye(self.dimension)
        state["F"] = HALF * np.eye(self.dimension)
        state["born"] = -1.0
        return state

    @property
    def notes(self) -> list[str]:
        """How many of the parameters matter."""
        return [f"{self.name}: {self.dimension} combinations of its {self.regressor.size} parameters matter"]

    @property
    def dimension(self) -> int:
        """Number of combinations that matter, k."""
        return self._typical[1].shape[1]

    def known(self, state: ControllerState) -> Array:
        """P, (k, k): the covariance of w as the equations have it, with a prior of 1."""
        return state["P"]

    @property
    def basis(self) -> Array:
        """`theta = theta_0 + basis w`, (k0, k): the directions that matter, of the size of the prior."""
        root, directions = self._typical
        return product(root, directions)

    @property
    def root(self) -> Array:
        """A root (k0, k0) of the prior covariance of theta."""
        return self._typical[0]

    @cached_property
    def _start(self) -> Array:
        """The parameters of `start`, (k0,), computed once: a prior looks at many positions."""
        if self.informed and self.nominal is not None:
            return np.array(self.nominal)
        own = AdaptiveSettings()
        return prior_of(self.regressor, self._gains, own.mass, own.size, self.bearable(own.slowest))

    def theta(self, state: ControllerState) -> Array:
        """The estimate as parameters of the robot, (k0,)."""
        return np.asarray(self.start() + self.basis @ state["w"])

    def knowledge(self, state: ControllerState) -> tuple[Array, Array | None]:
        """The estimate as parameters (k0,), and its covariance (k0, k0)."""
        return self.theta(state), np.asarray(self.basis @ self.known(state) @ self.basis.T)

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The estimate, (k,)."""
        return {"w": state["w"]}

    def features(self, law: Law, state: ControllerState) -> Array | None:
        """Phi, (p, k); while it learns, that of the last control period."""
        return np.asarray(law.learner.Phi)

    def unknown(self, state: ControllerState) -> Array:
        """Share of the prior variance of Psi that is left on random motion, (p,): 1 nothing learned, 0 all known."""
        Phi = self.random_motion() @ self.basis
        left = np.einsum("nij,jk,nik->i", Phi, self.known(state), Phi)
        return np.asarray(left / np.einsum("nij,nij->i", Phi, Phi))

    def findings(self, state: ControllerState) -> list[str]:
        """Says when the run did not excite what the learner would have to know of other motions."""
        if not self.learning or not np.isfinite(state.values).all():
            return []
        unknown = float(self.unknown(state).max())
        if unknown <= UNKNOWN:
            return []
        return [
            f"{self.name}: not excited: {unknown:.0%} of what it did not know is left, on random motion; what it "
            "learned tracks the motions of this run and is no knowledge of others"
        ]

    def random_motion(self, seed: int = 0) -> Array:
        """Regressors of random motion of unit speed, (samples, p, k0)."""
        rng, p = np.random.default_rng(seed), self.regressor.massless.nu.size
        place = self.regressor.random_position
        return np.array([self.regressor.matrix(place(rng), *standard_normal(rng, (3, p))) for _ in range(SAMPLES)])

    @cached_property
    def _typical(self) -> tuple[Array, Array]:
        """A root of the prior covariance (k0, k0), and orthonormal directions of what it scales that matter."""
        deviation = self.settings.spread * self._sizes()
        root = np.diag(deviation)
        if self.covariance is not None:
            root = cholesky(within_prior(self.covariance, deviation * deviation))
        Y = product(self.random_motion().reshape(-1, self.regressor.size), root)
        _, singular, directions = svd(triangle(Y))
        return root, np.ascontiguousarray(directions[:, singular > RANK * singular[0]])

    def _sizes(self) -> Array:
        """Sizes of the parameters, (k0,): of a typical robot, and of friction some of the gain that the joint feels."""
        own = AdaptiveSettings()
        inertial = sizes_of(self.regressor, self._gains, own.mass, own.size, own.slowest)
        return np.concatenate((inertial, FRICTION * scales(self.regressor, self._gains)))

    @property
    def _gains(self) -> Array:
        """K, (p,); errors as of `law`."""
        m = self.regressor.massless
        return self.positive_gains(Layout(m.base, m.nu.size - m.base, m.offset.size, 0))

    def true_weights(self, theta: Array, start: ControllerState) -> Array | None:
        """Where `theta - theta_0` lies in the directions that matter."""
        root, directions = self._typical
        return product(directions.T, solve(root, theta - self.start()))
