"""A contest in tables, in figures and on a page: every task, medians over the seeds and their spread, the targets."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from mmnn_pin.lab.experiments.controllers import ORACLES
from mmnn_pin.lab.show.figure import (
    FIGURES,
    Look,
    add_legend,
    axes_grid,
    figure,
    log_ticks,
    mark_empty,
    new_figure,
    pictures,
    plain,
    save,
    styles_of_controllers,
)
from mmnn_pin.lab.show.files import HtmlPage, fill_template
from mmnn_pin.lab.show.table import Cell, Column, Table, TextLine, number, row_of, terminal_text
from mmnn_pin.signals import Array

from .settings import PLAIN
from .standing import BASELINE, Standing, Target, over_all, relative_errors
from .trial import arm_of, base_of, nan

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Values = Callable[[Standing, str, str], list[float]]
MARKERS = "os^DvPX<>*hd"
POINTS = 25  # of a learning curve, at most: more of them are a thicket of lines


@dataclass(frozen=True)
class Quantity:
    """What a column shows of a controller on a task.

    Attributes:
        key: Its name in files.
        heading: In tables.
        unit: In tables.
        values: Standing, task and controller to a number per seed; inf and nan have their own words.
        infinite: Word for inf.
        limit: Above this it is marked.
    """

    key: str
    heading: str
    unit: str
    values: Values
    infinite: str = "-"
    limit: float = math.inf


def per_row(number: Callable[..., float], **options: str) -> Values:
    """Values of a column that is read off single rows."""
    return lambda standing, task, controller: [number(row, **options) for row in standing.of(task, controller)]


ERRORS: Mapping[str, Callable[..., float]] = {
    "base [mm]": lambda row: 1e3 * base_of(row.rms),
    "heading [mrad]": lambda row: 1e3 * nan(row.rms.get("phi")),
    "arm [mrad]": lambda row: 1e3 * arm_of(row.rms),
}
HELD_OUT: Mapping[str, Callable[..., float]] = {
    "base, held out [mm]": lambda row, how: 1e3 * over_all(row, how, base_of),
    "arm, held out [mrad]": lambda row, how: 1e3 * over_all(row, how, arm_of),
}


HELD_BASE, HELD_ARM = HELD_OUT.values()
TRAINING: Sequence[Quantity] = (
    Quantity("base", "base\n", "mm", per_row(ERRORS["base [mm]"])),
    Quantity("heading", "heading\n", "mrad", per_row(ERRORS["heading [mrad]"])),
    Quantity("arm", "arm\n", "mrad", per_row(ERRORS["arm [mrad]"])),
    Quantity("peak_base", "peak base\n", "mm", per_row(lambda row: 1e3 * base_of(row.peak))),
    Quantity("peak_arm", "peak arm\n", "mrad", per_row(lambda row: 1e3 * arm_of(row.peak))),
    Quantity("effort", "effort\n", "N²m²s", per_row(lambda row: nan(row.effort))),
    Quantity("torque", "torque\n", "%", per_row(lambda row: 100 * nan(row.torque)), limit=100.0),
    Quantity("kick", "kick\n", "%", per_row(lambda row: 100 * nan(row.kick)), limit=100.0),
    Quantity("learned", "learned\nin", "s", Standing.learning_times, "never"),
)
KNOWLEDGE: Sequence[Quantity] = (
    Quantity("online_fvu", "FVU\nonline", "", per_row(lambda row: nan(row.online_worst))),
    Quantity("frozen_fvu", "FVU\nfrozen", "", per_row(lambda row: nan(row.frozen_worst))),
    Quantity("held_base", "base held\nout", "mm", per_row(HELD_BASE, how="learning"), "lost"),
    Quantity("held_arm", "arm held\nout", "mrad", per_row(HELD_ARM, how="learning"), "lost"),
    Quantity("frozen_base", "base\nfrozen", "mm", per_row(HELD_BASE, how="frozen"), "lost"),
    Quantity("frozen_arm", "arm\nfrozen", "mrad", per_row(HELD_ARM, how="frozen"), "lost"),
    Quantity("step", "step\n/ pd", "", lambda standing, task, name: [standing.step_ratio(task, name)]),
)
WIDTH = 120
CAPTION = (
    "Medians over the seeds ({seeds}), below them half of the spread from the smallest to the largest, from 1 % on. "
    "Errors are the true ones: RMS and peak in the last window of the training; arm: root of the mean square over its"
    " joints. torque, kick: largest torque asked of a motor over its limit, in the training and in its first "
    "{start:g} s. learned in: until the error stays below {learned:g} of the least of {plain}. FVU: of \u03a8, its "
    "worst component; frozen: with the final weights held fixed, on the worst of the held-out trajectories. held out:"
    " RMS error over all of those, learning on, or with frozen weights. step: processor time of a step over "
    "PD's, called from Python."
)


def render(standing: Standing, colour: bool = False, width: int = WIDTH) -> str:
    """All tables and the targets as text of at most `width` columns."""
    parts: list[str | TextLine | Table] = [TextLine(standing.experiment.title or standing.name, "bold")]
    for task in tasks_run(standing):
        parts += [TextLine(f"\n{task}: {standing.tasks[task]}", "bold"), demands(standing, task)]
        parts += [task_table(standing, task, quantities) for quantities in (TRAINING, KNOWLEDGE)]
    targets = judged_targets(standing)
    parts += [TextLine(caption(standing), "italic"), *([targets_table(targets)] if targets else [])]
    return terminal_text(parts, colour, width)


def judged_targets(standing: Standing) -> list[Target]:
    """The targets that there are numbers for."""
    return [target for target in standing.targets() if target.reached is not None]


def caption(standing: Standing) -> str:
    """What the columns mean."""
    contest = standing.contest
    plain = ", ".join(PLAIN)
    return CAPTION.format(seeds=contest.seeds, start=contest.start, learned=contest.learned, plain=plain)


def findings(standing: Standing) -> list[str]:
    """Findings of the learners, each once with its tasks."""
    found: dict[str, list[str]] = {}
    for row in standing.results:
        for text in row.findings:
            tasks = found.setdefault(text if text.startswith(row.controller) else f"{row.controller}: {text}", [])
            tasks += [row.task] if row.task not in tasks else []
    return [f"{text} ({', '.join(tasks)})" for text, tasks in found.items()]


def demands(standing: Standing, task: str) -> str:
    """What the reference asks of the motors."""
    found = standing.demands[task]
    speed, torque = max(found.speed, default=0.0), max(found.torque, default=0.0)
    return f"the reference takes {100 * speed:.3g} % of a motor's speed limit, {100 * torque:.3g} % of its torque limit"


def task_table(standing: Standing, task: str, quantities: Sequence[Quantity]) -> Table:
    """A row per controller; one that was lost on a seed says so in the place of its numbers."""
    made = []
    for controller in standing.controllers:
        rows = standing.of(task, controller)
        if not rows:
            continue
        if lost := [row for row in rows if not row.completed]:
            words = f"{len(lost)} of {len(rows)} lost\n{lost[0].outcome} at {lost[0].ended:.3g} s"
            cells = [Cell(words, "bad")]
        else:
            cells = [cell(q.values(standing, task, controller), q.infinite, q.limit) for q in quantities]
        made.append(row_of(controller, *cells))
    return Table(task, (Column(text=True), *(Column(q.heading, q.unit) for q in quantities)), tuple(made))


def cell(values: Sequence[float], infinite: str = "-", above: float = math.inf) -> Cell:
    """Median, and below it half of the spread in percent of it, from 1 % on; bad above a limit."""
    if any(map(math.isnan, values)):
        return Cell("-")
    ordered = sorted(values)
    low, mid, high = ordered[0], median(ordered), ordered[-1]
    text = number(mid, infinite)
    if not math.isfinite(high):
        text += f"\n({number(low, infinite)} to {infinite})" * (low < high)
    elif mid > 0 and high - low >= 0.02 * mid:
        text += f"\n±{50 * (high - low) / mid:.0f} %"
    return Cell(text, "bad" if mid > above else "")


def targets_table(targets: Sequence[Target]) -> Table:
    """Every target that could be judged: what is asked, what was reached and by whom, met or not."""
    heads = (
        Column("target", text=True, fold=True),
        Column("reached"),
        Column("by", text=True, fold=True),
        Column(text=True),
    )
    rows = (
        row_of(t.about, number(t.reached), t.by, Cell("met", "good") if t.met else Cell("not met", "bad"))
        for t in targets
        if t.reached is not None
    )
    return Table("Targets", heads, tuple(rows), gap=1)


# -- the page ----------------------------------------------------------------------------------------------------------


def page(standing: Standing, command: str = "") -> HtmlPage:
    """The page of a contest.

    Args:
        standing: What it gave.
        command: The command that makes this page, to be shown in it.
    """
    targets, missing = judged_targets(standing), ", ".join(standing.missing)
    unfinished = [f"rows are missing: {missing}; the command that runs the contest goes on with them"] * bool(missing)
    text = fill_template(
        "contest.html",
        __package__,
        title=standing.experiment.title or standing.name,
        subject=subject(standing),
        met=sum(target.met for target in targets),
        targets=targets_table(targets) if targets else None,
        notes=[*unfinished, *standing.notes],
        findings=findings(standing),
        tasks=[
            {"name": task, "title": standing.tasks[task], "demand": demands(standing, task), "tables": tables}
            for task in tasks_run(standing)
            if (tables := [task_table(standing, task, quantities) for quantities in (TRAINING, KNOWLEDGE)])
        ],
        caption=caption(standing).replace("below them", "beside them"),
        pictures=pictures("contest", standing),
        folder=str(standing.folder or ""),
        command=command,
        settings=json.dumps(json.loads(standing.experiment.to_json()), indent=2, ensure_ascii=False),
    )
    return HtmlPage(text)


def subject(standing: Standing) -> str:
    """What was run, in one line."""
    tasks, seeds, seed = tasks_run(standing), standing.contest.seeds, standing.experiment.seed
    counts = f"{len(standing.controllers)} controllers \u00b7 {len(tasks)} task{'s' if len(tasks) > 1 else ''}"
    return f"{standing.name} \u00b7 {counts} \u00b7 {seeds} seed{'s' if seeds > 1 else ''} from {seed}"


# -- the figures -------------------------------------------------------------------------------------------------------


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
    """A row of axes per task, a column per quantity, a line per controller: seeds as dots, their median as a bar."""
    tasks, names, style = tasks_run(standing), standing.controllers, styles_of_controllers(standing.controllers)
    picture = new_figure(3.1 * len(columns) + 1.2, 0.7 + len(tasks) * (0.55 + 0.19 * len(names)))
    grid: Any = picture.subplots(len(tasks), len(columns), squeeze=False)
    for (i, j), axes in np.ndenumerate(grid):
        task, (label, of, options) = tasks[i], columns[j]
        for k, name in enumerate(names):
            values = [of(row, **options) for row in standing.of(task, name) if row.completed]
            values = [value for value in values if math.isfinite(value) and value > 0]
            if values:
                axes.plot(values, [-k] * len(values), "o", ms=4, color=style[name].color, alpha=0.6, mew=0)
                axes.plot([float(np.median(values))], [-k], "|", ms=11, mew=2, color=style[name].color)
        if axes.lines:
            axes.set_xscale("log")
            number_axes(axes.xaxis)
        else:
            mark_empty(axes)
        axes.set_yticks([-k for k in range(len(names))], [plain(name) for name in names] if j == 0 else [])
        axes.set_ylim(0.6 - len(names), 0.6)
        axes.set_title(f"{task}: " * (j == 0) + label + "".join(f", {how}" for how in options.values()))
    picture.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
    return picture


def number_axes(*every: Axis) -> None:
    """Numbers of logarithmic axes at powers of ten, between them too where one is so short that it has room."""
    for axis in every:
        low, high = axis.get_view_interval()
        between = (1.0, 2.0, 5.0) if high > 5 * low else (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
        log_ticks(axis, between if high <= 100 * low else (1.0,))


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
    picture, panels = axes_grid(len(tasks), 4, 3.2 if len(tasks) > 1 else 4.6, 3.1, 0.9)
    shown: dict[str, Look] = {}
    for axes, task in zip(panels, tasks, strict=True):
        for name, marker in zip(learners, cycle(MARKERS), strict=False):
            pairs = [(nan(row.online_worst), nan(row.frozen_worst)) for row in standing.of(task, name)]
            if pairs := [pair for pair in pairs if all(value > 0 for value in pair)]:
                shown[plain(name)] = {"marker": marker, "color": style[name].color, "ls": "", "ms": 5.5, "mew": 0}
                axes.plot(*zip(*pairs, strict=True), alpha=0.75, **shown[plain(name)])
        axes.set(xscale="log", yscale="log", xlabel="FVU online", ylabel="FVU frozen, worst held out", title=task)
        low, high = min(axes.get_xlim()[0], axes.get_ylim()[0]), max(axes.get_xlim()[1], axes.get_ylim()[1])
        axes.plot([low, high], [low, high], color="0.7", lw=0.8, zorder=1)
        axes.axhline(1.0, color="0.7", lw=0.8, ls=":", zorder=1)
        number_axes(axes.xaxis, axes.yaxis)
    add_legend(picture, "Contest: what is followed and what is known", list(shown.items()))
    return picture


@figure(
    "contest-learning",
    of="contest",
    needs=finished,
    caption="Error over the least of PD, PD with gravity and PID, median over the seeds; dotted: counts as learned.",
)
def learning(standing: Standing) -> Figure:
    """Error over the least of the plain controllers' along the training, median over the seeds; dotted: learned.

    Windows are joined until a curve has at most `POINTS`.
    """
    tasks, style, contest = tasks_run(standing), styles_of_controllers(standing.controllers), standing.contest
    picture, panels = axes_grid(len(tasks), 3, 4.2, 2.6, 0.9)
    for axes, task in zip(panels, tasks, strict=True):
        step = contest.window
        for name in standing.controllers:
            curves = relative_curves(standing, task, name)
            if length := min(map(len, curves), default=0):  # of a file that lost windows of a run: what all have
                joined = -(-length // POINTS)  # windows in a point
                middle = np.median([thinned(curve[:length], joined) for curve in curves], axis=0)
                step = contest.window * joined
                axes.plot(step * (np.arange(len(middle)) + 0.5), middle, **style[name].line)
        axes.set(yscale="log", xlabel=f"time [s], in steps of {step:g} s", ylabel="error / best plain", title=task)
        axes.axhline(contest.learned, color="0.5", lw=0.8, ls=":")
    add_legend(picture, "Contest: learning curves", [(plain(name), one.line) for name, one in style.items()])
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


def thinned(curve: Sequence[float], k: int) -> Array:
    """A curve with k windows joined to one, as root of the mean square; without those of an unfinished end."""
    joined = np.asarray(curve)[: len(curve) // k * k].reshape(-1, k)
    return np.sqrt((joined**2).mean(axis=1))


def relative_curves(standing: Standing, task: str, controller: str) -> list[list[float]]:
    """Error over the plain controllers' per window, one curve per seed that was completed; see `relative_errors`."""
    rows = (row for row in standing.of(task, controller) if row.completed)
    curves = (relative_errors(row, standing.plain_errors(task, row.seed)) for row in rows)
    return [curve for curve in curves if curve]
