"""A path given by samples, and what every path is checked for: can the base follow, does the law stabilise."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..elementary.arrays import cos_sin
from ..errors import TrajectoryError
from ..files import LARGEST, read_bytes, reason
from ..signals import Array
from .joint import require_clock, within
from .path import BasePath, BaseSamples, require_finite, times

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline, CubicSpline


TIMES = ("t", "time", "timestamp", "stamp", "sec", "seconds")  # heads of the column of times; the first is our own
HEADINGS = ("theta", "yaw", "heading", "psi", "th")  # heads that others give to phi
SECONDS = ("s", "sec", "seconds")
MEASURED, SLOW = 100, 0.9  # rows of what is no list of waypoints; from this step on their times are hardly seconds [s]
APART, TURNED = 0.02, 0.1  # how far beside samples the motion may pass that is driven in their place [m, rad]
AGREES = 0.05, 0.25  # by which velocities may differ from that motion's, RMS: so much, and of its own [m/s, rad/s; 1]
BASE_COLUMNS = ("x", "y", "phi", "v", "vx", "vy", "w")
JUMP, LEAP = {"rad": 1.0, "m": 0.3}, 10.0  # speed of a jump, and its ratio to those around it [rad/s, m/s]
AROUND = 4  # steps before and after a jump that tell what is usual
SEPARATORS = ",;\t"  # of cells; the one that the first line has most of


@dataclass(frozen=True, eq=False)
class BaseTable(BasePath):
    """A reference given by samples, from any planner; between them the pose is a cubic Hermite spline.

    Args:
        time: (N,) increasing times [s], the first 0.
        pose: (N, 3) poses `(x, y, phi)` [m, m, rad]; phi may be wrapped if it turns by less than pi per sample.
        velocity: (N, 2) `(v, w)`, or (N, 3) `(vx, vy, w)` for a holonomic base [m/s, rad/s]; their derivatives are
            those of a cubic spline through them.
        note: What was made of a planner's samples, for people; "" where they are as they came.

    Raises:
        TrajectoryError: The samples are malformed, or no such base can follow them (`check_followable`).
    """

    followable: ClassVar[bool] = True

    time: Array
    pose: Array
    velocity: Array
    note: str = ""

    def __post_init__(self) -> None:
        time, pose, velocity = (np.array(part, float) for part in (self.time, self.pose, self.velocity))
        if time.ndim != 1 or pose.shape != (len(time), 3) or velocity.shape not in ((len(time), 2), (len(time), 3)):
            raise TrajectoryError(
                f"samples of shapes {time.shape}, {pose.shape}, {velocity.shape}",
                fix="give (N,), (N, 3), (N, 2) or (N, 3)",
            )
        require_finite(time=time, pose=pose, velocity=velocity)
        require_clock(time)
        pose[:, 2] = np.unwrap(pose[:, 2])
        check_followable(time, pose, velocity)
        object.__setattr__(self, "sideways", has_vy(velocity))
        for name, part in (("time", time), ("pose", pose), ("velocity", velocity)):
            part.flags.writeable = False
            object.__setattr__(self, name, part)

    @classmethod
    def read(cls, file: str | Path) -> BaseTable:
        """Table from a CSV file with a column `t` and those of `TableColumns.base`, in any order, others ignored.

        Raises:
            TrajectoryError: A column is missing or a value is not a number (with the line), or as for the class.
        """
        found = TableColumns.read(file)
        with found.blamed():
            table = found.base("vy" in found)
        if table is None:
            raise TrajectoryError("no column x, y", fix="name x, y, phi in the first line", file=found.file, line=1)
        return table

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.time[-1])

    @cached_property
    def _splines(self) -> tuple[CubicHermiteSpline, CubicSpline]:
        from scipy.interpolate import CubicHermiteSpline, CubicSpline  # slow to import, seldom needed

        vx, vy, w = in_three(self.velocity)
        c, s = cos_sin(self.pose[:, 2])
        rate = np.stack([vx * c - vy * s, vx * s + vy * c, w], axis=1)
        return CubicHermiteSpline(self.time, self.pose, rate), CubicSpline(self.time, self.velocity)

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`.

        Raises:
            TrajectoryError: A time lies after the last sample.
        """
        t = times(t)
        at, (pose, velocity) = within(t, float(self.time[-1])), self._splines
        return BaseSamples(t, pose(at), velocity(at), velocity(at, 1))


def has_vy(velocity: Array) -> bool:
    """Whether velocities of a base are `(vx, vy, w)`, (N, 3), and not `(v, w)`, (N, 2)."""
    return velocity.shape[1] == 3


