"""A document out of a template and a summary that is kept beside it: no number in it is written by hand."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import jinja2

DOCS = Path(__file__).parents[1] / "docs"


def environment(folder: Path) -> jinja2.Environment:
    """Templates of a folder; a name that a summary does not have is an error."""
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=False,
    )


def filled(templates: jinja2.Environment, name: str, summary: dict[str, Any]) -> str:
    """A template with the numbers of a summary."""
    text = templates.get_template(name).render(**summary)
    return "\n".join(line.rstrip() for line in text.splitlines()) + "\n"


def kept(summary: Path) -> dict[str, Any]:
    """The summary that is kept."""
    content: dict[str, Any] = json.loads(summary.read_text(encoding="utf-8"))
    return content


def renew_figures(out: Path, document: Path) -> None:
    """Copy the figures that a document shows."""
    (DOCS / "figures").mkdir(exist_ok=True)
    for name in re.findall(r"\(figures/([^)]+)\)", document.read_text(encoding="utf-8")):
        shutil.copyfile(out / "figures" / name, DOCS / "figures" / name)
