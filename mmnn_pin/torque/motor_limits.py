"""Psi_hat within what the motors can give: the last stage of every law before its torque. Compiled.

Of every motor Psi_hat takes what the feedback leaves of its torque limit. So it never asks for more than a motor can
give, alone or with the feedback, unless the feedback alone does; and it is bounded, whatever the weights are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compiled import compiled
from ..signals import Array


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
    return MotorLimits(E, E_inv, np.array(effort, float), np.zeros(effort.size), np.zeros(len(E)))


@compiled
def limit(psi_hat: Array, feedback: Array, limits: MotorLimits) -> None:
    """Clip psi_hat, motor by motor, to what the feedback leaves of the limits.

    Args:
        psi_hat: (p,) changed where it asks for too much, and where it is no number [N, N m].
        feedback: (p,) the rest of the torque on nu [N, N m].
        limits: Of the motors.
    """
    motors, clipped = limits.motors, False
    for j in range(motors.size):
        u, fed, top = 0.0, 0.0, limits.effort[j]
        for i in range(psi_hat.size):
            u += limits.E_inv[j, i] * psi_hat[i]
            fed += limits.E_inv[j, i] * feedback[i]
        low, high = -min(top, max(0.0, top + fed)), min(top, max(0.0, top - fed))
        motors[j] = min(max(u, low), high) if not math.isnan(u) else 0.0
        clipped = clipped or motors[j] != u
    for i in range(psi_hat.size):
        limits.asked[i] = psi_hat[i]
        if clipped:
            psi_hat[i] = 0.0
            for j in range(motors.size):
                psi_hat[i] += limits.E[i, j] * motors[j]
