"""Velocity interfaces: the split dynamics against DOP853, the servos' law against its closed form, and whole runs."""

from __future__ import annotations

import re
import shlex
from dataclasses import fields, replace

import msgspec
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from numba import config
from scipy.integrate import solve_ivp

from mmnn_pin import (
    PD,
    Eight,
    Feedback,
    Hold,
    Line,
    Loop,
    Sine,
    Stepper,
    StepperSettings,
    Timing,
    Trajectory,
    compare,
    load,
    load_experiment,
)
from mmnn_pin.actuator import STATES, Actuator, motor_state, new_drive
from mmnn_pin.errors import ConfigError, InputError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.loop.batch import simulate_many
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.latency import Latency
from mmnn_pin.loop.ordinary import OrdinaryLoop
from mmnn_pin.loop.sampled import verdicts
from mmnn_pin.loop.servo import Servo, interfaces_of, split_of
from mmnn_pin.loop.servo_model import servo_slots, servos_of
from mmnn_pin.loop.suited import LoopToSuit, suited
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robots import robot_data
from mmnn_pin.safety import Safety
from mmnn_pin.sensing import exact
from mmnn_pin.signals import INDEX, Measurement, Setpoint
from mmnn_pin.torque.model_based import ComputedTorque

needs_data = pytest.mark.skipif(robot_data() is None, reason="example-robot-data is not installed")
ROBOT = load("platform_arm").with_friction((30.0, 5.0, 0.5, 0.5))
WHEELS = dict.fromkeys(ROBOT.actuator_names[:2], "velocity")
H = 0.002
CALM = Kinematic(kx=2.0, ky=16.0, kth=8.0, K=5.0)


def made(controller=None, interfaces=WHEELS, duration=0.3, **more):
    timing = Timing(duration, H, 0.001, integrator="implicit_friction")
    arm = tuple(Sine(0.4, 2.0, phase=0.5 * i) for i in range(ROBOT.dimensions.arm))
    controller = suited(
        controller or ComputedTorque(Feedback(20.0, 30.0, "inertia")), ROBOT, lambda: LoopToSuit(CALM, H)
    )
    given = {"kinematic": CALM, "timing": timing, "interfaces": interfaces, "servo": Servo(bandwidth=25.0)} | more
    return Loop(ROBOT, Trajectory(Eight(3.0, 1.5, 20.0), arm), controller, **given)


def asked(position, nu, time, loop):
    """Torque, command and errors of a loop's control sample at a state of one's own."""
    engine = replace(loop, engine="ordinary").engine_at(plant_state=(position, nu))
    assert isinstance(engine, OrdinaryLoop)
    exact(engine.row, engine.at, position, nu, engine.places)
    table = np.zeros(loop.table().shape[1])
    measured = Measurement.of(engine.row, loop.layout)
    loop.trajectory.write(time, measured, Setpoint.side_by_side(table, loop.layout))
    engine.control.step(time, table)
    return engine.row, engine.control.hardware.split


def test_the_energy_of_the_effort_rows_falls_as_their_gains_say():
    """The split dynamics, written down and integrated by DOP853: `dV/dt = -r' K r` for `V = 1/2 r' M_ee r`."""
    loop = made(servo=Servo(bandwidth=25.0, rate=0.0))
    dynamics, nv, e, s = Dynamics(ROBOT), ROBOT.dimensions.full, slice(2, 4), slice(0, 2)
    k, b = loop.controller.feedback_gain(loop.layout), 25.0
    start = Start(joint_offset=(0.2, -0.1), moving=False)
    position, nu = start.state(ROBOT, loop.table()[0])
    nu[:] = (0.2, -0.3, 0.4, -0.5)

    def parts(y, t):
        position, nu = y[:nv], y[nv:]
        row, split = asked(position, nu, t, loop)
        return position, nu, row, split

    def rate(t, y):
        position, nu, row, split = parts(y, t)
        M, C = dynamics.mass_matrix(position), dynamics.coriolis_matrix(position, nu)
        rest = dynamics.gravity(position) + dynamics.friction(nu)
        nudot = np.zeros(4)
        nudot[s] = b * (split.command[s] - nu[s])  # the servo as its model says, whatever the torque that takes
        tau = row[loop.layout.where("torque")]
        assert not tau[s].any()
        nudot[e] = np.linalg.solve(M[e, e], (tau - C @ nu - rest - M[:, s] @ nudot[s])[e])
        velocity = ROBOT.T @ nu
        c, sn = np.cos(position[2]), np.sin(position[2])
        velocity[:2] = c * velocity[0] - sn * velocity[1], sn * velocity[0] + c * velocity[1]
        return np.concatenate((velocity, nudot))

    def energy(t, y):
        position, _, row, _ = parts(y, t)
        r = row[loop.layout.where("r")]
        return 0.5 * r @ dynamics.mass_matrix(position)[e, e] @ r, r

    h = 1e-4
    for t0 in (0.0, 0.05):
        found = solve_ivp(rate, (t0, t0 + 2 * h), np.concatenate((position, nu)), "DOP853", [t0, t0 + h, t0 + 2 * h],
                          rtol=1e-12, atol=1e-14)  # fmt: skip
        (before, _), (_, r), (after, _) = (energy(t, y) for t, y in zip(found.t, found.y.T, strict=True))
        assert (after - before) / (2 * h) == pytest.approx(-r @ (k[e] * r), rel=2e-4)
        assert before > 1e-3


