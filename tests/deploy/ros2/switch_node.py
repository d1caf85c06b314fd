"""Someone at a real ROS 2 (rclpy) who resets a robot after a trip, and stops it; tells as JSON what was answered."""

import json
import os
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from std_srvs.srv import Trigger

ERROR = b"\x02"


def main():
    rclpy.init()
    node, level, told = rclpy.create_node("switch"), [b"\0"], {}
    node.create_subscription(DiagnosticArray, "/diagnostics", lambda m: level.__setitem__(0, m.status[0].level), 10)
    reset, stop = (node.create_client(Trigger, f"/mmnn/{name}") for name in ("reset", "stop"))
    told["there"] = reset.wait_for_service(240.0) and stop.wait_for_service(240.0)

    def ask(client):
        """The answer; asked once more where none comes, as both sides may not have met yet."""
        for _ in range(2):
            future = client.call_async(Trigger.Request())
            rclpy.spin_until_future_complete(node, future, timeout_sec=5.0)
            if (found := future.result() if future.done() else None) is not None:
                return [found.success, found.message]
        return [False, ""]

    def wait(tripped):
        limit = time.monotonic() + 20.0
        while (level[0] == ERROR) != tripped and time.monotonic() < limit:
            rclpy.spin_once(node, timeout_sec=0.1)
        return (level[0] == ERROR) == tripped

    while level[0] != ERROR and "nothing to reset" not in told.get("early", [0, ""])[1]:  # until it is driven
        rclpy.spin_once(node, timeout_sec=0.1)
        told["early"] = ask(reset)
        time.sleep(0.2)
    told["tripped"] = wait(True)
    told["blind"] = ask(reset)
    limit, answer = time.monotonic() + 20.0, told["blind"]
    while not answer[0] and time.monotonic() < limit:
        time.sleep(0.1)
        answer = ask(reset)
    told["reset"], told["runs"] = answer, wait(False)
    time.sleep(1.0)
    told["stop"], told["stopped"] = ask(stop), wait(True)
    time.sleep(1.0)
    told["again"], told["runs again"] = ask(reset), wait(False)
    time.sleep(1.5)
    print(json.dumps(told), flush=True)
    os._exit(0)  # rclpy's destructors are not what is tested


if __name__ == "__main__":
    sys.exit(main())
