"""A node of real ROS 2 (rclpy) that sends back, field by field, whatever of five types it hears.

python echo_node.py reliable|best_effort
"""

import sys

import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry, Path
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

KINDS = (JointState, Odometry, TwistStamped, JointTrajectory, Path)


def main():
    rclpy.init()
    node = rclpy.create_node("echo")
    quality = QoSProfile(depth=200, reliability=ReliabilityPolicy[sys.argv[1].upper()])
    for kind in KINDS:
        back = node.create_publisher(kind, f"/back/{kind.__name__}", quality)

        def heard(message, back=back, kind=kind):
            back.publish(deserialize_message(serialize_message(message), kind))

        node.create_subscription(kind, f"/there/{kind.__name__}", heard, quality)
    print("ready", flush=True)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
