"""Evidence of a base beside its geometry: rollers, contact friction, plugins, controllers, names; and stated lengths.

Geometry cannot tell mecanum wheels from plain ones. Each piece of evidence speaks for `holonomic` or `skid_steer`, and
says where it stands. Plugins and YAML files of the robot's controllers also state a radius and a track. A controller
works with the stated length times its multipliers, as `diff_drive_controller` of ros-controls/ros2_controllers (6.9.0)
has them (ROS 1 also `wheel_radius_multiplier`). Keys are read by their indentation, so far as such files go: mappings,
flow mappings on one line, lists.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from lxml import etree

from ...elementary import atan2
from ...errors import ConfigError
from ...files import read_bytes, reason
from ...signals import Array
from ..urdf.document import number_problem
from ..urdf.packages import package_of
from ..urdf.shapes import HORIZONTAL, AtRest
from .wheels import Candidate

Patterns = tuple[tuple[str, re.Pattern[str]], ...]
Word = tuple[str, str, int]  # what it means, its text, its line
WORDS: Patterns = (
    ("holonomic", re.compile(r"mecanum|planar_?move|holonomic|omni|swedish", re.IGNORECASE)),
    ("skid_steer", re.compile(r"skid|diff_?drive", re.IGNORECASE)),
)
SAID: Patterns = (  # in a text for people
    ("holonomic", re.compile(r"mecanum|omni-?(?:wheel|directional)|(?<!non)(?<!non-)holonomic", re.IGNORECASE)),
    ("skid_steer", re.compile(r"skid|diff(?:erential)?[ _-]?drive", re.IGNORECASE)),
)
README = "[Rr][Ee][Aa][Dd][Mm][Ee]*"
MECANUM = re.compile(r"mecanum|swedish_?wheel|(?<![a-z])meca?(?![a-z])", re.IGNORECASE)
DRIVING: Patterns = (  # that tell whether others steer than drive
    ("car-like", re.compile(r"tricycle|ackermann|bicycle|car[_-]?like|four_wheel_steering", re.IGNORECASE)),
    ("differential_drive", re.compile(r"diff[_-]?drive", re.IGNORECASE)),
)
DRIVEN_KEYS = re.compile(r"(?:wheel|axle|steering|traction|drive|front|rear|left|right)\w*_(?:names?|joints?)$")
OUTDOORS = re.compile(r"rover|4wd|4x4|ugv|all.?terrain|off.?road", re.IGNORECASE)  # robots that mostly skid
MOVED = re.compile(r"joint|wheel", re.IGNORECASE)  # tags of plugins that name what they drive
READS = re.compile(r"state[_-]?publisher|force[_-]?torque|ft[_-]?sensor", re.IGNORECASE)  # plugins that drive nothing
WEIGHTS = {  # of evidence by its source, as of `model.signs`: the last ones only confirm
    "rollers": 8.0,
    "oblique friction": 5.0,
    "plugin": 3.5,
    "controllers": 3.5,
    "commands": 3.5,
    "no friction": 3.0,
    "friction": 2.5,
    "mecanum": 4.5,
    "meshes": 2.5,
    "names": 1.5,
    "readme": 2.2,
    "called": 1.2,
    "transmissions": 1.0,
}
NO_FRICTION, GRIP = 1e-3, 0.2  # friction coefficients below the first slide, above the second hold
LONGEST, YAMLS = 1_000_000, 40  # bytes of a controllers' file or a README, files looked at beside a robot's
ABOVE = 5  # folders from a package's up that may have its README
# Names of plugins and controllers for a length, and the factor to it.
TRACKS = {"wheel_separation": 1.0, "wheelSeparation": 1.0, "track_width": 1.0, "wheel_separation_y": 1.0}
RADII = {"wheel_radius": 1.0, "wheelRadius": 1.0, "wheel_diameter": 0.5, "wheelDiameter": 0.5, "wheels_radius": 1.0}
FACTORS = {  # what else a controller multiplies them by
    "wheel_separation": ("wheel_separation_multiplier",),
    "wheel_radius": ("wheel_radius_multiplier", "{side}_wheel_radius_multiplier"),
}
SIDES = ("left", "right")
MOTORS = {"commands": "ros2_control/joint[command_interface]", "transmissions": "transmission/joint"}
KEY = re.compile(r"['\"]?([^\s'\"{}\[\],]{1,200}?)['\"]?\s*:(?:\s+|$)(.*)")  # longer ones no driver has
FLOW = re.compile(r"[{,]\s*['\"]?([^\s'\"{}\[\],:]{1,200})['\"]?\s*:\s*([^{}\[\],]+)")
CONTROLLING = re.compile("type|joint|wheel|track")  # in keys of controllers


@dataclass(frozen=True)
class Evidence:
    """Text, with its line, that speaks for `holonomic` or `skid_steer`; of one source it counts once for all wheels."""

    meaning: str
    text: str
    line: int
    source: str  # where it is from, a key of `WEIGHTS`
    wheel: str = ""  # joint of the wheel that it is about, empty for all
    roller: float = math.nan  # roller angle that it states of that wheel [rad], see `Wheel`; nan when it states none

    @property
    def weight(self) -> float:
        """The weight of its source [nats]."""
        return WEIGHTS[self.source]


def evidence(rest: AtRest, wheels: list[Candidate], controllers: str | None = None) -> list[Evidence]:
    """All evidence about parallel wheels, in the order of its weight; errors as of `lines_of`."""
    files = own_files(rest, {c.joint.name for c in wheels}, controllers)
    words = (word for file in files for word in types_in(file, WORDS))
    drivers = [*plugins(rest), *(Evidence(*word, "controllers") for word in words)]
    found = [*rollers(rest, wheels), *drivers, *motors_of_some(rest, wheels), *contact(rest, wheels)]
    return [*found, *names(rest, wheels), *([] if drivers else readme(rest))]  # a README repeats what drivers say


def rollers(rest: AtRest, wheels: list[Candidate]) -> Iterator[Evidence]:
    """Rollers modelled as joints on the wheels, at the angle of the one on the floor, in (-pi/2, pi/2]."""
    for wheel in (wheel for wheel in wheels if wheel.rollers):
        lowest = min((rest.document.joints[name] for name in wheel.rollers), key=lambda joint: rest.hub(joint)[2])
        name, line, angle = wheel.joint.name, wheel.joint.line, from_rolling(wheel, rest.axis(lowest))
        angles = f"rollers at {math.degrees(abs(angle)):.0f} degrees (line {line})"
        yield Evidence("holonomic", f"'{name}' carries {len(wheel.rollers)} {angles}", line, "rollers", name, angle)


def from_rolling(wheel: Candidate, axis: Array) -> float:
    """Angle of a line on the floor from a wheel's rolling direction, counterclockwise from above [rad]."""
    forward = (wheel.axis[1], -wheel.axis[0])
    angle = atan2(forward[0] * axis[1] - forward[1] * axis[0], forward[0] * axis[0] + forward[1] * axis[1])
    return math.remainder(angle, math.pi)


