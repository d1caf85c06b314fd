"""Learners on bases that steer: what they know of the angles, that they learn, and that all ways to run them agree."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest
from numba import config

from mmnn_pin import load, load_experiment
from mmnn_pin.errors import ConfigError, RobotError
from mmnn_pin.loop.batch import simulate_many
from mmnn_pin.loop.lead import catch_up, look_ahead
from mmnn_pin.model.base.rolling import new_maps, roll
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.regressor import Regressor, regress
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.signals import INDEX, Layout
from mmnn_pin.torque.entries import CONTROLLERS
from mmnn_pin.torque.law import Ahead, constant_gain
from mmnn_pin.torque.neural import MEASURED, SEEN, Inputs

ROBOTS = ("car_arm", "tricycle_arm", "loader_arm", "truck_trailer_arm", "swerve_arm", "casters_arm")
SHORT = 0.02 if config.DISABLE_JIT else 0.3
PLAIN = ["actuator.torque_limit=none", "torque_limits=false", "time.control_period=0.002", "time.plant_step=0.002"]
WHOLE = {name for name, entry in CONTROLLERS.items() if not entry.gain_of}
LEARNERS = sorted(WHOLE - {"computed_torque", "pd", "two_layer_random", "nominal"})


@cache
def robot(name):
    return load(name)


def loop(name, learner, *said, duration=SHORT):
    experiment = load_experiment("track", [f"robot={name}", *PLAIN, f"time.duration={duration}", *said])
    return experiment.loop(robot(name), experiment.controller(learner, robot=robot(name)))


def random_state(name, seed):
    """A position with its wheels along a path, and three random velocities."""
    rng, found = np.random.default_rng(seed), Regressor.of(robot(name))
    return found, found.random_position(rng), *rng.standard_normal((3, robot(name).dimensions.dof))


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("seed", range(3))
def test_regressor_times_parameters_is_psi(name, seed):
    regressor, position, nu, nu_ref, nudot_ref = random_state(name, seed)
    masses = robot(name).with_joint_friction(viscous=0.3, coulomb=0.2).with_friction(2.0)
    psi = Dynamics(masses).psi(position, nu, nu_ref, nudot_ref)
    ours = regressor.matrix(position, nu, nu_ref, nudot_ref) @ parameters(masses)
    np.testing.assert_allclose(ours, psi, atol=1e-11 * np.abs(psi).max())


@pytest.mark.parametrize("name", ROBOTS)
def test_rotors_of_wheels_and_steering_take_their_own_acceleration(name):
    """Column of a rotor: what turning it takes, `t (t nudot_ref + tdot nu_ref)` with its row t of T."""
    regressor, position, nu, nu_ref, nudot_ref = random_state(name, 1)
    found = robot(name)
    T, Tdot, Y = found.T_at(position), found.Tdot_at(position, nu), regressor.matrix(position, nu, nu_ref, nudot_ref)
    for joint in regressor.joints:
        row = found.full_velocity_names.index(joint)
        wanted = T[row] * (T[row] @ nudot_ref + Tdot[row] @ nu_ref)
        np.testing.assert_allclose(Y[:, regressor.labels.index(f"{joint}.rotor")], wanted, atol=1e-11)


@pytest.mark.parametrize("name", ROBOTS)
def test_regressor_along_a_motion_goes_on_from_sample_to_sample(name):
    """`along` has the angles of every row, and of a swerve drive the way u counted before."""
    regressor, position, nu, nu_ref, _ = random_state(name, 0)
    found, maps = robot(name), new_maps(robot(name).rolling, np.array(robot(name).template))
    rows, positions = [], [position]
    for _ in range(4):
        measured = found.neutral_position()
        measured[found.measured_index] = positions[-1][found.measured_index]
        rows.append((maps.n.copy(), measured))
        roll(found.rolling, measured, nu, maps)
        positions.append(measured + 0.05 * maps.T @ nu)
    positions = np.array(positions[:-1])
    many = [np.tile(each, (4, 1)) for each in (nu, nu_ref)]
    Y = regressor.along(positions[:, found.arm_index], *many, positions[:, found.shape_index])
    for one, (n, at) in zip(Y, rows, strict=True):
        work = regressor.workspace()
        work.maps.n[:] = n
        np.testing.assert_allclose(one, regressor_at(work, at, nu, nu_ref), atol=1e-9)


def regressor_at(work, position, nu, nudot):
    work.position[:], work.nu[:] = position, nu
    regress(work, nu, nudot)
    return work.Y


@pytest.mark.parametrize("name", ROBOTS)
def test_networks_see_the_angles_and_nothing_else_beside(name):
    layout = Layout.of(robot(name).dimensions)
    for inputs in (Inputs(), SEEN):
        rows, more = inputs.rows(layout), 2 * layout.shape
        shape = np.arange(*layout.where("shape").indices(layout.width)[:2])
        np.testing.assert_array_equal(rows[-more:], np.repeat(shape, 2))
        seen = [np.arange(*layout.where(s).indices(layout.width)[:2]) for s in inputs.signals]
        np.testing.assert_array_equal(rows[: -more - bool(inputs.bias)], np.concatenate(seen))
        assert set(inputs.signals) <= set(MEASURED)
        x = inputs.seen(np.linspace(0.1, 0.9, layout.width)[rows], layout)
        angles = np.linspace(0.1, 0.9, layout.width)[shape]
        np.testing.assert_allclose(x[-more:], np.column_stack((np.cos(angles), np.sin(angles))).ravel())


def test_constant_kinds_have_the_inputs_of_before():
    layout = Layout.of(load("platform_arm").dimensions)
    assert Inputs().numbers(layout).shape == (2, Inputs().rows(layout).size)


def test_a_network_learns_cosine_and_sine_of_the_angles():
    """The state's input of the last sample is that of its row."""
    made = loop("truck_trailer_arm", "two_layer", duration=2.0)
    run = made.run()
    state = made.controller.init(made.context())
    state.values[:] = run.final["controller_state"]
    angles = run["shape"][-1]
    assert np.abs(angles).max() > 1e-4
    trigonometric = np.column_stack((np.cos(angles), np.sin(angles))).ravel()
    np.testing.assert_allclose(state["x"][-trigonometric.size :], trigonometric, rtol=1e-15)