def in_three(velocity: Array) -> tuple[Array, Array, Array]:
    """Columns vx, vy, w of base velocities (N, twist); vy = 0 for a differential drive."""
    vx, w = velocity[:, 0], velocity[:, -1]
    return vx, velocity[:, 1] if has_vy(velocity) else np.zeros_like(vx), w


def spline_rates(time: Array, pose: Array) -> tuple[Array, Array, Array]:
    """Rates of poses (N, 3) by a cubic spline: in the world (N, 3), along the heading (N,), and across it (N,)."""
    from scipy.interpolate import CubicSpline  # slow to import, seldom needed

    rate = CubicSpline(time, pose)(time, 1)
    c, s = cos_sin(pose[:, 2])
    return rate, rate[:, 0] * c + rate[:, 1] * s, rate[:, 1] * c - rate[:, 0] * s


def velocities(time: Array, pose: Array, sideways: bool) -> Array:
    """Base velocities (N, 2 or 3) of poses (N, 3) at times (N,): the slope of a cubic spline, in the pose's frame."""
    rate, forward, aside = spline_rates(time, pose)
    return np.stack([forward, aside, rate[:, 2]] if sideways else [forward, rate[:, 2]], axis=1)


def table_of(time: ArrayLike, pose: ArrayLike, velocity: ArrayLike | None, sideways: bool) -> BaseTable:
    """A table of a planner's poses; where wheels cannot roll them, of the nearest motion that they can.

    Args:
        time: (N,) increasing times [s], the first 0.
        pose: (N, 3) poses; (N, 2) points that are driven through forwards, by a holonomic base without turning.
        velocity: Velocities; those of the poses where there are none.
        sideways: Whether the base is holonomic.

    Raises:
        TrajectoryError: As of `BaseTable`; or the nearest motion passes further than `APART` or `TURNED` beside them.
    """
    t, poses = np.array(time, float), np.array(pose, float)
    if t.ndim != 1 or poses.shape not in ((len(t), 2), (len(t), 3)):
        return BaseTable(t, poses, np.zeros((len(t), 2 + sideways)) if velocity is None else np.array(velocity, float))
    require_finite(time=t, pose=poses)
    require_clock(t)
    headed = poses.shape[1] == 3
    if not headed:
        poses = np.column_stack((poses, np.zeros(len(t))))
    poses[:, 2] = np.unwrap(poses[:, 2])
    if not (headed or sideways):
        return rolling_table(t, poses, velocity, None)
    given = velocities(t, poses, sideways) if velocity is None else np.array(velocity, float)
    try:
        return BaseTable(t, poses, given)
    except Unfollowable as error:
        if sideways:
            raise
        return rolling_table(t, poses, velocity, error)


def rolling_table(time: Array, pose: Array, velocity: ArrayLike | None, refused: Unfollowable | None) -> BaseTable:
    """The table of the motion nearest to poses that wheels can roll.

    Args:
        time: (N,) times [s].
        pose: (N, 3) poses.
        velocity: Velocities that it must agree with, None for none.
        refused: Why the poses themselves are none; None where they have no headings.

    Raises:
        TrajectoryError: It passes too far beside them, or does not agree.
    """
    from .rollable import nearest

    found = nearest(time, pose, headed=refused is not None)
    over = np.maximum(found.apart / APART, found.turned / TURNED)
    worst = int(np.argmax(over))
    if over[worst] > 1:
        error = refused or Unfollowable("points that cannot be driven through forwards", fix="give phi, too")
        beside = f"{found.apart[worst]:.2g} m and {found.turned[worst]:.2g} rad beside the sample of {time[worst]:g} s"
        why = f"the nearest motion that rolls passes {beside} (allowed {APART:g} m, {TURNED:g} rad)"
        raise error.but(why=f"{error.why}; {why}" if error.why else why)
    if velocity is not None:
        require_agreement(time, np.array(velocity, float), found.velocity[found.rows])
    most = f"{1e3 * found.apart.max():.2g} mm"
    if refused is None:
        note = f"no headings are given: it drives forwards through the points, at most {most} beside them"
    else:
        turned = f"{found.turned.max():.2g} rad"
        note = (
            f"the samples slip sideways: driven is the nearest motion that rolls, at most {most}, {turned} beside them"
        )
    return BaseTable(found.time, found.pose, found.velocity, note)


