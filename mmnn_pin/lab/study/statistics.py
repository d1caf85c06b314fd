"""What numbers of many runs show.

Confidence intervals of 95 % that assume no distribution, a paired test of two rates, and how much of a result each
factor decides: first-order variance shares from the runs themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, binomtest, rankdata, spearmanr
from scipy.stats import f as f_distribution

from ...signals import Array, IntArray

LEVEL = 0.95
BINS = 8


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


def rate(successes: int, runs: int) -> Interval:
    """A share with Wilson's interval; nan without runs."""
    if not runs:
        return Interval(math.nan, 0.0, 1.0)
    found = binomtest(successes, runs).proportion_ci(LEVEL, "wilson")
    return Interval(successes / runs, float(found.low), float(found.high))


def quantile(values: Array, q: float) -> Interval:
    """A quantile with the interval between two order statistics, whose ranks are binomial.

    Args:
        values: (n,) independent draws; inf is larger than all others.
        q: Which, between 0 and 1.
    """
    n = len(values)
    if not n:
        return Interval(math.nan, math.nan, math.nan)
    ordered = np.sort(values)
    low, high = (int(binom.ppf(p, n, q)) for p in ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return Interval(
        float(np.quantile(ordered, q, method="inverted_cdf")),
        float(ordered[low - 1]) if low > 0 else -math.inf,
        float(ordered[high]) if high < n else math.inf,
    )


def differ(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> float:
    """Probability of so unequal successes by chance: McNemar's exact test on runs with equal draws.

    Args:
        one: (n,) successes of one controller.
        other: (n,) of another one, on the same draws.
    """
    wins, losses = int((one & ~other).sum()), int((other & ~one).sum())
    return float(binomtest(wins, wins + losses).pvalue) if wins + losses else 1.0


@dataclass(frozen=True)
class Share:
    """What a factor decides of a result.

    Attributes:
        share: Its first-order share of the variance of the result's ranks, from 0 (nothing) to 1 (all); corrected for
            the number of bins, so that a factor without influence has 0 on average.
        direction: Spearman's rank correlation; nan for a factor without an order.
        p: Probability of so large a share by chance.
    """

    share: float
    direction: float
    p: float


def share_of(values: Sequence[Any], result: Array, ordered: bool) -> Share:
    """Share of one factor in one result.

    The estimate from given data: the variance between the means of bins of the factor over the whole variance
    (Plischke, 2012), of ranks so that runs that diverged count as the worst.

    Args:
        values: (n,) the factor's.
        result: (n,) the result; inf is the worst.
        ordered: Whether the values have an order.
    """
    ranks = rankdata(np.where(np.isnan(result), np.inf, result))
    groups = bins_of(values, ordered)
    n, k = len(ranks), int(groups.max(initial=-1)) + 1
    total = float(((ranks - ranks.mean()) ** 2).sum()) if n else 0.0
    direction = correlation(values, ranks) if ordered else np.nan
    if k < 2 or n <= k or total == 0:
        return Share(0.0, direction if total else np.nan, 1.0)
    counts = np.bincount(groups, minlength=k)
    means = np.bincount(groups, ranks, minlength=k) / counts
    between = float((counts * (means - ranks.mean()) ** 2).sum())
    within = max(total - between, 0.0)
    noise = within / (n - k)
    ratio = between / (k - 1) / noise if noise > 0 else np.inf
    return Share(
        max(0.0, (between - (k - 1) * noise) / total), direction, float(f_distribution.sf(ratio, k - 1, n - k))
    )


def correlation(values: Sequence[Any], ranks: Array) -> float:
    """Rank correlation; nan where one of the two is constant."""
    given = np.asarray(values, float)
    if np.ptp(given) == 0 or np.ptp(ranks) == 0:
        return float("nan")
    return float(spearmanr(given, ranks).statistic)


def bins_of(values: Sequence[Any], ordered: bool, most: int = BINS) -> IntArray:
    """Number of the bin of every value, (n,): its level where there are few, else bins of equally many.

    Args:
        values: (n,).
        ordered: Whether they have an order.
        most: Number of bins, at most.
    """
    levels = levels_of(values, ordered)
    if not ordered or len(levels) <= most:
        place = {identity(level): i for i, level in enumerate(levels)}
        return np.array([place[identity(value)] for value in values], np.int64)
    order = np.asarray(rankdata(np.asarray(values, float), method="min"), np.int64) - 1
    raw = order * most // len(values)
    return np.asarray(np.unique(raw, return_inverse=True)[1], np.int64)


def levels_of(values: Sequence[Any], ordered: bool) -> list[Any]:
    """Different values, in order where they have one."""
    levels = list({identity(value): value for value in values}.values())
    return sorted(levels) if ordered else levels


def identity(value: Any) -> str:
    """What tells values apart; lists too."""
    return repr(value)
