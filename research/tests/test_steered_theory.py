"""The algebra of docs/explanation/steered-bases.md by sympy, its inequalities on random numbers and random motions.

Motions are integrated from the formulas of the page alone, beside the package. The document names the tests that prove
its steps; a test here holds it to that.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
import sympy as sp
from places import ROOT
from scipy.integrate import solve_ivp

from mmnn_pin.model.base.rolling import Pivot, Rolling, new_maps, roll
from mmnn_pin.model.base.steered import Articulated, SteeredBase, Swerve
from mmnn_pin.signals import Array
from research.proof.steering import (
    CASES,
    SQUARE,
    Constants,
    SteeredMotion,
    backed,
    car,
    gyration,
    hitch_on_circle,
    rows_of,
    spread_of,
    way_to,
)

DOCUMENT = ROOT / "docs" / "explanation" / "steered-bases.md"
COUNT = 40  # motions at once
vx, vy, w, vxd, vyd, wd = sp.symbols("vx vy w vxd vyd wd", real=True)
h, hd, x, y, t, base, K = sp.symbols("h hd x y t l K", real=True)
a = sp.Matrix([[-sp.sin(h), sp.cos(h), x * sp.cos(h) + y * sp.sin(h) + t]])
along = -a.diff(h)


def zero(expression: sp.Expr) -> bool:
    return sp.simplify(sp.expand_trig(sp.expand(expression))) == 0


def rolling_of(base: SteeredBase) -> Rolling:
    return base.rolling_at({pivot.joint: 4 + k for k, pivot in enumerate(base.pivots)})


def maps_of(base: SteeredBase, angles: Array) -> Array:
    """(3, nb) of the body, by the package."""
    rolling, position = rolling_of(base), np.array([0.0, 0.0, 1.0, 0.0, *angles])
    maps = new_maps(rolling, np.zeros((4 + len(angles), 1 + len(base.masters))))
    for _ in range(20):
        roll(rolling, position, np.zeros(1 + len(base.masters)), maps)
    return maps.V[0]


# -- section 1: what can move ----------------------------------------------------------------------------------------


def growth(fields: list[sp.Matrix], q: list[sp.Symbol], at: dict[sp.Symbol, float]) -> list[int]:
    """Ranks of the motions and their brackets, one longer each time, at a place."""

    def value(many: list[sp.Matrix]) -> int:
        return int(np.linalg.matrix_rank(np.array([[float(v) for v in f.subs(at)] for f in many]), 1e-9))

    known, last = list(fields), list(fields)
    ranks = [value(known)]
    while ranks[-1] < len(q) and len(ranks) < 6:
        last = [g.jacobian(q) * f - f.jacobian(q) * g for f in fields for g in last]
        known += last
        ranks.append(value(known))
    return ranks


def planar(motion: sp.Matrix, phi: sp.Symbol, more: list[sp.Expr]) -> sp.Matrix:
    """A field on (x, y, phi, ...) of a motion (vx, vy, w) of the body."""
    c, s = sp.cos(phi), sp.sin(phi)
    return sp.Matrix([c * motion[0] - s * motion[1], s * motion[0] + c * motion[1], motion[2], *more])


def test_how_many_brackets_reach_every_pose() -> None:
    px, py, phi, h1, h2, gamma = sp.symbols("px py phi h1 h2 gamma", real=True)
    place = {px: 0.1, py: 0.2, phi: 0.3, h1: 0.4, h2: -0.2, gamma: 0.5}
    car = planar(sp.Matrix([sp.cos(h1), 0, 2 * sp.sin(h1)]), phi, [0])
    assert growth([car, sp.Matrix([0, 0, 0, 1])], [px, py, phi, h1], place) == [2, 3, 4]
    rows = [sp.Matrix([-sp.sin(h), sp.cos(h), X * sp.cos(h)]) for h, X in ((h1, 0.3), (h2, -0.3))]
    swerve = planar(rows[0].cross(rows[1]), phi, [0, 0])
    turns = [sp.Matrix([0, 0, 0, 1, 0]), sp.Matrix([0, 0, 0, 0, 1])]
    assert growth([swerve, *turns], [px, py, phi, h1, h2], place) == [3, 5]
    drive = [planar(sp.Matrix(m), phi, []) for m in ([1, 0, 0], [0, 0, 1])]
    assert growth(drive, [px, py, phi], place) == [2, 3]
    for hitch, expected in ((sp.Rational(1, 5), [2, 3, 4, 5]), (0, [2, 3, 4, 5])):
        v, yaw = sp.cos(h1), 2 * sp.sin(h1)
        rate = -(v * sp.sin(gamma) + hitch * yaw * sp.cos(gamma)) - yaw
        truck = planar(sp.Matrix([v, 0, yaw]), phi, [0, rate])
        assert growth([truck, sp.Matrix([0, 0, 0, 1, 0])], [px, py, phi, h1, gamma], place) == expected


@pytest.mark.parametrize("seed", range(3))
def test_n_and_x_are_those_of_the_page(seed: int) -> None:
    """A fixed axle: n, X from the row alone. All wheels steered: n is the least eigenvector, whatever its wheels do."""
    rng = np.random.default_rng(seed)
    X, Y, trail, turned, L = 0.7, rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.6), rng.uniform(-1.2, 1.2), 0.7
    base = Articulated(pivots=(Pivot("s", "master", X, Y, wheel=(trail, 0.0, 0.0)),), length=L)
    row = np.array([-np.sin(turned), X * np.cos(turned) + Y * np.sin(turned) + trail])  # on (v, w)
    W = np.diag([1.0, L**2])
    n = np.array([row[1], -row[0]]) / np.sqrt(np.array([row[1], -row[0]]) @ W @ np.array([row[1], -row[0]]))
    least = -trail * np.linalg.solve(W, row) / (row @ np.linalg.solve(W, row))
    V = maps_of(base, np.array([turned]))[[0, 2]]
    assert abs(V[:, 0] @ W @ n) == pytest.approx(1.0, abs=1e-12)
    assert V[:, 1] == pytest.approx(least, abs=1e-12)
    assert V[:, 0] @ W @ V[:, 1] == pytest.approx(0.0, abs=1e-12)
    size = np.sqrt(row @ np.linalg.solve(W, row))
    assert np.sqrt(V[:, 1] @ W @ V[:, 1]) == pytest.approx(abs(trail) / size, abs=1e-12)

    swerve = Swerve(pivots=tuple(Pivot(str(k), "master", *p) for k, p in enumerate(SQUARE)), length=gyration(SQUARE))
    angles = rng.uniform(-0.3, 0.3, 4)
    rows = rows_of(np.array(SQUARE), angles[None], swerve.length)[0]
    vectors = np.linalg.eigh(rows.T @ rows)[1]
    found = maps_of(swerve, angles)[:, 0] * [1.0, 1.0, swerve.length]
    assert abs(found @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-9)


# -- section 2: reduced dynamics -------------------------------------------------------------------------------------


def test_the_reduced_rate_stays_skew() -> None:
    """`M = T' M T`, `C = T' (M Tdot + C T)`; the power of nu is that of all velocities."""
    rng = np.random.default_rng(0)
    T, Td, A = rng.normal(size=(7, 3)), rng.normal(size=(7, 3)), rng.normal(size=(7, 7))
    M, skew, Md = A @ A.T, rng.normal(size=(7, 7)), rng.normal(size=(7, 7))
    Md = Md + Md.T
    C = (Md + skew - skew.T) / 2
    reduced, rate, coriolis = T.T @ M @ T, Td.T @ M @ T + T.T @ Md @ T + T.T @ M @ Td, T.T @ (M @ Td + C @ T)
    left = rate - 2 * coriolis
    assert left == pytest.approx(-left.T, abs=1e-12)
    assert np.abs(rate - 2 * T.T @ C @ T + (rate - 2 * T.T @ C @ T).T).max() > 0.1  # without M Tdot it is not
    nu, acceleration = rng.normal(size=3), rng.normal(size=3)
    full = M @ (T @ acceleration + Td @ nu) + C @ (T @ nu)
    assert nu @ (reduced @ acceleration + coriolis @ nu) == pytest.approx((T @ nu) @ full)


# -- section 3: the law that steers ----------------------------------------------------------------------------------


def test_how_the_angle_to_the_path_turns() -> None:
    """Chidot = Omega - hdot (1 - t w s / (s^2 + f^2)), and the law makes it -K chi for t = 0."""
    eta, etad = sp.Matrix([vx, vy, w]), sp.Matrix([vxd, vyd, wd])
    s, f = (a * eta)[0], (along * eta)[0]
    rates = {vx: vxd, vy: vyd, w: wd, h: hd}
    sdot, fdot = (sum(e.diff(v) * d for v, d in rates.items()) for e in (s, f))
    q, p = (a * etad)[0], (along * etad)[0]
    assert zero(f * sdot - s * fdot - (q * f - p * s - hd * (s**2 + f**2 - t * w * s)))
    chi = sp.Symbol("chi", real=True)
    law = (K * chi * (s**2 + f**2) + q * f - p * s) / (s**2 + f**2)
    left = ((f * sdot - s * fdot) / (s**2 + f**2)).subs(hd, law).subs(t, 0)
    assert zero(sp.numer(sp.together(left + K * chi)))


def test_what_falls_as_a_wheel_turns_to_its_path() -> None:
    """A swerve drive whose modules stood exactly across their paths: |chi| = e^{-Kt} pi / 2, and its integral."""
    motion, _ = CASES["swerve"](2, COUNT)
    e, headings = motion.begun(2, COUNT, 0.1, 0.0)
    times, _, chis = motion.run(e, headings + np.pi / 2, 4.0)
    assert np.abs(chis) == pytest.approx(np.pi / 2 * np.exp(-motion.rate * times)[:, None, None] + 0 * chis, abs=2e-5)
    swept = np.trapezoid(np.abs(np.sin(chis)), times, axis=0)
    assert (swept <= np.pi / 2 / motion.rate).all()
    assert swept == pytest.approx(float(sp.Si(sp.pi / 2)) / motion.rate, rel=1e-3)


def test_what_wheels_off_their_paths_take_from_the_command() -> None:
    """A fixed axle: |eta_c - u n|_W = |P| |sin chi| / |a|; swerve: at most S / sqrt(mu_2), whose wheels slide by S."""
    rng = np.random.default_rng(1)
    pivots, length = np.array(SQUARE), gyration(SQUARE)
    headings, asked = rng.uniform(-np.pi, np.pi, (500, 4)), rng.normal(size=(500, 3))
    rows = rows_of(pivots, headings, length)
    mu, vectors = np.linalg.eigh(np.swapaxes(rows, 1, 2) @ rows)
    n = vectors[:, :, 0]
    u = np.sum(n * asked, axis=1)
    off = np.linalg.norm(asked - u[:, None] * n, axis=1)
    S = np.linalg.norm((rows @ asked[:, :, None])[:, :, 0], axis=1)
    assert (off <= S / np.sqrt(mu[:, 1]) + 1e-12).all()
    assert np.max(off * np.sqrt(mu[:, 1]) / S) > 0.95
    slides = np.linalg.norm((rows @ (u[:, None] * n)[:, :, None])[:, :, 0], axis=1)
    assert (slides <= S + 1e-12).all()
    eta = asked / [1.0, 1.0, length]
    P = np.stack((eta[:, :1] - pivots[:, 1] * eta[:, 2:], eta[:, 1:2] + pivots[:, 0] * eta[:, 2:]), axis=2)
    assert np.sum(P**2, axis=(1, 2)) == pytest.approx(4 * np.sum(asked**2, axis=1))  # l is the wheels' gyration

    for X, Y, length in ((0.65, 0.0, 0.65), (0.65, 0.22, 0.65)):
        spread = spread_of(X, Y, length)
        turned, command = rng.uniform(-1.5, 1.5, 500), rng.normal(size=(500, 2))  # (v, l w)
        row = np.stack((-np.sin(turned), (X * np.cos(turned) + Y * np.sin(turned)) / length), axis=1)
        n = np.stack((row[:, 1], -row[:, 0]), axis=1) / np.linalg.norm(row, axis=1)[:, None]
        off = np.linalg.norm(command - np.sum(n * command, axis=1)[:, None] * n, axis=1)
        v, yaw = command[:, 0], command[:, 1] / length
        P = np.stack((v - Y * yaw, X * yaw), axis=1)
        s = P[:, 1] * np.cos(turned) - P[:, 0] * np.sin(turned)
        assert off == pytest.approx(np.abs(s) / np.linalg.norm(row, axis=1))
        sine = np.abs(s) / np.linalg.norm(P, axis=1)
        assert (off <= spread * np.linalg.norm(command, axis=1) * sine + 1e-12).all()


# -- section 4: the cascade ------------------------------------------------------------------------------------------


def functional(constants: Constants, a: Array, worst: Array, rate: float) -> Array:
    """U of the cascade."""
    _, B0, B1, _ = constants
    return np.log(B0 + B1 * a) / (constants.m * B1) + worst / rate


@pytest.mark.parametrize("case", CASES)
def test_the_cascade_is_as_the_theorem_says(case: str) -> None:
    """Chi decays exactly, from right angles, too; U never grows; the size stays below its bound; all errors vanish."""
    motion, constants = CASES[case](3, COUNT)
    times, errors, chis = motion.run(*motion.begun(3, COUNT, 0.1, np.pi / 2), 6.0)
    assert chis == pytest.approx(chis[0] * np.exp(-motion.rate * times)[:, None, None], abs=2e-5)
    a, worst = constants.size(errors), np.max(np.abs(chis), axis=2)
    assert np.diff(functional(constants, a, worst, motion.rate), axis=0).max() < 1e-9
    assert (a <= constants.reached(a[0], worst[0], motion.rate) + 1e-9).all()
    assert a[-1].max() < 0.02 * a[0].max()
    assert constants.reached(0.1, 0.5, constants.rate_for(0.1, 0.5, 0.3)) == pytest.approx(0.3)


def test_a_command_that_takes_more_than_is_said_would_be_seen() -> None:
    """With a fifth of m U grows."""
    motion, constants = CASES["car"](3, COUNT)
    _, errors, chis = motion.run(*motion.begun(3, COUNT, 0.02, 1.4), 1.0)
    less = constants._replace(m=constants.m / 5)
    U = functional(less, constants.size(errors), np.max(np.abs(chis), axis=2), motion.rate)
    assert np.diff(U, axis=0).max() > 0


def test_the_pose_decays_under_the_holonomic_law() -> None:
    """Adot <= -k (1 - a^2 / 4) a + |d| with V = (ex^2 + ey^2) / 2 + 1 - cos ephi, for a < 2."""
    rng = np.random.default_rng(5)
    e, d, k = rng.uniform(-1.2, 1.2, (2000, 3)), rng.normal(size=(2000, 3)), np.array([1.0, 2.0, 1.5])
    pull = np.stack((e[:, 0], e[:, 1], np.sin(e[:, 2])), axis=1)
    size = np.sqrt(e[:, 0] ** 2 + e[:, 1] ** 2 + 2 * (1 - np.cos(e[:, 2])))
    rate = np.sum(pull * (d - k * pull), axis=1) / size
    inside = size < 2
    bound = -k.min() * (1 - size**2 / 4) * size + np.linalg.norm(d, axis=1)
    assert inside.sum() > 1000
    assert (rate <= bound + 1e-12)[inside].all()


def test_reverse_is_the_mirror_image() -> None:
    """(ex, ey, ephi, vr, wr, v, w) -> (-ex, ey, -ephi, -vr, -wr, -v, -w) keeps error kinematics and law."""
    ex, ey, ephi, vr, wr, v, kx, ky, kth = sp.symbols("ex ey ephi vr wr v kx ky kth", real=True)
    signs = {ex: -ex, ephi: -ephi, vr: -vr, wr: -wr, v: -v, w: -w}
    c, s = sp.cos(ephi), sp.sin(ephi)
    rates = sp.Matrix([w * ey - v + vr * c, -w * ex + vr * s, wr - w])
    law = sp.Matrix([vr * c + kx * ex, wr + vr * ky * ey + sp.Abs(vr) * kth * s])
    assert all(zero(m) for m in rates.subs(signs, simultaneous=True) - sp.diag(-1, 1, -1) * rates)
    assert all(zero(m) for m in law.subs(signs, simultaneous=True) + law)


@pytest.mark.parametrize("case", ["car", "swerve"])
def test_where_wheels_may_not_turn_as_fast_as_asked(case: str) -> None:
    """Rates of at most r: as K' = min(K, (r - |Omega|) / |chi(0)|), Omega the path's turning in the wheel's carrier."""
    motion, _ = CASES[case](4, COUNT)
    motion.limit = 4.0
    times, _, chis = motion.run(*motion.begun(4, COUNT, 0.05, 1.2), 2.0)
    assert np.max(np.abs(motion.turned)) == pytest.approx(motion.limit)
    omega = np.abs(np.diff(chis, axis=0) / np.diff(times)[:, None, None] + motion.turned).max(axis=(0, 2))
    slower = np.minimum(motion.rate, (motion.limit - omega)[:, None] / np.abs(chis[0]))
    assert np.median(slower) > 1
    bound = np.abs(chis[0]) * np.exp(-slower * times[:, None, None])
    assert (np.abs(chis) <= bound * 1.02 + 1e-6)[:, slower > 0].all()
    assert (np.abs(chis) > np.abs(chis[0]) * np.exp(-motion.rate * times)[:, None, None] + 0.01).any()


