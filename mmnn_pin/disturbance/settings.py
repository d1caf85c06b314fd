"""The disturbances as settings: tables `[[disturbances]]` of an experiment, told apart by their `type`.

What follows the settings turns those of one run into what the hardware model needs: the pushes as an effect, windows of
time in which joints fail, and for every message and every command what becomes of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import numpy as np

from ..elementary.normals import standard_normal
from ..errors import ConfigError, UnknownName
from ..model.robot import Robot
from ..settings import Settings, Timing
from ..signals import EARLY, Array
from .effects import PUSH, SHAPES, Pushes

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
        shape: "step" is there from start to end; "impulse" is given within the step of the plant at start, whatever the
            end; "sine" starts with phase 0; "noise" is white, held over each control period.
        force: Height of the step, amplitude, or standard deviation [N, N m]; of an impulse its integral [N s, N m s].
        frequency: Frequency of a sine [Hz].

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
        mass: Mass of the load [kg].
        start: When it is picked up [s].
        end: When it is put down, inf for never [s].
        joint: Joint whose link carries it; empty for the last of the arm.
        at: Its place in that joint's frame [m].

    Raises:
        ConfigError: A mass that is not positive, a time that is negative, an end that is not after the start.
    """

    mass: float
    start: float = 0.0
    end: float = math.inf
    joint: str = ""
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mass) and self.mass > 0):
            raise ConfigError(f"{self.mass} kg", fix="use a finite number > 0", key="disturbances.mass")
        if not (math.isfinite(self.start) and self.start >= 0):
            raise ConfigError(f"{self.start} s", fix="use a finite time >= 0", key="disturbances.start")
        if not self.end > self.start:
            what = f"put down at {self.end:g} s, picked up at {self.start:g} s"
            raise ConfigError(what, fix="end after the start", key="disturbances.end")
        if not np.all(np.isfinite(self.at)):
            raise ConfigError(f"{self.at}", fix="use finite numbers", key="disturbances.at")


class DeadMotor(Window, frozen=True, kw_only=True, tag="dead_motor"):
    """A motor without current: its joint turns freely.

    Args:
        joint: Joint of the motor, a drive wheel's or the arm's.
    """

    joint: str


class BlockedJoint(Window, frozen=True, kw_only=True, tag="block"):
    """A joint that is blocked, a wheel or one of the arm: held by friction of 1e4 N m; needs the integrator "stick".

    Args:
        joint: The joint.
    """

    joint: str


class FrozenEncoder(Window, frozen=True, kw_only=True, tag="frozen_encoder"):
    """An encoder that keeps its reading.

    Args:
        joint: Joint of the encoder.
    """

    joint: str


