"""A planner's poses as legs of a drive: each from rest to rest, ahead or in reverse, and the heading at the end.

    poses ─▶ headings that say something ─▶ tips, where the way turns back ─▶ legs, as lines or `Smoothed`

Planners fill headings that they do not know with the identity, which also is the heading 0. It counts where it lies
along the way at every such pose and looks ahead at one of them at least; else the way itself says where to look.
Points that go back and forth by less than `FOLD`, as those of a noisy planner do, are no change of direction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..elementary.arrays import atan2, cos_sin, hypot, sin
from ..signals import Array, IntArray
from .path import Curve
from .timed import Drivable, Smoothed, thinned

FOLD = 0.05  # what points may go back and forth, or beside a line, without a meaning [m]
SHARP = -0.17  # cosine of the turn beyond which a corner is a change of direction: 100 degrees
PARALLEL = 0.985  # cosine of an angle between a heading and the way that counts as none: 10 degrees
AGAINST = -0.5  # mean cosine of headings and way below which a leg is driven in reverse
STRAIGHT = 1e-3  # what a line's points may lie beside it [m]
FINE = 0.01  # distance of the points at which a leg is looked for [m]


@dataclass(frozen=True)
class Arc:
    """Driving and turning in a constant ratio from a pose: a line, a circle, or a turn on the spot."""

    start: tuple[float, float, float]  # pose (x, y, phi)
    forward: float  # way by the parameter [m], negative tail first
    turning: float  # heading by the parameter [rad]
    span: float  # the parameter at its end

    def curve(self, s: Array) -> Curve:
        """The geometry at s (k,)."""
        x, y, phi = self.start
        half, one = 0.5 * self.turning * s, np.ones_like(s)
        chord = self.forward * s * np.where(abs(half) < 1e-9, 1.0, sin(half) / np.where(abs(half) < 1e-9, 1.0, half))
        c, sine = cos_sin(phi + half)
        return Curve(x + chord * c, y + chord * sine, phi + 2 * half, self.forward * one, 0, self.turning * one, 0)


@dataclass(frozen=True, eq=False)
class Leg:
    """A part of a route from rest to rest."""

    path: Drivable  # its curve
    backwards: bool  # whether it is driven in reverse

    @cached_property
    def grid(self) -> tuple[Array, Array]:
        """Parameters (N,), close to each other, and the points there (N, 2)."""
        s = np.linspace(0.0, self.path.span, max(2, round(self.path.span / FINE) + 1))
        curve = self.path.curve(s)
        return s, np.stack([curve.x, curve.y], axis=1)

    def pose(self, s: float) -> Array:
        """The pose (3,) at a parameter."""
        curve = self.path.curve(np.array([s]))
        return np.array([curve.x[0], curve.y[0], curve.phi[0]])

    def nearest(self, pose: Array) -> tuple[float, float]:
        """Where it passes a pose (3,), walked along from its start as long as that comes nearer; and how far aside."""
        s, points = self.grid
        away = hypot(*(points - pose[:2]).T)
        i = int(np.argmax(np.append(np.diff(away) >= 0.0, True)))
        return float(s[i]), float(away[i])


@dataclass(frozen=True, eq=False)
class Route:
    """The route that a planner asks of a base.

    Args:
        legs: Ways from rest to rest; none where all poses are in one place.
        end: (2,) the last point [m].
        heading: At the end [rad]; None where that is not told.
    """

    legs: tuple[Leg, ...]
    end: Array
    heading: float | None

    @classmethod
    def of(cls, points: Array, headings: Array, plain: NDArray[np.bool_], bends: float = np.inf) -> Route:
        """The route through poses.

        Args:
            points: (k, 2) [m].
            headings: (k,) [rad], NaN where there is none.
            plain: (k,) which of them are the identity, which may mean that there is none.
            bends: Largest curvature that the base can have [1/m].
        """
        stays = hypot(*(points - points[-1]).T).max() <= FOLD
        headings = np.where(plain, np.nan, headings) if stays else believed(points, headings, plain)
        heading = None if np.isnan(headings[-1]) else float(headings[-1])
        if stays:
            return cls((), points[-1], heading)
        asked = headings.copy()
        asked[-1] = np.nan  # a goal's heading does not say how to go there
        ends = sorted({0, *tips(points), *turned_over(points, asked), len(points) - 1})
        parts = [slice(first, last + 1) for first, last in pairwise(ends)]
        legs = (leg_of(points[part], asked[part], bends) for part in parts)
        return cls(tuple(leg for leg in legs if leg.path.span > STRAIGHT), points[-1], heading)


def leg_of(points: Array, headings: Array, bends: float = np.inf) -> Leg:
    """The leg through points (k, 2) with headings (k,), NaN where there is none, of a largest curvature [1/m]."""
    backwards = is_reverse(points, headings)
    points = onward(points)
    dx, dy = points[-1] - points[0]
    way = float(atan2(dy, dx))
    along = np.sum(hypot(*np.diff(thinned(points, Smoothed.NEAR), axis=0).T))
    if len(corners(points, STRAIGHT)) == 2 or along <= Smoothed.SPACING:
        start = float(points[0, 0]), float(points[0, 1]), way + (np.pi if backwards else 0.0)
        return Leg(Arc(start, -1.0 if backwards else 1.0, 0.0, float(hypot(dx, dy))), backwards)
    smooth = Smoothed(points, bends=bends)
    if backwards:
        smooth = replace(smooth, looks=float(smooth.curve(np.zeros(1)).phi[0] + np.pi))
    return Leg(smooth, backwards)


def onward(points: Array) -> Array:
    """The points of (k, 2) that come further than all before, along a polygon through their corners."""
    kept = corners(points, FOLD)
    on = np.isin(np.arange(len(points)), kept)
    for first, last in pairwise(kept):
        along, _ = beside(points[first : last + 1], points[first], points[last])
        on[first + 1 : last] = (along[1:-1] > np.maximum.accumulate(along)[:-2]) & (along[1:-1] < along[-1])
    return points[on]


def believed(points: Array, headings: Array, plain: NDArray[np.bool_]) -> Array:
    """Headings (k,), those of identities only where they agree with the way through points (k, 2)."""
    before, after = ways(points, corners(points, FOLD))
    cosines = np.stack([before[plain, 0], after[plain, 0]])  # with the heading 0
    agrees = (abs(cosines).max(axis=0) > PARALLEL).all() and (cosines > PARALLEL).any()
    return headings if agrees else np.where(plain, np.nan, headings)


def is_reverse(points: Array, headings: Array) -> bool:
    """Whether headings (k,) look against the way through points (k, 2); those that are NaN are not asked."""
    known = ~np.isnan(headings)
    if not known.any():
        return False
    _, after = ways(points, corners(points, FOLD))
    c, s = cos_sin(headings[known])
    return float(np.mean(c * after[known, 0] + s * after[known, 1])) < AGAINST


def turned_over(points: Array, headings: Array) -> list[int]:
    """Which of points (k, 2) the way leaves against its heading where it came along it, or the other way round."""
    known = np.flatnonzero(~np.isnan(headings))
    _, after = ways(points, corners(points, FOLD))
    c, s = cos_sin(headings[known])
    sense = c * after[known, 0] + s * after[known, 1]
    return known[1:][(sense[1:] * sense[:-1] < 0.0) & (np.minimum(abs(sense[1:]), abs(sense[:-1])) > -AGAINST)].tolist()


def ways(points: Array, kept: IntArray) -> tuple[Array, Array]:
    """Directions (k, 2) before and after each of points (k, 2), along a polygon through some of them."""
    edges = np.diff(points[kept], axis=0)
    edges = edges / np.maximum(hypot(*edges.T), 1e-12)[:, None]
    i = np.arange(len(points))
    last = len(edges) - 1
    return (
        edges[np.clip(np.searchsorted(kept, i, side="left") - 1, 0, last)],
        edges[np.clip(np.searchsorted(kept, i, side="right") - 1, 0, last)],
    )


def tips(points: Array) -> list[int]:
    """Which of points (k, 2) the way turns back at: the outermost ones of sharp corners."""
    kept, found = corners(points, FOLD), list[int]()
    edges = np.diff(points[kept], axis=0)
    edges = edges / hypot(*edges.T)[:, None]
    for i in np.flatnonzero(np.sum(edges[:-1] * edges[1:], axis=1) < SHARP):
        first = max(kept[i], found[-1] if found else 0) + 1
        outwards = points[first : kept[i + 2]] @ (edges[i] - edges[i + 1])
        if len(outwards):
            found.append(int(first + np.argmax(outwards)))
    return found


def corners(points: Array, within: float) -> IntArray:
    """Which of points (k, 2) a polygon needs to pass all others within a distance, in their order.

    Douglas and Peucker (1973); a line on which the points go back by more than that is divided where they turn.
    """
    kept, parts = [0, len(points) - 1], [(0, len(points) - 1)]
    while parts:
        first, last = parts.pop()
        if last - first < 2:
            continue
        along, away = beside(points[first + 1 : last], points[first], points[last])
        furthest = np.maximum.accumulate(along)
        back, i = furthest - along, int(np.argmax(away))
        if back.max() > max(away[i], within):
            i = int(np.argmax(along == furthest[np.argmax(back)]))
        elif away[i] <= within:
            continue
        middle = first + 1 + i
        kept.append(middle)
        parts += [(first, middle), (middle, last)]
    return np.unique(kept)


def beside(points: Array, first: Array, last: Array) -> tuple[Array, Array]:
    """How far along the way from one point to another points (k, 2) are, and how far from the line between (k,) [m]."""
    line = last - first
    length = max(float(hypot(*line)), 1e-9)
    along = (points - first) @ line / length
    return along, hypot(*(points - first - np.clip(along, 0.0, length)[:, None] * line / length).T)
