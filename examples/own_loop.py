"""A loop of one's own: a driver that reads and writes a robot, and a stepper between; here the robot is simulated."""

import numpy as np

from mmnn_pin import PD, Feedback, Measurement, Stepper, StepperSettings, load
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.reference.wishes import BaseVelocity, JointGoal
from mmnn_pin.safety import Safety


class Driver:
    """Stands for what talks to your robot: `read` gives a measurement, `write` takes torques of the motors."""

    def __init__(self, robot, period):
        self.robot, self.plant = robot, IdealPlant(robot, period, "implicit_friction")
        self.plant.start(robot.neutral_position(), np.zeros(robot.dimensions.dof))

    def read(self):
        """Pose (x, y, phi), base velocity (v, w), joints, their rates."""
        position, nu = self.plant.position, self.plant.nu
        return Measurement(position[:3], nu[:2], position[self.robot.arm_index], nu[2:])

    def write(self, motor_effort):
        """Torques of the motors, drive wheels from left to right, then the arm [N m]."""
        self.plant.step(self.robot.E @ motor_effort)
        self.plant.refresh()


if __name__ == "__main__":
    robot, limits = load("platform_arm"), Safety(torque=50.0, speed=1.0, joint_error=0.5)
    with Stepper(robot, PD(Feedback(15.0, 20.0, "inertia")), StepperSettings(safety=limits, period=0.002)) as stepper:
        driver, drive = Driver(robot, stepper.period), BaseVelocity((0.3, 0.2))
        for k in range(2000):  # pacing is yours: here there is none
            setpoint = drive if k % 50 == 0 else JointGoal((0.8, -0.5)) if k == 1 else None
            command = stepper.step(k * stepper.period, driver.read(), setpoint)
            driver.write(command.motor_effort)
            stepper.record()
        run = stepper.finish()
    velocity, q = run["velocity"][-1].round(3), run["q"][-1].round(3)
    print(f"{run.outcome.status} after {run.outcome.time:g} s: v, w {velocity}, q {q}")
