"""Wheels, found on the geometry of a robot at rest; names decide nothing.

A wheel is a joint that turns freely about a horizontal axis, carries a round body around that axis and touches the
floor. Its body is a cylinder, a sphere or a mesh; where nothing can be read, two joints that share an axis at the
same height are wheels whose radius is the height of their hub.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mmnn_pin.model.shapes import HORIZONTAL, AtRest, round_about
from mmnn_pin.model.urdf import Joint
from mmnn_pin.signals import Array

TOUCHING = 0.2  # a wheel's lowest point may be off the floor by this fraction of the radius
COAXIAL = 0.01  # two wheels' axes may be apart by this fraction of the track
ROLLERS = 4  # so many bodies that turn freely on a wheel are its rollers

Mount = Literal["", "swivel", "steering", "leg"]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A joint that may be a wheel, in the root frame at rest.

    Attributes:
        joint: The joint.
        axis: (3,) its axis.
        centre: (3,) middle of the round body on the axis [m].
        radius: [m], nan while unknown.
        shape: `cylinder`, `sphere`, `mesh`, or `unknown`.
        mount: What it hangs on: a free `swivel`, a `steering` joint, a `leg`, or nothing that turns.
        rollers: Joints of the rollers on its rim.
    """

    joint: Joint
    axis: Array
    centre: Array
    radius: float
    shape: str
    mount: Mount = ""
    rollers: tuple[str, ...] = ()

    @property
    def bottom(self) -> float:
        """Height of its lowest point [m]."""
        return float(self.centre[2] - self.radius)

    @property
    def text(self) -> str:
        """Itself in words."""
        x, y, _ = self.centre
        how = {"": "", "swivel": " (on a swivel)", "steering": " (steered)", "leg": " (on a leg)"}[self.mount]
        return f"'{self.joint.name}' ({self.shape}, radius {self.radius:.4g} m, at x {x:.4g}, y {y:.4g} m){how}"


def wheel_candidates(rest: AtRest) -> tuple[list[Candidate], list[Candidate], float]:
    """Wheels on the floor, axles in the air (when no wheel is on the floor), and the floor's height.

    The floor is the lowest that any link reaches as far as primitives, centres of mass and wheels tell.
    """
    found = [c for joint in rest.document.joints.values() if (c := round_joint(rest, joint))]
    rollers = {name for c in found for name in c.rollers}
    found = [c for c in found if c.joint.name not in rollers]
    known = [c for c in found if c.shape != "unknown"]
    heights = [shape.lowest for link in rest.document.links for shape in rest.shapes(link)]
    floor = min(heights + [c.bottom for c in known], default=math.inf)
    known += on_floor([c for c in found if c.shape == "unknown"], known, floor)
    floor = min([floor, *(rest.bottom(link) for link in rest.document.links), *(c.bottom for c in known)])
    touching = [c for c in known if abs(c.bottom - floor) <= TOUCHING * c.radius]
    hanging = [c for c in known if not touching and is_axle(rest, c, known)]
    return touching, hanging, floor


def round_joint(rest: AtRest, joint: Joint) -> Candidate | None:
    """The joint as a wheel whose floor is not yet known, None when it cannot be one."""
    if not joint.turns_freely or joint.mimics is not None or not rest.is_horizontal(joint):
        return None
    carried = rest.document.moving_children(joint.child)
    rollers = tuple(j.name for j in carried if is_roller(rest, j))
    if len(rollers) != len(carried) or 0 < len(rollers) < ROLLERS:
        return None
    candidate = wheel_of(rest, joint)
    return candidate and replace(candidate, mount=hangs_on(rest, joint), rollers=rollers)


def wheel_of(rest: AtRest, joint: Joint) -> Candidate | None:
    """The joint with its round body, of shape `unknown` when no body can be read, None when its body is not round."""
    axis, hub, links = rest.axis(joint), rest.hub(joint), rest.document.body(joint.child)
    seen = False
    for tag in ("collision", "visual"):
        bodies = [s for link in links for s in rest.shapes(link, tag) if s.kind != "mesh" or len(s.points)]
        seen = seen or bool(bodies)
        rounds = [(*fit, s.kind) for s in bodies if (fit := round_about(s, hub, axis))]
        if rounds:
            radius, travel, kind = max(rounds)
            return Candidate(joint, axis, hub + travel * axis, radius, kind)
    return None if seen else Candidate(joint, axis, hub, math.nan, "unknown")


