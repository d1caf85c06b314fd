"""The mobile base: its wheels found on geometry, what their rolling forbids, and the motions that are left.

Frames: the *root* link's frame at rest (z up), and the *control frame* of the base: on the floor, at the middle of the
drive axle, x along the rolling direction (the one nearer the root's x), y to the left. Names decide nothing: a wheel
is a joint that turns freely about a horizontal axis, carries a round body around that axis and touches the floor.

Rolling: the contact point of a wheel at lateral offset y, radius r, stands still,

    v - y w - sign r thetadot = 0,        thetadot = sign (v - y w) / r

where `sign` is +1 when a positive joint velocity rolls the base forward (axis to the left).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from lxml import etree

from mmnn_pin.errors import RobotError
from mmnn_pin.model.urdf import Document, Joint, number, placement, vector
from mmnn_pin.signals import Array

HORIZONTAL = 0.02  # largest vertical part of a unit axis that counts as horizontal
AROUND = 0.05  # a wheel's shape may be off its axis by this fraction of the radius
TOUCHING = 0.2  # a wheel's lowest point may be off the floor by this fraction of the radius
COAXIAL = 0.01  # two wheels' axes may be apart by this fraction of the track


class Undecided(RobotError):
    """Geometry does not tell what the base is.

    Attributes:
        candidates: The joints that could be wheels, each with what is known of it.
    """

    candidates: tuple[str, ...] = ()


@dataclass(frozen=True)
class Wheel:
    """A drive wheel.

    Attributes:
        joint: Name of its joint.
        radius: Rolling radius [m].
        sign: +1 if positive joint velocity rolls the base forward, else -1.
        y: Lateral offset of the contact point in the control frame [m], positive to the left.
    """

    joint: str
    radius: float
    sign: float
    y: float


@dataclass(frozen=True, eq=False)
class Base:
    """What carries the arm, and how it can move.

    Attributes:
        kind: `differential_drive` or `fixed`.
        wheels: Drive wheels, left before right.
        track: Distance between the contact points of the drive wheels [m]; 0 for a fixed arm.
        frame: (3,) control frame `(x, y, heading)` in the root link's frame [m, m, rad].
        floor: Height of the floor in the root link's frame [m].
        casters: Joints of casters, locked at rest.
        suspensions: Joints that hold the drive wheels, locked at rest.
    """

    kind: Literal["differential_drive", "fixed"]
    wheels: tuple[Wheel, ...] = ()
    track: float = 0.0
    frame: Array = field(default_factory=lambda: np.zeros(3))
    floor: float = 0.0
    casters: tuple[str, ...] = ()
    suspensions: tuple[str, ...] = ()

    @property
    def velocity_names(self) -> tuple[str, ...]:
        """Names of the base velocities, nb of them: `v` forward [m/s], `w` counterclockwise [rad/s]."""
        return () if self.kind == "fixed" else ("v", "w")

    @property
    def locked(self) -> tuple[str, ...]:
        """All joints that stand still."""
        return self.casters + self.suspensions

    @cached_property
    def to_control(self) -> Array:
        """(3, 3) map from the root's planar velocity `(vx, vy, w)` to the control frame's, each in its own axes."""
        x, y, psi = self.frame
        c, s = math.cos(psi), math.sin(psi)
        return np.array([[c, s, s * x - c * y], [-s, c, c * x + s * y], [0.0, 0.0, 1.0]])

    @cached_property
    def root_map(self) -> Array:
        """(3, nb) map from the base velocity to the root's planar velocity; an axle at x = a gives vy = -a w."""
        x, y, psi = self.frame
        columns = np.array([[math.cos(psi), y], [math.sin(psi), -x], [0.0, 1.0]])
        return columns[:, : len(self.velocity_names)]

    @cached_property
    def wheel_map(self) -> Array:
        """(number of wheels, nb) map from the base velocity to the wheels' joint velocities."""
        rows = [[w.sign / w.radius, -w.sign * w.y / w.radius] for w in self.wheels]
        return np.array(rows).reshape(len(self.wheels), len(self.velocity_names))

    @cached_property
    def slip_rows(self) -> Array:
        """(k, 3) rows on the root's planar velocity that vanish: no motion of the control frame along its y."""
        return self.to_control[1:2] if self.wheels else np.zeros((0, 3))

    @cached_property
    def rolling_rows(self) -> Array:
        """(number of wheels, 3) forward velocity of each wheel's centre from the root's planar velocity."""
        return np.array([self.to_control[0] - w.y * self.to_control[2] for w in self.wheels]).reshape(-1, 3)


