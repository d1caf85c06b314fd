"""The features of a learner in a tube (theory.md, section 9), against the compiled regressor, differences, attacks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from proofs import KINDS, SLOW, loop_of, subject_of

from mmnn_pin.model.regressor import Regressor
from mmnn_pin.signals import Array
from research.proof.features import Features
from research.proof.periods import Periods
from research.proof.steps import Steps

E = 1e-5  # [m, rad, m/s, rad/s]
PLACES = slice(10, 14)


@pytest.fixture(scope="module", params=KINDS)
def steps(request: pytest.FixtureRequest) -> Steps:
    return Steps(Periods(subject_of(request.param, loop_of(request.param, duration=0.03).run())), 0, 3)


def features_of(steps: Steps) -> Features:
    return Features(Regressor.of(steps.periods.robot), steps.course, steps.signal("q_ref"))


def exact(features: Features, steps: Steps, j: int, y: Array) -> Array:
    """Phi (p, k) at a state of a period, by the compiled regressor, which Pinocchio has checked."""
    seen, position, nu = steps.periods.seen(steps.rows[j], y)
    asked = (seen[steps.periods.layout.where(name)] for name in ("nu_ref", "nudot_ref"))
    return np.asarray(features.regressor.matrix(position, nu, *asked))


def test_values_and_slopes_are_those_of_the_regressor(steps: Steps) -> None:
    features, m, p = features_of(steps), steps.size, steps.periods.layout.dof
    N = PLACES.stop - PLACES.start
    value, slope, _ = features.smooth(PLACES, np.zeros((N, m)))
    dry, most = features.dry(PLACES, np.zeros((N, p)))
    smooth = np.array([not label.endswith(".coulomb") for label in features.regressor.labels])
    assert not most.any()
    for n, j in enumerate(range(PLACES.start, PLACES.stop)):
        Phi = exact(features, steps, j, np.zeros(m))
        np.testing.assert_allclose(value[n] + dry[n], Phi, atol=1e-12 * np.abs(Phi).max())
        for i, y in enumerate(E * np.eye(m)):
            by = (exact(features, steps, j, y) - exact(features, steps, j, -y)) / (2 * E)
            np.testing.assert_allclose(slope[i, n][:, smooth], by[:, smooth], atol=1e-6)


@settings(deadline=None, max_examples=3 if SLOW else 15)
@given(st.integers(0, 2**32 - 1), st.floats(1e-4, 0.3))
def test_no_features_in_a_box_are_further_off_than_their_rest(steps: Steps, seed: int, size: float) -> None:
    """At corners and inside; a smaller box has a rest that is smaller by the square; some come near."""
    rng, features, m = np.random.default_rng(seed), features_of(steps), steps.size
    p, N, nearest = steps.periods.layout.dof, PLACES.stop - PLACES.start, 0.0
    box = np.tile(size * rng.uniform(0.1, 1.0, m), (N, 1))
    value, slope, rest = features.smooth(PLACES, box)
    dry, most = features.dry(PLACES, box[:, -p:])
    share = rng.uniform(0.2, 1.0)
    assert (features.smooth(PLACES, share * box)[2] <= share**2 * rest * (1 + 1e-9) + 1e-15).all()
    bound = rest + most
    for where in (*rng.choice((-1.0, 1.0), (6, m)), *rng.uniform(-1, 1, (2, m))):
        for n, j in enumerate(range(PLACES.start, PLACES.stop)):
            y = where * box[n]
            off = np.abs(exact(features, steps, j, y) - value[n] - dry[n] - np.einsum("z,zij->ij", y, slope[:, n]))
            assert (off <= bound[n] + 1e-12 * (1 + np.abs(value[n]).max())).all()
            there = rest[n] > 1e-9
            nearest = max(nearest, float((off[there] / bound[n][there]).max(initial=0.0)))
    assert nearest > 0.02
