"""What `noting` has noted of a sample as LLVM code for one run, which is made as fast as it can be: not optimised.

It works on the engine's own arrays. All numbers that a sample writes are written behind its guards, so a sample that
goes another way than the one that was noted has changed nothing:

    advance(roots, setpoints, rows, first, count, h)        how many samples were right

with the addresses of the arrays (`side_by_side.Form.roots`), the setpoints (count + 1, m) from the sample before
`first` on, and where the rows (count, width) go.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate
from typing import Any

from .vector_code import LEAVES, OPPOSITE, SYMBOL, operands, word

TYPES = {"bits": "i64", "add": "i64", "shl": "i64"}  # of results; all others are doubles


def scalar_code(told: dict[str, Any], sizes: Sequence[int]) -> str:
    """The code of a sample.

    Args:
        told: What `noting.sample` gives.
        sizes: How many numbers each of the arrays has that are the memory, one after the other.
    """
    return ScalarCode(told, sizes).text()


class ScalarCode:
    """The code of one sample; arguments as of `scalar_code`."""

    def __init__(self, told: dict[str, Any], sizes: Sequence[int]) -> None:
        self.told, self.ops = told, told["ops"]
        self.starts = list(accumulate(sizes, initial=0))
        self.lines: list[str] = []
        self.names: dict[int, str] = {}
        self.found: dict[int, str] = {}

    def text(self) -> str:
        """All of it."""
        for op in range(len(self.ops)):
            self.compute(op)
        guards = [self.guard(*guard) for guard in self.told["guards"]]
        for i, guard in enumerate(guards):
            self.lines.append(f"%o{i} = or i1 {f'%o{i - 1}' if i else 'false'}, {guard}")
        leaves = f"%o{len(guards) - 1}" if guards else "false"
        body, self.lines = self.lines, []
        for place, op in sorted((int(place), op) for place, op in self.told["written"].items()):
            self.lines.append(f"store double {self.names[op]}, ptr {self.address(place)}")
        row, width = self.address(int(self.told["row"])), self.told["width"]
        places = self.found.items()
        known = sorted({bisect_right(self.starts, place) - 1 for place in self.found})
        roots = [f"%b{i} = getelementptr ptr, ptr %roots, i64 {i}\n%r{i} = load ptr, ptr %b{i}" for i in known]
        addresses = [
            f"{name} = getelementptr double, ptr %r{(i := bisect_right(self.starts, place) - 1)}, "
            f"i64 {place - self.starts[i]}"
            for place, name in places
        ]
        lines = (
            *declarations(self.ops),
            "define i64 @advance(ptr %roots, ptr %setpoints, ptr %rows, i64 %first, i64 %count, double %h) {",
            "entry:",
            *roots,
            *addresses,
            "br label %loop",
            "loop:",
            "%k = phi i64 [0, %entry], [%next, %right]",
            "%number = add i64 %first, %k",
            "%real = sitofp i64 %number to double",
            "%time = fmul double %real, %h",
            f"%here = mul i64 %k, {self.told['setpoints']}",
            "%setpoint = getelementptr double, ptr %setpoints, i64 %here",
            *body,
            f"br i1 {leaves}, label %off, label %right",
            "right:",
            *self.lines,
            f"%line = mul i64 %k, {width}",
            "%target = getelementptr double, ptr %rows, i64 %line",
            f"call void @llvm.memcpy.p0.p0.i64(ptr %target, ptr {row}, i64 {8 * width}, i1 false)",
            "%next = add i64 %k, 1",
            "%more = icmp slt i64 %next, %count",
            "br i1 %more, label %loop, label %off",
            "off:",
            "%done = phi i64 [%k, %loop], [%next, %right]",
            "ret i64 %done",
            "}",
            "",
        )
        return "\n".join(lines)

    def address(self, place: int) -> str:
        """The address of a number of the memory."""
        return self.found.setdefault(place, f"%m{place}")

    def compute(self, op: int) -> None:
        """The lines of an operation."""
        code, *rest = self.ops[op]
        name = self.names[op] = f"%v{op}"
        if code == "const":
            self.names[op] = word(rest[0])
        elif code == "time":
            self.names[op] = "%time"
        elif code == "state":
            self.lines.append(f"{name} = load double, ptr {self.address(rest[0])}")
        elif code == "setpoint":
            at = rest[0] * self.told["setpoints"] + rest[1]
            self.lines.append(f"%s{op} = getelementptr double, ptr %setpoint, i64 {at}")
            self.lines.append(f"{name} = load double, ptr %s{op}")
        elif code == "row":
            self.row(op, *rest)
        else:
            self.lines.append(f"{name} = {self.expression(code, rest, [self.names[a] for a in operands(self.ops[op])])}")

    def row(self, op: int, index: int, place: int, rows: int, columns: int) -> None:
        """The lines of a number in the row of a table that is found by a number; one beyond it leaves its way."""
        self.lines += [
            f"%f{op} = call double @llvm.maxnum.f64(double {self.names[index]}, double 0.0)",
            f"%t{op} = call double @llvm.minnum.f64(double %f{op}, double {word(str(rows - 1))})",
            f"%i{op} = fptosi double %t{op} to i64",
            f"%j{op} = mul i64 %i{op}, {columns}",
            f"%q{op} = getelementptr double, ptr {self.address(place)}, i64 %j{op}",
            f"%v{op} = load double, ptr %q{op}",
        ]

    def expression(self, code: str, rest: Sequence[Any], names: Sequence[str]) -> str:
        """What an operation that is no leaf gives."""
        if code == "call":
            return f'call double @"{SYMBOL}{rest[0]}"({", ".join(f"double {name}" for name in names)})'
        if code in ("fabs", "sqrt"):
            return f"call double @llvm.{code}.f64(double {names[0]})"
        if code == "bits":
            return f"bitcast double {names[0]} to i64"
        if code == "double":
            return f"bitcast i64 {names[0]} to double"
        if code in ("add", "shl"):
            return f"{code} i64 {names[0]}, {rest[1]}"
        return f"{code} double {', '.join(names)}"

    def guard(self, comparison: str, a: int, b: int, outcome: bool) -> str:
        """Whether the run goes another way."""
        name = f"%g{len(self.lines)}"
        code = OPPOSITE[comparison] if outcome else comparison
        self.lines.append(f"{name} = fcmp {code} double {self.names[a]}, {self.names[b]}")
        return name


def declarations(ops: Sequence[Sequence[Any]]) -> list[str]:
    """The functions that are called."""
    called = sorted({(op[1], len(op) - 2) for op in ops if op[0] == "call"})
    return [
        *(f"declare double @llvm.{name}.f64(double)" for name in ("fabs", "sqrt")),
        *(f"declare double @llvm.{name}.f64(double, double)" for name in ("maxnum", "minnum")),
        "declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)",
        *(f'declare double @"{SYMBOL}{name}"({", ".join(["double"] * count)})' for name, count in called),
    ]
