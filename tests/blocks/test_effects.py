"""Every effect of the hardware model alone, without a loop: one step against its closed form."""

from __future__ import annotations

import math
import re
import textwrap

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import ROOT
from scipy.signal import lfilter

from mmnn_pin.actuator import NEVER, effects
from mmnn_pin.actuator.effects import (
    STATES,
    Backlash,
    Battery,
    CurrentLoop,
    DeadMotors,
    Meter,
    MotorSpeed,
    ShortedWindings,
    SpeedLimit,
    Supply,
    TorqueConstant,
    TorqueLimit,
    motor_state,
    new_drive,
)
from mmnn_pin.disturbance import BRAKE, Forces, Pushes, block
from mmnn_pin.disturbance.effects import NOISE, SINE, STEP
from mmnn_pin.loop.hardware import CommandLine, MotorSide, SentTorque, pass_through
from mmnn_pin.sensing.effects import (
    CLOCK,
    COLUMNS,
    COUNT,
    ESTIMATE,
    MOVED,
    RATE,
    READING,
    Encoders,
    FrozenEncoders,
    MessageLine,
    Noise,
    Rates,
    Reading,
    Velocities,
    WheelOdometry,
)
from mmnn_pin.sensing.settings import Sensor

RNG = np.random.default_rng(0)
THREE = np.array([3.0, -4.0, 0.5])


def drive(torque=THREE, speed=(0.0, 0.0, 0.0), shorted=0):
    wire = new_drive(len(torque))._replace(shorted=np.array([shorted]))
    wire.torque[:], wire.speed[:], wire.joint[:] = torque, speed, speed
    return wire


def reading(encoders=2, pose=0, size=4, modelled=False):
    """Of a fixed arm with as many encoders, in the second measurement."""
    clock = np.zeros(CLOCK)
    clock[COUNT] = 1.0
    return Reading(
        np.zeros(encoders + pose),
        np.zeros(encoders),
        clock,
        np.zeros((encoders, COLUMNS)),
        np.zeros(size),
        np.zeros(size),
        np.zeros(encoders if modelled else 0),
        np.zeros(encoders if modelled else 0),
        0,
    )


# --- Motors -----------------------------------------------------------------------------------------------------------


def test_a_motor_turns_as_its_rotor_behind_a_gap_and_else_as_its_joint():
    states, wire = motor_state(np.zeros((3, STATES))), drive(speed=(1.0, 2.0, 3.0))
    states.rotor_speed[:] = 9.0
    MotorSpeed(np.array([0.0, 0.1, 0.0]), states).act(wire, 0, 0.0)
    np.testing.assert_array_equal(wire.speed, [1.0, 9.0, 3.0])


def test_torque_constant_torque_limit_and_speed_limit():
    wire = drive(speed=(2.0, 2.0, -2.0))
    TorqueConstant(np.array([2.0, 0.5, 1.0])).act(wire, 0, 0.0)
    np.testing.assert_array_equal(wire.torque, [6.0, -2.0, 0.5])
    TorqueLimit(np.array([5.0, 1.0, np.inf])).act(wire, 0, 0.0)
    np.testing.assert_array_equal(wire.torque, [5.0, -1.0, 0.5])
    SpeedLimit(np.array([1.0, 1.0, 1.0])).act(wire, 0, 0.0)
    np.testing.assert_array_equal(wire.torque, [0.0, -1.0, 0.5])  # the others brake


def test_a_supply_gives_the_torque_of_its_voltage_and_a_battery_sags_by_the_power_drawn():
    states, wire = motor_state(np.zeros((3, STATES))), drive((100.0, -100.0, 1.0), (5.0, 5.0, 5.0))
    supply = Supply(24.0, 0.1, 0.0, np.full(3, 0.5), np.full(3, 0.4), states)
    states.drawn[:] = 10.0, 5.0, 0.0
    supply.act(wire, 0, 0.0)
    volts = np.clip(0.4 * np.array([100.0, -100.0, 1.0]) / 0.5 + 0.5 * 5.0, -22.5, 22.5)
    np.testing.assert_allclose(wire.torque, 0.5 * (volts - 2.5) / 0.4)
    Battery(supply).act(wire, 0, 0.0)
    power = volts * wire.torque / 0.5  # of the windings, which the battery gives at its voltage
    np.testing.assert_allclose(states.drawn[:] * 22.5, power)


