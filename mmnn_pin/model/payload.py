"""A robot that carries a point mass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from ..errors import ConfigError, UnknownName
from .bodies import bodies_of
from .robot import Robot


def carrying(robot: Robot, mass: float, joint: str = "", at: Sequence[float] = (0.0, 0.0, 0.0)) -> Robot:
    """The same robot with a point mass on a link.

    Args:
        robot: The robot.
        mass: [kg].
        joint: Joint whose link carries it; empty for the last of the arm, or the base where there is no arm.
        at: Where, (3,) in that joint's frame [m].

    Raises:
        UnknownName: It has no such joint.
        ConfigError: A joint that stands still, or numbers that cannot be used.
    """
    names = bodies_of(robot.model)
    joint = joint or (robot.joint_names[-1] if robot.joint_names else "root")
    if joint not in names:
        raise UnknownName("joint", joint, names, key="joint")
    if not (np.isfinite(mass) and mass > 0 and np.shape(at) == (3,) and np.isfinite(at).all()):
        raise ConfigError(f"{mass} kg at {at}", fix="give a mass > 0 and three finite numbers", key="mass")
    model = robot.model.copy()
    i = names.index(joint) + 1
    model.inertias[i] = model.inertias[i] + pin.Inertia(mass, np.array(at, float), np.zeros((3, 3)))
    return replace(robot, model=model)
