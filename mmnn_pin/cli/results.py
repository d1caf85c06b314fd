"""`mmnn plot`, `judge`, `replay`, `report` and `export`: what is made of recordings, or of a study."""

from __future__ import annotations

import os
import shlex
from contextlib import nullcontext
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ConfigError
from ..files import require_free
from .options import FORCE, NO_BROWSER, PACKAGE_DIRS, PATH, PORT, RangedNumber, examples, judged_on, law, shared
from .output import (
    DONE,
    answer,
    compile_if_cold,
    folders_of,
    found_in,
    judging,
    look,
    named,
    one_run,
    open_page,
    open_runs,
    progress_bar,
    styled,
    targets,
    warn,
    wrote,
)

if TYPE_CHECKING:
    from ..lab.show.files import HtmlPage
    from ..recording.recording import Recording

RUNS = click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=PATH)
ONE_RUN = click.argument("run", metavar="RUN", type=PATH)
LARGE = 50_000_000  # bytes of an exported file from which it is told how to have less
TO = ("csv", "npz", "parquet", "mcap", "lerobot")


def whats(of: str = "runs") -> tuple[str, ...]:
    """Names of all figures of runs, or of a kind of folder."""
    from ..lab.show.gallery import FIGURES, PICTURES

    return tuple(PICTURES if of == "runs" else FIGURES[of])


def plotted() -> list[str]:
    """Kinds of folders that have figures."""
    from ..lab.show.gallery import FIGURES

    return [kind for kind in FIGURES if kind not in ("runs", "judged")]


class FigureName(click.Choice[str]):
    """A figure by its name in the register, which is imported when a name is looked up and not before."""

    case_sensitive = True

    def __init__(self) -> None:
        """Leave the names to the register."""

    @cached_property
    def choices(self) -> tuple[str, ...]:  # type: ignore[override]
        """The names."""
        return (*whats(), *(name for kind in plotted() for name in whats(kind)))


@click.command(
    short_help="Plot recordings side by side.",
    epilog=examples(
        "mmnn plot runs/chapter4/pd.h5 runs/chapter4/two_layer.h5",
        "mmnn plot runs/chapter4 --what psi --what torque --out plots",
        "mmnn plot runs/chapter4 --what figure-4.2 --what gains --out plots",
        "mmnn plot runs/chapter4/two_layer.h5 --what path --out path.svg",
        "mmnn plot runs/robustness --what study-errors      errors against the factors of a study",
    ),
)
@RUNS
@click.option(
    "--what",
    "whats",
    type=FigureName(),
    multiple=True,
    help="What to draw; study-... is for the folder of a study. Repeatable.  [default: errors; of a folder all]",
)
@click.option("--out", type=PATH, help="A .png, .svg or .pdf file, or a folder.  [default: .]")
@FORCE
@law
@shared
def plot(runs: tuple[Path, ...], whats: tuple[str, ...], out: Path | None, force: bool, as_json: bool) -> int:
    """Plot recordings side by side. RUN is a recording, a folder of them, or the folder of one study."""
    from ..lab.show.curves import require_comparable
    from ..lab.show.figure import FIGURES, save
    from ..lab.show.folders import FOLDERS
    from ..lab.show.gallery import PICTURES

    kind, folder = next(((kind, path) for kind in plotted() if (path := found_in(runs, kind))), ("runs", None))
    require_whats(whats, kind, folder)
    if folder is None:
        every = open_runs(runs)
        require_comparable(every)
        recordings = by_name(every)
        about: dict[str, Any] = {"runs": [str(recording.path) for recording in recordings.values()]}
        make, wanted = (lambda what: PICTURES[what].make(recordings)), whats or ("errors",)
    else:
        content, about = FOLDERS[kind].opened(folder), {kind: str(folder)}
        entries = FIGURES[kind]
        make = lambda what: entries[what].make(content)  # noqa: E731
        wanted = whats or tuple(name for name, entry in entries.items() if not entry.lacks(content))
    files = pictures(out or Path("."), tuple(dict.fromkeys(wanted)))
    for file in files.values():
        require_free(file, force, "picture")
    judged = kind == "runs" and any(what in FIGURES["judged"] for what in files)
    with judging(recordings) if judged else nullcontext():
        figures = {what: make(what) for what in files}
    for what, figure in figures.items():
        save(figure, files[what], force)
    answer(as_json, lambda: about | {"files": named(files)}, lambda: wrote(files.values()))
    return DONE