@settings(deadline=None, max_examples=10, phases=(Phase.generate,))
@given(st.floats(5.0, 40.0), st.floats(0.0, 2.0), st.floats(0.0, 5.0), st.floats(-0.3, 0.3))
def test_errors_of_a_servo_row_obey_their_linear_equation_and_the_integral_takes_the_rest(b, k, rate, rest):
    """`ds/dt = -b (1 + k) s - b psi - rest`, `dpsi/dt = rate s`: eigenvalues, and the rest is gone in the end."""
    A = np.array([[-b * (1 + k), -b], [rate, 0.0]])
    assert np.linalg.eigvals(A).real.max() <= 1e-9
    loop = made(servo=Servo(bandwidth=b, gain=k, rate=rate))
    position, nu = Start().state(ROBOT, loop.table()[0])
    nu[:2] = 0.1, -0.2
    row, split = asked(position, nu, 0.0, loop)
    table = Setpoint.side_by_side(loop.table()[0], loop.layout)
    alpha, alphadot = row[loop.layout.where("alpha")], row[loop.layout.where("alphadot")]
    s = alpha - nu[:2]
    np.testing.assert_allclose(row[loop.layout.where("z")], s)  # told, though no torque sees it
    np.testing.assert_allclose(split.integral[:2], H * rate * s, atol=1e-15)
    u = alpha + alphadot / b + k * s + H * rate * s
    np.testing.assert_allclose(split.command[:2], u, atol=1e-12)
    np.testing.assert_allclose(b * (u - nu[:2]) - alphadot, b * (1 + k) * s + b * split.integral[:2], atol=1e-9)
    modelled = alphadot + b * (1 + k) * s  # psi stands for the rest, so it moves nothing
    np.testing.assert_allclose(row[loop.layout.where("nudot_ref")][:2], modelled, atol=1e-9)
    assert table.velocity.shape == (2,)


def test_a_base_on_velocity_follows_with_its_arm_on_effort_and_a_stepper_does_the_same():
    loop = made(duration=0.3 if config.DISABLE_JIT else 3.0, safety=Safety(), start=Start(moving=True))
    run = loop.run()
    assert run.outcome.status == "completed"
    late = run.time > 0.8 * run.outcome.time
    assert np.abs(run["true_pose_error"][late]).max() < 0.03 and np.abs(run["true_e"][late]).max() < 0.05
    assert not run["torque"][:, :2].any() and np.abs(run["applied"][:, :2]).max() > 0.1
    setpoints = Setpoint.side_by_side(loop.table(), loop.layout)
    with Stepper.of(loop) as stepper:
        for k in range(len(run)):
            measured = Measurement(*(run[name][k] for name in ("pose", "velocity", "q", "qdot")))
            one = Setpoint(*(getattr(setpoints, f.name)[k] for f in fields(Setpoint)))
            command = stepper.step(k * H, measured, one)
            assert command.effort[2:].tolist() == run["torque"][k, 2:].tolist()
            assert np.isnan(command.effort[:2]).all() and np.isnan(command.velocity[2:]).all()
        np.testing.assert_allclose(command.motor_velocity[:2], ROBOT.E.T[:2, :2] @ command.velocity[:2])
        assert np.isnan(command.motor_effort[:2]).all() and np.isnan(command.position).all()
        np.testing.assert_allclose(command.velocity[:2], measured.velocity, atol=0.3)
        stepper.stop()
        for k in range(len(run), len(run) + 400):
            command = stepper.step(k * H, measured)
        assert not command.velocity[:2].any()