def is_roller(rest: AtRest, joint: Joint) -> bool:
    """Whether a joint turns freely and carries nothing that moves."""
    return joint.turns_freely and not rest.document.moving_children(joint.child)


def is_axle(rest: AtRest, candidate: Candidate, others: list[Candidate]) -> bool:
    """Whether it shares its axis with another and hangs on no turning joint: no wrist of an arm."""
    above = rest.document.moving_ancestors(candidate.joint.child)[1:]
    return any(coaxial(candidate, o) for o in others if o is not candidate) and all(
        j.type == "prismatic" for j in above
    )


def on_floor(unknown: list[Candidate], known: list[Candidate], floor: float) -> list[Candidate]:
    """Bodies of unknown shape that have a coaxial partner: wheels whose radius is the height of the hub."""
    wheels = []
    for c in unknown:
        partners = [o for o in known + unknown if o is not c and coaxial(c, o)]
        radius = float(c.centre[2] - floor)
        if partners and 0 < radius < np.linalg.norm(partners[0].centre - c.centre):
            wheels.append(replace(c, radius=radius, shape="hub height"))
    return wheels


def parallel(a: Candidate, b: Candidate) -> bool:
    """Whether two wheels roll in the same direction."""
    return bool(abs(a.axis @ b.axis) > 1 - HORIZONTAL**2)


def coaxial(a: Candidate, b: Candidate) -> bool:
    """Whether two wheels turn about one line, at different places on it."""
    between = (b.centre - a.centre)[:2]
    along = between @ a.axis[:2]
    across = between - along * a.axis[:2]
    return parallel(a, b) and bool(np.hypot(*across) < COAXIAL * abs(along))


def hangs_on(rest: AtRest, joint: Joint) -> Mount:
    """What a wheel hangs on: one joint about a vertical axis, free (a caster) or within limits, or a leg of several."""
    above = [j for j in rest.document.moving_ancestors(joint.child)[1:] if j.type in ("revolute", "continuous")]
    if len(above) > 2:
        return "leg"
    upright = [j for j in above if rest.is_vertical(j)]
    if upright:
        return "swivel" if upright[0].turns_freely else "steering"
    return ""  # a rocker or swing arm: a suspension


def bare_swivels(rest: AtRest, floor: float, radius: float) -> Iterator[Joint]:
    """Swivels whose wheel is welded on: they turn freely about the vertical and reach down to the floor."""
    for joint in rest.document.joints.values():
        if joint.turns_freely and rest.is_vertical(joint) and not rest.document.moving_children(joint.child):
            heights = [s.lowest for link in rest.document.body(joint.child) for s in rest.shapes(link)]
            if min(heights, default=math.inf) < floor + TOUCHING * radius:
                yield joint


def welded_wheels(rest: AtRest) -> list[Joint]:
    """Fixed joints that keep a horizontal axis shared by two, on the lowest bodies: wheels that cannot turn.

    A file made for planning often has its casters and wheels welded so.
    """
    with_axis = {e.get("name") for e in rest.document.root.iterchildren("joint") if e.find("axis") is not None}
    ends = [j for j in rest.document.joints.values() if not j.moves and not rest.document.children[j.child]]
    ends = [j for j in ends if j.name in with_axis and np.any(j.axis) and rest.mass(j.child) > 0]
    stated = [j for j in ends if rest.is_horizontal(j) and not rest.document.moving_ancestors(j.child)]
    hubs = [Candidate(j, rest.axis(j), rest.hub(j), math.nan, "unknown") for j in stated]
    pairs = [(a, b) for a in hubs for b in hubs if a is not b and coaxial(a, b)]
    lowest = min((p[2, 3] for name, p in rest.placements.items() if rest.mass(name) > 0), default=math.inf)
    low = [a.joint for a, b in pairs if a.centre[2] - lowest < 0.5 * np.linalg.norm(a.centre - b.centre)]
    return list(dict.fromkeys(low))
