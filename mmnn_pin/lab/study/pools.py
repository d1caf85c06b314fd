"""Where the runs of a study are made: threads of this process, processes of this machine, or a Dask cluster.

Workers of a cluster join and leave, lost runs are made again, no folder is shared. The scheduler, and some workers, may
not have this package. Dask takes a task apart on its way, so what it meets there is bytes, and functions that exist
only inside others: those travel by value, and fail where the package is missing, not where they are unpacked.
"""

from __future__ import annotations

import asyncio
import logging
import os
import pickle
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache
from types import ModuleType
from typing import Any

from ...children import Spawning, end_with, spawning
from ...compiled import libraries
from ...errors import ConfigError, MmnnError, StudyError
from . import worker
from .worker import Bundle, JobResult, code_digest, optional, run

RETRIES = 2  # of a run whose worker raised; a run whose worker died is made again by the scheduler itself
LEAST = 64  # calls handed out at a time, at least
ASKED_EVERY = 5.0  # how often the number of workers is asked for [s]
TIMEOUT = 10.0  # to connect [s]
SAME = ("python", "distributed")  # versions that must agree: what travels between them is pickled


@dataclass(frozen=True)
class Pool:
    """Takes runs, some at a time.

    Attributes:
        executor: Runs them.
        place: What it is, for people.
        window: How many calls it is given at a time; asked again and again.
        processes: How many there are, each with compiled code of its own.
        share: Hands a robot's files to it; gives what stands for them in a call, None where they are there already.
        check: Asked about once a second.
        stop: Tells runs in this process to end; None where they know by themselves.
        first_alone: Whether the first run must have ended before others start: it compiles.
        crew: Who is there at the start, for people.
    """

    executor: Executor
    place: str
    window: Callable[[], int]
    processes: int = 1
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
    context = Spawning()  # a fork would copy threads' locks
    with spawning():  # Python's tracker of what they share, too
        stop = context.Event()
        executor = ProcessPoolExecutor(count, context, begin, (stop, os.getpid()))
    with executor:
        try:
            yield Pool(executor, f"{count} process{'es' * (count > 1)}", lambda: 2 * count, count)
        finally:
            stop.set()
            executor.shutdown(wait=True, cancel_futures=True)


