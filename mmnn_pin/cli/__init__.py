"""The command line: parsing, exit codes, one line per problem. A module for each of their subjects.

Exit codes: 0 done, 1 a run failed or diverged (its recording says where), 2 bad input, 130 stopped by Ctrl-C (what was
recorded is kept). Whatever is slow to import is imported inside the commands.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import click

from .. import __version__
from ..errors import InputError, MmnnError, UnknownName, printable
from ..files import reason, way_out
from ..program import heard, is_interruption
from .docs import docs
from .embed import embed
from .identify import excite, identify
from .options import examples
from .output import BAD_INPUT, DONE, FAILED, STOPPED, answer, note, say
from .results import export, judge, plot, replay, report
from .robot import check, inspect, model, view
from .ros2 import ros2
from .run import list_, readings, run
from .study import study, tune
from .warm import warm

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

for _library in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_library, "1")  # see `compiled`; read when numpy is imported


def beside() -> EntryPoints:
    """Commands that are installed beside the package."""
    from importlib.metadata import entry_points

    return entry_points(group="mmnn_pin.commands")


class CommandGroup(click.Group):
    """The commands by name."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands, also of those that are installed beside the package."""
        return sorted({*self.commands, *beside().names})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """A command, or what an installed one says of itself.

        Raises:
            UnknownName: There is none of that name.
        """
        if cmd_name in self.commands:
            return self.commands[cmd_name]
        if cmd_name in (there := beside()).names:
            command: click.Command = there[cmd_name].load()
            return command
        if ctx.resilient_parsing:  # a shell completes
            return None
        raise UnknownName("command", cmd_name, [*self.commands, *there.names])


def tell_version(context: click.Context, _: click.Parameter, asked: bool) -> None:
    """Print the version with its commit."""
    if asked and not context.resilient_parsing:
        from ..recording.versions import versions

        commit = versions().get("commit", "")
        say(f"mmnn, version {__version__}" + (f" (commit {commit})" if commit else ""))
        context.exit()


@click.group(
    cls=CommandGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100, "show_default": True},
    epilog=examples(
        "mmnn inspect my_robot.urdf                      what the file says, and what is wrong with it",
        "mmnn run track --robot my_robot.urdf            drive it along an eight, with six controllers",
        "mmnn run track --robot my_robot.urdf --set time.duration=2     the same, 2 s long",
        "mmnn replay runs/track                          watch the runs in the browser",
        "mmnn report runs/track --html track.html        one page: verdict, numbers, plots",
        "mmnn list                                       all experiments, robots and controllers",
        "mmnn docs                                       the pages of the documentation, here",
    ),
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=tell_version,
    help="Show the version, and its commit where that is known, and exit.",
)
@click.pass_context
def mmnn(context: click.Context) -> None:
    """Torque control for mobile manipulators: read a URDF, compare controllers in simulation, take one to the robot.

    To let the shell complete names and keys: eval "$(_MMNN_COMPLETE=bash_source mmnn)" (or zsh_source, fish_source).

    Every command takes --json, --debug and --help. Exit codes: 0 done, 1 a run failed or diverged, 2 bad input,
    130 stopped by Ctrl-C.
    """
    if context.invoked_subcommand is None:
        say(context.get_help())


JUDGING = (run, study, tune, readings, model, plot, judge, replay, report, export, list_, warm, docs)
ROBOTS = (inspect, view, check)
DEPLOYING = (ros2, embed, identify, excite)
for command in (*JUDGING, *ROBOTS, *DEPLOYING):
    mmnn.add_command(command)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: What follows the program's name; None takes it from the system.

    Returns:
        The exit code.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    open_closed()
    if arguments is None and given[:1] == ["inspect"]:  # a process of its own, over before a compiler has begun
        os.environ.setdefault("NUMBA_DISABLE_JIT", "1")
    with heard():
        return ended(given)


def open_closed() -> None:
    """Let what is printed go nowhere where somebody has closed standard output or error."""
    for number, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            if nowhere != number:
                os.dup2(nowhere, number)
                os.close(nowhere)
            setattr(sys, name, os.fdopen(number, "w", closefd=False))


def ended(given: Sequence[str]) -> int:
    """The exit code of a command."""
    try:
        return int(mmnn.main(given, prog_name="mmnn", standalone_mode=False) or DONE)
    except (click.Abort, KeyboardInterrupt):
        return complain(STOPPED, InputError("stopped by Ctrl-C"), given)
    except click.ClickException as error:
        return complain(BAD_INPUT, usage_error(error), given)
    except InputError as error:
        return complain(BAD_INPUT, error, given)
    except MmnnError as error:
        return complain(FAILED, InputError(str(error)), given)
    except MemoryError as error:
        fix = "use a shorter duration, longer periods or fewer hidden units"
        return complain(BAD_INPUT, InputError("not enough memory", why=str(error), fix=fix), given)
    except OSError as error:
        if fix := way_out(error):  # a disk that is full, a place that is closed, a name that no file can have
            found = InputError("cannot be used", why=reason(error), fix=fix, file=error.filename)
            return complain(BAD_INPUT, found, given)
        return complain(FAILED, unexpected(error), given)
    except Exception as error:
        if is_interruption(error):
            return complain(STOPPED, InputError("stopped by Ctrl-C"), given)
        return complain(FAILED, unexpected(error), given)


def unexpected(error: Exception) -> InputError:
    """A fault of ours."""
    why = f"{type(error).__name__}: {error}"
    return InputError("internal error", why=why, fix="run it again with --debug and report what it prints")


def usage_error(error: click.ClickException) -> InputError:
    """The complaint of click in our form."""
    context = getattr(error, "ctx", None)
    if context and isinstance(error, click.NoSuchOption):
        if error.option_name.lstrip("-") in [
            one.name for one in context.command.params if isinstance(one, click.Argument)
        ]:
            fix = f"leave it out: {context.command_path} {error.option_name.lstrip('-').upper()}"
            return InputError(f"unknown option '{error.option_name}'", why="what follows stands alone here", fix=fix)
        options = [name for parameter in context.command.params for name in parameter.opts if name.startswith("--")]
        return UnknownName("option", error.option_name, [*options, "--help"])
    what = error.format_message().rstrip(".")
    return InputError(what, fix=f"see '{context.command_path} --help'" if context else "")


def complain(code: int, error: InputError, given: Sequence[str]) -> int:
    """One line on standard error; with --debug the traceback, with --json one object on standard output."""
    if "--debug" in given:
        traceback.print_exc()
    problems = [str(problem) for problem in getattr(error, "errors", None) or [error]]  # an audit has several
    with suppress(OSError):
        note("\n".join(printable(" ".join(problem.split())) for problem in problems))
    if "--json" in given:
        fields = {name: getattr(error, name) for name in ("what", "why", "fix", "line", "key")}
        file = None if error.file is None else str(error.file)
        with suppress(InputError):  # where nothing can be written, the exit code says it
            answer(True, lambda: {"error": fields | {"file": file}, "errors": problems}, str)
    return code
