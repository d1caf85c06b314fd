"""Parts of flat arrays in compiled code: elements, vectors, matrices, and named tuples of them, in few instructions.

What a block remembers is one flat array: from Python one array costs 0.15 us per call, a tuple of twelve 1.6 us.
Compiled code sees it as a named tuple of views that `views` generates from the tuple's declaration:

    class State(NamedTuple):
        W: Matrix
        samples: Vector

    state_of = views(State)                             # in compiled code: o = state_of(values, layout)
    layout = layout_of(State, {"samples": (1,), "W": (3, 4)})       # where the parts stand, whatever their order

numba would type and lower the arithmetic of every place, which was much of what a first run takes: here a part is a few
instructions, written with numba's public interface for extensions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from itertools import accumulate
from typing import Annotated, Any, TypeVar, cast, get_type_hints

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import lower_builtin, type_callable
from numpy.typing import NDArray

T = TypeVar("T")
Array, Integer = types.Array, types.Integer

# Parts of a flat array, by their number of dimensions.
Vector = Annotated[NDArray[np.float64], 1]
Matrix = Annotated[NDArray[np.float64], 2]
Cube = Annotated[NDArray[np.float64], 3]
FIELDS: dict[type[Any], tuple[tuple[str, Any], ...]] = {}  # of the tuples of views: reading their hints is slow

MEMINFO, PARENT, ITEMS, ITEMSIZE, DATA, SHAPE, STRIDES = range(7)  # what numba's arrays consist of
WORD = ir.IntType(64)


def vector(values: NDArray[Any], start: int, size: int) -> NDArray[Any]:
    """A part of a flat array; compiled code neither checks nor wraps its place."""
    return values[start : start + size]


def matrix(values: NDArray[Any], start: int, rows: int, columns: int) -> NDArray[Any]:
    """A part of a flat array, row by row."""
    return values[start : start + rows * columns].reshape((rows, columns))


def cube(values: NDArray[Any], start: int, layers: int, rows: int, columns: int) -> NDArray[Any]:
    """A part of a flat array, layer by layer."""
    return values[start : start + layers * rows * columns].reshape((layers, rows, columns))


PARTS = {1: vector, 2: matrix, 3: cube}  # by their number of dimensions


def view(row: NDArray[np.float64], at: NDArray[np.int64], signal: int) -> NDArray[np.float64]:
    """The part of a row that holds a signal, by the offsets of all signals and its place in `signals.INDEX`."""
    return vector(row, at[signal], at[signal + 1] - at[signal])


def views(kind: type[T]) -> Callable[[NDArray[np.float64], NDArray[np.int64]], T]:
    """A function that makes a named tuple of views into a flat array: `(values, layout) -> kind`.

    In compiled code it costs a few additions. Fields of the tuple are a `Vector`, a `Matrix`, a `Cube` or another such
    tuple; `layout` is that of `layout_of`.
    """
    text, _ = constructor(kind, known := dict[str, Any]({made.__name__: made for made in PARTS.values()}), 0)
    parts = spelled(f"def parts(values, layout): return {text}", **known)

    def code(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
        places = (load(builder, arguments[1], WORD(place)) for place in range(10**6))
        return shared(given.return_type, context, builder, (given.args[0], arguments[0]), places)

    def typed(values: Any, layout: Any) -> Any:
        flat = all(isinstance(one, Array) and one.ndim == 1 and one.layout == "C" for one in (values, layout))
        return tuple_type(kind, values.dtype) if flat else None

    instruction(parts, typed, code, Array, Array)
    return cast(Callable[[NDArray[np.float64], NDArray[np.int64]], T], parts)


def constructor(kind: type[Any], known: dict[str, Any], place: int) -> tuple[str, int]:
    """The call that makes a tuple of views, whose layout begins at a place; and where it ends."""
    known[kind.__name__], parts = kind, []
    for _, part in fields_of(kind):
        if not isinstance(part, int):
            text, place = constructor(part, known, place)
        else:
            where = ", ".join(f"layout[{place + i}]" for i in range(part + 1))
            text = f"{PARTS[part].__name__}(values, {where})"
            place += 1 + part
        parts.append(text)
    return f"{kind.__name__}({', '.join(parts)})", place


def spelled(text: str, **known: Any) -> Any:
    """The function that a text defines; its globals keep the text as `__source__`, for those who read it."""
    known["__source__"] = text
    name = text.removeprefix("def ").partition("(")[0]
    exec(compile(text, f"<{name}>", "exec"), known)
    return known[name]


def tuple_type(kind: type[Any], dtype: Any) -> Any:
    """Numba's type of a tuple of views."""
    parts = [
        Array(dtype, part, "C") if isinstance(part, int) else tuple_type(part, dtype) for _, part in fields_of(kind)
    ]
    return types.BaseTuple.from_types(parts, kind)


