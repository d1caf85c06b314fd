"""The algebra of docs/explanation/theory.md by sympy, and each of its inequalities on random numbers, against the code.

The document names the tests that prove its steps; a test here holds it to that.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from certified import learner_loop
from hypothesis import given, settings
from hypothesis import strategies as st
from places import ROOT
from scipy.linalg import eigh
from scipy.special import expit

from mmnn_pin.kinematic import command
from mmnn_pin.lab.psi.rate import radius
from mmnn_pin.loop.sampled import held_loop
from mmnn_pin.model.base.base import Fixed
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.signals import Array, Layout
from mmnn_pin.torque.one_layer import one_layer_update
from mmnn_pin.torque.two_layer import two_layer_update
from research.proof.bounds import PoseBound, PoseSet, growth
from research.proof.boxes import Box, Boxes
from research.proof.certified_loop import CertifiedLoop
from research.proof.cover import Cover
from research.proof.motion_bound import Feed, Forces, Gains, drive, push

DOCUMENT = ROOT / "docs" / "explanation" / "theory.md"
ex, ey, ephi, vr, wr, z1, z2, w = sp.symbols("ex ey ephi vr wr z1 z2 w", real=True)
kx, ky, kth = sp.symbols("kx ky kth", positive=True)
eps = sp.Symbol("eps", positive=True)
alpha = sp.Matrix([vr * sp.cos(ephi) + kx * ex, wr + vr * (ky * ey + kth * sp.sin(ephi))])
eta = sp.sin(ephi) / sp.sqrt(ky)
Vk = (ex**2 + ey**2) / 2 + (1 - sp.cos(ephi)) / ky + eps * ey * eta


def rates(velocity: sp.Matrix) -> sp.Matrix:
    """The error kinematics (3.2) for (v, w) of the base."""
    v, w = velocity
    return sp.Matrix([w * ey - v + vr * sp.cos(ephi), -w * ex + vr * sp.sin(ephi), wr - w])


def zero(expression: sp.Expr) -> bool:
    return sp.simplify(sp.expand_trig(sp.expand(expression))) == 0


# -- section 2: the pose ---------------------------------------------------------------------------------------------


def test_the_derivative_of_vk() -> None:
    """Vkdot = -xi' Q xi + ex z1 + (eta + eps cos(ephi) ey) z2 / sqrt(ky), w the yaw rate of the base."""
    velocity = alpha - sp.Matrix([z1, z2])
    Vdot = (sp.Matrix([Vk]).jacobian([ex, ey, ephi]) * rates(velocity))[0]
    c, yaw = sp.cos(ephi), velocity[1]
    lateral, xi = eps * vr * sp.sqrt(ky), sp.Matrix([ex, ey, eta])
    Q = sp.Matrix(
        [[kx, 0, eps * yaw / 2],
         [0, lateral * c, eps * vr * kth * c / 2],
         [eps * yaw / 2, eps * vr * kth * c / 2, vr * kth - lateral]]
    )  # fmt: skip
    assert zero(Vdot - (-(xi.T * Q * xi)[0] + ex * z1 + (eta + eps * c * ey) * z2 / sp.sqrt(ky)))
    numbers = {kx: 1.3, ky: 7.0, kth: 5.0, eps: 0.6, vr: 0.4, ephi: 0.3, wr: 0.0, ex: 0.1, ey: 0.2, z2: 0.05}
    Q_number = np.array(Q.subs(numbers), float)
    bound = PoseBound(1.3, 7.0, 5.0, 0.4, 0.4, 0.0, 0.6)
    np.testing.assert_allclose(bound.decay_matrix(0.4, float(yaw.subs(numbers)), np.cos(0.3)), Q_number, rtol=1e-12)


