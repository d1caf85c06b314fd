"""Joints and inertias stand where Pinocchio's own parser puts them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from robots import fixed_arm, mobile_arm

from mmnn_pin import Robot, load
from mmnn_pin.model.robots import robot_data


def assert_placed_as_by_pinocchio(robot: Robot) -> None:
    root = (pin.JointModelPlanar(), "root_joint") if robot.dimensions.base else ()
    theirs, ours = pin.buildModelFromXML(robot.urdf, *root), robot.model
    for j in range(1, theirs.njoints):
        at = ours.jointPlacements[j].homogeneous
        np.testing.assert_allclose(at, theirs.jointPlacements[j].homogeneous, atol=2e-15)
        matrix = theirs.inertias[j].matrix()
        np.testing.assert_allclose(ours.inertias[j].matrix(), matrix, atol=1e-14 * np.abs(matrix).max())


@pytest.mark.parametrize("joints", [1, 4, 7])
def test_arms_with_any_axes_and_tilted_inertias(joints: int) -> None:
    assert_placed_as_by_pinocchio(mobile_arm(joints, seed=joints))
    assert_placed_as_by_pinocchio(fixed_arm(joints, seed=joints))


@pytest.mark.skipif(robot_data() is None, reason="example-robot-data is not installed")
@pytest.mark.parametrize("name", ["tiago", "tiago_pro", "panda", "baxter"])
def test_other_robots_with_welded_links(name: str) -> None:
    assert_placed_as_by_pinocchio(load(name))
