"""Exponentials and logarithms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled, inlined
from .bits import (
    INF,
    LN2_HI,
    LN2_LO,
    NAN,
    PER_LN2,
    ROUND,
    ROUND_BITS,
    TWO_54,
    TWO_M54,
    bits_of,
    from_bits,
    horner,
    scaled,
)

# Coefficients of the polynomials, lowest power first.
EXP = (1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05,
       -1.65339022054652515390e-06, 4.13813679705723846039e-08)  # fmt: skip
EXPM1 = (-3.33333333333331316428e-02, 1.58730158725481460165e-03, -7.93650757867487942473e-05,
         4.00821782732936239552e-06, -2.01099218183624371326e-07)  # fmt: skip
LOG = (6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01, 2.222219843214978396e-01,
       1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01)  # fmt: skip
LOG_EVEN, LOG_ODD = LOG[::2], LOG[1::2]
TANH_P = (-1.61468768441708447952e3, -9.92877231001918586564e1, -9.64399179425052238628e-1)
TANH_Q = (4.84406305325125486048e3, 2.23548839060100448583e3, 1.12811678491632931402e2, 1.0)


@compiled
def exp(x: float) -> float:
    """`e^x`; 0 below -745.2, inf above 709.8."""
    if not (-745.2 < x < 709.8):
        return x if x != x else (INF if x > 0.0 else 0.0)
    k = x * PER_LN2 + ROUND - ROUND
    return scaled(exp_within(x, k), int(k))


@inlined
def exp_within(x: float, k: float) -> float:
    """`e^(x - k ln 2)`, k being the integer next to `x / ln 2`."""
    above, below = x - k * LN2_HI, k * LN2_LO
    r = above - below
    t = r * r
    c = r - t * horner(t, EXP, 4)
    return 1.0 + (above + ((r * c) / (2.0 - c) - below))


@compiled
def sigmoids(x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
    """`1 / (1 + e^-x)` of a vector, written to another; the bits are those of `exp`, one by one.

    Where all are within the range of powers of two, these are the steps of `exp` without its branches: the processor
    works on several numbers at a time.
    """
    beyond = 0
    for j in range(x.size):
        beyond += 0 if -700.0 < x[j] < 700.0 else 1
    if beyond > 0:
        for j in range(x.size):
            y[j] = 1.0 / (1.0 + exp(-x[j]))
        return
    for j in range(x.size):
        k = -x[j] * PER_LN2 + ROUND
        power = from_bits((bits_of(k) - ROUND_BITS + 1023) << 52)
        y[j] = 1.0 / (1.0 + exp_within(-x[j], k - ROUND) * power)


@compiled
def expm1(x: float) -> float:
    """`e^x - 1`, exact to the last place also where x is small."""
    if x != x:
        return x
    if x > 709.8:
        return INF
    if x < -37.5:
        return -1.0
    if -TWO_M54 < x < TWO_M54:
        return x
    k, c = 0.0, 0.0
    if not -0.34657 < x < 0.34657:
        k = x * PER_LN2 + ROUND - ROUND
        above, below = x - k * LN2_HI, k * LN2_LO
        x = above - below
        c = (above - x) - below
    half = 0.5 * x
    hxs = x * half
    r1 = 1.0 + hxs * horner(hxs, EXPM1, 4)
    t = 3.0 - r1 * half
    e = hxs * ((r1 - t) / (6.0 - x * t))
    if k == 0.0:
        return x - (x * e - hxs)
    e = x * (e - c) - c - hxs
    if k == -1.0:
        return 0.5 * (x - e) - 0.5
    if k == 1.0:
        return -2.0 * (e - (x + 0.5)) if x < -0.25 else 1.0 + 2.0 * (x - e)
    n = int(k)
    if n <= -2 or n > 56:
        return scaled(1.0 - (e - x), n) - 1.0
    if n < 20:
        return scaled((1.0 - from_bits((1023 - n) << 52)) - (e - x), n)
    return scaled((x - (e + from_bits((1023 - n) << 52))) + 1.0, n)


@compiled
def log(x: float) -> float:
    """The natural logarithm; -inf at 0, nan below."""
    if not (0.0 < x < INF):
        return -INF if x == 0.0 else (x if x != x or x > 0.0 else NAN)
    k = 0
    if x < 2.2250738585072014e-308:
        x, k = x * TWO_54, -54
    bits = bits_of(x) + (0x3FF0000000000000 - 0x3FE6A09E667F3BCD)  # the mantissa from sqrt(1/2) to sqrt(2)
    k += (bits >> 52) - 1023
    f = from_bits((bits & 0xFFFFFFFFFFFFF) + 0x3FE6A09E667F3BCD) - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    odd, even = z * horner(w, LOG_EVEN, 3), w * horner(w, LOG_ODD, 2)
    half = 0.5 * f * f
    return k * LN2_HI - ((half - (s * (half + odd + even) + k * LN2_LO)) - f)


@compiled
def tanh(x: float) -> float:
    """The hyperbolic tangent: a rational function in the middle, by the exponential beyond."""
    a = abs(x)
    if a < 0.625:
        z = x * x
        return x + x * z * horner(z, TANH_P, 2) / horner(z, TANH_Q, 3) if a > 2.0**-28 else x
    if a < 22.0:
        z = 1.0 - 2.0 / (exp(2.0 * a) + 1.0)
    elif a >= 22.0:
        z = 1.0
    else:
        return x
    return z if x > 0.0 else -z
