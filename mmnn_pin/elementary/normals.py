"""Normal distribution: numpy's random numbers, and its distribution function, without a libm.

numpy draws normal numbers by a ziggurat (Marsaglia and Tsang 2000), which needs a logarithm in the tail and an
exponential at its edges, and takes both from the libm. `standard_normal` draws from the same stream with our own, and
leaves the generator where numpy would: the same numbers, but for the last place of one in 4,000.
"""

from __future__ import annotations

import math

import numpy as np
from numba.np.random import _constants as ziggurat
from numpy.typing import NDArray

from .arrays import Array
from .bits import horner
from .exponentials import exp, log

UNIT = 2.0**-53
ROOM = 64  # 64-bit words beyond one per number, and 1 % more
# Wichura 1988, algorithm AS 241 (PPND16), lowest power first: the middle, the flanks, the tails.
MIDDLE = (
    (3.3871328727963666080e0, 1.3314166789178437745e2, 1.9715909503065514427e3, 1.3731693765509461125e4,
     4.5921953931549871457e4, 6.7265770927008700853e4, 3.3430575583588128105e4, 2.5090809287301226727e3),
    (1.0, 4.2313330701600911252e1, 6.8718700749205790830e2, 5.3941960214247511077e3, 2.1213794301586595867e4,
     3.9307895800092710610e4, 2.8729085735721942674e4, 5.2264952788528545610e3),
)  # fmt: skip
FLANKS = (
    (1.42343711074968357734e0, 4.63033784615654529590e0, 5.76949722146069140550e0, 3.64784832476320460504e0,
     1.27045825245236838258e0, 2.41780725177450611770e-1, 2.27238449892691845833e-2, 7.74545014278341407640e-4),
    (1.0, 2.05319162663775882187e0, 1.67638483018380384940e0, 6.89767334985100004550e-1, 1.48103976427480074590e-1,
     1.51986665636164571966e-2, 5.47593808499534494600e-4, 1.05075007164441684324e-9),
)  # fmt: skip
TAILS = (
    (6.65790464350110377720e0, 5.46378491116411436990e0, 1.78482653991729133580e0, 2.96560571828504891230e-1,
     2.65321895265761230930e-2, 1.24266094738807843860e-3, 2.71155556874348757815e-5, 2.01033439929228813265e-7),
    (1.0, 5.99832206555887937690e-1, 1.36929880922735805310e-1, 1.48753612908506148525e-2,
     7.86869131145613259100e-4, 1.84631831751005468180e-5, 1.42151175831644588870e-7, 2.04426310338993978564e-15),
)  # fmt: skip


def standard_normal(rng: np.random.Generator, shape: int | tuple[int, ...]) -> Array:
    """Normal numbers of mean 0 and deviation 1, those of `rng.standard_normal(shape)`."""
    out, generator = np.empty(shape), rng.bit_generator
    flat, before = out.reshape(-1), generator.state
    words = generator.random_raw(flat.size + flat.size // 50 + ROOM)
    layer, size = (words & np.uint64(0xFF)).astype(np.int64), (words >> np.uint64(9)) & np.uint64(0xFFFFFFFFFFFFF)
    x = size.astype(float) * ziggurat.wi_double[layer]
    x = np.where((words >> np.uint64(8)) & np.uint64(1), -x, x)
    inside = size < ziggurat.ki_double[layer]
    edges = [*np.flatnonzero(~inside).tolist(), len(words)]
    at = done = 0
    for edge in edges:
        if edge < at:
            continue
        count = min(edge - at, flat.size - done)
        flat[done : done + count] = x[at : at + count]
        at, done = at + count, done + count
        if done == flat.size:
            break
        if len(words) - edge < ROOM:  # more rejections than are to be expected
            generator.state = before
            generator.random_raw(at, output=False)
            flat[done:] = standard_normal(rng, flat.size - done)
            return out
        value, at = at_edge(words, edge, int(layer[edge]), float(x[edge]))
        if not math.isnan(value):
            flat[done], done = value, done + 1
    generator.state = before
    generator.random_raw(at, output=False)
    return out


def at_edge(words: NDArray[np.uint64], at: int, layer: int, x: float) -> tuple[float, int]:
    """A draw that is not inside its layer, nan where it is rejected; and the next word.

    Args:
        words: Random words of 64 bits.
        at: The one of this draw.
        layer: Of the ziggurat; 0 is the tail.
        x: The number drawn.
    """

    def uniform(place: int) -> float:
        return int(words[place] >> np.uint64(11)) * UNIT

    if layer:
        low, high = float(ziggurat.fi_double[layer]), float(ziggurat.fi_double[layer - 1])
        return (x if (high - low) * uniform(at + 1) + low < exp(-0.5 * x * x) else math.nan), at + 2
    negative = int(words[at] >> np.uint64(17)) & 1
    while True:
        far = -ziggurat.ziggurat_nor_inv_r * log(1.0 - uniform(at + 1))  # 1 - u is exact
        above = -log(1.0 - uniform(at + 2))
        at += 2
        if above + above > far * far:
            far += ziggurat.ziggurat_nor_r
            return (-far if negative else far), at + 1


def quantile(p: float) -> float:
    """The number below which a normal one lies with probability p (Wichura 1988, AS 241, PPND16)."""
    q = p - 0.5
    if abs(q) <= 0.425:
        r = 0.180625 - q * q
        return float(q * horner(r, MIDDLE[0], 7) / horner(r, MIDDLE[1], 7))
    tail = min(p, 1.0 - p)
    if not tail > 0.0:
        return math.nan if tail < 0.0 or p != p else math.copysign(math.inf, q)
    r = math.sqrt(-log(tail))
    r, (above, below) = (r - 1.6, FLANKS) if r <= 5.0 else (r - 5.0, TAILS)
    return math.copysign(horner(r, above, 7) / horner(r, below, 7), q)


def probability(x: float) -> float:
    """How likely a normal number lies below x: a series in the middle, a continued fraction in the tails."""
    size = abs(x)
    if size < 3.0:
        term = total = x
        for n in range(3, 140, 2):
            term *= x * x / n
            total += term
        return 0.5 + total * density(size)
    if size > 40.0:
        tail = 0.0
    else:
        below = size
        for n in range(120, 0, -1):
            below = size + n / below
        tail = density(size) / below
    return tail if x < 0.0 else 1.0 - tail


def density(x: float) -> float:
    """Density of the normal distribution."""
    return float(exp(-0.5 * x * x) * 0.3989422804014327)
