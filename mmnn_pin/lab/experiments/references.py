"""The reference of an experiment: tables with a `type`, and the trajectory that they describe."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Literal

import msgspec
import numpy as np

from ...errors import LENGTH, ConfigError, InputError, TrajectoryError, UnknownName
from ...model.base import kind_of
from ...model.robot import Robot
from ...reference import (
    BasePath,
    Circle,
    Eight,
    Hold,
    HolonomicPath,
    Line,
    MinimumJerk,
    Parking,
    Points,
    Sine,
    Sines,
    Trajectory,
    Waypoints,
)
from ...reference.hand import (
    Capsule,
    HandCircle,
    HandLine,
    HandMotion,
    HandPath,
    HandSpline,
    Pieces,
    Task,
    Wait,
    WholeBody,
    WholeBodySettings,
    comfortable,
    plan,
)
from ...reference.joint import JointProfile
from ...reference.limits import Limits
from ...reference.samples import TableColumns
from ...reference.trajectory import still
from ...settings import Settings, Timing, require_gain
from ...settings.arguments import wrong_type
from ...signals import Array, Dimensions

BASE_PATHS = {"line": Line, "circle": Circle, "eight": Eight, "waypoints": Waypoints, "parking": Parking}
ARM_PROFILES = {"sine": Sine, "sines": Sines, "hold": Hold, "minimum_jerk": MinimumJerk, "points": Points}


OF_A_FIXED_ARM = 0.15  # scale of a path where no base moves, per metre of reach
SIX = 6  # joints that an orientation takes
SMALLER = (0.7, 0.5, 0.35, 0.25)  # sizes in which a path that cannot be followed is tried
KEY = "reference.hand"


@dataclasses.dataclass(frozen=True)
class Poses:
    """Poses from a CSV file: t, x, y, z, and qx, qy, qz, qw for orientations."""

    file: str  # the file


HAND_PATHS: dict[str, Any] = {
    "line": HandLine,
    "circle": HandCircle,
    "spline": HandSpline,
    "poses": Poses,
    "wait": Wait,
}
LENGTHS = ("by", "speed", "radius", "points")


class Other(Task, frozen=True):
    """Another frame of the same robot: as `Task`, with a path of its own.

    Args:
        path: Its path, from where it is; without one it stays there, or looks where it should.
    """

    path: tuple[dict[str, Any], ...] = ()


class HandTables(Settings, frozen=True):
    """The table `[reference.hand]`: where the hand goes, and how base and arm share that.

    Args:
        path: Its pieces, tables with a `type`, one after the other.
        frame: A link or joint that the arm moves; empty for the arm's tip.
        position: As of `Task`.
        orientation: As of `Task`; "auto" holds it with six joints or more and leaves it free with fewer.
        priority: As of `Task`.
        at: Where the path begins in the world, in the world's axes [m]; without it at the hand, in the robot's axes.
        start: Pose of the base at the start [m, m, rad].
        posture: Joints at the start and where tasks leave them free [rad or m]; "auto" for one far from singular.
        scale: Factor on the lengths and speeds of the path; "auto" shortens it for an arm that stands still.
        drive: Speed and turning rate of driving to where a path begins [m/s, rad/s].
        tolerance: Largest distance of the reference's hand from the path [m].
        body: How base and arm share the work.
        limits: Of base and joints.
        capsules: Bodies that keep apart.
        others: Other frames: a second arm, a head that looks.

    Raises:
        ConfigError: No path, or a number out of range.
    """

    path: tuple[dict[str, Any], ...]
    frame: str = ""
    position: float | tuple[float, float, float] = 1.0
    orientation: Literal["auto"] | float | tuple[float, float, float] = "auto"
    priority: int = 0
    at: tuple[float, float, float] | None = None
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    posture: Literal["auto"] | tuple[float, ...] = "auto"
    scale: Literal["auto"] | float = "auto"
    drive: tuple[float, float] = (0.3, 0.5)
    tolerance: float = 0.005
    body: WholeBodySettings = WholeBodySettings()
    limits: Limits = Limits()
    capsules: tuple[Capsule, ...] = ()
    others: tuple[Other, ...] = ()

    def __post_init__(self) -> None:
        if not self.path:
            fix = "give path = [{ type = 'line', by = [1.0, 0.0, 0.0] }]"
            raise ConfigError("a hand without a path", fix=fix, key="reference.hand.path")
        for name in ("scale", "tolerance", "drive"):
            value = getattr(self, name)
            if value != "auto" and not (np.isfinite(value).all() and (np.asarray(value) > 0).all()):
                raise ConfigError(f"{value}", fix="use numbers > 0", key=f"reference.hand.{name}")
        self.first(0.0)

    def first(self, turned: float) -> Task:
        """The task of the frame; `turned` is the weight of an orientation that says "auto"."""
        orientation = turned if self.orientation == "auto" else self.orientation
        return Task(self.frame, self.position, orientation, priority=self.priority)

    def body_of(self, robot: Robot, period: float) -> WholeBody:
        """The robot with its tasks; errors as of `WholeBody`."""
        others = [Task(**{f: getattr(o, f) for f in Task.__struct_fields__}) for o in self.others]
        return WholeBody(
            robot,
            [self.first(0.1 if robot.dimensions.arm >= SIX else 0.0), *others],
            settings=self.body,
            limits=self.limits,
            period=period,
            capsules=self.capsules,
        )

    def motion(self, robot: Robot, timing: Timing) -> HandMotion:
        """The motion of a robot; errors as of `plan`, of which one tells the size of the path that can be followed."""
        body = self.body_of(robot, timing.control_period)
        if self.scale != "auto":
            return self._drawn(body, self.scale, timing)
        size = 1.0 if robot.dimensions.base else reach_of(body) * OF_A_FIXED_ARM
        try:
            return self._drawn(body, size, timing)
        except TrajectoryError as refused:
            smaller = self._followed(body, size, timing) if refused.key == f"{KEY}.path" else None
            if smaller is None:
                raise
            fits = f"--set {KEY}.scale={smaller:g} draws it smaller, which it can follow"
            raise refused.but(fix=f"{fits}; or {refused.fix}") from refused

    def _followed(self, body: WholeBody, size: float, timing: Timing) -> float | None:
        """The largest of some smaller sizes in which the path can be followed."""
        for share in SMALLER:
            smaller = float(f"{share * size:.2g}")
            with suppress(TrajectoryError):
                self._drawn(body, smaller, timing)
                return smaller
        return None

    def _drawn(self, body: WholeBody, size: float, timing: Timing) -> HandMotion:
        """The motion along the path in a size."""
        paths: list[HandPath | None] = [path_of(self.path, size, f"{KEY}.path")]
        for i, other in enumerate(self.others):
            paths.append(path_of(other.path, size, f"{KEY}.others.{i}.path") if other.path else None)
        return plan(
            body,
            paths,
            timing.samples * timing.control_period,
            start=self.start,
            posture=None if self.posture == "auto" else self.posture,
            at=self.at,
            drive=self.drive,
            tolerance=self.tolerance,
        )


def path_of(tables: tuple[dict[str, Any], ...], scale: float, key: str) -> HandPath:
    """A path of tables; errors as of `references.make`."""
    parts: list[HandPath] = []
    for i, table in enumerate(tables):
        scaled = {name: scaled_by(value, scale) if name in LENGTHS else value for name, value in table.items()}
        part = make(HAND_PATHS, scaled, f"{key}.{i}")
        parts.append(HandSpline.read(part.file) if isinstance(part, Poses) else part)
    return Pieces(tuple(parts))


def scaled_by(value: Any, factor: float) -> Any:
    """A number or numbers in lists times a factor; what is none stays."""
    if isinstance(value, list | tuple):
        return [scaled_by(each, factor) for each in value]
    return value * factor if isinstance(value, int | float) else value


def reach_of(body: WholeBody) -> float:
    """Distance of the hand from the first joint with the arm as it stands [m]."""
    body.put(np.zeros(body.pose.size), comfortable(body)[0])
    axes = body.chains[0].axes
    return float(np.linalg.norm(body.places[0, 9:] - axes[0, 3:])) if len(axes) else 1.0


class ReferenceTables(Settings, frozen=True):
    """The reference: tables with `type` and its arguments.

    Args:
        base: The base's path.
        heading: Profile of a holonomic base's heading [rad]; None turns it along the path.
        arm: One profile per arm joint, or one table for all of them (type "swing", see `Swing`).
        share: Largest share of every motor's effort and speed limits that following the reference exactly may need.
            Where it would need more, swings move to another posture and the whole reference slows down (`loop.suited`).
            0 for no limit.
        hand: Where the hand goes; base and arm follow from that, in place of the keys above.
        file: A CSV file as for `Trajectory.from_csv`; its columns replace base and arm. In an experiment's file it is
            looked for from that file's folder, then from where you are; so is `robot`.

    Raises:
        ConfigError: A hand beside a path of the base, profiles of the arm or a file.
    """

    base: dict[str, Any] | None = None
    heading: dict[str, Any] | None = None
    arm: tuple[dict[str, Any], ...] | dict[str, Any] = ()
    share: float = 0.0
    hand: HandTables | None = None
    file: str = ""

    def __post_init__(self) -> None:
        require_gain(self.share, "reference.share")
        if self.hand is not None and (self.base or self.heading or self.arm or self.file):
            why, fix = "the motion of base and arm follows from the hand's", "leave out one of them"
            beside = "a file" if self.file else "[reference.base] or [reference.arm]"
            raise ConfigError(f"a hand beside {beside}", why=why, fix=fix, key="reference")

    def of(self, robot: Robot, limits: tuple[Array, Array] | None = None) -> Trajectory:
        """The reference for a robot, also from a file; arguments and errors as in `trajectory`."""
        if not self.file:
            return self.trajectory(robot.dimensions, limits)
        read = Trajectory.from_csv(robot, self.file)
        base = self._path(robot.dimensions) if still(read.base) and self.base else read.base
        arm = self._arm(robot.dimensions, limits) if all(map(still, read.arm)) and self.arm else read.arm
        return Trajectory(base, arm)

    def trajectory(self, layout: Dimensions, limits: tuple[Array, Array] | None = None) -> Trajectory:
        """The reference for a robot; arguments and errors as in `Experiment.trajectory`."""
        if layout.base and self.base is None:
            raise ConfigError("no path for the base", fix="add [reference.base] with a type", key="reference.base")
        return Trajectory(self._path(layout), self._arm(layout, limits))

    def _path(self, layout: Dimensions) -> BasePath | None:
        if not layout.base or self.base is None:
            return None
        path = make(BASE_PATHS, self.base, "reference.base")
        if layout.sideways:
            heading = self.heading
            return HolonomicPath(path, None if heading is None else make(ARM_PROFILES, heading, "reference.heading"))
        if self.heading is not None:
            raise ConfigError(
                f"a heading for {kind_of(layout).words}",
                why="they look along their path",
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
                code=LENGTH,
            )
        return tuple(make(ARM_PROFILES, table, f"reference.arm.{i}") for i, table in enumerate(tables))


class HeldOutReference(ReferenceTables, frozen=True):
    """A reference that no learner is trained on; `mmnn judge` asks on it what a learner knows.

    Args:
        duration: Its length [s].
    """

    duration: float = 10.0


@dataclasses.dataclass(frozen=True)
class Swing:
    """A sine around the middle of each joint's range, from rest; around 0 for a joint without limits."""

    amplitude: float  # largest amplitude [rad or m]
    period: float  # [s]
    share: float = 0.5  # largest amplitude as a share of half the joint's range

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
    needed = [
        f.name for f in dataclasses.fields(kind) if f.init and f.default is f.default_factory is dataclasses.MISSING
    ]
    if missing := [name for name in needed if name not in arguments]:
        what = f"without {', '.join(missing)}"
        raise ConfigError(f"'{name}' {what}", fix=f"give {', '.join(needed)}", key=key)
    try:
        return msgspec.convert(arguments, kind)
    except msgspec.ValidationError as error:
        where = str(error).partition(" - at ")[2].strip("`").removeprefix("$")
        what, fix = wrong_type(error, arguments.get(where.removeprefix(".")))
        raise ConfigError(what, fix=fix, key=key + where) from error
    except InputError as error:  # of the object itself, which knows only the name of its argument
        first = error.what.partition(" ")[0]
        raise error.but(key=error.key or (f"{key}.{first}" if first in known else key)) from error


def as_long_as_its_file(table: dict[str, Any], own: Mapping[str, Any]) -> None:
    """Let an experiment end with the motion of its file, where that is shorter and the user does not say how long.

    Args:
        table: The experiment, changed in place.
        own: What the user's own file says, empty without one.
    """
    time, reference = table.get("time", {}), table.get("reference")
    if not (isinstance(time, dict) and isinstance(reference, dict)) or not reference.get("file"):
        return
    if isinstance(said := own.get("time"), dict) and "duration" in said:
        return
    with suppress(InputError, TypeError, ValueError, ZeroDivisionError):  # told when the file is read
        usual = Timing()
        period, duration = time.get("control_period", usual.control_period), time.get("duration", usual.duration)
        end = float(TableColumns.read(reference["file"])["t"][-1])
        if 0 < end < duration:
            table["time"] = time | {"duration": round(math.floor(end / period + 1e-6) * period, 9)}
