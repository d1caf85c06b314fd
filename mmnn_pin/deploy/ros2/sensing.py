"""From messages to a measurement: clocks, names of joints, frames, and what is wrong with a message.

The pose is that of the control frame in the odometry's frame, which never jumps; the map's corrections touch only
setpoints that are given in the map. A method that reads a message returns why it was refused, or nothing.
"""

from __future__ import annotations

import math
import time as clock
from typing import Any

import numpy as np
import pinocchio as pin

from ...elementary import nearest_turn
from ...errors import ConfigError
from ...model.base.rolling import Maps, new_maps, roll
from ...model.base.steered import SteeredBase
from ...model.robot import Robot
from ...safety.door import FARTHEST
from ...signals import Array, Measurement
from .settings import Clocks, Node

NANO = 1e-9
LARGEST = 1e9  # a number beyond this is none [SI units]
Planar = tuple[float, float, float]  # x, y, turn
STILL: Planar = (0.0, 0.0, 0.0)
ANY = np.zeros(3)  # direction of u where none is known yet


class Clock:
    """The time of the node, and how old a stamp is.

    Args:
        settings: What becomes of stamps.
        is_simulated: Whether a simulator tells the time.

    Attributes:
        begin: Zero of the node's time, by its clock [s].
        simulated: Time of the simulator; NaN before it told [s].
        jumped: What a simulated clock did that no clock does; empty else. The node's time goes on from where it was,
            with the simulator's.
    """

    def __init__(self, settings: Clocks, is_simulated: bool = False) -> None:
        self.settings, self.is_simulated = settings, is_simulated
        self.simulated, self.jumped, self.begin = math.nan, "", 0.0

    def start(self) -> None:
        """Count from now on."""
        self.begin += self.now

    @property
    def now(self) -> float:
        """Time since the start [s]."""
        return (self.simulated if self.is_simulated else clock.monotonic()) - self.begin

    @property
    def by_ros(self) -> float:
        """The time of ROS 2 [s]: the wall clock's, or the simulator's; 0 before the simulator told it."""
        by = self.simulated if self.is_simulated else clock.time()
        return 0.0 if math.isnan(by) else by

    def tick(self, message: Any) -> None:
        """Take the time of a simulator, a `rosgraph_msgs/Clock`."""
        told = seconds(message.clock)
        step = 0.0 if math.isnan(self.simulated) else told - self.simulated
        if step < 0.0 or step > self.settings.jump:
            self.jumped = f"/clock jumped by {step:+.3g} s at {self.simulated:.3f} s"
            self.begin += step
        self.simulated = told

    def since(self, stamp: Any) -> float:
        """Time since the moment that a motion's stamp says; 0 for none, which is now [s]."""
        none = stamp.sec == 0 and stamp.nanosec == 0
        return 0.0 if none else min(max(self.by_ros - seconds(stamp), -3600.0), 1e6)

    def measured(self, stamp: Any, oldest: float) -> float | str:
        """When something was measured, in the node's time [s]; a text where its stamp cannot be.

        Args:
            stamp: Of the message; 0 for none.
            oldest: Age from which on it is refused [s].
        """
        if self.settings.stamps == "ignore" or (stamp.sec == 0 and stamp.nanosec == 0):
            return self.now
        age = self.by_ros - seconds(stamp)
        if not -self.settings.ahead <= age <= oldest:
            how = f"{age:.3g} s old" if age > 0 else f"{-age:.3g} s in the future"
            return f"its stamp is {how}: synchronise the clocks, or set clock.stamps to ignore"
        return self.now - max(age, 0.0)


