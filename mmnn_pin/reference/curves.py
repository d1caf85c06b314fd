"""Closed-form paths: line, circle, eight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..signals import Array
from .path import BasePath, BaseSamples, Curve, driven, require_finite, require_positive, require_start, start_up, times


@dataclass(frozen=True)
class Line(BasePath):
    """A straight line.

    Args:
        speed: Forward speed [m/s]; negative drives backwards with the same heading, 0 waits at the start.
        start: Pose `(x, y, phi)` at t = 0.
        ramp: Time from rest to full speed [s]; 0 starts at full speed.
    """

    followable: ClassVar[bool] = True

    speed: float
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ramp: float = 0.0

    def __post_init__(self) -> None:
        require_finite(speed=self.speed)
        require_start(self.start, self.ramp)

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`."""
        t = times(t)
        x, y, phi = self.start
        progress = start_up(t, self.speed, self.ramp)
        s, zero = progress.s, np.zeros_like(t)
        return driven(t, progress, Curve(x + s * np.cos(phi), y + s * np.sin(phi), zero + phi, zero + 1, 0, zero, 0))


@dataclass(frozen=True)
class Circle(BasePath):
    """A circle.

    Args:
        radius: Radius [m].
        speed: Speed along the circle [m/s]; negative drives backwards along the same circle.
        start: Pose `(x, y, phi)` at t = 0, on the circle and tangent to it.
        turn: +1 with the centre to the left, -1 to the right.
        ramp: Time from rest to full speed [s]; 0 starts at full speed.
    """

    followable: ClassVar[bool] = True

    radius: float
    speed: float
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: int = 1
    ramp: float = 0.0

    def __post_init__(self) -> None:
        require_positive(radius=self.radius)
        require_finite(speed=self.speed)
        require_start(self.start, self.ramp)
        if self.turn not in (-1, 1):
            raise TrajectoryError(f"turn = {self.turn} is neither 1 nor -1", fix="1 turns left, -1 turns right")

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`."""
        t = times(t)
        x, y, phi0 = self.start
        progress = start_up(t, self.speed, self.ramp)
        one, k = np.ones_like(t), self.turn / self.radius
        phi = phi0 + k * progress.s
        xs, ys = x + (np.sin(phi) - np.sin(phi0)) / k, y - (np.cos(phi) - np.cos(phi0)) / k
        return driven(t, progress, Curve(xs, ys, phi, one, 0, k * one, 0))


@dataclass(frozen=True)
class Eight(BasePath):
    """A figure of eight (Gerono's lemniscate) `x = length/2 sin s`, `y = width/2 sin 2s`, in a turned frame.

    It is fastest and straight at the crossing, slower and sharpest near the four corners of its box.

    Args:
        length: Extent along its long axis [m].
        width: Extent across [m].
        period: Time of one lap [s]; negative drives the same curve backwards.
        start: Pose `(x, y, phi)` at t = 0: the crossing, with the heading of the path there.
        ramp: Time from rest to full speed [s]; 0 starts at full speed.
    """

    followable: ClassVar[bool] = True

    length: float
    width: float
    period: float
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ramp: float = 0.0

    def __post_init__(self) -> None:
        require_positive(length=self.length, width=self.width)
        require_finite(period=self.period)
        require_start(self.start, self.ramp)
        if self.period == 0:
            raise TrajectoryError("period = 0 s", why="a lap takes time", fix="give the time of one lap")

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`."""
        t = times(t)
        progress = start_up(t, 2 * np.pi / self.period, self.ramp)
        return driven(t, progress, self._curve(progress.s))

    def _curve(self, s: Array) -> Curve:
        a, b = self.length / 2, self.width / 2
        x1, x2, x3 = a * np.cos(s), -a * np.sin(s), -a * np.cos(s)
        y1, y2, y3 = 2 * b * np.cos(2 * s), -4 * b * np.sin(2 * s), -8 * b * np.cos(2 * s)
        g = np.hypot(x1, y1)
        dg = (x1 * x2 + y1 * y2) / g
        k = (x1 * y2 - y1 * x2) / g**2
        dk = (x1 * y3 - y1 * x3) / g**2 - 2 * k * dg / g
        # The tangent never points along +y of the eight's own frame, so measured from -y its angle has no jump.
        phi = np.arctan2(x1, -y1) - np.pi / 2
        x0, y0, phi0 = self.start
        turn = phi0 - np.arctan2(2 * b, a)
        x, y = a * np.sin(s), b * np.sin(2 * s)
        cos, sin = np.cos(turn), np.sin(turn)
        return Curve(x0 + cos * x - sin * y, y0 + sin * x + cos * y, phi + turn, g, dg, k, dk)
