"""The energy of the errors changes as the model says, on every kind of robot; and no longer when a term is broken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from proofs import KINDS, PERIOD, SLOW, learner, loop_of, robot_of_kind, subject_of

from mmnn_pin import Line, Timing, Trajectory, load_experiment
from mmnn_pin.actuator import Actuator
from mmnn_pin.disturbance import BlockedJoint, Payload, Push
from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.sensing import Sensor
from mmnn_pin.signals import INDEX, Layout
from research.proof import balance as module
from research.proof.balance import TOLERANCE, Balance, Between, balance, evenly, polynomial

DURATION = 0.02 if SLOW else 0.1


@pytest.fixture(scope="module", params=KINDS)
def run(request: pytest.FixtureRequest) -> tuple[str, Subject]:
    recording = loop_of(request.param, duration=DURATION).run()
    return request.param, subject_of(request.param, recording)


def test_the_equality_holds_over_every_period(run: tuple[str, Subject]) -> None:
    _, subject = run
    found = balance(subject)
    assert len(found.time) == found.periods == round(DURATION / PERIOD) - 1
    assert found.identity < 0.1 * TOLERANCE and found.steps < 0.1 * TOLERANCE and found.holds
    assert np.abs(found.increment).max() > 1e-5  # and it is not about nothing
    np.testing.assert_array_equal(found.time, subject.recording.time[:-1])


def test_a_trial_step_that_overflows_is_made_shorter(run: tuple[str, Subject], monkeypatch: pytest.MonkeyPatch) -> None:
    """A stiff arm leaves all numbers within one trial step: the solver has to take a shorter one, not to stop."""
    _, subject = run
    as_it_is, flow = balance(subject, budget=0), module.Motion.flow
    broken: list[float] = []

    def overflows(self: module.Motion, t: float, y: np.ndarray) -> float:
        if t > 0 and len(broken) < 5:
            broken.append(t)
            return 1e200
        return flow(self, t, y)

    monkeypatch.setattr(module.Motion, "flow", overflows)
    found = balance(subject, budget=0)
    assert len(broken) == 5 and found.holds
    np.testing.assert_allclose(found.work, as_it_is.work, rtol=1e-9)


def test_it_holds_whatever_the_torque_and_the_sensors_are() -> None:
    """With a learner, noise, and measurements between which the torque is held: alpha is that of the true state."""
    sensor = Sensor(noise=1e-3, velocity_noise=1e-2, velocity="true", delay=1)
    loop = loop_of("differential", learner("differential"), duration=DURATION, sensor=sensor)
    subject = Subject.of(loop.run())
    assert not subject.exact_sensors
    found = balance(subject)
    assert found.holds
    held = subject.truth(subject.rows)[:, subject.layout.where("nu_ref")] - subject.signal("nu_ref")
    assert np.abs(held).max() > 1e-3  # the controller did not know the true alpha


def drop(name: str):
    """A command that forgets a part of itself."""
    command = module.command

    def forgetful(row, at, *others) -> None:
        command(row, at, *others)
        row[at[INDEX[name]] : at[INDEX[name] + 1]] = 0.0

    return forgetful


def hold_reference(self: Between, k: int, t: float, row: np.ndarray) -> None:
    HELD(self, k, 0.0, row)


HELD = Between.write


def without_coriolis(self: Dynamics, nu_ref, nudot_ref, psi) -> None:
    psi[:] = self.M @ nudot_ref + self.robot.T.T @ self.g_full + self.F


def without_gravity(self: Dynamics, nu_ref, nudot_ref, psi) -> None:
    REFRESH(self, nu_ref, nudot_ref, psi)
    psi -= self.robot.T.T @ self.g_full


def without_friction(self: Dynamics, nu_ref, nudot_ref, psi) -> None:
    REFRESH(self, nu_ref, nudot_ref, psi)
    psi -= self.F


REFRESH = Dynamics.refresh_psi


@pytest.mark.parametrize(
    ("where", "what", "broken"),
    [
        (module, "command", drop("nudot_ref")),
        (Between, "write", hold_reference),
        (Dynamics, "refresh_psi", without_coriolis),
        (Dynamics, "refresh_psi", without_gravity),
        (Dynamics, "refresh_psi", without_friction),
    ],
    ids=["the command's derivative", "the reference moves", "Coriolis", "gravity", "friction"],
)
def test_a_broken_term_is_found(where: object, what: str, broken: object, monkeypatch: pytest.MonkeyPatch) -> None:
    subject = Subject.of(loop_of("differential", duration=DURATION).run())
    assert balance(subject).holds
    monkeypatch.setattr(where, what, broken)
    found = balance(subject)
    assert not found.holds and found.identity > 100 * TOLERANCE


def changed(subject: Subject, name: str, factor: float) -> Subject:
    rows = subject.rows.copy()
    rows[:, subject.layout.where(name)] *= factor
    return replace(subject, rows=rows)


def more_torque(subject: Subject) -> Subject:
    subject.hardware.torque[:] *= 1.001
    return subject


@pytest.mark.parametrize("what", ["torque", "velocity", "mass", "friction"])
def test_a_recording_of_another_plant_is_found(what: str) -> None:
    """The model alone is right then; the recorded states do not follow it."""
    subject = Subject.of(loop_of("differential", duration=DURATION).run())
    robot = robot_of_kind("differential")
    other = {
        "torque": lambda: more_torque(subject),
        "velocity": lambda: changed(subject, "nu", 1.001),
        "mass": lambda: replace(subject, robot=robot.with_masses(1.01)),
        "friction": lambda: replace(subject, robot=robot.with_friction(robot.viscous + 0.1)),
    }[what]()
    found = balance(other)
    assert found.steps > 10 * TOLERANCE and not found.holds


@pytest.mark.parametrize("integrator", ["semi_implicit_euler", "implicit_friction", "stick"])
def test_what_an_integrator_of_first_order_misses_is_told_apart(integrator: str) -> None:
    loop = loop_of("differential", duration=DURATION)
    timing = Timing(DURATION, PERIOD, PERIOD / 2, integrator=integrator)  # type: ignore[arg-type]
    found = balance(Subject.of(replace(loop, timing=timing).run()))
    assert found.holds and found.steps < 0.1 * TOLERANCE < TOLERANCE < found.recorded


def test_chapter_4_holds_between_its_recorded_states() -> None:
    """The thesis's robot has no dry friction: RK4 is exact enough for the equality itself."""
    experiment = load_experiment("chapter4", [f"time.duration={DURATION}"])
    robot = experiment.load_robot()
    found = balance(Subject.of(experiment.loop(robot, experiment.controller("two_layer", robot=robot)).run()))
    assert found.holds and found.recorded < 0.1 * TOLERANCE


