"""What a control sample does, noted: the compiled loop's own functions, run once on numbers that remember.

`side_by_side` steps several runs at once, one in each lane of the processor's vectors. For that it needs a sample as
one list of sums, products, roots and comparisons, and there is only one place that says what a sample is: the blocks.
So they are run as plain Python (`NUMBA_DISABLE_JIT=1`, a process of its own) on numbers that note what is done to them.

A branch that depends on a number becomes a *guard*: the list is right for all states that go the same way, and says of
any other that it is not. An elementary function is noted as a call, so its branches are its own.

    ops        [code, ...] by number; operands are numbers of operations before
    guards     [comparison, a, b, outcome]
    written    {place in memory: operation} for every number that the sample changes
    row, width, setpoints   where the row of signals stands in the memory, and how many numbers row and setpoint have
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from .. import elementary
from ..elementary import bits
from ..parts import view
from ..signals import INDEX

MOST = 60_000  # operations: more take longer to compile than they ever gain
CALLED = {name: getattr(elementary, name) for name in elementary.__all__ if name not in ("cos_sin", "sigmoids")}


class NotNoted(Exception):
    """A sample cannot be noted, or is too long."""


class Notes:
    """Operations, each noted once, and guards.

    Args:
        most: How many operations there may be.
    """

    def __init__(self, most: int = MOST) -> None:
        self.most = most
        self.ops: list[tuple[Any, ...]] = []
        self.numbers: dict[tuple[Any, ...], int] = {}
        self.guards: dict[tuple[str, int, int, bool], None] = {}

    def op(self, *what: Any) -> int:
        """The number of an operation, noted if it is new."""
        if what not in self.numbers:
            if len(self.ops) >= self.most:
                raise NotNoted
            self.numbers[what] = len(self.ops)
            self.ops.append(what)
        return self.numbers[what]

    def of(self, value: Any) -> int:
        """The number of a value, a constant if it is not noted."""
        if isinstance(value, Noted):
            return value.number
        number = float(value)
        return self.op("const", number.hex() if math.isfinite(number) else str(number))


class Noted:
    """A number that notes what is done with it; its value is that of the state at hand."""

    notes: ClassVar[Notes]

    def __init__(self, value: float, number: int) -> None:
        self.value, self.number = value, number

    def make(self, value: float, code: str, *operands: Any) -> Noted:
        """The result of an operation."""
        return Noted(value, self.notes.op(code, *map(self.notes.of, operands)))

    def compare(self, outcome: bool, code: str, other: Any) -> bool:
        """The outcome of a comparison, which becomes a guard."""
        self.notes.guards[code, self.number, self.notes.of(other), outcome] = None
        return outcome

    def __add__(self, other: Any) -> Noted:
        return self.make(self.value + plain(other), "fadd", self, other)

    def __radd__(self, other: Any) -> Noted:
        return self.make(plain(other) + self.value, "fadd", other, self)

    def __sub__(self, other: Any) -> Noted:
        return self.make(self.value - plain(other), "fsub", self, other)

    def __rsub__(self, other: Any) -> Noted:
        return self.make(plain(other) - self.value, "fsub", other, self)

    def __mul__(self, other: Any) -> Noted:
        return self.make(self.value * plain(other), "fmul", self, other)

    def __rmul__(self, other: Any) -> Noted:
        return self.make(plain(other) * self.value, "fmul", other, self)

    def __truediv__(self, other: Any) -> Noted:
        return self.make(divided(self.value, plain(other)), "fdiv", self, other)

    def __rtruediv__(self, other: Any) -> Noted:
        return self.make(divided(plain(other), self.value), "fdiv", other, self)

    def __mod__(self, other: float) -> Noted:
        if 0.0 <= self < other:
            return self
        if other <= self < 2.0 * other:
            return self - other
        if -other < self < 0.0:
            return self + other
        raise NotNoted

    def __neg__(self) -> Noted:
        return self.make(-self.value, "fneg", self)

    def __abs__(self) -> Noted:
        return self.make(abs(self.value), "fabs", self)

    def __lt__(self, other: Any) -> bool:
        return self.compare(self.value < plain(other), "olt", other)

    def __le__(self, other: Any) -> bool:
        return self.compare(self.value <= plain(other), "ole", other)

    def __gt__(self, other: Any) -> bool:
        return self.compare(self.value > plain(other), "ogt", other)

    def __ge__(self, other: Any) -> bool:
        return self.compare(self.value >= plain(other), "oge", other)

    def __eq__(self, other: object) -> bool:
        return self.compare(self.value == plain(other), "oeq", other)

    def __ne__(self, other: object) -> bool:
        return self.compare(self.value != plain(other), "une", other)

    def __int__(self) -> int:
        self.compare(True, "oeq", float(int(self.value)))
        return int(self.value)

    def __float__(self) -> float:
        raise NotNoted

    __hash__ = None  # type: ignore[assignment]


class Bits:
    """The bits of a noted number, of which a power of two is made."""

    def __init__(self, value: int, number: int) -> None:
        self.value, self.number = value, number

    def make(self, value: int, code: str, other: int) -> Bits:
        """The result of an operation with a constant."""
        return Bits(value, Noted.notes.op(code, self.number, other))

    def __sub__(self, other: int) -> Bits:
        return self.make(self.value - other, "add", -other)

    def __add__(self, other: int) -> Bits:
        return self.make(self.value + other, "add", other)

    def __lshift__(self, other: int) -> Bits:
        shifted = (self.value << other) & 0xFFFFFFFFFFFFFFFF
        return self.make(shifted - (1 << 64) if shifted >> 63 else shifted, "shl", other)


def plain(x: Any) -> float:
    """The value of a number, noted or not."""
    return x.value if isinstance(x, Noted) else float(x)


def divided(a: float, b: float) -> float:
    """`a / b` as IEEE 754 has it."""
    with np.errstate(all="ignore"):
        return float(np.float64(a) / np.float64(b))


def called(function: Callable[..., float], name: str) -> Callable[..., Any]:
    """An elementary function that notes its call."""

    def call(*arguments: Any) -> Any:
        if not any(isinstance(x, Noted) for x in arguments):
            return function(*arguments)
        notes = Noted.notes
        return Noted(function(*map(plain, arguments)), notes.op("call", name, *map(notes.of, arguments)))

    return call


def root(x: Any, sqrt: Callable[[float], float] = math.sqrt) -> Any:
    """`math.sqrt`."""
    return x.make(sqrt(x.value), "sqrt", x) if isinstance(x, Noted) else sqrt(x)


def is_finite(x: Any, isfinite: Callable[[Any], Any] = np.isfinite) -> Any:
    """`np.isfinite`, `math.isfinite`."""
    return abs(x) < math.inf if isinstance(x, Noted) else isfinite(x)


def is_nan(x: Any, isnan: Callable[[float], bool] = math.isnan) -> bool:
    """`math.isnan`."""
    return x != x if isinstance(x, Noted) else isnan(x)


def bits_of(x: Any, plain_bits: Callable[[float], int] = bits.bits_of) -> Any:
    """`elementary.bits.bits_of`."""
    return Bits(plain_bits(x.value), Noted.notes.op("bits", x.number)) if isinstance(x, Noted) else plain_bits(x)


def from_bits(x: Any, plain_number: Callable[[int], float] = bits.from_bits) -> Any:
    """`elementary.bits.from_bits`."""
    return Noted(plain_number(x.value), Noted.notes.op("double", x.number)) if isinstance(x, Bits) else plain_number(x)


@contextmanager
def noting(notes: Notes) -> Iterator[None]:
    """Within it elementary functions note their calls."""
    Noted.notes = notes
    instead: dict[Any, Any] = {function: called(function, name) for name, function in CALLED.items()}
    cos, sin = instead[elementary.cos], instead[elementary.sin]
    instead |= {elementary.cos_sin: lambda x: (cos(x), sin(x)), bits.bits_of: bits_of, bits.from_bits: from_bits}
    modules = [module for name, module in sys.modules.items() if name.startswith(__package__.partition(".")[0])]
    before: list[tuple[Any, str, Any]] = [(math, "sqrt", root), (math, "isnan", is_nan)]
    before += [(module, "isfinite", is_finite) for module in (math, np)]
    before += [
        (module, name, instead[thing])
        for module in modules
        if module is not sys.modules[__name__]
        for name, thing in list(vars(module).items())
        if callable(thing) and getattr(thing, "__hash__", None) and thing in instead
    ]
    kept = [(module, name, getattr(module, name)) for module, name, _ in before]
    for module, name, thing in before:
        setattr(module, name, thing)
    try:
        yield
    finally:
        for module, name, thing in kept:
            setattr(module, name, thing)


def rebuilt(form: Any, memory: Any, numbers: int) -> Any:
    """What a form tells of, its numbers those of the memory, an array of noted ones; single ones behind `numbers`."""
    kind, *rest = form
    if kind == "array":
        first, shape, writeable = rest
        made = memory[first : first + math.prod(shape)].reshape(shape)
        made.flags.writeable = writeable
        return made
    if kind == "number":
        return memory[numbers + rest[0]]
    if kind == "places":
        made = np.array(rest[2], rest[0]).reshape(rest[1])
        made.flags.writeable = rest[3]
        return made
    if kind == "tuple":
        module, name, parts = rest
        things = [rebuilt(part, memory, numbers) for part in parts]
        return getattr(import_module(module), name)(*things) if name else tuple(things)
    return rest[0]


def noted(values: Any, notes: Notes) -> Any:
    """Memory whose numbers are noted."""
    memory = np.empty(len(values), object)
    memory[:] = [Noted(x, notes.op("state", i)) for i, x in enumerate(values)]
    return memory


def written(memory: Any, notes: Notes) -> dict[int, int]:
    """The operations of the numbers in memory that were changed, by their places."""
    changed = (
        (i, x) for i, x in enumerate(memory) if not (isinstance(x, Noted) and notes.ops[x.number] == ("state", i))
    )
    return {i: notes.of(x) for i, x in changed}


def call(function: Any, form: Any, values: Any, numbers: int, most: int = MOST) -> dict[str, Any]:
    """The notes of a call.

    Args:
        function: What is called.
        form: Of its arguments.
        values: Of its memory, single numbers from place `numbers` on; the last one is for what it returns.
        numbers: That place.
        most: How many operations there may be.

    Returns:
        What `sample` does but for the rows; `answer` holds what it returned, None for a number, which is written.

    Raises:
        NotNoted: It cannot be noted.
    """
    notes = Notes(most)
    memory = noted(values, notes)
    arguments = [rebuilt(one, memory, numbers) for one in form]
    with noting(notes), np.errstate(all="ignore"):
        answer = function(*arguments)
    if isinstance(answer, Noted):
        memory[len(memory) - 1] = answer
    elif answer is not None and not isinstance(answer, int):
        raise NotNoted
    given = None if isinstance(answer, Noted) else (answer,)
    return {"ops": notes.ops, "guards": list(notes.guards), "written": written(memory, notes), "answer": given}


def sample(told: dict[str, Any]) -> dict[str, Any]:
    """The notes of one control sample.

    Args:
        told: `form` of the engine's `parts`, `values` of its memory, single ones from place `numbers` on, `setpoints`
            (2, m) of the sample before and of this one, `time` [s].

    Raises:
        NotNoted: It cannot be noted.
    """
    from .compiled import control, measure, move, observe

    notes = Notes()
    memory, names = noted(told["values"], notes), told["parts"]
    setpoints = np.empty(np.shape(told["setpoints"]), object)
    for (i, j), x in np.ndenumerate(np.array(told["setpoints"])):
        setpoints[i, j] = Noted(float(x), notes.op("setpoint", i, j))
    time: Any = Noted(told["time"], notes.op("time"))
    part = dict(zip(names, (rebuilt(form, memory, told["numbers"]) for form in told["form"]), strict=True))
    run, true = part["run"]._replace(setpoints=setpoints), part["true"]
    with noting(notes), np.errstate(all="ignore"):
        measure(0, time, run, true, None)
        learner, limits, ahead, later = (part[name] for name in ("learner", "limits", "ahead", "later"))
        control(1, time, run, part["nominal"], None, learner, limits, ahead, later, None)
        bad = observe(run, true.body, true, run.numbers.start_energy)
        for i in range(run.numbers.steps):
            move(run.numbers, i, true.body, true, view(run.row, run.at, INDEX["torque"]))
    if bad >= 0:
        raise NotNoted
    return {
        "ops": notes.ops,
        "guards": list(notes.guards),
        "written": written(memory, notes),
        "row": (run.row.ctypes.data - memory.ctypes.data) // memory.itemsize,
        "width": run.row.size,
        "setpoints": setpoints.shape[1],
    }
