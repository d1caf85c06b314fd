"""The law that steers: what it claims of a wheel's angle to its path, and its derivative, by differences of motions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmnn_pin.model.base.rolling import Maps, Pivot, Rolling, new_maps, roll
from mmnn_pin.model.base.steered import Articulated, CarLike, SteeredBase, Swerve
from mmnn_pin.model.base.steering_law import Asked, SteeringNumbers, along_n, asked_of, turned_wheel
from mmnn_pin.model.base.trailers import towed
from mmnn_pin.signals import Array

K, EPS = 5.0, 0.03
CAR = CarLike(pivots=(Pivot("s", "master", 0.65, 0.2, sign=-1.0),), length=0.65)
LOADER = Articulated(pivots=(Pivot("s", "master", -0.45, 0.0, wheel=(-0.45, 0.0, 0.0)),), length=0.9)
SWERVE = Swerve(
    pivots=tuple(Pivot(f"{x}{y}", "master", x, y) for x in (0.3, -0.3) for y in (0.2, -0.2)),
    length=math.hypot(0.3, 0.2),
)
numbers = st.floats(-1.0, 1.0)
motions = st.lists(numbers, min_size=9, max_size=9).map(lambda values: np.array(values).reshape(3, 3))


def at(base: SteeredBase, headings: Array, nu: Array) -> tuple[Rolling, Array, Maps]:
    """The base with its wheels at headings, rolled."""
    rolling = base.rolling_at({pivot.joint: 4 + k for k, pivot in enumerate(base.pivots)})
    signs = np.array([pivot.sign for pivot in base.pivots])
    position = np.array([0.0, 0.0, 1.0, 0.0, *(signs * headings)])
    maps = new_maps(rolling, np.zeros((4 + len(headings), 1 + len(headings))))
    for _ in range(8):
        roll(rolling, position, nu, maps)
    return rolling, position, maps


def asked_at(asked: Array, time: float) -> Array:
    """(3, 3) what is asked a moment later, its second derivative constant."""
    c, d, dd = asked
    return np.array([c + d * time + dd * time**2 / 2, d + dd * time, dd])


def law(base: SteeredBase, law_of: SteeringNumbers, headings: Array, nu: Array, asked: Array) -> tuple[Array, Array]:
    """nu_c and its derivative, by the parts of the compiled law."""
    rolling, position, maps = at(base, headings, nu)
    alpha, alphadot = np.zeros(len(nu)), np.zeros(len(nu))
    along_n(rolling, maps, asked, alpha, alphadot)
    for k in range(len(headings)):
        wheel = asked_of(rolling, k, position, nu[1 + k], asked)
        alpha[1 + k], alphadot[1 + k] = turned_wheel(rolling, k, position, nu[1 + k], law_of, Asked(*wheel), False)
    return alpha, alphadot


def angles(base: SteeredBase, headings: Array, eta: Array) -> Array:
    """From every wheel to its path, by its velocity as a point of the plane."""
    places = np.array([(p.x, p.y) for p in base.pivots])
    ahead, left = eta[0] - places[:, 1] * eta[2], eta[1] + places[:, 0] * eta[2]
    return (np.arctan2(left, ahead) - headings + np.pi / 2) % np.pi - np.pi / 2


@pytest.mark.parametrize("base", [CAR, SWERVE], ids=["car", "swerve"])
@given(motion=motions, turned=st.lists(st.floats(-0.6, 0.6), min_size=4, max_size=4))
def test_a_wheel_turns_to_its_path_at_its_rate(base: SteeredBase, motion: Array, turned: list[float]) -> None:
    """dchi/dt = -K chi where eps = 0, whatever is asked."""
    motion[0, 0] = 1.5 + motion[0, 0]
    if base is CAR:
        motion[:, 1] = 0.0
    headings = np.array(turned[: len(base.pivots)])
    signs = np.array([p.sign for p in base.pivots])
    exact = SteeringNumbers(K, 0.0, False, False)
    zeta = signs * law(base, exact, headings, np.zeros(1 + len(headings)), motion)[0][1:]
    h = 1e-5
    later, before = (angles(base, headings + t * zeta, asked_at(motion, t)[0]) for t in (h, -h))
    chi, step = angles(base, headings, motion[0]), (later - before + np.pi / 2) % np.pi - np.pi / 2
    assert step / (2 * h) == pytest.approx(-K * chi, abs=1e-5 * (1 + np.abs(zeta).max()))


@pytest.mark.parametrize("base", [CAR, SWERVE, LOADER], ids=["car", "swerve", "loader"])
@given(motion=motions, turned=st.lists(st.floats(-0.6, 0.6), min_size=4, max_size=4), rate=st.floats(-1.0, 1.0))
def test_its_derivative_is_that_of_differences(
    base: SteeredBase, motion: Array, turned: list[float], rate: float
) -> None:
    """Wheels turn at their measured rates, and what is asked goes on."""
    motion[0, 0] = 1.5 + motion[0, 0]
    if base is not SWERVE:
        motion[:, 1] = 0.0
    count = len(base.pivots)
    headings = turned[0] + 0.15 * np.array([0.0, *turned[1:count]])  # where n's own rate is exact enough
    nu = np.concatenate(([0.5], np.linspace(rate, -rate / 2, count)))
    signs, of = np.array([p.sign for p in base.pivots]), SteeringNumbers(K, EPS, False, base is LOADER)
    h = 1e-5
    later, before = (law(base, of, headings + t * signs * nu[1:], nu, asked_at(motion, t))[0] for t in (h, -h))
    slope = (later - before) / (2 * h)
    flips = np.abs(later - before) > 1e-2  # n has either sign
    alphadot = law(base, of, headings, nu, motion)[1]
    assert alphadot[~flips] == pytest.approx(slope[~flips], rel=1e-4, abs=1e-4)
    assert not flips[1:].any()


@given(motion=motions, turned=st.floats(-0.6, 0.6))
def test_a_loaders_body_moves_exactly_as_asked(motion: Array, turned: float) -> None:
    """And its waist turns as a hitch without a motor would."""
    motion[:, 1] = 0.0
    headings = np.array([turned])
    nu = law(LOADER, SteeringNumbers(K, EPS, False, True), headings, np.zeros(2), motion)[0]
    assert at(LOADER, headings, nu)[2].V[0] @ nu == pytest.approx(motion[0], abs=1e-12)
    towed(np.array([0.45, 0.45]), turned, motion[0, ::2].copy(), rear := np.empty(2))
    assert nu[1] == pytest.approx(rear[1] - motion[0, 2], abs=1e-9)
