"""Where the processor time of a first run goes: typing, lowering, LLVM, the cache on disk, and what is no compiling.

    python benchmarks/compiling.py                  shares of `mmnn run chapter4 --controller two_layer`, empty cache
    python benchmarks/compiling.py --functions 20   and the functions that cost most
    python benchmarks/compiling.py -- run track --robot ur5 --controller pd_gravity --set time.duration=1

All of it is compiled in one process here, so it takes longer than the command, which uses two. numba says when a pass
and when a call of LLVM begins and ends; every second counts for the innermost of them.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from importlib import import_module
from typing import Any

COMMAND = ["run", "chapter4", "--controller", "two_layer"]
LOWERING = "native_lowering"


class Clock:
    """Processor seconds of this process by what it does, and by the function that is compiled."""

    def __init__(self) -> None:
        self.kinds, self.functions = Counter[str](), Counter[str]()
        self.stack, self.last = [("other", "-")], time.process_time()

    def _count(self) -> None:
        now = time.process_time()
        kind, function = self.stack[-1]
        self.kinds[kind] += now - self.last
        self.functions[function] += now - self.last
        self.last = now

    def enter(self, kind: str, function: str | None = None) -> None:
        """What begins now; within the same function where none is named."""
        self._count()
        self.stack.append((kind, function or self.stack[-1][1]))

    def leave(self) -> None:
        """What has begun last is over."""
        self._count()
        self.stack.pop()

    def around(self, kind: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """A function whose time counts for a kind."""

        def timed(*given: Any, **named: Any) -> Any:
            self.enter(kind)
            try:
                return function(*given, **named)
            finally:
                self.leave()

        return timed


def listen(clock: Clock) -> None:
    """Have numba tell the clock of its passes, of LLVM and of its cache."""
    from numba.core import caching
    from numba.core.event import Listener, register

    class Passes(Listener):
        def on_start(self, event: Any) -> None:
            kind = "lowering" if event.data["name"].startswith(LOWERING) else "typing and what is before it"
            clock.enter(kind, f"{event.data['module']}.{event.data['qualname']}")

        def on_end(self, event: Any) -> None:
            clock.leave()

    class Locks(Listener):
        def on_start(self, event: Any) -> None:
            clock.enter("LLVM")

        def on_end(self, event: Any) -> None:
            clock.leave()

    register("numba:run_pass", Passes())
    register("numba:llvm_lock", Locks())
    for name in ("save_overload", "load_overload"):
        setattr(caching.Cache, name, clock.around("cache", getattr(caching.Cache, name)))


def main() -> None:
    """Run a command with an empty cache in this process, and print what it took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--functions", type=int, default=0, metavar="N", help="print the N that cost most")
    parser.add_argument("command", nargs="*", default=COMMAND, help="arguments of mmnn, after --")
    options = parser.parse_args()
    clock = Clock()
    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"NUMBA_CACHE_DIR": f"{folder}/cache", "NUMBA_DISABLE_JIT": "0"}
        listen(clock)
        from mmnn_pin.cli import main as mmnn
        from mmnn_pin.loop import precompile

        vars(import_module("mmnn_pin.cli.run"))["before_it_is_compiled"] = after_it_is_compiled
        precompile.precompile = in_one_process  # type: ignore[assignment]
        sys.argv = ["mmnn", *options.command, "--out", f"{folder}/runs", "--json"]
        with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), suppress(SystemExit):
            mmnn()
    clock.enter("end")
    total, count = sum(clock.kinds.values()), len(clock.functions) - 1
    print(f"{total:.1f} s of processor time, {count} functions")
    for kind, seconds in clock.kinds.most_common():
        print(f"{kind:30}{seconds:8.2f} s{100 * seconds / total:6.1f} %")
    for name, seconds in clock.functions.most_common(options.functions):
        print(f"{seconds:8.2f} s  {name}")


@contextmanager
def after_it_is_compiled(hardware: bool) -> Iterator[None]:
    """All is compiled first, as later commands do that find nothing compiled."""
    from mmnn_pin.cli.output import compile_if_cold

    compile_if_cold(hardware)
    yield


def in_one_process(*_: Any) -> None:
    """What two processes do otherwise."""
    from mmnn_pin.loop.precompile import call_control_blocks, call_plant_blocks, no_collection

    with no_collection():
        call_control_blocks()
        call_plant_blocks()


if __name__ == "__main__":
    main()
