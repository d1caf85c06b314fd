"""Limits that bite: commands, integrals, stops, a loop slower than told; on plants of plain pinocchio and by hand."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from numba import config

from mmnn_pin import PD, Stepper, StepperSettings, load
from mmnn_pin.loop.servo import Servo
from mmnn_pin.model.robot import speed_limits
from mmnn_pin.reference.limits import Limits
from mmnn_pin.reference.wishes import HOLD, BaseVelocity, JointGoal
from mmnn_pin.safety import Safety, trip_of
from mmnn_pin.signals import Measurement, Setpoint

compiled = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="too many samples for plain Python")
NONE = np.zeros(0)
SPEED, EFFORT = 4.0, 60.0
ARM = ("continuous", "revolute", "prismatic")


def link(name, mass, ahead=0.05):
    inertia = f'ixx="{0.02 * mass}" ixy="0" ixz="0" iyy="{0.02 * mass}" iyz="0" izz="{0.02 * mass}"'
    inertial = f'<inertial><origin xyz="{ahead} 0 0"/><mass value="{mass}"/><inertia {inertia}/></inertial>'
    return f'<link name="{name}">{inertial}</link>'


def urdf(kinds, speed=SPEED, effort=EFFORT, friction=2.0):
    """An arm whose joints turn about the vertical or slide along the floor: it carries no weight."""
    text = link("base", 5.0)
    for i, kind in enumerate(kinds):
        ends = "" if kind == "continuous" else 'lower="-3.1" upper="3.1" '
        limit = f'<limit {ends}effort="{effort}" velocity="{speed}"/><dynamics damping="{friction}"/>'
        axis, parent = ("1 0 0" if kind == "prismatic" else "0 0 1"), f"l{i - 1}" if i else "base"
        frame = f'<origin xyz="0.2 0 0"/><parent link="{parent}"/><child link="l{i}"/><axis xyz="{axis}"/>'
        text += link(f"l{i}", 3.0 - 0.5 * i) + f'<joint name="j{i}" type="{kind}">{frame}{limit}</joint>'
    return f'<robot name="arm">{text}</robot>'


def wheeled(speed):
    """A differential drive of radius 0.1 m and track 0.4 m."""
    text = link("base_link", 30.0)
    for name, y in (("left", 0.2), ("right", -0.2)):
        cylinder = '<geometry><cylinder radius="0.1" length="0.04"/></geometry>'
        shape = f'<collision><origin rpy="1.5707963267948966 0 0"/>{cylinder}</collision>'
        text += link(f"{name}_wheel", 1.0, 0.0).replace("</link>", f"{shape}</link>")
        text += (
            f'<joint name="{name}_wheel_joint" type="continuous"><origin xyz="0 {y} 0.1"/><parent link="base_link"/>'
        )
        text += f'<child link="{name}_wheel"/><axis xyz="0 1 0"/><limit effort="20" velocity="{speed}"/></joint>'
    return f'<robot name="drive">{text}</robot>'


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Robots by their text, loaded once."""
    folder, found = tmp_path_factory.mktemp("robots"), {}

    def robot(text):
        if text not in found:
            path = folder / f"r{len(found)}.urdf"
            path.write_text(text)
            found[text] = load(path)
        return found[text]

    return robot


class Arm:
    """Plain pinocchio's forward dynamics of an arm, its joints by effort, velocity or position."""

    def __init__(self, text, kinds, q):
        self.model = pin.buildModelFromXML(text)
        self.data, self.kinds, self.q, self.v = self.model.createData(), kinds, np.array(q, float), np.zeros(len(q))
        self.sent = self.q.copy()

    def step(self, command, interface, dt, damping=2.0, blocked=None):
        """Move on; velocity and position servos have the URDF's torque and a bandwidth of 30 1/s."""
        n = len(self.q)
        if interface == "effort":
            tau = np.nan_to_num(command.effort[-n:])
        else:
            asked = command.velocity[-n:] if interface == "velocity" else 30.0 * (command.position[-n:] - self.q)
            inertia = np.diag(pin.crba(self.model, self.data, self.configuration()))
            tau = 60.0 * inertia * (asked - self.v) + damping * self.v
        tau = np.clip(tau, -EFFORT, EFFORT)
        a = pin.aba(self.model, self.data, self.configuration(), self.v, tau - damping * self.v)
        self.v = self.v + dt * a
        if blocked is not None:
            self.v[blocked] = 0.0
        self.q = self.q + dt * self.v

    def configuration(self):
        found = []
        for kind, q in zip(self.kinds, self.q, strict=True):
            found += [math.cos(q), math.sin(q)] if kind == "continuous" else [q]
        return np.array(found)


