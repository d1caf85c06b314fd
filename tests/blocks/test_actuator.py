"""Motors: every imperfection with and without, against closed forms, circuit equations and a two-mass integration.

Friction of gears that sticks is tested in test_stick.py, friction in a URDF's `<dynamics>` in test_plant.py and
test_dynamics.py; both engines are compared in test_hardware.py.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from closed_form import inertial, joint
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config
from robots import dynamics, fixed_arm, robot_of
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from mmnn_pin import PD, Feedback, Hold, Loop, Sine, Timing, TorqueController, Trajectory, load
from mmnn_pin import actuator as motor
from mmnn_pin.actuator import NEVER, Actuator, Backlash, new_drive
from mmnn_pin.errors import ConfigError
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.hardware import pass_through
from mmnn_pin.sensing import Sensor

ARM = fixed_arm(2, 1)  # its URDF says 99 N m or N and 9 rad/s or m/s
PLATFORM = load("platform_arm")
DT = 0.001
patient = settings(max_examples=10 if config.DISABLE_JIT else 60, deadline=None)


def driven(actuator, commands, speeds=0.0, robot=ARM, dt=DT, dead=0.0, shorted=0):
    """What motors give under commands (N,) or (N, m) at speeds (N,) or (N, m): torques (N, m), last states."""
    count = robot.dimensions.motors
    windows = np.array([(i, 0.0, math.inf) for i in range(count)]) if dead else NEVER
    motors = actuator.motors(robot, dt, windows)
    commands, speeds = (per_motor(values, len(commands), count) for values in (commands, speeds))
    return np.array([step(motors, u, w, shorted) for u, w in zip(commands, speeds, strict=True)]), motors.states


def step(motors, command, speed, shorted=0):
    """One step of the plant: what the joints get."""
    motors.wire.torque[:], motors.wire.joint[:], motors.wire.shorted[:] = command, speed, shorted
    pass_through(motors.effects, motors.wire, 0, 0.0)
    return motors.wire.torque.copy()


def per_motor(values, samples, motors):
    values = np.asarray(values, float)
    values = values[:, None] if values.ndim == 1 else values
    return np.ascontiguousarray(np.broadcast_to(values, (samples, motors)))


def column(run, name):
    return np.asarray(run[name]).reshape(len(run), -1)[:, 0]


def test_perfect_motors_give_what_is_asked_for():
    commands = np.random.default_rng(0).normal(0, 50, (20, 2))
    np.testing.assert_array_equal(driven(Actuator(), commands)[0], commands)
    assert Actuator().perfect and not Actuator(lag=0.01).perfect


def test_torques_are_limited_by_given_numbers_or_the_urdf():
    commands = np.array([[500.0, -500.0], [3.0, -4.0]])
    np.testing.assert_array_equal(driven(Actuator(torque_limit=(5.0, 7.0)), commands)[0], [[5, -7], [3, -4]])
    np.testing.assert_array_equal(driven(Actuator(torque_limit="urdf"), commands)[0], [[99, -99], [3, -4]])


def test_a_torque_constant_that_the_drive_does_not_know_scales_the_torque():
    np.testing.assert_allclose(driven(Actuator(torque_gain=(0.8, 1.1)), [10.0])[0], [[8.0, 11.0]])


@patient
@given(st.floats(1e-4, 0.5), st.floats(-20, 20), st.sampled_from([1e-3, 2.5e-4]))
def test_the_current_loop_is_the_closed_form_of_a_first_order_lag(lag, u, dt):
    torque = driven(Actuator(lag=lag), np.full(50, u), dt=dt)[0][:, 0]
    times = dt * np.arange(1, 51)
    np.testing.assert_allclose(torque, u * (1 - np.exp(-times / lag)), rtol=1e-9, atol=1e-12)
    assert (driven(Actuator(), np.full(3, u), dt=dt)[0] == u).all()


def test_beyond_its_speed_a_motor_brakes_but_does_not_drive():
    actuator, speeds = Actuator(speed_limit=2.0), np.array([1.9, 2.1, 2.1, -2.1, -2.1])
    torque = driven(actuator, [5.0, 5.0, -5.0, 5.0, -5.0], speeds)[0][:, 0]
    np.testing.assert_array_equal(torque, [5.0, 0.0, -5.0, 5.0, 0.0])
    assert (driven(Actuator(speed_limit="urdf"), [5.0, 5.0], np.array([8.9, 9.1]))[0] == [[5, 5], [0, 0]]).all()


def test_a_dead_motor_gives_nothing():
    assert not driven(Actuator(), np.full(5, 9.0), dead=1.0)[0].any()


def test_shorted_windings_brake_those_that_are_shorted():
    speeds = np.array([[2.0, -3.0]])
    torque = driven(Actuator(brake=(4.0, 5.0)), [[0.0, 0.0]], speeds, shorted=1)[0]
    np.testing.assert_array_equal(torque, [[-8.0, 0.0]])
    np.testing.assert_array_equal(driven(Actuator(brake=4.0), [[0.0, 0.0]], speeds, shorted=2)[0], [[-8.0, 12.0]])
    assert not driven(Actuator(brake=4.0), [[0.0, 0.0]], speeds)[0].any()


# --- The supply -------------------------------------------------------------------------------------------------------

MOTOR = {"voltage": 24.0, "torque_constant": 0.4, "resistance": 0.5}


@patient
@given(st.floats(-60, 60), st.floats(-80, 80))
def test_a_dc_motor_gives_the_torque_of_its_circuit(u, w):
    """The drive asks for V = R I + kt w and gets it within the supply; then kt I flows."""
    volts = np.clip(0.5 * u / 0.4 + 0.4 * w, -24.0, 24.0)
    current = (volts - 0.4 * w) / 0.5
    torque = driven(Actuator(**MOTOR), [u], np.array([w]))[0][0, 0]
    assert torque == pytest.approx(0.4 * current, rel=1e-9, abs=1e-9)
    if abs(0.5 * u / 0.4 + 0.4 * w) < 24.0:
        assert torque == pytest.approx(u, rel=1e-9, abs=1e-9)


def test_a_free_motor_runs_up_to_the_speed_where_its_voltage_is_used_up():
    """J dw/dt = kt (V - kt w) / R under full voltage has w = V/kt (1 - exp(-t kt^2 / (R J)))."""
    inertia, dt, w, actuator = 0.02, 1e-4, 0.0, Actuator(**MOTOR)
    motors, speeds = actuator.motors(ARM, dt), []
    for _ in range(3000):
        w += dt * step(motors, 1e3, w)[0] / inertia
        speeds.append(w)
    times, rate = dt * np.arange(1, 3001), 0.4**2 / (0.5 * inertia)
    np.testing.assert_allclose(speeds, 60.0 * (1 - np.exp(-rate * times)), rtol=2e-3)
    assert speeds[-1] == pytest.approx(60.0, rel=1e-2)


@patient
@given(st.floats(-15, 15), st.floats(-20, 20), st.integers(1, 1024))
def test_pwm_gives_whole_steps_of_the_supply(u, w, levels):
    torque = driven(Actuator(**MOTOR, pwm_levels=levels), [u], np.array([w]))[0][0, 0]
    volts, step = 0.5 * torque / 0.4 + 0.4 * w, 24.0 / levels
    assert volts / step == pytest.approx(round(volts / step), abs=1e-6)
    free = driven(Actuator(**MOTOR), [u], np.array([w]))[0][0, 0]
    assert abs(torque - free) <= 0.4 / 0.5 * step / 2 + 1e-9


def stalled(actuator, u, w, steps=400):
    """Torques of both motors once the supply has settled, at constant speeds."""
    return driven(actuator, np.full((steps, 2), u), np.tile(w, (steps, 1)))[0][-1]


@patient
@given(st.floats(0.01, 0.24), st.floats(-30, 30), st.floats(-30, 30), st.floats(-20, 20))
def test_a_battery_sags_as_the_circuit_says(battery, u0, u1, w):
    """Power balance at the battery: what the windings take is what it gives, V i = sum V_j I_j."""
    u, speed, kt, R = np.array([u0, u1]), np.array([w, 0.5 * w]), 0.4, 0.5
    wanted = R * u / kt + kt * speed

    def taken(supply):
        volts = np.clip(wanted, -supply, supply)
        return volts @ ((volts - kt * speed) / R) / supply

    supply = brentq(lambda v: v - 24.0 + battery * taken(v), 6.0, 60.0)
    expected = kt * (np.clip(wanted, -supply, supply) - kt * speed) / R
    torque = stalled(Actuator(**MOTOR, battery_resistance=battery), u, speed)
    np.testing.assert_allclose(torque, expected, rtol=1e-6, atol=1e-6)


def test_a_strong_motor_takes_voltage_from_a_weak_one():
    both = stalled(Actuator(**MOTOR, battery_resistance=0.2), np.array([100.0, 100.0]), np.zeros(2))
    alone = stalled(Actuator(**MOTOR, battery_resistance=0.2), np.array([100.0, 0.0]), np.zeros(2))
    ideal = stalled(Actuator(**MOTOR), np.array([100.0, 100.0]), np.zeros(2))
    assert both[0] < 0.85 * alone[0] < 0.85 * ideal[0]


# --- Backlash: two masses and a gap -----------------------------------------------------------------------------------

GEAR = {"gap": 0.02, "rotor_inertia": 0.01, "stiffness": 500.0, "damping": 0.5}


def two_masses(torque, duration, dt, inertia=0.05, gear=None, rotor=(0.0, 0.0), speed=0.0):
    """Rotor and joint of a given inertia by our backlash: times, (N, 5) lead, rotor's speed, joint's, torque, angle."""
    names = "gap", "rotor_inertia", "stiffness", "damping", "rotor_friction"
    numbers = (np.array([(gear or GEAR).get(name, 0.0)]) for name in names)
    states, rows, angle = motor.motor_state(np.zeros((1, motor.STATES))), [], 0.0
    backlash, wire = Backlash(dt, *numbers, states), new_drive(1)
    states.ahead[0], states.rotor_speed[0] = rotor
    times = dt * np.arange(round(duration / dt))
    for t in times:
        wire.torque[0], wire.joint[0] = torque(t + 0.5 * dt), speed
        backlash.act(wire, 0, t)
        flank = wire.torque[0]
        speed += dt * flank / inertia
        angle += dt * speed
        rows.append((states.ahead[0], states.rotor_speed[0], speed, flank, angle))
    return times + dt, np.array(rows)


def reference(torque, times, inertia=0.05):
    """The same by DOP853: lead, rotor's speed, joint's speed, joint's angle at some times."""
    J, k, c, half = GEAR["rotor_inertia"], GEAR["stiffness"], GEAR["damping"], 0.5 * GEAR["gap"]

    def rate(t, y):
        ahead, w, v, _ = y
        flank = max(0.0, k * (ahead - half) + c * (w - v)) if ahead > half else 0.0
        flank += min(0.0, k * (ahead + half) + c * (w - v)) if ahead < -half else 0.0
        return [w - v, (torque(t) - flank) / J, flank / inertia, v]

    end = float(times[-1])
    return solve_ivp(rate, (0, end), np.zeros(4), "DOP853", t_eval=times, rtol=1e-9, atol=1e-12, max_step=2e-4).y.T


