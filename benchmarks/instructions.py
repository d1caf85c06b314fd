"""How many machine instructions a step of the compiled loop takes: the same on a busy machine as on a quiet one.

    python benchmarks/instructions.py            instructions per step beside those of `instructions.json`
    python benchmarks/instructions.py --check    exit status 1 where one takes 5 % more
    python benchmarks/instructions.py --keep     write them there, after a change that was meant

Numba compiles for a plain x86-64, so that machines agree. The processor stops after every instruction (its trap flag),
and a handler of that signal, compiled by numba too, counts. Runs of 2 and of 10 steps differ by 8 steps, without what
a call takes. It needs Linux on x86-64, and neither hardware counters nor other programs.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import platform
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from threading import get_ident
from typing import Any

import numpy as np
from numba import carray, cfunc, int64, types
from numba.extending import intrinsic

KEPT = Path(__file__).with_name("instructions.json")
FEW, MANY, WARM = 2, 10, 30  # steps; calls before
MORE = 1.05  # times the instructions that are kept: compilers differ by less, a slow-down of 10 % is more
PLAIN = {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": "", "NUMBA_DISABLE_JIT": "0"}
FLAGS, TRAP = 22, 0x100  # place of the flags among the words of a handler's context, and the trap flag (ucontext.h)
START, STOP, COUNT = signal.SIGUSR1, signal.SIGUSR2, signal.SIGTRAP
Handler = types.void(types.int32, types.voidptr, types.CPointer(types.int64))


def main() -> None:
    """Parse the command line, count, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="exit status 1 where a step takes 5 %% more than is kept")
    parser.add_argument("--keep", action="store_true", help=f"write {KEPT.name}")
    options = parser.parse_args()
    if not can_count():
        sys.exit(f"instructions are not counted on {platform.system()} {platform.machine()}: use Linux on x86-64")
    if any(os.environ.get(name) != value for name, value in PLAIN.items()):  # numba reads them once
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | PLAIN)
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {"instructions_per_step": {}}
    found = {name: per_step(advance) for name, advance in works().items()}
    slow = []
    for name, count in found.items():
        before = kept["instructions_per_step"].get(name, count)
        print(f"{name:24}{count:10,.0f} instructions per step, {before:,.0f} kept: {100 * (count / before - 1):+.1f} %")
        slow += [name] if count > MORE * before else []
    if options.keep:
        versions = {package: metadata.version(package) for package in ("numba", "llvmlite")}
        KEPT.write_text(json.dumps({"instructions_per_step": found, "versions": versions}, indent=2) + "\n")
    elif options.check and slow:
        fix = "make it as fast as it was, or say in the changelog why not and run benchmarks/instructions.py --keep"
        sys.exit(f"error: {', '.join(slow)}: a step takes more instructions: {fix}")


def can_count() -> bool:
    """Whether this machine's instructions can be counted."""
    return sys.platform == "linux" and platform.machine() == "x86_64"


def works() -> dict[str, Callable[[int], object]]:
    """What is counted: so many steps of a loop that has begun."""
    from workload import thesis_loop

    def stepping(engine: str) -> Callable[[int], object]:
        loop = thesis_loop(1.0, engine=engine)
        made = loop.engine_at()
        made.advance(0, FEW)
        return lambda count: made.advance(FEW, FEW + count)

    return {"thesis, compiled": stepping("compiled")}


def per_step(advance: Callable[[int], object]) -> float:
    """Instructions of one step; before, Python calls it until it has its own shortest way to do so."""
    for _ in range(WARM):
        advance(FEW)
    return (counted(lambda: advance(MANY)) - counted(lambda: advance(FEW))) / (MANY - FEW)


def counted(call: Callable[[], object]) -> int:
    """Instructions that a call takes in this thread."""
    thread = get_ident()
    with handlers() as count:
        signal.pthread_kill(thread, START)
        call()
        signal.pthread_kill(thread, STOP)
    return int(count[0])


@contextmanager
def handlers() -> Iterator[np.ndarray]:
    """The signals start, stop and count while it is open; what is counted."""
    count, libc = np.zeros(1, np.int64), ctypes.CDLL(None)
    address = count.ctypes.data

    def start(number: int, info: Any, context: Any) -> None:
        carray(context, 23)[FLAGS] |= TRAP

    def stop(number: int, info: Any, context: Any) -> None:
        carray(context, 23)[FLAGS] &= ~TRAP

    def trap(number: int, info: Any, context: Any) -> None:
        carray(place(address), 1)[0] += 1

    made, before = [cfunc(Handler)(function) for function in (start, stop, trap)], []
    for number, handler in zip((START, STOP, COUNT), made, strict=True):
        old, new = Action(), Action(handler=handler.address, flags=4)  # SA_SIGINFO
        libc.sigaction(number, ctypes.byref(new), ctypes.byref(old))
        before.append((number, old))
    try:
        yield count
    finally:
        for number, old in before:
            libc.sigaction(number, ctypes.byref(old), None)


class Action(ctypes.Structure):
    """`struct sigaction` of glibc."""

    _fields_ = (
        ("handler", ctypes.c_void_p),
        ("mask", ctypes.c_char * 128),
        ("flags", ctypes.c_int),
        ("restorer", ctypes.c_void_p),
    )


@intrinsic
def place(typing: Any, address: Any) -> Any:
    """An address as a pointer to integers."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.CPointer(int64)(int64), code


if __name__ == "__main__":
    main()