@pytest.mark.compiled
def test_both_engines_and_a_batch_give_the_same_bits():
    """Wheels by velocity, a joint by position, a jittery way, and a supervisor that trips in between."""
    interfaces, way = WHEELS | {ROBOT.joint_names[1]: "position"}, Latency(sensing=H, command=H, jitter=H)
    limits = Safety(joint_error=0.03)  # the start is off by more
    late = {"interfaces": interfaces, "latency": way, "check_gains": False}  # one loop to compile; it would ring soon
    known = Servo(25.0, stiffness=(0.0, 0.0, 0.0, 60.0), damping=2.0, dead_band=1e-3, profile_speed=2.0, period=0.002)
    loops = [
        made(duration=0.1, **late),
        made(duration=0.1, **late, servo=known, actuator=Actuator(lag=0.002)),
        made(duration=0.1, **late, safety=limits, start=Start(joint_offset=0.04)),
    ]
    for loop in loops:
        compiled, ordinary = (replace(loop, engine=engine).run() for engine in ("compiled", "ordinary"))
        assert compiled.meta["loop"] == "compiled" and compiled.outcome == ordinary.outcome
        for signal in compiled:
            np.testing.assert_array_equal(compiled[signal], ordinary[signal], err_msg=signal)
        np.testing.assert_array_equal(compiled.final["hardware_state"], ordinary.final["hardware_state"])
    batch = simulate_many(loops, keep=("torque", "applied"), workers=1)
    np.testing.assert_array_equal(batch[-1].recording["applied"], compiled["applied"])
    assert compiled.outcome.status == "tripped" and np.abs(compiled["applied"][:, :2]).max() > 0.1


def test_a_joint_that_takes_positions_gets_the_integral_of_its_velocity():
    joint = ROBOT.joint_names[1]
    loop = made(interfaces={joint: "position"}, servo=Servo(bandwidth=25.0))
    run, setpoints = loop.run(), Setpoint.side_by_side(loop.table(), loop.layout)
    with Stepper.of(loop, safety=Safety()) as stepper:
        total = run["q"][0, 1]
        for k in range(50):
            measured = Measurement(*(run[name][k] for name in ("pose", "velocity", "q", "qdot")))
            one = Setpoint(*(getattr(setpoints, f.name)[k] for f in fields(Setpoint)))
            command = stepper.step(k * H, measured, one)
            total += H * stepper.hardware.split.command[3]
            assert command.position[3] == pytest.approx(total, abs=1e-12) and np.isnan(command.velocity).all()
    assert np.isnan(command.position[:3]).all() and np.isfinite(command.effort[:3]).all()


def test_a_weak_servo_saturates_and_a_slow_one_is_late():
    free, weak = made(), made(servo=Servo(bandwidth=25.0, strength=1e-3))
    limited = replace(ROBOT, effort_limits=np.full(4, 50.0))
    applied = [replace(one, robot=limited, nominal=ROBOT).run()["applied"][:, :2] for one in (free, weak)]
    assert np.abs(applied[0]).max() > 0.1 and np.abs(applied[1]).max() == pytest.approx(0.05)
    slow, (kinds, _), state = Servo(delay=0.01), interfaces_of(ROBOT, WHEELS), np.zeros(15)
    split = split_of(ROBOT, kinds, slow, H, state)
    split.command[:] = 0.5, 0.2, 0.0, 0.0
    memory = motor_state(np.zeros((4, STATES))), np.zeros((servo_slots(slow, 0.002, 0.001), 4))
    servos = servos_of(ROBOT, kinds, slow, Actuator(), split, memory, 0.001)
    wire = new_drive(4)  # of joints that no torque moves
    for n in range(20):
        servos.act(wire, 0, n * 0.001)
        lasted = max(0, n - 12) * 0.001  # the integral's part of a servo that does not move
        wheels = (1 + 0.25 * 30.0 * (lasted + 0.001)) * servos.law[1, :2] * (ROBOT.E.T @ split.command)[:2] * (n >= 12)
        wheels = np.clip(wheels, -ROBOT.effort_limits[:2], ROBOT.effort_limits[:2])
        np.testing.assert_allclose(wire.torque, [*wheels, 0.0, 0.0])


