"""The whole program: which functions there are, what is known of their arguments, what lies in memory.

It is translated from one call, on the objects that a stepper has in memory. A parameter that is the same in all calls
is no parameter in C, an array that nobody writes is a constant table. Both are found by assuming the most and starting
again where a call or a line says otherwise, until nothing changes.
"""

from __future__ import annotations

import re
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...settings.meanings import meanings
from .source import defined_in, source_of
from .values import (
    C_TYPES,
    ArrayValue,
    Number,
    Pointer,
    Root,
    Static,
    Tuple,
    Value,
    Vec,
    dimensions,
    integer,
    leaves,
    real,
    row_strides,
    spelled,
    structure,
    truth,
)  # fmt: skip

VARIES = object()


@dataclass
class Parameter:
    """A parameter of a function in C: a number, a struct, or a pointer."""

    name: str
    kind: Any
    pointer: Pointer | None = None


@dataclass
class CFunction:
    """A function in C."""

    name: str  # its name
    source: Any  # where it comes from
    parameters: dict[str, Parameter] = field(default_factory=dict)  # by name, those that are used
    result: Any = None  # kind of a number, size of a struct, kinds of several numbers, or None
    text: str = ""  # the lines of its body
    head: str = ""  # its declaration
    comment: str = ""  # its docstring
    is_math: bool = False  # whether it is one of `mmnn_pin.elementary`: those keep two words per number
    uses_self: bool = False  # whether it needs the controller
    is_empty: bool = False  # whether it does nothing


