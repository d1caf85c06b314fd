"""`mmnn run`, and what there is to run: `mmnn list` and `mmnn readings`."""

from __future__ import annotations

import contextlib
import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import InputError, few
from ..files import read_toml
from .options import (
    CHANGES,
    HARDWARE,
    PATH,
    VARIANT,
    cases,
    controllers,
    examples,
    experiments,
    robots,
    shared,
    understanding,
)
from .output import (
    DONE,
    FAILED,
    STOPPED,
    answer,
    columns,
    compile_if_cold,
    interruptible,
    look,
    named,
    note,
    progress_bar,
    say,
    styled,
    wrote,
    wrote_into,
)

if TYPE_CHECKING:
    from ..lab.experiments.experiment import Experiment
    from ..model.robot import Robot

ROBOT = click.option(
    "--robot", metavar="ROBOT", shell_complete=robots, help="Another robot: a name (see `mmnn list`) or a URDF file."
)


@click.command(
    short_help="Run an experiment and compare its controllers.",
    epilog=examples(
        "mmnn run track --robot my_robot.urdf",
        "mmnn run track --robot so101 --hardware feetech-sts3215",
        "mmnn run track --robot my_robot.urdf --controller pd_gravity --controller two_layer",
        "mmnn run track --robot my_robot.urdf --wheels left_joint,right_joint --lock head_joint=0.2",
        "mmnn run track --robot my_robot.urdf --set feedback.base=300 --set reference.file=motion.csv",
        "mmnn run track --set 'reference.base={type = \"circle\", radius = 1.0, speed = 0.3}'",
        "mmnn run track --plant contact                     wheels that may slip, in MuJoCo",
        "mmnn run faults                                    noise, delays, weak motors, pushes, lost messages",
        "mmnn run chapter4 --variant figures                the thesis's simulation, one of its variants",
        "mmnn run my_experiment.toml --json > result.json",
    ),
)
@click.argument("experiment", shell_complete=experiments)
@VARIANT
@ROBOT
@HARDWARE
@click.option(
    "--controller",
    "controllers",
    metavar="NAME",
    multiple=True,
    shell_complete=controllers,
    help="Only this controller, see `mmnn list`, or FILE.py:Class for one of your own; repeatable.",
)
@click.option(
    "--case",
    "cases",
    shell_complete=cases,
    metavar="NAME",
    multiple=True,
    help="Only this case, see `mmnn list`; repeatable.",
)
@CHANGES
@click.option("--plant", metavar="NAME", help="ideal, or contact: wheels that may slip, in MuJoCo.")
@click.option("--seed", type=int, help="The seed; short for --set seed=N.")
@click.option(
    "--out",
    type=PATH,
    help="Folder for the files, with a number added if it has such files.  [default: runs/EXPERIMENT[-VARIANT]]",
)
@click.option("--force", is_flag=True, help="Replace what is already in that folder.")
@click.option("--details", is_flag=True, help="Print every error, peak, torque and gain, not only what matters most.")
@understanding
@shared
def run(
    experiment: str,
    variant: str | None,
    robot: str | None,
    hardware: str | None,
    controllers: tuple[str, ...],
    cases: tuple[str, ...],
    settings: tuple[str, ...],
    plant: str | None,
    seed: int | None,
    out: Path | None,
    force: bool,
    details: bool,
    overrides: dict[str, Any],
    as_json: bool,
) -> int:
    """Run EXPERIMENT with each of its controllers from the same start, and compare their errors.

    EXPERIMENT is a bundled name (see `mmnn list`) or the path of a TOML file. Writes one HDF5 recording per controller
    and the pictures that the experiment asks for. Ctrl-C ends the run and keeps what is recorded (exit code 130).

    An experiment with cases runs all controllers in each of them and gives every run a verdict (exit code 1 if one
    fails).
    """
    from ..lab.experiments.cases import chosen_cases
    from ..lab.experiments.config import load_experiment
    from ..lab.experiments.runner import has_hardware
    from ..lab.show.gallery import require_plots

    chosen = {
        "robot": robot,
        "hardware": hardware,
        "controllers": list(dict.fromkeys(controllers)) or None,
        "seed": seed,
        "plant": plant,
    }
    changes = [*about_robot(robot, overrides), *settings, *in_toml(**chosen)]
    asked, name = chosen_cases(load_experiment(experiment, changes, variant), cases), Path(experiment).stem
    folder = out or Path("runs") / (f"{name}-{variant}" if variant else name)
    require_plots(asked.plots)
    taken = folder
    if not force:
        folder = unused(folder, files_of(asked) if out else None)
    elsewhere = f"{taken} has runs already: these go to {folder} (--force replaces them)" if folder != taken else ""
    said = bool(controllers) or any(change.startswith("controllers") for change in settings)
    by_name = said or says_controllers(experiment)
    behind = bool(asked.cases) or has_hardware(asked)
    with told_from_where(experiment, variant, asked, changes):
        compile_if_cold(behind)
        if asked.cases:
            return run_cases(asked, name, folder, force, as_json, elsewhere)
        return run_one(asked, name, folder, force, as_json, elsewhere, by_name, details)


