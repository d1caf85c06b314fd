"""Output of the commands, their exit codes, and the runs and studies that paths hold.

Results go to standard output, all else to standard error. A path may hold a recording, a folder of recordings, a study
or what else a folder may hold.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from secrets import token_hex
from types import FrameType
from typing import TYPE_CHECKING, Any, ParamSpec

import click

from ..errors import ConfigError, InputError, RecordingError, printable
from ..files import reason, way_out

if TYPE_CHECKING:
    from ..recording.recording import Recording

P = ParamSpec("P")
DONE, FAILED, BAD_INPUT, STOPPED = 0, 1, 2, 130
EVERY = 10.0  # between two lines of progress [s]
NARROW, WIDTH, WIDE = 40, 100, 200  # columns that tables are made for: at least, without a terminal, at most
STYLE = f"\ufdd0{token_hex(8)}\ufdd1"  # in place of what begins a style of ours: no text of others has it


def say(text: str) -> None:
    """Print on standard output; a reader that has left (`| head`) is no error.

    What its encoding lacks is escaped.

    Raises:
        InputError: It cannot be written to.
    """
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    try:
        print(safe(text).encode(encoding, "backslashreplace").decode(encoding), flush=True)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left over goes there
        if not isinstance(error, BrokenPipeError):
            fix = way_out(error)
            raise InputError("standard output cannot be written", why=reason(error), fix=fix) from error


def look() -> dict[str, Any]:
    """Look of text on standard output: in colours on a terminal; as wide as that or COLUMNS, else as it is."""
    colour = sys.stdout.isatty()
    if not colour and not os.environ.get("COLUMNS", "").isdigit():
        return {}
    return {"colour": colour, "width": min(max(shutil.get_terminal_size().columns, NARROW), WIDE)}


def columns() -> int:
    """Columns of text for standard output, see `look`."""
    return int(look().get("width", WIDTH))


def styled(text: str) -> str:
    """A text with styles of ours, as `say` lets them through; see `terminal_text`."""
    return text.replace("\x1b", STYLE)


def safe(text: str) -> str:
    """Lines for a terminal: of what steers it, only our own styles are left."""
    return "\x1b".join(printable(part, "\n\t") for part in text.split(STYLE))


def answer(as_json: bool, content: Callable[[], dict[str, Any]], text: Callable[[], str]) -> None:
    """Print what came out: as one JSON object, without the NaN that JSON does not know, or as text for people."""
    say(json.dumps(content(), allow_nan=False) if as_json else text())


def wrote(files: Iterable[Path]) -> str:
    """The lines that name written files."""
    return "\n".join(f"wrote {file}" for file in files)


def wrote_into(folder: Path, files: Sequence[Path]) -> str:
    """The line that names written files of one folder."""
    return f"wrote {', '.join(file.name for file in files)} into {folder}"


def named(files: dict[str, Path]) -> dict[str, str]:
    """Files by name, for JSON."""
    return {name: str(file) for name, file in files.items()}


def has_display() -> bool:
    """Whether a browser could show something; without, one that works in the terminal might take it over."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))


def open_page(url: str, no_browser: bool) -> None:
    """Open a page in a browser, where there is a display and nobody said not to."""
    if not no_browser and has_display():
        import webbrowser

        webbrowser.open(url)


def note(text: str) -> None:
    """Print lines on standard error."""
    click.echo(safe(text), err=True)


def warn(text: str) -> None:
    """Print a warning about a run or a page on standard error."""
    note(f"warning: {printable(text)}")


def compile_if_cold(hardware: bool = False) -> None:
    """Tell on standard error what is compiled from now on, and before the first of it how long a first run takes.

    Args:
        hardware: Whether the run has sensors, motors, a supervisor or disturbances; then more is compiled.
    """
    from ..compiled import is_warm
    from ..compiled.folders import cache_folder

    tell_what_compiles()
    if not is_warm():
        announce("first run of this version: compiling takes about half a minute, later runs start at once")
        return
    folder = cache_folder()
    if hardware and folder is not None and not (announced := folder / "hardware was announced").exists():
        parts = "sensors, motors, a supervisor or disturbances"
        announce(f"first run with {parts}: their part of the loop is compiled, about 20 s more")
        with suppress(OSError):  # a full disk: it is announced again
            announced.touch()


