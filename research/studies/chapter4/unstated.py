"""The calibration's model of chapter 4: which numbers it may choose, and what the figures then show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from msgspec.structs import replace as with_settings

from mmnn_pin import Loop, Robot, load_experiment
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.lab.experiments.thesis import figure_intervals
from mmnn_pin.signals import Array
from research.studies.rollouts import Rollout, roll_out, with_mount
from research.studies.search import Number

Values = Mapping[str, float]


LEARNERS = ("two_layer", "one_layer")


SIGNALS = ("pose_error", "z", "e")


WORST = 1e3  # distance of a run that diverged, in widths of an interval


SHARED = (
    Number("K", 3, 15, "1/s"),
    Number("friction_v", 5, 200, "N s/m", log=True),
    Number("friction_w", 1, 40, "N m s", log=True),
    Number("friction_arm", 0.1, 4, "N m s", log=True),
    Number("behind", 0.002, 0.02, "m"),
)


MOUNT, AS_DRAWN = Number("mount", 0.0, 0.3, "m"), 0.12  # the URDF has it at 0.12 m


ROBUST = (
    Number("Kz1", 1, 200, "", log=True),
    Number("Kz2", 0.02, 5, "", log=True),
    Number("ZB", 0.2, 15, "", log=True),
)


V_RANGE, WIDTH = Number("v_range", 0.05, 2, ""), Number("width", 1, 12, "", log=True)


@dataclass(frozen=True)
class Case:
    """A reading of the thesis whose unstated numbers are searched."""

    name: str  # key
    title: str  # for tables
    hidden: int  # hidden units of each network
    separate: bool  # whether every learner has robust gains of its own

    @property
    def numbers(self) -> tuple[Number, ...]:
        """What is searched."""
        names = LEARNERS if self.separate else ("both",)
        robust = tuple(replace(number, name=f"{who}.{number.name}") for who in names for number in ROBUST)
        return (*SHARED, *robust, V_RANGE, WIDTH)


CASES = (
    Case("separate_22", "separate robust gains, 22 units per network", 22, True),
    Case("separate_44", "separate robust gains, 44 units per network", 44, True),
    Case("equal_22", "equal robust gains, 22 units per network", 22, False),
)


@cache
def chapter4(control_period: float) -> Experiment:
    """Chapter 4 at a sample time [s], one plant step per sample.

    A fourth-order step of 2 ms gives the errors of one of 1 ms to six digits; a first-order one would not.
    """
    times = f"time.control_period={control_period}", f"time.plant_step={control_period}", "time.integrator=rk4"
    return load_experiment("chapter4", [*times, "weights_interval=5.0"])


@cache
def robot_of(mount: float) -> Robot:
    """The thesis's robot with its arm at a place along the platform's x axis [m]."""
    return with_mount(chapter4(0.002).load_robot(), mount)


def loops(case: Case, values: Values, control_period: float = 0.002, seed: int = 1) -> dict[str, Loop]:
    """The two learners' loops with these numbers."""
    experiment, found = chapter4(control_period), {}
    friction = [values[f"friction_{name}"] for name in ("v", "w", "arm", "arm")]
    robot = robot_of(values.get(MOUNT.name, AS_DRAWN)).with_friction(friction)
    for learner in LEARNERS:
        who = learner if case.separate else "both"
        Kz1, Kz2, ZB = (values[f"{who}.{name}"] for name in ("Kz1", "Kz2", "ZB"))
        settings = with_settings(
            experiment,
            seed=seed,
            kinematic=with_settings(experiment.kinematic, K=values["K"]),
            robust=with_settings(experiment.robust, base=Kz1, arm=Kz2, ZB=(ZB, ZB)),
            two_layer=with_settings(experiment.two_layer, hidden=case.hidden, v_range=values["v_range"]),
            one_layer=with_settings(experiment.one_layer, hidden=case.hidden, width=values["width"]),
            start=with_settings(experiment.start, pose_offset=(-values["behind"], 0.0, 0.0)),
        )
        found[learner] = settings.loop(robot, settings.controller(learner))
    return found


def extremes(pairs: Sequence[Mapping[str, Loop]]) -> Array:
    """The twelve extremes of figures 4.2 to 4.4 for every pair of learners, (pairs, 12); nan where one diverged."""
    done = iter(roll_out([pair[learner] for pair in pairs for learner in LEARNERS], SIGNALS))
    return np.array([extremes_of({learner: next(done) for learner in LEARNERS}) for _ in pairs])


def extremes_of(runs: Mapping[str, Rollout]) -> list[float]:
    """The twelve extremes of one pair of runs."""
    if not all(run.completed for run in runs.values()):
        return [np.nan] * len(figure_intervals())
    signals = {learner: run.signals for learner, run in runs.items()}
    return [float(interval.extreme(signals) or 0.0) for interval in figure_intervals()]


def distances(found: Array) -> Array:
    """How far extremes lie outside their intervals, in widths of the interval; 0 inside."""
    lower = np.array([interval.lower for interval in figure_intervals()])
    upper = np.array([interval.upper for interval in figure_intervals()])
    away = np.maximum(np.maximum(lower - found, found - upper), 0.0) / (upper - lower)
    return np.where(np.isfinite(found), np.minimum(away, WORST), WORST)


def met(found: Array) -> Array:
    """How many of the twelve intervals are met, along the last axis."""
    return np.sum(distances(found) == 0, axis=-1)


def cost_of(found: Array) -> Array:
    """What the search makes small, (n,) for extremes (n, 12).

    The number of intervals missed, plus `d / (1 + d)` for each of them, d its distance in widths; among equals the
    extremes nearest to the middle of their intervals win, so that the result does not sit on an edge.
    """
    lower = np.array([interval.lower for interval in figure_intervals()])
    upper = np.array([interval.upper for interval in figure_intervals()])
    away = distances(found)
    off_middle = np.minimum(np.abs(np.nan_to_num(found, nan=np.inf) - (lower + upper) / 2) / (upper - lower), 1.0)
    return np.sum((away > 0) + away / (1 + away), axis=-1) + 0.1 * np.mean(off_middle, axis=-1)
