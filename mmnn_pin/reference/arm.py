"""Profiles of the arm joints: sine, sum of sines, hold, minimum jerk."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..signals import Array
from .path import require_finite, require_positive, times


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
    """

    amplitude: float
    period: float
    offset: float = 0.0
    phase: float = 0.0

    def __post_init__(self) -> None:
        require_finite(amplitude=self.amplitude, offset=self.offset, phase=self.phase)
        require_positive(period=self.period)

    def sample(self, t: ArrayLike) -> JointSamples:
        """See `JointProfile.sample`."""
        rate = 2 * np.pi / self.period
        angle = rate * times(t) + self.phase
        swing = self.amplitude * np.sin(angle)
        return JointSamples(self.offset + swing, self.amplitude * rate * np.cos(angle), -(rate**2) * swing)


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
    """A joint at rest at `value` [rad or m]."""

    value: float

    def __post_init__(self) -> None:
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
        require_finite(start=self.start, goal=self.goal, begin=self.begin)
        require_positive(duration=self.duration)

    def sample(self, t: ArrayLike) -> JointSamples:
        """See `JointProfile.sample`."""
        u = np.clip((times(t) - self.begin) / self.duration, 0, 1)
        by, T = self.goal - self.start, self.duration
        q = self.start + by * u**3 * (10 - 15 * u + 6 * u**2)
        return JointSamples(q, by / T * 30 * u**2 * (1 - u) ** 2, by / T**2 * 60 * u * (1 - u) * (1 - 2 * u))
