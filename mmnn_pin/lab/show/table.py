"""A table as data, and how a terminal shows it; the pages have a macro of their own for the same data (`table.html`).

What makes a table (a comparison, a study, a proof) says what stands in its cells and which of them are good
or bad. It knows nothing of colours, widths or tags.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

from ...errors import few, printable

if TYPE_CHECKING:
    from rich.table import Table as RichTable

WIDTH = 100  # columns of a terminal
HEIGHT = 25  # its rows; with both given, rich takes the width even where TERM=dumb
LABELS = 0.4  # share of a terminal that texts left of numbers keep before the numbers go below each other
UNBOUNDED = 100_000  # columns that no line needs
NARROWEST = 24  # columns that a text beside others has at least
CellKind = Literal["", "best", "good", "bad", "warn", "dim"]
STYLES: dict[CellKind, str] = {"best": "bold", "good": "green", "bad": "bold red", "warn": "yellow", "dim": "dim"}


@dataclass(frozen=True)
class Cell:
    """Text of a cell, what to think of it, and a mark beside it such as a star."""

    text: str
    kind: CellKind = ""
    mark: str = ""


@dataclass(frozen=True)
class Column:
    """Head of a column."""

    heading: str = ""  # its name; line breaks are for a terminal
    unit: str = ""  # unit of its numbers; empty for pure numbers and for texts
    group: str = ""  # name of the columns that it belongs to with its neighbours
    text: bool = False  # whether it holds texts, from the left; numbers end at the right
    fold: bool = False  # whether a terminal may break its texts, to have room
    letters: int = 0  # names longer than this are broken at underscores on a terminal

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


NAMED = re.compile(r"'[^']*'")
SPECIFIC = re.compile(r"'[^']*'|[-+0-9.e]*[0-9][-+0-9.e]*")  # names and numbers in a line


@dataclass(frozen=True)
class Table:
    """A table."""

    title: str  # what it shows
    columns: tuple[Column, ...]  # their heads; those of texts stand at the left
    rows: tuple[Row, ...]  # its rows, a cell per column
    notes: tuple[str, ...] = ()  # what marks and words mean, a sentence each
    gap: int = 2  # spaces between columns on a terminal, beside one

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
class TextLine:
    """A line of text in a style of the terminal; a whole one, such as a command, is not wrapped."""

    text: str
    style: str = ""
    whole: bool = False


def row_of(*cells: str | Cell, ends: bool = False) -> Row:
    """A row of cells or of their texts."""
    return Row(tuple(cell if isinstance(cell, Cell) else Cell(cell) for cell in cells), ends)


def grouped(*groups: Iterable[Row]) -> tuple[Row, ...]:
    """Rows in groups, with a line after each."""
    every = [list(rows) for rows in groups]
    return tuple(Row(row.cells, row is rows[-1]) for rows in every for row in rows)


def terminal_text(parts: Iterable[str | TextLine | Table], colour: bool = False, width: int = WIDTH) -> str:
    """Lines and tables as text of at most `width` columns.

    Args:
        parts: What to show, in order.
        colour: Whether the terminal shows styles.
        width: Its columns.
    """
    from rich.console import Console
    from rich.text import Text

    colours: Literal["standard"] | None = "standard" if colour else None
    console = Console(width=width, height=HEIGHT, force_terminal=colour, color_system=colours, force_jupyter=False)
    with console.capture() as capture:
        for part in (TextLine(part) if isinstance(part, str) else part for part in parts):
            if isinstance(part, Table):
                for piece in folded(safe(part), width):
                    console.print(terminal_table(piece, width))
            else:
                room, text = UNBOUNDED if part.whole else width, printable(part.text, "\n")
                lines = Text("\n".join(hanging("", line, room) for line in text.split("\n")))
                console.print(lines, style=part.style or None, soft_wrap=True)
    text = "\n".join(line.rstrip() for line in capture.get().splitlines())
    return re.sub(r"\n{3,}", "\n\n", text)  # a table ends and begins with an empty line


def safe(table: Table) -> Table:
    """A table whose texts do not steer a terminal."""
    heads = (replace(one, heading=printable(one.heading, "\n"), group=printable(one.group)) for one in table.columns)
    cells = ([replace(cell, text=printable(cell.text, "\n")) for cell in row.cells] for row in table.rows)
    rows = (replace(row, cells=tuple(own)) for row, own in zip(table.rows, cells, strict=True))
    return replace(table, columns=tuple(heads), rows=tuple(rows))


def alike(lines: Iterable[str], least: int = 3) -> list[str]:
    """Lines, those that differ only in names, numbers and places as one with how many there are.

    Args:
        lines: The lines, of which a kind stands where its first one did.
        least: How many there must be of a kind.
    """
    kinds = dict[str, list[str]]()
    for line in lines:
        kinds.setdefault(SPECIFIC.sub("", line), []).append(line)
    found = []
    for kind in kinds.values():
        if len(kind) < least:
            found += kind
            continue
        names = list(dict.fromkeys(name for line in kind[1:] for name in NAMED.findall(line)))
        of = f": {few(names)}" if names else ""
        found.append(f"{kind[0]} (and {len(kind) - 1} more like it{of})")
    return found


def hanging(head: str, text: str, width: int) -> str:
    """A text behind a head, its lines below each other, at most `width` columns wide.

    A longer word, such as a path, stays whole. Where the head leaves no room, the text stands on lines of its own.
    """
    room = textwrap.TextWrapper(width, break_long_words=False, break_on_hyphens=False)
    if len(head) > width - NARROWEST:
        room.initial_indent = room.subsequent_indent = "  "
        return f"{head.rstrip()}\n{room.fill(text)}"
    room.initial_indent, room.subsequent_indent = head, " " * len(head)
    return room.fill(text)


def folded(table: Table, width: int) -> list[Table]:
    """A table that is too wide for a terminal as several below each other, each with the texts at its left."""
    heads = next((i for i, column in enumerate(table.columns) if not column.text), len(table.columns))
    pieces: list[Table] = []
    first = heads
    while first < len(table.columns) or not pieces:
        end = len(table.columns)
        while end > first + 1 and excess(piece := of_columns(table, heads, first, end), least(piece, width), width) > 0:
            end -= 1
        pieces.append(of_columns(table, heads, first, end))
        first = end
    return pieces


def of_columns(table: Table, heads: int, first: int, end: int) -> Table:
    """The table with its first columns, and with those from one place to another; rows may end early."""
    kept = [*range(heads), *range(first, end)]
    rows = tuple(replace(row, cells=tuple(row.cells[i] for i in kept if i < len(row.cells))) for row in table.rows)
    return replace(table, columns=tuple(table.columns[i] for i in kept), rows=rows)


def excess(table: Table, widths: Sequence[int], width: int) -> int:
    """Letters by which a table with columns of these widths is wider than a terminal."""
    return 2 + sum(widths) + (1 + table.gap) * (len(widths) - 1) - width


def terminal_texts(table: Table) -> list[list[str]]:
    """Head and cells of every column as a terminal shows them; cells leave room for marks if one of theirs has some."""
    texts, group = [], ""
    for i, column in enumerate(table.columns):
        above = f"{broken(column.group, column.letters)}\n" if column.group not in ("", group) else ""
        unit = f" [{column.unit}]" if column.unit else ""
        cells = [row.cells[i] if i < len(row.cells) else Cell("") for row in table.rows]
        is_marked, group = any(cell.mark for cell in cells), column.group
        rooms = [f" {cell.mark or ' '}" if is_marked and cell.text else "" for cell in cells]
        own = (c.text.replace("\n", f"{room}\n") + room for c, room in zip(cells, rooms, strict=True))
        texts.append([f"{above}{broken(column.heading, column.letters)}{unit}", *own])
    return texts


def natural(table: Table) -> list[int]:
    """Letters of the longest line of every column."""
    from rich.cells import cell_len

    return [max(cell_len(line) for text in column for line in text.split("\n")) for column in terminal_texts(table)]


def least(table: Table, width: int) -> list[int]:
    """Letters that every column keeps on a narrow terminal: its longest word where it may be folded, else all.

    Texts left of numbers keep their share of the terminal, too.
    """
    from rich.cells import cell_len

    found, is_all_text = natural(table), all(column.text for column in table.columns)
    for i, (column, texts) in enumerate(zip(table.columns, terminal_texts(table), strict=True)):
        if column.fold:
            words = [cell_len(word) for text in texts for word in text.split()]
            share = round(LABELS * width) if i == 0 and column.text and not is_all_text else 0
            found[i] = max(*words, min(found[i], share), 0)
    return found


def column_widths(table: Table, width: int) -> list[int]:
    """Letters of every column: the widest ones give way where a terminal is narrow, as far as `least` lets them."""
    found, smallest = natural(table), least(table, width)
    while excess(table, found, width) > 0 and (wide := [i for i, n in enumerate(found) if n > smallest[i]]):
        found[max(wide, key=found.__getitem__)] -= 1
    return found


def terminal_table(table: Table, width: int) -> RichTable:
    """A table for rich, at most so wide as a terminal where its columns can be."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as RichTable
    from rich.text import Text

    made = RichTable(box=SIMPLE_HEAD, padding=(0, 0, 0, table.gap), pad_edge=False)
    texts = terminal_texts(table)
    for column, (head, *_), letters in zip(table.columns, texts, column_widths(table, width), strict=True):
        justify: Literal["left", "right"] = "left" if column.text else "right"
        overflow: Literal["fold", "ellipsis"] = "fold" if column.fold else "ellipsis"
        made.add_column(Text(head), justify=justify, no_wrap=not column.fold, overflow=overflow, width=letters)
    for i, row in enumerate(table.rows):
        cells = (Text(own[i + 1], STYLES.get(cell.kind, "")) for own, cell in zip(texts, row.cells, strict=False))
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
