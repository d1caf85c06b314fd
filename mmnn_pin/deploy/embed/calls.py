"""Calls: Python's own functions, those of `math`, named tuples, and functions that become functions in C."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from .expressions import MATH, Expressions
from .program import Function
from .source import Source
from .values import (
    SUM,
    UNARY,
    Array,
    Number,
    Pointer,
    Static,
    Tuple,
    Value,
    Vec,
    integer,
    joined,
    leaves,
    real,
    row_strides,
    truth,
)  # fmt: skip


class Calls(Expressions):
    """The calls in one function."""

    source: Source

    def call(self, node: ast.Call) -> Value:
        """What a call is worth."""
        return self._call(node)

    def _call(self, node: ast.Call) -> Value:
        if isinstance(node.func, ast.Attribute) and node.func.attr == "reshape":
            array = self.expression(node.func.value)
            if isinstance(array, Array):
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

    def items(self, node: ast.AST, value: Value) -> list[Value]:
        """The values that a tuple is made of."""
        raise NotImplementedError

    def _plain(self, node: ast.AST, value: Value) -> Number:
        if not isinstance(value, Number):
            self.refuse(node, "this in the place of a number")
        return value

    def _reshaped(self, node: ast.Call, array: Array) -> Array:
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
            before, is_known = len(self.lines), all(map(known, arguments.values()))
            if not returns_numbers(source.node):
                return self._spliced(source, arguments, body)
            if len(body) == 1 and is_known:
                found = self._spliced(source, arguments, body)
                if isinstance(found, Number) and found.is_known:
                    return found
                del self.lines[before:]
        return self._to_c(node, source, arguments)

    def _named(self, node: ast.Call, source: Source, function: Any, given: list[Value]) -> dict[str, Value]:
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

    def _spliced(self, source: Source, arguments: dict[str, Value], body: list[ast.stmt]) -> Value:
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

    def statements(self, nodes: list[ast.stmt]) -> bool:
        """Statements one after the other; whether what follows them is reached."""
        raise NotImplementedError

    def _to_c(self, node: ast.Call, source: Source, arguments: dict[str, Value]) -> Value:
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

    def _is_lost(self, record: Function, parts: list[Any]) -> bool:
        """Whether a call writes, and only what is left out."""
        given = [(record.parameters.get(name), array) for name, _, array in parts]
        into = [array for p, array in given if p is not None and p.pointer is not None and p.pointer.is_written]
        return bool(into) and all(self.program.is_dropped(array.base) for array in into)

    def _record(self, text: str, kinds: tuple[str, ...]) -> Tuple:
        """Numbers of several kinds that a function returns."""
        raise NotImplementedError

    # -- Python's own --------------------------------------------------------------------------------------------------

    def _length(self, node: ast.Call, given: list[Value]) -> Value:
        value = given[0]
        if isinstance(value, Array):
            return value.shape[0]
        return integer(len(self.items(node, value)))

    def _absolute(self, node: ast.Call, given: list[Value]) -> Value:
        a = self._plain(node, given[0])
        if a.is_known and a.kind != "real":
            return integer(abs(a.value))
        return Number(a.kind, f"mmnn_{'absolute' if a.kind == 'real' else 'magnitude'}({a.text})")

    def _smaller(self, node: ast.Call, given: list[Value]) -> Value:
        return self._extreme(node, given, "min")

    def _larger(self, node: ast.Call, given: list[Value]) -> Value:
        return self._extreme(node, given, "max")

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


def known(value: Value) -> bool:
    """Whether nothing about a value is left to be found out."""
    return isinstance(value, Static) or (isinstance(value, Number) and value.is_known)


def returns_numbers(node: ast.FunctionDef) -> bool:
    """Whether a function says that it gives numbers, side by side or one."""
    said = "" if node.returns is None else ast.unparse(node.returns)
    return said in ("float", "int", "bool", "Vector", "None") or said.startswith("tuple")


OWN: dict[Any, Callable[[Any, ast.Call, list[Value]], Value]] = {
    len: Calls._length, abs: Calls._absolute, min: Calls._smaller, max: Calls._larger, int: Calls._integer,
    float: Calls._floating, bool: Calls._boolean, isinstance: Calls._instance, type: Calls._type,
}  # fmt: skip
