"""What YAML files of a robot's controllers say of its base: lengths, the factors that correct them, names of wheels.

A length that a controller works with is the stated one times its multipliers, as `diff_drive_controller` of
ros-controls/ros2_controllers (6.9.0) has them: `wheel_separation_multiplier`, `left_wheel_radius_multiplier` and
`right_wheel_radius_multiplier` (ROS 1 also `wheel_radius_multiplier`). Keys are read by their indentation, so far as
such files go: mappings, flow mappings on one line, lists. Multipliers that correct what the geometry says are the
measured size of this robot, and taken; other lengths are opinions (`opinions`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from mmnn_pin.errors import ConfigError
from mmnn_pin.files import read_bytes, reason

from ..urdf.packages import package_of
from ..urdf.shapes import AtRest
from ..urdf.xml import number_problem

LONGEST, YAMLS = 1_000_000, 40  # bytes of a controllers' file, files looked at beside a robot's
# Names of plugins and controllers for a length, and the factor to it.
TRACKS = {"wheel_separation": 1.0, "wheelSeparation": 1.0, "track_width": 1.0, "wheel_separation_y": 1.0}
RADII = {"wheel_radius": 1.0, "wheelRadius": 1.0, "wheel_diameter": 0.5, "wheelDiameter": 0.5, "wheels_radius": 1.0}
FACTORS = {  # what else a controller multiplies them by
    "wheel_separation": ("wheel_separation_multiplier",),
    "wheel_radius": ("wheel_radius_multiplier", "{side}_wheel_radius_multiplier"),
}
SIDES = ("left", "right")
KEY = re.compile(r"['\"]?([^\s'\"{}\[\],]+?)['\"]?\s*:(?:\s+|$)(.*)")
FLOW = re.compile(r"[{,]\s*['\"]?([^\s'\"{}\[\],:]+)['\"]?\s*:\s*([^{}\[\],]+)")
STEERED = re.compile(r"(?:ackermann|bicycle|tricycle)(?:_steering)?_controller|steering_controllers_library")


class Stated(NamedTuple):
    """A length of the base that a file states.

    Attributes:
        value: As the controller works with it [m].
        text: Where it stands.
        nominal: Without multipliers [m].
        side: Whose wheels it is of, "left" or "right"; empty for all.
    """

    value: float
    text: str
    nominal: float
    side: str = ""


class Entry(NamedTuple):
    """A key of a YAML file: its value as text, the items of a list with blanks between them, and its line."""

    text: str
    line: int

    @property
    def items(self) -> tuple[str, ...]:
        """The items of a list, or the one value."""
        return tuple(re.findall(r"[^\s'\"\[\],{}]+", self.text))


Table = dict[str, Entry]


def lines_of(file: str | None) -> list[tuple[int, str]]:
    """Lines of a controllers' file without comments, numbered from 1; none without a file.

    Raises:
        ConfigError: It cannot be read.
    """
    if file is None:
        return []
    try:
        text = read_bytes(file, LONGEST).decode()
    except (OSError, ValueError) as error:
        fix = "name the YAML file of the robot's controllers"
        raise ConfigError("cannot be read", why=reason(error), fix=fix, file=file, key="controllers_file") from None
    return [(number, line.partition("#")[0]) for number, line in enumerate(text.splitlines(), 1)]


def tables_of(file: str | None) -> list[Table]:
    """The mappings of a controllers' file, each by its keys, the last part of those with dots.

    Raises:
        ConfigError: It cannot be read.
    """
    tables: dict[tuple[str, ...], Table] = {}
    above: list[tuple[int, str]] = []
    last: tuple[Table, str] | None = None
    for number, line in lines_of(file):
        word, indent = line.strip(), len(line) - len(line.lstrip())
        if word.startswith("- ") and last:
            table, key = last
            table[key] = table[key]._replace(text=f"{table[key].text} {word[2:]}")
        elif hit := KEY.match(word):
            above = [(i, name) for i, name in above if i < indent]
            path = tuple(name for _, name in above)
            last = (tables.setdefault(path, {}), hit[1].rpartition(".")[2])
            last[0][last[1]] = Entry(hit[2].strip(" '\""), number)
            above.append((indent, hit[1]))
            inner = tables.setdefault((*path, hit[1]), {})
            inner |= {one[1].rpartition(".")[2]: Entry(one[2].strip(" '\""), number) for one in FLOW.finditer(hit[2])}
    return list(tables.values())


def number_of(table: Table, key: str, default: float) -> float:
    """A number of a table, the default where there is none."""
    text = table[key].text if key in table else ""
    return default if not text or number_problem(text, 1) else float(text)


def in_yaml(file: str | None, names: dict[str, float]) -> Iterator[Stated]:
    """What a controllers' file states under some names, each of the two sides' where they differ.

    Raises:
        ConfigError: It cannot be read.
    """
    for table in tables_of(file):
        for key in [key for key in table if key in names]:
            nominal = number_of(table, key, 0.0) * names[key]
            where = f"{Path(file or '').name}, line {table[key].line}"
            known = {side: multipliers(table, key, side) for side in SIDES}
            sides = {"": known["left"]} if known["left"] == known["right"] else known
            for side, factors in sides.items():
                value = nominal * abs(math.prod(factors.values()))
                times = "".join(f" times {name} {factor:g}" for name, factor in factors.items())
                yield Stated(value, f"{key} ({where}){times}", nominal, side)


def multipliers(table: Table, key: str, side: str) -> dict[str, float]:
    """What a table's controller multiplies one of its lengths by on a side, but for ones."""
    names = [name.format(side=side) for name in FACTORS.get(key, ())]
    found = {name: number_of(table, name, 1.0) for name in names}
    return {name: factor for name, factor in found.items() if factor not in (0.0, 1.0)}


def beside(rest: AtRest) -> list[Path]:
    """YAML files of the package that a robot's file is in, and of those beside it that have its name."""
    own = Path(package_of(str(rest.document.path.parent.absolute())))
    stem = re.sub(r"_?(description|model|urdf)$", "", own.name)
    folders = [own, *(f for f in siblings(own) if stem and f.name.startswith(stem) and f != own)]
    files = [
        file for folder in folders for place in ("", "config", "params") for file in (folder / place).glob("*.y*ml")
    ]
    return [file for file in files[:YAMLS] if file.stat().st_size < LONGEST]


def siblings(folder: Path) -> list[Path]:
    """Packages in the folder that holds one, none where it is no package."""
    if not (folder / "package.xml").is_file():
        return []
    return sorted(file.parent for file in folder.parent.glob("*/package.xml"))
