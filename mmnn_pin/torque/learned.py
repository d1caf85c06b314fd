"""The default learner: feedforward of the URDF along the reference with an integral, and what filtered torque teaches.

    tau = Phi_d (theta_0 + lambda (theta - theta_0)) + I + K s,        I' = rate K s,        s = [z; r] = nu_ref - nu

theta_0 is the robot as its file describes it, and Phi_d what `feedforward` takes: the regressor at the velocities of
the reference, with friction features (`friction_features`) beside it. So what is learned acts along the reference, and
adds no more feedback than the model of a file does: whatever friction it learns, the loop has the margins of
`feedforward`. With theta = theta_0 it is `feedforward`.

theta is a Kalman filter's on filtered torque (`filtered`, `linear`). It starts at theta_0 with the doubt that an
engineer has in a file: bodies `BODIES` wrong, rotors and friction unknown. What the arm's end carries may change at any
time, by `LOAD` of the arm's mass. An equation of a velocity counts where that velocity moves: friction that holds says
nothing of friction that slides.

What was learned counts as far as it has predicted what the integral does not answer. Before an equation is learned
from, let beyond_i be the measured torque without that of the file, and said_i = Phi_d (theta - theta_0), of Phi_d with
the reference's own derivative, filtered as Phi_f is. Both pass a low-pass and a high-pass at the integral's rate, as a
torque does until it is an error, while the velocity moves. With their sums a = beyond_i^2, b = beyond_i said_i, c =
said_i^2 of the last `MEMORY` seconds

    lambda_i = b / c (1 - (a c / b^2 - 1) / `EQUATIONS`),

with each factor within [0, 1]. The first is the share of the prediction that fits best. The second is one less the
variance of that share over its square, had it been found of so many independent equations: what fits by chance counts
for nothing. As said_i is of the reference, the noise of velocities, which biases theta by Phi_f and by K s in the
torque, does not confirm itself. Where motors have limits Psi_hat takes of them what the feedback leaves, whatever was
learned (`torque.law`).

What no robot of this file can be is no robot: a hand that is held, a wall. theta stays where

    sum_j (theta_j - theta_0j)^2 / P_0jj <= `BELIEVED`^2,

P_0 the doubt of the start, that of what the end carries times `HEAVY`^2. Where equations lead out of that ball, theta
is scaled back to its rim, and b is 0: what was learned counts for nothing until it has predicted anew. So for any data
what is learned says at most `BELIEVED` times the standard deviation that the file's doubt has for that motion. Nothing
more is claimed of theta.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import compiled, copy_to, internal, linked
from ..elementary import exp
from ..elementary.normals import standard_normal
from ..model.regressor import BODY, Massless, measured, regress
from ..parts import Cube, Matrix, Vector, layout_of, views
from ..settings import require_numbers
from ..signals import INDEX, Array, IntArray
from .classical import Integral, Integrator, go_on, integral_shapes, integrate, new_integrator
from .controller import Context, ControllerState, Law
from .factored import NEGLIGIBLE, covariance, dot, measure
from .feedforward import Feedforward, FeedforwardSettings
from .filtered import Filter, Filtered, low_pass, new_filter, parts, period, remember
from .friction_features import FrictionFeatures, columns, desired_rates, friction, shipped
from .law import KERNELS, Kernels, constant_gain
from .linear import drift, heed

POSE, Q, SHAPE = INDEX["pose"], INDEX["q"], INDEX["shape"]
NUDOT_REF = INDEX["nudot_ref"]
PSI_HAT = INDEX["psi_hat"]
EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["effective_gain"], INDEX["weight_norm"]
BODIES = 0.3  # standard deviation of a body's numbers, relative
SAMPLES = 300  # of random motion
MEMORY = 5.0  # time over which predictions are compared [s]
EQUATIONS = 10.0  # that count as independent among those of `MEMORY` seconds
MOVES = 0.9  # part of the low-pass's time in which a velocity has to have moved
BELIEVED = 8.0  # how far theta may be from the file, over the doubt in it
HEAVY = 3.0  # times that for what an arm's end carries
LOAD, REACH = 0.1, 0.1  # what an arm may carry, as a share of its mass, and how far out [m]
WIDE = 10.0  # standard deviation of Psi on random motion, over K, of what nothing is known of


class LearnedSettings(FeedforwardSettings, frozen=True):
    """How `learned` learns, and integrates as `feedforward` does; one set suits robots of any size.

    Args:
        noise: Standard deviation of the errors of filtered torque, divided by K [m/s, rad/s].
        drift: Part of the prior variance that comes back in a second [1/s].
        pole: Low-pass on features and filtered torque [1/s].
        state_pole: Low-pass on states and torque ahead of the features [1/s]; 0 for none.
        interval: Time from one update to the next [s], at least a control period.
        change: Part of a constant's prior variance that comes back in a second [1/s].
        load: The same of the body at the arm's end, which a load changes [1/s].
        alarm: The robot counts as changed where the square of the errors is this many times that of the last seconds;
            its load is then learned anew. 0 for never.
        friction: Standard deviation of what the friction features say before anything is learned, over K.
        constant: Standard deviation of a constant per velocity, likewise [m/s, rad/s].
        slowest: Velocity below which an equation does not count [m/s, rad/s].

    Raises:
        ConfigError: A number that is negative, not finite or 0 where it must not be.
    """

    noise: float = 0.4
    drift: float = 1e-4
    pole: float = 20.0
    state_pole: float = 100.0
    interval: float = 0.01
    change: float = 0.1
    load: float = 0.3
    alarm: float = 3.0
    friction: float = 0.2
    constant: float = 0.03
    slowest: float = 0.005

    def __post_init__(self) -> None:
        require_numbers(self, "learned", ("noise", "pole", "interval", "friction", "constant"))


@by_address
class Learned(NamedTuple):
    """The numbers of the learner, and room to work in."""

    known: Massless  # how the robot moves
    friction: FrictionFeatures  # friction features
    integrator: Integrator  # the integral beside it
    filter: Filter  # of torque and features
    gain: Array  # (p,) K of `tau = K s + Psi_hat` [N s/m, N m s/rad; N m s/rad or N s/m]
    learning: bool  # off keeps the estimate
    every: int  # samples from one update to the next
    interval: float  # the same in seconds
    noise: float  # variance of an equation that stands for one interval, divided by K_i [m^2/s^2, rad^2/s^2]
    drift: float  # part of the prior variance that comes back in a second [1/s]
    change: float  # the same of the constants [1/s]
    load: float  # the same of what the arm carries [1/s]
    alarm: float  # as in the settings
    carrying: IntArray  # places of what changes most likely
    theta0: Array  # (k,) the robot as its file describes it
    slowest: float  # velocity below which an equation does not count
    answers: float  # rate of the filters ahead of the comparison of predictions: the integral's [1/s]
    forget: float  # what an update leaves of the comparison of predictions
    Phi: Array  # (p, k) room to work in
    nu: Array  # (p,) room to work in
    nudot: Array  # (p,) room to work in
    work: Array  # (4, k) room to work in
    layout: IntArray  # of `LearnedParts` in the state


class LearnedParts(NamedTuple):
    """State of the learner; k columns: those of the regressor, friction features and constants."""

    W: Matrix  # (1, k) theta
    U: Matrix  # (k, k) factor of its covariance, `U D U'`
    D: Vector  # (k,) factor of it
    prior: Vector  # (k,) largest variances
    counts: Vector  # (7,) as in `linear.Parts`
    expected: Vector  # (p,) variances of the last equations
    level: Vector  # (p,) squares of errors in the last seconds, over K
    filtered: Filtered  # what the filter remembers
    desired: Cube  # (3, p, k) Phi_d of the last sample, behind the filter of states and torque, and the low-pass
    moving: Vector  # (p,) part of the low-pass's time in which a velocity has moved
    band: Cube  # (2, 2, p) measured torque beyond the URDF, and its prediction, behind one low-pass and behind two
    agrees: Matrix  # (3, p) their squares and product in the last seconds, beyond^2, beyond said, said^2
    integral: Integral  # the integral


parts_of = views(LearnedParts)


@linked
def estimate(row: Array, at: IntArray, a: Learned, state: Array) -> None:
    """Psi_hat and gain of one sample, then the update; arguments as of `law.estimate`."""
    o = parts_of(state, a.layout)
    feed_forward(row, at, a, o)
    if a.learning:
        learn(row, at, a, o)


@linked
def settle(row: Array, at: IntArray, a: Learned, state: Array) -> None:
    """Keep the torque that is held from this sample on, and the integral of the next one."""
    remember(row, at, parts_of(state, a.layout).filtered)
    integrate(row, at, a.integrator, state)


@internal
def feed_forward(row: Array, at: IntArray, a: Learned, o: LearnedParts) -> None:
    """Psi_hat, the gain and the norm of one sample."""
    squares = 0.0
    desired_motion(row, at, a)
    go_on(row, at, a.integrator, o.integral)
    for i in range(a.gain.size):
        told, learned = 0.0, 0.0
        for j in range(o.D.size):
            told += a.Phi[i, j] * a.theta0[j]
            learned += a.Phi[i, j] * (o.W[0, j] - a.theta0[j])
        a.integrator.beside[i] = told + share(o, i) * learned
        row[at[PSI_HAT] + i] = a.integrator.beside[i] + o.integral.used[i]
        row[at[EFFECTIVE_GAIN] + i] = a.gain[i]
    for j in range(o.D.size):
        squares += (o.W[0, j] - a.theta0[j]) * (o.W[0, j] - a.theta0[j])
    row[at[WEIGHT_NORM]] = math.sqrt(squares)


@compiled
def share(o: LearnedParts, i: int) -> float:
    """Part of what was learned of velocity i that counts: lambda_i."""
    beyond, both, said = o.agrees[0, i], o.agrees[1, i], o.agrees[2, i]
    if not both > 0.0:
        return 0.0
    return min(both / said, 1.0) * max(1.0 - (beyond * said / (both * both) - 1.0) / EQUATIONS, 0.0)


@internal
def desired_motion(row: Array, at: IntArray, a: Learned) -> None:
    """Features (p, k) of the desired motion at the measured joints, nudot_ref for its derivative, into a.Phi."""
    for i in range(a.gain.size):
        a.nudot[i] = row[at[NUDOT_REF] + i]
    along(row, at, a)


@internal
def along(row: Array, at: IntArray, a: Learned) -> None:
    """Features (p, k) of the desired velocities and a.nudot at the measured joints, into a.Phi."""
    known, nb = a.known, a.known.base
    pose, q, shape = row[at[POSE] : at[POSE + 1]], row[at[Q] : at[Q + 1]], row[at[SHAPE] : at[SHAPE + 1]]
    for i in range(a.gain.size):
        a.nu[i], nudot = desired_rates(row, at, i)
        columns(a.friction, i, a.nu[i], nudot, a.Phi)
    measured(known, pose, a.nu[:nb], q, a.nu[nb:], shape)
    regress(known, a.nu, a.nudot)
    for i in range(a.gain.size):
        copy_to(known.Y[i], a.Phi[i, : known.Y.shape[1]])


@internal
def learn(row: Array, at: IntArray, a: Learned, o: LearnedParts) -> None:
    """The update by one sample."""
    f, known = a.filter, a.known
    now = int(o.counts[0]) % a.every == 0 or o.counts[5] > 0.0
    o.counts[0] += 1.0
    o.counts[6] += 1.0
    follows = period(row, at, f, o.filtered)
    if o.filtered.clock[1] <= 1.0:
        o.counts[3], o.counts[4], o.counts[5] = 0.0, 0.0, 0.0
    for i in range(a.gain.size):
        _, a.nudot[i] = desired_rates(row, at, i)
    along(row, at, a)
    follow(f, o.filtered, o.desired, a.Phi)
    if follows:
        nb = a.gain.size - f.q.size
        measured(known, f.pose, f.nu[:nb], f.q, f.nu[nb:], f.shape)
        regress(known, f.nu, f.nudot)
        for i in range(a.gain.size):
            copy_to(known.Y[i], a.Phi[i, : known.Y.shape[1]])
        take_in(a, o)
        if now:
            predict(a, o)
    if now:
        o.counts[6] = 0.0


@internal
def follow(f: Filter, seen: Filtered, desired: Array, Phi: Array) -> None:
    """Phi_d (p, k) of the period that ends with a sample, filtered as its torque is, in place of that in Phi."""
    follows = seen.clock[1] > 1.0
    for i in range(Phi.shape[0]):
        for j in range(Phi.shape[1]):
            mean, before = 0.5 * (desired[0, i, j] + Phi[i, j]), desired[1, i, j] if follows else 0.0
            desired[0, i, j] = Phi[i, j]
            desired[1, i, j] = f.keep * before + (1.0 - f.keep) * mean if follows else 0.0
            Phi[i, j] = mean - f.lag * (desired[1, i, j] - before)
            desired[2, i, j] = f.hold * desired[2, i, j] + (1.0 - f.hold) * f.told[i] * Phi[i, j]


@internal
def take_in(a: Learned, o: LearnedParts) -> None:
    """Features, torque and whether velocities move through the low-pass; whether the robot has just changed."""
    f = a.filter
    low_pass(f, a.Phi, o.filtered)
    for i in range(a.gain.size):
        moves = 1.0 if abs(f.nu[i]) > a.slowest else 0.0
        o.moving[i] = f.hold * o.moving[i] + (1.0 - f.hold) * moves
    if a.alarm > 0.0:
        heed(a, o)


@internal
def predict(a: Learned, o: LearnedParts) -> None:
    """Compare what was learned with the equations of velocities that move, and learn from them; then the drift."""
    k, p = o.D.size, a.gain.size
    Phi_f, Y_f = o.filtered.Phi_f, o.filtered.Y_f
    phi, f, b, time = a.work[0], a.work[1], a.work[2], o.counts[6] * a.filter.h
    for i in range(p):
        if o.moving[i] < MOVES:
            continue
        for j in range(k):
            phi[j] = Phi_f[i, j] / a.gain[i]
        beyond = Y_f[i] / a.gain[i] - dot(a.theta0, phi, k)
        said = (dot(o.W[0], o.desired[2, i], k) - dot(a.theta0, o.desired[2, i], k)) / a.gain[i]
        beyond = unanswered(beyond, a.answers * time, o.band[0], i)
        said = unanswered(said, a.answers * time, o.band[1], i)
        o.agrees[0, i] = a.forget * o.agrees[0, i] + beyond * beyond
        o.agrees[1, i] = a.forget * o.agrees[1, i] + beyond * said
        o.agrees[2, i] = a.forget * o.agrees[2, i] + said * said
        e = Y_f[i] / a.gain[i] - dot(o.W[0], phi, k)
        alpha = measure(o.U, o.D, phi, a.noise * a.interval / time, f, b)
        o.expected[i] = alpha
        for j in range(k if alpha > 0.0 else 0):
            o.W[0, j] += e / alpha * b[j]
    believe(a, o)
    drift(a, o, int(o.counts[1]) % k, a.drift * time * k)
    o.counts[1] += 1.0
    for c in range(k - p, k):
        drift(a, o, c, a.change * time)
    for c in range(a.carrying.size):
        drift(a, o, a.carrying[c], a.load * time)


@internal
def believe(a: Learned, o: LearnedParts) -> None:
    """Scale theta back to what its file's doubt allows; what one beyond that has predicted then counts no more."""
    square = 0.0
    for j in range(o.D.size):
        square += apart(a, o, j)
    for c in range(a.carrying.size):
        square -= (1.0 - 1.0 / (HEAVY * HEAVY)) * apart(a, o, a.carrying[c])
    if not square > BELIEVED * BELIEVED:
        return
    part = BELIEVED / math.sqrt(square)
    for j in range(o.D.size):
        o.W[0, j] = a.theta0[j] + part * (o.W[0, j] - a.theta0[j])
    o.agrees[1] = 0.0


