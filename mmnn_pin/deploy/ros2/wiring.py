"""What a robot and a file of settings make together, before anything speaks: who takes what, and an example."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any, NamedTuple

from pinocchio import BODY

from ...errors import ConfigError, UnknownName, printable
from ...files import quoted
from ...model.inspection import interfaces_of
from ...model.robot import Robot
from .drivers import DIFF_DRIVE, driver_of
from .settings import TRAJECTORY, TWIST_STAMPED, Network, Node, Output

EXAMPLE = """# {name} as a node of a ROS 2 graph: mmnn ros2 THIS_FILE. See `mmnn ros2 --help`, `mmnn docs how-to/ros2`.
# Topics without a leading / get network.namespace.

robot = {robot}             # name or URDF file
experiment = "track"          # where gains, learners and the supervisor come from; [set] changes its keys
controller = "pd"             # see mmnn list
rate = 200.0                  # control samples per second
latency = 0.005               # known delay from the measurement to the motors [s], which the gains have to bear

[set]
feedback = {{ scaling = "inertia", base = 15.0, arm = 20.0 }}    # bandwidths [1/s]
safety = {{ torque = "urdf", position_error = 0.5, heading_error = 0.5, timeout = 0.5 }}

[network]
domain = 0                    # ROS_DOMAIN_ID
interface = "lo"              # name or address of the network interface
peers = ["127.0.0.1"]         # who is looked for, and listened to

[clock]
source = "steady"             # "sim" with use_sim_time
stamps = "check"              # "ignore" where the clocks of robot and controller are not synchronised

[joint_states]
topic = "/joint_states"
age = 0.1                     # older ones are refused [s]
# names = {{ arm_1_joint = "left_arm_1_joint" }}    # URDF = as the robot calls it
{odometry}
[trajectory]                  # trajectory_msgs/JointTrajectory
topic = "/mmnn/joint_trajectory"

[action]                      # control_msgs/FollowJointTrajectory, as MoveIt sends it
name = "/mmnn/follow_joint_trajectory"

[switches]                    # std_srvs/Trigger; without this table the node ends after a trip
stop = "/mmnn/stop"
reset = "/mmnn/reset"

[limits]                      # of references made on the way
speed = 0.5                   # [m/s]
yaw_rate = 1.0                # [rad/s]
# joint_acceleration = 5.0    # [rad/s^2 or m/s^2]; where it is stated, plans beyond it are refused

[diagnostics]
topic = "/diagnostics"
rate = 10.0

# A table per controller of ros2_control; together they command every motor once.
{commands}"""
BASE = """
[odometry]
topic = "/{driver}/{odometry}"
age = 0.2
at = [0.0, 0.0, 0.0]          # {driver} tells of the middle of the wheels, whatever its frame's name;
                              # leave it out where the URDF says how the message's child frame lies

[velocity]                    # geometry_msgs/Twist of a joystick or a navigation stack
topic = "/cmd_vel"
stamped = false

[path]                        # nav_msgs/Path
topic = "/plan"
speed = 0.3

# [tf]                        # for paths in the frame of a map
# map = "map"
# odom = "odom"
"""
WHEELS = """[[commands]]
topic = "/{driver}/{takes}"
type = "TwistStamped"