def fields_of(kind: type[Any]) -> tuple[tuple[str, Any], ...]:
    """Names of a tuple's fields with their number of dimensions, or with the tuple that they are."""
    if kind not in FIELDS:
        hints = get_type_hints(kind, include_extras=True).items()
        FIELDS[kind] = tuple((name, getattr(hint, "__metadata__", (hint,))[0]) for name, hint in hints)
    return FIELDS[kind]


def layout_of(kind: type[Any], shapes: Mapping[str, tuple[int, ...]]) -> NDArray[np.int64]:
    """Start and shape of every field of a tuple of views; a field that the array does not have is empty.

    Args:
        kind: The tuple; fields of tuples within it have names of their own.
        shapes: Name and shape of all parts of the flat array, in the order in which they stand there.
    """
    ends = accumulate((math.prod(shape) for shape in shapes.values()), initial=0)
    starts = dict(zip(shapes, ends, strict=False))
    found: list[int] = []
    for name, part in fields_of(kind):
        if not isinstance(part, int):
            found += layout_of(part, shapes).tolist()
        else:
            found += [starts[name], *shapes[name]] if name in shapes else [0] * (1 + part)
    return np.array(found, np.int64)


def instruction(function: Any, typed: Callable[..., Any], code: Callable[..., Any], *kinds: Any) -> None:
    """Let compiled code make a call of a function by a piece of its own code.

    Args:
        function: What plain Python does.
        typed: Types of the arguments -> type of the result, None where the function does not take them.
        code: Writes the code, as one of numba's lowering functions.
        kinds: Classes of the arguments' types.
    """
    names = ", ".join(function.__code__.co_varnames[: function.__code__.co_argcount])
    choose = spelled(f"def choose({names}): return typed({names})", typed=typed)
    type_callable(function)(lambda context: choose)
    lower_builtin(function, *kinds)(code)


def part_type(values: Any, *places: Any) -> Any:
    """The type of a part of a flat array: a whole array, of as many dimensions as sizes are given."""
    flat = isinstance(values, Array) and values.ndim == 1 and values.layout == "C"
    return Array(values.dtype, len(places) - 1, "C") if flat else None


def part_code(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
    """The code of a part by its start and sizes."""
    places = (
        context.cast(builder, value, kind, types.intp)
        for value, kind in zip(arguments[1:], given.args[1:], strict=True)
    )
    return shared(given.return_type, context, builder, (given.args[0], arguments[0]), places)


def view_type(row: Any, at: Any, signal: Any) -> Any:
    """The type of a signal in a row."""
    flat = all(isinstance(one, Array) and one.ndim == 1 and one.layout == "C" for one in (row, at))
    return Array(row.dtype, 1, "C") if flat else None


def view_code(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
    """The code of a signal in a row."""
    row, at, _ = arguments
    signal = context.cast(builder, arguments[2], given.args[2], types.intp)
    start, end = load(builder, at, signal), load(builder, at, builder.add(signal, WORD(1)))
    places = iter((start, builder.sub(end, start)))
    return shared(given.return_type, context, builder, (given.args[0], row), places)


def shared(kind: Any, context: Any, builder: Any, source: tuple[Any, Any], places: Iterator[Any]) -> Any:
    """The view that `make` makes; where numba counts references, it adds one to the flat array's."""
    made = make(kind, context, builder, source, places)
    if context.enable_nrt:
        context.nrt.incref(builder, kind, made)
    return made


def make(kind: Any, context: Any, builder: Any, source: tuple[Any, Any], places: Iterator[Any]) -> Any:
    """A part of a flat array, or a tuple of them, at the places that come next: start and sizes of each."""
    if hasattr(kind, "types"):
        return context.make_tuple(builder, kind, [make(one, context, builder, source, places) for one in kind.types])
    values, start = source[1], next(places)
    sizes = [next(places) for _ in range(kind.ndim)]
    strides = [WORD(context.get_abi_sizeof(context.get_data_type(kind.dtype)))]
    for size in reversed(sizes[1:]):
        strides.insert(0, builder.mul(strides[0], size))
    items = sizes[0]
    for size in sizes[1:]:
        items = builder.mul(items, size)
    data = builder.gep(builder.extract_value(values, DATA), [start])
    parts = {ITEMS: items, ITEMSIZE: strides[-1], DATA: data}
    array = ir.Constant(context.get_value_type(kind), ir.Undefined)
    for place in (MEMINFO, PARENT):
        array = builder.insert_value(array, builder.extract_value(values, place), place)
    for place, value in parts.items():
        array = builder.insert_value(array, value, place)
    for place, words in ((SHAPE, sizes), (STRIDES, strides)):
        for i, word in enumerate(words):
            array = builder.insert_value(array, word, (place, i))
    return array


def load(builder: Any, array: Any, place: Any) -> Any:
    """The number at a place of a vector."""
    return builder.load(builder.gep(builder.extract_value(array, DATA), [place]))


for ndim, part in PARTS.items():
    instruction(cast(Any, part), part_type, part_code, Array, *[Integer] * (ndim + 1))
instruction(view, view_type, view_code, Array, Array, Integer)
