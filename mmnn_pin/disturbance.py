"""What happens to a robot during a run: pushes, a payload, joints that fail or block, messages that are lost or wrong.

A disturbance is a table of its own, `[[disturbances]]` with a `type`. Pushes are generalized forces on one velocity of
nu: they are the `f` of `M nudot + C nu + gravity + friction = tau + f`, and the signal `disturbance` records them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import numpy as np

from .compiled import compiled
from .errors import ConfigError, UnknownName
from .model.robot import Robot
from .settings import Settings
from .signals import Array
from .timing import Timing

# Columns of the table of pushes.
ON, SHAPE, FORCE, FREQUENCY, START, END, PUSH = range(7)
STEP, IMPULSE, SINE, NOISE = range(4)
SHAPES = {"step": STEP, "impulse": IMPULSE, "sine": SINE, "noise": NOISE}
BRAKE = 1e4  # torque or force by which a blocked joint is held [N m or N]


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
        return (times >= self.start - 5e-10) & (times < self.end - 5e-10)


class Push(Window, frozen=True, kw_only=True, tag="push"):
    """An external force or torque on one velocity.

    Args:
        on: `v`, `w` (`vx`, `vy`, `w`), or the name of an arm joint.
        shape: "step" is there from start to end; "impulse" is given within one step of the plant; "sine" starts with
            phase 0; "noise" is white, held over each control period.
        force: Height of the step, amplitude, or standard deviation [N, N m]; of an impulse its integral [N s, N m s].
        frequency: Of a sine [Hz].

    Raises:
        ConfigError: A number that is not finite.
    """

    on: str
    force: float
    shape: Literal["step", "impulse", "sine", "noise"] = "step"
    frequency: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("force", "frequency"):
            if not math.isfinite(getattr(self, name)):
                raise ConfigError(f"{getattr(self, name)}", fix="use a finite number", key=f"disturbances.{name}")


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
TYPES: dict[str, Any] = {
    str(kind.__struct_config__.tag): kind for kind in (Push, Payload, DeadMotor, Block, Frozen, Messages, Commands)
}


def of_type(kind: type, disturbances: Sequence[Disturbance]) -> list[tuple[int, Any]]:
    """Disturbances of one type with their places in the list."""
    return [(i, one) for i, one in enumerate(disturbances) if isinstance(one, kind)]


def place(name: str, names: Sequence[str], key: str) -> int:
    """Place of a joint or velocity.

    Raises:
        UnknownName: It is none of them.
    """
    if name not in names:
        raise UnknownName("joint", name, names, key=key)
    return list(names).index(name)


def pushes(disturbances: Sequence[Disturbance], robot: Robot) -> Array:
    """Table of the pushes, (k, PUSH).

    Raises:
        UnknownName: A push on a velocity that the robot does not have.
    """
    rows = [
        [place(one.on, robot.velocity_names, f"disturbances.{i}.on"), SHAPES[one.shape], one.force, one.frequency,
         one.start, one.end]
        for i, one in of_type(Push, disturbances)
    ]  # fmt: skip
    return np.array(rows, float).reshape(-1, PUSH)


def gusts(disturbances: Sequence[Disturbance], samples: int, rng: np.random.Generator) -> Array:
    """Random numbers of the pushes of shape "noise", (samples, k), zeros for the others; (0, 0) without any."""
    found = of_type(Push, disturbances)
    if not any(one.shape == "noise" for _, one in found):
        return np.zeros((0, 0))
    streams = rng.spawn(len(found))
    return np.column_stack(
        [
            stream.standard_normal(samples) * (one.shape == "noise")
            for stream, (_, one) in zip(streams, found, strict=True)
        ]
    )


def windows(kind: type, disturbances: Sequence[Disturbance], names: Sequence[str]) -> Array:
    """Joint, start and end of the disturbances of one type, (k, 3); places in the names.

    Raises:
        UnknownName: A joint that is not among the names.
    """
    rows = [
        [place(one.joint, names, f"disturbances.{i}.joint"), one.start, one.end]
        for i, one in of_type(kind, disturbances)
    ]
    return np.array(rows, float).reshape(-1, 3)


def payload(disturbances: Sequence[Disturbance]) -> tuple[str, Payload | None]:
    """The payload of a run and its key.

    Raises:
        ConfigError: There are two.
    """
    found = of_type(Payload, disturbances)
    if len(found) > 1:
        raise ConfigError("a second payload", fix="one run picks up one payload", key=f"disturbances.{found[1][0]}")
    return (f"disturbances.{found[0][0]}", found[0][1]) if found else ("", None)


def lateness(disturbances: Sequence[Disturbance], timing: Timing) -> Array:
    """Further delay of every message in measurements, (measurements,), -1 for one that is lost."""
    late = np.zeros(timing.measurements)
    times = np.arange(timing.measurements) * timing.measurement_period
    for _, one in of_type(Messages, disturbances):
        inside = one.times(times)
        if one.fault == "lost":
            late[inside] = -1.0
        elif one.fault in ("late", "shuffled"):
            odd = np.arange(late.size) % 2 == 1
            here = inside & (late >= 0) & (odd if one.fault == "shuffled" else True)
            late[here] = np.maximum(late[here], one.delay)
    return late


def corruption(disturbances: Sequence[Disturbance], timing: Timing) -> Array:
    """What is added to all numbers of every message, (measurements,)."""
    added = np.zeros(timing.measurements)
    times = np.arange(timing.measurements) * timing.measurement_period
    for _, one in of_type(Messages, disturbances):
        inside = one.times(times)
        if one.fault == "nan":
            added[inside] = np.nan
        elif one.fault == "spike":
            added[inside & (np.arange(added.size) % one.EVERY == 0)] += one.size
    return added


def commands(disturbances: Sequence[Disturbance], timing: Timing) -> Array:
    """What becomes of every torque command, (samples,): 0 it arrives, 1 it is lost, 2 it is not a number."""
    fate = np.zeros(timing.samples)
    times = np.arange(timing.samples) * timing.control_period
    for _, one in of_type(Commands, disturbances):
        fate[one.times(times)] = 1.0 if one.fault == "lost" else 2.0
    return fate


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
        if middle < start or middle >= end:
            continue
        value = table[i, FORCE]
        if shape == IMPULSE:
            value = value / dt if middle - dt < start else 0.0
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
        if table[i, 1] <= time + 5e-10 and time + 5e-10 < table[i, 2]:
            marks[int(table[i, 0])] = value
