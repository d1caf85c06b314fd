"""The held-out trajectory: other path, other speed, other arm motion, recorded once under computed torque.

A config may name one in `[held_out]`. Else it follows from the run's reference alone, so that all learners of an
experiment get the same one: the base drives an eight at 1.3 times the mean speed, turning at most 1.3 times as fast as
the run; every joint swings 1.3 times as fast, those that stood still, too, each with a phase of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from ...errors import ConfigError, RecordingError
from ...kinematic import Kinematic
from ...loop.before_run import Start
from ...loop.loop import Loop
from ...model.robot import Robot
from ...reference import BasePath, Eight, Holonomic, Sine, Trajectory
from ...settings import Timing
from ...signals import Array
from ...torque.controller import Feedback
from ...torque.model_based import ComputedTorque
from ..experiments.config import recorded_experiment
from ..experiments.experiment import Experiment
from .fvu import START
from .subject import Subject, finite_rows

FASTER = 1.3
ASPECT = 0.8  # width of the eight over its length
SHORTEST, USUAL, LONGEST = 5.0, 10.0, 20.0  # of a lap [s]
SPEED = 0.2  # [m/s] where the run's base stands still
SWING = 0.3  # [rad or m] of a joint that stood still and has no limits; else this share of half its range
MARGIN = 0.95  # of a joint's range
GOLDEN = 2.399963  # [rad]: phases that do not repeat


@dataclass(frozen=True)
class HeldOut:
    """A trajectory for judging, never for training.

    Attributes:
        trajectory: What the robot should do.
        duration: For how long [s].
        about: The same in words.
    """

    trajectory: Trajectory
    duration: float
    about: str


def held_out(subject: Subject) -> HeldOut:
    """The one that the run's config names, or the one that follows from its reference.

    Raises:
        InputError: The config cannot be read, or its trajectory does not suit the robot.
    """
    experiment = recorded_experiment(subject.recording)
    if experiment is not None:
        return next(iter(all_held_out(experiment, subject.robot).values()))
    return usual(subject.robot, subject.timing.control_period, subject.rows)


def all_held_out(experiment: Experiment, robot: Robot) -> dict[str, HeldOut]:
    """All that an experiment names, or the one that follows from its reference, by name.

    Raises:
        InputError: One does not suit the robot, or is over before errors count.
    """
    for name, given in experiment.held_out.items():
        if given.duration <= START:
            why, fix = f"the first {START:g} s do not count", "make it longer"
            raise ConfigError(f"{given.duration:g} s", why=why, fix=fix, key=f"held_out.{name}.duration")
    if not experiment.held_out:
        rows = whole_reference(experiment, robot)
        return {"usual": usual(robot, experiment.time.control_period, rows)}
    return {
        name: HeldOut(experiment.held_out_of(robot, name), given.duration, f"as [held_out.{name}] of its config says")
        for name, given in experiment.held_out.items()
    }


def whole_reference(experiment: Experiment, robot: Robot) -> Array:
    """The reference of a whole run as rows (N, width), also of one that ended early."""
    layout, timing = robot.layout, experiment.time
    rows = np.zeros((timing.samples, layout.width))
    where = slice(layout.where("pose_ref").start, layout.where("qddot_ref").stop)
    times = np.arange(timing.samples) * timing.control_period
    rows[:, where] = experiment.trajectory_of(robot).table(times, layout)
    return rows


def usual(robot: Robot, h: float, rows: Array) -> HeldOut:
    """The trajectory that follows from the reference in some rows, see the top of this module.

    Args:
        robot: The robot.
        h: Control period [s].
        rows: (N, width).
    """
    layout = robot.layout
    velocity, q, qdot = (rows[:, layout.where(name)] for name in ("velocity_ref", "q_ref", "qdot_ref"))
    base, lap = base_path(velocity)
    profiles, period = arm_profiles(robot, q, qdot)
    duration, words = float(np.clip(lap or 3 * period, SHORTEST, LONGEST)), []
    if base is not None:
        eight = base.path if isinstance(base, Holonomic) else base
        assert isinstance(eight, Eight)
        words.append(f"an eight of {eight.length:.2g} x {eight.width:.2g} m, {lap:.3g} s a lap")
    if profiles:
        words.append(f"every joint a sine, {FASTER:g} times as fast")
    return HeldOut(Trajectory(base, profiles), h * round(duration / h), "; ".join(words))


def base_path(velocity: Array) -> tuple[BasePath | None, float]:
    """An eight for a base that was asked for these velocities (N, nb), and its time of a lap [s]."""
    nb = velocity.shape[1]
    if not nb:
        return None, 0.0
    speed, turning = np.hypot(velocity[:, 0], velocity[:, 1] if nb == 3 else 0.0).mean(), np.abs(velocity[:, -1]).max()
    lap = Eight(1.0, ASPECT, 1.0).sample(np.linspace(0, 1, 1001)).velocity
    length, bend = np.abs(lap[:-1, 0]).mean(), np.abs(lap[:, 1]).max()
    period = float(np.clip(bend / (FASTER * turning), SHORTEST, 2 * LONGEST)) if turning > 1e-6 else USUAL
    size = FASTER * (speed if speed > 1e-3 else SPEED) * period / length
    eight = Eight(float(size), float(ASPECT * size), period)
    return (eight if nb == 2 else Holonomic(eight, Sine(0.5, period / 2))), period


def arm_profiles(robot: Robot, q: Array, qdot: Array) -> tuple[tuple[Sine, ...], float]:
    """A sine for every joint that was asked for q and qdot (N, n), and the longest of their periods [s]."""
    half, fastest = np.ptp(q, axis=0) / 2, np.abs(qdot).max(axis=0)
    moves = half > 1e-6
    rates = FASTER * np.where(moves, fastest, 0.0) / np.where(moves, half, 1.0)
    rates[~moves] = np.median(rates[moves]) if moves.any() else FASTER * 2 * np.pi / 4.0
    lower, upper = robot.lower[robot.arm_index], robot.upper[robot.arm_index]
    room = np.where(np.isfinite(upper - lower), (upper - lower) / 2, np.inf)
    swing = np.minimum(np.where(moves, half, SWING * np.minimum(room, 1.0)), MARGIN * room)
    middle = np.clip((q.max(axis=0) + q.min(axis=0)) / 2, lower + swing, upper - swing)
    numbers = zip(swing.tolist(), (2 * np.pi / rates).tolist(), middle.tolist(), strict=True)
    profiles = tuple(Sine(a, period, at, GOLDEN * i) for i, (a, period, at) in enumerate(numbers))
    return profiles, max((profile.period for profile in profiles), default=0.0)


def recorded_under_computed_torque(
    robot: Robot, wanted: HeldOut, feedback: Feedback, kinematic: Kinematic, timing: Timing
) -> Array:
    """Rows (N, width) of a robot that does what is wanted, knowing its own model, with exact sensors.

    Args:
        robot: The robot.
        wanted: What it does.
        feedback: K.
        kinematic: Gains of the kinematic layer.
        timing: Of the run in question; its duration does not count.

    Raises:
        RecordingError: It is lost on the way.
        KeyboardInterrupt: Ctrl-C on the way.
    """
    timing = msgspec.structs.replace(timing, duration=wanted.duration, sensor_period=None)
    loop = Loop(
        robot=robot,
        trajectory=wanted.trajectory,
        controller=ComputedTorque(feedback),
        kinematic=kinematic,
        timing=timing,
        start=Start(moving=True),
        check_gains=False,
    )
    run = loop.run()
    if run.outcome.status == "interrupted":
        raise KeyboardInterrupt
    if run.outcome.status != "completed":
        raise RecordingError(
            "no held-out trajectory", why=f"computed torque does not get through: {run.outcome.message}"
        )
    return finite_rows(run, robot.layout)
