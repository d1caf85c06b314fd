"""`mmnn docs`: the pages of the documentation and what keys and names mean, where no site is at hand."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import click
import msgspec
from click.shell_completion import CompletionItem

from ..errors import UnknownName
from .options import PACKAGE, examples, shared, starting
from .output import DONE, answer, columns

FOLDERS = (PACKAGE / "docs", PACKAGE.parent / "docs")  # of a wheel, of a clone
FREE = {"reference.base": "BASE_PATHS", "reference.arm": "ARM_PROFILES", "reference.hand.path": "HAND_PATHS"}


def pages() -> dict[str, Path]:
    """Pages by name, such as `how-to/studies`; where the site was built, its page of what `LISTED` has is none."""
    folder = next((folder for folder in FOLDERS if (folder / "how-to").is_dir()), FOLDERS[0])
    found = {file.relative_to(folder).with_suffix("").as_posix(): file for file in sorted(folder.glob("*/*.md"))}
    return {name: file for name, file in found.items() if name not in LISTED}


def title(page: Path) -> str:
    """The heading of a page."""
    return page.read_text("utf-8").partition("\n")[0].lstrip("# ")


# -- keys of an experiment ---------------------------------------------------------------------------------------------


def first_line(thing: Any) -> str:
    """The first line of a thing's docstring."""
    return (inspect.getdoc(thing) or "").partition("\n")[0]


def meaning(key: str) -> str:
    """The meaning of an experiment's key, as its class says it, and its subkeys; empty for one that there is not."""
    from ..lab.experiments.config import keys_of, kind_at
    from ..settings.meanings import meanings

    above, _, name = key.rpartition(".")
    kind = kind_at(above or None)
    if name not in keys_of(kind):
        return ""
    said = meanings(kind).get(name) or first_line(kind_at(key)) or "a table"
    return "\n".join([f"{key}: {said}", *subkeys(key, kind_at(key))])


def siblings(key: str) -> list[str]:
    """The keys of the table that a key with a point would stand in."""
    from ..lab.experiments.config import keys_of, kind_at

    above = key.rpartition(".")[0]
    return [f"{above}.{name}" for name in keys_of(kind_at(above))] if above else []


def subkeys(key: str, kind: Any) -> Iterator[str]:
    """The keys of a table with defaults and meanings, a line each; of tables with a `type`, type by type."""
    from ..lab.experiments import references

    if key in FREE:
        for name, one in getattr(references, FREE[key]).items():
            fields = inspect.signature(one).parameters.values()
            defaults = {p.name: "required" if p.default is p.empty else f"default: {shown(p.default)}" for p in fields}
            yield from table_lines(f'type = "{name}"', one, defaults)
        return
    for one in tables_in(kind):
        tag = one.__struct_config__.tag
        heading = f'type = "{tag}"' if tag else f"keys of {key}"
        yield from table_lines(heading, one, {f.encode_name: default_of(f) for f in msgspec.structs.fields(one)})


def table_lines(heading: str, kind: Any, defaults: dict[str, str]) -> Iterator[str]:
    """A heading and the keys of a kind of table, each with its default and its meaning."""
    from ..lab.show.table import hanging
    from ..settings.meanings import meanings

    said, width = meanings(kind), max(map(len, defaults), default=0)
    what = f": {first_line(kind)}" if heading.startswith("type") else ""
    yield "\n" + hanging("", heading + what, columns())
    for name, default in defaults.items():
        yield hanging(f"  {name:{width}}  ", f"{said.get(name, '')} [{default}]".lstrip(), columns())


def default_of(field: msgspec.structs.FieldInfo) -> str:
    """The default of a key in words."""
    if field.required:
        return "required"
    made = field.default_factory() if callable(field.default_factory) else field.default
    return "a table" if isinstance(made, msgspec.Struct) else f"default: {shown(made)}"


def shown(value: Any) -> str:
    """A value as TOML has it, in short."""
    if value is None:
        return "unset"
    text = str(value).lower() if isinstance(value, bool) else repr(list(value) if isinstance(value, tuple) else value)
    return text.replace("'", '"') if len(text) <= 60 else "several"


