"""`mmnn ros2`: a controller as a node of a ROS 2 graph."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from msgspec.structs import replace

from ..errors import ConfigError, InputError
from ..files import quoted
from .options import RangedNumber, examples, robots, shared
from .output import DONE, FAILED, STOPPED, answer, compile_if_cold, wrote

if TYPE_CHECKING:
    from ..deploy.ros2.settings import Node
    from ..kinematic import Kinematic
    from ..lab.experiments.experiment import Experiment
    from ..loop.stepper import Stepper
    from ..model.robot import Robot
    from ..reference.wishes import Motion

COARSEST = 0.001  # step of a simulated plant, which is not used here [s]
GET = "source /opt/ros/DISTRIBUTION/setup.bash (Jazzy or later), or pip install 'mmnn_pin[ros2]' (Linux on x86-64)"


@click.command(
    short_help="Run a controller as a ROS 2 node.",
    context_settings={"ignore_unknown_options": True},
    epilog=examples(
        "mmnn ros2 --example my_robot_control --robot my_robot.urdf    a package to start from",
        "mmnn ros2 my_robot.yaml --check                               what it would listen to and send",
        "mmnn ros2 my_robot.yaml --controllers                         YAML of the controllers for ros2_control",
        "mmnn ros2 my_robot.yaml",
        "mmnn ros2 my_robot.yaml --seconds 60 --ros-args -p controller:=two_layer -r cmd_vel:=teleop/cmd_vel",
    ),
)
@click.argument("arguments", metavar="[PARAMETERS.yaml] [--ros-args ...]", nargs=-1, type=click.UNPROCESSED)
@click.option("--example", metavar="FOLDER", type=click.Path(path_type=Path), help="Write a ROS 2 package, and end.")
@click.option(
    "--robot",
    metavar="ROBOT",
    shell_complete=robots,
    default="platform_arm",
    help="For --example: a name or a URDF file.",
)
@click.option("--check", is_flag=True, help="Say what it would subscribe to and publish, and end. Nothing moves.")
@click.option("--controllers", "show_controllers", is_flag=True, help="Print the YAML of ros2_control for it, and end.")
@click.option("--managed", is_flag=True, help="Wait for a lifecycle manager to configure and activate it.")
@click.option(
    "--seconds",
    type=RangedNumber(0.0, min_open=True),
    default=math.inf,
    show_default="never",
    help="Stop after this time.",
)  # fmt: skip
@click.option("--wait", type=RangedNumber(0.0), default=10.0, help="How long to wait for the robot [s].")
@click.option("--out", type=click.Path(path_type=Path), help="The recording.  [default: runs/ros2/ROBOT.h5]")
@click.option("--force", is_flag=True, help="Replace an existing recording.")
@shared
def ros2(
    arguments: tuple[str, ...],
    example: Path | None,
    robot: str,
    check: bool,
    show_controllers: bool,
    managed: bool,
    seconds: float,
    wait: float,
    out: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Control a robot through ROS 2 topics.

    The node subscribes to joint states and odometry, takes setpoints (Twist, JointTrajectory, Path, and the action
    FollowJointTrajectory that MoveIt sends), and publishes commands to the robot's ros2_control controllers, and
    diagnostics. It checks publishers, order, age, NaN and joint names of messages. Its supervisor trips when
    measurements stay away for too long, or when an error or a speed passes its limit. Then the base brakes and the arm
    holds until ~/reset is called. Ctrl-C stops the robot in the same way, and ends the node.

    It is a lifecycle node of rclpy. Arguments after --ros-args go to ROS 2 (parameters, remapping, namespace, logging).
    Its recording is a run like any other: mmnn plot, report and replay show it. Exit codes: 0 done, 1 tripped, 2 bad
    input or no robot there, 130 stopped by Ctrl-C.
    """
    if example is not None:
        from ..deploy.ros2.example import write_package
        from ..model.loading import load

        files = write_package(example, load(robot), robot)
        answer(as_json, lambda: {"files": [str(file) for file in files]}, lambda: wrote(files))
        return DONE
    require_rclpy()
    from ..deploy.ros2 import node

    given, making = ros_arguments(arguments), Making(seconds, out, force, keep=not check)
    if show_controllers:
        yaml = yaml_of(node.settings(making, given))
        answer(as_json, lambda: {"yaml": yaml}, lambda: yaml)
        return DONE
    if check:
        name, rows = node.checked(making, given)
        topics = {"robot": name, "topics": [row._asdict() for row in rows]}
        answer(as_json, lambda: topics, lambda: columns(rows))
        return DONE
    compile_if_cold(True)
    run, stopped = node.control(making, given, wait, managed)
    if run is None:
        return STOPPED if stopped else DONE
    outcome = run.outcome
    facts = {"status": outcome.status, "time": outcome.time, "message": outcome.message, "recording": str(run.path)}
    text = f"{outcome.status} after {outcome.time:.3f} s: {outcome.message}".rstrip(": ")
    answer(as_json, lambda: facts, lambda: text)
    return STOPPED if stopped else DONE if outcome.status == "completed" else FAILED


def require_rclpy() -> None:
    """Refuse to go on without rclpy, or without the RMW that is asked for: rcl itself would end the process.

    Raises:
        ConfigError: One is not there, with how to get it.
    """
    asked = os.environ.get("RMW_IMPLEMENTATION", "")
    try:
        from ament_index_python.packages import PackageNotFoundError, get_package_prefix

        if asked:
            get_package_prefix(asked)
        import rclpy  # noqa: F401
    except ImportError as error:
        version = ".".join(map(str, sys.version_info[:2]))
        raise ConfigError(f"no rclpy for this Python {version}", why=str(error), fix=GET) from error
    except PackageNotFoundError as error:
        fix = f"apt install ros-$ROS_DISTRO-{asked.replace('_', '-')} (no wheel has it), or unset RMW_IMPLEMENTATION"
        raise ConfigError(f"no RMW '{asked}' here", fix=fix) from error


