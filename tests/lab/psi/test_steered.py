"""Runs on bases that steer are judged as others: what frozen weights know elsewhere, and what a run excited."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numba import config

from mmnn_pin import load_experiment
from mmnn_pin.lab.psi.excitation import random_motion
from mmnn_pin.lab.psi.judgement import judge
from mmnn_pin.lab.psi.subject import on_nu
from mmnn_pin.signals import Layout

SECONDS = 0.6 if config.DISABLE_JIT else 3.0
PLAIN = ["time.control_period=0.002", "time.plant_step=0.002", f"time.duration={SECONDS}"]


@cache
def run(name, learner, *said):
    experiment = load_experiment("track", [f"robot={name}", *PLAIN, *said])
    robot = experiment.load_robot()
    return experiment.loop(robot, experiment.controller(learner, robot=robot)).run(), robot


@pytest.mark.skipif(config.DISABLE_JIT, reason="minutes without compiled code")
@pytest.mark.parametrize("name", ["car_arm", "truck_trailer_arm", "swerve_arm"])
def test_what_a_learner_knows_elsewhere(name):
    """It knows the motion and saw seconds of it: its weights explain Psi on a trajectory that it never saw."""
    psi = judge(run(name, "kalman_friction")[0]).psi
    held_out = psi.frozen["held_out"].fvu[psi.halves["base"]]  # the arm saw half a period
    assert np.max(psi.online) < 0.05 and np.max(held_out) < 0.1
    assert np.ptp(psi.frozen["held_out"].psi, axis=0).min() > 0.0


@pytest.mark.parametrize("name", ["swerve_arm", "casters_arm", "car_arm"])
def test_torques_of_motors_are_those_of_the_loop(name):
    """Perfect motors behind a supervisor: what they gave acts on nu as was asked, from the first sample to the last."""
    recording, robot = run(name, "pd")
    asked = on_nu(robot, recording["position"], recording["applied"])
    np.testing.assert_allclose(asked, recording["torque"], atol=1e-9 * np.abs(recording["torque"]).max())
    assert np.ptp(recording["shape"], axis=0).max() > 1e-3


@pytest.mark.parametrize("name", ["swerve_arm", "casters_arm", "car_arm", "loader_arm"])
def test_random_motion_can_be(name):
    """Twists of random motion are those of the base velocities at the angles, of wheels along one path."""
    _, robot = run(name, "pd")
    layout = Layout.of(robot.dimensions)
    for row in random_motion(robot, layout)[:5]:
        position = robot.neutral_position()
        position[robot.shape_index] = row[layout.where("shape")]
        np.testing.assert_array_equal(robot.follow(position.copy()), position)
        eta = robot.base.eta_of(row[layout.where("velocity_ref")])
        to_root = np.linalg.inv(robot.base.to_control)
        np.testing.assert_allclose((robot.T_at(position) @ row[layout.where("nu")])[:3], to_root @ eta, atol=1e-12)
        rows = robot.A_at(position) @ robot.T_at(position)
        np.testing.assert_allclose(rows, 0.0, atol=1e-12)
