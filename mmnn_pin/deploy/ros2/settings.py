"""One TOML file that says what the node listens to, what it sends, and what it takes for wrong."""

from __future__ import annotations

import re
from typing import Any, Literal

import msgspec
import numpy as np

from ...errors import ConfigError
from ...loop.latency import Latency
from ...reference.limits import Limits
from ...settings import Settings, require_numbers

NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
MULTI_ARRAY, TRAJECTORY, TWIST, TWIST_STAMPED = "Float64MultiArray", "JointTrajectory", "Twist", "TwistStamped"


class Network(Settings, frozen=True):
    """Where the node speaks.

    Args:
        domain: `ROS_DOMAIN_ID`.
        interface: Name or address of the one network interface that is used.
        peers: Addresses to look for, and the only ones to listen to. No multicast is used.
        namespace: Of relative topic names.
        largest: Larger messages are refused [bytes].
        participants: How many processes with DDS a peer may have.
        config: More settings of Cyclone DDS, XML inside `<Domain>`, such as `<Security>`.

    Raises:
        ConfigError: A domain beyond 232, a number that is not positive.
    """

    domain: int = 0
    interface: str = "lo"
    peers: tuple[str, ...] = ("127.0.0.1",)
    namespace: str = ""
    largest: int = 1_000_000
    participants: int = 30
    config: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.domain <= 232:
            raise ConfigError(f"{self.domain}", fix="use 0 to 232, as ROS_DOMAIN_ID", key="network.domain")
        if not (self.largest > 0 and 0 < self.participants <= 119):
            key = "network.largest" if self.largest <= 0 else "network.participants"
            raise ConfigError("out of range", fix="use more than 0, of participants up to 119", key=key)
        if not self.peers:
            raise ConfigError("no peers", fix='name those that may speak, e.g. ["127.0.0.1"]', key="network.peers")


class Clocks(Settings, frozen=True):
    """Clocks.

    Args:
        source: "steady", the machine's clock that never jumps, or "sim": the topic `/clock` of a simulator.
        stamps: "check" the age of what has a stamp, or "ignore" them: what comes is taken as measured when it came.
        ahead: How far a stamp may lie in the future [s].
        jump: By how much a simulated clock may go ahead at once [s].

    Raises:
        ConfigError: A number that is negative or not finite.
    """

    source: Literal["steady", "sim"] = "steady"
    stamps: Literal["check", "ignore"] = "check"
    ahead: float = 0.02
    jump: float = 0.5

    def __post_init__(self) -> None:
        require_numbers(self, "clock", {"jump"})


class Topic(Settings, frozen=True):
    """A topic and its quality of service.

    Args:
        topic: Its name; one that does not begin with / gets the namespace.
        reliability: "reliable", or "best_effort", which hears both kinds of writers.
        depth: How many messages are kept.
        age: Oldest stamp that is taken [s].
        publishers: How many may send on it at a time; messages of further ones are dropped.

    Raises:
        ConfigError: A name that ROS 2 does not know, a number that is not positive.
    """

    topic: str
    reliability: Literal["reliable", "best_effort"] = "best_effort"
    depth: int = 4
    age: float = 0.2
    publishers: int = 1

    def __post_init__(self) -> None:
        if not NAME.fullmatch(self.topic):
            fix = "use letters, digits and _, parts joined by /"
            raise ConfigError(f"'{self.topic}' is no name of a topic", fix=fix, key="topic")
        for name in ("depth", "age", "publishers"):
            if not 0 < getattr(self, name) < 1e6:
                raise ConfigError(f"{getattr(self, name)}", fix="use a number > 0", key=name)


class Joints(Topic, frozen=True):
    """`sensor_msgs/JointState`.

    Args:
        names: How the robot calls joints that have another name in its URDF, `urdf = "theirs"`.
    """

    topic: str = "joint_states"
    names: dict[str, str] = msgspec.field(default_factory=dict)


class Base(Topic, frozen=True):
    """`nav_msgs/Odometry`.

    Args:
        pose: "odometry": pose and velocity of the message; "tf": the pose of `/tf` and velocities from the wheels'
            rates, nothing of this topic.
        at: Control frame in the frame whose pose comes, `(x, y, phi)`; None looks that link up in the URDF [m, rad].
        jump: Largest step of the pose between two messages beside what the velocity explains [m].
        turn: Likewise of the heading [rad].
    """

    topic: str = "odom"
    pose: Literal["odometry", "tf"] = "odometry"
    at: tuple[float, float, float] | None = None
    jump: float = 0.2
    turn: float = 0.3

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("jump", "turn"):
            if not 0 < getattr(self, name) < np.inf:
                raise ConfigError(f"{getattr(self, name)}", fix="use a number > 0", key=name)
        if self.at is not None and not np.isfinite(self.at).all():
            raise ConfigError(f"{self.at}", fix="give finite numbers", key="at")


