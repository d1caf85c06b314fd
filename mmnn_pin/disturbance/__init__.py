"""What happens to a robot during a run: pushes, a payload, joints that fail or block, messages that are lost or wrong.

A disturbance is a table of its own, `[[disturbances]]` with a `type`. Pushes are generalized forces on one velocity of
nu: they are the `f` of `M nudot + C nu + gravity + friction = tau + f`, and the signal `disturbance` records them.
"""

from .effects import BRAKE, EARLY, mark, push
from .settings import Block, Commands, DeadMotor, Disturbance, Frozen, Messages, Payload, Push
from .tables import (
    commands,
    corruption,
    gusts,
    lateness,
    payload,
    pushes,
    require_in_time,
    require_long_enough,
    windows,
)

__all__ = [
    "BRAKE",
    "EARLY",
    "Block",
    "Commands",
    "DeadMotor",
    "Disturbance",
    "Frozen",
    "Messages",
    "Payload",
    "Push",
    "commands",
    "corruption",
    "gusts",
    "lateness",
    "mark",
    "payload",
    "push",
    "pushes",
    "require_in_time",
    "require_long_enough",
    "windows",
]
