"""A task of the contest: robot, training motion, held-out trajectories, and what the reference asks of the motors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from typing import Any

import msgspec
import numpy as np

from mmnn_pin.disturbance import Payload, payload
from mmnn_pin.errors import ConfigError, InputError, RecordingError
from mmnn_pin.lab.experiments.cases import with_case
from mmnn_pin.lab.experiments.controllers import EFFECTIVE
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.lab.experiments.runner import require_runnable
from mmnn_pin.lab.psi.held_out import HeldOut, all_held_out, recorded_under_computed_torque, whole_reference
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.loop import Loop
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robot import Robot, carrying, speed_limits
from mmnn_pin.signals import Array, Layout
from mmnn_pin.torque.controller import CompiledController, Feedback

from .settings import ONLY, Contest, ContestExperiment

PLACES = 500  # along the reference, at which torques are computed


@dataclass(frozen=True, eq=False)
class Task:
    """A task.

    Attributes:
        name: Of its case.
        title: In a few words.
        experiment: All that defines it.
        contest: What the contest asks.
        robot: The true robot before it picks up what it may pick up.
    """

    name: str
    title: str
    experiment: Experiment
    contest: Contest
    robot: Robot

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of its runs."""
        return tuple(self.experiment.seed + i for i in range(self.contest.seeds))

    @property
    def since(self) -> float:
        """When its last change happens, from which the learning time counts: a payload picked up or put down [s]."""
        load = self.load
        return 0.0 if load is None else load.end if self.puts_down else load.start

    @property
    def puts_down(self) -> bool:
        """Whether it puts its payload down before the training ends."""
        return self.load is not None and self.load.end < self.experiment.time.duration

    @property
    def load(self) -> Payload | None:
        """What it picks up."""
        return payload(self.experiment.disturbances)[1]

    @cached_property
    def held_out(self) -> dict[str, HeldOut]:
        """Trajectories that no learner is trained on, by name."""
        return all_held_out(self.experiment, self.robot)

    @cached_property
    def at_the_end(self) -> Robot:
        """The true robot at the end of the training: with its payload, unless that was put down."""
        load = self.load
        return self.robot if load is None or self.puts_down else carrying(self.robot, load.mass, load.joint, load.at)

    @cached_property
    def rows(self) -> dict[str, Array]:
        """Rows (N, width) of the held-out trajectories under computed torque, with exact sensors.

        Raises:
            RecordingError: The robot is lost on one of them.
        """
        feedback: Feedback = self.controller("computed_torque").feedback
        kinematic, timing = self.experiment.kinematic, self.experiment.time
        found = {}
        for name, wanted in self.held_out.items():
            try:
                found[name] = recorded_under_computed_torque(self.at_the_end, wanted, feedback, kinematic, timing)
            except RecordingError as error:
                raise error.but(key=f"cases.{self.name}: held_out.{name}") from error
        return found

    def controller(self, name: str) -> Any:
        """A controller for the robot as it is believed to be, without payload."""
        return self.experiment.controller(name, robot=self.robot)

    def training(self, controller: Any, seed: int) -> Loop:
        """The closed loop of a training run."""
        return replace(self.experiment.loop(self.robot, controller), seed=seed)

    def held_out_loop(self, controller: Any, seed: int, name: str, learning: bool) -> Loop | None:
        """The closed loop on a held-out trajectory, from its first point on; None for weights that cannot be fixed."""
        judged = controller if learning else frozen(controller)
        if judged is None:
            return None
        loop, wanted = self.training(judged, seed), self.held_out[name]
        changed = self.at_the_end is not self.robot
        return replace(
            loop,
            robot=self.at_the_end,
            nominal=(loop.nominal or self.robot) if changed else loop.nominal,
            trajectory=wanted.trajectory,
            timing=msgspec.structs.replace(loop.timing, duration=wanted.duration),
            start=Start(moving=True),
            disturbances=(),
            check_gains=False,
        )


def frozen(controller: Any) -> Any:
    """The controller with its weights held fixed; itself where it has none, None where they cannot be held fixed."""
    if is_dataclass(controller) and any(field.name == "learning" for field in fields(controller)):
        return replace(controller, learning=False)  # type: ignore[type-var]
    return controller if isinstance(controller, CompiledController) else None


