"""The learner of a run, built again, and its steps over rows: its weights at every sample, and what fixed ones say.

A controller stepped again over the rows of its run, each with the torque of the sample before it still in place, gives
the weights of every sample; with learning switched off it gives what fixed weights say of any rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...loop.controller import Torque
from ...model.robot import Robot
from ...signals import Array
from ...torque.controller import CompiledController, Context, ControllerState, Feedback, TorqueController

Controller = CompiledController | TorqueController


@dataclass(frozen=True, eq=False)
class Learner:
    """A learner and its weights.

    Attributes:
        controller: Its settings; one with a field `learning`.
        context: What it was told before the run.
        start: Its memory before the first row.
        end: Its memory at the end, or the last one that is known.
        end_time: When that is [s].
        robot: The robot whose model it adds, where it uses the loop's.
    """

    controller: Any
    context: Context
    start: ControllerState
    end: ControllerState
    end_time: float
    robot: Robot

    @property
    def feedback(self) -> Feedback:
        """Its gains K."""
        found: Feedback = self.controller.feedback
        return found

    def frozen(self) -> Any:
        """The controller with its weights held fixed."""
        return replace(self.controller, learning=False)


class Stepper:
    """A controller stepped over rows of a recording, one after the other; the rows are not changed.

    Args:
        learner: The learner.
        state: Its memory, changed in place.
        learning: Off holds its weights fixed.

    Attributes:
        row: (width,) the row that was stepped last, as the controller left it.
        torque: The controller wired to it.
    """

    def __init__(self, learner: Learner, state: ControllerState, learning: bool = True) -> None:
        layout = learner.context.layout
        controller = learner.controller if learning else learner.frozen()
        self.state, self.row = state, layout.new_row()
        self._time, self._torque = layout.where("time").start, layout.where("torque")
        self.psi_hat, self._sent = self.row[layout.where("psi_hat")], np.zeros(layout.dof)
        self.torque = Torque(controller, learner.context, self.row, learner.robot, state)

    def step(self, row: Array) -> Array:
        """Output at a row (width,), a view (p,) that the next step overwrites; a learner learns from it."""
        self.row[:] = row
        self.psi_hat[:] = 0.0  # one that says nothing leaves it as it was
        self.row[self._torque] = self._sent  # a controller finds what was sent last
        self.torque.step(float(row[self._time]))
        self._sent[:] = self.row[self._torque] = row[self._torque]
        self.torque.keep()
        return self.psi_hat

    @property
    def known(self) -> Array:
        """Psi_hat of the last step as the weights say it, before the motors' limits take of it, (p,), a view."""
        limits = self.torque.limits
        return self.psi_hat if limits is None else limits.asked

    def features(self) -> Array | None:
        """What the weights are multiplied with at the last step, (rows, k), a copy; None where it does not tell."""
        found = self.torque.features()
        return None if found is None else np.array(np.atleast_2d(found), float)


def said(learner: Learner, state: ControllerState, rows: Array, every: int = 1) -> Array:
    """What the weights of a memory, held fixed, say along rows (N, width): Psi_hat of every so many of them, (k, p).

    It is what they know: before the motors' limits take of it.
    """
    stepper = Stepper(learner, state.snapshot(), learning=False)
    found = np.zeros((-(-len(rows) // every), learner.context.layout.dof))
    for n, row in enumerate(rows):
        stepper.step(row)
        if n % every == 0:
            found[n // every] = stepper.known
    return found
