"""One control sample around the controller, compiled: what comes before the torque and what is known after it."""

from __future__ import annotations

import numpy as np

from . import kinematic
from .compiled import compiled, copy_to
from .model.tree_regressor import Massless, measured, regress
from .sensing.exact import exact
from .signals import INDEX, Array, IntArray
from .torque.adaptation import Adaptation, adapt
from .torque.filtered import low_pass, period, remember
from .torque.prediction import Prediction, gather

TIME, POSITION, NU, FIRST_REFERENCE, POSE = (INDEX[n] for n in ("time", "position", "nu", "pose_ref", "pose"))
TORQUE, MOTOR_TORQUE = INDEX["torque"], INDEX["motor_torque"]
POSE_REF, ALPHA, Q_REF = (INDEX[n] for n in ("pose_ref", "alpha", "q_ref"))
TRUE_POSE_ERROR, TRUE_Z, TRUE_E = (INDEX[n] for n in ("true_pose_error", "true_z", "true_e"))
VELOCITY, Q, QDOT, NU_REF, NUDOT_REF = (INDEX[n] for n in ("velocity", "q", "qdot", "nu_ref", "nudot_ref"))
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
def estimate(row: Array, at: IntArray, adaptation: Adaptation, memory: Array) -> None:
    """Psi_hat of an adaptive controller at the measured state, and the update of its estimate."""
    known, pose = adaptation.known, row[at[POSE] : at[POSE + 1]]
    look_back(row, at, known, adaptation.prediction, memory)
    velocity, q, qdot = row[at[VELOCITY] : at[Q]], row[at[Q] : at[QDOT]], row[at[QDOT] : at[QDOT + 1]]
    measured(known, pose, velocity, q, qdot)
    regress(known, row[at[NU_REF] : at[NU_REF + 1]], row[at[NUDOT_REF] : at[NUDOT_REF + 1]])
    adapt(row, at, adaptation, memory)


@compiled
def settle(row: Array, at: IntArray, prediction: Prediction | None, memory: Array) -> None:
    """Keep the torque that is held from here on, for a learner that looks back at it."""
    if prediction is not None:
        remember(row, at, memory[prediction.first :])


@compiled
def look_back(row: Array, at: IntArray, known: Massless, prediction: Prediction | None, memory: Array) -> None:
    """What the control period before this sample says of the dynamics, into the memory."""
    if prediction is not None:
        f, nb = prediction.filter, known.base
        seen = memory[prediction.first :]
        if period(row, at, f, seen):
            measured(known, f.pose, f.nu[:nb], f.q, f.nu[nb:])
            regress(known, f.nu, f.nudot)
            low_pass(f, known.Y, seen)
            if int(memory[prediction.gradient.size]) % prediction.every == 0:
                gather(prediction, memory)


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
