"""Wheels, found on the geometry of a robot at rest; names decide nothing.

A wheel is a joint that turns freely about a horizontal axis, carries a round body around that axis and touches the
floor, with its tread. Its body is a cylinder, a sphere or a mesh, and where rollers turn on it, what they reach. Where
its visual mesh is missing the collision shape is the wheel, unless signs speak against it (`bearing`): another floor,
another radius that is stated, an inertia about the axle that it has no room for, a radius too small for the track.
Joints that cannot be measured are wheels all the same where two share an axis, or three are low on the root's body:
their radius is what is stated, else the height of their hub above the floor.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from ...elementary import hypot
from ...elementary.matrices import product
from ...signals import Array
from ..signs import MARGIN, Sign, score
from ..urdf.audit import BodyPart
from ..urdf.document import Joint
from ..urdf.shapes import HORIZONTAL, VERTICAL, AtRest, Shape, is_ball, reach_about, round_about

TOUCHING = 0.2  # a wheel's lowest point may be off the floor by this fraction of the radius
COAXIAL = 0.01  # two wheels' axes may be apart by this fraction of the track
SLOPPY = 0.1  # those of two that the user names may be apart by this fraction, and it is told
SURE = 0.05  # what is left of a wheel is all of it if its radius is right within this fraction
# Weights of signs that a collision shape is the wheel [nats]: logarithms of how often each is right on public robots.
ROUND, RIGHT, WRONG, MISSTATED, SLIM, ROOM, CROWDED = 2.9, 3.0, -4.0, -3.5, -3.0, 1.0, -2.5
FLIPPER = 2.0  # radii that what turns with a wheel reaches at most: a track about one of its ends reaches further
SLIMMEST = 0.09  # of 114 public robots two have wheels of a smaller radius by the distance of two on one axle
LOOSE = 1.5  # a wheel of this many times the radius of a disc of its inertia is odd
ALIKE = 0.02  # moments of inertia that differ by less than this fraction about all axes are nobody's measure
MIDDLE = 0.05  # of the track: wheels nearer to the middle are on no side
TILTED = 0.3  # vertical part of a unit axis beyond which nobody means a wheel
LUMPY, PARTIAL = "not round", "mesh missing"  # shapes that are not measured, one since a mesh of it cannot be read
HUB, STATED = "hub height", "radius as stated"  # shapes of wheels whose body cannot be read
NOT_SEEN = (math.nan, math.nan, False)  # radius and place by sight, whether a shape cannot be read
UNSEEN = (HUB, STATED, PARTIAL, LUMPY, "unknown")
FLOOR_NAMES = re.compile(r"footprint|ground|floor|world|map|odom", re.IGNORECASE)  # of frames that stand for the floor
STEER_NAMES = re.compile(r"steer", re.IGNORECASE)
WHEEL_NAMES = re.compile(r"wheel|whl", re.IGNORECASE)
LOW = 0.4  # joints in the lower part of a robot, by this fraction of its height, may be wheels
ALL_ROUND, TRAIL = 6.0, 1e-3  # [rad] travel of a joint that swivels, [m] least trail of a caster
MOST_PER_SIDE = 3  # wheels of a skid-steer base on either side
ROUND_ABOUT, ROLLERS = 3, 4  # low joints that are wheels though no axis is shared; bodies on a wheel, its rollers
Mount = Literal["", "swivel", "steering", "leg"]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A joint that may be a wheel, in the root frame at rest."""

    joint: Joint  # the joint
    axis: Array  # (3,) its axis
    centre: Array  # (3,) middle of the round body on the axis [m]
    radius: float  # [m], nan while unknown
    shape: str  # `cylinder`, `sphere`, `mesh`, `unknown`, `PARTIAL`, or where the radius is from, `HUB` or `STATED`
    mount: Mount = ""  # what it hangs on: a free `swivel`, a `steering` joint, a `leg`, or nothing that turns
    trail: float = math.inf  # distance of the wheel from the vertical axis that it hangs on, inf without one [m]
    rollers: tuple[str, ...] = ()  # joints of the rollers on its rim
    # radius of its visual shapes where its collision shapes are measured, nan where it is not known [m]
    other: float = math.nan
    beside: float = math.nan  # place of those along the axis, from the centre; nan where it is not known [m]
    # radius of what is left of it where a mesh is missing: that may be its hub; nan where nothing is missing, or
    # nothing left [m]
    left: float = math.nan
    signs: tuple[Sign, ...] = ()  # what speaks for and against that what is left is all of it

    @property
    def is_partial(self) -> bool:
        """Whether a mesh of it is missing, and it is measured from what is left, if at all."""
        return not math.isnan(self.left)

    @property
    def bottom(self) -> float:
        """Height of its lowest point [m]."""
        return float(self.centre[2] - self.radius)

    @property
    def text(self) -> str:
        """Its joint, shape, size and place in words."""
        x, y, _ = np.round(self.centre, 6) + 0.0
        size = "radius unknown" if math.isnan(self.radius) else f"radius {self.radius:.4g} m"
        size += f", {self.left:.4g} m without it" if self.shape == PARTIAL and not math.isnan(self.left) else ""
        tilt = math.degrees(math.asin(min(1.0, abs(self.axis[2]))))
        plain = "" if abs(self.axis[2]) <= HORIZONTAL else f" (axle tilted by {tilt:.2g} degrees)"
        how = {"": plain, "swivel": " (on a swivel)", "steering": " (steered)", "leg": " (on a leg)"}[self.mount]
        return f"'{self.joint.name}' ({self.shape}, {size}, at x {x:.4g}, y {y:.4g} m){how}"


