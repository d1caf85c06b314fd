"""What a robot may be asked to do while it runs, beside a full `Setpoint` per sample; `guide` makes setpoints of it.

    HOLD                              brake and stand
    BaseVelocity((0.3, 0.1))          what a joystick or a navigation stack sends
    JointGoal(q)                      joints to a goal, or through several, at rest there, within jerk limits
    Motion.of(trajectory, ...)        a motion known ahead, of the base, of the arm, or of both
    FollowHand(body, path)            the hand along a path, by base and arm together

Base and arm may follow different ones: `(BaseVelocity((0.3, 0.0)), JointGoal(q))`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ..elementary import cos_sin
from ..errors import ConfigError, TrajectoryError
from ..settings import given_array
from ..signals import Array, Dimensions, Setpoint
from .guide import ARM, BASE
from .hand import FollowHand
from .trajectory import Trajectory

MOST_ROWS = 10_000_000  # of a motion


@dataclass(frozen=True)
class Stand:
    """Brake within the limits of the accelerations, and stand.

    Args:
        parts: Which parts of the robot; base and arm by default.
    """

    parts: tuple[int, ...] = (BASE, ARM)


HOLD = Stand()


@dataclass(frozen=True)
class BaseVelocity:
    """A velocity of the base; the robot goes where it leads, pose errors are zero. It has to be renewed.

    Args:
        velocity: (nb,) in the control frame [m/s, rad/s].
    """

    velocity: ArrayLike


@dataclass(frozen=True)
class JointGoal:
    """A goal of the joints, reached at rest in the shortest time within speed, acceleration and jerk (`ruckig`).

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

    def write(self, elapsed: float, wanted: Array) -> bool:
        """Write the sample of a time [s] into a flat setpoint; false once it is over, with the last sample."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Samples of a motion at a period, made ahead: nothing of it is computed while the robot runs.

    Attributes:
        table: (N, 3 + 2 nb + 3 n) setpoints side by side.
        period: Between two of them [s].
        parts: Which parts of the robot they are for.
        dimensions: Of the robot.
        from_here: Whether the path of the base starts at the reference pose of the moment in place of its own.
    """

    table: Array
    period: float
    parts: tuple[int, ...]
    dimensions: Dimensions
    from_here: bool = False
    shift: Array = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def of(
        cls,
        trajectory: Trajectory,
        duration: float,
        period: float,
        dimensions: Dimensions,
        from_here: bool = False,
    ) -> Motion:
        """The samples of a trajectory; one without a base path or without profiles moves the other part only.

        Raises:
            TrajectoryError: The base cannot follow, it is for another robot, or it has no end.
        """
        if not (0 < duration < np.inf and 0 < period < np.inf and duration / period < MOST_ROWS):
            fix = f"give seconds > 0, and at most {MOST_ROWS:,} samples"
            raise TrajectoryError(f"{duration:g} s in samples of {period:g} s", fix=fix)
        d, t = dimensions, np.arange(round(duration / period) + 1) * period
        parts = (*((BASE,) if trajectory.base is not None else ()), *((ARM,) if trajectory.arm else ()))
        moved = Dimensions(d.base if BASE in parts else 0, d.arm if ARM in parts else 0, d.full, d.motors)
        part = trajectory.table(t, moved)
        table = np.zeros((len(t), d.pose + 2 * d.base + 3 * d.arm))
        start = 0 if BASE in parts else d.pose + 2 * d.base
        table[:, start : start + part.shape[1]] = part
        return cls(table, period, parts, dimensions, from_here)

    @classmethod
    def through(
        cls,
        time: ArrayLike,
        q: ArrayLike,
        period: float,
        dimensions: Dimensions,
        qdot: ArrayLike | None = None,
        qddot: ArrayLike | None = None,
    ) -> Motion:
        """A motion of the arm through points: cubic splines, Hermite with rates, of degree five with accelerations too.

        Args:
            time: (k,) times of the points [s], increasing from 0 on.
            q: (k, n) joints [rad or m].
            period: Between two samples [s].
            dimensions: Of the robot.
            qdot: (k, n) rates; without them the motion is at rest at its ends.
            qddot: (k, n) accelerations; with rates only.

        Raises:
            TrajectoryError: Points of wrong shape, not finite, or out of order.
        """
        from scipy.interpolate import BPoly, CubicHermiteSpline, CubicSpline  # slow to import, seldom needed

        n, at = dimensions.arm, np.asarray(time, float)
        points = [np.asarray(part, float) for part in (q, qdot, qddot) if part is not None]
        if any(part.shape != (at.size, n) or not np.isfinite(part).all() for part in points) or at.size < 2:
            raise TrajectoryError(
                f"points that are not finite numbers of shape ({at.size}, {n})", fix="give two or more"
            )
        if not (np.isfinite(at).all() and at[0] >= 0 and (np.diff(at) > 0).all()):
            raise TrajectoryError("times of points out of order", fix="let them increase from 0 on")
        at = at - at[0]
        if len(points) == 1:
            spline: Any = CubicSpline(at, points[0], bc_type="clamped")
        elif len(points) == 2:
            spline = CubicHermiteSpline(at, *points)
        else:
            spline = BPoly.from_derivatives(at, np.stack(points, axis=1))
        t = np.minimum(np.arange(round(at[-1] / period) + 1) * period, at[-1])
        table = np.zeros((len(t), dimensions.pose + 2 * dimensions.base + 3 * n))
        setpoints = Setpoint.side_by_side(table, dimensions)
        setpoints.q[:], setpoints.qdot[:], setpoints.qddot[:] = spline(t), spline(t, 1), spline(t, 2)
        return cls(table, period, (ARM,), dimensions)

    def write(self, elapsed: float, wanted: Array) -> bool:
        """See `Course`; the sample nearest in time."""
        k = round(elapsed / self.period)
        row, q = self.table[min(k, len(self.table) - 1)], self.dimensions.pose + 2 * self.dimensions.base
        if ARM in self.parts:
            wanted[q:] = row[q:]
        if BASE in self.parts:
            wanted[:q] = row[:q]
            x, y, turn = self.shift
            c, s = cos_sin(turn)
            wanted[0], wanted[1] = x + c * row[0] - s * row[1], y + s * row[0] + c * row[1]
            wanted[2] += turn
        return k < len(self.table)

    def placed(self, pose: Array) -> Motion:
        """The same, its path beginning at a pose (3,) where it is to start from here."""
        if not self.from_here or BASE not in self.parts:
            return self
        x, y, phi = self.table[0, :3]
        turn = pose[2] - phi
        c, s = cos_sin(turn)
        shift = np.array([pose[0] - c * x + s * y, pose[1] - s * x - c * y, turn])
        return Motion(self.table, self.period, self.parts, self.dimensions, False, shift)


