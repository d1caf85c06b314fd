"""Adaptive control: the natural law against its geodesic, divergence and projection; passivity; a closed loop."""

from __future__ import annotations

import json
import os
import re
import runpy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import assert_engines_agree, assert_frozen, assert_it_resumes
from places import ROOT
from scipy.linalg import expm, sqrtm

from mmnn_pin import PD, Circle, Eight, Loop, Sine, Stepper, StepperSettings, Timing, Trajectory, load, load_experiment
from mmnn_pin.errors import ConfigError
from mmnn_pin.loop.before_run import Start
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.safety import Safety
from mmnn_pin.sensing import Sensor
from mmnn_pin.signals import Layout
from mmnn_pin.torque.adaptive import Adaptive, AdaptiveSettings, Estimate, adapt
from mmnn_pin.torque.controller import Context, Feedback
from mmnn_pin.torque.prior import DOUBT
from mmnn_pin.torque.pseudo_inertia import (
    cholesky,
    clip,
    directions,
    exponential,
    lifted,
    pseudo_inertias,
    vector_of,
    within,
)

PLAIN = os.environ.get("NUMBA_DISABLE_JIT") == "1"  # plain Python: short runs only
ROBOT = load("platform_arm").with_friction((30.0, 5.0, 0.5, 0.5)).with_joint_friction(coulomb=0.5)
REGRESSOR = Regressor.of(ROBOT)
TRUE = parameters(ROBOT)
K = Feedback(500.0, 30.0)
seeds = st.integers(0, 2**32 - 1)


def positive(rng, spread=2.0):
    """A random positive definite 4 x 4 matrix."""
    return np.asarray(sqrtm(expm(spread * symmetric(rng)))).real


def symmetric(rng):
    A = rng.standard_normal((4, 4))
    return (A + A.T) / 2


def divergence(P, Q):
    """Log-det Bregman divergence D(P || Q), by determinants and an inverse."""
    return np.linalg.slogdet(Q)[1] - np.linalg.slogdet(P)[1] + np.trace(np.linalg.solve(Q, P)) - 4


class Bench:
    """An adaptive controller alone: Y and s go in, theta moves."""

    def __init__(self, h=1e-3, regressor=REGRESSOR, **adapting):
        self.adapting = AdaptiveSettings(**{"share": 1e9, "rotor": 0.5} | adapting)
        self.controller = Adaptive(regressor, K, self.adapting)
        self.layout, self.h = Layout.of(ROBOT.dimensions), h
        context = Context(self.layout, h, 10)
        self.a, self.state = self.controller.law(context).learner, self.controller.init(context)
        self.row, self.theta = self.layout.new_row(), self.state["theta"]

    def step(self, Y, s):
        """Psi_hat of one sample, with theta from before it."""
        self.a.known.Y[:] = Y
        self.row[self.layout.where("z")], self.row[self.layout.where("r")] = s[:2], s[2:]
        adapt(self.row, self.layout.offsets, self.a, self.state.view(Estimate))
        return self.row[self.layout.where("psi_hat")].copy()

    def distance(self, theta=TRUE):
        """The part of V that theta has."""
        first = REGRESSOR.inertial
        bodies = zip(pseudo_inertias(theta[:first]), pseudo_inertias(self.theta[:first]), strict=True)
        moves = self.a.bodies.rates > 0
        rest = (theta - self.theta)[first:][moves] ** 2 / (2 * self.a.bodies.rates[moves])
        return sum(divergence(*pair) for pair in bodies) / self.adapting.rate + rest.sum()


# --- the law of one body


@settings(max_examples=40, deadline=None)
@given(seeds, st.floats(1e-3, 0.1))
def test_a_step_is_close_to_the_geodesic_and_always_positive(seed, size):
    rng = np.random.default_rng(seed)
    X, E = symmetric(rng), np.zeros((4, 4))
    X *= size / np.linalg.norm(X, 2)
    exponential(X, E)
    np.testing.assert_allclose(E @ E, expm(X), atol=size**3)
    exponential(1e4 * X, E)
    assert np.linalg.eigvalsh(E).min() > 0


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_one_sample_of_a_body_is_the_natural_law(seed):
    """By matrices: P+ = P^1/2 exp(h gamma P^1/2 L P^1/2) P^1/2, with tr(L dP) = s' Y dtheta, for every body."""
    rng = np.random.default_rng(seed)
    bench = Bench(h=1e-5, rate=2.0)
    before = bench.theta.copy()
    Y, s = rng.standard_normal((4, REGRESSOR.size)), rng.standard_normal(4)
    np.testing.assert_allclose(bench.step(Y, s), Y @ before, rtol=1e-12)
    first = REGRESSOR.inertial
    for b, P in enumerate(pseudo_inertias(before[:first])):
        g = (Y.T @ s)[10 * b : 10 * b + 10]
        L = dual(g)
        root = np.asarray(sqrtm(P)).real
        expected = root @ expm(bench.h * 2.0 * root @ L @ root) @ root
        moved = pseudo_inertias(bench.theta[:first])[b] - P
        np.testing.assert_allclose(moved, expected - P, atol=1e-4 * np.abs(expected - P).max())
    moved = bench.theta[first:] - before[first:]
    np.testing.assert_allclose(moved, np.maximum(bench.h * bench.a.bodies.rates * (Y.T @ s)[first:], 0), atol=1e-15)