def test_a_dead_motor_has_no_torque_while_its_window_is_open():
    effect = DeadMotors(np.array([[1.0, 0.2, 0.3]]))
    for time, torque in ((0.1, -4.0), (0.2, 0.0), (0.29, 0.0), (0.3, -4.0)):
        wire = drive()
        effect.act(wire, 0, time)
        np.testing.assert_array_equal(wire.torque, [3.0, torque, 0.5])
    wire = drive()
    DeadMotors(NEVER).act(wire, 0, 0.0)
    np.testing.assert_array_equal(wire.torque, THREE)


def test_the_dead_zone_of_contributing_is_one():
    (text,) = re.findall(
        r"```python\n( +@by_address\n +class DeadZone.*?)```", (ROOT / "CONTRIBUTING.md").read_text(), re.S
    )
    names = dict(vars(effects)) | {"internal": lambda function: function}  # a text has no file to cache beside
    exec(textwrap.dedent(text), names)
    wire = drive()
    names["DeadZone"](np.array([2.0, 5.0, 0.5])).act(wire, 0, 0.0)
    np.testing.assert_array_equal(wire.torque, [3.0, 0.0, 0.5])


def test_a_current_loop_is_a_first_order_filter():
    commands, decay = RNG.normal(size=50), 0.8
    effect = CurrentLoop(np.full(3, decay), motor_state(np.zeros((3, STATES))))
    given = []
    for u in commands:
        wire = drive((u, u, u))
        effect.act(wire, 0, 0.0)
        given.append(wire.torque[0])
    np.testing.assert_allclose(given, lfilter([1.0 - decay], [1.0, -decay], commands), atol=1e-15)


def test_shorted_windings_brake_the_first_motors_implicitly_in_a_rotor():
    wire = drive((0.0, 0.0, 0.0), (2.0, 2.0, 2.0), 2)
    ShortedWindings(0.01, np.full(3, 5.0), np.array([0.0, 0.1, 0.1]), np.full(3, 0.02)).act(wire, 0, 0.0)
    np.testing.assert_allclose(wire.torque, [-10.0, -10.0 / (1.0 + 0.01 * 5.0 / 0.02), 0.0])


def test_inside_its_gap_a_rotor_turns_freely_and_the_joint_feels_nothing():
    one, states = np.ones(1), motor_state(np.zeros((1, STATES)))
    wire = new_drive(1)
    wire.torque[:] = 0.3
    Backlash(0.001, 0.1 * one, 0.02 * one, 500.0 * one, 0.5 * one, 0.0 * one, states).act(wire, 0, 0.0)
    assert wire.torque[0] == 0.0 and states.rotor_speed[0] == pytest.approx(0.001 * 0.3 / 0.02)


def test_a_meter_sums_what_the_joints_get():
    states = motor_state(np.zeros((3, STATES)))
    for _ in range(2):
        Meter(states).act(drive(), 0, 0.0)
    np.testing.assert_array_equal(states.sum[:], 2 * THREE)
    np.testing.assert_array_equal(states.given[:], THREE)


# --- Commands and pushes ----------------------------------------------------------------------------------------------


def test_a_lost_command_leaves_the_last_one_and_a_broken_one_is_no_number():
    line = CommandLine(np.array([0.0, 1.0, 2.0]), np.array([7.0, 8.0]))
    for k, (torque, arrived) in enumerate((([1.0, 2.0], 1.0), ([7.0, 8.0], 0.0), ([np.nan, np.nan], 1.0))):
        wire = SentTorque(np.array([1.0, 2.0]), np.zeros(1))
        pass_through((line,), wire, k, 0.0)
        np.testing.assert_array_equal(wire.torque, torque)
        assert wire.arrived[0] == arrived


def test_pushes_add_up():
    rows = [[0, STEP, 2.0, 1.0, 0.0, 1.0], [0, SINE, 3.0, 4.0, 0.0, 1.0], [1, NOISE, 5.0, 1.0, 0.0, 1.0]]
    gusts, wire = RNG.normal(size=(2, 3)), Forces(np.zeros(2))
    Pushes(0.01, np.array(rows), gusts).act(wire, 1, 0.02)
    np.testing.assert_allclose(wire.force, [2.0 + 3.0 * math.sin(2 * math.pi * 4.0 * 0.025), 5.0 * gusts[1, 2]])


def test_a_joint_is_blocked_while_its_window_is_open():
    hold = np.zeros(3)
    for time, held in ((0.0, 0.0), (0.1, BRAKE), (0.2, 0.0)):
        block(time, np.array([[2.0, 0.1, 0.2]]), hold)
        np.testing.assert_array_equal(hold, [0.0, 0.0, held])


