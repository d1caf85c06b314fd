"""A learner on top of a nominal model: `Psi_hat = Psi_0 + network`, so the network learns only the difference.

Psi_0 is a known function of measured and commanded signals, so the thesis's closed loop and its proof hold as they
stand with `Psi - Psi_0` in the place of Psi: what has to be small is the distance of that difference from a network.
(A rigid-body model and something learned for what it leaves: Nguyen-Tuong and Peters 2010, Using model knowledge for
learning inverse dynamics, IEEE ICRA.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

from ..signals import Array, Layout
from . import law
from .controller import CompiledController, Context, ControllerState, Feedback, Law
from .neural import Neural

if TYPE_CHECKING:
    from ..model.robot import Robot


PROJECTION = 100.0  # bound on the weights unless told, as of `Neural`


@dataclass(frozen=True, eq=False)
class Residual(CompiledController):
    """`tau = k s + Psi_0 + network + robust term`: a network of the thesis with a nominal model taken out of it.

    Args:
        learner: The network with its feedback and robust term.
        model: The nominal robot; None for the loop's.
        learning: Off keeps the weights as they are.
        projection: Bound on the weights, as of `Neural`; takes the place of the learner's.
        name: Name in tables and recordings.
    """

    learner: Neural
    model: Robot | None = None
    learning: bool = True
    projection: float | None = PROJECTION
    name: str = "two_layer_residual"

    within_limits: ClassVar[bool] = True

    @property
    def feedback(self) -> Feedback:
        """k1, k2."""
        return self.learner.feedback

    @property
    def uses_model(self) -> bool:
        """Psi of the nominal robot is added."""
        return True

    @property
    def notes(self) -> list[str]:
        """What the network has to say."""
        return self.own.notes

    def law(self, context: Context) -> Law:
        """The network's numbers; the loop writes the model's Psi into psi_hat."""
        numbers = self.own.law(context)
        numbers.sizes[law.MODEL] = 1
        return numbers

    def init(self, context: Context) -> ControllerState:
        """Initial weights of the network."""
        return self.own.init(context)

    def feedback_gain(self, layout: Layout) -> Array:
        """The network's, (p,)."""
        return self.own.feedback_gain(layout)

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The network's."""
        return self.own.weights(state)

    def facts(self) -> dict[str, Any]:
        """The network's settings and what is told of the model."""
        if self.model is None:
            return self.own.facts()
        told = self.model.facts()
        return self.own.facts() | {"model": {k: v for k, v in told.items() if k not in ("urdf", "urdf_sha256")}}

    def findings(self, state: ControllerState) -> list[str]:
        """What the network's weights show."""
        return self.own.findings(state)

    @property
    def own(self) -> Neural:
        """The network's controller, as it is called and learns here."""
        learning = self.learning and self.learner.learning
        return replace(self.learner, called=self.name, learning=learning, projection=self.projection)
