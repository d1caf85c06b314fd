"""The default learner: feedforward of the URDF along the reference with an integral, and what filtered torque teaches.

    tau = Phi_d (theta_0 + lambda (theta - theta_0)) + I + K s,        I' = rate K s,        s = [z; r] = nu_ref - nu

Phi_d are the regressor and the friction features (`friction_features`) of the *desired* motion (Sadegh and Horowitz
1990, Int. J. Robotics Research 9(3)), theta_0 is the robot as its file describes it. So what is learned acts along the
reference and adds no feedback: whatever it learns, the loop has the margins of PD with the integral of `feedforward`.

theta is a Kalman filter's on filtered torque (`filtered`, `linear`), from theta_0 with the doubt that an engineer has
in a file: bodies `BODIES` wrong, rotors and friction unknown. An equation of a velocity counts where that velocity
moves: friction that holds says nothing of friction that slides. The way of a torque to the motion that shows it need
not be told: torque d late is, to first order, one more column,

    Y_f = Phi_f theta + d Y_f',

and Phi_d is taken d ahead along the reference, as far as the filter is sure of d.

What was learned counts as far as it has predicted: lambda_i is the share of the prediction `Phi_f (theta - theta_0)`
that fits best what measured torque has beyond the URDF, over the last `MEMORY` seconds, from 0 to 1. Each equation is
compared before it is learned from, so that is a test on data that the estimate has not seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from ..by_address import by_address
from ..compiled import compiled, copy_to, internal, linked
from ..elementary import exp
from ..elementary.normals import standard_normal
from ..model.regressor import BODY, Massless, Regressor, measured, regress
from ..parts import Matrix, Vector, layout_of, views
from ..settings import Settings, require_numbers
from ..signals import INDEX, Array, IntArray
from .classical import Integral, Integrator, go_on, integral_shapes, integrate, new_integrator
from .controller import (
    CompiledController,
    Context,
    ControllerSettings,
    ControllerState,
    Feedback,
    Law,
    Told,
    read_facts,
)
from .factored import NEGLIGIBLE, dot, measure, variance
from .filtered import Filter, Filtered, low_pass, new_filter, parts, period, remember
from .friction_features import FrictionFeatures, columns, desired_rates, follow, friction, shipped
from .law import KERNELS, Kernels, constant_gain
from .linear import drift, heed

POSE, Q, SHAPE = INDEX["pose"], INDEX["q"], INDEX["shape"]
QDOT_REF, ALPHA, NU_REF, NUDOT_REF = (INDEX[name] for name in ("qdot_ref", "alpha", "nu_ref", "nudot_ref"))
PSI_HAT = INDEX["psi_hat"]
EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["effective_gain"], INDEX["weight_norm"]
BODIES = 0.3  # standard deviation of a body's numbers, relative
SAMPLES = 300  # of random motion
MEMORY = 5.0  # time over which predictions are compared [s]
MOVES = 0.9  # part of the low-pass's time in which a velocity has to have moved
LATEST = 0.03  # largest delay that is believed [s]
LOAD, REACH = 0.1, 0.1  # what an arm may carry, as a share of its mass, and how far out [m]
WIDE = 10.0  # standard deviation of Psi on random motion, over K, of what nothing is known of


class LearnedSettings(Settings, frozen=True):
    """How `learned` learns; all numbers are measured by the feedback, so one set suits robots of any size.

    Args:
        rate: Integral gain over K [1/s].
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
        delay: Standard deviation of the delay that nobody told [s].

    Raises:
        ConfigError: A number that is negative, not finite or 0 where it must not be.
    """

    rate: float = 20.0
    noise: float = 0.2
    drift: float = 1e-4
    pole: float = 7.0
    state_pole: float = 100.0
    interval: float = 0.01
    change: float = 0.1
    load: float = 0.3
    alarm: float = 3.0
    friction: float = 0.2
    constant: float = 0.03
    slowest: float = 0.02
    delay: float = 0.01

    def __post_init__(self) -> None:
        require_numbers(self, "learned", ("noise", "pole", "interval", "friction", "constant", "delay"))


@by_address
class Learned(NamedTuple):
    """The numbers of the learner, and room to work in.

    Attributes:
        known: How the robot moves.
        friction: Friction features.
        integrator: The integral beside it.
        filter: Of torque and features.
        gain: (p,) K.
        learning: Off keeps the estimate.
        every: Samples from one update to the next.
        interval: The same in seconds.
        noise: Variance of an equation that stands for one interval, divided by K_i [m^2/s^2, rad^2/s^2].
        drift: Part of the prior variance that comes back in a second [1/s].
        change: The same of the constants [1/s].
        load: The same of what the arm carries [1/s].
        alarm: As in the settings.
        carrying: Places of what changes most likely.
        theta0: (k,) the robot as its file describes it.
        slowest: Velocity below which an equation does not count.
        forget: What an update leaves of the comparison of predictions.
        Phi: (p, k) room to work in.
        nu: (p,) room to work in.
        nudot: (p,) room to work in.
        q: (n,) room to work in.
        work: (4, k) room to work in.
        layout: Of `Parts` in the state.
    """

    known: Massless
    friction: FrictionFeatures
    integrator: Integrator
    filter: Filter
    gain: Array
    learning: bool
    every: int
    interval: float
    noise: float
    drift: float
    change: float
    load: float
    alarm: float
    carrying: IntArray
    theta0: Array
    slowest: float
    forget: float
    Phi: Array
    nu: Array
    nudot: Array
    q: Array
    work: Array
    layout: IntArray


class Parts(NamedTuple):
    """State of the learner; k columns: those of the regressor, the delay, friction features and constants.

    Attributes:
        W: (1, k) theta.
        U, D: (k, k), (k,) factors of its covariance.
        prior: (k,) largest variances.
        counts: (7,) as in `linear.Parts`.
        expected: (p,) variances of the last equations.
        level: (p,) squares of errors in the last seconds, over K.
        filtered: What the filter remembers.
        moved: (2, p d) friction features of the last sample, and behind the filter of states and torque.
        moving: (p,) part of the low-pass's time in which a velocity has moved.
        before: (p,) filtered torque of the last sample.
        agrees: (2, p) measured torque beyond the URDF times its prediction, and that squared, of the last seconds.
        delay: (1,) how far the reference is looked ahead [s].
        desired: (2, p) acceleration of the desired motion in the last sample, and whether there was one.
        integral: The integral.
    """

    W: Matrix
    U: Matrix
    D: Vector
    prior: Vector
    counts: Vector
    expected: Vector
    level: Vector
    filtered: Filtered
    moved: Matrix
    moving: Vector
    before: Vector
    agrees: Matrix
    delay: Vector
    desired: Matrix
    integral: Integral


parts_of = views(Parts)


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
def feed_forward(row: Array, at: IntArray, a: Learned, o: Parts) -> None:
    """Psi_hat, the gain and the norm of one sample."""
    squares = 0.0
    desired_motion(row, at, a, o)
    go_on(row, at, o.integral)
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
def share(o: Parts, i: int) -> float:
    """Part of what was learned of velocity i that counts: lambda_i."""
    if not o.agrees[1, i] > 0.0:
        return 0.0
    return min(max(o.agrees[0, i] / o.agrees[1, i], 0.0), 1.0)


@internal
def desired_motion(row: Array, at: IntArray, a: Learned, o: Parts) -> None:
    """Features (p, k) of the desired motion as far ahead as the delay is known, into a.Phi; their delay's are 0."""
    known, p, nb, delay = a.known, a.gain.size, at[ALPHA + 1] - at[ALPHA], o.delay[0]
    for i in range(p):
        nu, nudot = desired_rates(row, at, i)
        jerk = (nudot - o.desired[0, i]) / a.filter.h if o.desired[1, i] > 0.0 else 0.0
        a.nu[i] = nu + delay * nudot
        a.nudot[i] = row[at[NUDOT_REF] + i] + delay * jerk
        columns(a.friction, i, a.nu[i], nudot + delay * jerk, a.Phi)
        if a.learning:
            o.desired[0, i], o.desired[1, i] = nudot, 1.0
    for i in range(a.q.size):
        a.q[i] = row[at[Q] + i] + delay * row[at[QDOT_REF] + i]
    pose, shape = row[at[POSE] : at[POSE + 1]], row[at[SHAPE] : at[SHAPE + 1]]
    measured(known, pose, a.nu[:nb], a.q, a.nu[nb:], shape)
    regress(known, a.nu, a.nudot)
    for i in range(p):
        copy_to(known.Y[i], a.Phi[i, : known.Y.shape[1]])


