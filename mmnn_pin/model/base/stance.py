"""How the pivots of a base stand along a motion: their angles and rates, and the curvatures that their stops leave.

A wheel on a pivot at (x, y), t ahead of its axis, rolls along the heading h without sliding, the pivot held, where

    cos h (vy + x w) - sin h (vx - y w) + t w = 0        sin(h - d) = t w / R

(R, d) being size and direction of the velocity at the axis: there are two such headings, and both stay when the motion
is reversed. With vy = 0 that is `w / v = sin h / (x cos h + y sin h + t)`, as in `rolling`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compiled import compiled
from ...elementary import arrays, atan2, cos_sin, hypot
from ...signals import Array
from .rolling import PASSIVE, ROLES, Pivot

MOVES = 1e-3  # of the largest speed of a place: below it stands, and says nothing about the direction
TURN = 2.0 * math.pi
FINE = 0.5  # largest step of a swing, over the time in which it comes to rest


class Stance(NamedTuple):
    """How pivots stand along a motion."""

    angles: Array  # (N, K) of the joints [rad]
    rates: Array  # (N, K) their rates [rad/s]
    moves: NDArray[np.bool_]  # (N, K) whether the place moves, which says how it stands
    fits: NDArray[np.bool_]  # (K,) whether it stays between its stops


def room(pivot: Pivot, share: float = 1.0) -> tuple[float, float]:
    """Stops of a pivot to the left [rad], a share of the way between them."""
    low, high = sorted((pivot.sign * pivot.lower, pivot.sign * pivot.upper))
    off = 0.5 * (1.0 - share) * (high - low) if high - low < math.inf else 0.0
    return low + off, high - off


def bends(pivots: Sequence[Pivot], share: float = 1.0) -> tuple[float, float]:
    """Smallest and largest curvature of a base with a fixed axle, by the stops of what steers [1/m].

    Args:
        pivots: Of the base.
        share: Of the way between the stops.
    """
    least, most = -math.inf, math.inf
    for p in pivots:
        if p.role != ROLES[PASSIVE] and p.parent < 0:
            low, high = bends_of(p, *room(p, share))
            least, most = max(least, low), min(most, high)
    return least, most


def bends_of(p: Pivot, low: float, high: float) -> tuple[float, float]:
    """Curvatures to the right and to the left that a pivot between two stops allows [1/m]."""
    straight = math.pi * round(p.wheel[2] / math.pi)
    ahead, trail = cos_sin(straight)[0], trail_of(p)
    leans = p.x * ahead + trail
    if leans == 0.0:  # it stands on the axle's line, and steers nothing
        return -math.inf, math.inf
    found = {}
    for side, stop in ((1.0, high), (-1.0, low)):
        way = max(side * (stop + p.wheel[2] - straight), 0.0)
        pole, most = turning_points(p, trail, straight, side)
        h = straight + side * min(way, most)
        c, s = cos_sin(h)
        to = math.copysign(1.0, side * ahead * leans)
        found[to] = to * math.inf if pole <= min(way, most) else s / (p.x * c + p.y * s + trail)
    return found[-1.0], found[1.0]


def turning_points(p: Pivot, trail: float, straight: float, side: float) -> tuple[float, float]:
    """How far to a side a wheel turns until the base turns on the spot, and until its curvature grows no more [rad]."""
    far, found = hypot(p.x, p.y), []
    for middle, cosine in ((atan2(p.y, p.x), -trail / far if far else 2.0), (0.0, -p.x / trail if trail else 2.0)):
        ways = []
        if abs(cosine) <= 1.0:
            off = atan2(math.sqrt(1.0 - cosine * cosine), cosine)
            ways = [(side * (middle + s * off - straight)) % TURN for s in (1.0, -1.0)]
        found.append(min(ways, default=math.inf))
    return found[0], found[1]


def trail_of(pivot: Pivot) -> float:
    """How far ahead of a pivot's axis its wheel is, along its heading [m]."""
    (c, s), (x, y, _) = cos_sin(pivot.wheel[2]), pivot.wheel
    return x * c + y * s


