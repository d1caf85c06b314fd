"""What a contest gave: trials, learning times, and the targets: medians over the seeds, met or not met."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from statistics import median
from typing import Any

from mmnn_pin.lab.experiments.controllers import ORACLES
from mmnn_pin.settings import finite
from mmnn_pin.torque.entries import ENTRIES

from .settings import PLAIN, Contest, ContestExperiment
from .task import Demand
from .trial import Number, Trial, TrialResult, arm_of, as_json, base_of, middle, nan

BASELINE = "pd"
GRAVITY = "pd_gravity"
FIXED = tuple(entry.name for entry in ENTRIES if entry.baseline)
WAYS = ("learning", "frozen")
THESIS, ORACLE = "two_layer", "computed_torque"
PRIOR = {
    "kinematics": "knows the kinematics, not masses and friction",
    "form": "knows the form of the equations",
    "nothing": "knows nothing of the robot",
    "nominal": "knows a model with wrong masses",
}
Results = Callable[[str, str], list[TrialResult]]


@dataclass(frozen=True)
class Standing:
    """What a contest gave.

    Attributes:
        name: Of the experiment.
        experiment: The contest.
        controllers: Who took part.
        tasks: Task to its title.
        demands: Task to what its reference asks of the motors.
        trials: Task and controller to its trial.
        failed: Task and controller of a user to what it raised: its rows are missing.
        interrupted: Whether rows are missing because the user stopped it.
        folder: Where the files are.
        notes: What to know beside the numbers.
        missing: `task/controller` that are still to be run.
    """

    name: str
    experiment: ContestExperiment
    controllers: tuple[str, ...]
    tasks: dict[str, str]
    demands: dict[str, Demand]
    trials: dict[tuple[str, str], Trial]
    failed: dict[tuple[str, str], str]
    interrupted: bool
    folder: Path | None
    notes: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()

    @property
    def contest(self) -> Contest:
        """What it asks."""
        return self.experiment.contest

    @property
    def completed(self) -> bool:
        """Whether every run is there and reached its end."""
        return not self.interrupted and not self.failed and all(one.completed for one in self.results)

    @cached_property
    def results(self) -> list[TrialResult]:
        """All results, task after task."""
        return [result for trial in self.trials.values() for result in trial.results]

    def of(self, task: str, controller: str) -> list[TrialResult]:
        """Results of a controller on a task, one per seed; none where it did not run."""
        trial = self.trials.get((task, controller))
        return trial.results if trial is not None else []

    def learning_times(self, task: str, controller: str) -> list[float]:
        """Learning time per seed [s], inf where it never learned, nan without a plain controller beside it.

        See `learning_time`.
        """
        contest = self.contest
        return [
            learning_time(row, self.plain_errors(task, row.seed), contest.window, contest.learned)
            for row in self.of(task, controller)
        ]

    def plain_errors(self, task: str, seed: int) -> list[float]:
        """Per axis the least RMS error of PD, PD with gravity and PID in the last window of the training [m, rad].

        Those that ran and reached their end count; without any it is empty.
        """
        ran = [row for name in PLAIN for row in self.of(task, name) if row.seed == seed and row.completed]
        return [min(map(nan, axis)) for axis in zip(*(row.rms.values() for row in ran), strict=True)]

    def step_ratio(self, task: str, controller: str) -> float:
        """Time of a controller's step over that of PD, called from Python; nan where one was not measured."""
        times = [self.trials.get((task, name)) for name in (controller, BASELINE)]
        own, pd = (nan(one.step_time) if one is not None else math.nan for one in times)
        return own / pd if pd else math.nan

    def targets(self) -> list[Target]:
        """What the contest asks of the learners, and what was reached."""
        learners = tuple(name for name in self.controllers if name not in (*FIXED, *ORACLES))
        return targets(self.contest, learners, self.tasks, self.of)

    def to_dict(self) -> dict[str, Any]:
        """The contest as the command line's JSON object."""
        rows = []
        for task, controller in self.trials:
            times = self.learning_times(task, controller)
            rows += [
                as_json(row) | {"learning_time": finite(time)}
                for row, time in zip(self.of(task, controller), times, strict=True)
            ]
        steps: dict[str, dict[str, float | None]] = {task: {} for task in self.tasks}
        for (task, controller), one in self.trials.items():
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
                "outcome": one.results[0].outcome,
            }
            for (task, controller), one in self.trials.items()
        }
        return {"experiment": self.name, "robot": self.experiment.robot, "runs": runs, "comparison": comparison}


