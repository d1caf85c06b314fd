"""A flattened tree, and where its bodies are and how they move, compiled.

Everything is expressed in one frame O that stands still for an instant: the root link of a mobile base, the world for
a fixed arm. There every joint has the spatial axis `S = (w, s)` (angular part first), every body the twist
`(omega, u)` of its point at O, and mass `m`, first moment `mc` and second moment `Sigma = int x x' dm` about O.
Row 0 of all tables is the base. Places and motions stand in a scratch table, one row per body.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmnn_pin.compiled import compiled

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Vector = tuple[float, float, float]

REVOLUTE, PRISMATIC = 1, 2

# Columns of the scratch table: one row per body.
ROTATION, ORIGIN = 0, 9  # of the body in O
AXIS, AXIS_RATE = 12, 18  # S = (w, s) and its time derivative
OMEGA, SPEED = 24, 27  # twist of the body in O
WHIRL = 30  # omega x mc
BODY = 33  # mass, mc, Sigma (xx xy xz yy yz zz) about O
COMPOSITE = 43  # the same of all that the body carries
OMEGA_REF, ALPHA_REF, SPEED_RATE_REF = 53, 56, 59
FORCE, MOMENT = 62, 65
WIDTH = 68


class Tree(NamedTuple):
    """A robot as plain arrays: n moving joints with their bodies, after the base in row 0.

    Joint frames are turned so that every axis is z.

    Attributes:
        parent: (n + 1,) row of the parent body.
        kind: (n + 1,) `REVOLUTE` or `PRISMATIC`; 0 for the base.
        coordinate: (n + 1,) entry of `position` that moves the joint; -1 for the base.
        start: (n + 2,) first term of the joint's rate `sum_k weight[k] nu[column[k]]`, k from start[i] to start[i + 1].
        column: entries of nu.
        weight: their factors.
        rotation: (n + 1, 9) joint frame in its parent, by rows.
        offset: (n + 1, 3) origin of the joint frame in its parent [m].
        inertia: (n + 1, 10) mass [kg], first [kg m] and second moments [kg m^2] about the joint frame.
        base_column: (k,) entries of nu that move the base.
        base_map: (3, k) their factors in its `(vx, vy, w)`.
        rotors: (p, p) constant mass of armatures and of wheels that are alike all around their axis.
        still: (p,) zeros.
        gravity: (3,) in the frame of the root joint (world for a fixed arm) [m/s^2].
        frame: (3,) control frame in the root link `(x, y, psi)` [m, m, rad].
        level: 1 where gravity does not depend on the heading.
        height_energy: potential energy of all mass at the origin of the root joint [J].
    """

    parent: Indices
    kind: Indices
    coordinate: Indices
    start: Indices
    column: Indices
    weight: Array
    rotation: Array
    offset: Array
    inertia: Array
    base_column: Indices
    base_map: Array
    rotors: Array
    still: Array
    gravity: Array
    frame: Array
    level: int
    height_energy: float


def new_scratch(tree: Tree) -> Array:
    """Memory that the compiled functions work in, shape (n + 1, WIDTH); one per thread."""
    return np.zeros((len(tree.parent), WIDTH))


@compiled
def get(table: Array, i: int, k: int) -> Vector:
    """Three entries of row i."""
    return table[i, k], table[i, k + 1], table[i, k + 2]


@compiled
def put(table: Array, i: int, k: int, a: Vector) -> None:
    """Set three entries of row i."""
    table[i, k], table[i, k + 1], table[i, k + 2] = a


@compiled
def dot(a: Vector, b: Vector) -> float:
    """`a' b`."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a: Vector, b: Vector) -> Vector:
    """`a x b`."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def add(a: Vector, b: Vector) -> Vector:
    """`a + b`."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def along(a: Vector, b: Vector, x: float) -> Vector:
    """`a + x b`."""
    return a[0] + x * b[0], a[1] + x * b[1], a[2] + x * b[2]


@compiled
def times(table: Array, i: int, k: int, a: Vector) -> Vector:
    """Product of the symmetric matrix (xx xy xz yy yz zz) at `table[i, k]` and a vector."""
    return (
        table[i, k] * a[0] + table[i, k + 1] * a[1] + table[i, k + 2] * a[2],
        table[i, k + 1] * a[0] + table[i, k + 3] * a[1] + table[i, k + 4] * a[2],
        table[i, k + 2] * a[0] + table[i, k + 4] * a[1] + table[i, k + 5] * a[2],
    )


@compiled
def joint_rate(tree: Tree, i: int, nu: Array) -> float:
    """Rate of joint i, a row of T times nu."""
    x = 0.0
    for k in range(tree.start[i], tree.start[i + 1]):
        x += tree.weight[k] * nu[tree.column[k]]
    return x


@compiled
def base_rate(tree: Tree, nu: Array) -> Vector:
    """`(vx, vy, w)` of the base in its own frame; zero for a fixed arm."""
    x, y, w = 0.0, 0.0, 0.0
    for k in range(len(tree.base_column)):
        speed = nu[tree.base_column[k]]
        x += tree.base_map[0, k] * speed
        y += tree.base_map[1, k] * speed
        w += tree.base_map[2, k] * speed
    return x, y, w


