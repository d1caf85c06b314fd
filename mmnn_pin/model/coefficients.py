"""Coefficients as a user gives them: one number for all joints, or one for each."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ConfigError
from ..signals import Array


def one_or_each(
    what: str, given: ArrayLike, count: int, *, least: int = 0, key: str | None = None, fix: str = ""
) -> Array:
    """What was given as finite numbers >= least: one for all, shape (), or one for each, (count,).

    Raises:
        ConfigError: It is something else.
    """
    values = np.asarray(given, float)
    if values.shape not in ((), (count,)) or not (np.isfinite(values) & (values >= least)).all():
        fix = fix or f"give one finite number >= {least}, or {count} of them"
        raise ConfigError(f"{what} {values.tolist()} cannot be used", fix=fix, key=key)
    return values
