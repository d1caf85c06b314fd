"""A path through points: straight lines joined by bends of bounded and continuous curvature."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import TrajectoryError
from ..signals import Array
from .path import (
    BasePath,
    BaseSamples,
    Curve,
    driven,
    require_finite,
    require_positive,
    require_start,
    there_and_stop,
    times,
)

NODES, WEIGHTS = np.polynomial.legendre.leggauss(32)


def bend(u: ArrayLike, turn: ArrayLike) -> NDArray[np.complex128]:
    """Point at fraction `u` of a bend of unit length that turns by `turn`, starting along +x; complex x + iy.

    The heading is `turn (u - sin(2 pi u) / (2 pi))`: the curvature rises from 0 to twice its mean and falls back to 0,
    with a continuous slope. Integrated by Gauss-Legendre quadrature, exact to rounding for turns up to pi.
    """
    end = np.asarray(u, float)[..., None]
    nodes = end * (1 + NODES) / 2
    heading = np.asarray(turn, float)[..., None] * (nodes - np.sin(2 * np.pi * nodes) / (2 * np.pi))
    return np.exp(1j * heading) @ WEIGHTS * end[..., 0] / 2


@dataclass(frozen=True)
class Pieces:
    """Bends (a straight is a bend of turn 0) one after the other; each field is (m,)."""

    s: Array  # path length at the start
    length: Array
    point: NDArray[np.complex128]  # start, complex x + iy
    heading: Array  # at the start
    turn: Array


@dataclass(frozen=True)
class Waypoints(BasePath):
    """Straight lines between points with the corners rounded, from rest at the first point to rest at the last.

    A corner that turns by theta is cut by a bend of length `2 |theta| radius` whose curvature rises smoothly from 0 to
    `1/radius` and back to 0, so that w and wdot are continuous (with circular arcs w would jump). The path cuts the
    corners; the first and the last point lie on it.

    Args:
        points: (k, 2) points [m], k >= 2.
        speed: Speed on the way [m/s]; negative drives the same path tail first.
        radius: Smallest radius of curvature [m].
        ramp: Time of the smooth start and of the smooth stop [s]; with 0 the speed jumps there.

    Attributes:
        length: Length of the path [m].
        duration: Time from start to rest at the last point [s].

    Raises:
        TrajectoryError: The points leave no room for the bends, or the path is too short for the ramps.
    """

    followable: ClassVar[bool] = True

    points: tuple[tuple[float, float], ...]
    speed: float
    radius: float
    ramp: float = 1.0

    def __post_init__(self) -> None:
        points = np.asarray(self.points, float)
        require_finite(points=points, speed=self.speed)
        require_positive(radius=self.radius)
        require_start((0, 0, 0), self.ramp)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
            raise TrajectoryError("points are not two or more (x, y)", fix="give points = [[x, y], [x, y], ...]")
        if self.speed == 0:
            raise TrajectoryError("speed = 0 m/s", why="it never reaches the next point", fix="give another speed")
        if self.length < abs(self.speed) * self.ramp:
            longest = self.length / abs(self.speed)
            raise TrajectoryError(
                f"path of {self.length:.3g} m is too short for ramps of {self.ramp:g} s at {self.speed:g} m/s",
                why="it would have to stop before it is up to speed",
                fix=f"give ramp <= {longest:.3g} s, or a lower speed",
            )

    @cached_property
    def _pieces(self) -> Pieces:
        return rounded(np.asarray(self.points, float), self.radius)

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(self._pieces.s[-1] + self._pieces.length[-1])

    @property
    def duration(self) -> float:
        """Time from start to rest at the last point [s]."""
        return self.length / abs(self.speed) + self.ramp

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`."""
        t = times(t)
        progress = there_and_stop(t, abs(self.speed), self.ramp, self.length)
        return driven(t, progress, self._curve(progress.s))

    def _curve(self, s: Array) -> Curve:
        p = self._pieces
        i = np.searchsorted(p.s, s, side="right") - 1
        length, turn = p.length[i], p.turn[i]
        u = np.clip((s - p.s[i]) / length, 0, 1)
        point = p.point[i] + length * np.exp(1j * p.heading[i]) * bend(u, turn)
        heading = p.heading[i] + turn * (u - np.sin(2 * np.pi * u) / (2 * np.pi))
        k = turn / length * (1 - np.cos(2 * np.pi * u))
        dk = turn / length**2 * 2 * np.pi * np.sin(2 * np.pi * u)
        forward = np.sign(self.speed)
        phi = heading if forward > 0 else heading + np.pi
        return Curve(point.real, point.imag, phi, np.full_like(s, forward), 0, k, dk)


def rounded(points: Array, radius: float) -> Pieces:
    """Straights and bends along points (k, 2), none of them sharper than `radius`.

    Raises:
        TrajectoryError: Two points coincide, the path turns back on itself, or a leg is shorter than its bends need.
    """
    legs = np.diff(points @ (1, 1j))
    if (abs(legs) < 1e-9).any():
        i = int(np.argmin(abs(legs)))
        raise TrajectoryError(f"points {i} and {i + 1} are the same: {points[i]}", fix="leave one of them out")
    turns = np.angle(legs[1:] / legs[:-1])
    if (abs(turns) > np.radians(175)).any():
        i = int(np.argmax(abs(turns))) + 1
        raise TrajectoryError(f"the path turns back at point {i}: {points[i]}", fix="go around by one more point")
    reach = 2 * abs(turns) * abs(bend(1.0, turns)) / (2 * np.cos(turns / 2))  # corner to start of bend, per radius
    need = np.append(reach, 0) + np.append(0, reach)
    short = need * radius - abs(legs)
    if (short > 1e-9).any():
        i = int(np.argmax(short))
        fits = min(abs(leg) / n for leg, n in zip(legs, need, strict=True) if n > 0)
        raise TrajectoryError(
            f"points {i} and {i + 1} are too close: {abs(legs[i]):.3g} m apart",
            why=f"the bends of radius {radius:g} m there take {need[i] * radius:.3g} m",
            fix=f"give radius <= {fits:.3g} m, or move the points",
        )
    return _chain(complex(*points[0]), legs, turns, reach * radius, radius)


def _chain(start: complex, legs: NDArray[np.complex128], turns: Array, reach: Array, radius: float) -> Pieces:
    """Alternating straights and bends; empty ones are left out."""
    straight = abs(legs) - np.append(reach, 0) - np.append(0, reach)
    length, turn = np.zeros(2 * len(legs) - 1), np.zeros(2 * len(legs) - 1)
    length[::2], length[1::2], turn[1::2] = straight, 2 * abs(turns) * radius, turns
    heading = np.angle(legs[0]) + np.cumsum(turn) - turn
    step = length * np.exp(1j * heading) * bend(1.0, turn)
    point, s = start + np.cumsum(step) - step, np.cumsum(length) - length
    keep = length > 1e-9
    return Pieces(s[keep], length[keep], point[keep], heading[keep], turn[keep])
