"""The place that the key of an error comes from: an override, or a line of a TOML file."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TypeGuard

from ...errors import InputError, UnknownKey, UnknownName
from ...files import read_text

OPTIONS = ("robot", "hardware", "overrides", "controllers", "seed", "plant")  # keys that options of their own set, too
PART = r"""(?:"[^"\n]*"|'[^'\n]*'|[A-Za-z0-9_-]+)"""
PATH = rf"{PART}(?:\s*\.\s*{PART})*"
HEADER = re.compile(rf"^\s*\[(\[?)\s*({PATH})\s*\]\]?")
ENTRY = re.compile(rf"^\s*({PATH})\s*=")


def of_override(error: InputError, texts: Iterable[str]) -> InputError:
    """An error at a key that an override sets: that it came from there, not from the experiment's file.

    Args:
        error: It.
        texts: `key.path=value`.

    Returns:
        The error itself where it does not.
    """
    unknown, at = unknown_in(error), path_of(error)
    for key in (text.partition("=")[0].strip() for text in texts):
        if at and (f"{at}.".startswith(f"{key}.") or f"{key}.".startswith(f"{at}.")):
            by_option = key.partition(".")[0] in OPTIONS and not unknown
            option, longest = "" if by_option else "--set", max(key, at, key=len)
            return error.but(file=None, option=option, key=longest if unknown else error.key)
    return error


def placed(error: InputError, *files: Path) -> InputError:
    """An error at a key, with the file that has the key, or the longest part of its path, and the line there.

    Args:
        error: It.
        files: TOML files; one that starts from another stands before it.

    Returns:
        With the first file and no line where none has the key; the error itself where it names a file already, or
        there are no files.
    """
    if error.file is not None or not files:
        return error
    name = error.name if error.key and isinstance(error, UnknownName) else None  # of a joint, say, which is a key there
    path = ".".join(part for part in (error.key, unknown_in(error) or name) if part)
    lines = [nearest_line(read_text(file), path) for file in files]
    best = max(range(len(files)), key=lambda i: (lines[i][0], lines[i][1] is not None))
    return error.but(file=files[best], line=lines[best][1])


def path_of(error: InputError) -> str:
    """Key path of an error, with the name of a key that there is not; empty for none."""
    return ".".join(part for part in (error.key, unknown_in(error)) if part)


def unknown_in(error: InputError) -> str | None:
    """The name of a key that there is not, of an error about one."""
    return error.name if isinstance(error, UnknownKey) or is_key(error) else None


def is_key(error: InputError) -> TypeGuard[UnknownName]:
    """Whether an error is about the name of a key."""
    return isinstance(error, UnknownName) and error.kind == "key"


def nearest_line(text: str, key: str) -> tuple[int, int | None]:
    """Line, counted from 1, of the entry or table that a key path names, or the first within, or the nearest around it.

    Args:
        text: The file.
        key: Key path; quotes around its parts are left out, as in the errors of a config.

    Returns:
        How many letters of the path stand there, and the line; None for none.
    """
    best, line, within, table, places = 0, None, None, "", dict[str, int]()
    for number, text_line in enumerate(text.splitlines(), start=1):
        if header := HEADER.match(text_line):
            table = plain(header[2])
            if header[1]:
                places[table] = places.get(table, -1) + 1
            table = path = numbered(table, places)
        elif entry := ENTRY.match(text_line):
            path = f"{table}.{plain(entry[1])}" if table else plain(entry[1])
        else:
            continue
        if f"{key}.".startswith(f"{path}.") and len(path) > best:
            best, line = len(path), number
        elif path.startswith(f"{key}.") and within is None:
            within = number
    return best, line if best == len(key) else within or line


def numbered(table: str, places: dict[str, int]) -> str:
    """The name of a table, `disturbances` or `disturbances.load`, with the place in the list that it stands in."""
    inner = [name for name in places if f"{table}.".startswith(f"{name}.")]
    name = max(inner, key=len, default="")
    return f"{name}.{places[name]}{table.removeprefix(name)}" if name else table


def plain(path: str) -> str:
    """A key path without quotes and blanks."""
    return ".".join(part.strip("\"'") for part in re.findall(PART, path))