def by(interface, kinds):
    return {f"j{i}": interface for i in range(len(kinds))}


# -- commands and integrals --------------------------------------------------------------------------------------------


def drive(robot, wish, seconds, reach=math.inf, period=0.01):
    """Wheels that follow at once, up to a speed; distance, speed and largest wheel command of every sample."""
    wheels = dict.fromkeys(robot.actuator_names, "velocity")
    stepper = Stepper(robot, PD(), StepperSettings(period=period, interfaces=wheels))
    pose, velocity, found = np.zeros(3), np.zeros(2), []
    for k in range(round(seconds / period)):
        measured = Measurement(pose.copy(), velocity.copy(), NONE, NONE)
        command = stepper.step(k * period, measured, wish(k * period)).motor_velocity
        left, right = np.clip(command, -reach, reach)
        velocity = np.array([0.05 * (left + right), 0.25 * (right - left)])
        middle = pose[2] + 0.5 * period * velocity[1]
        pose += period * np.array([velocity[0] * np.cos(middle), velocity[0] * np.sin(middle), velocity[1]])
        found.append((pose[0], velocity[0], velocity[1], np.abs(command).max()))
    assert not stepper.tripped
    return np.array(found)


@compiled
@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize("seconds", [2.0, 8.0])
def test_wheels_slower_than_asked_drive_on_after_hold_no_farther_than_wheels_that_reach_it(made, told, seconds):
    def wish(time):
        return BaseVelocity((0.6, 0.0)) if time < seconds else HOLD

    slow, fast = made(wheeled(3.0)), made(wheeled(20.0))
    reached = drive(fast, wish, seconds + 6.0)
    found = drive(slow if told else fast, wish, seconds + 6.0, reach=3.0)
    k = round(seconds / 0.01)
    assert found[k:, 0].max() - found[k, 0] < 1.1 * (reached[k:, 0].max() - reached[k, 0]) < 0.2
    assert found[k:, 0].max() - found[-1, 0] < 0.01 and found[k:, 1].min() > -0.02  # and not back
    assert found[:, 3].max() <= (3.0 if told else 1.5 * 6.0) * (1 + 1e-9)


@compiled
def test_full_samples_that_wheels_do_not_follow_leave_nothing_to_make_up_for_after_hold(made):
    """A reference that has run ahead of the base is given up with HOLD: it stands within what braking needs."""
    still, seconds, period = np.zeros(2), 2.0, 0.01

    def wish(time):
        v = 0.4 if time < seconds else 0.0
        sample = Setpoint(np.array([0.4 * time, 0.0, 0.0]), np.array([v, 0.0]), still, NONE, NONE, NONE)
        return sample if time < seconds else HOLD if time < seconds + 0.5 * period else None

    found = drive(made(wheeled(20.0)), wish, seconds + 6.0, reach=3.0)
    k = round(seconds / period)
    assert found[k:, 0].max() - found[k, 0] < 0.3**2 / 2.0 + 0.06 and found[-1, 1] == pytest.approx(0.0, abs=1e-3)


@compiled
@pytest.mark.parametrize("jump", [np.zeros(3), np.array([0.0, 0.0, 2.0])])
def test_a_base_whose_odometry_freezes_or_turns_trips_before_it_is_far(made, jump):
    robot, period = made(wheeled(20.0)), 0.01
    stepper = Stepper(
        robot, PD(), StepperSettings(period=period, interfaces=dict.fromkeys(robot.actuator_names, "velocity"))
    )
    pose, velocity, frozen = np.zeros(3), np.zeros(2), None
    for k in range(1500):
        if k == 100:
            frozen = pose + jump, velocity.copy()
        told = (pose.copy(), velocity.copy()) if frozen is None else frozen
        sample = Setpoint(np.array([0.003 * k, 0.0, 0.0]), np.array([0.3, 0.0]), np.zeros(2), NONE, NONE, NONE)
        command = stepper.step(k * period, Measurement(*told, NONE, NONE), sample).motor_velocity
        velocity = np.array([0.05 * command.sum(), 0.25 * (command[1] - command[0])])
        pose += period * np.array([velocity[0] * np.cos(pose[2]), velocity[0] * np.sin(pose[2]), velocity[1]])
    assert stepper.tripped and not velocity.any()
    assert np.hypot(*(pose[:2] - (0.3, 0.0))) < 1.2  # of it 0.3 m until it is lost, and braking


