"""Paths of the base: a curve driven with a smooth progress, differentiated by the chain rule.

The paths of a differential drive are curves `(x(s), y(s))` driven with a smooth `s(t)`. With `g = |d(x, y)/ds|`
(negative when driven tail first) and heading `phi(s)`:

    v = g sdot                          w = phi' sdot
    vdot = g' sdot^2 + g sddot          wdot = phi'' sdot^2 + phi' sddot

so `xdot = v cos phi`, `ydot = v sin phi`, `phidot = w` hold by construction: the base can follow, thesis (2.6).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..elementary.arrays import atan2, cos, cos_sin, hypot, sin
from ..errors import TrajectoryError
from ..settings.arguments import is_numeric, require_types, shortly
from ..signals import Array


@dataclass(frozen=True)
class BaseSamples:
    """A base path at N instants."""

    t: Array  # (N,) time [s]
    pose: Array  # (N, 3) pose of the control frame in the world `(x, y, phi)`, phi unwrapped [m, m, rad]
    # (N, twist) base velocity in the reference's own frame, `(v, w)`; `(vx, vy, w)` of a holonomic base [m/s, rad/s]
    velocity: Array
    acceleration: Array  # (N, twist) its time derivative [m/s^2, rad/s^2]


class BasePath(ABC):
    """A motion of the base.

    Attributes:
        sideways: Whether its velocities are `(vx, vy, w)`, of a base that moves sideways, and not `(v, w)`.
        followable: True for a path that the base can follow by construction; others are checked when sampled.
    """

    sideways: bool = False
    followable: ClassVar[bool] = False

    @abstractmethod
    def sample(self, t: ArrayLike) -> BaseSamples:
        """Pose, velocity and acceleration at the times `t` (N,) [s], counted from the start of the run."""


@dataclass(frozen=True)
class Progress:
    """Path parameter s over time, each (N,)."""

    s: Array
    ds: Array
    dds: Array


@dataclass(frozen=True)
class Curve:
    """A curve at N parameters s: position, heading, signed speed `g`, `k = dphi/ds`; dg and dk are d/ds; each (N,)."""

    x: Array
    y: Array
    phi: Array
    g: Array
    dg: Array | float
    k: Array
    dk: Array | float


def bending(x: Sequence[Array], y: Sequence[Array]) -> tuple[Array, Array, Array, Array]:
    """Speed g, dg, k and dk of a `Curve` (N,), by the first three derivatives of its points, (N,) each."""
    (x1, x2, x3), (y1, y2, y3) = x, y
    g = hypot(x1, y1)
    dg = (x1 * x2 + y1 * y2) / g
    k = (x1 * y2 - y1 * x2) / g**2
    return g, dg, k, (x1 * y3 - y1 * x3) / g**2 - 2 * k * dg / g


def start_up(t: Array, rate: float, ramp: float) -> Progress:
    """Reach `ds/dt = rate` from rest within `ramp` seconds, by a minimum-jerk polynomial; at once if `ramp = 0`."""
    if ramp == 0:
        return Progress(rate * t, np.full_like(t, rate), np.zeros_like(t))
    u = np.clip(t / ramp, 0, 1)
    s = rate * (ramp * u**2 * u**2 * (2.5 - 3 * u + u**2) + np.maximum(t - ramp, 0))
    return Progress(s, rate * u**2 * u * (10 - 15 * u + 6 * u**2), rate * 30 * u**2 * (1 - u) ** 2 / ramp)


def there_and_stop(t: Array, rate: float, ramp: float, length: float) -> Progress:
    """As `start_up`, but the motion mirrors itself in time and rests at `s = length` from `length / rate + ramp` on."""
    left = length / rate + ramp - t
    first, last = start_up(t, rate, ramp), start_up(np.maximum(left, 0), rate, ramp)
    ending = left < t
    ds = np.where(left < 0, 0.0, np.where(ending, last.ds, first.ds))
    return Progress(np.where(ending, length - last.s, first.s), ds, np.where(ending, -last.dds, first.dds))


def driven(t: ArrayLike, progress: Progress, curve: Curve) -> BaseSamples:
    """Samples of a curve driven with a given progress, by the chain rule at the top of this module."""
    s, c = progress, curve
    velocity = np.stack([c.g * s.ds, c.k * s.ds], axis=1)
    acceleration = np.stack([c.dg * s.ds**2 + c.g * s.dds, c.dk * s.ds**2 + c.k * s.dds], axis=1)
    return BaseSamples(np.asarray(t, float), np.stack([c.x, c.y, c.phi], axis=1), velocity, acceleration)


def times(t: ArrayLike) -> Array:
    """Times as an array (N,).

    Raises:
        TrajectoryError: They are not a list of finite numbers from 0 on.
    """
    t = np.asarray(t, float)
    if t.ndim != 1 or not np.isfinite(t).all() or (t < 0).any():
        raise TrajectoryError("sample times are not a list of finite numbers >= 0", why="a run starts at t = 0")
    return t


def require_finite(**values: ArrayLike) -> None:
    """Refuse a parameter that is not finite."""
    for name, value in values.items():
        if not is_numeric(value) or not np.isfinite(value).all():
            raise TrajectoryError(f"{name} = {shortly(value)} is not finite", fix="give finite numbers")


def require_ramps(what: str, length: float, speed: float, ramp: float) -> None:
    """Refuse a path or a stroke in which there is no room to come up to speed and to stop (`TrajectoryError`)."""
    if length < abs(speed) * ramp:
        raise TrajectoryError(
            f"{what} of {length:.3g} m is too short for ramps of {ramp:g} s at {speed:g} m/s",
            why="it would have to stop before it is up to speed",
            fix=f"give ramp <= {math.floor(100 * length / abs(speed)) / 100:g} s, or a lower speed",
        )


def require_positive(**values: float) -> None:
    """Refuse a parameter that is not a finite number above 0."""
    require_finite(**values)
    for name, value in values.items():
        if value <= 0:
            raise TrajectoryError(f"{name} = {value} is not positive", fix=f"give {name} > 0")


def require_start(path: Any) -> None:
    """Refuse fields of wrong types, a start that is not `(x, y, phi)`, a ramp that is no time from 0 on."""
    require_types(path, "start", "points")
    start, ramp = getattr(path, "start", (0, 0, 0)), path.ramp
    require_finite(start=start, ramp=ramp)
    if np.shape(start) != (3,):
        raise TrajectoryError(f"start = {shortly(start)} is not a pose", fix="give (x, y, phi) in m, m, rad")
    if ramp < 0:
        raise TrajectoryError(f"ramp = {ramp} s is negative", fix="give a time, or 0 to start at full speed")


@dataclass(frozen=True)
class Line(BasePath):
    """A straight line.

    Args:
        speed: Forward speed [m/s]; negative drives backwards with the same heading, 0 waits at the start.
        start: Pose `(x, y, phi)` at t = 0.
        ramp: Time from rest to full speed [s]; 0 starts at full speed.

    >>> Line(speed=0.3).sample([0.0, 2.0]).pose.tolist()
    [[0.0, 0.0, 0.0], [0.6, 0.0, 0.0]]
    """

    followable: ClassVar[bool] = True

    speed: float
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ramp: float = 0.0

    def __post_init__(self) -> None:
        require_start(self)
        require_finite(speed=self.speed)

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`."""
        t, (x, y, phi) = times(t), self.start
        progress = start_up(t, self.speed, self.ramp)
        s, zero = progress.s, np.zeros_like(t)
        c, sine = cos_sin(phi)
        return driven(t, progress, Curve(x + s * c, y + s * sine, zero + phi, zero + 1, 0, zero, 0))


