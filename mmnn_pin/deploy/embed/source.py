"""Functions of Python as text: their syntax trees, what their names mean, where their constants were defined."""

from __future__ import annotations

import ast
import inspect
import sys
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from ...errors import InputError


class Untranslatable(InputError):
    """Something in a function that cannot be said in C."""


@dataclass
class FunctionSource:
    """A function of Python, its text and what its names mean."""

    function: Any
    node: ast.FunctionDef
    file: str
    first: int
    scope: dict[str, Any]
    stores: Counter[str]


def source_of(function: Any) -> FunctionSource:
    """Text and scope of a function; of one that has no text (made by `parts.spelled`) its only expression."""
    code = function.__code__
    scope = dict(function.__globals__)
    if function.__closure__:
        scope |= dict(zip(code.co_freevars, (cell.cell_contents for cell in function.__closure__), strict=True))
    if code.co_filename.startswith("<"):
        text, first = scope["__source__"], 1
    else:
        lines, first = inspect.getsourcelines(function)
        text = _dedented(lines)
    node = ast.parse(text).body[0]
    assert isinstance(node, ast.FunctionDef)
    found = Counter(n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store))
    found.update(n.target.id for n in ast.walk(node) if isinstance(n, ast.AugAssign) and isinstance(n.target, ast.Name))
    return FunctionSource(function, node, code.co_filename, first, scope, found)


def _dedented(lines: list[str]) -> str:
    indent = len(lines[0]) - len(lines[0].lstrip())
    return "".join(line[indent:] if line[:indent].isspace() else line for line in lines)


@cache
def imported_from(module: str) -> dict[str, str]:
    """Names that a module of the package imports, and from where."""
    file = str(getattr(sys.modules.get(module), "__file__", None) or "")
    found = dict[str, str]()
    for node in ast.walk(ast.parse(Path(file).read_text())) if file and "mmnn_pin" in module else ():
        if isinstance(node, ast.ImportFrom) and node.level:
            parts = module.split(".") if file.endswith("__init__.py") else module.split(".")[:-1]
            base = parts[: len(parts) - node.level + 1]
            for alias in node.names:
                found[alias.asname or alias.name] = ".".join([*base, *([node.module] if node.module else [])])
    return found


def defined_in(module: str, name: str) -> str:
    """The module that a constant comes from, followed through imports."""
    while name in imported_from(module):
        module = imported_from(module)[name]
    return module


def comment(source: Any) -> str:
    """The docstring of a function as a comment, with where it comes from."""
    said = inspect.cleandoc(source.function.__doc__ or "").replace("*/", "* /").replace("/*", "/ *")
    module = source.function.__module__
    lines = (
        [*said.splitlines(), f"From {module}.{source.node.name}."] if said else [f"From {module}.{source.node.name}."]
    )
    if len(lines) == 1:
        return f"/* {lines[0]} */"
    return "\n".join(["/* " + lines[0], *(f" * {line}".rstrip() for line in lines[1:]), " */"])
