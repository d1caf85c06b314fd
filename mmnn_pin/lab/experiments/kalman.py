"""The linear learners of an experiment: what each of them is told of the robot."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from ...model.base.overrides import Overrides
from ...model.regressor import Regressor
from ...model.robot import Robot
from ...torque.controller import Feedback
from ...torque.kalman import KalmanLearner, Machine
from ...torque.kalman_settings import Kalman, KalmanResidual, KalmanTables
from .controllers import KALMAN
from .nominal import Nominal, nominal_parameters, require_robot


def machine_of(robot: Robot) -> Machine:
    """What a learner may know of a robot without knowing how it moves: names, and of its joints the ends and motors."""
    n, limits = robot.layout.arm, robot.effort_limits
    joints = (np.abs(robot.E) @ limits)[robot.layout.dof - n :] if np.isfinite(limits).all() else np.full(n, np.inf)
    return Machine(
        velocities=tuple(robot.velocity_names),
        lower=robot.lower[robot.arm_index],
        upper=robot.upper[robot.arm_index],
        effort=joints,
    )


def kalman_controller(
    settings: Kalman, feedback: Feedback, robot: Robot | None, nominal: Nominal, said: Overrides, learning: bool
) -> KalmanLearner:
    """A linear learner for a robot.

    Args:
        settings: Its settings.
        feedback: K.
        robot: The true robot, of which only what `machine_of` tells and, for a regressor, the kinematics are read.
        nominal: The nominal robot, for the one that is told of it.
        said: What the experiment says about its robots.
        learning: Whether it learns.

    Raises:
        ConfigError: No robot, or a nominal one that moves otherwise.
        InputError: The nominal robot cannot be loaded.
    """
    robot = require_robot(robot, settings.section)
    regressor = Regressor.of(robot) if settings.needs_regressor else None
    theta0 = None
    if isinstance(settings, KalmanResidual):
        theta0 = nominal_parameters(nominal, robot, said)
    return KalmanLearner(settings, machine_of(robot), feedback, regressor, theta0, learning)


def kalman_from_facts(name: str, facts: dict[str, Any], robot: Robot) -> KalmanLearner:
    """A linear learner from what its `facts` told a recording.

    Args:
        name: One of `KALMAN`.
        facts: `controller_settings` of the recording.
        robot: The recorded robot.

    Raises:
        InputError: Settings of another version.
    """
    kind = type(getattr(KalmanTables(), KALMAN[name]))
    settings, feedback = msgspec.convert(facts["settings"], kind), msgspec.convert(facts["feedback"], Feedback)
    regressor = Regressor.of(robot) if settings.needs_regressor else None
    theta0 = np.array(facts["theta0"]) if "theta0" in facts else None
    return KalmanLearner(settings, machine_of(robot), feedback, regressor, theta0, facts["learning"])
