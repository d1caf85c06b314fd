"""Fixed-step integration of the reduced dynamics, compiled: RK4, semi-implicit Euler, and two for stiff friction.

The integrated vector is `y = [position (nv), nu (p), work (1)]`; the work is what torques and friction have done, so
that `energy - work` is conserved and its drift is the balance's residual.

Motion of a link of 4e-6 kg m^2 against 1 N m s dies out in microseconds: an explicit method cannot follow it. With
implicit friction an Euler step takes friction at the velocity that it ends with,

    M (nu_new - nu) / dt + F(nu_new) = tau - C nu - gravity,

where a convex function is least, found by Newton's method. Such a step and two of half its length give `y = 2 y_halves
- y_whole`, of second order, in which motion too fast for the step still dies out (linearly implicit extrapolation after
Deuflhard 1985; Hairer and Wanner, Solving Ordinary Differential Equations II, IV.9).

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
from ..model.reduction import COULOMB_SPEED, dry_level, friction, position_rate, solve, spread, substitute
from ..signals import Array

RK4, SEMI_IMPLICIT, IMPLICIT_FRICTION, STICK = 0, 1, 2, 3
METHODS = {"rk4": RK4, "semi_implicit_euler": SEMI_IMPLICIT, "implicit_friction": IMPLICIT_FRICTION, "stick": STICK}
ORDER = {"rk4": 4, "semi_implicit_euler": 1, "implicit_friction": 2, "stick": 1}
STAGES = (4, 1, 2, 1)  # states of every step at which a method wants the dynamics
SWEEPS = 100  # of Gauss-Seidel at most
ITERATIONS, HALVINGS = 50, 40  # of Newton's method at most


@by_address
class PlantJoints(NamedTuple):
    """A robot as an integrator sees it."""

    T: Array  # (nv, p) map from nu to the velocities of all joints
    damping: Array  # (nv,) viscous friction of the joints
    dry: Array  # (nv, 3) dry friction of the joints
    viscous: Array  # (p,) viscous friction on nu
    base: int  # number of base velocities
    sideways: bool  # whether they are `(vx, vy, w)`
    eta: Array  # (3,) `(vx, vy, w)` at the state, of a base that steers; (0,) of others
    V: Array  # (3, nb) its map from the base velocities; (3, 0) of others


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
    """The terms of the dynamics at a state, and scratch."""

    v: Array  # (nv,) `T nu`
    M: Array  # (p, p) reduced mass matrix
    h: Array  # (p,) `C nu + gravity + friction`
    F: Array  # (p,) friction
    hold: Array  # (nv,) further dry friction, of joints that are blocked
    ydot: Array  # (nv + p + 1,) time derivative of y, written
    L: Array  # (p, p) scratch: Cholesky factor of M
    rest: Array  # (p,) scratch
    grip: Array  # (nv, p + 2) scratch of the method `stick`
    A: Array  # (p, p) scratch of implicit friction
    new: Array  # (p,) velocity at the end of an implicit step
    rates: Array  # (nv,) scratch of implicit friction


def plant_terms(v: Array, M: Array, h: Array, F: Array, hold: Array, ydot: Array) -> PlantTerms:
    """The terms of the dynamics, written elsewhere, with scratch of their own."""
    nv, p = v.size, F.size
    scratch = (np.zeros(shape) for shape in ((p, p), (p,), (nv, p + 2), (p, p), (p,), (nv,)))
    return PlantTerms(v, M, h, F, hold, ydot, *scratch)


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


@linked
def implicit_stage(
    stage: int, dt: float, joints: PlantJoints, terms: PlantTerms, tau: Array, y: Array, whole: Array, trial: Array
) -> None:
    """One of the two stages of a step with implicit friction.

    Args:
        stage: 0 with the terms at y, after which they are wanted at trial; 1 with those.
        dt: Step [s].
        joints: The robot.
        terms: Where the stage begins; v changes.
        tau: (p,) generalized torque.
        y: (nv + p + 1,) start of the step, in stage 1 moved on.
        whole: Written in stage 0: the end by one Euler step.
        trial: Written: the middle, in stage 1 the end by two Euler steps.
    """
    if stage == 0:
        implicit_euler(dt, joints, terms, tau, y, whole)
        implicit_euler(0.5 * dt, joints, terms, tau, y, trial)
        return
    implicit_euler(0.5 * dt, joints, terms, tau, trial, trial)
    for i in range(y.size):
        y[i] = 2.0 * trial[i] - whole[i]


@internal
def implicit_euler(dt: float, joints: PlantJoints, terms: PlantTerms, tau: Array, y: Array, out: Array) -> None:
    """One Euler step with the friction of its end, from y to out, (nv + p + 1,) each, which may be the same.

    The velocity is found by Newton's method. Slopes leave out that the level of dry friction changes with the velocity,
    so that their matrix is positive definite.
    """
    nv, p, new, lacking = terms.v.size, tau.size, terms.new, terms.rest
    nu, step = y[nv : nv + p], terms.ydot[nv : nv + p]
    for j in range(p):
        new[j] = nu[j]
    for _ in range(ITERATIONS):
        slopes(dt, joints, terms)
        lack(dt, joints, terms, tau, nu)
        solve(terms.A, lacking, terms.L, step)
        share = line_search(joints, terms, step)
        for j in range(p):
            new[j] += share * step[j]
        if not fastest(joints, terms) > 1e-6 * COULOMB_SPEED:  # the next would be that to the square, by COULOMB_SPEED
            break
    spread(joints.T, new, terms.v)
    friction(joints.T, terms.v, new, joints.damping, joints.dry, joints.viscous, lacking)
    move_on(dt, joints, terms, tau, lacking, new, y, out)


@compiled
def dry_force(v: float, dry: Array) -> tuple[float, float]:
    """Smooth dry friction of a joint at a velocity, and its slope at a given level."""
    level, share = dry_level(v, dry), tanh(v / COULOMB_SPEED)
    return level * share, level * (1.0 - share * share) / COULOMB_SPEED


@internal
def lack(dt: float, joints: PlantJoints, terms: PlantTerms, tau: Array, nu: Array) -> None:
    """`terms.rest = tau - C nu - gravity - F(new) - M (new - nu) / dt`, with `terms.v = T new`."""
    p, new, rest = tau.size, terms.new, terms.rest
    spread(joints.T, new, terms.v)
    friction(joints.T, terms.v, new, joints.damping, joints.dry, joints.viscous, rest)
    for j in range(p):
        rest[j] = tau[j] - (terms.h[j] - terms.F[j]) - rest[j]
        for k in range(p):
            rest[j] -= terms.M[j, k] * (new[k] - nu[k]) / dt


@internal
def slopes(dt: float, joints: PlantJoints, terms: PlantTerms) -> None:
    """`terms.A = M / dt + dF / dnu` at the velocity `terms.new`; v becomes `T new`."""
    T, v, A, p = joints.T, terms.v, terms.A, joints.viscous.size
    spread(T, terms.new, v)
    for j in range(p):
        for k in range(p):
            A[j, k] = terms.M[j, k] / dt
        A[j, j] += joints.viscous[j]
    for i in range(v.size):
        slope = joints.damping[i]
        if joints.dry[i, 0] != 0.0:
            slope += dry_force(v[i], joints.dry[i])[1]
        for j in range(p):
            if slope * T[i, j] != 0.0:
                for k in range(p):
                    A[j, k] += T[i, j] * slope * T[i, k]


@linked
def respond(
    dt: float, joints: PlantJoints, terms: PlantTerms, nu: Array, tau: Array, E: Array, free: Array, answer: Array
) -> None:
    """How fast motors turn at the end of a step, `free + answer torques`, with the friction of its end linearised.

    Args:
        dt: Step [s].
        joints: The robot.
        terms: At the state; `rest`, `ydot`, `new`, A and L are scratch.
        nu: (p,) velocity.
        tau: (p,) generalized torque of all but these motors.
        E: (p, motors) speeds of the motors are E' nu.
        free: (motors,) written: without a torque of theirs [rad/s or m/s].
        answer: (motors, motors) written: per torque of each.
    """
    nv, p, rest = terms.v.size, nu.size, terms.rest
    step = terms.ydot[nv : nv + p]
    for i in range(p):
        terms.new[i], rest[i] = nu[i], tau[i] - terms.h[i]
    slopes(dt, joints, terms)
    solve(terms.A, rest, terms.L, step)
    for j in range(free.size):
        free[j] = 0.0
        for i in range(p):
            free[j] += E[i, j] * (nu[i] + step[i])
    for k in range(free.size):
        for i in range(p):
            rest[i] = E[i, k]
        substitute(terms.L, rest)
        for j in range(free.size):
            answer[j, k] = 0.0
            for i in range(p):
                answer[j, k] += E[i, j] * rest[i]


@internal
def line_search(joints: PlantJoints, terms: PlantTerms, step: Array) -> float:
    """Share of Newton's step (p,) after which the convex function rises at most half as steeply as it fell before it.

    `terms.rest` is what the equation lacks before it, v the velocities of the joints; `rates` becomes `T step`.
    """
    v, rates, share, fall = terms.v, terms.rates, 1.0, 0.0
    spread(joints.T, step, rates)
    for j in range(step.size):
        fall += step[j] * terms.rest[j]
    for _ in range(HALVINGS):
        rise = (share - 1.0) * fall
        for i in range(v.size):
            if joints.dry[i, 0] != 0.0:
                force, slope = dry_force(v[i], joints.dry[i])
                there, _ = dry_force(v[i] + share * rates[i], joints.dry[i])
                rise += rates[i] * (there - force - share * slope * rates[i])
        if not rise > 0.5 * fall:
            break
        share *= 0.5
    return share


@internal
def fastest(joints: PlantJoints, terms: PlantTerms) -> float:
    """Largest `terms.rates` of a joint with dry friction; 0 without any, where Newton's first step is exact."""
    found = 0.0
    for i in range(terms.rates.size):
        if joints.dry[i, 0] != 0.0:
            found = max(found, abs(terms.rates[i]))
    return found