@pytest.mark.compiled
def test_backlash_is_the_two_sided_contact_of_two_masses():
    def torque(t):
        return 0.5 * math.sin(12.0 * t)

    duration, error = 0.6, {}
    for dt in (4e-5, 2e-5):
        times, rows = two_masses(torque, duration, dt)
        every = round(2e-3 / dt)
        truth = reference(torque, times[every - 1 :: every])
        error[dt] = np.abs(rows[every - 1 :: every][:, [0, 1, 2, 4]] - truth).max(axis=0)
        flanks = np.sign(rows[:, 3])
    assert {-1.0, 0.0, 1.0} == set(flanks)  # both flanks and the gap
    assert (error[2e-5] < [5e-4, 6e-2, 2e-2, 1e-4]).all()
    assert (error[2e-5] < 0.6 * error[4e-5]).all()  # first order


speeds, shares = st.floats(-3, 3), st.floats(0.01, 1.0)


@patient
@given(
    speeds,
    speeds,
    st.floats(-0.03, 0.03),
    st.floats(1, 1e6),
    st.floats(0, 10),
    st.floats(0.01, 1.0),
    st.floats(1e-5, 1e-2),
)
def test_backlash_never_creates_energy_and_keeps_momentum(w, v, ahead, stiffness, damping, ratio, dt):
    inertia, gear = 0.05, {"gap": 0.02, "rotor_inertia": 0.05 * ratio, "stiffness": stiffness, "damping": damping}
    _, rows = two_masses(lambda t: 0.0, 100 * dt, dt, inertia, gear, (ahead, w), v)
    lead, rotor, speed = np.vstack(([ahead, w, v], rows[:, :3])).T
    pressed = np.maximum(np.abs(lead) - 0.01, 0.0)
    energy = 0.5 * inertia * ratio * rotor**2 + 0.5 * inertia * speed**2 + 0.5 * stiffness * pressed**2
    assert (np.diff(energy) <= 1e-9 * (1e-6 + energy[:-1])).all()
    np.testing.assert_allclose(inertia * (ratio * rotor + speed), inertia * (ratio * w + v), rtol=1e-9, atol=1e-12)
    assert (rows[:, 3] * rows[:, 0] >= 0).all()  # a flank pushes outward and never pulls


