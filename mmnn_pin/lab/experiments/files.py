"""Files of experiments: those that come with the package by name, their variants, and one that starts from another."""

from __future__ import annotations

import glob
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...errors import ConfigError, UnknownName

FOLDER = Path(__file__).parent
ITS_OWN = ("title", "variant", "experiment", "cases")  # keys that no other experiment takes over


def bundled() -> dict[str, Path]:
    """Experiments that come with the package, name to file; of one with variants the file of its default."""
    return {path.stem: path for path in sorted(FOLDER.glob("*.toml")) if "." not in path.stem}


def variants(path: Path) -> dict[str, Path]:
    """Variants of an experiment, name to file, the default first.

    `NAME.toml` is the default and says its variant's name itself; the others are `NAME.VARIANT.toml` beside it.
    """
    own = read_toml(path).get("variant")
    others = sorted(path.parent.glob(f"{glob.escape(path.stem)}.*.toml"))
    return ({own: path} if own else {}) | {other.stem.removeprefix(f"{path.stem}."): other for other in others}


def find(name_or_path: str | Path) -> Path:
    """File of an experiment.

    Raises:
        UnknownName: Neither a bundled name nor something that looks like a path.
        ConfigError: A path without a file.
    """
    text = str(name_or_path)
    if text in bundled():
        return bundled()[text]
    path = Path(text)
    if path.suffix != ".toml" and len(path.parts) < 2 and not path.exists():
        raise UnknownName("experiment", text, bundled())
    if not path.is_file():
        raise ConfigError("no such file", fix=f"name a TOML file, or one of: {', '.join(bundled())}", file=path)
    return path


def find_variant(path: Path, variant: str) -> Path:
    """File of an experiment's variant.

    Raises:
        UnknownName: It has no such variant.
        ConfigError: It has no variants.
    """
    known = variants(path)
    if not known:
        raise ConfigError("has no variants", fix="leave --variant out", file=path, key="--variant")
    if variant not in known:
        raise UnknownName("variant", variant, known, file=path, key="--variant")
    return known[variant]


def read_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file.

    Raises:
        ConfigError: It cannot be read, is not UTF-8 or not TOML; with the line.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError("cannot be read", why=error.strerror or str(error), file=path) from error
    except UnicodeDecodeError as error:
        raise ConfigError("not a text in UTF-8", why=str(error), file=path) from error
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"at line (\d+)", str(error))
        number = int(line[1]) if line else None
        raise ConfigError("not valid TOML", why=str(error), file=path, line=number) from error


def whole(path: Path, before: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Content of a TOML file; where its key `experiment` names another one, on top of what that one says.

    Args:
        path: The file.
        before: Files that have led to it.

    Raises:
        UnknownName: No such experiment.
        ConfigError: A file cannot be read, or starts from itself.
    """
    table = read_toml(path)
    name = table.pop("experiment", None)
    if name is None:
        return table
    if path in before:
        raise ConfigError("starts from itself", fix="name another experiment", file=path, key="experiment")
    return merged(inherited(whole(beside(path, name), (*before, path))), table)


def with_starts(table: dict[str, Any], own: Mapping[str, Any], path: Path, overrides: tuple[str, ...]) -> None:
    """Complete the cases that start from another experiment: that one, what this file itself says, overrides, the case.

    Args:
        table: The experiment, changed in place.
        own: What its file itself says.
        path: The file.
        overrides: `key.path=value` texts.

    Raises:
        UnknownName: No such experiment.
        ConfigError: A file cannot be read, or an override sets nothing.
    """
    cases = table.get("cases")
    for name, case in cases.items() if isinstance(cases, dict) else ():
        if not (isinstance(case, dict) and case.get("experiment")):
            continue
        try:
            start = merged(inherited(whole(beside(path, case["experiment"]))), inherited(own))
        except UnknownName as error:
            error.file, error.key = path, f"cases.{name}.experiment"
            raise
        for text in overrides:
            if not text.startswith("cases."):
                override(start, text)
        case["set"] = merged(start, case.get("set", {}))


def inherited(table: Mapping[str, Any]) -> dict[str, Any]:
    """What another experiment takes over from this one."""
    return {key: value for key, value in table.items() if key not in ITS_OWN}


def beside(path: Path, name: Any) -> Path:
    """File of an experiment that a file names: a path from its folder, or as in `find`."""
    there = path.parent / str(name)
    return there if there.suffix == ".toml" and there.is_file() else find(str(name))


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A table with the keys of another, tables in it likewise; a table of another `type` replaces the old one."""
    result = dict(table)
    for key, value in changes.items():
        old = result.get(key)
        both = isinstance(value, Mapping) and isinstance(old, Mapping)
        same = both and value.get("type", old.get("type")) == old.get("type")  # type: ignore[union-attr]
        result[key] = merged(old, value) if same else value  # type: ignore[arg-type]
    return result


def override(table: dict[str, Any], text: str) -> None:
    """Set `key.path=value` in a table read from TOML.

    Raises:
        ConfigError: No `=`, or the path runs through something that is not a table.
    """
    key, equals, value = text.partition("=")
    key = key.strip()
    if not equals or not all(key.split(".")):
        raise ConfigError(f"'{text}' sets nothing", fix="write key.path=value, e.g. time.duration=2", key="--set")
    put(table, key, parse_value(value.strip()))


def put(table: dict[str, Any], key: str, value: Any) -> None:
    """Set a value at a key path of a table; numbers in the path are places in lists, counted from 0.

    Raises:
        ConfigError: The path runs through something that is not a table, or a list has no such place.
    """
    parts = key.split(".")
    here: Any = table
    for part in parts[:-1]:
        here = here[place(here, part, key)] if isinstance(here, list) else here.setdefault(part, {})
        if not isinstance(here, (dict, list)):
            raise ConfigError(f"'{part}' is not a table", fix="see the experiment's TOML for its keys", key=key)
    last = place(here, parts[-1], key) if isinstance(here, list) else parts[-1]
    here[last] = value


def place(items: list[Any], part: str, key: str) -> int:
    """Place in a list that a part of a key path names.

    Raises:
        ConfigError: The list has no such place.
    """
    if not (part.isdecimal() and int(part) < len(items)):
        raise ConfigError(f"'{part}' is no place in a list of {len(items)}", fix="count from 0", key=key)
    return int(part)


def parse_value(text: str) -> Any:
    """Value as TOML reads it; what TOML does not read is a text."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
