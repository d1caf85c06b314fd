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
    """The end of an arm."""

    frame: str  # its link
    joints: tuple[str, ...]  # joints of the arm that lead to it, from the root on
    why: str  # what makes it the hand
    on: str = ""  # link that carries it, where it is none of the file's; else empty
    at: tuple[float, ...] = ()  # where it is on that link [m]


def hands_of(limbs: Limbs, moves: Sequence[str], tip: str | None = None) -> tuple[Hand, ...]:
    """The hand of every arm, that with the most joints first.

    Args:
        limbs: The branches of the robot.
        moves: Joints of its arms.
        tip: What the user names as the end.
    """
    inner = {up for name in moves for up in limbs.tree[name].above}
    ends = [(*limbs.tree[name].above[::-1], name) for name in moves if name not in inner]
    chains = sorted((tuple(up for up in end if up in moves) for end in ends), key=lambda chain: -len(chain))
    if tip is not None:
        return tuple(Hand(tip, chain, "as you said") for chain in chains[:1])
    return tuple(hand_at(limbs, chain) for chain in chains)


def hand_at(limbs: Limbs, chain: tuple[str, ...]) -> Hand:
    """The hand at the end of a chain of joints."""
    rest, document = limbs.rest, limbs.rest.document
    root, roles = document.joints[chain[-1]].child, limbs.roles
    place, out = rest.placements[root], dict[str, float]()
    for link in document.body(root):
        out[link] = math.dist(rest.placements[link][:3, 3], place[:3, 3])
    farthest = max(out, key=lambda link: (TOOL.search(link) is not None, out[link]))
    if TOOL.search(farthest):
        return Hand(farthest, chain, "the frame of a tool")
    for group in limbs.groups:
        if group.parent in out:
            return Hand(group.parent, chain, f"'{group.name}' is mounted on it ({group.where})")
    jaws = [name for name in limbs.tree[chain[-1]].below if roles.get(limbs.followers.get(name, name)) == "jaw"]
    if len(jaws) < 2:
        return Hand(farthest, chain, "the link farthest out")
    tips = [rest.centre(document.joints[limbs.tree[name].carried[-1]].child) for name in jaws]
    at = place[:3, :3].T @ (np.mean(tips, axis=0) - place[:3, 3])
    frame = f"{root}_hand" if f"{root}_hand" not in document.links else f"{root}_middle_of_jaws"
    return Hand(frame, chain, f"the middle of {' and '.join(jaws)}", root, tuple(map(float, at)))


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
    own = [[name for name in hand.joints if name not in other.joints] for hand, other in (hands, hands[::-1])]
    named = [[any(side.search(name) for name in joints) for side in SIDES] for joints in own]
    c, s = cos_sin(float(base.frame[2]) if base.columns else 0.0)
    y = [float(np.mean([(-s, c) @ rest.hub(rest.document.joints[name])[:2] for name in joints])) for joints in own]
    left = int(named[1][0]) if named[0] != named[1] and named[0][0] != named[1][0] else int(y[1] > y[0])
    return {"left": own[1 - left], "right": own[left], "both": []}[arm]
