"""Parameters of the node: what it controls, what it listens to, what it sends, and what it takes for wrong.

Topics, services and the action have fixed names, which ROS 2 remaps; their quality of service is overridden likewise.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal

import msgspec
import numpy as np

from ...errors import ConfigError, UnknownName
from ...loop.latency import Latency
from ...reference.limits import Limits
from ...settings import LARGEST, Settings
from ...settings.arguments import unknown_key, wrong_type

TRAJECTORY: Final = "JointTrajectory"
TWIST: Final = "Twist"
TWIST_STAMPED: Final = "TwistStamped"
ACKERMANN: Final = "AckermannDriveStamped"
Interface = Literal["effort", "velocity", "position"]
BOUNDS = (  # of numbers, with their units
    ("rate", 1, 2000, " /s"), ("thread_priority", 0, 99, ""), ("speed_scaling", 0, 1, ""), ("latency", 0, 10, " s"),
    ("setpoint_timeout", 0, 10, " s"),
)  # fmt: skip
FREE = ("set", "commands")  # tables whose keys are the user's
LIVE = ("limits.", "set.", "learning", "speed_scaling")  # what may be changed while the node is configured


def require_positive(settings: Settings, *names: str) -> None:
    """Refuse fields whose number is not positive, or not finite.

    Raises:
        ConfigError: With the first of them.
    """
    for name in names:
        if not 0.0 < getattr(settings, name) < LARGEST:
            raise ConfigError(f"{getattr(settings, name)}", fix="use a number > 0", key=name)


class Heard(Settings, frozen=True):
    """A topic that is listened to.

    Args:
        age: Largest age of a message by its stamp [s]; older ones are refused.
        publishers: How many publishers the topic may have; messages of others are refused.

    Raises:
        ConfigError: A number that is not positive.
    """

    age: float = 0.2
    publishers: int = 1

    def __post_init__(self) -> None:
        require_positive(self, "age", "publishers")


class Joints(Heard, frozen=True):
    """`sensor_msgs/JointState`.

    Args:
        names: The robot's names of joints that have another name in its URDF, "urdf=theirs".

    Raises:
        ConfigError: A text without `=`.
    """

    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if wrong := [text for text in self.names if not all(text.partition("="))]:
            raise ConfigError(f"'{wrong[0]}'", fix='write "urdf=theirs"', key="names")

    @property
    def theirs(self) -> dict[str, str]:
        """The robot's names by those of the URDF."""
        return {own: name for own, _, name in (text.partition("=") for text in self.names)}


class Odometry(Heard, frozen=True):
    """`nav_msgs/Odometry`.

    Args:
        source: "odometry" takes pose and velocity of the message; "tf" takes the pose of `/tf` and velocities from the
            wheels' rates, and nothing of this topic.
        at: Control frame in the frame whose pose is sent, `(x, y, phi)`; none looks that link up in the URDF [m, rad].
        jump: Largest step of the pose between two messages beyond what the velocity explains [m].
        turn: Largest step of the heading, likewise [rad].

    Raises:
        ConfigError: A number that is not positive, or not finite.
    """

    source: Literal["odometry", "tf"] = "odometry"
    at: tuple[float, float, float] | None = None
    jump: float = 0.2
    turn: float = 0.3

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "jump", "turn")
        if self.at is not None and not np.isfinite(self.at).all():
            raise ConfigError(f"{self.at}", fix="give finite numbers", key="at")


class Frames(Settings, frozen=True):
    """Frames of `/tf`, for poses by it and for paths in the frame of a map.

    Args:
        map: The frame of the map.
        odom: The frame in which the robot is controlled, which never jumps.
        base: The frame of the robot.
        replace: Smallest correction of the map after which a path is placed again [m, rad].
    """

    map: str = "map"
    odom: str = "odom"
    base: str = "base_footprint"
    replace: float = 0.02


