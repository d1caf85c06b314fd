"""The supervisor: each behaviour has one test with its name. Both engines are compared in test_hardware.py."""

from __future__ import annotations

import math

import numpy as np
import pytest
from builders import THESIS
from closed_form import inertial, joint
from numba import config
from robots import dynamics, mobile_arm, robot_of

from mmnn_pin import (
    PD,
    Feedback,
    Hold,
    Line,
    Loop,
    Neural,
    Recording,
    Sine,
    Timing,
    TorqueController,
    Trajectory,
    load,
    load_experiment,
    run_experiment,
)
from mmnn_pin.actuator import Actuator
from mmnn_pin.disturbance import BlockedJoint, CommandFault, Messages, Payload, Push
from mmnn_pin.errors import ConfigError
from mmnn_pin.loop.before_run import Start
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robot import speed_limits
from mmnn_pin.recording.recording import Outcome
from mmnn_pin.safety import RAMPING, RUNNING, STEPPED_IN, STOPPING, Safety
from mmnn_pin.sensing import Sensor
from mmnn_pin.signals import Layout
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.two_layer import TwoLayer

ROBOT = load("platform_arm")
H = 0.002
REACH = Trajectory(Line(0.3), (Sine(0.5, 2.0), Hold(0.4)))
SAFE = Safety(timeout=0.02, ramp=0.02, stop_time=0.05)


def loop_of(safety=SAFE, duration=0.1, robot=ROBOT, trajectory=REACH, controller=None, **more):
    more.setdefault("timing", Timing(duration))
    return Loop(
        robot, trajectory, controller or PD(Feedback(200.0, 3.0)), safety=safety, start=Start(moving=True), **more
    )


def run_of(*arguments, **more):
    return loop_of(*arguments, **more).run()


def states(run):
    return np.asarray(run["safety"]).reshape(-1)


def require_tripped(run, signal, time=None):
    """It tripped for this reason, told by how much, stopped from then on and ended after stop_time."""
    assert run.outcome.status == "tripped" and run.outcome.signal == signal, run.outcome
    assert time is None or run.outcome.time == pytest.approx(time, abs=1e-9)
    assert (
        f"tripped at t = {run.outcome.time:g} s" in run.outcome.message and "over its limit of" in run.outcome.message
    )
    after = run.time > run.outcome.time + 1e-9
    assert set(states(run)[after]) <= {STOPPING, RAMPING}
    assert not set(states(run)[run.time < run.outcome.time - 1e-9]) & {STOPPING, RAMPING}


class Given(TorqueController):
    """A torque that does not care."""

    def __init__(self, torque):
        self.torque = torque

    def step(self, time, reference, measurement, command, state):
        return np.array(self.torque(time), float)


def test_without_limits_a_supervisor_changes_nothing():
    with_it, without = run_of(Safety()), run_of(None)
    for name in without.names:
        np.testing.assert_array_equal(with_it[name], without[name], err_msg=name)
    assert "safety" not in without and not states(with_it).any()


# --- Torque -----------------------------------------------------------------------------------------------------------


def test_motor_torques_are_clipped():
    free = run_of(Safety())
    most = (0.3 * np.abs(free["motor_torque"]).max(axis=0)).tolist()
    run = run_of(Safety(torque=tuple(most), torque_time=9.0))
    np.testing.assert_array_less(np.abs(run["motor_torque"]), np.broadcast_to(most, run["motor_torque"].shape) + 1e-12)
    clipped = (np.abs(run["motor_torque"]) > np.array(most) - 1e-12).any(axis=1)
    assert clipped.any() and not clipped.all()
    np.testing.assert_array_equal(states(run), np.where(clipped, STEPPED_IN, RUNNING))
    np.testing.assert_allclose(run["torque"], run["motor_torque"] @ ROBOT.E.T, atol=1e-9)
    assert run.outcome.status == "completed"
    other = Safety(torque="urdf").supervisor(ROBOT, H, np.full(4, 1e3), np.ones(2))
    np.testing.assert_array_equal(other.torque, ROBOT.effort_limits)


def test_torque_that_is_asked_for_too_long_trips():
    run = run_of(
        Safety(torque=5.0, torque_time=0.01, stop_time=0.02), controller=Given(lambda t: [400.0 * (t > 0.03), 0, 0, 0])
    )
    require_tripped(run, "motor_torque[0]")
    assert 0.03 + 0.01 <= run.outcome.time <= 0.03 + 0.01 + 2 * H
    short = Given(lambda t: [400.0 * (0.03 < t < 0.038 or 0.05 < t < 0.058), 0, 0, 0])  # twice, but never for long
    assert run_of(Safety(torque=5.0, torque_time=0.01), controller=short).outcome.status == "completed"