def find_base(document: Document) -> Base:
    """Find the mobile base on the geometry of a robot at rest.

    Args:
        document: An audited URDF.

    Raises:
        Undecided: There are wheels, but not two coaxial ones that drive, or they hang in the air; the candidates are
            listed.
    """
    placements = rest_placements(document)
    candidates = wheel_candidates(document, placements)
    if not candidates:
        return Base("fixed")
    swivelled = [c for c in candidates if hangs_on(document, placements, c.joint) == "swivel"]
    steered = [c for c in candidates if hangs_on(document, placements, c.joint) == "steering"]
    drives = [c for c in candidates if c not in swivelled and c not in steered]
    balls = [c for c in drives if c.shape == "sphere"]
    if 0 < len(balls) == len(drives) - 2:  # balls beside two proper wheels: casters written as continuous joints
        swivelled, drives = swivelled + balls, [c for c in drives if c not in balls]
    if steered or len(drives) != 2 or not coaxial(*drives):
        raise undecided(document, candidates, steered)
    casters = [j.name for c in swivelled for j in document.moving_ancestors(c.joint.child)]
    casters += [joint.name for joint in bare_swivels(document, placements, drives)]
    suspensions = [j.name for c in drives for j in document.moving_ancestors(c.joint.child)[1:]]
    base = differential_drive(*drives)
    in_order = list(document.joints).index
    casters = sorted(set(casters) - set(suspensions), key=in_order)
    return replace(base, casters=tuple(casters), suspensions=tuple(sorted(set(suspensions), key=in_order)))


def differential_drive(first: Candidate, second: Candidate) -> Base:
    """Control frame, track and wheels of two coaxial drive wheels."""
    forward = np.array([first.axis[1], -first.axis[0]]) / np.hypot(*first.axis[:2])
    backward = forward[0] < -1e-6 or (abs(forward[0]) <= 1e-6 and forward[1] < 0)  # axle along x: y is as near
    forward = (-forward if backward else forward) + 0.0  # no -0
    left = np.array([-forward[1], forward[0]])
    middle = (first.centre[:2] + second.centre[:2]) / 2
    wheels = [
        Wheel(c.joint.name, c.radius, math.copysign(1.0, c.axis[:2] @ left), float((c.centre[:2] - middle) @ left))
        for c in (first, second)
    ]
    wheels.sort(key=lambda wheel: -wheel.y)
    return Base(
        kind="differential_drive",
        wheels=tuple(wheels),
        track=wheels[0].y - wheels[1].y,
        frame=np.array([*middle, math.atan2(forward[1], forward[0])]),
        floor=float(first.centre[2] - first.radius + second.centre[2] - second.radius) / 2,
    )


def undecided(
    document: Document,
    candidates: list[Candidate],
    steered: list[Candidate],
    why: str = "a differential drive has exactly two coaxial drive wheels, other casters swivel or are balls",
) -> Undecided:
    """The error that lists what could be a wheel."""
    texts = tuple(c.text + (" (steered)" if c in steered else "") for c in candidates)
    error = Undecided(
        f"the base is undecided: {len(candidates)} wheel(s) found: {'; '.join(texts)}",
        why=why,
        fix="make joints that do not drive fixed",
        file=document.path,
        line=candidates[0].joint.line,
    )
    error.candidates = texts
    return error


# --- Wheels -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Candidate:
    """A joint that may be a wheel, in the root frame at rest.

    Attributes:
        joint: The joint.
        axis: (3,) its axis.
        centre: (3,) middle of the round body on the axis [m].
        radius: [m], nan while unknown.
        shape: `cylinder`, `sphere`, `mesh`, or `unknown`.
    """

    joint: Joint
    axis: Array
    centre: Array
    radius: float
    shape: str

    @property
    def bottom(self) -> float:
        """Height of its lowest point [m]."""
        return float(self.centre[2] - self.radius)

    @property
    def text(self) -> str:
        """Itself in words."""
        x, y, _ = self.centre
        return f"'{self.joint.name}' ({self.shape}, radius {self.radius:.4g} m, at x {x:.4g}, y {y:.4g} m)"


def wheel_candidates(document: Document, placements: dict[str, Array]) -> list[Candidate]:
    """Freely turning joints with a horizontal axis and a round body around it that touches the floor."""
    found = [c for joint in document.joints.values() if (c := round_joint(document, placements, joint))]
    known = [c for c in found if c.shape != "unknown"]
    heights = [lowest(shape) for link in document.links for shape in shapes(document, placements, link)]
    floor = min(heights + [c.bottom for c in known], default=math.inf)
    known += on_floor([c for c in found if c.shape == "unknown"], known, floor)
    floor = min([floor, *mass_heights(document, placements)])
    touching = [c for c in known if abs(c.bottom - floor) <= TOUCHING * c.radius]
    hanging = [c for c in known if not touching and is_axle(document, c, known)]
    if hanging:
        why = f"they end {min(c.bottom for c in hanging) - floor:.3g} m above the robot's lowest point"
        raise undecided(document, hanging, [], why)
    return touching


