"""The thesis's claim, tested: the two-layer against the one-layer network, everything else equal, over many draws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from msgspec.structs import replace as with_settings

from mmnn_pin import PD, ScheduledPD
from mmnn_pin.experiments.experiment import Experiment
from mmnn_pin.signals import Array

from .draws import REFERENCES, Draw, draw, loop, motions
from .rollouts import Rollout, roll_out
from .search import search
from .unstated import LEARNERS, Number, at

Row = dict[str, Any]
TRAINING, TEST = 1, 2  # streams of draws
KEPT = ("pose_error", "e", "effective_gain")
WINDOWS = {"whole": 0.0, "tracking": 1.0}  # from when on an error counts [s]
PARTS = ("base", "arm")
LOST = 10.0  # error of a run that diverged, relative to PD alone, for the tuning

# What a designer may choose, around the thesis's numbers as the middle of the range: five numbers each.
TUNED: dict[str, tuple[Number, ...]] = {
    "two_layer": (
        Number("F1", 0.01, 100, "", log=True),
        Number("F2", 0.002, 20, "", log=True),
        Number("G1", 0.01, 100, "", log=True),
        Number("G2", 0.002, 20, "", log=True),
        Number("kappa", 0.01, 100, "", log=True),
    ),
    "one_layer": (
        Number("beta1", 0.005, 50, "", log=True),
        Number("beta2", 0.005, 50, "", log=True),
        Number("mu", 0.0035, 35, "", log=True),
        Number("width", 1, 50, "", log=True),
        Number("centre_range", 1, 20, "", log=True),
    ),
}


def with_rates(experiment: Experiment, learner: str, values: Mapping[str, float] | None) -> Experiment:
    """The experiment with one learner's tuned numbers; as it is for None."""
    if values is None:
        return experiment
    if learner == "two_layer":
        F, G = (values["F1"], values["F2"]), (values["G1"], values["G2"])
        return with_settings(experiment, two_layer=with_settings(experiment.two_layer, F=F, G=G, kappa=values["kappa"]))
    network = with_settings(
        experiment.one_layer,
        beta=(values["beta1"], values["beta2"]),
        **{name: values[name] for name in ("mu", "width", "centre_range")},
    )
    return with_settings(experiment, one_layer=network)


def error(run: Rollout, part: str, start: float, period: float) -> float:
    """RMS distance of base [m] or arm [rad] from the reference, from a time on; inf for a run that was lost."""
    if not run.completed:
        return float("inf")
    table = run.signals["pose_error"][:, :2] if part == "base" else run.signals["e"]
    return float(np.sqrt(np.mean(np.sum(table[round(start / period) :] ** 2, axis=1))))


def errors(run: Rollout, period: float) -> dict[str, float]:
    """All errors of a run."""
    return {f"{part}.{name}": error(run, part, start, period) for part in PARTS for name, start in WINDOWS.items()}


@dataclass(frozen=True)
class Budget:
    """What each learner's tuning may use: the same for both.

    Attributes:
        draws: Training draws.
        searches: Searches, each with a seed of its own; the best of all counts.
        trials: Trials per search.
    """

    draws: int = 24
    searches: int = 3
    trials: int = 112


def tune(learner: str, budget: Budget) -> dict[str, Any]:
    """The best rates of one learner on the training draws.

    The cost is the mean logarithm of its errors, base and arm, whole and tracking, relative to PD alone on the same
    draw; each draw goes along one of the references in turn.
    """
    numbers, cases = TUNED[learner], training(budget.draws)
    pd = [errors(run, d.period) for run, (d, _) in zip(run_all([(*c, "pd", None) for c in cases]), cases, strict=True)]

    def costs(tried: Sequence[Mapping[str, float] | None]) -> Array:
        runs = iter(run_all([(d, r, learner, values) for values in tried for d, r in cases]))
        return np.array([cost_of([next(runs) for _ in cases]) for _ in tried])

    def cost_of(runs: Sequence[Rollout]) -> float:
        return float(
            np.mean([relative(errors(run, d.period), p) for run, (d, _), p in zip(runs, cases, pd, strict=True)])
        )

    found = [
        search(lambda p: costs([at(numbers, u) for u in p]), len(numbers), budget.trials, s)
        for s in range(budget.searches)
    ]
    places, cost = min(found, key=lambda search: search[1].min())
    return {
        "values": at(numbers, places[int(np.argmin(cost))]),
        "costs": [float(cost.min()) for _, cost in found],
        "cost_as_printed": float(costs([None])[0]),
        "trials": int(sum(len(cost) for _, cost in found)),
        "numbers": [asdict(number) for number in numbers],
    }


