"""Paths of a hand: lines, circles, splines, poses from a file, waits; one after the other, from rest to rest.

A path is relative to the pose of the hand where it begins: x ahead of the robot, y to its left, z up. Its orientation
is a rotation on top of the one that the hand has there. Rotations are unit quaternions `(x, y, z, w)`, normalised
splines of them between poses, so that angular velocity and acceleration are analytic and need no libm.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...elementary.arrays import cos_sin
from ...elementary.matrices import product
from ...errors import TrajectoryError
from ...signals import Array
from ..path import Progress, require_finite, require_positive, there_and_stop, times
from ..samples import TableColumns

Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class HandSamples:
    """A motion of a hand at N instants, in the axes of its path or of the world."""

    position: Array  # (N, 3) [m]
    velocity: Array  # (N, 3) [m/s]
    acceleration: Array  # (N, 3) [m/s^2]
    rotation: Array  # (N, 3, 3), of the hand's axes
    spin: Array  # (N, 3) angular velocity [rad/s]
    spin_rate: Array  # (N, 3) its derivative [rad/s^2]

    @property
    def flat(self) -> Array:
        """(N, 24): position, velocity, acceleration, rotation row by row, spin, its derivative."""
        n = len(self.position)
        parts = (self.position, self.velocity, self.acceleration, self.rotation.reshape(n, 9))
        return np.hstack((*parts, self.spin, self.spin_rate))


class HandPath(ABC):
    """A motion of a hand from rest to rest, relative to where it begins."""

    @property
    def begin(self) -> tuple[Array | None, Array | None]:
        """Where it begins in the world and how the hand is turned there, (3,) and (3, 3), if it says so."""
        return None, None

    @property
    @abstractmethod
    def duration(self) -> float:
        """How long it takes [s]."""

    @abstractmethod
    def sample(self, t: ArrayLike) -> HandSamples:
        """The motion at times (N,) [s], at rest at its end after its duration."""


def driven(progress: Progress, point: Array, d1: Array, d2: Array) -> HandSamples:
    """Samples of a curve (N, 3) without turning, by its derivatives along the progress."""
    n, ds, dds = len(point), progress.ds[:, None], progress.dds[:, None]
    still = np.zeros((n, 3))
    return HandSamples(point, d1 * ds, d2 * ds**2 + d1 * dds, np.tile(np.eye(3), (n, 1, 1)), still, still)


def require_speed(speed: float, ramp: float, length: float) -> None:
    """Refuse a speed that is not positive, and a path that is shorter than its ramps take."""
    require_positive(speed=speed)
    require_finite(ramp=ramp)
    if ramp < 0 or length < speed * ramp:
        longest = length / speed
        raise TrajectoryError(
            f"path of {length:.3g} m is too short for ramps of {ramp:g} s at {speed:g} m/s",
            why="the hand would have to stop before it is up to speed",
            fix=f"give ramp from 0 to {longest:.3g} s, or a lower speed",
        )


@dataclass(frozen=True)
class HandLine(HandPath):
    """A straight line.

    Args:
        by: Where to, from where it begins [m].
        speed: [m/s].
        ramp: Time of the smooth start and of the smooth stop [s].
    """

    by: Vector3
    speed: float = 0.2
    ramp: float = 1.0

    def __post_init__(self) -> None:
        require_finite(by=self.by)
        require_speed(self.speed, self.ramp, self.length)

    @property
    def length(self) -> float:
        """[m]."""
        return float(np.sqrt(np.sum(np.square(self.by))))

    @property
    def duration(self) -> float:
        """See `HandPath`."""
        return self.length / self.speed + self.ramp

    def sample(self, t: ArrayLike) -> HandSamples:
        """See `HandPath`."""
        progress = there_and_stop(times(t), self.speed, self.ramp, self.length)
        along = np.tile(np.array(self.by) / self.length, (len(progress.s), 1))
        return driven(progress, along * progress.s[:, None], along, np.zeros_like(along))


@dataclass(frozen=True)
class HandCircle(HandPath):
    """Circles, which begin along `ahead` and end where they began.

    Args:
        radius: [m].
        speed: [m/s].
        laps: How many times around.
        ramp: Time of the smooth start and of the smooth stop [s].
        ahead: Direction in which it begins.
        centre: Direction of the centre from there, at right angles to `ahead`.
    """

    radius: float
    speed: float = 0.2
    laps: float = 1.0
    ramp: float = 1.0
    ahead: Vector3 = (1.0, 0.0, 0.0)
    centre: Vector3 = (0.0, 1.0, 0.0)

    def __post_init__(self) -> None:
        require_positive(radius=self.radius, laps=self.laps)
        require_finite(ahead=self.ahead, centre=self.centre)
        a, b = (np.array(each, float) for each in (self.ahead, self.centre))
        if not (np.sum(a * a) > 0 and np.sum(b * b) > 0 and abs(np.sum(a * b)) < 1e-9):
            raise TrajectoryError(
                f"ahead = {self.ahead}, centre = {self.centre} are not at right angles",
                fix="give two directions such as (1, 0, 0) and (0, 0, 1)",
            )
        require_speed(self.speed, self.ramp, self.length)

    @property
    def length(self) -> float:
        """[m]."""
        return 2 * np.pi * self.radius * self.laps

    @property
    def duration(self) -> float:
        """See `HandPath`."""
        return self.length / self.speed + self.ramp

    def sample(self, t: ArrayLike) -> HandSamples:
        """See `HandPath`."""
        progress, r = there_and_stop(times(t), self.speed, self.ramp, self.length), self.radius
        a, b = (np.array(each) / np.sqrt(np.sum(np.square(each))) for each in (self.ahead, self.centre))
        c, s = (each[:, None] for each in cos_sin(progress.s / r))
        return driven(progress, r * (s * a + (1 - c) * b), c * a + s * b, (c * b - s * a) / r)


@dataclass(frozen=True)
class Wait(HandPath):
    """The hand stays where it is for a time [s]."""

    seconds: float

    def __post_init__(self) -> None:
        require_positive(seconds=self.seconds)

    @property
    def duration(self) -> float:
        """See `HandPath`."""
        return self.seconds

    def sample(self, t: ArrayLike) -> HandSamples:
        """See `HandPath`."""
        n = len(times(t))
        zero = np.zeros(n)
        return driven(Progress(zero, zero, zero), *(np.zeros((n, 3)) for _ in range(3)))


@dataclass(frozen=True, eq=False)
class HandSpline(HandPath):
    """A smooth curve through points at given times, with orientations or without, at rest at both ends.

    Args:
        points: (k, 3) points, the first where the hand begins [m].
        time: (k,) times [s], increasing from 0.
        quaternions: (k, 4) orientations `(x, y, z, w)`, or None to keep the one that the hand has.
    """

    points: tuple[Vector3, ...]
    time: tuple[float, ...]
    quaternions: tuple[tuple[float, float, float, float], ...] | None = None

    def __post_init__(self) -> None:
        points, time = np.array(self.points, float), np.array(self.time, float)
        if points.ndim != 2 or points.shape[1:] != (3,) or time.shape != (len(points),) or len(time) < 2:
            what = f"points of shape {points.shape} at times of shape {time.shape}"
            raise TrajectoryError(what, fix="give two or more points (x, y, z), and a time for each")
        require_finite(points=points, time=time)
        if time[0] != 0 or (np.diff(time) <= 0).any():
            raise TrajectoryError("times do not increase from 0", fix="sort them, start at 0")
        if self.quaternions is None:
            return
        q = np.array(self.quaternions, float)
        if q.shape != (len(points), 4) or not np.isfinite(q).all() or (np.sum(q * q, axis=1) < 1e-6).any():
            raise TrajectoryError("orientations that are no quaternions", fix="give (x, y, z, w) for every point")

    @classmethod
    def read(cls, file: str | Path) -> HandSpline:
        """Poses from a CSV file with the columns `t, x, y, z` and, for orientations, `qx, qy, qz, qw`.

        Raises:
            TrajectoryError: A column is missing, or a value is no number (with the line); as for the class.
        """
        names, turned = ("t", "x", "y", "z"), ("qx", "qy", "qz", "qw")
        found = TableColumns.read(file, names)
        if turns := any(name in found for name in turned):
            found = TableColumns.read(file, (*names, *turned))
        t, *points = (found[name] for name in names)
        with found.blamed():
            return cls(np.stack(points, 1), t, np.stack([found[name] for name in turned], 1) if turns else None)  # type: ignore[arg-type]

    @property
    def duration(self) -> float:
        """See `HandPath`."""
        return float(self.time[-1])

    @cached_property
    def _splines(self) -> tuple[Any, Any]:
        from scipy.interpolate import CubicSpline  # slow to import, seldom needed

        points, q = np.array(self.points, float), np.tile((0.0, 0.0, 0.0, 1.0), (len(self.time), 1))
        if self.quaternions is not None:
            q = np.array(self.quaternions, float)
            q /= np.sqrt(np.sum(q * q, axis=1, keepdims=True))
            for i in range(1, len(q)):  # the nearer of the two that mean the same
                q[i] *= -1.0 if np.sum(q[i] * q[i - 1]) < 0 else 1.0
        return tuple(CubicSpline(self.time, each, bc_type="clamped") for each in (points, q))

    def sample(self, t: ArrayLike) -> HandSamples:
        """See `HandPath`."""
        points, turning = self._splines
        at, first = np.minimum(times(t), self.duration), rotations(turning([0.0]), *np.zeros((2, 1, 4)))[0][0]
        moving = (times(t) < self.duration)[:, None]
        R, spin, spin_rate = rotations(turning(at), turning(at, 1) * moving, turning(at, 2) * moving)
        R = product(R.reshape(-1, 3), first.T).reshape(-1, 3, 3)
        return HandSamples(points(at) - points(0.0), points(at, 1) * moving, points(at, 2) * moving, R, spin, spin_rate)

    @property
    def begin(self) -> tuple[Array | None, Array | None]:
        """See `HandPath`."""
        turned = self.quaternions is not None
        R = rotations(self._splines[1]([0.0]), *np.zeros((2, 1, 4)))[0][0] if turned else None
        return np.array(self.points[0], float), R


def rotations(q: Array, dq: Array, ddq: Array) -> tuple[Array, Array, Array]:
    """Rotation (N, 3, 3), angular velocity and acceleration (N, 3) of a quaternion (N, 4) of any length.

    `omega = 2 vec(qdot conj(q)) / |q|^2`, which does not see how the length changes.
    """
    square = np.sum(q * q, axis=1, keepdims=True)
    growth = 2 * np.sum(q * dq, axis=1, keepdims=True) / square
    spin = 2 * vector_of(dq, q) / square
    x, y, z, w = (q / np.sqrt(square)).T
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return np.moveaxis(R, 2, 0), spin, 2 * vector_of(ddq, q) / square - spin * growth


def vector_of(a: Array, b: Array) -> Array:
    """Vector part of the product of quaternions `a conj(b)`, (N, 3)."""
    return a[:, 3:] * -b[:, :3] + b[:, 3:] * a[:, :3] - np.cross(a[:, :3], b[:, :3])


@dataclass(frozen=True)
class Pieces(HandPath):
    """Paths one after the other, each relative to where the one before ended."""

    parts: tuple[HandPath, ...]

    def __post_init__(self) -> None:
        if not self.parts:
            raise TrajectoryError("a path without parts", fix="give at least one")

    @property
    def begin(self) -> tuple[Array | None, Array | None]:
        """See `HandPath`."""
        return self.parts[0].begin

    @property
    def duration(self) -> float:
        """See `HandPath`."""
        return sum(part.duration for part in self.parts)

    def sample(self, t: ArrayLike) -> HandSamples:
        """See `HandPath`."""
        t, begin, found = times(t), 0.0, []
        at, R = np.zeros(3), np.eye(3)
        for i, part in enumerate(self.parts):
            end, last = begin + part.duration, i + 1 == len(self.parts)
            inside = (t >= begin) & ((t < end) | last)
            here = placed(part.sample(np.array([*(t[inside] - begin), part.duration])), at, np.eye(3), R)
            found.append(HandSamples(*(getattr(here, name)[:-1] for name in here.__dataclass_fields__)))
            at, R, begin = here.position[-1], here.rotation[-1], end
        order = np.argsort(np.argsort(t, kind="stable"), kind="stable")
        names = HandSamples.__dataclass_fields__
        return HandSamples(*(np.concatenate([getattr(f, name) for f in found])[order] for name in names))


def placed(samples: HandSamples, origin: Array, axes: Array, rotation: Array) -> HandSamples:
    """A motion whose path has its origin and axes (3, 3) in the world, on top of a rotation (3, 3) of the hand."""
    vectors = (samples.position, samples.velocity, samples.acceleration, samples.spin, samples.spin_rate)
    p, v, a, spin, spin_rate = (product(each, axes.T) for each in vectors)
    after = product(samples.rotation.reshape(-1, 3), axes.T, rotation).reshape(-1, 3, 3)
    R = product(after.transpose(0, 2, 1).reshape(-1, 3), axes.T).reshape(-1, 3, 3).transpose(0, 2, 1)
    return HandSamples(origin + p, v, a, R, spin, spin_rate)
