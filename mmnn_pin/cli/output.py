"""What commands print, their exit codes, and what the paths that they are given hold.

Results go to standard output, all else to standard error. A path may hold a recording, a folder of recordings, a study
or a contest.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ConfigError, RecordingError

if TYPE_CHECKING:
    from ..recording.recording import Recording


DONE, FAILED, BAD_INPUT, STOPPED = 0, 1, 2, 130
STUDY, CONTEST = "study.sqlite", ("contest.json", "rows.json")  # names of their files


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
    if hardware and folder is not None and not (announced := folder / "told of the rig").exists():
        parts = "sensors, motors, a supervisor or disturbances"
        click.echo(f"first run with {parts}: their part of the loop is compiled, about half a minute more", err=True)
        announced.touch()


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


def study_of(paths: tuple[Path, ...]) -> Path | None:
    """The database of a study among some paths: the path itself, or a file in the folder; None without one.

    Raises:
        ConfigError: It is not the only path.
    """
    inside = [path / STUDY for path in paths if (path / STUDY).is_file()]
    return alone("study", [*(path for path in paths if path.suffix == ".sqlite"), *inside], paths)


def contest_of(paths: tuple[Path, ...]) -> Path | None:
    """The folder of a contest among some paths; None without one.

    Raises:
        ConfigError: It is not the only path.
    """
    return alone("contest", [path for path in paths if any((path / name).is_file() for name in CONTEST)], paths)


def alone(what: str, found: list[Path], paths: tuple[Path, ...]) -> Path | None:
    """The first that was found, which has to be the only path.

    Raises:
        ConfigError: It is not.
    """
    if found and len(paths) > 1:
        raise ConfigError(f"a {what} among other runs", fix="name it alone", file=found[0])
    return found[0] if found else None


def open_runs(path: Path) -> list[Recording]:
    """The recording of a path, or all recordings of a folder.

    Raises:
        RecordingError: None there, or one that cannot be read.
    """
    from ..recording.recording import Recording

    files = sorted(path.glob("*.h5")) if path.is_dir() else [path]
    if not files:
        folders = [folder.name for folder in folders_of(path)]
        fix = f"name one of its folders: {', '.join(folders)}" if folders else "name one that `mmnn run` wrote"
        raise RecordingError("no recordings (*.h5) in this folder", fix=fix, file=path)
    return [Recording.open(file) for file in files]


def folders_of(path: Path) -> list[Path]:
    """Folders with recordings in a folder: the tasks of a contest, the cases of an experiment."""
    return sorted({file.parent for file in path.glob("*/*.h5")})


def recordings_in(path: Path) -> str:
    """The recordings of a folder in words, to choose one; with `FOLDER/` for those of its folders."""
    if here := sorted(path.glob("*.h5")):
        return f"name one of its recordings: {', '.join(file.name for file in here)}"
    folders = folders_of(path)
    if not folders:
        return "name a recording that `mmnn run` wrote"
    names = dict.fromkeys(file.name for folder in folders for file in sorted(folder.glob("*.h5")))
    where = ", ".join(folder.name for folder in folders)
    return f"name a recording FOLDER/FILE in it: FOLDER is one of {where}; FILE one of {', '.join(names)}"


def require_no_pictures(files: Iterable[Path], what: str, elsewhere: str, force: bool) -> None:
    """Refuse to draw over pictures.

    Args:
        files: They.
        what: What to call them.
        elsewhere: What to do instead.
        force: Whether they may be replaced.

    Raises:
        RecordingError: One exists.
    """
    for file in files:
        if file.exists() and not force:
            raise RecordingError(f"the {what} exists", fix=f"{elsewhere}, or replace it with --force", file=file)
