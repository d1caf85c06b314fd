"""How the arithmetic of the blocks is made fast: compiled by numba, with the linear algebra libraries on one thread.

numba's own way is to take the code of every function into its callers, and to optimise all of it again at every level:
a loop around a learner and a hardware model took half a minute. Here a function says how it is called:

    @linked     by its address: compiled once, for all callers. What is larger than a few lines.
    @internal   so too, from compiled code alone (from Python a caller is compiled for it)
    @compiled   numba's own way
    @inlined    numba's own way, and always inlined; handing over arrays takes longer than a little arithmetic
    @spliced    its source is copied into its callers

All run without the interpreter lock, and are kept in a file cache. numba's cache looks only at the file of the function
itself, so an edited callee would run stale; here the cache folder is keyed by a hash of all sources of the package.
`NUMBA_DISABLE_JIT=1` runs the same functions as plain Python. Large tuples go by address, too: `by_address`.

What a block remembers is one flat array: from Python one array costs 0.15 us per call, a tuple of twelve 1.6 us.
Compiled code sees it as a named tuple of views that `views` generates from the tuple's declaration:

    class State(NamedTuple):
        W: Matrix
        samples: Vector

    state_of = views(State)                             # in compiled code: o = state_of(values, layout)
    layout = layout_of(State, {"samples": (1,), "W": (3, 4)})       # where the parts stand, whatever their order

Code that depends on the type of an argument is chosen with `by_type`.

Our matrices are small: threads of a linear algebra library that wait for each other cost more than they compute. The
command line limits them in the environment before numpy starts; in Python `@one_thread` does while a function runs.
"""

from __future__ import annotations

import hashlib
import math
import os
import sys
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import cache, cached_property, partial, wraps
from importlib import import_module
from itertools import accumulate
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, ParamSpec, TypeVar, cast, get_type_hints

import numba
import numpy as np
from llvmlite.binding import add_symbol
from numba.core.imputils import lower_builtin
from numba.core.options import DefaultOptions
from numba.core.registry import CPUDispatcher
from numba.core.types import Array, Integer
from numba.core.typing import signature
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import overload
from numba.np.arrayobj import make_array, populate_array
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

# Compiled functions allocate nothing; without numba's reference counts they run up to 1.5 times faster and compile in
# less time. One that does allocate fails to compile, loudly.
LEAN: dict[str, Any] = {"_nrt": False} if hasattr(DefaultOptions, "_nrt") else {}

MARKS = (b"@internal", b"@compiled", b"@linked", b"@inlined", b"@spliced")
F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

# Parts of a flat array, by their number of dimensions.
Vector = Annotated[NDArray[np.float64], 1]
Matrix = Annotated[NDArray[np.float64], 2]
Cube = Annotated[NDArray[np.float64], 3]
FIELDS: dict[type[Any], tuple[tuple[str, Any], ...]] = {}  # of the tuples of views: reading their hints is slow

P = ParamSpec("P")
R = TypeVar("R")


def cache_root() -> Path:
    """Folder that holds the compiled code of all versions of the sources."""
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(given)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "mmnn_pin"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mmnn_pin"


@cache
def cache_folder() -> Path | None:
    """Folder for the code compiled from exactly these sources, None where nothing can be written."""
    digest = hashlib.sha256()
    package = Path(__file__).parent
    for source in sorted(package.rglob("*.py")):
        text = source.read_bytes()
        if any(mark in text for mark in MARKS) or source.name == "signals.py":  # numbers that compiled code freezes
            digest.update(str(source.relative_to(package)).encode() + b"\0" + text)
    folder = cache_root() / digest.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def is_warm() -> bool:
    """Whether compiled code for these sources is already on disk (else the first run takes some seconds)."""
    folder = cache_folder()
    return os.environ.get("NUMBA_DISABLE_JIT", "0") == "1" or (folder is not None and any(folder.rglob("*.nbi")))