class Velocity(Heard, frozen=True):
    """`geometry_msgs/Twist` of a joystick or of a navigation stack.

    Args:
        stamped: Whether it is a `TwistStamped`.
    """

    stamped: bool = False


class Action(Settings, frozen=True):
    """The action `control_msgs/FollowJointTrajectory`, which MoveIt sends.

    Args:
        path_tolerance: Largest error of a joint during a goal that states none; 0 for no limit [rad or m].
        goal_tolerance: Largest error of a joint at the end, likewise [rad or m].
        stopped_velocity: Largest velocity at the end, likewise [rad/s or m/s].
        goal_time: Time after the end in which the goal has to be reached, likewise; 0 for no limit [s].
        smooth: Largest distance at which a base may pass points of a goal to which its wheels cannot roll; 0 refuses
            such a goal [m].
        rate: Rate of the feedback [1/s].

    Raises:
        ConfigError: A number that is negative or not finite.
    """

    path_tolerance: float = 0.0
    goal_tolerance: float = 0.05
    stopped_velocity: float = 0.1
    goal_time: float = 1.0
    smooth: float = 0.0
    rate: float = 20.0

    def __post_init__(self) -> None:
        require_positive(self, "rate")


class PlannedPath(Heard, frozen=True):
    """`nav_msgs/Path` of a planner, and that of `nav2_msgs/FollowPath`, driven along its arc length.

    Args:
        speed: Largest speed along the path [m/s].
        acceleration: Largest acceleration along the path [m/s^2].
        lateral: Largest lateral acceleration [m/s^2].
        goal_tolerance: Distance from the path's end at which the action has succeeded [m].
        goal_turn: Heading error at which it has succeeded [rad].
        goal_time: Time after the end in which it has to succeed [s].
    """

    speed: float = 0.3
    acceleration: float = 0.3
    lateral: float = 0.5
    goal_tolerance: float = 0.1
    goal_turn: float = 0.1
    goal_time: float = 2.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "speed", "acceleration", "lateral")


class HandTopics(Heard, frozen=True):
    """Setpoints of the hand: `~/hand/pose`, `~/hand/twist`; where it gives way `~/hand/stiffness`, `~/hand/force`.

    Args:
        listen: Whether the node subscribes to them; none for only if the experiment has `[impedance]`.
        turns: Whether the hand follows the orientation, too.
        speed: Largest speed of the hand [m/s].
        turning: Largest turning rate of the hand [rad/s].

    Raises:
        ConfigError: A number that is not positive.
    """

    listen: bool | None = None
    turns: bool = False
    speed: float = 0.25
    turning: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "speed", "turning")


class Output(Settings, frozen=True):
    """Commands for one of the robot's controllers.

    Args:
        type: "Float64MultiArray" for group and forward command controllers, "JointTrajectory" (one point) for
            `joint_trajectory_controller`, "TwistStamped" or "Twist" for a base (`diff_drive_controller`),
            "AckermannDriveStamped" for a car: speed and steering angle, to be reached as fast as it can.
        joints: The controller's joints in its order, by the robot's names; none for a base.
        interface: What the controller takes: "effort", "velocity" or "position".
        frame: `frame_id` of messages with a stamp.

    Raises:
        ConfigError: Joints of a base's, none of anything else, an effort by a trajectory.
    """

    type: Literal["Float64MultiArray", "JointTrajectory", "TwistStamped", "Twist", "AckermannDriveStamped"] = (
        "Float64MultiArray"
    )
    joints: tuple[str, ...] = ()
    interface: Interface = "effort"
    frame: str = "base_link"

    def __post_init__(self) -> None:
        if self.is_base == bool(self.joints):
            fix = "leave joints out" if self.is_base else "list them as the controller's `joints` does"
            raise ConfigError(f"a {self.type} with {len(self.joints)} joints", fix=fix, key="joints")
        if self.type == TRAJECTORY and self.interface != "position":
            why, fix = "its points are positions", 'say interface = "position"'
            raise ConfigError(f"{self.interface} by a JointTrajectory", why=why, fix=fix, key="interface")
        if len(set(self.joints)) < len(self.joints):
            raise ConfigError("a joint appears twice", fix="list each once", key="joints")

    @property
    def is_base(self) -> bool:
        """Whether it is the velocity of the base."""
        return self.type in (TWIST, TWIST_STAMPED, ACKERMANN)


