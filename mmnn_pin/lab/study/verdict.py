"""Which controller to take, and within which values of the factors it succeeds often enough: a box.

The box is found on half of the runs and judged on the other half. The search peels thin slices off the box where they
cost most successes (PRIM: Friedman and Fisher, 1999) and then takes back every cut that is not needed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .factors import Factor
from .results import Results
from .statistics import Interval, differ, identity, levels_of, rate

CHANCE = 0.05  # two rates differ where chance alone would do so less often than this
SLICE = 0.06  # share of the box that a peel takes
SMALLEST = 0.08  # share of the runs that a box must hold
FEWEST = 20  # runs of either half that it must hold
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Cut:
    """What a box demands of one factor.

    Attributes:
        factor: Its name.
        low: Smallest value; None for no bound.
        high: Largest value; None for no bound.
        levels: Values that are in, of a factor without an order; None for all.
    """

    factor: str
    low: float | None = None
    high: float | None = None
    levels: tuple[Any, ...] | None = None

    def describe(self, unit: str = "") -> str:
        """In words."""
        end = f" {unit}" if unit else ""
        if self.levels is not None:
            return f"{self.factor} {' or '.join(map(str, self.levels))}{end}"
        if self.low is not None and self.high is not None:
            return f"{self.factor} {self.low:.3g} to {self.high:.3g}{end}"
        if self.low is not None:
            return f"{self.factor} from {self.low:.3g}{end}"
        return f"{self.factor} up to {self.high:.3g}{end}"

    def holds(self, values: Sequence[Any]) -> Mask:
        """Which values are in."""
        if self.levels is not None:
            inside = {identity(level) for level in self.levels}
            return np.array([identity(value) in inside for value in values], bool)
        given = np.asarray(values, float)
        low, high = -np.inf if self.low is None else self.low, np.inf if self.high is None else self.high
        return np.asarray((given >= low) & (given <= high))


@dataclass(frozen=True)
class Region:
    """A box in the factors.

    Attributes:
        cuts: What it demands; nothing where all runs are in.
        share: Share of all runs that are in it.
        success: Rate of successes within, of the runs that had no part in finding it.
    """

    cuts: tuple[Cut, ...]
    share: float
    success: Interval


@dataclass(frozen=True)
class Verdict:
    """The answer of a study.

    Attributes:
        controller: The one to take; None where none ever succeeds.
        success: Rate of successes of every controller.
        alike: Controllers whose rates of successes cannot be told apart from its own.
        deciding: Metric by which it was chosen among them; empty if there are none.
        region: Where it succeeds often enough; None where no such region was found.
        wanted: Share of successes that is often enough.
    """

    controller: str | None
    success: dict[str, Interval]
    alike: tuple[str, ...]
    deciding: str
    region: Region | None
    wanted: float

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        found = self.region
        box = None if found is None else {
            "cuts": [{"factor": c.factor, "low": c.low, "high": c.high, "levels": c.levels} for c in found.cuts],
            "share": found.share,
            "success": found.success.to_dict(),
        }  # fmt: skip
        success = {name: interval.to_dict() for name, interval in self.success.items()}
        about = {"take": self.controller, "success": success, "not_told_apart": self.alike, "decided_by": self.deciding}
        return about | {"region": box, "wanted": self.wanted}


def verdict(results: Results) -> Verdict:
    """The answer: most successes on equal draws; among those not told apart the smallest median of the first metric."""
    good = {name: results.succeeded(name) for name in results.controllers}
    rates = {name: rate(int(s.sum()), len(s)) for name, s in good.items()}
    wanted = results.settings.success.wanted
    best = max(rates, key=lambda name: rates[name].value)
    if rates[best].value == 0:
        return Verdict(None, rates, (), "", None, wanted)
    others = [name for name in rates if name != best]
    alike = [name for name in others if chance(results, best, name) > CHANCE / max(1, len(others))]
    deciding = results.patterns[0] if alike and results.patterns else ""
    if deciding:
        best = min([best, *alike], key=lambda name: float(np.median(results.metric(name, deciding))))
        alike = [name for name in rates if name != best and chance(results, best, name) > CHANCE / len(others)]
    return Verdict(best, rates, tuple(alike), deciding, region_for(results, best), wanted)


def chance(results: Results, one: str, other: str) -> float:
    """Probability that two controllers differ so much by chance, on their common draws."""
    here, there = results.paired(one, other)
    return differ(results.succeeded(one)[here], results.succeeded(other)[there])


def region_for(results: Results, controller: str) -> Region | None:
    """Where a controller succeeds often enough; a random half of the points finds the region, the others judge it."""
    rows, success = results.of[controller], results.succeeded(controller)
    points = np.array([row.point for row in rows])
    half = (np.random.default_rng(0).random(points.max() + 1) < 0.5)[points]
    values = {name: results.values(controller, name) for name in results.factors}
    return region_of(values, results.factors, success, half, results.settings.success.wanted)


def region_of(
    values: Mapping[str, Sequence[Any]], factors: Mapping[str, Factor], success: Mask, half: Mask, wanted: float
) -> Region | None:
    """The largest box found in which at least the wanted share succeeds; None where there is none.

    Args:
        values: Factor to its values in all runs.
        factors: The factors.
        success: (n,) which runs succeeded.
        half: (n,) which runs find the box; the others judge it.
        wanted: Share of successes.
    """
    cuts: dict[str, Cut] = {}
    inside = np.ones(len(success), bool)
    least = max(FEWEST, SMALLEST * half.sum())
    while success_share(success, inside & half) < wanted:
        searched = inside & half
        options = [
            cut for name in factors for cut in peels(name, factors[name], values[name], searched, cuts.get(name))
        ]
        gains = [gain(success, searched, cut.holds(values[cut.factor])) for cut in options]
        if max(gains, default=0.0) <= 0:
            return None
        best = options[int(np.argmax(gains))]
        cuts[best.factor] = best
        inside &= best.holds(values[best.factor])
        if (inside & half).sum() < least or (inside & ~half).sum() < FEWEST:
            return None
    cuts = needed(cuts, values, success, half, wanted)
    inside = runs_within(cuts, values, len(success))
    judged = inside & ~half
    return Region(tuple(cuts.values()), float(inside.mean()), rate(int(success[judged].sum()), int(judged.sum())))


def peels(name: str, factor: Factor, values: Sequence[Any], inside: Mask, cut: Cut | None) -> list[Cut]:
    """Boxes that take a slice off one factor."""
    kept = [value for value, is_in in zip(values, inside, strict=True) if is_in]
    levels = levels_of(kept, factor.numeric)
    if len(levels) < 2:
        return []
    if not factor.numeric:
        return [Cut(name, levels=tuple(other for other in levels if other is not level)) for level in levels]
    low, high = (None, None) if cut is None else (cut.low, cut.high)
    ordered = np.sort(np.asarray(kept, float))
    count = max(1, round(SLICE * len(ordered)))
    above, below = ordered[ordered > ordered[count - 1]], ordered[ordered < ordered[-count]]
    options = [Cut(name, float(above[0]), high)] if len(above) else []
    return options + ([Cut(name, low, float(below[-1]))] if len(below) else [])


def gain(success: Mask, inside: Mask, kept: Mask) -> float:
    """How much the rate of successes rises for each run that a peel takes away."""
    left = inside & kept
    taken = int(inside.sum() - left.sum())
    return (success_share(success, left) - success_share(success, inside)) / taken if taken and left.any() else -np.inf


def needed(
    cuts: dict[str, Cut], values: Mapping[str, Sequence[Any]], success: Mask, half: Mask, wanted: float
) -> dict[str, Cut]:
    """The cuts without which the rate would be too low; those that take most runs away are tried first."""
    order = sorted(cuts, key=lambda name: int(cuts[name].holds(values[name]).sum()))
    for name in order:
        for fewer in (None, *one_sided(cuts[name])):
            trial = {n: c for n, c in cuts.items() if n != name} | ({} if fewer is None else {name: fewer})
            if success_share(success, runs_within(trial, values, len(success)) & half) >= wanted:
                cuts = trial
                break
    return cuts


def one_sided(cut: Cut) -> list[Cut]:
    """A cut with one of its two bounds."""
    if cut.low is None or cut.high is None:
        return []
    return [Cut(cut.factor, cut.low, None), Cut(cut.factor, None, cut.high)]


def runs_within(cuts: Mapping[str, Cut], values: Mapping[str, Sequence[Any]], count: int) -> Mask:
    """Runs that are in a box."""
    inside = np.ones(count, bool)
    for name, cut in cuts.items():
        inside &= cut.holds(values[name])
    return inside


def success_share(success: Mask, inside: Mask) -> float:
    """Rate of successes of some runs; 0 of none."""
    return float(success[inside].mean()) if inside.any() else 0.0


def sentences(results: Results, found: Verdict) -> list[str]:
    """The answer in words."""
    if found.controller is None:
        return [f"None of {', '.join(results.controllers)} succeeds in any run."]
    own = found.success[found.controller]
    total = len(results.of[found.controller])
    lines = [f"Take {found.controller}: it succeeds in {percent(own)} of {total} runs."]
    rest = sorted((n for n in found.success if n != found.controller), key=lambda n: -found.success[n].value)
    if rest:
        lines.append("The others: " + "; ".join(f"{name} {percent(found.success[name])}" for name in rest) + ".")
    if found.alike:
        names = " and ".join(found.alike)
        lines.append(
            f"Its successes are not told apart from those of {names}; it has the smallest median of {found.deciding}."
        )
    return [*lines, describe_region(results, found)]


def describe_region(results: Results, found: Verdict) -> str:
    """Within which uncertainty, in words."""
    wanted = f"{100 * found.wanted:g} %"
    if found.region is None:
        return f"No range of the factors was found in which it succeeds in {wanted} of the runs."
    where = found.region
    checked = f"{percent(where.success)} of the runs that were kept apart to check it"
    if not where.cuts:
        return f"That holds within everything that was varied: {checked} succeed."
    units = {n: f.unit or ("times the experiment's" if f.relative else "") for n, f in results.factors.items()}
    cuts = ", ".join(cut.describe(units[cut.factor]) for cut in where.cuts)
    return f"Within {cuts} ({100 * where.share:.0f} % of all draws) it succeeds in {checked} ({wanted} were asked)."


def percent(interval: Interval) -> str:
    """A rate with its interval."""
    return f"{100 * interval.value:.1f} % [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
