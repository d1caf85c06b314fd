"""Folders of contests that strangers hand in, and those on disks that fail."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from contextlib import redirect_stdout
from io import StringIO

import pytest
from fuzz_files import json_file, raw
from places import ROOT
from sound_contest import contest
from test_failing_disks import judge

from mmnn_pin.cli import main


def test_a_contest_that_lost_windows_of_a_curve_is_drawn_as_far_as_all_go(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    contest(tmp_path / "contest")
    rows = json.loads((tmp_path / "contest" / "rows.json").read_bytes())
    rows["eight/two_layer"]["rows"][0]["curve"].pop()
    (tmp_path / "contest" / "rows.json").write_text(json.dumps(rows))
    with redirect_stdout(StringIO()):
        assert main(["plot", "contest", "--what", "contest-learning", "--out", "out"]) == 0


def test_a_contest_with_a_squared_error_below_0_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    contest(tmp_path / "contest")
    rows = json.loads((tmp_path / "contest" / "rows.json").read_bytes())
    rows["eight/two_layer"]["rows"][0]["curve"][0][0] = -1.0
    (tmp_path / "contest" / "rows.json").write_text(json.dumps(rows))
    assert main(["report", "contest", "--html", "out.html"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "the curve of two_layer has a squared error below 0" in line


@pytest.mark.parametrize("value", [1e300, -1.0])
def test_a_contest_with_an_error_that_is_none_is_one_line(value, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    contest(tmp_path / "contest")
    rows = json.loads((tmp_path / "contest" / "rows.json").read_bytes())
    first = rows["eight/two_layer"]["rows"][0]["rms"]
    first[next(iter(first))] = value
    (tmp_path / "contest" / "rows.json").write_text(json.dumps(rows))
    assert main(["report", "contest", "--html", "out.html"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"an error of {value:g}" in line


@pytest.mark.long
@pytest.mark.parametrize("name", ["prove", "contest", "plot of a contest"])
def test_commands_of_research_are_told_of_disks_that_fail(name, came_of):
    judge(name, came_of[name])


@pytest.fixture(scope="module")
def came_of(tmp_path_factory):
    """Command to trouble to what came of it."""
    paths = f"{ROOT}:{ROOT / 'tests'}:{ROOT / 'research' / 'tests'}"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": paths, "MPLBACKEND": "agg"}
    program = [sys.executable, str(ROOT / "research" / "tests" / "failing_research.py")]
    done = subprocess.run(
        [*program, str(tmp_path_factory.mktemp("disks") / "here")], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout)


MUTATIONS = [kind(name) for name in ("contest.json", "rows.json") for kind in (json_file, raw)]


@pytest.mark.parametrize("seed", range(12))
def test_a_broken_contest_is_an_answer_or_one_line(seed, tmp_path, monkeypatch, capsys):
    """Files broken as `fuzz_files` breaks them."""
    monkeypatch.chdir(tmp_path)
    contest(tmp_path / "contest")
    MUTATIONS[seed % len(MUTATIONS)](tmp_path / "contest", random.Random(seed))
    for command in ("plot contest --out out --what contest-fvu", "report contest --html c.html"):
        code, told = main(command.split()), capsys.readouterr().err.splitlines()
        errors = [line for line in told if "error: " in line]
        assert (code, len(errors)) in ((0, 0), (2, 1)) and "internal error" not in " ".join(told)
