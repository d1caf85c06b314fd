"""The default learner: it starts as feedforward; its estimate against a dense filter; what counts of it; its gain."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import assert_engines_agree, assert_frozen, assert_it_resumes, made
from numba import config
from robots import fixed_arm, mobile_arm
from scipy.signal import lfilter

from mmnn_pin import Feedback, load_experiment
from mmnn_pin.errors import ConfigError
from mmnn_pin.lab.psi.learner import frozen_psi_hat, recorded_learner
from mmnn_pin.lab.psi.subject import finite_rows
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.signals import Layout
from mmnn_pin.torque.controller import Context
from mmnn_pin.torque.feedforward import Feedforward, FeedforwardSettings, forward
from mmnn_pin.torque.learned import (
    BELIEVED,
    EQUATIONS,
    HEAVY,
    MOVES,
    LearnedFeedforward,
    LearnedParts,
    LearnedSettings,
    feed_forward,
    predict,
    share,
)

H = 1e-3


def bench(robot, kind=LearnedFeedforward, settings=LearnedSettings, rate=20.0, **own):
    """Dimensions, numbers and state of a controller with a file whose masses are a fifth too large."""
    layout, n = Layout.of(robot.dimensions), robot.dimensions.arm
    K = Feedback(300.0 if robot.dimensions.base else None, tuple(np.linspace(5.0, 9.0, n)))
    theta = parameters(robot.with_masses(1.2))
    controller = kind(feedback=K, settings=settings(rate=rate, **own), motion=Regressor.of(robot), theta=theta)
    context = Context(layout, H, 10)
    state = controller.init(context)
    return layout, controller.law(context).learner, state


@pytest.mark.parametrize("robot", [mobile_arm(3), fixed_arm(4)], ids=["mobile", "fixed"])
def test_before_it_has_learned_it_is_feedforward(robot):
    layout, a, state = bench(robot)
    _, b, theirs = bench(robot, Feedforward, FeedforwardSettings)
    o, rng = state.view(LearnedParts), np.random.default_rng(0)
    row, other = layout.new_row(), layout.new_row()
    for _ in range(3):
        row[:] = other[:] = rng.standard_normal(row.size)
        feed_forward(row, layout.offsets, a, o)
        forward(other, layout.offsets, b, theirs.values)
        psi = other[layout.where("psi_hat")]
        np.testing.assert_allclose(row[layout.where("psi_hat")], psi, rtol=1e-10, atol=1e-10 * np.abs(psi).max())


def beyond_belief(a, o, W):
    """How far a W (k,) is from the file, over what its doubt allows."""
    z = (W - a.theta0)[o.prior > 0.0] / np.sqrt(o.prior[o.prior > 0.0])
    z[np.isin(np.flatnonzero(o.prior > 0.0), a.carrying)] /= HEAVY
    return np.linalg.norm(z) / BELIEVED


@pytest.mark.parametrize(("size", "leaves"), [(1.0, False), (10.0, True)])
def test_its_estimate_is_that_of_a_dense_filter_and_stands_where_a_velocity_stands(size, leaves):
    """`W += P phi e / (R + phi' P phi)` row by row with a dense P, then back to the rim; the second velocity stands."""
    _, a, state = bench(fixed_arm(3), drift=0.0, change=0.0, load=0.0)
    o, rng, K = state.view(LearnedParts), np.random.default_rng(1), a.gain
    W, P, still, left = o.W[0].copy(), np.diag(o.D), 1, False
    o.moving[:] = 1.0
    o.moving[still] = 0.99 * MOVES
    for _ in range(20):
        Phi, Y = rng.standard_normal((3, W.size)), size * rng.standard_normal(3)
        o.filtered.Phi_f[:], o.filtered.Y_f[:], o.counts[6] = Phi, Y + Phi @ a.theta0, float(a.every)
        predict(a, o)
        for i in (0, 2):
            phi = Phi[i] / K[i]
            gain = P @ phi / (a.noise + phi @ P @ phi)
            W = W + gain * (o.filtered.Y_f[i] / K[i] - W @ phi)
            P = P - np.outer(gain, phi @ P)
        beyond = max(beyond_belief(a, o, W), 1.0)
        W, left = a.theta0 + (W - a.theta0) / beyond, left or beyond > 1.0
    assert left == leaves
    np.testing.assert_allclose(o.W[0], W, rtol=1e-6, atol=1e-9 * np.abs(W).max())
    assert share(o, still) == o.agrees[:, still].max() == 0.0 < o.agrees[0, 0]


@given(st.integers(0, 2**32 - 1), st.floats(-3.0, 8.0), st.floats(-3.0, 8.0))
def test_whatever_it_is_told_it_believes_no_robot_that_its_file_cannot_be(seed, torques, features):
    """Torques and features of any size; what it says then is within so many deviations of what the file leaves open."""
    _, a, state = bench(fixed_arm(3))
    o, rng = state.view(LearnedParts), np.random.default_rng(seed)
    o.moving[:] = 1.0
    for _ in range(10):
        o.filtered.Phi_f[:] = 10.0**features * rng.standard_normal((3, o.D.size))
        o.filtered.Y_f[:], o.counts[6] = 10.0**torques * rng.standard_normal(3), float(a.every)
        predict(a, o)
        beyond = beyond_belief(a, o, o.W[0])
        assert beyond < 1.0 + 1e-9
        if beyond > 1.0 - 1e-9:
            assert share(o, 0) == share(o, 1) == share(o, 2) == 0.0
    allowed = o.prior.copy()
    allowed[a.carrying] *= HEAVY**2
    phi = rng.standard_normal(o.D.size)
    assert abs(phi @ (o.W[0] - a.theta0)) <= BELIEVED * np.sqrt(phi @ (allowed * phi)) * (1.0 + 1e-9)


def predictions(beyond, said, rate):
    """A learner after predictions (N,) of its last velocity, and what it had beyond its file."""
    _, a, state = bench(fixed_arm(3), rate=rate, noise=1e6)  # so sure of nothing that it learns no more
    o = state.view(LearnedParts)
    o.moving[:], o.W[0] = 1.0, a.theta0
    o.W[0, -1] += 1.0  # its constant
    for torque, one in zip(beyond, said, strict=True):
        o.filtered.Y_f[2], o.desired[2, 2, -1], o.counts[6] = a.gain[2] * torque, a.gain[2] * one, float(a.every)
        predict(a, o)
    return a, o


@pytest.mark.parametrize("rate", [0.0, 7.0])
def test_its_worth_is_that_of_sums_over_what_an_error_shows(rate):
    """Both signals through `(1 - 1 / (1 + p / rate)) / (1 + p / rate)` by scipy, then James and Stein's share."""
    beyond, said = np.random.default_rng(3).standard_normal((2, 400))
    beyond = beyond + said
    a, o = predictions(beyond, said, rate)
    w = rate * a.interval / (1.0 + rate * a.interval)
    if rate:
        low = lfilter([w], [1.0, w - 1.0], np.array([beyond, said]))
        beyond, said = low - lfilter([w], [1.0, w - 1.0], low)
    weight = a.forget ** np.arange(400)[::-1]
    aa, ab, bb = (weight * beyond**2).sum(), (weight * beyond * said).sum(), (weight * said**2).sum()
    expected = min(ab / bb, 1.0) * (1.0 - (aa * bb / ab**2 - 1.0) / EQUATIONS)
    assert 0.3 < expected < 0.95
    np.testing.assert_allclose(share(o, 2), expected, rtol=1e-6)


