"""A day of someone with a real ROS 2 (rclpy): teleoperation, goals of arm and base, a path, live parameters, e-stop.

It knows the robot from its topics, and tells as JSON what it was answered and where the robot was.
"""

import json
import math
import os
import time

import rclpy
from geometry_msgs.msg import Twist
from nav2_msgs.action import FollowPath
from nav_msgs.msg import Odometry
from planner_node import Planner, goal_of, path_goal, whole_goal
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

PATIENCE = 120.0  # with a busy machine [s]


class Session:
    """What is heard of the robot, and what is asked of the node."""

    def __init__(self):
        self.node, self.odometry, self.joints = rclpy.create_node("session"), None, None
        self.node.create_subscription(Odometry, "/odom", lambda message: setattr(self, "odometry", message), 1)
        self.node.create_subscription(JointState, "/joint_states", lambda message: setattr(self, "joints", message), 1)
        self.steer = self.node.create_publisher(Twist, "/cmd_vel", 1)
        self.planner = Planner(self.node)
        self.navigator = Planner(self.node, FollowPath, "/follow_path")

    @property
    def pose(self):
        """Where the base is."""
        there = self.odometry.pose.pose
        return there.position.x, there.position.y, 2.0 * math.atan2(there.orientation.z, there.orientation.w)

    @property
    def arm(self):
        """Positions of the arm's joints by their names."""
        pairs = zip(self.joints.name, self.joints.position, strict=True)
        return {name: q for name, q in pairs if "wheel" not in name}

    def until(self, is_so, meanwhile=lambda: None):
        """Listen until something is so; whether it is."""
        limit = time.monotonic() + PATIENCE
        while not (found := is_so()) and time.monotonic() < limit:
            meanwhile()
            rclpy.spin_once(self.node, timeout_sec=0.05)
        return bool(found)

    def ask(self, kind, name, request):
        """The answer of a service of the node."""
        client = self.node.create_client(kind, f"/mmnn/{name}")
        assert client.wait_for_service(PATIENCE), name
        return self.planner.wait(client.call_async(request), PATIENCE)

    def speed(self):
        """The base's, ahead."""
        return self.odometry.twist.twist.linear.x

    def teleoperate(self):
        """Drive until it is fast; the base stands when the joystick falls silent."""
        asked = Twist()
        asked.linear.x = 0.2
        fast = self.until(lambda: self.speed() > 0.15, lambda: self.steer.publish(asked))
        return fast and self.until(lambda: abs(self.speed()) < 0.005)

    def reach(self, change):
        """A goal of the arm, as `joint_trajectory_controller` takes it: result, and how far off the arm is."""
        begin, names = self.arm, list(self.arm)
        ends = [begin[name] + change for name in names]
        result = self.planner.result(self.planner.send(goal_of([begin[n] for n in names], ends, names=names, step=3.0)))
        return result, self.off(names, ends)

    def off(self, names, ends):
        rclpy.spin_once(self.node, timeout_sec=0.5)
        return max(abs(self.arm[name] - end) for name, end in zip(names, ends, strict=True))

    def whole(self):
        """A goal of base and arm, as MoveIt writes it: turn, then roll; result, and how far off the base is."""
        x, y, phi = self.pose
        there = x + 0.3 * math.cos(phi + 0.3), y + 0.3 * math.sin(phi + 0.3), phi + 0.3
        goal = whole_goal((x, y, phi), (x, y, phi + 0.3), there)
        goal.trajectory.joint_names = list(self.arm)
        for i, point in enumerate(goal.trajectory.points):
            point.positions = [q - 0.05 * i for q in self.arm.values()]
        return self.planner.result(self.planner.send(goal)), self.distance(*there)

    def path(self):
        """A path of Nav2's, 0.3 m ahead: result, and how far off the base is."""
        x, y, phi = self.pose
        points = [(x + d * math.cos(phi), y + d * math.sin(phi)) for d in (0.0, 0.1, 0.2, 0.3)]
        return self.navigator.result(self.navigator.send(path_goal(*points))), self.distance(*points[-1], phi)

    def distance(self, x, y, phi):
        rclpy.spin_once(self.node, timeout_sec=0.5)
        there = self.pose
        return [math.hypot(there[0] - x, there[1] - y), abs(math.remainder(there[2] - phi, math.tau))]

    def set(self, name, value):
        """Whether a live parameter is taken."""
        one = Parameter(name=name, value=ParameterValue(type=3, double_value=value))
        return self.ask(SetParameters, "set_parameters", SetParameters.Request(parameters=[one])).results[0].successful


def main():
    rclpy.init()
    session, told = Session(), {}
    assert session.planner.client.wait_for_server(timeout_sec=1200.0)
    while session.planner.result(session.planner.send(goal_of())) != [6, -1, "no points"]:  # it is not active yet
        time.sleep(0.2)
    assert session.until(lambda: session.odometry and session.joints)
    told["teleoperation"] = session.teleoperate()
    told["arm"], told["whole"], told["path"] = session.reach(0.1), session.whole(), session.path()
    told["parameters"] = [session.set("limits.speed", 0.1), session.set("limits.speed", 0.0)]
    told["stop"] = session.ask(Trigger, "stop", Trigger.Request()).success
    told["stopped"] = session.planner.result(
        session.planner.send(goal_of(list(session.arm.values()), names=session.arm))
    )
    told["reset"] = session.until(lambda: session.ask(Trigger, "reset", Trigger.Request()).success)
    told["again"] = session.reach(-0.1)
    print(json.dumps(told), flush=True)
    os._exit(0)  # rclpy's destructors are not what is tested


if __name__ == "__main__":
    main()
