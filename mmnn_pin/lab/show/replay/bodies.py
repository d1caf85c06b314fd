"""The moving bodies of a robot as a tree, and the tips of its arms. Links fixed to one another are one body."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ....model.robot import Robot
from ....model.urdf.document import Document, Joint
from ....signals import Array

MOST_TIPS = 4  # more ends than this are fingers: only the one with the most joints before it is traced


@dataclass(frozen=True, eq=False)
class Body:
    """A moving body: the root, or what one joint carries.

    Attributes:
        parent: Index of the body it hangs on; -1 for the root.
        origin: (4, 4) its placement on the parent with the joint at 0.
        joint: The joint that carries it; None for the root.
    """

    parent: int
    origin: Array
    joint: Joint | None

    def for_page(self, robot: Robot) -> dict[str, Any]:
        """What the page needs to move it: `column` is the joint's place in a position."""
        if self.joint is None:
            return {"parent": -1, "origin": columns(np.eye(4)), "kind": "root"}
        kind = "prismatic" if self.joint.type == "prismatic" else "revolute"
        column = robot.position_names.index(self.joint.name)
        moved = {"kind": kind, "axis": self.joint.axis.tolist(), "column": column}
        return {"parent": self.parent, "origin": columns(self.origin), **moved}


@dataclass(frozen=True, eq=False)
class Tree:
    """The bodies of a robot.

    Attributes:
        document: The URDF.
        bodies: Parents before their children.
        places: For every link the index of its body and its (4, 4) placement on it.
    """

    document: Document
    bodies: list[Body]
    places: dict[str, tuple[int, Array]]

    @classmethod
    def of(cls, document: Document) -> Tree:
        """Tree of a URDF whose joints are fixed, revolute, continuous or prismatic."""
        root = document.root_link
        bodies, places = [Body(-1, np.eye(4), None)], {root: (0, np.eye(4))}
        pending = [root]
        while pending:
            link = pending.pop()
            body, place = places[link]
            for joint in document.children[link]:
                at = place @ joint.origin
                places[joint.child] = (len(bodies), np.eye(4)) if joint.moves else (body, at)
                bodies += [Body(body, at, joint)] if joint.moves else []
                pending.append(joint.child)
        return cls(document, bodies, places)

    def tips(self, robot: Robot) -> list[dict[str, Any]]:
        """The tips of a robot's arms, as the page reads them: a body and a point on it [m]."""
        named = robot.overrides.arm_tip
        links = [named] if named else [self.end_of(joint) for joint in self.last_joints(robot)]
        return [{"body": self.places[link][0], "point": self.places[link][1][:3, 3].tolist()} for link in links]

    def last_joints(self, robot: Robot) -> list[str]:
        """The last joint of every arm."""
        arm, joints = set(robot.joint_names), self.document.joints
        before = {name: arm & {j.name for j in self.document.moving_ancestors(joints[name].parent)} for name in arm}
        ends = [name for name in robot.joint_names if not any(name in others for others in before.values())]
        return ends if len(ends) <= MOST_TIPS else [max(ends, key=lambda name: len(before[name]))]

    def end_of(self, joint: str) -> str:
        """The link that is farthest from a joint, of those on the body that it carries."""
        return max(
            self.document.body(self.document.joints[joint].child),
            key=lambda link: math.hypot(*self.places[link][1][:3, 3]),
        )


def columns(transform: Array) -> list[float]:
    """The 16 numbers of a (4, 4) transform, column after column as three.js has them."""
    return [round(float(number), 9) for number in transform.T.ravel()]
