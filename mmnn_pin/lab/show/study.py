"""A study in a table, in figures, on a page, and as numbers for JSON: which controller holds, how often, and why."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...signals import Array, IntArray
from ..study.results import Results
from ..study.verdict import Interval, Share, bins_of, levels_of, quantile, rate, sentences, share_of, verdict
from .figure import add_legend, axes_grid, figure, log_ticks, new_figure, pictures, plain, styles_of_controllers
from .files import HtmlPage, fill_template
from .table import Column, Line, Row, Table, grouped, number, row_of, terminal_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 110
NAME = 16  # letters of a controller's name on a line
WORST = 5  # runs of each controller that are named
SIGNIFICANT = 0.01
QUANTILES = {"median": 0.5, "95 %": 0.95}
SHOWN = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "m/s": (1e3, "mm/s"), "rad/s": (1e3, "mrad/s")}
MAP_BINS = 6
MOST_METRICS = 3  # metrics in the figures of distributions and of what decides
CAPTION = (
    "95 %: what 95 % of the runs stay below. [a, b]: 95 % confidence interval, of draws as if independent; inf: too "
    "few runs to bound it. A run that did not complete counts as worse than all others, as inf."
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
    of_all = f" of {results.planned}" if len(results.rows) < results.planned else ""
    return f"{name}: {len(results.rows)} runs{of_all}"


def remarks(results: Results) -> list[str]:
    """What a reader must know beside the numbers."""
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


def shown_unit(results: Results, pattern: str) -> tuple[float, str]:
    """Factor and unit in which a metric is shown: thousandths of metres and radians."""
    unit = results.unit(pattern)
    return SHOWN.get(unit, (1.0, unit))


def outcome_rows(results: Results) -> Iterator[Row]:
    """How many runs ended how, and how many were a success."""
    counts = {name: results.outcomes(name) for name in results.controllers}
    statuses = ["completed", *sorted({s for count in counts.values() for s in count} - {"completed"})]
    for status in statuses:
        first = "runs" if status == "completed" else ""
        yield row_of(first, status, *(str(count[status]) for count in counts.values()))
    rates = (rate(int(s.sum()), len(s)) for s in map(results.succeeded, results.controllers))
    yield row_of("success [%]", "", *(interval_text(interval, 100.0) for interval in rates))


def quantile_rows(results: Results) -> Iterator[Row]:
    """Median and upper quantile of every metric."""
    for pattern in results.patterns:
        scale, unit = shown_unit(results, pattern)
        for words, q in QUANTILES.items():
            first = titled(pattern, unit) if words == "median" else ""
            intervals = (quantile(results.metric(name, pattern), q) for name in results.controllers)
            yield row_of(first, words, *(interval_text(interval, scale) for interval in intervals))


def titled(name: str, unit: str) -> str:
    """A factor or a metric with its unit."""
    return f"{name} [{unit}]" if unit else name


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
    head, *points = sentences(results, verdict(results))
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
        pictures=pictures("study", results),
        decides=decides(results),
        worst=worst(results),
        factors=factor_rows(results),
        facts=facts(results),
        command=command,
        settings=json.dumps(results.meta["settings"], indent=2, ensure_ascii=False),
    )
    return HtmlPage(text)


def decides(results: Results) -> list[tuple[str, str]]:
    """What decides the success of every controller: its factors with a share that chance does not explain."""
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


# -- the figures -------------------------------------------------------------------------------------------------------


def legend(picture: Figure, results: Results, title: str) -> None:
    """The title and the controllers' looks."""
    styles = styles_of_controllers(results.controllers)
    add_legend(picture, plain(title), [(plain(name), style.line) for name, style in styles.items()])


