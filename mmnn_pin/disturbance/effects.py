"""Pushes and blocked joints at one step of the plant, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import compiled, internal
from ..elementary import sin
from ..signals import EARLY, Array

# Columns of the table of pushes.
ON, SHAPE, FORCE, FREQUENCY, START, END, PUSH = range(7)
STEP, IMPULSE, SINE, NOISE = range(4)
SHAPES = {"step": STEP, "impulse": IMPULSE, "sine": SINE, "noise": NOISE}
NOTHING: Array = np.zeros(0)
BRAKE = 1e4  # torque or force by which a blocked joint is held [N m or N]


@by_address
class Forces(NamedTuple):
    """Forces of the world on a robot over one step of the plant."""

    force: Array  # (p,) on nu [N, N m]
    position: Array = NOTHING  # (nv,) where the robot is; (0,) where nothing asks for it
    nu: Array = NOTHING  # (p,) how it moves, likewise
    by_hand: Array = NOTHING  # (p,) what of `force` acts at a frame, `J' F`, likewise
    hand: Array = NOTHING  # (6,) where that is in the world, and F [m, N], likewise
    n: Array = NOTHING  # (3,) direction of u of a base that steers, likewise


@by_address
class Pushes(NamedTuple):
    """Forces and torques on single velocities, one after the other."""

    dt: float  # step of the plant [s]
    table: Array  # (k, PUSH) one row per push
    gusts: Array  # (samples, k) random numbers of the shape "noise", (0, 0) without any

    @internal
    def act(self, wire: Forces, k: int, time: float) -> None:
        """Add the pushes of the step that begins at a time, in control sample k."""
        table, middle = self.table, time + 0.5 * self.dt
        for i in range(table.shape[0]):
            start, shape, value = table[i, START], int(table[i, SHAPE]), table[i, FORCE]
            if not (middle < start - EARLY or (middle >= table[i, END] - EARLY and shape != IMPULSE)):
                if shape == IMPULSE:
                    value = value / self.dt if middle - self.dt < start - EARLY else 0.0
                elif shape == SINE:
                    value *= sin(2.0 * math.pi * table[i, FREQUENCY] * (middle - start))
                elif shape == NOISE:
                    value *= self.gusts[k, i]
                wire.force[int(table[i, ON])] += value


@compiled
def block(time: float, windows: Array, hold: Array) -> None:
    """Hold the joints that are blocked now.

    Args:
        time: [s].
        windows: (k, 3) place of the joint in the position, start and end [s].
        hold: (nv,) friction of blocked joints, written: `BRAKE` where a window is open, 0 where all are over.
    """
    for i in range(windows.shape[0]):
        hold[int(windows[i, 0])] = 0.0
    for i in range(windows.shape[0]):
        if windows[i, 1] <= time + EARLY and time + EARLY < windows[i, 2]:
            hold[int(windows[i, 0])] = BRAKE
