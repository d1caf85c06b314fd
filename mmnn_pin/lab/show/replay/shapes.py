"""Shapes of a robot for a page: those of its links, each geometry once; meshes as triangles, small.

For a mesh that cannot be shown the collision shapes of its link stand in, or a box of `STAND_IN` metres in a colour of
its own, with a warning; a box marks every body of a robot whose file has no shapes at all. A mesh takes 16 bits per
coordinate, with equal vertices merged and one colour per part: the grid of 65,536 steps spans the part's own box, so a
part 1 m long is off by 8 micrometres at most.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from ....model.base.overrides import folders_of
from ....model.robot import Robot
from ....model.urdf.document import number, placement, vector
from ....model.urdf.meshes import BrokenMesh, meshes_of
from ....model.urdf.packages import locate
from ....recording.robot_file import UNSEEN
from ....signals import Array
from ..files import Blob
from .motion import ReplayTree, columns

Color = tuple[float, float, float, float]  # red, green, blue, opacity, each in [0, 1]
ColouredMesh = tuple[int, Color | None]  # a geometry's index, and the colour that its file gives

STAND_IN = 0.1  # edge of the box in the place of a mesh [m]
STANDS_IN = {True: "collision shapes stand in", False: f"a box of {STAND_IN:g} m stands in"}  # whether there are some
MISSING: Color = (0.93, 0.36, 0.62, 1.0)
PLAIN: Color = (0.72, 0.74, 0.77, 1.0)
WHY = {"remote": "is remote and never fetched", "outside": "lies outside its package"}
STEPS = 65535


class Lost(NamedTuple):
    """A mesh that cannot be shown: its name, and what is wrong with it; nothing where it is not there."""

    name: str
    why: str


class Shapes:
    """The geometries of all robots of a page, and how they are placed.

    Args:
        blob: Takes the meshes.
        package_dirs: Folders to look for meshes in before those that a robot knows.

    Attributes:
        geometries: As the page reads them.
        parts: Those of them that are meshes, by their place.
    """

    def __init__(self, blob: Blob, package_dirs: Sequence[str | Path] = ()) -> None:
        self.geometries: list[dict[str, Any]] = []
        self.parts: dict[int, MeshPart] = {}
        self._warned: list[str] = []
        self._missing: dict[str, bool] = {}  # whether collision shapes stand in
        self._blob, self._folders = blob, tuple(package_dirs)
        self._files: dict[Path, list[ColouredMesh]] = {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """A line for everything that is not shown as the URDF says."""
        lines = dict.fromkeys(self._warned)
        fix = "give the folder of their packages (--package-dir), or put them there"
        for kind, stands_in in STANDS_IN.items():
            names = [name for name, shaped in self._missing.items() if shaped == kind]
            if names:
                more = f" and {len(names) - 1} more are" if names[1:] else " is"
                lines[f"mesh '{names[0]}'{more} missing: {stands_in}: {fix}"] = None
        return tuple(lines)

    def visuals(self, robot: Robot, tree: ReplayTree) -> list[dict[str, Any]]:
        """The shapes of a robot, as the page reads them: body, placement, geometry, colour."""
        links, root = tree.document.links, tree.document.root
        colors = {material.get("name"): rgba(material) for material in root.iterfind("material")}
        tag = next((t for t in ("visual", "collision") if any(e.find(t) is not None for e in links.values())), "")
        if tag != "visual":
            shown = "its collision shapes are shown" if tag else "a box marks every body"
            self._warned.append(f"{robot.name} has no visual shapes: {shown}")
        found = []
        for link, element in links.items():
            body, place = tree.places[link]
            lost = []
            for holder in element.iterchildren(tag) if tag else ():
                color = color_of(holder, colors)
                for at, solid in self._solids(robot, holder):
                    if isinstance(solid, Lost):
                        lost.append((at, solid))
                    else:
                        found.append((body, place @ at, solid[0], color or solid[1] or PLAIN))
            found += [(body, place @ at, *placed) for at, placed in self._instead(robot, element, lost)]
        box = self._box(STAND_IN) if not found else 0
        found = found or [(body, np.eye(4), box, MISSING) for body in range(len(tree.bodies))]
        return [
            {"body": body, "place": columns(place), "geometry": geometry, "color": [round(part, 4) for part in color]}
            for body, place, geometry, color in found
        ]

    def _instead(
        self, robot: Robot, link: etree._Element, lost: Sequence[tuple[Array, Lost]]
    ) -> Iterator[tuple[Array, tuple[int, Color]]]:
        """Substitutes for meshes of a link that cannot be shown: its collision shapes, else boxes; warns of it."""
        if not lost:
            return
        every = (one for holder in link.iterchildren("collision") for one in self._solids(robot, holder))
        shapes = [(at, (solid[0], PLAIN)) for at, solid in every if not isinstance(solid, Lost)]
        for _, (name, why) in lost:
            if why:
                self._warned.append(f"mesh '{name}' {why}: {STANDS_IN[bool(shapes)]}")
            else:
                self._missing[name] = bool(shapes)
        yield from shapes or [(at, (self._box(STAND_IN), MISSING)) for at, _ in lost]

    def _solids(self, robot: Robot, holder: etree._Element) -> Iterator[tuple[Array, ColouredMesh | Lost]]:
        """Placement on the link, geometry and own colour of what is in a `<visual>` or `<collision>`."""
        at = placement(holder.find("origin"))
        for solid in holder.iterfind("geometry/*"):
            if solid.tag == "mesh":
                yield from self._mesh(robot, at, solid)
            elif solid.tag == "box":
                yield at, (self._box(*vector(solid, "size").tolist()), None)
            elif solid.tag in ("cylinder", "sphere"):
                sizes = [number(solid, "radius", 0.0), number(solid, "length", 0.0)]
                yield at, (self._index({"kind": solid.tag, "size": sizes}), None)

    def _mesh(self, robot: Robot, at: Array, solid: etree._Element) -> Iterator[tuple[Array, ColouredMesh | Lost]]:
        name = solid.get("filename", "")
        found = locate(name, robot.path, (*self._folders, *folders_of(robot.path, robot.overrides)))
        try:
            if found.file is None:
                raise BrokenMesh(WHY.get(found.problem, ""))
            if found.file not in self._files:
                self._files[found.file] = [(self._part(part), part.color) for part in read_mesh(found.file)]
        except BrokenMesh as error:
            gone = found.problem == "missing" or name.startswith(UNSEEN)
            yield at, Lost(name.removeprefix(UNSEEN) if gone else name, "" if gone else str(error))
            return
        scaled = at @ np.diag([*vector(solid, "scale", (1.0, 1.0, 1.0)), 1.0])
        yield from ((scaled, placed) for placed in self._files[found.file])

    def _part(self, part: MeshPart) -> int:
        indices = "u2" if len(part.grid) <= np.iinfo(np.uint16).max else "u4"
        points, triangles = self._blob.add(part.grid, "u2"), self._blob.add(part.triangles, indices)
        grid = {"corner": part.corner.tolist(), "step": part.step.tolist()}
        index = self._index({"kind": "mesh", "points": points, "triangles": triangles, **grid})
        self.parts[index] = part
        return index

    def _box(self, *edges: float) -> int:
        return self._index({"kind": "box", "size": list(edges * 3)[:3]})

    def _index(self, geometry: dict[str, Any]) -> int:
        if geometry not in self.geometries:
            self.geometries.append(geometry)
        return self.geometries.index(geometry)


def color_of(holder: etree._Element, named: dict[str, Color | None]) -> Color | None:
    """Colour of a `<visual>`: its own, else the one that the robot gives that name."""
    material = holder.find("material")
    return None if material is None else rgba(material) or named.get(material.get("name"))


def rgba(material: etree._Element) -> Color | None:
    """Colour of a `<material>`, None for one without."""
    words = (material.find("color").get("rgba", "") if material.find("color") is not None else "").split()
    if len(words) != 4:
        return None
    red, green, blue, opacity = (min(max(float(word), 0.0), 1.0) for word in words)
    return red, green, blue, opacity


# -- meshes ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Triangles of one colour."""

    grid: NDArray[np.uint16]  # (k, 3) vertices in steps of the grid, uint16
    corner: Array  # (3,) the grid's lowest corner [m, in the mesh's own scale]
    step: Array  # (3,) its steps
    triangles: NDArray[np.int64]  # (m, 3) indices of vertices
    color: Color | None  # the colour that the file gives; None when it gives none


