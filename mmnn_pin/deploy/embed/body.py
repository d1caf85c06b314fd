"""One function of Python as lines of C: its statements, what they assign, its expressions and its calls.

A name that is bound once to something known stands for that and is not written. Every other name becomes a local
variable of one kind, declared where it is first written, in the innermost block that has all its uses. Loops over a
few known numbers are unrolled only where the memory that they reach must be known.

The text of a C expression has the operations of the Python expression in the same order and with the same rounding:
products and sums are never regrouped, `min` and `max` keep their first argument where a comparison fails, `%` has the
sign of the divisor.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import math
import operator
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any, NoReturn, TypeVar

import numpy as np

from ...elementary.bits import bits_of, from_bits
from .program import CFunction, CProgram, Parameter
from .source import FunctionSource, Untranslatable
from .values import (
    AND,
    ATOM,
    CHOICE,
    COMPARE,
    OR,
    PRODUCT,
    SUM,
    UNARY,
    ArrayValue,
    Number,
    Pointer,
    Root,
    Static,
    Tuple,
    Value,
    Vec,
    integer,
    joined,
    leaves,
    minus,
    plus,
    real,
    row_strides,
    times,
    truth,
)  # fmt: skip
from .writing import Assign, CodeBlock, finished

COMPARISONS: dict[type, tuple[str, Callable[[Any, Any], bool]]] = {
    ast.Lt: ("<", operator.lt), ast.LtE: ("<=", operator.le), ast.Gt: (">", operator.gt), ast.GtE: (">=", operator.ge),
    ast.Eq: ("==", operator.eq), ast.NotEq: ("!=", operator.ne),
}  # fmt: skip
ARITHMETIC: dict[type, tuple[str, int, Callable[[Any, Any], Any]]] = {
    ast.Add: ("+", SUM, operator.add), ast.Sub: ("-", SUM, operator.sub), ast.Mult: ("*", PRODUCT, operator.mul),
    ast.BitAnd: ("&", 3, operator.and_), ast.BitOr: ("|", 3, operator.or_), ast.RShift: (">>", 3, operator.rshift),
}  # fmt: skip
# Functions of C that stand for those of Python: name, and kind of the result.
MATH: dict[Any, tuple[str, str]] = {
    math.sqrt: ("mmnn_sqrt", "real"), np.sqrt: ("mmnn_sqrt", "real"), math.floor: ("mmnn_floor", "real"),
    math.isfinite: ("mmnn_is_finite", "bool"), np.isfinite: ("mmnn_is_finite", "bool"),
    math.isnan: ("mmnn_is_nan", "bool"), np.isnan: ("mmnn_is_nan", "bool"),
    math.copysign: ("mmnn_copysign", "real"), bits_of: ("mmnn_bits_of", "long"), from_bits: ("mmnn_from_bits", "real"),
}  # fmt: skip
NARROW = 2**15  # what a mask below it leaves counts as an integer of 32 bits: products of two such are exact
RESERVED = {"self", "double", "float", "int", "long", "short", "register", "auto", "signed", "default", "switch"}
NumberOrVec = TypeVar("NumberOrVec", bound=Number | Vec)
UNROLLED = 16  # most turns of a loop that is written out


class NeedsUnrolling(Exception):
    """A place in memory that is known only where a loop's variable is."""


