"""The parameters theta of a robot that is known, in the order of `mmnn_pin.model.regressor`."""

from __future__ import annotations

import numpy as np

from ..signals import Array
from .regressor import inertial_parameters, moving_joints
from .robot import Robot
from .tree.tree import flatten


def parameters(robot: Robot) -> Array:
    """Parameters of a robot, (k,): `Y theta` is its Psi where dry friction is Coulomb's alone (no `breakaway`).

    Friction on a joint's velocity counts as friction of the joint.

    Raises:
        RobotError: A joint that cannot be flattened.
    """
    layout, T = robot.layout, np.array(robot.T)
    frame = tuple(robot.frame) if layout.base else (0.0, 0.0, 0.0)
    tree = flatten(robot.model, T, robot.neutral_position(), frame, absorb=False)
    moving, viscous = moving_joints(T, layout.base), robot.damping.copy()
    viscous[robot.arm_index] += robot.viscous[layout.base :]
    return np.concatenate(
        (
            inertial_parameters(tree, layout.base),
            robot.model.armature[moving],
            robot.viscous[: layout.base],
            viscous[moving],
            robot.coulomb[moving],
        )
    )
