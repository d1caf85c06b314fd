"""Simulated servos against MuJoCo's position actuators, closed forms and data sheets; light joints do not chatter."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from mmnn_pin import load
from mmnn_pin.actuator import STATES, Actuator, motor_state, new_drive
from mmnn_pin.loop.hardware import pass_through
from mmnn_pin.loop.servo import Servo, interfaces_of, split_of
from mmnn_pin.loop.servo_model import GOAL, ROWS, servo_slots, servos_of
from mmnn_pin.model.robots import robot_data
from mmnn_pin.plant.contact.feet import Contact, feet_of
from mmnn_pin.plant.contact.plant import ContactPlant
from mmnn_pin.plant.contact.tree import compile_tree
from mmnn_pin.plant.ideal import IdealPlant

needs_data = pytest.mark.skipif(robot_data() is None, reason="example-robot-data is not installed")
TURNTABLE = """<robot name="turntable"><link name="stand"/>
<link name="table"><inertial><mass value="1"/><inertia ixx="{0}" iyy="{0}" izz="{0}" ixy="0" ixz="0" iyz="0"/>
</inertial></link>
<joint name="turn" type="continuous"><parent link="stand"/><child link="table"/><axis xyz="0 0 1"/>
<limit effort="1000" velocity="100"/><dynamics damping="{1}" friction="{2}"/></joint></robot>"""
FEETECH = Servo(stiffness=17.8, damping=0.549, stall=3.35)  # STS3215 at 7.4 V, identified by BAM: kt 1.21, R 2.68
RUBS, ROTOR = 0.059, 0.0284  # N m s/rad, kg m^2, likewise
H = 1e-3


def turntable(tmp_path, inertia=0.01, damping=0.0, friction=0.0):
    file = tmp_path / "turntable.urdf"
    file.write_text(TURNTABLE.format(inertia, damping, friction))
    return load(file)


def stepped(robot, servo, goal, duration, dt=H, plant="ideal", actuator=Actuator()):  # noqa: B008 (frozen)
    """Positions, speeds and torques of an arm whose servos are sent a goal at rest, (steps, 3, n)."""
    d, kinds = robot.dimensions, interfaces_of(robot, dict.fromkeys(robot.actuator_names, "position"))[0]
    split = split_of(robot, kinds, servo, 0.02, np.zeros(2 * d.dof + 2 * d.arm + 3))
    memory = motor_state(np.zeros((d.motors, STATES))), np.zeros((servo_slots(servo, 0.0, dt), d.motors))
    motors = actuator.motors(robot, dt, states=memory[0])
    effects = servos_of(robot, kinds, servo, actuator, split, memory, dt), *motors.effects
    kind = {"ideal": IdealPlant, "contact": ContactPlant}[plant]
    body, wire, E, found = kind(robot, dt, "implicit_friction"), new_drive(d.motors), np.ascontiguousarray(robot.E), []
    body.start(robot.neutral_position(), np.zeros(d.dof))
    for k in range(round(duration / dt)):
        split.place[:] = goal(k * dt) if callable(goal) else goal
        body.motor_speeds(wire.joint)
        wire.angle[:] = body.position[robot.arm_index]
        body.respond(np.zeros(d.dof), E, wire.free, wire.answer)
        pass_through(effects, wire, 0, k * dt)
        body.step(E @ wire.torque)
        body.refresh()
        found.append((body.position[robot.arm_index], body.nu.copy(), wire.torque.copy()))
    return np.array(found), memory[1]


def by_mujoco(robot, servo, limit, goal, duration, dt=1e-4):
    """The same joints under MuJoCo's position actuators, implicit in their damping."""
    mujoco = pytest.importorskip("mujoco")
    model = compile_tree(robot, feet_of(robot), Contact(), dt)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.dof_damping[:] = robot.damping[robot.arm_index] + robot.viscous
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1] = servo.stiffness, -np.asarray(servo.stiffness)
    model.actuator_biasprm[:, 2], model.actuator_biastype[:] = -np.asarray(servo.damping), mujoco.mjtBias.mjBIAS_AFFINE
    model.actuator_forcelimited[:], model.actuator_forcerange[:] = 1, (-limit, limit)
    data, found = mujoco.MjData(model), []
    data.qpos[:], data.ctrl[:] = robot.neutral_position()[robot.arm_index], goal
    for _ in range(round(duration / dt)):
        mujoco.mj_step(model, data)
        found.append(data.qpos.copy())
    return np.array(found)


@needs_data
@pytest.mark.compiled
@pytest.mark.parametrize("rotor", [ROTOR, 0.0])
def test_position_servos_move_an_arm_as_mujocos_position_actuators_do(rotor):
    robot = load("so101").with_armature(rotor).with_friction((RUBS,) * 5)
    servo, goal = Servo(stiffness=17.8, damping=0.549), np.array([0.3, -0.4, 0.5, -0.3, 0.6])
    truth, motors = by_mujoco(robot, servo, 1.91, goal, 0.6), Actuator(torque_limit=1.91)
    errors = []
    for dt in (1e-3, 5e-4):
        run, _ = stepped(robot, servo, goal, 0.6, dt, actuator=motors)
        errors.append(np.abs(run[:, 0] - truth[round(dt / 1e-4) - 1 :: round(dt / 1e-4)]).max())
    assert np.abs(run[:, 2]).max() == 1.91  # they saturate on the way
    assert errors[0] < 0.009 and errors[1] < 0.6 * errors[0]  # of first order in the step


