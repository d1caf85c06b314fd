"""Refusals of the command line: one line that says what, why and a fix, exit code 2, nothing written."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from mmnn_pin import load_experiment
from mmnn_pin.cli import main
from mmnn_pin.model.robots import find

SHORT = ["--set", "time.duration=0.1", "--set", "plots=[]", "--controller", "pd"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run")
    assert main(["run", "chapter4", *SHORT, "--out", str(out)]) == 0
    return out / "pd.h5"


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    assert main(arguments) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if ": error: " in line]
    assert len(lines) == 1
    return lines[0]


def test_damaged_files_are_told_a_way_out(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cut, other, page = tmp_path / "cut.h5", tmp_path / "other.h5", tmp_path / "page.html"
    cut.write_bytes(run.read_bytes()[:20_000])
    other.write_text("no HDF5")
    assert refused(["replay", str(cut), "--html", str(page)], capsys).endswith(": take it from a copy, or run it again")
    assert refused(["judge", str(other)], capsys).endswith(": name a file that `mmnn run` wrote")
    broken = tmp_path / "broken.toml"
    broken.write_text("title = my run\n")
    for command in ("run", "study"):
        line = refused([command, str(broken)], capsys)
        assert line.startswith(f"{broken}:1: error: not valid TOML: ") and "texts stand in quotes" in line
    picture = tmp_path / "robot.png"
    picture.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(64))
    line = refused(["inspect", str(picture)], capsys)
    assert ":1: error: this is a picture (PNG), not a URDF: name a URDF or xacro file" in line
    assert not page.exists()


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc")
def test_a_place_that_takes_no_files_is_told_to_be_changed(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["run", "chapter4", *SHORT, "--out", "/proc/mmnn"]
    for arguments in (out, ["report", str(run), "--html", "/proc/mmnn.html"]):
        assert ": choose another" in refused(arguments, capsys)


def test_what_a_path_lacks_is_listed_and_the_list_is_complete(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    base = ["run", "track", *SHORT, "--out", str(tmp_path / "out"), "--set"]
    line = refused([*base, 'reference.base={type="eight", ramp=1.0}'], capsys)
    assert line.startswith("--set reference.base: error: 'eight' without length, ")
    names = line.rpartition(": give ")[2].split(", ")
    values = ", ".join(f"{name} = {20.0 if name in ('period', 'duration') else 2.0}" for name in names)
    assert main([*base, f'reference.base={{type="eight", {values}}}']) == 0


def test_files_that_an_experiment_names_are_looked_for_from_its_own_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, here = tmp_path / "mine", tmp_path / "here"
    folder.mkdir(), here.mkdir()
    time = np.linspace(0.0, 2.0, 21)
    rows = "\n".join(f"{t},{0.1 * t},0.0" for t in time)
    (folder / "motion.csv").write_text(f"t,arm_1_joint,arm_2_joint\n{rows}\n")
    shutil.copy(find("platform_arm"), folder / "mine.urdf")
    text = 'experiment = "track"\nrobot = "mine.urdf"\nreference.file = "motion.csv"\n'
    (folder / "mine.toml").write_text(text)
    (here / "next.toml").write_text('experiment = "../mine/mine.toml"\n')
    monkeypatch.chdir(here)
    for name in ("../mine/mine.toml", "next.toml"):
        experiment = load_experiment(name)
        robot = experiment.load_robot()
        assert Path(experiment.robot).resolve() == (folder / "mine.urdf").resolve()
        assert experiment.time.duration == 2.0
        assert experiment.trajectory_of(robot).arm[0].duration == 2.0  # type: ignore[attr-defined]
    shutil.copy(folder / "motion.csv", here / "other.csv")  # what is not there is looked for from here
    assert load_experiment("../mine/mine.toml", ["reference.file=other.csv"]).reference.file == "other.csv"


def test_folders_of_what_is_asked_for_are_made_by_every_command(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, table, figure = (
        tmp_path / name / "deeper" / f"a.{end}" for name, end in (("p", "html"), ("t", "csv"), ("f", "png"))
    )
    assert main(["replay", str(run), "--html", str(page)]) == 0
    assert main(["export", str(run), "--to", "csv", "--out", str(table)]) == 0
    assert main(["plot", str(run), "--out", str(figure)]) == 0
    assert page.is_file() and table.is_file() and figure.is_file()
    assert "missing folders are made" in " ".join(helped("replay", capsys).split())


def helped(command: str, capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    assert main([command, "--help"]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize(("seconds", "there"), [(0.5, {"RMS 0-0.5 s"}), (3.0, {"RMS 0-2 s", "RMS 2-3 s"})])
def test_windows_in_the_table_are_those_that_a_run_reaches(
    seconds: float, there: set[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    short = [*SHORT[2:], "--set", f"time.duration={seconds}", "--out", str(tmp_path / "out")]
    assert main(["run", "track", *short, "--set", "windows=[[0, 2], [2, 10]]", "--details"]) == 0
    assert set(re.findall(r"RMS [\d.]+-[\d.]+ s", capsys.readouterr().out)) == there