def test_more_motors_than_velocities_keep_the_direction_of_the_force():
    from mmnn_pin.safety.supervisor import within

    E, limits = np.array([[1.0, 1.0, 1.0]]), np.array([2.0, 2.0, 2.0])
    tau = np.array([9.0])
    within(tau, E, np.linalg.pinv(E), limits)
    np.testing.assert_allclose(tau, 6.0)


# --- Motion -----------------------------------------------------------------------------------------------------------


def test_a_base_that_is_too_fast_trips():
    run = run_of(Safety(speed=0.35, stop_time=0.02), disturbances=(Push(on="v", force=3000.0, start=0.04),))
    require_tripped(run, "velocity[0]")
    k = int(np.argmax(run.time >= run.outcome.time - 1e-9))
    assert abs(run["velocity"][k, 0]) > 0.35 >= np.abs(run["velocity"][:k, 0]).max()
    assert f"speed of v {run['velocity'][k, 0]:.4g} m/s" in run.outcome.message


def test_a_base_that_turns_too_fast_trips():
    run = run_of(Safety(yaw_rate=0.2, stop_time=0.02), disturbances=(Push(on="w", force=300.0, start=0.04),))
    require_tripped(run, "velocity[1]")
    assert "speed of w" in run.outcome.message and "rad/s" in run.outcome.message


def test_a_joint_that_is_too_fast_trips():
    name = ROBOT.joint_names[1]
    run = run_of(Safety(joint_speed=(5.0, 0.5), stop_time=0.02), disturbances=(Push(on=name, force=30.0, start=0.04),))
    require_tripped(run, "qdot[1]")
    assert f"speed of {name}" in run.outcome.message
    robot = mobile_arm(2, 1)
    supervisor = Safety(joint_speed="urdf").supervisor(robot, H, np.full(4, 1e3), np.ones(2))
    np.testing.assert_array_equal(supervisor.speed, [np.inf, np.inf, *speed_limits(robot)[2:]])
    assert np.isfinite(supervisor.speed[2:]).all()


def test_a_base_that_is_too_far_away_trips():
    start = Start(pose_offset=(0.03, 0.04, 0.0))
    run = Loop(ROBOT, REACH, PD(THESIS), timing=Timing(0.1), safety=Safety(position_error=0.0499), start=start).run()
    require_tripped(run, "pose_error[0]", 0.0)
    assert "position error 0.05 m, 0.0001 m over its limit of 0.0499 m" in run.outcome.message
    near = Loop(ROBOT, REACH, PD(THESIS), timing=Timing(0.1), safety=Safety(position_error=0.08), start=start).run()
    assert near.outcome.status == "completed"


def test_a_base_that_looks_elsewhere_trips():
    start = Start(pose_offset=(0.0, 0.0, -0.3))
    run = Loop(ROBOT, REACH, PD(THESIS), timing=Timing(0.1), safety=Safety(heading_error=0.25), start=start).run()
    require_tripped(run, "pose_error[2]", 0.0)
    assert "heading error 0.3 rad, 0.05 rad over" in run.outcome.message


def test_a_joint_that_is_off_its_reference_trips():
    start = Start(joint_offset=(0.0, 0.2))
    run = Loop(ROBOT, REACH, PD(THESIS), timing=Timing(0.1), safety=Safety(joint_error=(0.1, 0.19)), start=start).run()
    require_tripped(run, "e[1]", 0.0)
    assert f"joint error of {ROBOT.joint_names[1]} 0.2 rad, 0.01 rad over" in run.outcome.message


# --- Weights ----------------------------------------------------------------------------------------------------------


class Told(TorqueController):
    """A feedback that holds the arm, and beside it a Psi_hat of one motor that is told, which is not sent."""

    def __init__(self, psi):
        self.psi = psi

    def step(self, time, reference, measurement, command, state):
        s = np.concatenate((command.z, command.r))
        return np.array([200.0, 50.0, 3.0, 1.0]) * s, np.array([0.0, 0.0, self.psi(time), 0.0])


