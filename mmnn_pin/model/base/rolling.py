"""T(theta): the motions of a base whose wheels steer, trail behind swivels, or ride on a trailer.

The posture model of G. Campion, G. Bastin, B. d'Andrea-Novel, IEEE T-RA 12(1), 1996, in one mechanism. A base is a
planar tree: its body, *pivots* (vertical joints: steering, casters, hitches, a loader's waist) and wheels on either. A
wheel at (x, y) on its carrier, rolling along the heading h there, neither slips nor slides:

    across = cos h (vy + x w) - sin h (vx - y w) = 0        along = cos h (vx - y w) + sin h (vy + x w) = sign r phidot

(vx, vy, w) the carrier's velocity in its own axes. A pivot is one of three:

    master      its rate is a velocity of the base: a motor steers
    follower    it stands along its path as a linkage, or the wheel's own controller, holds it (a car's other wheel)
    passive     its wheel is off its axis, and the rolling turns it (casters, hitches)

The body moves with `eta = (vx, vy, w)` of the control frame. It is free where no wheel on the body or on a master holds
it (powered casters), free but for vy on a fixed axle that nothing steers (a differential drive with a trailer), else

    eta = n(theta) u + X(theta) zeta        zeta the masters' rates, u = n' W eta, W = diag(1, 1, l^2), n' W n = 1

With a fixed axle at the control frame and one master, whose wheel is at p ahead and t behind its axis, both closed:

    n ~ (px cos h + py sin h + t, 0, sin h)        X the least motion that lets the wheel swing by t

so that u is the speed of a car's virtual front wheel, bounded at a right angle, where l is its wheelbase. Without an
axle all steered wheels are masters: n is the direction along which they slide least, exact where their axles meet in
one place. The sign of n goes on from the one before: a wheel may turn by half a turn, and u keeps its meaning. The
first one rolls most wheels forwards.

Every number has its rate beside it, so that Tdot is exact.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ...by_address import by_address
from ...compiled import compiled, internal, linked
from ...elementary import atan2, cos_sin
from ...signals import Array, IntArray

MASTER, FOLLOWER, PASSIVE = 0, 1, 2
ROLES = ("master", "follower", "passive")
STEERED, AXLE, FREE = 0, 2, 3  # what the body may do: as its wheels steer; `(v, w)`; `(vx, vy, w)`
TIE = 0.3  # wheels by which those that roll forwards outnumber the others: below it sensors would decide


@dataclass(frozen=True)
class Pivot:
    """A vertical joint of the base."""

    joint: str  # its name
    role: str  # one of `ROLES`
    x: float  # its axis on its carrier, ahead [m]; in the control frame where the body carries it
    y: float  # likewise, to the left [m]
    parent: int = -1  # number of the pivot that carries it, -1 for the body; a carrier stands before what it carries
    sign: float = 1.0  # +1 where a positive joint velocity turns to the left seen from above, else -1
    lower: float = -math.inf  # lower stop [rad], -inf for none
    upper: float = math.inf  # upper stop [rad], inf for none
    rate: float = math.inf  # largest rate [rad/s], inf where the file states none
    motor: bool = False  # whether a motor turns it; a follower on a linkage has none
    # the wheel, or the middle of the axle, that it carries: ahead, to the left [m], heading [rad] on it
    wheel: tuple[float, float, float] = (0.0, 0.0, 0.0)


class _Turn(NamedTuple):
    """Columns of `Rolling.turns`."""

    role: int = 0
    parent: int = 1
    place: int = 2  # of its angle in a position, and its row of T
    column: int = 3  # of its rate in nu, -1 for none


class _Pivot(NamedTuple):
    """Columns of `Rolling.pivots`: place, sign, and the wheel on it that decides."""

    x: int = 0
    y: int = 1
    sign: int = 2
    wheel_x: int = 3
    wheel_y: int = 4
    c: int = 5
    s: int = 6
    lower: int = 7
    upper: int = 8
    rate: int = 9


class _Wheel(NamedTuple):
    """Columns of `Rolling.wheels`."""

    x: int = 0
    y: int = 1
    c: int = 2
    s: int = 3
    per: int = 4  # joint velocity per rim speed [1/m]


MOST_STEPS, SETTLED = 60, 1e-28  # of the iteration for n: how many, and when n and its rate stand still, squared
TURN, PIVOT, WHEEL = _Turn(), _Pivot(), _Wheel()


@by_address
class Rolling(NamedTuple):
    """A base that rolls by T(theta), as arrays."""

    turns: IntArray  # (K, 4) of every pivot: role, carrier, place in the position, column in nu
    pivots: Array  # (K, 10) of every pivot: where it is, its sign, the wheel on it, its limits
    carriers: IntArray  # (W, 2) of every wheel: its carrier, its row of T
    wheels: Array  # (W, 5) of every wheel: where it is, its heading, joint velocity per rim speed
    body: int  # `STEERED`, `AXLE` or `FREE`
    axle: bool  # whether an axle at the control frame is fixed
    length: float  # l of W [m]
    root: Array  # (3, 3) map from eta to the root's planar velocity


@by_address
class Maps(NamedTuple):
    """The maps of a base at a state, and memory to work in; one per thread."""

    T: Array  # (nv, p) map from nu to all velocities
    Tdot: Array  # (nv, p) its rate
    V: Array  # (K + 1, 3, nb) velocity of the body and of what every pivot carries, in its own axes
    Vdot: Array  # (K + 1, 3, nb) its rate
    eta: Array  # (3,) velocity of the control frame; (0,) where T is constant
    n: Array  # (3,) direction of u, in the measure of W; the sign of the next one goes on from it, 0 at first
    gram: Array  # (4, 3, 3) scratch


def new_maps(rolling: Rolling | None, T: Array) -> Maps:
    """Memory for the maps of a base, T (nv, p) of what is constant in it already there; `rolling` None: T is."""
    pivots, nb = (0, 0) if rolling is None else (len(rolling.turns), base_size(rolling))
    drift = np.zeros_like(T) if rolling is not None else np.zeros((0, 0))
    eta = np.zeros(3 if pivots else 0)
    parts = np.zeros((pivots + 1, 3, nb)), np.zeros((pivots + 1, 3, nb)), eta, np.zeros(3)
    return Maps(T.copy(), drift, *parts, np.zeros((4, 3, 3)))


def maps_in(value: Any) -> Iterator[Maps]:
    """All maps in a tuple of tuples, such as the numbers of a learner."""
    if isinstance(value, Maps):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from maps_in(part)


def base_size(rolling: Rolling) -> int:
    """Number of base velocities."""
    own = {STEERED: 1, AXLE: 2, FREE: 3}[rolling.body]
    return own + int(np.sum(rolling.turns[:, TURN.role] == MASTER))


@linked
def roll(rolling: Rolling, position: Array, nu: Array, maps: Maps) -> None:
    """Write the maps at a position (nv,) and velocity nu (p,): rows of T and Tdot of the root, pivots and wheels.

    Args:
        rolling: The base.
        position: (nv,) only the angles of pivots are read.
        nu: (p,) independent velocities, the base's first.
        maps: Written.
    """
    T, Tdot, V, Vdot = maps.T, maps.Tdot, maps.V, maps.Vdot
    nb = V.shape[2]
    body_motion(rolling, position, nu, maps)
    for i in range(3):
        maps.eta[i] = 0.0
        for j in range(nb):
            maps.eta[i] += V[0, i, j] * nu[j]
            T[i, j], Tdot[i, j] = 0.0, 0.0
            for k in range(3):
                T[i, j] += rolling.root[i, k] * V[0, k, j]
                Tdot[i, j] += rolling.root[i, k] * Vdot[0, k, j]
    for k in range(len(rolling.turns)):
        carry(rolling, k, position, nu, maps)
    for i in range(len(rolling.carriers)):
        w, at, row = rolling.wheels[i], rolling.carriers[i, 0] + 1, rolling.carriers[i, 1]
        for j in range(nb):
            T[row, j] = w[WHEEL.per] * along(V[at], w[WHEEL.x], w[WHEEL.y], w[WHEEL.c], w[WHEEL.s], j)
            Tdot[row, j] = w[WHEEL.per] * along(Vdot[at], w[WHEEL.x], w[WHEEL.y], w[WHEEL.c], w[WHEEL.s], j)


@compiled
def along(V: Array, x: float, y: float, c: float, s: float, j: int) -> float:
    """Speed along a heading (c, s) of a point (x, y) of a carrier, per velocity j."""
    return c * (V[0, j] - y * V[2, j]) + s * (V[1, j] + x * V[2, j])


@compiled
def across(V: Array, x: float, y: float, c: float, s: float, j: int) -> float:
    """Speed across it, to the left."""
    return c * (V[1, j] + x * V[2, j]) - s * (V[0, j] - y * V[2, j])


@compiled
def heading_of(rolling: Rolling, k: int, position: Array) -> tuple[float, float, float]:
    """Cosine and sine of the heading of the wheel on a pivot of the body, and its trail: how far ahead it is [m]."""
    p = rolling.pivots[k]
    c, s = cos_sin(p[PIVOT.sign] * position[rolling.turns[k, TURN.place]])
    trail = p[PIVOT.wheel_x] * p[PIVOT.c] + p[PIVOT.wheel_y] * p[PIVOT.s]
    return c * p[PIVOT.c] - s * p[PIVOT.s], s * p[PIVOT.c] + c * p[PIVOT.s], trail


@internal
def body_motion(rolling: Rolling, position: Array, nu: Array, maps: Maps) -> None:
    """Velocity of the body per base velocity, (3, nb), and its rate, into the first layer of `V` and `Vdot`."""
    V, Vdot = maps.V[0], maps.Vdot[0]
    V[:] = 0.0
    Vdot[:] = 0.0
    if rolling.body == FREE:
        V[0, 0] = V[1, 1] = V[2, 2] = 1.0
    elif rolling.body == AXLE:
        V[0, 0] = V[2, 1] = 1.0
    elif rolling.axle:
        for k in range(len(rolling.turns)):
            if rolling.turns[k, TURN.role] == MASTER:
                steer_axle(rolling, k, position, nu, V, Vdot)
    else:
        meet(rolling, position, nu, maps)


@internal
def steer_axle(rolling: Rolling, k: int, position: Array, nu: Array, V: Array, Vdot: Array) -> None:
    """N and X of a fixed axle and one master k, closed; see the heading."""
    p, column = rolling.pivots[k], rolling.turns[k, TURN.column]
    x, y, sign, L2 = p[PIVOT.x], p[PIVOT.y], p[PIVOT.sign], rolling.length * rolling.length
    (c, s, t), rate = heading_of(rolling, k, position), sign * nu[column]
    a, b, a1 = x * c + y * s + t, s, y * c - x * s
    size2 = a * a + L2 * b * b
    size, grow = math.sqrt(size2), (a * a1 + L2 * b * c) / size2  # grow = (d size / d heading) / size
    forward = 1.0 if x + t > 0.0 else -1.0
    V[0, 0], V[2, 0] = forward * a / size, forward * b / size
    Vdot[0, 0], Vdot[2, 0] = forward * rate * (a1 - a * grow) / size, forward * rate * (c - b * grow) / size
    V[0, column], V[2, column] = sign * t * L2 * b / size2, -sign * t * a / size2
    Vdot[0, column] = sign * t * L2 * rate * (c - 2.0 * b * grow) / size2
    Vdot[2, column] = -sign * t * rate * (a1 - 2.0 * a * grow) / size2


@internal
def meet(rolling: Rolling, position: Array, nu: Array, maps: Maps) -> None:
    """N of a base whose wheels all steer, and its rate: inverse iteration from the n before.

    Of the rows `r` of the masters on `(vx, vy, l w)`, `G = sum r r'` has n as the eigenvector of its least eigenvalue,
    and its adjugate is `sum of (r_i x r_j)(r_i x r_j)'` over pairs: n n' times a factor where all axles meet.
    """
    adj, adjdot, n, ndot = maps.gram[0], maps.gram[1], maps.gram[2, 0], maps.gram[2, 1]
    adjugate_of_axles(rolling, position, nu, maps)
    if maps.n[0] == 0.0 and maps.n[1] == 0.0 and maps.n[2] == 0.0:
        first_direction(rolling, position, adj, maps.n)
    for i in range(3):
        n[i], ndot[i] = maps.n[i], 0.0
    for _ in range(MOST_STEPS):
        if turn_towards(adj, adjdot, n, ndot) < SETTLED:
            break
    if n[0] * maps.n[0] + n[1] * maps.n[1] + n[2] * maps.n[2] < 0.0:
        for i in range(3):
            n[i], ndot[i] = -n[i], -ndot[i]
    known = n[0] + n[1] + n[2] == n[0] + n[1] + n[2]  # angles that are no numbers are forgotten
    for i in range(3):
        scale = 1.0 if i < 2 else 1.0 / rolling.length
        maps.n[i] = n[i] if known else maps.n[i]
        maps.V[0, i, 0], maps.Vdot[0, i, 0] = scale * n[i], scale * ndot[i]


@internal
def first_direction(rolling: Rolling, position: Array, adj: Array, n: Array) -> None:
    """The direction of u as most wheels roll forwards, ahead or to the left where as many roll backwards."""
    largest, forwards = 0, 0.0
    for i in range(3):
        if adj[i, i] > adj[largest, largest]:
            largest = i
    x, y, z = adj[0, largest], adj[1, largest], adj[2, largest]
    size = math.sqrt(x * x + y * y + z * z)
    for i in range(3):
        n[i] = adj[i, largest] / size
    for k in range(len(rolling.turns)):
        p, (c, s, _) = rolling.pivots[k], heading_of(rolling, k, position)
        forwards += c * n[0] + s * n[1] + (p[PIVOT.x] * s - p[PIVOT.y] * c) / rolling.length * n[2]
    sign = -1.0 if forwards < -TIE or (forwards < TIE and n[largest] < 0.0) else 1.0
    for i in range(3):
        n[i] *= sign


@internal
def adjugate_of_axles(rolling: Rolling, position: Array, nu: Array, maps: Maps) -> None:
    """The adjugate of the masters' `sum r r'` into `gram[0]`, its rate into `gram[1]`."""
    adj, adjdot = maps.gram[0], maps.gram[1]
    adj[:] = 0.0
    adjdot[:] = 0.0
    for i in range(len(rolling.turns)):
        for j in range(i):
            if rolling.turns[i, TURN.role] == MASTER and rolling.turns[j, TURN.role] == MASTER:
                add_meeting(rolling, i, j, position, nu, maps.gram[3], adj, adjdot)


@internal
def add_meeting(
    rolling: Rolling, i: int, j: int, position: Array, nu: Array, scratch: Array, adj: Array, adjdot: Array
) -> None:
    """Add `m m'` of the cross product m of two masters' rows, and its rate."""
    r, rd = axle_row(rolling, i, position, nu)
    q, qd = axle_row(rolling, j, position, nu)
    m, md = scratch[0], scratch[1]
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        m[a] = r[b] * q[c] - r[c] * q[b]
        md[a] = rd[b] * q[c] + r[b] * qd[c] - rd[c] * q[b] - r[c] * qd[b]
    for a in range(3):
        for b in range(3):
            adj[a, b] += m[a] * m[b]
            adjdot[a, b] += md[a] * m[b] + m[a] * md[b]


@compiled
def axle_row(
    rolling: Rolling, k: int, position: Array, nu: Array
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Row of master k on `(vx, vy, l w)` that vanishes where its wheel does not slide, and its rate."""
    p, (c, s, t) = rolling.pivots[k], heading_of(rolling, k, position)
    rate, per = p[PIVOT.sign] * nu[rolling.turns[k, TURN.column]], 1.0 / rolling.length
    x, y = p[PIVOT.x], p[PIVOT.y]
    return (-s, c, (x * c + y * s + t) * per), (-c * rate, -s * rate, (y * c - x * s) * rate * per)


