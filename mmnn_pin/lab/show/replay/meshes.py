"""Mesh files as triangles, small: 16 bits per coordinate, equal vertices merged, one colour per part.

The grid of 65,536 steps spans the part's own box, so a part 1 m long is off by 8 micrometres at most.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....signals import Array

STEPS = 65535
Color = tuple[float, float, float, float]  # red, green, blue, opacity, each in [0, 1]


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles of one colour.

    Attributes:
        grid: (k, 3) vertices in steps of the grid, uint16.
        corner: (3,) the grid's lowest corner [m, in the mesh's own scale].
        step: (3,) its steps.
        triangles: (m, 3) indices of vertices.
        color: The colour that the file gives; None when it gives none.
    """

    grid: NDArray[np.uint16]
    corner: Array
    step: Array
    triangles: NDArray[np.int64]
    color: Color | None


class BrokenMesh(Exception):
    """A mesh file that cannot be shown; the text tells why."""


def read_mesh(file: Path) -> list[Part]:
    """The parts of a mesh file: STL, Collada, OBJ and whatever else trimesh reads.

    The file's up axis is ignored, its unit is not: as RViz does.

    Raises:
        BrokenMesh: It cannot be read, or holds no triangles.
    """
    import trimesh  # slow to import

    try:
        loaded: Any = trimesh.load(file, process=False)
        meshes = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
        parts = [part_of(mesh) for mesh in meshes if len(getattr(mesh, "faces", ()))]
    except BrokenMesh:
        raise
    except Exception as error:  # whatever a damaged file makes a decoder raise
        raise BrokenMesh(f"cannot be read ({str(error) or type(error).__name__})") from error
    if not parts:
        raise BrokenMesh("holds no triangles")
    return parts


def part_of(mesh: Any) -> Part:
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
    return Part(grid, corner, step, triangles, color_of(mesh))


def merged(grid: NDArray[np.uint64], triangles: NDArray[Any]) -> tuple[NDArray[np.uint16], NDArray[np.int64]]:
    """Vertices without doubles, and the triangles that are left: those with three different corners."""
    keys, index = np.unique(grid @ np.array([1 << 32, 1 << 16, 1], dtype=np.uint64), return_inverse=True)
    corners = index.reshape(-1)[triangles]
    a, b, c = corners.T
    vertices = np.column_stack([(keys >> np.uint64(shift)) & np.uint64(0xFFFF) for shift in (32, 16, 0)])
    return vertices.astype(np.uint16), corners[(a != b) & (b != c) & (c != a)]


def unit_of(mesh: Any) -> float:
    """Metres per unit, which Collada files state; trimesh tells it as `0.01 * meters`."""
    stated, _, rest = str(mesh.metadata.get("units", "")).partition(" * ")
    return float(stated) if rest else 1.0


def color_of(mesh: Any) -> Color | None:
    """The main colour that a file gives a mesh; one without any opacity is an exporter's slip and counts as full."""
    if not mesh.visual.defined:
        return None
    rgba = getattr(getattr(mesh.visual, "material", mesh.visual), "main_color", None)
    if rgba is None:
        return None
    red, green, blue, opacity = (float(value) / 255 for value in rgba)
    return red, green, blue, opacity or 1.0
