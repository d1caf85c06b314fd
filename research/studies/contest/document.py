"""The contest's page and CSV file: smallest, median and largest numbers, and the text that shows them."""

from __future__ import annotations

import math
from pathlib import Path
from statistics import median
from typing import Any

from mmnn_pin.lab.show.table import number
from research.contest.settings import PLAIN
from research.contest.show import KNOWLEDGE, TRAINING
from research.contest.standing import ORACLE, THESIS, Standing, distances, held_out
from research.contest.task import held_out_torque, tasks_of
from research.studies.contest_plant.drive import CHANGES
from research.studies.document import Document, environment, filled, kept

from .delay import DELAYS, LOST, errors_by_delay

HERE = Path(__file__).parent
SUMMARY = HERE / "summary.json"
PLANT = HERE.parent / "contest_plant" / "found.json"  # of `python -m research.studies.contest_plant --publish`
Cell = list[float | str | None] | None
FAR = (  # in the page's table of distances from the best; the CSV file has all
    *("two_layer", "adaptive", "adaptive_composite", "concurrent"),
    *("kalman_regressor", "kalman_friction", ORACLE),
)
DRAWN = ("eight", "rig", "tiago", "friction", "encoders", "drop")  # in the figures of the page


def render(summary: dict[str, Any]) -> str:
    """The document."""
    templates = environment(HERE)
    templates.filters |= {"cell": cell, "number": number, "percent": lambda value: f"{100 * value:.3g} %"}
    templates.filters |= {"middle": middle}
    templates.globals |= {"middle_axis": axis_at, "unexcited": unexcited, "far_shown": FAR}
    templates.globals |= {"lost_from": lost_from, "plain": PLAIN, "best_plain": best_plain, "changes": CHANGES}
    templates.globals |= {"first_on": first_on, "worse_than_pd": worse_than_pd, "passed_over": passed_over}
    return filled(templates, "contest.md.j2", summary | {"plant": kept(PLANT)})


def cell(values: list[Any] | None, infinite: str = "never") -> str:
    """Median, with half of the spread in percent from 20 % on."""
    if values is None:
        return "-"
    low, mid, high = values
    if mid == "inf":
        return infinite
    if high == "inf":
        return f"{number(mid)}, to {infinite}"
    spread = 50 * (high - low) / mid if mid > 0 else 0.0
    return number(mid) + (f" ±{spread:.0f} %" if spread >= 20 else "")


def middle(values: list[Any] | None) -> str:
    """The median alone; a number that is missing is one of a run that was lost."""
    if values is None:
        return "lost"
    return "never" if values[1] == "inf" else number(values[1])


def axis_at(ratios: dict[str, float], place: int) -> str:
    """The axis at a place in the order of its ratio."""
    return sorted(ratios, key=ratios.__getitem__)[place]


def best_plain(far: dict[str, dict[str, float | str]], task: str) -> float:
    """How far the best of PD, PD with gravity and PID is from the least error of a task."""
    return min(float(far[name][task]) for name in PLAIN if task in far.get(name, ()))


def first_on(far: dict[str, dict[str, float | str]], name: str) -> tuple[list[str], list[str]]:
    """The tasks of a controller: those where no other one is nearer to the best, and the rest."""
    found: tuple[list[str], list[str]] = [], []
    for task, value in far[name].items():
        least = min(float(other[task]) for other in far.values() if task in other)
        found[float(value) > least].append(task)
    return found


def worse_than_pd(tasks: dict[str, Any], learners: list[str]) -> dict[str, list[str]]:
    """Learner to the tasks where an error, in training or held out while learning, is above PD's by 5 %."""
    found: dict[str, list[str]] = {}
    for task, about in tasks.items():
        pd = about["rows"]["pd"]
        for name in (name for name in learners if name in about["rows"]):
            pairs = [(about["rows"][name][key], pd[key]) for key in ("base", "arm", "held_base", "held_arm")]
            if any(one and other and float(one[1]) > 1.05 * float(other[1]) for one, other in pairs):
                found.setdefault(name, []).append(task)
    return found


def passed_over(searches: dict[str, Any]) -> dict[str, list[str]]:
    """The searches of every learner whose best try did not hold in the second look."""
    found: dict[str, list[str]] = {}
    for tuning, learners in searches.items():
        for learner, one in learners.items():
            if one["score"] > one.get("best", one["score"]):
                found.setdefault(learner, []).append(tuning)
    return found


def lost_from(late: dict[str, Any]) -> dict[str, list[str]]:
    """The least delay that loses a controller, in ms, to those controllers; "none" for the rest, at the end."""
    words = (*(f"{1e3 * delay:.0f} ms" for delay in late["delays"]), "none")
    found: dict[str, list[str]] = {word: [] for word in words}
    for name, errors in late["errors"].items():
        lost = [delay for delay, one in zip(late["delays"], errors, strict=True) if one is None]
        found[f"{1e3 * lost[0]:.0f} ms" if lost else "none"].append(name)
    return {delay: names for delay, names in found.items() if names}


