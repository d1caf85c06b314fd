"""Confidence intervals that assume no distribution, and the paired test of two rates. All are of 95 %."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, binomtest

from ...signals import Array

LEVEL = 0.95


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
