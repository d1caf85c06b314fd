"""What `noting` has noted of a call as LLVM code for one run, made as fast as it can be: it is not optimised.

It works on the arrays themselves. All numbers that the call writes are written behind its guards, so a call that goes
another way than the one that was noted has changed nothing:

    call(roots)         with the addresses of the arrays: 1, or 0 where it goes another way
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate
from typing import Any

from .vector_code import OPPOSITE, SYMBOL, called, operands, word

BLOCK = 200  # operations in a piece of code that LLVM looks at as a whole


def scalar_code(told: dict[str, Any], sizes: Sequence[int]) -> str:
    """The code of a call.

    Args:
        told: What `noting.call` gives.
        sizes: How many numbers each of the arrays has that are the memory, one after the other.
    """
    return ScalarCode(told, sizes).text()


class ScalarCode:
    """The code of one call; arguments as of `scalar_code`."""

    def __init__(self, told: dict[str, Any], sizes: Sequence[int]) -> None:
        self.told, self.ops = told, told["ops"]
        self.starts = list(accumulate(sizes, initial=0))
        self.lines: list[str] = []
        self.names: dict[int, str] = {}
        self.found: dict[int, str] = {}

    def text(self) -> str:
        """All of it."""
        for op in range(len(self.ops)):
            if op % BLOCK == 0:
                self.lines.append(f"br label %block{op}\nblock{op}:")
            self.compute(op)
        guards = [self.guard(*guard) for guard in self.told["guards"]]
        for i, guard in enumerate(guards):
            self.lines.append(f"%o{i} = or i1 {f'%o{i - 1}' if i else 'false'}, {guard}")
        leaves = f"%o{len(guards) - 1}" if guards else "false"
        body, self.lines = self.lines, []
        for place, op in sorted(self.told["written"].items()):
            self.lines.append(f"store double {self.names[op]}, ptr {self.address(place)}")
        of = {place: bisect_right(self.starts, place) - 1 for place in self.found}
        roots = [f"%b{i} = getelementptr ptr, ptr %roots, i64 {i}\n%r{i} = load ptr, ptr %b{i}" for i in {*of.values()}]
        addresses = [
            f"{name} = getelementptr double, ptr %r{of[place]}, i64 {place - self.starts[of[place]]}"
            for place, name in self.found.items()
        ]
        lines = (
            *(f"declare double @llvm.{name}.f64(double)" for name in ("fabs", "sqrt")),
            *called(self.ops),
            "define i64 @call(ptr %roots) {",
            *roots,
            *addresses,
            *body,
            f"br i1 {leaves}, label %off, label %right",
            "right:",
            *self.lines,
            "ret i64 1",
            "off:",
            "ret i64 0",
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
        elif code == "state":
            self.lines.append(f"{name} = load double, ptr {self.address(rest[0])}")
        else:
            self.lines.append(
                f"{name} = {self.expression(code, rest, [self.names[a] for a in operands(self.ops[op])])}"
            )

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
