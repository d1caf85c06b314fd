"""A lifecycle manager of real ROS 2 (rclpy) that moves a node through its states and changes its parameters.

python manager_node.py 0|1        the first half of what it does, or the second; tells as JSON
"""

import json
import os
import sys
import time

import rclpy
from geometry_msgs.msg import TwistStamped
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters

CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4


class Manager:
    """Clients of one node's services, and what the robot is told."""

    def __init__(self):
        self.node, self.fastest, self.last = rclpy.create_node("manager"), 0.0, 0.0
        self.node.create_subscription(TwistStamped, "/diff_drive_controller/cmd_vel", self.on_twist, 10)

    def on_twist(self, message):
        self.last = abs(message.twist.linear.x)
        self.fastest = max(self.fastest, self.last)

    def until(self, is_so):
        """Listen until the last speed is so, or for a long time."""
        limit = time.monotonic() + 120.0
        while not is_so(self.last) and time.monotonic() < limit:
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def call(self, kind, name, request):
        client = self.node.create_client(kind, f"/mmnn/{name}")
        assert client.wait_for_service(600.0), name
        future = client.call_async(request)
        rclpy.spin_until_future_complete(self.node, future, timeout_sec=900.0)
        return future.result()

    def state(self):
        return self.call(GetState, "get_state", GetState.Request()).current_state.label

    def go(self, transition):
        request = ChangeState.Request()
        request.transition.id = transition
        self.call(ChangeState, "change_state", request)
        return self.state()

    def set(self, name, **value):
        kind = {"double_value": 3, "bool_value": 1, "string_value": 4}[next(iter(value))]
        one = Parameter(name=name, value=ParameterValue(type=kind, **value))
        result = self.call(SetParameters, "set_parameters", SetParameters.Request(parameters=[one])).results[0]
        return [result.successful, result.reason]

    def listen(self, seconds):
        """The fastest that the base is told to go meanwhile."""
        limit, self.fastest = time.monotonic() + seconds, 0.0
        while time.monotonic() < limit:
            rclpy.spin_once(self.node, timeout_sec=0.05)
        return self.fastest


def first(manager):
    told = {"states": [manager.state(), manager.go(CONFIGURE), manager.go(ACTIVATE)]}
    request = DescribeParameters.Request(names=["limits.speed"])
    descriptor = manager.call(DescribeParameters, "describe_parameters", request).descriptors[0]
    (told["range"],) = [[one.from_value, one.to_value] for one in descriptor.floating_point_range]
    told["description"] = descriptor.description
    manager.until(lambda speed: speed > 0.15)
    told["speed"] = manager.set("limits.speed", double_value=0.1)
    manager.until(lambda speed: speed < 0.11)
    told["driven"] = manager.listen(1.0)
    told["gains"] = manager.set("set.feedback.arm", double_value=8.0)
    told["learning"] = manager.set("learning", bool_value=False)
    told["unstable"] = manager.set("set.feedback.arm", double_value=500.0)
    told["robot"] = manager.set("robot", string_value="two_axis_arm")
    told["wrong"] = manager.set("limits.speed", double_value=0.0)
    return told


def second(manager):
    told = {"after": [manager.go(DEACTIVATE)], "stands": manager.listen(1.0)}
    told["after"].append(manager.go(ACTIVATE))
    manager.last = 0.0
    manager.until(lambda speed: speed > 0.05)
    told["drives again"] = manager.last
    told["after"] += [manager.go(DEACTIVATE), manager.go(CLEANUP), manager.go(CONFIGURE)]
    return told


def main():
    rclpy.init()
    manager = Manager()
    print(json.dumps((first, second)[int(sys.argv[1])](manager)), flush=True)
    os._exit(0)  # rclpy's destructors are not what is tested


if __name__ == "__main__":
    main()