def along(
    pivots: Sequence[Pivot], time: Array, twist: Array, change: Array, near: Array | None = None, share: float = 1.0
) -> Stance:
    """How the pivots of a base stand while it moves.

    What steers stands as its wheel rolls, of two ways in the one that stays between its stops, else in the nearer one;
    what is passive begins as it trails, or straight behind on a hitch, and swings as the rolling turns it.

    Args:
        pivots: Of the base, a carrier before what it carries.
        time: (N,) [s].
        twist: (N, 3) `(vx, vy, w)` of the control frame.
        change: (N, 3) its derivative.
        near: (K,) joints before [rad]; None for 0.
        share: Of the way between the stops in which they stay.
    """
    count, now = len(pivots), np.zeros(len(pivots)) if near is None else near
    angles, rates = np.zeros((len(twist), count)), np.zeros((len(twist), count))
    moves, fits = np.zeros((len(twist), count), bool), np.ones(count, bool)
    carried: list[tuple[Array, Array]] = []
    for k, p in enumerate(pivots):
        body = (twist, change) if p.parent < 0 else carried[p.parent]
        place, bent, left = at_place(p, body[0]), at_place(p, body[1]), p.sign * now[k]
        moves[:, k] = moving(place)
        if moves[:, k].any():
            ways, turning = ways_along(p, place, bent, moves[:, k])
            if p.role == ROLES[PASSIVE]:
                first = trailing(p, place, moves[:, k], ways[:, 0], left)
                ways = np.full((1, len(time)), first)
                swing(np.ascontiguousarray(time), np.ascontiguousarray(place), trail_of(p), p.wheel[2], ways[0])
                turning = swing_rate(p, place, ways[0])[None]
            at, angles[:, k], fits[k] = nearest_way(ways, left, *room(p, share))
            rates[:, k] = turning[at]
        else:
            angles[:, k] = left
        carried.append(turned_by(place, bent, angles[:, k], rates[:, k]))
        angles[:, k] *= p.sign
        rates[:, k] *= p.sign
    return Stance(angles, rates, moves, fits)


def at_place(p: Pivot, twist: Array) -> Array:
    """Velocity (N, 3) of a pivot's place on a carrier, in the carrier's axes; also of its derivative (N, 3)."""
    vx, vy, w = twist.T
    return np.stack([vx - p.y * w, vy + p.x * w, w], axis=1)


def turned_by(place: Array, bent: Array, angle: Array, rate: Array) -> tuple[Array, Array]:
    """Velocity (N, 3) of what a pivot carries, in its own axes, and its derivative but for the pivot's acceleration."""
    (c, s), (vx, vy, w), (ax, ay, wdot) = arrays.cos_sin(angle), place.T, bent.T
    here = np.stack([c * vx + s * vy, c * vy - s * vx, w + rate], axis=1)
    bends = [c * ax + s * ay + rate * here[:, 1], c * ay - s * ax - rate * here[:, 0], wdot]
    return here, np.stack(bends, axis=1)


def moving(place: Array) -> NDArray[np.bool_]:
    """Where a place moves, (N,), of its velocities (N, 3)."""
    size2 = place[:, 0] ** 2 + place[:, 1] ** 2
    return np.asarray((size2 > MOVES * MOVES * size2.max(initial=0.0)) & (size2 > 0.0))


