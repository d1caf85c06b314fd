"""What the studies share: a document out of a template and a summary that is kept beside it, a clock, rows as CSV.

No number in a document is written by hand.
"""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2

DOCS = Path(__file__).parents[2] / "docs"


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


@dataclass(frozen=True)
class Document:
    """A document of docs/ and the summary that it is made from."""

    name: str  # of the document in docs/, with its folder and without its ending
    summary: Path  # where the summary is kept
    render: Callable[[dict[str, Any]], str]  # makes the text of a summary
    # makes the rows of a CSV file beside the document, of data that nobody reads as text
    rows: Callable[[dict[str, Any]], list[dict[str, Any]]] | None = None

    def publish(self, out: Path) -> None:
        """Renew the summary that is kept, the document and the figures that it shows."""
        shutil.copyfile(out / "summary.json", self.summary)
        self.write()
        (DOCS / "figures").mkdir(exist_ok=True)
        for name in re.findall(r"\(\.\./figures/([^)]+)\)", (DOCS / f"{self.name}.md").read_text(encoding="utf-8")):
            shutil.copyfile(out / "figures" / name, DOCS / "figures" / name)

    def write(self) -> None:
        """The document from the summary that is kept."""
        self._write(kept(self.summary), DOCS / self.name)

    def save(self, summary: dict[str, Any], out: Path, publish: bool) -> None:
        """Write a summary and its document to a folder, and publish them if asked to."""
        (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
        self._write(summary, out / Path(self.name).name)
        if publish:
            self.publish(out)

    def _write(self, summary: dict[str, Any], where: Path) -> None:
        """The document, and the CSV file beside it."""
        where.with_suffix(".md").write_text(self.render(summary), encoding="utf-8")
        if self.rows:
            write_rows(where.with_suffix(".csv"), self.rows(summary))


class Clock:
    """Says what is done and when, and how long all of it took."""

    def __init__(self) -> None:
        self.begin, self.processor, self.load = time.perf_counter(), time.process_time(), os.getloadavg()[0]

    def say(self, text: str) -> None:
        """Print a line with the time since the start."""
        print(f"{time.perf_counter() - self.begin:6.1f} s  {text}", flush=True)

    def facts(self) -> dict[str, Any]:
        """Wall-clock and processor time so far, and how busy the machine was."""
        return {
            "wall_s": time.perf_counter() - self.begin,
            "processor_s": time.process_time() - self.processor,
            "cores": os.cpu_count(),
            "load_before": self.load,
            "load_after": os.getloadavg()[0],
        }


def write_rows(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Rows as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
