"""What the whole robot should do: setpoints, from profiles of the arm joints and a path of the base.

A `SetpointSource` says at every sample where the robot should be. A `Trajectory` is one, which also knows it ahead:
`Trajectory.table` samples it for a loop, so that nothing of it is computed between the steps.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ..elementary.arrays import cos_sin
from ..errors import TrajectoryError
from ..model.base import BY_SIZE
from ..signals import Array, Dimensions, Measurement, Setpoint
from .path import BasePath, require_finite, require_positive, times
from .samples import check_followable


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
        q = self.start + by * u**2 * u * (10 - 15 * u + 6 * u**2)
        return JointSamples(q, by / T * 30 * u**2 * (1 - u) ** 2, by / (T * T) * 60 * u * (1 - u) * (1 - 2 * u))


class SetpointSource(Protocol):
    """What says where the robot should be, sample by sample: a trajectory, a planner, a joystick, ..."""

    def write(self, time: float, measurement: Measurement, setpoint: Setpoint) -> None:
        """Write the setpoint of a time [s] in place, knowing what is measured."""


@dataclass(frozen=True)
class Trajectory:
    """What the whole robot should do over time: a source of setpoints that knows them ahead.

    Args:
        base: Path of the base; None for a fixed arm.
        arm: One profile per arm joint, in the order of the robot's arm joints.
        slowness: How much more time everything takes than base and arm say.
    """

    base: BasePath | None
    arm: tuple[JointProfile, ...] = ()
    slowness: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "arm", tuple(self.arm))
        require_positive(slowness=self.slowness)

    def table(self, t: ArrayLike, layout: Dimensions) -> Array:
        """Setpoints ahead of a run: rows with pose, velocity, acceleration, q, qdot, qddot side by side.

        Args:
            t: (N,) times [s].
            layout: Sizes of the robot; a row of the table fits into `row[pose_ref.start:qddot_ref.stop]`.

        Returns:
            (N, 3 + 2 nb + 3 n) table, without the base part for a fixed arm.

        Raises:
            TrajectoryError: The base cannot follow, or it is for another kind of base or another number of joints.
        """
        t = times(t) / self.slowness
        self._require_fit(layout)
        table = np.zeros((len(t), layout.pose + 2 * layout.base + 3 * layout.arm))
        setpoints = Setpoint.side_by_side(table, layout)
        if self.base is not None:
            base = self.base.sample(t)
            if not self.base.followable and len(t) > 3:
                check_followable(t, base.pose, base.velocity)
            setpoints.pose[:], setpoints.velocity[:] = base.pose, base.velocity
            setpoints.acceleration[:] = base.acceleration
        for i, profile in enumerate(self.arm):
            joint = profile.sample(t)
            setpoints.q[:, i], setpoints.qdot[:, i], setpoints.qddot[:, i] = joint.q, joint.qdot, joint.qddot
        self._slow(setpoints)
        return table

    def write(self, time: float, measurement: Measurement, setpoint: Setpoint) -> None:
        """See `SetpointSource.write`."""
        if self.base is not None:
            base = self.base.sample([time / self.slowness])
            setpoint.pose[:], setpoint.velocity[:] = base.pose[0], base.velocity[0]
            setpoint.acceleration[:] = base.acceleration[0]
        for i, profile in enumerate(self.arm):
            joint = profile.sample([time / self.slowness])
            setpoint.q[i], setpoint.qdot[i], setpoint.qddot[i] = joint.q[0], joint.qdot[0], joint.qddot[0]
        self._slow(setpoint)

    def _slow(self, setpoint: Setpoint) -> None:
        """Rates of one setpoint or of many by the slower clock."""
        for rates in (setpoint.velocity, setpoint.qdot):
            rates /= self.slowness
        for rates in (setpoint.acceleration, setpoint.qddot):
            rates /= self.slowness * self.slowness

    def _require_fit(self, layout: Dimensions) -> None:
        nb = self.base.nb if self.base is not None else 0
        if nb != layout.base:
            raise TrajectoryError(
                f"a base path of {nb} velocities for a base of {layout.base}",
                why=", ".join(f"{size}: {kind.words}" for size, kind in sorted(BY_SIZE.items())),
                fix="choose a path made for this base" if layout.base else "leave the base path out",
            )
        if len(self.arm) != layout.arm:
            raise TrajectoryError(
                f"{len(self.arm)} arm profiles for {layout.arm} arm joints", fix=f"give {layout.arm} of them"
            )