@dataclass(frozen=True, eq=False)
class Candidates:
    """Joints that may be wheels, in the root frame at rest."""

    wheels: list[Candidate]  # those on the floor
    # when there are none, what could be wheels but for one thing: it hangs in the air, its axle is tilted, or nothing
    # tells its radius (nan)
    near_misses: list[Candidate]
    # height of the floor: the lowest that any link reaches as far as primitives, centres of mass and wheels tell [m]
    floor: float
    footing: float  # height of the floor where something tells that it is the floor, else nan [m]
    # what could be wheels on the floor but for the limits of their joints
    limited: list[Candidate] = field(default_factory=list)


def wheel_candidates(rest: AtRest, radius: float | None = None, given: bool = False) -> Candidates:
    """Joints that may be wheels.

    Args:
        rest: The robot at rest.
        radius: What is stated of their radius, for those that cannot be measured [m].
        given: Whether the user states it, and not the file.
    """
    found = [c for joint in rest.document.joints.values() if (c := round_joint(rest, joint))]
    on_rims = {name for c in found for name in c.rollers}
    found = [c for c in found if c.joint.name not in on_rims]
    level = [c for c in found if rest.is_horizontal(c.joint)]
    hidden, lumpy = [c for c in level if c.shape in ("unknown", PARTIAL)], [c for c in level if c.shape == LUMPY]
    measured = [c for c in level if c not in hidden and c not in lumpy]
    blind = hidden + [c for c in measured if c.is_partial]
    unseen = {link for c in blind for link in rest.document.body(c.joint.child)}  # these tell no floor
    shapes = [shape for link in rest.document.links if link not in unseen for shape in rest.primitives[link]]
    whole = [c for c in measured if not c.is_partial]
    footing = footing_of(rest, whole, [s for s in shapes if not at_hub(s, blind)])
    known, hidden = borne_out(rest, measured, hidden, footing, radius)
    known = known + on_floor(rest, hidden, known, footing, radius, given)
    heights = [shape.lowest for shape in shapes] + [rest.bottom(link) for link in rest.document.links]
    floor = min(heights + [c.bottom for c in known if not math.isnan(c.radius)], default=math.inf)
    limited = limited_wheels(rest, known, floor)
    if touching := those_touching(rest, known, standing_on(rest, known, floor)) or hung(rest, known, floor):
        return Candidates(touching, [], floor, footing, limited)
    return Candidates([], near_misses(rest, known, found, lumpy, floor), floor, footing, limited)


def borne_out(
    rest: AtRest, measured: list[Candidate], hidden: list[Candidate], footing: float, stated: float | None
) -> tuple[list[Candidate], list[Candidate]]:
    """Those that are measured and those that are hidden: what is left of a wheel counts where signs bear it out."""
    left, all_ = [c for c in measured if c.is_partial and c.mount == ""], [*measured, *hidden]
    signs = {c.joint: tuple(bearing(rest, c, all_, footing, stated)) for c in left}
    doubts = [c for c in left if score(signs[c.joint]) < MARGIN]
    hidden = hidden + [replace(c, radius=math.nan, shape=PARTIAL) for c in doubts]
    return [replace(c, signs=signs.get(c.joint, ())) for c in measured if c not in doubts], hidden


