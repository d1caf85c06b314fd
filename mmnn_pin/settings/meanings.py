"""Meanings of the fields of a class, from its docstring and from the comments beside them."""

from __future__ import annotations

import inspect
import re
from functools import cache

LISTED = re.compile(r"^    (?P<names>\w+(?:, \w+)*): (?P<text>.*(?:\n {8}.*)*)", re.M)
BESIDE = re.compile(r"^ {4}(?:(?P<above>(?:# .+\n {4})+)(?P<field>\w+): .+|(?P<name>\w+): .+?  # (?P<text>.+))$", re.M)


@cache
def meanings(kind: type) -> dict[str, str]:
    """Meanings of a class's fields by name, those of the classes that it derives from too."""
    found = dict[str, str]()
    for each in reversed(getattr(kind, "__mro__", ())):
        for hit in LISTED.finditer((inspect.getdoc(each) or "").partition("\nRaises:")[0]):
            found |= dict.fromkeys(hit["names"].split(", "), " ".join(hit["text"].split()))
        for hit in BESIDE.finditer(source_of(each)):
            found[hit["field"] or hit["name"]] = hit["text"] or " ".join(hit["above"].replace("# ", "").split())
    return found


def source_of(kind: type) -> str:
    """The source of a class; empty where there is none."""
    try:
        return inspect.getsource(kind)
    except (OSError, TypeError):
        return ""