def tasks_of(
    experiment: ContestExperiment, controllers: tuple[str, ...], progress: Callable[[str], None] = lambda name: None
) -> list[Task]:
    """All tasks of a contest, made and judged before anything is run.

    Args:
        experiment: The contest; its cases are the tasks, without any it is the only one.
        controllers: Who takes part.
        progress: Called with the name of every task.

    Raises:
        ConfigError: A controller that needs another's run.
        InputError: A robot, reference or gain that cannot be, with its case.
    """
    borrowed = [name for name in controllers if name in EFFECTIVE]
    if borrowed:
        raise ConfigError(
            f"{borrowed[0]} takes no part in a contest",
            why=f"its gain is that of {EFFECTIVE[borrowed[0]]}'s run",
            fix="leave it out",
            key="controllers",
        )
    found = []
    for name in tuple(experiment.cases) or ("",):
        progress(name)
        full = with_case(experiment, name) if name else experiment
        one, contest = full.ordinary, full.contest
        if not names_its_own(experiment, name):
            one = msgspec.structs.replace(one, controllers=controllers, laws=experiment.laws)
        try:
            title = experiment.cases[name].title if name else one.title
            task = Task(name or ONLY, title, one, contest, one.load_robot())
            require_windows(one, contest)
            require_runnable(one, task.robot)
            _ = task.held_out
        except InputError as error:
            raise error.but(key=f"cases.{name}: {error.key or ''}".rstrip(": ") if name else error.key) from error
        found.append(task)
    return found


def names_its_own(experiment: Experiment, name: str) -> bool:
    """Whether a case says itself which controllers run in it."""
    case = experiment.cases.get(name)
    return case is not None and "controllers" in (case.own if case.experiment else case.set)


def require_windows(experiment: Experiment, contest: Contest) -> None:
    """Refuse no window for the errors, windows of the curves longer than a run, and a start without a sample.

    Raises:
        ConfigError: With the key.
    """
    time = experiment.time
    if not experiment.windows:
        raise ConfigError(
            "no windows",
            why="the errors count in the last",
            fix="give at least one, [start, end] in seconds",
            key="windows",
        )
    for name in ("window", "start"):
        value = getattr(contest, name)
        if not time.control_period <= value <= time.duration:
            raise ConfigError(
                f"{value:g} s",
                fix=f"use a time from the control period, {time.control_period:g} s, to the duration, "
                f"{time.duration:g} s",
                key=f"contest.{name}",
            )


def late_windows(tasks: Sequence[Task]) -> list[str]:
    """A note on tasks whose last window, in which the errors count, begins when the training is over; or none."""
    found = []
    for task in tasks:
        (start, stop), end = task.experiment.windows[-1], task.experiment.time.duration
        if start >= end:
            found.append(f"{task.name} ({start:g}-{stop:g} s of {end:g} s)")
    return (
        [
            "no errors where the last window begins after the end of the training: "
            + ", ".join(found)
            + "; set windows, too"
        ]
        if found
        else []
    )


@dataclass(frozen=True)
class Demand:
    """Largest share of the motors' limits along a reference that is followed exactly; 0 for motors without a limit.

    Attributes:
        motors: Names.
        speed: (motors,) speed over the speed limit.
        torque: (motors,) torque over the effort limit, that of the robot as the training starts.
    """

    motors: tuple[str, ...]
    speed: tuple[float, ...]
    torque: tuple[float, ...]

    def to_dict(self) -> dict[str, Any]:
        """Motor to its shares."""
        each = zip(self.motors, self.speed, self.torque, strict=True)
        return {motor: {"speed": speed, "torque": torque} for motor, speed, torque in each}


def demand(task: Task) -> Demand:
    """What a task's reference asks: rates `E' nu_ref` (wheels roll) and torques `E^-1 Psi` at `nudot_ref`."""
    robot, layout = task.robot, Layout.of(task.robot.dimensions)
    rows = whole_reference(task.experiment, robot)
    nu = np.hstack([rows[:, layout.where(name)] for name in ("velocity_ref", "qdot_ref")])
    nudot = np.hstack([rows[:, layout.where(name)] for name in ("acceleration_ref", "qddot_ref")])
    table = rows[:, layout.where("pose_ref").start : layout.where("qddot_ref").stop]
    speed = np.abs(nu @ robot.E).max(axis=0) / speed_limits(robot)
    dynamics, psi, torque = Dynamics(robot), np.zeros(layout.dof), np.zeros(len(robot.actuator_names))
    inverse = np.linalg.pinv(robot.E)
    for k in np.unique(np.linspace(0, len(table) - 1, PLACES).astype(int)):
        position, _ = Start().state(robot, table[k])
        dynamics.refresh(position, nu[k])
        dynamics.refresh_psi(nu[k], nudot[k], psi)
        torque = np.maximum(torque, np.abs(inverse @ psi))
    return Demand(tuple(robot.actuator_names), tuple(speed.tolist()), tuple((torque / robot.effort_limits).tolist()))


def held_out_torque(task: Task) -> dict[str, float]:
    """Largest share of a motor's torque limit on each held-out trajectory, of the robot as it is there, with its load.

    Raises:
        RecordingError: The robot is lost on one of them.
    """
    layout, inverse = Layout.of(task.robot.dimensions), np.linalg.pinv(task.robot.E)
    return {
        name: float((np.abs(rows[:, layout.where("psi")] @ inverse.T) / task.robot.effort_limits).max())
        for name, rows in task.rows.items()
    }