def shaken_at(psi, duration=0.4, **own):
    """When a Psi_hat of the arm's first motor trips, and the run's outcome."""
    safety = Safety(shaking=0.1, timeout=0.02, ramp=0.02, stop_time=0.01, **own)
    run = run_of(safety, duration, controller=Told(psi))
    return (run.outcome.time if run.outcome.status == "tripped" else math.inf), run.outcome


def test_what_is_learned_trips_when_it_shakes_a_motor():
    """A ring of 40 Hz at half the limit: its square is A^2 / 2 of which a second's average has `1 - exp(-t)`."""
    A, limit, f = 100.0, 0.1 * 200.0, 40.0
    time, outcome = shaken_at(lambda t: A * math.sin(math.tau * f * t))
    a = 1.0 - math.exp(-math.tau * 10.0 * H)
    z = np.exp(2j * np.pi * f * H)
    passed = abs((1.0 - a) * (z - 1.0) / (z - 1.0 + a)) ** 2  # both high-passes
    expected = -math.log(1.0 - 2.0 * (limit / (A * passed)) ** 2)
    assert time == pytest.approx(expected, abs=0.5 / f + 0.02)
    assert outcome.signal == "motor_torque[2]"
    assert "what is learned shakes arm_1_joint" in outcome.message and "over its limit of 20 N m" in outcome.message


def test_what_is_learned_may_be_large_slow_and_begin_at_once():
    assert shaken_at(lambda t: 200.0 * math.cos(math.tau * t))[0] == math.inf  # 1 Hz, all of the limit
    assert shaken_at(lambda t: 0.0 if t < 0.2 else 150.0)[0] == math.inf  # a payload
    assert shaken_at(lambda t: 150.0)[0] == math.inf
    for pulse in (1500.0, 150.0):  # of two samples, of which the motor gets no more than it has
        assert shaken_at(lambda t, u=pulse: u if 0.2 <= t < 0.2 + 2 * H else 0.0, torque="urdf")[0] == math.inf
    assert shaken_at(lambda t: 12.0 * math.sin(math.tau * 40.0 * t), torque=(10.0, 10.0, 10.0, 10.0))[0] < 0.4


def test_on_a_robot_a_learner_that_shakes_trips_unless_it_is_told_not_to_and_a_model_never():
    from mmnn_pin import Stepper
    from mmnn_pin.torque.model_based import ComputedTorque

    learner, model = Neural(TwoLayer(), Feedback(200.0, 3.0), robust=None), ComputedTorque(Feedback(200.0, 3.0))
    told_not_to, most = Safety(shaking="none"), 0.15 * ROBOT.effort_limits
    for controller, given, shakes in (
        (learner, Safety(), True),
        (learner, told_not_to, False),
        (model, Safety(), False),
    ):
        with Stepper.of(loop_of(None, controller=controller), safety=given, check_gains=False) as stepper:
            shaken = stepper.hardware.way.supervisor.shaken
            assert np.allclose(shaken, most) if shakes else (shaken > 1e90).all()


def test_weights_are_projected_onto_their_bound_at_every_sample():
    controller = Neural(TwoLayer(), Feedback(200.0, 3.0), robust=None)
    free = run_of(Safety(), controller=controller, weights_interval=H)
    norms = {
        name: np.linalg.norm(values.reshape(len(values), -1), axis=1) for name, (_, values) in weights(free).items()
    }
    bound = float(0.9 * min(norm.max() for norm in norms.values()))
    run = run_of(Safety(weights=bound), controller=controller, weights_interval=H)
    for name, (times, values) in weights(run).items():
        norm = np.linalg.norm(values.reshape(len(values), -1), axis=1)[times > 0]
        assert norm.max() <= bound * (1 + 1e-12), name
        if norms[name].max() > 1.1 * bound:  # scaled back, in its direction
            assert norm.max() == pytest.approx(bound, rel=1e-9)
    assert STEPPED_IN in states(run) and run.outcome.status == "completed"


def weights(run):
    return {name: (run.weights["time"], np.array(values)) for name, values in run.weights.items() if name != "time"}


