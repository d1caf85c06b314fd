"""A flattened tree, and where its bodies are and how they move, compiled.

All vectors are along the axes of one frame O that stands still for an instant: the root link of a mobile base, the
world for a fixed arm. There every joint has an axis `(w, s)`, `w` for turning and `s` for sliding (one of them zero),
and every body an angular velocity `omega`, a mass `m` and, about the origin of its own joint (so that small bodies far
out keep their digits), a first moment `mc` and a second moment `Sigma = int x x' dm`.

All tables have one row per velocity `(vx, vy, w)` of the base, whose body is in the third, then one per moving joint.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmnn_pin.compiled import compiled, inlined, linked

from ...by_address import by_address
from ...elementary import cos_sin
from ...signals import Array

Indices = NDArray[np.int64]
Triple = tuple[float, float, float]
REVOLUTE, PRISMATIC = 1, 2
ZERO = (0.0, 0.0, 0.0)


class _Links(NamedTuple):
    """Columns of `BodyTree.links`."""

    parent: int = 0
    kind: int = 1
    coordinate: int = 2
    first: int = 3
    stop: int = 4


class _Numbers(NamedTuple):
    """Columns of `BodyTree.numbers`."""

    rotation: int = 0
    origin: int = 9
    mass: int = 12
    moment: int = 13
    second: int = 16
    weight: int = 22


class _Base(NamedTuple):
    """Rows of the velocities of the base; its body is in the last."""

    vx: int = 0
    vy: int = 1
    w: int = 2


class _Scratch(NamedTuple):
    """Columns of the table that the compiled functions work in; all along the axes of O."""

    rotation: int = 0
    origin: int = 9
    lever: int = 12  # from the origin of the parent
    lever_rate: int = 15
    w: int = 18  # axis
    s: int = 21
    w_rate: int = 24
    s_rate: int = 27
    omega: int = 30
    whirl: int = 33  # omega x mc
    mass: int = 36  # of the body
    moment: int = 37
    second: int = 40  # xx xy xz yy yz zz
    all_mass: int = 46  # of the body with all that it carries
    all_moment: int = 47
    all_second: int = 50
    omega_ref: int = 56  # motion of the reference
    alpha: int = 59
    a: int = 62
    force: int = 65
    torque: int = 68
    weight: int = 71  # entries of the row of T, then those of its rate


# numba compiles a function anew for every integer constant it is called with, but not for entries of tuples.
BASE, LINK, NUMBER, AT = _Base(), _Links(), _Numbers(), _Scratch()


@by_address
class BodyTree(NamedTuple):
    """A robot as plain arrays; joint frames are turned so that every axis is z."""

    # (3 + n, 5) row of the parent body; `REVOLUTE` or `PRISMATIC`; entry of `position` that moves the joint, which is
    # its row of T; first and last + 1 entry of nu there
    links: Indices
    # (3 + n, 22 + k) rotation (by rows) and origin [m] of the joint frame in its parent, mass [kg], first [kg m] and
    # second moments [kg m^2] of the body in the joint frame, entries of the row of T, 0 where those change
    numbers: Array
    rotors: Array  # (p, p) constant mass of armatures and of wheels that are alike all around their axis
    gravity: Triple  # (gx, gy, gz) in the frame of the root joint (world for a fixed arm) [m/s^2]
    frame: Triple  # control frame in the root link `(x, y, psi)` [m, m, rad]
    level: int  # 1 where gravity does not depend on the heading, else 0
    root_energy: float  # potential energy of all mass at the origin of the root joint [J]
    spins: Array  # (m, 2) of lumped wheels whose rows of T change: row of T, mass of their spinning [kg m^2]
    steers: bool  # whether rows of T change; then `steer` writes them


def new_scratch(tree: BodyTree) -> Array:
    """Memory that the compiled functions work in, the weights in it; one per thread.

    Shape (3 + n, 71 + k); of a robot that steers (3 + n + m, 71 + 2 k).
    """
    weights = tree.numbers[:, NUMBER.weight :]
    n, k = weights.shape
    scratch = np.zeros((n + len(tree.spins), AT.weight + (2 * k if tree.steers else k)))
    scratch[:n, AT.weight : AT.weight + k] = weights
    scratch[BASE.vx, AT.s] = scratch[BASE.vy, AT.s + 1] = scratch[BASE.w, AT.w + 2] = 1.0  # axes of the base
    return scratch


@compiled
def get(table: Array, i: int, k: int) -> Triple:
    """Three entries of row i."""
    return table[i, k], table[i, k + 1], table[i, k + 2]


@compiled
def put(table: Array, i: int, k: int, a: Triple) -> None:
    """Set three entries of row i."""
    table[i, k] = a[0]
    table[i, k + 1] = a[1]
    table[i, k + 2] = a[2]


@compiled
def dot(a: Triple, b: Triple) -> float:
    """`a' b`."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a: Triple, b: Triple) -> Triple:
    """`a x b`."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def add(a: Triple, b: Triple) -> Triple:
    """`a + b`."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def along(a: Triple, b: Triple, x: float) -> Triple:
    """`a + x b`."""
    return a[0] + x * b[0], a[1] + x * b[1], a[2] + x * b[2]


