"""Settings: frozen msgspec structs, the same in Python and in a TOML config, which knows no unknown keys."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import msgspec
import numpy as np

from .errors import ConfigError


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of all settings; a child checks its own values in `__post_init__`."""


def plain(settings: Any) -> Any:
    """Settings as JSON has them; numbers of numpy become numbers."""
    return msgspec.to_builtins(settings, enc_hook=lambda value: np.asarray(value).tolist())


def require_gains(settings: Settings, section: str, *names: str) -> None:
    """Refuse numbers that are negative or not finite.

    Args:
        settings: Where the numbers are.
        section: First part of the key path in an error.
        names: Fields to check; all if none are named.

    Raises:
        ConfigError: With the key path.
    """
    for name in names or settings.__struct_fields__:
        require_gain(getattr(settings, name), f"{section}.{name}")


def require_gain(value: Any, key: str) -> None:
    """Refuse a number, or numbers, negative or not finite.

    Raises:
        ConfigError: With the key path.
    """
    if not np.all(np.isfinite(value)) or np.any(np.asarray(value) < 0):
        raise ConfigError(f"{value} is negative or not finite", fix="use a finite number >= 0", key=key)


def require_numbers(settings: Settings, section: str, positive: Collection[str]) -> None:
    """Refuse fields with numbers that are negative or not finite, or 0 where they must not be.

    Fields that are None or a text are let pass.

    Args:
        settings: Where the numbers are.
        section: First part of the key path in an error.
        positive: Fields whose numbers must be > 0.

    Raises:
        ConfigError: With the key path.
    """
    for name in settings.__struct_fields__:
        value, key = getattr(settings, name), f"{section}.{name}"
        if value is None or isinstance(value, str):
            continue
        require_gain(value, key)
        if name in positive and not np.all(np.asarray(value) > 0):
            raise ConfigError(f"{value}", fix="use a number > 0", key=key)
