"""Classical controllers, to try before any learner: PD with the gravity of the URDF, and PID.

    pd_gravity    tau = K s + g(q),           g(q) = T' g_full(q)
    pid           tau = K s + I,              I' = rate K s,              s = [z; r] = nu_ref - nu

*Gravity* is that of the robot as its file describes it, at the measured joints: the reduced robot at rest,
`g(q) = Y(q, 0, 0, 0) theta` with the regressor of the robot and the parameters of its file (Takegaki and Arimoto 1981,
J. Dyn. Sys. Meas. Control 103(2), for a constant setpoint). What the experiment makes of the true robot beside its
file, other masses or a payload, it does not know.

*PID.* For a joint `s = edot + k e`, so the integral of s over time is `e + k int e`: K s + I is a PID law of the
position error e with the gains `K k + rate K` on e, `rate K k` on its integral and K on its rate. A joint's
integral is made so, of the change of e in place of its measured rate, which may be filtered, late where nobody told.

*Anti-windup* is conditional integration (Astrom and Hagglund 1995, PID Controllers, 3.5) within the motors' limits.
With u = E^+ (K s + I) of all motors, clipped to their limits, let `K s + I - E clip(u)` be the excess. A velocity whose
s would make its excess larger keeps its integral; the integral alone is clipped to the limits, too. So it never asks a
motor for more than there is, and it turns back with the first sample in which s does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal, NamedTuple, Self

import numpy as np

from ..by_address import by_address
from ..compiled import copy_to, internal, linked
from ..errors import ConfigError
from ..model.regressor import Massless, Regressor, measured, regress
from ..parts import Matrix, Vector, layout_of, views
from ..settings import Settings, require_numbers
from ..signals import INDEX, Array, IntArray, Layout
from .controller import CompiledController, Context, ControllerSettings, ControllerState, Feedback, Law
from .law import KERNELS, Kernels, MotorLimits, constant_gain, limit, motor_limits, nothing_to_keep
from .model_based import ConstantGain

POSE, VELOCITY, Q, QDOT, SHAPE = (INDEX[name] for name in ("pose", "velocity", "q", "qdot", "shape"))
TIME, E, EDOT, Z, R = (INDEX[name] for name in ("time", "e", "edot", "z", "r"))
PSI_HAT, EFFECTIVE_GAIN = INDEX["psi_hat"], INDEX["effective_gain"]
WEIGHT_NORM = INDEX["weight_norm"]
ROUNDING = 1e-9  # part of a torque below which an excess is rounding


@by_address
class Gravity(NamedTuple):
    """The numbers of a PD with gravity."""

    known: Massless  # how the robot moves, and room to work in
    theta: Array  # (k,) parameters of its bodies as the file has them
    rest: Array  # (p,) zeros


@linked
def gravity(row: Array, at: IntArray, a: Gravity, state: Array) -> None:
    """Psi_hat = g(q) of one sample; arguments as of `law.estimate`."""
    known = a.known
    pose, velocity = row[at[POSE] : at[POSE + 1]], row[at[VELOCITY] : at[VELOCITY + 1]]
    shape = row[at[SHAPE] : at[SHAPE + 1]]
    measured(known, pose, velocity, row[at[Q] : at[Q + 1]], row[at[QDOT] : at[QDOT + 1]], shape)
    copy_to(a.rest, known.nu)
    regress(known, a.rest, a.rest)
    for i in range(a.rest.size):
        total = 0.0
        for j in range(a.theta.size):
            total += known.Y[i, j] * a.theta[j]
        row[at[PSI_HAT] + i] = total


KERNELS[Gravity] = Kernels(gravity, nothing_to_keep)


@dataclass(frozen=True, eq=False, kw_only=True)
class PDGravity(ConstantGain):
    """`tau = K s + g(q)`, g of the robot as its URDF describes it.

    Args:
        feedback: K.
        motion: How the robot moves.
        theta: (k,) its parameters, of `model.tree.body.parameters`; only those of bodies are used.
        name: Name in tables and recordings.
    """

    motion: Regressor
    theta: Array
    name: str = "pd_gravity"

    within_limits: ClassVar[bool] = True

    @classmethod
    def build(cls, given: ControllerSettings) -> Self:
        """With the gravity of the robot's file."""
        return cls(feedback=given.feedback, motion=given.told.motion, theta=given.told.described)

    def law(self, context: Context) -> Law:
        """The gains, and what gives the gravity."""
        theta, p = np.array(self.theta[: self.motion.inertial], float), context.layout.dof
        found = Gravity(self.motion.workspace(), theta, np.zeros(p))
        return Law(constant_gain(self.feedback.vector(context.layout)), found)


