"""From a TOML file to settings; whatever is wrong is named with its line."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec

from ...errors import ConfigError, InputError, UnknownName
from ...files import parsed_toml, read_text, read_toml
from ...settings import Settings
from ...settings.arguments import wrong_type
from .settings import Node


def load_settings(file: str | Path, changes: Iterable[str] = ()) -> Node:
    """The settings of a file.

    Args:
        file: A TOML file.
        changes: `key.path=value` texts, values as in TOML (a bare word is a text).

    Raises:
        ConfigError: It cannot be read, is not TOML, has an unknown key or a value that cannot be; with the line.
    """
    path = Path(file)
    try:
        table, text = read_toml(path), read_text(path)
    except ConfigError as error:
        error.fix = "mmnn ros2 --example > robot.toml writes one to start from"
        raise
    for change in changes:
        put(table, change)
    return converted(table, path, text)


def put(table: dict[str, Any], change: str) -> None:
    """Set `key.path=value` in a table.

    Raises:
        ConfigError: It sets nothing, or its path runs through something that is not a table.
    """
    key, equals, value = change.partition("=")
    *way, last = key.strip().split(".")
    for part in way:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise ConfigError(f"'{part}' is not a table", fix="change what the file says there", key=key)
    if not (equals and last):
        raise ConfigError(f"'{change}' sets nothing", fix="write key.path=value, e.g. rate=500", key="--set")
    try:
        table[last] = parsed_toml(f"value = {value}")["value"]
    except ValueError:
        table[last] = value.strip()


def converted(table: dict[str, Any], path: Path, text: str) -> Node:
    """A table as settings; errors as of `load_settings`."""
    parts = {field.name: field.type for field in msgspec.structs.fields(Node)}
    for name, value in table.items():  # one by one, so that an error of a part knows where it stands
        kind = next((k for k in (parts.get(name), *getattr(parts.get(name), "__args__", ())) if is_part(k)), None)
        for i, one in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if kind is not None and isinstance(one, dict):
                convert(one, kind, path, text, f"{name}." if i is None else f"{name}.{i}.")
    return convert(table, Node, path, text, "")


def is_part(kind: Any) -> bool:
    """Whether a type is that of a table."""
    return isinstance(kind, type) and issubclass(kind, Settings)


def convert(table: dict[str, Any], kind: Any, path: Path, text: str, prefix: str) -> Any:
    """One table as settings; errors as of `load_settings`."""
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        message, _, where = str(error).partition(" - at ")
        there = re.sub(r"\[(\d+)\]", r".\1", where.strip("`").removeprefix("$")).removeprefix(".")
        key = (prefix + there).rstrip(".")
        unknown = re.search(r"unknown field `(\w+)`", message)
        if unknown:
            fields = [field.name for field in msgspec.structs.fields(kind)] if not there else []
            wrong: InputError = (
                UnknownName("key", unknown[1], fields, key=key or None)
                if fields
                else ConfigError(f"unknown key '{unknown[1]}'", fix="leave it out", key=key)
            )
            wrong.file, wrong.line = path, line_of(text, f"{key}.{unknown[1]}".lstrip("."))
            raise wrong from error
        what, fix = wrong_type(message)
        raise ConfigError(what, fix=fix, file=path, line=line_of(text, key), key=key or None) from error
    except InputError as error:
        own = (error.key or "").removeprefix(prefix)
        error.key = (prefix + own).rstrip(".") or None
        error.file, error.line = path, line_of(text, error.key or "")
        raise


def line_of(text: str, key: str) -> int | None:
    """Line of a TOML text on which a key path stands, or the table that it would stand in; None for neither."""
    here, counts, nearest = "", dict[str, int](), None
    for number, line in enumerate(text.splitlines(), 1):
        if many := re.match(r"\s*\[\[\s*([\w.-]+)\s*\]\]", line):
            counts[many[1]] = counts.get(many[1], -1) + 1
            here = path = f"{many[1]}.{counts[many[1]]}"
        elif one := re.match(r"\s*\[\s*([\w.-]+)\s*\]", line):
            here = path = one[1]
        elif entry := re.match(r'\s*"?([\w.-]+)"?\s*=', line):
            path = f"{here}.{entry[1]}".lstrip(".")
        else:
            continue
        if path == key:
            return number
        if key.startswith(f"{path}."):
            nearest = number
    return nearest
