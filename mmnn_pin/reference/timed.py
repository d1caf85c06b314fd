"""The fastest way along a path of the base that keeps to limits, computed before it is driven.

Along a curve with parameter s, driven with `x = sdot^2` and `u = sddot`,

    v = g sdot,  vdot = g' x + g u          w = k sdot,  wdot = k' x + k u          wheel = (a g + b k) sdot

so limits on speeds and on lateral acceleration bound x, limits on accelerations are linear in (u, x). On a grid of s a
pass backwards finds the largest x from which the end can be reached at rest, a pass forwards drives as fast as that
allows (Pham and Pham 2018, IEEE T-RO 34(3), TOPP-RA). Between two points of the grid u is constant, and the limits hold
at both.

Corners cannot be driven: what a planner gives as points becomes such a curve by a spline (`Smoothed`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from ..elementary.arrays import atan2, cos_sin, hypot
from ..errors import TrajectoryError
from ..model.robot import Robot, speed_limits
from ..settings.arguments import is_numeric
from ..signals import Array
from .limits import Limits
from .path import (
    BasePath,
    BaseSamples,
    Curve,
    Eight,
    Progress,
    Waypoints,
    driven,
    require_finite,
    require_positive,
    times,
)

AGAINST = -0.5  # cosine of a heading to the way below which it looks backwards
POINTS, APART = 800, 0.02  # of the grid, at least; and how far apart they may be [m]
HALVINGS = 35  # of an interval that a bound of x is looked for in


class Bounds(NamedTuple):
    """What holds at a point of the grid, as plain numbers: there are many points, and few limits.

    Attributes:
        most: Largest x by speeds and lateral acceleration.
        linear: Factors of u and of x, and the largest `|a u + b x|`, for every limit of an acceleration.
    """

    most: float
    linear: tuple[tuple[float, float, float], ...]

    def freedom(self, x: float) -> tuple[float, float]:
        """Least and largest u with x; the first is above the second where none is left."""
        low, high = -math.inf, math.inf
        for a, b, c in self.linear:
            one, other = (-c - b * x) / a, (c - b * x) / a
            low, high = max(low, min(one, other)), min(high, max(one, other))
        return low, high


@dataclass(frozen=True, eq=False)
class Smoothed(BasePath):
    """A smooth way along points, for `Timed`: a spline of degree five, so that curvature and its slope are continuous.

    Args:
        points: (k, 2) points [m], k >= 2, at any distances.
        looks: Heading with which it begins [rad]; where that is against the way, it is driven tail first.
        wander: How far it may go beside the polygon of the points, on average [m]; its ends stay where they are.

    Attributes:
        span: Length of the polygon [m], which is the curve's parameter.

    Raises:
        TrajectoryError: Points that are not finite, or all in one place.
    """

    SPACING: ClassVar[float] = 0.05  # of what the spline goes through [m]
    followable: ClassVar[bool] = True

    points: Any
    looks: float | None = None
    wander: float = 0.02

    def __post_init__(self) -> None:
        require_positive(wander=self.wander)
        if not is_numeric(self.points) or np.ndim(self.points) != 2 or np.shape(self.points)[1] != 2:
            raise TrajectoryError("points are not two or more (x, y)", fix="give points = [[x, y], [x, y], ...]")
        require_finite(points=self.points)
        if not self.span > self.SPACING:
            raise TrajectoryError("points that are all in one place", fix=f"give a way of {self.SPACING:g} m or more")

    @cached_property
    def _polygon(self) -> tuple[Array, Array]:
        """Its points (k, 2), none twice, and how far along each is, (k,)."""
        points = np.asarray(self.points, float)
        points = points[np.append(True, hypot(*np.diff(points, axis=0).T) > 1e-3)]
        return points, np.append(0.0, np.cumsum(hypot(*np.diff(points, axis=0).T)))

    @property
    def span(self) -> float:
        """Length of the polygon of the points [m]."""
        return float(self._polygon[1][-1])

    @cached_property
    def _spline(self) -> tuple[Any, Array, Array]:
        """The spline, parameters (N,) close to each other, and the headings there, without jumps."""
        from scipy.interpolate import splev, splprep  # slow to import, seldom needed

        points, along = self._polygon
        count = max(8, round(self.span / self.SPACING) + 1)
        at = np.linspace(0.0, self.span, count)
        dense = [np.interp(at, along, column) for column in points.T]
        weights = np.ones(count)
        weights[[0, -1]] = 100.0  # it begins and ends where it should
        spline, _ = splprep(dense, w=weights, u=at, k=5, s=count * self.wander**2)
        u = np.linspace(0.0, self.span, max(50, 4 * count))
        dx, dy = splev(u, spline, der=1)
        return spline, u, np.unwrap(atan2(dy, dx))

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`: at 1 m of the polygon a second, and at rest at its end."""
        t = times(t)
        moving = np.where(t < self.span, 1.0, 0.0)
        progress = Progress(np.minimum(t, self.span), moving, np.zeros_like(t))
        return driven(t, progress, self.curve(progress.s))

    def curve(self, s: Array) -> Curve:
        """The geometry at s (k,)."""
        from scipy.interpolate import splev  # slow to import, seldom needed

        spline, u, headings = self._spline
        (x, y), (x1, y1), (x2, y2), (x3, y3) = (splev(s, spline, der=i) for i in range(4))
        g = hypot(x1, y1)
        dg = (x1 * x2 + y1 * y2) / g
        k = (x1 * y2 - y1 * x2) / g**2
        dk = (x1 * y3 - y1 * x3) / g**2 - 2 * k * dg / g
        near = np.interp(s, u, headings)
        c, sine = cos_sin(near)
        phi = near + atan2(c * y1 - sine * x1, c * x1 + sine * y1)
        if self.looks is not None and cos_sin(self.looks - headings[0])[0] < AGAINST:
            phi, g, dg = phi + np.pi, -g, -dg
        return Curve(x, y, phi, g, dg, k, dk)


