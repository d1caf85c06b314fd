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
from .parts import Hardware

APPLIED, DISTURBANCE, SAFETY = INDEX["applied"], INDEX["disturbance"], INDEX["safety"]
TORQUE, PSI_HAT = INDEX["torque"], INDEX["psi_hat"]


@compiled
def sense(
    number: int, time: float, row: Array, at: IntArray, position: Array, nu: Array, arm: IntArray, hardware: Hardware
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
        hardware: The rig.
    """
    is_new, measured = True, time
    if hardware.exact:
        exact(row, at, position, nu, arm)
    else:
        copy_to(position, hardware.position)
        copy_to(nu, hardware.nu)
        if hardware.motor_side:
            lead(nu, hardware)
        freeze(time, hardware)
        before = hardware.sensor[RECEIVED] if hardware.sensor[COUNT] > 0.0 else -1.0
        measure(
            row,
            at,
            hardware.position,
            hardware.nu,
            hardware.encoders,
            hardware.W,
            hardware.sensors,
            hardware.noise[number],
            hardware.sensor,
        )
        is_new = hardware.sensor[RECEIVED] != before
        measured = hardware.sensor[RECEIVED] * hardware.sensors[PERIOD]
    if hardware.supervised:
        safety.accept(row, at, measured, time, is_new, hardware.guard)


@compiled
def lead(nu: Array, hardware: Hardware) -> None:
    """Positions and speeds of the motors in place of those of their joints."""
    n = hardware.encoders.size - hardware.W.shape[1]
    for j in range(hardware.motors.shape[0]):
        if hardware.motors[j, motor.GAP] > 0.0:
            hardware.position[int(hardware.motors[j, motor.PLACE])] += hardware.states[j, motor.AHEAD]
            i = j - (hardware.motors.shape[0] - n)
            if i >= 0:
                hardware.nu[nu.size - n + i] = hardware.states[j, motor.ROTOR_SPEED]


@compiled
def freeze(time: float, hardware: Hardware) -> None:
    """Encoders that keep their reading, and what they kept."""
    n = hardware.encoders.size - hardware.W.shape[1]
    for k in range(hardware.frozen.shape[0]):
        place = int(hardware.frozen[k, 0])
        if (
            hardware.sensor[COUNT] == 0.0
            or time + EARLY < hardware.frozen[k, 1]
            or time + EARLY >= hardware.frozen[k, 2]
        ):
            hardware.held[k] = hardware.position[place]
            continue
        hardware.position[place] = hardware.held[k]
        for i in range(n):
            if hardware.encoders[hardware.W.shape[1] + i] == place:
                hardware.nu[hardware.nu.size - n + i] = 0.0


@compiled
def is_stopped(hardware: Hardware) -> bool:
    """Whether the supervisor does without the controller."""
    return hardware.supervised and not safety.may_learn(hardware.guard)


@compiled
def send(k: int, time: float, row: Array, at: IntArray, weights: Array, hardware: Hardware) -> None:
    """The torque of control sample k on its way to the motors: what is lost or broken, and what the supervisor does.

    Args:
        k: Number of the control sample.
        time: [s].
        row: (width,) row of signals; its torque becomes the one that reaches the motors.
        at: Offsets of the signals.
        weights: The controller's memory.
        hardware: The rig.
    """
    tau, fate = row[at[TORQUE] : at[TORQUE + 1]], hardware.fates[k]
    if hardware.supervised and not safety.may_learn(hardware.guard):
        for i in range(at[PSI_HAT], at[TORQUE + 1]):  # the controller was not asked
            row[i] = 0.0
    if fate == 2.0:
        tau[:] = np.nan
    elif fate == 1.0:
        copy_to(hardware.sent, tau)
    if hardware.supervised:
        safety.supervise(
            row,
            at,
            time,
            fate != 1.0,
            hardware.E,
            hardware.E_inv,
            hardware.limits,
            hardware.guard,
            hardware.weights,
            weights,
        )
    copy_to(tau, hardware.sent)
    for j in range(hardware.command.size):
        hardware.command[j] = 0.0
        for i in range(tau.size):
            hardware.command[j] += hardware.E_inv[j, i] * tau[i]
        hardware.states[j, motor.SUM] = 0.0
    hardware.total[:] = 0.0


@compiled
def rotate(nu: Array, hardware: Hardware) -> None:
    """Speeds of the motors of a robot whose wheels roll, `E' nu`."""
    for j in range(hardware.speed.size):
        hardware.speed[j] = 0.0
        for i in range(nu.size):
            hardware.speed[j] += hardware.E[i, j] * nu[i]


@compiled
def act(k: int, time: float, dt: float, row: Array, at: IntArray, hardware: Hardware) -> None:
    """Generalized torque over one step of the plant, of motors and pushes, into `rig.tau`; `rig.speed` is set.

    Args:
        k: Number of the control sample.
        time: Start of the step [s].
        dt: Step [s].
        row: (width,) row of signals.
        at: Offsets of the signals.
        hardware: The rig.
    """
    copy_to(row[at[TORQUE] : at[TORQUE + 1]], hardware.tau)
    if hardware.driven:
        mark(time, hardware.dead, hardware.is_dead, 1.0)
        motor.drive(
            dt,
            hardware.command,
            hardware.speed,
            hardware.is_dead,
            shorted(row, at, hardware),
            hardware.motors,
            hardware.supply,
            hardware.states,
        )
        for i in range(hardware.tau.size):
            hardware.tau[i] = 0.0
            for j in range(hardware.command.size):
                hardware.tau[i] += hardware.E[i, j] * hardware.states[j, motor.STATES]
    if hardware.pushes.shape[0]:
        gust = hardware.gusts[k] if hardware.gusts.shape[0] else hardware.force
        push(time, dt, hardware.pushes, gust, hardware.force)
        for i in range(hardware.tau.size):
            hardware.tau[i] += hardware.force[i]
            hardware.total[i] += hardware.force[i]


@compiled
def shorted(row: Array, at: IntArray, hardware: Hardware) -> int:
    """How many motors, from the first on, have their windings shorted by the supervisor."""
    if not hardware.supervised or row[at[SAFETY]] < safety.STOPPING:
        return 0
    n = hardware.encoders.size - hardware.W.shape[1]
    if row[at[SAFETY]] == safety.RAMPING:
        return int(hardware.command.size)
    return int(hardware.command.size - n) if hardware.limits[safety.SHORT] > 0.0 else 0


@compiled
def note(steps: int, row: Array, at: IntArray, hardware: Hardware) -> None:
    """What motors and pushes gave on average over a control period, into its row, once it is over."""
    for j in range(at[APPLIED + 1] - at[APPLIED]):
        given = hardware.states[j, motor.SUM] / steps if hardware.driven else hardware.command[j]
        row[at[APPLIED] + j] = given if math.isfinite(given) else 0.0  # the motion has just left all bounds
    for i in range(at[DISTURBANCE + 1] - at[DISTURBANCE]):
        row[at[DISTURBANCE] + i] = hardware.total[i] / steps