class Frames(Topic, frozen=True):
    """`/tf`, for poses by it and for paths in the frame of a map.

    Args:
        map: The frame of the map.
        odom: The frame in which the robot is controlled, which never jumps.
        base: The frame of the robot.
        replace: A correction of the map from which on a path is put anew [m, rad].
    """

    topic: str = "/tf"
    depth: int = 20
    publishers: int = 8
    age: float = 1.0
    map: str = "map"
    odom: str = "odom"
    base: str = "base_footprint"
    replace: float = 0.02


class Velocity(Topic, frozen=True):
    """`geometry_msgs/Twist` of a joystick or of a navigation stack.

    Args:
        stamped: Whether it is a `TwistStamped`.
    """

    topic: str = "cmd_vel"
    reliability: Literal["reliable", "best_effort"] = "reliable"
    stamped: bool = False


class JointMotions(Topic, frozen=True):
    """`trajectory_msgs/JointTrajectory` of a planner, without an answer."""

    topic: str = "arm_controller/joint_trajectory"
    reliability: Literal["reliable", "best_effort"] = "reliable"


class Action(Settings, frozen=True):
    """The action `control_msgs/FollowJointTrajectory`, which MoveIt sends.

    Args:
        name: Of the action.
        path_tolerance: Largest error of a joint on the way where a goal states none; 0 for none [rad or m].
        goal_tolerance: Largest error at the end likewise.
        goal_time: Time after the end in which the goal has to be reached, likewise [s].
        rate: Of the feedback [1/s].
        keep: Time that a result is kept [s].

    Raises:
        ConfigError: A number that is negative or not finite.
    """

    name: str = "arm_controller/follow_joint_trajectory"
    path_tolerance: float = 0.0
    goal_tolerance: float = 0.05
    goal_time: float = 1.0
    rate: float = 20.0
    keep: float = 300.0

    def __post_init__(self) -> None:
        require_numbers(self, "action", {"rate"})


class Route(Topic, frozen=True):
    """`nav_msgs/Path` of a planner, driven along its arc length.

    Args:
        speed: [m/s].
        acceleration: Along the path [m/s^2].
        lateral: Largest sideways acceleration [m/s^2].
    """

    topic: str = "plan"
    reliability: Literal["reliable", "best_effort"] = "reliable"
    speed: float = 0.3
    acceleration: float = 0.3
    lateral: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("speed", "acceleration", "lateral"):
            if not 0 < getattr(self, name) < np.inf:
                raise ConfigError(f"{getattr(self, name)}", fix="use a number > 0", key=name)


class Output(Settings, frozen=True):
    """Commands for one of the robot's controllers.

    Args:
        topic: Its topic.
        type: "Float64MultiArray" of group and forward command controllers, "JointTrajectory" (one point) of
            `joint_trajectory_controller`, "TwistStamped" or "Twist" of a base's (`diff_drive_controller`).
        joints: In the order in which the controller lists them, as the robot calls them; none for a twist.
        interface: What it takes: "effort", "velocity" or "position".
        frame: `frame_id` of a stamped twist.
        reliability: As in `Topic`.
        depth: Likewise.

    Raises:
        ConfigError: Joints of a twist, none of anything else, an effort by a trajectory.
    """

    topic: str
    type: Literal["Float64MultiArray", "JointTrajectory", "TwistStamped", "Twist"] = "Float64MultiArray"
    joints: tuple[str, ...] = ()
    interface: Literal["effort", "velocity", "position"] = "effort"
    frame: str = "base_link"
    reliability: Literal["reliable", "best_effort"] = "reliable"
    depth: int = 1

    def __post_init__(self) -> None:
        Topic(self.topic, depth=self.depth)
        if self.is_twist == bool(self.joints):
            fix = "leave joints out" if self.is_twist else "list them as the controller's `joints` does"
            raise ConfigError(f"a {self.type} with {len(self.joints)} joints", fix=fix, key="joints")
        if self.type == TRAJECTORY and self.interface != "position":
            why, fix = "its points are positions", 'say interface = "position"'
            raise ConfigError(f"{self.interface} by a JointTrajectory", why=why, fix=fix, key="interface")
        if len(set(self.joints)) < len(self.joints):
            raise ConfigError("a joint appears twice", fix="list each once", key="joints")

    @property
    def is_twist(self) -> bool:
        """Whether it is the velocity of the base."""
        return self.type in (TWIST, TWIST_STAMPED)


