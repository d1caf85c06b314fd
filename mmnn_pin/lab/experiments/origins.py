"""The place that the key of an error comes from: an override, or a line of a TOML file."""

from __future__ import annotations

import re
from collections.abc import Iterable

from ...errors import InputError

UNKNOWN_KEY = re.compile(r"unknown key '(.*)'")
OPTIONS = ("robot", "overrides", "controllers", "seed", "plant")  # keys that options of their own set, too
PART = r"""(?:"[^"\n]*"|'[^'\n]*'|[A-Za-z0-9_-]+)"""
PATH = rf"{PART}(?:\s*\.\s*{PART})*"
HEADER = re.compile(rf"^\s*\[\[?\s*({PATH})\s*\]\]?")
ENTRY = re.compile(rf"^\s*({PATH})\s*=")


def of_override(error: InputError, texts: Iterable[str]) -> InputError:
    """An error at a key that an override sets: that it came from there, not from the experiment's file.

    Args:
        error: It; its file and key are changed.
        texts: `key.path=value`.
    """
    unknown = UNKNOWN_KEY.match(error.what)
    at = ".".join(part for part in (error.key, unknown and unknown[1]) if part)
    for key in (text.partition("=")[0].strip() for text in texts):
        if at and (f"{at}.".startswith(f"{key}.") or f"{key}.".startswith(f"{at}.")):
            by_option = key.partition(".")[0] in OPTIONS and not unknown
            error.file, error.option = None, "" if by_option else "--set"
            error.key = max(key, at, key=len) if unknown else error.key
            break
    return error


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
