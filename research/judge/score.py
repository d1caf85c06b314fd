"""What rows of the judge come to: shares, ratios and losses against the baseline; see `preregistered.toml`."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

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
    """

    draws: int
    better: float
    median: float
    high: float
    worst: float
    lost: int
    alone: int


def ratio_of(row: Row, baseline: Row) -> float:
    """Error of a run over that of the baseline's, geometric mean of arm and base; nan where both are lost.

    >>> row = {"arm": 0.01, "base": 0.002, "lost": ""}
    >>> ratio_of(row, {"arm": 0.02, "base": 0.016, "lost": ""})
    0.25
    """
    if row["lost"] or baseline["lost"]:
        return math.nan if row["lost"] and baseline["lost"] else math.inf if row["lost"] else 0.0
    parts = [row[part] / baseline[part] for part in ("arm", "base") if baseline[part] is not None]
    return float(math.prod(parts) ** (1.0 / len(parts)))


def score_of(pairs: Sequence[tuple[Row, Row]]) -> Score:
    """The score of runs, each beside the baseline's of the same draw."""
    ratios = np.array([ratio_of(row, baseline) for row, baseline in pairs])
    told = np.sort(ratios[~np.isnan(ratios)])
    lost = [bool(row["lost"]) for row, _ in pairs]
    alone = [bool(row["lost"]) and not baseline["lost"] for row, baseline in pairs]
    if not told.size:
        return Score(len(pairs), math.nan, math.nan, math.nan, math.nan, sum(lost), sum(alone))
    at = {share: float(told[math.ceil(share * len(told)) - 1]) for share in (0.5, 0.9, 1.0)}
    return Score(len(pairs), float(np.mean(told < 1.0)), at[0.5], at[0.9], at[1.0], sum(lost), sum(alone))


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
