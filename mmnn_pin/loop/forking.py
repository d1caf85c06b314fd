"""When a batch goes to forked processes, and how these begin and end.

They are forked from the process that asks for the batch, once it has the compiled code: loops and code are inherited,
nothing is sent to them but numbers. Ctrl-C is their parent's; they end with it, however it ends.
"""

from __future__ import annotations

import mmap
import multiprocessing
import signal
import sys
import threading
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from ..children import end_with
from ..torque.controller import CompiledController
from .loop import Loop

FORKED = 500_000  # samples of a batch, from which on it goes to processes
MORE = ("interfaces", "within_limits")
DECISIVE = ("engine", "timing", "plant", "contact", "sensor", "actuator", "latency", "disturbances", "safety", *MORE)
FORK: Any = multiprocessing.get_context("fork") if sys.platform == "linux" else None


def forks(loops: Sequence[Loop], workers: int) -> bool:
    """Whether a batch goes to processes: where forking is safe and takes less time than it gains.

    The first run compiles for all, so these are alike in all that code depends on. Laws in plain Python stay in this
    process: their authors may look at them afterwards.
    """
    safe = sys.platform == "linux" and threading.active_count() == 1 and not multiprocessing.current_process().daemon
    safe = safe and have_locks()
    large = workers > 1 and sum(loop.timing.samples for loop in loops) >= FORKED
    first = loops[0].controller
    return safe and large and isinstance(first, CompiledController) and all(are_alike(loops[0], loop) for loop in loops)


def are_alike(one: Loop, other: Loop) -> bool:
    """Whether the code that steps one loop is that of the other; robots, gains, references and seeds may differ."""
    first, second = one.controller, other.controller
    same = one.layout == other.layout and all(getattr(one, name) == getattr(other, name) for name in DECISIVE)
    same = same and limited(one) == limited(other)
    return same and one.engine != "ordinary" and type(first) is type(second) and first.name == second.name


@cache
def have_locks() -> bool:
    """Whether processes can have locks together: not where /dev/shm cannot be written, as in some containers."""
    try:
        FORK.Lock()
    except (ImportError, OSError):
        return False
    return True


def limited(loop: Loop) -> bool:
    """Whether any motor of a loop's robot has a limit: code that keeps within limits is other code."""
    return bool(np.isfinite(loop.robot.effort_limits).any())


class Flag:
    """What one process tells all that it forks; an event's lock would stay with one that is killed while it asks."""

    def __init__(self) -> None:
        self.shared = mmap.mmap(-1, 1)

    def set(self) -> None:
        """Tell it."""
        self.shared[0] = 1

    def is_set(self) -> bool:
        """Whether it was told."""
        return self.shared[0] == 1


def leave_to(parent: int) -> None:
    """Leave Ctrl-C to the parent of this process, and end with it however it ends.

    Args:
        parent: Its number.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    end_with(parent)
