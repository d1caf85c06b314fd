"""The weights' part of V of every learner beyond the thesis, and each of its terms, in a second way.

What moves the weights is done again here by other means: P and L as dense matrices with textbook updates, each with the
equations that were measured and with exact ones; derivatives by finite differences; identities by sympy.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import sympy as sp
from learning import COMMON, SHORT
from proofs import SLOW, loop_of, robot_of_kind
from robots import feedback

from mmnn_pin import LearningLaw, load_experiment
from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.psi.learner import LearnerStepper, NetworkLearner, frozen_psi_hat
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.pseudo_inertia import directions, factor, move
from research.proof.linear import covariance_part, stack_part
from research.proof.lyapunov import TERMS
from research.proof.networks import network_part
from research.proof.proof import Proof
from research.proof.truth import distances, metric, numbers_of, prediction_step, true_weights

slow = pytest.mark.skipif(SLOW, reason="too long for uncompiled code")
COVARIANCE = ("kalman_regressor", "kalman_bilinear", "kalman_features", "kalman_residual")
LEARNERS = (*COVARIANCE, "concurrent", "adaptive_composite", "two_layer_residual")
SMALL = {
    "kalman_bilinear": ("kalman.bilinear.hidden=5",),
    "kalman_features": ("kalman.features.hidden=20",),
    "kalman_residual": ("kalman.residual.hidden=5",),
}


@cache
def proof_of(name: str, *more: str) -> Proof:
    """A noisy run of a learner on chapter 4's line with friction."""
    noise = ["sensor.noise=1e-4", "sensor.velocity_noise=2e-3", f"time.duration={SHORT}"]
    experiment = load_experiment("chapter4", [*COMMON, *noise, *SMALL.get(name, ()), *more])
    robot = experiment.load_robot()
    loop = experiment.loop(robot, experiment.controller(name, robot=robot))
    return Proof(loop.run(meta={"config": experiment.to_json()}))


def errors_of(proof: Proof) -> tuple[np.ndarray, np.ndarray]:
    """The s that was told (N, p), and `s' (Psi - Psi_hat)` (N,)."""
    subject = proof.subject
    s = np.hstack((subject.signal("z"), subject.signal("r")))
    return s, (s * (subject.signal("psi") - subject.signal("psi_hat"))).sum(axis=1)


@slow
@pytest.mark.parametrize("name", LEARNERS)
def test_terms_add_up_to_the_measured_change_and_the_run_is_met_again(name: str) -> None:
    proof = proof_of(name)
    v = proof.lyapunov
    assert proof.left_out == "" and v.missed < 1e-12 and (v.weights > 0).all()
    np.testing.assert_allclose(np.sum(list(v.terms.values()), axis=0), v.measured, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.diff(v.total) / v.period, v.measured[:-1], rtol=1e-6, atol=1e-6 * v.total[0])
    assert v.terms["prediction"].any() == (name != "two_layer_residual") and set(v.terms) == set(TERMS)
    control = proof.subject.timing.control_period
    assert v.period == pytest.approx({"concurrent": 0.02}.get(name, control if "two_layer" in name else 0.01))


# -- a covariance --


def test_what_an_update_does_to_the_distance_by_sympy() -> None:
    """W~' P^-1 W~ after one Kalman update, and after variance was added, for two weights and any numbers."""
    a, b, c, R, q, e, p1, p2, w1, w2 = sp.symbols("a b c R q e p1 p2 w1 w2", real=True)
    P, phi, error = sp.Matrix([[a, b], [b, c]]), sp.Matrix([p1, p2]), sp.Matrix([w1, w2])
    alpha, u = R + (phi.T * P * phi)[0], (phi.T * error)[0]
    after = error - P * phi * (u + e) / alpha
    inverse = P.inv() + phi * phi.T / R
    told = -(u**2) / alpha + (e**2 * (alpha / R - 1) - 2 * u * e) / alpha
    assert sp.simplify((after.T * inverse * after)[0] - (error.T * P.inv() * error)[0] - told) == 0
    more = P + sp.diag(q, 0)
    weighed = P.inv() * error
    told = -q * weighed[0] ** 2 / (1 + q * P.inv()[0, 0])
    assert sp.simplify((error.T * more.inv() * error)[0] - (error.T * P.inv() * error)[0] - told) == 0


