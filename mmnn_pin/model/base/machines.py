"""Machines that are none of our bases, by their shape: legged, humanoid, drone, on tracks, or on wheels that steer.

A leg is a chain of joints from the root's body down to the lowest place of the robot, with no other support under the
root; two or more make a legged machine, two with arms above them or under a waist a humanoid. Four or more that are
alike and stretched out to all sides are legs at any height. A drone has rotors: three or more equal bodies that turn
about vertical axes around its middle. Where a machine hides its rotors in a mesh only its names are left; they make the
loader refuse or ask, never accept.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from lxml import etree

from ...elementary.matrices import length
from ..signs import Sign
from ..urdf.document import Joint
from ..urdf.shapes import AtRest
from .wheels import LOW, MOST_PER_SIDE, Candidate, height_at

MESHES = "link/*/geometry/mesh"

STEERED_NAMES = re.compile(
    r"(?<!skid_)(?<!skid)(?<!skid-)steer|ackermann|racecar|tricycle|bicycle|car[_-]?like", re.IGNORECASE
)

TRACK_NAMES = re.compile(
    r"(^|[_/ -])(tracks?|tracked|crawlers?|caterpillars?|flippers?|tank)([_./ -]|$)", re.IGNORECASE
)
TRACKED_NAMES = re.compile(r"tracked|crawler|caterpillar", re.IGNORECASE)  # of "tanks" some have plain wheels
LEG_JOINTS, ROTORS = 2, 3  # fewest joints of a leg, fewest rotors of a drone
LEGS, SPREAD = 4, 0.5  # fewest legs that are stretched out; how alike they are, and how little they point one way
SAME_HEIGHT = 0.1  # feet may differ in height by this fraction of a leg's
SWERVE = "swerve drive"
MODULE_NAMES = re.compile(r"wheel|steer|caster", re.IGNORECASE)
PROPELLERS, PROPELLER_NAMES = "vehicle with propellers", re.compile(r"thruster|propeller", re.IGNORECASE)
DRONE_NAMES = re.compile(r"drone|copter|propeller|rotor|\buav|flying|(?<![a-z])prop_?\d", re.IGNORECASE)


def machine(rest: AtRest) -> tuple[str, str] | None:
    """Name of the machine and what tells; None for what may stand on a table."""
    if feet := legs(rest, trunk_joints(rest)) or legs_of_a_waist(rest) or legs_all_around(rest):
        names = ", ".join(f"'{joint.name}'" for joint in feet)
        above = [j for j in trunk_joints(rest) if j not in feet and len(chain(rest, j)) >= LEG_JOINTS]
        if len(feet) == 2 and any(len(chain(rest, j)) > 2 for j in above):
            return "humanoid", f"it stands on two legs ({names}) and has limbs above them"
        return "legged machine", f"it stands on {len(feet)} legs ({names})"
    if feet := upright_along_y(rest):
        names = ", ".join(f"'{joint.name}'" for joint in feet)
        return "humanoid", f"with y up, it stands on two legs ({names}) and has limbs above them"
    if joints := steering_modules(rest):
        return SWERVE, f"{len(joints)} wheels, or their mounts, turn about vertical axes ({', '.join(joints)})"
    if names := propellers(rest):
        return PROPELLERS, f"{names} by their names, and nothing that rolls"
    if joints := list(rotors(rest)):
        return "drone", f"{len(joints)} equal rotors turn about vertical axes ({', '.join(joints)})"
    meshes = map(mesh_name, rest.document.root.iterfind(MESHES))
    swings = {j.child for j in rest.document.joints.values() if j.moves and not j.turns_freely}
    links = [name for name in rest.document.links if name not in swings]
    if hit := DRONE_NAMES.search(" ".join([rest.document.root.get("name", ""), *links, *meshes])):
        return "drone", f"'{hit[0]}' in its names, and nothing that carries it"
    return None


def propellers(rest: AtRest, joints: Iterable[Joint] | None = None) -> str:
    """Endless joints called propellers or thrusters, in words; empty where none of these joints, or not all, are."""
    ends = [j for j in rest.document.joints.values() if j.turns_freely and not rest.document.moving_children(j.child)]
    called = [j.name for j in ends if PROPELLER_NAMES.search(f"{j.name} {j.child}")]
    wanted = called if joints is None else [j.name for j in joints]
    drone = len(called) >= ROTORS and all(rest.is_vertical(rest.document.joints[name]) for name in called)
    return ", ".join(f"'{name}'" for name in called) if not drone and {*wanted} <= {*called} else ""


def steering_named(rest: AtRest) -> str:
    """A name that tells that a machine steers its wheels, empty where there is none."""
    names = (rest.document.root.get("name", ""), *rest.document.joints, *rest.document.links)
    hit = next(filter(None, map(STEERED_NAMES.search, names)), None)
    return f"'{hit.string}' among its names" if hit else ""


def belt_signs(rest: AtRest, wheels: Sequence[Candidate]) -> Iterator[Sign]:
    """Signs that parallel wheels run in belts: how many they are, and names."""
    on_root = [j for j in trunk_joints(rest) if j.turns_freely and rest.is_horizontal(j)]
    alike = sum(abs(rest.axis(on_root[0]) @ rest.axis(j)) > 0.99 for j in on_root) if on_root else 0
    count = max(alike, len(wheels))
    if count > 2 * MOST_PER_SIDE:
        yield Sign(f"{count} parallel wheels: more than {MOST_PER_SIDE} per side run in tracks", 4.0)
    if named := welded_tracks(rest):
        yield Sign(named, 3.0)
    elif named := track_named(rest):
        yield Sign(named, 2.5 if TRACKED_NAMES.search(named) else 1.0)
    size, bottom = (max(2.0 * c.radius for c in wheels), min(c.bottom for c in wheels)) if wheels else (0.0, 0.0)
    if rest.is_footprint and len(wheels) == 2 and bottom > size:  # drums; more wheels tell of a misplaced root
        text = f"they end {bottom:.3g} m above the root link '{rest.document.root_link}', which stands for the floor"
        yield Sign(text, 1.0)


def track_named(rest: AtRest) -> str:
    """A name that tells that a machine runs on tracks, empty where there is none."""
    meshes = (mesh.get("filename", "") for mesh in rest.document.root.iterfind(MESHES))
    called = f"{rest.document.root.get('name', '')} {rest.document.path.stem}"
    if "tank" in called.lower() or TRACKED_NAMES.search(called):
        return f"'{called.strip()}' is its name"
    names = [*rest.document.links, *rest.document.joints, *("/".join(m.split("/")[-2:]) for m in meshes)]
    hit = next(filter(None, map(TRACK_NAMES.search, names)), None)
    return f"'{hit.string}' among its names" if hit else ""


def welded_tracks(rest: AtRest) -> str:
    """Names of links on both sides of the root's body that tell that it runs on tracks, empty where there are none."""
    body = rest.document.body(rest.document.root_link)[1:]
    named = [(n, float(rest.placements[n][1, 3] - rest.middle[1])) for n in body if TRACK_NAMES.search(n)]
    sided = [[name for name, y in named if side * y > 0] for side in (1, -1)]
    return f"'{sided[0][0]}' and '{sided[1][0]}' on its sides" if all(sided) else ""