class Tree:
    """Frames in the plane, by `/tf` and `/tf_static`."""

    def __init__(self) -> None:
        self.parents: dict[str, tuple[str, Planar, float]] = {}
        self.version = 0

    def take(self, message: Any, when: float) -> str:
        """Read transforms; those that are not finite are refused."""
        for one in message.transforms:
            there = planar(one.transform.translation, one.transform.rotation)
            if isinstance(there, str):
                return f"{one.child_frame_id}: {there}"
            self.parents[one.child_frame_id.lstrip("/")] = one.header.frame_id.lstrip("/"), there, when
        self.version += 1
        return ""

    def between(self, above: str, below: str) -> tuple[Planar, float] | None:
        """Pose of one frame in another, and when its youngest part was told; None where nothing connects them."""
        up, down = self._line(above), self._line(below)
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            return None
        (a, _), (b, when) = up[common], down[common]
        return composed(inverse(a), b), when

    def _line(self, frame: str) -> dict[str, tuple[Planar, float]]:
        """The frames above one, with its pose in each of them."""
        found, here, when = {frame: (STILL, -math.inf)}, STILL, -math.inf
        while frame in self.parents and self.parents[frame][0] not in found:
            frame, step, told = self.parents[frame]
            here, when = composed(step, here), max(when, told)
            found[frame] = here, when
        return found