@pytest.mark.compiled
def test_a_resumed_run_is_the_same():
    loop, half = made(duration=0.2), made(duration=0.1)
    first = half.run()
    final = first.final
    state = first.final.get("controller_state")
    rest = loop.run(
        first=50, plant_state=(final["position"], final["nu"]), hardware_state=final["hardware_state"]
    )  # fmt: skip
    assert state is None or state.size == 0
    np.testing.assert_array_equal(rest["torque"], loop.run()["torque"][50:])


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("interfaces", "text"),
    [
        ({"elbow": "velocity"}, "interfaces: error: unknown joint"),
        ({ROBOT.joint_names[0]: "torque"}, "unknown interface"),
        ({ROBOT.actuator_names[0]: "velocity"}, "wheels by effort and velocity"),
        (dict.fromkeys(ROBOT.actuator_names[:2], "position"), "wheels by position"),
    ],
)
def test_interfaces_that_cannot_be_are_one_line(interfaces, text):
    with pytest.raises(InputError, match=text):
        made(interfaces=interfaces).run()


def test_torque_regressors_are_refused_on_servo_rows():
    from test_stepper import learner

    with pytest.raises(ConfigError, match="kalman_regressor on a velocity interface"):
        made(learner("kalman_regressor")).run()
    made(PD(Feedback(20.0, 30.0, "inertia")), duration=0.02).run()


def test_names_say_which_rows_are_servo_rows():
    kinds, on = interfaces_of(ROBOT, WHEELS | {ROBOT.joint_names[1]: "position"})
    assert kinds == ("velocity", "velocity", "effort", "position") and on.tolist() == [1, 1, 0, 1]
    with pytest.raises(ConfigError, match=r"servo\.bandwidth"):
        Servo(bandwidth=0.0)


# -- the loop that is judged before a run ------------------------------------------------------------------------------

EVERY = dict.fromkeys(ROBOT.actuator_names, "velocity")


def standing(share, period, **more):
    """Every motor by velocity, the arm still, a start off by little; gains of the kinematic layer times a share."""
    kinematic = Kinematic(kx=3.0 * share, ky=16.0 * share, kth=8.0 * share, K=5.0 * share)
    reference = Trajectory(Line(0.3), (Hold(0.4), Hold(0.4)))
    start = Start(pose_offset=(-1e-8, 1e-8, 0.0), joint_offset=1e-8, moving=True)
    timing = Timing(60 * period, period, 0.001, integrator="implicit_friction")
    given = {"kinematic": kinematic, "timing": timing, "start": start, "interfaces": EVERY, "servo": Servo()} | more
    return Loop(ROBOT, reference, PD(Feedback(100.0, 10.0)), check_gains=False, **given)


