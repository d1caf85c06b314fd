"""Pushes and windows of time at one step of the plant, compiled."""

from __future__ import annotations

import math

from ..compiled import compiled
from ..signals import Array

# Columns of the table of pushes.
ON, SHAPE, FORCE, FREQUENCY, START, END, PUSH = range(7)
STEP, IMPULSE, SINE, NOISE = range(4)
SHAPES = {"step": STEP, "impulse": IMPULSE, "sine": SINE, "noise": NOISE}
BRAKE = 1e4  # torque or force by which a blocked joint is held [N m or N]
EARLY = 5e-10  # half a nanosecond early counts, as times are rounded [s]


@compiled
def push(time: float, dt: float, table: Array, gust: Array, force: Array) -> None:
    """Sum of all pushes over one step of the plant.

    Args:
        time: Start of the step [s].
        dt: Step [s].
        table: (k, PUSH) pushes.
        gust: (k,) random numbers of this control sample.
        force: (p,) written [N, N m].
    """
    force[:] = 0.0
    middle = time + 0.5 * dt
    for i in range(table.shape[0]):
        start, end, shape = table[i, START], table[i, END], int(table[i, SHAPE])
        if middle < start - EARLY or (middle >= end - EARLY and shape != IMPULSE):
            continue
        value = table[i, FORCE]
        if shape == IMPULSE:
            value = value / dt if middle - dt < start - EARLY else 0.0
        elif shape == SINE:
            value *= math.sin(2.0 * math.pi * table[i, FREQUENCY] * (middle - start))
        elif shape == NOISE:
            value *= gust[i]
        force[int(table[i, ON])] += value


@compiled
def mark(time: float, table: Array, marks: Array, value: float) -> None:
    """Set `marks[joint]` to a value for all windows (joint, start, end) that are open, to 0 for the others."""
    for i in range(table.shape[0]):
        marks[int(table[i, 0])] = 0.0
    for i in range(table.shape[0]):
        if table[i, 1] <= time + EARLY and time + EARLY < table[i, 2]:
            marks[int(table[i, 0])] = value