# --- Sensors ----------------------------------------------------------------------------------------------------------


def test_encoders_round_to_their_steps_and_tell_how_far_they_moved():
    wire = reading()
    wire.position[:], wire.joints[:, READING] = (0.123, -0.456), 0.1
    noise = RNG.normal(size=(1, 2))
    offset, spread, step = np.array([0.01, 0.0]), np.array([0.0, 0.02]), np.array([0.01, 0.0])
    Encoders(np.array([0, 1]), step, offset, spread, noise).act(wire, 0, 0.0)
    angles = np.array([0.13, -0.456 + 0.02 * noise[0, 1]])
    np.testing.assert_allclose(wire.joints[:, READING], angles)
    np.testing.assert_allclose(wire.joints[:, MOVED], angles - 0.1)


def test_an_encoder_on_the_motor_reads_the_rotor():
    states, wire = motor_state(np.zeros((1, STATES))), reading()
    states.ahead[0], states.rotor_speed[0] = 0.02, 3.0
    MotorSide(np.array([[0, 1, 1]]), states).act(wire, 0, 0.0)
    np.testing.assert_array_equal((wire.position, wire.nu), ([0.0, 0.02], [0.0, 3.0]))


def test_a_frozen_encoder_keeps_what_it_read_when_its_window_opened():
    effect, wire = FrozenEncoders(np.array([[1.0, 0.1, 0.2, 1.0]]), np.zeros(1)), reading()
    for time, angle, read in ((0.0, 1.0, 1.0), (0.1, 2.0, 1.0), (0.2, 3.0, 3.0)):
        wire.position[1], wire.nu[1] = angle, 5.0
        effect.act(wire, 0, time)
        assert wire.position[1] == read and wire.nu[1] == (0.0 if time == 0.1 else 5.0)


@pytest.mark.parametrize("observer", [False, True])
def test_rates_are_a_filter_or_an_observer_of_the_readings(observer):
    h, alpha, beta, angles = 0.01, 0.4, 3.0, RNG.normal(size=60).cumsum()
    effect, wire, rates = Rates(observer, h, alpha, beta, 0.0, np.zeros((0, 0))), reading(1), []
    for angle in angles:
        wire.joints[0, MOVED], wire.joints[0, READING] = angle - wire.joints[0, READING], angle
        effect.act(wire, 0, 0.0)
        rates.append(wire.joints[0, RATE])
    if not observer:
        differences = np.diff(angles, prepend=0.0) / h
        return np.testing.assert_allclose(rates, lfilter([alpha], [1.0, alpha - 1.0], differences), rtol=1e-9)
    x, A = np.zeros(2), np.array([[1.0, h], [0.0, 1.0]])  # x = A x + L (angle - (A x)_1)
    for angle, rate in zip(angles, rates, strict=True):
        x = A @ x + np.array([alpha, beta]) * (angle - (A @ x)[0])
        assert rate == pytest.approx(x[1], rel=1e-9, abs=1e-12)


def observing(bandwidth, h, wheels=0):
    """The observer on a model as a sensor of that bandwidth makes it, its three poles at exp(-bandwidth h)."""
    coefficients = Sensor(velocity="model", bandwidth=bandwidth).derivative(h)
    return Rates(True, h, *coefficients, np.ones((wheels, 1)))


@settings(max_examples=50, deadline=None)
@given(bandwidth=st.floats(1.0, 300.0), h=st.floats(1e-4, 0.01))
def test_the_observer_on_a_model_has_three_equal_poles(bandwidth, h):
    effect, pole = observing(bandwidth, h), math.exp(-bandwidth * h)
    A, L = np.array([[1, h, h * h / 2], [0, 1, h], [0, 0, 1]]), np.array([effect.alpha, effect.beta, effect.gamma])
    wanted = np.poly(np.full(3, pole))
    np.testing.assert_allclose(np.poly(A - np.outer(L, A[0])), wanted, atol=1e-9)


@pytest.mark.parametrize("told", [0.0, 1.0, -2.0])
def test_the_observer_on_a_model_learns_what_it_was_not_told(told):
    """A wheel and a joint under an acceleration of their own, of which it is told a share; a base moves its wheels."""
    h, wire = 0.002, reading(3, 0, 4, modelled=True)
    effect = observing(60.0, h, wheels=2)
    truth = np.array([0.7, 0.7, -3.0])
    for k in range(1, 500):
        wire.joints[:, READING] = 0.5 * truth * (k * h) ** 2
        wire.acceleration[:2] = told * 0.7, told * -3.0
        effect.act(wire, 0, 0.0)
    np.testing.assert_allclose(wire.joints[:, RATE], truth * 499 * h, rtol=1e-6)
    np.testing.assert_allclose(wire.joints[:, ESTIMATE], wire.joints[:, READING], rtol=1e-6)
    np.testing.assert_allclose(wire.bias, (1.0 - told) * truth, atol=1e-5)


