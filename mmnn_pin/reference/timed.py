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
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from ..compiled import compiled
from ..elementary.arrays import atan2, cos_sin, hypot
from ..errors import TrajectoryError
from ..model.base.stance import along
from ..model.base.steered import SteeredBase
from ..model.robot import Robot
from ..settings.arguments import is_numeric
from ..signals import Array
from .limits import OF_RATE, OF_STOPS, Limits, rims
from .path import BasePath, BaseSamples, Curve, Progress, bending, driven, require_finite, require_positive, times

AGAINST = -0.5  # cosine of a heading to the way below which it looks backwards
EXACT = 1e-3  # a curve that wanders less goes through its points [m]
POINTS, APART = 800, 0.003  # of the grid, at least; and how far apart they may be [m]


@runtime_checkable
class Drivable(Protocol):
    """A curve with a smooth parameter: `Waypoints`, one lap of an `Eight`, `Smoothed` points, ..."""

    @property
    def span(self) -> float:
        """The parameter's growth over the whole curve; negative where it is driven against it."""

    def curve(self, s: Array) -> Curve:
        """The geometry at s (k,)."""


def curve_along(rates: list[Array], near: Array, backwards: bool) -> Curve:
    """The geometry of a curve, of its points and their three derivatives by the parameter.

    Args:
        rates: (k, 2) of each.
        near: (k,) the way's directions, to less than half a turn [rad].
        backwards: Whether it is driven tail first.
    """
    (x, *xs), (y, *ys) = zip(*(rate.T for rate in rates), strict=True)
    g, dg, k, dk = bending(xs, ys)
    c, sine = cos_sin(near)
    phi = near + atan2(c * ys[0] - sine * xs[0], c * xs[0] + sine * ys[0])
    return Curve(x, y, phi + np.pi, -g, -dg, k, dk) if backwards else Curve(x, y, phi, g, dg, k, dk)


