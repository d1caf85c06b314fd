"""`mmnn run`."""

from __future__ import annotations

import json
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from .options import examples, shared, understanding
from .output import DONE, FAILED, STOPPED, compile_if_cold, progress_bar, require_no_pictures, say, say_json, warn

if TYPE_CHECKING:
    from ..lab.contest.standing import Standing
    from ..lab.experiments.experiment import Experiment
    from ..lab.experiments.runner import Result


@click.command(
    short_help="Run an experiment and compare its controllers.",
    epilog=examples(
        "mmnn run chapter4",
        "mmnn run chapter4 --variant figures",
        "mmnn run chapter4 --controller pd --controller two_layer --out runs/short --set time.duration=2",
        "mmnn run chapter4 --robot my_robot.urdf --set feedback.base=300 --set 'two_layer.F=[0.5, 0.1]'",
        "mmnn run chapter4 --set 'reference.base={type = \"circle\", radius = 1.0, speed = 0.3}'",
        "mmnn run track --robot my_robot.urdf --wheels left_joint,right_joint --lock head_joint=0.2",
        "mmnn run track --plant contact              wheels that may slip, in MuJoCo",
        "mmnn run faults                            what sensors, motors and the world can do to a run",
        "mmnn run contest                           who tracks, who learns, who knows; minutes",
        "mmnn run contest --case eight --controller adaptive --set contest.seeds=2",
        "mmnn run contest --case eight --controller my_law.py:MyLaw     a law of your own beside the others",
        "mmnn run my_experiment.toml --json > result.json",
    ),
)
@click.argument("experiment")
@click.option("--variant", metavar="NAME", help="A variant of the experiment, see `mmnn list`.  [default: its first]")
@click.option("--robot", metavar="ROBOT", help="Another robot: a name (see `mmnn list`) or a URDF file.")
@click.option(
    "--controller",
    "controllers",
    metavar="NAME",
    multiple=True,
    help="Only this controller, see `mmnn list`, or FILE.py:Class for one of your own; repeatable.",
)
@click.option(
    "--case",
    "cases",
    metavar="NAME",
    multiple=True,
    help="Only this case, or this task of a contest, see `mmnn list`; repeatable.",
)
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True, help="Change a key of the TOML; repeatable.")
@click.option("--plant", metavar="NAME", help="ideal, or contact: wheels that may slip, in MuJoCo.")
@click.option("--seed", type=int, help="The seed, short for --set seed=N.")
@click.option(
    "--out", type=click.Path(path_type=Path), help="Folder for the files.  [default: runs/EXPERIMENT[-VARIANT]]"
)
@click.option("--force", is_flag=True, help="Replace what is already in that folder.")
@understanding
@shared
def run(
    experiment: str,
    variant: str | None,
    robot: str | None,
    controllers: tuple[str, ...],
    cases: tuple[str, ...],
    settings: tuple[str, ...],
    plant: str | None,
    seed: int | None,
    out: Path | None,
    force: bool,
    said: dict[str, Any],
    as_json: bool,
) -> int:
    """Run EXPERIMENT with all its controllers from equal starts and compare them.

    EXPERIMENT is a bundled name (see `mmnn list`) or the path of a TOML file. Writes one HDF5 recording per controller
    and the pictures that the experiment asks for. Ctrl-C ends the run and keeps what is recorded (exit code 130).

    An experiment with cases runs all controllers in each of them and gives every run a verdict (exit code 1 if one
    fails).

    A contest (a file with a table [contest], such as the bundled one) runs all controllers on several tasks, each with
    several seeds, and then on trajectories that none of them was trained on, with what was learned held fixed and
    learning on. It prints a table per task and the targets, draws figures, and goes on where it was stopped; what its
    numbers mean is in docs/contest.md. --controller leaves those in by which the others are measured.
    """
    from ..lab.experiments.cases import chosen_cases
    from ..lab.experiments.config import load_experiment
    from ..lab.experiments.runner import has_hardware
    from ..lab.show.gallery import require_plots

    chosen = {"robot": robot, "controllers": list(dict.fromkeys(controllers)) or None, "seed": seed, "plant": plant}
    overrides = [*about_robot(robot, said), *settings, *in_toml(**chosen)]
    asked, name = chosen_cases(load_experiment(experiment, overrides, variant), cases), Path(experiment).stem
    folder = out or Path("runs") / (f"{name}-{variant}" if variant else name)
    require_plots(asked.plots)
    drawn = [folder / f"{plot}.png" for plot in asked.plots]
    require_no_pictures(drawn, "plot", "choose another folder with --out", force)
    compile_if_cold(bool(asked.cases) or has_hardware(asked))
    return (run_contest if asked.contest is not None else run_cases if asked.cases else run_one)(
        asked, name, folder, force, as_json
    )


