"""One table of what each reading of an experiment does to its learners."""

from __future__ import annotations

from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from .table import WIDTH, number

CAPTION = (
    "RMS errors of the last window, in thousandths (mm, mrad). share: RMS of Psi_hat over RMS of the torque. met: "
    "intervals of the thesis's figures. A dash: the run did not get there."
)
HIDDEN = ("pose_error.y",)  # a straight line has next to none


def render(title: str, rows: list[dict[str, Any]], width: int = WIDTH) -> str:
    """The table with title and caption, as text; rows as `experiments.readings.told` gives them."""
    console = Console(width=width)
    with console.capture() as capture:
        console.print(title, style="bold", highlight=False)
        console.print(comparison(rows))
        console.print(CAPTION, highlight=False)
    return "\n".join(line.rstrip() for line in capture.get().splitlines())


def comparison(rows: list[dict[str, Any]]) -> Table:
    """Per reading a line for each learner: its RMS errors and learned shares."""
    learners = [name for name, value in rows[0].items() if isinstance(value, dict)]
    first = rows[0][learners[0]]
    table = Table(box=SIMPLE_HEAD, padding=0)
    for head in ("", ""):
        table.add_column(head, no_wrap=True)
    for head in [*map(heading, errors(first)), *(f"share\n{part}" for part in first["learned_share"]), "met"]:
        table.add_column(Text(head), justify="right", no_wrap=True)
    for row in rows:
        for learner in learners:
            words, met = (row["reading"], f"{row['met']} of {row['of']}") if learner == learners[0] else ("", "")
            cells = (*errors(row[learner]).values(), *shares(row[learner]))
            table.add_row(words, f"  {learner}", *(f"  {cell}" for cell in cells), f"  {met if row['of'] else ''}")
    return table


def heading(key: str) -> str:
    """Label of an error's column."""
    return key.partition(".")[2].removesuffix("_joint")


def errors(learner: dict[str, Any]) -> dict[str, str]:
    """RMS errors of pose and joints in thousandths."""
    kept = {key: value for key, value in learner["rms"].items() if not key.startswith("z.") and key not in HIDDEN}
    return {key: "-" if value is None else number(1e3 * value) for key, value in kept.items()}


def shares(learner: dict[str, Any]) -> list[str]:
    """Learned shares of base and arm."""
    return ["-" if value is None else f"{value:.2f}" for value in learner["learned_share"].values()]
