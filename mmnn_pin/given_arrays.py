"""Arrays that are given to a run, such as a state to start from: checked and copied."""

from __future__ import annotations

from typing import Any

import numpy as np

from .errors import ConfigError
from .signals import Array


def given_array(key: str, values: Any, shape: tuple[int, ...], *, finite: bool = True) -> Array:
    """Copy of an array that must be of a shape, and finite unless it may be otherwise.

    Raises:
        ConfigError: It is not.
    """
    array = np.array(values, float)
    if array.shape != shape or (finite and not np.isfinite(array).all()):
        what = f"of shape {array.shape}" if array.shape != shape else "not finite"
        raise ConfigError(f"an array that is {what}", fix=f"give finite numbers of shape {shape}", key=key)
    return array
