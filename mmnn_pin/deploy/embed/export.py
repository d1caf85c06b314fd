"""`mmnn embed`: from a loop to a folder of C99 whose self-test has been compiled and run."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ConfigError, MmnnError
from ...files import whole_folder
from ...loop.loop import Loop
from ...model.tree.body import body_of
from ...reference.limits import Limits
from ...safety import Safety
from ...settings.arguments import checked
from ...torque.controller import CompiledController
from .board import Fresh
from .files import Export, files_of, plain, readme, room, selftest, starts, translated
from .golden import answers, usual_events
from .in_the_loop import QEMU, require_tools
from .instructions import clock_of, counted, require_time

FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off", "-O2")
CORTEX_M7 = ("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard", "-ffunction-sections")
MEMORY = 512  # kB: the largest block of RAM of the usual Cortex-M7
LONGEST = 600.0  # time for the self-test [s]


@dataclass(frozen=True, repr=False)
class Embedded:
    """An exported controller."""

    controller: str  # its name
    robot: str  # name of the robot
    folder: str  # where the files are
    files: list[str]  # their names
    ram_bytes: int  # size of the controller's struct
    code_bytes: int | None  # code and constants, the initial values among them; None where nothing was compiled
    initial_bytes: int  # constants that are only the initial values of what is learned
    compiler: str  # what `code_bytes` is of
    selftest_steps: int  # samples of the self-test
    processor: str = ""  # the processor that was named; empty for none
    # of the worst sample of the self-test on a Cortex-M7; None where no processor was named
    instructions: int | None = None
    share: float | None = None  # share of the period that this sample takes there

    def __repr__(self) -> str:
        code = "" if self.code_bytes is None else f", {self.code_bytes} bytes of code and constants"
        return f"<Embedded: {self.controller} for {self.robot}{code}, {self.ram_bytes} of memory, in {self.folder}>"

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


@checked
def embed(  # noqa: PLR0913 - options, by keyword alone
    loop: Loop,
    folder: str | Path,
    *,
    force: bool = False,
    single: bool = False,
    diagnostics: bool = True,
    steps: int = 1000,
    compiler: str | None = "cc",
    memory: int = MEMORY,
    processor: str = "",
    limits: Limits = Limits(),  # noqa: B008 (frozen)
    units: Mapping[str, tuple[str, float]] = {},
) -> Embedded:
    """Write the controller of a loop, its kinematic layer and its supervisor as C99 source, and run its self-test.

    The supervisor is that of the loop, or one that holds the motors within the URDF's effort limits.

    Args:
        loop: Robot, controller, gains and supervisor; what it simulates beside is left out.
        folder: For the files.
        force: Write into a folder that exists.
        single: Numbers of 32 bits; the self-test then says how far the torques are off.
        diagnostics: Keep what only reports how well the motion excites (the Gram matrix of `adaptive`).
        steps: Samples of the self-test.
        compiler: With its flags, for the self-test; None writes the files alone.
        memory: Largest size of what the controller remembers [kB].
        processor: Name of a Cortex-M7 (`instructions.PROCESSORS`): the worst sample of the self-test, which is counted
            on an emulated board, has to fit into its period; empty for no count.
        limits: Of the references that it makes, and of the samples that it is handed.
        units: By motor that takes a "current" or "pwm": which, and the torque per unit [N m/A or N m]; the C has
            `mmnn_motor_sent` then.

    Raises:
        ConfigError: The controller is plain Python or too large, the plant has contacts, motors have no limits, the
            folder exists, there is no such compiler, the processor is too slow.
        Untranslatable: Something in the controller's functions cannot be said in C.
        MmnnError: The self-test fails.

    >>> robot = load("platform_arm")
    >>> loop = Loop(robot, Trajectory.of(robot, base=Line(speed=0.3)), PD())
    >>> made = embed(loop, "firmware", steps=20, compiler=None)
    >>> made.controller, "selftest.c" in made.files
    ('pd', True)
    """
    folder = Path(folder)
    require_embeddable(loop)
    require_new(folder, force)
    tool = found_compiler(compiler)
    if processor:
        clock_of(processor)
        require_tools(QEMU)
    stepper = Fresh.of(supervised(loop), limits=limits)
    require_limits(stepper)
    title = plain(f"{loop.controller.name} for {loop.robot.name}")
    export = translated(stepper, title, "float" if single else "double", diagnostics, units)
    require_small(export, memory)
    texts = files_of(export)
    events = usual_events(loop, stepper.period, steps)
    answered = answers(stepper, events, [m.live for m in export.remembered])
    texts["selftest.c"] = selftest(export, events, answered)
    texts["README.md"] = readme(export, steps, ram_bytes(export))
    with whole_folder(folder, "source", force) as made:
        for name, text in texts.items():
            (made / name).parent.mkdir(exist_ok=True)
            (made / name).write_text(text)
        code, of, count, share = None, "", None, None
        if tool:
            check(made, tool)
            code, of = size_of_code(made, tool)
        if processor:
            count = counted(made)
            share = require_time(count, export.stepper.period, processor)
    initial = sum(root.data.size * width(export, root.kind) for root in starts(export))
    return Embedded(
        loop.controller.name, loop.robot.name, str(folder), sorted(texts), ram_bytes(export), code, initial, of, steps,
        processor, None if count is None else count.worst, share,
    )  # fmt: skip


def supervised(loop: Loop) -> Loop:
    """A loop with its supervisor, or with one that holds the motors within the URDF's effort limits."""
    return replace(loop, safety=loop.safety or Safety(torque="urdf"))


