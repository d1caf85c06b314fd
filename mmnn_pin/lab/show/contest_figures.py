"""Figures of a contest: errors, what is known against what is followed, learning curves, held-out trajectories."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...signals import Array
from ..contest.standing import BASELINE, Standing
from ..contest.trial import Number, Tracking, TrialResult, arm_of, base_of, nan
from ..experiments.controllers import ORACLES
from .figure import FIGURES, Look, Style, axes_grid, figure, log_ticks, new_figure, plain, save, styles_of_controllers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

ERRORS: Mapping[str, Callable[[TrialResult], float]] = {
    "base [mm]": lambda row: 1e3 * base_of(row.rms),
    "heading [mrad]": lambda row: 1e3 * nan(row.rms.get("phi")),
    "arm [mrad]": lambda row: 1e3 * arm_of(row.rms),
}
HELD_OUT: Mapping[str, Callable[[TrialResult, str], float]] = {
    "base, held out [mm]": lambda row, how: 1e3 * over_all(row, how, base_of),
    "arm, held out [mrad]": lambda row, how: 1e3 * over_all(row, how, arm_of),
}
MARKERS = "os^DvPX<>*hd"
POINTS = 25  # of a learning curve, at most: more of them are a thicket of lines


def write_figures(standing: Standing, folder: Path) -> dict[str, Path]:
    """Write all figures, if there are rows for them, as PNG; name to file.

    Raises:
        RecordingError: A file that cannot be written.
    """
    if finished(standing):
        return {}
    return {name: save(entry.make(standing), folder / f"{name}.png") for name, entry in FIGURES["contest"].items()}


def finished(standing: Standing) -> str:
    """Why there is nothing to draw: no run reached its end."""
    return "" if any(row.completed for row in standing.results) else "no run reached its end"


def tasks_run(standing: Standing) -> list[str]:
    """Tasks with rows."""
    return [task for task in standing.tasks if any(standing.of(task, name) for name in standing.controllers)]


def over_all(row: TrialResult, how: str, of_axes: Callable[[dict[str, Number]], float]) -> float:
    """Root of the mean square error over all held-out trajectories; inf where one was lost, nan where none was run."""
    tracked: list[Tracking] = [ways[how] for ways in row.held_out.values() if how in ways]
    if not tracked:
        return math.nan
    if any(one.outcome != "completed" for one in tracked):
        return math.inf
    return math.sqrt(sum(of_axes(one.rms) ** 2 for one in tracked) / len(tracked))


@figure(
    "contest-errors",
    of="contest",
    needs=finished,
    caption="RMS errors in the last window of the training: a dot per seed, a bar at the median.",
)
def errors(standing: Standing) -> Figure:
    """RMS errors of the training's last window: a dot per seed, a bar at the median, a row of axes per task."""
    return dots(standing, "Contest: RMS error in the last window, every seed", [(k, v, {}) for k, v in ERRORS.items()])


def dots(standing: Standing, title: str, columns: Sequence[tuple[str, Callable[..., float], dict[str, str]]]) -> Figure:
    """A row of axes per task, a column per quantity, a line per controller, all seeds."""
    tasks, names, style = tasks_run(standing), standing.controllers, styles_of_controllers(standing.controllers)
    height = 0.7 + len(tasks) * (0.55 + 0.19 * len(names))
    picture = new_figure(3.1 * len(columns) + 1.2, height)
    grid: Any = picture.subplots(len(tasks), len(columns), squeeze=False)
    for i, task in enumerate(tasks):
        for j, (label, of, options) in enumerate(columns):
            axes: Axes = grid[i, j]
            for k, name in enumerate(names):
                values = [of(row, **options) for row in standing.of(task, name) if row.completed]
                line(axes, -k, [value for value in values if math.isfinite(value) and value > 0], style[name])
            if axes.lines:
                axes.set_xscale("log")
                number_axis(axes.xaxis)
            else:
                axes.set_xticks([])
                axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", va="center", color="0.5")
            axes.set_yticks([-k for k in range(len(names))], [plain(name) for name in names] if j == 0 else [])
            axes.set_ylim(0.6 - len(names), 0.6)
            axes.set_title(f"{task}: " * (j == 0) + label + "".join(f", {how}" for how in options.values()))
    picture.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
    return picture


def line(axes: Axes, at: float, values: Sequence[float], style: Style) -> None:
    """All seeds of a controller as dots, the median as a bar."""
    if not values:
        return
    axes.plot(values, [at] * len(values), "o", ms=4, color=style.color, alpha=0.6, mew=0)
    axes.plot([float(np.median(values))], [at], "|", ms=11, mew=2, color=style.color)


