"""What the graph asks of the robot, as setpoints of the stepper: velocities, motions of the arm, paths of the base.

Motions are made in a thread of their own, so that a long one does not make a control sample late. A path in the frame
of a map is placed into the odometry's frame when it comes; when the map is corrected it is placed anew, and the stepper
takes it over without a jump.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from ...reference.wishes import BaseVelocity, Motion, Stand, Wish
from ...signals import Array
from . import messages as msg
from .link import Inlet, Link
from .planned import Arm, Refused, base_motion, rest_of
from .sensing import STILL, Clock, Planar, Tree, composed, seconds, wrapped
from .settings import Node

Made = Motion | Stand


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


class Asking:
    """The topics with setpoints of one robot.

    Args:
        link: The graph.
        arm: The robot's arm.
        settings: Topics and limits.
        tree: Frames.
        planner: Makes motions.

    Attributes:
        route: The path that is followed, its frame, where that was placed, and since when [s]; None for none.
    """

    def __init__(self, link: Link, arm: Arm, settings: Node, tree: Tree, planner: Planner) -> None:
        self.arm, self.settings, self.tree, self.planner = arm, settings, tree, planner
        s = settings
        velocity = msg.TwistStamped if s.velocity is not None and s.velocity.stamped else msg.Twist
        kinds = ((s.velocity, velocity), (s.trajectory, msg.JointTrajectory), (s.path, msg.Path))
        made = [None if topic is None else Inlet(link, topic.topic, kind, topic) for topic, kind in kinds]
        self.velocity, self.trajectory, self.path = made
        self.inlets = [inlet for inlet in made if inlet is not None]
        self.route: tuple[Motion, str, Planar, float] | None = None

    def poll(self, clock: Clock, steady: float, reference: Array) -> tuple[Wish, ...]:
        """What is asked from now on.

        Args:
            clock: The node's.
            steady: The machine's steady time [s].
            reference: (3, n) q, qdot, qddot of the arm's reference.
        """
        found: list[Wish] = []
        if self.velocity is not None and (message := self.velocity.newest(steady)) is not None:
            found += self._base_velocity(self.velocity, message, clock)
        if self.trajectory is not None and (message := self.trajectory.newest(steady)) is not None:
            self._arm_motion(message, clock, reference)
        if self.path is not None and (message := self.path.newest(steady)) is not None:
            self._base_path(self.path, message, clock)
        found += self.planner.poll()
        found += self._placed_anew(clock.now)
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
        return [BaseVelocity(given if self.arm.robot.dimensions.base == 3 else (given[0], given[2]))]

    def _arm_motion(self, message: msg.JointTrajectory, clock: Clock, reference: Array) -> None:
        since, now = begun(message.header.stamp, clock), reference.copy()
        inlet = self.trajectory

        def done(made: Made | Refused) -> Wish | None:
            if isinstance(made, Refused):
                assert inlet is not None
                inlet.refuse(f"{made}")
                return None
            return made

        self.planner.plan(lambda: self.arm.motion(message, now, since), done)

    def _base_path(self, inlet: Inlet, message: msg.Path, clock: Clock) -> None:
        frame = message.header.frame_id.lstrip("/")
        arm, route, limits = self.arm, self.settings.path, self.settings.limits
        assert route is not None

        def done(made: Made | Refused) -> Wish | None:
            placed = self.place_of(frame)
            self.route = None
            if isinstance(made, Refused) or placed is None:
                why = (
                    str(made) if isinstance(made, Refused) else f"no way from '{frame}' to the odometry's frame by /tf"
                )
                inlet.refuse(why)
                return None
            if isinstance(made, Stand):
                return made
            self.route = made, frame, placed, clock.now
            return rest_of(made, 0.0, placed)

        self.planner.plan(lambda: base_motion(message, route, limits, arm.robot, arm.period), done)

    def place_of(self, frame: str) -> Planar | None:
        """Where a frame lies in the odometry's; None where that is not known."""
        odom = self.settings.tf.odom if self.settings.tf else "odom"
        if frame in ("", odom):
            return STILL
        found = self.tree.between(odom, frame)
        return None if found is None else found[0]

    def _placed_anew(self, now: float) -> list[Wish]:
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

    def close(self) -> None:
        """Plan nothing more."""
        self.planner.close()


def begun(stamp: msg.Time, clock: Clock) -> float:
    """Time since the moment that a motion's stamp says; 0 for none, which is now [s]."""
    return 0.0 if stamp.sec == 0 and stamp.nanosec == 0 else float(np.clip(clock.by_ros - seconds(stamp), -3600.0, 1e6))
