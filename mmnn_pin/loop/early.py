"""The first run on a machine: its result comes before the loop is compiled.

numba takes some twenty seconds for the loop's blocks. A first run does not wait for them: all blocks run as plain
Python (`compiled.run_plainly`), which is slow, but the few functions that take nearly all of its time (`NOTED`) are
noted after some calls, operation by operation (`noting`), and LLVM makes code of that in a tenth of a second to one
(`scalar_code`). A call that goes another way is made by plain Python, and noted, too, up to `WAYS` times. So the
bits are those of the compiled loop.

A function whose calls leave their ways often, such as a learner that sweeps until something is small, is compiled by
itself.

Meanwhile a process of its own compiles the loop for later runs, and goes on when this one is over, unless that was
killed. A run that is long waits for it.
"""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import chain
from tempfile import TemporaryFile
from time import sleep
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from ..children import begin_beside, end_if_killed
from ..compiled import cache_folder, run_compiled, run_plainly
from ..torque import law
from . import compiled
from .compiled import CompiledLoop, Run
from .noting import MOST, NotNoted, call, rebuilt
from .precompile import call_control_blocks, call_plant_blocks, no_collection
from .scalar_code import scalar_code
from .side_by_side import NOTHING, SYMBOL, Reader, Unlike, callback, machine

NOTED = ((compiled, ("observe", "move", "model_psi", "estimate")), (law, ("networks",)))
FIRST = 8  # calls before the one that is noted: the first of a run are not like the others
WAYS = 8  # of a function on the same arrays
PLAIN = 20  # calls that went none of them, after which the function is compiled
MANY = 6_000  # operations of a learner; those that have more leave their ways often, and are compiled
LONG = 100_000  # samples of all runs, after which compiled code is waited for
LONG_ONES: dict[str, Any] = {"setpoints": NOTHING, "rows": NOTHING, "counter": np.zeros(0, np.int64)}  # arrays of a run
LEFT_OUT: dict[str, Any] = {"numbers": None, "law": None, "state": NOTHING} | LONG_ONES
LOCK = "compiling"  # file in the cache folder that the process holds which compiles


class Way:
    """One way that calls of a function go, as code.

    Args:
        told: What `noting.call` gives.
        sizes: How many numbers each of the arrays has that it works on.
    """

    def __init__(self, told: dict[str, Any], sizes: list[int]) -> None:
        for name in {op[1] for op in told["ops"] if op[0] == "call"}:
            llvm.add_symbol(SYMBOL + name, callback(name).address)
        text = scalar_code(told, sizes)
        self.code = llvm.create_mcjit_compiler(llvm.parse_assembly(text), machine(0))
        self.code.finalize_object()
        self.run = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(self.code.get_function_address("call"))
        self.answer = told["answer"]


