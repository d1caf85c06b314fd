"""docs/contest.md out of a summary: no number in it is written by hand."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from mmnn_pin.lab.show.table import number

from ..document import DOCS, environment, filled, kept, renew_figures

HERE = Path(__file__).parent
SUMMARY = HERE / "summary.json"


def render(summary: dict[str, Any]) -> str:
    """The document."""
    templates = environment(HERE)
    templates.filters |= {"cell": cell, "number": number, "percent": lambda value: f"{100 * value:.3g} %"}
    templates.filters |= {"setting": setting, "middle": middle}
    return filled(templates, "contest.md.j2", summary)


def cell(values: list[Any] | None, infinite: str = "never") -> str:
    """Median, with half of the spread in percent from 1 % on."""
    if values is None:
        return "-"
    low, mid, high = values
    if mid == "inf":
        return infinite
    if high == "inf":
        return f"{number(mid)}, to {infinite}"
    spread = 50 * (high - low) / mid if mid > 0 else 0.0
    return number(mid) + (f" ±{spread:.0f} %" if spread >= 1 else "")


def middle(values: list[Any]) -> str:
    """The median alone."""
    return "never" if values[1] == "inf" else number(values[1])


def setting(value: Any) -> str:
    """A value of a setting."""
    return f"[{', '.join(f'{each:g}' for each in value)}]" if isinstance(value, list) else f"{value:g}"


def publish(out: Path) -> None:
    """Renew the summary that is kept, the document and the figures that it shows."""
    shutil.copyfile(out / "summary.json", SUMMARY)
    write_document()
    renew_figures(out, DOCS / "contest.md")


def write_document() -> None:
    """docs/contest.md from the summary that is kept."""
    (DOCS / "contest.md").write_text(render(kept(SUMMARY)), encoding="utf-8")
