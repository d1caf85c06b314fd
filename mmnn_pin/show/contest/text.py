"""A contest for a terminal: one table per task, medians over the seeds with their spread, and the targets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ...contest.contest import Standing
from ...contest.row import Row, Tracking, arm_of, base_of, nan
from ...contest.targets import Target
from ..table import number

WIDTH = 120
Cells = Callable[[Standing, str, str, Sequence[Row]], Iterator[Text]]
TRAINING = (
    *("base\n[mm]", "heading\n[mrad]", "arm\n[mrad]"),
    *("peak base\n[mm]", "peak arm\n[mrad]"),
    *("effort\n[N²m²s]", "torque\n[%]", "kick\n[%]", "learned\nin [s]"),
)
KNOWLEDGE = (
    *("FVU\nonline", "FVU\nfrozen"),
    *("base held\nout [mm]", "arm held\nout [mrad]", "the same,\nfrozen", "the same,\nfrozen", "step\n/ pd"),
)
CAPTION = (
    "Medians over {seeds} seeds, below them half of the spread from the smallest to the largest, from 1 % on. Errors are "
    "the true ones: RMS and peak in the last window of the training; arm: root of the mean square over its joints. "
    "torque, kick: largest torque asked of a motor over its limit, in all of the training and in its first {start:g} s. "
    "learned in: until the error stays below {learned:g} of PD's. FVU: of Psi, mean over its components; frozen: with "
    "the final weights held fixed, on the worst of the held-out trajectories. held out: RMS error over all of those, "
    "learning on, or with frozen weights. step: processor time of the controller's step over PD's, called from Python."
)


def render(standing: Standing, colour: bool = False, width: int = WIDTH) -> str:
    """All tables and the targets as text of at most `width` columns."""
    console = Console(width=width, force_terminal=colour, color_system="standard" if colour else None)
    contest = standing.contest
    with console.capture() as capture:
        console.print(standing.experiment.title or standing.name, style="bold", highlight=False)
        for task in standing.tasks:
            if any(standing.of(task, name) for name in standing.controllers):
                console.print(f"\n{task}: {standing.tasks[task]}", style="bold", highlight=False)
                console.print(demands(standing, task), highlight=False)
                console.print(table(standing, task, TRAINING, training))
                console.print(table(standing, task, KNOWLEDGE, knowledge))
        caption = CAPTION.format(seeds=contest.seeds, start=contest.start, learned=contest.learned)
        console.print(caption, style="italic", highlight=False)
        if found := standing.targets():
            console.print(targets_table(found))
    return "\n".join(line.rstrip() for line in capture.get().splitlines())


def demands(standing: Standing, task: str) -> str:
    """What the reference asks of the motors."""
    found = standing.demands[task]
    speed, torque = max(found.speed, default=0.0), max(found.torque, default=0.0)
    return f"the reference takes {100 * speed:.3g} % of a motor's speed limit, {100 * torque:.3g} % of its torque limit"


def table(standing: Standing, task: str, columns: Sequence[str], cells: Cells) -> Table:
    """A row per controller."""
    grid = Table(box=SIMPLE_HEAD, padding=(0, 2, 0, 0))
    grid.add_column("", no_wrap=True)
    for name in columns:
        grid.add_column(name, justify="right", no_wrap=True)
    for controller in standing.controllers:
        rows = standing.of(task, controller)
        lost = sum(not row.completed for row in rows)
        if lost:
            grid.add_row(controller, Text(f"{lost} of {len(rows)} lost", style="bold red"))
        elif rows:
            grid.add_row(controller, *cells(standing, task, controller, rows))
    return grid


def training(standing: Standing, task: str, controller: str, rows: Sequence[Row]) -> Iterator[Text]:
    """How a controller did in the training."""
    for of in (lambda row: base_of(row.rms), lambda row: nan(row.rms.get("phi")), lambda row: arm_of(row.rms)):
        yield cell([1e3 * of(row) for row in rows])
    yield cell([1e3 * base_of(row.peak) for row in rows])
    yield cell([1e3 * arm_of(row.peak) for row in rows])
    yield cell([row.effort for row in rows])
    yield cell([100 * row.torque for row in rows], above=100.0)
    yield cell([100 * row.kick for row in rows], above=100.0)
    yield cell(standing.learning_times(task, controller), "never")


def knowledge(standing: Standing, task: str, controller: str, rows: Sequence[Row]) -> Iterator[Text]:
    """What a controller knows of Psi, and how it did on the held-out trajectories."""
    yield cell([nan(row.online_fvu) for row in rows])
    yield cell([nan(row.frozen_fvu) for row in rows])
    for how in ("learning", "frozen"):
        for of_axes in (base_of, arm_of):
            yield cell([1e3 * over_all(row, how, of_axes) for row in rows], "lost")
    yield Text(number(standing.step_ratio(task, controller)))


def over_all(row: Row, how: str, of_axes: Callable[[dict[str, float | None]], float]) -> float:
    """Root of the mean square error over all held-out trajectories; inf where one was lost, nan where none was run."""
    found: list[Tracking] = [ways[how] for ways in row.held_out.values() if how in ways]
    if not found:
        return math.nan
    if any(one.outcome != "completed" for one in found):
        return math.inf
    return math.sqrt(sum(of_axes(one.rms) ** 2 for one in found) / len(found))


def cell(values: Sequence[float], infinite: str = "-", above: float = math.inf) -> Text:
    """Median, and below it half of the spread in percent of it, from 1 % on; red above a limit."""
    if any(map(math.isnan, values)):
        return Text("-")
    ordered = sorted(values)
    low, mid, high = ordered[0], ordered[len(ordered) // 2], ordered[-1]
    text = word(mid, infinite)
    if not math.isfinite(high):
        text += f"\n{word(low, infinite)} to {infinite}" * (low < high)
    elif mid > 0 and high - low >= 0.02 * mid:
        text += f"\n±{50 * (high - low) / mid:.0f} %"
    return Text(text, style="bold red" if mid > above else "")


def word(value: float, infinite: str) -> str:
    """A number, or a word for one that is not finite."""
    return number(value) if math.isfinite(value) else infinite


def targets_table(found: Sequence[Target]) -> Table:
    """Every target: what is asked, what was reached and by whom, met or not."""
    grid = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("target", "reached", "by", ""):
        grid.add_column(name, overflow="fold", justify="right" if name == "reached" else "left")
    for target in found:
        reached = "-" if target.reached is None else number(target.reached)
        mark = Text("met", style="green") if target.met else Text("not met", style="bold red")
        grid.add_row(target.about, reached, target.by or "nobody judged", mark)
    return grid
