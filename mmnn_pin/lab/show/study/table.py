"""A study's summary for a terminal, and as numbers for JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from ...study.results import Results
from ...study.statistics import Interval, quantile, rate
from ...study.verdict import sentences, verdict
from ..verdicts import heading

WIDTH = 110
QUANTILES = {"median": 0.5, "95 %": 0.95}
CAPTION = (
    "95 %: what 95 % of the runs stay below. [a, b]: 95 % confidence interval, of draws as if independent. A run that "
    "did not complete counts as worse than all others; inf: so many did not complete."
)
SHOWN = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "m/s": (1e3, "mm/s"), "rad/s": (1e3, "mrad/s")}


def render(results: Results, colour: bool = False, width: int = WIDTH) -> str:
    """Verdict, table and caption, as text of at most `width` columns."""
    console = Console(width=width, force_terminal=colour, color_system="standard" if colour else None)
    with console.capture() as capture:
        console.print(title(results), style="bold", highlight=False)
        for line in sentences(results, verdict(results)):
            console.print(line, highlight=False, markup=False)
        console.print(summary(results))
        console.print(CAPTION, style="italic", highlight=False, markup=False)
        for line in remarks(results):
            console.print(f"note: {line}", highlight=False, markup=False)
    return "\n".join(line.rstrip() for line in capture.get().splitlines())


def title(results: Results) -> str:
    """What was studied, and how much of it is done."""
    name = results.settings.title or results.name
    done = f"{len(results.rows)} runs"
    return f"{name}: {done}" + (f" of {results.planned}" if len(results.rows) < results.planned else "")


def remarks(results: Results) -> list[str]:
    """What a reader must know beside the numbers."""
    notes = []
    if len(results.rows) < results.planned:
        notes.append(f"{results.planned - len(results.rows)} runs are missing; the same command makes them")
    for row in results.failed[:3]:
        notes.append(f"row {row.id} failed and is run again next time: {row.message}")
    refused = [row for row in results.rows if row.status == "refused"]
    for row in refused[:3]:
        notes.append(f"row {row.id} could not be run: {row.message}")
    if len(refused) > 3:
        notes.append(f"{len(refused) - 3} more rows could not be run")
    return notes


def summary(results: Results) -> Table:
    """Rows: outcomes, successes, quantiles of every metric. Columns: controllers."""
    table = Table(box=SIMPLE_HEAD, padding=0)
    table.add_column("", overflow="fold")
    table.add_column("", no_wrap=True)
    for name in results.controllers:
        table.add_column(heading(name, 16), justify="right")
    for row in outcomes(results):
        table.add_row(*row)
    table.add_section()
    for row in quantiles(results):
        table.add_row(*row)
    return table


def outcomes(results: Results) -> Iterator[list[str]]:
    """How many runs ended how, and how many were a success."""
    counts = {name: results.outcomes(name) for name in results.controllers}
    statuses = ["completed", *sorted({s for count in counts.values() for s in count} - {"completed"})]
    first = "runs"
    for status in statuses:
        yield [first, status, *(str(count[status]) for count in counts.values())]
        first = ""
    rates = (rate(int(s.sum()), len(s)) for s in map(results.succeeded, results.controllers))
    yield ["success [%]", "", *(told(interval, 100.0) for interval in rates)]


def quantiles(results: Results) -> Iterator[list[str]]:
    """Median and upper quantile of every metric."""
    for pattern in results.patterns:
        scale, unit = shown_unit(results.unit(pattern))
        first = f"{pattern} [{unit}]" if unit else pattern
        for words, q in QUANTILES.items():
            intervals = (quantile(results.metric(name, pattern), q) for name in results.controllers)
            yield [first.replace("[", r"\["), words, *(told(interval, scale) for interval in intervals)]
            first = ""


def shown_unit(unit: str) -> tuple[float, str]:
    """Factor and unit in which a metric is shown: thousandths of metres and radians."""
    return SHOWN.get(unit, (1.0, unit))


def told(interval: Interval, scale: float = 1.0) -> str:
    """An estimate with its interval in few digits; rich takes no bracket for markup."""
    value, low, high = (number(scale * part) for part in (interval.value, interval.low, interval.high))
    return f"{value} \\[{low}, {high}]"


def number(value: float) -> str:
    """Three significant digits."""
    if not math.isfinite(value):
        return "inf" if value > 0 else "-"
    if value == 0:
        return "0"
    if not 1e-3 <= abs(value) < 1e5:
        return f"{value:.1e}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def to_dict(results: Results) -> dict[str, Any]:
    """The summary for JSON; null stands for inf."""
    controllers = {
        name: {
            "runs": len(results.of[name]),
            "outcomes": dict(results.outcomes(name)),
            "success": rate(int(results.succeeded(name).sum()), len(results.of[name])).to_dict(),
            "metrics": {
                pattern: {
                    "unit": results.unit(pattern),
                    "median": quantile(results.metric(name, pattern), 0.5).to_dict(),
                    "q95": quantile(results.metric(name, pattern), 0.95).to_dict(),
                }
                for pattern in results.patterns
            },
        }
        for name in results.controllers
    }
    about = {"study": results.name, "database": str(results.path), "rows": results.planned, "done": len(results.rows)}
    return about | {"failed": len(results.failed), "controllers": controllers, "verdict": verdict(results).to_dict()}
