"""What the graph asks of the robot, as setpoints of the stepper: velocities, motions of the arm, paths of the base.

Motions are made in a thread of their own, so that a long one does not make a control sample late. A path in the frame
of a map is placed into the odometry's frame when it comes; when the map is corrected it is placed anew, and the stepper
takes it over without a jump.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...reference.drive import RouteDrive
from ...reference.wishes import BaseVelocity, Motion, Stand, Wish
from ...signals import Array
from . import messages as msg
from .action import ArmAction
from .link import Inlet, Link, decoded
from .planned import Arm, Made, Planner, Refused, base_motion, caught_up, rest_of
from .sensing import STILL, Clock, Planar, Tree, composed, inverse, wrapped
from .settings import Node


class Asking:
    """The topics with setpoints of one robot.

    Args:
        link: The graph.
        arm: The robot's arm.
        settings: Topics and limits.
        tree: Frames.

    Attributes:
        base: (3 + nb,) pose and velocity of the base's reference.
        route: The path that is followed, its frame, where that was placed, and since when [s]; None for none.
    """

    def __init__(self, link: Link, arm: Arm, settings: Node, tree: Tree) -> None:
        self.arm, self.settings, self.tree, self.planner = arm, settings, tree, Planner()
        asked = settings.action
        self.action = None if asked is None else ArmAction(link, arm, asked, self.planner)
        s = settings
        velocity = msg.TwistStamped if s.velocity is not None and s.velocity.stamped else msg.Twist
        kinds = ((s.velocity, velocity), (s.trajectory, msg.JointTrajectory), (s.path, msg.Path))
        made = [None if topic is None else Inlet(link, topic.topic, kind, topic) for topic, kind in kinds]
        self.velocity, self.trajectory, self.path = made
        self.inlets = [inlet for inlet in made if inlet is not None]
        self.base = np.zeros(0)
        self.route: tuple[Motion, str, Planar, float] | None = None

    def rehearse(self) -> None:
        """Make a motion of the arm and a path once: the first one takes longer, as libraries are loaded."""
        here = self.arm.robot.rest[self.arm.robot.arm_index]
        points = [msg.JointTrajectoryPoint(here.tolist(), [], [], [], msg.Duration(i)) for i in range(2)]
        if here.size:
            trajectory = msg.JointTrajectory(msg.Header(msg.Time()), list(self.arm.names), points)
            self.arm.motion(trajectory, np.stack([here, 0.0 * here, 0.0 * here]))
        d, route = self.arm.robot.dimensions, self.settings.path
        if route is not None and d.base:
            header, spots = msg.Header(msg.Time()), [msg.Point(), msg.Point(1.0), msg.Point(1.0, 1.0)]
            poses = [msg.PoseStamped(header, msg.Pose(spot, msg.Quaternion())) for spot in spots]
            start = np.array([0.0, 1.0, 0.0]), np.ones(d.base)
            base_motion(msg.Path(header, poses), route, self.settings.limits, self.arm.robot, self.arm.period, start)

    def poll(
        self, clock: Clock, steady: float, reference: Array, base: Array, measured: Array, stopped: bool
    ) -> tuple[Wish, ...]:
        """What is asked from now on.

        Args:
            clock: The node's.
            steady: The machine's steady time [s].
            reference: (3, n) q, qdot, qddot of the arm's reference.
            base: (3 + nb,) pose and velocity of the base's reference.
            measured: (2, n) q, qdot.
            stopped: Whether the supervisor has stopped the robot.
        """
        found: list[Wish] = []
        self.base = base.copy()
        if self.velocity is not None and (message := self.velocity.newest(steady)) is not None:
            found += self._base_velocity(self.velocity, message, clock)
        if self.trajectory is not None and (data := self.trajectory.newest(steady, raw=True)) is not None:
            self._arm_motion(self.trajectory, data, clock, reference)
        if self.path is not None and (data := self.path.newest(steady, raw=True)) is not None:
            self._base_path(self.path, data, clock)
        if self.action is not None:
            found += self.action.poll(clock, reference, measured, stopped)
        found += self.planner.poll()
        found += self.placed_anew(clock.now)
        return tuple(found)

    def _base_velocity(self, inlet: Inlet, message: Any, clock: Clock) -> list[Wish]:
        """A velocity of the base, in its control frame."""
        stamped = isinstance(message, msg.TwistStamped)
        twist = message.twist if stamped else message
        when = clock.measured(message.header.stamp, inlet.silence) if stamped else clock.now
        given = (twist.linear.x, twist.linear.y, twist.angular.z)
        if isinstance(when, str) or not all(map(math.isfinite, given)):
            inlet.refuse(when if isinstance(when, str) else "a velocity that is not finite")
            return []
        self.route = None
        return [BaseVelocity(given if self.arm.robot.dimensions.sideways else (given[0], given[2]))]

    def _arm_motion(self, inlet: Inlet, data: bytes, clock: Clock, reference: Array) -> None:
        now, asked = reference.copy(), clock.now

        def make() -> Made:
            message = decoded(data, msg.JointTrajectory)
            return self.arm.motion(message, now, clock.since(message.header.stamp))

        def done(made: Made | Refused) -> Wish | None:
            if isinstance(made, Refused):
                inlet.refuse(str(made))
                return None
            if self.action is not None:
                self.action.give_way("another motion came")
            return caught_up(made, clock.now - asked) if isinstance(made, Motion) else made

        self.planner.plan(make, done)

    def _base_path(self, inlet: Inlet, data: bytes, clock: Clock) -> None:
        """Make a motion of a path, and begin it from the reference, placed by what `/tf` says, when it is ready."""
        arm, route, limits, frame = self.arm, self.settings.path, self.settings.limits, [""]
        assert route is not None

        def make() -> Made:
            message = decoded(data, msg.Path)
            frame[0] = message.header.frame_id.lstrip("/")
            return base_motion(message, route, limits, arm.robot, arm.period)

        def done(made: Made | Refused) -> Wish | None:
            placed = self.place_of(frame[0])
            if isinstance(made, Refused) or placed is None:
                unknown = f"no way from '{frame[0]}' to the odometry's frame by /tf"
                inlet.refuse(str(made) if isinstance(made, Refused) else unknown)
                return None
            if isinstance(made, RouteDrive):
                made = made.placed(*seen_from(placed, self.base))
            self.route = None if isinstance(made, Stand) else (made, frame[0], placed, clock.now)
            return made if isinstance(made, Stand) else rest_of(made, 0.0, placed)

        self.planner.plan(make, done)

    def place_of(self, frame: str) -> Planar | None:
        """Where a frame lies in the odometry's; None where that is not known."""
        odom = self.settings.tf.odom if self.settings.tf else "odom"
        if frame in ("", odom):
            return STILL
        found = self.tree.between(odom, frame)
        return None if found is None else found[0]

    def placed_anew(self, now: float) -> list[Wish]:
        """The path where the map's correction has moved it to."""
        if self.route is None or self.settings.tf is None:
            return []
        motion, frame, placed, since = self.route
        there = self.place_of(frame)
        if there is None or now - since > (len(motion.table) - 1) * motion.period:
            return []
        k = round((now - since) / motion.period)
        before, after = (composed(place, tuple(motion.table[k, :3])) for place in (placed, there))
        moved = max(math.hypot(after[0] - before[0], after[1] - before[1]), abs(wrapped(there[2] - placed[2])))
        if moved < self.settings.tf.replace:
            return []
        self.route = motion, frame, there, since
        return [rest_of(motion, now - since, there)]

    def give_way(self, why: str) -> None:
        """Follow neither a path nor a goal of the action any more."""
        self.route = None
        if self.action is not None:
            self.action.give_way(why)

    def close(self) -> None:
        """Plan nothing more, and answer nothing."""
        self.planner.close()
        if self.action is not None:
            self.action.close()


def seen_from(place: Planar, base: Array) -> tuple[Planar, Array]:
    """Pose and velocity (nb,) of a base (3 + nb,) in a frame at a place."""
    x, y, phi = base[:3].tolist()
    return composed(inverse(place), (x, y, phi)), base[3:]
