"""HTML pages that stand alone, made of templates and numbers.

The templates of reports lie in `web`, those of the replay in `replay/web`.
"""

from __future__ import annotations

import base64
import gzip
import json
from dataclasses import dataclass, field
from datetime import UTC, datetime
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...files import whole_file

TYPES = {"f4": np.float32, "u2": np.uint16, "u4": np.uint32}  # what the page can read
ALIGNMENT = 4


@dataclass(frozen=True, repr=False)
class HtmlPage:
    """A page of HTML that stands alone."""

    html: str = field(repr=False)  # the whole page
    warnings: tuple[str, ...] = ()  # what could not be shown, one line each
    what: str = "page"  # what it is, in a word
    height: str = "80vh"  # its height within a notebook, as CSS has it

    def __repr__(self) -> str:
        return f'<{self.what}: {self.size / 1e6:.2g} MB; .save("{self.what}.html") writes it>'

    @property
    def size(self) -> int:
        """Bytes of the page."""
        return len(self.html.encode())

    def _repr_html_(self) -> str:
        return self.iframe()

    def iframe(self, height: int | None = None) -> str:
        """The page as an element for another page, isolated from it; `height` in CSS pixels."""
        look = f"width:100%;height:{self.height if height is None else f'{height}px'};border:0"
        return (
            f'<iframe title="{self.what}" sandbox="allow-scripts" style="{look}" srcdoc="{escape(self.html)}"></iframe>'
        )

    def save(self, path: str | Path, force: bool = True) -> Path:
        """Write the page, whole or not at all.

        Args:
            path: The file.
            force: Whether it may replace another one.

        Raises:
            RecordingError: A place that cannot be written, or a file that is there.
        """
        with whole_file(Path(path), self.what, force) as part:
            part.write_text(self.html, encoding="utf-8")
        return Path(path)


def web_file(name: str, package: str = __package__) -> str:
    """A file of the folder `web` of a package."""
    return resources.files(package).joinpath("web", name).read_text("utf-8")


def fill_template(name: str, package: str = __package__, **values: Any) -> str:
    """A template of the folder `web` of a package with its values, and `made`: when that was.

    Templates include one another, and those of this module's folder, by name.
    """
    from jinja2 import Environment, FunctionLoader

    made = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    own = {file.name for file in resources.files(package).joinpath("web").iterdir()}
    loader = FunctionLoader(lambda other: web_file(other, package if other in own else __package__))
    templates = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return templates.get_template(name).render(made=made, **values)


class Blob:
    """Arrays for the page, little endian."""

    def __init__(self) -> None:
        self._data = bytearray()

    def add(self, array: NDArray[Any], kind: str) -> dict[str, Any]:
        """Store an array, flattened.

        Args:
            array: The numbers.
            kind: Their type in the page, one of `TYPES`.

        Returns:
            Where it is: what the JSON holds in its place.
        """
        data = np.ascontiguousarray(array, dtype=np.dtype(TYPES[kind]).newbyteorder("<")).tobytes()
        reference = {"type": kind, "at": len(self._data), "size": int(array.size)}
        self._data += data + bytes(-len(data) % ALIGNMENT)
        return reference

    def pack(self, header: dict[str, Any]) -> str:
        """Header and arrays as text: the header's length (4 bytes), the header as JSON, the arrays; compressed."""
        text = json.dumps(header, allow_nan=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % ALIGNMENT)
        return compressed(len(text).to_bytes(4, "little") + text + self._data)


def compressed(data: bytes) -> str:
    """Bytes as text that the page can unpack: gzip, then base64."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode()