def test_inside_the_gap_the_rotor_is_alone():
    times, rows = two_masses(lambda t: 0.01, 0.1, 1e-4, rotor=(-0.005, 0.0), speed=0.0)
    free = rows[:, 0] < 0.0099
    assert free.sum() > 300 and not rows[free, 3].any() and not rows[free, 2].any()
    np.testing.assert_allclose(rows[free, 1], times[free] * 0.01 / GEAR["rotor_inertia"], rtol=1e-9)


@pytest.mark.parametrize("stiffness", [1e3, 1e6, 1e9, 1e12])
def test_however_stiff_the_flanks_the_step_may_stay(stiffness):
    gear = {**GEAR, "stiffness": stiffness}
    _, rows = two_masses(lambda t: 0.5, 1.0, 1e-3, gear=gear)
    assert rows[-1, 2] == pytest.approx(0.5 / 0.06, rel=0.02)  # rotor and joint as one under a constant torque
    assert abs(rows[-1, 1] - rows[-1, 2]) < 0.02


def test_friction_of_the_rotor_holds_it_and_takes_its_part():
    gear = {**GEAR, "rotor_friction": 0.1}
    _, rows = two_masses(lambda t: 0.09, 0.2, 1e-3, gear=gear)
    assert not rows.any()
    _, rows = two_masses(lambda t: 0.5, 1.0, 1e-3, gear=gear)
    assert rows[-1, 2] == pytest.approx(0.4 / 0.06, rel=0.02)


