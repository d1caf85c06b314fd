"""A drive of the base along a route, from wherever the reference is when it begins.

    standing aside      turn on the spot, drive to the route, turn along it, go on
    standing on it      turn on the spot along it where it looks elsewhere, and curve onto it
    moving along it     curve onto it with the present speed
    moving elsewhere    brake along the present arc, and begin from rest

Legs of a route follow each other from rest to rest, with turns on the spot between them and, where a heading is told,
at the end. A base that steers and cannot turn on the spot curves onto every leg within its curvature, or the route is
refused. All but the beginning is timed ahead, so that a control loop can take it over within a sample.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ..elementary import angles, atan2, hypot, nearest_turn
from ..elementary.arrays import cos_sin
from ..errors import TrajectoryError
from ..model.base.steered import SteeredBase
from ..model.robot import Robot
from ..signals import Array
from .guide import BASE
from .limits import Limits
from .motion import Motion
from .path import Curve
from .route import Arc, Leg, Route
from .steerable import curvatures
from .timed import Drivable, Timed, curve_along

SHARE = 0.98  # of the limits that are used at the points of a grid; between them it may be a little more
NEAR = 0.1  # how far aside of a route the base counts as standing on it [m]
REACHED = 0.01  # distance from a point that is not driven [m]
REST = 1e-3  # velocity that counts as none [m/s, rad/s]
ALIGNED, ALONG = 0.1, 0.5  # angle between heading and route that is curved away, standing and moving [rad]
ONWARD = 0.3  # least progress of a curve onto a route in the direction in which it begins, by its length
REACH = 0.3  # way on which the base curves onto a route, at least where there is room [m]
TIGHTEST = 3.0  # curvature of a present motion that is gone on with [1/m]
SLOWER = 0.9  # share of the present speed from which on a motion is gone on with
TINY = 1e-6  # [m, rad]
STEERED = 0.01  # share of the tightest curve by which the steering may be off where a leg begins
BENDS_APART = 0.02  # of the points at which a path's curvature is looked at [m]


@dataclass(frozen=True, eq=False)
class Joined:
    """The rest of a curve, from a pose beside it: a polynomial of degree six leads there, curvature has no corner."""

    onto: Drivable  # the curve
    at: float  # its parameter where it is reached [m]
    start: Array  # pose (3,)
    bend: float  # curvature of the way at the start, phi by its length [rad/m]
    backwards: bool  # whether it is driven in reverse

    @cached_property
    def _bridge(self) -> tuple[float, list[Any], float, float]:
        """Its length [m], it and its derivatives; speed of the rest there, and its turn of headings [rad]."""
        from scipy.interpolate import BPoly  # slow to import, seldom needed

        there = self._after(np.array([self.at]), 0.0, 1.0)
        g, turn = abs(float(there.g[0])), nearest_turn(float(there.phi[0]), self.start[2]) - float(there.phi[0])
        there = self._after(np.array([self.at]), turn, g)
        length = hypot(float(there.x[0]) - self.start[0], float(there.y[0]) - self.start[1])
        x, y, phi = self.start[:, None]
        here = Curve(x, y, phi, np.sign(there.g), 0.0, np.array([self.bend]), 0.0)
        bridge = BPoly.from_derivatives([0.0, length], [derivatives(here)[:3], derivatives(there)])
        return length, [bridge, *(bridge.derivative(i) for i in (1, 2, 3))], g, turn

    @property
    def length(self) -> float:
        """Its parameter where the curve is reached [m]."""
        return self._bridge[0]

    @property
    def forthcoming(self) -> float:
        """The least of how far the bridge goes in the direction in which it begins, by its parameter."""
        length, parts, _, _ = self._bridge
        rates = parts[1](np.linspace(0.0, length, 50))
        return float((rates @ rates[0]).min())

    def _after(self, s: Array, turn: float, g: float) -> Curve:
        """The curve at its parameters s (k,), turned by whole turns, its parameter stretched by g."""
        one = self.onto.curve(s)
        return Curve(one.x, one.y, one.phi + turn, one.g / g, one.dg / g**2, one.k / g, one.dk / g**2)

    @property
    def span(self) -> float:
        """Length of the bridge, and what is left of the curve at the speed that it has there."""
        length, _, g, _ = self._bridge
        return length + g * (self.onto.span - self.at)

    def curve(self, s: Array) -> Curve:
        """The geometry at s (k,)."""
        length, parts, g, turn = self._bridge
        on = s > length
        way = np.full(np.count_nonzero(~on), self.start[2] - (math.pi if self.backwards else 0.0))
        bridge = curve_along([part(s[~on]) for part in parts], way, self.backwards)
        rest = self._after(self.at + (s[on] - length) / g, turn, g)
        both = {name: np.empty_like(s) for name in vars(rest)}
        for name, values in both.items():
            values[~on], values[on] = getattr(bridge, name), getattr(rest, name)
        return Curve(**both)


def bent_too_far(path: Drivable, base: SteeredBase | None, end: float | None = None) -> float:
    """Largest curvature of a path, up to a parameter, that a base cannot steer [1/m]; 0 where it can."""
    least, most = curvatures(base)
    end = path.span if end is None else end
    curve = path.curve(np.linspace(0.0, end, max(50, math.ceil(abs(end) / BENDS_APART))))
    bends = curve.k / curve.g
    beyond = (bends > SHARE * most) | (bends < SHARE * least)
    return float(np.abs(bends[beyond]).max(initial=0.0))


def end_bend(path: Drivable, at: float | None = None) -> float:
    """Curvature `w / v` of a path at its end, or at a parameter [1/m]."""
    curve = path.curve(np.array([path.span if at is None else at]))
    return float(curve.k[0] / curve.g[0])


def faced(pose: Array, there: Array, away: float) -> Array:
    """A pose (3,) turned on the spot as one of a route is, unless it curves onto it from so far aside [m]."""
    heading = nearest_turn(there[2], pose[2])
    return pose if abs(heading - pose[2]) <= ALIGNED and away >= TINY else np.array([pose[0], pose[1], heading])


def derivatives(curve: Curve) -> Array:
    """Point and three derivatives (4, 2) by the parameter of a curve at one; its speed may bend."""
    g, dg, k, dk = (float(np.ravel(one)[0]) for one in (curve.g, curve.dg, curve.k, curve.dk))
    c, s = (float(one[0]) for one in cos_sin(curve.phi))
    along = np.array([(g, 0.0), (dg, g * k), (-g * k * k, 2 * dg * k + g * dk)])  # and across
    return np.vstack(([curve.x[0], curve.y[0]], along @ np.array([(c, s), (-s, c)])))


@dataclass(frozen=True, eq=False, kw_only=True)
class RouteDrive(Motion):
    """Motion of the base along a route; it begins anew from the reference's pose and velocity when taken over."""

    route: Route  # the route
    limits: Timed  # of speeds and accelerations, as those of any timed path
    blocks: list[Array]  # of every leg and turn from rest to rest poses, velocities and accelerations (N, 3 + 2 twist)
    begins: Array | None = None  # (3,) the pose that it begins from; None for the route's own start

    @classmethod
    def along(cls, route: Route, robot: Robot, limits: Limits, lateral: float, period: float) -> Self:
        """The drive along a route, from its own start.

        Args:
            route: The route.
            robot: The robot.
            limits: Speeds and accelerations.
            lateral: Largest sideways acceleration [m/s^2].
            period: Between two samples [s].
        """
        least = Timed.of(Arc((0.0, 0.0, 0.0), 1.0, 0.0, 1.0), robot, limits, lateral)
        names = "speed", "yaw_rate", "acceleration", "yaw_acceleration", "lateral"
        least = replace(least, **{name: SHARE * getattr(least, name) for name in names})
        drive = cls(np.zeros((0, 0)), period, (BASE,), robot.dimensions, route=route, limits=least, blocks=[])
        at = start = route.legs[0].pose(0.0) if route.legs else np.array([*route.end, route.heading or 0.0])
        blocks, bend = list[Array](), math.nan
        for leg in route.legs:
            if drive.steers:
                blocks.append(drive.driven(drive.led(leg, at, bend)))
                bend = end_bend(leg.path)
            else:
                blocks += [*drive.turned(at, leg.pose(0.0)[2]), drive.driven(leg.path)]
            at = blocks[-1][-1, :3]
        if route.legs and route.heading is not None:
            blocks += drive.turned(at, route.heading)
        return replace(drive, blocks=blocks, table=drive.chained(blocks, start))

    @property
    def steers(self) -> bool:
        """Whether it has a tightest curve, and so cannot turn on the spot."""
        return bool(np.isfinite(curvatures(self.limits.base)).any())

    def placed(self, pose: ArrayLike, velocity: ArrayLike | None = None) -> RouteDrive:
        """The drive from a pose (3,) and a velocity (twist,) of the reference, at rest without one.

        Raises:
            TrajectoryError: It cannot be steered onto the route.
        """
        v = np.zeros(self.dimensions.twist) if velocity is None else np.array(velocity, float)
        at, rests = np.array(pose, float), bool((abs(v) < REST).all())
        if rests and self.begins is not None and (abs(at - self.begins) < REST).all():
            return self
        block = None if rests else self.in_motion(at, v)
        if block is not None:
            blocks = [block, *self.blocks[1:]]
        else:
            blocks = [] if rests else [self.braked(at, v)]
            blocks += self.from_rest(blocks[0][-1, :3] if blocks else at)
        return replace(self, table=self.chained(blocks, at), begins=at)

    def in_motion(self, pose: Array, velocity: Array) -> Array | None:
        """The first leg from a pose (3,), gone on with at a velocity (twist,); None where it leads elsewhere."""
        v, w = float(velocity[0]), float(velocity[-1])
        if not self.route.legs or abs(v) < REST or abs(w) > TIGHTEST * abs(v) or (abs(velocity[1:-1]) > REST).any():
            return None
        leg = self.route.legs[0]
        s, away = leg.nearest(pose)
        off = abs(nearest_turn(leg.pose(s)[2] - pose[2], 0.0))
        curve = self.joined(leg, s, away, pose, w / abs(v), abs(v))
        if (v < 0.0) != leg.backwards or off > ALONG or curve is None:
            return None
        timed = replace(self.limits, path=curve, pace=abs(v))
        return self.rows(timed) if timed.fastest_entry >= SLOWER * abs(v) else None

    def braked(self, pose: Array, velocity: Array) -> Array:
        """To rest along the present arc, from a pose (3,) and a velocity (twist,)."""
        v, w, aside = velocity[0], velocity[-1], 0.0
        if velocity.size == 3:
            v, aside = hypot(velocity[0], velocity[1]), atan2(velocity[1], velocity[0])
        rate = hypot(v, w)
        along, about = self.limits.acceleration, self.limits.yaw_acceleration
        brakes = along / max(abs(v), TINY), about / max(abs(w), TINY)
        arc = Arc((pose[0], pose[1], pose[2] + aside), v / rate, w / rate, (1 + TINY) * rate / (2 * min(brakes)))
        free = {"speed": 2 * abs(v) + 1, "yaw_rate": 2 * abs(w) + 1, "lateral": 2 * abs(v * w) + 1, "wheels": ()}
        return self.rows(replace(self.limits, path=arc, pace=rate, **free), aside)

    def from_rest(self, pose: Array) -> list[Array]:
        """Blocks of samples that lead along the route from rest at a pose (3,)."""
        legs, blocks = self.route.legs, list[Array]()
        s, away = legs[0].nearest(pose) if legs else (0.0, 0.0)
        if not legs or (len(legs) == 1 and legs[0].path.span - s < REACHED):
            blocks = self.driven_to(pose, self.route.end, REACHED)
            at = blocks[-1][-1, :3] if blocks else pose
            return blocks + ([] if self.route.heading is None else self.turned(at, self.route.heading))
        leg = legs[0]
        if self.steers:
            return [self.driven(self.led(leg, pose)), *self.blocks[1:]]
        if away > NEAR or self.joined(leg, s, away, faced(pose, leg.pose(s), away), 0.0, 0.0) is None:
            s = leg.path.span if away <= NEAR and leg.path.span - s <= 4 * away else s
            blocks, away = self.driven_to(pose, leg.pose(s)[:2]), 0.0
            pose = blocks[-1][-1, :3] if blocks else pose
        at = faced(pose, leg.pose(s), away)
        blocks += self.turned(pose, at[2])
        if s == 0.0 and away < TINY:
            blocks.append(self.blocks[0])
        elif (curve := self.joined(leg, s, away, at, 0.0, 0.0)) is not None:
            blocks.append(self.driven(curve))
        return [*blocks, *self.blocks[1:]]

    def joined(self, leg: Leg, s: float, away: float, pose: Array, bend: float, speed: float) -> Joined | None:
        """The curve from a pose (3,) onto a leg that passes it at s; None where there is no room."""
        left = leg.path.span - s
        reach = min(max(REACH, 5 * away, speed), left)
        if self.steers:
            for further in (*np.arange(reach, left, 0.25 * REACH), left):
                curve = Joined(leg.path, s + further, pose, bend, leg.backwards)
                if curve.forthcoming > ONWARD and not bent_too_far(curve, self.limits.base, curve.length):
                    return curve
            return None
        while reach > max(4 * away, 2 * REST):
            curve = Joined(leg.path, s + reach, pose, bend, leg.backwards)
            if curve.forthcoming > ONWARD:
                return curve
            reach /= 2
        return None

    def led(self, leg: Leg, pose: Array, bend: float = math.nan) -> Drivable:
        """A leg from rest at a pose (3,), curved onto within what can be steered.

        Args:
            leg: The leg.
            pose: Where the base rests.
            bend: The curvature at which it steers [1/m]; NaN for that of the leg.

        Raises:
            TrajectoryError: There is no room, or the leg itself bends too far.
        """
        base, (s, away) = self.limits.base, leg.nearest(pose)
        off = nearest_turn(leg.pose(s)[2] - pose[2], 0.0)
        tightest = min(map(abs, curvatures(base)))
        can = f"it turns within {1.0 / tightest:.3g} m, not on the spot"
        if too_far := bent_too_far(leg.path, base):
            more = math.ceil(100.0 * (too_far / (SHARE * tightest) - 1.0)) + 1
            fix = f"raise the planner's smallest turning radius, by {more} %"
            raise TrajectoryError(f"the route bends by {too_far:.3g} 1/m", why=can, fix=fix)
        first = end_bend(leg.path, 0.0)
        bend = first if math.isnan(bend) else bend
        if s == 0.0 and away < TINY and abs(off) < TINY and abs(bend - first) < STEERED * tightest:
            return leg.path
        way = -bend if leg.backwards else bend
        curve = self.joined(leg, s, away, pose, way, 0.0) if abs(off) <= ALONG else None
        if curve is None:
            what = f"a route {away:.3g} m beside the base and turned by {abs(off):.3g} rad"
            fix = "plan from where it stands, along its heading or against it"
            if away < REACHED and abs(off) <= ALIGNED:
                what = f"a route that bends by {first:.3g} 1/m where the base steers {bend:.3g} 1/m"
                fix = "raise the planner's smallest turning radius"
            raise TrajectoryError(what, why=can, fix=fix)
        return curve

    def driven_to(self, pose: Array, point: Array, least: float = TINY) -> list[Array]:
        """A turn on the spot towards a point (2,), and the way to it of at least some length [m], from a pose (3,)."""
        dx, dy = float(point[0] - pose[0]), float(point[1] - pose[1])
        far, way = hypot(dx, dy), nearest_turn(atan2(dy, dx), pose[2])
        if far < least:
            return []
        return [*self.turned(pose, way), self.driven(Arc((pose[0], pose[1], way), 1.0, 0.0, far))]

    def turned(self, pose: Array, heading: float) -> list[Array]:
        """A turn on the spot from a pose (3,) to a heading [rad], the short way; nothing where it looks there."""
        turn = nearest_turn(heading - pose[2], 0.0)
        if abs(turn) < (ALIGNED if self.steers else TINY):
            return []
        if self.steers:
            what, fix = f"a turn by {abs(turn):.3g} rad on the spot", "plan ways that end along their headings"
            raise TrajectoryError(what, why="its steering has a tightest curve", fix=fix)
        return [self.driven(Arc((pose[0], pose[1], pose[2]), 0.0, math.copysign(1.0, turn), abs(turn)))]

    def driven(self, curve: Drivable) -> Array:
        """A curve from rest to rest, (N, 3 + 2 twist)."""
        return self.rows(replace(self.limits, path=curve))

    def instants(self, duration: float) -> Array:
        """Times at the period from 0 to the end or after it [s], (N,)."""
        return np.asarray(np.arange(math.ceil(duration / self.period - TINY) + 1) * self.period)

    def rows(self, timed: Timed, aside: float = 0.0) -> Array:
        """Samples (N, 3 + 2 twist) of a path; its way leads that much aside of the heading, where a base can [rad]."""
        one, k = timed.sample(self.instants(timed.duration)), 1.0
        if timed.pace == 0.0:  # between the points of its grid it may be pushed harder: as much slower, then
            most = np.array([timed.acceleration, timed.yaw_acceleration]) / SHARE
            k = math.sqrt(max(1.0, float((np.abs(one.acceleration) / most).max(initial=0.0))))
            one = one if k == 1.0 else timed.sample(self.instants(k * timed.duration) / k)
        one = replace(one, velocity=one.velocity / k, acceleration=one.acceleration / (k * k))
        if not self.dimensions.sideways:
            return np.hstack((one.pose, one.velocity, one.acceleration))
        c, s = angles.cos_sin(aside)
        (v, w), (vdot, wdot) = one.velocity.T, one.acceleration.T
        x, y, phi = one.pose.T
        return np.stack([x, y, phi - aside, c * v, s * v, w, c * vdot, s * vdot, wdot], axis=1)

    def chained(self, blocks: list[Array], at: Array) -> Array:
        """Setpoints of the robot: blocks one after the other, each from where the last rests.

        Args:
            blocks: Samples (N, 3 + 2 twist); where there are none, it stands.
            at: (3,) pose whose heading theirs go on from, by whole turns.
        """
        width = 3 + 2 * self.dimensions.twist
        ends = np.cumsum([0, *(len(block) - 1 for block in blocks)])
        table = np.zeros((ends[-1] + 1 if blocks else 2, width + 3 * self.dimensions.arm))
        table[:, :3], heading = at if not blocks else 0.0, float(at[2])
        for first, block in zip(ends[:-1], blocks, strict=True):
            part = table[first : first + len(block)]
            part[:, :width] = block
            part[:, 2] += nearest_turn(block[0, 2], heading) - block[0, 2]
            heading = float(part[-1, 2])
        return table
