"""Intervals of 95 % for a rate or a quantile of so many runs, which assume no distribution; and a paired test.

Draws of the factors are independent; runs of one draw, with several seeds or in several cells of a grid, are not: they
share masses, friction and whatever else was drawn. So n runs of G draws say as much of a share as n / d independent
ones do. The design effect d is the variance of the share between draws over that of independent runs (Kish, 1965,
Survey Sampling): 1 where a draw decides nothing, n / G where it decides all. It is estimated from G draws, so the
interval is widened by Student's t (Korn and Graubard, 1998, Survey Methodology 24). With one run per draw these are
Wilson's interval, that of two order statistics, and McNemar's exact test.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are slow to import, and come when they are used
from numpy.typing import NDArray

from ...signals import Array, IntArray

LEVEL = 0.95
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Interval:
    """An estimate with its confidence interval."""

    value: float
    low: float
    high: float

    def to_dict(self) -> dict[str, float | None]:
        """For JSON, which knows no inf and no nan."""
        parts = {"value": self.value, "low": self.low, "high": self.high}
        return {name: number if math.isfinite(number) else None for name, number in parts.items()}


def rate(success: Mask, draws: IntArray | None = None) -> Interval:
    """A share with Wilson's interval for as many independent runs as these say; nan without runs.

    Args:
        success: (n,) which runs are a success.
        draws: (n,) number of the draw of every run; None where each has its own.
    """
    n = len(success)
    if not n:
        return Interval(math.nan, 0.0, 1.0)
    p, z2 = float(np.mean(success)), float(scipy.stats.norm.ppf((1 + LEVEL) / 2)) ** 2
    worth = independent(np.asarray(success, float), draws)
    middle, half = p + z2 / (2 * worth), math.sqrt(z2 * p * (1 - p) / worth + (z2 / (2 * worth)) ** 2)
    low, high = ((middle + side * half) / (1 + z2 / worth) for side in (-1.0, 1.0))
    return Interval(p, low if p > 0 else 0.0, high if p < 1 else 1.0)


def quantile(values: Array, q: float, draws: IntArray | None = None) -> Interval:
    """A quantile with the interval between two order statistics, whose ranks are binomial.

    Args:
        values: (n,) of the runs; inf is larger than all others.
        q: Which, between 0 and 1.
        draws: As of `rate`.
    """
    n = len(values)
    if not n:
        return Interval(math.nan, math.nan, math.nan)
    ordered = np.sort(values)
    value = float(np.quantile(ordered, q, method="inverted_cdf"))
    worth = math.floor(independent(np.asarray(values <= value, float), draws))
    low, high = (int(scipy.stats.binom.ppf(p, worth, q)) for p in ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    low, high = low * n // worth, -(-(high + 1) * n // worth) - 1  # ranks of as many runs as there are, outwards
    return Interval(
        value, float(ordered[low - 1]) if low > 0 else -math.inf, float(ordered[high]) if high < n else math.inf
    )


def independent(hit: Array, draws: IntArray | None) -> float:
    """How many independent runs say as much of a share as some runs do.

    Args:
        hit: (n,) 1 or 0, at least one; the share is their mean.
        draws: As of `rate`.
    """
    n = len(hit)
    if draws is None or (counts := np.bincount(np.unique(draws, return_inverse=True)[1])).size == n:
        return float(n)
    least, groups = n**2 / float((counts**2).sum()), counts.size
    spread = n * float(hit.var()) * n / (n - 1)  # of the sum, if runs were independent
    if groups < 2 or spread == 0:
        return least
    sums = np.bincount(np.unique(draws, return_inverse=True)[1], hit - hit.mean())
    effect = groups / (groups - 1) * float((sums**2).sum()) / spread
    few, many = (float(scipy.stats.t.ppf((1 + LEVEL) / 2, one - 1)) for one in (groups, n))
    return float(np.clip(n / max(effect, 1.0) * (many / few) ** 2, least, n))


def differ(one: Mask, other: Mask, draws: IntArray | None = None) -> float:
    """Probability of so unequal successes by chance: the exact sign test on draws, McNemar's with one run for each.

    Args:
        one: (n,) successes of one controller.
        other: (n,) of another one, on the same draws and seeds.
        draws: As of `rate`.
    """
    more = one.astype(float) - other
    if draws is not None and len(draws):
        more = np.bincount(np.unique(draws, return_inverse=True)[1], more)
    wins, losses = int((more > 0).sum()), int((more < 0).sum())
    return float(scipy.stats.binomtest(wins, wins + losses).pvalue) if wins + losses else 1.0


def percent(interval: Interval) -> str:
    """A rate with its interval."""
    return f"{100 * interval.value:.1f} % [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