@compiled
def test_speed_and_yaw_rate_are_scaled_together_so_that_the_curvature_stays(made):
    for v, w in ((0.3, 1.0), (0.25, -1.4), (0.6, 0.3)):
        found = drive(made(wheeled(3.0)), lambda time, v=v, w=w: BaseVelocity((v, w)), 4.0, reach=3.0)
        assert found[:, 3].max() <= 3.0 * (1 + 1e-9)
        assert found[-1, 2] / found[-1, 1] == pytest.approx(w / v, rel=0.02)


@compiled
@pytest.mark.parametrize("interface", ["velocity", "position"])
@pytest.mark.parametrize("seconds", [2.0, 4.0])
def test_a_blocked_joint_winds_nothing_up(made, interface, seconds):
    """Held 0.2 rad before its goal, then let go: it comes to the goal and not far beyond it."""
    kinds = ("revolute", "revolute")
    text = urdf(kinds)
    robot, plant, period = made(text), Arm(text, kinds, [0.0, 0.0]), 0.01
    stepper = Stepper(
        robot, PD(), StepperSettings(period=period, interfaces=by(interface, kinds), safety=Safety(joint_error=1.0))
    )
    q, sent, speeds = [], [], []
    for k in range(round((seconds + 4.0) / period)):
        held = 0.5 if k * period < seconds else None
        measured = Measurement(NONE, NONE, plant.q.copy(), plant.v.copy())
        sample = Setpoint(NONE, NONE, NONE, np.array([min(k * period, 0.7), 0.0]), np.zeros(2), np.zeros(2))
        command = stepper.step(k * period, measured, sample)
        sent.append(command.position[0] if interface == "position" else plant.q[0])
        speeds.append(0.0 if interface == "position" else abs(command.velocity[0]))
        for _ in range(10):
            plant.step(command, interface, period / 10, blocked=0 if held and plant.q[0] >= held else None)
        q.append(plant.q[0])
    assert not stepper.tripped
    assert max(speeds) <= SPEED and max(sent) < 0.7 + 0.2
    assert max(np.abs(np.diff(sent))) <= SPEED * period * (1 + 1e-9)
    assert max(q) < 0.7 + 0.08 and q[-1] == pytest.approx(0.7, abs=0.01)


@compiled
@pytest.mark.parametrize("interface", ["velocity", "position"])
@pytest.mark.parametrize("slower", [1.0, 4.0])
def test_a_goal_is_reached_and_a_stop_on_the_way_stands_whatever_the_period_is_really(made, interface, slower):
    """Told 20 ms: servos' integrals go by the real period, and a stop begins with what the reference did."""
    kinds, told = ("revolute", "revolute"), 0.02
    text = urdf(kinds)
    for stops_at in (math.inf, 1.0):
        plant, period = Arm(text, kinds, [0.0, 0.0]), told * slower
        stepper = Stepper(
            made(text),
            PD(),
            StepperSettings(period=told, interfaces=by(interface, kinds), safety=Safety(slowest="none")),
        )
        fastest, there = 0.0, None
        for k in range(round(6.0 / period)):
            if there is None and k * period >= stops_at:
                stepper.stop()
                there, fastest = plant.q[0], plant.v[0]
            measured = Measurement(NONE, NONE, plant.q.copy(), plant.v.copy())
            command = stepper.step(k * period, measured, JointGoal((2.0, 0.0)) if k == 1 else None)
            for _ in range(round(period / 0.002)):
                plant.step(command, interface, 0.002)
        if there is None:
            assert plant.q[0] == pytest.approx(2.0, abs=0.02) and not stepper.tripped
        else:
            assert fastest > 0.5 and abs(plant.v[0]) < 1e-3
            assert -0.05 < plant.q[0] - there < fastest**2 / (2 * 5.0) + 2.0 * fastest / 30.0 + fastest * period + 0.05


