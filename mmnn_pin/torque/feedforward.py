"""Feedforward of the robot's file along the reference, and an integral: what an engineer writes who has a URDF.

    tau = Y(q, nu_d, nu_d, nudot_ref) theta + K s + I,      I' = rate K s,      s = [z; r] = nu_ref - nu

Y is the regressor of the robot at the velocities nu_d of the reference, and theta the parameters of its file: masses,
and friction where the file states some. What the experiment makes of the true robot beside its file, other masses, a
payload, rotors or friction, it does not know. Velocities of the reference are the desired compensation of Sadegh and
Horowitz 1990 (Int. J. Robotics Research 9(3)): C and friction carry no noise and are no feedback. Joints are the
measured ones, as with `pd_gravity`: where a joint's spring K k is weaker than gravity, gravity along the reference lets
an arm fall off it.

The acceleration is the commanded one, `nudot_ref = [alphadot; qddot_ref + K edot]`. Of a model that is right it leaves

    M s' + K s + I = 0,

stable for any M, K and rate > 0 (with I = rate K x and x' = s, `V = s' M s / 2 + rate x' K x / 2` has `V' = -s' K s`
where M is constant). With the reference's own acceleration, as with `pid`, it is `M (s' - k edot) + K s + I = 0`, and
a slow mode of bandwidth b bears only `rate k < b (k + rate)`: arms of six joints have modes of 0.4 1/s.

What is missed is left to the integral, which is that of `pid` (`classical.integrate`): it does not wind up against the
motors' limits, here with the feedforward beside it. Of a base that steers nu_d is alpha.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from ..by_address import by_address
from ..compiled import linked
from ..model.regressor import Massless, Regressor, measured, regress
from ..parts import layout_of
from ..settings import Settings, require_numbers
from ..signals import INDEX, Array, IntArray
from .classical import Integral, Integrating, Integrator, go_on, integral_of, integrate, new_integrator
from .controller import (
    Context,
    ControllerSettings,
    Feedback,
    Law,
    Told,
    read_facts,
)
from .friction_features import desired_rates
from .law import KERNELS, Kernels, constant_gain

POSE, Q, SHAPE, NUDOT_REF = (INDEX[name] for name in ("pose", "q", "shape", "nudot_ref"))
PSI_HAT, EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["psi_hat"], INDEX["effective_gain"], INDEX["weight_norm"]


class FeedforwardSettings(Settings, frozen=True):
    """How fast the integral beside a feedforward is.

    Args:
        rate: Integral gain over K [1/s]; None for what its loop bears (`loop.rates`), at most 20.

    Raises:
        ConfigError: A number that is negative or not finite.
    """

    rate: float | None = None

    def __post_init__(self) -> None:
        require_numbers(self, "feedforward", ())


@by_address
class Forward(NamedTuple):
    """The numbers of a feedforward."""

    known: Massless  # how the robot moves, and room to work in
    theta: Array  # (k,) its parameters as its file has them
    nu: Array  # (p,) room to work in
    nudot: Array  # (p,) room to work in
    integrator: Integrator  # what is integrated, with the feedforward beside it


@linked
def forward(row: Array, at: IntArray, a: Forward, state: Array) -> None:
    """Psi_hat of one sample, feedforward and integral, and the gain; arguments as of `law.estimate`."""
    own, squares = a.integrator, 0.0
    o = integral_of(state, own.layout)
    go_on(row, at, own, o)
    nb, pose, q = a.known.base, row[at[POSE] : at[POSE + 1]], row[at[Q] : at[Q + 1]]
    for i in range(o.used.size):
        a.nu[i], _ = desired_rates(row, at, i)
        a.nudot[i] = row[at[NUDOT_REF] + i]
    measured(a.known, pose, a.nu[:nb], q, a.nu[nb:], row[at[SHAPE] : at[SHAPE + 1]])
    regress(a.known, a.nu, a.nudot)
    for i in range(o.used.size):
        total = 0.0
        for j in range(a.theta.size):
            total += a.known.Y[i, j] * a.theta[j]
        own.beside[i] = total
        row[at[PSI_HAT] + i], row[at[EFFECTIVE_GAIN] + i] = total + o.used[i], own.K[i]
        squares += o.used[i] * o.used[i]
    row[at[WEIGHT_NORM]] = math.sqrt(squares)


@linked
def follow(row: Array, at: IntArray, a: Forward, state: Array) -> None:
    """The integral of the next sample; arguments as of `law.settle`."""
    integrate(row, at, a.integrator, state)


KERNELS[Forward] = Kernels(forward, follow)


@dataclass(frozen=True, eq=False, kw_only=True)
class Feedforward(Integrating):
    """`tau = Y theta + K s + I` along the reference, theta of the robot's file."""

    feedback: Feedback = field(default_factory=Feedback)  # K
    settings: FeedforwardSettings = field(default_factory=FeedforwardSettings)  # the integral's gain
    motion: Regressor  # how the robot moves
    theta: Array  # (k,) its parameters, of `model.tree.body.parameters`
    learning: bool = True  # off keeps the integral as it is
    name: str = "feedforward"  # name in tables and recordings

    within_limits: ClassVar[bool] = True
    by_velocity: ClassVar[bool] = True
    kind: ClassVar[Literal["integral", "model", "observer", "sliding"]] = "model"

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

    def law(self, context: Context) -> Law:
        """The numbers of the law; errors as of `positive_gains`."""
        K, p = self.positive_gains(context.layout), context.layout.dof
        integrator = new_integrator(context, K, self.rate * self.learning, layout_of(Integral, self.shapes(context)))
        room = np.zeros(p), np.zeros(p)
        found = Forward(self.motion.workspace(), np.array(self.theta, float), *room, integrator)
        return Law(constant_gain(K), found)