def training(draws: int) -> list[tuple[Draw, str]]:
    """Training draws, each with its reference."""
    names = list(REFERENCES)
    return [(draw(TRAINING, i), names[i % len(names)]) for i in range(draws)]


def relative(found: Mapping[str, float], pd: Mapping[str, float]) -> float:
    """Mean logarithm of errors relative to PD's."""
    ratios = [min(found[key] / pd[key], LOST) if np.isfinite(pd[key]) else 1.0 for key in found]
    return float(np.mean(np.log(ratios)))


def run_all(wanted: Sequence[tuple[Draw, str, str, Mapping[str, float] | None]], finer: int = 1) -> list[Rollout]:
    """Runs of draws along references by `pd` or a learner with tuned numbers."""
    loops = []
    for d, reference, name, values in wanted:
        experiment = with_rates(d.experiment(finer), name, values)
        loops.append(loop(experiment, d.robot, reference, experiment.controller(name)))
    return roll_out(loops, KEPT)


def compare(
    rates: Mapping[str, Mapping[str, Mapping[str, float] | None]], first: int, last: int, finer: int = 1
) -> list[Row]:
    """Rows of the test draws first ... last - 1, each along its two references.

    Args:
        rates: Condition (`thesis`, `tuned`) to learner to its tuned numbers, None for the thesis's.
        first: First draw.
        last: One past the last.
        finer: Plant steps per control sample.
    """
    places = [(i, draw(TEST, i), reference) for i in range(first, last) for reference in motions(i)]
    pd = run_all([(d, reference, "pd", None) for _, d, reference in places], finer)
    rows = []
    for condition, numbers in rates.items():
        runs = {name: run_all([(d, r, name, numbers[name]) for _, d, r in places], finer) for name in LEARNERS}
        gains = {name: at_gain(places, runs[name], finer) for name in LEARNERS}
        for k, (i, d, reference) in enumerate(places):
            row = {"draw": i, "reference": reference, "condition": condition, **d.facts}
            named = {"pd": pd[k]} | {name: runs[name][k] for name in LEARNERS}
            named |= {f"gain_of_{name}": gains[name][k] for name in LEARNERS}
            for name, run in named.items():
                row |= {f"{name}.{key}": value for key, value in errors(run, d.period).items()}
            rows.append(row | {f"{name}.diverged": not run.completed for name, run in named.items()})
    return rows


def at_gain(places: Sequence[tuple[int, Draw, str]], runs: Sequence[Rollout], finer: int = 1) -> list[Rollout]:
    """PD at the effective gain that each learner's run had: its gain without its network."""
    loops = []
    for (_, d, reference), run in zip(places, runs, strict=True):
        experiment = d.experiment(finer)
        gains = run.signals["effective_gain"]
        controller = ScheduledPD(gains) if len(gains) else PD(experiment.feedback)
        loops.append(loop(experiment, d.robot, reference, controller))
    return roll_out(loops, KEPT)


def claim(rates: Mapping[str, Any], draws: int, chunk: int, say: Callable[[str], None]) -> list[Row]:
    """Rows of all test draws, a chunk of draws at a time."""
    rows: list[Row] = []
    for first in range(0, draws, chunk):
        rows += compare(rates, first, min(draws, first + chunk))
        say(f"{min(draws, first + chunk)} of {draws} draws")
    return rows


def accuracy(rates: Mapping[str, Any], draws: int) -> dict[str, Any]:
    """What the plant's step does to the verdict: the first draws again with two steps per sample.

    Returns:
        Pairs, the share of them with the same winner, median and largest change of the ratio two-layer to one-layer.
    """
    coarse, fine = (compare(rates, 0, draws, finer) for finer in (1, 2))
    same, change = [], []
    for part in PARTS:
        with np.errstate(all="ignore"):
            a, b = (
                np.array([r[f"two_layer.{part}.tracking"] / r[f"one_layer.{part}.tracking"] for r in rows])
                for rows in (coarse, fine)
            )
            known = np.isfinite(a) & np.isfinite(b) & (a > 0) & (b > 0)  # nobody lost
            same += list((a < 1)[known] == (b < 1)[known])
            change += list(np.abs(a / b - 1)[known])
    return {
        "pairs": len(same),
        "same_winner": float(np.mean(same)),
        "median": float(np.median(change)),
        "largest": float(np.max(change)),
    }
