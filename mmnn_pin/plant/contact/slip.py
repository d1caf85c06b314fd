"""What the wheels did in a run: when they slipped, how fast, and how much of their grip they used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...model.robot import Robot
from ...signals import Array

SLIPPING = 0.01  # a wheel whose contact point moves faster than this slips; contacts creep by less than 2 mm/s [m/s]


@dataclass
class Slip:
    """Sums over a run.

    Args:
        wheels: Their joints.
        dt: Time between two samples [s].

    Attributes:
        samples: Samples so far.
        slipping: Those in which a wheel slipped.
        first: The first of them, -1 for none.
        fastest: Largest slip [m/s].
        wheel: The wheel that had it.
        ended: What ended the run, with its time; empty if nothing did.
    """

    wheels: tuple[str, ...]
    dt: float
    samples: int = 0
    slipping: int = 0
    first: int = -1
    fastest: float = 0.0
    wheel: str = ""
    ended: str = ""

    def take(self, speed: Array) -> None:
        """Take the speeds (wheels,) of the contact points over the floor [m/s]."""
        self.samples += 1
        worst = float(speed.max(initial=0.0))
        if worst <= SLIPPING:
            return
        self.slipping += 1
        if self.first < 0:
            self.first = self.samples
        if worst > self.fastest:
            self.fastest, self.wheel = worst, self.wheels[int(speed.argmax())]

    def end(self, what: str) -> None:
        """Say what ended the run; the first word counts."""
        self.ended = self.ended or f"{what} at t = {self.samples * self.dt:.3g} s"

    def findings(self) -> list[str]:
        """One line per thing to tell, none for wheels that rolled."""
        found = []
        if self.slipping:
            found.append(
                f"the wheels slipped for {self.slipping * self.dt:.3g} s, first at t = {self.first * self.dt:.3g} s, "
                f"by up to {self.fastest:.3g} m/s ('{self.wheel}')"
            )
        return [*found, self.ended] if self.ended else found


def sliding_rows(robot: Robot) -> tuple[Array, Array]:
    """Two (wheels, nv) maps from all velocities to each contact point's over the floor: along the wheel and across."""
    base, names = robot.base, robot.full_velocity_names
    along, across = np.zeros((2, len(base.wheels), len(names)))
    for i, wheel in enumerate(base.wheels):
        along[i, :3], across[i, :3] = base.rolling_rows[i], base.to_control[1] + wheel.x * base.to_control[2]
        along[i, names.index(wheel.joint)] = -wheel.sign * wheel.radius
    return along, across
