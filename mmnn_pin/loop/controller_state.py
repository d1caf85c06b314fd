"""A controller's memory around a run: a new one, one of an earlier run that fits, and what it shows at the end."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

from ..errors import ConfigError, InputError
from ..given_arrays import given_array
from ..recording.recording import Outcome
from ..torque.controller import CompiledController, Context, ControllerState, TorqueController
from ..torque.learning_law import LearningLaw, blamed


def state_from(controller: CompiledController | TorqueController, context: Context, given: Any = None) -> Any:
    """A copy of a memory that fits a controller; a new one for None.

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
            f"not a memory of {controller.name} with these settings",
            why=f"it is {is_of}, not {new.shapes}",
            fix="use one made by its init",
            key="memory",
        )
    new.values[:] = given_array("memory", given.values, new.values.shape)
    return new


def new_state(controller: CompiledController | TorqueController, context: Context) -> Any:
    """What a controller's `init` gives.

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
            raise ConfigError(what, why="a law learns in a `ControllerState`", fix="return Memory.of(name=shape, ...)")
        controller.weights(new)
    return new


def findings_of(controller: CompiledController | TorqueController, state: Any) -> list[str]:
    """What a controller's memory shows after a run; of one in plain Python that fails, where: the run is kept."""
    if isinstance(controller, CompiledController):
        return controller.findings(state)
    try:
        return [str(text) for text in controller.findings(state)]
    except Exception as error:
        return [f"its findings are lost: {blamed(error, controller)}"]


def told_with(outcome: Outcome, controller: CompiledController | TorqueController, state: Any) -> Outcome:
    """An outcome whose message also tells what the controller's memory shows after the run."""
    if outcome.status == "interrupted":
        return outcome
    findings = findings_of(controller, state)
    return replace(outcome, message="; ".join(text for text in (outcome.message, *findings) if text))
