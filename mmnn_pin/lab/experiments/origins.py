"""The place that the key of an error comes from: an override, or a line of a TOML file."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TypeGuard

from ...errors import InputError, UnknownKey, UnknownName

OPTIONS = ("robot", "hardware", "overrides", "controllers", "seed", "plant")  # keys that options of their own set, too
PART = r"""(?:"[^"\n]*"|'[^'\n]*'|[A-Za-z0-9_-]+)"""
PATH = rf"{PART}(?:\s*\.\s*{PART})*"
HEADER = re.compile(rf"^\s*\[\[?\s*({PATH})\s*\]\]?")
ENTRY = re.compile(rf"^\s*({PATH})\s*=")


def of_override(error: InputError, texts: Iterable[str]) -> InputError:
    """An error at a key that an override sets: that it came from there, not from the experiment's file.

    Args:
        error: It.
        texts: `key.path=value`.

    Returns:
        The error itself where it does not.
    """
    unknown = error.name if isinstance(error, UnknownKey) or is_key(error) else None
    at = ".".join(part for part in (error.key, unknown) if part)
    for key in (text.partition("=")[0].strip() for text in texts):
        if at and (f"{at}.".startswith(f"{key}.") or f"{key}.".startswith(f"{at}.")):
            by_option = key.partition(".")[0] in OPTIONS and not unknown
            option, longest = "" if by_option else "--set", max(key, at, key=len)
            return error.but(file=None, option=option, key=longest if unknown else error.key)
    return error


def is_key(error: InputError) -> TypeGuard[UnknownName]:
    """Whether an error is about the name of a key."""
    return isinstance(error, UnknownName) and error.kind == "key"


def line_of(text: str, key: str) -> int | None:
    """Line, counted from 1, of the entry or table that a key path names, or the nearest around it, or the first within.

    Args:
        text: The file.
        key: Key path; quotes around its parts are left out, as in the errors of a config.
    """
    best, line, within, table = 0, None, None, ""
    for number, text_line in enumerate(text.splitlines(), start=1):
        if header := HEADER.match(text_line):
            table = path = plain(header[1])
        elif entry := ENTRY.match(text_line):
            path = f"{table}.{plain(entry[1])}" if table else plain(entry[1])
        else:
            continue
        if f"{key}.".startswith(f"{path}.") and len(path) > best:
            best, line = len(path), number
        elif path.startswith(f"{key}.") and within is None:
            within = number
    return line or within


def plain(path: str) -> str:
    """A key path without quotes and blanks."""
    return ".".join(part.strip("\"'") for part in re.findall(PART, path))
