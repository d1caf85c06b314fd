"""The body of one function: its statements as lines of C.

A name that is bound once to something known stands for that and is not written. Every other name becomes a local
variable of one kind, declared where it is first written, in the innermost block that has all its uses. Loops over a
few known numbers are unrolled only where the memory that they reach must be known.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NoReturn

from .assignments import Assignments
from .expressions import NeedsUnrolling
from .program import Function, Parameter, Program
from .source import Source, Untranslatable
from .values import (
    Array,
    Number,
    Pointer,
    Root,
    Static,
    Tuple,
    Value,
    Vec,
    integer,
    joined,
)  # fmt: skip
from .writing import Block, finished

UNROLLED = 16  # most turns of a loop that is written out


class Body(Assignments):
    """The translation of one function, with the values of its arguments."""

    def __init__(self, program: Program, source: Source, names: dict[str, Value], record: Function) -> None:
        self.program, self.source, self.record = program, source, record
        self.scope, self.names, self.arguments = source.scope, dict(names), dict(names)
        self.small = ".elementary." in source.function.__module__
        self.kinds: dict[str, Any] = {}  # of local variables, as far as they are known
        self.result: Any = None
        self.counts = Counter[str]()
        self.lines: list[Any] = []
        self.pointers: dict[str, Pointer] = {}

    def refuse(self, node: ast.AST, what: str) -> NoReturn:
        """Stop, with function and line."""
        line = self.source.first + getattr(node, "lineno", 1) - 1
        raise Untranslatable(
            f"{what} in '{self.source.node.name}' cannot be written as C",
            why="the export knows numbers, arrays, named tuples, loops over ranges and calls",
            fix="say it with those",
            file=self.source.file,
            line=line,
        )

    def translate(self) -> list[Any]:
        """The lines of the body; once more as long as local variables turn out to be of wider kinds."""
        while True:
            before = dict(self.kinds), self.result
            self.lines, self.names, self.pointers, self.counts = [], dict(self.arguments), {}, Counter()
            self._enter()
            self.statements(self.source.node.body)
            if (self.kinds, self.result) == before:
                return self.lines

    def _enter(self) -> None:
        """Arguments that are written to become local variables; those that stand for known memory get pointers."""
        for name, value in self.arguments.items():
            if self.source.stores[name] and isinstance(value, Number | Vec):
                is_parameter = isinstance(value, Vec) or not value.is_known
                if not is_parameter:
                    self._to_variable(name, value)
                else:
                    self.kinds[name] = value.kind if isinstance(value, Number) else value.size
            elif isinstance(value, Array) and isinstance(value.base, Root) and value.alias is None:
                self.names[name] = self._aliased(name, value)

    # -- statements ---------------------------------------------------------------------------------------------------

    def statements(self, nodes: list[ast.stmt]) -> bool:
        """Statements one after the other; whether what follows them is reached."""
        for node in nodes:
            handler: Callable[[Any], bool | None] | None = getattr(self, f"do_{type(node).__name__.lower()}", None)
            if handler is None:
                self.refuse(node, f"'{type(node).__name__.lower()}'")
            if handler(node) is False:
                return False
        return True

    @contextmanager
    def block(self, head: str, is_loop: bool = False) -> Iterator[Block]:
        """Lines that go into braces of their own."""
        block, outer = Block(head, is_loop=is_loop), self.lines
        self.lines = block.lines
        try:
            yield block
        finally:
            self.lines = outer

    def do_expr(self, node: ast.Expr) -> None:
        """A docstring, or a call."""
        if isinstance(node.value, ast.Constant):
            return
        value = self.expression(node.value)
        if isinstance(value, Number | Vec) and "(" in value.text:
            self.lines.append(f"{value.text};" if "(" in value.text[:60] else f"(void){value.text};")

    def do_pass(self, node: ast.Pass) -> None:
        """Nothing."""

    def do_break(self, node: ast.Break) -> bool:
        """Leave a loop."""
        self.lines.append("break;")
        return False

    def do_continue(self, node: ast.Continue) -> bool:
        """Next turn of a loop."""
        self.lines.append("continue;")
        return False

    def do_return(self, node: ast.Return) -> bool:
        """The result; of several numbers a struct."""
        if node.value is None:
            self.lines.append("return;")
            return False
        value = self.expression(node.value)
        if isinstance(value, Static) and value.object is None:
            self.lines.append("return;")
            return False
        kind: Any
        if isinstance(value, Tuple):
            items = [item if isinstance(item, Number) else self.vec(node, item) for item in value.items]
            kind = tuple(item.kind if isinstance(item, Number) else item.size for item in items)
            if self.result is not None:
                kind = tuple(
                    joined(a, b) if isinstance(a, str) else a
                    for a, b in zip(self._each(self.result), kind, strict=True)
                )
            kind = len(kind) if set(kind) == {"real"} else kind
            if isinstance(kind, tuple):
                name = self.program.record_type(kind)
                text = f"({name}){{{', '.join(item.text for item in items)}}}"
            else:
                text = self.vec(node, value).text
        elif isinstance(value, Number):
            kind = joined(value.kind, self.result) if isinstance(self.result, str) else value.kind
            text = value.text
        else:
            vec = self.vec(node, value)
            kind, text = vec.size, vec.text
        self.result = kind
        self.lines.append(f"return {text};")
        return False

    def _each(self, kind: Any) -> tuple[str, ...]:
        return kind if isinstance(kind, tuple) else ("real",) * kind

    def do_if(self, node: ast.If) -> bool | None:
        """A branch; only the one that is taken where that is known."""
        test = self.number(node.test)
        if test.is_known:
            return self.statements(node.body if test.value else node.orelse)
        with self.block(f"if ({test.text})") as then:
            goes_on = self.statements(node.body)
        with self.block("else") as otherwise:
            goes_on_else = self.statements(node.orelse)
        if not then.lines and not otherwise.lines:
            if "(" in test.text:
                self.lines.append(f"(void)({test.text});")
            return None
        if not then.lines:
            then, otherwise = replace(otherwise, head=f"if (!({test.text}))"), Block("else")
        self.lines.append(then)
        if otherwise.lines:
            self.lines.append(otherwise)
        return None if goes_on or goes_on_else else False

    def do_while(self, node: ast.While) -> None:
        """A loop."""
        if node.orelse:
            self.refuse(node, "'else' of a loop")
        with self.block(f"while ({self.number(node.test).text})", is_loop=True) as block:
            self.statements(node.body)
        self.lines.append(block)

    def do_for(self, node: ast.For) -> None:
        """A loop over a range, or over the items of a tuple, which is written out."""
        if node.orelse:
            self.refuse(node, "'else' of a loop")
        call = node.iter
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "range"):
            over = self.expression(call)
            items = over.items if isinstance(over, Tuple) else ()
            if isinstance(over, Static) and isinstance(over.object, tuple):
                items = tuple(self.program.lifted(x, f"{over.name}_{i}") for i, x in enumerate(over.object))
            elif not isinstance(over, Tuple):
                self.refuse(node, "a loop over this")
            self._written_out(node, items)
            return
        given = [self.number(item) for item in call.args]
        first, last, step = (integer(0), *given, integer(1)) if len(given) == 1 else (*given, integer(1))[:3]
        if first.is_known and last.is_known and step.is_known and not range(first.value, last.value, step.value):
            return
        before, names = len(self.lines), dict(self.names)
        try:
            self._loop(node, first, last, step)
        except NeedsUnrolling as error:
            del self.lines[before:]
            self.names = names
            turns = range(first.value, last.value, step.value) if first.is_known and last.is_known else ()
            if not 0 < len(turns) <= UNROLLED:
                self.refuse(node, f"memory at {error}")
            self._written_out(node, tuple(integer(i) for i in turns))

    def _loop(self, node: ast.For, first: Number, last: Number, step: Number) -> None:
        if not isinstance(node.target, ast.Name) or not step.is_known:
            self.refuse(node, "a loop like this")
        name = self.local(node.target.id)
        if not last.is_known and not re.fullmatch(r"[\w +-]*", last.text):
            last = self.fresh(last, f"{name}_end")  # type: ignore[assignment]
        step_text = {1: f"{name}++", -1: f"{name}--"}.get(step.value, f"{name} += {step.value}")
        sign, kind = "<" if step.value > 0 else ">", joined(first.kind, last.kind, "int")
        used_elsewhere = self.source.stores[node.target.id] > self._loops_over(node.target.id)
        if used_elsewhere:
            self.kinds[name] = joined(self.kinds.get(name, "bool"), kind)
        declared = "" if used_elsewhere else f"{self.program.c_type(kind)} "
        self.names[node.target.id] = Number(kind, name)
        head = f"for ({declared}{name} = {first.text}; {name} {sign} {last.text}; {step_text})"
        with self.block(head, is_loop=True) as block:
            self.statements(node.body)
        if block.lines:
            self.lines.append(block)

    def _loops_over(self, name: str) -> int:
        loops = [n.target for n in ast.walk(self.source.node) if isinstance(n, ast.For)]
        return sum(isinstance(target, ast.Name) and target.id == name for target in loops)

    def _written_out(self, node: ast.For, items: tuple[Value, ...]) -> None:
        if any(isinstance(n, ast.Break | ast.Continue) for n in ast.walk(node)):
            with self.block("do", is_loop=True):
                self.refuse(node, "'break' or 'continue' in a loop over this")
        for item in items:
            with self.block("") as block:
                self._bind(node.target, item, written_out=True)
                self.statements(node.body)
            if block.lines:
                self.lines.append(block)


def write(
    program: Program, record: Function, source: Source, names: dict[str, Value], possible: dict[str, Parameter]
) -> None:
    """Translate one function.

    Args:
        program: That it belongs to.
        record: What is to be filled in.
        source: Its text.
        names: What its arguments stand for.
        possible: Parameters that they may become, by name.
    """
    body = Body(program, source, names, record)
    lines = body.translate()
    record.result = body.result
    finished(program, record, possible, lines, body.kinds, body.pointers)
