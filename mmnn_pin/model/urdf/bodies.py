"""Mass and inertia of the bodies that move: links that are fixed to each other count as one.

A link alone may have no mass or a degenerate inertia; what accelerates is the body they make together.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from lxml import etree

from mmnn_pin.signals import Array

from .document import Joint, Tree, placement
from .finding import Finding, finding
from .reading import number

KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
ROUNDING = 1e-3  # of the largest principal inertia: files print few digits
POSITIVE = 1e-9  # of the largest principal inertia: less is zero
HEAVY = 10_000.0  # [kg]
WIDE = 10.0  # radius of gyration [m]


@dataclass(frozen=True, eq=False)
class Part:
    """A link as a part of a body.

    Attributes:
        link: Its element.
        mass: [kg].
        frame: (4, 4) placement of its inertial in the frame of the body's first link.
        inertia: (3, 3) about its centre of mass, along the axes of its frame [kg m^2].
    """

    link: etree._Element
    mass: float
    frame: Array
    inertia: Array

    @classmethod
    def of(cls, link: etree._Element, pose: Array) -> Part:
        """A link whose frame has the pose (4, 4)."""
        inertial = link.find("inertial")
        if inertial is None:
            return cls(link, 0.0, pose, np.zeros((3, 3)))
        parts = {part.tag: part for part in reversed(inertial)}  # of several the first one counts
        frame, element = pose @ placement(parts.get("origin")), parts.get("inertia")
        xx, xy, xz, yy, yz, zz = [number(element, key, 0.0) for key in KEYS]
        inertia = np.array([xx, xy, xz, xy, yy, yz, xz, yz, zz]).reshape(3, 3)
        return cls(link, number(parts.get("mass"), "value", 0.0), frame, inertia)


def bad_bodies(tree: Tree) -> Iterator[Finding]:
    """Findings about all bodies, the root's included; needs a sound tree, bad numbers judge nothing."""
    whole: list[tuple[list[Part], Joint | None]] = []
    for start, joint in [(tree.root_link, None), *((j.child, j) for j in tree.joints.values() if j.moves)]:
        parts = parts_of(tree, start)
        for part in parts:
            if part.mass < 0:
                what = f"mass {part.mass:g} kg is negative"
                yield finding("negative-mass", part.link, what, "nothing has such a mass", "give a mass above 0")
        mass = sum(part.mass for part in parts)
        if joint is not None and mass == 0 and not carries_mass(tree, joint):
            what = f"the body that joint '{joint.name}' moves has no mass, nor has what hangs on it"
            why, fix = "its acceleration could be infinite", "give it an <inertial>, or make the joint fixed"
            yield finding("zero-mass", tree.links[start], what, why, fix)
        elif mass > 0 and all(part.mass >= 0 for part in parts):
            whole.append((parts, joint))
    with np.errstate(over="ignore", invalid="ignore"):
        inertias = np.array([lumped(parts) for parts, _ in whole]).reshape(-1, 3, 3)
    finite = np.isfinite(inertias).all(axis=(1, 2))
    principal = np.linalg.eigvalsh(np.where(finite[:, None, None], inertias, np.eye(3)))
    for (parts, joint), values, judged in zip(whole, principal.tolist(), finite, strict=True):
        if judged:
            yield from bad_inertia(parts, joint, values)


def carries_mass(tree: Tree, joint: Joint) -> bool:
    """Whether something with mass hangs on a body: then the mass matrix tells whether the body can be accelerated."""
    pending = tree.moving_children(joint.child)
    while pending:
        below = pending.pop()
        if any(part.mass for part in parts_of(tree, below.child)):
            return True
        pending += tree.moving_children(below.child)
    return False


def parts_of(tree: Tree, start: str) -> list[Part]:
    """The links of the body that starts at a link."""
    poses, names = {start: np.eye(4)}, [start]
    for name in names:
        for joint in tree.children[name]:
            if not joint.moves:
                poses[joint.child] = poses[name] @ joint.origin
                names.append(joint.child)
    return [Part.of(tree.links[name], pose) for name, pose in poses.items()]


def bad_inertia(parts: list[Part], joint: Joint | None, principal: list[float]) -> Iterator[Finding]:
    """An inertia that no body can have, or that a robot's hardly has; the root's may vanish, it may never turn."""
    low, middle, high = principal
    mass = sum(part.mass for part in parts)
    whose = "the root's body" if joint is None else f"the body that joint '{joint.name}' moves"
    values = f"principal inertias {low:.3g}, {middle:.3g}, {high:.3g} kg m^2"
    if low < -POSITIVE * abs(high) or high < 0 or (joint is not None and low <= POSITIVE * high):
        what = f"the inertia of {whose} is not positive definite ({values})"
        why, fix = "its acceleration could be infinite or against the torque", "compute it from the mesh and the mass"
        yield finding("inertia-not-positive", to_blame(parts), what, why, fix)
    elif joint is not None and high > low + middle + ROUNDING * high:
        what = f"the inertia of {whose} violates the triangle inequality ({values})"
        yield finding(
            "inertia-triangle", to_blame(parts), what, "no body has it; taken as it is", "compute it from the mesh"
        )
    if mass > HEAVY:
        what = f"the mass of {whose} is {mass:.4g} kg"
        yield finding("odd-mass", parts[0].link, what, "is the file in grams? taken as kg", "give kg")
    elif high > mass * WIDE**2:
        what = f"the inertia of {whose} is that of something {2 * (high / mass) ** 0.5:.3g} m wide ({values})"
        yield finding("odd-inertia", to_blame(parts), what, "is it in kg mm^2? taken as kg m^2", "give kg m^2")


def lumped(parts: list[Part]) -> Array:
    """(3, 3) inertia of a body about its centre of mass, by Huygens and Steiner; of one part along its own axes."""
    heavy = [part for part in parts if part.mass or part.inertia.any()]
    if len(heavy) == 1:
        return heavy[0].inertia
    masses, frames = np.array([part.mass for part in heavy]), np.array([part.frame for part in heavy])
    R, place = frames.reshape(-1, 4, 4)[:, :3, :3], frames.reshape(-1, 4, 4)[:, :3, 3]
    d = place - masses @ place / masses.sum()
    about = R @ np.array([part.inertia for part in heavy]).reshape(-1, 3, 3) @ R.transpose(0, 2, 1)
    return np.asarray(about.sum(axis=0) + (masses @ (d * d).sum(axis=1)) * np.eye(3) - (masses * d.T) @ d)


def to_blame(parts: list[Part]) -> etree._Element:
    """The link whose own inertia is furthest from a body's, the first with an inertial when none is."""

    def excess(part: Part) -> float:
        if not np.isfinite(part.inertia).all():
            return 0.0
        low, middle, high = np.linalg.eigvalsh(part.inertia).tolist()
        return max(-low, high - low - middle) / max(abs(low), abs(high), 1e-300)

    stated = [part for part in parts if part.link.find("inertial") is not None] or parts
    return max(stated, key=excess).link