def dual(g):
    """L with tr(L P(dtheta)) = g' dtheta, column by column from the ten unit parameters."""
    units = pseudo_inertias(np.eye(10).ravel())
    gram = np.array([[np.trace(a @ b) for b in units] for a in units])
    return np.tensordot(np.linalg.solve(gram, g), units, axes=1)


@settings(max_examples=60, deadline=None)
@given(seeds, st.floats(0.02, 0.7), st.floats(1.5, 50.0))
def test_clipping_is_the_projection_in_the_divergence(seed, least, most):
    """Pythagoras for Bregman projections: D(P || Q) >= D(P || clipped Q) + D(clipped Q || Q) for every P within."""
    rng = np.random.default_rng(seed)
    Q, P, work, half = positive(rng, 4.0), positive(rng), np.zeros((4, 4)), np.zeros((4, 4))
    values, vectors = np.linalg.eigh(P)
    P = vectors @ np.diag(np.clip(values, least, most)) @ vectors.T
    clipped = Q.copy()
    clip(clipped, least, most, work, half)
    ends = np.linalg.eigvalsh(clipped)
    assert least * (1 - 1e-9) <= ends[0] and ends[-1] <= most * (1 + 1e-9)
    if within(Q, least, most, work, half):
        np.testing.assert_allclose(clipped, Q, atol=1e-9 * np.abs(Q).max())
    left = divergence(P, Q)
    assert left >= divergence(P, clipped) + divergence(clipped, Q) - 1e-8 * (1 + left)


def test_cholesky_says_where_there_is_none():
    rng, B = np.random.default_rng(0), np.zeros((4, 4))
    P = positive(rng)
    assert cholesky(P, B)
    np.testing.assert_allclose(B @ B.T, P, atol=1e-12)
    assert not cholesky(P - 2 * np.linalg.eigvalsh(P)[-1] * np.eye(4), B)
    assert not cholesky(np.full((4, 4), np.nan), B)


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_what_the_estimate_loses_is_the_work_of_its_error(seed):
    """d/dt V_theta = -s' Y (theta - theta_hat), by a small step."""
    rng = np.random.default_rng(seed)
    bench = Bench(h=1e-9, rate=3.0)
    bench.theta[REGRESSOR.inertial :] += 0.1  # off the wall at zero
    before, Y, s = bench.distance(), rng.standard_normal((4, REGRESSOR.size)), rng.standard_normal(4)
    work = s @ Y @ (TRUE - bench.theta)
    bench.step(Y, s)
    assert (bench.distance() - before) / bench.h == pytest.approx(-work, rel=1e-3, abs=0.05)


def test_the_map_from_s_to_the_error_of_psi_is_passive():
    """The integral of s' Y (theta_hat - theta) is at least -V_theta(0), up to what a sample costs: it goes with h."""
    rng = np.random.default_rng(3)
    amplitude, rate, phase = rng.standard_normal((3, 4, REGRESSOR.size))
    excess = []
    truth, first = TRUE.copy(), REGRESSOR.inertial
    truth[first:] = 30.0
    for h in (2e-3, 1e-3):
        bench, supplied = Bench(h=h, rate=1.0, viscous=0.01, coulomb=0.01, rotor=0.01, friction_bound=1e3), 0.0
        bench.theta[first:] = 25.0  # off the walls
        start = bench.distance(truth)
        for t in np.arange(0.0, 0.05 if PLAIN else 1.0, h):
            Y, s = 0.1 * amplitude * np.sin(5 * rate * t + phase), 0.05 * np.sin(7 * t + np.arange(4.0))
            supplied += h * s @ (Y @ truth - bench.step(Y, s))
        excess.append(start - bench.distance(truth) - supplied)
        assert supplied <= start + abs(excess[-1])
        assert (bench.theta[first:] > 0).all()
    assert abs(excess[0]) < 0.01 * abs(supplied)
    assert abs(excess[1]) < 0.6 * abs(excess[0])


