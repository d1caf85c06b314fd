"""What stands between a controller and an ideal robot: sensors, supervisor, motors and disturbances of one run.

A loop around a robot that is measured exactly and driven perfectly has no `Hardware` (None), and compiled loops
without one are compiled without all this. Both engines call the same functions.
"""

from .chain import act, is_stopped, note, rotate, send, sense
from .new import new_hardware
from .parts import Hardware

__all__ = ["Hardware", "act", "is_stopped", "new_hardware", "note", "rotate", "send", "sense"]
