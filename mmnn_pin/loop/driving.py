"""A loop in real time around a stepper: read, step, write, record, wait; and odometry by velocities."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from ..elementary import cos_sin
from ..recording.recording import Recording
from ..reference.wishes import Wish
from ..settings.arguments import checked, faced
from ..signals import Array, Measurement
from .servo import Command
from .stepper import Stepper

SMALL = 1e-4  # angle whose sine is its series up to the third power [rad]


@runtime_checkable
class Bus(Protocol):
    """The face of a robot's own driver to `drive`."""

    def read(self) -> Measurement | None:
        """The measurement of now; None where nothing came."""

    def write(self, command: Command) -> None:
        """Send a command, NaN where another interface holds."""


@checked
def drive(
    stepper: Stepper,
    driver: Bus,
    seconds: float,
    wish: Callable[[float], Wish | tuple[Wish, ...] | None],
    clock: Callable[[], float] = time.perf_counter,
    sleep: Callable[[float], None] = time.sleep,
) -> Recording:
    """One sample a period: read, step, write, record, wait. It ends when the time is over or a stop has ended.

    Args:
        stepper: What is in between.
        driver: The robot.
        seconds: How long [s].
        wish: What the robot should do from a time [s] on, as of `Stepper.step`.
        clock: What tells the time [s].
        sleep: What waits some seconds.

    Raises:
        RecordingError: The recording cannot be written.

    >>> class Standing:
    ...     def read(self):
    ...         return Measurement(np.zeros(0), np.zeros(0), np.zeros(2), np.zeros(2))
    ...     def write(self, command):
    ...         pass
    >>> with Stepper(load("two_axis_arm"), PD()) as stepper:
    ...     drive(stepper, Standing(), 0.02, lambda t: None).outcome.status
    'completed'
    """
    began = clock()
    for k in range(round(seconds / stepper.period)):
        if stepper.is_over:
            break
        now = clock() - began
        driver.write(stepper.step(now, driver.read(), wish(now)))
        stepper.record()
        sleep(max(0.0, began + (k + 1) * stepper.period - clock()))
    return stepper.finish()


@faced
class DeadReckoning:
    """Where a base is that tells its velocity alone.

    Attributes:
        pose: (3,) x, y, phi, from where it was made [m, m, rad].

    >>> DeadReckoning().move([1.0, np.pi], 1.0).round(6).tolist()  # half a circle of 1/pi
    [0.0, 0.63662, 3.141593]
    """

    def __init__(self) -> None:
        self.pose: Array = np.zeros(3)

    def move(self, velocity: Array, seconds: float) -> Array:
        """The pose after a time at a velocity (v, w) or (vx, vy, w) in the body's axes, a copy."""
        turn = 0.5 * seconds * velocity[-1]
        c, s = cos_sin(self.pose[2] + turn)
        aside = velocity[1] if len(velocity) == 3 else 0.0
        chord = seconds * (cos_sin(turn)[1] / turn if abs(turn) > SMALL else 1.0 - turn * turn / 6.0)
        self.pose += chord * (c * velocity[0] - s * aside), chord * (s * velocity[0] + c * aside), 2.0 * turn
        return self.pose.copy()
