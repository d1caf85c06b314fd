"""`mmnn check`."""

from __future__ import annotations

from typing import Any

import click

from .options import examples, shared, understanding
from .output import DONE, FAILED, progress_bar, say, say_json


@click.command(
    short_help="Check the properties of a robot's model, with numbers.",
    epilog=examples(
        "mmnn check platform_arm",
        "mmnn check my_robot.urdf --samples 1000 --seed 7",
        "mmnn check tiago --json",
    ),
)
@click.argument("robot")
@click.option("--samples", type=click.IntRange(1, 1_000_000), default=100, show_default=True, help="Random states.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True, help="Their seed.")
@understanding
@shared
def check(robot: str, samples: int, seed: int, said: dict[str, Any], as_json: bool) -> int:
    """Check ROBOT: M, properties 1-5, A S = 0, passivity, bounds of M and C, and whether its base is nonholonomic.

    ROBOT is a bundled name, a name of example-robot-data, or the path of a URDF file. Every property is a scale-free
    residual, its worst value over random states held against a tolerance; exit code 1 when one fails.
    """
    from ..lab.show.properties import properties_text, to_dict
    from ..model.checks.properties import check_properties
    from ..model.loading import load

    loaded = load(robot, **said)
    with progress_bar() as show:
        progress = None if show is None else lambda fraction: show("checking", fraction)
        report = check_properties(loaded, samples, seed, progress=progress)
    if as_json:
        say_json(to_dict(report))
    else:
        say(properties_text(report))
    return DONE if report.passed else FAILED
