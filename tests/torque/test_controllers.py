"""Torque controllers: the law, what they may see, what they remember."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import THESIS, with_gains
from places import ROOT
from scipy.special import expit

import mmnn_pin
from mmnn_pin import load_experiment
from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.loop import Loop
from mmnn_pin.model import load
from mmnn_pin.recording.recording import Recording
from mmnn_pin.reference import Hold, Line, Sine, Trajectory
from mmnn_pin.settings import Timing
from mmnn_pin.signals import Array, Dimensions, Layout, Measurement, Setpoint, VelocityCommand
from mmnn_pin.torque import law
from mmnn_pin.torque.controller import (
    CompiledController,
    Context,
    ControllerState,
    Feedback,
    TorqueController,
    per_velocity,
)
from mmnn_pin.torque.model_based import PD, ComputedTorque, ScheduledPD
from mmnn_pin.torque.neural import MEASURED, Inputs, Neural, Robust
from mmnn_pin.torque.one_layer import OneLayer
from mmnn_pin.torque.two_layer import TwoLayer

PLAIN = os.environ.get("NUMBA_DISABLE_JIT") == "1"  # plain Python: short runs only
LAYOUT = Layout(base=2, arm=2, full=7, motors=4)
H, SAMPLES = 0.002, 40
GAINS = Feedback((500.0, 120.0), (30.0, 20.0))
ROBUST = Robust((10.0, 6.0), (0.3, 0.2), (5.0, 3.0))
SMALL = TwoLayer(hidden=5, F=(0.9, 0.2), G=(0.7, 0.1), kappa=0.3)
NEURAL = Neural(SMALL, GAINS, ROBUST)
SEEN = {*MEASURED, "time"}


class Bench:
    """A controller on a bench: rows of our own go in, and what it writes can be read by name."""

    def __init__(self, controller: CompiledController, layout: Layout = LAYOUT, seed: int = 1) -> None:
        self.layout, self.row = layout, layout.new_row()
        controller, context = with_gains(controller), Context(layout, H, SAMPLES, np.random.default_rng(seed))
        self.law, self.state = controller.law(context), controller.init(context)

    def step(self, seed: int, **signals: Any) -> Bench:
        """One sample of random signals, some of them given."""
        self.row[:] = np.random.default_rng(seed).uniform(-1, 1, self.row.size)
        for name, value in signals.items():
            self.row[self.layout.where(name)] = value
        law.step(self.row, self.layout.offsets, self.law.numbers, self.state.values, None, None)
        return self

    def __getitem__(self, name: str) -> Array:
        return self.row[self.layout.where(name)].copy()

    @property
    def s(self) -> Array:
        return np.concatenate((self["z"], self["r"]))

    def weights(self) -> dict[str, Array]:
        return {name: self.state[name].copy() for name in self.state.shapes if name[0] in "WV"}


# --- the law


@pytest.mark.parametrize("controller", [PD(GAINS), ComputedTorque(GAINS)], ids=lambda c: c.name)
def test_constant_gain(controller: CompiledController) -> None:
    bench = Bench(controller).step(2, psi_hat=[1.0, 2.0, 3.0, 4.0])
    k = np.array([500.0, 120.0, 30.0, 20.0])
    np.testing.assert_allclose(bench["torque"], k * bench.s + [1, 2, 3, 4])
    np.testing.assert_array_equal(bench["effective_gain"], k)


def test_scheduled_gain_takes_one_row_per_sample() -> None:
    gains = np.random.default_rng(0).uniform(1, 9, (SAMPLES, 4))
    bench = Bench(ScheduledPD(gains))
    for k in range(4):
        bench.step(k, psi_hat=0.0)
        np.testing.assert_allclose(bench["torque"], gains[k] * bench.s)
        np.testing.assert_array_equal(bench["effective_gain"], gains[k])


def test_schedule_of_a_run_that_ended_early_keeps_its_last_gain() -> None:
    gains = np.array([[1.0, 2, 3, 4], [5, 6, 7, 8]])
    bench = Bench(ScheduledPD(gains))
    seen = [bench.step(k)["effective_gain"] for k in range(4)]
    np.testing.assert_array_equal(seen, gains[[0, 1, 1, 1]])


@pytest.mark.parametrize("shape", [(SAMPLES, 3), (SAMPLES,), (0, 4)])
def test_schedule_of_another_robot_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ConfigError, match=r"gains: error: gains of shape .*\(samples, 4\)"):
        Bench(ScheduledPD(np.ones(shape)))


def test_gains_that_are_no_numbers_or_of_no_run_are_refused() -> None:
    with pytest.raises(ConfigError, match="all finite"):
        Bench(ScheduledPD(np.full((9, 4), np.nan)))
    experiment = load_experiment("track")
    with pytest.raises(ConfigError, match="pd_effective without gains"):
        experiment.loop(experiment.load_robot(), "pd_effective")


def network_answer(kind: str, W: Array, V: Array, x: Array, width: float) -> tuple[Array, float]:
    """Output and norm of a network by matrices."""
    if kind == "one_layer":
        return W.T @ np.exp(-np.sum((x[:, None] - V) ** 2, axis=0) / (2 * width**2)), float(np.linalg.norm(W))
    return W.T @ expit(V.T @ x), float(np.sqrt(np.sum(W**2) + np.sum(V**2)))


@pytest.mark.parametrize("network", [SMALL, OneLayer(hidden=5, width=4.0, centre_range=2.0)], ids=lambda n: n.name)
@pytest.mark.parametrize("layout", [LAYOUT, Layout(2, 1, 6, 3), Layout(0, 2, 2, 2), Layout(2, 0, 5, 2)])
def test_network_law(network: TwoLayer | OneLayer, layout: Dimensions) -> None:
    """Torque = k s + Psi_hat + Kz (|Z| + ZB) s, each network with its own error, weights and numbers."""
    feedback, robust = Feedback(500.0, 30.0), Robust(10.0, 0.3, (5.0, 3.0))
    bench = Bench(Neural(network, feedback, robust), layout)
    for seed in range(3):
        bench.step(seed)
    old = bench.weights()
    bench.step(9)
    outputs, norms, Kz, ZB = [], [], [], []
    for i, size in ((1, layout.base), (2, layout.arm)):
        if size:
            x = bench.state["x"]
            psi_hat, norm = network_answer(network.name, old[f"W{i}"], old[f"V{i}"], x, getattr(network, "width", 0))
            outputs.append(psi_hat)
            norms += [norm] * size
            Kz += [(10.0, 0.3)[i - 1]] * size
            ZB += [(5.0, 3.0)[i - 1]] * size
            assert bench["weight_norm"][i - 1] == pytest.approx(norm)
    k, s, extra = feedback.vector(layout), bench.s, np.array(Kz) * (np.array(norms) + ZB)
    assert np.abs(np.concatenate(outputs)).min() > 1e-4
    np.testing.assert_allclose(bench["psi_hat"], np.concatenate(outputs), rtol=1e-12)
    np.testing.assert_allclose(bench["effective_gain"], k + extra, rtol=1e-12)
    np.testing.assert_allclose(bench["robust"], extra * s, rtol=1e-9)
    np.testing.assert_allclose(bench["torque"], (k + extra) * s + np.concatenate(outputs), rtol=1e-12)


def test_gains_of_each_velocity() -> None:
    bench = Bench(NEURAL).step(1)
    k, Kz = np.array([500.0, 120.0, 30.0, 20.0]), np.array([10.0, 6.0, 0.3, 0.2])
    norm = bench["weight_norm"][[0, 0, 1, 1]]
    np.testing.assert_allclose(bench["effective_gain"], k + Kz * (norm + np.array([5, 5, 3, 3])))
    np.testing.assert_allclose(NEURAL.feedback_gain(LAYOUT), k + Kz * [5, 5, 3, 3])


# --- what a network sees


def test_network_input_is_that_of_the_thesis() -> None:
    """(3.24): pose_ref, alpha, alphadot, e_p, z, e, r, q_ref, qdot_ref, qddot_ref; 22 numbers for two joints."""
    codes = {
        "pose_ref": [1, 2, 3],
        "alpha": [4, 5],
        "alphadot": [6, 7],
        "pose_error": [8, 9, 10],
        "z": [11, 12],
        "e": [13, 14],
        "r": [15, 16],
        "q_ref": [17, 18],
        "qdot_ref": [19, 20],
        "qddot_ref": [21, 22],
    }
    bench = Bench(Neural(learning=False)).step(0, **codes)
    np.testing.assert_array_equal(bench.state["x"], np.arange(1, 23))


def test_chosen_input_scaled() -> None:
    inputs = Inputs(("edot", "velocity", "e"), scale=180 / np.pi)
    bench = Bench(Neural(inputs=inputs)).step(0, edot=[1, 2], velocity=[3, 4], e=[5, 6])
    np.testing.assert_allclose(bench.state["x"], np.rad2deg([1, 2, 3, 4, 5, 6]))


def test_slip_of_appendix_b_puts_a_constant_for_the_yaw_rate() -> None:
    thesis, slip = Bench(Neural()).step(3), Bench(Neural(inputs=Inputs(constant_yaw_rate=5.0))).step(3)
    expected = thesis.state["x"].copy()
    expected[4] = 5.0
    np.testing.assert_array_equal(slip.state["x"], expected)
    assert thesis.state["x"][4] == thesis["alpha"][1]


@pytest.mark.parametrize("network", [SMALL, OneLayer(hidden=5)], ids=lambda n: n.name)
def test_networks_never_read_the_true_state(network: TwoLayer | OneLayer) -> None:
    sighted, blind = Bench(Neural(network)), Bench(Neural(network))
    hidden = [name for name in ("position", "nu", "psi", "energy", "work", "energy_residual") if name not in SEEN]
    assert len(hidden) == 6
    for k in range(3):
        sighted.step(k)
        blind.step(k, **dict.fromkeys(hidden, np.nan), psi_hat=np.nan, robust=np.nan, torque=np.nan)
        for name in ("torque", "psi_hat", "robust", "effective_gain"):
            assert np.isfinite(blind[name]).all()
            np.testing.assert_array_equal(blind[name], sighted[name])
    np.testing.assert_array_equal(blind.state.values, sighted.state.values)


@pytest.mark.parametrize("name", ["psi", "nu", "position", "torque", "energy", "nonsense"])
def test_inputs_that_no_controller_may_know_are_refused(name: str) -> None:
    with pytest.raises(UnknownName, match=f"inputs.signals: error: unknown network input '{name}'"):
        Inputs(("z", name))


# --- learning


def two_layer_dot(W: Array, V: Array, x: Array, s: Array, sigma: Array, rates: tuple[float, ...]) -> list[Array]:
    F, G, kappa = rates
    slope, leak = np.diag(sigma * (1 - sigma)), kappa * np.linalg.norm(s)
    Wdot = F * (np.outer(sigma - slope @ V.T @ x, s) - leak * W)
    return [Wdot, G * (np.outer(x, slope @ W @ s) - leak * V)]


@pytest.mark.parametrize("update", ["after_output", "before_output"])
@pytest.mark.parametrize(("rates", "dt"), [("per_sample", 1.0), ("per_second", H)])
def test_sequence_of_updates(update: Any, rates: Any, dt: float) -> None:
    """Three samples by matrices. Appendix B's order moves the weights first, with the previous hidden outputs."""
    bench = Bench(replace(NEURAL, update=update, rates=rates))
    parts: dict[int, Any] = {1: (0.9, 0.7, 0.3), 2: (0.2, 0.1, 0.3)}
    W, V = ({i: bench.state[f"{letter}{i}"].copy() for i in parts} for letter in "WV")
    for i in parts:
        W[i][:] = bench.state[f"W{i}"][:] = np.random.default_rng(i).normal(size=W[i].shape)
    sigma = {i: np.zeros(5) for i in parts}
    for k in range(3):
        bench.step(k)
        x, outputs = bench.state["x"], []
        for i, rates_of_it in parts.items():
            s = bench["z"] if i == 1 else bench["r"]
            if update == "after_output":
                sigma[i] = expit(V[i].T @ x)
                outputs.append(W[i].T @ sigma[i])
            Wdot, Vdot = two_layer_dot(W[i], V[i], x, s, sigma[i], rates_of_it)
            W[i], V[i] = W[i] + dt * Wdot, V[i] + dt * Vdot
            if update == "before_output":
                sigma[i] = expit(V[i].T @ x)
                outputs.append(W[i].T @ sigma[i])
            np.testing.assert_allclose(bench.state[f"W{i}"], W[i], atol=1e-12)
            np.testing.assert_allclose(bench.state[f"V{i}"], V[i], atol=1e-12)
        np.testing.assert_allclose(bench["psi_hat"], np.concatenate(outputs), atol=1e-12)


