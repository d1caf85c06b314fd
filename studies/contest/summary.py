"""A contest as the numbers of its document: smallest, median and largest per task, controller and column."""

from __future__ import annotations

import math
from statistics import median
from typing import Any

from mmnn_pin.lab.contest.contest import Standing
from mmnn_pin.lab.contest.demand import held_out_torque
from mmnn_pin.lab.contest.task import tasks_of
from mmnn_pin.lab.show.contest import KNOWLEDGE, TRAINING

Cell = list[float | str | None] | None


def summed(standing: Standing) -> dict[str, Any]:
    """Tasks with their tables, targets, findings."""
    held_out = {task.name: held_out_torque(task) for task in tasks_of(standing.experiment, ("pd",))}
    return {
        "tasks": {task: about(standing, task) | {"held_out": held_out[task]} for task in standing.tasks},
        "targets": [target.to_dict() for target in standing.targets()],
        "seeds": standing.contest.seeds,
        "learned": standing.contest.learned,
        "window": standing.contest.window,
        "start": standing.contest.start,
        "told": {name: standing.contest.told(name) for name in standing.controllers},
        "poor": findings(standing, standing.contest.targets.poor),
    }


def about(standing: Standing, task: str) -> dict[str, Any]:
    """One task: what its reference asks, and a cell per controller and column."""
    demand = standing.demands[task]
    return {
        "title": standing.tasks[task],
        "speed": max(demand.speed, default=0.0),
        "torque": max(demand.torque, default=0.0),
        "rows": {
            name: {column.key: cell(column.values(standing, task, name)) for column in (*TRAINING, *KNOWLEDGE)}
            for name in standing.controllers
            if standing.of(task, name)
        },
        "lost": {
            name: sum(not row.completed for row in standing.of(task, name))
            for name in standing.controllers
            if standing.of(task, name)
        },
    }


def cell(values: list[float]) -> Cell:
    """Smallest, median, largest; "inf" for what is not finite, None where a number is missing."""
    if not values or any(map(math.isnan, values)):
        return None
    ordered = sorted(values)
    return [value if math.isfinite(value) else "inf" for value in (ordered[0], median(ordered), ordered[-1])]


def findings(standing: Standing, task: str) -> dict[str, list[str]]:
    """What every controller said at the end of a task, on the first seed."""
    if not task:
        return {}
    return {name: list(rows[0].findings) for name in standing.controllers if (rows := standing.of(task, name))}
