"""Composite adaptive control: the prediction error's step against matrices, its decrease, and a closed loop."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from learning import assert_engines_agree, assert_frozen, assert_it_resumes, made
from numba import config
from test_adaptive import REGRESSOR, ROBOT, TRUE, Bench, divergence, dual

from mmnn_pin.errors import ConfigError
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.torque.adaptive import AdaptiveSettings
from mmnn_pin.torque.adaptive_composite import (
    ENOUGH,
    AdaptiveComposite,
    AdaptiveCompositeSettings,
    Composite,
    descend,
    follow,
    gather,
    pushed,
)
from mmnn_pin.torque.pseudo_inertia import factor, pseudo_inertias, vector_of

seeds = st.integers(0, 2**32 - 1)
EXAMPLES = 4 if config.DISABLE_JIT else 15  # plain Python takes a hundred times as long


class Follower(Bench):
    """An adaptive controller's prediction error alone."""

    def __init__(self, adapting=None, **predicting):
        super().__init__(h=1e-3, rate=3.0, **(adapting or {}))
        own = AdaptiveCompositeSettings(**{"every": 1e-3} | predicting)
        self.controller = AdaptiveComposite(REGRESSOR, self.controller.feedback, self.adapting, composite=own)
        context = made("adaptive_composite").context()
        self.context = type(context)(context.layout, self.h, 10)
        self.p, self.state = self.controller.law(self.context).learner, self.controller.init(self.context)
        self.theta, self.a = self.state["theta"], self.p.adaptation
        self.bodies, self.o = self.a.bodies, self.state.view(Composite)
        self.theta[REGRESSOR.inertial :] += 0.1  # off the walls

    def factors(self):
        for b in range(len(self.bodies.roots)):
            factor(self.theta[10 * b : 10 * b + 10], self.bodies, b)

    def units(self):
        """An orthonormal basis of symmetric matrices, one set per body, and of the rest; a row each."""
        bodies, rest = len(self.bodies.roots), self.bodies.rates.size
        found = []
        for i in range(4):
            for j in range(i, 4):
                E = np.zeros((4, 4))
                E[i, j] = E[j, i] = 1.0 if i == j else np.sqrt(0.5)
                found.append(E.ravel())
        whole = np.kron(np.eye(bodies), np.array(found))
        return np.block([[whole, np.zeros((len(whole), rest))], [np.zeros((rest, whole.shape[1])), np.eye(rest)]])

    def S(self):
        """Gamma = S S', column by column."""
        self.factors()
        columns = []
        for unit in self.units():
            pushed(unit.copy(), self.bodies, self.p.velocity)
            columns.append(self.p.velocity.copy())
        return np.array(columns).T


def told(rng, bench, rows=8, truth=TRUE):
    """Q and b of a few random equations that the truth obeys."""
    Y = rng.standard_normal((rows, REGRESSOR.size))
    bench.state["Q"] = Y.T @ Y
    bench.state["b"] = bench.state["Q"] @ truth


def test_q_and_b_are_kreisselmeiers_integrals():
    bench, rng = Follower(forgetting_time=0.05), np.random.default_rng(0)
    k, p = REGRESSOR.size, ROBOT.dimensions.dof
    Q, b, keep = np.zeros((k, k)), np.zeros(k), np.exp(-1e-3 / 0.05)
    for _ in range(5):
        Y, y = rng.standard_normal((p, k)), rng.standard_normal(p)
        bench.state["Phi_f"], bench.state["Y_f"] = Y, y
        gather(bench.p, bench.o)
        R = np.diag(1 / bench.a.gain)
        Q, b = keep * Q + (1 - keep) * Y.T @ R @ Y, keep * b + (1 - keep) * Y.T @ R @ y
    np.testing.assert_allclose(bench.state["Q"], Q, atol=1e-12)
    np.testing.assert_allclose(bench.state["b"], b, atol=1e-12)