def unexcited(said: dict[str, list[str]]) -> int:
    """How many say that they were not excited."""
    return sum(any("not excited" in text for text in texts) for texts in said.values())


def rows(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """Every task and controller: the median of each quantity, its smallest and its largest."""
    return [
        {"task": task, "controller": name, "runs lost": about["lost"][name]}
        | {"over the best": short(summary.get("far", {}).get(name, {}).get(task, ""))}
        | {
            f"{quantity.key}{f' [{quantity.unit}]' if quantity.unit else ''}{suffix}": told(row[quantity.key], place)
            for quantity in (*TRAINING, *KNOWLEDGE)
            for suffix, place in (("", 1), (" smallest", 0), (" largest", 2))
        }
        for task, about in summary["tasks"].items()
        for name, row in about["rows"].items()
    ]


def told(values: Cell, place: int) -> str:
    """One number of a cell as `short`; empty where there is none."""
    return short(values[place] if values else "")


def short(value: Any) -> str:
    """A number with four digits; what is none as it is."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def summed(standing: Standing) -> dict[str, Any]:
    """Tasks with their tables, targets, findings."""
    held_out = {task.name: held_out_torque(task) for task in tasks_of(standing.experiment, ("pd",))}
    return {
        "tasks": {task: about(standing, task) | {"held_out": held_out[task]} for task in standing.tasks},
        "targets": [target.to_dict() for target in standing.targets()],
        "axes": best_axes(standing),
        "margins": margins(standing),
        "late": late_commands(standing),
        "far": far(standing),
        "drawn": [task for task in DRAWN if task in standing.tasks],
        "seeds": standing.contest.seeds,
        "learned": standing.contest.learned,
        "window": standing.contest.window,
        "start": standing.contest.start,
        "told": {name: standing.contest.knowledge_of(name) for name in standing.controllers},
        "poor": findings(standing, standing.contest.targets.poor),
    }


def best_axes(standing: Standing) -> dict[str, Any]:
    """The best learner, and the oracle, against the thesis's law on the ordinary task: the ratio of errors per axis."""
    task = standing.contest.targets.task
    best = next((one.by for one in standing.targets() if one.about.startswith(THESIS) and "learning" in one.about), "")
    thesis, other = (held_out(standing.of(task, name), "learning") for name in (THESIS, best))
    oracle = held_out(standing.of(task, ORACLE), "learning")
    ratios = [{axis: thesis[axis] / row[axis] for axis in thesis if row.get(axis)} for row in (other, oracle)]
    return {"by": best, "ratios": ratios[0], "oracle": ratios[1]}


def far(standing: Standing) -> dict[str, dict[str, float | str]]:
    """Controller to task to its largest error over the least, "inf" for a run that was lost; the oracle's is none."""
    names = [name for name in standing.controllers if name != ORACLE]
    found, _ = distances(names, standing.tasks, standing.of, (ORACLE,))
    return {
        name: {task: value if math.isfinite(value) else "inf" for task, value in row.items()}
        for name, row in found.items()
        if row
    }


def margins(standing: Standing) -> dict[str, float]:
    """Delay margin of every task's loop with the feedback inside Psi, beside the task's own latency [s]."""
    found = {}
    for task in tasks_of(standing.experiment, ("computed_torque",)):
        loop = task.training(task.controller("computed_torque"), task.seeds[0])
        found[task.name] = loop.delay_margin() - loop.latency.total
    return found


def late_commands(standing: Standing) -> dict[str, Any]:
    """What the controllers of the ordinary task bear of delay that nobody told them; see `delay`."""
    wanted = standing.contest.targets.task
    task = next(one for one in tasks_of(standing.experiment, ("pd",)) if one.name == wanted)
    return {"delays": DELAYS, "lost": LOST, "errors": errors_by_delay(task, standing.controllers)}


def about(standing: Standing, task: str) -> dict[str, Any]:
    """One task: what its reference asks, and a cell per controller and column."""
    demand = standing.demands[task]
    return {
        "title": standing.tasks[task],
        "speed": max(demand.speed, default=0.0),
        "torque": max(demand.torque, default=0.0),
        "rows": {
            name: {column.key: spread(column.values(standing, task, name)) for column in (*TRAINING, *KNOWLEDGE)}
            for name in standing.controllers
            if standing.of(task, name)
        },
        "lost": {
            name: sum(not row.completed for row in standing.of(task, name))
            for name in standing.controllers
            if standing.of(task, name)
        },
    }


def spread(values: list[float]) -> Cell:
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


DOCUMENT = Document("explanation/contest", SUMMARY, render, rows)
