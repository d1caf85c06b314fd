"""The fastest way along a path of the base that keeps to limits, computed before it is driven.

Along a curve with parameter s, driven with `x = sdot^2` and `u = sddot`,

    v = g sdot,  vdot = g' x + g u          w = k sdot,  wdot = k' x + k u          rim = v -+ w B / 2

so limits on speeds and on lateral acceleration bound x, limits on accelerations are linear in (u, x). On a grid of s a
pass backwards finds the largest x from which the end can be reached at rest, a pass forwards drives as fast as that
allows (Pham and Pham 2018, IEEE T-RO 34(3), TOPP-RA). Between two points of the grid u is constant, and the limits hold
at both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..model.robot import Robot, speed_limits
from ..signals import Array
from .guide import Limits
from .path import BasePath, BaseSamples, Eight, Progress, Waypoints, driven, require_positive, times

POINTS = 500  # of the grid
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


@dataclass(frozen=True)
class Timed(BasePath):
    """A path of the base from rest to rest, as fast as limits allow; its own speed and ramps do not count.

    Args:
        path: `Waypoints`, or one lap of an `Eight`.
        speed: Largest speed [m/s].
        yaw_rate: [rad/s].
        acceleration: [m/s^2].
        yaw_acceleration: [rad/s^2].
        lateral: Largest lateral acceleration v w [m/s^2].
        rim: Largest speed of a drive wheel's rim [m/s].
        track: Distance B between the wheels [m].

    Attributes:
        duration: Time from start to rest at the end [s].

    Raises:
        TrajectoryError: A limit that is not positive, or a path of another kind.
    """

    followable: ClassVar[bool] = True

    path: Waypoints | Eight
    speed: float = 1.0
    yaw_rate: float = 1.5
    acceleration: float = 1.0
    yaw_acceleration: float = 2.0
    lateral: float = 1.0
    rim: float = 1e3
    track: float = 0.0

    def __post_init__(self) -> None:
        names = ("speed", "yaw_rate", "acceleration", "yaw_acceleration", "lateral", "rim")
        require_positive(**{name: getattr(self, name) for name in names})
        if not isinstance(self.path, Waypoints | Eight):
            raise TrajectoryError(f"{type(self.path).__name__} cannot be timed", fix="give Waypoints or an Eight")

    @classmethod
    def of(cls, path: Waypoints | Eight, robot: Robot, limits: Limits = Limits(), lateral: float = 1.0) -> Self:  # noqa: B008
        """A path under the limits of setpoints, and those of a robot's wheels as its URDF states them."""
        wheels = robot.base.wheels
        rims = [speed * wheel.radius for speed, wheel in zip(speed_limits(robot), wheels, strict=False)]
        rim = min([1e3, *(value for value in rims if np.isfinite(value) and value > 0)])
        of = limits.speed, limits.yaw_rate, limits.acceleration, limits.yaw_acceleration
        return cls(path, *of, lateral, rim, robot.base.track)

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
        curve, zero = self.path._curve(forward * s), np.zeros(POINTS)
        g, k, dg, dk = forward * (curve.g + zero), forward * (curve.k + zero), curve.dg + zero, curve.dk + zero
        left, right = g - k * self.track / 2, g + k * self.track / 2
        tiny = 1e-9
        speeds = ((g, self.speed), (k, self.yaw_rate), (left, self.rim), (right, self.rim))
        most = [(limit / np.maximum(abs(rate), tiny)) ** 2 for rate, limit in speeds]
        most.append(self.lateral / np.maximum(abs(g * k), tiny))
        c = np.array([[self.acceleration], [self.yaw_acceleration]])
        a, b = np.array([g, k]), np.array([dg, dk])
        most += list(np.where(abs(a) < tiny, c / np.maximum(abs(b), tiny), np.inf))  # what u does not move
        after = np.minimum(np.arange(1, POINTS + 1), POINTS - 1)  # at the next point x is x + 2 step u
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
        return driven(t, progress, self.path._curve(progress.s))


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
