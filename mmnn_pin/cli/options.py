"""What the commands have in common: options, and examples at the end of their help."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


def shared(function: F) -> F:
    """Add the options of every command."""
    debug = click.option("--debug", is_flag=True, expose_value=False, help="Show the traceback of an error.")
    as_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout, nothing else.")
    return as_json(debug(function))


def examples(*lines: str) -> str:
    """Examples for the end of a help text, one per line."""
    return "\b\nExamples:\n" + "\n".join(f"  {line}" for line in lines)
