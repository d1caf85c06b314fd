"""What the rows of a contest do not say: titles, demands, what was asked; kept beside them, for report and plot."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from ...errors import InputError, RecordingError
from ..experiments.config import without_null
from ..experiments.experiment import Experiment
from .demand import Demand
from .store import write
from .task import Task

NAME = "contest.json"


class AboutTask(msgspec.Struct, frozen=True):
    """A task.

    Attributes:
        title: In a few words.
        controllers: Who runs in it.
        demand: What its reference asks of the motors.
    """

    title: str
    controllers: tuple[str, ...]
    demand: Demand

    @classmethod
    def of(cls, task: Task, demand: Demand) -> AboutTask:
        """That of a task."""
        return cls(task.title, task.experiment.controllers, demand)


class About(msgspec.Struct, frozen=True):
    """A contest without its rows.

    Attributes:
        name: Of the experiment.
        experiment: The contest without its cases, as JSON has it.
        controllers: Who took part.
        tasks: By name.
        notes: What to know beside the numbers.
    """

    name: str
    experiment: dict[str, Any]
    controllers: tuple[str, ...]
    tasks: dict[str, AboutTask]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        name: str,
        controllers: tuple[str, ...],
        tasks: Mapping[str, AboutTask],
        notes: tuple[str, ...],
    ) -> About:
        """That of a contest."""
        table = msgspec.json.decode(msgspec.structs.replace(experiment, cases={}).to_json())
        return cls(name, table, controllers, dict(tasks), notes)

    def after(self, earlier: About | None) -> About:
        """This one with the tasks and controllers of an earlier command, whose rows stay in the folder."""
        if earlier is None:
            return self
        tasks = dict(earlier.tasks)
        for name, task in self.tasks.items():
            before = tasks[name].controllers if name in tasks else ()
            tasks[name] = msgspec.structs.replace(task, controllers=both(before, task.controllers))
        controllers, notes = both(earlier.controllers, self.controllers), both(earlier.notes, self.notes)
        return msgspec.structs.replace(self, controllers=controllers, tasks=tasks, notes=notes)

    def contest(self, folder: Path) -> Experiment:
        """The contest without its cases.

        Raises:
            RecordingError: Another version wrote it.
        """
        try:
            return msgspec.convert(without_null(self.experiment), Experiment)
        except (msgspec.ValidationError, InputError) as error:
            raise broken(folder, error) from error


def both(first: tuple[str, ...], second: tuple[str, ...]) -> tuple[str, ...]:
    """Names of two lists, each once."""
    return tuple(dict.fromkeys((*first, *second)))


def write_about(folder: Path, about: About) -> None:
    """Write it.

    Raises:
        RecordingError: It cannot be written.
    """
    write(folder / NAME, msgspec.json.encode(about))


def read_about(folder: Path) -> About | None:
    """That of a folder; None where it has none.

    Raises:
        RecordingError: It cannot be read.
    """
    file = folder / NAME
    if not file.exists():
        return None
    try:
        return msgspec.json.decode(file.read_bytes(), type=About)
    except (OSError, msgspec.DecodeError) as error:
        raise broken(folder, error) from error


def broken(folder: Path, error: Exception) -> RecordingError:
    """The error of a file that cannot be read."""
    why, fix = " ".join(str(error).split()), "run the contest again with --force, or choose another folder with --out"
    return RecordingError("cannot be read", why=why, fix=fix, file=folder / NAME)
