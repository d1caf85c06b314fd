"""Messages that take their time: how old a measurement is when it is used, and when a command reaches the motors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from ..actuator import Drive
from ..by_address import by_address
from ..compiled import internal
from ..errors import ConfigError
from ..settings import Settings, Timing, require_gain, require_gains
from ..signals import EARLY, Array, IntArray

LONGEST = 1.0  # latency that may be [s]


class Latency(Settings, frozen=True):
    """How long a measurement and a command are under way between robot and controller.

    Args:
        sensing: Age of a measurement when it is used [s]; a whole number of measurements in a simulation.
        command: Delay from the control sample to the motors [s], rounded to steps of the plant.
        jitter: Largest further delay of a command, drawn anew for each; none overtakes another [s].
        margin: Delay margin that a loop should have beyond these [s]; less is reported. Lower feedback gains have more.
        predict: Whether a measurement is moved on as the reference has moved since it was taken (`loop.lead.catch_up`);
            this needs a measurement at every control sample.

    Raises:
        ConfigError: A number that is negative, not finite or above a second.
    """

    sensing: float = 0.0
    command: float = 0.0
    jitter: float = 0.0
    margin: float = 0.003
    predict: bool = False

    def __post_init__(self) -> None:
        require_gains(self, "latency")
        for name in ("sensing", "command", "jitter", "margin"):
            if (value := getattr(self, name)) > LONGEST:
                fix = f"give seconds, as {value / 1e3:g} for {value:g} ms"
                raise ConfigError(f"{value:g} s", why="no loop bears that", fix=fix, key=f"latency.{name}")

    @classmethod
    def of(cls, latency: float | Latency, predict: bool | None) -> Latency:
        """A latency out of a number [s]: the command's delay, or with `predict` the measurement's.

        Raises:
            ConfigError: It is negative or not finite.
        """
        if isinstance(latency, Latency):
            return latency if predict is None else replace(latency, predict=predict)
        require_gain(latency, "latency")
        return cls(sensing=latency, predict=True) if predict else cls(command=latency)

    @property
    def total(self) -> float:
        """All of it at its longest [s]."""
        return self.sensing + self.command + self.jitter

    def caught_up(self, timing: Timing) -> float:
        """By how much a measurement is brought up to now [s].

        Raises:
            ConfigError: There is none at some control samples, and what was brought up once is kept there.
        """
        if not self.predict:
            return 0.0
        if timing.measurement_period > timing.control_period * (1 + 1e-9):
            why = f"the sensors measure every {timing.measurement_period:g} s, the controller acts every"
            why += f" {timing.control_period:g} s"
            fix = "use latency.predict = false, or a shorter time.sensor_period"
            raise ConfigError("a measurement that is not new at every sample", why=why, fix=fix, key="latency.predict")
        return self.sensing

    def way(self, timing: Timing) -> float:
        """How long ago, on average, a torque was asked for that a measurement shows when it is used [s]."""
        return self.sensing - self.caught_up(timing) + self.command + 0.5 * self.jitter

    def measurements(self, timing: Timing) -> int:
        """Measurements by which the sensors are late.

        Raises:
            ConfigError: Not a whole number.
        """
        late = round(self.sensing / timing.measurement_period)
        if abs(late * timing.measurement_period - self.sensing) > EARLY:
            why = f"the sensors measure every {timing.measurement_period:g} s"
            fix = "give a multiple of that, a shorter time.sensor_period, or latency.command"
            raise ConfigError(f"{self.sensing:g} s", why=why, fix=fix, key="latency.sensing")
        return late

    def in_force(self, timing: Timing, rng: np.random.Generator) -> IntArray:
        """Number of the command in force at every step of the plant, -1 before the first; (0,) without delay."""
        if self.command + self.jitter == 0.0:
            return np.zeros(0, np.int64)
        steps, numbers = timing.steps_per_control, np.arange(timing.samples)
        late = self.command + self.jitter * rng.random(timing.samples)
        arrivals = numbers * steps + np.round(late / timing.plant_step).astype(np.int64)
        arrivals = np.maximum.accumulate(arrivals)
        return np.searchsorted(arrivals, np.arange(timing.samples * steps), side="right").astype(np.int64) - 1

    def slots(self, timing: Timing) -> int:
        """How many commands may be under way at once."""
        late = self.command + self.jitter
        return 0 if late == 0.0 else math.ceil(late / timing.control_period) + 2


@by_address
class Transport(NamedTuple):
    """The way of the commands to the motors, on which each is late."""

    dt: float  # step of the plant [s]
    in_force: IntArray  # (steps,) see `Latency.in_force`
    sent: Array  # (slots, motors) state: the last commands, command k in row k modulo slots

    @internal
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Put the command that has arrived in place of the one that is sent."""
        slots, n = self.sent.shape[0], int(time / self.dt + 0.5)
        last = self.in_force[min(n, self.in_force.size - 1)]
        for i in range(wire.torque.size):
            self.sent[k % slots, i] = wire.torque[i]
            wire.torque[i] = self.sent[last % slots, i] if last >= 0 else 0.0
