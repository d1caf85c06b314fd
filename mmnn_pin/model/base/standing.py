"""What is welded: joints that stand a robot in the world, which the loader welds, and wheels that a file has welded."""

from __future__ import annotations

import copy
import math
import re
from dataclasses import replace

import numpy as np

from ..urdf.document import Document, Joint
from ..urdf.shapes import HORIZONTAL, AtRest
from ..urdf.xml import text_of
from .base import Base
from .overrides import Overrides
from .report import Reading, undecided
from .wheels import LOW, TOUCHING, Candidate, coaxial, height_at

WHEEL_NAMES = re.compile(r"wheel|whl", re.IGNORECASE)

NOTHING = 0.05  # of the mass of a robot: what simulators ask for of an empty link


def welded(document: Document) -> tuple[Document, dict[str, str]]:
    """The robot with its planar and floating joints welded, and those of a virtual x, y and yaw; and what they were."""
    kinds = {joint.name: joint.type for joint in document.joints.values() if joint.type in ("planar", "floating")}
    kinds |= virtual_joints(document)
    if not kinds:
        return document, {}
    root = copy.deepcopy(document.root)
    for element in root.iterchildren("joint"):
        if element.get("name") in kinds:
            element.set("type", "fixed")
    return replace(document, root=root, text=text_of(root)), kinds


def virtual_joints(document: Document) -> dict[str, str]:
    """Joints with their types that place a robot in the plane: two level slides and a vertical turn.

    Their links are empty, but for the little mass that some simulators ask for.
    """
    rest, link, found = AtRest(document), document.root_link, list[Joint]()
    mass = NOTHING * sum(rest.masses.values())
    while len(found) < 3:
        below = document.moving_children(link)
        if len(below) != 1 or any(rest.mass(name) > mass or shaped(rest, name) for name in document.body(link)):
            return {}
        found.append(below[0])
        link = below[0].child
    if not document.moving_children(link):  # they are all that it can do
        return {}
    slides = [j for j in found if j.type == "prismatic" and rest.is_horizontal(j)]
    turns = [j for j in found if j.type in ("revolute", "continuous") and rest.is_vertical(j)]
    crossed = len(slides) == 2 and len(turns) == 1 and abs(rest.axis(slides[0]) @ rest.axis(slides[1])) < HORIZONTAL
    return {j.name: j.type for j in found} if crossed else {}


def shaped(rest: AtRest, link: str) -> bool:
    """Whether a link that weighs something has a shape, too."""
    return rest.mass(link) > 0 and rest.document.links[link].find(".//geometry") is not None


def require_rolling(rest: AtRest, base: Base, welds: dict[str, str], overrides: Overrides) -> None:
    """Refuse to take a robot as an arm on a stand whose root moves in the plane.

    Raises:
        Undecided: It does, and has no wheels.
    """
    moves = [name for name, kind in welds.items() if kind != "floating"]
    if moves and not base.columns and overrides.base is None:
        why = f"its root moves in the plane by {', '.join(moves)}, and no wheel is found"
        rolls, still = Reading("holonomic", (why,)), Reading("fixed", ("no wheel is found",))
        fix = "--base holonomic drives it by forces on its frame; --base fixed takes it as an arm"
        raise undecided(rest, [], [rolls, still], why, fix, rest.document.joints[moves[0]].line)


# -- wheels that cannot turn -------------------------------------------------------------------------------------------


def welded_wheels(rest: AtRest, floor: float) -> list[Joint]:
    """Fixed joints with wheels that cannot turn: those that keep their axis, and those with cylinders on the floor.

    A file made for planning often has its casters and wheels welded so.
    """
    return list(dict.fromkeys([*welded_axles(rest), *welded_cylinders(rest, floor), *welded_by_name(rest)]))


def welded_by_name(rest: AtRest) -> list[Joint]:
    """Two or more fixed joints at the end of the root's body whose links are called wheels, low on it.

    A name makes the loader ask here, where geometry has nothing to say.
    """
    highest = height_at(rest, LOW)
    body = rest.document.body(rest.document.root_link)[1:]
    ends = [
        rest.document.carrier[name] for name in body if WHEEL_NAMES.search(name) and not rest.document.children[name]
    ]
    low = [joint for joint in ends if rest.hub(joint)[2] <= highest]
    return low if len(low) >= 2 else []


def welded_cylinders(rest: AtRest, floor: float) -> list[Joint]:
    """Fixed joints at the end of the root's body with a cylinder that lies on the floor on an axis shared by two."""
    document, found = rest.document, []
    for name in document.body(document.root_link)[1:]:
        joint = document.carrier[name]
        if not document.children[name]:
            lying = [s for s in rest.primitives[name] if s.kind == "cylinder" and s.rolls]
            touching = [s for s in lying if abs(s.lowest - floor) <= TOUCHING * s.radius]
            found += [Candidate(joint, s.pose[:3, 2], s.pose[:3, 3], s.radius, "cylinder") for s in touching]
    return [c.joint for c in found if any(coaxial(c, o) for o in found if o.joint is not c.joint)]


def welded_axles(rest: AtRest) -> list[Joint]:
    """Fixed joints that keep a horizontal axis shared by two, on the lowest bodies."""
    with_axis = {e.get("name") for e in rest.document.root.iterchildren("joint") if e.find("axis") is not None}
    ends = [j for j in rest.document.joints.values() if not j.moves and not rest.document.children[j.child]]
    ends = [j for j in ends if j.name in with_axis and np.any(j.axis) and rest.mass(j.child) > 0]
    stated = [j for j in ends if rest.is_horizontal(j) and not rest.document.moving_ancestors(j.child)]
    hubs = [Candidate(j, rest.axis(j), rest.hub(j), math.nan, "unknown") for j in stated]
    pairs = [(a, b) for a in hubs for b in hubs if a is not b and coaxial(a, b)]
    lowest = min((p[2, 3] for name, p in rest.placements.items() if rest.mass(name) > 0), default=math.inf)
    return [a.joint for a, b in pairs if a.centre[2] - lowest < 0.5 * np.linalg.norm(a.centre - b.centre)]
