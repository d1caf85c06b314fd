"""DREM: its mixing against adjugates, errors that fall one by one, its part of V, bounds, engines."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from learning import assert_engines_agree, assert_frozen, assert_it_resumes, made
from numba import config
from test_composite import EIGHT

from mmnn_pin import load_experiment, run_experiment
from mmnn_pin.errors import ConfigError
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.torque.concurrent import SHARE
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.drem import BOUND, FAINT, OPEN, POSTURES, Mixed, estimate, extend, follow, mix, weigh
from mmnn_pin.torque.history import HALF, Stack, consider, estimate_of, scratch, shapes

SLOW = config.DISABLE_JIT


@cache
def loop_of(*said):
    return made("drem", *said)


def bench(*said):
    """The numbers of the thesis robot's DREM, its state, and views of it."""
    loop = loop_of(*said)
    context = loop.context()
    state = loop.controller.init(context)
    return loop.controller.law(context).learner, state, state.view(Mixed), context.layout


def learn(a, o, Phi, w):
    """One exact equation per velocity of true parameters w (k,), and one step."""
    o.filtered.Phi_f[:], o.filtered.Y_f[:] = Phi, Phi @ w
    extend(a, o)
    mix(a, o)


def adjugate(A):
    """By cofactors."""
    k = len(A)
    minors = [[np.delete(np.delete(A, i, 0), j, 1) for j in range(k)] for i in range(k)]
    return np.array([[(-1.0) ** (i + j) * np.linalg.det(minors[i][j]) for j in range(k)] for i in range(k)]).T


def test_the_integrals_are_those_of_kreisselmeier():
    """Omega and b against sums of all equations, each forgotten by its age."""
    a, _, o, _ = bench("drem.memory=0.5")
    rng, w, kept = np.random.default_rng(0), np.ones(27), []
    for _ in range(20):
        kept.append(0.02 * rng.standard_normal((4, 27)))
        learn(a, o, kept[-1], w)
    R, every = 1.0 / (0.005 * a.gain) ** 2, a.every * a.h
    Omega = sum(np.exp(-every / 0.5 * (19 - n)) * every * Phi.T @ (R[:, None] * Phi) for n, Phi in enumerate(kept))
    np.testing.assert_allclose(o.Omega, Omega, rtol=1e-10, atol=1e-12 * np.abs(Omega).max())
    np.testing.assert_allclose(o.b, Omega @ w, rtol=1e-8, atol=1e-10 * np.abs(Omega).max())


def test_a_step_is_that_of_a_scalar_equation_by_the_adjugate():
    """By numpy: det and adjugate, the row of each parameter divided by its cofactor, a normalised gradient."""
    a, _, o, _ = bench("drem.unsure=0.7")
    rng, k = np.random.default_rng(1), 27
    A = rng.standard_normal((k, k))
    o.Omega[:], o.b[:], o.w[:] = A @ A.T / k, rng.standard_normal(k), 0.1 * rng.standard_normal(k)
    extended = o.Omega + FAINT * np.eye(k)
    adj = adjugate(extended)
    Delta, Y = np.linalg.det(extended) / np.diag(adj) - FAINT, (adj @ o.b) / np.linalg.det(extended)
    told = Delta > (1 / OPEN - 1) * FAINT
    assert 0 < told.sum() < k and (Delta > 0).all()
    share = (1 - np.exp(-5.0 * a.every * a.h)) * Delta**2 / (Delta**2 + 0.7**-4)
    expected = o.w + np.where(told, share, 0.0) * (Y - o.w)
    mix(a, o)
    np.testing.assert_allclose(o.w, expected, rtol=1e-6, atol=1e-9)


def by_concurrent(Phis, w, a):
    """Errors of `concurrent` along the same equations, at the same rate."""
    k, size = w.size, np.sqrt(a.precision)
    state = ControllerState.of(**shapes(60, 4, k))
    state["L"] = state["P"] = np.eye(k)
    state["born"], state["F"] = -1.0, HALF * np.eye(k)
    stack, room, found, target, errors = state.view(Stack), scratch(60, 4, k), np.zeros(k), np.zeros(k), []
    for n, Phi in enumerate(Phis):
        consider(stack, room, size[:, None] * Phi, size * (Phi @ w), float(n), 0.05, np.inf, False)
        estimate_of(stack, target)
        found += a.rate * (target - found)
        errors.append(np.abs(w - found))
    return np.array(errors)


