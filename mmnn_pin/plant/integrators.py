"""Fixed-step integration of the reduced dynamics, compiled: RK4 and semi-implicit Euler, also with implicit friction.

The integrated vector is `y = [position (nv), nu (p), work (1)]`; the work is what torques and friction have done, so
that `energy - work` is conserved and its drift is the balance's residual.

Motion of a link of 4e-6 kg m^2 against 1 N m s dies out in microseconds: an explicit method cannot follow it. With
implicit friction the force is `F = S nu_new`, S the ratio of friction to velocity at the start of the step, stable at
any step.
"""

from __future__ import annotations

import math

from ..compiled import compiled
from ..model.reduction import COULOMB_SPEED, position_rate, solve, spread
from ..signals import Array

RK4, SEMI_IMPLICIT, IMPLICIT_FRICTION = 0, 1, 2
METHODS = {"rk4": RK4, "semi_implicit_euler": SEMI_IMPLICIT, "implicit_friction": IMPLICIT_FRICTION}
ORDER = {"rk4": 4, "semi_implicit_euler": 1, "implicit_friction": 1}


@compiled
def derivative(
    y: Array, v: Array, M: Array, h: Array, F: Array, tau: Array, base: int, L: Array, rest: Array, ydot: Array
) -> None:
    """Time derivative of y under the torque tau.

    Args:
        y: (nv + p + 1,) position, nu, work.
        v: (nv,) `T nu`.
        M: (p, p) reduced mass matrix.
        h: (p,) `C nu + gravity + friction`.
        F: (p,) friction.
        tau: (p,) generalized torque.
        base: Number of base velocities.
        L: (p, p) scratch.
        rest: (p,) scratch.
        ydot: (nv + p + 1,) written.
    """
    nv, p = v.size, tau.size
    nu = y[nv : nv + p]
    position_rate(y[:nv], nu, v, base, ydot[:nv])
    power = 0.0
    for i in range(p):
        rest[i] = tau[i] - h[i]
        power += nu[i] * (tau[i] - F[i])
    solve(M, rest, L, ydot[nv : nv + p])
    ydot[nv + p] = power


@compiled
def rk4_stage(stage: int, dt: float, y: Array, ydot: Array, total: Array, trial: Array) -> None:
    """Take in the derivative of one of the four stages; trial is where the next one is evaluated, or the result.

    Args:
        stage: 0 to 3.
        dt: Step [s].
        y: Start of the step.
        ydot: Derivative at this stage.
        total: Weighted sum of the derivatives, scratch.
        trial: Written.
    """
    if stage == 0:
        total[:] = 0.0
    weight = 1.0 if stage == 0 or stage == 3 else 2.0
    ahead = dt if stage == 2 else 0.5 * dt
    for i in range(y.size):
        total[i] += weight * ydot[i]
        trial[i] = y[i] + (ahead * ydot[i] if stage < 3 else dt / 6.0 * total[i])


@compiled
def semi_implicit(
    dt: float, T: Array, F: Array, tau: Array, base: int, y: Array, v: Array, ydot: Array, out: Array
) -> None:
    """Semi-implicit Euler: nu first, then the position with the new nu; the work by the trapezoid of nu.

    Arguments as in `derivative`, with ydot the derivative at y; out is written and v becomes `T nu` of the new nu.
    """
    nv, p = v.size, tau.size
    nu, new = y[nv : nv + p], out[nv : nv + p]
    work = 0.0
    for i in range(p):
        new[i] = nu[i] + dt * ydot[nv + i]
        work += 0.5 * (nu[i] + new[i]) * (tau[i] - F[i])
    spread(T, new, v)
    position_rate(y[:nv], new, v, base, ydot[:nv])
    for i in range(nv):
        out[i] = y[i] + dt * ydot[i]
    out[nv + p] = y[nv + p] + dt * work


@compiled
def friction_ratio(v: float, damping: float, coulomb: float) -> float:
    """Friction of a joint divided by its velocity v."""
    if abs(v) < 1e-6 * COULOMB_SPEED:
        return damping + coulomb / COULOMB_SPEED
    return damping + coulomb * math.tanh(v / COULOMB_SPEED) / v


@compiled
def stiffen(dt: float, T: Array, v: Array, damping: Array, coulomb: Array, viscous: Array, M: Array) -> None:
    """Add `dt S` to M, so that `(M + dt S) nudot = tau - h` gives the velocity after a step with `F = S nu_new`.

    Args:
        dt: Step [s].
        T: (nv, p) map to all velocities.
        v: (nv,) `T nu`.
        damping: (nv,) viscous friction of the joints.
        coulomb: (nv,) Coulomb friction of the joints.
        viscous: (p,) viscous friction on nu.
        M: (p, p) changed.
    """
    for j in range(viscous.size):
        M[j, j] += dt * viscous[j]
    for i in range(v.size):
        if damping[i] != 0.0 or coulomb[i] != 0.0:
            ratio = dt * friction_ratio(v[i], damping[i], coulomb[i])
            for j in range(viscous.size):
                for k in range(viscous.size):
                    M[j, k] += T[i, j] * ratio * T[i, k]


@compiled
def friction_ahead(
    dt: float, T: Array, v: Array, damping: Array, coulomb: Array, viscous: Array, nudot: Array, F: Array
) -> None:
    """Friction F (p,) at the start of a step becomes that of its end, `F + dt S nudot`; arguments as in `stiffen`."""
    for j in range(viscous.size):
        F[j] += dt * viscous[j] * nudot[j]
    for i in range(v.size):
        if damping[i] != 0.0 or coulomb[i] != 0.0:
            rate = 0.0
            for j in range(viscous.size):
                rate += T[i, j] * nudot[j]
            force = dt * friction_ratio(v[i], damping[i], coulomb[i]) * rate
            for j in range(viscous.size):
                F[j] += T[i, j] * force
