"""Ideal weights: a minimum of their penalised fit, numbers that fit each other, networks that know Psi."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from proofs import PERIOD, SLOW, learner, loop_of
from scipy.special import expit

from mmnn_pin import Timing
from mmnn_pin.lab.psi.excitation import effective_rank
from mmnn_pin.lab.psi.learner import seen
from mmnn_pin.lab.psi.psi import fvu, psi_of, worst
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.torque.two_layer import TwoLayer
from research.proof import networks as ideal_module
from research.proof.linear import PENALTY, variances
from research.proof.networks import hidden_weights, ideal_weights, output_weights

patient = settings(deadline=None, max_examples=25)
seeds = st.integers(0, 2**32 - 1)
slow = pytest.mark.skipif(SLOW, reason="too long for uncompiled code")


@slow
def test_a_network_that_knows_is_told_from_one_that_follows() -> None:
    """Weights fitted offline, held fixed in a run, know Psi; the weights that the thesis's law leaves do not."""
    loop = loop_of("differential", learner("differential"), duration=1.0)
    subject = Subject.of(loop.run())
    follows = psi_of(subject)
    assert subject.networks is not None
    weights = ideal_weights(subject, subject.networks)
    state = subject.networks.start.snapshot()
    for i, found in weights.items():
        state[f"W{i}"], state[f"V{i}"] = found.W, found.V
    fixed = replace(loop, controller=replace(loop.controller, learning=False))
    knows = psi_of(Subject.of(fixed.run(state=state)))
    np.testing.assert_allclose(knows.frozen["same"].fvu, knows.online)  # held fixed already
    assert worst(knows.frozen["same"].fvu) < 0.2 * min(1.0, worst(follows.frozen["same"].fvu))
    assert np.abs(follows.frozen["same"].psi_hat - subject.signal("psi_hat")).max() > 1e-3


@patient
@given(seeds)
def test_output_weights_are_those_of_penalised_least_squares(seed: int) -> None:
    """Against ordinary least squares on a table with the penalty as further rows."""
    rng = np.random.default_rng(seed)
    hidden, target = rng.uniform(size=(30, 4)), rng.normal(size=(30, 2)) * [1.0, 30.0]
    W = output_weights(hidden, target)
    for i, variance in enumerate(variances(target)):
        table = np.vstack((hidden / np.sqrt(30 * variance), np.sqrt(PENALTY) * np.eye(4)))
        rest = np.concatenate((target[:, i] / np.sqrt(30 * variance), np.zeros(4)))
        np.testing.assert_allclose(W[:, i], np.linalg.lstsq(table, rest, rcond=None)[0], rtol=1e-6, atol=1e-9)


def objective(x: np.ndarray, target: np.ndarray, W: np.ndarray, V: np.ndarray) -> float:
    error = target - expit(x @ V) @ W
    return float(((error**2).mean(axis=0) / variances(target)).sum() + PENALTY * ((W**2).sum() + (V**2).sum()))


def test_ideal_weights_are_a_minimum_and_find_a_network_that_exists(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    x, V, W = rng.normal(size=(300, 3)), rng.normal(size=(3, 4)), rng.normal(size=(4, 2))
    target = expit(x @ V) @ W
    found_V = hidden_weights(x, target, V + 0.3 * rng.normal(size=V.shape))
    found_W = output_weights(expit(x @ found_V), target)
    best = objective(x, target, found_W, found_V)
    assert fvu(target, expit(x @ found_V) @ found_W).max() < 1e-3
    for _ in range(20):
        dW, dV = 1e-2 * rng.normal(size=W.shape), 1e-2 * rng.normal(size=V.shape)
        assert objective(x, target, found_W + dW, found_V + dV) > best
    monkeypatch.setattr(ideal_module, "ITERATIONS", 0)
    start = hidden_weights(x, target, V + 0.3)
    assert objective(x, target, output_weights(expit(x @ start), target), start) > 10 * best


def test_ideal_weights_of_a_run_are_numbers_that_fit_each_other() -> None:
    subject = Subject.of(loop_of("differential", learner("differential"), duration=0.1).run())
    assert subject.networks is not None
    for i, found in ideal_weights(subject, subject.networks).items():
        part = dict(subject.networks.networks)[i]
        x = seen(subject.networks, subject.networks.start, subject.rows).inputs
        error = subject.signal("psi")[:, part] - expit(x @ found.V) @ found.W
        np.testing.assert_allclose(found.eps, np.abs(error).max(axis=0))
        assert found.eps_N == pytest.approx(np.linalg.norm(error, axis=1).max())
        assert found.norm == pytest.approx(np.hypot(np.linalg.norm(found.W), np.linalg.norm(found.V)))
        assert found.distance == pytest.approx(np.hypot(found.distance_W, found.distance_V))
        assert found.distance_W == pytest.approx(np.linalg.norm(found.W - subject.networks.end[f"W{i}"]))
        assert found.assumed == subject.networks.controller.robust.ZB[i - 1] and found.unexplained.max() < 0.1


def test_units_that_start_alike_are_told_apart_by_the_fit() -> None:
    controller = learner("fixed", network=TwoLayer(hidden=4, initial="zero"))
    subject = Subject.of(loop_of("fixed", controller, duration=0.1, timing=Timing(0.1, PERIOD, PERIOD)).run())
    assert subject.networks is not None
    (found,) = ideal_weights(subject, subject.networks).values()
    assert np.linalg.matrix_rank(found.V) > 1 and effective_rank(subject.networks.end["V2"]) == pytest.approx(1)
