"""Arguments: values of Python held against their annotations, and the words for one that does not fit.

What is public holds its arguments against its annotations: `checked` before a function, `require_types` in a dataclass.
Any sequence stands for a list, any number for a float, whatever numpy makes numbers of for an array; a text is no list.
"""

from __future__ import annotations

import builtins
import collections.abc
import inspect
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, wraps
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin

import msgspec
import numpy as np

from ..errors import ConfigError, MmnnError, UnknownArgument, short

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
UNIONS = (Union, UnionType)
HOW = {"Robot": 'load("platform_arm")', "CompiledController": "PD()"}  # what needs a word more
HOW |= {"Trajectory": "Trajectory.of(robot, base=Line(0.3))"}
HOW |= {"Loop": "Loop(robot, trajectory, PD())", "Experiment": 'load_experiment("track")'}
HOW |= {"Recording": 'Recording.open("run.h5")'}


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """A public function that holds its arguments against its annotations first.

    Raises:
        ConfigError: One of a wrong type, with the function and the argument as its key.
        UnknownArgument: One that the function does not have.
    """
    return checked_but()(function)


def checked_but(*own: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """As `checked`, but for arguments that the function itself refuses, in better words.

    Args:
        own: Their names.
    """

    def mark(function: Callable[P, R]) -> Callable[P, R]:
        signature = inspect.signature(function)
        takes_any = any(one.kind is one.VAR_KEYWORD for one in signature.parameters.values())

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            if not takes_any:
                require_known(function, kwargs, [name for name in signature.parameters if name != "self"])
            given = signature.bind(*args, **kwargs).arguments
            require_fit(function, {name: value for name, value in given.items() if name not in own})
            return function(*args, **kwargs)

        return call

    return mark


def faced(kind: type[R]) -> type[R]:
    """A public class whose methods, called with arguments that do not fit, end in an error of this package.

    Arguments are looked at once something was raised: what fits costs nothing. Where all are of their types, and some
    are numbers, these have a shape or values that the method cannot take.
    """
    for name, found in list(vars(kind).items()):
        function = getattr(found, "__func__", found)
        if inspect.isfunction(function) and (not name.startswith("_") or name == "__getitem__"):
            told = guarded(function)
            setattr(kind, name, told if function is found else type(found)(told))
    return kind


def guarded(function: Callable[P, R]) -> Callable[P, R]:
    """A method of `faced`."""
    signature = inspect.signature(function)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except (MmnnError, OSError, MemoryError):
            raise
        except Exception as error:
            try:
                given = signature.bind(*args, **kwargs).arguments
            except TypeError:
                raise error from None
            owner = next(iter(given.values()), None)
            name = f"{getattr(owner, '__name__', type(owner).__name__)}.{function.__name__}"
            require_fit(function, given, name)
            kinds = {"self": Any, "cls": Any, **hints(function)}
            if not any(is_numbers(part) for one in given for part in (kinds[one], *get_args(kinds[one]))):
                raise
            why, fix = " ".join(str(error).split()), "give as many finite numbers as it says"
            raise ConfigError("arguments that do not fit", why=why, fix=fix, key=name) from error

    return call


def require_types(made: Any, *own: str) -> None:
    """Hold the fields of a dataclass against their annotations; for its `__post_init__`.

    Args:
        made: The dataclass.
        own: Fields that it refuses itself, in better words.

    Raises:
        ConfigError: A value of a wrong type, with class and field as its key.
    """
    require_fit(type(made), {name: value for name, value in vars(made).items() if name not in own})


def require_known(owner: Any, given: Iterable[str], known: Iterable[str]) -> None:
    """Refuse the first of some arguments that a function or a class does not have (`UnknownArgument`)."""
    for name in given:
        if name not in known:
            raise UnknownArgument("argument", name, known, key=name_of(owner))


def name_of(owner: Any) -> str:
    """A function or a class as who calls it writes it."""
    return str(owner.__qualname__).removesuffix(".__init__")


def require_fit(owner: Any, given: Mapping[str, Any], called: str = "") -> None:
    """Refuse the first of some arguments that is not of the type that its owner, a function or a class, says.

    Args:
        owner: It.
        given: Arguments by name.
        called: How the owner is called, where that is not as it was defined.

    Raises:
        ConfigError: With the value and what to give.
    """
    kinds = hints(owner)
    for name, value in given.items():
        if name in kinds and not fits(value, kinds[name]):
            what, fix = misfit(value, kinds[name])
            raise ConfigError(what, fix=fix, key=f"{called or name_of(owner)}.{name}")


def misfit(value: Any, kind: Any) -> tuple[str, str]:
    """Two phrases on a value that is not of an annotated type: what is wrong, and what to give."""
    there = KINDS.get(NAMES.get(type(value), ""), f"of the type {type(value).__name__}")
    fix = wanted(kind)
    return shortly(value) if fix.startswith(there) else f"{shortly(value)} is {there}", f"give {fix}"


class Names(dict[str, Any]):
    """Names of a module; of one that only a type checker imports nothing is asked."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, Any)


@lru_cache(None)
def hints(owner: Any) -> dict[str, Any]:
    """Types of the fields of a class or of the arguments of a function."""
    found: dict[str, Any] = {}
    for one in reversed(getattr(owner, "__mro__", (owner,))):
        names = Names(vars(sys.modules[one.__module__]))
        found |= inspect.get_annotations(one, locals=names, eval_str=True)
    return found


def fits(value: Any, kind: Any) -> bool:
    """Whether a value is of an annotated type; any sequence stands for a list, any number for a float."""
    try:
        return is_of(value, kind)
    except Exception:  # no Unicode, a signalling NaN, a list in itself, whatever its own methods raise
        return False


def is_of(value: Any, kind: Any) -> bool:
    """As `fits`; what the value's own methods raise is raised."""
    if type(value) is kind or kind in (Any, object):
        return True
    if kind is NoneType or (isinstance(value, np.ndarray) and value.dtype.kind == "O" and not value.ndim):
        return False  # as a list, what is masked is None, an object in an array itself
    test, parts = test_of(kind)
    if test is not None:
        return test(value)
    if isinstance(value, np.ndarray) and kind in (str, Path):
        return False
    if isinstance(value, str | bytes) and get_origin(kind) not in (None, Literal):
        return False  # a text is no list
    if get_origin(kind) is tuple and parts[-1] is not ... and isinstance(value, Sequence):
        return len(value) == len(parts) and all(map(fits, value, parts))
    try:
        msgspec.convert(bare(value), kind)
    except msgspec.ValidationError:
        return False
    except TypeError:  # of items of several classes
        items = value.values() if isinstance(value, Mapping) else value
        of = parts[0] if parts[-1] is ... else parts[-1]
        return isinstance(value, get_origin(kind)) and all(fits(item, of) for item in items)
    return True


@lru_cache(None)  # a robot's thirty fields are looked at for each of its variants
def test_of(kind: Any) -> tuple[Callable[[Any], bool] | None, tuple[Any, ...]]:
    """The test of a value for unions, numbers, functions and classes, None where msgspec knows; the kind's parts."""
    parts = parts_of(kind)
    if get_origin(kind) in UNIONS:
        return lambda value: any(fits(value, part) for part in parts), parts
    if is_numbers(kind):
        return is_numeric, parts
    if get_origin(kind) is collections.abc.Callable:
        return callable, parts
    of_its_own = isinstance(kind, type) and get_origin(kind) is None and kind not in NAMES
    return (lambda value: isinstance(value, kind)) if of_its_own else None, parts


def parts_of(kind: Any) -> tuple[Any, ...]:
    """Types that a type is made of; of a union with numpy's `ArrayLike` not the texts that this has beside numbers."""
    parts = get_args(kind)
    if get_origin(kind) in UNIONS and any(map(is_numbers, parts)):
        return tuple(p for p in parts if is_numbers(p) or p is NoneType or get_origin(p))
    return parts


def bare(value: Any) -> Any:
    """Numbers of numpy as Python's, also in tables, and all sequences as lists."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: bare(item) for key, item in value.items()}
    is_list = isinstance(value, Sequence) and not isinstance(value, str | bytes)
    return [bare(item) for item in value] if is_list else value


def is_numbers(kind: Any) -> bool:
    """Whether a type is one of numpy's arrays, or of what it makes arrays of."""
    return get_origin(kind) is np.ndarray or str(getattr(kind, "__module__", "")).startswith("numpy._typing")


def is_numeric(value: Any) -> bool:
    """Whether numpy makes numbers of a value; of one that is masked it would make those under the mask."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "biuf" and not isinstance(value, np.ma.MaskedArray)
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except Exception:  # whatever its own methods raise
        return False


def wanted(kind: Any) -> str:
    """A phrase for values of an annotated type: what to give."""
    origin, parts = get_origin(kind), parts_of(kind)
    if origin in UNIONS:
        return " or ".join(dict.fromkeys(wanted(part) for part in parts if part is not NoneType))
    if origin is Literal:
        return " or ".join(map(repr, parts))
    if is_numbers(kind):
        return "numbers"
    if origin is collections.abc.Callable:
        return "a function"
    if origin is tuple and parts[-1] is not ...:
        return f"{len(parts)} values: {', '.join(map(wanted, parts))}"
    if origin is not None:
        is_table = issubclass(origin, Mapping)
        return f"a table, each value {wanted(parts[1])}" if is_table else f"a list, each item {wanted(parts[0])}"
    name = getattr(kind, "__name__", str(kind))
    such = f", such as {HOW[name]}" if name in HOW else ""
    return KINDS.get(NAMES.get(kind, ""), f"{'an' if name[0] in 'AEIOU' else 'a'} {name}") + such


def unknown_key(error: msgspec.ValidationError) -> str | None:
    """The key that settings do not have, whatever its characters, out of an error of a conversion; None for another."""
    found = re.fullmatch(r"Object contains unknown field `(.*?)`(?: - at `\$.*`)?", str(error), re.S)
    return found[1] if found else None


def wrong_type(error: msgspec.ValidationError | str, value: Any = None) -> tuple[str, str]:
    """Two phrases out of a message such as "Expected `int`, got `str` - at `$.seed`": what is wrong, and what to give.

    Args:
        error: From a conversion.
        value: What stands there; None where that is not known.

    Returns:
        What and fix; the message itself and no fix where it is about something else than a type or a length.
    """
    message = str(error).partition(" - at ")[0]
    if missing := re.search(r"missing required field `(\w+)`", message):
        return f"the key '{missing[1]}' is missing", "write it"
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
    try:
        text = str(value).lower() if type(value) is bool else " ".join(repr(value).split())
    except Exception:  # of its own
        text = object.__repr__(value)
    return short(text, 60)