def learning_time(row: TrialResult, rivals: Sequence[float], window: float, learned: float) -> float:
    """Time until the error stays below a share of the rivals', counted from the last change of the task; inf for never.

    Args:
        row: The run.
        rivals: Errors of plain controllers on the same task with the same seed, see `Standing.plain_errors`.
        window: Length of the windows [s].
        learned: The share.
    """
    if not row.completed:
        return math.inf
    if not (errors := relative_errors(row, rivals)):
        return math.nan
    later = errors[round(row.since / window) :]
    above = [k for k, error in enumerate(later) if error > learned]
    if not later or (above and above[-1] == len(later) - 1):
        return math.inf
    return window * (above[-1] + 1) if above else 0.0


def relative_errors(row: TrialResult, rivals: Sequence[float]) -> list[float]:
    """Error of every window over the rivals': root of the mean, over the axes, of the squared ratio; empty without."""
    scale = [value**2 for value in rivals]
    if not scale or not all(value > 0 for value in scale):
        return []
    means = (sum(a / b for a, b in zip(window, scale, strict=True)) / len(scale) for window in row.curve)
    return [math.sqrt(mean) for mean in means]


@dataclass(frozen=True)
class Target:
    """One target.

    Attributes:
        about: What is asked, in words.
        limit: The number that is asked for.
        reached: The number that was reached, inf where a run was lost; None where nobody could be judged.
        by: Who reached it.
        met: Whether that is enough.
    """

    about: str
    limit: float
    reached: float | None
    by: str
    met: bool

    def to_dict(self) -> dict[str, Any]:
        """The target for JSON."""
        return asdict(self) | {"reached": None if self.reached is None else finite(self.reached)}


def targets(contest: Contest, learners: tuple[str, ...], tasks: Iterable[str], of: Results) -> list[Target]:
    """All targets.

    Args:
        contest: What is asked.
        learners: Who learns.
        tasks: Names of all tasks.
        of: Gives the results of a controller on a task.
    """
    asked, found = contest.targets, list[Target]()
    if not asked.task:
        return found
    for prior, limit in asked.frozen_fvu.items():
        names = [name for name in learners if contest.knowledge_of(name) == prior]
        found += [lowest_fvu(names, task, PRIOR[prior], limit, of) for task in (asked.task, asked.rich) if task]
    found += [better(learners, asked.task, asked.better, of, how) for how in WAYS]
    knowing = [name for name in learners if contest.knowledge_of(name) == "kinematics"]
    found += [near(knowing, asked.task, how, asked.near, of) for how in WAYS]
    found += oracle(asked.task, asked.oracle, of)
    if asked.poor:
        found += [bounded(learners, asked.poor, how, asked.bounded, of) for how in WAYS]
        silent = f"after '{asked.poor}' say that they were not excited"
        found.append(everyone(silent, learners, asked.poor, of, lambda row: row.not_excited))
    found.append(kick(learners, [task for task in tasks if of(task, ORACLE)], asked.kick, of))
    return [*found, *everywhere((*FIXED, *learners), learners, tasks, asked.first, of)]


def lowest_fvu(names: Iterable[str], task: str, words: str, limit: float, of: Results) -> Target:
    """Lowest frozen FVU of some learners; of each its worst component counts."""
    values = {name: middle([nan(row.frozen_worst) for row in of(task, name)]) for name in names}
    return best_of(f"frozen FVU after '{task}', {words}", limit, values)