def bearing(rest: AtRest, c: Candidate, level: list[Candidate], footing: float, stated: float | None) -> Iterator[Sign]:
    """Signs that a collision shape is the wheel whose visual mesh is missing, and not its hub.

    On 124 of 131 public robots that have both the two radii are within 5 %, and none is a hub's.
    """

    def about(other: float, wrong: float) -> float:
        return RIGHT if abs(other) <= SURE * c.radius else wrong

    yield Sign("a collision shape round about the axle", ROUND)
    if not math.isnan(footing):
        yield Sign(f"the floor at {footing:.4g} m", about(c.bottom - footing, WRONG))
    if stated is not None:
        yield Sign(f"the stated radius of {stated:.4g} m", about(c.radius - stated, MISSTATED))
    apart = [float(np.linalg.norm(o.centre - c.centre)) for o in level if coaxial(c, o)]
    if c.radius < SLIMMEST * max(apart, default=0.0):
        yield Sign(f"wheels {max(apart):.4g} m apart", SLIM)
    disc = radius_by_inertia(rest, c)
    if disc > math.sqrt(2.0) * c.radius or c.radius <= LOOSE * disc:
        text = f"its inertia, a disc's of {disc:.3g} m"
        yield Sign(text, ROOM if disc <= math.sqrt(2.0) * c.radius else CROWDED)


def radius_by_inertia(rest: AtRest, c: Candidate) -> float:
    """Radius of the solid disc with a wheel's inertia about its axle, `sqrt(2 I / m)` [m]; nan where nothing tells it.

    No mass is further out than the radius r, so that I is `m r^2` at most, a thin ring's: r is at least the disc's over
    `sqrt(2)`. It is larger than the disc's where a motor or a hub weighs much. Moments that are the same about all axes
    are no wheel's: somebody made them up.
    """
    moment, size, mass = 0.0, 0.0, 0.0
    for link in rest.document.body(c.joint.child):
        part = BodyPart.of(rest.document.links[link], rest.placements[link])
        axis = product(part.frame[:3, :3].T, c.axis)
        away = part.frame[:3, 3] - c.centre
        moment += float(product(axis, part.inertia, axis)) + part.mass * float(away @ away - (away @ c.axis) ** 2)
        size, mass = size + float(np.trace(part.inertia)), mass + part.mass
    if not (mass > 0 and moment > 0) or abs(3.0 * moment - size) <= ALIKE * size:
        return math.nan
    return math.sqrt(2.0 * moment / mass)


def those_touching(rest: AtRest, known: list[Candidate], ground: float) -> list[Candidate]:
    """Wheels on the floor, and those that sink to it on rockers or bogies."""
    touching = [c for c in known if c.shape == STATED or abs(c.bottom - ground) <= TOUCHING * c.radius]
    return touching + [c for c in known if c not in touching and sinks_to(rest, c, ground, touching)]


def hung(rest: AtRest, known: list[Candidate], floor: float) -> list[Candidate]:
    """Cylinders in pairs less than their radius above what reaches lowest, a caster or the body, drawn too low.

    So are three of three on public robots. Meshes may be toothed drums of belts, which hang, too.
    """
    low = [c for c in known if c.shape == "cylinder" and c.bottom - floor < c.radius]
    return [c for c in low if is_axle(rest, c, low)]


def near_misses(
    rest: AtRest, known: list[Candidate], found: list[Candidate], lumpy: list[Candidate], floor: float
) -> list[Candidate]:
    """Joints that would be wheels but for one thing: they hang in the air, are tilted, lie, or are not round."""

    def alike(some: list[Candidate]) -> list[Candidate]:
        low = [c for c in some if is_low(rest, c.joint)]
        return [c for c in some if is_axle(rest, c, some) or (c in low and len(low) >= ROUND_ABOUT)]

    upright = [c for c in found if rest.is_vertical(c.joint)]
    tilted = [c for c in found if not (rest.is_horizontal(c.joint) or c in upright)]
    known, upright, lumpy = ([c for c in some if c.joint.mimics is None] for some in (known, upright, lumpy))
    standing = [c for c in tilted if abs(c.bottom - floor) <= TOUCHING * c.radius and not moving_above(rest, c.joint)]
    lying = [c for c in upright if c.shape not in ("unknown", PARTIAL, LUMPY) and is_axle(rest, c, upright)]
    return alike(known) or standing or lying or alike(lumpy)


