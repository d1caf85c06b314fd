"""The verdict of many runs: which factors decide, which controller to take, and within which values.

How much of a result each factor decides: first-order variance shares from the runs themselves. The box of factors in
which a controller succeeds often enough is found on half of the draws and judged on the other half. The search peels
thin slices off the box where they cost most successes (PRIM: Friedman and Fisher, 1999) and then takes back every cut
that is not needed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import scipy

from ...signals import Array, IntArray
from ..experiments.outliers import lost_places
from .factors import Factor
from .intervals import Interval, Mask, differ, percent, rate
from .results import Results

BINS = 8
MAP_BINS = 6  # of a factor, in maps of the rate of successes and in what is said of them
CHANCE = 0.05  # two rates differ where chance alone would do so less often than this
SLICE = 0.06  # share of the box that a peel takes
SMALLEST = 0.08  # share of the runs that a box must hold
FEWEST = 20  # runs of either half that it must hold


@dataclass(frozen=True)
class Share:
    """The share of a result that a factor decides."""

    # its first-order share of the variance of the result's ranks, from 0 (nothing) to 1 (all); corrected for the number
    # of bins, so that a factor without influence has 0 on average
    share: float
    direction: float  # spearman's rank correlation; nan for a factor without an order
    p: float  # probability of so large a share by chance


def share_of(values: Sequence[Any], result: Array, ordered: bool, groups: IntArray | None = None) -> Share:
    """Share of one factor in one result.

    The estimate from given data: the variance between the means of bins of the factor over the whole variance
    (Plischke, 2012), of ranks so that runs that diverged count as the worst.

    Args:
        values: (n,) the factor's.
        result: (n,) the result; inf is the worst.
        ordered: Whether the values have an order.
        groups: (n,) number of the group of every run, of runs with one value that are not independent of each other;
            None where all are.
    """
    ranks = scipy.stats.rankdata(np.where(np.isnan(result), np.inf, result))
    bins = bins_of(values, ordered)
    n, k = len(ranks), int(bins.max(initial=-1)) + 1
    total = float(((ranks - ranks.mean()) ** 2).sum()) if n else 0.0
    varies = bool(n) and ordered and np.ptp(np.asarray(values, float)) > 0 and np.ptp(ranks) > 0
    direction = float(scipy.stats.spearmanr(np.asarray(values, float), ranks).statistic) if varies else np.nan
    if k < 2 or n <= k or total == 0:
        return Share(0.0, direction if total else np.nan, 1.0)
    counts = np.bincount(bins, minlength=k)
    means = np.bincount(bins, ranks, minlength=k) / counts
    between = float((counts * (means - ranks.mean()) ** 2).sum())
    alone = np.arange(n) if groups is None else np.unique(groups, return_inverse=True)[1]
    sums, free = np.bincount(alone, ranks - means[bins]), int(alone.max()) + 1 - k
    if free < 1:
        return Share(0.0, direction, 1.0)
    noise = float((sums**2 / np.bincount(alone)).sum()) / free  # of a bin's mean, times its runs
    ratio = between / (k - 1) / noise if noise > 0 else np.inf
    p = float(scipy.stats.f.sf(ratio, k - 1, free))
    return Share(max(0.0, (between - (k - 1) * noise) / total), direction, p)


def bins_of(values: Sequence[Any], ordered: bool, most: int = BINS) -> IntArray:
    """Number of the bin of every value, (n,): its level where there are few, else bins of equally many.

    Args:
        values: (n,).
        ordered: Whether they have an order.
        most: Number of bins, at most.
    """
    levels = levels_of(values, ordered)
    if not ordered or len(levels) <= most:
        place = {repr(level): i for i, level in enumerate(levels)}
        return np.array([place[repr(value)] for value in values], np.int64)
    order = np.asarray(scipy.stats.rankdata(np.asarray(values, float), method="min"), np.int64) - 1
    raw = order * most // len(values)
    return np.asarray(np.unique(raw, return_inverse=True)[1], np.int64)


def levels_of(values: Sequence[Any], ordered: bool) -> list[Any]:
    """Different values, in order where they have one."""
    levels = list({repr(value): value for value in values}.values())
    return sorted(levels) if ordered else levels


# -- the answer --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cut:
    """The interval of one factor in a box."""

    factor: str  # its name
    low: float | None = None  # smallest value; None for no bound
    high: float | None = None  # largest value; None for no bound
    levels: tuple[Any, ...] | None = None  # values that are in, of a factor without an order; None for all

    def describe(self, unit: str = "") -> str:
        """In words."""
        if self.levels is not None:
            values = " or ".join(map(str, self.levels))
        elif self.low is None:
            values = f"up to {self.high:.3g}"
        elif self.high is None:
            values = f"from {self.low:.3g}"
        else:
            values = f"{self.low:.3g}" if self.low == self.high else f"{self.low:.3g} to {self.high:.3g}"
        return f"{self.factor} {values} {unit}".rstrip()

    def holds(self, values: Sequence[Any]) -> Mask:
        """Which values are in."""
        if self.levels is not None:
            inside = {repr(level) for level in self.levels}
            return np.array([repr(value) in inside for value in values], bool)
        given = np.asarray(values, float)
        low, high = -np.inf if self.low is None else self.low, np.inf if self.high is None else self.high
        return np.asarray((given >= low) & (given <= high))


@dataclass(frozen=True)
class Region:
    """A box in the factors."""

    cuts: tuple[Cut, ...]  # what it demands; nothing where all runs are in
    share: float  # share of all runs that are in it
    success: Interval  # rate of successes within, of the runs that had no part in finding it


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
        box = self.region and {
            "cuts": [dict(vars(cut)) for cut in self.region.cuts],
            "share": self.region.share,
            "success": self.region.success.to_dict(),
        }
        success = {name: interval.to_dict() for name, interval in self.success.items()}
        about = {"take": self.controller, "success": success, "not_told_apart": self.alike, "decided_by": self.deciding}
        return about | {"region": box, "wanted": self.wanted}


def verdict(results: Results) -> Verdict:
    """The answer: most successes on equal draws; among those not told apart the smallest median of the first metric."""
    good = {name: results.succeeded(name) for name in results.controllers}
    rates = {name: rate(s, results.draws(name)) for name, s in good.items()}
    wanted = results.settings.success.wanted
    best = max(rates, key=lambda name: rates[name].value)
    if rates[best].value == 0:
        return Verdict(None, rates, (), "", None, wanted)
    others = [name for name in rates if name != best]
    alike = [name for name in others if chance(results, best, name) > CHANCE / max(1, len(others))]
    deciding = results.patterns[0] if alike and results.patterns else ""
    if deciding:
        medians = {name: float(np.median(results.metric(name, deciding))) for name in (best, *alike)}
        best = min(medians, key=lambda name: medians[name] if medians[name] < np.inf else np.inf)  # NaN is none
        alike = [name for name in rates if name != best and chance(results, best, name) > CHANCE / len(others)]
    draws = results.draws(best)
    half = (np.random.default_rng(0).random(draws.max() + 1) < 0.5)[draws]  # finds the region; the others judge it
    values = {name: results.values(best, name) for name in results.factors}
    region = region_of(values, results.factors, good[best], half, wanted, draws)
    return Verdict(best, rates, tuple(alike), deciding, region, wanted)


def chance(results: Results, one: str, other: str) -> float:
    """Probability that two controllers differ so much by chance, on their common draws."""
    here, there = results.paired(one, other)
    return differ(results.succeeded(one)[here], results.succeeded(other)[there], results.draws(one)[here])


def region_of(
    values: Mapping[str, Sequence[Any]],
    factors: Mapping[str, Factor],
    success: Mask,
    half: Mask,
    wanted: float,
    draws: IntArray | None = None,
) -> Region | None:
    """The largest box found in which at least the wanted share succeeds; None where there is none.

    Args:
        values: Factor to its values in all runs.
        factors: The factors.
        success: (n,) which runs succeeded.
        half: (n,) which runs find the box; the others judge it.
        wanted: Share of successes.
        draws: (n,) number of the draw of every run; None where each has its own.
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
    found = rate(success[judged], None if draws is None else draws[judged])
    return Region(tuple(cuts.values()), float(inside.mean()), found)


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
    for name in sorted(cuts, key=lambda name: int(cuts[name].holds(values[name]).sum())):
        low, high = cuts[name].low, cuts[name].high
        sides = () if low is None or high is None else (Cut(name, low, None), Cut(name, None, high))
        for fewer in (None, *sides):
            trial = {n: c for n, c in cuts.items() if n != name} | ({} if fewer is None else {name: fewer})
            if success_share(success, runs_within(trial, values, len(success)) & half) >= wanted:
                cuts = trial
                break
    return cuts