@dataclass(frozen=True)
class Circle(BasePath):
    """A circle.

    Args:
        radius: Radius [m].
        speed: Speed along the circle [m/s]; negative drives backwards along the same circle.
        start: Pose `(x, y, phi)` at t = 0, on the circle and tangent to it.
        turn: +1 with the centre to the left, -1 to the right.
        ramp: Time from rest to full speed [s]; 0 starts at full speed.

    >>> Circle(radius=1.0, speed=0.5).sample([1.0]).velocity.tolist()
    [[0.5, 0.5]]
    """

    followable: ClassVar[bool] = True

    radius: float
    speed: float
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: int = 1
    ramp: float = 0.0

    def __post_init__(self) -> None:
        require_start(self)
        require_positive(radius=self.radius)
        require_finite(speed=self.speed)
        if self.turn not in (-1, 1):
            raise TrajectoryError(f"turn = {self.turn} is neither 1 nor -1", fix="1 turns left, -1 turns right")

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`."""
        t, (x, y, phi0) = times(t), self.start
        progress = start_up(t, self.speed, self.ramp)
        one, k = np.ones_like(t), self.turn / self.radius
        phi = phi0 + k * progress.s
        (c, s), (c0, s0) = cos_sin(phi), cos_sin(phi0)
        xs, ys = x + (s - s0) / k, y - (c - c0) / k
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

    >>> abs(Eight(length=2.0, width=1.0, period=20.0).sample([10.0]).pose[0, :2]).max() < 1e-9  # the crossing
    np.True_
    """

    followable: ClassVar[bool] = True

    length: float
    width: float
    period: float
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ramp: float = 0.0

    def __post_init__(self) -> None:
        require_start(self)
        require_positive(length=self.length, width=self.width)
        require_finite(period=self.period)
        if self.period == 0:
            raise TrajectoryError("period = 0 s", why="a lap takes time", fix="give the time of one lap")

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`."""
        progress = start_up(times(t), 2 * np.pi / self.period, self.ramp)
        return driven(t, progress, self.curve(progress.s))

    @property
    def span(self) -> float:
        """The parameter's growth over one lap [rad]."""
        return float(np.copysign(2 * np.pi, self.period))

    def curve(self, s: Array) -> Curve:
        """The geometry at s (k,)."""
        a, b = self.length / 2, self.width / 2
        (c, sine), (c2, sine2) = cos_sin(s), cos_sin(2 * s)
        x1, x2, x3 = a * c, -a * sine, -a * c
        y1, y2, y3 = 2 * b * c2, -4 * b * sine2, -8 * b * c2
        g, dg, k, dk = bending((x1, x2, x3), (y1, y2, y3))
        # The tangent never points along +y of the eight's own frame, so measured from -y its angle has no jump.
        phi = atan2(x1, -y1) - np.pi / 2
        x0, y0, phi0 = self.start
        turn = phi0 - atan2(2 * b, a)
        x, y, (c, sine) = a * sine, b * sine2, cos_sin(turn)
        return Curve(x0 + c * x - sine * y, y0 + sine * x + c * y, phi + turn, g, dg, k, dk)


