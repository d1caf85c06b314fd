"""The figures of a study: distributions, what decides, and which value of a gain is best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...signals import Array, IntArray
from ..study.choice import gains_of, levels
from ..study.factors import is_number
from ..study.intervals import rate
from ..study.results import Results
from ..study.verdict import MAP_BINS, Share, bins_of, levels_of, share_of
from .figure import Look, add_legend, axes_grid, figure, log_ticks, new_figure, plain, styles_of_controllers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = {"rad": "mrad", "m": "mm", "m/s": "mm/s", "rad/s": "mrad/s"}  # in thousandths
SHORT: Look = {"marker": "o", "markersize": 8, "fillstyle": "none", "linestyle": "none", "zorder": 5}
DECADE = 8.0  # spread from which an axis is logarithmic
TICKS = 8  # values of a factor that all stand on its axis, at most
SHORTEST = 6  # letters that each of these may have
FINE = 0.01  # a logarithmic axis from less than this has long numbers
MOST_METRICS = 3  # metrics in the figures of distributions and of what decides


def shown_unit(results: Results, pattern: str) -> tuple[float, str]:
    """Factor and unit in which a metric is shown: thousandths of metres and radians."""
    units = results.unit(pattern).split(" or ")
    if all(unit in SHOWN for unit in units):
        return 1e3, " or ".join(SHOWN[unit] for unit in units)
    return 1.0, " or ".join(units)


def titled(name: str, unit: str) -> str:
    """A factor or a metric with its unit."""
    return f"{name} [{unit}]" if unit else name


def legend(picture: Figure, results: Results, title: str, more: Sequence[tuple[str, Look]] = ()) -> None:
    """The title and the controllers' looks, and others."""
    styles = styles_of_controllers(results.controllers)
    add_legend(picture, plain(title), [*((plain(name), style.line) for name, style in styles.items()), *more])


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
        draws = results.draws(controller)
        found = [rate(success[groups == g], draws[groups == g]) for g in range(len(x))]
        y = np.array([interval.value for interval in found])
        bars = np.array([[r.value - r.low for r in found], [r.high - r.value for r in found]])
        x = x if not labels else x + 0.06 * (i - 1)
        axes.errorbar(x, y, yerr=bars, elinewidth=0.8, capsize=1.5, marker="o", markersize=3, **style.line)
    if labels:
        axes.set_xticks(range(len(labels)), [plain(label) for label in labels])
    elif factor.on_log_scale:
        log_axis(axes)
    else:
        axes.locator_params(axis="x", nbins=5)
    axes.set(ylim=(-0.03, 1.03), xlabel=plain(titled(name, factor.unit)), ylabel="success rate")


def log_axis(axes: Axes) -> None:
    """A logarithmic axis across, labelled at 1, 2 and 5 of every decade where that has room, else at powers of ten."""
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    log_ticks(axes.xaxis, (1.0, 2.0, 5.0) if high <= (100 if low >= FINE else 10) * low else (1.0,))


def centres(values: Sequence[Any], groups: IntArray, numeric: bool) -> tuple[Array, list[str]]:
    """Places of the bins of a factor on an axis, and their labels where they are levels without an order."""
    if not numeric:
        levels = [str(level) for level in levels_of(values, False)]
        return np.arange(len(levels), dtype=float), levels
    given = np.asarray(values, float)
    return np.array([np.median(given[groups == g]) for g in range(int(groups.max()) + 1)]), []


def shares(results: Results, result: str) -> dict[str, dict[str, Share]]:
    """Share of each factor in a result, "success" or a metric: controller to factor to its share."""
    found = {}
    for controller in results.controllers:
        values = ~results.succeeded(controller) if result == "success" else results.metric(controller, result)
        found[controller] = {
            name: share_of(
                results.values(controller, name), values.astype(float), factor.numeric, results.groups(controller, name)
            )
            for name, factor in results.factors.items()
        }
    return found


