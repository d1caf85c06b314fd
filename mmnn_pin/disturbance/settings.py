"""The disturbances as settings: tables `[[disturbances]]` of an experiment, told apart by their `type`."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import numpy as np

from ..errors import ConfigError
from ..settings import Settings
from ..signals import Array
from .effects import EARLY

MOST = 1e9  # of a push [N, N m, N s, N m s]


class Window(Settings, frozen=True, kw_only=True):
    """A stretch of time.

    Args:
        start: First instant [s].
        end: Where it ends; inf for the end of the run [s].

    Raises:
        ConfigError: Not an interval.
    """

    start: float = 0.0
    end: float = math.inf

    def __post_init__(self) -> None:
        if not 0 <= self.start < self.end:
            raise ConfigError(
                f"from {self.start:g} s to {self.end:g} s", fix="give 0 <= start < end", key="disturbances.start"
            )

    def times(self, times: Array) -> Any:
        """Which of these times lie in it; half a nanosecond early counts, as times are rounded."""
        return (times >= self.start - EARLY) & (times < self.end - EARLY)


class Push(Window, frozen=True, kw_only=True, tag="push"):
    """An external force or torque on one velocity.

    Args:
        on: `v`, `w` (`vx`, `vy`, `w`), or the name of an arm joint.
        shape: "step" is there from start to end; "impulse" is given within the step of the plant at start, whatever
            the end; "sine" starts with phase 0; "noise" is white, held over each control period.
        force: Height of the step, amplitude, or standard deviation [N, N m]; of an impulse its integral [N s, N m s].
        frequency: Of a sine [Hz].

    Raises:
        ConfigError: A force that is not finite or too large, a frequency that is not positive.
    """

    on: str
    force: float
    shape: Literal["step", "impulse", "sine", "noise"] = "step"
    frequency: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not abs(self.force) <= MOST:
            raise ConfigError(f"{self.force}", fix=f"use a number of at most {MOST:.0e}", key="disturbances.force")
        if not (math.isfinite(self.frequency) and self.frequency > 0):
            raise ConfigError(f"{self.frequency} Hz", fix="use a finite number > 0", key="disturbances.frequency")


class Payload(Settings, frozen=True, kw_only=True, tag="payload"):
    """A point mass that the arm picks up; it moves as the arm does when that happens, so nothing jerks.

    Args:
        mass: [kg].
        start: When [s].
        joint: Joint whose link carries it; empty for the last of the arm.
        at: Where, in that joint's frame [m].

    Raises:
        ConfigError: A mass that is not positive, a time that is negative.
    """

    mass: float
    start: float = 0.0
    joint: str = ""
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mass) and self.mass > 0):
            raise ConfigError(f"{self.mass} kg", fix="use a finite number > 0", key="disturbances.mass")
        if not (math.isfinite(self.start) and self.start >= 0):
            raise ConfigError(f"{self.start} s", fix="use a finite time >= 0", key="disturbances.start")
        if not np.all(np.isfinite(self.at)):
            raise ConfigError(f"{self.at}", fix="use finite numbers", key="disturbances.at")


class DeadMotor(Window, frozen=True, kw_only=True, tag="dead_motor"):
    """A motor without current: its joint turns freely.

    Args:
        joint: Joint of the motor, a drive wheel's or the arm's.
    """

    joint: str


class Block(Window, frozen=True, kw_only=True, tag="block"):
    """A joint that is blocked, a wheel or one of the arm: held by friction of 1e4 N m; needs the integrator "stick".

    Args:
        joint: The joint.
    """

    joint: str


class Frozen(Window, frozen=True, kw_only=True, tag="frozen_encoder"):
    """An encoder that keeps its reading.

    Args:
        joint: Joint of the encoder.
    """

    joint: str


class Messages(Window, frozen=True, kw_only=True, tag="messages"):
    """What happens to the messages of the sensors.

    Args:
        fault: "lost": none arrives, as when their process was killed. "late": late by `delay` measurements more.
            "shuffled": every second one is late by `delay`, so that they come out of order. "nan": no numbers.
            "spike": every tenth one is off by `size` in every number.
        delay: Of late and shuffled messages, in measurements.
        size: Of a spike [m, rad, m/s, rad/s].

    Raises:
        ConfigError: A delay out of range, a size that is not finite.
    """

    fault: Literal["lost", "late", "shuffled", "nan", "spike"]
    delay: int = 5
    size: float = 1.0
    EVERY: ClassVar[int] = 10

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.delay <= 10_000:
            raise ConfigError(
                f"{self.delay}", fix="use a whole number of measurements from 1 to 10000", key="disturbances.delay"
            )
        if not math.isfinite(self.size):
            raise ConfigError(f"{self.size}", fix="use a finite number", key="disturbances.size")


class Commands(Window, frozen=True, kw_only=True, tag="commands"):
    """What happens to the torque commands on their way to the motors.

    Args:
        fault: "lost": none arrives and the motors keep what they had. "nan": what arrives is not a number.
    """

    fault: Literal["lost", "nan"]


Disturbance = Push | Payload | DeadMotor | Block | Frozen | Messages | Commands
