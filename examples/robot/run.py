"""A base under a joystick while the arm follows a trajectory, over ROS 2, on a robot that MuJoCo is; PD and a learner.

    python examples/robot/run.py [--seconds 30] [--controllers pd two_layer]

It starts `robot.py` and `mmnn ros2 robot.yaml` as processes and plays joystick and planner itself: three nodes of one
ROS 2 graph. `ros2 topic list` shows them. It needs rclpy (`mmnn docs how-to/ros2`) and MuJoCo.
"""

import argparse
import math
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import Twist
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mmnn_pin.recording.recording import Recording

HERE = Path(__file__).parent
SETTLED = 5.0  # [s] after which errors count
NODE = "import sys; from mmnn_pin.cli import main; sys.exit(main(sys.argv[1:]))"


def arm_motion(seconds):
    """What a planner sends: points every quarter of a second, from rest to rest."""
    message = JointTrajectory(joint_names=["arm_1_joint", "arm_2_joint"])
    for t in np.arange(1.0, seconds, 0.25):
        share = math.sin(math.pi * min(t / seconds, 1.0)) ** 2  # from rest to rest
        q = share * 0.7 * math.sin(0.9 * t), share * 0.5 * math.sin(1.4 * t + 1.0)
        point = JointTrajectoryPoint(positions=list(q))
        point.time_from_start.sec, point.time_from_start.nanosec = int(t), int(1e9 * (t % 1))
        message.points.append(point)
    return message


def drive(controller, seconds, out):
    """One run; its recording, or None where the node failed."""
    robot = subprocess.Popen([sys.executable, str(HERE / "robot.py")])
    asked = ["--seconds", str(seconds), "--wait", "30", "--out", str(out), "--force"]
    changes = ["--ros-args", "-p", f"controller:={controller}"]
    command = [sys.executable, "-P", "-c", NODE, "ros2", str(HERE / "robot.yaml"), *asked, *changes]
    process, node = subprocess.Popen(command), rclpy.create_node("operator")
    joystick = node.create_publisher(Twist, "/cmd_vel", 1)
    planner = node.create_publisher(JointTrajectory, "/mmnn/joint_trajectory", 1)
    begun = []
    node.create_subscription(
        Float64MultiArray, "/effort_controller/commands", lambda _: begun or begun.append(time.monotonic()), 1
    )
    is_planned = False
    while process.poll() is None:
        rclpy.spin_once(node, timeout_sec=0.05)
        if not begun:
            continue
        if not is_planned:
            planner.publish(arm_motion(seconds - 3.0))
        is_planned, t, message = True, time.monotonic() - begun[0], Twist()
        message.linear.x, message.angular.z = 0.25 * math.sin(0.5 * t), 0.5 * math.sin(0.9 * t)
        joystick.publish(message)
    robot.terminate()
    robot.wait()
    node.destroy_node()
    return Recording.open(out) if process.returncode == 0 else None


def main():
    """Drive with every controller, and print the errors."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--seconds", type=float, default=30.0)
    options.add_argument("--controllers", nargs="+", default=["pd", "two_layer"])
    options.add_argument("--out", type=Path, default=Path("runs/robot"))
    options = options.parse_args()
    rclpy.init()
    rows, failed = [], False
    for controller in options.controllers:
        run = drive(controller, options.seconds, options.out / f"{controller}.h5")
        if run is None:
            failed = True
            continue
        counted = run["time"].ravel() > SETTLED
        rows.append((controller, 1e3 * np.sqrt((run["e"][counted] ** 2).mean(axis=0)), run["z"][counted]))
    print(f"\n{'':22}arm_1 [mrad]  arm_2 [mrad]  base v [mm/s]  base w [mrad/s]   RMS after {SETTLED:g} s")
    for controller, e, z in rows:
        v, w = 1e3 * np.sqrt((z**2).mean(axis=0))
        print(f"{controller:22}{e[0]:12.2f}{e[1]:14.2f}{v:15.1f}{w:17.1f}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
