"""A URDF file, read strictly: what would make a loader guess, drop or crash is refused with its line.

Pinocchio's parser drops a whole `<inertial>` over one bad number and hides the reasons of its refusals on C++ stderr,
so the file is audited here first. A check is a function from the `<robot>` element to its findings; `audit` runs them
all, `read` raises the first. What passes is also what Pinocchio gets: `Document.text` is the parsed tree written out
again, free of declarations, comments and namespaces.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from lxml import etree

from mmnn_pin.errors import RobotError
from mmnn_pin.signals import Array

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
MAX_JOINTS, MAX_LINKS = (
    200,
    2000,
)  # Pinocchio's memory grows with the cube of the joints; 4000 links in a chain crash it
TEN_TURNS = 20 * math.pi  # a revolute joint with more travel than this [rad] counts as unlimited

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
# Attributes that hold numbers: how many, by element; those in REQUIRED must be there.
NUMBERS: dict[str, dict[str, int]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "box": {"size": 3},
    "mesh": {"scale": 3},
}
REQUIRED: dict[str, tuple[str, ...]] = {
    "axis": ("xyz",),
    "mass": ("value",),
    "inertia": tuple(NUMBERS["inertia"]),
    "limit": ("effort", "velocity"),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "box": ("size",),
}
OTHER_FORMATS = {"mujoco": "MJCF (MuJoCo)", "sdf": "SDF (Gazebo)", "model": "SDF (Gazebo)", "COLLADA": "a COLLADA mesh"}
XACRO_FIX = "expand it first: xacro FILE > robot.urdf"


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a file.

    Attributes:
        code: Stable name of the check.
        line: Line in the file, counted from 1.
        what: The element and what is wrong with it.
        why: What it would lead to.
        fix: What to do.
    """

    code: str
    line: int
    what: str
    why: str = ""
    fix: str = ""

    def error(self, path: Path) -> RobotError:
        """The finding as an exception."""
        return RobotError(self.what, why=self.why, fix=self.fix, file=path, line=self.line)


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint as the file states it.

    Attributes:
        name: Its name.
        type: One of `JOINT_TYPES`.
        parent: Link it hangs on.
        child: Link it carries.
        origin: (4, 4) placement of the child's frame in the parent's, at position 0.
        axis: (3,) unit axis in the child's frame (a fixed joint's may be zero).
        lower: Lower limit [rad or m], -inf when unlimited.
        upper: Upper limit [rad or m], inf when unlimited.
        effort: Largest torque or force [N m or N]; inf when the file states none or 0.
        damping: Viscous friction [N m s or N s/m].
        friction: Coulomb friction [N m or N].
        mimics: Joint that it follows, None for an ordinary joint.
        line: Line in the file.
    """

    name: str
    type: str
    parent: str
    child: str
    origin: Array
    axis: Array
    lower: float
    upper: float
    effort: float
    damping: float
    friction: float
    mimics: str | None
    line: int

    @property
    def moves(self) -> bool:
        """Whether it is more than a weld."""
        return self.type != "fixed"

    @property
    def turns_freely(self) -> bool:
        """Whether it can turn without end."""
        return self.type == "continuous" or (self.type == "revolute" and self.upper - self.lower >= TEN_TURNS)

    @property
    def rest(self) -> float:
        """Position at rest: 0 clipped into the limits [rad or m]."""
        return min(max(0.0, self.lower), self.upper)

    @classmethod
    def of(cls, element: etree._Element) -> Joint:
        """Joint of an audited `<joint>` element."""
        kind, limit, dynamics = element.get("type"), element.find("limit"), element.find("dynamics")
        limited = kind in ("revolute", "prismatic")
        mimic = element.find("mimic")
        axis = vector(element.find("axis"), "xyz", (1.0, 0.0, 0.0))
        return cls(
            name=element.get("name"),
            type=kind,
            parent=element.find("parent").get("link"),
            child=element.find("child").get("link"),
            origin=placement(element.find("origin")),
            axis=axis / (np.linalg.norm(axis) or 1.0),
            lower=number(limit, "lower", 0.0) if limited else -math.inf,
            upper=number(limit, "upper", 0.0) if limited else math.inf,
            effort=number(limit, "effort", 0.0) or math.inf,
            damping=number(dynamics, "damping", 0.0),
            friction=number(dynamics, "friction", 0.0),
            mimics=None if mimic is None else mimic.get("joint"),
            line=element.sourceline,
        )


@dataclass(frozen=True, eq=False)
class Document:
    """A URDF that passed the audit.

    Attributes:
        path: File it came from.
        text: The XML that Pinocchio reads.
        sha256: Hash of the file's bytes.
        root: The `<robot>` element.
    """

    path: Path
    text: str
    sha256: str
    root: etree._Element

    @cached_property
    def links(self) -> dict[str, etree._Element]:
        """Links by name, in the order of the file."""
        return {link.get("name"): link for link in self.root.iterchildren("link")}

    @cached_property
    def joints(self) -> dict[str, Joint]:
        """Joints by name, in the order of the file."""
        return {joint.get("name"): Joint.of(joint) for joint in self.root.iterchildren("joint")}

    @cached_property
    def children(self) -> dict[str, list[Joint]]:
        """For every link the joints that hang on it."""
        table: dict[str, list[Joint]] = {link: [] for link in self.links}
        for joint in self.joints.values():
            table[joint.parent].append(joint)
        return table

    @cached_property
    def carrier(self) -> dict[str, Joint]:
        """For every link but the root the joint that carries it."""
        return {joint.child: joint for joint in self.joints.values()}

    @property
    def root_link(self) -> str:
        """The link that no joint carries."""
        return next(link for link in self.links if link not in self.carrier)

    def body(self, link: str) -> list[str]:
        """Links of the moving body that starts at a link: itself and everything fixed to it."""
        links = [link]
        for name in links:
            links.extend(joint.child for joint in self.children[name] if not joint.moves)
        return links

    def moving_children(self, link: str) -> list[Joint]:
        """Moving joints that hang on the body of a link."""
        return [joint for name in self.body(link) for joint in self.children[name] if joint.moves]

    def moving_ancestors(self, link: str) -> list[Joint]:
        """Moving joints between a link and the root, from the link up; the joint that carries the link included."""
        joints = []
        while link in self.carrier:
            joint = self.carrier[link]
            joints += [joint] if joint.moves else []
            link = joint.parent
        return joints


def read(path: str | Path) -> Document:
    """Read and audit a URDF file.

    Args:
        path: The file.

    Raises:
        RobotError: The file cannot be read, is not a URDF, or the audit found something; the first finding is told.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise RobotError("no such file", file=path) from None
    except IsADirectoryError:
        raise RobotError("is a folder, not a URDF file", file=path) from None
    except OSError as error:
        raise RobotError(f"cannot be read ({error.strerror})", file=path) from None
    return parse(data, path)


