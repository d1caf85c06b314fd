"""The two-layer network with a prediction error: its step against finite differences, its memory, and a closed loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import assert_engines_agree, assert_frozen, assert_it_resumes, made
from numba import config
from test_composite import EIGHT
from test_concurrent import CIRCLE

from mmnn_pin.errors import ConfigError
from mmnn_pin.loop.sample import Torque
from mmnn_pin.signals import Layout
from mmnn_pin.torque.neural import MEASURED, Inputs
from mmnn_pin.torque.two_layer_composite import TwoLayerCompositeSettings, descend, estimate, keep_sample, recollect

seeds = st.integers(0, 2**32 - 1)


def parts_of(loop):
    controller, context = loop.controller, loop.context()
    return controller.law(context).learner, controller.init(context), context.layout


def output(W, V, x):
    return W.T @ (1 / (1 + np.exp(-V.T @ x)))


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_a_step_is_the_gradient_over_its_size(seed):
    """Against central differences of |e / unit|^2 / 2, and the size |J|^2 of the output's derivative."""
    a, _, _ = parts_of(made("two_layer_composite"))
    rng, m = np.random.default_rng(seed), 2
    h, nx, unit = a.net.size, a.x.size, np.array([3.0, 0.5])
    W, V, x = unit * rng.standard_normal((h, m)), rng.standard_normal((nx, h)), rng.standard_normal(nx)
    torque = unit * rng.standard_normal(m)

    def cost(W, V):
        return 0.5 * np.sum(((torque - output(W, V, x)) / unit) ** 2)

    def slopes(A, f):
        found = np.zeros(A.shape)
        for place in np.ndindex(*A.shape):
            d = np.zeros(A.shape)
            d[place] = 1e-6
            found[place] = (f(A + d) - f(A - d)) / 2e-6
        return found

    gW, gV = slopes(W, lambda A: cost(A, V)), slopes(V, lambda A: cost(W, A))
    sigma = 1 / (1 + np.exp(-V.T @ x))
    Jv = np.array([np.outer(x, sigma * (1 - sigma) * W[:, i] / unit[i]) for i in range(m)])
    size = 1 + sigma @ sigma + np.sum(Jv**2)
    newW, newV = W.copy(), V.copy()
    descend(a, newW, newV, x, torque, unit)
    np.testing.assert_allclose(newW - W, -a.rate * gW * unit**2 / size, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(newV - V, -a.rate * gV / size, rtol=1e-5, atol=1e-8)
    before, after = (np.linalg.norm((torque - output(*pair, x)) / unit) for pair in ((W, V), (newW, newV)))
    assert (1 - a.rate) ** 2 * before * 0.9 <= after <= before * (1 + 1e-9)


def test_the_input_is_that_of_a_reference_followed_exactly():
    """Every signal that a network may see: the row of a robot that is where its reference is, moving as it does."""
    loop = made("two_layer_composite")
    loop = replace(loop, controller=replace(loop.controller, inputs=Inputs(signals=MEASURED, bias=0.5, scale=2.0)))
    a, state, layout = parts_of(loop)
    f, rng = a.filter, np.random.default_rng(0)
    for values in (f.pose, f.q, f.nu, f.nudot):
        values[:] = rng.standard_normal(values.size)
    row, nb = layout.new_row(), layout.base
    same = {
        f.pose.tobytes(): ("pose", "pose_ref"), f.q.tobytes(): ("q", "q_ref"), f.nu.tobytes(): ("nu_ref",),
        f.nudot.tobytes(): ("nudot_ref",), f.nu[:nb].tobytes(): ("velocity", "velocity_ref", "alpha"),
        f.nu[nb:].tobytes(): ("qdot", "qdot_ref"), f.nudot[:nb].tobytes(): ("acceleration_ref", "alphadot"),
        f.nudot[nb:].tobytes(): ("qddot_ref",),
    }  # fmt: skip
    for values, names in same.items():
        for name in names:
            row[layout.where(name)] = np.frombuffer(values)
    Torque(loop.controller, loop.context(), row, loop.robot, state).answer(0.0)
    recollect(a)
    np.testing.assert_array_equal(a.x, state["x"])


@settings(max_examples=20, deadline=None)
@given(st.sampled_from([2, 4, 10]), st.integers(1, 200))
def test_what_is_kept_is_spread_evenly_over_the_run(entries, samples):
    a, _, layout = parts_of(made("two_layer_composite"))
    counts, kept = np.array([0.0, 0.0, 1.0]), np.zeros((entries, a.x.size + layout.dof))
    for k in range(samples):
        if k % int(counts[2]) == 0:
            a.x[:], a.filter.torque[:] = k, -k
            keep_sample(a, counts, kept)
    taken = kept[: int(counts[1]), 0]
    np.testing.assert_array_equal(taken, counts[2] * np.arange(counts[1]))
    np.testing.assert_array_equal(kept[: int(counts[1]), -1], -taken)
    assert len(taken) >= min(samples / 2, entries / 2) and taken[-1] > samples - 1 - counts[2]


@settings(max_examples=10, deadline=None)
@given(seeds, st.floats(0, 8))
def test_the_weights_stay_bounded_whatever_the_sensors_say(seed, size):
    loop, rng = (
        made("two_layer_composite", "two_layer_composite.bound=7.0", "two_layer_composite.pole=1000.0"),
        np.random.default_rng(seed),
    )
    a, state, layout = parts_of(loop)
    row = layout.new_row()
    for k in range(40):
        row[:] = 10.0**size * rng.standard_normal(row.size)
        row[0] = k * a.filter.h
        estimate(row, layout.offsets, a, state.values)
        state["held"] = row[layout.where("torque")]
        unit = {"1": a.unit[:2], "2": a.unit[2:]}
        for i in "12":
            assert np.linalg.norm(state[f"W{i}"] / unit[i]) <= 7.0 * (1 + 1e-9)
            assert np.linalg.norm(state[f"V{i}"]) <= max(7.0, np.sqrt(state[f"V{i}"].size) * 0.5) * (1 + 1e-9)
    assert state["counts"][1] > 0


@pytest.mark.compiled
def test_engines_batch_resumption_and_freezing():
    loop = made("two_layer_composite", "two_layer_composite.entries=7")
    assert_engines_agree(loop)
    assert_it_resumes(loop, loop.timing.duration / 2)
    assert_frozen(loop)


def explained(controller, state, rows, loop):
    """Mean square of what frozen weights leave of Psi, over its variance."""
    layout, still = Layout.of(loop.robot.dimensions), replace(controller, learning=False)
    row, left = layout.new_row(), []
    torque = Torque(still, loop.context(), row, loop.robot, state.snapshot())
    psi = rows["psi"]
    for k in range(0, len(rows), 5):
        for name in rows:
            row[layout.where(name)] = rows[name][k]
        torque.answer(rows.time[k])
        torque.keep()
        left.append(psi[k] - row[layout.where("psi_hat")])
    return np.mean(np.mean(np.square(left), axis=0) / np.var(psi, axis=0))


@pytest.mark.long
@pytest.mark.skipif(config.DISABLE_JIT, reason="needs a long run")
def test_without_its_memory_it_follows_and_forgets():
    """Frozen on an eight 1.3 times faster: a network that sees only the newest sample explains nothing."""
    faster = [text.replace("12.0", "9.23").replace("4.0", "3.08").replace("3.0", "2.31") for text in EIGHT]
    truth = made("computed_torque", *faster, duration=10.0).run()
    left = {}
    for replays in (0, 4):
        loop = made("two_layer_composite", *EIGHT, f"two_layer_composite.replays={replays}", duration=24.0)
        run = loop.run()
        state = loop.controller.init(loop.context())
        state.values[:] = run.final["controller_state"]
        left[replays] = explained(loop.controller, state, truth, loop)
        assert "not excited" not in run.outcome.message
    assert left[4] < 0.25 and left[4] < 0.4 * left[0]
    assert "not excited" in made("two_layer_composite", *CIRCLE, duration=12.0).run().outcome.message


def test_impossible_settings_are_refused_with_their_key():
    for name, value in (("rate", 2.0), ("rate", -0.1), ("entries", 0), ("unit", 0.0), ("pole", np.nan)):
        with pytest.raises(ConfigError) as error:
            TwoLayerCompositeSettings(**{name: value})
        assert error.value.key == f"two_layer_composite.{name}"
    loop = made("two_layer_composite", "feedback.base=0.0")
    with pytest.raises(ConfigError, match="needs all > 0"):
        loop.controller.law(loop.context())
