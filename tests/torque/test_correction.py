"""The correction beside a linear learner: its features, its weights in closed form, that it is passive and bounded."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import SHORT, assert_engines_agree, assert_it_resumes, made
from scipy.linalg import null_space

from mmnn_pin import Feedback, Loop, load, load_experiment
from mmnn_pin.errors import ConfigError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.lab.experiments.controllers import machine_of
from mmnn_pin.lab.psi.learner import recorded_learner
from mmnn_pin.model.base import KINDS
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.signals import Array, Layout
from mmnn_pin.torque.controller import Context
from mmnn_pin.torque.correction import (
    SHARE,
    SLOWER,
    Corrected,
    Correction,
    correct,
    desired,
    find_cut,
    follow_error,
    new_correction,
)
from mmnn_pin.torque.kalman import Kalman
from mmnn_pin.torque.kalman_settings import KalmanFrictionSettings
from mmnn_pin.torque.linear import Linear

ROBOT = load("platform_arm").with_friction((30.0, 5.0, 0.5, 0.5)).with_joint_friction(coulomb=0.5)
REGRESSOR, TRUE, LAYOUT, K = Regressor.of(ROBOT), parameters(ROBOT), Layout.of(ROBOT.dimensions), Feedback(500.0, 30.0)
GAINS, AT, H, ROOM = K.vector(LAYOUT), LAYOUT.offsets, 0.002, 5
seeds, delays = st.integers(0, 2**32 - 1), st.just(0.0) | st.floats(1e-4, 0.03)


@cache
def typical() -> Array:
    """Features of random motion of the learner of the thesis's robot."""
    return Kalman(KalmanFrictionSettings(), machine_of(ROBOT), K, REGRESSOR).typical()


def new(
    correction: float = 20.0, leakage: float = 20.0, part: float = 0.5, weights: Array | None = None
) -> tuple[Correction, Corrected]:
    """A correction of the thesis's robot, and what it remembers."""
    c = new_correction(Context(LAYOUT, H, 1, pose_weights=weights), GAINS, typical(), correction, leakage, part)
    return c, Corrected(np.zeros(len(c.rate)), np.zeros(1), *np.zeros((2, len(GAINS))))


def test_its_numbers_are_those_of_the_settings() -> None:
    """On the motion that it is measured by, it answers s with `correction` times K, on average over the velocities."""
    own = KalmanFrictionSettings(correction=3.0, leakage=2.0, desired=0.25)
    c = Kalman(own, machine_of(ROBOT), K, REGRESSOR).correction(Context(LAYOUT, H, 1))
    assert c is not None and c.blend == 0.25 and c.top == 3.0 and c.keep == pytest.approx(np.exp(-2.0 * H))
    answers = np.einsum("nij,j,nij->ni", typical(), c.rate, typical()).mean(axis=0) / GAINS
    assert answers.mean() == pytest.approx(3.0, rel=1e-9)


def motion(rng: np.random.Generator, time: float = 0.0, size: float = 1.0) -> Array:
    """A row of signals with a random reference, measurement and error."""
    row = LAYOUT.new_row()
    row[:] = size * rng.normal(size=row.size)
    row[LAYOUT.where("time")] = time
    return row


def of(row: Array, *names: str) -> Array:
    """Signals of a row, side by side."""
    return np.concatenate([row[LAYOUT.where(name)] for name in names])


def looked(row: Array, c: Correction) -> Array:
    """The learner's features of a row, moved towards those of the reference; c.F is that of the row."""
    Phi = np.zeros((len(GAINS), len(c.rate)))
    position = REGRESSOR.massless.offset + REGRESSOR.massless.arm @ of(row, "q")
    measured = REGRESSOR.matrix(position, of(row, "velocity", "qdot"), of(row, "nu_ref"), of(row, "nudot_ref"))
    Phi[:, : REGRESSOR.size] = measured
    Phi[:, REGRESSOR.size :] = np.repeat(np.eye(len(GAINS)), ROOM, axis=1)
    desired(row, AT, c, REGRESSOR.workspace(), GAINS, Phi)
    return Phi


