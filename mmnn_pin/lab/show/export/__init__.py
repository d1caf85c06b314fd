"""A recording in the formats of other programs: CSV, NumPy's npz, Parquet, and MCAP for Foxglove and PlotJuggler."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from ....errors import RecordingError, UnknownName
from ....recording.recording import Recording
from ..whole import require_free, whole
from .tables import write_csv, write_npz, write_parquet

__all__ = ["FORMATS", "export"]

T = TypeVar("T")


def write_mcap(recording: Recording, path: Path) -> None:
    """Write MCAP, see `bag.write_bag`."""
    from .bag import write_bag

    write_bag(recording, path)


FORMATS: Mapping[str, Callable[[Recording, Path], None]] = {
    "csv": write_csv,
    "npz": write_npz,
    "parquet": write_parquet,
    "mcap": write_mcap,
}


def export(recording: Recording, path: str | Path, to: str = "", *, force: bool = False) -> Path:
    """Write a recording in another format; the file appears whole or not at all.

    Args:
        recording: The run.
        path: The file.
        to: One of `FORMATS`; by default what the file's name ends in.
        force: Replace an existing file.

    Raises:
        UnknownName: No such format.
        RecordingError: The file exists or cannot be written; a package is missing; for MCAP a recording that does not
            tell its robot.
    """
    path = Path(path)
    return write_as(FORMATS, "format", recording, path, to or path.suffix[1:].lower(), force)


def write_as(
    formats: Mapping[str, Callable[[T, Path], None]], what: str, content: T, path: Path, to: str, force: bool
) -> Path:
    """Write something in one of its formats; errors as in `export`."""
    if to not in formats:
        raise UnknownName(what, to, formats)
    require_free(path, force)
    with whole(path, "export") as part:
        try:
            formats[to](content, part)
        except ModuleNotFoundError as error:
            raise missing(to, error) from error
    return path


def missing(to: str, error: ModuleNotFoundError) -> RecordingError:
    """What to say where a package is not installed."""
    package, install = (error.name or "").partition(".")[0], "pip install 'mmnn_pin[export]'"
    return RecordingError(f"cannot export to {to}", why=f"the package {package} is not installed", fix=install)