def run_one(asked: Experiment, name: str, folder: Path, force: bool, as_json: bool) -> int:
    """Run an experiment, draw and print what came of it; 130 if stopped, 1 if a run did not reach its end, else 0."""
    from ..lab.experiments.runner import run_experiment
    from ..lab.show.comparison import notes, render

    with shown_progress() as progress:
        result = run_experiment(asked, name, out=folder, force=force, progress=progress)
    pictures = draw(result, folder)
    if as_json:
        say_json(result.to_dict() | {"plots": {plot: str(file) for plot, file in pictures.items()}})
    else:
        say(render(result, colour=sys.stdout.isatty()) + "\n")
        for note in notes(result):
            say(f"note: {note}")
        files = [recording.path for recording in result.recordings.values() if recording.path]
        for file in [*files, *pictures.values()]:
            say(f"wrote {file}")
    if any(recording.outcome.status == "interrupted" for recording in result.recordings.values()):
        return STOPPED
    return DONE if result.completed else FAILED


def draw(result: Result, folder: Path) -> dict[str, Path]:
    """Write the pictures of an experiment, as far as its runs have something for them; name to file."""
    from ..lab.show.gallery import write_pictures

    return write_pictures(result.recordings, result.experiment.plots, folder)


def run_cases(asked: Experiment, name: str, folder: Path, force: bool, as_json: bool) -> int:
    """Run all controllers in all cases and print the verdicts; the exit code."""
    from ..lab.experiments.cases import run_cases as run_all
    from ..lab.show.comparison import render_cases

    with shown_progress() as progress:
        matrix = run_all(asked, name, out=folder, force=force, progress=progress)
    if as_json:
        say_json(matrix.to_dict())
    else:
        look = f"mmnn plot {folder}/{next(iter(matrix.verdicts))}/*.h5"
        say(render_cases(matrix, colour=sys.stdout.isatty()) + "\n")
        say(f"wrote {folder}/CASE/CONTROLLER.h5; look at one with: {look}")
    return STOPPED if matrix.interrupted else DONE if matrix.completed else FAILED


def run_contest(asked: Experiment, name: str, folder: Path, force: bool, as_json: bool) -> int:
    """Run a contest, draw and print what came of it; the exit code."""
    from ..lab.contest.contest import run_contest as run_all
    from ..lab.show.contest_figures import write_figures

    with shown_progress() as progress:
        standing = run_all(asked, name, out=folder, force=force, progress=progress, warn=warn)
    pictures = write_figures(standing, folder)
    if as_json:
        say_json(standing.to_dict() | {"plots": {plot: str(file) for plot, file in pictures.items()}})
    else:
        say_contest(standing, folder, list(pictures.values()))
    return STOPPED if standing.interrupted else DONE if standing.completed else FAILED


def say_contest(standing: Standing, folder: Path, pictures: list[Path]) -> None:
    """Print a contest: its tables, what failed, what to know, where the files are."""
    from ..lab.show.contest import findings, render

    say(render(standing, colour=sys.stdout.isatty()) + "\n")
    for (task, controller), error in standing.failed.items():
        say(f"failed: {controller} on {task}: {error}")
    for note in findings(standing):
        say(f"note: {note}")
    for file in (folder / "rows.json", folder / "rows.csv", *pictures) if standing.trials else ():
        say(f"wrote {file}")
    say(
        f"wrote {folder}/TASK/CONTROLLER.h5, the first seed's; look at one with mmnn plot, prove, report or replay;"
        f" mmnn report {folder} --html contest.html makes one page of all"
    )
    if standing.interrupted:
        done, rest = len(standing.trials), len(standing.missing)
        say(f"stopped: {done} of {done + rest} are done and kept; the same command goes on with the rest")


@contextmanager
def shown_progress() -> Iterator[Callable[[str, float], None]]:
    """Show how far each run is; yields what a run calls with its controller and the share that is done."""
    with progress_bar() as show, remembered_interrupt() as stop_if_pressed:

        def progress(controller: str, fraction: float) -> None:
            stop_if_pressed()
            show(controller, fraction)

        yield progress


@contextmanager
def remembered_interrupt() -> Iterator[Callable[[], None]]:
    """Ctrl-C as ever, and remembered: Python swallows a KeyboardInterrupt that happens to hit a destructor.

    Yields a function that raises it again if it was pressed.
    """
    pressed = threading.Event()

    def press(number: int, frame: FrameType | None) -> None:
        pressed.set()
        signal.default_int_handler(number, frame)

    def stop_if_pressed() -> None:
        if pressed.is_set():
            raise KeyboardInterrupt

    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # else someone's own, or ignored
    if not usual or threading.current_thread() is not threading.main_thread():
        yield stop_if_pressed
        return
    signal.signal(signal.SIGINT, press)
    try:
        yield stop_if_pressed
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def in_toml(**values: object) -> list[str]:
    """Overrides `key=value` of those that are given; JSON's texts, lists and integers are TOML's."""
    return [f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in values.items() if value is not None]


def about_robot(robot: str | None, said: dict[str, Any]) -> list[str]:
    """Overrides for what the options say about the robot; of another robot nothing is left of what the TOML says."""
    anew = ["overrides={}"] if robot is not None else []
    return [*anew, *in_toml(**{f"overrides.{key}": value for key, value in said.items()})]
