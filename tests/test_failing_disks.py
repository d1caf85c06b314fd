"""Full, closed, vanished and shared disks, and a clock that jumps: every command that writes says one clear line.

`failing_disks` makes the trouble, in a process of its own. All of it is a long test; the default takes less.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import pytest
from failing_disks import COMMANDS, GROWING, QUICK, SAYING
from places import ROOT

from mmnn_pin.cli import mmnn

READ = (
    "file",
    "runs",
    "run",
    "logs",
    "--at",
    "--held-out",
    "--without-load",
    "--package-dir",
)  # paths that commands only read
KEEPING = ("study", "tune")  # the same command goes on with what is there
BESIDE = (*KEEPING, "run")  # or makes a folder beside it


@pytest.fixture(scope="module")
def came_of(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> dict[str, Any]:
    """Command to trouble to what came of it."""
    return all_tried(tmp_path_factory.mktemp("disks") / "here", *request.param)


def all_tried(folder: Path, *options: str) -> dict[str, Any]:
    """What `failing_disks` tells, in a folder that it makes."""
    program = [sys.executable, str(ROOT / "tests" / "failing_disks.py"), *options]
    if os.geteuid() == 0:  # nothing is closed to root, unless it gives that up
        program = [*(["setpriv", "--bounding-set=-dac_override"] if may_give_up() else []), *program]
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}", "MPLBACKEND": "agg"}
    done = subprocess.run([*program, str(folder)], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def may_give_up() -> bool:
    """Whether root may give up what opens every file to it."""
    if shutil.which("setpriv") is None:
        return False
    return subprocess.run(["setpriv", "--bounding-set=-dac_override", "true"], capture_output=True).returncode == 0


PLACES = ("--out", "--html", "--plots", "--example", "--picture")  # options of commands that write
ELSEWHERE = {"ros2": "tests/deploy/ros2/test_node.py"}  # needs rclpy: tried there


def test_no_command_that_writes_is_forgotten():
    """The commands that have a place to write to, as the command line itself knows them, and those tried here."""
    places = {name: [o for p in one.params for o in p.opts if o in PLACES] for name, one in mmnn.commands.items()}
    tried = {name: [word for word in command.split() if word in PLACES] for name, command in COMMANDS.items()}
    for name, options in places.items():
        assert name in ELSEWHERE or set(options) == {
            o for one in COMMANDS if COMMANDS[one].split()[0] == name for o in tried[one]
        }
    paths = {p.opts[-1] for c in mmnn.commands.values() for p in c.params if isinstance(p.type, click.Path)}
    assert paths <= {*PLACES, *READ}, "a new option with a path: it reads or it writes"
    assert all((ROOT / file).is_file() for file in ELSEWHERE.values())


quick = pytest.mark.parametrize("came_of", [("--quick",)], indirect=True, ids=["quick"])
whole = pytest.mark.parametrize("came_of", [()], indirect=True, ids=["whole"])


def complaint(what: dict[str, Any]) -> str:
    """The one line of an error."""
    (line,) = (line for line in what["told"] if " runs, on " not in line)
    assert what["code"] == 2 and "error: " in line, what
    assert not any(words in line for words in ("internal error", "Traceback", "Errno")), line
    return str(line)


def judge(name: str, came_of: dict[str, dict[str, Any]]) -> None:
    """Hold what came of a command against what is promised."""
    sound = came_of["none"]
    assert sound["code"] == 0 and sound["files"]
    for trouble, what in came_of.items():
        assert not any(Path(file).name.startswith(".") or file.endswith(".part") for file in what["files"]), trouble
        if trouble in ("none", "clock"):
            assert what["code"] == 0 and set(what["files"]) == set(sound["files"]), trouble
        elif trouble == "again":
            assert what["code"] == 0 if name in BESIDE else "exist" in complaint(what)
            assert what["files"] == sound["files"] or name in KEEPING
        elif trouble.endswith("then room"):  # the fix works when it is followed
            assert what["code"] == 0 and set(what["files"]) >= set(sound["files"]) - {"pd.h5"}, what
        elif trouble.endswith("replacing"):
            if what["code"]:
                complaint(what)
            same = {file: digest for file, digest in what["files"].items() if ".sqlite" not in file}
            assert name in KEEPING or same == sound["files"] or what["code"] == 0, trouble
            assert set(what["files"]) >= set(sound["files"])  # nothing is lost that was complete
        elif trouble.startswith("full"):
            line = complaint(what) if what["code"] else ""
            assert not line or "make room" in line or "free some space" in line, line
            whole = not line and what["files"] == sound["files"]  # it is as small
            assert whole or not what["files"] or name in GROWING, what
            assert whole or line or name in GROWING
        elif trouble.startswith("closed"):
            if os.geteuid() == 0 and not may_give_up():
                continue
            line = complaint(what)
            assert "ermission denied" in line or "cannot be written to" in line
            assert not what["files"]
        elif trouble == "in the way":
            assert complaint(what) and what["files"] == sha("a file where a folder should be")
        elif trouble == "gone":
            assert (what["code"] == 0 and set(what["files"]) == set(sound["files"])) or complaint(what)
        elif trouble == "taken" and name not in KEEPING:
            complaint(what)
            assert set(what["files"].values()) <= {sha("theirs"), "folder"}


def sha(text: str) -> str:
    import hashlib

    return hashlib.sha256(text.encode()).hexdigest()


@quick
@pytest.mark.parametrize("name", QUICK)
def test_a_command_on_a_failing_disk_says_one_line_and_leaves_nothing_half_written(name, came_of):
    judge(name, came_of[name])


@quick
def test_standard_output_on_a_full_disk_is_one_line_and_exit_code_2(came_of):
    assert len(came_of["standard output"]) == 2 * len(SAYING)
    for what in came_of["standard output"].values():
        assert "standard output cannot be written: No space left on device: make room" in complaint(what)


@pytest.mark.long
@whole
@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_in_every_trouble(name, came_of):
    judge(name, came_of[name])
