"""`mmnn ros2`: a controller as a node of a ROS 2 graph."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from msgspec.structs import replace

from ..errors import ConfigError, InputError
from ..files import quoted, read_text
from .options import examples, robots, shared
from .output import DONE, FAILED, STOPPED, answer, compile_if_cold, note

if TYPE_CHECKING:
    from ..deploy.ros2.settings import Node
    from ..deploy.ros2.wiring import Row
    from ..lab.experiments.experiment import Experiment
    from ..model.robot import Robot
    from ..recording.recording import Recording

Made = TypeVar("Made")
COARSEST = 0.001  # step of a simulated plant, which is not used here [s]


@click.command(
    short_help="Run a controller as a ROS 2 node, without an installation of ROS 2.",
    epilog=examples(
        "mmnn ros2 --example --robot my_robot.urdf > my_robot.toml     a file to start from",
        "mmnn ros2 my_robot.toml --check                               what it would listen to and send",
        "mmnn ros2 my_robot.toml --controllers                         YAML of the controllers for ros2_control",
        "mmnn ros2 my_robot.toml",
        "mmnn ros2 my_robot.toml --set controller=two_layer --set network.domain=7 --seconds 60",
    ),
)
@click.argument("file", metavar="SETTINGS.toml", required=False, type=click.Path(path_type=Path))
@click.option("--example", "show_example", is_flag=True, help="Print a SETTINGS.toml with comments, and end.")
@click.option(
    "--robot",
    metavar="ROBOT",
    shell_complete=robots,
    help="For --example: a name or a URDF file.  [default: platform_arm]",
)
@click.option("--check", is_flag=True, help="Say what it would subscribe to and publish, and end. Nothing is started.")
@click.option("--controllers", "show_controllers", is_flag=True, help="Print the YAML of ros2_control for it, and end.")
@click.option("--set", "changes", metavar="KEY=VALUE", multiple=True, help="Change a key of the file; repeatable.")
@click.option("--seconds", type=float, default=math.inf, help="Stop after this time.  [default: never]")
@click.option("--wait", type=float, default=10.0, help="How long to wait for the robot [s].  [default: 10]")
@click.option("--out", type=click.Path(path_type=Path), help="The recording.  [default: runs/ros2/ROBOT.h5]")
@click.option("--force", is_flag=True, help="Replace an existing recording.")
@shared
def ros2(
    file: Path | None,
    show_example: bool,
    robot: str | None,
    check: bool,
    show_controllers: bool,
    changes: tuple[str, ...],
    seconds: float,
    wait: float,
    out: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Control a robot through its ROS 2 topics, as SETTINGS.toml says.

    It subscribes to joint states and odometry, takes setpoints (Twist, JointTrajectory, Path, and the action
    FollowJointTrajectory that MoveIt sends), and publishes commands to the robot's ros2_control controllers, and
    diagnostics. A supervisor stands between controller and robot: it trips when measurements stay away for too long, or
    when an error or a speed passes its limit; then the base brakes, the arm holds, and the node ends. Ctrl-C does the
    same. Messages are checked: source, size, order, age, NaN, joint names. Every problem is one line.

    It is recorded as a run: mmnn plot, report and replay show it. Exit codes: 0 done, 1 tripped, 2 bad input or no
    robot there, 130 stopped by Ctrl-C. It needs: pip install 'mmnn_pin[ros2]'.
    """
    from ..deploy.ros2.reading import load_settings
    from ..deploy.ros2.wiring import controllers, example, rows
    from ..safety.settings import PRESSED, SIGNAL

    if show_example:
        from ..model.loading import load

        text = example(load(robot or "platform_arm"), robot or "platform_arm")
        answer(as_json, lambda: {"toml": text}, lambda: text)
        return DONE
    if file is None:
        raise ConfigError("no SETTINGS.toml", fix="mmnn ros2 --example > robot.toml writes one to start from")
    settings = load_settings(file, changes)
    experiment, made = asked(settings, file)
    if show_controllers:
        yaml = with_lines(lambda: controllers(made, settings), settings, file)
        answer(as_json, lambda: {"yaml": yaml}, lambda: yaml)
        return DONE
    if check:
        table = rows(made, settings)
        topics = {"robot": made.name, "topics": [row._asdict() for row in table]}
        answer(as_json, lambda: topics, lambda: columns(table))
        return DONE
    to = out or Path("runs/ros2") / f"{made.name}.h5"
    run, pressed = control(settings, file, experiment, made, seconds, wait, to, force)
    outcome = run.outcome
    facts = {"status": outcome.status, "time": outcome.time, "message": outcome.message, "recording": str(run.path)}
    text = f"{outcome.status} after {outcome.time:.3f} s: {outcome.message}".rstrip(": ")
    answer(as_json, lambda: facts, lambda: text)
    if pressed and outcome.signal == SIGNAL[PRESSED]:  # which stops the robot as a trip does
        return STOPPED
    return {"completed": DONE, "interrupted": STOPPED}.get(outcome.status, FAILED)


