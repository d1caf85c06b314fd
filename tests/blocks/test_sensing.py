"""Measurements: every imperfection with and without, against numpy twins and against what is known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from builders import THESIS
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from numba import config
from robots import fixed_arm, mobile_arm

from mmnn_pin import PD, Feedback, Hold, Line, Loop, Neural, Sine, Timing, Trajectory, load, load_experiment
from mmnn_pin.errors import ConfigError
from mmnn_pin.loop.batch import simulate_many
from mmnn_pin.loop.hardware import pass_through
from mmnn_pin.recording.metrics import metrics
from mmnn_pin.sensing import Sensor
from mmnn_pin.sensing.settings import drawn
from mmnn_pin.signals import Layout, Measurement
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.model_based import ComputedTorque
from mmnn_pin.torque.one_layer import OneLayer
from mmnn_pin.torque.two_layer import TwoLayer

ROBOT = load("platform_arm")
ARM = fixed_arm(2, 1)
PERIOD = 0.005
patient = settings(max_examples=10 if config.DISABLE_JIT else 40, deadline=None)
seeds = st.integers(0, 2**31)


def measured(sensor, position, nu, robot=ROBOT, period=PERIOD, seed=0):
    """Measurements along a motion: positions (N, nv) and velocities (N, p)."""
    layout, sensors = Layout.of(robot.dimensions), sensor.on(robot, period, len(position), np.random.default_rng(seed))
    row, wire = layout.new_row(), sensors.wire
    view, out = Measurement.of(row, layout), {name: [] for name in ("pose", "velocity", "q", "qdot")}
    for k, (y, v) in enumerate(zip(position, nu, strict=True)):
        wire.position[:], wire.nu[:] = y, v
        pass_through(sensors.effects, wire, k, k * period)
        row[layout.where("pose").start : layout.where("qdot").stop] = wire.received
        for name, values in out.items():
            values.append(np.array(getattr(view, name)))
    return {name: np.array(values) for name, values in out.items()}


def motion(robot=ROBOT, samples=200, seed=0, period=PERIOD):
    """A smooth rolling motion by fine integration: positions and velocities at the sampling instants."""
    rng, p, fine = np.random.default_rng(seed), robot.dimensions.dof, 20
    amplitude, rate, phase = rng.uniform(0.1, 0.8, p), rng.uniform(0.5, 3, p), rng.uniform(0, 6, p)
    position, positions, velocities = robot.neutral_position(), [], []
    nb = robot.dimensions.base
    for k in range(samples * fine):
        t = k * period / fine
        nu = amplitude * np.sin(rate * t + phase)
        if k % fine == 0:
            positions.append(position.copy())
            velocities.append(nu)
        middle = amplitude * np.sin(rate * (t + 0.5 * period / fine) + phase)
        step = robot.T @ middle * period / fine
        if nb:
            heading = position[2] + 0.5 * step[robot.dimensions.pose - 1]
            vx, vy = middle[0], middle[1] if nb == 3 else 0.0
            c, s = np.cos(heading), np.sin(heading)
            step = step.copy()
            step[:3] = np.array([c * vx - s * vy, s * vx + c * vy, middle[nb - 1]]) * period / fine
        position = position + step
    return np.array(positions), np.array(velocities)


def true(robot, position, nu):
    nb, pose = robot.dimensions.base, robot.dimensions.pose
    return {"pose": position[:, :pose], "velocity": nu[:, :nb], "q": position[:, robot.arm_index], "qdot": nu[:, nb:]}


ROBOTS = {"platform": ROBOT, "fixed": ARM, "mobile": mobile_arm(3, 2)}


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_without_imperfections_the_truth_is_measured(robot):
    position, nu = motion(robot, 20)
    assert Sensor().exact and not Sensor(delay=1).exact
    for name, values in measured(Sensor(), position, nu, robot).items():
        np.testing.assert_array_equal(values, true(robot, position, nu)[name])


@patient
@given(seeds, st.floats(1e-5, 0.3))
def test_readings_are_multiples_of_the_step_within_half_of_it(seed, step):
    position, nu = motion(samples=20, seed=seed)
    q = measured(Sensor(resolution=step, offset=(0.1, -0.2)), position, nu)["q"]
    np.testing.assert_allclose(q / step, np.round(q / step), atol=1e-9)
    assert np.abs(q - position[:, ROBOT.arm_index] - [0.1, -0.2]).max() <= step * (0.5 + 1e-9)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_differences_are_numpys_and_those_of_wheels_give_the_base(robot):
    position, nu = motion(robot, 50)
    got = measured(Sensor(velocity="difference"), position, nu, robot)
    q = position[:, robot.arm_index]
    np.testing.assert_allclose(got["qdot"][1:], np.diff(q, axis=0) / PERIOD, rtol=1e-9, atol=1e-12)
    assert not got["qdot"][0].any()
    middle = 0.5 * (nu[1:] + nu[:-1])
    np.testing.assert_allclose(got["velocity"][1:], middle[:, : robot.dimensions.base], atol=2e-4)


def test_differencing_a_coarse_encoder_gives_multiples_of_step_over_period():
    position, nu = motion(samples=100)
    step = 0.002
    qdot = measured(Sensor(velocity="difference", resolution=step), position, nu)["qdot"]
    counts = qdot * PERIOD / step
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert np.abs(qdot[1:] - nu[1:, 2:]).max() > 0.05  # without a filter the rate is coarse


def test_a_filtered_derivative_is_scipys_filter():
    from scipy.signal import lfilter

    position, nu = motion(samples=100)
    wc = 60.0
    got = measured(Sensor(velocity="filtered", bandwidth=wc), position, nu)["qdot"]
    q = position[:, ROBOT.arm_index] - position[0, ROBOT.arm_index]
    a = 1 + wc * PERIOD  # wc s / (s + wc) with s = (1 - 1/z) / T
    np.testing.assert_allclose(got, lfilter([wc / a, -wc / a], [1, -1 / a], q, axis=0), atol=1e-10)


def test_the_observer_has_both_poles_where_it_says_and_no_error_on_a_ramp():
    wc, z = 80.0, np.exp(-80.0 * PERIOD)
    n, position = 400, np.tile(ROBOT.neutral_position(), (400, 1))
    position[1:, ROBOT.arm_index[0]] = 1.0  # a step of the angle
    nu = np.zeros((n, 4))
    rate = measured(Sensor(velocity="observer", bandwidth=wc), position, nu)["qdot"][:, 0]
    k = np.arange(n - 2)
    fit = np.linalg.lstsq(np.column_stack((z**k, k * z**k)), rate[1 : n - 1], rcond=None)
    assert fit[1][0] < 1e-18  # (a + b k) z^k: a double pole at z
    position[:, ROBOT.arm_index[0]] = 0.7 * PERIOD * np.arange(n)
    ramp = measured(Sensor(velocity="observer", bandwidth=wc), position, nu)["qdot"][:, 0]
    assert ramp[-1] == pytest.approx(0.7, abs=1e-10)


def test_filters_are_less_noisy_than_differences():
    position, nu = motion(samples=300)
    error = {}
    for velocity in ("difference", "filtered", "observer"):
        sensor = Sensor(resolution=1e-3, velocity=velocity, bandwidth=40.0)
        got = measured(sensor, position, nu)["qdot"]
        error[velocity] = np.std(np.diff(got[50:], axis=0))
    assert error["filtered"] < 0.5 * error["difference"]
    assert error["observer"] < 0.5 * error["difference"]


@pytest.mark.parametrize("name", ["platform", "mobile"])
def test_odometry_is_the_pose_where_wheels_roll_and_drifts_where_they_slip(name):
    robot = ROBOTS[name]
    position, nu = motion(robot, 400, seed=3)
    exact = measured(Sensor(pose="odometry"), position, nu, robot)["pose"]
    np.testing.assert_allclose(exact, position[:, :3], atol=2e-5)
    slipping = position.copy()
    wheel = robot.position_names.index(robot.base.wheels[0].joint)
    slipping[:, wheel] += 0.2 * np.linspace(0, 1, len(position)) ** 2  # [rad] more than it rolled
    drifting = measured(Sensor(pose="odometry"), slipping, nu, robot)["pose"]
    assert np.abs(drifting - position[:, :3])[-1].max() > 1e-3
    np.testing.assert_array_equal(measured(Sensor(), slipping, nu, robot)["pose"], position[:, :3])


def test_noise_has_the_deviation_asked_for_and_follows_the_seed():
    n = 300 if config.DISABLE_JIT else 3000
    position, nu = np.tile(ROBOT.neutral_position(), (n, 1)), np.zeros((n, 4))
    sensor = Sensor(noise=1e-3, velocity_noise=0.02, pose_noise=(0.01, 0.02, 0.03))
    a, b, c = (measured(sensor, position, nu, seed=seed) for seed in (1, 1, 2))
    for name, deviation in (("q", [1e-3]), ("qdot", [0.02]), ("velocity", [0.02]), ("pose", [0.01, 0.02, 0.03])):
        np.testing.assert_array_equal(a[name], b[name])
        assert (a[name] != c[name]).any()
        centred = a[name] - a[name].mean(axis=0)
        np.testing.assert_allclose(centred.std(axis=0), np.broadcast_to(deviation, centred.shape[1]), rtol=0.15)


def test_no_noise_is_beyond_four_deviations_and_all_other_noise_is_as_drawn():
    (found,) = drawn(np.random.default_rng(5), 100_000, (3,))[:1]
    plain = np.random.default_rng(5).spawn(2)[0].standard_normal((100_000, 3))
    beyond = np.abs(plain) > 4.0
    assert 5 < beyond.sum() < 50 and (np.abs(found[beyond]) == 4.0).all()
    np.testing.assert_allclose(found[~beyond], plain[~beyond], rtol=4e-16)


def test_every_velocity_may_have_noise_of_its_own():
    n = 300 if config.DISABLE_JIT else 3000
    position, nu = np.tile(ROBOT.neutral_position(), (n, 1)), np.zeros((n, 4))
    noisy = measured(Sensor(velocity_noise=(0.1, 0.2, 0.0, 0.4)), position, nu, seed=1)
    found = np.hstack([noisy["velocity"], noisy["qdot"]]).std(axis=0)
    np.testing.assert_allclose(found, [0.1, 0.2, 0.0, 0.4], rtol=0.15, atol=1e-12)
    alike = measured(Sensor(velocity_noise=0.2), position, nu, seed=1)
    np.testing.assert_array_equal(alike["velocity"][:, 1], noisy["velocity"][:, 1])
    with pytest.raises(ConfigError, match="2 numbers for 4 velocities"):
        measured(Sensor(velocity_noise=(0.1, 0.2)), position, nu)


def test_a_delay_shifts_everything():
    position, nu = motion(samples=40)
    late, now = (measured(Sensor(delay=delay, velocity="difference"), position, nu) for delay in (3, 0))
    for name in now:
        np.testing.assert_array_equal(late[name][3:], now[name][:-3])
        np.testing.assert_array_equal(late[name][:3], np.tile(now[name][0], (3, 1)))


@pytest.mark.parametrize("delay", [0, 2])
def test_the_base_is_new_as_seldom_as_it_is_told_and_the_arm_at_once(delay):
    position, nu = motion(samples=40)
    exact = measured(Sensor(delay=delay), position, nu)
    seldom = measured(Sensor(delay=delay, base_period=2.5 * PERIOD), position, nu)
    told = np.maximum(np.arange(40) - delay, 0) // 3 * 3 + delay  # 2.5 measurements are 3
    for name in ("pose", "velocity"):
        np.testing.assert_array_equal(seldom[name], exact[name][told])
    for name in ("q", "qdot"):
        np.testing.assert_array_equal(seldom[name], exact[name])
    late = measured(Sensor(delay=delay, base_period=2.5 * PERIOD, base_delay=1.5 * PERIOD), position, nu)
    for name in ("pose", "velocity"):
        np.testing.assert_array_equal(late[name][2:], seldom[name][:-2])
        np.testing.assert_array_equal(late[name][:2], np.tile(exact[name][0], (2, 1)))
    for name in ("q", "qdot"):
        np.testing.assert_array_equal(late[name], exact[name])
    assert Sensor(base_period=2.5 * PERIOD).base_age(PERIOD) == pytest.approx(2 * PERIOD)
    assert Sensor(base_period=2.5 * PERIOD, base_delay=1.5 * PERIOD).base_age(PERIOD) == pytest.approx(4 * PERIOD)
    assert Sensor(base_period=0.5 * PERIOD).base_age(PERIOD) == 0.0


@patient
@given(seeds, st.integers(0, 4), st.integers(0, 5), st.floats(0, 0.9))
def test_what_arrives_is_never_older_than_what_was_there_nor_newer_than_the_delay(seed, delay, jitter, loss):
    n = 60
    position, nu = np.tile(ROBOT.neutral_position(), (n, 1)), np.zeros((n, 4))
    position[:, ROBOT.arm_index[0]] = np.arange(n)  # the reading is the number of its measurement
    got = measured(Sensor(delay=delay, jitter=jitter, loss=loss), position, nu, seed=seed)["q"][:, 0]
    assert (np.diff(got) >= 0).all() and (got <= np.maximum(0, np.arange(n) - delay)).all()
    if loss == 0:
        assert (got >= np.maximum(0, np.arange(n) - delay - jitter)).all()


def test_jitter_and_loss_are_as_frequent_as_they_say():
    n = 400 if config.DISABLE_JIT else 4000
    position, nu = np.tile(ROBOT.neutral_position(), (n, 1)), np.zeros((n, 4))
    position[:, ROBOT.arm_index[0]] = np.arange(n)
    held = np.diff(measured(Sensor(loss=0.3), position, nu)["q"][:, 0]) == 0
    assert held.mean() == pytest.approx(0.3, abs=0.07)
    age = np.arange(n) - measured(Sensor(jitter=1), position, nu)["q"][:, 0]
    assert set(age[1:]) == {0, 1} and (age == 1).mean() == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"resolution": -1.0}, "sensor.resolution"),
        ({"wheel_resolution": float("nan")}, "sensor.wheel_resolution"),
        ({"offset": float("inf")}, "sensor.offset"),
        ({"bandwidth": 0.0}, "sensor.bandwidth"),
        ({"delay": -1}, "sensor.delay"),
        ({"jitter": 20_000}, "sensor.jitter"),
        ({"loss": 1.0}, "sensor.loss"),
        ({"pose_noise": (0.1, -0.1, 0.0)}, "sensor.pose_noise"),
    ],
)
def test_numbers_out_of_range_are_refused(arguments, text):
    with pytest.raises(ConfigError, match=text):
        Sensor(**arguments)


def test_numbers_that_do_not_fit_the_robot_are_refused():
    with pytest.raises(ConfigError, match=r"sensor.offset.*3 numbers for 2 joints"):
        Sensor(offset=(0.0, 0.0, 0.0)).on(ROBOT, PERIOD, 1, np.random.default_rng(0))


# --- In the loop ------------------------------------------------------------------------------------------------------

DURATION = 0.04 if config.DISABLE_JIT else 0.4
TRAJECTORY = Trajectory(Line(0.3), (Sine(0.5, 2.0), Hold(0.4)))
ROUGH = Sensor(
    resolution=1e-3,
    wheel_resolution=2e-3,
    offset=(0.01, 0.0),
    velocity="filtered",
    bandwidth=80.0,
    pose="odometry",
    noise=1e-4,
    wheel_noise=1e-4,
    velocity_noise=1e-3,
    pose_noise=(1e-3, 1e-3, 1e-3),
    delay=1,
    jitter=1,
    loss=0.1,
)


def loop_of(sensor, controller=None, **changes):
    timing = changes.pop("timing", Timing(duration=DURATION))
    controller = controller or Neural(TwoLayer(), Feedback(200.0, 3.0), robust=None)
    return Loop(ROBOT, TRAJECTORY, controller, timing=timing, sensor=sensor, seed=3, weights_interval=0.02, **changes)


@pytest.mark.compiled
@pytest.mark.parametrize("velocity", ["true", "difference", "filtered", "observer"])
@pytest.mark.parametrize("sensor_period", [0.001, 0.002, 0.004])
def test_both_engines_measure_the_same(velocity, sensor_period):
    sensor = structs.replace(ROUGH, velocity=velocity)
    timing = Timing(duration=DURATION, sensor_period=sensor_period)
    runs = [loop_of(sensor, timing=timing, engine=engine).run() for engine in ("ordinary", "compiled")]
    for name in runs[0].names:
        np.testing.assert_allclose(runs[0][name], runs[1][name], rtol=1e-7, atol=1e-7, err_msg=name)
    assert np.abs(runs[0]["q"] - runs[0]["position"][:, ROBOT.arm_index]).max() > 0.005


def test_the_same_seed_gives_the_same_bits_and_another_one_other_noise():
    a, b, c = (replace(loop_of(ROUGH), seed=seed).run() for seed in (3, 3, 4))
    np.testing.assert_array_equal(a["q"], b["q"])
    assert (a["q"] != c["q"]).any()


def test_controllers_draw_the_same_weights_with_and_without_noise():
    exact, rough = (loop_of(sensor).run() for sensor in (Sensor(), ROUGH))
    np.testing.assert_array_equal(exact.weights["V1"][0], rough.weights["V1"][0])


@pytest.mark.parametrize("engine", ["ordinary", "compiled"])
def test_a_run_resumes_with_its_sensors(engine):
    whole = loop_of(ROUGH, engine=engine)
    half = replace(whole, timing=Timing(duration=DURATION / 2))
    first = half.run()
    k, end = half.timing.samples, first.final
    state = ControllerState(np.array(end["controller_state"]), whole.state_from().shapes)
    rest = whole.run(
        state=state, plant_state=(end["position"], end["nu"]), hardware_state=end["hardware_state"], first=k
    )
    straight = whole.run()
    for name in ("q", "pose", "velocity", "torque"):
        np.testing.assert_allclose(rest[name], straight[name][k:], rtol=1e-9, atol=1e-9)
    assert len(rest) == len(straight) - k


def test_true_errors_are_those_of_the_state_and_equal_the_measured_ones_of_exact_sensors():
    exact, rough = (loop_of(sensor).run() for sensor in (Sensor(), ROUGH))
    for true_error, error in (("true_pose_error", "pose_error"), ("true_z", "z"), ("true_e", "e")):
        np.testing.assert_array_equal(exact[true_error], exact[error])
        assert (rough[true_error] != rough[error]).any()
    np.testing.assert_array_equal(rough["true_e"], rough["q_ref"] - rough["position"][:, ROBOT.arm_index])
    np.testing.assert_array_equal(rough["true_z"], rough["alpha"] - rough["nu"][:, :2])


@pytest.mark.compiled
def test_runs_are_judged_by_the_true_errors():
    """An encoder that is 10 mrad off tracks its reading; the joint itself is 10 mrad off."""
    sensor = Sensor(offset=(0.01, 0.0))
    run = loop_of(sensor, engine="compiled", timing=Timing(duration=10 * DURATION)).run()
    late = run.time >= 5 * DURATION
    name = f"e.{ROBOT.joint_names[0]}.rms_{5 * DURATION:g}_{10 * DURATION:g}"
    told = metrics(run, [(5 * DURATION, 10 * DURATION)])[name]
    assert told == pytest.approx(np.sqrt(np.mean(run["true_e"][late, 0] ** 2)))
    batch = simulate_many([loop_of(sensor, timing=run_timing(run))], windows=[(5 * DURATION, 10 * DURATION)])[0]
    assert batch.metrics[name] == told


def run_timing(run):
    return Timing(duration=float(run.time[-1]) + 0.002)


@pytest.mark.parametrize(
    "controller",
    [PD(Feedback(200.0, 3.0)), Neural(TwoLayer(), THESIS), Neural(OneLayer(), THESIS), ComputedTorque(THESIS)],
)
def test_controllers_see_the_measurement_and_nothing_else(controller):
    """Sensors that never say anything new: the torque follows from the first measurement, not from the moving state."""
    stuck = loop_of(Sensor(delay=10_000), controller).run()
    for name in ("pose", "velocity", "q", "qdot"):
        np.testing.assert_array_equal(stuck[name], np.tile(stuck[name][0], (len(stuck), 1)))
    heavy = ROBOT.with_masses(2.0)  # moves otherwise; the controllers still believe in the other one
    loop = replace(loop_of(Sensor(delay=10_000), controller), robot=heavy, nominal=ROBOT, check_gains=False)
    other = loop.run()
    assert np.abs(other["position"] - stuck["position"]).max() > 1e-4
    np.testing.assert_array_equal(other["torque"], stuck["torque"])


def test_an_experiment_takes_sensors_from_its_toml_and_records_them():
    experiment = load_experiment("chapter4", ["sensor.resolution=0.001", 'sensor.velocity="difference"'])
    loop = experiment.loop(ROBOT, experiment.controller("pd"))
    assert loop.sensor == Sensor(resolution=0.001, velocity="difference")
    assert loop.facts()["sensor"]["velocity"] == "difference" and "sensor" not in loop_of(Sensor()).facts()
    with pytest.raises(ConfigError, match=r"sensor\.delay"):
        load_experiment("chapter4", ["sensor.delay=-3"])
