"""The errata of the thesis, each by a proof or a run; docs/thesis/errata.md names the tests."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from places import ROOT
from scipy.special import expit

from mmnn_pin import Recording, load, load_experiment, run_experiment
from mmnn_pin.kinematic import command
from mmnn_pin.lab.experiments.cases import readings, summaries
from mmnn_pin.model.checks.second_answers import WorldFrame
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.signals import INDEX, Array, Layout
from mmnn_pin.torque.neural import Inputs
from mmnn_pin.torque.two_layer import numerical_rank, two_layer_update

HERE = Path(__file__)
DOCUMENT = ROOT / "docs" / "thesis" / "errata.md"
SECONDS = 0.04 if numba.config.DISABLE_JIT else 1.0
compiled_only = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="slow in plain Python")


def chapter4(*overrides: str, seconds: float = SECONDS) -> dict[str, Recording]:
    return run_experiment(load_experiment("chapter4", [f"time.duration={seconds}", *overrides]), "x").recordings


# -- chapter 2: the Lie bracket ----------------------------------------------------------------------------------------


def test_the_lie_bracket_of_2_9_has_the_other_sign() -> None:
    q = sp.symbols("x y phi")
    phi = q[2]
    s1, s2 = sp.Matrix([sp.cos(phi), sp.sin(phi), 0]), sp.Matrix([0, 0, 1])
    bracket = s2.jacobian(q) * s1 - s1.jacobian(q) * s2  # as (2.9) writes it
    printed = sp.Matrix([-sp.sin(phi), sp.cos(phi), 0])
    assert sp.simplify(bracket + printed) == sp.zeros(3, 1)
    assert sp.simplify(sp.Matrix.hstack(s1, s2, bracket).det() ** 2) == 1  # the conclusion holds: independent


def test_with_the_wheel_angles_one_rolling_constraint_integrates() -> None:
    q = sp.symbols("x y phi left right")
    r, b, phi = *sp.symbols("r b", positive=True), q[2]
    v = sp.Matrix([sp.cos(phi), sp.sin(phi), 0, 1 / r, 1 / r])
    w = sp.Matrix([0, 0, 1, -b / r, b / r])

    def bracket(f: sp.Matrix, g: sp.Matrix) -> sp.Matrix:
        return g.jacobian(q) * f - f.jacobian(q) * g

    first = bracket(v, w)
    fields = [v, w, first, bracket(v, first), bracket(w, first)]
    assert [sp.Matrix.hstack(*fields[:k]).rank(simplify=True) for k in (2, 3, 5)] == [2, 3, 4]
    again = [bracket(f, g) for f in (v, w) for g in fields[3:]]
    assert sp.Matrix.hstack(*fields, *again).rank(simplify=True) == 4  # it stays
    integral = phi - r / (2 * b) * (q[4] - q[3])  # which no motion changes
    assert all(sp.simplify((sp.Matrix([integral]).jacobian(q) * f)[0]) == 0 for f in fields + again)


# -- chapter 3: the kinematic controller -------------------------------------------------------------------------------

EX, EY, EPHI, VR, WR, KX, KY, KTH, Z1, Z2 = sp.symbols("ex ey ephi vr wr kx ky kth z1 z2", real=True)
GAINS = {KX: 10, KY: 64, KTH: 16, VR: sp.Rational(3, 10)}  # chapter 4


def derivative(V: sp.Expr, z: tuple[Any, Any] = (0, 0)) -> sp.Expr:
    """dV/dt along (3.2) with v = alpha - z and the command (3.3)."""
    v = VR * sp.cos(EPHI) + KX * EX - z[0]
    w = WR + VR * (KY * EY + KTH * sp.sin(EPHI)) - z[1]
    rates = (w * EY - v + VR * sp.cos(EPHI), -w * EX + VR * sp.sin(EPHI), WR - w)
    return sp.expand(sum(V.diff(e) * rate for e, rate in zip((EX, EY, EPHI), rates, strict=True)))


PRINTED_V1 = KX * (EX**2 + EY**2) + 2 * KTH * VR * (1 - sp.cos(EPHI))
WORKING_V1 = (EX**2 + EY**2) / 2 + (1 - sp.cos(EPHI)) / KY


def test_the_function_of_3_4_increases_somewhere_with_the_thesis_s_own_gains() -> None:
    wanted = -2 * KX**2 * EX**2 - 2 * KTH**2 * VR**2 * sp.sin(EPHI) ** 2
    wanted += 2 * VR * EY * sp.sin(EPHI) * (KX - KTH * KY * VR)
    assert sp.simplify(derivative(PRINTED_V1) - wanted) == 0
    rate = sp.lambdify((EX, EY, EPHI), derivative(PRINTED_V1).subs(GAINS).subs(WR, 0))
    assert rate(0.0, -0.2, 0.1) > 0 > rate(0.0, 0.2, 0.1)  # 0.2 m and 0.1 rad beside the reference
    assert wanted.subs(KX, KTH * KY * VR).diff(EY) == 0  # only then no term in ey
    assert GAINS[KTH] * GAINS[KY] * GAINS[VR] > 30 * GAINS[KX]  # the thesis's gains are far from that


def test_the_function_that_works_never_increases_but_says_nothing_at_rest() -> None:
    wanted = -KX * EX**2 - VR * KTH / KY * sp.sin(EPHI) ** 2
    assert sp.simplify(derivative(WORKING_V1) - wanted) == 0  # <= 0 for vr >= 0
    assert wanted.subs({EX: 0, EPHI: 0}) == 0  # for any ey: only semi-definite
    assert wanted.subs({EX: 0, VR: 0}) == 0  # at rest for any ey and ephi: no posture is stabilised


def test_the_velocity_error_adds_what_3_19_drops() -> None:
    added = sp.simplify(derivative(WORKING_V1, (Z1, Z2)) - derivative(WORKING_V1))
    assert sp.simplify(added - EX * Z1 - sp.sin(EPHI) / KY * Z2) == 0
    rate = derivative(WORKING_V1, (Z1, Z2)).subs(GAINS)
    assert rate.subs({EX: 0.01, EPHI: 0, EY: 0, Z1: 0.4, Z2: 0}) > 0  # 10 mm behind, z1 as figure 4.3 begins


def test_without_a_term_in_ey_squares_alone_bound_no_lateral_error() -> None:
    """At ex = ephi = 0 the rate of V1 is zero however large ey is, with or without z: nothing pushes V1 down."""
    rate = derivative(WORKING_V1, (Z1, Z2)).subs({EX: 0, EPHI: 0})
    assert sp.simplify(rate) == 0


# -- chapter 3: the unknown terms --------------------------------------------------------------------------------------


def test_only_the_second_definition_of_f2_gives_psi_2() -> None:
    """Psi_2 (3.21) equals the arm's rows of M nudot_ref + C nu_ref + F with f2 of (3.22), not with that of (3.13)."""
    robot, rng = load("platform_arm"), np.random.default_rng(3)
    model, world, K = Dynamics(robot), WorldFrame(robot), 7.0
    nv, p, n = robot.T.shape[0], robot.dimensions.dof, robot.dimensions.arm
    arm = [list(robot.full_velocity_names).index(name) for name in robot.joint_names]
    base = [i for i in range(nv) if i not in arm]
    position, nu = rng.uniform(-1, 1, nv), rng.uniform(-1, 1, p)
    alpha, alphadot, qdot_rd, qddot_rd, e = (rng.uniform(-1, 1, 2) for _ in range(5))
    r = qdot_rd - nu[2:] + K * e
    edot = r - K * e
    q = world.coordinates(position)
    S = world.null_space(q[2])
    qdot = S @ nu
    Sdot = world.null_space_rate(q[2], qdot[2])
    M, C = world.mass_matrix(q), world.coriolis_matrix(q, qdot)
    M_r, C_r, M_rv, C_rv = (A[np.ix_(arm, cols)] for cols in (arm, base) for A in (M, C))
    S_v, S_v_dot = S[base][:, :2], Sdot[base][:, :2]
    F2 = world.gravity(q)[arm] + model.friction(nu)[2:]
    f2 = {"3.22": M_r @ qddot_rd + C_r @ qdot_rd + F2}
    qddot_v = S_v @ rng.uniform(-1, 1, 2) + S_v_dot @ nu[:2]
    f2["3.13"] = M_rv @ qddot_v + C_rv @ qdot[base] + f2["3.22"]
    rest = K * M_r @ r + (C_r - K * M_r) @ (K * e) + (M_rv @ S_v) @ alphadot + (M_rv @ S_v_dot + C_rv @ S_v) @ alpha
    nu_ref, nudot_ref = np.concatenate([alpha, qdot_rd + K * e]), np.concatenate([alphadot, qddot_rd + K * edot])
    psi_2 = model.psi(position, nu, nu_ref, nudot_ref)[-n:]
    np.testing.assert_allclose(rest + f2["3.22"], psi_2, rtol=1e-9)
    assert np.abs(rest + f2["3.13"] - psi_2).max() > 0.1  # N m: the coupling counted twice