@figure(
    "study-distributions",
    of="study",
    needs=lambda results: "" if results.patterns else "the study records no metrics",
    caption="A curve that ends below 1 has runs that did not complete; the dotted line is the bound of a success.",
)
def distributions(results: Results) -> Figure:
    """Share of runs with at most so much of a metric; a curve that ends below 1 has runs that did not complete."""
    chosen = results.patterns[:MOST_METRICS]
    picture, every = axes_grid(len(chosen), 3, 3.5, 2.7, 0.7)
    for axes, pattern in zip(every, chosen, strict=True):
        scale, unit = shown_unit(results, pattern)
        for name, style in styles_of_controllers(results.controllers).items():
            values = np.sort(results.metric(name, pattern) * scale)
            shares, finite = np.arange(1, len(values) + 1) / len(values), np.isfinite(values)
            if finite.any():
                axes.step(values[finite], shares[finite], where="post", **style.line)
        if bound := results.settings.success.at_most.get(pattern):
            axes.axvline(bound * scale, color="0.5", linewidth=1.0, linestyle=(0, (2, 2)))
        log_axis(axes)
        axes.set(ylim=(0, 1.02), xlabel=plain(titled(pattern, unit)))
    every[0].set_ylabel("share of runs")
    legend(picture, results, "Share of runs with at most this error")
    return picture


@figure(
    "study-factors",
    of="study",
    needs=lambda results: "" if results.factors else "the study varies nothing",
    caption="Bars are 95 % intervals. All other factors vary as they do in the study.",
)
def against_factors(results: Results) -> Figure:
    """Rate of successes in bins of every factor, with 95 % intervals; the other factors vary as they do."""
    picture, every = axes_grid(len(results.factors), 3, 3.5, 2.7, 0.7)
    for axes, name in zip(every, results.factors, strict=False):
        draw_rates(axes, results, name)
    legend(picture, results, "Successes against each factor")
    return picture


def draw_rates(axes: Axes, results: Results, name: str) -> None:
    """Rates of successes of all controllers against one factor."""
    factor = results.factors[name]
    labels: list[str] = []
    for i, (controller, style) in enumerate(styles_of_controllers(results.controllers).items()):
        values = results.values(controller, name)
        groups, success = bins_of(values, factor.numeric), results.succeeded(controller)
        x, labels = centres(values, groups, factor.numeric)
        found = [rate(int(success[groups == g].sum()), int((groups == g).sum())) for g in range(len(x))]
        y = np.array([interval.value for interval in found])
        bars = np.array([[r.value - r.low for r in found], [r.high - r.value for r in found]])
        x = x if not labels else x + 0.06 * (i - 1)
        axes.errorbar(x, y, yerr=bars, elinewidth=0.8, capsize=1.5, marker="o", markersize=3, **style.line)
    if labels:
        axes.set_xticks(range(len(labels)), [plain(label) for label in labels])
    elif factor.on_log_scale:
        log_axis(axes)
    axes.set(ylim=(-0.03, 1.03), xlabel=plain(titled(name, factor.unit)), ylabel="success rate")


def log_axis(axes: Axes) -> None:
    """A logarithmic axis across, labelled at 1, 2 and 5 of every decade at most."""
    axes.set_xscale("log")
    log_ticks(axes.xaxis, (1.0, 2.0, 5.0))


def centres(values: Sequence[Any], groups: IntArray, numeric: bool) -> tuple[Array, list[str]]:
    """Where the bins of a factor stand on an axis, and their labels where they are levels without an order."""
    if not numeric:
        levels = [str(level) for level in levels_of(values, False)]
        return np.arange(len(levels), dtype=float), levels
    given = np.asarray(values, float)
    return np.array([np.median(given[groups == g]) for g in range(int(groups.max()) + 1)]), []


def shares(results: Results, result: str) -> dict[str, dict[str, Share]]:
    """What each factor decides of a result, "success" or a metric: controller to factor to its share."""
    found = {}
    for controller in results.controllers:
        values = ~results.succeeded(controller) if result == "success" else results.metric(controller, result)
        found[controller] = {
            name: share_of(results.values(controller, name), values.astype(float), factor.numeric)
            for name, factor in results.factors.items()
        }
    return found


