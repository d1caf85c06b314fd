"""What is learned within what the motors can give: the last stage of every law before its torque. Compiled.

The feedback `k s` comes first. Robust term and Psi_hat, which go with the weights, take of every motor's torque limit
what it leaves, in this order. So no motor is asked for more than its limit unless the feedback alone asks for it, and
what is added to the feedback is bounded, whatever the weights are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compiled import compiled, copy_to
from ..signals import Array

ROUNDING = 1e-12  # part of a limit that is left for rounding, so that no sum is beyond it


class MotorLimits(NamedTuple):
    """Limits of a robot's motors, and memory to work in.

    Attributes:
        E: (p, motors) torque on nu from motor torques.
        E_inv: (motors, p) and back.
        effort: (motors,) largest torques of the motors [N m or N], inf for no limit.
        motors: (motors,) memory to work in.
        asked: (p,) written: Psi_hat as it was before it was limited [N, N m].
    """

    E: Array
    E_inv: Array
    effort: Array
    motors: Array
    asked: Array


def motor_limits(E: Array, effort: Array) -> MotorLimits | None:
    """Limits of motors with E (p, motors) and largest torques (motors,); None where no motor has one."""
    if not np.isfinite(effort).any():
        return None
    E = np.ascontiguousarray(E, dtype=float)
    E_inv = np.ascontiguousarray(np.linalg.pinv(E))
    return MotorLimits(E, E_inv, (1.0 - ROUNDING) * effort, np.zeros(effort.size), np.zeros(len(E)))


@compiled
def share_left(feedback: Array, more: Array, limits: MotorLimits) -> float:
    """Largest share, from 0 to 1, of `more` (p,) that a feedback (p,) leaves room for on every motor [N, N m]."""
    share = 1.0
    for j in range(limits.motors.size):
        u, fed, top = 0.0, 0.0, limits.effort[j]
        for i in range(more.size):
            u += limits.E_inv[j, i] * more[i]
            fed += limits.E_inv[j, i] * feedback[i]
        left = max(0.0, top - fed if u > 0.0 else top + fed)
        if abs(u) > left:
            share = min(share, left / abs(u))
    return share if not math.isnan(share) else 0.0


@compiled
def limit(psi_hat: Array, feedback: Array, limits: MotorLimits) -> None:
    """Clip psi_hat, motor by motor, to what the feedback leaves of the limits.

    Args:
        psi_hat: (p,) changed where it asks for too much; one that is no number stays, and the guard sees it [N, N m].
        feedback: (p,) the rest of the torque on nu [N, N m].
        limits: Of the motors.
    """
    motors, clipped = limits.motors, False
    copy_to(psi_hat, limits.asked)
    for j in range(motors.size):
        u, fed, top = 0.0, 0.0, limits.effort[j]
        for i in range(psi_hat.size):
            u += limits.E_inv[j, i] * psi_hat[i]
            fed += limits.E_inv[j, i] * feedback[i]
        low, high = -min(top, max(0.0, top + fed)), min(top, max(0.0, top - fed))
        if math.isnan(u):
            return
        motors[j] = min(max(u, low), high)
        clipped = clipped or motors[j] != u
    for i in range(psi_hat.size if clipped else 0):
        psi_hat[i] = 0.0
        for j in range(motors.size):
            psi_hat[i] += limits.E[i, j] * motors[j]
