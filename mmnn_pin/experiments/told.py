"""The controllers of an experiment that are told something of the robot: how it moves, what a nominal one weighs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..model.robot import Robot
from ..torque.composite import CompositeNetwork
from ..torque.controller import CompiledController, Feedback
from ..torque.model_based import ComputedTorque
from .adaptive import adaptive_controller, concurrent_learner
from .controllers import KALMAN
from .kalman import kalman_controller
from .nominal import nominal_robot

if TYPE_CHECKING:
    from .experiment import Experiment

TOLD = ("adaptive", "adaptive_composite", "concurrent", "two_layer_composite", "nominal", *KALMAN)


def told_controller(experiment: Experiment, name: str, feedback: Feedback, robot: Robot | None) -> CompiledController:
    """One of `TOLD` for a robot.

    Args:
        experiment: Whose settings it has.
        name: Which.
        feedback: K, scaled where the experiment asks for it.
        robot: The robot that the controller is made for, of which only what each may know is read.

    Raises:
        ConfigError: No robot, or a nominal one that moves otherwise.
        InputError: The nominal robot cannot be loaded.
    """
    switches = experiment.learning
    told = (experiment.nominal, experiment.overrides, switches.learning)
    if name in ("adaptive", "adaptive_composite"):
        predicting = experiment.prediction if name == "adaptive_composite" else None
        return adaptive_controller(experiment.adaptive, predicting, feedback, robot, *told)
    if name == "concurrent":
        return concurrent_learner(experiment.concurrent, feedback, robot, *told)
    if name == "nominal":
        return ComputedTorque(feedback, nominal_robot(experiment.nominal, robot, experiment.overrides), name)
    if name == "two_layer_composite":
        numbers = (experiment.replay, experiment.two_layer)
        return CompositeNetwork(feedback, *numbers, rates=switches.rates, learning=switches.learning)
    return kalman_controller(getattr(experiment.kalman, KALMAN[name]), feedback, robot, *told)
