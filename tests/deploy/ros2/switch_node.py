"""Someone at a real ROS 2 (rclpy) who resets a robot after a trip, and stops it; tells as JSON what was answered."""

import json
import math
import os
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

ERROR = b"\x02"


def main():
    rclpy.init()
    node, level, speed, told = rclpy.create_node("switch"), [b"\0"], [0.0], {}
    node.create_subscription(Odometry, "/odom", lambda m: speed.__setitem__(0, m.twist.twist.linear.x), 1)
    node.create_subscription(DiagnosticArray, "/diagnostics", lambda m: level.__setitem__(0, m.status[0].level), 10)
    speak = node.create_publisher(Empty, "/speak", 1)
    reset, stop = (node.create_client(Trigger, f"/mmnn/{name}") for name in ("reset", "stop"))
    told["there"] = reset.wait_for_service(1200.0) and stop.wait_for_service(1200.0)

    def ask(client):
        """The answer; asked once more where none comes, as both sides may not have met yet."""
        for _ in range(2):
            future = client.call_async(Trigger.Request())
            rclpy.spin_until_future_complete(node, future, timeout_sec=5.0)
            if (found := future.result() if future.done() else None) is not None:
                return [found.success, found.message]
        return [False, ""]

    def drives(is_so, meanwhile=lambda: None):
        """Wait until the robot drives, or stands, by what it tells from now on."""
        limit, speed[0] = time.monotonic() + 120.0, math.nan
        while not (speed[0] > 0.16 if is_so else abs(speed[0]) < 0.03) and time.monotonic() < limit:
            meanwhile()
            rclpy.spin_once(node, timeout_sec=0.1)

    def wait(tripped):
        limit = time.monotonic() + 120.0
        while (level[0] == ERROR) != tripped and time.monotonic() < limit:
            rclpy.spin_once(node, timeout_sec=0.1)
        return (level[0] == ERROR) == tripped

    while level[0] != ERROR and "nothing to reset" not in told.get("early", [0, ""])[1]:  # until it is driven
        rclpy.spin_once(node, timeout_sec=0.1)
        told["early"] = ask(reset)
        time.sleep(0.2)
    told["tripped"] = wait(True)
    told["blind"] = answer = ask(reset)
    if not answer[0]:  # it is silent
        drives(False, lambda: speak.publish(Empty()))
    limit = time.monotonic() + 120.0
    while not answer[0] and time.monotonic() < limit:
        time.sleep(0.1)
        answer = ask(reset)
    told["reset"], told["runs"] = answer, wait(False)
    drives(True)
    told["stop"], told["stopped"] = ask(stop), wait(True)
    drives(False)
    told["again"], told["runs again"] = ask(reset), wait(False)
    drives(True)
    print(json.dumps(told), flush=True)
    os._exit(0)  # rclpy's destructors are not what is tested


if __name__ == "__main__":
    sys.exit(main())
