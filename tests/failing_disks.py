"""Every command that writes, on disks that are full, closed, gone, shared or wrong about the time.

python tests/failing_disks.py [--quick] FOLDER    one JSON object: command to kind of trouble to what came of it

It runs without compiling, all commands in one process: what they import is imported once, and what takes long to
compute and writes nothing is computed once. As root it is to be started by `setpriv --bounding-set=-dac_override`, for
which a folder without permission is closed as for anybody.
"""

from __future__ import annotations

import contextlib
import datetime as calendar
import hashlib
import io
import itertools
import os
import resource
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import msgspec
import sound_files

import mmnn_pin.files
from mmnn_pin import load_experiment
from mmnn_pin.cli import main
from mmnn_pin.deploy.embed import export
from mmnn_pin.deploy.identify import excitation, identification
from mmnn_pin.lab.psi import judgement
from mmnn_pin.lab.show import files as pages
from mmnn_pin.lab.show import study as study_pages
from mmnn_pin.lab.study import store, tuning, worker
from mmnn_pin.recording import recorder, run_file

COMMANDS = {
    "run": "run x.toml --out {out}",
    "plot": "plot run.h5 --out {out}/a.png",
    "plot as svg": "plot run.h5 --out {out}/a.svg",
    "replay": "replay run.h5 --html {out}/a.html",
    "report": "report run.h5 --no-replay --html {out}/a.html",
    "report of a study": "report db --html {out}/a.html",
    "export as csv": "export run.h5 --to csv --out {out}",
    "export as npz": "export run.h5 --to npz --out {out}",
    "export as parquet": "export run.h5 --to parquet --out {out}",
    "export as mcap": "export run.h5 --to mcap --out {out}",
    "export of a study": "export db --to csv --out {out}",
    "study": "study short.toml --workers 1 --out {out}",
    "one row of a study": "study short.toml --row 1 --out {out}",
    "tune": "tune tuning.toml --workers 1 --out {out}",
    "inspect": "inspect two_axis_arm --picture {out}/a.png",
    "judge": "judge learned.h5 --plots {out}",
    "identify": "identify log.csv --robot two_axis_arm --even-if-worse --out {out}",
    "excite": "excite two_axis_arm --duration 10 --seconds 0 --out {out}/a.csv",
    "embed": "embed track --controller pd --no-check --steps 3 --out {out}/c",
}
GROWING = ("run", "study", "one row of a study", "tune")  # these keep what was done before
SAYING = ("list", "export run.h5 --to csv --out {out}", "run x.toml --out {out}")
# Those of the default tests are the other ones: these write, and go on, with the same functions.
LONG = ("plot as svg", "report of a study", "judge", "excite", "embed")
LONG += ("one row of a study", "tune", "export as npz", "export of a study")
QUICK = [name for name in COMMANDS if name not in LONG]
SIZES = (0, 3000, 40_000)  # bytes of a file on a full disk


# What takes long and writes nothing, by module and name.
COMPUTED = (
    (judgement, "Judgement"),
    (excitation, "excite"),
    (identification, "identify"),
    (study_pages, "page"),
    (export, "translated"),
    (export, "answers"),
    (export, "selftest"),
    (export, "files_of"),
)


def prepare(folder: Path, quick: bool = False) -> None:
    """What the commands read."""
    folder.mkdir()
    sound_files.old_recording(folder / "run.h5")
    (folder / "x.toml").write_text(sound_files.EXPERIMENT)
    (folder / "tuning.toml").write_text(sound_files.TUNING.replace("check = 2", "check = 0"))
    sound_files.study(folder)
    sound_files.motion(folder / "log.csv")
    if not quick:
        steps = [f"time.{name}=0.005" for name in ("control_period", "plant_step")]
        experiment = load_experiment("track", ["time.duration=0.8", *steps])
        loop = experiment.loop(experiment.load_robot(), "adaptive")
        loop.run(folder / "learned.h5", meta={"config": experiment.to_json()})


def called(command: str, out: Path, *more: str) -> dict[str, Any]:
    """Exit code, words and files of a command."""
    said, errors = io.StringIO(), io.StringIO()
    words = [word.format(out=out) for word in command.split()]
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(errors):
        code = main([*words, *more])
    told = [line for line in errors.getvalue().splitlines() if line and not line.startswith(("warning", "note"))]
    return {"code": code, "told": told, "said": said.getvalue()[-300:], "files": files_of(out)}


def files_of(folder: Path) -> dict[str, str]:
    """Files of a folder, its locks left out, with a digest of each."""
    found = sorted(file for file in folder.rglob("*") if file.suffix != ".lock") if folder.is_dir() else []
    return {
        str(f.relative_to(folder)): hashlib.sha256(f.read_bytes()).hexdigest() if f.is_file() else "folder"
        for f in found
    }


@contextlib.contextmanager
def small_files(size: int) -> Iterator[None]:
    """Files that cannot grow beyond a size: what a full disk looks like, without a disk."""
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, old[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)