# -- the theorem -------------------------------------------------------------------------------------------------------

positive = st.floats(0.1, 50)


@given(positive, positive, positive, positive)
def test_one_error_outside_of_its_bound_is_not_enough(k1: float, k2: float, D1: float, D2: float) -> None:
    """Gap (a): with |z| just above bz = D1/k1 and |r| = D2/(2 k2) the bound on Vdot is positive."""

    def bound(z: float, r: float) -> float:
        """What (3.57) leaves once the squares are completed, `Vdot <= bound`; |Z| takes its worst place."""
        return -z * (k1 * z - D1) - r * (k2 * r - D2)

    bz = D1 / k1
    step = D2**2 / (8 * k2 * (D1 + k1))  # small beside what r can add
    assert bound(bz + min(step, 1.0), D2 / (2 * k2)) > 0
    half_width = D1 / (2 * k1) + np.sqrt(D1**2 / (4 * k1**2) + D2**2 / (4 * k1 * k2))
    worst = max(bound(half_width, r) for r in np.linspace(0, 2 * D2 / k2, 2001))
    assert worst == pytest.approx(0, abs=1e-9 * (D1 + D2) * (bz + D2 / k2)) and half_width > bz


@given(st.floats(0.1, 1e3), st.floats(0.1, 1e3), st.floats(0.1, 50), st.floats(0.1, 50), st.floats(0.01, 5))
def test_v_may_grow_however_large_one_network_s_weights_are(
    k1: float, k2: float, D1: float, D2: float, kappa: float
) -> None:
    """The two braces of (3.57) with |Ztilde_1| a billion beyond its bound, |z| small enough: still positive."""
    far, r = 1e9, D2 / (2 * k2)
    z = 0.5 * D2**2 / (4 * k2) / (kappa * far**2 + k1 + D1)
    z = min(z, 1.0)
    assert -z * (k1 * z + kappa * far**2 - D1) - r * (k2 * r - D2) > 0


