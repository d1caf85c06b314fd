"""The columns of a contest's tables: what each one shows of a controller on a task, one number per seed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ...contest.result import Number, Tracking, TrialResult, arm_of, base_of, nan
from ...contest.standing import Standing

Values = Callable[[Standing, str, str], list[float]]


@dataclass(frozen=True)
class Column:
    """A column.

    Attributes:
        key: Its name in files.
        heading: In tables.
        values: Standing, task and controller to a number per seed; inf and nan have their own words.
        infinite: Word for inf.
        limit: Above this it is marked.
    """

    key: str
    heading: str
    values: Values
    infinite: str = "-"
    limit: float = math.inf


def per_row(number: Callable[[TrialResult], float]) -> Values:
    """Values of a column that is read off single rows."""
    return lambda standing, task, controller: [number(row) for row in standing.of(task, controller)]


def held_out(how: str, of_axes: Callable[[dict[str, Number]], float]) -> Values:
    """Values of a column of errors on the held-out trajectories, in thousandths."""
    return per_row(lambda row: 1e3 * over_all(row, how, of_axes))


def over_all(row: TrialResult, how: str, of_axes: Callable[[dict[str, Number]], float]) -> float:
    """Root of the mean square error over all held-out trajectories; inf where one was lost, nan where none was run."""
    found: list[Tracking] = [ways[how] for ways in row.held_out.values() if how in ways]
    if not found:
        return math.nan
    if any(one.outcome != "completed" for one in found):
        return math.inf
    return math.sqrt(sum(of_axes(one.rms) ** 2 for one in found) / len(found))


def learning_times(standing: Standing, task: str, controller: str) -> list[float]:
    """Values of the learning time."""
    return standing.learning_times(task, controller)


def steps(standing: Standing, task: str, controller: str) -> list[float]:
    """Time of the step over PD's; measured once, not per seed."""
    return [standing.step_ratio(task, controller)]


TRAINING: Sequence[Column] = (
    Column("base", "base\n[mm]", per_row(lambda row: 1e3 * base_of(row.rms))),
    Column("heading", "heading\n[mrad]", per_row(lambda row: 1e3 * nan(row.rms.get("phi")))),
    Column("arm", "arm\n[mrad]", per_row(lambda row: 1e3 * arm_of(row.rms))),
    Column("peak_base", "peak base\n[mm]", per_row(lambda row: 1e3 * base_of(row.peak))),
    Column("peak_arm", "peak arm\n[mrad]", per_row(lambda row: 1e3 * arm_of(row.peak))),
    Column("effort", "effort\n[N²m²s]", per_row(lambda row: nan(row.effort))),
    Column("torque", "torque\n[%]", per_row(lambda row: 100 * nan(row.torque)), limit=100.0),
    Column("kick", "kick\n[%]", per_row(lambda row: 100 * nan(row.kick)), limit=100.0),
    Column("learned", "learned\nin [s]", learning_times, "never"),
)
KNOWLEDGE: Sequence[Column] = (
    Column("online_fvu", "FVU\nonline", per_row(lambda row: nan(row.online_fvu))),
    Column("frozen_fvu", "FVU\nfrozen", per_row(lambda row: nan(row.frozen_fvu))),
    Column("held_base", "base held\nout [mm]", held_out("learning", base_of), "lost"),
    Column("held_arm", "arm held\nout [mrad]", held_out("learning", arm_of), "lost"),
    Column("frozen_base", "the same,\nfrozen", held_out("frozen", base_of), "lost"),
    Column("frozen_arm", "the same,\nfrozen", held_out("frozen", arm_of), "lost"),
    Column("step", "step\n/ pd", steps),
)