def largest_eigenvalue(gain, ratio, bandwidth, h=0.001, rate=7.0):
    """Of a kilogram under a held force `-gain (v + rate x)` by the observer, which takes its mass for `ratio`."""
    alpha, beta, gamma = Sensor(velocity="model", bandwidth=bandwidth).derivative(h)

    def step(z):
        q, v, x, r, b, a = z
        change = h * (a + b)
        off = q - x - h * (r + 0.5 * change)
        x, r, b = q - off + alpha * off, r + change + beta * off, b + gamma * off
        force = -gain * (r + rate * x)
        return np.array([q + h * v + 0.5 * h * h * force, v + h * force, x, r, b, force / ratio])

    return np.abs(np.linalg.eigvals(np.column_stack([step(unit) for unit in np.eye(6)]))).max()


@pytest.mark.parametrize("gain", [20.0, 60.0, 200.0, 600.0])
def test_a_wrong_mass_leaves_the_loop_of_the_observer_stable_if_it_is_not_below_gain_times_period(gain):
    """Half to three times the mass, with feedback up to ten times as fast as the observer; too light a one is lost."""
    for ratio in (0.5, 1.0, 2.0, 3.0):
        for bandwidth in (60.0, 100.0):
            assert largest_eigenvalue(gain, max(ratio, 0.001 * gain), bandwidth) < 1.0
    assert largest_eigenvalue(gain, 0.0003 * gain, 60.0) > 1.0


def test_velocities_are_true_or_the_rates():
    wire, W = reading(), np.zeros((0, 0))
    wire.nu[:], wire.joints[:, RATE], wire.joints[:, READING] = (1.0, 2.0), (3.0, 4.0), (5.0, 6.0)
    for exact, rates in ((True, [1.0, 2.0]), (False, [3.0, 4.0])):
        Velocities(exact, W, READING).act(wire, 0, 0.0)
        np.testing.assert_array_equal(wire.message, [5.0, 6.0, *rates])
    wire.joints[:, ESTIMATE] = 7.0, 8.0
    Velocities(False, W, ESTIMATE).act(wire, 0, 0.0)
    np.testing.assert_array_equal(wire.message, [7.0, 8.0, 3.0, 4.0])


def test_odometry_follows_the_arc_and_a_true_pose_is_the_robots():
    wire, pose = reading(2, 3, 5), np.array([1.0, 2.0, 0.3])
    wire.position[:3], wire.joints[:, MOVED] = (7.0, 8.0, 9.0), (0.1, 0.3)
    WheelOdometry(True, np.array([[0.5, 0.5], [0.0, 0.0], [-1.0, 1.0]]), pose).act(wire, 0, 0.0)
    np.testing.assert_allclose(wire.message[:3], [1.0 + 0.2 * math.cos(0.4), 2.0 + 0.2 * math.sin(0.4), 0.5])
    WheelOdometry(False, np.zeros((3, 2)), pose).act(wire, 0, 0.0)
    np.testing.assert_array_equal(wire.message[:3], [7.0, 8.0, 9.0])


def test_noise_is_added_to_velocities_and_nothing_else():
    wire, normals = reading(), RNG.normal(size=(2, 2))
    Noise(np.array([0.1, 0.2]), np.zeros(0), normals, np.zeros((2, 0))).act(wire, 1, 0.0)
    np.testing.assert_array_equal(wire.message, [0.0, 0.0, *(normals[1] * [0.1, 0.2])])


def test_a_line_delays_by_whole_measurements_loses_and_corrupts():
    n, wire = 8, reading(1, 0, 1)
    wire.clock[:] = 0.0
    faults, uniforms = np.zeros((n, 2)), np.zeros((n, 2))
    uniforms[:, 1], faults[5, 0], faults[6, 1] = 0.5, -1.0, 100.0
    line, got = MessageLine(1, 0, 0.1, uniforms, faults, 0, 1, 0, np.zeros((2, 1))), []
    for k in range(n):
        wire.message[0] = k
        line.act(wire, k, 0.0)
        got.append(wire.received[0])
    assert got == [0.0, 0.0, 1.0, 2.0, 3.0, 3.0, 5.0, 106.0]
