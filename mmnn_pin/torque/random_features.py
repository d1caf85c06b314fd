"""Random features of the dynamics of a robot that is not known, compiled.

Bilinear: what every mechanism's equations look like and no more. Psi is linear in nudot_ref, bilinear and symmetric in
nu and nu_ref (Christoffel's C), and its coefficients are unknown functions of the arm's joints (a free base sees no
pose) and of the cosines and sines of a steering base's pivots, which turn without an end; these are `tanh(a' q + b)`
with random a and b, their weights are learned, one set per velocity,

    Psi_i ~ sum over units u and terms t of W_iut g_u(q) t(nu, nu_ref, nudot_ref),    t = nudot_ref, sym(nu nu_ref'), 1,

over all pairs, or as many as `paired` leaves a robot with many joints.

Generic: `tanh` of random combinations of q, nu, nu_ref and nudot_ref, which knows nothing (random features: Rahimi and
Recht 2008, NIPS; with a linear last layer as in Igelnik and Pao 1995, IEEE Trans. Neural Networks 6(6)). Both have the
terms without a random function, and friction: nu and `tanh(nu / eps)`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled, inlined
from ..elementary import cos_sin, tanh
from ..signals import Array, IntArray

BILINEAR, GENERIC = 0, 1
GRAVITY = 4  # one in so many random features is one of gravity, where there is no room for all


class Random(NamedTuple):
    """The numbers of random features; a and b stand in the controller's state, so that they are recorded."""

    kind: int  # `BILINEAR` or `GENERIC`
    number: int  # features with a random function
    units: int  # random functions
    pairs: IntArray  # (number, 2) random function and term of every one of them; the term is -1 for none
    inputs: int  # what each of them sees: n joints and two numbers per pivot, or 3 p more
    eps: float  # speed over which dry friction turns [rad/s or m/s]
    centre: Array  # (n,) where the joints are counted from [rad or m]
    scale: Array  # (inputs,) what inputs are multiplied with
    x: Array  # (inputs,) room to work in
    g: Array  # (units,) room to work in
    t: Array  # (terms,) room to work in


def terms(kind: int, p: int) -> int:
    """Number of terms without a random function."""
    return p + p * (p + 1) // 2 + 1 if kind == BILINEAR else 2 * p + 1


def size(kind: int, p: int, number: int) -> int:
    """Number of features: terms, random ones, friction."""
    return terms(kind, p) + number + 2 * p


def coprime(units: int, terms: int) -> int:
    """The smallest number from `units` on that shares no divisor with the number of terms.

    With function `c % units` and term `c % terms` all pairs come once before one comes again.
    """
    while math.gcd(units, terms) > 1:
        units += 1
    return units