class PIDSettings(Settings, frozen=True):
    """How fast a PID controller integrates.

    Args:
        rate: Integral gain over K [1/s]; None for what its loop bears (`loop.rates`), at most 20. A mode of bandwidth
            b, which a chain of links may have far below that of a joint alone, needs `b (k + rate) > k rate` (Routh and
            Hurwitz; k of the filtered error): on some arms that is 0.4.

    Raises:
        ConfigError: A number that is negative or not finite.
    """

    rate: float | None = None

    def __post_init__(self) -> None:
        require_numbers(self, "pid", ())


@dataclass(frozen=True, eq=False)
class Integrating(CompiledController):
    """Controller that integrates beside its feedback; a loop chooses how fast where it is left open (`loop.suited`)."""

    rate_key: ClassVar[str] = "rate"  # name of the rate in its settings
    rate_factor: ClassVar[float] = 1.0  # times the rate of `loop.rates`
    kind: ClassVar[Literal["integral", "model", "observer", "sliding"]] = "integral"  # what it adds, of `loop.rates`

    @property
    def complete(self) -> bool:
        """Whether it has its rate, and its inertias where it needs some."""
        return getattr(self.settings, self.rate_key) is not None and getattr(self, "inertia", ()) is not None

    @property
    def rate(self) -> float:
        """The rate [1/s].

        Raises:
            ConfigError: There is none.
        """
        found = getattr(self.settings, self.rate_key)
        if found is None:
            why, key = "a loop or a stepper chooses it for its robot", f"{self.name}.{self.rate_key}"
            raise ConfigError(f"no {self.rate_key}", why=why, fix="give one, or run it in a Loop", key=key)
        return float(found)

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """The integral, of the next sample and of the last one."""
        return integral_shapes(context.layout)

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The integral, (p,) [N, N m]."""
        return {"integral": state["integral"]}


@by_address
class Integrator(NamedTuple):
    """The numbers of an integral of K s."""

    K: Array  # (p,) feedback gains
    rate: Array  # (p,) what a sample adds to the integral over s; 0 keeps it
    h: float  # control period [s]
    limits: MotorLimits  # of the motors, and room to work in
    beside: Array  # (p,) what is added to K s and the integral; zeros for PID [N, N m]
    asked: Array  # (p,) room to work in
    sent: Array  # (p,) room to work in
    nothing: Array  # (p,) zeros
    layout: IntArray  # of `Integral` in the state


class Integral(NamedTuple):
    """State of the integral: I (p,) of the next sample and of this one, e (n,) and time of this sample and the last."""

    integral: Vector
    used: Vector
    error: Matrix
    instants: Vector


def integral_shapes(layout: Layout) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the parts of `Integral`, to be parts of a `ControllerState`."""
    return {"integral": (layout.dof,), "used": (layout.dof,), "error": (2, layout.arm), "instants": (2,)}


integral_of = views(Integral)


def new_integrator(context: Context, K: Array, rate: float, layout: IntArray) -> Integrator:
    """The numbers of an integral.

    Args:
        context: Control period, and the motors' limits.
        K: (p,) feedback gains.
        rate: Of the integral over K [1/s]; 0 keeps it.
        layout: Of `Integral` in the state.
    """
    given, p = context.limits, context.layout.dof
    limits = unlimited(p) if given is None else given._replace(motors=given.motors.copy(), asked=np.zeros(p))
    (a, b, c, d), h = np.zeros((4, p)), float(context.control_period)
    return Integrator(K, rate * h * K, h, limits, a, b, c, d, layout)


