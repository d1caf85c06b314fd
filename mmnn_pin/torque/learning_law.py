"""A learning law of your own in plain Python: `tau = K s + Psi_hat`, `s = [z; r]`, with Psi_hat and its learning yours.

    class MyLaw(LearningLaw):
        rate: float = 10.0  # annotated attributes are its settings

        def init(self, wiring):
            return Memory.of(W=(50, wiring.layout.dof))

        def estimate(self, now, memory):
            return features(now) @ memory["W"]

        def learn(self, now, memory):
            memory["W"] += self.rate * now.period * np.outer(features(now), now.s)

The loop does the rest: it adds the feedback, which is the same for all controllers of an experiment, and records
Psi_hat, gains and weights, so that all monitors work. Such a law runs in the ordinary loop.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, dataclass_transform

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ConfigError, UnknownName
from ..settings import plain
from ..signals import Array, Layout, Measurement, Setpoint, VelocityCommand
from .controller import Context, ControllerState, Feedback, TorqueController
from .now import Now


@dataclass_transform(frozen_default=True, kw_only_default=True)
@dataclass(frozen=True, kw_only=True, eq=False)
class LearningLaw(TorqueController):
    """`tau = K s + Psi_hat` with `init`, `estimate` and `learn` of your own.

    Annotated attributes of a child are settings: keyword arguments, and keys of a table `[laws.NAME]` of an experiment.
    A child is frozen; all that changes during a run is in its `ControllerState`, so that it can be frozen, resumed and
    recorded.

    Attributes:
        name: Name in tables and recordings; that of the class unless it says.
        learned: Names of the parts of the memory that are weights: they are recorded at intervals, their norm at every
            sample, and a supervisor bounds them. Empty for all parts.
        within_limits: Whether Psi_hat takes of the motors' limits only what the feedback leaves, unless the loop says.
        knows_motion: Whether it is told how the robot moves, never what it weighs: `now.regressor`.

    Args:
        feedback: K; an experiment gives its own.
        learning: Off holds the weights fixed: `learn` is not called.
    """

    feedback: Feedback = field(default_factory=Feedback)
    learning: bool = True

    learned: ClassVar[tuple[str, ...]] = ()
    knows_motion: ClassVar[bool] = False
    within_limits: ClassVar[bool] = True

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if "__init__" in cls.__dict__:
            raise TypeError(f"{cls.__name__} has an __init__: write its settings as annotated attributes instead")
        if "name" not in cls.__dict__:
            cls.name = cls.__name__
        dataclass(frozen=True, kw_only=True, eq=False)(cls)

    @abstractmethod
    def init(self, context: Context) -> ControllerState:
        """Memory for a new run: `ControllerState.of(name=shape, ...)`, zeros to be filled."""

    @abstractmethod
    def estimate(self, now: Now, state: ControllerState) -> Array:
        """What is taken for Psi at this sample, (p,) [N, N m]: `M nudot_ref + C nu_ref + gravity + friction`."""

    @abstractmethod
    def learn(self, now: Now, state: ControllerState) -> None:
        """Change the memory in place; called after `estimate` of the same sample."""

    def features(self, now: Now, state: ControllerState) -> Array | None:
        """What the weights are multiplied with, if Psi_hat is linear in them: `mmnn prove` then tells their excitation.

        (p, k) where all components share the k weights, (k,) where each has its own; None for none of these.
        """
        return None

    def gain(self, state: ControllerState) -> ArrayLike | None:
        """Gamma where the law follows s by `W' = Gamma Phi' s + ...`, if it has `features` Phi.

        One number, (k,) for a diagonal or (k, k), positive definite; a sample changes W by the control period times W'.
        With it `mmnn prove` has the weights' part of the Lyapunov function; None leaves that out.
        """
        return None

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The parts of the memory that are `learned`.

        Raises:
            UnknownName: It has no part of that name.
        """
        for part in self.learned:
            if part not in state.shapes:
                raise UnknownName(f"part of the memory of {self.name}", part, state.shapes, key="learned")
        return {part: state[part] for part in self.learned or state.shapes}

    def feedback_gain(self, layout: Layout) -> Array:
        """K, (p,)."""
        return self.feedback.vector(layout)

    def facts(self) -> dict[str, Any]:
        """All settings, as JSON has them."""
        return {f.name: plain(getattr(self, f.name)) for f in fields(self)}

    def step(
        self, time: float, reference: Setpoint, measurement: Measurement, command: VelocityCommand, state: Any
    ) -> Array:
        """Not for this kind of controller: the loop calls `estimate` and `learn`.

        Raises:
            ConfigError: Always.
        """
        raise ConfigError(f"{self.name} has no step", fix="call estimate and learn, as `control.Torque` does")


def norms(weights: dict[str, Array], layout: Layout) -> tuple[float, float]:
    """Norm of the weights that serve the base, and of those that serve the arm.

    Matrices with a column per velocity are split; whatever else there is counts with the first.
    """
    squares = [0.0, 0.0]
    for array in weights.values():
        split = array.ndim == 2 and array.shape[1] == layout.dof
        first, rest = (array[:, : layout.base], array[:, layout.base :]) if split else (array, array[:0])
        squares[0] += float(np.vdot(first, first))
        squares[1] += float(np.vdot(rest, rest))
    return squares[0] ** 0.5, squares[1] ** 0.5
