"""What carries the arm: a differential drive, a holonomic base, nothing that moves; or a question to the user.

Geometry at rest decides first (`wheels`), what else the file says next (`evidence`). What the user says (`overrides`)
is taken as it is. A machine that is none of these is refused by its name, as the shape of the whole tells it:

A leg is a chain of joints from the root's body down to the lowest place of the robot, with no other support under the
root; two or more make a legged machine, two with arms above them a humanoid. A drone has rotors: three or more equal
bodies that turn, or are welded, about vertical axes around its middle. Where a machine hides its rotors in a mesh
only its names are left; they make the loader ask, never accept.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..urdf.document import Joint
from ..urdf.shapes import AtRest
from .base import Base, Fixed
from .evidence import evidence, stated_rollers, verdict
from .overrides import Overrides
from .placing import crossed, declared_wheel, mecanum, pushed, require_used, with_wheels
from .report import (
    GO_ON,
    BaseResult,
    Reading,
    Undecided,
    base_notes,
    evidence_note,
    not_on_floor,
    readings,
    undecided,
    unsupported,
    welded_note,
)
from .wheels import TRAIL, Candidate, Candidates, coaxial, parallel, welded_cylinders, welded_wheels, wheel_candidates

STEERS = re.compile(r"tricycle|ackermann|bicycle|car[_-]?like", re.IGNORECASE)

ROLLS = re.compile(r"diff[_-]?drive", re.IGNORECASE)

LEG_JOINTS, ROTORS = 2, 3  # fewest joints of a leg, fewest rotors of a drone

SAME_HEIGHT = 0.1  # feet may differ in height by this fraction of a leg's

DRONE_NAMES = re.compile(r"drone|copter|propeller|rotor|uav|flying", re.IGNORECASE)


def find_base(rest: AtRest, overrides: Overrides | None = None) -> BaseResult:
    """Find the mobile base.

    Args:
        rest: The robot at rest.
        overrides: What the user says about it.

    Raises:
        Undecided: It may be one thing or another; the candidates are listed with the reasons for and against.
        Unsupported: It is a machine of another kind, e.g. a skid-steer, car-like or legged one.
        UnknownName: A wheel that the robot does not have.
        ConfigError: Wheels that do not suit the base.
    """
    overrides = overrides or Overrides()
    candidates = wheel_candidates(rest, overrides.radius)
    drives = candidates.wheels
    if overrides.base == "fixed":
        found = BaseResult(parked([*candidates.wheels, *candidates.near_misses, *candidates.limited]))
    elif overrides.wheels is not None:
        drives = [declared_wheel(rest, name, candidates, overrides) for name in overrides.wheels]
        found = with_wheels(rest, drives, [*candidates.wheels, *candidates.limited], overrides)
    elif overrides.base == "holonomic" and not plain(candidates.wheels):
        found = pushed(rest, candidates)
    else:
        found = decide(rest, candidates, overrides)
    require_used(overrides, found.base)
    welds = welded_note(rest, welded_cylinders(rest, candidates.floor)) if found.base.wheels else []
    return replace(found, findings=(*found.findings, *base_notes(rest, found.base, drives), *welds))


def decide(rest: AtRest, candidates: Candidates, overrides: Overrides) -> BaseResult:
    """The base as geometry and evidence have it."""
    wheels = candidates.wheels
    if candidates.limited and (wheels or not machine(rest)):
        raise undecided_limits(rest, candidates)
    if (
        not wheels
        and candidates.near_misses
        and not (rest.is_vertical(candidates.near_misses[0].joint) and machine(rest))
    ):
        raise not_on_floor(rest, candidates)
    if not wheels:
        return without_wheels(rest, overrides, candidates.floor)
    drives = plain(wheels)
    balls = [c for c in drives if c.shape == "sphere"]
    if 0 < len(balls) == len(drives) - 2:  # balls beside two proper wheels: casters written as continuous joints
        drives = [c for c in drives if c not in balls]
    refuse_steered(rest, wheels)
    refuse_mimic_wheels(rest, wheels, drives)
    if len(drives) == 2 and coaxial(*drives) and overrides.base != "holonomic":
        refuse_steered_pair(rest, drives, wheels)
        return with_wheels(rest, drives, wheels, overrides)
    if len(drives) >= 3 and overrides.base != "differential_drive":
        if not all(parallel(drives[0], c) for c in drives[1:]):
            return crossed(rest, drives, wheels, overrides)
        if len(drives) >= 4:
            return four_parallel(rest, drives, wheels, overrides)
    why = "a differential drive has exactly two coaxial drive wheels, other casters swivel or are balls"
    raise undecided(rest, wheels, readings(rest, drives), why)


def parked(wheels: list[Candidate]) -> Base:
    """A base that stands still whatever it has."""
    casters = tuple(c.joint.name for c in wheels if c.mount == "swivel")
    names = (name for c in wheels for name in (c.joint.name, *c.rollers))
    return Fixed(parked=tuple(name for name in names if name not in casters), casters=casters)


def plain(wheels: Sequence[Candidate]) -> list[Candidate]:
    """Wheels that hang on nothing that turns."""
    return [c for c in wheels if c.mount == ""]


def without_wheels(rest: AtRest, overrides: Overrides, floor: float) -> BaseResult:
    """A fixed arm, unless it walks, flies, is welded together or stands on welded wheels."""
    if told := machine(rest):
        name, why = told
        raise unsupported(rest, name, why)
    moving = [joint for joint in rest.document.joints.values() if joint.moves]
    welded = welded_wheels(rest, floor)
    if welded:
        names = ", ".join(f"'{joint.name}'" for joint in welded)
        rolls = Reading("holonomic", ("wheels under casters on all sides",), (f"{names} are welded on (fixed joints)",))
        still = Reading("fixed", ("no wheel can turn in this file",), ("there are wheels under it",))
        fix = (
            "--base fixed to keep the base parked, --base holonomic to drive it by forces on its frame, "
            "or make the wheels' joints continuous"
        )
        raise undecided(rest, [], [rolls, still], f"{len(welded)} wheels are welded on", fix, welded[0].line, names)
    if not moving:
        raise unsupported(rest, "single rigid body", "it has no joint that moves")
    if overrides.base is not None:
        why = "no joint turns without end about a horizontal axis with something round on the floor"
        yours = Reading(overrides.base, ("you said so",), (why,))
        raise undecided(rest, [], [yours], why, "name them with --wheels LEFT,RIGHT")
    return BaseResult(Fixed())


def four_parallel(rest: AtRest, drives: list[Candidate], wheels: list[Candidate], overrides: Overrides) -> BaseResult:
    """Four or more wheels that roll in one direction: mecanum wheels or a skid-steer, as the evidence has it."""
    told = evidence(rest, drives)
    meaning = "holonomic" if overrides.base == "holonomic" else verdict(told)
    if meaning is None:
        why = "four parallel wheels roll the same whether they have rollers (mecanum) or skid"
        if told:
            why += ", and the evidence does not decide"
        fix = "--base holonomic for mecanum wheels, or --wheels LEFT,RIGHT for two drive wheels with the others free"
        raise undecided(rest, wheels, readings(rest, drives), why, fix)
    if meaning == "skid-steer":
        why = "; ".join(dict.fromkeys(piece.text for piece in told if piece.meaning == meaning and piece.decides))
        raise unsupported(rest, "skid-steer base", f"{len(drives)} parallel wheels, and {why}", drives)
    cited = [piece for piece in told if piece.meaning == "holonomic"]
    findings = [evidence_note(rest, cited)] if cited else []
    base, assumed = mecanum(rest, drives, wheels, overrides, stated_rollers(cited))
    return BaseResult(base, (*findings, *assumed))


# -- wheels that leave a doubt -----------------------------------------------------------------------------------------


def undecided_limits(rest: AtRest, candidates: Candidates) -> Undecided:
    """The error for wheels whose joints have limits."""
    names = ", ".join(f"'{c.joint.name}'" for c in candidates.limited)
    why = f"{names}: revolute with limits, and a wheel turns without end"
    two = Reading("differential_drive", ("coaxial round bodies on the floor",), (why,))
    still = Reading("fixed", ("no wheel can turn without end",), ("there are wheels under it",))
    fix = 'write type="continuous" for wheels, name the others with --wheels LEFT,RIGHT, or --base fixed to park them'
    return undecided(rest, [*candidates.wheels, *candidates.limited], [two, still], why, fix)


def refuse_steered(rest: AtRest, wheels: list[Candidate]) -> None:
    """Refuse wheels that steer, and wheels at the ends of legs.

    Raises:
        Unsupported: By name.
    """
    steered, drives = [c for c in wheels if c.mount == "steering"], plain(wheels)
    if not drives and not steered:  # nothing else drives, and what does not trail is no caster
        steered = [c for c in wheels if c.mount == "swivel" and c.trail <= TRAIL]
    legged = [c for c in wheels if c.mount == "leg"]
    if len(legged) >= 2:
        raise unsupported(
            rest, "legged machine", f"its wheels hang on legs: {'; '.join(c.text for c in legged)}", legged
        )
    if steered:
        name = "car-like base" if drives else "swerve drive"
        raise unsupported(rest, name, f"wheels are steered: {'; '.join(c.text for c in steered)}", steered)


def refuse_mimic_wheels(rest: AtRest, wheels: list[Candidate], drives: list[Candidate]) -> None:
    """Refuse drive wheels that follow others (<mimic>): nothing that this package drives has them.

    Raises:
        Unsupported: Wheels behind each other that turn together must slip: a skid-steer.
        Undecided: Other slaves.
    """
    slaves = [c for c in drives if c.joint.mimics is not None]
    if not slaves:
        return
    why = "; ".join(f"wheel '{c.joint.name}' follows '{c.joint.mimics}' (<mimic>)" for c in slaves)
    aligned = all(parallel(drives[0], c) for c in drives[1:])
    if (
        aligned
        and all(follows_on_its_side(c, drives) for c in slaves)
        and verdict(evidence(rest, drives)) != "holonomic"
    ):
        raise unsupported(rest, "skid-steer base", why, drives)
    two = Reading("differential_drive", (), ("a drive wheel turns by itself",))
    raise undecided(rest, wheels, [two], why, GO_ON + ", or take out their <mimic>")


def follows_on_its_side(slave: Candidate, drives: list[Candidate]) -> bool:
    """Whether a wheel follows one in front of or behind it, on the same side."""
    master = next((c for c in drives if c.joint.name == slave.joint.mimics), None)
    if master is None:
        return False
    between = slave.centre - master.centre
    return bool(abs(between @ master.axis) < master.radius < float((between @ between) ** 0.5))


def refuse_steered_pair(rest: AtRest, drives: list[Candidate], wheels: list[Candidate]) -> None:
    """Refuse two coaxial wheels that another wheel or plugin steers.

    A free caster follows by its trail. One without may be a tricycle's front wheel: what the file drives decides.

    Raises:
        Unsupported: The file drives the wheel that steers, and not the two.
        Undecided: Nothing tells, or pieces contradict each other.
    """
    front = [c for c in wheels if c.mount == "swivel" and c.trail <= TRAIL]
    told = list(driven(rest, drives, front))
    steers, rolls = ([text for kind, text in told if kind == wanted] for wanted in ("car-like", "differential_drive"))
    if front and steers and not rolls:
        why = f"{'; '.join(c.text for c in front)} has no trail and steers: {', '.join(steers)}"
        raise unsupported(rest, "car-like base", why, front)
    if steers or (front and not rolls):
        why = f"the file also speaks of steering: {', '.join(steers)}"
        if not steers:
            why = f"'{front[0].joint.name}' has no trail: a caster could not follow, a tricycle steers with it"
        two = Reading("differential_drive", ("two coaxial wheels", *rolls), tuple(steers))
        car = Reading("car-like", tuple(steers) or (f"a wheel without trail: '{front[0].joint.name}'",), tuple(rolls))
        raise undecided(rest, wheels, [two, car], why)


def driven(rest: AtRest, drives: list[Candidate], front: list[Candidate]) -> Iterator[tuple[str, str]]:
    """What plugins, controllers and motors say of two coaxial wheels and those that may steer: a kind, and the text."""
    root = rest.document.root
    for element in root.iterfind("gazebo//*"):
        words = f"{element.get('filename', '')} {element.get('name', '')} {element.text or ''}"
        for kind, pattern in (("car-like", STEERS), ("differential_drive", ROLLS)):
            if element.tag in ("plugin", "controller") and (hit := pattern.search(words)):
                yield kind, f"<gazebo> names '{hit[0]}' (line {element.sourceline})"
    ahead = {j.name for c in front for j in rest.document.moving_ancestors(c.joint.child)}
    pair = {c.joint.name for c in drives}
    moved = [e for e in root.iterfind("ros2_control/joint") if e.find("command_interface") is not None]
    for what, motors in (("<ros2_control>", moved), ("<transmission>", root.findall("transmission/joint"))):
        lines = {e.get("name"): e.sourceline for e in motors}
        for kind, own, others in (("car-like", ahead, pair), ("differential_drive", pair, ahead)):
            if lines.keys() & own and not lines.keys() & others:
                name = sorted(lines.keys() & own)[0]
                yield kind, f"{what} drives '{name}' (line {lines[name]})"


# -- other machines ----------------------------------------------------------------------------------------------------


def machine(rest: AtRest) -> tuple[str, str] | None:
    """Name of the machine and what tells; None for what may stand on a table."""
    if feet := legs(rest):
        names = ", ".join(f"'{joint.name}'" for joint in feet)
        above = [j for j in trunk_joints(rest) if j not in feet and len(chain(rest, j)) >= LEG_JOINTS]
        if len(feet) == 2 and any(len(chain(rest, j)) > 2 for j in above):
            return "humanoid", f"it stands on two legs ({names}) and has limbs above them"
        return "legged machine", f"it stands on {len(feet)} legs ({names})"
    if feet := upright_along_y(rest):
        names = ", ".join(f"'{joint.name}'" for joint in feet)
        return "humanoid", f"with y up, it stands on two legs ({names}) and has limbs above them"
    if told := list(rotors(rest)):
        return "drone", f"{len(told)} equal rotors turn about vertical axes ({', '.join(told)})"
    files = [mesh.get("filename", "") for mesh in rest.document.root.iterfind("link/*/geometry/mesh")]
    meshes = [name.rpartition("/")[2] for name in files]
    if hit := DRONE_NAMES.search(" ".join([rest.document.root.get("name", ""), *rest.document.links, *meshes])):
        return "drone", f"'{hit[0]}' in its names, and nothing that carries it"
    return None


def trunk_joints(rest: AtRest) -> list[Joint]:
    """Joints on the root's body."""
    return rest.document.moving_children(rest.document.root_link)


