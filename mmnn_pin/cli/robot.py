"""`mmnn inspect`, `check` and `model`: what a robot is, whether its model holds, and the model at a state."""

from __future__ import annotations

import functools
import os
from pathlib import Path
from typing import Any

import click

from ..errors import RobotError
from ..files import require_free
from .options import FORCE, NO_BROWSER, PATH, PORT, examples, numbers, robots, run_command, shared, understanding
from .output import BAD_INPUT, DONE, FAILED, answer, columns, note, open_page, progress_bar, warn


@click.command(
    short_help="Check the properties of a robot's model, with numbers.",
    epilog=examples(
        "mmnn check platform_arm",
        "mmnn check my_robot.urdf --samples 1000 --seed 7",
        "mmnn check tiago --bound M_max=120 --bound C_b=5      bounds that your own proof assumes",
    ),
)
@click.argument("robot", shell_complete=robots)
@click.option("--samples", type=click.IntRange(1, 1_000_000), default=100, help="Random states.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=0, help="Their seed.")
@click.option("--bound", "bounds", multiple=True, metavar="NAME=VALUE", help="M_min, M_max or C_b that must hold.")
@understanding
@shared
def check(
    robot: str, samples: int, seed: int, bounds: tuple[str, ...], overrides: dict[str, Any], as_json: bool
) -> int:
    """Check that ROBOT's model has the properties that the controllers' proofs assume.

    Checked are the mass matrix, properties 1 to 5 of the thesis, A T = 0, passivity, the bounds of M and C, and whether
    the base is nonholonomic (mmnn docs reference/checks).

    ROBOT is a bundled name, a name of example-robot-data, or the path of a URDF file. Every property is a number
    without a unit; its worst value over random states is compared with a tolerance. Exit code 1 when one fails.
    """
    from ..lab.show.robots import properties_dict, properties_text
    from ..model.checks.properties import check as judge
    from ..model.loading import load

    loaded = load(robot, **overrides)
    with progress_bar() as show:
        own = numbers(bounds, "--bound")
        report = judge(loaded, samples, seed, bounds=own, progress=functools.partial(show, "checking"))
    answer(as_json, lambda: properties_dict(report), lambda: properties_text(report, columns()))
    return DONE if report.passed else FAILED


@click.command(
    short_help="Show what the loader understood of a robot, and every finding.",
    epilog=examples(
        "mmnn inspect my_robot.urdf",
        "mmnn inspect my_robot.urdf --wheels left_joint,right_joint --radius 0.1",
        "mmnn inspect tiago --lock torso_lift_joint=0.2 --arm-tip arm_7_link",
        "mmnn inspect my_robot.urdf --gains               the gains that mmnn run track gives it",
        "mmnn inspect my_robot.urdf --picture robot.png   what was understood, in colours",
        "mmnn inspect my_robot.urdf --strict --json",
    ),
)
@click.argument("robot", shell_complete=robots)
@click.option("--gains", is_flag=True, help="Also the gains that suit it, as `mmnn run track` takes them.")
@click.option("--picture", metavar="FILE.png", type=PATH, help="Write a picture of what was understood.")
@FORCE
@understanding
@shared
def inspect(
    robot: str, gains: bool, picture: Path | None, force: bool, overrides: dict[str, Any], as_json: bool
) -> int:
    """Show what the loader understood of ROBOT: base, wheels, arm with limits, locked joints, mass, and all findings.

    ROBOT is a bundled name, a name of example-robot-data, or the path of a URDF file. The options can also
    stand in NAME.mmnn.toml beside NAME.urdf. Exit code 2 when the robot cannot be used or its base is undecided.
    """
    from ..lab.experiments.hardware_table import beside_urdf, proposed
    from ..lab.show.robots import inspection_text, refusal_text, summary
    from ..model.base.overrides import Overrides
    from ..model.inspection import inspection_of, refusal_of
    from ..model.loading import load
    from ..model.robots import find

    if picture is not None:
        require_free(picture, force)
    try:
        loaded = load(robot, **overrides)
        content, code = inspection_of(loaded), DONE
        if gains:
            from ..lab.experiments.track_gains import track_gains

            content["track"] = track_gains(loaded)
        content["understood"] = summary(content)
        own, profile, run = beside_urdf(robot), proposed(loaded), run_command(robot, overrides)
        content["hardware"] = {"profile": own or profile, "run": run if own else f"{run} --hardware {profile}"}
    except RobotError as error:
        content, code = refusal_of(error, find(robot), Overrides(**overrides)), BAD_INPUT
    for finding in content["findings"]:
        if finding["severity"] == "error":
            note(finding["text"])
    if picture is not None and code == DONE:
        from ..lab.show.figure import save
        from ..lab.show.picture import picture as drawn

        figure, warnings = drawn(loaded)
        content["picture"] = str(save(figure, picture, force))
        for line in warnings:
            warn(line)
        note(f"wrote {picture}")
    text = inspection_text(content, columns()) if code == DONE else refusal_text(content)
    without_texts = [{k: v for k, v in finding.items() if k != "text"} for finding in content["findings"]]
    if as_json or text:
        answer(as_json, lambda: content | {"findings": without_texts}, lambda: text)
    return code


@click.command(
    short_help="Look at a robot in the browser: what was understood, in colours, with sliders.",
    epilog=examples(
        "mmnn view tiago",
        "mmnn view my_robot.urdf --at state.json            where it stands, as `mmnn model` takes it",
        "mmnn view my_robot.urdf --arm-tip gripper --port 8000 --no-browser",
    ),
)
@click.argument("robot", shell_complete=robots)
@click.option("--at", "state", metavar="STATE.json", type=PATH, help="Where it stands.  [default: at rest]")
@PORT
@NO_BROWSER
@understanding
@shared
def view(robot: str, state: Path | None, port: int, no_browser: bool, overrides: dict[str, Any], as_json: bool) -> int:
    """Show ROBOT in meshcat: wheels, arm, jaws, head and what is locked in colours of their own, forward as an arrow.

    ROBOT is a bundled name, a name of example-robot-data, or the path of a URDF file. The page is served to this
    machine only, until Ctrl-C. Every joint has a slider.
    """
    parent = os.getppid()
    from ..lab.show.replay import wait_until_left
    from ..lab.show.view import RobotView
    from ..model.inspection import read_state
    from ..model.loading import load

    loaded = load(robot, **overrides)
    q = read_state(state, loaded)[0][loaded.q_places] if state else None
    with RobotView(loaded, q, port) as shown:
        for line in shown.warnings:
            warn(line)
        answer(as_json, lambda: {"robot": loaded.name, "url": shown.url}, lambda: f"{shown.url}; Ctrl-C ends it")
        open_page(shown.url, no_browser)
        wait_until_left(parent)
    return DONE


@click.command(
    short_help="Print a robot's reduced model at one state.",
    epilog=examples(
        "mmnn model platform_arm",
        """echo '{"base_velocity": [0.3, 0], "joints": {"arm_2_joint": 0.8}}' > state.json""",
        "mmnn model platform_arm --at state.json --json",
    ),
)
@click.argument("robot", shell_complete=robots)
@click.option("--at", "state", metavar="STATE.json", type=PATH, help="The state.  [default: at rest]")
@understanding
@shared
def model(robot: str, state: Path | None, overrides: dict[str, Any], as_json: bool) -> int:
    """Print the reduced model of ROBOT at one state: M, C, gravity, friction, T, A, E with names.

    ROBOT is a bundled name, a name of example-robot-data, or the path of a URDF file. STATE.json has the keys
    pose [x, y, phi], base_velocity [v, w], joints {name: rad or m}, joint_velocities {name: rad/s or m/s}; what is left
    out is zero.
    """
    from ..lab.show.robots import model_text
    from ..model.inspection import NamedState, doubtful, model_at, read_state
    from ..model.loading import load

    loaded = load(robot, **overrides)
    position, nu = read_state(state, loaded) if state else NamedState().of(loaded)
    at = model_at(loaded, position, nu)
    for doubt in doubtful(loaded, position):
        warn(f"{state}: {doubt}")
    answer(as_json, lambda: at, lambda: model_text(at, columns()))
    return DONE