def test_weights_of_a_controller_in_python_are_bounded_where_it_keeps_a_memory():
    class Learner(TorqueController):
        def init(self, context):
            return ControllerState.of(W=(2, 3))

        def step(self, time, reference, measurement, command, state):
            state["W"] += 1.0
            return np.zeros(4)

        def weights(self, state):
            return {"W": state["W"]}

    class Hidden(Learner):
        def init(self, context):
            return {"W": np.zeros((2, 3))}

    loop = loop_of(Safety(weights=2.0), controller=Learner())
    state = loop.run().final["controller_state"]
    assert np.linalg.norm(state) == pytest.approx(2.0)
    with pytest.raises(ConfigError, match=r"safety\.weights.*cannot be bounded"):
        run_of(Safety(weights=2.0), controller=Hidden())


def test_weights_that_are_not_finite_trip():
    controller = Neural(TwoLayer(), Feedback(200.0, 3.0), robust=None)
    loop = loop_of(Safety(stop_time=0.01), controller=controller)
    state = loop.state_from()
    engine = loop.engine_at(state)
    engine.state["V1"][0, 0] = math.nan
    from mmnn_pin.recording.recorder import Recorder

    with Recorder(loop.layout, loop.facts(), None, False) as recorder:
        outcome = loop.stream(engine, recorder)
    assert outcome.status == "tripped" and outcome.signal.startswith("weights[")
    assert "weights are not finite" in outcome.message


# --- Messages ---------------------------------------------------------------------------------------------------------


def test_a_measurement_that_is_not_finite_is_refused():
    run = run_of(SAFE, disturbances=(Messages(fault="nan", start=0.04, end=0.05),))
    assert run.outcome.status == "completed" and "refused 5 measurements" in run.outcome.message
    bad = (run.time > 0.04 - 1e-9) & (run.time < 0.05 - 1e-9)
    last = int(np.argmax(bad)) - 1
    for name in ("pose", "velocity", "q", "qdot"):
        np.testing.assert_array_equal(run[name][bad], np.broadcast_to(run[name][last], run[name][bad].shape))
        assert np.isfinite(run[name]).all()
    np.testing.assert_array_equal(states(run), np.where(bad, STEPPED_IN, RUNNING))
    without = run_of(None, disturbances=(Messages(fault="nan", start=0.04, end=0.05),))
    assert without.outcome.status == "diverged" and without.outcome.time == pytest.approx(0.04)


def test_before_the_first_good_measurement_nothing_moves_and_nothing_is_judged():
    far = Trajectory(Line(0.3, start=(50.0, 0.0, 0.0)), (Sine(0.5, 2.0), Hold(0.4)))
    safety = Safety(position_error=1.0, timeout=0.05, ramp=0.0, stop_time=0.02)
    loop = Loop(
        ROBOT, far, PD(THESIS), timing=Timing(0.1), safety=safety, disturbances=(Messages(fault="nan", end=0.02),)
    )
    run = loop.run()
    early = run.time < 0.02 - 1e-9
    assert not run["torque"][early].any() and (states(run)[early] == STEPPED_IN).all()
    assert run.outcome.status == "completed" and run["torque"][~early].any()
    never = Loop(ROBOT, far, PD(THESIS), timing=Timing(0.1), safety=safety, disturbances=(Messages(fault="nan"),)).run()
    require_tripped(never, "measurement[0]")
    assert not never["torque"].any()


def test_a_command_that_is_not_finite_is_refused():
    for fault in (CommandFault(fault="nan", start=0.04, end=0.05), None):
        own = None if fault else Given(lambda t: [math.nan if 0.039 < t < 0.049 else 7.0, 0, 0, 0])
        run = run_of(SAFE, controller=own, disturbances=(fault,) if fault else ())
        assert run.outcome.status == "completed" and "refused 5 commands" in run.outcome.message
        bad = (run.time > 0.04 - 1e-9) & (run.time < 0.05 - 1e-9)
        last = int(np.argmax(bad)) - 1
        np.testing.assert_array_equal(run["torque"][bad], np.tile(run["torque"][last], (5, 1)))
        np.testing.assert_array_equal(states(run), np.where(bad, STEPPED_IN, RUNNING))
    assert run_of(None, disturbances=(CommandFault(fault="nan", start=0.04),)).outcome.status == "diverged"