def chain(rest: AtRest, joint: Joint) -> list[Joint]:
    """The longest chain of joints that starts with this one."""
    below = [chain(rest, j) for j in rest.document.moving_children(joint.child)]
    return [joint, *max(below, key=len, default=[])]


def height(rest: AtRest, joint: Joint) -> float:
    """Height of the lowest frame or primitive that a joint carries [m]."""
    links = rest.document.body(joint.child)
    own = min(min(float(rest.placements[link][2, 3]), lowest(rest, link)) for link in links)
    return min([own, *(height(rest, j) for j in rest.document.moving_children(joint.child))])


def lowest(rest: AtRest, link: str) -> float:
    """Height of a link's lowest primitive, inf without any [m]."""
    return min((shape.lowest for shape in rest.primitives[link]), default=math.inf)


def legs(rest: AtRest) -> list[Joint]:
    """First joints of the legs, empty when there are fewer than two."""
    limbs = [j for j in trunk_joints(rest) if len(chain(rest, j)) >= LEG_JOINTS]
    feet = {j.name: height(rest, j) for j in limbs}
    ground = min(feet.values(), default=math.inf)
    hips = {j.name: float(rest.hub(j)[2]) for j in limbs}
    body = [link for link in rest.document.body(rest.document.root_link) if rest.mass(link) > 0]
    root = min((min(lowest(rest, link), rest.bottom(link)) for link in body), default=0.0)
    found = []
    for joint in limbs:
        drop = hips[joint.name] - feet[joint.name]
        on_ground = feet[joint.name] - ground < SAME_HEIGHT * max(drop, 1e-9) + 1e-3
        if drop > 0 and on_ground and root - feet[joint.name] > 0.1 * drop:
            found.append(joint)
    return found if len(found) >= 2 else []


