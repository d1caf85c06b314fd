"""The true robot: `ideal`, whose wheels roll exactly, and `contact`, whose wheels may slip.

`Plant` is what a loop needs of one.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..model.robot import Robot
from ..model.tree.twin import Terms
from ..signals import Array, Layout

NO_PUSH: Array = np.zeros(0)


class Plant(Protocol):
    """A robot that moves under torques that are held over a step.

    Attributes:
        y: (nv + p + 1,) position, nu and the work done on the robot since the start; not finite once it is lost.
        position: View of the position in y.
        nu: View of nu in y.
        hold: (nv,) friction of joints that are blocked, written by the loop [N m or N].
        dynamics: Reduced dynamics of the robot at the present state.
    """

    y: Array
    position: Array
    nu: Array
    hold: Array
    dynamics: Terms

    def start(self, position: Array, nu: Array) -> None:
        """Put the robot at a position (nv,) with velocity nu (p,) and no work done."""

    def refresh(self) -> None:
        """Evaluate M and h at the present state; `step` starts from there."""

    def step(self, tau: Array, pushed: Array = NO_PUSH) -> None:
        """Advance by the plant's step under a generalized torque (p,); `pushed` is the part that motors do not give."""

    def carry(self, robot: Robot) -> None:
        """Go on with a robot that carries more."""

    def motor_speeds(self, speeds: Array) -> None:
        """Write the speed of every motor's joint, (motors,) [rad/s or m/s]."""

    def respond(self, tau: Array, E: Array, free: Array, answer: Array) -> None:
        """Write how fast motors turn at the end of a step: see `integrators.respond`."""

    def observe(self, row: Array, layout: Layout) -> None:
        """Write what only this plant knows into a row of signals."""

    def findings(self) -> list[str]:
        """Findings of the run so far, a line each."""
