"""What a folder or file that a command is given holds: recordings, a study or a contest."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import ConfigError, RecordingError

if TYPE_CHECKING:
    from ..recording.recording import Recording

STUDY, CONTEST = "study.sqlite", ("contest.json", "rows.json")  # names of their files


def study_of(paths: tuple[Path, ...]) -> Path | None:
    """The database of a study among some paths: the path itself, or a file in the folder; None without one.

    Raises:
        ConfigError: It is not the only path.
    """
    inside = [path / STUDY for path in paths if (path / STUDY).is_file()]
    return alone("study", [*(path for path in paths if path.suffix == ".sqlite"), *inside], paths)


def contest_of(paths: tuple[Path, ...]) -> Path | None:
    """The folder of a contest among some paths; None without one.

    Raises:
        ConfigError: It is not the only path.
    """
    return alone("contest", [path for path in paths if any((path / name).is_file() for name in CONTEST)], paths)


def alone(what: str, found: list[Path], paths: tuple[Path, ...]) -> Path | None:
    """The first that was found, which has to be the only path.

    Raises:
        ConfigError: It is not.
    """
    if found and len(paths) > 1:
        raise ConfigError(f"a {what} among other runs", fix="name it alone", file=found[0])
    return found[0] if found else None


def open_runs(path: Path) -> list[Recording]:
    """The recording of a path, or all recordings of a folder.

    Raises:
        RecordingError: None there, or one that cannot be read.
    """
    from ..recording.recording import Recording

    files = sorted(path.glob("*.h5")) if path.is_dir() else [path]
    if not files:
        folders = [folder.name for folder in folders_of(path)]
        fix = f"name one of its folders: {', '.join(folders)}" if folders else "name one that `mmnn run` wrote"
        raise RecordingError("no recordings (*.h5) in this folder", fix=fix, file=path)
    return [Recording.open(file) for file in files]


def folders_of(path: Path) -> list[Path]:
    """Folders with recordings in a folder: the tasks of a contest, the cases of an experiment."""
    return sorted({file.parent for file in path.glob("*/*.h5")})


def recordings_in(path: Path) -> str:
    """The recordings of a folder in words, to choose one; with `FOLDER/` for those of its folders."""
    if here := sorted(path.glob("*.h5")):
        return f"name one of its recordings: {', '.join(file.name for file in here)}"
    folders = folders_of(path)
    if not folders:
        return "name a recording that `mmnn run` wrote"
    names = dict.fromkeys(file.name for folder in folders for file in sorted(folder.glob("*.h5")))
    where = ", ".join(folder.name for folder in folders)
    return f"name a recording FOLDER/FILE in it: FOLDER is one of {where}; FILE one of {', '.join(names)}"
