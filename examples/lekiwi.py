"""LeKiwi by LeRobot's own Python API: its observations to a stepper, and the stepper's commands back, at 30 Hz.

`pip install lerobot[lekiwi]`; LeRobot's drivers, its calibration and its emergency stop stay as they are:

    python examples/lekiwi.py lekiwi.urdf /dev/ttyACM0
"""

import math
import sys
import time

import numpy as np

from mmnn_pin import PD, Measurement, Stepper, StepperSettings, load
from mmnn_pin.reference.wishes import BaseVelocity, JointGoal
from mmnn_pin.safety import Safety

PERIOD = 1.0 / 30.0
ARM = ("arm_shoulder_pan", "arm_shoulder_lift", "arm_elbow_flex", "arm_wrist_flex", "arm_wrist_roll")


class LeKiwi:
    """What LeRobot's robot says and takes: degrees, degrees per second, metres per second; the pose is integrated."""

    def __init__(self, robot, lekiwi):
        self.lekiwi, self.pose, self.kept = lekiwi, np.zeros(3), {}
        self.q, self.n, self.steers = None, robot.dimensions.arm, robot.dimensions.base

    def read(self):
        """What the robot says now."""
        said = self.lekiwi.get_observation()
        q = np.radians([said[f"{name}.pos"] for name in ARM[: self.n]])
        velocity = np.array([said["x.vel"], said["y.vel"], math.radians(said["theta.vel"])])
        qdot = np.zeros(self.n) if self.q is None else (q - self.q) / PERIOD
        self.kept = {key: value for key, value in said.items() if key.startswith("arm_")}  # the gripper stays
        c, s = math.cos(self.pose[2]), math.sin(self.pose[2])
        self.pose += PERIOD * np.array(
            [c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1], velocity[2]]
        )
        self.q = q
        return Measurement(self.pose.copy(), velocity, q, qdot)

    def write(self, command):
        """Goals of the arm and the base's velocity; the gripper stays where it is."""
        goal = dict(self.kept)
        goal |= {f"{name}.pos": math.degrees(q) for name, q in zip(ARM, command.position[3:], strict=False)}
        x, y, theta = command.twist
        self.lekiwi.send_action({**goal, "x.vel": x, "y.vel": y, "theta.vel": math.degrees(theta)})


def run(robot, lekiwi, seconds, goal, velocity, clock=time.perf_counter, sleep=time.sleep):
    """Drive at a velocity (vx, vy, w) and bring the arm to a goal [rad]; the recording."""
    wheels = dict.fromkeys([wheel.joint for wheel in robot.base.wheels], "velocity")
    interfaces = wheels | dict.fromkeys(robot.joint_names, "position")
    settings = StepperSettings(safety=Safety(), period=PERIOD, interfaces=interfaces, latency=0.02)
    with Stepper(robot, PD(), settings) as stepper:
        driver, began = LeKiwi(robot, lekiwi), clock()
        for k in range(round(seconds / PERIOD)):
            wish = (BaseVelocity(velocity), JointGoal(goal)) if k == 0 else BaseVelocity(velocity)
            driver.write(stepper.step(clock() - began, driver.read(), wish))
            stepper.record()
            sleep(max(0.0, began + (k + 1) * PERIOD - clock()))
        return stepper.finish()


if __name__ == "__main__":
    from lerobot.robots.lekiwi import LeKiwi as Bus
    from lerobot.robots.lekiwi import LeKiwiConfig

    bus = Bus(LeKiwiConfig(port=sys.argv[2], cameras={}, use_degrees=True))
    bus.connect()
    try:
        print(run(load(sys.argv[1]), bus, 5.0, np.zeros(5), (0.1, 0.0, 0.3)).errors())
    finally:
        bus.disconnect()
