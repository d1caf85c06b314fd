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

from mmnn_pin.deploy.ros2 import messages as msg
from mmnn_pin.deploy.ros2.link import Inlet, Link, Outlet
from mmnn_pin.deploy.ros2.settings import Network, Topic

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
NAMES = ("wheel_left_joint", "wheel_right_joint", "arm_1_joint", "arm_2_joint")


class Robot:
    """The simulated machine and its drivers."""

    def __init__(self, link, seed):
        self.model = mujoco.MjModel.from_xml_string(MODEL)
        self.data, self.rng = mujoco.MjData(self.model), np.random.default_rng(seed)
        places = [self.model.joint(name) for name in NAMES]
        self.q, self.v = [int(p.qposadr[0]) for p in places], [int(p.dofadr[0]) for p in places]
        self.told, self.answers = math.inf, []
        self.pose, self.driven, self.worked, self.before = np.zeros(3), -math.inf, -math.inf, np.zeros(2)
        self.twist = Inlet(link, "/diff_drive_controller/cmd_vel", msg.TwistStamped, Topic("/cmd_vel", "reliable"))
        self.effort = Inlet(link, "/effort_controller/commands", msg.Float64MultiArray, Topic("/commands", "reliable"))
        self.states = Outlet(link, "/joint_states", msg.JointState, Topic("/joint_states", "reliable"))
        self.odometry = Outlet(link, "/odom", msg.Odometry, Topic("/odom", "reliable"))

    def listen(self, now):
        """Take commands; the base stops and the arm's motors are off when none come."""
        if (message := self.twist.newest(now)) is not None:
            v, w, self.driven = message.twist.linear.x, message.twist.angular.z, now
            self.data.ctrl[:2] = (v - w * TRACK / 2) / RADIUS, (v + w * TRACK / 2) / RADIUS
        if (message := self.effort.newest(now)) is not None:
            self.data.ctrl[2:], self.worked = message.data, now
            self.answers.append(now - self.told)
        if now - self.driven > TIMEOUT:
            self.data.ctrl[:2] = 0.0
        if now - self.worked > TIMEOUT:
            self.data.ctrl[2:] = 0.0

    def tell(self):
        """Publish what the encoders say, and the wheels' odometry."""
        seconds, rest = divmod(time.time(), 1.0)
        header = msg.Header(msg.Time(int(seconds), int(1e9 * rest)), "odom")
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
        self.states.send(msg.JointState(header, list(NAMES), q.tolist(), qdot.tolist(), []))
        half = self.pose[2] / 2
        turn = msg.Quaternion(0.0, 0.0, math.sin(half), math.cos(half))
        pose = msg.Pose(msg.Point(float(self.pose[0]), float(self.pose[1])), turn)
        twist = msg.Twist(msg.Vector3(float(v)), msg.Vector3(z=float(w)))
        self.told, unknown = time.monotonic(), [0.0] * 36
        told = msg.PoseWithCovariance(pose, unknown), msg.TwistWithCovariance(twist, unknown)
        self.odometry.send(msg.Odometry(header, "base_footprint", *told))


def main():
    """Run until a signal comes, in real time."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--domain", type=int, default=42)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--rate", type=float, default=200.0, help="messages per second (200)")
    options = options.parse_args()
    over = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: over.append(1))
    link = Link(Network(domain=options.domain))
    robot, start, k = Robot(link, options.seed), time.monotonic(), 0
    while not over:
        k += 1
        while (now := time.monotonic()) < start + k / options.rate:  # hears commands as they come
            robot.listen(now)
            time.sleep(min(2.5e-4, max(0.0, start + k / options.rate - now)))
        while robot.data.time < now - start:
            mujoco.mj_step(robot.model, robot.data)
        robot.tell()
        k = max(k, int((time.monotonic() - start) * options.rate))
    if robot.answers:
        median, tail = 1e3 * np.percentile(robot.answers, (50, 99))
        print(f"robot: a command {median:.2f} ms after a measurement, 99 % within {tail:.2f} ms", flush=True)
    truth = robot.data.qpos[:2], robot.pose[:2]
    print(f"robot: true place {truth[0].round(3)}, by odometry {truth[1].round(3)}", flush=True)
    link.close()


if __name__ == "__main__":
    main()