@cache
def quadrature(n: int = 32) -> tuple[Array, Array]:
    """Nodes in (-1, 1) and weights of Gauss and Legendre's rule, by Newton's method on the recurrence."""
    i = np.arange(1, n + 1)
    x, slope = -cos(np.pi * (i - 0.25) / (n + 0.5)), np.ones(n)
    for _ in range(6):
        last, value = np.ones(n), x
        for k in range(2, n + 1):
            last, value = value, ((2 * k - 1) * x * value - (k - 1) * last) / k
        slope = n * (x * value - last) / (x * x - 1)
        x = x - value / slope
    return x, 2 / ((1 - x * x) * slope * slope)


def bend(u: ArrayLike, turn: ArrayLike) -> tuple[Array, Array]:
    """Point (x, y) at fraction `u` of a bend of unit length that turns by `turn`, starting along +x.

    The heading is `turn (u - sin(2 pi u) / (2 pi))`: the curvature rises from 0 to twice its mean and falls back to 0,
    with a continuous slope. Integrated by Gauss-Legendre quadrature, exact to rounding for turns up to pi.
    """
    end, (nodes, weights) = np.asarray(u, float)[..., None], quadrature()
    at = end * (1 + nodes) / 2
    heading = np.asarray(turn, float)[..., None] * (at - sin(2 * np.pi * at) / (2 * np.pi))
    c, s = cos_sin(heading)
    return (c * weights).sum(axis=-1) * end[..., 0] / 2, (s * weights).sum(axis=-1) * end[..., 0] / 2


def turned(point: tuple[Array, Array], angle: ArrayLike) -> tuple[Array, Array]:
    """Points (x, y) turned by angles about the origin."""
    (x, y), (c, s) = point, cos_sin(angle)
    return c * x - s * y, s * x + c * y


