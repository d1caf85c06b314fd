"""The contest's tasks on the plant of this study, each controller through `Stepper` as on a robot."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from mmnn_pin import Measurement, Setpoint, Stepper
from mmnn_pin.reference import Trajectory
from mmnn_pin.safety import Safety
from research.contest.task import Task, frozen

from .plant import (
    LAWS,
    NU,
    POSE,
    ROTOR,
    SMOOTH,
    STATES,
    STEP,
    STICK,
    Array,
    Body,
    Q,
    World,
    advance,
    inverse,
    read,
)
from .sensors import Sensors

SETTLED = 0.5  # of a held-out run that does not count [s]
LARGE = 3.0  # error at which a run is lost [m or rad]


@dataclass(frozen=True)
class Changes:
    """What is other than in the contest.

    Attributes:
        about: In words.
        law: Of the joints' dry friction, "" for the contest's.
        masses: Times those of the URDF.
        noise: Times the sensors'.
        rolling: Dry resistance of each wheel [N m].
        ripple: Of the motors' torques.
        lengths: Times those of the arm.
        lag: Times the motors', which controllers are told.
    """

    about: str = "as in the contest"
    law: str = ""
    masses: float = 1.0
    noise: float = 1.0
    rolling: float = 0.0
    ripple: float = 0.0
    lengths: float = 1.0
    lag: float = 1.0


CHANGES = {
    "contest": Changes(),
    "stick": Changes("dry friction sticks", law="stick"),
    "lugre": Changes("LuGre friction", law="lugre"),
    "masses": Changes("masses 1.2 times", masses=1.2),
    "lengths": Changes("arm 1 % longer", lengths=1.01),
    "rolling": Changes("0.8 N m of dry rolling resistance per wheel", rolling=0.8),
    "noise": Changes("noise twice as large", noise=2.0),
    "ripple": Changes("3 % torque ripple", ripple=0.03),
    "lag": Changes("lag 1.5 times as told", lag=1.5),
}


@dataclass(frozen=True)
class Errors:
    """Numbers of one run as the contest has them; inf for what was lost.

    Attributes:
        base: RMS error in the last window of the training [mm].
        arm: The same of the joints [mrad].
        held_base: On all held-out trajectories, while learning [mm].
        held_arm: Of the joints [mrad].
        frozen_base: The same with the final weights held fixed [mm].
        frozen_arm: Of the joints [mrad].
        frozen_fvu: Of the worst component, weights held fixed, on the worst held-out trajectory.
    """

    base: float
    arm: float
    held_base: float
    held_arm: float
    frozen_base: float
    frozen_arm: float
    frozen_fvu: float

    @property
    def training(self) -> Errors:
        """Those of the training alone, nan for the others."""
        return Errors(self.base, self.arm, *[math.nan] * 5)

    @classmethod
    def middle(cls, runs: list[Errors]) -> Errors:
        """Median of each."""
        return cls(**{name: median(getattr(run, name) for run in runs) for name in cls.__dataclass_fields__})


def errors_of(task: Task, name: str, changes: Changes, seed: int, only: str = "") -> Errors:
    """One controller, trained on a task, then held out: on all trajectories, or on the one that is named."""
    experiment, controller = task.experiment, task.controller(name)
    body, world = read(changes.masses, changes.lengths, task.experiment.radii), world_of(task, changes)  # type: ignore[arg-type]
    stepper = new_stepper(task, controller, seed)
    window = experiment.windows[-1]
    rng = np.random.default_rng([seed, 0])
    length = experiment.time.duration
    run = follow(stepper, task, body, world, experiment.trajectory_of(task.robot), length, rng, False, changes.noise)
    trained = rms(run, *window)
    if not np.isfinite(trained).all():
        return Errors(*trained, *[math.inf] * 5)
    state = stepper.snapshot()
    carried = world._replace(load=world.load * [1, 1, 0, 1] if world.load[3] > length else np.zeros(4))
    found: dict[str, list[Array]] = {"learning": [], "frozen": []}
    judging = {name: held for name, held in task.held_out.items() if only in ("", name)}
    for i, held in enumerate(judging.values()):
        for how in found:
            judged = controller if how == "learning" else frozen(controller)
            if judged is None:
                continue
            again = new_stepper(task, judged, seed, state)
            rng = np.random.default_rng([seed, 1 + i])
            run = follow(again, task, body, carried, held.trajectory, held.duration, rng, True, changes.noise)
            found[how].append(rms(run, SETTLED, held.duration))
    squares = [np.sqrt(np.mean(np.square(each), axis=0)) if each else np.full(2, np.nan) for each in found.values()]
    known = max(unexplained(task, controller, seed, state, body, carried, held) for held in judging.values())
    return Errors(*[*trained, *squares[0], *squares[1], known])


def world_of(task: Task, changes: Changes) -> World:
    """The plant of a task, as its experiment says."""
    experiment = task.experiment
    f, motors, load = experiment.friction, experiment.actuator, task.load
    law = LAWS[changes.law] if changes.law else STICK if experiment.time.integrator == "stick" else SMOOTH
    gap = np.zeros(4)
    if isinstance(motors.gap, tuple):
        gap = np.array([motors.gap[-1], motors.rotor_inertia, motors.stiffness, motors.damping], float)
    held = [load.mass, load.at[0], load.start, load.end] if load else [0.0] * 4
    return World(
        law=law,
        viscous=np.append(f.base, [f.arm, f.arm]).astype(float),
        dry=np.array([f.coulomb, f.breakaway, f.stribeck], float),
        rolling=changes.rolling,
        gap=gap,
        lag=changes.lag * float(motors.lag),  # type: ignore[arg-type]
        ripple=changes.ripple,
        gain=np.ones(4) * motors.torque_gain,
        limited=motors.torque_limit == "urdf",
        load=np.array(held, float),
    )


def new_stepper(task: Task, controller: Any, seed: int, state: Any = None, **more: Any) -> Stepper:
    """A controller on a robot, with what the task says of gains, delay, lead and observer, but for what is given."""
    loop = task.training(controller, seed)
    poles = loop.sensor.bandwidth if loop.sensor.velocity == "model" else 0.0
    return Stepper.of(loop, **({"safety": Safety(), "state": state, "check_gains": False, "observer": poles} | more))


def follow(
    stepper: Stepper,
    task: Task,
    body: Body,
    world: World,
    trajectory: Trajectory,
    duration: float,
    rng: np.random.Generator,
    moving: bool,
    noise: float,
) -> Array:
    """Drive the plant along a trajectory.

    Returns:
        (N, 3) time, distance of the base, root mean square of the joints' errors [s, m, rad]; inf once it is lost.
    """
    experiment = task.experiment
    h, late = experiment.time.control_period, experiment.latency.sensing
    wait, steps = round(late / h), round(h / STEP)
    times = np.arange(round(duration / h)) * h
    table = trajectory.table(times, task.robot.dimensions)
    state = start_of(task, table[0], moving)
    sensors, seen = Sensors.of(task, read(), noise, rng), list[Array]()
    found = np.full((len(times), 3), np.inf)
    found[:, 0] = times
    for k, time in enumerate(times):
        away, apart = state[POSE : POSE + 2] - table[k, :2], state[Q : Q + 2] - table[k, 7:9]
        error = np.sqrt([np.sum(away**2), np.mean(apart**2)])
        if not error.max() < LARGE:
            break
        found[k, 1:] = error
        seen.append(sensors.read(state))
        now = seen[max(k - wait, 0)]
        setpoint = Setpoint.side_by_side(table[k], task.robot.dimensions)
        measurement = Measurement(now[:3], now[3:5], now[5:7], now[7:])
        command = stepper.step(time, measurement, setpoint, measured=max(k - wait, 0) * h if late else None)
        advance(body, world, state, command.motor_effort, time, steps, STEP)
    return found


def start_of(task: Task, row: Array, moving: bool) -> Array:
    """The plant's state at the first sample of a reference: on it, or at rest and off by the task's offset."""
    state = np.zeros(STATES)
    state[POSE : POSE + 3], state[Q : Q + 2] = row[:3], row[7:9]
    if moving:
        state[NU : NU + 2], state[NU + 2 : NU + 4] = row[3:5], row[9:11]
    else:
        dx, dy, turn = task.experiment.start.pose_offset
        c, s = math.cos(row[2]), math.sin(row[2])
        state[POSE : POSE + 3] += [c * dx - s * dy, s * dx + c * dy, turn]
    state[ROTOR : ROTOR + 2] = state[NU + 2 : NU + 4]
    return state


def rms(run: Array, start: float, stop: float) -> Array:
    """RMS error of the base [mm] and of the arm [mrad] in a window."""
    counts = (run[:, 0] >= start - 1e-9) & (run[:, 0] < stop - 1e-9)
    return 1e3 * np.sqrt(np.mean(run[counts, 1:] ** 2, axis=0))


def unexplained(task: Task, controller: Any, seed: int, state: Any, body: Body, world: World, held: Any) -> float:
    """FVU of the worst component, weights held, on a robot that is exactly on the reference and measured exactly.

    It judges what the weights say, before the motors' limits take of it.
    """
    judged = frozen(controller)
    if judged is None:
        return math.nan
    stepper = new_stepper(task, judged, seed, state, within_limits=False, observer=0.0)
    h, layout = task.experiment.time.control_period, stepper.setup.layout
    times = np.arange(round(held.duration / h)) * h
    table = held.trajectory.table(times, task.robot.dimensions)
    psi, said = np.zeros((2, len(times), 4))
    mass = float(world.load[0]) if world.load[2] <= 0.0 < world.load[3] else 0.0
    for k, row in enumerate(table):
        nu, nudot = np.concatenate((row[3:5], row[9:11])), np.concatenate((row[5:7], row[11:]))
        psi[k] = inverse(body, world, mass, nu, nudot, row[7:9])
        measurement = Measurement(row[:3], row[3:5], row[7:9], row[9:11])
        stepper.step(times[k], measurement, Setpoint.side_by_side(row, task.robot.dimensions))
        said[k] = stepper.row[layout.where("psi_hat")]
    late = times >= SETTLED
    missed, varies = ((x[late] ** 2).sum(axis=0) for x in (psi - said, psi - psi[late].mean(axis=0)))
    return float((missed / varies).max())