class Sensing:
    """The measurement of one robot, out of messages of its joints and of its base.

    Args:
        robot: The robot.
        settings: Names, frames and limits.
        tree: Frames.

    Raises:
        ConfigError: A name for a joint that the robot does not have.
    """

    def __init__(self, robot: Robot, settings: Node, tree: Tree) -> None:
        self.robot, self.settings, self.tree, d = robot, settings, tree, robot.dimensions
        names = settings.joint_states.theirs
        for name in names:
            known = dict.fromkeys((*robot.actuator_names, *robot.base.shape))
            if name not in known:
                fix = f"name joints with a motor: {', '.join(known)}"
                raise ConfigError(f"no joint '{name}'", fix=fix, key="joint_states.names")
        by_wheels = bool(d.base) and settings.odometry.source == "tf"
        driven = tuple(wheel.joint for wheel in robot.base.wheels if wheel.driven)
        self.wheels = (driven if robot.steers else robot.actuator_names[: d.motors - d.arm]) if by_wheels else ()
        self.names = [names.get(name, name) for name in (*robot.joint_names, *robot.base.shape, *self.wheels)]
        by_twist = by_wheels and not robot.steers
        self.rolled = np.linalg.pinv(robot.E[: d.base, : len(self.wheels)].T) if by_twist else np.zeros((d.base, 0))
        self.known: list[str] = []
        self.places = np.full(len(self.names), -1)
        self.heard = np.full(len(self.names), -math.inf)
        self.q, self.qdot = np.zeros(len(self.names)), np.zeros(len(self.names))
        self.at: Planar | None = settings.odometry.at if d.base else STILL
        self.pose, self.velocity, self.placed = np.zeros(d.pose), np.zeros(d.twist), -math.inf
        self.is_new = False

    @property
    def when(self) -> float:
        """When the oldest part of the measurement was measured [s]; -inf where a part has never come."""
        base = self.placed if self.robot.dimensions.base else math.inf
        return float(min(base, self.heard.min(initial=math.inf)))

    def measurement(self, direction: Array = ANY) -> Measurement | None:
        """The measurement with all that came since the last call; None where nothing did, or a part has never come.

        Args:
            direction: (3,) of u, `Stepper.direction`.
        """
        if not self.is_new or self.when == -math.inf:
            return None
        self.is_new, n, K = False, self.robot.dimensions.arm, self.robot.dimensions.shape
        velocity, base = self.velocity, self.robot.base
        if isinstance(base, SteeredBase):
            velocity, m = base.velocity_along(self._maps(direction), self.velocity).copy(), len(base.masters)
            velocity[velocity.size - m :] = self.qdot[n + np.array(base.masters, int)]
        return Measurement(self.pose, velocity, self.q[:n], self.qdot[:n], self.q[n : n + K])

    def _maps(self, direction: Array) -> Maps:
        """The maps of a base that steers at its measured angles."""
        robot, n, d = self.robot, self.robot.dimensions.arm, self.robot.dimensions
        assert robot.rolling is not None
        maps, position = new_maps(robot.rolling, robot.template), robot.rest.copy()
        maps.n[:], position[robot.shape_index] = direction, self.q[n : n + d.shape]
        roll(robot.rolling, position, np.zeros(d.dof), maps)
        return maps

    def _rolled(self) -> Array:
        """The twist by the rates of the wheels, and of what steers them."""
        robot, d = self.robot, self.robot.dimensions
        if not robot.steers:
            return self.rolled @ self.qdot[d.arm :]
        maps = self._maps(ANY)
        rows = [*robot.shape_index, *(robot.rows[name] for name in self.wheels)]
        velocity = np.linalg.pinv(maps.T[rows, : d.base]) @ self.qdot[d.arm :]
        return (maps.V[0] @ velocity)[robot.base.columns]

    def shift(self, by: float) -> None:
        """Count time from a later moment [s]."""
        self.heard -= by
        self.placed -= by

    def lacking(self, now: float) -> str:
        """Which parts of the measurement have not come for longer than their age allows; empty for none."""
        late = [
            name
            for name, heard in zip(self.names, self.heard, strict=True)
            if now - heard > self.settings.joint_states.age
        ]
        parts = [f"joints {', '.join(late)}"] if late else []
        if self.robot.dimensions.base and now - self.placed > self.settings.odometry.age:
            parts.append("the pose of the base")
        return " and ".join(parts)

    def take_joints(self, message: Any, when: float) -> str:
        """Read joints by their names, whatever their order; one that is missing stays as it was, and gets older."""
        if len(message.position) != len(message.name):
            return f"{len(message.position)} positions for {len(message.name)} joints"
        if list(message.name) != self.known:
            if len(set(message.name)) < len(message.name):
                return "a joint appears twice"
            at = {name: i for i, name in enumerate(message.name)}
            self.known, self.places = list(message.name), np.array([at.get(name, -1) for name in self.names], int)
        here = self.places >= 0
        if not here.any():
            return ""
        if len(message.velocity) != len(message.name):
            fix = "let the robot's broadcaster tell them"
            return f"{len(message.velocity)} velocities for {len(message.name)} joints: {fix}"
        q, qdot = np.asarray(message.position)[self.places[here]], np.asarray(message.velocity)[self.places[here]]
        if not ((np.abs(q) < LARGEST) & (np.abs(qdot) < LARGEST)).all():
            return "a position or a velocity is not finite"
        if when < self.heard[here].max():
            return "it is older than the one before"
        self.q[here], self.qdot[here], self.heard[here], self.is_new = q, qdot, when, True
        return self._take_pose() if self.wheels else ""

    def take_base(self, message: Any, when: float) -> str:
        """Read pose and velocity of the base."""
        there = planar(message.pose.pose.position, message.pose.pose.orientation)
        if isinstance(there, str):
            return there
        twist = message.twist.twist
        given = twist.linear.x, twist.linear.y, twist.angular.z
        if not all(abs(value) < LARGEST for value in given):
            return "a velocity is not finite"
        if when < self.placed:
            return "it is older than the one before"
        if self.at is None:
            self.at = control_frame(self.robot, message.child_frame_id.lstrip("/"))
        x, y, turn = self.at
        vx, vy, w = given[0] - given[2] * y, given[1] + given[2] * x, given[2]
        c, s = math.cos(turn), math.sin(turn)
        forward, sideways = c * vx + s * vy, c * vy - s * vx
        velocity = (forward, sideways, w) if self.robot.dimensions.sideways else (forward, w)
        return self._place(composed(there, self.at), np.array(velocity), when)

    def _take_pose(self) -> str:
        """The pose by `/tf`, the velocity by the wheels."""
        found = self.tree.between(self.settings.tf.odom, self.settings.tf.base)
        if found is None or found[1] <= self.placed:
            return ""
        if self.at is None:
            self.at = control_frame(self.robot, self.settings.tf.base)
        return self._place(composed(found[0], self.at), self._rolled(), found[1])

    def _place(self, there: Planar, velocity: Array, when: float) -> str:
        """Take a pose unless it jumps; its heading goes on without turning over."""
        dt = when - self.placed if self.placed > -math.inf else 0.0
        ahead = dt * self.velocity[-1] if dt > 0.0 else 0.0
        heading = nearest_turn(there[2], self.pose[2] + min(max(ahead, -FARTHEST), FARTHEST))
        if self.placed > -math.inf:
            step, turn = math.hypot(there[0] - self.pose[0], there[1] - self.pose[1]), abs(heading - self.pose[2])
            speed, odometry = 2.0 * max(np.abs(velocity).max(), np.abs(self.velocity).max()), self.settings.odometry
            if step > odometry.jump + speed * dt or turn > odometry.turn + speed * dt:
                return f"the pose jumps by {step:.3g} m and {turn:.3g} rad in {1e3 * dt:.3g} ms"
        self.pose[:], self.velocity[:] = (there[0], there[1], heading), velocity
        self.placed, self.is_new = when, True
        return ""


