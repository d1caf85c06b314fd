"""The follower takes wishes as they come while a robot runs, and makes the setpoint of every sample.

The arithmetic is `guide`'s; here is what base and arm follow at present, since when, and what becomes of it when it is
over, when nothing more comes, and in a pause.
"""

from __future__ import annotations

import math

import numpy as np

from ..elementary import nearest_turn
from ..errors import ConfigError, TrajectoryError
from ..model.robot import Robot
from ..settings.arguments import is_numeric, shortly
from ..signals import Array, Setpoint
from .goal import Reach
from .guide import (
    ARM,
    AT_REST,
    BASE,
    HOLD,
    PLANNED,
    ROUNDING,
    SAMPLE,
    VELOCITY,
    advance,
    brake,
    drive,
    is_home,
    leave_home,
    new_guide,
    stand,
    take_joints,
    take_sample,
)
from .hand import FollowHand, HandCourse, HandWish, WishedCourse
from .limits import Limits
from .motion import between, require_within
from .steerable import pushes_trailer, require_steerable
from .wishes import BaseVelocity, Course, JointGoal, JointSample, Motion, Stand, Wish

LARGEST = 1e9  # a number beyond this is none [SI units]


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
        share: Of its own speed at which a motion is to be followed, 0 to 1; its path stays what it is.
        pace: The share at present, and at the next sample; it comes to `share` within the accelerations.

    Raises:
        ConfigError: Limits that do not fit the robot.
    """

    def __init__(self, robot: Robot, limits: Limits, timeout: float) -> None:
        self.dimensions, self.timeout, self.names = robot.dimensions, timeout, robot.joint_names
        self.base = robot.base
        self.guide = new_guide(robot, limits)
        self.now, self.q = self.guide.now, robot.dimensions.pose + 2 * robot.dimensions.twist
        self.sample = np.zeros(self.now.size)
        self.parts_of_sample = tuple(
            getattr(Setpoint.side_by_side(self.sample, robot.dimensions), name) for name in Setpoint.__slots__
        )
        self.wanted = Setpoint.side_by_side(self.guide.wanted, robot.dimensions)
        self.courses: list[Course | None] = [None, None]
        self.over = [False, False]
        self.begun, self.renewed = [0.0, 0.0], [-math.inf, -math.inf]
        self.stands, self.paused, self.losses = False, math.nan, 0
        self.share, self.pace = 1.0, (1.0, 1.0)
        self.measured = np.zeros(robot.dimensions.pose + robot.dimensions.twist + 2 * robot.dimensions.arm)

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
                require_finite(getattr(wish, name), f"setpoint.{name}")
        elif isinstance(wish, BaseVelocity):
            self._check_velocity(wish)
        elif isinstance(wish, JointSample):
            require_finite(joint_sample(wish, d.arm), "setpoint.q")
        elif isinstance(wish, JointGoal):
            return Reach(wish, self.now[self.q :].reshape(3, d.arm), self.guide, self.names)
        elif isinstance(wish, Motion):
            return self._checked(wish)
        elif isinstance(wish, FollowHand | HandWish):
            if wish.body.robot.dimensions != d:
                raise ConfigError("a hand of another robot", fix="make its body of this robot", key="setpoint")
            return (HandCourse if isinstance(wish, FollowHand) else WishedCourse)(wish, self.now, self.measured)
        elif not isinstance(wish, Stand):
            fix = "give a Setpoint, BaseVelocity, JointSample, JointGoal, Motion, FollowHand, HandWish or HOLD"
            raise ConfigError(f"a {type(wish).__name__} as a setpoint", fix=fix, key="setpoint")
        return None

    def _check_velocity(self, wish: BaseVelocity) -> None:
        """Refuse a velocity that the base cannot have.

        Raises:
            ConfigError: Not as many finite numbers as a twist has, or backwards with a trailer.
        """
        d, given = self.dimensions, wish.velocity if is_numeric(wish.velocity) else np.zeros(0)
        velocity = np.asarray(given, float)
        if velocity.shape != (d.twist,) or not d.base or not np.isfinite(velocity).all():
            fix = f"give {d.twist} finite numbers" if d.base else "leave it out: this robot has no base"
            raise ConfigError(f"a base velocity {shortly(wish.velocity)}", fix=fix, key="setpoint.velocity")
        if velocity[0] < 0.0 and pushes_trailer(self.base):
            why, fix = "a trailer that is pushed folds up", 'back along a path, with kinematic.guide = "trailer"'
            raise ConfigError("a velocity backwards with a trailer", why=why, fix=fix, key="setpoint.velocity")

    def _checked(self, wish: Motion) -> Motion:
        """A motion from where the reference is.

        Raises:
            ConfigError: It is of another robot, or beyond its limits.
        """
        d = self.dimensions
        if wish.dimensions != d:
            raise ConfigError("a motion of another robot", fix="make it by the stepper's `plan`", key="setpoint")
        try:
            motion = wish.placed(self.now[: d.pose], self.now[d.pose : d.pose + d.twist])
            motion = motion.at_nearest_turn(self.now, self.guide.turn)
            require_steerable(self.base, motion.times, Setpoint.side_by_side(motion.table, d))
        except TrajectoryError as error:
            raise ConfigError(error.what, why=error.why, fix=error.fix, key="setpoint") from error
        require_within(motion, self.guide, self.names, self.now[self.q : self.q + d.arm])
        return motion

    def stand(self, measured: Array) -> None:
        """Put the reference where the robot is measured (pose, velocity, q, qdot), braking from there."""
        stand(measured, self.guide)
        self.measured[:] = measured
        self.courses[:], self.stands = (None, None), True

    def limit(self, robot: Robot, limits: Limits) -> None:
        """Other limits from the next sample on; errors as of the class."""
        made = new_guide(robot, limits)
        for name in ("base", "wheels", "arm", "ends", "exact"):
            getattr(self.guide, name)[...] = getattr(made, name)

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
                self.begun[part] += (1.0 - 0.5 * sum(self.pace)) * dt
                self._go_on(part, time)
            if self.share < 1.0 or self.pace != (1.0, 1.0):
                self._slow_down(dt)
        advance(measured, dt, self.guide)

    def pause(self, time: float) -> None:
        """Hold; wishes are not followed, and motions wait."""
        if math.isnan(self.paused):
            self.paused = time
            for part in (BASE, ARM):
                brake(part, self.measured, self.guide)

    def resume(self, time: float) -> None:
        """Go on with the motions that wait."""
        if not math.isnan(self.paused):
            waited, self.paused = time - self.paused, math.nan
            for part, course in enumerate(self.courses):
                self.begun[part] += waited
                if course is not None:
                    self._go_after(part, course)

    def rehearse(self, measured: Array) -> None:
        """Call, and so compile, all that a sample calls; it leaves no trace."""
        stand(measured, self.guide)
        take_sample(self.now, self.guide)
        advance(measured, 0.0, self.guide)
        if self.dimensions.base:
            drive(np.zeros(self.dimensions.twist), self.guide)
        for part in (BASE, ARM):
            leave_home(part, self.guide)
            is_home(part, self.guide)
            brake(part, measured, self.guide)
        d = self.dimensions
        between(self.sample, self.sample, 0.0, 1.0, d.twist, d.sideways, self.sample)
        nearest_turn(0.0, 0.0)
        for array in (self.guide.now, self.guide.wanted, self.guide.pace, self.guide.kind, self.guide.home):
            array[:] = 0

    def _follow(self, wish: Wish, course: Course | None, time: float, dt: float) -> None:
        """Follow a wish from this sample on."""
        if isinstance(wish, Setpoint):
            for name, mine in zip(wish.__slots__, self.parts_of_sample, strict=True):
                mine[:] = getattr(wish, name)
            self.courses[:], self.renewed[:] = (None, None), (time, time)
            take_sample(self.sample, self.guide)
        elif isinstance(wish, BaseVelocity):
            self._leave(BASE)
            drive(np.asarray(wish.velocity, float), self.guide)
            self.renewed[BASE] = time
        elif isinstance(wish, JointSample):
            self.courses[ARM], self.renewed[ARM] = None, time
            take_joints(joint_sample(wish, self.dimensions.arm), self.guide)
        elif course is not None:
            # what is made of the last reference begins with it, which is dt old
            begun = time - (0.0 if isinstance(course, Motion) and not self._goes_on(course) else dt)
            for part in course.parts:
                self.courses[part], self.begun[part] = course, begun
                self._go_after(part, course)
        elif isinstance(wish, Stand):
            for part in wish.parts:
                self._stop(part)

    def _goes_on(self, motion: Motion) -> bool:
        """Whether a motion begins with the joints' reference as it moves."""
        place, rates = self.q + self.dimensions.arm, self.q + 2 * self.dimensions.arm
        first = motion.table[0, self.q : rates]
        moves = motion.table[0, place:rates].any()
        return ARM in motion.parts and bool(moves and np.abs(first - self.now[self.q : rates]).max() < ROUNDING)

    def _go_after(self, part: int, course: Course) -> None:
        """Let the reference go after the samples of a course."""
        self.guide.kind[part], self.over[part] = PLANNED, False
        leave_home(part, self.guide)
        if part == ARM:
            guide, q = self.guide, self.now[self.q :].reshape(3, -1)
            np.maximum(guide.bend, course.bends, out=guide.bend)
            stop = q[0] + 0.5 * q[1] * np.abs(q[1]) / guide.arm[1]
            least, most = course.places
            np.clip(np.minimum(least, np.minimum(q[0], stop)), *guide.ends, out=guide.span[0])
            np.clip(np.maximum(most, np.maximum(q[0], stop)), *guide.ends, out=guide.span[1])

    def _go_on(self, part: int, time: float) -> None:
        """The wanted sample of a part that follows a course; hold where a course is over, or a wish was not renewed."""
        kind, course = self.guide.kind[part], self.courses[part]
        if kind in (SAMPLE, VELOCITY) and time - self.renewed[part] > self.timeout:
            self._stop(part)
            self.losses += 1
        elif course is not None:
            was_over, self.over[part] = self.over[part], not course.write(time - self.begun[part], self.guide.wanted)
            if self.over[part] and (not course.ends_at_rest or (was_over and self._has_arrived(part))):
                self._leave(part)

    def _slow_down(self, dt: float) -> None:
        """The wanted samples of courses at the pace, and the pace of the next sample.

        A velocity v of a course is followed as `pace v`; a change of the pace costs an acceleration of `v dpace/dt`.
        """
        before, pace = self.pace
        change, longest = (pace - before) / dt if dt > 0.0 else 0.0, 0.0
        n, m, guide = self.dimensions.arm, self.dimensions.twist, self.guide
        for kind, first, size, limits in zip(guide.kind, (3, self.q + n), (m, n), (guide.base, guide.arm), strict=True):
            if kind == PLANNED and size:
                v, a = guide.wanted[first : first + 2 * size].reshape(2, size)
                longest = max(longest, float(((np.abs(v) + np.abs(a) * dt) / limits[1]).max()))  # at the next sample
                a[:] = pace * pace * a + change * v
                v *= pace
        most = dt / longest if longest > 0.0 else 1.0
        self.pace = pace, pace + min(max(self.share - pace, -most), most)

    def _stop(self, part: int) -> None:
        """Brake and stand, the base from where it is."""
        self.courses[part] = None
        brake(part, self.measured, self.guide)

    def _has_arrived(self, part: int) -> bool:
        """Whether the reference of a part is its target, or stands as near to it as the joints' ends let it."""
        d, arm = self.dimensions, self.q + self.dimensions.arm
        rates = self.now[d.pose : self.q] if part == BASE else self.now[arm : arm + 2 * d.arm]  # and bends
        return is_home(part, self.guide) or not (np.abs(rates) > AT_REST).any()

    def _leave(self, part: int) -> None:
        """Hold, from the reference as it is."""
        self.courses[part], self.guide.kind[part] = None, HOLD


