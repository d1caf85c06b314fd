"""The controllers of an experiment: each with its settings, and with what it is told of the robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...model.robot import Robot
from ...signals import Array
from ...torque.composite import CompositeNetwork
from ...torque.controller import CompiledController, Feedback, TorqueController
from ...torque.model_based import PD, ComputedTorque, ScheduledPD
from ...torque.neural import Neural
from ...torque.neural_settings import Robust
from ...torque.residual import PROJECTION, Residual
from .adaptive import adaptive_controller, concurrent_learner
from .controllers import EFFECTIVE, KALMAN
from .kalman import kalman_controller
from .laws import own_controller
from .nominal import nominal_robot

if TYPE_CHECKING:
    from .experiment import Experiment


def new_controller(
    experiment: Experiment, name: str, gains: Array | None, robot: Robot | None
) -> CompiledController | TorqueController:
    """A controller by name; arguments and errors as in `Experiment.controller`."""
    feedback, robust, inertia = scaled(experiment, name, robot)
    learning = experiment.learning.learning
    told = (experiment.nominal, experiment.overrides, learning)
    if name in experiment.laws:
        return own_controller(name, experiment.laws[name], feedback, learning)
    if name in KALMAN:
        return kalman_controller(getattr(experiment.kalman, KALMAN[name]), feedback, robot, *told)
    if name in EFFECTIVE:
        assert gains is not None
        return ScheduledPD(gains, name)
    match name:
        case "pd":
            return PD(feedback)
        case "computed_torque":
            return ComputedTorque(feedback)
        case "nominal":
            return ComputedTorque(feedback, nominal_robot(experiment.nominal, robot, experiment.overrides), name)
        case "adaptive":
            return adaptive_controller(experiment.adaptive, None, feedback, robot, *told)
        case "adaptive_composite":
            return adaptive_controller(experiment.adaptive, experiment.prediction, feedback, robot, *told)
        case "concurrent":
            return concurrent_learner(experiment.concurrent, feedback, robot, *told)
        case "two_layer_composite":
            return CompositeNetwork(
                feedback,
                experiment.replay,
                experiment.two_layer,
                rates=experiment.learning.rates,
                learning=learning,
                inertia=None if inertia is None else tuple(inertia.tolist()),
            )
        case "two_layer_residual":
            believed = nominal_robot(experiment.nominal, robot, experiment.overrides)
            return Residual(
                networks(experiment, name, feedback, robust, inertia),
                believed,
                learning,
                PROJECTION if experiment.learning.projection is None else experiment.learning.projection,
            )
        case _:
            return networks(experiment, name, feedback, robust, inertia)


def scaled(experiment: Experiment, name: str, robot: Robot | None) -> tuple[Feedback, Robust, Array | None]:
    """Feedback and robust term of a controller, and the effective inertias (p,) that both are scaled by, or None."""
    feedback, robust = experiment.feedback, experiment.robust_term(name)
    inertia = None if robot is None else experiment.inertia(robot)
    if robot is not None and inertia is not None:
        feedback, robust = feedback.scaled(robot.layout, inertia), robust.scaled(robot.layout, inertia)
    return feedback, robust, inertia


def networks(experiment: Experiment, name: str, feedback: Feedback, robust: Robust, inertia: Array | None) -> Neural:
    """The thesis's controller with the networks of a name."""
    switches = experiment.learning
    return Neural(
        network=experiment.network(name),
        feedback=feedback,
        robust=robust if switches.robust_term else None,
        inertia=None if inertia is None else tuple(inertia.tolist()),
        inputs=experiment.inputs,
        rates=switches.rates,
        learning=switches.learning,
        leakage=switches.leakage,
        update=switches.update,
        projection=switches.projection,
        called=name,
    )