def test_fast_learning_destabilises_the_loop_of_chapter_4() -> None:
    """Gap (c): ex, velocity and Psi_hat with Psi_hatdot = L z, no friction; unstable from L = k^2 kx/(kx m - k) on."""
    robot = load("platform_arm")
    m, k, kx = float(Dynamics(robot).mass_matrix(robot.neutral_position())[0, 0]), 500.0, 10.0

    def growth(L: float) -> float:
        A = np.array([[0, -1, 0], [k * kx / m, -k / m, 1 / m], [L * kx, -L, 0]])
        return float(np.linalg.eigvals(A).real.max())

    limit = k**2 * kx / (kx * m - k)
    assert growth(0.99 * limit) < 0 < growth(1.01 * limit)
    assert limit == pytest.approx(3813, abs=1)
    assert limit / (22 / 4 / 0.002) == pytest.approx(1.4, abs=0.03)  # F1: 22 units, sigma' sigma = 22/4, every 2 ms


@given(st.floats(0.1, 200), st.floats(0.01, 500), st.floats(0.1, 100), st.floats(0.01, 10), st.floats(0, 50))
def test_the_gain_condition_does_not_keep_the_transient_in_sz(
    m: float, F: float, Z0: float, C0: float, D: float
) -> None:
    """A state of the sublevel set of V(0), z(0) = 0, that (3.64) allows and that lies outside of Sz."""
    z = Z0 / np.sqrt(F * m)  # where all that the weights are off at the start is kinetic energy
    assert 0.5 * m * z**2 == pytest.approx(Z0**2 / (2 * F))  # V there is V(0), with Ztilde = 0
    Sz = 0.5 * z  # (bx - qB) / (c0 + c2), which may be as small
    k1 = 2 * (C0 + D) / Sz  # (3.64) holds, with D for kappa C6^2 / 4
    assert (C0 + D) / k1 < Sz < z  # bz is inside, the transient need not be