class Reach:
    """A joint goal planned by ruckig from where the reference is; its time per sample is a microsecond.

    Args:
        goal: The goal.
        start: (3, n) q, qdot, qddot of the reference.
        limits: (3, n) speed, acceleration and jerk.
        ends: (2, n) ends of the joints.
        first: Where q begins in a flat setpoint.

    Raises:
        ConfigError: A goal of wrong shape, not finite or outside the joints' ends; ruckig is missing or finds no way.
    """

    parts = (ARM,)

    def __init__(self, goal: JointGoal, start: Array, limits: Array, ends: Array, first: int) -> None:
        n, shape = limits.shape[1], np.atleast_2d(np.asarray(goal.q, float)).shape
        points = given_array("setpoint.q", np.atleast_2d(np.asarray(goal.q, float)), (shape[0], n))
        rates = given_array("setpoint.qdot", np.zeros_like(points) if goal.qdot is None else goal.qdot, points.shape)
        outside = np.argwhere((points < ends[0]) | (points > ends[1]))
        if len(outside):
            k, i = outside[0]
            what, why = f"joint {i} to {points[k, i]:.4g}", f"its ends are {ends[0, i]:.4g} and {ends[1, i]:.4g}"
            raise ConfigError(what, why=why, fix="give a goal between them", key="setpoint.q")
        self.first, self.n, self.legs, self.ends = first, n, [], [0.0]
        state = start
        for q, qdot in zip(points, rates, strict=True):
            leg = planned(state, q, qdot, limits)
            self.legs.append(leg)
            self.ends.append(self.ends[-1] + leg.duration)
            state = np.array([q, qdot, np.zeros(n)])

    @property
    def duration(self) -> float:
        """Time that it takes [s]."""
        return self.ends[-1]

    def write(self, elapsed: float, wanted: Array) -> bool:
        """See `Course`."""
        leg = 0
        while leg + 1 < len(self.legs) and elapsed >= self.ends[leg + 1]:
            leg += 1
        inside = min(elapsed - self.ends[leg], self.legs[leg].duration)
        wanted[self.first :].reshape(3, self.n)[:] = self.legs[leg].at_time(inside)[:3]
        return elapsed < self.ends[-1]


def planned(start: Array, q: Array, qdot: Array, limits: Array) -> Any:
    """The fastest motion of the joints from a state (3, n) to q with qdot, (n,), within limits (3, n).

    Raises:
        ConfigError: ruckig is missing, or finds no way.
    """
    try:
        import ruckig
    except ImportError as error:
        fix = "pip install 'mmnn_pin[tasks]', or give full setpoints"
        raise ConfigError("a joint goal without ruckig", fix=fix, key="setpoint") from error
    n = limits.shape[1]
    asked, found = ruckig.InputParameter(n), ruckig.Trajectory(n)
    asked.current_position, asked.current_velocity, asked.current_acceleration = start.tolist()
    asked.target_position, asked.target_velocity = q.tolist(), qdot.tolist()
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = limits.tolist()
    try:
        result = ruckig.Ruckig(n).calculate(asked, found)
    except RuntimeError as error:
        raise ConfigError("a joint goal that cannot be planned", why=str(error), key="setpoint.q") from error
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        why = f"ruckig says {result.name}"
        raise ConfigError("a joint goal that cannot be planned", why=why, fix="raise [limits]", key="setpoint.q")
    return found


Wish = Setpoint | BaseVelocity | JointGoal | Motion | FollowHand | Stand
