"""Processes of our own: they run what we import, nothing that lies where one stands, and end with their parent.

Python looks for modules first in the folder of the script, or in the current one: a `struct.py` that a stranger left
beside his recordings would run. Here a process looks where Python's libraries are, where the user's PYTHONPATH says
and where this package is. A worker that is handed the user's own classes looks beside his script, too, but last.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path

from .program import OURS

PR_SET_PDEATHSIG = 1  # of Linux: the signal that a process gets when its parent has ended
LOOK_EVERY = 0.5  # whether the parent still lives, where the system does not tell [s]


def stood_in() -> set[str]:
    """Folders that Python looks into because it was started there: the script's and the current one."""
    main, found = sys.modules.get("__main__"), set[str]()
    script = getattr(main, "__file__", None)
    if script and getattr(main, "__spec__", None) is None:  # else it was started by `-m`
        found.add(os.path.dirname(os.path.realpath(script)))
    with suppress(OSError):  # it is gone
        found.add(os.path.realpath(os.getcwd()))
    asked = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    return found - {os.path.realpath(folder) for folder in asked if os.path.isabs(folder)}


def search_path() -> list[str]:
    """Where a process of ours looks for modules."""
    left_out, root = stood_in(), str(Path(__file__).parent.parent)
    kept = [os.path.abspath(folder) for folder in sys.path if folder and os.path.realpath(folder) not in left_out]
    return kept if root in kept else [root, *kept]


def environment() -> dict[str, str]:
    """Environment of a process of ours, with the precautions of `program`; the interpreter needs `-P` besides."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(search_path()), OURS: "1"}


def end_with(parent: int) -> None:
    """End this process when its parent ends, however that ends.

    Args:
        parent: Its number.
    """
    if sys.platform != "linux" or ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL):
        threading.Thread(target=watch_parent, args=(parent,), daemon=True).start()
    if os.getppid() != parent:
        os._exit(1)


def watch_parent(parent: int) -> None:
    """End this process soon after its parent."""
    while os.getppid() == parent:
        time.sleep(LOOK_EVERY)
    os._exit(1)


@contextmanager
def spawning() -> Iterator[None]:
    """While processes are spawned: they start as others of ours, but find the user's own modules, too."""
    names, path = ("PYTHONSAFEPATH", "PYTHONPATH"), sys.path
    before = {name: os.environ.get(name) for name in names}
    kept = search_path()
    os.environ |= {"PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join(kept)}
    sys.path = [*kept, *(folder for folder in map(os.path.abspath, path) if folder not in kept)]
    try:
        yield
    finally:
        sys.path = path
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


class Spawned(SpawnProcess):
    """A process that was spawned so."""

    def start(self) -> None:
        """Start it."""
        with spawning():
            super().start()


class Spawning(SpawnContext):
    """How processes are spawned."""

    Process = Spawned