@internal
def learn(row: Array, at: IntArray, a: Learned, o: Parts) -> None:
    """The update by one sample."""
    f, known = a.filter, a.known
    now = int(o.counts[0]) % a.every == 0 or o.counts[5] > 0.0
    o.counts[0] += 1.0
    o.counts[6] += 1.0
    follows = period(row, at, f, o.filtered)
    if o.filtered.clock[1] <= 1.0:
        o.counts[3], o.counts[4], o.counts[5] = 0.0, 0.0, 0.0
    for i in range(a.gain.size):
        nu, nudot = desired_rates(row, at, i)
        columns(a.friction, i, nu, nudot, a.Phi)
    follow(f, o.filtered, o.moved, a.Phi)
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
def take_in(a: Learned, o: Parts) -> None:
    """Features, torque, its rate and whether velocities move through the low-pass; whether the robot has changed."""
    f, Phi_f, Y_f, late = a.filter, o.filtered.Phi_f, o.filtered.Y_f, a.known.Y.shape[1]
    low_pass(f, a.Phi, o.filtered)
    for i in range(Y_f.size):
        Phi_f[i, late] = (Y_f[i] - o.before[i]) / f.h
        moves = 1.0 if abs(f.nu[i]) > a.slowest else 0.0
        o.moving[i] = f.hold * o.moving[i] + (1.0 - f.hold) * moves
    if a.alarm > 0.0:
        heed(a, o)
    copy_to(Y_f, o.before)


