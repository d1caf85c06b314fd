"""How much faster could several runs side by side be, one in each lane of the processor's vectors?

    python benchmarks/side_by_side.py             the thesis's loop, 1, 4 and 8 runs side by side
    python benchmarks/side_by_side.py --c FILE    also keep the program

A prototype, no second copy of the laws: one step of the compiled loop is run as plain Python on numbers that note what
is done with them. What they noted, some ten thousand sums, products, quotients and roots without a branch, becomes a C
function of vectors of 1, 4 or 8 runs. It knows all settings, does no more than this one step has to, and takes no
branch, so that it is faster than code that could be used: what it gains is an upper bound.

Needs gcc. The step is compared with that of the compiled loop, to 1e-9 of the largest value of every array.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

SAMPLE, REPEAT, ROUNDS, LANES = 100, 20_000, 7, (1, 4, 8)
AGAIN = 50  # steps until the state is set back, so that it stays near that of the step that was noted
HEAD = """
#include <math.h>
#include <stdint.h>
#include <string.h>
#define N LANES
typedef double V __attribute__((vector_size(8 * N), aligned(8 * N)));
typedef int64_t I __attribute__((vector_size(8 * N), aligned(8 * N)));
static inline V root(V x) { V y; for (int i = 0; i < N; i++) y[i] = __builtin_sqrt(x[i]); return y; }
static inline V size(V x) { return (V)((I)x & 0x7fffffffffffffff); }
static inline V exponential(V x) {
    V k = x * 0x1.71547652b82fep+0 + 0x1.8p52, n = k - 0x1.8p52;
    V power = (V)(((I)k - 0x4338000000000000 + 1023) << 52), above = x - n * 0x1.62e42feep-1;
    V below = n * 0x1.a39ef35793c76p-33, r = above - below, t = r * r;
    V c = r - t * (0x1.555555555553ep-3 + t * (-0x1.6c16c16bebd93p-9 + t * (0x1.1566aaf25de2cp-14
        + t * (-0x1.bbd41c5d26bf1p-20 + t * 0x1.6376972bea4dp-25))));
    return (1.0 + (above + ((r * c) / (2.0 - c) - below))) * power;
}
static inline V sine(V x) {
    V t = x * x;
    return x + x * t * (-0x1.5555555555549p-3 + t * (0x1.111111110f8a6p-7 + t * (-0x1.a01a019c161d5p-13
        + t * (0x1.71de357b1fe7dp-19 + t * (-0x1.ae5e68a2b9cebp-26 + t * 0x1.5d93a5acfd57cp-33)))));
}
static inline V cosine(V x) {
    V t = x * x;
    return 1.0 - 0.5 * t + t * t * (0x1.555555555554cp-5 + t * (-0x1.6c16c16c15177p-10 + t * (0x1.a01a019cb159p-16
        + t * (-0x1.27e4f809c52adp-22 + t * (0x1.1ee9ebdb4b1c4p-29 + t * -0x1.8fae9be8838d4p-37)))));
}
void repeat(V *x, const V *start, int64_t size, int64_t count, int64_t again);
static void step(V *restrict x) {
"""
TAIL = """}
void repeat(V *x, const V *start, int64_t size, int64_t count, int64_t again) {
    for (int64_t i = 0; i < count; i++) {
        if (i % again == 0) memcpy(x, start, size * sizeof(V));
        step(x);
        __asm__ volatile("" ::: "memory");
    }
}
"""


def main() -> None:
    """Parse the command line, note a step, compile, compare, time in turn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--c", type=Path, metavar="FILE", help="keep the program")
    parser.add_argument("--noted", type=Path, help=argparse.SUPPRESS)  # the process that runs plain Python writes there
    options = parser.parse_args()
    if options.noted is not None:
        options.noted.write_text(json.dumps(noted_step()))
        return
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "step.json"
        command = [sys.executable, __file__, "--noted", str(told)]
        subprocess.run(command, check=True, env=os.environ | {"NUMBA_DISABLE_JIT": "1"})
        step = json.loads(told.read_text())
        if options.c is not None:
            options.c.write_text(program(step, 4))
        report(step, Path(folder))


