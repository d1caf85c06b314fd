"""Is a URDF a mechanism: names and one tree of links, joints that can move, bodies that can be accelerated.

Links that are fixed to each other count as one body: a link alone may have no mass or a degenerate inertia, what
accelerates is the body that they make together. At the end stands what is possible but hardly meant: millimetres,
degrees.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from lxml import etree

from ...elementary.matrices import product
from ...signals import Array
from .document import Joint, Tree, placement
from .finding import Finding, finding
from .xml import Elements, largest, nearest, number, numbers

MAX_JOINTS = 200  # moving ones; Pinocchio's memory grows with their cube

MAX_LINKS = 2000  # a chain of 4000 crashes Pinocchio

VERSIONS = ("1.0", "1.1", "1.2", "1")

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")

NOT_UNIT = 1e-3  # axes are printed with a few digits

INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")

ROUNDING = 1e-3  # of the largest principal inertia: files print few digits

POSITIVE = 1e-9  # of the largest principal inertia: less is zero

HEAVY = 10_000.0  # [kg]

WIDE = 10.0  # radius of gyration [m]

LONG = 10.0  # [m]; no joint of a robot for a laboratory is further from the next, no part of it larger

FULL_TURN = 2 * math.pi + 0.01  # [rad]

TWO_TURNS, DEGREES = 4 * math.pi, 720.0  # a limit between the two is suspect; beyond it is meant as none

LENGTHS = {"origin": "xyz", "cylinder": "length", "sphere": "radius", "box": "size"}


# -- names and the tree ------------------------------------------------------------------------------------------------


def too_large(root: etree._Element) -> Iterator[Finding]:
    """More joints or links than can be handled."""
    moving = sum(joint.get("type") != "fixed" for joint in root.iterchildren("joint"))
    links = sum(1 for _ in root.iterchildren("link"))
    for count, most, kind in ((moving, MAX_JOINTS, "moving joints"), (links, MAX_LINKS, "links")):
        if count > most:
            fix = "make joints that need not move fixed, or load a part of the robot"
            yield finding("too-many", root, f"has {count} {kind}", f"more than {most} are not supported", fix)


def bad_names(root: etree._Element) -> Iterator[Finding]:
    """A robot, links and joints without a name, or two of the same name."""
    if root.get("name") is None:
        yield finding("empty-name", root, "has no name", "Pinocchio's parser refuses the file", "name it", of="robot")
    if (version := root.get("version")) is not None and version not in VERSIONS:
        what, fix = f"URDF version '{version}' is unknown", f"one of {', '.join(VERSIONS[:3])}"
        yield finding("version", root, what, "Pinocchio's parser refuses the file", fix)
    for tag in ("link", "joint"):
        lines: dict[str, int] = {}
        for element in root.iterchildren(tag):
            name, line = element.get("name") or "", element.sourceline
            if not name.strip():
                yield finding("empty-name", element, "has no name", "nothing could refer to it", "name it", f"<{tag}>")
            elif name in lines:
                what = f"{tag} '{name}' appears twice (first in line {lines[name]})"
                yield finding("duplicate-name", element, what, "one would hide the other", "rename one of the two", "")
            else:
                lines[name] = line


def bad_tree(root: etree._Element) -> Iterator[Finding]:
    """Missing links, two parents, loops, several roots."""
    links = {link.get("name", ""): link for link in root.iterchildren("link")}
    if not links:
        yield finding("no-links", root, "has no links", fix="describe at least one <link>")
        return
    parent: dict[str, str] = {}
    carrier: dict[str, etree._Element] = {}
    for joint in root.iterchildren("joint"):
        above, below = (end_of(joint, tag) for tag in ("parent", "child"))
        for tag, name in (("parent", above), ("child", below)):
            if name not in links or not name:
                end = joint.find(tag)
                what = f"{tag} link '{name}' does not exist" if name else f"{tag} link is missing"
                yield finding("missing-link", joint if end is None else end, what, "", "name an existing link")
        if below in parent:
            what = f"link '{below}' already hangs on joint '{carrier[below].get('name')}'"
            yield finding("two-parents", joint, what, "a URDF is a tree", "remove one of the joints")
        elif above and below:
            parent[below], carrier[below] = above, joint
    roots = [name for name in links if name not in parent]
    for name in roots[1:]:
        what = f"link '{name}' hangs on nothing, and neither does '{roots[0]}'"
        yield finding("two-roots", links[name], what, "a URDF has one root", "join them", "")
    for circle in circles(parent):
        what = f"link '{circle[0]}' hangs on itself in a circle of joints: {', '.join(map(repr, circle))}"
        at = min((carrier[name] for name in circle), key=lambda joint: joint.sourceline)
        yield finding("loop", at, what, "a URDF is a tree", "open the loop", "")


def gazebo_loops(root: etree._Element) -> Iterator[Finding]:
    """Joints in `<gazebo>` between links that already hang in the tree: a simulator closes a loop, URDF cannot."""
    links = {link.get("name", "") for link in root.iterchildren("link")}
    for joint in root.iterfind("gazebo//joint"):
        ends = [joint.find(tag) for tag in ("parent", "child")]
        above, below = ("" if e is None else e.get("link", e.text or "").strip().rpartition("::")[2] for e in ends)
        if above in links and below in links:
            what = f"joint '{joint.get('name')}' closes a loop: it holds '{below}' to '{above}'"
            why = "a URDF is a tree: the loop is taken as open, nothing of this joint is in the model"
            fix = "lock the joints of one branch (--lock JOINT), or let them <mimic> those of the other"
            yield finding("gazebo-loop", joint, what, why, fix)


def end_of(joint: etree._Element, tag: str) -> str:
    """Name of a joint's parent or child link, empty when it has none."""
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")


