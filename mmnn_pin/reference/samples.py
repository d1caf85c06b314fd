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


SECONDS = ("s", "sec", "seconds")
MEASURED, SLOW = 100, 0.9  # rows of what is no list of waypoints; from this step on their times are hardly seconds [s]
SEPARATORS = ",;\t"  # of cells; the one that the first line has most of


@dataclass(frozen=True, eq=False)
class BaseTable(BasePath):
    """A reference given by samples, from any planner; between them the pose is a cubic Hermite spline.

    Args:
        time: (N,) increasing times [s], the first 0.
        pose: (N, 3) poses `(x, y, phi)` [m, m, rad]; phi may be wrapped if it turns by less than pi per sample.
        velocity: (N, 2) `(v, w)`, or (N, 3) `(vx, vy, w)` for a holonomic base [m/s, rad/s]; their derivatives are
            those of a cubic spline through them.

    Raises:
        TrajectoryError: The samples are malformed, or no such base can follow them (`check_followable`).
    """

    followable: ClassVar[bool] = True

    time: Array
    pose: Array
    velocity: Array

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
        """Table from a CSV file with the columns `t, x, y, phi, v, w`, in any order, others ignored.

        Cells are separated by commas, semicolons or tabs.

        A holonomic base has the columns `vx, vy` in place of `v`. Without columns of velocities they are those of the
        poses.

        Raises:
            TrajectoryError: A column is missing or a value is not a number (with the line), or as for the class.
        """
        found = TableColumns.read(file, ("t", "x", "y", "phi"))
        with found.blamed():
            return found.table("vy" in found)

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
    """A table of poses, with their own velocities where none are given.

    Raises:
        TrajectoryError: As of `BaseTable`.
    """
    t, poses = np.array(time, float), np.array(pose, float)
    if velocity is not None or t.ndim != 1 or poses.shape != (len(t), 3):
        return BaseTable(t, poses, np.zeros((len(t), 2 + sideways)) if velocity is None else np.array(velocity, float))
    require_finite(time=t, pose=poses)
    require_clock(t)
    poses[:, 2] = np.unwrap(poses[:, 2])
    return BaseTable(t, poses, velocities(t, poses, sideways))


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

    What a name has in square brackets behind it, a unit, is left out.

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

    def table(self, sideways: bool) -> BaseTable:
        """The base's: `x, y, phi`, and `v, w` or `vx, vy, w` where they are there; errors as of `BaseTable`."""
        names = ("vx", "vy", "w") if sideways else ("v", "w")
        missing = [name for name in names if name not in self]
        if missing and len(missing) < len(names):
            fix = f"give {', '.join(names)}, or none of them and the poses' own are taken"
            raise TrajectoryError(f"no column {', '.join(missing)}", fix=fix, file=self.file, line=1)
        given = None if missing else np.stack([self[n] for n in names], axis=1)
        return table_of(self["t"], np.stack([self[n] for n in ("x", "y", "phi")], axis=1), given, sideways)

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
        """Refuse a joint's positions beyond its limits.

        Raises:
            TrajectoryError: With the first line that is.
        """
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
        TrajectoryError: Naming the worst time and the speed there.
    """
    rate, forward, sideways = spline_rates(time, pose)
    if tolerance is None:
        tolerance = max(1e-3, 0.02 * float(max(abs(rate).max(), abs(velocity).max())))
    holonomic = has_vy(velocity)
    worst = int(np.argmax(abs(sideways)))
    if not holonomic and abs(sideways[worst]) > tolerance:
        raise TrajectoryError(
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
            raise TrajectoryError(
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
