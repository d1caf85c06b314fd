"""Wishes for a robot that runs, beside a full `Setpoint` per sample; `guide` makes setpoints of them.

    HOLD                              brake and stand
    BaseVelocity((0.3, 0.1))          what a joystick or a navigation stack sends
    JointSample(q)                    one of samples that the joints follow, as a planner or another controller sends
    JointGoal(q)                      joints to a goal, or through several, at rest there, within jerk limits
    Motion.of(trajectory, ...)        a motion known ahead, of the base, of the arm, or of both
    FollowHand(body, path)            the hand along a path, by base and arm together
    HandWish(body)                    the hand to places or at velocities that are told on the way

Base and arm may follow different ones: `(BaseVelocity((0.3, 0.0)), JointGoal(q))`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from numpy.typing import ArrayLike

from ..signals import Array, Setpoint
from .guide import ARM, BASE
from .hand import FollowHand, HandWish
from .motion import Motion


@dataclass(frozen=True)
class Stand:
    """Brake within the limits of the accelerations, and stand."""

    parts: tuple[int, ...] = (BASE, ARM)  # which parts of the robot; base and arm by default


HOLD = Stand()


@dataclass(frozen=True)
class BaseVelocity:
    """A velocity of the base; the robot goes where it leads, pose errors are zero. It has to be renewed.

    Args:
        velocity: (twist,) in the control frame [m/s, rad/s]. A car keeps its v and turns no tighter than its steering
            reaches: a turn on the spot is none, and it stands.
    """

    velocity: ArrayLike


@dataclass(frozen=True)
class JointSample:
    """One sample of a motion of the joints, while the base follows something else. It has to be renewed.

    Args:
        q: (n,) positions [rad or m].
        qdot: (n,) rates, None for rest [rad/s or m/s].
        qddot: (n,) accelerations, None for none [rad/s^2 or m/s^2].
    """

    q: ArrayLike
    qdot: ArrayLike | None = None
    qddot: ArrayLike | None = None


@dataclass(frozen=True)
class JointGoal:
    """A goal of the joints, reached at rest in the shortest time within speed, acceleration and jerk (`ruckig`).

    A joint without ends goes to it by the nearest turn.

    Args:
        q: (n,) one goal, or (k, n) goals one after the other [rad or m].
        qdot: (k, n) with which rate to pass them, 0 at the last; None for rest at each [rad/s or m/s].
    """

    q: ArrayLike
    qdot: ArrayLike | None = None


class Course(Protocol):
    """A motion that a part of the robot follows: its samples by the time since it began."""

    @property
    def parts(self) -> tuple[int, ...]:
        """Which parts of the robot it moves."""

    @property
    def ends_at_rest(self) -> bool:
        """Whether nothing moves in its last sample."""

    @property
    def places(self) -> Array:
        """Least and largest places of the joints, (2, n) [rad or m]."""

    @property
    def bends(self) -> Array:
        """Largest accelerations of the joints that it brings along, (n,); 0 for those of what is made here."""

    def write(self, elapsed: float, wanted: Array) -> bool:
        """Write the sample of a time [s] into a flat setpoint; false once it is over, with the last sample."""


Wish = Setpoint | BaseVelocity | JointSample | JointGoal | Motion | FollowHand | HandWish | Stand