def report(step: dict[str, Any], folder: Path) -> None:
    """Times of the compiled loop and of every number of lanes, in turn."""
    from workload import thesis_loop

    engine = thesis_loop(AGAIN * 1e-3 + 0.2, engine="compiled").engine_at()
    engine.advance(0, SAMPLE)
    start = np.array(step["start"])
    routes: dict[str, tuple[int, Callable[[int], object]]] = {
        "compiled loop": (1, lambda count: [engine.advance(SAMPLE, SAMPLE + AGAIN) for _ in range(count // AGAIN)])
    }
    for lanes in LANES:
        run = built(step, lanes, folder)
        found = run(start, 1)
        assert alike(found, step), f"{lanes} lanes do another step"
        routes[f"noted step, {lanes} side by side"] = (lanes, lambda count, run=run: run(start, count))  # type: ignore[misc]
    times: dict[str, list[float]] = {name: [] for name in routes}
    for _ in range(ROUNDS):
        for name, (lanes, route) in routes.items():
            before = time.thread_time()
            route(REPEAT)
            times[name].append(1e6 * (time.thread_time() - before) / REPEAT / lanes)
    first = median(times["compiled loop"])
    print(f"{step['operations']} operations, {8 * len(start) / 1024:.1f} kB per run; processor time per step and run")
    for name, some in times.items():
        print(f"{name:32}{median(some):8.2f} us{first / median(some):8.2f} times the compiled loop's speed")


def alike(found: np.ndarray[Any, Any], step: dict[str, Any]) -> bool:
    """Whether all lanes end where the plain step did."""
    expected, ok = np.array(step["end"]), True
    for first, last in step["arrays"]:
        size = max(np.abs(expected[first:last]).max(initial=0.0), 1e-300)
        ok &= bool((np.abs(found[first:last] - expected[first:last, None]) <= 1e-9 * size).all())
    return ok


def built(step: dict[str, Any], lanes: int, folder: Path) -> Callable[[Any, int], Any]:
    """The compiled program: from the state at the start (n,) and a number of steps to the state of all lanes (n, N)."""
    source, library = folder / f"step_{lanes}.c", folder / f"step_{lanes}.so"
    source.write_text(program(step, lanes))
    flags = ["-O2", "-march=native", "-mprefer-vector-width=512", "-ffp-contract=off", "-fno-math-errno", "-shared"]
    subprocess.run(["gcc", *flags, "-fPIC", "-w", "-o", str(library), str(source)], check=True)
    repeat = ctypes.CDLL(str(library)).repeat

    def run(start: Any, count: int) -> Any:
        room = np.empty(2 * start.size * lanes + 8)
        at = (-room.ctypes.data // 8) % 8  # aligned to 64 bytes
        first = room[at : at + start.size * lanes]
        first[:] = np.repeat(start, lanes)
        end = np.empty(start.size * lanes + 8)
        end = end[(-end.ctypes.data // 8) % 8 :][: start.size * lanes]
        repeat(*(ctypes.c_void_p(a.ctypes.data) for a in (end, first)), *map(ctypes.c_int64, (start.size, count, AGAIN)))
        return end.reshape(-1, lanes)

    return run


def program(step: dict[str, Any], lanes: int) -> str:
    """The C program."""
    return HEAD.replace("LANES", str(lanes)) + "\n".join(step["lines"]) + "\n" + TAIL


class Noted:
    """A number that notes in C what is done with it."""

    lines: list[str] = []

    def __init__(self, value: float, text: str) -> None:
        self.value, self.text = float(value), text

    @classmethod
    def made(cls, value: float, text: str) -> Noted:
        """The result of an operation."""
        cls.lines.append(f"V t{len(cls.lines)} = {text};")
        return cls(value, f"t{len(cls.lines) - 1}")

    def __add__(self, other: Any) -> Noted:
        return Noted.made(self.value + value(other), f"{self.text} + {text(other)}")

    def __radd__(self, other: Any) -> Noted:
        return Noted.made(value(other) + self.value, f"{text(other)} + {self.text}")

    def __sub__(self, other: Any) -> Noted:
        return Noted.made(self.value - value(other), f"{self.text} - {text(other)}")

    def __rsub__(self, other: Any) -> Noted:
        return Noted.made(value(other) - self.value, f"{text(other)} - {self.text}")

    def __mul__(self, other: Any) -> Noted:
        return Noted.made(self.value * value(other), f"{self.text} * {text(other)}")

    def __rmul__(self, other: Any) -> Noted:
        return Noted.made(value(other) * self.value, f"{text(other)} * {self.text}")

    def __truediv__(self, other: Any) -> Noted:
        return Noted.made(self.value / value(other), f"{self.text} / {text(other)}")

    def __rtruediv__(self, other: Any) -> Noted:
        return Noted.made(value(other) / self.value, f"{text(other)} / {self.text}")

    def __mod__(self, other: float) -> Noted:
        return self - (self.value // other) * other

    def __neg__(self) -> Noted:
        return Noted.made(-self.value, f"-{self.text}")

    def __abs__(self) -> Noted:
        return Noted.made(abs(self.value), f"size({self.text})")

    def __lt__(self, other: Any) -> bool:
        return self.value < value(other)

    def __le__(self, other: Any) -> bool:
        return self.value <= value(other)

    def __gt__(self, other: Any) -> bool:
        return self.value > value(other)

    def __ge__(self, other: Any) -> bool:
        return self.value >= value(other)

    def __eq__(self, other: object) -> bool:
        return self.value == value(other)

    def __ne__(self, other: object) -> bool:
        return self.value != value(other)

    __hash__ = None  # type: ignore[assignment]


def value(x: Any) -> float:
    """Of a number, noted or not."""
    return x.value if isinstance(x, Noted) else float(x)


def text(x: Any) -> str:
    """In C."""
    return x.text if isinstance(x, Noted) else f"({float(x).hex()})"


def noted(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    """A function that notes its call where its argument is noted."""
    return lambda x: Noted.made(function(x.value), f"{name}({x.text})") if isinstance(x, Noted) else function(x)


@contextmanager
def noting() -> Iterator[None]:
    """Lets the blocks' functions of numbers note their calls."""
    from mmnn_pin.elementary import angles, exponentials

    cosine, sine, root = noted(math.cos, "cosine"), noted(math.sin, "sine"), noted(math.sqrt, "root")
    exp = noted(math.exp, "exponential")

    def sigmoids(x: Any, y: Any) -> None:
        for j in range(x.size):
            y[j] = 1.0 / (1.0 + exp(-x[j]))

    others = {
        angles.cos_sin: lambda x: (cosine(x), sine(x)),
        angles.cos: cosine,
        angles.sin: sine,
        exponentials.sigmoids: sigmoids,
    }
    changed: list[tuple[Any, str, Any]] = [(math, "sqrt", math.sqrt), (np, "isfinite", np.isfinite)]
    for module in [m for name, m in list(sys.modules.items()) if name.startswith("mmnn_pin")]:
        changed += [(module, name, f) for name, f in vars(module).items() if callable(f) and f in others]
    for module, name, before in changed:
        setattr(module, name, others[before] if before in others else root if name == "sqrt" else finite)
    try:
        yield
    finally:
        for module, name, before in changed:
            setattr(module, name, before)


def finite(x: Any, isfinite: Callable[[Any], Any] = np.isfinite) -> Any:
    """`np.isfinite` of a number, noted or not."""
    return isfinite(x.value if isinstance(x, Noted) else x)


class Memory:
    """Arrays of noted numbers in place of arrays of numbers, views of one as views of one."""

    def __init__(self, known: set[int]) -> None:
        self.known, self.made, self.start = known, dict[int, Any](), list[float]()
        self.arrays: list[tuple[int, int]] = []

    def of(self, thing: Any) -> Any:
        """The same of arrays and tuples of them."""
        if isinstance(thing, np.ndarray):
            root = thing
            while isinstance(root.base, np.ndarray):
                root = root.base
            if thing.dtype != np.float64 or root.ctypes.data in self.known:
                return thing
            first = (thing.ctypes.data - root.ctypes.data) // 8
            return self.root(root).ravel()[first : first + thing.size].reshape(thing.shape)
        if isinstance(thing, tuple):
            parts = [self.of(part) for part in thing]
            return type(thing)(*parts) if hasattr(thing, "_fields") else tuple(parts)
        return thing

    def root(self, root: Any) -> Any:
        """The whole array that a view is of."""
        if root.ctypes.data not in self.made:
            first = len(self.start)
            self.start += root.ravel().tolist()
            self.arrays.append((first, len(self.start)))
            noted = np.empty(root.size, object)
            noted[:] = [Noted(x, f"x[{first + i}]") for i, x in enumerate(root.ravel())]
            self.made[root.ctypes.data] = noted.reshape(root.shape)
        return self.made[root.ctypes.data]

    def end(self) -> tuple[list[float], list[str]]:
        """The numbers now, and the lines that write those that have changed."""
        things = [thing for array in self.made.values() for thing in array.ravel()]
        changed = [(i, t) for i, t in enumerate(things) if text(t) != f"x[{i}]"]
        return [value(t) for t in things], [f"x[{i}] = (V){{}} + {text(t)};" for i, t in changed]


def noted_step() -> dict[str, Any]:
    """One step of the thesis's loop: its lines in C, the state before and after."""
    from workload import thesis_loop

    from mmnn_pin.loop.compiled import advance

    engine = thesis_loop(AGAIN * 1e-3 + 0.2, engine="compiled").engine_at()
    engine.advance(0, SAMPLE)
    run, true = engine.run, engine.true
    settings = (run.setpoints, run.then, run.gains, run.K, run.law, run.E_inv, run.bounds, true.body, true.joints)
    memory = Memory({array.ctypes.data for array in arrays(settings)})
    engine.rows = run.rows[:1].copy()
    run = run._replace(rows=engine.rows)
    with noting():
        ended = advance(SAMPLE, SAMPLE + 1, memory.of(run), memory.of(true), engine.nominal, None, None, None, None, None, None)
    assert ended == -1
    lines = list(Noted.lines)
    end, stores = memory.end()
    operations = len(lines)
    return {
        "lines": lines + stores,
        "operations": operations,
        "start": memory.start,
        "end": end,
        "arrays": memory.arrays,
    }


def arrays(thing: Any) -> Iterator[Any]:
    """All roots of arrays in tuples of them."""
    if isinstance(thing, np.ndarray):
        while isinstance(thing.base, np.ndarray):
            thing = thing.base
        yield thing
    elif isinstance(thing, tuple):
        for part in thing:
            yield from arrays(part)


if __name__ == "__main__":
    main()
