"""A controller around a run: its context, its state before and after."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

from ..errors import ConfigError, InputError
from ..model.regressor import Regressor
from ..model.robot import Robot
from ..recording.recording import Outcome
from ..settings import given_array
from ..torque.controller import CompiledController, Context, ControllerState, TorqueController
from ..torque.law import motor_limits
from ..torque.learning_law import LearningLaw, blamed


def state_from(controller: CompiledController | TorqueController, context: Context, given: Any = None) -> Any:
    """A copy of a state that fits a controller; a new one for None.

    Raises:
        ConfigError: It is of another controller or of other settings, or not finite.
    """
    new = new_state(controller, context)
    if given is None:
        return new
    if not isinstance(new, ControllerState):
        return copy.deepcopy(given)
    if not isinstance(given, ControllerState) or given.shapes != new.shapes:
        is_of = given.shapes if isinstance(given, ControllerState) else type(given).__name__
        raise ConfigError(
            f"not a state of {controller.name} with these settings",
            why=f"it is {is_of}, not {new.shapes}",
            fix="use one made by its init",
            key="state",
        )
    new.values[:] = given_array("state", given.values, new.values.shape)
    return new


def new_state(controller: CompiledController | TorqueController, context: Context) -> Any:
    """A new state of a controller, by its `init`.

    Raises:
        InputError: It fails, or a learning law gives something else than a `ControllerState`.
    """
    if isinstance(controller, CompiledController):
        return controller.init(context)
    try:
        new = controller.init(context)
    except InputError:
        raise
    except Exception as error:
        raise blamed(error, controller) from error
    if isinstance(controller, LearningLaw):
        if not isinstance(new, ControllerState):
            what = f"{controller.name}.init returned {type(new).__name__}"
            raise ConfigError(
                what, why="a law learns in a `ControllerState`", fix="return ControllerState.of(name=shape, ...)"
            )
        controller.weights(new)
    return new


def findings_of(controller: CompiledController | TorqueController, state: Any) -> list[str]:
    """Findings in a controller's state after a run; where one in plain Python fails, a line that says where instead."""
    if isinstance(controller, CompiledController):
        return controller.findings(state)
    try:
        return [str(text) for text in controller.findings(state)]
    except Exception as error:
        return [f"its findings are lost: {blamed(error, controller)}"]


def with_findings(outcome: Outcome, controller: CompiledController | TorqueController, state: Any) -> Outcome:
    """An outcome whose message also tells what the controller's state shows after the run."""
    if outcome.status == "interrupted":
        return outcome
    findings = findings_of(controller, state)
    return replace(outcome, message="; ".join(text for text in (outcome.message, *findings) if text))


REGRESSORS: WeakKeyDictionary[Robot, Regressor] = WeakKeyDictionary()


def context_of(
    controller: CompiledController | TorqueController,
    robot: Robot,
    context: Context,
    within_limits: bool | None = None,
) -> Context:
    """A context with the limits of the robot, and with its regressor only where a learning law asks for it.

    Args:
        controller: The controller that is told it before a run.
        robot: Its robot.
        context: All else of the context.
        within_limits: Whether Psi_hat is kept within the motors' limits; None for what the controller says.
    """
    told = isinstance(controller, LearningLaw) and controller.knows_motion
    kept = controller.within_limits if within_limits is None else within_limits
    limits = motor_limits(robot.E_at(robot.rest), robot.effort_limits) if kept else None
    return replace(context, regressor=regressor_of(robot) if told else None, limits=limits)


def regressor_of(robot: Robot) -> Regressor:
    """The regressor of a robot, made once.

    Raises:
        RobotError: A joint that cannot be flattened.
    """
    if robot not in REGRESSORS:
        REGRESSORS[robot] = Regressor.of(robot)
    return REGRESSORS[robot]