def test_leakage_alone_pulls_the_dual_variable_to_its_start():
    """d/dt P^-1 = sigma (P_0^-1 - P^-1), so P^-1 - P_0^-1 decays with exp(-sigma t)."""
    bench = Bench(h=1e-3, leakage=2.0, rate=1.0)
    first = REGRESSOR.inertial
    P0 = pseudo_inertias(bench.theta[:first])
    bench.theta[:] *= 3.0
    for _ in range(500):
        bench.step(np.zeros((4, REGRESSOR.size)), np.ones(4))
    left = np.linalg.inv(pseudo_inertias(bench.theta[:first])) - np.linalg.inv(P0)
    np.testing.assert_allclose(left, -np.exp(-1.0) * (2 / 3) * np.linalg.inv(P0), rtol=0.01, atol=1e-6)


def test_leakage_alone_pulls_rotors_and_friction_to_their_start():
    """Each loses the share h sigma of its distance in every sample."""
    bench = Bench(h=1e-3, leakage=2.0)
    rest, start = bench.theta[REGRESSOR.inertial :], bench.a.bodies.start
    rest += 0.01
    for _ in range(50):
        bench.step(np.zeros((4, REGRESSOR.size)), np.ones(4))
    np.testing.assert_allclose(rest - start, 0.01 * (1 - 2e-3) ** 50, rtol=1e-9)


def test_e_modification_leaks_with_the_error():
    still, moving = Bench(leakage=2.0, modification="e"), Bench(leakage=2.0, modification="e")
    for bench, s in ((still, 0.0), (moving, 1.0)):
        bench.theta[:] *= 3.0
        bench.step(np.zeros((4, REGRESSOR.size)), np.full(4, s))
    start = 3.0 * still.controller.start()
    np.testing.assert_allclose(still.theta, start, rtol=1e-12)
    assert (moving.theta[:10] != start[:10]).any()


@settings(max_examples=20, deadline=None)
@given(seeds, st.floats(0.0, 1e6))
def test_the_estimate_stays_physical_and_bounded_whatever_comes(seed, size):
    rng, bench = np.random.default_rng(seed), Bench(h=0.01, bounds=7.0, heaviest=5.0, rate=5.0)
    first, starts = REGRESSOR.inertial, pseudo_inertias(Bench().controller.start()[: REGRESSOR.inertial])
    for _ in range(5):
        bench.step(size * rng.standard_normal((4, REGRESSOR.size)), rng.standard_normal(4))
        for P, P0 in zip(pseudo_inertias(bench.theta[:first]), starts, strict=True):
            ratios = np.linalg.eigvals(np.linalg.solve(P0, P)).real
            assert ratios.min() > 1 / 7.01 and ratios.max() < 5.01
        assert (bench.theta[first:] >= 0).all() and (bench.theta[first:] <= bench.a.bodies.top).all()


def test_no_body_is_believed_to_be_heavier_than_ten_of_the_priors_however_light_that_was_made():
    """Under strong gains the prior stays as it is; servo-sized gains make it lighter, and it may grow as much more."""
    strong = Adaptive(REGRESSOR, Feedback(1e4, 1e4))
    np.testing.assert_allclose(strong.most(), 10.0)
    weak = Adaptive(REGRESSOR, Feedback(20.0, 0.5))
    assert (weak.most() > 10.0).any() and weak.most().max() <= 100.0
    for i, body in enumerate(REGRESSOR.bodies):
        mass = weak.start()[10 * i]
        assert weak.most()[i] == pytest.approx(min(100.0, 10.0 * (30.0 if body == "root" else 2.0) / mass))
    told = Adaptive(REGRESSOR, Feedback(20.0, 0.5), AdaptiveSettings(initial="nominal"), strong.start())
    np.testing.assert_array_equal(told.most(), 100.0)


