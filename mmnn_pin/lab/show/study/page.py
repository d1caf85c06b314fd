"""A study as one HTML page that opens anywhere: the answer, the table, the pictures, where it comes from."""

from __future__ import annotations

import json
from importlib import resources
from typing import TYPE_CHECKING, Any

from ...study.results import Results
from ...study.statistics import Interval, quantile, rate
from ...study.verdict import sentences, verdict
from ..figure import svg
from ..html_page import HtmlPage, filled
from ..report.page import source as source_of_report
from . import plots
from .table import CAPTION, QUANTILES, number, remarks, shown_unit, title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORST = 5  # runs of each controller that are named
SIGNIFICANT = 0.01


def page(results: Results, command: str = "") -> HtmlPage:
    """The page of a study.

    Args:
        results: Its rows.
        command: The command that makes this page, to be shown in it.
    """
    found = verdict(results)
    head, *points = sentences(results, found)
    text = filled(
        resources.files(__package__).joinpath("page.html").read_text("utf-8"),
        title=title(results),
        headline=head,
        points=points,
        remarks=remarks(results),
        controllers=results.controllers,
        rows=list(table_rows(results)),
        caption=CAPTION,
        success=success_words(results),
        pictures=pictures(results),
        decides=decides(results),
        worst=worst(results),
        factors=factor_rows(results),
        facts=facts(results),
        command=command,
        settings=json.dumps(results.meta["settings"], indent=2, ensure_ascii=False),
        style=source_of_report("page.css"),
    )
    return HtmlPage(text)


def table_rows(results: Results) -> Any:
    """Rows of the summary: two names, then a cell per controller."""
    counts = {name: results.outcomes(name) for name in results.controllers}
    for status in ["completed", *sorted({s for count in counts.values() for s in count} - {"completed"})]:
        yield "runs", status, [str(count[status]) for count in counts.values()]
    rates = [rate(int(s.sum()), len(s)) for s in map(results.succeeded, results.controllers)]
    yield "success [%]", "", [cell(interval, 100.0) for interval in rates]
    for pattern in results.patterns:
        scale, unit = shown_unit(results.unit(pattern))
        for words, q in QUANTILES.items():
            intervals = [quantile(results.metric(name, pattern), q) for name in results.controllers]
            yield f"{pattern} [{unit}]" if unit else pattern, words, [cell(interval, scale) for interval in intervals]


def cell(interval: Interval, scale: float) -> str:
    """An estimate with its interval."""
    return f"{number(scale * interval.value)} [{number(scale * interval.low)}, {number(scale * interval.high)}]"


def success_words(results: Results) -> str:
    """When a run is a success, in words."""
    bounds = []
    for pattern, bound in results.settings.success.at_most.items():
        scale, unit = shown_unit(results.unit(pattern))
        bounds.append(f"{pattern} is at most {number(scale * bound)} {unit}".rstrip())
    return "it completes" + (f" and {' and '.join(bounds)}" if bounds else "")


def pictures(results: Results) -> list[dict[str, str]]:
    """The pictures as SVG, each with a caption."""
    made: list[tuple[str, Figure]] = []
    if results.patterns:
        words = "A curve that ends below 1 has runs that did not complete; the dotted line is the bound of a success."
        made.append((words, plots.distributions(results)))
    if results.factors:
        words = "Bars are 95 % intervals. All other factors vary as they do in the study."
        made.append((words, plots.against_factors(results)))
        if len(results.factors) > 1:
            words = "Rate of successes in per cent, in bins of equally many runs."
            made.append((words, plots.success_maps(results)))
        words = (
            "First-order share of the variance of ranks; what a factor decides only together with others is not in it."
        )
        made.append((words, plots.sensitivity(results)))
    return [{"svg": svg(figure), "caption": caption} for caption, figure in made]


def decides(results: Results) -> list[dict[str, Any]]:
    """What decides the success of every controller: its factors with a share that chance does not explain."""
    table = plots.shares(results)["success"]
    found = []
    for controller, shares in table.items():
        strong = sorted((n for n, s in shares.items() if s.p < SIGNIFICANT), key=lambda n: -shares[n].share)
        parts = [f"{name} {100 * shares[name].share:.0f} %{way(shares[name].direction)}" for name in strong]
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
        numbers = [{"id": rows[i].id, "told": rows[i].message or rows[i].status} for i in order]
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