def growth(errors):
    """Of errors (samples, p) per sample, late in a run."""
    size = np.linalg.norm(errors, axis=1)
    n = len(size)
    return (size[2 * n // 3 :].max() / size[n // 3 : 2 * n // 3].max()) ** (3 / n)


def judged(plan):
    return max(verdict.radius for verdict in verdicts(plan))


def limit_of(made):
    """The share of the gains at which a loop is judged to turn unstable."""
    low, high = 0.05, 5.0
    for _ in range(30):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if judged(made(middle)) <= 1.0 + 1e-9 else (low, middle)
    return low


@pytest.mark.compiled
@pytest.mark.parametrize(("period", "more"), [(0.1, {}), (0.2, {}), (0.1, {"servo": Servo(bandwidth=60.0, gain=0.5)})])
def test_simulated_servos_ring_above_the_judged_limit_and_not_below(period, more):
    share = limit_of(lambda share: standing(share, period, **more).plan())
    calm, wild = (standing(f * share, period, **more) for f in (0.8, 1.1))
    runs = [growth(np.hstack((run["z"], run["r"]))) for run in (calm.run(), wild.run())]
    assert runs[0] < 1.0 < runs[1]
    assert runs[1] == pytest.approx(judged(wild.plan()), rel=0.03) and judged(wild.plan()) > 1.01


def on_lags(share, period, check=True, samples=70, b=30.0):
    """Errors of a `Stepper` before servos that are lags, `nudot = b (u - nu)`, by DOP853; and the stepper."""
    kinematic = Kinematic(kx=3.0 * share, ky=16.0 * share, kth=8.0 * share, K=5.0 * share)
    given = {"kinematic": kinematic, "period": period, "interfaces": EVERY, "servo": Servo(bandwidth=b)}
    stepper = Stepper(ROBOT, PD(), StepperSettings(check_gains=check, **given))
    state = np.array([-1e-8, 1e-8, 0.0, 0.4 - 1e-8, 0.4 - 1e-8, 0.5, 0.0, 0.0, 0.0])  # pose, q, nu: within limits
    errors = []

    def rate(_, y, u):
        v = y[5]
        return np.concatenate(([v * np.cos(y[2]), v * np.sin(y[2])], y[6:9], b * (u - y[5:])))

    for k in range(samples):
        one = Setpoint(np.array([0.5 * k * period, 0.0, 0.0]), np.array([0.5, 0.0]), np.zeros(2), np.full(2, 0.4),
                       np.zeros(2), np.zeros(2))  # fmt: skip
        measured = Measurement(state[:3].copy(), state[5:7].copy(), state[3:5].copy(), state[7:].copy())
        command = stepper.step(k * period, measured, one)
        errors.append(
            np.concatenate((stepper.row[stepper.at[INDEX["z"]] :][:2], stepper.row[stepper.at[INDEX["r"]] :][:2]))
        )
        u = command.velocity.copy()
        state = solve_ivp(rate, (0.0, period), state, "DOP853", args=(u,), rtol=1e-10, atol=1e-14).y[:, -1]
    return np.array(errors), stepper


@pytest.mark.parametrize("period", [0.1, 0.2])
def test_servos_that_are_lags_ring_above_the_judged_limit_of_a_stepper_and_not_below(period):
    def plan(share):
        return on_lags(share, period, False, 0)[1].judged

    share = limit_of(plan)
    calm, wild = (on_lags(f * share, period, False)[0] for f in (0.8, 1.15))
    assert growth(calm[20:]) < 1.0
    assert growth(wild[20:]) == pytest.approx(judged(plan(1.15 * share)), rel=0.02)
    assert on_lags(0.8 * share, period, True, 0)[1].delay_margin() > 0.0
    with pytest.raises(ConfigError, match=r"kinematic: error: the sampled loop is unstable"):
        on_lags(1.15 * share, period, True, 0)


@pytest.mark.parametrize("bandwidth", [30.0, 100.0])
def test_a_stepper_at_50_hz_takes_servos_as_fast_as_they_are(bandwidth):
    errors, stepper = on_lags(1.0, 0.02, True, 150, bandwidth)
    assert growth(errors) < 1.0 and stepper.delay_margin() > 0.02


def advised(text):
    """What a refusal says to give in Python."""
    found = re.search(r"(kinematic|servo)=((?:Kinematic|Servo)\((?:[^()]|\([^()]*\))*\))", text)
    assert found, text
    return {found[1]: eval(found[2], {"Servo": Servo, "Kinematic": Kinematic})}


@pytest.mark.parametrize("bandwidth", [30.0, (30.0, 30.0, 60.0, 60.0)])
def test_lower_gains_of_the_kinematic_layer_are_advised_and_then_the_loop_holds(bandwidth):
    given = {"period": 0.4, "interfaces": EVERY, "servo": Servo(bandwidth=bandwidth)}
    with pytest.raises(ConfigError, match=r"kinematic: error: the sampled loop is unstable") as refused:
        Stepper(ROBOT, PD(), StepperSettings(**given))
    with Stepper(ROBOT, PD(), StepperSettings(**given, **advised(str(refused.value)))) as stepper:
        assert stepper.delay_margin() > 0.1 * 0.4


def test_a_law_that_answers_too_strongly_is_told_a_gain():
    given = {"period": 0.1, "interfaces": EVERY}
    with pytest.raises(ConfigError, match=r"servo\.gain: error: the sampled loop is unstable") as refused:
        Stepper(ROBOT, PD(), StepperSettings(servo=Servo(bandwidth=60.0, gain=2.0), **given))
    servo = msgspec.structs.replace(advised(str(refused.value))["servo"], bandwidth=60.0)
    Stepper(ROBOT, PD(), StepperSettings(servo=servo, **given)).__exit__(None, None, None)


def test_gains_that_do_not_bear_a_latency_before_servos_are_told_lower_ones():
    given = {"period": 0.02, "interfaces": EVERY, "latency": 0.3}
    with pytest.raises(ConfigError, match=r"does not bear a latency of 300 ms") as refused:
        Stepper(ROBOT, PD(), StepperSettings(**given))
    with Stepper(ROBOT, PD(), StepperSettings(**given, **advised(str(refused.value)))) as stepper:
        assert stepper.delay_margin() > 0.3


def test_a_servo_of_the_simulation_that_is_late_counts_like_a_latency():
    with pytest.raises(ConfigError, match=r"does not bear a latency of 300 ms"):
        replace(standing(1.0, 0.02, servo=Servo(delay=0.3)), check_gains=True).require_stable_gains()


def test_gains_on_effort_are_to_blame_where_other_servos_do_not_help():
    stiff = PD(Feedback(20.0, 3000.0))
    with pytest.raises(ConfigError, match="feedback: error: the sampled PD loop is unstable"):
        Stepper(ROBOT, stiff, StepperSettings(period=0.02, interfaces=WHEELS))


@needs_data
@pytest.mark.compiled
def test_tiago_at_50_hz_follows_by_velocity_with_servos_as_they_are():
    motors = ",".join(f'{name}="velocity"' for name in load("tiago").actuator_names)
    keys = ['robot="tiago"', 'controllers=["pd"]', f"interfaces={{{motors}}}", "time.control_period=0.02"]
    result = run_experiment(load_experiment("track", [*keys, "time.duration=4.0"]), "track")
    assert result.completed
    assert max(error.rms for error in result["pd"].errors(start=2.0).values()) < 0.05
    with pytest.raises(ConfigError, match="too high for servos") as refused:
        run_experiment(load_experiment("track", [*keys, "time.control_period=0.2"]), "track")
    found = shlex.split(str(refused.value).partition("lower them, ")[2].partition(", or shorten")[0])[1::2]
    assert len(found) == 4
    load_experiment("track", [*keys, "time.control_period=0.2", *found])
    experiment = load_experiment("track", [*keys, "time.control_period=0.2", *found])
    experiment.loop(experiment.load_robot(), "pd").require_stable_gains()


def test_a_comparison_in_python_is_told_its_own_key():
    path = Trajectory.of(ROBOT, base=Eight(3.0, 1.5, 20.0))
    every = {"interfaces": EVERY, "time.control_period": 0.4, "time.plant_step": 0.001}
    with pytest.raises(ConfigError, match="too high for servos") as refused:
        compare(ROBOT, path, ["pd"], duration=2.0, settings=every)
    found = re.search(r"settings=(\{.*?\})", str(refused.value))
    assert found
    assert compare(ROBOT, path, ["pd"], duration=2.0, settings=every | eval(found[1])).completed


# -- controllers that cannot run on them -------------------------------------------------------------------------------


def test_controllers_that_nobody_named_are_left_out_with_a_note():
    path = Trajectory.of(ROBOT, base=Eight(3.0, 1.5, 20.0))
    result = compare(ROBOT, path, duration=0.02, settings={"interfaces": EVERY, "kinematic": CALM})
    assert list(result) == ["pd_gravity", "two_layer"]
    assert [note for note in result.notes if note.startswith("pid, feedforward, learned left out")]
    result = compare(ROBOT, path, duration=0.02, settings={"interfaces": WHEELS})
    assert "driven wheel_left_joint, wheel_right_joint by velocity; all others by effort" in result.notes
    assert list(result) == ["pd_gravity", "pid", "feedforward", "two_layer", "learned"]
    with pytest.raises(ConfigError, match="time_delay on a velocity interface"):
        compare(ROBOT, path, ["pd", "time_delay"], duration=0.02, settings={"interfaces": WHEELS})