def test_the_last_trace_of_3_55_is_of_the_second_network() -> None:
    """d/dt tr(V2t' G2^-1 V2t)/2 by the leakage of (3.49), by finite differences; V1 - V1t is another number."""
    rng = np.random.default_rng(0)
    V1, V1_hat, V2, V2_hat = rng.standard_normal((4, 5, 3))
    kappa, G, r, dt = 0.7, 0.3, 1.9, 1e-7
    after = V2_hat - dt * kappa * G * r * V2_hat
    rate = (((V2 - after) ** 2).sum() - ((V2 - V2_hat) ** 2).sum()) / (2 * G * dt)
    second = kappa * r * np.trace((V2 - V2_hat).T @ (V2 - (V2 - V2_hat)))
    printed = kappa * r * np.trace((V2 - V2_hat).T @ (V1 - (V1 - V1_hat)))
    assert rate == pytest.approx(second, rel=1e-5) and abs(printed - second) > 0.1


matrices = st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng(seed).normal(size=(2, 6, 3)))


@given(matrices, st.floats(0.1, 5))
def test_the_robust_term_needs_the_plus_of_3_50(pair: Array, C2: float) -> None:
    """(3.57) prints |Z_hat| - ZB; the step to the next line needs Kz (...) >= C2 |Z_tilde| for Kz > C2."""
    ideal, estimate = pair
    ZB, Kz = np.linalg.norm(ideal), 1.01 * C2
    needed = C2 * np.linalg.norm(ideal - estimate)
    assert Kz * (np.linalg.norm(estimate) + ZB) >= needed  # (3.50): by the triangle inequality
    start = np.zeros_like(estimate)  # zero initial weights
    assert Kz * (np.linalg.norm(start) - ZB) < 0 < C2 * np.linalg.norm(ideal - start)


def test_the_networks_input_is_not_bounded_by_z() -> None:
    """Gap (c), Lemma 3.4.1: states with z = 0 and any r or pose error, so no c1 + c2 |z| bounds x."""
    layout = Layout(2, 2, 7, 4)
    inputs, at = Inputs(), layout.offsets
    for size in (1e1, 1e3, 1e5):
        row = layout.new_row()
        row[layout.where("q_ref")] = size  # the arm is far away
        row[layout.where("pose_ref")] = size, 0.0, 0.0  # and so is the base
        row[layout.where("velocity")] = 10.0 * size, 0.0  # which drives as commanded: alpha = kx ex
        command(row, at, np.array([10.0, 64.0, 16.0]), np.full(2, 7.0), np.zeros(0), None)
        assert np.abs(row[layout.where("z")]).max() <= 1e-9 * size
        assert np.linalg.norm(row[inputs.rows(layout)]) > 10 * size
        assert row[at[INDEX["alpha"]]] == pytest.approx(10 * size)  # a feedback signal, not a bounded reference