def runs_within(cuts: Mapping[str, Cut], values: Mapping[str, Sequence[Any]], count: int) -> Mask:
    """Runs that are in a box."""
    return np.logical_and.reduce([np.ones(count, bool), *(cut.holds(values[name]) for name, cut in cuts.items())])


def success_share(success: Mask, inside: Mask) -> float:
    """Rate of successes of some runs; 0 of none."""
    return float(success[inside].mean()) if inside.any() else 0.0


def sentences(results: Results, found: Verdict) -> list[str]:
    """The answer in words."""
    if found.controller is None:
        return [f"None of {', '.join(results.controllers)} succeeds in any run."]
    own, total = percent(found.success[found.controller]), len(results.of[found.controller])
    if found.alike:
        why = f"its successes and those of {' and '.join(found.alike)} are not told apart by so many runs"
        lines = [
            f"Take {found.controller}: {why}, and it has the smallest median of {found.deciding} among them.",
            f"It succeeds in {own} of {total} runs.",
        ]
    else:
        lines = [f"Take {found.controller}: it succeeds in {own} of {total} runs."]
    lines += lost_sentence(results, found.controller)
    rest = sorted((n for n in found.success if n != found.controller), key=lambda n: -found.success[n].value)
    if rest:
        lines.append("The others: " + "; ".join(f"{name} {percent(found.success[name])}" for name in rest) + ".")
    return [*lines, describe_region(results, found)]


