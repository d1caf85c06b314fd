"""Options that the commands have in common, and the examples at the end of their help."""

from __future__ import annotations

import functools
import json
import math
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import click
from click.shell_completion import CompletionItem

from ..errors import ConfigError, InputError

F = TypeVar("F", bound=Callable[..., Any])
PACKAGE = Path(__file__).parent.parent
PATH = click.Path(path_type=Path)


class RangedNumber(click.FloatRange):
    """A number within a range: click takes NaN for one that is in every range."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number of a text."""
        number = float(super().convert(value, param, ctx))
        if math.isnan(number):
            self.fail(f"{value} is no number.", param, ctx)
        return number


def shared(function: F) -> F:
    """Add the options of every command."""
    debug = click.option("--debug", is_flag=True, expose_value=False, help="Show the traceback of an error.")
    as_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout, nothing else.")
    return as_json(debug(function))


def law(function: F) -> F:
    """Add the option that names the file of a learning law; it is run before the command."""
    text = (
        "File of your own controller, FILE.py or FILE.py:Class, needed for its runs. The file is run to evaluate the"
        " recorded weights. Repeatable."
    )

    @functools.wraps(function)
    def loaded(*args: Any, **kwargs: Any) -> Any:
        files = kwargs.pop("law_files")
        if files:
            from ..lab.experiments.laws import load_class, read_file

            for file in files:
                if file.endswith(".py"):
                    read_file(Path(file))
                else:
                    load_class(file)
        return function(*args, **kwargs)

    return cast(F, click.option("--law", "law_files", metavar="FILE", multiple=True, help=text)(loaded))


def understanding(function: F) -> F:
    """Add the options that state what a robot is; the command gets them as `overrides`, keys of `Overrides`."""

    @functools.wraps(function)
    def gathered(*args: Any, **kwargs: Any) -> Any:
        given = {name: kwargs.pop(name) for name in OVERRIDES}
        for key in LISTED:
            if given[key] is not None:
                given[key] = tuple(name.strip() for name in given[key].split(","))
        kept = {name: value for name, value in given.items() if not (value is None or value is False or value == ())}
        return function(*args, overrides=kept, **kwargs)

    return with_all(ROBOT_OPTIONS, gathered)  # type: ignore[return-value]


def judged_on(function: F) -> F:
    """Add the options that say what a learner is judged on."""
    load = click.option(
        "--payload",
        type=RangedNumber(0, 1e6, min_open=True),
        metavar="KG",
        help="Load of the changed robot.  [default: a quarter of what the arm weighs]",
    )
    count = click.option(
        "--windows", type=click.IntRange(1, 1000), default=5, show_default=True, help="Windows of the online FVU."
    )
    return load(count(function))


def makes_runs(function: F) -> F:
    """Add argument and options of a command that makes the runs of a study: which file, where they are made."""
    return with_all(STUDY_OPTIONS, function)


def with_all(options: Sequence[Callable[[F], F]], function: F) -> F:
    """A command with some options, in this order in its help."""
    return functools.reduce(lambda made, option: option(made), reversed(options), function)


# -- what a shell completes; imported is only what a press of the key needs --


def starting(names: Iterable[str], incomplete: str) -> list[CompletionItem]:
    """The names that begin with what is typed, and files where none does."""
    found = [CompletionItem(name) for name in sorted(names) if name.startswith(incomplete)]
    return found or [CompletionItem(incomplete, type="file")]