def require_agreement(time: Array, given: Array, rolled: Array) -> None:
    """Refuse velocities (N, 2) of another motion than the one that rolls through the poses (`TrajectoryError`)."""
    if given.shape != rolled.shape:
        raise TrajectoryError(f"velocities of shape {given.shape}", fix=f"give {rolled.shape}: v, w")
    require_finite(velocity=given)
    for name, unit, one, other in zip(("v", "w"), ("m/s", "rad/s"), given.T, rolled.T, strict=True):
        usual, off = (float(np.sqrt(np.mean(signal**2))) for signal in (other, one - other))
        if off > AGREES[0] + AGREES[1] * usual:
            worst = int(np.argmax(abs(one - other)))
            raise TrajectoryError(
                f"{name} = {one[worst]:.3g} {unit} at t = {time[worst]:g} s, the poses move at {other[worst]:.3g}",
                why="velocity and pose must be of one motion",
                fix=f"correct {name}, or the time or unit of the samples, or leave v, w out",
            )


def integrated(time: Array, velocity: Array) -> BaseTable:
    """The table of a base that starts at the origin and moves with velocities (N, 2 or 3), linear between samples.

    Raises:
        TrajectoryError: Times or velocities that are not finite, or times that do not increase.
    """
    from .rollable import driven_from, grid_of

    require_finite(time=time, velocity=velocity)
    require_clock(time)
    nodes, _ = grid_of(time)
    dense, steps = np.column_stack([np.interp(nodes, time, column) for column in velocity.T]), np.diff(nodes)
    pose = driven_from(np.zeros(3), dense[:, [0, -1]], steps)
    if has_vy(velocity):  # what it moves aside is what one would that looks to the left
        left = driven_from(np.array([0.0, 0.0, np.pi / 2]), dense[:, 1:], steps)
        pose[:, :2] += left[:, :2]
    return BaseTable(nodes, pose, dense, "no poses are given: it drives from x = 0, y = 0, phi = 0")


def require_no_jump(
    name: str, unit: str, time: Array, values: Array, line: Callable[[int], int | None] = lambda k: None
) -> None:
    """Refuse a step of a coordinate (N,) that is no motion: far faster than the steps around it.

    Args:
        name: Of the coordinate.
        unit: rad or m.
        time: (N,) times [s].
        values: (N,).
        line: Line of a file in which a sample stands.

    Raises:
        TrajectoryError: With the row, the size and the speed.
    """
    speed = np.abs(np.diff(values) / np.diff(time))
    for k in np.flatnonzero(speed > JUMP[unit]):
        around = np.concatenate((speed[max(k - AROUND, 0) : k], speed[k + 1 : k + 1 + AROUND]))
        if len(around) and speed[k] > LEAP * float(np.max(around)):
            what = f"{name} jumps by {values[k + 1] - values[k]:.3g} {unit} to its row of t = {time[k + 1]:g} s"
            why = f"that is {speed[k]:.3g} {unit}/s, beside {np.max(around):.2g} {unit}/s around it"
            raise TrajectoryError(what, why=why, fix="correct that row, or give rows in between", line=line(int(k + 1)))


def require_within(
    name: str,
    values: Array,
    lower: float,
    upper: float,
    where: Callable[[int], tuple[Path | None, int | None]] = lambda k: (None, None),
) -> None:
    """Refuse positions (N,) of a joint beyond its limits [rad or m].

    Args:
        name: Of the joint or of its column.
        values: The positions.
        lower: Its lower limit.
        upper: Its upper limit.
        where: File and line of a position.

    Raises:
        TrajectoryError: With the first that is.
    """
    more = 1e-6 * max(1.0, min(abs(lower), abs(upper)))
    beyond = np.flatnonzero((values < lower - more) | (values > upper + more))
    if beyond.size:
        (file, line), value = where(int(beyond[0])), values[beyond[0]]
        what = f"{name} = {value:g} is beyond the joint's limits {lower:g} to {upper:g}"
        fix = "stay within them, or correct the joint's <limit> in the URDF"
        raise TrajectoryError(what, fix=fix, file=file, line=line)