def sinks_to(rest: AtRest, c: Candidate, ground: float, others: list[Candidate]) -> bool:
    """Whether a wheel hangs less than its radius above the floor, on a rocker or bogie, like one that touches it."""
    near = c.mount == "" and abs(c.bottom - ground) <= c.radius and moving_above(rest, c.joint)
    return bool(near) and any(parallel(c, o) and abs(c.radius - o.radius) <= SURE * c.radius for o in others)


def at_hub(shape: Shape, wheels: list[Candidate]) -> bool:
    """Whether a lying cylinder is as high as the hub of a wheel that cannot be measured: its motor, no caster."""
    high = [abs(float(shape.pose[2, 3]) - float(c.centre[2])) for c in wheels]
    return shape.kind == "cylinder" and shape.rolls and min(high, default=math.inf) < shape.radius / 2


def standing_on(rest: AtRest, known: list[Candidate], floor: float) -> float:
    """Height of the floor by three or more wheels and balls, though an arm at rest hangs below it; else `floor`."""
    body = rest.document.body(rest.document.root_link)
    feet = [(c.bottom, c.radius) for c in known if not math.isnan(c.radius)]
    feet += [(s.lowest, s.radius) for link in body for s in rest.primitives[link] if s.rolls]
    level = min((bottom for bottom, _ in feet), default=math.nan)
    steady = [bottom for bottom, radius in feet if bottom - level <= TOUCHING * radius]
    lowest = min((rest.bottom(link) for link in body), default=math.inf)
    near = len(steady) >= ROUND_ABOUT and level - lowest <= SURE * feet[0][1]
    wheels = [c for c in known if abs(c.bottom - level) <= SURE * c.radius]
    axles = len(wheels) >= 4 and all(is_axle(rest, c, wheels, True) for c in wheels)
    rims = len(wheels) >= ROUND_ABOUT and all(c.rollers for c in wheels)
    return level if near or axles or rims else floor


def limited_wheels(rest: AtRest, known: list[Candidate], floor: float) -> list[Candidate]:
    """Round bodies on the floor whose revolute joints have limits and share an axis with each other or a wheel."""
    joints = [j for j in rest.document.joints.values() if j.type == "revolute" and not j.turns_freely]
    joints = [j for j in joints if rest.is_horizontal(j) and not rest.document.moving_children(j.child)]
    rounds = [c for c in (wheel_of(rest, j) for j in joints) if not math.isnan(c.radius) and steers_at_most(rest, c)]
    ground = min([floor, *(c.bottom for c in rounds)])
    low = [c for c in rounds if abs(c.bottom - ground) <= TOUCHING * c.radius]
    steered = [c for c in low if moving_above(rest, c.joint)]
    pairs = [c for c in low if any(coaxial(c, o) for o in known + low if o is not c)]
    return low if len(steered) >= ROUND_ABOUT else [c for c in pairs if c not in steered]


def steers_at_most(rest: AtRest, candidate: Candidate) -> bool:
    """Whether a body hangs on the root's, or on one joint about a vertical axis there."""
    above = moving_above(rest, candidate.joint)
    return not above or (len(above) == 1 and rest.is_vertical(above[0]))


def footing_of(rest: AtRest, known: list[Candidate], shapes: list[Shape]) -> float:
    """Height of the floor, as wheels, casters or a footprint frame tell it; nan where nothing does [m].

    A frame counts by its name (REP 105, REP 120), since many a massless root link is in the middle of the chassis. A
    chassis is above the floor, nobody knows how far: the lowest shape must be a ball or a lying cylinder.
    """
    lowest = min([shape.lowest for shape in shapes] + [c.bottom for c in known], default=math.inf)
    root = rest.document.body(rest.document.root_link)
    frames = [name for name in root if rest.mass(name) == 0 and FLOOR_NAMES.search(name)]
    if frames:
        return min([lowest, *(float(rest.placements[name][2, 3]) for name in frames)])
    rolling = [shape.lowest for shape in shapes if shape.rolls] + [c.bottom for c in known]
    return lowest if rolling and min(rolling) <= lowest else math.nan