@internal
def predict(a: Learned, o: Parts) -> None:
    """Compare what was learned with the equations of velocities that move, and learn from them; then the drift."""
    k, p, late = o.D.size, a.gain.size, a.known.Y.shape[1]
    Phi_f, Y_f = o.filtered.Phi_f, o.filtered.Y_f
    phi, f, b, time = a.work[0], a.work[1], a.work[2], o.counts[6] * a.filter.h
    for i in range(p):
        if o.moving[i] < MOVES:
            continue
        for j in range(k):
            phi[j] = Phi_f[i, j] / a.gain[i]
        told = dot(a.theta0, phi, k)
        e, late_by = Y_f[i] / a.gain[i] - dot(o.W[0], phi, k), o.W[0, late] * phi[late]
        said = Y_f[i] / a.gain[i] - e - late_by - told
        o.agrees[0, i] = a.forget * o.agrees[0, i] + (e + said) * said
        o.agrees[1, i] = a.forget * o.agrees[1, i] + said * said
        alpha = measure(o.U, o.D, phi, a.noise * a.interval / time, f, b)
        o.expected[i] = alpha
        for j in range(k if alpha > 0.0 else 0):
            o.W[0, j] += e / alpha * b[j]
    drift(a, o, int(o.counts[1]) % k, a.drift * time * k)
    o.counts[1] += 1.0
    for c in range(k - p, k):
        drift(a, o, c, a.change * time)
    for c in range(a.carrying.size):
        drift(a, o, a.carrying[c], a.load * time)
    sure = 1.0 - variance(o.U, o.D, late) / o.prior[late]
    o.delay[0] = max(0.0, sure) * min(max(o.W[0, late], 0.0), LATEST)


KERNELS[Learned] = Kernels(estimate, settle)


@dataclass(frozen=True, eq=False, kw_only=True)
class LearnedFeedforward(CompiledController):
    """`tau = Phi_d (theta_0 + lambda (theta - theta_0)) + I + K s`, theta learned on filtered torque.

    Args:
        feedback: K.
        settings: How it learns.
        motion: How the robot moves.
        theta: (k,) parameters of the robot's file, of `model.tree.body.parameters`.
        learning: Off keeps estimate and integral.
        name: Name in tables and recordings.
    """

    feedback: Feedback = field(default_factory=Feedback)
    settings: LearnedSettings = field(default_factory=LearnedSettings)
    motion: Regressor
    theta: Array
    learning: bool = True
    name: str = "learned"

    within_limits: ClassVar[bool] = True

    @classmethod
    def build(cls, given: ControllerSettings) -> Self:
        """With the model of the robot's file."""
        own = {"feedback": given.feedback, "settings": given.settings, "learning": given.learning}
        return cls(motion=given.told.motion, theta=given.told.described, **own)

    @classmethod
    def from_facts(cls, name: str, facts: dict[str, Any], told: Told) -> Self | None:
        """From gains and settings, with the model of the robot's file."""
        own = read_facts(cls, facts, "feedback", "settings", "learning")
        return cls(motion=told.motion, theta=told.described, **own)

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
            integrator=new_integrator(context, K, own.rate * self.learning, layout_of(Integral, shapes)),
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
            forget=exp(-every * h / MEMORY),
            Phi=np.zeros((p, k)),
            nu=np.zeros(p),
            nudot=np.zeros(p),
            q=np.zeros(context.layout.arm),
            work=np.zeros((4, k)),
            layout=layout_of(Parts, shapes),
        )
        return Law(constant_gain(K), learned)

    def size(self, p: int) -> int:
        """Columns: those of the regressor, the delay, friction features and constants of p velocities."""
        return self.motion.size + 1 + p * (self.features_of + 1)

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """Estimate and covariance, what the filter remembers, the comparison, the integral."""
        p = context.layout.dof
        k, own = self.size(p), dict.fromkeys(("expected", "level", "moving", "before"), (p,))
        own |= integral_shapes(context.layout)
        own |= {"agrees": (2, p), "desired": (2, p), "delay": (1,), "moved": (2, p * self.features_of)}
        return {"W": (1, k), "U": (k, k), "D": (k,), "prior": (k,), "counts": (7,)} | parts(context, p, k) | own

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
        state["prior"][k0] = own.delay**2
        state["prior"][k0 + 1 : -p] = own.friction**2 / d * np.repeat(K, d) ** 2
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
        """The estimate (k,) and the integral (p,)."""
        return {"theta": state["W"][0], "integral": state["integral"]}

    def features(self, law: Law, state: ControllerState) -> Array:
        """Phi, (p, k), of the last equation."""
        learner: Learned = law.learner
        return learner.Phi