def require_whats(chosen: tuple[str, ...], kind: str, folder: Path | None) -> None:
    """Refuse plots of runs for a folder of another kind, and the other way round (`ConfigError`)."""
    for what in chosen:
        if what in whats(kind):
            continue
        if folder is None:
            other = next(each for each in plotted() if what in whats(each))
            raise ConfigError(f"'{what}' is a figure of a {other}", fix=f"name a {other}'s folder", key="--what")
        if folder.is_dir() and what in whats() and (folders := ", ".join(map(str, folders_of(folder)))):
            fix = f"name one of its folders: {folders}"
            raise ConfigError(f"'{what}' is a plot of the runs of one folder", fix=fix, file=folder, key="--what")
        fix = f"there is: {', '.join(whats(kind))}"
        raise ConfigError(f"'{what}' is no figure of a {kind}", fix=fix, file=folder, key="--what")


def by_name(recordings: list[Recording]) -> dict[str, Recording]:
    """Recordings by controller; where that does not tell them apart, with the robot or the file."""
    for keys in (("controller",), ("controller", "robot"), ()):
        names = [", ".join(str(r.meta.get(key, r.path)) for key in keys) or str(r.path) for r in recordings]
        if len(set(names)) == len(names):
            break
    return dict(zip(names, recordings, strict=True))


def pictures(out: Path, whats: tuple[str, ...]) -> dict[str, Path]:
    """File of every plot: the one named, or one per plot in the folder named.

    Raises:
        ConfigError: One file for several plots, or a format that is not offered.
    """
    from ..lab.show.figure import FORMATS

    if not out.suffix or out.is_dir():
        return {what: out / f"{what}.png" for what in whats}
    if out.suffix[1:].lower() not in FORMATS:
        fix = f"end its name in {', '.join(f'.{name}' for name in FORMATS)}, or name a folder"
        raise ConfigError(f"unknown format '{out.suffix}'", fix=fix, file=out, key="--out")
    if len(whats) > 1:
        raise ConfigError(f"one file for {len(whats)} plots", fix="name a folder", file=out, key="--out")
    return {whats[0]: out}


@click.command(
    short_help="Tell whether a run learned Psi, or only followed it.",
    epilog=examples(
        "mmnn judge runs/chapter4/two_layer.h5",
        "mmnn judge runs/track/two_layer.h5 --payload 3 --plots judged",
        "mmnn judge runs/track/MyLaw.h5 --law my_law.py     a law of your own",
    ),
)
@ONE_RUN
@judged_on
@click.option("--plots", type=PATH, metavar="DIR", help="Write the figures to this folder.")
@FORCE
@law
@shared
def judge(run: Path, payload: float | None, windows: int, plots: Path | None, force: bool, as_json: bool) -> int:
    """Judge one recording: whether it learned Psi, or only followed it.

    It prints the fraction of Psi's variance that the estimate leaves unexplained (FVU), online and with the final
    weights held, on the run's own trajectory, on another one and with a payload (mmnn docs explanation/proof). It also
    prints how far the run excited the learner, and which directions of the weights it does not determine.
    """
    from ..lab.psi.judgement import judge as judgement
    from ..lab.show.psi import render
    from ..lab.show.psi_figures import write_judged

    recording = to_judge(run)
    with progress_bar() as show:
        found = judgement(recording, payload=payload, windows=windows, progress=show)
    files = {} if plots is None else write_judged(found, plots, force)
    written = {} if plots is None else {"files": named(files)}

    def text() -> str:
        return f"{styled(render(found, **look()))}\n{wrote(files.values())}".rstrip()

    answer(as_json, lambda: found.to_dict() | written, text)
    return DONE


def to_judge(run: Path) -> Recording:
    """A run that is to be judged, compiled what that needs."""
    from ..lab.psi.psi import how_to_know
    from ..lab.psi.subject import Subject

    recording = one_run(run)
    if recording.meta.get("law") and (how := how_to_know(Subject.of(recording))):
        warn(how)
    compile_if_cold()
    return recording


