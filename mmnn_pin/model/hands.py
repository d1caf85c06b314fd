"""The hand of every arm: a frame at its end, and whose the joints are that lead to it.

It is the frame of a tool on the arm's last body, else the link to which an SRDF mounts the end effector, else the
middle of the jaws, which becomes a link of its own, else the link farthest out.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from lxml import etree

from ..elementary import cos_sin
from ..errors import ConfigError
from .base.base import Base
from .limbs import TOOL, Limbs
from .urdf.document import Document, text_of
from .urdf.shapes import AtRest

SIDES = (re.compile(r"left|links|gauche|izq|sinistr|zuo|(?:^|_)l(?:_|$)|^L(?=[A-Z])", re.IGNORECASE),
         re.compile(r"right|rechts|droite|derech|destr|you|(?:^|_)r(?:_|$)|^R(?=[A-Z])", re.IGNORECASE))  # fmt: skip


@dataclass(frozen=True)
class Hand:
    """The end of an arm.

    Attributes:
        frame: Its link.
        joints: Joints of the arm that lead to it, from the root on.
        why: What makes it the hand.
        on: Link that carries it, where it is none of the file's; else empty.
        at: Where it is on that link [m].
    """

    frame: str
    joints: tuple[str, ...]
    why: str
    on: str = ""
    at: tuple[float, ...] = ()


def hands_of(limbs: Limbs, moves: Sequence[str], tip: str | None = None) -> tuple[Hand, ...]:
    """The hand of every arm, that with the most joints first.

    Args:
        limbs: The branches of the robot.
        moves: Joints of its arms.
        tip: What the user names as the end.
    """
    inner = {up for name in moves for up in limbs.tree[name].above}
    ends = [name for name in moves if name not in inner]
    chains = [tuple(up for up in (*limbs.tree[end].above[::-1], end) if up in moves) for end in ends]
    chains.sort(key=lambda chain: -len(chain))
    if tip is not None:
        return tuple(Hand(tip, chain, "as you said") for chain in chains[:1])
    return tuple(hand_at(limbs, chain) for chain in chains)


def hand_at(limbs: Limbs, chain: tuple[str, ...]) -> Hand:
    """The hand at the end of a chain of joints."""
    rest, end = limbs.rest, limbs.rest.document.joints[chain[-1]]
    links = rest.document.body(end.child)
    out = {link: math.dist(rest.placements[link][:3, 3], rest.hub(end)) for link in links}
    if tools := [link for link in links if TOOL.search(link)]:
        return Hand(max(tools, key=lambda link: out[link]), chain, "the frame of a tool")
    mounts = [(group.parent, group) for group in limbs.groups if group.parent in links]
    if mounts:
        return Hand(mounts[0][0], chain, f"'{mounts[0][1].name}' is mounted on it ({mounts[0][1].where})")
    jaws = [name for name in limbs.tree[chain[-1]].below if limbs.is_jaw(name)]
    if len(jaws) > 1:
        tips = [rest.centre(rest.document.joints[limbs.tree[name].carried[-1]].child) for name in jaws]
        place = rest.placements[end.child]
        at = place[:3, :3].T @ (np.mean(tips, axis=0) - place[:3, 3])
        name = next(n for n in (f"{end.child}_hand", f"{end.child}_middle_of_jaws") if n not in rest.document.links)
        return Hand(name, chain, f"the middle of {' and '.join(jaws)}", end.child, tuple(map(float, at)))
    return Hand(max(links, key=lambda link: out[link]), chain, "the link farthest out")


def placed(document: Document, hands: Sequence[Hand]) -> Document:
    """A document with links for hands that are none of its own."""
    new = [hand for hand in hands if hand.on]
    if not new:
        return document
    root = copy.deepcopy(document.root)
    for hand in new:
        etree.SubElement(root, "link", name=hand.frame)
        joint = etree.SubElement(root, "joint", name=f"{hand.frame}_joint", type="fixed")
        etree.SubElement(joint, "origin", xyz=" ".join(map(repr, hand.at)))
        etree.SubElement(joint, "parent", link=hand.on)
        etree.SubElement(joint, "child", link=hand.frame)
    return replace(document, root=root, text=text_of(root))


def of_other_arm(rest: AtRest, base: Base, hands: Sequence[Hand], arm: str | None) -> list[str]:
    """Joints of the arm that is not the one which the user wants; what both share moves.

    Raises:
        ConfigError: There are not two arms.
    """
    if arm is None:
        return []
    if len(hands) != 2:
        what, why = f"'{arm}' of two arms", f"'{rest.document.path.stem}' has {len(hands) or 'none'}"
        fix = "leave --arm out, or name the end of the arm with --arm-tip LINK"
        raise ConfigError(what, why=why, fix=fix, file=rest.document.path, key="arm")
    pairs = ((hands[0], hands[1]), (hands[1], hands[0]))
    own = [[name for name in hand.joints if name not in other.joints] for hand, other in pairs]
    named = [[any(side.search(name) for name in joints) for side in SIDES] for joints in own]
    c, s = cos_sin(float(base.frame[2]) if base.columns else 0.0)
    places = [np.mean([rest.hub(rest.document.joints[name]) for name in joints], axis=0) for joints in own]
    y = [float(c * place[1] - s * place[0]) for place in places]
    left = int(named[1][0]) if named[0] != named[1] and named[0][0] != named[1][0] else int(y[1] > y[0])
    return {"left": own[1 - left], "right": own[left], "both": []}[arm]