@settings(max_examples=20, deadline=None)
@given(st.floats(-9.0, 9.0), st.floats(-3.0, 3.0), st.floats(0.2, 5.0))
@example(0.0, 1.0, 1.0)  # stopped, as no measurement is new
def test_a_sent_position_stays_in_reach_between_the_ends_and_moves_within_the_speed(made, goal, measured, speed):
    """Whatever is asked and measured: the closed form of every bound."""
    kinds, period = ("revolute", "revolute"), 0.02
    robot = made(urdf(kinds))
    stepper = Stepper(
        robot, PD(), StepperSettings(period=period, interfaces=by("position", kinds), safety=Safety(joint_error="none"),
        limits=Limits(joint_speed=speed), servo=Servo(bandwidth=20.0), latency=0.01),
    )  # fmt: skip
    most, before = min(speed, SPEED), None
    for k in range(12):
        sample = Setpoint(NONE, NONE, NONE, np.full(2, goal), np.full(2, goal), np.zeros(2))
        command = stepper.step(k * period, Measurement(NONE, NONE, np.full(2, measured), np.zeros(2)), sample)
        sent = command.position.copy()
        assert (np.abs(sent - measured) <= most * (1 / 20.0 + 0.01 + period) * (1 + 1e-9)).all()
        assert (np.abs(sent) <= 3.1).all()
        if before is not None:
            assert (np.abs(sent - before) <= most * period * (1 + 1e-9)).all()
        before = sent


# -- a loop slower than told -------------------------------------------------------------------------------------------


def paced(made, times, told=0.002, safety=None):
    """A goal under gravity-free dynamics, sampled at some times; the stepper and the fastest joint."""
    kinds = ("revolute", "revolute")
    text = urdf(kinds, friction=0.0)
    stepper = Stepper(made(text), PD(), StepperSettings(period=told, safety=safety or Safety(torque="urdf")))
    plant = Arm(text, kinds, [0.0, 0.0])
    fastest = 0.0
    for k, (now, then) in enumerate(pairwise(times)):
        goal = JointGoal([0.5, -0.4]) if k == 5 else None
        command = stepper.step(now, Measurement(NONE, NONE, plant.q.copy(), plant.v.copy()), goal)
        steps = max(1, round((then - now) / 0.0005))
        for _ in range(steps):
            plant.step(command, "effort", (then - now) / steps, damping=0.0)
        fastest = max(fastest, np.abs(plant.v).max())
    return stepper, plant, fastest


@compiled
def test_a_loop_slower_than_told_is_told_and_beyond_what_the_gains_bear_it_stops(made):
    bears = paced(made, np.arange(10) * 0.002)[0].setup.safety.slowest
    slower, _, fastest = paced(made, np.arange(300) * 0.01)
    assert not slower.tripped and len(slower.told) == 1 and "its period is 2 ms" in slower.told[0]
    assert 0.01 < bears < 0.1 and fastest < 2.0
    late, plant, _ = paced(made, np.arange(200) * 1.5 * bears)
    assert late.tripped and np.abs(plant.v).max() < 0.1  # at rest, though its gains would swing it at this rate
    assert np.abs(plant.q - paced(made, np.arange(2) * 0.002)[1].q).max() < 0.2  # and before it has moved that far
    still, _, _ = paced(made, np.arange(60) * 1.5 * bears, safety=Safety(joint_speed="none", joint_error="none"))
    assert "the control period is" in trip_of(still.hardware.way.supervisor.state, still.robot)[2]


@compiled
def test_jitter_and_a_single_pause_are_no_slow_loop(made):
    rng, told = np.random.default_rng(0), 0.002
    late = np.cumsum(told * rng.uniform(0.2, 1.8, 800))
    paused = np.arange(800) * told + 0.3 * (np.arange(800) > 300)
    for times in (late, paused):
        stepper, _, _ = paced(made, times)
        assert not stepper.tripped and stepper.told == []


# -- runaways ----------------------------------------------------------------------------------------------------------


@compiled
@pytest.mark.parametrize("interface", ["effort", "velocity", "position"])
def test_a_joint_that_runs_away_trips_before_it_is_02_rad_beyond_its_load(made, interface):
    """A joint that a fault drives off at its own speed, whatever it is commanded."""
    kinds = ("continuous", "revolute")
    robot = made(urdf(kinds, friction=0.0))
    stepper, period, q = (
        Stepper(robot, PD(), StepperSettings(period=0.002, interfaces=by(interface, kinds))),
        0.002,
        np.zeros(2),
    )
    bound = stepper.setup.safety.joint_error[0]
    for k in range(1000):
        stepper.step(k * period, Measurement(NONE, NONE, q.copy(), np.array([SPEED, 0.0]) * (k > 50)), None)
        if stepper.tripped:
            break
        q[0] += SPEED * period * (k > 50)
    assert stepper.tripped and q[0] <= bound + 2 * SPEED * period and bound < 0.3