def read_mesh(file: Path) -> list[MeshPart]:
    """The parts of a mesh file: STL, Collada, OBJ and whatever else trimesh reads.

    The file's up axis is ignored, its unit is not: as RViz does.

    Raises:
        BrokenMesh: It cannot be read, or holds no triangles.
    """
    try:
        return [part_of(mesh) for mesh in meshes_of(file)]
    except BrokenMesh:
        raise
    except Exception as error:  # of what trimesh took for a place or a colour
        raise BrokenMesh(f"cannot be read ({str(error) or type(error).__name__})") from error


def part_of(mesh: Any) -> MeshPart:
    """Part of a trimesh.

    Raises:
        BrokenMesh: A vertex is not finite.
    """
    points = np.asarray(mesh.vertices, dtype=float) * unit_of(mesh)
    if not np.isfinite(points).all():
        raise BrokenMesh("holds a vertex that is not finite")
    corner = points.min(axis=0)
    step = np.maximum((points.max(axis=0) - corner) / STEPS, np.finfo(float).tiny)
    grid, triangles = merged(np.rint((points - corner) / step).astype(np.uint64), np.asarray(mesh.faces))
    return MeshPart(grid, corner, step, triangles, mesh_color(mesh))


def merged(grid: NDArray[np.uint64], triangles: NDArray[Any]) -> tuple[NDArray[np.uint16], NDArray[np.int64]]:
    """Vertices without doubles, and the triangles that are left: those with three different corners."""
    keys, index = np.unique(grid @ np.array([1 << 32, 1 << 16, 1], dtype=np.uint64), return_inverse=True)
    corners = index.reshape(-1)[triangles]
    a, b, c = corners.T
    vertices = np.column_stack([(keys >> np.uint64(shift)) & np.uint64(0xFFFF) for shift in (32, 16, 0)])
    return vertices.astype(np.uint16), corners[(a != b) & (b != c) & (c != a)]


def unit_of(mesh: Any) -> float:
    """Metres per unit, which Collada files state; trimesh has it as `0.01 * meters`."""
    stated, _, rest = str(mesh.metadata.get("units", "")).partition(" * ")
    return float(stated) if rest else 1.0


def mesh_color(mesh: Any) -> Color | None:
    """The main colour that a file gives a mesh; one without any opacity is an exporter's slip and counts as full."""
    rgba = getattr(getattr(mesh.visual, "material", mesh.visual), "main_color", None) if mesh.visual.defined else None
    if rgba is None:
        return None
    red, green, blue, opacity = (float(value) / 255 for value in rgba)
    return red, green, blue, opacity or 1.0
