"""docs/chapter4.md out of a summary: no number in it is written by hand."""

from __future__ import annotations

import json
import math
import re
import shutil
from pathlib import Path
from typing import Any

import jinja2

HERE = Path(__file__).parent
SUMMARY = HERE / "summary.json"
DOCS = HERE.parents[1] / "docs"


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
    environment.filters |= {"exp": lambda value: three(math.exp(value)), "tiny": lambda value: f"{value:.0e}"}
    text = environment.get_template("chapter4.md.j2").render(**summary)
    return "\n".join(line.rstrip() for line in text.splitlines()) + "\n"


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
    low, high = entry["interval"] or (None, None)
    return f"{percent(entry['share'])} ({bare(low)} to {bare(high)})"


def bare(value: float | None) -> str:
    """A share in percent without its sign."""
    return percent(value).removesuffix(" %")


def median(entry: dict[str, Any]) -> str:
    """A median with its confidence interval."""
    low, high = entry["interval"]
    return f"{ratio(entry['median'])} ({ratio(low)} to {ratio(high)})"


def within(entry: dict[str, Any]) -> str:
    """Where the middle 90 % lie."""
    return " to ".join(map(ratio, entry["middle_90"]))


def ratio(value: float | None) -> str:
    """A ratio of errors; infinite where the first run was lost."""
    return "∞" if value is None else three(value)


def publish(out: Path) -> None:
    """Renew the summary that is kept, the document and the figures that it shows."""
    shutil.copyfile(out / "summary.json", SUMMARY)
    write_document()
    text = (DOCS / "chapter4.md").read_text(encoding="utf-8")
    (DOCS / "figures").mkdir(exist_ok=True)
    for name in re.findall(r"\(figures/([^)]+)\)", text):
        shutil.copyfile(out / "figures" / name, DOCS / "figures" / name)


def write_document() -> None:
    """docs/chapter4.md from the summary that is kept."""
    summary = json.loads(SUMMARY.read_text(encoding="utf-8"))
    (DOCS / "chapter4.md").write_text(render(summary), encoding="utf-8")
