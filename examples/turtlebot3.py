"""TurtleBot3 with OpenMANIPULATOR by Dynamixel's SDK: one bus of protocol 2.0, at 30 Hz, without ROS.

`pip install dynamixel_sdk`; the servos are XL430 and XM430, wheels in velocity mode, the arm in position mode:

    python examples/turtlebot3.py turtlebot3_manipulation.urdf /dev/ttyUSB0
"""

import math
import sys
import time

import numpy as np

from mmnn_pin import PD, Measurement, Stepper, StepperSettings, load
from mmnn_pin.reference.wishes import BaseVelocity, JointGoal
from mmnn_pin.safety import Safety

PERIOD = 1.0 / 30.0
WHEELS, ARM = (1, 2), (11, 12, 13, 14)  # ids on the bus, left and right wheel, then the arm
TORQUE, MODE, GOAL_VELOCITY, GOAL_POSITION, VELOCITY, POSITION = 64, 11, 104, 116, 128, 132  # of the control table
TICK, RATE = math.tau / 4096, 0.229 * math.tau / 60.0  # [rad], [rad/s]


def signed(number):
    """A number of four bytes as the control table has it."""
    return number - (1 << 32) if number >= 1 << 31 else number


class TurtleBot:
    """Present velocity and position of every servo by one sync read, goals by sync writes."""

    def __init__(self, robot, port, packet, sync_read, sync_write):
        self.robot, self.pose = robot, np.zeros(3)
        self.state = sync_read(port, packet, VELOCITY, 8)
        self.wheels, self.arm = (sync_write(port, packet, at, 4) for at in (GOAL_VELOCITY, GOAL_POSITION))
        for i in (*WHEELS, *ARM):
            packet.write1ByteTxRx(port, i, TORQUE, 0)
            packet.write1ByteTxRx(port, i, MODE, 1 if i in WHEELS else 3)
            packet.write1ByteTxRx(port, i, TORQUE, 1)
            self.state.addParam(i)

    def read(self):
        """What the servos say now; None where a packet is broken."""
        if self.state.txRxPacket() != 0:
            return None  # a broken packet: the stepper holds the last one
        rates = RATE * np.array([signed(self.state.getData(i, VELOCITY, 4)) for i in (*WHEELS, *ARM)])
        q = TICK * (np.array([signed(self.state.getData(i, POSITION, 4)) for i in ARM]) - 2048)
        velocity = np.linalg.lstsq(self.robot.E[:2, :2].T, rates[:2], rcond=None)[0]
        turn = self.pose[2] + 0.5 * PERIOD * velocity[1]
        self.pose += PERIOD * np.array([velocity[0] * math.cos(turn), velocity[0] * math.sin(turn), velocity[1]])
        return Measurement(self.pose.copy(), velocity, q, rates[2:])

    def write(self, command):
        """Goals of all servos."""
        goals = np.concatenate((command.motor_velocity[:2] / RATE, 2048 + command.motor_position[2:] / TICK))
        for i, goal in zip((*WHEELS, *ARM), np.round(goals).astype(int).tolist(), strict=True):
            (self.wheels if i in WHEELS else self.arm).addParam(i, list(int(goal).to_bytes(4, "little", signed=True)))
        for group in (self.wheels, self.arm):
            group.txPacket()
            group.clearParam()


def run(robot, driver, seconds, goal, velocity, clock=time.perf_counter, sleep=time.sleep):
    """Drive at a velocity (v, w) and bring the arm to a goal [rad]; the recording."""
    kinds = ["velocity"] * 2 + ["position"] * robot.dimensions.arm
    interfaces = dict(zip(robot.actuator_names, kinds, strict=True))
    settings = StepperSettings(safety=Safety(), period=PERIOD, interfaces=interfaces, latency=0.01)
    with Stepper(robot, PD(), settings) as stepper:
        began = clock()
        for k in range(round(seconds / PERIOD)):
            wish = (BaseVelocity(velocity), JointGoal(goal)) if k == 0 else BaseVelocity(velocity)
            driver.write(stepper.step(clock() - began, driver.read(), wish))
            stepper.record()
            sleep(max(0.0, began + (k + 1) * PERIOD - clock()))
        return stepper.finish()


if __name__ == "__main__":
    from dynamixel_sdk import GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

    port, packet, robot = PortHandler(sys.argv[2]), PacketHandler(2.0), load(sys.argv[1])
    port.openPort()
    port.setBaudRate(1_000_000)
    bot = TurtleBot(robot, port, packet, GroupSyncRead, GroupSyncWrite)
    print(run(robot, bot, 5.0, np.zeros(4), (0.1, 0.3)).errors())