@cache
def announce(text: str) -> None:
    """Print a line on standard error as soon as something is compiled: not before an input that is refused."""
    from ..compiled import when_compiling

    waiting = [text]
    when_compiling(lambda: note(waiting.pop()) if waiting else None)


@cache
def tell_what_compiles() -> Callable[[], None]:
    """From now on, a line on standard error every 10 s while something is compiled; what tells it."""
    from ..compiled import when_compiling

    tell = compiling_lines()
    when_compiling(tell)
    return tell


def compiling_lines(now: Callable[[], float] = time.monotonic) -> Callable[[], None]:
    """A function, called for every function that is compiled, that prints their number at most every 10 s.

    Args:
        now: The clock [s].
    """
    lines, last, count = Lines(now), now(), 0

    def tell() -> None:
        nonlocal last, count
        count += 1
        if (here := now()) - last > EVERY:  # something else was done meanwhile
            lines.wait(here)
        last = here
        lines.show(lambda: f"compiling, {count} functions so far")

    return tell


class Lines:
    """Progress where no terminal is, such as a log: a line on standard error every 10 s.

    Args:
        now: The clock [s].
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now, self._start = now, now()
        self.wait(self._start)

    def wait(self, here: float) -> None:
        """Print nothing for 10 s from a time on."""
        self._next = here + EVERY

    def show(self, text: Callable[[], str]) -> None:
        """Print a line, if the last one is 10 s old."""
        if (here := self._now()) >= self._next:
            self.wait(here)
            note(f"{text()}, after {here - self._start:.0f} s")


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """Shows how far each controller's run is, on standard error: bars on a terminal, else a line now and then."""
    if not sys.stderr.isatty():
        lines = Lines()
        yield lambda controller, fraction: lines.show(lambda: f"{controller}: {100 * fraction:.0f} %")
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:

        def show(controller: str, fraction: float) -> None:
            known, name = {task.description: task.id for task in bar.tasks}, escape(printable(controller))
            task = known[name] if name in known else bar.add_task(name, total=1.0)
            bar.update(task, completed=fraction)

        yield show


@contextmanager
def counter(what: str, total: int, done: int = 0) -> Iterator[Callable[[int, str], None]]:
    """Shows how many of something are done, with a text behind, as `progress_bar` does."""
    if not sys.stderr.isatty():
        lines = Lines()
        yield lambda done, text: lines.show(lambda: f"{done} of {total} {what}  {text}".rstrip())
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, TextColumn("{task.description}"), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=total, completed=done)
        yield lambda done, text: bar.update(task, completed=done, description=escape(printable(text)))


@contextmanager
def judging(recordings: Mapping[str, Recording]) -> Iterator[None]:
    """Within it what takes long of the runs' judgements is told on standard error, as of `mmnn judge`."""
    from ..lab.psi.judgement import Judgement, keep

    with progress_bar() as show:
        for name, recording in recordings.items():
            show(f"{name}, reading", 0.0)
            with suppress(InputError):  # one that holds too little
                keep(Judgement(recording, progress=partial(tell, show, name)))
        yield


def tell(show: Callable[[str, float], None], name: str, what: str, fraction: float) -> None:
    """Progress of a part of a run's judgement."""
    show(f"{name}, {what}", fraction)


