"""The law that steers: from a velocity asked of the control frame to the velocities of a base that steers.

The law of the pose, Kanayama's or the holonomic one, asks for `eta_c = (vx, vy, w)` of the control frame. Of every
wheel that steers, with its rows a (across) and `-a'` (along) on eta, `a' = da / d heading`,

    s = a eta_c         f = -a' eta_c         tan chi = s / f

chi is the angle from the wheel to its path as asked. With q = a deta_c, p = -a' deta_c:

    u_c    = n' W eta_c                                             as much of the velocity as the wheels permit
    zeta_c = (K chi (s^2 + f^2) + q f - p s) / (s^2 + f^2 + eps^2)

The first part turns the wheel to its path by the shortest way, it may run backwards: of the angles half turns apart
chi is the least that lies between the wheel's stops. The rest is the path's own turning. Where the base moves as asked
and eps = 0, `dchi/dt = -K chi`. Where nothing is asked, nothing steers: the wheels coast. Towards a stop a wheel turns
more slowly.

A loader's waist moves its body as it turns: the axle off it by t has `s + t zeta = 0`, and `zeta_c = -s / t` moves the
control frame exactly as asked. The waist settles where that axle leads, and folds up where it is pushed, as a hitch.
A waist that is pushed at a velocity, with no pose to come back to, turns as any wheel.

Everything has its rate beside it; the second derivative of eta_c is given.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ...by_address import by_address
from ...compiled import compiled, internal
from ...elementary import atan2
from ...signals import Array
from .rolling import AXLE, MASTER, PIVOT, STEERED, TURN, Maps, Rolling, heading_of


class Asked(NamedTuple):
    """Speeds asked of a wheel, across and along it, their rates, and the rates of these [m/s, m/s^2, m/s^3]."""

    s: float
    f: float
    q: float
    p: float
    sdot: float
    fdot: float
    qdot: float
    pdot: float


@by_address
class SteeringNumbers(NamedTuple):
    """The numbers of the law."""

    rate: float  # K, how fast a wheel turns to its path [1/s]
    slow: float  # eps, the speed under which wheels steer less [m/s]
    align: bool  # whether the base waits for wheels that do not stand along their paths
    waist: bool  # whether what steers is a loader's waist


@internal
def steered_velocity(  # noqa: PLR0913 - what is read, then what is written
    rolling: Rolling, angles: Array, nu: Array, maps: Maps, numbers: SteeringNumbers, asked: Array, jogs: bool,
    alpha: Array, alphadot: Array,
) -> None:  # fmt: skip
    """Velocities of a base that steers, and their derivative, from what the law of its pose asks for.

    Args:
        rolling: The base, its pivots placed in `angles`.
        angles: (K,) measured angles of its pivots [rad].
        nu: (nb,) measured base velocities.
        maps: Its maps there.
        numbers: Of the law.
        asked: (3, 3) `eta_c`, its derivative, and the derivative of that.
        jogs: Whether a loader is asked for a velocity, and for no pose.
        alpha: (nb,) written.
        alphadot: (nb,) written.
    """
    first = 1
    if rolling.body == STEERED:
        along_n(rolling, maps, asked, alpha, alphadot)
    elif rolling.body == AXLE:
        alpha[0], alpha[1], alphadot[0], alphadot[1] = asked[0, 0], asked[0, 2], asked[1, 0], asked[1, 2]
        first = 2
    else:
        for i in range(3):
            alpha[i], alphadot[i] = asked[0, i], asked[1, i]
        first = 3
    waits, waitsdot = 1.0, 0.0
    for k in range(len(rolling.turns)):
        if rolling.turns[k, TURN.role] == MASTER:
            j = rolling.turns[k, TURN.column]
            a = asked_of(rolling, k, angles, nu[j], asked)
            alpha[j], alphadot[j] = turned_wheel(rolling, k, angles, nu[j], numbers, a, jogs)
            size2 = a.s * a.s + a.f * a.f + numbers.slow * numbers.slow
            aligned = 1.0 - a.s * a.s / size2
            aligning = -2.0 * (a.s * a.sdot * size2 - a.s * a.s * (a.s * a.sdot + a.f * a.fdot)) / (size2 * size2)
            if aligned < waits:
                waits, waitsdot = aligned, aligning
    if numbers.align and first == 1:
        alphadot[0] = waits * alphadot[0] + waitsdot * alpha[0]
        alpha[0] *= waits


@compiled
def along_n(rolling: Rolling, maps: Maps, asked: Array, alpha: Array, alphadot: Array) -> None:
    """`u_c = n' W eta_c` and its derivative."""
    alpha[0], alphadot[0] = 0.0, 0.0
    for i in range(3):
        weight = 1.0 if i < 2 else rolling.length * rolling.length
        n, ndot = weight * maps.V[0, i, 0], weight * maps.Vdot[0, i, 0]
        alpha[0] += n * asked[0, i]
        alphadot[0] += ndot * asked[0, i] + n * asked[1, i]


@compiled
def part(asked: Array, i: int, x: float, y: float, w: float) -> float:
    """A row (x, y, w) on what is asked, or on a derivative of it."""
    return x * asked[i, 0] + y * asked[i, 1] + w * asked[i, 2]


@compiled
def asked_of(rolling: Rolling, k: int, angles: Array, rate: float, asked: Array) -> Asked:
    """The speeds that the wheel of master k is asked for; rate is that of its joint [rad/s]."""
    p, (c, s, t) = rolling.pivots[k], heading_of(rolling, k, angles)
    turning = p[PIVOT.sign] * rate
    across, along = p[PIVOT.x] * c + p[PIVOT.y] * s + t, p[PIVOT.x] * s - p[PIVOT.y] * c
    a0, a1, a2 = part(asked, 0, -s, c, across), part(asked, 1, -s, c, across), part(asked, 2, -s, c, across)
    f0, f1, f2 = part(asked, 0, c, s, along), part(asked, 1, c, s, along), part(asked, 2, c, s, along)
    swing = turning * t  # of a wheel off its axis, d along / d heading = across - t
    return Asked(
        a0, f0, a1, f1, a1 - f0 * turning, f1 + a0 * turning - swing * asked[0, 2],
        a2 - f1 * turning, f2 + a1 * turning - swing * asked[1, 2],
    )  # fmt: skip


@compiled
def turned_wheel(
    rolling: Rolling, k: int, angles: Array, rate: float, numbers: SteeringNumbers, a: Asked, jogs: bool
) -> tuple[float, float]:
    """Rate of the joint of master k, and its derivative; within its limits."""
    p, K, sign = rolling.pivots[k], numbers.rate, rolling.pivots[k, PIVOT.sign]
    size2 = a.s * a.s + a.f * a.f
    size2dot = 2.0 * (a.s * a.sdot + a.f * a.fdot)
    below = size2 + numbers.slow * numbers.slow
    back, backdot = 0.0, 0.0
    low, high = sign * p[PIVOT.lower], sign * p[PIVOT.upper]
    if sign < 0.0:
        low, high = high, low
    now = sign * angles[rolling.turns[k, TURN.place]]
    if size2 > 0.0:
        chi, inside = way_between(atan2(a.s, a.f), now, low, high)
        chidot = (a.sdot * a.f - a.s * a.fdot) / size2 if inside else -sign * rate
        back, backdot = chi * size2, chidot * size2 + chi * size2dot
    top = K * back + a.q * a.f - a.p * a.s
    topdot = K * backdot + a.qdot * a.f + a.q * a.fdot - a.pdot * a.s - a.p * a.sdot
    zeta, zetadot = 0.0, 0.0
    if below > 0.0:
        zeta, zetadot = top / below, (topdot - top * size2dot / below) / below
    trail = heading_of(rolling, k, angles)[2]
    if numbers.waist and not (jogs and trail * a.f > 0.0):
        zeta, zetadot = -a.s / trail, -a.sdot / trail
    most, least = min(p[PIVOT.rate], 2.0 * K * (high - now)), max(-p[PIVOT.rate], 2.0 * K * (low - now))
    if zeta > most:
        zeta, zetadot = most, 0.0 if most == p[PIVOT.rate] else -2.0 * K * sign * rate
    elif zeta < least:
        zeta, zetadot = least, 0.0 if least == -p[PIVOT.rate] else -2.0 * K * sign * rate
    return sign * zeta, sign * zetadot


@compiled
def way_between(chi: float, now: float, low: float, high: float) -> tuple[float, bool]:
    """Of the angles from a wheel to its path, half turns apart, the least between its stops, and whether there is one.

    Without one it is the angle to the stop that is nearest to one.
    """
    best, found, nearest, missed = 0.0, False, 0.0, math.inf
    for turns in range(-2, 3):
        e = chi + turns * math.pi
        beyond = max(low - now - e, now + e - high)
        if beyond <= 0.0 and (not found or abs(e) < abs(best)):
            best, found = e, True
        if beyond < missed:
            missed, nearest = beyond, min(max(now + e, low), high) - now
    return (best, True) if found else (nearest, False)
