"""Which value of a setting to take: every value's runs judged by themselves, and the best of them.

A gain is chosen, masses and friction are met with. So a study tells which gain to take, and what it has to bear.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...torque.entries import CONTROLLERS
from .intervals import Interval, quantile, rate
from .results import Results
from .verdict import bins_of

# First parts of the keys that somebody can choose.
GAINS = {"feedback", "kinematic", "robust", "robust_of", *(one.key.partition(".")[0] for one in CONTROLLERS.values())}

MARGIN, ASKED = "delay_margin", "delay_margin_asked"  # numbers of a run [s], where they are known


@dataclass(frozen=True)
class Level:
    """The runs at one value of a setting, or in one bin of its values."""

    value: Any  # the value; of a bin its median
    low: float | None  # smallest value in it; None for one that has no order
    high: float | None  # largest value in it, likewise
    runs: int  # number of runs
    success: Interval  # rate of successes
    medians: dict[str, Interval]  # metric to its median over the runs; inf where fewer than half of the runs completed
    margin: float = math.nan  # least delay margin of the runs [s]; NaN where it is not known
    asked: float = math.nan  # delay margin that they should have [s]; NaN likewise

    @property
    def short(self) -> bool:
        """Whether the loop bears less delay than it should: it may look good where motors have limits, and chatter."""
        return self.margin < self.asked

    @property
    def words(self) -> str:
        """The value, or from where to where."""
        if self.low is None or self.high is None:
            return str(self.value)
        return f"{self.value:.4g}" if self.low == self.high else f"{self.low:.3g} to {self.high:.3g}"


def gains_of(results: Results) -> list[str]:
    """Factors that somebody can choose: all their keys are gains or settings of a learner."""
    found = results.factors.items()
    return [name for name, f in found if all(path.partition(".")[0] in GAINS for path in f.paths(name))]


def levels(results: Results, controller: str, factor: str) -> list[Level]:
    """The values of a factor with what a controller did there, in order; many values are put together in bins."""
    values = results.values(controller, factor)
    about = results.factors[factor]
    numeric = about.numeric or all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    groups, success, draws = bins_of(values, numeric), results.succeeded(controller), results.draws(controller)
    metrics = {pattern: results.metric(controller, pattern) for pattern in results.patterns}
    rows = results.of[controller]
    margins, asked = (np.array([row.metrics.get(key, math.nan) for row in rows]) for key in (MARGIN, ASKED))
    found = []
    for group in range(int(groups.max(initial=-1)) + 1):
        inside = groups == group
        own = [value for value, is_in in zip(values, inside, strict=True) if is_in]
        low, high = (float(min(own)), float(max(own))) if numeric else (None, None)
        found.append(
            Level(
                value=own[0] if low == high or low is None else float(np.median(own)),
                low=low,
                high=high,
                runs=len(own),
                success=rate(success[inside], draws[inside]),
                medians={p: quantile(each[inside], 0.5, draws[inside]) for p, each in metrics.items()},
                margin=float(margins[inside].min()),
                asked=float(asked[inside].max()),
            )
        )
    return found


def best_of(found: Sequence[Level]) -> Level | None:
    """The level with most successes; of equals the one whose medians are smallest, each over the least of its metric.

    Levels with a delay margin below the one asked for count only where all are. None where no run succeeded.
    """
    found = [level for level in found if not level.short and level.success.value] or found
    most = max((level.success.value for level in found), default=0.0)
    if most == 0.0:
        return None
    equals = [level for level in found if level.success.value == most]
    least = {p: min(level.medians[p].value for level in equals) for p in equals[0].medians}

    def excess(level: Level) -> float:
        return math.fsum(level.medians[p].value / value for p, value in least.items() if 0 < value < math.inf)

    return min(equals, key=excess)


def advice(results: Results, controller: str, factor: str) -> str:
    """Which value of a factor to take with a controller, in a sentence."""
    found = levels(results, controller, factor)
    best = best_of(found)
    if best is None:
        text = f"{controller}: no {factor} that was tried succeeds in any run"
        return next((f"{text}; the first: {row.message}" for row in results.of[controller] if row.message), f"{text}.")
    others = sorted({level.words for level in found} - {best.words}, key=[level.words for level in found].index)
    text = f"{controller}: take {factor} = {best.words}"
    text += f" (tried beside it: {', '.join(others)})" if others else ""
    if len(found) > 1 and best.low is not None and best in (found[0], found[-1]):
        side = "smaller" if best is found[0] else "larger"
        text += f"; it is the {'least' if best is found[0] else 'largest'} that was tried, so try {side} ones"
    if best.short:
        text += f"; its delay margin, {1e3 * best.margin:.3g} ms, is below the {1e3 * best.asked:.3g} ms asked for"
    return f"{text}."
