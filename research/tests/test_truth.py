"""What an adaptive controller knows: rebuilt, frozen, its distance from the truth, V with it; each in a second way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from proofs import SLOW, loop_of, robot_of_kind
from robots import feedback, robot_of
from scipy.linalg import eigvals
from test_arm import slaves

from mmnn_pin import Hold, Loop, Robot, Sine, Timing, Trajectory, load, load_experiment
from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.lab.psi import learner as learners
from mmnn_pin.lab.psi.excitation import features_of
from mmnn_pin.lab.psi.learner import frozen_psi_hat
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.reference import Line
from mmnn_pin.torque.adaptive import Adaptive, AdaptiveSettings
from mmnn_pin.torque.model_based import ComputedTorque
from mmnn_pin.torque.prior import scales, tempo
from mmnn_pin.torque.pseudo_inertia import pseudo_inertias
from research.proof import truth
from research.proof.linear import linear_fit
from research.proof.lyapunov import lyapunov
from research.proof.proof import Proof
from research.proof.truth import distances, divergence, estimate_part, shares_of_update, stepped, true_parameters

patient = settings(deadline=None, max_examples=25)
seeds = st.integers(0, 2**32 - 1)
slow = pytest.mark.skipif(SLOW, reason="too long for uncompiled code")


@cache
def robot_with_densities(kind: str) -> Robot:
    """One whose bodies all have mass and volume, so that its parameters can be estimated, with smooth friction."""
    if kind == "fixed":
        return robot_of_kind(kind)
    return load("platform_arm").with_friction((30.0, 5.0, 0.5, 0.5)).with_joint_friction(coulomb=0.3)


def controller(kind: str = "differential", **more: object) -> Adaptive:
    """One that starts with all friction well inside its bounds, so that nothing is clipped."""
    robot = robot_with_densities(kind)
    regressor = Regressor.of(robot)
    start = parameters(robot) * np.random.default_rng(0).uniform(0.7, 1.3, regressor.size)
    start[regressor.inertial :] = parameters(robot)[regressor.inertial :] + 0.2
    settings = AdaptiveSettings(
        **({"rate": 0.5, "viscous": 0.01, "coulomb": 0.01, "share": 1e9, "initial": "nominal"} | more)
    )
    return Adaptive(regressor, feedback(robot, 0.002), settings, start)


def subject_of(own: Adaptive, kind: str = "differential", **more: object) -> Subject:
    return Subject.of(loop_of(kind, own, robot=robot_with_densities(kind), **more).run())


def states(subject: Subject) -> Iterator[tuple[np.ndarray, ...]]:
    """Position, nu, nu_ref and nudot_ref of every row as a controller knows them: it does not measure wheel angles."""
    position = np.tile(subject.robot.neutral_position(), (len(subject.rows), 1))
    known = [*range(subject.layout.pose), *subject.robot.arm_index]
    position[:, known] = subject.signal("position")[:, known]
    return zip(position, *(subject.signal(name) for name in ("nu", "nu_ref", "nudot_ref")), strict=True)


# -- built again --


@pytest.mark.parametrize("kind", ["differential", "fixed"])
def test_it_is_built_again_and_says_y_theta(kind: str) -> None:
    own = controller(kind)
    subject = subject_of(own, kind, duration=0.03)
    learner = subject.learner
    assert learner is not None and subject.networks is None
    assert learner.controller.settings == own.settings and learner.controller.feedback == own.feedback
    assert learner.controller.start() == pytest.approx(own.start(), rel=1e-12) and learner.end_time == pytest.approx(
        0.03
    )
    theta = subject.recording.weights["theta"][-1]
    np.testing.assert_array_equal(learner.end["theta"], theta)
    assert np.abs(theta - own.start()).max() > 1e-6
    expected = np.array([own.regressor.matrix(*state) @ theta for state in states(subject)])
    np.testing.assert_allclose(frozen_psi_hat(learner, learner.end, subject.rows), expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        frozen_psi_hat(learner, learner.end, subject.rows, every=7), expected[::7], rtol=1e-9, atol=1e-9
    )
    found = stepped(learner, subject.rows, np.array([0, 5]))
    assert found.missed < 1e-12


@slow
def test_frozen_fvu_is_a_sum_by_hand() -> None:
    subject = subject_of(controller(), duration=0.6)
    psi, regressor = Proof(subject.recording).psi, Regressor.of(subject.robot)
    theta = subject.recording.weights["theta"][-1]
    error = subject.signal("psi") - np.array([regressor.matrix(*state) @ theta for state in states(subject)])
    late = subject.signal("time")[:, 0] >= 0.5 - 1e-9
    truth = subject.signal("psi")[late]
    by_hand = (error[late] ** 2).sum(axis=0) / ((truth - truth.mean(axis=0)) ** 2).sum(axis=0)
    np.testing.assert_allclose(psi.frozen["same"].fvu, by_hand, rtol=1e-6)
    assert set(psi.frozen) == {"same", "held_out", "payload"} and psi.networks[0].what == "regressor"


def test_an_experiment_that_makes_another_controller_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = load_experiment("track", ["time.duration=0.01"])
    robot = experiment.load_robot()
    made = experiment.controller("computed_torque", robot=robot)
    run = experiment.loop(robot, made).run(meta={"config": experiment.to_json()})
    assert Subject.of(run).learner is None  # it learns nothing

    class Other(ComputedTorque):
        learning = True

        def facts(self):
            return {"rate": 2.0}

    monkeypatch.setattr(Experiment, "controller", lambda self, name, gains=None, robot=None: Other(made.feedback))
    with pytest.raises(RecordingError, match="does not give its computed_torque"):
        _ = Subject.of(run).learner
    run.meta["controller_settings"] = {"rate": 2.0}
    learner = Subject.of(run).learner
    assert learner is not None and isinstance(learner.controller, Other)


# -- the distance from the truth --


def some_body(rng: np.random.Generator) -> np.ndarray:
    points = rng.normal(size=(8, 4))
    points[:, 3] = 1.0
    return points.T @ points


@patient
@given(seeds)
def test_the_divergence_is_a_sum_over_relative_eigenvalues(seed: int) -> None:
    rng = np.random.default_rng(seed)
    P, Q = some_body(rng), some_body(rng)
    ratios = eigvals(P, Q).real
    expected = (ratios - np.log(ratios) - 1.0).sum()
    np.testing.assert_allclose(divergence(P, Q[None])[0], expected, rtol=1e-8, atol=1e-10)
    assert divergence(P, P[None])[0] == pytest.approx(0.0, abs=1e-10) and expected > 0


def test_what_the_truth_leaves_is_no_matter_of_whose_run_it_is() -> None:
    """A recording that says another Psi_hat is of the same robot on the same motion."""
    own = controller()
    subject = subject_of(own, duration=0.02)
    learner = subject.learner
    assert learner is not None
    eps = true_parameters(subject, learner).eps
    expected = [own.regressor.matrix(*state) @ parameters(subject.robot) for state in states(subject)]
    by_hand = np.abs(subject.signal("psi") - expected).max(axis=0)
    np.testing.assert_allclose(eps, by_hand, atol=1e-9 * np.abs(subject.signal("psi")).max())
    rows = subject.rows.copy()
    rows[:, subject.layout.where("psi_hat")] *= 2.0
    np.testing.assert_array_equal(true_parameters(replace(subject, rows=rows), learner).eps, eps)


def test_the_distance_is_that_of_bodies_and_of_friction() -> None:
    own = controller(rotor=0.0)
    subject = subject_of(own, duration=0.02)
    assert subject.learner is not None
    found = true_parameters(subject, subject.learner)
    theta, first = parameters(subject.robot), own.regressor.inertial
    np.testing.assert_array_equal(found.theta, theta)
    assert found.eps.max() < 1e-9 * np.abs(subject.signal("psi")).max()  # smooth friction, exact sensors
    start, K = own.start(), own.feedback.vector(subject.layout)
    pace, freely = tempo(own.regressor, K)
    bodies = sum(
        (r - np.log(r) - 1).sum() / (each * own.settings.rate)
        for each, P, Q in zip(pace, pseudo_inertias(theta[:first]), pseudo_inertias(start[:first]), strict=True)
        for r in [eigvals(P, Q).real]
    )
    rates = freely * np.repeat([0.0, 0.01, 0.01], own.counts()) * scales(own.regressor, K) ** 2
    error = (theta - start)[first:]
    friction = (error[rates > 0] ** 2 / (2 * rates[rates > 0])).sum()
    assert found.parts["bodies"][0] == pytest.approx(bodies) and found.parts["friction"][0] == pytest.approx(friction)
    assert found.distance[0] == pytest.approx(bodies + friction)


def test_a_body_without_a_density_has_no_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    subject = subject_of(controller(), duration=0.02)

    def flat(robot):
        theta = parameters(robot)
        theta[4:10] = 0.0
        return theta

    monkeypatch.setattr(truth, "parameters", flat)
    proof = Proof(subject.recording)
    with pytest.raises(RecordingError, match="the body at 'root' has no density"):
        _ = proof.ideal
    assert not proof.lyapunov.weights.any() and proof.lyapunov.terms["remainder"].any()


# -- V along a run --

SETTINGS = {
    "plain": {},
    "sigma": {"leakage": 5.0},
    "e": {"leakage": 5.0, "modification": "e"},
    "cut": {"share": 1e-4, "viscous": 0.01, "coulomb": 0.01, "rate": 5.0},
    "rotors": {"rotor": 0.1},
    "bodies alone": {"viscous": 0.0, "coulomb": 0.0},
    "friction alone": {"rate": 0.0},
}


@slow
@pytest.mark.parametrize("what", SETTINGS)
def test_v_changes_as_predicted_up_to_steps_of_second_order(what: str) -> None:
    """`step` is all that the terms of the flow do not say; it goes with the period, or one of them is wrong."""
    left = []
    for period in (1e-3, 5e-4):
        subject = subject_of(controller(**SETTINGS[what]), period=period, duration=0.05)
        assert subject.learner is not None
        every = np.arange(len(subject.rows))
        found = estimate_part(subject, subject.learner, true_parameters(subject, subject.learner), every)
        s = subject.signal("nu_ref") - subject.signal("nu")
        error = (s * (subject.signal("psi") - subject.signal("psi_hat"))).sum(axis=1)
        flow, step = sum(found.terms.values()) - error, found.arrived["step"]
        change = np.diff(found.value) / period
        np.testing.assert_allclose(change, flow[:-1] + step[1:], rtol=1e-6, atol=1e-9 * np.abs(flow).max())
        left.append(np.abs(step).sum() * period / (np.abs(flow).sum() * period))
        assert found.missed < 1e-12 and found.terms["leakage"].any() == (what in ("sigma", "e"))
        assert (np.abs(found.terms["cut"]).max() > 1e-3 * np.abs(error).max()) == (what == "cut")
        assert (np.abs(found.terms["remainder"]).max() > 1e-6 * np.abs(error).max()) == (
            "alone" in what or what != "rotors"
        )
    shorter = left[1] / left[0]  # a cut step is a share of the feedback, however short the period
    assert left[0] < 0.2 and (0.9 < shorter < 1.1 if what == "cut" else 0.3 < shorter < 0.7), left


@slow
def test_the_share_of_an_update_is_the_one_that_was_made() -> None:
    """Eta by the formula against the move of a friction parameter that is neither clipped nor leaks."""
    own = controller(share=1e-4)
    subject = subject_of(own, duration=0.05)
    learner = subject.learner
    assert learner is not None
    every = np.arange(len(subject.rows))
    found, a, h = stepped(learner, subject.rows, every), truth.numbers_of(learner)[0], learner.context.control_period
    s = np.hstack((subject.signal("z"), subject.signal("r")))
    g = np.einsum("npk,np->nk", found.Y, s)
    eta = shares_of_update(a, found.theta, found.Y, s, subject.signal("z").shape[1], h)
    j = own.regressor.labels.index("v.viscous")
    rate = h * a.bodies.rates[j - own.regressor.inertial]
    np.testing.assert_allclose(np.diff(found.theta[:, j]), eta[:-1] * rate * g[:-1, j], rtol=1e-9, atol=1e-15)
    assert eta.min() < 0.9 and eta.max() <= 1.0


@slow
def test_the_monitor_sees_v_fall_as_the_theorem_says() -> None:
    own = controller()
    known = own.nominal.copy()
    known[own.regressor.inertial :][: own.counts()[0]] -= 0.2  # rotors, which are not learned: as they are
    subject = subject_of(replace(own, nominal=known), duration=0.3)
    proof = Proof(subject.recording)
    v = proof.lyapunov
    assert v.missed < 1e-12 and v.weights[0] > 0
    np.testing.assert_allclose(np.sum(list(v.terms.values()), axis=0), v.measured, rtol=1e-9, atol=1e-9)
    without = lyapunov(subject)
    assert np.abs(v.terms["remainder"]).max() < 1e-6 * np.abs(without.terms["remainder"]).max()
    energy = v.motion + v.weights
    predicted = np.cumsum(v.terms["feedback"]) * v.period
    assert energy[-1] - energy[0] == pytest.approx(predicted[-2], rel=0.05) and energy[-1] < energy[0]


# -- excitation --


@pytest.mark.parametrize("kind", ["differential", "fixed"])
def test_excitation_counts_what_random_motion_excites_as_one(kind: str) -> None:
    regressor = Regressor.of(robot_with_densities(kind))
    unit, mean = regressor.unit(), regressor.gram()
    np.testing.assert_allclose(unit.T @ mean @ unit, np.eye(unit.shape[1]), atol=1e-6)
    assert unit.shape[1] == regressor.identifiable().shape[1]


def test_excitation_of_a_run_is_that_of_its_regressors() -> None:
    own = controller()
    subject = subject_of(own, duration=0.05)
    learner = subject.learner
    assert learner is not None
    (found,) = features_of(learner, subject.rows)
    Y = [own.regressor.matrix(*state) @ own.unit for state in states(subject)]
    values = np.linalg.eigvalsh(np.mean([y.T @ y for y in Y], axis=0))
    assert found.excitation.largest == pytest.approx(values[-1]) and found.excitation.units == own.unit.shape[1]
    assert found.excitation.directions == (values > 1e-3 * values[-1]).sum() < len(values)


# -- the best fixed weights of a linear learner --


def test_the_best_fixed_weights_say_the_truth_where_there_is_one() -> None:
    own = controller()
    subject = subject_of(own, duration=0.05)
    learner = subject.learner
    assert learner is not None
    found = linear_fit(subject, learner)
    assert found is not None and found.W.shape == (own.regressor.size, 1)
    assert found.unexplained.max() < 1e-8 and found.eps.max() < 1e-3 * np.abs(subject.signal("psi")).max()
    Y = np.array([own.regressor.matrix(*state) for state in states(subject)])
    error = (subject.signal("psi") - Y @ learner.end["theta"]) / subject.signal("psi").std(axis=0)
    assert found.distance[1] == pytest.approx(np.sqrt((error**2).mean()), rel=1e-3)


# -- joints that follow others --


@pytest.mark.parametrize("engine", ["compiled", "ordinary"])
def test_a_model_at_what_is_measured_has_slaves_where_their_masters_put_them(engine: str) -> None:
    """Psi of the true model at exact measurements is the true Psi, also with mimic joints under gravity."""
    robot = robot_of(slaves(-1.3, 0.4))
    arm = (Sine(0.4, 1.0), Sine(0.5, 1.3), Hold(0.3))
    loop = Loop(
        robot=robot,
        trajectory=Trajectory(Line(speed=0.1), arm),
        controller=ComputedTorque(feedback(robot, 0.002)),
        timing=Timing(0.05, 1e-3, 1e-3),
        check_gains=False,
        engine=engine,
    )
    run = loop.run()
    assert run.outcome.status == "completed"
    np.testing.assert_allclose(run["psi_hat"], run["psi"], rtol=1e-8, atol=1e-8 * np.abs(run["psi"]).max())
    names = robot.position_names
    at = dict(zip(names, run["position"].T, strict=True))
    assert np.abs(at["follow"] - (-1.3 * at["arm_joint_1"] + 0.4)).max() < 1e-9 and np.ptp(at["follow"]) > 1e-3


def test_distances_of_a_learner_that_does_not_learn_are_no_part_of_v() -> None:
    own = replace(controller(), learning=False)
    subject = subject_of(own, duration=0.02)
    assert subject.learner is not None
    theta = true_parameters(subject, subject.learner)
    found = estimate_part(subject, subject.learner, theta, np.arange(5))
    assert (
        not found.value.any()
        and distances(truth.numbers_of(subject.learner)[0].bodies, theta.theta, own.start()[None])[0] > 0
    )
    assert learners.recorded_learner(subject.recording, subject.robot) is not None


def test_a_body_without_extent_is_infinitely_far_from_one_that_has_it():
    P, flat = np.diag([1.0, 2.0, 3.0, 4.0]), np.diag([1.0, 0.0, 3.0, 4.0])
    near, far, same = divergence(P, np.array([2 * P, flat, P]))
    assert far == np.inf and same == pytest.approx(0.0, abs=1e-12)
    assert near == pytest.approx(4 * np.log(2) - 2)  # log |2 P| / |P| + tr(1 / 2) - 4
