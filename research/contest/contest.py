"""Runs a contest: every controller on every task, each trial kept in a folder when it is done; can go on later.

The folder has the results (`rows.json`, `rows.csv`), what they do not say (`contest.json`), and a recording per trial.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from mmnn_pin.errors import InputError, RecordingError
from mmnn_pin.files import DEEP, LARGEST, is_deep, locked, read_bytes, whole_file
from mmnn_pin.lab.experiments.config import without_null
from mmnn_pin.lab.experiments.runner import require_free
from mmnn_pin.lab.study.worker import code_digest
from mmnn_pin.settings import finite, plain

from .settings import ContestExperiment
from .standing import Standing
from .task import Demand, Task, demand, late_windows, tasks_of
from .trial import Stopped, Trial, as_csv, run_trial

ABOUT = "contest.json"
RESULTS, TABLE = "rows.json", "rows.csv"


def run_contest(
    experiment: ContestExperiment,
    name: str,
    *,
    out: Path | None = None,
    force: bool = False,
    workers: int | None = None,
    progress: Callable[[str, float], None] | None = None,
    warn: Callable[[str], None] = lambda note: None,
) -> Standing:
    """Run a contest. What a folder holds of the same contest is kept and the rest is run; Ctrl-C keeps what is done.

    Args:
        experiment: The contest; its cases are the tasks.
        name: Its name.
        out: Folder for results and recordings; None keeps the results in memory and no recordings.
        force: Run anew what is there.
        workers: Threads; by default one per core.
        progress: Called now and then with the task and controller, and the fraction of all that is done.
        warn: Called with every note before anything is run.

    Raises:
        InputError: A task that cannot be, before anything is run; results of other settings and no `force`.
        RecordingError: A file that cannot be written.
    """
    contest = experiment.contest
    controllers = (*experiment.controllers, *(one for one in contest.beside if one not in experiment.controllers))
    tasks = tasks_of(experiment, controllers)
    store = Store(out) if force else Store.opened(out)
    plan = [Entry(task, one, fingerprint(task, one)) for task in tasks for one in task.experiment.controllers]
    todo = [entry for entry in plan if not is_done(store, entry)]
    require_free([out / f"{entry.label}.h5" for entry in todo] if out else [], True)
    demands, notes = {task.name: demand(task) for task in tasks}, tuple(late_windows(tasks))
    for note in notes:
        warn(note)
    about = About(
        name,
        msgspec.json.decode(msgspec.structs.replace(experiment, cases={}).to_json()),
        controllers,
        {t.name: AboutTask(t.title, t.experiment.controllers, demands[t.name]) for t in tasks},
        notes,
    )
    with locked(out / RESULTS, "contest") if out is not None else nullcontext():
        if out is not None:
            store = Store(out) if force else Store.opened(out)  # another process may have gone on meanwhile
            todo = [entry for entry in plan if not is_done(store, entry)]
            write(out / ABOUT, msgspec.json.encode(about if force else about.after(read_about(out))))
        failed, interrupted = run_missing(store, todo, tuple(experiment.laws), workers, progress)
    trials = {entry.key: store.trials[entry.label] for entry in plan if entry.label in store.trials}
    missing = tuple(entry.label for entry in plan if entry.key not in trials and entry.key not in failed)
    titles = {task.name: task.title for task in tasks}
    return Standing(name, experiment, controllers, titles, demands, trials, failed, interrupted, out, notes, missing)


@dataclass(frozen=True)
class Entry:
    """A trial to be run: its task, its controller, and the fingerprint of all that decides it."""

    task: Task
    controller: str
    fingerprint: str

    @property
    def key(self) -> tuple[str, str]:
        """Names of task and controller."""
        return self.task.name, self.controller

    @property
    def label(self) -> str:
        """The same as one text."""
        return "/".join(self.key)


def run_missing(
    store: Store,
    todo: Sequence[Entry],
    own: tuple[str, ...],
    workers: int | None,
    progress: Callable[[str, float], None] | None,
) -> tuple[dict[tuple[str, str], str], bool]:
    """Run trials and store each; the errors of those that failed, and whether Ctrl-C ended them.

    Args:
        store: Takes them.
        todo: The trials.
        own: Controllers of a user, which may fail.
        workers: As in `run_contest`.
        progress: As there.
    """
    failed: dict[tuple[str, str], str] = {}
    try:
        for k, entry in enumerate(todo):

            def show(fraction: float, label: str = entry.label, k: int = k) -> None:
                if progress is not None:
                    progress(label, (k + fraction) / len(todo))

            _ = entry.task.rows  # no run where there is no held-out trajectory
            file = store.folder / f"{entry.label}.h5" if store.folder else None
            try:
                results, step = run_trial(entry.task, entry.controller, file, workers, show)
            except InputError as error:
                if entry.controller not in own:
                    raise
                failed[entry.key] = str(error)
                continue
            store.put(entry.label, Trial(entry.fingerprint, finite(step), results))
    except (Stopped, KeyboardInterrupt):
        return failed, True
    return failed, False


def is_done(store: Store, entry: Entry) -> bool:
    """Whether the results of a trial are there.

    Raises:
        RecordingError: They are of other settings or another version.
    """
    trial = store.trials.get(entry.label)
    if trial is None:
        return False
    if trial.fingerprint != entry.fingerprint:
        raise RecordingError(
            f"the rows of {entry.controller} on {entry.task.name} are of other settings or of another version",
            fix="--force runs everything anew; or choose another folder with --out",
            file=store.folder,
        )
    return True


def fingerprint(task: Task, controller: str) -> str:
    """Of all that decides the results of a controller on a task: settings, robot, code."""
    contest = task.contest
    asked = {"seeds": contest.seeds, "window": contest.window, "start": contest.start}
    cosmetic: dict[str, Any] = {"cases": {}, "title": "", "variant": "", "plots": ()}
    experiment = msgspec.structs.replace(task.experiment, controllers=(controller,), **cosmetic)
    facts = plain(task.training(task.controller(controller), task.experiment.seed).facts())  # with URDF and origin
    text = json.dumps([experiment.to_json(), asked, facts, code_digest()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def opened(folder: Path) -> Standing:
    """The contest of a folder, with all tasks that it holds rows of.

    Raises:
        RecordingError: It holds none, or one whose files cannot be read.
    """
    about, store = read_about(folder), Store.opened(folder)
    if about is None:
        raise RecordingError(
            f"no {ABOUT} beside the rows",
            why="an older version wrote them",
            fix="run the contest again, with --force or in another folder",
            file=folder,
        )
    keys = [(name, controller) for name, task in about.tasks.items() for controller in task.controllers]
    trials = {key: store.trials["/".join(key)] for key in keys if "/".join(key) in store.trials}
    if not trials:
        raise RecordingError("a contest without rows", why="it was stopped before the first", file=folder)
    missing = tuple("/".join(key) for key in keys if key not in trials)
    tasks = {name: about.tasks[name] for name, _ in trials}
    titles, demands = {k: task.title for k, task in tasks.items()}, {k: task.demand for k, task in tasks.items()}
    experiment = about.contest(folder)
    name, who, rest = about.name, about.controllers, bool(missing)
    return Standing(name, experiment, who, titles, demands, trials, {}, rest, folder, about.notes, missing)


@dataclass
class Store:
    """What is done.

    Attributes:
        folder: Where the files are; None keeps everything in memory.
        trials: `task/controller` to what came of it.
    """

    folder: Path | None
    trials: dict[str, Trial] = field(default_factory=dict)

    @classmethod
    def opened(cls, folder: Path | None) -> Store:
        """The trials of a folder; none where there is no file.

        Raises:
            RecordingError: The file is not one of rows.
        """
        file = None if folder is None else folder / RESULTS
        if file is None or not file.exists():
            return cls(folder)
        try:
            return cls(folder, msgspec.json.decode(read_bytes(file, LARGEST), type=dict[str, Trial]))
        except (OSError, ValueError, RecursionError) as error:
            raise RecordingError(
                "not a file of rows",
                why=str(error),
                fix="replace it with --force, or choose another folder with --out",
                file=file,
            ) from error

    def put(self, key: str, trial: Trial) -> None:
        """Keep what came of a controller on a task.

        Raises:
            RecordingError: The files cannot be written.
        """
        self.trials[key] = trial
        if self.folder is None:
            return
        write(self.folder / RESULTS, msgspec.json.encode(self.trials))
        write(self.folder / TABLE, as_csv([result for one in self.trials.values() for result in one.results]).encode())


class About(msgspec.Struct, frozen=True):
    """What the results do not say, for report and plot: titles, demands, what was asked.

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

    def contest(self, folder: Path) -> ContestExperiment:
        """The contest without its cases.

        Raises:
            RecordingError: Another version wrote it.
        """
        try:
            return msgspec.convert(without_null(self.experiment), ContestExperiment)
        except (msgspec.ValidationError, InputError) as error:
            raise broken(folder, error) from error


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


def both(first: tuple[str, ...], second: tuple[str, ...]) -> tuple[str, ...]:
    """Names of two lists, each once."""
    return tuple(dict.fromkeys((*first, *second)))


def read_about(folder: Path) -> About | None:
    """That of a folder; None where it has none.

    Raises:
        RecordingError: It cannot be read.
    """
    file = folder / ABOUT
    if not file.exists():
        return None
    try:
        about = msgspec.json.decode(read_bytes(file), type=About)
        if is_deep(about.experiment):
            raise ValueError(DEEP)
        return about
    except (OSError, ValueError, RecursionError) as error:  # msgspec's are values, too
        raise broken(folder, error) from error


def broken(folder: Path, error: Exception) -> RecordingError:
    """The error of a file that cannot be read."""
    return RecordingError(
        "cannot be read",
        why=" ".join(str(error).split()),
        fix="run the contest again with --force, or choose another folder with --out",
        file=folder / ABOUT,
    )


def write(path: Path, content: bytes) -> None:
    """Write a file whole or not at all.

    Raises:
        RecordingError: It cannot be written.
    """
    with whole_file(path, "contest") as part:
        part.write_bytes(content)
