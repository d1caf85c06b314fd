"""`mmnn inspect`."""

from __future__ import annotations

from typing import Any

import click

from ..errors import RobotError
from .options import examples, shared, understanding
from .output import BAD_INPUT, DONE, say, say_json


@click.command(
    short_help="Show what the loader understood of a robot, and every finding.",
    epilog=examples(
        "mmnn inspect my_robot.urdf",
        "mmnn inspect my_robot.urdf --wheels left_joint,right_joint --radius 0.1",
        "mmnn inspect tiago --lock torso_lift_joint=0.2 --arm-tip arm_7_link",
        "mmnn inspect my_robot.urdf --strict --json",
    ),
)
@click.argument("robot")
@understanding
@shared
def inspect(robot: str, said: dict[str, Any], as_json: bool) -> int:
    """Show what the loader understood of ROBOT: base, wheels, arm with limits, locked joints, mass, and all findings.

    ROBOT is a bundled name, a name of example-robot-data, or the path of a URDF file. What is said in the options can
    stand in NAME.mmnn.toml beside NAME.urdf too. Exit code 2 when the robot cannot be used or its base is undecided.
    """
    from ..lab.show.inspection import inspection_text, refusal_text
    from ..model.base.overrides import Overrides
    from ..model.inspection import inspection_of, refusal_of
    from ..model.loading import load
    from ..model.robots import find

    try:
        content, code = inspection_of(load(robot, **said)), DONE
    except RobotError as error:
        path = find(robot)
        content, code = refusal_of(error, path, Overrides(**said)), BAD_INPUT
    for finding in content["findings"]:
        if finding["severity"] == "error":
            click.echo(finding["text"], err=True)
    if as_json:
        say_json(without_texts(content))
    elif code == DONE:
        say(inspection_text(content))
    elif text := refusal_text(content):
        say(text)
    return code


def without_texts(content: dict[str, Any]) -> dict[str, Any]:
    """The content without the lines that a terminal shows."""
    findings = [{k: v for k, v in finding.items() if k != "text"} for finding in content["findings"]]
    return content | {"findings": findings}
