"""Settings of a compliant hand: stiffness, damping, how base and arm share the work, and forces."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from ..errors import ConfigError
from ..settings import Settings

Each = float | tuple[float, float, float]  # one number, or one per axis


class Impedance(Settings, frozen=True):
    """A hand that gives way: what it resists a displacement with, and how base and arm share it.

    Args:
        frame: A link or joint that the arm moves; empty for the robot's hand.
        stiffness: Stiffness of the position, one number or one per axis [N/m].
        rotation: Stiffness of the orientation, likewise; 0 leaves it free [N m/rad].
        damping: Damping of the position, likewise; None for `ratio` of critical at the start [N s/m].
        rotation_damping: Damping of the orientation, likewise [N m s].
        ratio: Damping ratio if no damping is given.
        axes: Whether axes are the world's or those of the hand's setpoint.
        share: How much of the hand's motion the base takes over, in (0, 1); the arm takes the rest.
        station: How much of its own reference the base keeps where that does not move the hand: with 1 all, with 0
            nothing, so that it goes where the hand and the arm's posture take it.
        limit: Largest force of a spring [N].
        mass: Mass of the hand if the arm takes no torques; None for the hand's effective mass at the start [kg].

    Raises:
        ConfigError: A number that is negative or not finite, or no limit.
    """

    frame: str = ""
    stiffness: Each = 300.0
    rotation: Each = 0.0
    damping: Each | None = None
    rotation_damping: Each | None = None
    ratio: float = 0.7
    axes: Literal["world", "hand"] = "world"
    share: float = 0.5
    station: float = 1.0
    limit: float = 60.0
    mass: float | None = None

    def __post_init__(self) -> None:
        for name in ("stiffness", "rotation", "damping", "rotation_damping"):
            require_not_negative(getattr(self, name), f"impedance.{name}")
        for name in ("ratio", "limit", "mass"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise ConfigError(f"{value}", fix="use a finite number > 0", key=f"impedance.{name}")
        if not 0 < self.share < 1:
            raise ConfigError(f"{self.share}", fix="use a number between 0 and 1", key="impedance.share")
        if not 0 <= self.station <= 1:
            raise ConfigError(f"{self.station}", fix="use a number from 0 to 1", key="impedance.station")


class Force(Settings, frozen=True):
    """A force of the hand on what it touches, along one direction, or along the way that a door lets it go.

    Args:
        along: Direction in the world, of any length; None for the first of down, left and ahead in which the arm can
            push.
        newtons: The force [N]; with `follow` the largest force.
        start: When the force begins [s]; nothing may touch the hand before, as its springs' load then counts as the
            model's error.
        rise: How long the force takes to grow [s].
        gain: Gain of the integral of the force error that is felt, less what is felt before `start` [1/s].
        follow: Whether the hand moves with `speed`, turning `along` to where it can move.
        speed: Speed of a hand that follows [m/s].
        far: How far a hand that follows goes [m].
        turning: How fast the direction turns to the hand's motion [1/s].

    Raises:
        ConfigError: A number out of range, or no direction.
    """

    along: tuple[float, float, float] | None = None
    newtons: float = 20.0
    start: float = 1.0
    rise: float = 0.5
    gain: float = 0.0
    follow: bool = False
    speed: float = 0.1
    far: float = 0.8
    turning: float = 8.0

    def __post_init__(self) -> None:
        for name in ("newtons", "start", "rise", "gain", "speed", "far", "turning"):
            require_not_negative(getattr(self, name), f"force.{name}")
        if self.along is not None and not (np.all(np.isfinite(self.along)) and np.any(self.along)):
            raise ConfigError(f"{self.along} is no direction", fix="use (0, 0, -1)", key="force.along")


def require_impedance(impedance: Impedance | None, force: Force | None) -> None:
    """Refuse a force of a hand that is stiff (`ConfigError`)."""
    if force is not None and impedance is None:
        fix = "add a table [impedance], empty for its defaults"
        raise ConfigError("a force of a hand that does not give way", fix=fix, key="force")


def require_not_negative(value: Any, key: str) -> None:
    """Refuse numbers that are negative or not finite; None is let pass (`ConfigError`)."""
    if value is not None and not (np.all(np.isfinite(value)) and np.all(np.asarray(value) >= 0)):
        what = f"{value} is negative or not finite"
        raise ConfigError(what, fix="use finite numbers >= 0", key=key)
