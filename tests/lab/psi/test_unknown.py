"""What a run leaves undetermined: finite differences, closed forms; told after a poor motion, not after a rich one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from proofs import SLOW, learner, loop_of

from mmnn_pin import LearningLaw
from mmnn_pin.lab.psi.excitation import (
    NOISE,
    left,
    random_motion,
    signals_for,
    tangents,
    unknown,
)
from mmnn_pin.lab.psi.learner import Learner
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.one_layer import OneLayer
from mmnn_pin.torque.two_layer import TwoLayer

LONG = pytest.mark.skipif(SLOW, reason="needs a long run")


def forward(x, W, V, kind, width):
    """Output of a network, from the thesis's formulas."""
    if kind == "two_layer":
        return W.T @ (1 / (1 + np.exp(-V.T @ x)))
    return W.T @ np.exp(-((x[:, None] - V) ** 2).sum(axis=0) / (2 * width**2))


@pytest.mark.parametrize("kind", ["two_layer", "one_layer"])
@pytest.mark.parametrize("still", [False, True])
def test_tangents_are_finite_differences(kind, still):
    """Of the output in every weight that is learned, over the root of its rate; one that is not learned has none."""
    network = {
        "two_layer": TwoLayer(hidden=4, F=(2.0, 1.0), G=(0.0, 0.0) if still else (1.5, 0.7), v_range=0.5),
        "one_layer": OneLayer(hidden=4, beta=(1.0, 0.6), width=3.0),
    }[kind]
    subject = Subject.of(loop_of("differential", learner("differential", network=network), duration=0.02).run())
    one = subject.networks
    assert one is not None
    found = tangents(one, one.controller, subject.rows[5:6])
    for i, part in one.networks:
        W, V, m = one.end[f"W{i}"], one.end[f"V{i}"], part.stop - part.start
        x = np.concatenate([subject.signal(name)[5] for name in one.controller.inputs.signals])
        rate_W, rate_V, _ = network.rates(i - 1, False)
        columns = []
        for layer, rate in ((W, rate_W), (V, rate_V if kind == "two_layer" else 0.0)):
            for place in np.ndindex(layer.shape):
                step = np.zeros(layer.shape)
                step[place] = 1e-6
                ends = [
                    forward(x, W + s * step if layer is W else W, V + s * step if layer is V else V, kind, 3.0)
                    for s in (1, -1)
                ]
                columns.append(np.sqrt(rate) * (ends[0] - ends[1]) / 2e-6)
        expected = np.array(columns).T
        J = found[i][0][0]
        assert J.shape[0] == m
        np.testing.assert_allclose(J @ J.T, expected @ expected.T, rtol=1e-5, atol=1e-7)  # whatever their order
        assert (not still and kind == "two_layer") == bool(np.abs(J[:, W.size :]).max(initial=0.0) > 0)


def test_left_in_closed_form():
    """Two independent features: seen, half seen, not seen; a constant one counts for nothing."""
    rng, n = np.random.default_rng(0), 4000
    random = rng.standard_normal((n, 1, 2))
    still = np.zeros((50, 1, 2))
    assert left(random, random)[0] == pytest.approx(NOISE / (1 + NOISE), rel=0.05)
    assert left(still, random) == (pytest.approx(1.0), 2)
    half = still.copy()
    half[:, 0, 0] = 3.0
    assert left(half, random)[0] == pytest.approx(0.5, rel=0.01)
    faint = still.copy()
    faint[:25, 0, 0], faint[25:, 0, 1] = np.sqrt(2 * NOISE), np.sqrt(2 * NOISE)
    assert left(faint, random)[0] == pytest.approx(0.5, rel=0.05)
    with_constant = np.concatenate((random, np.ones((n, 1, 1))), axis=2)
    assert left(np.ones((9, 1, 3)) * [0.0, 0.0, 1.0], with_constant) == (pytest.approx(1.0), 2)


seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_it_is_the_variance_that_least_squares_leave_and_does_not_know_units(seed):
    """By the posterior of a Bayesian linear regression; other coordinates of the weights change nothing."""
    rng, k = np.random.default_rng(seed), 5
    A = rng.standard_normal((k, k)) + 3 * np.eye(k)
    run = rng.standard_normal((40, 2, k)) * np.array([1.0, 1.0, 0.03, 0.0, 0.0])
    random = rng.standard_normal((200, 2, k))
    share, directions = left(run, random)
    centred = random - random.mean(axis=0)
    size = np.sqrt((centred**2).sum(axis=2).mean(axis=0))[:, None]
    prior = np.linalg.inv(np.einsum("nik,nil->kl", centred / size, centred / size) / 200)
    information = np.einsum("nik,nil->kl", run / size, run / size) / 40 / NOISE
    posterior = np.linalg.inv(np.linalg.inv(prior) + information)
    expected = np.trace(posterior @ np.linalg.inv(prior)) / k
    assert share == pytest.approx(expected, rel=1e-6) and directions == k
    Q = np.linalg.qr(A)[0]
    assert left(run @ Q, random @ Q)[0] == pytest.approx(share, rel=1e-6)
    units = np.array([1e3, 1e-2])[:, None]
    assert left(run * units, random * units)[0] == pytest.approx(share, rel=1e-6)


def test_random_motion_is_without_errors_and_within_the_joints_limits():
    subject = Subject.of(loop_of("differential", learner("differential"), duration=0.01).run())
    rows, where = random_motion(subject.robot, subject.layout), subject.layout.where
    for name in ("z", "e", "edot", "r", "pose_error"):
        assert not rows[:, where(name)].any()
    np.testing.assert_array_equal(rows[:, where("nu_ref")], rows[:, where("nu")])
    q = rows[:, where("q")]
    assert (q >= subject.robot.lower[subject.robot.arm_index]).all() and np.ptp(q, axis=0).min() > 1.0


class Bilinear(LearningLaw):
    """Weights of nudot_ref and of nothing else."""

    def init(self, context):
        return ControllerState.of(W=(context.layout.dof, context.layout.dof))

    def features(self, now, state):
        return np.array(now.nudot_ref)

    def estimate(self, now, state):
        return now.nudot_ref @ state["W"]

    def learn(self, now, state):
        state["W"] += now.period * np.outer(now.nudot_ref, now.s)


class Silent(Bilinear):
    """Does not tell its features."""

    def features(self, now, state):
        return None


def test_a_law_that_tells_its_features_is_judged_by_them():
    """By hand: on random motion nudot_ref is white, so the share is that of its Gram matrix along the run."""
    subject = Subject.of(loop_of("differential", Bilinear(), duration=0.05).run())
    own = subject.learner
    assert own is not None
    (found,) = unknown(own, subject.rows).values()
    nudot = subject.signal("nudot_ref")
    excited = np.linalg.eigvalsh(nudot.T @ nudot / len(nudot))
    size = 4  # one row of four features, each of variance one: the output's variance
    expected = np.mean(1 / (1 + excited / NOISE))
    assert found.share == pytest.approx(expected, rel=0.3) and found.directions == size and found.units == 0
    gains = own.controller.feedback
    silent = replace(own, controller=Silent(feedback=gains))
    assert unknown(silent, subject.rows) == {} and signals_for(Silent()) != ()
    assert unknown(replace(own, controller=Bilinear(feedback=gains, learning=False)), subject.rows) == {}
    assert unknown(own, subject.rows[:0]) == {}


@LONG
def test_the_signals_that_are_kept_are_all_that_it_needs():
    loop = loop_of("differential", learner("differential"), duration=0.1)
    whole = Subject.of(loop.run())
    assert whole.learner is not None
    rows = np.zeros_like(whole.rows)
    for name in signals_for(loop.controller):
        rows[:, whole.layout.where(name)] = whole.signal(name)
    assert unknown(whole.learner, rows) == unknown(whole.learner, whole.rows)
    assert isinstance(whole.learner, Learner)
