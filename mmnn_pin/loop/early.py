"""The first run on a machine: its result comes before the loop is compiled.

numba takes some twenty seconds for the loop's blocks. A run whose sample can be noted (`noting`) does not wait for
them: all blocks run as plain Python (`compiled.run_plainly`), which is slow, but after a few samples one is noted, and
LLVM makes code of its operations in half a second (`scalar_code`). A sample that goes another way is made by plain
Python, and noted, too, up to `WAYS` times. So the bits are those of the compiled loop.

Meanwhile a process of its own compiles the loop for later runs, and goes on when this one is over. It is waited for
where an engine cannot be noted (a hardware model, a learner that counts its samples), leaves its ways often, or runs
for long.
"""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from tempfile import TemporaryFile
from time import sleep
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from ..compiled import cache_folder, run_compiled, run_plainly
from .compiled import CompiledLoop, advance
from .noting import NotNoted, rebuilt, sample
from .precompile import call_control_blocks, call_plant_blocks, no_collection, precompile
from .scalar_code import scalar_code
from .side_by_side import LANES, SYMBOL, Form, callback, forms_of, machine, told_of

FIRST = 8  # samples before the one that is noted: the first of a run are not like the others
WAYS = 6  # of a form
PLAIN = 400  # samples that went none of them, after which compiled code is waited for
LONG = 200_000  # samples of all runs, after which compiled code is waited for
LOCK = "compiling"  # file in the cache folder that the process holds which compiles


class Way:
    """One way that samples of a form go, as code.

    Args:
        engine: Before the sample that is noted.
        form: Its form.
        number: The sample's.

    Raises:
        NotNoted: It cannot be noted.
    """

    def __init__(self, engine: CompiledLoop, form: Form, number: int) -> None:
        told = sample(told_of(engine, form, number), rows=True)
        target = machine(0)
        for name in {op[1] for op in told["ops"] if op[0] == "call"}:
            llvm.add_symbol(SYMBOL + name, callback(name).address)
        text = scalar_code(told, [root.size for root in form.roots])
        self.code = llvm.create_mcjit_compiler(llvm.parse_assembly(text), target)
        self.code.finalize_object()
        pointer, integer = ctypes.c_void_p, ctypes.c_int64
        kind = ctypes.CFUNCTYPE(integer, pointer, pointer, pointer, integer, integer, ctypes.c_double)
        self.advance = kind(self.code.get_function_address("advance"))


