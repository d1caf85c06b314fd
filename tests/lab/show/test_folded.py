"""Tables that are wider than the terminal: nothing is cut off, every number stands there once."""

from __future__ import annotations

import re

from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin.lab.show.table import Cell, Column, Row, Table, broken, folded, row_of, terminal_text

names = st.lists(st.text("abcdefgh_", min_size=1, max_size=14), min_size=1, max_size=9, unique=True)


def wide(heads: list[str]) -> Table:
    rows = tuple(row_of(f"row {i}", "RMS", *(f"{1000 * i + j}.5" for j in range(len(heads)))) for i in range(1, 4))
    columns = (Column(text=True, fold=True), Column(text=True), *(Column(head) for head in heads))
    return Table("Wide", columns, rows)


@settings(max_examples=25, deadline=None)
@given(names, st.integers(40, 120))
def test_every_number_is_there_once_and_no_line_is_longer(heads: list[str], width: int) -> None:
    text = terminal_text([wide(heads)], width=width)
    assert all(len(line) <= width for line in text.splitlines()) and "\u2026" not in text
    numbers = re.findall(r"\d+\.5", text)
    assert sorted(numbers) == sorted(f"{1000 * i + j}.5" for i in range(1, 4) for j in range(len(heads)))
    for head in heads:
        assert head in text


def test_labels_are_not_squeezed_to_have_room_for_numbers() -> None:
    """At 100 columns, 18 controllers once left the labels 8 letters: `velocit`, `y w`."""
    labels = ("pose x [mm]", "peak torque wheel_right_joint", "velocity w [mrad/s]")
    rows = tuple(row_of(label, "RMS 2-10 s", *(f"{i}.25" for i in range(18))) for label in labels)
    columns = (Column(text=True, fold=True), Column(text=True), *(Column("controller") for _ in range(18)))
    table = Table("Many", columns, rows)
    for width in (80, 100, 200):
        text = terminal_text([table], width=width)
        assert all(text.count(label) == len(folded(table, width)) for label in labels)
    narrow = terminal_text([table], width=60)
    assert "wheel_right_joint" in narrow and narrow.count("velocity w") == len(folded(table, 60))
    assert all(len(line) <= 60 for line in narrow.splitlines())


def test_a_dumb_terminal_is_as_wide_as_it_is(monkeypatch) -> None:
    monkeypatch.setenv("TERM", "dumb")
    text = terminal_text([wide(["pd", "pid"]), "word " * 30], colour=True, width=50)
    assert all(len(line) <= 50 for line in re.sub(r"\x1b\[[0-9;]*m", "", text).splitlines())


def test_a_table_that_fits_stays_whole_and_marks_stay_with_their_cells() -> None:
    table = wide(["pd", "pid"])
    assert folded(table, 100) == [table]
    marked = Table("m", table.columns, (Row((Cell("row"), Cell("RMS"), Cell("1", "best", "*"), Cell("2"))),))
    (one, other) = folded(marked, 12)
    assert one.rows[0].cells[2] == Cell("1", "best", "*") and other.rows[0].cells[2] == Cell("2")
    assert [c.heading for c in one.columns] == ["", "", "pd"] and [c.heading for c in other.columns] == ["", "", "pid"]


@settings(max_examples=25, deadline=None)
@given(st.integers(55, 130), st.lists(st.text("abc_", min_size=1, max_size=18), min_size=1, max_size=4, unique=True))
def test_no_name_is_broken_by_columns_that_may_be_folded(width: int, heads: list[str]) -> None:
    """A study's: at 60 columns it broke `pose_error.[xy].peak` and `computed_torque`."""
    labels = ("pose_error.[xy].peak [mm]", "e.*.peak [mrad]", "success [%]")
    rows = tuple(row_of(label, "median", *("0.113 [0.0812, 0.168]" for _ in heads)) for label in labels)
    numbers = (Column(head, fold=True, letters=9) for head in heads)
    text = terminal_text(
        [Table("Study", (Column(text=True, fold=True), Column(text=True), *numbers), rows)], width=width
    )
    assert all(len(line) <= width for line in text.splitlines())
    words = {*text.split()}
    for head in heads:
        assert {*broken(head, 9).split()} <= words
    assert {"pose_error.[xy].peak", "e.*.peak", "0.113", "[0.0812,", "0.168]"} <= words


def test_a_path_in_a_line_stays_whole_and_other_words_are_wrapped() -> None:
    path = "/home/someone/a_workspace/src/my_robot-description/urdf/with/many/folders/my_robot.urdf"
    for colour in (False, True):
        text = re.sub(r"\x1b\[[0-9;]*m", "", terminal_text([f"Track: an eight ({path}, 10 s, seed 1)"], colour, 60))
        assert path in text
        assert all(len(line) <= 60 for line in text.splitlines() if path not in line)
