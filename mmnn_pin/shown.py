"""Tables, pictures and pages of results: their types, as editors see them, and the register of what makes them.

What makes them stands above what they are made of, in `lab.show` or `research`, and registers itself here with `shows`;
what they are made of asks with `shown`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self, TypeVar

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

F = TypeVar("F", bound=Callable[..., Any])
ABOVE: list[
    Callable[[], object]
] = []  # import what registers itself; each is called once, when first something is shown
SHOWS: dict[tuple[type, str], Callable[..., Any]] = {}


def shows(kind: type, what: str) -> Callable[[F], F]:
    """Register a function that makes something of a thing, its first argument.

    Args:
        kind: Type of the thing; children have it, too, unless they have their own.
        what: What is made, such as `text` or `html`.
    """

    def register(make: F) -> F:
        SHOWS[kind, what] = make
        return make

    return register


def filled() -> None:
    """Let all that stands above register itself, once."""
    while ABOVE:
        ABOVE.pop()()


def shown(thing: object, what: str, *args: Any, **kwargs: Any) -> Any:
    """The table, text, picture or page that is registered for a thing, made of it."""
    filled()
    make = next(SHOWS[kind, what] for kind in type(thing).__mro__ if (kind, what) in SHOWS)
    return make(thing, *args, **kwargs)


class AsText:
    """A thing that prints as text; a notebook shows the same."""

    def _repr_html_(self) -> str:
        from html import escape

        return f"<pre>{escape(str(self))}</pre>"


class ShownTable(Protocol):
    """Tables that print as text; a notebook shows them."""

    @property
    def text(self) -> str:
        """As `print` shows it."""

    def _repr_html_(self) -> str: ...


class ShownPicture(Protocol):
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


class ShownPage(Protocol):
    """A page of HTML that stands alone; a notebook shows it."""

    @property
    def html(self) -> str:
        """The whole page."""

    @property
    def size(self) -> int:
        """Its bytes."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Notes on things that could not be shown, one line each."""

    def save(self, path: str | Path, force: bool = True) -> Path:
        """Write it, whole or not at all; without `force` not in the place of another file."""

    def _repr_html_(self) -> str: ...


class ShownView(Protocol):
    """A robot in meshcat, on a server of this machine; a notebook shows it."""

    @property
    def url(self) -> str:
        """Of the page, with sliders and legend."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Notes on shapes that are not shown as the file says, one line each."""

    def display(self, q: ArrayLike) -> None:
        """Move the robot to a q, as `Robot` has it.

        Raises:
            ConfigError: It is of another size, or not finite.
        """

    def close(self) -> None:
        """End the server."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...

    def _repr_html_(self) -> str: ...
