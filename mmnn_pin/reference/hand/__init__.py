"""Tasks of the hand: whole-body motion of base and arm, in which side-slip cannot be asked for.

chain      where a frame is and how it moves: `J S`, compiled
tasks      what frames should keep to, what limits base, joints and wheels
whole_body one quadratic program per control sample
path       lines, circles, splines, poses from a file
motion     made ahead of a run, as setpoints: drive there, reach, follow
capsules   bodies that keep apart
"""

from .capsules import Capsule
from .motion import HandMotion, comfortable, plan
from .online import FollowHand, HandCourse, HandWish, WishedCourse
from .path import HandCircle, HandLine, HandPath, HandSpline, Pieces, Wait
from .tasks import Task, WholeBodySettings
from .whole_body import WholeBody