def mesh_name(mesh: etree._Element) -> str:
    """Name of a mesh's file, without folders."""
    return str(mesh.get("filename", "").rpartition("/")[2])


def trunk_joints(rest: AtRest) -> list[Joint]:
    """Joints on the root's body."""
    return rest.document.moving_children(rest.document.root_link)


def chain(rest: AtRest, joint: Joint) -> list[Joint]:
    """The longest chain of joints that starts with this one."""
    below = [chain(rest, j) for j in rest.document.moving_children(joint.child)]
    return [joint, *max(below, key=len, default=[])]


def rolls(rest: AtRest, joint: Joint) -> bool:
    """Whether a joint turns without end about a level axis."""
    return joint.turns_freely and rest.is_horizontal(joint)


def height(rest: AtRest, joint: Joint) -> float:
    """Height of the lowest frame or primitive that a joint carries [m]."""
    links = rest.document.body(joint.child)
    lowest_frame = min(min(float(rest.placements[link][2, 3]), lowest(rest, link)) for link in links)
    return min([lowest_frame, *(height(rest, j) for j in rest.document.moving_children(joint.child))])


def lowest(rest: AtRest, link: str) -> float:
    """Height of a link's lowest primitive, inf without any [m]."""
    return min((shape.lowest for shape in rest.primitives[link]), default=math.inf)


def legs(rest: AtRest, joints: Sequence[Joint]) -> list[Joint]:
    """Those of these joints that are the first of a leg; empty when there are fewer than two. No wheel is a foot."""
    limbs = [j for j in joints if len(chain(rest, j)) >= LEG_JOINTS and not rolls(rest, chain(rest, j)[-1])]
    feet = {j.name: height(rest, j) for j in limbs}
    ground = min(feet.values(), default=math.inf)
    hips = {j.name: float(rest.hub(j)[2]) for j in limbs}
    body = [link for link in rest.document.body(rest.document.root_link) if rest.mass(link) > 0]
    root = min((min(lowest(rest, link), rest.bottom(link)) for link in body), default=0.0)
    first = []
    for joint in limbs:
        drop = hips[joint.name] - feet[joint.name]
        on_ground = feet[joint.name] - ground < SAME_HEIGHT * max(drop, 1e-9) + 1e-3
        if drop > 0 and on_ground and root - feet[joint.name] > 0.1 * drop:
            first.append(joint)
    return first if len(first) >= 2 else []


