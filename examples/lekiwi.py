"""LeKiwi by LeRobot's own Python API: its observations to a stepper, and the stepper's commands back, at 30 Hz.

`pip install lerobot[lekiwi]`; LeRobot's drivers, its calibration and its emergency stop stay as they are:

    python examples/lekiwi.py lekiwi.urdf /dev/ttyACM0
"""

import math
import sys

import numpy as np

from mmnn_pin import DeadReckoning, Measurement, drive, load, stepper_on
from mmnn_pin.reference.wishes import BaseVelocity, JointGoal

ARM = ("arm_shoulder_pan", "arm_shoulder_lift", "arm_elbow_flex", "arm_wrist_flex", "arm_wrist_roll")


class LeKiwi:
    """What LeRobot's robot says and takes: degrees, degrees per second, metres per second; the gripper stays."""

    def __init__(self, lekiwi, period):
        self.lekiwi, self.period, self.odometry, self.kept, self.q = lekiwi, period, DeadReckoning(), {}, None

    def read(self):
        """What the robot says now."""
        said = self.lekiwi.get_observation()
        self.kept = {key: value for key, value in said.items() if key.startswith("arm_")}
        q, before = np.radians([said[f"{name}.pos"] for name in ARM]), self.q
        velocity, self.q = np.array([said["x.vel"], said["y.vel"], math.radians(said["theta.vel"])]), q
        rates = np.zeros(5) if before is None else (q - before) / self.period
        return Measurement(self.odometry.move(velocity, self.period), velocity, q, rates)

    def write(self, command):
        """Goals of the arm and the base's velocity."""
        goal = self.kept | {f"{name}.pos": math.degrees(q) for name, q in zip(ARM, command.position[3:], strict=True)}
        x, y, theta = command.twist
        self.lekiwi.send_action({**goal, "x.vel": x, "y.vel": y, "theta.vel": math.degrees(theta)})


def run(robot, lekiwi, seconds, wish, **clock):
    """Do what is wished for; the recording."""
    with stepper_on(robot, "lekiwi", "learned") as stepper:
        return drive(stepper, LeKiwi(lekiwi, stepper.period), seconds, wish, **clock)


if __name__ == "__main__":
    from lerobot.robots.lekiwi import LeKiwi as Bus
    from lerobot.robots.lekiwi import LeKiwiConfig

    bus = Bus(LeKiwiConfig(port=sys.argv[2], cameras={}, use_degrees=True))
    bus.connect()
    try:
        on, home = BaseVelocity((0.1, 0.0, 0.3)), JointGoal(np.zeros(5))  # velocities have to be renewed, goals not
        print(run(load(sys.argv[1]), bus, 5.0, lambda t: on if t else (on, home)).errors())
    finally:
        bus.disconnect()