def says_controllers(experiment: str) -> bool:
    """Whether an experiment is a file of the user's that says which controllers run."""
    from ..lab.experiments.config import bundled, find

    return experiment not in bundled() and "controllers" in read_toml(find(experiment))


@contextlib.contextmanager
def told_from_where(experiment: str, variant: str | None, asked: Experiment, changes: Sequence[str]) -> Iterator[None]:
    """Errors within say which option or line of a file they are about.

    An experiment that does not fit the robot that was given is told with the robot that it is made for.
    """
    try:
        yield
    except InputError as error:
        from ..lab.experiments.config import load_experiment
        from ..lab.experiments.refusals import explained, located

        found = explained(error, Path(experiment).stem, asked, load_experiment(experiment, (), variant))
        raise located(found, experiment, changes, variant) from None


def unused(folder: Path, files: list[str] | None) -> Path:
    """This folder, or where it is taken the first of `FOLDER-2` and so on that does not exist.

    Args:
        folder: The folder.
        files: It is taken if it has one of these; None if it only exists.
    """
    if not (folder.exists() if files is None else any((folder / file).exists() for file in files)):
        return folder
    numbered = (folder.with_name(f"{folder.name}-{i}") for i in itertools.count(2))
    return next(each for each in numbered if not each.exists())


@contextlib.contextmanager
def announced(text: str) -> Iterator[Callable[[str, float], None]]:
    """A progress function that first prints a line on standard error, if there is one; a refused run never does."""
    lines = [text] if text else []

    def tell() -> None:
        if lines:
            note(lines.pop())

    with progress_bar() as show, interruptible(show) as progress:

        def first_told(name: str, fraction: float) -> None:
            tell()
            progress(name, fraction)

        yield first_told
    tell()


def tell_robot(robot: Robot) -> None:
    """Print in short what was understood of a robot."""
    from ..lab.show.robots import summary_text
    from ..model.inspection import inspection_of

    say(f"{summary_text(inspection_of(robot), columns())}\n")


def files_of(asked: Experiment) -> list[str]:
    """Files that a run writes into its folder: recordings by case, and plots."""
    folders = [f"{case}/" for case in asked.cases] or [""]
    runs = [f"{folder}{name}.h5" for folder in folders for name in asked.controllers]
    return [*runs, *(f"{plot}.png" for plot in asked.plots)]


def run_one(
    asked: Experiment, name: str, folder: Path, force: bool, as_json: bool, elsewhere: str, by_name: bool, details: bool
) -> int:
    """Run an experiment, draw and print what came of it; 130 if stopped, 1 if a run did not reach its end, else 0.

    Args:
        asked: The experiment.
        name: Its name.
        folder: For its files.
        force: Replace those that are there.
        as_json: Print one JSON object.
        elsewhere: Said once it is sure to run; empty for nothing.
        by_name: Whether the user chose the controllers; else those that cannot run are left out.
        details: Print all tables, notes and files, not what matters most.
    """
    from ..lab.experiments.runner import run_experiment
    from ..lab.show.comparison import notes, render, render_brief
    from ..lab.show.gallery import write_pictures
    from ..lab.show.report.verdict import headline, lost_runs, rivals_left_out, worse_somewhere
    from ..lab.show.table import alike, hanging

    told = None if as_json else tell_robot
    with announced(elsewhere) as progress:
        result = run_experiment(
            asked, name, out=folder, force=force, progress=progress, leave_out=not by_name, understood=told
        )
    pictures = write_pictures(result.recordings, asked.plots, folder, force)

    def text() -> str:
        found = (*lost_runs(result), *worse_somewhere(result), *rivals_left_out(result), *notes(result))
        remarks = [f"note: {remark}" for remark in found]
        files = [recording.path for recording in result.recordings.values() if recording.path]
        files += list(pictures.values())
        verdict = hanging("", headline(result), columns())
        if details:
            return "\n".join([styled(render(result, **look())), "", verdict, *remarks, wrote(files)])
        table = styled(render_brief(result, **look()))
        return "\n".join([verdict, "", table, "", *alike(remarks, least=2), wrote_into(folder, files)])

    answer(as_json, lambda: result.to_dict() | {"plots": named(pictures)}, text)
    if any(recording.outcome.status == "interrupted" for recording in result.recordings.values()):
        return STOPPED
    return DONE if result.completed else FAILED


def run_cases(asked: Experiment, name: str, folder: Path, force: bool, as_json: bool, elsewhere: str) -> int:
    """Run all controllers in all cases and print the verdicts; the exit code."""
    from ..lab.experiments.cases import run_cases as run_all
    from ..lab.show.comparison import render_cases

    told = None if as_json else tell_robot
    with announced(elsewhere) as progress:
        matrix = run_all(asked, name, out=folder, force=force, progress=progress, understood=told)
    command = f"mmnn plot {folder}/{next(iter(matrix.verdicts))}/*.h5"
    files = f"wrote {folder}/CASE/CONTROLLER.h5; look at one with: {command}"
    answer(as_json, matrix.to_dict, lambda: f"{styled(render_cases(matrix, **look()))}\n\n{files}")
    return STOPPED if matrix.interrupted else DONE if matrix.completed else FAILED


