"""What the rows of the claim's test say: shares, medians, their confidence intervals, gain apart from learning."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from mmnn_pin.signals import Array

from .claim import PARTS, WINDOWS, Row
from .draws import RANGES, REFERENCES
from .unstated import LEARNERS

Flags = NDArray[np.bool_]
IDLE = 0.01  # a learner within this of PD at its own gain has learned nothing that shows
ALL = "all"
JUDGED = (*PARTS, "both")


def verdict(rows: Sequence[Row]) -> dict[str, Any]:
    """Condition to reference (or `all` of them) to part and window to numbers, for JSON."""
    found: dict[str, Any] = {}
    for condition in dict.fromkeys(row["condition"] for row in rows):
        mine = [row for row in rows if row["condition"] == condition]
        chosen = {ALL: mine} | {name: [row for row in mine if row["reference"] == name] for name in REFERENCES}
        found[condition] = {name: of_reference(part) for name, part in chosen.items()}
    return found


def of_reference(rows: Sequence[Row]) -> dict[str, Any]:
    """Numbers of one reference, or of all pooled."""
    draws = np.array([row["draw"] for row in rows])
    return {
        "pairs": len(rows),
        "draws": len(set(draws.tolist())),
        "lost": {name: int(sum(row[f"{name}.diverged"] for row in rows)) for name in ("pd", *LEARNERS)},
        **{f"{part}.{window}": of_part(rows, draws, part, window) for part in JUDGED for window in WINDOWS},
    }


def of_part(rows: Sequence[Row], draws: Array, part: str, window: str) -> dict[str, Any]:
    """Who wins, by how much, and why, for the base or the arm in one window."""
    two, one, gain_two, gain_one, pd = (
        column(rows, name, part, window) for name in (*LEARNERS, *(f"gain_of_{name}" for name in LEARNERS), "pd")
    )
    with np.errstate(all="ignore"):
        learns = one / gain_one < 1 - IDLE
        return {
            "two_layer_wins": share(two < one, draws),
            "one_layer_wins": share(one < two, draws),
            "both_lost": int(np.sum(np.isinf(two) & np.isinf(one))),
            "ratio": middle(two / one, draws),
            "gain": middle(gain_two / gain_one, draws),
            "learning": middle((two / gain_two) / (one / gain_one), draws),
            "two_layer_by_learning": middle(two / gain_two, draws),
            "one_layer_by_learning": middle(one / gain_one, draws),
            "two_layer_to_pd": middle(two / pd, draws),
            "one_layer_to_pd": middle(one / pd, draws),
            "two_layer_idle": share(np.abs(two / gain_two - 1) < IDLE, draws),
            "one_layer_idle": share(np.abs(one / gain_one - 1) < IDLE, draws),
            "one_layer_harms": share(one / gain_one > 1 + IDLE, draws),
            "two_layer_harms": share(two / gain_two > 1 + IDLE, draws),
            "wins_where_one_layer_learns": share((two < one)[learns], draws[learns]),
        }


def column(rows: Sequence[Row], name: str, part: str, window: str) -> Array:
    """Errors of a controller, inf where its run was lost; for `both` the geometric mean of base and arm."""
    if part == "both":
        return np.sqrt(column(rows, name, "base", window) * column(rows, name, "arm", window))
    return np.array([float(row[f"{name}.{part}.{window}"]) for row in rows])


def share(yes: Flags, draws: Array) -> dict[str, Any]:
    """Share of pairs with its 95 % interval."""
    if not len(yes):
        return {"share": None, "interval": None, "of": 0}
    found = float(np.mean(yes))
    return {"share": found, "interval": list(wilson(found, effective_number(yes, draws))), "of": len(yes)}


def middle(ratios: Array, draws: Array) -> dict[str, Any]:
    """Median of ratios, where their middle 90 % lie, and the median's 95 % interval; what both lost is left out.

    The interval has its ends where the share of pairs below is at the ends of the interval of one half (Woodruff).
    """
    known = ~np.isnan(ratios)
    if not known.any():
        return {"median": None, "interval": None, "middle_90": None}
    values, median = ratios[known], quantile(ratios[known], 0.5)
    below = values <= (np.inf if median is None else median)
    interval = [quantile(values, q) for q in wilson(0.5, effective_number(below, draws[known]))]
    return {"median": median, "interval": interval, "middle_90": [quantile(values, q) for q in (0.05, 0.95)]}


def quantile(values: Array, q: float) -> float | None:
    """Quantile, an observed value; None for infinity."""
    found = float(np.quantile(values, q, method="inverted_cdf"))
    return found if np.isfinite(found) else None


def effective_number(yes: Flags, draws: Array) -> float:
    """How many independent pairs say as much about a share as these, of which those of one draw go together.

    `p (1 - p) / variance`, the variance of p from the sums over whole draws; the number of draws where all agree.
    """
    p, groups = float(np.mean(yes)), len(set(draws.tolist()))
    sums = np.bincount(np.unique(draws, return_inverse=True)[1], weights=np.asarray(yes, float) - p)
    variance = float(np.sum(sums**2)) / len(yes) ** 2 * groups / max(1, groups - 1)
    return min(len(yes), p * (1 - p) / variance) if variance > 0 else groups


def wilson(p: float, n: float, z: float = 1.959964) -> tuple[float, float]:
    """Wilson's 95 % interval of a share p of n."""
    middle, half = p + z**2 / (2 * n), z * float(np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2)))
    return max(0.0, (middle - half) / (1 + z**2 / n)), min(1.0, (middle + half) / (1 + z**2 / n))


def what_decides(rows: Sequence[Row], part: str) -> list[dict[str, Any]]:
    """Spearman's correlation of the ratio two-layer to one-layer with every number drawn, strongest first."""
    two, one = (column(rows, name, part, "tracking") for name in LEARNERS)
    known = ~(np.isinf(two) & np.isinf(one))
    with np.errstate(all="ignore"):
        ratio = (two / one)[known]
    names = [name for name in (*RANGES, "period") if name in rows[0]] + [
        n for n in rows[0] if n.startswith("mass factor")
    ]
    found = []
    for name in names:
        value = np.array([float(row[name]) for row in rows])[known]
        found.append({"name": name, "correlation": float(spearmanr(value, ratio).statistic)})
    return sorted(found, key=lambda entry: -abs(entry["correlation"]))