def better(names: Iterable[str], task: str, limit: float, of: Results, how: str) -> Target:
    """Best learner against the thesis's errors, on every axis of every held-out trajectory."""
    thesis = held_out(of(task, THESIS), how)
    values = {name: least_ratio(thesis, held_out(of(task, name), how)) for name in names if name != THESIS}
    about = f"{THESIS}'s error over that of the best learner, tuned alike, {how}, held out, worst axis"
    return best_of(about, limit, values, largest=True)


def near(names: Iterable[str], task: str, how: str, limit: float, of: Results) -> Target:
    """Best learner that knows the kinematics against the oracle on every axis of every held-out trajectory."""
    oracle = held_out(of(task, ORACLE), "learning")
    least = {name: least_ratio(oracle, held_out(of(task, name), how)) for name in names}
    values = {name: 1 / value for name, value in least.items() if value > 0}
    return best_of(f"{PRIOR['kinematics']}: error over {ORACLE}'s, {how}, held out, worst axis", limit, values)


def oracle(task: str, limits: tuple[float, float], of: Results) -> list[Target]:
    """Held-out errors of the oracle, over all trajectories: what a model gives that is right."""
    found, rows = [], of(task, ORACLE)
    for part, unit, limit, of_axes in (("base", "mm", limits[0], base_of), ("arm", "mrad", limits[1], arm_of)):
        value = {ORACLE: 1e3 * middle([over_all(row, "learning", of_axes) for row in rows])}
        found.append(best_of(f"{ORACLE}'s error of the {part} on '{task}', held out [{unit}]", 1e3 * limit, value))
    return found


def bounded(names: Iterable[str], task: str, how: str, limit: float, of: Results) -> Target:
    """Worst learner against PD, on every axis of every held-out trajectory; a lost run has no bound."""
    pd = held_out(of(task, BASELINE), "learning")
    least = {name: least_ratio(pd, held_out(of(task, name), how)) for name in names}
    values = {name: 1 / value if value > 0 else math.inf for name, value in least.items() if not math.isnan(value)}
    return worst_of(f"after '{task}' any learner's error over PD's, {how}, held out, worst axis", limit, values)


def kick(names: Iterable[str], tasks: Iterable[str], limit: float, of: Results) -> Target:
    """Largest torque of the start of any learner over the oracle's, medians; the motors' limits do not bound it."""
    values = {}
    for task in tasks:
        least = middle([nan(row.kick) for row in of(task, ORACLE)])
        for name in names:
            own = middle([nan(row.kick) for row in of(task, name)])
            if least > 0 and not math.isnan(own):
                values[f"{name} on {task}"] = own / least
    return worst_of(f"largest torque of the start over {ORACLE}'s, any learner, any task", limit, values)


def everywhere(
    names: Iterable[str], learners: Iterable[str], tasks: Iterable[str], limit: float, of: Results
) -> list[Target]:
    """One learner for all tasks: how far it is from the least error in each, and whether PD with gravity beats it.

    The error of a task is that of base and of arm in training and held out, and the largest of the four ratios counts;
    controllers that run in a task by themselves are not compared there.
    """
    apart = distances(names, tasks, of)
    far, worse = ({name: max(found[name].values(), default=0.0) for name in learners} for found in apart)
    ran = {name: far[name] for name in far if far[name] > 0.0}
    return [
        best_of("one learner's error over the least of all without the truth, worst task", limit, ran),
        best_of(f"one learner's error over {GRAVITY}'s, worst task", 1.0, {name: worse[name] for name in ran}),
    ]


def distances(
    names: Iterable[str], tasks: Iterable[str], of: Results, shown: Iterable[str] = ()
) -> tuple[dict[str, dict[str, float]], ...]:
    """How far every controller is from the least error of a task, and from PD with gravity, as in `everywhere`.

    Args:
        names: The controllers.
        tasks: Names of all tasks.
        of: Gives the results of a controller on a task.
        shown: Controllers beside them, whose errors are never the least.

    Returns:
        Controller to task to the largest of the four ratios, to the least error and to that of PD with gravity; without
        the tasks that a controller, or PD with gravity, did not run.
    """
    names, shown = tuple(names), frozenset(shown)
    names = (*names, *shown)
    far, worse = ({name: dict[str, float]() for name in names} for _ in range(2))
    for task in tasks:
        errors = {name: task_errors(of(task, name)) for name in names}
        errors = {name: found for name, found in errors.items() if found}
        if GRAVITY not in errors:
            continue
        counted = [found for name, found in errors.items() if name not in shown]
        least = [min(column) for column in zip(*counted, strict=True)]
        for name, found in errors.items():
            far[name][task] = max(ratios(found, least))
            worse[name][task] = max(ratios(found, errors[GRAVITY]))
    return far, worse