@compiled
def times(table: Array, i: int, k: int, a: Triple) -> Triple:
    """Product of the symmetric matrix (xx xy xz yy yz zz) at `table[i, k]` and a vector."""
    xx, xy, xz, yy, yz, zz = (
        table[i, k],
        table[i, k + 1],
        table[i, k + 2],
        table[i, k + 3],
        table[i, k + 4],
        table[i, k + 5],
    )
    return (
        xx * a[0] + xy * a[1] + xz * a[2],
        xy * a[0] + yy * a[1] + yz * a[2],
        xz * a[0] + yz * a[1] + zz * a[2],
    )


@linked
def steer(tree: BodyTree, T: Array, Tdot: Array, scratch: Array) -> None:
    """Write rows of T (nv, p) that change, and of its rate, where the dynamics read them."""
    links, n, k = tree.links, len(tree.links), tree.numbers.shape[1] - NUMBER.weight
    for i in range(n):
        row, first = links[i, LINK.coordinate] if i > BASE.w else i, links[i, LINK.first]
        for j in range(links[i, LINK.stop] - first):
            scratch[i, AT.weight + j] = T[row, first + j]
            scratch[i, AT.weight + k + j] = Tdot[row, first + j]
    for i in range(len(tree.spins)):
        row = int(tree.spins[i, 0])
        for j in range(links[BASE.w, LINK.stop]):
            scratch[n + i, AT.weight + j] = T[row, j]
            scratch[n + i, AT.weight + k + j] = Tdot[row, j]


@inlined
def rate(links: Indices, scratch: Array, i: int, nu: Array) -> float:
    """Row i of T times nu."""
    first, x = links[i, LINK.first], 0.0
    for k in range(links[i, LINK.stop] - first):
        x += scratch[i, AT.weight + k] * nu[first + k]
    return x


@inlined
def drift(links: Indices, scratch: Array, i: int, nu: Array) -> float:
    """Row i of the rate of T times nu."""
    first, x = links[i, LINK.first], 0.0
    middle = AT.weight + (scratch.shape[1] - AT.weight) // 2
    for k in range(links[i, LINK.stop] - first):
        x += scratch[i, middle + k] * nu[first + k]
    return x


@inlined
def base_rates(links: Indices, scratch: Array, nu: Array) -> Triple:
    """`(vx, vy, w)` of the base."""
    return rate(links, scratch, BASE.vx, nu), rate(links, scratch, BASE.vy, nu), rate(links, scratch, BASE.w, nu)


@inlined
def base_drift(links: Indices, scratch: Array, nu: Array) -> Triple:
    """Accelerations of the base by the rate of T."""
    return drift(links, scratch, BASE.vx, nu), drift(links, scratch, BASE.vy, nu), drift(links, scratch, BASE.w, nu)


