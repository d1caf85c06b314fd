"""A ROS 2 package to start from: parameters and a launch file for a robot, and what `colcon build` needs."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

from ...errors import ConfigError, printable
from ...files import whole_folder
from ...model.base.steered import SteeredBase
from ...model.inspection import interfaces_of
from ...model.robot import Robot
from .drivers import DIFF_DRIVE, driver_of
from .settings import TWIST_STAMPED, Interface, Node, Output
from .wiring import controllers, flow

PARAMETERS = """# {title} under mmnn: mmnn ros2 THIS_FILE, or the launch file beside. See `mmnn docs how-to/ros2`.
/**:
  ros__parameters:
    robot: {robot}             # name or URDF file
    experiment: track          # where gains, learners and the supervisor come from; `set` changes its keys
    controller: {controller}    # see mmnn list
    learning: true             # live, as `limits` and `set` are
    rate: 200.0                # control samples per second
    latency: 0.005             # known delay from the measurement to the motors [s], which the gains have to bear
    set:
      feedback: {{scaling: inertia, base: 15.0, arm: 20.0}}    # bandwidths [1/s]
      safety: {{torque: urdf, position_error: 0.5, heading_error: 0.5}}
    joint_states:
      age: 0.1                 # older ones are refused [s]
      # names: ["arm_1_joint=left_arm_1_joint"]    # "URDF=as the robot calls it"
{base}    limits:                    # of references made on the way
      speed: 0.5               # [m/s]
      yaw_rate: 1.0            # [rad/s]
      # joint_acceleration: 5.0    # [rad/s^2 or m/s^2]; where it is stated, plans beyond it are refused
    commands:                  # by the names of the robot's controllers; together they command every motor once
{commands}"""
BASE = """    odometry:
      age: 0.2
      at: [0.0, 0.0, 0.0]      # {driver} tells of the middle of the wheels, whatever its frame's name;
                               # leave it out where the URDF says how the message's child frame lies
    velocity: {{stamped: false}}    # cmd_vel is a Twist, or a TwistStamped
    path: {{speed: 0.3}}         # [m/s]
"""
WHEELS = "      {driver}: {{type: TwistStamped}}\n"
ARM = "      {name}: {{type: Float64MultiArray, interface: {interface}, joints: {joints}}}\n"
LAUNCH = '''from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    """The controller; add `remappings=[(mine, theirs)]` where the robot's topics have other names."""
    parameters = str(Path(get_package_share_directory("{name}")) / "config" / "mmnn.yaml")
    node = Node(package="{name}", executable="mmnn", name="mmnn", parameters=[parameters], output="screen")
    return LaunchDescription([node])
'''
PACKAGE = """<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>0.1.0</version>
  <description>Whole-body control by mmnn_pin.</description>
  <maintainer email="you@example.com">you</maintainer>
  <license>Apache-2.0</license>
  <exec_depend>rclpy</exec_depend>
  <exec_depend>launch_ros</exec_depend>
  <exec_depend>control_msgs</exec_depend>
  <exec_depend>diagnostic_msgs</exec_depend>
  <exec_depend>nav_msgs</exec_depend>
  <exec_depend>nav2_msgs</exec_depend>
  <exec_depend>sensor_msgs</exec_depend>
  <exec_depend>std_srvs</exec_depend>
  <exec_depend>tf2_msgs</exec_depend>
  <exec_depend>trajectory_msgs</exec_depend>
  <export><build_type>ament_python</build_type></export>
</package>
"""
SETUP = """from glob import glob

from setuptools import setup

setup(
    name="{name}",
    version="0.1.0",
    packages=["{name}"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/{name}"]),
        ("share/{name}", ["package.xml"]),
        ("share/{name}/launch", glob("launch/*.py")),
        ("share/{name}/config", glob("config/*.yaml")),
    ],
    install_requires=["mmnn_pin"],
    entry_points={{"console_scripts": ["mmnn = {name}:node"]}},
)
"""
EXECUTABLE = """import sys

from mmnn_pin.cli import main


def node():
    sys.exit(main(["ros2", *sys.argv[1:]]))
"""
SETUP_CFG = "[develop]\nscript_dir=$base/lib/{name}\n[install]\ninstall_scripts=$base/lib/{name}\n"
INTERFACES: tuple[Interface, ...] = ("effort", "velocity", "position")
NAME = re.compile(r"[a-z][a-z0-9_]*")
CONTROLLER = "pd_gravity"  # an arm on efforts would fall without it
FILES = {
    "package.xml": PACKAGE, "setup.py": SETUP, "setup.cfg": SETUP_CFG, "resource/{name}": "",
    "{name}/__init__.py": EXECUTABLE, "launch/{name}.launch.py": LAUNCH,
}  # fmt: skip


def commands_of(robot: Robot) -> dict[str, Output]:
    """Outputs to the joints of a URDF by the names of their controllers: an effort where a joint takes one."""
    driver, offered, base = driver_of(robot.base) or DIFF_DRIVE, interfaces_of(robot)["interfaces"], robot.base
    found = {driver.name: Output(TWIST_STAMPED)} if robot.dimensions.base else {}
    if isinstance(base, SteeredBase):
        turned = tuple(pivot.joint for pivot in base.pivots if pivot.motor and pivot.role != "passive")
        driven = tuple(joint for joint in base.driven if joint not in turned)
        found = {"drive_controller": Output(joints=driven, interface="velocity")}
        found |= {"steering_controller": Output(joints=turned, interface="position")} if turned else {}
    for interface in INTERFACES:
        if joints := tuple(joint for joint in robot.joint_names if offered[joint] == interface):
            found[f"{interface}_controller"] = Output(joints=joints, interface=interface)
    return found


def parameters(robot: Robot, named: str) -> str:
    """The parameters for a robot, to be adapted.

    Args:
        robot: The robot.
        named: As the user named it.
    """
    commands, driver = commands_of(robot), driver_of(robot.base)
    rows = [
        WHEELS.format(driver=name)
        if one.is_base
        else ARM.format(name=name, interface=one.interface, joints=flow(list(one.joints)))
        for name, one in commands.items()
    ]
    base = BASE.format(driver=driver.name if driver else "its controller") if robot.dimensions.base else ""
    told = {"title": printable(robot.name), "robot": flow(named), "controller": CONTROLLER}
    return PARAMETERS.format(base=base, commands="".join(rows), **told)


def write_package(folder: Path, robot: Robot, named: str) -> list[Path]:
    """Write the package; the files that were written.

    Args:
        folder: A new one, whose name is that of the package.
        robot: The robot.
        named: As the user named it.

    Raises:
        ConfigError: A name that no package may have.
        RecordingError: The folder is there already, or cannot be written.
    """
    name = folder.name
    if not NAME.fullmatch(name):
        fix = "give a folder whose name begins with a small letter, then small letters, digits and _"
        raise ConfigError(f"'{name}' is no name of a package", fix=fix, key="--example")
    texts = {path.format(name=name): text.format(name=name) for path, text in FILES.items()}
    texts["config/mmnn.yaml"] = parameters(robot, named)
    with suppress(ConfigError):  # a base that no controller of ros2_controllers rolls
        texts["config/controllers.yaml"] = controllers(robot, Node(robot=named, commands=commands_of(robot)))
    with whole_folder(folder, "package", force=False) as made:
        for path, text in texts.items():
            (made / path).parent.mkdir(parents=True, exist_ok=True)
            (made / path).write_text(text)
    return [folder / path for path in texts]
