"""What the contact plant stands on: friction, patches of other friction, stiffness of the casters."""

from __future__ import annotations

import math
from typing import Literal

from ...errors import ConfigError
from ...settings import Settings


class Patch(Settings, frozen=True):
    """A rectangle of the floor with another friction.

    Args:
        friction: Coulomb coefficient between wheel and floor.
        x: From, to [m]; None for all.
        y: From, to [m]; None for all.

    Raises:
        ConfigError: A negative or non-finite coefficient, or an interval that is none.
    """

    friction: float
    x: tuple[float, float] | None = None
    y: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        require_friction(self.friction, "contact.patches.friction")
        for name in ("x", "y"):
            interval = getattr(self, name)
            if interval is not None and not -math.inf < interval[0] < interval[1] < math.inf:
                raise ConfigError(f"{interval}", fix="give from < to, both finite", key=f"contact.patches.{name}")

    def holds(self, x: float, y: float) -> bool:
        """Whether a point is on it."""
        return within(x, self.x) and within(y, self.y)


class Contact(Settings, frozen=True):
    """Settings of the contact plant.

    Args:
        friction: Coulomb coefficient between wheels and floor; casters have none.
        patches: Places with another friction; the last one that holds a wheel counts.
        step: Longest step of the engine [s]; the plant's step is divided until it is short enough.
        casters: "rigid" as the wheels are, or "soft" (they leave more of the weight to the wheels).

    Raises:
        ConfigError: A negative or non-finite coefficient, or a step that is not in (0, 0.01] s.
    """

    friction: float = 1.0
    patches: tuple[Patch, ...] = ()
    step: float = 0.0005
    casters: Literal["rigid", "soft"] = "rigid"

    def __post_init__(self) -> None:
        require_friction(self.friction, "contact.friction")
        if not 0 < self.step <= 0.01:
            raise ConfigError(f"{self.step} s", fix="use a step in (0, 0.01] s", key="contact.step")

    def at(self, x: float, y: float) -> float:
        """Friction at a point of the floor."""
        found = [patch.friction for patch in self.patches if patch.holds(x, y)]
        return found[-1] if found else self.friction


def within(value: float, interval: tuple[float, float] | None) -> bool:
    """Whether a number lies in an interval; None is all numbers."""
    return interval is None or interval[0] <= value <= interval[1]


def require_friction(value: float, key: str) -> None:
    """Refuse a coefficient that is negative or not finite.

    Raises:
        ConfigError: With the key path.
    """
    if not (math.isfinite(value) and value >= 0):
        raise ConfigError(f"{value} is negative or not finite", fix="use a finite number >= 0", key=key)
