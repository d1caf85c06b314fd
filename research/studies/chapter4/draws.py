"""Draws of everything that the thesis does not state, the motions, and the errors of runs on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from msgspec.structs import replace as with_settings

from mmnn_pin import Circle, Eight, Hold, Line, Loop, Robot, Sine, Trajectory, load
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.torque.controller import CompiledController, TorqueController
from research.studies.rollouts import Rollout, roll_out, with_centre_of_mass, with_mount

from .choices import Choice, with_choice
from .unstated import chapter4

ARM = (Sine(amplitude=np.pi / 4, period=4.0), Hold(np.pi / 4))  # the thesis's


LINE = Line(speed=0.3)


REFERENCES: dict[str, tuple[str, Trajectory]] = {
    "line": ("the thesis's line, joint 1 swinging", Trajectory(LINE, ARM)),
    "circle": ("a circle of 0.8 m at 0.3 m/s, the same arm motion", Trajectory(Circle(radius=0.8, speed=0.3), ARM)),
    "eight": (
        "an eight of 1.6 m by 0.8 m in 14 s, the same arm motion",
        Trajectory(Eight(length=1.6, width=0.8, period=14.0), ARM),
    ),
    "fast arm": (
        "the thesis's line, both joints swinging with 2 s and 1.5 s",
        Trajectory(LINE, (Sine(np.pi / 4, 2.0), Sine(np.pi / 6, 1.5, np.pi / 4))),
    ),
}


BODIES = ("root", "arm_1_joint", "arm_2_joint")


MASSES = "mass factor of platform, link 1, link 2"


# What is drawn: from where to where, uniformly or (log) uniformly in the logarithm. K, Kz1, Kz2 and ZB are the same for
# both networks of a draw, and so is everything else that both have. What the thesis prints is not drawn.
RANGES: dict[str, tuple[float, float, str, str]] = {
    MASSES: (0.7, 1.4, "", "log"),
    "mount": (0.0, 0.3, "m", ""),
    "platform's centre of mass": (-0.1, 0.1, "m", ""),
    "friction_v": (3.0, 100.0, "N s/m", "log"),
    "friction_w": (0.5, 25.0, "N m s", "log"),
    "friction_arm": (0.05, 2.0, "N m s", "log"),
    "K": (3.0, 12.0, "1/s", ""),
    "Kz1": (0.5, 50.0, "", "log"),
    "Kz2": (0.02, 1.0, "", "log"),
    "ZB": (0.3, 10.0, "", "log"),
    "width": (1.0, 12.0, "", "log"),
    "v_range": (0.05, 1.5, "", ""),
    "start behind": (0.0, 0.02, "m", ""),
    "start aside": (-0.005, 0.005, "m", ""),
}


PERIODS = (0.001, 0.002, 0.0025, 0.004)  # sample times, equally likely [s]


@dataclass(frozen=True, eq=False)
class Draw:
    """One draw."""

    seed: int  # seed of the initial weights and of random centres
    numbers: Mapping[str, Any]  # name of `RANGES` to its value; three factors for the masses
    period: float  # sample time [s]
    centres: str  # "diagonal" or "random"
    initial: str  # "random" or "zero" (section 5.2 of the thesis)

    @property
    def facts(self) -> dict[str, Any]:
        """What was drawn, flat."""
        numbers = {name: value for name, value in self.numbers.items() if not isinstance(value, list)}
        factors = self.numbers[MASSES]
        masses = {f"mass factor {name}": factor for name, factor in zip(BODIES, factors, strict=True)}
        rest = {"period": self.period, "centres": self.centres, "initial": self.initial, "seed": self.seed}
        return {**numbers, **masses, **rest}

    @cached_property
    def robot(self) -> Robot:
        """The robot of this draw."""
        x = self.numbers
        masses = dict(zip(BODIES, x[MASSES], strict=True))
        friction = [x[f"friction_{name}"] for name in ("v", "w", "arm", "arm")]
        robot = with_mount(thesis_robot().with_masses(masses), x["mount"]).with_friction(friction)
        return with_centre_of_mass(robot, x["platform's centre of mass"])

    def experiment(self, finer: int = 1) -> Experiment:
        """Chapter 4 with the numbers of this draw, the rates of the thesis, and so many plant steps per sample."""
        x, base = self.numbers, chapter4(self.period)
        return with_settings(
            base,
            seed=self.seed,
            time=with_settings(base.time, plant_step=self.period / finer),
            kinematic=with_settings(base.kinematic, K=x["K"]),
            robust=with_settings(base.robust, base=x["Kz1"], arm=x["Kz2"], ZB=(x["ZB"], x["ZB"])),
            two_layer=with_settings(base.two_layer, v_range=x["v_range"], initial=self.initial),
            one_layer=with_settings(base.one_layer, width=x["width"], centres=self.centres),
            start=with_settings(base.start, pose_offset=(-x["start behind"], x["start aside"], 0.0)),
        )


@cache
def thesis_robot() -> Robot:
    """The thesis's robot."""
    return load("platform_arm")