# --- In the loop ------------------------------------------------------------------------------------------------------

LIMIT = '<limit lower="-9" upper="9" effort="2" velocity="9"/>'


def wheel(friction=0.0, inertia=0.05):
    """A disc on a vertical axle: one joint, of constant inertia, without gravity."""
    disc = f'<link name="base"/><link name="disc">{inertial(1.0, (inertia,) * 3)}</link>'
    axle = joint("axle", "base", "disc", "", "0 0 1", dynamics(0.0, friction) + LIMIT, "revolute")
    return robot_of(f'<robot name="disc">{disc}{axle}</robot>')


class Given(TorqueController):
    """A torque that does not care."""

    def __init__(self, torque):
        self.torque = torque

    def step(self, time, reference, measurement, command, state):
        return np.array([self.torque(time)])


def run_of(actuator, torque, duration=0.2, friction=0.0, integrator="rk4", **more):
    timing, still = Timing(duration, 0.002, 0.0005, None, integrator), Trajectory(None, (Hold(0.0),))
    return Loop(wheel(friction), still, Given(torque), timing=timing, actuator=actuator, **more).run()


def test_what_the_joint_felt_is_recorded_and_moves_it():
    run = run_of(Actuator(lag=0.02), lambda t: 1.0)
    applied = column(run, "applied")
    np.testing.assert_allclose(np.diff(column(run, "nu")), applied[:-1] * 0.002 / 0.05, rtol=1e-6)
    ends = run.time[:, None] + 0.0005 * np.arange(1, 5)  # of the plant's steps
    np.testing.assert_allclose(applied, (1 - np.exp(-ends / 0.02)).mean(axis=1), rtol=1e-9)
    np.testing.assert_array_equal(column(run, "motor_torque"), 1.0)
    np.testing.assert_array_equal(column(run_of(Actuator(torque_limit=1e6), lambda t: 1.0), "applied"), 1.0)


