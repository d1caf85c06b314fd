"""`mmnn contest`, or `python -m research.contest`: all controllers on all tasks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from mmnn_pin.cli.options import CHANGES, controllers, examples, shared
from mmnn_pin.cli.output import (
    DONE,
    FAILED,
    STOPPED,
    answer,
    compile_if_cold,
    interruptible,
    look,
    named,
    progress_bar,
    styled,
    warn,
    wrote,
)
from mmnn_pin.cli.run import in_toml
from mmnn_pin.errors import InputError

if TYPE_CHECKING:
    from .settings import ContestExperiment
    from .standing import Standing


@click.command(
    short_help="Run all controllers on several tasks, and judge what they learned.",
    epilog=examples(
        "mmnn contest                                   all controllers on all tasks; takes minutes",
        "mmnn contest --case eight --controller adaptive --set contest.seeds=2",
        "mmnn contest --case eight --controller my_law.py:MyLaw     a law of your own beside the others",
        "mmnn contest my_contest.toml --json > result.json",
    ),
)
@click.argument("experiment", default="contest", metavar="[CONTEST.toml]")
@click.option(
    "--controller",
    "controllers",
    metavar="NAME",
    multiple=True,
    shell_complete=controllers,
    help="Only this controller, see `mmnn list`, or FILE.py:Class for one of your own; repeatable.",
)
@click.option("--case", "cases", metavar="NAME", multiple=True, help="Only this task; repeatable.")
@CHANGES
@click.option("--seed", type=int, help="The first seed; short for --set seed=N.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the files.  [default: runs/CONTEST]")
@click.option("--force", is_flag=True, help="Run anew what is already in that folder.")
@shared
def contest(
    experiment: str,
    controllers: tuple[str, ...],
    cases: tuple[str, ...],
    settings: tuple[str, ...],
    seed: int | None,
    out: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Run a contest: all controllers on several tasks, each with several seeds.

    Then they run on trajectories that none of them was trained on, once with the weights held fixed and once with
    learning on. It prints a table per task and whether the targets are met, draws figures, and goes on where it was
    stopped; `mmnn docs explanation/contest` explains its numbers. The controllers that others are compared with run
    even if --controller leaves them out. CONTEST.toml is an experiment with a table [contest]; its cases are the tasks.
    """
    from mmnn_pin.lab.experiments.cases import chosen_cases

    from .settings import load_contest

    changes = [*settings, *in_toml(controllers=list(dict.fromkeys(controllers)) or None, seed=seed)]
    asked, name = chosen_cases(load_contest(experiment, changes), cases), Path(experiment).stem
    compile_if_cold(True)
    try:
        return run(asked, name, out or Path("runs") / name, force, as_json)
    except InputError as error:
        from mmnn_pin.lab.experiments.refusals import located

        from .settings import FILE

        raise located(error, str(FILE) if experiment == "contest" else experiment, changes) from None


def run(asked: ContestExperiment, name: str, folder: Path, force: bool, as_json: bool) -> int:
    """Run a contest, draw and print what came of it; the exit code."""
    from .contest import run_contest
    from .show import write_figures

    with progress_bar() as show, interruptible(show) as progress:
        standing = run_contest(asked, name, out=folder, force=force, progress=progress, warn=warn)
    pictures = write_figures(standing, folder)
    answer(
        as_json,
        lambda: standing.to_dict() | {"plots": named(pictures)},
        lambda: contest_text(standing, folder, list(pictures.values())),
    )
    return STOPPED if standing.interrupted else DONE if standing.completed else FAILED


def contest_text(standing: Standing, folder: Path, pictures: list[Path]) -> str:
    """A contest as text: its tables, what failed, what to know, where the files are."""
    from .show import findings, render

    lines = [styled(render(standing, **look())), ""]
    lines += [f"failed: {controller} on {task}: {error}" for (task, controller), error in standing.failed.items()]
    lines += [f"note: {note}" for note in findings(standing)]
    lines += [wrote([folder / "rows.json", folder / "rows.csv", *pictures])] if standing.trials else []
    lines.append(
        f"wrote {folder}/TASK/CONTROLLER.h5, the first seed's; look at one with mmnn plot, prove, report or replay;"
        f" mmnn report {folder} --html contest.html makes one page of all"
    )
    if standing.interrupted:
        done, rest = len(standing.trials), len(standing.missing)
        lines.append(f"stopped: {done} of {done + rest} are done and kept; the same command goes on with the rest")
    return "\n".join(lines)
