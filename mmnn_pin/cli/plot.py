"""`mmnn plot`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ConfigError, RecordingError
from .folders import contest_of, folders_of, open_runs
from .options import examples, law, shared
from .output import DONE, say, say_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..recording.recording import Recording

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
OF_CONTEST = ("contest-errors", "contest-fvu", "contest-learning", "contest-held-out")


@click.command(
    short_help="Plot recordings side by side.",
    epilog=examples(
        "mmnn plot runs/chapter4/pd.h5 runs/chapter4/two_layer.h5",
        "mmnn plot runs/chapter4 --what psi --what torque --out plots",
        "mmnn plot runs/chapter4 --what figure-4.2 --what gains --out plots",
        "mmnn plot runs/chapter4/two_layer.h5 --what path --out path.svg",
        "mmnn plot runs/contest --out plots                 the figures of a contest",
        "mmnn plot runs/contest/eight --what fvu            the runs of one of its tasks, first seed",
    ),
)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(path_type=Path))
@click.option(
    "--what",
    "whats",
    type=click.Choice((*WHATS, *OF_CONTEST)),
    multiple=True,
    help="What to draw; repeatable; contest-... of a contest's folder.  [default: errors; of a contest all four]",
)
@click.option("--out", type=click.Path(path_type=Path), help="A .png, .svg or .pdf file, or a folder.  [default: .]")
@click.option("--force", is_flag=True, help="Replace existing pictures.")
@law
@shared
def plot(runs: tuple[Path, ...], whats: tuple[str, ...], out: Path | None, force: bool, as_json: bool) -> int:
    """Plot recordings side by side. RUN is a recording, a folder with recordings, or the folder of one contest."""
    from ..lab.show.figure import FORMATS, save
    from ..lab.show.gallery import PICTURES

    folder = contest_of(runs)
    require_whats(whats, folder)
    recordings = named([recording for path in runs for recording in open_runs(path)]) if folder is None else {}
    wanted = tuple(dict.fromkeys(whats)) or (("errors",) if folder is None else OF_CONTEST)
    files = pictures(out or Path("."), wanted, FORMATS)
    for file in files.values():
        if file.exists() and not force:
            fix = "choose another with --out, or replace it with --force"
            raise RecordingError("the picture exists", fix=fix, file=file)
    told: dict[str, Any]
    if folder is None:
        told = {"runs": [str(recording.path) for recording in recordings.values()]}
        figures = {what: PICTURES[what](recordings) for what in files}
    else:
        told, figures = {"contest": str(folder)}, figures_of(folder, wanted)
    for what, file in files.items():
        save(figures[what], file)
    if as_json:
        say_json(told | {"files": {what: str(file) for what, file in files.items()}})
    else:
        say("\n".join(f"wrote {file}" for file in files.values()))
    return DONE


def require_whats(whats: tuple[str, ...], contest: Path | None) -> None:
    """Refuse plots of runs for a contest, and the other way round.

    Raises:
        ConfigError: With the name of the first.
    """
    for what in whats:
        if contest is None and what in OF_CONTEST:
            raise ConfigError(f"'{what}' is a figure of a contest", fix="name a contest's folder", key="--what")
        if contest is not None and what not in OF_CONTEST:
            folders = ", ".join(map(str, folders_of(contest)))
            fix = f"name the folder of a task: {folders}" if folders else f"there is: {', '.join(OF_CONTEST)}"
            raise ConfigError(f"'{what}' is a plot of the runs of one task", fix=fix, file=contest, key="--what")


def figures_of(folder: Path, whats: tuple[str, ...]) -> dict[str, Figure]:
    """Figures of the contest in a folder, drawn again.

    Raises:
        RecordingError: It has none, or no run that reached its end.
    """
    from ..lab.contest.contest import opened
    from ..lab.show.contest.figures import FIGURES

    standing = opened(folder)
    if not any(row.completed for row in standing.results):
        raise RecordingError("nothing to draw", why="no run reached its end", file=folder)
    return {what: FIGURES[what](standing) for what in whats}


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