@compiled
def turn_towards(adj: Array, adjdot: Array, n: Array, ndot: Array) -> float:
    """`n <- adj n / |adj n|` in place, and its rate; returns how far both moved, squared."""
    size2, grow = 0.0, 0.0
    before, before_dot = (n[0], n[1], n[2]), (ndot[0], ndot[1], ndot[2])
    (x, y, z), (xd, yd, zd) = before, before_dot
    for a in range(3):
        n[a] = adj[a, 0] * x + adj[a, 1] * y + adj[a, 2] * z
        ndot[a] = adjdot[a, 0] * x + adjdot[a, 1] * y + adjdot[a, 2] * z
        ndot[a] += adj[a, 0] * xd + adj[a, 1] * yd + adj[a, 2] * zd
        size2 += n[a] * n[a]
    size = math.sqrt(size2)
    for a in range(3):
        grow += n[a] * ndot[a] / size2
    for a in range(3):
        ndot[a] = (ndot[a] - n[a] * grow) / size
        n[a] = n[a] / size
    way = 1.0 if x * n[0] + y * n[1] + z * n[2] > 0.0 else -1.0
    moved, turned, fast = 0.0, 0.0, 1.0
    for a in range(3):
        off, more = n[a] - way * before[a], ndot[a] - way * before_dot[a]
        moved, turned, fast = moved + off * off, turned + more * more, fast + ndot[a] * ndot[a]
    return moved + turned / fast


