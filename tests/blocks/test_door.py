"""The door for measurements: turns go on, jumps trip and are taken out, and nothing else changes a bit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from closed_form import inertial, joint
from hypothesis import example, given, settings
from hypothesis import strategies as st
from robots import robot_of

from mmnn_pin import PD, Stepper, StepperSettings, load
from mmnn_pin.errors import ConfigError
from mmnn_pin.reference.wishes import JointGoal
from mmnn_pin.safety import Safety, accept, new_state, release, trip_of
from mmnn_pin.safety.supervisor import TURN
from mmnn_pin.signals import Layout, Measurement

ROBOT = load("platform_arm")
NB = ROBOT.dimensions.base
ENCODERS = st.sampled_from([0.0, -math.pi, -1.0, 2.5])  # seams


class Entrance:
    """A door, and what is in the row behind it."""

    def __init__(self, safety=Safety(jump=0.1), robot=ROBOT):  # noqa: B008
        d = robot.dimensions
        self.layout = Layout.of(d, wheels=0, hardware=1)
        self.supervisor = safety.supervisor(robot, 0.002, np.ones(d.dof), np.ones(d.arm), values=new_state(d))
        self.row = self.layout.new_row()
        self.received = self.row[self.layout.where("pose").start : self.layout.where("qdot").stop]

    def take(self, time, *parts):
        self.received[:] = np.concatenate(parts)
        accept(self.row, self.layout.offsets, time, time, True, self.supervisor.door)
        return self.received.copy()

    @property
    def tripped(self):
        return bool(self.supervisor.state.tripped[0])


def wrapped(angle, seam):
    """As an encoder reads it that jumps at a seam."""
    return (angle - seam) % (2 * math.pi) + seam


@settings(max_examples=100, deadline=None)
@given(ENCODERS, st.floats(-24.0, 24.0), st.floats(-24.0, 24.0), st.floats(0.001, 0.2), st.integers(0, 99))
@example(2.5, 22.0, -21.0, 0.2, 1)
def test_angles_that_wrap_go_on_as_the_true_ones_whatever_the_seam(seam, w, speed, dt, seed):
    """Headings and joints, also fast ones read rarely: the true angle up to a whole turn, and no jump."""
    rng, door = np.random.default_rng(seed), Entrance(Safety(jump=0.1, joint_speed="none"))
    phi, q, acceleration = rng.uniform(-3.0, 3.0), rng.uniform(-3.0, 3.0, 2), rng.uniform(-2.0, 2.0, 3)
    offsets = None
    for k in range(40):
        nu = np.array([w, speed, -speed]) + acceleration * k * dt
        true = np.array([phi, *q]) + np.array([w, speed, -speed]) * k * dt + 0.5 * acceleration * (k * dt) ** 2
        found = door.take(k * dt, [0.0, 0.0, wrapped(true[0], seam)], [0.0, nu[0]], wrapped(true[1:], seam), nu[1:])
        turns = (found[[2, 5, 6]] - true) / (2 * math.pi)
        offsets = turns if offsets is None else offsets
        np.testing.assert_allclose(turns, offsets, atol=1e-9)
        np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    assert not door.tripped


@settings(max_examples=50, deadline=None)
@given(st.lists(st.lists(st.floats(-3.0, 3.0), min_size=9, max_size=9), min_size=1, max_size=9))
def test_what_does_not_wrap_keeps_its_bits(rows):
    door = Entrance(Safety())
    before = np.zeros(9)
    for k, row in enumerate(rows):
        sent = np.array(row)
        sent[[2, 5, 6]] = np.clip(sent[[2, 5, 6]], before[[2, 5, 6]] - 2.0, before[[2, 5, 6]] + 2.0)
        before = sent.copy()
        assert door.take(k * 1e-3, sent).tobytes() == before.tobytes()
    assert not door.tripped


def limited(lower=-3.1, upper=3.1):
    """A joint that turns between ends, and one that slides."""
    text = ""
    for name in ("base", "upper", "lower"):
        text += f'<link name="{name}">{inertial(1.0, (0.1, 0.1, 0.1))}</link>'
    for name, kind, ends, above, below in (
        ("turns", "revolute", (lower, upper), "base", "upper"), ("slides", "prismatic", (-9.0, 9.0), "upper", "lower"),
    ):  # fmt: skip
        limit = f'<limit lower="{ends[0]}" upper="{ends[1]}" effort="9" velocity="4"/>'
        text += joint(name, above, below, "", "0 0 1", limit, kind)
    return robot_of(f'<robot name="r">{text}</robot>')


@pytest.mark.parametrize("seam", [0.0, -1.0, 1.5])
def test_a_joint_with_ends_is_read_between_them_from_an_encoder_that_wraps_within_them(seam):
    robot = limited()
    for start in (-2.9, -1.2, 0.4, 2.8):
        door = Entrance(robot=robot)
        for k in range(300):
            true = np.clip(start + 0.02 * k * (1 if start < 0 else -1), -3.0, 3.0)
            speed = 0.02 / 0.01 * (1 if start < 0 else -1)
            found = door.take(0.01 * k, [wrapped(true, seam), 7.0], [speed, 0.0])
            assert found[0] == pytest.approx(true, abs=1e-9) and found[1] == 7.0  # one that slides never turns
        assert not door.tripped


def test_a_joint_that_rests_just_outside_of_its_ends_stays_there():
    for q in (3.1001, -3.1001, 4.0):
        found = Entrance(robot=limited()).take(0.0, [q, 0.0], [0.0, 0.0])[0]
        assert found == (q if q != 4.0 else pytest.approx(4.0 - 2 * math.pi))
    assert Entrance(robot=limited(-1.0, 1.0)).take(0.0, [3.0, 0.0], [0.0, 0.0])[0] == 3.0  # no turn brings it in


def test_a_jump_that_no_speed_explains_trips_and_is_taken_out():
    door, still = Entrance(Safety(jump=0.1, joint_speed=4.0)), np.zeros(2)
    door.take(0.0, np.zeros(3), still, [0.3, 0.5], still)
    assert door.take(0.01, np.zeros(3), still, [0.3 + 0.1 + 2 * 4.0 * 0.01 - 1e-9, 0.5], still)[5] > 0.47
    assert not door.tripped
    found = door.take(0.02, np.zeros(3), still, [2.0, 0.5], still)
    assert door.tripped and found[5] < 0.48  # it stays where it was
    after = door.take(0.03, np.zeros(3), still, [2.01, 0.5], still)
    assert after[5] - found[5] == pytest.approx(0.01)  # and goes on from there
    time, signal, text = trip_of(door.supervisor.state, ROBOT)
    assert (time, signal) == (0.02, "q[0]")
    assert "tripped at t = 0.02 s: arm_1_joint jumps by 1.52 rad" in text and "its speed explains 0.18 rad" in text
    assert release(0.03, door.supervisor)
    assert door.take(0.04, np.zeros(3), still, [2.02, 0.5], still)[5] == pytest.approx(2.02) and not door.tripped


def test_without_a_limit_a_jump_is_a_motion():
    door, still = Entrance(Safety()), np.zeros(2)
    door.take(0.0, np.zeros(3), still, [0.3, 0.5], still)
    assert door.take(0.01, np.zeros(3), still, [2.0, 0.5], still)[5] == 2.0 and not door.tripped
    assert door.supervisor.state.good[0] == 2.0


def test_a_stepper_holds_where_a_jump_began_and_goes_on_from_the_new_reading_after_a_reset():
    period, q = 0.002, np.array([0.3, 0.5])
    still = np.zeros(2)
    with Stepper(ROBOT, PD(), StepperSettings(period=period)) as stepper:
        for k in range(60):
            read = q + np.array((1.5, 0.0)) if k >= 30 else q
            stepper.step(k * period, Measurement(np.zeros(3), still, read, still), JointGoal(q) if k == 1 else None)
            assert stepper.tripped == (k >= 30)
            if k > 30:
                assert np.abs(stepper.torque[NB:]).max() < 1e-9  # no spring to a place that it does not know
        stepper.reset()
        np.testing.assert_allclose(stepper.measured.q, [1.8, 0.5])
        for k in range(60, 90):
            stepper.step(k * period, Measurement(np.zeros(3), still, q + np.array((1.5, 0.0)), still), None)
        assert not stepper.tripped
        np.testing.assert_allclose(stepper.setpoint.q, [1.8, 0.5], atol=1e-9)


def test_what_the_door_knows_of_joints_comes_from_the_urdf():
    door = Entrance(robot=limited()).supervisor.door
    assert door.joints[TURN].tolist() == [2 * math.pi, 0.0]
    with pytest.raises(ConfigError, match=r"safety\.jump"):
        Safety(jump=0.0)
    with pytest.raises(ConfigError, match=r"safety\.slowest"):
        Safety(slowest=-1.0)