def round_joint(rest: AtRest, joint: Joint) -> Candidate | None:
    """The joint as a wheel whose floor is not yet known, None when it cannot be one."""
    if not joint.turns_freely or TILTED < abs(rest.axis(joint)[2]) < VERTICAL:
        return None
    carried = rest.document.moving_children(joint.child)
    if rest.is_vertical(joint) and carried:
        return None
    rollers = tuple(j.name for j in carried if is_roller(rest, j))
    if len(rollers) != len(carried) or (
        0 < len(rollers) < ROLLERS and not all(is_tyre(rest, j, joint) for j in carried)
    ):
        return None
    candidate = wheel_of(rest, joint, rollers)
    mount, trail = hangs_on(rest, joint, candidate)
    return replace(candidate, mount=mount, trail=trail, rollers=rollers)


def wheel_of(rest: AtRest, joint: Joint, rollers: tuple[str, ...] = ()) -> Candidate:
    """The joint with its round body, of shape `unknown` where none can be read, `PARTIAL` where a mesh of it cannot.

    Its shape is `LUMPY` when its body is not round. Rollers reach out further than the rim that carries them.
    """
    axis, hub, left, looks = rest.axis(joint), rest.hub(joint), math.nan, list[WheelSight]()
    for tag in ("collision", "visual"):
        look = look_at(rest, joint, rollers, tag)
        if look.rounds and not look.gone:
            radius, travel, kind = max(look.rounds)
            other, at, unseen = by_eye(rest, joint) if tag == "collision" and not look.rimmed else NOT_SEEN
            left, at = radius if unseen else math.nan, at - travel
            return Candidate(joint, axis, hub + travel * axis, radius, kind, other=other, beside=at, left=left)
        looks.append(look)
        left = max([left, *(radius for radius, _, _ in look.rounds)], key=lambda r: 0.0 if math.isnan(r) else r)
    gone, seen = any(look.gone for look in looks), any(look.seen for look in looks)
    return Candidate(joint, axis, hub, math.nan, PARTIAL if gone else LUMPY if seen else "unknown", left=left)


class WheelSight(NamedTuple):
    """The sight of a wheel by its collision or its visual shapes."""

    rounds: list[tuple[float, float, str]]  # radius, place along the axis [m] and kind of what is round about it
    seen: bool  # whether a shape can be read
    gone: bool  # whether one cannot
    rimmed: bool  # whether rollers on the rim can be read


def look_at(rest: AtRest, joint: Joint, rollers: tuple[str, ...], tag: str) -> WheelSight:
    """The sight of a wheel on a joint, with the rollers on its rim, by its collision or its visual shapes."""
    axis, hub = rest.axis(joint), rest.hub(joint)
    bodies, gone = readable(rest, rest.document.body(joint.child), tag)
    rims, rims_gone = readable(rest, [rest.document.joints[name].child for name in rollers], tag)
    fits = [(s, fit) for s in bodies if (fit := round_about(s, hub, axis))]
    rounds = [(*fit, "sphere" if is_ball(s, hub + fit[1] * axis, fit[0]) else s.kind) for s, fit in fits]
    if rounds and max(reach_about(s, hub, axis)[0] for s in bodies) > FLIPPER * max(rounds)[0]:
        rounds = []
    if rims:
        reaches = [reach_about(s, hub, axis) for s in rims]
        middle = (min(low for _, low, _ in reaches) + max(high for _, _, high in reaches)) / 2
        rounds.append((max(out for out, _, _ in reaches), middle, "mesh" if rims[0].kind == "mesh" else "cylinder"))
    return WheelSight(rounds, bool(bodies), gone or rims_gone, bool(rims))


def by_eye(rest: AtRest, joint: Joint) -> tuple[float, float, bool]:
    """Radius of the round visual shapes on a joint and their place along it, nan where none is read; if one is gone."""
    bodies, gone = readable(rest, rest.document.body(joint.child), "visual")
    fits = [fit for s in bodies if (fit := round_about(s, rest.hub(joint), rest.axis(joint)))]
    return (*max(fits), gone) if fits and not gone else (math.nan, math.nan, gone)