def ros_arguments(given: Sequence[str]) -> list[str]:
    """Arguments for ROS 2, a file of parameters in front as ROS 2 takes it.

    Raises:
        ConfigError: A file that is not there, an argument that is none.
    """
    own = list(given[: given.index("--ros-args")]) if "--ros-args" in given else list(given)
    rest = list(given[len(own) :])
    for name in own:
        if name.startswith("-"):
            raise ConfigError(f"no option {name}", fix="give arguments for ROS 2 after --ros-args", key="ros2")
        if not os.path.isfile(name):
            fix = "mmnn ros2 --example FOLDER writes one to start from"
            raise ConfigError(f"no file {name}", fix=fix, key="ros2")
    return [*(part for name in own for part in ("--ros-args", "--params-file", name, "--")), *rest]


def yaml_of(settings: Node) -> str:
    """The YAML of ros2_control."""
    from ..deploy.ros2.wiring import controllers

    return controllers(asked(settings)[1], settings)


def columns(table: Sequence[Any]) -> str:
    """Topics, one a line, what is said of them below each other."""
    width = [max(len(row[i]) for row in table) for i in range(3)]
    return "\n".join("  ".join((*(f"{row[i]:{width[i]}}" for i in range(3)), row.qos, row.what)) for row in table)


@dataclass
class Making:
    """A maker of steppers out of a node's settings."""

    seconds: float  # how long they run at most
    out: Path | None  # file for the recording; None for one by the robot's name, or in memory where nothing runs
    force: bool  # whether it may be replaced
    keep: bool = True  # whether there is a file at all

    def stepper(self, settings: Node, count: int) -> Stepper:
        """A stepper, the count-th of the process."""
        from ..deploy.ros2.wiring import interfaces
        from ..loop.stepper import Stepper
        from ..safety import Safety

        experiment, robot = asked(settings)
        self.experiment, self.follow = experiment, settings.follow
        self.loop = experiment.loop(robot, experiment.controller(settings.controller, robot=robot))
        path = self.out or Path("runs/ros2") / f"{robot.name}.h5"
        with experiment.in_its_keys(as_parameters):
            return Stepper.of(
                self.loop,
                limits=settings.limits,
                setpoint_timeout=settings.setpoint_timeout,
                interfaces=interfaces(robot, settings),
                path=path.with_stem(f"{path.stem}-{count}" if count else path.stem) if self.keep else None,
                force=self.force,
                safety=self.loop.safety or Safety(torque="urdf"),
                meta={"config": experiment.to_json()},
            )

    def motion(self, stepper: Stepper) -> tuple[Motion | None, float]:
        """The motion that a stepper follows from the start, None for none; and for how long [s]."""
        if self.follow == "topics":
            return None, self.seconds
        duration = self.experiment.time.duration
        return stepper.plan(self.loop.trajectory, duration, from_here=True), min(self.seconds, duration)

    def law(self, settings: Node, before: Node) -> tuple[Any, Kinematic]:
        """Controller and kinematic gains of changed settings.

        Raises:
            ConfigError: More than those changed.
        """
        now, robot = asked(settings)
        then, _ = asked(before)
        gains = ("kinematic", "feedback", "robust", "robust_of", "learning", settings.controller)
        fixed = [name for name in now.__struct_fields__ if getattr(now, name) != getattr(then, name)]
        if wrong := [name for name in fixed if name not in gains]:
            why, fix = "only gains, learning and the controller's table can", "clean up, set it, configure anew"
            raise ConfigError(f"set.{wrong[0]} cannot change now", why=why, fix=fix, key=f"set.{wrong[0]}")
        with now.in_its_keys(as_parameters):
            return now.controller(settings.controller, robot=robot), now.kinematic


def asked(settings: Node) -> tuple[Experiment, Robot]:
    """The experiment with the settings' changes, and its robot; the wiring is checked.

    Raises:
        InputError: They do not fit each other.
    """
    from ..deploy.ros2.wiring import interfaces
    from ..lab.experiments.config import load_experiment

    period, duration = 1.0 / settings.rate, 10.0
    step = period / math.ceil(period / COARSEST - 1e-9)
    times = [f"time.control_period={period!r}", f"time.plant_step={step!r}"]
    times += [f"time.duration={round(duration / period) * period!r}"]
    changes = [f"robot={quoted(settings.robot)}", *times, *settings.changes]
    try:
        experiment = load_experiment(settings.experiment, changes)
        experiment = replace(experiment, latency=settings.latency_of(experiment.latency))
        robot = experiment.load_robot()
    except InputError as error:
        if error.key is not None and error.key.partition(".")[0] in settings.set:
            raise error.but(key=f"set.{error.key}") from error
        raise
    interfaces(robot, settings)
    return experiment, robot


def as_parameters(values: Mapping[str, str]) -> str:
    """Changes of an experiment as a file of parameters has them, whose lists have no whole numbers among others."""
    reals = {key: re.sub(r"(?<![\w.])(\d+)(?![\w.])", r"\1.0", value) for key, value in values.items()}
    return " ".join(f"`set.{key}: {value}`" for key, value in reals.items())