@dataclass(frozen=True)
class Bends:
    """Bends (a straight is a bend of turn 0) one after the other; each field is (m,)."""

    s: Array  # path length at the start
    length: Array
    x: Array  # start
    y: Array
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
        require_start(self)
        require_positive(radius=self.radius)
        shape = np.shape(self.points) if is_numeric(self.points) else ()
        if len(shape) != 2 or shape[1] != 2 or shape[0] < 2:
            raise TrajectoryError("points are not two or more (x, y)", fix="give points = [[x, y], [x, y], ...]")
        require_finite(points=self.points, speed=self.speed)
        if self.speed == 0:
            raise TrajectoryError("speed = 0 m/s", why="it never reaches the next point", fix="give another speed")
        require_ramps("path", self.length, self.speed, self.ramp)

    @cached_property
    def _pieces(self) -> Bends:
        return rounded(np.asarray(self.points, float), self.radius)

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(self._pieces.s[-1] + self._pieces.length[-1])

    @property
    def span(self) -> float:
        """The parameter's growth over the whole path, its length [m]."""
        return self.length

    @property
    def duration(self) -> float:
        """Time from start to rest at the last point [s]."""
        return self.length / abs(self.speed) + self.ramp

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`."""
        t = times(t)
        progress = there_and_stop(t, abs(self.speed), self.ramp, self.length)
        return driven(t, progress, self.curve(progress.s))

    def curve(self, s: Array) -> Curve:
        """The geometry at s (k,)."""
        p = self._pieces
        i = np.searchsorted(p.s, s, side="right") - 1
        length, turn = p.length[i], p.turn[i]
        u = np.clip((s - p.s[i]) / length, 0, 1)
        (x, y), (c, s1) = turned(bend(u, turn), p.heading[i]), cos_sin(2 * np.pi * u)
        heading = p.heading[i] + turn * (u - s1 / (2 * np.pi))
        k, dk = turn / length * (1 - c), turn / length**2 * 2 * np.pi * s1
        forward = np.sign(self.speed)
        phi = heading if forward > 0 else heading + np.pi
        return Curve(p.x[i] + length * x, p.y[i] + length * y, phi, np.full_like(s, forward), 0, k, dk)


def rounded(points: Array, radius: float) -> Bends:
    """Straights and bends along points (k, 2), none of them sharper than `radius`.

    Raises:
        TrajectoryError: Two points coincide, the path turns back on itself, or a leg is shorter than its bends need.
    """
    dx, dy = np.diff(points, axis=0).T
    legs = hypot(dx, dy)
    if (legs < 1e-9).any():
        i = int(np.argmin(legs))
        raise TrajectoryError(f"points {i} and {i + 1} are the same: {points[i]}", fix="leave one of them out")
    turns = atan2(dx[:-1] * dy[1:] - dy[:-1] * dx[1:], dx[:-1] * dx[1:] + dy[:-1] * dy[1:])
    if (abs(turns) > np.radians(175)).any():
        i = int(np.argmax(abs(turns))) + 1
        raise TrajectoryError(f"the path turns back at point {i}: {points[i]}", fix="go around by one more point")
    reach = 2 * abs(turns) * hypot(*bend(1.0, turns)) / (2 * cos(turns / 2))  # corner to start of bend, per radius
    need = np.append(reach, 0) + np.append(0, reach)
    short = need * radius - legs
    if (short > 1e-9).any():
        i = int(np.argmax(short))
        fits = min(leg / n for leg, n in zip(legs, need, strict=True) if n > 0)
        raise TrajectoryError(
            f"points {i} and {i + 1} are too close: {legs[i]:.3g} m apart",
            why=f"the bends of radius {radius:g} m there take {need[i] * radius:.3g} m",
            fix=f"give radius <= {fits:.3g} m, or move the points",
        )
    heading = float(atan2(dy[0], dx[0]))
    return _chain(points[0], heading, legs, turns, reach * radius, radius)


def _chain(start: Array, first: float, legs: Array, turns: Array, reach: Array, radius: float) -> Bends:
    """Alternating straights and bends from a point (2,) and a heading; empty ones are left out."""
    straight = legs - np.append(reach, 0) - np.append(0, reach)
    length, turn = np.zeros(2 * len(legs) - 1), np.zeros(2 * len(legs) - 1)
    length[::2], length[1::2], turn[1::2] = straight, 2 * abs(turns) * radius, turns
    heading = first + np.cumsum(turn) - turn
    dx, dy = (length * part for part in turned(bend(1.0, turn), heading))
    x, y, s = start[0] + np.cumsum(dx) - dx, start[1] + np.cumsum(dy) - dy, np.cumsum(length) - length
    keep = length > 1e-9
    return Bends(s[keep], length[keep], x[keep], y[keep], heading[keep], turn[keep])


@dataclass(frozen=True)
class Parking(BasePath):
    """Parallel parking: to a place beside the start, with the same heading, in strokes backwards and forwards.

    Every stroke is a bend to one side and its mirror image, from rest to rest, and brings the base as far aside as any
    other. Curvature rises smoothly from 0 and falls back to 0, so that the steering is straight where it stops.

    Args:
        aside: How far to the left the place is [m]; negative to the right.
        radius: Smallest radius of curvature [m].
        speed: Speed of a stroke [m/s]; the first is driven backwards, with a negative speed forwards.
        strokes: How many; more need less room, and an even number ends beside where it began.
        start: Pose `(x, y, phi)` at t = 0.
        ramp: Time of the smooth start and of the smooth stop of a stroke [s].

    Attributes:
        length: Way of one stroke [m].
        room: How far it goes along the heading of the start [m].
        duration: Time until it rests at its place [s].

    Raises:
        TrajectoryError: Strokes that are none, or too short for their ramps or too long for their bends.

    >>> Parking(aside=-1.0, radius=1.2, speed=0.4, strokes=2).sample([60.0]).pose.round(6).tolist()
    [[0.0, -1.0, 0.0]]
    """

    followable: ClassVar[bool] = True

    aside: float
    radius: float
    speed: float
    strokes: int = 1
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ramp: float = 1.0

    def __post_init__(self) -> None:
        require_start(self)
        require_positive(radius=self.radius)
        require_finite(aside=self.aside, speed=self.speed)
        if self.strokes < 1:
            raise TrajectoryError(f"strokes = {self.strokes}", why="it parks by driving", fix="give 1 or more")
        if self.speed == 0:
            raise TrajectoryError("speed = 0 m/s", why="it never reaches its place", fix="give another speed")
        far = abs(self.aside) / (self.strokes * self.radius)
        if not 0 < far < self._aside_of(np.pi / 2):
            fewest = 1 + int(abs(self.aside) / (self.radius * self._aside_of(np.pi / 2)))
            fix = f"give strokes >= {fewest}, or another place" if far else "give aside other than 0"
            raise TrajectoryError(f"aside = {self.aside:g} m in {self.strokes} strokes", why="it turns across", fix=fix)
        require_ramps("stroke", self.length, self.speed, self.ramp)

    @staticmethod
    def _aside_of(turn: float) -> float:
        """How far aside a bend by an angle [rad] and its mirror image lead, by the radius."""
        return 4 * turn * float(bend(1.0, turn)[1])

    @cached_property
    def turn(self) -> float:
        """By how much a bend turns [rad], found by halving."""
        low, high, far = 0.0, np.pi / 2, abs(self.aside) / (self.strokes * self.radius)
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if self._aside_of(middle) < far else (low, middle)
        return (low + high) / 2

    @property
    def length(self) -> float:
        """Way of one stroke [m]."""
        return 4 * self.turn * self.radius

    @property
    def room(self) -> float:
        """How far it goes along the heading of the start [m]."""
        return self.length * float(bend(1.0, self.turn)[0])

    @property
    def duration(self) -> float:
        """Time until it rests at its place [s]."""
        return self.strokes * self._lasts

    @property
    def _lasts(self) -> float:
        """Time of a stroke [s]."""
        return self.length / abs(self.speed) + self.ramp

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`."""
        t = times(t)
        stroke = np.clip((t / self._lasts).astype(int), 0, self.strokes - 1)
        progress = there_and_stop(t - stroke * self._lasts, abs(self.speed), self.ramp, self.length)
        return driven(t, progress, self._curve(progress.s, stroke))

    def _curve(self, s: Array, stroke: NDArray[np.int64]) -> Curve:
        """The geometry at s (k,) of strokes (k,)."""
        sense = np.where(stroke % 2 == 0, -1.0, 1.0) * np.copysign(1.0, self.speed)
        side, half = sense * np.copysign(1.0, self.aside), self.length / 2
        second = s > half
        u = np.where(second, self.length - s, s) / half  # the second bend is the first one turned by half a turn
        (x, y), (c, sine) = bend(u, self.turn), cos_sin(2 * np.pi * u)
        end = self._aside_of(self.turn) * self.radius
        x, y = np.where(second, self.room - half * x, half * x), np.where(second, end - half * y, half * y)
        k, dk = self.turn / half * (1 - c), self.turn / half**2 * 2 * np.pi * sine
        before = np.where(stroke % 2 == 0, 0.0, -np.copysign(self.room, self.speed))
        along = before + sense * x
        across = np.copysign(1.0, self.aside) * (y + stroke * end)
        x0, y0, phi0 = self.start
        (c0, s0), heading = cos_sin(phi0), side * self.turn * (u - sine / (2 * np.pi))
        phi, k = phi0 + heading, side * np.where(second, -k, k)
        return Curve(x0 + c0 * along - s0 * across, y0 + s0 * along + c0 * across, phi, sense, 0, k, side * dk)
