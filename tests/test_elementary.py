"""Elementary functions: against mpmath to the last place, special values as in C99, the same bits without numba."""

from __future__ import annotations

import ctypes
import ctypes.util
import hashlib
import itertools
import math
import os
import struct
import subprocess
import sys
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin import elementary

RNG = np.random.default_rng(16)
N = 300 if os.environ.get("NUMBA_DISABLE_JIT") == "1" else 3000
TINY, HUGE = 5e-324, 1.7976931348623157e308
# Near multiples of pi/2, where most of an angle cancels (the first is the hardest double of all), and the largest ones.
HARD_ANGLES = [
    6381956970095103.0 * 2.0**797,
    5.319372648326541e255,
    1e22,
    HUGE,
    2.0**1000,
    1647099.0,
    1647100.0,
    *(k * math.pi / 2 for k in range(1, 400)),
    *(float(k) for k in (355, 710, 103993, 208341, 312689, 833719, 411557987)),
]
ANGLES = np.concatenate(
    [*(RNG.uniform(-size, size, N) for size in (1, 1e3, 1e7)), 10 ** RNG.uniform(5, 308, N), HARD_ANGLES]
)
SMALL = 10 ** RNG.uniform(-320, 0, N)
POINTS: dict[str, Any] = {
    "exp": np.concatenate((RNG.uniform(-745, 709.7, N), RNG.uniform(-745.1, -708, N), RNG.uniform(-1, 1, N), SMALL)),
    "expm1": np.concatenate((RNG.uniform(-40, 709.7, N), RNG.uniform(-1, 1, N), SMALL, -SMALL)),
    "log": np.concatenate((10 ** RNG.uniform(-323, 308, N), RNG.uniform(0.5, 2, N), 1 + RNG.uniform(-1e-6, 1e-6, N))),
    "sin": np.concatenate((ANGLES, SMALL)),
    "cos": ANGLES,
    "tan": np.concatenate((ANGLES, SMALL)),
    "tanh": np.concatenate((RNG.uniform(-25, 25, N), RNG.uniform(-1, 1, N), SMALL)),
    "atan": np.concatenate((RNG.uniform(-3, 3, N), 10 ** RNG.uniform(-300, 300, N))),
}
POINTS_OF_TWO: dict[str, Any] = {
    "atan2": RNG.standard_normal((2 * N, 2))
    * 10 ** (RNG.uniform(-150, 150, (2 * N, 2)) * RNG.integers(0, 2, (2 * N, 1))),
    "hypot": np.concatenate(
        (RNG.standard_normal((N, 2)), 10 ** RNG.uniform(-320, 307, (N, 2)), 10 ** RNG.uniform(-3, 3, (N, 2)))
    ),
    "pow": np.concatenate(
        (
            np.stack((10 ** RNG.uniform(-3, 3, N), RNG.uniform(-100, 100, N)), 1),
            np.stack((RNG.uniform(0.5, 2, N), RNG.uniform(-1000, 1000, N)), 1),
            np.stack((1 + RNG.uniform(-1e-3, 1e-3, N), RNG.uniform(-7e5, 7e5, N)), 1),
            np.stack((10 ** RNG.uniform(-320, -300, N), RNG.uniform(-1, 1, N)), 1),
        )
    ),
}
ALLOWED = dict.fromkeys([*POINTS, *POINTS_OF_TWO], 1.0) | {"tanh": 2.0, "atan2": 2.0, "pow": 2.0}


def places(found: float, exact: Any) -> float:
    """Error in units in the last place of the exact value."""
    nearest = float(exact)
    if math.isinf(nearest):
        return 0.0 if found == nearest else math.inf
    if math.isnan(found):
        return math.inf
    return float(abs(mpmath.mpf(found) - exact) / mpmath.mpf(math.ulp(nearest)))


@pytest.mark.parametrize("name", [*POINTS, *POINTS_OF_TWO])
def test_functions_are_exact_to_the_last_places(name: str) -> None:
    function, exact = getattr(elementary, name), {"pow": mpmath.power}.get(name) or getattr(mpmath, name)
    points = [(x,) for x in POINTS[name]] if name in POINTS else POINTS_OF_TWO[name]
    with mpmath.workprec(1300 if name in ("sin", "cos", "tan") else 180):
        numbers = [tuple(map(float, point)) for point in points]
        worst = max((places(function(*one), exact(*map(mpmath.mpf, one))), one) for one in numbers)
    assert worst[0] <= ALLOWED[name], worst


POSITIVE = (0.0, 1.0, 0.5, 2.0, 2.5, 3.0, TINY, 2.3e-308, HUGE, math.inf)
SPECIAL = (*POSITIVE, *(-x for x in POSITIVE), math.nan)
LIBM = ctypes.CDLL(ctypes.util.find_library("m") or None)