@given(seed=seeds)
def test_with_the_true_parameters_they_say_what_pinocchio_needs_for_the_reference(seed: int) -> None:
    """F up to its factor; with `desired = 1` the learner's own features are those, with 0 they stay."""
    row = motion(np.random.default_rng(seed))
    nu, nudot = of(row, "velocity_ref", "qdot_ref"), of(row, "acceleration_ref", "qddot_ref")
    dynamics = Dynamics(ROBOT)
    position = REGRESSOR.massless.offset + REGRESSOR.massless.arm @ of(row, "q_ref")
    psi = dynamics.psi(position, nu, nu, nudot)
    for part in (0.0, 1.0):
        c, _ = new(part=part)
        Phi = looked(row, c)
        if part:
            assert Phi[:, : TRUE.size] @ TRUE == pytest.approx(psi, rel=1e-9, abs=1e-9)
            scale = [np.linalg.lstsq(Phi[[i]].T, c.F[i], rcond=None)[0] for i in range(len(GAINS))]
            assert pytest.approx(scale * Phi, rel=1e-9, abs=1e-9) == c.F
            assert np.einsum("ij,j,ij->i", c.F, c.rate, c.F) == pytest.approx(c.top * GAINS, rel=1e-9)
        else:
            still = REGRESSOR.matrix(
                REGRESSOR.massless.offset + REGRESSOR.massless.arm @ of(row, "q"),
                *(of(row, "velocity", "qdot"), of(row, "nu_ref"), of(row, "nudot_ref")),
            )
            assert (Phi[:, : TRUE.size] == still).all()


def test_the_answer_to_an_error_that_stays_is_an_integral_that_forgets() -> None:
    """`w = Gamma F' s (1 - exp(-leakage t)) / leakage` for F and s that stand still, to first order in the period."""
    c, o = new(correction=3.0, leakage=4.0)
    rng = np.random.default_rng(3)
    row = motion(rng, size=0.3)
    for n in range(400):
        row[LAYOUT.where("time")] = n * H
        looked(row, c)
        follow_error(row, AT, c, GAINS, False, o)
    expected = c.rate * (c.F.T @ of(row, "z", "r")) * (1.0 - np.exp(-4.0 * 400 * H)) / 4.0
    assert o.w == pytest.approx(expected, rel=2 * 4.0 * H)
    before = of(row, "psi_hat")
    correct(row, AT, c, o)
    assert of(row, "psi_hat") - before == pytest.approx(c.F @ o.w, rel=1e-9)


@given(
    seed=seeds, size=st.sampled_from([1e-3, 1.0, 1e3]), correction=st.floats(0.1, 300.0), leakage=st.floats(0.1, 50.0)
)
def test_it_is_passive_and_bounded_by_its_gain_whatever_comes(
    seed: int, size: float, correction: float, leakage: float
) -> None:
    """Its energy grows by the work of s on Psi_w, up to the share of the feedback that a sample may answer with."""
    c, o = new(correction=correction, leakage=leakage)
    rng, live, largest = np.random.default_rng(seed), c.rate > 0.0, 0.0
    for n in range(12):
        row = motion(rng, n * H, size)
        looked(row, c)
        s, psi, before = of(row, "z", "r"), c.F @ o.w, (o.w[live] ** 2 / c.rate[live]).sum() / 2.0
        assert (
            np.sqrt((psi**2 / GAINS).sum()) <= len(GAINS) * correction / leakage * largest * (1.0 + leakage * H) + 1e-12
        )
        largest = max(largest, float(np.sqrt((GAINS * s**2).sum())))
        follow_error(row, AT, c, GAINS, False, o)
        after = (o.w[live] ** 2 / c.rate[live]).sum() / 2.0
        fed = 0.5 * H * SHARE * (GAINS * s**2).sum()
        assert after <= before + max(0.0, H * s @ psi) + fed + 1e-9 * (before + fed)
    assert (o.w[~live] == 0.0).all()


def told(period: float, way: float, unseen: float, lag: float) -> Linear:
    """The numbers of the learner with its defaults where these delays are known."""
    context = Context(LAYOUT, period, 1, lag=np.full(len(GAINS), lag), way=way, unseen=unseen)
    learner: Linear = Kalman(KalmanFrictionSettings(), machine_of(ROBOT), K, REGRESSOR).law(context).learner
    return learner


@settings(max_examples=25)
@given(period=st.floats(5e-4, 0.01), way=delays, unseen=delays, lag=delays)
def test_alone_it_bears_twice_the_delay_that_is_known(period: float, way: float, unseen: float, lag: float) -> None:
    """An integral whose answers show twice the known delays later: what it remembers dies out without a feedback."""
    correction = told(period, way, unseen, lag).correction
    assert correction is not None
    late = math.ceil(2.0 * (way + unseen + lag) / period)
    integral = np.eye(late + 1, k=-1)
    integral[0, 0] += 1.0
    integral[0, late] -= correction.top * period
    assert np.abs(np.linalg.eigvals(integral)).max() < 1.0
    assert correction.top * 2.0 * (period + way + unseen + lag) == pytest.approx(1.0)


@settings(max_examples=25)
@given(unseen=st.floats(0.0, 0.1))
def test_its_low_pass_lasts_longer_than_velocities_repeat_what_it_believes(unseen: float) -> None:
    pole = -math.log(told(H, 0.0, unseen, 0.0).filter.hold) / H
    assert pole == pytest.approx(min(7.0, 0.04 / unseen) if unseen > 0.0 else 7.0)