def task_errors(rows: list[TrialResult]) -> list[float]:
    """Median errors of base and arm, in training and held out; inf for what was lost, nothing without rows."""
    if not rows:
        return []
    found = []
    for of_axes in (base_of, arm_of):
        trained = [of_axes(row.rms) if row.completed else math.inf for row in rows]
        tracked = [over_all(row, "learning", of_axes) if row.completed else math.inf for row in rows]
        found += [math.inf if any(map(math.isinf, each)) else middle(each) for each in (trained, tracked)]
    return found


def ratios(errors: list[float], others: list[float]) -> list[float]:
    """Error over error where both have one; a lost run is infinitely far from one that was not."""
    pairs = [(a, b) for a, b in zip(errors, others, strict=True) if not math.isnan(a) and b > 0]
    return [1.0 if math.isinf(a) and math.isinf(b) else a / b for a, b in pairs] or [0.0]


def over_all(row: TrialResult, how: str, of_axes: Callable[[dict[str, Number]], float]) -> float:
    """Root of the mean square error over all held-out trajectories; inf where one was lost, nan where none was run."""
    tracked = [ways[how] for ways in row.held_out.values() if how in ways]
    if any(one.outcome != "completed" for one in tracked):
        return math.inf
    return math.sqrt(sum(of_axes(one.rms) ** 2 for one in tracked) / len(tracked)) if tracked else math.nan


def worst_of(about: str, limit: float, values: dict[str, float]) -> Target:
    """Target that the largest number has to meet from below."""
    worst = max(values, key=values.__getitem__, default="")
    met = bool(values) and values[worst] <= limit
    return Target(f"{about}: at most {limit:g}", limit, values.get(worst), worst, met)


def best_of(about: str, limit: float, values: dict[str, float], largest: bool = False) -> Target:
    """Target that the smallest number has to meet from below, or the largest from above."""
    judged = {name: value for name, value in values.items() if math.isfinite(value)}
    best = (max if largest else min)(judged, key=judged.__getitem__, default="")
    met = bool(best) and (judged[best] >= limit if largest else judged[best] <= limit)
    return Target(f"{about}: at {'least' if largest else 'most'} {limit:g}", limit, judged.get(best), best, met)


def everyone(about: str, names: Iterable[str], task: str, of: Results, good: Callable[[TrialResult], bool]) -> Target:
    """Target that all learners with results on a task have to meet; the number is their share."""
    met = {name: all(map(good, results)) for name in names if (results := of(task, name))}
    missing = [name for name, one in met.items() if not one]
    if not met:
        return Target(about, 1.0, None, "", False)
    by = f"all but {', '.join(missing)}" if len(missing) < len(met) else "nobody"
    return Target(about, 1.0, (len(met) - len(missing)) / len(met), by if missing else "all", not missing)


def held_out(rows: list[TrialResult], how: str) -> dict[str, float]:
    """Median RMS error per held-out trajectory and axis; inf where a run was lost, empty without runs."""
    found: dict[str, list[float]] = {}
    for row in rows:
        for name, ways in row.held_out.items():
            for axis, value in ways[how].rms.items() if how in ways else ():
                found.setdefault(f"{name}.{axis}", []).append(math.inf if value is None else value)
    return {key: median(values) for key, values in found.items()}


def least_ratio(above: dict[str, float], below: dict[str, float]) -> float:
    """Least ratio over the axes, 0 where the run below was lost; nan where they are not the same."""
    if not above or above.keys() != below.keys() or not all(value > 0 for value in below.values()):
        return math.nan
    return min([above[key] / below[key] if math.isfinite(below[key]) else 0.0 for key in above])