def require_embeddable(loop: Loop) -> None:
    """Refuse what has no C.

    Raises:
        ConfigError: A controller in plain Python, a plant with contacts, measurements that are brought up to now.
        RobotError: A joint that cannot be flattened.
    """
    if not isinstance(loop.controller, CompiledController):
        why, fix = "it is plain Python", "use one of the package, or write its arithmetic as compiled functions"
        raise ConfigError(f"'{loop.controller.name}' cannot be written as C", why=why, fix=fix, key="controller")
    if loop.plant != "ideal":
        why = "the self-test follows the reference on wheels that roll"
        raise ConfigError(
            f"an experiment with the plant '{loop.plant}'", why=why, fix="use plant = 'ideal'", key="plant"
        )
    if loop.latency.predict and loop.latency.total > 0.0:
        why, fix = "the references of the past are kept in Python", "use --set latency.predict=false"
        raise ConfigError("measurements that are brought up to now", why=why, fix=fix, key="latency.predict")
    body_of(loop.robot)


def require_new(folder: Path, force: bool) -> None:
    """Refuse a folder that exists (`ConfigError`)."""
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder} is a file", fix="give a folder", key="out")
    if folder.exists() and not force:
        raise ConfigError(f"{folder} exists", fix="give another one, or --force to write into it", key="out")


def require_limits(stepper: Fresh) -> None:
    """Refuse a robot whose motors nothing limits (`ConfigError`)."""
    torque, robot = stepper.hardware.way.supervisor.torque, stepper.robot
    free = [name for name, limit in zip(robot.actuator_names, torque, strict=True) if not np.isfinite(limit)]
    if free:
        why = f"no effort limit of {', '.join(free)} is known"
        named = ", ".join(f"{limit:g}" if np.isfinite(limit) else "10" for limit in torque)
        fix = f"state <limit effort=...>, or put the motors' own limits for 10 in --set 'safety.torque=[{named}]'"
        raise ConfigError("motors that nothing limits", why=why, fix=fix, key="safety.torque")


def require_small(export: Export, memory: int) -> None:
    """Refuse a controller that does not fit a microcontroller (`ConfigError`)."""
    size = ram_bytes(export)
    if size > 1000 * memory:
        largest = sorted(export.members, key=lambda m: -m.data.size)[:3]
        parts = ", ".join(f"{m.name} {m.data.size * width(export, m.kind) / 1000:.0f} kB" for m in largest)
        why = f"it remembers {size / 1000:.0f} kB ({parts}), and {memory} kB is the limit"
        fix = "use another controller, fewer features, or --memory"
        raise ConfigError(f"{export.title} does not fit a microcontroller", why=why, fix=fix, key="controller")


def width(export: Export, kind: str) -> int:
    """Bytes of a number."""
    return 8 if kind == "real" and export.program.real == "double" else 4


def ram_bytes(export: Export) -> int:
    """Size of the controller's struct: what it remembers, and its room to work in."""
    size, ends = 0, 8 if export.program.real == "double" else 4
    for member in export.members:
        one = width(export, member.kind)
        size = -(-size // one) * one + room(member) * one
    return -(-size // ends) * ends


def found_compiler(compiler: str | None) -> list[str]:
    """The command of a compiler; empty for none.

    Raises:
        ConfigError: It is not there, or no command.
    """
    try:
        words = shlex.split(compiler or "")
    except ValueError as error:
        raise ConfigError(f"no command {compiler!r}", why=str(error), fix="close its quotes", key="cc") from error
    if words and shutil.which(words[0]) is None:
        fix = "install gcc or clang, name another with --cc, or give --no-check to write the files alone"
        raise ConfigError(f"no compiler '{words[0]}'", why="the self-test is to be run", fix=fix, key="cc")
    return [os.path.abspath(words[0]), *words[1:]] if words and os.sep in words[0] else words


def check(folder: Path, compiler: list[str]) -> str:
    """Compile the self-test of a folder and run it; what it prints.

    Raises:
        MmnnError: It does not compile, or a sample differs from Python.
    """
    with tempfile.TemporaryDirectory() as made:
        program = Path(made) / "selftest"
        sources = [file.name for file in sorted(folder.glob("*.c"))]
        run([*compiler, *FLAGS, *sources, "-o", str(program)], folder, "the export does not compile")
        return run([str(program)], folder, "the self-test of the export fails")


def run(command: list[str], folder: Path, what: str) -> str:
    """Run a command in a folder of ours, as linkers look for libraries where they are started; what it prints.

    Raises:
        MmnnError: It fails.
    """
    done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST, cwd=folder)
    if done.returncode:
        said = (done.stdout + done.stderr).strip().splitlines()
        raise MmnnError(f"{what}: {' '.join(said[:3]) or f'exit status {done.returncode}'}")
    return done.stdout


def size_of_code(folder: Path, compiler: list[str]) -> tuple[int | None, str]:
    """Code and constants: on a Cortex-M7 where there is a compiler for it, else on this machine; and which it is."""
    is_board = shutil.which("arm-none-eabi-gcc") is not None
    tool = ["arm-none-eabi-gcc", *CORTEX_M7] if is_board else compiler
    measure = "arm-none-eabi-size" if is_board else "size"
    if shutil.which(measure) is None:
        return None, ""
    total = 0
    with tempfile.TemporaryDirectory() as made:
        for name in ("controller", "robot_law", "mmnn_math"):
            made_of = str(Path(made) / f"{name}.o")
            run([*tool, *FLAGS, "-c", f"{name}.c", "-o", made_of], folder, "the export does not compile")
            total += int(run([measure, made_of], folder, "no size").splitlines()[1].split()[0])
    return total, "arm-none-eabi-gcc -O2, Cortex-M7" if is_board else f"{compiler[0]} -O2, this machine"