def experiments(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Bundled experiments, or a file."""
    files = (PACKAGE / "lab/experiments").glob("*.toml")
    return starting((file.stem for file in files if "." not in file.stem), incomplete)


def hardware_names(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Profiles of hardware, or a file."""
    files = (PACKAGE / "lab/experiments/profiles").glob("*.toml")
    return starting((file.stem for file in files), incomplete)


def typed(context: click.Context) -> list[Path]:
    """File of the experiment on the line; click leaves its name in the rest where an option still wants its value."""
    from ..lab.experiments.config import find

    try:
        return [find(context.params.get("experiment") or context.args[0])]
    except (InputError, IndexError):
        return []


def cases(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Cases of the experiment that is typed."""
    from ..files import read_toml

    return [item for file in typed(context) for item in starting(read_toml(file).get("cases", ()), incomplete)]


def variants(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Variants of the experiment that is typed."""
    from ..lab.experiments import config

    return [item for file in typed(context) for item in starting(config.variants(file), incomplete)]


def robots(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Bundled robots and those of example-robot-data, or a file."""
    from ..model.robots import bundled, extra

    return starting(bundled() | extra(), incomplete)


def controllers(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Controllers of the package, or a file with one."""
    from ..torque.entries import CONTROLLERS

    return starting(CONTROLLERS, incomplete)


def keys(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Keys of an experiment, a table after the other; nothing after the equals sign."""
    return [] if "=" in incomplete else [CompletionItem(path) for path in paths(incomplete)]


def paths(incomplete: str) -> list[str]:
    """Key paths that begin so; where that is one table alone, its keys, so that a shell adds no blank after its dot."""
    from ..lab.experiments.config import keys_of, kind_at

    above, dot, _ = incomplete.rpartition(".")
    every = [f"{above}{dot}{key}" for key in keys_of(kind_at(above or None))]
    found = [f"{path}{'.' if keys_of(kind_at(path)) else '='}" for path in every if path.startswith(incomplete)]
    return paths(found[0]) if len(found) == 1 and found[0].endswith(".") else found


FORCE = click.option("--force", is_flag=True, help="Replace existing files.")
PORT = click.option(
    "--port", type=click.IntRange(0, 65535), default=7007, help="Port of the page, or the next that is free."
)
NO_BROWSER = click.option("--no-browser", is_flag=True, help="Only print the address.")
VARIANT = click.option(
    "--variant",
    metavar="NAME",
    shell_complete=variants,
    help="A variant, see `mmnn list`.  [default: the first]",
)
CHANGES = click.option(
    "--set",
    "settings",
    metavar="KEY=VALUE",
    multiple=True,
    shell_complete=keys,
    help="Change a key of the TOML; repeatable.",
)
HARDWARE = click.option(
    "--hardware",
    metavar="NAME",
    shell_complete=hardware_names,
    help="Its hardware: a profile (see `mmnn list`), or a TOML file.  [default: ROBOT.hardware.toml beside the URDF]",
)
PACKAGE_DIRS = click.option(
    "--package-dir", "package_dirs", metavar="DIR", multiple=True, help="Where package:// meshes are; repeatable."
)
STUDY_OPTIONS: tuple[Callable[[F], F], ...] = (
    click.argument("file", metavar="STUDY.toml", type=click.Path(path_type=Path)),
    click.option("--workers", type=int, help="Processes on this machine.  [default: one per core]"),
    click.option(
        "--cluster",
        metavar="ADDRESS",
        help="Run on the Dask cluster of this scheduler. It can run any program here, so name only one that you trust,"
        " best by TLS (tls://...); see mmnn docs how-to/cluster.",
    ),
    CHANGES,
    click.option("--out", type=click.Path(path_type=Path), help="Folder for the results.  [default: runs/STUDY]"),
)
OVERRIDES = (
    "base",
    "wheels",
    "radius",
    "wheel_radii",
    "track",
    "roller",
    "lock",
    "free",
    "arm",
    "arm_tip",
    "package_dirs",
    "xacro",
    "without",
    "controllers_file",
    "mu",
    "steer",
    "hitch",
    "wheelbase",
    "steering_limit",
    "forward",
    "strict",
)
LISTED = ("wheels", "steer", "hitch")  # joints, separated by commas  # fmt: skip
OPTION_OF = {"package_dirs": "package_dir", "controllers_file": "controllers"}  # where the option has another name
ROBOT_OPTIONS: tuple[Callable[[F], F], ...] = (
    click.option(
        "--base",
        metavar="KIND",
        help="Kind of the base: differential_drive, skid_steer, holonomic, car_like, tricycle, swerve, ... or fixed.",
    ),
    click.option("--wheels", metavar="LEFT,RIGHT", help="Joints of the drive wheels, separated by commas."),
    click.option("--radius", type=float, metavar="M", help="Radius of the drive wheels."),
    click.option("--wheel-radii", metavar="JOINT=M", multiple=True, help="Radius of one drive wheel; repeatable."),
    click.option(
        "--track",
        type=float,
        metavar="M",
        help="Distance of left and right wheels; of a skid-steer base the effective one.",
    ),
    click.option("--roller", type=float, metavar="RAD", help="Angle of a holonomic base's rollers: 0 for omni wheels."),
    click.option("--lock", metavar="JOINT[=AT]", multiple=True, help="A joint to lock, at rest or at AT; repeatable."),
    click.option(
        "--free",
        metavar="JOINT",
        multiple=True,
        help="A joint to free that is locked by default, or 'all'; repeatable.",
    ),
    click.option("--arm", metavar="SIDE", help="Which of two arms moves: left, right or both."),
    click.option("--arm-tip", metavar="LINK", help="End of the arm; joints that do not lead to it are locked."),
    PACKAGE_DIRS,
    click.option("--xacro", metavar="NAME:=VALUE", multiple=True, help="Argument of a xacro file; repeatable."),
    click.option("--without", metavar="MACRO", multiple=True, help="Macro of a xacro file to leave out; repeatable."),
    click.option(
        "--controllers",
        "controllers_file",
        metavar="FILE",
        help="YAML file of the robot's ros2_control controllers, for the kind of base, radius and track.",
    ),
    click.option(
        "--mu", type=float, metavar="MU", help="Friction under the wheels of a skid-steer base.  [default: 1]"
    ),
    click.option("--steer", metavar="JOINT,...", help="Joints that steer, separated by commas."),
    click.option("--hitch", metavar="JOINT,...", help="Joints on which trailers follow, separated by commas."),
    click.option("--wheelbase", type=float, metavar="M", help="Distance of the wheels that steer from the fixed axle."),
    click.option("--forward", metavar="AXIS", help="Axis of the root link that points forward: x, -x, y or -y."),
    click.option("--steering-limit", type=float, metavar="RAD", help="Largest steering angle, to either side."),
    click.option("--strict", is_flag=True, help="Refuse impossible inertias and implausible sizes."),
)


def examples(*lines: str) -> str:
    """Examples for the end of a help text, one per line."""
    return "\b\nExamples:\n" + "\n".join(f"  {line}" for line in lines)


def run_command(robot: str, overrides: Mapping[str, Any], *controllers: str, **settings: object) -> str:
    """The `mmnn run track` that drives a robot, to be typed as it stands.

    Args:
        robot: Name or file.
        overrides: What was stated about it, as a command gets it.
        controllers: Those that are to drive it.
        settings: Keys of the experiment, `__` for a dot.
    """
    words = ["mmnn", "run", "track", "--robot", robot]
    for name, value in overrides.items():
        option = "--" + OPTION_OF.get(name, name).replace("_", "-")
        if name in LISTED:
            words += [option, ",".join(value)]
        elif value is True:
            words += [option]
        else:
            words += [word for one in (value if isinstance(value, tuple) else (value,)) for word in (option, str(one))]
    words += [word for name in controllers for word in ("--controller", name)]
    changes = (f"{key.replace('__', '.')}={json.dumps(value, ensure_ascii=False)}" for key, value in settings.items())
    return shlex.join([*words, *(word for change in changes for word in ("--set", change))])


def numbers(given: Sequence[str], option: str) -> dict[str, float]:
    """Numbers by name of a repeatable option NAME=NUMBER.

    Raises:
        ConfigError: Something else was given, or a name twice.
    """
    found: dict[str, float] = {}
    for text in given:
        name, _, value = text.rpartition("=")
        if not name or name in found:
            why = f"'{name}' is given twice" if name else ""
            raise ConfigError(text, why=why, fix="write NAME=NUMBER, each name once", key=option)
        try:
            found[name] = float(value)
        except ValueError as error:
            raise ConfigError(text, why=f"'{value}' is no number", fix="write NAME=NUMBER", key=option) from error
    return found