class TableColumns(Mapping[str, Array]):
    """The columns of a CSV file by the names in its first line, (N,) each, read when they are asked for.

    What a name has in square brackets behind it, a unit, is left out. Another of `TIMES` is read as `t` where that is
    missing.

    Args:
        file: The file.
        heads: The names.
        lines: Number and cells of every line that has any.
    """

    def __init__(self, file: Path, heads: Sequence[str], lines: Sequence[tuple[int, Sequence[str]]]) -> None:
        self.file, self._heads, self._lines = file, list(heads), lines

    @classmethod
    def read(cls, file: str | Path, needed: Sequence[str] = ("t",)) -> TableColumns:
        """The columns of a file.

        Raises:
            TrajectoryError: The file cannot be read, a column that is needed is missing, or there are no rows.
        """
        file = Path(file)
        try:
            stream = StringIO(read_bytes(file, LARGEST).decode("utf-8-sig"), newline="")
            first = stream.readline()
            stream.seek(0)
            rows = list(csv.reader(stream, delimiter=max(SEPARATORS, key=first.count), skipinitialspace=True))
        except (OSError, ValueError, csv.Error) as error:
            why = "it is no text in UTF-8" if isinstance(error, UnicodeDecodeError) else reason(error)
            raise TrajectoryError("cannot be read", why=why, fix="name a CSV file", file=file) from None
        heads = [head.partition("[")[0].strip() for head in rows[0]] if rows else []
        if "t" not in heads and (clock := next((head for head in heads if head.lower() in TIMES), None)):
            heads[heads.index(clock)] = "t"
        if missing := [name for name in needed if name not in heads]:
            fix = f"name {', '.join(needed)} in the first line"
            raise TrajectoryError(f"no column {', '.join(missing)}", fix=fix, file=file, line=1)
        lines = [(number, row) for number, row in enumerate(rows[1:], 2) if any(row)]
        if not lines:
            raise TrajectoryError("no rows", fix="give a line of numbers per time", file=file, line=1)
        found = cls(file, heads, lines)
        if "t" in heads:
            found.require_seconds(rows[0][heads.index("t")].partition("[")[2].strip(" ]"))
        return found

    def __getitem__(self, name: str) -> Array:
        if name not in self._heads:
            raise KeyError(name)
        place = self._heads.index(name)
        return np.array([number_at(row, place, name, self.file, line) for line, row in self._lines])

    def __iter__(self) -> Iterator[str]:
        return iter(self._heads)

    def __len__(self) -> int:
        return len(self._heads)

    def __contains__(self, name: object) -> bool:
        return name in self._heads

    def base(self, sideways: bool) -> BaseTable | None:
        """The base's motion; None where no column is of it.

        It has `x, y, phi`, or `x, y`, and with them or alone `v, w`, `vx, vy, w` for a holonomic base. `vx` is another
        name of `v`; a holonomic base without `vy` does not move aside.

        Raises:
            TrajectoryError: A part of these, or as of `table_of` and `integrated`.
        """
        have = [name for name in BASE_COLUMNS if name in self]
        forward = "vx" if "vx" in have else "v"
        names = (forward, "vy", "w") if sideways and "vy" in have else (forward, "w")
        placed, moving = [n for n in have if n in ("x", "y", "phi")], [n for n in have if n in names]
        if strange := [name for name in have if name not in (*placed, *moving)]:
            fix = f"this base moves by {'vx, vy, w' if sideways else 'v, w'}: name them so, or leave the column out"
            raise TrajectoryError(f"nothing uses the column '{strange[0]}'", fix=fix, file=self.file, line=1)
        if placed and not {"x", "y"} <= set(placed):
            missing = [name for name in ("x", "y") if name not in placed]
            fix = "give x, y, phi, or x, y, or none of them and the base rests, or moves by its velocities"
            raise TrajectoryError(f"no column {', '.join(missing)}", fix=fix, file=self.file, line=1)
        if moving and len(moving) < len(names):
            missing = [name for name in names if name not in moving]
            fix = f"give {', '.join(names)}, or none of them" + (" and the poses' own are taken" if placed else "")
            raise TrajectoryError(f"no column {', '.join(missing)}", fix=fix, file=self.file, line=1)
        velocity = np.stack([self[name] for name in names], axis=1) if moving else None
        if velocity is not None and sideways and len(names) == 2:
            velocity = np.insert(velocity, 1, 0.0, axis=1)
        if placed:
            pose = np.stack([self[name] for name in placed], axis=1)
            for name in ("x", "y"):
                self.require_no_jump(name, "m", self[name])
            return table_of(self["t"], pose, velocity, sideways)
        return None if velocity is None else integrated(self["t"], velocity)

    def require_no_jump(self, name: str, unit: str, values: Array) -> None:
        """Refuse a step of a coordinate (N,) that is no motion (`TrajectoryError`)."""
        if len(values) > 1 and (np.diff(self["t"]) > 0).all():
            require_no_jump(name, unit, self["t"], values, lambda k: self._lines[k][0])

    def require_seconds(self, unit: str) -> None:
        """Refuse times that another unit is written behind, or that look like milliseconds and have none.

        Raises:
            TrajectoryError: They are, with the unit that would be taken.
        """
        if unit and unit not in SECONDS:
            fix = "give seconds, under the head t [s]"
            raise TrajectoryError(f"times in [{unit}]", fix=fix, file=self.file, line=1)
        step = float(np.median(np.diff(self["t"]))) if len(self._lines) >= MEASURED else 0.0
        if not unit and step >= SLOW:
            what, why = f"one row every {step:g} s", f"so many rows ({len(self._lines)}) look like milliseconds"
            raise TrajectoryError(
                what, why=why, fix="give seconds, or write t [s] in the first line", file=self.file, line=1
            )

    def require_within(self, name: str, lower: float, upper: float) -> None:
        """Refuse a joint's positions beyond its limits (`TrajectoryError`)."""
        require_within(name, self[name], lower, upper, lambda k: (self.file, self._lines[k][0]))

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Errors of trajectories within are about this file."""
        try:
            yield
        except TrajectoryError as error:
            raise error.but(file=error.file or self.file) from error


def number_at(row: Sequence[str], place: int, column: str, file: Path, line: int) -> float:
    """A number of a line.

    Raises:
        TrajectoryError: There is none at that place, or one that is not finite.
    """
    text = row[place] if place < len(row) else ""
    try:
        number = float(text)
    except ValueError:
        fix = "write a decimal point" if "," in text else "write a number there" if text else "give one cell per column"
        raise TrajectoryError(f"{column} = '{text}' is not a number", fix=fix, file=file, line=line) from None
    if not math.isfinite(number):
        fix = "give a number there, or leave the line out"
        raise TrajectoryError(f"{column} = {text.strip()} is not finite", fix=fix, file=file, line=line)
    return number


class Unfollowable(TrajectoryError):
    """Samples that no base can follow."""


def check_followable(time: Array, pose: Array, velocity: Array, tolerance: float | None = None) -> None:
    """Refuse samples that a base cannot follow, thesis (2.6).

    The poses are differentiated by a spline. In the frame of the pose the sideways speed
    `-xdot sin phi + ydot cos phi` must vanish (a holonomic base: be the given vy), and the forward speed and phidot
    must be the given `(v, w)`.

    Args:
        time: (N,) times [s].
        pose: (N, 3) poses, phi unwrapped.
        velocity: (N, 2) `(v, w)`, or (N, 3) `(vx, vy, w)` of a holonomic base.
        tolerance: Largest deviation [m/s, rad/s]; by default 2 % of the largest speed that occurs, at least 0.001.

    Raises:
        Unfollowable: Naming the worst time and the speed there.
    """
    rate, forward, sideways = spline_rates(time, pose)
    if tolerance is None:
        tolerance = max(1e-3, 0.02 * float(max(abs(rate).max(), abs(velocity).max())))
    holonomic = has_vy(velocity)
    worst = int(np.argmax(abs(sideways)))
    if not holonomic and abs(sideways[worst]) > tolerance:
        raise Unfollowable(
            f"the reference moves sideways at t = {time[worst]:g} s, by {sideways[worst]:.3g} m/s",
            why=f"wheels that roll cannot (allowed {tolerance:.2g} m/s)",
            fix="give phi along the direction of travel (or opposite to it), in rad",
        )
    vx, vy, w = in_three(velocity)
    compared = [("vx" if holonomic else "v", "m/s", vx, forward), ("w", "rad/s", w, rate[:, 2])]
    if holonomic:
        compared.insert(1, ("vy", "m/s", vy, sideways))
    for name, unit, given, moved in compared:
        worst = int(np.argmax(abs(given - moved)))
        if abs(given - moved)[worst] > tolerance:
            raise Unfollowable(
                f"{name} = {given[worst]:.3g} {unit} at t = {time[worst]:g} s, the poses move at {moved[worst]:.3g}",
                why="velocity and pose must be of one motion",
                fix=f"correct {name}, or the time or unit of the samples",
            )


def warnings(samples: BaseSamples, speed: float = 1e-3, duration: float = 0.5) -> list[str]:
    """Warnings of stretches where the kinematic law does not stabilise the base.

    With `vr = 0` Kanayama's law, thesis (3.3), leaves the lateral and the heading error without feedback.

    Args:
        samples: Samples of a base path, in order of time.
        speed: `|vr|` below this counts as standing [m/s].
        duration: Shorter stretches are passed over [s].
    """
    if has_vy(samples.velocity) or not len(samples.t):
        return []
    standing = np.concatenate([[False], abs(samples.velocity[:, 0]) < speed, [False]])
    starts, ends = np.flatnonzero(np.diff(standing.astype(int))).reshape(-1, 2).T
    spans = [(samples.t[a], samples.t[b - 1]) for a, b in zip(starts, ends, strict=True)]
    return [
        f"vr = 0 from t = {a:g} s to {b:g} s: there the kinematic law (3.3) leaves lateral and heading error alone"
        for a, b in spans
        if b - a >= duration
    ]
