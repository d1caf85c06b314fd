"""Values of names while a function is translated: a number, a few of them, an array in memory, or an object.

Numbers whose value is known keep it: sizes, offsets and kinds of a robot are known when C is written, so they end up as
numbers in its text, and branches that they decide are not written at all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

# How tightly a text of C binds, so that parentheses are written where they are needed.
OR, AND, CHOICE, COMPARE, SUM, PRODUCT, UNARY, ATOM = 1, 2, 0, 5, 8, 9, 10, 12

KINDS = ("bool", "int", "long", "real")  # the later holds the earlier
C_TYPES = {"bool": "bool", "int": "int32_t", "long": "int64_t", "real": "real"}
SMALL = 2**31


@dataclass(frozen=True)
class Number:
    """A truth value, an integer of 32 or 64 bits, or a floating-point number."""

    kind: str  # one of `KINDS`
    text: str  # in C
    binds: int = ATOM  # how tightly the text binds
    value: Any = None  # its value where that is known
    everywhere: str = ""  # a text of a known number that means the same in every function; empty for `text`

    @property
    def is_known(self) -> bool:
        """Whether its value is known."""
        return self.value is not None

    def within(self, binds: int) -> str:
        """The text as a part of one that binds so."""
        return self.text if self.binds >= binds else f"({self.text})"


@dataclass
class Root:
    """A block of memory: a member of the controller's struct, or a constant table."""

    name: str  # in C
    data: np.ndarray  # (size,) what it holds at the start
    kind: str  # "real" or "int"
    live: np.ndarray  # (size,) the same memory, as it is at present
    # name, start and size of the members that it is split into, where it is split
    parts: list[tuple[str, int, int]] = field(default_factory=list)
    about: str = ""  # its meaning and units, as its class says beside the field


@dataclass
class Pointer:
    """A pointer that is a local name or a parameter."""

    name: str  # in C
    of: tuple[Any, ...] = ()  # what it points into, as far as that is known
    is_written: bool = False  # whether anything is written through it


@dataclass(frozen=True)
class ArrayValue:
    """An array: where it begins, its shape and its strides, in elements; `alias` is a pointer to where it begins."""

    base: Root | Pointer
    offset: Number
    shape: tuple[Number, ...]
    strides: tuple[Number, ...]
    kind: str
    alias: Pointer | None = None

    @property
    def layout(self) -> str:
        """C for rows one after the other, F for columns, A for anything else; as numba's types have it."""
        if self.strides == row_strides(self.shape):
            return "C"
        return "F" if self.strides == tuple(reversed(row_strides(tuple(reversed(self.shape))))) else "A"


@dataclass(frozen=True)
class Vec:
    """Some numbers of one kind side by side, a struct in C."""

    text: str
    size: int


@dataclass(frozen=True)
class Tuple:
    """Values side by side that C never sees as one; of a named tuple its class is known."""

    items: tuple[Any, ...]
    of: type | None = None


@dataclass(frozen=True)
class Static:
    """A Python object that is known when C is written: None, a function, a named tuple of arrays, the stepper."""

    object: Any  # the object
    name: str = ""  # how its parts are called in C


Value = Number | ArrayValue | Vec | Tuple | Static


def integer(value: int, text: str = "") -> Number:
    """A known integer."""
    is_small = -SMALL <= value < SMALL
    text = text or (str(value) if is_small else f"INT64_C({value})" if value > -(2**63) else "INT64_MIN")
    binds = ATOM if value >= 0 or not text.startswith("-") else UNARY
    return Number("int" if is_small else "long", text, binds, int(value))


def real(value: float, text: str = "") -> Number:
    """A known floating-point number."""
    return Number("real", text or spelled(value), ATOM if text or not value < 0 else UNARY, float(value))


def truth(value: bool) -> Number:
    """A known truth value."""
    return Number("bool", "true" if value else "false", ATOM, bool(value))


def spelled(value: float) -> str:
    """A number as C reads it back exactly."""
    if math.isnan(value):
        return "MMNN_NAN"
    if math.isinf(value):
        return "MMNN_INF" if value > 0 else "-MMNN_INF"
    return repr(float(value))


def joined(*kinds: str) -> str:
    """The kind that holds all of these."""
    return KINDS[max(KINDS.index(kind) for kind in kinds)]


def row_strides(shape: tuple[Number, ...]) -> tuple[Number, ...]:
    """Strides of rows one after the other."""
    strides = [integer(1)]
    for size in reversed(shape[1:]):
        strides.insert(0, times(strides[0], size))
    return tuple(strides)


def plus(a: Number, b: Number) -> Number:
    """Sum of integers."""
    if (a.is_known and a.value == 0) or (b.is_known and b.value == 0):
        return b if a.is_known and a.value == 0 else a
    if a.is_known and b.is_known:
        return integer(a.value + b.value)
    if b.is_known and b.value < 0:
        return Number(joined(a.kind, b.kind), f"{a.within(SUM)} - {-b.value}", SUM)
    return Number(joined(a.kind, b.kind), f"{a.within(SUM)} + {b.within(SUM)}", SUM)


def minus(a: Number, b: Number) -> Number:
    """Difference of integers; of a sum and what it begins with it is the rest."""
    if a.is_known and b.is_known:
        return integer(a.value - b.value)
    if a == b:
        return integer(0)
    rest = a.text.removeprefix(f"{b.within(SUM)} + ")
    if a.text.startswith(f"{b.within(SUM)} + ") and rest.isdigit():
        return integer(int(rest))
    if b.is_known and b.value == 0:
        return a
    return Number(joined(a.kind, b.kind), f"{a.within(SUM)} - {b.within(PRODUCT)}", SUM)


def times(a: Number, b: Number) -> Number:
    """Product of integers."""
    for one, other in ((a, b), (b, a)):
        if one.is_known and one.value in (0, 1):
            return other if one.value else integer(0)
    if a.is_known and b.is_known:
        return integer(a.value * b.value)
    return Number(joined(a.kind, b.kind), f"{a.within(PRODUCT)} * {b.within(UNARY)}", PRODUCT)


def leaves(value: Value, name: str) -> Iterator[tuple[str, Number | Pointer | Root | Vec, Any]]:
    """Parts of a value that a function in C may be handed: name, number or pointer, and the array."""
    if isinstance(value, Number | Vec):
        yield name, value, None
    elif isinstance(value, ArrayValue):
        yield name, value.base, value
        for place, size in zip(dimensions(name, len(value.shape)), value.shape, strict=True):
            yield place, size, None
        if value.layout == "A":
            for i, stride in enumerate(value.strides):
                yield f"{name}_stride{i}", stride, None
    elif isinstance(value, Tuple):
        names = value.of._fields if value.of is not None else range(len(value.items))  # type: ignore[attr-defined]
        for part, item in zip(names, value.items, strict=True):
            yield from leaves(item, f"{name}_{part}")


def dimensions(name: str, count: int) -> list[str]:
    """Names of an array's sizes."""
    ends = {1: ["size"], 2: ["rows", "columns"]}.get(count) or [f"size{i}" for i in range(count)]
    return [f"{name}_{end}" for end in ends]


def structure(value: Value) -> Any:
    """The key of a value: calls whose arguments have equal keys are calls of one function in C."""
    if isinstance(value, Number):
        return value.kind
    if isinstance(value, Vec):
        return value.size
    if isinstance(value, ArrayValue):
        return value.kind, len(value.shape), value.layout
    if isinstance(value, Tuple):
        return (value.of, *map(structure, value.items))
    return id(value.object)
