"""Arguments: values of Python held against their annotations, and the words for one that does not fit.

What is public holds its arguments against its annotations: `checked` before a function, `require_types` in a dataclass.
Any sequence stands for a list, any number for a float, whatever numpy makes numbers of for an array; a text is no list.
"""

from __future__ import annotations

import collections.abc
import inspect
import re
import sys
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache, wraps
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin

import msgspec
import numpy as np

from ..errors import ConfigError

KINDS = {
    "int": "a whole number",
    "float": "a number",
    "str": "a text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
    "null": "nothing",
    "path": "a path",
}
NAMES = {int: "int", float: "float", str: "str", bool: "bool", list: "array", tuple: "array", dict: "object"}
NAMES |= {NoneType: "null", Path: "path"}
P = ParamSpec("P")
R = TypeVar("R")
FORMERLY = {"guess": "prior"}  # texts that an older version took
LARGEST_FLOAT = sys.float_info.max
NUMBERS: dict[Any, Any] = {bool: (bool, np.bool_), int: Integral, float: Real}
HOW = {"Robot": 'load("platform_arm")', "CompiledController": "PD()"}  # what needs a word more
HOW |= {"Trajectory": "Trajectory.of(robot, base=Line(0.3))"}
HOW |= {"Loop": "Loop(robot, trajectory, PD())", "Experiment": 'load_experiment("track")'}
HOW |= {"Recording": 'Recording.open("run.h5")'}


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """A public function that holds its arguments against its annotations first.

    Raises:
        ConfigError: One of a wrong type, with the function and the argument as its key.
    """
    return checked_but()(function)


def checked_but(*own: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """As `checked`, but for arguments that the function itself refuses, in better words.

    Args:
        own: Their names.
    """

    def mark(function: Callable[P, R]) -> Callable[P, R]:
        signature = inspect.signature(function)

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            given = signature.bind(*args, **kwargs).arguments
            require_fit(function, {name: value for name, value in given.items() if name not in own})
            return function(*args, **kwargs)

        return call

    return mark


def require_types(made: Any, *own: str) -> None:
    """Hold the fields of a dataclass against their annotations; for its `__post_init__`.

    Args:
        made: The dataclass.
        own: Fields that it refuses itself, in better words.

    Raises:
        ConfigError: A value of a wrong type, with class and field as its key.
    """
    require_fit(type(made), {name: value for name, value in vars(made).items() if name not in own})


def require_fit(owner: Any, given: Mapping[str, Any]) -> None:
    """Refuse the first of some arguments that is not of the type that its owner, a function or a class, says.

    Raises:
        ConfigError: With the value and what to give.
    """
    kinds = hints(owner)
    for name, value in given.items():
        if name in kinds and not fits(value, kinds[name]):
            what, fix = misfit(value, kinds[name])
            raise ConfigError(what, fix=fix, key=f"{owner.__qualname__.removesuffix('.__init__')}.{name}")


def misfit(value: Any, kind: Any) -> tuple[str, str]:
    """What is wrong with a value that is not of an annotated type, and what to give."""
    now = FORMERLY.get(value) if isinstance(value, str) else None
    if now and fits(now, kind):
        return f"'{value}' is now called '{now}'", f"write '{now}'"
    there = KINDS.get(NAMES.get(type(value), ""), f"of the type {type(value).__name__}")
    fix = wanted(kind)
    return shortly(value) if fix.startswith(there) else f"{shortly(value)} is {there}", f"give {fix}"


@lru_cache(None)
def hints(owner: Any) -> dict[str, Any]:
    """Types of the fields of a class or the arguments of a function, without those that only a type checker knows."""
    found = {}
    for one in reversed(owner.__mro__) if isinstance(owner, type) else (owner,):
        names = vars(sys.modules.get(getattr(one, "__module__", ""), object))
        for name, kind in vars(one).get("__annotations__", getattr(one, "__annotations__", {})).items():
            with suppress(NameError, AttributeError, TypeError, SyntaxError):
                found[name] = eval(kind, dict(names)) if isinstance(kind, str) else kind
    return found


def fits(value: Any, kind: Any) -> bool:
    """Whether a value is of an annotated type; any sequence stands for a list, any number for a float."""
    return type(value) is kind or test_of(kind)(value)


@lru_cache(None)  # a robot's thirty fields are looked at for each of its variants
def test_of(kind: Any) -> Callable[[Any], bool]:
    """Whether a value is of an annotated type, as a function of the value."""
    origin, parts = get_origin(kind), get_args(kind)
    if kind in (Any, object) or isinstance(kind, TypeVar):
        return lambda value: True
    if origin in (Union, UnionType):
        numeric = [part for part in parts if is_numbers(part)]  # `ArrayLike` beside them has texts
        parts = tuple(part for part in parts if part is NoneType or get_origin(part)) if numeric else parts
        return lambda value: any(fits(value, part) for part in (*numeric, *parts))
    if origin is Literal:
        return lambda value: any(type(value) is type(part) and value == part for part in parts)
    if is_numbers(kind):
        return is_numeric
    if origin is not None:
        return test_of_items(origin, parts)
    if kind in NUMBERS:
        return lambda value: is_number(value, kind)
    if getattr(kind, "_is_protocol", False):
        names = typing._get_protocol_attrs(kind)  # type: ignore[attr-defined]
        return lambda value: all(hasattr(value, name) for name in names)
    return lambda value: not isinstance(kind, type) or isinstance(value, kind)


def test_of_items(origin: Any, parts: tuple[Any, ...]) -> Callable[[Any], bool]:
    """Whether a value is a list, a table, a function with items of annotated types, as a function of the value."""
    if origin is collections.abc.Callable:
        return callable
    if issubclass(origin, Mapping):
        key, item = parts
        return lambda value: (
            isinstance(value, Mapping) and all(fits(k, key) and fits(v, item) for k, v in value.items())
        )
    if not issubclass(origin, Iterable):
        return lambda value: isinstance(value, origin)
    return lambda value: is_list(value, origin, parts)


def is_list(value: Any, origin: Any, parts: tuple[Any, ...]) -> bool:
    """Whether a value is a list with items of annotated types."""
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable) or not getattr(value, "ndim", 1):
        return False
    if not isinstance(value, Sequence | np.ndarray):
        return not issubclass(origin, Sequence)  # what may be gone once it has been looked at
    kinds = parts[:1] * len(value) if origin is not tuple or parts[-1] is ... else parts
    return len(kinds) == len(value) and all(map(fits, value, kinds))


