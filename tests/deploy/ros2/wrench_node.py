"""Who listens to the wrench of a robot's hand, in real ROS 2 (rclpy); tells as JSON the first 150 that it heard."""

import json
import time

import rclpy
from geometry_msgs.msg import WrenchStamped


def main():
    rclpy.init()
    node, heard = rclpy.create_node("listener"), []

    def hear(message):
        force, moment, stamp = message.wrench.force, message.wrench.torque, message.header.stamp
        six = [force.x, force.y, force.z, moment.x, moment.y, moment.z]
        heard.append([message.header.frame_id, stamp.sec + 1e-9 * stamp.nanosec, *six])

    node.create_subscription(WrenchStamped, "/mmnn/external_wrench", hear, 100)
    end = time.monotonic() + 250.0
    while time.monotonic() < end and len(heard) < 150:
        rclpy.spin_once(node, timeout_sec=0.1)
    print(json.dumps(heard))
    rclpy.shutdown()


main()