@click.command(
    short_help="Watch recordings in the browser.",
    epilog=examples(
        "mmnn replay runs/chapter4/two_layer.h5",
        "mmnn replay runs/chapter4/two_layer.h5 runs/chapter4/pd.h5       both in one scene",
        "mmnn replay runs/track/pd.h5 --html pd.html                      one file that opens anywhere",
        "mmnn replay runs/track/pd.h5 --live                              in meshcat, with sliders",
        "mmnn replay my_run.h5 --package-dir ~/ros/src                    meshes of package:// are there",
    ),
)
@RUNS
@click.option("--html", type=PATH, help="Write the page to this file and open nothing; missing folders are made.")
@FORCE
@click.option("--fps", type=RangedNumber(0.1, 1000), default=60, help="Frames kept per second.")
@click.option("--live", is_flag=True, help="Play one run in meshcat itself, with sliders for its joints.")
@PORT
@NO_BROWSER
@PACKAGE_DIRS
@shared
def replay(
    runs: tuple[Path, ...],
    html: Path | None,
    live: bool,
    force: bool,
    fps: float,
    port: int,
    no_browser: bool,
    package_dirs: tuple[str, ...],
    as_json: bool,
) -> int:
    """Watch recordings in the browser, several in one scene or side by side.

    RUN is a recording, or a folder with recordings. Without --html the page is served on this machine only, until
    Ctrl-C.
    """
    parent = os.getppid()  # before anything slow: a parent that dies meanwhile counts, too
    from ..lab.show.replay import page, wait_until_left
    from ..lab.show.report import best_of

    if html is not None:
        require_free(html, force)
    recordings = by_name(open_runs(runs))
    if live:
        from ..lab.show.view import played

        if html is not None:
            raise ConfigError("--live writes no page", fix="leave out --live or --html", key="--live")
        if len(recordings) > 1:
            fix = f"name one, such as {next(iter(recordings.values())).path}"
            raise ConfigError(f"--live plays one run, not {len(recordings)}", fix=fix, key="--live")
        [recording] = recordings.values()
        with played(recording, port, package_dirs) as shown:
            for warning in shown.warnings:
                warn(warning)
            told = {"runs": [str(recording.path)], "url": shown.url, "warnings": list(shown.warnings)}
            answer(as_json, lambda: told, lambda: f"replay at {shown.url}; Ctrl-C ends it")
            open_page(shown.url, no_browser)
            wait_until_left(parent)
        return DONE
    best = best_of(recordings) if len(recordings) > 1 else ""
    made = page(recordings, fps=fps, package_dirs=package_dirs, best=best)
    for warning in made.warnings:
        warn(warning)
    about = {"runs": [str(r.path) for r in recordings.values()], "bytes": made.size, "frames": made.frames}
    about |= {"samples": made.samples, "warnings": list(made.warnings)}
    summary = f"{made.size / 1e6:.2g} MB, {made.frames:,} frames of {made.samples:,} samples"
    if html is not None:
        made.save(html, force)
        answer(as_json, lambda: about | {"html": str(html)}, lambda: f"wrote {html}: {summary}")
        return DONE
    with made.served(port) as url:
        answer(as_json, lambda: about | {"url": url}, lambda: f"replay at {url} ({summary}); Ctrl-C ends it")
        open_page(url, no_browser)
        wait_until_left(parent)
    return DONE


@click.command(
    short_help="Write one HTML page that shows what was run and how good it was.",
    epilog=examples(
        "mmnn report runs/chapter4 --html chapter4.html",
        "mmnn report runs/chapter4/pd.h5 runs/chapter4/two_layer.h5 --html two.html",
        "mmnn report runs/track --html track.html --no-replay        without the robot's meshes",
        "mmnn report runs/robustness --html robustness.html          a study",
        "mmnn report identified --html identified.html               what mmnn identify wrote",
    ),
)
@RUNS
@click.option("--html", required=True, type=PATH, help="The page.")
@FORCE
@click.option("--no-replay", is_flag=True, help="Leave the replay out.")
@PACKAGE_DIRS
@law
@shared
def report(
    runs: tuple[Path, ...], html: Path, force: bool, no_replay: bool, package_dirs: tuple[str, ...], as_json: bool
) -> int:
    """Write a report on runs of one task: verdict, numbers, plots, replay, robot, origin, in one HTML file.

    RUN is a recording or a folder of them, one study, or what `mmnn identify` wrote.
    """
    from ..lab.show.folders import FOLDERS
    from ..lab.show.gallery import report as make

    require_free(html, force)
    command = shlex.join(["mmnn", "report", *map(str, runs), "--html", str(html)])
    kind, place = next(((kind, path) for kind in FOLDERS if (path := found_in(runs, kind))), ("runs", None))
    if place is not None:
        about: dict[str, Any] = {kind: str(place)}
        made: HtmlPage = FOLDERS[kind].page(FOLDERS[kind].opened(place), command)
    else:
        recordings = by_name(open_runs(runs))
        about = {"runs": [str(recording.path) for recording in recordings.values()]}
        with judging(recordings):
            made = make(recordings, command=command, with_replay=not no_replay, package_dirs=package_dirs)
    for warning in made.warnings:
        warn(warning)
    made.save(html, force)
    answer(
        as_json,
        lambda: about | {"html": str(html), "bytes": made.size, "warnings": list(made.warnings)},
        lambda: f"wrote {html}: {made.size / 1e6:.2g} MB",
    )
    return DONE


