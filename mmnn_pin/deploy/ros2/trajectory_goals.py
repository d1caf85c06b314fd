"""Goals of `control_msgs/FollowJointTrajectory`, judged as `joint_trajectory_controller` judges them.

A goal is reached when every part is within its tolerance of the last point after its time, and given up when that
takes too long, when a part strays from the way by more than its tolerance, or when the supervisor stops the robot.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from ...reference.guide import BASE
from ...reference.wishes import Motion
from ...signals import Array, Setpoint
from .goals import GiveWay, Goal, Goals
from .planned import OFF_GOAL, OFF_PATH, OKAY, Made, PlannedArm, Planner, Refused, RobotSituation
from .sensing import Clock, Planar, seconds
from .settings import Action
from .whole_body import PARTS, base_points, whole_motion

AXES = {1: (0,), 2: (1,), 4: (0, 1), 5: (2,)}  # component of a `JointComponentTolerance` to parts of a pose


@dataclass
class TrajectoryGoal(Goal):
    """A goal of joints, and of the base."""

    base: str = ""  # what the planner calls the base; empty where it does not move
    last: Array = field(default_factory=lambda: np.zeros(0))  # (n + 3,) where joints and base are to end
    # (2, n + 3) largest errors of position and velocity on the way, inf for none
    on_way: Array = field(default_factory=lambda: np.zeros((2, 0)))
    at_end: Array = field(default_factory=lambda: np.zeros((2, 0)))  # (2, n + 3) likewise at the end
    patience: float = 0.0  # time after the end [s]


class TrajectoryGoals(Goals):
    """The goals of one robot's joints and base.

    Args:
        planner: Makes motions.
        give_way: As in `Goals`.
        arm: The robot.
        settings: Tolerances.
        place_of: Where a frame lies in the odometry's.
        told: Makes the feedback's message.
    """

    CANCELED: ClassVar[int] = OKAY

    def __init__(
        self,
        planner: Planner,
        give_way: GiveWay,
        arm: PlannedArm,
        settings: Action,
        place_of: Callable[[str], Planar | None],
        told: Callable[[Sequence[str], str, RobotSituation, float], Any],
    ) -> None:
        super().__init__(planner, give_way, settings.rate)
        self.arm, self.settings, self.place_of, self.message = arm, settings, place_of, told

    def goal(self, handle: Any) -> Goal:
        """See `Goals.goal`."""
        return TrajectoryGoal(handle)

    def since(self, request: Any, clock: Clock) -> float:
        """See `Goals.since`."""
        several = request.multi_dof_trajectory
        return clock.since((several if several.points else request.trajectory).header.stamp)

    def plan(self, goal: Goal, now: RobotSituation, since: float) -> Made:
        """See `Goals.plan`."""
        assert isinstance(goal, TrajectoryGoal)
        joints, several = goal.handle.request.trajectory, goal.handle.request.multi_dof_trajectory
        if not (joints.points or several.points):
            raise Refused("no points")
        if (points := base_points(joints, several)) is None:
            return self.arm.motion(joints, now.reference, since)
        goal.base, frame = points.name, (several if several.points else joints).header.frame_id.lstrip("/")
        if (place := self.place_of(frame)) is None:
            raise Refused(f"no way from '{frame}' to the odometry's frame by /tf")
        return whole_motion(self.arm, joints, points, now, place, since, self.settings.smooth)

    def begin(self, goal: Goal, made: Motion, now: RobotSituation) -> Motion:
        """See `Goals.begin`."""
        assert isinstance(goal, TrajectoryGoal)
        request, s = goal.handle.request, self.settings
        last = Setpoint.side_by_side(made.table[-1], made.dimensions)
        goal.last = np.append(last.q, last.pose)
        names = self._names(goal)[: len(goal.last)]
        way, end = (s.path_tolerance, 0.0), (s.goal_tolerance, s.stopped_velocity)
        parts = request.component_path_tolerance, request.component_goal_tolerance
        goal.on_way = tolerances(names, request.path_tolerance, way, parts[0])
        goal.at_end = tolerances(names, request.goal_tolerance, end, parts[1])
        if BASE not in goal.parts:
            goal.on_way[:, len(last.q) :] = goal.at_end[:, len(last.q) :] = np.inf
        given = seconds(request.goal_time_tolerance)
        goal.patience = math.inf if given < 0.0 else given or s.goal_time or math.inf
        return made

    def judge(self, goal: Goal, now: RobotSituation) -> tuple[str, int, str] | None:
        """See `Goals.judge`."""
        assert isinstance(goal, TrajectoryGoal)
        there, moves = np.append(now.measured[0], now.pose), np.append(now.measured[1], _planar(now.velocity, now))
        if goal.left > 0.0:
            wanted = np.append(now.reference[1], _planar(now.base[3:], now))
            errors = np.abs([np.append(now.reference[0], now.base[:3]) - there, wanted - moves])
            found = self._worst(goal, errors, goal.on_way, "off its way")
            return None if found is None else ("abort", OFF_PATH, found)
        found = self._worst(goal, np.abs([goal.last - there, moves]), goal.at_end, "off its goal")
        if found is None:
            return "succeed", OKAY, ""
        return ("abort", OFF_GOAL, found) if -goal.left > goal.patience else None

    def lost(self, goal: Goal) -> tuple[str, int, str]:
        """See `Goals.lost`."""
        return "abort", OFF_PATH, "the supervisor stopped the robot"

    def feedback(self, goal: Goal, now: RobotSituation, time: float) -> Any:
        """See `Goals.feedback`."""
        assert isinstance(goal, TrajectoryGoal)
        return self.message(self.arm.names, goal.base if BASE in goal.parts else "", now, time)

    def _names(self, goal: TrajectoryGoal) -> list[str]:
        return [*self.arm.names, *(f"{goal.base}/{part}" for part in PARTS)]

    def _worst(self, goal: TrajectoryGoal, errors: Array, most: Array, where: str) -> str | None:
        """A line on the part with the largest error beyond its tolerance; None where all are within."""
        if not (errors > most).any():
            return None
        kind, i = np.unravel_index(int(np.argmax(errors / most)), errors.shape)
        what = f"{where} by {errors[kind, i]:.4g}" if kind == 0 else f"{errors[kind, i]:.4g} /s {where}"
        return f"{self._names(goal)[int(i)]} is {what}, its tolerance is {most[kind, i]:.4g}"


def _planar(velocity: Array, now: RobotSituation) -> Array:
    """(pose,) velocity along, across and about of a twist."""
    return velocity if velocity.size != 2 else np.array([velocity[0], 0.0, velocity[1]])


def tolerances(
    names: Sequence[str], given: Sequence[Any], default: tuple[float, float], components: Sequence[Any] = ()
) -> Array:
    """(2, k) tolerances of position and velocity of every name; one of 0 says nothing, one below 0 that there is none.

    Args:
        names: Joints, then `NAME/x`, `NAME/y`, `NAME/theta`.
        given: `JointTolerance`.
        default: Of position and velocity, 0 for none.
        components: `JointComponentTolerance`, of the base by its axes.
    """
    found = np.array([np.full(len(names), one or np.inf) for one in default])
    pairs = [(one, one.name) for one in given]
    pairs += [(one, f"{one.joint_name}/{PARTS[k]}") for one in components for k in AXES.get(one.component, ())]
    for one, name in pairs:
        if name in names:
            i = list(names).index(name)
            for kind, value in enumerate((one.position, one.velocity)):
                found[kind, i] = value if value > 0.0 else found[kind, i] if value == 0.0 else np.inf
    return found
