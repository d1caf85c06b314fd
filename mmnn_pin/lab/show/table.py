"""A table as data, and how a terminal shows it; the pages have a macro of their own for the same data (`pages.html`).

What makes a table (a comparison, a contest, a study, a proof) says what stands in its cells and which of them are good
or bad. It knows nothing of colours, widths or tags.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

from ...errors import printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table as RichTable

WIDTH = 100  # columns of a terminal
HEIGHT = 25  # its rows; with both given, rich takes the width even where TERM=dumb
LABELS = 0.4  # share of a terminal that texts left of numbers keep before the numbers go below each other
UNBOUNDED = 100_000  # columns that no table needs
CUT = "\u2026"  # what rich puts where a text is cut off
Kind = Literal["", "best", "good", "bad", "warn", "dim"]
STYLES: dict[Kind, str] = {"best": "bold", "good": "green", "bad": "bold red", "warn": "yellow", "dim": "dim"}


@dataclass(frozen=True)
class Cell:
    """Text of a cell, what to think of it, and a mark beside it such as a star."""

    text: str
    kind: Kind = ""
    mark: str = ""


@dataclass(frozen=True)
class Column:
    """Head of a column.

    Attributes:
        heading: Its name; line breaks are for a terminal.
        unit: Unit of its numbers; empty for pure numbers and for texts.
        group: Name of the columns that it belongs to with its neighbours.
        text: Whether it holds texts, from the left; numbers end at the right.
        fold: Whether a terminal may break its texts, to have room.
        letters: Names longer than this are broken at underscores on a terminal.
    """

    heading: str = ""
    unit: str = ""
    group: str = ""
    text: bool = False
    fold: bool = False
    letters: int = 0

    @property
    def title(self) -> str:
        """The heading on one line, with group and unit."""
        words = " ".join(self.heading.split())
        unit = f" [{self.unit}]" if self.unit else ""
        return f"{self.group}: {words}{unit}" if self.group else words + unit


@dataclass(frozen=True)
class Row:
    """Cells of a row; whether a group of rows ends with it."""

    cells: tuple[Cell, ...]
    ends: bool = False


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        title: What it shows.
        columns: Their heads; those of texts stand at the left.
        rows: Its rows, a cell per column.
        notes: What marks and words mean, a sentence each.
        gap: Spaces between columns on a terminal, beside one.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
    gap: int = 2

    @property
    def spans(self) -> list[tuple[Row, int, bool]]:
        """Rows; how many rows the first cell of each names, 0 where one above does; whether a group ends with them."""
        starts = [i for i, row in enumerate(self.rows) if row.cells[0].text or i == 0 or self.rows[i - 1].ends]
        lengths = {start: end - start for start, end in pairwise([*starts, len(self.rows)])}
        spans = (lengths.get(i, 0) for i in range(len(self.rows)))
        return [
            (row, span, self.rows[i + max(span, 1) - 1].ends)
            for i, (row, span) in enumerate(zip(self.rows, spans, strict=True))
        ]

    @property
    def caption(self) -> str:
        """The notes as one text."""
        return " ".join(self.notes)


@dataclass(frozen=True)
class Line:
    """A line of text in a style of the terminal."""

    text: str
    style: str = ""


def row_of(*cells: str | Cell, ends: bool = False) -> Row:
    """A row of cells or of their texts."""
    return Row(tuple(cell if isinstance(cell, Cell) else Cell(cell) for cell in cells), ends)


def grouped(*groups: Iterable[Row]) -> tuple[Row, ...]:
    """Rows in groups, with a line after each."""
    every = [list(rows) for rows in groups]
    return tuple(Row(row.cells, row is rows[-1]) for rows in every for row in rows)


def terminal_text(parts: Iterable[str | Line | Table], colour: bool = False, width: int = WIDTH) -> str:
    """Lines and tables as text of at most `width` columns.

    Args:
        parts: What to show, in order.
        colour: Whether the terminal shows styles.
        width: Its columns.
    """
    from rich.console import Console
    from rich.text import Text

    colours: Literal["standard"] | None = "standard" if colour else None
    console = Console(width=width, height=HEIGHT, force_terminal=colour, color_system=colours)
    with console.capture() as capture:
        for part in (Line(part) if isinstance(part, str) else part for part in parts):
            if isinstance(part, Table):
                for piece in folded(safe(part), width):
                    console.print(laid_out(piece, console))
            else:
                console.print(
                    Text(wrapped(printable(part.text, "\n"), width)), style=part.style or None, soft_wrap=True
                )
    return "\n".join(line.rstrip() for line in capture.get().splitlines())


def safe(table: Table) -> Table:
    """A table whose texts do not steer a terminal."""
    heads = (replace(one, heading=printable(one.heading, "\n"), group=printable(one.group)) for one in table.columns)
    cells = ([replace(cell, text=printable(cell.text, "\n")) for cell in row.cells] for row in table.rows)
    rows = (replace(row, cells=tuple(own)) for row, own in zip(table.rows, cells, strict=True))
    return replace(table, columns=tuple(heads), rows=tuple(rows))


def wrapped(text: str, width: int) -> str:
    """A text in lines of at most `width` letters; a word that is longer, such as a path, stays whole."""
    room = textwrap.TextWrapper(width, break_long_words=False, break_on_hyphens=False, replace_whitespace=False)
    return "\n".join("\n".join(room.wrap(line)) for line in text.split("\n"))


def folded(table: Table, width: int) -> list[Table]:
    """A table that is too wide for a terminal as several below each other, each with the texts at its left."""
    heads = next((i for i, column in enumerate(table.columns) if not column.text), len(table.columns))
    pieces: list[Table] = []
    first = heads
    while first < len(table.columns) or not pieces:
        end = len(table.columns)
        while end > first + 1 and not fits(of_columns(table, heads, first, end), width):
            end -= 1
        pieces.append(of_columns(table, heads, first, end))
        first = end
    return pieces


def of_columns(table: Table, heads: int, first: int, end: int) -> Table:
    """The table with its first columns, and with those from one place to another; rows may end early."""
    kept = [*range(heads), *range(first, end)]
    rows = tuple(replace(row, cells=tuple(row.cells[i] for i in kept if i < len(row.cells))) for row in table.rows)
    return replace(table, columns=tuple(table.columns[i] for i in kept), rows=rows)


def fits(table: Table, width: int) -> bool:
    """Whether nothing of a table is cut off on a terminal, no word is broken, and texts left of numbers have room."""
    from rich.console import Console

    if gives_way(table):  # to any number, were it to be folded
        first, *others = table.columns
        width += max(0, widest(table) - least(table, width))
        table = replace(table, columns=(replace(first, fold=False), *others))
    console = Console(width=width, height=HEIGHT, color_system=None)
    with console.capture() as capture:
        console.print(terminal_table(table))
    cut = CUT in capture.get() and not any(CUT in cell.text for row in table.rows for cell in row.cells)
    return not cut and words_of(table) <= {*capture.get().split()}


def gives_way(table: Table) -> bool:
    """Whether texts left of a table's numbers may be folded."""
    first = table.columns[0]
    return first.text and first.fold and not all(column.text for column in table.columns)


