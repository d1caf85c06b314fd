"""Key paths of an experiment: whether one exists, what is near it, how to change it."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from typing import Any

from ...errors import ConfigError, UnknownName, keyed
from ..experiments.config import keys_of, kind_at, put, value_at

NEAR = 6  # how many near keys an error names


def known_keys(path: str) -> tuple[str, ...]:
    """Keys that exist at a key path of an experiment; none where no settings stand there, or any keys may."""
    return keys_of(kind_at(path))


def leaves(table: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Key paths of everything in a table that is no table."""
    for name, value in table.items():
        if isinstance(value, Mapping) and value:
            yield from leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}"


def require_path(table: Mapping[str, Any], path: str, key: str) -> None:
    """Refuse a key path that names nothing in an experiment.

    Args:
        table: The experiment with all its defaults.
        path: The path.
        key: Where the path was given.

    Raises:
        UnknownName: With the paths that are near it.
    """
    here: Any = table
    parts = path.split(".")
    for i, part in enumerate(parts):
        if isinstance(here, list) and part.isdecimal() and int(part) < len(here):
            here = here[int(part)]
        elif isinstance(here, Mapping) and part in here:
            here = here[part]
        elif here is None and part in known_keys(".".join(parts[:i])):
            continue  # a table that the experiment leaves out, such as `safety`
        elif isinstance(here, Mapping) and i and not known_keys(".".join(parts[:i])) and part:
            return  # a free table, such as a path's arguments: judged when the path is made
        else:
            raise UnknownName("setting", path, near(path, list(leaves(table))), key=key)


def near(path: str, known: list[str]) -> list[str]:
    """Known key paths that are like one: by their whole, or by their last part; the top ones where none is."""
    last = path.rpartition(".")[2]
    ends = {known_path: known_path.rpartition(".")[2] for known_path in known}
    whole = difflib.get_close_matches(path, known, n=NEAR, cutoff=0.6)
    alike = difflib.get_close_matches(last, sorted(set(ends.values())), n=3, cutoff=0.75)
    found = list(dict.fromkeys([*whole, *(p for end in alike for p in known if ends[p] == end)]))[:NEAR]
    return found or sorted({known_path.partition(".")[0] for known_path in known})


def flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Key paths and values of changes to an experiment, written with dots or as tables.

    A table whose keys are free, such as `reference.base`, is one value and replaces what was there.
    """
    for name, value in table.items():
        path = f"{prefix}{name}"
        if isinstance(value, Mapping) and known_keys(path):
            yield from flat(value, f"{path}.")
        else:
            yield path, value


def changed(table: dict[str, Any], path: str, value: Any, relative: bool = False) -> Any:
    """Change a table at a path, and the value that it has then.

    Args:
        table: An experiment with all its defaults; changed in place.
        path: A path that exists.
        value: The new value, or what the old one is multiplied with.
        relative: Which of the two.

    Raises:
        ConfigError: As in `put`, or the old value is no number and no list of numbers; with the path.
    """
    parts = path.split(".")
    with keyed(lambda key: path):
        if relative:
            value = times(value_at(table, path), value)
        for above in (".".join(parts[:i]) for i in range(1, len(parts))):
            if value_at(table, above) is None and known_keys(above):  # a table that the experiment leaves out
                put(table, above, {})
        put(table, path, value)
    return value


def times(old: Any, factor: float) -> Any:
    """A number, or all numbers of a list, multiplied.

    Raises:
        ConfigError: It is neither.
    """
    if isinstance(old, list):
        return [times(item, factor) for item in old]
    if isinstance(old, bool) or not isinstance(old, (int, float)):
        raise ConfigError(f"{old!r} cannot be multiplied", why="it is no number", fix="leave out `relative`")
    return old * factor


def deep(table: Any) -> Any:
    """A copy of tables and lists; much faster than `copy.deepcopy`."""
    if isinstance(table, dict):
        return {key: deep(value) for key, value in table.items()}
    return [deep(value) for value in table] if isinstance(table, list | tuple) else table
