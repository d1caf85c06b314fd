"""What the whole robot should do, as the loop reads it: rows of reference signals."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..model.base import BY_SIZE
from ..signals import Array, Layout
from .arm import JointProfile
from .path import BasePath, times
from .samples import check_followable

SIGNALS = ("pose_ref", "velocity_ref", "acceleration_ref", "q_ref", "qdot_ref", "qddot_ref")


@dataclass(frozen=True)
class Trajectory:
    """What the whole robot should do.

    Args:
        base: Path of the base; None for a fixed arm.
        arm: One profile per arm joint, in the order of the robot's arm joints.
    """

    base: BasePath | None
    arm: tuple[JointProfile, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "arm", tuple(self.arm))

    def table(self, t: ArrayLike, layout: Layout) -> Array:
        """Rows with the signals pose_ref, velocity_ref, acceleration_ref, q_ref, qdot_ref, qddot_ref side by side.

        Args:
            t: (N,) times [s].
            layout: Layout of the robot's rows; a row of the table fits into `row[pose_ref.start:qddot_ref.stop]`.

        Returns:
            (N, 3 + 2 nb + 3 n) table, without the base part for a fixed arm.

        Raises:
            TrajectoryError: The base cannot follow, or it is for another kind of base or another number of joints.
        """
        t = times(t)
        self._require_fit(layout)
        where = {name: layout.where(name) for name in SIGNALS}
        first = where[SIGNALS[0]].start
        table = np.zeros((len(t), where[SIGNALS[-1]].stop - first))
        for name, values in self._signals(t):
            table[:, where[name].start - first : where[name].stop - first] = values
        return table

    def _signals(self, t: Array) -> Iterable[tuple[str, Array]]:
        if self.base is not None:
            base = self.base.sample(t)
            if not self.base.followable and len(t) > 3:
                check_followable(t, base.pose, base.velocity)
            yield from zip(SIGNALS[:3], (base.pose, base.velocity, base.acceleration), strict=True)
        if self.arm:
            joints = [profile.sample(t) for profile in self.arm]
            for name, part in zip(SIGNALS[3:], ("q", "qdot", "qddot"), strict=True):
                yield name, np.stack([getattr(joint, part) for joint in joints], axis=1)

    def _require_fit(self, layout: Layout) -> None:
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
