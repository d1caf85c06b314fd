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

import hashlib
import os
import re
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, wraps
from multiprocessing import parent_process
from pathlib import Path
from shutil import rmtree
from tempfile import gettempdir
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numba.core.event import Listener, register
from numba.extending import overload
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from .files import make_private
from .parts import spelled

prepare: Any
try:
    if os.environ.get("MMNN_PLAIN_NUMBA", "0") == "1":
        raise ImportError
    from .linking import LEAN, prepare
except ImportError:  # numba's insides are others
    LEAN, prepare = {}, None

PACKAGE = Path(__file__).parent
MARKS = re.compile(rb"^ *@(internal|compiled|linked|inlined|by_address)", re.M)
IMPORT = re.compile(r"^from (\.*)([\w.]*) import (\([^)]*\)|[^(\n]*)", re.M)
CONSTANTS = (
    "mmnn_pin.signals",
    "mmnn_pin.parts",
    "mmnn_pin.linking",
)  # without compiled functions; these depend on them
KEPT = 30 * 86400.0  # how long code of other versions is kept after its last use [s]
F = TypeVar("F", bound=Callable[..., Any])

P = ParamSpec("P")
R = TypeVar("R")


# -- the cache folder of a module --------------------------------------------------------------------------------------


@cache
def file_of(module: str) -> Path | None:
    """The file of a module; None where it has none."""
    root, *names = module.split(".")
    if root != PACKAGE.name:
        file = getattr(sys.modules.get(module), "__file__", None)
        return Path(file) if file and Path(file).is_file() else None
    place = PACKAGE.joinpath(*names)
    files = (place / "__init__.py", place.with_suffix(".py"))
    return next((file for file in files if file.is_file()), None)


@cache
def text_of(module: str) -> bytes:
    """The source of a module; nothing where it has none."""
    file = file_of(module)
    return b"" if file is None else file.read_bytes()


@cache
def imports_of(module: str) -> dict[str, str]:
    """The names that a module imports at its head from this package, and the modules that they come from."""
    file, found = file_of(module), dict[str, str]()
    parts = module.split(".") if file is not None and file.name == "__init__.py" else module.split(".")[:-1]
    for dots, source, names in IMPORT.findall(text_of(module).decode()):
        base = ".".join([*parts[: len(parts) - len(dots) + 1], *([source] if source else [])]) if dots else source
        if base.split(".")[0] == PACKAGE.name:
            for name in re.findall(r"(\w+)(?: +as +\w+)?", re.sub(r"#.*", "", names)):
                found[name] = origin(base, name)
    return found


def origin(module: str, name: str) -> str:
    """The module that a name comes from which another module hands on."""
    if file_of(f"{module}.{name}") is not None:
        return f"{module}.{name}"
    file = file_of(module)
    if file is not None and file.name == "__init__.py":
        return imports_of(module).get(name, module)
    return module


@cache
def has_compiled(module: str) -> bool:
    """Whether compiled functions depend on the text of a module; a package is imported for what it hands on."""
    file = file_of(module)
    hands_on = file is not None and file.name == "__init__.py"
    return hands_on or module in CONSTANTS or MARKS.search(text_of(module)) is not None


@cache
def source_key(module: str) -> str:
    """A name for the sources that the compiled functions of a module depend on: its own, and what it imports."""
    found, left = {module, *CONSTANTS}, [module]
    while left:
        new = {one for one in imports_of(left.pop()).values() if has_compiled(one)} - found
        found |= new
        left += new
    if prepare is None:  # callers have the code of learners in them: all sources
        files = (file.relative_to(PACKAGE.parent).with_suffix("").parts for file in PACKAGE.rglob("*.py"))
        found |= {one for one in map(".".join, files) if has_compiled(one)}
    digest = hashlib.sha256(numba.__version__.encode())  # of two versions neither reads what the other keeps
    for one in sorted(found):
        digest.update(one.encode() + b"\0" + text_of(one))
    return digest.hexdigest()[:16]


def cache_root() -> Path:
    """Folder that holds the compiled code of all versions of the sources."""
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(given)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "mmnn_pin"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mmnn_pin"


@cache
def cache_folder(module: str = "mmnn_pin.loop.compiled") -> Path | None:
    """Folder for the code of a module compiled from exactly these sources, None where nothing can be written."""
    try:
        root, name = checked_root(), source_key(module)
        if root is None or make_private(root / name):
            return None
        os.utime(root / name)  # used now
    except OSError:
        return None
    return root / name if os.access(root / name, os.W_OK) else None


@cache
def checked_root() -> Path | None:
    """The folder for the code of all modules that only this user can write to, see `private_root`; None for none."""
    root = private_root(cache_root().resolve(), source_key("mmnn_pin.compiled"))
    if root is not None:
        with suppress(OSError):
            forget(root)
    return root


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
    """Remove the code of other versions that nothing has used for `KEPT`: a version takes up to 150 MB."""
    for folder in root.iterdir():
        with suppress(OSError):  # another process removes it, too
            unused = time.time() - folder.stat().st_mtime > KEPT
            if unused and re.fullmatch("[0-9a-f]{16}", folder.name) and any(folder.rglob("*.nbi")):
                rmtree(folder, ignore_errors=True)


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
    """The same for a function that only compiled code calls: what hands over arguments from Python is not compiled."""
    return made(function, by_address=True, from_python=False)


def plain(function: F) -> F:
    """The function as plain Python; what it calls stays compiled."""
    return cast(F, getattr(function, "py_func", function))


class Told(Listener):
    """Hears from numba what is compiled, and tells its name.

    Args:
        tell: Called with the name of a function before it is compiled.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.tell = tell

    def on_start(self, event: Any) -> None:
        """A function is going to be compiled."""
        self.tell(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event: Any) -> None:
        """It is compiled."""


def when_compiling(tell: Callable[[str], None]) -> None:
    """From now on, tell the name of every function that this process compiles."""
    register("numba:compile", Told(tell))


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
