"""All controllers on many rigs: the largest and the RMS error of each, and of PD at each learner's own gain.

Also the same rig again and again, and with one of its numbers moved at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace as with_settings

from mmnn_pin import PD
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.model.robot import Robot
from mmnn_pin.signals import Array
from mmnn_pin.torque.controller import CompiledController, TorqueController
from mmnn_pin.torque.model_based import ScheduledPD
from research.studies.rollouts import Rollout, roll_out

from .rigs import DEGREES, THESIS_PERIOD, Values, chapter5, draw, loop_of, per_second, robot_of, with_rig

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


def controller(experiment: Experiment, name: str) -> CompiledController | TorqueController:
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
            "same_winner": float(np.mean([one == other for one, other in zip(*better, strict=True)])),
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


OFFSET = np.radians(0.1)  # largest difference of the start from the reference between two repeats [rad]


# Numbers that are moved, from the calibrated rig: factors for friction and resolution, values for the others.
MOVED: dict[str, tuple[str, tuple[float, ...]]] = {
    "friction": ("dry friction, times the calibrated", (0.1, 0.3, 0.6, 1.0, 1.4)),
    "gap": ("backlash [mrad]", (0.0, 0.002, 0.005, 0.01, 0.02)),
    "resolution": ("step of the encoders [mrad]", (1e-4, 3e-4, 1e-3, 2e-3, 5e-3)),
    "rate": ("sample rate [Hz]", (125.0, 200.0, 400.0, 1000.0)),
}


SCALE = {"gap": 1e3, "resolution": 1e3}  # for the figure


def moved(values: Values, name: str, value: float) -> dict[str, Any]:
    """The calibrated numbers with one of them moved."""
    v = dict(values)
    if name == "friction":
        return v | {f"coulomb_{j}": value * v[f"coulomb_{j}"] for j in (1, 2)}
    return v | ({"period": 1.0 / value} if name == "rate" else {name: value})


def repeats(values: Values, count: int, stream: int) -> list[Row]:
    """Runs that differ in nothing but a start up to 0.1 deg beside the reference and the draw of random weights."""
    experiments = []
    for i in range(count):
        rng = np.random.default_rng([stream, i])
        again = {"offset": tuple(rng.uniform(-OFFSET, OFFSET, 2).tolist()), "seed": int(rng.integers(2**31))}
        experiments.append(with_rig(chapter5(), {**values, **again}))
    return compare([(e, robot_of(e)) for e in experiments], gains=False)


def column(rows: Sequence[Mapping[str, Any]], name: str, measure: str) -> Array:
    """Errors of a controller [deg], inf where it was lost."""
    return np.array([float(row[f"{name}.{measure}"]) for row in rows])


def spread(values: Array) -> dict[str, Any]:
    """Median and the middle 90 %; None for infinity."""
    found = [float(np.quantile(values, q, method="inverted_cdf")) for q in (0.5, 0.05, 0.95)]
    median, low, high = (x if np.isfinite(x) else None for x in found)
    return {"median": median, "middle_90": [low, high]}


def told(rows: Sequence[Row]) -> dict[str, Any]:
    """Spread of every controller's errors and of their ratios to one_layer, over the repeats of a rig."""
    found: dict[str, Any] = {"repeats": len(rows), "errors": {}, "ratios": {}}
    for measure in MEASURES:
        one = column(rows, "one_layer", measure)
        found["errors"][measure] = {name: spread(column(rows, name, measure)) for name in NAMES}
        with np.errstate(all="ignore"):
            ratios = {name: column(rows, name, measure) / one for name in NAMES if name != "one_layer"}
        found["ratios"][measure] = {
            name: {**spread(np.nan_to_num(x, nan=np.inf)), "below_1": float(np.mean(x < 1))}
            for name, x in ratios.items()
        }
    return found


def repeatability(rigs: Sequence[Values], count: int, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """The calibrated rigs, each repeated."""
    found = [told(repeats(values, count, 51)) for values in rigs]
    say(f"{len(rigs)} rigs, {count} runs of each")
    return found


def sweep(values: Values, count: int, say: Callable[[str], None]) -> dict[str, list[dict[str, Any]]]:
    """Every number of `MOVED` alone, from the calibrated rig, with repeats at each of its values."""
    found = {
        name: [{"value": value, **told(repeats(moved(values, name, value), count, 52))} for value in tried]
        for name, (_, tried) in MOVED.items()
    }
    say("one number at a time")
    return found