def test_what_z2_weighs() -> None:
    """The square of the input term over that of xi in the metric is z1^2 + g^2 z2^2."""
    c = sp.Symbol("c", real=True)
    B = sp.Matrix([[1, 0], [0, eps * c / sp.sqrt(ky)], [0, 1 / sp.sqrt(ky)]])
    P = sp.Matrix([[1, 0, 0], [0, 1, eps], [0, eps, 1]])
    weight = sp.simplify(B.T * P.inv() * B)
    g2 = (1 - eps**2 * (2 - c) * c) / (ky * (1 - eps**2))
    assert sp.simplify(weight - sp.diag(1, g2)) == sp.zeros(2)
    assert sp.simplify(sp.diff(g2, c) + 2 * eps**2 * (1 - c) / (ky * (1 - eps**2))) == 0  # falls up to c = 1
    weights = [np.sqrt(float(weight[1, 1].subs({c: at, eps: 0.6, ky: 7.0}))) for at in np.linspace(0.3, 1, 8)]
    assert PoseBound(1.0, 7.0, 5.0, 0.3, 0.3, 0.0, 0.6).yaw_gain(0.3) == pytest.approx(max(weights), rel=1e-12)


def test_what_a_drift_of_the_reference_adds() -> None:
    """To Vkdot a term of at most `a (d_p + g d_w)`, to alphadot what `Drive` counts: (dx, dy, dw) beside (3.2)."""
    dx, dy, dw, c = *sp.symbols("dx dy dw", real=True), sp.cos(ephi)
    off = sp.Matrix([dx, dy, dw])
    added = (sp.Matrix([Vk]).jacobian([ex, ey, ephi]) * off)[0]
    assert zero(added - (ex * dx + (ey + eps * eta) * dy + (eta + eps * c * ey) * dw / sp.sqrt(ky)))
    P, weigh = sp.Matrix([[1, eps], [eps, 1]]), sp.Matrix([1, eps])
    assert sp.simplify((weigh.T * P.inv() * weigh)[0]) == 1  # |(ex, ey + eps eta)| <= a; the rest is that of z2
    nudot = alpha.jacobian([ex, ey, ephi]) * off
    wanted = sp.Matrix([kx * dx - vr * sp.sin(ephi) * dw, vr * (ky * dy + kth * c * dw)])
    assert all(zero(entry) for entry in nudot - wanted)
    bound, reach = PoseBound(1.3, 7.0, 5.0, 0.4, 0.5, 0.1, 0.6), PoseSet(0.1, 0.2, 0.3, 0.9, 0.4)
    still, moving = (
        drive(bound, reach, 0.0, np.zeros(1), np.ones(1), np.zeros((1, 2)), d) for d in ((0.0, 0.0), (0.02, 0.03))
    )
    most = [1.3 * 0.02 + 0.5 * 0.3 * 0.03, 0.5 * (7.0 * 0.02 + 5.0 * 0.03)]
    np.testing.assert_allclose(moving.nudot - still.nudot, most, rtol=1e-9)


def test_the_size_that_excludes_a_heading() -> None:
    """At cos ephi = 1 - u the least Vk over ey is (u (1 - eps^2) + eps^2 u^2/2)/ky, and it rises with u."""
    u = sp.Symbol("u", positive=True)
    sine2 = 1 - (1 - u) ** 2
    least = u / ky - eps**2 * sine2 / (2 * ky)  # min over ey of ey^2/2 + eps ey eta is -(eps eta)^2/2
    assert sp.simplify(least - (u * (1 - eps**2) + eps**2 * u**2 / 2) / ky) == 0
    bound = PoseBound(1.0, 8.0, 5.0, 0.3, 0.3, 0.0, 0.7)
    for size in np.linspace(0.01, 0.99, 9) * bound.largest:
        at = 1 - bound.reach(size).cosine
        assert (at * (1 - 0.49) + 0.49 * at**2 / 2) / 8.0 == pytest.approx(size**2 / 2, rel=1e-9)
    assert bound.reach(bound.largest).cosine == pytest.approx(0, abs=1e-9)


gains = st.tuples(st.floats(0.3, 12), st.floats(1, 70), st.floats(0.5, 20))


