"""A contest for a terminal: one table per task, medians over the seeds with their spread, and the targets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from ...contest.standing import Standing, Target
from ..table import number
from .columns import KNOWLEDGE, TRAINING, Column

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
    console = Console(width=width, force_terminal=colour, color_system="standard" if colour else None)
    with console.capture() as capture:
        console.print(standing.experiment.title or standing.name, style="bold", highlight=False)
        for task in standing.tasks:
            if any(standing.of(task, name) for name in standing.controllers):
                console.print(f"\n{task}: {standing.tasks[task]}", style="bold", highlight=False)
                console.print(demands(standing, task), highlight=False)
                console.print(table(standing, task, TRAINING))
                console.print(table(standing, task, KNOWLEDGE))
        console.print(caption(standing), style="italic", highlight=False)
        if found := [target for target in standing.targets() if target.reached is not None]:
            console.print(targets_table(found))
    return "\n".join(line.rstrip() for line in capture.get().splitlines())


def caption(standing: Standing) -> str:
    """What the columns mean."""
    contest = standing.contest
    return CAPTION.format(seeds=contest.seeds, start=contest.start, learned=contest.learned)


def findings(standing: Standing) -> list[str]:
    """Findings of the learners, each told once with its tasks."""
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


def table(standing: Standing, task: str, columns: Sequence[Column]) -> Table:
    """A row per controller."""
    grid = Table(box=SIMPLE_HEAD, padding=(0, 2, 0, 0))
    grid.add_column("", no_wrap=True)
    for column in columns:
        grid.add_column(escape(column.heading), justify="right", no_wrap=True)
    for controller in standing.controllers:
        rows = standing.of(task, controller)
        lost = sum(not row.completed for row in rows)
        if lost:
            first = next(row for row in rows if not row.completed)
            told = f"{lost} of {len(rows)} lost\n{first.outcome} at {first.ended:.3g} s"
            grid.add_row(controller, Text(told, style="bold red"))
        elif rows:
            values = [column.values(standing, task, controller) for column in columns]
            cells = [cell(found, c.infinite, c.limit) for found, c in zip(values, columns, strict=True)]
            grid.add_row(controller, *cells)
    return grid


def cell(values: Sequence[float], infinite: str = "-", above: float = math.inf) -> Text:
    """Median, and below it half of the spread in percent of it, from 1 % on; red above a limit."""
    if any(map(math.isnan, values)):
        return Text("-")
    ordered = sorted(values)
    low, mid, high = ordered[0], median(ordered), ordered[-1]
    text = word(mid, infinite)
    if not math.isfinite(high):
        text += f"\n({word(low, infinite)} to {infinite})" * (low < high)
    elif mid > 0 and high - low >= 0.02 * mid:
        text += f"\n±{50 * (high - low) / mid:.0f} %"
    return Text(text, style="bold red" if mid > above else "")


def word(value: float, infinite: str) -> str:
    """A number, or a word for one that is not finite."""
    return number(value) if math.isfinite(value) else infinite


def targets_table(found: Sequence[Target]) -> Table:
    """Every target that could be judged: what is asked, what was reached and by whom, met or not."""
    grid = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("target", "reached", "by", ""):
        grid.add_column(name, overflow="fold", justify="right" if name == "reached" else "left")
    for target in found:
        if target.reached is not None:
            mark = Text("met", style="green") if target.met else Text("not met", style="bold red")
            grid.add_row(target.about, number(target.reached), target.by, mark)
    return grid
