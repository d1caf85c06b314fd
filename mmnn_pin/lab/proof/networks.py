"""A learner with the thesis's networks, which can be looked into: their inputs and activations along rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...signals import Array
from ...torque.composite import CompositeNetwork
from ...torque.controller import ControllerState
from ...torque.neural import Neural, channels
from ...torque.residual import Residual
from .learner import Learner, Stepper

NAMES = {1: "base", 2: "arm"}  # of the networks


@dataclass(frozen=True, eq=False)
class Networks(Learner):
    """A learner with a network for the base, one for the arm: the thesis's, on a nominal model, or composite."""

    controller: Neural | Residual | CompositeNetwork

    @property
    def own(self) -> Neural:
        """The thesis's controller in it."""
        controller = self.controller
        if isinstance(controller, Neural):
            return controller
        return controller.own if isinstance(controller, Residual) else controller.learner

    @property
    def networks(self) -> list[tuple[int, slice]]:
        """Number of every network (1 the base's, 2 the arm's) and its velocities."""
        layout = self.context.layout
        parts = {1: slice(0, layout.base), 2: slice(layout.base, layout.dof)}
        return [(i, parts[i]) for i, _ in channels(layout)]


@dataclass(frozen=True, eq=False)
class Seen:
    """What networks with fixed weights do along rows.

    Attributes:
        psi_hat: (N, p) their output [N, N m].
        inputs: (N, nx) what they see.
        activations: Network to (N, h) hidden outputs.
    """

    psi_hat: Array
    inputs: Array
    activations: dict[int, Array]


def seen(learner: Networks, state: ControllerState, rows: Array) -> Seen:
    """What networks with the weights of a memory, held fixed, do along rows (N, width)."""
    stepper = Stepper(learner, state.snapshot(), learning=False)
    psi_hat, inputs = np.zeros((len(rows), learner.context.layout.dof)), np.zeros((len(rows), state["x"].size))
    activations = {i: np.zeros((len(rows), state[f"sigma{i}"].size)) for i, _ in learner.networks}
    x, hidden = stepper.state["x"], {i: stepper.state[f"sigma{i}"] for i in activations}
    for k, row in enumerate(rows):
        psi_hat[k], inputs[k] = stepper.step(row), x
        for i, sigma in hidden.items():
            activations[i][k] = sigma
    return Seen(psi_hat, inputs, activations)
