"""Calibration: the rig that the printed numbers belong to, found by a search that anyone can repeat.

Three questions. *one_layer*: which rig gives the two errors of the one-layer network? It is the one of the experiment's
file; what the two-layer network then does is a prediction. *all*: is there a rig that gives all four numbers? And both
with the networks in degrees throughout, or with their input alone in degrees.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.lab.experiments.thesis import PRINTED
from mmnn_pin.signals import Array
from research.studies.rollouts import roll_out
from research.studies.search import Number, at, search

from .rigs import DEGREES, chapter5, loop_of, robot_of, with_rig

SEARCHED = (
    Number("coulomb_1", 3.0, 15.0, "N m"),
    Number("coulomb_2", 3.0, 15.0, "N m"),
    Number("breakaway", 1.0, 2.0, ""),
    Number("stribeck", 0.02, 0.5, "rad/s", log=True),
    Number("viscous", 0.1, 8.0, "N m s", log=True),
    Number("gap", 0.001, 0.02, "rad", log=True),
    Number("resolution", 1e-4, 3e-3, "rad", log=True),
    Number("inertia", 0.3, 0.6, "kg m^2", log=True),
    Number("mu", 0.002, 0.03, "", log=True),
)
LOST = 10.0  # deviation of a run that was lost


@dataclass(frozen=True)
class Case:
    """What is fitted, and how the networks take the error that teaches them."""

    name: str  # key
    title: str  # for the table
    fitted: tuple[str, ...]  # controllers whose two largest errors are fitted
    unit: str  # one of `rigs.UNITS`
    searches: int = 1  # how many searches, each with a seed of its own


ONE, BOTH = ("one_layer",), ("one_layer", "two_layer_zero")
CASES = (
    Case("one_layer", "the one-layer network's two, degrees throughout", ONE, "degrees", 4),
    Case("one_layer_radians", "the one-layer network's two, degrees at the input only", ONE, "radians"),
    Case("all", "all four, degrees throughout", BOTH, "degrees", 2),
    Case("all_radians", "all four, degrees at the input only", BOTH, "radians"),
)
SHOWN = ("pd", "one_layer", "two_layer_zero", "two_layer_random")


@dataclass(frozen=True)
class Budget:
    """How much is tried."""

    searches: int = 4  # searches per case at most
    trials: int = 200  # trials per search


def largest(experiments: Sequence[Experiment], names: Sequence[str]) -> Array:
    """Largest measured errors [deg], (experiments, names, 2); inf for a run that was lost."""
    places = [(e, robot_of(e)) for e in experiments]
    runs = iter(roll_out([loop_of(e, robot, e.controller(n)) for e, robot in places for n in names], ("e",)))
    return np.array([[of_run(next(runs)) for _ in names] for _ in experiments])


def of_run(run: Any) -> Array:
    """Largest errors of a run [deg], (2,)."""
    return DEGREES * np.abs(run.signals["e"]).max(axis=0) if run.completed else np.full(2, np.inf)


def printed(names: Sequence[str]) -> Array:
    """The thesis's numbers of these controllers [deg], (names, 2)."""
    return np.array([PRINTED[name.removesuffix("_zero")] for name in names])


def deviation(found: Array, names: Sequence[str]) -> Array:
    """RMS of the relative deviations from the thesis's numbers, (n,) for errors (n, names, 2)."""
    away = np.where(np.isfinite(found), found / printed(names) - 1.0, LOST)
    return np.sqrt(np.mean(np.minimum(np.abs(away), LOST) ** 2, axis=(1, 2)))


def fit(case: Case, budget: Budget, seed: int) -> tuple[float, dict[str, float]]:
    """Least deviation of one search, and the values."""

    def cost(places: Array) -> Array:
        tried = [with_rig(chapter5(), {**at(SEARCHED, place), "unit": case.unit}) for place in places]
        return deviation(largest(tried, case.fitted), case.fitted)

    places, costs = search(cost, len(SEARCHED), budget.trials, seed)
    best = int(np.argmin(costs))
    return float(costs[best]), at(SEARCHED, places[best])


def calibrate(budget: Budget, say: Callable[[str], None]) -> dict[str, Any]:
    """All cases, for JSON: their best values, deviations per search, and all controllers' errors there."""
    summary: dict[str, Any] = {}
    for case in CASES:
        found = [fit(case, budget, seed) for seed in range(min(budget.searches, case.searches))]
        values = min(found, key=lambda each: each[0])[1]
        summary[case.name] = {
            "title": case.title,
            "fitted": list(case.fitted),
            "unit": case.unit,
            "deviations": [cost for cost, _ in found],
            "searches": [each for _, each in found],
            "predicted": [shown(each, case.unit) for _, each in found],
            "values": values,
            "largest": shown(values, case.unit),
        }
        say(f"{case.name}: " + ", ".join(f"{100 * cost:.2f} %" for cost, _ in found))
    summary["numbers"] = [asdict(number) for number in SEARCHED]
    return summary


def taken() -> dict[str, float]:
    """The numbers that the experiment's file has in the place of those searched."""
    e = chapter5()
    first, second = e.friction.coulomb if isinstance(e.friction.coulomb, tuple) else (e.friction.coulomb,) * 2
    found = {
        "coulomb_1": first,
        "coulomb_2": second,
        "breakaway": e.friction.breakaway,
        "stribeck": e.friction.stribeck,
        "viscous": e.friction.arm,
        "gap": e.actuator.gap,
        "resolution": e.sensor.resolution,
        "inertia": e.armature + e.actuator.rotor_inertia,  # type: ignore[operator]
        "mu": e.one_layer.mu,
    }
    return {name: float(np.round(value, 9)) for name, value in found.items()}


def shown(values: Mapping[str, float], unit: str) -> dict[str, list[float] | None]:
    """Largest errors [deg] of all controllers on a rig; None for one that was lost."""
    found = largest([with_rig(chapter5(), {**values, "unit": unit})], SHOWN)[0]
    return {name: each.tolist() if np.isfinite(each).all() else None for name, each in zip(SHOWN, found, strict=True)}