def plugins(rest: AtRest) -> Iterator[Evidence]:
    """Simulator plugins and controllers that say how they move the base."""
    for meaning, text, line in words_in(rest, WORDS, ("gazebo", "ros2_control"), ("plugin", "controller", "hardware")):
        yield Evidence(meaning, text, line, "plugin")


def words_in(rest: AtRest, patterns: Patterns, blocks: Sequence[str], tags: Sequence[str]) -> Iterator[Word]:
    """Words of some patterns in elements of a file: what each means, its text with its line, and that line."""
    for block in rest.document.root.iterchildren(*blocks):
        for e in block.iter(*tags):
            words = f"{e.get('filename', '')} {e.get('name', '')} {(e.text or '').strip()}"
            for meaning, pattern in patterns:
                if hit := pattern.search(words):
                    text = f"<{block.tag}> names '{hit[0]}' in <{e.tag}> (line {e.sourceline})"
                    yield meaning, text, e.sourceline


def types_in(file: str | None, patterns: Patterns) -> Iterator[Word]:
    """Words of some patterns in the types of a file of controllers, as of `words_in`."""
    for number, line in lines_of(file):
        for meaning, pattern in patterns:
            if "type" in line and (hit := pattern.search(line)):
                yield meaning, f"{Path(file or '').name} names '{hit[0]}' (line {number})", 1


