"""Where the robot should be: sources of setpoints, made of paths of the base and profiles of the arm.

A base path gives the pose of the control frame and, in the reference's own frame, the base velocity and its time
derivative, all of them analytic. `Trajectory` puts base and arm together.
"""

from .holonomic import HolonomicPath
from .joint import Hold, JointProfile, JointSamples, JointTable, MinimumJerk, Points, Sine, Sines
from .path import BasePath, BaseSamples, Circle, Eight, Line, Parking, Waypoints
from .samples import BaseTable, check_followable, warnings
from .timed import Smoothed, Timed
from .trajectory import SetpointSource, Trajectory
