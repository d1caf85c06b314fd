"""What the node sends: commands as the robot's controllers take them, and what the supervisor and the learner do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...loop.servo import Command
from ...loop.stepper import Stepper
from ...model.robot import Robot
from ...signals import Array
from . import messages as msg
from .link import Link, Outlet
from .settings import TRAJECTORY, TWIST_STAMPED, Node, Output
from .wiring import names_of

KINDS: dict[str, Any] = {
    "Float64MultiArray": msg.Float64MultiArray, "JointTrajectory": msg.JointTrajectory,
    "Twist": msg.Twist, "TwistStamped": msg.TwistStamped,
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
        link: The graph.
        robot: The robot.
        settings: What each of its controllers takes.
    """

    def __init__(self, link: Link, robot: Robot, settings: Node) -> None:
        names, d = names_of(robot, settings), robot.dimensions
        self.base, self.refused = d.base, 0
        self.soon = msg.Duration(0, int(2e9 / settings.rate))
        self.outlets = []
        for output in settings.commands:
            at = [robot.actuator_names.index(names[joint]) for joint in output.joints]
            outlet = Outlet(link, output.topic, KINDS[output.type], output)
            self.outlets.append((output, outlet, np.array(at, int), np.array(at, int) - d.motors + d.dof))

    def send(self, command: Command, stamp: msg.Time) -> None:
        """Send a command; one that is not finite is not sent, and counted."""
        for output, outlet, motors, rows in self.outlets:
            values = self._values(command, output, motors, rows)
            if np.isfinite(values).all():
                outlet.send(message_of(output, values.tolist(), stamp, self.soon))
            else:
                self.refused += 1

    def end(self, command: Command, share: float, stamp: msg.Time) -> None:
        """Send a share of the efforts of a command, and velocities of zero; positions stay."""
        for output, outlet, motors, rows in self.outlets:
            values = self._values(command, output, motors, rows)
            if np.isfinite(values).all() and output.interface != "position":
                by_effort = not output.is_twist and output.interface == "effort"
                factor = share if by_effort else 0.0
                outlet.send(message_of(output, (factor * values).tolist(), stamp, self.soon))

    @property
    def unheard(self) -> list[str]:
        """Topics of commands that nobody reads."""
        return [outlet.name for _, outlet, _, _ in self.outlets if not outlet.readers]

    @property
    def clashes(self) -> list[str]:
        """Topics whose readers ask for more than is offered."""
        return [outlet.name for _, outlet, _, _ in self.outlets if outlet.clashes]

    def _values(self, command: Command, output: Output, motors: Any, rows: Any) -> Array:
        if output.is_twist:
            return command.velocity[: self.base]
        if output.interface == "position":
            return command.position[rows]
        return (command.motor_effort if output.interface == "effort" else command.motor_velocity)[motors]


def message_of(output: Output, values: list[float], stamp: msg.Time, soon: msg.Duration) -> Any:
    """A command as its controller takes it."""
    if output.is_twist:
        sideways = values[1] if len(values) == 3 else 0.0
        twist = msg.Twist(msg.Vector3(values[0], sideways, 0.0), msg.Vector3(0.0, 0.0, values[-1]))
        return msg.TwistStamped(msg.Header(stamp, output.frame), twist) if output.type == TWIST_STAMPED else twist
    if output.type == TRAJECTORY:
        point = msg.JointTrajectoryPoint(values, [], [], [], soon)
        return msg.JointTrajectory(msg.Header(msg.Time(), ""), list(output.joints), [point])
    return msg.Float64MultiArray(msg.MultiArrayLayout([], 0), values)


def diagnostics(stepper: Stepper, stamp: msg.Time, problem: str, counts: dict[str, float]) -> msg.DiagnosticArray:
    """State of the supervisor, errors, Psi_hat and what the link counts.

    Args:
        stepper: After a sample.
        stamp: Now.
        problem: What is wrong at present; empty for nothing.
        counts: Numbers of the link.
    """
    row, layout, robot = stepper.row, stepper.setup.layout, stepper.robot
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
    statuses.append(status("link", WARN if any(counts.values()) else OK, "", counts))
    return msg.DiagnosticArray(msg.Header(stamp, ""), statuses)


def status(name: str, level: int, text: str, values: dict[str, float]) -> msg.DiagnosticStatus:
    """One part of the diagnostics; numbers as texts, as the message has them."""
    pairs = [msg.KeyValue(key, f"{value:.6g}") for key, value in values.items() if not math.isnan(value)]
    return msg.DiagnosticStatus(level, f"mmnn: {name}", text, "mmnn", pairs)
