"""Settings: frozen msgspec structs, the same in Python and in a TOML config, which knows no unknown keys."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from .errors import ConfigError
from .signals import Array

LARGEST = 1e12  # of a number that is squared somewhere
Numbers = float | tuple[float, ...]  # one for all, or one for each; see `one_or_each`
KINDS = {
    "int": "a whole number",
    "float": "a number",
    "str": "a text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
    "null": "nothing",
}


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of all settings; a child checks its own values in `__post_init__`."""


def plain(settings: Any) -> Any:
    """Settings as JSON has them; numbers of numpy become numbers."""
    return msgspec.to_builtins(settings, enc_hook=lambda value: np.asarray(value).tolist())


def wrong_type(error: msgspec.ValidationError | str, value: Any = None) -> tuple[str, str]:
    """What is wrong and what to give instead, out of a message such as "Expected `int`, got `str` - at `$.seed`".

    Args:
        error: From a conversion.
        value: What stands there; None where that is not known.

    Returns:
        What and fix; the message itself and no fix where it is about something else than a type or a length.
    """
    message = str(error).partition(" - at ")[0]
    if missing := re.search(r"missing required field `(\w+)`", message):
        return f"the key '{missing[1]}' is missing", ""
    found = re.fullmatch(r"Expected `([a-z |]+)`(?: of length (\d+))?(?:, got `?(\w+)`?)?", message)
    if found is None or not (found[2] or found[3]):
        return message, ""
    shown = "this" if value is None else shortly(value)
    if found[2]:
        count = {None: "another length", "1": "one entry"}.get(found[3], f"{found[3]} entries")
        return f"{shown} has {count}", f"give {found[2]}"
    wanted = " or ".join(KINDS.get(name, name) for name in found[1].split(" | ") if name != "null")
    return f"{shown} is {KINDS.get(found[3], found[3])}", f"give {wanted}"


def shortly(value: Any) -> str:
    """A value as a message names it."""
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def require_at_most(settings: Settings, section: str, most: Mapping[str, int]) -> None:
    """Refuse sizes with which memory and time would explode.

    Args:
        settings: Where the sizes are.
        section: First part of the key path in an error.
        most: Field to its largest value.

    Raises:
        ConfigError: With the key path.
    """
    for name, largest in most.items():
        if getattr(settings, name) > largest:
            why, fix = "memory and time grow with it", f"use at most {largest}"
            raise ConfigError(f"{getattr(settings, name)}", why=why, fix=fix, key=f"{section}.{name}")


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
    """Refuse fields with numbers that are negative, not finite or huge, or 0 where they must not be.

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
        if name in positive and np.any(np.asarray(value) <= 0):
            raise ConfigError(f"{value}", fix="use a number > 0", key=key)
        require_gain(value, key)
        if np.any(np.asarray(value) > LARGEST):
            raise ConfigError(f"{value}", fix=f"use a number up to {LARGEST:g}", key=key)


def one_or_each(
    value: ArrayLike,
    count: int,
    kind: str,
    key: str | None = None,
    least: float | None = None,
    names: Sequence[str] = (),
) -> Array:
    """One number for all, or one for each, as one for each, (count,).

    Args:
        value: One number, or `count` of them.
        count: How many there are.
        kind: What there are, for messages: `joint`, `motor`, `velocity`.
        key: Key path of the value, for messages.
        least: Smallest number that is allowed; the numbers must then be finite. None allows all numbers.
        names: Their names, for messages.

    Raises:
        ConfigError: Another number of numbers, or one that is not allowed.
    """
    values, fix = np.asarray(value, float), f"give one number or one per {kind}"
    fix += f": {', '.join(names)}" if names else ""
    if values.shape not in ((), (count,)):
        kinds = f"{kind[:-1]}ies" if kind.endswith("y") else f"{kind}s"
        raise ConfigError(f"{values.size} numbers for {count} {kinds}", fix=fix, key=key)
    if least is not None and not (np.isfinite(values) & (values >= least)).all():
        raise ConfigError(f"{values.tolist()} cannot be used", fix=f"{fix}, finite and >= {least:g}", key=key)
    return np.full(count, values)
