"""The program `mmnn` is imported with two precautions, which an import from Python does not take.

- Ctrl-C where Python itself would print it, or lose it: while the program is imported, in destructors, at its end.
- Settings that libraries read from the folder where one stands, which may be a stranger's, do not count: numba reads
  `.numba_config.yaml` when it is imported and before it compiles, matplotlib `matplotlibrc`. Nor in its processes.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib.machinery import ModuleSpec, PathFinder
from types import FrameType, ModuleType
from typing import Any

OURS = "MMNN_CHILD"  # a variable that processes of ours have
READING = ("numba.core.config", "matplotlib")  # modules that read settings as they are imported
SOON = 0.05  # [s] after a Ctrl-C that was lost, when it comes again


def leave(number: int, frame: FrameType | None) -> None:
    """End this process at once."""
    os.write(2, b"error: stopped by Ctrl-C\n")
    os._exit(130)


PROGRAM = os.path.basename((getattr(sys, "argv", None) or [""])[0])
if PROGRAM == "mmnn" and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, leave)


def late(number: int, frame: FrameType | None) -> None:
    """Raise what was lost, unless a loop that listens by itself does."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        raise KeyboardInterrupt


@contextmanager
def heard() -> Iterator[None]:
    """Within it Ctrl-C raises KeyboardInterrupt; where Python drops that, as in a destructor, it comes again."""
    if signal.getsignal(signal.SIGINT) is not leave:  # it is not the program
        yield
        return
    usual = sys.unraisablehook

    def again(lost: Any) -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            return usual(lost)
        signal.setitimer(signal.ITIMER_REAL, SOON)

    sys.unraisablehook = again
    signal.signal(signal.SIGALRM, late)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, leave)
        if signal.setitimer(signal.ITIMER_REAL, 0.0)[0]:  # it was to come again
            leave(signal.SIGINT, None)


def is_interruption(error: BaseException | None) -> bool:
    """Whether an error comes of a KeyboardInterrupt, which some libraries and Python turn into others."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


class Elsewhere(PathFinder):
    """Finds those modules, and has them imported in the root folder."""

    @classmethod
    def find_spec(cls, name: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Where a module is; None for those that others find."""
        found = super().find_spec(name, path, target) if name in READING else None
        if found is not None and found.loader is not None:
            vars(found.loader)["exec_module"] = partial(executed, found.loader.exec_module)
        return found


def executed(execute: Callable[[ModuleType], None], module: ModuleType) -> None:
    """Execute a module in the root folder."""
    here = os.open(".", getattr(os, "O_PATH", os.O_RDONLY))  # which may be closed to readers
    try:
        os.chdir("/")
        execute(module)
    finally:
        os.fchdir(here)
        os.close(here)
    vars(module)["_config_fname"] = os.devnull  # which numba would look for again and again


if PROGRAM == "mmnn" or OURS in os.environ:
    sys.meta_path.insert(0, Elsewhere)
