"""The half period: Psi_hat said for the middle of the time in which the torque acts, against scipy and Pinocchio."""

from __future__ import annotations

import shutil
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import assert_it_resumes, made
from numba import config
from scipy.integrate import solve_ivp

from mmnn_pin import load, load_experiment
from mmnn_pin.deploy.embed.export import embed
from mmnn_pin.errors import ConfigError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.latency import Latency
from mmnn_pin.loop.lead import catch_up, look_ahead
from mmnn_pin.loop.loop import Loop
from mmnn_pin.loop.sample import Control, Torque, before_torque, estimate_ahead
from mmnn_pin.loop.stepper import Stepper, StepperSettings
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.recording.recording import Recording
from mmnn_pin.reference import Eight, Sine, Trajectory
from mmnn_pin.reference.wishes import BaseVelocity
from mmnn_pin.safety import Safety
from mmnn_pin.sensing import Sensor
from mmnn_pin.settings import Timing
from mmnn_pin.signals import Measurement, Setpoint
from mmnn_pin.torque.controller import Feedback
from mmnn_pin.torque.entries import CONTROLLERS
from mmnn_pin.torque.law import Ahead, constant_gain, step
from mmnn_pin.torque.model_based import PD, ComputedTorque

ROBOTS = {
    "two_axis_arm": Trajectory(None, (Sine(0.6, 1.4), Sine(0.5, 1.1, 0.4, 1.0))),
    "platform_arm": Trajectory(Eight(2.0, 1.0, 6.0), (Sine(0.5, 1.4), Sine(0.4, 1.1, 0.5, 1.0))),
}
SAME = ("pd", "two_layer_zero", "two_layer_random", "nominal", "kalman_bilinear")  # nothing, or the code of another
EVERY = [name for name, entry in CONTROLLERS.items() if not entry.gain_of and name not in SAME]
LEARNERS = EVERY if config.DISABLE_JIT else ["two_layer", "adaptive"]  # compiled, it is the same code
one_more_compiled_loop = pytest.mark.long if not config.DISABLE_JIT else lambda test: test


def loop_of(name, h=0.002, lead=True, **more):
    """Computed torque on a robot that knows itself, from the reference on."""
    feedback = Feedback(500.0, (5.0, 0.4)) if name == "platform_arm" else Feedback(None, (5.0, 0.4))
    timing = Timing(duration=0.6, control_period=h, plant_step=h)
    return Loop(
        load(name), ROBOTS[name], ComputedTorque(feedback), Kinematic(kx=5.0, ky=16.0, kth=8.0, K=7.0), timing,
        Start(moving=True), check_gains=False, lead=lead, **more,
    )  # fmt: skip


def errors_under_held_torque(loop):
    """Largest errors of pose and joints after 0.3 s, the robot moved by Pinocchio and DOP853 under held torques."""
    robot, plan, h = loop.robot, loop.plan(), loop.timing.control_period
    layout, dynamics, row = plan.layout, Dynamics(robot), plan.layout.new_row()
    control, seen = Control(plan, row, loop.state_from(), None), Measurement.of(row, plan.layout)
    position, nu = loop.start.state(robot, plan.setpoints[0])
    still, bias, worst = np.zeros(layout.dof), np.zeros(layout.dof), 0.0
    nb, arm = layout.base, robot.arm_index

    def rates(_, y, tau):
        full, velocity = y[: layout.full], y[layout.full :]
        dynamics.refresh(full, velocity)
        dynamics.refresh_psi(velocity, still, bias)
        moved = robot.T @ velocity
        if nb:
            c, s = np.cos(full[2]), np.sin(full[2])
            moved[:2] = c * moved[0] - s * moved[1], s * moved[0] + c * moved[1]
        return np.concatenate((moved, np.linalg.solve(dynamics.M, tau - bias)))

    for k, setpoint in enumerate(plan.setpoints):
        seen.pose[:], seen.velocity[:] = position[: layout.pose], nu[:nb]
        seen.q[:], seen.qdot[:] = position[arm], nu[nb:]
        control.step(k * h, setpoint, k, plan.setpoints[max(k - 1, 0)])
        if k * h > 0.3:
            wanted = Setpoint.side_by_side(setpoint, layout)
            worst = np.maximum(worst, np.abs(np.concatenate((wanted.pose - seen.pose, wanted.q - seen.q))))
        tau = row[layout.where("torque")].copy()
        y = np.concatenate((position, nu))
        y = solve_ivp(rates, (0.0, h), y, "DOP853", args=(tau,), rtol=1e-10, atol=1e-12).y[:, -1]
        position, nu = y[: layout.full], y[layout.full :]
    return worst


