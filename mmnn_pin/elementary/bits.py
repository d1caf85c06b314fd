"""The bits of a double, read and written in compiled code and in plain Python alike."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

from ..compiled import compiled, inlined

INF, NAN = math.inf, math.nan
TWO_54, TWO_M54 = 2.0**54, 2.0**-54
ROUND = 1.5 * 2.0**52  # added and taken away, it rounds a double below 2^51 to the nearest integer
LN2_HI, LN2_LO, PER_LN2 = 6.93147180369123816490e-01, 1.90821492927058770002e-10, 1.44269504088896338700e00


def bits_of(x: float) -> int:
    """The bits of a double as an int64."""
    return int(struct.unpack("<q", struct.pack("<d", x))[0])


def from_bits(bits: int) -> float:
    """The double of an int64's bits."""
    return float(struct.unpack("<d", struct.pack("<q", bits))[0])


ROUND_BITS = bits_of(ROUND)


@intrinsic
def as_int(typing_context: Any, x: Any) -> Any:
    """The bits of a double in compiled code; in plain Python there is `bits_of`."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), code


@intrinsic
def as_double(typing_context: Any, x: Any) -> Any:
    """The double of some bits in compiled code; in plain Python there is `from_bits`."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.DoubleType())

    return types.float64(types.int64), code


@overload(bits_of, strict=False)
def _bits_of(x: Any) -> Callable[[Any], Any]:
    return lambda x: as_int(float(x))  # type: ignore[call-arg]


@overload(from_bits, strict=False)
def _from_bits(bits: Any) -> Callable[[Any], Any]:
    return lambda bits: as_double(bits)  # type: ignore[call-arg]


@compiled
def exponent(x: float) -> int:
    """The power of two of a normal number: 0 in [1, 2)."""
    return ((bits_of(x) >> 52) & 0x7FF) - 1023


@compiled
def high(x: float) -> float:
    """A number without the lower 32 bits of its mantissa."""
    return from_bits(bits_of(x) & ~0xFFFFFFFF)


@compiled
def scaled(x: float, k: int) -> float:
    """`x 2^k`, for any k, rounded once."""
    if k > 1023:
        x, k = x * 2.0**1023, k - 1023
        if k > 1023:
            x, k = x * 2.0**1023, min(k - 1023, 1023)
    elif k < -1022:
        x, k = x * 2.0**-969, k + 969  # 2^-1022 2^53: what is lost is lost in the last step only
        if k < -1022:
            x, k = x * 2.0**-969, max(k + 969, -1022)
    return x * from_bits((k + 1023) << 52)


@inlined
def horner(z: float, c: tuple[float, ...], last: int) -> float:
    """`c[0] + c[1] z + ... + c[last] z^last`."""
    total = c[last]
    for i in range(last - 1, -1, -1):
        total = c[i] + z * total
    return total
