"""What tuning makes small: a quantile of a metric over all of a study's draws, for one set of gains."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np

from ...errors import MmnnError
from ...signals import Array
from .constraints import judged, violations
from .execution import execute
from .factors import Factor
from .intervals import Interval, quantile
from .keys import at, times
from .plan import Plan, plan_of
from .pools import Pool
from .reading import StudyFile
from .results import worth
from .settings import Tune

LOST = 1e12  # value of gains with which too many runs did not complete, times 1 + the share of those
REFUSED = 1e15  # value of gains that break a constraint, times 1 + the share of runs that do


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
            found[path] = times(at(table, path), number) if gains[name].relative else number
    return found
