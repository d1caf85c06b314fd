"""Tables that are wider than the terminal: nothing is cut off, every number stands there once."""

from __future__ import annotations

import re

from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin.lab.show.table import Cell, Column, Row, Table, folded, row_of, terminal_text

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


def test_a_table_that_fits_stays_whole_and_marks_stay_with_their_cells() -> None:
    table = wide(["pd", "pid"])
    assert folded(table, 100) == [table]
    marked = Table("m", table.columns, (Row((Cell("row"), Cell("RMS"), Cell("1", "best", "*"), Cell("2"))),))
    (one, other) = folded(marked, 12)
    assert one.rows[0].cells[2] == Cell("1", "best", "*") and other.rows[0].cells[2] == Cell("2")
    assert [c.heading for c in one.columns] == ["", "", "pd"] and [c.heading for c in other.columns] == ["", "", "pid"]
