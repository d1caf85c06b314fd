"""`mmnn identify`: from recorded motion to a corrected URDF."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ConfigError
from ..files import require_free
from .options import FORCE, PATH, RangedNumber, examples, numbers, robots, run_command, shared, understanding
from .output import BAD_INPUT, DONE, FAILED, answer, look, named, progress_bar, styled, warn, wrote

if TYPE_CHECKING:
    from ..deploy.identify.doctor import ExaminedLog
    from ..deploy.identify.identification import Identification
    from ..deploy.identify.log import Log
    from ..deploy.identify.mends import Mend
    from ..deploy.identify.odometry import Wheels
    from ..deploy.identify.rotors import RotorChoice
    from ..model.robot import Robot

FOLLOWS = "kalman_friction"  # the controller that follows such motions best, with delay and encoders, too
HEADERS = (
    "Which header, joint or topic holds a signal: SIGNAL=HEADER, several separated by commas, or a TOML file of such"
    " lines. Repeatable."
)
MENDS = (
    "How to correct a signal, as the check advises: its unit (ms, us, ns, deg, mm, counts:4096), negated,"
    " late:SECONDS, lag:SECONDS, seam:PERIOD, another signal, dropped. '*' stands for several. Repeatable."
)


@click.command(
    short_help="Find inertias and friction from recorded motion, and write a corrected URDF.",
    epilog=examples(
        "mmnn identify motion.csv --robot my_arm.urdf",
        "mmnn identify motion.csv --robot my_arm.urdf --check                    what is wrong with the log?",
        "mmnn identify motion.csv --robot my_arm.urdf --mend 'effort.*=late:0.05' --mend time=us",
        "mmnn identify bag_folder --robot ur10 --out ur10_identified",
        "mmnn identify q.csv v.csv tau.csv --robot tiago --columns 'position.{joint}={joint}_pos'",
        "mmnn identify log.mcap --robot my_arm.urdf --torque-constant joint_1=13.6 --torque-constant joint_2=13.6",
        "mmnn identify log.mcap --robot my_arm.urdf --torque-constant joint_1=?     from what the others feel",
        "mmnn identify with_load.csv --robot identified/my_arm.urdf --payload     what the hand carries",
        "mmnn identify with_load.csv --without-load empty.csv --robot my_arm.urdf --payload",
        "mmnn identify fit.csv --held-out other.csv --robot my_arm.urdf --stribeck 0.05",
    ),
)
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=PATH)
@click.option(
    "--robot",
    required=True,
    shell_complete=robots,
    help="A bundled name, a name of example-robot-data, or a URDF file.",
)
@click.option("--out", default=Path("identified"), type=PATH, help="Folder, or NAME.urdf.")
@click.option("--columns", metavar="SIGNAL=HEADER", multiple=True, help=HEADERS)
@click.option("--rate", type=RangedNumber(1.0, 1e5), metavar="HZ", help="Rows per second of a table without times.")
@click.option("--degrees", is_flag=True, help="Angles are in degrees.")
@click.option(
    "--torque-constant", "constants", metavar="JOINT=K", multiple=True,
    help="Torque at the joint per unit of its recorded effort, for motor currents; '?' finds it. Repeatable.",
)  # fmt: skip
@click.option(
    "--held-out", multiple=True, metavar="LOG", type=PATH, help="Judge on this log.  [default: the last third of each]"
)
@click.option("--cutoff", type=float, metavar="HZ", help="Low-pass on motion and torque.  [default: by the motion]")
@click.option("--stribeck", type=float, metavar="V", help="Fit Stribeck friction with this velocity, rad/s or m/s.")
@click.option(
    "--rotors", type=click.Choice(["no", "yes", "auto"]), default="auto",
    help="Inertias of motors: none beyond the URDF's, in every joint, or where the data ask for one.",
)  # fmt: skip
@click.option("--check", is_flag=True, help="Say what is wrong with the logs, worst first, and write nothing.")
@click.option("--mend", "mends", metavar="SIGNAL=HOW", multiple=True, help=MENDS)
@click.option("--payload", is_flag=True, help="Find mass and centre of the load in ROBOT's hand, and write nothing.")
@click.option(
    "--without-load", multiple=True, metavar="LOG", type=PATH,
    help="The motion of --payload with an empty hand: it separates the load from the robot's own errors.",
)  # fmt: skip
@click.option("--joint", default="", show_default="the last of the arm", help="Joint whose link carries the payload.")
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
    rotors: RotorChoice,
    check: bool,
    mends: tuple[str, ...],
    payload: bool,
    without_load: tuple[Path, ...],
    joint: str,
    even_if_worse: bool,
    force: bool,
    overrides: dict[str, Any],
    as_json: bool,
) -> int:
    """Find inertias and friction of ROBOT from recorded motion, judge them on motion held out, write a corrected URDF.

    LOG is a CSV file (`time`, `position.JOINT`, `velocity.JOINT`, `effort.JOINT`, `base.v`, `base.w`, or headers with a
    joint's name and such a word), a bag (rosbag2 with sqlite3 or MCAP) with sensor_msgs/JointState, or a recording of
    this package. Tables with the same times are one motion. Parameters that the motion does not determine keep the
    URDF's values and are named.

    It writes NAME.urdf, NAME.identified.toml (rotors, constants), NAME.identified.json (all numbers, covariances) and
    NAME.mmnn.toml. A log that contradicts the physics is refused (exit code 2), with the option that mends it. Where
    the fit predicts the held-out motion no better than the URDF or friction alone it writes nothing, and the exit code
    is 1.
    """
    from ..deploy.identify import corrected, identification
    from ..deploy.identify.mends import read_mends
    from ..deploy.identify.reading import read_columns, read_logs
    from ..lab.show.identified import text_of
    from ..model.loading import load

    loaded, names = load(robot, **overrides), read_columns(columns)
    mend = read_mends(mends)
    if payload:
        every = [read_logs(some, loaded, names, rate, degrees) for some in (logs, without_load)]
        return carried(loaded, every, constants, mend, joint, cutoff, as_json)
    if without_load:
        raise ConfigError("it goes with --payload", fix="add it, or leave it out", key="--without-load")
    if not check:
        corrected.require_free(corrected.files_of(loaded, out), loaded, force)
    with progress_bar() as show:
        show("reading the logs", 0.0)
        given, judged = (read_logs(some, loaded, names, rate, degrees) for some in (logs, held_out))
        if check:
            seen, wheels = identification.examine(
                loaded, [*given, *judged], torque_constants=constants_of(constants), mend=mend, progress=show
            )
            return checked(robot, seen, wheels, as_json)
        found = identification.identify(
            loaded, given, held_out=judged, cutoff=cutoff, stribeck=stribeck,
            torque_constants=constants_of(constants), mend=mend, rotors=rotors, progress=show,
        )  # fmt: skip
    report = corrected.report_of(found)
    files = corrected.write(found, out, force) if found.better or even_if_worse else {}
    report |= {"file": str(files["urdf"]) if files else None, "files": named(files)}

    def text() -> str:
        after = [wrote(files.values()), *what_it_changes(found, robot, files["urdf"], overrides)] if files else []
        return "\n".join((styled(text_of(report, **look())), *after))

    answer(as_json, lambda: report, text)
    if not files:
        warn(f"nothing written: {why_nothing(found)}; --even-if-worse writes it")
    return DONE if files else FAILED


def checked(robot: str, seen: list[ExaminedLog], wheels: Wheels | None, as_json: bool) -> int:
    """Print what the doctor saw, worst first; the exit code is that of bad input where something is refused."""
    from ..deploy.identify.doctor import all_findings
    from ..lab.show.identified import check_text

    found = all_findings([one.log for one in seen])
    report: dict[str, Any] = {"robot": robot, "findings": [one.to_dict() for one in found]}
    report |= {"logs": [one.to_dict() for one in seen], "wheels": None if wheels is None else wheels.to_dict()}
    answer(as_json, lambda: report, lambda: check_text(report))
    return BAD_INPUT if any(one.grade == "refused" for one in found) else DONE


def what_it_changes(found: Identification, robot: str, urdf: Path, overrides: dict[str, Any]) -> Iterator[str]:
    """The lines that say how to see what a correction is worth; none where the old file does not move as the new one.

    Args:
        found: What was identified.
        robot: The robot before, as the user named it.
        urdf: The corrected file.
        overrides: What was stated about the robot.
    """
    if found.wheels is not None or {"xacro", "without"} & set(overrides):  # other radii; options for one of the two
        return
    yield "what that changes: the robot as it was identified, driven with the old model (nominal) and with the new one:"
    model: dict[str, object] = {"nominal__robot": robot, "nominal__masses": 1.0, "nominal__friction": True}
    yield f"  {run_command(str(urdf), overrides, 'nominal', 'computed_torque', **model)}"


def why_nothing(found: Identification) -> str:
    """The reason why a fit is not written."""
    if found.plausible and not found.helps_in_urdf and found.error("identified") < found.error("urdf"):
        held, before = (f"{100 * found.error(model):.3g} %" for model in ("urdf_file", "urdf"))
        why = f"what a URDF can hold of the fit predicts no better ({held}) than the URDF ({before})"
        return f"{why}; what helps are constants and rotors"
    if found.plausible:
        return "the fit is no better than what it is compared with"
    why = "no masses that can be explain these efforts: currents need --torque-constant, check units and signs"
    ours, any_numbers = found.errors("identified"), found.errors("least_squares")
    shares = {
        name: float(ours[i] / any_numbers[i])
        for i, name in enumerate(found.names)
        if found.follows[i] and name in found.robot.actuator_names and any_numbers[i] > 0
    }
    if found.follows.sum() < 2 or not shares:
        return why
    worst = max(shares, key=lambda name: shares[name])
    return f"{why}; without the worst, which may have another unit: --mend 'effort.{worst}=dropped'"


def constants_of(given: tuple[str, ...]) -> dict[str, float | None]:
    """Torque constants by motor, None for those to be found."""
    unknown = {text.removesuffix("=?"): None for text in given if text.endswith("=?")}
    return numbers([text for text in given if not text.endswith("=?")], "--torque-constant") | unknown


def carried(
    robot: Robot,
    logs: list[list[Log]],
    constants: tuple[str, ...],
    mend: Mend,
    joint: str,
    cutoff: float | None,
    as_json: bool,
) -> int:
    """Print what a robot carries, by logs with the load and without.

    What `identify` found of the robot lies beside its corrected URDF, and is used.
    """
    from ..deploy.identify.identification import scaled
    from ..deploy.identify.mends import mended, mends_of, require_signals
    from ..deploy.identify.payload import payload
    from ..lab.show.identified import payload_text
    from ..model.regressor import Regressor
    from ..torque.prior import identified

    factors, known = numbers(constants, "--torque-constant"), robot.path.with_suffix(".identified.json")
    require_signals([log for some in logs for log in some], mend)
    loaded, empty = ([mended(scaled(log, robot, factors), mends_of(log, mend)) for log in some] for some in logs)
    believed = identified(str(known), Regressor.of(robot).labels, "--robot") if known.exists() else None
    found = payload(robot, loaded, joint, cutoff, believed, empty)
    report = found.to_dict() | {"known_by": str(known) if believed else None}
    answer(as_json, lambda: report, lambda: payload_text(report))
    return DONE


@click.command(
    short_help="Find the motion from which a robot's inertias and friction are identified best.",
    epilog=examples(
        "mmnn excite platform_arm --out motion.csv",
        "mmnn excite ur10 --duration 60 --share 0.5 --out motion.csv     half of all limits",
        "mmnn excite tiago --space 0.5 --seconds 60 --json               what it would determine",
        "mmnn excite platform_arm --obstacle 0.9,0,0.2 --obstacle 0,0.8,0.3,0.7     0.7 m tall, the other one a pillar",
    ),
)
@click.argument("robot", shell_complete=robots)
@click.option("--out", type=PATH, default=Path("excitation.csv"), help="The CSV file.")
@click.option("--duration", type=float, default=40.0, metavar="S", help="Duration of the motion.")
@click.option("--space", type=float, default=1.0, metavar="M", help="How far the base may go to either side.")
@click.option(
    "--share", type=float, default=0.8, help="Share of the limits of position, speed and torque that it may use."
)
@click.option(
    "--clearance",
    type=float,
    default=0.06,
    metavar="M",
    help="Radius of the spheres along the links that are kept apart, and distance to obstacles.",
)
@click.option(
    "--obstacle", "obstacles", metavar="X,Y,RADIUS[,HEIGHT]", multiple=True,
    help="An upright cylinder on the floor, in m from where the base starts, x ahead, y to the left. Repeatable.",
)  # fmt: skip
@click.option("--seconds", type=float, default=20.0, metavar="S", help="Duration of the search.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=0, help="Seed of the search.")
@FORCE
@understanding
@shared
def excite(
    robot: str,
    out: Path,
    duration: float,
    space: float,
    share: float,
    clearance: float,
    obstacles: tuple[str, ...],
    seconds: float,
    seed: int,
    force: bool,
    overrides: dict[str, Any],
    as_json: bool,
) -> int:
    """Find the motion of ROBOT from which inertias and friction are identified best, and write it as CSV.

    The motion stays within the robot's limits and the floor of --space, keeps the URDF's shapes away from every
    --obstacle, and starts and ends at rest. The table has t, for a base x, y, phi, v, w, and
    position.JOINT, velocity.JOINT, acceleration.JOINT at 100 rows per second. The command prints how well it
    determines the base parameters: predicted standard deviations, for noise of 2 % of each motor's limit.
    """
    from ..deploy.identify import excitation
    from ..deploy.identify.clearance import Obstacle
    from ..lab.show.identified import excitation_text
    from ..model.loading import load

    require_free(out, force)
    around = tuple(map(Obstacle.read, obstacles))
    limits = excitation.ExcitationLimits(duration, space, share, clearance, seconds, seed, around)
    found = excitation.excite(load(robot, **overrides), limits)
    found.save(out, force)
    report = found.to_dict() | {"file": str(out)}

    def text() -> str:
        """The motion that was found, and the command that drives it: unscaled, for it keeps its share of the limits.

        Such motions ask for torques that the feedback of a light joint, which has to bear delay, is too weak for.
        """
        whole: dict[str, object] = {"reference__file": str(out), "reference__share": 0.0}
        whole["time__duration"] = float(found.time[-1])
        drive = run_command(robot, overrides, FOLLOWS, **whole)
        return f"{excitation_text(report)}\n{wrote([out])}\ndrive it, in simulation first:\n  {drive}"

    answer(as_json, lambda: report, text)
    return DONE
