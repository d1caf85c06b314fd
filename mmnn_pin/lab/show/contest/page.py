"""A contest as one HTML page that opens anywhere: targets, the tables of every task, the figures, what was asked."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from importlib import resources
from typing import Any

from ...contest.standing import Standing
from ..figure import svg
from ..html_page import HtmlPage, filled
from ..report.page import source as source_of_report
from ..report.tables import Row, plain, rows_of
from .columns import KNOWLEDGE, TRAINING, Column
from .figures import FIGURES, run_tasks
from .text import caption, demands, findings, table, targets_table

PICTURES = {
    "contest-errors": "RMS errors in the last window of the training: a dot per seed, a bar at the median.",
    "contest-fvu": "What is known (frozen) against what is followed (online); on the diagonal both are one.",
    "contest-learning": "Error over PD's along the training, median over the seeds; dotted where it counts as learned.",
    "contest-held-out": "RMS errors on the held-out trajectories, while learning and with fixed weights.",
}


def page(standing: Standing, command: str = "") -> HtmlPage:
    """The page of a contest.

    Args:
        standing: What it gave.
        command: The command that makes this page, to be shown in it.
    """
    found = [target for target in standing.targets() if target.reached is not None]
    text = filled(
        resources.files(__package__).joinpath("page.html").read_text("utf-8"),
        title=standing.experiment.title or standing.name,
        subject=subject(standing),
        met=sum(target.met for target in found),
        targets=rows_of(targets_table(found)),
        notes=[*unfinished(standing), *standing.notes],
        findings=findings(standing),
        tasks=list(tasks_of(standing)),
        caption=caption(standing).replace("below them", "beside them"),
        pictures=pictures(standing),
        folder=str(standing.folder or ""),
        command=command,
        settings=json.dumps(json.loads(standing.experiment.to_json()), indent=2, ensure_ascii=False),
        style=source_of_report("page.css"),
    )
    return HtmlPage(text)


def subject(standing: Standing) -> str:
    """What was run, in one line."""
    tasks, seeds, seed = run_tasks(standing), standing.contest.seeds, standing.experiment.seed
    counts = f"{len(standing.controllers)} controllers \u00b7 {len(tasks)} task{'s' if len(tasks) > 1 else ''}"
    return f"{standing.name} \u00b7 {counts} \u00b7 {seeds} seed{'s' if seeds > 1 else ''} from {seed}"


def unfinished(standing: Standing) -> list[str]:
    """What is still to be run."""
    if not standing.missing:
        return []
    return [f"rows are missing: {', '.join(standing.missing)}; the command that runs the contest goes on with them"]


def tasks_of(standing: Standing) -> Iterator[dict[str, Any]]:
    """Every task: its name, title, demand and two tables."""
    for task in run_tasks(standing):
        yield {
            "name": task,
            "title": standing.tasks[task],
            "demand": demands(standing, task),
            "tables": [table_of(standing, task, columns) for columns in (TRAINING, KNOWLEDGE)],
        }


def table_of(standing: Standing, task: str, columns: Sequence[Column]) -> tuple[list[str], tuple[Row, ...]]:
    """Heads and rows of a table."""
    return [plain(column.heading) for column in columns], rows_of(table(standing, task, columns))


def pictures(standing: Standing) -> list[dict[str, str]]:
    """The figures as SVG, each with a caption; none where no run reached its end."""
    if not any(row.completed for row in standing.results):
        return []
    return [{"svg": svg(FIGURES[name](standing)), "caption": words} for name, words in PICTURES.items()]