def parse(data: bytes, path: str | Path) -> Document:
    """Audit a URDF given as bytes.

    Args:
        data: The file's content.
        path: Name for messages, and the place that relative mesh paths start from.

    Raises:
        RobotError: As in `read`.
    """
    path = Path(path)
    root = parse_xml(data, path)
    for finding in audit(root):
        raise finding.error(path)
    text = etree.tostring(root, encoding="unicode")
    return Document(path, text, hashlib.sha256(data).hexdigest(), root)


def parse_xml(data: bytes, path: Path) -> etree._Element:
    """The `<robot>` element of an XML file, without comments and default namespaces.

    Raises:
        RobotError: Not XML, a DOCTYPE, or another format.
    """
    doctype = data.find(b"<!DOCTYPE")
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, huge_tree=False, remove_comments=True, remove_pis=True
    )
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        reason = str(error.msg).split(", line ")[0]
        if "prefix xacro" in reason:
            raise RobotError("this is xacro, not yet a URDF", fix=XACRO_FIX, file=path, line=error.lineno) from None
        raise RobotError(
            f"not well-formed XML ({reason})", why="cut off or damaged?", file=path, line=error.lineno
        ) from None
    if root.getroottree().docinfo.doctype:
        why = "entities could pull in other files or blow up"
        line = data.count(b"\n", 0, max(doctype, 0)) + 1
        raise RobotError("has a DOCTYPE", why=why, fix="delete it", file=path, line=line)
    for element in root.iter("*"):
        if element.prefix is None:
            element.tag = etree.QName(element).localname
    if root.tag != "robot":
        known = OTHER_FORMATS.get(root.tag, f"a file whose root is <{root.tag}>")
        fix = "convert it to URDF (root element <robot>)"
        raise RobotError(f"this is {known}, not a URDF", fix=fix, file=path, line=root.sourceline)
    return root


def audit(root: etree._Element) -> list[Finding]:
    """All findings about a `<robot>` element, in the order of the checks; empty when it may be loaded."""
    findings = [finding for check in CHECKS for finding in check(root)]
    return findings or list(massless_bodies(root))  # bodies can be judged only in a sound tree


