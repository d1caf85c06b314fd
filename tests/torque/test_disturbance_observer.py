"""A disturbance observer: its law in closed form, its part of V, engines, and where an experiment has it."""

from __future__ import annotations

import numpy as np
import pytest
from learning import assert_engines_agree, assert_frozen, assert_it_resumes, made

from mmnn_pin import Feedback, load_experiment
from mmnn_pin.errors import ConfigError
from mmnn_pin.signals import Layout
from mmnn_pin.torque.controller import Context
from mmnn_pin.torque.disturbance_observer import DisturbanceObserver, DisturbanceObserverSettings, estimate

LAYOUT = Layout(2, 2, 5, 4)
K = Feedback((400.0, 40.0), 5.0)


def bench(h=1e-3, **own):
    controller, context = DisturbanceObserver(K, DisturbanceObserverSettings(**own)), Context(LAYOUT, h, 10)
    return controller.law(context).learner, controller.init(context), LAYOUT.new_row()


def step(a, state, row, s):
    row[LAYOUT.where("z")], row[LAYOUT.where("r")] = s[:2], s[2:]
    estimate(row, LAYOUT.offsets, a, state.values)
    return row[LAYOUT.where("psi_hat")].copy()


def test_a_constant_error_gives_a_geometric_series():
    """D after n samples is gamma h K s (1 - q^n) / (1 - q), q = exp(-leakage h)."""
    a, state, row = bench(gamma=3.0, leakage=2.0)
    s, k, q = np.array([0.1, -0.2, 0.05, 0.01]), K.vector(LAYOUT), np.exp(-2e-3)
    for n in range(50):
        expected = 3e-3 * k * s * (1 - q**n) / (1 - q)
        np.testing.assert_allclose(step(a, state, row, s), expected, rtol=1e-12, atol=1e-15)
    assert row[LAYOUT.where("weight_norm")][0] == pytest.approx(np.linalg.norm(expected))
    np.testing.assert_array_equal(row[LAYOUT.where("effective_gain")], k)


def test_it_stays_within_its_bounds_whatever_s_is():
    a, state, row = bench(bound=0.5)
    for s in np.random.default_rng(0).standard_normal((50, 4)) * 1e6:
        step(a, state, row, s)
        assert (np.abs(state["d"]) <= 0.5 * K.vector(LAYOUT)).all()


@pytest.mark.compiled
def test_engines_batch_resumption_and_freezing():
    loop = made("disturbance_observer")
    assert_engines_agree(loop)
    assert_it_resumes(loop, loop.timing.duration / 2)
    assert_frozen(loop)


def test_its_table_is_one_of_an_experiment():
    experiment = load_experiment("track", ["disturbance_observer.gamma=7.0"])
    assert experiment.controller("disturbance_observer").settings.gamma == 7.0
    with pytest.raises(ConfigError) as error:
        load_experiment("track", ["disturbance_observer.bound=0.0"])
    assert error.value.key == "disturbance_observer.bound"
