"""Wishes of the graph as setpoints of the stepper: velocities, motions of the arm, paths of the base.

Motions are made in a thread of their own, so that a long one does not make a control sample late. A path in the frame
of a map is placed into the odometry's frame when it comes; when the map is corrected it is placed anew, and the stepper
takes it over without a jump.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Path
from rclpy.node import Node as RosNode
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ...reference.guide import ARM, BASE, Guide
from ...reference.wishes import BaseVelocity, Motion, Wish
from ...signals import Array
from .goals import Goals
from .inlets import Inlet
from .mapped import MappedRoute
from .outputs import duration_of
from .path_goals import PathGoals
from .planned import Made, PlannedArm, Planner, Refused, RobotSituation, base_motion, caught_up
from .sensing import Clock, Tree
from .settings import Heard, Node
from .trajectory_goals import TrajectoryGoals

if TYPE_CHECKING:
    from .action import Served


class Asking:
    """The topics with setpoints of one robot.

    Args:
        node: The node.
        arm: The robot's arm.
        settings: Topics and limits.
        tree: Frames.

    Attributes:
        base: (3 + twist,) pose and velocity of the base's reference.
        route: The path that the base follows.
        actions: What is served.
        share: Of their own speed at which motions are to be followed; None for as before.
    """

    def __init__(self, node: RosNode, arm: PlannedArm, settings: Node, tree: Tree) -> None:
        self.arm, self.settings, self.planner = arm, settings, Planner()
        self.route, self.base = MappedRoute(settings.tf, tree), np.zeros(0)
        self.later: tuple[Any, float] | None = None  # a motion of the arm, and when it begins by ROS 2
        self.share: float | None = settings.speed_scaling
        self.actions = list(actions_of(node, self))

        def listened(name: str, kind: type[Any], topic: Heard, latched: bool = False) -> Inlet:
            return Inlet(node, name, kind, reliable=True, publishers=topic.publishers, latched=latched)

        base, s = arm.robot.dimensions.base, settings
        velocity = TwistStamped if s.velocity.stamped else Twist
        self.velocity = listened("cmd_vel", velocity, s.velocity) if base else None
        self.path = listened("plan", Path, s.path) if base else None
        self.trajectory = listened("~/joint_trajectory", JointTrajectory, s.trajectory) if arm.names else None
        kind = scaling_type()
        self.scaling = None if kind is None else listened("~/speed_scaling_input", kind, Heard(), latched=True)
        every = (self.velocity, self.path, self.trajectory, self.scaling)
        self.inlets = [inlet for inlet in every if inlet is not None]

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
        found += self.route.placed_anew(now.moved_on)
        if self.velocity is not None and (message := self.velocity.newest()) is not None:
            found += self._base_velocity(self.velocity, message, clock)
        if self.trajectory is not None:
            self._arm_motion(self.trajectory, clock, now.reference)
        if self.path is not None and (message := self.path.newest()) is not None:
            self._base_path(self.path, message)
        if self.scaling is not None and (message := self.scaling.newest()) is not None:
            self._scale(self.scaling, message.factor)
        for action in self.actions:
            found += action.goals.poll(clock, now, stopped)
        return (*found, *self.planner.poll())

    def _scale(self, inlet: Inlet, factor: float) -> None:
        if 0.0 <= factor <= 1.0:
            self.share = float(factor)
        else:
            inlet.refuse(f"a factor of {factor:g}: plans are checked at their own speed: use 0 to 1")

    def _base_velocity(self, inlet: Inlet, message: Any, clock: Clock) -> list[Wish]:
        """A velocity of the base, in its control frame."""
        stamped, age = self.settings.velocity.stamped, self.settings.velocity.age
        twist = message.twist if stamped else message
        when = clock.measured(message.header.stamp, age) if stamped else clock.now
        given = (twist.linear.x, twist.linear.y, twist.angular.z)
        if isinstance(when, str) or not all(map(math.isfinite, given)):
            inlet.refuse(when if isinstance(when, str) else "a velocity that is not finite")
            return []
        self.give_way("a velocity of the base came", (BASE,))
        return [BaseVelocity(given if self.arm.robot.dimensions.sideways else (given[0], given[2]))]

    def _arm_motion(self, inlet: Inlet, clock: Clock, reference: Array) -> None:
        """A motion of the arm that came, or whose time has come: its stamp says when it begins."""
        message = inlet.newest()
        if message is None and self.later is not None and clock.by_ros >= self.later[1]:
            message, self.later = self.later[0], None
        if message is None:
            return
        now, asked, since = reference.copy(), clock.now, clock.since(message.header.stamp)
        if since < 0.0:
            self.later = message, clock.by_ros - since
            return

        def done(made: Made | Refused) -> Wish | None:
            if isinstance(made, Refused):
                inlet.refuse(str(made))
                return None
            self.give_way("another motion came", (ARM,))
            return caught_up(made, clock.now - asked) if isinstance(made, Motion) else made

        self.planner.plan(lambda: self.arm.motion(message, now, since), done)

    def _base_path(self, inlet: Inlet, message: Any) -> None:
        """Make a motion of a path, and begin it from the reference, placed by what `/tf` says, when it is ready."""

        def done(made: Made | Refused) -> Wish | None:
            try:
                if isinstance(made, Refused):
                    raise made
                found = self.route.placed(made, message.header.frame_id.lstrip("/"), self.base)
            except Refused as why:
                inlet.refuse(str(why))
                return None
            self.give_way("a path came", (BASE,))
            return self.route.follow(found)

        self.planner.plan(lambda: self.path_motion(message), done)

    def path_motion(self, message: Any) -> Made:
        """The motion of a path, in its frame; errors as of `base_motion`."""
        return base_motion(message, self.settings.path, self.settings.limits, self.arm.robot, self.arm.period)

    def give_way(self, why: str, parts: tuple[int, ...]) -> None:
        """Follow neither a path nor a goal of an action any more that moves one of these parts."""
        if BASE in parts:
            self.route.followed = None
        for action in self.actions:
            action.goals.give_way(why, parts)

    def change(self, guide: Guide) -> None:
        """Plan motions of the arm within other limits from now on."""
        self.arm = replace(self.arm, guide=guide)
        for action in self.actions:
            if isinstance(action.goals, TrajectoryGoals):
                action.goals.arm = self.arm

    def open(self) -> None:
        """Follow goals of the actions."""
        for action in self.actions:
            action.goals.closed = ""

    def close(self, why: str) -> None:
        """Follow nothing any more."""
        self.route.followed = self.later = None
        for action in self.actions:
            action.goals.close(why)


def actions_of(node: RosNode, asking: Asking) -> Iterator[Served]:
    """The servers of the actions; a warning for one whose messages are not there."""
    planner, s, way = asking.planner, asking.settings, asking.give_way

    def of_trajectories(told: Any) -> Goals:
        return TrajectoryGoals(planner, way, asking.arm, s.action, asking.route.place_of, told)

    def of_paths(told: Any) -> Goals:
        return PathGoals(planner, way, asking.route, asking.path_motion, s.path, s.action.rate, told)

    has_base = bool(asking.arm.robot.dimensions.base)
    for package, name, make in (("control", "trajectories", of_trajectories), ("nav2", "paths", of_paths)):
        try:
            from . import action

            if package == "control" or has_base:
                yield getattr(action, f"serve_{name}")(node, make)
        except ImportError:
            kind = "FollowJointTrajectory" if package == "control" else "FollowPath"
            where = f"apt install ros-$ROS_DISTRO-{package}-msgs; beside wheels see `mmnn docs how-to/ros2`"
            node.get_logger().warning(f"no action {kind} without the package {package}_msgs: {where}")


def scaling_type() -> Any:
    """The message `SpeedScalingFactor`; None where `control_msgs` is not there, or older."""
    try:
        from control_msgs.msg import SpeedScalingFactor
    except ImportError:
        return None
    return SpeedScalingFactor