@compiled
def test_a_joint_or_a_wheel_that_is_too_fast_trips_by_the_urdf_alone(made):
    arm, base = made(urdf(("revolute",))), made(wheeled(3.0))
    for robot, nu in ((arm, 1.6 * SPEED), (base, 1.6 * 0.3)):
        for share in (0.9, 1.0):
            stepper = Stepper(robot, PD(), StepperSettings(safety=Safety(joint_error="none")))
            n, nb = robot.dimensions.arm, robot.dimensions.base
            fast = Measurement(
                np.zeros(3 * (nb > 0)), share * nu * np.eye(1, nb)[0], np.zeros(n), np.full(n, share * nu)
            )
            stepper.step(0.0, fast, None)
            assert stepper.tripped == (share == 1.0)
        assert stepper.tripped and "speed of" in trip_of(stepper.hardware.way.supervisor.state, robot)[2]
    assert speed_limits(base).tolist() == [3.0, 3.0]
    off = Safety(wheel_speed="none", joint_error="none")
    stepper = Stepper(base, PD(), StepperSettings(safety=off))
    stepper.step(0.0, Measurement(np.zeros(3), np.array([5.0, 0.0]), NONE, NONE), None)
    assert not stepper.tripped


# -- a stop, whatever the sensors say ----------------------------------------------------------------------------------

LIES = ("honest", "jump", "wrap", "frozen", "frozen position", "flip", "noise", "silent", "velocity flip")


def lie(kind, q, v, then, rng):
    """What a sensor says after a trip, of the truth and of what it said at the trip."""
    if kind == "jump":
        return q + 1.7, v
    if kind == "wrap":
        return (q + 1.0) % (2 * math.pi), v
    if kind == "frozen":
        return then[0], then[1]
    if kind == "frozen position":
        return then[0], v
    if kind == "flip":
        return 2 * then[0] - q, -v
    if kind == "velocity flip":
        return q, -v
    if kind == "noise":
        return q + rng.normal(0.0, 0.4, q.size), v
    return q, v


@compiled
@settings(max_examples=600, deadline=None, derandomize=True)
@given(
    st.sampled_from(LIES), st.sampled_from(["effort", "velocity", "position"]),
    st.sampled_from(["speed", "jump", "stop"]), st.floats(-0.9, 0.9), st.integers(0, 1000),
)  # fmt: skip
def test_after_a_trip_the_robot_comes_to_rest_whatever_its_sensors_say(made, kind, interface, cause, speed, seed):
    """The true joints, by plain pinocchio: at rest in 3.5 s, no farther than braking and friction explain."""
    assume((kind, cause) != ("silent", "speed"))  # the last that is heard is a lie, and the ramp begins from there
    kinds, rng, period = ("continuous", "revolute"), np.random.default_rng(seed), 0.004
    text = urdf(kinds)
    robot, plant = made(text), Arm(text, kinds, rng.uniform(-1.0, 1.0, 2))
    safety = Safety(torque="urdf", joint_error="none")
    stepper = Stepper(robot, PD(), StepperSettings(period=period, interfaces=by(interface, kinds), safety=safety))
    plant.v[:] = speed * SPEED * rng.uniform(0.5, 1.0, 2)
    start, then, began = plant.q.copy(), None, plant.v.copy()
    for k in range(1500):
        q, v = plant.q.copy(), plant.v.copy()
        if then is not None:
            q, v = lie(kind, q, v, then, rng)
        elif k == 25:
            start, then, began = plant.q.copy(), (q.copy(), v.copy()), v.copy()
            stepper.stop() if cause == "stop" else None
            q, v = (q + 2.5, v) if cause == "jump" else (q, v + 3.0 * SPEED) if cause == "speed" else (q, v)
        measured = None if kind == "silent" and k > 25 else Measurement(NONE, NONE, q, v)
        command = stepper.step(k * period, measured, None)
        for _ in range(4):
            plant.step(command, interface, period / 4)
    assert stepper.tripped
    # By friction alone: v M / d at most; by a servo: v^2 / (2 a) and its lag; before a lie is found out, half a radian.
    inertia = pin.crba(plant.model, plant.data, plant.configuration()).max()
    coasting = max(np.abs(began).max(), 1.5 * SPEED) * inertia / 2.0
    if interface != "effort":
        coasting = SPEED / 30.0 + SPEED**2 / (2 * 5.0)
    creeps = 0.25 if "flip" in kind else 0.05  # a sign that lies is found out by what it moves: a slow swing is left
    assert np.abs(plant.v).max() < creeps, (kind, interface, plant.v)
    assert np.abs(plant.q - start).max() < 0.5 + coasting, (kind, interface, plant.q - start)
