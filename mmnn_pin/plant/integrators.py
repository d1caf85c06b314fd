"""Fixed-step integration of the reduced dynamics, compiled: RK4 and semi-implicit Euler, with three kinds of friction.

The integrated vector is `y = [position (nv), nu (p), work (1)]`; the work is what torques and friction have done, so
that `energy - work` is conserved and its drift is the balance's residual.

Motion of a link of 4e-6 kg m^2 against 1 N m s dies out in microseconds: an explicit method cannot follow it. With
implicit friction the force is `F = S nu_new`, S the ratio of friction to velocity at the start of the step, stable at
any step.

Friction that really sticks is no function of the velocity. The method `stick` takes the impulse of dry friction on a
joint as the one within `+-level dt` that brings the joint to rest, or comes nearest to it (time stepping after
Stewart and Trinkle 1996; the box-constrained problem is solved by projected Gauss-Seidel). Viscous friction is
implicit there, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import compiled, internal, linked
from ..elementary import tanh
from ..model.base.rolling import Maps
from ..model.reduction import COULOMB_SPEED, dry_level, position_rate, solve, spread, substitute
from ..signals import Array

RK4, SEMI_IMPLICIT, IMPLICIT_FRICTION, STICK = 0, 1, 2, 3
METHODS = {"rk4": RK4, "semi_implicit_euler": SEMI_IMPLICIT, "implicit_friction": IMPLICIT_FRICTION, "stick": STICK}
ORDER = {"rk4": 4, "semi_implicit_euler": 1, "implicit_friction": 1, "stick": 1}
SWEEPS = 100  # of Gauss-Seidel at most


@by_address
class PlantJoints(NamedTuple):
    """A robot as an integrator sees it.

    Attributes:
        T: (nv, p) map from nu to the velocities of all joints.
        damping: (nv,) viscous friction of the joints.
        dry: (nv, 3) dry friction of the joints.
        viscous: (p,) viscous friction on nu.
        base: Number of base velocities.
        sideways: Whether they are `(vx, vy, w)`.
        eta: (3,) `(vx, vy, w)` at the state, of a base that steers; (0,) of others.
        V: (3, nb) its map from the base velocities; (3, 0) of others.
    """

    T: Array
    damping: Array
    dry: Array
    viscous: Array
    base: int
    sideways: bool
    eta: Array
    V: Array


def plant_joints(friction: tuple[Array, Array, Array], base: int, sideways: bool, maps: Maps) -> PlantJoints:
    """A robot as an integrator sees it.

    Args:
        friction: `damping`, `dry`, `viscous`.
        base: Number of base velocities.
        sideways: Whether a twist is `(vx, vy, w)`.
        maps: Those that its dynamics write.
    """
    damping, dry, viscous = map(np.array, friction)  # writable: compiled code exists once for these
    return PlantJoints(maps.T, damping, dry, viscous, base, sideways, maps.eta, maps.V[0])


@by_address
class PlantTerms(NamedTuple):
    """The terms of the dynamics at a state, and scratch.

    Attributes:
        v: (nv,) `T nu`.
        M: (p, p) reduced mass matrix.
        h: (p,) `C nu + gravity + friction`.
        F: (p,) friction.
        hold: (nv,) further dry friction, of joints that are blocked.
        ydot: (nv + p + 1,) time derivative of y, written.
        L: (p, p) scratch: Cholesky factor of M.
        rest: (p,) scratch.
        grip: (nv, p + 2) scratch of the method `stick`.
    """

    v: Array
    M: Array
    h: Array
    F: Array
    hold: Array
    ydot: Array
    L: Array
    rest: Array
    grip: Array


@linked
def derivative(y: Array, tau: Array, joints: PlantJoints, terms: PlantTerms) -> None:
    """Time derivative of y, into `terms.ydot`, under the generalized torque tau (p,)."""
    nv, p, rest, ydot = terms.v.size, tau.size, terms.rest, terms.ydot
    nu = y[nv : nv + p]
    position_rate(y[:nv], nu, terms.v, joints.base, joints.sideways, joints.eta, ydot[:nv])
    power = 0.0
    for i in range(p):
        rest[i] = tau[i] - terms.h[i]
        power += nu[i] * (tau[i] - terms.F[i])
    solve(terms.M, rest, terms.L, ydot[nv : nv + p])
    ydot[nv + p] = power


@linked
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
def friction_ratio(v: float, damping: float, dry: Array) -> float:
    """Friction of a joint divided by its velocity v."""
    level = dry_level(v, dry)
    if abs(v) < 1e-6 * COULOMB_SPEED:
        return damping + level / COULOMB_SPEED
    return damping + level * tanh(v / COULOMB_SPEED) / v


@internal
def stiffen(dt: float, joints: PlantJoints, smooth: bool, terms: PlantTerms) -> None:
    """Add `dt S` to M, so that `(M + dt S) nudot = tau - h` gives the velocity after a step with `F = S nu_new`.

    Args:
        dt: Step [s].
        joints: The robot.
        smooth: Whether dry friction is part of F.
        terms: At the start of the step; M changes.
    """
    T, viscous, damping, dry, v, M = joints.T, joints.viscous, joints.damping, joints.dry, terms.v, terms.M
    for j in range(viscous.size):
        M[j, j] += dt * viscous[j]
    for i in range(v.size):
        if damping[i] != 0.0 or (smooth and dry[i, 0] != 0.0):
            ratio = dt * (friction_ratio(v[i], damping[i], dry[i]) if smooth else damping[i])
            for j in range(viscous.size):
                for k in range(viscous.size):
                    M[j, k] += T[i, j] * ratio * T[i, k]


@internal
def friction_ahead(dt: float, joints: PlantJoints, smooth: bool, terms: PlantTerms) -> None:
    """Friction F (p,) at the start of a step becomes that of its end, `F + dt S nudot`; arguments as in `stiffen`."""
    T, viscous, damping, dry, v, F = joints.T, joints.viscous, joints.damping, joints.dry, terms.v, terms.F
    nudot = terms.ydot[v.size : v.size + F.size]
    for j in range(viscous.size):
        F[j] += dt * viscous[j] * nudot[j]
    for i in range(v.size):
        if damping[i] != 0.0 or (smooth and dry[i, 0] != 0.0):
            rate = 0.0
            for j in range(viscous.size):
                rate += T[i, j] * nudot[j]
            ratio = friction_ratio(v[i], damping[i], dry[i]) if smooth else damping[i]
            for j in range(viscous.size):
                F[j] += T[i, j] * dt * ratio * rate


@compiled
def release(joints: PlantJoints, terms: PlantTerms) -> None:
    """Take smooth dry friction out of h (p,) and F (p,)."""
    T, dry, v, h, F = joints.T, joints.dry, terms.v, terms.h, terms.F
    for i in range(v.size):
        if dry[i, 0] != 0.0:
            force = dry_level(v[i], dry[i]) * tanh(v[i] / COULOMB_SPEED)
            for j in range(F.size):
                h[j] -= T[i, j] * force
                F[j] -= T[i, j] * force


@internal
def stick(dt: float, joints: PlantJoints, terms: PlantTerms) -> None:
    """Impulses of dry friction: each within `+-level dt`, bringing its joint to rest or as near to it as they can.

    Args:
        dt: Step [s].
        joints: The robot.
        terms: With v at the start of the step, where the levels are taken. `rest` is the velocity without dry friction
            and becomes that with it; to F is added what the impulses are. A row of `grip` becomes the response of nu to
            an impulse on a joint, that of the joint itself, and the impulse.
    """
    prepare_grip(joints, terms)
    for _ in range(SWEEPS):
        if sweep(dt, joints, terms) < 1e-13:
            break
    T, grip, p = joints.T, terms.grip, terms.F.size
    for i in range(T.shape[0]):
        for j in range(p):
            terms.F[j] -= T[i, j] * grip[i, p + 1] / dt


@internal
def prepare_grip(joints: PlantJoints, terms: PlantTerms) -> None:
    """Responses to impulses into the rows of `terms.grip`, which begin with no impulse."""
    T, dry, hold, grip = joints.T, joints.dry, terms.hold, terms.grip
    nv, p = T.shape
    for i in range(nv):
        grip[i, p + 1] = 0.0
        if dry[i, 0] != 0.0 or hold[i] != 0.0:
            answer, grip[i, p] = grip[i, :p], 0.0
            for j in range(p):
                answer[j] = T[i, j]
            substitute(terms.L, answer)
            for j in range(p):
                grip[i, p] += T[i, j] * answer[j]


@internal
def sweep(dt: float, joints: PlantJoints, terms: PlantTerms) -> float:
    """One impulse after the other as the present velocity asks; the largest change of one, over its limit."""
    T, dry, v, hold, grip, new = joints.T, joints.dry, terms.v, terms.hold, terms.grip, terms.rest
    nv, p = T.shape
    change = 0.0
    for i in range(nv):
        if (dry[i, 0] == 0.0 and hold[i] == 0.0) or grip[i, p] <= 0.0:
            continue
        speed = 0.0
        for j in range(p):
            speed += T[i, j] * new[j]
        most = (dry_level(v[i], dry[i]) + hold[i]) * dt
        step = min(max(grip[i, p + 1] - speed / grip[i, p], -most), most) - grip[i, p + 1]
        grip[i, p + 1] += step
        change = max(change, abs(step) / most)
        for j in range(p):
            new[j] += step * grip[i, j]
    return change


@linked
def euler(method: int, dt: float, joints: PlantJoints, terms: PlantTerms, tau: Array, y: Array) -> None:
    """One step of semi-implicit Euler: nu first, then the position with the new nu; the work by the trapezoid of nu.

    With the methods `IMPLICIT_FRICTION` and `STICK` the friction is that of the end of the step, and M, h and F change.

    Args:
        method: One of `METHODS`, not RK4.
        dt: Step [s].
        joints: The robot.
        terms: At y; v becomes `T nu` of the new nu.
        tau: (p,) generalized torque.
        y: (nv + p + 1,) position, nu and work, moved on.
    """
    nv, p, v, F, rest, ydot = terms.v.size, tau.size, terms.v, terms.F, terms.rest, terms.ydot
    implicit, smooth = method in (IMPLICIT_FRICTION, STICK), method != STICK
    if not smooth:
        release(joints, terms)
    if implicit:
        stiffen(dt, joints, smooth, terms)
    derivative(y, tau, joints, terms)
    if implicit:
        friction_ahead(dt, joints, smooth, terms)
    for i in range(p):
        rest[i] = y[nv + i] + dt * ydot[nv + i]
    if not smooth:
        stick(dt, joints, terms)
    work = 0.0
    for i in range(p):
        work += 0.5 * (y[nv + i] + rest[i]) * (tau[i] - F[i])
        y[nv + i] = rest[i]
    new = y[nv : nv + p]
    spread(joints.T, new, v)
    if joints.eta.size:
        spread(joints.V, new[: joints.base], joints.eta)
    position_rate(y[:nv], new, v, joints.base, joints.sideways, joints.eta, ydot[:nv])
    for i in range(nv):
        y[i] += dt * ydot[i]
    y[nv + p] += dt * work