@internal
def carry(rolling: Rolling, k: int, position: Array, nu: Array, maps: Maps) -> None:
    """Velocity of what pivot k carries, its row of T, and their rates; those of its carrier are known."""
    p, turn = rolling.pivots[k], rolling.turns[k]
    P, Pd, V, Vd = maps.V[turn[TURN.parent] + 1], maps.Vdot[turn[TURN.parent] + 1], maps.V[k + 1], maps.Vdot[k + 1]
    T, Td, row, sign, nb = maps.T, maps.Tdot, turn[TURN.place], p[PIVOT.sign], maps.V.shape[2]
    c, s = cos_sin(sign * position[row])
    for j in range(nb):
        vx, vy = P[0, j] - p[PIVOT.y] * P[2, j], P[1, j] + p[PIVOT.x] * P[2, j]
        V[0, j], V[1, j], V[2, j] = c * vx + s * vy, c * vy - s * vx, P[2, j]
    pivot_rates(rolling, k, position, nu, maps, T[row], Td[row])
    turning = 0.0
    for j in range(nb):
        turning += T[row, j] * nu[j]
    for j in range(nb):
        vx, vy = Pd[0, j] - p[PIVOT.y] * Pd[2, j], Pd[1, j] + p[PIVOT.x] * Pd[2, j]
        Vd[0, j] = c * vx + s * vy + turning * V[1, j]
        Vd[1, j] = c * vy - s * vx - turning * V[0, j]
        Vd[2, j] = Pd[2, j]
    if turn[TURN.role] == PASSIVE:
        trail = p[PIVOT.wheel_x] * p[PIVOT.c] + p[PIVOT.wheel_y] * p[PIVOT.s]
        for j in range(nb):
            Td[row, j] = -across(Vd, p[PIVOT.wheel_x], p[PIVOT.wheel_y], p[PIVOT.c], p[PIVOT.s], j) / trail
    for j in range(nb):
        V[2, j] += T[row, j]
        Vd[2, j] += Td[row, j]
        T[row, j] *= sign
        Td[row, j] *= sign