@needs_data
@pytest.mark.compiled
@pytest.mark.parametrize("plant", ["ideal", "contact"])
@pytest.mark.parametrize("name", ["panda", "so100", "kinova", "baxter"])
def test_light_joints_under_stiff_servos_do_not_chatter_at_a_millisecond(name, plant):
    """A link of grams would ask for steps of microseconds by torques of the start of a step."""
    robot = load(name)
    goal = robot.neutral_position()[robot.arm_index] + 0.1
    run, _ = stepped(robot, Servo(stiffness=2000.0, damping=100.0), goal, 0.5, plant=plant)
    torque = run[-100:, 2]
    # a chattering torque jumps between its limits; a settling one turns at most once
    jumps = np.abs(np.diff(torque, 2, axis=0)).max(axis=0)
    assert (jumps < 1e-3 * np.minimum(robot.effort_limits, 100.0)).all()
    assert np.isfinite(run).all() and np.abs(run[:, 1]).max() < 100.0


@settings(deadline=None, max_examples=6, phases=(Phase.generate,))
@given(st.floats(0.003, 0.1), st.floats(5.0, 60.0), st.floats(0.2, 1.5), st.sampled_from([0.0, 40.0]))
def test_a_pid_servo_steps_as_its_differential_equation_says(tmp_path_factory, inertia, kp, kd, ki):
    robot = turntable(tmp_path_factory.mktemp("servo"), inertia)
    whole, half = (stepped(robot, Servo(stiffness=kp, damping=kd, integral=ki), 0.5, 0.3, dt)[0] for dt in (1e-3, 5e-4))

    def rate(_, y):
        q, w, integral = y
        return [w, (kp * (0.5 - q) + ki * integral - kd * w) / inertia, 0.5 - q]

    truth = solve_ivp(rate, (0.0, 0.3), np.zeros(3), "DOP853", 1e-3 * np.arange(1, 301), rtol=1e-10, atol=1e-12)
    # of first order in the step: twice the half step less the whole one leaves what is of second order
    np.testing.assert_allclose(2.0 * half[1::2, 0, 0] - whole[:, 0, 0], truth.y[0], atol=6e-3)


def test_a_feetech_turns_as_fast_as_its_data_sheet_says_and_gives_way_to_a_weight_as_measured(tmp_path):
    """STS3215: 0.192 s per 60 degrees at 7.4 V; 1.5 kg at 0.1 m and 45 degrees move it by 20 to 30 of 4096 steps."""
    robot = turntable(tmp_path, ROTOR, RUBS, 0.0524)
    run, _ = stepped(robot, FEETECH, 50.0, 0.6)
    assert run[-1, 1, 0] == pytest.approx(math.radians(60.0) / 0.192, rel=0.01)
    load_torque = 1.5 * 9.81 * 0.1 * math.sin(math.radians(45.0))
    stiffness = 17.8 * 32 / 16  # as it comes from its maker; LeRobot halves its P gain
    steps = load_torque / stiffness * 4096 / math.tau
    assert 18 < steps < 30


def test_a_dead_band_a_profile_and_a_period_of_its_own(tmp_path):
    robot = turntable(tmp_path)
    within, _ = stepped(robot, Servo(stiffness=20.0, damping=0.5, dead_band=0.1), 0.09, 0.2)
    assert not within.any()
    beyond, _ = stepped(robot, Servo(stiffness=20.0, damping=1.0, dead_band=0.1), 0.5, 2.0)
    assert 0.39 < beyond[-1, 0, 0] < 0.5 and abs(beyond[-1, 2, 0]) < 1e-6
    # a trapezoid: 0.5 m/s^2 up to 0.2 rad/s, 0.4 rad take 0.4 / 0.2 + 0.2 / 0.5 = 2.4 s
    profiled = Servo(stiffness=200.0, damping=2.0, profile_speed=0.2, profile_acceleration=0.5)
    goals = [stepped(robot, profiled, 0.4, t)[1][GOAL - ROWS, 0] for t in (0.4, 1.4, 2.41)]
    assert goals == pytest.approx([0.04, 0.24, 0.4], abs=1e-3)
    # a servo that samples every 20 ms holds its torque, but for what its speed brakes
    slow, _ = stepped(robot, Servo(stiffness=2.0, period=0.02), 0.5, 0.1)
    assert len(np.unique(slow[:, 2, 0].round(12))) == 5
    held = slow[:20, 2, 0]
    assert held == pytest.approx(1.0) and slow[19, 0, 0] == pytest.approx(0.5 * 1.0 / 0.01 * 0.02**2, rel=0.06)


@pytest.mark.parametrize(("lag", "gap"), [(0.01, 0.0), (0.0, 0.002)])
def test_lag_and_backlash_are_part_of_what_a_stiff_servo_solves(tmp_path, lag, gap):
    """With torques of the start of a step both would fly: `dt Kd / rotor` is 10."""
    robot = turntable(tmp_path, 1e-3)
    motors = Actuator(lag=lag, gap=gap, rotor_inertia=1e-4 if gap else 0.0)
    run, _ = stepped(robot, Servo(stiffness=10.0, damping=1.0), lambda t: min(t, 0.3), 0.8, actuator=motors)
    assert np.isfinite(run).all() and np.abs(run[:, 1]).max() < 20.0
    assert run[-1, 0, 0] == pytest.approx(0.3, abs=max(gap, 1e-3))
