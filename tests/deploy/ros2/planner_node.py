"""A planner of real ROS 2 (rclpy) that sends goals of the action FollowJointTrajectory, as MoveIt does; tells as JSON.

It needs the package control_msgs beside rclpy.
"""

import json
import math
import os
import sys
import time

import rclpy
from control_msgs.action import FollowJointTrajectory
from geometry_msgs.msg import Transform
from rclpy.action import ActionClient
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


class Planner:
    """Sends goals, and waits for what becomes of them."""

    def __init__(self):
        self.node = rclpy.create_node("planner")
        self.client = ActionClient(self.node, FollowJointTrajectory, "/mmnn/follow_joint_trajectory")
        self.feedback = []

    def wait(self, future, patience=15.0):
        rclpy.spin_until_future_complete(self.node, future, timeout_sec=patience)
        return future.result() if future.done() else None

    def send(self, goal):
        return self.wait(self.client.send_goal_async(goal, feedback_callback=self.feedback.append))

    def result(self, handle):
        found = self.wait(handle.get_result_async())
        return None if found is None else [found.status, found.result.error_code, found.result.error_string]


def main():
    rclpy.init()
    planner, told = Planner(), {}
    told["there"] = planner.client.wait_for_server(timeout_sec=240.0)
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
    told["whole"] = planner.result(planner.send(whole_goal((0.0, 0.0, 0.0), (0.0, 0.0, 0.5), (0.35, 0.19, 0.5))))
    last = planner.feedback[-1].feedback
    told["base"] = [last.multi_dof_joint_names, last.multi_dof_actual.transforms[0].translation.x]
    told["sideways"] = planner.result(planner.send(whole_goal((0.35, 0.19, 0.5), (0.35, 0.49, 0.5))))
    print(json.dumps(told), flush=True)
    os._exit(0)  # rclpy's destructors are not what is tested


if __name__ == "__main__":
    sys.exit(main())
