"""One control sample around the controller, compiled: what comes before the torque and what is known after it."""

from __future__ import annotations

import numpy as np

from .. import kinematic
from ..compiled import compiled, copy_to
from ..sensing import exact
from ..signals import INDEX, Array, IntArray

TIME, POSITION, NU, FIRST_REFERENCE, POSE = (INDEX[n] for n in ("time", "position", "nu", "pose_ref", "pose"))
TORQUE, MOTOR_TORQUE = INDEX["torque"], INDEX["motor_torque"]
POSE_REF, ALPHA, Q_REF = (INDEX[n] for n in ("pose_ref", "alpha", "q_ref"))
TRUE_POSE_ERROR, TRUE_Z, TRUE_E = (INDEX[n] for n in ("true_pose_error", "true_z", "true_e"))
ENERGY, WORK, RESIDUAL = (INDEX[n] for n in ("energy", "work", "energy_residual"))


@compiled
def before_torque(
    row: Array,
    at: IntArray,
    time: float,
    y: Array,
    reference: Array,
    measure_exactly: bool,
    arm: IntArray,
    gains: Array,
    K: Array,
) -> None:
    """Everything of a sample up to the controller: time, true state, reference, measurement, velocity command."""
    row[at[TIME]] = time
    nv, p = at[POSITION + 1] - at[POSITION], at[NU + 1] - at[NU]
    position, nu = y[:nv], y[nv : nv + p]
    copy_to(position, row[at[POSITION] : at[POSITION + 1]])
    copy_to(nu, row[at[NU] : at[NU + 1]])
    copy_to(reference, row[at[FIRST_REFERENCE] : at[POSE]])
    if measure_exactly:
        exact(row, at, position, nu, arm)
    kinematic.command(row, at, gains, K)
    true_errors(row, at, position, nu, arm)


@compiled
def true_errors(row: Array, at: IntArray, position: Array, nu: Array, arm: IntArray) -> None:
    """The tracking errors of the true state, which no controller sees: true_pose_error, true_z, true_e."""
    if at[POSE_REF + 1] > at[POSE_REF]:
        pose_ref = row[at[POSE_REF] : at[POSE_REF + 1]]
        kinematic.body_error(pose_ref, position, row[at[TRUE_POSE_ERROR] : at[TRUE_POSE_ERROR + 1]])
    for i in range(at[TRUE_Z + 1] - at[TRUE_Z]):
        row[at[TRUE_Z] + i] = row[at[ALPHA] + i] - nu[i]
    for i in range(arm.size):
        row[at[TRUE_E] + i] = row[at[Q_REF] + i] - position[arm[i]]


@compiled
def after_torque(
    row: Array, at: IntArray, M: Array, E_inv: Array, potential: float, work: float, start: float, bounds: Array
) -> int:
    """Motor torques, energy balance and the guard of a sample.

    Returns:
        -1, or the first column that is not finite or a velocity that is out of bounds.
    """
    nu, torque, motors = (
        row[at[NU] : at[NU + 1]],
        row[at[TORQUE] : at[TORQUE + 1]],
        row[at[MOTOR_TORQUE] : at[MOTOR_TORQUE + 1]],
    )
    for i in range(motors.size):
        motors[i] = 0.0
        for j in range(torque.size):
            motors[i] += E_inv[i, j] * torque[j]
    energy = potential
    for i in range(nu.size):
        for j in range(nu.size):
            energy += 0.5 * nu[i] * M[i, j] * nu[j]
    row[at[ENERGY]], row[at[WORK]], row[at[RESIDUAL]] = energy, work, energy - start - work
    for i in range(nu.size):
        if abs(nu[i]) > bounds[i]:
            return int(at[NU] + i)
    for i in range(row.size):
        if not np.isfinite(row[i]):
            return i
    return -1
