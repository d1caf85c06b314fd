"""The wiring of a robot by its settings, before anything speaks: who takes what, and the YAML of ros2_control."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from pinocchio import BODY

from ...elementary import atan2, hypot
from ...errors import ConfigError, UnknownName
from ...files import quoted
from ...model.base.steered import CarLike, Tricycle
from ...model.robot import Robot
from ...signals import Array
from .drivers import DIFF_DRIVE, driver_of
from .settings import ACKERMANN, TRAJECTORY, TWIST_STAMPED, Node, Output

PLAIN = re.compile(r"(?!(?:true|false|yes|no|on|off|null|y|n)\Z)[a-zA-Z_/][\w/]*", re.ASCII | re.IGNORECASE)
SLOW = 1e-3  # speed of a car's wheels under which they keep their angle [m/s]
GROUP = "forward_command_controller/ForwardCommandController"
TRAJECTORIES = "joint_trajectory_controller/JointTrajectoryController"


def interfaces(robot: Robot, settings: Node) -> dict[str, str]:
    """Joint of every motor to the interface that it takes, by the commands that are sent to it.

    Raises:
        UnknownName: A joint that is no motor of the robot.
        ConfigError: A motor that nothing commands, or two do.
    """
    names, found = names_of(robot, settings), dict[str, str]()
    wheels = robot.actuator_names[: robot.dimensions.motors - robot.dimensions.arm]
    for name, output in settings.commands.items():
        if output.is_base and not wheels:
            raise ConfigError("a twist for a robot without a base", fix="leave it out", key=f"commands.{name}.type")
        if output.type == ACKERMANN and not isinstance(robot.base, CarLike | Tricycle):
            what = f"an {ACKERMANN} for a base of kind '{robot.base.kind}'"
            why, fix = "it says a speed and one steering angle", "send a TwistStamped, or every joint's own command"
            raise ConfigError(what, why=why, fix=fix, key=f"commands.{name}.type")
        for joint in wheels if output.is_base else output.joints:
            if not output.is_base and joint not in names:
                raise UnknownName("joint", joint, names, key=f"commands.{name}.joints")
            own = joint if output.is_base else names[joint]
            if own in found:
                raise ConfigError(f"{own} is commanded twice", fix="name it once", key=f"commands.{name}.joints")
            found[own] = "velocity" if output.is_base else output.interface
    if missing := [joint for joint in robot.actuator_names if joint not in found]:
        fix = "add them to one of `commands`; wheels also by a TwistStamped; or --lock joints that have no motor"
        raise ConfigError(f"nothing commands {', '.join(missing)}", fix=fix, key="commands")
    return found


def names_of(robot: Robot, settings: Node) -> dict[str, str]:
    """Motors by the names that the robot has for them."""
    theirs = settings.joint_states.theirs
    return {theirs.get(name, name): name for name in robot.actuator_names}


def topic_of(robot: Robot, name: str, output: Output) -> str:
    """The topic that the robot's controller of a name takes commands on, as `ros2_controllers` name it."""
    if output.type == ACKERMANN:
        return f"{name}/ackermann_cmd"
    if not output.is_base:
        return f"{name}/{'joint_trajectory' if output.type == TRAJECTORY else 'commands'}"
    driver = driver_of(robot.base)
    return f"{name}/{driver.takes if driver is not None else 'cmd_vel'}"


def ackermann(twist: Array, wheelbase: float, before: float) -> tuple[float, float]:
    """A car's speed, and the angle of a wheel in the middle of the axle that steers; at rest it keeps that.

    Args:
        twist: (2,) of the middle of the axle that does not steer [m/s, rad/s].
        wheelbase: [m], negative where the axle that steers is behind.
        before: Angle before [rad].
    """
    v, swing = float(twist[0]), wheelbase * float(twist[1])
    if hypot(v, swing) <= SLOW:
        return v, before
    return v, atan2(-swing if v < 0.0 else swing, abs(v))


def odometry_topic(robot: Robot, settings: Node) -> str:
    """The topic on which the controller of the base tells of its odometry; `odom` where no controller drives it."""
    driver = driver_of(robot.base)
    names = [name for name, output in settings.commands.items() if output.is_base]
    return f"{names[0]}/{driver.tells}" if names and driver is not None else "odom"


def controllers(robot: Robot, settings: Node) -> str:
    """The YAML of `ros2_control` for the controllers that take the commands.

    Raises:
        ConfigError: A base that no controller's formula rolls.
    """
    interfaces(robot, settings)
    made = {name: controller(robot, settings, name, output) for name, output in settings.commands.items()}
    kinds = {"joint_state_broadcaster": "joint_state_broadcaster/JointStateBroadcaster"}
    head = ["controller_manager:", "  ros__parameters:", f"    update_rate: {round(settings.rate)}"]
    for name, kind in (kinds | {name: kind for name, (kind, _) in made.items()}).items():
        head += [f"    {flow(name)}: {{type: {kind}}}"]
    for name, (_, told) in made.items():
        head += [f"{flow(name)}:", "  ros__parameters:", *lines(told, 4)]
    return "\n".join(head) + "\n"


def controller(robot: Robot, settings: Node, name: str, output: Output) -> tuple[str, dict[str, Any]]:
    """Class and parameters of the controller of a name, which takes an output.

    Raises:
        ConfigError: A base that no controller's formula rolls.
    """
    if output.is_base:
        return drive_controller(robot, settings, name, output)
    joints = {"joints": list(output.joints)}
    if output.type == TRAJECTORY:
        told = {"command_interfaces": [output.interface], "state_interfaces": ["position", "velocity"]}
        return TRAJECTORIES, joints | told
    return GROUP, joints | {"interface_name": output.interface}


def drive_controller(robot: Robot, settings: Node, name: str, output: Output) -> tuple[str, dict[str, Any]]:
    """Class and parameters of the controller of a name for a robot's base.

    Raises:
        ConfigError: None takes these commands, or none rolls its wheels.
    """
    driver, theirs, key = driver_of(robot.base), settings.joint_states.theirs, f"commands.{name}.type"
    if driver is None or output.type != TWIST_STAMPED:
        why, fix = "they take a TwistStamped, for a base on wheels", "write its YAML by hand, as its own page says"
        raise ConfigError("no controller of ros2_controllers takes this", why=why, fix=fix, key=key)
    driven = [
        replace(w, joint=theirs.get(w.joint, w.joint)) for w in robot.base.wheels if w.joint in robot.actuator_names
    ]
    try:
        told = driver.geometry(robot.base, driven)
    except ConfigError as error:
        raise error.but(what=f"{driver.name}: {error.what}", key=key) from error
    root = next(frame.name for frame in robot.model.frames if frame.type == BODY and frame.parentJoint == 1)
    told |= {driver.timeout: settings.setpoint_timeout}
    if driver is DIFF_DRIVE:  # its 10 make velocities late; until kilted it publishes less often than it is updated
        told |= {"publish_rate": float(settings.rate), "velocity_rolling_window_size": 1}
    return driver.kind, told | {"odom_frame_id": "odom", "base_frame_id": root}


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