def ways_along(p: Pivot, place: Array, bent: Array, moves: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Both ways in which a wheel stands along a motion, (2, N), to the left [rad], and their rates [rad/s].

    Where its place does not move it stands as before, at first as it will.
    """
    on = np.flatnonzero(moves)
    (x, y, w), (ax, ay, wdot), trail = place[on].T, bent[on].T, trail_of(p)
    sense = np.cumprod(np.append(1.0, np.where(x[1:] * x[:-1] + y[1:] * y[:-1] < 0.0, -1.0, 1.0)))
    size2 = x * x + y * y
    size = np.sqrt(size2)
    sine = np.clip(trail * sense * w / size, -1.0, 1.0)
    cosine = np.sqrt(np.maximum(1.0 - sine * sine, 1e-12))
    ahead, lean = arrays.unwrapped(arrays.atan2(sense * y, sense * x)), arrays.atan2(sine, cosine)
    turning = (x * ay - y * ax) / size2
    leaning = trail * sense * (wdot * size2 - w * (x * ax + y * ay)) / (size2 * size * cosine)
    ways = np.stack([ahead + lean, ahead + math.pi - lean]) - p.wheel[2]
    last = np.maximum(np.searchsorted(on, np.arange(len(place)), side="right") - 1, 0)
    rates = np.where(moves, np.stack([turning + leaning, turning - leaning])[:, last], 0.0)
    return ways[:, last], rates


def nearest_way(ways: Array, near: float, low: float, high: float) -> tuple[int, Array, bool]:
    """Of ways (2, N), each by whole turns: the nearest at first that stays between two stops, or the nearest of all.

    Returns:
        Which, its angles (N,), and whether it stays between the stops.
    """
    slack = 1e-9 + 1e-9 * min(abs(low), abs(high)) if math.isfinite(low) and math.isfinite(high) else 1e-9
    found: list[tuple[bool, float, int, int, Array]] = []
    for i, way in enumerate(ways):
        to = TURN * round((near - way[0]) / TURN)
        for turn in (to - TURN, to, to + TURN):
            one = way + turn
            fits = one.min() >= low - slack and one.max() <= high + slack
            found.append((not fits, abs(one[0] - near), len(found), i, one))
    out, _, _, i, one = min(found, key=lambda each: each[:3])
    return i, one, not out


def trailing(p: Pivot, place: Array, moves: NDArray[np.bool_], ways: Array, near: float) -> float:
    """The angle to the left at which what is passive begins: behind its axis, or straight on a hitch [rad]."""
    if not p.motor:
        return near
    first = place[np.argmax(moves)]
    for way in ways:
        c, s = cos_sin(way + p.wheel[2])
        if trail_of(p) * (c * first[0] + s * first[1]) <= 0.0:
            return float(way + TURN * round((near - way) / TURN))
    return near


def swing_rate(p: Pivot, place: Array, angle: Array) -> Array:
    """Rate (N,) to the left at which the rolling turns a passive pivot."""
    (c, s), (x, y, w), trail = arrays.cos_sin(angle + p.wheel[2]), place.T, trail_of(p)
    return np.asarray((s * x - c * y) / trail - w)


@compiled
def swing(time: Array, place: Array, trail: float, heading: float, angles: Array) -> None:
    """Angles (N,) of a passive pivot along velocities (N, 3) of its place, the first one given (Runge, Kutta)."""
    for i in range(time.size - 1):
        dt, size = time[i + 1] - time[i], max(hypot(place[i, 0], place[i, 1]), hypot(place[i + 1, 0], place[i + 1, 1]))
        steps = 1 + int(dt * size / (FINE * abs(trail)))
        h, a = 1.0 / steps, angles[i]
        for k in range(steps):
            k1 = swing_at(place[i], place[i + 1], h * k, trail, a + heading)
            k2 = swing_at(place[i], place[i + 1], h * (k + 0.5), trail, a + 0.5 * h * dt * k1 + heading)
            k3 = swing_at(place[i], place[i + 1], h * (k + 0.5), trail, a + 0.5 * h * dt * k2 + heading)
            k4 = swing_at(place[i], place[i + 1], h * (k + 1), trail, a + h * dt * k3 + heading)
            a += h * dt * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0
        angles[i + 1] = a


@compiled
def swing_at(before: Array, after: Array, share: float, trail: float, heading: float) -> float:
    """Rate of a passive pivot whose wheel has a heading, between two velocities (3,) of its place."""
    c, s = cos_sin(heading)
    x, y = before[0] + share * (after[0] - before[0]), before[1] + share * (after[1] - before[1])
    return (s * x - c * y) / trail - (before[2] + share * (after[2] - before[2]))