@pytest.mark.parametrize("share", [0.1, 0.01])
@pytest.mark.parametrize("sizes", [(1e-3, 1e-3), (1.0, 1e-4), (1e-5, 1e-2)])
def test_a_sample_answers_at_most_its_share_of_the_feedback(share, sizes):
    """All velocities, and base and arm alone: noise of a strong base lets no light arm be answered with more."""
    rng, h, gains = np.random.default_rng(1), 2e-3, K.vector(ROBOT.dimensions)
    Y, s = 30 * rng.standard_normal((4, REGRESSOR.size)), rng.standard_normal(4) * np.repeat(sizes, 2)
    bench = Bench(h=h, share=share, bounds=1e6, heaviest=1e6, friction_bound=1e6)
    bench.theta[REGRESSOR.inertial :] = 50.0
    before, A = bench.theta.copy(), h * Y @ natural_gain(bench) @ Y.T
    parts = [np.isin(range(4), where) * s for where in (range(4), (0, 1), (2, 3))]
    eta = min(1.0, *(share * x @ (gains * x) / (x @ A @ x) for x in parts))
    bench.step(Y, s)
    assert eta < 0.5 and s @ Y @ (bench.theta - before) == pytest.approx(eta * s @ A @ s, rel=0.03)


def test_a_start_from_a_robot_without_density_is_made_physical():
    rng = np.random.default_rng(0)
    guess, flat = positive(rng), np.diag([1.0, 2.0, 0.0, 3.0])
    made = lifted(flat, guess)
    assert np.linalg.eigvalsh(made).min() > 0 and np.linalg.eigvalsh(made - flat).min() > -1e-12
    full = guess + positive(rng)
    np.testing.assert_allclose(lifted(full, guess), full, atol=1e-12)
    np.testing.assert_allclose(pseudo_inertias(vector_of(made))[0], made)


# --- in a closed loop


def loop_of(controller, duration=4.0, h=0.002, **more):
    base = more.pop("base", Eight(length=1.5, width=0.75, period=12.0, ramp=1.0))
    arm = [Sine(0.785, 4.0, 0.0, np.pi / 2), Sine(0.5, 3.0, 0.0, np.pi / 2)]
    timing = Timing(duration=0.02 if PLAIN else duration, control_period=h, plant_step=h, integrator="rk4")
    more = {"start": Start((-0.01, 0.0, 0.0))} | more
    return Loop(ROBOT, Trajectory(base=base, arm=arm), controller, timing=timing, **more)


def adaptive(**adapting):
    return Adaptive(REGRESSOR, K, AdaptiveSettings(**adapting))


@pytest.mark.skipif(PLAIN, reason="needs a long run")
def test_v_falls_by_the_feedback_alone_up_to_what_sampling_costs():
    """V(T) - V(0) + integral of s' K s goes to zero with the control period, and V never grows by more than that."""
    left, rates = [], {"rate": 3.0, "viscous": 0.0, "coulomb": 0.0, "share": 1e9}  # no friction: no walls are touched
    for h in (1e-3, 2.5e-4):
        loop = replace(loop_of(adaptive(**rates), 1.0, h, weights_interval=h), robot=load("platform_arm"))
        run, bench, dynamics = loop.run(), Bench(**rates, rotor=0.0), Dynamics(loop.robot)
        s = np.hstack((run["z"], run["r"]))
        kinetic = [0.5 * e @ dynamics.mass_matrix(q) @ e for q, e in zip(run["position"], s, strict=True)]
        V = []
        for energy, theta in zip(kinetic, run.weights["theta"], strict=False):
            bench.theta[:] = theta
            V.append(energy + bench.distance())
        power = (s**2 @ K.vector(ROBOT.dimensions))[: len(V)]
        lost = np.concatenate([[0.0], np.cumsum(0.5 * h * (power[1:] + power[:-1]))])
        left.append(np.abs(np.array(V) - V[0] + lost).max() / V[0])
        assert np.diff(V).max() < 0.01 * V[0] * h / 1e-3
        assert V[-1] < 0.97 * V[0]
    assert left[0] < 0.05
    assert left[1] < 0.4 * left[0]


def test_both_engines_agree_and_stop_where_they_are_told():
    assert_engines_agree(loop_of(adaptive(), 0.1))
    frozen = loop_of(replace(adaptive(), learning=False), 0.1)
    assert_frozen(frozen)
    assert "combinations" not in frozen.run().outcome.message


def test_a_resumed_run_equals_the_uninterrupted_one():
    loop = loop_of(adaptive(), 0.2)
    assert_it_resumes(loop, loop.timing.duration / 2)


