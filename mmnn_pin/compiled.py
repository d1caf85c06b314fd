"""How the arithmetic of the blocks is made fast: compiled by numba, with the linear algebra libraries on one thread.

`@compiled` (`@inlined`, `@spliced` for small functions) is `numba.njit` without the interpreter lock and with a file
cache. numba's cache looks only at the file of the function itself, so an edited callee would run stale; here the cache
folder is keyed by a hash of all sources of the package. `NUMBA_DISABLE_JIT=1` runs the same functions as plain Python.

Our matrices are small: threads of a linear algebra library that wait for each other cost more than they compute. The
command line limits them in the environment before numpy starts; in Python `@one_thread` does while a function runs.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numba.core.options import DefaultOptions
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

# Compiled functions allocate nothing; without numba's reference counts they run up to 1.5 times faster and compile in
# less time. One that does allocate fails to compile, loudly.
LEAN: dict[str, Any] = {"_nrt": False} if hasattr(DefaultOptions, "_nrt") else {}

MARKS = (b"@compiled", b"@inlined", b"@spliced")
F = TypeVar("F", bound=Callable[..., Any])
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
        return cast(F, numba.njit(cache=folder is not None, nogil=True, error_model="numpy", **given)(function))
    finally:
        config.CACHE_DIR = before


def inlined(function: F) -> F:
    """Compile a function also into its callers: handing over arrays takes longer than a little arithmetic."""
    return compiled(function, forceinline=True)


def spliced(function: F) -> F:
    """Copy a function into the source of its one or two callers: as fast, and nothing is compiled twice."""
    return compiled(function, inline="always")


@compiled
def copy_to(source: NDArray[np.float64], target: NDArray[np.float64]) -> None:
    """Copy a vector; an assignment of slices would drag numba's texts for shape errors into every caller."""
    for i in range(target.size):
        target[i] = source[i]


@spliced
def view(row: NDArray[np.float64], at: NDArray[np.int64], signal: int) -> NDArray[np.float64]:
    """The part of a row that holds a signal, by the offsets of all signals and its place in `signals.INDEX`."""
    return row[at[signal] : at[signal + 1]]


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
