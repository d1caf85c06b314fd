"""Messages of the node: commands as the robot's controllers take them, and the state of supervisor and learner."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Twist, TwistStamped, WrenchStamped
from rclpy.node import Node as RosNode
from std_msgs.msg import Float64MultiArray, Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ...elementary.matrices import product
from ...errors import ConfigError
from ...loop.servo import Command
from ...loop.stepper import Stepper
from ...model.base.steered import SteeredBase
from ...model.robot import Robot
from ...signals import Array
from .inlets import Outlet
from .settings import ACKERMANN, TRAJECTORY, TWIST_STAMPED, Node, Output
from .wiring import ackermann, names_of, topic_of

KINDS: dict[str, Any] = {
    "Float64MultiArray": Float64MultiArray, "JointTrajectory": JointTrajectory,
    "Twist": Twist, "TwistStamped": TwistStamped,
}  # fmt: skip
OK, WARN, ERROR = 0, 1, 2
STATES = {
    0: "running",
    1: "running, a torque is clipped or a measurement held",
    2: "stopping",
    3: "stopping, no feedback",
}


class Commands:
    """The commands of all of the robot's controllers.

    Args:
        node: The node.
        robot: The robot.
        settings: What each of its controllers takes.
    """

    def __init__(self, node: RosNode, robot: Robot, settings: Node) -> None:
        names = names_of(robot, settings)
        self.refused, self.angle = 0, 0.0
        self.wheelbase = robot.base.length if isinstance(robot.base, SteeredBase) else 0.0
        self.soon = duration_of(2.0 / settings.rate)
        self.outlets = []
        for name, output in settings.commands.items():
            at = [robot.actuator_names.index(names[joint]) for joint in output.joints]
            outlet = Outlet(node, topic_of(robot, name, output), message_type(output.type))
            self.outlets.append((output, outlet, np.array(at, int)))

    def send(self, command: Command, stamp: Time) -> None:
        """Send a command; one that is not finite is not sent, and counted."""
        for output, outlet, motors in self.outlets:
            values = self._values(command, output, motors)
            if np.isfinite(values).all():
                outlet.send(message_of(output, values.tolist(), stamp, self.soon))
            else:
                self.refused += 1

    def end(self, command: Command, share: float, stamp: Time) -> None:
        """Send a share of the efforts of a command, and velocities of zero; positions stay, and a car's steering."""
        for output, outlet, motors in self.outlets:
            values = self._values(command, output, motors)
            if np.isfinite(values).all() and output.interface != "position":
                by_effort = not output.is_base and output.interface == "effort"
                faded = (share if by_effort else 0.0) * values
                if output.type == ACKERMANN:
                    faded[1] = values[1]
                outlet.send(message_of(output, faded.tolist(), stamp, self.soon))

    @property
    def unheard(self) -> list[str]:
        """Topics of commands that nobody reads."""
        return [outlet.name for _, outlet, _ in self.outlets if not outlet.readers]

    def crowd(self) -> str:
        """Which other node sends commands, too; empty for none."""
        for _, outlet, _ in self.outlets:
            if others := outlet.others():
                return f"{outlet.name}: {', '.join(others)} publishes it, too: one node controls a robot"
        return ""

    @property
    def trouble(self) -> str:
        """Why nothing may be sent: nobody reads, asks for another quality, or another node sends; empty else."""
        for _, outlet, _ in self.outlets:
            if outlet.clash:
                return f"{outlet.name}: its reader asks for another {outlet.clash}: set qos_overrides"
        if crowd := self.crowd():
            return crowd
        unheard = self.unheard
        return f"nobody reads {', '.join(unheard)}: load the robot's controllers" if unheard else ""

    def _values(self, command: Command, output: Output, motors: Any) -> Array:
        if output.type == ACKERMANN:
            return self._driven(command.twist)
        if output.is_base:
            return command.twist
        if output.interface == "position":
            return command.motor_position[motors]
        return (command.motor_effort if output.interface == "effort" else command.motor_velocity)[motors]

    def _driven(self, twist: Array) -> Array:
        """Speed of a car's fixed axle and the angle of the wheel in the middle of the other; it keeps that at rest."""
        v, angle = ackermann(twist, self.wheelbase, self.angle)
        self.angle = angle if math.isfinite(angle) else self.angle
        return np.array([v, angle])


