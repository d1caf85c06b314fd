"""The half period: what a torque says of the reference is said for the middle of the time in which it acts.

A torque is computed at a sample and held for a period h, so what it knows of the motion is h/2 old on average, older by
the way of the command and by the lag of the motors. With

    delta = h/2 + command + jitter/2 + lag,                                                            (L)

the estimate is asked twice with the same weights: at the sample, which is `psi_hat` and what is learned from, and delta
ahead, where the reference will be. There every signal is moved as the reference moves it and every error is kept:

    q + delta qd_ref,   nu + delta a,   nu_ref + delta a,   nudot_ref + delta (a - a before) / h,     a = qdd_ref

and `psi_applied = psi_hat + share (ahead - psi_hat)` is sent, share being delta of a velocity over the largest. It is
causal: time, measurement, and the setpoints of this sample and the last. What is added is a difference of the reference
alone. So the errors inside nudot_ref (`K edot`, alphadot) are held, not extrapolated: psi_applied has the noise of
psi_hat, and the loop linearised about the reference has the same feedback, to first order in delta
(docs/explanation/theory.md, section 8).

A base that steers has other velocities than the reference: its own (velocity, alpha, nu_ref) move by alphadot, its
angles as they turn, and alphadot is held. What is added then has the feedback of the pose in it, delta of it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..compiled import compiled, copy_to, internal, linked
from ..elementary import cos_sin
from ..errors import ConfigError
from ..kinematic import Steering
from ..model.robot import Robot
from ..reference.guide import BASE, Guide
from ..reference.guide import VELOCITY as VELOCITY_LED
from ..settings import Numbers, Timing
from ..signals import INDEX, SIDEWAYS, Array, IntArray
from ..torque.controller import CompiledController, Context, TorqueController
from ..torque.law import Ahead, constant_gain
from ..torque.learning_law import LearningLaw
from ..torque.model_based import PD, ScheduledPD
from .before_run import lags
from .latency import Latency

TIME, POSE_REF, POSE = INDEX["time"], INDEX["pose_ref"], INDEX["pose"]
VELOCITY_REF, ACCELERATION_REF, VELOCITY = INDEX["velocity_ref"], INDEX["acceleration_ref"], INDEX["velocity"]
Q_REF, QDOT_REF, QDDOT_REF, Q, QDOT = (INDEX[name] for name in ("q_ref", "qdot_ref", "qddot_ref", "q", "qdot"))
ALPHA, ALPHADOT, NU_REF, NUDOT_REF = (INDEX[name] for name in ("alpha", "alphadot", "nu_ref", "nudot_ref"))
SHAPE = INDEX["shape"]


class Lead(NamedTuple):
    """How a law looks ahead."""

    ahead: Ahead  # where to, and the numbers of the law with its weights held
    learner: Any  # what it learns with, its weights held; None where nothing learns but networks


def delays(robot: Robot, timing: Timing, latency: Latency, lag: Numbers) -> Array:
    """How long the torque of every velocity is under way, (L), (p,) [s].

    Args:
        robot: The robot.
        timing: Periods.
        latency: What is known of the way of measurements and commands.
        lag: Time constants of the motors, one number or one per motor [s].
    """
    return lags(robot, lag) + (0.5 * timing.control_period + latency.command + 0.5 * latency.jitter)


def leads(controller: CompiledController | TorqueController) -> bool:
    """Whether a controller has a Psi_hat that can be asked ahead; one that gives its torque itself has none."""
    return isinstance(controller, CompiledController | LearningLaw) and not isinstance(controller, PD | ScheduledPD)


def lead_of(
    controller: CompiledController | TorqueController, context: Context, delays: Array, age: float = 0.0
) -> Lead:
    """How a controller that `leads` looks ahead.

    Args:
        controller: The controller.
        context: What it is told before the run, its row with `psi_applied`.
        delays: (p,) delta of every velocity, see (L) [s].
        age: Of a measurement when it is used [s]; the state moves by that much more.

    Raises:
        ConfigError: Networks whose weights move with the hidden outputs of the last call: these would be those ahead.
    """
    networks = controller.networks
    if networks is not None and networks.update == "before_output":
        why = "its weights move with the hidden outputs of the last call, which the lead would overwrite"
        fix = "use lead = false, or learning.update = 'after_output'"
        raise ConfigError(f"{controller.name} with lead", why=why, fix=fix, key="lead")
    longest = float(delays.max(initial=0.0))
    share = delays / longest if longest > 0.0 else np.zeros(delays.size)
    packed, learner = constant_gain(np.zeros(delays.size)), None
    if isinstance(controller, CompiledController):
        law = held(controller).law(context)
        packed, learner = law.numbers, law.learner
    return Lead(
        Ahead(longest, float(age), float(context.control_period), share, context.layout.new_row(), packed), learner
    )


def held(controller: CompiledController) -> CompiledController:
    """The controller with its weights held: asked so, it changes nothing that it remembers."""
    return replace(controller, learning=False) if learns(controller) else controller  # type: ignore[type-var]


def learns(controller: CompiledController) -> bool:
    """Whether a controller has weights that may be held."""
    return "learning" in controller.__dataclass_fields__  # type: ignore[attr-defined]


@linked
def catch_up(row: Array, at: IntArray, setpoint: Array, then: Array, age: float, steering: Steering | None) -> None:
    """Bring a measurement up to now by what the reference has moved since it was taken, in place.

    So every error is that of the measurement against the reference of its own time: the feedback is as late as ever,
    but for no error it asks for nothing, while `q_ref(t) - q(t - age)` drives a robot that follows exactly. The pose
    goes along the mean of the reference's velocities then and now. Velocities and angles of a base that steers, of
    which the reference has none, move as the last sample asked.

    Args:
        row: (width,) row of signals with the measurement, and with alpha and alphadot of the sample before.
        at: Offsets of the signals.
        setpoint: Of this sample, side by side.
        then: The reference when the measurement was taken, likewise.
        age: Of the measurement [s].
        steering: Of a base that steers, its maps those of the sample before; None for others.
    """
    first, nb = at[POSE_REF], at[ALPHA + 1] - at[ALPHA]
    for measured, reference in ((VELOCITY, VELOCITY_REF), (Q, Q_REF), (QDOT, QDOT_REF)):
        for i in range(at[measured + 1] - at[measured] if steering is None or measured != VELOCITY else 0):
            place = at[reference] - first + i
            row[at[measured] + i] += setpoint[place] - then[place]
    if steering is not None:
        move_wheels(row, at, age, row, steering)
    if nb:
        v, last, half = at[VELOCITY_REF] - first, at[ACCELERATION_REF] - first - 1, 0.5 * age
        turn = half * (setpoint[last] + then[last])
        along = half * (setpoint[v] + then[v])
        aside = half * (setpoint[v + 1] + then[v + 1]) if at[SIDEWAYS] else 0.0
        c, s = cos_sin(setpoint[2] - 0.5 * turn)
        row[at[POSE]] += c * along - s * aside
        row[at[POSE] + 1] += s * along + c * aside
        row[at[POSE] + 2] += turn


@linked
def reference_then(setpoints: Array, k: int, back: float, then: Array) -> None:
    """The reference of sample k less some periods, of a table (N, w), into `then`; the first one before the start."""
    place = max(k - back, 0.0)
    i = int(place)
    for j in range(then.size):
        step = setpoints[min(i + 1, setpoints.shape[0] - 1), j] - setpoints[i, j]
        then[j] = setpoints[i, j] + (place - i) * step


class Past(NamedTuple):
    """References of the last samples of a stepper, by which measurements are brought up to now."""

    longest: float  # largest age of a measurement that is made up for [s]
    times: Array  # (m,) of the references, -inf where there is none yet [s]
    rows: Array  # (m, w) references, in a ring
    newest: IntArray  # (1,) place of the newest
    then: Array  # (w,) the reference when it was taken

    @classmethod
    def of(cls, longest: float, period: float, setpoint: Array) -> Past:
        """Of a stepper with this period, whose setpoints are as long as this one."""
        m = int(longest / period) + 3
        return cls(longest, np.full(m, -np.inf), np.zeros((m, setpoint.size)), np.zeros(1, np.int64), setpoint.copy())


@compiled
def bring_up(
    row: Array, at: IntArray, time: float, taken: float, guide: Guide, past: Past, steering: Steering | None
) -> None:
    """Bring a stepper's last good measurement, which is in the row, up to now.

    A base that goes where a velocity leads has no pose error: the setpoint's pose goes along.

    Args:
        row: (width,) row of signals.
        at: Offsets of the signals.
        time: Of the sample [s].
        taken: When the measurement was taken [s].
        guide: With the setpoint of the sample.
        past: The references before.
        steering: As of `catch_up`.
    """
    past.newest[0] = (past.newest[0] + 1) % past.times.size
    past.times[past.newest[0]] = time
    copy_to(guide.now, past.rows[past.newest[0]])
    age = min(max(time - taken, 0.0), past.longest)
    recall(past, time - age)
    catch_up(row, at, guide.now, past.then, age, steering)
    if guide.kind[BASE] == VELOCITY_LED:
        copy_to(row[at[POSE] : at[POSE + 1]], guide.now[: at[POSE + 1] - at[POSE]])


@compiled
def recall(past: Past, time: float) -> None:
    """The reference of a time, into `then`; the oldest there is where that is longer ago."""
    m, later = past.times.size, past.newest[0]
    i = later
    for _ in range(m - 1):
        before = (i + m - 1) % m
        if past.times[i] <= time or past.times[before] == -math.inf:
            break
        later, i = i, before
    span = past.times[later] - past.times[i]
    share = min(max((time - past.times[i]) / span, 0.0), 1.0) if span > 0.0 else 0.0
    for j in range(past.then.size):
        past.then[j] = past.rows[i, j] + share * (past.rows[later, j] - past.rows[i, j])


@linked
def look_ahead(row: Array, at: IntArray, before: Array, ahead: Ahead, steering: Steering | None) -> None:
    """The row of a sample as it will be where the torque acts, into `ahead.row`: the reference moves, errors stay.

    Args:
        row: (width,) row of signals with setpoint, measurement and velocity command.
        at: Offsets of the signals.
        before: The setpoint of the sample before, side by side.
        ahead: How far.
        steering: Of a base that steers, its maps those of this sample; None for others.
    """
    to, d, old = ahead.row, ahead.time, ahead.time + ahead.age
    nb, n, first = at[ALPHA + 1] - at[ALPHA], at[Q + 1] - at[Q], 0
    copy_to(row, to)
    to[at[TIME]] += d
    if nb:
        travel(row, at, d, at[POSE_REF], to)
        travel(row, at, old, at[POSE], to)
    if steering is not None:
        move_wheels(row, at, old, to, steering)
        first = nb
        for i in range(nb):
            for signal in (ALPHA, NU_REF):
                to[at[signal] + i] += d * row[at[ALPHADOT] + i]
        for i in range(at[ACCELERATION_REF + 1] - at[ACCELERATION_REF]):
            rate = at[ACCELERATION_REF] + i
            jerk = (row[rate] - before[rate - at[POSE_REF]]) / ahead.h
            to[rate] += d * jerk
            to[at[VELOCITY_REF] + i] += d * (row[rate] + 0.5 * d * jerk)
    for i in range(first, nb + n):
        j = i - nb
        rate = at[ACCELERATION_REF] + i if i < nb else at[QDDOT_REF] + j
        jerk = (row[rate] - before[rate - at[POSE_REF]]) / ahead.h
        faster, later = d * (row[rate] + 0.5 * d * jerk), old * (row[rate] + 0.5 * old * jerk)
        to[rate] += d * jerk
        to[at[NU_REF] + i] += faster
        to[at[NUDOT_REF] + i] += d * jerk
        if i < nb:
            to[at[VELOCITY_REF] + i] += faster
            to[at[VELOCITY] + i] += later
            to[at[ALPHA] + i] += faster
            to[at[ALPHADOT] + i] += d * jerk
        else:
            speed = row[at[QDOT_REF] + j]
            to[at[QDOT_REF] + j] += faster
            to[at[QDOT] + j] += later
            to[at[Q_REF] + j] += d * (speed + 0.5 * d * row[rate])
            to[at[Q] + j] += old * (speed + 0.5 * old * row[rate])


@internal
def move_wheels(row: Array, at: IntArray, d: float, to: Array, steering: Steering) -> None:
    """Move the measured velocities and angles of a base that steers in a row as a sample asks it to for d seconds."""
    nb, T = at[ALPHA + 1] - at[ALPHA], steering.maps.T
    for k in range(at[SHAPE + 1] - at[SHAPE]):
        for i in range(nb):
            to[at[SHAPE] + k] += d * T[3 + k, i] * (row[at[VELOCITY] + i] + 0.5 * d * row[at[ALPHADOT] + i])
    for i in range(nb):
        to[at[VELOCITY] + i] += d * row[at[ALPHADOT] + i]


@compiled
def travel(row: Array, at: IntArray, d: float, pose: int, to: Array) -> None:
    """Move the pose that stands at a place of a row as the reference moves its own in d seconds."""
    vx, w = row[at[VELOCITY_REF]], row[at[VELOCITY_REF + 1] - 1]
    vy = row[at[VELOCITY_REF] + 1] if at[SIDEWAYS] else 0.0
    c, s = cos_sin(row[at[POSE_REF] + 2] + 0.5 * d * w)
    to[pose] += d * (c * vx - s * vy)
    to[pose + 1] += d * (s * vx + c * vy)
    to[pose + 2] += d * w