def is_axle(document: Document, candidate: Candidate, others: list[Candidate]) -> bool:
    """Whether it shares its axis with another and hangs on no turning joint: no wrist of an arm."""
    above = document.moving_ancestors(candidate.joint.child)[1:]
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
            wheels.append(replace(c, radius=radius))
    return wheels


def round_joint(document: Document, placements: dict[str, Array], joint: Joint) -> Candidate | None:
    """The joint as a wheel whose floor is not yet known, None when it cannot be one."""
    pose = placements[joint.child]
    axis, hub = pose[:3, :3] @ joint.axis, pose[:3, 3]
    if not joint.turns_freely or abs(axis[2]) > HORIZONTAL or document.moving_children(joint.child):
        return None
    seen = False
    for tag in ("collision", "visual"):
        bodies = [s for link in document.body(joint.child) for s in shapes(document, placements, link, tag)]
        bodies = [s for s in bodies if s.kind != "mesh" or len(s.points)]
        seen = seen or bool(bodies)
        rounds = [(*fit, s.kind) for s in bodies if (fit := round_about(s, hub, axis))]
        if rounds:
            radius, travel, kind = max(rounds)
            return Candidate(joint, axis, hub + travel * axis, radius, kind)
    return None if seen else Candidate(joint, axis, hub, math.nan, "unknown")


def coaxial(a: Candidate, b: Candidate) -> bool:
    """Whether two wheels turn about one line, at different places on it."""
    between = (b.centre - a.centre)[:2]
    along = between @ a.axis[:2]
    across = between - along * a.axis[:2]
    return bool(abs(a.axis @ b.axis) > 1 - HORIZONTAL**2 and np.hypot(*across) < COAXIAL * abs(along))


def hangs_on(document: Document, placements: dict[str, Array], joint: Joint) -> Literal["swivel", "steering", ""]:
    """Whether a wheel can turn about a vertical axis, freely (a caster) or within limits."""
    for above in document.moving_ancestors(joint.child)[1:]:
        if above.type in ("revolute", "continuous") and is_vertical(placements, above):
            return "swivel" if above.turns_freely else "steering"
    return ""


def is_vertical(placements: dict[str, Array], joint: Joint) -> bool:
    """Whether a joint's axis is vertical at rest."""
    return bool(abs((placements[joint.child][:3, :3] @ joint.axis)[2]) > 1 - HORIZONTAL)


def bare_swivels(document: Document, placements: dict[str, Array], drives: list[Candidate]) -> Iterator[Joint]:
    """Swivels whose wheel is welded on: they turn freely about the vertical and reach down to the floor."""
    floor, radius = max(c.bottom for c in drives), max(c.radius for c in drives)
    for joint in document.joints.values():
        if joint.turns_freely and is_vertical(placements, joint) and not document.moving_children(joint.child):
            heights = [lowest(s) for link in document.body(joint.child) for s in shapes(document, placements, link)]
            if min(heights, default=math.inf) < floor + TOUCHING * radius:
                yield joint


# --- Geometry at rest -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Shape:
    """A collision or visual shape in the root frame at rest.

    Attributes:
        kind: `cylinder`, `sphere`, `box` or `mesh`.
        pose: (4, 4) its placement.
        radius: Of a cylinder or sphere [m].
        half: (3,) half its extents along its own axes, for a cylinder the z one is its half length [m].
        points: (k, 3) vertices of a mesh in the root frame; (0, 3) when it cannot be read.
    """

    kind: str
    pose: Array
    radius: float
    half: Array
    points: Array


def shapes(document: Document, placements: dict[str, Array], link: str, tag: str = "") -> Iterator[Shape]:
    """Shapes of one link; without a tag its primitives only (reading every mesh takes long), collisions if it has any.

    Args:
        document: The robot.
        placements: Its links at rest.
        link: Name of the link.
        tag: `collision` or `visual`, meshes included.
    """
    element = document.links[link]
    primitives_only, tag = not tag, tag or ("visual" if element.find("collision") is None else "collision")
    for holder in element.iterchildren(tag):
        pose = placements[link] @ placement(holder.find("origin"))
        for body in holder.iterfind("geometry/*"):
            if body.tag in ("cylinder", "sphere", "box") or (body.tag == "mesh" and not primitives_only):
                yield shape_of(body, pose, document.path)


