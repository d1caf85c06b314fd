"""docs/thesis/chapter5.md out of a summary: no number in it is written by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from research.studies.chapter4.document import median, percent, ratio, share, three
from research.studies.document import Document, environment, filled

HERE = Path(__file__).parent
SUMMARY = HERE / "summary.json"


def render(summary: dict[str, Any]) -> str:
    """The document."""
    templates = environment(HERE)
    templates.filters |= {"percent": percent, "three": three, "share": share, "median": median}
    templates.filters |= {
        "zip": zip,
        "missed": missed,
        "ratio": ratio,
        "four": lambda value: f"{value:.4f}",
        "two": lambda value: f"{value:.2f}",
    }
    return filled(templates, "chapter5.md.j2", summary)


def missed(intervals: list[dict[str, Any]]) -> str:
    """Figures with an interval that is not met, in words."""
    figures = sorted({row["figure"].partition(" ")[0] for row in intervals if not row["inside"]})
    return ", ".join(figures) or "none"


DOCUMENT = Document("thesis/chapter5", SUMMARY, render)
