"""Runs as bytes, for a cluster whose scheduler, or some of whose workers, may not have this package.

Dask takes a task apart on its way. What it meets there is bytes, and functions that exist only inside others: those
travel by value, and fail where the package is missing, not where they are unpacked.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import cache, lru_cache
from typing import Any

from ...compiled import libraries
from .bundle import Bundle
from .worker import Done, Task, run


class Packed(Executor):
    """An executor that packs a study's runs for another one.

    Args:
        inner: Takes functions of bytes.
    """

    def __init__(self, inner: Executor) -> None:
        self.inner = inner
        self.call = carriers()["call"]

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Make a run: `fn` is `worker.run`, the arguments are its task and the packed files of its robot."""
        assert fn is run and not kwargs
        return self.inner.submit(self.call, pickle.dumps(args[0]), args[1])


def carriers() -> dict[str, Callable[..., Any]]:
    """Functions that travel by value: `call` makes a run, `keep` holds bytes, `code` tells a worker's sources."""

    def call(task: bytes, bundle: bytes) -> Done:
        from .packed import run_packed

        return run_packed(task, bundle)

    def keep(packed: bytes) -> bytes:
        return packed

    def code() -> str:
        from .worker import code_digest

        return code_digest()

    return {"call": call, "keep": keep, "code": code}


def run_packed(task: bytes, bundle: bytes) -> Done:
    """Make a run on a worker; see `worker.run`."""
    for_good()
    made: Task = pickle.loads(task)
    return run(made, unpacked(bundle))


@cache
def for_good() -> None:
    """Keep linear algebra on one thread in this process: a worker's runs come side by side."""
    libraries().limit(limits=1, user_api="blas")


@lru_cache(maxsize=4)
def unpacked(bundle: bytes) -> Bundle:
    """A robot's files, unpacked once."""
    found: Bundle = pickle.loads(bundle)
    return found


def root_of(error: ModuleNotFoundError) -> str:
    """Name of the package that is missing."""
    return str(error.name).partition(".")[0]
