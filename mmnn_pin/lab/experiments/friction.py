"""Friction that an experiment puts on its robot."""

from __future__ import annotations

from ...settings import Settings, require_gains


class Friction(Settings, frozen=True):
    """Viscous friction on nu, beside what the URDF says of its joints.

    Args:
        base: One number or one per base velocity [N s/m, N m s].
        arm: One number or one per joint [N m s or N s/m].
        coulomb: Dry friction of the arm's gears, one number or one per joint [N m or N]; it sticks with the integrator
            "stick", else it is smooth.
        breakaway: Ratio of static to Coulomb friction.
        stribeck: Velocity over which the one falls to the other [rad/s or m/s].
    """

    base: float | tuple[float, ...] = 0.0
    arm: float | tuple[float, ...] = 0.0
    coulomb: float | tuple[float, ...] = 0.0
    breakaway: float = 1.0
    stribeck: float = 0.05

    def __post_init__(self) -> None:
        require_gains(self, "friction")
