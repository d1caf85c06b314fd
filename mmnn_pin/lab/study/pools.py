"""Where runs are made: threads of this process, processes of this machine, or workers of a cluster; one interface."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from ...compiled import libraries
from ...errors import ConfigError
from . import worker
from .bundle import Bundle


@dataclass(frozen=True)
class Pool:
    """Takes runs.

    Attributes:
        executor: Runs them.
        place: What it is, for people.
        window: How many runs it is given at a time; asked again and again.
        share: Hands a robot's files to it; gives what stands for them in a call, None where they are there already.
        check: Asked about once a second.
        stop: Tells runs in this process to end; None where they know by themselves.
        first_alone: Whether the first run must have ended before others start: it compiles.
        crew: Who is there at the start, for people.
    """

    executor: Executor
    place: str
    window: Callable[[], int]
    share: Callable[[Bundle], Any] = lambda bundle: None
    check: Callable[[], None] = lambda: None
    stop: Callable[[], bool] | None = None
    first_alone: bool = False
    crew: str = ""


@contextmanager
def threads(workers: int | None = None) -> Iterator[Pool]:
    """Threads, for runs of the compiled engine: they share the compiled code and run without the interpreter lock.

    Raises:
        ConfigError: Less than one.
    """
    count = number_of(workers)
    stop = threading.Event()
    with ThreadPoolExecutor(count) as executor, libraries().limit(limits=1, user_api="blas"):
        try:
            name = f"{count} thread{'s' * (count > 1)}"
            yield Pool(executor, name, lambda: 2 * count, stop=stop.is_set, first_alone=True)
        finally:
            stop.set()
            executor.shutdown(wait=True, cancel_futures=True)


@contextmanager
def processes(workers: int | None = None) -> Iterator[Pool]:
    """Processes, for runs with Python in their steps.

    Raises:
        ConfigError: Less than one.
    """
    count = number_of(workers)
    context = multiprocessing.get_context("spawn")  # a fork would copy threads' locks
    stop = context.Event()
    with ProcessPoolExecutor(count, context, begin, (stop,)) as executor:
        try:
            yield Pool(executor, f"{count} process{'es' * (count > 1)}", lambda: 2 * count)
        finally:
            stop.set()
            executor.shutdown(wait=True, cancel_futures=True)


def begin(stop: Any) -> None:
    """In a new process: Ctrl-C is the parent's, and so is the event that ends the runs."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    worker.STOP = stop


def number_of(workers: int | None) -> int:
    """How many workers.

    Raises:
        ConfigError: Less than one.
    """
    count = available() if workers is None else workers
    if count < 1:
        raise ConfigError(f"{count} workers", fix="use at least one", key="--workers")
    return count


def available() -> int:
    """Cores that this process may use."""
    with contextlib.suppress(AttributeError):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