@pytest.mark.compiled
@pytest.mark.parametrize("name", ROBOTS)
def test_under_a_held_torque_the_error_is_of_second_order_in_the_period_with_the_lead_and_of_first_without(name):
    late, led = ([errors_under_held_torque(loop_of(name, h, lead)) for h in (0.008, 0.004)] for lead in (False, True))
    arm = slice(-2, None)
    assert (late[0][arm] / late[1][arm] > 1.6).all() and (late[0][arm] / late[1][arm] < 2.5).all()
    assert (led[0][arm] / led[1][arm] > 3.2).all()
    assert (led[1] < 0.2 * late[1]).all()  # of the pose, too


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    name=st.sampled_from(sorted(ROBOTS)),
    time=st.floats(0.1, 5.0),
    d=st.floats(0.0, 0.01),
    age=st.floats(0.0, 0.01),
)
def test_ahead_the_reference_is_where_it_will_be_and_every_error_is_what_it_was(seed, name, time, d, age):
    loop, h, rng = loop_of(name, lead=False), 0.001, np.random.default_rng(seed)
    layout, row = loop.layout, loop.layout.new_row()
    before, now, then = loop.trajectory.table(np.array([time - h, time, time + d]), layout)
    setpoint, measured = Setpoint.side_by_side(now, layout), Measurement.of(row, layout)
    for own, wanted in ((measured.pose, setpoint.pose), (measured.velocity, setpoint.velocity),
                        (measured.q, setpoint.q), (measured.qdot, setpoint.qdot)):  # fmt: skip
        own[:] = wanted + 0.01 * rng.standard_normal(own.size)
    gains, K = loop.kinematic.base_gains(layout), loop.kinematic.arm_gains(layout)
    before_torque(row, layout.offsets, time, now, gains, K, before, None)
    kept = row.copy()
    ahead = Ahead(d, age, h, np.ones(layout.dof), layout.new_row(), constant_gain(np.ones(layout.dof)))
    look_ahead(row, layout.offsets, before, ahead, None)
    np.testing.assert_array_equal(row, kept)
    for error in ("z", "e", "edot", "r", "pose_error", "world_error"):
        np.testing.assert_array_equal(ahead.row[layout.where(error)], row[layout.where(error)])
    moved = ahead.row[layout.where("pose_ref").start : layout.where("qddot_ref").stop]
    np.testing.assert_allclose(moved, then, atol=1e-12 + 400 * d * (d + h))
    shift = ahead.row - row
    np.testing.assert_allclose(
        shift[layout.where("nu_ref")][layout.base :], shift[layout.where("qdot_ref")], atol=1e-12
    )
    np.testing.assert_allclose(
        shift[layout.where("nudot_ref")][layout.base :], shift[layout.where("qddot_ref")], atol=1e-12
    )
    old = loop.trajectory.table(np.array([time + d + age]), layout)[0]
    later = Setpoint.side_by_side(old, layout)
    near = 1e-12 + 400 * (d + age) * (d + age + h)
    np.testing.assert_allclose(shift[layout.where("q")], later.q - setpoint.q, atol=near)


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(sorted(ROBOTS)), st.floats(0.2, 5.0), st.floats(0.001, 0.01), st.integers(0, 2**32 - 1))
def test_a_measurement_that_is_brought_up_has_the_errors_of_its_own_time(name, time, age, seed):
    loop, rng = loop_of(name, lead=False), np.random.default_rng(seed)
    layout, row = loop.layout, loop.layout.new_row()
    then, now = loop.trajectory.table(np.array([time - age, time]), layout)
    first = layout.where("pose_ref").start

    def parts(table):
        return np.concatenate([table[layout.where(f"{k}_ref").start - first : layout.where(f"{k}_ref").stop - first]
                               for k in ("pose", "velocity", "q", "qdot")])  # fmt: skip

    measured = row[layout.where("pose").start : layout.where("qdot").stop]
    off = 0.01 * rng.standard_normal(measured.size)
    measured[:] = parts(then) + off
    catch_up(row, layout.offsets, now, then, age, None)
    np.testing.assert_allclose(measured - parts(now), off, atol=1e-12 + 40 * age**3)