@compiled
def gravity_in_base(tree: Tree, position: Array) -> Vector:
    """Gravity in O."""
    x, y, z = tree.gravity[0], tree.gravity[1], tree.gravity[2]
    if not tree.level:
        phi = position[2] - tree.frame[2]
        c, s = math.cos(phi), math.sin(phi)
        x, y = c * x + s * y, c * y - s * x
    return x, y, z


@compiled
def locate(tree: Tree, position: Array, i: int, scratch: Array) -> None:
    """Rotation and origin of body i in O; its parent's are known."""
    j = tree.parent[i]
    rx, ry, rz = get(tree.rotation, i, 0), get(tree.rotation, i, 3), get(tree.rotation, i, 6)
    origin = get(tree.offset, i, 0)
    q = position[tree.coordinate[i]]
    turning = tree.kind[i] == REVOLUTE
    c, s = (math.cos(q), math.sin(q)) if turning else (1.0, 0.0)
    if not turning:
        origin = along(origin, (rx[2], ry[2], rz[2]), q)
    for row in range(3):
        if j == 0:
            a = rx if row == 0 else (ry if row == 1 else rz)
            scratch[i, ORIGIN + row] = origin[row]
        else:
            b = get(scratch, j, ROTATION + 3 * row)
            a = along(along(along((0.0, 0.0, 0.0), rx, b[0]), ry, b[1]), rz, b[2])
            scratch[i, ORIGIN + row] = scratch[j, ORIGIN + row] + dot(b, origin)
        put(scratch, i, ROTATION + 3 * row, (c * a[0] + s * a[1], c * a[1] - s * a[0], a[2]))


@compiled
def first_moment(tree: Tree, i: int, scratch: Array) -> Vector:
    """First moment of body i about its own origin, along the axes of O."""
    mc = get(tree.inertia, i, 1)
    rx, ry, rz = get(scratch, i, 0), get(scratch, i, 3), get(scratch, i, 6)
    return dot(rx, mc), dot(ry, mc), dot(rz, mc)


@compiled
def _weigh(tree: Tree, i: int, scratch: Array) -> None:
    """Moments of body i about O: `Sigma_O = R Sigma R' + p mc' + mc p' + m p p'`."""
    m, p = tree.inertia[i, 0], get(scratch, i, ORIGIN)
    mc = first_moment(tree, i, scratch)
    h = along(mc, p, 0.5 * m)
    rx, ry, rz = get(scratch, i, 0), get(scratch, i, 3), get(scratch, i, 6)
    yx, yy, yz = times(tree.inertia, i, 4, rx), times(tree.inertia, i, 4, ry), times(tree.inertia, i, 4, rz)
    scratch[i, BODY] = m
    put(scratch, i, BODY + 1, along(mc, p, m))
    scratch[i, BODY + 4] = dot(rx, yx) + 2.0 * p[0] * h[0]
    scratch[i, BODY + 5] = dot(rx, yy) + p[0] * h[1] + p[1] * h[0]
    scratch[i, BODY + 6] = dot(rx, yz) + p[0] * h[2] + p[2] * h[0]
    scratch[i, BODY + 7] = dot(ry, yy) + 2.0 * p[1] * h[1]
    scratch[i, BODY + 8] = dot(ry, yz) + p[1] * h[2] + p[2] * h[1]
    scratch[i, BODY + 9] = dot(rz, yz) + 2.0 * p[2] * h[2]


@compiled
def _move(tree: Tree, nu: Array, i: int, scratch: Array) -> None:
    """Axis of joint i, the axis' rate and the twist of the body, in O."""
    j = tree.parent[i]
    z = (scratch[i, 2], scratch[i, 5], scratch[i, 8])
    omega, u = get(scratch, j, OMEGA), get(scratch, j, SPEED)
    rate = joint_rate(tree, i, nu)
    if tree.kind[i] == REVOLUTE:
        s = cross(get(scratch, i, ORIGIN), z)
        put(scratch, i, AXIS, z)
        put(scratch, i, AXIS_RATE, cross(omega, z))
        put(scratch, i, AXIS_RATE + 3, add(cross(omega, s), cross(u, z)))
        omega = along(omega, z, rate)
    else:
        s = z
        put(scratch, i, AXIS, (0.0, 0.0, 0.0))
        put(scratch, i, AXIS_RATE, (0.0, 0.0, 0.0))
        put(scratch, i, AXIS_RATE + 3, cross(omega, s))
    put(scratch, i, AXIS + 3, s)
    put(scratch, i, OMEGA, omega)
    put(scratch, i, SPEED, along(u, s, rate))
    put(scratch, i, WHIRL, cross(omega, get(scratch, i, BODY + 1)))


@compiled
def place(tree: Tree, position: Array, nu: Array, scratch: Array) -> None:
    """Where all bodies are and how they move, into `scratch`: what the other functions start from.

    Args:
        tree: The robot.
        position: (nv,) pose of the control frame and joint coordinates [m, rad].
        nu: (p,) independent velocities.
        scratch: Memory of `new_scratch`.
    """
    vx, vy, w = base_rate(tree, nu)
    put(scratch, 0, OMEGA, (0.0, 0.0, w))
    put(scratch, 0, SPEED, (vx, vy, 0.0))
    for i in range(1, len(tree.parent)):
        locate(tree, position, i, scratch)
        _weigh(tree, i, scratch)
        _move(tree, nu, i, scratch)
