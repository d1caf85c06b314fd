"""A planner of real ROS 2 (rclpy) that sends goals as MoveIt (FollowJointTrajectory) and Nav2 (FollowPath) do.

It needs the packages control_msgs and nav2_msgs beside rclpy, and tells as JSON what it was answered.
"""

import json
import math
import os
import sys
import time
from functools import partial

import rclpy
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTrajectoryControllerState, SpeedScalingFactor
from geometry_msgs.msg import PoseStamped, Transform
from nav2_msgs.action import FollowPath
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectoryPoint, MultiDOFJointTrajectoryPoint

NAMES = ("arm_2_joint", "arm_1_joint")


def goal_of(*points, names=NAMES, step=1.0):
    """A goal through points, `step` seconds apart from time 0."""
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = list(names)
    for i, q in enumerate(points):
        point = JointTrajectoryPoint(positions=[float(x) for x in q])
        point.time_from_start.sec = int(step * i)
        point.time_from_start.nanosec = int(1e9 * (step * i % 1))
        goal.trajectory.points.append(point)
    return goal


def whole_goal(*poses):
    """A goal of base and arm through poses of the base, 2 s apart, as MoveIt writes it."""
    goal = goal_of(*([0.3, 0.5 + 0.1 * i] for i in range(len(poses))), step=2.0)
    goal.multi_dof_trajectory.joint_names = ["world_joint"]
    for point, (x, y, phi) in zip(goal.trajectory.points, poses, strict=True):
        there = Transform()
        there.translation.x, there.translation.y = x, y
        there.rotation.z, there.rotation.w = math.sin(phi / 2), math.cos(phi / 2)
        several = MultiDOFJointTrajectoryPoint(transforms=[there], time_from_start=point.time_from_start)
        goal.multi_dof_trajectory.points.append(several)
    return goal


def path_goal(*points):
    """A path through places, without headings, as Nav2 sends it."""
    goal = FollowPath.Goal(controller_id="FollowPath", goal_checker_id="goal_checker")
    goal.path.header.frame_id = "odom"
    for x, y in points:
        pose = PoseStamped()
        pose.pose.position.x, pose.pose.position.y, pose.pose.orientation.w = x, y, 0.0
        goal.path.poses.append(pose)
    return goal


class Planner:
    """Sends goals of an action, and waits for what becomes of them."""

    def __init__(self, node, kind=FollowJointTrajectory, name="/mmnn/follow_joint_trajectory"):
        self.node, self.client, self.feedback = node, ActionClient(node, kind, name), []

    def wait(self, future, patience=300.0):
        rclpy.spin_until_future_complete(self.node, future, timeout_sec=patience)
        return future.result() if future.done() else None

    def send(self, goal):
        return self.wait(self.client.send_goal_async(goal, feedback_callback=self.feedback.append))

    def result(self, handle):
        found = self.wait(handle.get_result_async())
        if found is None:
            return None
        why = getattr(found.result, "error_string", getattr(found.result, "error_msg", ""))
        return [found.status, found.result.error_code, why]


def main():
    rclpy.init()
    node, told = rclpy.create_node("planner"), {}
    planner, navigator = Planner(node), Planner(node, FollowPath, "/follow_path")
    told["there"] = planner.client.wait_for_server(timeout_sec=1200.0)
    heard = {}
    for kind, topic in ((JointTrajectoryControllerState, "/mmnn/controller_state"), (Odometry, "/mmnn/odom")):
        node.create_subscription(kind, topic, partial(heard.__setitem__, kind), 10)
    node.create_subscription(TFMessage, "/tf", partial(heard.__setitem__, TFMessage), 10)
    node.create_subscription(Odometry, "/odom", partial(heard.__setitem__, "robot's"), 10)
    while planner.result(planner.send(goal_of())) != [6, -1, "no points"]:  # it is not active yet
        time.sleep(0.2)
    goal = goal_of((0.0, 0.0), (0.1, 0.1), names=("arm_2_joint", "elbow"))
    told["unknown joint"] = planner.result(planner.send(goal))
    told["too fast"] = planner.result(planner.send(goal_of((0.0, 0.0), (3.0, 0.0), step=0.02)))
    long = goal_of(*((0.2 + 1e-4 * i, 0.3) for i in range(6000)), (0.8, 0.3), step=0.05)
    handle = planner.send(long)  # more than one packet: fragments
    told["long"] = bool(handle and handle.accepted)
    handle = planner.send(goal_of((-0.3, 0.2), (0.0, 0.4), (0.2, 0.5)))  # takes its place
    told["accepted"] = handle.accepted
    told["reached"] = planner.result(handle)
    told["feedback"] = len(planner.feedback)
    last = planner.feedback[-1].feedback if planner.feedback else None
    told["names"] = list(last.joint_names) if last else []
    told["error"] = max(abs(e) for e in last.error.positions) if last else None
    handle = planner.send(goal_of((0.2, 0.5), (1.0, 1.0), step=4.0))
    time.sleep(0.5)
    told["cancel"] = len(planner.wait(handle.cancel_goal_async()).goals_canceling)
    told["cancelled"] = planner.result(handle)
    quality = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    scaling = node.create_publisher(SpeedScalingFactor, "/mmnn/speed_scaling_input", quality)
    scaling.publish(SpeedScalingFactor(factor=0.5))
    handle = planner.send(goal_of((0.2, 0.5), (0.3, 0.4)))
    told["scaled"] = [time.monotonic(), planner.result(handle), time.monotonic()]
    scaling.publish(SpeedScalingFactor(factor=1.0))
    told["whole"] = planner.result(planner.send(whole_goal((0.0, 0.0, 0.0), (0.0, 0.0, 0.5), (0.35, 0.19, 0.5))))
    last = planner.feedback[-1].feedback
    told["base"] = [last.multi_dof_joint_names, last.multi_dof_actual.transforms[0].translation.x]
    told["sideways"] = planner.result(planner.send(whole_goal((0.35, 0.19, 0.5), (0.35, 0.49, 0.5))))
    told["path"] = navigator.result(navigator.send(path_goal((0.35, 0.19), (0.35, 0.34), (0.35, 0.49))))
    far = [one.feedback.distance_to_goal for one in navigator.feedback]
    told["distances"] = [max(far, default=0.0), min(far, default=1.0)]
    told["no path"] = navigator.result(navigator.send(path_goal()))
    state, odom, robots = (heard[name] for name in (JointTrajectoryControllerState, Odometry, "robot's"))
    told["state"] = [list(state.joint_names), list(state.multi_dof_joint_names), len(state.output.effort)]
    told["state's error"] = [abs(a - b) for a, b in zip(state.feedback.positions, (0.7, 0.3), strict=True)]
    places = odom.pose.pose.position, robots.pose.pose.position, heard[TFMessage].transforms[0].transform.translation
    told["places"] = [[place.x, place.y] for place in places]
    told["frames"] = [odom.header.frame_id, odom.child_frame_id, heard[TFMessage].transforms[0].child_frame_id]
    print(json.dumps(told), flush=True)
    os._exit(0)  # rclpy's destructors are not what is tested


if __name__ == "__main__":
    sys.exit(main())
