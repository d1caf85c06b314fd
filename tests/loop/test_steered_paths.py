"""Bases that steer along their own kinds of paths, in the closed loop: parking, reverse, a heading free of the path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mmnn_pin import Loop, Measurement, Stepper, StepperSettings, Timing, load, load_experiment, run_experiment
from mmnn_pin.errors import ConfigError, TrajectoryError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.lab.show.curves import path
from mmnn_pin.lab.show.replay.motion import base_reference
from mmnn_pin.loop.loop import Start
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.recording.recording import Recording, guided_pose
from mmnn_pin.reference import Eight, HolonomicPath, Parking, Sine, Trajectory
from mmnn_pin.reference.path import BasePath
from mmnn_pin.reference.steerable import curvatures
from mmnn_pin.reference.wishes import BaseVelocity
from mmnn_pin.safety import Safety
from mmnn_pin.torque.model_based import ComputedTorque

ROOT = Path(__file__).parents[2]
GAINS = Kinematic(kx=3.0, ky=16.0, kth=8.0, holonomic=(3.0, 3.0, 3.0))


def driven(name: str, path: BasePath, duration: float) -> Recording:
    robot = load(name)
    timing = Timing(duration=duration, control_period=0.002, plant_step=0.002, integrator="implicit_friction")
    run = Loop(robot, Trajectory.of(robot, path), ComputedTorque(), kinematic=GAINS, timing=timing).run()
    assert run.outcome.status == "completed"
    for pivot in robot.base.pivots:
        place = robot.full_velocity_names.index(pivot.joint)
        assert np.all((run["position"][:, place] > pivot.lower) & (run["position"][:, place] < pivot.upper))
    return run


def errors(run: Recording) -> np.ndarray:
    return np.hypot(*run["true_pose_error"][:, :2].T)


def test_a_car_parks_in_three_strokes():
    path = Parking(-1.2, 1.02 / curvatures(load("car_arm").base)[1], 0.4, strokes=3)
    run = driven("car_arm", path, round(path.duration + 0.5, 1))
    assert errors(run).max() < 2e-3
    assert run["pose"][-1] == pytest.approx((-path.room, -1.2, 0.0), abs=2e-3)


def test_a_car_drives_an_eight_in_reverse():
    assert errors(driven("car_arm", Eight(10.0, 5.0, -30.0, ramp=2.0), 8.0)).max() < 1e-3


def test_a_swerve_drive_turns_along_an_eight():
    path = HolonomicPath(Eight(3.0, 1.5, 20.0, ramp=2.0), Sine(0.8, 16.0))
    run = driven("swerve_arm", path, 8.0)
    assert errors(run)[1000:].max() < 2e-3 and np.ptp(run["pose"][:, 2]) > 0.7


def test_a_truck_backs_its_trailer_into_a_gap():
    """examples/backing.toml; pictures compare the trailer with its path, and show the truck as it stands to it."""
    changes = ["controllers=['computed_torque']", "time.duration=19.5", "windows=[[2.0, 19.5]]"]
    (run,) = run_experiment(load_experiment(ROOT / "examples/backing.toml", changes), "backing").recordings.values()
    assert errors(run).max() < 1e-3
    assert guided_pose(run)[-1] == pytest.approx([-6.77, -1.5, 0.0], abs=0.03)
    truck = run["pose"] - guided_pose(run)
    assert np.hypot(*truck[:, :2].T) == pytest.approx(0.84, abs=0.02)  # 0.14 m to the hitch, 0.7 m from there
    (_, gaps) = path({"computed_torque": run})
    assert gaps.curves["computed_torque"][1] == pytest.approx(1e3 * errors(run))
    assert base_reference(run) == pytest.approx(run["pose"], abs=1e-3)


def test_a_path_that_is_too_tight_moves_nothing():
    with pytest.raises(TrajectoryError, match=r"the path bends by .* times as large"):
        driven("car_arm", Eight(3.0, 1.5, 20.0, ramp=2.0), 10.0)


@pytest.mark.parametrize("asked", [(-0.4, 0.05), (-0.3, -0.1), (0.3, -0.1)])
def test_a_loader_moves_at_the_velocity_asked_whichever_axle_leads(asked: tuple[float, float]) -> None:
    robot, h = load("loader_arm"), 0.002
    stepper = Stepper(robot, ComputedTorque(), StepperSettings(safety=Safety(torque="urdf"), period=h))
    plant, d = IdealPlant(robot, h, "rk4"), robot.dimensions
    plant.start(robot.neutral_position(), np.zeros(d.dof))
    for k in range(3000):
        q, shape = plant.position[robot.arm_index], plant.position[robot.shape_index]
        measured = Measurement(
            plant.position[:3].copy(), plant.nu[: d.base].copy(), q, plant.nu[d.base :].copy(), shape
        )
        plant.step(robot.E_at(plant.position) @ stepper.step(k * h, measured, BaseVelocity(asked)).motor_effort)
        plant.refresh()
    moved = robot.base.to_control @ (robot.T_at(plant.position) @ plant.nu)[:3]
    assert moved[[0, 2]] == pytest.approx(asked, abs=5e-3)


@pytest.mark.parametrize("start", [(-0.3, 0.3, 0.5), (-0.2, -0.3, -0.5)])
def test_a_car_far_from_its_path_turns_no_wheel_beyond_its_stops(start: tuple[float, float, float]) -> None:
    robot = load("car_arm")
    trajectory, timing = Trajectory.of(robot, Eight(14.0, 7.0, 50.0, ramp=3.0)), Timing(duration=6.0)
    run = Loop(robot, trajectory, ComputedTorque(), kinematic=GAINS, timing=timing, start=Start(start)).run()
    for pivot, angles in zip(robot.base.pivots, run["shape"].T, strict=True):
        assert pivot.lower - 0.01 < angles.min() and angles.max() < pivot.upper + 0.01
    assert np.abs(run["shape"]).max() > 0.9 * robot.base.pivots[0].upper


@pytest.mark.parametrize("name", ["tricycle_arm", "swerve_arm"])
def test_wheels_that_pass_their_paths_in_one_sample_are_refused_and_advice_works(name: str):
    robot, eight, timing = load(name), Eight(14.0, 7.0, 50.0, ramp=3.0), Timing(duration=2.0)
    trajectory = Trajectory.of(robot, HolonomicPath(eight) if robot.dimensions.sideways else eight)
    with pytest.raises(ConfigError, match="passes its path in one sample") as refused:
        Loop(robot, trajectory, ComputedTorque(), kinematic=Kinematic(steering=2000.0), timing=timing).run()
    most = float(str(refused.value.fix).removeprefix("take at most "))
    gains = Kinematic(3.0, 16.0, 8.0, holonomic=(3.0, 3.0, 3.0), steering=most)
    assert errors(Loop(robot, trajectory, ComputedTorque(), kinematic=gains, timing=timing).run()).max() < 0.03