class FunctionBody:
    """The translation of one function, with the values of its arguments.

    Attributes:
        program: What all functions share.
        scope: Globals and closure of the function.
        names: What its local names stand for.
        lines: The lines so far.
        small: Whether its integers from floating-point numbers have 32 bits (see `program`).
        kinds: Kinds of the local variables, as far as they are known.
        counts: How many new names begin alike.
        pointers: Local variables that are pointers.
    """

    def __init__(self, program: CProgram, source: FunctionSource, names: dict[str, Value]) -> None:
        self.program, self.source = program, source
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
            elif isinstance(value, ArrayValue) and isinstance(value.base, Root) and value.alias is None:
                self.names[name] = self._aliased(name, value)

    # -- statements ----------------------------------------------------------------------------------------------------

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
    def block(self, head: str, is_loop: bool = False) -> Iterator[CodeBlock]:
        """Lines that go into braces of their own."""
        block, outer = CodeBlock(head, is_loop=is_loop), self.lines
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
                each = self.result if isinstance(self.result, tuple) else ("real",) * self.result
                kind = tuple(joined(a, b) if isinstance(a, str) else a for a, b in zip(each, kind, strict=True))
            kind = len(kind) if set(kind) == {"real"} else kind
            if isinstance(kind, tuple):
                name = self.program.record_type(kind)
                text = f"MMNN_OF({name}){{{', '.join(item.text for item in items)}}}"
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
            then, otherwise = replace(otherwise, head=f"if (!({test.text}))"), CodeBlock("else")
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
            self._written_out(node, self.items(node, self.expression(call)))
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
            self._written_out(node, [integer(i) for i in turns])

    def _loop(self, node: ast.For, first: Number, last: Number, step: Number) -> None:
        if not isinstance(node.target, ast.Name) or not step.is_known:
            self.refuse(node, "a loop like this")
        name = self.local(node.target.id)
        if not last.is_known and not re.fullmatch(r"[\w +-]*", last.text):
            last = self.fresh(last, f"{name}_end")
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

    def _written_out(self, node: ast.For, items: Sequence[Value]) -> None:
        if any(isinstance(n, ast.Break | ast.Continue) for n in ast.walk(node)):
            self.refuse(node, "'break' or 'continue' in a loop over this")
        for item in items:
            with self.block("") as block:
                self._bind(node.target, item, written_out=True)
                self.statements(node.body)
            if block.lines:
                self.lines.append(block)

    # -- assignments ---------------------------------------------------------------------------------------------------

    def do_assign(self, node: ast.Assign) -> None:
        """One value to one or more targets."""
        target = node.targets[0]
        if len(node.targets) == 1 and isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            self._several(target.elts, node.value.elts)
            return
        value = self.expression(node.value)
        if len(node.targets) > 1 and isinstance(value, Number) and not value.is_known:
            value = self.fresh(value)
        for one in node.targets:
            self._bind(one, value)

    def do_annassign(self, node: ast.AnnAssign) -> None:
        """One value to a target with a type."""
        assert node.value is not None
        self._bind(node.target, self.expression(node.value))

    def _several(self, targets: list[ast.expr], nodes: list[ast.expr]) -> None:
        """Values side by side; one whose target a later value reads waits under a new name until all are known."""
        waiting: list[tuple[ast.expr, Value]] = []
        for i, (target, node) in enumerate(zip(targets, nodes, strict=True)):
            value, later = self.expression(node), [n for other in nodes[i + 1 :] for n in ast.walk(other)]
            written = {n.id for n in ast.walk(target) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
            clash = any(isinstance(n, ast.Name) and n.id in written for n in later)
            into_memory = any(isinstance(n, ast.Subscript) for n in ast.walk(target))
            clash |= into_memory and any(isinstance(n, ast.Subscript | ast.Call) for n in later)
            if not clash:
                self._bind(target, value)
                continue
            if isinstance(value, Vec) or (isinstance(value, Number) and not value.is_known):
                value = self.fresh(value)
            waiting.append((target, value))
        for target, value in waiting:
            self._bind(target, value)

    def _bind(self, target: ast.expr, value: Value, written_out: bool = False) -> None:
        """A value to a name, to several, or into memory."""
        if isinstance(target, ast.Name):
            self._to_name(target, value, written_out)
        elif isinstance(target, ast.Tuple):
            for one, item in zip(target.elts, self.items(target, value), strict=True):
                self._bind(one, item, written_out)
        elif isinstance(target, ast.Subscript):
            self._to_memory(target, value)
        else:
            self.refuse(target, "an assignment to this")

    def items(self, node: ast.AST, value: Value) -> list[Value]:
        """The values that a tuple, a struct or a shape is made of."""
        if isinstance(value, Tuple):
            return list(value.items)
        if isinstance(value, Static) and isinstance(value.object, tuple):
            return [self.program.lifted(x, f"{value.name}_{i}") for i, x in enumerate(value.object)]
        if isinstance(value, Vec):
            whole = value if is_name(value.text) else self.fresh(value)
            return [Number("real", f"{whole.text}.v[{i}]") for i in range(whole.size)]
        self.refuse(node, "parts of this")

    def _to_name(self, target: ast.Name, value: Value, written_out: bool) -> None:
        name, once = target.id, written_out or self.source.stores[target.id] == 1
        if (isinstance(value, Number) and not (once and value.is_known)) or isinstance(value, Vec):
            self._to_variable(name, value)
        elif not once and isinstance(value, Tuple) and all(isinstance(x, Number) for x in value.items):
            self._to_variable(name, self.vec(target, value))
        elif isinstance(value, Tuple) and reads(value):
            self.names[name] = self.fresh(self.vec(target, value))
        elif not once:
            self.refuse(target, f"'{name}', which is several things,")
        elif isinstance(value, ArrayValue):
            self.names[name] = self._aliased(name, value)
        else:
            self.names[name] = value

    def _to_variable(self, name: str, value: Number | Vec) -> None:
        """A number or a struct into a local variable."""
        local = self.local(name)
        if isinstance(value, Vec):
            self.kinds[local] = value.size
            self.names[name] = Vec(local, value.size)
        else:
            before = self.kinds.get(local, value.kind)
            if not isinstance(before, str):
                self.refuse(self.source.node, f"'{name}', which is several things,")
            self.kinds[local] = joined(before, value.kind)
            self.names[name] = Number(self.kinds[local], local)
            value = as_kind(value, self.kinds[local])
        self.lines.append(Assign(local, value.text))

    def _aliased(self, name: str, array: ArrayValue) -> ArrayValue:
        """An array under a name of its own: a pointer, which is written only where it is used."""
        if array.alias is not None and array.alias.name == self.local(name):
            return array
        if not array.shape or (isinstance(array.base, Root) and array.base.parts):
            return array
        pointer = self.pointer(self.address(array), array.kind, (array.alias or array.base,), self.local(name))
        if isinstance(array.base, Root) and array.offset.is_known:
            return replace(array, alias=pointer)
        return ArrayValue(pointer, integer(0), array.shape, array.strides, array.kind)

    def _to_memory(self, target: ast.Subscript, value: Value) -> None:
        place = self.expression(target.value)
        if not isinstance(place, ArrayValue):
            self.refuse(target, "an assignment to a part of this")
        items = target.slice.elts if isinstance(target.slice, ast.Tuple) else [target.slice]
        if self.program.is_dropped(place.base):
            return
        if len(items) == len(place.shape) and not any(isinstance(item, ast.Slice) for item in items):
            if not isinstance(value, Number):
                self.refuse(target, "this as a number of an array")
            value = as_kind(value, place.kind)
            self.program.write(place)
            found = self.part(target, place, items)
            assert isinstance(found, Number)
            self.lines.append(f"{found.text.removeprefix('(int64_t)')} = {value.text};")
            return
        part = self.part(target, place, items)
        assert isinstance(part, ArrayValue)
        self._fill(target, part, value)

    def _fill(self, target: ast.AST, part: ArrayValue, value: Value) -> None:
        """A number, or an array, into all places of an array whose rows stand one after the other."""
        size = integer(1)
        for one in part.shape:
            size = self.operate(target, size, ast.Mult(), one)
        if part.layout != "C" or (isinstance(value, ArrayValue) and (value.layout != "C" or len(value.shape) != 1)):
            self.refuse(target, "an assignment to an array like this")
        if not isinstance(value, Number | ArrayValue):
            self.refuse(target, "an assignment of this")
        self.program.write(part)
        i = "at_"
        one = Number("int", i)
        text = self.element(value, one).text if isinstance(value, ArrayValue) else value.text
        into = self.element(part, one).text
        if size.value != 0:
            head = f"for (int32_t {i} = 0; {i} < {size.text}; {i}++)"
            self.lines.append(CodeBlock(head, [f"{into} = {text};"], is_loop=True))

    def do_augassign(self, node: ast.AugAssign) -> None:
        """`x += a` and its like."""
        if isinstance(node.target, ast.Name):
            value = self.names.get(node.target.id)
            assert isinstance(value, Number)
            result = self.operate(node, Number(value.kind, value.text), node.op, self.number(node.value))
            self._to_variable(node.target.id, result)
            return
        assert isinstance(node.target, ast.Subscript)
        place = self.expression(node.target.value)
        assert isinstance(place, ArrayValue)
        if self.program.is_dropped(place.base):
            return
        self.program.write(place)
        items = node.target.slice.elts if isinstance(node.target.slice, ast.Tuple) else [node.target.slice]
        found = self.part(node.target, place, items)
        assert isinstance(found, Number)
        value = as_kind(self.number(node.value), found.kind)
        sign = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}.get(type(node.op))
        if sign is None:
            self.refuse(node, "this operator before '='")
        self.lines.append(f"{found.text} {sign}= {value.text};")

    # -- names ---------------------------------------------------------------------------------------------------------

    def local(self, name: str) -> str:
        """A name of Python as one of C."""
        return f"{name}_" if name in RESERVED else name

    def fresh(self, value: NumberOrVec, hint: str = "t") -> NumberOrVec:
        """A new local name for a value that is used more than once."""
        self.counts[hint] += 1
        name = f"{hint}{self.counts[hint]}" if hint == "t" or self.counts[hint] > 1 else hint
        self.kinds[name] = value.kind if isinstance(value, Number) else value.size
        self.lines.append(Assign(name, value.text))
        made: Any = Number(value.kind, name) if isinstance(value, Number) else Vec(name, value.size)
        return made

    def pointer(self, text: str, kind: str, of: tuple[Any, ...], hint: str = "t") -> Pointer:
        """A new local pointer."""
        if hint == "t":
            self.counts["t"] += 1
            hint = f"t{self.counts['t']}"
        pointer = self.pointers.setdefault(hint, Pointer(hint))
        pointer.of += of
        self.kinds[hint] = ("pointer", kind)
        self.lines.append(Assign(hint, text))
        return pointer

    def _record(self, text: str, kinds: tuple[str, ...]) -> Tuple:
        """Numbers of several kinds that a function returns."""
        self.counts["t"] += 1
        name = f"t{self.counts['t']}"
        self.kinds[name] = kinds
        self.lines.append(Assign(name, text))
        parts = (f"{name}.n{i}" for i in range(len(kinds)))
        return Tuple(
            tuple(Vec(p, k) if isinstance(k, int) else Number(k, p) for p, k in zip(parts, kinds, strict=True))
        )

    # -- expressions ---------------------------------------------------------------------------------------------------

    def expression(self, node: ast.expr) -> Value:
        """The value of an expression."""
        handler = getattr(self, f"_{type(node).__name__.lower()}", None)
        if handler is None:
            self.refuse(node, f"a {type(node).__name__}")
        value: Value = handler(node)
        return value

    def number(self, node: ast.expr) -> Number:
        """An expression that is one number."""
        return self._plain(node, self.expression(node))

    def _constant(self, node: ast.Constant) -> Value:
        return self.program.lifted(node.value)

    def _name(self, node: ast.Name) -> Value:
        if node.id in self.names:
            return self.names[node.id]
        if node.id not in self.scope and hasattr(builtins, node.id):
            return Static(getattr(builtins, node.id))
        if node.id not in self.scope:
            self.refuse(node, f"'{node.id}', which is not known here,")
        return self.program.named(self.scope[node.id], node.id, self.scope)

    def _attribute(self, node: ast.Attribute) -> Value:
        value = self.expression(node.value)
        if isinstance(value, Tuple) and value.of is not None and node.attr in value.of._fields:  # type: ignore[attr-defined]
            item: Value = value.items[value.of._fields.index(node.attr)]  # type: ignore[attr-defined]
            return item
        if isinstance(value, Static):
            return self.program.attribute(value, node.attr)
        if isinstance(value, ArrayValue):
            if node.attr == "T":
                return replace(value, shape=value.shape[::-1], strides=value.strides[::-1])
            if node.attr == "size":
                size = integer(1)
                for one in value.shape:
                    size = times(size, one)
                return size
            if node.attr == "shape":
                return Tuple(value.shape)
        self.refuse(node, f"'.{node.attr}'")

    def _tuple(self, node: ast.Tuple) -> Value:
        return Tuple(tuple(self.expression(item) for item in node.elts))

    def _unaryop(self, node: ast.UnaryOp) -> Value:
        a = self.number(node.operand)
        if isinstance(node.op, ast.Not):
            return truth(not a.value) if a.is_known else Number("bool", f"!{a.within(UNARY)}", UNARY)
        if isinstance(node.op, ast.USub):
            if a.is_known and a.kind != "real":
                return integer(-a.value)
            known = None if a.value is None else -a.value
            return Number(a.kind, f"-{a.within(UNARY + 1)}", UNARY, known)
        if isinstance(node.op, ast.Invert):
            return integer(~a.value) if a.is_known else Number(a.kind, f"~{a.within(UNARY + 1)}", UNARY)
        self.refuse(node, "this sign")

    def _binop(self, node: ast.BinOp) -> Value:
        return self.operate(node, self.number(node.left), node.op, self.number(node.right))

    def operate(self, node: ast.AST, a: Number, op: ast.operator, b: Number) -> Number:
        """Two numbers and an operator."""
        whole = "real" not in (a.kind, b.kind)
        if isinstance(op, ast.Pow):
            if not (a.is_known and b.is_known):
                self.refuse(node, "a power of numbers that are not known")
            return integer(a.value**b.value) if whole else real(a.value**b.value)
        if isinstance(op, ast.Div):
            left = (
                f"({self.program.c_type('real', is_math=self.small)}){a.within(UNARY)}" if whole else a.within(PRODUCT)
            )
            return Number("real", f"{left} / {b.within(UNARY)}", PRODUCT)
        if isinstance(op, ast.Mod | ast.FloorDiv):
            return self._divided(node, a, b, isinstance(op, ast.Mod), whole)
        kind = joined(a.kind, b.kind, "int")
        if isinstance(op, ast.LShift):
            is_known = a.is_known and b.is_known
            return integer(a.value << b.value) if is_known else Number("long", f"mmnn_shifted({a.text}, {b.text})")
        if type(op) not in ARITHMETIC:
            self.refuse(node, f"'{type(op).__name__}'")
        sign, binds, work = ARITHMETIC[type(op)]
        if whole and a.is_known and b.is_known:
            return integer(work(a.value, b.value))
        if whole and binds in (SUM, PRODUCT):
            return {"+": plus, "-": minus, "*": times}[sign](a, b)
        if binds == 3:
            if sign == "&" and b.is_known and 0 <= b.value < NARROW:
                if kind == "long":
                    return Number("int", f"(int32_t)({a.within(ATOM)} & {b.within(ATOM)})", UNARY)
                kind = "int"
            return Number(kind, f"{a.within(ATOM)} {sign} {b.within(ATOM)}", binds)
        return Number(kind, f"{a.within(binds)} {sign} {b.within(binds + 1)}", binds)

    def _divided(self, node: ast.AST, a: Number, b: Number, rest: bool, whole: bool) -> Number:
        """`%` and `//`, with the sign of the divisor."""
        if not whole:
            if not rest:
                self.refuse(node, "'//' of floating-point numbers")
            return Number("real", f"mmnn_modulo({a.text}, {b.text})")
        if a.is_known and b.is_known:
            return integer(a.value % b.value if rest else a.value // b.value)
        kind = joined(a.kind, b.kind, "int")
        return Number(kind, f"mmnn_{'rest' if rest else 'quotient'}_{kind}({a.text}, {b.text})")

    def _compare(self, node: ast.Compare) -> Value:
        left, parts = self.expression(node.left), list[Number]()
        for i, (op, right_node) in enumerate(zip(node.ops, node.comparators, strict=True)):
            right = self.expression(right_node)
            if i + 1 < len(node.ops) and isinstance(right, Number) and "(" in right.text:
                right = self.fresh(right)
            parts.append(self._compared(node, left, op, right))
            left = right
        return self.all_of(parts)

    def _compared(self, node: ast.Compare, a: Value, op: ast.cmpop, b: Value) -> Number:
        if isinstance(op, ast.Is | ast.IsNot):
            same = isinstance(a, Static) and isinstance(b, Static) and a.object is b.object
            return truth(same == isinstance(op, ast.Is))
        if isinstance(op, ast.In) and isinstance(a, Number) and isinstance(b, Tuple):
            parts = [self._compared(node, a, ast.Eq(), item) for item in b.items]
            return self.any_of(parts)
        if isinstance(a, Static) and isinstance(b, Static) and isinstance(op, ast.Eq | ast.NotEq):
            return truth((a.object == b.object) == isinstance(op, ast.Eq))
        if not (isinstance(a, Number) and isinstance(b, Number)) or type(op) not in COMPARISONS:
            self.refuse(node, "this comparison")
        sign, work = COMPARISONS[type(op)]
        if a.is_known and b.is_known:
            return truth(work(a.value, b.value))
        return Number("bool", f"{a.within(COMPARE + 1)} {sign} {b.within(COMPARE + 1)}", COMPARE)

    def all_of(self, parts: list[Number]) -> Number:
        """All of these, as far as they are not known."""
        if any(part.is_known and not part.value for part in parts):
            return truth(False)
        open_ = [part for part in parts if not part.is_known]
        if len(open_) <= 1:
            return open_[0] if open_ else truth(True)
        return Number("bool", " && ".join(part.within(AND + 1) for part in open_), AND)

    def _boolop(self, node: ast.BoolOp) -> Value:
        is_and, parts = isinstance(node.op, ast.And), list[Number]()
        for item in node.values:
            part = self.number(item)
            if part.is_known and bool(part.value) != is_and:
                parts.append(part)
                break
            parts.append(part)
        if is_and:
            return self.all_of(parts)
        return self.any_of(parts)

    def any_of(self, parts: list[Number]) -> Number:
        """Any of these, as far as they are not known."""
        if parts[-1].is_known and parts[-1].value and all(p.is_known for p in parts[:-1]):
            return truth(True)
        open_ = [part for part in parts if not (part.is_known and not part.value)]
        if len(open_) <= 1:
            return open_[0] if open_ else truth(False)
        return Number("bool", " || ".join(part.within(COMPARE) for part in open_), OR)

    def _ifexp(self, node: ast.IfExp) -> Value:
        test = self.number(node.test)
        if test.is_known:
            return self.expression(node.body if test.value else node.orelse)
        if isinstance(node.body, ast.Tuple) and test.binds != ATOM:
            test = self.fresh(test)
        return self.chosen(node, test, self.expression(node.body), self.expression(node.orelse))

    def chosen(self, node: ast.AST, test: Number, a: Value, b: Value) -> Value:
        """One of two values."""
        if isinstance(a, Tuple) and isinstance(b, Tuple) and len(a.items) == len(b.items):
            return Tuple(tuple(self.chosen(node, test, x, y) for x, y in zip(a.items, b.items, strict=True)), a.of)
        if isinstance(a, Vec | Static | Tuple) and isinstance(b, Vec | Static | Tuple):
            x, y = self.vec(node, a), self.vec(node, b)
            return Vec(f"({test.within(CHOICE + 1)} ? {x.text} : {y.text})", x.size)
        if isinstance(a, Number) and isinstance(b, Number):
            if a == b:
                return a
            text = f"{test.within(CHOICE + 1)} ? {a.within(CHOICE + 1)} : {b.within(CHOICE)}"
            return Number(joined(a.kind, b.kind), text, CHOICE)
        if (
            isinstance(a, ArrayValue)
            and isinstance(b, ArrayValue)
            and a.kind == b.kind
            and len(a.shape) == len(b.shape)
        ):
            if a == b:
                return a
            pairs = zip(a.shape, b.shape, strict=True)
            shape = tuple(self._plain(node, self.chosen(node, test, x, y)) for x, y in pairs)
            if "A" in (a.layout, b.layout) or a.layout != b.layout:
                self.refuse(node, "a choice of arrays with strides of their own")
            strides = row_strides(shape) if a.layout == "C" else tuple(reversed(row_strides(shape[::-1])))
            text = f"{test.within(CHOICE + 1)} ? {self.address(a)} : {self.address(b)}"
            pointer = self.pointer(text, a.kind, tuple(x.alias or x.base for x in (a, b)))
            return ArrayValue(pointer, integer(0), shape, strides, a.kind)
        self.refuse(node, "a choice of these")

    def vec(self, node: ast.AST, value: Value) -> Vec:
        """Numbers side by side as one struct."""
        if isinstance(value, Vec):
            return value
        if isinstance(value, Static) and isinstance(value.object, tuple):
            value = Tuple(tuple(self.program.lifted(x) for x in value.object))
        if isinstance(value, Tuple) and all(isinstance(item, Number) for item in value.items):
            size = len(value.items)
            return Vec(
                f"MMNN_OF({self.program.vec(size, self.small)}){{{{{', '.join(item.text for item in value.items)}}}}}",
                size,
            )
        self.refuse(node, "this in the place of a few numbers")

    def base(self, array: ArrayValue) -> str:
        """The text of where an array's memory begins."""
        if array.alias is not None:
            return array.alias.name
        return self.program.text_of(array.base) if isinstance(array.base, Root) else array.base.name

    def address(self, array: ArrayValue) -> str:
        """The text of a pointer to an array's first number."""
        offset = integer(0) if array.alias is not None else array.offset
        return self.base(array) if offset.value == 0 else f"{self.base(array)} + {offset.within(SUM)}"

    def element(self, array: ArrayValue, place: Number) -> Number:
        """A number of an array."""
        value, everywhere = None, ""
        if isinstance(array.base, Root) and array.base.parts:  # it lies in several members
            one = replace(
                array, offset=plus(array.offset, place), shape=(integer(1),), strides=(integer(1),), alias=None
            )
            array, place = self.program.part_of(one), integer(0)
            if array.base.parts:  # type: ignore[union-attr]
                raise NeedsUnrolling(one.offset.text)
        if isinstance(array.base, Root) and (array.offset.is_known and place.is_known):
            at = array.offset.value + place.value
            value = self.program.constant(array.base, at)
            if value is not None and array.kind == "int":
                return self.program.known_integer(array.base, at)
            everywhere = f"{self.program.text_of(array.base)}[{at}]"
        if isinstance(array.base, Root) and self.program.is_nothing(array.base):
            return real(0.0)
        text = f"{self.base(array)}[{place.text if array.alias else plus(array.offset, place).text}]"
        kind = array.kind if array.kind == "real" or not self.small else "long"
        if kind == "long":
            text = f"(int64_t){text}"
        return Number(kind, text, ATOM if kind != "long" else UNARY, value, everywhere if value is not None else "")

    def _subscript(self, node: ast.Subscript) -> Value:
        value = self.expression(node.value)
        items = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if isinstance(value, ArrayValue):
            return self.part(node, value, items)
        if isinstance(value, Static) and isinstance(value.object, dict):
            key = self.expression(items[0])
            return self.program.lifted(value.object[key.object if isinstance(key, Static) else key])
        place = self.number(items[0])
        if isinstance(value, Tuple) and place.is_known:
            item: Value = value.items[place.value]
            return item
        if isinstance(value, Static) and isinstance(value.object, tuple):
            if place.is_known:
                return self.program.lifted(value.object[place.value], f"{value.name}_{place.value}")
            return self.element(self.program.table(value.object, value.name), place)
        vec = self.vec(node, value)
        if not is_name(vec.text):
            vec = self.fresh(vec)
        return Number("real", f"{vec.text}.v[{place.text}]")

    def part(self, node: ast.AST, array: ArrayValue, items: list[ast.expr]) -> Value:
        """A number of an array, or a part of it."""
        offset, shape, strides = integer(0), list[Number](), list[Number]()
        for i, (size, stride) in enumerate(zip(array.shape, array.strides, strict=True)):
            item = items[i] if i < len(items) else ast.Slice()
            if isinstance(item, ast.Slice):
                if item.step is not None:
                    self.refuse(node, "a slice with a step")
                first = integer(0) if item.lower is None else self._from(self.number(item.lower), size)
                last = size if item.upper is None else self._from(self.number(item.upper), size)
                if last.is_known and size.is_known:
                    last = integer(min(last.value, size.value), last.text)
                offset = plus(offset, times(first, stride))
                shape.append(minus(last, first))
                strides.append(stride)
            else:
                offset = plus(offset, times(self._from(self.number(item), size), stride))
        if not shape:
            return self.element(array, offset)
        return self.placed(array, offset, tuple(shape), tuple(strides))

    def _from(self, index: Number, size: Number) -> Number:
        return plus(size, index) if index.is_known and index.value < 0 else index

    def placed(
        self, array: ArrayValue, offset: Number, shape: tuple[Number, ...], strides: tuple[Number, ...]
    ) -> ArrayValue:
        """A part of an array that begins at an offset."""
        alias = array.alias if offset.value == 0 else None
        if array.alias is not None and not isinstance(array.base, Root):
            array = replace(array, base=array.alias, offset=integer(0))
        found = ArrayValue(array.base, plus(array.offset, offset), shape, strides, array.kind, alias)
        if array.offset.value == 0 and offset.is_known and offset.text != str(offset.value):
            found = replace(found, offset=offset)
        if isinstance(found.base, Root) and found.base.parts:
            found = self.program.part_of(found)
            numbers = found.offset, *found.shape, *found.strides
            if found.base.parts and not all(one.is_known for one in numbers):  # type: ignore[union-attr]
                raise NeedsUnrolling(offset.text)
        return found

    # -- calls ---------------------------------------------------------------------------------------------------------

    def _call(self, node: ast.Call) -> Value:
        if isinstance(node.func, ast.Attribute) and node.func.attr == "reshape":
            array = self.expression(node.func.value)
            if isinstance(array, ArrayValue):
                return self._reshaped(node, array)
        function = self.expression(node.func)
        if not isinstance(function, Static):
            self.refuse(node, "a call of this")
        given = self._arguments(node)
        callee = function.object
        if callee in OWN:
            return OWN[callee](self, node, given)
        if callee in MATH:
            name, kind = MATH[callee]
            return Number(kind, f"{name}({', '.join(self._plain(node, value).text for value in given)})")
        if isinstance(callee, type) and hasattr(callee, "_fields"):
            return Tuple(tuple(given), callee)
        return self._function(node, callee, given)

    def _arguments(self, node: ast.Call) -> list[Value]:
        given = list[Value]()
        for item in node.args:
            if isinstance(item, ast.Starred):
                given += self.items(item, self.expression(item.value))
            else:
                given.append(self.expression(item))
        if node.keywords:
            self.refuse(node, "an argument by name")
        return given

    def _plain(self, node: ast.AST, value: Value) -> Number:
        if not isinstance(value, Number):
            self.refuse(node, f"{type(value).__name__.lower()} in the place of a number")
        return value

    def _reshaped(self, node: ast.Call, array: ArrayValue) -> ArrayValue:
        shape = self.items(node, self.expression(node.args[0]))
        sizes = tuple(self._plain(node, size) for size in shape)
        return replace(array, shape=sizes, strides=row_strides(sizes))

    def _function(self, node: ast.Call, callee: Any, given: list[Value]) -> Value:
        """A call of a function of ours, or of a method of a known object."""
        if inspect.ismethod(callee) or (hasattr(callee, "__func__") and hasattr(callee, "__self__")):
            owner = callee.__self__
            given, callee = [Static(owner, self.program.name_of(owner)), *given], callee.__func__
        function = getattr(callee, "py_func", callee)
        if not inspect.isfunction(function):
            self.refuse(node, f"a call of {callee!r}")
        source = self.program.source(function)
        arguments = self._named(node, source, function, given)
        body = [s for s in source.node.body if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))]
        if body and isinstance(body[-1], ast.Return) and all(isinstance(one, ast.Assign) for one in body[:-1]):
            before, is_known = len(self.lines), all(map(is_constant, arguments.values()))
            if not returns_numbers(source.node):
                return self._spliced(source, arguments, body)
            if len(body) == 1 and is_known:
                found = self._spliced(source, arguments, body)
                if isinstance(found, Number) and found.is_known:
                    return found
                del self.lines[before:]
        return self._to_c(node, source, arguments)

    def _named(self, node: ast.Call, source: FunctionSource, function: Any, given: list[Value]) -> dict[str, Value]:
        names = [a.arg for a in source.node.args.args]
        defaults = function.__defaults__ or ()
        lacking = len(names) - len(given)
        if lacking < 0 or lacking > len(defaults):
            self.refuse(node, f"a call with {len(given)} arguments of '{source.node.name}'")
        given = given + [self.program.lifted(x) for x in defaults[len(defaults) - lacking :]] if lacking else given
        annotations = {a.arg: ast.unparse(a.annotation) for a in source.node.args.args if a.annotation is not None}
        for i, (name, value) in enumerate(zip(names, given, strict=True)):
            if isinstance(value, Static) and type(value.object) is tuple and value.object:
                if all(isinstance(x, float) for x in value.object):
                    is_table = "..." in annotations.get(name, "")
                    given[i] = self.program.table(value.object, value.name) if is_table else self.vec(node, value)
            elif isinstance(value, Tuple) and value.of is None and all(isinstance(x, Number) for x in value.items):
                given[i] = self.vec(node, value)
        return dict(zip(names, given, strict=True))

    def _spliced(self, source: FunctionSource, arguments: dict[str, Value], body: list[ast.stmt]) -> Value:
        """A function that gives an array or a tuple of them: its expression, in the place of the call."""
        last = body[-1]
        assert isinstance(last, ast.Return) and last.value is not None
        kept = self.scope, self.names, self.source
        self.scope, self.names, self.source = source.scope, arguments, source
        try:
            self.statements(body[:-1])
            return self.expression(last.value)
        finally:
            self.scope, self.names, self.source = kept

    def _to_c(self, node: ast.Call, source: FunctionSource, arguments: dict[str, Value]) -> Value:
        record = self.program.function(source, arguments)
        texts = ["self"] if record.uses_self else []
        parts = [leaf for name, value in arguments.items() for leaf in leaves(value, name)]
        if record.result is None and not record.uses_self and self._is_lost(record, parts):
            return Static(None)
        for name, part, array in parts:
            parameter = record.parameters.get(name)
            if parameter is None:
                continue
            if array is not None:
                if isinstance(parameter.pointer, Pointer) and parameter.pointer.is_written:
                    self.program.write(array)
                texts.append(self.address(array))
            else:
                texts.append(part.text)  # type: ignore[union-attr]
        text = f"{record.name}({', '.join(texts)})"
        result = record.result
        if isinstance(result, str):
            return Number(result, text)
        if isinstance(result, int):
            is_converted = record.is_math and not self.small and self.program.real != "double"
            return Vec(f"mmnn_to_single{result}({text})" if is_converted else text, result)
        if isinstance(result, tuple):
            return self._record(text, result)
        if not record.is_empty:
            self.lines.append(f"{text};")
        return Static(None)

    def _is_lost(self, record: CFunction, parts: list[Any]) -> bool:
        """Whether a call writes, and only what is left out."""
        given = [(record.parameters.get(name), array) for name, _, array in parts]
        into = [array for p, array in given if p is not None and p.pointer is not None and p.pointer.is_written]
        return bool(into) and all(self.program.is_dropped(array.base) for array in into)

    def _length(self, node: ast.Call, given: list[Value]) -> Value:
        value = given[0]
        if isinstance(value, ArrayValue):
            return value.shape[0]
        return integer(len(self.items(node, value)))

    def _absolute(self, node: ast.Call, given: list[Value]) -> Value:
        a = self._plain(node, given[0])
        if a.is_known and a.kind != "real":
            return integer(abs(a.value))
        return Number(a.kind, f"mmnn_{'absolute' if a.kind == 'real' else 'magnitude'}({a.text})")

    def _extreme(self, node: ast.Call, given: list[Value], which: str) -> Value:
        a, b = (self._plain(node, value) for value in given)
        if a.is_known and b.is_known and "real" not in (a.kind, b.kind):
            return integer((min if which == "min" else max)(a.value, b.value))
        kind = joined(a.kind, b.kind, "int")
        name = {"real": f"mmnn_{which}", "int": f"mmnn_{which}_int", "long": f"mmnn_{which}_long"}[kind]
        return Number(kind, f"{name}({a.text}, {b.text})")

    def _integer(self, node: ast.Call, given: list[Value]) -> Value:
        a = self._plain(node, given[0])
        if a.is_known:
            return integer(int(a.value))
        if a.kind != "real":
            return a
        kind = "int" if self.small else "long"
        return Number(kind, f"({'int32_t' if self.small else 'int64_t'}){a.within(UNARY)}", UNARY)

    def _floating(self, node: ast.Call, given: list[Value]) -> Value:
        a = self._plain(node, given[0])
        if a.kind == "real":
            return a
        if a.is_known:
            return real(float(a.value))
        return Number("real", f"({self.program.c_type('real', is_math=self.small)}){a.within(UNARY)}", UNARY)

    def _boolean(self, node: ast.Call, given: list[Value]) -> Value:
        a = self._plain(node, given[0])
        if a.is_known:
            return truth(bool(a.value))
        return a if a.kind == "bool" else Number("bool", f"{a.within(SUM)} != 0", 5)

    def _instance(self, node: ast.Call, given: list[Value]) -> Value:
        value, kinds = given
        if not (isinstance(value, Static) and isinstance(kinds, Static)):
            self.refuse(node, "'isinstance' of this")
        return truth(isinstance(value.object, kinds.object))

    def _type(self, node: ast.Call, given: list[Value]) -> Value:
        value = given[0]
        if isinstance(value, Static):
            return Static(type(value.object))
        if isinstance(value, Tuple) and value.of is not None:
            return Static(value.of)
        self.refuse(node, "'type' of this")