def test_what_fits_by_chance_counts_for_nothing():
    """Of predictions that have nothing to do with the torque half fit it a little; their share of it is nearly 0."""
    found = []
    for seed in range(20):
        beyond, said = np.random.default_rng(seed).standard_normal((2, 500))
        _, o = predictions(beyond, said, 0.0)
        found.append(share(o, 2))
    assert max(found) == 0.0


def test_what_the_integral_answers_is_no_merit():
    """A slow torque that was predicted, and a fast one that was not: what was learned counts little."""
    time = np.arange(2000) * 0.01
    slow, fast = np.sin(0.5 * time), 0.2 * np.sin(20.0 * time)
    _, o = predictions(slow, slow + fast, 20.0)
    _, without = predictions(slow, slow + fast, 0.0)
    assert share(o, 2) < 0.05 < 0.9 < share(without, 2)


@pytest.mark.parametrize(("factor", "expected"), [(2.0, 1.0), (1.0, 1.0), (0.4, 0.4), (-1.0, 0.0)])
def test_what_was_learned_counts_as_far_as_it_has_predicted(factor, expected):
    """Measured torque is the file's, and `factor` times what was learned: that part of it is said."""
    layout, a, state = bench(fixed_arm(3), noise=1e6)  # so sure of nothing that it learns no more
    o, rng = state.view(LearnedParts), np.random.default_rng(2)
    o.moving[:] = 1.0
    learned = 0.3 * np.sqrt(o.prior) * rng.standard_normal(a.theta0.size)
    o.W[0] = a.theta0 + learned
    for _ in range(50):
        Phi = rng.standard_normal((3, learned.size))
        o.filtered.Phi_f[:], o.filtered.Y_f[:], o.counts[6] = Phi, Phi @ (a.theta0 + factor * learned), float(a.every)
        o.desired[2] = Phi
        predict(a, o)
    row = layout.new_row()
    row[:] = rng.standard_normal(row.size)
    feed_forward(row, layout.offsets, a, o)
    said = a.Phi @ (a.theta0 + expected * learned)
    np.testing.assert_allclose(row[layout.where("psi_hat")], said, rtol=1e-5, atol=1e-5 * np.abs(said).max())


