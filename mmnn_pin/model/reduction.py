"""The arithmetic between the full model and the reduced one, compiled: configuration, rates, friction, `T' (.) T`.

The planar root joint has body-frame velocities, so T is constant and `Tdot = 0`: the reduced matrices are plain
projections, equal to the thesis's world-frame `Mbar`, `Cbar` (2.23)-(2.25).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled, linked
from ..elementary import cos_sin, exp, tanh
from ..signals import Array, IntArray

# Dry friction is `level(speed) tanh(speed / COULOMB_SPEED)` where it is a smooth force. [rad/s or m/s]
COULOMB_SPEED = 0.01
SINGULAR = 1e-12  # share of the largest joint's effect: where none moves, none is taken for infinitely much


@linked
def as_measured(
    offset: Array, arm: Array, pose: Array, velocity: Array, q: Array, qdot: Array, position: Array, nu: Array
) -> None:
    """Position (nv,) and nu (p,) of a measurement, in place.

    Slaves stand where their masters have them, and what is not measured (wheel angles) where it rests.

    Args:
        offset: (nv,) position where the arm's joints stand at 0.
        arm: (nv, n) what each arm joint moves, itself and its slaves (see `Robot.arm_map`).
        pose: (3,) measured pose, (0,) for a fixed arm.
        velocity: (nb,) measured base velocity.
        q: (n,) measured joints.
        qdot: (n,) their rates.
        position: Written.
        nu: Written.
    """
    for i in range(offset.size):
        position[i] = offset[i]
        for j in range(q.size):
            position[i] += arm[i, j] * q[j]
    for i in range(pose.size):
        position[i] = pose[i]
    for i in range(velocity.size):
        nu[i] = velocity[i]
    for j in range(q.size):
        nu[velocity.size + j] = qdot[j]


@compiled
def put_shape(places: IntArray, shape: Array, position: Array) -> None:
    """Put the measured angles of a base's pivots into a position (nv,), where they stand."""
    for i in range(places.size):
        position[places[i]] = shape[i]


@compiled
def configuration(
    position: Array,
    nu: Array,
    T: Array,
    frame: Array,
    q_index: IntArray,
    continuous: NDArray[np.uint8],
    q: Array,
    v: Array,
) -> None:
    """Pinocchio's configuration and velocity.

    Args:
        position: (nv,) pose of the control frame (none for a fixed arm), then angle or travel of every joint.
        nu: (p,) independent velocities.
        T: (nv, p) map to all velocities.
        frame: (3,) control frame in the root link (x, y, angle); (0,) for a fixed arm.
        q_index: (nv,) first index in q of every velocity.
        continuous: (nv,) 1 where q holds cosine and sine.
        q: (nq,) written.
        v: (nv,) written.
    """
    first = frame.size
    if first == 3:
        c, s = cos_sin(position[2] - frame[2])
        q[0] = position[0] - c * frame[0] + s * frame[1]
        q[1] = position[1] - s * frame[0] - c * frame[1]
        q[2], q[3] = c, s
    for i in range(first, position.size):
        k = q_index[i]
        if continuous[i]:
            q[k], q[k + 1] = cos_sin(position[i])
        else:
            q[k] = position[i]
    spread(T, nu, v)


@compiled
def spread(T: Array, nu: Array, v: Array) -> None:
    """`v = T nu`."""
    for i in range(v.size):
        total = 0.0
        for j in range(nu.size):
            total += T[i, j] * nu[j]
        v[i] = total


@compiled
def position_rate(position: Array, nu: Array, v: Array, base: int, sideways: bool, eta: Array, rate: Array) -> None:
    """Time derivative of the position, (nv,): `qdot_v = S(phi) v` (2.18) for the pose, `T nu` for the joints.

    Args:
        position: (nv,).
        nu: (p,) independent velocities.
        v: (nv,) `T nu`.
        base: Number of base velocities.
        sideways: Whether they are `(vx, vy, w)`.
        eta: (3,) `(vx, vy, w)` of a base that steers; (0,) of others.
        rate: (nv,) written.
    """
    first = 0
    if base:
        first = 3
        c, s = cos_sin(position[2])
        vx, vy, w = nu[0], nu[1] if sideways else 0.0, nu[base - 1]
        if eta.size:
            vx, vy, w = eta[0], eta[1], eta[2]
        rate[0], rate[1], rate[2] = c * vx - s * vy, s * vx + c * vy, w
    for i in range(first, position.size):
        rate[i] = v[i]