def words_of(table: Table) -> set[str]:
    """The words in columns that may be folded."""
    texts = [broken(column.heading, column.letters) for column in table.columns if column.fold]
    for row in table.rows:
        texts += [cell.text for cell, column in zip(row.cells, table.columns, strict=False) if column.fold]
    return {word for text in texts for word in text.split()}


def laid_out(table: Table, console: Console) -> RichTable:
    """A table for a terminal: texts left of numbers give way to these no further than to `least`."""
    made = terminal_table(table)
    natural = console.measure(made, options=console.options.update(width=UNBOUNDED)).maximum
    if gives_way(table) and natural > console.width:
        made.columns[0].width = least(table, console.width)
    return made


def widest(table: Table) -> int:
    """Letters of the longest line in the first column."""
    return max(len(line) for text in first_texts(table) for line in text.split("\n"))


def least(table: Table, width: int) -> int:
    """Letters that the first column keeps: its longest word, and its share of the terminal if it needs that."""
    word = max((len(word) for text in first_texts(table) for word in text.split()), default=0)
    return max(word, min(widest(table), round(LABELS * width)))


def first_texts(table: Table) -> list[str]:
    """Heading and cells of the first column."""
    return [table.columns[0].heading, *(row.cells[0].text for row in table.rows)]


def terminal_table(table: Table) -> RichTable:
    """A table for rich; the cells of a column leave room for marks if any of them has one."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as RichTable
    from rich.text import Text

    made = RichTable(box=SIMPLE_HEAD, padding=(0, 0, 0, table.gap), pad_edge=False)
    marked = {i for row in table.rows for i, cell in enumerate(row.cells) if cell.mark}
    group = ""
    for column in table.columns:
        above = f"{broken(column.group, column.letters)}\n" if column.group != group else ""
        unit = f" [{column.unit}]" if column.unit else ""
        head = Text(f"{above if column.group else ''}{broken(column.heading, column.letters)}{unit}")
        justify: Literal["left", "right"] = "left" if column.text else "right"
        made.add_column(head, justify=justify, no_wrap=not column.fold, overflow="fold" if column.fold else "ellipsis")
        group = column.group
    for row in table.rows:
        cells = []
        for i, cell in enumerate(row.cells):
            room = f" {cell.mark or ' '}" if i in marked and cell.text else ""
            cells.append(Text("\n".join(f"{line}{room}" for line in cell.text.split("\n")), STYLES.get(cell.kind, "")))
        made.add_row(*cells, end_section=row.ends)
    return made


def broken(name: str, letters: int) -> str:
    """A name in lines of at most so many letters, as far as its words allow; 0 for one line."""
    if not letters:
        return name
    lines = [""]
    for word in name.split("_"):
        longer = f"{lines[-1]}_{word}" if lines[-1] else word
        lines = [*lines[:-1], longer] if len(longer) <= letters or not lines[-1] else [*lines, word]
    return "\n".join(lines)


def number(value: float, infinite: str = "-") -> str:
    """Three significant digits; a dash where there is no number, a word for infinity."""
    if not math.isfinite(value):
        return infinite if value > 0 else "-"
    if value == 0:
        return "0"
    if not 1e-3 <= abs(value) < 1e5:
        return f"{value:.1e}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"