class Early:
    """Steps engines before they are compiled.

    Args:
        tell: Called every second with what is waited for.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.tell = tell
        self.ways: dict[str, list[Way]] = {}  # by the key of their form
        self.asked = False  # for compiled code
        self.plain = self.samples = 0
        self.engine: CompiledLoop | None = None

    def advance(self, engine: CompiledLoop, first: int, last: int, at: int) -> int:
        """What `CompiledLoop.advance` does."""
        self.samples += last - first
        suits = engine is self.engine or self.take_up(engine)
        if not suits or self.plain > PLAIN or self.samples > LONG:
            self.end()
            return engine.advance(first, last, at)
        k = first
        while k < last:
            engine.counter[0] = at + k - first
            if done := self.along_a_way(k, last - k, at + k - first):
                k += done
                continue
            if (bad := engine.step(k, k + 1, at + k - first)) != -1:
                return bad
            self.plain += k >= FIRST
            k += 1
        engine.counter[0] = at + last - first
        return -1

    def take_up(self, engine: CompiledLoop) -> bool:
        """Begin with an engine; False where it cannot be noted."""
        forms = forms_of([engine] * LANES)
        if forms is None or engine.learner is not None:
            return False
        self.engine, self.form = engine, forms[0]
        self.known = self.ways.setdefault(self.form.key, [])
        self.roots = np.array([root.ctypes.data for root in self.form.roots], np.int64)
        if not self.asked:
            self.asked = True
            compile_beside(self.form)
        return True

    def along_a_way(self, k: int, count: int, at: int) -> int:
        """Make samples from k on, at most as many as asked for, by code; how many were made, 0 where none goes so."""
        engine = self.engine
        assert engine is not None
        if k < FIRST or self.plain > PLAIN:
            return 0
        for i, way in enumerate(self.known):
            if done := self.made(way, k, count, at):
                self.known.insert(0, self.known.pop(i))
                return done
        if len(self.known) >= WAYS:
            return 0
        try:
            with no_collection():
                self.known.insert(0, Way(engine, self.form, k))
        except (NotNoted, TypeError, ValueError, ArithmeticError, AttributeError):
            self.plain = PLAIN + 1  # compiled code is waited for, from the next samples on
            return 0
        return self.made(self.known[0], k, count, at)

    def made(self, way: Way, k: int, count: int, at: int) -> int:
        """How many samples from k on a way has made."""
        engine = self.engine
        assert engine is not None
        setpoints, rows = engine.run.setpoints[k - 1 :], engine.rows[at:]
        return int(
            way.advance(
                self.roots.ctypes.data, setpoints.ctypes.data, rows.ctypes.data, k, count, engine.run.numbers.h
            )
        )

    def end(self) -> None:
        """Go on with compiled code; wait for it where it is being made."""
        if CompiledLoop.instead is None:
            return
        CompiledLoop.instead = None
        run_compiled()
        wait(self.tell)
        if not self.asked:
            precompile(self.tell)


@contextmanager
def early(tell: Callable[[str], None]) -> Iterator[None]:
    """Within it loops are stepped before they are compiled, where that is possible.

    Args:
        tell: Called every second with what is waited for.
    """
    begun = Early(tell)
    CompiledLoop.instead = begun
    run_plainly()
    try:
        yield
    finally:
        CompiledLoop.instead = None
        run_compiled()


def is_compiling() -> bool:
    """Whether a process compiles for later runs."""
    folder = cache_folder()
    if folder is None or not (folder / LOCK).exists():
        return False
    with (folder / LOCK).open("r+") as file, suppress(OSError):
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return False
    return True


def wait(tell: Callable[[str], None]) -> None:
    """Wait for a process that compiles, if there is one.

    Args:
        tell: Called now and then with what is waited for.
    """
    while is_compiling():
        tell("the loop, in a process that an earlier run began")
        sleep(0.2)


def compile_beside(form: Form) -> None:
    """Let a process of its own compile the blocks and the loop of a form, unless one does.

    It holds the lock of `LOCK`, which it inherits, until it ends, and nothing else that is ours.
    """
    folder = cache_folder()
    if folder is None:
        return
    told = {"form": form.form, "values": np.concatenate(form.roots).tolist()}
    told["numbers"] = sum(root.size for root in form.roots[:-1])
    with TemporaryFile() as read, (folder / LOCK).open("w") as lock, suppress(OSError):
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        read.write(json.dumps(told).encode())
        read.seek(0)
        command, quiet = [sys.executable, "-m", __name__], subprocess.DEVNULL
        streams: dict[str, Any] = {"stdin": read, "stdout": quiet, "stderr": quiet}
        subprocess.Popen(command, **streams, start_new_session=True, pass_fds=(lock.fileno(),))


def main() -> None:
    """Compile the blocks and the loop of a form that standard input tells of."""
    told: dict[str, Any] = json.load(sys.stdin)
    os.nice(5)
    with no_collection():
        call_control_blocks()
        call_plant_blocks()
        memory = np.array(told["values"])
        parts = (rebuilt(one, memory, told["numbers"]) for one in told["form"])
        run, true, nominal, learner, limits, ahead, later = parts
        run = run._replace(setpoints=np.zeros((1, 1)), rows=np.zeros((1, 1)))
        advance(0, 0, run, true, nominal, None, learner, limits, ahead, later, None)


if __name__ == "__main__":
    main()
