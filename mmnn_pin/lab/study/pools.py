"""Where the runs of a study are made: in this process, in processes of this machine, or on a Dask cluster.

All three are executors of `concurrent.futures`. Workers of a cluster join and leave, lost runs are made again, no
folder is shared.
"""

from __future__ import annotations

import importlib
import logging
import os
import platform
import signal
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
from multiprocessing import active_children
from types import ModuleType
from typing import Any

from threadpoolctl import threadpool_limits

from ...children import Spawning, end_with, spawning
from ...errors import ConfigError, MmnnError, StudyError
from .worker import Bundle, Trial, TrialResult, code_digest, run

RETRIES = 2  # of a run whose worker raised; a run whose worker died is made again by the scheduler itself
LEAST, EACH = 64, 8  # runs that a cluster is given at a time: at least, and for each of its threads
TIMEOUT = 10.0  # to connect [s]
SILENCE = 60.0  # of a scheduler that is there: it is busy, or was stopped [s]


@dataclass
class Pool:
    """Makes runs."""

    executor: Executor  # takes them
    place: str  # what it is, for people
    window: Callable[[], int]  # how many runs it is given at a time; asked again and again
    # hands a robot's files to it; gives what stands for them in a call, None where they are there already
    share: Callable[[Bundle], Any] = lambda bundle: None
    check: Callable[[], None] = lambda: None  # asked about once a second
    # whether runs may start at once: until the first one has ended, others would compile what it does
    is_warm: bool = False
    # what stands for the files that were handed to it, by their digest
    shared: dict[str, Any] = field(default_factory=dict)

    def submit(self, trial: Trial, bundle: Bundle) -> Future[TrialResult]:
        """Have a run made; the files of a robot are handed in once."""
        if bundle.digest not in self.shared:
            self.shared[bundle.digest] = self.share(bundle)
        return self.executor.submit(run_side_by_side, trial, self.shared[bundle.digest])


def local(workers: int | None = None) -> AbstractContextManager[Pool]:
    """This machine: as many processes as workers, by default one per core; this process for one.

    Raises:
        ConfigError: Less than one.
    """
    count = number_of(workers)
    return here() if count == 1 else processes(count)


class Here(Executor):
    """Makes a run while it is handed in."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """The run, made."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def here() -> Iterator[Pool]:
    """This process, one run after the other."""
    with threadpool_limits(1, "blas"):
        yield Pool(Here(), "1 process", lambda: 1)


@contextmanager
def processes(count: int) -> Iterator[Pool]:
    """Processes of this machine, with nothing of the current folder on their path; they end with this one.

    An error or Ctrl-C ends them at once: what they have told is stored, the rest is made again.
    """
    others, context = {*active_children()}, Spawning()  # a fork would copy threads' locks
    with spawning():  # Python's tracker of what they share, too
        executor = ProcessPoolExecutor(count, context, begin, (os.getpid(),))
    with executor:
        try:
            yield Pool(executor, f"{count} processes", lambda: 2 * count)
        except BaseException:
            for process in {*active_children()} - others:
                process.kill()
            raise
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


