"""What a rig does, step by step: measure, send, act; both engines call these."""

from __future__ import annotations

import math

import numpy as np

from ... import actuator as motor
from ...compiled import compiled, copy_to
from ...disturbance.effects import EARLY, mark, push
from ...safety import supervisor as safety
from ...sensing import exact, measure
from ...sensing.encoders import COUNT, PERIOD, RECEIVED
from ...signals import INDEX, Array, IntArray
from .parts import Rig

APPLIED, DISTURBANCE, SAFETY = INDEX["applied"], INDEX["disturbance"], INDEX["safety"]
TORQUE, PSI_HAT = INDEX["torque"], INDEX["psi_hat"]


@compiled
def sense(
    number: int, time: float, row: Array, at: IntArray, position: Array, nu: Array, arm: IntArray, rig: Rig
) -> None:
    """Take the measurement of this number into the row.

    Args:
        number: Of the measurement.
        time: [s].
        row: (width,) row of signals.
        at: Offsets of the signals.
        position: (nv,) true position.
        nu: (p,) true velocity.
        arm: (n,) places of the arm joints in the position.
        rig: The rig.
    """
    is_new, measured = True, time
    if rig.exact:
        exact(row, at, position, nu, arm)
    else:
        copy_to(position, rig.position)
        copy_to(nu, rig.nu)
        if rig.motor_side:
            lead(nu, rig)
        freeze(time, rig)
        before = rig.sensor[RECEIVED] if rig.sensor[COUNT] > 0.0 else -1.0
        measure(row, at, rig.position, rig.nu, rig.encoders, rig.W, rig.sensors, rig.noise[number], rig.sensor)
        is_new = rig.sensor[RECEIVED] != before
        measured = rig.sensor[RECEIVED] * rig.sensors[PERIOD]
    if rig.supervised:
        safety.accept(row, at, measured, time, is_new, rig.guard)


@compiled
def lead(nu: Array, rig: Rig) -> None:
    """Positions and speeds of the motors in place of those of their joints."""
    n = rig.encoders.size - rig.W.shape[1]
    for j in range(rig.motors.shape[0]):
        if rig.motors[j, motor.GAP] > 0.0:
            rig.position[int(rig.motors[j, motor.PLACE])] += rig.states[j, motor.AHEAD]
            i = j - (rig.motors.shape[0] - n)
            if i >= 0:
                rig.nu[nu.size - n + i] = rig.states[j, motor.ROTOR_SPEED]


@compiled
def freeze(time: float, rig: Rig) -> None:
    """Encoders that keep their reading, and what they kept."""
    n = rig.encoders.size - rig.W.shape[1]
    for k in range(rig.frozen.shape[0]):
        place = int(rig.frozen[k, 0])
        if rig.sensor[COUNT] == 0.0 or time + EARLY < rig.frozen[k, 1] or time + EARLY >= rig.frozen[k, 2]:
            rig.held[k] = rig.position[place]
            continue
        rig.position[place] = rig.held[k]
        for i in range(n):
            if rig.encoders[rig.W.shape[1] + i] == place:
                rig.nu[rig.nu.size - n + i] = 0.0


@compiled
def is_stopped(rig: Rig) -> bool:
    """Whether the supervisor does without the controller."""
    return rig.supervised and not safety.may_learn(rig.guard)


@compiled
def send(k: int, time: float, row: Array, at: IntArray, weights: Array, rig: Rig) -> None:
    """The torque of control sample k on its way to the motors: what is lost or broken, and what the supervisor does.

    Args:
        k: Number of the control sample.
        time: [s].
        row: (width,) row of signals; its torque becomes the one that reaches the motors.
        at: Offsets of the signals.
        weights: The controller's memory.
        rig: The rig.
    """
    tau, fate = row[at[TORQUE] : at[TORQUE + 1]], rig.fates[k]
    if rig.supervised and not safety.may_learn(rig.guard):
        for i in range(at[PSI_HAT], at[TORQUE + 1]):  # the controller was not asked
            row[i] = 0.0
    if fate == 2.0:
        tau[:] = np.nan
    elif fate == 1.0:
        copy_to(rig.sent, tau)
    if rig.supervised:
        safety.supervise(row, at, time, fate != 1.0, rig.E, rig.E_inv, rig.limits, rig.guard, rig.weights, weights)
    copy_to(tau, rig.sent)
    for j in range(rig.command.size):
        rig.command[j] = 0.0
        for i in range(tau.size):
            rig.command[j] += rig.E_inv[j, i] * tau[i]
        rig.states[j, motor.SUM] = 0.0
    rig.total[:] = 0.0


@compiled
def rotate(nu: Array, rig: Rig) -> None:
    """Speeds of the motors of a robot whose wheels roll, `E' nu`."""
    for j in range(rig.speed.size):
        rig.speed[j] = 0.0
        for i in range(nu.size):
            rig.speed[j] += rig.E[i, j] * nu[i]


@compiled
def act(k: int, time: float, dt: float, row: Array, at: IntArray, rig: Rig) -> None:
    """Generalized torque over one step of the plant, of motors and pushes, into `rig.tau`; `rig.speed` is set.

    Args:
        k: Number of the control sample.
        time: Start of the step [s].
        dt: Step [s].
        row: (width,) row of signals.
        at: Offsets of the signals.
        rig: The rig.
    """
    copy_to(row[at[TORQUE] : at[TORQUE + 1]], rig.tau)
    if rig.driven:
        mark(time, rig.dead, rig.is_dead, 1.0)
        motor.drive(dt, rig.command, rig.speed, rig.is_dead, shorted(row, at, rig), rig.motors, rig.supply, rig.states)
        for i in range(rig.tau.size):
            rig.tau[i] = 0.0
            for j in range(rig.command.size):
                rig.tau[i] += rig.E[i, j] * rig.states[j, motor.STATES]
    if rig.pushes.shape[0]:
        gust = rig.gusts[k] if rig.gusts.shape[0] else rig.force
        push(time, dt, rig.pushes, gust, rig.force)
        for i in range(rig.tau.size):
            rig.tau[i] += rig.force[i]
            rig.total[i] += rig.force[i]


@compiled
def shorted(row: Array, at: IntArray, rig: Rig) -> int:
    """How many motors, from the first on, have their windings shorted by the supervisor."""
    if not rig.supervised or row[at[SAFETY]] < safety.STOPPING:
        return 0
    n = rig.encoders.size - rig.W.shape[1]
    if row[at[SAFETY]] == safety.RAMPING:
        return int(rig.command.size)
    return int(rig.command.size - n) if rig.limits[safety.SHORT] > 0.0 else 0


@compiled
def note(steps: int, row: Array, at: IntArray, rig: Rig) -> None:
    """What motors and pushes gave on average over a control period, into its row, once it is over."""
    for j in range(at[APPLIED + 1] - at[APPLIED]):
        given = rig.states[j, motor.SUM] / steps if rig.driven else rig.command[j]
        row[at[APPLIED] + j] = given if math.isfinite(given) else 0.0  # the motion has just left all bounds
    for i in range(at[DISTURBANCE + 1] - at[DISTURBANCE]):
        row[at[DISTURBANCE] + i] = rig.total[i] / steps