@pytest.mark.parametrize("base", ["differential_drive", "holonomic"])
def test_errors_of_velocities_count_as_the_energy_of_the_pose_grows(base: str) -> None:
    """Second differences of that energy along what each velocity drives."""
    gains, kind, tiny = Kinematic(ky=9.0), KINDS[base], 1e-3
    nb = len(kind.twist_names)
    layout, still = Layout(nb, 0, nb + 3, nb, base), np.zeros((nb, nb))
    energy = kind.pose_energy(tiny * np.eye(3)[kind.columns], still, still, gains.base_gains(layout))
    assert energy is not None
    assert gains.pose_weights(layout) == pytest.approx(2.0 * energy.value / tiny**2, rel=1e-6)
    assert kind.sideways or Kinematic(ky=0.0).pose_weights(layout) is None


@given(seed=seeds, size=st.sampled_from([1e-6, 1e-2, 1.0]))
def test_every_velocity_answers_alike_however_slow_the_reference_is(seed: int, size: float) -> None:
    c, _ = new(correction=3.0)
    looked(motion(np.random.default_rng(seed), size=size), c)
    assert np.diag(c.F @ np.diag(c.rate) @ c.F.T) == pytest.approx(3.0 * GAINS, rel=1e-9)


@pytest.mark.parametrize("ky", [None, 0.5, 64.0])
@given(seed=seeds, motor=st.integers(0, 3), part=st.sampled_from([1e-6, 1.0, 1e6]))
def test_against_a_motor_at_its_limit_nothing_is_learned(seed: int, motor: int, part: float, ky: float | None) -> None:
    """The error that counts is the nearest one, measured by A^-1, in which that motor's speed has none."""
    rng = np.random.default_rng(seed)
    row, weights = motion(rng, H, 0.1), None if ky is None else np.array([1.0, 1.0 / ky])
    s, column, metric = of(row, "z", "r"), ROBOT.E[:, motor], GAINS.copy()
    if weights is not None:
        metric[:2] = weights * (GAINS[:2] / weights).sum() / 2
        assert (GAINS / metric)[:2].mean() == pytest.approx(1.0)
    for sign in (1.0, -1.0):
        c, o = new(weights=weights)
        o.when[0], o.cut[:] = 0.0, sign * part * column * np.sign(column @ s)
        looked(row, c)
        follow_error(row, AT, c, GAINS, False, o)
        free = null_space(column[None] / np.sqrt(metric))  # of the errors times its root
        counted = (free @ free.T @ (np.sqrt(metric) * s)) / np.sqrt(metric) if sign > 0.0 else s
        step = c.rate * (c.F.T @ counted)
        assert o.w == pytest.approx(
            min(1.0, np.abs(o.w).max() / np.abs(H * step).max()) * H * step, rel=1e-6, abs=1e-12
        )
        assert sign < 0.0 or abs(column @ counted) < 1e-9
        assert (o.asked == of(row, "psi_hat")).all()
        row[LAYOUT.where("psi_hat")] -= 2.0
        find_cut(row, AT, o)
        assert o.cut == pytest.approx(2.0)
        row[LAYOUT.where("psi_hat")] += 2.0


@pytest.mark.parametrize(("changed", "rate"), [(False, 4.0), (True, 4.0 * SLOWER)])
def test_just_after_a_change_it_is_forgotten_more_slowly(changed: bool, rate: float) -> None:
    c, o = new(leakage=4.0)
    row = motion(np.random.default_rng(4))
    row[LAYOUT.where("z")], row[LAYOUT.where("r")], o.w[:] = 0.0, 0.0, 1.0
    for n in range(100):
        row[LAYOUT.where("time")] = n * H
        looked(row, c)
        follow_error(row, AT, c, GAINS, changed, o)
    assert o.w == pytest.approx(np.exp(-rate * 100 * H), rel=1e-9)


@pytest.mark.parametrize(("later", "counts"), [(0.0, True), (0.05, True), (-1.0, False), (3.0, False)])
def test_one_that_nobody_moves_any_more_does_not_count(later: float, counts: bool) -> None:
    c, o = new()
    rng = np.random.default_rng(1)
    row = motion(rng, 7.0)
    looked(row, c)
    follow_error(row, AT, c, GAINS, False, o)
    row[LAYOUT.where("time")] = 7.0 + later
    before = of(row, "psi_hat")
    correct(row, AT, c, o)
    assert (of(row, "psi_hat") != before).any() == counts
    if not counts:
        row[LAYOUT.where("z")], row[LAYOUT.where("r")] = 0.0, 0.0
        follow_error(row, AT, c, GAINS, False, o)
        assert (o.w == 0.0).all()


