"""How the arithmetic of the blocks is made fast: compiled by numba, with the linear algebra libraries on one thread.

numba's own way is to take the code of every function into its callers, and to optimise all of it again at every level:
a loop around a learner and a hardware model took half a minute. Here a function says how it is called:

    @linked     by its address: compiled once, for all callers. What is larger than a few lines.
    @internal   so too, from compiled code alone (from Python a caller is compiled for it)
    @compiled   numba's own way
    @inlined    numba's own way, and always inlined; handing over arrays takes longer than a little arithmetic
    @spliced    its source is copied into its callers

`run_plainly` has all of them run as plain Python until `run_compiled`, which is how a first run begins (`loop.early`).

All run without the interpreter lock, and are kept in a file cache. numba's cache looks only at the file of the function
itself, so an edited callee would run stale; here the cache folder is keyed by a hash of all sources of the package.
`NUMBA_DISABLE_JIT=1` runs the same functions as plain Python. Large tuples go by address, too: `by_address`.

Code that depends on the type of an argument is chosen with `by_type`, parts of flat arrays are cut by `parts`.

numba optimises every function by itself, then with all that it calls at the lowest level, then at the highest; it links
the runtime for memory into each, and looks for closures and for expressions of whole arrays. Functions here allocate
nothing, are loops over numbers, and are optimised once (`Pipeline`): as fast, and a first run waits less.

Our matrices are small: threads of a linear algebra library that wait for each other cost more than they compute. The
command line limits them in the environment before numpy starts; in Python `@one_thread` does while a function runs.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import cache, cached_property, partial, wraps
from importlib import import_module
from multiprocessing import parent_process
from operator import attrgetter
from pathlib import Path
from pickle import UnpicklingError
from shutil import rmtree
from tempfile import gettempdir
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from llvmlite.binding import add_symbol
from numba.core.caching import IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import AnalysisPass, PassManager, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.typed_passes import NativeLowering, NopythonRewrites
from numba.core.untyped_passes import InlineClosureLikes, LiteralUnroll, RewriteDynamicRaises, WithLifting
from numba.extending import overload
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from .files import make_private
from .parts import spelled

UNUSED = (InlineClosureLikes, LiteralUnroll, NopythonRewrites, RewriteDynamicRaises, WithLifting)  # of numba's passes
MARKS = (b"@internal", b"@compiled", b"@linked", b"@inlined", b"@spliced")
KEPT = 30 * 86400.0  # how long code of other versions is kept after its last use [s]
MADE: list[Any] = []  # all compiled functions
KINDS: dict[Any, type] = {}  # what those are that run as plain Python
F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

P = ParamSpec("P")
R = TypeVar("R")


class Library(JITCodeLibrary):
    """Code of a function and of those that it takes in, optimised once and without the runtime for memory."""

    def add_linking_library(self, library: Any) -> None:
        """Take in what is called."""
        if library is not rtsys.library:
            super().add_linking_library(library)

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        manager, builder = self._codegen._module_pass_manager()
        manager.run(self._final_module, builder)


class Face(Library):
    """Stands for a function that is called by its address: there is no code in it."""

    def finalize(self) -> None:
        """Nothing is compiled."""
        self._shared_module, self._finalized = self._final_module, True


@register_pass(mutates_CFG=False, analysis_only=True)
class NewLibrary(AnalysisPass):
    """The library into which a function is lowered."""

    _name = "new_library"

    def __init__(self) -> None:
        AnalysisPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        """Give it to the lowering pass."""
        state.library = Library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return False


class Pipeline(CompilerBase):
    """numba's passes for compiled code, without those that are not used."""

    def define_pipelines(self) -> list[PassManager]:
        """All passes in their order."""
        passes = PassManager("lean")
        for one, what in DefaultPassBuilder.define_nopython_pipeline(self.state).passes:
            if one is NativeLowering:
                passes.add_pass(NewLibrary, "new library")
            if one not in UNUSED:
                passes.add_pass(one, what)
        passes.finalize()
        return [passes]


