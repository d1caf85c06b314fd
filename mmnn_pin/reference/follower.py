"""What a robot follows while it runs: takes wishes as they come, and makes the setpoint of every sample.

The arithmetic is `guide`'s; here is what base and arm follow at present, since when, and what becomes of it when it is
over, when nothing more comes, and in a pause.
"""

from __future__ import annotations

import math

import numpy as np

from ..errors import ConfigError
from ..model.robot import Robot
from ..settings.arguments import is_numeric, shortly
from ..signals import Array, Setpoint
from .guide import ARM, BASE, HOLD, PLANNED, SAMPLE, VELOCITY, Limits, advance, join, new_guide, stand
from .hand import FollowHand, HandCourse
from .wishes import BaseVelocity, Course, JointGoal, Motion, Reach, Stand, Wish

LARGEST = 1e9  # a number beyond this is none [SI units]
LEAST_FADE = 0.1  # shortest time in which a motion handed in takes over [s]


class Follower:
    """Base and arm of one robot, each following the last wish for it.

    Args:
        robot: The robot.
        limits: Limits of references that are made here.
        timeout: Age of a wish that has to be renewed (full samples, velocities) at which base and arm hold [s].

    Attributes:
        now: (w,) the setpoint of the last sample: pose, velocity, acceleration, q, qdot, qddot side by side.
        losses: How often a wish was not renewed in time.
        stands: Whether it knows where the robot stands.

    Raises:
        ConfigError: Limits that do not fit the robot.
    """

    def __init__(self, robot: Robot, limits: Limits, timeout: float) -> None:
        self.dimensions, self.timeout, self.guide = robot.dimensions, timeout, new_guide(robot, limits)
        self.now, self.q = self.guide.now, robot.dimensions.pose + 2 * robot.dimensions.base
        self.wanted = Setpoint.side_by_side(self.guide.wanted, robot.dimensions)
        self.courses: list[Course | None] = [None, None]
        self.begun, self.renewed = [0.0, 0.0], [-math.inf, -math.inf]
        self.stands, self.paused, self.losses = False, math.nan, 0
        self.measured = np.zeros(robot.dimensions.pose + robot.dimensions.base + 2 * robot.dimensions.arm)

    @property
    def is_moving(self) -> bool:
        """Whether a motion or a joint goal is not over yet."""
        return any(course is not None for course in self.courses)

    def check(self, wish: Wish) -> Course | None:
        """The course of a wish that has one.

        Raises:
            ConfigError: A wish for another robot, not finite, or that cannot be planned.
        """
        d = self.dimensions
        if isinstance(wish, Setpoint):
            require_shapes("setpoint", wish, self.wanted)
            for name in wish.__slots__:
                if not (np.abs(getattr(wish, name)) < LARGEST).all():
                    raise ConfigError(
                        "a setpoint that is not finite", fix="give finite numbers", key=f"setpoint.{name}"
                    )
        elif isinstance(wish, BaseVelocity):
            velocity = np.asarray(wish.velocity, float)
            if velocity.shape != (d.base,) or not d.base or not np.isfinite(velocity).all():
                fix = f"give {d.base} finite numbers" if d.base else "leave it out: this robot has no base"
                raise ConfigError(f"a base velocity {velocity.tolist()}", fix=fix, key="setpoint.velocity")
        elif isinstance(wish, JointGoal):
            start = self.now[self.q :].reshape(3, d.arm)
            return Reach(wish, start, self.guide.arm, self.guide.ends, self.q)
        elif isinstance(wish, Motion):
            if wish.dimensions != d:
                raise ConfigError("a motion of another robot", fix="make it by the stepper's `plan`", key="setpoint")
            return wish.placed(self.now[: d.pose])
        elif isinstance(wish, FollowHand):
            if wish.body.robot.dimensions != d:
                raise ConfigError("a hand of another robot", fix="make its body of this robot", key="setpoint")
            return HandCourse(wish, self.now, self.measured)
        elif not isinstance(wish, Stand):
            fix = "give a Setpoint, a BaseVelocity, a JointGoal, a Motion, a FollowHand or HOLD"
            raise ConfigError(f"a {type(wish).__name__} as a setpoint", fix=fix, key="setpoint")
        return None

    def stand(self, measured: Array) -> None:
        """Put the reference where the robot is measured (pose, velocity, q, qdot), braking from there."""
        stand(measured, self.guide)
        self.measured[:] = measured
        self.courses[:], self.stands = (None, None), True

    def step(
        self, time: float, dt: float, measured: Array, wishes: tuple[Wish, ...], courses: list[Course | None]
    ) -> None:
        """The setpoint of a sample, into `now`.

        Args:
            time: [s].
            dt: Since the last sample [s].
            measured: Pose, velocity, q, qdot side by side.
            wishes: What came since then.
            courses: Theirs, of `check`.
        """
        self.measured[:] = measured
        if math.isnan(self.paused):
            for wish, course in zip(wishes, courses, strict=True):
                self._follow(wish, course, time, dt)
            for part in (BASE, ARM):
                self._go_on(part, time)
        advance(measured, dt, self.guide)

    def pause(self, time: float) -> None:
        """Hold; wishes are not followed, and motions wait."""
        if math.isnan(self.paused):
            self.paused = time
            self.guide.aim[:], self.guide.kind[:] = self.now, HOLD

    def resume(self, time: float) -> None:
        """Go on with the motions that wait, joined without a jump."""
        if not math.isnan(self.paused):
            waited, self.paused = time - self.paused, math.nan
            for part in (BASE, ARM):
                self.begun[part] += waited
                self._join(part, time, 0.0)

    def rehearse(self, measured: Array) -> None:
        """Call, and so compile, all that a sample calls; it leaves no trace."""
        stand(measured, self.guide)
        for part in (BASE, ARM):
            join(part, 0.0, LEAST_FADE, self.guide)
        advance(measured, 0.0, self.guide)
        for array in (self.guide.now, self.guide.aim, self.guide.wanted, self.guide.clock):
            array[:] = 0.0

    def _follow(self, wish: Wish, course: Course | None, time: float, dt: float) -> None:
        """Follow a wish from this sample on."""
        guide = self.guide
        if isinstance(wish, Setpoint):
            for name in wish.__slots__:
                getattr(self.wanted, name)[:] = getattr(wish, name)
            self.courses[:], self.renewed[:] = (None, None), (time, time)
            guide.kind[:], guide.fresh[:], guide.clock[:] = SAMPLE, 1, 0.0
        elif isinstance(wish, BaseVelocity):
            self._leave(BASE)
            np.clip(wish.velocity, -guide.base[0], guide.base[0], out=self.wanted.velocity)
            guide.kind[BASE], self.renewed[BASE] = VELOCITY, time
        elif course is not None:
            for part in course.parts:
                self._leave(part)
                planned_here = isinstance(course, Reach)  # from the last reference, which is dt old
                self.courses[part], self.begun[part] = course, time - (dt if planned_here else 0.0)
                self._join(part, time, dt)
        elif isinstance(wish, Stand):
            for part in wish.parts:
                self._leave(part)

    def _join(self, part: int, time: float, dt: float) -> None:
        """Begin to follow the course of a part at its sample of a time; dt is how old the reference is."""
        course = self.courses[part]
        if course is not None:
            course.write(time - self.begun[part], self.guide.wanted)
            join(part, dt, LEAST_FADE, self.guide)
            self.guide.kind[part] = PLANNED

    def _go_on(self, part: int, time: float) -> None:
        """The wanted sample of a part that follows a course; hold where a course is over, or a wish was not renewed."""
        kind, course = self.guide.kind[part], self.courses[part]
        if kind in (SAMPLE, VELOCITY) and time - self.renewed[part] > self.timeout:
            self._leave(part)
            self.losses += 1
        elif course is not None and not course.write(time - self.begun[part], self.guide.wanted):
            self._leave(part)

    def _leave(self, part: int) -> None:
        """Hold, from the reference as it is."""
        at = slice(0, self.q) if part == BASE else slice(self.q, None)
        self.guide.aim[at] = self.guide.now[at]
        self.courses[part], self.guide.kind[part] = None, HOLD


def require_shapes(key: str, given: object, mine: object) -> None:
    """Refuse what is no record as ours, or has arrays of other shapes.

    Raises:
        ConfigError: It is, or one has.
    """
    if not isinstance(given, type(mine)):
        what, fix = f"{shortly(given)} is no {type(mine).__name__}", f"give a {type(mine).__name__}"
        raise ConfigError(what, fix=fix, key=key)
    for name in mine.__slots__:  # type: ignore[attr-defined]
        value, ours = getattr(given, name), getattr(mine, name).shape
        shape = value.shape if isinstance(value, np.ndarray) else np.shape(value) if is_numeric(value) else None
        if shape != ours:
            raise ConfigError(f"a {key} with {name} of shape {shape}", fix=f"give one of shape {ours}", key=key)