def own_files(rest: AtRest, wheels: set[str], controllers: str | None) -> list[str]:
    """The controllers' file that was given, else those beside the robot's that name all these wheels."""
    if controllers is not None:
        return [controllers]
    values = {
        str(file): [entry for table in mappings_of(str(file)).values() for entry in table.values()]
        for file in beside(rest)
    }
    return [file for file, entries in values.items() if wheels <= {word for entry in entries for word in entry.items}]


def motors_of_some(rest: AtRest, wheels: list[Candidate]) -> Iterator[Evidence]:
    """Commands and transmissions of some of the wheels only: the others roll along, so they must skid."""
    for what, source in (("<ros2_control> commands only", "commands"), ("transmissions only of", "transmissions")):
        stated = {e.get("name"): e for e in rest.document.root.iterfind(MOTORS[source])}
        driven = [stated[wheel.joint.name] for wheel in wheels if wheel.joint.name in stated]
        if 0 < len(driven) < len(wheels):
            text = f"{what} {', '.join(e.get('name', '') for e in driven)} (line {driven[0].sourceline})"
            yield Evidence("skid_steer", text, driven[0].sourceline, source)


def contact(rest: AtRest, wheels: list[Candidate]) -> Iterator[Evidence]:
    """Contact friction that gazebo tags give the wheels: along one oblique direction, none, or all around."""
    links = {link: wheel for wheel in wheels for link in rest.document.body(wheel.joint.child)}
    for block in rest.document.root.iterchildren("gazebo"):
        if block.get("reference") not in links:
            continue
        mu1, mu2 = ((numbers_of(block.find(f".//{tag}"), 1) or [math.nan])[0] for tag in ("mu1", "mu2"))
        where = f"of '{block.get('reference')}' (line {block.sourceline})"
        wheel, along = links[block.get("reference")], friction_direction(rest, block)
        size = float(np.linalg.norm(along))
        if mu1 > GRIP and mu2 < NO_FRICTION and 0.1 < abs(along @ wheel.axis) / (size or 1.0) < 0.995:
            text = f"contact friction holds only along an oblique direction {where}"
            roller = from_rolling(wheel, along) if abs(along[2]) <= HORIZONTAL * size else math.nan
            yield Evidence("holonomic", text, block.sourceline, "oblique friction", wheel.joint.name, roller)
        elif mu1 < NO_FRICTION and mu2 < NO_FRICTION:
            yield Evidence("holonomic", f"contact friction is 0 {where}", block.sourceline, "no friction")
        elif mu1 > GRIP and mu2 > GRIP:
            text = f"contact friction {mu1:g}, {mu2:g} holds in all directions {where}"
            yield Evidence("skid_steer", text, block.sourceline, "friction")


def friction_direction(rest: AtRest, block: etree._Element) -> Array:
    """(3,) `fdir1` in the root frame at rest, zero without; it is stated in the link's, or that of `expressed_in`."""
    element = block.find(".//fdir1")
    if not (values := numbers_of(element, 3)):
        return np.zeros(3)
    named = [value for key, value in element.attrib.items() if key.endswith("expressed_in")]
    frame = rest.placements.get([*named, block.get("reference", "")][0], np.eye(4))
    return np.asarray(frame[:3, :3] @ values)


def numbers_of(element: etree._Element | None, count: int) -> list[float]:
    """So many numbers of an element's value or text, none where it has others."""
    text = "" if element is None else element.get("value", element.text) or ""
    return [] if number_problem(text, count) else [float(word) for word in text.split()]


def names(rest: AtRest, wheels: list[Candidate]) -> Iterator[Evidence]:
    """Names of wheels and their meshes, and what the robot is called; they weigh little."""
    for wheel in wheels:
        name, line = wheel.joint.name, wheel.joint.line
        meshes = [mesh.get("filename", "") for mesh in rest.document.links[wheel.joint.child].iter("mesh")]
        for source, word, words in (("names", "names", (name, wheel.joint.child)), ("meshes", "mesh", meshes)):
            for meaning, pattern in WORDS:
                if hit := next(filter(None, map(pattern.search, words)), None):
                    text = f"'{hit[0]}' in the {word} of wheel '{name}' (line {line})"
                    yield Evidence(meaning, text, line, source, name)
    package = own_package(rest)
    called = f"{rest.document.root.get('name', '')} {rest.document.path.name} {package.name if package else ''}"
    shown = " ".join(mesh.get("filename", "") for mesh in rest.document.root.iterfind("link/*/geometry/mesh"))
    if hit := MECANUM.search(f"{called} {shown}"):
        yield Evidence("holonomic", f"the robot or a mesh of it is called '{hit[0]}'", 1, "mecanum")
    for meaning, pattern in (*WORDS, ("skid_steer", OUTDOORS)):
        if hit := pattern.search(called):
            yield Evidence(meaning, f"the robot is called '{hit[0]}'", 1, "called")