class CProgram:
    """A program in C, made of functions of Python.

    Args:
        write: Translates one function (`body.write`).
        real: "double" or "float".
    """

    def __init__(self, write: Callable[..., None], real: str = "double") -> None:
        self.writer, self.real = write, real
        self.known: dict[Any, Any] = {}
        self.written: set[str] = set()
        self.dropped: set[str] = set()
        self.roots: dict[int, Root] = {}
        self.kept: list[Any] = []
        self.names: dict[int, str] = {}
        self.taken: dict[str, int] = {}
        self.hints: dict[tuple[str, int], str] = {}
        self.sources: dict[Any, Any] = {}
        self.pieces: dict[tuple[str, int], Root] = {}
        self.restart()

    def restart(self) -> None:
        """Forget the functions; what is known of arguments and memory stays."""
        self.functions: dict[Any, CFunction] = {}
        self.constants: dict[str, int | float] = {}
        self.vecs: set[int] = set()
        self.records: set[tuple[str, ...]] = set()
        self.function_names: dict[str, int] = {}
        self.changed = False

    def translate(self, calls: Callable[[], None]) -> None:
        """Translate what some calls of `function` need, until all that is assumed holds."""
        while True:
            self.restart()
            calls()
            if not self.changed:
                return

    # -- functions -----------------------------------------------------------------------------------------------------

    def source(self, function: Any) -> Any:
        """Text and scope of a function."""
        if function not in self.sources:
            self.sources[function] = source_of(function)
        return self.sources[function]

    def function(self, source: Any, arguments: dict[str, Value]) -> CFunction:
        """The function in C for such arguments; parameters that are the same in all calls are taken as known."""
        key = (source.function, *(structure(value) for value in arguments.values()))
        self.kept += [value.object for value in arguments.values() if isinstance(value, Static)]
        is_math = ".elementary." in source.function.__module__  # which knows of no controller, and so of no array
        for name, value in arguments.items():
            for place, part, array in leaves(value, name):
                self._note((key, place), VARIES if is_math and array else self._sameness(part, array))
        if key not in self.functions:
            self.functions[key] = self._translated(key, source, arguments)
        return self.functions[key]

    def _sameness(self, part: Any, array: ArrayValue | None) -> Any:
        """A key that is equal in all calls where a part of an argument is known; `VARIES` for one that never is."""
        if array is not None:
            if isinstance(array.base, Root) and array.offset.is_known:
                return array.base.name, array.offset.value
            return VARIES
        if isinstance(part, Number) and part.is_known:
            return (part.kind, spelled(part.value)) if part.kind == "real" else part.value
        return VARIES

    def _note(self, key: Any, found: Any) -> None:
        if key not in self.known:
            self.known[key] = found
        elif self.known[key] is not VARIES and self.known[key] != found:
            self.known[key], self.changed = VARIES, True

    def _translated(self, key: Any, source: Any, arguments: dict[str, Value]) -> CFunction:
        record = CFunction(self._function_name(source), source, is_math=".elementary." in source.function.__module__)
        possible = dict[str, Parameter]()
        names = {name: self._parameter(key, name, value, possible) for name, value in arguments.items()}
        self.writer(self, record, source, names, possible)
        return record

    def _function_name(self, source: Any) -> str:
        module = source.function.__module__
        if ".elementary." in module:
            name = f"mmnn_{source.node.name.strip('_')}"
        else:
            name = f"{module.rpartition('.')[2]}_{source.node.name.strip('_')}"
        self.function_names[name] = count = self.function_names.get(name, 0) + 1
        return name if count == 1 else f"{name}_{count}"

    def _parameter(self, key: Any, name: str, value: Value, possible: dict[str, Parameter]) -> Value:
        """An argument as the function sees it: known, or by the names of parameters."""
        if isinstance(value, Number):
            if self.known[key, name] is not VARIES:
                return replace(value, text=value.everywhere) if value.everywhere else value
            possible[name] = Parameter(name, value.kind)
            return Number(value.kind, name)
        if isinstance(value, Vec):
            possible[name] = Parameter(name, value.size)
            return Vec(name, value.size)
        if isinstance(value, Tuple):
            parts = value.of._fields if value.of is not None else range(len(value.items))  # type: ignore[attr-defined]
            pairs = zip(parts, value.items, strict=True)
            return Tuple(tuple(self._parameter(key, f"{name}_{p}", item, possible) for p, item in pairs), value.of)
        if isinstance(value, Static):
            return value
        is_known = self.known[key, name] is not VARIES
        pointer = Pointer(name)
        if not is_known:
            possible[name] = Parameter(name, ("pointer", value.kind), pointer)
        shape = tuple(
            self._size(self._parameter(key, place, size, possible))
            for place, size in zip(dimensions(name, len(value.shape)), value.shape, strict=True)
        )
        strides = {"C": row_strides(shape), "F": tuple(reversed(row_strides(shape[::-1])))}.get(value.layout)
        if strides is None:
            found = (self._parameter(key, f"{name}_stride{i}", one, possible) for i, one in enumerate(value.strides))
            strides = tuple(self._size(one) for one in found)
        if is_known:
            return replace(value, shape=shape, strides=strides, alias=None)
        return ArrayValue(pointer, integer(0), shape, strides, value.kind)

    def _size(self, value: Value) -> Number:
        assert isinstance(value, Number)
        return value

    # -- what is known ------------------------------------------------------------------------------------------------

    def lifted(self, value: Any, name: str = "") -> Value:
        """A Python object as a value."""
        if isinstance(value, bool | np.bool_):
            return truth(bool(value))
        if isinstance(value, int | np.integer):
            return integer(int(value))
        if isinstance(value, float | np.floating):
            return real(float(value), self.macro(name, float(value)) if name else "")
        if isinstance(value, np.ndarray):
            return self.array(value, name)
        if name and not isinstance(value, types.ModuleType | types.FunctionType | type):
            self.names.setdefault(id(value), name)
            self.kept.append(value)
        return Static(value, name)

    def named(self, value: Any, name: str, scope: Mapping[str, Any]) -> Value:
        """A global name: its value, under that name where it is a constant."""
        module = defined_in(scope.get("__name__", ""), name).rpartition(".")[2]
        full = f"{module}_{name.lstrip('_')}".upper()
        if isinstance(value, int) and not isinstance(value, bool):
            return integer(value, self.macro(full, value))
        if isinstance(value, float):
            return real(value, self.macro(full, value))
        return self.lifted(value, full if isinstance(value, np.ndarray | tuple) else "")

    def attribute(self, owner: Static, name: str) -> Value:
        """A part of a known object."""
        value = getattr(owner.object, name)
        if isinstance(owner.object, types.ModuleType):
            return self.named(value, name, vars(owner.object))
        full = f"{owner.name}_{name}" if owner.name else name
        if isinstance(value, int) and not isinstance(value, bool):
            return integer(value, self.macro(full, value)) if owner.name.isupper() else integer(value)
        found = self.lifted(value, full if isinstance(value, float | np.ndarray) else name)
        if isinstance(found, ArrayValue) and isinstance(found.base, Root) and value.size == found.base.data.size:
            kind: Any = type(owner.object)
            said = meanings(kind).get(name, "")
            found.base.about = found.base.about or said.replace("*/", "* /").replace("/*", "/ *")
        return found

    def name_of(self, owner: Any) -> str:
        """The name under which the parts of an object stand in C."""
        return self.names.get(id(owner), "")

    def macro(self, name: str, value: int | float) -> str:
        """The name of a constant in C."""
        if isinstance(value, float) and value in (0.0, 1.0):
            return ""
        name = name.upper()
        while name in self.constants and spelled(self.constants[name]) != spelled(value):
            name += "_"
        self.constants[name] = value
        return name

    # -- memory -------------------------------------------------------------------------------------------------------

    def array(self, array: np.ndarray, name: str) -> ArrayValue:
        """An array of Python, as the part of a block of memory that it is."""
        base = array
        while isinstance(base.base, np.ndarray):
            base = base.base
        if id(base) not in self.roots:
            self.kept.append(base)
            kind = "real" if base.dtype == np.float64 else "int"
            flat = base.ravel(order="K")
            self.roots[id(base)] = Root(self._unique(name or "array"), flat.copy(), kind, flat)
        root, size = self.roots[id(base)], array.itemsize
        offset = (array.__array_interface__["data"][0] - base.__array_interface__["data"][0]) // size
        shape = tuple(integer(one) for one in array.shape)
        plain = row_strides(shape)
        strides = plain if array.flags.c_contiguous else tuple(integer(one // size) for one in array.strides)
        found = ArrayValue(root, integer(offset), shape, strides, root.kind)
        return self.part_of(found) if root.parts else found

    def table(self, numbers: tuple[float, ...], name: str) -> ArrayValue:
        """Numbers of a tuple as a constant table."""
        if id(numbers) not in self.roots:
            self.kept.append(numbers)
            self.roots[id(numbers)] = Root(self._unique(name or "table"), np.array(numbers), "real", np.array(numbers))
        return ArrayValue(self.roots[id(numbers)], integer(0), (integer(len(numbers)),), (integer(1),), "real")

    def memory(self, array: np.ndarray, name: str, parts: Mapping[str, int] | None = None) -> Root:
        """Name a block of memory before it is used, and split it into members."""
        root = self.array(array, name).base
        assert isinstance(root, Root)
        start = 0
        for part, size in (parts or {}).items():
            root.parts.append((self._unique(part), start, size))
            start += size
        for part, start, size in root.parts:
            end = start + size
            self.pieces[root.name, start] = Root(part, root.data[start:end], root.kind, root.live[start:end])
        return root

    def part_of(self, array: ArrayValue) -> ArrayValue:
        """An array as a part of the member of a split block that it lies in, where that is known."""
        root = array.base
        assert isinstance(root, Root)
        if not all(one.is_known for one in (array.offset, *array.shape, *array.strides)):
            return array
        first = array.offset.value
        reach = sum((n.value - 1) * s.value for n, s in zip(array.shape, array.strides, strict=True)) + 1
        for _, start, size in root.parts:
            if start <= first and first + reach <= start + size:
                return replace(array, base=self.pieces[root.name, start], offset=integer(first - start))
        return array

    def _unique(self, name: str) -> str:
        name = name.lower()
        self.taken[name] = count = self.taken.get(name, 0) + 1
        return name if count == 1 else f"{name}_{count}"

    def write(self, array: ArrayValue) -> None:
        """Note that something is written into an array."""
        for owner in (array.alias, array.base):
            self._write(owner)

    def _write(self, owner: Any) -> None:
        if isinstance(owner, Pointer):
            owner.is_written = True
            for one in owner.of:
                self._write(one)
        elif isinstance(owner, Root) and owner.name not in self.written:
            self.written.add(owner.name)
            self.changed = True

    def is_dropped(self, base: Root | Pointer) -> bool:
        """Whether what is written there is left out."""
        return isinstance(base, Root) and base.name in self.dropped

    def constant(self, root: Root, place: int) -> float | int | None:
        """A number of memory that nobody writes."""
        return None if root.name in self.written or root.parts else root.data[place].item()

    def is_nothing(self, root: Root) -> bool:
        """Whether a table has nothing but zeros."""
        return root.name not in self.written and not root.parts and root.kind == "real" and not root.data.any()

    def known_integer(self, root: Root, place: int) -> Number:
        """A known integer of a table, under its name where it has one."""
        value = int(root.data[place])
        hint = self.hints.get((root.name, place), "")
        return integer(value, self.macro(hint, value) if hint else "")

    def text_of(self, root: Root) -> str:
        """A block of memory in C; tables with the same numbers are one."""
        if root.name in self.written:
            return f"self->{root.name}"
        same = (one for one in self.roots.values() if one.kind == root.kind and one.name not in self.written)
        return f"law_{next((one.name for one in same if np.array_equal(one.data, root.data)), root.name)}"

    # -- types --------------------------------------------------------------------------------------------------------

    def c_type(self, kind: Any, is_const: bool = False, is_math: bool = False) -> str:
        """A kind of value in C."""
        if isinstance(kind, int):
            return self.vec(kind, is_math)
        if isinstance(kind, tuple) and kind[0] == "pointer":
            return f"{'const ' if is_const else ''}{self.c_type(kind[1], is_math=is_math)} *"
        if isinstance(kind, tuple):
            return self.record_type(kind)
        if kind == "real":
            return "double" if is_math else self.real
        return C_TYPES[kind]

    def vec(self, size: int, is_math: bool) -> str:
        """The struct of some numbers."""
        self.vecs.add(size)
        return f"mmnn_vec{size}" if is_math or self.real == "double" else f"mmnn_single{size}"

    def literals(self, text: str) -> str:
        """Floating-point numbers in a text as those of the program's precision."""
        if self.real == "double":
            return text
        return re.sub(r"(?<![\w.])(\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)(?![\w.])", r"\1f", text)

    def record_type(self, kinds: tuple[str, ...]) -> str:
        """The struct of numbers of several kinds."""
        self.records.add(kinds)
        return "mmnn_" + "_".join(f"vec{kind}" if isinstance(kind, int) else kind for kind in kinds)
