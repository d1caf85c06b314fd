"""`mmnn replay`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import RecordingError
from .folders import open_runs
from .options import examples, shared
from .output import DONE, say, say_json, warn

if TYPE_CHECKING:
    from ..lab.show.replay import Page
    from ..recording.recording import Recording


@click.command(
    short_help="Play recordings in the browser.",
    epilog=examples(
        "mmnn replay runs/chapter4/two_layer.h5",
        "mmnn replay runs/chapter4/two_layer.h5 runs/chapter4/pd.h5       both in one scene",
        "mmnn replay runs/track/pd.h5 --html pd.html                      one file that opens anywhere",
        "mmnn replay my_run.h5 --package-dir ~/ros/src                    meshes of package:// are there",
    ),
)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(path_type=Path))
@click.option("--html", type=click.Path(path_type=Path), help="Write the page to this file and open nothing.")
@click.option("--force", is_flag=True, help="Replace that file.")
@click.option("--fps", type=click.FloatRange(0.1, 1000), default=60, show_default=True, help="Frames kept per second.")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=7007, show_default=True, help="Or the next that is free."
)
@click.option("--no-browser", is_flag=True, help="Only tell the address.")
@click.option(
    "--package-dir", "package_dirs", metavar="DIR", multiple=True, help="Where package:// meshes are; repeatable."
)
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
    """Serve a page until Ctrl-C or until the parent process is gone; `facts` are told as JSON."""
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
