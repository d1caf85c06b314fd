"""A seeded search for each learner's settings, the same number of tries for all, on trajectories of its own.

What counts is the geometric mean, over the tuning tasks, of three errors over those of PD: in the last window of the
training, on the held-out trajectories while learning, and (but for `PLAIN`) there with the final weights held fixed;
where the robot picks something up, of a fourth: in the first `SOON` seconds with it. The held-out trajectories are
driven with it, too.

`eight` searches the settings of every learner that its space names, on a robot that does not change; `payload` after it
those that forget and follow, on one that picks something up. Every task outside of the learners' model class has a
search of its own name (`OUTSIDE`), driven otherwise and with other seeds. The contest's case of a search's name has
what it found (`lines` says it as TOML; a test compares). A search that was stopped goes on: what was tried is in a
file, and is not run again.

The best of what was tried is looked at a second time before it is taken (`second_look`).
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mmnn_pin.errors import InputError
from mmnn_pin.files import whole_file
from mmnn_pin.lab.experiments.cases import chosen_cases, with_case
from mmnn_pin.lab.experiments.config import override, value_at
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.lab.study.factors import Factor
from mmnn_pin.lab.study.tuning import imported, own_gains, settings_of, suggested
from research.contest.settings import load_contest
from research.contest.task import Task, tasks_of
from research.contest.trial import TrialResult, nan, run_trial

SEED = 20100


SOON = 2.0  # after a pick-up [s]


PLAIN = ("pid",)  # what they hold says nothing of another motion: not judged frozen


LOST = 1e3  # error over PD's that a lost run counts for


TORQUE = 1.0 - 1e-6  # of the motors' limits; a run that comes to them at any time counts as lost


Say = Callable[[str], None]


def budget(bench: Bench, learners: int, tries: int) -> str:
    """How much a search runs: sets of settings, runs, and the time that they simulate."""
    runs, seconds = 0, 0.0
    for task in bench.tasks:
        held_out = [held.duration for held in task.held_out.values()]
        runs += len(task.seeds) * (1 + 2 * len(held_out))
        seconds += len(task.seeds) * (task.experiment.time.duration + 2 * sum(held_out))
    tried = learners * tries
    return (
        f"{learners} learners, {tries} sets of settings each, {len(bench.tasks)} tasks: "
        f"{tried * runs} runs of {tried * seconds / 3600:.3g} simulated hours together"
    )


@dataclass(frozen=True)
class Bench:
    """The tuning tasks, and what PD does there.

    Attributes:
        tasks: The tasks, their experiments without changes.
        pd: Task to PD's rows.
        limits: Whether a run that comes to the motors' limits counts as lost.
    """

    tasks: tuple[Task, ...]
    pd: dict[str, list[TrialResult]]
    limits: bool = True

    @classmethod
    def made(cls, tuning: str, *overrides: str) -> Bench:
        """The tasks of a tuning experiment, with PD run on them."""
        experiment = load_contest(tuning_file(tuning), overrides)
        if tuning in OUTSIDE:
            experiment = chosen_cases(experiment, [tuning])
        return cls.of(tuple(tasks_of(experiment, ("pd",))))

    @classmethod
    def of(cls, tasks: tuple[Task, ...], limits: bool = True) -> Bench:
        """Tasks, with PD run on them."""
        pd = {task.name: run_trial(task, "pd", None, None, quiet, False)[0] for task in tasks}
        return cls(tasks, pd, limits)

    def score(self, learner: str, settings: Mapping[str, Any]) -> float:
        """Geometric mean of a learner's errors over PD's, see the top of this module."""
        logs = []
        for task in self.tasks:
            try:
                changed = replace(task, experiment=changed_by(task.experiment, settings))
            except InputError:
                return LOST
            rows, _ = run_trial(changed, learner, None, None, quiet, False)
            for row, pd in zip(rows, self.pd[task.name], strict=True):
                ways = ("learning",) if learner in PLAIN else ("learning", "frozen")
                logs += [math.log(ratio) for ratio in ratios(row, pd, task.contest.window, ways, self.limits)]
        return math.exp(float(np.mean(logs)))


def quiet(fraction: float) -> None:
    """No progress."""


def changed_by(experiment: Experiment, settings: Mapping[str, Any]) -> Experiment:
    """An experiment with some settings changed.

    Raises:
        InputError: A value that cannot be.
    """
    table = msgspec.to_builtins(experiment)
    for path, value in settings.items():
        override(table, f"{path}={json.dumps(value)}")
    return msgspec.convert(table, Experiment)


def ratios(
    row: TrialResult,
    pd: TrialResult,
    window: float,
    held_out: tuple[str, ...] = ("learning", "frozen"),
    limits: bool = True,
) -> list[float]:
    """A row's errors over PD's, `LOST` for what was lost.

    Args:
        row: The run.
        pd: PD's on the same task with the same seed.
        window: Length of the windows of their curves [s].
        held_out: How the weights are there.
        limits: Whether a run that comes to the motors' limits counts as lost.

    Returns:
        In training, held out in each of these ways; where something is picked up also soon after that.
    """
    count = 1 + len(held_out) + (row.since > 0)
    if not row.completed or (limits and not nan(row.torque) < TORQUE):
        return [LOST] * count
    found = [relative(row.rms, pd.rms)]
    for how in held_out:
        each = [relative(row.held_out[name][how].rms, ways[how].rms) for name, ways in pd.held_out.items()]
        found.append(math.sqrt(sum(value**2 for value in each) / len(each)))
    if row.since > 0:
        found.append(relative(soon(row, window), soon(pd, window)))
    return [min(value, LOST) if math.isfinite(value) else LOST for value in found]


def soon(row: TrialResult, window: float) -> dict[str, float]:
    """RMS errors per axis in the first `SOON` seconds after the last change of a task.

    Args:
        row: The run, which reached its end.
        window: Length of the windows of its curve [s].
    """
    first = round(row.since / window)
    squares = np.mean(row.curve[first : first + round(SOON / window)], axis=0)
    return dict(zip(row.rms, np.sqrt(squares).tolist(), strict=True))


def relative(errors: Mapping[str, float | None], pd: Mapping[str, float | None]) -> float:
    """Root of the mean, over the axes, of the square of an error over PD's; nan where one is missing."""
    squares = [(nan(errors.get(axis)) / nan(value)) ** 2 for axis, value in pd.items()]
    return math.sqrt(sum(squares) / len(squares))


