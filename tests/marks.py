"""Marks of an experiment's values: printed in the thesis, assumed or calibrated, read from the comments of its TOML."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mmnn_pin.lab.experiments.config import read_toml

MARKS = ("printed", "assumed", "calibrated")


def marked(file: Path) -> dict[str, tuple[Any, str]]:
    """Key path to value and mark, from the text of a TOML; every key line must carry exactly one mark."""
    values, places, found = read_toml(file), {}, {}
    here: list[str | int] = []
    for line in file.read_text().splitlines():
        if header := re.match(r"(\[+)([\w.]+)\]", line):
            here = [*header[2].split(".")]
            if len(header[1]) == 2:  # one more table of an array
                places[header[2]] = places.get(header[2], -1) + 1
                here.append(places[header[2]])
        elif key := re.match(r"(\w+) = ", line):
            comment = line.rpartition("#")[2]
            marks = re.findall("|".join(MARKS), comment)
            assert "#" in line and len(marks) == 1, f"{file.name}: {line}"
            value: Any = values
            for part in (*here, key[1]):
                value = value[part]
            found[".".join(map(str, (*here, key[1])))] = (value, marks[0])
    return found


def leaves(value: Any, path: str = "") -> list[str]:
    """Key paths of all values of a TOML; a list without tables is one value."""
    if isinstance(value, dict):
        return [leaf for key, each in value.items() for leaf in leaves(each, f"{path}.{key}" if path else key)]
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [leaf for i, each in enumerate(value) for leaf in leaves(each, f"{path}.{i}")]
    return [path]