@pytest.mark.parametrize("update", ["after_output", "before_output"])
def test_sequence_of_one_layer_updates(update: Any) -> None:
    network = OneLayer(hidden=4, beta=(0.5, 0.2), mu=0.35, width=3.0, centre_range=2.0)
    bench = Bench(Neural(network, update=update))
    W, phi = {1: np.zeros((4, 2)), 2: np.zeros((4, 2))}, {1: np.zeros(4), 2: np.zeros(4)}
    for k in range(3):
        bench.step(k)
        x, outputs = bench.state["x"], []
        for i, beta in ((1, 0.5), (2, 0.2)):
            s = bench["z"] if i == 1 else bench["r"]
            now = np.exp(-np.sum((x[:, None] - bench.state[f"V{i}"]) ** 2, axis=0) / 18)
            if update == "after_output":
                outputs.append(W[i].T @ now)
            used = now if update == "after_output" else phi[i]
            W[i] = W[i] + beta * (np.outer(used, s) - 0.35 * np.linalg.norm(s) * W[i])
            if update == "before_output":
                outputs.append(W[i].T @ now)
            phi[i] = now
            np.testing.assert_allclose(bench.state[f"W{i}"], W[i], atol=1e-12)
        np.testing.assert_allclose(bench["psi_hat"], np.concatenate(outputs), atol=1e-12)