@settings(max_examples=60, deadline=None)
@given(gains, st.floats(0.05, 0.95), st.floats(0.1, 0.6), st.floats(0, 1), st.integers(0, 2**32 - 1))
def test_the_pose_error_obeys_its_bound(
    k: tuple[float, float, float], weight: float, slow: float, turning: float, seed: int
) -> None:
    """The size's rate is at most -decay a + |(z1, g z2)|, by the kinematics themselves; and the set it stands for."""
    rng = np.random.default_rng(seed)
    bound = PoseBound(*k, slow, 1.5 * slow, turning, weight)
    size, yaw_error = rng.uniform(0.05, 0.95) * bound.largest, 0.3
    reach, decay = bound.reach(size), bound.decay(size, yaw_error)
    g = bound.yaw_gain(reach.cosine)
    for _ in range(40):
        error = rng.standard_normal(3) * np.array([1, 1, np.sqrt(k[1])]) * bound.largest
        for _ in range(60):  # scaled into the set, where it is connected to 0
            if np.abs(error[2]) < np.pi / 2 and bound.size(error[None])[0] <= size:
                break
            error *= 0.85
        a = bound.size(error[None])[0]
        x, y, phi = error
        assert abs(x) <= reach.ex and abs(y) <= reach.ey and abs(np.sin(phi)) <= reach.sine + 1e-12
        assert np.cos(phi) >= reach.cosine and abs(k[1] * y + k[2] * np.sin(phi)) <= reach.turn * (1 + 1e-12)
        v, yaw = rng.uniform(slow, 1.5 * slow), rng.uniform(-turning, turning)
        z = rng.uniform(-1, 1, 2) * np.array([1.0, yaw_error])
        rate = rate_of_size(bound, error, v, yaw, z)
        assert rate <= -decay * a + np.hypot(z[0], g * z[1]) + 1e-9 * (1 + abs(decay) * a)


@settings(max_examples=25, deadline=None)
@given(gains, st.floats(0.05, 0.95), st.floats(0.1, 0.6), st.floats(0, 1), st.floats(0.05, 0.9))
def test_the_decay_is_the_smallest_over_all_that_may_vary(
    k: tuple[float, float, float], weight: float, slow: float, turning: float, share: float
) -> None:
    """Brute force over vr, w and cos ephi in their intervals, ends included: nothing below, and it is reached."""
    bound, yaw_error = PoseBound(*k, slow, 1.5 * slow, turning, weight), 0.2
    reach = bound.reach(share * bound.largest)
    most = turning + 1.5 * slow * reach.turn + yaw_error
    P, found = bound.metric(reach.cosine), []
    for v in np.linspace(slow, 1.5 * slow, 4):
        for yaw in np.linspace(-most, most, 5):
            for c in np.linspace(reach.cosine, 1, 4):
                found.append(eigh(bound.decay_matrix(v, yaw, c), P, eigvals_only=True)[0])
    assert bound.decay(share * bound.largest, yaw_error) == pytest.approx(min(found), rel=1e-9, abs=1e-9)


def rate_of_size(bound: PoseBound, error: np.ndarray, v_ref: float, yaw: float, z: np.ndarray) -> float:
    """d/dt of the size by central differences along the kinematics, without Q or its derivation."""
    x, y, phi = error
    v = v_ref * np.cos(phi) + bound.kx * x - z[0]
    turn = yaw + v_ref * (bound.ky * y + bound.kth * np.sin(phi)) - z[1]
    step = np.array([turn * y - v + v_ref * np.cos(phi), -turn * x + v_ref * np.sin(phi), yaw - turn])
    d = 1e-6 * bound.size(error[None])[0] / max(np.abs(step).max(), 1e-9)
    return float((bound.size((error + d * step)[None])[0] - bound.size((error - d * step)[None])[0]) / (2 * d))


# -- section 3: the weights ------------------------------------------------------------------------------------------


def test_a_unit_less_its_slope_rises_from_0_to_1() -> None:
    a = sp.Symbol("a", real=True)
    sigma = 1 / (1 + sp.exp(-a))
    slope = sigma * (1 - sigma)
    assert sp.simplify(sp.diff(sigma, a) - slope) == 0
    g = sigma - a * slope
    assert sp.simplify(sp.diff(g, a) - a * slope * (2 * sigma - 1)) == 0  # a (2 sigma - 1) >= 0
    assert sp.limit(g, a, -sp.oo) == 0
    assert sp.simplify(g + g.subs(a, -a)) == 1  # so that it goes to 1 at the other end


