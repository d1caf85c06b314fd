"""The mobile base: wheels found in the description, the decision which base they make, and the motions it permits.

A kind of base is one module (its maps, its law, its words) and one name here. Signals and compiled code know a base by
the number of its velocities.
"""

from __future__ import annotations

from ...compiled import compiled
from ...signals import Array
from .base import Base, Fixed
from .differential import DifferentialDrive, kanayama
from .holonomic import Holonomic, holonomic_command, moves_sideways
from .skid_steer import SkidSteer

KINDS: dict[str, type[Base]] = {kind.kind: kind for kind in (DifferentialDrive, SkidSteer, Holonomic, Fixed)}
BY_SIZE: dict[int, type[Base]] = {len(kind.velocity_names): kind for kind in reversed(KINDS.values())}


@compiled
def velocity_command(
    error: Array, v_ref: Array, a_ref: Array, velocity: Array, gains: Array, alpha: Array, alphadot: Array
) -> None:
    """Velocity command of a mobile base and its derivative; see the law of its kind for the arguments."""
    if moves_sideways(alpha.size):
        holonomic_command(error, v_ref, a_ref, velocity, gains, alpha, alphadot)
    else:
        kanayama(error, v_ref, a_ref, velocity, gains, alpha, alphadot)
