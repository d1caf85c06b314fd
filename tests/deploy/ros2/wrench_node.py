"""Who listens to the wrench of a robot's hand, in real ROS 2 (rclpy); tells as JSON what it heard in 60 s.

It ends a second after the last message.
"""

import json
import time

import rclpy
from geometry_msgs.msg import WrenchStamped


def main():
    rclpy.init()
    node, heard, last = rclpy.create_node("listener"), [], [0.0]

    def hear(message):
        force, moment, stamp = message.wrench.force, message.wrench.torque, message.header.stamp
        six = [force.x, force.y, force.z, moment.x, moment.y, moment.z]
        heard.append([message.header.frame_id, stamp.sec + 1e-9 * stamp.nanosec, *six])
        last[0] = time.monotonic()

    node.create_subscription(WrenchStamped, "/mmnn/external_wrench", hear, 100)
    end = time.monotonic() + 60.0
    while time.monotonic() < end and not (last[0] and time.monotonic() > last[0] + 1.0):
        rclpy.spin_once(node, timeout_sec=0.1)
    print(json.dumps(heard))
    rclpy.shutdown()


main()