@contextlib.contextmanager
def before_writing(act: Callable[[Path], None]) -> Iterator[None]:
    """Something happens to the place of a file after it was found free, and before it is written."""
    first, patches = iter([True]), contextlib.ExitStack()

    def acting(function: Callable[..., Any], place: Callable[..., Path]) -> Callable[..., Any]:
        def later(*given: Any, **named: Any) -> Any:
            if next(first, False):
                act(place(*given))
            return function(*given, **named)

        return later

    with patches:
        for module, name, place in (
            (mmnn_pin.files, "settle", lambda part, path, *_: path),
            (mmnn_pin.files, "settle_folder", lambda made, folder, *_: folder),
            (run_file, "settle", lambda part, path, *_: path),
            (store.Store, "add", lambda self, *_: self.path),
            (tuning, "require_there", lambda path: path),
        ):
            patches.enter_context(patch.object(module, name, acting(getattr(module, name), place)))
        yield


class Jumping(calendar.datetime):
    """A clock that is set back and forth by years."""

    years = itertools.cycle((2031, 1999, 2040, 1971))

    @classmethod
    def now(cls, tz: Any = None) -> Any:
        """Some time."""
        return calendar.datetime(next(cls.years), 1, 1, tzinfo=tz)


@contextlib.contextmanager
def jumping_clock() -> Iterator[None]:
    """The wall clock of every module that looks at it."""
    times = itertools.cycle((2e9, 1e9, 3e9, 0.0))
    with contextlib.ExitStack() as patches:
        for module in (recorder, pages, worker):
            patches.enter_context(patch.object(module, "datetime", Jumping))
        patches.enter_context(patch.object(time, "time", lambda: next(times)))
        yield


def once(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that is called once for each recording; its later calls have the first one's answer."""
    answers: dict[Any, Any] = {}

    def answer(*given: Any, **named: Any) -> Any:
        of = getattr(given[0], "path", None)
        if of not in answers:
            answers[of] = function(*given, **named)
        return answers[of]

    return answer


def troubles(name: str, command: str, place: Path, quick: bool) -> Iterator[tuple[str, dict[str, Any]]]:
    """What comes of a command in every kind of trouble, or in the commonest."""
    sound = place / "sound"
    yield "none", called(command, sound)
    again = () if "--row" in command else ("--force",)
    for size in SIZES if name in GROWING and not quick else SIZES[1:2]:
        with small_files(size):
            yield f"full at {size}", called(command, place / f"full{size}")
        if not quick:
            yield f"full at {size}, then room", called(command, place / f"full{size}", *again)
        shutil.copytree(sound, place / f"kept{size}")
        with small_files(size):
            yield f"full at {size}, replacing", called(command, place / f"kept{size}", *again)
    (closed := place / "closed").mkdir()
    closed.chmod(0o555)
    yield "closed", called(command, closed)
    closed.chmod(0o755)
    with before_writing(lambda path: path.exists() or path.write_text("theirs")):
        yield "taken", called(command, place / "taken")
    if quick:
        return
    closed.chmod(0o555)
    yield "closed below", called(command, closed / "new")
    closed.chmod(0o755)
    yield "again", called(command, sound)
    (place / "file").write_text("a file where a folder should be")
    yield "in the way", called(command, place / "file" / "new") | {"files": files_of(place)["file"]}
    with before_writing(lambda path: shutil.rmtree(place / "gone", ignore_errors=True)):
        yield "gone", called(command, place / "gone")
    with jumping_clock():
        yield "clock", called(command, place / "clock")


def standard_output(place: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """What comes of commands whose standard output is a full disk."""
    for k, command in enumerate(SAYING):
        for more in ((), ("--json",)):
            errors = io.StringIO()
            with open("/dev/full", "w") as full, contextlib.redirect_stdout(full), contextlib.redirect_stderr(errors):
                words = [word.format(out=place / f"{k}{len(more)}") for word in command.split()]
                yield (
                    f"{command} {' '.join(more)}",
                    {"code": main([*words, *more]), "told": errors.getvalue().splitlines()},
                )
                os.dup2(os.open(os.devnull, os.O_WRONLY), full.fileno())


def work(folder: Path, quick: bool) -> dict[str, Any]:
    """All commands in all troubles, or some in the commonest."""
    prepare(folder, quick)
    if quick:
        file = folder / "x.toml"
        file.write_text(file.read_text().replace('title = "Broken"', "plots = []"))
    os.chdir(folder)
    found: dict[str, Any] = {}
    with contextlib.ExitStack() as patches:
        for module, name in COMPUTED:
            patches.enter_context(patch.object(module, name, once(getattr(module, name))))
        for name in QUICK if quick else COMMANDS:
            begun = time.process_time()
            (place := folder / "places" / name.replace(" ", "_")).mkdir(parents=True)
            found[name] = dict(troubles(name, COMMANDS[name], place, quick))
            print(f"{name}: {time.process_time() - begun:.1f} s", file=sys.stderr)
        found["standard output"] = dict(standard_output(folder / "places"))
    return found


if __name__ == "__main__":
    sys.stdout.write(msgspec.json.encode(work(Path(sys.argv[-1]), "--quick" in sys.argv)).decode())
