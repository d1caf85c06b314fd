"""Lengths and powers, by products and sums that are kept as two doubles."""

from __future__ import annotations

import math

from ..compiled import compiled
from .bits import INF, LN2_HI, LN2_LO, NAN, PER_LN2, ROUND, TWO_54, bits_of, from_bits, horner, scaled

ODD = tuple(1.0 / n for n in range(5, 25, 2))  # of the logarithm, behind s + s^3/3
FACTORIALS = tuple(1.0 / math.factorial(n) for n in range(2, 14))  # of the exponential, behind 1 + r


@compiled
def product(a: float, b: float) -> tuple[float, float]:
    """`a b` as two doubles, exact where nothing over- or underflows (Dekker 1971)."""
    p = a * b
    t = 134217729.0 * a
    a1 = t - (t - a)
    t = 134217729.0 * b
    b1 = t - (t - b)
    a0, b0 = a - a1, b - b1
    return p, ((a1 * b1 - p) + a1 * b0 + a0 * b1) + a0 * b0


@compiled
def hypot(x: float, y: float) -> float:
    """`sqrt(x^2 + y^2)` without over- or underflow on the way."""
    a, b = abs(x), abs(y)
    if a == INF or b == INF:
        return INF
    if a != a or b != b:
        return NAN
    if a < b:
        a, b = b, a
    if b == 0.0 or a > b * 2.0**54:
        return a + b
    unit = 1.0
    if a > 2.0**510:
        a, b, unit = a * 2.0**-700, b * 2.0**-700, 2.0**700
    elif b < 2.0**-450:
        a, b, unit = a * 2.0**700, b * 2.0**700, 2.0**-700
    a2, a2_rest = product(a, a)
    b2, b2_rest = product(b, b)
    whole = a2 + b2
    return unit * math.sqrt(whole + (((a2 - whole) + b2) + (a2_rest + b2_rest)))


@compiled
def pow(x: float, y: float) -> float:
    """`x^y`, special values as in C99."""
    if y == 0.0 or x == 1.0:
        return 1.0
    if x != x or y != y:
        return NAN
    a, size = abs(x), abs(y)
    is_whole = size >= 2.0**52 or math.floor(size) == size
    is_odd = is_whole and size < 2.0**53 and math.floor(size * 0.5) * 2.0 != size
    sign = -1.0 if is_odd and bits_of(x) < 0 else 1.0
    if size == INF:
        return 1.0 if a == 1.0 else (INF if (a > 1.0) == (y > 0.0) else 0.0)
    if a == 0.0 or a == INF:
        return sign * (INF if (a == INF) == (y > 0.0) else 0.0)
    if x < 0.0 and not is_whole:
        return NAN
    if a == 1.0:
        return sign
    if size > 1e22:
        return sign * (INF if (a > 1.0) == (y > 0.0) else 0.0)
    h, h_rest = log_in_two(a)
    p, p_rest = product(y, h)
    return sign * exp_of_two(p, p_rest + y * h_rest)


@compiled
def log_in_two(x: float) -> tuple[float, float]:
    """The natural logarithm of a positive number as two doubles, to about 2^-68 of itself."""
    k = 0
    if x < 2.2250738585072014e-308:
        x, k = x * TWO_54, -54
    bits = bits_of(x) + (0x3FF0000000000000 - 0x3FE6A09E667F3BCD)
    k += (bits >> 52) - 1023
    z = from_bits((bits & 0xFFFFFFFFFFFFF) + 0x3FE6A09E667F3BCD)
    f = z - 1.0  # exact
    g = 2.0 + f
    g_rest = f - (g - 2.0)
    s = f / g  # log z = 2 (s + s^3/3 + s^5/5 + ...)
    p, r = product(s, g)
    s_rest = (((f - p) - r) - s * g_rest) / g
    q, q_rest = product(s, s)
    q_rest += 2.0 * s * s_rest
    tail = horner(q, ODD, 9)
    # third = 1/3 + q tail, in two parts; then s (1 + q third)
    t, t_rest = product(q, tail)
    third = 1.0 / 3.0 + t
    third_rest = (t - (third - 1.0 / 3.0)) + t_rest + 1.850371707708594e-17
    u, u_rest = product(q, third)
    u_rest += q * third_rest + q_rest * third
    v, v_rest = product(s, u)
    v_rest += s * u_rest + s_rest * u
    total = s + v
    rest = (v - (total - s)) + v_rest + s_rest
    high_part = k * LN2_HI  # exact: LN2_HI has 32 bits
    total, rest = 2.0 * total, 2.0 * rest
    whole = high_part + total
    if abs(high_part) > abs(total):
        rest += total - (whole - high_part)
    else:
        rest += high_part - (whole - total)
    below, below_rest = product(float(k), LN2_LO)
    rest += below + below_rest
    h = whole + rest
    return h, rest - (h - whole)


@compiled
def exp_of_two(h: float, h_rest: float) -> float:
    """`e^(h + h_rest)`, h_rest small beside h."""
    if not (-746.0 < h < 710.0):
        return INF if h > 0.0 else 0.0
    k = h * PER_LN2 + ROUND - ROUND
    n = int(k)
    above = h - k * LN2_HI
    below = k * LN2_LO - h_rest
    r = above - below
    rest = (above - r) - below
    # e^r - 1 - r by its series, |r| below 0.35; what is left of r is added to first order
    t = r * r * horner(r, FACTORIALS, 11)
    return scaled(1.0 + (r + (t + rest * (1.0 + r))), n)