def readable(rest: AtRest, links: list[str], tag: str) -> tuple[list[Shape], bool]:
    """Shapes of some links that can be read, and whether there are others."""
    shapes = [s for link in links for s in rest.shapes(link, tag)]
    bodies = [s for s in shapes if s.kind != "mesh" or len(s.points)]
    return bodies, len(bodies) < len(shapes)


def is_roller(rest: AtRest, joint: Joint) -> bool:
    """Whether a joint turns freely and carries nothing that moves."""
    return joint.turns_freely and not rest.document.moving_children(joint.child)


def is_tyre(rest: AtRest, joint: Joint, wheel: Joint) -> bool:
    """Whether a joint on a wheel turns about the wheel's own axis, as a tyre on its rim."""
    away = np.cross(rest.hub(joint) - rest.hub(wheel), rest.axis(wheel))
    return bool(abs(rest.axis(joint) @ rest.axis(wheel)) > VERTICAL and np.linalg.norm(away) < TRAIL)


def is_axle(rest: AtRest, candidate: Candidate, others: list[Candidate], steered: bool = False) -> bool:
    """Whether it shares its axis with another and hangs on no turning joint: no wrist of an arm; it may be steered."""
    above = [j for j in moving_above(rest, candidate.joint) if not (steered and rest.is_vertical(j))]
    return not above and any(coaxial(candidate, o) for o in others if o is not candidate)


def moving_above(rest: AtRest, joint: Joint) -> list[Joint]:
    """Joints that carry another one, from it up, but for slides."""
    return [j for j in rest.document.moving_ancestors(joint.child)[1:] if j.type != "prismatic"]


def pivots_above(rest: AtRest, joint: Joint) -> list[Joint]:
    """Those about vertical axes."""
    return [j for j in moving_above(rest, joint) if rest.is_vertical(j)]


def on_floor(
    rest: AtRest,
    hidden: list[Candidate],
    known: list[Candidate],
    footing: float,
    stated: float | None,
    given: bool = False,
) -> list[Candidate]:
    """Hidden bodies that are wheels by their places: two share an axis, or three are low on the root's body."""
    low = [c for c in hidden if is_low(rest, c.joint)]
    wheels = []
    for c in hidden:
        partner = next((o for o in (*known, *hidden) if o is not c and coaxial(c, o)), None)
        if partner is not None or (c in low and len(low) >= ROUND_ABOUT):
            room = math.inf if partner is None else float(np.linalg.norm(partner.centre - c.centre))
            wheels.append(possible(rest, sized(c, room, footing, stated, given)))
    return wheels


def possible(rest: AtRest, c: Candidate) -> Candidate:
    """A hidden wheel whose radius is not known where its inertia has no room within the height of its hub."""
    crowded = c.shape == HUB and math.sqrt(2.0) * c.radius < LOOSE * radius_by_inertia(rest, c)
    return replace(c, radius=math.nan, shape=PARTIAL) if crowded else c


def sized(c: Candidate, room: float, footing: float, stated: float | None, given: bool) -> Candidate:
    """A hidden wheel with the radius that is stated, else with the height of its hub above the floor, all in m.

    The radius is nan where nothing tells the floor, or where the next wheel on the axis leaves no room for it; one that
    no user gives cannot be less than what is left of the wheel.
    """
    least = 0.0 if math.isnan(c.left) else (1 - SURE) * c.left
    believed = stated if stated is not None and (given or stated >= least) else None
    radius = float(c.centre[2] - footing) if believed is None else believed
    if not 0 < radius < room or (believed is None and radius < least):
        return replace(c, radius=math.nan)
    return replace(c, radius=radius, shape=HUB if believed is None else STATED)


def is_low(rest: AtRest, joint: Joint) -> bool:
    """Whether a joint turns without end about a near horizontal axis, low on the root's body, and carries no other.

    So do wheels, and hardly ever joints of an arm. On another body three such joints must be the lowest there are: the
    root may be a torso above the base.
    """
    if not is_endless_end(rest, joint) or abs(rest.axis(joint)[2]) > TILTED:
        return False
    above = moving_above(rest, joint)
    beside = [j for j in rest.document.moving_children(joint.parent) if is_endless_end(rest, j)]
    if above and len(beside) < ROUND_ABOUT:
        return False
    return bool(rest.hub(joint)[2] <= height_at(rest, LOW / 2 if above else LOW))