def begin(stop: Any, parent: int) -> None:
    """In a new process: Ctrl-C is the parent's, and so is the event that ends the runs; it ends with its parent."""
    end_with(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    worker.STOP = stop


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
        try:
            require_same_versions(client.get_versions(), address)
            require_same_code(client.run(carriers()["code"], on_error="return"))
            state, executor = State(client, address), client.get_executor(pure=False, retries=RETRIES)
            try:
                place, count = f"the cluster at {address}", len(state.workers())
                crew = f"{count} worker{'s' * (count > 1)}" if count else "no workers yet: waiting for some"
                yield Pool(Packed(executor), place, state.window, count, state.share, state.check, crew=crew)
            finally:
                executor.shutdown(wait=False)
        finally:
            client.close(timeout=5)


class State:
    """What is known of a cluster.

    Args:
        client: Connected to it.
        address: Of its scheduler.
    """

    def __init__(self, client: Any, address: str) -> None:
        self.client, self.address = client, address
        self.threads, self.asked = 0, -ASKED_EVERY

    def workers(self) -> dict[str, int]:
        """Address of every worker to its number of threads.

        Raises:
            MmnnError: The scheduler is gone.
        """
        self.check()
        try:
            return dict(self.client.nthreads())
        except (OSError, TimeoutError) as error:
            raise self.gone() from error

    def window(self) -> int:
        """Eight calls for each thread that there is now."""
        if time.monotonic() - self.asked > ASKED_EVERY:
            self.threads, self.asked = sum(self.workers().values()), time.monotonic()
        return max(LEAST, 8 * self.threads)

    def share(self, bundle: Bundle) -> Any:
        """Files on the cluster: sent once, kept by the scheduler's graph, so that a lost worker takes nothing along."""
        return self.client.submit(carriers()["keep"], pickle.dumps(bundle), pure=False)

    def check(self) -> None:
        """Refuse to wait for a scheduler that is gone.

        Raises:
            MmnnError: It is.
        """
        if self.client.status not in ("running", "connecting"):
            raise self.gone()

    def gone(self) -> MmnnError:
        """What to say of a scheduler that does not answer any more."""
        return MmnnError(f"the scheduler at {self.address} is gone; the same command goes on with what is missing")


class Packed(Executor):
    """An executor that packs a study's runs for another one.

    Args:
        inner: Takes functions of bytes.
    """

    def __init__(self, inner: Executor) -> None:
        self.inner = inner
        self.call = carriers()["call"]

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Make runs: `fn` is `worker.run`; the arguments are its own, the files of the robot packed."""
        assert fn is run and not kwargs
        rows, bundle, _ = args
        return self.inner.submit(self.call, pickle.dumps(rows), bundle)


def carriers() -> dict[str, Callable[..., Any]]:
    """Functions that travel by value: `call` makes runs, `keep` holds bytes, `code` hashes a worker's sources."""

    def call(rows: bytes, bundle: bytes) -> list[JobResult]:
        from .pools import run_packed

        return run_packed(rows, bundle)

    def keep(packed: bytes) -> bytes:
        return packed

    def code() -> str:
        from .worker import code_digest

        return code_digest()

    return {"call": call, "keep": keep, "code": code}


def run_packed(rows: bytes, bundle: bytes) -> list[JobResult]:
    """Make runs on a worker; see `worker.run`."""
    on_one_thread()
    return run(pickle.loads(rows), unpacked(bundle), None)


@cache
def on_one_thread() -> None:
    """Keep linear algebra on one thread in this process: a worker's runs come side by side."""
    libraries().limit(limits=1, user_api="blas")


unpacked: Callable[[bytes], Bundle] = lru_cache(maxsize=4)(pickle.loads)


def connected(distributed: ModuleType, address: str) -> Any:
    """A client of a scheduler.

    Raises:
        StudyError: It cannot be reached.
    """
    require_address(address)
    require_scheduler(address)
    try:
        return distributed.Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise unreachable(address, error) from None


def require_scheduler(address: str) -> None:
    """Refuse an address at which nobody answers, or a scheduler of another version, before a client is made.

    Raises:
        StudyError: With both versions.
    """
    from distributed.core import rpc
    from distributed.security import Security
    from distributed.versions import get_versions

    async def ask() -> Any:
        certificates = Security().get_connection_args("client")
        async with rpc(address, timeout=TIMEOUT, connection_args=certificates) as scheduler:
            return await asyncio.wait_for(scheduler.versions(), TIMEOUT)

    try:
        theirs = asyncio.run(ask())
    except (OSError, TimeoutError) as error:
        raise unreachable(address, error) from None
    except Exception as error:  # a peer that speaks another protocol
        why = f"{type(error).__name__}: {' '.join(str(error).split())}"
        fix = "give the address of a scheduler of the same version as here"
        if "TLS" in why or "encryption" in why:
            fix = "use tls:// and name your certificates, see 'Whom you trust' in `mmnn docs how-to/cluster`"
        raise StudyError(f"no Dask scheduler at {address}", why=why, fix=fix, key="--cluster") from None
    require_same_versions({"client": get_versions(), "scheduler": theirs, "workers": {}}, address)


def unreachable(address: str, error: Exception) -> StudyError:
    """The complaint about a scheduler that does not answer."""
    why = " ".join(str(error).split()) or "no answer"
    fix = "start it with `dask scheduler`, and give the address that it prints"
    return StudyError(f"the scheduler at {address} cannot be reached", why=why, fix=fix, key="--cluster")


def require_address(address: str) -> None:
    """Refuse what is no address.

    Raises:
        StudyError: With the reason.
    """
    from distributed.comm.addressing import parse_address, parse_host_port
    from distributed.comm.registry import get_backend

    try:
        scheme, place = parse_address(address)
        get_backend(scheme)
        parse_host_port(place)
    except ValueError as error:
        fix = "give one such as tcp://10.0.0.1:8786"
        raise StudyError(f"'{address}' is no address", why=str(error), fix=fix, key="--cluster") from None


def require_same_versions(versions: Mapping[str, Any], address: str) -> None:
    """Refuse a scheduler or workers of another Python or another Dask.

    Args:
        versions: As `Client.get_versions` gives them.
        address: Of the scheduler.

    Raises:
        StudyError: With both versions and the machine.
    """
    ours = packages(versions["client"])
    peers = {f"scheduler at {address}": versions["scheduler"]}
    peers |= {f"worker at {name}": worker for name, worker in versions["workers"].items()}
    for name, peer in peers.items():
        theirs = packages(peer)
        for package in SAME:
            if package in theirs and major(theirs[package], package) != major(ours[package], package):
                fix = "install the same versions on all machines"
                what = f"the {name} has {package} {theirs[package]}, this machine {ours[package]}"
                raise StudyError(what, fix=fix, key="--cluster")


def require_same_code(found: Mapping[str, Any]) -> None:
    """Refuse workers without this package, or with other sources of it.

    Args:
        found: Address of every worker to its digest of the sources, or to the error that it raised.

    Raises:
        StudyError: With the worker.
    """
    for name, code in found.items():
        if isinstance(code, ModuleNotFoundError):
            fix = "install the same version of mmnn_pin there as here"
            raise StudyError(f"the worker at {name} has no {root_of(code)}", fix=fix, key="--cluster")
        if code != code_digest():
            why = "" if isinstance(code, str) else f"{type(code).__name__}: {code}"
            fix = "install the same version of mmnn_pin on all machines"
            raise StudyError(f"the worker at {name} runs other code of mmnn_pin", why=why, fix=fix, key="--cluster")


def packages(of: Mapping[str, Any] | None) -> dict[str, str]:
    """Package to version, of one machine."""
    python = {key: value for key, value in dict((of or {}).get("host", {})).items() if key == "python"}
    return {name: str(version) for name, version in (dict((of or {}).get("packages", {})) | python).items()}


def major(version: str, package: str) -> tuple[str, ...]:
    """The part of a version that must agree: 3.11 of Python, all of the others."""
    return tuple(version.split(".")[:2]) if package == "python" else (version,)


@contextmanager
def quiet() -> Iterator[None]:
    """Dask's own log lines and warnings kept to itself: what matters stands in one line of ours."""
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] in ("distributed", "tornado")]
    loggers = [logging.getLogger(name) for name in ("distributed", "tornado.application", *names)]
    before = [logger.disabled for logger in loggers]
    for logger in loggers:
        logger.disabled = True
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module="distributed")
            yield
    finally:
        for logger, was in zip(loggers, before, strict=True):
            logger.disabled = was


def root_of(error: ModuleNotFoundError) -> str:
    """Name of the package that is missing."""
    return str(error.name).partition(".")[0]
