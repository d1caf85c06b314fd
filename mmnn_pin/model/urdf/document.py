"""An audited URDF as links and joints: numbers, limits, placements, and who hangs on whom.

A number that is bad reads as nan, which judges nothing.
"""

from __future__ import annotations

import copy
import math
import re
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from lxml import etree

from ...elementary import cos, sin
from ...signals import Array
from .finding import Finding

KEPT = ("links", "joints", "children", "carrier")  # properties of a tree that are read out once
TEN_TURNS = 20 * math.pi  # a revolute joint with more travel than this [rad] counts as unlimited
NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint as the file states it."""

    name: str  # its name
    type: str  # one of `JOINT_TYPES`
    parent: str  # link it hangs on
    child: str  # link it carries
    origin: Array  # (4, 4) placement of the child's frame in the parent's, at position 0
    axis: Array  # (3,) unit axis in the child's frame (a fixed joint's may be zero)
    has_axis: bool  # whether the file states it
    lower: float  # lower limit [rad or m], -inf when unlimited
    upper: float  # upper limit [rad or m], inf when unlimited
    effort: float  # largest torque or force [N m or N]; inf when the file states none, 0 or a negative one
    rate: float  # largest rate [rad/s or m/s]; inf when the file states none, 0 or a negative one
    damping: float  # viscous friction [N m s or N s/m]
    friction: float  # Coulomb friction [N m or N]
    mimics: str | None  # joint that it follows, None for an ordinary joint
    multiplier: float  # its rate over that joint's; 1 for an ordinary joint
    offset: float  # its position where that joint's is 0 [rad or m]; 0 for an ordinary joint
    line: int  # line in the file

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
        parts = {part.tag: part for part in reversed(element)}  # of several the first one counts
        kind, limit, dynamics, mimic = element.get("type"), *map(parts.get, ("limit", "dynamics", "mimic"))
        limited = kind in ("revolute", "prismatic")
        axis = numbers(parts.get("axis"), "xyz", (1.0, 0.0, 0.0))
        return cls(
            name=element.get("name"),
            type=kind,
            parent=parts["parent"].get("link"),
            child=parts["child"].get("link"),
            origin=placement(parts.get("origin")),
            axis=np.array(axis) / (math.hypot(*axis) or 1.0),
            has_axis="axis" in parts,
            lower=number(limit, "lower", 0.0) if limited else -math.inf,
            upper=number(limit, "upper", 0.0) if limited else math.inf,
            effort=effort if (effort := number(limit, "effort", 0.0)) > 0 else math.inf,
            rate=rate if (rate := number(limit, "velocity", 0.0)) > 0 else math.inf,
            damping=number(dynamics, "damping", 0.0),
            friction=number(dynamics, "friction", 0.0),
            mimics=None if mimic is None else mimic.get("joint"),
            multiplier=number(mimic, "multiplier", 1.0),
            offset=number(mimic, "offset", 0.0),
            line=element.sourceline,
        )


@dataclass(frozen=True, eq=False)
class LinkTree:
    """Links and joints of a `<robot>` element whose names and ends are sound."""

    root: etree._Element  # the element

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

    @property
    def mass(self) -> float:
        """Mass of all links [kg]."""
        return math.fsum(number(link.find("inertial/mass"), "value", 0.0) for link in self.links.values())

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


@dataclass(frozen=True, eq=False)
class Document(LinkTree):
    """A URDF that passed the audit."""

    path: Path  # file it came from
    text: str  # the XML that Pinocchio reads
    sha256: str  # hash of the file's bytes
    findings: tuple[Finding, ...] = field(default=())  # what the audit has to say about it, warnings and notes

    @classmethod
    def of(cls, tree: LinkTree, path: Path, sha256: str, findings: tuple[Finding, ...]) -> Document:
        """Document of an audited tree, which keeps what has been read out of it."""
        document = cls(tree.root, path, text_of(tree.root), sha256, findings)
        vars(document).update({name: value for name, value in vars(tree).items() if name in KEPT})
        return document


def placement(origin: etree._Element | None) -> Array:
    """(4, 4) transform of an `<origin>`: roll, pitch, yaw about fixed axes, then the offset."""
    return transform(numbers(origin, "xyz"), numbers(origin, "rpy"))


@lru_cache(maxsize=8192)
def transform(xyz: tuple[float, ...], rpy: tuple[float, ...]) -> Array:
    """(4, 4) transform of an offset and angles, read-only: the same origins are asked for again and again."""
    (x, y, z), (roll, pitch, yaw) = xyz, rpy
    cr, cp, cy = cos(roll), cos(pitch), cos(yaw)
    sr, sp, sy = sin(roll), sin(pitch), sin(yaw)
    matrix = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, x],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, y],
            [-sp, cp * sr, cp * cr, z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    matrix.flags.writeable = False
    return matrix


def text_of(root: etree._Element) -> str:
    """A tree as text, every element on the line of the file that it came from.

    Comments are gone; where they stood are empty lines, so that what is found in the text has the lines of the file.
    """
    root, line, before = copy.deepcopy(root), 1, ""
    for event, element in etree.iterwalk(root, events=("start", "end")):
        if event == "end":
            line += (element.tail or "").count("\n") if element is not root else 0
            continue
        missing = "\n" * max(0, (element.sourceline or 0) - line)
        if element is root:
            before = missing
        elif (previous := element.getprevious()) is not None:
            previous.tail = missing + (previous.tail or "")
        else:
            parent = element.getparent()
            parent.text = missing + (parent.text or "")
        line += len(missing) + (element.text or "").count("\n")
    return before + etree.tostring(root, encoding="unicode")


# -- numbers -----------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=8192)
def read_numbers(text: str) -> tuple[float, ...]:
    """Decimal numbers; nan for each word of another kind or beyond what a double holds."""
    values = (float(word) if NUMBER.fullmatch(word) else math.nan for word in text.split())
    return tuple(math.nan if math.isinf(value) else value for value in values)


@lru_cache(maxsize=8192)
def number_problem(text: str, count: int) -> str:
    """The fault of a list of numbers, empty when there is none."""
    values = read_numbers(text)
    for word, value in zip(text.split(), values, strict=True):
        if math.isnan(value) and NUMBER.fullmatch(word):
            return f"is '{text}': '{word}' is beyond what a double holds"
        if math.isnan(value):
            between = word.endswith(",") or text.count(",") == count - 1 > 0
            hint = (
                (" (commas between numbers? write blanks)" if between else " (decimal comma?)") if "," in word else ""
            )
            return f"is '{text}': '{word}' is not a finite number{hint}"
    return "" if len(values) == count else f"is '{text}': {len(values)} number(s) where {count} are needed"


@lru_cache(maxsize=8192)
def largest(text: str | None) -> float:
    """Largest magnitude of some numbers, 0 where there are none or a bad one."""
    values = () if text is None else read_numbers(text)
    return 0.0 if any(math.isnan(value) for value in values) else max(map(abs, values), default=0.0)


def number(element: etree._Element | None, key: str, default: float) -> float:
    """A number of an attribute, the default where it is not stated, nan where it is bad."""
    text = None if element is None else element.get(key)
    if text is None:
        return default
    values = read_numbers(text)
    return values[0] if len(values) == 1 else math.nan


def numbers(
    element: etree._Element | None, key: str, default: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> tuple[float, ...]:
    """Numbers of an attribute, the default where they are not stated, nan where they are bad or not as many."""
    text = None if element is None else element.get(key)
    values = default if text is None else read_numbers(text)
    return values if len(values) == len(default) else (math.nan,) * len(default)


def vector(element: etree._Element | None, key: str, default: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Array:
    """Numbers of an attribute as an array; as of `numbers`."""
    return np.array(numbers(element, key, default))
