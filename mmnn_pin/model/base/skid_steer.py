"""The skid-steer base: wheels of a side that turn alike, or a belt around them, velocities `(v, w)`, Kanayama's law.

No wheel of it rolls exactly when it turns. The model is a differential drive on a virtual axle in the middle of the
wheels: the middle does not slip sideways, and a side's wheels roll as if they were at half the *effective track* B,

    r thetadot = sign (v -+ w B / 2)

What they slide over the floor takes work: a wheel at (x, y) under the load N slides by `x w` sideways and by
`(B/2 - |y|) w` along itself, so that Coulomb friction opposes the turning with

    sign(w) mu sum N hypot(x, B/2 - |y|)

which is a term of F. On a hard floor, with equal loads, the steady turn on the spot has `B/2 = |y| + x^2 / |y|`: there
the moment of the rims is the one that the sliding takes (J. L. Martinez et al., IJRR 24 (2005) 867, find B by
experiment).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Self

import numpy as np

from ...elementary import arrays, hypot
from ...elementary.matrices import product, pseudo_inverse
from ...errors import ConfigError
from ...signals import Array
from .base import Wheel
from .differential import DifferentialDrive

GRAVITY = 9.81  # [m/s^2]


class SkidSteer(DifferentialDrive):
    """A base that steers by sliding; its `track` is the effective one, its wheels are where they touch the floor."""

    kind = "skid_steer"
    words = "skid-steer bases"
    scrubs = True

    @property
    def rolling(self) -> tuple[Wheel, ...]:
        """The wheels at half the effective track, where they would roll as they do."""
        return tuple(replace(w, y=math.copysign(self.track / 2, w.y)) for w in self.wheels)

    def with_radii(self, factors: Mapping[str, float]) -> Self:
        """See `Base.with_radii`.

        Raises:
            ConfigError: Wheels of one side get different factors.
        """
        for side in (1.0, -1.0):
            found = {w.joint: factors[w.joint] for w in self.wheels if w.y * side > 0}
            if len(set(found.values())) > 1:
                what, why = f"{found}", "the wheels of a side turn alike, and would not roll"
                raise ConfigError(what, why=why, fix="give all wheels of a side the same factor", key="radii")
        return super().with_radii(factors)


class Tracked(SkidSteer):
    """A machine on belts: its wheels are those on the floor, and as they turn the belt does; the idlers stand still."""

    kind = "tracked"
    words = "tracked machines"


def loads(wheels: Sequence[Wheel], mass: float, centre: Array) -> Array:
    """Load of every wheel standing still, (k,) [N]: of all that hold the weight, the most even ones.

    Args:
        wheels: The wheels in the control frame.
        mass: Of the whole robot [kg].
        centre: (2,) its centre of mass in the control frame [m].
    """
    lever = np.array([[1.0, w.x, w.y] for w in wheels]).T
    held = product(pseudo_inverse(lever), mass * GRAVITY * np.array([1.0, *centre]))
    return np.asarray(np.maximum(held, 0.0))


def turning_friction(wheels: Sequence[Wheel], track: float, load: Array, mu: float) -> float:
    """Friction against turning, `mu sum N hypot(x, B/2 - |y|)` [N m].

    Args:
        wheels: The wheels in the control frame.
        track: Effective track B [m].
        load: (k,) of every wheel [N].
        mu: Coefficient of friction between wheels and floor.
    """
    slide = [hypot(w.x, track / 2 - abs(w.y)) for w in wheels]
    return float(mu * product(load, np.array(slide)))


def rotation_centre(wheels: Sequence[Wheel], load: Array) -> float:
    """Distance ahead of the middle of the centre of a turn on the spot, where the wheels' side forces cancel [m].

    Args:
        wheels: The wheels in the control frame.
        load: (k,) of every wheel [N].
    """
    from scipy.optimize import brentq  # slow to import

    along = np.array([spread(w) for w in wheels])
    x = np.array([w.x for w in wheels])

    def sideways(at: float) -> float:
        return float(product(load, (x - at) / arrays.hypot(x - at, along + 1e-9)))

    return float(brentq(sideways, x.min() - 1e-6, x.max() + 1e-6))


def turning_track(wheels: Sequence[Wheel]) -> float:
    """Effective track of a steady turn on the spot on a hard floor, the mean of `2 (|y| + x^2 / |y|)` [m]."""
    return float(np.mean([2 * (abs(w.y) + spread(w)) for w in wheels]))


def spread(wheel: Wheel) -> float:
    """Share of a wheel at (x, y) in half the effective track, `x^2 / |y|` [m]; inf in the middle, where none turns."""
    return wheel.x**2 / abs(wheel.y) if wheel.y else math.inf
