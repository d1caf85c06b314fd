"""The fit of the friction features: what they say of joints that it never saw, and LuGre's friction itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from mmnn_pin.torque.friction_features import features, friction, shipped
from research.studies import friction_features as study

motions = st.floats(-20.0, 20.0)


@given(nu=motions, a=motions)
def test_features_are_the_two_layers_and_turn_round_with_the_motion(nu: float, a: float) -> None:
    f, there, back = friction(), np.zeros(4), np.zeros(4)
    features(f, nu, a, there)
    features(f, -nu, -a, back)
    W1, W2 = shipped()
    assert there == pytest.approx(W2 @ np.tanh(W1 @ study.inputs(np.array(nu), np.array(a))), rel=1e-12, abs=1e-12)
    assert (there == -back).all()


def test_they_say_the_friction_of_joints_that_they_were_not_fitted_on() -> None:
    """Another seed than the fit's and its judge's; the combination from the first half of a motion."""
    others = study.joints(40, seed=77)
    W1, W2 = shipped()
    without, found = (study.judged((first, W2), others) for first in (np.zeros_like(W1), W1))
    assert np.median(found) < 0.1 * np.median(without)
    assert found.mean() < 0.4 * without.mean()


def test_random_features_of_the_same_size_say_less() -> None:
    others, rng = study.joints(40, seed=78), np.random.default_rng(0)
    random = [
        np.median(study.judged((rng.normal(0, 0.5, (12, 11)), rng.normal(0, 0.5, (4, 12))), others)) for _ in range(3)
    ]
    assert np.median(study.judged(shipped(), others)) < 0.5 * min(random)


def test_a_few_steps_of_the_fit_already_say_more() -> None:
    joints, others = study.joints(40, seed=5), study.joints(20, seed=6)
    before, after = (np.median(study.judged(study.fitted(joints, steps), others)) for steps in (0, 60))
    assert after < 0.8 * before


def test_the_friction_they_are_fitted_on_is_lugres() -> None:
    """Against an adaptive solver along a speed that changes smoothly."""
    time = study.STEP * np.arange(500)
    static, stribeck, bristle = 1.6, 0.05, 3e-3

    def slope(t: float, f: np.ndarray) -> np.ndarray:
        nu = 0.3 * np.sin(3.0 * t)
        return (nu - abs(nu) * f / (1.0 + (static - 1.0) * np.exp(-((nu / stribeck) ** 2)))) / bristle

    exact = solve_ivp(slope, (0.0, 2.0), [0.0], method="Radau", rtol=1e-9, atol=1e-10, t_eval=time[1:])
    nu = 0.3 * np.sin(3.0 * (time + 0.5 * study.STEP))
    ours = study.lugre(nu[None], np.array([static]), np.array([stribeck]), np.array([bristle]))[0]
    assert np.abs(ours[:-1] - exact.y[0]).max() < 0.02
