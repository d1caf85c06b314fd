"""All controllers on many rigs: the largest and the RMS error of each, and of PD at each learner's own gain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace as with_settings

from mmnn_pin import PD, ScheduledPD
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.model.robot import Robot
from mmnn_pin.torque.controller import CompiledController

from ..chapter4.rollouts import Rollout, roll_out
from .rigs import DEGREES, THESIS_PERIOD, draw, loop_of, per_second

Row = dict[str, Any]
Place = tuple[Experiment, Robot]
LEARNERS = ("one_layer", "two_layer_zero", "two_layer_random")
NAMES = ("pd", *LEARNERS, "integral")  # the last: all that is left of the network, saturated
KEPT = ("q", "e", "true_e", "effective_gain")
AMPLITUDE = 30.0  # of the reference [deg]
SETTLED = 2.0  # from when on an error counts for the RMS [s]
MEASURES = ("largest", "rms")
CONDITIONS = ("per sample", "per second")


def errors(run: Rollout, period: float) -> dict[str, float]:
    """Errors of a run [deg]; inf for one that was lost.

    `largest` is the geometric mean over the joints of the largest measured error of the whole run, the statistic of the
    thesis; `rms` the RMS of the true errors of both joints from 2 s on.
    """
    if not run.completed:
        return dict.fromkeys(MEASURES, float("inf"))
    late = DEGREES * run.signals["true_e"][round(SETTLED / period) :]
    peaks = DEGREES * np.abs(run.signals["e"]).max(axis=0)
    return {"largest": float(np.exp(np.mean(np.log(peaks)))), "rms": float(np.sqrt(np.mean(late**2)))}


def beyond(run: Rollout) -> bool:
    """Whether both joints, as measured, went beyond 30 deg on both sides, as figures 5.3 and 5.4 say."""
    q = DEGREES * run.signals["q"]
    return bool((q.max(axis=0) > AMPLITUDE).all() and (q.min(axis=0) < -AMPLITUDE).all())


def run_all(places: Sequence[Place], name: str) -> list[Rollout]:
    """Runs of one controller on all of these rigs."""
    return roll_out([loop_of(e, robot, controller(e, name)) for e, robot in places], KEPT)


def controller(experiment: Experiment, name: str) -> CompiledController:
    """A controller of the experiment, or `integral`.

    With G = 0 and weights from zero every hidden unit gives 1/2, whatever the input is. Four times the rate and a
    quarter of the leakage make that what the network is with every unit saturated at 1: per unit F times the sum of the
    error, which leaks as the weights do.
    """
    if name != "integral":
        return experiment.controller(name)
    two = experiment.two_layer
    deaf = with_settings(two, G=(0.0, 0.0), F=tuple(4.0 * rate for rate in two.F), kappa=two.kappa / 4.0)
    return with_settings(experiment, two_layer=deaf).controller("two_layer_zero")


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
            row[f"{name}.beyond"] = run.completed and beyond(run)

    for name in NAMES:
        runs = run_all(places, name)
        note(name, runs)
        if gains and name in LEARNERS:
            note(f"gain_of_{name}", at_gain(places, runs))
    return rows


def accuracy(rigs: int) -> dict[str, Any]:
    """What the plant's step does: the first rigs again with half of it.

    Returns:
        Per measure the share of rigs with the same better network, and the median change of each controller's error.
    """
    coarse = compare([(draw(i).experiment, draw(i).robot) for i in range(rigs)], gains=False)
    fine = compare([(finer(draw(i).experiment), draw(i).robot) for i in range(rigs)], gains=False)
    found: dict[str, Any] = {"rigs": rigs}
    for measure in MEASURES:
        better = [
            [row[f"two_layer_zero.{measure}"] < row[f"one_layer.{measure}"] for row in rows] for rows in (coarse, fine)
        ]
        changes = {
            name: [
                abs(a[f"{name}.{measure}"] / b[f"{name}.{measure}"] - 1)
                for a, b in zip(coarse, fine, strict=True)
                if not (a[f"{name}.lost"] or b[f"{name}.lost"])
            ]
            for name in NAMES
        }
        found[measure] = {
            "same_winner": float(np.mean(np.equal(*better))),
            "change": {name: float(np.median(values)) if values else None for name, values in changes.items()},
        }
    return found


def finer(experiment: Experiment) -> Experiment:
    """The same with half the plant's step."""
    return with_settings(experiment, time=with_settings(experiment.time, plant_step=0.5 * experiment.time.plant_step))


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
