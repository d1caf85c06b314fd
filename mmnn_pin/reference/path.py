"""What paths of the base are made of: a curve driven with a smooth progress, differentiated by the chain rule.

The paths of a differential drive are curves `(x(s), y(s))` driven with a smooth `s(t)`. With `g = |d(x, y)/ds|`
(negative when driven tail first) and heading `phi(s)`:

    v = g sdot                          w = phi' sdot
    vdot = g' sdot^2 + g sddot          wdot = phi'' sdot^2 + phi' sddot

so `xdot = v cos phi`, `ydot = v sin phi`, `phidot = w` hold by construction: the base can follow, thesis (2.6).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..signals import Array


@dataclass(frozen=True)
class BaseSamples:
    """A base path at N instants.

    Attributes:
        t: (N,) time [s].
        pose: (N, 3) pose of the control frame in the world `(x, y, phi)`, phi unwrapped [m, m, rad].
        velocity: (N, nb) base velocity in the reference's own frame, `(v, w)`; `(vx, vy, w)` of a holonomic base
            [m/s, rad/s].
        acceleration: (N, nb) its time derivative [m/s^2, rad/s^2].
    """

    t: Array
    pose: Array
    velocity: Array
    acceleration: Array


class BasePath(ABC):
    """A motion of the base.

    Attributes:
        nb: Number of base velocities, 2 for a differential drive, 3 for a holonomic base.
        followable: True for a path that the base can follow by construction; others are checked when sampled.
    """

    nb: int = 2
    followable: ClassVar[bool] = False

    @abstractmethod
    def sample(self, t: ArrayLike) -> BaseSamples:
        """Pose, velocity and acceleration at the times `t` (N,) [s], counted from the start of the run."""


@dataclass(frozen=True)
class Progress:
    """Path parameter s over time, each (N,)."""

    s: Array
    ds: Array
    dds: Array


@dataclass(frozen=True)
class Curve:
    """A curve at N parameters s: position, heading, signed speed `g`, `k = dphi/ds`; dg and dk are d/ds; each (N,)."""

    x: Array
    y: Array
    phi: Array
    g: Array
    dg: Array | float
    k: Array
    dk: Array | float


def start_up(t: Array, rate: float, ramp: float) -> Progress:
    """Reach `ds/dt = rate` from rest within `ramp` seconds, by a minimum-jerk polynomial; at once if `ramp = 0`."""
    if ramp == 0:
        return Progress(rate * t, np.full_like(t, rate), np.zeros_like(t))
    u = np.clip(t / ramp, 0, 1)
    s = rate * (ramp * u**4 * (2.5 - 3 * u + u**2) + np.maximum(t - ramp, 0))
    return Progress(s, rate * u**3 * (10 - 15 * u + 6 * u**2), rate * 30 * u**2 * (1 - u) ** 2 / ramp)


def there_and_stop(t: Array, rate: float, ramp: float, length: float) -> Progress:
    """As `start_up`, but the motion mirrors itself in time and rests at `s = length` from `length / rate + ramp` on."""
    left = length / rate + ramp - t
    first, last = start_up(t, rate, ramp), start_up(np.maximum(left, 0), rate, ramp)
    ending = left < t
    ds = np.where(left < 0, 0.0, np.where(ending, last.ds, first.ds))
    return Progress(np.where(ending, length - last.s, first.s), ds, np.where(ending, -last.dds, first.dds))


def driven(t: ArrayLike, progress: Progress, curve: Curve) -> BaseSamples:
    """Samples of a curve driven with a given progress, by the chain rule at the top of this module."""
    s, c = progress, curve
    velocity = np.stack([c.g * s.ds, c.k * s.ds], axis=1)
    acceleration = np.stack([c.dg * s.ds**2 + c.g * s.dds, c.dk * s.ds**2 + c.k * s.dds], axis=1)
    return BaseSamples(np.asarray(t, float), np.stack([c.x, c.y, c.phi], axis=1), velocity, acceleration)


def times(t: ArrayLike) -> Array:
    """Times as an array (N,).

    Raises:
        TrajectoryError: They are not a list of finite numbers from 0 on.
    """
    t = np.asarray(t, float)
    if t.ndim != 1 or not np.isfinite(t).all() or (t < 0).any():
        raise TrajectoryError("sample times are not a list of finite numbers >= 0", why="a run starts at t = 0")
    return t


def require_finite(**values: float | tuple[float, ...] | Array) -> None:
    """Refuse a parameter that is not finite."""
    for name, value in values.items():
        if not np.isfinite(np.asarray(value, float)).all():
            raise TrajectoryError(f"{name} = {value} is not finite", fix="give finite numbers")


def require_positive(**values: float) -> None:
    """Refuse a parameter that is not a finite number above 0."""
    require_finite(**values)
    for name, value in values.items():
        if value <= 0:
            raise TrajectoryError(f"{name} = {value} is not positive", fix=f"give {name} > 0")


def require_start(start: tuple[float, float, float], ramp: float) -> None:
    """Refuse a start that is not `(x, y, phi)`, and a ramp that is not a number of seconds from 0 on."""
    require_finite(start=start, ramp=ramp)
    if len(start) != 3:
        raise TrajectoryError(f"start = {start} is not a pose", fix="give (x, y, phi) in m, m, rad")
    if ramp < 0:
        raise TrajectoryError(f"ramp = {ramp} s is negative", fix="give a time, or 0 to start at full speed")