def unexpanded_xacro(root: etree._Element) -> Iterator[Finding]:
    """Xacro elements, and `${...}` or `$(...)` in attributes of links and joints."""
    for element in root.iter("*"):
        name = etree.QName(element)
        if "xacro" in (name.namespace or "").lower():
            what = f"<xacro:{name.localname}> is xacro, not yet a URDF"
            yield Finding("xacro", element.sourceline, what, fix=XACRO_FIX)
    for element in own_elements(root):
        for key, value in element.attrib.items():
            if "${" in value or "$(" in value:
                what = f"{label(element)}: {key} '{value}' is an unexpanded xacro expression"
                yield Finding("xacro", element.sourceline, what, fix=XACRO_FIX)


def bad_numbers(root: etree._Element) -> Iterator[Finding]:
    """Numbers that are missing, not numbers, not finite or not as many as they should be."""
    for element in own_elements(root):
        for key, count in NUMBERS.get(element.tag, {}).items():
            text = element.get(key)
            if text is None and key not in REQUIRED.get(element.tag, ()):
                continue
            if problem := number_problem(text, count):
                what = f"{label(element)}: {key} of <{element.tag}> {problem}"
                why = "the whole inertial would be dropped" if element.tag in ("mass", "inertia") else ""
                yield Finding("number", element.sourceline, what, why, f"give {count} finite number(s) in SI units")


def number_problem(text: str | None, count: int) -> str:
    """What is wrong with a list of numbers, empty when nothing is."""
    if text is None:
        return "is missing"
    words = text.split()
    for word in words:
        if not NUMBER.fullmatch(word):
            hint = " (decimal comma?)" if "," in word else ""
            return f"is '{text}': '{word}' is not a finite number{hint}"
        if not math.isfinite(float(word)):
            return f"is '{text}': '{word}' is beyond what a double holds"
    return "" if len(words) == count else f"is '{text}': {len(words)} number(s) where {count} are needed"


def incomplete_inertials(root: etree._Element) -> Iterator[Finding]:
    """`<inertial>` without mass or inertia, which would be dropped in silence."""
    for link in root.iterchildren("link"):
        for inertial in link.iterchildren("inertial"):
            for tag in ("mass", "inertia"):
                if inertial.find(tag) is None:
                    what, why = f"{label(inertial)}: <{tag}> is missing", "the whole inertial would be dropped"
                    yield Finding("inertial", inertial.sourceline, what, why, f"add <{tag}>")


def bad_names(root: etree._Element) -> Iterator[Finding]:
    """Links and joints without a name, or two of the same name."""
    for tag in ("link", "joint"):
        lines: dict[str, int] = {}
        for element in root.iterchildren(tag):
            name, line = element.get("name"), element.sourceline
            if not name:
                yield Finding("name", line, f"<{tag}> has no name", fix="name it")
            elif name in lines:
                what = f"{tag} '{name}' appears twice (first in line {lines[name]})"
                yield Finding("name", line, what, fix="rename one of the two")
            else:
                lines[name] = line


def bad_tree(root: etree._Element) -> Iterator[Finding]:
    """Links and joints that do not make one tree: missing links, two parents, loops, several roots."""
    links = {link.get("name"): link for link in root.iterchildren("link")}
    if not links:
        yield Finding("tree", root.sourceline, "has no links", fix="describe at least one <link>")
    parent: dict[str, str] = {}
    for joint in root.iterchildren("joint"):
        ends: list[str] = []
        for tag in ("parent", "child"):
            end = joint.find(tag)
            ends.append("" if end is None else end.get("link", ""))
            if ends[-1] not in links:
                what = f"'{ends[-1]}' does not exist" if ends[-1] else "is missing"
                line = joint.sourceline if end is None else end.sourceline
                yield Finding("tree", line, f"{label(joint)}: {tag} link {what}", fix="name an existing link")
        above, below = ends
        if below in parent:
            what = f"{label(joint)}: link '{below}' already hangs on '{parent[below]}'"
            yield Finding("tree", joint.sourceline, what, "a URDF is a tree", "remove one of the joints")
        elif above and below:
            parent[below] = above
    roots = [name for name in links if name not in parent]
    if len(roots) > 1:
        what = f"link '{roots[1]}' hangs on nothing, and neither does '{roots[0]}'"
        yield Finding("tree", links[roots[1]].sourceline, what, "a URDF has one root", "join them")
    if links and loop(parent):
        what = f"link '{loop(parent)}' hangs on itself in a circle of joints"
        yield Finding("tree", links[loop(parent)].sourceline, what, "a URDF is a tree", "open the loop")


def loop(parent: dict[str, str]) -> str:
    """A link that is its own ancestor, empty when there is none."""
    for start in parent:
        link, seen = start, {start}
        while link in parent:
            link = parent[link]
            if link in seen:
                return link
            seen.add(link)
    return ""