def test_stops_do_not_slow_a_wheel() -> None:
    """Rates within 2 K times the way to a stop: |chi| falls as fast as K where paths approach stops no faster."""
    rng = np.random.default_rng(15)
    high, low, rate = 1.2, -0.7, 6.0
    path, now = rng.uniform(low, high, (2, 5000))
    omega = rng.uniform(2 * rate * (low - path), 2 * rate * (high - path))
    chi = path - now
    free = rate * chi + omega
    turning = np.clip(free, 2 * rate * (low - now), 2 * rate * (high - now))
    assert (np.sign(chi) * (omega - turning) <= -rate * np.abs(chi) + 1e-9).all()
    assert (turning != free).mean() > 0.05


@pytest.mark.parametrize("case", ["car", "swerve"])
def test_a_base_that_waits_for_its_wheels(case: str) -> None:
    """`align` takes at most as much again of the command: the theorem with 2 m."""
    motion, constants = CASES[case](4, COUNT)
    motion.wait = True
    _, errors, chis = motion.run(*motion.begun(4, COUNT, 0.1, 1.4), 2.0)
    a, worst = constants.size(errors), np.max(np.abs(chis), axis=2)
    assert np.diff(functional(constants._replace(m=2 * constants.m), a, worst, motion.rate), axis=0).max() < 1e-9


