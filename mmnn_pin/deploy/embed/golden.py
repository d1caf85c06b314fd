"""Golden vectors: samples with measurements and setpoints as they come on a robot, and what the stepper answers.

The measurements are those of a robot that follows its reference with an error that wanders, so that a learner has
something to learn. Some are lost or are no numbers. In the second half encoders wrap. Towards the end the supervisor
trips, brakes, and is reset, and an encoder jumps.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from ...loop.loop import Loop
from ...loop.stepper import Stepper
from ...model.robot import Robot, revolute
from ...reference.wishes import HOLD, BaseVelocity, JointSample, Wish
from ...signals import Array, Measurement, Setpoint
from .board import FOLLOW_BOTH, FOLLOW_JOINTS, FOLLOW_SAMPLE, FOLLOW_VELOCITY, GO_ON, STAND

STOP, RESET, PAUSE, RESUME = 1, 2, 3, 4
PRIME = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True)
class GoldenEvent:
    """The inputs of one sample."""

    time: float  # [s]
    received: Array | None  # (m,) pose, velocity, q, qdot, shape; None where no measurement came
    measured: float  # when it was taken [s]
    wish: int = GO_ON  # of `board`
    asked: Array = field(default_factory=lambda: np.zeros(0))  # (w,) the setpoint
    action: int = 0  # `STOP`, `RESET`, `PAUSE`, `RESUME`, or 0


@dataclass(frozen=True)
class Answer:
    """The outputs of one sample."""

    torque: Array  # (motors,) [N m or N]
    checksum: int  # of all that it remembers


def usual_events(loop: Loop, period: float, steps: int, seed: int = 0) -> list[GoldenEvent]:
    """Samples along the trajectory of a loop, with what goes wrong on a robot now and then."""
    rng, d = np.random.default_rng(seed), loop.robot.dimensions
    times = np.arange(steps) * period
    table = loop.trajectory.table(times, d)
    first = d.pose + d.base
    last_angle = first + 2 * d.arm + d.shape
    away = np.zeros(last_angle)
    angles = [*range(2, d.pose), *(first + np.flatnonzero(revolute(loop.robot)[loop.robot.arm_index]))]
    angles += range(first + 2 * d.arm, last_angle)
    events = []
    for k, asked in enumerate(table):
        away = 0.995 * away + 0.002 * rng.standard_normal(away.size)
        read = np.asarray(as_measured(asked, loop.robot) + away)
        last = k >= int(0.85 * steps)
        chance, wish, action = rng.random(), FOLLOW_SAMPLE, 0
        if 0.3 < k / steps < 0.35 and d.base:
            wish = FOLLOW_VELOCITY if k % 2 else FOLLOW_BOTH
        elif 0.5 < k / steps < 0.55:
            wish = FOLLOW_JOINTS
        elif 0.35 <= k / steps < 0.37:
            wish = STAND if chance < 0.5 else GO_ON
        if k in (int(0.4 * steps), int(0.42 * steps)):
            action = PAUSE if k == int(0.4 * steps) else RESUME
        if last:
            read[-1] += 100.0 * (k == int(0.86 * steps))
            action = RESET if k in (int(0.93 * steps), int(0.96 * steps)) else STOP if k == int(0.97 * steps) else 0
            read[first : first + 1] += 0.7 * (k >= int(0.95 * steps))
        if 0.6 < k / steps < 0.63:  # a target that jumps: the reference goes after it within its limits
            asked[d.pose + 2 * d.twist :][: d.arm] += 0.2
        if k > steps // 2:
            read[angles] %= math.tau
        received: Array | None = read
        if chance < 0.01:
            read[int(rng.integers(read.size))] = rng.choice([np.nan, np.inf, 1e12])
        elif chance < 0.03:
            received = None
        measured = times[k] - period * (chance > 0.98)
        events.append(GoldenEvent(float(times[k]), received, float(measured), wish, asked.copy(), action))
    return events


def as_measured(asked: Array, robot: Robot) -> Array:
    """The measurement of a robot that is where a setpoint wants it, (pose, velocity, q, qdot, shape)."""
    setpoint = Setpoint.side_by_side(asked, robot.dimensions)
    position = robot.steered_along(robot.neutral_position(), setpoint.velocity)
    velocity = robot.base_velocity(position, setpoint.velocity)
    return np.concatenate((setpoint.pose, velocity, setpoint.q, setpoint.qdot, position[robot.shape_index]))


def answers(stepper: Stepper, events: list[GoldenEvent], remembered: Iterable[Array]) -> list[Answer]:
    """The answers of a stepper to events; `remembered` is the memory that goes into the checksums."""
    d, arrays, found = stepper.robot.dimensions, list(remembered), []
    powers = powers_of(sum(array.size for array in arrays))
    ends = np.cumsum((d.pose, d.base, d.arm, d.arm))
    for event in events:
        measurement = None if event.received is None else Measurement(*np.split(event.received, ends))
        setpoint = Setpoint.side_by_side(event.asked, d)
        wish = wish_of(event.wish, setpoint)
        with suppress(ConfigError):  # refused, and nothing has changed
            if event.action:
                {STOP: stepper.stop, RESET: stepper.reset, PAUSE: stepper.pause, RESUME: stepper.resume}[event.action]()
        with suppress(ConfigError):
            stepper.step(event.time, measurement, wish, measured=event.measured)
        found.append(Answer(stepper.motor_torque.copy(), checksum(np.concatenate(arrays), powers)))
    return found


def wish_of(kind: int, sample: Setpoint) -> Wish | tuple[Wish, ...] | None:
    """The wish of the stepper by a number of `board` and a full sample."""
    velocity, joints = BaseVelocity(sample.velocity), JointSample(sample.q, sample.qdot, sample.qddot)
    asked: dict[int, Wish | tuple[Wish, ...]] = {
        FOLLOW_SAMPLE: sample, FOLLOW_VELOCITY: velocity, STAND: HOLD, FOLLOW_JOINTS: joints,
        FOLLOW_BOTH: (velocity, joints),
    }  # fmt: skip
    return asked.get(kind)


def powers_of(size: int) -> NDArray[np.uint64]:
    """Factors (size,) of the numbers in a checksum: powers of `PRIME`."""
    rising = np.cumprod(np.full(size, PRIME), dtype=np.uint64)
    return np.append(rising[:-1][::-1], np.uint64(1))[:size]


def checksum(numbers: Array, powers: NDArray[np.uint64]) -> int:
    """A checksum of the bits of some numbers; all that are no numbers count alike."""
    bits = np.where(np.isnan(numbers), np.nan, numbers).view(np.uint64)
    bits = np.where(np.isnan(numbers), np.uint64(0x7FF8000000000000), bits)
    with np.errstate(over="ignore"):
        return int(np.sum(bits * powers, dtype=np.uint64))
