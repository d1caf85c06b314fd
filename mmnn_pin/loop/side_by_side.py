"""Several runs at once on one core: each in one lane of the processor's vectors, with the bits that it has alone.

A control sample of the compiled loop is noted as one list of operations (`noting`), which becomes a function of vectors
of four runs (`vector_code`). It does what the blocks do, in their order, so that nothing is rounded otherwise. Where a
run takes another branch than the one that was noted, a guard tells: then the state goes back to where the piece began,
and the compiled loop makes it, run by run. So the result is that of the compiled loop whatever happens; only how long
it takes depends on how often runs leave the way. Learners that count samples or sweep until something is small leave it
all the time; then the compiled loop goes on alone.

Runs go side by side if their loops differ in numbers only: same blocks, shapes, signals and periods, without a hardware
model. The function is made once for such loops, in a process of its own while the compiled loop goes on, and kept on
disk beside numba's code.
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
from functools import cache, cached_property
from pathlib import Path
from tempfile import TemporaryFile
from threading import Lock
from typing import Any, ClassVar

import llvmlite.binding as llvm
import numba
import numpy as np

from .. import elementary
from ..children import begin_beside, end_if_killed
from ..compiled import cache_folder
from ..signals import Array, IntArray
from .compiled import CompiledLoop
from .vector_code import SYMBOL, vector_code

LANES = 4
PARTS = ("run", "true", "nominal", "learner", "limits", "ahead", "later")  # of an engine, what a sample works on
WAYS = 4  # programs of one form: settings may say which way a sample goes
WARM = 64  # samples before the one that is noted: the first of a run are not like the others
PIECE = 250  # samples at a time
FEW, ENOUGH = 0.2, 10  # of the pieces may leave the way; with more the compiled loop is faster
NOTHING = np.zeros((0, 0))
WORTH = 2_000_000  # samples of a batch, from which on compiling is worth while


class Unlike(Exception):
    """A loop that cannot go side by side with others; never seen outside."""


@dataclass(eq=False)
class Form:
    """What a sample of an engine works on, apart from its numbers.

    Attributes:
        form: Of its parts: tuples by class, integers as they are, arrays and single numbers by their place.
        roots: The arrays whose numbers, one after the other, are the memory; the last has the single numbers.
    """

    form: list[Any]
    roots: list[Array]

    @classmethod
    def of(cls, engine: CompiledLoop) -> Form:
        """The form of an engine.

        Raises:
            Unlike: It has something else in it.
        """
        run = engine.run._replace(setpoints=NOTHING, rows=NOTHING, counter=np.zeros(0, np.int64))
        parts = (run, engine.true, engine.nominal, engine.learner, engine.limits, engine.ahead, engine.later)
        reader = Reader()
        form = [reader.told(part) for part in parts]
        return cls(form, [*reader.roots, np.array(reader.numbers)])

    @cached_property
    def key(self) -> str:
        """The same for engines that can go side by side, and other for others."""
        return hashlib.sha256(json.dumps(self.form).encode()).hexdigest()

    def changed(self, places: IntArray) -> list[tuple[Array, int]]:
        """The arrays with any of some places of the memory in them, and where they begin."""
        ends = np.cumsum([root.size for root in self.roots])
        which = np.unique(np.searchsorted(ends, places, side="right"))
        return [(self.roots[i], int(ends[i]) - self.roots[i].size) for i in which]


class Reader:
    """Reads forms; see `Form`."""

    def __init__(self) -> None:
        self.numbers, self.roots, self.size = list[float](), list[Array](), 0
        self.places: dict[int, int] = {}

    def told(self, thing: Any) -> list[Any]:
        """The form of a part."""
        if isinstance(thing, np.ndarray):
            return self.array(thing)
        if isinstance(thing, tuple):
            kind = type(thing) if hasattr(thing, "_fields") else None
            name = (kind.__module__, kind.__qualname__) if kind else ("", "")
            return ["tuple", *name, [self.told(part) for part in thing]]
        if isinstance(thing, float):
            self.numbers.append(thing)
            return ["number", len(self.numbers) - 1]
        if thing is None or isinstance(thing, int | str):
            return ["plain", thing]
        raise Unlike

    def array(self, thing: np.ndarray[Any, Any]) -> list[Any]:
        """The form of an array, a view of the memory."""
        if thing.dtype.kind in "iub":
            return ["places", thing.dtype.str, thing.shape, thing.ravel().tolist(), thing.flags.writeable]
        whole = thing
        while isinstance(whole.base, np.ndarray):
            whole = whole.base
        if thing.dtype != np.float64 or not (thing.flags.c_contiguous and whole.flags.c_contiguous):
            raise Unlike
        if id(whole) not in self.places:
            self.places[id(whole)] = self.size
            self.roots.append(whole.reshape(-1))
            self.size += whole.size
        within = 0 if thing is whole else (thing.ctypes.data - whole.ctypes.data) // 8
        return ["array", self.places[id(whole)] + within, thing.shape, thing.flags.writeable]


class Lanes:
    """The engines of some runs, stepped together.

    Args:
        engines: As many as there are lanes, at the same sample.
        forms: Theirs, all alike.
        worth: Whether compiling is worth while where there is no code yet.
    """

    def __init__(self, engines: Sequence[Any], forms: Sequence[Form], worth: bool) -> None:
        self.engines, self.forms, self.worth = engines, forms, worth
        self.program: Program | None = None
        self.waits = True  # for its program
        self.alive = aligned((LANES,), np.int64)
        self.alive[:] = -1

    def advance(self, first: int, last: int) -> list[int]:
        """Samples first ... last - 1 of all runs that have not ended; for each what `CompiledLoop.advance` gives.

        Their engines' states are those of `last` after `put_back`.
        """
        answers, k = [-1] * LANES, first
        while k < last and self.alive.any():
            if self.waits:
                self.begin(k)
            piece = WARM - k if k < WARM else PIECE
            count = min(piece if self.waits or self.program is not None else last - k, last - k)
            done = self.program is not None and self.together(k, count, k - first)
            if not done:
                self.one_by_one(k, count, k - first, answers)
            k += count
        for lane in self.living():
            self.engines[lane].counter[0] = last - first
        return answers

    def living(self) -> list[int]:
        """The lanes of runs that have not ended."""
        return [int(lane) for lane in np.flatnonzero(self.alive)]

    def begin(self, sample: int) -> None:
        """Take up the program, if there is one for these engines; what makes it is begun with the second piece."""
        self.program = Program.of(self.engines[0], self.forms[0], sample, self.worth)
        self.waits = self.worth and self.program is None
        if self.program is not None:
            width = sum(root.size for root in self.forms[0].roots)
            self.memory, self.before = aligned((width, LANES)), aligned((width, LANES))
            self.slots = aligned((self.program.slots, LANES))
            self.setpoints = aligned((PIECE + 1, self.engines[0].run.setpoints.shape[1], LANES))
            self.rows = np.zeros(LANES, np.int64)
            self.changed = [form.changed(self.program.written) for form in self.forms]
            self.read()

    def together(self, first: int, count: int, at: int) -> bool:
        """Samples of all runs, their rows from place `at` on; False, and nothing done, where one leaves the way."""
        assert self.program is not None
        np.copyto(self.before, self.memory)
        for lane, engine in enumerate(self.engines):
            self.setpoints[0, :, lane] = engine.run.setpoints[max(first - 1, 0)]
            self.setpoints[1 : count + 1, :, lane] = engine.run.setpoints[first : first + count]
            self.rows[lane] = engine.rows.ctypes.data + at * engine.rows.strides[0]
        arrays = (self.memory, self.slots, self.setpoints, self.rows, self.alive)
        places = (array.ctypes.data for array in arrays)
        self.program.pieces += 1
        if self.program.advance(*places, first, count, self.engines[0].run.numbers.h) == count:
            return True
        np.copyto(self.memory, self.before)
        self.put_back()
        self.program.left += 1
        return False

    def one_by_one(self, first: int, count: int, at: int, answers: list[int]) -> None:
        """The same by the compiled loop."""
        for lane in self.living():
            answers[lane] = self.engines[lane].advance(first, first + count, at)
            if answers[lane] != -1:
                self.alive[lane] = 0
        if self.program is not None:
            self.read()

    def read(self) -> None:
        """Take the numbers out of the engines; without a program from here on where a run goes another way for good."""
        assert self.program is not None
        for lane, form in enumerate(self.forms):
            self.memory[:, lane] = np.concatenate(form.roots)
        others = self.program.prepare(self.memory.ctypes.data, self.slots.ctypes.data)
        if self.program.is_left_often or any(others >> lane & 1 for lane in self.living()):
            self.program = None

    def put_back(self) -> None:
        """Put them back into the engines of the runs that have not ended; without a program they are there."""
        for lane in self.living() if self.program is not None else ():
            for root, first in self.changed[lane]:
                root[:] = self.memory[first : first + root.size, lane]


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
    room: np.ndarray[Any, Any] = np.zeros(size + 8, kind)
    first = -room.ctypes.data // 8 % 8
    return room[first : first + size].reshape(shape)


class Program:
    """A sample of several runs, compiled.

    Args:
        file: Where it is kept.
    """

    lock = Lock()
    made: ClassVar[list[tuple[list[Any], int, Program]]] = []  # with their forms and ways
    asked: ClassVar[dict[Path, subprocess.Popen[bytes]]] = {}

    def __init__(self, file: Path) -> None:
        about, _, code = file.read_bytes().partition(b"\n")
        told = json.loads(about)
        self.slots, self.written = told["slots"], np.array(told["written"], np.int64)
        self.engine = loaded(code, told["calls"])
        self.pieces = self.left = 0
        pointer, integer = ctypes.c_void_p, ctypes.c_int64
        prepare, advance = (self.engine.get_function_address(name) for name in ("prepare", "advance"))
        self.prepare = ctypes.CFUNCTYPE(integer, pointer, pointer)(prepare)
        self.advance = ctypes.CFUNCTYPE(integer, *[pointer] * 5, integer, integer, ctypes.c_double)(advance)

    @classmethod
    def of(cls, engine: CompiledLoop, form: Form, sample: int, worth: bool) -> Program | None:
        """The program for an engine, None where there is none yet, or can be none.

        Args:
            engine: Where it is after some samples.
            form: Its form.
            sample: The number of its next sample, which is noted if there is no program: a process of its own makes it
                meanwhile.
            worth: Whether to begin that.
        """
        with cls.lock:
            for way in range(WAYS):
                if (program := cls.kept(form, way)) is None:
                    file = file_of(form, way)
                    if worth and sample >= WARM and file is not None and not (file.exists() or file in cls.asked):
                        cls.asked[file] = ask_for(file, engine, form, sample)
                    return None
                if program.fits(form):
                    return None if program.is_left_often else program
            return None

    @classmethod
    def kept(cls, form: Form, way: int) -> Program | None:
        """The program of a form that was noted on one way, from this process or the disk; None where there is none."""
        for known, at, program in cls.made:
            if at == way and known == form.form:
                return program
        file = file_of(form, way)
        if file is None or not file.exists() or file.stat().st_size == 0:  # an empty one cannot be noted
            return None
        cls.made.append((form.form, way, cls(file)))
        return cls.made[-1][2]

    @property
    def is_left_often(self) -> bool:
        """Whether runs leave its way so often that the compiled loop is faster."""
        return self.pieces >= ENOUGH and self.left > FEW * self.pieces

    def fits(self, form: Form) -> bool:
        """Whether it was noted on the way that an engine goes by its settings."""
        memory, slots = aligned((sum(root.size for root in form.roots), LANES)), aligned((self.slots, LANES))
        memory[:] = np.concatenate(form.roots)[:, None]
        return bool(self.prepare(memory.ctypes.data, slots.ctypes.data) == 0)


def file_of(form: Form, way: int) -> Path | None:
    """Where the program of a form that was noted on one way is kept; None where nothing can be."""
    folder = cache_folder()
    key = f"{form.key} {way} {sources()} {host_cpu()} {llvm.llvm_version_info} {platform.machine()} {LANES}"
    return None if folder is None else folder / f"side_by_side.{hashlib.sha256(key.encode()).hexdigest()[:24]}"


@cache
def sources() -> str:
    """Of the code that makes code; the folder is of the blocks' sources only."""
    files = (Path(__file__).with_name(name) for name in ("noting.py", "side_by_side.py", "vector_code.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def ask_for(file: Path, engine: CompiledLoop, form: Form, sample: int) -> subprocess.Popen[bytes]:
    """Begin to make the program of an engine's next sample, in a process of its own; see `main`."""
    told = {
        "parts": PARTS,
        "form": form.form,
        "values": np.concatenate(form.roots).tolist(),
        "numbers": sum(root.size for root in form.roots[:-1]),
        "setpoints": engine.run.setpoints[sample - 1 : sample + 1].tolist(),
        "time": sample * engine.run.numbers.h,
    }
    with TemporaryFile() as read:
        read.write(json.dumps(told).encode())
        read.seek(0)
        return begin_beside(__name__, str(file), read=read, more={"NUMBA_DISABLE_JIT": "1"})


def main() -> None:
    """Note a sample that standard input tells of and compile it into the file named; an empty one if that cannot be."""
    from .noting import NotNoted, sample

    end_if_killed(int(sys.argv[1]))
    file = Path(sys.argv[2])
    try:
        told = sample(json.load(sys.stdin))
    except (NotNoted, TypeError, ValueError, ArithmeticError, AttributeError):
        content = b""
    else:
        slots, text = vector_code(told, LANES)
        calls = sorted({op[1] for op in told["ops"] if op[0] == "call"})
        about = {"slots": slots, "written": sorted(map(int, told["written"])), "calls": calls}
        content = json.dumps(about).encode() + b"\n" + bytes(machine().emit_object(llvm.parse_assembly(text)))
    draft = file.with_name(f"{file.name}.{os.getpid()}")
    draft.write_bytes(content)
    draft.replace(file)


def ready(loop: Any) -> bool:
    """Make the program of a loop, if there is none yet, and wait for it; whether there is one."""
    engine = loop.engine_at()
    if (forms := forms_of([engine] * LANES)) is None:
        return False
    for sample in range(WARM):
        engine.advance(sample, sample + 1)
    while Program.of(engine, forms[0], WARM, True) is None:
        running = [process for process in Program.asked.values() if process.poll() is None]
        if not running:
            return Program.of(engine, forms[0], WARM, False) is not None
        for process in running:
            process.wait()
    return True


def host_cpu() -> tuple[str, str]:
    """Name and features of the processor that code is made for, as numba has them."""
    config: Any = numba.config
    name, features = config.CPU_NAME, config.CPU_FEATURES
    return name or llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten() if features is None else features


def machine(optimisation: int = 2) -> Any:
    """What makes code for it; at 0 it is made fast, and no fast code."""
    name, features = host_cpu()
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(cpu=name, features=features, opt=optimisation, jit=True)


def loaded(code: bytes, calls: Sequence[str]) -> Any:
    """The engine that holds compiled code, which calls some elementary functions."""
    for name in calls:
        llvm.add_symbol(SYMBOL + name, callback(name).address)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


@cache
def callback(name: str) -> Any:
    """An elementary function of doubles for code that is not numba's."""
    function = getattr(elementary, name)
    if name in ("atan2", "hypot", "pow"):
        return numba.cfunc("float64(float64, float64)", error_model="numpy")(lambda x, y: function(x, y))
    return numba.cfunc("float64(float64)", error_model="numpy")(lambda x: function(x))


if __name__ == "__main__":
    main()