@inlined
def locate(links: Indices, numbers: Array, position: Array, i: int, scratch: Array) -> None:
    """Rotation and origin of body i; its parent's are known."""
    j, q, k = links[i, LINK.parent], position[links[i, LINK.coordinate]], NUMBER.rotation
    rx, ry, rz = get(numbers, i, k), get(numbers, i, k + 3), get(numbers, i, k + 6)
    lever, c, s = get(numbers, i, NUMBER.origin), 1.0, 0.0
    if links[i, LINK.kind] == REVOLUTE:
        c, s = cos_sin(q)
    else:
        lever = along(lever, (rx[2], ry[2], rz[2]), q)
    for row in range(3):
        if j == BASE.w:
            a, x = (rx if row == 0 else (ry if row == 1 else rz)), lever[row]
        else:
            b = get(scratch, j, AT.rotation + 3 * row)
            a, x = along(along(along(ZERO, rx, b[0]), ry, b[1]), rz, b[2]), dot(b, lever)
        put(scratch, i, AT.rotation + 3 * row, (c * a[0] + s * a[1], c * a[1] - s * a[0], a[2]))
        scratch[i, AT.lever + row] = x
        scratch[i, AT.origin + row] = scratch[j, AT.origin + row] + x


@inlined
def first_moment(numbers: Array, i: int, scratch: Array) -> Triple:
    """First moment of body i."""
    mc = get(numbers, i, NUMBER.moment)
    rx, ry, rz = get(scratch, i, AT.rotation), get(scratch, i, AT.rotation + 3), get(scratch, i, AT.rotation + 6)
    return dot(rx, mc), dot(ry, mc), dot(rz, mc)


@inlined
def _weigh(numbers: Array, i: int, scratch: Array) -> None:
    """Moments of body i: `R mc`, `R Sigma R'`, and `omega x mc`."""
    k = NUMBER.second
    rx, ry, rz = get(scratch, i, AT.rotation), get(scratch, i, AT.rotation + 3), get(scratch, i, AT.rotation + 6)
    x, y, z = times(numbers, i, k, rx), times(numbers, i, k, ry), times(numbers, i, k, rz)
    scratch[i, AT.mass] = numbers[i, NUMBER.mass]
    put(scratch, i, AT.moment, first_moment(numbers, i, scratch))
    put(scratch, i, AT.second, (dot(rx, x), dot(rx, y), dot(rx, z)))
    put(scratch, i, AT.second + 3, (dot(ry, y), dot(ry, z), dot(rz, z)))
    put(scratch, i, AT.whirl, cross(get(scratch, i, AT.omega), get(scratch, i, AT.moment)))


@inlined
def _move(links: Indices, i: int, speed: float, scratch: Array) -> None:
    """Axis and lever of joint i, their rates, and the angular velocity of the body."""
    omega = get(scratch, links[i, LINK.parent], AT.omega)
    z = (scratch[i, AT.rotation + 2], scratch[i, AT.rotation + 5], scratch[i, AT.rotation + 8])
    w, s = (z, ZERO) if links[i, LINK.kind] == REVOLUTE else (ZERO, z)
    put(scratch, i, AT.w, w)
    put(scratch, i, AT.s, s)
    put(scratch, i, AT.w_rate, cross(omega, w))
    put(scratch, i, AT.s_rate, cross(omega, s))
    put(scratch, i, AT.lever_rate, along(cross(omega, get(scratch, i, AT.lever)), s, speed))
    put(scratch, i, AT.omega, along(omega, w, speed))


@inlined
def move(links: Indices, numbers: Array, position: Array, nu: Array, scratch: Array) -> None:
    """Places and motions of all bodies, into `scratch`."""
    put(scratch, BASE.w, AT.omega, (0.0, 0.0, rate(links, scratch, BASE.w, nu)))
    for i in range(BASE.w + 1, len(links)):
        locate(links, numbers, position, i, scratch)
        _move(links, i, rate(links, scratch, i, nu), scratch)


@inlined
def place(links: Indices, numbers: Array, position: Array, nu: Array, scratch: Array) -> None:
    """Places, motions and moments of all bodies, into `scratch`: the dynamics start from them."""
    move(links, numbers, position, nu, scratch)
    for i in range(BASE.w + 1, len(links)):
        _weigh(numbers, i, scratch)
