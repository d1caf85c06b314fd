"""What tuning makes small: a quantile of a metric over all of a study's draws, for one set of gains.

Gains must satisfy constraints before runs are made with them. A constraint takes the loop of a run and raises
`ConfigError` where its gains break it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np

from ...actuator import Actuator
from ...errors import ConfigError, MmnnError
from ...loop.loop import Loop
from ...sensing import Sensor
from ...signals import Array
from ...torque.neural import Neural
from ..experiments.config import value_at
from ..proof.rate import rate_of
from ..proof.subject import Subject
from .execution import Pool, execute
from .factors import Factor
from .keys import times
from .plan import Plan, plan_of
from .results import worth
from .settings import StudyFile, Tune
from .statistics import Interval, quantile
from .worker import loop_of

LOST = 1e12  # value of gains with which too many runs did not complete, times 1 + the share of those
REFUSED = 1e15  # value of gains that break a constraint, times 1 + the share of runs that do
LOOK = 1.0  # of a run, to see where the weights go before the learning rates are judged [s]


@dataclass(frozen=True)
class Score:
    """What a set of gains is worth.

    Attributes:
        metric: (n,) the metric of every run, inf where it did not complete.
        quantile: Which quantile counts.
        refused: Share of runs on which the gains break a constraint; nothing was run then.
        complaint: One of these complaints.
    """

    metric: Array
    quantile: float
    refused: float = 0.0
    complaint: str = ""

    @property
    def interval(self) -> Interval:
        """The quantile with its confidence interval."""
        return quantile(self.metric, self.quantile)

    @property
    def lost(self) -> float:
        """Share of runs that did not complete."""
        return float(np.mean(~np.isfinite(self.metric))) if len(self.metric) else 0.0

    @property
    def value(self) -> float:
        """The quantile as a number that an optimiser can take: finite, and worse the more runs are lost."""
        if self.refused:
            return REFUSED * (1.0 + self.refused)
        found = self.interval.value
        return found if math.isfinite(found) else LOST * (1.0 + self.lost)


@dataclass
class Scorer:
    """Tries gains on a study's draws.

    Args:
        study: The study.
        tune: What to look for.
        pool: Makes the runs.
        points: Number of draws; None for the study's.
        sampling_seed: Of the draws; None for the study's.
    """

    study: StudyFile
    tune: Tune
    pool: Pool
    points: int | None = None
    sampling_seed: int | None = None

    def __post_init__(self) -> None:
        self.handed: dict[str, Any] = {}

    def score(self, gains: Mapping[str, Any]) -> Score:
        """Run all draws with a set of gains.

        Raises:
            MmnnError: The pool is lost, or a run failed for a fault.
        """
        plan = self.plan(gains)
        complaints = list(violations(plan))
        if complaints:
            share = len(complaints) / len(judged(plan))
            return Score(np.zeros(0), self.tune.quantile, share, complaints[0])
        metric = np.full(len(plan), math.inf)
        for row, done in execute(self.pool, plan, map(plan.row, range(len(plan))), self.handed):
            if done.status == "failed":
                raise MmnnError(f"a run failed: {done.message}")
            metric[row.id] = worth(done.status, done.metrics, self.tune.objective)
        self.pool = replace(self.pool, first_alone=False)
        return Score(metric, self.tune.quantile)

    def plan(self, gains: Mapping[str, Any]) -> Plan:
        """The runs of one set of gains."""
        settings = msgspec.structs.replace(
            self.study.settings,
            controllers=(self.tune.controller,),
            tune=None,
            set=self.study.settings.set | dict(gains),
        )
        study = replace(self.study, settings=settings)
        return plan_of(study, sampling_seed=self.sampling_seed, points=self.points)


def settings_of(drawn: Mapping[str, Any], gains: Mapping[str, Factor], table: Mapping[str, Any]) -> dict[str, Any]:
    """Key path to value of a set of gains.

    Args:
        drawn: Name of a gain to its number.
        gains: Name of a gain to what it changes.
        table: The experiment, for gains that multiply what it has.
    """
    found = {}
    for name, number in drawn.items():
        for path in gains[name].keys or (name,):
            found[path] = times(value_at(table, path), number) if gains[name].relative else number
    return found


def stable_when_sampled(loop: Loop) -> None:
    """The PD loop alone is stable at the control period, on the true robot; see `loop/before_run.py`."""
    replace(loop, check_gains=True).require_stable_gains()


def learns_slowly_enough(loop: Loop) -> None:
    """The loop with its network, linearised, does not grow at the first second's weights; see `lab/proof/rate.py`.

    Sensors, motors and the world are left out: this is about rates, sample time and gains.
    """
    controller = loop.controller
    if not isinstance(controller, Neural) or not controller.learning:
        return
    h, given = loop.timing.control_period, loop.timing
    timing = msgspec.structs.replace(given, duration=h * max(2, round(min(LOOK, given.duration) / h)))
    ideal = replace(loop, timing=timing, plant="ideal", sensor=Sensor(), actuator=Actuator(), safety=None)
    recording = replace(ideal, disturbances=(), check_gains=False).run()
    if recording.outcome.status != "completed":
        return  # its runs will tell
    rate = rate_of(Subject.of(recording))
    if not rate.stable:
        times = 1.0 / rate.limit.min()
        what = f"learning at {times:.3g} times its largest rate" if times > 1 else "the leakage turns the weights over"
        raise ConfigError(what, why=f"spectral radius {rate.radius.max():.4g}", fix="lower F, G or beta")


# Constraints, and on how many runs of a study, evenly spread, each is judged.
CONSTRAINTS: tuple[tuple[Callable[[Loop], None], int], ...] = ((stable_when_sampled, 64), (learns_slowly_enough, 4))


def violations(plan: Plan) -> Iterator[str]:
    """Complaints about the gains of a study, one per run that breaks a constraint."""
    refused: set[int] = set()
    for constraint, most in CONSTRAINTS:
        for number in judged(plan, most):
            try:
                if number not in refused:
                    constraint(loop_of(plan.row(number).job))
            except ConfigError as error:
                refused.add(number)
                yield f"row {number}: {error.what}"


def judged(plan: Plan, most: int = CONSTRAINTS[0][1]) -> list[int]:
    """Runs on which gains are judged."""
    return sorted({int(i) for i in np.linspace(0, len(plan) - 1, min(most, len(plan)))})
