"""Motors of bases that steer behind velocity and position interfaces, in the loop and by a stepper."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from steered import car

from mmnn_pin import Loop, Measurement, Setpoint, Stepper, StepperSettings, Timing, load, load_experiment
from mmnn_pin.errors import ConfigError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.loop.servo import Servo, interfaces_of, share_of_base, split_of, state_size
from mmnn_pin.loop.stepper import placed_motors
from mmnn_pin.model.base.rolling import followed
from mmnn_pin.model.robot import Robot
from mmnn_pin.reference import Eight, HolonomicPath, Sine, Trajectory
from mmnn_pin.safety import Safety
from mmnn_pin.torque.model_based import ComputedTorque

GAINS = Kinematic(kx=1.5, ky=6.0, kth=4.0, K=5.0, holonomic=(2.0, 2.0, 2.0))
ROBOTS = {name: load(name) for name in ("car_arm", "swerve_arm")}
PARTS = ("pose", "velocity", "q", "qdot", "shape")


def interfaces(robot: Robot, drive: str, steer: str) -> dict[str, str]:
    """Of all motors; the arm's take velocities."""
    d = robot.dimensions
    base = {name: steer if name in robot.base.shape else drive for name in robot.actuator_names[: d.motors - d.arm]}
    return base | dict.fromkeys(robot.joint_names, "velocity")


def servo(robot: Robot) -> Servo:
    """Steering with a lag of 20 ms, the others as they are."""
    own = [30.0] * robot.dimensions.dof
    own[1 : robot.dimensions.base] = [50.0] * (robot.dimensions.base - 1)
    return Servo(bandwidth=tuple(own))


def loop_of(name: str, drive: str, steer: str, timing: Timing) -> Loop:
    robot = ROBOTS[name]
    path = Eight(12.0, 6.0, 40.0, ramp=3.0)
    path = HolonomicPath(path, Sine(0.5, 15.0)) if robot.dimensions.sideways else path
    arm = tuple(Sine(0.2, 6.0) for _ in range(robot.dimensions.arm))
    said = {"interfaces": interfaces(robot, drive, steer), "servo": servo(robot), "safety": Safety(torque="urdf")}
    return Loop(robot, Trajectory(path, arm), ComputedTorque(), kinematic=GAINS, timing=timing, **said)


@pytest.mark.parametrize("drive", ["velocity", "effort"])
def test_a_car_on_steering_servos_of_50_hz_keeps_to_its_eight(drive: str) -> None:
    """Commands every 20 ms, a lag of 20 ms, 3 rad/s: within 10 mm."""
    robot = ROBOTS["car_arm"]
    slow = tuple(replace(pivot, rate=3.0) for pivot in robot.base.pivots)
    robot = replace(robot, base=replace(robot.base, pivots=slow))
    loop = replace(
        loop_of("car_arm", drive, "position", Timing(duration=25.0, control_period=0.02, plant_step=0.001)), robot=robot
    )
    run = loop.run()
    off = np.hypot(*run["true_pose_error"][250:, :2].T)
    assert run.outcome.status == "completed" and off.max() < 0.01, off.max()
    assert np.abs(run["nu"][:, 1]).max() < 3.0 * 1.3


