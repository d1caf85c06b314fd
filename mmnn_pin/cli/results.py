"""`mmnn plot`, `replay`, `report` and `export`: what is made of recordings, of a study, of a contest."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ConfigError, RecordingError
from .options import examples, law, shared
from .output import DONE, contest_of, folders_of, open_runs, require_no_pictures, say, say_json, study_of, warn

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..lab.show.files import HtmlPage
    from ..lab.show.replay import Page
    from ..recording.recording import Recording


RUNS = click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(path_type=Path))
PACKAGE_DIRS = click.option(
    "--package-dir", "package_dirs", metavar="DIR", multiple=True, help="Where package:// meshes are; repeatable."
)
TO = ("csv", "npz", "parquet", "mcap")


def whats() -> tuple[str, ...]:
    """Names of all figures of runs."""
    from ..lab.show.gallery import PICTURES

    return tuple(PICTURES)


def contest_whats() -> tuple[str, ...]:
    """Names of all figures of a contest."""
    from ..lab.show.gallery import FIGURES

    return tuple(FIGURES["contest"])


class FigureName(click.Choice[str]):
    """A figure by its name in the register, which is imported when a name is looked up and not before."""

    def __init__(self) -> None:
        super().__init__(())

    @property
    def choices(self) -> tuple[str, ...]:
        """The names."""
        return (*whats(), *contest_whats())

    @choices.setter
    def choices(self, names: Sequence[str]) -> None:
        """Click sets them; the register has them."""


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
@RUNS
@click.option(
    "--what",
    "whats",
    type=FigureName(),
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
    wanted = tuple(dict.fromkeys(whats)) or (("errors",) if folder is None else contest_whats())
    files = pictures(out or Path("."), wanted, FORMATS)
    require_no_pictures(files.values(), "picture", "choose another with --out", force)
    facts: dict[str, Any]
    if folder is None:
        facts = {"runs": [str(recording.path) for recording in recordings.values()]}
        figures = {what: PICTURES[what](recordings) for what in files}
    else:
        facts, figures = {"contest": str(folder)}, figures_of(folder, wanted)
    for what, file in files.items():
        save(figures[what], file)
    if as_json:
        say_json(facts | {"files": {what: str(file) for what, file in files.items()}})
    else:
        say("\n".join(f"wrote {file}" for file in files.values()))
    return DONE


def require_whats(whats: tuple[str, ...], contest: Path | None) -> None:
    """Refuse plots of runs for a contest, and the other way round.

    Raises:
        ConfigError: With the name of the first.
    """
    of_contest = contest_whats() if whats else ()
    for what in whats:
        if contest is None and what in of_contest:
            raise ConfigError(f"'{what}' is a figure of a contest", fix="name a contest's folder", key="--what")
        if contest is not None and what not in of_contest:
            folders = ", ".join(map(str, folders_of(contest)))
            fix = f"name the folder of a task: {folders}" if folders else f"there is: {', '.join(of_contest)}"
            raise ConfigError(f"'{what}' is a plot of the runs of one task", fix=fix, file=contest, key="--what")


def figures_of(folder: Path, whats: tuple[str, ...]) -> dict[str, Figure]:
    """Figures of the contest in a folder, drawn again.

    Raises:
        RecordingError: It has none, or no run that reached its end.
    """
    from ..lab.contest.contest import opened
    from ..lab.show.figure import FIGURES

    standing, register = opened(folder), FIGURES["contest"]
    if why := next(iter(register.values())).lacks(standing):
        raise RecordingError("nothing to draw", why=why, file=folder)
    return {what: register[what].make(standing) for what in whats}


def named(recordings: list[Recording]) -> dict[str, Recording]:
    """Recordings of robots alike, by name.

    Raises:
        RecordingError: One holds no rows, or they are of robots with different velocities.
    """
    for recording in recordings:
        if not len(recording):
            raise RecordingError("holds no rows", why="the run ended before its first sample", file=recording.path)
        if recording.labels("torque") != recordings[0].labels("torque"):
            here, there = (", ".join(r.labels("torque")) for r in (recording, recordings[0]))
            why = f"it moves in {here}; {recordings[0].path} in {there}"
            raise RecordingError("a recording of another robot", why=why, fix="plot them apart", file=recording.path)
    return by_name(recordings)


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


@click.command(
    short_help="Play recordings in the browser.",
    epilog=examples(
        "mmnn replay runs/chapter4/two_layer.h5",
        "mmnn replay runs/chapter4/two_layer.h5 runs/chapter4/pd.h5       both in one scene",
        "mmnn replay runs/track/pd.h5 --html pd.html                      one file that opens anywhere",
        "mmnn replay my_run.h5 --package-dir ~/ros/src                    meshes of package:// are there",
    ),
)
@RUNS
@click.option("--html", type=click.Path(path_type=Path), help="Write the page to this file and open nothing.")
@click.option("--force", is_flag=True, help="Replace that file.")
@click.option("--fps", type=click.FloatRange(0.1, 1000), default=60, show_default=True, help="Frames kept per second.")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=7007, show_default=True, help="Or the next that is free."
)
@click.option("--no-browser", is_flag=True, help="Only tell the address.")
@PACKAGE_DIRS
@shared
def replay(
    runs: tuple[Path, ...],
    html: Path | None,
    force: bool,
    fps: float,
    port: int,
    no_browser: bool,
    package_dirs: tuple[str, ...],
    as_json: bool,
) -> int:
    """Play recordings in the browser, several in one scene.

    RUN is a recording, or a folder with recordings. Without --html the page is served on this machine only, until
    Ctrl-C.
    """
    parent = os.getppid()  # before anything slow: a parent that dies meanwhile counts, too
    from ..lab.show.replay import page

    if html is not None and html.exists() and not force:
        raise RecordingError("the file exists", fix="choose another, or replace it with --force", file=html)
    recordings = by_name([recording for path in runs for recording in open_runs(path)])
    made = page(recordings, fps=fps, package_dirs=package_dirs)
    for warning in made.warnings:
        warn(warning)
    facts = {"runs": [str(r.path) for r in recordings.values()], "bytes": made.size, "frames": made.frames}
    facts |= {"samples": made.samples, "warnings": list(made.warnings)}
    if html is None:
        return serve(made, port, no_browser, parent, facts if as_json else None)
    made.save(html)
    if as_json:
        say_json(facts | {"html": str(html)})
    else:
        say(f"wrote {html}: {summary(made)}")
    return DONE


def serve(made: Page, port: int, no_browser: bool, parent: int, facts: dict[str, Any] | None) -> int:
    """Serve a page until Ctrl-C or until the parent process is gone; `facts` are printed as JSON."""
    import webbrowser

    from ..lab.show.replay.server import served, wait_until_left

    with served(made.html, port) as url:
        if facts is None:
            say(f"replay at {url} ({summary(made)}); Ctrl-C ends it")
        else:
            say_json(facts | {"url": url})
        if not no_browser and has_display():
            webbrowser.open(url)
        wait_until_left(parent)
    return DONE


def has_display() -> bool:
    """Whether a browser could show something; without, one that works in the terminal might take it over."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))


