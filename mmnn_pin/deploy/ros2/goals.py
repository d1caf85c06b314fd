"""Goals of an action, apart from its server: planned, followed, put off, replaced, cancelled, judged.

A new goal takes the place of the one that is followed. A goal that cannot be followed is accepted and aborted at once,
as only so its sender learns why. One whose stamp lies in the future is planned at once, so that its sender learns what
is wrong with it, and planned anew and begun when its time has come; until then the robot goes on with what it does.

The server's callbacks run in an executor; goals are judged by the control loop, and `Goal.over` is where they meet.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Event
from typing import Any, ClassVar

from ...reference.guide import ARM
from ...reference.wishes import Motion, Stand, Wish
from .planned import INVALID_GOAL, Made, Planner, Refused, RobotSituation, caught_up
from .sensing import Clock

MOST_WAITING = 8
GiveWay = Callable[[str, tuple[int, ...]], None]


@dataclass
class Goal:
    """A goal that came, and what becomes of it."""

    handle: Any  # the server's
    parts: tuple[int, ...] = ()  # which parts of the robot it moves
    begins: float = 0.0  # when it begins, by the time of ROS 2 [s]
    left: float = 0.0  # time until its motion is over, at the pace at which it is followed [s]
    over: Event = field(default_factory=Event)  # set at the end, when these hold:
    outcome: str = "abort"  # "succeed", "abort" or "canceled"
    code: int = 0  # as its action numbers it
    why: str = ""  # in one line

    def end(self, outcome: str, code: int, why: str) -> None:
        """It is over."""
        self.outcome, self.code, self.why = outcome, code, why
        self.over.set()


class Goals(ABC):
    """The goals of one action.

    Args:
        planner: Makes motions.
        give_way: Ends what other goals and topics ask of parts of the robot.
        rate: Of the feedback [1/s].

    Attributes:
        closed: Why no goal is followed at present; empty where one is.
        refused: Goals that could not be followed.
        why: Why the last one could not.
        active: The one that is followed.
        later: The one that has been put off.
    """

    CANCELED: ClassVar[int] = 0
    REPLACED: ClassVar[int] = INVALID_GOAL

    def __init__(self, planner: Planner, give_way: GiveWay, rate: float) -> None:
        self.planner, self.give_others_way, self.rate = planner, give_way, rate
        self.closed, self.refused, self.why = "the node is not active", 0, ""
        self.came: deque[Goal] = deque()
        self.goals: dict[bytes, Goal] = {}
        self.active: Goal | None = None
        self.later: Goal | None = None
        self.told = 0.0

    # -- in the executor -----------------------------------------------------------------------------------------------

    def accept(self, handle: Any) -> None:
        """Take a goal of the server."""
        goal = self.goals[bytes(handle.goal_id.uuid)] = self.goal(handle)
        crowded = f"{MOST_WAITING} goals wait already" if len(self.came) >= MOST_WAITING else ""
        if why := self.closed or crowded:
            self._refuse(goal, Refused(why))
        else:
            self.came.append(goal)

    def answer(self, handle: Any) -> Goal:
        """Wait until the control loop has ended a goal, and tell its sender so."""
        goal = self.goals[bytes(handle.goal_id.uuid)]
        goal.over.wait()
        getattr(handle, goal.outcome)()
        del self.goals[bytes(handle.goal_id.uuid)]
        return goal

    # -- of an action --------------------------------------------------------------------------------------------------

    def goal(self, handle: Any) -> Goal:
        """The record of a goal."""
        return Goal(handle)

    @abstractmethod
    def since(self, request: Any, clock: Clock) -> float:
        """Time since the moment at which a goal is to begin; negative before it [s]."""

    @abstractmethod
    def plan(self, goal: Goal, now: RobotSituation, since: float) -> Made:
        """Plan the motion of a goal; errors as of `planned`."""

    @abstractmethod
    def begin(self, goal: Goal, made: Motion, now: RobotSituation) -> Motion:
        """The motion of a goal, as it is followed from now on; errors as of `planned`."""

    def start(self, goal: Goal) -> None:  # noqa: B027
        """The motion that `begin` made is followed from now on; others have given way."""

    @abstractmethod
    def judge(self, goal: Goal, now: RobotSituation) -> tuple[str, int, str] | None:
        """Outcome, code and reason of a goal that is reached or lost; None where it is neither."""

    @abstractmethod
    def feedback(self, goal: Goal, now: RobotSituation, time: float) -> Any:
        """The message for the sender on the way, at a time of ROS 2 [s]."""

    # -- in the control loop -------------------------------------------------------------------------------------------

    def poll(self, clock: Clock, now: RobotSituation, stopped: bool) -> list[Wish]:
        """Begin with goals that came, and judge the one that is followed; what the robot is to do then.

        Args:
            clock: The node's.
            now: Reference and measurement.
            stopped: Whether the supervisor has stopped the robot.
        """
        self.now = now
        later = self.later
        if later is not None and later.handle.is_cancel_requested:
            self.later = None
            later.end("canceled", self.CANCELED, "cancelled")
        elif later is not None and clock.by_ros >= later.begins:
            self.later = None
            self.came.append(later)
        while self.came:
            self._plan(self.came.popleft(), clock, now, stopped)
        return [] if self.active is None else self._judge(self.active, clock, now, stopped)

    def give_way(self, why: str, parts: tuple[int, ...]) -> None:
        """End the goal that is followed, as another motion takes its place, where it moves one of these parts."""
        if self.active is not None and set(parts) & set(self.active.parts):
            self._end(self.active, "abort", self.REPLACED, why)

    def close(self, why: str) -> None:
        """Follow no goal any more."""
        self.closed, self.active, self.later = why, None, None
        for goal in list(self.goals.values()):
            if not goal.over.is_set():
                goal.end("abort", INVALID_GOAL, why)

    def _plan(self, goal: Goal, clock: Clock, now: RobotSituation, stopped: bool) -> None:
        """Plan the motion of a goal, and follow it when it is ready, or later."""
        asked, since, then = clock.now, self.since(goal.handle.request, clock), now.copy()

        def make() -> Made:
            if stopped:
                raise Refused("the supervisor has stopped the robot")
            return self.plan(goal, then, max(since, 0.0))

        def done(made: Made | Refused) -> Wish | None:
            if goal.over.is_set():
                return None
            try:
                if not isinstance(made, Motion):
                    raise made if isinstance(made, Refused) else Refused("it moves nothing")
                if since < 0.0:
                    self._put_off(goal, clock.by_ros - since - (clock.now - asked))
                    return None
                goal.parts = made.parts
                motion = self.begin(goal, made, self.now)
            except Refused as why:
                self._refuse(goal, why)
                return None
            self.give_others_way("another goal came", goal.parts)
            self.start(goal)
            self.active, goal.left = goal, motion.duration
            return caught_up(motion, clock.now - asked) if motion.parts == (ARM,) else motion

        self.planner.plan(make, done)

    def _put_off(self, goal: Goal, begins: float) -> None:
        """Begin a goal later; one that was put off before is dropped."""
        if self.later is not None:
            self.later.end("abort", self.REPLACED, "another goal came")
        goal.begins, self.later = begins, goal

    def _refuse(self, goal: Goal, why: Refused) -> None:
        self.refused, self.why = self.refused + 1, str(why)
        goal.end("abort", why.code, str(why))

    def _judge(self, goal: Goal, clock: Clock, now: RobotSituation, stopped: bool) -> list[Wish]:
        """Whether a goal is reached, or lost."""
        goal.left -= now.moved_on
        if goal.handle.is_cancel_requested:
            self._end(goal, "canceled", self.CANCELED, "cancelled")
            return [Stand(goal.parts)]
        found = self.lost(goal) if stopped else self.judge(goal, now)
        if found is not None:
            self._end(goal, *found)
            return [] if found[0] == "succeed" or stopped else [Stand(goal.parts)]
        if clock.now - self.told >= 1.0 / self.rate:
            self.told = clock.now
            goal.handle.publish_feedback(self.feedback(goal, now, clock.by_ros))
        return []

    @abstractmethod
    def lost(self, goal: Goal) -> tuple[str, int, str]:
        """Outcome of a goal whose robot the supervisor has stopped."""

    def _end(self, goal: Goal, outcome: str, code: int, why: str) -> None:
        self.active = None
        goal.end(outcome, code, why)
