"""What results are shown as: the types of tables, pictures and pages that editors see, and text in a notebook.

What makes them stands above what they are made of, in `lab.show`, and is found by name; these types stand below both.
"""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class AsText:
    """What prints as text; a notebook shows the same."""

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"


class Table(Protocol):
    """Tables that print as text; a notebook shows them."""

    @property
    def text(self) -> str:
        """As `print` shows it."""

    def _repr_html_(self) -> str: ...


class Picture(Protocol):
    """A figure; a notebook shows it."""

    @property
    def name(self) -> str:
        """Of the figure."""

    @property
    def figure(self) -> Figure:
        """It, as matplotlib has it."""

    def save(self, path: str | Path) -> Path:
        """Write it as PNG, SVG or PDF, by the suffix.

        Raises:
            RecordingError: Another suffix, or a place that cannot be written.
        """

    def _repr_html_(self) -> str: ...


class Page(Protocol):
    """A page of HTML that stands alone; a notebook shows it."""

    @property
    def html(self) -> str:
        """The whole page."""

    @property
    def size(self) -> int:
        """Its bytes."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What could not be shown, one line each."""

    def save(self, path: str | Path, force: bool = True) -> Path:
        """Write it, whole or not at all; without `force` not in the place of another file."""

    def _repr_html_(self) -> str: ...