def compiled(function: F, **options: Any) -> F:
    """Compile a function of scalars and float64 arrays; division by zero gives inf or nan as in numpy."""
    folder = cache_folder()
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = "" if folder is None else str(folder)
    try:
        given: dict[str, Any] = LEAN | options
        made: Any = numba.njit(cache=folder is not None, nogil=True, error_model="numpy", **given)(function)
    finally:
        config.CACHE_DIR = before
    if hasattr(made, "add_overload"):
        made.add_overload = partial(remember, made)
    return cast(F, made)


def remember(dispatcher: Any, compilation: Any) -> None:
    """Enter a compilation; from the cache it no longer says what is made ready before it, which its callers have to."""
    compilation.library._reload_init.update(compilation.reload_init)
    type(dispatcher).add_overload(dispatcher, compilation)


def inlined(function: F) -> F:
    """Compile a function also into its callers: handing over arrays takes longer than a little arithmetic."""
    return without_wrapper(compiled(function, forceinline=True, no_cpython_wrapper=True))


def spliced(function: F) -> F:
    """Copy a function into the source of its one or two callers: as fast, and nothing is compiled twice."""
    return without_wrapper(compiled(function, inline="always", no_cpython_wrapper=True))


def linked(function: F, **options: Any) -> F:
    """Compile a function once: its callers call it where it is, and do not take in its code and optimise it again."""
    made: Any = compiled(function, **options)
    if hasattr(made, "add_overload"):
        made.add_overload = partial(publish, made)
    return cast(F, made)


def internal(function: F) -> F:
    """The same for a function that only compiled code calls: what hands over arguments from Python is not compiled."""
    return without_wrapper(linked(function, no_cpython_wrapper=True))


def without_wrapper(function: F) -> F:
    """Let a function that was compiled for compiled callers be called from Python, too: by a caller made when asked."""
    made: Any = function
    if isinstance(made, CPUDispatcher):
        made.__class__ = Internal
    return function


class Internal(CPUDispatcher):
    """What numba makes of a function; called from Python, it compiles a caller."""

    def __call__(self, *args: Any) -> Any:
        """Call it from Python."""
        return self.caller(*args)

    @cached_property
    def caller(self) -> Any:
        """The function, for Python."""
        given = ", ".join(self.py_func.__code__.co_varnames[: self.py_func.__code__.co_argcount])
        call = spelled(f"def call({given}): return function({given})", function=self)
        return numba.njit(nogil=True, error_model="numpy", **LEAN)(call)


@dataclass(frozen=True)
class Load:
    """Makes a linked function ready before code that calls it, which comes from the cache."""

    module: str
    name: str
    types: tuple[Any, ...]

    def __call__(self) -> None:
        """Compile the function for these types, or take it from the cache."""
        attrgetter(self.name)(import_module(self.module)).compile(self.types)


def publish(dispatcher: Any, compilation: Any) -> None:
    """Enter what numba has compiled for some types under a name of its own, by which compiled callers find it."""
    remember(dispatcher, compilation)
    target, types, library = dispatcher.targetctx, compilation.signature.args, compilation.library
    fndesc = copy(compilation.fndesc)
    load = Load(fndesc.modname, fndesc.qualname, types)
    given = str([(getattr(kind, "instance_class", None), kind) for kind in types])  # numba says no more than its name
    name = f"{load.module}.{load.name}.{hashlib.sha256(given.encode()).hexdigest()[:16]}"
    add_symbol(name, library.get_pointer_to_function(fndesc.llvm_func_name))
    fndesc.mangled_name = name
    face = target.codegen().create_library(name)
    face._reload_init.add(load)
    face.finalize()
    face._shared_module = face._final_module
    target.remove_user_function(compilation.entry_point)
    target.insert_user_function(compilation.entry_point, fndesc, [face])


@compiled
def copy_to(source: NDArray[np.float64], target: NDArray[np.float64]) -> None:
    """Copy a vector; an assignment of slices would drag numba's texts for shape errors into every caller."""
    for i in range(target.size):
        target[i] = source[i]