def message_type(name: str) -> Any:
    """The class of a message.

    Raises:
        ConfigError: Its package is not there.
    """
    if name != ACKERMANN:
        return KINDS[name]
    try:
        from ackermann_msgs.msg import AckermannDriveStamped
    except ImportError as error:
        fix = "apt-get install ros-$ROS_DISTRO-ackermann-msgs, or send it a TwistStamped"
        raise ConfigError("no ackermann_msgs for this Python", why=str(error), fix=fix, key="commands") from error
    return AckermannDriveStamped


def message_of(output: Output, values: list[float], stamp: Time, soon: Duration) -> Any:
    """A command as its controller takes it."""
    if output.type == ACKERMANN:
        message = message_type(ACKERMANN)(header=Header(stamp=stamp, frame_id=output.frame))
        message.drive.speed, message.drive.steering_angle = values
        return message
    if output.is_base:
        twist = Twist()
        twist.linear.x, twist.angular.z = values[0], values[-1]
        twist.linear.y = values[1] if len(values) == 3 else 0.0
        header = Header(stamp=stamp, frame_id=output.frame)
        return TwistStamped(header=header, twist=twist) if output.type == TWIST_STAMPED else twist
    if output.type == TRAJECTORY:
        point = JointTrajectoryPoint(positions=values, time_from_start=soon)
        return JointTrajectory(joint_names=list(output.joints), points=[point])
    return Float64MultiArray(data=values)


def wrench_of(stepper: Stepper, stamp: Time) -> WrenchStamped:
    """Force and moment of the world on the hand at the last measurement, in the hand's frame."""
    seen, hand = stepper.measured, stepper.hand
    R = stepper.robot.placement(hand, np.concatenate((seen.pose, seen.shape, seen.q)))[:3, :3]
    force, moment = (product(R.T, part).tolist() for part in np.split(stepper.external_wrench, 2))
    message = WrenchStamped(header=Header(stamp=stamp, frame_id=hand))
    message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = force
    message.wrench.torque.x, message.wrench.torque.y, message.wrench.torque.z = moment
    return message


def stamp_of(time: float) -> Time:
    """A time [s] for a header."""
    whole, rest = divmod(time, 1.0)
    return Time(sec=int(whole), nanosec=int(1e9 * rest))


def duration_of(time: float) -> Duration:
    """A duration [s]."""
    whole, rest = divmod(time, 1.0)
    return Duration(sec=int(whole), nanosec=int(1e9 * rest))


def diagnostics(
    stepper: Stepper, row: Array, stamp: Time, problem: str, counts: dict[str, float], share: float
) -> DiagnosticArray:
    """State of the supervisor, errors, Psi_hat and what the link counts.

    Args:
        stepper: The stepper.
        row: Its row after a sample.
        stamp: Now.
        problem: What is wrong at present; empty for nothing.
        counts: Numbers of the link.
        share: RMS of Psi_hat over RMS of the torque.
    """
    layout, robot = stepper.setup.layout, stepper.robot
    state = int(row[layout.where("safety")][0])
    level = ERROR if stepper.tripped else WARN if problem or state else OK
    error = ("error x", "error y", "error phi")[: robot.dimensions.pose]
    tables: dict[str, tuple[Sequence[str], Array]] = {
        "pose": (error, row[layout.where("pose_error")]),
        "joint error": (robot.joint_names, row[layout.where("e")]),
        "psi_hat": (robot.velocity_names, row[layout.where("psi_hat")]),
        "torque": (robot.velocity_names, row[layout.where("torque")]),
    }
    own = {"time": stepper.time, "state": float(state), "step_time": stepper.step_time}
    statuses = [status("supervisor", level, problem or STATES.get(state, ""), own)]
    statuses += [
        status(name, OK, "", dict(zip(names, values.tolist(), strict=True))) for name, (names, values) in tables.items()
    ]
    statuses.append(status("learner", OK, "", {"learned_share": share}))
    statuses.append(status("link", WARN if any(counts.values()) else OK, "", counts))
    return DiagnosticArray(header=Header(stamp=stamp), status=statuses)


def status(name: str, level: int, text: str, values: dict[str, float]) -> DiagnosticStatus:
    """One part of the diagnostics; numbers as texts, as the message has them."""
    pairs = [KeyValue(key=key, value=f"{value:.6g}") for key, value in values.items() if not math.isnan(value)]
    return DiagnosticStatus(level=bytes([level]), name=f"mmnn: {name}", message=text, hardware_id="mmnn", values=pairs)