# -- section 5: slow wheels, velocity errors -------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["car", "swerve"])
def test_what_eps_leaves_of_the_angle(case: str) -> None:
    """Chidot = -kappa K chi + (1 - kappa) Omega: at last |chi| <= eps^2 |Omega| / (K p^2)."""
    motion, _ = CASES[case](6, COUNT)
    motion.slow = 0.2
    e, headings = motion.begun(6, COUNT, 0.05, 0.3)
    times, errors, chis = motion.run(e, headings, 8.0)
    late = times[1:] > 5
    omega = np.abs(np.diff(chis, axis=0) / np.diff(times)[:, None, None] + motion.turned)[late].max(axis=0)
    slowest = np.array([motion.speeds(time, e) for time, e in zip(times[1:][late], errors[1:][late], strict=True)]).min(
        axis=0
    )
    bound = motion.slow**2 * omega / (motion.rate * slowest**2)
    left = np.abs(chis[-1])
    assert (left <= bound + 1e-6).all()
    assert np.max(left / bound) > 0.1
    assert np.abs(motion.turned).max() > 0.1


def test_no_wheel_is_asked_to_turn_faster_than_its_bound() -> None:
    """|zeta| <= kappa K |chi| + |Pdot| / (2 eps), whatever is asked."""
    rng = np.random.default_rng(7)
    s, f, q, p = rng.normal(size=(4, 5000)) * 10.0 ** rng.uniform(-4, 1, (4, 5000))
    rate, slow = 6.0, 0.03
    chi = way_to(s, f)
    zeta = (rate * chi * (s**2 + f**2) + q * f - p * s) / (s**2 + f**2 + slow**2)
    kappa = (s**2 + f**2) / (s**2 + f**2 + slow**2)
    assert (np.abs(zeta) <= kappa * rate * np.abs(chi) + np.hypot(p, q) / (2 * slow) + 1e-9).all()
    assert np.abs(chi).max() <= np.pi / 2
    q, p = 1.0 * slow, 0.0  # it is reached: |P| = eps, Pdot across P
    assert abs(q * slow / (2 * slow**2)) == pytest.approx(np.hypot(p, q) / (2 * slow))


