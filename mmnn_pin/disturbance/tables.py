"""The disturbances of one run as tables of numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import ConfigError, UnknownName
from ..model.robot import Robot
from ..settings import Timing
from ..signals import Array
from .effects import PUSH, SHAPES
from .settings import Commands, Disturbance, Messages, Payload, Push, Window


def require_in_time(disturbances: Sequence[Disturbance], duration: float) -> None:
    """Refuse what would never happen in a run of this duration [s].

    Raises:
        ConfigError: A disturbance that begins when the run is over.
    """
    for i, one in enumerate(disturbances):
        if one.start >= duration:
            what, why = f"{one.start:g} s", f"the run ends at {duration:g} s"
            raise ConfigError(what, why=why, fix="begin earlier, or run longer", key=f"disturbances.{i}.start")


def require_long_enough(disturbances: Sequence[Disturbance], step: float) -> None:
    """Refuse what could fall between two steps of the plant [s].

    Raises:
        ConfigError: A disturbance that is over before the plant has made a step.
    """
    for i, one in enumerate(disturbances):
        if isinstance(one, Window) and one.end - one.start < step * (1 - 1e-9):
            what, why = f"{one.end - one.start:g} s long", f"the plant's step is {step:g} s"
            raise ConfigError(what, why=why, fix="end later", key=f"disturbances.{i}.end")


def of_type(kind: type, disturbances: Sequence[Disturbance]) -> list[tuple[int, Any]]:
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


def pushes(disturbances: Sequence[Disturbance], robot: Robot) -> Array:
    """Table of the pushes, (k, PUSH).

    Raises:
        UnknownName: A push on a velocity that the robot does not have.
    """
    rows = []
    for i, one in of_type(Push, disturbances):
        on = place(one.on, robot.velocity_names, f"disturbances.{i}.on", "velocity")
        rows.append((on, SHAPES[one.shape], one.force, one.frequency, one.start, one.end))
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