def require_finite(numbers: Array, key: str) -> None:
    """Refuse numbers of a setpoint that are none (`ConfigError`)."""
    if not (np.abs(numbers) < LARGEST).all():
        raise ConfigError("a setpoint that is not finite", fix="give finite numbers", key=key)


def joint_sample(wish: JointSample, n: int) -> Array:
    """A sample of n joints as (q, qdot, qddot) side by side.

    Raises:
        ConfigError: Not n numbers each.
    """
    rows = [np.zeros(n) if part is None else part for part in (wish.q, wish.qdot, wish.qddot)]
    for name, row in zip(("q", "qdot", "qddot"), rows, strict=True):
        if not is_numeric(row) or np.shape(row) != (n,):
            fix = f"give {n} numbers"
            raise ConfigError(f"a sample of joints with {name} {shortly(row)}", fix=fix, key=f"setpoint.{name}")
    return np.concatenate(rows, dtype=float)


def require_shapes(key: str, given: object, mine: object) -> None:
    """Refuse what is no record as ours, or has arrays of other shapes (`ConfigError`)."""
    if not isinstance(given, type(mine)):
        what, fix = f"{shortly(given)} is no {type(mine).__name__}", f"give a {type(mine).__name__}"
        raise ConfigError(what, fix=fix, key=key)
    for name in mine.__slots__:  # type: ignore[attr-defined]
        value, ours = getattr(given, name), getattr(mine, name).shape
        if not is_numeric(value):
            raise ConfigError(f"a {key} with {name} that is no array of numbers", fix=f"give {ours[0]}", key=key)
        if (shape := np.shape(value)) != ours:
            raise ConfigError(f"a {key} with {name} of shape {shape}", fix=f"give one of shape {ours}", key=key)