def test_a_swerve_drive_comes_to_rest() -> None:
    """Where kx = ky = k, V = k (ex^2 + ey^2) / 2 + l^2 kphi (1 - cos ephi) falls by u^2, whatever the wheels do."""
    count, gains, eps = 30, (2.0, 2.0, 1.5), 0.03
    none, rng = np.zeros((count, 3)), np.random.default_rng(8)
    motion = SteeredMotion(np.array(SQUARE), gyration(SQUARE), gains, 6.0, False, lambda _: (none, none), slow=eps)
    e, headings = rng.uniform(-1, 1, (count, 3)) * [0.05, 0.05, 0.3], rng.uniform(-np.pi, np.pi, (count, 4))
    heading = motion.length**2 * gains[2]
    asked, (n, _) = motion.asked(e, none) * [1.0, 1.0, motion.length], motion.direction(headings)
    rates = motion.rates(0.0, e, headings)[0]
    slope = np.sum(np.column_stack((gains[0] * e[:, :2], heading * np.sin(e[:, 2]))) * rates, axis=1)
    assert slope == pytest.approx(-(np.sum(n * asked, axis=1) ** 2))
    _, errors, _ = motion.run(e, headings, 10.0, dt=0.008)
    V = gains[0] * np.sum(errors[..., :2] ** 2, axis=2) / 2 + heading * (1 - np.cos(errors[..., 2]))
    assert np.diff(V, axis=0).max() < 1e-12
    assert V[-1].max() < 0.02 * V[0].max()


