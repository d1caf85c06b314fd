"""A page of HTML that stands alone: how it is filled and written, its size, how it stands within another page."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import Any, ClassVar

from .whole import whole


@dataclass(frozen=True)
class HtmlPage:
    """A page.

    Attributes:
        html: The whole page.
    """

    html: str = field(repr=False)

    what: ClassVar[str] = "page"

    @property
    def size(self) -> int:
        """Bytes of the page."""
        return len(self.html.encode())

    def within(self, height: str) -> str:
        """The page as an element for another page, isolated from it, as high as a length of CSS."""
        look = f"width:100%;height:{height};border:0"
        return (
            f'<iframe title="{self.what}" sandbox="allow-scripts" style="{look}" srcdoc="{escape(self.html)}"></iframe>'
        )

    def save(self, path: str | Path) -> Path:
        """Write the page; the file appears whole or not at all.

        Raises:
            RecordingError: A place that cannot be written.
        """
        with whole(Path(path), self.what) as part:
            part.write_text(self.html, encoding="utf-8")
        return Path(path)


def filled(template: str, **values: Any) -> str:
    """A template with its values, and `made`: when that was."""
    from jinja2 import Environment

    made = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    found = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True).from_string(template)
    return found.render(made=made, **values)
