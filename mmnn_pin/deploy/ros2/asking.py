"""Wishes of the graph as setpoints of the stepper: velocities, motions of the arm, paths of the base.

Motions are made in a thread of their own, so that a long one does not make a control sample late. A path in the frame
of a map is placed into the odometry's frame when it comes; when the map is corrected it is placed anew, and the stepper
takes it over without a jump.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Path
from rclpy.node import Node as RosNode
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ...reference.guide import ARM, BASE
from ...reference.wishes import BaseVelocity, Motion, Wish
from ...signals import Array
from .inlets import Inlet
from .mapped import MappedRoute
from .outputs import duration_of
from .planned import Made, PlannedArm, Planner, Refused, RobotSituation, base_motion, caught_up
from .sensing import Clock, Tree
from .settings import Heard, Node

if TYPE_CHECKING:
    from .action import GoalAction


class Asking:
    """The topics with setpoints of one robot.

    Args:
        node: The node.
        arm: The robot's arm.
        settings: Topics and limits.
        tree: Frames.

    Attributes:
        base: (3 + nb,) pose and velocity of the base's reference.
        route: The path that the base follows.
    """

    def __init__(self, node: RosNode, arm: PlannedArm, settings: Node, tree: Tree) -> None:
        self.arm, self.settings, self.planner = arm, settings, Planner()
        self.route = MappedRoute(settings.tf, tree)
        self.action = action_of(node, arm, settings, self.planner, self.route)

        def listened(name: str, kind: type[Any], topic: Heard) -> Inlet:
            return Inlet(node, name, kind, reliable=True, publishers=topic.publishers)

        base, s = arm.robot.dimensions.base, settings
        velocity = TwistStamped if s.velocity.stamped else Twist
        self.velocity = listened("cmd_vel", velocity, s.velocity) if base else None
        self.path = listened("plan", Path, s.path) if base else None
        self.trajectory = listened("~/joint_trajectory", JointTrajectory, s.trajectory) if arm.names else None
        self.inlets = [inlet for inlet in (self.velocity, self.path, self.trajectory) if inlet is not None]
        self.base = np.zeros(0)

    def rehearse(self) -> None:
        """Make a motion of the arm and a path once: the first one takes longer, as libraries are loaded."""
        here = self.arm.robot.rest[self.arm.robot.arm_index]
        points = [JointTrajectoryPoint(positions=here.tolist(), time_from_start=duration_of(i)) for i in range(2)]
        if here.size:
            trajectory = JointTrajectory(joint_names=list(self.arm.names), points=points)
            self.arm.motion(trajectory, np.stack([here, 0.0 * here, 0.0 * here]))
        if self.arm.robot.dimensions.base:
            path, steers = Path(poses=[PoseStamped() for _ in range(3)]), self.arm.robot.steers
            path.poses[1].pose.position.x = path.poses[2].pose.position.x = path.poses[2].pose.position.y = 1.0
            start = np.array([0.0, 1.0, 0.0]), np.ones(self.arm.robot.dimensions.twist)
            if steers:  # straight ahead, as any base can
                path.poses[2].pose.position.x, path.poses[2].pose.position.y = 2.0, 0.0
                start[0][1], start[1][-1] = 0.0, 0.0
            s = self.settings
            base_motion(path, s.path, s.limits, self.arm.robot, self.arm.period, start)

    def poll(self, clock: Clock, now: RobotSituation, stopped: bool) -> tuple[Wish, ...]:
        """The wishes that hold from now on.

        Args:
            clock: The node's.
            now: Reference and measurement.
            stopped: Whether the supervisor has stopped the robot.
        """
        found: list[Wish] = []
        self.base = now.base.copy()
        if self.velocity is not None and (message := self.velocity.newest()) is not None:
            found += self._base_velocity(self.velocity, message, clock)
        if self.trajectory is not None and (message := self.trajectory.newest()) is not None:
            self._arm_motion(self.trajectory, message, clock, now.reference)
        if self.path is not None and (message := self.path.newest()) is not None:
            self._base_path(self.path, message, clock)
        if self.action is not None:
            found += self.action.poll(clock, now, stopped)
        found += self.planner.poll()
        found += self.route.placed_anew(clock.now)
        return tuple(found)

    def _base_velocity(self, inlet: Inlet, message: Any, clock: Clock) -> list[Wish]:
        """A velocity of the base, in its control frame."""
        stamped, age = self.settings.velocity.stamped, self.settings.velocity.age
        twist = message.twist if stamped else message
        when = clock.measured(message.header.stamp, age) if stamped else clock.now
        given = (twist.linear.x, twist.linear.y, twist.angular.z)
        if isinstance(when, str) or not all(map(math.isfinite, given)):
            inlet.refuse(when if isinstance(when, str) else "a velocity that is not finite")
            return []
        self.give_way("a velocity of the base came", BASE)
        return [BaseVelocity(given if self.arm.robot.dimensions.sideways else (given[0], given[2]))]

    def _arm_motion(self, inlet: Inlet, message: Any, clock: Clock, reference: Array) -> None:
        now, asked = reference.copy(), clock.now

        def make() -> Made:
            return self.arm.motion(message, now, clock.since(message.header.stamp))

        def done(made: Made | Refused) -> Wish | None:
            if isinstance(made, Refused):
                inlet.refuse(str(made))
                return None
            if self.action is not None:
                self.action.give_way("another motion came", ARM)
            return caught_up(made, clock.now - asked) if isinstance(made, Motion) else made

        self.planner.plan(make, done)

    def _base_path(self, inlet: Inlet, message: Any, clock: Clock) -> None:
        """Make a motion of a path, and begin it from the reference, placed by what `/tf` says, when it is ready."""
        arm, route, limits = self.arm, self.settings.path, self.settings.limits
        frame = message.header.frame_id.lstrip("/")

        def make() -> Made:
            return base_motion(message, route, limits, arm.robot, arm.period)

        def done(made: Made | Refused) -> Wish | None:
            wish = str(made) if isinstance(made, Refused) else self.route.begin(made, frame, self.base, clock.now)
            if isinstance(wish, str):
                inlet.refuse(wish)
                return None
            if self.action is not None:
                self.action.give_way("a path came", BASE)
            return wish

        self.planner.plan(make, done)

    def give_way(self, why: str, part: int | None = None) -> None:
        """Follow neither a path nor a goal of the action any more, of a part or of all."""
        self.route.followed = None
        if self.action is not None:
            self.action.give_way(why, part)

    def open(self) -> None:
        """Follow goals of the action."""
        if self.action is not None:
            self.action.closed = ""

    def close(self, why: str) -> None:
        """Follow nothing any more."""
        self.route.followed = None
        if self.action is not None:
            self.action.close(why)


def action_of(
    node: RosNode, arm: PlannedArm, settings: Node, planner: Planner, route: MappedRoute
) -> GoalAction | None:
    """The server of the action; None, with a warning, where its messages are not there."""
    try:
        from .action import GoalAction
    except ImportError:
        where = "apt install ros-$ROS_DISTRO-control-msgs; beside wheels see `mmnn docs how-to/ros2`"
        node.get_logger().warning(f"no action FollowJointTrajectory without the package control_msgs: {where}")
        return None
    return GoalAction(node, arm, settings.action, planner, route.place_of)
