"""Expressions of Python as expressions of C, with what is known worked out.

The text of a C expression has the operations of the Python expression in the same order and with the same rounding:
products and sums are never regrouped, `min` and `max` keep their first argument where a comparison fails, `%` has the
sign of the divisor.
"""

from __future__ import annotations

import ast
import builtins
import math
import operator
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np

from ...elementary.bits import bits_of, from_bits
from .program import Program
from .values import (
    AND,
    ATOM,
    CHOICE,
    COMPARE,
    OR,
    PRODUCT,
    SUM,
    UNARY,
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
    minus,
    plus,
    real,
    row_strides,
    times,
    truth,
)  # fmt: skip

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


class NeedsUnrolling(Exception):
    """A place in memory that is known only where a loop's variable is."""


class Expressions:
    """The expressions of one function.

    Attributes:
        program: What all functions share.
        scope: Globals and closure of the function.
        names: What its local names stand for.
        lines: Where text goes that has to stand before an expression.
        small: Whether its integers from floating-point numbers have 32 bits (see `program`).
    """

    program: Program
    scope: dict[str, Any]
    names: dict[str, Value]
    lines: list[Any]
    small: bool

    def refuse(self, node: ast.AST, what: str) -> NoReturn:
        """Stop: this cannot be said in C."""
        raise NotImplementedError

    def call(self, node: ast.Call) -> Value:
        """A call."""
        raise NotImplementedError

    def fresh(self, value: Value, hint: str = "t") -> Value:
        """A new local name for a value that is used more than once."""
        raise NotImplementedError

    def expression(self, node: ast.expr) -> Value:
        """What an expression is worth."""
        handler = getattr(self, f"_{type(node).__name__.lower()}", None)
        if handler is None:
            self.refuse(node, f"a {type(node).__name__}")
        value: Value = handler(node)
        return value

    def number(self, node: ast.expr) -> Number:
        """An expression that is one number."""
        value = self.expression(node)
        if not isinstance(value, Number):
            self.refuse(node, f"{type(value).__name__.lower()} in the place of a number")
        return value

    # -- leaves ----------------------------------------------------------------------------------------------------

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
        if isinstance(value, Array):
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

    # -- arithmetic ------------------------------------------------------------------------------------------------

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
            return integer(a.value << b.value) if a.is_known and b.is_known else self._shifted(a, b)
        if type(op) not in ARITHMETIC:
            self.refuse(node, f"'{type(op).__name__}'")
        sign, binds, work = ARITHMETIC[type(op)]
        if whole and a.is_known and b.is_known:
            return integer(work(a.value, b.value))
        if whole and binds in (SUM, PRODUCT):
            return {"+": plus, "-": minus, "*": times}[sign](a, b)
        if binds == 3:
            if sign == "&" and b.is_known and 0 <= b.value < NARROW:
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

    def _shifted(self, a: Number, b: Number) -> Number:
        return Number("long", f"mmnn_shifted({a.text}, {b.text})")

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
            test = self._number_of(self.fresh(test))
        return self.chosen(node, test, self.expression(node.body), self.expression(node.orelse))

    def _number_of(self, value: Value) -> Number:
        assert isinstance(value, Number)
        return value

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
        if isinstance(a, Array) and isinstance(b, Array) and a.kind == b.kind and len(a.shape) == len(b.shape):
            if a == b:
                return a
            shape = tuple(self._number_of(self.chosen(node, test, x, y)) for x, y in zip(a.shape, b.shape, strict=True))
            if "A" in (a.layout, b.layout) or a.layout != b.layout:
                self.refuse(node, "a choice of arrays with strides of their own")
            strides = row_strides(shape) if a.layout == "C" else tuple(reversed(row_strides(shape[::-1])))
            text = f"{test.within(CHOICE + 1)} ? {self.address(a)} : {self.address(b)}"
            pointer = self.pointer(text, a.kind, tuple(x.alias or x.base for x in (a, b)))
            return Array(pointer, integer(0), shape, strides, a.kind)
        self.refuse(node, "a choice of these")

    def pointer(self, text: str, kind: str, of: tuple[Any, ...], hint: str = "t") -> Pointer:
        """A new local pointer."""
        raise NotImplementedError

    def vec(self, node: ast.AST, value: Value) -> Vec:
        """Numbers side by side as one struct."""
        if isinstance(value, Vec):
            return value
        if isinstance(value, Static) and isinstance(value.object, tuple):
            value = Tuple(tuple(self.program.lifted(x) for x in value.object))
        if isinstance(value, Tuple) and all(isinstance(item, Number) for item in value.items):
            size = len(value.items)
            return Vec(
                f"({self.program.vec(size, self.small)}){{{{{', '.join(item.text for item in value.items)}}}}}", size
            )
        self.refuse(node, "this in the place of a few numbers")

    # -- places in memory --------------------------------------------------------------------------------------------

    def base(self, array: Array) -> str:
        """The text of where an array's memory begins."""
        if array.alias is not None:
            return array.alias.name
        return self.program.text_of(array.base) if isinstance(array.base, Root) else array.base.name

    def address(self, array: Array) -> str:
        """The text of a pointer to an array's first number."""
        offset = integer(0) if array.alias is not None else array.offset
        return self.base(array) if offset.value == 0 else f"{self.base(array)} + {offset.within(SUM)}"

    def element(self, array: Array, place: Number) -> Number:
        """A number of an array."""
        value, everywhere = None, ""
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
        if isinstance(value, Array):
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
        if not vec.text.replace(".", "").isidentifier():
            vec = self.fresh(vec)  # type: ignore[assignment]
        return Number("real", f"{vec.text}.v[{place.text}]")

    def part(self, node: ast.AST, array: Array, items: list[ast.expr]) -> Value:
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

    def placed(self, array: Array, offset: Number, shape: tuple[Number, ...], strides: tuple[Number, ...]) -> Array:
        """A part of an array that begins at an offset."""
        alias = array.alias if offset.value == 0 else None
        if array.alias is not None and not isinstance(array.base, Root):
            array = replace(array, base=array.alias, offset=integer(0))
        found = Array(array.base, plus(array.offset, offset), shape, strides, array.kind, alias)
        if array.offset.value == 0 and offset.is_known and offset.text != str(offset.value):
            found = replace(found, offset=offset)
        if isinstance(found.base, Root) and found.base.parts:
            found = self.program.part_of(found)
            if found.base.parts:  # type: ignore[union-attr]
                raise NeedsUnrolling(offset.text)
        return found