def slowed(gain: float, rate: float) -> Callable[[float, Array], list[float]]:
    """Rates of ln rho and chi, all wheels parallel and no heading error."""

    def rates(_: float, state: Array) -> list[float]:
        kappa, chi = 1 / (1 + np.exp(-state[0])), state[1]
        return [-2 * gain * np.cos(chi) ** 2, -kappa * rate * chi + (1 - kappa) * gain * np.sin(2 * chi) / 2]

    return rates


def test_how_a_swerve_drive_creeps_to_rest() -> None:
    """In rho = (k r / eps)^2 and chi it is the motion itself; at last r^4 = eps^4 / (pi^2 k^3 K^2 t)."""
    gain, rate, eps = 2.0, 6.0, 0.03
    still = np.zeros((4, 3))
    motion = SteeredMotion(
        np.array(SQUARE), gyration(SQUARE), (gain,) * 3, rate, False, lambda _: (still, still), slow=eps
    )
    e = np.outer([0.05, 0.03, 0.01, 0.005], [1.0, 0.0, 0.0])
    turned = np.array([1.5, 0.8, 0.3, 1.55])
    times, errors, chis = motion.run(e, np.repeat(turned[:, None], 4, axis=1), 4.0)
    for k, chi in enumerate(turned):
        begin = [2 * np.log(gain * e[k, 0] / eps), chi]
        run = solve_ivp(slowed(gain, rate), (0, 4), begin, "LSODA", times[::100], rtol=1e-9, atol=1e-12)
        r = np.hypot(errors[::100, k, 0], errors[::100, k, 1])
        assert r == pytest.approx(eps / gain * np.exp(run.y[0] / 2), rel=1e-3)
        assert np.abs(chis[::100, k, 0]) == pytest.approx(run.y[1], abs=1e-3)
    run = solve_ivp(slowed(gain, rate), (0, 1e4), [0.0, np.pi / 2], "LSODA", rtol=1e-9, atol=1e-12)
    rho = np.exp(run.y[0, -1])
    late = eps / (np.pi**2 * gain**3 * rate**2 * 1e4) ** 0.25
    assert eps / gain * np.sqrt(rho) == pytest.approx(late, rel=1e-2)
    assert np.pi / 2 - run.y[1, -1] == pytest.approx(np.pi * rate / (2 * gain) * rho, rel=2e-2)