def test_engines_batch_resumption_and_freezing():
    loop = made("learned")
    run = assert_engines_agree(loop)
    assert config.DISABLE_JIT or np.ptp(run.weights["W"], axis=0).max() > 0.0
    assert_it_resumes(loop, loop.timing.duration / 2)
    assert_frozen(loop)


def test_a_look_ahead_leaves_the_integral_as_it_is():
    """The integral after a run in which Psi_hat leads is that of its errors: `rate K (e + k int e)`."""
    loop = made("feedforward", "lead=true", "feedforward.rate=20")
    run, h = loop.run(), loop.timing.control_period
    e, own = run["e"], run["r"] - run["edot"]
    n = len(e)
    gathered = h * own.sum(axis=0) + e[n - 1] - e[0] + h * run["edot"][0]
    state = loop.controller.init(loop.context())
    state.values[:] = run.final["controller_state"]
    K = loop.controller.feedback.vector(loop.robot.dimensions)[-e.shape[1] :]
    np.testing.assert_allclose(state["integral"][-e.shape[1] :], 20.0 * K * gathered, rtol=1e-9)


def test_a_recording_has_all_that_its_frozen_output_depends_on():
    """Frozen as it ended it says along the run what its last state says: estimate, its worth and integral are kept."""
    loop = made("learned")
    run = loop.run()
    learner = recorded_learner(run, loop.robot)
    rows = finite_rows(run, learner.context.layout)[:50]
    state = loop.controller.init(loop.context())
    state.values[:] = run.final["controller_state"]
    found = frozen_psi_hat(learner, learner.end, rows)
    expected = frozen_psi_hat(learner, state, rows)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    assert config.DISABLE_JIT or np.abs(state["agrees"]).max() > 0.0


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="seconds of control samples")
@pytest.mark.parametrize("said", [["masses=1.2"], ["friction.coulomb=1.0", "friction.arm=0.5"]])
def test_it_ends_with_less_error_than_feedforward(said):
    """Seconds 6 to 10 on a fixed arm whose file is wrong: masses, or friction that it does not know."""
    experiment = load_experiment("track", ["robot=panda", *said])
    robot = experiment.load_robot()
    errors = {}
    for name in ("feedforward", "learned"):
        run = experiment.loop(robot, experiment.controller(name, robot=robot)).run()
        assert run.outcome.status == "completed"
        errors[name] = np.sqrt(np.mean(run["true_e"][6000:] ** 2))
    assert errors["learned"] < 0.6 * errors["feedforward"]


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="seconds of control samples")
def test_differences_of_coarse_encoders_teach_it_nothing_that_harms():
    """An arm whose velocities are differences of 1 mrad, masses a fifth wrong: then it is as good as `feedforward`."""
    said = ["masses=1.2", "sensor.resolution=0.001", "time.control_period=0.002", "sensor.velocity=difference"]
    experiment = load_experiment("track", ["robot=panda", *said])
    robot = experiment.load_robot()
    errors = {}
    for name in ("feedforward", "learned"):
        run = experiment.loop(robot, experiment.controller(name, robot=robot)).run()
        errors[name] = np.sqrt(np.mean(run["true_e"][run["time"] > 4.0] ** 2))
    assert errors["learned"] < 1.05 * errors["feedforward"]


def errors_along(robot, masses, disturbance):
    """Errors of the arm (samples, n) with `feedforward` and with `learned`, and times."""
    said = [f"robot={robot}", f"masses={masses}", "reference.arm.amplitude=0.1", f"disturbances=[{disturbance}]"]
    experiment = load_experiment("track", said)
    made = experiment.load_robot()
    runs = [experiment.loop(made, experiment.controller(name, robot=made)).run() for name in ("feedforward", "learned")]
    return [np.abs(run["true_e"]).max(axis=1) for run in runs], runs[0]["time"]


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="seconds of control samples")
@settings(max_examples=6)
@given(st.floats(0.8, 1.2), st.floats(250.0, 2000.0), st.floats(1.0, 5.0))
def test_a_hand_that_was_held_is_thrown_no_further_than_without_learning(masses, grip, held):
    """A door holds the hand of an arm without `[touch]`, for a while, and lets it go."""
    door = f'{{type="door",grip={grip:.0f},start=3.0,end={3.0 + held:.2f}}}'
    (plain, ours), time = errors_along("panda", round(masses, 2), door)
    free = time > 3.0 + held
    assert ours.max() < 1.1 * plain.max() + 0.03 and ours[free].max() < 1.1 * plain[free].max() + 0.03


def test_its_table_is_one_of_an_experiment():
    experiment = load_experiment("track", ["learned.noise=0.1", "learned.rate=7"])
    own = experiment.controller("learned", robot=experiment.load_robot()).settings
    assert (own.noise, own.rate) == (0.1, 7.0)
    with pytest.raises(ConfigError) as error:
        load_experiment("track", ["learned.noise=0.0"])
    assert error.value.key == "learned.noise"
