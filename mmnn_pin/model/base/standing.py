"""Joints that stand a robot in the world, which a simulator's file has: they are welded, here the loader does that."""

from __future__ import annotations

import copy
from dataclasses import replace

from ..urdf.document import Document, Joint
from ..urdf.shapes import HORIZONTAL, AtRest
from ..urdf.xml import text_of
from .base import Base
from .overrides import Overrides
from .report import Reading, undecided

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
