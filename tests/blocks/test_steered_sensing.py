"""Encoders on wheels and pivots of bases that steer: velocities, odometry, angles, delays; both engines alike."""

from __future__ import annotations

import numpy as np
import pytest

from mmnn_pin import Loop, Timing, load
from mmnn_pin.errors import ConfigError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.loop.loop import Start
from mmnn_pin.reference import Eight, HolonomicPath, Sine, Trajectory
from mmnn_pin.sensing import Sensor
from mmnn_pin.torque.model_based import ComputedTorque

H = 0.002
ROBOTS = {name: load(name) for name in ("car_arm", "swerve_arm", "truck_trailer_arm", "casters_arm")}


def run_of(name: str, sensor: Sensor, duration: float = 4.0, engine: str = "auto"):
    robot, gains = ROBOTS[name], Kinematic(kx=3.0, ky=16.0, kth=8.0, holonomic=(3.0, 3.0, 3.0))
    path = Eight(14.0, 7.0, 40.0, ramp=3.0)
    path = HolonomicPath(path, Sine(0.3, 15.0)) if robot.dimensions.sideways else path
    arm = tuple(Sine(0.2, 4.0) for _ in range(robot.dimensions.arm))
    timing = Timing(duration=duration, control_period=H, plant_step=H)
    loop = Loop(
        robot, Trajectory(path, arm), ComputedTorque(), kinematic=gains, timing=timing, sensor=sensor, start=Start(),
        engine=engine,
    )  # fmt: skip
    return loop.run()


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_velocities_by_differences_are_those_half_a_sample_ago(name: str) -> None:
    run = run_of(name, Sensor(velocity="difference"))
    nb, nu = ROBOTS[name].dimensions.base, run["nu"]
    between = 0.5 * (nu[1:, :nb] + nu[:-1, :nb])
    off = np.abs(run["velocity"][1:] - between)[500:]
    moved = np.abs(np.diff(nu[:, :nb], axis=0))[500:].max(axis=0)
    assert (off.max(axis=0) < 2e-3 + 0.6 * moved).all(), off.max(axis=0)


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_odometry_goes_on_as_the_base_does(name: str) -> None:
    run = run_of(name, Sensor(pose="odometry"))
    off = np.abs(run["pose"] - run["position"][:, :3])
    assert np.hypot(*np.diff(run["pose"][:, :2], axis=0).T).sum() > 1.0  # it went a way
    assert off[:, :2].max() < 2e-3 and off[:, 2].max() < 2e-3, off.max(axis=0)


@pytest.mark.parametrize("name", ["car_arm", "swerve_arm"])
def test_angles_are_read_in_steps_with_their_zero_errors_and_late(name: str) -> None:
    robot, step, delay = ROBOTS[name], 1e-3, 4
    K = robot.dimensions.shape
    offsets = tuple(2e-3 * (k + 1) for k in range(K))
    run = run_of(name, Sensor(steering_resolution=step, steering_offset=offsets, delay=delay), duration=1.0)
    steps = run["shape"] / step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    true = run["position"][:, robot.shape_index] + offsets
    assert np.abs(run["shape"][delay:] - true[:-delay]).max() <= 0.5 * step + 1e-12


def test_a_zero_error_of_the_steering_makes_a_car_drift() -> None:
    straight = run_of("car_arm", Sensor(pose="odometry"))
    askew = run_of("car_arm", Sensor(pose="odometry", steering_offset=0.02))
    heading = np.abs(askew["pose"][-1, 2] - askew["position"][-1, 2])
    assert heading > 20 * np.abs(straight["pose"][-1, 2] - straight["position"][-1, 2]) and heading > 5e-3


@pytest.mark.parametrize("velocity", ["filtered", "model"])
def test_both_engines_measure_a_car_alike(velocity: str) -> None:
    sensor = Sensor(velocity=velocity, bandwidth=150.0, pose="odometry", noise=1e-4, steering_noise=1e-4, delay=1)  # type: ignore[arg-type]
    one, other = (run_of("car_arm", sensor, 0.4, engine) for engine in ("ordinary", "compiled"))
    for signal in ("pose", "velocity", "q", "qdot", "shape", "torque"):
        assert one[signal].tobytes() == other[signal].tobytes(), signal


def test_settings_of_steering_encoders_are_numbers() -> None:
    with pytest.raises(ConfigError, match=r"sensor\.steering_offset: error: nan is not finite"):
        Sensor(steering_offset=float("nan"))
    with pytest.raises(ConfigError, match=r"sensor\.steering_noise"):
        Sensor(steering_noise=-1.0)
    with pytest.raises(ConfigError, match=r"sensor\.steering_offset"):
        run_of("car_arm", Sensor(steering_offset=(0.1, 0.2, 0.3)), 0.1)
