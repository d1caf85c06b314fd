"""What the rows of the claim's test say: shares, medians, their confidence intervals, gain apart from learning."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from mmnn_pin.signals import Array
from research.studies.crossed import middle, share

from .claim import THESIS, Row
from .draws import PARTS, RANGES, REFERENCES, WINDOWS
from .unstated import LEARNERS

IDLE = 0.01  # a learner within this of PD at its own gain has learned nothing that shows
ALL = "all"
JUDGED = (*PARTS, "both")
SPLITS = {"initial": ("zero", "random"), "centres": ("diagonal", "random")}  # what else a draw decides, as printed


def verdict(rows: Sequence[Row]) -> dict[str, Any]:
    """Condition to group of draws (all, a motion, a split) to part and window to numbers, for JSON."""
    found: dict[str, Any] = {}
    for condition in dict.fromkeys(row["condition"] for row in rows):
        mine = [row for row in rows if row["condition"] == condition]
        groups = {ALL: mine} | {name: [row for row in mine if row["reference"] == name] for name in REFERENCES}
        if condition == THESIS:  # a tuned network has its own
            for key, values in SPLITS.items():
                groups |= {f"{key} {value}": [row for row in mine if row.get(key) == value] for value in values}
        found[condition] = {name: of_group(group) for name, group in groups.items() if group}
    return found


def of_group(rows: Sequence[Row]) -> dict[str, Any]:
    """Numbers of some draws."""
    runs = {name: sum(row[f"{name}.diverged"] for row in rows) for name in LEARNERS}
    first = [row for row in rows if row["tuning"] == rows[0]["tuning"]]
    return {
        "draws": len(first),
        "tunings": len(rows) // len(first),
        "lost": {"pd": int(sum(row["pd.diverged"] for row in first))} | {name: int(n) for name, n in runs.items()},
        **{f"{part}.{window}": of_part(rows, part, window) for part in JUDGED for window in WINDOWS},
    }


def of_part(rows: Sequence[Row], part: str, window: str) -> dict[str, Any]:
    """Who wins, by how much, and why, for the base, the arm or both in one window."""
    pd = column(rows, "pd", part, window)[:1, None]
    two, one = across(rows, part, window)
    gain_two, gain_one = across(rows, part, window, "gain_of_")
    integral_two, integral_one = across(rows, part, window, "integral_of_")
    with np.errstate(all="ignore"):
        ratio = two / one
        decided = ~(np.isinf(two) & np.isinf(one))
        learns = decided & (one / gain_one < 1 - IDLE)
        return {
            "two_layer_wins": share(two < one, decided),
            "pairs": [[share(a < b, ~(np.isinf(a) & np.isinf(b)))["share"] for b in one[0]] for a in two[:, 0]],
            "ratio": middle(ratio),
            "gain": middle(gain_two / gain_one),
            "learning": middle((two / gain_two) / (one / gain_one)),
            "wins_where_one_layer_learns": share(two < one, learns),
            "errors": {
                name: middle(found)["median"] for name, found in zip(("pd", *LEARNERS), (pd, two, one), strict=True)
            },
            **of_learner("two_layer", two, gain_two, pd, integral_two),
            **of_learner("one_layer", one, gain_one, pd, integral_one),
        }


def of_learner(name: str, error: Array, at_gain: Array, pd: Array, integral: Array) -> dict[str, Any]:
    """One network beside PD at its own gain, PD, and its integral alone."""
    learned = error / at_gain
    known = ~np.isnan(learned)
    return {
        f"{name}_by_learning": middle(learned),
        f"{name}_to_pd": middle(error / pd),
        f"{name}_to_integral": middle(error / integral),
        f"{name}_idle": share(np.abs(learned - 1) < IDLE, known),
        f"{name}_harms": share(learned > 1 + IDLE, known),
    }


def across(rows: Sequence[Row], part: str, window: str, prefix: str = "") -> tuple[Array, Array]:
    """Errors of the networks, (tunings, 1, draws) and (1, tunings, draws): against each other they give all pairs."""
    two, one = (column(rows, prefix + name, part, window) for name in LEARNERS)
    return two[:, None], one[None]


def column(rows: Sequence[Row], name: str, part: str, window: str) -> Array:
    """Errors of a controller, (tunings, draws): inf where its run was lost, nan where it was not run.

    For `both` the geometric mean of base and arm.
    """
    if part == "both":
        return np.sqrt(column(rows, name, "base", window) * column(rows, name, "arm", window))
    found = [np.nan if row[key] is None else float(row[key]) for row in rows for key in [f"{name}.{part}.{window}"]]
    tunings, draws = np.array([row["tuning"] for row in rows]), np.array([row["draw"] for row in rows])
    order = np.lexsort((draws, tunings))
    return np.array(found)[order].reshape(len(set(tunings.tolist())), -1)


def what_decides(rows: Sequence[Row], part: str) -> list[dict[str, Any]]:
    """Spearman's correlation of the ratio two-layer to one-layer with every number drawn, strongest first.

    With several tunings, of the median over their pairs.
    """
    first = sorted((row for row in rows if row["tuning"] == rows[0]["tuning"]), key=lambda row: row["draw"])
    two, one = across(rows, part, "tracking")
    with np.errstate(all="ignore"):
        ratio = np.median(two / one, axis=(0, 1))
    known = ~np.isnan(ratio)  # somebody arrived in every pair
    numbers = [name for name in (*RANGES, "period") if name in first[0]]
    found = []
    for name in [*numbers, *(name for name in first[0] if name.startswith("mass factor"))]:
        value = np.array([float(row[name]) for row in first])[known]
        found.append({"name": name, "correlation": float(spearmanr(value, ratio[known]).statistic)})
    return sorted(found, key=lambda entry: -abs(entry["correlation"]))