def is_number(value: Any, kind: Any) -> bool:
    """Whether a value is a number of a kind, or true or false."""
    too_large = kind is float and isinstance(value, int) and abs(value) > LARGEST_FLOAT
    return isinstance(value, NUMBERS[kind]) and (kind is bool or not isinstance(value, bool)) and not too_large


def is_numbers(kind: Any) -> bool:
    """Whether a type is one of numpy's arrays, or of what it makes arrays of."""
    return get_origin(kind) is np.ndarray or str(getattr(kind, "__module__", "")).startswith("numpy._typing")


def is_numeric(value: Any) -> bool:
    """Whether numpy makes numbers of a value."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "biuf"
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except Exception:  # whatever its own methods raise
        return False


def wanted(kind: Any) -> str:
    """What to give, in words."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        if any(map(is_numbers, parts)):  # what else `ArrayLike` stands for, such as texts, is not meant
            parts = tuple(part for part in parts if is_numbers(part) or isinstance(get_origin(part), type))
        return " or ".join(dict.fromkeys(wanted(part) for part in parts if part is not NoneType))
    if origin is Literal:
        return " or ".join(map(repr, parts))
    if is_numbers(kind):
        return "numbers"
    if origin is collections.abc.Callable:
        return "a function"
    if origin is tuple and parts[-1] is not ...:
        return f"{len(parts)} values: {', '.join(map(wanted, parts))}"
    if origin is not None and issubclass(origin, Mapping):
        return f"a table, each value {wanted(parts[1])}"
    if origin is not None:
        return f"a list, each item {wanted(parts[0])}"
    name = getattr(kind, "__name__", str(kind))
    such = f", such as {HOW[name]}" if name in HOW else ""
    return KINDS.get(NAMES.get(kind, ""), f"{'an' if name[0] in 'AEIOU' else 'a'} {name}") + such


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
    text = str(value).lower() if isinstance(value, bool) else " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
