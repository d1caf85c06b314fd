"""Disturbances of a run: pushes, a payload, joints that fail or block, messages that are lost or wrong.

A disturbance is a table of its own, `[[disturbances]]` with a `type`. Pushes are generalized forces on one velocity of
nu: they are the `f` of `M nudot + C nu + gravity + friction = tau + f`, and the signal `disturbance` records them.
`settings` reads the tables, `effects` is the compiled part, `scene` what a hand touches.
"""

from .effects import BRAKE, Forces, Pushes, block
from .scene import WORK, HingedDoor, Surface, Touched, scene_of, scene_size, touched_frame
from .settings import (
    BlockedJoint,
    CommandFault,
    DeadMotor,
    FrozenEncoder,
    Messages,
    Payload,
    Push,
    commands,
    corruption,
    lateness,
    payload,
    pushes,
    require_in_time,
    require_long_enough,
    windows,
)

Disturbance = Push | Payload | DeadMotor | BlockedJoint | FrozenEncoder | Messages | CommandFault | Surface | HingedDoor
