"""A deep residual network: derivatives, the sampled answer, bounds, a Lyapunov function, engines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from learning import assert_engines_agree, assert_frozen, assert_it_resumes, made

from mmnn_pin import Feedback, load_experiment
from mmnn_pin.errors import ConfigError
from mmnn_pin.signals import Layout
from mmnn_pin.torque.controller import Context
from mmnn_pin.torque.deep_residual import DeepResidual, DeepResidualSettings, Weights, estimate
from mmnn_pin.torque.neural import SEEN

LAYOUT = Layout(2, 3, 6, 5)
GAINS = Feedback((400.0, 40.0), (9.0, 3.0, 0.5))
K = GAINS.vector(LAYOUT)
H = 1e-3


def bench(h=H, seed=0, late=0.0, **own):
    """The numbers of a controller, its state with weights at random, and a row of random signals."""
    own = {"hidden": 5, "blocks": 3, "v_range": 0.5} | own
    controller = DeepResidual(GAINS, DeepResidualSettings(**own))
    context = Context(LAYOUT, h, 10, np.random.default_rng(seed), way=late)
    state, row, rng = controller.init(context), LAYOUT.new_row(), np.random.default_rng(seed + 1)
    for name, weight in controller.weights(state).items():
        weight += 0.4 * rng.standard_normal(weight.shape) * (name[0] in "BW")
    for name in SEEN.signals:
        row[LAYOUT.where(name)] = rng.standard_normal(LAYOUT.where(name).stop - LAYOUT.where(name).start)
    return controller.law(context).learner, state, row


def sample(a, state, row, s=None):
    """Psi_hat of one sample; it learns from s (p,), if there is one."""
    row[LAYOUT.where("z")], row[LAYOUT.where("r")] = (
        (np.zeros(5) if s is None else s)[:2],
        (np.zeros(5) if s is None else s)[2:],
    )
    estimate(row, LAYOUT.offsets, a if s is not None else a._replace(learning=False), state.values)
    return row[LAYOUT.where("psi_hat")].copy()


def network(w, i, x):
    """Output of the base's (1) or the arm's (2) network before its scale, written as the equations stand."""
    kappa = getattr(w, f"V{i}").T @ x
    for A, B in zip(getattr(w, f"A{i}"), getattr(w, f"B{i}"), strict=True):
        kappa = kappa + B.T @ np.tanh(A.T @ kappa)
    return getattr(w, f"W{i}").T @ np.tanh(kappa)


def by_equations(state, row, unit=0.1):
    """Psi_hat in plain numpy."""
    w, x = state.view(Weights), SEEN.seen(row[SEEN.rows(LAYOUT)], LAYOUT)
    parts = (K[:2], K[2:])
    return np.concatenate([unit * np.sqrt(k * k.mean()) * network(w, i, x) for i, k in zip((1, 2), parts, strict=True)])


def gradient_of(state, row, s, step=1e-6):
    """Derivative of `s' Psi_hat` by every number of the state, by central differences of the equations."""
    found = np.zeros(state.values.size)
    for j in range(found.size):
        ends = []
        for sign in (1.0, -1.0):
            moved = state.snapshot()
            moved.values[j] += sign * step
            ends.append(s @ by_equations(moved, row))
        found[j] = (ends[0] - ends[1]) / (2 * step)
    return found


def rates_of(state, own):
    """Gamma of every number of the state, in the units of `V`: over `u^2 c`."""
    found = state.snapshot()
    for name in state.shapes:
        c = (K[:2] if name[1] == "1" else K[2:]).mean()
        found[name] = (own.rate if name[0] == "W" else own.inner) / own.hidden / (own.unit**2 * c)
    return found.values


def test_the_output_is_that_of_the_equations():
    a, state, row = bench()
    expected = by_equations(state, row)
    np.testing.assert_allclose(sample(a, state, row), expected, rtol=1e-12)
    assert (np.abs(expected) > 1e-3).all()
    np.testing.assert_array_equal(row[LAYOUT.where("effective_gain")], K)
    squares = [sum((state[name] ** 2).sum() for name in state.shapes if name[1] == i) for i in "12"]
    np.testing.assert_allclose(row[LAYOUT.where("weight_norm")], np.sqrt(squares), rtol=1e-12)


@pytest.mark.parametrize("blocks", [0, 1, 3])
def test_all_layers_move_along_the_gradient(blocks):
    """Without leakage one sample moves theta by h Gamma times the derivative of `s' Psi_hat`, while nothing is cut."""
    own = DeepResidualSettings(hidden=5, blocks=blocks, v_range=0.5, rate=3.0, inner=2.0, leakage=0.0)
    a, state, row = bench(blocks=blocks, rate=3.0, inner=2.0, leakage=0.0)
    s, before = np.array([0.01, -0.02, 0.03, 0.01, -0.02]), state.values.copy()
    expected = H * rates_of(state, own) * gradient_of(state, row, s)
    sample(a, state, row, s)
    np.testing.assert_allclose(state.values - before, expected, rtol=1e-5, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("size", [1e-3, 0.1, 10.0])
def test_a_samples_answer_stays_below_its_share_of_the_feedback(size):
    """`s' (Psi_hat+ - Psi_hat)` is at most share s'Ks, but for the second order, which the small step makes small."""
    for seed in range(20):
        a, state, row = bench(seed=seed, rate=1e6, inner=1e6, leakage=0.0, answer=30.0)
        s = size * np.random.default_rng(seed).standard_normal(5) * np.array([0.2, 1, 1, 1, 1])
        before = sample(a, state, row)
        sample(a, state, row, s)
        answer, most = s @ (sample(a, state, row) - before), 30.0 * H * s @ (K * s)
        assert answer < most * (1 + 0.2 * min(1.0, 1e3 * size)), (seed, answer / most)
        assert size > 1e-2 or answer > 0.99 * most