def upright_along_y(rest: AtRest) -> list[Joint]:
    """First joints of the two legs of a humanoid drawn with y up, as body models are; by frames only."""

    def reach(joint: Joint) -> float:
        own = float(rest.placements[joint.child][1, 3])
        return min([own, *(reach(j) for j in rest.document.moving_children(joint.child))])

    limbs = [j for j in trunk_joints(rest) if len(chain(rest, j)) > LEG_JOINTS]
    drops = {j.name: float(rest.hub(j)[1]) - reach(j) for j in limbs}
    longest = max(drops.values(), default=0.0)
    found = [j for j in limbs if drops[j.name] > (1 - SAME_HEIGHT) * longest > 0]
    rest_of = [j for j in limbs if j not in found and drops[j.name] < 0.5 * longest]
    return found if len(found) == 2 and rest_of and len(limbs) == len(found) + len(rest_of) else []


def rotors(rest: AtRest) -> Iterator[str]:
    """Names of equal light bodies on vertical axes around the centre of mass, none when there are fewer than three."""
    document = rest.document
    turning = [j for j in trunk_joints(rest) if j.turns_freely and rest.is_vertical(j)]
    turning = [j for j in turning if not document.moving_children(j.child)]
    if len(turning) < ROTORS:
        turning = [j for j in document.joints.values() if not j.moves and is_propeller(rest, j)]
    if len(turning) < ROTORS or any(document.moving_children(j.child) for j in turning):
        return
    hubs = np.array([rest.hub(j) for j in turning])
    masses = np.array([rest.mass(j.child) for j in turning])
    level = np.ptp(hubs[:, 2]) < 0.1 * np.ptp(hubs[:, :2], axis=0).max()
    around = np.linalg.norm(hubs[:, :2].mean(axis=0)) < 0.3 * np.linalg.norm(hubs[:, :2], axis=1).max()
    if level and around and np.ptp(masses) <= 0.1 * masses.max():
        yield from (joint.name for joint in turning)


def is_propeller(rest: AtRest, joint: Joint) -> bool:
    """Whether a joint carries a flat upright cylinder beside the root's middle."""
    flat = [s for s in rest.primitives[joint.child] if s.kind == "cylinder" and s.half[2] < 0.25 * s.radius]
    beside = [s for s in flat if abs(s.pose[2, 2]) > 0.9 and math.hypot(*rest.hub(joint)[:2]) > 0.5 * s.radius]
    return bool(beside)
