"""Linear learners: features against numpy, weights against batch least squares, bounds, guarantees, closed loops."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import numpy as np
import pytest
from builders import first_of
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import assert_engines_agree, assert_it_resumes
from robots import fixed_arm, mobile_arm
from scipy.signal import lfilter

from mmnn_pin import Circle, Eight, Feedback, Hold, Loop, Sine, Stepper, Timing, Trajectory, load, load_experiment
from mmnn_pin.disturbance import Payload
from mmnn_pin.errors import ConfigError
from mmnn_pin.lab.experiments.controllers import Granted, Nominal, machine_of
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.sample import Torque
from mmnn_pin.model.base.overrides import Overrides
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.robots import extra
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.safety import Safety
from mmnn_pin.sensing import Sensor
from mmnn_pin.signals import INDEX, Layout, Measurement, Setpoint
from mmnn_pin.torque.controller import Context
from mmnn_pin.torque.entries import CONTROLLERS
from mmnn_pin.torque.factored import measure
from mmnn_pin.torque.kalman import Kalman, factors
from mmnn_pin.torque.kalman_settings import (
    KalmanBilinearSettings,
    KalmanFeaturesSettings,
    KalmanFrictionSettings,
    KalmanRegressorSettings,
    KalmanResidualSettings,
)
from mmnn_pin.torque.law import limit, motor_limits
from mmnn_pin.torque.linear import Parts, estimate, project, track
from mmnn_pin.torque.model_based import ComputedTorque
from mmnn_pin.torque.prior import identified
from mmnn_pin.torque.random_features import coprime

PLAIN = os.environ.get("NUMBA_DISABLE_JIT") == "1"  # plain Python: short runs only
LONG = pytest.mark.skipif(PLAIN, reason="needs a long run")
ROBOT = load("platform_arm").with_friction((30.0, 5.0, 0.5, 0.5)).with_joint_friction(coulomb=0.5)
NOMINAL = load("platform_arm").with_masses(0.7)
REGRESSOR, TRUE, THETA0 = Regressor.of(ROBOT), parameters(ROBOT), parameters(NOMINAL)
LAYOUT, K = Layout.of(ROBOT.dimensions), Feedback(500.0, 30.0)
GAINS = K.vector(LAYOUT)
KINDS = {
    "regressor": KalmanRegressorSettings,
    "bilinear": KalmanBilinearSettings,
    "features": KalmanFeaturesSettings,
    "residual": KalmanResidualSettings,
}
SMALL = {"bilinear": {"hidden": 4}, "residual": {"hidden": 4}, "features": {"hidden": 12}, "regressor": {}}
NOISY = Sensor(noise=1e-4, velocity_noise=2e-3, pose_noise=(1e-4, 1e-4, 1e-4))
kinds, seeds = st.sampled_from(sorted(KINDS)), st.integers(0, 2**32 - 1)
LIMITS = motor_limits(ROBOT.E, ROBOT.effort_limits)


def learner(kind, learning=True, **own):
    regressor = REGRESSOR if kind in ("regressor", "residual") else None
    theta0 = THETA0 if kind == "residual" else None
    return Kalman(KINDS[kind](**own), machine_of(ROBOT), K, regressor, theta0, learning)


def small(kind, **own):
    return learner(kind, **(SMALL[kind] | own))


def loop_of(controller, duration=4.0, base=None, arm=None, robot=ROBOT, **more):
    base = base or Eight(length=1.5, width=0.75, period=12.0, ramp=1.0)
    arm = arm or (Sine(0.785, 4.0, 0.0, np.pi / 2), Sine(0.785, 3.0, 0.0, 0.3))
    timing = Timing(0.02 if PLAIN else duration, 0.002, 0.002, integrator="implicit_friction")
    more = {"start": Start((-0.01, 0.0, 0.0)), "sensor": NOISY} | more
    return Loop(robot, Trajectory(base=base, arm=arm), controller, timing=timing, **more)


class Bench:
    """A learner alone: rows go in."""

    def __init__(self, kind, h=1e-2, **own):
        self.controller = small(kind, **own)
        context = Context(LAYOUT, h, 10, np.random.default_rng(3))
        self.a, self.state = self.controller.law(context).learner, self.controller.init(context)
        (self.rows, self.k, self.m), self.h = self.controller.shape, h
        self.o = self.state.view(Parts)
        self.row, self.P0 = LAYOUT.new_row(), np.diag(self.state["prior"])

    def random_covariance(self, rng):
        """Replace P by a random one of the prior's size."""
        scale = np.sqrt(self.state["prior"])
        self.state["U"] = 0.3 * rng.standard_normal((self.k, self.k)) * scale / np.where(scale > 0, scale, 1)[:, None]
        self.state["D"] = self.state["prior"] * rng.uniform(0.1, 1.0, self.k)

    @property
    def P(self):
        upper = np.eye(self.k) + np.tril(self.state["U"], -1).T
        return upper @ np.diag(self.state["D"]) @ upper.T

    def fill(self, rng, size=1.0):
        """Random signals into the row."""
        for name in ("time", "pose", "velocity", "q", "qdot", "z", "r", "nu_ref", "nudot_ref", "torque"):
            self.row[LAYOUT.where(name)] = size * rng.standard_normal(self.row[LAYOUT.where(name)].size)

    def step(self):
        estimate(self.row, LAYOUT.offsets, self.a, self.state.values)
        return self.row[LAYOUT.where("psi_hat")].copy()


# --- features, independently