def test_the_plants_steps_converge_to_it() -> None:
    """Half the plant's step, a 16th of the error between the recorded states: the plant is of fourth order."""
    smooth, errors = (
        replace(robot_of_kind("differential"), coulomb=np.zeros(robot_of_kind("differential").dimensions.full)),
        [],
    )
    for steps in (1, 2):
        loop = loop_of("differential", robot=smooth, period=0.02, duration=0.1)
        loop = replace(loop, timing=Timing(0.1, 0.02, 0.02 / steps))
        found = balance(Subject.of(loop.run()))
        errors.append(np.abs(found.increment - found.work).max())
        assert found.identity < TOLERANCE
    assert 8 < errors[0] / errors[1] < 32


def test_few_periods_are_spread_evenly() -> None:
    assert sorted(evenly(11)) == list(range(11)) and evenly(1) == [0]
    for count in (4, 16, 64):
        assert np.diff(sorted(evenly(1024)[:count])).max() <= 2 * 1024 / count
    subject = Subject.of(loop_of("fixed", duration=DURATION).run())
    few = balance(subject, budget=5 * 20)
    assert 1 < len(few.time) < few.periods and isinstance(few, Balance) and few.holds


def test_no_equality_on_the_contact_plant() -> None:
    subject = Subject.of(loop_of("differential", duration=DURATION).run())
    subject.recording.meta["plant"] = "contact"
    with pytest.raises(RecordingError, match="contact plant"):
        balance(subject)