def in_toml(**values: object) -> list[str]:
    """Changes `key=value` of those that are given; JSON's texts, lists and integers are TOML's."""
    return [f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in values.items() if value is not None]


def about_robot(robot: str | None, overrides: dict[str, Any]) -> list[str]:
    """Changes of the TOML for what the options state about the robot; another robot drops what the TOML states."""
    anew = ["overrides={}"] if robot is not None else []
    return [*anew, *in_toml(**{f"overrides.{key}": value for key, value in overrides.items()})]


@click.command(
    "list",
    short_help="List experiments with their cases, robots, controllers, references.",
    epilog=examples("mmnn list", "mmnn list --json"),
)
@shared
def list_(as_json: bool) -> int:
    """List the bundled experiments with their cases, robots, hardware, the controllers and the references.

    Controllers are listed with what they know and what they learn.
    """
    from ..lab.experiments.config import bundled, variants
    from ..lab.experiments.controllers import CONTROLLERS
    from ..lab.experiments.hardware_table import profiles
    from ..lab.experiments.references import ARM_PROFILES, BASE_PATHS
    from ..model.robots import bundled as robots
    from ..model.robots import extra

    files = {name: read_toml(path) for name, path in bundled().items()}
    there_is: dict[str, dict[str, Any]] = {
        "experiments": {name: table.get("title", "") for name, table in files.items()},
        "variants": {name: list(variants(path)) for name, path in bundled().items()},
        "cases": {name: list(table.get("cases", {})) for name, table in files.items()},
        "robots": {name: str(path) for name, path in (robots() | extra()).items()},
        "hardware": {name: read_toml(path)["title"] for name, path in profiles().items()},
        "controllers": CONTROLLERS,
        "references": {
            part: {name: (kind.__doc__ or "").partition("\n")[0] for name, kind in kinds.items()}
            for part, kinds in (("base", BASE_PATHS), ("arm", ARM_PROFILES))
        },
    }
    answer(as_json, lambda: there_is, lambda: list_text(there_is, columns()))
    return DONE


def list_text(there_is: dict[str, dict[str, Any]], width: int) -> str:
    """Experiments, robots, controllers and references in lines of at most `width` columns.

    Variants and cases stand behind their experiments.

    Robots are named with the files that they come from, which stay whole, in groups by folder.
    """
    from ..lab.show.table import hanging

    titles = dict(there_is["experiments"])
    for option in ("variant", "case"):
        for name, known in there_is[f"{option}s"].items():
            titles[name] += f" (--{option} {few(known)})" if known else ""
    groups: dict[str, dict[str, str]] = {"experiments": titles}
    for name, file in there_is["robots"].items():
        folder = robot_folder(Path(file))
        groups.setdefault(f"robots in {folder}", {})[name] = str(Path(file).relative_to(folder))
    groups["hardware"] = there_is["hardware"]
    groups["controllers"] = there_is["controllers"]
    groups |= {f"references of the {part}": kinds for part, kinds in there_is["references"].items()}
    lines = {
        kind: [hanging(f"  {name:24}", text, width) if text else f"  {name}" for name, text in group.items()]
        for kind, group in groups.items()
    }
    return "\n".join("\n".join([kind, *group]) for kind, group in lines.items())


def robot_folder(file: Path) -> Path:
    """The folder that the robots beside a file share: that of example-robot-data, or its own."""
    return next((folder for folder in file.parents if folder.match("example-robot-data/robots")), file.parent)


@click.command(
    short_help="Run an experiment under each reading that the thesis allows.",
    epilog=examples(
        "mmnn readings chapter4",
        "mmnn readings chapter4 --variant printed",
        "mmnn readings chapter4 --set time.control_period=0.001 --json",
    ),
)
@click.argument("experiment", shell_complete=experiments)
@VARIANT
@CHANGES
@shared
def readings(experiment: str, variant: str | None, settings: tuple[str, ...], as_json: bool) -> int:
    """Run both networks of EXPERIMENT as it is, then with one reading of the thesis changed at a time, and compare.

    The readings: learning rates per sample or per second, weights from zero or random, Appendix B's order and its
    wd = 5, the frame of the pose error in the networks' input, the input with and without absolute position. Nothing
    is written.
    """
    from ..lab.experiments.cases import readings as turn
    from ..lab.experiments.cases import summaries
    from ..lab.experiments.config import load_experiment
    from ..lab.show.comparison import render_readings

    asked, name = load_experiment(experiment, settings, variant), Path(experiment).stem
    compile_if_cold()
    with progress_bar() as show:
        rows = summaries(turn(asked, name, show))
    words = f" (variant {asked.variant})" if asked.variant else ""
    answer(
        as_json,
        lambda: {"experiment": name, "variant": asked.variant, "readings": rows},
        lambda: render_readings(f"{asked.title or name}{words}, one reading changed at a time", rows, columns()),
    )
    return DONE
