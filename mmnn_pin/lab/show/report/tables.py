"""The terminal's tables as rows of cells for the page: the same numbers, from the same place."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from rich.table import Table as RichTable
from rich.text import Text

from ...experiments.runner import Result
from .. import verdicts
from ..table import caption, comparison

SHARES = ("better", "gain", "learning", "gain : learning")


@dataclass(frozen=True)
class Cell:
    """Text of a cell; `best`, `bad` or nothing about it."""

    text: str
    kind: str = ""


@dataclass(frozen=True)
class Row:
    """Cells of a row; whether a group of rows ends with it."""

    cells: tuple[Cell, ...]
    ends: bool = False


@dataclass(frozen=True)
class Table:
    """A table of the page.

    Attributes:
        title: What it shows.
        heads: Heads of its columns.
        rows: Its rows.
        leading: How many columns at its left are names.
        caption: What marks and words mean.
    """

    title: str
    heads: tuple[str, ...]
    rows: tuple[Row, ...]
    leading: int = 1
    caption: str = ""


def tables_of(result: Result) -> Iterator[Table]:
    """Comparison; gain or learning; the thesis's figures. Those that the result has something for."""
    about = caption(result).replace(verdicts.ABOUT_SHARES, "").removesuffix("! outside of its interval.").strip()
    yield Table("Comparison", ("", "", *result.recordings), rows_of(comparison(result)), 2, about)
    if improvements := result.improvements():
        window = result.experiment.windows[-1]
        heads = [f"{learner}: {head}" for learner in improvements for head in SHARES]
        head = f"RMS {window[0]:g}-{window[1]:g} s, % of pd's"
        rows = rows_of(verdicts.shares(improvements, window))
        yield Table("Gain or learning", (head, *heads), rows, 1, verdicts.ABOUT_SHARES)
    if found := result.largest_errors():
        largest = verdicts.largest(found)
        names = tuple(plain(column.header) for column in largest.columns)
        yield Table("The largest errors that chapter 5 prints", names, rows_of(largest), 1, verdicts.ABOUT_LARGEST)
    if ranges := result.figure_ranges():
        figures = verdicts.figures(ranges)
        met = plain(figures.columns[0].header)
        heads = ["", *(plain(column.header) for column in figures.columns[1:])]
        yield Table("The thesis's figures", tuple(heads), rows_of(figures), 1, f"{met}. ! outside of its interval.")


def rows_of(table: RichTable) -> tuple[Row, ...]:
    """Rows of a table made for the terminal."""
    columns = [list(column.cells) for column in table.columns]
    return tuple(
        Row(tuple(cell(column[i]) for column in columns), bool(row.end_section)) for i, row in enumerate(table.rows)
    )


def cell(content: object) -> Cell:
    """A cell made for the terminal: what is red there is bad, what is bold is best."""
    style = str(content.style) if isinstance(content, Text) else ""
    return Cell(plain(content).strip(), "bad" if "red" in style else "best" if "bold" in style else "")


def plain(content: object) -> str:
    """Text without style, on one line."""
    return " ".join((content.plain if isinstance(content, Text) else str(content)).split())
