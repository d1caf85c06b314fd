"""Psi_hat within what the motors can give, compiled."""

from __future__ import annotations

import math

from ..compiled import compiled
from ..signals import INDEX, Array, IntArray

Z, R, PSI_HAT = INDEX["z"], INDEX["r"], INDEX["psi_hat"]


@compiled
def limit(row: Array, at: IntArray, gain: Array, E: Array, E_inv: Array, effort: Array, motors: Array) -> None:
    """Clip psi_hat: of every motor it takes what the feedback leaves of its torque limit.

    So it never asks for more than a motor can give, alone or with the feedback, unless the feedback alone does.

    Args:
        row: (width,) row of signals; psi_hat is changed where it asks for too much, and where it is no number.
        at: Offsets of the signals.
        gain: (p,) K.
        E: (p, motors) torque on nu from motor torques.
        E_inv: (motors, p) and back.
        effort: (motors,) largest torques of the motors, inf for no limit.
        motors: (motors,) memory to work in.
    """
    psi_hat, z, r = row[at[PSI_HAT] : at[PSI_HAT + 1]], row[at[Z] : at[Z + 1]], row[at[R] : at[R + 1]]
    clipped = False
    for j in range(effort.size):
        u, fed, top = 0.0, 0.0, effort[j]
        for i in range(gain.size):
            u += E_inv[j, i] * psi_hat[i]
            fed += E_inv[j, i] * gain[i] * (z[i] if i < z.size else r[i - z.size])
        low, high = -min(top, max(0.0, top + fed)), min(top, max(0.0, top - fed))
        motors[j] = min(max(u, low), high) if not math.isnan(u) else 0.0
        clipped = clipped or motors[j] != u
    for i in range(gain.size if clipped else 0):
        psi_hat[i] = 0.0
        for j in range(effort.size):
            psi_hat[i] += E[i, j] * motors[j]