def draw(stream: int, i: int) -> Draw:
    """Draw i of a stream; streams and draws are independent, whatever their number."""
    rng = np.random.default_rng([stream, i])
    numbers: dict[str, Any] = {}
    for name, (low, high, _, how) in RANGES.items():
        size = len(BODIES) if name == MASSES else None
        found = np.exp(rng.uniform(np.log(low), np.log(high), size)) if how == "log" else rng.uniform(low, high, size)
        numbers[name] = found.tolist() if size else float(found)
    period, centres = float(rng.choice(PERIODS)), str(rng.choice(["diagonal", "random"]))
    return Draw(
        int(rng.integers(2**31)), numbers, period, centres, str(rng.choice(["random", "random", "random", "zero"]))
    )


def motion(i: int) -> str:
    """The motion of draw i; all come equally often."""
    return list(REFERENCES)[i % len(REFERENCES)]


def loop(
    experiment: Experiment, robot: Robot, reference: str, controller: CompiledController | TorqueController
) -> Loop:
    """The closed loop of a draw along a reference. The gains are not judged beforehand: divergence counts."""
    return Loop(
        robot=robot,
        trajectory=REFERENCES[reference][1],
        controller=controller,
        kinematic=experiment.kinematic,
        timing=experiment.time,
        start=experiment.start,
        seed=experiment.seed,
        weights_interval=experiment.time.duration,
        check_gains=False,
    )


KEPT = ("pose_error", "e", "effective_gain")


WINDOWS = {"whole": 0.0, "tracking": 1.0}  # from when on an error counts [s]


PARTS = ("base", "arm")


Wanted = tuple[Draw, str, str, Choice | None]  # a draw, its motion, a controller, what was chosen of it


def run_all(wanted: Sequence[Wanted], finer: int = 1) -> list[Rollout]:
    """Runs of `pd` or a learner, so many plant steps per control sample."""
    loops = []
    for d, reference, name, chosen in wanted:
        experiment = with_choice(d.experiment(finer), name, chosen)
        loops.append(loop(experiment, d.robot, reference, experiment.controller(name)))
    return roll_out(loops, KEPT)


def error(run: Rollout, part: str, start: float, period: float) -> float:
    """RMS distance of base [m] or arm [rad] from the reference, from a time on; inf for a run that was lost."""
    if not run.completed:
        return float("inf")
    table = run.signals["pose_error"][:, :2] if part == "base" else run.signals["e"]
    return float(np.sqrt(np.mean(np.sum(table[round(start / period) :] ** 2, axis=1))))


def errors(run: Rollout, period: float) -> dict[str, float]:
    """All errors of a run."""
    return {f"{part}.{name}": error(run, part, start, period) for part in PARTS for name, start in WINDOWS.items()}
