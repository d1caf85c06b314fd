"""Folders and files that hold something else than runs: how each is found, opened, and made a page of.

A kind with figures (`@figure(NAME, of=KIND)`) can be plotted, too. A kind registers itself here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from os.path import lexists
from pathlib import Path
from typing import Any

from ..study.results import load_results
from . import identified, study
from .files import HtmlPage

RESULTS = ("results.jsonl", "study.sqlite")  # of studies; the second is of old versions, and refused in one line
IDENTIFIED = "*.identified.json"


@dataclass(frozen=True)
class FolderKind:
    """A kind of thing that a path may hold in place of runs."""

    finds: Callable[[Path], Iterable[Path]]  # a path as the user names it to where this is, none where it holds none
    opened: Callable[[Path], Any]  # that to what it holds
    page: Callable[[Any, str], HtmlPage]  # what it holds and the command that asks to a page


def studies(path: Path) -> list[Path]:
    """The results of a study."""
    inside = [path / name for name in RESULTS if lexists(path / name)]
    return [path] if path.suffix in (".jsonl", ".sqlite") else inside[:1]


def identifications(path: Path) -> list[Path]:
    """Reports that `mmnn identify` wrote."""
    return [file for file in (path, *path.glob(IDENTIFIED)) if file.match(IDENTIFIED)]


FOLDERS = {
    "study": FolderKind(studies, load_results, study.page),
    "identification": FolderKind(identifications, Path, identified.page),
}