def tables_in(kind: Any) -> list[type[msgspec.Struct]]:
    """The structs that a type holds, however deep in unions, lists and tables of names."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return [kind]
    return [struct for part in get_args(kind) for struct in tables_in(part)]


# -- names of Python, and what is listed from the code -----------------------------------------------------------------


def public(name: str) -> str:
    """The signature and the docstring of a public name of any module, or of a method; empty for one that there is not.

    `Loop`, `mmnn_pin.loop.loop.Loop`, `Loop.run`; where several modules have one of that name, all are shown.
    """
    path, _, last = name.removeprefix("mmnn_pin.").rpartition(".")
    things = defined(last, path)
    if not things and path and not last.startswith("_"):
        module, _, owner = path.rpartition(".")
        things = [getattr(thing, last) for thing in defined(owner, module) if hasattr(thing, last)]
    return "\n\n".join(described(name, thing) for thing in things)


def defined(name: str, module: str = "") -> list[Any]:
    """Classes and functions of a public name, of a module or of any."""
    import importlib

    import mmnn_pin

    if not re.fullmatch(r"[A-Za-z]\w*", name):
        return []
    if not module and name in mmnn_pin.__all__:
        return [getattr(mmnn_pin, name)]
    found, stated = [], re.compile(rf"^(?:class|def) {name}\b", re.M)
    for file in sorted(PACKAGE.rglob("*.py")):
        parts = file.relative_to(PACKAGE).with_suffix("").parts
        dotted = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        if (not module or dotted == module or dotted.startswith(f"{module}.")) and stated.search(
            file.read_text("utf-8")
        ):
            found.append(getattr(importlib.import_module(f"mmnn_pin.{dotted}"), name))
    return found


def described(name: str, thing: Any) -> str:
    """A name with its signature, where it is from, its docstring, and what stands beside the fields of a class."""
    from ..settings.meanings import BESIDE, source_of

    try:
        signature = str(inspect.signature(thing))
    except (TypeError, ValueError):
        signature = ""
    text = inspect.getdoc(thing.fget if isinstance(thing, property) else thing) or ""
    where = getattr(thing, "__module__", None)
    fields = [hit[0] for hit in BESIDE.finditer(source_of(thing))] if inspect.isclass(thing) else []
    return f"{name}{signature}\n" + (f"of {where}\n" if where else "") + "\n".join(["", text, "", *fields]).rstrip()


def python_names() -> dict[str, str]:
    """The names that `from mmnn_pin import ...` has."""
    import mmnn_pin

    return {name: first_line(getattr(mmnn_pin, name)) for name in mmnn_pin.__all__ if not name.startswith("_")}


def commands() -> dict[str, str]:
    """The commands."""
    every = click.get_current_context().find_root().command
    assert isinstance(every, click.Group)
    return {f"mmnn {name}": command.get_short_help_str(100) for name, command in every.commands.items()}


def controllers() -> dict[str, str]:
    """The controllers."""
    from ..torque.entries import CONTROLLERS

    return {name: entry.about for name, entry in CONTROLLERS.items()}


def keys_of_kind(kind: Any) -> dict[str, str]:
    """Keys of a kind of file."""
    from ..settings.meanings import meanings

    said = meanings(kind)
    return {f.encode_name: said.get(f.encode_name, first_line(f.type)) for f in msgspec.structs.fields(kind)}


def kinds() -> dict[str, Any]:
    """The files that a user writes, by name, with what reads them."""
    from ..deploy.ros2.settings import Node
    from ..lab.experiments.experiment import Experiment
    from ..lab.experiments.hardware_table import HardwareTable
    from ..lab.study.settings import StudySettings
    from ..model.base.overrides import Overrides

    return {
        "experiment": Experiment,
        "study": StudySettings,
        "hardware": HardwareTable,
        "robot": Overrides,
        "ros2": Node,
    }


def schema(name: str) -> dict[str, Any]:
    """The JSON schema of a kind of file, with meanings; no key is required, for a file may start from another one."""
    kind, narrow = kinds()[name], narrower()
    found = msgspec.json.schema(kind)
    without_defaults(found)
    for part in every_struct(kind, {}).values():
        if table := found["$defs"].get(part.__name__):
            table["properties"] |= narrow.get(part.__name__, {})
            complete_table(table, part)
    if name == "experiment":
        own = {"type": "string", "description": "Another experiment, on top of which this file says what differs."}
        found["$defs"][kind.__name__]["properties"]["experiment"] = own
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"mmnn_pin: {name}", **found}


def narrower() -> dict[str, dict[str, Any]]:
    """Struct to key to schema of what the types of Python say too little of: tables with a `type`, names, files."""
    from ..lab.experiments import references as r
    from ..lab.show.gallery import PICTURES
    from ..loop.loop import PLANTS
    from ..loop.servo import EFFORT, POSITION, VELOCITY
    from ..model.base import KINDS
    from ..model.base.overrides import ARMS, FORWARD

    interfaces = {"type": "object", "additionalProperties": {"enum": [EFFORT, VELOCITY, POSITION]}}
    profile, hand = one_of(r.ARM_PROFILES), {"type": "array", "items": one_of(r.HAND_PATHS)}
    arm = {"anyOf": [{"type": "array", "items": profile}, one_of({"swing": r.Swing, **r.ARM_PROFILES})]}
    reference = {"base": one_of(r.BASE_PATHS), "heading": profile, "arm": arm}
    hardware = {"anyOf": [{"$ref": "#/$defs/HardwareTable"}, {"type": "string"}]}
    plots = {"type": "array", "items": {"enum": [*PICTURES]}}
    return {
        "Experiment": {"plant": {"enum": [*PLANTS]}, "plots": plots, "interfaces": interfaces, "hardware": hardware},
        "Overrides": {key: {"enum": [*known]} for key, known in (("base", KINDS), ("arm", ARMS), ("forward", FORWARD))},
        "ReferenceTables": reference,
        "HeldOutReference": reference,
        "HandTables": {"path": hand},
        "Other": {"path": hand},
    }


def one_of(kinds: dict[str, Any]) -> dict[str, Any]:
    """The schema of a table that is of one of some kinds; `type` says which, or another file from which it starts."""
    tables = []
    for name, kind in kinds.items():
        table = msgspec.json.schema(kind)["$defs"][kind.__name__]
        without_defaults(table)
        complete_table(table, kind)
        table["properties"]["type"] = {"enum": [name]}
        tables.append(table | {"additionalProperties": False})
    return {"anyOf": tables}


def complete_table(table: dict[str, Any], kind: type) -> None:
    """Give the schema of a table the meanings of its keys, and let none be required."""
    from ..settings.meanings import meanings

    table.pop("required", None)
    for key, text in meanings(kind).items():
        if key in table["properties"]:
            table["properties"][key] = table["properties"][key] | {"description": text}


def without_defaults(part: Any) -> None:
    """Take the defaults out of a schema: JSON has no inf."""
    if isinstance(part, dict):
        if not isinstance(part.get("default"), dict):  # a key of that name is a table
            part.pop("default", None)
        for inner in part.values():
            without_defaults(inner)
    elif isinstance(part, list):
        for inner in part:
            without_defaults(inner)


def every_struct(kind: Any, found: dict[str, Any]) -> dict[str, Any]:
    """A struct and all that its fields hold, by name."""
    for one in tables_in(kind):
        if one.__name__ not in found:
            found[one.__name__] = one
            for field in msgspec.structs.fields(one):
                every_struct(field.type, found)
    return found


def signals() -> dict[str, str]:
    """Signals of a recording, with what each means."""
    from .signal_meanings import MEANINGS

    return MEANINGS


def paths() -> dict[str, str]:
    """The values of `type` in the tables of a reference."""
    from ..lab.experiments import references

    return {key: ", ".join(getattr(references, name)) for key, name in FREE.items()}


LISTED: dict[str, tuple[str, Callable[[], dict[str, str]]]] = {
    "reference/python": ("Python: `mmnn docs NAME` prints one of them", python_names),
    "reference/commands": ("Commands: `mmnn NAME --help` prints one of them", commands),
    "reference/controllers": ("Controllers", controllers),
    "reference/paths": ("Paths and profiles: `mmnn docs KEY` prints those of one key", paths),
    "reference/experiment-keys": (
        "Keys of an experiment: `mmnn docs KEY` prints one of them",
        lambda: keys_of_kind(kinds()["experiment"]),
    ),
    "reference/study-keys": ("Keys of a study", lambda: keys_of_kind(kinds()["study"])),
    "reference/robot-keys": (
        "Keys of NAME.mmnn.toml, options and arguments of load",
        lambda: keys_of_kind(kinds()["robot"]),
    ),
    "reference/ros2-keys": ("Parameters of the ROS 2 node", lambda: keys_of_kind(kinds()["ros2"])),
    "reference/signals": ("Signals of a recording", signals),
}


def listed(name: str) -> str:
    """A page of `LISTED`, written from the code."""
    from ..lab.show.table import hanging

    heading, content = LISTED[name]
    found = content()
    width = max(map(len, found))
    return "\n".join([f"# {heading}\n", *(hanging(f"{key:{width}}  ", text, columns()) for key, text in found.items())])


def names(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Pages that a shell completes."""
    return starting([*pages(), *LISTED], incomplete)


