"""Which controller to take, and within which uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .intervals import Interval, differ, rate
from .region import Region, region_of
from .results import Results

CHANCE = 0.05  # two rates differ where chance alone would do so less often than this


@dataclass(frozen=True)
class Verdict:
    """The answer of a study.

    Attributes:
        controller: The one to take; None where none ever succeeds.
        success: Rate of successes of every controller.
        alike: Controllers that its rate of successes is not told apart from.
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
    return [*lines, told_region(results, found)]


def told_region(results: Results, found: Verdict) -> str:
    """Within which uncertainty, in words."""
    wanted = f"{100 * found.wanted:g} %"
    if found.region is None:
        return f"No range of the factors was found in which it succeeds in {wanted} of the runs."
    where = found.region
    checked = f"{percent(where.success)} of the runs that were kept apart to check it"
    if not where.cuts:
        return f"That holds within everything that was varied: {checked} succeed."
    units = {n: f.unit or ("times the experiment's" if f.relative else "") for n, f in results.factors.items()}
    cuts = ", ".join(cut.told(units[cut.factor]) for cut in where.cuts)
    return f"Within {cuts} ({100 * where.share:.0f} % of all draws) it succeeds in {checked} ({wanted} were asked)."


def percent(interval: Interval) -> str:
    """A rate with its interval."""
    return f"{100 * interval.value:.1f} % [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
