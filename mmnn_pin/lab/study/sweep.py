"""One setting swept: every controller at every value, on equal draws of the robot's masses and of the seed.

A controller that holds on the robot as its file says may not hold on the one that stands there. So every value is tried
on several robots, whose masses are not quite those of the file, and by a controller that does not know this. The rows
are those of a study, and are judged by the same code.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ...errors import ConfigError, UnknownName
from ...loop.batch import BatchRun, simulate_many
from ...loop.loop import Loop
from ...model.robot import Robot
from ...recording.versions import versions
from ...reference import Trajectory
from ...settings import plain
from ...settings.arguments import checked_but, fits, shortly
from ...shown import ShownPicture, ShownTable, shown
from ..experiments.compare import Assembled, Controllers, assembled
from ..experiments.controllers import EFFECTIVE
from .choice import ASKED, MARGIN, Level, best_of, levels
from .factors import Factor
from .results import Results, require_patterns, units_of, value_of
from .settings import StudySettings
from .store import TrialResult

LIGHT, HEAVY = 0.8, 1.25  # masses of the robots that are tried, over those of the file
RUNS = 8  # of every controller at every value: fewer give no interval of a median
IN_MEMORY = Path("in memory")


@dataclass(frozen=True, repr=False)
class Sweep:
    """The results of a sweep; `print` shows a line for every value.

    Attributes:
        results: The rows, as of a study.
        key: What was swept.
    """

    results: Results
    key: str

    def errors(self, controller: str) -> dict[Any, Level]:
        """Every value with its rate of completed runs and the medians of its metrics, with 95 % intervals.

        Raises:
            UnknownName: There is no such controller.
        """
        if controller not in self.results.controllers:
            raise UnknownName("controller", controller, self.results.controllers)
        return {level.value: level for level in levels(self.results, controller, self.key)}

    @property
    def best(self) -> dict[str, Any]:
        """The best value of every controller; None where no run completes.

        Values with less delay margin than `latency.margin` asks for come last, then count most runs that complete, then
        the smallest errors.
        """
        found = {name: best_of(levels(self.results, name, self.key)) for name in self.results.controllers}
        return {name: None if level is None else level.value for name, level in found.items()}

    def table(self) -> ShownTable:
        """A line for every value, and which to take; it prints as text."""
        made: ShownTable = shown(self, "table")
        return made

    def plot(self) -> ShownPicture:
        """Error against the value with intervals; `.save("sweep.svg")` writes it."""
        made: ShownPicture = shown(self, "plot")
        return made

    def __repr__(self) -> str:
        ends = ", ".join(f"{name} best at {value}" for name, value in self.best.items())
        return f"<Sweep of {self.key}: {ends}>"

    def __str__(self) -> str:
        return str(self.table())

    def _repr_html_(self) -> str:
        return self.table()._repr_html_() + self.plot()._repr_html_()


@checked_but("robot", "trajectory", "values")
def sweep(  # noqa: PLR0913 - options, by keyword alone
    robot: Robot,
    trajectory: Trajectory,
    key: str,
    values: Sequence[Any],
    controllers: Controllers = ("pd",),
    *,
    runs: int = RUNS,
    masses: tuple[float, float] = (LIGHT, HEAVY),
    duration: float | None = None,
    settings: Mapping[str, Any] | None = None,
    metrics: Sequence[str] | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Sweep:
    """Run controllers at every value of a setting, several times each, and say which value is best.

    Args:
        robot: The robot.
        trajectory: What it should do.
        key: What to sweep, a key of an experiment as `--set` takes it, such as `feedback.arm`.
        values: Its values.
        controllers: As of `compare`. A gain of `feedback` counts for those that are not given one.
        runs: Runs of every controller at every value: each has its own seed, and a robot with other masses.
        masses: Least and largest factor on the masses of that robot, which the controller does not know.
        duration: As of `compare`.
        settings: As of `compare`.
        metrics: What to judge by, names as in `Recording`'s metrics, `*` for all; the RMS errors by default.
        workers: Threads; by default one per core.
        progress: Called with the number of runs done and of all runs.

    Raises:
        InputError: As of `compare`; a value that cannot be, a metric that there is not, or no runs.

    >>> robot = load("platform_arm")
    >>> path = Trajectory.of(robot, base=Line(speed=0.3), arm={"arm_1_joint": Sine(0.5, period=4.0)})
    >>> found = sweep(robot, path, "feedback.arm", [1.0, 5.0, 80.0], runs=2, duration=0.4)
    >>> found.best  # at 80 the sampled loop is unstable
    {'pd': 5.0}
    """
    require_sweep(values, runs, masses)
    jobs: list[tuple[Any, int, str, Loop]] = []
    for value in values:
        made = assembled(robot, trajectory, controllers, duration=duration, settings={**(settings or {}), key: value})
        require_no_schedules(made)
        jobs += [(value, i, name, loop) for i in range(runs) for name, loop in loops_of(made, i, runs, masses)]
    windows = made.windows
    done = simulate_many([loop for *_, loop in jobs], windows=windows, workers=workers, progress=progress)
    names = list(done[0].metrics)
    patterns = tuple(metrics) if metrics is not None else rms(names, windows[-1])
    require_patterns(patterns, names, "metrics")
    rows = [row_of(n, key, job, run) for n, (job, run) in enumerate(zip(jobs, done, strict=True))]
    factors = {key: Factor(grid=tuple(plain(value) for value in values))}
    about = StudySettings(experiment="", title=f"{key} of {robot.name}", seeds=1, metrics=patterns, factors=factors)
    facts = {"controllers": list(made.controllers), "versions": versions(), "settings": plain(about), "file": ""}
    kept = [row for row in rows if row.status != "interrupted"]
    units = units_of(names, robot)
    return Sweep(Results(IN_MEMORY, key, about, len(rows), kept, [], patterns, units, facts), key)


def require_sweep(values: Sequence[Any], runs: int, masses: tuple[float, float]) -> None:
    """Refuse a sweep of nothing, and robots that cannot be (`ConfigError`)."""
    if not fits(values, Sequence[Any]):
        raise ConfigError(
            f"{shortly(values)} is no list", fix=f"give a list of values: [{shortly(values)}]", key="values"
        )
    if not len(values):
        raise ConfigError("no values, so no runs", fix="give a list of values", key="values")
    if runs < 1:
        raise ConfigError(f"{runs} runs", fix="give at least one; 6 or more give intervals", key="runs")
    if len(masses) != 2 or not 0 < masses[0] <= masses[1] < np.inf:
        raise ConfigError(f"{masses}", fix="give the least and the largest factor, both > 0", key="masses")


def require_no_schedules(made: Assembled) -> None:
    """Refuse controllers that take the gain of another one's run (`ConfigError`)."""
    for name in made.controllers:
        if name in EFFECTIVE and name not in made.own:
            why = "it takes the gain of a learner's run"
            raise ConfigError(f"{name} is not swept", why=why, fix="leave it out", key="controllers")


