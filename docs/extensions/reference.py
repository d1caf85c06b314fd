"""The reference, written from the code whenever the site is built: names, TOML keys, signals, commands, findings."""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

import click
import msgspec
from sphinx.application import Sphinx

import mmnn_pin
from mmnn_pin.settings.meanings import meanings

FOLDER = "reference"
WIDTH = 60  # of a default that a table shows in full


# -- what several pages need ------------------------------------------------------------------------------------------


def about(thing: Any) -> str:
    """What a docstring says before its sections."""
    return re.split(r"^(?:Args|Attributes|Raises|Returns|Yields):$", inspect.getdoc(thing) or "", flags=re.M)[0].strip()


def cell(text: str) -> str:
    """Text of a table's cell."""
    return " ".join(text.split()).replace("|", r"\|")


def table(heads: tuple[str, ...], rows: Iterator[tuple[str, ...]] | list[tuple[str, ...]]) -> str:
    """A table of Markdown."""
    lines = [heads, tuple("---" for _ in heads), *rows]
    return "\n".join(f"| {' | '.join(map(cell, line))} |" for line in lines) + "\n"


# -- TOML -------------------------------------------------------------------------------------------------------------


def type_text(kind: Any) -> str:
    """A type as a user of TOML thinks of it."""
    plain = {float: "number", int: "whole number", str: "text", bool: "true or false", Any: "any", type(None): "unset"}
    if kind in plain:
        return plain[kind]
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Literal:
        return ", ".join(f'"{value}"' if isinstance(value, str) else str(value) for value in inner)
    if origin in (Union, types.UnionType):
        names = [type_text(each) for each in inner if each is not type(None)]
        return " or ".join(dict.fromkeys(names))
    if origin is tuple:
        if len(inner) == 2 and inner[1] is Ellipsis:
            return f"list of {type_text(inner[0])}"
        return f"list of {len(inner)}: {', '.join(dict.fromkeys(map(type_text, inner)))}"
    if origin is list:
        return f"list of {type_text(inner[0])}"
    if origin in (dict, Mapping) or kind is dict:
        return f"table of {type_text(inner[1])}" if inner else "table"
    return "table" if isinstance(kind, type) and issubclass(kind, msgspec.Struct) else getattr(kind, "__name__", "any")


def default_text(field: msgspec.structs.FieldInfo) -> str:
    """The default of a key; empty for one that must be given."""
    if field.required:
        return "*required*"
    if field.default is msgspec.NODEFAULT:
        value = field.default_factory() if callable(field.default_factory) else None
        return "" if isinstance(value, msgspec.Struct) or not value else f"`{value}`"
    value = field.default
    if isinstance(value, msgspec.Struct) or value is None:
        return ""
    text = (
        "[]" if value == () else {True: "true", False: "false"}.get(value) if isinstance(value, bool) else repr(value)
    )
    text = str(text).replace("'", '"').replace("(", "[").replace(",)", "]").replace(")", "]")
    return f"`{text}`" if len(text) <= WIDTH else "several"