@contextmanager
def interruptible(show: Callable[P, None]) -> Iterator[Callable[P, None]]:
    """A progress function that also raises what Ctrl-C raises.

    Python swallows a KeyboardInterrupt that happens to hit a destructor: it is remembered, and raised again here.
    """
    pressed = threading.Event()

    def press(number: int, frame: FrameType | None) -> None:
        pressed.set()
        signal.default_int_handler(number, frame)

    def progress(*args: P.args, **kwargs: P.kwargs) -> None:
        if pressed.is_set():
            raise KeyboardInterrupt
        show(*args, **kwargs)

    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # else someone's own, or ignored
    ours = usual and threading.current_thread() is threading.main_thread()
    try:
        if ours:
            signal.signal(signal.SIGINT, press)
        yield progress
    except Exception:
        if pressed.is_set():  # a compiler whose callback swallowed it fails in its own way
            raise KeyboardInterrupt from None
        raise
    finally:
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def found_in(paths: tuple[Path, ...], what: str) -> Path | None:
    """The one path among some that holds something else than runs; None where none does.

    Args:
        paths: As the user named them.
        what: A kind of `lab.show.folders`.

    Raises:
        ConfigError: It is not the only path.
    """
    from ..lab.show.folders import FOLDERS

    found = [file for path in paths for file in FOLDERS[what].finds(path)]
    if found and max(len(paths), len(found)) > 1:
        raise ConfigError(f"a {what} among other runs", fix="name it alone", file=found[0])
    return found[0] if found else None


def open_runs(paths: tuple[Path, ...]) -> list[Recording]:
    """The recordings of some paths: each a recording, or a folder of recordings, in the order of `mmnn list`.

    Raises:
        RecordingError: None there, or one that cannot be read.
    """
    from ..recording.recording import Recording
    from ..torque.entries import CONTROLLERS

    places = {name: place for place, name in enumerate(CONTROLLERS)}  # the user's own come first
    files: list[Path] = []
    for path in paths:
        found = sorted(path.glob("*.h5"), key=lambda file: (places.get(file.stem, -1), file.name))
        here = found if path.is_dir() else [path]
        if not here:
            folders = [folder.name for folder in folders_of(path)]
            fix = f"name one of its folders: {', '.join(folders)}" if folders else "name one that `mmnn run` wrote"
            raise RecordingError("no recordings (*.h5) in this folder", fix=fix, file=path)
        files += here
    recordings = [Recording.open(file) for file in files]
    for recording in recordings:
        for why in dict.fromkeys(recording.damage.values()):
            first, *more = (where for where, reason in recording.damage.items() if reason == why)
            what = f"{first} and {len(more)} more are" if more else f"{first} is"
            warn(f"{recording.path}: {what} damaged and left out: {why}")
    return recordings


def one_run(path: Path) -> Recording:
    """The one recording of a path, with rows.

    Raises:
        RecordingError: A folder, no recording, or one without rows.
    """
    from ..lab.show.curves import require_comparable

    if not path.is_dir():
        recordings = open_runs((path,))
        require_comparable(recordings)
        return recordings[0]
    fix, here, folders = "name a recording that `mmnn run` wrote", sorted(path.glob("*.h5")), folders_of(path)
    if here:
        fix = f"name one of its recordings: {', '.join(file.name for file in here)}"
    elif folders:
        names = ", ".join(dict.fromkeys(file.name for folder in folders for file in sorted(folder.glob("*.h5"))))
        where = ", ".join(folder.name for folder in folders)
        fix = f"name a recording FOLDER/FILE in it: FOLDER is one of {where}; FILE one of {names}"
    raise RecordingError("a folder", why="one run is judged at a time", fix=fix, file=path)


def folders_of(path: Path) -> list[Path]:
    """Folders with recordings in a folder: such as the cases of an experiment."""
    return sorted({file.parent for file in path.glob("*/*.h5")})


def targets(runs: list[Path], out: Path | None, to: str) -> list[Path]:
    """File for every recording: the one named, or one per recording in the folder named, or beside each.

    Raises:
        ConfigError: One file for several recordings.
    """
    if out is not None and (out.suffix and not out.is_dir()):
        if len(runs) > 1:
            raise ConfigError(f"one file for {len(runs)} recordings", fix="name a folder", file=out, key="--out")
        return [out]
    files = [(run.parent if out is None else out) / f"{run.stem}.{to}" for run in runs]
    for i, file in enumerate(files):
        if file in files[:i]:
            why = f"{runs[files.index(file)]} and {runs[i]} have the same name"
            raise ConfigError("two recordings for one file", why=why, fix="export them apart", file=file)
    return files
