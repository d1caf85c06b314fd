"""The mobile base: wheels found in the description, the decision which base they make, and the motions it permits.

A kind of base is one module (its maps, its law, its words) and one name here. `Dimensions` has that name; compiled code
knows a base by `Dimensions.sideways`, in which of the two laws differ that drive a pose.
"""

from __future__ import annotations

from ...compiled import compiled
from ...signals import Array, Dimensions
from .base import Base, Fixed
from .differential import DifferentialDrive, kanayama
from .holonomic import HolonomicBase, holonomic_command
from .skid_steer import SkidSteer, Tracked
from .steered import STEERED_KINDS

ALL: tuple[type[Base], ...] = (DifferentialDrive, SkidSteer, Tracked, HolonomicBase, *STEERED_KINDS, Fixed)
KINDS: dict[str, type[Base]] = {kind.kind: kind for kind in ALL}


def kind_of(dimensions: Dimensions) -> type[Base]:
    """The kind of base of a robot with these dimensions."""
    return KINDS[dimensions.kind]


@compiled
def velocity_command(
    sideways: int,
    error: Array,
    v_ref: Array,
    a_ref: Array,
    velocity: Array,
    gains: Array,
    alpha: Array,
    alphadot: Array,
) -> None:
    """Velocity command of a base that moves sideways or not, and its derivative; arguments as of either law."""
    if sideways:
        holonomic_command(error, v_ref, a_ref, velocity, gains, alpha, alphadot)
    else:
        kanayama(error, v_ref, a_ref, velocity, gains, alpha, alphadot)