@slow
@pytest.mark.parametrize("name", COVARIANCE)
def test_a_covariance_by_dense_matrices(name: str) -> None:
    assert updates_by_dense_matrices(proof_of(name), range(100)) >= 5


@slow
@pytest.mark.parametrize("interval", [0.002, 0.01])
def test_a_covariance_by_dense_matrices_when_a_load_was_picked_up(interval: float) -> None:
    """The alarm comes with an update of its own, and between two; just after it every sample is one."""
    load = 'disturbances=[{type="payload",mass=3.0,start=2.2,at=[0.3,0.05,0.02]}]'
    often = f"kalman.regressor.interval={interval}"
    proof = proof_of("kalman_regressor", load, "kalman.regressor.alarm=3.0", "time.duration=2.4", often)
    alarm, every = alarms(proof)
    assert len(alarm) == 1 and 1100 <= alarm[0] < 1150 and (alarm[0] % every == 0) == (interval == 0.002)
    assert updates_by_dense_matrices(proof, range(alarm[0] - 10, alarm[0] + 10)) >= 11


def alarms(proof: Proof) -> tuple[list[int], int]:
    """Rows at which a learner heard an alarm, and samples between its updates otherwise."""
    learner = proof.subject.learner
    assert learner is not None
    stepper, found = LearnerStepper(learner, learner.start.snapshot()), []
    for n, row in enumerate(proof.subject.rows):
        stepper.step(row)
        found += [n] if stepper.state["counts"][3] > 0 else []
    return found, learner.controller.law(learner.context).learner.every


