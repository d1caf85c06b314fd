"""From the lines of a function to its text: local variables declared where they belong, parameters that are used."""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass, field
from typing import Any

from .program import CFunction, CProgram, Parameter
from .source import comment
from .values import Pointer

INDENT = "    "
WIDTH = 110


@dataclass
class Assign:
    """A line that gives a local variable its value."""

    name: str
    text: str


@dataclass
class CodeBlock:
    """Lines in braces."""

    head: str
    lines: list[Any] = field(default_factory=list)
    is_loop: bool = False


def mentions(item: Any, name: str) -> bool:
    """Whether a line, or what is in a block, mentions a name."""
    if isinstance(item, CodeBlock):
        return bool(found(item.head, name)) or any(mentions(line, name) for line in item.lines)
    if isinstance(item, Assign):
        return item.name == name or bool(found(item.text, name))
    return bool(found(item, name))


def found(text: str, name: str) -> re.Match[str] | None:
    """A name in a text, as a word that is no member of something."""
    return re.search(rf"(?<![\w.>]){re.escape(name)}\b", text)


def is_read(lines: list[Any], name: str) -> bool:
    """Whether a variable is ever used, and not only written."""
    for item in lines:
        if isinstance(item, CodeBlock):
            if found(item.head, name) or is_read(item.lines, name):
                return True
        elif found(item.text if isinstance(item, Assign) else item, name):
            return True
    return False


def without(lines: list[Any], name: str) -> list[Any]:
    """Lines without those that write a variable."""
    kept = list[Any]()
    for item in lines:
        if isinstance(item, CodeBlock):
            item.lines = without(item.lines, name)
            if not item.lines and not item.head.startswith("if") and "while" not in item.head:
                continue
        elif isinstance(item, Assign) and item.name == name:
            if "(" in item.text and re.search(
                r"\w\(", item.text.replace("MMNN_OF(", "").replace("mmnn_", "").replace("real)", "")
            ):
                kept.append(f"(void)({item.text});")
            continue
        kept.append(item)
    return kept


def declare(lines: list[Any], name: str, c_type: str, initial: str) -> None:
    """Declare a variable in the innermost block that has all its uses, with its first value where that can be."""
    places = [i for i, item in enumerate(lines) if mentions(item, name)]
    if not places:
        return
    first = lines[places[0]]
    is_inside = len(places) == 1 and isinstance(first, CodeBlock) and not found(first.head, name)
    if is_inside and (not first.is_loop or begins(first.lines, name)):
        declare(first.lines, name, c_type, initial)
        return
    space = "" if c_type.endswith("*") else " "
    if isinstance(first, Assign) and first.name == name and not found(first.text, name):
        lines[places[0]] = f"{c_type}{space}{name} = {first.text};"
    else:
        lines.insert(places[0], f"{c_type}{space}{name} = {initial};")


def begins(lines: list[Any], name: str) -> bool:
    """Whether the first line that mentions a variable gives it a value, in this block or a block within it."""
    for item in lines:
        if mentions(item, name):
            if isinstance(item, CodeBlock):
                return not found(item.head, name) and begins(item.lines, name)
            return isinstance(item, Assign) and not found(item.text, name)
    return False


def finished(
    program: CProgram,
    record: CFunction,
    possible: dict[str, Parameter],
    lines: list[Any],
    kinds: dict[str, Any],
    pointers: dict[str, Pointer],
) -> None:
    """Give a function its parameters, its head and its text.

    Args:
        program: That it belongs to.
        record: The function, with its result.
        possible: Parameters that it may have, by name.
        lines: Of its body.
        kinds: Of its local variables, by name.
        pointers: Those of them that are pointers.
    """
    changed = True
    while changed:  # a pointer that is not used may have been all that another one was for
        changed = False
        for name in list(kinds):
            if name not in possible and any(mentions(line, name) for line in lines) and not is_read(lines, name):
                lines, changed = without(lines, name), True
    record.parameters = {name: p for name, p in possible.items() if any(mentions(line, name) for line in lines)}
    for name, kind in kinds.items():
        if name not in possible:
            pointer = pointers.get(name)
            initial = initial_of(kind)
            declare(
                lines,
                name,
                program.c_type(kind, pointer is not None and not pointer.is_written, record.is_math),
                initial,
            )
    text = "\n".join(rendered(lines, 1))
    record.uses_self = bool(re.search(r"\bself\b", text))
    record.is_empty = not text.strip()
    result = "void" if record.result is None else program.c_type(record.result, is_math=record.is_math)
    given = ["mmnn_controller *self"] if record.uses_self else []
    given += [parameter_text(program, p, record.is_math) for p in record.parameters.values()]
    record.head = f"{result} {record.name}({', '.join(given) or 'void'})"
    record.text = text if record.is_math else program.literals(text)
    record.comment = comment(record.source)


def initial_of(kind: Any) -> str:
    """The first value of a variable of a kind, as C has it."""
    if isinstance(kind, str):
        return {"bool": "false", "real": "0.0"}.get(kind, "0")
    return "{{0}}" if isinstance(kind, int) else "NULL" if kind[0] == "pointer" else "{0}"


def parameter_text(program: CProgram, parameter: Parameter, is_math: bool) -> str:
    """The declaration of a parameter."""
    is_const = parameter.pointer is not None and not parameter.pointer.is_written
    c_type = program.c_type(parameter.kind, is_const, is_math)
    return f"{c_type}{'' if c_type.endswith('*') else ' '}{parameter.name}"


def rendered(lines: list[Any], depth: int) -> list[str]:
    """Lines with their indentation, long ones broken."""
    out = list[str]()
    for item in lines:
        if isinstance(item, CodeBlock):
            out += block(item, depth, out)
        else:
            text = f"{item.name} = {item.text};" if isinstance(item, Assign) else item
            out += wrapped(text, depth)
    return out


def block(item: CodeBlock, depth: int, before: list[str]) -> list[str]:
    """A block; one that begins with 'else' goes on where the last line was, and takes up a branch that it only has."""
    indent = INDENT * depth
    inner = item.lines[0] if item.lines else None
    is_chain = all(isinstance(other, CodeBlock) and other.head.startswith("else") for other in item.lines[1:])
    if item.head == "else" and is_chain and isinstance(inner, CodeBlock) and inner.head.startswith("if "):
        chain = rendered([CodeBlock(f"else {inner.head}", inner.lines), *item.lines[1:]], depth)
        before[-1] = f"{indent}}} {chain[0].strip()}"
        return chain[1:]
    head = f"{item.head} {{" if item.head else "{"
    body = rendered(item.lines, depth + 1)
    if item.head.startswith("else") and before:
        before[-1] = f"{indent}}} {head}"
        return [*body, f"{indent}}}"]
    return [*wrapped(head, depth), *body, f"{indent}}}"]


def wrapped(text: str, depth: int) -> list[str]:
    """A line of at most `WIDTH` characters, or several."""
    return textwrap.wrap(
        text, WIDTH, initial_indent=INDENT * depth, subsequent_indent=INDENT * (depth + 1), break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip
