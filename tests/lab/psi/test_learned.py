"""What was learned: FVU, shares, ranks, frozen weights, payload, held-out trajectory; each against a second answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from proofs import KINDS, PERIOD, SLOW, learner, loop_of, robot_of_kind, subject_of
from scipy.spatial.distance import cdist
from scipy.special import expit

from mmnn_pin import Line, Trajectory, compare, load, load_experiment
from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.psi import held_out as held
from mmnn_pin.lab.psi.excitation import effective_rank, excitation
from mmnn_pin.lab.psi.held_out import held_out, loaded, recorded_under_computed_torque, tip, usual_payload
from mmnn_pin.lab.psi.learner import LearnerStepper, frozen_psi_hat, seen
from mmnn_pin.lab.psi.psi import error_in, fvu, fvu_in, psi_along, psi_of, shares, sizes, windows, worst
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.signals import Layout
from mmnn_pin.torque.neural import Neural

patient = settings(deadline=None, max_examples=25)
seeds = st.integers(0, 2**32 - 1)
LONG = 0.6  # FVU counts from 0.5 s on
slow = pytest.mark.skipif(SLOW, reason="too long for uncompiled code")


# -- FVU ------------------------------------------------------------------------------------------------------------


@patient
@given(seeds, st.floats(-3, 3), st.floats(0.1, 10))
def test_fvu_of_the_best_line_is_what_correlation_leaves(seed: int, shift: float, scale: float) -> None:
    rng = np.random.default_rng(seed)
    psi, other = rng.normal(size=(2, 50))
    line = np.polyval(np.polyfit(other, psi, 1), other)
    expected = 1 - np.corrcoef(psi, other)[0, 1] ** 2
    np.testing.assert_allclose(fvu(psi[:, None], line[:, None]), expected, rtol=1e-9)
    np.testing.assert_allclose(fvu(scale * psi[:, None] + shift, scale * line[:, None] + shift), expected, rtol=1e-6)


def test_fvu_of_truth_constant_nothing_and_what_does_not_vary() -> None:
    rng = np.random.default_rng(1)
    psi = rng.normal(size=(200, 3)) + 2.0
    assert (fvu(psi, psi) == 0).all()
    np.testing.assert_allclose(fvu(psi, np.broadcast_to(psi.mean(axis=0), psi.shape)), 1.0)
    np.testing.assert_allclose(fvu(psi, 0 * psi), 1 + psi.mean(axis=0) ** 2 / psi.var(axis=0))
    psi[:, 1] = 7.0
    found = fvu(psi, psi + 0.1)
    assert np.isnan(found[1]) and np.isfinite(found[[0, 2]]).all() and worst(found) == found[[0, 2]].max()
    assert np.isnan(fvu(psi[:0], psi[:0])).all() and np.isnan(worst(np.full(2, np.nan)))


@patient
@given(seeds, st.integers(1, 7))
def test_errors_in_windows_average_to_the_whole(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 0.5 + 0.002 * 420, 0.002)  # 420 samples count, divisible by 1 ... 7
    psi, psi_hat = rng.normal(size=(2, len(time), 2))
    edges, counts = windows(time, count), time >= 0.5 - 1e-9
    assert edges[0] == 0.5 and edges[-1] == pytest.approx(time[-1] + 0.002)
    np.testing.assert_allclose(error_in(edges, time, psi, psi_hat).mean(axis=0), fvu(psi[counts], psi_hat[counts]))
    per_window = np.array_split(np.flatnonzero(counts), count)
    for rows, found in zip(per_window, fvu_in(edges, time, psi, psi_hat), strict=True):
        np.testing.assert_allclose(found, fvu(psi[rows], psi_hat[rows]))
    assert not windows(time[:200], 3).size


# -- shares, ranks --


@patient
@given(seeds)
def test_shares_add_up_and_are_regressions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    torque, psi_hat, robust = rng.normal(size=(3, 40, 2))
    found, rms = shares(torque, psi_hat, robust), sizes(torque, psi_hat, robust)
    np.testing.assert_allclose(sum(found.values()), 1.0)
    for i in range(2):
        slope = np.linalg.lstsq(torque[:, [i]], psi_hat[:, i], rcond=None)[0][0]
        assert found["network"][i] == pytest.approx(slope)
        assert rms["network"][i] == pytest.approx(np.std(psi_hat[:, i] + 1j * 0, mean=0) / np.std(torque[:, i], mean=0))
    assert np.isnan(shares(0 * torque, 0 * torque, 0 * torque)["feedback"]).all()


@patient
@given(seeds, st.integers(1, 6))
def test_effective_rank_counts_equal_directions_and_sees_no_rotation(seed: int, k: int) -> None:
    rng = np.random.default_rng(seed)
    U, _ = np.linalg.qr(rng.normal(size=(9, 9)))
    V, _ = np.linalg.qr(rng.normal(size=(7, 7)))
    assert effective_rank(U[:, :k] @ V[:k]) == pytest.approx(k)
    A = rng.normal(size=(9, 7))
    assert effective_rank(U @ A @ V) == pytest.approx(effective_rank(A)) and 1 < effective_rank(A) <= 7
    assert effective_rank(np.outer(A[:, 0], A[0])) == pytest.approx(1) and effective_rank(0 * A) == 0


@patient
@given(seeds)
def test_excitation_is_the_spectrum_of_the_gram_matrix(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sigma = rng.uniform(size=(60, 5))
    values = np.linalg.eigvalsh(sigma.T @ sigma / 60)
    found = excitation(sigma)
    assert found.smallest == pytest.approx(values[0]) and found.largest == pytest.approx(values[-1])
    assert (found.directions, found.units) == (5, 5)
    # weights along the least excited direction leave exactly that trace in the output
    w = np.linalg.eigh(sigma.T @ sigma)[1][:, 0]
    assert ((sigma @ w) ** 2).mean() == pytest.approx(found.smallest)
    equal = excitation(np.repeat(sigma[:, :1], 5, axis=1))  # zero initial weights: all units alike
    assert equal.directions == 1 and equal.smallest < 1e-28 and equal.rank == pytest.approx(1)
    assert excitation(sigma[:3]).smallest == 0.0  # fewer samples than units


# -- the learner of a recording --


@pytest.mark.compiled
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("which", ["two_layer", "one_layer"])
def test_a_learner_is_built_again_and_says_what_its_networks_say(kind: str, which: str) -> None:
    """Psi_hat of fixed weights against the plain formula on the named signals of the recording."""
    p = robot_of_kind(kind).dimensions.dof
    controller = learner(kind, which, inertia=tuple(np.linspace(0.5, 2.0, p)))
    run = loop_of(kind, controller, duration=0.02).run()
    subject = subject_of(kind, run)
    found = subject.networks
    assert found is not None and found.controller == controller and found.end_time == pytest.approx(0.02)
    told = seen(found, found.end, subject.rows)
    names = controller.inputs.signals
    x = np.hstack([run[name].reshape(len(run), -1) for name in names if name in run])
    np.testing.assert_array_equal(told.inputs, x)
    out_scale = controller.network_scales(subject.layout)[1]
    for i, part in found.networks:
        W, V = found.end[f"W{i}"], found.end[f"V{i}"]
        assert np.abs(W - found.start[f"W{i}"]).max() > 1e-6
        if which == "two_layer":
            hidden = expit(x @ V)
        else:
            hidden = np.exp(-(cdist(x, V.T) ** 2) / (2 * controller.network.width**2))
        np.testing.assert_allclose(told.activations[i], hidden, rtol=1e-9)
        np.testing.assert_allclose(told.psi_hat[:, part], hidden @ W * out_scale[part], rtol=1e-8, atol=1e-12)


def test_a_killed_run_has_the_weights_of_its_last_snapshot() -> None:
    run = loop_of("fixed", learner("fixed"), duration=0.05, weights_interval=0.01).run()
    whole = Subject.of(run).networks
    run.__dict__["final"] = {}  # a run that was killed wrote nothing at its end
    for name in ("W2", "V2"):
        run.weights[name][-1] = np.nan  # nor all of its last snapshot
    found = Subject.of(run).networks
    assert whole is not None and found is not None
    assert whole.end_time == pytest.approx(0.05) and found.end_time == pytest.approx(0.04)
    np.testing.assert_array_equal(found.end["W2"], run.weights["W2"][-2])
    run.__dict__["weights"] = {}
    with pytest.raises(RecordingError, match="no weights"):
        _ = Subject.of(run).networks


def test_settings_of_a_learner_survive_the_recording() -> None:
    for which, more in (("two_layer", {"rates": "per_second", "robust": None}), ("one_layer", {"leakage": False})):
        controller = learner("differential", which, **more)
        assert Neural.from_facts(which, controller.facts(), None) == controller


# -- frozen weights --


@slow
@pytest.mark.parametrize("kind", KINDS)
def test_psi_of_every_kind_of_robot(kind: str) -> None:
    subject = subject_of(kind, loop_of(kind, learner(kind), duration=LONG).run())
    found = psi_of(subject, count=3)
    assert not found.remarks and set(found.frozen) == {"same", "held_out", "payload"}
    assert found.windows.shape == (3, subject.layout.dof)
    counts = subject.signal("time")[:, 0] >= 0.5
    psi, psi_hat = subject.signal("psi")[counts], subject.signal("psi_hat")[counts]
    np.testing.assert_allclose(found.online, ((psi - psi_hat) ** 2).sum(axis=0) / (psi.var(axis=0) * len(psi)))
    truth = psi_along(subject.robot, subject.rows, subject.layout)
    np.testing.assert_allclose(truth, subject.signal("psi"), rtol=1e-8, atol=1e-8)
    assert np.abs(found.frozen["payload"].psi - truth).max() > 1e-3
    np.testing.assert_array_equal(found.frozen["payload"].psi_hat, found.frozen["same"].psi_hat)
    assert found.weights_time == pytest.approx(LONG)


def test_a_run_of_half_a_second_has_no_fvu() -> None:
    subject = Subject.of(loop_of("fixed", learner("fixed"), duration=0.05).run())
    with pytest.raises(RecordingError, match="too short for Psi"):
        psi_of(subject)


# -- payload --


@pytest.mark.parametrize("name", ["platform_arm", "two_axis_arm", "mobile", "fixed"])
def test_a_payload_adds_the_kinetic_energy_of_a_point_at_the_tip(name: str) -> None:
    robot = {"mobile": "differential", "fixed": "fixed"}.get(name)
    robot = load(name) if robot is None else robot_of_kind(robot)
    heavy, mass = loaded(robot, 1.7), 1.7
    rng = np.random.default_rng(4)
    position, nu = robot.neutral_position(), rng.normal(size=robot.dimensions.dof)
    position[robot.arm_index] = rng.uniform(-1, 1, robot.dimensions.arm)
    joint = robot.model.getJointId(robot.joint_names[-1])
    at = tip(robot.model, joint, True)
    data, q = robot.model.createData(), robot.configuration(position)
    frame = robot.model.copy()
    point = frame.addFrame(pin.Frame("load", joint, 0, pin.SE3(np.eye(3), at), pin.FrameType.OP_FRAME))
    data = frame.createData()
    pin.forwardKinematics(frame, data, q, robot.T @ nu)
    velocity = pin.getFrameVelocity(frame, data, point, pin.LOCAL).linear
    before, after = (nu @ Dynamics(each).mass_matrix(position) @ nu / 2 for each in (robot, heavy))
    assert after - before == pytest.approx(mass * velocity @ velocity / 2, rel=1e-9)
    assert after - before > 1e-3


def test_the_usual_payload_is_a_quarter_of_the_arm() -> None:
    assert usual_payload(load("platform_arm")) == pytest.approx(0.25 * 8.0)
    assert usual_payload(load("two_axis_arm")) == pytest.approx(0.25 * 2.0)
    assert tip(load("platform_arm").model, 3, True) == pytest.approx([0.4, 0.0, 0.04])


# -- the held-out trajectory --


@pytest.mark.parametrize("kind", KINDS)
def test_the_held_out_trajectory_is_another_one(kind: str) -> None:
    subject = subject_of(kind, loop_of(kind, learner(kind), duration=0.05).run())
    found = held_out(subject)
    layout, robot = subject.layout, subject.robot
    times = np.arange(0.0, found.duration, 0.01)
    rows = np.zeros((len(times), layout.width))
    rows[:, layout.where("pose_ref").start : layout.where("qddot_ref").stop] = found.trajectory.table(times, layout)
    q, rate = rows[:, layout.where("q_ref")], rows[:, layout.where("qdot_ref")]
    assert (q >= robot.lower[robot.arm_index]).all() and (q <= robot.upper[robot.arm_index]).all()
    assert (np.ptp(rate, axis=0) > 0.05).all()  # the joint that stood still moves, too
    was = np.abs(subject.signal("qdot_ref")[:, 0]).max()
    assert np.abs(rate[:, 0]).max() == pytest.approx(held.FASTER * was, rel=0.02)
    assert found.duration / PERIOD == pytest.approx(round(found.duration / PERIOD))


def test_it_is_faster_and_turns_no_more_than_allowed() -> None:
    experiment = load_experiment("track", ["time.duration=10", "time.control_period=0.01", "time.plant_step=0.01"])
    robot = experiment.load_robot()
    loop = experiment.loop(robot, experiment.controller("pd", robot=robot))
    rows = np.zeros((1000, Layout.of(robot.dimensions).width))
    rows[
        :, Layout.of(robot.dimensions).where("pose_ref").start : Layout.of(robot.dimensions).where("qddot_ref").stop
    ] = loop.table()
    velocity = rows[:, Layout.of(robot.dimensions).where("velocity_ref")]
    path, lap = held.base_path(velocity, False)
    assert path is not None
    driven = path.sample(np.arange(0.0, lap, 0.01)).velocity
    assert np.abs(driven[:, 0]).mean() == pytest.approx(1.3 * np.abs(velocity[:, 0]).mean(), rel=1e-3)
    assert np.abs(driven[:, 1]).max() <= 1.301 * np.abs(velocity[:, 1]).max()


@slow
def test_it_is_the_same_for_all_learners_and_followed() -> None:
    """Also for a run that ended early; under computed torque the robot does what is asked."""
    experiment = load_experiment("chapter4", ["time.duration=0.6"])
    robot = experiment.load_robot()
    wanted = []
    for name, rows in (("two_layer", 300), ("one_layer", 100)):
        loop = experiment.loop(robot, experiment.controller(name, robot=robot))
        subject = Subject.of(loop.run(meta={"config": experiment.to_json()}))
        wanted.append(held_out(replace(subject, rows=subject.rows[:rows])))
    assert wanted[0] == wanted[1]
    assert subject.networks is not None
    feedback = subject.networks.controller.feedback
    rows = recorded_under_computed_torque(robot, wanted[0], feedback, subject.kinematic, subject.timing)
    assert len(rows) == round(wanted[0].duration / 0.002)
    assert np.abs(rows[:, Layout.of(robot.dimensions).where("pose_error")]).max() < 2e-3
    np.testing.assert_allclose(
        rows[:, Layout.of(robot.dimensions).where("psi")],
        psi_along(robot, rows, Layout.of(robot.dimensions)),
        rtol=1e-8,
        atol=1e-8,
    )


def test_a_config_may_name_its_own() -> None:
    own = ["held_out.ring.duration=1.5", 'held_out.ring.base={type="circle", radius=1.0, speed=0.5}']
    own += ['held_out.ring.arm={type="hold", value=0.2}', "time.duration=0.02"]
    experiment = load_experiment("chapter4", own)
    robot = experiment.load_robot()
    loop = experiment.loop(robot, experiment.controller("two_layer", robot=robot))
    found = held_out(Subject.of(loop.run(meta={"config": experiment.to_json()})))
    assert found.duration == 1.5 and type(found.trajectory.base).__name__ == "Circle"
    broken = load_experiment("chapter4", [*own, 'held_out.ring.base={type="ring"}'])
    with pytest.raises(Exception, match="held_out") as caught:
        broken.held_out_of(robot, "ring")
    assert caught.value.key == "held_out.ring.base.type"  # type: ignore[attr-defined]


@pytest.mark.parametrize("controller", ["two_layer", pytest.param("adaptive", marks=pytest.mark.compiled), "learned"])
def test_frozen_weights_walked_compiled_are_those_stepped_row_by_row(controller: str) -> None:
    runs = compare(load("platform_arm"), Trajectory.of(load("platform_arm"), Line(0.3)), [controller], duration=0.6)
    subject = Subject.of(runs[controller])
    assert subject.learner is not None
    stepper = LearnerStepper(subject.learner, subject.learner.end.snapshot(), learning=False)
    expected = []
    for n, row in enumerate(subject.rows):
        stepper.step(row)
        expected += [stepper.known.copy()] * (n % 3 == 0)
    found = frozen_psi_hat(subject.learner, subject.learner.end, subject.rows, 3)
    np.testing.assert_array_equal(found, np.array(expected))
    assert found.any()
