"""Setpoints of a hand out of the graph: where it is to be, how it is to move, push and give way.

~/hand/pose        geometry_msgs/PoseStamped      in the odometry's frame, the map's or another one of `/tf`
~/hand/twist       geometry_msgs/TwistStamped     likewise, or in the hand's own frame, by `frame_id`
~/hand/force       geometry_msgs/WrenchStamped    force on the world, likewise, where the experiment has [force]
~/hand/stiffness   std_msgs/Float64MultiArray     k, or kx ky kz [N/m]; dx dy dz [N s/m] behind them
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.node import Node as RosNode
from std_msgs.msg import Float64MultiArray

from ...elementary.matrices import product
from ...errors import ConfigError, InputError
from ...loop.stepper import Stepper
from ...model.chain import hands_of
from ...reference.hand import HandWish, Task, WholeBody, WishedCourse
from ...reference.wishes import Wish
from ...signals import Array
from .inlets import Inlet
from .mapped import MappedRoute
from .sensing import Clock, Planar, quaternion
from .settings import Node


class HandAsking:
    """The topics with setpoints of a stepper's hand.

    Args:
        node: The node.
        stepper: The robot's.
        settings: Topics and limits.
        route: What knows where frames are.

    Attributes:
        wish: What the stepper follows once something came.

    Raises:
        InputError: A hand that cannot be led, or no daqp.
    """

    def __init__(self, node: RosNode, stepper: Stepper, settings: Node, route: MappedRoute) -> None:
        robot, own = stepper.robot, settings.hand
        self.stepper, self.settings, self.route = stepper, settings, route
        soft = stepper.setup.impedance
        self.frame = (soft.frame if soft is not None else "") or hands_of(robot)[0]
        task = Task(frame=self.frame, orientation=0.1 if own.turns else 0.0)
        body = WholeBody(robot, [task], limits=settings.limits, period=stepper.period)
        self.wish = HandWish(body, (own.speed, own.turning), settings.setpoint_timeout, on_measured=soft is None)

        def listened(name: str, kind: type[Any]) -> Inlet:
            return Inlet(node, name, kind, reliable=True, publishers=own.publishers)

        self.pose = listened("~/hand/pose", PoseStamped)
        self.twist = listened("~/hand/twist", TwistStamped)
        self.stiffness = listened("~/hand/stiffness", Float64MultiArray) if soft is not None else None
        self.force = listened("~/hand/force", WrenchStamped) if stepper.setup.force is not None else None
        self.pushed = math.inf  # when the last force came [s]
        self._rehearse()
        self.inlets = [one for one in (self.pose, self.twist, self.stiffness, self.force) if one is not None]

    def _rehearse(self) -> None:
        """Lead the hand where it stands at rest, and forget it: the first time compiles."""
        robot, d = self.stepper.robot, self.stepper.robot.dimensions
        q, now = robot.rest[robot.arm_index], np.zeros_like(self.stepper.follower.now)
        now[d.pose + 2 * d.twist :][: d.arm] = q
        self.wish.go(
            robot.placement(self.frame, np.hstack((np.zeros(d.pose), robot.rest[robot.shape_index], q)))[:3, 3]
        )
        measured = np.hstack((np.zeros(d.pose + d.twist), q, np.zeros(d.arm)))
        WishedCourse(self.wish, now.copy(), measured).write(3 * self.stepper.period, now)
        self.wish.goal = None

    @classmethod
    def of(cls, node: RosNode, stepper: Stepper, settings: Node, route: MappedRoute) -> HandAsking | None:
        """The topics; None where they are not asked for, and with a warning where the hand cannot be led."""
        asked = settings.hand.listen
        if not (stepper.setup.impedance is not None if asked is None else asked):
            return None
        try:
            return cls(node, stepper, settings, route)
        except InputError as error:
            if asked:
                raise
            node.get_logger().warning(f"no setpoints of the hand: {error}")
            return None

    def poll(self, clock: Clock) -> tuple[Wish, ...]:
        """The wish, where something came and it is not followed yet."""
        came = self._soften()
        self._press(clock)
        for inlet, read in ((self.pose, self._place), (self.twist, self._move)):
            if (message := inlet.newest()) is not None:
                when = clock.measured(message.header.stamp, self.settings.hand.age)
                why = when if isinstance(when, str) else self._tried(read, message)
                came = came or not why
                if why:
                    inlet.refuse(why)
        followed = all(isinstance(course, WishedCourse) for course in self._courses())
        return () if followed or not came else (self.wish,)

    def _courses(self) -> list[Any]:
        courses = self.stepper.follower.courses
        return courses if self.stepper.robot.dimensions.base else courses[1:]

    def _tried(self, read: Any, message: Any) -> str:
        """Why a message is not followed; empty where it is."""
        try:
            read(message)
        except InputError as error:
            return f"{error.what}: {error.fix}"
        return ""

    def _frame(self, name: str) -> Planar:
        """Where a frame lies in the odometry's.

        Raises:
            ConfigError: Nobody knows.
        """
        if (place := self.route.place_of(name.lstrip("/"))) is None:
            raise ConfigError(f"nothing tells where '{name}' is", fix=f"use '{self.settings.tf.odom}'", key="hand")
        return place

    def _place(self, message: Any) -> None:
        x, y, turn = self._frame(message.header.frame_id)
        at, c, s = message.pose.position, math.cos(turn), math.sin(turn)
        frame = pin.Quaternion(np.array([0.0, 0.0, math.sin(0.5 * turn), math.cos(0.5 * turn)]))
        q = pin.Quaternion(np.array(quaternion(message.pose.orientation), float))
        turned = (frame * q).coeffs() if self.settings.hand.turns else None
        self.wish.go((x + c * at.x - s * at.y, y + s * at.x + c * at.y, at.z), turned)

    def _move(self, message: Any) -> None:
        self.wish.move(self._turned(message, message.twist.linear, message.twist.angular).ravel())

    def _turned(self, message: Any, *vectors: Any) -> Array:
        """(k, 3) vectors of a message in the odometry's axes."""
        if message.header.frame_id == self.frame:
            seen = self.stepper.measured
            R = self.stepper.robot.placement(self.frame, np.concatenate((seen.pose, seen.shape, seen.q)))[:3, :3]
        else:
            turn = self._frame(message.header.frame_id)[2]
            c, s = math.cos(turn), math.sin(turn)
            R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return product([[one.x, one.y, one.z] for one in vectors], R.T)

    def _press(self, clock: Clock) -> None:
        """Push as the newest message says, and with nothing once it is old."""
        if self.force is None:
            return
        if (message := self.force.newest()) is not None:
            when = clock.measured(message.header.stamp, self.settings.hand.age)
            why = when if isinstance(when, str) else self._tried(self._push, message)
            if why:
                self.force.refuse(why)
            elif not isinstance(when, str):
                self.pushed = when
        elif clock.now - self.pushed > self.settings.setpoint_timeout:
            self.stepper.push(np.zeros(3))
            self.pushed = math.inf

    def _push(self, message: Any) -> None:
        moment = message.wrench.torque
        if (moment.x, moment.y, moment.z) != (0.0, 0.0, 0.0):
            raise ConfigError("a moment", fix="send a force alone", key="hand")
        self.stepper.push(self._turned(message, message.wrench.force)[0])

    def _soften(self) -> bool:
        """Take another stiffness; false, as it asks for no motion."""
        if self.stiffness is not None and (message := self.stiffness.newest()) is not None:
            values = list(message.data)
            split = len(values) if len(values) in (1, 3) else 3
            if len(values) not in (1, 3, 6):
                self.stiffness.refuse(f"{len(values)} numbers: send 1, 3 or 6")
                return False
            k, d = values[:split], values[split:]
            why = self._tried(lambda _: self.stepper.comply(k[0] if len(k) == 1 else k, d or None), message)
            if why:
                self.stiffness.refuse(why)
        return False
