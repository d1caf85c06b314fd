"""`mmnn identify`: from recorded motion to a corrected URDF."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from .options import FORCE, examples, numbers, shared, understanding
from .output import DONE, FAILED, answer, named, warn, wrote

HEADERS = (
    "Which header, joint or topic holds a signal: SIGNAL=HEADER, several separated by commas, or a TOML file of such"
    " lines. Repeatable."
)


@click.command(
    short_help="Find inertias and friction from recorded motion, and write a corrected URDF.",
    epilog=examples(
        "mmnn identify motion.csv --robot my_arm.urdf",
        "mmnn identify bag_folder --robot ur10 --out ur10_identified",
        "mmnn identify q.csv v.csv tau.csv --robot tiago --columns 'position.{joint}={joint}_pos'",
        "mmnn identify log.mcap --robot my_arm.urdf --torque-constant joint_1=13.6 --torque-constant joint_2=13.6",
        "mmnn identify fit.csv --held-out other.csv --robot my_arm.urdf --stribeck 0.05",
    ),
)
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--robot", required=True, help="A bundled name, a name of example-robot-data, or a URDF file.")
@click.option(
    "--out",
    default=Path("identified"),
    show_default=True,
    type=click.Path(path_type=Path),
    help="Folder, or NAME.urdf.",
)
@click.option("--columns", metavar="SIGNAL=HEADER", multiple=True, help=HEADERS)
@click.option("--rate", type=click.FloatRange(1.0, 1e5), metavar="HZ", help="Rows per second of a table without times.")
@click.option("--degrees", is_flag=True, help="Angles are in degrees.")
@click.option(
    "--torque-constant", "constants", metavar="JOINT=K", multiple=True,
    help="Torque at the joint per unit of its recorded effort, for motor currents; repeatable.",
)  # fmt: skip
@click.option(
    "--held-out",
    multiple=True,
    metavar="LOG",
    type=click.Path(path_type=Path),
    help="Judge on this log.  [default: the last third of each]",
)
@click.option("--cutoff", type=float, metavar="HZ", help="Low-pass on motion and torque.  [default: by the motion]")
@click.option("--stribeck", type=float, metavar="V", help="Fit Stribeck friction with this velocity, rad/s or m/s.")
@click.option("--even-if-worse", is_flag=True, help="Write the files even if the fit is no better than the URDF.")
@FORCE
@understanding
@shared
def identify(
    logs: tuple[Path, ...],
    robot: str,
    out: Path,
    columns: tuple[str, ...],
    rate: float | None,
    degrees: bool,
    constants: tuple[str, ...],
    held_out: tuple[Path, ...],
    cutoff: float | None,
    stribeck: float | None,
    even_if_worse: bool,
    force: bool,
    overrides: dict[str, Any],
    as_json: bool,
) -> int:
    """Find inertias and friction of ROBOT from recorded motion, judge them on motion held out, write a corrected URDF.

    LOG is a CSV file (`time`, `position.JOINT`, `velocity.JOINT`, `effort.JOINT`, `base.v`, `base.w`, or headers with a
    joint's name and such a word), a bag (rosbag2 with sqlite3 or MCAP) with sensor_msgs/JointState, or a recording of
    this package. Tables with the same times are one motion. What the motion does not tell stays at the URDF and is
    named.
    Written are NAME.urdf, NAME.identified.toml (rotors, constants), NAME.identified.json (all numbers, covariances),
    NAME.mmnn.toml, unless the fit predicts the motion held out no better than the URDF or friction alone: exit code 1.
    """
    from ..deploy.identify import corrected, identification
    from ..deploy.identify.reading import read_columns, read_logs
    from ..lab.show.identified import text_of
    from ..model.loading import load

    loaded, names = load(robot, **overrides), read_columns(columns)
    corrected.require_free(corrected.files_of(loaded, out), loaded, force)
    given, judged = (read_logs(some, loaded, names, rate, degrees) for some in (logs, held_out))
    found = identification.identify(
        loaded, given, held_out=judged, cutoff=cutoff, stribeck=stribeck,
        torque_constants=numbers(constants, "--torque-constant"),
    )  # fmt: skip
    report = corrected.report_of(found)
    files = corrected.write(found, out, force) if found.better or even_if_worse else {}
    report |= {"file": str(files["urdf"]) if files else None, "files": named(files)}
    answer(
        as_json,
        lambda: report,
        lambda: "\n".join((text_of(report, sys.stdout.isatty()), wrote(files.values()))).rstrip(),
    )
    if not files:
        warn("nothing written: the fit is no better than what it is compared with; --even-if-worse writes it")
    return DONE if files else FAILED
