"""What is proved of the controllers beside the thesis's: their part of V, what leads, what limits take, bad weights."""

from __future__ import annotations

from dataclasses import replace

import h5py
import numpy as np
import pytest
from builders import loop
from learning import made
from proofs import learner, loop_of, robot_of_kind, subject_of
from robots import feedback
from test_lead import (
    compiled,  # noqa: F401
    one_more_compiled_loop,
)
from test_learning_law import OnTop
from test_lyapunov import DURATION
from test_radii import LEFT
from test_radii import loop_with as rolling

from mmnn_pin import Neural, Recording, load_experiment
from mmnn_pin.cli import main
from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.torque.classical import PID
from research.proof.certified_loop import refusal
from research.proof.certified_run import prove
from research.proof.linear import linear_fit
from research.proof.lyapunov import limited_power, lyapunov, powers
from research.proof.networks import ideal_weights
from research.proof.proof import Proof, proof_of, weights_of


def test_the_part_of_v_of_pid_is_that_of_its_gain():
    loop = made("pid", "pid.rate=4.0")
    proof = Proof(loop.run())
    found, k = proof.lyapunov, loop.controller.feedback.vector(loop.robot.dimensions)
    d = proof.ideal.W[:, 0]
    assert found.weights[0] == pytest.approx((d**2 / (4.0 * k)).sum() / 2)
    assert found.missed < 1e-12
    assert np.abs(found.terms["own"]).max() < 0.01 * np.abs(found.terms["feedback"]).max()  # angles for noisy rates


def test_a_proof_of_pd_with_gravity_judges_its_estimate():
    proof = Proof(made("pd_gravity").run())
    assert np.isfinite(proof.lyapunov.missed)


@pytest.mark.parametrize(
    ("method", "answer", "fix"),
    [
        ("learning_gain", None, "write a method learning_gain(state, context) that returns Gamma"),
        (
            "learning_gain",
            -np.ones(4),
            "(state, context) of pid is not positive definite",
        ),
        ("weights", {}, "return one such array in `weights`"),
    ],
)
def test_an_observer_without_its_part_names_the_method_that_is_missing(monkeypatch, method, answer, fix):
    run = made("pid", duration=0.02).run()
    monkeypatch.setattr(PID, method, lambda *told: answer)
    proof = Proof(run)
    assert not proof.lyapunov.weights.any() and fix in proof.left_out


@pytest.mark.compiled
@one_more_compiled_loop
def test_a_proof_takes_the_lead_out_of_the_feedback(compiled):  # noqa: F811
    loop, run = compiled
    subject = Subject.of(run)
    rows = subject.rows
    found = powers(subject, rows, subject.truth(rows), subject.applied, subject.hardware.torque, subject.hardware.push)
    s = np.hstack((run["z"], run["r"]))
    K = loop.controller.feedback_gain(loop.layout)
    np.testing.assert_allclose(found["feedback"], -(K * s**2).sum(axis=1), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found["lead"], (s * (run["psi_hat"] - run["psi_applied"])).sum(axis=1), atol=1e-12)
    assert np.abs(found["lead"]).max() > 0


@pytest.mark.parametrize("which", ["two_layer", "one_layer"])
def test_what_the_limits_take_is_a_term_of_v(tmp_path, which):
    """Stepped again from a file the learner says the recorded Psi_hat, and V changes as its terms say, to rounding."""
    loop = loop_of("differential", learner("differential", which), duration=DURATION, within_limits=True)
    run = replace(loop, robot=replace(loop.robot, effort_limits=np.full(loop.robot.dimensions.motors, 0.3)))
    run.run(tmp_path / "run.h5")
    subject = replace(Subject.of(Recording.open(tmp_path / "run.h5")), robot=run.robot, told=run.robot)
    one = subject.networks
    assert one is not None and one.context.limits is not None
    rows, every = subject.rows, np.arange(len(subject.rows))
    ideal = ideal_weights(subject, one)
    part = weights_of(subject, ideal).part
    found, lost = part(every, None), limited_power(one, rows, every)
    s = subject.signal("nu_ref") - subject.signal("nu")
    error = (s * (subject.signal("psi") - subject.signal("psi_hat"))).sum(axis=1)
    change = np.diff(found.value) / subject.timing.control_period
    expected = (found.terms["leakage"] + found.terms["remainder"] - error)[:-1] + found.arrived["step"][1:]
    np.testing.assert_allclose(change, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())
    assert found.missed == 0.0 and np.abs(lost).max() > 1e-3 * np.abs(error).max()
    v = lyapunov(subject, part, most=10**6)
    np.testing.assert_array_equal(v.terms["limits"], lost[:-1])
    np.testing.assert_array_equal(v.terms["remainder"], (found.terms["remainder"] - lost)[:-1])


def test_a_certificate_does_not_count_with_them():
    for within, words in ((True, "motors' limits"), (False, "")):
        said = [f"learning.within_limits={str(within).lower()}", "time.duration=0.02"]
        experiment = load_experiment("certified", said)
        robot = experiment.load_robot()
        run = experiment.loop(robot, experiment.controller("two_layer", robot=robot)).run()
        assert words in refusal(Subject.of(run)) and bool(words) == bool(refusal(Subject.of(run)))


def test_weights_whose_squares_overflow_have_no_ideal(tmp_path):
    run = loop(Neural(), duration=0.6).run(tmp_path / "run.h5")
    assert proof_of(run).ideal is not None
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file["weights/V1"][0] = 1e300
    with pytest.raises(RecordingError, match="no ideal weights: weights of network 1"):
        assert proof_of(Recording.open(tmp_path / "run.h5")).ideal
    assert main(["prove", str(tmp_path / "run.h5")]) == 0


def test_nothing_is_left_for_weights_on_top_of_the_true_parameters():
    robot = robot_of_kind("differential")
    law = OnTop(theta=tuple(parameters(robot)), feedback=feedback(robot, 0.002))
    subject = subject_of("differential", loop_of("differential", law, duration=0.05).run())
    found = linear_fit(subject, subject.learner)
    assert found is not None and found.norm < 1e-6 and found.unexplained.max() < 1e-12


def test_prove_holds_the_run_to_the_true_robot():
    found = prove(rolling({LEFT: 1.05}).run()).to_dict()
    assert found["equality"]["holds"] and found["equality"]["steps"] < 1e-9
    assert "other radii" in found["certificate"]["why_not"]