def updates_by_dense_matrices(proof: Proof, rows: range) -> int:
    """Value from the inverse of P; prediction from updates with exact equations; noise from what the real ones add.

    Returns:
        How many of the rows, whose terms are all as told, have an update.
    """
    subject, learner, W_true = proof.subject, proof.subject.learner, proof.ideal.W
    assert learner is not None
    a, h = learner.controller.law(learner.context).learner, learner.context.control_period
    every = np.arange(len(subject.rows))
    found = covariance_part(subject, learner, W_true, every)
    stepper, still = (LearnerStepper(learner, learner.start.snapshot(), on) for on in (True, False))
    s, error = errors_of(proof)
    m, count = W_true.shape[1], 0
    lets = learner.start["prior"] > 0

    def value(P: np.ndarray, wrong: np.ndarray) -> float:
        wrong = wrong[lets]
        return float(((wrong * np.linalg.solve(P[np.ix_(lets, lets)], wrong)).sum(axis=0) / (2 * a.answer)).sum())

    def dense(state: ControllerState) -> np.ndarray:
        U = np.tril(state["U"], -1).T + np.eye(len(state["D"]))
        return U @ np.diag(state["D"]) @ U.T

    for n, row in enumerate(subject.rows[: rows.stop]):
        P, W, counts = dense(stepper.state), stepper.state["W"].T.copy(), stepper.state["counts"].copy()
        update = int(counts[0]) % a.every == 0 or counts[5] > 0
        if n < rows.start:
            stepper.step(row)
            continue
        still.step(row)
        Phi = still.torque.features()
        stepper.step(row)
        assert found.value[n] == pytest.approx(value(P, W_true - W), rel=1e-6)
        g = Phi.T @ s[n][:, None] if m == 1 else np.outer(Phi[0], s[n])
        pull = (g * (W_true - W)).sum()
        assert found.terms["remainder"][n] == pytest.approx(error[n] - pull, rel=1e-6, abs=1e-9 * abs(pull))
        told = P.copy()  # with what an alarm gives back
        if stepper.state["counts"][3] > 0:
            np.fill_diagonal(told, np.where(np.isin(np.arange(len(P)), a.carrying), learner.start["prior"], np.diag(P)))
        if not update or stepper.state["counts"][1] == 0:
            assert not any(found.terms[term][n] for term in ("prediction", "noise"))
            assert update or found.terms["cut"][n] == 0
            back = value(told, W_true - W) - value(P, W_true - W)
            assert found.terms["memory"][n] * h == pytest.approx(back, rel=1e-6)
            continue
        count += 1
        time = h * (counts[6] + 1)  # since the last update
        answer = time * (a.answer * (g * (P @ g)).sum(axis=0)).sum()
        eta = min(1.0, 0.2 * a.gain @ s[n] ** 2 / answer)
        tracked = W + eta * time * a.answer * (P @ g)
        assert found.terms["cut"][n] * h == pytest.approx((1 - eta) * time * pull, rel=1e-6, abs=1e-12)
        V, back = value(P, W_true - tracked), value(told, W_true - tracked) - value(P, W_true - tracked)
        exact, real, R = (told, tracked), (told, tracked), a.noise * a.interval / time
        noise = prediction = 0.0
        for i, features in enumerate(stepper.state["Phi_f"]):
            phi = features / a.gain[i] if m == 1 else features
            y = stepper.state["Y_f"][i : i + 1] / a.gain[i] if m == 1 else stepper.state["Y_f"]
            P, at = real
            K, left = P @ phi / (R + phi @ P @ phi), P - np.outer(P @ phi, phi @ P) / (R + phi @ P @ phi)
            exact = (left, at + np.outer(K, phi @ W_true - phi @ at))
            real = (left, at + np.outer(K, y - phi @ at))
            before, best, after = value(P, W_true - at), value(left, W_true - exact[1]), value(left, W_true - real[1])
            prediction, noise = prediction + best - before, noise + after - best
        scale = abs(V)
        assert found.terms["prediction"][n] * h == pytest.approx(prediction, rel=1e-5, abs=1e-9 * scale)
        assert found.terms["noise"][n] * h == pytest.approx(noise, rel=1e-5, abs=1e-9 * scale)
        end = value(dense(stepper.state), W_true - stepper.state["W"].T)
        drift = end - value(real[0], W_true - real[1])
        assert found.terms["memory"][n] * h == pytest.approx(back + drift, rel=1e-4, abs=1e-9 * scale)
        assert prediction <= 0 and drift <= 1e-9 * scale and back <= 1e-9 * scale
    return count


# -- a stack --


@slow
def test_a_stack_by_derivatives_along_what_it_says() -> None:
    """Terms as the slopes of V along the way to w_L, of exact equations, of the prior, of what the equations err."""
    proof = proof_of("concurrent")
    subject, learner, w_true = proof.subject, proof.subject.learner, proof.ideal.W[:, 0]
    assert learner is not None
    a, h = learner.controller.law(learner.context).learner, learner.context.control_period
    found = stack_part(subject, learner, w_true, np.arange(len(subject.rows)))
    stepper, count, eps = LearnerStepper(learner, learner.start.snapshot()), 0, 1e-6
    share = 1 - np.exp(-a.rate * a.every * h)
    for n, row in enumerate(subject.rows):
        w, L = stepper.state["w"].copy(), stepper.state["L"].copy()
        stepper.step(row)
        now, b, after = (stepper.state[name].copy() for name in ("L", "b", "w"))

        def value(w: np.ndarray, L: np.ndarray) -> float:
            return float((w_true - w) @ L @ (w_true - w) / (2 * a.tracking))

        assert found.value[n] == pytest.approx(value(w, L))
        if not any(found.terms[name][n] for name in ("prediction", "leakage", "noise")):
            assert found.terms["memory"][n] == 0 and np.array_equal(L, now)
            continue
        # w as it was after it had followed s: what is left when the way to w_L is taken back
        target = np.linalg.solve(now, b)
        tracked = (after - share * target) / (1 - share)
        exact, prior = np.linalg.solve(now, now @ w_true - w_true), np.zeros_like(w)
        ends = {"exact": exact, "noise": target - exact, "prior": prior}

        def slope(way: np.ndarray, at: np.ndarray = tracked, L: np.ndarray = now) -> float:
            return share / h * (value(at + eps * way, L) - value(at - eps * way, L)) / (2 * eps)

        told = {name: found.terms[name][n] for name in ("prediction", "leakage", "noise")}
        scale = 1e-6 * max(map(abs, told.values()))
        assert told["noise"] == pytest.approx(slope(ends["noise"]), rel=1e-5, abs=scale)
        both = told["prediction"] + told["leakage"]
        assert both == pytest.approx(slope(exact - tracked), rel=1e-5, abs=scale)
        # the prior alone is an equation 0 = w with the information 1
        wanted = slope(np.linalg.solve(now, -tracked))
        assert told["leakage"] == pytest.approx(wanted, rel=1e-5, abs=scale) and told["prediction"] <= 0
        jump = value(tracked, now) - value(tracked, L)
        assert found.terms["memory"][n] * h == pytest.approx(jump, rel=1e-6, abs=1e-12)
        count += 1
    assert count > 10 and np.abs(found.terms["memory"]).max() > 0