def test_the_networks_input_grows_along_a_straight_line() -> None:
    """Gap (c), assumption 3.3.1: q_vd of a line has no bound qB; without it the input stays where it is."""
    times = np.array([10.0, 100.0, 1000.0])
    e = load_experiment("chapter4")
    layout = e.load_robot().dimensions
    positions = np.linalg.norm(e.trajectory(layout).table(times, layout)[:, :3], axis=1)
    np.testing.assert_allclose(positions, 0.3 * times)
    assert "pose_ref" in e.inputs.signals


@compiled_only
def test_without_the_position_the_one_layer_networks_arm_is_better_and_the_two_layer_networks_as_good() -> None:
    """Gap (c) over 5 s: q_vd out of the input, then Appendix B's short one."""
    rows = summaries(readings(load_experiment("chapter4"), "x"))
    rms = {row["reading"]: {name: row[name]["rms"] for name in ("two_layer", "one_layer")} for row in rows}
    for reading, falls in (("no absolute position", 0.1), ("Appendix B's short input", 0.25)):
        for key in ("pose_error.x", "pose_error.y", "pose_error.phi", "e.arm_1_joint", "e.arm_2_joint"):
            two, one = (rms[reading][name][key] / rms["as it is"][name][key] for name in ("two_layer", "one_layer"))
            assert abs(two - 1) < 0.03
            assert one < 1 - falls or not key.startswith("e.")


def test_a_discrete_update_can_grow_where_the_continuous_law_decays() -> None:
    """Gap (d): W <- (1 - kappa F |z|) W + ... with F = kappa = 1 grows once |z| > 2; Wdot = -|z| W decays."""
    for size, grows in ((0.5, False), (1.9, False), (2.1, True), (3.0, True)):
        W, V = np.full((4, 2), 1e6), np.zeros((3, 4))
        s, x, net, sigma = np.array([size, 0.0]), np.zeros(3), np.zeros(4), np.full(4, 0.5)
        two_layer_update(W, V, x, net, sigma, s, np.ones(3), 1.0)
        assert (np.abs(W).max() > 1e6) == grows
        slow = np.full((4, 2), 1e6)
        for _ in range(1000):  # the same law and the same second, in small steps
            two_layer_update(slow, V, x, np.zeros(4), sigma, s, np.ones(3), 1e-3)
        assert np.abs(slow).max() < 1e6


# -- Appendix B --------------------------------------------------------------------------------------------------------


class AppendixB:
    """`MM_MLPNN` line by line, with its globals as attributes and its slip; one network instead of two copies."""

    def __init__(self, F: float, G: float, k: float, W: Array, V: Array) -> None:
        self.F, self.G, self.k, self.W, self.V = F, G, k, W.copy(), V.copy()
        self.sigma = np.zeros(len(W))

    def __call__(self, x: Array, z: Array) -> Array:
        sigma_d = np.diag(self.sigma) @ (np.eye(self.sigma.size) - np.diag(self.sigma))
        W_d = self.F * np.outer(self.sigma, z) - self.F * np.outer(sigma_d @ self.V.T @ x, z)
        W_d = W_d - self.k * self.F * np.linalg.norm(z) * self.W
        V_d = self.G * np.outer(x, sigma_d.T @ self.W @ z) - self.k * self.G * np.linalg.norm(z) * self.V
        self.W, self.V = self.W + W_d, self.V + V_d  # no sample time
        self.sigma = expit(self.V.T @ x)
        return self.W.T @ self.sigma


