"""Reads an experiment's TOML, applies overrides, and names the key path of whatever is wrong with it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

import msgspec

from ...disturbance import Disturbance
from ...errors import ConfigError, InputError, RecordingError, UnknownName
from ...model.base.overrides import Overrides
from ...recording.recording import Recording
from ...settings import wrong_type
from .contest import ONLY
from .controllers import CONTROLLERS, new_name, renamed
from .experiment import Experiment
from .files import find, find_variant, override, read_toml, whole, with_starts

UNIONS = (Union, UnionType)


def load_experiment(name_or_path: str | Path, overrides: Iterable[str] = (), variant: str | None = None) -> Experiment:
    """Experiment by name or from a TOML file.

    Args:
        name_or_path: A bundled name (`chapter4`) or a path to a file.
        overrides: `key.path=value` texts, values as in TOML (a bare word is a text).
        variant: Which variant, where the experiment has several; None for its default.

    Raises:
        UnknownName: No such experiment or variant.
        ConfigError: The file cannot be read or is not TOML, a key is unknown, a value of the wrong type or range.
    """
    path, texts = find(name_or_path), tuple(overrides)
    if variant is not None:
        path = find_variant(path, variant)
    table = whole(path)
    for text in texts:
        override(table, text)
    with_starts(table, read_toml(path), path, texts)
    try:
        require_overrides(table.get("overrides", {}))
        require_disturbances(table.get("disturbances"))
        experiment = msgspec.convert(table, Experiment)
        require_names(experiment)
        return experiment
    except msgspec.ValidationError as error:
        raise config_error(error, path, table) from error
    except InputError as error:
        error.file = error.file or path
        raise


def recorded_experiment(recording: Recording) -> Experiment | None:
    """The experiment of a recording; None where it was run without one.

    Raises:
        RecordingError: Another version wrote it.
    """
    if not recording.config_text:
        return None
    try:
        return msgspec.convert(renamed(without_null(msgspec.json.decode(recording.config_text))), Experiment)
    except (msgspec.DecodeError, InputError) as error:
        why = f"another version of mmnn_pin wrote it: {' '.join(str(error).split())}"
        raise RecordingError("its config cannot be read", why=why, file=recording.path) from error


def without_null(value: Any) -> Any:
    """A value of JSON without what is null there: what is None by default, and times that are inf by default."""
    if isinstance(value, dict):
        return {key: without_null(item) for key, item in value.items() if item is not None}
    return [without_null(item) for item in value] if isinstance(value, list) else value


def require_names(experiment: Experiment) -> None:
    """Refuse controllers and tasks that a contest names and that do not exist.

    Raises:
        UnknownName: With the key path.
    """
    contest = experiment.contest
    if contest is None:
        return
    there, tasks = {**CONTROLLERS, **experiment.laws}, tuple(experiment.cases) or (ONLY,)
    named = {f"contest.knows.{what}": names for what, names in contest.knows.items()} | {
        "contest.beside": contest.beside
    }
    for key, names in named.items():
        for name in names:
            if name not in there:
                raise UnknownName("controller", name, there, key=key)
    for key in ("task", "printed", "rich", "poor"):
        name = getattr(contest.targets, key)
        if name and name not in tasks:
            raise UnknownName("task", name, tasks, key=f"contest.targets.{key}")


def require_overrides(table: Any) -> None:
    """Judge what is said about the robot by itself: its errors name keys of a file of its own.

    Raises:
        InputError: A value out of range, with the key path of an experiment.
    """
    with suppress(msgspec.ValidationError):  # told with its path when the whole experiment is read
        try:
            msgspec.convert(table, Overrides)
        except InputError as error:
            error.key = f"overrides.{error.key}"
            raise


def require_disturbances(items: Any) -> None:
    """Judge every disturbance by itself: its errors do not know its place in the list.

    Raises:
        ConfigError: A value out of range, with the key path of an experiment.
    """
    for i, item in enumerate(items if isinstance(items, list) else ()):
        with suppress(msgspec.ValidationError):  # told with its path when the whole experiment is read
            try:
                msgspec.convert(item, Disturbance)
            except InputError as error:
                error.key = f"disturbances.{i}.{(error.key or '').removeprefix('disturbances.')}"
                raise


def config_error(error: msgspec.ValidationError, path: Path | None, table: Any = None) -> ConfigError:
    """The key path and a line of advice out of a message such as "Expected `int` - at `$.seed`".

    Args:
        error: From the conversion.
        path: File of the experiment.
        table: What was converted; tells which of several types a table is.
    """
    message, _, where = str(error).partition(" - at ")
    there = re.sub(r"\[(\d+)\]", r".\1", where.strip("`").removeprefix("$").replace("[...]", ".*")).removeprefix(".")
    key = with_names(there, table) or None
    kind, known = kind_at(key, table), tuple[str, ...]()
    unknown = re.search(r"unknown field `(\w+)`", message)
    last = unknown[1] if unknown else value_at(key, table)
    if now := new_name(".".join(filter(None, (key, last))) if unknown else key or "", None if unknown else last):
        return ConfigError(f"'{last}' is now called '{now}'", fix=f"write {now}", file=path, key=key)
    if unknown:
        message, known = f"unknown key '{unknown[1]}'", keys_of(kind)
    elif missing := re.search(r"missing required field `(\w+)`", message):
        message, known = f"the key '{missing[1]}' is missing", tags_of(kind) if missing[1] == "type" else ()
    elif key and (wrong := re.fullmatch(r"Invalid value '(.*)'", message)):
        message, known = f"unknown type '{wrong[1]}'", tags_of(kind_at(key.rpartition(".")[0], table))
    elif wrong := re.fullmatch(r"Invalid enum value '?(.*?)'?", message):
        message, known = f"unknown value '{wrong[1]}'", words_of(kind)
        known += ("or a number",) if float in get_args(kind) else ()
    if known:
        return ConfigError(message, fix=f"there is: {', '.join(known)}", file=path, key=key)
    what, fix = wrong_type(message, value_at(key, table))
    return ConfigError(what, fix=fix, file=path, key=key)


def with_names(key: str, table: Any) -> str:
    """A key path with `*`, which stands for a name, as that of the first entry there that is of the wrong type."""
    head, star, rest = key.partition(".*")
    if not star:
        return key
    entries, kind = value_at(head, table), kind_at(f"{head}.*", table)
    if kind is None:
        return head
    for name, entry in entries.items() if isinstance(entries, dict) else ():
        try:
            msgspec.convert(entry, kind)
        except msgspec.ValidationError:
            return with_names(f"{head}.{name}{rest}", table)
        except InputError:
            continue
    return head


def value_at(key: str | None, table: Any) -> Any:
    """What a table holds at a key path; None where it holds nothing there."""
    for part in key.split(".") if key else ():
        table = inside(table, part)
    return table if key else None


def kind_at(key: str | None, table: Any = None) -> Any:
    """The type that stands at a key path, of a table with a `type` the one that it says; None where there is none."""
    kind: Any = Experiment
    for part in (key or "").split("."):
        if isinstance(kind, type) and issubclass(kind, msgspec.Struct) and part:
            kind, table = {f.encode_name: f.type for f in msgspec.structs.fields(kind)}.get(part), inside(table, part)
        elif get_origin(kind) in (tuple, list) and part:
            kind, table = get_args(kind)[0], inside(table, part)
        elif part and (tables := [k for k in (kind, *get_args(kind)) if get_origin(k) is dict]):
            kind, table = get_args(tables[0])[1], inside(table, part)
        elif part:
            return None
        kinds = tuple(k for k in get_args(kind) if k is not type(None)) if get_origin(kind) in UNIONS else (kind,)
        named = [k for k in kinds if len(kinds) > 1 and inside(table, "type") in tags_of(k)]
        kind = named[0] if named else kinds[0] if len(kinds) == 1 else Union[kinds]  # noqa: UP007
    return kind


def inside(table: Any, part: str) -> Any:
    """What a table or a list holds at a part of a key path; None where it does not."""
    if isinstance(table, list):
        return table[int(part)] if part.isdecimal() and int(part) < len(table) else None
    return table.get(part) if isinstance(table, dict) else None


def keys_of(kind: Any) -> tuple[str, ...]:
    """Keys of settings; none of anything else."""
    is_settings = isinstance(kind, type) and issubclass(kind, msgspec.Struct)
    return tuple(f.encode_name for f in msgspec.structs.fields(kind)) if is_settings else ()


def tags_of(kind: Any) -> tuple[str, ...]:
    """What a key `type` can say, for one kind of settings or several."""
    kinds = get_args(kind) or (kind,)
    found = [k.__struct_config__.tag for k in kinds if isinstance(k, type) and issubclass(k, msgspec.Struct)]
    return tuple(str(tag) for tag in found if tag is not None)


def words_of(kind: Any) -> tuple[str, ...]:
    """Words that stand for a value, such as those of `Literal["true", "odometry"]`."""
    if get_origin(kind) is Literal:
        return tuple(map(str, get_args(kind)))
    return tuple(word for part in get_args(kind) for word in words_of(part)) if get_origin(kind) in UNIONS else ()