@pytest.mark.compiled
def test_known_age_of_measurements_no_longer_drives_a_robot_off_its_reference():
    """On the reference `q_ref(t) - q(t - age)` asks for a motion by age times the speed, 4 mrad and more."""
    late = {one: loop_of("two_axis_arm", latency=Latency(sensing=0.006, predict=one)).run() for one in (False, True)}
    raw, caught = (np.abs(run["true_e"][run.time > 0.3]).max(axis=0) for run in late.values())
    assert (raw > 4e-3).all() and (caught < 0.05 * raw).all()
    slow = Timing(duration=0.1, control_period=0.002, plant_step=0.002, sensor_period=0.004)
    with pytest.raises(ConfigError, match=r"latency.predict: error: a measurement that is not new.*predict = false"):
        replace(loop_of("two_axis_arm", latency=Latency(sensing=0.004, predict=True)), timing=slow).plan()


@pytest.mark.compiled
@pytest.mark.parametrize(("lead", "command"), [(False, 0.0), (True, 0.0), (True, 0.002)])
def test_a_stepper_brings_its_measurements_up_by_their_age_as_a_loop_does(lead, command):
    """From the true state 6 ms ago, with its time, to the torques of the loop: no delay counts twice."""
    h, old = 0.002, 0.006
    latency = Latency(sensing=old, command=command, predict=True)
    loop = loop_of("platform_arm", lead=lead, latency=latency, safety=Safety())
    run, setpoints = loop.run(), Setpoint.side_by_side(loop.table(), loop.layout)
    arm, nb = loop.robot.arm_index, loop.robot.dimensions.base

    def then(k):
        position, nu = run["position"][max(k - 3, 0)], run["nu"][max(k - 3, 0)]
        return Measurement(position[:3], nu[:nb], position[arm], nu[nb:])

    with Stepper.of(loop) as stepper:
        for k in range(len(run)):
            one = Setpoint(*(getattr(setpoints, name)[k] for name in Setpoint.__slots__))
            command = stepper.step(k * h, then(k), one, measured=k * h - old)
            np.testing.assert_allclose(command.effort, run["torque"][k], rtol=1e-7, atol=1e-7)
    raw = Stepper.of(loop, predict=False)
    raw.step(0.0, then(len(run)), one, measured=-old)
    assert np.abs(raw.command.effort - command.effort).max() > 1e-3


