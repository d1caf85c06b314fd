"""Limits of a robot's motors: those of its URDF, or one number for all, or one for each."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from ..errors import ConfigError
from ..signals import Array
from .robot import Robot

Numbers = float | tuple[float, ...]


def each(key: str, value: Numbers, count: int, kind: str = "motor") -> Array:
    """One number per motor, or per joint.

    Raises:
        ConfigError: Neither one number nor one for each.
    """
    given = np.asarray(value, float)
    if given.shape not in ((), (count,)):
        raise ConfigError(f"{given.size} numbers for {count} {kind}s", fix=f"give one, or one per {kind}", key=key)
    return np.broadcast_to(given, (count,))


def limits(key: str, value: Literal["urdf"] | Numbers | None, urdf: Array, kind: str = "motor") -> Array:
    """Limits of all motors or joints: those of the URDF, given ones, or inf for None; errors as in `each`."""
    return urdf if isinstance(value, str) else each(key, math.inf if value is None else value, urdf.size, kind)


def speed_limits(robot: Robot) -> Array:
    """Velocity limits of the URDF of every motor's joint, inf where it states none or 0, (motors,)."""
    names, limits = robot.full_velocity_names, robot.model.velocityLimit
    found = [limits[names.index(name)] if name in names else math.inf for name in robot.actuator_names]
    return np.array([limit if 0 < limit < 1e30 else math.inf for limit in found], float)