def blind_beside(rest: AtRest, wheels: list[Candidate]) -> list[Candidate]:
    """Joints low on the base that turn without end beside wheels, and cannot be measured as such."""
    known = {c.joint.name for c in wheels}
    return [wheel_of(rest, j) for j in rest.document.joints.values() if is_low(rest, j) and j.name not in known]


def height_at(rest: AtRest, fraction: float) -> float:
    """Height of so much of the way from a robot's lowest frame or primitive to its highest [m]."""
    heights = [float(pose[2, 3]) for link, pose in rest.placements.items() if link != rest.document.root_link]
    heights += [float(shape.pose[2, 3]) for shapes in rest.primitives.values() for shape in shapes]
    low, high = min(heights, default=0.0), max(heights, default=0.0)
    return low + fraction * (high - low)


def is_endless_end(rest: AtRest, joint: Joint) -> bool:
    """Whether a joint turns without end and carries nothing that moves, rollers apart: one alone is an elbow."""
    carried = rest.document.moving_children(joint.child)
    return joint.turns_freely and (
        not carried or (len(carried) >= ROLLERS and all(is_roller(rest, j) for j in carried))
    )


def alike_on_root(rest: AtRest) -> list[Joint]:
    """Three or more like bodies on endless joints on the root's body: wheels or casters, hardly an arm.

    Their axes are parallel, or they are low and tilted alike.
    """
    joints = [j for j in rest.document.moving_children(rest.document.root_link) if is_endless_end(rest, j)]
    if len(joints) < ROUND_ABOUT:
        return []
    masses, axes = [rest.mass(j.child) for j in joints], [rest.axis(j) for j in joints]
    alike = max(masses) - min(masses) <= 0.2 * max(masses)
    tilts, highest = [abs(float(axis[2])) for axis in axes], max(float(rest.hub(j)[2]) for j in joints)
    around = max(tilts) - min(tilts) <= HORIZONTAL and highest <= height_at(rest, LOW)  # wheels on a ball, say
    return joints if alike and (around or all(abs(axes[0] @ axis) > VERTICAL for axis in axes)) else []


def parallel(a: Candidate, b: Candidate) -> bool:
    """Whether two wheels roll in the same direction."""
    return bool(abs(a.axis @ b.axis) > 1 - HORIZONTAL**2)


def rolling(candidate: Candidate) -> Array:
    """(2,) direction that positive joint velocity rolls a wheel in."""
    return np.array([candidate.axis[1], -candidate.axis[0]]) / hypot(candidate.axis[0], candidate.axis[1])


def across(wheels: Sequence[Candidate]) -> Array:
    """(k,) places of some parallel wheels along their axles, to the left of the rolling direction of the first [m]."""
    left = np.array([-1.0, 1.0]) * rolling(wheels[0])[::-1]
    return np.array([float(left @ c.centre[:2]) for c in wheels])


def on_either_side(wheels: Sequence[Candidate]) -> tuple[int, int]:
    """How many of some parallel wheels are left and right; those near the middle are on no side."""
    places = across(wheels)
    middle, near = (places.max() + places.min()) / 2, MIDDLE * (places.max() - places.min())
    return int((places > middle + near).sum()), int((places < middle - near).sum())


def coaxial(a: Candidate, b: Candidate, *, within: float = COAXIAL) -> bool:
    """Whether two wheels turn about one line, at different places on it; seen from above when it is horizontal."""
    seen = 2 if abs(a.axis[2]) <= TILTED else 3
    between, axis = (b.centre - a.centre)[:seen], a.axis[:seen]
    along = between @ axis
    across = between - along * axis
    return parallel(a, b) and bool(np.linalg.norm(across) < within * abs(along))


def one_axle(wheels: Sequence[Candidate]) -> bool:
    """Whether all wheels turn about one line: twin tyres where they are more than two."""
    return all(coaxial(wheels[0], c) for c in wheels[1:])


