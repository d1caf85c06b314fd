"""The action `control_msgs/FollowJointTrajectory`: goals that are followed, replaced, cancelled, and answered.

Goals are judged as `joint_trajectory_controller` does: a new one takes the place of the one that is followed; it is
reached when every part is within its tolerance of the last point, and given up when that takes too long, when a part
strays from the way by more than its tolerance, or when the supervisor stops the robot. A goal that cannot be followed
is accepted and aborted at once, as only so its sender learns why (`error_string`).

The server's callbacks run in an executor; goals are judged by the control loop, and `Goal.over` is where they meet.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from threading import Event
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from geometry_msgs.msg import Transform
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node as RosNode
from trajectory_msgs.msg import JointTrajectoryPoint

from ...reference.guide import ARM, BASE
from ...reference.wishes import Motion, Stand, Wish
from ...signals import Array, Setpoint
from .outputs import stamp_of
from .planned import (
    INVALID_GOAL,
    OFF_GOAL,
    OFF_PATH,
    OKAY,
    Made,
    PlannedArm,
    Planner,
    Refused,
    RobotSituation,
    caught_up,
)
from .sensing import Clock, Planar, seconds
from .settings import Action
from .whole_body import PARTS, base_points, whole_motion

MOST_WAITING = 8
KEEP = 300  # time that a result is kept [s]


@dataclass
class Goal:
    """A goal that came, and what becomes of it.

    Attributes:
        handle: The server's.
        parts: Which parts of the robot it moves.
        base: What the planner calls the base; empty where it does not move.
        last: (n + 3,) where joints and base are to end.
        ends: When they are to be there, by the node's time [s].
        on_way: (n + 3,) largest errors on the way, inf for none.
        at_end: (n + 3,) likewise at the end.
        patience: Time after the end [s].
        over: Set at the end, when these hold:
        outcome: "succeed", "abort" or "canceled".
        code: As `FollowJointTrajectory` numbers it.
        why: In one line.
    """

    handle: ServerGoalHandle
    parts: tuple[int, ...] = (ARM,)
    base: str = ""
    last: Array = field(default_factory=lambda: np.zeros(0))
    ends: float = 0.0
    on_way: Array = field(default_factory=lambda: np.zeros(0))
    at_end: Array = field(default_factory=lambda: np.zeros(0))
    patience: float = 0.0
    over: Event = field(default_factory=Event)
    outcome: str = "abort"
    code: int = OKAY
    why: str = ""

    def end(self, outcome: str, code: int, why: str) -> None:
        """It is over."""
        self.outcome, self.code, self.why = outcome, code, why
        self.over.set()


class GoalAction:
    """The server of the action.

    Args:
        node: The node.
        arm: The robot's arm.
        settings: Tolerances.
        planner: Makes motions.
        place_of: Where a frame lies in the odometry's.

    Attributes:
        closed: Why no goal is followed at present; empty where one is.
        refused: Goals that could not be followed.
        why: Why the last one could not.
    """

    def __init__(
        self,
        node: RosNode,
        arm: PlannedArm,
        settings: Action,
        planner: Planner,
        place_of: Callable[[str], Planar | None],
    ) -> None:
        self.arm, self.settings, self.planner, self.place_of = arm, settings, planner, place_of
        self.closed, self.refused, self.why = "the node is not active", 0, ""
        self.came: deque[Goal] = deque()
        self.goals: dict[bytes, Goal] = {}
        self.active: Goal | None = None
        self.told = 0.0
        self.server = ActionServer(
            node, FollowJointTrajectory, "~/follow_joint_trajectory", self._execute, result_timeout=KEEP,
            callback_group=ReentrantCallbackGroup(), handle_accepted_callback=self._accepted,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip

    # -- in the executor -----------------------------------------------------------------------------------------------

    def _accepted(self, handle: ServerGoalHandle) -> None:
        goal = self.goals[bytes(handle.goal_id.uuid)] = Goal(handle)
        crowded = f"{MOST_WAITING} goals wait already" if len(self.came) >= MOST_WAITING else ""
        if why := self.closed or crowded:
            self._refuse(goal, Refused(why))
        else:
            self.came.append(goal)
        handle.execute()

    def _execute(self, handle: ServerGoalHandle) -> Any:
        """Wait until the control loop has ended a goal, and answer."""
        goal = self.goals[bytes(handle.goal_id.uuid)]
        goal.over.wait()
        getattr(handle, goal.outcome)()
        del self.goals[bytes(handle.goal_id.uuid)]
        return FollowJointTrajectory.Result(error_code=goal.code, error_string=goal.why)

    # -- in the control loop -------------------------------------------------------------------------------------------

    def poll(self, clock: Clock, now: RobotSituation, stopped: bool) -> list[Wish]:
        """Begin with goals that came, and judge the one that is followed; what the robot is to do then.

        Args:
            clock: The node's.
            now: Reference and measurement.
            stopped: Whether the supervisor has stopped the robot.
        """
        while self.came:
            self._begin(self.came.popleft(), clock, now, stopped)
        return [] if self.active is None else self._judge(self.active, clock, now, stopped)

    def give_way(self, why: str, part: int | None = None) -> None:
        """End the goal that is followed, as another motion takes its place, of a part or of all."""
        if self.active is not None and (part is None or part in self.active.parts):
            self._end(self.active, "abort", OKAY, why)

    def close(self, why: str) -> None:
        """Follow no goal any more."""
        self.closed = why
        self.give_way(why)
        for goal in list(self.goals.values()):
            goal.end("abort", INVALID_GOAL, why)

    def _begin(self, goal: Goal, clock: Clock, now: RobotSituation, stopped: bool) -> None:
        """Plan the motion of a goal, and follow it when it is ready."""
        asked, request = clock.now, goal.handle.request
        reference, base = now.reference.copy(), now.base.copy()

        def make() -> Made:
            joints, several = request.trajectory, request.multi_dof_trajectory
            if stopped or not (joints.points or several.points):
                raise Refused("the supervisor has stopped the robot" if stopped else "no points")
            since = clock.since(several.header.stamp if several.points else joints.header.stamp)
            if (points := base_points(joints, several)) is None:
                return self.arm.motion(joints, reference, since)
            goal.base, frame = points.name, (several if several.points else joints).header.frame_id.lstrip("/")
            if (place := self.place_of(frame)) is None:
                raise Refused(f"no way from '{frame}' to the odometry's frame by /tf")
            return whole_motion(self.arm, joints, points, reference, base, place, since)

        def done(made: Made | Refused) -> Wish | None:
            if not isinstance(made, Motion):
                self._refuse(goal, made if isinstance(made, Refused) else Refused("it moves nothing"))
                return None
            if goal.over.is_set():
                return None
            self.give_way("another goal came")
            self._follow(goal, made, clock)
            return caught_up(made, clock.now - asked) if made.parts == (ARM,) else made

        self.planner.plan(make, done)

    def _refuse(self, goal: Goal, why: Refused) -> None:
        self.refused, self.why = self.refused + 1, str(why)
        goal.end("abort", why.code, str(why))

    def _follow(self, goal: Goal, made: Motion, clock: Clock) -> None:
        request, s = goal.handle.request, self.settings
        last = Setpoint.side_by_side(made.table[-1], made.dimensions)
        goal.parts, goal.last = made.parts, np.append(last.q, last.pose)
        goal.ends = clock.now + (len(made.table) - 1) * made.period
        names = [*self.arm.names, *(f"{goal.base}/{part}" for part in PARTS[: len(last.pose)])]
        goal.on_way = tolerances(names, request.path_tolerance, s.path_tolerance)
        goal.at_end = tolerances(names, request.goal_tolerance, s.goal_tolerance)
        if BASE not in goal.parts:
            goal.on_way[len(last.q) :] = goal.at_end[len(last.q) :] = np.inf
        goal.patience = seconds(request.goal_time_tolerance) or s.goal_time
        self.active = goal

    def _judge(self, goal: Goal, clock: Clock, now: RobotSituation, stopped: bool) -> list[Wish]:
        """Whether a goal is reached, or lost."""
        there = np.append(now.measured[0], now.pose)
        error, left = np.abs(np.append(now.reference[0], now.base[:3]) - there), np.abs(goal.last - there)
        if stopped:
            self._end(goal, "abort", OFF_PATH, "the supervisor stopped the robot")
        elif goal.handle.is_cancel_requested:
            self._end(goal, "canceled", OKAY, "cancelled")
            return [Stand(goal.parts)]
        elif (error > goal.on_way).any():
            i = int(np.argmax(error - goal.on_way))
            self._end(goal, "abort", OFF_PATH, f"{self._name(goal, i)} is {error[i]:.4g} off its way")
            return [Stand(goal.parts)]
        elif clock.now >= goal.ends and (left <= goal.at_end).all():
            self._end(goal, "succeed", OKAY, "")
        elif clock.now > goal.ends + goal.patience:
            i = int(np.argmax(left - goal.at_end))
            self._end(goal, "abort", OFF_GOAL, f"{self._name(goal, i)} is {left[i]:.4g} off its goal")
        elif clock.now - self.told >= 1.0 / self.settings.rate:
            self.told = clock.now
            goal.handle.publish_feedback(self._feedback(goal, clock, now))
        return []

    def _end(self, goal: Goal, outcome: str, code: int, why: str) -> None:
        self.active = None
        goal.end(outcome, code, why)

    def _name(self, goal: Goal, i: int) -> str:
        """A joint, or a part of the base's pose."""
        n = len(self.arm.names)
        return self.arm.names[i] if i < n else f"{goal.base}/{PARTS[i - n]}"

    def _feedback(self, goal: Goal, clock: Clock, now: RobotSituation) -> Any:
        names = ("positions", "velocities", "accelerations")

        def point(values: Array) -> JointTrajectoryPoint:
            rows = dict(zip(names, values.tolist(), strict=False))
            return JointTrajectoryPoint(**rows)

        points = {"desired": now.reference, "actual": now.measured, "error": now.reference[:2] - now.measured}
        told = {name: point(values) for name, values in points.items()}
        feedback = FollowJointTrajectory.Feedback(joint_names=list(self.arm.names), **told)
        feedback.header.stamp = stamp_of(clock.by_ros)
        if BASE in goal.parts:
            feedback.multi_dof_joint_names = [goal.base]
            feedback.multi_dof_desired.transforms = [transform(now.base[:3])]
            feedback.multi_dof_actual.transforms = [transform(now.pose)]
            feedback.multi_dof_error.transforms = [transform(now.base[:3] - now.pose)]
        return feedback


def tolerances(names: Sequence[str], given: Sequence[JointTolerance], default: float) -> Array:
    """Tolerance of every name; one of 0 says nothing, one below 0 that there is none."""
    found = np.full(len(names), default or np.inf)
    for one in given:
        if one.name in names:
            i = list(names).index(one.name)
            found[i] = one.position if one.position > 0.0 else found[i] if one.position == 0.0 else np.inf
    return found


def transform(pose: Array) -> Transform:
    """A pose (3,) in the plane as a message."""
    made = Transform()
    made.translation.x, made.translation.y = pose[:2].tolist()
    made.rotation.z, made.rotation.w = math.sin(pose[2] / 2), math.cos(pose[2] / 2)
    return made