@internal
def pivot_rates(
    rolling: Rolling, k: int, position: Array, nu: Array, maps: Maps, rates: Array, ratesdot: Array
) -> None:
    """Rate of pivot k to the left per base velocity, and of a master or follower its rate; V[k + 1] is its place's."""
    p, turn, nb = rolling.pivots[k], rolling.turns[k], maps.V.shape[2]
    for j in range(nb):
        rates[j], ratesdot[j] = 0.0, 0.0
    if turn[TURN.role] == MASTER:
        rates[turn[TURN.column]] = p[PIVOT.sign]
    elif turn[TURN.role] == FOLLOWER:
        follow(rolling, k, position, nu, rates, ratesdot)
    else:
        trail = p[PIVOT.wheel_x] * p[PIVOT.c] + p[PIVOT.wheel_y] * p[PIVOT.s]
        for j in range(nb):
            rates[j] = -across(maps.V[k + 1], p[PIVOT.wheel_x], p[PIVOT.wheel_y], p[PIVOT.c], p[PIVOT.s], j) / trail


@internal
def follow(rolling: Rolling, k: int, position: Array, nu: Array, rates: Array, ratesdot: Array) -> None:
    """Rate of a follower: its wheel keeps along its path as the master turns.

    Of the master's `(a, b)` as in `steer_axle`, the path there is along `(a - y b, x b)`; the angle of it has the
    derivative `x (a b' - b a') / |.|^2`.
    """
    x, y = rolling.pivots[k, PIVOT.x], rolling.pivots[k, PIVOT.y]
    for m in range(len(rolling.turns)):
        if rolling.turns[m, TURN.role] == MASTER:
            q, column = rolling.pivots[m], rolling.turns[m, TURN.column]
            (c, s, t), sign = heading_of(rolling, m, position), q[PIVOT.sign]
            a, a1 = q[PIVOT.x] * c + q[PIVOT.y] * s + t, q[PIVOT.y] * c - q[PIVOT.x] * s
            P, Q, P1, Q1 = a - y * s, x * s, a1 - y * c, x * c
            size2, D = P * P + Q * Q, x * (a * c - s * a1)
            rates[column] = sign * D / size2
            ratesdot[column] = nu[column] * (-x * s * t * size2 - 2.0 * D * (P * P1 + Q * Q1)) / (size2 * size2)


