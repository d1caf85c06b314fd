"""Torques that act through position servos of known stiffness: closed forms, the judged limit, what learners see."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from test_stepper import learner

from mmnn_pin import (
    PD,
    Feedback,
    Hold,
    Line,
    Loop,
    Measurement,
    Setpoint,
    Sine,
    Stepper,
    StepperSettings,
    Timing,
    Trajectory,
    load,
    load_experiment,
    run_experiment,
)
from mmnn_pin.errors import ConfigError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.sampled import verdicts
from mmnn_pin.loop.servo import Servo, hidden_torques, through_servos
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.reference.wishes import JointGoal
from mmnn_pin.safety import Safety
from mmnn_pin.torque.model_based import ComputedTorque

ARM, HOBBY = load("two_axis_arm"), load("so101")
PLACED = dict.fromkeys(ARM.actuator_names, "position")
STIFF = Servo(bandwidth=30.0, stiffness=(400.0, 250.0), damping=(12.0, 8.0))
H = 0.02


def made(controller, joints, duration=0.4, period=H, robot=ARM, **more):
    """A loop of an arm behind its servos."""
    timing = Timing(duration, period, 0.001, integrator="implicit_friction")
    given = {"kinematic": Kinematic(K=4.0), "timing": timing, "servo": STIFF} | more
    given |= {"interfaces": dict.fromkeys(robot.actuator_names, "position")}
    return Loop(robot, Trajectory(None, joints), controller, **given)


def swings():
    """A reference that moves both joints."""
    return tuple(Sine(0.3, 2.0, phase=0.5 * i) for i in range(ARM.dimensions.arm))


def test_what_is_sent_is_the_reference_and_the_torque_over_the_stiffness():
    loop = made(ComputedTorque(Feedback(arm=2.0)), swings(), nominal=ARM)
    run, setpoints = loop.run(), Setpoint.side_by_side(loop.table(), loop.layout)
    path = run["q"][0].copy()
    with Stepper.of(loop, safety=Safety()) as stepper:
        for k in range(len(run)):
            measured = Measurement(np.zeros(0), np.zeros(0), run["q"][k], run["qdot"][k])
            one = Setpoint(*(getattr(setpoints, f.name)[k] for f in fields(Setpoint)))
            command, split = stepper.step(k * H, measured, one), stepper.hardware.split
            path += H * split.command
            tau = 2.0 * run["r"][k] + run["psi_hat"][k]
            np.testing.assert_allclose(command.position, path + tau / np.array(STIFF.stiffness), atol=1e-9)
            late = run["q"][k] + 0.5 * H * run["qdot_ref"][k]
            gives = STIFF.stiffness * (command.position - late) - STIFF.damping * run["qdot_ref"][k]
            np.testing.assert_allclose(run["torque"][k], gives, atol=1e-7)
    assert np.abs(run["psi_hat"]).max() > 0.5


@pytest.mark.compiled
def test_weight_bends_a_servo_that_feedback_alone_commands_and_no_other():
    """Without any integral a servo stands g / Kp below its goal, and on it where the gravity is known."""
    servo, q = Servo(30.0, 0.0, 0.0, stiffness=30.0, damping=2.0), np.array([0.1, -0.3, 0.4, 0.2, 0.0])
    still = {"kinematic": Kinematic(K=1e-6), "servo": servo, "robot": HOBBY, "check_gains": False}
    joints = tuple(Hold(angle) for angle in q)
    bent, straight = (made(of(Feedback(arm=1e-3)), joints, 1.5, **still).run()["e"][-1] for of in (PD, ComputedTorque))
    position = HOBBY.neutral_position()
    position[HOBBY.arm_index] = q - bent
    np.testing.assert_allclose(bent, Dynamics(HOBBY).gravity(HOBBY.follow(position)) / 30.0, rtol=2e-3, atol=1e-5)
    np.testing.assert_allclose(straight, 0.0, atol=1e-3 * np.abs(bent).max())
    assert np.abs(bent).max() > 0.01


@pytest.mark.compiled
def test_feedback_through_servos_rings_above_the_judged_limit_and_not_below():
    """By the simulation, of which the linear loop knows nothing but its numbers."""

    def loop(gain):
        servo = Servo(30.0, 0.0, 0.0, stiffness=30.0, damping=4.0)
        given = {"servo": servo, "start": Start(joint_offset=1e-7), "check_gains": False}
        return made(PD(Feedback(arm=gain)), (Hold(0.0), Hold(0.0)), 80 * H, **given)

    low, high = 0.1, 1000.0
    for _ in range(25):
        middle = np.sqrt(low * high)
        radius = max(verdict.radius for verdict in verdicts(loop(middle).plan()))
        low, high = (middle, high) if radius <= 1.0 + 1e-9 else (low, middle)
    assert 0.2 < low < 900.0
    sizes = []
    for factor in (0.85, 1.15):
        size = np.linalg.norm(loop(factor * low).run()["r"], axis=1)
        sizes.append(size[60:].max() / size[20:40].max())
    assert sizes[0] < 1.0 < sizes[1], (low, sizes)


def test_torques_are_hidden_behind_servos_of_which_no_stiffness_is_known():
    kinds = ("position", "velocity")
    np.testing.assert_allclose(through_servos(ARM, kinds, STIFF)[:, 1], 0.0)
    np.testing.assert_allclose(through_servos(ARM, kinds, STIFF)[:2, 0], (1 / 400.0, 12.0))
    assert hidden_torques(ARM, PLACED, STIFF) is None and hidden_torques(ARM, {}, STIFF) is None
    assert hidden_torques(ARM, PLACED, Servo()).tolist() == [1, 1]
    assert hidden_torques(ARM, PLACED | {ARM.joint_names[1]: "velocity"}, STIFF).tolist() == [0, 1]


@given(st.integers(0, 10_000))
@settings(max_examples=15, phases=(Phase.explicit, Phase.generate))
def test_no_position_is_out_of_reach_whatever_is_measured(seed):
    rng, robot = np.random.default_rng(seed), HOBBY
    n = robot.dimensions.arm
    servo = Servo(stiffness=17.8, damping=0.55, stall=3.35)
    given = {"interfaces": dict.fromkeys(robot.actuator_names, "position"), "servo": servo, "period": H}
    lower, upper = robot.lower[robot.arm_index], robot.upper[robot.arm_index]
    q, sent = rng.uniform(lower, upper), None
    with Stepper(
        robot, ComputedTorque(Feedback(arm=rng.uniform(0.0, 2.0))), StepperSettings(check_gains=False, **given)
    ) as s:
        for k in range(10):
            goal = JointGoal(rng.uniform(lower, upper)) if k % 4 == 0 else None
            q = np.clip(q + rng.normal(0.0, 0.02, n), lower, upper)
            place = s.step(k * H, Measurement(np.zeros(0), np.zeros(0), q, rng.normal(0.0, 1.0, n)), goal).position
            assert (place >= lower - 1e-9).all() and (place <= upper + 1e-9).all()
            most = H * np.asarray(s.hardware.split.speed)
            assert sent is None or (np.abs(place - sent) <= most + 1e-9).all()
            sent = place.copy()


@pytest.mark.compiled
def test_learning_earns_through_servos_that_carry_a_load_nobody_knows():
    """Friction and 0.15 kg are in no model: the one that learns them errs least, and knows what the servos give."""
    said = ['hardware="feetech-sts3215"', 'robot="so101"', "time.duration=14.0", "plots=[]"]
    said += ['disturbances=[{type="payload", mass=0.15, start=0.0}]', 'controllers=["pd", "pd_gravity", "learned"]']
    runs = run_experiment(load_experiment("track", said), "track")
    late = {name: runs[name]["true_e"][len(runs[name]) // 2 :] for name in ("pd", "pd_gravity", "learned")}
    errors = {name: np.sqrt(np.mean(error**2)) for name, error in late.items()}
    assert errors["learned"] < 0.85 * errors["pd_gravity"] < 0.85**2 * errors["pd"], errors
    run = runs["learned"]
    wrong = run["applied"] - run["torque"]
    assert np.sqrt(np.mean(wrong**2)) < 0.2 * np.sqrt(np.mean(run["applied"] ** 2))


def test_learners_go_by_the_torques_that_servos_tell():
    """On a base by velocity `learned` takes the arm's equations alone; what needs those of all is refused."""
    robot, arm = load("platform_arm"), Servo(stiffness=30.0, damping=2.0)
    kinds = dict.fromkeys(robot.actuator_names[:2], "velocity") | dict.fromkeys(robot.actuator_names[2:], "position")

    def loop(name):
        given = {"interfaces": kinds, "servo": arm, "timing": Timing(0.2, H, 0.001), "check_gains": False}
        return Loop(robot, Trajectory(Line(0.3), swings()), learner(name), **given)

    with pytest.raises(ConfigError, match="kalman_regressor on a velocity interface"):
        loop("kalman_regressor").run()
    made = loop("learned")
    state, shapes = made.run().final["controller_state"], made.controller.init(made.context()).shapes
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes.values())])
    place = list(shapes).index("Phi_f")
    Phi_f = state[ends[place] : ends[place + 1]].reshape(shapes["Phi_f"])
    assert not Phi_f[:2].any() and Phi_f[2:].any()
