"""TurtleBot3 with OpenMANIPULATOR by Dynamixel's SDK, without ROS: examples/turtlebot3.py ROBOT.urdf /dev/ttyUSB0."""

import sys

import numpy as np

from mmnn_pin import Measurement, load
from mmnn_pin.lab.experiments.stepping import stepper_on
from mmnn_pin.loop.driving import DeadReckoning, drive
from mmnn_pin.reference.wishes import BaseVelocity

WHEELS, ARM, TICK, RATE = (1, 2), (11, 12, 13, 14), np.pi / 2048, 0.229 * np.pi / 30.0  # ids, rad, rad/s
TORQUE, MODE, GOALS, VELOCITY, POSITION = 64, 11, (104, 116), 128, 132  # of the control table


class TurtleBot:
    """Present velocity and position of every servo by one sync read, goals by sync writes."""

    def __init__(self, robot, period, port, packet, sync_read, sync_write):
        self.robot, self.period, self.odometry = robot, period, DeadReckoning()
        self.state, self.groups = sync_read(port, packet, VELOCITY, 8), [sync_write(port, packet, g, 4) for g in GOALS]
        for i in (*WHEELS, *ARM):
            for address, value in ((TORQUE, 0), (MODE, 1 if i in WHEELS else 3), (TORQUE, 1)):
                packet.write1ByteTxRx(port, i, address, value)
            self.state.addParam(i)

    def numbers(self, ids, address):
        """Numbers of four bytes with a sign, as the control table has them."""
        return np.array([self.state.getData(i, address, 4) for i in ids], np.uint32).astype(np.int32)

    def read(self):
        """What the servos say now; None where a packet is broken: the stepper holds the last one."""
        if self.state.txRxPacket() != 0:
            return None
        rates, q = RATE * self.numbers((*WHEELS, *ARM), VELOCITY), TICK * (self.numbers(ARM, POSITION) - 2048)
        base = np.linalg.solve(self.robot.E[:2, :2].T, rates[:2])
        return Measurement(self.odometry.move(base, self.period), base, q, rates[2:])

    def write(self, command):
        """Goals of all servos."""
        goals = command.motor_velocity[:2] / RATE, 2048 + command.motor_position[2:] / TICK
        for group, ids, values in zip(self.groups, (WHEELS, ARM), goals, strict=True):
            for i, goal in zip(ids, values, strict=True):
                group.addParam(i, list(round(goal).to_bytes(4, "little", signed=True)))
            group.txPacket()
            group.clearParam()


def run(robot, bus, seconds, wish, **clock):
    """Do what is wished for; the recording."""
    with stepper_on(robot, "turtlebot3") as stepper:
        return drive(stepper, TurtleBot(robot, stepper.period, *bus), seconds, wish, **clock)


if __name__ == "__main__":
    from dynamixel_sdk import GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

    bus = (PortHandler(sys.argv[2]), PacketHandler(2.0), GroupSyncRead, GroupSyncWrite)
    bus[0].setBaudRate(1_000_000)  # opens it, too
    print(run(load(sys.argv[1]), bus, 5.0, lambda t: BaseVelocity((0.1, 0.3))).errors())