@pytest.mark.parametrize("network", [SMALL, OneLayer(hidden=5)], ids=lambda n: n.name)
@pytest.mark.parametrize("update", ["after_output", "before_output"])
def test_learning_off_keeps_the_weights(network: TwoLayer | OneLayer, update: Any) -> None:
    off, on = (Bench(Neural(network, update=update, learning=learning)) for learning in (False, True))
    before = off.weights()
    for bench in (off, on):
        bench.step(1).step(2)
    for name, W in before.items():
        np.testing.assert_array_equal(off.state[name], W)
    assert np.abs(on.state["W1"]).max() > 0


@pytest.mark.parametrize("network", [SMALL, OneLayer(hidden=5, mu=0.3)], ids=lambda n: n.name)
def test_leakage_off_is_zero_leakage(network: TwoLayer | OneLayer) -> None:
    none = TwoLayer(5, SMALL.F, SMALL.G, 0.0) if isinstance(network, TwoLayer) else OneLayer(hidden=5, mu=0.0)
    off, zero, on = Bench(Neural(network, leakage=False)), Bench(Neural(none)), Bench(Neural(network))
    for k in range(3):
        for bench in (off, zero, on):
            bench.step(k)
    np.testing.assert_array_equal(off.state.values, zero.state.values)
    assert np.abs(off.state["W1"] - on.state["W1"]).max() > 1e-3