@settings(max_examples=50, deadline=None)
@given(st.floats(0.05, 1.95), st.floats(0.1, 5), st.integers(0, 2**32 - 1))
def test_no_sequence_of_updates_takes_the_weights_beyond_their_bound(y: float, kappa: float, seed: int) -> None:
    """Any inputs and errors, up to kappa F |s| = y: the package's own updates keep |W| and |V| within the bound."""
    rng = np.random.default_rng(seed)
    h, m, nx, F, G = 5, 2, 4, 0.3, 0.1
    W, V, X = np.zeros((h, m)), rng.uniform(-0.1, 0.1, (nx, h)), 3.0
    most, own = y / (kappa * F), growth(y) * np.sqrt(h) / kappa
    most_V = max(float(np.linalg.norm(V)), growth(y * G / F) * X * own / (4 * kappa))
    one = np.zeros((h, m))
    s = rng.standard_normal(m)
    for _ in range(200):
        s = -s if rng.random() < 0.7 else rng.standard_normal(m)
        s *= most * (1.0 if rng.random() < 0.7 else rng.random()) / np.linalg.norm(s)
        x = rng.standard_normal(nx)
        x *= X / np.linalg.norm(x)
        net = V.T @ x
        two_layer_update(W, V, x, net, expit(net), s, np.array([F, G, kappa]), 1.0)
        one_layer_update(one, rng.uniform(0, 1, h), s, F, kappa, 1.0)
        assert np.linalg.norm(W) <= own * (1 + 1e-12) and np.linalg.norm(one) <= own * (1 + 1e-12)
        assert np.linalg.norm(V) <= most_V * (1 + 1e-12)


def test_the_bound_on_the_weights_is_reached_and_from_2_on_there_is_none() -> None:
    """Signs that alternate at y = 1.8 come close to y/(2 - y); at y = 2.2 they grow without end."""
    for y, limit in ((1.8, growth(1.8)), (2.2, np.inf)):
        W, s = np.zeros((1, 1)), np.array([y])
        for _ in range(300):
            one_layer_update(W, np.ones(1), s, 1.0, 1.0, 1.0)
            s = -s
        assert 0.95 * limit < abs(W[0, 0]) <= limit if np.isfinite(limit) else abs(W[0, 0]) > 1e6


# -- section 4: the energy of the errors -----------------------------------------------------------------------------


def test_alphadot_is_affine_in_z() -> None:
    """alphadot(v, w) = alphadot(alpha) + Az z with Az = [[kx, -kx ey - vr sin], [0, ky vr ex + kth vr cos]]."""
    vrdot, wrdot = sp.symbols("vrdot wrdot", real=True)
    time = {vr: vrdot, wr: wrdot}

    def alphadot(velocity: sp.Matrix) -> sp.Matrix:
        moved = alpha.jacobian([ex, ey, ephi]) * rates(velocity)
        return moved + sum((alpha.diff(symbol) * rate for symbol, rate in time.items()), sp.zeros(2, 1))

    s, c = sp.sin(ephi), sp.cos(ephi)
    Az = sp.Matrix([[kx, -kx * ey - vr * s], [0, ky * vr * ex + kth * vr * c]])
    z = sp.Matrix([z1, z2])
    assert all(zero(entry) for entry in alphadot(alpha - z) - alphadot(alpha) - Az * z)


def test_what_the_hold_takes() -> None:
    """|d| <= h (mu (|s| + |d|) + W) gives |d| <= (h mu |s| + h W)/(1 - h mu); Young gives the constant."""
    h, mu, W, size, d, theta = sp.symbols("h mu W size d theta", positive=True)
    solved = sp.solve(sp.Eq(d, h * (mu * (size + d) + W)), d)[0]
    assert sp.simplify(solved - (h * mu * size + h * W) / (1 - h * mu)) == 0
    omega = sp.Symbol("omega", positive=True)
    gap = theta * size**2 + omega**2 / (4 * theta) - size * omega
    assert sp.simplify(gap - (2 * theta * size - omega) ** 2 / (4 * theta)) == 0