@dataclass(frozen=True)
class Timed(BasePath):
    """A path of the base from rest to rest, as fast as limits allow; its own speed and ramps do not count.

    Args:
        path: `Waypoints`, one lap of an `Eight`, or points that are `Smoothed`.
        speed: Largest speed [m/s].
        yaw_rate: [rad/s].
        acceleration: [m/s^2].
        yaw_acceleration: [rad/s^2].
        lateral: Largest lateral acceleration v w [m/s^2].
        wheels: Of every drive wheel the factors a and b of its speed `a v + b w`, and its largest speed.

    Attributes:
        duration: Time from start to rest at the end [s].

    Raises:
        TrajectoryError: A limit that is not positive, or a path of another kind.
    """

    followable: ClassVar[bool] = True

    path: Waypoints | Eight | Smoothed
    speed: float = 1.0
    yaw_rate: float = 1.5
    acceleration: float = 1.0
    yaw_acceleration: float = 2.0
    lateral: float = 1.0
    wheels: tuple[tuple[float, float, float], ...] = ()

    def __post_init__(self) -> None:
        names = ("speed", "yaw_rate", "acceleration", "yaw_acceleration", "lateral")
        require_positive(**{name: getattr(self, name) for name in names})
        for forward, turning, fastest in self.wheels:
            require_finite(wheels=(forward, turning))
            require_positive(wheels=fastest)
        if not isinstance(self.path, Waypoints | Eight | Smoothed):
            fix = "give Waypoints, an Eight, or Smoothed points"
            raise TrajectoryError(f"{type(self.path).__name__} cannot be timed", fix=fix)

    @classmethod
    def of(
        cls,
        path: Waypoints | Eight | Smoothed,
        robot: Robot,
        limits: Limits = Limits(),  # noqa: B008 (frozen)
        lateral: float = 1.0,
    ) -> Self:
        """A path under the limits of setpoints, and those of a robot's wheels as its URDF states them."""
        nb, speeds = robot.dimensions.base, speed_limits(robot)
        rows = robot.E.T[: robot.dimensions.motors - robot.dimensions.arm, :nb]  # a wheel turns by its row times nu
        wheels = tuple(
            (float(row[0]), float(row[-1]), float(fastest))
            for row, fastest in zip(rows, speeds, strict=False)
            if np.isfinite(fastest) and fastest > 0
        )
        of = limits.speed, limits.yaw_rate, *limits.accelerations
        return cls(path, *of, lateral, wheels)

    @property
    def duration(self) -> float:
        """Time from start to rest at the end [s]."""
        return float(self._timing[3][-1])

    @cached_property
    def _bounds(self) -> tuple[Array, list[Bounds]]:
        """The grid (N,), and what holds on it."""
        span = self.path.span
        s = np.linspace(0.0, abs(span), POINTS)
        forward = np.sign(span)
        length = float(np.mean(np.abs(self.path.curve(forward * s).g + 0.0 * s)) * abs(span))
        s = np.linspace(0.0, abs(span), max(POINTS, math.ceil(length / APART)))
        curve, zero = self.path.curve(forward * s), np.zeros_like(s)
        g, k, dg, dk = forward * (curve.g + zero), forward * (curve.k + zero), curve.dg + zero, curve.dk + zero
        tiny = 1e-9
        speeds = [(g, self.speed), (k, self.yaw_rate)]
        speeds += [(one * g + other * k, fastest) for one, other, fastest in self.wheels]
        most = [(limit / np.maximum(abs(rate), tiny)) ** 2 for rate, limit in speeds]
        most.append(self.lateral / np.maximum(abs(g * k), tiny))
        c = np.array([[self.acceleration], [self.yaw_acceleration]])
        a, b = np.array([g, k]), np.array([dg, dk])
        most += list(np.where(abs(a) < tiny, c / np.maximum(abs(b), tiny), np.inf))  # what u does not move
        after = np.minimum(np.arange(1, len(s) + 1), len(s) - 1)  # at the next point x is x + 2 step u
        a, b = np.vstack((a, a[:, after] + 2 * (s[1] - s[0]) * b[:, after])), np.vstack((b, b[:, after]))
        c = np.vstack((c, c))
        a, b = np.where(abs(a) < tiny, tiny, a), np.where(abs(a) < tiny, 0.0, b)
        rows = zip(np.min(most, axis=0).tolist(), a.T.tolist(), b.T.tolist(), strict=True)
        reach = c[:, 0].tolist()
        return s, [Bounds(one, tuple(zip(*factors, reach, strict=True))) for one, *factors in rows]

    @cached_property
    def _timing(self) -> tuple[Array, Array, Array, Array]:
        """The grid, x on it (N,), u after each point (N - 1,), and when each is reached (N,)."""
        s, bounds = self._bounds
        step, count = float(s[1] - s[0]), len(s)
        able = [0.0] * count  # the largest x from which rest at the end can be reached
        for i in range(count - 2, -1, -1):
            able[i] = largest(bounds[i], step, able[i + 1])
        x, u = [0.0], list[float]()
        for i in range(count - 1):
            low, high = bounds[i].freedom(x[i])
            u.append(max(min(high, (able[i + 1] - x[i]) / (2 * step)), low, -x[i] / (2 * step)))
            x.append(max(x[i] + 2 * step * u[i], 0.0))
        speed = np.sqrt(x)
        passed = 2 * step / np.maximum(speed[:-1] + speed[1:], 1e-12)
        return s, np.array(x), np.array(u), np.append(0.0, np.cumsum(passed))

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`."""
        t = times(t)
        s, x, u, when = self._timing
        i = np.clip(np.searchsorted(when, t, side="right") - 1, 0, len(u) - 1)
        there = t >= when[-1]
        since, speed = np.where(there, 0.0, t - when[i]), np.sqrt(x[i])
        ds = np.where(there, 0.0, np.maximum(speed + u[i] * since, 0.0))
        at = np.where(there, s[-1], np.clip(s[i] + speed * since + u[i] * since**2 / 2, 0.0, s[-1]))
        forward = np.sign(self.path.span)
        progress = Progress(forward * at, forward * ds, forward * np.where(there, 0.0, u[i]))
        return driven(t, progress, self.path.curve(progress.s))


def largest(bounds: Bounds, step: float, after: float) -> float:
    """The largest x at a point from which one step leads to no more than `after`; all below it do so too."""

    def leads(x: float) -> bool:
        low, high = bounds.freedom(x)
        return low <= high and x + 2 * step * low <= after and x + 2 * step * high >= 0.0

    low, high = 0.0, bounds.most
    if leads(high):
        return high
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if leads(middle) else (low, middle)
    return low