def bad_joints(root: etree._Element) -> Iterator[Finding]:
    """Unknown types, zero axes, limits that are missing, reversed or negative, negative friction."""
    for joint in root.iterchildren("joint"):
        kind, line = joint.get("type"), joint.sourceline
        if kind not in JOINT_TYPES:
            fix = f"one of {', '.join(JOINT_TYPES)}"
            yield Finding("type", line, f"{label(joint)}: type '{kind}' is unknown", fix=fix)
        axis, limit, dynamics = joint.find("axis"), joint.find("limit"), joint.find("dynamics")
        stated = axis is not None and kind != "fixed" and not number_problem(axis.get("xyz"), 3)
        if stated and not any(vector(axis, "xyz")):
            yield Finding("axis", axis.sourceline, f"{label(joint)}: axis is zero", "the mass matrix would be singular")
        if kind in ("revolute", "prismatic") and limit is None:
            yield Finding("limit", line, f"{label(joint)}: <limit> is missing", f"a {kind} joint needs it", "add it")
        if kind in ("revolute", "prismatic") and value(limit, "lower") > value(limit, "upper"):
            yield Finding("limit", limit.sourceline, f"{label(joint)}: lower limit is above the upper one")
        for element, keys in ((limit, ("effort", "velocity")), (dynamics, ("damping", "friction"))):
            for key in keys:
                if value(element, key) < 0:
                    yield Finding("limit", element.sourceline, f"{label(joint)}: {key} is negative")


def too_large(root: etree._Element) -> Iterator[Finding]:
    """More joints or links than can be handled."""
    moving = sum(joint.get("type") != "fixed" for joint in root.iterchildren("joint"))
    links = len(root.findall("link"))
    for count, most, kind in ((moving, MAX_JOINTS, "moving joints"), (links, MAX_LINKS, "links")):
        if count > most:
            yield Finding("size", root.sourceline, f"has {count} {kind}", f"more than {most} are not supported")


def massless_bodies(root: etree._Element) -> Iterator[Finding]:
    """Negative masses, and moving bodies without mass once fixed links are lumped."""
    document = Document(Path(), "", "", root)
    mass = {name: number(link.find("inertial/mass"), "value", 0.0) for name, link in document.links.items()}
    for name, link in document.links.items():
        if mass[name] < 0:
            yield Finding("mass", link.sourceline, f"link '{name}': mass {mass[name]:g} kg is negative")
    for joint in document.joints.values():
        if joint.moves and sum(mass[link] for link in document.body(joint.child)) <= 0:
            what = f"link '{joint.child}': the body that joint '{joint.name}' moves has no mass"
            why = "its acceleration would be infinite"
            fix = "give it an <inertial>, or make the joint fixed"
            yield Finding("mass", document.links[joint.child].sourceline, what, why, fix)


CHECKS = (unexpanded_xacro, bad_numbers, incomplete_inertials, bad_names, bad_tree, bad_joints, too_large)


def own_elements(root: etree._Element) -> Iterator[etree._Element]:
    """Elements inside links and joints: what URDF defines, not the extensions beside them."""
    for element in root.iterchildren("link", "joint"):
        yield from element.iter("*")


def label(element: etree._Element) -> str:
    """The link or joint that an element belongs to, in words."""
    while element.getparent() is not None and element.getparent().tag != "robot":
        element = element.getparent()
    return f"{element.tag} '{element.get('name')}'"


def number(element: etree._Element | None, key: str, default: float) -> float:
    """An audited number, the default where it is not stated."""
    return default if element is None or element.get(key) is None else float(element.get(key))


def value(element: etree._Element | None, key: str) -> float:
    """A number that may be missing (0, as URDF has it) or bad (nan: compares with nothing)."""
    if element is None or element.get(key) is None:
        return 0.0
    return math.nan if number_problem(element.get(key), 1) else float(element.get(key))


def vector(element: etree._Element | None, key: str, default: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Array:
    """Audited numbers, the default where they are not stated."""
    text = None if element is None else element.get(key)
    return np.array(default if text is None else [float(word) for word in text.split()])


def placement(origin: etree._Element | None) -> Array:
    """(4, 4) transform of an `<origin>`: roll, pitch, yaw about fixed axes, then the offset."""
    result = np.eye(4)
    (cr, cp, cy), (sr, sp, sy) = np.cos(vector(origin, "rpy")), np.sin(vector(origin, "rpy"))
    result[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    result[:3, 3] = vector(origin, "xyz")
    return result
