"""A robot at rest, in the root link's frame: where its links are, the shapes on them, and how low they reach.

Everything that is concluded about the base starts from this geometry. Mesh files are looked for inside their package
and read only when they are asked for (that takes long); nothing is fetched, nothing outside is opened.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from lxml import etree

from ...elementary import arrays, cos_sin, hypot
from ...elementary.matrices import length, product
from ...signals import Array
from .document import Document, Joint, number, numbers, placement, vector
from .meshes import vertices_of
from .packages import locate

PRIMITIVES = ("cylinder", "sphere", "box")
SHAPES = (*PRIMITIVES, "capsule", "mesh")
AROUND = 0.05  # a wheel's shape may be off its axis by this fraction of the radius
TREAD = 0.98  # what reaches out further than this fraction of a wheel's radius is its tread
HORIZONTAL = 0.02  # largest vertical part of a unit axis that counts as horizontal
VERTICAL = 1 - HORIZONTAL  # smallest vertical part of one that counts as vertical


@dataclass(frozen=True, eq=False)
class Shape:
    """A collision or visual shape in the root frame at rest."""

    kind: str  # `cylinder`, `sphere`, `box` or `mesh`
    pose: Array  # (4, 4) its placement
    radius: float  # of a cylinder or sphere [m]
    half: Array  # (3,) half its extents along its own axes, for a cylinder the z one is its half length [m]
    points: Array  # (k, 3) vertices of a mesh in the root frame; (0, 3) when it cannot be read

    @property
    def rolls(self) -> bool:
        """Whether it can stand on a floor and roll: a ball, or a cylinder that lies."""
        return self.kind == "sphere" or (self.kind == "cylinder" and abs(self.pose[2, 2]) <= HORIZONTAL)

    @cached_property
    def lowest(self) -> float:
        """Height of a primitive's lowest point [m]."""
        x, y, z, height = self.pose[2].tolist()  # the vertical in the shape's axes
        if self.kind == "sphere":
            return float(height - self.radius)
        if self.kind == "cylinder":
            return float(height - self.radius * hypot(x, y) - self.half[2] * abs(z))
        a, b, c = self.half.tolist()
        return float(height - a * abs(x) - b * abs(y) - c * abs(z))


@dataclass(frozen=True, eq=False)
class AtRest:
    """A robot with all joints at rest."""

    document: Document  # the audited URDF
    # folders that `package://` is looked for in, before the folders above the URDF
    package_dirs: Sequence[str | Path] = ()

    @cached_property
    def placements(self) -> dict[str, Array]:
        """(4, 4) placement of every link in the root link's frame."""
        placements = {self.document.root_link: np.eye(4)}
        pending = [self.document.root_link]
        while pending:
            link = pending.pop()
            for joint in self.document.children[link]:
                at_zero = product(placements[link], joint.origin)
                placements[joint.child] = product(at_zero, motion(joint, joint.rest)) if joint.rest else at_zero
                pending.append(joint.child)
        return placements

    def axis(self, joint: Joint) -> Array:
        """(3,) axis of a joint."""
        return product(self.placements[joint.child][:3, :3], joint.axis)

    def hub(self, joint: Joint) -> Array:
        """(3,) origin of a joint's child link [m]."""
        return self.placements[joint.child][:3, 3]

    def is_vertical(self, joint: Joint) -> bool:
        """Whether a joint's axis is vertical."""
        return bool(abs(self.axis(joint)[2]) > VERTICAL)

    def is_horizontal(self, joint: Joint) -> bool:
        """Whether a joint's axis is horizontal."""
        return bool(abs(self.axis(joint)[2]) <= HORIZONTAL)

    @cached_property
    def primitives(self) -> dict[str, list[Shape]]:
        """Cylinders, spheres and boxes of every link, of its collisions if it has any, else of its visuals."""
        table = {}
        for name, link in self.document.links.items():
            tag = "visual" if link.find("collision") is None else "collision"
            table[name] = list(self.shapes(name, tag, PRIMITIVES))
        return table

    def shapes(self, link: str, tag: str, kinds: Sequence[str] = (*PRIMITIVES, "mesh")) -> Iterator[Shape]:
        """Shapes of one link.

        Args:
            link: Name of the link.
            tag: `collision` or `visual`.
            kinds: Which shapes.
        """
        for holder in self.document.links[link].iterchildren(tag):
            body = next((body for body in holder.iterfind("geometry/*") if body.tag in SHAPES), None)
            if body is not None and body.tag in kinds:
                pose = product(self.placements[link], placement(holder.find("origin")))
                yield self.mesh(body, pose) if body.tag == "mesh" else primitive(body, pose)

    def mesh(self, body: etree._Element, pose: Array) -> Shape:
        """Shape of a `<mesh>`."""
        points = mesh_points(self.document.path, body.get("filename", ""), self.package_dirs)
        with np.errstate(over="ignore", invalid="ignore"):
            points = product(points * vector(body, "scale", (1.0, 1.0, 1.0)), pose[:3, :3].T) + pose[:3, 3]
        return Shape("mesh", pose, 0.0, np.zeros(3), points if np.isfinite(points).all() else np.zeros((0, 3)))

    @property
    def is_footprint(self) -> bool:
        """Whether the root link has no mass of its own: a frame, by custom on the floor."""
        return self.mass(self.document.root_link) == 0

    @cached_property
    def masses(self) -> dict[str, float]:
        """Mass of every link [kg], 0 where none is stated."""
        return {name: number(link.find("inertial/mass"), "value", 0.0) for name, link in self.document.links.items()}

    def mass(self, link: str) -> float:
        """Mass of a link [kg], 0 where none is stated."""
        return self.masses[link]

    def centre(self, link: str) -> Array:
        """(3,) centre of mass of a link [m]."""
        origin, at = self.document.links[link].find("inertial/origin"), self.placements[link]
        return product(at[:3, :3], numbers(origin, "xyz")) + at[:3, 3]

    @cached_property
    def middle(self) -> Array:
        """(3,) centre of mass of the robot, 0 of one without mass [m]."""
        total = sum((mass * self.centre(link) for link, mass in self.masses.items()), np.zeros(3))
        return np.asarray(total / (math.fsum(self.masses.values()) or 1.0))

    def bottom(self, link: str) -> float:
        """Height of a link's lowest place by its primitives, else of its centre of mass; inf for an empty one [m]."""
        heights = [shape.lowest for shape in self.primitives[link]]
        if not heights and self.mass(link) > 0:
            heights = [float(self.centre(link)[2])]
        return min(heights, default=math.inf)