def test_completing_the_square_in_energy() -> None:
    """-s'Ks + s'u + 2 rate E - u'Ru/4 = -|R^-1/2 (s - R u/2)|^2 for R = (K - rate M)^-1: never positive."""
    a, b, c, x, y, f, g = sp.symbols("a b c x y f g", real=True)
    N, s, u = sp.Matrix([[a, b], [b, c]]), sp.Matrix([x, y]), sp.Matrix([f, g])  # N = K - rate M
    R = N.inv()
    off = s - R * u / 2
    assert sp.simplify((-s.T * N * s + s.T * u - u.T * R * u / 4 + off.T * N * off)[0]) == 0
    rng = np.random.default_rng(0)
    for _ in range(200):
        A, B = rng.standard_normal((2, 4, 4))
        M, rate = A @ A.T + np.eye(4), 0.7
        K = B @ B.T + rate * M + 0.1 * np.eye(4)
        s, u = rng.standard_normal((2, 4))
        R = np.linalg.inv(K - rate * M)
        left = -s @ K @ s + s @ u + rate * s @ M @ s - u @ R @ u / 4
        off = s - R @ u / 2
        assert left == pytest.approx(-off @ (K - rate * M) @ off, abs=1e-9 * (1 + s @ K @ s))
        assert left <= 1e-9


@dataclass
class Place:
    """Anywhere in the k-th box of a cover: where the arm is, and what the reference does there; mostly at corners."""

    loop: CertifiedLoop
    cover: Cover
    k: int
    rng: np.random.Generator

    def of(self, middle: Array, half: Array) -> Array:
        u = self.rng.uniform(-1, 1, middle.shape[1])
        return middle[self.k] + half[self.k] * (np.sign(u) if self.rng.random() < 0.5 else u)

    def __post_init__(self) -> None:
        robot, cover, here = self.loop.robot, self.cover, self.cover.postures
        self.q, self.nu = self.of(here.q, here.half), self.of(cover.nu, cover.nu_off)
        self.nudot, self.dynamics = self.of(cover.nudot, cover.nudot_off), Dynamics(robot)
        position = robot.neutral_position()
        position[robot.arm_index] = self.q
        self.position = robot.follow(position)
        self.M = self.dynamics.mass_matrix(self.position)

    def coriolis(self, nu: Array) -> Array:
        return self.dynamics.coriolis_matrix(self.position, nu)

    def signals(self, error: Array, e: Array, s: Array) -> dict[str, Array]:
        """Signals of `command` with these errors."""
        layout = Layout.of(self.loop.robot.dimensions)
        row, gains = layout.new_row(), self.loop.kinematic.base_gains(layout)
        values = {"pose_ref": error, "velocity_ref": self.nu[:2], "acceleration_ref": self.nudot[:2]}
        values |= {"q_ref": self.q + e, "qdot_ref": self.nu[2:], "qddot_ref": self.nudot[2:], "q": self.q}
        for name, value in values.items():
            row[layout.where(name)] = value
        command(row, layout.offsets, gains, self.loop.K, np.zeros(0), None)
        nu = row[layout.where("nu_ref")] - s
        row[layout.where("velocity")], row[layout.where("qdot")] = nu[:2], nu[2:]
        command(row, layout.offsets, gains, self.loop.K, np.zeros(0), None)
        names = ("alpha", "alphadot", "e", "edot", "r", "z", "nu_ref", "nudot_ref", "pose_error")
        return {name: row[layout.where(name)].copy() for name in names}


def places(loop: CertifiedLoop, cover: Cover, seed: int, number: int) -> Iterator[Place]:
    rng = np.random.default_rng(seed)
    for _ in range(number):
        yield Place(loop, cover, int(rng.integers(len(cover.nu))), rng)


