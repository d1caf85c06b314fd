"""docs/chapter5.md out of a summary: no number in it is written by hand."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from ..chapter4.document import median, percent, ratio, share, three, within
from ..document import DOCS, environment, filled, kept, renew_figures

HERE = Path(__file__).parent
SUMMARY = HERE / "summary.json"


def render(summary: dict[str, Any]) -> str:
    """The document."""
    templates = environment(HERE)
    templates.filters |= {"percent": percent, "three": three, "within": within, "share": share, "median": median}
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


def publish(out: Path) -> None:
    """Renew the summary that is kept, the document and the figures that it shows."""
    shutil.copyfile(out / "summary.json", SUMMARY)
    write_document()
    renew_figures(out, DOCS / "chapter5.md")


def write_document() -> None:
    """docs/chapter5.md from the summary that is kept."""
    (DOCS / "chapter5.md").write_text(render(kept(SUMMARY)), encoding="utf-8")
