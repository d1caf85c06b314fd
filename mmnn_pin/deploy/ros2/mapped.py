"""A path of the base in the frame of a map: where it lies in the odometry's, now and when the map is corrected."""

from __future__ import annotations

import math

from ...errors import TrajectoryError
from ...reference.drive import RouteDrive
from ...reference.wishes import Motion, Stand, Wish
from ...signals import Array
from .planned import rest_of
from .sensing import STILL, Planar, Tree, composed, inverse, wrapped
from .settings import Frames


class MappedRoute:
    """The path that the base follows.

    Args:
        settings: Frames.
        tree: Where they are.

    Attributes:
        followed: The path, its frame, where that was placed, and since when [s]; None for none.
    """

    def __init__(self, settings: Frames, tree: Tree) -> None:
        self.settings, self.tree = settings, tree
        self.followed: tuple[Motion, str, Planar, float] | None = None

    def begin(self, made: Motion | Stand, frame: str, base: Array, now: float) -> Wish | str:
        """The wish that follows a path from now on; a text where its frame is not known, or it cannot be steered.

        Args:
            made: The path in its frame.
            frame: The frame.
            base: (3 + nb,) pose and velocity of the base's reference.
            now: [s].
        """
        placed = self.place_of(frame)
        if placed is None:
            return f"no way from '{frame}' to the odometry's frame by /tf"
        if isinstance(made, RouteDrive):
            try:
                made = made.placed(*seen_from(placed, base))
            except TrajectoryError as error:
                return error.what
        self.followed = None if isinstance(made, Stand) else (made, frame, placed, now)
        return made if isinstance(made, Stand) else rest_of(made, 0.0, placed)

    def placed_anew(self, now: float) -> list[Wish]:
        """The path where the map's correction has moved it to."""
        if self.followed is None:
            return []
        motion, frame, placed, since = self.followed
        there = self.place_of(frame)
        if there is None or now - since > (len(motion.table) - 1) * motion.period:
            return []
        k = round((now - since) / motion.period)
        before, after = (composed(place, tuple(motion.table[k, :3])) for place in (placed, there))
        moved = max(math.hypot(after[0] - before[0], after[1] - before[1]), abs(wrapped(there[2] - placed[2])))
        if moved < self.settings.replace:
            return []
        self.followed = motion, frame, there, since
        return [rest_of(motion, now - since, there)]

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
