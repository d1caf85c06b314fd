"""Calibration: the unstated numbers that meet the figures' intervals, and how far the figures determine them.

Anyone can repeat the search. How flat is its optimum? Three answers that need not agree: each number moved alone; all
of them together, as a random walk through everything that still meets eleven intervals; and the linear one, from the
Jacobian of the twelve extremes, which holds where it was taken: at the best, and at places of the walk.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mmnn_pin.lab.experiments.thesis import figure_intervals
from mmnn_pin.signals import Array
from research.studies.search import Number, at, search

from .unstated import AS_DRAWN, CASES, MOUNT, Case, cost_of, distances, extremes, loops, met
from .unstated import distances as distances_of


@dataclass(frozen=True)
class Budget:
    """How much is tried."""

    searches: int = 2  # searches per case, each with a seed of its own
    trials: int = 360  # trials per search
    seeds: int = 20  # other seeds of the initial weights with which the best is run again


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


ENOUGH = 11  # intervals


PERIODS = (0.001, 0.004, 0.005)  # sample times besides the calibrated 2 ms [s]


@dataclass(frozen=True)
class Effort:
    """How much is tried."""

    places: int = 21  # values per number, moved alone
    chains: int = 24  # walkers, an even number
    steps: int = 60  # steps of each
    refit: int = 180  # trials of the search at every other sample time
    slopes: int = 8  # places of the walk at which the linear answer is asked for, too


def flatness(
    case: Case, tried: Sequence[Trials], values: dict[str, float], effort: Effort, say: Callable[[str], None]
) -> Any:
    """The summary for JSON."""
    numbers = (*case.numbers, MOUNT)
    best = np.array([number.place({**values, MOUNT.name: AS_DRAWN}[number.name]) for number in numbers])
    enough = min(ENOUGH, int(met(run(case, numbers, best[None]))[0]))
    alone = moved_alone(case, numbers, best, enough, effort.places)
    say("moved every number alone")
    walked, accepted = walk(case, numbers, starts(tried, effort.chains), enough, effort)
    say(f"walked through what meets {enough}: {len(walked)} places, {accepted:.0%} of the steps accepted")
    left, singular_values = left_by_jacobian(case, numbers, best)
    last = walked[-effort.chains :]
    elsewhere = [left_by_jacobian(case, numbers, place)[0] for place in last[:: max(1, len(last) // effort.slopes)]]
    rows = []
    for i, number in enumerate(numbers):
        low, high = np.quantile(walked[:, i], (0.05, 0.95))
        rows.append(
            {
                "name": number.name,
                "unit": number.unit,
                "range": [number.lower, number.upper],
                "best": number.at(best[i]),
                "alone": [number.at(u) for u in alone[i]],
                "together": [number.at(low), number.at(high)],
                "share_left": float((high - low) / 0.9),
                "best_inside": bool(low <= best[i] <= high),
                "linear_left": float(left[i]),
                "linear_left_elsewhere": np.quantile([other[i] for other in elsewhere], (0, 0.5, 1)).tolist(),
            }
        )
    return {
        "enough": enough,
        "numbers": rows,
        "singular_values": singular_values.tolist(),
        "slopes": len(elsewhere),
        "walk": {"places": len(walked), "accepted": accepted, "chains": effort.chains, "unsure": unsure(walked)},
        "sample_times": sample_times(case, values, effort, say),
    }


def moved_alone(case: Case, numbers: Sequence[Number], best: Array, few: int, places: int) -> list[tuple[float, float]]:
    """Per number the ends of the stretch around the best in which `few` intervals stay met, as places 0 to 1."""
    grid = np.linspace(0, 1, places)
    tried = np.array([np.where(np.arange(len(best)) == i, u, best) for i in range(len(best)) for u in grid])
    enough = (met(run(case, numbers, tried)) >= few).reshape(len(best), places)
    return [stretch(grid, enough[i], best[i]) for i in range(len(best))]


def stretch(grid: Array, enough: Array, best: float) -> tuple[float, float]:
    """Ends of the unbroken stretch of good grid points around a place; the place itself where there is none."""
    low = high = best
    for u in grid[grid <= best][::-1]:
        if not enough[np.searchsorted(grid, u)]:
            break
        low = u
    for u in grid[grid >= best]:
        if not enough[np.searchsorted(grid, u)]:
            break
        high = u
    return float(low), float(high)


def left_by_jacobian(case: Case, numbers: Sequence[Number], best: Array, step: float = 0.01) -> tuple[Array, Array]:
    """Linear answer at a place, and the singular values of J.

    J is the extremes' change, in widths of their intervals, over a number's whole range.
    A uniform prior over the range and a uniform error over the interval have the same variance, 1/12, so that the share
    of a number's spread that the twelve intervals leave is `sqrt(diag((I + J' J)^-1))`.
    """
    middle = np.clip(best, step, 1 - step)
    sides = [run(case, numbers, middle + sign * step * np.eye(len(best))) for sign in (1, -1)]
    J = ((sides[0] - sides[1]) / (2 * step)).T / widths()[:, None]
    left = np.sqrt(np.diag(np.linalg.inv(np.eye(len(best)) + J.T @ J)))
    return left, np.asarray(np.linalg.svd(J, compute_uv=False), float)


def widths() -> Array:
    """Widths of the twelve intervals, (12,)."""
    return np.array([interval.upper - interval.lower for interval in figure_intervals()])


def starts(tried: Sequence[Trials], chains: int) -> Array:
    """Where the walkers start: the searches' best trials, the same number of each, the mount as drawn."""
    mount = MOUNT.place(AS_DRAWN)
    each = -(-chains // len(tried))
    found = [trials.places[np.argsort(trials.costs)[:each]] for trials in tried]
    places = np.vstack([found[i][k : k + 1] for k in range(each) for i in range(len(found)) if k < len(found[i])])
    places = np.resize(places, (chains, places.shape[1]))
    return np.column_stack((places, np.full(chains, mount)))


def walk(case: Case, numbers: Sequence[Number], places: Array, enough: int, effort: Effort) -> tuple[Array, float]:
    """Differential-evolution walk, uniform over what meets enough; one half moves along differences in the other.

    Returns:
        The places of the second half of the walk, and the share of steps that were accepted. Walkers that start outside
        may only come nearer.
    """
    rng, d = np.random.default_rng(0), places.shape[1]
    short = np.maximum(enough - met(run(case, numbers, places)), 0)
    kept, accepted = [], 0
    halves = np.arange(len(places)).reshape(2, -1)
    for step in range(effort.steps):
        for mine, other in (halves, halves[::-1]):
            pairs = np.array([rng.choice(other, 2, replace=False) for _ in mine])
            scale = np.where(rng.random(len(mine)) < 0.1, 1.0, 2.38 / np.sqrt(2 * d) * rng.uniform(0.3, 1.0, len(mine)))
            move = scale[:, None] * (places[pairs[:, 0]] - places[pairs[:, 1]])
            wanted = places[mine] + move + 0.02 * rng.standard_normal(move.shape)
            inside = np.all((wanted >= 0) & (wanted <= 1), axis=1)
            then = np.full(len(mine), 13)
            if inside.any():
                then[inside] = np.maximum(enough - met(run(case, numbers, wanted[inside])), 0)
            yes = inside & (then <= short[mine])
            places[mine[yes]], short[mine[yes]] = wanted[yes], then[yes]
            accepted += int(yes.sum())
        if step >= effort.steps // 2:
            kept.append(places[short == 0].copy())
    return np.vstack(kept), accepted / (effort.steps * len(places))


def unsure(walked: Array) -> float:
    """How far the ends of the middle 90 % differ between the first and the second half of a walk, at most; 0 to 1."""
    if len(walked) < 2:
        return 1.0
    first, second = (np.quantile(half, (0.05, 0.95), axis=0) for half in np.array_split(walked, 2))
    return float(np.abs(first - second).max())


def run(case: Case, numbers: Sequence[Number], places: Array) -> Array:
    """Extremes at places of the unit cube, (n, 12)."""
    return extremes([loops(case, at(numbers, place)) for place in places])


def sample_times(
    case: Case, values: dict[str, float], effort: Effort, say: Callable[[str], None]
) -> list[dict[str, Any]]:
    """At other sample times: how many intervals the same numbers meet, and how many after a new search."""
    found = []
    for period in PERIODS:
        same = extremes([loops(case, values, period)])[0]
        again = trials_of(case, Budget(trials=effort.refit), 0, period)
        best = again.extremes[again.best]
        found.append(
            {
                "control_period": period,
                "met_with_the_same_numbers": int(met(same)),
                "met_after_a_search": int(met(best)),
                "widths_outside": float(distances_of(best).sum()),
            }
        )
        say(f"sample time {1e3 * period:g} ms: {found[-1]['met_after_a_search']} of 12")
    return found
