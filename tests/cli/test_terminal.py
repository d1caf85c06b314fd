"""What a shell and a log see: names completed by Tab, a line of progress every 10 s, tables as wide as the terminal."""

from __future__ import annotations

import io
import sys

import pytest
from click.testing import CliRunner

from mmnn_pin.cli import main, mmnn, output
from mmnn_pin.lab.experiments.config import keys_of, kind_at
from mmnn_pin.torque.entries import CONTROLLERS


def completed(words: str) -> list[str]:
    """What a bash completes the last of some words to."""
    count = len(words.split()) - (0 if words.endswith(" ") else 1)
    environment = {"COMP_WORDS": words, "COMP_CWORD": str(count), "_MMNN_COMPLETE": "bash_complete"}
    done = CliRunner().invoke(mmnn, env=environment, prog_name="mmnn")
    return [line.partition(",")[2] for line in done.stdout.splitlines() if line.startswith("plain,")]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("mmnn run chap", ["chapter4", "chapter5"]),
        ("mmnn run track --controller pd_e", [name for name in sorted(CONTROLLERS) if name.startswith("pd_e")]),
        ("mmnn embed track --controller kalman_b", ["kalman_bilinear"]),
        ("mmnn run track --robot platform_", ["platform_arm"]),
        ("mmnn inspect two_ax", ["two_axis_arm"]),
        ("mmnn run track --set feedba", ["feedback.base=", "feedback.arm=", "feedback.scaling="]),
        ("mmnn run track --set adap", ["adaptive.", "adaptive_composite."]),
        ("mmnn run track --set feedback.a", ["feedback.arm="]),
        ("mmnn readings chapter4 --set time.int", ["time.integrator="]),
        ("mmnn run track --set feedback.arm=3", []),
        ("mmnn stu", ["study"]),
        ("mmnn nothing here", []),
    ],
)
def test_a_shell_completes_names_and_keys(words: str, found: list[str]) -> None:
    assert completed(words) == found


def test_every_key_that_is_completed_exists() -> None:
    for words in completed("mmnn run track --set "):
        assert words.rstrip(".=") in keys_of(kind_at(None))


def test_a_log_gets_a_line_every_ten_seconds(capsys) -> None:
    clock = iter([0.0, 1.0, 9.9, 10.1, 12.0, 19.9, 25.0])
    lines = output.Lines(now=lambda: next(clock))
    for share in range(6):
        lines.show(lambda share=share: f"pd: {10 * share} %")
    told = capsys.readouterr()
    assert told.err.splitlines() == ["pd: 20 %, after 10 s", "pd: 50 %, after 25 s"] and told.out == ""


def test_a_log_gets_no_line_where_a_function_is_compiled_long_after_the_last(capsys) -> None:
    clock = Clock()
    tell = output.compiling_lines(clock)
    for clock.time in (4.0, 9.0, 600.0, 606.0, 611.0):
        tell()
    assert capsys.readouterr().err.splitlines() == ["compiling, 5 functions so far, after 611 s"]


class Clock:
    time = 0.0

    def __call__(self) -> float:
        return self.time


def test_progress_in_a_log_goes_to_standard_error(monkeypatch, capsys) -> None:
    monkeypatch.setattr(output, "EVERY", 0.0)
    with output.progress_bar() as show, output.counter("runs", 8, 2) as count:
        show("pd", 0.5)
        count(3, "1.0/s")
    told = capsys.readouterr()
    assert told.out == "" and [line.partition(", after")[0] for line in told.err.splitlines()] == [
        "pd: 50 %",
        "3 of 8 runs  1.0/s",
    ]


def test_tables_are_as_wide_as_the_terminal_and_plain_in_a_file(monkeypatch) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    assert output.look() == {}
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    for columns, wanted in ((63, 63), (10, output.NARROW), (999, output.WIDE)):
        monkeypatch.setenv("COLUMNS", str(columns))
        assert output.look() == {"colour": True, "width": wanted}
    monkeypatch.setattr(sys.stdout, "isatty", lambda: False, raising=False)
    assert output.look() == {"colour": False, "width": output.WIDE}  # asked for, as `COLUMNS=999 mmnn list | less`


@pytest.mark.parametrize("columns", [60, 200])
def test_lists_fold_below_each_other_and_break_no_name(columns: int, capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    assert main(["list"]) == 0
    listed = capsys.readouterr().out
    assert all(len(line) <= columns for line in listed.splitlines() if ".urdf" not in line and "robots in" not in line)
    assert main(["inspect", "tiago_dual"]) == 0
    told = capsys.readouterr().out.partition("\nfindings (")[0]
    assert "hand_right_little_flex_3_joint" in told
    for command in ("check", "model"):
        assert main([command, "platform_arm"]) == 0
        long = [line for line in capsys.readouterr().out.splitlines() if len(line) > columns]
        assert all("M <=" in line or "M nudot" in line for line in long)  # a formula is one line
    assert all(len(line) <= columns for line in told.splitlines() if "_joint, " in line)


def test_help_says_how_to_switch_completion_on(capsys) -> None:
    assert main(["--help"]) == 0
    assert "_MMNN_COMPLETE=bash_source mmnn" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("encoding", "told"),
    [
        ("ascii", r"arm_\u6a5f"),
        ("gbk", "arm_機"),
        ("euc-jp", "arm_機"),
        ("utf-8", "arm_機"),
        ("latin-1", r"arm_\u6a5f"),
    ],
)
def test_what_an_encoding_lacks_is_escaped(encoding: str, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding, newline="\n")
    monkeypatch.setattr(sys, "stdout", stream)
    output.say("arm_機 🙂\n─ arm")
    assert stream.buffer.getvalue().decode(encoding).startswith(told + " ")  # type: ignore[attr-defined]
    assert stream.buffer.getvalue().endswith(b" arm\n")  # type: ignore[attr-defined]
