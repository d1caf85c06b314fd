"""The stiffness that delay and period bear: at which a compliant hand, held between samples, turns unstable.

At the start, about rest, with `d' = nu` for small motions and K_k the arm's kinematic gains:

    M nu' + B nu = tau,   tau = -J' K J d - J' D J nu - P' K P (nu + N K_k d) - M N K_k nu,   held, late by L

Velocities that take no torque follow what is asked for by their servo, `nu_s' = b (-N K_k d - nu)_s`. The hand is free,
and on damped springs in the world from soft to stiff; all must be stable.

Beside that the hand must give no energy, which asks more of it: J P' = 0 and J N = 0 make it alone what moves it, with
`Lambda = (J M^-1 J')^-1`, and held for h, late by L its impedance is

    j w Lambda + (K_x / (j w) + D) exp(-j w l),    l = L + h / 2,    of real part D cos(w l) - K_x sin(w l) / w

which falls with w. It must not be negative up to the w at which the lightest direction bounces off a wall of `BOUNCES`.
The bound is the stiffness with that, a factor of `RESERVE` below where it turns unstable: nearer to that contacts that
come and go find the little that a held torque gives.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy

from ..elementary import cos_sin
from ..errors import ConfigError
from ..signals import Array

WALLS = (0.0, 1e3, 1e4, 1e5)  # what the hand may touch [N/m]
YIELDING = 0.005  # its damping over its stiffness [s]
BOUNCES = 1e4  # stiffest wall off which the hand may bounce and be given no energy [N/m]
RESERVE = 4.0  # of the stiffness
TOLERANCE = 1e-7
HALVINGS, LEAST, MOST = 12, 1e-12, 1e3  # of a search, and between which factors
SHARE = 0.97  # of the bound, what is printed


class Held(NamedTuple):
    """The loop around a compliant hand."""

    gains: Array  # (p,) K
    rates: Array  # (p,) of the kinematic layer, 0 of the base [1/s]
    period: float  # control period [s]
    delay: float  # from the measurement to the torque [s]
    on: Array  # (p,) 1 for velocities that take no torque
    bandwidth: Array  # (p,) of their servos [1/s]
    friction: Array  # (p, p) viscous friction on nu


class Bound(NamedTuple):
    """Result of `bound_of`."""

    factor: float  # largest factor on all stiffnesses, with the damping that belongs to it, that is borne; 0 for none
    damping: float  # where that is 0, the largest one on all damping of a hand without springs; 0 for none
    margin: float  # delay from which on any damping drives the hand [s]
    held: Held  # the loop

    def require(self, impedance: Any) -> None:
        """Refuse a stiffness or a damping beyond the bound (`ConfigError`)."""
        if self.factor >= 1.0:
            return
        why = f"with {1e3 * self.held.delay:.3g} ms of delay and a period of {1e3 * self.held.period:.3g} ms "
        if self.factor > 0.0:
            largest = float(np.max(impedance.stiffness))
            fix = ", ".join([f"use at most {rounded(self.factor * largest):g}", *also(impedance)])
            why += f"the bound is {self.factor * largest:.4g} N/m"
            raise ConfigError(f"{largest:g} N/m", why=why, fix=fix, key="impedance.stiffness")
        if self.held.delay >= self.margin:
            why = f"from {1e3 * self.margin:.3g} ms on its damper drives what bounces off {BOUNCES / 1e3:g} kN/m"
            most = 1e3 * rounded(0.7 * max(self.margin, 1e-6))
            fix = f"shorten latency.sensing, latency.command and actuator.lag to {most:g} ms together"
            what = f"a compliant hand with {1e3 * self.held.delay:.3g} ms of delay"
            raise ConfigError(what, why=why, fix=fix, key="impedance")
        name = "ratio" if impedance.damping is None else "damping"
        given = float(np.max(getattr(impedance, name)))
        if self.damping <= 0.0:
            fix = "lower feedback.base and feedback.arm, or time.control_period"
            raise ConfigError("a compliant hand", why=why + "its posture is unstable", fix=fix, key="impedance")
        fix = ", ".join([f"use at most {rounded(self.damping * given):g}", *also(impedance)])
        what, bound = f"a {'damping ratio' if name == 'ratio' else name} of {given:g}", self.damping * given
        raise ConfigError(what, why=f"{why}the bound is {bound:.4g}", fix=fix, key=f"impedance.{name}")


def rounded(bound: float) -> float:
    """A little less than a bound, in three digits."""
    return float(f"{SHARE * bound:.2e}")


def also(impedance: Any) -> list[str]:
    """Names of the numbers that have to change beside the largest one on the position."""
    each = [name for name in ("stiffness", "damping") if np.size(getattr(impedance, name)) > 1]
    turned = np.any(impedance.rotation) or np.any(impedance.rotation_damping)
    return [f"{what} in proportion" for what in (["other axes"] if each else []) + (["rotation"] if turned else [])]


def bound_of(c: Any, M: Array, held: Held, damping: Callable[[float], Array]) -> Bound:
    """The bound of a compliance where `c.work.J` has its Jacobian.

    Args:
        c: The compliance.
        M: (p, p) mass matrix there.
        held: The loop.
        damping: (6,) of a factor on all stiffnesses.
    """
    J, p = c.work.J[0, : c.rows], len(M)
    W = np.diag(c.weights)
    A = J @ W @ J.T
    A += 1e-6 * np.trace(A) * np.eye(len(A))
    N = np.eye(p) - W @ J.T @ np.linalg.solve(A, J)
    X = np.linalg.solve(M, J.T)
    A = J @ X
    P = np.eye(p) - X @ np.linalg.solve(A + 1e-6 * np.trace(A) * np.eye(len(A)), J)
    still, rates = P.T @ np.diag(c.still) @ P, np.diag(held.rates)
    asks = N @ rates
    free = np.flatnonzero(held.on == 0.0)
    light = J[:3, free] @ np.linalg.solve(M[np.ix_(free, free)], J[:3, free].T)
    w = math.sqrt(BOUNCES * max(float(np.linalg.eigvalsh(light)[-1]), 1e-9))
    late = held.delay + 0.5 * held.period

    def takes(springs: Array, dampers: Array) -> bool:
        cosine, sine = cos_sin(min(w * late, math.pi))
        real = dampers * cosine - springs * sine / w
        return bool(np.all(real[: c.rows] >= 0.0))

    def stable(factor: float, share: float = 1.0) -> bool:
        if not takes(factor * c.springs, share * damping(factor)):
            return False
        springs = factor * J.T @ np.diag(c.springs[: c.rows]) @ J
        dampers = share * J.T @ np.diag(damping(factor)[: c.rows]) @ J
        F = np.hstack((springs + still @ asks, dampers + still + M @ asks))
        return all(radius(F, asks, M, wall * J[:3].T @ J[:3], held) <= 1.0 + TOLERANCE for wall in WALLS)

    margin = 0.5 * math.pi / w - 0.5 * held.period
    if factor := largest(stable):
        return Bound(factor / RESERVE, 1.0, margin, held)
    return Bound(0.0, largest(lambda share: stable(LEAST, share)) / RESERVE, margin, held)


def largest(stable: Callable[[float], bool]) -> float:
    """The largest number up to which something is stable, from 1 on upwards or downwards; 0 for none."""
    if stable(1.0):
        low, high = 1.0, 2.0
        while high < MOST and stable(high):
            low, high = high, 2.0 * high
    else:
        low, high = 0.5, 1.0
        while low > LEAST and not stable(low):
            low, high = 0.5 * low, low
        if low <= LEAST:
            return 0.0
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


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
    whole = scipy.linalg.expm(np.block([[rates, B], [np.zeros((p, 3 * p))]]) * held.period)
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
