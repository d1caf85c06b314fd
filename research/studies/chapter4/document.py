"""docs/thesis/chapter4.md out of a summary: no number in it is written by hand."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mmnn_pin.lab.experiments.controllers import EFFECTIVE
from research.studies.document import Document, environment, filled

from .unstated import LEARNERS

HERE = Path(__file__).parent
SUMMARY = HERE / "summary.json"


def render(summary: dict[str, Any]) -> str:
    """The document."""
    templates = environment(HERE)
    templates.filters |= {"percent": percent, "three": three, "share": share, "median": median}
    templates.filters |= {"wins": wins, "parts": parts, "changed": changed, "own": own, "listed": listed}
    templates.tests["search"] = lambda text, pattern: re.search(pattern, text) is not None
    templates.globals |= {"same_peaks": same_peaks, "same_fit": same_fit}
    return filled(templates, "chapter4.md.j2", summary)


def percent(value: float | None) -> str:
    """A share in percent, without decimals unless it is next to none or next to all."""
    if value is None:
        return "-"
    if 0 < value < 0.001 or 0.999 < value < 1:
        return "< 0.1 %" if value < 0.5 else "> 99.9 %"
    digits = 1 if 0 < value < 0.01 or 0.99 < value < 1 else 0
    return f"{100 * value:.{digits}f} %"


def three(value: float | None) -> str:
    """A number with three significant digits, no exponent."""
    if value is None:
        return "-"
    text = f"{value:#.3g}"
    return f"{float(text):.0f}" if "e" in text else text.rstrip(".")


def share(entry: dict[str, Any]) -> str:
    """A share with its confidence interval."""
    if entry["interval"] is None:
        return "-"
    low, high = entry["interval"]
    return f"{percent(entry['share'])} ({bare(low)} to {bare(high)})"


def bare(value: float | None) -> str:
    """A share in percent without its sign."""
    return percent(value).removesuffix(" %")


def median(entry: dict[str, Any]) -> str:
    """A median with its confidence interval."""
    if entry["interval"] is None:
        return "-"
    low, high = entry["interval"]
    return f"{ratio(entry['median'])} ({ratio(low)} to {ratio(high)})"


def ratio(value: float | None) -> str:
    """A ratio of errors; infinite where the first run was lost."""
    return "∞" if value is None else three(value)


def wins(entry: dict[str, Any]) -> str:
    """Who wins more than half of the comparisons, if the interval of the two-layer network's share says so."""
    low, high = entry["interval"] or (0.0, 1.0)
    return "two-layer better" if low > 0.5 else "one-layer better" if high < 0.5 else "undecided"


def own(entry: dict[str, Any], like: float = 1.1) -> str:
    """What a ratio's confidence interval says of a network beside something simpler."""
    low, high = (math.inf if end is None else end for end in entry["interval"] or (0.0, math.inf))
    if 1 / like < low and high < like:
        return "does as well as"
    return "is better than" if high < 1 else "is worse than" if low > 1 else "cannot be told from"


def same_fit(variant: dict[str, Any], case: dict[str, Any]) -> bool:
    """Whether a variant has the extremes of a case's best, to a thousandth of their intervals."""
    pairs = zip(variant["intervals"], case["intervals"], strict=True)
    return all(abs(a["value"] - b["value"]) < 1e-3 * (b["upper"] - b["lower"]) for a, b in pairs)


def same_peaks(variant: dict[str, Any], by: float = 0.1) -> bool:
    """Whether PD at each network's gain peaks in x where the network does, but for a share of it."""
    peaks = {name: run["pose_error.x.peak"] for name, run in variant["metrics"].items()}
    return all(abs(peaks[gain] / peaks[learner] - 1) < by for gain, learner in EFFECTIVE.items())


def parts(improvement: dict[str, float | None]) -> str:
    """What gain and learning take from PD's error, in percent of it, and learning's share where they take anything."""
    pd, gain, learning = (float(improvement[key] or 0.0) for key in ("pd", "gain", "learning"))
    share = improvement["learning_share"]
    total = "worse than PD" if share is None else f"learning {percent(share)}"
    return f"{100 * gain / pd:.1f} {'+' if learning >= 0 else '−'} {abs(100 * learning / pd):.1f} ({total})"


def changed(readings: list[dict[str, Any]], by: float = 0.1) -> list[str]:
    """Readings that move an RMS error of the document's table by more than a share of what it is in the first."""
    rows = ("pose_error.x", "e.arm_1_joint")
    first = readings[0]
    found = []
    for reading in readings[1:]:
        pairs = [(reading[name]["rms"][row], first[name]["rms"][row]) for name in LEARNERS for row in rows]
        if any(now is None or abs(now / then - 1) > by for now, then in pairs):
            found.append(reading["reading"])
    return found


def listed(names: Iterable[str]) -> str:
    """Names in a row."""
    return ", ".join(names) or "none"


DOCUMENT = Document("thesis/chapter4", SUMMARY, render)