@pytest.mark.parametrize("case", ["car", "swerve"])
def test_velocity_errors_enter_linearly(case: str) -> None:
    """Chidot = -K chi + z of the wheel, and eta is off by n z_u: against differences."""
    motion, _ = CASES[case](9, COUNT)
    rng = np.random.default_rng(9)
    e, headings = motion.begun(9, COUNT, 0.1, 1.0)
    z = rng.normal(size=COUNT), rng.normal(size=headings.shape)
    plain, _ = motion.rates(0.5, e, headings)
    motion.z = lambda _: z
    ed, turning = motion.rates(0.5, e, headings)
    step = 1e-5
    later, before = (motion.angles(0.5 + k * step, e + k * step * ed, headings + k * step * turning) for k in (1, -1))
    chi = motion.angles(0.5, e, headings)
    assert (later - before) / (2 * step) == pytest.approx(-motion.rate * chi + z[1], abs=1e-5)
    n = motion.direction(headings)[0] / [1.0, 1.0, motion.length] * z[0][:, None]
    spin = np.stack((-n[:, 2] * e[:, 1] + n[:, 0], n[:, 2] * e[:, 0] + n[:, 1], n[:, 2]), axis=1)
    assert ed - plain == pytest.approx(spin, abs=1e-9)


@pytest.mark.parametrize("Z", [0.05, 1.0])
@pytest.mark.parametrize("case", ["car", "swerve"])
def test_with_a_torque_loop_the_cascade_stays_in_its_bounds(case: str, Z: float) -> None:
    """Velocity errors of at most Z exp(-l t), of any sign: |chi| and a obey theorem 2, and all vanish."""
    motion, constants = CASES[case](10, COUNT)
    e, headings = motion.begun(10, COUNT, 0.05, np.pi / 2)
    rng = np.random.default_rng(10)
    fast, phase = rng.uniform(1, 20, COUNT), rng.uniform(0, 6.28, COUNT)
    fade, N = 4.0, len(motion.pivots)

    def z(time: float) -> tuple[Array, Array]:
        wave = Z * np.exp(-fade * time) * np.sign(np.sin(fast * time + phase))
        return wave, np.repeat(wave[:, None], N, axis=1)

    motion.z = z
    _, errors, chis = motion.run(e, headings, 6.0)
    a, worst = constants.size(errors), np.max(np.abs(chis), axis=2)
    top = worst[0] + Z / fade
    assert (worst <= top + 1e-3).all()
    swing = top / motion.rate
    m, B0, B1, _ = constants
    assert (B0 + B1 * a <= (B0 + B1 * (a[0] + m * Z / fade)) * np.exp(m * B1 * swing)).all()
    assert a[-1].max() < 0.05
    assert worst[-1].max() < 1e-4