def test_the_reference_between_samples_is_the_reference() -> None:
    """Half way between two samples it is within a millionth of the analytic one, and its derivatives are its own."""
    loop = loop_of("differential", period=0.01, duration=0.2)
    trajectory, layout, h = loop.trajectory, Layout.of(loop.robot.dimensions), 0.01
    rows, row = np.zeros((20, layout.width)), layout.new_row()
    where = slice(layout.where("pose_ref").start, layout.where("qddot_ref").stop)
    rows[:, where] = trajectory.table(np.arange(20) * h, layout)
    between, exact = Between(rows, layout, h), trajectory.table(np.arange(20) * h + 0.3 * h, layout)
    step = 1e-5
    for k in range(19):
        between.write(k, 0.3 * h, row)
        for name in ("velocity_ref", "q_ref", "qdot_ref"):
            at = layout.where(name)
            np.testing.assert_allclose(row[at], exact[k, at.start - where.start : at.stop - where.start], atol=1e-6)
        for coefficients in (between.base[:, k], between.arm[:, k]):
            _, rate, second = polynomial(coefficients, 0.3 * h)
            ahead, behind = (polynomial(coefficients, 0.3 * h + d) for d in (step, -step))
            np.testing.assert_allclose(rate, (ahead[0] - behind[0]) / (2 * step), atol=1e-6)
            np.testing.assert_allclose(second, (ahead[1] - behind[1]) / (2 * step), atol=1e-5)


def test_a_straight_line_far_away_is_judged_by_its_rounding() -> None:
    """At 1 km the pose error is known to 1e-13 m only; the scale of an error says so, and the equality holds."""
    loop = loop_of("differential", duration=0.02)
    far = Trajectory(Line(1.0, (1000.0, -700.0, 0.3)), loop.trajectory.arm)
    assert balance(Subject.of(replace(loop, trajectory=far).run())).holds


# -- with motors, pushes and a payload --


def rigged(integrator: str = "rk4", steps: int = 1, **more: object) -> Subject:
    loop = loop_of("fixed", **more)
    timing = Timing(DURATION, PERIOD, PERIOD / steps, integrator=integrator)  # type: ignore[arg-type]
    return Subject.of(replace(loop, timing=timing).run())


def test_external_forces_and_motors_are_part_of_it() -> None:
    """D is the recorded push, tau what the motors gave: lag, limit, a sine of force."""
    push = Push(on="joint_0", force=2.0, shape="sine", frequency=20.0)
    actuator = Actuator(lag=0.003, torque_gain=0.9)
    subject = rigged(disturbances=(push,), actuator=actuator)
    found = balance(subject)
    assert found.holds and found.steps < 0.1 * TOLERANCE and not subject.hardware.varies
    assert (
        np.abs(subject.hardware.push).max() > 1
        and np.abs(subject.hardware.torque - subject.signal("torque")).max() > 0.1
    )
    for name in ("push", "torque"):
        broken = rigged(disturbances=(push,), actuator=actuator)
        given = {"push": 0 * broken.hardware.push, "torque": broken.signal("torque")}[name]
        object.__setattr__(broken.hardware, name, given)
        assert not balance(broken).holds


def test_what_varies_within_a_period_is_not_made_again() -> None:
    subject = rigged(steps=2, actuator=Actuator(lag=0.003))
    found = balance(subject)
    assert subject.hardware.varies and np.isnan(found.steps) and found.holds and found.identity < TOLERANCE
    constant = rigged(steps=2, disturbances=(Push(on="joint_0", force=2.0, start=5 * PERIOD, end=9 * PERIOD),))
    assert not constant.hardware.varies and balance(constant).steps < 0.1 * TOLERANCE
    assert rigged(steps=2, disturbances=(Push(on="joint_0", force=2.0, start=5.5 * PERIOD),)).hardware.varies


def test_a_payload_changes_the_dynamics_where_it_is_picked_up() -> None:
    load = Payload(mass=1.0, start=10 * PERIOD, at=(0.0, 0.0, 0.1))
    subject = rigged(disturbances=(load,))
    found = balance(subject)
    assert found.holds and found.steps < 0.1 * TOLERANCE
    before, after = (subject.dynamics(t).mass_matrix(subject.robot.neutral_position()) for t in (0.0, 0.05))
    assert np.abs(after - before).max() > 1e-3
    object.__setattr__(subject.hardware, "pick", np.inf)
    assert not balance(subject).holds


def test_a_blocked_joint_has_no_equality() -> None:
    subject = rigged("stick", disturbances=(BlockedJoint(joint="joint_1", start=5 * PERIOD),))
    with pytest.raises(RecordingError, match="no equality"):
        balance(subject)
