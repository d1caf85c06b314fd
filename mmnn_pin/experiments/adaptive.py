"""The adaptive controller of an experiment: told how the robot moves, and perhaps what a nominal one weighs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..model.overrides import Overrides
from ..model.parameters import parameters
from ..model.regressor import Regressor
from ..model.robot import Robot, load_with
from ..torque.adaptive import Adapting, Adaptive
from ..torque.controller import Feedback


def adaptive_controller(
    adapting: Adapting, feedback: Feedback, robot: Robot | None, loaded: tuple[str, Overrides], learning: bool
) -> Adaptive:
    """The adaptive controller for a robot.

    Args:
        adapting: Its settings.
        feedback: K.
        robot: The true robot, of which the kinematics are read.
        loaded: What the experiment calls it, and what it says about it: where nominal masses come from.
        learning: Whether it learns.

    Raises:
        ConfigError: No robot, or a nominal one that moves otherwise.
        InputError: The nominal robot cannot be loaded.
    """
    if robot is None:
        raise ConfigError("adaptive control of no robot", fix="give the robot", key="controllers")
    regressor = Regressor.of(robot)
    if adapting.initial != "nominal":
        return Adaptive(regressor, feedback, adapting, learning=learning)
    theta = nominal_parameters(robot, adapting.nominal, adapting.masses, loaded, "adaptive.nominal")
    return Adaptive(regressor, feedback, adapting, theta, learning)


def nominal_parameters(
    robot: Robot, nominal: str, masses: float, loaded: tuple[str, Overrides], key: str
) -> NDArray[np.float64]:
    """Parameters of the robot that a learner believes in, in the order of the true robot's regressor.

    Args:
        robot: The true robot.
        nominal: Name or path of the other one; empty for the robot itself.
        masses: Factor on its masses.
        loaded: As in `adaptive_controller`.
        key: Of the setting that names it, for errors.

    Raises:
        ConfigError: It moves otherwise.
        InputError: It cannot be loaded.
    """
    name, said = loaded
    other = load_with(nominal or name, said)
    if other.layout != replace(robot.layout, wheels=0, rig=0) or not np.array_equal(other.T, robot.T):
        fix = "name one with the same base and the same joints"
        raise ConfigError(f"{other.name} does not move as {robot.name}", fix=fix, key=key)
    return parameters(other.with_masses(masses))
