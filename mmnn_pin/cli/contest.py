"""What `mmnn run` does with a contest."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from .output import DONE, FAILED, STOPPED, say, say_json, warn

if TYPE_CHECKING:
    from ..lab.contest.standing import Standing
    from ..lab.experiments.experiment import Experiment


def contest(
    experiment: Experiment, name: str, folder: Path, force: bool, progress: Callable[[str, float], None]
) -> Standing:
    """Run it; arguments as in `run_contest`."""
    from ..lab.contest.contest import run_contest

    return run_contest(experiment, name, out=folder, force=force, progress=progress, warn=warn)


def tell_contest(standing: Standing, folder: Path, as_json: bool) -> int:
    """Draw and print what came of it; the exit code."""
    from ..lab.show.contest.figures import write_figures
    from ..lab.show.contest.text import findings, render

    drawn = write_figures(standing, folder)
    if as_json:
        say_json(standing.to_dict() | {"plots": {plot: str(file) for plot, file in drawn.items()}})
    else:
        say(render(standing, colour=sys.stdout.isatty()) + "\n")
        for (task, controller), error in standing.failed.items():
            say(f"failed: {controller} on {task}: {error}")
        for note in findings(standing):
            say(f"note: {note}")
        for file in (folder / "rows.json", folder / "rows.csv", *drawn.values()) if standing.trials else ():
            say(f"wrote {file}")
        say(
            f"wrote {folder}/TASK/CONTROLLER.h5, the first seed's; look at one with mmnn plot, prove, report or replay;"
            f" mmnn report {folder} --html contest.html makes one page of all"
        )
        if standing.interrupted:
            done, rest = len(standing.trials), len(standing.missing)
            say(f"stopped: {done} of {done + rest} are done and kept; the same command goes on with the rest")
    return STOPPED if standing.interrupted else DONE if standing.completed else FAILED
