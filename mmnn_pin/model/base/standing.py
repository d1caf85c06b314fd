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
    """Joints with their types that place a robot in the plane, on empty links: two level slides and a vertical turn."""
    rest, link, found = AtRest(document), document.root_link, list[Joint]()
    while len(found) < 3:
        below = document.moving_children(link)
        if len(below) != 1 or any(rest.mass(name) > 0 for name in document.body(link)):
            return {}
        found.append(below[0])
        link = below[0].child
    slides = [j for j in found if j.type == "prismatic" and rest.is_horizontal(j)]
    turns = [j for j in found if j.type in ("revolute", "continuous") and rest.is_vertical(j)]
    crossed = len(slides) == 2 and len(turns) == 1 and abs(rest.axis(slides[0]) @ rest.axis(slides[1])) < HORIZONTAL
    return {j.name: j.type for j in found} if crossed else {}


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