@pytest.mark.parametrize("seed", range(3))
def test_the_energy_of_the_errors_obeys_its_bound(seed: int) -> None:
    """At random states of a box, in any posture: s' Psi and ds/dt, from Pinocchio and `command`, within the bounds."""
    loop = learner_loop()
    box = Box(0.4 * loop.pose.largest, 0.15, 0.08)
    boxes = Boxes(loop, box)
    cover, added, p = boxes.cover(box), boxes.drive(box), 4
    bare = Gains(*(0 * boxes.gains.lower for _ in range(3)), loop.K, 0 * boxes.gains.lower, loop.period)
    forces, feed = Forces.of(cover, added, box.energy, bare), Feed.of(cover, added)
    sizes = forces.size(cover, np.broadcast_to(np.eye(p), cover.L.shape), np.ones((len(cover.L), p)))
    pushed = push(cover, added, forces, box.energy, replace(bare, upper=boxes.gains.upper))
    limits, near = loop.signal_bounds(added, box.pose, boxes.joints(box), boxes.velocity(box)), []
    for place in places(loop, cover, seed, 150):
        rng, k = place.rng, place.k
        e, error = loop.metric.root @ ball(rng, 2) * box.arm, pose_error(rng, loop.pose, box.pose)
        still, L_inv = place.signals(error, e, np.zeros(p)), np.linalg.inv(np.linalg.cholesky(place.M))
        way = L_inv @ place.dynamics.psi(place.position, still["nu_ref"], still["nu_ref"], still["nudot_ref"])
        way = way / np.linalg.norm(way) if rng.random() < 0.5 else ball(rng, p)  # where Psi pushes the most, or any
        s = L_inv.T @ way * np.sqrt(2 * box.energy)
        signals = place.signals(error, e, s)
        nu_ref, nudot_ref = signals["nu_ref"], signals["nudot_ref"]
        psi = place.dynamics.psi(place.position, nu_ref - s, nu_ref, nudot_ref)
        x = cover.L[k].T @ s
        bound = -x @ feed.K[k] @ x + feed.lost[k] * (x @ x) + np.linalg.norm(x) * sizes[k]
        assert s @ psi <= bound + 1e-9
        sdot = np.linalg.solve(place.M, psi - place.coriolis(nu_ref - s) @ s)
        size = np.sqrt(boxes.gains.upper @ sdot**2)
        assert size <= pushed * (1 + 1e-9)
        near.append((s @ psi + x @ feed.K[k] @ x) / (bound + x @ feed.K[k] @ x))
        for name, value in signals.items():
            assert (np.abs(value) <= limits[name] + 1e-9).all(), name
    assert max(near) > 0.12


def test_what_the_errors_add_to_the_reference_velocity() -> None:
    """`drive` against `command`: never less, entry by entry of Az, and not much more."""
    loop = learner_loop()
    box = Box(0.5 * loop.pose.largest, 0.15, 0.08)
    boxes = Boxes(loop, box)
    added = boxes.drive(box)
    most = {"nu": np.zeros(4), "nudot": np.zeros(2), "Az": np.zeros((4, 4))}
    for place in places(loop, boxes.cover(box), 0, 400):
        error, e = pose_error(place.rng, loop.pose, box.pose), loop.metric.root @ ball(place.rng, 2) * box.arm
        still = place.signals(error, e, np.zeros(4))
        Az = np.array([place.signals(error, e, s)["nudot_ref"] - still["nudot_ref"] for s in np.eye(4)]).T
        np.testing.assert_allclose(still["nudot_ref"][2:] - place.nudot[2:], -(loop.K**2) * e, atol=1e-12)
        here = {
            "nu": np.abs(still["nu_ref"] - place.nu),
            "nudot": np.abs(still["alphadot"] - place.nudot[:2]),
            "Az": np.abs(Az - added.middle),
        }
        most = {name: np.maximum(value, here[name]) for name, value in most.items()}
    for name, limit in (("nu", added.nu), ("nudot", added.nudot), ("Az", added.half)):
        assert (most[name] <= limit + 1e-12).all(), name
        assert (most[name][limit > 0] > 0.2 * limit[limit > 0]).all(), name


