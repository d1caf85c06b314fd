"""The learners of an experiment that are told how the robot moves, and perhaps what a nominal one weighs."""

from __future__ import annotations

from ...model.base.overrides import Overrides
from ...model.regressor import Regressor
from ...model.robot import Robot
from ...torque.adaptive import Adaptive
from ...torque.adaptive_settings import Adapting, Predicting
from ...torque.concurrent import Concurrent, ConcurrentLearner
from ...torque.controller import Feedback
from .nominal import Nominal, nominal_parameters, require_robot


def adaptive_controller(
    adapting: Adapting,
    predicting: Predicting | None,
    feedback: Feedback,
    robot: Robot | None,
    nominal: Nominal,
    said: Overrides,
    learning: bool,
) -> Adaptive:
    """The adaptive controller for a robot.

    Args:
        adapting: Its settings.
        predicting: Those of its prediction error; None without one.
        feedback: K.
        robot: The true robot, of which the kinematics are read.
        nominal: The nominal robot, from which it may start.
        said: What the experiment says about its robots.
        learning: Whether it learns.

    Raises:
        ConfigError: No robot, or a nominal one that moves otherwise.
        InputError: The nominal robot cannot be loaded.
    """
    robot = require_robot(robot, "adaptive control")
    start = nominal_parameters(nominal, robot, said) if adapting.initial == "nominal" else None
    return Adaptive(Regressor.of(robot), feedback, adapting, start, learning, predicting)


def concurrent_learner(
    settings: Concurrent, feedback: Feedback, robot: Robot | None, nominal: Nominal, said: Overrides, learning: bool
) -> ConcurrentLearner:
    """The concurrent learner for a robot; arguments and errors as in `adaptive_controller`."""
    robot = require_robot(robot, "concurrent learning")
    start = nominal_parameters(nominal, robot, said) if settings.initial == "nominal" else None
    return ConcurrentLearner(Regressor.of(robot), feedback, settings, start, learning)
