"""`mmnn warm`: compile ahead."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from .options import CHANGES, VARIANT, controllers, examples, experiments, robots, shared, understanding
from .output import DONE, answer, progress_bar, tell_what_compiles

SAMPLES = 20  # control samples of every controller


@click.command(
    epilog=examples(
        "mmnn warm                                      what `mmnn run track` compiles",
        "mmnn warm chapter5 --controller adaptive",
        "mmnn warm track --robot my_robot.urdf",
    )
)
@click.argument("experiment", default="track", shell_complete=experiments)
@VARIANT
@click.option("--robot", metavar="ROBOT", shell_complete=robots, help="Another robot: a name or a URDF file.")
@click.option(
    "--controller", "controllers", metavar="NAME", multiple=True, shell_complete=controllers,
    help="Only this controller; repeatable.",
)  # fmt: skip
@CHANGES
@understanding
@shared
def warm(
    experiment: str,
    variant: str | None,
    robot: str | None,
    controllers: tuple[str, ...],
    settings: tuple[str, ...],
    overrides: dict[str, Any],
    as_json: bool,
) -> int:
    """Compile the code of EXPERIMENT in advance, so that its first run begins at once.

    Every controller is run for some samples, and nothing but compiled code is written. Ctrl-C keeps what has been
    compiled.
    """
    import msgspec

    from ..compiled.folders import checked_root
    from ..lab.experiments.config import load_experiment
    from ..lab.experiments.runner import run_experiment
    from .run import about_robot, in_toml

    chosen = in_toml(robot=robot, controllers=list(dict.fromkeys(controllers)) or None)
    asked = load_experiment(experiment, [*about_robot(robot, overrides), *settings, *chosen], variant)
    timing = msgspec.structs.replace(asked.time, duration=SAMPLES * asked.time.control_period)
    tell_what_compiles()
    began = time.perf_counter()
    with progress_bar() as show:
        result = run_experiment(
            msgspec.structs.replace(asked, time=timing), Path(experiment).stem, progress=show, leave_out=True
        )
    took, root = time.perf_counter() - began, checked_root()
    told = {"experiment": result.name, "controllers": list(result), "seconds": took, "folder": str(root or "")}
    where = f"kept in {root}" if root else "and not kept: no folder can be written"
    answer(as_json, lambda: told, lambda: f"{', '.join(result)}: compiled in {took:.1f} s, {where}")
    return DONE
