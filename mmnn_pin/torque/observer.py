"""Observers of a disturbance: the model and the memory that they share, and how they are made.

Every velocity alone has the model `m nudot = u - d` with its effective inertia m; d is all the rest, coupling included.
The estimate is added to the torque, `tau = K s + m nudot_ref + d_hat`. What a period tells of d are the torque that was
sent at its beginning, behind limits and supervisor, and the velocities at both ends. So an estimate does not wind up
where a motor is at its limit: it is of the torque that there was. A period counts only where the sample before it is
one control period ago, and where nothing is no number.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from ..by_address import by_address
from ..compiled import compiled, copy_to, internal
from ..errors import ConfigError
from ..parts import Vector, layout_of, views
from ..signals import INDEX, Array, IntArray
from .classical import Integrating
from .controller import Context, ControllerSettings, ControllerState, Feedback, Law, Told, read_facts
from .law import constant_gain

TIME, VELOCITY, QDOT, TORQUE = (INDEX[name] for name in ("time", "velocity", "qdot", "torque"))
PSI_HAT, NUDOT_REF = INDEX["psi_hat"], INDEX["nudot_ref"]
EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["effective_gain"], INDEX["weight_norm"]


@by_address
class Model(NamedTuple):
    """The model of every velocity alone."""

    h: float  # control period [s]
    K: Array  # (p,) feedback gains
    inertia: Array  # (p,) m [kg, kg m^2]
    learning: bool  # off keeps the estimate
    layout: IntArray  # of `Seen` in the state


class Seen(NamedTuple):
    """State of an observer."""

    d: Vector  # (p,) d_hat [N, N m]
    x: Vector  # (p,) velocities as predicted, of one that predicts
    sigma: Vector  # (p,) acceleration that the prediction lacks, of one that adapts it
    nu: Vector  # (p,) velocities of the last sample
    torque: Vector  # (p,) what was sent from then on
    when: Vector  # (1,) its time [s]


seen_of = views(Seen)


@compiled
def speed(row: Array, at: IntArray, i: int) -> float:
    """Measured velocity i of nu."""
    nb = at[VELOCITY + 1] - at[VELOCITY]
    return row[at[VELOCITY] + i] if i < nb else row[at[QDOT] + i - nb]


@internal
def follows(row: Array, at: IntArray, a: Model, o: Seen) -> bool:
    """Whether a sample ends a period that tells something; if not, what predicts begins anew from it."""
    told = a.learning and 0.5 * a.h < row[at[TIME]] - o.when[0] < 1.5 * a.h
    for i in range(o.d.size):
        told = told and math.isfinite(speed(row, at, i)) and math.isfinite(o.nu[i]) and math.isfinite(o.torque[i])
    if a.learning and not told:
        for i in range(o.d.size):
            o.x[i], o.sigma[i] = speed(row, at, i), -o.d[i] / a.inertia[i]
    return told


@internal
def answer(row: Array, at: IntArray, a: Model, o: Seen) -> None:
    """Psi_hat and the gain of a sample."""
    squares = 0.0
    for i in range(o.d.size):
        row[at[PSI_HAT] + i] = a.inertia[i] * row[at[NUDOT_REF] + i] + o.d[i]
        row[at[EFFECTIVE_GAIN] + i] = a.K[i]
        squares += o.d[i] * o.d[i]
    row[at[WEIGHT_NORM]] = math.sqrt(squares)


@internal
def keep(row: Array, at: IntArray, a: Model, state: Array) -> None:
    """Keep what the next sample looks back at; the same however often it is called."""
    if a.learning:
        o = seen_of(state, a.layout)
        copy_to(row[at[TORQUE] : at[TORQUE + 1]], o.torque)
        for i in range(o.nu.size):
            o.nu[i] = speed(row, at, i)
        o.when[0] = row[at[TIME]]


@dataclass(frozen=True, eq=False)
class ByInertia(Integrating):
    """A controller that integrates, told one inertia per velocity."""

    feedback: Feedback = field(default_factory=Feedback)  # K
    settings: Any = None  # with its bandwidth
    # (p,) effective inertias m; None for those by which gains that suit the robot are scaled
    inertia: tuple[float, ...] | None = None
    learning: bool = True  # off keeps what it integrates

    within_limits: ClassVar[bool] = True
    rate_key: ClassVar[str] = "bandwidth"

    @classmethod
    def build(cls, given: ControllerSettings) -> Self:
        """With the inertias that scale the gains."""
        return cls(given.feedback, given.settings, given.inertia, given.learning)

    @classmethod
    def from_facts(cls, name: str, facts: dict[str, Any], told: Told) -> Self | None:
        """From gains, settings and inertias."""
        return cls(**read_facts(cls, facts, "feedback", "settings", "inertia", "learning"))

    def facts(self) -> dict[str, Any]:
        """Gains, settings and inertias."""
        return super().facts() | {"inertia": self.inertia}


@dataclass(frozen=True, eq=False)
class DisturbanceObserver(ByInertia):
    """`tau = K s + m nudot_ref + d_hat`. Args are those of `ByInertia`."""

    kind: ClassVar[Literal["integral", "model", "observer", "sliding"]] = "observer"

    @abstractmethod
    def observer(self, model: Model) -> Any:
        """The numbers of the observer of a model."""

    def law(self, context: Context) -> Law:
        """The numbers of the law; errors as of `positive_gains` and `rate`."""
        K, layout = self.positive_gains(context.layout), layout_of(Seen, self.shapes(context))
        m = masses_of(self.inertia, context.layout.dof, self.name)
        return Law(constant_gain(K), self.observer(Model(float(context.control_period), K, m, self.learning, layout)))

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """Estimate, prediction, and what a period is made of."""
        each: tuple[int, ...] = (context.layout.dof,)
        return dict.fromkeys(Seen._fields, each) | {"when": (1,)}

    def init(self, context: Context) -> ControllerState:
        """Zeros, and no sample yet."""
        state = super().init(context)
        state["when"] = -np.inf
        return state

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The estimate, (p,) [N, N m]."""
        return {"d": state["d"]}


def masses_of(inertia: tuple[float, ...] | None, p: int, name: str) -> Array:
    """Effective inertias as an array (p,).

    Raises:
        ConfigError: There are none, not p, or one that is not above 0.
    """
    m = np.array(() if inertia is None else inertia, float)
    if m.shape != (p,) or not (m > 0).all():
        why = "a loop or a stepper finds them for its robot"
        raise ConfigError(f"inertias {inertia}", why=why, fix=f"give {p} numbers > 0", key=f"{name}.inertia")
    return m
