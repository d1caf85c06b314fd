"""What `mmnn report`, `plot` and objects show with this package installed; importing it registers all."""

from __future__ import annotations

from pathlib import Path

from mmnn_pin.lab.show.folders import FOLDERS, FolderKind

from .contest import show as contest
from .contest.contest import ABOUT, RESULTS, opened
from .proof import figures, text

MODULES = (contest, figures, text)  # that register themselves


def contests(path: Path) -> list[Path]:
    """The folder of a contest."""
    return [path] if any((path / name).is_file() for name in (ABOUT, RESULTS)) else []


FOLDERS["contest"] = FolderKind(contests, opened, contest.page)