@dataclass(frozen=True, eq=False)
class Smoothed(BasePath):
    """A smooth way along points, for `Timed`: a spline of degree five, so that curvature and its slope are continuous.

    Args:
        points: (k, 2) points [m], k >= 2, at any distances; one nearer than `NEAR` to the one before is left out.
        looks: Heading with which it begins [rad]; where that is against the way, it is driven tail first.
        wander: How far it may go beside the polygon of the points, on average [m]; less where they are smooth, and
            nowhere further than `FARTHEST` times that. Its ends stay where they are.
        bends: Largest curvature; where it would bend more it keeps nearer to the points [1/m].

    Attributes:
        span: Length of the polygon [m], which is the curve's parameter.

    Raises:
        TrajectoryError: Points that are not finite, or all in one place.
    """

    SPACING: ClassVar[float] = 0.05  # of what the spline goes through [m]
    NEAR: ClassVar[float] = 0.04  # [m]
    FARTHEST: ClassVar[float] = 2.5
    followable: ClassVar[bool] = True

    points: Any
    looks: float | None = None
    wander: float = 0.02
    bends: float = math.inf

    def __post_init__(self) -> None:
        require_positive(wander=self.wander)
        if not is_numeric(self.points) or np.ndim(self.points) != 2 or np.shape(self.points)[1] != 2:
            raise TrajectoryError("points are not two or more (x, y)", fix="give points = [[x, y], [x, y], ...]")
        require_finite(points=self.points)
        if not self.span > self.SPACING:
            raise TrajectoryError("points that are all in one place", fix=f"give a way of {self.SPACING:g} m or more")

    @cached_property
    def _polygon(self) -> tuple[Array, Array]:
        """Its points (k, 2), none near the one before, and how far along each is, (k,)."""
        points = thinned(np.asarray(self.points, float), self.NEAR)
        return points, np.append(0.0, np.cumsum(hypot(*np.diff(points, axis=0).T)))

    @property
    def span(self) -> float:
        """Length of the polygon of the points [m]."""
        return float(self._polygon[1][-1])

    @cached_property
    def _spline(self) -> tuple[list[Any], Array, Array]:
        """The spline and its derivatives, parameters (N,) close to each other, and headings there, without jumps."""
        points, along = self._polygon
        count = max(8, round(self.span / self.SPACING) + 1)
        u = np.union1d(np.linspace(0.0, self.span, max(50, 4 * count)), along)
        polygon = np.array([np.interp(u, along, column) for column in points.T])
        wander = min(self.wander, roughness(points, along))
        spline = fitted(points, along, count, wander)
        while wander > EXACT and hypot(*(spline(u).T - polygon)).max() > self.FARTHEST * self.wander:
            wander /= 2
            spline = fitted(points, along, count, wander)
        while wander > EXACT and sharpest(spline, u) > self.bends:  # fewer pieces may bend more
            wander /= 2
            spline = fitted(points, along, count, wander)
        splines = [spline, *(spline.derivative(i) for i in (1, 2, 3))]
        dx, dy = splines[1](u).T
        return splines, u, np.unwrap(atan2(dy, dx))

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`: at 1 m of the polygon a second, and at rest at its end."""
        t = times(t)
        moving = np.where(t < self.span, 1.0, 0.0)
        progress = Progress(np.minimum(t, self.span), moving, np.zeros_like(t))
        return driven(t, progress, self.curve(progress.s))

    def curve(self, s: Array) -> Curve:
        """The geometry at s (k,)."""
        splines, u, headings = self._spline
        tail_first = self.looks is not None and bool(cos_sin(self.looks - headings[0])[0] < AGAINST)
        return curve_along([one(s) for one in splines], np.interp(s, u, headings), tail_first)


def sharpest(spline: Any, u: Array) -> float:
    """Largest curvature of a spline at its parameters (N,) [1/m]."""
    (x1, y1), (x2, y2) = spline(u, 1).T, spline(u, 2).T
    return float(np.max(np.abs(x1 * y2 - y1 * x2) / hypot(x1, y1) ** 3))


def thinned(points: Array, near: float) -> Array:
    """Points (k, 2) without those that are nearer to the one kept before; the first and the last stay."""
    kept = [0]
    for i, (x, y) in enumerate(points.tolist()):
        dx, dy = x - points[kept[-1], 0], y - points[kept[-1], 1]
        if dx * dx + dy * dy >= near * near:
            kept.append(i)
    if len(kept) > 1 and hypot(*(points[-1] - points[kept[-1]])) < near:
        kept.pop()
    return points[[*kept, len(points) - 1]]


def roughness(points: Array, along: Array) -> float:
    """How far a polygon through points (k, 2), so far along (k,), is from its mean over 0.3 m, on average [m]."""
    at = np.linspace(0.0, along[-1], round(along[-1] / 0.05) + 1)
    dense = np.array([np.interp(at, along, column) for column in points.T])
    room = min(3, len(at) - 1)
    wide = np.pad(dense, ((0, 0), (room, room)), "reflect", reflect_type="odd")
    means = np.lib.stride_tricks.sliding_window_view(wide, 2 * room + 1, axis=1).mean(axis=2)
    return float(np.sqrt(np.mean(np.sum((dense - means) ** 2, axis=0))))


def fitted(points: Array, along: Array, count: int, wander: float) -> Any:
    """A spline along points (k, 2) that are so far along, from the first to the last of them exactly.

    Args:
        points: Corners of a polygon.
        along: (k,) the parameter at each [m].
        count: How many points of the polygon it is fitted to.
        wander: How far it goes beside them, on average [m].
    """
    from scipy.interpolate import PPoly, splprep  # slow to import, seldom needed

    at = np.linspace(0.0, along[-1], count)
    weights = np.ones(count)
    weights[[0, -1]] = 100.0
    dense = [np.interp(at, along, column) for column in points.T]
    (knots, parts, degree), _ = splprep(dense, w=weights, u=at, k=5, s=count * wander**2 if wander > EXACT else 0.0)
    parts = np.array(parts).T
    places = np.array([knots[i + 1 : i + 1 + degree].mean() for i in range(len(parts))])[:, None] / along[-1]
    lacks = points[[0, -1]] - parts[[0, -1]]  # of its ends; a line in between is one of the coefficients there
    parts += (1 - places) * lacks[0] + places * lacks[1]
    pieces = [PPoly.from_spline((knots, part, degree)) for part in parts.T]
    return PPoly(np.stack([piece.c for piece in pieces], axis=2), knots)


@dataclass(frozen=True)
class Timed(BasePath):
    """A path of the base to rest at its end, as fast as limits allow; its own speed and ramps do not count.

    Args:
        path: `Waypoints`, one lap of an `Eight`, points that are `Smoothed`, or another curve.
        speed: Largest speed [m/s].
        yaw_rate: [rad/s].
        acceleration: [m/s^2].
        yaw_acceleration: [rad/s^2].
        lateral: Largest lateral acceleration v w [m/s^2].
        wheels: Of every drive wheel the factors a and b of its speed `a v + b w`, and its largest speed.
        pace: Rate of the curve's parameter at the start, 0 for rest; at most `fastest_entry` counts.
        base: A base that steers, whose pivots turn no faster than they can; None for another.

    Attributes:
        duration: Time from start to rest at the end [s].
        fastest_entry: The largest pace from which the limits can be kept to.

    Raises:
        TrajectoryError: A limit that is not positive, or a path of another kind.
    """

    followable: ClassVar[bool] = True

    path: Drivable
    speed: float = 1.0
    yaw_rate: float = 1.5
    acceleration: float = 1.0
    yaw_acceleration: float = 2.0
    lateral: float = 1.0
    wheels: tuple[tuple[float, float, float], ...] = ()
    pace: float = 0.0
    base: SteeredBase | None = None

    def __post_init__(self) -> None:
        names = ("speed", "yaw_rate", "acceleration", "yaw_acceleration", "lateral")
        require_positive(**{name: getattr(self, name) for name in names})
        for forward, turning, fastest in self.wheels:
            require_finite(wheels=(forward, turning))
            require_positive(wheels=fastest)
        require_finite(pace=self.pace)
        if not isinstance(self.path, Drivable):
            fix = "give Waypoints, an Eight, or Smoothed points"
            raise TrajectoryError(f"{type(self.path).__name__} cannot be timed", fix=fix)

    @classmethod
    def of(
        cls,
        path: Drivable,
        robot: Robot,
        limits: Limits = Limits(),  # noqa: B008 (frozen)
        lateral: float = 1.0,
        pace: float = 0.0,
    ) -> Self:
        """A path under the limits of setpoints, and those of a robot's wheels as its URDF states them."""
        wheels = tuple(
            (float(row[0]), float(row[-1]), float(fastest))
            for row, fastest in zip(*rims(robot), strict=True)
            if np.isfinite(fastest) and fastest > 0
        )
        of = limits.speed, limits.yaw_rate, *limits.accelerations
        return cls(path, *of, lateral, wheels, pace, robot.base if isinstance(robot.base, SteeredBase) else None)

    @property
    def duration(self) -> float:
        """Time from start to rest at the end [s]."""
        return float(self._timing[3][-1])

    @property
    def fastest_entry(self) -> float:
        """The largest rate of the curve's parameter at the start from which the limits can be kept to."""
        return math.sqrt(self._able[-1][0])

    @cached_property
    def _able(self) -> tuple[Array, Array, Array, Array]:
        """The grid (N,), factors and reach of what bounds u there (m, N), and the largest x (N,)."""
        span = self.path.span
        forward, s = np.sign(span), np.linspace(0.0, abs(span), 100)
        length = float(np.mean(np.abs(self.path.curve(forward * s).g)) * abs(span))
        s = np.linspace(0.0, abs(span), max(POINTS, math.ceil(length / APART)))
        curve, zero = self.path.curve(forward * s), np.zeros_like(s)
        g, k, dg, dk = forward * (curve.g + zero), forward * (curve.k + zero), curve.dg + zero, curve.dk + zero
        tiny = 1e-9
        speeds = [(g, self.speed), (k, self.yaw_rate)]
        speeds += [(one * g + other * k, fastest) for one, other, fastest in self.wheels]
        speeds += [] if self.base is None else turns(self.base, s, Curve(curve.x, curve.y, curve.phi, g, dg, k, dk))
        most = [(limit / np.maximum(abs(rate), tiny)) ** 2 for rate, limit in speeds]
        most.append(self.lateral / np.maximum(abs(g * k), tiny))
        c = np.array([[self.acceleration], [self.yaw_acceleration]])
        a, b = np.array([g, k]), np.array([dg, dk])
        most += list(np.where(abs(a) < tiny, c / np.maximum(abs(b), tiny), np.inf))  # what u does not move
        after = np.minimum(np.arange(1, len(s) + 1), len(s) - 1)  # at the next point x is x + 2 step u
        a, b = np.vstack((a, a[:, after] + 2 * (s[1] - s[0]) * b[:, after])), np.vstack((b, b[:, after]))
        a, b = np.where(abs(a) < tiny, tiny, a), np.where(abs(a) < tiny, 0.0, b)
        slope, reach, able = b / a, np.vstack((c, c)) / abs(a), np.min(most, axis=0)
        look_back(2 * float(s[1] - s[0]), slope, reach, able)
        return s, slope, reach, able

    @cached_property
    def _timing(self) -> tuple[Array, Array, Array, Array]:
        """The grid, x on it (N,), u after each point (N - 1,), and when each is reached (N,)."""
        s, slope, reach, able = self._able
        step, x, u = float(s[1] - s[0]), np.zeros(len(s)), np.zeros(len(s) - 1)
        x[0] = min(self.pace**2, able[0])
        drive_on(2 * step, slope, reach, able, x, u)
        speed = np.sqrt(x)
        passed = 2 * step / np.maximum(speed[:-1] + speed[1:], 1e-12)
        return s, x, u, np.append(0.0, np.cumsum(passed))

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


def turns(base: SteeredBase, s: Array, curve: Curve) -> list[tuple[Array, float]]:
    """Rates (N,) of the pivots of a base by the parameter of a curve, and what of theirs a reference may need [rad/s].

    Args:
        base: The base.
        s: (N,) parameters.
        curve: The curve there.
    """
    none = np.zeros_like(s)
    twist, change = np.stack([curve.g, none, curve.k], 1), np.stack([none + curve.dg, none, none + curve.dk], 1)
    rates = along(base.pivots, s, twist, change, share=OF_STOPS).rates
    return [(rate, OF_RATE * p.rate) for rate, p in zip(rates.T, base.pivots, strict=True) if p.rate < math.inf]


@compiled
def look_back(double: float, slope: Array, reach: Array, able: Array) -> None:
    """The largest x from which the end of a grid can be reached at rest.

    A limit allows `u` in `-slope x +- reach`. All that is asked of x at a point is linear in it: that some u keeps to
    two limits at a time, and leads no further than to the next point's largest x and not below 0.

    Args:
        double: Twice the distance of two points.
        slope: (m, N) of every limit at every point.
        reach: (m, N) likewise.
        able: (N,) the largest x by speeds, then by all.
    """
    able[able.size - 1] = 0.0
    for i in range(able.size - 2, -1, -1):
        most = able[i]
        for j in range(slope.shape[0]):
            lean, far = 1.0 - double * slope[j, i], double * reach[j, i]
            if lean > 0.0:
                most = min(most, (able[i + 1] + far) / lean)
            elif lean < 0.0:
                most = min(most, -far / lean)
            for k in range(j):
                apart = abs(slope[j, i] - slope[k, i])
                if apart > 0.0:
                    most = min(most, (reach[j, i] + reach[k, i]) / apart)
        able[i] = most


@compiled
def drive_on(double: float, slope: Array, reach: Array, able: Array, x: Array, u: Array) -> None:
    """Drive along a grid as fast as what comes allows.

    Args:
        double: Twice the distance of two points.
        slope: (m, N) of every limit at every point, see `look_back`.
        reach: (m, N) likewise.
        able: (N,) the largest x.
        x: (N,) its first is given, the others are found.
        u: (N - 1,) is found.
    """
    for i in range(u.size):
        low, high = -x[i] / double, (able[i + 1] - x[i]) / double
        for j in range(slope.shape[0]):
            high = min(high, reach[j, i] - slope[j, i] * x[i])
        for j in range(slope.shape[0]):
            low = max(low, -reach[j, i] - slope[j, i] * x[i])
        u[i] = max(low, high)
        x[i + 1] = max(x[i] + double * u[i], 0.0)