def hangs_on(rest: AtRest, joint: Joint, wheel: Candidate) -> tuple[Mount, float]:
    """The mount of a wheel, and its trail if that is a joint about a vertical axis.

    A swivel turns without end, or all the way round with the wheel trailing behind it; other such joints steer. More
    than two joints that carry the same wheels are a leg; fewer without a vertical one, or of a rocker, a suspension.
    """
    above = moving_above(rest, joint)
    ends = [j for j in rest.document.joints.values() if is_endless_end(rest, j)]
    bodies = [body for body, count in Counter(j.parent for j in ends).items() if count >= ROUND_ABOUT]
    if bodies == [joint.parent]:  # the base hangs on joints of a torso that is the root
        return "", math.inf
    carried = Counter(frozenset(j.name for j in ends if up in rest.document.moving_ancestors(j.child)) for up in above)
    if max(carried.values(), default=0) > 2:
        return "leg", math.inf
    upright = next(iter(pivots_above(rest, joint)), None)
    if upright is None:  # some files write the axis of a steering joint wrong
        return ("steering" if any(STEER_NAMES.search(j.name) for j in above) else ""), math.inf
    trail = math.dist(rest.hub(upright)[:2], wheel.centre[:2])
    all_round = upright.turns_freely or (upright.upper - upright.lower > ALL_ROUND and trail > TRAIL)
    return ("swivel" if all_round else "steering"), trail


def bare_swivels(rest: AtRest, floor: float, radius: float) -> Iterator[Joint]:
    """Swivels whose wheel is welded on: they turn freely about the vertical and reach down to the floor."""
    for joint in rest.document.joints.values():
        if joint.turns_freely and rest.is_vertical(joint) and not rest.document.moving_children(joint.child):
            heights = [s.lowest for link in rest.document.body(joint.child) for s in rest.primitives[link]]
            if min(heights, default=math.inf) < floor + TOUCHING * radius:
                yield joint


# -- wheels that cannot turn -------------------------------------------------------------------------------------------


def welded_wheels(rest: AtRest, floor: float) -> list[Joint]:
    """Fixed joints with wheels that cannot turn: those that keep their axis, and those with cylinders on the floor.

    A file made for planning often has its casters and wheels welded so.
    """
    return list(dict.fromkeys([*welded_axles(rest), *welded_cylinders(rest, floor), *welded_by_name(rest)]))


def written_to_turn(rest: AtRest, welded: list[Joint]) -> str:
    """The edit of a file by which welded wheels turn, and what steers them: joints with a vertical axis."""
    names = list[str]()
    for wheel in welded:
        link, above = wheel.parent, list[Joint]()
        while link in rest.document.carrier:
            above.append(rest.document.carrier[link])
            link = above[-1].parent
        pivots = [j for j in above if not j.moves and j.has_axis and np.any(j.axis) and rest.is_vertical(j)]
        names += [j.name for j in pivots[:1] if j.child != wheel.parent or len(above) > 1 or j is above[0]]
    joined = ", ".join(f"'{name}'" for name in dict.fromkeys([*names, *(joint.name for joint in welded)]))
    return f'write type="continuous" in {joined} if they turn'


def called_wheels(rest: AtRest) -> list[Candidate]:
    """Joints that turn without end, carry nothing and are called wheels: names make the loader ask."""
    ends = [j for j in rest.document.joints.values() if is_endless_end(rest, j)]
    called = [wheel_of(rest, j) for j in ends if WHEEL_NAMES.search(f"{j.name} {j.child}")]
    return [replace(c, mount=hangs_on(rest, c.joint, c)[0]) for c in called]


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
    document = rest.document

    def is_hub(joint: Joint) -> bool:
        ends = not joint.moves and not document.children[joint.child] and not document.moving_ancestors(joint.child)
        stated = joint.has_axis and np.any(joint.axis) and rest.is_horizontal(joint)
        return bool(ends and stated and rest.mass(joint.child) > 0)

    hubs = [Candidate(j, rest.axis(j), rest.hub(j), math.nan, "unknown") for j in document.joints.values() if is_hub(j)]
    lowest = min((p[2, 3] for name, p in rest.placements.items() if rest.mass(name) > 0), default=math.inf)
    pairs = [(a, b) for a in hubs for b in hubs if a is not b and coaxial(a, b)]
    return [a.joint for a, b in pairs if a.centre[2] - lowest < 0.5 * np.linalg.norm(a.centre - b.centre)]
