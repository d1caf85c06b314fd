"""What a contest gave: trials, learning times, and the targets: medians over the seeds, met or not met."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from statistics import median
from typing import Any

from ...settings import finite
from ..experiments.contest import Contest
from ..experiments.controllers import ORACLES
from ..experiments.experiment import Experiment
from .task import Demand
from .trial import Trial, TrialResult, as_json, middle, nan

BASELINE = "pd"
FIXED = (BASELINE, "pd_gravity", "pid", "nominal")  # they learn nothing of Psi
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
    experiment: Experiment
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
        return self.experiment.contest or Contest()

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
        """Learning time per seed [s], inf where it never learned, nan without PD beside it; see `learning_time`."""
        pd = {row.seed: row for row in self.of(task, BASELINE)}
        contest = self.contest
        return [
            learning_time(row, pd[row.seed], contest.window, contest.learned) if row.seed in pd else math.nan
            for row in self.of(task, controller)
        ]

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


def learning_time(row: TrialResult, pd: TrialResult, window: float, learned: float) -> float:
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


@dataclass(frozen=True)
class Target:
    """One target.

    Attributes:
        about: What is asked, in words.
        limit: The number that is asked for.
        reached: The number that was reached; None where nobody could be judged.
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
        return asdict(self)


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
    for law, about in ((asked.printed, "as printed"), (asked.task, "tuned as the others")):
        for how in ("learning", "frozen") if law else ():
            thesis = held_out(of(law, THESIS), how)
            found.append(better(learners, asked.task, thesis, f"{about}, {how}", asked.better, of, how))
    knowing = [name for name in learners if contest.knowledge_of(name) == "kinematics"]
    found += [near(knowing, asked.task, how, asked.near, of) for how in ("learning", "frozen")]
    if asked.poor:
        bounded = f"after '{asked.poor}', in training and held out, bounded"
        found.append(everyone(bounded, learners, asked.poor, of, lambda row: row.survived))
        silent = f"after '{asked.poor}' say that they were not excited"
        found.append(everyone(silent, learners, asked.poor, of, lambda row: row.not_excited))
    judged = [task for task in (asked.task, asked.rich, asked.poor) if task]
    return [
        *found,
        kick(learners, judged, ", ".join(judged), asked.kick, of),
        kick(learners, tasks, "any task", asked.kick, of),
    ]


def lowest_fvu(names: Iterable[str], task: str, words: str, limit: float, of: Results) -> Target:
    """Lowest frozen FVU of some learners."""
    values = {name: middle([nan(row.frozen_fvu) for row in of(task, name)]) for name in names}
    return best_of(f"frozen FVU after '{task}', {words}", limit, values)


def better(
    names: Iterable[str], task: str, thesis: dict[str, float], words: str, limit: float, of: Results, how: str
) -> Target:
    """Best learner against the thesis's errors, on every axis of every held-out trajectory."""
    values = {name: least_ratio(thesis, held_out(of(task, name), how)) for name in names if name != THESIS}
    about = f"{THESIS}'s error over that of the best learner, {words}, held out, worst axis"
    return best_of(about, limit, values, largest=True)


def near(names: Iterable[str], task: str, how: str, limit: float, of: Results) -> Target:
    """Best learner that knows the kinematics against the oracle on every axis of every held-out trajectory."""
    oracle = held_out(of(task, ORACLE), "learning")
    least = {name: least_ratio(oracle, held_out(of(task, name), how)) for name in names}
    values = {name: 1 / value for name, value in least.items() if value > 0}
    return best_of(f"{PRIOR['kinematics']}: error over {ORACLE}'s, {how}, held out, worst axis", limit, values)


def kick(names: Iterable[str], tasks: Iterable[str], where: str, limit: float, of: Results) -> Target:
    """Largest torque of the start on some tasks, over the limits of the motors."""
    values = {f"{name} on {task}": nan(row.kick) for task in tasks for name in names for row in of(task, name)}
    worst = max(values, key=values.__getitem__, default="")
    about = f"largest torque of the start over the motors' limits, any learner, on {where}: at most {limit:g}"
    return Target(about, limit, values.get(worst), worst, bool(values) and values[worst] <= limit)


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
