"""What a command says: results on standard output, the rest on standard error, and its exit code."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import click

DONE, FAILED, BAD_INPUT, STOPPED = 0, 1, 2, 130


def say(text: str) -> None:
    """Print on standard output; a reader that has left (`| head`) is no error."""
    try:
        print(printable(text), flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def printable(text: str) -> str:
    """Text without what would steer a terminal: control and direction characters, which names in a URDF may hold."""
    return text if text.isprintable() else "".join(c if c.isprintable() or c in "\n\t\x1b" else " " for c in text)


def say_json(content: dict[str, Any]) -> None:
    """Print one JSON object, without the NaN that JSON does not know."""
    say(json.dumps(content, allow_nan=False))


def warn(text: str) -> None:
    """Say on standard error what to know of a run or a page."""
    click.echo(f"warning: {text}", err=True)


def compile_if_cold(hardware: bool = False) -> None:
    """Compile what a run needs, unless that was done, and tell so on standard error.

    Args:
        hardware: Whether the run has sensors, motors, a supervisor or disturbances; then more is compiled.
    """
    from ..compiled import cache_folder, is_warm

    if not is_warm():
        click.echo("first run of this version: compiling takes about half a minute, later runs start at once", err=True)
        from ..loop.precompile import precompile

        precompile()
    folder = cache_folder()
    if hardware and folder is not None and not (told := folder / "told of the rig").exists():
        parts = "sensors, motors, a supervisor or disturbances"
        click.echo(f"first run with {parts}: their part of the loop is compiled, about half a minute more", err=True)
        told.touch()


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """Shows how far each controller's run is, on standard error and only where that is a terminal."""
    if not sys.stderr.isatty():
        yield lambda controller, fraction: None
        return
    from rich.console import Console
    from rich.progress import Progress, TaskID

    with Progress(console=Console(stderr=True), transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def show(controller: str, fraction: float) -> None:
            if controller not in tasks:
                tasks[controller] = bar.add_task(controller, total=1.0)
            bar.update(tasks[controller], completed=fraction)

        yield show
