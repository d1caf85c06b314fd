"""A path given by samples, and what every path is checked for: can the base follow, does the law stabilise."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..elementary.arrays import cos_sin
from ..errors import TrajectoryError
from ..model.base import BY_SIZE
from ..model.base.holonomic import moves_sideways
from ..signals import Array
from .path import BasePath, BaseSamples, require_finite, times

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline, CubicSpline


@dataclass(frozen=True, eq=False)
class Table(BasePath):
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
        if (
            time.ndim != 1
            or pose.shape != (len(time), 3)
            or velocity.shape not in ((len(time), nb) for nb in BY_SIZE if nb)
        ):
            raise TrajectoryError(
                f"samples of shapes {time.shape}, {pose.shape}, {velocity.shape}",
                fix="give (N,), (N, 3), (N, 2) or (N, 3)",
            )
        require_finite(time=time, pose=pose, velocity=velocity)
        if len(time) < 4 or time[0] != 0 or (np.diff(time) <= 0).any():
            raise TrajectoryError("time does not increase from 0 over four or more samples", fix="sort it, start at 0")
        pose[:, 2] = np.unwrap(pose[:, 2])
        check_followable(time, pose, velocity)
        object.__setattr__(self, "nb", velocity.shape[1])
        for name, part in (("time", time), ("pose", pose), ("velocity", velocity)):
            part.flags.writeable = False
            object.__setattr__(self, name, part)

    @classmethod
    def read(cls, file: str | Path) -> Table:
        """Table from a CSV file with the columns `t, x, y, phi, v, w`, in any order, others ignored.

        A holonomic base has the columns `vx, vy` in place of `v`.

        Raises:
            TrajectoryError: A column is missing or a value is not a number (with the line), or as for the class.
        """
        with open(file, newline="", encoding="utf-8-sig") as stream:
            rows = csv.DictReader(stream, skipinitialspace=True)
            sideways = "vy" in (rows.fieldnames or ())
            names = ("t", "x", "y", "phi", *(("vx", "vy") if sideways else ("v",)), "w")
            missing = [name for name in names if name not in (rows.fieldnames or ())]
            if missing:
                raise TrajectoryError(
                    f"no column {', '.join(missing)}", fix=f"name them {', '.join(names)}", file=file, line=1
                )
            values = [[_number(row[name], name, file, rows.line_num) for name in names] for row in rows]
        data = np.array(values).reshape(-1, len(names))
        try:
            return cls(data[:, 0], data[:, 1:4], data[:, 4:])
        except TrajectoryError as error:
            raise TrajectoryError(error.what, why=error.why, fix=error.fix, file=file) from None

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
        t, end = times(t), self.time[-1]
        if t.size and t.max() > end + 1e-9:
            raise TrajectoryError(
                f"the reference ends at {end:g} s, but the run asks for t = {t.max():g} s", fix="shorten the run"
            )
        pose, velocity = self._splines
        at = np.minimum(t, end)
        return BaseSamples(t, pose(at), velocity(at), velocity(at, 1))


def in_three(velocity: Array) -> tuple[Array, Array, Array]:
    """Columns vx, vy, w of base velocities (N, nb); vy = 0 for a differential drive."""
    vx, w = velocity[:, 0], velocity[:, -1]
    return vx, velocity[:, 1] if moves_sideways(velocity.shape[1]) else np.zeros_like(vx), w


def _number(text: str | None, column: str, file: str | Path, line: int) -> float:
    try:
        return float(text or "")
    except ValueError:
        raise TrajectoryError(f"{column} = '{text}' is not a number", file=file, line=line) from None


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
    from scipy.interpolate import CubicSpline  # slow to import, seldom needed

    rate = CubicSpline(time, pose)(time, 1)
    cos, sin = cos_sin(pose[:, 2])
    forward, sideways = rate[:, 0] * cos + rate[:, 1] * sin, rate[:, 1] * cos - rate[:, 0] * sin
    if tolerance is None:
        tolerance = max(1e-3, 0.02 * float(max(abs(rate).max(), abs(velocity).max())))
    holonomic = moves_sideways(velocity.shape[1])
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
    """What is allowed but should be known: stretches where the kinematic law does not stabilise the base.

    With `vr = 0` Kanayama's law, thesis (3.3), leaves the lateral and the heading error without feedback.

    Args:
        samples: Samples of a base path, in order of time.
        speed: `|vr|` below this counts as standing [m/s].
        duration: Shorter stretches are passed over [s].
    """
    if samples.velocity.shape[1] != 2 or not len(samples.t):
        return []
    standing = np.concatenate([[False], abs(samples.velocity[:, 0]) < speed, [False]])
    starts, ends = np.flatnonzero(np.diff(standing.astype(int))).reshape(-1, 2).T
    spans = [(samples.t[a], samples.t[b - 1]) for a, b in zip(starts, ends, strict=True)]
    return [
        f"vr = 0 from t = {a:g} s to {b:g} s: there the kinematic law (3.3) leaves lateral and heading error alone"
        for a, b in spans
        if b - a >= duration
    ]