def control_frame(robot: Robot, link: str) -> Planar:
    """The control frame in a link that moves with the root.

    Raises:
        ConfigError: The URDF has no such link, or it moves.
    """
    key = "odometry.at"
    fix = "give odometry.at = [x, y, phi], the control frame (middle of the drive axle, x ahead) in that frame"
    if not robot.model.existBodyName(link):
        raise ConfigError(f"the frame '{link}' is no link of the URDF", fix=fix, key=key)
    frame = robot.model.frames[robot.model.getFrameId(link)]
    if frame.parentJoint > 1:
        raise ConfigError(f"the frame '{link}' moves against the base", fix=fix, key=key)
    placement: pin.SE3 = frame.placement
    turn = math.atan2(placement.rotation[1, 0], placement.rotation[0, 0])
    root: Planar = (float(robot.frame[0]), float(robot.frame[1]), float(robot.frame[2]))
    return composed(inverse((placement.translation[0], placement.translation[1], turn)), root)


def of_frame(at: Planar, pose: Array, velocity: Array) -> tuple[Planar, Array]:
    """Pose of the frame in which the control frame lies at a place, and its velocity in itself, (3,).

    Args:
        at: The control frame in that frame.
        pose: (3,) of the control frame.
        velocity: (twist,) of the control frame, in itself.
    """
    x, y, turn = inverse(at)
    v, aside, w = velocity[0], velocity[1] if velocity.size == 3 else 0.0, velocity[-1]
    along, across, c, s = v - w * y, aside + w * x, math.cos(turn), math.sin(turn)
    own = np.array([c * along + s * across, c * across - s * along, w])
    return composed((float(pose[0]), float(pose[1]), float(pose[2])), (x, y, turn)), own


def planar(position: Any, turned: Any) -> Planar | str:
    """Place and heading in the plane; a text where that is no pose."""
    x, y, z, w = quaternion(turned)
    length = x * x + y * y + z * z + w * w
    if not (abs(position.x) < LARGEST and abs(position.y) < LARGEST and 0.98 < length < 1.02):
        finite = math.isfinite(position.x) and math.isfinite(position.y) and math.isfinite(length)
        return "a quaternion that is none" if finite else "a pose that is not finite"
    return position.x, position.y, math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def quaternion(turned: Any) -> tuple[float, float, float, float]:
    """The numbers of a `geometry_msgs/Quaternion`, `(x, y, z, w)`."""
    return turned.x, turned.y, turned.z, turned.w


def composed(a: Planar, b: Planar) -> Planar:
    """Pose b, given in the frame a, in a's parent."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2]


def inverse(a: Planar) -> Planar:
    """Pose of the parent in the frame a."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return -c * a[0] - s * a[1], s * a[0] - c * a[1], -a[2]


def wrapped(angle: float) -> float:
    """An angle in (-pi, pi]."""
    return math.remainder(angle, math.tau)


def seconds(stamp: Any) -> float:
    """Seconds of a stamp or a duration."""
    return stamp.sec + NANO * stamp.nanosec
