"""`mmnn plot`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import ConfigError, RecordingError
from .options import examples, law, shared
from .output import DONE, say, say_json

if TYPE_CHECKING:
    from ..recording import Recording

STUDY = "study.sqlite"  # name of a study's database
WHATS = (
    "errors",
    "torque",
    "psi",
    "gains",
    "path",
    "weights",
    "residuals",
    "step-times",
    "fvu",
    "frozen",
    "shares",
    "ranks",
    "lyapunov",
    "lyapunov-terms",
    "equality",
    "figure-4.2",
    "figure-4.3",
    "figure-4.4",
    "figure-5.3",
    "figure-5.4",
    "figure-5.5",
)


@click.command(
    short_help="Plot recordings side by side.",
    epilog=examples(
        "mmnn plot runs/chapter4/pd.h5 runs/chapter4/two_layer.h5",
        "mmnn plot runs/chapter4 --what psi --what torque --out plots",
        "mmnn plot runs/chapter4 --what figure-4.2 --what gains --out plots",
        "mmnn plot runs/chapter4/two_layer.h5 --what path --out path.svg",
    ),
)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(path_type=Path))
@click.option("--what", "whats", type=click.Choice(WHATS), multiple=True, default=("errors",), show_default=True)
@click.option("--out", type=click.Path(path_type=Path), help="A .png, .svg or .pdf file, or a folder.  [default: .]")
@click.option("--force", is_flag=True, help="Replace existing pictures.")
@law
@shared
def plot(runs: tuple[Path, ...], whats: tuple[str, ...], out: Path | None, force: bool, as_json: bool) -> int:
    """Plot recordings side by side. RUN is a recording, or a folder with recordings."""
    from ..show.figure import FORMATS, save
    from ..show.gallery import PICTURES

    recordings = named([recording for path in runs for recording in open_runs(path)])
    files = pictures(out or Path("."), tuple(dict.fromkeys(whats)), FORMATS)
    for file in files.values():
        if file.exists() and not force:
            fix = "choose another with --out, or replace it with --force"
            raise RecordingError("the picture exists", fix=fix, file=file)
    figures = {what: PICTURES[what](recordings) for what in files}
    for what, file in files.items():
        save(figures[what], file)
    if as_json:
        paths = [str(recording.path) for recording in recordings.values()]
        say_json({"runs": paths, "files": {what: str(file) for what, file in files.items()}})
    else:
        say("\n".join(f"wrote {file}" for file in files.values()))
    return DONE


def study_of(paths: tuple[Path, ...]) -> Path | None:
    """The database of a study among some paths: the path itself, or a file in the folder; None without one.

    Raises:
        ConfigError: It is not the only path.
    """
    inside = [path / STUDY for path in paths if (path / STUDY).is_file()]
    found = [*(path for path in paths if path.suffix == ".sqlite"), *inside]
    if found and len(paths) > 1:
        raise ConfigError("a study among other runs", fix="name it alone", file=found[0])
    return found[0] if found else None


def open_runs(path: Path) -> list[Recording]:
    """The recording of a path, or all recordings of a folder.

    Raises:
        RecordingError: None there, or one that cannot be read.
    """
    from ..recording import Recording

    files = sorted(path.glob("*.h5")) if path.is_dir() else [path]
    if not files:
        raise RecordingError("no recordings (*.h5) in this folder", fix="name one that `mmnn run` wrote", file=path)
    return [Recording.open(file) for file in files]


def named(recordings: list[Recording]) -> dict[str, Recording]:
    """Recordings by controller, or by file where two have the same one.

    Raises:
        RecordingError: One holds no rows, or they are of robots with different velocities.
    """
    names = [str(recording.meta.get("controller", recording.path)) for recording in recordings]
    if len(set(names)) < len(names):
        names = [str(recording.path) for recording in recordings]
    for recording in recordings:
        if not len(recording):
            raise RecordingError("holds no rows", why="the run ended before its first sample", file=recording.path)
        if recording.labels("torque") != recordings[0].labels("torque"):
            here, there = (", ".join(r.labels("torque")) for r in (recording, recordings[0]))
            why = f"it moves in {here}; {recordings[0].path} in {there}"
            raise RecordingError("a recording of another robot", why=why, fix="plot them apart", file=recording.path)
    return dict(zip(names, recordings, strict=True))


def pictures(out: Path, whats: tuple[str, ...], formats: tuple[str, ...]) -> dict[str, Path]:
    """File of every plot: the one named, or one per plot in the folder named.

    Raises:
        ConfigError: One file for several plots, or a format that is not offered.
    """
    if not out.suffix or out.is_dir():
        return {what: out / f"{what}.png" for what in whats}
    if out.suffix[1:].lower() not in formats:
        fix = f"end its name in {', '.join(f'.{name}' for name in formats)}, or name a folder"
        raise ConfigError(f"unknown format '{out.suffix}'", fix=fix, file=out, key="--out")
    if len(whats) > 1:
        raise ConfigError(f"one file for {len(whats)} plots", fix="name a folder", file=out, key="--out")
    return {whats[0]: out}
