"""On which line of a TOML file a key path stands."""

from __future__ import annotations

import re

PART = r"""(?:"[^"\n]*"|'[^'\n]*'|[A-Za-z0-9_-]+)"""
PATH = rf"{PART}(?:\s*\.\s*{PART})*"
HEADER = re.compile(rf"^\s*\[\[?\s*({PATH})\s*\]\]?")
ENTRY = re.compile(rf"^\s*({PATH})\s*=")


def line_of(text: str, key: str) -> int | None:
    """Line, counted from 1, of the entry or table that a key path names, or of the nearest one around it.

    Args:
        text: The file.
        key: Key path; quotes around its parts are left out, as in the errors of a config.
    """
    best, found, table = 0, None, ""
    for number, line in enumerate(text.splitlines(), start=1):
        if header := HEADER.match(line):
            table = path = plain(header[1])
        elif entry := ENTRY.match(line):
            path = f"{table}.{plain(entry[1])}" if table else plain(entry[1])
        else:
            continue
        if f"{key}.".startswith(f"{path}.") and len(path) > best:
            best, found = len(path), number
    return found


def plain(path: str) -> str:
    """A key path without quotes and blanks."""
    return ".".join(part.strip("\"'") for part in re.findall(PART, path))
