"""The table of an experiment with cases: a row per case, a column per controller, a verdict in every cell."""

from __future__ import annotations

import math
import re

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ..experiments.cases import Matrix, Verdict

STYLES = {"tracked": "green", "stopped": "yellow", "failed": "bold red", "interrupted": "dim"}
WIDTH = 120


def render(matrix: Matrix, colour: bool = False, width: int = WIDTH) -> str:
    """The table and what it adds up to, as text of at most `width` columns."""
    console = Console(width=width, force_terminal=colour, color_system="standard" if colour else None)
    with console.capture() as capture:
        console.print(
            f"{matrix.experiment.title or matrix.name} ({matrix.experiment.robot})", style="bold", highlight=False
        )
        console.print(table(matrix))
        console.print(summary(matrix), highlight=False)
        console.print(caption(matrix), style="italic", highlight=False)
    return "\n".join(line.rstrip() for line in capture.get().splitlines())


def table(matrix: Matrix) -> Table:
    """A row per case."""
    grid = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    grid.add_column("case", overflow="fold")
    for controller in matrix.experiment.controllers:
        grid.add_column(controller, overflow="fold")
    for case, row in matrix.verdicts.items():
        cells = [cell(row[c]) if c in row else Text("-") for c in matrix.experiment.controllers]
        grid.add_row(matrix.experiment.cases[case].title, *cells)
    return grid


def cell(verdict: Verdict) -> Text:
    """A verdict in a few words: how far off it tracked, or when and why it stopped."""
    if verdict.kind == "tracked":
        words = "tracked " + ", ".join(
            f"{1000 * value:.3g} {unit}"
            for value, unit in ((verdict.pose, "mm"), (verdict.joint, "mrad"))
            if not math.isnan(value)
        )
    elif verdict.kind == "stopped":
        found = re.match(r"tripped at t = (\S+) s: (.*?)(,|;|$)", verdict.text)
        words = f"stopped {found[1]} s: {found[2]}" if found else f"stopped: {verdict.text}"
    else:
        words = f"{verdict.kind.upper()}: {verdict.text}"
    return Text(words, STYLES[verdict.kind])


def summary(matrix: Matrix) -> str:
    """How many runs tracked, stopped, failed."""
    counts = {kind: matrix.count(kind) for kind in ("tracked", "stopped", "failed")}
    total = sum(counts.values())
    return f"{total} runs: " + ", ".join(f"{count} {kind}" for kind, count in counts.items())


def caption(matrix: Matrix) -> str:
    """What the cells say."""
    t = matrix.experiment.tolerance
    return (
        f"tracked: largest true distance of the base and joint error after {t.settle:g} s, within the case's tolerance "
        f"({1000 * t.pose:g} mm, {1000 * t.joint:g} mrad unless it says otherwise). stopped: by the supervisor, at "
        f"rest at the end, less than {t.runaway:g} m away when it tripped and driven after it. FAILED: neither."
    )