def summary(made: Page) -> str:
    """Size of a page in words."""
    return f"{made.size / 1e6:.2g} MB, {made.frames:,} frames of {made.samples:,} samples"


def by_name(recordings: list[Recording]) -> dict[str, Recording]:
    """Recordings by controller; where that does not tell them apart, with the robot or the file."""
    for keys in (("controller",), ("controller", "robot"), ()):
        names = [", ".join(str(r.meta.get(key, r.path)) for key in keys) or str(r.path) for r in recordings]
        if len(set(names)) == len(names):
            break
    return dict(zip(names, recordings, strict=True))


@click.command(
    short_help="Write one HTML page that tells what was run and how good it was.",
    epilog=examples(
        "mmnn report runs/chapter4 --html chapter4.html",
        "mmnn report runs/chapter4/pd.h5 runs/chapter4/two_layer.h5 --html two.html",
        "mmnn report runs/track --html track.html --no-replay        without the robot's meshes",
        "mmnn report runs/robustness --html robustness.html          a study",
        "mmnn report runs/contest --html contest.html                a contest, all tasks",
        "mmnn report runs/contest/eight --html eight.html            the runs of one of its tasks, first seed",
    ),
)
@RUNS
@click.option("--html", required=True, type=click.Path(path_type=Path), help="The page.")
@click.option("--force", is_flag=True, help="Replace it.")
@click.option("--no-replay", is_flag=True, help="Leave the replay out.")
@PACKAGE_DIRS
@law
@shared
def report(
    runs: tuple[Path, ...], html: Path, force: bool, no_replay: bool, package_dirs: tuple[str, ...], as_json: bool
) -> int:
    """Write a report on runs of one task: verdict, numbers, plots, replay, robot, origin, in one HTML file.

    RUN is a recording, or a folder with recordings; or one study: its folder or its database; or the folder of one
    contest: its page has the tables of all tasks, the targets and the figures. The page needs no network and no server.
    """
    from ..lab.show.files import require_free
    from ..lab.show.report import report as make

    require_free(html, force)
    command = shlex.join(["mmnn", "report", *map(str, runs), "--html", str(html)])
    warnings: tuple[str, ...] = ()
    if (study := study_of(runs)) is not None:
        from ..lab.show.study import page as study_page
        from ..lab.study.results import load_results

        about: dict[str, Any] = {"study": str(study)}
        made: HtmlPage = study_page(load_results(study), command)
    elif (contest := contest_of(runs)) is not None:
        from ..lab.contest.contest import opened
        from ..lab.show.contest import page as contest_page

        about, made = {"contest": str(contest)}, contest_page(opened(contest), command)
    else:
        recordings = by_name([recording for path in runs for recording in open_runs(path)])
        about = {"runs": [str(recording.path) for recording in recordings.values()]}
        made = page = make(recordings, command=command, with_replay=not no_replay, package_dirs=package_dirs)
        warnings = page.warnings
    for warning in warnings:
        warn(warning)
    made.save(html)
    if as_json:
        say_json(about | {"html": str(html), "bytes": made.size, "warnings": list(warnings)})
    else:
        say(f"wrote {html}: {made.size / 1e6:.2g} MB")
    return DONE


