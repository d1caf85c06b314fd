"""A disturbance observer: one constant per velocity that stands for all of Psi, learned with leakage, within bounds.

    tau = d_hat + K s,      d_hat' = gamma K s - leakage d_hat,      |d_hat_i| <= bound K_i,      s = [z; r]

It is the integral action that an engineer would add first, and knows nothing of the robot. Psi that does not change,
such as gravity at rest, it learns exactly where nothing leaks; Psi that changes it follows, and does not know. With
`V = s' M s / 2 + d~' (gamma K)^-1 d~ / 2` of a constant d, V' has `-s' K s` and the leakage alone; the bounds project
onto a box, which no d within it is farther from than before. Every sample is one Euler step; the torque uses d_hat from
before it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import linked
from ..elementary import exp
from ..parts import Vector, layout_of, views
from ..settings import Settings, require_numbers
from ..signals import INDEX, Array, IntArray
from .controller import CompiledController, Context, ControllerState, Feedback, Law
from .law import KERNELS, Kernels, constant_gain, nothing_to_keep

Z, R, PSI_HAT = INDEX["z"], INDEX["r"], INDEX["psi_hat"]
EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["effective_gain"], INDEX["weight_norm"]


class DisturbanceObserverSettings(Settings, frozen=True):
    """How a disturbance observer learns; measured by the feedback, so one set suits robots of any size.

    Args:
        gamma: How fast it answers s: the integral gain over K [1/s].
        leakage: How fast it forgets [1/s].
        bound: Largest torque that is believed, over K: the velocity error that would ask for it [m/s, rad/s].

    Raises:
        ConfigError: A number that is negative, not finite or 0 where it must not be.
    """

    gamma: float = 5.0
    leakage: float = 0.01
    bound: float = 1.0

    def __post_init__(self) -> None:
        require_numbers(self, "disturbance_observer", ("bound",))


@by_address
class Observer(NamedTuple):
    """The numbers of a disturbance observer.

    Attributes:
        K: (p,) feedback gains.
        learning: Off keeps the estimate.
        rate: gamma times the control period.
        keep: What leakage leaves of the estimate in a sample.
        bound: (p,) largest estimate [N, N m].
        layout: Of `Observed` in the state.
    """

    K: Array
    learning: bool
    rate: float
    keep: float
    bound: Array
    layout: IntArray


class Observed(NamedTuple):
    """State of the observer: d_hat (p,)."""

    d: Vector


observed_of = views(Observed)


@linked
def estimate(row: Array, at: IntArray, a: Observer, state: Array) -> None:
    """Psi_hat = d_hat and the gain of one sample, then the update; arguments as of `law.estimate`."""
    d, z, r, squares = observed_of(state, a.layout).d, row[at[Z] : at[Z + 1]], row[at[R] : at[R + 1]], 0.0
    for i in range(d.size):
        s = z[i] if i < z.size else r[i - z.size]
        row[at[PSI_HAT] + i], row[at[EFFECTIVE_GAIN] + i] = d[i], a.K[i]
        squares += d[i] * d[i]
        if a.learning:
            d[i] = min(max(a.keep * d[i] + a.rate * a.K[i] * s, -a.bound[i]), a.bound[i])
    row[at[WEIGHT_NORM]] = math.sqrt(squares)


KERNELS[Observer] = Kernels(estimate, nothing_to_keep)


@dataclass(frozen=True, eq=False)
class DisturbanceObserver(CompiledController):
    """`tau = d_hat + K s`.

    Args:
        feedback: K.
        settings: Rates and bound.
        learning: Off keeps the estimate.
    """

    feedback: Feedback = field(default_factory=Feedback)
    settings: DisturbanceObserverSettings = field(default_factory=DisturbanceObserverSettings)
    learning: bool = True
    name: str = "disturbance_observer"

    within_limits: ClassVar[bool] = True

    def law(self, context: Context) -> Law:
        """The numbers of the law; errors as of `positive_gains`."""
        K, h, own = self.positive_gains(context.layout), float(context.control_period), self.settings
        layout = layout_of(Observed, self.shapes(context))
        observer = Observer(K, self.learning, own.gamma * h, exp(-own.leakage * h), own.bound * K, layout)
        return Law(constant_gain(K), observer)

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """The estimate."""
        return {"d": (context.layout.dof,)}

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The estimate, (p,) [N, N m]."""
        return {"d": state["d"]}

    def features(self, law: Law, state: ControllerState) -> Array:
        """The estimate's factor, 1: every velocity has its own."""
        return np.eye(state["d"].size)

    def learning_gain(self, state: ControllerState, context: Context) -> Array:
        """Gamma K, (p,)."""
        return np.asarray(self.settings.gamma * self.feedback.vector(context.layout))