Tries = list[tuple[dict[str, Any], float]]  # settings and their score


def search(
    bench: Bench,
    learner: str,
    factors: dict[str, Factor],
    tries: int,
    say: Say,
    journal: Path | None = None,
    scores: Sequence[float] = (),
) -> Tries:
    """Look for a learner's settings.

    Args:
        bench: Where they are tried.
        learner: Whose.
        factors: What is searched.
        tries: How many sets, the experiment's own first, where they are within the bounds.
        say: Told the best so far.
        journal: File of the scores so far, which are taken from there; None keeps none.
        scores: Of the first sets, known from an earlier search of the same code in the same space: not run again.

    Returns:
        All sets in the order in which they were tried.
    """
    optuna = imported()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    table = json.loads(bench.tasks[0].experiment.to_json())
    trials = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=SEED, multivariate=True))
    own = own_gains(factors, table)
    if own is not None:
        trials.enqueue_trial(own)
    found: Tries = []
    done = json.loads(journal.read_text(encoding="utf-8")) if journal is not None and journal.exists() else []
    for k in range(tries):
        trial = trials.ask()
        drawn = {name: suggested(trial, name, factor) for name, factor in factors.items()}
        settings = {path: rounded(value) for path, value in settings_of(drawn, factors, table).items()}
        known = [score for kept, score in done[k : k + 1] if kept == settings] or list(scores[k : k + 1])
        score = known[0] if known else bench.score(learner, settings)
        found.append((settings, score))
        if journal is not None and not known:
            done = [list(one) for one in found]
            with whole_file(journal, "search") as part:
                part.write_text(json.dumps(done) + "\n", encoding="utf-8")
        trials.tell(trial, math.log(score))
        if not known:
            say(f"{learner}: {k + 1} of {tries}, {score:.4f}, best {min(one[1] for one in found):.4f}")
    return found


def rounded(value: Any) -> Any:
    """Numbers with three digits, as they are written into the experiment."""
    if isinstance(value, float):
        return float(f"{value:.3g}")
    return [rounded(each) for each in value] if isinstance(value, list | tuple) else value


HERE = Path(__file__).parent


SPACES, TUNED = HERE / "spaces.toml", HERE / "tuned.json"


def told(file: Path) -> dict[str, Any]:
    """What a TOML file says."""
    return tomllib.loads(file.read_text(encoding="utf-8"))


OUTSIDE = tuple(told(HERE / "tuning/outside.toml")["cases"])


TUNINGS = ("eight", "payload", *OUTSIDE)  # each also the case of the contest that takes what was found


TRIES = {"eight": 28, "payload": 20, **dict.fromkeys(OUTSIDE, 16)}  # sets of settings per learner


def tuning_file(tuning: str) -> Path:
    """The experiment that a search runs."""
    return HERE / "tuning" / f"{'outside' if tuning in OUTSIDE else tuning}.toml"


def spaces(tuning: str) -> dict[str, dict[str, Factor]]:
    """What is searched for each learner."""
    found = msgspec.convert(told(SPACES)["outside" if tuning in OUTSIDE else tuning], dict[str, dict[str, Factor]])
    own = told(tuning_file(tuning))["cases"][tuning]["set"].get("controllers") if tuning in OUTSIDE else None
    return {learner: space for learner, space in found.items() if own is None or learner in own}


def tuned() -> dict[str, dict[str, Any]]:
    """What was found and is kept: tuning and learner to their search."""
    kept = json.loads(TUNED.read_text(encoding="utf-8")) if TUNED.exists() else {}
    return {tuning: kept.get(tuning, {}) for tuning in TRIES}


def keep(tuning: str, learner: str, found: dict[str, Any]) -> None:
    """Keep a search beside what is there."""
    content = tuned()
    content[tuning][learner] = found
    TUNED.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def taken(tuning: str, learner: str) -> dict[str, Any]:
    """What the contest's case says of what was searched for a learner: key path to value."""
    table = json.loads(with_case(load_contest(), tuning).to_json())
    return {path: value_at(table, path) for path in tuned()[tuning][learner]["settings"]}


def lines(tuning: str) -> list[str]:
    """What was found, as the contest's case of that name says it in its table `set`, one line per learner."""
    found = []
    for one in tuned()[tuning].values():
        tables: dict[str, list[str]] = {}
        for path, value in one["settings"].items():
            table, _, key = path.rpartition(".")
            tables.setdefault(table, []).append(f"{key} = {json.dumps(value)}")
        found += [f"{table} = {{ {', '.join(sorted(pairs))} }}" for table, pairs in tables.items()]
    return sorted(found)