@internal
def brake(dt: float, joints: PlantJoints, terms: PlantTerms) -> None:
    """Add `dt D` to M, so that `(M + dt D) nudot = tau - h` gives a step with the viscous friction of its end."""
    T, viscous, damping, M = joints.T, joints.viscous, joints.damping, terms.M
    for j in range(viscous.size):
        M[j, j] += dt * viscous[j]
    for i in range(damping.size):
        if damping[i] != 0.0:
            ratio = dt * damping[i]
            for j in range(viscous.size):
                for k in range(viscous.size):
                    M[j, k] += T[i, j] * ratio * T[i, k]


@internal
def viscous_ahead(dt: float, joints: PlantJoints, terms: PlantTerms) -> None:
    """Viscous friction in F (p,) at the start of a step becomes that of its end, `F + dt D nudot`."""
    T, viscous, damping, F, nv = joints.T, joints.viscous, joints.damping, terms.F, terms.v.size
    nudot = terms.ydot[nv : nv + F.size]
    for j in range(viscous.size):
        F[j] += dt * viscous[j] * nudot[j]
    for i in range(nv):
        if damping[i] != 0.0:
            rate = 0.0
            for j in range(viscous.size):
                rate += T[i, j] * nudot[j]
            for j in range(viscous.size):
                F[j] += T[i, j] * dt * damping[i] * rate


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
    """One step of semi-implicit Euler: nu first, then the position with the new nu.

    With the method `STICK` friction is that of the end of the step, and M, h and F change.

    Args:
        method: `SEMI_IMPLICIT` or `STICK`.
        dt: Step [s].
        joints: The robot.
        terms: At y; v becomes `T nu` of the new nu.
        tau: (p,) generalized torque.
        y: (nv + p + 1,) position, nu and work, moved on.
    """
    nv, p, new, ydot = terms.v.size, tau.size, terms.rest, terms.ydot
    if method == STICK:
        release(joints, terms)
        brake(dt, joints, terms)
    derivative(y, tau, joints, terms)
    if method == STICK:
        viscous_ahead(dt, joints, terms)
    for i in range(p):
        new[i] = y[nv + i] + dt * ydot[nv + i]
    if method == STICK:
        stick(dt, joints, terms)
    move_on(dt, joints, terms, tau, terms.F, new, y, y)


@internal
def move_on(
    dt: float, joints: PlantJoints, terms: PlantTerms, tau: Array, F: Array, new: Array, y: Array, out: Array
) -> None:
    """The end of an Euler step whose nu is known: the position by the new nu, the work by the trapezoid of nu.

    Args:
        dt: Step [s].
        joints: The robot.
        terms: v becomes `T nu` of the new nu.
        tau: (p,) generalized torque.
        F: (p,) friction.
        new: (p,) nu at the end.
        y: (nv + p + 1,) position, nu and work at the start.
        out: Those of the end, written; may be y.
    """
    nv, p, v, ydot, work = terms.v.size, tau.size, terms.v, terms.ydot, 0.0
    for i in range(p):
        work += 0.5 * (y[nv + i] + new[i]) * (tau[i] - F[i])
        out[nv + i] = new[i]
    out[nv + p] = y[nv + p] + dt * work
    spread(joints.T, new, v)
    if joints.eta.size:
        spread(joints.V, new[: joints.base], joints.eta)
    position_rate(y[:nv], new, v, joints.base, joints.sideways, joints.eta, ydot[:nv])
    for i in range(nv):
        out[i] = y[i] + dt * ydot[i]