def test_where_velocity_errors_do_not_vanish() -> None:
    """|z| <= zbar: at last |chi| <= zbar / K, which a constant z reaches."""
    motion, _ = CASES["car"](11, COUNT)
    zbar = 1.0
    motion.z = lambda _: (np.zeros(COUNT), np.full((COUNT, 1), zbar))
    _, _, chis = motion.run(*motion.begun(11, COUNT, 0.05, 0.5), 4.0)
    assert np.abs(chis[-1]) == pytest.approx(zbar / motion.rate, rel=1e-3)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_loader_moves_as_asked_where_the_guided_axle_leads(way: float) -> None:
    """Zeta = -s / t makes [n, X] nu = eta_c; the waist settles where -t f > 0 and folds over where not."""
    motion, constants = car(14, COUNT, way=way)
    for leads in (True, False):
        t_ = -0.6 * way * (1.0 if leads else -1.0)
        motion.trail, motion.pivots, motion.length = t_, np.array([[np.sign(t_) * 0.65, 0.0]]), 0.65 + abs(t_)
        motion.exact = True
        e, headings = motion.begun(14, COUNT, 0.1, 0.3)
        headings = np.arctan(np.tan(headings))
        _, errors, _ = motion.run(e, headings, 8.0)
        assert constants.size(errors[-1]).max() < 0.02 * constants.size(errors[0]).max()
        swing = np.abs(headings + motion.turned.sum(axis=0) * 0.004)
        assert (swing.max() < 1.0) == leads


# -- section 6: what a path asks of the wheels ------------------------------------------------------------------------


def test_what_a_path_asks_of_the_wheels() -> None:
    """Angles that make the row across vanish, their rates, and the largest curvature, of every kind."""
    v, yaw, X, Y, T_, r = 0.8, 0.3, 0.7, 0.2, 0.5, 0.3 / 0.8
    car = np.arctan2(X * r, 1 - Y * r)
    assert np.cos(car) * X * yaw - np.sin(car) * (v - Y * yaw) == pytest.approx(0)
    waist = np.arctan(X * r) + np.arcsin(T_ * r / np.sqrt(1 + X**2 * r**2))
    assert -np.sin(waist) * v + (X * np.cos(waist) + T_) * yaw == pytest.approx(0)
    time = sp.Symbol("time")
    px, py = sp.Function("px")(time), sp.Function("py")(time)
    rate = sp.atan2(py, px).diff(time)
    assert zero(rate - (px * py.diff(time) - py * px.diff(time)) / (px**2 + py**2))
    kappa = sp.Function("kappa")(time)
    assert zero(sp.atan(base * kappa).diff(time) - base * kappa.diff(time) / (1 + base**2 * kappa**2))


# -- section 7: trailers ----------------------------------------------------------------------------------------------

g, H, L_, kap, vt, wt = sp.symbols("gamma h L kappa v_t w_t", real=True)
J = sp.Matrix([[sp.cos(g), -H * sp.sin(g)], [-sp.sin(g) / L_, -H * sp.cos(g) / L_]])


def test_what_a_guided_trailer_asks_of_its_truck() -> None:
    assert zero(J.det() + H / L_)
    truck = J.inv() * sp.Matrix([vt, wt])
    assert zero(truck[0] - (sp.cos(g) * vt - L_ * sp.sin(g) * wt))
    assert zero(wt - truck[1] - (vt * sp.sin(g) + wt * (H + L_ * sp.cos(g))) / H)
    curvature = (truck[1] / truck[0]).subs(wt, kap * vt)
    assert abs(float((curvature + sp.tan(g + sp.atan(kap * L_)) / H).subs({g: 0.3, kap: 0.4, L_: 1.2, H: 0.2}))) < 1e-12


