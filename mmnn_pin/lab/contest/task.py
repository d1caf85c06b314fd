"""A task of the contest: robot, training motion, and held-out trajectories recorded once for all learners."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import msgspec

from ...disturbance import Payload, payload
from ...errors import ConfigError, InputError, RecordingError
from ...loop.before_run import Start
from ...loop.loop import Loop
from ...model.payload import carrying
from ...model.robot import Robot
from ...signals import Array
from ...torque.controller import Feedback
from ..experiments.cases import with_case
from ..experiments.contest import ONLY, Contest
from ..experiments.controllers import EFFECTIVE
from ..experiments.experiment import Experiment
from ..experiments.runner import require_runnable
from ..proof.held_out import HeldOut, all_held_out, recorded_under_computed_torque
from .frozen import frozen


@dataclass(frozen=True, eq=False)
class Task:
    """A task.

    Attributes:
        name: Of its case.
        title: In a few words.
        experiment: All that defines it.
        robot: The true robot before it picks up what it may pick up.
    """

    name: str
    title: str
    experiment: Experiment
    robot: Robot

    @property
    def contest(self) -> Contest:
        """What the contest asks."""
        return self.experiment.contest or Contest()

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of its runs."""
        return tuple(self.experiment.seed + i for i in range(self.contest.seeds))

    @property
    def since(self) -> float:
        """When its last change happens, from which the learning time counts: a payload picked up [s]."""
        return 0.0 if self.load is None else self.load.start

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
        """The true robot at the end of the training: with its payload."""
        load = self.load
        return self.robot if load is None else carrying(self.robot, load.mass, load.joint, load.at)

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
                error.key = f"cases.{self.name}: held_out.{name}"
                raise
        return found

    def controller(self, name: str) -> Any:
        """A controller for the robot as it is believed to be, without payload."""
        return self.experiment.controller(name, robot=self.robot)

    def training(self, controller: Any, seed: int) -> Loop:
        """The closed loop of a training run."""
        return replace(self.experiment.loop(self.robot, controller), seed=seed)

    def trial(self, controller: Any, seed: int, name: str, learning: bool) -> Loop | None:
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


def tasks_of(
    experiment: Experiment, controllers: tuple[str, ...], progress: Callable[[str], None] = lambda name: None
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
        why = f"its gain is that of {EFFECTIVE[borrowed[0]]}'s run"
        raise ConfigError(f"{borrowed[0]} takes no part in a contest", why=why, fix="leave it out", key="controllers")
    found = []
    for name in tuple(experiment.cases) or ("",):
        progress(name)
        one = with_case(experiment, name) if name else experiment
        if not names_its_own(experiment, name):
            one = msgspec.structs.replace(one, controllers=controllers, laws=experiment.laws)
        try:
            task = Task(name or ONLY, experiment.cases[name].title if name else one.title, one, one.load_robot())
            require_windows(one)
            require_runnable(one, task.robot)
            _ = task.held_out
        except InputError as error:
            error.key = f"cases.{name}: {error.key or ''}".rstrip(": ") if name else error.key
            raise
        found.append(task)
    return found


def late_windows(tasks: Sequence[Task]) -> list[str]:
    """A note on tasks whose last window, in which the errors count, begins when the training is over; or none."""
    found = []
    for task in tasks:
        (start, stop), end = task.experiment.windows[-1], task.experiment.time.duration
        if start >= end:
            found.append(f"{task.name} ({start:g}-{stop:g} s of {end:g} s)")
    what = "no errors where the last window begins after the end of the training: "
    return [what + ", ".join(found) + "; set windows, too"] if found else []


def require_windows(experiment: Experiment) -> None:
    """Refuse no window for the errors, windows of the curves longer than a run, and a start without a sample.

    Raises:
        ConfigError: With the key.
    """
    contest, time = experiment.contest or Contest(), experiment.time
    if not experiment.windows:
        fix = "give at least one, [start, end] in seconds"
        raise ConfigError("no windows", why="the errors count in the last", fix=fix, key="windows")
    for name in ("window", "start"):
        value = getattr(contest, name)
        if not time.control_period <= value <= time.duration:
            fix = f"use a time from the control period, {time.control_period:g} s, to the duration, {time.duration:g} s"
            raise ConfigError(f"{value:g} s", fix=fix, key=f"contest.{name}")


def names_its_own(experiment: Experiment, name: str) -> bool:
    """Whether a case says which controllers run in it; what one that starts elsewhere has, the contest says."""
    case = experiment.cases.get(name)
    return case is not None and not case.experiment and "controllers" in case.set
