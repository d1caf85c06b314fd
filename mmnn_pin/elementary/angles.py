"""Angles: sine, cosine, tangent and their inverses."""

from __future__ import annotations

import math

import numpy as np

from ..compiled import compiled
from .bits import INF, NAN, ROUND, bits_of, exponent, high, horner
from .two_doubles import product

# pi/2 in pieces of 33 bits, each with its rest
PER_PIO2 = 6.36619772367581382433e-01
PIO2_1, PIO2_1T = 1.57079632673412561417e00, 6.07710050650619224932e-11
PIO2_2, PIO2_2T = 6.07710050630396597660e-11, 2.02226624879595063154e-21
PIO2_3, PIO2_3T = 2.02226624871116645580e-21, 8.47842766036889956997e-32
PIO2, PIO2_LO = 1.57079632679489655800e00, 6.12323399573676603587e-17
PI, PI_LO = 3.14159265358979311600e00, 1.22464679914735317720e-16
MEDIUM = 1647099.0  # 2^20 pi/2: below it the pieces of pi/2 suffice
SIN = (-1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
       2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10)  # fmt: skip
COS = (4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
       -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11)  # fmt: skip
TAN = (3.33333333333334091986e-01, 1.33333333333201242699e-01, 5.39682539762260521377e-02, 2.18694882948595424599e-02,
       8.86323982359930005737e-03, 3.59207910759131235356e-03, 1.45620945432529025516e-03, 5.88041240820264096874e-04,
       2.46463134818469906812e-04, 7.81794442939557092300e-05, 7.14072491382608190305e-05, -1.85586374855275456654e-05,
       2.59073051863633712884e-05)  # fmt: skip
ATAN = (3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01,
        -1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02,
        6.66107313738753120669e-02, -5.83357013379057348645e-02, 4.97687799461593236017e-02,
        -3.65315727442169155270e-02, 1.62858201153657823623e-02)  # fmt: skip
TAN_ODD, TAN_EVEN, ATAN_EVEN, ATAN_ODD = TAN[1::2], TAN[2::2], ATAN[::2], ATAN[1::2]
# Arctangents of 0.5, 1, 1.5 and infinity, in two parts.
ATAN_HI = (4.63647609000806093515e-01, 7.85398163397448278999e-01, 9.82793723247329054082e-01, 1.57079632679489655800)
ATAN_LO = (2.26987774529616870924e-17, 3.06161699786838301793e-17, 1.39033110312309984516e-17, PIO2_LO)
# 2/pi in words of 24 bits, behind two words of zeros: enough for the largest doubles.
TWO_OVER_PI = np.array(
    [
        0x000000, 0x000000, 0xA2F983, 0x6E4E44, 0x1529FC, 0x2757D1, 0xF534DD, 0xC0DB62, 0x95993C,
        0x439041, 0xFE5163, 0xABDEBB, 0xC561B7, 0x246E3A, 0x424DD2, 0xE00649, 0x2EEA09, 0xD1921C,
        0xFE1DEB, 0x1CB129, 0xA73EE8, 0x8235F5, 0x2EBB44, 0x84E99C, 0x7026B4, 0x5F7E41, 0x3991D6,
        0x398353, 0x39F49C, 0x845F8B, 0xBDF928, 0x3B1FF8, 0x97FFDE, 0x05980F, 0xEF2F11, 0x8B5A0A,
        0x6D1F6D, 0x367ECF, 0x27CB09, 0xB74F46, 0x3F669E, 0x5FEA2D, 0x7527BA, 0xC7EBE5, 0xF17B3D,
        0x0739F7, 0x8A5292, 0xEA6BFB, 0x5FB11F, 0x8D5D08, 0x560330, 0x46FC7B, 0x6BABF0, 0xCFBC20,
    ],
    dtype=np.int64,
)  # fmt: skip
WORD = 0xFFFFFF
TURN = 6.28318530717958623200e00  # 2 pi


@compiled
def window(first: int, j: int) -> int:
    """Digit j (0 the lowest) of the eight of 24 bits that follow bit `first` of the table."""
    at = first + 24 * (7 - j)
    q, shift = at // 24, at % 24
    return ((TWO_OVER_PI[q] << shift) | (TWO_OVER_PI[q + 1] >> (24 - shift))) & WORD


@compiled
def added(total: float, rest: float, part: float) -> tuple[float, float]:
    """`total + rest + part`, part above the total, as a sum and its rest."""
    whole = part + total
    return whole, rest + (total - (whole - part))