def columns(table: list[Row]) -> str:
    """Topics, one a line, what is said of them below each other."""
    width = [max(len(row[i]) for row in table) for i in range(3)]
    return "\n".join(
        "  ".join((*(f"{row[i]:{width[i]}}" for i in range(3)), f"{row.qos}: {row.what}")) for row in table
    )


def asked(settings: Node, file: Path) -> tuple[Experiment, Robot]:
    """The experiment with the settings' changes, and its robot; the wiring is checked.

    Raises:
        InputError: They do not fit each other; with the line.
    """
    from ..deploy.ros2.wiring import interfaces
    from ..lab.experiments.config import load_experiment

    period, duration = 1.0 / settings.rate, 10.0
    step = period / math.ceil(period / COARSEST - 1e-9)
    times = [f"time.control_period={period!r}", f"time.plant_step={step!r}"]
    times += [f"time.duration={round(duration / period) * period!r}"]

    def build() -> tuple[Experiment, Robot]:
        changes = [f"robot={quoted(settings.robot)}", *times, *settings.changes]
        experiment = load_experiment(settings.experiment, changes)
        experiment = replace(experiment, latency=settings.latency_of(experiment.latency))
        robot = experiment.load_robot()
        interfaces(robot, settings)
        return experiment, robot

    return with_lines(build, settings, file)


def with_lines(make: Callable[[], Made], settings: Node, file: Path) -> Made:
    """What a function makes of the settings; what is wrong with them gets their file and line.

    Raises:
        InputError: It fails.
    """
    from ..deploy.ros2.reading import line_of

    try:
        return make()
    except InputError as error:
        text = read_text(file)
        if error.file is None or Path(error.file).suffix == ".toml":
            own = error.key is not None and error.key.partition(".")[0] in settings.set
            error.key = f"set.{error.key}" if own else error.key
            error.file, error.line = file, line_of(text, error.key or "")
        raise


def control(
    settings: Node,
    file: Path,
    experiment: Experiment,
    robot: Robot,
    seconds: float,
    wait: float,
    out: Path,
    force: bool,
) -> tuple[Recording, bool]:
    """Run the node; its recording, and whether Ctrl-C came.

    Raises:
        InputError: The package for DDS is missing, the robot is not there, settings that do not fit.
    """
    try:
        import cyclonedds  # noqa: F401
    except ImportError as error:
        raise ConfigError("ROS 2 without DDS", why=str(error), fix="pip install 'mmnn_pin[ros2]'") from error
    from ..deploy.ros2.node import Bridge
    from ..deploy.ros2.wiring import interfaces
    from ..loop.stepper import Stepper
    from ..safety import Safety

    compile_if_cold(True)
    loop = experiment.loop(robot, experiment.controller(settings.controller, robot=robot))
    more: dict[str, Any] = {"limits": settings.limits, "setpoint_timeout": settings.setpoint_timeout}
    more |= {
        "interfaces": interfaces(robot, settings),
        "path": out,
        "force": force,
    }
    more |= {"safety": loop.safety or Safety(torque="urdf"), "meta": {"config": experiment.to_json()}}
    with experiment.in_its_keys("set."):
        made = with_lines(lambda: Stepper.of(loop, **more), settings, file)
    with made as stepper, Bridge(stepper, settings, note) as node:
        motion = None
        if settings.follow == "experiment":
            motion = stepper.plan(loop.trajectory, experiment.time.duration, from_here=True)
            seconds = min(seconds, experiment.time.duration)
        note(f"{robot.name} at {settings.rate:g} Hz in domain {settings.network.domain}, as {file} says")
        return node.run(wait, seconds, motion), bool(node.stopped)
