"""Ctrl-C where Python itself would print it, or lose it: while the program is imported, in destructors, at its end.

Imported first of all, it does so for the program `mmnn` alone: who imports this package has his own ways.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

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


def is_interruption(error: BaseException | None) -> bool:
    """Whether an error comes of a KeyboardInterrupt, which some libraries and Python turn into others."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False