@figure(
    "study-maps",
    of="study",
    needs=lambda results: "" if len(results.factors) > 1 else "the study varies less than two factors",
    caption="Rate of successes in per cent, in bins of equally many runs.",
)
def success_maps(results: Results) -> Figure:
    """Rate of successes over the two factors that decide most of it, one map per controller."""
    table, count = shares(results, "success"), len(results.controllers)
    order = sorted(results.factors, key=lambda name: -sum(of[name].share for of in table.values()))
    picture = new_figure(2.9 * count + 0.9, 3.5)
    every = picture.subplots(1, count, squeeze=False)[0]
    for axes, controller in zip(every, results.controllers, strict=True):
        image = draw_map(axes, results, controller, order[0], order[1])
        axes.set_title(plain(controller))
    picture.colorbar(image, ax=list(every), label="success rate", shrink=0.8)
    picture.suptitle("Successes over the two factors that decide most", x=0.01, ha="left", fontweight="bold")
    return picture


@figure(
    "study-sensitivity",
    of="study",
    needs=lambda results: "" if results.factors else "the study varies nothing",
    caption="First-order share of the variance of ranks; what a factor decides only together with others is not in it.",
)
def sensitivity(results: Results) -> Figure:
    """How much of the success and of the metrics each factor decides alone, for every controller."""
    chosen = ["success", *results.patterns[:2]]
    names = list(results.factors)
    picture = new_figure(3.4 * len(chosen) + 1.2, 0.9 + 0.2 * max(1, len(names)) * (1 + len(results.controllers)) / 1.6)
    every = picture.subplots(1, len(chosen), sharey=True, squeeze=False)[0]
    looks = styles_of_controllers(results.controllers)
    height = 0.8 / len(looks)
    for axes, result in zip(every, chosen, strict=True):
        table = shares(results, result)
        for i, (controller, style) in enumerate(looks.items()):
            y = np.arange(len(names)) + (i - (len(looks) - 1) / 2) * height
            axes.barh(y, [table[controller][name].share for name in names], height, color=style.color)
        axes.set(xlim=(0, 1), xlabel=plain(f"share of the variance of {result}"))
        axes.set_yticks(range(len(names)), [plain(name) for name in names])
    every[0].invert_yaxis()
    bars = [(plain(name), {"color": style.color, "linewidth": 6}) for name, style in looks.items()]
    add_legend(picture, "What each factor decides alone", bars)
    return picture


def draw_map(axes: Axes, results: Results, controller: str, across: str, up: str) -> Any:
    """One map; cells without runs stay empty, the number of runs stands in each."""
    success = results.succeeded(controller)
    sides = []
    for name in (across, up):
        values, numeric = results.values(controller, name), results.factors[name].numeric
        groups = bins_of(values, numeric, MAP_BINS)
        sides.append((groups, edge_labels(values, groups, numeric)))
    (i, x_labels), (j, y_labels) = sides
    rates = np.full((len(y_labels), len(x_labels)), np.nan)
    for row, column in np.ndindex(rates.shape):
        inside = (i == column) & (j == row)
        rates[row, column] = success[inside].mean() if inside.any() else np.nan
    image = axes.imshow(rates, origin="lower", vmin=0, vmax=1, cmap="viridis", aspect="auto")
    for row, column in np.argwhere(np.isfinite(rates)):
        colour = "black" if rates[row, column] > 0.6 else "white"
        axes.text(column, row, f"{100 * rates[row, column]:.0f}", ha="center", va="center", fontsize=7, color=colour)
    axes.set_xticks(range(len(x_labels)), x_labels, rotation=45, ha="right", fontsize=7)
    axes.set_yticks(range(len(y_labels)), y_labels, fontsize=7)
    x, y = (plain(titled(name, results.factors[name].unit)) for name in (across, up))
    axes.set(xlabel=x, ylabel=y)
    axes.grid(visible=False)
    return image


def edge_labels(values: Sequence[Any], groups: IntArray, numeric: bool) -> list[str]:
    """Labels of bins: a level, or from where to where."""
    if not numeric:
        return [plain(str(level)) for level in levels_of(values, False)]
    given = np.asarray(values, float)
    ends = [(given[groups == g].min(), given[groups == g].max()) for g in range(int(groups.max()) + 1)]
    return [f"{low:.3g}" if low == high else f"{low:.2g} to {high:.2g}" for low, high in ends]
