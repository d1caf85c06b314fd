"""Random words and options to every command: exit codes 0, 1, 2 and 130 alone, and one JSON object with --json.

NUMBA_DISABLE_JIT=1 python tests/random_options.py [--tries 1000] [--seed 0] [--sources FOLDER]

Half of the words are files that the command may read. A command that is still at it after 10 s gets
what Ctrl-C gives it.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import importlib
import io
import json
import os
import random
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
from fuzz_files import KINDS

from mmnn_pin.cli import main, mmnn

VALUES = ["", "x", "-1", "0", "1e999", "nan", "a=b", "../..", "\x1b[2J", "--", "é", "1,2", "[", "{}", "/dev/null/x"]
VALUES += [
    "\udcff",
    "a" * 300,
    "x.py:Y",
    "1" * 30,
    "/",
    ".",
    "out",
    "=",
    "x=1",
    "time.duration=0.004",
    "[[[[",
    "%s",
    "-",
]
PATIENCE = 10.0  # [s]


def words_of(name: str, files: list[str], rng: random.Random) -> list[str]:
    """A command with random words and options; what would run for minutes is kept short."""
    command = mmnn.commands.get(name)
    options = [o for p in command.params for o in p.opts if o.startswith("--")] if command else ["--x"]
    kinds = {option: parameter.type for parameter in (command.params if command else ()) for option in parameter.opts}

    def value(option: str = "") -> str:
        kind = kinds.get(option)
        pool = [*(kind.choices if isinstance(kind, click.Choice) else ()), *VALUES]
        return str(rng.choice(files) if files and rng.random() < 0.5 else rng.choice(pool))

    words = [name, *(value() for _ in range(rng.choice((0, 1, 1, 1, 2))))]
    known = [one for _, commands in KINDS.values() for one in commands if one.split()[0] == name]
    if files and known and rng.random() < 0.5:
        words = rng.choice(known).replace("run.h5", "run_old.h5").split()
    for _ in range(rng.randrange(4)):
        option = rng.choice([o for o in options if o != "--debug"])
        words += [option, *([value(option)] if rng.random() < 0.6 else [])]
    if name in ("run", "readings", "study", "tune") and len(words) > 1:
        words += ["--set", f"{'set.' * (name in ('study', 'tune'))}time.duration=0.004"]
    return words


def verdict(words: list[str]) -> tuple[int, str]:
    """Exit code of a command, and what is wrong with what it did; empty for nothing."""
    out, err = io.StringIO(), io.StringIO()

    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    usual = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE, 1.0)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(words)
    except BaseException as error:
        return -1, f"it raised {type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, usual)
    told = err.getvalue()
    if code not in (0, 1, 2, 130):
        return code, f"exit code {code}"
    if "internal error" in told or ("Traceback" in told and code != 130):  # Ctrl-C may hit a destructor
        return code, told
    if code == 2 and "error: " not in told:
        return code, f"no error told: {told}"
    asked = any(word == "--json" and not before.startswith("--") for before, word in pairwise(words))
    if asked and code != 130 and not {"--help", "-h", "--version"} & set(words):
        try:
            if not isinstance(json.loads(out.getvalue()), dict):
                return code, "no object"
        except ValueError:
            return code, f"not one JSON object: {out.getvalue()[:200]!r}"
    return code, ""


def tried(
    count: int, seed: int, sources: Path | None, names: Iterable[str] = ()
) -> tuple[collections.Counter[int], list[str]]:
    """Try random commands in an empty folder, or in a copy of one with files.

    What draws and proves is imported before: that takes seconds, and is no command's fault.

    Returns:
        How often each exit code came, and a line for everything that was wrong.
    """
    for name in ("gallery", "report"):
        importlib.import_module(f"mmnn_pin.lab.show.{name}")
    counts: collections.Counter[int] = collections.Counter()
    wrong, before, rng = [], Path.cwd(), random.Random(seed)
    every = [*(names or mmnn.commands), "nonsense"]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "here"
        shutil.copytree(sources, folder) if sources else folder.mkdir()
        files = sorted(str(file.relative_to(folder)) for file in folder.iterdir())
        os.chdir(folder)
        try:
            for _ in range(count):
                words = words_of(rng.choice(every), files, rng)
                code, problem = verdict(words)
                counts[code] += 1
                wrong += [f"{words}: {problem}"] if problem else []
        finally:
            os.chdir(before)
    return counts, wrong


def command_line() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tries", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sources", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        sources = given.sources
        if sources is None:
            from sound_files import sound_files

            sources = sound_files(Path(scratch) / "sources", ("pd",))
        counts, wrong = tried(given.tries, given.seed, sources)
    print(f"{sum(counts.values()):,} commands, exit codes {dict(counts)}")
    print(*wrong, sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(command_line())