class Clocks(Settings, frozen=True):
    """Stamps of messages.

    Args:
        stamps: "check" the age of messages with a stamp, or "ignore" stamps and take the time of arrival.
        ahead: How far a stamp may lie in the future [s].
        jump: Largest step of a simulated clock [s].

    Raises:
        ConfigError: A number that is negative or not finite.
    """

    stamps: Literal["check", "ignore"] = "check"
    ahead: float = 0.02
    jump: float = 0.5

    def __post_init__(self) -> None:
        require_positive(self, "jump")


class Published(Settings, frozen=True):
    """Topics of the robot's state, as `joint_trajectory_controller` and `diff_drive_controller` have them.

    Args:
        state: How often `~/controller_state` is published; 0 for never [1/s].
        odometry: How often the measured `~/odom` is published; 0 for never [1/s].
        tf: Whether the base's frame in the odometry's is published on `/tf`.
    """

    state: float = 50.0
    odometry: float = 0.0
    tf: bool = False


class Node(Settings, frozen=True):
    """All parameters.

    Args:
        robot: Name or URDF file.
        commands: The commands for all motors, by the names of the robot's controllers.
        controller: Name of a controller, see `mmnn list`.
        experiment: Experiment with gains, learners and the supervisor's limits, name or file.
        hardware: The robot's hardware, a profile or a file, see `mmnn list`; empty for the table beside the URDF.
        set: Changes to the experiment's keys, tables in tables.
        learning: Whether the controller learns; live.
        rate: Control samples per second.
        thread_priority: Priority of the control thread among real-time threads (SCHED_FIFO), like ros2_control's
            controller manager, if the user may have it (`rtprio`); 0 for an ordinary thread [0 to 99].
        latency: Known delay from the measurement to the motors [s], for which gains are checked; none as the experiment
            says.
        predict: Whether measurements are moved on by the reference's motion since their stamps; none likewise.
        setpoint_timeout: Age of a velocity at which the base brakes [s].
        speed_scaling: Share of their own speed at which motions are followed, until another comes; live [0 to 1].
        follow: "topics", or "experiment": its own motion, from where the robot stands.
        end_after_trip: Whether the process ends after a trip; else it waits for a reset.
        clock: Stamps.
        limits: Limits of references that are made on the way.
        joint_states: The joints.
        odometry: The base.
        tf: Frames.
        velocity: Velocities of the base that are asked for.
        trajectory: Motions of the arm that are asked for by a topic, without an answer.
        action: Motions that are asked for by the action.
        path: Paths of the base that are asked for.
        hand: Places and velocities of the hand that are asked for, and its stiffness.
        diagnostics: How often the node tells of itself; 0 for never [1/s].
        publish: Topics of the robot's state.

    Raises:
        ConfigError: A number that is not positive, no robot, no commands.
    """

    robot: str = ""
    commands: dict[str, Output] = msgspec.field(default_factory=dict)
    controller: str = "pd"
    experiment: str = "track"
    hardware: str = ""
    set: dict[str, Any] = msgspec.field(default_factory=dict)
    learning: bool = True
    rate: float = 200.0
    thread_priority: int = 50
    latency: float | None = None
    predict: bool | None = None
    setpoint_timeout: float = 0.5
    speed_scaling: float = 1.0
    follow: Literal["topics", "experiment"] = "topics"
    end_after_trip: bool = False
    clock: Clocks = Clocks()
    limits: Limits = Limits()
    joint_states: Joints = Joints()
    odometry: Odometry = Odometry()
    tf: Frames = Frames()
    velocity: Velocity = Velocity()
    trajectory: Heard = Heard()
    action: Action = Action()
    path: PlannedPath = PlannedPath()
    hand: HandTopics = HandTopics()
    diagnostics: float = 10.0
    publish: Published = Published()

    def __post_init__(self) -> None:
        if not (self.robot and self.commands):
            what, key = ("no commands", "commands") if self.robot else ("no robot", "robot")
            raise ConfigError(what, fix="mmnn ros2 --example FOLDER --robot ROBOT writes a file to start from", key=key)
        for name, least, most, unit in BOUNDS:
            if (value := getattr(self, name)) is not None and not least <= value <= most:
                raise ConfigError(f"{value}{unit}", fix=f"use {least} to {most}", key=name)

    def latency_of(self, own: Latency) -> Latency:
        """The latency of an experiment with what these settings say: its `margin` stays."""
        predict = own.predict if self.predict is None else self.predict
        if self.latency is None:
            return msgspec.structs.replace(own, predict=predict)
        return msgspec.structs.replace(Latency.of(self.latency, predict), margin=own.margin)

    @property
    def changes(self) -> list[str]:
        """The changes of the experiment as `key.path=value` texts, values as in TOML."""
        own = [("learning.learning", self.learning), *([("hardware", self.hardware)] if self.hardware else [])]
        return [f"{key}={msgspec.json.encode(value).decode()}" for key, value in leaves(self.set) + own]