@pytest.mark.parametrize("yaw_rate", [None, 5.0])
@pytest.mark.parametrize("initial", ["zero", "random"])
def test_the_switches_together_are_the_code_of_appendix_b(yaw_rate: float | None, initial: str) -> None:
    """Update first, with the hidden outputs of the previous call, rates per sample, `wd = (5)` or not."""
    wd = [] if yaw_rate is None else [f"inputs.constant_yaw_rate={yaw_rate}"]
    options = ["controllers=['two_layer']", "learning.update=before_output", f"two_layer.initial={initial}"]
    run = chapter4(*options, *wd)["two_layer"]
    u = np.hstack([run[name] for name in load_experiment("chapter4").inputs.signals])
    if yaw_rate is not None:
        u[:, 4] = yaw_rate
    first = {name: weights[0] for name, weights in run.weights.items() if name != "time"}
    assert run.weights["time"][0] == 0.0
    base, arm = (AppendixB(F, F, 1.0, first[f"W{i}"], first[f"V{i}"]) for i, F in ((1, 1.0), (2, 0.2)))
    tau = np.array([[*base(x, z), *arm(x, r)] for x, z, r in zip(u, run["z"], run["r"], strict=True)])
    np.testing.assert_allclose(tau, run["psi_hat"], rtol=1e-6, atol=1e-9)


def test_rates_per_sample_are_rates_per_second_times_the_sample_rate() -> None:
    """The update of Appendix B has no sample time in it: at 2 ms its F = 1 is 500 per second."""
    as_is = chapter4("controllers=['two_layer']")["two_layer"]
    second = ["learning.rates=per_second", "two_layer.F=[500.0, 100.0]", "two_layer.G=[500.0, 100.0]"]
    np.testing.assert_allclose(
        chapter4("controllers=['two_layer']", *second)["two_layer"]["psi_hat"], as_is["psi_hat"], rtol=1e-9
    )


@compiled_only
def test_rates_per_second_learn_nothing_that_shows() -> None:
    """Read as continuous-time rates, the printed rates leave PD at the same gain; per sample they do not."""
    options = ["controllers=['two_layer', 'pd_effective']", "learning.rates=per_second"]
    runs = chapter4(*options, seconds=5.0)
    for signal in ("pose_error", "e"):
        one, other = (np.sqrt(np.mean(runs[name][signal] ** 2, axis=0)) for name in ("two_layer", "pd_effective"))
        np.testing.assert_allclose(one, other, rtol=0.03)
    assert np.abs(runs["two_layer"]["psi_hat"]).max() < 0.02 * np.abs(runs["two_layer"]["torque"]).max()
    runs = chapter4(options[0], seconds=5.0)
    e = [np.sqrt(np.mean(runs[name]["e"][500:] ** 2, axis=0)) for name in ("two_layer", "pd_effective")]
    assert (e[0] < 0.2 * e[1]).all()


@compiled_only
def test_the_slip_wd_5_takes_most_of_the_one_layer_network_s_learning_away() -> None:
    runs = [chapter4("controllers=['one_layer']", *wd, seconds=5.0) for wd in ([], ["inputs.constant_yaw_rate=5"])]
    as_is, slip = (np.sqrt(np.mean(run["one_layer"]["e"][500:] ** 2, axis=0)) for run in runs)
    assert (slip > 2 * as_is).all()


@compiled_only
def test_the_order_of_appendix_b_changes_next_to_nothing() -> None:
    runs = [chapter4("controllers=['two_layer']", f"learning.update={order}_output", seconds=5.0)["two_layer"]
            for order in ("before", "after")]  # fmt: skip
    for signal in ("pose_error", "e"):
        one, other = (np.sqrt(np.mean(run[signal] ** 2, axis=0)) for run in runs)
        np.testing.assert_allclose(one, other, rtol=0.02)
    assert not np.array_equal(runs[0]["e"], runs[1]["e"])


def test_zero_initial_weights_make_one_hidden_unit_of_22() -> None:
    run = chapter4("controllers=['two_layer']", "two_layer.initial=zero")["two_layer"]
    for i in (1, 2):
        W, V = run.weights[f"W{i}"][-1], run.weights[f"V{i}"][-1]
        assert (
            np.abs(W).max() > 0 and not np.ptp(W, axis=0).any() and not np.ptp(V, axis=1).any()
        )  # all units equal, to the bit
        assert numerical_rank(W) == numerical_rank(V) == 1


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_equal_units_stay_equal_whatever_comes(seed: int) -> None:
    """The proof in one step: equal rows of W and equal columns of V stay so under (3.48) for any x and z."""
    rng = np.random.default_rng(seed)
    W, V = np.tile(rng.normal(size=2), (5, 1)), np.tile(rng.normal(size=(4, 1)), (1, 5))
    x, s = rng.normal(size=4), rng.normal(size=2)
    net = V.T @ x
    two_layer_update(W, V, x, net.copy(), expit(net), s, np.array([1.0, 1.0, 0.5]), 1.0)
    np.testing.assert_allclose(W - W[0], 0, atol=1e-14)
    np.testing.assert_allclose(V - V[:, :1], 0, atol=1e-14)