@pytest.mark.parametrize("learner", LEARNERS)
@pytest.mark.parametrize("name", ["car_arm", "truck_trailer_arm", "swerve_arm", "casters_arm"])
def test_engines_agree(name, learner):
    """Bit for bit, with Psi_hat leading."""
    made = loop(name, learner, "lead=true")
    runs = [replace(made, engine=engine).run() for engine in ("compiled", "ordinary")]
    assert runs[0].outcome.status == "completed"
    for signal in ("psi_hat", "torque", "e", "shape", "weight_norm"):
        np.testing.assert_array_equal(runs[0][signal], runs[1][signal])
    assert np.abs(runs[0]["psi_hat"]).max() > 0.0


@pytest.mark.parametrize("learner", ["two_layer", "kalman_regressor", "concurrent", "adaptive_composite"])
def test_a_batch_has_the_bits_of_one(learner):
    made = loop("car_arm", learner)
    for one in simulate_many([replace(made, engine="compiled")] * 2, keep=True, workers=2):
        np.testing.assert_array_equal(one.recording["torque"], made.run()["torque"])


@pytest.mark.parametrize("learner", ["kalman_friction", "concurrent"])
def test_runs_resume(learner):
    """A run that stops in the middle and goes on from its memory ends as one that does not, bit for bit."""
    whole = loop("truck_trailer_arm", learner)
    begin, half = whole.start.state(whole.robot, whole.table()[0]), round(SHORT / 2 / whole.timing.control_period)
    first = replace(whole, timing=msgspec.structs.replace(whole.timing, duration=SHORT / 2))
    straight, begun = whole.run(plant_state=begin), first.run(plant_state=begin)
    state = first.controller.init(first.context())
    state.values[:] = begun.final["controller_state"]
    there = begun.final["position"], begun.final["nu"]
    resumed = whole.run(state=state, plant_state=there, first=half)
    np.testing.assert_array_equal(resumed.final["controller_state"], straight.final["controller_state"])


def test_a_swerve_drive_does_not_resume():
    """Which way u counts is not in its state."""
    made = loop("swerve_arm", "two_layer")
    start = made.start.state(made.robot, made.table()[5])
    with pytest.raises(ConfigError, match="cannot go on"):
        made.run(plant_state=start, first=5)


