"""An existing Dask cluster as a pool: workers join and leave, lost runs are made again, no folder is shared.

The scheduler, and some workers, may not have this package. Dask takes a task apart on its way, so what it meets there
is bytes, and functions that exist only inside others: those travel by value, and fail where the package is missing,
not where they are unpacked.
"""

from __future__ import annotations

import asyncio
import logging
import pickle
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from functools import cache, lru_cache
from types import ModuleType
from typing import Any

from ...compiled import libraries
from ...errors import MmnnError, StudyError
from .execution import Pool, root_of
from .worker import Bundle, Job, JobResult, code_digest, run

RETRIES = 2  # of a run whose worker raised; a run whose worker died is made again by the scheduler itself
LEAST = 64  # runs handed out at a time, at least
ASKED_EVERY = 5.0  # how often the number of workers is asked for [s]
TIMEOUT = 10.0  # to connect [s]
SAME = ("python", "distributed")  # versions that must agree: what travels between them is pickled


@contextmanager
def cluster(address: str) -> Iterator[Pool]:
    """The workers of a Dask scheduler.

    Args:
        address: Of the scheduler, such as `tcp://10.0.0.1:8786`.

    Raises:
        StudyError: `distributed` is not installed; the scheduler cannot be reached, or it or a worker is of another
            version.
    """
    distributed = imported()
    with quiet():
        client = connected(distributed, address)
        try:
            require_same_versions(client.get_versions(), address)
            require_same_code(client.run(carriers()["code"], on_error="return"))
            state, executor = State(client, address), client.get_executor(pure=False, retries=RETRIES)
            try:
                yield Pool(
                    Packed(executor),
                    f"the cluster at {address}",
                    state.window,
                    state.share,
                    state.check,
                    crew=state.crew(),
                )
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

    def crew(self) -> str:
        """How many workers there are now."""
        count = len(self.workers())
        return f"{count} worker{'s' if count > 1 else ''}" if count else "no workers yet: waiting for some"

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
        """Eight runs for each thread that there is now."""
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
        """Make a run: `fn` is `worker.run`, the arguments are its job and the packed files of its robot."""
        assert fn is run and not kwargs
        return self.inner.submit(self.call, pickle.dumps(args[0]), args[1])


def carriers() -> dict[str, Callable[..., Any]]:
    """Functions that travel by value: `call` makes a run, `keep` holds bytes, `code` hashes a worker's sources."""

    def call(job: bytes, bundle: bytes) -> JobResult:
        from .cluster import run_packed

        return run_packed(job, bundle)

    def keep(packed: bytes) -> bytes:
        return packed

    def code() -> str:
        from .worker import code_digest

        return code_digest()

    return {"call": call, "keep": keep, "code": code}


def run_packed(job: bytes, bundle: bytes) -> JobResult:
    """Make a run on a worker; see `worker.run`."""
    on_one_thread()
    made: Job = pickle.loads(job)
    return run(made, unpacked(bundle))


@cache
def on_one_thread() -> None:
    """Keep linear algebra on one thread in this process: a worker's runs come side by side."""
    libraries().limit(limits=1, user_api="blas")


@lru_cache(maxsize=4)
def unpacked(bundle: bytes) -> Bundle:
    """A robot's files, unpacked once."""
    found: Bundle = pickle.loads(bundle)
    return found


def imported() -> ModuleType:
    """The module `distributed`.

    Raises:
        StudyError: It is not installed.
    """
    try:
        import distributed
    except ModuleNotFoundError as error:
        fix = "pip install 'mmnn_pin[cluster]'"
        raise StudyError("no cluster without dask.distributed", why=f"no {error.name}", fix=fix) from None
    return distributed


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
    from distributed.versions import get_versions

    async def ask() -> Any:
        async with rpc(address, timeout=TIMEOUT) as scheduler:
            return await asyncio.wait_for(scheduler.versions(), TIMEOUT)

    try:
        theirs = asyncio.run(ask())
    except (OSError, TimeoutError) as error:
        raise unreachable(address, error) from None
    except Exception as error:  # a peer that speaks another protocol
        why = f"{type(error).__name__}: {' '.join(str(error).split())}"
        fix = "give the address of a scheduler of the same version as here"
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
    if not of:
        return {}
    host = dict(of.get("host", {}))
    found = {name: str(version) for name, version in dict(of["packages"]).items()}
    return found | ({"python": str(host["python"])} if "python" in host else {})


def major(version: str, package: str) -> tuple[str, ...]:
    """The part of a version that must agree: 3.11 of Python, all of the others."""
    return tuple(version.split(".")[:2]) if package == "python" else (version,)


@contextmanager
def quiet() -> Iterator[None]:
    """Dask's own log lines and warnings kept to itself: what matters is told in one line of ours."""
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