def loops_of(made: Assembled, i: int, runs: int, masses: tuple[float, float]) -> list[tuple[str, Loop]]:
    """The loops of draw i by controller: equal seeds and masses at every value, evenly spread; the first is the file's.

    A draw is the middle of one of equally likely slices, so that few of them cover the range.
    """
    seeded = msgspec.structs.replace(made, seed=made.seed + i)
    share = (i - 0.5) / max(runs - 1, 1)
    true = made.load_robot() if i == 0 else made.load_robot().with_masses(masses[0] + share * (masses[1] - masses[0]))
    found = []
    for name in made.controllers:
        loop = seeded.loop(true, seeded.controller(name, robot=made.load_robot()))
        found.append((name, replace(loop, nominal=made.load_robot(), check_gains=False)))
    return found


def row_of(number: int, key: str, job: tuple[Any, int, str, Loop], run: BatchRun) -> TrialResult:
    """A run as the row of a study, with its delay margin and the one that is asked for."""
    (value, draw, controller, loop), end = job, run.outcome
    margins = {MARGIN: loop.delay_margin(), ASKED: loop.latency.margin + loop.latency.total}
    return TrialResult(
        id=number, status=end.status, time=end.time, signal=end.signal, message=end.message,
        metrics=run.metrics | margins,
        point=draw, controller=controller, seed=draw, parameters={key: plain(value)},
    )  # fmt: skip


def rms(names: Sequence[str], window: tuple[float, float]) -> tuple[str, ...]:
    """Patterns of the RMS errors of a window, those that a robot has: of the base's place, and of the joints."""
    end = "rms_{:g}_{:g}".format(*window)
    every = (f"pose_error.[xy].{end}", f"e.*.{end}")
    return tuple(pattern for pattern in every if value_of(dict.fromkeys(names, 0.0), pattern) == 0.0)