class Messages(Window, frozen=True, kw_only=True, tag="messages"):
    """Messages of the sensors that are lost, late or wrong.

    Args:
        fault: "lost": no message arrives, as if the process was killed. "late": each comes `delay` measurements later.
            "shuffled": every second one comes `delay` later, so that they are out of order. "nan": not a number.
            "spike": every tenth one is off by `size` in every number.
        delay: Delay of late and shuffled messages, in measurements.
        size: Size of a spike [m, rad, m/s, rad/s].

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


class CommandFault(Window, frozen=True, kw_only=True, tag="commands"):
    """Torque commands that are lost or wrong on their way to the motors.

    Args:
        fault: "lost": none arrives and the motors keep what they had. "nan": what arrives is not a number.
    """

    fault: Literal["lost", "nan"]


def require_in_time(disturbances: Sequence[Any], duration: float) -> None:
    """Refuse what would never happen in a run of this duration [s] (`ConfigError`)."""
    for i, one in enumerate(disturbances):
        if one.start >= duration:
            what, why = f"{one.start:g} s", f"the run ends at {duration:g} s"
            raise ConfigError(what, why=why, fix="begin earlier, or run longer", key=f"disturbances.{i}.start")


def require_long_enough(disturbances: Sequence[Any], step: float) -> None:
    """Refuse what could fall between two steps of the plant [s] (`ConfigError`)."""
    for i, one in enumerate(disturbances):
        if isinstance(one, Window) and one.end - one.start < step * (1 - 1e-9):
            what, why = f"{one.end - one.start:g} s long", f"the plant's step is {step:g} s"
            raise ConfigError(what, why=why, fix="end later", key=f"disturbances.{i}.end")


def of_type(kind: type, disturbances: Sequence[Any]) -> list[tuple[int, Any]]:
    """Disturbances of one type with their places in the list."""
    return [(i, one) for i, one in enumerate(disturbances) if isinstance(one, kind)]


def place(name: str, names: Sequence[str], key: str, kind: str = "joint") -> int:
    """Place of a joint or velocity.

    Raises:
        UnknownName: It is none of them.
    """
    if name not in names:
        raise UnknownName(kind, name, names, key=key)
    return list(names).index(name)


def pushes(disturbances: Sequence[Any], robot: Robot, dt: float, samples: int, rng: np.random.Generator) -> Pushes:
    """The pushes of a run as an effect.

    Args:
        disturbances: Of the run.
        robot: The robot.
        dt: Step of the plant [s].
        samples: Control samples of the run.
        rng: For those of shape "noise".

    Raises:
        UnknownName: A push on a velocity that the robot does not have.
    """
    found, rows, gusts = of_type(Push, disturbances), [], np.zeros((0, 0))
    for i, one in found:
        on = place(one.on, robot.velocity_names, f"disturbances.{i}.on", "velocity")
        rows.append((on, SHAPES[one.shape], one.force, one.frequency, one.start, one.end))
    if any(one.shape == "noise" for _, one in found):
        drawn = [standard_normal(stream, samples) for stream in rng.spawn(len(found))]
        gusts = np.column_stack(drawn)
    return Pushes(float(dt), np.array(rows, float).reshape(-1, PUSH), gusts)


def windows(kind: type, disturbances: Sequence[Any], names: Sequence[str]) -> Array:
    """Joint, start and end of the disturbances of one type, (k, 3); places in the names.

    Raises:
        UnknownName: A joint that is not among the names.
    """
    rows = [
        [place(one.joint, names, f"disturbances.{i}.joint"), one.start, one.end]
        for i, one in of_type(kind, disturbances)
    ]
    return np.array(rows, float).reshape(-1, 3)


def payload(disturbances: Sequence[Any]) -> tuple[str, Payload | None]:
    """The payload of a run and its key.

    Raises:
        ConfigError: There are two.
    """
    found = of_type(Payload, disturbances)
    if len(found) > 1:
        raise ConfigError("a second payload", fix="one run picks up one payload", key=f"disturbances.{found[1][0]}")
    return (f"disturbances.{found[0][0]}", found[0][1]) if found else ("", None)


def lateness(disturbances: Sequence[Any], timing: Timing) -> Array:
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


def corruption(disturbances: Sequence[Any], timing: Timing) -> Array:
    """The number that is added to all numbers of every message, (measurements,)."""
    added = np.zeros(timing.measurements)
    times = np.arange(timing.measurements) * timing.measurement_period
    for _, one in of_type(Messages, disturbances):
        inside = one.times(times)
        if one.fault == "nan":
            added[inside] = np.nan
        elif one.fault == "spike":
            added[inside & (np.arange(added.size) % one.EVERY == 0)] += one.size
    return added


def commands(disturbances: Sequence[Any], timing: Timing) -> Array:
    """The fate of every torque command, (samples,): 0 it arrives, 1 it is lost, 2 it is not a number."""
    fate = np.zeros(timing.samples)
    times = np.arange(timing.samples) * timing.control_period
    for _, one in of_type(CommandFault, disturbances):
        fate[one.times(times)] = 1.0 if one.fault == "lost" else 2.0
    return fate