def as_kind(value: Number, kind: str) -> Number:
    """A number where one of a kind is stored: a known integer is written as a floating-point number."""
    return real(float(value.value)) if kind == "real" and value.is_known and value.kind != "real" else value


def is_name(text: str) -> bool:
    """Whether a text is a name, or a member of something that has one."""
    return text.replace(".", "").isidentifier()


def reads(value: Tuple) -> bool:
    """Whether a tuple is of real numbers that are not known: what they are read from may be written later."""
    numbers = [item for item in value.items if isinstance(item, Number) and item.kind == "real"]
    return value.of is None and len(numbers) == len(value.items) and not all(item.is_known for item in numbers)


def is_constant(value: Value) -> bool:
    """Whether nothing about a value is left to be found out."""
    return isinstance(value, Static) or (isinstance(value, Number) and value.is_known)


def returns_numbers(node: ast.FunctionDef) -> bool:
    """Whether a function says that it gives numbers, side by side or one."""
    said = "" if node.returns is None else ast.unparse(node.returns)
    return said in ("float", "int", "bool", "Vector", "None") or said.startswith("tuple")


OWN: dict[Any, Callable[[Any, ast.Call, list[Value]], Value]] = {
    len: FunctionBody._length, abs: FunctionBody._absolute, int: FunctionBody._integer,
    min: partial(FunctionBody._extreme, which="min"), max: partial(FunctionBody._extreme, which="max"),
    float: FunctionBody._floating, bool: FunctionBody._boolean,
    isinstance: FunctionBody._instance, type: FunctionBody._type,
}  # fmt: skip


def write(
    program: CProgram,
    record: CFunction,
    source: FunctionSource,
    names: dict[str, Value],
    possible: dict[str, Parameter],
) -> None:
    """Translate one function.

    Args:
        program: That it belongs to.
        record: What is to be filled in.
        source: Its text.
        names: What its arguments stand for.
        possible: Parameters that they may become, by name.
    """
    body = FunctionBody(program, source, names)
    lines = body.translate()
    record.result = body.result
    finished(program, record, possible, lines, body.kinds, body.pointers)