@pytest.mark.skipif(PLAIN, reason="needs a long run")
def test_it_learns_from_a_prior_and_from_a_wrong_robot():
    def late(run):
        errors = np.hstack((run["true_pose_error"], run["true_e"]))[run.time > 8.0]
        return np.sqrt(np.mean(errors**2, axis=0))

    wrong = Adaptive(
        REGRESSOR, K, AdaptiveSettings(initial="nominal"), parameters(load("platform_arm").with_masses(0.7))
    )
    pd = late(loop_of(PD(K), 12.0).run())
    for controller in (adaptive(), wrong):
        run = loop_of(controller, 12.0).run()
        assert run.outcome.status == "completed" and (late(run) < pd).all()
        assert late(run)[3:].max() < 0.2 * pd[3:].min() or late(run)[3:].sum() < 0.15 * pd[3:].sum()
        for theta in run.weights["theta"]:
            assert all(np.linalg.eigvalsh(P)[0] > 0 for P in pseudo_inertias(theta[: REGRESSOR.inertial]))


@pytest.mark.skipif(PLAIN, reason="needs a long run")
def test_a_poor_motion_is_told_and_harmless():
    def excited(message):
        return int(message.split("excited ")[1].split()[0])

    still = [Sine(0.0, 4.0), Sine(0.0, 4.0)]
    poor = replace(
        loop_of(adaptive(), 12.0), trajectory=Trajectory(base=Circle(speed=0.3, radius=1.0), arm=still)
    ).run()
    rich = loop_of(adaptive(), 12.0).run()
    assert poor.outcome.status == "completed"
    assert excited(poor.outcome.message) < excited(rich.outcome.message)


@pytest.mark.skipif(PLAIN, reason="needs a long run")
def test_the_example_knows_more_after_the_richer_motion(capsys):
    runpy.run_path(str(ROOT / "examples" / "adaptive.py"), run_name="__main__")
    rich, poor = ([float(x) for x in re.findall(r"0[.]\d{4}", line)] for line in capsys.readouterr().out.splitlines())
    assert rich[0] < 0.1 and all(a < b for a, b in zip(rich, poor, strict=True))


def test_it_acts_alike_on_a_robot_of_other_masses():
    """What the controller is made of does not depend on the true robot: the same row gives the same torque."""
    heavy = ROBOT.with_masses(3.0).with_friction(0.0)
    benches = [Bench(regressor=Regressor.of(robot)) for robot in (ROBOT, heavy)]
    rng = np.random.default_rng(0)
    Y, s = rng.standard_normal((4, REGRESSOR.size)), rng.standard_normal(4)
    np.testing.assert_array_equal(*[bench.step(Y, s) for bench in benches])
    np.testing.assert_array_equal(*[bench.theta for bench in benches])


# --- settings


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"rate": -1.0}, "adaptive.rate"),
        ({"mass": (0.0, 1.0)}, "adaptive.mass"),
        ({"size": (0.1, np.nan)}, "adaptive.size"),
        ({"bounds": 1.0}, "adaptive.bounds"),
        ({"heaviest": 0.5}, "adaptive.heaviest"),
    ],
)
def test_impossible_settings_are_refused_with_their_key(settings, key):
    with pytest.raises(ConfigError) as error:
        AdaptiveSettings(**settings)
    assert error.value.key == key


def test_what_does_not_fit_is_refused():
    with pytest.raises(ConfigError, match="no nominal parameters"):
        adaptive(initial="nominal")
    with pytest.raises(ConfigError, match="give 64 finite ones"):
        Adaptive(REGRESSOR, K, nominal=np.ones(3))
    with pytest.raises(ConfigError, match="adaptation needs all > 0"):
        Adaptive(REGRESSOR, Feedback(0.0, 1.0)).law(Context(Layout.of(ROBOT.dimensions), 0.001, 1))


def test_an_experiment_makes_it():
    said = ["adaptive.initial=nominal", "nominal.masses=0.5", "adaptive.rate=7"]
    experiment = load_experiment("track", said)
    robot = experiment.load_robot()
    controller = experiment.controller("adaptive", robot=robot)
    assert controller.settings.rate == 7 and controller.notes == [
        f"adaptive: {controller.unit.shape[1]} combinations of its 64 parameters matter on this robot"
    ]
    np.testing.assert_allclose(controller.nominal[0], 0.5 * parameters(robot)[0])
    other = load_experiment("track", ["adaptive.initial=nominal", "nominal.robot=two_axis_arm"])
    with pytest.raises(ConfigError, match="does not move as platform_arm"):
        other.controller("adaptive", robot=robot)
    with pytest.raises(ConfigError, match="rate"):
        load_experiment("track", ["adaptive.rate=-1"])


# --- begun with a fit


