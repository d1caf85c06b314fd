"""What stands between a controller and an ideal robot: sensors, supervisor, motors and disturbances of one run.

A loop around a robot that is measured exactly and driven perfectly has no `Rig` (None), and compiled loops without one
are compiled without all this. Both engines call the same functions.
"""

from .chain import act, is_stopped, note, rotate, send, sense
from .new import new_rig
from .parts import Rig

__all__ = ["Rig", "act", "is_stopped", "new_rig", "note", "rotate", "send", "sense"]
