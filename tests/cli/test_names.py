"""Names of others may hold what steers a terminal: none of it reaches one, our own styles do."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import h5py
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmnn_pin import PD, Feedback, load_experiment
from mmnn_pin.cli import main, output
from mmnn_pin.errors import printable
from mmnn_pin.lab.show.table import STYLES, Cell, Column, Row, Table, TextLine, terminal_text

HOSTILE = "\x1b]0;PWN\x07\x1b[31mred\u202e\x9b2J[bold]\\r\n"
STYLE = re.compile(r"\x1b\[[0-9;]*m")
texts = st.text(st.sampled_from("ab \n\t\r\x1b[31m]0;\x07\x9b\u202e\ufdd0\ufdd1\x00é"), max_size=30)


def steers(text: str) -> bool:
    """Whether a text has a character that steers a terminal, beside ends of lines and tabs."""
    return any(not c.isprintable() for c in text if c not in "\n\t")


@given(texts)
def test_what_is_printed_of_a_text_steers_nothing(text: str) -> None:
    found = output.safe(text)
    assert not steers(found) and len(found) == len(text)
    assert [c for c, own in zip(found, text, strict=True) if own.isprintable()] == [c for c in text if c.isprintable()]
    assert "\n" not in printable(text)


@given(texts, texts, st.sampled_from(["", *STYLES]))
def test_styles_of_tables_are_ours_alone(name: str, other: str, kind: str) -> None:
    table = Table("t", (Column(name, text=True, group=other), Column("x")), (Row((Cell(other, kind), Cell(name))),))
    plain, shown = (terminal_text([table, TextLine(name, "bold")], colour, 80) for colour in (False, True))
    assert not steers(plain) and not steers(STYLE.sub("", shown))
    assert output.safe(output.styled(shown)) == shown and not steers(output.safe(shown))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    experiment = load_experiment("track", ["time.duration=0.3"])
    robot, path = experiment.load_robot(), tmp_path_factory.mktemp("run") / "run.h5"
    experiment.loop(robot, PD(Feedback(500.0, 80.0))).run(path, meta={"config": experiment.to_json()})
    return path


ANYWAY = ("experiment", "plant", "outcome_message", "versions")  # facts that no command needs


@pytest.mark.parametrize("fact", ["robot", "controller", "labels", "anyway"])
def test_no_command_prints_what_a_recording_hides_in_names(
    fact: str, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(run, "run.h5")
    with h5py.File("run.h5", "r+") as file:
        if fact == "labels":
            for kind in ("velocity_names", "position_names", "actuator_names"):
                file.attrs[kind] = [HOSTILE if one == "arm_1_joint" else one for one in file.attrs[kind]]
            for signal in file["signals"].values():
                if "labels" in signal.attrs:
                    labels = signal.attrs["labels"]
                    signal.attrs["labels"] = [HOSTILE if one == "arm_1_joint" else one for one in labels]
        for name in () if fact == "labels" else ANYWAY if fact == "anyway" else (fact,):
            file.attrs[name] = f"json:{json.dumps({'mmnn_pin': HOSTILE})}" if name == "versions" else HOSTILE
        if fact == "anyway":
            file.attrs["outcome"] = "diverged"
    commands = (
        "report run.h5 --html r.html --no-replay", "export run.h5 --to csv --out a.csv", "plot run.h5 --out p",
        "replay run.h5 --html p.html", "identify run.h5 --robot platform_arm --out x",
    )  # fmt: skip
    for command in commands:
        assert main(command.split()) in (0, 1, 2)
        told = capsys.readouterr()
        assert not steers(told.out) and not steers(told.err), command
        assert "internal error" not in told.err