def begin(parent: int) -> None:
    """In a new process: Ctrl-C is the parent's, and it ends with its parent."""
    end_with(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    on_one_thread()


@cache
def on_one_thread() -> None:
    """Keep linear algebra on one thread in this process: runs come side by side."""
    threadpool_limits(1, "blas")


def number_of(workers: int | None) -> int:
    """How many workers.

    Raises:
        ConfigError: Less than one.
    """
    if workers is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if workers < 1:
        raise ConfigError(f"{workers} workers", fix="use at least one", key="--workers")
    return workers


# -- a Dask cluster ----------------------------------------------------------------------------------------------------


@contextmanager
def cluster(address: str) -> Iterator[Pool]:
    """The workers of a Dask scheduler.

    Args:
        address: Of the scheduler, such as `tcp://10.0.0.1:8786`.

    Raises:
        StudyError: `distributed` is not installed; the scheduler cannot be reached, or it or a worker is of another
            version.
    """
    distributed = optional("no cluster without dask.distributed", "cluster", "distributed")
    with quiet():
        client = connected(distributed, address)

        lost = f"the scheduler at {address} is gone, or silent for {SILENCE:g} s"
        gone = MmnnError(f"{lost}; the same command goes on with what is missing")

        def check() -> None:
            if client.status not in ("running", "connecting"):
                raise gone

        def window() -> int:
            check()
            try:
                threads = client.sync(client.scheduler.ncores, callback_timeout=SILENCE)
                return max(LEAST, EACH * sum(threads.values()))
            except (OSError, TimeoutError):
                raise gone from None

        try:
            require_alike({"scheduler": client.run_on_scheduler(installed)} | client.run(installed, on_error="return"))
            count = len(client.nthreads())
            crew = f"{count} worker{'s' * (count > 1)}" if count else "no workers yet: waiting for some"
            if not address.startswith("tls://"):
                crew += "; open to whoever reaches it: `mmnn docs how-to/cluster`"
            executor = client.get_executor(pure=False, retries=RETRIES)
            yield Pool(
                executor,
                f"the cluster at {address} ({crew})",
                window,
                partial(client.submit, kept, pure=False),
                check,
                is_warm=True,
            )
            executor.shutdown(wait=False)
        finally:
            client.close(timeout=5)


def kept(bundle: Bundle) -> Bundle:
    """Files on the cluster: sent once, and made again from the scheduler's graph where a worker takes them along."""
    return bundle


def run_side_by_side(trial: Trial, bundle: Bundle | None = None) -> TrialResult:
    """Make a run on a worker of many; see `run`."""
    on_one_thread()
    return run(trial, bundle)


def connected(distributed: ModuleType, address: str) -> Any:
    """A client of a scheduler.

    Raises:
        StudyError: It cannot be reached, or nothing that answers there is one.
    """
    client = object.__new__(distributed.Client)
    try:
        client.__init__(address, timeout=TIMEOUT, set_as_default=False)
        return client
    except ValueError as error:
        what, why, fix = f"'{address}' is no address", str(error), "give one such as tcp://10.0.0.1:8786"
    except (OSError, TimeoutError) as error:
        what, why = f"the scheduler at {address} cannot be reached", " ".join(str(error).split()) or "no answer"
        fix = "start it with `dask scheduler`, and give the address that it prints"
    except Exception as error:  # a peer that speaks another protocol
        what, why = f"no Dask scheduler at {address}", f"{type(error).__name__}: {' '.join(str(error).split())}"
        fix = "give the address of a scheduler of the same version as here"
        if "TLS" in why or "encryption" in why:
            fix = "use tls:// and name your certificates, see 'Whom you trust' in `mmnn docs how-to/cluster`"
    client.status = "closed"  # else it waits for itself when the process ends, in vain
    raise StudyError(what, why=why, fix=fix, key="--cluster")


def installed() -> dict[str, str]:
    """Versions that must agree on all machines: what travels between them is pickled, and makes the same runs."""
    import distributed

    python = ".".join(platform.python_version_tuple()[:2])
    return {"python": python, "distributed": distributed.__version__, "code of mmnn_pin": code_digest()}


def require_alike(found: Mapping[str, Any]) -> None:
    """Refuse a scheduler or workers with other versions, or without this package.

    Args:
        found: The scheduler, and the address of every worker, to its `installed`, or to the error that it raised.

    Raises:
        StudyError: With the machine.
    """
    ours, fix = installed(), "install the same versions on all machines"
    for name, theirs in found.items():
        where = name if name == "scheduler" else f"worker at {name}"
        if isinstance(theirs, Exception):
            why = f"{type(theirs).__name__}: {theirs}"
            raise StudyError(f"the {where} cannot run mmnn_pin", why=why, fix=fix, key="--cluster")
        for what, version in ours.items():
            if theirs[what] != version:
                text = f"the {where} has {what} {theirs[what]}, this machine {version}"
                raise StudyError(text, fix=fix, key="--cluster")


@contextmanager
def quiet() -> Iterator[None]:
    """Dask's own log lines and warnings kept to itself: what matters stands in one line of ours."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module="distributed")
            yield
    finally:
        logging.disable(before)


def optional(what: str, extra: str, *modules: str) -> ModuleType:
    """The first of some modules, which all have to be installed.

    Args:
        what: What cannot be done without them.
        extra: The extra of this package that installs them.
        modules: Their names.

    Raises:
        StudyError: One is not installed.
    """
    try:
        found = [importlib.import_module(name) for name in modules]
    except ModuleNotFoundError as error:
        raise StudyError(what, why=f"no {error.name}", fix=f"pip install 'mmnn_pin[{extra}]'") from None
    return found[0]
