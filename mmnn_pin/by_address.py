"""Large tuples for compiled code by their place in memory.

numba hands a named tuple over by value: every array in it is seven numbers, at every call, in every caller. A tuple of
a hundred arrays makes small functions slow to compile, and slow to call from Python. One that is marked,

    @by_address
    class Motors(NamedTuple):
        wire: Drive
        effects: tuple[Any, ...]

is written into memory once, when compiled code first meets it, and handed over as one address. Compiled code reads
its fields as before. Tuples within it that are marked, too, are addresses in it. A marked tuple is made by Python only.

When Python calls, numba looks at the parts of a tuple and not at its class: classes that may stand in one place must
differ in the types of their parts, or in their number.
"""

from __future__ import annotations

import ctypes
import struct
from functools import cached_property
from hashlib import sha256
from typing import Any, TypeVar

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)

from .compiled import folders

AttributeTemplate: Any = None
if not folders.PLAIN:
    from .compiled.linking import AttributeTemplate

T = TypeVar("T")
WORD = ir.IntType(32)


def by_address(kind: type[T]) -> type[T]:
    """The class of named tuples, of which compiled code is handed the address."""
    if folders.PLAIN:
        return kind
    more: dict[str, Any] = {name: getattr(kind, name) for name in ("__doc__", "__module__", "__qualname__")}
    more |= {"address": cached_property(address), "__getstate__": lambda value: None}  # a copy stands elsewhere
    made = type(kind.__name__, (kind,), more)
    typeof_impl.register(made)(typed)
    return made


def address(value: Any) -> int:
    """Where a tuple stands in memory, as compiled code reads it, as long as it lives."""
    form, numbers = words(value)
    made = ctypes.create_string_buffer(struct.pack(form, *numbers))
    return ctypes.addressof(value.__dict__.setdefault("memory", made))  # threads that ask at once get the same


def words(parts: tuple[Any, ...]) -> tuple[str, list[Any]]:
    """The parts of a tuple as a format of `struct` and its numbers; an array's are those of numba's `ArrayModel`."""
    form, numbers = "0q", list[Any]()
    for part in parts:
        if hasattr(part, "address"):
            more, found = "P", [part.address]
        elif isinstance(part, tuple):
            more, found = words(part)
        elif part is None:
            more, found = "P", [0]
        elif isinstance(part, np.ndarray):
            more = f"{5 + 2 * part.ndim}q"
            found = [0, 0, part.size, part.itemsize, part.ctypes.data, *part.shape, *part.strides]
        else:
            more, found = {types.boolean: "?", types.int64: "q", types.float64: "d"}[numba.typeof(part)], [part]
        form, numbers = form + more, numbers + found
    return form + "0q", numbers


class Placed(types.Type):
    """numba's type of a marked tuple."""

    def __init__(self, tuple_type: Any) -> None:
        self.tuple_type, self.instance_class = tuple_type, tuple_type.instance_class
        key = folders.source_key(self.instance_class.__module__)  # an edited learner recompiles its callers, too
        told = sha256(f"{self.instance_class} {tuple_type} {key}".encode()).hexdigest()[:16]
        super().__init__(f"{self.instance_class.__qualname__} {told}")  # numba says no more than its name, often


@register_model(Placed)
class Address(models.PrimitiveModel):
    """A marked tuple in compiled code."""

    def __init__(self, manager: Any, kind: Placed) -> None:
        super().__init__(manager, kind, manager.lookup(kind.tuple_type).get_value_type().as_pointer())


def typed(value: Any, context: Any) -> Placed | None:
    """Numba's type of a marked tuple; None where it has none for a part."""
    parts = [typeof_impl(part, context) for part in value]
    return None if None in parts else Placed(types.BaseTuple.from_types(parts, type(value)))


@unbox(Placed)
def take(kind: Placed, value: Any, c: Any) -> NativeValue:
    """The address of a marked tuple that comes from Python."""
    place = c.pyapi.object_getattr_string(value, "address")
    number = c.pyapi.long_as_voidptr(place)
    c.pyapi.decref(place)
    error = c.pyapi.err_occurred()
    failed = c.builder.icmp_unsigned("!=", error, ir.Constant(error.type, None))
    return NativeValue(c.builder.bitcast(number, c.context.get_value_type(kind)), is_error=failed)


class Field:
    """The type of a marked tuple's field."""

    key = Placed

    def generic_resolve(self, kind: Placed, name: str) -> Any:
        """The field's type, None for no field."""
        fields = kind.tuple_type.fields
        return kind.tuple_type.types[fields.index(name)] if name in fields else None


def read(context: Any, builder: Any, kind: Placed, place: Any, name: str) -> Any:
    """Read a field; that it never changes is said, so that it is read once."""
    i = kind.tuple_type.fields.index(name)
    found = builder.load(builder.gep(place, [WORD(0), WORD(i)], inbounds=True))
    found.set_metadata("invariant.load", builder.module.add_metadata([]))
    return found


if AttributeTemplate is not None:
    infer_getattr(type("Fields", (Field, AttributeTemplate), {}))
    lower_getattr_generic(Placed)(read)