@pytest.mark.parametrize("name", sorted(ROBOTS))
@pytest.mark.parametrize(("drive", "steer"), [("velocity", "position"), ("velocity", "effort"), ("effort", "velocity")])
def test_a_stepper_answers_as_the_loop_does(name: str, drive: str, steer: str) -> None:
    loop = loop_of(name, drive, steer, Timing(duration=0.3, control_period=0.004, plant_step=0.001))
    run = loop.run()
    stepper, (own, K) = Stepper.of(loop, check_gains=False), (1, ROBOTS[name].dimensions.base)
    for k, time in enumerate(run["time"].ravel()):
        told = Measurement(*(run[part][k].copy() for part in PARTS))
        asked = Setpoint(*(run[f"{part}_ref"][k].copy() for part in Setpoint.__slots__))
        command = stepper.step(float(time), told, asked)
    assert stepper.row[stepper.setup.layout.where("torque")].tobytes() == run["torque"][-1].tobytes()
    shape = run["shape"][-1][[stepper.robot.base.masters]].ravel()
    by = {"position": command.position, "velocity": command.velocity, "effort": command.effort}[steer][own:K]
    assert np.isfinite(by).all()
    if steer == "position":
        assert np.abs(by - shape).max() < 0.1
        motors = [
            stepper.robot.actuator_names.index(n) for n in stepper.robot.base.driven if n in stepper.robot.base.shape
        ]
        np.testing.assert_array_equal(np.sort(command.motor_position[motors]), np.sort(by))
    if drive == "velocity":
        rolled = stepper.robot.E_at(position_of(stepper.robot, told)).T @ stepper.hardware.split.command
        wheels = [i for i, n in enumerate(stepper.robot.actuator_names) if n not in stepper.robot.base.shape]
        there = [i for i in wheels if np.isfinite(command.motor_velocity[i])]
        np.testing.assert_allclose(command.motor_velocity[there], rolled[there], atol=1e-9)


def position_of(robot: Robot, told: Measurement) -> np.ndarray:
    position = robot.neutral_position()
    position[robot.shape_index], position[robot.arm_index] = told.shape, told.q
    return position


def test_wheels_of_one_velocity_have_one_interface() -> None:
    robot = ROBOTS["swerve_arm"]
    one, *_ = robot.actuator_names
    with pytest.raises(ConfigError, match=r"wheels by effort and velocity: one velocity of the base moves all wheels"):
        interfaces_of(robot, {one: "velocity"})
    with pytest.raises(ConfigError, match="wheels by position"):
        interfaces_of(robot, dict.fromkeys(robot.actuator_names[:4], "position"))
    kinds, on = interfaces_of(robot, {robot.actuator_names[5]: "position"})
    assert kinds[:5] == ("effort", "effort", "position", "effort", "effort") and on.sum() == 1


@settings(deadline=None, max_examples=200)
@given(
    st.floats(-3.0, 3.0),
    st.lists(st.floats(-12.0, 12.0), min_size=4, max_size=4),
    st.lists(st.floats(-3.0, 3.0), min_size=4, max_size=4),
)
def test_no_wheel_is_asked_for_more_than_it_can(u: float, rates: list[float], angles: list[float]) -> None:
    robot, d = ROBOTS["swerve_arm"], ROBOTS["swerve_arm"].dimensions
    kinds, on = interfaces_of(robot, interfaces(robot, "velocity", "velocity"))
    steering = GAINS.steering_of(robot, 0.01)
    split = split_of(robot, kinds, Servo(), 0.01, np.zeros(state_size(on, d.arm + 4)), 0.0, steering)
    position = robot.neutral_position()
    position[robot.shape_index] = angles
    split.E[:] = robot.E_at(position)
    split.command[:5] = u, *rates
    share = share_of_base(d.base, split)
    speeds = np.abs(split.E.T @ (share * split.command))[:8]
    assert (speeds[:4] <= split.wheel[:4] * (1 + 1e-12)).all()
    assert (speeds[4:] <= [pivot.rate * (1 + 1e-12) for pivot in robot.base.pivots]).all()
    if share < 1.0:
        assert np.isclose(speeds[:4], split.wheel[:4]).any()  # no slower than it must be