def legs_of_a_waist(rest: AtRest) -> list[Joint]:
    """First joints of two legs on a waist of one or more joints, under a body with two arms; empty without."""
    limbs = [j for j in trunk_joints(rest) if len(chain(rest, j)) > LEG_JOINTS]
    for waist in limbs if len(limbs) > 2 else ():
        joints = rest.document.moving_children(waist.child)
        while len(joints) == 1:
            joints = rest.document.moving_children(joints[0].child)
        feet = legs(rest, [j for j in joints if len(chain(rest, j)) > LEG_JOINTS])
        if len(feet) == 2:
            return feet
    return []


def legs_all_around(rest: AtRest) -> list[Joint]:
    """First joints of four legs or more that are drawn stretched out: alike, and to all sides, as no fingers are."""
    chains = [chain(rest, j) for j in trunk_joints(rest)]
    usual = Counter(map(len, chains)).most_common(1)
    limbs = [c for c in chains if [len(c)] == [n for n, _ in usual] and len(c) >= LEG_JOINTS and not rolls(rest, c[-1])]
    ways = [(rest.hub(joints[-1]) - rest.hub(joints[0]))[:2] for joints in limbs]
    sizes = [length(way) for way in ways]
    if len(limbs) < LEGS or min(sizes) <= SPREAD * max(sizes):
        return []
    mean = sum(way / size for way, size in zip(ways, sizes, strict=True)) / len(ways)
    return [joints[0] for joints in limbs] if length(mean) < SPREAD else []


def upright_along_y(rest: AtRest) -> list[Joint]:
    """First joints of the two legs of a humanoid drawn with y up, as body models are; by frames only."""

    def reach(joint: Joint) -> float:
        own = float(rest.placements[joint.child][1, 3])
        return min([own, *(reach(j) for j in rest.document.moving_children(joint.child))])

    limbs = [j for j in trunk_joints(rest) if len(chain(rest, j)) > LEG_JOINTS]
    drops = {j.name: float(rest.hub(j)[1]) - reach(j) for j in limbs}
    longest = max(drops.values(), default=0.0)
    feet = [j for j in limbs if drops[j.name] > (1 - SAME_HEIGHT) * longest > 0]
    rest_of = [j for j in limbs if j not in feet and drops[j.name] < 0.5 * longest]
    return feet if len(feet) == 2 and rest_of and len(limbs) == len(feet) + len(rest_of) else []


def steering_modules(rest: AtRest) -> list[str]:
    """Names of low joints about vertical axes on which names say that wheels are, and nothing turns.

    There are three or more of them, or two that are said to steer.
    """
    highest, names = height_at(rest, LOW), []
    for joint in trunk_joints(rest):
        words = [joint.name, joint.child, *map(mesh_name, rest.document.links[joint.child].iter("mesh"))]
        ends = rest.is_vertical(joint) and not rest.document.moving_children(joint.child)
        if ends and MODULE_NAMES.search(" ".join(words)) and rest.hub(joint)[2] <= highest:
            names.append(joint.name)
    steer = [name for name in names if "steer" in name.lower()]
    return names if len(names) >= ROTORS or len(steer) >= 2 else []


def rotors(rest: AtRest) -> Iterator[str]:
    """Names of equal light bodies on vertical axes around the centre of mass, none when there are fewer than three."""
    document = rest.document
    turning = [j for j in trunk_joints(rest) if j.turns_freely and rest.is_vertical(j)]
    turning = [j for j in turning if not document.moving_children(j.child)]
    if len(turning) < ROTORS:
        return
    hubs = np.array([rest.hub(j) for j in turning])
    masses = np.array([rest.mass(j.child) for j in turning])
    around = length(hubs.mean(axis=0)[:2] - rest.middle[:2]) < 0.3 * np.ptp(hubs[:, :2], axis=0).max()
    level = np.ptp(hubs[:, 2]) < 0.1 * np.ptp(hubs[:, :2], axis=0).max()
    if level and around and np.ptp(masses) <= 0.1 * masses.max():
        yield from (joint.name for joint in turning)