@click.command(
    short_help="Read the documentation: its pages, or what a key of an experiment means.",
    epilog=examples(
        "mmnn docs",
        "mmnn docs how-to/studies | less",
        "mmnn docs latency.margin",
        "mmnn docs actuator                  a table: its keys, defaults and meanings",
        "mmnn docs Trajectory                a name of Python; mmnn docs reference/python lists them",
        "mmnn docs Stepper.step              a method; names of any module are found",
        "mmnn docs --schema experiment > experiment.schema.json     for completion of keys in an editor",
    ),
)
@click.argument("page", required=False, shell_complete=names)
@click.option(
    "--schema",
    "file",
    type=click.Choice(["experiment", "study", "hardware", "robot", "ros2"]),
    help="JSON schema of a file.",
)
@shared
def docs(page: str | None, file: str | None, as_json: bool) -> int:
    """Print a page of the documentation, a key of an experiment with its subkeys, or a name of Python.

    Without PAGE it lists all pages.
    """
    if file is not None:
        answer(True, lambda: schema(file), str)
        return DONE
    there = pages()
    if page is None:
        found = {name: title(file) for name, file in there.items()} | {name: one[0] for name, one in LISTED.items()}
        answer(as_json, lambda: found, lambda: "\n".join(f"{name:30}{heading}" for name, heading in found.items()))
        return DONE
    name = page.removeprefix("docs/").removesuffix(".md")
    if name in there:
        text = there[name].read_text("utf-8")
    elif not (text := listed(name) if name in LISTED else meaning(page) or public(page)):
        beside = siblings(page)
        raise UnknownName("key" if beside else "page, key or name", page, beside or [*LISTED, *there])
    answer(as_json, lambda: {"page": page, "text": text}, lambda: text.rstrip())
    return DONE
