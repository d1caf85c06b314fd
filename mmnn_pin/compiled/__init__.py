"""How the arithmetic of the blocks is made fast: compiled by numba, with the linear algebra libraries on one thread.

Compiled functions are plain `njit`, without the interpreter lock, in a file cache. A function says how it is called:

    @compiled   numba's own way
    @inlined    numba's own way, and always inlined; handing over arrays takes longer than a little arithmetic
    @linked     by its address: compiled once, for all callers (`linking`). What is larger than a few lines.
    @internal   so too, from compiled code alone (from Python a caller is compiled for it)

numba's cache looks only at the file of the function itself, so an edited callee would run stale; here the cache folder
is keyed by a hash of the sources that a function's module imports. `NUMBA_DISABLE_JIT=1` runs the same functions as
plain Python. Large tuples go by address, too: `by_address`.

Code that depends on the type of an argument is chosen with `by_type`, parts of flat arrays are cut by `parts`.

Our matrices are small: threads of a linear algebra library that wait for each other cost more than they compute. The
command line limits them in the environment before numpy starts; in Python `@one_thread` does while a function runs.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numba.core.event import Listener, register
from numba.extending import overload
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from ..parts import spelled
from . import folders
from .folders import cache_folder

prepare: Any
try:
    if folders.PLAIN:
        raise ImportError
    from .linking import LEAN, prepare
except ImportError:  # numba's insides are others
    LEAN, prepare, folders.PLAIN = {}, None, True

F = TypeVar("F", bound=Callable[..., Any])

P = ParamSpec("P")
R = TypeVar("R")


def is_warm() -> bool:
    """Whether compiled code for these sources is already on disk (else the first run takes half a minute)."""
    folder = cache_folder()
    return os.environ.get("NUMBA_DISABLE_JIT", "0") == "1" or (folder is not None and any(folder.rglob("*.nbi")))


# -- kinds of compiled functions ---------------------------------------------------------------------------------------


def made(function: F, by_address: bool = False, from_python: bool = True, **options: Any) -> F:
    """A compiled function; division by zero gives inf or nan as in numpy.

    Args:
        function: Of scalars, float64 arrays and named tuples of them.
        by_address: Whether callers find it by its address.
        from_python: Whether Python often calls it.
        options: More of numba's.
    """
    folder, config = cache_folder(function.__module__), cast(Any, numba.config)
    before = config.CACHE_DIR
    config.CACHE_DIR = "" if folder is None else str(folder)
    if prepare is not None and not from_python:
        options |= {"no_cpython_wrapper": True}
    try:
        found: Any = numba.njit(cache=folder is not None, nogil=True, error_model="numpy", **LEAN, **options)(function)
    finally:
        config.CACHE_DIR = before
    if prepare is not None and hasattr(found, "add_overload"):
        prepare(found, by_address, from_python)
    return cast(F, found)


def compiled(function: F) -> F:
    """Compile a function."""
    return made(function)


def inlined(function: F) -> F:
    """Compile a function into its callers: handing over arrays takes longer than a little arithmetic."""
    return made(function, from_python=False, forceinline=True)


def linked(function: F) -> F:
    """Compile a function once: its callers call it where it is, and do not take in its code and optimise it again."""
    return made(function, by_address=True)


def internal(function: F) -> F:
    """Compile a function once, as `linked`, for compiled callers alone: nothing takes arguments from Python."""
    return made(function, by_address=True, from_python=False)


def plain(function: F) -> F:
    """The function as plain Python; what it calls stays compiled."""
    return cast(F, getattr(function, "py_func", function))


class CompileListener(Listener):
    """Hears from numba that something is compiled.

    Args:
        tell: Called before a function is compiled.
    """

    def __init__(self, tell: Callable[[], object]) -> None:
        self.tell = tell

    def on_start(self, event: Any) -> None:
        """A function is going to be compiled."""
        self.tell()

    def on_end(self, event: Any) -> None:
        """It is compiled."""


def when_compiling(tell: Callable[[], object]) -> None:
    """From now on, call `tell` before every function that this process compiles."""
    register("numba:compile", CompileListener(tell))


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

    options: Any = {"nogil": True, "error_model": "numpy"} | {name: LEAN[name] for name in LEAN if name == "_nrt"}
    # numba asks a function with the arguments of the stub
    resolve = spelled(f"def resolve({given}): return chosen({given})", chosen=chosen)
    overload(stub, jit_options=options, inline="always")(resolve)
    return stub


@cache
def libraries(has_scipy: bool) -> ThreadpoolController:
    """The thread pools of the libraries that are loaded, with those of scipy's or before it is there."""
    return ThreadpoolController()


def one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """The function, with linear algebra on one thread while it runs."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with libraries("scipy.linalg" in sys.modules).limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
