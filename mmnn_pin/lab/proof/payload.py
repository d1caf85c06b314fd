"""A robot that holds a load: what Psi is after a change that the network was not told of."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...model.robot import Robot, carrying
from ...signals import Array

SHARE = 0.25  # of the arm's mass, about what arms are made to carry


def usual_payload(robot: Robot) -> float:
    """A quarter of the mass that the arm moves, or of the whole robot's where it has no arm [kg]."""
    model, arm = robot.model, [robot.model.getJointId(name) for name in robot.joint_names]
    bodies = {i for joint in arm for i in model.subtrees[joint]} if arm else range(1, model.njoints)
    return float(SHARE * sum(model.inertias[i].mass for i in bodies))


def loaded(robot: Robot, mass: float) -> Robot:
    """The robot with a point mass [kg] at the tip of its arm, or at the centre of its base where it has no arm.

    The tip is the point of the last arm joint's body that is farthest from the joint, among the frames and joints
    that it carries.
    """
    joint = robot.model.getJointId(robot.joint_names[-1]) if robot.joint_names else 1
    return carrying(robot, mass, at=tuple(tip(robot.model, joint, bool(robot.joint_names))))


def tip(model: pin.Model, joint: int, of_arm: bool) -> Array:
    """Where the load is, (3,) in the joint's frame [m]."""
    points = [frame.placement.translation for frame in model.frames if frame.parentJoint == joint]
    points += [model.jointPlacements[child].translation for child in model.children[joint]]
    if not of_arm or not any(np.linalg.norm(point) > 1e-9 for point in points):
        return np.array(model.inertias[joint].lever)
    return np.array(max(points, key=np.linalg.norm))
