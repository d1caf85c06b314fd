"""Learning laws in plain Python: what they are told, what the loop does for them, numpy twins of compiled learners."""

from __future__ import annotations

import re
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from proofs import KINDS, SLOW, learner, loop_of, robot_of_kind, subject_of
from robots import feedback

from mmnn_pin import PD, LearningLaw, TorqueController
from mmnn_pin.errors import ConfigError, InputError, UnknownName
from mmnn_pin.lab.psi.judgement import Judgement
from mmnn_pin.lab.psi.learner import LearnerStepper
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.safety import Safety
from mmnn_pin.sensing import Sensor
from mmnn_pin.torque.adaptive import Adaptive, AdaptiveSettings
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.learning_law import norms
from mmnn_pin.torque.model_based import ComputedTorque
from mmnn_pin.torque.neural import THESIS_INPUT

SIGNALS = ("psi_hat", "torque", "effective_gain", "position", "nu", "motor_torque")


class Nothing(LearningLaw):
    """A law that says nothing: PD."""

    def init(self, context):
        return ControllerState.of()

    def estimate(self, now, state):
        return np.zeros(now.s.size)

    def learn(self, now, state):
        assert not state.values.size


class OneLayerTwin(LearningLaw):
    """The one-layer network of reference [9], in numpy."""

    hidden: int = 5
    beta: tuple[float, float] = (1.0, 0.6)
    mu: float = 0.2
    width: float = 4.5
    range: float = 10.0

    learned = ("W1", "W2")

    def init(self, context):
        nb, n = context.layout.base, context.layout.arm
        nx = 3 * context.layout.pose - context.layout.pose + 3 * nb + 5 * n
        return ControllerState.of(W1=(self.hidden, nb), W2=(self.hidden, n), nx=(nx,))

    def phi(self, now):
        asked, commanded = now.reference, now.command
        signals = [(asked, n.removesuffix("_ref")) if n.endswith("_ref") else (commanded, n) for n in THESIS_INPUT]
        x = np.concatenate([getattr(record, name) for record, name in signals])
        centres = np.linspace(-self.range, self.range, self.hidden)
        return np.exp(-((x[:, None] - centres) ** 2).sum(axis=0) / (2 * self.width**2))

    def estimate(self, now, state):
        phi = self.phi(now)
        return np.concatenate((phi @ state["W1"], phi @ state["W2"]))

    def learn(self, now, state):
        phi, nb = self.phi(now), state["W1"].shape[1]
        for W, s, beta in zip((state["W1"], state["W2"]), (now.s[:nb], now.s[nb:]), self.beta, strict=True):
            W += beta * (np.outer(phi, s) - self.mu * np.linalg.norm(s) * W)


class Friction(LearningLaw):
    """The friction part of the adaptive law in numpy: the last columns of Y, a gradient between 0 and a bound."""

    viscous: float = 1.0
    coulomb: float = 10.0

    knows_motion = True
    learned = ("theta",)

    def init(self, context):
        state, regressor = (
            ControllerState.of(theta=(context.regressor.size,), rates=(context.regressor.size,)),
            context.regressor,
        )
        K, joints = self.feedback.vector(context.layout), regressor.massless.joints
        on_joints = 1 / np.array([t @ (t / K) for t in joints])
        rest = [0 * on_joints, K[: context.layout.base], self.viscous**0.5 * on_joints, self.coulomb**0.5 * on_joints]
        base = context.layout.base  # rates are meant for gains of 500 N s/m and 30 N m s
        of_base = np.full(base, 500.0 / K[0])
        arm = 30.0 / np.sqrt(np.median(K[base:]) * on_joints)
        faster = np.where(joints[:, :base].any(axis=1), 500.0 / K[0], arm)
        state["rates"][regressor.inertial :] = np.concatenate(rest) ** 2 * np.concatenate(
            (faster, of_base, faster, faster)
        )
        return state

    def estimate(self, now, state):
        return now.regressor @ state["theta"]

    def learn(self, now, state):
        state["theta"] += now.period * state["rates"] * (now.regressor.T @ now.s)
        rest = state["theta"][state["rates"] > 0]
        state["theta"][state["rates"] > 0] = np.maximum(rest, 0.0)


class Told(LearningLaw):
    """Keeps all that it is told; `theta` is the robot's own, as no learner can have it."""

    theta: tuple[float, ...] = ()
    knows_motion = True

    def init(self, context):
        p = context.layout.dof
        self.heard.clear()
        return ControllerState.of(W=(p, 2))

    def estimate(self, now, state):
        self.heard.append((now.time, now.first, now.s.copy(), now.nu.copy(), now.sent.copy()))
        return now.regressor @ np.array(self.theta)

    def learn(self, now, state):
        state["W"] += 1.0

    heard: Any = None