def paired(kind: int, p: int, hidden: int, largest: int) -> IntArray:
    """Random function and term of every feature that has one, (number, 2); term -1 for none.

    Bilinear features are all pairs, where they are at most `largest`. A robot with many joints has more, most of them
    products of velocities: there gravity gets a quarter of them, each with a function of its own, so that many joints
    can bend it, the accelerations a half and the products a quarter.

    Args:
        kind: `BILINEAR` or `GENERIC`.
        p: Number of velocities.
        hidden: Random functions, at least.
        largest: Most bilinear features with a random function.
    """
    if kind == GENERIC:
        return np.column_stack((np.arange(hidden), np.full(hidden, -1)))
    count = terms(kind, p)
    units = coprime(hidden, count)
    c = np.arange(units * count)
    if c.size <= largest:
        return np.column_stack((c % units, c % count))
    functions = max(1, largest // GRAVITY)
    shares = ((functions, count - 1, 1), (largest // 2, 0, p), (largest - functions - largest // 2, p, count - 1 - p))
    pairs = [np.column_stack((np.arange(n) % functions, first + np.arange(n) % size)) for n, first, size in shares]
    return np.vstack(pairs)


def new_random(kind: int, p: int, pairs: IntArray, eps: float, centre: Array, scale: Array) -> Random:
    """Random features of a robot with p velocities, with room of their own to work in; the rest as in `Random`."""
    units = int(pairs[:, 0].max()) + 1
    room = (np.zeros(scale.size), np.zeros(units), np.zeros(terms(kind, p)))
    return Random(kind, len(pairs), units, pairs, scale.size, eps, centre, scale, *room)


class Movement(NamedTuple):
    """A movement, of which features are computed: how the robot stands and moves, and how it should move."""

    pose: Array  # (3,) pose of the base, (0,) for a fixed arm
    q: Array  # (n,) joints
    velocity: Array  # (nb,) velocity of the base
    qdot: Array  # (n,) rates of the joints
    nu_ref: Array  # (p,) reference velocities
    nudot_ref: Array  # (p,) their time derivatives
    shape: Array  # (shape,) angles of the pivots of a base that steers


@compiled
def fill(r: Random, a: Array, b: Array, m: Movement, phi: Array) -> None:
    """The features of a movement, (k,), into phi.

    Args:
        r: The numbers.
        a: (units, inputs) what was drawn.
        b: (units,) likewise.
        m: The movement.
        phi: (k,) written.
    """
    p, nb = m.nu_ref.size, m.velocity.size
    first = phi.size - 2 * p
    for i in range(p):
        speed = m.velocity[i] if i < nb else m.qdot[i - nb]
        phi[first + i], phi[first + p + i] = speed, tanh(speed / r.eps)
    fill_functions(r, a, b, m, phi[first : first + p])
    fill_terms(r, m, phi[first : first + p])
    last = r.t.size - 1
    for c in range(last + 1):
        phi[c] = r.t[c]
    for c in range(r.number):
        term = r.pairs[c, 1]
        phi[last + 1 + c] = r.g[r.pairs[c, 0]] * (r.t[term] if term >= 0 else 1.0)


@inlined
def fill_functions(r: Random, a: Array, b: Array, m: Movement, nu: Array) -> None:
    """The random functions (units,) of a movement with the velocity nu (p,), into r.g; the rest as of `fill`."""
    n, p, x = m.q.size, nu.size, r.x
    for i in range(n):
        x[i] = r.scale[i] * (m.q[i] - r.centre[i])
    for i in range(m.shape.size):
        x[n], x[n + 1] = cos_sin(m.shape[i])
        n += 2
    if r.kind == GENERIC:
        for i in range(p):
            x[n + i] = r.scale[n + i] * nu[i]
            x[n + p + i] = r.scale[n + p + i] * m.nu_ref[i]
            x[n + 2 * p + i] = r.scale[n + 2 * p + i] * m.nudot_ref[i]
    for u in range(r.units):
        total = b[u]
        for i in range(r.inputs):
            total += a[u, i] * x[i]
        r.g[u] = tanh(total)


@inlined
def fill_terms(r: Random, m: Movement, nu: Array) -> None:
    """The terms (terms,) of a movement with the velocity nu (p,), into r.t."""
    p, t = nu.size, r.t
    for i in range(p):
        t[i] = m.nudot_ref[i]
    if r.kind == GENERIC:
        for i in range(p):
            t[p + i] = m.nu_ref[i]
    else:
        place = p
        for i in range(p):
            for j in range(i, p):
                t[place] = 0.5 * (nu[i] * m.nu_ref[j] + nu[j] * m.nu_ref[i])
                place += 1
    t[t.size - 1] = 1.0


def at_rest(random: Random, k: int) -> NDArray[np.bool_]:
    """Which of k random features are there when nothing moves: the constant, and random functions that stand alone."""
    last, rest = random.t.size - 1, np.zeros(k, bool)
    rest[last] = True
    rest[last + 1 : last + 1 + random.number] = np.isin(random.pairs[:, 1], (-1, last))
    return rest