def test_backlash_in_the_loop_is_that_of_two_masses_and_balances_energy():
    def torque(t):
        return 0.5 * math.sin(30.0 * t)

    run = run_of(Actuator(**GEAR), torque, 0.3)
    held = two_masses(lambda t: torque(0.002 * math.floor(t / 0.002)), 0.3, 0.0005)[1]
    np.testing.assert_allclose(column(run, "nu")[1:], held[3::4, 2][:-1], atol=1e-9)
    assert (column(run, "applied") == 0).mean() > 0.05  # in the gap
    assert np.abs(run["energy_residual"]).max() < 1e-9
    without = run_of(Actuator(torque_limit=1e6), torque, 0.3)
    assert np.abs(column(run, "nu") - column(without, "nu")).max() > 0.1


def test_a_rotor_starts_with_its_joint():
    timing, robot = Timing(0.1), wheel()
    loop = Loop(
        robot, Trajectory(None, (Sine(0.3, 0.5),)), Given(lambda t: 0.0), timing=timing, actuator=Actuator(**GEAR)
    )
    run = loop.run(plant_state=(np.zeros(1), np.full(1, 2.0)))
    assert not run["applied"].any() and (column(run, "nu") == 2.0).all()  # both coast side by side


def test_a_gap_is_seen_from_the_motors_side():
    ahead = {}
    for side in ("joint", "motor"):
        run = run_of(Actuator(**GEAR), lambda t: 0.05, sensor=Sensor(side=side))
        ahead[side] = column(run, "q") - column(run, "position")
    assert not ahead["joint"].any()
    assert ahead["motor"][0] == 0.0 and 0.0095 < ahead["motor"].max() < 0.0115  # half the gap; the flank gives way


@pytest.mark.compiled
def test_a_motor_within_the_friction_of_its_joint_does_not_move_it():
    """The rotor crosses the gap and presses; the joint sticks, exactly."""
    gear = Actuator(**{**GEAR, "stiffness": 200.0, "damping": 0.5})
    run = run_of(gear, lambda t: 0.02, 2.0, friction=0.6, integrator="stick", sensor=Sensor(side="motor"))
    assert np.abs(column(run, "nu")).max() < 1e-15
    assert column(run, "q")[-1] == pytest.approx(0.01 + 0.02 / 200.0, rel=1e-3)
    assert column(run, "applied")[-1] == pytest.approx(0.02, rel=1e-3)
    assert column(run_of(gear, lambda t: 1.0, friction=0.6, integrator="stick"), "nu")[-1] > 0.1


def test_a_speed_limit_holds_within_one_step():
    limited, free = (column(run_of(a, lambda t: 1.0), "nu") for a in (Actuator(speed_limit=1.0), Actuator(lag=1e-4)))
    assert limited.max() <= 1.0 + 0.0005 / 0.05 and limited[-1] > 0.99
    assert free.max() > 3.0


@pytest.mark.compiled
def test_a_gap_costs_accuracy_and_hammers():
    robot, errors, jumps = wheel(), {}, {}
    for gap in (0.0, 0.1):
        actuator = Actuator(gap=gap, rotor_inertia=0.005, torque_limit=50.0)
        arguments = {"timing": Timing(1.0), "actuator": actuator, "start": Start(moving=True)}
        loop = Loop(robot, Trajectory(None, (Sine(0.3, 0.5),)), PD(Feedback(1.0, 2.0)), **arguments)
        run = loop.run()
        errors[gap], jumps[gap] = np.std(column(run, "true_e")), np.abs(np.diff(column(run, "nu"))).max()
    assert errors[0.1] > 1.05 * errors[0.0] and jumps[0.1] > 3.0 * jumps[0.0]


