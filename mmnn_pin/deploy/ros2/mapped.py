"""A path of the base in the frame of a map: where it lies in the odometry's, now and when the map is corrected."""

from __future__ import annotations

import math
from typing import NamedTuple

from ...errors import TrajectoryError
from ...reference.drive import RouteDrive
from ...reference.wishes import Motion, Stand, Wish
from ...signals import Array
from .planned import Refused, rest_of
from .sensing import STILL, Planar, Tree, composed, inverse, wrapped
from .settings import Frames


class Followed(NamedTuple):
    """A path, its frame, and where that was placed."""

    motion: Motion
    frame: str
    place: Planar


class MappedRoute:
    """The path that the base follows.

    Args:
        settings: Frames.
        tree: Where they are.

    Attributes:
        followed: The path; None for none.
        elapsed: How far along it is, at the pace at which it is followed [s].
    """

    def __init__(self, settings: Frames, tree: Tree) -> None:
        self.settings, self.tree = settings, tree
        self.followed: Followed | None = None
        self.elapsed = 0.0

    @property
    def end(self) -> Planar | None:
        """Where it ends in the odometry's frame; None where there is none."""
        return (
            None if self.followed is None else composed(self.followed.place, tuple(self.followed.motion.table[-1, :3]))
        )

    def placed(self, made: Motion | Stand, frame: str, base: Array) -> Followed | Stand:
        """A path where its frame lies now, from where the base is.

        Args:
            made: The path in its frame.
            frame: The frame.
            base: (3 + twist,) pose and velocity of the base's reference.

        Raises:
            Refused: Its frame is not known, or it cannot be steered.
        """
        if isinstance(made, Stand):
            return made
        place = self.place_of(frame)
        if place is None:
            raise Refused(f"no way from '{frame}' to the odometry's frame by /tf")
        if isinstance(made, RouteDrive):
            try:
                made = made.placed(*seen_from(place, base))
            except TrajectoryError as error:
                raise Refused(error.what) from error
        return Followed(made, frame, place)

    def follow(self, found: Followed | Stand) -> Motion | Stand:
        """The wish that follows a path from now on."""
        if isinstance(found, Stand):
            return found
        self.followed, self.elapsed = found, 0.0
        return rest_of(found.motion, 0.0, found.place)

    def placed_anew(self, moved_on: float) -> list[Wish]:
        """The path where the map's correction has moved it to, so much further along [s]."""
        self.elapsed += moved_on
        if self.followed is None or self.elapsed > self.followed.motion.duration:
            return []
        motion, frame, placed = self.followed
        there = self.place_of(frame)
        if there is None:
            return []
        k = round(self.elapsed / motion.period)
        before, after = (composed(place, tuple(motion.table[k, :3])) for place in (placed, there))
        moved = max(math.hypot(after[0] - before[0], after[1] - before[1]), abs(wrapped(there[2] - placed[2])))
        if moved < self.settings.replace:
            return []
        self.followed = Followed(motion, frame, there)
        return [rest_of(motion, self.elapsed, there)]

    def place_of(self, frame: str) -> Planar | None:
        """Where a frame lies in the odometry's; None where that is not known."""
        if frame in ("", self.settings.odom):
            return STILL
        found = self.tree.between(self.settings.odom, frame)
        return None if found is None else found[0]


def seen_from(place: Planar, base: Array) -> tuple[Planar, Array]:
    """Pose and velocity (nb,) of a base (3 + nb,) in a frame at a place."""
    x, y, phi = base[:3].tolist()
    return composed(inverse(place), (x, y, phi)), base[3:]
