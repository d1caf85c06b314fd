"""A learner on top of a nominal model: `Psi_hat = Psi_0 + network`, so the network learns only the difference.

Psi_0 is a known function of measured and commanded signals, so the thesis's closed loop and its proof hold as they
stand with `Psi - Psi_0` in the place of Psi: what has to be small is the distance of that difference from a network.
(A rigid-body model and something learned for what it leaves: Nguyen-Tuong and Peters 2010, Using model knowledge for
learning inverse dynamics, IEEE ICRA.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

from ..signals import Array, Dimensions
from .controller import CompiledController, Context, ControllerSettings, ControllerState, Feedback, Law, Told
from .neural import Neural

if TYPE_CHECKING:
    from ..model.robot import Robot


PROJECTION = 100.0  # bound on the weights unless told, as of `Neural`


@dataclass(frozen=True, eq=False)
class TwoLayerResidual(CompiledController):
    """`tau = k s + Psi_0 + network + robust term`: a network of the thesis with a nominal model taken out of it."""

    learner: Neural  # the network with its feedback and robust term
    model: Robot | None = None  # the nominal robot; None for the loop's
    learning: bool = True  # off keeps the weights as they are
    projection: float | None = PROJECTION  # bound on the weights, as of `Neural`; takes the place of the learner's
    name: str = "two_layer_residual"  # name in tables and recordings

    within_limits: ClassVar[bool] = True

    @classmethod
    def build(cls, given: ControllerSettings) -> Self:
        """With the thesis's network, and the nominal robot."""
        learner, bound = Neural.build(given), given.networks["projection"]
        return cls(learner, given.told.nominal, given.learning, PROJECTION if bound is None else bound)

    @property
    def feedback(self) -> Feedback:  # type: ignore[override]
        """k1, k2."""
        return self.learner.feedback

    @property
    def uses_model(self) -> bool:
        """Psi of the nominal robot is added."""
        return True

    @property
    def networks(self) -> Neural:
        """The network's controller, as it is called and learns here."""
        learning = self.learning and self.learner.learning
        return replace(self.learner, called=self.name, learning=learning, projection=self.projection, adds_model=True)

    @property
    def excited_by(self) -> tuple[str, ...]:
        """The network's."""
        return self.learner.excited_by

    @property
    def notes(self) -> list[str]:
        """The network's notes."""
        return self.networks.notes

    def law(self, context: Context) -> Law:
        """The network's numbers; the loop writes the model's Psi into psi_hat."""
        return self.networks.law(context)

    def init(self, context: Context) -> ControllerState:
        """Initial weights of the network."""
        return self.networks.init(context)

    def feedback_gain(self, layout: Dimensions) -> Array:
        """The network's, (p,)."""
        return self.networks.feedback_gain(layout)

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The network's."""
        return self.networks.weights(state)

    def facts(self) -> dict[str, Any]:
        """The network's settings and those of the model."""
        if self.model is None:
            return self.networks.facts()
        model = {k: v for k, v in self.model.facts().items() if k not in ("urdf", "urdf_sha256")}
        return self.networks.facts() | {"model": model}

    def findings(self, state: ControllerState) -> list[str]:
        """Findings in the network's weights."""
        return self.networks.findings(state)

    @classmethod
    def from_facts(cls, name: str, facts: dict[str, Any], told: Told) -> Self | None:
        """None: the recording's experiment says the nominal robot."""
        return None