@internal
def go_on(row: Array, at: IntArray, a: Integrator, o: Integral) -> None:
    """The integral of this sample is that of the next one of the last, and the error, too; one that is kept, stays."""
    copy_to(o.integral, o.used)
    if a.rate[0] == 0.0:
        return
    if row[at[TIME]] != o.instants[0]:
        copy_to(o.error[0], o.error[1])
        o.instants[1] = o.instants[0]
    copy_to(row[at[E] : at[E + 1]], o.error[0])
    o.instants[0] = row[at[TIME]]


@linked
def integral(row: Array, at: IntArray, a: Integrator, state: Array) -> None:
    """Psi_hat = I and the gain of one sample; arguments as of `law.estimate`."""
    o, squares = integral_of(state, a.layout), 0.0
    go_on(row, at, a, o)
    for i in range(o.used.size):
        row[at[PSI_HAT] + i], row[at[EFFECTIVE_GAIN] + i] = o.used[i], a.K[i]
        squares += o.used[i] * o.used[i]
    row[at[WEIGHT_NORM]] = math.sqrt(squares)


@linked
def integrate(row: Array, at: IntArray, a: Integrator, state: Array) -> None:
    """The integral of the next sample; the same however often it is called. Arguments as of `law.settle`."""
    integrate_within(row, at, a, state, math.inf)


@linked
def integrate_within(row: Array, at: IntArray, a: Integrator, state: Array, layer: float) -> None:
    """The integral of s clipped to +-layer, otherwise as `integrate`."""
    o, z, r = integral_of(state, a.layout), row[at[Z] : at[Z + 1]], row[at[R] : at[R + 1]]
    for i in range(o.used.size):
        s = z[i] if i < z.size else r[i - z.size]
        a.asked[i] = a.sent[i] = a.K[i] * s + o.used[i] + a.beside[i]
    limit(a.sent, a.nothing, a.limits)
    follows = abs(o.instants[0] - o.instants[1] - a.h) < 0.5 * a.h
    for i in range(o.used.size):
        j = i - z.size
        s, excess = z[i] if j < 0 else r[j], a.asked[i] - a.sent[i]
        winds_up = excess * s > 0.0 and abs(excess) > ROUNDING * abs(a.asked[i])
        if j >= 0 and follows:
            s += (o.error[0, j] - o.error[1, j]) / a.h - row[at[EDOT] + j]
        o.integral[i] = o.used[i] if winds_up else o.used[i] + a.rate[i] * min(max(s, -layer), layer)
    limit(o.integral, a.nothing, a.limits)


KERNELS[Integrator] = Kernels(integral, integrate)


@dataclass(frozen=True, eq=False)
class PID(Integrating):
    """`tau = K s + I`, `I' = rate K s` within the motors' limits.

    Args:
        feedback: K.
        settings: The integral's gain.
        learning: Off keeps the integral as it is.
        name: Name in tables and recordings.
    """

    feedback: Feedback = field(default_factory=Feedback)
    settings: PIDSettings = field(default_factory=PIDSettings)
    learning: bool = True
    name: str = "pid"

    within_limits: ClassVar[bool] = True
    by_velocity: ClassVar[bool] = True

    def law(self, context: Context) -> Law:
        """The numbers of the law; errors as of `positive_gains`."""
        K, layout = self.positive_gains(context.layout), layout_of(Integral, self.shapes(context))
        return Law(constant_gain(K), new_integrator(context, K, self.rate * self.learning, layout))

    def features(self, law: Law, state: ControllerState) -> Array:
        """The integral's factor, 1: every velocity has its own."""
        return np.eye(state["integral"].size)

    def learning_gain(self, state: ControllerState, context: Context) -> Array:
        """Rate times K, (p,)."""
        return np.asarray(self.rate * self.feedback.vector(context.layout))


def unlimited(p: int) -> MotorLimits:
    """Motors without limits, one per velocity."""
    found = motor_limits(np.eye(p), np.ones(p))
    assert found is not None
    return found._replace(effort=np.full(p, np.inf))