def circles(follows: dict[str, str]) -> Iterator[list[str]]:
    """Every circle in a graph where each name follows at most one other."""
    done: set[str] = set()
    for start in follows:
        chain: dict[str, None] = {}
        name = start
        while name in follows and name not in done and name not in chain:
            chain[name] = None
            name = follows[name]
        if name in chain:
            members = list(chain)
            yield members[members.index(name) :]
        done.update(chain)


# -- joints ------------------------------------------------------------------------------------------------------------


def bad_joints(root: etree._Element) -> Iterator[Finding]:
    """What is wrong with each joint taken alone."""
    for joint in root.iterchildren("joint"):
        kind = joint.get("type")
        if kind not in JOINT_TYPES:
            meant = nearest(kind or "", frozenset(JOINT_TYPES))
            fix = f"did you mean '{meant}'?" if meant else f"one of {', '.join(JOINT_TYPES)}"
            why = f"known are {', '.join(JOINT_TYPES)}" if meant else ""
            yield finding("joint-type", joint, f"type '{kind}' is unknown" if kind else "has no type", why, fix)
        if kind in ("revolute", "continuous", "prismatic", "planar"):
            yield from bad_axis(joint)
        yield from bad_limit(joint, kind or "")
        dynamics = joint.find("dynamics")
        for key in ("damping", "friction"):
            if number(dynamics, key, 0.0) < 0:
                why, fix = "it would feed energy into the robot", "give a value of at least 0"
                yield finding("negative-friction", dynamics, f"{key} is negative", why, fix)


def bad_axis(joint: etree._Element) -> Iterator[Finding]:
    """An axis that is zero, not a unit vector, or not stated."""
    axis = joint.find("axis")
    if axis is None and joint.get("type") != "planar":
        yield finding("no-axis", joint, "has no <axis>", "assumed 1 0 0, as URDF has it", "state it")
    if axis is None:
        return
    length = math.hypot(*numbers(axis, "xyz"))
    if length < 1e-9:
        yield finding("zero-axis", axis, "axis is zero", "the mass matrix would be singular", "give its direction")
    elif abs(length - 1) > NOT_UNIT:
        what = f"axis '{axis.get('xyz')}' has length {length:.4g}"
        yield finding("axis-not-unit", axis, what, "assumed: its direction alone", "give a unit vector")


def bad_limit(joint: etree._Element, kind: str) -> Iterator[Finding]:
    """Limits that are missing, reversed, empty, negative, or zero."""
    limit = joint.find("limit")
    limited = kind in ("revolute", "prismatic")
    if limit is None:
        if limited:
            yield finding("no-limit", joint, "<limit> is missing", f"a {kind} joint needs it", "add it")
        return
    lower, upper = number(limit, "lower", 0.0), number(limit, "upper", 0.0)
    if limited and lower > upper:
        what = f"lower limit {lower:g} is above the upper one, {upper:g}"
        yield finding("limit-order", limit, what, "no position is allowed", "swap them", joint=joint.get("name"))
    if limited and lower == upper:
        what = f"lower and upper limit are both {lower:g}"
        fix = "state lower and upper, or make the joint continuous or fixed"
        yield finding("limit-empty", limit, what, "taken as it is: the joint cannot move", fix)
    powerless = kind != "fixed" and limit.get("effort") is not None and number(limit, "effort", 0.0) == 0
    for key in ("effort", "velocity"):
        if number(limit, key, 0.0) < 0:
            limit.set(key, "0")  # Pinocchio's parser refuses a negative one
            why = "taken as no limit, which it is in SDF"
            yield finding("limit-negative", limit, f"{key} is negative", why, "give its magnitude, or delete it")
    if powerless:
        why = "assumed: no limit, a motor of 0 could not move it"
        yield finding("zero-effort", limit, "effort limit is 0", why, "state the largest torque or force")


