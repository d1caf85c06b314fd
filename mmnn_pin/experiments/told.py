"""The controllers of an experiment that are told something of the robot: how it moves, what a nominal one weighs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..model.robot import Robot
from ..torque.controller import CompiledController, Feedback
from .adaptive import adaptive_controller
from .controllers import KALMAN
from .kalman import kalman_controller

if TYPE_CHECKING:
    from .experiment import Experiment

TOLD = ("adaptive", *KALMAN)


def told_controller(experiment: Experiment, name: str, feedback: Feedback, robot: Robot | None) -> CompiledController:
    """One of `TOLD` for a robot.

    Args:
        experiment: Whose settings it has.
        name: Which.
        feedback: K, scaled where the experiment asks for it.
        robot: The true robot, of which only what each may know is read.

    Raises:
        ConfigError: No robot, or a nominal one that moves otherwise.
        InputError: The nominal robot cannot be loaded.
    """
    loaded, learning = (experiment.robot, experiment.overrides), experiment.learning.learning
    if name == "adaptive":
        return adaptive_controller(experiment.adaptive, feedback, robot, loaded, learning)
    return kalman_controller(getattr(experiment.kalman, KALMAN[name]), feedback, robot, loaded, learning)
