"""Makes a study's missing runs in a pool and stores each row as it comes.

A pool is threads of this process, processes of this machine, or the workers of a cluster (`cluster.py`).
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from ...compiled import libraries
from ...errors import ConfigError, MmnnError, StudyError
from . import worker
from .plan import Plan, Row
from .store import Store
from .worker import Bundle, JobResult, run

AGAIN = ("failed", "interrupted")  # statuses of rows that the next session runs again
LOST = "the same command goes on with what is missing"


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


def fill(
    store: Store, plan: Plan, missing: list[int], pool: Pool, progress: Callable[[JobResult], None] = lambda done: None
) -> None:
    """Run rows and store them.

    Args:
        store: Takes them.
        plan: All rows.
        missing: Numbers of those to run.
        pool: Makes the runs.
        progress: Called after each.

    Raises:
        MmnnError: As in `execute`.
    """
    for row, done in execute(pool, plan, map(plan.row, missing)):
        if done.status != "interrupted":
            store.add(row.fingerprint, row.point, row.controller, row.seed, row.parameters, done)
            progress(done)


def execute(
    pool: Pool, plan: Plan, rows: Iterable[Row], handed: dict[str, Any] | None = None
) -> Iterator[tuple[Row, JobResult]]:
    """Make runs, each given back when it has finished, in any order.

    Args:
        pool: Makes them.
        plan: Knows the files of their robots.
        rows: The runs.
        handed: Robots' files that the pool has already, by digest; it is added to.

    Raises:
        MmnnError: The pool is lost; what was given back is done.
        StudyError: A worker cannot make runs of this study.
    """
    finished: queue.SimpleQueue[Future[JobResult]] = queue.SimpleQueue()
    pending: dict[Future[JobResult], Row] = {}
    left, alone = iter(rows), pool.first_alone
    files: dict[str, Any] = {} if handed is None else handed
    try:
        while True:
            room = (1 if alone else pool.window()) - len(pending)
            for row in take(left, room):
                future = pool.executor.submit(run, row.job, files_of(row, pool, plan, files), pool.stop)
                pending[future] = row
                future.add_done_callback(finished.put)
            if not pending:
                return
            try:
                future = finished.get(timeout=1.0)
            except queue.Empty:
                pool.check()
                continue
            row = pending.pop(future)
            yield row, result_of(future, row, pool)
            alone = False
    finally:
        for future in pending:
            future.cancel()


def files_of(row: Row, pool: Pool, plan: Plan, handed: dict[str, Any]) -> Any:
    """What stands for the files of a row's robot in the pool, which gets them once."""
    bundle = plan.bundle(row.experiment)
    if bundle.digest not in handed:
        handed[bundle.digest] = pool.share(bundle)
    return handed[bundle.digest]


def take(rows: Iterator[Row], count: int) -> Iterator[Row]:
    """The next few."""
    for _ in range(count):
        row = next(rows, None)
        if row is None:
            return
        yield row


def result_of(future: Future[JobResult], row: Row, pool: Pool) -> JobResult:
    """Result of a run; a run that kills its workers again and again has failed.

    Raises:
        MmnnError, StudyError: As in `execute`.
    """
    try:
        return future.result()
    except StudyError:
        raise
    except BrokenProcessPool as error:
        raise MmnnError(f"a worker process died, killed or out of memory; {LOST}") from error
    except CancelledError as error:
        pool.check()
        raise MmnnError(f"{pool.place} no longer knows its runs: was it stopped? {LOST}") from error
    except ModuleNotFoundError as error:
        fix = "install the same version of mmnn_pin there as here"
        raise StudyError(f"a worker has no {root_of(error)}", fix=fix) from error
    except Exception as error:
        if type(error).__name__ == "KilledWorker":
            return JobResult(row.id, "failed", message="the workers that ran it died, one after the other")
        raise MmnnError(f"a worker failed: {type(error).__name__}: {error}; {LOST}") from error


def root_of(error: ModuleNotFoundError) -> str:
    """Name of the package that is missing."""
    return str(error.name).partition(".")[0]