@click.command(
    short_help="Write recordings in the formats of other programs.",
    epilog=examples(
        "mmnn export runs/chapter4/two_layer.h5 --to csv",
        "mmnn export runs/track/pd.h5 --to csv --rate 100 --signals pose,q,torque        a small table",
        "mmnn export runs/chapter4/two_layer.h5 --to mcap --out two_layer.mcap     for Foxglove, PlotJuggler",
        "mmnn export runs/chapter4 --to parquet --out tables                       every recording of a folder",
        "mmnn export runs/track/pd.h5 --to lerobot --rate 50                       a LeRobot dataset, a folder",
        "mmnn export runs/robustness --to csv                                      the rows of a study",
    ),
)
@RUNS
@click.option("--to", type=click.Choice(TO), required=True, help="The format.")
@click.option("--out", type=PATH, help="A file, or a folder.  [default: beside the recording]")
@click.option("--signals", metavar="NAME,...", help="Signals of a table beside the time.  [default: all]")
@click.option(
    "--rate",
    type=float,
    metavar="HZ",
    help="At most so many rows per second, each a sample of the run.  [default: all]",
)
@FORCE
@shared
def export(
    runs: tuple[Path, ...],
    to: str,
    out: Path | None,
    signals: str | None,
    rate: float | None,
    force: bool,
    as_json: bool,
) -> int:
    """Write recordings as tables (csv, npz, parquet), as MCAP or as LeRobot datasets (v3.0, folders).

    RUN is a recording, or a folder with recordings.

    RUN may also be one study, its folder or its results.jsonl: its rows are written as csv or parquet.
    MCAP holds joint states, transforms, odometry and all signals as messages of ROS 2. Parquet, LeRobot and MCAP need
    `pip install 'mmnn_pin[export]'`.
    """
    from ..lab.show.export import RecordingPart, export_study
    from ..lab.show.export import export as write

    chosen = tuple(name.strip() for name in (signals or "").split(",") if name.strip())
    if (study := found_in(runs, "study")) is not None:
        from ..lab.study.results import load_results

        if chosen or rate is not None:
            fix = "leave out --signals and --rate"
            raise ConfigError("a part of a study's rows", why="a run is one row", fix=fix, key="--signals")
        results = load_results(study)
        files = dict(zip([study], targets([results.path.with_stem(results.name)], out, to), strict=True))
        export_study(results, files[study], to, force=force)
    else:
        recordings = {run: recording for recording in open_runs(runs) if (run := recording.path)}
        files = dict(zip(recordings, targets(list(recordings), out, to), strict=True))
        for file in files.values():
            require_free(file, force)
        for recording in recordings.values():
            RecordingPart.of(recording, chosen, rate)
        for run, recording in recordings.items():
            write(recording, files[run], to, force=force, signals=chosen, rate=rate)
    large = [file for file in files.values() if file.is_file() and file.stat().st_size > LARGE]
    sizes = ", ".join(f"{file.stat().st_size / 1e6:.0f} MB" for file in large)
    note = f"\nnote: {sizes}; --rate 100 and --signals q,torque make smaller tables" if large and to != "mcap" else ""
    answer(
        as_json,
        lambda: {"to": to, "files": {str(run): str(file) for run, file in files.items()}},
        lambda: wrote(files.values()) + note,
    )
    return DONE
