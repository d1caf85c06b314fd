"""What a supervisor promises of a base that steers: its limits, its stop, its door; on robots as they are bundled."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin import PD, Measurement, Stepper, StepperSettings, load
from mmnn_pin.errors import ConfigError
from mmnn_pin.model.robot import Robot
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.reference.follower import Follower
from mmnn_pin.reference.limits import Limits
from mmnn_pin.reference.wishes import BaseVelocity
from mmnn_pin.safety import Safety
from mmnn_pin.signals import Array

ROBOTS = {name: load(name) for name in ("car_arm", "swerve_arm")}
LOADER = load("loader_arm")
NAMES = st.sampled_from(sorted(ROBOTS))
H = 0.002


def stepper(name: str, safety: Safety) -> Stepper:
    """A new stepper of a robot."""
    return Stepper(ROBOTS[name], PD(), StepperSettings(safety=safety, period=H, check_gains=False))


def measured(robot: Robot, position: Array, nu: Array) -> Measurement:
    """The exact measurement of a state."""
    d = robot.dimensions
    q, shape = position[robot.arm_index], position[robot.shape_index]
    return Measurement(position[: d.pose].copy(), nu[: d.base].copy(), q, nu[d.base :].copy(), shape)


def moving(robot: Robot, speed: float, turn: float, rate: float) -> tuple[Array, Array]:
    """A state whose wheels stand along the path of a twist, driving at a speed [m/s] while masters turn."""
    d, twist = robot.dimensions, np.zeros(robot.dimensions.twist)
    twist[0], twist[-1] = math.cos(turn), math.sin(turn)
    position = robot.steered_along(robot.neutral_position(), twist)
    nu = np.zeros(d.dof)
    nu[0] = speed
    if name_of(robot) == "car_arm":  # the masters of a swerve drive turn together, or they slide
        nu[1] = rate
    return position, nu


def name_of(robot: Robot) -> str:
    return next(name for name, one in ROBOTS.items() if one is robot)


@settings(deadline=None, max_examples=8)
@given(NAMES, st.floats(-1.5, 1.5), st.floats(-0.5, 0.5), st.floats(-1.0, 1.0))
def test_a_stop_brakes_along_the_curve_and_the_steering_holds(
    name: str, speed: float, turn: float, rate: float
) -> None:
    robot, run = ROBOTS[name], stepper(name, Safety(torque="urdf", stop_time=1.0))
    plant, (position, nu) = IdealPlant(robot, H, "rk4"), moving(robot, speed, turn, rate)
    plant.start(position, nu)
    d, began = robot.dimensions, position[robot.shape_index].copy()
    energies, speeds, angles = [], [], []
    for k in range(400):
        if k == 1:
            run.stop()
        command = run.step(k * H, measured(robot, plant.position, plant.nu))
        plant.step(robot.E_at(plant.position) @ command.motor_effort)
        plant.refresh()
        energies.append(0.5 * plant.nu[: d.base] @ plant.dynamics.M[: d.base, : d.base] @ plant.nu[: d.base])
        speeds.append(plant.nu[0])
        angles.append(plant.position[robot.shape_index].copy())
    assert run.tripped and abs(plant.nu[: d.base]).max() < 0.05
    assert max(energies) <= energies[0] * (1 + 1e-9) + 0.05  # what the arm's weight moves the base by
    assert np.abs(np.array(angles) - began).max() < 0.05 + 0.2 * abs(rate)
    assert all(one * speed >= -0.02 * abs(speed) - 1e-3 for one in speeds)  # it comes to rest and does not turn back


@settings(deadline=None, max_examples=12)
@given(NAMES, st.floats(-1.5, 1.5), st.floats(-0.5, 0.5), st.floats(0.2, 1.5), st.floats(0.1, 1.0))
def test_a_twist_trips_beyond_its_limits_and_only_there(
    name: str, speed: float, turn: float, fastest: float, yaw: float
) -> None:
    robot = ROBOTS[name]
    run = stepper(name, Safety(torque="urdf", speed=fastest, yaw_rate=yaw, wheel_speed="none", position_error="none"))
    position, nu = moving(robot, speed, turn, 0.0)
    run.step(0.0, measured(robot, position, nu))
    twist = robot.base.to_control @ (robot.T_at(position) @ nu)[:3]  # from the root's velocity in Pinocchio's model
    over = math.hypot(twist[0], twist[1]) - fastest, abs(twist[2]) - yaw
    if max(over) > 1e-9:
        assert run.tripped and "over its limit" in run.finish().outcome.message
    elif max(over) < -1e-9:
        assert not run.tripped


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_a_steering_joint_trips_by_its_rate(name: str) -> None:
    robot, run = ROBOTS[name], stepper(name, Safety(torque="urdf", steering_rate=0.5))
    position, nu = moving(robot, 0.0, 0.0, 0.0)
    nu[1] = 0.6
    run.step(0.0, measured(robot, position, nu))
    assert run.tripped and f"speed of {robot.base.pivots[0].joint} 0.6 rad/s" in run.finish().outcome.message


@settings(deadline=None, max_examples=6)
@given(NAMES, st.floats(0.3, 2.0), st.sampled_from([-1.0, 1.0]), st.integers(0, 1))
def test_a_jump_of_a_steering_angle_trips_and_is_taken_out(name: str, jump: float, sign: float, pivot: int) -> None:
    robot, run = ROBOTS[name], stepper(name, Safety(torque="urdf"))
    position, nu = moving(robot, 0.0, 0.3, 0.0)
    told = measured(robot, position, nu)
    for k in range(3):
        run.step(k * H, told)
    before = run.measured.shape.copy()
    told.shape[pivot] += sign * jump
    run.step(3 * H, told)
    assert run.tripped
    for k in range(4, 8):
        run.step(k * H, told)
        np.testing.assert_allclose(run.measured.shape, before, atol=1e-12)
    assert f"{robot.base.shape[pivot]} jumps" in run.finish().outcome.message


@settings(deadline=None, max_examples=6)
@given(st.integers(-3, 3), st.integers(0, 3))
def test_an_encoder_that_wraps_goes_on(turns: int, pivot: int) -> None:
    robot, run = ROBOTS["swerve_arm"], stepper("swerve_arm", Safety(torque="urdf"))
    position, nu = moving(robot, 0.0, 0.3, 0.0)
    told = measured(robot, position, nu)
    run.step(0.0, told)
    before = run.measured.shape.copy()
    told.shape[pivot] += math.tau * turns
    run.step(H, told)
    assert not run.tripped
    np.testing.assert_allclose(run.measured.shape, before, atol=1e-12)


def test_angles_that_are_none_or_too_few_are_refused() -> None:
    robot, run = ROBOTS["car_arm"], stepper("car_arm", Safety(torque="urdf"))
    position, nu = moving(robot, 0.2, 0.3, 0.0)
    told = measured(robot, position, nu)
    run.step(0.0, told)
    kept = run.measured.shape.copy()
    told.shape[0] = math.nan
    run.step(H, told)
    np.testing.assert_array_equal(run.measured.shape, kept)
    assert "refused 1 measurement" in run.finish().outcome.message
    fewer = Measurement(told.pose, told.velocity, told.q, told.qdot, kept[:1])
    with pytest.raises(ConfigError, match=r"shape of shape \(1,\)"):
        run.step(2 * H, fewer)


def test_a_reset_takes_angles_as_they_are_read() -> None:
    robot, run = ROBOTS["car_arm"], stepper("car_arm", Safety(torque="urdf"))
    told = measured(robot, *moving(robot, 0.0, 0.1, 0.0))
    run.step(0.0, told)
    told.shape[:] += 0.3
    for k in range(1, 4):
        run.step(k * H, told)
    run.reset()
    run.step(4 * H, told)
    assert not run.tripped
    np.testing.assert_allclose(run.measured.shape, told.shape)


@pytest.mark.parametrize("rate", [0.8, -0.8])
def test_a_loader_brakes_while_its_waist_turns(rate: float) -> None:
    """Its wheels brake as much as they can; the waist has its own torque, or the brakes would fold it."""
    run = Stepper(LOADER, PD(), StepperSettings(safety=Safety(torque="urdf"), period=H, check_gains=False))
    plant, nu = IdealPlant(LOADER, H, "rk4"), np.zeros(LOADER.dimensions.dof)
    position = LOADER.neutral_position()
    position[LOADER.shape_index] = 0.4 * np.sign(rate)
    nu[:2] = 1.4, rate
    plant.start(position, nu)
    for k in range(600):
        if k == 1:
            run.stop()
        command = run.step(k * H, measured(LOADER, plant.position, plant.nu))
        plant.step(LOADER.E_at(plant.position) @ command.motor_effort)
        plant.refresh()
        assert np.all(np.abs(command.motor_effort) <= LOADER.effort_limits * (1 + 1e-9))
    assert np.abs(plant.nu[:2]).max() < 0.05


def test_a_trailer_is_not_pushed_by_a_jog():
    robot = load("truck_trailer_arm")
    follower = Follower(robot, Limits(), 0.5)
    follower.check(BaseVelocity((0.3, 0.1)))
    with pytest.raises(ConfigError, match=r"backwards with a trailer.*folds up.*kinematic.guide"):
        follower.check(BaseVelocity((-0.1, 0.0)))
    Follower(load("loader_arm"), Limits(), 0.5).check(BaseVelocity((-0.1, 0.0)))