def test_a_sample_that_is_no_number_teaches_nothing() -> None:
    c, o = new()
    for value in (np.nan, np.inf, 1e300):
        row = motion(np.random.default_rng(2))
        looked(row, c)
        row[LAYOUT.where("z")] = value
        follow_error(row, AT, c, GAINS, False, o)
        assert (o.w == 0.0).all()


@pytest.mark.parametrize(("own", "key"), [({"desired": 1.1}, "desired"), ({"leakage": 0.0}, "leakage")])
def test_settings_that_cannot_be_are_refused(own: dict[str, Any], key: str) -> None:
    with pytest.raises(ConfigError) as refused:
        KalmanFrictionSettings(**own)
    assert refused.value.key == f"kalman.friction.{key}"


def test_without_one_nothing_is_left_of_it() -> None:
    learner = Kalman(KalmanFrictionSettings(correction=0.0), machine_of(ROBOT), K, REGRESSOR)
    assert learner.correction(Context(LAYOUT, H, 1)) is None


def loop(*said: str) -> Loop:
    """The closed loop of `kalman_friction` along an eight, with a torque that is sent as it is at the sample."""
    experiment = load_experiment("eight", ("time.duration=9.0", "windows=[[0.0,2.0],[5.0,9.0]]", "lead=false", *said))
    robot = experiment.load_robot()
    return experiment.loop(robot, experiment.controller("kalman_friction", robot=robot))


@pytest.mark.compiled
def test_it_takes_out_what_filtered_torque_does_not_say() -> None:
    """Half a period of delay: the learner's equations hold exactly, and the robot is late all the same."""
    error = {}
    for said in ("kalman.friction.correction=40", "kalman.friction.correction=0"):
        run = loop(said, "feedback={base=500,arm=30}").run()  # weak enough for the delay to show above the noise
        error[said] = np.sqrt((run["true_pose_error"][run["time"].ravel() > 5.0, :2] ** 2).mean())
    with_one, without = error.values()
    assert with_one < 0.7 * without


@pytest.mark.compiled
def test_it_helps_also_where_the_motors_give_all_they_can() -> None:
    """An eight that asks for more than the wheels' motors have; a correction that learns against them does harm."""
    eight = 'reference.base={type="eight",length=1.5,width=0.75,period=3.2,ramp=1.0}'
    error = {}
    for said in ("kalman.friction.correction=40", "kalman.friction.correction=0"):
        run = loop(eight, said).run()
        assert (run["motor_torque"][:, :2] >= 60.0 * (1.0 - 1e-9)).any(axis=0).all()
        error[said] = np.sqrt((run["true_pose_error"][run["time"].ravel() > 5.0, :2] ** 2).mean())
    with_one, without = error.values()
    assert with_one < without


@pytest.mark.compiled
def test_where_a_wheel_cannot_help_the_pose_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same eight with a missing torque shared as K says, and as errors of velocities count in the pose."""
    eight = 'reference.base={type="eight",length=1.5,width=0.75,period=3.2,ramp=1.0}'
    error = []
    for weights in (Kinematic.pose_weights, lambda self, layout: None):
        monkeypatch.setattr(Kinematic, "pose_weights", weights)
        run = loop(eight).run()
        error.append(np.sqrt((run["true_pose_error"][run["time"].ravel() > 5.0] ** 2).mean(axis=0)))
    assert (error[0][:2] < 0.8 * error[1][:2]).all() and error[0][2] < 1.1 * error[1][2]


@pytest.mark.compiled
def test_a_learner_built_again_from_its_recording_has_the_same_numbers() -> None:
    run = loop("latency={sensing=0.002,predict=true}", "kinematic.ky=25.0")
    learner = recorded_learner(run.run(), run.robot)
    assert learner is not None
    made, again = (law.learner for law in (run.controller.law(run.context()), learner.controller.law(learner.context)))
    assert made.filter.hold == again.filter.hold and made.correction.top == again.correction.top
    np.testing.assert_array_equal(made.correction.A, again.correction.A)


@pytest.mark.compiled
def test_engines_agree_and_a_resumed_run_goes_on() -> None:
    assert_engines_agree(made("kalman_friction"))
    assert_it_resumes(made("kalman_friction"), SHORT / 2)


@pytest.mark.compiled
def test_weights_held_fixed_are_those_of_the_filter_alone() -> None:
    """What follows the error of one motion is no knowledge of another."""
    learned = made("kalman_friction")
    controller = learned.controller
    state = controller.init(learned.context())
    state.values[:] = learned.run().final["controller_state"]
    state["when"] = 1e3
    still = replace(learned, controller=replace(controller, learning=False))
    run, moved = still.run(state=state.snapshot()), state.snapshot()
    moved["w"] = 0.0
    np.testing.assert_array_equal(run["torque"], still.run(state=moved)["torque"])
