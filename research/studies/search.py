"""Numbers that are searched, and a seeded search with Optuna's CMA-ES; the same seed gives the same trials."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import optuna

from mmnn_pin.signals import Array


@dataclass(frozen=True)
class Number:
    """A number that the thesis does not state."""

    name: str  # key
    lower: float  # lower end of its range
    upper: float  # upper end
    unit: str  # unit
    log: bool = False  # whether the range is searched in its logarithm

    def place(self, value: float) -> float:
        """Where a value lies in the range, 0 to 1."""
        a, b, v = np.log([self.lower, self.upper, value]) if self.log else (self.lower, self.upper, value)
        return float((v - a) / (b - a))

    def at(self, place: float) -> float:
        """Value at a place, 0 to 1."""
        if self.log:
            return float(self.lower * (self.upper / self.lower) ** place)
        return float(self.lower + place * (self.upper - self.lower))


def at(numbers: Sequence[Number], place: Array) -> dict[str, float]:
    """Values at a place of the unit cube, to four significant digits: what is judged can be written down."""
    return {number.name: float(f"{number.at(u):.4g}") for number, u in zip(numbers, place, strict=True)}


Cost = Callable[[Array], Array]


def search(cost: Cost, size: int, trials: int, seed: int) -> tuple[Array, Array]:
    """Look for the place in the unit cube where a cost is least, from the cube's middle on.

    Args:
        cost: Costs (n,) of places (n, size), all of a generation at once.
        size: Number of dimensions.
        trials: Budget, rounded down to whole generations.
        seed: Seed of the search.

    Returns:
        All places (trials, size) and their costs (trials,), in the order in which they were tried.
    """
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    names, generation = [f"x{i}" for i in range(size)], 4 + 3 * int(math.log(size))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.CmaEsSampler(
            seed=seed, popsize=generation, n_startup_trials=0, warn_independent_sampling=False
        )
    space: dict[str, optuna.distributions.BaseDistribution] = {
        name: optuna.distributions.FloatDistribution(0, 1) for name in names
    }
    study = optuna.create_study(sampler=sampler)
    places, costs = [np.zeros((0, size))], [np.zeros(0)]
    for _ in range(trials // generation):
        asked = [study.ask(space) for _ in range(generation)]
        places.append(np.array([[trial.params[name] for name in names] for trial in asked]))
        costs.append(cost(places[-1]))
        for trial, value in zip(asked, costs[-1], strict=True):
            study.tell(trial, float(value))
    return np.vstack(places), np.concatenate(costs)