def covariance_of(seed):
    """A covariance of all parameters, correlated, sure in some directions, of the size of the parameters."""
    rng, k = np.random.default_rng(seed), REGRESSOR.size
    A = rng.standard_normal((k, k)) * 10.0 ** rng.uniform(-2, 0, k)
    size = 0.1 * np.abs(TRUE) + 1e-3
    return size[:, None] * (A @ A.T / k + 1e-4 * np.eye(k)) * size


def begun(covariance, **adapting):
    """A bench that begins near the truth, with friction off its walls, and a covariance."""
    bench = Bench(h=1e-5, **adapting)
    start = TRUE * np.random.default_rng(1).uniform(0.9, 1.1, REGRESSOR.size)
    start[REGRESSOR.inertial :] = TRUE[REGRESSOR.inertial :] + 0.1
    bench.controller = replace(bench.controller, nominal=start, covariance=covariance)
    context = Context(bench.layout, bench.h, 10)
    bench.a, bench.state = bench.controller.law(context).learner, bench.controller.init(context)
    bench.theta = bench.state["theta"]
    return bench


def natural_gain(bench):
    """Gamma, (k, k), of no fit: `gamma P L P` of every body, the rates of the rest."""
    columns, first = np.diag(np.concatenate((np.zeros(REGRESSOR.inertial), bench.a.bodies.rates))), REGRESSOR.inertial
    for b, P in enumerate(pseudo_inertias(bench.theta[:first])):
        here = slice(10 * b, 10 * b + 10)
        columns[here, here] = np.array([vector_of(bench.adapting.rate * P @ dual(e) @ P) for e in np.eye(10)]).T
    return columns


def gain(bench):
    """Gamma as the law computes it, column by column."""
    columns, bodies = [], bench.a.bodies
    for unit in np.eye(REGRESSOR.size):
        directions(bench.theta, unit, bodies)
        columns.append(bodies.column / bodies.h)
    return np.array(columns).T


@pytest.mark.compiled
def test_the_gain_of_a_fit_is_its_covariance():
    """`gamma / DOUBT^2 Sigma` where Sigma is small, the natural metric where it is large, never more than either."""
    rate = 3.0
    wide = begun(1e12 * covariance_of(0), rate=rate)
    natural = natural_gain(wide)
    np.testing.assert_allclose(gain(wide), natural, rtol=1e-6, atol=1e-9)
    small = 1e-10 * covariance_of(0)
    learned = np.diag(natural) > 0
    wanted = (rate / DOUBT**2 * small)[np.ix_(learned, learned)]
    found = gain(begun(small, rate=rate))[np.ix_(learned, learned)]
    size = np.sqrt(np.diag(wanted))
    np.testing.assert_allclose(found / np.outer(size, size), wanted / np.outer(size, size), atol=2e-3)
    some = gain(begun(covariance_of(0), rate=rate))[np.ix_(learned, learned)]
    for most in (natural[np.ix_(learned, learned)], rate / DOUBT**2 * covariance_of(0)[np.ix_(learned, learned)]):
        values = np.linalg.eigvals(np.linalg.solve(most, some)).real
        assert values.max() < 1 + 1e-3 and values.min() < 0.5


def test_what_an_estimate_begun_with_a_fit_loses_is_the_work_of_its_error():
    """`V_theta + theta~' Lambda theta~ / 2` falls by s' Y theta~, and without its second part it does not."""
    left, without = 0.0, 0.0
    for seed in range(6):
        rng, bench = np.random.default_rng(seed), begun(covariance_of(0), rate=3.0, rotor=0.0)
        known, error = bench.a.bodies.known, TRUE - bench.theta
        error[REGRESSOR.inertial + np.flatnonzero(bench.a.bodies.rates == 0)] = 0.0
        Y, s = rng.standard_normal((4, REGRESSOR.size)), 1e-3 * rng.standard_normal(4)
        before, was = bench.distance(), bench.theta.copy()
        bench.step(Y, s)
        moved = bench.a.bodies.column  # theta's own is rounded, in the directions that are sure too much
        np.testing.assert_allclose(bench.theta - was, moved, atol=1e-5 * np.abs(moved).max())
        natural, work = (bench.distance() - before) / bench.h, s @ Y @ error
        left += abs(natural - error @ known @ moved / bench.h + work)
        without += abs(natural + work)
    assert left < 0.03 * without


