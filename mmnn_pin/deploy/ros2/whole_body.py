"""Motions of base and arm together, out of a goal as MoveIt sends it.

The base is a joint of several degrees of freedom (`multi_dof_trajectory`, transforms), or three columns of the joint
trajectory, `NAME/x`, `NAME/y`, `NAME/theta`, as MoveIt names the variables of a planar joint. A base on wheels is led
from point to point along arcs that it can roll: what it drives and how it turns are cubics of time, its place follows
from both. Where a point lies aside of that, it cannot be rolled to, and the goal is refused with that point, or, where
that is asked for, the base drives the motion nearest to what was planned that rolls (`reference.rollable`).

Velocities and accelerations of points are those of x, y and theta in the frame of the message, as MoveIt writes them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...elementary import nearest_turn
from ...errors import ConfigError
from ...reference.guide import ARM, BASE
from ...reference.motion import instants, require_within, slopes
from ...reference.rollable import driven_from, nearest
from ...reference.wishes import Motion, Stand
from ...signals import Array, Setpoint
from .planned import AT_REST, INVALID_JOINTS, OLD_STAMP, PlannedArm, Refused, RobotSituation, rest_of
from .sensing import Planar, composed, planar, seconds

ASIDE = 0.02  # farthest from a point that the base rolls by [m]
SLIDES = 0.05  # largest velocity aside of a point on wheels [m/s]
AWAY, TURNED = 0.05, 0.1  # farthest from where the base is that a motion may begin [m], [rad]
GRID = 0.1  # between two samples to which the nearest motion that rolls is found [s]
PARTS = ("x", "y", "theta")


@dataclass(frozen=True)
class BasePoints:
    """Where the base is to be, and when."""

    name: str  # of the joint that it is to the planner
    times: Array  # (k,) from the start of the motion on [s]
    poses: Array  # (k, 3) in the frame of the message
    rates: Array | None = None  # (k, 3) of the pose; None where the points have none [m/s, rad/s]
    bends: Array | None = None  # (k, 3) rates of those likewise; only with rates

    def placed(self, place: Planar, heading: float) -> BasePoints:
        """Out of a frame at a place, headings by the nearest turn from one on."""
        poses = np.array([composed(place, (x, y, phi)) for x, y, phi in self.poses.tolist()])
        for k, phi in enumerate(poses[:, 2].tolist()):
            heading = poses[k, 2] = nearest_turn(phi, heading)
        turned = [None if part is None else part @ in_frame(place[2]).T for part in (self.rates, self.bends)]
        return BasePoints(self.name, self.times, poses, *turned)

    def from_here(self, base: Array) -> BasePoints:
        """Begun at time 0 where the base is, (3 + twist,).

        Raises:
            Refused: They begin elsewhere.
        """
        if self.times[0] == 0.0:
            away, turned = math.dist(self.poses[0, :2], base[:2]), abs(self.poses[0, 2] - base[2])
            if away > AWAY or turned > TURNED:
                raise Refused(f"it begins {away:.3g} m and {turned:.3g} rad from where the base is")
            return replace(self, poses=np.vstack([base[:3], self.poses[1:]]))
        rates = None if self.rates is None else np.vstack([rates_of(base), self.rates])
        bends = None if self.bends is None else np.vstack([np.zeros(3), self.bends])
        return BasePoints(self.name, np.append(0.0, self.times), np.vstack([base[:3], self.poses]), rates, bends)

    def spline(self, values: Array, first: Array, rates: Array | None, bends: Array | None) -> Any:
        """Values (k, m) over time: cubics, Hermite with rates, of degree five with bends too, as those of the arm."""
        from scipy.interpolate import BPoly, CubicHermiteSpline  # slow to import, seldom needed

        if rates is not None and bends is not None:
            return BPoly.from_derivatives(self.times, np.stack([values, rates, bends], axis=1))
        return CubicHermiteSpline(self.times, values, slopes(self.times, values, first) if rates is None else rates)


def in_frame(turn: float) -> Array:
    """(3, 3) what turns velocities in the plane by an angle."""
    c, s = math.cos(turn), math.sin(turn)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rates_of(base: Array) -> Array:
    """(3,) rates of the pose of a base (3 + twist,)."""
    v, aside, w = base[3], base[4] if base.size == 6 else 0.0, base[-1]
    return np.asarray(in_frame(base[2]) @ (v, aside, w))


def base_points(trajectory: Any, multi: Any = None) -> BasePoints | None:
    """The points of the base in a goal's two trajectories; None where there are none.

    Raises:
        Refused: More than one such joint, one of its columns missing, or poses that are none.
    """
    names = {name.rpartition("/")[0] for name in trajectory.joint_names if name.rpartition("/")[2] in PARTS}
    names = {name for name in names if name} | set(multi.joint_names if multi is not None else ())
    if not names:
        return None
    if len(names) > 1:
        raise Refused(f"{', '.join(sorted(names))}: there is one base", INVALID_JOINTS)
    (name,) = names
    if multi is not None and multi.joint_names:
        told = [planar(one.transforms[0].translation, one.transforms[0].rotation) for one in multi.points]
        if wrong := [pose for pose in told if isinstance(pose, str)]:
            raise Refused(f"{name}: {wrong[0]}")
        rows = (
            [[(t.linear.x, t.linear.y, t.angular.z) for t in getattr(one, kind)[:1]] for one in multi.points]
            for kind in ("velocities", "accelerations")
        )
        poses = np.array(told, float).reshape(-1, 3)
        return BasePoints(name, times_of(multi), poses, *(of_all([sum(row, ()) for row in part]) for part in rows))
    columns = [f"{name}/{part}" for part in PARTS]
    if missing := [column for column in columns if column not in trajectory.joint_names]:
        raise Refused(f"{', '.join(missing)} is missing", INVALID_JOINTS)
    at = [list(trajectory.joint_names).index(column) for column in columns]
    parts = [
        of_all([[row[i] for i in at] if (row := getattr(point, kind)) else [] for point in trajectory.points])
        for kind in ("positions", "velocities", "accelerations")
    ]
    return BasePoints(name, times_of(trajectory), np.zeros((0, 3)) if parts[0] is None else parts[0], *parts[1:])


def of_all(rows: Sequence[Sequence[float]]) -> Array | None:
    """Rows (k, 3) of all points; None where none has one.

    Raises:
        Refused: Some have, some have not.
    """
    if not any(rows):
        return None
    if not all(rows):
        raise Refused("velocities or accelerations of the base are missing at a point")
    return np.array(rows, float)


def joints_of(trajectory: Any, base: str) -> Any:
    """A joint trajectory without the columns of the base."""
    at = [i for i, name in enumerate(trajectory.joint_names) if name.rpartition("/")[0] != base or not base]
    names = ("positions", "velocities", "accelerations")
    points = [
        SimpleNamespace(
            time_from_start=point.time_from_start,
            **{name: [getattr(point, name)[i] for i in at] if getattr(point, name) else [] for name in names},
        )
        for point in trajectory.points
    ]
    return SimpleNamespace(joint_names=[trajectory.joint_names[i] for i in at], points=points)


def times_of(trajectory: Any) -> Array:
    """Times of the points of a trajectory, (k,) [s]."""
    return np.array([seconds(point.time_from_start) for point in trajectory.points])


def whole_motion(
    arm: PlannedArm,
    trajectory: Any,
    points: BasePoints,
    now: RobotSituation,
    place: Planar,
    since: float,
    smooth: float,
) -> Motion | Stand:
    """The motion of base and arm that a goal asks for.

    Args:
        arm: The robot.
        trajectory: Of the joints.
        points: Of the base.
        now: Reference and measurement.
        place: Where the frame of the points lies in the odometry's.
        since: As in `PlannedArm.motion` [s].
        smooth: How far a base on wheels may pass its points aside where it cannot roll to them; 0 refuses them [m].

    Raises:
        Refused: It breaks a rule, begins elsewhere, or the base cannot roll it.
    """
    d, times = arm.robot.dimensions, points.times
    if not d.base:
        raise Refused(f"{points.name}: this robot has no base", INVALID_JOINTS)
    if len(times) < 2 and not (len(times) and times[0] > 0.0):
        raise Refused("a motion of the base has two points, or one after the start")
    told = [part for part in (points.poses, points.rates, points.bends) if part is not None]
    if not (all(np.isfinite(part).all() for part in told) and times[0] >= 0.0 and (np.diff(times) > 0.0).all()):
        raise Refused("poses that are not finite, or times that do not increase from 0 on")
    if points.rates is not None and np.abs(points.rates[-1]).max() > AT_REST:
        raise Refused(f"{points.name}: its last point is not at rest")
    if since >= times[-1]:
        raise Refused(f"it was over {since - times[-1]:.3g} s ago", OLD_STAMP)
    points = points.placed(place, now.base[2]).from_here(now.base)
    if smooth > 0.0 and not d.sideways:
        table = smoothed(slid(points, now.base, arm), arm.period)
        require_passed(points, table, arm.period, smooth, "even when smoothed")
    else:
        table = slid(points, now.base, arm) if d.sideways else rolled(points, now.base, arm)
    joints = joints_of(trajectory, points.name)
    motion = arm.motion(joints, now.reference) if joints.joint_names and joints.points else None
    whole = together(arm, table, motion if isinstance(motion, Motion) else None, now.reference)
    try:
        require_within(whole, arm.guide, arm.names, now.reference[0])
    except ConfigError as error:
        raise Refused(f"{error.what}: {error.why} ({error.fix})") from error
    return rest_of(whole, since)


def rolled(points: BasePoints, base: Array, arm: PlannedArm) -> Array:
    """(N, 7) pose, velocity and acceleration of a base on wheels from point to point.

    Raises:
        Refused: A point that it cannot roll to.
    """
    step, turn = np.diff(points.poses[:, :2], axis=0), np.diff(points.poses[:, 2])
    middle = points.poses[:-1, 2] + 0.5 * turn
    chord = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)  # an arc's lies along its middle heading
    driven = np.append(0.0, np.cumsum(chord / np.sinc(turn / math.tau)))
    ways = np.stack([driven, points.poses[:, 2]], axis=1)
    spline = points.spline(ways, base[3:5], *(along(points, part) for part in (points.rates, points.bends)))
    t = instants(float(points.times[-1]), arm.period)
    way, velocity, acceleration = spline(t), spline(t, 1), spline(t, 2)
    on, heading = np.diff(way[:, 0]), 0.5 * (way[1:, 1] + way[:-1, 1])
    moved = np.stack([on * np.cos(heading), on * np.sin(heading)], axis=1)
    places = base[:2] + np.vstack([np.zeros(2), np.cumsum(moved, axis=0)])
    table = np.concatenate([places, way[:, 1:], velocity, acceleration], axis=1)
    require_passed(points, table, arm.period, ASIDE, "action.smooth lets it pass aside")
    return table


def smoothed(planned: Array, period: float) -> Array:
    """(N, 7) pose, velocity and acceleration of the motion nearest to one that slides, which wheels roll.

    Args:
        planned: (M, 9) pose, velocity and acceleration; it ends at rest.
        period: Between two samples [s].
    """
    every = max(round(GRID / period), 1)
    rows = np.append(np.arange(0, len(planned) - 1, every), len(planned) - 1)
    rests = rows[-1] + every * np.arange(1, 6)  # it comes to rest there, too
    time = np.append(rows, rests) * period
    found = nearest(time, planned[np.append(rows, np.full(5, rows[-1])), :3])
    t = np.arange(rests[-1] + 1) * period
    velocity = np.stack([np.interp(t, found.time, column) for column in found.velocity.T], axis=1)
    velocity[-1] = 0.0
    poses = driven_from(planned[0, :3], velocity, np.diff(t))
    return np.concatenate([poses, velocity, np.gradient(velocity, period, axis=0)], axis=1)


def along(points: BasePoints, rates: Array | None) -> Array | None:
    """(k, 2) rates along and about the headings of points on wheels.

    Raises:
        Refused: A velocity that slides.
    """
    if rates is None:
        return None
    cos, sin = np.cos(points.poses[:, 2]), np.sin(points.poses[:, 2])
    aside = np.abs(cos * rates[:, 1] - sin * rates[:, 0])
    if rates is points.rates and aside.max() > SLIDES:
        k = int(np.argmax(aside > SLIDES))
        why = (
            f"the base cannot roll through its point {k} at {points.times[k]:.3g} s: it slides {aside[k]:.3g} m/s aside"
        )
        raise Refused(f"{why}; velocities are those of x, y and theta in the frame of the message")
    return np.stack([cos * rates[:, 0] + sin * rates[:, 1], rates[:, 2]], axis=1)


def require_passed(points: BasePoints, table: Array, period: float, most: float, more: str) -> None:
    """Refuse points that a rolling base passes too far away.

    Args:
        points: What was asked for.
        table: (N, ...) where the base is.
        period: Between two rows [s].
        most: Distance that is near enough [m].
        more: What to say besides.

    Raises:
        Refused: With the first of them.
    """
    at = np.minimum(np.ceil(points.times / period - 1e-6).astype(int), len(table) - 1)
    away = np.hypot(*(table[at, :2] - points.poses[:, :2]).T)
    if away.max() > most:
        k = int(np.argmax(away > most))
        where = f"its point {k} at {points.times[k]:.3g} s: it passes {away[k]:.3g} m aside"
        raise Refused(f"the base cannot roll to {where} ({more})")


def slid(points: BasePoints, base: Array, arm: PlannedArm) -> Array:
    """(N, 9) pose, velocity and acceleration of a base that moves in every direction."""
    spline = points.spline(points.poses, rates_of(base), points.rates, points.bends)
    t = instants(float(points.times[-1]), arm.period)
    pose, rate = spline(t), spline(t, 1)
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    velocity = np.stack([cos * rate[:, 0] + sin * rate[:, 1], cos * rate[:, 1] - sin * rate[:, 0], rate[:, 2]], axis=1)
    return np.concatenate([pose, velocity, np.gradient(velocity, arm.period, axis=0)], axis=1)


def together(arm: PlannedArm, base: Array, motion: Motion | None, now: Array) -> Motion:
    """One motion of both parts, the shorter one waiting at its end.

    Args:
        arm: The robot.
        base: (N, 3 + 2 twist) pose, velocity and acceleration.
        motion: Of the arm; None where it is to stay.
        now: (3, n) of the arm's reference.
    """
    d = arm.robot.dimensions
    count = max(len(base), 0 if motion is None else len(motion.table))
    table = np.zeros((count, d.pose + 2 * d.twist + 3 * d.arm))
    table[: len(base), : base.shape[1]] = base
    table[len(base) :, :3] = base[-1, :3]
    setpoints = Setpoint.side_by_side(table, d)
    if motion is None:
        setpoints.q[:] = now[0]
        return Motion(table, arm.period, (BASE,), d)
    given = Setpoint.side_by_side(motion.table, d)
    n = len(motion.table)
    setpoints.q[:n], setpoints.qdot[:n], setpoints.qddot[:n] = given.q, given.qdot, given.qddot
    setpoints.q[n:] = given.q[-1]
    return replace(motion, table=table, parts=(BASE, ARM))
