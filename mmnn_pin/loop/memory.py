"""A controller's memory around a run: a new one, one of an earlier run that fits, and what it shows at the end."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

from ..errors import ConfigError, InputError
from ..given_arrays import given_array
from ..recording.recording import Outcome
from ..torque.controller import CompiledController, Memory, TorqueController, Wiring
from ..torque.learning_law import LearningLaw
from ..torque.origin import blamed


def memory_from(controller: CompiledController | TorqueController, wiring: Wiring, given: Any = None) -> Any:
    """A copy of a memory that fits a controller; a new one for None.

    Raises:
        ConfigError: It is of another controller or of other settings, or not finite.
    """
    new = new_memory(controller, wiring)
    if given is None:
        return new
    if not isinstance(new, Memory):
        return copy.deepcopy(given)
    if not isinstance(given, Memory) or given.shapes != new.shapes:
        is_of = given.shapes if isinstance(given, Memory) else type(given).__name__
        raise ConfigError(
            f"not a memory of {controller.name} with these settings",
            why=f"it is {is_of}, not {new.shapes}",
            fix="use one made by its init",
            key="memory",
        )
    new.values[:] = given_array("memory", given.values, new.values.shape)
    return new


def new_memory(controller: CompiledController | TorqueController, wiring: Wiring) -> Any:
    """What a controller's `init` gives.

    Raises:
        InputError: It fails, or a learning law gives something else than a `Memory`.
    """
    if isinstance(controller, CompiledController):
        return controller.init(wiring)
    try:
        new = controller.init(wiring)
    except InputError:
        raise
    except Exception as error:
        raise blamed(error, controller) from error
    if isinstance(controller, LearningLaw):
        if not isinstance(new, Memory):
            what = f"{controller.name}.init returned {type(new).__name__}"
            raise ConfigError(what, why="a law learns in a `Memory`", fix="return Memory.of(name=shape, ...)")
        controller.weights(new)
    return new


def findings_of(controller: CompiledController | TorqueController, memory: Any) -> list[str]:
    """What a controller's memory shows after a run; of one in plain Python that fails, where: the run is kept."""
    if isinstance(controller, CompiledController):
        return controller.findings(memory)
    try:
        return [str(text) for text in controller.findings(memory)]
    except Exception as error:
        return [f"its findings are lost: {blamed(error, controller)}"]


def told_with(outcome: Outcome, controller: CompiledController | TorqueController, memory: Any) -> Outcome:
    """An outcome whose message also tells what the controller's memory shows after the run."""
    if outcome.status == "interrupted":
        return outcome
    findings = findings_of(controller, memory)
    return replace(outcome, message="; ".join(text for text in (outcome.message, *findings) if text))