def test_a_fit_is_read_kept_and_refused_beside_another_start(tmp_path):
    file = tmp_path / "r.identified.json"
    report = {"labels": list(REGRESSOR.labels), "theta": TRUE.tolist(), "covariance": covariance_of(2).tolist()}
    file.write_text(json.dumps(report))
    for name, key in (("adaptive", "adaptive"), ("adaptive_composite", "adaptive"), ("concurrent", "concurrent")):
        made = load_experiment("track", [f"{key}.start='{file}'"]).controller(name, robot=ROBOT)
        np.testing.assert_array_equal(made.covariance, covariance_of(2))
        again = type(made).from_facts(name, json.loads(json.dumps(made.facts())), Truth)
        np.testing.assert_array_equal(again.covariance, made.covariance)
        np.testing.assert_allclose(again.start(), made.start(), rtol=1e-12, atol=1e-15)
        with pytest.raises(ConfigError, match="beside initial"):
            load_experiment("track", [f"{key}.start='{file}'", f"{key}.initial='nominal'"])
        with pytest.raises(ConfigError, match="No such file") as error:
            load_experiment("track", [f"{key}.start='{file}s'"]).controller(name, robot=ROBOT)
        assert error.value.key == f"{key}.start"
    with pytest.raises(ConfigError, match="covariance of `start`"):
        AdaptiveSettings(start=str(file), leakage=0.1)
    with pytest.raises(ConfigError, match="no covariance"):
        Adaptive(REGRESSOR, K, AdaptiveSettings(), TRUE, True, np.eye(3))


class Truth:
    """What a learner may be told here."""

    motion, parameters = REGRESSOR, TRUE


# --- The largest answer -----------------------------------------------------------------------------------------------


LATE = st.floats(0.0, 0.05)


@given(st.floats(1e-4, 0.02), LATE, LATE, st.lists(LATE, min_size=4, max_size=4))
@settings(max_examples=40, deadline=None)
def test_answers_that_do_not_show_yet_stay_below_the_feedback(period, way, unseen, lags):
    context = Context(Layout.of(ROBOT.dimensions), period, 1, lag=np.array(lags), way=way, unseen=unseen)
    share = Adaptive(REGRESSOR).answer(context)
    under_way = 1 + (way + unseen + max(lags)) / period  # samples until an answer shows
    assert share * under_way == pytest.approx(1.0) and 0 < share <= 1
    assert Adaptive(REGRESSOR).answer(context, 0.3) == min(share, 0.3)


@pytest.mark.parametrize(
    "said",
    ["", "sensor={velocity='observer',bandwidth=100}", "sensor={velocity='filtered',bandwidth=50}",
     "sensor.velocity=difference", "sensor={velocity='model',bandwidth=60}", "latency={sensing=0.002,predict=true}",
     "latency={command=0.004,margin=0.001}"],
)  # fmt: skip
def test_on_a_robot_the_share_is_that_of_the_simulation(said):
    """Its drivers filter velocities as the experiment says: with the share of exact ones it rings there."""
    experiment = load_experiment("track", [said] if said else [])
    robot = experiment.load_robot()
    loop = experiment.loop(robot, experiment.controller("adaptive", robot=robot))
    share = loop.controller.law(loop.context()).learner.share
    with Stepper.of(loop, safety=Safety(), check_gains=False) as stepper:
        assert stepper.control.torque.learner.share == share


def test_a_filter_is_not_late_by_less_than_nothing():
    with pytest.raises(ConfigError, match="filtered"):
        Stepper(ROBOT, PD(Feedback(30.0, 60.0, "inertia")), StepperSettings(safety=Safety(), filtered=-0.01))


@pytest.mark.parametrize("late", range(5))
@pytest.mark.parametrize("bandwidth", [0.001, 0.01])
def test_an_answer_of_that_share_bears_the_delay_that_it_counts_with(late, bandwidth):
    """s+ = s - a (s + I), I+ = I + share s, both late: eigenvalues reach 1 where share is above 1 / (1 + late)."""

    def radius(share):
        size = late + 2  # s, then what was asked for before and has not shown yet, then I
        A = np.zeros((size, size))
        A[0, 0], A[-1, -1], A[-1, 0] = 1.0, 1.0, share
        asked = np.zeros(size)
        asked[0], asked[-1] = -bandwidth, -bandwidth
        if late:
            A[0, late] = 1.0
            A[1] = asked
            A[2 : late + 1, 1:late] = np.eye(late - 1)
        else:
            A[0] += asked
        return np.abs(np.linalg.eigvals(A)).max()

    context = Context(Layout.of(ROBOT.dimensions), 0.001, 1, way=0.001 * late)
    share = Adaptive(REGRESSOR).answer(context)
    assert radius(0.9 * share) < 1.0 < radius(1.1 * share)


