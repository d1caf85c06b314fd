"""`mmnn report`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from .folders import contest_of, open_runs, study_of
from .options import examples, law, shared
from .output import DONE, say, say_json, warn
from .replay import by_name

if TYPE_CHECKING:
    from ..lab.show.html_page import HtmlPage


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
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(path_type=Path))
@click.option("--html", required=True, type=click.Path(path_type=Path), help="The page.")
@click.option("--force", is_flag=True, help="Replace it.")
@click.option("--no-replay", is_flag=True, help="Leave the replay out.")
@click.option(
    "--package-dir", "package_dirs", metavar="DIR", multiple=True, help="Where package:// meshes are; repeatable."
)
@law
@shared
def report(
    runs: tuple[Path, ...], html: Path, force: bool, no_replay: bool, package_dirs: tuple[str, ...], as_json: bool
) -> int:
    """Write a report on runs of one task: verdict, numbers, plots, replay, robot, origin, in one HTML file.

    RUN is a recording, or a folder with recordings; or one study: its folder or its database; or the folder of one
    contest: its page has the tables of all tasks, the targets and the figures. The page needs no network and no server.
    """
    from ..lab.show.report import report as make
    from ..lab.show.whole import require_free

    require_free(html, force)
    if (study := study_of(runs)) is not None:
        return report_study(study, html, as_json)
    if (contest := contest_of(runs)) is not None:
        return report_contest(contest, html, as_json)
    recordings = by_name([recording for path in runs for recording in open_runs(path)])
    command = shlex.join(["mmnn", "report", *map(str, runs), "--html", str(html)])
    made = make(recordings, command=command, with_replay=not no_replay, package_dirs=package_dirs)
    for warning in made.warnings:
        warn(warning)
    made.save(html)
    if as_json:
        files = [str(recording.path) for recording in recordings.values()]
        say_json({"runs": files, "html": str(html), "bytes": made.size, "warnings": list(made.warnings)})
    else:
        say(f"wrote {html}: {made.size / 1e6:.2g} MB")
    return DONE


def report_study(path: Path, html: Path, as_json: bool) -> int:
    """Write the page of a study."""
    from ..lab.show.study.page import page
    from ..lab.study.results import load_results

    made = page(load_results(path), shlex.join(["mmnn", "report", str(path), "--html", str(html)]))
    return write(made, html, "study", path, as_json)


def report_contest(path: Path, html: Path, as_json: bool) -> int:
    """Write the page of a contest."""
    from ..lab.contest.contest import opened
    from ..lab.show.contest.page import page

    made = page(opened(path), shlex.join(["mmnn", "report", str(path), "--html", str(html)]))
    return write(made, html, "contest", path, as_json)


def write(made: HtmlPage, html: Path, what: str, path: Path, as_json: bool) -> int:
    """Write a page and say so."""
    made.save(html)
    if as_json:
        say_json({what: str(path), "html": str(html), "bytes": made.size, "warnings": []})
    else:
        say(f"wrote {html}: {made.size / 1e6:.2g} MB")
    return DONE
