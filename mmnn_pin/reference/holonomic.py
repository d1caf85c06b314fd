"""Paths of a holonomic base: the way of any path, with a heading of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from .joint import JointProfile
from .path import BasePath, BaseSamples, times, turned
from .samples import in_three


@dataclass(frozen=True)
class HolonomicPath(BasePath):
    """A path driven while the base turns as it likes.

    With the path's world velocity `p = (xdot, ydot)` and the heading `psi`, the velocity in the reference's own frame
    is `b = R(-psi) p`, and its time derivative `R(-psi) pdot + psidot (b_y, -b_x)`.

    Raises:
        TrajectoryError: The path is not one of a mobile base.
    """

    sideways: ClassVar[bool] = True  # type: ignore[misc]
    followable: ClassVar[bool] = True

    # where the base goes: a path of a differential drive, or of a holonomic base whose heading is replaced
    path: BasePath
    heading: JointProfile | None = None  # heading of the base in the world over time [rad]; None keeps the path's own

    def __post_init__(self) -> None:
        if not isinstance(self.path, BasePath):
            raise TrajectoryError(f"{self.path!r} is not a path of a base", fix="give a Line, an Eight, Waypoints, ...")

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`."""
        t, along = times(t), self.path.sample(t)
        w, wdot = along.velocity[:, -1], along.acceleration[:, -1]
        # World velocity and acceleration, from those in the path's own frame.
        psi, (vx, vy, _), (ax, ay, _) = along.pose[:, 2], in_three(along.velocity), in_three(along.acceleration)
        rate, change = turned((vx, vy), psi), turned((ax - w * vy, ay + w * vx), psi)
        if self.heading is not None:
            profile = self.heading.sample(t)
            psi, w, wdot = profile.q, profile.qdot, profile.qddot
        (vx, vy), (ax, ay) = turned(rate, -psi), turned(change, -psi)
        return BaseSamples(
            t,
            np.stack([along.pose[:, 0], along.pose[:, 1], psi], axis=1),
            np.stack([vx, vy, w], axis=1),
            np.stack([ax + w * vy, ay - w * vx, wdot], axis=1),
        )
