"""What else a certificate must count with: gains that differ, a supervisor, a reference that drifts or jumps."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from certified import DIAGONAL, PERIOD, kinematic, learner_loop, loop_of
from hypothesis import given, settings
from hypothesis import strategies as st
from proofs import SLOW
from robots import mobile_arm

from mmnn_pin import PD, Feedback, Hold, Line, Timing, Trajectory, load
from mmnn_pin.actuator.settings import Actuator
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.latency import Latency
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.reference import BaseTable
from mmnn_pin.reference.path import BasePath, BaseSamples
from mmnn_pin.safety import Safety
from mmnn_pin.sensing import Sensor
from mmnn_pin.torque.classical import PDGravity
from research.proof.boxes import Box, Boxes
from research.proof.certificate import Certificate, certify
from research.proof.certified_loop import CertifiedLoop, certified_loop, drift, jump, refusal
from research.proof.certified_run import compare, sizes_of
from research.proof.motion_bound import Gains, motion_bound, stale
from research.proof.text import side

compiled_only = pytest.mark.skipif(SLOW, reason="thousands of uncompiled steps")
BRIEF = PERIOD / 4  # [s]
STILL = Trajectory(Line(speed=0.3), (Hold(0.0), Hold(0.8)))


def pd(bandwidth: float = 100.0) -> PD:
    gain = tuple((bandwidth * DIAGONAL).tolist())
    return PD(Feedback(gain[:2], gain[2:]))


def pd_run(duration: float = 0.3, start: Start | None = None, **more: object) -> Subject:
    """PD along a line, the robot without friction."""
    options = {"controller": pd(), "robot": load("platform_arm"), "trajectory": STILL} | more
    return Subject.of(loop_of(start or Start(moving=True), duration, **options).run())


# -- gains of the joints that differ ---------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(st.floats(0.3, 30), st.floats(0.3, 30), st.integers(0, 2**32 - 1))
def test_arm_errors_shrink_in_their_metric_whatever_the_gains_are(k1: float, k2: float, seed: int) -> None:
    """Along edot = -K e; in the metric of the inertia they need not, and nothing is held there."""
    loop = learner_loop(K=(k1, k2))
    e, N = np.random.default_rng(seed).standard_normal(2), loop.metric.N
    assert 0 < loop.arm_decay <= min(k1, k2) * (1 + 1e-9)
    assert -(e @ N @ (loop.K * e)) <= -loop.arm_decay * (e @ N @ e) * (1 - 1e-9)
    coupled = learner_loop(K=3.0).metric
    if coupled.decay(loop.K) <= 0:
        box = Box(0.02, 0.005, 0.002)
        loop = learner_loop(K=(k1, k2))
        loop.__dict__["metric"] = coupled  # what is cached
        assert Boxes(loop, box).arm_stands(box) == np.inf


def test_the_metric_of_the_inertia_is_left_where_gains_differ_much() -> None:
    """Its size grows from a place on the face of a small box, at first, that was taken for held."""
    loop = learner_loop(K=(1.0, 12.0))
    N = learner_loop(K=3.0).metric.N
    assert loop.metric.N[0, 1] == 0 and N[0, 1] != 0
    values, vectors = np.linalg.eigh(N * loop.K + (N * loop.K).T)
    assert values[0] < 0 and vectors[:, 0] @ N @ (loop.K * vectors[:, 0]) < 0


# -- gravity that the controller adds ----------------------------------------------------------------------------------


@cache
def weighed(factor: float = 1.0) -> Subject:
    """A Subject whose controller adds the gravity of a robot with masses of a factor."""
    robot, period = mobile_arm(2), 2e-4
    inertia = 1 / np.diag(np.linalg.inv(Dynamics(robot).mass_matrix(robot.neutral_position())))
    regressor = Regressor.of(robot)
    gain = Feedback(tuple((100 * inertia[:2]).tolist()), tuple((100 * inertia[2:]).tolist()))
    control = PDGravity(feedback=gain, motion=regressor, theta=factor * parameters(robot))
    path = Trajectory(Line(speed=0.3), (Hold(0.1), Hold(0.2)))
    timing = Timing(0.02, period, period)
    return pd_run(0.02, controller=control, robot=robot, trajectory=path, timing=timing)


@compiled_only
def test_gravity_that_the_controller_adds_counts_by_what_changes_within_the_hold() -> None:
    assert Dynamics(weighed().robot).feels_gravity
    loop = certified_loop(weighed())
    assert loop.weighs and refusal(weighed()) == ""
    assert "nor PD with the gravity of the robot" in refusal(weighed(1.1))
    box = Box(0.02, 0.01, 1e-3)
    with_it, without = (Boxes(one, box).faces(box).motion.level for one in (loop, replace(loop, weighs=False)))
    assert with_it < 0.1 * without
    rng, cover = np.random.default_rng(0), loop.cover(box.arm)
    dynamics, position = Dynamics(loop.robot), loop.robot.neutral_position()
    age, most = 2e-4, cover.old_gravity(np.full(4, 0.1), box.energy, 2e-4)
    assert np.isfinite(most).all() and np.isinf(cover.old_gravity(np.full(4, 100.0), box.energy, 2e-4)).all()
    speed = np.abs(cover.nu) + cover.nu_off + 0.1 + np.sqrt(2 * box.energy * cover.lightest)
    for _ in range(100):
        k = rng.integers(len(most))
        half = cover.postures.half[k] - cover.beyond
        q, terms = cover.postures.q[k] + half * rng.uniform(-1, 1, 2), []
        for at in (q, q - age * speed[k, 2:] * rng.choice((-1, 1), 2)):
            position[loop.robot.arm_index] = at
            terms.append(dynamics.gravity(loop.robot.follow(position)))
        assert np.linalg.norm(cover.L_inv[k] @ (terms[0] - terms[1])) <= most[k] * (1 + 1e-9)


# -- the hold, and where nothing drives ------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [0.006, 0.008])
def test_a_period_that_takes_all_of_the_feedback_holds_nothing_however_strong_the_friction(period: float) -> None:
    robot = load("platform_arm").with_friction(300.0 * DIAGONAL)
    loop = replace(learner_loop(), robot=robot, learner=None, gain=20.0 * DIAGONAL, period=period)
    box = Box(0.08, 0.4, 1.0)
    boxes = Boxes(loop, box)
    found = motion_bound(boxes.cover(box), boxes.drive(box), box.energy, boxes.gains)
    assert period * found.fastest > 0.5 and found.margin > 0 and found.level == np.inf
    brief = motion_bound(boxes.cover(box), boxes.drive(box), box.energy, replace(boxes.gains, period=1e-4))
    assert np.isfinite(brief.level)


def test_a_loop_that_nothing_drives_ends_within_a_millionth_of_its_region() -> None:
    loop = certified_loop(pd_run(0.01))
    found = certify(loop)
    assert found.holds and len(found.faces) < 150
    assert found.bound.box.energy < 1e-10 * found.region.box.energy
    assert certify(loop, found.region.box).holds
    assert certify(loop, found.bound.box).bound.box.energy <= found.bound.box.energy  # it divided by an energy of 0


def test_what_has_no_bound_is_told_with_its_sign() -> None:
    assert [side(value) for value in (np.inf, -np.inf, np.nan, -2.0)] == ["infinity", "-infinity", "no number", "-2.00"]


# -- a supervisor ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("safety", "name"),
    [
        (Safety(position_error=0.03), "position"),
        (Safety(heading_error=0.03), "heading"),
        (Safety(joint_error=0.05), "joint error"),
        (Safety(speed=0.33), "speed"),
        (Safety(joint_speed=0.5), "speed"),
        (Safety(torque=8.0), "torque"),
    ],
)
def test_a_region_in_which_a_supervisor_may_step_in_is_not_invariant(safety: Safety, name: str) -> None:
    subject = pd_run(0.01, safety=safety)
    assert refusal(subject) == ""
    loop = certified_loop(subject)
    free = replace(loop, supervisor=None)
    box = certify(free).region.box
    faces = Boxes(loop, box).faces(box)
    passed = [limit.name for limit in faces.limits if not limit.value < limit.limit]
    assert Boxes(free, box).faces(box).invariant and not faces.invariant and passed == [f"supervisor, {name}"]
    smaller = certify(loop)
    assert smaller.holds and all(condition.holds for condition in smaller.conditions)
    assert smaller.region.box.energy < box.energy or smaller.region.box.pose < box.pose


def test_what_is_reached_of_a_limit_is_not_less_than_runs_reach() -> None:
    """Largest motor torque, speed and errors of a run in the region beside what the certificate has for them."""
    safety = Safety(torque=1e3, speed=10.0, yaw_rate=10.0, joint_speed=50.0, position_error=1.0, heading_error=1.0)
    loop = certified_loop(pd_run(0.01, safety=safety))
    found = certify(loop)
    size = 0.15 * found.region.box.pose
    subject = pd_run(0.3, Start((-size, size, 0.0), moving=True), safety=safety)
    assert sizes_of(subject, loop).inside(found.region.box).all()
    limits = {limit.name.split(", ")[1]: limit.value for limit in found.region.limits}
    assert np.abs(subject.recording["motor_torque"]).max() <= limits["torque"]
    assert np.linalg.norm(subject.signal("pose_error")[:, :2], axis=1).max() <= limits["position"]
    assert np.abs(subject.signal("pose_error")[:, 2]).max() <= limits["heading"]


def test_a_run_that_its_supervisor_stopped_has_no_certificate() -> None:
    subject = pd_run(0.01, Start((-0.05, 0.0, 0.0), moving=True), safety=Safety(position_error=0.03))
    assert refusal(subject) == "its supervisor stopped it"
    clipped = pd_run(0.05, Start((-0.05, 0.0, 0.0)), safety=Safety(torque=1.0))
    assert refusal(clipped) == "its supervisor stepped in"


# -- late commands, noise, limits of torque --------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(st.floats(0.01, 0.6), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_no_signs_take_a_late_sample_further_away_than_its_bound(held: float, late: int, seed: int) -> None:
    """Two velocities in the norm of k, pushed with random signs; |s| reached within the windows is the box's."""
    rng, h = np.random.default_rng(seed), 1e-3
    gains = Gains(*(np.ones(2) for _ in range(3)), np.zeros(0), np.zeros(2), h, late * h)
    root = rng.standard_normal((2, 2))
    rate = root @ root.T
    rate *= held / gains.oldest / np.linalg.eigvalsh(rate)[-1]  # of M^-1 k
    mu, pushed, fine = float(np.linalg.eigvalsh(rate)[-1]), float(rng.uniform(0, 100.0)), 10
    s = [rng.standard_normal(2)]
    first, push = (late + 1) * 4, np.ones(2)
    for j in range(first + 40):
        sample = s[max(j - late, 0) * fine]
        push = rng.standard_normal(2) if rng.random() < 0.2 else push
        for _ in range(fine):
            s.append(s[-1] + h / fine * (-rate @ sample + pushed * push / np.linalg.norm(push)))
    sizes = np.linalg.norm(s, axis=1)
    for k in range(first * fine, len(s) - 1):
        box = sizes[max(k - 6 * (late + 1) * fine, 0) : k + 1].max() ** 2 / (2 * mu)
        away = np.linalg.norm(s[k + 1] - s[max(k // fine - late, 0) * fine])
        for grip, rest in stale(gains, mu, pushed, box * (1 + 1e-9)):
            assert away <= grip * sizes[k + 1] + rest + 1e-9


def real(start: Start | None = None, duration: float = 0.01) -> Subject:
    """PD at 20 kHz whose commands are a sample late, velocities noisy and motors limited."""
    hardware = {"sensor": Sensor(velocity_noise=5e-4), "actuator": Actuator(torque_limit=200.0)}
    timing = Timing(duration, BRIEF, BRIEF)
    return pd_run(duration, start, timing=timing, latency=Latency(command=BRIEF), **hardware)


@compiled_only
def test_late_commands_noise_and_limits_are_read_and_certified_and_runs_stay() -> None:
    subject = real()
    loop = certified_loop(subject)
    assert loop.late == pytest.approx(BRIEF) and (loop.motors == 200.0).all()
    np.testing.assert_allclose(loop.noise, 4 * 5e-4)
    found = certify(loop)
    names = {condition.name for condition in found.conditions if condition.holds}
    assert found.holds and {"period, delay", "motors, torque"} <= names
    exact = certify(replace(loop, late=0.0, noise=0 * loop.noise)).bound.box
    assert exact.energy < 0.1 * found.bound.box.energy  # what noise costs
    size = 0.15 * found.region.box.pose
    for angle in (0.0, 2.0, 4.0):
        place = (size * np.cos(angle), size * np.sin(angle), 0.0)
        run = real(Start(place, moving=True), 0.5)
        sizes = sizes_of(run, loop)
        assert sizes.inside(found.region.box).all()
        assert np.abs(run.recording["motor_torque"]).max() <= 200.0


def test_what_fails_of_late_commands_and_limits_is_named() -> None:
    loop = certified_loop(real())
    box = certify(loop).region.box
    for more, name in (({"late": 60 * BRIEF}, "period, delay"), ({"motors": 0.1 * loop.motors}, "motors, torque")):
        boxes = Boxes(replace(loop, **more), box)
        faces = boxes.faces(box)
        failed = [condition.name for condition in Certificate(boxes, [faces]).conditions if not condition.holds]
        assert not faces.invariant and name in failed
    assert not certify(replace(loop, period=PERIOD, late=PERIOD)).holds
    noisy = replace(loop, noise=100 * loop.noise)
    assert not Boxes(noisy, box).faces(box).invariant


@pytest.mark.parametrize(
    ("hardware", "why"),
    [
        ({"sensor": Sensor(pose_noise=(1e-4, 0.0, 0.0))}, "true pose"),
        ({"latency": Latency(sensing=PERIOD)}, "measurements are late"),
        ({"actuator": Actuator(lag=0.01)}, "by more than a limit of torque"),
    ],
)
def test_what_is_not_covered_of_a_real_loop_is_named(hardware: dict, why: str) -> None:
    assert why in refusal(pd_run(0.01, **hardware))


# -- a reference that is not quite one motion ------------------------------------------------------------------------


@cache
def drifting(sideways: bool) -> tuple[Subject, CertifiedLoop, Certificate]:
    """A table whose poses move 1.9 % beside its velocities, which `check_followable` lets pass."""
    t = np.arange(0, 8.01, 0.01)
    along, aside, speed = (0.3, 0.3 * 0.019, 0.3) if sideways else (0.3, 0.0, 0.3 * 0.981)
    pose, velocity = np.stack([along * t, aside * t, 0 * t], 1), np.stack([speed + 0 * t, 0 * t], 1)
    timing = Timing(8.0, 2e-4, 2e-4)
    subject = pd_run(trajectory=Trajectory(BaseTable(t, pose, velocity), STILL.arm), timing=timing)
    loop = certified_loop(subject)
    return subject, loop, certify(loop)


@pytest.mark.parametrize("sideways", [False, True])
def test_a_reference_that_drifts_is_counted_with(sideways: bool) -> None:
    subject, loop, found = drifting(sideways)
    sizes = sizes_of(subject, loop)
    assert loop.drift[0] == pytest.approx(1.5 * 0.3 * 0.019, rel=1e-3) and loop.drift[1] < 1e-9  # of Hermite cubics
    run = compare(subject, found, sizes)
    assert found.holds and run.stays and run.settles < 8.0
    assert sizes.pose[-1] > 0.15 * found.bound.box.pose  # not far below
    without = certify(replace(loop, drift=(0.0, 0.0)))
    assert without.holds and not sizes.inside(without.bound.box)[-1]  # it never gets there


def test_the_drift_of_paths_of_this_package_is_none() -> None:
    rng = np.random.default_rng(0)
    from mmnn_pin import Circle, Eight
    from mmnn_pin.reference import Waypoints

    for path in (
        Circle(1.0, 0.5),
        Eight(3.0, 1.5, 12.0),
        Waypoints(((0, 0), (3, 0), (3, 3)), 0.5, 0.4),
        Line(0.3, (100.0, 50.0, 1.0)),
    ):
        h = float(rng.uniform(5e-4, 2e-3))
        samples = path.sample(np.arange(2000) * h)
        assert max(drift(samples.pose, samples.velocity, samples.acceleration, h)) < 2e-7
        assert np.isnan(jump(samples.t, samples.velocity, samples.acceleration, h))


class Jumps(BasePath):
    """Straight ahead, with 1 mm/s more from 0.1 s on."""

    def sample(self, t: object) -> BaseSamples:
        """See `BasePath.sample`."""
        t = np.asarray(t, float)
        v = np.where(t < 0.1, 0.3, 0.301)
        x = 0.3 * t + 0.001 * np.maximum(t - 0.1, 0)
        zero = np.zeros_like(t)
        return BaseSamples(t, np.stack([x, zero, zero], 1), np.stack([v, zero], 1), np.stack([zero, zero], 1))


def test_a_reference_that_jumps_has_no_certificate() -> None:
    subject = pd_run(0.2, trajectory=Trajectory(Jumps(), STILL.arm))
    assert refusal(subject).startswith("velocity_ref jumps at t = 0.099")
    assert refusal(pd_run(0.01, kinematic=kinematic(2.0))) == ""
