"""Every network tuned several times, each time from other training draws and another seed, at the same budget."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mmnn_pin.signals import Array
from research.studies.rollouts import Rollout
from research.studies.search import search

from .choices import TUNED, Choice, choice, level
from .draws import Draw, draw, errors, motion, run_all
from .unstated import LEARNERS

TRAINING = 1  # stream of draws


LOST = 10.0  # error of a run that diverged, relative to PD alone


@dataclass(frozen=True)
class Budget:
    """What each tuning of each learner may use: the same for all."""

    tunings: int = 3  # tunings of each learner, independent of each other
    draws: int = 32  # training draws of a tuning, its own
    trials: int = 77  # trials of its search


def tunings(budget: Budget, say: Callable[[str], None]) -> dict[str, Any]:
    """All tunings of all learners, for JSON."""
    begin, found = time.perf_counter(), dict[str, list[dict[str, Any]]]()
    for seed in range(budget.tunings):
        for name in LEARNERS:
            found.setdefault(name, []).append(tune(name, budget, seed))
            say(f"tuned {name}: {found[name][-1]['cost_as_printed']:.3f} to {found[name][-1]['cost']:.3f}")
    first = found[LEARNERS[0]][0]
    return {
        "learners": found,
        "numbers": {name: [asdict(number) for number in TUNED[name]] for name in LEARNERS},
        "draws": budget.draws,
        "trials": first["trials"],
        "runs": first["trials"] * budget.draws,
        "wall_s": (time.perf_counter() - begin) / (len(LEARNERS) * budget.tunings),
    }


def tune(learner: str, budget: Budget, seed: int) -> dict[str, Any]:
    """The best choice of one learner on the training draws of a seed.

    The cost is the mean logarithm of its errors, base and arm, whole and tracking, relative to PD alone on the same
    draw; each draw goes along one of the motions in turn.
    """
    cases = training(budget.draws, seed)
    pd = [errors(run, d.period) for run, (d, _) in zip(run_all([(*c, "pd", None) for c in cases]), cases, strict=True)]

    def costs(tried: Sequence[Choice | None]) -> Array:
        runs = iter(run_all([(d, reference, learner, chosen) for chosen in tried for d, reference in cases]))
        return np.array([cost_of([next(runs) for _ in cases]) for _ in tried])

    def cost_of(runs: Sequence[Rollout]) -> float:
        found = [relative(errors(run, d.period), p) for run, (d, _), p in zip(runs, cases, pd, strict=True)]
        return float(np.mean(found))

    places, cost = search(
        lambda places: costs([choice(learner, place) for place in places]), len(TUNED[learner]), budget.trials, seed
    )
    values = choice(learner, places[int(np.argmin(cost))])
    return {
        "seed": seed,
        "values": values,
        "level": level(values) if learner == "one_layer" else None,
        "cost": float(cost.min()),
        "cost_as_printed": float(costs([None])[0]),
        "trials": len(cost),
    }


def training(draws: int, seed: int) -> list[tuple[Draw, str]]:
    """Training draws of a seed, each with its motion; no two seeds share one."""
    return [(draw(TRAINING, seed * draws + i), motion(i)) for i in range(draws)]


def relative(found: Mapping[str, float], pd: Mapping[str, float]) -> float:
    """Mean logarithm of errors relative to PD's."""
    ratios = [min(found[key] / pd[key], LOST) if np.isfinite(pd[key]) else 1.0 for key in found]
    return float(np.mean(np.log(ratios)))