@slow
@pytest.mark.parametrize("name", ["kalman_regressor", "concurrent"])
def test_true_weights_say_the_true_psi_on_any_motion(name: str) -> None:
    proof = proof_of(name)
    subject, learner = proof.subject, proof.subject.learner
    assert learner is not None and proof.ideal.true
    controller, w, theta = learner.controller, true_weights(subject, learner), parameters(subject.robot)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        motion = rng.standard_normal((3, subject.layout.dof))
        Y = controller.regressor.matrix(controller.regressor.random_position(rng), *motion)
        frozen_psi_hat = Y @ w if name != "concurrent" else Y @ (controller.start() + controller.basis @ w)
        np.testing.assert_allclose(frozen_psi_hat, Y @ theta, rtol=1e-6, atol=1e-6 * np.abs(Y @ theta).max())
    if name == "kalman_regressor":  # none that say the same are nearer in the metric of the prior
        prior = learner.start["prior"]
        lets, blind = (
            prior > 0,
            np.eye(len(prior))
            - np.linalg.pinv(controller.regressor.identifiable().T) @ (controller.regressor.identifiable().T),
        )
        assert not w[~lets].any()
        others = w[lets, None] + 0.1 * (blind @ np.random.default_rng(0).standard_normal((len(w), 20)))[lets]
        assert ((others**2 / prior[lets, None]).sum(axis=0) > (w[lets] ** 2 / prior[lets]).sum()).all()


# -- an estimate with a prediction error --


@slow
def test_the_metric_is_where_a_gradient_takes_the_estimate() -> None:
    proof = proof_of("adaptive_composite")
    learner = proof.subject.learner
    assert learner is not None
    a, theta = numbers_of(learner)[0].bodies, proof.ideal.theta.copy()
    theta[a.start.size :] += 1e-3 * np.abs(theta[a.start.size :])
    theta[-a.start.size :] = 0.5 * a.top
    g = np.random.default_rng(0).standard_normal(theta.size) * 1e-9
    moved = theta.copy()
    for b in range(len(a.roots)):
        factor(moved[10 * b : 10 * b + 10], a, b)
    directions(moved, g, a)
    move(moved, 1.0, 0.0, a)
    np.testing.assert_allclose((moved - theta) / a.h, metric(a, theta) @ g, rtol=1e-4, atol=1e-15)


