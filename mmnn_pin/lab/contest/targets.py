"""What the contest asks of the learners, and what was reached: medians over the seeds, met or not met."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

from ..experiments.contest import Contest
from .row import Row, middle, nan

THESIS, ORACLE = "two_layer", "computed_torque"
TOLD = {
    "kinematics": "told the kinematics, not masses and friction",
    "form": "told the form of the equations",
    "nothing": "told nothing but the error",
    "nominal": "told a model with wrong masses",
}
Rows = Callable[[str, str], list[Row]]


@dataclass(frozen=True)
class Target:
    """One target.

    Attributes:
        about: What is asked, in words.
        limit: The number that is asked for.
        reached: The number that was reached; None where nobody could be judged.
        by: Who reached it.
        met: Whether that is enough.
    """

    about: str
    limit: float
    reached: float | None
    by: str
    met: bool

    def to_dict(self) -> dict[str, Any]:
        """The target for JSON."""
        return asdict(self)


def targets(contest: Contest, learners: tuple[str, ...], tasks: Iterable[str], of: Rows) -> list[Target]:
    """All targets.

    Args:
        contest: What is asked.
        learners: Who learns.
        tasks: Names of all tasks.
        of: Rows of a controller on a task.
    """
    asked, found = contest.targets, list[Target]()
    if not asked.task:
        return found
    for told, limit in asked.frozen_fvu.items():
        names = [name for name in learners if contest.told(name) == told]
        found += [lowest_fvu(names, task, TOLD[told], limit, of) for task in (asked.task, asked.rich) if task]
    for law, about in ((asked.printed, "as printed"), (asked.task, "tuned as the others")):
        for how in ("learning", "frozen") if law else ():
            thesis = held_out(of(law, THESIS), how)
            found.append(better(learners, asked.task, thesis, f"{about}, {how}", asked.better, of, how))
    knowing = [name for name in learners if contest.told(name) == "kinematics"]
    found += [near(knowing, asked.task, how, asked.near, of) for how in ("learning", "frozen")]
    if asked.poor:
        found += [bounded(learners, asked.poor, of), unexcited(learners, asked.poor, of)]
    judged = [task for task in (asked.task, asked.rich, asked.poor) if task]
    return [
        *found,
        kick(learners, judged, ", ".join(judged), asked.kick, of),
        kick(learners, tasks, "any task", asked.kick, of),
    ]


def lowest_fvu(names: Iterable[str], task: str, words: str, limit: float, of: Rows) -> Target:
    """Lowest frozen FVU of some learners."""
    values = {name: middle([nan(row.frozen_fvu) for row in of(task, name)]) for name in names}
    return smallest(f"frozen FVU after '{task}', {words}", limit, values)


def better(
    names: Iterable[str], task: str, thesis: dict[str, float], words: str, limit: float, of: Rows, how: str
) -> Target:
    """Best learner against the thesis's errors, on every axis of every held-out trajectory."""
    values = {name: least_ratio(thesis, held_out(of(task, name), how)) for name in names if name != THESIS}
    judged = {name: value for name, value in values.items() if math.isfinite(value)}
    best = max(judged, key=judged.__getitem__, default="")
    about = f"{THESIS}'s error over that of the best learner, {words}, held out, worst axis: at least {limit:g}"
    return Target(about, limit, judged.get(best), best, bool(best) and judged[best] >= limit)


def near(names: Iterable[str], task: str, how: str, limit: float, of: Rows) -> Target:
    """Best learner that knows the kinematics against the oracle on every axis of every held-out trajectory."""
    oracle = held_out(of(task, ORACLE), "learning")
    least = {name: least_ratio(oracle, held_out(of(task, name), how)) for name in names}
    values = {name: 1 / value for name, value in least.items() if value > 0}
    return smallest(f"{TOLD['kinematics']}: error over {ORACLE}'s, {how}, held out, worst axis", limit, values)


def bounded(names: Iterable[str], task: str, of: Rows) -> Target:
    """Learners that reach the end of the poor motion, and of the held-out ones after it."""
    rows = {name: found for name in names if (found := of(task, name))}
    good = [name for name, found in rows.items() if all(map(survived, found))]
    return everyone(f"after '{task}', in training and held out, bounded", good, rows)


def unexcited(names: Iterable[str], task: str, of: Rows) -> Target:
    """Learners that say that the poor motion did not excite them."""
    rows = {name: found for name in names if (found := of(task, name))}
    good = [name for name, found in rows.items() if all(says_not_excited(row) for row in found)]
    return everyone(f"after '{task}' say that they were not excited", good, rows)


def kick(names: Iterable[str], tasks: Iterable[str], where: str, limit: float, of: Rows) -> Target:
    """Largest torque of the start on some tasks, over the limits of the motors."""
    values = {f"{name} on {task}": nan(row.kick) for task in tasks for name in names for row in of(task, name)}
    worst = max(values, key=values.__getitem__, default="")
    about = f"largest torque of the start over the motors' limits, any learner, on {where}: at most {limit:g}"
    return Target(about, limit, values.get(worst), worst, bool(values) and values[worst] <= limit)


def smallest(about: str, limit: float, values: dict[str, float]) -> Target:
    """Target that the smallest number has to meet."""
    judged = {name: value for name, value in values.items() if math.isfinite(value)}
    best = min(judged, key=judged.__getitem__, default="")
    return Target(f"{about}: at most {limit:g}", limit, judged.get(best), best, bool(best) and judged[best] <= limit)


def everyone(about: str, good: list[str], rows: dict[str, list[Row]]) -> Target:
    """Target that all learners have to meet; the number is their share."""
    missing = [name for name in rows if name not in good]
    if not rows:
        return Target(about, 1.0, None, "", False)
    by = f"all but {', '.join(missing)}" if missing and good else "nobody" if missing else "all"
    return Target(about, 1.0, len(good) / len(rows), by, not missing)


def survived(row: Row) -> bool:
    """Whether training and all held-out runs reached their end."""
    return row.completed and all(one.outcome == "completed" for ways in row.held_out.values() for one in ways.values())


def says_not_excited(row: Row) -> bool:
    """Whether a finding says so."""
    return any("not excited" in text for text in row.findings)


def held_out(rows: list[Row], how: str) -> dict[str, float]:
    """Median RMS error per held-out trajectory and axis; inf where a run was lost, empty without runs."""
    found: dict[str, list[float]] = {}
    for row in rows:
        for name, ways in row.held_out.items():
            for axis, value in ways[how].rms.items() if how in ways else ():
                found.setdefault(f"{name}.{axis}", []).append(math.inf if value is None else value)
    return {key: median(values) for key, values in found.items()}


def least_ratio(above: dict[str, float], below: dict[str, float]) -> float:
    """Least ratio over the axes, 0 where the run below was lost; nan where they are not the same."""
    if not above or above.keys() != below.keys() or not all(value > 0 for value in below.values()):
        return math.nan
    ratios = [above[key] / below[key] if math.isfinite(below[key]) else 0.0 for key in above]
    return min(ratios)
