"""The two engines that step a loop, and which of them one asks for.

The compiled loop has no Python in it; the ordinary loop takes any controller and any robot. They call the same blocks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..errors import ConfigError, RobotError
from ..signals import Array
from ..torque.controller import TorqueController
from .compiled import CompiledLoop
from .ordinary import OrdinaryLoop

if TYPE_CHECKING:
    from .loop import Loop

Engine = CompiledLoop | OrdinaryLoop
BLOCK = 250  # most samples that an engine hands over at a time


def new_engine(
    loop: Loop, table: Array, position: Array, nu: Array, state: Any, hardware_state: Array | None = None
) -> Engine:
    """The engine that a loop asks for; arguments as in `OrdinaryLoop`.

    Raises:
        ConfigError: The compiled engine is asked for and cannot run this controller or this plant.
        RobotError: It is asked for and the robot cannot be flattened.
    """
    block = max(1, min(BLOCK, round(loop.weights_interval / loop.timing.control_period)))
    arguments = (loop, table, position, nu, state, hardware_state, block)
    if loop.engine == "compiled":
        require_compilable(loop)
        return CompiledLoop(*arguments)
    if loop.engine == "auto" and not isinstance(loop.controller, TorqueController) and loop.plant == "ideal":
        try:
            return CompiledLoop(*arguments)
        except RobotError:  # a joint that cannot be flattened
            pass
    return OrdinaryLoop(*arguments)


def require_compilable(loop: Loop) -> None:
    """Refuse the compiled engine to a loop with Python or MuJoCo in it.

    Raises:
        ConfigError: It has.
    """
    if isinstance(loop.controller, TorqueController):
        what, why, fix = "a controller in plain Python cannot be compiled", "", "use engine = 'auto'"
    elif loop.plant == "contact":
        what, why = "the contact plant cannot be compiled", "MuJoCo steps it, the ordinary loop only"
        fix = "use engine = 'auto', or the ideal plant"
    else:
        return
    raise ConfigError(what, why=why, fix=fix, key="engine")