# --- Bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"torque_limit": 0.0}, r"actuator\.torque_limit"),
        ({"torque_limit": (1.0, -1.0)}, r"actuator\.torque_limit"),
        ({"speed_limit": math.inf}, r"actuator\.speed_limit"),
        ({"torque_gain": -1.0}, r"actuator\.torque_gain"),
        ({"lag": math.nan}, r"actuator\.lag"),
        ({"voltage": 0.0}, r"actuator\.voltage"),
        ({"voltage": 9.0, "resistance": 0.0}, r"actuator\.resistance"),
        ({"torque_constant": 0.1}, r"actuator\.torque_constant.*voltage"),
        ({"pwm_levels": 8}, r"actuator\.pwm_levels.*voltage"),
        ({"battery_resistance": 1.0}, r"actuator\.battery_resistance.*voltage"),
        ({"voltage": 9.0, "pwm_levels": -8}, r"actuator\.pwm_levels"),
        ({"gap": -0.1}, r"actuator\.gap"),
        ({"gap": 0.1}, r"actuator\.rotor_inertia.*a gap without a rotor"),
        ({"gap": (0.0, 0.1), "rotor_inertia": (0.1, 0.0)}, r"actuator\.rotor_inertia.*a gap without a rotor"),
        ({"stiffness": 0.0}, r"actuator\.stiffness"),
        ({"damping": -1.0}, r"actuator\.damping"),
        ({"rotor_friction": -1.0}, r"actuator\.rotor_friction"),
        ({"brake": -1.0}, r"actuator\.brake"),
    ],
)
def test_numbers_out_of_range_are_refused(arguments, text):
    with pytest.raises(ConfigError, match=text):
        Actuator(**arguments)


@pytest.mark.parametrize("name", ["torque_limit", "speed_limit", "torque_gain", "lag", "gap", "rotor_inertia"])
def test_not_one_number_per_motor_is_refused(name):
    numbers = {name: (1e-3, 1e-3, 1e-3)} | ({"rotor_inertia": 1e-3} if name == "gap" else {})
    with pytest.raises(ConfigError, match=rf"actuator\.{name}.*3 numbers for 4 motors"):
        Actuator(**numbers).motors(PLATFORM, DT)


def test_a_rotor_heavier_than_what_it_drives_is_refused():
    """Of a joint alone the bound is its inertia; energy would come from nothing beyond it."""
    robot = wheel()
    Actuator(gap=0.01, rotor_inertia=0.0499).motors(robot, DT)
    with pytest.raises(ConfigError, match=r"actuator\.rotor_inertia.*'axle'.*0\.05"):
        Actuator(gap=0.01, rotor_inertia=0.0501).motors(robot, DT)
    gear = {"gap": 0.02, "rotor_inertia": 0.1, "stiffness": 1e6, "damping": 0.0}
    _, rows = two_masses(lambda t: 0.0, 0.1, 1e-3, 0.05, gear, (0.0, 1.0), 0.0)
    energy = 0.05 * rows[:, 1] ** 2 + 0.025 * rows[:, 2] ** 2
    assert energy.max() > 0.05  # more than at the start


def test_a_brake_too_strong_for_the_step_is_refused():
    """Held over a step it would turn back what it brakes; behind a gap it is implicit in the rotor and stable."""
    robot = wheel()
    Actuator(brake=49.0).motors(robot, DT)
    with pytest.raises(ConfigError, match=r"actuator\.brake.*'axle'.*less than 50"):
        Actuator(brake=51.0).motors(robot, DT)
    motors = Actuator(brake=1e4, gap=0.1, rotor_inertia=0.01).motors(robot, DT)
    motors.states.rotor_speed[0] = 3.0
    step(motors, 0.0, 0.0, 1)
    assert motors.states.rotor_speed[0] == pytest.approx(3.0 / (1 + DT * 1e4 / 0.01))


def test_a_battery_that_breaks_down_is_refused():
    with pytest.raises(ConfigError, match=r"actuator\.battery_resistance.*0\.25 Ohm"):
        Actuator(**MOTOR, battery_resistance=0.25).motors(ARM, DT)