def test_robust_term_off_leaves_the_constant_gain() -> None:
    bench = Bench(replace(NEURAL, robust=None)).step(1).step(2)
    np.testing.assert_array_equal(bench["effective_gain"], GAINS.vector(LAYOUT))
    np.testing.assert_array_equal(bench["robust"], np.zeros(4))
    np.testing.assert_allclose(bench["torque"], GAINS.vector(LAYOUT) * bench.s + bench["psi_hat"])
    np.testing.assert_array_equal(replace(NEURAL, robust=None).feedback_gain(LAYOUT), GAINS.vector(LAYOUT))


@pytest.mark.parametrize(("still", "moves"), [("z", "2"), ("r", "1")])
def test_each_network_learns_from_its_own_error(still: str, moves: str) -> None:
    bench = Bench(NEURAL)
    before = bench.weights()
    bench.step(1, **{still: 0.0}).step(2, **{still: 0.0})
    for name, W in before.items():
        assert np.array_equal(bench.state[name], W) == (name[1] != moves)


# --- initial weights


def test_initial_weights() -> None:
    random, zero = Bench(NEURAL), Bench(Neural(TwoLayer(hidden=5, initial="zero")))
    assert all(not W.any() for W in zero.weights().values())
    for i in "12":
        assert not random.state[f"W{i}"].any()
        assert random.state[f"V{i}"].shape == (22, 5)
        assert 0.5 < np.abs(random.state[f"V{i}"]).max() <= 1.0
    assert not np.array_equal(random.state["V1"], random.state["V2"])
    half = Bench(Neural(TwoLayer(hidden=5, v_range=0.5)))
    np.testing.assert_allclose(half.state["V1"], 0.5 * random.state["V1"])


