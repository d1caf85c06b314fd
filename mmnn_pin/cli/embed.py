"""`mmnn embed`: a controller as C99 source with a self-test."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ConfigError, UnknownName
from .options import CHANGES, HARDWARE, PATH, VARIANT, controllers, examples, experiments, shared, understanding
from .output import DONE, FAILED, answer
from .run import ROBOT, about_robot, in_toml, told_from_where

if TYPE_CHECKING:
    from ..deploy.embed import Embedded
    from ..deploy.embed.in_the_loop import RunComparison
    from ..reference.limits import Limits


@click.command(
    short_help="Write a controller as C99 source with a self-test.",
    epilog=examples(
        "mmnn embed track --controller two_layer --out firmware",
        "mmnn embed track --robot tiago --controller adaptive --out firmware --cc clang",
        "mmnn embed track --controller pd --out firmware --single",
        "mmnn embed track --controller adaptive --out firmware --plant qemu",
        "mmnn embed track --controller two_layer --out firmware --processor stm32h743",
    ),
)
@click.argument("experiment", shell_complete=experiments)
@VARIANT
@ROBOT
@HARDWARE
@click.option(
    "--controller", metavar="NAME", required=True, shell_complete=controllers, help="The controller, see `mmnn list`."
)
@click.option("--out", type=PATH, required=True, help="Folder for the files.")
@click.option("--force", is_flag=True, help="Write into a folder that exists.")
@click.option(
    "--single", is_flag=True, help="Compute in 32 bits; the self-test says by how much results differ from Python's."
)
@click.option("--no-diagnostics", is_flag=True, help="Leave out what only reports how well the motion excites.")
@click.option("--steps", type=click.IntRange(1, 100_000), default=1000, help="Steps of the self-test.")
@click.option(
    "--limits",
    metavar="KEY=VALUE",
    multiple=True,
    help="A limit of the references, such as speed=0.5, joint_acceleration=[2, 2] or samples=exact; repeatable.",
)
@click.option("--cc", metavar="COMMAND", default="cc", help="Compiler for the self-test.")
@click.option("--no-check", is_flag=True, help="Write the files without compiling them.")
@click.option(
    "--memory", type=click.IntRange(1), metavar="KB", help="Largest memory of the controller.  [default: 512]"
)
@click.option(
    "--processor",
    metavar="NAME",
    help="A Cortex-M7, such as stm32h743: refuse a controller that takes longer than its period there, by instructions"
    " counted in QEMU.",
)
@click.option(
    "--plant",
    type=click.Choice(["host", "qemu"]),
    help="Close the loop, too: run the C as a process here, or on an emulated Cortex-M7, and compare with Python.",
)
@CHANGES
@understanding
@shared
def embed(
    experiment: str,
    variant: str | None,
    robot: str | None,
    hardware: str | None,
    controller: str,
    out: Path,
    force: bool,
    single: bool,
    no_diagnostics: bool,
    steps: int,
    limits: tuple[str, ...],
    cc: str,
    no_check: bool,
    plant: str | None,
    memory: int | None,
    processor: str | None,
    settings: tuple[str, ...],
    overrides: dict[str, Any],
    as_json: bool,
) -> int:
    """Write one controller of EXPERIMENT with its kinematic layer, motor limits and supervisor as C99 source.

    The source is translated from the Python functions that the loops run. Its self-test compares all torques and states
    with Python's bit for bit. The command compiles and runs it, and makes the folder only if it passes.
    """
    from ..deploy.embed import embed as export
    from ..deploy.embed.export import MEMORY, found_compiler, supervised
    from ..deploy.embed.files import TOLERANCE
    from ..deploy.embed.in_the_loop import compared, require_tools
    from ..lab.experiments.config import load_experiment
    from ..lab.experiments.hardware import Fitted

    within = limits_of(limits)
    changes = [
        *about_robot(robot, overrides),
        *settings,
        *in_toml(robot=robot, hardware=hardware, controllers=[controller]),
    ]
    found = load_experiment(experiment, changes, variant)
    with told_from_where(experiment, variant, found, changes):
        loaded = found.load_robot()
        loop = found.loop(loaded, found.controller(found.controllers[0], robot=loaded))
        units = {} if found.hardware is None else Fitted(found.hardware, loaded).units()
        if plant is not None:
            require_tools(plant)
        with found.in_its_keys():
            made = export(
                loop, out, force=force, single=single, diagnostics=not no_diagnostics, steps=steps,
                compiler=None if no_check else cc, memory=memory or MEMORY,
                limits=within, processor=processor or "", units=units,
            )  # fmt: skip
    tool = found_compiler(cc if plant == "host" else None)
    run = None if plant is None else compared(supervised(loop), out, plant, tool, steps, out / "run.h5", within)
    bits = f"within {TOLERANCE:g} of the largest torque of Python" if single else "with the bits of Python"
    said = "" if no_check else f"self-test passed: {made.selftest_steps} samples {bits}\n"
    said += "".join(f"{name}: {kind} = torque / {each:g}, by mmnn_motor_sent\n" for name, (kind, each) in units.items())
    more = ({} if run is None else {"in_the_loop": asdict(run)}) | ({"units": units} if units else {})
    answer(as_json, lambda: made.to_dict() | more, lambda: told(made, run, said))
    return DONE if run is None or not run.differences else FAILED


def limits_of(changes: tuple[str, ...]) -> Limits:
    """Limits of references, of `key=value` texts, values as in TOML; a bare word is a text.

    Raises:
        ConfigError: A key that does not exist, or a value that cannot be.
    """
    import msgspec

    from ..lab.experiments.config import override
    from ..reference.limits import Limits
    from ..settings.arguments import unknown_key, wrong_type

    table: dict[str, Any] = {}
    for change in changes:
        override(table, change)
    try:
        return msgspec.convert(table, Limits)
    except msgspec.ValidationError as error:
        if (unknown := unknown_key(error)) is not None:
            raise UnknownName("limit", unknown, Limits.__struct_fields__, key="--limits") from error
        name = str(error).rpartition("`$.")[2].rstrip("`").partition("[")[0]
        what, fix = wrong_type(error, table.get(name))
        raise ConfigError(what, fix=fix, key=f"--limits {name}") from error


def told(made: Embedded, run: RunComparison | None, checked: str) -> str:
    """The files that were written, for people, and how a run in the loop ended."""
    time = ""
    if made.share is not None:
        said = f"{made.instructions:,} instructions in the worst sample"
        time = f"{said}: {100 * made.share:.3g} % of the period of {made.processor}, at two cycles each\n"
    size = "" if made.code_bytes is None else f", {made.code_bytes / 1000:.1f} kB of code and constants"
    of = f" ({made.initial_bytes / 1000:.1f} kB of them initial values; {made.compiler})" if size else ""
    loop = ""
    if run is not None:
        same = f"differs in {', '.join(run.differences)}" if run.differences else "equals Python's, bit for bit"
        loop = f"in the loop ({run.where}): {run.samples} samples, {run.status}; the recording {same}\n"
    memory = f"{made.ram_bytes / 1000:.1f} kB of RAM{size}{of}\n"
    return f"{checked}{loop}{time}{memory}wrote {made.folder}: {', '.join(made.files)}"
