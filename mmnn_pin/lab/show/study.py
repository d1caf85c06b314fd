"""A study in a table, on a page, and as numbers for JSON: which controller holds, how often, and what decides."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from ..study.results import Results
from ..study.statistics import Interval, quantile, rate
from ..study.verdict import sentences, verdict
from .figure import FIGURES, svg
from .files import HtmlPage, fill_template
from .study_figures import shares, shown_unit
from .table import Column, Line, Row, Table, grouped, number, row_of, terminal_text

WIDTH = 110
NAME = 16  # letters of a controller's name on a line
WORST = 5  # runs of each controller that are named
SIGNIFICANT = 0.01
QUANTILES = {"median": 0.5, "95 %": 0.95}
CAPTION = (
    "95 %: what 95 % of the runs stay below. [a, b]: 95 % confidence interval, of draws as if independent. A run that "
    "did not complete counts as worse than all others; inf: so many did not complete."
)


def render(results: Results, colour: bool = False, width: int = WIDTH) -> str:
    """Verdict, table and caption, as text of at most `width` columns."""
    table = summary(results)
    notes = (f"note: {line}" for line in remarks(results))
    head: list[str | Line | Table] = [Line(title(results), "bold"), *sentences(results, verdict(results))]
    return terminal_text([*head, table, Line(table.caption, "italic"), *notes], colour, width)


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
    heads = (Column(text=True, fold=True), Column(text=True))
    controllers = (Column(name, fold=True, letters=NAME) for name in results.controllers)
    return Table(
        "Numbers", (*heads, *controllers), grouped(outcome_rows(results), quantile_rows(results)), (CAPTION,), 0
    )


def outcome_rows(results: Results) -> Iterator[Row]:
    """How many runs ended how, and how many were a success."""
    counts = {name: results.outcomes(name) for name in results.controllers}
    statuses = ["completed", *sorted({s for count in counts.values() for s in count} - {"completed"})]
    first = "runs"
    for status in statuses:
        yield row_of(first, status, *(str(count[status]) for count in counts.values()))
        first = ""
    rates = (rate(int(s.sum()), len(s)) for s in map(results.succeeded, results.controllers))
    yield row_of("success [%]", "", *(interval_text(interval, 100.0) for interval in rates))


def quantile_rows(results: Results) -> Iterator[Row]:
    """Median and upper quantile of every metric."""
    for pattern in results.patterns:
        scale, unit = shown_unit(results.unit(pattern))
        first = f"{pattern} [{unit}]" if unit else pattern
        for words, q in QUANTILES.items():
            intervals = (quantile(results.metric(name, pattern), q) for name in results.controllers)
            yield row_of(first, words, *(interval_text(interval, scale) for interval in intervals))
            first = ""


def interval_text(interval: Interval, scale: float = 1.0) -> str:
    """An estimate with its interval in few digits."""
    value, low, high = (number(scale * part, "inf") for part in (interval.value, interval.low, interval.high))
    return f"{value} [{low}, {high}]"


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


def page(results: Results, command: str = "") -> HtmlPage:
    """The page of a study.

    Args:
        results: Its rows.
        command: The command that makes this page, to be shown in it.
    """
    found = verdict(results)
    head, *points = sentences(results, found)
    text = fill_template(
        "study.html",
        title=title(results),
        headline=head,
        points=points,
        remarks=remarks(results),
        table=summary(results),
        success=success_words(results),
        pictures=pictures(results),
        decides=decides(results),
        worst=worst(results),
        factors=factor_rows(results),
        facts=facts(results),
        command=command,
        settings=json.dumps(results.meta["settings"], indent=2, ensure_ascii=False),
    )
    return HtmlPage(text)


def success_words(results: Results) -> str:
    """When a run is a success, in words."""
    bounds = []
    for pattern, bound in results.settings.success.at_most.items():
        scale, unit = shown_unit(results.unit(pattern))
        bounds.append(f"{pattern} is at most {number(scale * bound)} {unit}".rstrip())
    return "it completes" + (f" and {' and '.join(bounds)}" if bounds else "")


def pictures(results: Results) -> list[dict[str, str]]:
    """The pictures that the study has something for, as SVG, each with a caption."""
    entries = (entry for entry in FIGURES["study"].values() if not entry.lacks(results))
    return [{"svg": svg(entry.make(results)), "caption": entry.caption} for entry in entries]


def decides(results: Results) -> list[dict[str, Any]]:
    """What decides the success of every controller: its factors with a share that chance does not explain."""
    table = shares(results)["success"]
    found = []
    for controller, of in table.items():
        strong = sorted((n for n, s in of.items() if s.p < SIGNIFICANT), key=lambda n: -of[n].share)
        parts = [f"{name} {100 * of[name].share:.0f} %{way(of[name].direction)}" for name in strong]
        found.append({"controller": controller, "text": ", ".join(parts) or "no factor alone"})
    return found


def way(direction: float) -> str:
    """In which direction a factor makes success rarer."""
    if not abs(direction) > 0.1:
        return ""
    return " (worse as it grows)" if direction > 0 else " (better as it grows)"


def worst(results: Results) -> list[dict[str, Any]]:
    """The worst runs of every controller, to be replayed: those that ended early, earliest first, then by metric."""
    found = []
    for controller in results.controllers:
        rows = results.of[controller]
        pattern = results.patterns[0] if results.patterns else ""
        metric = results.metric(controller, pattern) if pattern else [row.time for row in rows]
        order = sorted(range(len(rows)), key=lambda i: (rows[i].completed, rows[i].time, -float(metric[i])))[:WORST]
        numbers = [{"id": rows[i].id, "end": rows[i].message or rows[i].status} for i in order]
        found.append({"controller": controller, "rows": numbers})
    return found


def factor_rows(results: Results) -> list[tuple[str, str, str]]:
    """Every factor: name, distribution, what it changes."""
    rows = []
    for name, factor in results.settings.factors.items():
        values = getattr(factor, factor.kind)
        shown = f"{factor.kind.replace('_', '-')} {list(values)}{f' {factor.unit}' if factor.unit else ''}"
        keys = ", ".join(factor.keys or (name,)) + (", times what the experiment has" if factor.relative else "")
        rows.append((name, shown, keys))
    return rows


def facts(results: Results) -> list[tuple[str, str]]:
    """Where the rows come from."""
    meta, hosts = results.meta, sorted({row.host for row in results.rows})
    versions = ", ".join(f"{name} {version}" for name, version in meta["versions"].items())
    sampling = results.settings.sampling
    drawn = f"{sampling.points} points, {sampling.method}, seed {sampling.seed}" if sampling.points else "none"
    seconds = sum(row.seconds for row in results.rows)
    finished = max((row.finished for row in results.rows), default="")
    return [
        ("study", str(meta["file"])),
        ("experiment", results.settings.experiment),
        ("controllers are made for", f"the {results.settings.model} robot"),
        ("draws", drawn),
        ("database", str(results.path)),
        ("machines", ", ".join(hosts)),
        ("time of all runs", f"{seconds:.0f} s, the last one done at {finished}"),
        ("versions", versions),
    ]
