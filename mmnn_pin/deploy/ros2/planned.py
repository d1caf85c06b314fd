"""Motions out of a planner's messages: what is asked of the arm over time, and a path of the base along its length.

A motion that breaks a rule of `joint_trajectory_controller`, the joints' ends or their speeds is refused with a line
and with the number that the action `FollowJointTrajectory` has for it.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from ...elementary import nearest_turn
from ...elementary.arrays import atan2
from ...errors import ConfigError, MmnnError, TrajectoryError
from ...model.robot import Robot
from ...reference.drive import RouteDrive
from ...reference.goal import LEDGE
from ...reference.guide import ARM, BASE, Guide, new_guide
from ...reference.limits import Limits
from ...reference.motion import require_within, slopes
from ...reference.route import Route
from ...reference.steerable import curvatures
from ...reference.wishes import Motion, Stand, Wish
from ...signals import Array, Setpoint
from .sensing import Planar, quaternion, seconds
from .settings import PlannedPath

OKAY, INVALID_GOAL, INVALID_JOINTS, OLD_STAMP, OFF_PATH, OFF_GOAL = 0, -1, -2, -3, -4, -5
MOST_POINTS, LONGEST = 10_000, 3600.0  # of a trajectory, [s]
AT_REST = 1e-3  # speed of the last point that counts as rest [rad/s or m/s]


Made = Motion | Stand


class Refused(MmnnError):
    """A motion that is not followed.

    Args:
        why: In one line.
        code: As `FollowJointTrajectory` numbers it.
    """

    def __init__(self, why: str, code: int = INVALID_GOAL) -> None:
        self.code = code
        super().__init__(why)


class RobotSituation(NamedTuple):
    """The reference and the measured state of a robot at one sample."""

    reference: Array  # (3, n) q, qdot, qddot of the arm's reference
    measured: Array  # (2, n) q, qdot
    base: Array  # (3 + twist,) pose and velocity of the base's reference
    pose: Array  # (3,) measured
    velocity: Array  # (twist,) measured
    moved_on: float  # by how much motions went on since the last sample, at the pace at which they are followed [s]

    def copy(self) -> RobotSituation:
        """As it is now."""
        reference, measured, base, pose, velocity = (np.array(part) for part in self[:5])
        return RobotSituation(reference, measured, base, pose, velocity, self.moved_on)


@dataclass(frozen=True)
class PlannedArm:
    """A robot's arm as its planner sees it: makes motions out of the planner's messages."""

    robot: Robot  # the robot
    names: tuple[str, ...]  # its joints as the planner calls them
    guide: Guide  # ends and limits of the joints
    period: float  # between two samples [s]

    @classmethod
    def of(cls, robot: Robot, names: dict[str, str], limits: Limits, period: float) -> PlannedArm:
        """Of a robot, with the names that the planner has for its joints."""
        called = tuple(names.get(name, name) for name in robot.joint_names)
        return cls(robot, called, new_guide(robot, limits), period)

    def motion(self, message: Any, now: ArrayLike, since: float = 0.0) -> Motion | Stand:
        """The motion that a message asks for; standing where it has no points.

        Args:
            message: Of the planner. Joints that it does not name stay where the reference is.
            now: (3, n) q, qdot, qddot of the reference.
            since: Time since the moment at which the message's time begins [s].

        Raises:
            Refused: It breaks a rule.
        """
        if not message.points:
            return Stand((ARM,))
        columns, at = self._columns(message), self._times(message)
        start = np.asarray(now, float)
        if at[-1] == 0.0:
            raise Refused("its last point is at time 0: give it the time that the way takes")
        if since >= at[-1]:
            raise Refused(f"it was over {since - at[-1]:.3g} s ago", OLD_STAMP)
        stop = start[0] + 0.5 * start[1] * np.abs(start[1]) / self.guide.arm[1]
        rest, parts = np.clip(stop, *self.guide.ends), list[Array]()
        for i, name in enumerate(("positions", "velocities", "accelerations")):
            given = [list(getattr(point, name)) for point in message.points]
            if i and not any(given):
                break
            parts.append(self._filled(given, name, columns, rest if i == 0 else np.zeros(len(self.names))))
        if len(parts) > 1 and np.abs(parts[1][-1]).max(initial=0.0) > AT_REST:
            raise Refused("its last point is not at rest")
        self._mend(parts[0], start[0])
        if at[0] > 0.0:
            at, first = np.append(0.0, at), (start[0], start[1], np.zeros(len(self.names)))
            parts = [np.vstack([first[i], part]) for i, part in enumerate(parts)]
            rates = slopes(at, parts[0], start[1])
            parts = [parts[0], rates] if len(parts) == 1 else parts
            parts[1][0] = rates[0]
        return self._within(self._made(at, parts), since, start[0])

    def _mend(self, q: Array, start: Array) -> None:
        """Points (k, n) by the nearest turn, from where the joints are on; what stays a little outside, at its end."""
        for i in np.flatnonzero(self.guide.turn).tolist():
            near = start[i]
            for k in range(len(q)):
                near = q[k, i] = nearest_turn(q[k, i], near)
        stays = (np.abs(q - start) < LEDGE).all(axis=0)
        q[:, stays] = np.clip(q[:, stays], *self.guide.ends[:, stays])

    def _columns(self, message: Any) -> Array:
        """Places of its joints in ours."""
        unknown = [name for name in message.joint_names if name not in self.names]
        if unknown or not message.joint_names or len(set(message.joint_names)) < len(message.joint_names):
            why = f"joints {', '.join(unknown)}" if unknown else "no joints, or one twice"
            raise Refused(f"{why}: there is {', '.join(self.names)}", INVALID_JOINTS)
        return np.array([self.names.index(name) for name in message.joint_names])

    def _times(self, message: Any) -> Array:
        at = np.array([seconds(point.time_from_start) for point in message.points])
        if len(at) > MOST_POINTS or at[-1] > LONGEST:
            raise Refused(f"{len(at):,} points in {at[-1]:g} s: at most {MOST_POINTS:,} in {LONGEST:g} s")
        if at[0] < 0.0 or (np.diff(at) <= 0.0).any():
            raise Refused("its times do not increase from 0 on")
        return at

    def _filled(self, given: list[list[float]], name: str, columns: Array, rest: Array) -> Array:
        """(k, n) values of all joints at the points; those that are not named rest."""
        if any(len(one) != len(columns) for one in given):
            raise Refused(f"{name} for {len(columns)} joints are missing at a point")
        values = np.tile(rest, (len(given), 1))
        values[:, columns] = given
        if not np.isfinite(values).all():
            raise Refused(f"{name} that are not finite")
        return values

    def _made(self, at: Array, parts: list[Array]) -> Motion:
        try:
            return Motion.through(at, parts[0], self.period, self.robot.dimensions, *parts[1:])
        except TrajectoryError as error:
            raise Refused(error.what) from error

    def _within(self, motion: Motion, elapsed: float, start: Array) -> Motion:
        """The rest of a motion whose joints keep to their ends and limits."""
        try:
            require_within(motion, self.guide, self.names, start)
        except ConfigError as error:
            raise Refused(f"{error.what}: {error.why} ({error.fix})") from error
        return rest_of(motion, elapsed)


class Planner:
    """Makes motions one after the other, beside the control loop."""

    def __init__(self) -> None:
        self.pool = ThreadPoolExecutor(1, "planner")
        self.open: list[tuple[Future[Made], Callable[[Made | Refused], Wish | None]]] = []

    def plan(self, make: Callable[[], Made], done: Callable[[Made | Refused], Wish | None]) -> None:
        """Make a motion; `done` is called in the control loop with it, or with why there is none."""
        self.open.append((self.pool.submit(make), done))

    def poll(self) -> list[Wish]:
        """The motions that are ready, as far as they are still wanted."""
        ready = [pair for pair in self.open if pair[0].done()]
        self.open = [pair for pair in self.open if pair not in ready]
        found = []
        for future, done in ready:
            error = future.exception()
            outcome = future.result() if error is None else error if isinstance(error, Refused) else Refused(str(error))
            if (wish := done(outcome)) is not None:
                found.append(wish)
        return found

    def close(self) -> None:
        """Plan nothing more."""
        self.pool.shutdown(wait=False, cancel_futures=True)


def rest_of(motion: Motion, elapsed: float, shift: Planar | None = None) -> Motion:
    """The rest of a motion after some time [s], its path moved in the plane."""
    k = min(round(elapsed / motion.period), len(motion.table) - 1)
    moved = motion.shift if shift is None else np.array(shift)
    return Motion(motion.table[k:], motion.period, motion.parts, motion.dimensions, shift=moved)


def caught_up(made: Motion, late: float) -> Motion:
    """A motion of the arm that was planned from a moving reference, as it is by now: some time [s] later."""
    moves = Setpoint.side_by_side(made.table[0], made.dimensions).qdot.any()
    return rest_of(made, late + made.period) if moves else made


def base_motion(
    message: Any,
    route: PlannedPath,
    limits: Limits,
    robot: Robot,
    period: float,
    start: tuple[ArrayLike, ArrayLike] | None = None,
) -> RouteDrive | Stand:
    """A path of the base to rest at its end, in the frame of the message; standing without poses.

    The points are smoothed, and driven as fast as speeds, accelerations and wheels allow: ahead, or in reverse where
    their headings say so, turning on the spot where the way turns back (`reference.route`). One pose is driven to.

    Args:
        message: Of the planner.
        route: Speeds and accelerations.
        limits: What the robot keeps to.
        robot: The robot.
        period: Between two samples [s].
        start: Pose (3,) and velocity (nb,) of the reference in the frame of the message; None for the path's own start,
            until the motion is taken over.

    Raises:
        Refused: Poses that are not finite, too many; no base to follow.
    """
    if not robot.dimensions.base:
        raise Refused("a path for a robot without a base")
    if not message.poses:
        return Stand((BASE,))
    if len(message.poses) > MOST_POINTS:
        raise Refused(f"{len(message.poses):,} poses: at most {MOST_POINTS:,}")
    points = np.array([(one.pose.position.x, one.pose.position.y) for one in message.poses], float)
    x, y, z, w = np.array([quaternion(one.pose.orientation) for one in message.poses], float).T
    if not ((np.abs(points) < 1e6).all() and np.isfinite([x, y, z, w]).all()):
        raise Refused("poses that are not finite")
    slower = msgspec.structs.replace(
        limits, speed=min(route.speed, limits.speed), acceleration=min(route.acceleration, limits.accelerations[0])
    )
    told = x * x + y * y + z * z + w * w > 1e-6
    headings = np.where(told, atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z), np.nan)
    try:
        least, most = curvatures(robot.base)
        asked = Route.of(points, headings, told & (abs(headings) < 1e-6), min(most, -least))
        drive = RouteDrive.along(asked, robot, slower, route.lateral, period)
        return drive if start is None else drive.placed(*start)
    except TrajectoryError as error:
        raise Refused(": ".join(part for part in (error.what, error.why, error.fix) if part)) from error
