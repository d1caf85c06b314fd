"""The regressor of the reduced dynamics on a flattened tree, compiled: `Y(q, nu, nu_ref, nudot_ref) theta = Psi`.

A particle m of a body, at x in the axes of the body and with `xbar = (x, 1)`, moves at `V_j xbar` when joint j turns at
rate 1, `V_j = [w x, v]`, and the reference asks it for the acceleration `A xbar`, `A = [alpha x + omega_r x omega x,
a]` (a without gravity). It adds `m xbar' V_j' A xbar` to the torque of joint j, so the whole body adds

    tr(P sym(A' V_j)),      P = int xbar xbar' dm = [Sigma, mc; mc', m],

which is linear in the ten numbers of the pseudo-inertia P (Wensing, Kim, Slotine 2018, IEEE RA-L 3(1)), and these are
the ten numbers that a `Tree` holds of a body. The factorisation is that of the tree, `Mdot = C + C'`, as Slotine and
Li 1987 (Int. J. Robotics Research 6(3)) ask for. Rotors and friction of joints are linear as well; each joint acts on
nu through its row of T.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from mmnn_pin.compiled import compiled
from mmnn_pin.model.reduction import as_measured

from .dynamics import psi_again
from .motion import AT, BASE, LINK, NUMBER, Array, Tree, Vector, add, along, cross, dot, get, place

BODY = 10  # parameters of a body: m, mc (3), second moments xx xy xz yy yz zz [kg, kg m, kg m^2]


class Massless(NamedTuple):
    """A robot as arrays without its masses: how it moves, and memory to work in (one per thread).

    Attributes:
        tree: The tree; its inertial numbers are zero.
        joints: (nj, p) rows of T of the joints that move.
        base: Number of base velocities nb.
        first: Row of the first body that moves: the base, or the first link of a fixed arm.
        offset: (nv,) position of every joint where the arm's joints stand at 0.
        arm: (nv, n) what one arm joint moves, itself and its slaves.
        coulomb_speed: Dry friction is `tanh(speed / coulomb_speed)` [rad/s or m/s].
        scratch: Memory of the tree.
        position: (nv,) measured position.
        nu: (p,) measured velocity.
        out: (p,) unused forces.
        Y: (p, k) the regressor.
    """

    tree: Tree
    joints: Array
    base: int
    first: int
    offset: Array
    arm: Array
    coulomb_speed: float
    scratch: Array
    position: Array
    nu: Array
    out: Array
    Y: Array


@compiled
def measured(known: Massless, pose: Array, velocity: Array, q: Array, qdot: Array) -> None:
    """Position (nv,) and nu (p,) of a measurement, see `reduction.as_measured`."""
    as_measured(known.offset, known.arm, pose, velocity, q, qdot, known.position, known.nu)


@compiled
def turned(scratch: Array, i: int, a: Vector) -> Vector:
    """A vector along O in the axes of body i."""
    k = AT.rotation
    x, y, z = get(scratch, i, k), get(scratch, i, k + 3), get(scratch, i, k + 6)
    return (
        x[0] * a[0] + y[0] * a[1] + z[0] * a[2],
        x[1] * a[0] + y[1] * a[1] + z[1] * a[2],
        x[2] * a[0] + y[2] * a[1] + z[2] * a[2],
    )


@compiled
def body_columns(known: Massless, i: int) -> None:
    """Columns of Y of body i, after a pass over the tree."""
    links, numbers, scratch, Y = known.tree.links, known.tree.numbers, known.scratch, known.Y
    column = BODY * (i - known.first)
    omega, ref = turned(scratch, i, get(scratch, i, AT.omega)), turned(scratch, i, get(scratch, i, AT.omega_ref))
    alpha, a3 = turned(scratch, i, get(scratch, i, AT.alpha)), turned(scratch, i, get(scratch, i, AT.a))
    both = dot(ref, omega)  # omega_r x (omega x .) = omega omega_r' - (omega_r' omega) 1
    a0 = add((-both, alpha[2], -alpha[1]), along((0.0, 0.0, 0.0), omega, ref[0]))
    a1 = add((-alpha[2], -both, alpha[0]), along((0.0, 0.0, 0.0), omega, ref[1]))
    a2 = add((alpha[1], -alpha[0], -both), along((0.0, 0.0, 0.0), omega, ref[2]))
    origin, j = get(scratch, i, AT.origin), i
    while j >= 0:
        w = get(scratch, j, AT.w)
        lever = along(origin, get(scratch, j, AT.origin), -1.0)
        v = turned(scratch, i, add(get(scratch, j, AT.s), cross(w, lever)))
        w = turned(scratch, i, w)
        v0, v1, v2 = (0.0, w[2], -w[1]), (-w[2], 0.0, w[0]), (w[1], -w[0], 0.0)
        first = links[j, LINK.first]
        for k in range(links[j, LINK.stop] - first):
            t, y = numbers[j, NUMBER.weight + k], Y[first + k, column : column + BODY]
            y[0] += t * dot(a3, v)
            y[1] += t * (dot(a0, v) + dot(a3, v0))
            y[2] += t * (dot(a1, v) + dot(a3, v1))
            y[3] += t * (dot(a2, v) + dot(a3, v2))
            y[4] += t * dot(a0, v0)
            y[5] += t * (dot(a0, v1) + dot(a1, v0))
            y[6] += t * (dot(a0, v2) + dot(a2, v0))
            y[7] += t * dot(a1, v1)
            y[8] += t * (dot(a1, v2) + dot(a2, v1))
            y[9] += t * dot(a2, v2)
        j = links[j, LINK.parent] if j > BASE.w else j - 1


@compiled
def joint_columns(known: Massless, nudot_ref: Array, first: int) -> None:
    """Columns of Y of rotors, viscous friction of base and joints, and dry friction of joints, from `first` on."""
    joints, nu, Y = known.joints, known.nu, known.Y
    count, p = joints.shape
    for i in range(known.base):
        Y[i, first + count + i] = nu[i]
    for k in range(count):
        acceleration, speed = 0.0, 0.0
        for i in range(p):
            acceleration += joints[k, i] * nudot_ref[i]
            speed += joints[k, i] * nu[i]
        dry = math.tanh(speed / known.coulomb_speed)
        rough = first + count + known.base + k
        for i in range(p):
            Y[i, first + k] = joints[k, i] * acceleration
            Y[i, rough] = joints[k, i] * speed
            Y[i, rough + count] = joints[k, i] * dry


@compiled
def regress(known: Massless, nu_ref: Array, nudot_ref: Array) -> None:
    """Y at the known position and velocity, (p, k), into `known.Y`.

    Args:
        known: The robot; `known.position` and `known.nu` say where it is.
        nu_ref: (p,) reference velocities.
        nudot_ref: (p,) their time derivative.
    """
    tree, Y = known.tree, known.Y
    place(tree.links, tree.numbers, known.position, known.nu, known.scratch)
    psi_again(tree, known.position, nu_ref, nudot_ref, known.scratch, known.out)
    Y[:] = 0.0
    for i in range(known.first, len(tree.links)):
        body_columns(known, i)
    joint_columns(known, nudot_ref, BODY * (len(tree.links) - known.first))