def bilinear(state, q, nu, nu_ref, nudot_ref, eps=0.03):
    """All pairs of a random function and a term, by an outer product; in which order they stand is found by value."""
    g = np.tanh(state["a"] @ q + state["b"])
    sym = np.outer(nu, nu_ref)
    t = np.concatenate((nudot_ref, ((sym + sym.T) / 2)[np.triu_indices(4)], [1.0]))
    return t, np.outer(g, t).ravel(), np.concatenate((nu, np.tanh(nu / eps)))


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_bilinear_features_are_all_pairs_of_functions_and_terms(seed):
    rng, bench = np.random.default_rng(seed), Bench("bilinear")
    bench.fill(rng)
    phi = stated(bench)
    q, nu, nu_ref, nudot_ref = state(bench.row)
    t, pairs, friction = bilinear(bench.state, q, nu, nu_ref, nudot_ref)
    np.testing.assert_allclose(phi[:15], t, atol=1e-12)
    np.testing.assert_allclose(np.sort(phi[15:-8]), np.sort(pairs), atol=1e-12)
    np.testing.assert_allclose(phi[-8:], friction, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_generic_features_see_everything_and_know_nothing(seed):
    rng, bench = np.random.default_rng(seed), Bench("features")
    bench.fill(rng)
    phi = stated(bench)
    q, nu, nu_ref, nudot_ref = state(bench.row)
    x = np.concatenate((q, nu / 3, nu_ref / 3, nudot_ref / 20))
    np.testing.assert_allclose(phi[:9], [*nudot_ref, *nu_ref, 1.0], atol=1e-12)
    np.testing.assert_allclose(phi[9:21], np.tanh(bench.state["a"] @ x + bench.state["b"]), atol=1e-12)
    np.testing.assert_allclose(phi[21:], [*nu, *np.tanh(nu / 0.03)], atol=1e-12)


def state(row):
    parts = {name: row[LAYOUT.where(name)] for name in ("velocity", "q", "qdot", "nu_ref", "nudot_ref")}
    return parts["q"], np.hstack((parts["velocity"], parts["qdot"])), parts["nu_ref"], parts["nudot_ref"]


def stated(bench):
    """Features at the row, by letting a frozen learner look at it."""
    bench.a = bench.a._replace(learning=False)
    bench.step()
    return bench.a.Phi[0].copy()


@pytest.mark.parametrize("kind", ["bilinear", "features", "residual"])
def test_no_feature_sees_where_the_base_stands(kind):
    bench, rng = Bench(kind), np.random.default_rng(0)
    bench.fill(rng)
    before = stated(bench)
    bench.row[LAYOUT.where("pose")] += 3.0
    np.testing.assert_array_equal(stated(bench), before)


@given(st.integers(1, 60), st.integers(1, 80))
def test_pairs_do_not_repeat(units, terms):
    found = coprime(units, terms)
    assert units <= found and len({(c % found, c % terms) for c in range(found * terms)}) == found * terms


@pytest.mark.compiled
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_the_prior_is_what_its_docstring_says(kind):
    """Mean variance of Psi / K over random motion: prior^2, where gravity has no more than its part of it."""
    bench = Bench(kind, prior=2.0, **({} if kind == "regressor" else {"gravity": 0.0}))
    Phi = bench.controller.typical(bench.state)
    scaled = Phi / GAINS[:, None] if bench.m == 1 else Phi
    assert np.einsum("nik,k,nik->", scaled, bench.state["prior"], scaled) / (len(Phi) * bench.rows) == pytest.approx(4)
    np.testing.assert_allclose(bench.a.radius, 3 * np.sqrt(bench.k) * (1 if bench.m == 1 else GAINS))
    np.testing.assert_allclose(bench.controller.unknown(bench.state), 1.0)
    bench.state["D"] *= 0.25
    np.testing.assert_allclose(bench.controller.unknown(bench.state), 0.25)


@pytest.mark.parametrize("kind", ["bilinear", "features", "residual"])
def test_gravity_may_be_a_share_of_what_the_motors_give(kind):
    """Variance of what stands there at rest, by features of a robot at rest that turns to all sides."""
    plain, wide = Bench(kind, gravity=0.0), Bench(kind, gravity=3.0)
    strength = np.median(machine_of(ROBOT).effort[-2:] / GAINS[-2:])
    Phi = wide.controller.typical(wide.state)[:, 0]
    changed = wide.state["prior"] != plain.state["prior"]
    np.testing.assert_allclose(np.mean(Phi[:, changed] ** 2 @ wide.state["prior"][changed]), (3.0 * strength) ** 2)
    for i in np.flatnonzero(changed):  # the constant, or what is a function that does not go away at rest
        moving = wide.row.copy()
        for name in ("velocity", "qdot", "nu_ref", "nudot_ref"):
            wide.row[LAYOUT.where(name)] = 0.0
        assert stated(wide)[i] != 0.0
        wide.row[:] = moving


def test_a_robot_with_many_joints_gets_no_more_features_than_allowed():
    velocities = tuple(f"v{i}" for i in range(12))
    machine = machine_of(ROBOT)._replace(velocities=velocities, lower=np.full(10, -1.0), upper=np.ones(10))
    rows, k, m = Kalman(KalmanBilinearSettings(largest=100), machine, K).shape
    assert (rows, k, m) == (1, (12 + 78 + 1) + 100 + 24, 12)


# --- the law


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_learning_from_a_run_is_batch_least_squares(kind):
    """Means, filters, features and Kalman gain against one ridge regression over the recorded signals, by scipy."""
    own = {"tracking": 0.0, "drift": 0.0, "state_pole": 40.0, "interval": 0.004, "bound": 1e3}
    controller = small(kind, **own)
    loop = loop_of(controller, 0.6)
    run = loop.run()
    state = controller.init(loop.context())
    prior = state["prior"].copy()
    state.values[:] = run.final["controller_state"]
    h, (rows, k, m) = 0.002, controller.shape
    q, nu = np.array(run["q"]), np.hstack((run["velocity"], run["qdot"]))
    q, nu, nudot, tau = means(q, nu, np.array(run["torque"])[:-1], h, 40.0)
    Phi = np.zeros((len(q), rows, k))
    for i in range(len(q)):
        if kind == "regressor":
            Phi[i] = regressor_at(q[i], nu[i], nudot[i])
        else:
            Phi[i, 0] = phi_at(controller, state, q[i], nu[i], nudot[i])
        if kind == "residual":
            tau[i] -= regressor_at(q[i], nu[i], nudot[i]) @ THETA0
    wait = int(np.ceil(5 / (40.0 * h)))
    e = np.exp(-5.0 * h)
    Phi_f, Y_f = (lfilter([1 - e], [1, -e], x[wait:], axis=0) for x in (Phi, tau))
    taken = slice((-wait - 1) % 2, None, 2)  # sample i + 1 ends period i; every second sample, from 0 on
    A, Y = Phi_f[taken], Y_f[taken]
    used = prior > 0
    if m == 1:
        A, Y = (A / GAINS[:, None]).reshape(-1, k), (Y / GAINS).reshape(-1, 1)
    else:
        A = A[:, 0]
    A, noise = A[:, used] * np.sqrt(prior[used]), controller.settings.noise
    H = A.T @ A / noise**2 + np.eye(used.sum())
    W = np.sqrt(prior[used])[:, None] * np.linalg.solve(H, A.T @ Y / noise**2)
    if PLAIN:
        return
    scale = np.sqrt(prior[used])[:, None] * (1 if m == 1 else GAINS)
    np.testing.assert_allclose(state["W"][:, used].T / scale, W / scale, atol=1e-7)
    U = np.eye(k) + np.tril(state["U"], -1).T
    P = (U @ np.diag(state["D"]) @ U.T)[np.ix_(used, used)] / np.sqrt(np.outer(prior[used], prior[used]))
    np.testing.assert_allclose(P, np.linalg.inv(H), atol=1e-7)


def means(q, nu, tau, h, pole):
    """Means over every period of what passed a first-order low-pass, states straight in between, torque held."""
    e = np.exp(-pole * h)
    x = np.hstack((q, nu))
    fresh = 1 - (1 - e) / (pole * h)
    driven = (1 - e) * x[:-1] + fresh * np.diff(x, axis=0)
    smooth = np.vstack((x[:1], lfilter([1], [1, -e], driven, axis=0, zi=e * x[:1])[0]))
    mean = (x[1:] + x[:-1]) / 2 - np.diff(smooth, axis=0) / (pole * h)
    drive = np.vstack((np.zeros((1, tau.shape[1])), lfilter([1 - e], [1, -e], tau, axis=0)))
    n = q.shape[1]
    return mean[:, :n], mean[:, n:], np.diff(smooth, axis=0)[:, n:] / h, tau - np.diff(drive, axis=0) / (pole * h)


def regressor_at(q, nu, nudot):
    position = ROBOT.neutral_position()
    position[ROBOT.arm_index] = q
    return REGRESSOR.matrix(ROBOT.follow(position), nu, nu, nudot)


def phi_at(controller, state, q, nu, nudot):
    """Random features in the learner's order, by numpy."""
    if isinstance(controller.settings, KalmanFeaturesSettings):
        x = np.concatenate((q, nu / 3, nu / 3, nudot / 20))
        g = np.tanh(state["a"] @ x + state["b"])
        return np.concatenate((nudot, nu, [1.0], g, nu, np.tanh(nu / 0.03)))
    g = np.tanh(state["a"] @ q + state["b"])
    products = [nu[i] * nu[j] for i in range(4) for j in range(i, 4)]
    t = np.concatenate((nudot, products, [1.0]))
    pairs = [g[c % g.size] * t[c % t.size] for c in range(g.size * t.size)]
    return np.concatenate((t, pairs, nu, np.tanh(nu / 0.03)))


@pytest.mark.parametrize("nudge", [0.0, 1.0])
def test_a_nominal_model_is_pinocchios(nudge):
    """Before it has learned, `kalman_residual` says Psi of the nominal robot."""
    bench, rng = Bench("residual"), np.random.default_rng(2)
    bench.a = bench.a._replace(learning=False)
    for _ in range(5):
        bench.fill(rng)
        bench.state["W"][:, 14] = nudge  # the weight of 1
        q, nu, nu_ref, nudot_ref = state(bench.row)
        position = NOMINAL.neutral_position()
        position[NOMINAL.arm_index] = q
        expected = Dynamics(NOMINAL).psi(NOMINAL.follow(position), nu, nu_ref, nudot_ref) + nudge
        np.testing.assert_allclose(bench.step(), expected, rtol=1e-10, atol=1e-8)


def half_a_second(at_once, **own):
    """A learner after 0.5 s of signals that stand still, with updates every 10 ms or, after an alarm, every 2 ms."""
    own = {"alarm": 3.0, "drift": 0.0, "change": 1e-9, "correction": 0.0, "noise": 1e6, "bound": 1e9} | own
    controller = Kalman(KalmanFrictionSettings(**own), machine_of(ROBOT), K, REGRESSOR)
    context = Context(LAYOUT, 0.002, 10, np.random.default_rng(3))
    state, a = controller.init(context), controller.law(context).learner
    bench, row = Bench("regressor"), LAYOUT.new_row()
    bench.fill(np.random.default_rng(5))
    row[:] = bench.row
    state["D"] = 0.5 * state["prior"]
    for n in range(251):
        row[LAYOUT.where("time")] = 0.002 * n
        if at_once:
            state["counts"][4:6] = 0.0, 1000.0
        estimate(row, LAYOUT.offsets, a, state.values)
    assert state["counts"][1] > 200 if at_once else state["counts"][1] < 51
    return controller, state


@pytest.mark.compiled
def test_an_update_counts_the_time_since_the_last_one():
    """Just after an alarm there are five times as many; what they answer s with, and what they forget, is the same."""
    (_, slow), (_, fast) = half_a_second(False, tracking=0.01), half_a_second(True, tracking=0.01)
    np.testing.assert_allclose(fast["W"], slow["W"], rtol=1e-6)
    assert np.abs(slow["W"]).max() > 0.0
    for forgets, part in (({"drift": 0.2}, slice(None)), ({"change": 0.2}, slice(-4, None))):
        gained = []
        for at_once in (False, True):
            controller, state = half_a_second(at_once, tracking=0.0, **forgets)
            prior, U = state["prior"], np.eye(controller.shape[1]) + np.tril(state["U"], -1).T
            used = prior > 0
            back = np.zeros(len(prior))
            back[used] = np.diag((U * state["D"]) @ U.T)[used] / prior[used] - 0.5
            gained.append(back[part].sum())
        assert gained[1] == pytest.approx(gained[0], rel=0.25) and gained[0] > 0.05  # places that do not matter gain 0


@pytest.mark.parametrize("late", [0.0, 0.3])
def test_after_a_gap_in_time_an_alarm_is_forgotten(late):
    """The robot may be another one: a change is neither told again, nor learned from at every sample."""
    controller, state = half_a_second(False)
    row, a = LAYOUT.new_row(), controller.law(Context(LAYOUT, 0.002, 10)).learner
    row[LAYOUT.where("time")] = 0.002 * 251 + late
    state["counts"][3:6] = 1.0, 2000.0, 100.0
    estimate(row, LAYOUT.offsets, a, state.values)
    assert state["counts"][3:6].tolist() == ([0.0, 0.0, 0.0] if late else [0.0, 2001.0, 99.0])


def test_equations_say_as_much_in_a_second_however_often_they_are_asked():
    """(P^-1)' = Phi_f' R^-1 Phi_f, R of the time since the last update."""
    found = [half_a_second(at_once, tracking=0.0, noise=0.2)[1]["D"] for at_once in (False, True)]
    used = found[0] > 0
    np.testing.assert_allclose(np.log(found[1][used]).sum(), np.log(found[0][used]).sum(), atol=0.1)
    assert np.log(found[0][used] / half_a_second(False)[1]["D"][used]).sum() < -5.0


@pytest.mark.compiled
@settings(max_examples=20, deadline=None)
@given(seeds, kinds)
def test_what_the_weights_lose_by_tracking_is_the_work_of_their_error(seed, kind):
    """d/dt of sum_i W~_i' P^-1 W~_i / (2 tau_i) = -s' Phi W~, so that V' = -s' K s."""
    rng = np.random.default_rng(seed)
    bench = Bench(kind, h=1e-7, interval=1e-7, bound=1e6)
    bench.random_covariance(rng)
    bench.fill(rng)
    bench.a = bench.a._replace(share=1e9)
    used = bench.state["prior"] > 0
    scale = np.sqrt(bench.state["prior"])
    truth = scale * rng.standard_normal((bench.m, bench.k)) * (1 if bench.m == 1 else GAINS[:, None])
    inverse = np.linalg.inv(bench.P[np.ix_(used, used)])

    def distance():
        error = (truth - bench.state["W"])[:, used]
        return float(np.einsum("mk,kl,ml,m->", error, inverse, error, 0.5 / bench.a.answer))

    before, W = distance(), bench.state["W"].copy()
    bench.step()
    s = np.concatenate((bench.row[LAYOUT.where("z")], bench.row[LAYOUT.where("r")]))
    Phi = bench.a.Phi
    work = s @ (Phi @ (truth - W)[0]) if bench.m == 1 else s @ ((truth - W) @ Phi[0])
    assert (distance() - before) / bench.h == pytest.approx(-work, rel=1e-3, abs=1e-3 * abs(before))


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_an_update_answers_at_most_its_share_of_the_feedback(kind):
    rng, bench = np.random.default_rng(1), Bench(kind, tracking=1e6, bound=1e9)
    bench.a = bench.a._replace(learning=False)
    bench.fill(rng)
    before = bench.step()
    bench.state["counts"][6] = 1.0
    track(bench.row, LAYOUT.offsets, bench.a, bench.o)
    s = np.concatenate((bench.row[LAYOUT.where("z")], bench.row[LAYOUT.where("r")]))
    assert s @ (bench.step() - before) == pytest.approx(0.2 * s @ (GAINS * s), rel=1e-6)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_s_is_answered_at_the_rate_that_is_set(kind):
    """Psi_hat moves by `tracking interval K s` times what the prior says of this motion, over prior^2."""
    rng, bench = np.random.default_rng(4), Bench(kind, tracking=0.3, prior=2.0, bound=1e9)
    bench.a = bench.a._replace(learning=False, share=1e9)
    bench.fill(rng)
    before = bench.step()
    bench.state["counts"][6] = 1.0
    track(bench.row, LAYOUT.offsets, bench.a, bench.o)
    s = np.concatenate((bench.row[LAYOUT.where("z")], bench.row[LAYOUT.where("r")]))
    answer = bench.a.Phi @ bench.P0 @ bench.a.Phi.T / 2.0**2
    expected = answer @ s / GAINS.max() if bench.m == 1 else answer[0, 0] * GAINS * s
    np.testing.assert_allclose(bench.step() - before, 0.3 * bench.h * expected, rtol=1e-6)


@pytest.mark.compiled
@settings(max_examples=40, deadline=None)
@given(seeds, kinds, st.floats(1.01, 1e3))
def test_the_projection_comes_closer_to_every_point_of_the_ball(seed, kind, beyond):
    """In the metric P^-1, for the half-space; with what is scaled back after it, W is in the ball."""
    rng, bench = np.random.default_rng(seed), Bench(kind, bound=1.0)
    bench.random_covariance(rng)
    used, scale = bench.state["prior"] > 0, np.sqrt(bench.state["prior"])
    radius = bench.a.radius[:, None]

    def random(size):
        direction = rng.standard_normal((bench.m, bench.k)) * used
        return size * radius * scale * direction / np.linalg.norm(direction, axis=1, keepdims=True)

    W, inside = random(beyond), random(1.0)
    bench.state["W"] = W
    project(bench.a, bench.o)
    after = bench.state["W"][:, used] / scale[used]
    assert (np.linalg.norm(after, axis=1) <= bench.a.radius * (1 + 1e-9)).all()
    inverse = np.linalg.inv(bench.P[np.ix_(used, used)])
    n = (W / np.where(used, scale, 1) ** 2)[:, used]
    for c in range(bench.m):  # the half-space alone, by its closed form
        w, x = W[c, used], inside[c, used]
        Pn = bench.P[np.ix_(used, used)] @ n[c]
        size = np.sqrt(n[c] @ w)
        back = w - Pn * (size**2 - bench.a.radius[c] * size) / (n[c] @ Pn)
        assert (x - back) @ inverse @ (x - back) <= (x - w) @ inverse @ (x - w) * (1 + 1e-9)
        length = np.linalg.norm(back / scale[used])
        expected = back * min(1.0, bench.a.radius[c] / length)
        np.testing.assert_allclose(bench.state["W"][c, used], expected, atol=1e-7 * np.abs(w).max())


@pytest.mark.compiled
@settings(max_examples=40, deadline=None)
@given(seeds, kinds, st.sampled_from([1e-300, 1e-3, 1.0, 1e3, 1e8, 1e100, 1e300, np.inf, np.nan]), st.data())
def test_everything_stays_bounded_whatever_comes(seed, kind, size, data):
    rng, bench = np.random.default_rng(seed), Bench(kind, interval=0.01, state_pole=0.0, drift=0.1)
    trace = bench.state["prior"].sum()
    which = data.draw(st.sampled_from(["velocity", "q", "qdot", "nu_ref", "nudot_ref", "z", "r", "torque"]))
    for i in range(12):
        bench.fill(rng)
        bench.row[0] = i * bench.h
        if i % 3 != 2:
            bench.row[LAYOUT.where(which)] *= size
        state = bench.state["held"]
        state[:] = bench.row[LAYOUT.where("torque")]
        psi_hat = bench.step()
        feedback = GAINS * np.concatenate((bench.row[LAYOUT.where("z")], bench.row[LAYOUT.where("r")]))
        limit(psi_hat, feedback, LIMITS)
        assert np.isfinite(psi_hat).all() or not np.isfinite(bench.row).all() or size >= 1e100
        motors, fed = np.abs(LIMITS.E_inv @ psi_hat), LIMITS.E_inv @ feedback
        assert np.isnan(psi_hat).any() or (motors <= ROBOT.effort_limits * (1 + 1e-9)).all()
        if np.isfinite(psi_hat).all() and np.nan_to_num(np.abs(fed), nan=np.inf).max() < 1e9:
            both = np.abs(LIMITS.E_inv @ (psi_hat + feedback))
            assert (both <= np.maximum(ROBOT.effort_limits, np.abs(fed)) * (1 + 1e-6)).all()
        W, used = bench.state["W"], bench.state["prior"] > 0
        norms = np.linalg.norm(W[:, used] / np.sqrt(bench.state["prior"][used]), axis=1)
        assert (norms <= bench.a.radius * (1 + 1e-9)).all()
        assert (bench.state["D"] >= 0).all() and (bench.state["D"][used] > 0).all()
        P = bench.P
        assert np.trace(P) <= trace * (1 + 1e-9) and (np.diag(P) <= bench.state["prior"] * (1 + 1e-9)).all()
        assert np.isfinite(P).all()
    assert np.isfinite(bench.state.values[: -sum(part.size for part in bench.o.filtered)]).all()


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize("signal", ["z", "r", "nu_ref", "nudot_ref"])
def test_a_sample_that_is_no_number_teaches_nothing(kind, signal):
    bench, rng = Bench(kind), np.random.default_rng(5)
    bench.fill(rng)
    bench.step()
    before = bench.state["W"].copy()
    assert np.abs(before).max() > 0
    bench.row[LAYOUT.where(signal)] = np.nan
    bench.row[0] = 7.0  # no period either
    bench.step()
    np.testing.assert_array_equal(bench.state["W"], before)


# --- in closed loops


@pytest.mark.compiled
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_both_engines_and_a_batch_agree(kind):
    assert_engines_agree(loop_of(small(kind), 0.2))


@pytest.mark.compiled
@pytest.mark.parametrize("safety", [None, Safety(torque=(60.0, 60.0, 30.0, 5.0))])
@pytest.mark.parametrize("kind", ["regressor", "features"])
def test_a_resumed_run_equals_the_uninterrupted_one(kind, safety):
    loop = loop_of(small(kind, interval=0.006), 0.3, safety=safety)
    assert_it_resumes(loop, loop.timing.duration / 2)


def test_a_warm_start_elsewhere_takes_no_period_over_the_gap():
    controller = small("features")
    first = loop_of(controller, 0.1).run()
    loop = loop_of(controller, 0.004)
    state = controller.init(loop.context())
    state.values[:] = first.final["controller_state"]
    again = loop.run(state=state)
    state.values[:] = again.final["controller_state"]
    assert state["clock"][1] == round(loop.timing.duration / 0.002)


@pytest.mark.compiled
def test_frozen_weights_stay_and_features_come_from_the_memory():
    controller = small("bilinear")
    learned = loop_of(controller, 0.3, seed=1)
    state = controller.init(learned.context())
    state.values[:] = learned.run().final["controller_state"]
    frozen = loop_of(replace(controller, learning=False), 0.1, seed=2).run(state=state)
    after = controller.init(learned.context())
    after.values[:] = frozen.final["controller_state"]
    for part in ("W", "U", "D", "a", "b", "counts"):
        np.testing.assert_array_equal(after[part], state[part])
    assert "excited" not in frozen.outcome.message
    np.testing.assert_array_equal(frozen.weights["W"][0], state["W"])


@LONG
def test_the_filter_sees_the_torque_that_the_supervisor_let_through():
    """A supervisor that clips nearly everything: what was learned still fits the truth, not what was asked for."""
    safety = Safety(torque=(6.0, 6.0, 20.0, 4.0), torque_time=60.0)
    run = loop_of(learner("regressor"), 6.0, safety=safety, sensor=Sensor()).run()
    asked = np.abs(run["torque"] - run["psi_hat"] - GAINS * np.hstack((run["z"], run["r"]))).max()
    assert run.outcome.status == "completed" and asked > 5.0
    late = np.asarray(run.time) > 3.0
    error = (run["psi"] - run["psi_hat"])[late]
    assert (np.abs(error).max(axis=0) < 0.1 * np.abs(run["psi"][late]).max(axis=0)).all()


def unexplained(controller, loop, memory_values, held):
    """Frozen FVU, mean of the components, along a run under computed torque."""
    state = controller.init(loop.context())
    state.values[:] = memory_values
    row = LAYOUT.new_row()
    torque = Torque(replace(controller, learning=False), loop.context(), row, ROBOT, state)
    said = np.zeros_like(held["psi"])
    names = [n for n in ("pose", "velocity", "q", "qdot", "z", "r", "nu_ref", "nudot_ref") if n in INDEX]
    for k in range(len(said)):
        for name in names:
            row[LAYOUT.where(name)] = held[name][k]
        torque.answer(0.0)
        said[k] = row[LAYOUT.where("psi_hat")]
    psi = np.asarray(held["psi"])[250:]
    return float((((psi - said[250:]) ** 2).sum(0) / ((psi - psi.mean(0)) ** 2).sum(0)).mean())


def late_rms(run, after):
    errors = np.hstack((run["true_pose_error"], run["true_e"]))[np.asarray(run.time) > after]
    return np.sqrt(np.mean(errors**2, axis=0))


@pytest.fixture(scope="module")
def held_out():
    arm = (Sine(0.785, 3.1, 0.0, 0.7), Sine(0.785, 2.3, 0.0, 2.3))
    base = Eight(length=1.4, width=0.8, period=8.5, ramp=1.0)
    return loop_of(ComputedTorque(K), 9.0, base, arm, sensor=Sensor()).run()


@LONG
@pytest.mark.parametrize(
    ("kind", "fvu", "times"),
    [("regressor", 1e-3, 1.5), ("bilinear", 0.3, 3.0), ("features", 0.2, 3.0), ("residual", 0.1, 1.5)],
)
def test_each_learns_the_model_and_tracks_nearly_like_the_oracle(kind, fvu, times, held_out):
    controller = learner(kind)
    loop = loop_of(controller, 24.0)
    run, oracle = loop.run(), loop_of(ComputedTorque(K), 24.0).run()
    assert run.outcome.status == "completed" and run.outcome.message == ""
    assert (late_rms(run, 12.0) <= times * late_rms(oracle, 12.0)).all()
    assert unexplained(controller, loop, run.final["controller_state"], held_out) < fvu
    assert np.abs(run["motor_torque"]).max() <= ROBOT.effort_limits.max()


@LONG
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_poor_motion_is_told_and_harmless(kind):
    controller = learner(kind)
    loop = loop_of(controller, 12.0, Circle(radius=1.0, speed=0.4, ramp=1.0), (Hold(0.3), Hold(0.5)))
    run = loop.run()
    assert run.outcome.status == "completed" and f"{controller.name}: not excited" in run.outcome.message
    assert (late_rms(run, 6.0) < np.array([1e-3, 1e-3, 2e-3, 1e-3, 1e-3])).all()


@LONG
@pytest.mark.parametrize("kind", ["regressor", "features"])
def test_a_payload_is_learned_anew(kind):
    load_up = Payload(mass=3.0, joint="arm_2_joint", at=(0.2, 0.0, 0.0), start=12.0)
    runs = [loop_of(learner(kind, drift=drift), 36.0, disturbances=(load_up,)).run() for drift in (0.0, 1e-4)]
    never, anew = (late_rms(run, 30.0)[3:].sum() for run in runs)
    assert anew < 0.5 * never
    assert anew < 0.5 * late_rms(runs[1], 12.0)[3:].sum()


@pytest.mark.compiled
def test_a_cycle_learns_too():
    controller = small("regressor")
    loop = loop_of(controller, 0.02, safety=Safety(), sensor=Sensor())
    twin = loop_of(controller, 0.02, safety=Safety(), sensor=Sensor()).run()
    with Stepper.of(loop) as cycle:
        for k in range(len(twin)):
            parts = {name: np.array(twin[name][k]) for name in ("pose", "velocity", "q", "qdot")}
            asked = Setpoint.side_by_side(loop.table()[k], loop.layout)
            torque = cycle.step(k * 0.002, Measurement(**parts), asked).effort
            np.testing.assert_allclose(torque, twin["torque"][k], rtol=1e-9, atol=1e-9)
            cycle.record()
        recording = cycle.finish()
    np.testing.assert_allclose(
        recording.final["controller_state"], twin.final["controller_state"], rtol=1e-6, atol=1e-9
    )


@pytest.mark.compiled
@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize("name", first_of(("fixed", "mobile", "tiago"), "fixed", "mobile"))
def test_other_robots(name, kind):
    """A fixed arm under gravity, a mobile one, TIAGo: better than PD within seconds."""
    if name == "tiago" and name not in extra():
        pytest.skip("example-robot-data is not installed")
    if PLAIN and (name, kind) not in {("mobile", "features"), ("tiago", "residual")}:
        pytest.skip("slow in plain Python")
    if name != "tiago" and kind == "residual":
        pytest.skip("a nominal robot is loaded by name")
    made = {"fixed": fixed_arm, "mobile": mobile_arm}
    experiment = load_experiment("track", ["robot=tiago", f"time.duration={0.02 if PLAIN else 4.0}"])
    robot = load(name) if name == "tiago" else made[name](3)
    errors = []
    for controller in ("pd", f"kalman_{kind}"):
        run = experiment.loop(robot, experiment.controller(controller, robot=robot)).run()
        assert run.outcome.status == "completed"
        errors.append(np.sqrt(np.mean(np.asarray(run["true_e"])[len(run) // 2 :] ** 2, axis=0)))
    if not PLAIN:
        assert np.median(errors[1] / errors[0]) < 0.9


@pytest.mark.compiled
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_it_is_built_again_from_what_it_told(kind):
    controller = small(kind, noise=0.05)
    facts = json.loads(json.dumps(controller.facts()))
    again = Kalman.from_facts(
        controller.name, facts, Granted(CONTROLLERS[controller.name], ROBOT, Nominal(), Overrides())
    )
    runs = [loop_of(which, 0.02).run() for which in (controller, again)]
    np.testing.assert_array_equal(runs[0].final["controller_state"], runs[1].final["controller_state"])
    assert again.settings == controller.settings


# --- settings


@pytest.mark.parametrize(
    ("kind", "own", "key"),
    [
        (KalmanRegressorSettings, {"noise": 0.0}, "kalman.regressor.noise"),
        (KalmanBilinearSettings, {"drift": -1.0}, "kalman.bilinear.drift"),
        (KalmanBilinearSettings, {"hidden": 0}, "kalman.bilinear.hidden"),
        (KalmanFeaturesSettings, {"speed": np.nan}, "kalman.features.speed"),
    ],
)
def test_impossible_settings_are_refused_with_their_key(kind, own, key):
    with pytest.raises(ConfigError) as error:
        kind(**own)
    assert error.value.key == key


def test_what_does_not_fit_is_refused():
    with pytest.raises(ConfigError, match="without a regressor"):
        Kalman(KalmanRegressorSettings(), machine_of(ROBOT))
    with pytest.raises(ConfigError, match="no nominal parameters"):
        Kalman(KalmanResidualSettings(), machine_of(ROBOT), K, REGRESSOR, np.ones(3))
    with pytest.raises(ConfigError, match="needs all > 0"):
        Kalman(KalmanFeaturesSettings(), machine_of(ROBOT), Feedback(0.0, 1.0)).law(Context(LAYOUT, 0.001, 1))


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_an_experiment_makes_it(kind):
    experiment = load_experiment("track", [f"kalman.{kind}.noise=0.07", "learning.learning=false"])
    controller = experiment.controller(f"kalman_{kind}", robot=experiment.load_robot())
    assert controller.name == f"kalman_{kind}" and controller.settings.noise == 0.07 and not controller.learning
    assert controller.facts()["settings"]["noise"] == 0.07 and controller.notes[0].startswith(controller.name)
    with pytest.raises(ConfigError, match="of no robot"):
        experiment.controller(f"kalman_{kind}")
    with pytest.raises(ConfigError, match="noise"):
        load_experiment("track", [f"kalman.{kind}.noise=-1"])


@pytest.mark.compiled
def test_a_nominal_robot_that_moves_otherwise_is_refused():
    experiment = load_experiment("track", ["nominal.robot=two_axis_arm"])
    with pytest.raises(ConfigError, match="does not move as platform_arm") as error:
        experiment.controller("kalman_residual", robot=experiment.load_robot())
    assert error.value.key == "nominal.robot"


# -- beginning with what was identified --------------------------------------------------------------------------------


def covariance_of(seed: int, size: int = REGRESSOR.size) -> np.ndarray:
    A = np.random.default_rng(seed).standard_normal((size, size)) * 1e-4
    return A @ A.T


def begun(theta: np.ndarray, covariance: np.ndarray):
    return replace(learner("regressor"), before=(theta, covariance))


@given(seed=seeds, rank=st.integers(1, 12))
@settings(max_examples=20, deadline=None)
def test_the_factors_of_a_covariance_are_its_own(seed, rank):
    A = np.random.default_rng(seed).standard_normal((12, rank)) * np.logspace(-3, 3, 12)[:, None]
    U, D = factors(A @ A.T)
    upper = np.triu(U.T, 1) + np.eye(12)
    np.testing.assert_allclose(upper @ np.diag(D) @ upper.T, A @ A.T, atol=1e-6 * np.abs(A @ A.T).max())
    assert (D >= 0).all() and not np.triu(U).any()


def test_it_begins_with_parameters_and_covariance_within_its_prior():
    wide, silent = covariance_of(1), REGRESSOR.size - 1
    wide[0] *= 1e9
    wide[:, 0] *= 1e9  # more than the prior
    wide[silent] = wide[:, silent] = 0.0  # nothing said
    controller = begun(TRUE, wide)
    state = controller.init(Context(LAYOUT, 0.001, 1))
    upper = np.triu(state["U"].T, 1) + np.eye(REGRESSOR.size)
    P, prior = upper @ np.diag(state["D"]) @ upper.T, state["prior"]
    np.testing.assert_array_equal(state["W"][0], TRUE)
    assert P[0, 0] == pytest.approx(prior[0]) and P[silent, silent] == pytest.approx(prior[silent])
    kept = prior[1:silent] > np.diag(wide)[1:silent]
    assert kept.sum() > 10
    inside = np.flatnonzero(kept) + 1
    np.testing.assert_allclose(P[np.ix_(inside, inside)], wide[np.ix_(inside, inside)], rtol=1e-6, atol=1e-18)
    again = Kalman.from_facts("kalman_regressor", json.loads(json.dumps(controller.facts())), Truth())
    np.testing.assert_array_equal(again.init(Context(LAYOUT, 0.001, 1)).values, state.values)
    np.testing.assert_allclose(controller.true_weights(TRUE, state), TRUE, rtol=1e-6, atol=1e-9)


class Truth:
    """What a learner may be told here."""

    motion, machine, parameters = REGRESSOR, machine_of(ROBOT), THETA0


@pytest.mark.compiled
def test_a_fit_is_worth_its_covariance():
    """Begun with the truth it says it at once; what a measurement moves is what the covariance leaves open."""
    run = loop_of(begun(TRUE, covariance_of(2)), 0.02, sensor=Sensor(), engine="ordinary").run()
    np.testing.assert_allclose(run["psi_hat"][0], run["psi"][0], rtol=1e-6, atol=1e-6)
    phi, noise = REGRESSOR.matrix(ROBOT.neutral_position(), *np.full((3, 4), 0.3))[2] / GAINS[2], 1e-2
    for P in (covariance_of(4), 100.0 * covariance_of(4)):
        state, f, b = begun(TRUE, P).init(Context(LAYOUT, 0.001, 1)), np.zeros(phi.size), np.zeros(phi.size)
        assert measure(state["U"], state["D"], phi, noise, f, b) == pytest.approx(noise + phi @ P @ phi)
        matters = state["prior"] > 0.0  # what no motion tells has no variance
        np.testing.assert_allclose(b[matters], (P @ phi)[matters], rtol=1e-6, atol=1e-9 * np.abs(P @ phi).max())


@pytest.mark.compiled
def test_only_a_report_of_the_same_robot_is_a_start(tmp_path):
    file, order = tmp_path / "r.identified.json", np.random.default_rng(0).permutation(REGRESSOR.size)
    labels, C = [*REGRESSOR.labels, "arm_1_joint.offset"], covariance_of(3)
    more = np.zeros((len(labels), len(labels)))
    more[:-1, :-1] = C
    order = [*order, len(labels) - 1]
    report = {"labels": [labels[i] for i in order], "theta": np.array([*TRUE, 9.0])[order].tolist()}
    file.write_text(json.dumps(report | {"covariance": more[np.ix_(order, order)].tolist()}))
    theta, covariance = identified(str(file), REGRESSOR.labels, "kalman.regressor.start")
    np.testing.assert_array_equal(theta, TRUE)
    np.testing.assert_array_equal(covariance, C)
    experiment = load_experiment("track", [f"kalman.regressor.start='{file}'"])
    made = experiment.controller("kalman_regressor", robot=ROBOT)
    np.testing.assert_array_equal(made.before[0], TRUE)
    for text, what in (
        ("{", "no report"),
        ('{"labels": ["a"], "theta": [1], "covariance": [[1]]}', "of another robot"),
    ):
        file.write_text(text)
        with pytest.raises(ConfigError, match=what) as error:
            experiment.controller("kalman_regressor", robot=ROBOT)
        assert error.value.key == "kalman.regressor.start" and "\n" not in str(error.value)
    file.unlink()
    with pytest.raises(ConfigError, match="No such file"):
        experiment.controller("kalman_regressor", robot=ROBOT)