def shape_of(body: etree._Element, pose: Array, path: Path) -> Shape:
    """Shape of a child of `<geometry>`."""
    radius, half = number(body, "radius", 0.0), vector(body, "size") / 2
    if body.tag == "cylinder":
        half = np.array([radius, radius, number(body, "length", 0.0) / 2])
    points = np.zeros((0, 3))
    if body.tag == "mesh":
        points = mesh_points(path, body.get("filename", "")) * vector(body, "scale", (1.0, 1.0, 1.0))
    return Shape(body.tag, pose, radius, half, points @ pose[:3, :3].T + pose[:3, 3])


def lowest(shape: Shape) -> float:
    """Height of a primitive's lowest point [m]."""
    up = shape.pose[2, :3]  # the world's vertical in the shape's axes
    reach = {
        "sphere": shape.radius,
        "cylinder": shape.radius * math.hypot(up[0], up[1]) + shape.half[2] * abs(up[2]),
        "box": float(np.abs(up) @ shape.half),
    }
    return float(shape.pose[2, 3] - reach[shape.kind])


def round_about(shape: Shape, hub: Array, axis: Array) -> tuple[float, float] | None:
    """Radius of a shape that is round about an axis, and where its middle lies along it from the hub; else None."""
    if shape.kind == "mesh":
        return mesh_round_about(shape.points - hub, axis)
    offset = shape.pose[:3, 3] - hub
    travel = float(offset @ axis)
    centred = np.linalg.norm(offset - travel * axis) <= AROUND * shape.radius
    aligned = shape.kind == "sphere" or abs(shape.pose[:3, 2] @ axis) > 1 - HORIZONTAL**2
    return (shape.radius, travel) if shape.kind in ("sphere", "cylinder") and centred and aligned else None


def mesh_round_about(points: Array, axis: Array) -> tuple[float, float] | None:
    """The same for vertices: they must reach equally far in all directions across the axis."""
    along = points @ axis
    across = points - np.outer(along, axis)
    radius = float(np.linalg.norm(across, axis=1).max())
    side = np.cross(axis, [0.0, 0.0, 1.0])  # the axis is horizontal
    reach = [(across @ direction).max() for direction in (side, -side, np.cross(axis, side), np.cross(side, axis))]
    if radius <= 0 or min(reach) < (1 - 2 * AROUND) * radius:
        return None
    return radius, float(along.min() + along.max()) / 2


def mesh_points(urdf: Path, name: str) -> Array:
    """(k, 3) vertices of a mesh file, unscaled; (0, 3) when it is missing, remote, outside or cannot be read."""
    file = mesh_file(urdf, name)
    if file is None:
        return np.zeros((0, 3))
    import trimesh  # comes with yourdfpy; slow to import

    try:
        return np.array(trimesh.load_mesh(file).vertices, dtype=np.float64).reshape(-1, 3)
    except Exception:  # whatever a damaged file makes a decoder raise: the mesh counts as unknown
        return np.zeros((0, 3))


def mesh_file(urdf: Path, name: str) -> Path | None:
    """The file of a mesh: `package://` is looked for upwards from the URDF; nothing outside its package is opened."""
    scheme, _, rest = name.rpartition("://")
    folder = urdf.absolute().parent
    tops = [folder, *folder.parents] if scheme == "package" else [folder]
    if scheme not in ("", "package", "file"):
        return None
    for top in tops:
        file = (top / rest).resolve()
        inside = top / Path(rest).parts[0] if scheme == "package" and rest else folder.parent
        if file.is_file() and file.is_relative_to(inside.resolve()):
            return file
    return None


def rest_placements(document: Document) -> dict[str, Array]:
    """(4, 4) placement of every link in the root link's frame with all joints at rest."""
    placements = {document.root_link: np.eye(4)}
    pending = [document.root_link]
    while pending:
        link = pending.pop()
        for joint in document.children[link]:
            placements[joint.child] = placements[link] @ joint.origin @ motion(joint, joint.rest)
            pending.append(joint.child)
    return placements


def motion(joint: Joint, position: float) -> Array:
    """(4, 4) motion of a joint's child at a position [rad or m]."""
    result = np.eye(4)
    if joint.type == "prismatic":
        result[:3, 3] = position * joint.axis
    elif joint.type in ("revolute", "continuous"):
        x, y, z = joint.axis
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        result[:3, :3] += math.sin(position) * K + (1 - math.cos(position)) * K @ K  # Rodrigues
    return result


def mass_heights(document: Document, placements: dict[str, Array]) -> list[float]:
    """Heights of the centres of mass [m] of links without primitive shapes: the body reaches at least that low."""
    heights = []
    for name, link in document.links.items():
        inertial, shaped = link.find("inertial"), any(shapes(document, placements, name))
        if inertial is not None and not shaped and number(inertial.find("mass"), "value", 0.0) > 0:
            heights.append(float((placements[name] @ placement(inertial.find("origin")))[2, 3]))
    return heights