class Calls:
    """Calls of a function with the same arrays and tuples; numbers among its arguments may change.

    Their ways are those of calls on other arrays, too, where all that is no number is the same (`form`).

    Args:
        function: It.
        arguments: Of the first call; kept, as later ones are known by them.
    """

    def __init__(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
        self.function, self.arguments = function, arguments
        self.ways: list[Way] = []
        self.count = self.plain = 0
        self.can_be_noted = True
        reader, form, self.numbers = Reader(), [], list[tuple[int, int]]()
        try:
            for i, each in enumerate(arguments):
                if isinstance(each, int | float):
                    self.numbers.append((i, len(reader.numbers)))
                form.append(reader.told(float(each) if isinstance(each, int) else bare(each)))
        except Unlike:
            self.can_be_noted = False
        self.form, self.given, self.answer = form, np.array(reader.numbers, float), np.zeros(1)
        self.roots, self.first = [*reader.roots, self.given, self.answer], reader.size
        self.sizes = [root.size for root in self.roots]
        self.places = np.array([root.ctypes.data for root in self.roots], np.int64)
        self.address = self.places.ctypes.data

    def __call__(self, arguments: tuple[Any, ...]) -> Any:
        """What the function gives."""
        self.count += 1
        if not self.can_be_noted or self.count <= FIRST:
            return self.function(*arguments)
        for i, place in self.numbers:
            self.given[place] = arguments[i]
        for i, way in enumerate(self.ways):
            if way.run(self.address):
                if i:
                    self.ways.insert(0, self.ways.pop(i))
                return float(self.answer[0]) if way.answer is None else way.answer[0]
        self.plain += 1
        if self.plain == PLAIN or (len(self.ways) < WAYS and not self.note()):
            self.can_be_noted = False
            run_compiled(self.function, *chain(*(law.KERNELS.get(type(one), ()) for one in arguments)))
        return self.function(*arguments)

    def note(self) -> bool:
        """Add the way that the call at hand goes; False where it cannot be noted, or is too long."""
        most = MANY if self.function is law.estimate else MOST
        try:
            with no_collection():
                told = call(self.function, self.form, np.concatenate(self.roots), self.first, most)
                self.ways.append(Way(told, self.sizes))
        except (NotNoted, TypeError, ValueError, ArithmeticError, AttributeError):
            return False
        return True


def bare(argument: Any) -> Any:
    """An argument, a run's without what no function in `NOTED` takes from it: more runs are alike so."""
    return argument._replace(**LEFT_OUT) if isinstance(argument, Run) else argument


def known_by(argument: Any) -> Any:
    """What an argument that stays is known by: tuples are the same ones, arrays may be new views of the same memory."""
    if type(argument) is np.ndarray:
        return argument.__array_interface__["data"][0], argument.shape
    return None if isinstance(argument, int | float) else id(argument)


class Function:
    """A function that is noted, in place of it.

    Args:
        function: It.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.calls: dict[tuple[Any, ...], Calls] = {}

    def __call__(self, *arguments: Any) -> Any:
        """What it gives."""
        key = tuple([known_by(one) for one in arguments])
        found = self.calls.get(key)
        if found is None:
            found = Calls(self.function, arguments)
            alike = (one for one in self.calls.values() if one.form == found.form and one.sizes == found.sizes)
            found.ways = next((one.ways for one in alike), found.ways)
            self.calls[key] = found
        return found(arguments)


class Early:
    """Steps engines before they are compiled.

    Args:
        tell: Called now and then with what is waited for.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.tell, self.samples = tell, 0
        self.before = [(module, name, getattr(module, name)) for module, names in NOTED for name in names]
        self.functions = [Function(function) for *_, function in self.before]
        for (module, name, _), function in zip(self.before, self.functions, strict=True):
            setattr(module, name, function)
        CompiledLoop.instead = self
        run_plainly()

    def advance(self, engine: CompiledLoop, first: int, last: int, at: int) -> int:
        """What `CompiledLoop.advance` does."""
        if self.samples == 0:
            compile_beside(engine)
        self.samples += last - first
        if self.samples > LONG:
            self.end()
            wait(self.tell)
        return engine.step(first, last, at)

    def end(self) -> None:
        """Go on with compiled code."""
        CompiledLoop.instead = None
        for module, name, function in self.before:
            setattr(module, name, function)
        run_compiled()


@contextmanager
def early(tell: Callable[[str], None]) -> Iterator[None]:
    """Within it loops are stepped before they are compiled.

    Args:
        tell: Called now and then with what is waited for.
    """
    begun = Early(tell)
    try:
        yield
    finally:
        begun.end()


def is_compiling() -> bool:
    """Whether a process compiles for later runs."""
    folder = cache_folder()
    if folder is None:
        return False
    with suppress(OSError), (folder / LOCK).open("r+") as file:  # there is none, or it is another user's
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def wait(tell: Callable[[str], None]) -> None:
    """Wait for a process that compiles, if there is one.

    Args:
        tell: Called now and then with what is waited for.
    """
    while is_compiling():
        tell("the loop, in a process that a first run began")
        sleep(0.2)


def compile_beside(engine: CompiledLoop) -> None:
    """Let a process of its own compile the blocks and the loop of an engine, unless one does.

    It holds the lock of `LOCK`, which it inherits, until it ends, and nothing else that is ours.
    """
    folder, reader = cache_folder(), Reader()
    if folder is None:
        return
    run, *others = engine.blocks
    try:
        form = [reader.told(part) for part in (run._replace(**LONG_ONES), *others)]
    except Unlike:
        form = None
    memory = np.concatenate([np.zeros(0), *reader.roots, np.array(reader.numbers)])
    told = {"form": form, "values": memory.tolist(), "numbers": reader.size}
    with suppress(OSError), TemporaryFile() as read, (folder / LOCK).open("w") as lock:  # a full disk: nothing is
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        read.write(json.dumps(told).encode())
        read.seek(0)
        begin_beside(__name__, read=read, keep=(lock.fileno(),))


def main() -> None:
    """Compile the blocks and the loop of an engine that standard input tells of."""
    end_if_killed(int(sys.argv[1]))
    told: dict[str, Any] = json.load(sys.stdin)
    os.nice(5)
    with no_collection():
        call_control_blocks()
        call_plant_blocks()
        if told["form"] is not None:
            memory = np.array(told["values"])
            run, *others = (rebuilt(one, memory, told["numbers"]) for one in told["form"])
            compiled.advance(0, 0, run._replace(setpoints=np.zeros((1, 1)), rows=np.zeros((1, 1))), *others)


if __name__ == "__main__":
    main()
