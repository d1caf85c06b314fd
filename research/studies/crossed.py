"""Shares and medians over tunings of one network, tunings of the other and draws, all crossed, with 95 % intervals.

Every tuning of one network meets every tuning of the other on every draw. The luck of each of the three adds to the
variance of a mean, so it is the sum of three parts, each from the means over the other two (Owen, The pigeonhole
bootstrap, Annals of Applied Statistics 1(2), 2007, has the model). A few tunings say little of their own spread: the
normal quantile is replaced by Student's with Satterthwaite's degrees of freedom.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from mmnn_pin.signals import Array

Flags = NDArray[np.bool_]


def share(yes: Flags, counted: Flags) -> dict[str, Any]:
    """Share of the counted comparisons (a, b, draws), or (draws,), that are so, with its 95 % interval."""
    yes, counted = (np.reshape(flags, (1, 1, -1)) if flags.ndim == 1 else flags for flags in (yes, counted))
    if not counted.any():
        return {"share": None, "interval": None, "of": 0}
    found = float(np.mean(yes[counted]))
    return {"share": found, "interval": list(interval(found, yes, counted)), "of": int(counted.sum())}


def middle(ratios: Array) -> dict[str, Any]:
    """Median of ratios (a, b, draws), where their middle 90 % lie, and the median's 95 % interval; nan is left out.

    The interval has its ends where the share of ratios below is at the ends of the interval of one half (Woodruff).
    """
    known = ~np.isnan(ratios)
    if not known.any():
        return {"median": None, "interval": None, "middle_90": None}
    values, median = ratios[known], quantile(ratios[known], 0.5)
    ends = interval(0.5, known & (ratios <= (np.inf if median is None else median)), known)
    return {
        "median": median,
        "interval": [quantile(values, q) for q in ends],
        "middle_90": [quantile(values, q) for q in (0.05, 0.95)],
    }


def quantile(values: Array, q: float) -> float | None:
    """Quantile, an observed value; None for infinity."""
    found = float(np.quantile(values, q, method="inverted_cdf"))
    return found if np.isfinite(found) else None


def interval(p: float, yes: Flags, counted: Flags) -> tuple[float, float]:
    """95 % interval around a share p, as wide as the share of `yes` is uncertain."""
    found, parts = float(np.mean(yes[counted])), variances(yes, counted)
    total = sum(variance for variance, _ in parts)
    if not total > 0:  # all agree
        return wilson(p, int(counted.any(axis=(0, 1)).sum()))
    freedom = total**2 / sum(variance**2 / (size - 1) for variance, size in parts)
    number = min(float(counted.sum()), found * (1 - found) / total)
    return wilson(p, number, float(student.ppf(0.975, freedom)))


def variances(yes: Flags, counted: Flags) -> list[tuple[float, int]]:
    """Variance of a share by the luck of each of the three axes, and the axis's size; none where it has one place."""
    away = np.where(counted, yes - np.mean(yes[counted]), 0.0) / counted.mean()
    parts = []
    for axis, size in enumerate(away.shape):
        if size > 1:
            means = away.mean(axis=tuple(other for other in range(3) if other != axis))
            parts.append((float(means.var(ddof=1)) / size, size))
    return parts


def wilson(p: float, n: float, z: float = 1.959964) -> tuple[float, float]:
    """Wilson's interval of a share p of n; 95 % for z of the normal distribution."""
    middle, half = p + z**2 / (2 * n), z * float(np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2)))
    return max(0.0, (middle - half) / (1 + z**2 / n)), min(1.0, (middle + half) / (1 + z**2 / n))
