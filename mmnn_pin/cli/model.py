"""`mmnn model`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .options import examples, shared, understanding
from .output import DONE, say, say_json


@click.command(
    short_help="Print a robot's reduced model at one state.",
    epilog=examples(
        "mmnn model platform_arm",
        """echo '{"base_velocity": [0.3, 0], "joints": {"arm_2_joint": 0.8}}' > state.json""",
        "mmnn model platform_arm --at state.json --json",
    ),
)
@click.argument("robot")
@click.option("--at", "state", metavar="STATE.json", type=click.Path(path_type=Path), help="The state; else at rest.")
@understanding
@shared
def model(robot: str, state: Path | None, said: dict[str, Any], as_json: bool) -> int:
    """Print the reduced model of ROBOT at one state: M, C, gravity, friction, T, A, E with names.

    ROBOT is a bundled name, a name of example-robot-data, or the path of a URDF file. STATE.json has the keys
    pose [x, y, phi], base_velocity [v, w], joints {name: rad or m}, joint_velocities {name: rad/s or m/s}; what is left
    out is at rest and zero.
    """
    from ..model.inspection import NamedState, model_at, read_state
    from ..model.loading import load

    loaded = load(robot, **said)
    position, nu = read_state(state, loaded) if state else NamedState().of(loaded)
    at = model_at(loaded, position, nu)
    if as_json:
        say_json(at)
    else:
        from ..lab.show.matrices import model_text

        say(model_text(at))
    return DONE
