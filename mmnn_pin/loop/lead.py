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
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..compiled import compiled, copy_to
from ..elementary import cos_sin
from ..errors import ConfigError
from ..model.base.holonomic import moves_sideways
from ..model.robot import Robot
from ..settings import Numbers, Timing
from ..signals import INDEX, Array, IntArray
from ..torque.controller import CompiledController, Context, TorqueController
from ..torque.law import Ahead, constant_gain
from ..torque.learning_law import LearningLaw
from ..torque.model_based import PD, ScheduledPD
from .before_run import lags
from .hardware import Latency

TIME, POSE_REF, POSE = INDEX["time"], INDEX["pose_ref"], INDEX["pose"]
VELOCITY_REF, ACCELERATION_REF, VELOCITY = INDEX["velocity_ref"], INDEX["acceleration_ref"], INDEX["velocity"]
Q_REF, QDOT_REF, QDDOT_REF, Q, QDOT = (INDEX[name] for name in ("q_ref", "qdot_ref", "qddot_ref", "q", "qdot"))
ALPHA, ALPHADOT, NU_REF, NUDOT_REF = (INDEX[name] for name in ("alpha", "alphadot", "nu_ref", "nudot_ref"))


class Lead(NamedTuple):
    """How a law looks ahead.

    Attributes:
        ahead: Where to, and the numbers of the law with its weights held.
        learner: What it learns with, its weights held; None where nothing learns but networks.
    """

    ahead: Ahead
    learner: Any


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
    learns = "learning" in controller.__dataclass_fields__  # type: ignore[attr-defined]
    return replace(controller, learning=False) if learns else controller  # type: ignore[type-var]


@compiled
def catch_up(row: Array, at: IntArray, setpoint: Array, before: Array, h: float, age: float) -> None:
    """Bring a measurement up to now by what the reference has moved since it was taken, in place.

    So every error is that of the measurement against the reference of its own time: the feedback is as late as ever,
    but for no error it asks for nothing, while `q_ref(t) - q(t - age)` drives a robot that follows exactly.

    Args:
        row: (width,) row of signals with the measurement.
        at: Offsets of the signals.
        setpoint: Of this sample, side by side.
        before: Of the one before.
        h: Control period [s].
        age: Of the measurement [s].
    """
    nb, n, first = at[ALPHA + 1] - at[ALPHA], at[Q + 1] - at[Q], at[POSE_REF]
    for i in range(nb + n):
        place = (at[ACCELERATION_REF] + i if i < nb else at[QDDOT_REF] + i - nb) - first
        jerk = (setpoint[place] - before[place]) / h
        faster = age * (setpoint[place] - 0.5 * age * jerk)
        if i < nb:
            row[at[VELOCITY] + i] += faster
        else:
            speed = setpoint[at[QDOT_REF] + i - nb - first]
            row[at[QDOT] + i - nb] += faster
            row[at[Q] + i - nb] += age * (speed - 0.5 * age * (setpoint[place] - age * jerk / 3.0))
    if nb:
        v, a = at[VELOCITY_REF] - first, at[ACCELERATION_REF] - first
        half, sideways = 0.5 * age, moves_sideways(nb)
        vx, w = setpoint[v] - half * setpoint[a], setpoint[v + nb - 1] - half * setpoint[a + nb - 1]
        vy = setpoint[v + 1] - half * setpoint[a + 1] if sideways else 0.0
        c, s = cos_sin(setpoint[2] - half * w)
        row[at[POSE]] += age * (c * vx - s * vy)
        row[at[POSE] + 1] += age * (s * vx + c * vy)
        row[at[POSE] + 2] += age * w


@compiled
def look_ahead(row: Array, at: IntArray, before: Array, ahead: Ahead) -> None:
    """The row of a sample as it will be where the torque acts, into `ahead.row`: the reference moves, errors stay.

    Args:
        row: (width,) row of signals with setpoint, measurement and velocity command.
        at: Offsets of the signals.
        before: The setpoint of the sample before, side by side.
        ahead: How far.
    """
    to, d, old = ahead.row, ahead.time, ahead.time + ahead.age
    nb, n = at[ALPHA + 1] - at[ALPHA], at[Q + 1] - at[Q]
    copy_to(row, to)
    to[at[TIME]] += d
    if nb:
        travel(row, at, d, at[POSE_REF], to)
        travel(row, at, old, at[POSE], to)
    for i in range(nb + n):
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


@compiled
def travel(row: Array, at: IntArray, d: float, pose: int, to: Array) -> None:
    """Move the pose that stands at a place of a row as the reference moves its own in d seconds."""
    sideways = moves_sideways(at[VELOCITY_REF + 1] - at[VELOCITY_REF])
    vx, w = row[at[VELOCITY_REF]], row[at[VELOCITY_REF + 1] - 1]
    vy = row[at[VELOCITY_REF] + 1] if sideways else 0.0
    c, s = cos_sin(row[at[POSE_REF] + 2] + 0.5 * d * w)
    to[pose] += d * (c * vx - s * vy)
    to[pose + 1] += d * (s * vx + c * vy)
    to[pose + 2] += d * w
