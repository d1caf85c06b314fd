"""All controllers on many rigs: the largest and the RMS error of each, and of PD at each learner's own gain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mmnn_pin import PD, ScheduledPD
from mmnn_pin.experiments.experiment import Experiment
from mmnn_pin.model.robot import Robot

from ..chapter4.rollouts import Rollout, roll_out
from .rigs import DEGREES, THESIS_PERIOD, draw, loop_of, per_second

Row = dict[str, Any]
Place = tuple[Experiment, Robot]
LEARNERS = ("one_layer", "two_layer_zero", "two_layer_random")
NAMES = ("pd", *LEARNERS)
KEPT = ("e", "true_e", "effective_gain")
SETTLED = 2.0  # from when on an error counts for the RMS [s]
MEASURES = ("largest", "rms")
CONDITIONS = ("per sample", "per second")


def errors(run: Rollout, period: float) -> dict[str, float]:
    """Errors of a run [deg]; inf for one that was lost.

    `largest` is the geometric mean over the joints of the largest measured error of the whole run, the thesis's statistic;
    `rms` the RMS of the true errors of both joints from 2 s on.
    """
    if not run.completed:
        return dict.fromkeys(MEASURES, float("inf"))
    late = DEGREES * run.signals["true_e"][round(SETTLED / period) :]
    peaks = DEGREES * np.abs(run.signals["e"]).max(axis=0)
    return {"largest": float(np.exp(np.mean(np.log(peaks)))), "rms": float(np.sqrt(np.mean(late**2)))}


def run_all(places: Sequence[Place], name: str) -> list[Rollout]:
    """Runs of one controller on all of these rigs."""
    return roll_out([loop_of(e, robot, e.controller(name)) for e, robot in places], KEPT)


def at_gain(places: Sequence[Place], runs: Sequence[Rollout]) -> list[Rollout]:
    """PD at the effective gain that each learner's run had: its gain without its network."""
    loops = []
    for (e, robot), run in zip(places, runs, strict=True):
        gains = run.signals["effective_gain"]
        controller = ScheduledPD(gains) if run.completed else PD(e.feedback)
        loops.append(loop_of(e, robot, controller))
    return roll_out(loops, KEPT)


def compare(places: Sequence[Place], gains: bool = True) -> list[Row]:
    """A row per rig: every controller's errors and whether it was lost; with `gains` also PD at the learners' gains."""
    rows: list[Row] = [{} for _ in places]

    def note(name: str, runs: Sequence[Rollout]) -> None:
        for row, run, (e, _) in zip(rows, runs, places, strict=True):
            row |= {f"{name}.{key}": value for key, value in errors(run, e.time.control_period).items()}
            row[f"{name}.lost"] = not run.completed

    for name in NAMES:
        runs = run_all(places, name)
        note(name, runs)
        if gains and name in LEARNERS:
            note(f"gain_of_{name}", at_gain(places, runs))
    return rows


def ranking(rigs: int, chunk: int, say: Callable[[str], None]) -> list[Row]:
    """Rows of all rigs, under both conditions; at 200 Hz the two are the same runs."""
    rows: list[Row] = []
    for first in range(0, rigs, chunk):
        drawn = [draw(i) for i in range(first, min(rigs, first + chunk))]
        printed = compare([(rig.experiment, rig.robot) for rig in drawn])
        others = [rig for rig in drawn if rig.values["period"] != THESIS_PERIOD]
        scaled = iter(compare([(per_second(rig.experiment), rig.robot) for rig in others]))
        for rig, row in zip(drawn, printed, strict=True):
            about = {"rig": rig.number, **rig.values}
            rows.append({**about, "condition": CONDITIONS[0], **row})
            rows.append({**about, "condition": CONDITIONS[1], **(next(scaled) if rig in others else row)})
        say(f"{min(rigs, first + chunk)} of {rigs} rigs")
    return rows