def settings_of(parameters: Mapping[str, Any]) -> Node:
    """Settings out of parameters by their full names, values of None left out.

    Raises:
        ConfigError: One that is unknown or cannot be, with its name.
    """
    table: dict[str, Any] = {}
    for name, value in parameters.items():
        *way, last = name.split(".")
        here = table
        for part in way:
            here = here.setdefault(part, {})
            if not isinstance(here, dict):
                raise ConfigError(f"'{part}' is a value and a table", fix="leave one out", key=name)
        here |= {} if value is None else {last: value}
    return _converted(table)


def _converted(table: dict[str, Any]) -> Node:
    """A table as settings, part by part, so that an error of a part knows where it stands."""
    kinds = {field.name: field.type for field in msgspec.structs.fields(Node) if is_part(field.type)}
    parts = [(value, kinds[name], f"{name}.") for name, value in table.items() if name in kinds]
    if isinstance(table.get("commands"), dict):
        parts += [(value, Output, f"commands.{name}.") for name, value in table["commands"].items()]
    for part in parts:
        _convert(*part)
    whole: Node = _convert(table, Node, "")
    return whole


def is_part(kind: Any) -> bool:
    """Whether a type is that of a table."""
    return isinstance(kind, type) and issubclass(kind, Settings)


def _convert(value: Any, kind: type[Settings], prefix: str) -> Any:
    """One table as settings of a kind; keys of errors begin with a prefix."""
    try:
        return msgspec.convert(value, kind, strict=True)
    except msgspec.ValidationError as error:
        message, _, where = str(error).partition(" - at ")
        key = (prefix + where.strip("`").removeprefix("$").removeprefix(".")).rstrip(".")
        if (unknown := unknown_key(error)) is not None:
            known = [field.name for field in msgspec.structs.fields(kind)]
            raise UnknownName("parameter", f"{prefix}{unknown}", [prefix + name for name in known]) from error
        what, fix = wrong_type(message)
        raise ConfigError(what, fix=fix, key=key or None) from error
    except ConfigError as error:
        own = (error.key or "").removeprefix(prefix)
        raise error.but(key=(prefix + own.removeprefix(".")).rstrip(".") or None) from error


def leaves(table: dict[str, Any], before: str = "") -> list[tuple[str, Any]]:
    """Key paths and values of a table in tables."""
    found = []
    for key, value in table.items():
        found += leaves(value, f"{before}{key}.") if isinstance(value, dict) else [(f"{before}{key}", value)]
    return found