def number_axis(axis: Axis) -> None:
    """Numbers of a logarithmic axis at powers of ten, between them too where it is short."""
    low, high = axis.get_view_interval()
    between = (1.0, 2.0, 5.0) if high > 5 * low else (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
    log_ticks(axis, between if is_short(axis) else (1.0,))


def is_short(axis: Axis) -> bool:
    """Whether a logarithmic axis has so few powers of ten that numbers between them are needed, and have room."""
    low, high = axis.get_view_interval()
    return bool(high <= 100 * low)


def number_short(axes: Axes) -> None:
    """`number_axis` of those of both axes that are short; on the others powers of ten have room."""
    for axis in (axes.xaxis, axes.yaxis):
        if is_short(axis):
            number_axis(axis)


@figure(
    "contest-fvu",
    of="contest",
    needs=finished,
    caption="What is known (frozen) against what is followed (online); on the diagonal both are one.",
)
def known(standing: Standing) -> Figure:
    """Frozen against online FVU: what a learner knows against what it follows; on the diagonal both are one."""
    tasks, style = tasks_run(standing), styles_of_controllers(standing.controllers)
    learners = [name for name in standing.controllers if name not in (BASELINE, *ORACLES)]
    picture, panels = axes_grid(len(tasks), 4, 3.2, 3.1, 0.9)
    for axes, task in zip(panels, tasks, strict=True):
        for name, marker in zip(learners, cycle(MARKERS), strict=False):
            pairs = [(nan(row.online_fvu), nan(row.frozen_fvu)) for row in standing.of(task, name)]
            pairs = [pair for pair in pairs if all(value > 0 for value in pair)]
            if pairs:
                look: Look = {"marker": marker, "color": style[name].color, "label": plain(name)}
                axes.plot(*zip(*pairs, strict=True), ls="", ms=5.5, alpha=0.75, mew=0, **look)
        axes.set(xscale="log", yscale="log", xlabel="FVU online", ylabel="FVU frozen, worst held out", title=task)
        low, high = min(axes.get_xlim()[0], axes.get_ylim()[0]), max(axes.get_xlim()[1], axes.get_ylim()[1])
        axes.plot([low, high], [low, high], color="0.7", lw=0.8, zorder=1)
        axes.axhline(1.0, color="0.7", lw=0.8, ls=":", zorder=1)
        number_short(axes)
    legend(picture, "Contest: what is followed and what is known", panels)
    return picture


@figure(
    "contest-learning",
    of="contest",
    needs=finished,
    caption="Error over PD's along the training, median over the seeds; dotted where it counts as learned.",
)
def learning(standing: Standing) -> Figure:
    """Error over that of PD along the training, median over the seeds; dotted where it counts as learned.

    Windows are joined until a curve has at most `POINTS`.
    """
    tasks, style, contest = tasks_run(standing), styles_of_controllers(standing.controllers), standing.contest
    picture, panels = axes_grid(len(tasks), 3, 4.2, 2.6, 0.9)
    for axes, task in zip(panels, tasks, strict=True):
        step = contest.window
        for name in standing.controllers:
            curves = relative_curves(standing, task, name)
            if curves and len(curves[0]):
                middle = np.median([thinned(curve) for curve in curves], axis=0)
                step = contest.window * joined_windows(curves[0])
                axes.plot(step * (np.arange(len(middle)) + 0.5), middle, label=plain(name), **style[name].line)
        axes.set(yscale="log", xlabel=f"time [s], in steps of {step:g} s", ylabel="error / PD's", title=task)
        axes.axhline(contest.learned, color="0.5", lw=0.8, ls=":")
    legend(picture, "Contest: learning curves", panels)
    return picture


@figure(
    "contest-held-out",
    of="contest",
    needs=finished,
    caption="RMS errors on the held-out trajectories, while learning and with fixed weights.",
)
def held_out(standing: Standing) -> Figure:
    """RMS errors on the held-out trajectories: filled while learning, open with frozen weights."""
    columns = [(label, of, {"how": how}) for label, of in HELD_OUT.items() for how in ("learning", "frozen")]
    return dots(standing, "Contest: RMS error on the held-out trajectories, every seed", columns)


def joined_windows(curve: Sequence[float]) -> int:
    """How many windows of a curve are joined."""
    return -(-len(curve) // POINTS)


def thinned(curve: Sequence[float]) -> Array:
    """A curve with its windows joined, as root of the mean square; without those of an unfinished end."""
    k = joined_windows(curve)
    joined = np.asarray(curve)[: len(curve) // k * k].reshape(-1, k)
    return np.sqrt((joined**2).mean(axis=1))


def relative_curves(standing: Standing, task: str, controller: str) -> list[list[float]]:
    """Error over PD's per window, one curve per seed that was completed; see `learning_time`."""
    pd = {row.seed: row for row in standing.of(task, BASELINE)}
    curves = []
    for row in standing.of(task, controller):
        scale = [nan(value) ** 2 for value in pd[row.seed].rms.values()] if row.seed in pd else []
        if row.completed and scale and all(value > 0 for value in scale):
            squares = [sum(a / b for a, b in zip(mean, scale, strict=True)) / len(scale) for mean in row.curve]
            curves.append([math.sqrt(value) for value in squares])
    return curves


def legend(figure: Figure, title: str, all_axes: Sequence[Axes]) -> None:
    """Title and one legend of all that is drawn."""
    entries: dict[str, Any] = {}
    for axes in all_axes:
        handles, labels = axes.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    made = figure.legend(
        entries.values(),
        entries.keys(),
        loc="outside upper left",
        ncols=max(1, int(figure.get_figwidth() / 1.9)),
        frameon=False,
        title=title,
        alignment="left",
    )
    made.get_title().set(fontsize=12, fontweight="bold")