@compiled
def reduced_large(a: float) -> tuple[int, float, float]:
    """`reduced` for a large positive angle: its mantissa times those bits of 2/pi that matter (Payne and Hanek 1983).

    With `a = m 2^e`, m an integer of 53 bits, the bits of 2/pi that come out as multiples of 4 are skipped. m times the
    192 bits that follow is exact; its lowest 190 bits are the fraction of a quarter turn, to 2^-137.
    """
    e = exponent(a) - 52
    m = (bits_of(a) & 0xFFFFFFFFFFFFF) | 0x10000000000000
    m0, m1, m2 = m & WORD, (m >> 24) & WORD, m >> 48
    first = e - 2 + 48
    before = last = carry = digit = 0
    up, up_rest, down, down_rest, unit = 0.0, 0.0, 0.0, 0.0, 2.0**-190
    for j in range(8):  # the digits of the product, the lowest first; `down` is 1 less the fraction
        here = window(first, j)
        column = carry + m0 * here + m1 * last + m2 * before
        before, last = last, here
        digit, carry = column & WORD, column >> 24
        most = WORD if j < 7 else 0x3FFFFF
        up, up_rest = added(up, up_rest, (digit & most) * unit)
        down, down_rest = added(down, down_rest, ((WORD - digit) & most) * unit)
        unit *= 2.0**24
    n = digit >> 22  # whole quarters
    if (digit >> 21) & 1:  # the next one is nearer
        n, sum_, rest = n + 1, -down, -down_rest
    else:
        sum_, rest = up, up_rest
    y0, y1 = product(sum_, PIO2)
    y1 += sum_ * PIO2_LO + rest * PIO2
    whole = y0 + y1
    return n, whole, y1 - (whole - y0)


@compiled
def reduced(x: float) -> tuple[int, float, float]:
    """A finite angle as `n pi/2 + y0 + y1`, `|y0| <= pi/4` (about), y1 the rest of y0; n modulo 4."""
    a = abs(x)
    if a <= 0.78539816339744828:
        return 0, x, 0.0
    if a > MEDIUM:
        n, y0, y1 = reduced_large(a)
    else:
        fn = a * PER_PIO2 + ROUND - ROUND
        n = int(fn)
        r, w = a - fn * PIO2_1, fn * PIO2_1T
        y0 = r - w
        top = exponent(a)
        if top - exponent(y0) > 16:  # a second piece of pi/2, good to 118 bits
            t = r
            w = fn * PIO2_2
            r = t - w
            w = fn * PIO2_2T - ((t - r) - w)
            y0 = r - w
            if top - exponent(y0) > 49:  # a third, 151 bits: enough for all doubles
                t = r
                w = fn * PIO2_3
                r = t - w
                w = fn * PIO2_3T - ((t - r) - w)
                y0 = r - w
        y1 = (r - y0) - w
    if x < 0.0:
        return -n & 3, -y0, -y1
    return n & 3, y0, y1


@compiled
def sin_near(x: float, y: float) -> float:
    """Sine of `x + y`, |x| below pi/4 (about), y its rest."""
    z = x * x
    w = z * z
    r = SIN[1] + z * (SIN[2] + z * SIN[3]) + z * w * (SIN[4] + z * SIN[5])
    v = z * x
    return x - ((z * (0.5 * y - v * r) - y) - v * SIN[0])


@compiled
def cos_near(x: float, y: float) -> float:
    """Cosine of `x + y`, |x| below pi/4 (about), y its rest."""
    z = x * x
    w = z * z
    r = z * (COS[0] + z * (COS[1] + z * COS[2])) + w * w * (COS[3] + z * (COS[4] + z * COS[5]))
    half = 0.5 * z
    one = 1.0 - half
    return one + (((1.0 - one) - half) + (z * r - x * y))


@compiled
def sin(x: float) -> float:
    """The sine of an angle [rad]."""
    if -0.78539816339744828 <= x <= 0.78539816339744828:
        return x if -7.45e-9 < x < 7.45e-9 else sin_near(x, 0.0)
    if not -INF < x < INF:
        return NAN
    n, y0, y1 = reduced(x)
    if n == 0:
        return sin_near(y0, y1)
    if n == 1:
        return cos_near(y0, y1)
    return -sin_near(y0, y1) if n == 2 else -cos_near(y0, y1)