def test_centres_of_the_gaussians() -> None:
    diagonal = Bench(Neural(OneLayer(hidden=3, centre_range=10.0))).state["V1"]
    np.testing.assert_array_equal(diagonal, np.tile([-10.0, 0.0, 10.0], (22, 1)))
    random = Bench(Neural(OneLayer(hidden=3, centre_range=10.0, centres="random"))).state["V1"]
    assert 5 < np.abs(random).max() <= 10
    assert "V1" not in Neural(OneLayer()).weights(Bench(Neural(OneLayer())).state)  # they are not learned


def test_user_is_told_of_zero_weights_and_of_what_they_do() -> None:
    zero = Neural(TwoLayer(hidden=5, initial="zero"))
    assert "keep rank one" in zero.notes[0]
    assert not NEURAL.notes
    assert not Neural(TwoLayer(hidden=1, initial="zero")).notes
    assert not Neural(OneLayer()).notes
    bench = Bench(zero)
    assert not zero.findings(bench.state)
    for k in range(5):
        bench.step(k)
    assert zero.findings(bench.state) == ["two_layer: W1, V1, W2, V2 ended at rank one: the hidden units act as one"]
    learner = Bench(Neural(replace_leakage(SMALL)))
    for k in range(5):
        learner.step(k)
    assert not NEURAL.findings(learner.state)


def replace_leakage(network: TwoLayer) -> TwoLayer:
    return TwoLayer(network.hidden, network.F, network.G, 0.0)


# --- memory


def test_memory_is_one_array_with_views() -> None:
    state = ControllerState.of(a=(2, 3), b=(4,))
    assert state.values.shape == (10,)
    state["a"][1, 2] = 7.0
    state["b"] = 1.0
    np.testing.assert_array_equal(state.values, [0, 0, 0, 0, 0, 7, 1, 1, 1, 1])
    copy = state.snapshot()
    state["b"][:] = 2.0
    np.testing.assert_array_equal(copy["b"], np.ones(4))
    assert copy.shapes == state.shapes
    with pytest.raises(KeyError):
        state["c"]


def test_weights_are_views_into_the_memory_that_learns() -> None:
    bench = Bench(NEURAL)
    views = NEURAL.weights(bench.state)
    assert list(views) == ["W1", "V1", "W2", "V2"]
    bench.step(1)
    assert all(np.shares_memory(view, bench.state.values) for view in views.values())
    assert np.abs(views["W1"]).max() > 0


