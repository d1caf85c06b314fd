"""The stiffness that delay and period bear: at which a compliant hand, held between samples, turns unstable.

At the start, about rest, with `d' = nu` for small motions and K_k the arm's kinematic gains:

    M nu' + B nu = tau,   tau = -J' K J d - J' D J nu - P' K P (nu + N K_k d) - M N K_k nu,   held, late by L

Velocities that take no torque follow what is asked for by their servo, `nu_s' = b (-N K_k d - nu)_s`. The hand is free,
and on damped springs in the world from soft to stiff; all must be stable.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm

from ..errors import ConfigError
from ..signals import Array

WALLS = (0.0, 1e3, 1e4, 1e5)  # what the hand may touch [N/m]
YIELDING = 0.005  # its damping over its stiffness [s]
TOLERANCE = 1e-7
HALVINGS = 12


class Held(NamedTuple):
    """The loop around a compliant hand.

    Attributes:
        gains: (p,) K.
        rates: (p,) of the kinematic layer, 0 of the base [1/s].
        period: Control period [s].
        delay: From the measurement to the torque [s].
        on: (p,) 1 for velocities that take no torque.
        bandwidth: (p,) of their servos [1/s].
        friction: (p, p) viscous friction on nu.
    """

    gains: Array
    rates: Array
    period: float
    delay: float
    on: Array
    bandwidth: Array
    friction: Array


class Bound(NamedTuple):
    """Result of `bound_of`.

    Attributes:
        factor: Largest factor on all stiffnesses, their damping with its root, that is stable; 0 where none is.
        held: The loop.
    """

    factor: float
    held: Held

    def require(self, impedance: Any) -> None:
        """Refuse a stiffness beyond the bound.

        Raises:
            ConfigError: With the bound.
        """
        if self.factor >= 1.0:
            return
        largest = float(np.max(impedance.stiffness))
        late = 1e3 * self.held.delay
        why = f"with {late:.3g} ms of delay and a period of {1e3 * self.held.period:.3g} ms "
        if self.factor <= 0.0:
            fix = "give less damping, lower feedback gains, or a shorter period"
            raise ConfigError("the compliant hand", why=f"{why}its damping alone is unstable", fix=fix, key="impedance")
        most = math.floor(0.98 * self.factor * largest)
        texts = [f"at most {most}"] + (["rotation in proportion"] if np.any(impedance.rotation) else [])
        raise ConfigError(
            f"{largest:g} N/m",
            why=f"{why}the bound is {self.factor * largest:.4g} N/m",
            fix=f"use {', '.join(texts)}",
            key="impedance.stiffness",
        )


def bound_of(c: Any, M: Array, held: Held) -> Bound:
    """The bound of a compliance where `c.work.J` has its Jacobian, with the mass matrix M (p, p) there."""
    J, p = c.work.J[: c.rows], len(M)
    W = np.diag(c.weights)
    A = J @ W @ J.T
    A += 1e-6 * np.trace(A) * np.eye(len(A))
    N = np.eye(p) - W @ J.T @ np.linalg.solve(A, J)
    X = np.linalg.solve(M, J.T)
    A = J @ X
    P = np.eye(p) - X @ np.linalg.solve(A + 1e-6 * np.trace(A) * np.eye(len(A)), J)
    still, rates = P.T @ np.diag(c.still) @ P, np.diag(held.rates)
    springs, dampers = J.T @ np.diag(c.springs[: c.rows]) @ J, J.T @ np.diag(c.dampers[: c.rows]) @ J
    asks = N @ rates

    def stable(factor: float) -> bool:
        F = np.hstack((factor * springs + still @ asks, math.sqrt(factor) * dampers + still + M @ asks))
        return all(radius(F, asks, M, wall * J[:3].T @ J[:3], held) <= 1.0 + TOLERANCE for wall in WALLS)

    if stable(1.0):
        low, high = 1.0, 2.0
        while high < 1e3 and stable(high):
            low, high = high, 2.0 * high
    else:
        low, high = 0.5, 1.0
        while low > 1e-3 and not stable(low):
            low, high = 0.5 * low, low
        if low <= 1e-3:
            return Bound(0.0, held)
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return Bound(low, held)


def radius(F: Array, asks: Array, M: Array, wall: Array, held: Held) -> float:
    """Spectral radius of one period.

    Args:
        F: (p, 2 p) torque against displacements and velocities, late and held.
        asks: (p, p) velocities asked for against displacements, likewise.
        M: (p, p) mass matrix.
        wall: (p, p) stiffness of the world, which acts at once.
        held: The loop.
    """
    p, on = len(M), held.on > 0.0
    e, s = np.flatnonzero(~on), np.flatnonzero(on)
    rates, B, F = np.zeros((2 * p, 2 * p)), np.zeros((2 * p, p)), F.copy()
    rates[:p, p:] = np.eye(p)
    rates[p + s, p + s] = -held.bandwidth[s]
    B[p + s, s] = held.bandwidth[s]
    F[s, :p], F[s, p:] = asks[s], 0.0
    if len(e):
        M_inv = np.linalg.inv(M[np.ix_(e, e)])
        pull = M_inv @ M[np.ix_(e, s)]
        rates[p + e] = -pull @ rates[p + s]
        rates[p + e, :p] -= M_inv @ wall[e]
        rates[p + e, p:] -= M_inv @ (held.friction[e] + YIELDING * wall[e])
        B[p + e] = -pull @ B[p + s]
        B[np.ix_(p + e, e)] += M_inv
    whole = expm(np.block([[rates, B], [np.zeros((p, 3 * p))]]) * held.period)
    state, torque = whole[: 2 * p, : 2 * p], whole[: 2 * p, 2 * p :]
    late = math.ceil(held.delay / held.period - 1e-9)
    if not late:
        return float(np.abs(np.linalg.eigvals(state - torque @ F)).max())
    n = (2 + late) * p
    closed = np.zeros((n, n))  # torques under way follow the state, the newest first; the oldest acts
    closed[: 2 * p, : 2 * p], closed[: 2 * p, n - p :] = state, torque
    closed[2 * p : 3 * p, : 2 * p] = -F
    closed[3 * p :, 2 * p : n - p] = np.eye(n - 3 * p)
    return float(np.abs(np.linalg.eigvals(closed)).max())