# -- chapter 5 ---------------------------------------------------------------------------------------------------------


def chapter5(*overrides: str, seconds: float = 1.0) -> dict[str, Recording]:
    return run_experiment(load_experiment("chapter5", [f"time.duration={seconds}", *overrides]), "x").recordings


def hidden_outputs(run: Recording, scale: float) -> Array:
    """Outputs of the arm's hidden units, (snapshots, hidden), at every record of the weights after 0.2 s."""
    times, V = run.weights["time"], run.weights["V2"]
    kept = (times > 0.2) & (times < run.time[-1])
    x = np.hstack([run[name] for name in ("e", "edot", "q_ref", "qdot_ref", "qddot_ref")])
    return expit(np.einsum("ki,kih->kh", scale * x[np.rint(times[kept] / 0.005).astype(int)], V[kept]))


@compiled_only
@pytest.mark.parametrize("initial", ["zero", "random"])
def test_inputs_in_degrees_saturate_every_hidden_unit(initial: str) -> None:
    name, often, degrees = f"two_layer_{initial}", "weights_interval=0.02", 180 / np.pi
    run = chapter5(f"controllers=['{name}']", often, seconds=4.0)[name]
    ends = hidden_outputs(run, degrees)
    assert np.mean((ends < 0.01) | (ends > 0.99)) > 0.99
    radians = ("inputs.scale=1.0", "inputs.error_scale=1.0")
    middle = hidden_outputs(chapter5(f"controllers=['{name}']", often, *radians, seconds=4.0)[name], 1.0)
    assert np.mean((middle > 0.01) & (middle < 0.99)) > 0.9


@compiled_only
def test_the_leakage_of_chapter_4_loses_the_one_layer_network_of_chapter_5() -> None:
    for mu, kept in ((0.35, False), (0.01, True)):
        run = chapter5("controllers=['one_layer']", f"one_layer.mu={mu}")["one_layer"]
        assert (run.outcome.status == "completed") == kept


@compiled_only
def test_the_largest_error_of_one_run_depends_on_where_it_starts() -> None:
    peaks: dict[str, list[Array]] = {"two_layer_zero": [], "pd": []}
    for k in range(6):  # starts up to 0.1 deg beside the reference
        start = f"start.joint_offset={np.radians(0.1) * np.sin(k)}"
        for name, run in chapter5("controllers=['two_layer_zero', 'pd']", start, seconds=8.0).items():
            peaks[name].append(np.abs(run["e"]).max(axis=0))
    spread = {name: (np.max(found, axis=0) / np.min(found, axis=0) - 1).max() for name, found in peaks.items()}
    assert spread["two_layer_zero"] > 0.05 and spread["pd"] < 0.02


# -- the document ------------------------------------------------------------------------------------------------------


def test_the_document_names_every_test_here_and_no_other() -> None:
    tests = re.findall(r"^def (test_\w+)\(", HERE.read_text(), re.M)
    here = {name for name in tests if "_the_document_" not in name}
    assert set(re.findall(r"`(test_\w+)`", DOCUMENT.read_text())) == here


def test_the_document_has_a_test_for_every_entry() -> None:
    entries = re.split(r"^### ", DOCUMENT.read_text(), flags=re.M)[1:]
    assert len(entries) >= 10
    assert [entry.splitlines()[0] for entry in entries if "`test_" not in entry] == []