# --- bad input


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: TwoLayer(hidden=0), "two_layer.hidden"),
        (lambda: TwoLayer(F=(1.0, -1.0)), "two_layer.F"),
        (lambda: TwoLayer(G=(float("nan"), 1.0)), "two_layer.G"),
        (lambda: TwoLayer(kappa=-1.0), "two_layer.kappa"),
        (lambda: TwoLayer(v_range=float("inf")), "two_layer.v_range"),
        (lambda: OneLayer(hidden=-1), "one_layer.hidden"),
        (lambda: OneLayer(width=0.0), "one_layer.width"),
        (lambda: OneLayer(width=-1.0), "one_layer.width"),
        (lambda: OneLayer(beta=(-0.5, 0.5)), "one_layer.beta"),
        (lambda: OneLayer(mu=float("nan")), "one_layer.mu"),
        (lambda: Robust(-1.0), "robust.base"),
        (lambda: Robust(ZB=(1.0, -1.0)), "robust.ZB"),
        (lambda: Feedback(-500.0), "feedback.base"),
        (lambda: Feedback(arm=(1.0, float("inf"))), "feedback.arm"),
        (lambda: Feedback((1.0, 2.0, 3.0), 1.0).vector(LAYOUT), "feedback.base"),
        (lambda: Neural(feedback=GAINS, robust=Robust(arm=(1.0,))).feedback_gain(LAYOUT), "robust.arm"),
    ],
)
def test_impossible_settings_are_refused_with_their_key(make: Callable[[], object], key: str) -> None:
    with pytest.raises(ConfigError) as refused:
        make()
    assert refused.value.key == key


def test_numbers_of_the_base_come_before_those_of_the_arm() -> None:
    np.testing.assert_array_equal(per_velocity((1.0, 2.0), 3.0, LAYOUT, "x"), [1, 2, 3, 3])
    np.testing.assert_array_equal(per_velocity(9.0, (3.0, 4.0), Layout(0, 2, 2, 2), "x"), [3, 4])


# --- in the loop


def closed_loop(
    controller: CompiledController | TorqueController, samples: int, engine: Any = "ordinary", seed: int = 1
) -> Loop:
    return Loop(
        load("platform_arm"),
        Trajectory(Line(0.3), (Sine(0.78, 4.0), Hold(0.78))),
        with_gains(controller),
        timing=Timing(samples * H, H, 0.001),
        start=Start((-0.01, 0.0, 0.0)),
        seed=seed,
        engine=engine,
    )


def memory_of(loop: Loop, run: Recording) -> ControllerState:
    """The controller's memory as it was when a run ended."""
    state = loop.controller.init(loop.context())
    state.values[:] = run.final["controller_state"]
    return state


def same(one: Recording, other: Recording, rows: slice = slice(None)) -> None:
    for name in one.names:
        if name not in ("work", "energy_residual"):  # counted from the start of a run
            np.testing.assert_array_equal(one[name][rows], other[name], err_msg=name)


N = 6 if PLAIN else 60


def scheduled() -> ScheduledPD:
    return ScheduledPD(np.linspace(1, 2, N)[:, None] * [500.0, 500.0, 30.0, 30.0])