def test_a_measurement_that_is_too_old_trips_and_the_torque_ramps_to_zero():
    run = run_of(SAFE, 0.12, disturbances=(Messages(fault="lost", start=0.04),))
    require_tripped(run, "measurement[0]", 0.038 + 0.02 + H)
    assert "age of the measurement 0.022 s, 0.002 s over its limit of 0.02 s" in run.outcome.message
    k = round(run.outcome.time / H)
    before = run["torque"][round(0.038 / H)]  # of the last measurement: what was made of it later is not gone on with
    share = np.clip(1 - (np.arange(len(run) - k) + 1) * H / (SAFE.ramp + H), 0, 1)
    np.testing.assert_allclose(run["torque"][k:, 2:], share[:, None] * before[2:], atol=1e-9)  # a straight line
    assert not run["torque"][k:, :2].any()  # it would drive the base on, and holds no weight
    assert np.abs(before).max() > 0.5 and not run["torque"][-5:].any()
    assert (states(run)[k:] == RAMPING).all()


def test_late_measurements_count_as_old():
    assert run_of(SAFE, sensor=Sensor(delay=9)).outcome.status == "completed"
    require_tripped(run_of(SAFE, sensor=Sensor(delay=11)), "measurement[0]")


def test_a_command_that_is_too_old_trips_and_fades_under_the_stop():
    run = run_of(SAFE, 0.2, disturbances=(CommandFault(fault="lost", start=0.04),))
    require_tripped(run, "command[0]", 0.038 + 0.02 + H)
    assert "age of the command 0.022 s, 0.002 s over its limit of 0.02 s" in run.outcome.message
    k = round(run.outcome.time / H)
    held = (run.time > 0.04 - 1e-9) & (np.arange(len(run)) < k)
    np.testing.assert_array_equal(run["torque"][held], np.tile(run["torque"][19], (held.sum(), 1)))
    feedback = -200.0 * run["velocity"]
    stale = np.clip(1 - (np.arange(len(run) - k) + 1) * H / (SAFE.ramp + H), 0, 1)[:, None] * run["torque"][19, :2]
    np.testing.assert_allclose(run["torque"][k:, :2], feedback[k:] + stale, atol=1e-9)
    assert (states(run)[k:] == STOPPING).all()
    short = run_of(SAFE, disturbances=(CommandFault(fault="lost", start=0.04, end=0.058),))
    assert short.outcome.status == "completed"


def test_measurements_that_come_back_hold_the_arm_where_it_is_then():
    """The arm has moved on while the torque ramped down; it is not pulled back."""
    safety = Safety(timeout=0.02, ramp=0.0, stop_time=1.0)
    lost = Messages(fault="lost", start=0.04, end=0.16)
    run = run_of(safety, 0.24, disturbances=(lost, Push(on=ROBOT.joint_names[0], force=4.0, start=0.06, end=0.16)))
    require_tripped(run, "measurement[0]")
    back = round(0.16 / H)
    assert states(run)[back] == STOPPING and states(run)[back - 1] == RAMPING
    moved = abs(run["position"][back, ROBOT.arm_index[0]] - run["q"][int(run.outcome.time / H), 0])
    assert moved > 0.05
    np.testing.assert_allclose(run["torque"][back, 2:], -3.0 * run["qdot"][back], atol=1e-9)  # brakes, pulls nowhere


def test_measurements_that_come_back_during_a_stop_hold_the_arm_where_it_is_then():
    """Stopped for another reason, deaf for a while, and pushed meanwhile."""
    events = (
        Push(on="w", force=300.0, start=0.02, end=0.06),
        Messages(fault="lost", start=0.08, end=0.16),
        Push(on=ROBOT.joint_names[0], force=4.0, start=0.08, end=0.16),
    )
    run = run_of(Safety(yaw_rate=0.2, ramp=0.0), 0.24, disturbances=events)
    require_tripped(run, "velocity[1]")
    k, back = round(0.07 / H), round(0.16 / H)
    assert states(run)[k] == STOPPING and states(run)[back - 1] == RAMPING and states(run)[back] == STOPPING
    assert abs(run["q"][back, 0] - run["q"][k, 0]) > 0.02
    np.testing.assert_allclose(run["torque"][back, 2:], -3.0 * run["qdot"][back], atol=1e-9)


# --- The stop ---------------------------------------------------------------------------------------------------------


def heavy_arm():
    """Two joints against gravity, 9.81 m/s^2 along -z: horizontal axes, links of 3 and 2 kg."""
    text = '<robot name="heavy"><link name="base"/>'
    for i, (parent, mass, at) in enumerate((("base", 3.0, "0 0 1"), ("link_0", 2.0, "0.4 0 0"))):
        centre = '<origin xyz="0.2 0 0" rpy="0 0 0"/>'
        text += f'<link name="link_{i}">{inertial(mass, (0.05, 0.05, 0.05), centre)}</link>'
        limit = '<limit lower="-9" upper="9" effort="99" velocity="9"/>'
        place = f'<origin xyz="{at}" rpy="0 0 0"/>'
        text += joint(f"joint_{i}", parent, f"link_{i}", place, "0 1 0", dynamics(0.1, 0.0) + limit, "revolute")
    return robot_of(text + "</robot>")


