"""What rows of the judge come to: shares, ratios and losses against the baseline; see `preregistered.toml`."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mmnn_pin.signals import Array

from .draws import preregistered

Row = dict[str, Any]


@dataclass(frozen=True)
class Score:
    """A controller's score on some draws.

    Attributes:
        draws: How many have a run of it and of the baseline.
        better: Share of those that are not lost by both on which it errs less than the baseline.
        median, high, worst: Ratio of its error to the baseline's: median, 90th percentile, largest; nan without any.
        lost: Draws that it lost.
        alone: Draws that it lost and the baseline did not.
        arm, base: Median ratio of the arm's error alone, and of the base's.
    """

    draws: int
    better: float
    median: float
    high: float
    worst: float
    lost: int
    alone: int
    arm: float = math.nan
    base: float = math.nan


PARTS = "arm", "base"


def ratio_of(row: Row, baseline: Row, of: Sequence[str] = PARTS) -> float:
    """Error of a run over that of the baseline's, geometric mean of arm and base; nan where both are lost.

    Args:
        row: Of the run.
        baseline: Of the baseline's.
        of: Errors that count; nan, too, where the robot has none of them.

    >>> row = {"arm": 0.01, "base": 0.002, "lost": ""}
    >>> ratio_of(row, {"arm": 0.02, "base": 0.016, "lost": ""})
    0.25
    """
    if row["lost"] or baseline["lost"]:
        return math.nan if row["lost"] and baseline["lost"] else math.inf if row["lost"] else 0.0
    parts = [row[part] / baseline[part] for part in of if baseline[part] is not None]
    return float(math.prod(parts) ** (1.0 / len(parts))) if parts else math.nan


def score_of(pairs: Sequence[tuple[Row, Row]]) -> Score:
    """The score of runs, each beside the baseline's of the same draw."""
    lost = sum(bool(row["lost"]) for row, _ in pairs)
    alone = sum(bool(row["lost"]) and not baseline["lost"] for row, baseline in pairs)
    told = ratios_of(pairs)
    better = float(np.mean(told < 1.0)) if told.size else math.nan
    median, high, worst = (quantile(told, share) for share in (0.5, 0.9, 1.0))
    arm, base = (quantile(ratios_of(pairs, [part]), 0.5) for part in PARTS)
    return Score(len(pairs), better, median, high, worst, lost, alone, arm, base)


def ratios_of(pairs: Sequence[tuple[Row, Row]], of: Sequence[str] = PARTS) -> Array:
    """Ratios of runs that say one, sorted."""
    ratios = np.array([ratio_of(row, baseline, of) for row, baseline in pairs])
    return np.sort(ratios[~np.isnan(ratios)])


def quantile(ordered: Array, share: float) -> float:
    """The smallest number that a share of all does not exceed; nan of none. No interpolation: they may be inf."""
    return float(ordered[math.ceil(share * len(ordered)) - 1]) if ordered.size else math.nan


def paired(rows: Iterable[Row], name: str) -> list[tuple[Row, Row]]:
    """A controller's rows beside the baseline's of the same draws, in the order of robots and draws."""
    runs: dict[str, dict[tuple[str, str, int], Row]] = defaultdict(dict)
    for row in rows:
        runs[row["controller"]][row["plant"], row["robot"], row["draw"]] = row
    baseline = runs[preregistered()["controllers"]["baseline"]]
    return [(row, baseline[key]) for key, row in sorted(runs[name].items()) if key in baseline]


def within(row: Row, line: dict[str, Any]) -> bool:
    """Whether a row's draw is on this side of a disturbance's line."""
    return all(
        low_high[0] <= row["said"][name] <= low_high[1] if isinstance(low_high, list) else row["said"][name] == low_high
        for name, low_high in line.items()
    )


def parts_of_table(rows: Sequence[Row]) -> dict[str, dict[str, list[Row]]]:
    """The rows of all draws, of every robot, with and without every disturbance: kind of table, part, rows."""
    robots = list(dict.fromkeys(row["robot"] for row in rows))
    found = {"all": {"all draws": list(rows)}}
    found["robots"] = {robot: [row for row in rows if row["robot"] == robot] for robot in robots}
    found["disturbances"] = {}
    for name, line in preregistered()["disturbances"].items():
        for side, words in ((True, name), (False, f"not {name}")):
            found["disturbances"][words] = [row for row in rows if within(row, line) == side]
    return found
