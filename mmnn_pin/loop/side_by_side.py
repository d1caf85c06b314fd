"""Several runs at once on one core: each in one lane of the processor's vectors, with the bits that it has alone.

A control sample of the compiled loop is noted as one list of operations (`noting`), which becomes a function of vectors
of four runs. It does what the blocks do, in their order, so that nothing is rounded otherwise. Where a run takes another
branch than the one that was noted, a guard tells: then the state goes back to where the piece began, and the compiled
loop makes it, run by run. So the result is that of the compiled loop whatever happens; only how long it takes depends on
how often the runs leave the way.

Runs go side by side if their loops differ in numbers only: same blocks, shapes, signals and periods. The function is
made once for such loops, and kept on disk beside numba's code.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np

from .. import elementary
from ..compiled import cache_folder
from ..errors import InputError
from ..signals import Array
from .compiled import CompiledLoop
from .vector_code import SYMBOL, vector_code

LANES = 4
PARTS = ("run", "true", "nominal", "learner", "limits", "ahead", "later")  # of an engine, what a sample works on
WARM = 64  # samples before the one that is noted: the first of a run are not like the others
PIECE = 200  # samples at a time
FEW, ENOUGH = 0.2, 10  # of the pieces may leave the way; with more the compiled loop is faster
WORTH = 2_000_000  # samples of a batch, from which on compiling is worth while


class Unlike(Exception):
    """A loop that cannot go side by side with others; never seen outside."""


@dataclass(frozen=True, eq=False)
class Form:
    """What a sample of an engine works on, apart from its numbers.

    Attributes:
        form: Of its parts: tuples by class, integers as they are, arrays and numbers by their place in the memory.
        roots: The arrays whose numbers, one after the other, are the memory; the first has the single numbers.
    """

    form: list[Any]
    roots: list[Array]

    @classmethod
    def of(cls, engine: CompiledLoop) -> Form:
        """The form of an engine.

        Raises:
            Unlike: It has something else in it.
        """
        run = engine.run._replace(setpoints=np.zeros((0, 0)), rows=np.zeros((0, 0)))
        parts = (run, engine.true, engine.nominal, engine.learner, engine.limits, engine.ahead, engine.later)
        numbers, roots, places = list[float](), list[Array](), dict[int, int]()

        def told(thing: Any) -> list[Any]:
            if isinstance(thing, float):
                numbers.append(thing)
                return ["number", len(numbers) - 1]
            if isinstance(thing, np.ndarray):
                return array(thing)
            if isinstance(thing, tuple):
                kind = type(thing) if hasattr(thing, "_fields") else None
                return ["tuple", *((kind.__module__, kind.__qualname__) if kind else ("", "")), list(map(told, thing))]
            if thing is None or isinstance(thing, int | str):
                return ["plain", thing]
            raise Unlike

        def array(thing: np.ndarray[Any, Any]) -> list[Any]:
            if thing.dtype.kind in "iub":
                return ["places", thing.dtype.str, thing.shape, thing.ravel().tolist()]
            whole = thing
            while isinstance(whole.base, np.ndarray):
                whole = whole.base
            if thing.dtype != np.float64 or not (thing.flags.c_contiguous and whole.flags.c_contiguous):
                raise Unlike
            if (at := whole.ctypes.data) not in places:
                places[at] = sum(root.size for root in roots)
                roots.append(whole.reshape(-1))
            return ["array", places[at] + (thing.ctypes.data - at) // 8, thing.shape]

        form = list(map(told, parts))
        return cls(moved(form, len(numbers)), [np.array(numbers), *roots])

    @property
    def key(self) -> str:
        """The same for engines that can go side by side, and other for others."""
        return hashlib.sha256(json.dumps(self.form).encode()).hexdigest()

    def write(self, values: Array) -> None:
        """Back into the engine, all but the single numbers, which do not change."""
        first = self.roots[0].size
        for root in self.roots[1:]:
            root[:] = values[first : first + root.size]
            first += root.size


def moved(form: Any, by: int) -> Any:
    """A form whose arrays stand behind the single numbers."""
    if isinstance(form, list):
        if form[:1] == ["array"]:
            return ["array", form[1] + by, form[2]]
        return [moved(part, by) for part in form]
    return form


class Lanes:
    """The engines of some runs, stepped together.

    Args:
        engines: As many as there are lanes, at the same sample.
        worth: Whether compiling is worth while where there is no code yet.
    """

    def __init__(self, engines: Sequence[CompiledLoop], worth: bool) -> None:
        self.engines, self.worth = engines, worth
        self.forms = forms_of(engines)
        self.program: Program | None = None
        self.waits = self.forms is not None  # for its program
        self.alive = aligned((LANES,), np.int64)
        self.alive[:] = -1
        self.pieces = self.left = 0

    def advance(self, first: int, last: int) -> list[int]:
        """Samples first ... last - 1 of all runs that have not ended; for each what `CompiledLoop.advance` gives."""
        answers, k = [-1] * LANES, first
        while k < last and self.alive.any():
            if self.waits and k >= WARM:
                self.begin(k)
            if self.program is not None:
                count = min(PIECE, last - k)
                done = self.together(k, count, k - first)
            else:
                count, done = (min(WARM, last) if self.waits else last) - k, False
            if not done:
                self.one_by_one(k, count, k - first, answers)
            k += count
        if self.program is not None:
            self.write()
        for lane in self.living():
            self.engines[lane].counter[0] = last - first
        return answers

    def living(self) -> list[int]:
        """The lanes of runs that have not ended."""
        return [int(lane) for lane in np.flatnonzero(self.alive)]

    def begin(self, sample: int) -> None:
        """Take up the program, if there is one for these engines."""
        assert self.forms is not None
        self.waits, width = False, sum(root.size for root in self.forms[0].roots)
        self.program = Program.of(self.engines[0], self.forms[0], sample, self.worth)
        if self.program is not None:
            self.memory, self.before = aligned((width, LANES)), aligned((width, LANES))
            self.slots = aligned((self.program.slots, LANES))
            self.setpoints = aligned((PIECE + 1, self.engines[0].run.setpoints.shape[1], LANES))
            self.rows = np.zeros(LANES, np.int64)
            self.read()

    def together(self, first: int, count: int, at: int) -> bool:
        """Samples of all runs, their rows from place `at` on; False, and nothing done, where one leaves the way."""
        assert self.program is not None
        np.copyto(self.before, self.memory)
        for lane, engine in enumerate(self.engines):
            self.setpoints[: count + 1, :, lane] = engine.run.setpoints[first - 1 : first + count]
            self.rows[lane] = engine.rows.ctypes.data + at * engine.rows.strides[0]
        arrays = (self.memory, self.slots, self.setpoints, self.rows, self.alive)
        places = (array.ctypes.data for array in arrays)
        self.pieces += 1
        if self.program.advance(*places, first, count, self.engines[0].run.numbers.h) == count:
            return True
        np.copyto(self.memory, self.before)
        self.write()
        self.left += 1
        return False

    def one_by_one(self, first: int, count: int, at: int, answers: list[int]) -> None:
        """The same by the compiled loop."""
        for lane in self.living():
            answers[lane] = self.engines[lane].advance(first, first + count, at)
            if answers[lane] != -1:
                self.alive[lane] = 0
        if self.pieces >= ENOUGH and self.left > FEW * self.pieces:
            self.program = None
        elif self.program is not None:
            self.read()

    def read(self) -> None:
        """Take the numbers out of the engines; without a program from here on where a run goes another way for good."""
        assert self.forms is not None and self.program is not None
        for lane, form in enumerate(self.forms):
            self.memory[:, lane] = np.concatenate(form.roots)
        others = self.program.prepare(self.memory.ctypes.data, self.slots.ctypes.data)
        if any(others >> lane & 1 for lane in self.living()):
            self.program = None

    def write(self) -> None:
        """Put them back into the engines of the runs that have not ended."""
        assert self.forms is not None
        for lane in self.living():
            self.forms[lane].write(self.memory[:, lane])


def forms_of(engines: Sequence[Any]) -> list[Form] | None:
    """The forms of engines that can go side by side; None where they cannot."""
    if len(engines) != LANES or not all(isinstance(engine, CompiledLoop) for engine in engines):
        return None
    first = engines[0].run.numbers
    if first.age > 0.0 or first.per_measurement != first.steps:
        return None
    if any(engine.hardware is not None or engine.run.numbers.h != first.h for engine in engines):
        return None
    try:
        forms = [Form.of(engine) for engine in engines]
    except Unlike:
        return None
    return forms if all(form.form == forms[0].form for form in forms) else None


def aligned(shape: tuple[int, ...], kind: type = np.float64) -> np.ndarray[Any, Any]:
    """An array of eight-byte numbers whose vectors may be loaded as wholes."""
    size = int(np.prod(shape))
    room = np.zeros(size + 8, kind)
    first = -room.ctypes.data // 8 % 8
    return room[first : first + size].reshape(shape)


class Program:
    """A sample of several runs, compiled.

    Args:
        text: Its code.
        cached: What was compiled of it; None if nothing.
    """

    lock = Lock()
    made: dict[str, Program | None] = {}

    def __init__(self, text: str, cached: bytes | None) -> None:
        self.engine, self.code = compiled_text(text, cached)
        prepare, step = (self.engine.get_function_address(name) for name in ("prepare", "advance"))
        pointer, integer = ctypes.c_void_p, ctypes.c_int64
        self.prepare = ctypes.CFUNCTYPE(integer, pointer, pointer)(prepare)
        self.advance = ctypes.CFUNCTYPE(integer, *[pointer] * 5, integer, integer, ctypes.c_double)(step)
        self.slots = int(text.partition("\n")[0].split()[-1])

    @classmethod
    def of(cls, engine: CompiledLoop, form: Form, sample: int, worth: bool) -> Program | None:
        """The program for an engine, noted at its next sample; None where there can be none, or it is not worth while."""
        with cls.lock:
            if form.key not in cls.made:
                made = program(engine, form, sample, worth)
                if made is None and not worth:
                    return None
                cls.made[form.key] = made
            return cls.made[form.key]


def program(engine: CompiledLoop, form: Form, sample: int, worth: bool) -> Program | None:
    """The program from the disk, or else noted and compiled."""
    folder, cpu = cache_folder(), f"{host_cpu()} {llvm.llvm_version_info} {platform.machine()} {LANES}"
    name = hashlib.sha256(f"{form.key} {cpu} {sources()}".encode()).hexdigest()[:24]
    file = None if folder is None else folder / f"side_by_side.{name}"
    if file is not None and file.exists():
        text, _, code = file.read_bytes().partition(b"\0")
        return Program(text.decode(), code) if text else None
    if not worth:
        return None
    told = noted(engine, form, sample)
    text = vector_code(told, LANES) if told else ""
    result = Program(text, None) if told else None
    if file is not None:
        draft = file.with_name(f"{file.name}.{os.getpid()}")
        draft.write_bytes(text.encode() + b"\0" + (result.code if result else b""))
        draft.replace(file)
    return result


@cache
def sources() -> str:
    """Of the code that makes code; the folder is of the blocks' sources only."""
    files = (Path(__file__).with_name(name) for name in ("noting.py", "side_by_side.py", "vector_code.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def noted(engine: CompiledLoop, form: Form, sample: int) -> dict[str, Any]:
    """What `noting` says of the engine's next sample, in a process of its own; empty where it cannot be noted."""
    values = np.concatenate(form.roots)
    told = {
        "parts": PARTS,
        "form": form.form,
        "values": values.tolist(),
        "setpoints": engine.run.setpoints[sample - 1 : sample + 1].tolist(),
        "time": sample * engine.run.numbers.h,
    }
    plain = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-m", "mmnn_pin.loop.noting"]
    done = subprocess.run(command, input=json.dumps(told), capture_output=True, text=True, env=plain, check=False)
    return dict(json.loads(done.stdout)) if done.returncode == 0 else {}


def host_cpu() -> tuple[str, str]:
    """Name and features of the processor that code is made for, as numba has them."""
    name, features = numba.config.CPU_NAME, numba.config.CPU_FEATURES
    host = llvm.get_host_cpu_features().flatten() if features is None else features
    return name or llvm.get_host_cpu_name(), host


def compiled_text(text: str, cached: bytes | None) -> tuple[Any, bytes]:
    """The engine that holds the code of a text, and the code as it is kept."""
    for name in set(elementary.__all__) - {"cos_sin", "sigmoids"}:
        llvm.add_symbol(SYMBOL + name, address_of(name))
    name, features = host_cpu()
    machine = llvm.Target.from_default_triple().create_target_machine(cpu=name, features=features, opt=2, jit=True)
    kept = [cached or b""]
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly("" if cached else text), machine)
    if cached:
        engine.add_object_file(llvm.ObjectFileRef.from_data(cached))
    else:
        engine.set_object_cache(notify_func=lambda _, code: kept.__setitem__(0, code))
    engine.finalize_object()
    return engine, kept[0]


def address_of(name: str) -> int:
    """Where compiled code finds an elementary function of doubles."""
    if name not in FUNCTIONS:
        function = getattr(elementary, name)
        if name in ("atan2", "hypot", "pow"):
            made = numba.cfunc("float64(float64, float64)", error_model="numpy")(lambda x, y: function(x, y))
        else:
            made = numba.cfunc("float64(float64)", error_model="numpy")(lambda x: function(x))
        FUNCTIONS[name] = made
    return int(FUNCTIONS[name].address)


FUNCTIONS: dict[str, Any] = {}