def test_every_error_falls_monotonically_where_those_of_concurrent_do_not():
    """At first only sums of two parameters show, then each alone: DREM waits for an equation of each."""
    steps = 80 if SLOW else 800
    a, _, o, _ = bench("drem.memory=0.0")
    rng = np.random.default_rng(2)
    w, errors, faint = rng.choice([-1.0, 1.0], 27) * rng.uniform(0.5, 2.0, 27), [], []
    Phis = 30.0 / np.sqrt(a.precision)[:, None] * rng.standard_normal((steps, 4, 27))
    Phis[: steps // 2, :, 1::2] = Phis[: steps // 2, :, :-1:2]
    for Phi in Phis:
        errors.append(np.abs(w - o.w))
        learn(a, o, Phi, w)
        faint.append(np.linalg.norm(w) * np.sqrt(FAINT * np.diag(o.P)))
    errors, faint = np.array([*errors, np.abs(w - o.w)]), np.array(faint)
    np.testing.assert_array_equal(errors[steps // 2][:26], np.abs(w)[:26])
    assert errors[steps // 2][26] < 0.1 * abs(w[26])
    assert not ((np.diff(errors, axis=0) > 0) & (errors[:-1] > faint)).any()
    assert SLOW or (errors[-1] < 0.01 * np.abs(w)).all()
    other = by_concurrent(Phis, w, a)
    assert (other[steps // 2 - 1] > np.abs(w) + 0.1).sum() > 3
    assert SLOW or (other[-1] < 0.01 * np.abs(w)).all()


def test_a_direction_that_is_not_excited_holds_back_its_own_parameters_alone():
    """Two parameters that only ever show as their sum stay as they are; all others are known. The determinant is 0."""
    a, _, o, _ = bench("drem.memory=0.0")
    rng, w = np.random.default_rng(3), np.linspace(-1.0, 1.0, 27)
    for _ in range(100 if SLOW else 400):
        Phi = 30.0 / np.sqrt(a.precision)[:, None] * rng.standard_normal((4, 27))
        Phi[:, 5] = Phi[:, 11]
        learn(a, o, Phi, w)
    assert np.linalg.matrix_rank(o.Omega) == 26
    assert (np.abs(o.w - w)[np.delete(np.arange(27), (5, 11))] < 0.01).all()
    assert not o.w[[5, 11]].any()


def test_a_lyapunov_function_falls_by_the_feedback_and_the_errors():
    """`s'Ms/2 + |w~|^2 / (2 Gamma)` along `M sdot = Phi w~ - K s`, by small steps of random features."""
    a, _, o, layout = bench("time.control_period=0.0001", "time.plant_step=0.0001", "drem.tracking=20.0")
    rng, row = np.random.default_rng(4), layout.new_row()
    w, waves = rng.standard_normal(27), rng.standard_normal((2, 4, 27))
    s, M, steps, found, fed = 0.01 * rng.standard_normal(4), a.gain / 20.0, 300 if SLOW else 5000, [], 0.0
    for n in range(steps):
        a.Phi[:] = a.gain[:, None] * 0.02 * (waves[0] * np.sin(30 * n * a.h) + waves[1] * np.cos(50 * n * a.h))
        found.append(0.5 * s @ (M * s) + 0.5 * np.sum((w - o.w) ** 2) / a.gamma)
        fed += a.h * s @ (a.gain * s)
        push = a.Phi @ (w - o.w)
        row[layout.where("z")], row[layout.where("r")] = s[:2], s[2:]
        follow(row, layout.offsets, a._replace(share=np.inf), o.w)
        s = s + a.h * (push - a.gain * s) / M
    assert found[0] - found[-1] == pytest.approx(fed, rel=0.05)
    assert (np.diff(found[::50]) < 0).all()


@pytest.mark.parametrize("tracking", [1e-3, 1e6])
def test_a_sample_is_the_law(tracking):
    """By numpy: Psi_hat, and w after the tracking term, below its share of the feedback and cut to it."""
    a, state, _, layout = bench(f"drem.tracking={tracking}")
    learner, row, rng = loop_of(f"drem.tracking={tracking}").controller, layout.new_row(), np.random.default_rng(0)
    state["w"] = w = 0.1 * rng.standard_normal(27)
    row[layout.where("z")], row[layout.where("r")] = 1e-3 * rng.standard_normal((2, 2))
    row[layout.where("nu_ref")] = nu_ref = rng.standard_normal(4)
    Y = learner.regressor.matrix(learner.regressor.massless.offset, np.zeros(4), nu_ref, np.zeros(4))
    Phi, s = Y @ learner.basis, np.concatenate([row[layout.where(name)] for name in ("z", "r")])
    estimate(row, layout.offsets, a, state.values)
    np.testing.assert_allclose(row[layout.where("psi_hat")], Y @ learner.start() + Phi @ w, rtol=1e-9)
    typical = learner.random_motion() @ learner.basis
    gamma = tracking / np.mean([(one**2).sum(axis=1) / a.gain for one in typical])
    step = a.h * gamma * Phi.T @ s
    eta = min(1.0, a.share * s @ (a.gain * s) / (s @ Phi @ step))
    assert (eta < 1.0) == (tracking > 1.0)
    np.testing.assert_allclose(state["w"], w + eta * step, rtol=1e-9)


def test_it_stays_bounded_whatever_the_sensors_say():
    a, state, _, layout = bench()
    row, rng = layout.new_row(), np.random.default_rng(0)
    for k in range(40 if SLOW else 400):
        row[:] = 10.0 ** rng.uniform(-3, 8) * rng.standard_normal(row.size)
        row[0] = k * a.h
        if k % 7 == 6:
            row[rng.integers(1, row.size)] = (np.nan, np.inf)[k % 2]
        estimate(row, layout.offsets, a, state.values)
        assert (np.abs(state["w"]) <= BOUND).all()


def test_no_parameter_passes_its_bound():
    """Where its equation says more, and where the tracking error asks for more."""
    a, _, o, layout = bench("drem.tracking=1e6")
    rng, row = np.random.default_rng(5), layout.new_row()
    for _ in range(100):
        learn(a, o, 30.0 / np.sqrt(a.precision)[:, None] * rng.standard_normal((4, 27)), np.full(27, 50.0))
    np.testing.assert_array_equal(o.w, BOUND)
    a.Phi[:] = -a.gain[:, None]
    row[layout.where("z")], row[layout.where("r")] = -1.0, -1.0
    follow(row, layout.offsets, a, o.w)
    np.testing.assert_array_equal(o.w, BOUND)
    follow(-row, layout.offsets, a, o.w)
    assert (o.w < BOUND).all()


def test_no_velocity_weighs_less_than_nothing_or_more_than_its_loop_bears():
    """By Pinocchio's mass matrices; what is moved comes nearer to the true parameters."""
    a, _, _, _ = bench()
    loop = loop_of()
    learner, robot, rng = loop.controller, loop.robot, np.random.default_rng(0)
    places = [learner.regressor.random_position(rng) for _ in range(POSTURES)]
    masses = [robot.with_masses(factor) for factor in (1.0, 1.5)]
    bearable = np.tile(learner.bears.weight * a.gain, POSTURES)
    for heavier in masses:
        w = learner.true_weights(parameters(heavier), None)
        felt = np.concatenate([np.diag(Dynamics(heavier).mass_matrix(place)) for place in places])
        np.testing.assert_allclose((a.heavy @ w - a.least) / (a.most - a.least), felt / bearable, rtol=1e-5)
    true, w = learner.true_weights(parameters(robot), None), 5.0 * rng.standard_normal(27)
    weigh(a, inside := true.copy())
    np.testing.assert_array_equal(inside, true)
    before = np.linalg.norm(w - true)
    for _ in range(50 if SLOW else 2000):
        weigh(a, w)
        after = np.linalg.norm(w - true)
        assert after <= before + 1e-12
        before = after
    room = 1.0 if SLOW else 1e-3
    assert (a.heavy @ w > a.least - room).all() and (a.heavy @ w < a.most + room).all()


@pytest.mark.compiled
def test_on_coarse_encoders_behind_a_delay_it_errs_less_than_plain_control():
    """Without the bounds 4.7 times as much: its equations say of any motion that it excites everything."""
    said = ["sensor.resolution=0.001534", 'sensor.velocity="filtered"', "latency.command=0.005", "actuator.lag=0.01"]
    said += ["controllers=['drem', 'pd_gravity']", "plots=[]"]
    runs = run_experiment(load_experiment("track", said), "track").recordings
    learned, plain = (np.sqrt(np.mean(runs[name]["e"][1000:] ** 2)) for name in ("drem", "pd_gravity"))
    assert learned < 0.8 * plain


def test_known_delays_slow_its_answer_down():
    loop = loop_of()
    context = replace(loop.context(), way=0.02, unseen=0.0, lag=None)
    h, slow = context.control_period, loop.controller.bears._replace(rate=3.0)
    for controller, share in (
        (loop.controller, min(SHARE, h * loop.controller.bears.rate)),
        (replace(loop.controller, bears=slow), 3.0 * h),
        (replace(loop.controller, bears=None), h / (h + 0.02)),  # of a loop that nobody knows
    ):
        assert controller.law(context).learner.share == pytest.approx(share)


@pytest.mark.compiled
def test_engines_batch_resumption_and_freezing():
    loop = made("drem")
    assert_engines_agree(loop)
    assert_it_resumes(loop, loop.timing.duration / 2)
    assert_frozen(loop)


@pytest.mark.skipif(SLOW, reason="needs a long run")
def test_on_an_eight_it_comes_to_know_the_robot():
    loop = made("drem", *EIGHT, duration=24.0)
    gram, truth, run = Regressor.of(loop.robot).gram(), parameters(loop.robot), loop.run()
    state = loop.controller.init(loop.context())

    def left():
        wrong = loop.controller.theta(state) - truth
        return wrong @ gram @ wrong / (truth @ gram @ truth)

    before = left()
    state.values[:] = run.final["controller_state"]
    assert left() < 0.01 * before
    theta, covariance = loop.controller.knowledge(state)
    np.testing.assert_array_equal(theta, loop.controller.theta(state))
    inverse = loop.controller.basis @ np.linalg.inv(state["Omega"] + np.eye(27)) @ loop.controller.basis.T
    np.testing.assert_allclose(covariance, inverse, rtol=1e-9, atol=1e-12 * np.abs(inverse).max())


def test_its_table():
    experiment = load_experiment("track", ["drem.rate=7.0"])
    assert experiment.controller("drem", robot=experiment.load_robot()).settings.rate == 7.0
    for name in ("noise", "unsure", "every", "spread"):
        with pytest.raises(ConfigError) as error:
            load_experiment("track", [f"drem.{name}=0.0"])
        assert error.value.key == f"drem.{name}"
