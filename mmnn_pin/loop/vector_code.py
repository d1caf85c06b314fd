"""What `noting` has noted of a sample as LLVM code for several runs side by side, a vector of doubles for every number.

The memory holds every number of all runs next to each other. What follows from numbers that no sample changes, settings
and what is computed from them, is computed once (`prepare`) and kept in *slots*. `advance` makes samples until one of
them leaves the way that was noted:

    prepare(memory, slots)                                          bits of the runs that go another way from the start
    advance(memory, slots, setpoints, rows, alive, first, count, h)     how many samples were right

with the setpoints (count + 1, m, lanes) from the sample before `first` on, one place per run for its rows (count,
width), and alive (lanes,) -1 for the runs whose guards count, 0 for others.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

SYMBOL = "mmnn_pin.elementary."
NEAR = 150  # operations for which a number that was loaded is kept
INTEGERS = ("bits", "add", "shl")  # operations whose results are integers
LEAVES = ("state", "setpoint", "time", "const")


def vector_code(told: dict[str, Any], lanes: int) -> tuple[int, str]:
    """How many slots there are, and the code.

    Args:
        told: What `noting.sample` gives.
        lanes: Runs side by side.
    """
    code = VectorCode(told, lanes)
    prepare, advance = code.prepare(), code.advance()
    return max(len(code.slots), 1), "\n".join((*code.declarations(), *prepare, *advance, ""))


class VectorCode:
    """The code of one sample.

    Args:
        told: What `noting.sample` gives.
        lanes: Runs side by side.
    """

    def __init__(self, told: dict[str, Any], lanes: int) -> None:
        self.ops, self.guards = told["ops"], told["guards"]
        self.written = {int(place): op for place, op in told["written"].items()}
        self.row, self.width, self.setpoints = told["row"], told["width"], told["setpoints"]
        self.lanes, self.vector, self.integers = lanes, f"<{lanes} x double>", f"<{lanes} x i64>"
        self.fixed = self.find_fixed()
        self.needed = self.find_needed()
        self.slots: dict[int, int] = {}
        self.lines: list[str] = []
        self.names: dict[int, tuple[str, int]] = {}
        self.bad: list[str] = []
        self.reads_slots = False

    def operands(self, op: int) -> list[int]:
        """The operations that an operation needs."""
        return operands(self.ops[op])

    def find_fixed(self) -> list[bool]:
        """Which operations follow from what no sample changes."""
        fixed: list[bool] = []
        for op, (code, *rest) in enumerate(self.ops):
            leaf = code == "const" or (code == "state" and rest[0] not in self.written)
            fixed.append(leaf if code in LEAVES else all(fixed[a] for a in self.operands(op)))
        return fixed

    def find_needed(self) -> set[int]:
        """Operations that something comes of."""
        waiting = [*self.written.values(), *(a for _, *pair, _ in self.guards for a in pair)]
        needed: set[int] = set()
        while waiting:
            op = waiting.pop()
            if op not in needed:
                needed.add(op)
                waiting += self.operands(op)
        return needed

    def prepare(self) -> list[str]:
        """The function of what is fixed; the slots that `advance` reads are given their numbers."""
        users = [self.operands(op) for op in self.needed if not self.fixed[op]]
        users += [[op] for op in self.written.values()]
        users += [pair for _, *pair, _ in self.guards if not all(self.fixed[a] for a in pair)]
        kept = {a for some in users for a in some if self.fixed[a] and self.ops[a][0] not in LEAVES}
        self.begin(slots=False)
        for op in sorted(self.needed):
            if self.fixed[op] and self.ops[op][0] not in LEAVES:
                self.compute(op)
                if op in kept:
                    slot = self.slots[op] = len(self.slots)
                    kind = self.integers if self.ops[op][0] in INTEGERS else self.vector
                    where = self.place("slots", slot)
                    self.lines.append(f"store {kind} %v{op}, ptr {where}")
        for guard in self.guards:
            if all(self.fixed[a] for a in guard[1:3]):
                self.guard(*guard)
        mask = self.ended_badly()
        self.lines.append(f"%mask = bitcast <{self.lanes} x i1> {mask} to i{self.lanes}")
        self.lines.append(f"%answer = zext i{self.lanes} %mask to i64")
        return ["define i64 @prepare(ptr noalias %x, ptr noalias %slots) {", *self.lines, "ret i64 %answer", "}"]

    def advance(self) -> list[str]:
        """The function of the samples."""
        self.begin(slots=True)
        guards, stores = self.by_position()
        for guard in guards[-1]:
            self.guard(*guard)
        for op in range(len(self.ops)):
            if op in self.needed and not self.fixed[op] and self.ops[op][0] not in LEAVES:
                self.compute(op)
            for guard in guards[op]:
                self.guard(*guard)
            for place in stores[op]:
                self.store(place, self.name(self.written[place]))
        last = [(place, self.name(self.written[place])) for place in stores[len(self.ops)]]
        for place, name in last:
            self.store(place, name)
        self.write_row()
        mask = self.ended_badly()
        body, lanes = self.lines, self.lanes
        rows = [f"%a{i} = getelementptr ptr, ptr %rows, i64 {i}\n%r{i} = load ptr, ptr %a{i}" for i in range(lanes)]
        arguments = ", ".join(f"ptr noalias %{name}" for name in ("x", "slots", "setpoints", "rows", "alive"))
        return [
            f"define i64 @advance({arguments}, i64 %first, i64 %count, double %h) {{",
            "entry:",
            *rows,
            f"%living = load {self.integers}, ptr %alive",
            f"%counts = icmp ne {self.integers} %living, zeroinitializer",
            "br label %loop",
            "loop:",
            "%k = phi i64 [0, %entry], [%next, %right]",
            "%number = add i64 %first, %k",
            "%real = sitofp i64 %number to double",
            "%clock = fmul double %real, %h",
            f"%clocks = insertelement {self.vector} poison, double %clock, i64 0",
            f"%time = shufflevector {self.vector} %clocks, {self.vector} poison, <{lanes} x i32> zeroinitializer",
            f"%here = mul i64 %k, {self.setpoints}",
            f"%setpoint = getelementptr {self.vector}, ptr %setpoints, i64 %here",
            f"%line = mul i64 %k, {self.width}",
            *body,
            f"%some = and <{lanes} x i1> {mask}, %counts",
            f"%left = bitcast <{lanes} x i1> %some to i{lanes}",
            f"%leaves = icmp ne i{lanes} %left, 0",
            "br i1 %leaves, label %off, label %right",
            "right:",
            "%next = add i64 %k, 1",
            "%more = icmp slt i64 %next, %count",
            "br i1 %more, label %loop, label %off",
            "off:",
            "%done = phi i64 [%k, %loop], [%next, %right]",
            "ret i64 %done",
            "}",
        ]

    def by_position(self) -> tuple[dict[int, list[Any]], dict[int, list[int]]]:
        """Guards and stores behind the operation after which they can be made, stores when the old number is read."""
        last: dict[int, int] = defaultdict(lambda: -1)
        end = len(self.ops)
        for op in self.needed:
            if not self.fixed[op]:
                for a in self.operands(op):
                    last[a] = max(last[a], op)
        guards: dict[int, list[Any]] = defaultdict(list)
        for guard in self.guards:
            if not all(self.fixed[a] for a in guard[1:3]):
                at = max((a for a in guard[1:3] if not self.fixed[a] and self.ops[a][0] not in LEAVES), default=-1)
                guards[at].append(guard)
                for a in guard[1:3]:
                    last[a] = max(last[a], at)
        place_of = {op[1]: number for number, op in enumerate(self.ops) if op[0] == "state"}
        for op in self.written.values():
            if self.ops[op][0] in LEAVES:
                last[op] = end
        stores: dict[int, list[int]] = defaultdict(list)
        for place, op in self.written.items():
            plain = self.fixed[op] or self.ops[op][0] in LEAVES
            old = last[place_of[place]] if place in place_of else -1
            stores[end if plain else max(op, old)].append(place)
        return guards, stores

    def begin(self, slots: bool) -> None:
        """Another function, for which what is fixed stands in slots or is still to be computed."""
        self.lines, self.names, self.bad, self.reads_slots = [], {}, [], slots

    def place(self, base: str, index: int) -> str:
        """The address of a vector."""
        self.lines.append(f"%p{len(self.lines)} = getelementptr {self.vector}, ptr %{base}, i64 {index}")
        return f"%p{len(self.lines) - 1}"

    def name(self, op: int) -> str:
        """The vector of an operation, loaded again where that was long ago."""
        code, *rest = self.ops[op]
        if code == "const":
            return constant(rest[0], self.lanes)
        if code == "time":
            return "%time"
        if code in ("state", "setpoint"):
            base, index = ("x", rest[0]) if code == "state" else ("setpoint", rest[0] * self.setpoints + rest[1])
        elif self.fixed[op] and self.reads_slots:
            base, index = "slots", self.slots[op]
        else:
            return f"%v{op}"
        name, at = self.names.get(op, ("", -NEAR))
        if len(self.lines) - at >= NEAR:
            where, at = self.place(base, index), len(self.lines)
            name = f"%l{at}"
            self.lines.append(f"{name} = load {self.integers if code in INTEGERS else self.vector}, ptr {where}")
            self.names[op] = name, at
        return name

    def store(self, place: int, name: str) -> None:
        """A number of the memory."""
        where = self.place("x", place)
        self.lines.append(f"store {self.vector} {name}, ptr {where}")

    def compute(self, op: int) -> None:
        """The line of an operation."""
        code, *rest = self.ops[op]
        names, vector, integers = [self.name(a) for a in self.operands(op)], self.vector, self.integers
        if code == "call":
            self.call(op, rest[0], names)
            return
        if code in ("fadd", "fsub", "fmul", "fdiv"):
            text = f"{code} {vector} {names[0]}, {names[1]}"
        elif code == "fneg":
            text = f"fneg {vector} {names[0]}"
        elif code in ("fabs", "sqrt"):
            text = f"call {vector} @llvm.{code}.v{self.lanes}f64({vector} {names[0]})"
        elif code == "bits":
            text = f"bitcast {vector} {names[0]} to {integers}"
        elif code == "double":
            text = f"bitcast {integers} {names[0]} to {vector}"
        else:
            text = f"{code} {integers} {names[0]}, <{', '.join([f'i64 {rest[1]}'] * self.lanes)}>"
        self.lines.append(f"%v{op} = {text}")

    def call(self, op: int, function: str, names: list[str]) -> None:
        """An elementary function, run by run."""
        made = "poison"
        for lane in range(self.lanes):
            arguments = []
            for name in names:
                arguments.append(f"double %e{len(self.lines)}")
                self.lines.append(f"%e{len(self.lines)} = extractelement {self.vector} {name}, i64 {lane}")
            self.lines.append(f'%c{op}.{lane} = call double @"{SYMBOL}{function}"({", ".join(arguments)})')
            whole = f"%v{op}" if lane == self.lanes - 1 else f"%i{op}.{lane}"
            self.lines.append(f"{whole} = insertelement {self.vector} {made}, double %c{op}.{lane}, i64 {lane}")
            made = whole

    def guard(self, comparison: str, a: int, b: int, outcome: bool) -> None:
        """Which runs go another way."""
        code = comparison if not outcome else OPPOSITE[comparison]
        one, other = self.name(a), self.name(b)
        self.lines.append(f"%g{len(self.lines)} = fcmp {code} {self.vector} {one}, {other}")
        self.bad.append(f"%g{len(self.lines) - 1}")
        if len(self.bad) == 2:
            self.bad = [self.ended_badly()]

    def ended_badly(self) -> str:
        """The runs of which any guard said so."""
        kind = f"<{self.lanes} x i1>"
        if len(self.bad) == 2:
            self.lines.append(f"%g{len(self.lines)} = or {kind} {self.bad[0]}, {self.bad[1]}")
            return f"%g{len(self.lines) - 1}"
        return self.bad[0] if self.bad else "zeroinitializer"

    def write_row(self) -> None:
        """The row of signals of every run, from the memory, where it stands as vectors of all runs."""
        for first in range(0, self.width, self.lanes):
            count = min(self.lanes, self.width - first)
            for i in range(count):
                where = self.place("x", self.row + first + i)
                self.lines.append(f"%row{first + i} = load {self.vector}, ptr {where}")
            for lane in range(self.lanes):
                made, line = "poison", len(self.lines)
                kind = f"<{count} x double>"
                for i in range(count):
                    self.lines.append(f"%q{line}.{i} = extractelement {self.vector} %row{first + i}, i64 {lane}")
                    self.lines.append(f"%n{line}.{i} = insertelement {kind} {made}, double %q{line}.{i}, i64 {i}")
                    made = f"%n{line}.{i}"
                self.lines.append(f"%o{line} = add i64 %line, {first}")
                self.lines.append(f"%w{line} = getelementptr double, ptr %r{lane}, i64 %o{line}")
                self.lines.append(f"store {kind} {made}, ptr %w{line}, align 8")

    def declarations(self) -> list[str]:
        """The functions that are called."""
        vector = self.vector
        given = [f"declare {vector} @llvm.{name}.v{self.lanes}f64({vector})" for name in ("fabs", "sqrt")]
        return given + called(self.ops)


OPPOSITE = {"olt": "uge", "ole": "ugt", "ogt": "ule", "oge": "ult", "oeq": "une", "une": "oeq"}


def operands(op: Sequence[Any]) -> list[int]:
    """The operations that an operation needs."""
    code, *rest = op
    if code in LEAVES:
        return []
    return rest[1:] if code == "call" else rest[:1] if code in ("add", "shl") else rest


def called(ops: Sequence[Sequence[Any]]) -> list[str]:
    """The elementary functions that operations call, declared."""
    names = {(op[1], len(op) - 2) for op in ops if op[0] == "call"}
    return [
        f'declare double @"{SYMBOL}{name}"({", ".join(["double"] * count)}) nounwind memory(none)'
        for name, count in sorted(names)
    ]


def constant(text: str, lanes: int) -> str:
    """A vector of one number."""
    return f"<{', '.join([f'double {word(text)}'] * lanes)}>"


def word(text: str) -> str:
    """A number, as `noting` writes it, for LLVM."""
    number = float.fromhex(text) if text.lstrip("-").startswith("0x") else float(text)
    return f"0x{struct.unpack('<Q', struct.pack('<d', number))[0]:016X}"