@settings(deadline=None)
@given(st.floats(-0.69, 0.69), st.floats(0.3, 3.0), st.floats(0.1, 0.4))
def test_a_follower_takes_the_angle_of_its_linkage(angle: float, wheelbase: float, half: float) -> None:
    """Ackermann: cot(right) - cot(left) = track / wheelbase of the king-pins, seen from above."""
    base = car(wheelbase, half, 0.0)
    places = {name: 3 + i for i, name in enumerate((*base.shape, *(wheel.joint for wheel in base.wheels)))}
    found = -followed(base.rolling_at(places), 1, angle, 0.0)  # its joint counts to the right
    if abs(angle) > 1e-3:
        assert 1 / math.tan(found) - 1 / math.tan(angle) == pytest.approx(2 * half / wheelbase, abs=1e-6)
    else:
        assert abs(found) < 2e-3


def test_a_motor_that_follows_has_the_place_of_its_master() -> None:
    robot = ROBOTS["car_arm"]
    d = robot.dimensions
    placed = np.zeros(d.motors, bool)
    placed[[2, d.motors - 1]] = True
    assert placed_motors(robot, placed) == [(1, d.arm, 2, -1), (d.dof - 1, d.arm - 1, d.motors - 1, -1)]


def test_a_stop_drives_on_along_the_curve_and_steers_no_further() -> None:
    loop = loop_of("car_arm", "velocity", "velocity", Timing(duration=3.0, control_period=0.004, plant_step=0.001))
    run, stepper = loop.run(), Stepper.of(loop, check_gains=False)
    commands = []
    for k, time in enumerate(run["time"].ravel()):
        told = Measurement(*(run[part][k].copy() for part in PARTS))
        asked = Setpoint(*(run[f"{part}_ref"][k].copy() for part in Setpoint.__slots__))
        if k == 400:
            stepper.stop()
        commands.append(stepper.step(float(time), told, asked).velocity[:2].copy())
    before, after = commands[399], np.array(commands[400:])
    assert before[0] > 0.3 and np.abs(after[:, 1]).max() == 0.0 and after[-1, 0] == 0.0
    assert (np.diff(after[:, 0]) <= 0.0).all() and after[0, 0] <= before[0]


def test_other_gains_leave_u_counted_as_it_was() -> None:
    """Wheels that have turned by half a turn roll backwards at a positive u, and go on so."""
    robot = ROBOTS["swerve_arm"]
    stepper = Stepper.of(loop_of("swerve_arm", "effort", "effort", Timing(duration=0.1)), check_gains=False)
    d, n = robot.dimensions, robot.dimensions.arm
    for k in range(80):
        shape = np.full(d.shape, min(0.05 * k, math.pi))
        stepper.step(0.004 * k, Measurement(np.zeros(3), np.zeros(d.base), np.zeros(n), np.zeros(n), shape))
    np.testing.assert_allclose(stepper.direction, [-1.0, 0.0, 0.0], atol=1e-6)
    stepper.change(kinematic=Kinematic(holonomic=(1.0, 1.0, 1.0)))
    stepper.step(0.4, Measurement(np.zeros(3), np.zeros(d.base), np.zeros(n), np.zeros(n), shape))
    np.testing.assert_allclose(stepper.direction, [-1.0, 0.0, 0.0], atol=1e-6)


def test_a_learner_counts_u_from_where_the_wheels_first_stand() -> None:
    """Wheels that stand for turning on the spot, though their angles were zero when all was compiled."""
    robot = ROBOTS["swerve_arm"]
    controller = load_experiment("track", ["robot=swerve_arm"]).controller("feedforward", robot=robot)
    d, still = robot.dimensions, np.zeros(robot.dimensions.arm)
    position = robot.steered_along(robot.neutral_position(), np.array([0.0, 0.0, 1.0]))
    stepper = Stepper(robot, controller, StepperSettings(check_gains=False))
    for k in range(3):
        stepper.step(0.002 * k, Measurement(np.zeros(3), np.zeros(d.base), still, still, position[robot.shape_index]))
    maps = stepper.control.torque.learner.known.maps
    assert abs(stepper.direction[2]) == pytest.approx(1.0)
    np.testing.assert_allclose(maps.n, stepper.direction)
    assert np.isfinite(maps.T).all()
