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
from typing import TYPE_CHECKING

import click

from ..errors import RecordingError
from .options import examples, shared
from .output import DONE, FAILED, STOPPED, progress_bar, say, say_if_cold, say_json

if TYPE_CHECKING:
    from ..experiments.runner import Result


@click.command(
    short_help="Run an experiment and compare its controllers.",
    epilog=examples(
        "mmnn run chapter4",
        "mmnn run chapter4 --controller pd --controller two_layer --out runs/short --set time.duration=2",
        "mmnn run chapter4 --robot my_robot.urdf --set feedback.base=300 --set 'two_layer.F=[0.5, 0.1]'",
        "mmnn run chapter4 --set 'reference.base={type = \"circle\", radius = 1.0, speed = 0.3}'",
        "mmnn run my_experiment.toml --json > result.json",
    ),
)
@click.argument("experiment")
@click.option("--robot", metavar="ROBOT", help="Another robot: a bundled name or the path of a URDF file.")
@click.option("--controller", "controllers", metavar="NAME", multiple=True, help="Only this controller; repeatable.")
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True, help="Change a key of the TOML; repeatable.")
@click.option("--seed", type=int, help="The seed, short for --set seed=N.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the recordings.  [default: runs/EXPERIMENT]")
@click.option("--force", is_flag=True, help="Replace what is already in that folder.")
@shared
def run(
    experiment: str,
    robot: str | None,
    controllers: tuple[str, ...],
    settings: tuple[str, ...],
    seed: int | None,
    out: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Run EXPERIMENT with all its controllers from equal starts and compare them.

    EXPERIMENT is a bundled name (see `mmnn list`) or the path of a TOML file. Writes one HDF5 recording per controller
    and a plot of the errors. Ctrl-C ends the run and keeps what is recorded (exit code 130).
    """
    from ..experiments.config import load_experiment
    from ..experiments.runner import run_experiment

    overrides = [*settings, *in_toml(robot=robot, controllers=list(dict.fromkeys(controllers)) or None, seed=seed)]
    chosen, name = load_experiment(experiment, overrides), Path(experiment).stem
    folder = out or Path("runs") / name
    picture = folder / "errors.png"
    if picture.exists() and not force:
        fix = "choose another folder with --out, or replace it with --force"
        raise RecordingError("the plot exists", fix=fix, file=picture)
    say_if_cold()
    with progress_bar() as show, remembered_interrupt() as stop_if_pressed:

        def progress(controller: str, fraction: float) -> None:
            stop_if_pressed()
            show(controller, fraction)

        result = run_experiment(chosen, name, out=folder, force=force, progress=progress)
    drawn = draw_errors(result, picture)
    if as_json:
        say_json(result.to_dict() | {"plot": str(picture) if drawn else None})
    else:
        tell(result, [picture] if drawn else [])
    return exit_code(result)


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
    return [f"{key}={json.dumps(value)}" for key, value in values.items() if value is not None]


def draw_errors(result: Result, file: Path) -> bool:
    """Write the plot of the errors, if there is anything to plot."""
    from ..show import plots

    runs = {name: recording for name, recording in result.recordings.items() if len(recording)}
    if runs:
        plots.save(plots.errors_figure(runs), file)
    return bool(runs)


def tell(result: Result, pictures: list[Path]) -> None:
    """Print the table, the notes and where the files are."""
    from ..show import table

    say(table.render(result, colour=sys.stdout.isatty()) + "\n")
    for note in table.notes(result):
        say(f"note: {note}")
    files = [recording.path for recording in result.recordings.values() if recording.path]
    for file in [*files, *pictures]:
        say(f"wrote {file}")


def exit_code(result: Result) -> int:
    """130 if stopped, 1 if a run did not reach its end, else 0."""
    if any(recording.outcome.status == "interrupted" for recording in result.recordings.values()):
        return STOPPED
    return DONE if result.completed else FAILED