def run_both(kind: str, law: LearningLaw, controller: Any, **more: Any) -> tuple[Any, Any]:
    return tuple(loop_of(kind, one, engine="ordinary", **more).run() for one in (law, controller))


def same(ours: Any, theirs: Any, signals: tuple[str, ...] = SIGNALS, tolerance: float = 1e-9) -> None:
    for name in signals:
        scale = np.abs(theirs[name]).max(initial=0.0) or 1.0
        np.testing.assert_allclose(ours[name], theirs[name], rtol=0, atol=tolerance * scale, err_msg=name)


# -- twins of compiled controllers --


@pytest.mark.parametrize("kind", KINDS)
def test_a_law_that_says_nothing_is_pd(kind: str) -> None:
    K = feedback(robot_of_kind(kind), 0.002)
    ours, pd = (loop_of(kind, one).run() for one in (Nothing(feedback=K), PD(K)))
    assert ours.meta["loop"] == "ordinary" and pd.meta["loop"] == "compiled"
    same(ours, pd, tolerance=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_a_network_in_numpy_is_the_compiled_one(kind: str) -> None:
    theirs = learner(kind, "one_layer", robust=None)
    ours, compiled = run_both(kind, OneLayerTwin(feedback=theirs.feedback), theirs)
    assert np.abs(compiled["psi_hat"]).max() > 1e-3
    same(ours, compiled)
    for name in compiled.weights:
        np.testing.assert_allclose(ours.weights[name], compiled.weights[name], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("kind", ["differential", "fixed"])
def test_friction_in_numpy_is_that_of_the_adaptive_law(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With masses that are known (rate 0, no bodies' part) what is left of it is a gradient with clipping."""
    monkeypatch.setattr(Adaptive, "answer", lambda self, context, share: share)  # whatever the loop bears
    K, regressor = feedback(robot_of_kind(kind), 0.002), Regressor.of(robot_of_kind(kind))
    known = parameters(robot_of_kind(kind)) + np.where(np.arange(regressor.size) < regressor.inertial, 0.0, 0.1)
    adapting = AdaptiveSettings(rate=0.0, share=1e9, friction_bound=1e9, initial="nominal")
    theirs = Adaptive(regressor, K, adapting, known)
    masses = theirs.start().copy()

    class WithMasses(Friction):
        def init(self, context):
            state = super().init(context)
            state["theta"] = masses
            return state

    ours, compiled = run_both(kind, WithMasses(feedback=K), theirs)
    same(ours, compiled)
    theta = compiled.weights["theta"][-1]
    assert (theta != masses).any()
    np.testing.assert_allclose(ours.weights["theta"][-1], theta, rtol=1e-9, atol=1e-12)


# -- what a law is told --


@pytest.mark.parametrize("kind", ["differential", "fixed"])
def test_a_law_is_told_measurements_the_regressor_and_what_was_sent(kind: str) -> None:
    robot = robot_of_kind(kind)
    law = Told(theta=tuple(parameters(robot)), feedback=feedback(robot, 0.002), heard=[])
    run = loop_of(kind, law, duration=0.02).run()
    time, first, s, nu, sent = map(np.array, zip(*law.heard, strict=True))
    np.testing.assert_array_equal(time, run["time"])
    assert first.tolist() == [True] + [False] * (len(run) - 1)
    np.testing.assert_allclose(s, run["nu_ref"] - run["nu"], atol=1e-12)
    np.testing.assert_array_equal(nu, run["nu"])  # exact sensors
    np.testing.assert_array_equal(sent[1:], run["torque"][:-1])
    assert not sent[0].any()
    # with the robot's own parameters the regressor says the true Psi: computed torque
    np.testing.assert_allclose(run["psi_hat"], run["psi"], rtol=1e-8, atol=1e-8)
    oracle = loop_of(kind, ComputedTorque(law.feedback), duration=0.02).run()
    np.testing.assert_allclose(run["torque"], oracle["torque"], rtol=1e-7, atol=1e-7)


def test_a_law_sees_what_the_sensors_say_and_what_the_supervisor_sends() -> None:
    robot = robot_of_kind("differential")
    law = Told(theta=(0.0,) * Regressor.of(robot).size, feedback=feedback(robot, 0.002), heard=[])
    more = {"sensor": Sensor(noise=1e-3, velocity_noise=1e-2), "safety": Safety(torque=0.05)}
    run = loop_of("differential", law, duration=0.05, **more).run()
    _, _, s, nu, sent = map(np.array, zip(*law.heard, strict=True))
    measured = np.hstack((run["velocity"], run["qdot"]))
    np.testing.assert_array_equal(nu, measured)
    assert np.abs(nu - run["nu"]).max() > 1e-3
    asked = law.feedback.vector(robot.dimensions) * s + 0.0
    assert np.abs(asked[:-1] - sent[1:]).max() > 1e-3  # clipped
    np.testing.assert_array_equal(sent[1:], run["torque"][:-1])


def test_only_who_asks_is_told_how_the_robot_moves() -> None:
    class Curious(Nothing):
        def estimate(self, now, state):
            return now.regressor @ np.zeros(3)

    with pytest.raises(ConfigError, match="knows_motion = True"):
        loop_of("fixed", Curious(feedback=feedback(robot_of_kind("fixed"), 0.002))).run()


# -- what the loop does for it --


def test_weights_are_recorded_frozen_and_resumed() -> None:
    law = OneLayerTwin(feedback=feedback(robot_of_kind("differential"), 0.002))
    loop = loop_of("differential", law, duration=0.04, weights_interval=0.01)
    whole = loop.run()
    assert set(whole.weights) == {"W1", "W2", "time"}
    np.testing.assert_allclose(whole.weights["time"], [0.0, 0.01, 0.02, 0.03, 0.04])
    both = [np.linalg.norm(whole.weights[part][1:4], axis=(1, 2)) for part in ("W1", "W2")]
    np.testing.assert_allclose(whole["weight_norm"][[10, 20, 30], 0], np.hypot(*both))
    assert both[1][-1] > 0
    half = replace(loop, timing=replace_duration(loop.timing, 0.02)).run()
    state = loop.controller.init(loop.context())
    state.values[:] = half.final["controller_state"]
    plant_state = half.final["position"], half.final["nu"]
    rest = loop.run(state=state, plant_state=plant_state, first=20)
    same(rest, {n: whole[n][20:] for n in SIGNALS}, tolerance=1e-12)
    fixed = replace(loop, controller=replace(law, learning=False)).run(state=state)
    np.testing.assert_array_equal(fixed.weights["W2"][0], fixed.weights["W2"][-1])
    np.testing.assert_array_equal(fixed.weights["W2"][0], state["W2"])


def replace_duration(timing: Any, duration: float) -> Any:
    import msgspec

    return msgspec.structs.replace(timing, duration=duration)


@settings(deadline=None, max_examples=20)
@given(st.integers(1, 3), st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_norms_add_up_to_all_weights(base: int, arm: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    layout = robot_of_kind("differential").dimensions
    p = layout.dof
    weights = {"W": rng.normal(size=(arm, p)), "theta": rng.normal(size=base), "P": rng.normal(size=(p + 1, p + 1))}
    first, second = norms(weights, layout)
    assert np.hypot(first, second) == pytest.approx(np.sqrt(sum((w**2).sum() for w in weights.values())))
    assert second == pytest.approx(np.linalg.norm(weights["W"][:, layout.base :]))


def test_a_supervisor_bounds_its_weights() -> None:
    law = OneLayerTwin(feedback=feedback(robot_of_kind("differential"), 0.002), beta=(5.0, 5.0))
    free, held = (
        loop_of("differential", law, duration=0.1, safety=Safety(weights=bound)).run() for bound in (None, 0.05)
    )
    assert np.linalg.norm(free.weights["W2"], axis=(1, 2)).max() > 0.1
    assert np.linalg.norm(held.weights["W2"], axis=(1, 2)).max() <= 0.05 * (1 + 1e-12)


def test_gains_that_cannot_be_sampled_are_refused_as_those_of_pd() -> None:
    from mmnn_pin import Feedback

    for controller in (PD(Feedback(arm=1e5)), Nothing(feedback=Feedback(arm=1e5))):
        with pytest.raises(ConfigError, match="unstable"):
            loop_of("fixed", controller, check_gains=True).run()


def test_a_plain_controller_may_tell_its_psi_hat() -> None:
    class Both(TorqueController):
        def step(self, time, reference, measurement, command, state):
            s = np.concatenate((command.z, command.r))
            return 20.0 * s + 0.5, np.full(s.size, 0.5)

    run = loop_of("fixed", Both(), duration=0.01).run()
    assert (run["psi_hat"] == 0.5).all()
    np.testing.assert_allclose(run["torque"], 20.0 * run["r"] + 0.5)
    assert not any("gives no Psi_hat" in remark for remark in Judgement(run).remarks())


# -- what is wrong with a law is told in one line --


class Wrong(Nothing):
    """Fails in a way that is chosen."""

    how: str = ""

    def init(self, context):
        if self.how == "no memory":
            return {"W": 3}
        if self.how == "init":
            return ControllerState.of(W=(2,))["V"]
        return super().init(context)

    def estimate(self, now, state):
        if self.how == "raises":
            return state["W"]  # line of the error
        return {"shape": np.zeros(7), "nan": np.full(now.s.size, np.nan)}.get(self.how, np.zeros(now.s.size))


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("shape", r"returned a Psi_hat of shape \(7,\)"),
        ("no memory", "Wrong.init returned dict: a law learns in a `ControllerState`: return ControllerState.of"),
        ("init", "controller 'Wrong' failed: KeyError: 'V'"),
        ("raises", r"test_learning_law.py:\d+: error: controller 'Wrong' failed: KeyError: 'W'"),
    ],
)
def test_failures_are_told_in_one_line(how: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        loop_of("fixed", Wrong(feedback=feedback(robot_of_kind("fixed"), 0.002), how=how)).run()
    assert re.search(words, str(caught.value)) and "\n" not in str(caught.value)
    if how == "raises":
        assert "line of the error" in Path(__file__).read_text().splitlines()[caught.value.line - 1]


def test_numbers_that_are_none_end_the_run() -> None:
    run = loop_of("fixed", Wrong(feedback=feedback(robot_of_kind("fixed"), 0.002), how="nan")).run()
    assert run.outcome.status == "diverged" and "psi_hat of joint_0 is not finite" in run.outcome.message


def test_a_law_is_settings_and_nothing_else() -> None:
    law = OneLayerTwin(hidden=7)
    assert law.name == "OneLayerTwin" and law.facts()["hidden"] == 7 and law.facts()["learning"] is True
    with pytest.raises(FrozenInstanceError):
        law.hidden = 8
    with pytest.raises(TypeError, match="write its settings as annotated attributes"):
        type("Bad", (Nothing,), {"__init__": lambda self: None})
    with pytest.raises(TypeError, match="abstract"):
        type("Half", (LearningLaw,), {"init": lambda self, context: ControllerState.of()})()

    class Misnamed(Nothing):
        learned = ("W",)

    with pytest.raises(UnknownName, match="part of the state of Misnamed"):
        loop_of("fixed", Misnamed(feedback=feedback(robot_of_kind("fixed"), 0.002))).run()
    with pytest.raises(ConfigError, match="call estimate and learn"):
        law.step(0.0, None, None, None, None)


# -- what it knows --


@pytest.mark.skipif(SLOW, reason="too long for uncompiled code")
def test_frozen_weights_of_a_law_say_what_a_sum_by_hand_says() -> None:
    law = OneLayerTwin(feedback=feedback(robot_of_kind("differential"), 0.002))
    run = loop_of("differential", law, duration=0.6).run()
    subject = subject_of("differential", run)
    psi = Judgement(run).psi
    x = np.hstack([run[name].reshape(len(run), -1) for name in THESIS_INPUT])
    centres = np.linspace(-law.range, law.range, law.hidden)
    phi = np.exp(-((x[:, :, None] - centres) ** 2).sum(axis=1) / (2 * law.width**2))
    said = np.hstack((phi @ run.weights["W1"][-1], phi @ run.weights["W2"][-1]))
    counts = run["time"] >= 0.5 - 1e-9
    truth = run["psi"][counts]
    by_hand = ((truth - said[counts]) ** 2).sum(axis=0) / ((truth - truth.mean(axis=0)) ** 2).sum(axis=0)
    np.testing.assert_allclose(psi.frozen["same"].fvu, by_hand, rtol=1e-9)
    assert set(psi.frozen) == {"same", "held_out", "payload"} and subject.learner is not None
    assert psi.remarks == ()


class OnTop(LearningLaw):
    """Psi of known parameters, and weights of the same regressor on top; it learns from the torque sent."""

    theta: tuple[float, ...] = ()
    knows_motion = True
    learned = ("W",)

    def init(self, context):
        return ControllerState.of(W=(context.regressor.size,))

    def features(self, now, state):
        return now.regressor

    def estimate(self, now, state):
        return now.regressor @ (state["W"] + np.array(self.theta))

    def learn(self, now, state):
        state["W"] += 1e-6 * now.regressor.T @ (now.sent - now.regressor @ state["W"])


def test_stepping_it_again_gives_its_weights_and_what_is_known_is_not_asked_of_them() -> None:
    robot = robot_of_kind("differential")
    law = OnTop(theta=tuple(parameters(robot)), feedback=feedback(robot, 0.002))
    subject = subject_of("differential", loop_of("differential", law, duration=0.05).run())
    learner = subject.learner
    assert learner is not None and np.abs(learner.end["W"]).max() > 1e-6
    stepper = LearnerStepper(learner, learner.start.snapshot())
    again = np.array([stepper.step(row).copy() for row in subject.rows])
    np.testing.assert_allclose(again, subject.signal("psi_hat"), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(stepper.state["W"], learner.end["W"], rtol=1e-12)