@compiled
def entry(A: NDArray[np.float64], j: int, x: NDArray[np.float64]) -> float:
    """Entry j of `A x`: the torque of one motor, or on one velocity."""
    total = 0.0
    for i in range(x.size):
        total += A[j, i] * x[i]
    return total


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


class Part(AbstractTemplate):
    """The type of a part of a flat array."""

    def generic(self, args: Any, kws: Any) -> Any:
        """A whole array of its own, of as many dimensions as sizes are given."""
        values, ndim = args[0], len(args) - 2
        if isinstance(values, Array) and values.ndim == 1 and values.layout == "C":
            return signature(Array(values.dtype, ndim, "C"), values, *[numba.types.intp] * (ndim + 1))
        return None


def cut(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
    """The code of a part: where it begins, and its sizes."""
    values, made = make_array(given.args[0])(context, builder, arguments[0]), make_array(given.return_type)
    part, sizes, strides = made(context, builder), arguments[2:], [values.itemsize]
    for size in reversed(sizes[1:]):
        strides.insert(0, builder.mul(strides[0], size))
    populate_array(
        part,
        data=builder.gep(values.data, [arguments[1]]),
        shape=sizes,
        strides=strides,
        itemsize=values.itemsize,
        meminfo=values.meminfo,
        parent=values.parent,
    )
    return part._getvalue()


for ndim, function in PARTS.items():
    infer_global(function)(type(function.__name__, (Part,), {"key": function}))
    lower_builtin(function, Array, *[Integer] * (ndim + 1))(cut)


@spliced
def view(row: NDArray[np.float64], at: NDArray[np.int64], signal: int) -> NDArray[np.float64]:
    """The part of a row that holds a signal, by the offsets of all signals and its place in `signals.INDEX`."""
    return vector(row, at[signal], at[signal + 1] - at[signal])


def views(kind: type[T]) -> Callable[[NDArray[np.float64], NDArray[np.int64]], T]:
    """A function that makes a named tuple of views into a flat array, for compiled code: `(values, layout) -> kind`.

    It is spliced into its callers, so it costs a few additions. Fields of the tuple are a `Vector`, a `Matrix`, a
    `Cube` or another such tuple; `layout` is that of `layout_of`.
    """
    known: dict[str, Any] = {function.__name__: function for function in PARTS.values()}
    text, _ = constructor(kind, known, 0)
    view = spelled(f"def view(values, layout): return {text}", **known)
    made = numba.njit(nogil=True, error_model="numpy", inline="always", **LEAN)(view)
    return cast(Callable[[NDArray[np.float64], NDArray[np.int64]], T], made)


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


def by_type(stub: F, argument: str, choose: Callable[[type], Callable[..., Any]]) -> F:
    """Let compiled code call, in place of a function, the one that belongs to the type of an argument.

    In plain Python the function itself looks there, so both do the same; compiled is nothing but the one that a call
    needs.

    Args:
        stub: The function for plain Python; it has no default values.
        argument: Name of an argument that is a named tuple.
        choose: Compiled function that belongs to a type of named tuple; asked when a call is compiled.
    """
    names = stub.__code__.co_varnames[: stub.__code__.co_argcount]
    place, given = names.index(argument), ", ".join(names)

    def chosen(*types: Any) -> Any:
        return spelled(f"def call({given}): return function({given})", function=choose(types[place].instance_class))

    options: Any = {"nogil": True, "error_model": "numpy"} | LEAN
    # numba asks a function with the arguments of the stub
    resolve = spelled(f"def resolve({given}): return chosen({given})", chosen=chosen)
    overload(stub, jit_options=options, inline="always")(resolve)
    return stub


def spelled(text: str, **known: Any) -> Any:
    """The function that a text defines; its globals keep the text as `__source__`, for those who read it."""
    known["__source__"] = text
    name = text.removeprefix("def ").partition("(")[0]
    exec(compile(text, f"<{name}>", "exec"), known)
    return known[name]


@cache
def libraries() -> ThreadpoolController:
    """The thread pools of the libraries that are loaded."""
    return ThreadpoolController()


def one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """The function, with linear algebra on one thread while it runs."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with libraries().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