def primitive(body: etree._Element, pose: Array) -> Shape:
    """Shape of a `<cylinder>`, `<sphere>` or `<box>`."""
    radius, half = number(body, "radius", 0.0), vector(body, "size") / 2
    if body.tag == "cylinder":
        half = np.array([radius, radius, number(body, "length", 0.0) / 2])
    return Shape(body.tag, pose, radius, half, np.zeros((0, 3)))


def motion(joint: Joint, position: float) -> Array:
    """(4, 4) motion of a joint's child at a position [rad or m]."""
    result = np.eye(4)
    if joint.type == "prismatic":
        result[:3, 3] = position * joint.axis
    elif joint.type in ("revolute", "continuous"):
        return rotation(joint.axis, position)
    return result


def rotation(axis: Array, angle: float) -> Array:
    """(4, 4) rotation about an axis (3,) of unit length through the origin (Rodrigues) [rad]."""
    (x, y, z), result, (c, s) = axis, np.eye(4), cos_sin(angle)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    result[:3, :3] += s * K + (1 - c) * product(K, K)
    return result


def round_about(shape: Shape, hub: Array, axis: Array) -> tuple[float, float] | None:
    """Radius of a shape that is round about an axis, and where its middle lies along it from the hub; else None."""
    if shape.kind == "mesh":
        return mesh_round_about(shape.points - hub, axis)
    offset = shape.pose[:3, 3] - hub
    travel = float(product(offset, axis))
    centred = length(offset - travel * axis) <= AROUND * shape.radius
    aligned = shape.kind == "sphere" or abs(shape.pose[:3, 2] @ axis) > 1 - HORIZONTAL**2
    return (shape.radius, travel) if shape.kind in ("sphere", "cylinder") and centred and aligned else None


def is_ball(shape: Shape, centre: Array, radius: float) -> bool:
    """Whether a shape that is round about an axis is as round about all others through its middle."""
    if shape.kind != "mesh":
        return shape.kind == "sphere"
    away = shape.points - centre
    room = (1 + 2 * AROUND) * radius
    return bool(np.linalg.norm(away, axis=1).max() <= room and np.ptp(away, axis=0).min() >= 2 * (1 - AROUND) * radius)


def mesh_round_about(points: Array, axis: Array) -> tuple[float, float] | None:
    """Radius and middle of vertices that reach equally far in all directions across an axis; else None.

    The middle is that of the tread, the vertices that reach out almost as far as the farthest: a hub does not roll.
    """
    along = product(points, axis)
    across = points - np.outer(along, axis)
    out = np.linalg.norm(across, axis=1)
    radius = float(out.max())
    side = np.cross(axis, [0.0, 0.0, 1.0])  # the axis is horizontal
    reach = [
        product(across, direction).max() for direction in (side, -side, np.cross(axis, side), np.cross(side, axis))
    ]
    if radius <= 0 or min(reach) < (1 - 2 * AROUND) * radius:
        return None
    tread = along[out >= TREAD * radius]
    return radius, float(tread.min() + tread.max()) / 2


def reach_about(shape: Shape, hub: Array, axis: Array) -> tuple[float, float, float]:
    """Reach of a shape from an axis, and its ends along the axis from the hub [m]: of a roller's rim."""
    points = outline(shape) - hub
    along = product(points, axis)
    out = np.linalg.norm(points - np.outer(along, axis), axis=1) + (shape.radius if shape.kind == "sphere" else 0.0)
    far = along[out >= TREAD * out.max()]
    return float(out.max()), float(far.min()), float(far.max())


def outline(shape: Shape) -> Array:
    """(k, 3) points on a shape that reach as far out as it does; of a ball its middle."""
    if shape.kind == "mesh":
        return shape.points
    if shape.kind == "sphere":
        return shape.pose[None, :3, 3]
    turn = np.linspace(0.0, 2 * math.pi, 73)[:-1]
    ring = np.column_stack(arrays.cos_sin(turn))
    if shape.kind == "box":
        ring = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)])
    both = np.vstack([np.column_stack((ring, np.full(len(ring), end))) for end in (-1.0, 1.0)])
    return both * shape.half @ shape.pose[:3, :3].T + shape.pose[:3, 3]


def mesh_points(urdf: Path, name: str, package_dirs: Sequence[str | Path] = ()) -> Array:
    """(k, 3) vertices of a mesh file, unscaled; (0, 3) when it is missing, remote, outside or cannot be read."""
    file = locate(name, urdf, package_dirs).file
    try:
        return np.zeros((0, 3)) if file is None else vertices_of(file, file.stat().st_mtime_ns)
    except OSError:
        return np.zeros((0, 3))