@compiled
def cos(x: float) -> float:
    """The cosine of an angle [rad]."""
    if -0.78539816339744828 <= x <= 0.78539816339744828:
        return cos_near(x, 0.0)
    if not -INF < x < INF:
        return NAN
    n, y0, y1 = reduced(x)
    if n == 0:
        return cos_near(y0, y1)
    if n == 1:
        return -sin_near(y0, y1)
    return -cos_near(y0, y1) if n == 2 else sin_near(y0, y1)


@compiled
def cos_sin(x: float) -> tuple[float, float]:
    """Cosine and sine of an angle [rad], the bits of `cos` and `sin` in the time of one."""
    if -7.45e-9 < x < 7.45e-9:
        return 1.0, x
    if not -INF < x < INF:
        return NAN, NAN
    n, y0, y1 = reduced(x)
    c, s = cos_near(y0, y1), sin_near(y0, y1)
    if n & 1:
        c, s = -s, c
    return (-c, -s) if n & 2 else (c, s)


@compiled
def tan(x: float) -> float:
    """The tangent of an angle [rad]."""
    if -3.7e-9 < x < 3.7e-9:
        return x
    if not -INF < x < INF:
        return NAN
    n, y0, y1 = reduced(x)
    return tan_near(y0, y1, n & 1 == 1)


@compiled
def tan_near(x: float, y: float, inverse: bool) -> float:
    """Tangent of `x + y`, |x| below pi/4 (about), y its rest; or its inverse with the sign changed."""
    negative, large = x < 0.0, abs(x) >= 0.6744
    if large:
        if negative:
            x, y = -x, -y
        x, y = (7.85398163397448278999e-01 - x) + (3.06161699786838301793e-17 - y), 0.0
    z = x * x
    w = z * z
    r, v = horner(w, TAN_ODD, 5), z * horner(w, TAN_EVEN, 5)
    s = z * x
    r = y + z * (s * (r + v) + y) + TAN[0] * s
    w = x + r
    if large:
        sign = -1.0 if negative else 1.0
        unit = -1.0 if inverse else 1.0
        return sign * (unit - 2.0 * (x - (w * w / (w + unit) - r)))
    if not inverse:
        return w
    above = high(w)
    v = r - (above - x)
    a = -1.0 / w
    t = high(a)
    return t + a * (1.0 + t * above + t * v)


@compiled
def atan(x: float) -> float:
    """The arctangent, from -pi/2 to pi/2 [rad]."""
    a = abs(x)
    if a >= 7.378697629483821e19:
        return PIO2 + PIO2_LO if x > 0.0 else -PIO2 - PIO2_LO
    if a < 0.4375:
        which, t = -1, x
    elif a < 0.6875:
        which, t = 0, (2.0 * a - 1.0) / (2.0 + a)
    elif a < 1.1875:
        which, t = 1, (a - 1.0) / (a + 1.0)
    elif a < 2.4375:
        which, t = 2, (a - 1.5) / (1.0 + 1.5 * a)
    else:
        which, t = 3, -1.0 / a
    if which < 0 and a < 7.45e-9:
        return x
    z = t * t
    w = z * z
    s1, s2 = z * horner(w, ATAN_EVEN, 5), w * horner(w, ATAN_ODD, 4)
    if which < 0:
        return t - t * (s1 + s2)
    y = ATAN_HI[which] - ((t * (s1 + s2) - ATAN_LO[which]) - t)
    return -y if x < 0.0 else y


@compiled
def atan2(y: float, x: float) -> float:
    """The angle of the point (x, y), from -pi to pi [rad], with the signs of zeros as in C99."""
    if x != x or y != y:
        return NAN
    left, below = bits_of(x) < 0, bits_of(y) < 0
    a, b = abs(y), abs(x)
    if a == 0.0:
        angle = PI if left else 0.0
    elif b == 0.0:
        angle = PIO2
    elif b == INF:
        angle = (2.356194490192345 if left else 0.7853981633974483) if a == INF else (PI if left else 0.0)
    elif a == INF:
        angle = PIO2
    else:
        k = exponent(a) - exponent(b)
        if k > 60:
            angle = PIO2 + 0.5 * PI_LO
        elif k < -60 and left:
            angle = PI
        else:
            z = atan(a / b)
            angle = PI - (z - PI_LO) if left else z
    return -angle if below else angle


@compiled
def nearest_turn(angle: float, near: float) -> float:
    """An angle moved by whole turns to within half a turn of another one [rad]; unchanged where it is so already."""
    turns = math.floor((angle - near) / TURN + 0.5)
    return angle - turns * TURN if turns != 0.0 else angle