def same(one: float, other: float) -> bool:
    """Equal, with the sign of a zero; any nan is a nan."""
    return (math.isnan(one) and math.isnan(other)) or struct.pack("<d", one) == struct.pack("<d", other)


@pytest.mark.parametrize("name", POINTS)
def test_special_values_are_those_of_c99(name: str) -> None:
    theirs = {"atan": np.arctan}.get(name) or getattr(np, name)
    with np.errstate(all="ignore"):
        for x in (0.0, -0.0, math.inf, -math.inf, math.nan):
            assert same(getattr(elementary, name)(x), float(theirs(x))), x


@pytest.mark.parametrize("name", POINTS_OF_TWO)
def test_special_values_of_two_numbers_are_those_of_c99(name: str) -> None:
    theirs = LIBM[name]
    theirs.argtypes, theirs.restype = (ctypes.c_double, ctypes.c_double), ctypes.c_double
    for x, y in itertools.product(SPECIAL, SPECIAL):
        found, expected = getattr(elementary, name)(x, y), theirs(x, y)
        if math.isfinite(expected) and expected != 0.0:
            assert found == pytest.approx(expected, rel=1e-15, abs=TINY), (x, y)
        else:
            assert same(found, expected), (x, y)


def test_overflow_and_underflow_are_where_they_must_be() -> None:
    assert elementary.exp(709.782712893384) < math.inf and elementary.exp(709.7827128933841) == math.inf
    assert elementary.exp(-745.1332191019411) == TINY and elementary.exp(-745.1332191019412) == 0.0
    assert elementary.pow(2.0, 1023.0) == 2.0**1023 and elementary.pow(2.0, 1024.0) == math.inf
    assert elementary.pow(2.0, -1074.0) == TINY and elementary.pow(2.0, -1076.0) == 0.0
    assert elementary.hypot(3e307, 4e307) == pytest.approx(5e307, rel=1e-15)
    assert elementary.hypot(3 * TINY, 4 * TINY) == 5 * TINY


@given(st.floats(-1e300, 1e300))
@settings(max_examples=200, deadline=None)
def test_odd_functions_are_odd_and_even_ones_even(x: float) -> None:
    for name in ("sin", "tan", "tanh", "atan"):
        function = getattr(elementary, name)
        assert same(function(-x), -function(x))
    assert same(elementary.cos(-x), elementary.cos(x))
    assert same(elementary.hypot(x, 1.0), elementary.hypot(1.0, -x))


DIGEST = """
import hashlib, struct, sys
import numpy as np
from mmnn_pin import elementary
rng, digest = np.random.default_rng(3), hashlib.sha256()
for name in ("exp", "expm1", "log", "sin", "cos", "tan", "tanh", "atan"):
    for x in np.concatenate((rng.uniform(-30, 30, 200), 10 ** rng.uniform(-300, 300, 200))):
        digest.update(struct.pack("<d", getattr(elementary, name)(abs(float(x)) if name == "log" else float(x))))
for name in ("atan2", "hypot", "pow"):
    for x, y in rng.uniform(0, 30, (200, 2)):
        digest.update(struct.pack("<d", getattr(elementary, name)(float(x), float(y))))
print(digest.hexdigest())
"""


@pytest.mark.compiled
@pytest.mark.parametrize(
    "setting",
    [
        {"NUMBA_DISABLE_JIT": "1"},
        {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": "", "NUMBA_DISABLE_INTEL_SVML": "1"},
        pytest.param({"NUMBA_OPT": "0"}, marks=pytest.mark.long),
    ],
    ids=["plain Python", "plain x86-64", "not optimised"],
)
def test_the_bits_are_the_same_without_numba_and_on_the_plainest_processor(
    setting: dict[str, str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    if "NUMBA_CPU_NAME" in setting and not sys.platform.startswith("linux"):
        pytest.skip("the name of a plain processor is that of x86-64 Linux")

    def digest(**environment: str) -> str:
        command = [sys.executable, "-c", DIGEST]
        done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    found = digest(NUMBA_CACHE_DIR=str(tmp_path_factory.mktemp("cache")), **setting)
    assert len(found) == len(hashlib.sha256().hexdigest())
    assert found == digest()


@given(st.lists(st.floats(-720.0, 720.0) | st.floats(), max_size=40))
def test_sigmoids_have_the_bits_of_exp(numbers):
    x = np.array(numbers)
    y = np.zeros_like(x)
    elementary.sigmoids(x, y)
    assert np.array_equal(y, [1.0 / (1.0 + elementary.exp(-one)) for one in numbers], equal_nan=True)


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))
def test_the_nearest_turn_is_within_half_a_turn_and_differs_by_whole_ones(angle: float, near: float) -> None:
    found = elementary.nearest_turn(angle, near)
    assert abs(found - near) <= np.pi + 1e-9
    turns = (angle - found) / (2 * np.pi)
    assert abs(turns - round(turns)) < 1e-9
    assert found == angle or abs(angle - near) > np.pi - 1e-9