@slow
def test_a_prediction_step_by_derivatives_of_v() -> None:
    """Prediction and noise of a step are the slope of V_theta along it; for short steps those of the flow."""
    proof = proof_of("adaptive_composite")
    learner, theta = proof.subject.learner, proof.ideal.theta
    assert learner is not None
    (numbers, p), end, estimate = numbers_of(learner), learner.end, learner.end["theta"].copy()
    a = numbers.bodies
    assert p is not None and np.abs(end["Q"]).max() > 0
    first = theta.size - a.rates.size
    learned = np.concatenate((np.ones(first, bool), a.rates > 0))
    Gamma, Q, b = metric(a, estimate), end["Q"], end["b"]
    for weight in (1e-9, 1.0, p.weight):
        numbers = p._replace(weight=weight)
        told = prediction_step(a, numbers, estimate, theta, learned, end)
        # the implicit Euler step itself, by its definition: theta+ = theta + weight Gamma (b - Q theta+)
        step = np.linalg.solve(np.eye(len(Q)) + weight * Gamma @ Q, weight * Gamma @ (b - Q @ estimate))
        sizes = [
            np.sqrt(np.trace(np.linalg.matrix_power(np.linalg.solve(pseudo(estimate, i), pseudo(step, i)), 2)))
            for i in range(len(a.roots))
        ]
        step *= min(1.0, 0.3 / max(sizes))
        eps = 1e-5 / max(sizes)  # however short the step, the difference is of the same length
        ends = distances(a, theta, np.array([estimate - eps * step, estimate + eps * step]))
        assert sum(told) == pytest.approx((ends[1] - ends[0]) / (2 * eps), rel=1e-3, abs=1e-12)
        assert told[0] <= 0
    wrong = theta - estimate
    flow = prediction_step(a, p._replace(weight=1e-9), estimate, theta, learned, end)[0] / 1e-9
    assert flow == pytest.approx(-(wrong * learned) @ Q @ (wrong * learned), rel=1e-3)


def pseudo(theta: np.ndarray, i: int) -> np.ndarray:
    """The pseudo-inertia of a body, entry by entry."""
    m, cx, cy, cz, xx, xy, xz, yy, yz, zz = theta[10 * i : 10 * i + 10]
    return np.array([[xx, xy, xz, cx], [xy, yy, yz, cy], [xz, yz, zz, cz], [cx, cy, cz, m]])


# -- networks --


@slow
def test_a_networks_part_changes_exactly_as_its_terms_say() -> None:
    proof = proof_of("two_layer_residual")
    subject, one = proof.subject, proof.subject.learner
    assert isinstance(one, NetworkLearner) and subject.networks is None  # the certificate is for networks alone
    every = np.arange(len(subject.rows))
    found = network_part(subject, one, proof.ideal, every)
    change = np.diff(found.value) / subject.timing.control_period
    expected = (found.terms["leakage"] + found.terms["remainder"] - errors_of(proof)[1])[:-1]
    expected = expected + found.arrived["step"][1:]
    np.testing.assert_allclose(change, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())
    assert found.missed < 1e-12


@slow
def test_ideal_weights_put_into_the_learner_say_psi_up_to_eps() -> None:
    """With a nominal model in front: its Psi is not theirs to say."""
    proof = proof_of("two_layer_residual")
    subject, learner = proof.subject, proof.subject.learner
    assert isinstance(learner, NetworkLearner)
    state = learner.start.snapshot()
    for i, ideal in proof.ideal.items():
        state[f"W{i}"], state[f"V{i}"] = ideal.W, ideal.V
    wrong = np.abs(subject.signal("psi") - frozen_psi_hat(learner, state, subject.rows)).max(axis=0)
    for i, part in learner.networks:
        np.testing.assert_allclose(wrong[part], proof.ideal[i].eps, rtol=1e-6)
        assert (proof.ideal[i].unexplained < 0.5).all()


# -- without what follows s --


@slow
@pytest.mark.parametrize(
    ("name", "setting"),
    [
        ("kalman_regressor", "kalman.regressor.tracking=0.0"),
        ("concurrent", "concurrent.tracking=0.0"),
        ("adaptive_composite", "adaptive_composite.tracking=0.0"),
    ],
)
def test_weights_that_do_not_follow_s_have_no_part(name: str, setting: str) -> None:
    proof = proof_of(name, setting)
    assert not proof.lyapunov.weights.any() and "tracking is 0" in proof.left_out
    assert proof.left_out in proof.remarks()