def lost_sentence(results: Results, controller: str) -> list[str]:
    """In how many of its successes a controller is lost all the same, and the worst error; empty where in none."""
    good = zip(results.of[controller], results.succeeded(controller), strict=True)
    lost = [places for row, succeeded in good if succeeded and (places := lost_places(row.metrics))]
    if not lost:
        return []
    peak, key = max((peak, key) for places in lost for key, peak in places.items())
    what = f"{key} is up to {peak:.3g} {results.unit(key)}".rstrip()
    return [f"It is lost in {len(lost)} of these all the same ({what}): bound that in `success.at_most`."]


@dataclass(frozen=True)
class MapCell:
    """Runs within bins of some factors, as maps show them."""

    cuts: tuple[Cut, ...]  # the bins
    runs: int  # how many runs
    success: Interval  # their rate of successes


def best_cell(results: Results, controller: str, count: int, wanted: float) -> MapCell:
    """The cell of `count` factors that has most runs of those with the wanted rate of successes, else the best rate."""
    success, draws = results.succeeded(controller), results.draws(controller)
    values = {name: results.values(controller, name) for name in results.factors}
    bins = {name: bins_of(values[name], factor.numeric, MAP_BINS) for name, factor in results.factors.items()}
    found = list[MapCell]()
    for names in combinations(results.factors, count):
        for places in sorted(set(zip(*(bins[name].tolist() for name in names), strict=True))):
            inside = np.logical_and.reduce([bins[name] == place for name, place in zip(names, places, strict=True)])
            kept = {name: [value for value, is_in in zip(values[name], inside, strict=True) if is_in] for name in names}
            cuts = tuple(bin_of(name, results.factors[name].numeric, kept[name]) for name in names)
            found.append(MapCell(cuts, int(inside.sum()), rate(success[inside], draws[inside])))
    enough = [cell for cell in found if cell.success.value >= wanted]
    if enough:
        return max(enough, key=lambda cell: (cell.runs, cell.success.value))
    return max(found, key=lambda cell: (cell.success.value, cell.runs))


def bin_of(name: str, numeric: bool, kept: Sequence[Any]) -> Cut:
    """The bin of a factor that just holds some values."""
    return Cut(name, min(kept), max(kept)) if numeric else Cut(name, levels=(kept[0],))


def describe_region(results: Results, found: Verdict) -> str:
    """Within which uncertainty, in words."""
    wanted = f"{100 * found.wanted:g} %"
    if found.region is None:
        return describe_cells(results, found)
    where = found.region
    checked = f"{percent(where.success)} of the runs that were kept apart to check it"
    if not where.cuts:
        least = "" if where.success.value >= found.wanted else f", fewer than the {wanted} that were asked"
        return f"Within everything that was varied {checked} succeed{least}."
    units = {n: f.unit or "times the experiment's" * f.relative for n, f in results.factors.items()}
    cuts = ", ".join(cut.describe(units[cut.factor]) for cut in where.cuts)
    return f"Within {cuts} ({100 * where.share:.0f} % of all draws) it succeeds in {checked} ({wanted} were asked)."


def describe_cells(results: Results, found: Verdict) -> str:
    """Where it succeeds most, by the bins of the maps, where no region could be found and checked on other runs."""
    assert found.controller is not None
    units = {n: f.unit or "times the experiment's" * f.relative for n, f in results.factors.items()}
    for count, what in ((1, "one factor"), (2, "two factors")):
        if len(results.factors) < count:
            continue
        cell = best_cell(results, found.controller, count, found.wanted)
        where = " and ".join(cut.describe(units[cut.factor]) for cut in cell.cuts)
        if cell.success.value >= found.wanted:
            few = "too few to find a range and check it on runs kept apart"
            return f"Within {where} it succeeds in {percent(cell.success)} of {cell.runs} runs, {few}."
        best = f"the best, {where}, has {percent(cell.success)} of {cell.runs} runs"
        told = f"No value or range of {what}, as the maps show them, reaches {100 * found.wanted:g} %: {best}."
    return told
