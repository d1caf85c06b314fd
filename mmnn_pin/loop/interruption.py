"""Ctrl-C that waits for what must not be left half done."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def no_interruption() -> Iterator[list[int]]:
    """Ctrl-C is noted in a list, and comes at the end; the third one comes at once.

    In the midst of forking it would leave processes that nobody ends; in `concurrent.futures.wait`, locks that nobody
    gives back; after rows are handed over and before they are counted, a time that is not theirs. A signal that is
    blocked would reach a thread of BLAS, and Python all the same.
    """
    pressed: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):  # it raises nothing here
        yield pressed
        return

    def note(number: int, _: object) -> None:
        pressed.append(number)
        if len(pressed) > 2:
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, note)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, before)
        if pressed:
            signal.raise_signal(signal.SIGINT)
