"""Motions of base and arm together, out of a goal as MoveIt sends it.

The base is a joint of several degrees of freedom (`multi_dof_trajectory`, transforms), or three columns of the joint
trajectory, `NAME/x`, `NAME/y`, `NAME/theta`, as MoveIt names the variables of a planar joint. A base on wheels is led
from point to point along arcs that it can roll: what it drives and how it turns are cubics of time, its place follows
from both. Where a point lies aside of that, it cannot be rolled to, and the goal is refused with that point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...elementary import nearest_turn
from ...errors import ConfigError
from ...reference.guide import ARM, BASE
from ...reference.motion import instants, require_within, slopes
from ...reference.wishes import Motion, Stand
from ...signals import Array, Setpoint
from .planned import INVALID_JOINTS, OLD_STAMP, PlannedArm, Refused, rest_of
from .sensing import Planar, composed, planar, seconds

ASIDE = 0.02  # farthest from a point that the base rolls by [m]
AWAY, TURNED = 0.05, 0.1  # farthest from where the base is that a motion may begin [m], [rad]
PARTS = ("x", "y", "theta")


@dataclass(frozen=True)
class BasePoints:
    """Where the base is to be, and when.

    Attributes:
        name: Of the joint that it is to the planner.
        times: (k,) from the start of the motion on [s].
        poses: (k, 3) in the frame of the message.
    """

    name: str
    times: Array
    poses: Array


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
        return BasePoints(name, times_of(multi), np.array(told, float).reshape(-1, 3))
    columns = [f"{name}/{part}" for part in PARTS]
    if missing := [column for column in columns if column not in trajectory.joint_names]:
        raise Refused(f"{', '.join(missing)} is missing", INVALID_JOINTS)
    at = [list(trajectory.joint_names).index(column) for column in columns]
    poses = np.array([[point.positions[i] for i in at] for point in trajectory.points], float).reshape(-1, 3)
    return BasePoints(name, times_of(trajectory), poses)


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
    arm: PlannedArm, trajectory: Any, points: BasePoints, now: Array, base: Array, place: Planar, since: float
) -> Motion | Stand:
    """The motion of base and arm that a goal asks for.

    Args:
        arm: The robot.
        trajectory: Of the joints.
        points: Of the base.
        now: (3, n) q, qdot, qddot of the arm's reference.
        base: (3 + twist,) pose and velocity of the base's reference.
        place: Where the frame of the points lies in the odometry's.
        since: As in `PlannedArm.motion` [s].

    Raises:
        Refused: It breaks a rule, begins elsewhere, or the base cannot roll it.
    """
    d = arm.robot.dimensions
    if not d.base:
        raise Refused(f"{points.name}: this robot has no base", INVALID_JOINTS)
    times, poses = points.times - min(since, 0.0), points.poses.copy()
    if len(times) < 2 and not (len(times) and times[0] > 0.0):
        raise Refused("a motion of the base has two points, or one after the start")
    if not (np.isfinite(poses).all() and times[0] >= 0.0 and (np.diff(times) > 0.0).all()):
        raise Refused("poses that are not finite, or times that do not increase from 0 on")
    if since >= points.times[-1]:
        raise Refused(f"it was over {since - points.times[-1]:.3g} s ago", OLD_STAMP)
    poses = placed(poses, place, base[2])
    times, poses = from_here(times, poses, base)
    table = slid(times, poses, base, arm) if d.sideways else rolled(times, poses, base, arm)
    joints = joints_of(trajectory, points.name)
    motion = arm.motion(joints, now, min(since, 0.0)) if joints.joint_names and joints.points else None
    whole = together(arm, table, motion if isinstance(motion, Motion) else None, now)
    try:
        require_within(whole, arm.guide, arm.names, now[0])
    except ConfigError as error:
        raise Refused(f"{error.what}: {error.why} ({error.fix})") from error
    return rest_of(whole, max(since, 0.0))


def placed(poses: Array, place: Planar, heading: float) -> Array:
    """Poses (k, 3) out of a frame at a place, their headings by the nearest turn from one on."""
    found = np.array([composed(place, (x, y, phi)) for x, y, phi in poses.tolist()])
    for k, phi in enumerate(found[:, 2].tolist()):
        heading = found[k, 2] = nearest_turn(phi, heading)
    return found


def from_here(times: Array, poses: Array, base: Array) -> tuple[Array, Array]:
    """Times and poses that begin at time 0 where the base is.

    Raises:
        Refused: They begin elsewhere.
    """
    if times[0] > 0.0:
        return np.append(0.0, times), np.vstack([base[:3], poses])
    away, turned = math.dist(poses[0, :2], base[:2]), abs(poses[0, 2] - base[2])
    if away > AWAY or turned > TURNED:
        raise Refused(f"it begins {away:.3g} m and {turned:.3g} rad from where the base is")
    return times, np.vstack([base[:3], poses[1:]])


def rolled(times: Array, poses: Array, base: Array, arm: PlannedArm) -> Array:
    """(N, 7) pose, velocity and acceleration of a base on wheels from point to point.

    Raises:
        Refused: A point that it cannot roll to.
    """
    from scipy.interpolate import CubicHermiteSpline  # slow to import, seldom needed

    step, turn = np.diff(poses[:, :2], axis=0), np.diff(poses[:, 2])
    middle = poses[:-1, 2] + 0.5 * turn
    chord = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)  # an arc's lies along its middle heading
    driven = np.append(0.0, np.cumsum(chord / np.sinc(turn / math.tau)))
    ways = np.stack([driven, poses[:, 2]], axis=1)
    spline = CubicHermiteSpline(times, ways, slopes(times, ways, base[3:5]))
    t = instants(float(times[-1]), arm.period)
    way, velocity, acceleration = spline(t), spline(t, 1), spline(t, 2)
    along, heading = np.diff(way[:, 0]), 0.5 * (way[1:, 1] + way[:-1, 1])
    moved = np.stack([along * np.cos(heading), along * np.sin(heading)], axis=1)
    places = base[:2] + np.vstack([np.zeros(2), np.cumsum(moved, axis=0)])
    require_passed(times, poses, t, places)
    return np.concatenate([places, way[:, 1:], velocity, acceleration], axis=1)


def require_passed(times: Array, poses: Array, t: Array, places: Array) -> None:
    """Refuse points that a rolling base passes too far away.

    Raises:
        Refused: With the farthest.
    """
    at = np.clip(np.searchsorted(t, times - 1e-9), 0, len(t) - 1)
    away = np.hypot(*(places[at] - poses[:, :2]).T)
    if away.max() > ASIDE:
        k = int(np.argmax(away > ASIDE))
        raise Refused(f"the base cannot roll to its point {k} at {times[k]:.3g} s: it passes {away[k]:.3g} m aside")


def slid(times: Array, poses: Array, base: Array, arm: PlannedArm) -> Array:
    """(N, 9) pose, velocity and acceleration of a base that moves in every direction."""
    from scipy.interpolate import CubicHermiteSpline  # slow to import, seldom needed

    c, s = math.cos(base[2]), math.sin(base[2])
    first = np.array([c * base[3] - s * base[4], s * base[3] + c * base[4], base[5]])
    spline = CubicHermiteSpline(times, poses, slopes(times, poses, first))
    t = instants(float(times[-1]), arm.period)
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
