"""An existing Dask cluster as a pool: workers join and leave, lost runs are made again, no folder is shared."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from ..errors import MmnnError, StudyError
from .bundle import Bundle
from .pools import Pool

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
            state = State(client, address)
            executor = client.get_executor(pure=False, retries=RETRIES)
            try:
                yield Pool(executor, state.place(), state.window, state.share, state.check)
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

    def place(self) -> str:
        """The cluster in words."""
        count = len(self.client.nthreads())
        workers = f"{count} worker{'s' * (count != 1)} now" if count else "no workers yet: waiting for some"
        return f"the cluster at {self.address} ({workers})"

    def window(self) -> int:
        """Eight runs for each thread that there is now."""
        if time.monotonic() - self.asked > ASKED_EVERY:
            self.check()
            self.threads, self.asked = sum(self.client.nthreads().values()), time.monotonic()
        return max(LEAST, 8 * self.threads)

    def share(self, bundle: Bundle) -> Any:
        """Files on the cluster: sent once, kept by the scheduler's graph, so that a lost worker takes nothing along."""
        return self.client.submit(kept, bundle, pure=False)

    def check(self) -> None:
        """Refuse to wait for a scheduler that is gone.

        Raises:
            MmnnError: It is.
        """
        if self.client.status not in ("running", "connecting"):
            raise MmnnError(f"the scheduler at {self.address} is gone; the same command goes on with what is missing")


def kept(bundle: Bundle) -> Bundle:
    """The files themselves: what a worker holds for the others."""
    return bundle


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
    try:
        return distributed.Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, TimeoutError) as error:
        why = " ".join(str(error).split()) or "no answer"
        fix = "start it with `dask scheduler`, and give the address that it prints"
        raise StudyError(f"the scheduler at {address} cannot be reached", why=why, fix=fix, key="--cluster") from None
    except Exception as error:  # an address that is none, a peer that speaks another protocol
        why = f"{type(error).__name__}: {' '.join(str(error).split())}"
        fix = "give an address such as tcp://10.0.0.1:8786, of a scheduler of the same version"
        raise StudyError(f"no Dask scheduler at {address}", why=why, fix=fix, key="--cluster") from None


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
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module="distributed")
            yield
    finally:
        logger.setLevel(before)
