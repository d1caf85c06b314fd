"""How exact are the elementary functions? Against extended precision at ten million points, the worst against mpmath.

    python benchmarks/accuracy.py                    10^7 points of every function, a few minutes
    python benchmarks/accuracy.py --points 100000 --only sin

The platform's `long double` functions (64 bits of mantissa, x86) find the points with the largest errors; these are
evaluated by mpmath, and so are points near multiples of pi/2 and at the ends of what a double holds. Errors are in
units in the last place of the exact value. Exit status 1 when one is above the bound that `mmnn_pin.elementary` states.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from typing import Any

import mpmath
import numba
import numpy as np
from numpy.typing import NDArray

from mmnn_pin import elementary

Array = NDArray[np.float64]
BOUNDS = dict.fromkeys(("exp", "expm1", "log", "sin", "cos", "tan", "atan", "hypot"), 1.0)
BOUNDS |= {"tanh": 2.0, "atan2": 2.0, "pow": 2.0}
THEIRS: dict[str, Any] = {"atan": np.arctan, "atan2": np.arctan2, "pow": np.power}
SUSPECTS = 200  # points of each batch that mpmath looks at
BATCH = 1_000_000


def any_size(rng: np.random.Generator, count: int, low: float, high: float) -> Array:
    """Numbers of both signs, their decimal exponent even between two ends."""
    return np.asarray(10 ** rng.uniform(low, high, count) * rng.choice([-1.0, 1.0], count))


def near_quarters(rng: np.random.Generator, count: int) -> Array:
    """Doubles next to multiples of pi/2, up to 2^40 of them."""
    k = np.floor(2 ** rng.uniform(0, 40, count))
    return np.asarray(np.nextafter(k * (math.pi / 2), rng.choice([-np.inf, np.inf], count)))


def angles(rng: np.random.Generator, n: int) -> Array:
    """Small, usual, large and the largest ones, and those next to multiples of pi/2."""
    parts = (rng.uniform(-4, 4, n), rng.uniform(-1e3, 1e3, n), rng.uniform(-2e6, 2e6, n))
    return np.concatenate((*parts, any_size(rng, n, -300, 308), near_quarters(rng, n)))


def plane(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Points of usual and of any size."""
    usual, wide = rng.standard_normal((2, 3 * n)), [any_size(rng, n, -300, 300) for _ in range(2)]
    ratio = any_size(rng, n, -20, 20)
    return tuple(np.concatenate((usual[i], wide[i], ratio if i else np.ones(n))) for i in range(2))  # type: ignore


def powers(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Bases around 1 and of any size, with exponents that mostly stay within a double."""
    base = np.concatenate((10 ** rng.uniform(-3, 3, 2 * n), rng.uniform(0.5, 2, n), 1 + rng.uniform(-1e-3, 1e-3, n)))
    base = np.concatenate((base, 10 ** rng.uniform(-320, 308, n)))
    sizes = (100.0, 100.0, 1000.0, 7e5, 1.0)
    return base, np.concatenate([rng.uniform(-size, size, n) for size in sizes])


POINTS: dict[str, Callable[[np.random.Generator, int], Any]] = {
    "exp": lambda r, n: np.concatenate(
        (r.uniform(-708, 709.7, 2 * n), r.uniform(-1, 1, 2 * n), any_size(r, n, -30, 0))
    ),
    "expm1": lambda r, n: np.concatenate((r.uniform(-40, 709, n), r.uniform(-2, 2, 3 * n), any_size(r, n, -300, 1))),
    "log": lambda r, n: np.concatenate(
        (10 ** r.uniform(-323, 308, 2 * n), r.uniform(0.5, 2, 2 * n), 1 + any_size(r, n, -16, -1))
    ),
    "sin": angles,
    "cos": angles,
    "tan": angles,
    "tanh": lambda r, n: np.concatenate((r.uniform(-25, 25, 2 * n), r.uniform(-1, 1, 2 * n), any_size(r, n, -300, 1))),
    "atan": lambda r, n: np.concatenate((r.uniform(-3, 3, 4 * n), any_size(r, n, -300, 300))),
    "atan2": plane,
    "hypot": plane,
    "pow": powers,
}


def loop_over(name: str, two: bool) -> Callable[..., Array]:
    """Our function for arrays."""
    function = getattr(elementary, name)

    def of_one(x: Array) -> Array:
        out = np.empty(x.size)
        for i in range(x.size):
            out[i] = function(x[i])
        return out

    def of_two(x: Array, y: Array) -> Array:
        out = np.empty(x.size)
        for i in range(x.size):
            out[i] = function(x[i], y[i])
        return out

    return numba.njit(of_two if two else of_one, error_model="numpy")  # type: ignore[no-any-return]


def error(name: str, found: float, point: tuple[float, ...]) -> float:
    """Error in units in the last place, by mpmath."""
    with mpmath.workprec(1300 if name in ("sin", "cos", "tan") else 200):
        exact = (mpmath.power if name == "pow" else getattr(mpmath, name))(*map(mpmath.mpf, point))
        nearest = float(exact)
        if not math.isfinite(nearest):
            return 0.0 if found == nearest else math.inf
        return float(abs(mpmath.mpf(found) - exact) / mpmath.mpf(math.ulp(nearest)))


def worst_of(name: str, count: int, rng: np.random.Generator) -> tuple[int, float, tuple[float, ...]]:
    """How many points were compared, the largest error and where it is."""
    done, worst, ours = 0, (0.0, (0.0,)), None
    theirs = THEIRS.get(name) or getattr(np, name)
    while done < count:
        drawn = POINTS[name](rng, min(BATCH, count - done + 4) // 5)
        point = drawn if isinstance(drawn, tuple) else (drawn,)
        ours = ours or loop_over(name, len(point) > 1)
        found = ours(*point)
        with np.errstate(all="ignore"):
            exact = theirs(*(one.astype(np.longdouble) for one in point))
            off = np.abs(found - exact) / np.spacing(np.abs(exact.astype(float)))
        off = np.nan_to_num(off.astype(float), nan=-1.0, posinf=-1.0)  # an overflow: not judged here but in the tests
        for i in np.argpartition(off, -SUSPECTS)[-SUSPECTS:] if len(off) > SUSPECTS else range(len(off)):
            there = tuple(float(one[i]) for one in point)
            worst = max(worst, (error(name, float(found[i]), there), there))
        done += len(found)
    return done, *worst


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=10_000_000, help="per function")
    parser.add_argument("--only", action="append", choices=list(POINTS), default=[], help="repeatable")
    given = parser.parse_args()
    if np.finfo(np.longdouble).nmant < 63:
        raise SystemExit("this platform's long double is no wider than a double")
    failed = False
    print("function     points   largest error [ulp]   bound   at")
    for name in given.only or POINTS:
        done, worst, place = worst_of(name, given.points, np.random.default_rng(7))
        failed |= worst > BOUNDS[name]
        where = ", ".join(f"{x!r}" for x in place)
        print(f"{name:8} {done:10,}   {worst:19.4f}   {BOUNDS[name]:5g}   {where}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
