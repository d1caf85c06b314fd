"""The adaptive controller of an experiment: told how the robot moves, and perhaps what a nominal one weighs."""

from __future__ import annotations

import numpy as np

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
    name, said = loaded
    nominal = load_with(adapting.nominal or name, said)
    if nominal.layout != robot.layout or not np.array_equal(nominal.T, robot.T):
        fix = "name one with the same base and the same joints"
        raise ConfigError(f"{nominal.name} does not move as {robot.name}", fix=fix, key="adaptive.nominal")
    return Adaptive(regressor, feedback, adapting, parameters(nominal.with_masses(adapting.masses)), learning)
