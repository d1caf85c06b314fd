"""Calibration: the unstated numbers that meet the figures' intervals, found by a search that anyone can repeat."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mmnn_pin.lab.experiments.figure_ranges import figure_intervals
from mmnn_pin.signals import Array

from .search import search
from .unstated import CASES, Case, at, cost_of, distances, extremes, loops, met


@dataclass(frozen=True)
class Budget:
    """How much is tried.

    Attributes:
        searches: Searches per case, each with a seed of its own.
        trials: Trials per search.
        seeds: Other seeds of the initial weights with which the best is run again.
    """

    searches: int = 2
    trials: int = 360
    seeds: int = 20


@dataclass(frozen=True)
class Trials:
    """All trials of one search: places in the unit cube (n, d), extremes (n, 12), costs (n,)."""

    seed: int
    places: Array
    extremes: Array
    costs: Array

    @property
    def best(self) -> int:
        """The trial of least cost."""
        return int(np.argmin(self.costs))


def trials_of(case: Case, budget: Budget, seed: int, control_period: float = 0.002) -> Trials:
    """One search."""
    found: list[Array] = []

    def cost(places: Array) -> Array:
        found.append(extremes([loops(case, at(case.numbers, place), control_period) for place in places]))
        return cost_of(found[-1])

    places, costs = search(cost, len(case.numbers), budget.trials, seed)
    return Trials(seed, places, np.vstack(found), costs)


def calibrate(budget: Budget, say: Callable[[str], None]) -> tuple[dict[str, Any], dict[str, list[Trials]]]:
    """All cases: the summary for JSON, and the trials."""
    summary: dict[str, Any] = {}
    tried: dict[str, list[Trials]] = {}
    for case in CASES:
        tried[case.name] = []
        for seed in range(budget.searches):
            tried[case.name].append(trials_of(case, budget, seed))
            last = tried[case.name][-1]
            say(f"{case.name}, search {seed + 1} of {budget.searches}: {met(last.extremes[last.best])} of 12")
        summary[case.name] = summary_of(case, tried[case.name], budget)
    return summary, tried


def summary_of(case: Case, tried: Sequence[Trials], budget: Budget) -> dict[str, Any]:
    """What a case gave, for JSON."""
    best = min(tried, key=lambda trials: trials.costs.min())
    values = at(case.numbers, best.places[best.best])
    own, *others = extremes([loops(case, values, seed=seed) for seed in range(1, 2 + budget.seeds)])  # fitted with 1
    return {
        "title": case.title,
        "hidden": case.hidden,
        "trials": int(sum(len(trials.costs) for trials in tried)),
        "searches": [
            {"seed": t.seed, "met": int(met(t.extremes[t.best])), "cost": float(t.costs.min())} for t in tried
        ],
        "numbers": [asdict(number) for number in case.numbers],
        "values": values,
        "met": int(met(own)),
        "met_with_other_initial_weights": met(np.array(others)).tolist(),
        "intervals": intervals(own),
    }


def intervals(found: Array) -> list[dict[str, Any]]:
    """The twelve intervals beside the extremes (12,) found."""
    rows = zip(figure_intervals(), found, distances(found), strict=True)
    return [
        {
            "figure": known.figure,
            "curve": known.curve,
            "statistic": known.statistic,
            "lower": known.lower,
            "upper": known.upper,
            "unit": known.unit,
            "value": float(value),
            "widths_outside": float(away),
        }
        for known, value, away in rows
    ]
