"""Runs a contest: every controller on every task, row after row kept, and goes on where it was stopped."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ...errors import InputError, RecordingError
from ..experiments.contest import Contest
from ..experiments.controllers import ORACLES
from ..experiments.experiment import Experiment
from ..experiments.runner import require_free
from .about import NAME, About, AboutTask, read_about, write_about
from .demand import Demand, demand
from .heat import Stopped, heat
from .row import Row, known, nan
from .store import Heat, Store, as_json, fingerprint
from .targets import Target, targets
from .task import Task, late_windows, tasks_of

BASELINE = "pd"
FIXED = (BASELINE, "nominal")  # they learn nothing


@dataclass(frozen=True)
class Standing:
    """What a contest gave.

    Attributes:
        name: Of the experiment.
        experiment: The contest.
        controllers: Who took part.
        tasks: Task to its title.
        demands: Task to what its reference asks of the motors.
        heats: Task and controller to what came of them.
        failed: Task and controller of a user to what it raised: its rows are missing.
        interrupted: Whether rows are missing because the user stopped it.
        folder: Where the files are.
        notes: What to know beside the numbers.
        missing: `task/controller` that are still to be run.
    """

    name: str
    experiment: Experiment
    controllers: tuple[str, ...]
    tasks: dict[str, str]
    demands: dict[str, Demand]
    heats: dict[tuple[str, str], Heat]
    failed: dict[tuple[str, str], str]
    interrupted: bool
    folder: Path | None
    notes: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()

    @property
    def contest(self) -> Contest:
        """What it asks."""
        return self.experiment.contest or Contest()

    @property
    def completed(self) -> bool:
        """Whether every run is there and reached its end."""
        return not self.interrupted and not self.failed and all(row.completed for row in self.rows)

    @cached_property
    def rows(self) -> list[Row]:
        """All rows, task after task."""
        return [row for one in self.heats.values() for row in one.rows]

    def of(self, task: str, controller: str) -> list[Row]:
        """Rows of a controller on a task, one per seed; none where it did not run."""
        one = self.heats.get((task, controller))
        return one.rows if one is not None else []

    def learning_times(self, task: str, controller: str) -> list[float]:
        """Learning time per seed [s], inf where it never learned, nan without PD beside it; see `learning_time`."""
        pd = {row.seed: row for row in self.of(task, BASELINE)}
        contest = self.contest
        return [
            learning_time(row, pd[row.seed], contest.window, contest.learned) if row.seed in pd else math.nan
            for row in self.of(task, controller)
        ]

    def step_ratio(self, task: str, controller: str) -> float:
        """Time of a controller's step over that of PD, called from Python; nan where one was not measured."""
        times = [self.heats.get((task, name)) for name in (controller, BASELINE)]
        own, pd = (nan(one.step_time) if one is not None else math.nan for one in times)
        return own / pd if pd else math.nan

    def targets(self) -> list[Target]:
        """What the contest asks of the learners, and what was reached."""
        learners = tuple(name for name in self.controllers if name not in (*FIXED, *ORACLES))
        return targets(self.contest, learners, self.tasks, self.of)

    def to_dict(self) -> dict[str, Any]:
        """The contest as the command line's JSON object."""
        rows = []
        for task, controller in self.heats:
            times = self.learning_times(task, controller)
            rows += [
                as_json(row) | {"learning_time": known(time)}
                for row, time in zip(self.of(task, controller), times, strict=True)
            ]
        steps: dict[str, dict[str, float | None]] = {task: {} for task in self.tasks}
        for (task, controller), one in self.heats.items():
            steps[task][controller] = one.step_time
        comparison = {
            "tasks": self.tasks,
            "demands": {task: found.to_dict() for task, found in self.demands.items()},
            "rows": rows,
            "step_times": steps,
            "targets": [target.to_dict() for target in self.targets()],
            "failed": {f"{task}/{controller}": error for (task, controller), error in self.failed.items()},
            "interrupted": self.interrupted,
            "notes": list(self.notes),
        }
        runs = {
            f"{task}/{controller}": {
                "file": str(self.folder / task / f"{controller}.h5") if self.folder else None,
                "outcome": one.rows[0].outcome,
            }
            for (task, controller), one in self.heats.items()
        }
        return {"experiment": self.name, "robot": self.experiment.robot, "runs": runs, "comparison": comparison}


