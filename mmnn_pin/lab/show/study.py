"""A study in a table, on a page, and as numbers for JSON: which controller holds, how often, and why."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

from ..study.choice import Level, advice, best_of, gains_of, levels
from ..study.intervals import Interval, quantile, rate
from ..study.results import Results
from ..study.verdict import sentences, verdict
from .figure import pictures
from .files import HtmlPage, fill_template
from .study_figures import shares, shown_unit, titled
from .table import Cell, Column, Row, Table, TextLine, grouped, number, row_of, terminal_text

WIDTH = 110
FIRST = {True: "study-errors", False: "study-factors"}  # what a page shows at once: with gains, their errors
NAME = 16  # letters of a controller's name on a line
WORST = 5  # runs of each controller that are named
SIGNIFICANT = 0.01
QUANTILES = {"median": 0.5, "95 %": 0.95}
CAPTION = (
    "95 %: what 95 % of the runs stay below. [a, b]: 95 % confidence interval, of draws as if independent; runs that "
    "share a draw are not. A run that did not complete counts as worse than all others. A dash: not enough runs "
    "completed, or too few to bound it."
)


def render(results: Results, colour: bool = False, width: int = WIDTH) -> str:
    """Verdict, table and caption, as text of at most `width` columns."""
    table = summary(results)
    notes = (f"note: {line}" for line in remarks(results))
    head: list[str | TextLine | Table] = [TextLine(title(results), "bold"), *answer(results)]
    return terminal_text([*head, table, TextLine(table.caption, "italic"), *notes], colour, width)


def levels_text(results: Results, factor: str, width: int = WIDTH) -> str:
    """Results of the controllers at every value of a factor, and which value to take, as text."""
    every = {controller: levels(results, controller, factor) for controller in results.controllers}
    known = any(math.isfinite(level.margin) for found in every.values() for level in found)
    heads = [Column("success", "%"), *[Column("delay margin", "ms")] * known]
    heads += [Column(p, shown_unit(results, p)[1]) for p in results.patterns]
    tables: list[str | TextLine | Table] = []
    for controller, found in every.items():
        best = best_of(found)
        rows = (
            row_of(
                Cell(level.words, "best" if level is best else "", "*" if level is best else ""),
                *level_cells(results, level, known),
            )
            for level in found
        )
        tables += [TextLine(controller, "bold"), Table(controller, (Column(factor, text=True), *heads), tuple(rows))]
    notes = [advice(results, controller, factor) for controller in results.controllers]
    about = "Medians with 95 % intervals. A dash: too few runs completed, or too few runs to bound it."
    about += " Delay margin: the least of the runs; !: below the one asked for (latency.margin)." if known else ""
    return terminal_text([*tables, TextLine(about, "italic"), *notes], width=width)


def level_cells(results: Results, level: Level, margins: bool) -> Iterator[str | Cell]:
    """Cells of a level: share of runs that completed, their least delay margin, and the median of every metric."""
    yield number(100 * level.success.value)
    if margins:
        yield Cell(number(1e3 * level.margin), "bad" if level.short else "", "!" if level.short else "")
    for pattern, median in level.medians.items():
        yield interval_text(median, shown_unit(results, pattern)[0])


def title(results: Results) -> str:
    """Name of the study, and how much of it is done."""
    name = results.settings.title or results.name
    of_all = f" of {results.planned}" if len(results.rows) < results.planned else ""
    return f"{name}: {len(results.rows)} runs{of_all}"


def answer(results: Results) -> list[str]:
    """The answer of the study in sentences: which controller, which gains, within which uncertainty."""
    found = verdict(results)
    gains = [advice(results, found.controller, gain) for gain in gains_of(results) if found.controller is not None]
    return [*sentences(results, found), *gains]


def remarks(results: Results) -> list[str]:
    """Remarks on missing, failed and refused runs."""
    missing, refused = results.planned - len(results.rows), [r for r in results.rows if r.status == "refused"]
    return [
        *[f"{missing} runs are missing; the same command makes them"] * (missing > 0),
        *(f"row {row.id} failed and is run again next time: {row.message}" for row in results.failed[:3]),
        *(f"row {row.id} could not be run: {row.message}" for row in refused[:3]),
        *[f"{len(refused) - 3} more rows could not be run"] * (len(refused) > 3),
    ]


def summary(results: Results) -> Table:
    """Rows: outcomes, successes, quantiles of every metric. Columns: controllers."""
    heads = (Column(text=True, fold=True), Column(text=True))
    controllers = (Column(name, fold=True, letters=NAME) for name in results.controllers)
    return Table(
        "Numbers", (*heads, *controllers), grouped(outcome_rows(results), quantile_rows(results)), (CAPTION,), 0
    )


def outcome_rows(results: Results) -> Iterator[Row]:
    """Rows of outcomes: how many runs ended how, and how many were a success."""
    counts = {name: results.outcomes(name) for name in results.controllers}
    statuses = ["completed", *sorted({s for count in counts.values() for s in count} - {"completed"})]
    for status in statuses:
        first = "runs" if status == "completed" else ""
        yield row_of(first, status, *(str(count[status]) for count in counts.values()))
    rates = (rate(results.succeeded(name), results.draws(name)) for name in results.controllers)
    yield row_of("success [%]", "", *(interval_text(interval, 100.0) for interval in rates))


def quantile_rows(results: Results) -> Iterator[Row]:
    """Median and upper quantile of every metric."""
    for pattern in results.patterns:
        scale, unit = shown_unit(results, pattern)
        for words, q in QUANTILES.items():
            first = titled(pattern, unit) if words == "median" else ""
            every = ((results.metric(name, pattern), results.draws(name)) for name in results.controllers)
            intervals = (quantile(values, q, draws) for values, draws in every)
            yield row_of(first, words, *(interval_text(interval, scale) for interval in intervals))


def interval_text(interval: Interval, scale: float = 1.0) -> str:
    """An estimate with its interval in few digits."""
    value, low, high = (number(scale * part) for part in (interval.value, interval.low, interval.high))
    return f"{value} [{low}, {high}]"


def to_dict(results: Results) -> dict[str, Any]:
    """The summary for JSON; null stands for inf."""
    controllers = {
        name: {
            "runs": len(results.of[name]),
            "outcomes": dict(results.outcomes(name)),
            "success": rate(results.succeeded(name), results.draws(name)).to_dict(),
            "metrics": {
                pattern: {"unit": results.unit(pattern)}
                | {
                    key: quantile(results.metric(name, pattern), q, results.draws(name)).to_dict()
                    for key, q in (("median", 0.5), ("q95", 0.95))
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
    head, *points = answer(results)
    drawn, first = pictures("study", results), ("study-distributions", FIRST[bool(gains_of(results))])
    bounds = []
    for pattern, bound in results.settings.success.at_most.items():
        scale, unit = shown_unit(results, pattern)
        bounds.append(f"{pattern} is at most {number(scale * bound)} {unit}".rstrip())
    text = fill_template(
        "study.html",
        title=title(results),
        headline=head,
        points=points,
        notes=remarks(results),
        table=summary(results),
        success=" and ".join(["it completes", *bounds]),
        pictures=[picture for picture in drawn if picture["name"] in first],
        more=[picture for picture in drawn if picture["name"] not in first],
        decides=decides(results),
        worst=worst(results),
        factors=factor_rows(results),
        facts=facts(results),
        command=command,
        settings=json.dumps(results.meta["settings"], indent=2, ensure_ascii=False),
    )
    return HtmlPage(text)


def decides(results: Results) -> list[tuple[str, str]]:
    """The factors that decide the success of every controller: those with a share that chance does not explain."""
    found = []
    for controller, of in shares(results, "success").items():
        strong = sorted((n for n, s in of.items() if s.p < SIGNIFICANT), key=lambda n: -of[n].share)
        parts = [f"{name} {100 * of[name].share:.0f} %{way(of[name].direction)}" for name in strong]
        found.append((controller, ", ".join(parts) or "no factor alone"))
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
        metric = results.metric(controller, results.patterns[0]) if results.patterns else [row.time for row in rows]
        order = sorted(range(len(rows)), key=lambda i: (rows[i].completed, rows[i].time, -float(metric[i])))[:WORST]
        numbers = [{"id": rows[i].id, "end": rows[i].message or rows[i].status} for i in order]
        found.append({"controller": controller, "rows": numbers})
    return found


def factor_rows(results: Results) -> list[tuple[str, str, str]]:
    """Every factor: name, distribution, what it changes."""
    rows = []
    for name, factor in results.settings.factors.items():
        shown = f"{factor.kind.replace('_', '-')} {list(getattr(factor, factor.kind))} {factor.unit}".rstrip()
        keys = ", ".join(factor.paths(name)) + ", times what the experiment has" * factor.relative
        rows.append((name, shown, keys))
    return rows


def facts(results: Results) -> list[tuple[str, str]]:
    """The origin of the rows: files, machines, versions."""
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