def test_the_quadratic_form_in_s_is_exact() -> None:
    """In the middle, no other errors: s' Psi = s' centre - s' K s + s' M (Az - middle) s, K of the code."""
    loop = learner_loop()
    box = Box(0.3 * loop.pose.largest, 0.1, 0.05)
    boxes = Boxes(loop, box)
    cover, added = boxes.cover(box), boxes.drive(box)
    middles = replace(cover, nu_off=0 * cover.nu_off, nudot_off=0 * cover.nudot_off)
    middles = replace(middles, postures=replace(cover.postures, half=0 * cover.postures.half))
    K, forces, none = Feed.of(cover, added).K, Forces.of(cover, added, box.energy, boxes.gains), np.zeros(4)
    for place in places(loop, middles, 0, 50):
        k, s = place.k, place.rng.standard_normal(4)
        there, still = place.signals(np.zeros(3), np.zeros(2), s), place.signals(np.zeros(3), np.zeros(2), none)
        psi = place.dynamics.psi(place.position, there["nu_ref"] - s, there["nu_ref"], there["nudot_ref"])
        moved = there["nudot_ref"] - still["nudot_ref"] - added.middle @ s
        x = cover.L[k].T @ s
        right = x @ (forces.still + forces.moved)[k] - x @ K[k] @ x + s @ place.M @ moved
        assert s @ psi == pytest.approx(right, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("errors", [1.0, 0.0])
def test_what_the_rest_of_a_box_takes_from_the_quadratic_form(errors: float) -> None:
    """Anywhere, at corners of Az and nu_ref, s the worst direction: s' K s falls by at most `lost` s' M0 s.

    Without errors of pose and arm it is only the posture that changes it.
    """
    loop = learner_loop()
    box, worst = Box(0.5 * loop.pose.largest, 0.15, 0.08), np.inf
    boxes = Boxes(loop, box)
    cover, added = boxes.cover(box), boxes.drive(box)
    added = replace(added, nu=errors * added.nu, half=errors * added.half)
    feed = Feed.of(cover, added)
    for place in places(loop, cover, 0, 300):
        k, sign = place.k, place.rng.choice((-1.0, 1.0), (4, 4))
        nu = place.nu + place.rng.choice((-1.0, 1.0), 4) * added.nu
        true = cover.viscous - place.M @ (added.middle + sign * added.half)
        true = true + np.array([place.coriolis(unit) @ nu for unit in np.eye(4)]).T
        L_inv = cover.L_inv[k]
        least = np.linalg.eigvalsh(L_inv @ (true + true.T) @ L_inv.T / 2 - feed.K[k])[0]
        assert least >= -feed.lost[k] * (1 + 1e-9)
        worst = min(worst, least / feed.lost[k])
    assert worst < -0.3


def test_all_of_the_reference_and_all_arm_errors_are_in_a_cover() -> None:
    """Any instant of the reference with any arm error of the size is in a box whose terms and bounds hold there."""
    loop, rng = learner_loop(), np.random.default_rng(0)
    cover = loop.cover(0.09)
    here = cover.postures
    for _ in range(200):
        k = rng.integers(len(loop.along.v_ref))
        q = loop.along.q_ref[k] + loop.metric.root @ ball(rng, 2) * 0.09
        inside = (np.abs(q - here.q) <= here.half + 1e-12).all(axis=1)
        inside &= (np.abs(loop.along.nu[k] - cover.nu) <= cover.nu_off + 1e-12).all(axis=1)
        inside &= (np.abs(loop.along.nudot[k] - cover.nudot) <= cover.nudot_off + 1e-12).all(axis=1)
        assert inside.any()
        position = loop.robot.neutral_position()
        position[loop.robot.arm_index] = q
        M = Dynamics(loop.robot).mass_matrix(loop.robot.follow(position))
        ratio = np.linalg.eigvalsh(np.linalg.inv(M))[-1] / np.linalg.eigvalsh(cover.M_inverse[inside])[:, -1].max()
        assert ratio <= 1 + 1e-9


def ball(rng: np.random.Generator, n: int) -> np.ndarray:
    """A point on the unit sphere, or within."""
    v = rng.standard_normal(n)
    return v / np.linalg.norm(v) * (1.0 if rng.random() < 0.7 else rng.random())


def pose_error(rng: np.random.Generator, pose: PoseBound, size: float) -> np.ndarray:
    """A pose error of at most a size, most of them at it."""
    error = rng.standard_normal(3) * np.array([1, 1, np.sqrt(pose.ky)]) * size
    while np.abs(error[2]) > 1.5 or pose.size(error[None])[0] > size:
        error *= 0.98
    return error


def test_the_bound_on_the_arm_errors() -> None:
    """d/dt sqrt(e'Ne) <= -lambda_b sqrt(e'Ne) + gamma_b sqrt(s'Ms), with different K per joint."""
    loop = learner_loop(K=(2.0, 5.0))
    N, rng, cover = loop.metric.N, np.random.default_rng(0), loop.cover(0.1)
    for _ in range(500):
        e, s = rng.standard_normal(2), rng.standard_normal(4)
        b = np.sqrt(e @ N @ e)
        rate = e @ N @ (s[2:] - loop.K * e) / b
        energy = np.sqrt(s @ next(places(loop, cover, int(rng.integers(1 << 30)), 1)).M @ s)
        assert rate <= -loop.arm_decay * b + cover.arm_gain * energy + 1e-9


# -- section 6: the rates --------------------------------------------------------------------------------------------


def test_one_velocity_alone() -> None:
    """Jury's conditions for one inertia: stable if and only if L < k and h (2 k - L) < 4 m, for L > 0."""
    h, k, m, L, lam = sp.symbols("h k m L lam", positive=True)
    A = sp.Matrix([[1 - h * k / m, -h / m], [L, 1]])
    one, trace, det = A.charpoly(lam).all_coeffs()
    assert one == 1
    assert sp.simplify(1 - det - h * (k - L) / m) == 0
    assert sp.simplify(1 + trace + det - h * L / m) == 0
    assert sp.simplify(1 - trace + det - (4 - h * (2 * k - L) / m)) == 0


@settings(max_examples=100, deadline=None)
@given(st.floats(0.05, 3), st.floats(0.01, 3))
def test_the_radius_agrees_with_jury(gain: float, kernel: float) -> None:
    """`radius` on one joint without an error to integrate (K = 0), against the two inequalities."""
    m, h = 0.5, 0.01
    k, L = gain * m / h, kernel * m / h
    held = held_loop(np.array([[m]]), Fixed.linear_errors(np.zeros(0), np.zeros(0)), np.zeros(1), h)
    assert held is not None
    margin = min(k - L, 4 * m / h - 2 * k + L) / (m / h)
    if abs(margin) > 1e-6:
        assert (radius(held, np.array([k]), np.array([[L]]), False) < 1 + 1e-12) == (margin > 0)
        first = 4 - 2 * gain - kernel  # updates before the output: det < 1 always, only this is left
        if abs(first) > 1e-6:
            assert (radius(held, np.array([k]), np.array([[L]]), True) < 1 + 1e-12) == (first > 0)


def test_learning_destabilises_where_the_kinematic_gain_is_high() -> None:
    """In continuous time: m > k/kx makes a fast enough learner unstable, although V of (3.53) never says so."""
    m, k, L, p, kxs = sp.symbols("m k L p kx", positive=True)
    # ex' = -n, m n' = k s + Psi_hat, Psi_hat' = L s, s = kx ex - n; n what v is above vr, L per second
    A = sp.Matrix([[0, -1, 0], [k * kxs / m, -k / m, 1 / m], [L * kxs, -L, 0]])
    a3, a2, a1, a0 = A.charpoly(p).all_coeffs()
    assert a3 == 1
    routh = sp.simplify((a2 * a1 - a0) * m**2)
    assert sp.simplify(routh - (k**2 * kxs + L * (k - kxs * m))) == 0  # negative for large L if kx m > k


# -- section 7: the thesis's argument --------------------------------------------------------------------------------


def test_v_may_grow_however_far_the_weights_are() -> None:
    """The bound (3.57) is positive at any |Ztilde_1| for |z| small and |r| = D2/(2 k2): the set is not compact."""
    z, k1, k2, D1, D2, kappa, Z = sp.symbols("z k1 k2 D1 D2 kappa Z", positive=True)
    r = D2 / (2 * k2)
    bound = -z * (k1 * z - D1 + kappa * Z**2) - r * (k2 * r - D2)
    assert sp.simplify(sp.limit(bound, z, 0) - D2**2 / (4 * k2)) == 0


def names_in(file: Path) -> set[str]:
    return set(re.findall(r"^def (test_\w+)\(", file.read_text(), re.M))


def test_the_document_names_only_tests_that_exist() -> None:
    here = names_in(Path(__file__))
    files = (
        "test_certificate.py",
        "test_certified_assumptions.py",
        "test_certified_period.py",
        "test_postures.py",
        "test_certified_arms.py",
        "test_features.py",
        "test_known.py",
        "test_known_laws.py",
        "test_tube.py",
        "test_steps.py",
        "test_blocks.py",
        "test_laws_proved.py",
    )
    there = {name for file in files for name in names_in(Path(__file__).parent / file)}
    beside = "loop/test_lead.py", "torque/test_concurrent.py", "blocks/test_sensing.py", "blocks/test_compliance.py"
    there |= {name for file in beside for name in names_in(ROOT / "tests" / file)}
    named = set(re.findall(r"`(test_\w+)`", DOCUMENT.read_text()))
    assert named <= here | there
    assert {name for name in here if "_the_document_" not in name} <= named