@pytest.mark.skipif(config.DISABLE_JIT, reason="seconds of simulated time")
def test_a_stop_holds_the_arm_against_gravity():
    robot = heavy_arm()
    gravity = Dynamics(robot).gravity(np.array([0.0, 0.0]))
    assert np.abs(gravity).min() > 3.0
    safety = Safety(joint_speed=1.0, stop_time=8.0, hold_rate=2.0)
    pushed = Push(on="joint_0", force=60.0, start=0.5, end=0.6)
    arguments = {"controller": PD(Feedback(arm=(40.0, 20.0))), "disturbances": (pushed,), "timing": Timing(9.0)}
    run = run_of(safety, robot=robot, trajectory=Trajectory(None, (Hold(0.0), Hold(0.0))), **arguments)
    require_tripped(run, "qdot[0]")
    k = round(run.outcome.time / H)
    np.testing.assert_allclose(run["q"][-1], run["q"][k], atol=2e-3)  # where it was, though it hangs
    assert np.abs(run["qdot"][-1]).max() < 1e-3
    np.testing.assert_allclose(run["torque"][-1], Dynamics(robot).gravity(run["q"][-1]), rtol=2e-2)
    assert run.time[-1] == pytest.approx(run.outcome.time + 8.0, abs=1e-9)


@pytest.mark.compiled
def test_a_stop_brakes_the_base():
    pushed = Push(on="w", force=300.0, start=0.02, end=0.08)
    run = run_of(Safety(yaw_rate=0.2, stop_time=1.0), 1.5, controller=PD(THESIS), disturbances=(pushed,))
    require_tripped(run, "velocity[1]")
    k = round(run.outcome.time / H)
    assert abs(run["nu"][k, 0]) > 0.2 and np.abs(run["nu"][-1]).max() < 0.05 * np.abs(run["nu"][k]).max()
    speed = np.hypot(*run["velocity"][int(0.1 / H) :].T)
    assert (np.diff(speed) < 1e-6).all()


def test_a_stop_after_a_holonomic_base_was_too_fast_counts_both_directions():
    from mmnn_pin.safety import new_state, no_supervisor
    from mmnn_pin.safety.supervisor import SupervisorNumbers, check_motion
    from mmnn_pin.signals import INDEX

    layout = Layout(3, 0, 3, 3, "holonomic", True, hardware=1)
    row, at = layout.new_row(), layout.offsets
    supervisor = no_supervisor(layout, new_state(layout))._replace(
        numbers=SupervisorNumbers(*[np.inf] * len(SupervisorNumbers._fields))
    )
    row[at[INDEX["velocity"]] : at[INDEX["velocity"]] + 3] = 0.3, 0.4, 0.0
    for limit, tripped in ((0.51, 0.0), (0.49, 1.0)):
        check_motion(row, at, 0.0, supervisor._replace(speed=np.array([limit, limit, np.inf])))
        assert supervisor.state.tripped[0] == tripped


@pytest.mark.compiled
def test_a_stop_works_under_a_controller_whose_gains_are_not_known():
    controller = Given(lambda t: [50.0, 0.0, 1.0, 0.0])
    run = run_of(Safety(speed=0.32, stop_time=1.0), 1.2, controller=controller)
    require_tripped(run, "velocity[0]")
    k = round(run.outcome.time / H)
    assert np.abs(run["nu"][-1]).max() < 0.05 * np.abs(run["nu"][k]).max()


