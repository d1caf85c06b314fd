"""Assignments: to names, which are known things or local variables of C, and into memory."""

from __future__ import annotations

import ast
from collections import Counter
from dataclasses import replace
from typing import Any

from .calls import Calls
from .values import Array, Number, Pointer, Root, Static, Tuple, Value, Vec, integer, joined, real
from .writing import Assign, Block

RESERVED = {"self", "double", "float", "int", "long", "short", "register", "auto", "signed", "default", "switch"}


def as_kind(value: Number, kind: str) -> Number:
    """A number where one of a kind is stored: a known integer is written as a floating-point number."""
    return real(float(value.value)) if kind == "real" and value.is_known and value.kind != "real" else value


def is_name(text: str) -> bool:
    """Whether a text is a name, or a member of something that has one."""
    return text.replace(".", "").isidentifier()


class Assignments(Calls):
    """The assignments in one function.

    Attributes:
        kinds: Kinds of the local variables, as far as they are known.
        counts: How many new names begin alike.
        pointers: Local variables that are pointers.
    """

    kinds: dict[str, Any]
    counts: Counter[str]
    pointers: dict[str, Pointer]

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
            whole = value if is_name(value.text) else self.fresh(value)
            assert isinstance(whole, Vec)
            return [Number("real", f"{whole.text}.v[{i}]") for i in range(whole.size)]
        self.refuse(node, "several names for this")

    def _to_name(self, target: ast.Name, value: Value, written_out: bool) -> None:
        name, once = target.id, written_out or self.source.stores[target.id] == 1
        if (isinstance(value, Number) and not (once and value.is_known)) or isinstance(value, Vec):
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
        i = "at_"
        one = Number("int", i)
        text = self.element(value, one).text if isinstance(value, Array) else value.text
        into = self.element(part, one).text
        if size.value != 0:
            head = f"for (int32_t {i} = 0; {i} < {size.text}; {i}++)"
            self.lines.append(Block(head, [f"{into} = {text};"], is_loop=True))

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
        parts = (f"{name}.n{i}" for i in range(len(kinds)))
        return Tuple(
            tuple(Vec(p, k) if isinstance(k, int) else Number(k, p) for p, k in zip(parts, kinds, strict=True))
        )
