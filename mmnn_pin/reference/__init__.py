"""Where the robot should be: paths of the base and profiles of the arm, sampled ahead of a run.

A base path gives the pose of the control frame and, in the reference's own frame, the base velocity and its time
derivative, all of them analytic. `Trajectory.table` writes base and arm into rows as the loop reads them.
"""

from .arm import Hold, JointProfile, JointSamples, MinimumJerk, Sine, Sines
from .curves import Circle, Eight, Line
from .holonomic import Holonomic
from .path import BasePath, BaseSamples
from .samples import Table, check_followable, warnings
from .trajectory import Trajectory
from .waypoints import Waypoints

__all__ = [
    "BasePath",
    "BaseSamples",
    "Circle",
    "Eight",
    "Hold",
    "Holonomic",
    "JointProfile",
    "JointSamples",
    "Line",
    "MinimumJerk",
    "Sine",
    "Sines",
    "Table",
    "Trajectory",
    "Waypoints",
    "check_followable",
    "warnings",
]
