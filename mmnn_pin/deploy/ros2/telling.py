"""Topics beside the commands: the controller's state, the odometry, the frame of the base.

The state is that of `joint_trajectory_controller`, odometry and frame those of `diff_drive_controller`, out of what the
node measured; the control loop hands a copy over, and messages are made beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node as RosNode
from trajectory_msgs.msg import JointTrajectoryPoint

from ...errors import ConfigError
from ...loop.stepper import Stepper
from ...signals import Array
from .action import situation, transform, twist
from .inlets import Outlet
from .outputs import stamp_of
from .planned import RobotSituation
from .sensing import STILL, Sensing, of_frame
from .settings import Node

STATE = ("reference", "feedback", "error")  # fields of the controller's state
SHARE = 10.0  # time over which the learned share is taken [s]


class Telling:
    """The topics of one robot's state.

    Args:
        node: The node.
        stepper: The stepper.
        settings: All parameters.
        sensing: What is measured.

    Raises:
        ConfigError: Frames that come from `/tf` are to be published there, or a message's package is not there.
    """

    def __init__(self, node: RosNode, stepper: Stepper, settings: Node, sensing: Sensing) -> None:
        self.stepper, self.settings, self.sensing = stepper, settings, sensing
        self.names = [settings.joint_states.theirs.get(name, name) for name in stepper.robot.joint_names]
        self.outlets = list(self._outlets(node))
        self.told = [-np.inf for _ in self.outlets]

    def _outlets(self, node: RosNode) -> Iterator[tuple[Outlet, float, Callable[[RobotSituation, Array, float], Any]]]:
        """Topics, how often each is told, and what makes its message."""
        s, has_base = self.settings.publish, bool(self.stepper.robot.dimensions.base)
        if s.state:
            try:
                from control_msgs.msg import JointTrajectoryControllerState as State
            except ImportError:
                node.get_logger().warning("no ~/controller_state without the package control_msgs")
            else:
                self.kind = State
                yield Outlet(node, "~/controller_state", State), s.state, self._state
        if s.odometry and has_base:
            yield Outlet(node, "~/odom", Odometry), s.odometry, self._odometry
        if s.tf and has_base:
            from tf2_msgs.msg import TFMessage

            if self.settings.odometry.source == "tf":
                fix = "leave publish.tf out: who tells it now goes on"
                raise ConfigError("the frame of the base comes from /tf already", fix=fix, key="publish.tf")
            rate = s.odometry or 50.0
            yield Outlet(node, "/tf", TFMessage), rate, lambda *now: TFMessage(transforms=[self._frame(*now)])

    def due(self, time: float, now: RobotSituation, by_ros: float) -> Iterator[Callable[[], None]]:
        """Messages that are due at a time [s], each to be made and sent beside the loop."""
        for i, (outlet, rate, make) in enumerate(self.outlets):
            if time - self.told[i] >= (1.0 - 1e-6) / rate:
                self.told[i] = max(self.told[i] + 1.0 / rate, time - 1.0 / rate)
                command, told = self.stepper.command, now.copy()
                yield partial(self._tell, outlet, make, told, command.effort.copy(), by_ros)

    def _tell(self, outlet: Outlet, make: Callable[..., Any], *now: Any) -> None:
        outlet.send(make(*now))

    def _state(self, now: RobotSituation, effort: Array, by_ros: float) -> Any:
        base = self.settings.tf.base if self.stepper.robot.dimensions.base else ""
        told = situation(self.kind, self.names, base, now, by_ros, STATE)
        told.output = JointTrajectoryPoint(effort=effort[effort.size - len(self.names) :].tolist())
        return told

    def _frame(self, now: RobotSituation, effort: Array, by_ros: float) -> TransformStamped:
        """Where the frame of the base is in the odometry's."""
        there, _ = of_frame(self.sensing.at or STILL, now.pose, now.velocity)
        made = TransformStamped(child_frame_id=self.settings.tf.base, transform=transform(np.array(there)))
        made.header.stamp, made.header.frame_id = stamp_of(by_ros), self.settings.tf.odom
        return made

    def _odometry(self, now: RobotSituation, effort: Array, by_ros: float) -> Odometry:
        """Pose of the frame of the base, and its velocity in itself."""
        frame = self._frame(now, effort, by_ros)
        made = Odometry(header=frame.header, child_frame_id=frame.child_frame_id)
        place = made.pose.pose.position
        place.x, place.y = frame.transform.translation.x, frame.transform.translation.y
        made.pose.pose.orientation = frame.transform.rotation
        made.twist.twist = twist(of_frame(self.sensing.at or STILL, now.pose, now.velocity)[1])
        return made


class LearnedShare:
    """RMS of Psi_hat over RMS of the applied torque, of the last seconds."""

    def __init__(self) -> None:
        self.squares = np.zeros(2)

    def take(self, psi_hat: Array, torque: Array, dt: float) -> float:
        """The share with a sample that came some time [s] after the last; NaN where there is no torque."""
        self.squares *= np.exp(-dt / SHARE)
        self.squares += psi_hat @ psi_hat, torque @ torque
        return float(np.sqrt(self.squares[0] / self.squares[1])) if self.squares[1] > 0.0 else np.nan