def readme(rest: AtRest) -> Iterator[Evidence]:
    """Words of the README of a robot's package, the first from there up; none where it speaks of several kinds."""
    package = own_package(rest)
    folders = [package, *package.parents][:ABOVE] if package else []
    file = next((file for folder in folders for file in sorted(folder.glob(README)) if file.is_file()), None)
    text = read_bytes(file, LONGEST).decode(errors="replace") if file and file.stat().st_size < LONGEST else ""
    found = [(meaning, hit[0]) for meaning, pattern in SAID if (hit := pattern.search(text))]
    for meaning, word in found if len(found) == 1 else ():
        yield Evidence(meaning, f"the README says '{word}'", 1, "readme")


# -- what drives its joints --------------------------------------------------------------------------------------------


def motors_named(rest: AtRest, controllers: str | None = None) -> dict[str, str]:
    """Joints that plugins, `ros2_control`, transmissions or a controllers' file drive, with places; see `lines_of`."""
    root, drivers = rest.document.root, dict[str, str]()
    for element in root.iterfind("transmission//*"):
        tag = str(element.tag).lower()
        if "joint" in tag and not tag.startswith("passive"):  # PR2's have flexJoint, gap_joint, passive_joint
            drivers[element.get("name", "")] = f"<transmission> (line {element.sourceline})"
    for element in root.iterfind(MOTORS["commands"]):
        drivers[element.get("name", "")] = f"<ros2_control> (line {element.sourceline})"
    for element in root.iterfind("gazebo//*"):
        if MOVED.search(str(element.tag)) and not reads_only(element):
            named = re.split(r"[\s,]+", element.text or "")
            drivers |= dict.fromkeys(named, f"<{element.tag}> (line {element.sourceline})")
    for key, entry in (item for table in mappings_of(controllers).values() for item in table.items()):
        if DRIVEN_KEYS.search(key) or key == "joints":
            drivers |= dict.fromkeys(entry.items, f"{Path(controllers or '').name} (line {entry.line})")
    return {name: where for name, where in drivers.items() if name in rest.document.joints}


def reads_only(element: etree._Element) -> bool:
    """Whether what names a joint in a gazebo tag is a sensor, or a plugin that publishes its state."""
    above = list(element.iterancestors("sensor", "plugin"))
    return any(e.tag == "sensor" or READS.search(f"{e.get('filename')} {e.get('name')}") for e in above)


# -- lengths that are stated -------------------------------------------------------------------------------------------


class Stated(NamedTuple):
    """A length of the base that a file states, and where; of the wheels of a side, or of all."""

    value: float  # as the controller works with it, with its multipliers [m]
    text: str
    nominal: float  # without them [m]
    side: str = ""


def stated(rest: AtRest, controllers: str | None, names: dict[str, float]) -> list[Stated]:
    """Lengths that plugins and the controllers' file state under some names, each value once; errors of `lines_of`."""
    found, lengths = dict[tuple[float, str], Stated](), list[Stated]()
    for e in rest.document.root.iterfind("gazebo//*"):
        if e.tag in names and not number_problem(text := (e.text or "").strip(), 1):
            value = float(text) * names[e.tag]
            lengths.append(Stated(value, f"<{e.tag}> (line {e.sourceline})", value))
    for length in (*lengths, *in_yaml(controllers, names)):
        if length.value > 0:
            found.setdefault((round(length.value, 9), length.side), length)
    return list(found.values())


def in_yaml(file: str | None, names: dict[str, float]) -> Iterator[Stated]:
    """Lengths that a controllers' file states under some names, one for each side where they differ."""
    for table in mappings_of(file).values():
        for key in [key for key in table if key in names]:
            nominal = number_of(table, key, 0.0) * names[key]
            where = f"{Path(file or '').name}, line {table[key].line}"
            known = {side: multipliers(table, key, side) for side in SIDES}
            for side, factors in ({"": known["left"]} if known["left"] == known["right"] else known).items():
                value = nominal * abs(math.prod(factors.values()))
                times = "".join(f" times {name} {factor:g}" for name, factor in factors.items())
                yield Stated(value, f"{key} ({where}){times}", nominal, side)