@compiled
def apart(a: Learned, o: LearnedParts, j: int) -> float:
    """Square of how far number j of theta is from the file, over its first variance."""
    x = o.W[0, j] - a.theta0[j]
    return x * x / o.prior[j] if o.prior[j] > 0.0 else 0.0


@compiled
def unanswered(value: float, angle: float, seen: Array, i: int) -> float:
    """A torque of velocity i without what is fast and without what the integral answers, as an error shows it.

    Args:
        value: The torque.
        angle: Rate times time since the last one; 0 where there is no integral, and all of it is unanswered.
        seen: (2, p) what two low-passes in a row remember.
        i: The velocity.
    """
    if angle == 0.0:
        return value
    share = angle / (1.0 + angle)
    seen[0, i] += share * (value - seen[0, i])
    seen[1, i] += share * (seen[0, i] - seen[1, i])
    return float(seen[0, i] - seen[1, i])


@linked
def doubt(a: Learned, state: Array, S: Array) -> None:
    """Covariance of what the estimate says of the last sample, as of `law.doubt`."""
    o = parts_of(state, a.layout)
    covariance(a.Phi, o.U, o.D, a.work[0], S)


KERNELS[Learned] = Kernels(estimate, settle, doubt)


@dataclass(frozen=True, eq=False, kw_only=True)
class LearnedFeedforward(Feedforward):
    """`tau = Phi_d (theta_0 + lambda (theta - theta_0)) + I + K s`, theta learned on filtered torque.

    Args:
        feedback: K.
        settings: How it learns.
        motion: How the robot moves.
        theta: (k,) parameters of the robot's file, of `model.tree.body.parameters`.
        learning: Off keeps estimate and integral.
        name: Name in tables and recordings.
    """

    settings: LearnedSettings = field(default_factory=LearnedSettings)
    name: str = "learned"

    @property
    def features_of(self) -> int:
        """Friction features per velocity."""
        return len(shipped()[1])

    def law(self, context: Context) -> Law:
        """The numbers of the law, with room of its own to work in; errors as of `positive_gains`."""
        K, h, own, p = (
            self.positive_gains(context.layout),
            float(context.control_period),
            self.settings,
            context.layout.dof,
        )
        every, k = max(1, round(own.interval / h)), self.size(p)
        theta0 = np.zeros(k)
        theta0[: self.theta.size] = self.theta
        shapes = self.shapes(context)
        learned = Learned(
            known=self.motion.workspace(),
            friction=friction(),
            integrator=new_integrator(context, K, self.rate * self.learning, layout_of(Integral, shapes)),
            filter=new_filter(context, own.pole, own.state_pole),
            gain=K,
            learning=self.learning,
            every=every,
            interval=every * h,
            noise=own.noise * own.noise,
            drift=own.drift,
            change=own.change,
            load=own.load,
            alarm=own.alarm,
            carrying=self.motion.carrying,
            theta0=theta0,
            slowest=own.slowest,
            answers=self.rate,
            forget=exp(-every * h / MEMORY),
            Phi=np.zeros((p, k)),
            nu=np.zeros(p),
            nudot=np.zeros(p),
            work=np.zeros((4, k)),
            layout=layout_of(LearnedParts, shapes),
        )
        return Law(constant_gain(K), learned)

    def size(self, p: int) -> int:
        """Columns: those of the regressor, friction features and constants of p velocities."""
        return self.motion.size + p * (self.features_of + 1)

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """LearnedParts and covariance, what the filter remembers, the comparison, the integral."""
        p = context.layout.dof
        k = self.size(p)
        own: dict[str, tuple[int, ...]] = {"W": (1, k), "U": (k, k), "D": (k,), "prior": (k,), "counts": (7,)}
        own |= {"expected": (p,), "level": (p,), "moving": (p,), "agrees": (3, p)}
        own |= {"desired": (3, p, k), "band": (2, 2, p)}
        return own | parts(context, p, k) | integral_shapes(context.layout)

    def init(self, context: Context) -> ControllerState:
        """The robot of the file, with the doubt in it."""
        state, K, own = super().init(context), self.feedback.vector(context.layout), self.settings
        p, k0, d = K.size, self.motion.size, self.features_of
        square = (self.typical(K) ** 2).mean(axis=(0, 1))
        matters = square > NEGLIGIBLE * square.max()
        widest = WIDE**2 / matters.sum() * matters / np.where(matters, square, 1.0)
        state["W"][0, :k0] = self.theta
        state["prior"][:k0] = np.minimum(widest, self.doubt() ** 2)
        state["prior"][self.motion.inertial : k0] = widest[self.motion.inertial :]
        loaded = self.motion.carrying
        state["prior"][loaded] = np.minimum(widest, self.doubt(self.heaviest_load()) ** 2)[loaded]
        state["prior"][k0:-p] = own.friction**2 / d * np.repeat(K, d) ** 2
        state["prior"][-p:] = (own.constant * K) ** 2
        state["D"] = state["prior"]
        state["D"][loaded] = np.minimum(widest, self.doubt() ** 2)[loaded]
        return state

    def doubt(self, more: float = 0.0) -> Array:
        """Standard deviations of the file's parameters, (k,): of bodies `BODIES` of their mass and size, else inf.

        Args:
            more: A mass that any of them may carry [kg].
        """
        sd, inertial = np.full(self.motion.size, np.inf), self.motion.inertial
        bodies = zip(self.theta[:inertial].reshape(-1, BODY), sd[:inertial].reshape(-1, BODY), strict=True)
        for one, body in bodies:
            mass = abs(one[0])
            size = math.sqrt(max(one[4] + one[7] + one[9], 0.0) / mass) if mass > 0.0 else 0.0
            mass, size = (max(BODIES * mass, more), max(size, REACH if more else 0.0))
            body[:] = mass * np.array([1.0, size, size, size, *[size * size] * 6])
        return sd

    def heaviest_load(self) -> float:
        """A mass that the arm may well carry: a tenth of its own [kg]."""
        first = BODY * (self.motion.bodies[0] == "root")
        return float(LOAD * np.abs(self.theta[first : self.motion.inertial : BODY]).sum())

    def typical(self, K: Array) -> Array:
        """Regressors of random motion at 1 m/s, 1 rad/s, 1 m/s^2, 1 rad/s^2 over K, (samples, p, k0)."""
        rng = np.random.default_rng(0)
        every = (
            self.motion.matrix(self.motion.random_position(rng), *standard_normal(rng, (3, K.size)))
            for _ in range(SAMPLES)
        )
        return np.array([Y / K[:, None] for Y in every])

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The estimate (1, k), what its predictions are worth (3, p), and the integral (p,)."""
        return {name: state[name] for name in ("W", "agrees", "integral")}

    def features(self, law: Law, state: ControllerState) -> Array:
        """Phi, (p, k), of the last equation."""
        learner: Learned = law.learner
        return learner.Phi