@click.command(
    short_help="Write recordings in the formats of other programs.",
    epilog=examples(
        "mmnn export runs/chapter4/two_layer.h5 --to csv",
        "mmnn export runs/chapter4/two_layer.h5 --to mcap --out two_layer.mcap     for Foxglove, PlotJuggler",
        "mmnn export runs/chapter4 --to parquet --out tables                       every recording of a folder",
        "mmnn export runs/robustness --to csv                                      the rows of a study",
    ),
)
@RUNS
@click.option("--to", type=click.Choice(TO), required=True, help="The format.")
@click.option("--out", type=click.Path(path_type=Path), help="A file, or a folder.  [default: beside the recording]")
@click.option("--force", is_flag=True, help="Replace existing files.")
@shared
def export(runs: tuple[Path, ...], to: str, out: Path | None, force: bool, as_json: bool) -> int:
    """Write recordings as tables (csv, npz, parquet) or as MCAP. RUN is a recording, or a folder with recordings.

    RUN may also be one study, its folder or its database: its rows are written as csv or parquet.
    MCAP holds joint states, transforms, odometry and all signals as messages of ROS 2. Parquet and MCAP need
    `pip install 'mmnn_pin[export]'`.
    """
    from ..lab.show.export import export as write
    from ..lab.show.export import export_study
    from ..lab.show.files import require_free

    files: dict[Path, Path]
    if (study := study_of(runs)) is not None:
        from ..lab.study.results import load_results

        results = load_results(study)
        is_file = out is not None and out.suffix and not out.is_dir()
        file = out if is_file and out is not None else (out or study.parent) / f"{results.name}.{to}"
        files = {study: export_study(results, file, to, force=force)}
    else:
        recordings = {run: recording for path in runs for recording in open_runs(path) if (run := recording.path)}
        files = dict(zip(recordings, targets(list(recordings), out, to), strict=True))
        for file in files.values():
            require_free(file, force)
        for run, recording in recordings.items():
            write(recording, files[run], to, force=True)
    if as_json:
        say_json({"to": to, "files": {str(run): str(file) for run, file in files.items()}})
    else:
        say("\n".join(f"wrote {file}" for file in files.values()))
    return DONE


def targets(runs: list[Path], out: Path | None, to: str) -> list[Path]:
    """File for every recording: the one named, or one per recording in the folder named, or beside each.

    Raises:
        ConfigError: One file for several recordings.
    """
    if out is not None and (out.suffix and not out.is_dir()):
        if len(runs) > 1:
            raise ConfigError(f"one file for {len(runs)} recordings", fix="name a folder", file=out, key="--out")
        return [out]
    files = [(run.parent if out is None else out) / f"{run.stem}.{to}" for run in runs]
    for i, file in enumerate(files):
        if file in files[:i]:
            why = f"{runs[files.index(file)]} and {runs[i]} have the same name"
            raise ConfigError("two recordings for one file", why=why, fix="export them apart", file=file)
    return files
