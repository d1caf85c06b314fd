"""The reference of an experiment: tables with a `type`, and the trajectory that they describe."""

from __future__ import annotations

import dataclasses
from typing import Any

import msgspec
import numpy as np

from ...errors import ConfigError, UnknownName
from ...model.base.holonomic import moves_sideways
from ...reference import (
    BasePath,
    Circle,
    Eight,
    Hold,
    Holonomic,
    Line,
    MinimumJerk,
    Sine,
    Sines,
    Trajectory,
    Waypoints,
)
from ...reference.trajectory import JointProfile
from ...settings import Settings, require_gain, wrong_type
from ...signals import Array, Dimensions

BASE_PATHS = {"line": Line, "circle": Circle, "eight": Eight, "waypoints": Waypoints}
ARM_PROFILES = {"sine": Sine, "sines": Sines, "hold": Hold, "minimum_jerk": MinimumJerk}


class ReferenceTables(Settings, frozen=True):
    """The reference: tables with `type` and its arguments.

    Args:
        base: The base's path.
        heading: Profile of a holonomic base's heading [rad]; None turns it along the path.
        arm: One profile per arm joint, or one table for all of them (type "swing", see `Swing`).
        share: Share of every motor's effort and speed limits that whoever follows exactly may need: swings move to
            another posture, and the whole reference is slower, where it would be more (`loop.suited`). 0 for any.
    """

    base: dict[str, Any] | None = None
    heading: dict[str, Any] | None = None
    arm: tuple[dict[str, Any], ...] | dict[str, Any] = ()
    share: float = 0.0

    def __post_init__(self) -> None:
        require_gain(self.share, "reference.share")

    def trajectory(self, layout: Dimensions, limits: tuple[Array, Array] | None = None) -> Trajectory:
        """The reference for a robot; arguments and errors as in `Experiment.trajectory`."""
        if layout.base and self.base is None:
            raise ConfigError("no path for the base", fix="add [reference.base] with a type", key="reference.base")
        return Trajectory(self._path(layout.base), self._arm(layout, limits))

    def _path(self, nb: int) -> BasePath | None:
        if not nb or self.base is None:
            return None
        path = make(BASE_PATHS, self.base, "reference.base")
        if moves_sideways(nb):
            heading = self.heading
            return Holonomic(path, None if heading is None else make(ARM_PROFILES, heading, "reference.heading"))
        if self.heading is not None:
            raise ConfigError(
                "a heading for a differential drive",
                why="it looks along its path",
                fix="leave the table out",
                key="reference.heading",
            )
        return path

    def _arm(self, layout: Dimensions, limits: tuple[Array, Array] | None) -> tuple[JointProfile, ...]:
        tables, n = self.arm, layout.arm
        if isinstance(tables, dict):
            common = make({"swing": Swing, **ARM_PROFILES}, tables, "reference.arm")
            lower, upper = limits or (np.full(n, -np.inf), np.full(n, np.inf))
            if not isinstance(common, Swing):
                return (common,) * n
            return tuple(common.of(float(a), float(b)) for a, b in zip(lower, upper, strict=True))
        if len(tables) != n:
            raise ConfigError(
                f"{len(tables)} profiles for {n} arm joints",
                fix="add one [[reference.arm]] per joint, or one [reference.arm] for all",
                key="reference.arm",
            )
        return tuple(make(ARM_PROFILES, table, f"reference.arm.{i}") for i, table in enumerate(tables))


class HeldOut(ReferenceTables, frozen=True):
    """A reference that no learner is trained on, by which `mmnn prove` judges what it knows.

    Args:
        duration: Its length [s].
    """

    duration: float = 10.0


@dataclasses.dataclass(frozen=True)
class Swing:
    """A sine around the middle of each joint's range, from rest; around 0 for a joint without limits.

    Args:
        amplitude: Largest amplitude [rad or m].
        share: Largest amplitude as a share of half the joint's range.
        period: [s].
    """

    amplitude: float
    period: float
    share: float = 0.5

    def __post_init__(self) -> None:
        if not 0 <= self.share <= 1:
            raise ConfigError(f"share {self.share}", fix="use a number from 0 to 1", key="reference.arm.share")

    def of(self, lower: float, upper: float) -> Sine:
        """The profile of one joint with these limits."""
        if not np.isfinite(upper - lower):
            return Sine(self.amplitude, self.period, float(np.clip(0.0, lower, upper)), np.pi / 2)
        amplitude = min(self.amplitude, self.share * (upper - lower) / 2)
        return Sine(amplitude, self.period, (lower + upper) / 2, np.pi / 2)


def make(kinds: dict[str, Any], table: dict[str, Any], key: str) -> Any:
    """Object from a table with its `type` and arguments.

    Raises:
        UnknownName: No such type or argument.
        ConfigError: A value of the wrong type, an argument is missing.
    """
    name = table.get("type", "")
    if name not in kinds:
        raise UnknownName("type", str(name), kinds, key=f"{key}.type")
    kind, arguments = kinds[name], {k: v for k, v in table.items() if k != "type"}
    known = [field.name for field in dataclasses.fields(kind) if field.init]
    for argument in arguments:
        if argument not in known:
            raise UnknownName("key", argument, known, key=key)
    try:
        return msgspec.convert(arguments, kind)
    except msgspec.ValidationError as error:
        where = str(error).partition(" - at ")[2].strip("`").removeprefix("$")
        what, fix = wrong_type(error, arguments.get(where.removeprefix(".")))
        raise ConfigError(what, fix=fix, key=key + where) from error
