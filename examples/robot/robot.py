"""A robot that is not ours: MuJoCo in a process of its own, with ROS 2 topics and nothing of the controller's model.

Wheels with velocity servos on a floor with friction, an arm with effort motors, a payload of 1 kg that no URDF knows,
encoders with noise, odometry that is summed up from the wheels. It takes what `diff_drive_controller` and an effort
controller take, and tells what `joint_state_broadcaster` and `diff_drive_controller` tell.
"""

import argparse
import math
import signal
import time

import mujoco
import numpy as np
import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

STEP, TIMEOUT = 0.001, 0.5  # [s], [s] after which the base stops and the motors are off
RADIUS, TRACK = 0.075, 0.342  # that its odometry believes [m]
NOISE, RATE_NOISE = 2e-4, 2e-3  # of encoders [rad, rad/s]
MODEL = f"""
<mujoco>
  <option timestep="{STEP}" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <worldbody>
    <geom name="floor" type="plane" size="50 50 1" friction="0.9 0.01 0.001"/>
    <body name="base" pos="0 0 0.075">
      <freejoint/>
      <geom type="box" size="0.22 0.14 0.06" pos="0 0 0.02" mass="94" contype="0" conaffinity="0"/>
      <geom type="sphere" size="0.05" pos="0.29 0 -0.025" mass="0.5" friction="0.01 0 0" priority="1"/>
      <geom type="sphere" size="0.05" pos="-0.29 0 -0.025" mass="0.5" friction="0.01 0 0" priority="1"/>
      <body name="left" pos="0 0.171 0">
        <joint name="wheel_left_joint" axis="0 1 0" damping="0.05" armature="0.02"/>
        <geom type="cylinder" size="0.0752 0.02" euler="90 0 0" mass="5"/>
      </body>
      <body name="right" pos="0 -0.171 0">
        <joint name="wheel_right_joint" axis="0 1 0" damping="0.05" armature="0.02"/>
        <geom type="cylinder" size="0.0748 0.02" euler="90 0 0" mass="5"/>
      </body>
      <body name="arm_1" pos="0.12 0 0.26">
        <joint name="arm_1_joint" axis="0 0 1" damping="2.0" frictionloss="1.0"/>
        <geom type="box" size="0.2 0.03 0.03" pos="0.2 0 0.04" mass="4" contype="0" conaffinity="0"/>
        <body name="arm_2" pos="0.4 0 0.08">
          <joint name="arm_2_joint" axis="0 0 1" damping="1.0" frictionloss="0.5"/>
          <geom type="box" size="0.2 0.03 0.03" pos="0.2 0 0.04" mass="4" contype="0" conaffinity="0"/>
          <geom type="sphere" size="0.04" pos="0.4 0 0.04" mass="1.0" contype="0" conaffinity="0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <velocity joint="wheel_left_joint" kv="40" forcerange="-60 60"/>
    <velocity joint="wheel_right_joint" kv="40" forcerange="-60 60"/>
    <motor joint="arm_1_joint" forcerange="-200 200"/>
    <motor joint="arm_2_joint" forcerange="-200 200"/>
  </actuator>
</mujoco>
"""
NAMES = ["wheel_left_joint", "wheel_right_joint", "arm_1_joint", "arm_2_joint"]


class Robot:
    """The simulated machine and its drivers."""

    def __init__(self, node, seed):
        self.model = mujoco.MjModel.from_xml_string(MODEL)
        self.data, self.rng = mujoco.MjData(self.model), np.random.default_rng(seed)
        places = [self.model.joint(name) for name in NAMES]
        self.q, self.v = [int(p.qposadr[0]) for p in places], [int(p.dofadr[0]) for p in places]
        self.node, self.told, self.answers = node, math.inf, []
        self.pose, self.driven, self.worked, self.before = np.zeros(3), -math.inf, -math.inf, np.zeros(2)
        node.create_subscription(TwistStamped, "/diff_drive_controller/cmd_vel", self.on_twist, 1)
        node.create_subscription(Float64MultiArray, "/effort_controller/commands", self.on_effort, 1)
        self.states = node.create_publisher(JointState, "/joint_states", 1)
        self.odometry = node.create_publisher(Odometry, "/diff_drive_controller/odom", 1)

    def on_twist(self, message):
        """Set the wheels' rates."""
        v, w, self.driven = message.twist.linear.x, message.twist.angular.z, time.monotonic()
        self.data.ctrl[:2] = (v - w * TRACK / 2) / RADIUS, (v + w * TRACK / 2) / RADIUS

    def on_effort(self, message):
        """Set the arm's efforts."""
        self.data.ctrl[2:], self.worked = message.data, time.monotonic()
        self.answers.append(self.worked - self.told)

    def watch(self, now):
        """The base stops and the arm's motors are off when no commands come."""
        if now - self.driven > TIMEOUT:
            self.data.ctrl[:2] = 0.0
        if now - self.worked > TIMEOUT:
            self.data.ctrl[2:] = 0.0

    def tell(self):
        """Publish what the encoders say, and the wheels' odometry."""
        states, odometry = JointState(name=NAMES), Odometry(child_frame_id="base_footprint")
        states.header.stamp = odometry.header.stamp = self.node.get_clock().now().to_msg()
        states.header.frame_id = odometry.header.frame_id = "odom"
        q = self.data.qpos[self.q] + NOISE * self.rng.standard_normal(4)
        qdot = self.data.qvel[self.v] + RATE_NOISE * self.rng.standard_normal(4)
        turned, self.before = q[:2] - self.before, q[:2].copy()
        left, right = RADIUS * turned
        middle = self.pose[2] + (right - left) / TRACK / 2
        self.pose += (
            (left + right) / 2 * math.cos(middle),
            (left + right) / 2 * math.sin(middle),
            (right - left) / TRACK,
        )
        v, w = RADIUS * (qdot[0] + qdot[1]) / 2, RADIUS * (qdot[1] - qdot[0]) / TRACK
        states.position, states.velocity = q.tolist(), qdot.tolist()
        pose, twist, half = odometry.pose.pose, odometry.twist.twist, self.pose[2] / 2
        pose.position.x, pose.position.y = float(self.pose[0]), float(self.pose[1])
        pose.orientation.z, pose.orientation.w = math.sin(half), math.cos(half)
        twist.linear.x, twist.angular.z = float(v), float(w)
        self.told = time.monotonic()
        self.states.publish(states)
        self.odometry.publish(odometry)


def main():
    """Run until a signal comes, in real time."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--rate", type=float, default=200.0, help="messages per second (200)")
    options = options.parse_args()
    over = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: over.append(1))
    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node("robot")
    robot, start, k = Robot(node, options.seed), time.monotonic(), 0
    while not over:
        k += 1
        while (now := time.monotonic()) < start + k / options.rate:  # hears commands as they come
            rclpy.spin_once(node, timeout_sec=max(0.0, start + k / options.rate - now))
        robot.watch(now)
        while robot.data.time < now - start:
            mujoco.mj_step(robot.model, robot.data)
        robot.tell()
        k = max(k, int((time.monotonic() - start) * options.rate))
    if robot.answers:
        median, tail = 1e3 * np.percentile(robot.answers, (50, 99))
        print(f"robot: a command {median:.2f} ms after a measurement, 99 % within {tail:.2f} ms", flush=True)
    truth = robot.data.qpos[:2], robot.pose[:2]
    print(f"robot: true place {truth[0].round(3)}, by odometry {truth[1].round(3)}", flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
