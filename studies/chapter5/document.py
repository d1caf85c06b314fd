"""docs/chapter5.md out of a summary: no number in it is written by hand."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import jinja2

from ..chapter4.document import DOCS, median, percent, ratio, share, three, within

HERE = Path(__file__).parent
SUMMARY = HERE / "summary.json"


def render(summary: dict[str, Any]) -> str:
    """The document."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=False,
    )
    environment.filters |= {"percent": percent, "three": three, "within": within, "share": share, "median": median}
    environment.filters |= {
        "zip": zip,
        "missed": missed,
        "ratio": ratio,
        "four": lambda value: f"{value:.4f}",
        "two": lambda value: f"{value:.2f}",
    }
    text = environment.get_template("chapter5.md.j2").render(**summary)
    return "\n".join(line.rstrip() for line in text.splitlines()) + "\n"


def missed(intervals: list[dict[str, Any]]) -> str:
    """Figures with an interval that is not met, in words."""
    figures = sorted({row["figure"].partition(" ")[0] for row in intervals if not row["inside"]})
    return ", ".join(figures) or "none"


def publish(out: Path) -> None:
    """Renew the summary that is kept, the document and the figures that it shows."""
    shutil.copyfile(out / "summary.json", SUMMARY)
    write_document()
    text = (DOCS / "chapter5.md").read_text(encoding="utf-8")
    (DOCS / "figures").mkdir(exist_ok=True)
    for name in re.findall(r"\(figures/([^)]+)\)", text):
        shutil.copyfile(out / "figures" / name, DOCS / "figures" / name)


def write_document() -> None:
    """docs/chapter5.md from the summary that is kept."""
    summary = json.loads(SUMMARY.read_text(encoding="utf-8"))
    (DOCS / "chapter5.md").write_text(render(summary), encoding="utf-8")
