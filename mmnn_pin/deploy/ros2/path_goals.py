"""Goals of `nav2_msgs/FollowPath`: a path of the base to its end, as `plan` has it, with an answer.

What Nav2 sends anew every second goes on at speed where it leads along the present motion. The node's own checks of
goal and progress count; the names of Nav2's plugins do not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from ...reference.wishes import Motion
from ...signals import Array
from .goals import GiveWay, Goal, Goals
from .mapped import Followed, MappedRoute
from .planned import Made, Planner, Refused, RobotSituation, rest_of
from .sensing import Clock, wrapped
from .settings import PlannedPath

NONE, UNKNOWN, NO_FRAME, INVALID_PATH, NO_PROGRESS, NO_CONTROL = 0, 100, 102, 103, 105, 106  # of Nav2


@dataclass
class PathGoal(Goal):
    """A path of the base."""

    ways: Array = field(default_factory=lambda: np.zeros(1))  # (N,) way that is left at every sample of its motion [m]
    period: float = 1.0  # between two of them [s]
    found: Followed | None = None  # its motion, and where that lies

    @property
    def distance(self) -> float:
        """The way that is left [m]."""
        return float(self.ways[max(len(self.ways) - 1 - round(max(self.left, 0.0) / self.period), 0)])


class PathGoals(Goals):
    """The goals of one robot's base.

    Args:
        planner: Makes motions.
        give_way: As in `Goals`.
        route: What the base follows.
        path: Makes the motion of a path.
        settings: Tolerances.
        rate: Of the feedback [1/s].
        told: Makes the feedback's message, of the distance [m] and the speed [m/s].
    """

    CANCELED: ClassVar[int] = NONE
    REPLACED: ClassVar[int] = UNKNOWN

    def __init__(
        self,
        planner: Planner,
        give_way: GiveWay,
        route: MappedRoute,
        path: Callable[[Any], Made],
        settings: PlannedPath,
        rate: float,
        told: Callable[[float, float], Any],
    ) -> None:
        super().__init__(planner, give_way, rate)
        self.route, self.path, self.settings, self.message = route, path, settings, told

    def goal(self, handle: Any) -> Goal:
        """See `Goals.goal`."""
        return PathGoal(handle)

    def since(self, request: Any, clock: Clock) -> float:
        """See `Goals.since`: at once, whatever its stamp."""
        return 0.0

    def plan(self, goal: Goal, now: RobotSituation, since: float) -> Made:
        """See `Goals.plan`."""
        if not goal.handle.request.path.poses:
            raise Refused("no poses", INVALID_PATH)
        try:
            return self.path(goal.handle.request.path)
        except Refused as why:
            raise Refused(str(why), INVALID_PATH) from why

    def begin(self, goal: Goal, made: Motion, now: RobotSituation) -> Motion:
        """See `Goals.begin`."""
        assert isinstance(goal, PathGoal)
        try:
            found = self.route.placed(made, goal.handle.request.path.header.frame_id.lstrip("/"), now.base)
        except Refused as why:
            raise Refused(str(why), NO_FRAME) from why
        assert isinstance(found, Followed)
        goal.found, table, h = found, found.motion.table, found.motion.period
        driven = np.abs(table[:, 3 : 2 + made.dimensions.twist]).max(axis=1) * h
        goal.ways, goal.period = np.append(np.cumsum(driven[:0:-1])[::-1], 0.0), h
        return rest_of(found.motion, 0.0, found.place)

    def start(self, goal: Goal) -> None:
        """See `Goals.start`."""
        assert isinstance(goal, PathGoal) and goal.found is not None
        self.route.follow(goal.found)

    def judge(self, goal: Goal, now: RobotSituation) -> tuple[str, int, str] | None:
        """See `Goals.judge`."""
        s, end = self.settings, self.route.end
        if end is None or goal.left > 0.0:
            return None
        away, turned = math.dist(now.pose[:2], end[:2]), abs(wrapped(now.pose[2] - end[2]))
        if away <= s.goal_tolerance and turned <= s.goal_turn:
            return "succeed", NONE, ""
        why = f"the base is {away:.3g} m and {turned:.3g} rad from its end"
        return ("abort", NO_PROGRESS, why) if -goal.left > s.goal_time else None

    def lost(self, goal: Goal) -> tuple[str, int, str]:
        """See `Goals.lost`."""
        return "abort", NO_CONTROL, "the supervisor stopped the robot"

    def feedback(self, goal: Goal, now: RobotSituation, time: float) -> Any:
        """See `Goals.feedback`."""
        assert isinstance(goal, PathGoal)
        return self.message(goal.distance, math.hypot(*now.velocity[:-1]))
