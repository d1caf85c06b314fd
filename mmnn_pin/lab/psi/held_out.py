"""Motions on which frozen weights are judged: a trajectory that the learner never saw, and a robot with a load.

The held-out trajectory has another path, speed and arm motion, and is recorded once under computed torque. A config may
name one in `[held_out]`. Otherwise it follows from the run's reference alone, so that all learners of an experiment get
the same one: the base drives an eight at 1.3 times the mean speed, turning at most 1.3 times as fast as the run; every
joint swings 1.3 times as fast, those that stood still, too, each with a phase of its own. It is as large and as slow as
a base needs to steer along it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import msgspec
import numpy as np
import pinocchio as pin

from ...errors import ConfigError, RecordingError
from ...kinematic import Kinematic
from ...loop.before_run import Start
from ...loop.loop import Loop
from ...model.robot import Robot, carrying
from ...reference import BasePath, Eight, HolonomicPath, Sine, Trajectory
from ...reference.steerable import Enlarged, fitted
from ...settings import Timing
from ...signals import Array, Layout
from ...torque.controller import Feedback
from ...torque.entries import CONTROLLERS
from ..experiments.config import named_files, recorded_experiment
from ..experiments.experiment import Experiment
from .subject import Subject, finite_rows

FASTER = 1.3
ASPECT = 0.8  # width of the eight over its length
SHORTEST, USUAL, LONGEST = 5.0, 10.0, 20.0  # of a lap [s]
SPEED = 0.2  # [m/s] where the run's base stands still
SWING = 0.3  # [rad or m] of a joint that stood still and has no limits; else this share of half its range
MARGIN = 0.95  # of a joint's range
MOST_STEPS = 10_000_000  # of the plant, of a run that is made because a recording says so
GOLDEN = 2.399963  # [rad]: phases that do not repeat
START = 0.5  # [s] of a run that do not count: the transient
SHARE = 0.25  # of the arm's mass, about what arms are made to carry


@dataclass(frozen=True)
class HeldOut:
    """A trajectory for judging, never for training."""

    trajectory: Trajectory  # what the robot should do
    duration: float  # for how long [s]
    about: str  # the same in words


def held_out(subject: Subject) -> HeldOut:
    """The one that the run's config names, or the one that follows from its reference.

    Raises:
        InputError: The config cannot be read, or its trajectory does not suit the robot.
    """
    experiment = recorded_experiment(subject.recording)
    if experiment is not None:
        longest = max([experiment.time.duration, *(one.duration for one in experiment.held_out.values())])
        if not longest / experiment.time.plant_step < MOST_STEPS:
            why = f"{longest:g} s in steps of {experiment.time.plant_step:g} s"
            raise RecordingError("its held-out trajectory is too long", why=why, file=subject.recording.path)
        if named_files(experiment) and not experiment.held_out:
            return usual(subject.robot, subject.timing.control_period, subject.rows)
        return next(iter(all_held_out(experiment, subject.robot).values()))
    return usual(subject.robot, subject.timing.control_period, subject.rows)


def all_held_out(experiment: Experiment, robot: Robot) -> dict[str, HeldOut]:
    """All that an experiment names, or the one that follows from its reference, by name.

    Raises:
        InputError: One does not suit the robot, or is over before errors count.
    """
    for name, settings in experiment.held_out.items():
        if settings.duration <= START:
            raise ConfigError(
                f"{settings.duration:g} s",
                why=f"the first {START:g} s do not count",
                fix="make it longer",
                key=f"held_out.{name}.duration",
            )
    if not experiment.held_out:
        return {"usual": usual(robot, experiment.time.control_period, whole_reference(experiment, robot))}
    return {
        name: HeldOut(
            experiment.held_out_of(robot, name), settings.duration, f"as [held_out.{name}] of its config says"
        )
        for name, settings in experiment.held_out.items()
    }


def whole_reference(experiment: Experiment, robot: Robot) -> Array:
    """The reference of a whole run as rows (N, width), also of one that ended early."""
    layout, timing = Layout.of(robot.dimensions), experiment.time
    rows = np.zeros((timing.samples, layout.width))
    where = slice(layout.where("pose_ref").start, layout.where("qddot_ref").stop)
    rows[:, where] = experiment.trajectory_of(robot).table(np.arange(timing.samples) * timing.control_period, layout)
    return rows


def usual(robot: Robot, h: float, rows: Array) -> HeldOut:
    """The trajectory that follows from the reference in some rows, see the top of this module.

    Args:
        robot: The robot.
        h: Control period [s].
        rows: (N, width).
    """
    layout = Layout.of(robot.dimensions)
    velocity, q, qdot = (rows[:, layout.where(name)] for name in ("velocity_ref", "q_ref", "qdot_ref"))
    base, lap = base_path(velocity, layout.sideways)
    profiles, period = arm_profiles(robot, q, qdot)
    duration, words = float(np.clip(lap or 3 * period, SHORTEST, LONGEST)), []
    trajectory = fitted(Trajectory(base, profiles), robot.base, robot.dimensions, duration)
    if base is not None:
        eight = base.path if isinstance(base, HolonomicPath) else base
        assert isinstance(eight, Eight)
        larger = trajectory.base.factor if isinstance(trajectory.base, Enlarged) else 1.0
        length, width, lap = larger * eight.length, larger * eight.width, trajectory.slowness * math.sqrt(larger) * lap
        words.append(f"an eight of {length:.2g} x {width:.2g} m, {lap:.3g} s a lap")
    if profiles:
        words.append(f"every joint a sine, {FASTER:g} times as fast")
    return HeldOut(trajectory, h * round(duration / h), "; ".join(words))


def base_path(velocity: Array, sideways: bool) -> tuple[BasePath | None, float]:
    """An eight for a base that was asked for these velocities (N, nb), and its time of a lap [s]."""
    if not velocity.shape[1]:
        return None, 0.0
    speed, turning = (
        np.hypot(velocity[:, 0], velocity[:, 1] if sideways else 0.0).mean(),
        np.abs(velocity[:, -1]).max(),
    )
    lap = Eight(1.0, ASPECT, 1.0).sample(np.linspace(0, 1, 1001)).velocity
    length, bend = np.abs(lap[:-1, 0]).mean(), np.abs(lap[:, 1]).max()
    period = float(np.clip(bend / (FASTER * turning), SHORTEST, 2 * LONGEST)) if turning > 1e-6 else USUAL
    size = FASTER * (speed if speed > 1e-3 else SPEED) * period / length
    eight = Eight(float(size), float(ASPECT * size), period)
    return (HolonomicPath(eight, Sine(0.5, period / 2)) if sideways else eight), period


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


@lru_cache(maxsize=1)  # the learners of one experiment share it
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
        controller=CONTROLLERS["computed_torque"].load()(feedback),
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
    return finite_rows(run, Layout.of(robot.dimensions))


def usual_payload(robot: Robot) -> float:
    """A quarter of the mass that the arm moves, or of the whole robot's where it has no arm [kg]."""
    model, arm = robot.model, [robot.model.getJointId(name) for name in robot.joint_names]
    bodies = {i for joint in arm for i in model.subtrees[joint]} if arm else range(1, model.njoints)
    return float(SHARE * sum(model.inertias[i].mass for i in bodies))


def loaded(robot: Robot, mass: float) -> Robot:
    """The robot with a point mass [kg] at the tip of its arm, or at the centre of its base where it has no arm.

    The tip is the point of the last arm joint's body that is farthest from the joint, among the frames and joints
    that it carries.
    """
    joint = robot.model.getJointId(robot.joint_names[-1]) if robot.joint_names else 1
    return carrying(robot, mass, at=tuple(tip(robot.model, joint, bool(robot.joint_names))))


def tip(model: pin.Model, joint: int, of_arm: bool) -> Array:
    """Where the load is, (3,) in the joint's frame [m]."""
    points = [frame.placement.translation for frame in model.frames if frame.parentJoint == joint]
    points += [model.jointPlacements[child].translation for child in model.children[joint]]
    if not of_arm or not any(np.linalg.norm(point) > 1e-9 for point in points):
        return np.array(model.inertias[joint].lever)
    return np.array(max(points, key=np.linalg.norm))
