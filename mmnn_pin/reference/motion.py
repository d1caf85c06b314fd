"""A motion known ahead, as samples at a period: of a trajectory, or of the arm through a planner's points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ..compiled import compiled, copy_to
from ..elementary import cos_sin, nearest_turn
from ..errors import ConfigError, TrajectoryError
from ..model.base import kind_of
from ..settings.arguments import faced
from ..signals import Array, Dimensions, IntArray, Setpoint
from .guide import ARM, AT_REST, BASE, NEAR, Guide, roll
from .trajectory import Trajectory

MOST_ROWS = 10_000_000  # of a motion
BENDS = ("acceleration", "yaw_acceleration")  # limits of the base
ON_SAMPLE = 1e-6  # of a period, from a sample
SLACK = 1.01  # times a limit of speed or acceleration that a motion may have
BETWEEN = 1.5  # times a stated acceleration: splines bend more between a planner's points than at them
STEEPEST = 3.0  # slope of a cubic over that of its chord, up to which it stays between its ends


@faced
@dataclass(frozen=True, eq=False)
class Motion:
    """Samples of a motion at a period, made ahead: nothing of it is planned while the robot runs.

    Attributes:
        table: (N, 3 + 2 twist + 3 n) setpoints side by side.
        period: Between two of them [s].
        parts: Which parts of the robot they are for.
        dimensions: Of the robot.
        from_here: Whether the path of the base starts at the reference pose of the moment in place of its own.
        shift: (3,) by which the path is moved in the plane.
        turns: (1 + n,) whole turns by which heading and joints are moved [rad]; None for none.
    """

    table: Array
    period: float
    parts: tuple[int, ...]
    dimensions: Dimensions
    from_here: bool = False
    shift: Array = field(default_factory=lambda: np.zeros(3))
    turns: Array | None = None

    @cached_property
    def room(self) -> Array:
        """(3 + 2 twist + 3 n,) for a sample between two."""
        return np.zeros(self.table.shape[1])

    @classmethod
    def of(
        cls, trajectory: Trajectory, duration: float, period: float, dimensions: Dimensions, from_here: bool = False
    ) -> Motion:
        """The samples of a trajectory; one without a base path or without profiles moves the other part only.

        Raises:
            TrajectoryError: The base cannot follow, it is for another robot, or it has no end.
        """
        if not (0 < duration < np.inf and 0 < period < np.inf and duration / period < MOST_ROWS):
            fix = f"give seconds > 0, and at most {MOST_ROWS:,} samples"
            raise TrajectoryError(f"{duration:g} s in samples of {period:g} s", fix=fix)
        d, t = dimensions, instants(duration, period)
        parts = (*((BASE,) if trajectory.base is not None else ()), *((ARM,) if trajectory.arm else ()))
        moved = replace(d, base=d.base if BASE in parts else 0, arm=d.arm if ARM in parts else 0)
        part = trajectory.table(t, moved)
        table = np.zeros((len(t), d.pose + 2 * d.twist + 3 * d.arm))
        start = 0 if BASE in parts else d.pose + 2 * d.twist
        table[:, start : start + part.shape[1]] = part
        return cls(table, period, parts, dimensions, from_here)

    @classmethod
    def through(
        cls,
        time: ArrayLike,
        q: ArrayLike,
        period: float,
        dimensions: Dimensions,
        qdot: ArrayLike | None = None,
        qddot: ArrayLike | None = None,
    ) -> Motion:
        """A motion of the arm through points: cubics, Hermite with rates, of degree five with accelerations too.

        Args:
            time: (k,) times of the points [s], increasing from 0 on.
            q: (k, n) joints [rad or m].
            period: Between two samples [s].
            dimensions: Of the robot.
            qdot: (k, n) rates; without them it is at rest at its ends, and stays between every two points.
            qddot: (k, n) accelerations; with rates only.

        Raises:
            TrajectoryError: Points of wrong shape, not finite, or out of order.
        """
        from scipy.interpolate import BPoly, CubicHermiteSpline  # slow to import, seldom needed

        n, at = dimensions.arm, np.asarray(time, float)
        points = [np.asarray(part, float) for part in (q, qdot, qddot) if part is not None]
        if any(part.shape != (at.size, n) or not np.isfinite(part).all() for part in points) or at.size < 2:
            raise TrajectoryError(
                f"points that are not finite numbers of shape ({at.size}, {n})", fix="give two or more"
            )
        if not (np.isfinite(at).all() and at[0] >= 0 and (np.diff(at) > 0).all()):
            raise TrajectoryError("times of points out of order", fix="let them increase from 0 on")
        at = at - at[0]
        points += [slopes(at, points[0], np.zeros(n))] if len(points) == 1 else []
        spline: Any = (
            CubicHermiteSpline(at, *points)
            if len(points) == 2
            else BPoly.from_derivatives(at, np.stack(points, axis=1))
        )
        t = instants(float(at[-1]), period)
        table = np.zeros((len(t), dimensions.pose + 2 * dimensions.twist + 3 * n))
        setpoints = Setpoint.side_by_side(table, dimensions)
        setpoints.q[:], setpoints.qdot[:], setpoints.qddot[:] = spline(t), spline(t, 1), spline(t, 2)
        return cls(table, period, (ARM,), dimensions)

    @cached_property
    def columns(self) -> slice:
        """The columns of a flat setpoint that the motion is for."""
        q = self.dimensions.pose + 2 * self.dimensions.twist
        return slice(0 if BASE in self.parts else q, None if ARM in self.parts else q)

    @cached_property
    def is_moved(self) -> bool:
        """Whether its path is moved in the plane."""
        return BASE in self.parts and bool(self.shift.any())

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return (len(self.table) - 1) * self.period

    @property
    def times(self) -> Array:
        """(N,) of its samples [s]."""
        return np.asarray(np.arange(len(self.table)) * self.period)

    @cached_property
    def places(self) -> Array:
        """See `Course`."""
        q = Setpoint.side_by_side(self.table, self.dimensions).q
        found = np.array([q.min(axis=0), q.max(axis=0)])
        return found if self.turns is None else found + self.turns[1:]

    @cached_property
    def bends(self) -> Array:
        """See `Course`."""
        return np.asarray(np.abs(Setpoint.side_by_side(self.table, self.dimensions).qddot).max(axis=0))

    @property
    def ends_at_rest(self) -> bool:
        """Whether nothing moves in its last sample."""
        last = Setpoint.side_by_side(self.table[-1], self.dimensions)
        return bool(np.abs(np.append(last.velocity, last.qdot)).max(initial=0.0) < AT_REST)

    def write(self, elapsed: float, wanted: Array) -> bool:
        """See `Course`; between two samples as their rates say."""
        d, last, place = self.dimensions, len(self.table) - 1, max(elapsed / self.period, 0.0)
        q, k = d.pose + 2 * d.twist, min(round(place), last)
        if abs(place - k) < ON_SAMPLE or place > last:
            row = self.table[k]
        else:
            k, row = int(place), self.room
            between(self.table[k], self.table[k + 1], place - k, self.period, d.twist, d.sideways, row)
        wanted[self.columns] = row[self.columns]
        if self.is_moved:
            x, y, turn = self.shift
            c, s = cos_sin(turn)
            wanted[0], wanted[1] = x + c * row[0] - s * row[1], y + s * row[0] + c * row[1]
            wanted[2] += turn
        if self.turns is not None:
            wanted[2 : 3 if BASE in self.parts else 2] += self.turns[0]
            wanted[q : q + d.arm if ARM in self.parts else q] += self.turns[1:]
        return place <= last + ON_SAMPLE

    def placed(self, pose: Array, velocity: Array | None = None) -> Motion:
        """The motion with its path beginning at a pose (3,), where it is to start from here.

        Args:
            pose: Of the reference.
            velocity: (twist,) of the reference, for motions that go on from it.
        """
        if not self.from_here or BASE not in self.parts:
            return self
        x, y, phi = self.table[0, :3]
        turn = pose[2] - phi
        c, s = cos_sin(turn)
        shift = np.array([pose[0] - c * x + s * y, pose[1] - s * x - c * y, turn])
        return replace(self, from_here=False, shift=shift)

    def at_nearest_turn(self, now: Array, is_endless: IntArray) -> Self:
        """The motion, moved by whole turns to begin near a reference.

        Args:
            now: Flat setpoint.
            is_endless: (n,) whether a whole turn of a joint is none.
        """
        d, first, turns = self.dimensions, self.table[0], np.zeros(1 + self.dimensions.arm)
        q = d.pose + 2 * d.twist
        if BASE in self.parts:
            heading = first[2] + self.shift[2]
            turns[0] = nearest_turn(heading, now[2]) - heading
        for i in np.flatnonzero(is_endless) if ARM in self.parts else ():
            turns[1 + i] = nearest_turn(first[q + i], now[q + i]) - first[q + i]
        return replace(self, turns=turns) if turns.any() else self


def instants(duration: float, period: float) -> Array:
    """Times at a period from 0 on, the last of them the end [s], (N,)."""
    return np.minimum(np.arange(math.ceil(duration / period - ON_SAMPLE) + 1) * period, duration)


@compiled
def between(a: Array, b: Array, share: float, period: float, nb: int, sideways: bool, sample: Array) -> None:
    """A sample between two (w,): cubics of the joints by their rates; the base rolls as its velocity changes.

    Args:
        a: The sample before.
        b: The next.
        share: Of the period since the former.
        period: Between the two [s].
        nb: Base velocities.
        sideways: Whether they are `(vx, vy, w)`.
        sample: (w,) the result.
    """
    pose, dt = 3 if nb else 0, share * period
    q, n = pose + 2 * nb, (a.size - pose - 2 * nb) // 3
    copy_to(a, sample)
    if nb:
        for i in range(nb):
            change = (b[pose + i] - a[pose + i]) / period
            sample[pose + i], sample[pose + nb + i] = a[pose + i] + 0.5 * change * dt, change
        roll(sample[:3], sample[pose : pose + nb], sideways, dt)
        for i in range(nb):
            sample[pose + i] = a[pose + i] + sample[pose + nb + i] * dt
    for i in range(q, q + n):
        chord = (b[i] - a[i]) / period
        c = (3.0 * chord - 2.0 * a[i + n] - b[i + n]) / period
        d = (a[i + n] + b[i + n] - 2.0 * chord) / (period * period)
        sample[i] = a[i] + dt * (a[i + n] + dt * (c + dt * d))
        sample[i + n] = a[i + n] + dt * (2.0 * c + 3.0 * dt * d)
        sample[i + 2 * n] = 2.0 * c + 6.0 * dt * d


def slopes(time: Array, q: Array, first: Array) -> Array:
    """Rates (k, n) of cubics through points that stay between every two of them (Fritsch and Carlson 1980).

    Args:
        time: (k,) [s].
        q: (k, n) points.
        first: (n,) rate wanted at the first point, which is taken as far as that holds; at the last there is rest.
    """
    from scipy.interpolate import PchipInterpolator  # slow to import, seldom needed

    rates = np.zeros_like(q)
    if len(q) > 2:
        rates[1:-1] = PchipInterpolator(time, q, axis=0)(time[1:-1], 1)
    chord = STEEPEST * (q[1] - q[0]) / (time[1] - time[0])
    rates[0] = np.clip(first, np.minimum(chord, 0.0), np.maximum(chord, 0.0))
    return rates


def require_within(motion: Motion, guide: Guide, names: Sequence[str], start: Array) -> None:
    """Refuse a motion beyond the ends, the speeds or the stated accelerations of a robot.

    Args:
        motion: The motion.
        guide: With the limits.
        names: Of the joints.
        start: (n,) where the joints' reference is. What begins outside of an end may come in.

    Raises:
        ConfigError: The joint or the velocity that is, and by how much.
    """
    d = motion.dimensions
    setpoints = Setpoint.side_by_side(motion.table, d)
    if ARM in motion.parts:
        away = np.maximum(guide.ends[0] - setpoints.q, setpoints.q - guide.ends[1])  # turns have no ends
        away = np.maximum(away - np.maximum(guide.ends[0] - start, start - guide.ends[1]).clip(0.0) - NEAR, 0.0)
        least, largest = motion.places
        for i, name in enumerate(names):
            if away[-1, i] > 0.0 or (np.diff(away[:, i]) > 0.0).any():
                what, why = f"{name} from {least[i]:.4g} to {largest[i]:.4g}", "its ends are {:.4g} and {:.4g}"
                fix = "move it between them"
                raise ConfigError(what, why=why.format(*guide.ends[:, i]), fix=fix, key="setpoint")
        steps = (
            np.abs(np.diff(setpoints.q, axis=0)).max(axis=0, initial=0.0) / motion.period
        )  # its rates may not say so
        fastest = np.maximum(np.abs(setpoints.qdot).max(axis=0), steps)
        require_slower(fastest, guide.arm[0], names, "/s", "joint_speed")
        require_slower(motion.bends, guide.arm[3], names, "/s^2", "joint_acceleration", slack=BETWEEN)
    if BASE in motion.parts:
        names, v, a = kind_of(d).twist_names, setpoints.velocity, setpoints.acceleration
        for limit, found, kind in ((guide.base[0], v, ("speed", "yaw_rate")), (guide.base[2], a, BENDS)):
            keys = [kind[name == "w"] for name in names]
            require_slower(np.abs(found).max(axis=0), limit, names, "/s" if found is v else "/s^2", *keys)
        turning = np.abs(v @ guide.wheels.T).max(initial=0.0)
        if turning > SLACK:
            what, why = f"wheels {turning:.3g} times as fast as they can", "the URDF states their speed"
            raise ConfigError(what, why=why, fix="drive more slowly", key="setpoint")


def require_slower(
    found: Array, most: Array, names: Sequence[str], unit: str, *keys: str, slack: float = SLACK
) -> None:
    """Refuse rates (k,) beyond limits (k,) (`ConfigError`)."""
    for i in np.flatnonzero(found > slack * most).tolist():
        what, why = f"{names[i]} at {found[i]:.4g} {unit}", f"its limit is {most[i]:.4g} {unit}"
        fix = f"make it slower, or raise limits.{keys[min(i, len(keys) - 1)]}"
        raise ConfigError(what, why=why, fix=fix, key="setpoint")
