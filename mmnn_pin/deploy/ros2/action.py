"""Servers of the actions `control_msgs/FollowJointTrajectory` and `nav2_msgs/FollowPath`, which `goals` answers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import Transform, Twist
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node as RosNode
from trajectory_msgs.msg import JointTrajectoryPoint

from ...signals import Array
from .goals import Goal, Goals
from .outputs import stamp_of
from .planned import RobotSituation
from .whole_body import rates_of

FEEDBACK = ("desired", "actual", "error")
KEEP = 300  # time that a result is kept [s]


@dataclass
class Served:
    """An action that is served."""

    name: str  # of the action, as the graph has it
    type: str  # of the action
    goals: Goals  # its goals
    server: ActionServer  # of rclpy

    @classmethod
    def of(cls, node: RosNode, name: str, kind: Any, goals: Goals, result: Callable[[Goal], Any]) -> Served:
        """Serve an action.

        Args:
            node: The node.
            name: Of the action.
            kind: Its type.
            goals: Its goals.
            result: Makes the result's message of a goal that is over.
        """

        def accepted(handle: ServerGoalHandle) -> None:  # after the answer: one at a time, or goals change places
            goals.accept(handle)
            handle.execute()

        server = ActionServer(
            node, kind, name, lambda handle: result(goals.answer(handle)), result_timeout=KEEP,
            callback_group=MutuallyExclusiveCallbackGroup(), handle_accepted_callback=accepted,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip
        package = kind.__module__.partition(".")[0]
        return cls(node.resolve_service_name(name), f"{package}/action/{kind.__name__}", goals, server)


def serve_trajectories(node: RosNode, make: Callable[..., Goals]) -> Served:
    """Serve `FollowJointTrajectory`; `make` makes its goals by how feedback is told.

    Raises:
        ImportError: Its messages are not there.
    """
    from control_msgs.action import FollowJointTrajectory as Kind

    def result(goal: Goal) -> Any:
        return Kind.Result(error_code=goal.code, error_string=goal.why)

    return Served.of(node, "~/follow_joint_trajectory", Kind, make(partial(situation, Kind.Feedback)), result)


def serve_paths(node: RosNode, make: Callable[..., Goals]) -> Served:
    """Serve `FollowPath`; `make` makes its goals by how feedback is told.

    Raises:
        ImportError: Its messages are not there.
    """
    from nav2_msgs.action import FollowPath as Kind

    def result(goal: Goal) -> Any:
        made = Kind.Result(error_code=goal.code)
        if hasattr(made, "error_msg"):  # from Kilted on
            made.error_msg = goal.why
        return made

    def told(distance: float, speed: float) -> Any:
        return Kind.Feedback(distance_to_goal=distance, speed=speed)

    return Served.of(node, "follow_path", Kind, make(told), result)


def situation(
    kind: Any, names: Sequence[str], base: str, now: RobotSituation, time: float, fields: Sequence[str] = FEEDBACK
) -> Any:
    """Wanted and measured state and the error, as `joint_trajectory_controller` tells them.

    Args:
        kind: The message's type.
        names: Of the joints.
        base: Of the base; empty where it does not move.
        now: Reference and measurement.
        time: By ROS 2 [s].
        fields: Of the message, for what is wanted, what is measured, and the error.
    """
    states = zip(fields, (now.reference, now.measured, now.reference[:2] - now.measured), strict=True)
    told = kind(joint_names=list(names), **{name: joint_point(values) for name, values in states})
    told.header.stamp = stamp_of(time)
    if base:
        told.multi_dof_joint_names = [base]
        wanted, there = now.base[:3], now.pose
        rates = rates_of(now.base), rates_of(np.append(there, now.velocity))
        poses = wanted, there, wanted - there
        points = (getattr(told, f"multi_dof_{name}") for name in fields)
        for point, pose, rate in zip(points, poses, (*rates, rates[0] - rates[1]), strict=True):
            point.transforms, point.velocities = [transform(pose)], [twist(rate)]
    return told


def joint_point(values: Array) -> JointTrajectoryPoint:
    """Rows of positions, velocities, accelerations (up to 3, n) as a message."""
    names = ("positions", "velocities", "accelerations")
    return JointTrajectoryPoint(**dict(zip(names, values.tolist(), strict=False)))


def transform(pose: Array) -> Transform:
    """A pose (3,) in the plane as a message."""
    made = Transform()
    made.translation.x, made.translation.y = pose[:2].tolist()
    made.rotation.z, made.rotation.w = math.sin(pose[2] / 2), math.cos(pose[2] / 2)
    return made


def twist(velocity: Array) -> Twist:
    """A velocity (3,) in the plane as a message."""
    made = Twist()
    made.linear.x, made.linear.y, made.angular.z = velocity.tolist()
    return made