@pytest.mark.compiled
@pytest.mark.parametrize("engine", ["ordinary", "compiled"])
@pytest.mark.parametrize(
    "controller",
    [Neural(), Neural(update="before_output"), Neural(OneLayer()), scheduled(), ComputedTorque()],
    ids=["two_layer", "before_output", "one_layer", "pd_effective", "computed_torque"],
)
def test_a_resumed_run_equals_the_uninterrupted_one(controller: CompiledController, engine: Any) -> None:
    whole, half = closed_loop(controller, N, engine), closed_loop(controller, N // 2, engine)
    straight, first = whole.run(), half.run()
    state = memory_of(half, first)
    kept = state.snapshot()
    second = whole.run(state=state, plant_state=(first.final["position"], first.final["nu"]), first=N // 2)
    same(straight, first, slice(0, N // 2))
    same(straight, second, slice(N // 2, None))
    assert second.outcome == straight.outcome
    np.testing.assert_array_equal(second.final["controller_state"], straight.final["controller_state"])
    np.testing.assert_array_equal(state.values, kept.values)  # the caller's memory stays as it was


def test_learning_goes_on_only_where_it_is_on() -> None:
    """Trained weights, frozen: the same for the whole run, and not those of an untrained network."""
    trained = closed_loop(Neural(), N).run()
    loop = closed_loop(Neural(learning=False), N)
    frozen = loop.run(state=memory_of(loop, trained))
    for name in ("W1", "V1", "W2", "V2"):
        np.testing.assert_array_equal(frozen.weights[name][0], frozen.weights[name][-1])
        np.testing.assert_array_equal(frozen.weights[name][0], trained.weights[name][-1])
    assert np.abs(frozen["psi_hat"][0]).max() > 0


def test_the_seed_decides() -> None:
    one, again, other = (closed_loop(Neural(), N, seed=seed).run() for seed in (1, 1, 2))
    same(one, again)
    np.testing.assert_array_equal(one.weights["V1"], again.weights["V1"])
    assert np.abs(one.weights["V1"][0] - other.weights["V1"][0]).max() > 0.1
    assert np.abs(one["torque"][1:] - other["torque"][1:]).max() > 1e-3


def test_oracle_knows_psi_and_what_it_knows_helps() -> None:
    """Computed torque with the true model: psi_hat is Psi; without friction or noise the errors decay."""
    oracle, pd = (closed_loop(controller, N).run() for controller in (ComputedTorque(), PD()))
    np.testing.assert_allclose(oracle["psi_hat"], oracle["psi"], atol=1e-9)
    np.testing.assert_array_equal(pd["psi_hat"], 0 * pd["psi_hat"])
    if not PLAIN:
        assert np.linalg.norm(oracle["r"][-1]) < np.linalg.norm(pd["r"][-1])


def test_a_memory_of_another_controller_is_refused() -> None:
    loop = closed_loop(NEURAL, 4)
    others = [Neural(TwoLayer(hidden=6)), Neural(OneLayer(hidden=7)), PD()]
    for state in [*(other.init(loop.context()) for other in others), np.zeros(3)]:
        with pytest.raises(ConfigError, match="state: error: not a state of two_layer with these settings"):
            loop.run(state=state)


@pytest.mark.parametrize(("first", "sensor_period"), [(-1, None), (4, None), (1, 0.004)])
def test_a_first_sample_without_a_measurement_is_refused(first: int, sensor_period: float | None) -> None:
    loop = closed_loop(PD(), 4)
    loop = replace(loop, timing=Timing(4 * H, H, 0.001, sensor_period))
    with pytest.raises(ConfigError, match=f"first: error: cannot start at control sample {first}"):
        loop.run(first=first)
    assert len(loop.run(first=2)) == 2


def test_a_run_that_begins_later_begins_at_the_reference_of_that_time() -> None:
    loop = replace(closed_loop(PD(), 4), start=Start())
    run = loop.run(first=2)
    np.testing.assert_array_equal(run.time, [2 * H, 3 * H])
    np.testing.assert_allclose(run["pose_error"][0], 0, atol=1e-12)
    assert run["pose"][0, 0] == pytest.approx(0.3 * 2 * H)


# --- a controller in plain Python


class Recital(TorqueController):
    """PD that counts its samples, and keeps what it was handed."""

    name = "recital"

    def init(self, context: Context) -> ControllerState:
        return ControllerState.of(count=(1,))

    def step(
        self,
        time: float,
        reference: Setpoint,
        measurement: Measurement,
        command: VelocityCommand,
        state: ControllerState,
    ) -> Array:
        state["count"] += 1
        assert np.array_equal(command.e, reference.q - measurement.q)
        assert np.array_equal(command.z, command.alpha - measurement.velocity)
        return THESIS.vector(LAYOUT) * np.concatenate((command.z, command.r))

    def weights(self, state: ControllerState) -> dict[str, Array]:
        return {"count": state["count"]}


def test_a_controller_in_plain_python_equals_the_compiled_one() -> None:
    python, compiled = closed_loop(Recital(), N).run(), closed_loop(PD(), N).run()
    np.testing.assert_allclose(python["torque"], compiled["torque"], rtol=1e-12)
    np.testing.assert_allclose(python["position"], compiled["position"], atol=1e-14)
    assert python.final["controller_state"] == [N]
    assert python.weights["count"][-1] == [N]
    with pytest.raises(ConfigError, match="plain Python cannot be compiled"):
        closed_loop(Recital(), N, "compiled").run()


def test_a_controller_in_plain_python_resumes() -> None:
    half = closed_loop(Recital(), N // 2)
    first = half.run()
    plant_state = (first.final["position"], first.final["nu"])
    second = closed_loop(Recital(), N).run(state=memory_of(half, first), plant_state=plant_state, first=N // 2)
    assert second.final["controller_state"] == [N]
    same(closed_loop(Recital(), N).run(), second, slice(N // 2, None))


@pytest.mark.skipif(PLAIN, reason="runs compiled")
def test_the_example_runs_and_its_controller_is_the_better_one() -> None:
    example = ROOT / "examples" / "own_controller.py"
    assert len(example.read_text().splitlines()) < 40
    done = subprocess.run([sys.executable, example], capture_output=True, text=True, timeout=300, check=True)
    rows = {line.split()[0]: [float(n) for n in re.findall(r"\d+[.]\d+", line)] for line in done.stdout.splitlines()}
    assert list(rows) == ["pd", "pid"]
    assert np.isfinite([*rows.values()]).all()
    assert all(ours < pd for ours, pd in zip(rows["pid"], rows["pd"], strict=True))


# --- what a module imports is what it may know

PACKAGE = Path(mmnn_pin.__file__).parent
FEET = {"errors", "files", "compiled", "elementary", "parts", "settings", "signals"}  # what every block may stand on


def imported(module: Path) -> Iterator[str]:
    """Modules of ours that a module names in an import, as `torque.law`; those for type checking only are left out."""
    name = module.relative_to(PACKAGE).with_suffix("").parts
    tree = ast.parse(module.read_text())
    only_types = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in only_types:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name.removeprefix("mmnn_pin.") for alias in node.names if "mmnn_pin." in alias.name)
        elif isinstance(node, ast.ImportFrom):
            up = list(name[: len(name) - node.level]) if node.level else []
            source = [*up, *(node.module or "").split(".")] if node.level else (node.module or "").split(".")[1:]
            if node.level or (node.module or "").split(".")[0] == "mmnn_pin":
                for alias in node.names:
                    whole = [part for part in (*source, alias.name) if part]
                    path = PACKAGE.joinpath(*whole)
                    yield ".".join(whole if path.is_dir() or path.with_suffix(".py").exists() else whole[:-1])


def graph() -> dict[str, set[str]]:
    """Every module and the modules of ours that it imports."""
    edges = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")
        edges[name] = {target for target in imported(path) if target}
    return edges


def known(edges: dict[str, set[str]], module: str) -> set[str]:
    """All that a module imports, directly or not."""
    seen: set[str] = set()
    left = [module]
    while left:
        new = edges.get(left.pop(), set()) - seen
        seen |= new
        left += new
    return seen


@pytest.mark.compiled
def test_an_adaptive_controller_knows_how_the_robot_moves_and_not_what_it_weighs() -> None:
    edges = graph()
    assert {name.split(".")[0] for name in known(edges, "torque.pseudo_inertia")} <= FEET | {"torque"}
    weighs = {"model.dynamics", "model.robot", "model.loading", "model.inspection", "model.tree.body"}
    assert "model.regressor" in edges["torque.adaptive"]
    assert not known(edges, "torque.adaptive") & weighs