@figure(
    "study-errors",
    of="study",
    needs=lambda results: "" if results.patterns and numeric_of(results) else "the study varies no number",
    caption="Median with its 95 % interval, which is open upwards where too many runs did not complete; fewer than six"
    " runs at a value have none. A cross at the top: fewer than half of the runs completed.",
)
def errors_against_factors(results: Results) -> Figure:
    """Median of every metric against every number that is varied, with 95 % intervals: a row per number."""
    chosen, names = results.patterns[:MOST_METRICS], numeric_of(results)
    picture = new_figure(3.6 * max(len(chosen), 1.5), 2.5 * len(names) + 0.9)
    grid: Any = picture.subplots(len(names), len(chosen), squeeze=False)
    short = False
    for row, name in zip(grid, names, strict=True):
        for axes, pattern in zip(row, chosen, strict=True):
            short |= draw_errors(axes, results, name, pattern)
            axes.set_xlabel(plain(titled(name, results.factors[name].unit)))
    for axes, pattern in zip(grid[0], chosen, strict=True):
        axes.set_title(plain(titled(pattern, shown_unit(results, pattern)[1])))
    title = f"Errors against {names[0] if len(names) == 1 else 'each factor'}"
    legend(picture, results, title, [("delay margin too small", {"color": "0.3", **SHORT})] * short)
    return picture


def numeric_of(results: Results) -> list[str]:
    """Factors whose values are numbers, two of them at least; gains before what is met with."""
    first = gains_of(results)
    rest = [name for name in results.factors if name not in first]
    return [name for name in (*first, *rest) if len(orderly(results, name)) > 1]


def orderly(results: Results, name: str) -> set[float]:
    """The values of a factor, nothing where they are no numbers."""
    values = [value for controller in results.controllers for value in results.values(controller, name)]
    return set(values) if all(is_number(value) for value in values) else set()


def draw_errors(axes: Axes, results: Results, name: str, pattern: str) -> bool:
    """The median of a metric of all controllers against one factor, with intervals.

    Returns:
        Whether a value has less delay margin than is asked for; it is marked.
    """
    scale, _ = shown_unit(results, pattern)
    values = orderly(results, name)
    tops, unbounded, short = [], [], []
    for controller, style in styles_of_controllers(results.controllers).items():
        every = levels(results, controller, name)
        found = [(level.value, level.medians[pattern]) for level in every]
        short += [(x, scale * m.value, style.color) for (x, m), level in zip(found, every, strict=True) if level.short]
        seen = [(x, scale * m.value, scale * m.low, scale * m.high) for x, m in found if np.isfinite(m.value)]
        if seen:
            x, y, low, high = (np.array(column, float) for column in zip(*seen, strict=True))
            bars = np.array([np.where(np.isfinite(low), y - low, 0.0), np.where(np.isfinite(high), high - y, 0.0)])
            axes.errorbar(x, y, yerr=bars, elinewidth=0.8, capsize=1.5, marker="o", markersize=3, **style.line)
            unbounded += [(x[i], y[i], style.color) for i in np.flatnonzero(~np.isfinite(high) & np.isfinite(low))]
        tops += [(x, style.color) for x, m in found if not np.isfinite(m.value)]
    if min(values) > 0 and max(values) / min(values) >= DECADE:
        log_axis(axes)
    else:
        axes.locator_params(axis="x", nbins=5)
    labels = [f"{value:g}" for value in sorted(values)]
    if len(values) <= TICKS and all(len(label) <= SHORTEST for label in labels):  # chosen, not drawn at random
        axes.set_xticks(sorted(values), labels)
        axes.set_xticks([], minor=True)
    axes.set_ylim(0, 1.04 * axes.get_ylim()[1])  # a mark at the top has room
    for x, y, color in unbounded:
        axes.vlines(x, y, axes.get_ylim()[1], color=color, linewidth=0.8)
    for place, error, color in short:
        if np.isfinite(error):
            axes.plot(place, error, color=color, **SHORT)
    for i, (x, color) in enumerate(tops):
        above = sum(x == other for other, _ in tops[:i])  # crosses of other controllers at this value
        place = axes.get_xaxis_transform()
        axes.plot(x, 0.97 - 0.06 * above, "X", transform=place, color=color, mec="white", ms=7, zorder=5)
    return bool(short)


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
    """Shares of the success and of the metrics that each factor decides alone, for every controller."""
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