def tables_in(kind: Any) -> list[type[msgspec.Struct]]:
    """The structs that a type holds, however deep in unions, lists and tables of names."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return [kind]
    return [struct for part in get_args(kind) for struct in tables_in(part)]


def repeated(kind: Any) -> str:
    """How the path of a key goes on: `[]` in a list of tables, `.NAME` in a table of names."""
    for part in (kind, *get_args(kind)):
        if get_origin(part) is tuple and tables_in(part):
            return "[]"
        if get_origin(part) is dict and tables_in(part):
            return ".NAME"
    return ""


def keys(kind: type[msgspec.Struct], path: str, shown: dict[type, str]) -> Iterator[str]:
    """The keys of a table and, after them, those of the tables in it that were not shown before."""
    known, fields = meanings(kind), msgspec.structs.fields(kind)
    shown[kind] = path
    tag = kind.__struct_config__.tag
    label = f"`[{path}]`" if path else "Keys of the file"
    if path.endswith("[]"):
        label = f"`[[{path.removesuffix('[]')}]]`"
    yield f"## {label}{f' of type `{tag}`' if tag else ''}\n"
    yield about(kind) + "\n" if path and kind.__doc__ else ""
    yield table(
        ("key", "type", "default", "meaning"),
        [(f"`{f.encode_name}`", type_text(f.type), default_text(f), meaning(f, known, shown)) for f in fields],
    )
    for field in fields:
        for inner in tables_in(field.type):
            if inner not in shown:
                yield from keys(inner, f"{path}.{field.encode_name}".lstrip(".") + repeated(field.type), shown)


def meaning(field: msgspec.structs.FieldInfo, known: Mapping[str, str], shown: Mapping[type, str]) -> str:
    """What a key means: what its table says, else what the tables that it holds say of themselves."""
    inner = tables_in(field.type)
    text = known.get(field.name) or " ".join(about(each).partition("\n\n")[0] for each in inner)
    before = [f"`[{shown[each]}]`" for each in inner if shown.get(each)]
    return f"{text} Keys as in {', '.join(before)}." if before else text


def pieces(title: str, kinds: Mapping[str, Any], path: str) -> Iterator[str]:
    """The types of a table that is chosen by its key `type`."""
    yield f"## {title}\n"
    for name, kind in kinds.items():
        known, parameters = meanings(kind), inspect.signature(kind).parameters.values()
        yield f'### `{path} = {{ type = "{name}", ... }}`\n'
        yield about(kind) + "\n"
        rows = [
            (f"`{p.name}`", "*required*" if p.default is p.empty else f"`{p.default}`", known.get(p.name, ""))
            for p in parameters
        ]
        if rows:
            yield table(("key", "default", "meaning"), rows)


def experiment_page() -> Iterator[str]:
    """Keys of an experiment."""
    from mmnn_pin.lab.experiments.experiment import Experiment

    yield "# Keys of an experiment\n"
    yield "An experiment is a TOML file with these keys; `mmnn run FILE.toml --set key.path=value` changes one.\n"
    yield from keys(Experiment, "", {})


def paths_page() -> Iterator[str]:
    """Types of references."""
    from mmnn_pin.lab.experiments.references import ARM_PROFILES, BASE_PATHS, HAND_PATHS

    yield "# Paths and profiles\n"
    yield "What `type` may be in `[reference.base]`, `[[reference.arm]]` and `[reference.hand]`, with its arguments.\n"
    yield from pieces("Paths of the base", BASE_PATHS, "reference.base")
    yield from pieces("Profiles of a joint", ARM_PROFILES, "reference.arm")
    yield from pieces("Pieces of the hand's path", HAND_PATHS, "reference.hand.path")


def file_page(title: str, text: str, place: str) -> Callable[[], Iterator[str]]:
    """Keys of another kind of file."""

    def page() -> Iterator[str]:
        module, name = place.split(":")
        yield f"# {title}\n"
        yield text + "\n"
        yield from keys(getattr(import_module(f"mmnn_pin.{module}"), name), "", {})

    return page


# -- names, signals, commands, controllers, findings ------------------------------------------------------------------

FLOORS = {
    "model": "Robots",
    "reference": "References",
    "kinematic": "Controllers",
    "torque": "Controllers",
    "signals": "The loop",
    "settings": "The loop",
    "loop": "The loop",
    "recording": "The loop",
    "deploy": "Identification and export",
    "lab": "Experiments",
    "errors": "Errors",
}
MORE = {  # what is needed now and then, from its own module
    "reference": ("Circle", "Eight", "Waypoints", "BaseTable", "Timed", "Smoothed", "Hold", "Sines", "MinimumJerk"),
    "reference.limits": ("Limits",),
    "reference.wishes": ("HOLD", "BaseVelocity", "JointSample", "JointGoal", "Motion"),
    "reference.hand": (
        *("Capsule", "FollowHand", "HandCircle", "HandLine", "HandMotion", "HandSpline", "HandWish", "Pieces", "Task"),
        *("Wait", "WholeBody", "WholeBodySettings"),
    ),
    "model.dynamics": ("Dynamics",),
    "model.regressor": ("Regressor",),
    "torque.controller": ("Context", "ControllerState"),
    "torque.learning_law": ("Sample",),
    "torque.model_based": ("ComputedTorque",),
    "torque.adaptive": ("Adaptive", "AdaptiveSettings"),
    "actuator": ("Actuator",),
    "disturbance": ("Payload", "Push"),
    "safety": ("Safety",),
    "touch": ("Touch",),
    "sensing": ("Sensor",),
    "loop.servo": ("Command",),
    "loop.before_run": ("Bounds", "Start"),
    "loop.batch": ("BatchRun", "simulate_many"),
    "recording.recording": ("Outcome",),
    "deploy.identify.log": ("Log",),
    "deploy.identify.excitation": ("excite",),
    "deploy.identify.payload": ("payload",),
    "errors": ("MmnnError",),
}


def documented(module: str, name: str) -> str:
    """The directive for a name of a module."""
    thing = getattr(import_module(module), name)
    kind = "autoclass" if inspect.isclass(thing) else "autofunction" if callable(thing) else "autodata"
    return f"### {name}\n\n```{{eval-rst}}\n.. {kind}:: {module}.{name}\n```\n"


def api_page() -> Iterator[str]:
    """The public names."""
    groups: dict[str, list[str]] = {title: [] for title in FLOORS.values()}
    for name in mmnn_pin.__all__:
        floor = getattr(mmnn_pin, name).__module__.split(".")[1]
        groups[FLOORS[floor]].append(name)
    yield "# Python\n"
    yield "All that `from mmnn_pin import ...` has. Units are SI, angles in radians; shapes are those of one sample."
    yield "[What is needed now and then](python-more.md) is imported from its own module.\n"
    for title, names in groups.items():
        yield f"## {title}\n"
        yield from (documented("mmnn_pin", name) for name in names)


def more_page() -> Iterator[str]:
    """Names that are imported from their modules."""
    yield "# Python, by module\n"
    yield "What [the public face](python.md) leaves out: `from mmnn_pin.reference.wishes import BaseVelocity`.\n"
    for module, names in MORE.items():
        yield f"## mmnn_pin.{module}\n"
        own = [name for name in names if name not in mmnn_pin.__all__]
        yield from (documented(f"mmnn_pin.{module}", name) for name in own)


def signals_page() -> Iterator[str]:
    """The signals of a recording."""
    from mmnn_pin.cli.signal_meanings import MEANINGS
    from mmnn_pin.signals import SIGNALS

    sizes = {
        "pose": "3",
        "base": "nb",
        "shape": "K",
        "arm": "n",
        "all": "nb + n",
        "full": "nv",
        "motor": "motors",
        "wheel": "drive wheels",
        "floor": "1",
        "rig": "1",
        "rig motor": "motors",
        "rig all": "nb + n",
        "lead all": "nb + n",
        "hand": "7 a frame",
    }
    yield "# Signals\n"
    yield (
        "A recording has one row per control sample: `Recording.open(path)[name]` is an array (samples, size), and"
        " `Recording.time` the times. nb is the number of base velocities (2 for a differential drive, 3 for a"
        " holonomic base, 0 for a fixed arm, `[u; steering rates]` for a base that steers), n the number of arm joints,"
        " nv the number of velocities of the full model, K the number of pivots of a base that steers. A twist is"
        " `(v, w)`, or `(vx, vy, w)` of a base that moves sideways. Where a signal has a base and an arm part, the"
        " units are in that order.\n"
    )
    yield table(
        ("signal", "size", "unit", "meaning"),
        [
            (f"`{name}`", sizes.get(size, size), "; ".join(filter(None, (base, arm))), MEANINGS[name])
            for name, size, base, arm in SIGNALS
        ],
    )
    yield "\nSignals of wheels and floor are there on the contact plant, `applied`, `disturbance` and `safety` only"
    yield "where motors, disturbances or a supervisor are simulated.\n"


def command_page() -> Iterator[str]:
    """The commands, from the parser."""
    from mmnn_pin.cli import mmnn

    yield "# Command line\n"
    yield about(mmnn.callback) + "\n" if mmnn.callback else ""
    for name, command in mmnn.commands.items():
        context = click.Context(command, info_name=f"mmnn {name}")
        usage = command.get_usage(context).removeprefix("Usage: ")
        yield f"## mmnn {name}\n"
        yield f"```text\n{inspect.cleandoc(usage)}\n```\n"
        yield paragraphs(command.help or "") + "\n"
        rows = [
            (f"`{', '.join(p.opts)}{' ' + p.make_metavar(context) if not p.is_flag else ''}`", p.help or "")
            for p in command.params
            if isinstance(p, click.Option)
        ]
        yield table(("option", "meaning"), rows)
        if command.epilog:
            yield f"```text\n{inspect.cleandoc(command.epilog.split('Examples:')[-1].strip(chr(10)))}\n```\n"


def paragraphs(text: str) -> str:
    """Help of a command: blocks that click keeps as they are become blocks here."""
    parts = re.split(r"\n\n", inspect.cleandoc(text).replace("\f", ""))
    return "\n\n".join(
        f"```text\n{part.removeprefix(chr(8)).strip(chr(10))}\n```" if part.startswith("\b") else part for part in parts
    )


def controllers_page() -> Iterator[str]:
    """The controllers, from their list."""
    from mmnn_pin.torque.entries import ENTRIES

    yield "# Controllers\n"
    yield (
        "Names for `--controller` and for `controllers = [...]` in an experiment. A controller gets what its kind of"
        " law needs to know of the robot, and nothing else; the last column names the table of its settings.\n"
    )
    words = {"motion": "how it moves", "machine": "its motors", "nominal": "a model with wrong masses"}
    words |= {"parameters": "parameters to start from", "described": "the URDF's model"}
    rows = []
    for entry in ENTRIES:
        told = "the true model" if entry.oracle else ", ".join(words[each] for each in entry.told) or "nothing"
        rows.append((f"`{entry.name}`", entry.about, told, f"`[{entry.key}]`" if entry.settings else ""))
    yield table(("controller", "what it is", "knows of the robot", "settings"), rows)


FILES = {
    "python": api_page,
    "python-more": more_page,
    "experiment-keys": experiment_page,
    "paths": paths_page,
    "study-keys": file_page(
        "Keys of a study", "The file of `mmnn study` and `mmnn tune`.", "lab.study.settings:StudySettings"
    ),
    "robot-keys": file_page(
        "Keys of NAME.mmnn.toml",
        "What you say about a robot, in a file beside its URDF or in the `[overrides]` of an experiment.",
        "model.base.overrides:Overrides",
    ),
    "ros2-keys": file_page("Parameters of the ROS 2 node", "Parameters of `mmnn ros2`.", "deploy.ros2.settings:Node"),
    "signals": signals_page,
    "commands": command_page,
    "controllers": controllers_page,
}


def write(app: Sphinx) -> None:
    """Write the pages; one that has not changed is left as it is, so that Sphinx does not read it again."""
    for name, page in FILES.items():
        file = Path(app.srcdir) / FOLDER / f"{name}.md"
        text = "\n".join(part for part in page() if part)
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


def as_rst(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Docstrings as reStructuredText: bars are no substitutions, an indented block is code."""
    for i, line in enumerate(lines):
        parts = re.split(r"(``.*?``|`[^`]*`)", line)
        lines[i] = "".join(part if part.startswith("`") else part.replace("|", r"\|") for part in parts)
        lines[i] = re.sub(r"(`[^`]+`)(?=\w)", r"\1\\ ", lines[i])
    for i in range(len(lines) - 2, 0, -1):
        before, after = lines[i - 1], lines[i + 1]
        if not lines[i].strip() and after.startswith("    ") and re.match(r"[^ :.]", before):
            lines[i:i] = ["", "::"]


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before any is read."""
    app.connect("builder-inited", write)
    app.connect("autodoc-process-docstring", as_rst, priority=600)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
