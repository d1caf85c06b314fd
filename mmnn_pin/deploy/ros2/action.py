"""The action `control_msgs/FollowJointTrajectory`: goals that are accepted or not, followed, cancelled, and answered.

Goals are judged as `joint_trajectory_controller` does: a new one takes the place of the one that is followed; it is
reached when every joint is within its tolerance of the last point, and given up when that takes too long, when a joint
strays from the way by more than its tolerance, or when the supervisor stops the robot.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import MmnnError
from ...reference.guide import ARM
from ...reference.wishes import Motion, Stand, Wish
from ...signals import Array, Setpoint
from . import messages as msg
from .link import Link, Outlet, address_of, decoded
from .planned import OFF_GOAL, OFF_PATH, OKAY, Arm, Made, Planner, Refused, caught_up
from .sensing import Clock, seconds
from .services import Caller, Services
from .settings import Action, Topic
from .wiring import resolved

UNKNOWN, ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(7)  # action_msgs/GoalStatus
NONE, REJECTED, NO_SUCH_GOAL, OVER = range(4)  # action_msgs/srv/CancelGoal
SEND, CANCEL, RESULT = range(3)
MOST_GOALS = 32
EVENTS = Topic("/action", "reliable", 10)
STATUS = Topic("/action", "reliable", 1)


@dataclass
class Goal:
    """A goal that was accepted.

    Attributes:
        key: Its number, 16 bytes.
        stamp: When it was accepted.
        last: (n,) where the joints are to end.
        ends: When they are to be there, by the node's time [s].
        on_way: (n,) largest errors on the way, inf for none.
        at_end: (n,) likewise at the end.
        patience: Time after the end [s].
        status: As `action_msgs/GoalStatus` numbers it.
        result: What came of it.
        waiting: Who waits for that.
    """

    key: bytes
    stamp: msg.Time
    last: Array
    ends: float
    on_way: Array
    at_end: Array
    patience: float
    status: int = EXECUTING
    result: msg.FollowResult = field(default_factory=msg.FollowResult)
    waiting: list[Caller] = field(default_factory=list)

    @property
    def info(self) -> msg.GoalInfo:
        """Its number and stamp."""
        return msg.GoalInfo(msg.UUID(list(self.key)), self.stamp)


class ArmAction:
    """The server of the action.

    Args:
        link: The graph.
        arm: The robot's arm.
        settings: Name and tolerances.
        planner: Makes motions.

    Attributes:
        refused: Goals that were not accepted.
        why: Why the last one was not.
    """

    def __init__(self, link: Link, arm: Arm, settings: Action, planner: Planner) -> None:
        self.arm, self.settings, self.planner = arm, settings, planner
        name = self.name = resolved(link.network, settings.name)
        kinds: list[tuple[str, type[Any], type[Any]]] = [
            ("send_goal", msg.FollowSendRequest, msg.SendResponse),
            ("cancel_goal", msg.CancelRequest, msg.CancelResponse),
            ("get_result", msg.ResultRequest, msg.FollowResultResponse),
        ]
        services = [(f"{name}/_action/{what}", typename(asked), typename(told)) for what, asked, told in kinds]
        self.services = Services(link.network, [address_of(peer) for peer in link.network.peers], services)
        self.status = Outlet(link, f"{name}/_action/status", msg.GoalStatusArray, STATUS, latched=True)
        self.feedback = Outlet(link, f"{name}/_action/feedback", msg.FollowFeedbackMessage, EVENTS)
        self.goals: dict[bytes, Goal] = {}
        self.active: Goal | None = None
        self.told, self.refused, self.why = 0.0, 0, ""
        self._tell()

    def poll(self, clock: Clock, reference: Array, measured: Array, stopped: bool) -> list[Wish]:
        """Answer requests and judge the goal that is followed; what the arm is to do then.

        Args:
            clock: The node's.
            reference: (3, n) q, qdot, qddot of the arm's reference.
            measured: (2, n) q, qdot.
            stopped: Whether the supervisor has stopped the robot.
        """
        wishes: list[Wish] = []
        for caller, data in self.services.take():
            try:
                answer = (self._send, self._cancel, self._result)[caller.service]
                wishes += answer(caller, data, clock, reference, stopped)
            except MmnnError as error:
                self.why = str(error)
        if self.active is not None:
            wishes += self._judge(self.active, clock, reference, measured, stopped)
        return wishes

    def give_way(self, why: str) -> None:
        """End the goal that is followed, as another motion takes its place."""
        if self.active is not None:
            self._end(self.active, ABORTED, OKAY, why)

    def close(self) -> None:
        """Answer nothing more."""
        self.give_way("the node ends")
        self.services.close()

    # -- requests ------------------------------------------------------------------------------------------------------

    def _send(self, caller: Caller, data: bytes, clock: Clock, reference: Array, stopped: bool) -> list[Wish]:
        now, asked, request = reference.copy(), clock.now, list[msg.FollowSendRequest]()

        def make() -> Made:
            request.append(decoded(data, msg.FollowSendRequest))
            message = request[0].goal.trajectory
            if stopped or not message.points or bytes(request[0].goal_id.uuid) in self.goals:
                why = "the supervisor has stopped the robot" if stopped else "no points, or a goal that is known"
                raise Refused(why)
            return self.arm.motion(message, now, clock.since(message.header.stamp))

        def done(made: Made | Refused) -> Wish | None:
            stamp, accepted = clock.stamp, isinstance(made, Motion)
            if isinstance(made, Motion):
                self.give_way("another goal came")
                self._accept(request[0], made, clock)
            else:
                self.refused, self.why = self.refused + 1, str(made)
            self.services.reply(caller, encoded(msg.SendResponse(accepted, stamp)))
            return caught_up(made, clock.now - asked) if isinstance(made, Motion) else None

        self.planner.plan(make, done)
        return []

    def _accept(self, request: msg.FollowSendRequest, made: Motion, clock: Clock) -> None:
        goal, s = request.goal, self.settings
        last = Setpoint.side_by_side(made.table, made.dimensions).q[-1].copy()
        ends = clock.now + (len(made.table) - 1) * made.period
        on_way = self._tolerances(goal.path_tolerance, s.path_tolerance)
        at_end = self._tolerances(goal.goal_tolerance, s.goal_tolerance)
        patience = seconds(goal.goal_time_tolerance) or s.goal_time
        self.active = Goal(bytes(request.goal_id.uuid), clock.stamp, last, ends, on_way, at_end, patience)
        self.goals[self.active.key] = self.active
        over = [key for key, one in self.goals.items() if one.status >= SUCCEEDED]
        for key in over[: max(len(self.goals) - MOST_GOALS, 0)]:
            del self.goals[key]
        self._tell()

    def _cancel(self, caller: Caller, data: bytes, clock: Clock, reference: Array, stopped: bool) -> list[Wish]:
        asked = decoded(data, msg.CancelRequest).goal_info
        key, before = bytes(asked.goal_id.uuid), seconds(asked.stamp)
        goal, every = self.goals.get(key), not any(key)
        current = self.active
        early = current is not None and (before == 0.0 or seconds(current.stamp) <= before)
        if current is not None and (current.key == key or (every and early)):
            self.services.reply(caller, encoded(msg.CancelResponse(NONE, [current.info])))
            current.status = CANCELING
            self._tell()
            self._end(current, CANCELED, OKAY, "cancelled")
            return [Stand((ARM,))]
        code = REJECTED if every else NO_SUCH_GOAL if goal is None else OVER
        self.services.reply(caller, encoded(msg.CancelResponse(code, [])))
        return []

    def _result(self, caller: Caller, data: bytes, clock: Clock, reference: Array, stopped: bool) -> list[Wish]:
        goal = self.goals.get(bytes(decoded(data, msg.ResultRequest).goal_id.uuid))
        if goal is not None and goal.status < SUCCEEDED:
            goal.waiting = [*goal.waiting[-8:], caller]
        else:
            self._answer(caller, goal)
        return []

    def _answer(self, caller: Caller, goal: Goal | None) -> None:
        status, result = (UNKNOWN, msg.FollowResult()) if goal is None else (goal.status, goal.result)
        self.services.reply(caller, encoded(msg.FollowResultResponse(status, result)))

    # -- the goal that is followed -------------------------------------------------------------------------------------

    def _judge(self, goal: Goal, clock: Clock, reference: Array, measured: Array, stopped: bool) -> list[Wish]:
        """Whether a goal is reached, or lost."""
        error, left = np.abs(reference[0] - measured[0]), np.abs(goal.last - measured[0])
        if stopped:
            self._end(goal, ABORTED, OFF_PATH, "the supervisor stopped the robot")
        elif (error > goal.on_way).any():
            i = int(np.argmax(error - goal.on_way))
            self._end(goal, ABORTED, OFF_PATH, f"{self.arm.names[i]} is {error[i]:.4g} off its way")
            return [Stand((ARM,))]
        elif clock.now >= goal.ends and (left <= goal.at_end).all():
            self._end(goal, SUCCEEDED, OKAY, "")
        elif clock.now > goal.ends + goal.patience:
            i = int(np.argmax(left - goal.at_end))
            self._end(goal, ABORTED, OFF_GOAL, f"{self.arm.names[i]} is {left[i]:.4g} off its goal")
        elif clock.now - self.told >= 1.0 / self.settings.rate:
            self.told = clock.now
            self.feedback.send(self._feedback(goal, clock, reference, measured))
        return []

    def _end(self, goal: Goal, status: int, code: int, why: str) -> None:
        """A goal is over: tell those who wait."""
        goal.status, goal.result, self.active = status, msg.FollowResult(code, why), None
        self._tell()
        for caller in goal.waiting:
            self._answer(caller, goal)
        goal.waiting = []

    def _tell(self) -> None:
        self.status.send(msg.GoalStatusArray([msg.GoalStatus(one.info, one.status) for one in self.goals.values()]))

    def _feedback(self, goal: Goal, clock: Clock, reference: Array, measured: Array) -> msg.FollowFeedbackMessage:
        def point(values: Array) -> msg.JointTrajectoryPoint:
            parts = [row.tolist() for row in values] + [[]] * (4 - len(values))
            return msg.JointTrajectoryPoint(*parts, msg.Duration())

        nothing = msg.MultiDOFJointTrajectoryPoint([], [], [], msg.Duration())
        points = point(reference), point(measured), point(reference[:2] - measured)
        told = msg.FollowFeedback(
            msg.Header(clock.stamp, ""), list(self.arm.names), *points, 0, [], nothing, nothing, nothing, 0
        )
        return msg.FollowFeedbackMessage(msg.UUID(list(goal.key)), told)

    def _tolerances(self, given: list[msg.JointTolerance], default: float) -> Array:
        """Tolerance of every joint; one of 0 says nothing, one below 0 that there is none."""
        found = np.full(len(self.arm.names), default or np.inf)
        for one in given:
            if one.name not in self.arm.names:
                continue
            i = self.arm.names.index(one.name)
            found[i] = one.position if one.position > 0.0 else found[i] if one.position == 0.0 else np.inf
        return found


def typename(kind: type[Any]) -> str:
    """The name of a type on the wire."""
    return str(kind.__idl_typename__)


def encoded(message: Any) -> bytes:
    """A message in CDR."""
    return bytes(message.serialize(use_version_2=False))