@pytest.mark.compiled
def test_a_stop_that_does_not_bring_the_robot_to_rest_shorts_the_windings():
    """Somebody keeps pushing: after `settle` the torque ramps to zero and only the windings brake, where they do."""
    pushed = Push(on="w", force=300.0, start=0.02)
    safety = Safety(yaw_rate=0.2, settle=0.1, rest=0.05, ramp=0.02, stop_time=0.3)
    run = run_of(safety, 0.5, disturbances=(pushed,), actuator=Actuator(brake=(0.0, 0.0, 1.0, 1.0)))
    require_tripped(run, "velocity[1]")
    gave_up = run.time > run.outcome.time + 0.1 + 1e-9
    assert (states(run)[gave_up] == RAMPING).all() and not run["torque"][-1].any()
    assert (states(run)[(run.time > run.outcome.time - 1e-9) & ~gave_up] == STOPPING).all()
    np.testing.assert_array_equal(run["applied"][-1, :2], 0.0)
    middle = 0.5 * (run["nu"][-2:-1, 2:] + run["nu"][-1:, 2:])
    np.testing.assert_allclose(run["applied"][-2:-1, 2:], -middle, rtol=0.05)
    without = run_of(safety, 0.5, disturbances=(pushed,))  # there is nothing but feedback
    assert (states(without)[without.time > without.outcome.time - 1e-9] == STOPPING).all()
    assert abs(without["nu"][-1, 1]) < abs(run["nu"][-1, 1])


@pytest.mark.compiled
def test_shorted_windings_brake_the_base_at_once_and_the_arm_is_held():
    """Where the drive motors have a brake, the base needs no feedback: `applied` is -brake times the wheels' speed."""
    pushed = Push(on="w", force=300.0, start=0.02, end=0.08)
    actuator = Actuator(brake=(20.0, 20.0, 0.0, 0.0))
    run = run_of(
        Safety(yaw_rate=0.2, stop_time=0.5), 0.7, controller=PD(THESIS), disturbances=(pushed,), actuator=actuator
    )
    require_tripped(run, "velocity[1]")
    k = round(run.outcome.time / H)
    assert not run["torque"][k:, :2].any() and run["torque"][k:, 2:].any() and (states(run)[k:] == STOPPING).all()
    wheels = run["nu"] @ ROBOT.E[:, :2]
    middle = 0.5 * (wheels[k:-1] + wheels[k + 1 :])
    np.testing.assert_allclose(run["applied"][k:-1, :2], -20.0 * middle, atol=0.05 * 20.0 * np.abs(middle).max())
    assert np.abs(run["nu"][-1, :2]).max() < 0.1 * np.abs(run["nu"][k:, :2]).max()


def test_a_slow_sensor_is_no_reason_to_stop_blindly():
    """Measurements every 20 ms, control every 2 ms: between two of them the stop keeps its feedback."""
    pushed = Push(on="w", force=300.0, start=0.02, end=0.08)
    timing = Timing(0.4, H, 0.001, 0.02)
    weak = PD(Feedback(100.0, 1.0))
    run = run_of(Safety(yaw_rate=0.2, stop_time=0.1), controller=weak, disturbances=(pushed,), timing=timing)
    require_tripped(run, "velocity[1]")
    assert (states(run)[round(run.outcome.time / H) :] == STOPPING).all()


def test_a_stop_keeps_the_motors_within_their_torque():
    run = run_of(Safety(yaw_rate=0.2, torque=1.0, torque_time=9.0, stop_time=0.1), 0.3,
                 disturbances=(Push(on="w", force=300.0, start=0.02, end=0.08),))  # fmt: skip
    require_tripped(run, "velocity[1]")
    assert np.abs(run["motor_torque"]).max() <= 1.0 + 1e-12


def test_nobody_learns_after_a_trip():
    controller = Neural(TwoLayer(), Feedback(200.0, 3.0), robust=None)
    loop = loop_of(Safety(yaw_rate=0.2, stop_time=0.1), 0.3, controller=controller, weights_interval=H,
                   disturbances=(Push(on="w", force=300.0, start=0.02, end=0.08),))  # fmt: skip
    run = loop.run()
    require_tripped(run, "velocity[1]")
    times, values = run.weights["time"], np.array(run.weights["V1"])
    after = values[times > run.outcome.time + H]
    assert len(after) > 20 and (after == after[0]).all() and (values[0] != after[0]).any()
    assert not run["psi_hat"][run.time > run.outcome.time + 1e-9].any()


# --- What is left -----------------------------------------------------------------------------------------------------