@pytest.mark.parametrize("hitch", [0.3, -0.2])
@pytest.mark.parametrize("curvature", [0.0, 0.4, -0.5])
def test_how_a_hitch_angle_settles(hitch: float, curvature: float) -> None:
    """Gammadot = (v/h) (sin gamma + kappa (h + L cos gamma)): its slope at rest, and that of a guided truck."""
    length = 1.1
    gammadot = (vt * sp.sin(g) + kap * vt * (H + L_ * sp.cos(g))) / H
    values = {H: hitch, L_: length, kap: curvature, vt: -0.5}
    rest = -np.arctan(curvature * length) - np.arcsin(curvature * hitch / np.hypot(1, curvature * length))
    assert float(gammadot.subs(values).subs(g, rest)) == pytest.approx(0, abs=1e-12)
    slope = float(gammadot.diff(g).subs(values).subs(g, rest))
    assert slope == pytest.approx(-0.5 * np.sqrt(1 + curvature**2 * (length**2 - hitch**2)) / hitch)
    led = (-(vt * sp.sin(g) + H * kap * vt * sp.cos(g)) / L_ - kap * vt).subs(values)
    at = hitch_on_circle(np.array([hitch, length]), curvature)
    assert float(led.subs(g, at)) == pytest.approx(0, abs=1e-12)
    assert float(led.diff(g).subs(g, at)) == pytest.approx(
        0.5 * np.sqrt(1 + curvature**2 * (hitch**2 - length**2)) / length
    )


def test_two_trailers_settle_where_each_does() -> None:
    """Guided by the last: the slopes at rest are triangular, with both signs of v_t/h on the diagonal."""
    g2, h2, l2 = sp.symbols("gamma2 h2 l2", real=True)
    J2 = J.subs({g: g2, H: h2, L_: l2}, simultaneous=True)
    first = J2.inv() * sp.Matrix([vt, kap * vt])
    truck = J.inv() * first
    rates = sp.Matrix([first[1] - truck[1], kap * vt - first[1]])
    values = {H: 0.2, L_: 0.9, h2: 0.3, l2: 1.2, vt: -0.5}
    slopes = rates.jacobian([g, g2]).subs(values).subs({g: 0, g2: 0, kap: 0})
    assert slopes[1, 0] == 0
    assert [float(slopes[0, 0]), float(slopes[1, 1])] == pytest.approx([-0.5 / 0.2, -0.5 / 0.3])


def switching(rng: np.random.Generator, most: float) -> Callable[[float], Array]:
    """200 curvatures, each of one size up to `most`, that change their sign at a rate of their own."""
    rate, phase, size = rng.uniform(0.2, 3, 200), rng.uniform(0, 6.28, 200), rng.uniform(0, most, 200)
    return lambda time: size * np.sign(np.sin(rate * time + phase))


def test_no_backing_within_its_bound_jackknifes() -> None:
    """|gamma| < gamma_J and |kappa_c| below the trailer's own largest: it stays so, for any such commands."""
    rng = np.random.default_rng(12)
    for h_, length, most in ((0.12, 0.7, 1.05), (0.3, 0.7, 1.05), (0.5, 1.5, 0.4)):
        bound = abs(hitch_on_circle(np.array([h_, length]), most))
        own = most / np.sqrt(1 + most**2 * (h_**2 - length**2))
        gamma = rng.uniform(-0.999, 0.999, 200) * bound
        angles = backed(np.array([h_, length]), most, gamma, switching(rng, 0.999 * own))
        assert np.abs(angles).max() < bound
        over = backed(np.array([h_, length]), most, np.array([1.02 * bound]), lambda time: np.zeros(1))
        assert np.abs(over[-1]) > np.pi / 2  # and just beyond it folds up


def test_no_backing_jackknifes_with_a_steering_that_takes_its_time() -> None:
    """Delta = |v| T (1 + kappa (L + |h|)) / L is what a swing from stop to stop may cost."""
    rng = np.random.default_rng(13)
    h_, length, most, v = 0.3, 0.7, 0.9, -0.4
    bound, late = abs(hitch_on_circle(np.array([h_, length]), most)), 0.3
    cost = abs(v) * late * (1 + most * (length + h_)) / length
    beta = np.arctan(h_ * most)
    size = np.tan(bound - beta - cost) / length
    assert size > 0.1
    gamma = rng.uniform(-1, 1, 200) * (bound - cost)
    angles = backed(np.array([h_, length]), most, gamma, switching(rng, size), late, v)
    assert np.abs(angles).max() < bound


def test_the_document_names_the_tests_that_prove_it() -> None:
    here = {name for name in globals() if name.startswith("test_")}
    named = set(re.findall(r"`(test_\w+)`", DOCUMENT.read_text()))
    assert named <= here
    assert {name for name in here if "_the_document_" not in name} <= named