# -- a user's law --


class Gradient(LearningLaw):
    """W' = Gamma Phi' s - leak W over features of one's own."""

    shape: str = "number"
    leak: float = 0.0
    learned = ("W",)

    def init(self, context):
        return ControllerState.of(W=(3, context.layout.dof), count=(1,))

    def features(self, now, state):
        return np.array([1.0, np.sin(now.q[0]), now.nu[0]])

    def gain(self, state):
        full = np.array([[2.0, 0.3, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 4.0]])
        return {"number": 5.0, "diagonal": np.diag(full), "full": full, "none": None, "wrong": -full, "odd": full[:2]}[
            self.shape
        ]

    def estimate(self, now, state):
        return self.features(now, state) @ state["W"]

    def learn(self, now, state):
        gain = np.asarray(self.gain(state) if self.shape in ("number", "diagonal", "full") else 1.0)
        gain = np.diag(gain) if gain.ndim == 1 else gain
        Phi, W = np.outer(self.features(now, state), now.s), state["W"]
        W += now.period * ((gain @ Phi if gain.ndim else gain * Phi) - self.leak * W)


def law_of(**settings) -> Proof:
    law = Gradient(feedback=feedback(robot_of_kind("differential"), 0.002), **settings)
    return Proof(loop_of("differential", law, duration=0.05).run())


@pytest.mark.parametrize("shape", ["number", "diagonal", "full"])
def test_a_law_that_tells_its_gain_has_a_part(shape: str) -> None:
    proof = law_of(shape=shape)
    v, learner = proof.lyapunov, proof.subject.learner
    assert learner is not None and v.missed < 1e-12
    gain = np.asarray(learner.controller.gain(learner.start))
    inverse = np.linalg.inv(gain) if gain.ndim == 2 else np.diag(np.broadcast_to(1 / gain, 3))
    wrong = proof.ideal.W - proof.subject.recording.weights["W"][0]
    assert v.weights[0] == pytest.approx(np.trace(wrong.T @ inverse @ wrong) / 2)
    scale = np.abs(v.terms["remainder"]).max() + np.abs(v.terms["step"]).max()
    assert np.abs(v.terms["own"]).max() < 1e-6 * scale  # it follows s and does nothing else
    np.testing.assert_allclose(np.sum(list(v.terms.values()), axis=0), v.measured, rtol=1e-9, atol=1e-9)
    assert (v.terms["step"] >= 0).all() or shape == "odd"


def test_what_a_law_does_beside_is_told_apart() -> None:
    """Leakage -l W changes the part by l tr(W~' Gamma^-1 W) to first order in the period."""
    proof = law_of(shape="full", leak=2.0)
    v, learner, n = proof.lyapunov, proof.subject.learner, 30
    assert learner is not None
    stepper = LearnerStepper(learner, learner.start.snapshot())
    for row in proof.subject.rows[:n]:
        stepper.step(row)
    W, inverse = stepper.state["W"], np.linalg.inv(learner.controller.gain(learner.start))
    expected = 2.0 * np.trace((proof.ideal.W - W).T @ inverse @ W)
    assert v.terms["own"][n] == pytest.approx(expected, rel=0.05) and expected != 0


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ("none", "Gradient does not tell its learning gain; write a method gain"),
        ("wrong", "is not positive definite"),
        ("odd", r"has the shape \(2, 3\); return one number, \(3,\) or \(3, 3\)"),
    ],
)
def test_without_a_gain_one_line_says_what_to_write(shape: str, words: str) -> None:
    proof = law_of(shape=shape)
    assert not proof.lyapunov.weights.any()
    (line,) = (remark for remark in proof.remarks() if "weights' part" in remark)
    with pytest.raises(RecordingError, match=words):
        raise RecordingError(line)