@compiled
def dry_level(v: float, dry: Array) -> float:
    """Largest dry friction of a joint at a velocity, `coulomb + (breakaway - coulomb) exp(-(v / vs)^2)` (Stribeck).

    Args:
        v: Velocity of the joint.
        dry: (3,) coulomb, breakaway - coulomb [N m or N], Stribeck velocity vs [rad/s or m/s].
    """
    if dry[1] == 0.0:
        return dry[0]
    ratio = v / dry[2]
    return dry[0] + dry[1] * exp(-(ratio * ratio))


@compiled
def friction(T: Array, v: Array, nu: Array, damping: Array, dry: Array, viscous: Array, F: Array) -> None:
    """Friction of the joints through T and viscous friction on nu, written to F (p,), opposing the motion.

    `F = T' (damping v + level(v) tanh(v / COULOMB_SPEED)) + viscous nu`, v = T nu, dry (nv, 3) as in `dry_level`.
    """
    for j in range(nu.size):
        F[j] = viscous[j] * nu[j]
    for i in range(v.size):
        if damping[i] != 0.0 or dry[i, 0] != 0.0:
            f = damping[i] * v[i] + dry_level(v[i], dry[i]) * tanh(v[i] / COULOMB_SPEED)
            for j in range(nu.size):
                F[j] += T[i, j] * f


@compiled
def project(T: Array, force: Array, out: Array) -> None:
    """`T' force`, (p,)."""
    out[:] = 0.0
    for i in range(force.size):
        for j in range(out.size):
            out[j] += T[i, j] * force[i]


@compiled
def reduce(T: Array, full: Array, half: Array, out: Array) -> None:
    """`T' full T`, (p, p); half (nv, p) is scratch and holds `full T` afterwards."""
    nv, p = T.shape
    half[:] = 0.0
    for i in range(nv):
        for k in range(nv):
            a = full[i, k]
            if a != 0.0:
                for j in range(p):
                    half[i, j] += a * T[k, j]
    out[:] = 0.0
    for i in range(nv):
        for j in range(p):
            t = T[i, j]
            if t != 0.0:
                for k in range(p):
                    out[j, k] += t * half[i, k]


@compiled
def add_product(A: Array, x: Array, out: Array) -> None:
    """`out += A x`, in place."""
    for i in range(out.size):
        for j in range(x.size):
            out[i] += A[i, j] * x[j]


@compiled
def solve(M: Array, b: Array, L: Array, x: Array) -> None:
    """Solution of `M x = b` by Cholesky for a small positive definite M (p, p); L (p, p) is scratch.

    A matrix that is not positive definite gives nan.
    """
    p = b.size
    for j in range(p):
        d = M[j, j]
        for k in range(j):
            d -= L[j, k] * L[j, k]
        d = math.sqrt(d) if d > 0.0 else np.nan
        L[j, j] = d
        for i in range(j + 1, p):
            total = M[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = total / d
    for i in range(p):
        x[i] = b[i]
    substitute(L, x)


@compiled
def substitute(L: Array, x: Array) -> None:
    """`x = (L L')^-1 x` for a lower triangular L (p, p), x (p,) in place."""
    p = x.size
    for i in range(p):
        total = x[i]
        for k in range(i):
            total -= L[i, k] * x[k]
        x[i] = total / L[i, i]
    for i in range(p - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, p):
            total -= L[k, i] * x[k]
        x[i] = total / L[i, i]


@compiled
def quadratic(M: Array, a: Array) -> float:
    """`a' M a`."""
    total = 0.0
    for i in range(a.size):
        for j in range(a.size):
            total += a[i] * M[i, j] * a[j]
    return total


@linked
def shares(T: Array, rows: IntArray, scratch: Array, found: Array) -> None:
    """Least-squares inverse of some rows R of T, transposed: `R (R' R)^-1`.

    Its transpose makes the base velocity from the rates of these joints, itself the least torques of motors on them
    from those on the base velocities.

    Args:
        T: (nv, p) map to all velocities.
        rows: (m,) which of it.
        scratch: (2, nb, nb).
        found: (m, ...) of which the first nb columns are written.
    """
    RR, L, nb, largest = scratch[0], scratch[1], scratch.shape[1], 0.0
    for i in range(nb):
        for j in range(nb):
            RR[i, j] = 0.0
            for m in range(rows.size):
                RR[i, j] += T[rows[m], i] * T[rows[m], j]
        largest = max(largest, RR[i, i])
    for i in range(nb):
        RR[i, i] += SINGULAR * largest
    for m in range(rows.size):
        solve(RR, T[rows[m], :nb], L, found[m, :nb])