def test_gamma_is_the_natural_metric():
    """S S' g is what P' = gamma P L P gives for every body, and rate times g for the rest."""
    bench = Follower()
    S, g, first = bench.S(), np.random.default_rng(2).standard_normal(REGRESSOR.size), REGRESSOR.inertial
    for b, P in enumerate(pseudo_inertias(bench.theta[:first])):
        expected = vector_of(3.0 * P @ dual(g[10 * b : 10 * b + 10]) @ P)
        np.testing.assert_allclose((S @ S.T @ g)[10 * b : 10 * b + 10], expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose((S @ S.T @ g)[first:], bench.bodies.rates * g[first:], atol=1e-12)


@settings(max_examples=EXAMPLES, deadline=None)
@given(seeds, st.floats(-3, 6))
def test_a_step_is_implicit_euler(seed, size):
    """Against numpy's solution of (1 + c tau S' Q S) y = c tau S' (b - Q theta)."""
    bench, rng = Follower(weight=10.0**size), np.random.default_rng(seed)
    told(rng, bench)
    S, Q, b, tau = bench.S(), bench.state["Q"], bench.state["b"], bench.p.weight
    assert tau == pytest.approx(10.0**size * 1e-3)
    A, g = np.eye(S.shape[1]) + tau * S.T @ Q @ S, tau * S.T @ (b - Q @ bench.theta)
    descend(bench.p, bench.bodies, bench.o)
    found = bench.units() @ bench.p.step
    assert np.linalg.norm(A @ found - g) <= 1.1 * np.sqrt(ENOUGH) * np.linalg.norm(g)
    left = 1.1 * np.sqrt(ENOUGH) * np.linalg.norm(g) * np.linalg.norm(S @ np.linalg.inv(A), 2)  # of that residual
    np.testing.assert_allclose(bench.S() @ found, S @ np.linalg.solve(A, g), atol=left + 1e-9)


@pytest.mark.compiled
@settings(max_examples=EXAMPLES, deadline=None)
@given(seeds, st.floats(-3, 6))
@example(34613, 3.75)
def test_no_step_goes_away_from_the_truth_whatever_its_weight(seed, size):
    """D(P || P_hat) + ... never grows for exact equations.

    Once they are met to half of the digits it would fall by less than its last digit, and moves by rounding alone.
    """
    bench = Follower(adapting={"bounds": 1e9, "heaviest": 1e9, "friction_bound": 1e9}, weight=10.0**size)
    rng = np.random.default_rng(seed)
    truth = TRUE.copy()
    truth[REGRESSOR.inertial :] = 0.5
    told(rng, bench, truth=truth)
    Q, b, half = bench.state["Q"], bench.state["b"], np.sqrt(np.finfo(float).eps)
    for _ in range(20):
        if (np.abs(b - Q @ bench.theta) <= half * (np.abs(Q) @ np.abs(bench.theta) + np.abs(b))).all():
            break
        before = bench.distance(truth)
        follow(bench.p, bench.o)
        assert bench.distance(truth) <= before * (1 + 1e-12)


@pytest.mark.compiled
@settings(max_examples=EXAMPLES, deadline=None)
@given(seeds)
def test_v_falls_by_the_square_of_the_prediction_error(seed):
    """V' = -c theta~' Q theta~, by a small step."""
    bench, rng = Follower(weight=1e-6), np.random.default_rng(seed)
    truth = TRUE.copy()
    truth[REGRESSOR.inertial :] = 0.5
    told(rng, bench, truth=truth)
    before, error = bench.distance(truth), truth - bench.theta
    follow(bench.p, bench.o)
    expected = bench.p.weight * error @ bench.state["Q"] @ error
    assert before - bench.distance(truth) == pytest.approx(expected, rel=0.02)


@pytest.mark.compiled
@settings(max_examples=EXAMPLES, deadline=None)
@given(seeds, st.floats(0, 9))
def test_the_estimate_stays_physical_and_bounded_whatever_was_filtered(seed, size):
    bench, rng = Follower(adapting={"bounds": 7.0}), np.random.default_rng(seed)
    starts = pseudo_inertias(bench.controller.start()[: REGRESSOR.inertial])
    for _ in range(5):
        bench.state["Q"] = 10.0**size * (A := rng.standard_normal((64, 64))) @ A.T
        bench.state["b"] = 10.0**size * rng.standard_normal(64)
        follow(bench.p, bench.o)
        for P, P0 in zip(pseudo_inertias(bench.theta[: REGRESSOR.inertial]), starts, strict=True):
            ratios = np.linalg.eigvals(np.linalg.solve(P0, P)).real
            assert ratios.min() > 1 / 7.01 and ratios.max() < 7.01
        assert (bench.theta[REGRESSOR.inertial :] >= 0).all()


@pytest.mark.compiled
def test_engines_batch_resumption_and_freezing():
    loop = made("adaptive_composite")
    assert_engines_agree(loop)
    assert_it_resumes(loop, loop.timing.duration / 2)
    assert_frozen(loop)
    assert not any(name in made("adaptive").controller.init(loop.context()).shapes for name in ("Q", "b"))


def error_of(run):
    theta = run.weights["theta"][-1]
    gram, truth = REGRESSOR.gram(), parameters(ROBOT)
    return (theta - truth) @ gram @ (theta - truth) / (truth @ gram @ truth)


EIGHT = [
    "reference.base={type='eight', length=1.5, width=0.75, period=12.0, ramp=1.0}",
    "reference.arm=[{type='sine', amplitude=0.785, period=4.0, phase=1.57},"
    "{type='sine', amplitude=0.785, period=3.0, phase=1.57}]",
]
COARSE = ["sensor.velocity=difference", "sensor.resolution=0.0005", "sensor.wheel_resolution=0.0005"]


@pytest.mark.skipif(config.DISABLE_JIT, reason="needs a long run")
def test_it_knows_after_a_motion_what_the_tracking_error_alone_does_not_tell():
    known = {name: error_of(made(name, *EIGHT, duration=24.0).run()) for name in ("adaptive", "adaptive_composite")}
    assert known["adaptive_composite"] < 1e-3 < 0.1 * known["adaptive"]


@pytest.mark.long
@pytest.mark.skipif(config.DISABLE_JIT, reason="needs a long run")
def test_coarse_encoders_do_not_carry_it_away():
    """Differenced velocities at 500 Hz, steps of half a milliradian: the tracking law is lost, or at the limits."""
    said = [*EIGHT, *COARSE, "sensor.velocity_noise=0"]
    away, kept = (made(name, *said, duration=24.0).run() for name in ("adaptive", "adaptive_composite"))
    lost = made("adaptive", *said, "learning.within_limits=false", duration=24.0).run()
    assert lost.outcome.status == "diverged" and away.outcome.status == kept.outcome.status == "completed"
    assert error_of(kept) < 0.1 and error_of(away) > 1


def test_impossible_settings_are_refused_with_their_key():
    for name, value in (("weight", -1.0), ("forgetting_time", 0.0), ("every", 0.0), ("pole", np.nan)):
        with pytest.raises(ConfigError) as error:
            AdaptiveCompositeSettings(**{name: value})
        assert error.value.key == f"adaptive_composite.{name}"
    assert AdaptiveSettings().rate and divergence(np.eye(4), np.eye(4)) == 0.0