def test_a_base_that_is_led_has_no_pose_error_and_an_age_counts_up_to_the_latency():
    robot, h = load("platform_arm"), 0.01
    with Stepper(
        robot, PD(), StepperSettings(safety=Safety(timeout=1.0), period=h, latency=0.02, predict=True)
    ) as stepper:
        pose, q = np.array([1.0, 2.0, 0.5]), np.array([0.1, 0.2])
        for k in range(60):
            still = Measurement(pose, np.zeros(2), q, np.zeros(2)) if k < 40 else None
            stepper.step(k * h, still, BaseVelocity((0.3, 0.1)), measured=k * h - 0.01)
            assert np.abs(stepper.row[stepper.setup.layout.where("pose_error")]).max() < 1e-12
            ahead = stepper.measured.pose[0] - pose[0]
            age = 0.01 if k < 40 else 0.02
            if k in (39, 45, 59):  # the reference is at its speed by then
                assert ahead == pytest.approx(age * 0.3 * np.cos(0.5), rel=0.02)
                assert stepper.measured.velocity == pytest.approx([0.0, 0.0], abs=1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize("name", LEARNERS)
def test_to_look_ahead_changes_nothing_that_a_controller_remembers(name):
    loop = replace(made(name, "lead=true", "learning.leakage=true", duration=0.02), engine="ordinary")
    run, plan = loop.run(), loop.plan()
    state, row = loop.state_from(), plan.layout.new_row()
    state.values[:] = run.final.get("controller_state", state.values)
    torque = Torque(loop.controller, plan.context, row, plan.believed, state, plan.lead)
    for signal in run:
        if signal != "time":
            row[plan.layout.where(signal)] = np.atleast_1d(run[signal][-1])
    weights = {key: np.array(values) for key, values in loop.controller.weights(state).items()}
    kept = {key: state[key].copy() for key in state.shapes}
    look_ahead(row, plan.layout.offsets, plan.setpoints[-2], plan.lead.ahead, None)
    estimate_ahead(torque.at, state.values, torque.model, torque.ahead, torque.later)
    step(plan.lead.ahead.row, torque.at, plan.lead.ahead.law, state.values, None, None)
    for key, values in loop.controller.weights(state).items():
        np.testing.assert_array_equal(values, weights[key])
    scratch = {"x", "net1", "net2", "sigma1", "sigma2", "s1", "s2", "used"}  # the step that follows writes them anew
    for key in set(kept) - scratch:
        np.testing.assert_array_equal(state[key], kept[key], err_msg=key)
    assert np.isfinite(plan.lead.ahead.row).all()


@pytest.mark.compiled
def test_looking_no_way_ahead_sends_what_is_said_of_the_sample():
    """So both are said with the same weights, also while they move most: by tens of newtons a sample at the start."""
    said = ("lead=true", "start.pose_offset=[-0.01,0.0,0.0]")
    loop = replace(made("adaptive", *said, duration=0.05), engine="ordinary")
    engine = loop.engine_at()
    torque = engine.control.torque
    torque.ahead = torque.ahead._replace(time=0.0, age=0.0, share=np.ones(loop.layout.dof))
    engine.control.equip(engine.control.hardware)
    rows = []
    for k in range(25):
        assert engine.advance(k, k + 1) == -1
        rows.append(engine.row.copy())
    said, sent = (np.array(rows)[:, loop.layout.where(signal)] for signal in ("psi_hat", "psi_applied"))
    np.testing.assert_allclose(sent, said, rtol=1e-9, atol=1e-9)
    assert np.abs(np.diff(said, axis=0)).max() > 1.0


def answer_to_the_state(loop, time=0.4, step=1e-6):
    """Jacobians (p, m) of psi_hat and psi_applied to what is measured, at the reference."""
    plan, found = loop.plan(), []
    layout, row = plan.layout, plan.layout.new_row()
    control, k = Control(plan, row, loop.state_from(), None), round(time / loop.timing.control_period)
    seen = row[layout.where("velocity").start : layout.where("qdot").stop]
    setpoint = Setpoint.side_by_side(plan.setpoints[k], layout)
    start = np.concatenate((setpoint.velocity, setpoint.q, setpoint.qdot))
    for i in range(seen.size):
        sides = []
        for sign in (1.0, -1.0):
            row[layout.where("pose")], seen[:] = setpoint.pose, start
            seen[i] += sign * step
            control.step(time, plan.setpoints[k], k, plan.setpoints[k - 1])
            sides.append(np.array([row[layout.where(name)] for name in ("psi_hat", "psi_applied")]))
        found.append((sides[0] - sides[1]) / (2 * step))
    return np.moveaxis(np.array(found), 0, -1)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_lead_neither_amplifies_noise_nor_changes_the_feedback_inside_psi(name):
    """Extrapolating, 1.5 Psi_k - 0.5 Psi_k-1, would answer 1.5 times as strongly at once."""
    own, applied = answer_to_the_state(loop_of(name))
    assert np.abs(applied - own).max() < 0.02 * np.abs(own).max()
    assert np.abs(own[-1, -2:]).max() > 0.1  # K edot is in it


@pytest.mark.compiled
def test_what_is_sent_is_within_the_motors_limits_and_the_estimate_stays_that_of_the_sample():
    loop = made("kalman_regressor", "lead=true", "actuator.lag=[0.0,0.0,0.004,0.002]", duration=0.05)
    plan, run = loop.plan(), replace(loop, engine="ordinary").run()
    np.testing.assert_allclose(loop.delays, [0.001, 0.001, 0.005, 0.003])
    np.testing.assert_allclose(plan.lead.ahead.share, [0.2, 0.2, 1.0, 0.6])
    limits = loop.robot.effort_limits
    assert (np.abs(run["psi_applied"] @ plan.E_inv.T) <= limits).all()
    gain = run["effective_gain"]
    s = np.hstack((run["z"], run["r"]))
    np.testing.assert_allclose(run["torque"], gain * s + run["psi_applied"], rtol=1e-12, atol=1e-12)
    assert np.abs(run["psi_applied"] - run["psi_hat"]).max() > 0


def test_latency_and_lag_lengthen_the_lead_and_a_stepper_is_told_them():
    loop = loop_of("two_axis_arm", latency=Latency(sensing=0.004, command=0.003, jitter=0.002))
    np.testing.assert_allclose(loop.delays, 0.001 + 0.003 + 0.001)
    assert loop.plan().lead.ahead.age == 0.004
    assert loop.context().way == pytest.approx(0.004 + 0.003 + 0.001) and not loop.context().lag.any()
    predicted = loop_of("two_axis_arm", latency=Latency(sensing=0.004, command=0.003, predict=True))
    assert predicted.context().way == pytest.approx(0.003)
    stepper = Stepper(loop.robot, loop.controller, StepperSettings(lead=True, latency=0.003, lag=0.002))
    np.testing.assert_allclose(stepper.control.torque.ahead.time, 0.001 + 0.003 + 0.002)
    assert stepper.setup.context().way == 0.003 and stepper.setup.context().lag.tolist() == [0.002, 0.002]
    brought_up = Stepper(loop.robot, loop.controller, StepperSettings(latency=0.003, predict=True))
    assert brought_up.setup.context().way == 0.0
    now = Measurement(np.zeros(0), np.zeros(0), np.zeros(2), np.zeros(2))
    for k in range(3):
        stepper.step(0.002 * k, now)
    assert stepper.row[stepper.setup.layout.where("psi_applied")].size == 2


def test_what_does_not_lead():
    pd = made("pd", "lead=true")
    assert pd.plan().lead is None and "psi_applied" not in replace(pd, engine="ordinary").run()
    assert not load_experiment("chapter4").lead and not load_experiment("chapter5").lead
    with pytest.raises(ConfigError, match=r"hidden outputs of the last call.*after_output"):
        made("two_layer", "lead=true", "learning.update=before_output").plan()


@pytest.mark.compiled
@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler: apt-get install gcc")
def test_the_c_source_leads_as_the_stepper_does(tmp_path):
    """Its self-test compares every signal of the stepper's rows, `psi_applied` among them."""
    loop = replace(loop_of("two_axis_arm"), safety=Safety(torque="urdf"))
    made = embed(loop, tmp_path / "c", steps=40)
    assert made.selftest_steps == 40 and "PSI_APPLIED" in "".join(
        file.read_text() for file in (tmp_path / "c").rglob("*.h")
    )


@pytest.mark.compiled
def test_on_velocity_interfaces_nothing_is_sent_of_psi():
    wheels = dict.fromkeys(load("platform_arm").actuator_names[:2], "velocity")
    run = loop_of("platform_arm", interfaces=wheels).run()
    assert not run["psi_applied"][:, :2].any() and run["psi_applied"][:, 2:].any()


@pytest.fixture(scope="module")
def compiled():
    """`adaptive` that leads, in the compiled engine."""
    loop = replace(made("adaptive", "lead=true", duration=0.02 if config.DISABLE_JIT else 0.4), engine="compiled")
    return loop, loop.run()


@pytest.mark.compiled
@one_more_compiled_loop
def test_engines_agree_and_a_run_that_leads_resumes(compiled):
    loop, run = compiled
    other = replace(loop, engine="ordinary").run()
    for signal in ("psi_hat", "psi_applied", "torque", "e"):
        np.testing.assert_array_equal(run[signal], other[signal], err_msg=signal)
    assert_it_resumes(loop, loop.timing.duration / 2)


@pytest.mark.compiled
def test_a_file_tells_how_far_a_run_led_and_what_was_sent(tmp_path):
    loop = replace(made("adaptive", "lead=true", duration=0.01), engine="ordinary")
    loop.run(tmp_path / "run.h5")
    run = Recording.open(tmp_path / "run.h5")
    assert run.labels("psi_applied") == run.labels("psi_hat") == loop.robot.velocity_names
    assert run["psi_applied"].shape == run["psi_hat"].shape
    np.testing.assert_allclose(run.meta["lead"], 0.5 * loop.timing.control_period)
    assert msgspec.json.decode(msgspec.json.encode(run.meta["lead"])) == run.meta["lead"]


@pytest.mark.long
def test_with_coarse_encoders_computed_torque_errs_by_less_than_a_third_of_a_step():
    """1.5 mrad at 1 kHz, once the observer has found the speed with which the arm began."""
    loop = loop_of("two_axis_arm", 0.001, sensor=Sensor(velocity="model", bandwidth=60.0, resolution=0.0015))
    run = replace(loop, timing=msgspec.structs.replace(loop.timing, duration=3.0)).run()
    rms = np.sqrt((run["true_e"][run.time > 1.0] ** 2).mean(axis=0))
    assert run.outcome.status == "completed" and (rms < 0.0015 / 3).all()


@pytest.mark.parametrize("name", ["sensing", "command", "jitter", "margin"])
def test_a_latency_in_milliseconds_is_refused_with_its_seconds(name):
    with pytest.raises(ConfigError, match=rf"latency.{name}: error: 4 s: no loop bears that: give seconds, as 0.004"):
        Latency(**{name: 4.0})
    assert getattr(Latency(**{name: 0.004}), name) == 0.004
