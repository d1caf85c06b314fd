"""Controllers that learn nothing: PD, PD at a learner's effective gain, computed torque.

Only computed torque uses a model: its own, or the *nominal* robot of the run; with the true robot it is the oracle.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from ..errors import ConfigError
from ..parts import layout_of
from ..signals import Array, Dimensions
from .controller import CompiledController, Context, ControllerSettings, ControllerState, Feedback, Law
from .law import SCHEDULED_GAIN, Schedule, constant_gain, packed

if TYPE_CHECKING:
    from ..model.robot import Robot


@dataclass(frozen=True)
class ConstantGain(CompiledController):
    """`tau = Psi_hat + k s`, `s = [z; r]`, with nothing learned: a gain that never changes."""

    feedback: Feedback = field(default_factory=Feedback)  # k1, k2

    def law(self, context: Context) -> Law:
        """The gains; for one that uses a model the loop writes its Psi into psi_hat."""
        return Law(constant_gain(self.feedback.vector(context.layout)))

    @classmethod
    def build(cls, given: ControllerSettings) -> Self:
        """With the gains of the experiment."""
        return cls(given.feedback)

    def facts(self) -> dict[str, Any]:
        """Nothing: the gains of the experiment say all."""
        return {}


@dataclass(frozen=True)
class PD(ConstantGain):
    """`tau = k s`, `s = [z; r]`: the feedback of (3.39) alone.

    Args:
        feedback: k1, k2.
        name: Name in tables and recordings.

    >>> robot = load("platform_arm")
    >>> loop = Loop(robot, Trajectory.of(robot, base=Line(speed=0.3)), PD())
    >>> loop.controller.feedback.complete(robot.dimensions)  # gains that suit the robot
    True
    """

    name: str = "pd"


@dataclass(frozen=True, eq=False)
class ComputedTorque(ConstantGain):
    """`tau = Psi + k s` with Psi of the nominal model at the measured state (Slotine-Li form with known parameters).

    Args:
        feedback: k1, k2.
        model: The robot that it believes in; None for the loop's nominal one.
        name: Name in tables and recordings.
    """

    model: Robot | None = None
    name: str = "computed_torque"

    @classmethod
    def build(cls, given: ControllerSettings) -> Self:
        """With the gains of the experiment; `nominal` is told of the nominal robot, the oracle believes the loop's."""
        return cls(given.feedback, given.told.nominal if given.name == "nominal" else None, given.name)

    def facts(self) -> dict[str, Any]:
        """The facts of its model; none where it believes the loop's."""
        return {} if self.model is None else {"model": self.model.facts()}

    @property
    def uses_model(self) -> bool:
        """Psi of the nominal robot is added."""
        return True


@dataclass(frozen=True, eq=False)
class ScheduledPD(CompiledController):
    """`tau = k(t) s` with a gain given for every sample.

    With the effective gain of a learner's run it is that learner with the network's output taken away: what is left
    of the learner's advantage over this controller is learning, the rest is gain.
    """

    gains: Array  # (samples, p) gain on `[z; r]` of every control sample
    name: str = "pd_effective"  # name in tables and recordings

    def law(self, context: Context) -> Law:
        """The gains are in the state."""
        return Law(packed(SCHEDULED_GAIN, np.zeros((1, context.layout.dof)), layout_of(Schedule, self.shapes(context))))

    @classmethod
    def build(cls, given: ControllerSettings) -> Self:
        """At the gains of a learner's run.

        Raises:
            ConfigError: They are not given.
        """
        if given.gains is None:
            why = "it takes the gain that a learner had at every sample of a run"
            raise ConfigError(f"{given.name} without gains", why=why, fix="run both with `mmnn run`", key="controller")
        return cls(given.gains, given.name)

    def facts(self) -> dict[str, Any]:
        """Nothing: its gains are in the state."""
        return {}

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """The number of the sample, and the gains."""
        return {"counter": (1,), "gains": self.gains.shape}

    def init(self, context: Context) -> ControllerState:
        """The counter and the gains; after the end of a table (of a run that ended early) its last gain stays.

        Raises:
            ConfigError: The table has no rows, not p columns, or a number that is not finite.
        """
        p = context.layout.dof
        if self.gains.ndim != 2 or self.gains.shape[1] != p or not len(self.gains) or not np.isfinite(self.gains).all():
            fix = f"give (samples, {p}), all finite"
            raise ConfigError(f"gains of shape {self.gains.shape}", fix=fix, key="gains")
        state = super().init(context)
        state["gains"][:] = self.gains
        return state

    def feedback_gain(self, layout: Dimensions) -> Array:
        """Largest gain of the schedule, (p,)."""
        return np.asarray(self.gains.max(axis=0))
