"""Motions of one arm joint: position, rate and acceleration over time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..elementary.arrays import cos_sin
from ..errors import TrajectoryError
from ..settings.arguments import require_types
from ..signals import Array
from .path import require_finite, require_positive, times

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


@dataclass(frozen=True)
class JointSamples:
    """A joint profile at N instants, each (N,), in rad (or m) and seconds."""

    q: Array
    qdot: Array
    qddot: Array


class JointProfile(ABC):
    """A motion of one arm joint."""

    @abstractmethod
    def sample(self, t: ArrayLike) -> JointSamples:
        """Position, rate and acceleration at the times `t` (N,) [s], counted from the start of the run."""


@dataclass(frozen=True)
class Sine(JointProfile):
    """`q = offset + amplitude sin(2 pi t / period + phase)`.

    Args:
        amplitude: [rad or m].
        period: [s].
        offset: [rad or m].
        phase: [rad].

    >>> Sine(amplitude=0.5, period=4.0, offset=0.2).sample([0.0, 1.0]).q.round(3).tolist()
    [0.2, 0.7]
    """

    amplitude: float
    period: float
    offset: float = 0.0
    phase: float = 0.0

    def __post_init__(self) -> None:
        require_types(self)
        require_finite(amplitude=self.amplitude, offset=self.offset, phase=self.phase)
        require_positive(period=self.period)

    def sample(self, t: ArrayLike) -> JointSamples:
        """See `JointProfile.sample`."""
        rate = 2 * np.pi / self.period
        angle = rate * times(t) + self.phase
        cosine, sine = cos_sin(angle)
        swing = self.amplitude * sine
        return JointSamples(self.offset + swing, self.amplitude * rate * cosine, -(rate * rate) * swing)


@dataclass(frozen=True)
class Sines(JointProfile):
    """`q = offset + sum of amplitude sin(2 pi t / period + phase)`: a motion that excites more than one sine does.

    Args:
        amplitude: One per sine [rad or m].
        period: Likewise [s].
        offset: [rad or m].
        phase: One per sine [rad]; empty for 0.

    Raises:
        TrajectoryError: No sines, not as many periods or phases as amplitudes, or one that a sine cannot have.
    """

    amplitude: tuple[float, ...]
    period: tuple[float, ...]
    offset: float = 0.0
    phase: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        require_types(self)
        require_finite(offset=self.offset)
        count = len(self.amplitude)
        if not count or len(self.period) != count or len(self.phase) not in (0, count):
            what = f"{count} amplitudes, {len(self.period)} periods, {len(self.phase)} phases"
            raise TrajectoryError(what, fix="give one of each per sine; phases may be left out")
        _ = self.sines

    @cached_property
    def sines(self) -> tuple[Sine, ...]:
        """Its parts, around 0."""
        phases = self.phase or (0.0,) * len(self.amplitude)
        parts = zip(self.amplitude, self.period, phases, strict=True)
        return tuple(Sine(amplitude, period, 0.0, phase) for amplitude, period, phase in parts)

    def sample(self, t: ArrayLike) -> JointSamples:
        """See `JointProfile.sample`."""
        parts = [sine.sample(t) for sine in self.sines]
        q, qdot, qddot = (np.sum([getattr(part, name) for part in parts], axis=0) for name in ("q", "qdot", "qddot"))
        return JointSamples(self.offset + q, qdot, qddot)


@dataclass(frozen=True)
class Hold(JointProfile):
    """A joint at rest at `value` [rad or m].

    >>> Hold(0.8).sample([0.0, 1.0]).q.tolist()
    [0.8, 0.8]
    """

    value: float

    def __post_init__(self) -> None:
        require_types(self)
        require_finite(value=self.value)

    def sample(self, t: ArrayLike) -> JointSamples:
        """See `JointProfile.sample`."""
        zero = np.zeros_like(times(t))
        return JointSamples(zero + self.value, zero, zero.copy())


@dataclass(frozen=True)
class MinimumJerk(JointProfile):
    """From rest to rest by the polynomial of least jerk, `10 u^3 - 15 u^4 + 6 u^5`; at rest before and after.

    Args:
        start: Where it begins [rad or m].
        goal: Where it ends [rad or m].
        duration: Time of the motion [s].
        begin: When the motion begins [s].
    """

    start: float
    goal: float
    duration: float
    begin: float = 0.0

    def __post_init__(self) -> None:
        require_types(self)
        require_finite(start=self.start, goal=self.goal, begin=self.begin)
        require_positive(duration=self.duration)

    def sample(self, t: ArrayLike) -> JointSamples:
        """See `JointProfile.sample`."""
        u = np.clip((times(t) - self.begin) / self.duration, 0, 1)
        by, T = self.goal - self.start, self.duration
        q = self.start + by * u**2 * u * (10 - 15 * u + 6 * u**2)
        return JointSamples(q, by / T * 30 * u**2 * (1 - u) ** 2, by / (T * T) * 60 * u * (1 - u) * (1 - 2 * u))


@dataclass(frozen=True)
class Points(JointProfile):
    """Through positions at times, from rest to rest by a cubic spline; at rest before and after.

    Raises:
        TrajectoryError: Fewer than two, not one time for each, or times that do not increase from 0 or later.
    """

    time: tuple[float, ...]  # (k,) increasing times [s]
    position: tuple[float, ...]  # (k,) [rad or m]

    def __post_init__(self) -> None:
        require_types(self)
        time, position = (np.asarray(part, float) for part in (self.time, self.position))
        if time.ndim != 1 or position.shape != time.shape or time.size < 2:
            what = f"{position.size} positions at {time.size} times"
            raise TrajectoryError(what, fix="give one time for each of two or more positions")
        require_finite(time=time, position=position)
        if time[0] < 0 or (np.diff(time) <= 0).any():
            raise TrajectoryError(f"the times {time.tolist()} do not increase from 0 on", fix="sort them")
        for name, part in (("time", time), ("position", position)):
            object.__setattr__(self, name, tuple(part.tolist()))

    @property
    def duration(self) -> float:
        """When it is at rest [s]."""
        return self.time[-1]

    @cached_property
    def _spline(self) -> CubicSpline:
        from scipy.interpolate import CubicSpline  # slow to import, seldom needed

        return CubicSpline(self.time, self.position, bc_type="clamped")

    def sample(self, t: ArrayLike) -> JointSamples:
        """See `JointProfile.sample`."""
        t = times(t)
        at, moves = np.clip(t, self.time[0], self.time[-1]), (t >= self.time[0]) & (t < self.time[-1])
        q, qdot, qddot = (self._spline(at, order) for order in range(3))
        return JointSamples(q, np.where(moves, qdot, 0.0), np.where(moves, qddot, 0.0))


@dataclass(frozen=True, eq=False)
class JointTable(JointProfile):
    """A motion given by samples, from any planner: cubic splines between them.

    Raises:
        TrajectoryError: Arrays of different lengths, fewer than four samples, or times that do not increase from 0.
    """

    time: Array  # (N,) increasing times [s], the first 0
    position: Array  # (N,) [rad or m]
    velocity: Array | None = None  # (N,) [rad/s or m/s]; None for the slope of a spline through the positions

    def __post_init__(self) -> None:
        require_types(self)
        time, position = (np.array(part, float) for part in (self.time, self.position))
        velocity = None if self.velocity is None else np.array(self.velocity, float)
        if time.ndim != 1 or position.shape != time.shape or (velocity is not None and velocity.shape != time.shape):
            shapes = ", ".join(str(part.shape) for part in (time, position, velocity) if part is not None)
            raise TrajectoryError(f"samples of a joint of shapes {shapes}", fix="give as many of each: (N,)")
        require_finite(time=time, position=position, **({} if velocity is None else {"velocity": velocity}))
        require_clock(time)
        for name, part in (("time", time), ("position", position), ("velocity", velocity)):
            object.__setattr__(self, name, part)

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.time[-1])

    @cached_property
    def _splines(self) -> tuple[CubicSpline, CubicSpline]:
        from scipy.interpolate import CubicHermiteSpline, CubicSpline  # slow to import, seldom needed

        if self.velocity is None:
            spline = CubicSpline(self.time, self.position)
            return spline, spline.derivative()
        return CubicHermiteSpline(self.time, self.position, self.velocity), CubicSpline(self.time, self.velocity)

    def sample(self, t: ArrayLike) -> JointSamples:
        """See `JointProfile.sample`.

        Raises:
            TrajectoryError: A time lies after the last sample.
        """
        at = within(times(t), float(self.time[-1]))
        position, velocity = self._splines
        return JointSamples(position(at), velocity(at), velocity(at, 1))


def require_clock(time: Array) -> None:
    """Refuse times of samples that do not increase from 0, or that are too few for a spline (`TrajectoryError`)."""
    if len(time) < 4:
        what = f"{len(time)} samples" if len(time) != 1 else "1 sample"
        raise TrajectoryError(what, why="a spline takes four or more", fix="add some between them")
    if (early := np.flatnonzero(np.diff(time) <= 0)).size:
        k = int(early[0]) + 1
        what = f"time does not increase at sample {k}: {time[k - 1]:g} s, then {time[k]:g} s"
        raise TrajectoryError(what, fix="sort the samples, leave out those that stand there twice")
    if time[0] != 0:
        raise TrajectoryError(
            f"time starts at {time[0]:g} s", fix="subtract that from all times, so that it starts at 0"
        )


def within(t: Array, end: float) -> Array:
    """Times that samples up to `end` [s] have something for.

    Raises:
        TrajectoryError: One lies after it.
    """
    if t.size and t.max() > end + 1e-9:
        what = f"the reference ends at {end:g} s, but the run asks for t = {t.max():g} s"
        raise TrajectoryError(what, fix=f"shorten the run: time.duration = {end:g}")
    return np.minimum(t, end)