def closed(rolling: Rolling, position: Array) -> Array:
    """The position with its followers where their master has them, (nv,) or (nv, N), changed in place."""
    masters = [place for role, _, place, _ in rolling.turns if role == MASTER]
    for k, turn in enumerate(rolling.turns):
        if turn[TURN.role] == FOLLOWER:
            for column in position.reshape(len(position), -1).T:
                column[turn[TURN.place]] = followed(rolling, k, column[masters[0]], column[turn[TURN.place]])
    return position


@compiled
def followed(rolling: Rolling, k: int, master: float, now: float) -> float:
    """Angle of follower k where its master stands at an angle: of the two along its path the nearer to `now` [rad]."""
    p, want = rolling.pivots[k], 0.0
    for i in range(len(rolling.turns)):
        if rolling.turns[i, TURN.role] == MASTER:
            m = rolling.pivots[i]
            c0, s0 = cos_sin(m[PIVOT.sign] * master)
            c, s = c0 * m[PIVOT.c] - s0 * m[PIVOT.s], s0 * m[PIVOT.c] + c0 * m[PIVOT.s]
            trail = m[PIVOT.wheel_x] * m[PIVOT.c] + m[PIVOT.wheel_y] * m[PIVOT.s]
            along = m[PIVOT.x] * c + m[PIVOT.y] * s + trail - p[PIVOT.y] * s
            want = atan2(p[PIVOT.x] * s, along) - atan2(p[PIVOT.s], p[PIVOT.c])
    turned = want - p[PIVOT.sign] * now
    return p[PIVOT.sign] * (p[PIVOT.sign] * now + turned - math.pi * math.floor(turned / math.pi + 0.5))