@pytest.mark.skipif(config.DISABLE_JIT, reason="minutes without compiled code")
@pytest.mark.parametrize("name", ["car_arm", "swerve_arm"])
def test_learners_beat_the_feedback(name):
    """Psi_hat of those that know the motion is near Psi after two seconds, and all err less than PD."""
    runs = {each: loop(name, each, duration=2.0).run() for each in ("pd", "two_layer", "kalman_friction")}
    errors = {each: np.sqrt(np.mean(run["true_pose_error"][-500:, :2] ** 2)) for each, run in runs.items()}
    assert max(errors["two_layer"], errors["kalman_friction"]) < 0.3 * errors["pd"]
    run = runs["kalman_friction"]
    wrong = np.abs(run["psi_hat"] - run["psi"])[-500:].max(axis=0)
    assert (wrong < 0.2 * np.abs(run["psi"]).max()).all()


def test_memory_of_the_filter_has_the_angles():
    """Periods of a filter tell the mean of the angles, as of joints."""
    made = loop("car_arm", "kalman_regressor", duration=0.04)
    run, state = made.run(), made.controller.init(made.context())
    state.values[:] = run.final["controller_state"]
    np.testing.assert_array_equal(state["states"][0, -run["shape"].shape[1] :], run["shape"][-1])


@pytest.mark.parametrize("name", ["car_arm", "swerve_arm"])
def test_a_late_measurement_moves_as_was_asked(name):
    """Velocities and angles of some samples ago, brought up to now, are nearly those of now: the base did as asked."""
    made, late = loop(name, "computed_torque", duration=4.0), 10
    run, plan, k = made.run(), made.plan(), 1900
    layout, age = made.layout, late * made.timing.control_period
    row = layout.new_row()
    for signal in ("pose", "velocity", "q", "qdot", "shape"):
        row[layout.where(signal)] = run[signal][k - late]
    for signal in ("alpha", "alphadot"):
        row[layout.where(signal)] = run[signal][k - 1]
    roll(plan.steering.rolling, np.append(np.zeros(3), run["shape"][k - 1]), run["velocity"][k - 1], plan.steering.maps)
    catch_up(row, layout.offsets, plan.setpoints[k], plan.setpoints[k - late], age, plan.steering)
    for signal in ("pose", "velocity", "q", "qdot", "shape"):
        moved, left = run[signal][k] - run[signal][k - late], run[signal][k] - row[layout.where(signal)]
        assert np.abs(left).max() < 0.15 * np.abs(moved).max() + 1e-6, signal
    assert np.abs(run["shape"][k] - run["shape"][k - late]).max() > 1e-4


@pytest.mark.parametrize("name", ["car_arm", "swerve_arm"])
def test_the_row_ahead_is_that_of_later(name):
    """Signals moved ahead by as much as some samples are nearly those that the samples then have."""
    made, later = loop(name, "computed_torque", duration=4.0), 10
    run, plan, k = made.run(), made.plan(), 1900
    layout, row = made.layout, made.layout.new_row()
    for signal in list(INDEX)[INDEX["pose_ref"] : INDEX["psi"]]:
        row[layout.where(signal)] = run[signal][k]
    angles = np.append(np.zeros(3), run["shape"][k])
    roll(plan.steering.rolling, angles, run["velocity"][k], plan.steering.maps)
    h, p = made.timing.control_period, layout.dof
    ahead = Ahead(later * h, 0.0, h, np.ones(p), layout.new_row(), constant_gain(np.zeros(p)))
    look_ahead(row, layout.offsets, plan.setpoints[k - 1], ahead, plan.steering)
    for signal in ("pose_ref", "velocity_ref", "velocity", "alpha", "nu_ref", "shape", "q", "qdot"):
        then, now = run[signal][k + later], run[signal][k]
        left = then - ahead.row[layout.where(signal)]
        assert np.abs(left).max() < 0.15 * np.abs(then - now).max() + 1e-6, signal


@pytest.mark.parametrize("what", ["T", "A", "E"])
def test_constant_maps_are_refused_in_one_line(what):
    with pytest.raises(RobotError) as told:
        getattr(robot("car_arm"), what)
    text = str(told.value)
    assert "\n" not in text and f"'car_arm' has no constant {what}" in text
    assert "front_left_steering_joint" in text and f"{what}_at(position)" in text and "--base fixed" in text
