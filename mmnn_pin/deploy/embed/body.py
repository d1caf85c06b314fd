"""The body of one function: its statements as lines of C.

A name that is bound once to something known stands for that and is not written. Every other name becomes a local
variable of one kind, declared where it is first written, in the innermost block that has all its uses. Loops over a
few known numbers are unrolled only where the memory that they reach must be known.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NoReturn

from ...errors import InputError
from .calls import Calls
from .expressions import NeedsUnrolling
from .values import (
    ATOM, SUM, UNARY, Array, Number, Pointer, Root, Static, Tuple, Value, Vec, integer, joined, plus, real,
)  # fmt: skip

if TYPE_CHECKING:
    from .program import Function, Program

RESERVED = {"self", "fill", "double", "float", "int", "long", "short", "register", "auto", "signed", "default", "switch"}
UNROLLED = 16  # most turns of a loop that is written out


@dataclass
class Assign:
    """A line that gives a local variable its value."""

    name: str
    text: str


@dataclass
class Block:
    """Lines in braces."""

    head: str
    lines: list[Any] = field(default_factory=list)
    is_loop: bool = False


def as_kind(value: Number, kind: str) -> Number:
    """A number where one of a kind is stored: a known integer is written as a floating-point number."""
    return real(float(value.value)) if kind == "real" and value.is_known and value.kind != "real" else value


class Untranslatable(InputError):
    """Something in a function that cannot be said in C."""


@dataclass
class Source:
    """A function of Python, its text and what its names mean."""

    function: Any
    node: ast.FunctionDef
    file: str
    first: int
    scope: dict[str, Any]
    stores: Counter[str]


def source_of(function: Any) -> Source:
    """Text and scope of a function; of one that has no text (made by `compiled.spelled`) its only expression."""
    code = function.__code__
    scope = dict(function.__globals__)
    if function.__closure__:
        scope |= dict(zip(code.co_freevars, (cell.cell_contents for cell in function.__closure__), strict=True))
    if code.co_filename.startswith("<"):
        text, first = scope["__source__"], 1
    else:
        lines, first = inspect.getsourcelines(function)
        text = inspect.cleandoc("\n" + "".join(lines)) if lines[0][0] == " " else "".join(lines)
        text = _dedented(lines)
    node = ast.parse(text).body[0]
    assert isinstance(node, ast.FunctionDef)
    found = Counter(n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store))
    found.update(n.target.id for n in ast.walk(node) if isinstance(n, ast.AugAssign) and isinstance(n.target, ast.Name))
    return Source(function, node, code.co_filename, first, scope, found)


def _dedented(lines: list[str]) -> str:
    indent = len(lines[0]) - len(lines[0].lstrip())
    return "".join(line[indent:] if line[:indent].isspace() else line for line in lines)


class Body(Calls):
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
        if isinstance(value, Tuple) and all(isinstance(item, Number) for item in value.items):
            kind = tuple(item.kind for item in value.items)
            if self.result is not None:
                kind = tuple(joined(a, b) for a, b in zip(self._each(self.result), kind, strict=True))
            kind = len(kind) if set(kind) == {"real"} else kind
            if isinstance(kind, tuple):
                name = self.program.record_type(kind)
                text = f"({name}){{{', '.join(item.text for item in value.items)}}}"
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
        """The same with a type."""
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
            whole = value if value.text.isidentifier() else self.fresh(value)
            assert isinstance(whole, Vec)
            return [Number("real", f"{whole.text}.v[{i}]") for i in range(whole.size)]
        self.refuse(node, "several names for this")

    def _to_name(self, target: ast.Name, value: Value, written_out: bool) -> None:
        name, once = target.id, written_out or self.source.stores[target.id] == 1
        if isinstance(value, Number) and not (once and value.is_known):
            self._to_variable(name, value)
        elif isinstance(value, Vec):
            self._to_variable(name, value)
        elif not once and isinstance(value, Tuple) and all(isinstance(x, Number) for x in value.items):
            self._to_variable(name, self.vec(target, value))
        elif not once:
            self.refuse(target, f"'{name}', which is several things,")
        elif isinstance(value, Array):
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

    def _aliased(self, name: str, array: Array) -> Array:
        """An array under a name of its own: a pointer, which is written only where it is used."""
        if array.alias is not None and array.alias.name == self.local(name):
            return array
        if not array.shape or (isinstance(array.base, Root) and array.base.parts):
            return array
        pointer = self.pointer(self.address(array), array.kind, (array.alias or array.base,), self.local(name))
        if isinstance(array.base, Root) and array.offset.is_known:
            return replace(array, alias=pointer)
        return Array(pointer, integer(0), array.shape, array.strides, array.kind)

    def _to_memory(self, target: ast.Subscript, value: Value) -> None:
        place = self.expression(target.value)
        if not isinstance(place, Array):
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
        assert isinstance(part, Array)
        self._fill(target, part, value)

    def _fill(self, target: ast.AST, part: Array, value: Value) -> None:
        """A number, or an array, into all places of an array whose rows stand one after the other."""
        size = integer(1)
        for one in part.shape:
            size = self.operate(target, size, ast.Mult(), one)
        if part.layout != "C" or (isinstance(value, Array) and (value.layout != "C" or len(value.shape) != 1)):
            self.refuse(target, "an assignment to an array like this")
        if not isinstance(value, Number | Array):
            self.refuse(target, "an assignment of this")
        self.program.write(part)
        i = self.local("fill")
        one = Number("int", i)
        text = self.element(value, one).text if isinstance(value, Array) else value.text
        into = self.element(part, one).text
        with self.block(f"for (int32_t {i} = 0; {i} < {size.text}; {i}++)", is_loop=True) as block:
            self.lines.append(f"{into} = {text};")
        if size.value != 0:
            self.lines.append(block)

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
        assert isinstance(place, Array)
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

    def fresh(self, value: Value, hint: str = "t") -> Value:
        """See `Expressions`."""
        self.counts[hint] += 1
        name = f"{hint}{self.counts[hint]}" if hint == "t" or self.counts[hint] > 1 else hint
        assert isinstance(value, Number | Vec)
        self.kinds[name] = value.kind if isinstance(value, Number) else value.size
        self.lines.append(Assign(name, value.text))
        return Number(value.kind, name) if isinstance(value, Number) else Vec(name, value.size)

    def pointer(self, text: str, kind: str, of: tuple[Any, ...], hint: str = "t") -> Pointer:
        """See `Expressions`."""
        if hint == "t":
            self.counts["t"] += 1
            hint = f"t{self.counts['t']}"
        pointer = self.pointers.setdefault(hint, Pointer(hint))
        pointer.of += of
        self.kinds[hint] = ("pointer", kind)
        self.lines.append(Assign(hint, text))
        return pointer

    def _record(self, text: str, kinds: tuple[str, ...]) -> Tuple:
        """See `Calls`."""
        self.counts["t"] += 1
        name = f"t{self.counts['t']}"
        self.kinds[name] = kinds
        self.lines.append(Assign(name, text))
        return Tuple(tuple(Number(kind, f"{name}.n{i}") for i, kind in enumerate(kinds)))