def test_known_delays_slow_it_down():
    assert bench(answer=1e9)[0].share == pytest.approx(1.0)
    assert bench(answer=1e9, late=4e-3)[0].share == pytest.approx(0.2)
    assert bench(answer=20.0, late=4e-3)[0].share == pytest.approx(0.02)


def test_weights_stay_in_their_balls_whatever_is_measured():
    a, state, row = bench(bound=2.0, rate=1e9, inner=1e9, answer=1e9)
    rng = np.random.default_rng(3)
    for n in range(60):
        for name in SEEN.signals:
            where = LAYOUT.where(name)
            row[where] = 10.0 ** rng.uniform(-3, 8) * rng.standard_normal(where.stop - where.start)
        s = 10.0 ** rng.uniform(-6, 9) * rng.standard_normal(5)
        s[0] = (s[0], np.nan, np.inf)[n % 3] if n % 5 == 4 else s[0]
        sample(a, state, row, s)
        for i in "12":
            assert np.linalg.norm(state[f"W{i}"]) <= 2.0 * (1 + 1e-12)
            assert sum((state[f"{name}{i}"] ** 2).sum() for name in "VAB") <= 4.0 * (1 + 1e-12)
    assert np.linalg.norm(state["W2"]) > 1.0


def test_leakage_takes_back_what_began_at_zero_and_nothing_else():
    a, state, row = bench(leakage=3.0)
    before = state.snapshot()
    sample(a, state, row, np.zeros(5))
    for name in state.shapes:
        kept = np.exp(-3.0 * H) if name[0] in "WB" else 1.0
        np.testing.assert_allclose(state[name], kept * before[name], rtol=1e-14)


def lyapunov(steps, seed=0):
    """V and s along `M sdot = Psi(x, theta) - K s - Psi_hat(x)` with theta in the network's class, by small steps."""
    h = 1e-4
    own = DeepResidualSettings(hidden=5, blocks=3, v_range=0.5, rate=3.0, inner=2.0, leakage=0.0)
    a, state, row = bench(h=h, rate=3.0, inner=2.0, leakage=0.0, seed=seed)
    rng, truth, start = np.random.default_rng(seed + 7), state.snapshot(), state.snapshot()
    truth.values += 0.02 * rng.standard_normal(truth.values.size)
    M, s, rates, found = np.diag(K / 20.0), 0.05 * rng.standard_normal(5), rates_of(state, own), []
    for n in range(steps):
        for name in SEEN.signals:
            where = LAYOUT.where(name)
            row[where] = np.sin(2.0 * h * n * np.arange(1, where.stop - where.start + 1) + where.start)
        wrong = truth.values - state.values
        found.append((0.5 * s @ M @ s + 0.5 * np.sum(wrong**2 / rates), s @ (K * s)))
        psi = by_equations(truth, row)
        s = s + h * np.linalg.solve(M, psi - K * s - sample(a, state, row, s))
    assert np.abs(state.values - start.values).max() > 1e-4
    return np.array(found), h


def test_a_lyapunov_function_falls_where_the_plant_is_in_the_networks_class():
    """V falls by s'Ks per second, up to the second order in theta~ that V' has."""
    found, h = lyapunov(3000)
    V, power = found[:, 0], found[:, 1]
    fallen, fed = V[0] - V[-1], h * power[:-1].sum()
    assert fallen > 0
    assert fallen == pytest.approx(fed, rel=0.05)
    assert (np.diff(V[::100]) < 0).all()


@pytest.mark.compiled
def test_engines_batch_resumption_and_freezing():
    loop = made("deep_residual", "deep_residual.hidden=6")
    run = assert_engines_agree(loop)
    assert np.abs(run["psi_hat"]).max() > 0
    assert_it_resumes(loop, loop.timing.duration / 2)
    assert_frozen(loop)


def test_its_table_its_record_and_what_it_says():
    experiment = load_experiment("track", ["deep_residual.hidden=7"])
    controller = experiment.controller("deep_residual")
    assert controller.settings.hidden == 7
    again = DeepResidual.from_facts("deep_residual", replace(controller, feedback=GAINS).facts(), None)
    assert again.settings == controller.settings and again.feedback == GAINS
    for key, value in {"hidden": 0, "blocks": 101, "unit": 0.0, "rate": -1.0}.items():
        with pytest.raises(ConfigError) as error:
            load_experiment("track", [f"deep_residual.{key}={value}"])
        assert error.value.key == f"deep_residual.{key}"
    context = Context(LAYOUT, H, 10)
    controller = DeepResidual(GAINS)
    state = controller.init(context)
    assert controller.findings(state) == []
    state["W2"] = 100.0
    assert "W2 ended on" in controller.findings(state)[0]
