"""What is learned within the motors' limits: by bisection, in both engines, batches, cycles, plain Python."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from builders import first_of
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import SHORT, assert_engines_agree, assert_it_resumes, made
from proofs import learner, loop_of

from mmnn_pin import Feedback, LearningLaw, Stepper, TorqueController, load, load_experiment
from mmnn_pin.safety import Safety
from mmnn_pin.sensing import Sensor
from mmnn_pin.signals import Measurement, Setpoint
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.law import limit, motor_limits, share_left
from mmnn_pin.torque.neural import Robust

ROBOT = load("platform_arm")
E_INV = np.linalg.pinv(ROBOT.E)
LEARNERS = (
    *("two_layer", "one_layer", "two_layer_residual", "adaptive", "adaptive_composite"),
    *("concurrent", "kalman_regressor", "kalman_features"),
)
SMALL = np.array([3.0, 3.0, 12.0, 8.0])  # [N m]: the feedback takes part of it, and leaves too little for Psi
numbers = st.floats(-1e4, 1e4) | st.sampled_from([0.0, 1e-300, 1e12, -1e12])
vectors = st.lists(numbers, min_size=4, max_size=4).map(np.array)
moderate = st.lists(st.floats(-1e4, 1e4), min_size=4, max_size=4).map(np.array)
tops = st.lists(st.floats(1e-3, 1e4) | st.just(np.inf), min_size=4, max_size=4).map(np.array)


def room(u, fed, top):
    """Largest share of u that a motor has room for beside a feedback, by bisection of what may be asked of it."""

    def fits(share):
        low, high = min(-top, fed), max(top, fed)
        return low <= share * u + fed <= high

    if fits(1.0):
        return 1.0
    inside, outside = 0.0, 1.0
    for _ in range(200):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if fits(middle) else (inside, middle)
    return inside


@settings(max_examples=100, deadline=None)
@given(vectors, vectors, tops)
def test_of_every_motor_psi_hat_takes_what_the_feedback_leaves(psi_hat, feedback, top):
    asked, limits = psi_hat.copy(), motor_limits(ROBOT.E, top)
    if limits is None:
        assert np.isinf(top).all()
        return
    limit(psi_hat, feedback, limits)
    np.testing.assert_array_equal(limits.asked, asked)
    u, fed, given_ = E_INV @ asked, E_INV @ feedback, E_INV @ psi_hat
    scale = 1e-9 * (np.abs(u).max() + np.abs(fed).max())
    for j in range(4):
        expected = u[j] * min(room(u[j], fed[j], top[j]), top[j] / max(abs(u[j]), 1e-300))
        assert given_[j] == pytest.approx(expected, rel=1e-9, abs=scale)
    if (np.abs(u) < 0.99 * top).all() and (np.abs(u + fed) < 0.99 * top).all():
        np.testing.assert_array_equal(psi_hat, asked)  # to the bit


@settings(max_examples=100, deadline=None)
@given(moderate, moderate, tops)
def test_a_term_is_lowered_as_a_whole_to_where_all_motors_have_room(feedback, more, top):
    limits = motor_limits(ROBOT.E, top)
    if limits is not None:
        u, fed, share = E_INV @ more, E_INV @ feedback, share_left(feedback, more, limits)
        near = 1e-9 * (np.abs(u).max() + np.abs(fed).max() + 1e-300)
        above = share * u + fed - np.maximum(top * (1 + 1e-9), fed)
        below = np.minimum(-top * (1 + 1e-9), fed) - share * u - fed
        assert 0 <= share <= 1 and max(above.max(), below.max()) <= near
        further = (share * u + np.sign(u) * 2e-9 * (np.minimum(top, 1e9) + np.abs(fed)) + fed)[u != 0]
        low, high = np.minimum(-top, fed)[u != 0], np.maximum(top, fed)[u != 0]
        assert share == 1 or (further > high - near).any() or (further < low + near).any()  # and no more of it


def test_what_is_no_number_stays_so_that_the_run_ends_and_without_limits_there_is_nothing_to_do():
    limits = motor_limits(np.eye(1), np.array([5.0]))
    for asked, expected in ((np.inf, 5.0), (-np.inf, -5.0), (np.nan, np.nan)):
        psi_hat = np.array([asked])
        limit(psi_hat, np.zeros(1), limits)
        assert psi_hat[0] == pytest.approx(expected, nan_ok=True)
    assert motor_limits(ROBOT.E, np.full(4, np.inf)) is None


def weak(name, *said, **more):
    """The loop of a learner whose motors can give little."""
    loop = made(name, "learning.within_limits=true", *said, **more)
    return replace(loop, robot=replace(loop.robot, effort_limits=SMALL), nominal=loop.robot)


def assert_within(run, gain, top=SMALL):
    """No motor is asked for more than its limit unless k s alone asks for more; Psi_hat never."""
    s = np.hstack((run["z"], run["r"]))
    alone, asked = np.abs((gain * s) @ E_INV.T), np.abs(run["motor_torque"])
    assert (asked <= np.maximum(top, alone) * (1 + 1e-9)).all()
    assert (np.abs(run["psi_hat"] @ E_INV.T) <= top * (1 + 1e-9)).all()
    np.testing.assert_allclose(run["torque"], run["effective_gain"] * s + run["psi_hat"], rtol=1e-9, atol=1e-6)
    return (asked > 0.999 * top).any()


@pytest.mark.parametrize("name", first_of(LEARNERS, "two_layer", "adaptive", "kalman_regressor"))
def test_every_learner_in_both_engines_and_in_batches(name):
    loop = weak(name)
    run = assert_engines_agree(loop)
    assert_within(run, loop.controller.feedback.vector(loop.robot.dimensions))
    assert run.meta["within_limits"] is True


@pytest.mark.parametrize("name", first_of(("two_layer", "adaptive", "kalman_features"), "two_layer", "adaptive"))
def test_it_takes_hold_and_goes_on_where_it_was(name):
    loop = weak(name)
    reached = assert_within(loop.run(), loop.controller.feedback.vector(loop.robot.dimensions))
    free = replace(loop, within_limits=False).run()
    asked = np.abs(free["psi_hat"] @ E_INV.T)
    assert reached and free.meta["within_limits"] is False
    assert (asked > SMALL).any() or np.abs(free["motor_torque"]).max() > SMALL.max() or SHORT < 0.1
    assert_it_resumes(loop, SHORT / 2)


def test_far_limits_change_no_bit():
    loop = made("two_layer", "learning.within_limits=true")
    far = replace(loop, robot=replace(loop.robot, effort_limits=np.full(4, 1e9)))
    runs = [one.run() for one in (far, replace(loop, within_limits=False))]
    for name in ("torque", "psi_hat", "robust", "effective_gain"):
        np.testing.assert_array_equal(runs[0][name], runs[1][name])


def test_the_robust_term_goes_first_of_what_the_weights_bring():
    """`k s` is never touched; the share of the robust term is one number for all velocities."""
    strong = Robust(5e3, 5e2, (2.0, 3.0))
    loop = loop_of("differential", learner("differential", robust=strong), within_limits=True)
    limited = replace(loop, robot=replace(loop.robot, effort_limits=np.full(loop.robot.dimensions.motors, 0.5)))
    runs = [one.run() for one in (limited, replace(limited, within_limits=False))]
    k = limited.controller.feedback.vector(limited.robot.dimensions)
    more = [(run["effective_gain"] - k)[0] for run in runs]  # at the first sample both have the same weights
    share = more[0] / more[1]
    assert 0 <= share[0] < 1 and np.ptp(share) < 1e-9
    s = np.hstack((runs[0]["z"], runs[0]["r"]))
    np.testing.assert_allclose(runs[0]["robust"], (runs[0]["effective_gain"] - k) * s, atol=1e-9)


class Large(LearningLaw):
    """Says far too much."""

    def init(self, context):
        return ControllerState.of(W=(context.layout.dof,))

    def estimate(self, now, state):
        return state["W"] - 100.0

    def learn(self, now, state):
        state["W"] += now.sent  # what was sent, not what it asked for


class Own(TorqueController):
    """Tells what of its torque is Psi_hat."""

    def step(self, time, reference, measurement, command, state):
        s = np.concatenate((command.z, command.r))
        return 10.0 * s + 100.0, np.full(s.size, 100.0)


@pytest.mark.parametrize("kind", [Large, Own])
def test_controllers_in_plain_python(kind):
    loop = weak("pd")
    controller = kind(feedback=Feedback(10.0, 10.0)) if kind is Large else kind()
    run = replace(loop, controller=controller, within_limits=True, check_gains=False).run()
    s = np.hstack((run["z"], run["r"]))
    u, fed = (np.full(4, 100.0 if kind is Own else -100.0) + 0 * s)[0], 10.0 * s[0]
    rooms = [room(a, b, t) * a for a, b, t in zip(E_INV @ u, E_INV @ fed, SMALL, strict=True)]
    np.testing.assert_allclose(run["psi_hat"][0], ROBOT.E @ np.clip(rooms, -SMALL, SMALL), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(run["torque"], 10.0 * s + run["psi_hat"], rtol=1e-9, atol=1e-9)
    assert (np.abs(run["motor_torque"]) <= np.maximum(SMALL, np.abs(10.0 * s @ E_INV.T)) * (1 + 1e-9)).all()
    if kind is Large:
        np.testing.assert_allclose(run.final["controller_state"], run["torque"][:-1].sum(axis=0))
    off = replace(loop, controller=controller, within_limits=None, check_gains=False)
    assert (off.context().limits is not None) == (kind is Large)  # what a step returns is sent, unless one says


def test_a_cycle_does_the_same():
    loop = replace(weak("two_layer", duration=0.02), safety=Safety(torque=None), sensor=Sensor())
    twin = loop.run()
    with Stepper.of(loop) as cycle:
        for k in range(len(twin)):
            parts = {name: np.array(twin[name][k]) for name in ("pose", "velocity", "q", "qdot")}
            asked = Setpoint.side_by_side(loop.table()[k], loop.layout)
            command = cycle.step(k * cycle.period, Measurement(**parts), asked)
            np.testing.assert_allclose(command.effort, twin["torque"][k], rtol=1e-9)


def test_on_by_default_beyond_the_thesis():
    for name in LEARNERS:
        assert (made(name).context().limits is not None) == (name not in ("two_layer", "one_layer"))
    for name in ("pd", "computed_torque"):
        assert made(name).context().limits is None
    for name in ("chapter4", "chapter5"):
        assert load_experiment(name).learning.within_limits is None
