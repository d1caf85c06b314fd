"""A contest in tables and on a page: every task, medians over the seeds with their spread, and the targets."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from ..contest.standing import Standing, Target
from ..contest.trial import Number, TrialResult, arm_of, base_of, nan
from .contest_figures import finished, over_all, tasks_run
from .figure import FIGURES, svg
from .files import HtmlPage, fill_template
from .table import Cell, Column, Line, Table, number, row_of, terminal_text

Values = Callable[[Standing, str, str], list[float]]


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


def per_row(number: Callable[[TrialResult], float]) -> Values:
    """Values of a column that is read off single rows."""
    return lambda standing, task, controller: [number(row) for row in standing.of(task, controller)]


def held_out(how: str, of_axes: Callable[[dict[str, Number]], float]) -> Values:
    """Values of a column of errors on the held-out trajectories, in thousandths."""
    return per_row(lambda row: 1e3 * over_all(row, how, of_axes))


TRAINING: Sequence[Quantity] = (
    Quantity("base", "base\n", "mm", per_row(lambda row: 1e3 * base_of(row.rms))),
    Quantity("heading", "heading\n", "mrad", per_row(lambda row: 1e3 * nan(row.rms.get("phi")))),
    Quantity("arm", "arm\n", "mrad", per_row(lambda row: 1e3 * arm_of(row.rms))),
    Quantity("peak_base", "peak base\n", "mm", per_row(lambda row: 1e3 * base_of(row.peak))),
    Quantity("peak_arm", "peak arm\n", "mrad", per_row(lambda row: 1e3 * arm_of(row.peak))),
    Quantity("effort", "effort\n", "N²m²s", per_row(lambda row: nan(row.effort))),
    Quantity("torque", "torque\n", "%", per_row(lambda row: 100 * nan(row.torque)), limit=100.0),
    Quantity("kick", "kick\n", "%", per_row(lambda row: 100 * nan(row.kick)), limit=100.0),
    Quantity("learned", "learned\nin", "s", Standing.learning_times, "never"),
)
KNOWLEDGE: Sequence[Quantity] = (
    Quantity("online_fvu", "FVU\nonline", "", per_row(lambda row: nan(row.online_fvu))),
    Quantity("frozen_fvu", "FVU\nfrozen", "", per_row(lambda row: nan(row.frozen_fvu))),
    Quantity("held_base", "base held\nout", "mm", held_out("learning", base_of), "lost"),
    Quantity("held_arm", "arm held\nout", "mrad", held_out("learning", arm_of), "lost"),
    Quantity("frozen_base", "the same,\nfrozen", "", held_out("frozen", base_of), "lost"),
    Quantity("frozen_arm", "the same,\nfrozen", "", held_out("frozen", arm_of), "lost"),
    Quantity("step", "step\n/ pd", "", lambda standing, task, name: [standing.step_ratio(task, name)]),
)
WIDTH = 120
CAPTION = (
    "Medians over the seeds ({seeds}), below them half of the spread from the smallest to the largest, from 1 % on. "
    "Errors are the true ones: RMS and peak in the last window of the training; arm: root of the mean square over its"
    " joints. torque, kick: largest torque asked of a motor over its limit, in the training and in its first "
    "{start:g} s. learned in: until the error stays below {learned:g} of PD's. FVU: of Psi, mean over its components;"
    " frozen: with the final weights held fixed, on the worst of the held-out trajectories. held out: RMS error over "
    "all of those, learning on, or with frozen weights. step: processor time of the controller's step over PD's, "
    "called from Python."
)


def render(standing: Standing, colour: bool = False, width: int = WIDTH) -> str:
    """All tables and the targets as text of at most `width` columns."""
    parts: list[str | Line | Table] = [Line(standing.experiment.title or standing.name, "bold")]
    for task in tasks_run(standing):
        parts += [Line(f"\n{task}: {standing.tasks[task]}", "bold"), demands(standing, task)]
        parts += [task_table(standing, task, quantities) for quantities in (TRAINING, KNOWLEDGE)]
    targets = judged_targets(standing)
    parts += [Line(caption(standing), "italic"), *([targets_table(targets)] if targets else [])]
    return terminal_text(parts, colour, width)


def judged_targets(standing: Standing) -> list[Target]:
    """The targets that there are numbers for."""
    return [target for target in standing.targets() if target.reached is not None]


def caption(standing: Standing) -> str:
    """What the columns mean."""
    contest = standing.contest
    return CAPTION.format(seeds=contest.seeds, start=contest.start, learned=contest.learned)


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
        lost = [row for row in rows if not row.completed]
        if lost:
            words = f"{len(lost)} of {len(rows)} lost\n{lost[0].outcome} at {lost[0].ended:.3g} s"
            made.append(row_of(controller, Cell(words, "bad")))
        elif rows:
            made.append(
                row_of(
                    controller, *(cell(q.values(standing, task, controller), q.infinite, q.limit) for q in quantities)
                )
            )
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


def page(standing: Standing, command: str = "") -> HtmlPage:
    """The page of a contest.

    Args:
        standing: What it gave.
        command: The command that makes this page, to be shown in it.
    """
    targets = judged_targets(standing)
    text = fill_template(
        "contest.html",
        title=standing.experiment.title or standing.name,
        subject=subject(standing),
        met=sum(target.met for target in targets),
        targets=targets_table(targets) if targets else None,
        notes=[*unfinished(standing), *standing.notes],
        findings=findings(standing),
        tasks=list(tasks_of(standing)),
        caption=caption(standing).replace("below them", "beside them"),
        pictures=pictures(standing),
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


def unfinished(standing: Standing) -> list[str]:
    """What is still to be run."""
    if not standing.missing:
        return []
    return [f"rows are missing: {', '.join(standing.missing)}; the command that runs the contest goes on with them"]


def tasks_of(standing: Standing) -> Iterator[dict[str, Any]]:
    """Every task: its name, title, demand and two tables."""
    for task in tasks_run(standing):
        yield {
            "name": task,
            "title": standing.tasks[task],
            "demand": demands(standing, task),
            "tables": [task_table(standing, task, quantities) for quantities in (TRAINING, KNOWLEDGE)],
        }


def pictures(standing: Standing) -> list[dict[str, str]]:
    """The figures as SVG, each with a caption; none where no run reached its end."""
    if finished(standing):
        return []
    return [{"svg": svg(entry.make(standing)), "caption": entry.caption} for entry in FIGURES["contest"].values()]