"""
ARM = """[[commands]]
topic = "/{interface}_controller/commands"
type = "Float64MultiArray"
interface = "{interface}"
joints = [{joints}]
"""


PLAIN = re.compile(r"(?!(?:true|false|yes|no|on|off|null|y|n)\Z)[a-zA-Z_/][\w/]*", re.ASCII | re.IGNORECASE)
INTERFACES = ("effort", "velocity", "position")
GROUP = "forward_command_controller/ForwardCommandController"
TRAJECTORIES = "joint_trajectory_controller/JointTrajectoryController"


class Row(NamedTuple):
    """A topic or an action of the node: which way, its name, type and quality of service, and what it is for."""

    way: str
    name: str
    type: str
    qos: str
    what: str


def interfaces(robot: Robot, settings: Node) -> dict[str, str]:
    """What every motor takes, by the commands that are sent to it.

    Raises:
        UnknownName: A joint that is no motor of the robot.
        ConfigError: A motor that nothing commands, or two do.
    """
    names, found = names_of(robot, settings), dict[str, str]()
    wheels = robot.actuator_names[: robot.dimensions.motors - robot.dimensions.arm]
    for i, output in enumerate(settings.commands):
        if output.is_twist and not wheels:
            raise ConfigError("a twist for a robot without a base", fix="leave it out", key=f"commands.{i}.type")
        for joint in wheels if output.is_twist else output.joints:
            if not output.is_twist and joint not in names:
                raise UnknownName("joint", joint, names, key=f"commands.{i}.joints")
            own = joint if output.is_twist else names[joint]
            if own in found:
                raise ConfigError(f"{own} is commanded twice", fix="name it once", key=f"commands.{i}.joints")
            found[own] = "velocity" if output.is_twist else output.interface
    if missing := [name for name in robot.actuator_names if name not in found]:
        fix = "add them to a table [[commands]]; wheels also by a TwistStamped; or --lock joints that have no motor"
        raise ConfigError(f"nothing commands {', '.join(missing)}", fix=fix, key="commands")
    return found


def names_of(robot: Robot, settings: Node) -> dict[str, str]:
    """Motors by the names that the robot has for them."""
    theirs = settings.joint_states.names
    return {theirs.get(name, name): name for name in robot.actuator_names}


def rows(robot: Robot, settings: Node) -> list[Row]:
    """All topics and actions of the node."""
    s, has_base = settings, bool(robot.dimensions.base)

    def heard(table: Any, kind: str, what: str) -> Row:
        return Row(
            "subscribes", resolved(s.network, table.topic), kind, f"{table.reliability}, depth {table.depth}", what
        )

    def sent(name: str, kind: str, qos: str, what: str) -> Row:
        return Row("publishes", resolved(s.network, name), kind, qos, what)

    found = [heard(s.joint_states, "sensor_msgs/msg/JointState", ", ".join(names_of(robot, s)))]
    if has_base and s.odometry.pose == "odometry":
        found.append(heard(s.odometry, "nav_msgs/msg/Odometry", "pose and velocity of the base"))
    if s.clock.source == "sim":
        found.append(Row("subscribes", "/clock", "rosgraph_msgs/msg/Clock", "best_effort, depth 4", "the time"))
    if s.tf is not None:
        found.append(heard(s.tf, "tf2_msgs/msg/TFMessage", f"{s.tf.map}, {s.tf.odom}, {s.tf.base}"))
        found.append(Row("subscribes", "/tf_static", "tf2_msgs/msg/TFMessage", "reliable, transient local", "likewise"))
    if s.velocity is not None:
        kind = "TwistStamped" if s.velocity.stamped else "Twist"
        found.append(heard(s.velocity, f"geometry_msgs/msg/{kind}", "velocity of the base"))
    if s.trajectory is not None:
        found.append(heard(s.trajectory, "trajectory_msgs/msg/JointTrajectory", "motions of the arm"))
    if s.path is not None:
        found.append(heard(s.path, "nav_msgs/msg/Path", "paths of the base"))
    if s.action is not None:
        kind = "control_msgs/action/FollowJointTrajectory"
        found.append(Row("serves", resolved(s.network, s.action.name), kind, "reliable", "motions of the arm"))
    for name in () if s.switches is None else (s.switches.stop, s.switches.reset):
        found.append(Row("serves", resolved(s.network, name), "std_srvs/srv/Trigger", "reliable", "stop and reset"))
    for output in s.commands:
        package = {"Float64MultiArray": "std_msgs", "JointTrajectory": "trajectory_msgs"}.get(
            output.type, "geometry_msgs"
        )
        what = "velocity of the base" if output.is_twist else f"{output.interface} of {', '.join(output.joints)}"
        qos = f"{output.reliability}, depth {output.depth}"
        found.append(sent(output.topic, f"{package}/msg/{output.type}", qos, what))
    if s.diagnostics is not None:
        kind = "diagnostic_msgs/msg/DiagnosticArray"
        found.append(sent(s.diagnostics.topic, kind, "reliable, depth 4", "supervisor, errors, Psi_hat"))
    return found


def controllers(robot: Robot, settings: Node) -> str:
    """The YAML of `ros2_control` for the controllers that take the commands of a file of settings.

    Topics are `CONTROLLER/commands`, `CONTROLLER/cmd_vel` and so on, as `ros2_controllers` name them.

    Raises:
        ConfigError: A topic of another name, a base that no controller's formula rolls.
    """
    interfaces(robot, settings)
    kinds, parts = {"joint_state_broadcaster": "joint_state_broadcaster/JointStateBroadcaster"}, list[str]()
    for i, output in enumerate(settings.commands):
        kind, ending, told = parameters(robot, settings, i, output)
        node, _, last = resolved(settings.network, output.topic).rpartition("/")
        if last != ending or not node:
            fix = f'use topic = "/NAME/{ending}", NAME being the controller\'s'
            raise ConfigError(f"no controller takes '{output.topic}'", fix=fix, key=f"commands.{i}.topic")
        name = node.rpartition("/")[2]
        kinds[name] = kind
        key = name if node == f"/{name}" else node
        parts += [f"{key}:", "  ros__parameters:", *lines(told, 4)]
    head = ["controller_manager:", "  ros__parameters:", f"    update_rate: {round(settings.rate)}"]
    head += [f"    {name}: {{type: {kind}}}" for name, kind in kinds.items()]
    return "\n".join([*head, *parts]) + "\n"


def parameters(robot: Robot, settings: Node, i: int, output: Output) -> tuple[str, str, dict[str, Any]]:
    """Class, last part of the topic and parameters of the controller that takes command number i.

    Raises:
        ConfigError: A base that no controller's formula rolls.
    """
    if output.is_twist:
        return drive_parameters(robot, settings, i)
    joints = {"joints": list(output.joints)}
    if output.type == TRAJECTORY:
        told = {"command_interfaces": [output.interface], "state_interfaces": ["position", "velocity"]}
        return TRAJECTORIES, "joint_trajectory", joints | told
    return GROUP, "commands", joints | {"interface_name": output.interface}


def drive_parameters(robot: Robot, settings: Node, i: int) -> tuple[str, str, dict[str, Any]]:
    """Class, last part of the topic and parameters of the controller for a robot's base, which command number i drives.

    Raises:
        ConfigError: None takes these commands, or none rolls its wheels.
    """
    driver, theirs = driver_of(robot.base), settings.joint_states.names
    if driver is None or settings.commands[i].type != TWIST_STAMPED:
        why, fix = "they take a TwistStamped, for a base on wheels", "write its YAML by hand, as its own page says"
        raise ConfigError("no controller of ros2_controllers takes this", why=why, fix=fix, key=f"commands.{i}.type")
    driven = [
        replace(w, joint=theirs.get(w.joint, w.joint)) for w in robot.base.wheels if w.joint in robot.actuator_names
    ]
    try:
        told = driver.geometry(robot.base, driven)
    except ConfigError as error:
        error.what, error.key = f"{driver.name}: {error.what}", f"commands.{i}.type"
        raise
    root = next(frame.name for frame in robot.model.frames if frame.type == BODY and frame.parentJoint == 1)
    told |= {driver.timeout: settings.setpoint_timeout}
    if driver is DIFF_DRIVE:  # its 10 make velocities late; until kilted it publishes less often than it is updated
        told |= {"publish_rate": float(settings.rate), "velocity_rolling_window_size": 1}
    return driver.kind, driver.takes, told | {"odom_frame_id": "odom", "base_frame_id": root}


def lines(table: dict[str, Any], indent: int) -> list[str]:
    """A table in YAML, one key a line, tables in it indented further."""
    found = list[str]()
    for key, value in table.items():
        inner = lines(value, indent + 2) if isinstance(value, dict) else []
        found += [f"{' ' * indent}{key}:{'' if inner else f' {flow(value)}'}", *inner]
    return found


def flow(value: Any) -> str:
    """A value in YAML; texts that would be something else there stand in quotes."""
    if isinstance(value, float):
        value = round(value, 9) + 0.0  # no -0
    if isinstance(value, list):
        return f"[{', '.join(map(flow, value))}]"
    return quoted(value) if isinstance(value, str) and not PLAIN.fullmatch(value) else str(value)


def resolved(network: Network, name: str) -> str:
    """A topic's full name."""
    return name if name.startswith("/") else f"{network.namespace.rstrip('/')}/{name}"


def example(robot: Robot, name: str) -> str:
    """A file of settings for a robot, to be adapted; joints take what the URDF offers, an effort where it can be.

    Args:
        robot: The robot.
        name: As the user named it.
    """
    driver, offered = driver_of(robot.base) or DIFF_DRIVE, interfaces_of(robot)["interfaces"]
    names = {"driver": driver.name, "takes": driver.takes, "odometry": driver.tells}
    tables = [WHEELS.format(**names)] if robot.dimensions.base else []
    for interface in INTERFACES:
        joints = ", ".join(quoted(joint) for joint in robot.joint_names if offered[joint] == interface)
        tables += [ARM.format(interface=interface, joints=joints)] if joints else []
    commands = "\n".join(table.strip() + "\n" for table in tables)
    odometry = BASE.format(**names) if robot.dimensions.base else ""
    return EXAMPLE.format(name=printable(robot.name), robot=quoted(name), odometry=odometry, commands=commands)