def learning_time(row: Row, pd: Row, window: float, learned: float) -> float:
    """Time until the error stays below a share of PD's, counted from the last change of the task; inf for never.

    The error of a window is the root of the mean, over the axes, of its mean square over PD's in PD's last window.

    Args:
        row: The run.
        pd: PD's on the same task with the same seed.
        window: Length of the windows [s].
        learned: The share.
    """
    scale = [nan(value) ** 2 for value in pd.rms.values()]
    if not row.completed or not scale or not all(value > 0 for value in scale):
        return math.inf if not row.completed else math.nan
    first = round(row.since / window)
    squares = [sum(a / b for a, b in zip(mean, scale, strict=True)) / len(scale) for mean in row.curve[first:]]
    above = [k for k, value in enumerate(squares) if value > learned**2]
    if not squares or (above and above[-1] == len(squares) - 1):
        return math.inf
    return window * (above[-1] + 1) if above else 0.0


def run_contest(
    experiment: Experiment,
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
        experiment: With a `contest`; its cases are the tasks.
        name: Its name.
        out: Folder for rows and recordings; None keeps the rows in memory and no recordings.
        force: Run anew what is there.
        workers: Threads; by default one per core.
        progress: Called now and then with the task and controller, and the fraction of all that is done.
        warn: Called with every note before anything is run.

    Raises:
        InputError: A task that cannot be, before anything is run; rows of other settings and no `force`.
        RecordingError: A file that cannot be written.
    """
    contest = experiment.contest or Contest()
    wanted = [one for one in contest.beside if one not in experiment.controllers]
    controllers = (*experiment.controllers, *wanted)
    tasks = tasks_of(experiment, controllers)
    store = Store(out) if force else Store.opened(out)
    plan = [
        (task, controller, fingerprint(task, controller))
        for task in tasks
        for controller in task.experiment.controllers
    ]
    todo = [entry for entry in plan if not is_done(store, *entry)]
    require_free([out / task.name / f"{controller}.h5" for task, controller, _ in todo] if out else [], True)
    interrupted, count, failed = False, len(todo), dict[tuple[str, str], str]()
    demands, notes = {task.name: demand(task) for task in tasks}, tuple(late_windows(tasks))
    for note in notes:
        warn(note)
    about = About.of(experiment, name, controllers, {t.name: AboutTask.of(t, demands[t.name]) for t in tasks}, notes)
    if out is not None:
        write_about(out, about if force else about.after(read_about(out)))
    try:
        for k, (task, controller, mark) in enumerate(todo):
            label = f"{task.name}/{controller}"

            def show(fraction: float, label: str = label, k: int = k) -> None:
                if progress is not None:
                    progress(label, (k + fraction) / count)

            _ = task.rows  # no run where there is no held-out trajectory
            file = out / task.name / f"{controller}.h5" if out else None
            try:
                rows, step = heat(task, controller, file, workers, show)
            except InputError as error:
                if controller not in experiment.laws:
                    raise
                failed[task.name, controller] = str(error)
                continue
            store.put(label, Heat(mark, known(step), rows))
    except (Stopped, KeyboardInterrupt):
        interrupted = True
    heats = {
        (task.name, controller): store.heats[f"{task.name}/{controller}"]
        for task, controller, _ in plan
        if f"{task.name}/{controller}" in store.heats
    }
    titles = {task.name: task.title for task in tasks}
    missing = tuple("/".join(key) for task, c, _ in plan if (key := (task.name, c)) not in heats and key not in failed)
    return Standing(name, experiment, controllers, titles, demands, heats, failed, interrupted, out, notes, missing)


def opened(folder: Path) -> Standing:
    """The contest of a folder, with all tasks that it holds rows of.

    Raises:
        RecordingError: It holds none, or one whose files cannot be read.
    """
    about, store = read_about(folder), Store.opened(folder)
    if about is None:
        fix = "run the contest again, with --force or in another folder"
        raise RecordingError(f"no {NAME} beside the rows", why="an older version wrote them", fix=fix, file=folder)
    keys = [(name, controller) for name, task in about.tasks.items() for controller in task.controllers]
    heats = {key: store.heats["/".join(key)] for key in keys if "/".join(key) in store.heats}
    if not heats:
        raise RecordingError("a contest without rows", why="it was stopped before the first", file=folder)
    missing = tuple("/".join(key) for key in keys if key not in heats)
    tasks = {name: about.tasks[name] for name, _ in heats}
    titles, demands = {k: task.title for k, task in tasks.items()}, {k: task.demand for k, task in tasks.items()}
    experiment = about.contest(folder)
    name, who, rest = about.name, about.controllers, bool(missing)
    return Standing(name, experiment, who, titles, demands, heats, {}, rest, folder, about.notes, missing)


def is_done(store: Store, task: Task, controller: str, mark: str) -> bool:
    """Whether the rows are there.

    Raises:
        RecordingError: They are of other settings or another version.
    """
    found = store.heats.get(f"{task.name}/{controller}")
    if found is None:
        return False
    if found.fingerprint != mark:
        what = f"the rows of {controller} on {task.name} are of other settings or of another version"
        fix = "--force runs everything anew; or choose another folder with --out"
        raise RecordingError(what, fix=fix, file=store.folder)
    return True