def multipliers(table: YamlTable, key: str, side: str) -> dict[str, float]:
    """Factors by which a table's controller multiplies one of its lengths on a side; ones are left out."""
    names = [name.format(side=side) for name in FACTORS.get(key, ())]
    factors = {name: number_of(table, name, 1.0) for name in names}
    return {name: factor for name, factor in factors.items() if factor not in (0.0, 1.0)}


# -- YAML files of the robot's controllers -----------------------------------------------------------------------------


class YamlEntry(NamedTuple):
    """A key of a YAML file: its value as words, those of a list on lines of their own, and its line."""

    words: list[str]
    line: int

    @property
    def text(self) -> str:
        """The value, the items of a list with blanks between them."""
        return " ".join(self.words)

    @property
    def items(self) -> tuple[str, ...]:
        """The items of a list, or the one value."""
        return tuple(re.findall(r"[^\s'\"\[\],{}]+", self.text))


YamlTable = dict[str, YamlEntry]


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


def require_controllers(file: str | None) -> None:
    """Refuse a file none of whose keys is one of controllers (`ConfigError`); errors as of `lines_of`."""
    if file is not None and not any(CONTROLLING.search(key) for table in mappings_of(file).values() for key in table):
        why = "none of its keys tells a type, a joint, or a length of wheels"
        fix = "name the YAML file of the robot's controllers"
        raise ConfigError("names no controller", why=why, fix=fix, file=file, key="controllers_file")


def mappings_of(file: str | None) -> dict[tuple[str, ...], YamlTable]:
    """The mappings of a controllers' file by the keys above them, each by its own, the last part of those with dots."""
    tables: dict[tuple[str, ...], YamlTable] = {}
    above: list[tuple[int, str]] = []
    last: YamlEntry | None = None
    for number, line in lines_of(file):
        word, indent = line.strip(), len(line) - len(line.lstrip())
        if word.startswith("- ") and last:
            last.words.append(word[2:])
        elif hit := KEY.match(word):
            above = [(i, name) for i, name in above if i < indent]
            path = tuple(name for _, name in above)
            last = YamlEntry([hit[2].strip(" '\"")], number)
            tables.setdefault(path, {})[hit[1].rpartition(".")[2]] = last
            above.append((indent, hit[1]))
            inner = tables.setdefault((*path, hit[1]), {})
            for one in FLOW.finditer(hit[2]):
                inner[one[1].rpartition(".")[2]] = YamlEntry([one[2].strip(" '\"")], number)
    return tables


def number_of(table: YamlTable, key: str, default: float) -> float:
    """A number of a table, the default where there is none."""
    text = table[key].text if key in table else ""
    return default if not text or number_problem(text, 1) else float(text)


def beside(rest: AtRest) -> list[Path]:
    """YAML files of the package that a robot's file is in, and of those beside it that have its name."""
    package = Path(package_of(str(rest.document.path.parent.absolute())))
    stem = re.sub(r"_?(description|model|urdf)$", "", package.name)
    folders = [package, *(f for f in siblings(package) if stem and f.name.startswith(stem) and f != package)]
    places = [folder / place for folder in folders for place in ("", "config", "params")]
    files = [file for place in places for file in place.glob("*.y*ml")]
    return [file for file in files[:YAMLS] if is_readable(file)]


def is_readable(file: Path) -> bool:
    """Whether a file is a plain text of bounded size: what merely lies there keeps no robot from being loaded."""
    try:
        lines_of(str(file))
    except ConfigError:
        return False
    return True


def own_package(rest: AtRest) -> Path | None:
    """The ROS package that a robot's file is in, None where no `package.xml` marks one."""
    folder = Path(package_of(str(rest.document.path.parent.absolute())))
    return folder if (folder / "package.xml").is_file() else None


def siblings(folder: Path) -> list[Path]:
    """Packages in the folder that holds one, none where it is no package."""
    if not (folder / "package.xml").is_file():
        return []
    return sorted(file.parent for file in folder.parent.glob("*/package.xml"))
