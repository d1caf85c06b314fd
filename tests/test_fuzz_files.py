"""Files of every kind, broken at random: an answer or one clear line. `python tests/fuzz_files.py` tries 10,000."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fuzz_files import EVIL, KINDS, fuzz
from places import ROOT

SOURCES = "import sys; from pathlib import Path; from sound_files import sound_files; "
SOURCES += "sound_files(Path(sys.argv[1]), ('adaptive',), tuned=False)"
QUICK = [kind for kind in KINDS if not kind.startswith("tuning")]


@pytest.fixture(scope="module")
def sources(tmp_path_factory) -> Iterator[Path]:
    """Sound files, made without compiling."""
    folder = tmp_path_factory.mktemp("sound") / "files"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"}
    subprocess.run([sys.executable, "-c", SOURCES, str(folder)], env=environment, check=True)
    return folder


def test_no_broken_file_makes_a_command_fail_otherwise_than_in_one_line(sources):
    counts, wrong, _ = fuzz(sources, 5 * len(QUICK), batch=1000, kinds=QUICK, cheap=True)
    assert wrong == []
    told = {verdict: sum(found[verdict] for found in counts.values()) for verdict in ("done", "refused")}
    assert told["done"] > 20 and told["refused"] > 20  # it tries files that can be read, and files that cannot


MISBEHAVES = {  # what a command might do with a broken file, and the words of the harness
    "Path('beside.txt').write_text('x')": "written outside",
    "os.mkdir(folder.parent / 'beside')": "written outside",
    "os.rename('x.toml', 'y.toml')": "written outside",
    "os.remove('y.toml')": "written outside",
    "os.system('true')": "the program",
    "subprocess.run(['true'])": "the program",
    "exec(open('evil.py').read())": "a program of the file was run",
    "open('secret/x.stl').read()": "a secret was read",
    "all(not k for k in iter(int, 1))": "more than 0.3 s",
    "threading.Event().wait()": "crash, exit code 1: Timeout",
    "bytearray(3 << 30)": "it raised MemoryError",
    "print('error: not enough memory', file=sys.stderr) or 2": "more than 1 GB",
    "1 / 0": "it raised ZeroDivisionError",
    "sys.exit(5)": "it raised SystemExit",
    "print('error: internal error: x', file=sys.stderr) or 2": "internal error",
    "print('Traceback (most recent call last)', file=sys.stderr) or 0": "a traceback",
    "3": "exit code 3",
    "2": "an error without words",
    "print('[1]') or 0": "no object",
    "print('{} {}') or 0": "not one JSON object",
    "os.abort()": "crash, exit code -6",
    "Path('out').mkdir() or print('{}') or 0": "done",
    "print('{}') or print('error: x', file=sys.stderr) or 2": "refused",
}
OBJECTS = """
import os, subprocess, sys, tempfile, threading
from pathlib import Path
import fuzz_files, mmnn_pin.cli
from mmnn_pin.cli import main as ours
fuzz_files.SECONDS, fuzz_files.WAITING = 0.3, 8
folder, lines, last = Path(sys.argv[1]), sys.argv[2:], os.dup(1)
tempfile.gettempdir()  # tries its folder when first asked
fuzz_files.watch()
os.chdir(folder)
for line in lines:
    for one in folder.iterdir():
        one.rmdir() if one.is_dir() and one.name == "out" else None
    (folder / "ran").unlink(missing_ok=True)
    mmnn_pin.cli.main = lambda command: eval(line)
    said = fuzz_files.verdict(["plot", "--json"], folder).replace(chr(10), " ")
    os.write(last, said.encode() + b"\\n")
"""


def test_the_harness_objects_to_every_kind_of_misbehaviour(tmp_path):
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"}
    said: dict[str, str] = {}
    while left := [one for one in MISBEHAVES if one not in said]:
        folder = tmp_path / f"{len(said)}" / "here"
        (folder / "secret").mkdir(parents=True)
        (folder / "evil.py").write_text(EVIL)
        for name in ("x.toml", "secret/x.stl"):
            (folder / name).write_text("x = 1")
        done = subprocess.run(
            [sys.executable, "-c", OBJECTS, str(folder), *left], env=environment, capture_output=True, text=True
        )
        lines = done.stdout.splitlines()
        said |= dict(zip(left, lines, strict=False))
        if len(lines) < len(left):  # a crash
            said[left[len(lines)]] = f"crash, exit code {done.returncode}: {done.stderr}"
    missed = {one: (words, said[one][:200]) for one, words in MISBEHAVES.items() if words not in said[one]}
    assert missed == {}


@pytest.mark.long
def test_a_thousand_more(sources):
    assert fuzz(sources, 1000, seed=1_000_000, kinds=QUICK)[1] == []
