"""Runs a study's missing rows in a pool and stores each as it comes."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from ...errors import MmnnError, StudyError
from .packed import root_of
from .plan import Plan, Row
from .pools import Pool
from .store import Store
from .worker import Done, Task, run

AGAIN = ("failed", "interrupted")  # statuses of rows that the next session runs again
LOST = "the same command goes on with what is missing"


def execute(
    pool: Pool, plan: Plan, rows: Iterable[Row], handed: dict[str, Any] | None = None
) -> Iterator[tuple[Row, Done]]:
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
    finished: queue.SimpleQueue[Future[Done]] = queue.SimpleQueue()
    pending: dict[Future[Done], Row] = {}
    left, alone = iter(rows), pool.first_alone
    files: dict[str, Any] = {} if handed is None else handed
    try:
        while True:
            room = (1 if alone else pool.window()) - len(pending)
            for row in take(left, room):
                future = pool.executor.submit(run, Task.of(row), files_of(row, pool, plan, files), pool.stop)
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
    """What stands for the files of a row's robot in the pool, handed to it once."""
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


def result_of(future: Future[Done], row: Row, pool: Pool) -> Done:
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
            return Done(row.id, "failed", message="the workers that ran it died, one after the other")
        raise MmnnError(f"a worker failed: {type(error).__name__}: {error}; {LOST}") from error


def fill(
    store: Store, plan: Plan, missing: list[int], pool: Pool, progress: Callable[[Done], None] = lambda done: None
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