def bad_mimics(root: etree._Element) -> Iterator[Finding]:
    """Mimics of a joint that is not there, of themselves, or in a circle."""
    mimics = {joint.get("name", ""): joint.find("mimic") for joint in root.iterchildren("joint")}
    masters = {name: mimic.get("joint", "") for name, mimic in mimics.items() if mimic is not None}
    for name, master in masters.items():
        if master and master not in mimics:
            what = f"mimics joint '{master}', which does not exist"
            yield finding("mimic-ghost", mimics[name], what, "nothing would move it", "name an existing joint")
        elif master == name:
            why = "nothing would move it"
            yield finding("mimic-self", mimics[name], "mimics itself", why, "name another joint, or delete <mimic>")
    for circle in circles({name: master for name, master in masters.items() if name != master}):
        at = min((mimics[name] for name in circle), key=lambda mimic: mimic.sourceline)
        what = f"joints mimic each other in a circle: {', '.join(map(repr, circle))}"
        yield finding("mimic-circle", at, what, "nothing would move them", "let one of them move on its own")


# -- bodies ------------------------------------------------------------------------------------------------------------


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
        frame, element = product(pose, placement(parts.get("origin"))), parts.get("inertia")
        xx, xy, xz, yy, yz, zz = [number(element, key, 0.0) for key in INERTIA]
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
            yield finding("zero-mass", tree.links[start], what, why, fix, joint=joint.name)
        elif mass > 0 and all(part.mass >= 0 for part in parts):
            whole.append((parts, joint))
    with np.errstate(over="ignore", invalid="ignore"):
        inertias = np.array([lumped(parts) for parts, _ in whole]).reshape(-1, 3, 3)
    finite = np.isfinite(inertias).all(axis=(1, 2))
    principal = np.linalg.eigvalsh(np.where(finite[:, None, None], inertias, np.eye(3)))
    for (parts, joint), values, judged in zip(whole, principal.tolist(), finite, strict=True):
        if judged:
            yield from bad_inertia(parts, joint, values)


def no_inertials(tree: Tree) -> Iterator[Finding]:
    """Links without `<inertial>` that are fixed to another or are the root: one finding for all."""
    bare = [
        link
        for name, link in tree.links.items()
        if link.find("inertial") is None and not (name in tree.carrier and tree.carrier[name].moves)
    ]
    if bare:
        names = ", ".join(f"'{link.get('name')}'" for link in bare[:8]) + (", ..." if len(bare) > 8 else "")
        what = f"{len(bare)} link(s) without <inertial>: {names}"
        yield finding("no-inertial", bare[0], what, "assumed: massless", "none needed for mere frames", "")


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
        yield finding(
            "inertia-not-positive", to_blame(parts), what, why, fix, joint=None if joint is None else joint.name
        )
    elif high > low + middle + ROUNDING * high:
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
    """The link whose elements inertia is furthest from a body's, the first with an inertial when none is."""

    def excess(part: Part) -> float:
        if not np.isfinite(part.inertia).all():
            return 0.0
        low, middle, high = np.linalg.eigvalsh(part.inertia).tolist()
        return max(-low, high - low - middle) / max(abs(low), abs(high), 1e-300)

    stated = [part for part in parts if part.link.find("inertial") is not None] or parts
    return max(stated, key=excess).link


# -- what is hardly meant ----------------------------------------------------------------------------------------------


def millimetres(elements: Elements) -> Iterator[Finding]:
    """Lengths of more than `LONG`: one finding for the whole file, at the first of them."""
    long: list[tuple[etree._Element, str]] = []
    for tag, key in LENGTHS.items():
        long += [(e, key) for e in elements[tag] if largest(e.get(key)) > LONG]
    if long:
        element, key = min(long, key=lambda place: place[0].sourceline)
        more = f" (and {len(long) - 1} more)" if len(long) > 1 else ""
        what = f"{key} of <{element.tag}> is '{element.get(key)}' m{more}"
        yield finding("millimetres", element, what, "is the file in millimetres? taken as metres", "give metres")


def degrees(elements: Elements) -> Iterator[Finding]:
    """Limits and roll, pitch, yaw that look like degrees: of limits each, of angles one finding for the file."""
    for limit in elements["limit"]:
        most = max(abs(number(limit, key, 0.0)) for key in ("lower", "upper"))
        if limit.getparent().get("type") == "revolute" and TWO_TURNS < most <= DEGREES:
            what = f"limit of {most:g} rad is {most / (2 * math.pi):.3g} turns"
            yield finding("limit-degrees", limit, what, "is it in degrees? taken as radians", "give radians")
    turned = [o for o in elements["origin"] if largest(o.get("rpy")) > FULL_TURN]
    if turned:
        first = min(turned, key=lambda origin: origin.sourceline)
        more = f" (and so in {len(turned) - 1} more)" if len(turned) > 1 else ""
        what = f"rpy '{first.get('rpy')}' is more than a full turn{more}"
        yield finding("rpy-degrees", first, what, "is it in degrees? taken as radians", "give radians")