def largest(rate, bandwidth, velocity, pole):
    """Largest real part of v' = -bandwidth v_hat + p, p' = -rate bandwidth v_hat behind a filter or observer."""
    v, p, x, first, second, third = np.eye(6)  # x is the angle; then what the filter remembers
    if velocity == "filtered":
        hat, filtered = first, {3: pole * (v - first)}
    elif velocity == "observer":  # first follows the angle, second its rate
        hat, error = second, x - first
        filtered = {3: second + 2 * pole * error, 4: pole**2 * error}
    else:  # the same, which expects the acceleration of the feedback; third is what it learns of p
        hat, error = second, x - first
        filtered = {
            3: second + 3 * pole * error,
            4: third - bandwidth * second + 3 * pole**2 * error,
            5: pole**3 * error,
        }
    A = np.zeros((6, 6))
    A[0], A[1], A[2] = p - bandwidth * hat, -rate * bandwidth * hat, v
    for row, motion in filtered.items():
        A[row] = motion
    kept = [0, 1, *([] if velocity == "filtered" else [2]), *filtered]
    values = np.linalg.eigvals(A[np.ix_(kept, kept)])
    values = values[np.argsort(np.abs(values))]
    return values[1 if velocity != "filtered" else 0 :].real.max()  # an angle may be anywhere


@pytest.mark.parametrize(
    ("velocity", "bandwidths"),
    [("filtered", (0.1, 1.0, 10.0)), ("observer", (0.01, 0.02)), ("model", (0.1, 1.0, 10.0))],
)
def test_an_integral_is_stable_up_to_the_rate_that_the_velocities_filter_permits(velocity, bandwidths):
    pole = 40.0
    rate = 1 / Sensor(velocity=velocity, bandwidth=pole).smoothing(1e-3)
    assert all(largest(0.95 * rate, w * pole, velocity, pole) < 0 for w in bandwidths)
    assert any(largest(1.05 * rate, w * pole, velocity, pole) > 0 for w in bandwidths)
    assert Sensor(velocity="difference").smoothing(1e-3) == 5e-4 and Sensor().smoothing(1e-3) == 0.0


def rate_of(*overrides):
    experiment = load_experiment("track", ["time.duration=0.01", *overrides])
    robot = experiment.load_robot()
    loop = experiment.loop(robot, experiment.controller("adaptive", robot=robot))
    learner = loop.controller.law(loop.context()).learner
    assert learner.share == min(1.0, loop.timing.control_period * loop.controller.bears.rate)
    return loop.controller.bears.rate


def test_a_share_counts_with_all_that_is_in_the_loop_together():
    """Of gains that are given: those that suit the loop would be lower with all of it."""
    given = "feedback.base=[900.0,100.0]", "feedback.arm=[8.0,2.0]"
    alone = rate_of(*given)
    lag, late = "actuator.lag=0.006", "latency.command=0.004"
    seen, slow = "sensor={velocity='filtered',bandwidth=100}", "time.sensor_period=0.004"
    singles = [rate_of(*given, one) for one in (lag, late, seen, slow)]
    assert all(one < 0.9 * alone for one in singles), (alone, singles)
    assert rate_of(*given, lag, late) < 0.9 * min(singles[:2])
    assert rate_of(*given, lag, late, seen) < 0.9 * rate_of(*given, lag, late)


def test_a_share_that_is_given_is_cut_to_what_the_loop_bears():
    for share, found in ((0.01, 0.01), (1.0, None)):
        experiment = load_experiment("track", [f"adaptive.share={share}", "actuator.lag=0.01"])
        robot = experiment.load_robot()
        loop = experiment.loop(robot, experiment.controller("adaptive", robot=robot))
        borne = loop.timing.control_period * loop.controller.bears.rate
        assert loop.controller.law(loop.context()).learner.share == (found or borne) and borne < 1.0


@pytest.mark.parametrize("predict", [False, True])
def test_a_real_robots_share_counts_with_its_latency(predict):
    calm = Feedback((100.0, 100.0), (5.0, 5.0))
    rates = []
    for latency in (0.0, 0.004):
        settings = StepperSettings(period=0.002, latency=latency, predict=predict)
        with Stepper(ROBOT, Adaptive(REGRESSOR, calm), settings) as stepper:
            rates.append(stepper.control.torque.learner.share)
    assert 0.0 < rates[1] < 0.9 * rates[0]


def test_a_share_that_is_no_number_is_refused():
    with pytest.raises(ConfigError, match=r"adaptive\.share"):
        load_experiment("track", ["adaptive.share=fast"])