# Compiled functions allocate nothing; without numba's reference counts they run up to 1.5 times faster and compile in
# less time. One that does allocate fails to compile, loudly.
LEAN: dict[str, Any] = {"_nrt": False, "no_cfunc_wrapper": True, "pipeline_class": Pipeline}


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
    digest = hashlib.sha256(numba.__version__.encode())  # of two versions neither reads what the other keeps
    package = Path(__file__).parent
    for source in sorted(package.rglob("*.py")):
        text = source.read_bytes()
        if any(mark in text for mark in MARKS) or source.name in ("signals.py", "parts.py"):
            digest.update(str(source.relative_to(package)).encode() + b"\0" + text)
    try:
        root = private_root(cache_root().resolve(), digest.hexdigest()[:16])
        if root is None:
            return None
        folder = root / digest.hexdigest()[:16]
        if not any(folder.iterdir()):
            with suppress(OSError):
                forget(root)
        os.utime(folder)  # used now
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def private_root(root: Path, name: str) -> Path | None:
    """The folder for compiled code, or another where strangers can write to that one: code is run as it is found.

    Args:
        root: The folder, without symbolic links.
        name: Of the folder in it; it is made.
    """
    if not (why := make_private(root / name)):
        return root
    other: Path | None = Path(gettempdir()).resolve() / f"mmnn_pin-{os.getuid()}"
    if other is not None and make_private(other / name):
        other = None
    if parent_process() is None:  # else it has said so
        instead = "it is not kept" if other is None else f"it is kept in {other}"
        fix = "set NUMBA_CACHE_DIR to a folder of your own"
        print(f"warning: compiled code is not taken from {root}: {why}: {instead}: {fix}", file=sys.stderr)
    return other


def forget(root: Path) -> None:
    """Remove the code of other versions that nothing has used for `KEPT`: each takes up to 150 MB."""
    for folder in root.iterdir():
        with suppress(OSError):  # another process removes it, too
            unused = time.time() - folder.stat().st_mtime > KEPT
            if unused and re.fullmatch("[0-9a-f]{16}", folder.name) and any(folder.rglob("*.nbi")):
                rmtree(folder, ignore_errors=True)


class OwnNames(IndexDataCacheFile):
    """numba's cache files of a function, the code for each signature under a name of its own.

    numba numbers them. Of two processes that compile at the same time each may give one number to another signature,
    and then a run calls code that was made for other arguments, and crashes. Where one overwrites what the other has
    entered in the index, that is compiled once more. A file that a crash left empty or cut off counts as none, and code
    that does not fit on the disk is not kept.
    """

    def save(self, key: Any, data: Any) -> None:
        """Keep code; first itself, then its name."""
        with suppress(OSError):
            self._keep(key, data)

    def _keep(self, key: Any, data: Any) -> None:
        entries = self._load_index()
        name = entries.get(key) or self._data_name(int(hashlib.sha256(self._dump(key)).hexdigest()[:15], 16))
        self._save_data(name, data)
        self._save_index(entries | {key: name})

    def load(self, key: Any) -> Any:
        """What is kept; None for nothing that can be read."""
        try:
            return super().load(key)
        except (OSError, EOFError, UnpicklingError):
            return None

    def _load_index(self) -> dict[Any, str]:
        try:
            return dict(super()._load_index())
        except (EOFError, UnpicklingError):
            return {}


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
        MADE.append(made)
        if folder is not None:
            made._cache._cache_file.__class__ = OwnNames
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


class Plain(CPUDispatcher):
    """What numba makes of a function, while Python runs the function itself."""

    def __call__(self, *args: Any) -> Any:
        """Call it from Python."""
        return self.py_func(*args)


def run_plainly() -> None:
    """From now on Python calls all functions that are made so far as plain Python: nothing is compiled for it."""
    KINDS.update({made: made.__class__ for made in MADE if not isinstance(made, Plain)})
    for made in KINDS:
        made.__class__ = Plain


def run_compiled(*functions: Any) -> None:
    """The end of `run_plainly`, for some functions or for all."""
    for made in functions or tuple(KINDS):
        if made in KINDS:
            made.__class__ = KINDS.pop(made)


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
    face = Face(target.codegen(), name)
    face._reload_init.add(load)
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

    options: Any = {"nogil": True, "error_model": "numpy", "_nrt": False}
    # numba asks a function with the arguments of the stub
    resolve = spelled(f"def resolve({given}): return chosen({given})", chosen=chosen)
    overload(stub, jit_options=options, inline="always")(resolve)
    return stub


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