class Switches(Settings, frozen=True):
    """Services `std_srvs/Trigger`. With them the node stays after a trip and waits for a call.

    Args:
        stop: An emergency stop.
        reset: Goes on after a trip: the robot holds where it is, and what was learned stays.

    Raises:
        ConfigError: A name that ROS 2 does not know, or one for both.
    """

    stop: str = "mmnn/stop"
    reset: str = "mmnn/reset"

    def __post_init__(self) -> None:
        for name in (self.stop, self.reset):
            Topic(name)
        if self.stop == self.reset:
            raise ConfigError(f"'{self.stop}' for both", fix="give each its own name", key="switches.reset")


class Diagnostics(Settings, frozen=True):
    """`diagnostic_msgs/DiagnosticArray`, for PlotJuggler and Foxglove.

    Args:
        topic: Its name.
        rate: [1/s].
    """

    topic: str = "/diagnostics"
    rate: float = 10.0

    def __post_init__(self) -> None:
        Topic(self.topic)
        require_numbers(self, "diagnostics", {"rate"})


class Node(Settings, frozen=True):
    """All of the file.

    Args:
        robot: Name or URDF file.
        commands: What is sent, to all motors.
        controller: Name of a controller, see `mmnn list`.
        experiment: Experiment with gains, learners and the supervisor's limits, name or file.
        set: Its keys that are changed, tables in tables.
        rate: Control samples per second.
        latency: Known delay from the measurement to the motors, which the gains have to bear [s]; None as the
            experiment says.
        predict: Whether measurements are moved on as the reference has moved since their stamps; None likewise.
        setpoint_timeout: Age of a velocity at which the base brakes [s].
        follow: "topics", or "experiment": its own motion, from where the robot stands.
        network: Where it speaks.
        clock: Clocks.
        limits: Limits of references that are made on the way.
        joint_states: The joints.
        odometry: The base; left out for a fixed arm.
        tf: Frames.
        velocity: Of the base; None listens to none. Likewise the following.
        trajectory: Motions of the arm.
        action: Motions of the arm with an answer.
        path: Of the base.
        switches: Services that stop and reset; None for none, and the node ends after a trip.
        diagnostics: What is published of the node itself.

    Raises:
        ConfigError: A number that is not positive, no commands.
    """

    robot: str
    commands: tuple[Output, ...]
    controller: str = "pd"
    experiment: str = "track"
    set: dict[str, Any] = msgspec.field(default_factory=dict)
    rate: float = 200.0
    latency: float | None = None
    predict: bool | None = None
    setpoint_timeout: float = 0.5
    follow: Literal["topics", "experiment"] = "topics"
    network: Network = Network()
    clock: Clocks = Clocks()
    limits: Limits = Limits()
    joint_states: Joints = Joints()
    odometry: Base = Base()
    tf: Frames | None = None
    velocity: Velocity | None = None
    trajectory: JointMotions | None = None
    action: Action | None = None
    path: Route | None = None
    switches: Switches | None = None
    diagnostics: Diagnostics | None = Diagnostics()

    def __post_init__(self) -> None:
        if not self.commands:
            raise ConfigError(
                "no commands", fix="give a table [[commands]] per controller of the robot", key="commands"
            )
        if not 1 <= self.rate <= 2000:
            raise ConfigError(f"{self.rate} /s", fix="use 1 to 2000", key="rate")
        for name in ("latency", "setpoint_timeout"):
            if not 0 <= (getattr(self, name) or 0.0) < 10:
                raise ConfigError(f"{getattr(self, name)} s", fix="use 0 to 10", key=name)
        if self.odometry.pose == "tf" and self.tf is None:
            raise ConfigError("poses by /tf without frames", fix="give a table [tf]", key="odometry.pose")

    def latency_of(self, own: Latency) -> Latency:
        """The latency of an experiment with what these settings say: its `margin` stays."""
        predict = own.predict if self.predict is None else self.predict
        if self.latency is None:
            return msgspec.structs.replace(own, predict=predict)
        return msgspec.structs.replace(Latency.of(self.latency, predict), margin=own.margin)

    @property
    def changes(self) -> list[str]:
        """The changes of the experiment as `key.path=value` texts, values as in TOML."""
        return [f"{key}={msgspec.json.encode(value).decode()}" for key, value in leaves(self.set)]


def leaves(table: dict[str, Any], before: str = "") -> list[tuple[str, Any]]:
    """Key paths and values of a table in tables."""
    found = []
    for key, value in table.items():
        found += leaves(value, f"{before}{key}.") if isinstance(value, dict) else [(f"{before}{key}", value)]
    return found