def test_a_trip_leaves_its_last_samples_and_its_config_in_the_recording(tmp_path):
    settings = [
        "time.duration=1.2",
        "time.control_period=0.005",
        "time.plant_step=0.005",
        "safety.speed=1.2",
        "safety.stop_time=0.02",
        "windows=[]",
    ]
    push = 'disturbances=[{type="push", on="v", force=9000, start=0.8}]'
    experiment = load_experiment("chapter4", [*settings, push, "controllers=['pd']"])
    result = run_experiment(experiment, "trip", out=tmp_path)
    run = Recording.open(tmp_path / "pd.h5")
    assert not result.completed and isinstance(run.outcome, Outcome)
    require_tripped(run, "velocity[0]")
    before = run.time < run.outcome.time + 1e-9
    assert before.sum() >= 100 and run.time[-1] == pytest.approx(run.outcome.time + 0.02)
    assert all(np.isfinite(run[name]).all() for name in run.names)
    assert run.meta["safety"]["speed"] == 1.2 and "disturbances" in run.config_text


def test_a_run_that_ends_while_it_stops_has_tripped():
    run = run_of(Safety(yaw_rate=0.2, stop_time=9.0), 0.1, disturbances=(Push(on="w", force=300.0, start=0.02),))
    require_tripped(run, "velocity[1]")
    assert len(run) == 50


def test_a_run_that_diverges_while_it_stops_tells_both():
    from mmnn_pin.loop.before_run import Bounds

    run = run_of(Safety(yaw_rate=0.2, stop_time=9.0), 0.3, bounds=Bounds(yaw_rate=0.5),
                 disturbances=(Push(on="w", force=3000.0, start=0.02),))  # fmt: skip
    assert run.outcome.status == "diverged" and "tripped at t = " in run.outcome.message


def test_the_worst_day_of_all_ends_in_a_stop():
    """Everything at once, with noise and motors; nothing is not finite."""
    events = (
        Messages(fault="nan", start=0.02, end=0.03),
        CommandFault(fault="lost", start=0.04, end=0.05),
        Payload(mass=3.0, start=0.05),
        Push(on="v", force=200.0, shape="noise"),
        BlockedJoint(joint=ROBOT.base.wheels[0].joint, start=0.06),
    )
    safety = Safety(torque="urdf", position_error=0.003, timeout=0.02, stop_time=0.02)
    run = run_of(safety, 0.4, disturbances=events, sensor=Sensor(noise=1e-4, velocity="filtered", wheel_noise=1e-4),
                 actuator=Actuator(lag=0.005), timing=Timing(0.4, integrator="stick"))  # fmt: skip
    require_tripped(run, "pose_error[0]")
    assert all(np.isfinite(run[name]).all() for name in run.names)


# --- Bad input --------------------------------------------------------------------------------------------------------

NAMES = ("torque", "speed", "yaw_rate", "joint_speed", "position_error", "heading_error", "joint_error", "weights")


@pytest.mark.parametrize("name", [*NAMES, "timeout", "rest"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_a_limit_is_a_finite_number_above_zero(name, value):
    with pytest.raises(ConfigError, match=rf"safety\.{name}"):
        Safety(**{name: value})


@pytest.mark.parametrize("name", ["torque_time", "ramp", "stop_time", "settle", "hold_rate"])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_a_time_is_a_finite_number(name, value):
    Safety(**{name: 0.0})
    with pytest.raises(ConfigError, match=rf"safety\.{name}"):
        Safety(**{name: value})


SIZES = [("torque", "4 motors"), ("joint_speed", "2 joints"), ("joint_error", "2 joints")]


@pytest.mark.parametrize(("name", "of"), SIZES)
def test_limits_that_do_not_fit_the_robot_are_refused(name, of):
    with pytest.raises(ConfigError, match=rf"safety\.{name}.*3 numbers for {of}"):
        run_of(Safety(**{name: (1.0, 1.0, 1.0)}))


@pytest.mark.parametrize("gain", [2.0, 10.0, 1000.0])
def test_the_integral_of_a_stop_never_swings_the_arm(gain):
    """Routh: M s^3 + g s^2 + g K s + g K rate is stable for g > rate M."""
    robot = heavy_arm()
    inertia = Dynamics(robot).mass_matrix(np.zeros(2))[0, 0]
    assert np.roots([inertia, gain, 3.0 * gain, 3.0 * gain * 1.1 * gain / inertia]).real.max() > 0
    rate = Safety(hold_rate=20.0).supervisor(robot, H, np.full(2, gain), np.full(2, 3.0)).numbers.hold_rate
    assert np.roots([inertia, gain, 3.0 * gain, 3.0 * gain * rate]).real.max() < 0
    assert rate == pytest.approx(min(20.0, 0.5 * gain / inertia))
