"""Mesh files, read within limits: what is wrong with one by its size, head and tail, its vertices, its parts.

They are read by trimesh, but only what trimesh is handed: no picture, nothing out of another folder, no archive, no
more corners than `MOST_CORNERS`, however often a small file repeats itself.
"""

from __future__ import annotations

import json
import logging
import re
import struct
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from lxml import etree

from ...errors import printable, short
from ...files import parsed_json
from ...signals import Array
from .document import read_numbers

MOST_BYTES = {".stl": 60_000_000, ".dae": 60_000_000, ".obj": 60_000_000}  # of a mesh; no wheel needs more
OTHER_FORMATS = {".ply": 8_000_000, ".glb": 8_000_000, ".gltf": 8_000_000, ".off": 8_000_000}  # read by trimesh
CHUNK = 65_536  # bytes looked at, at either end of a file
TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", 9), ("attributes", "<u2")])  # of a binary STL file
UNIT = re.compile(rb"<unit\b[^<>]*?\bmeter\s*=\s*[\"']([^\"']+)[\"']")  # of a COLLADA file
VERTEX = re.compile(rb"^v[ \t]+(\S+[ \t]+\S+[ \t]+\S+)", re.MULTILINE)  # of an OBJ file
MOST_CORNERS = 6_000_000  # of the triangles of a mesh file with all its copies
MOST_PARTS = 10_000  # of such a file: each takes a millisecond
MOST_UNFOLDED = 120_000_000  # letters of the geometries of a Collada file with all its copies
MOST_STATED = 64_000_000  # bytes of the numbers that a glTF file states
POINTER = "a git-LFS pointer, its content was not downloaded"
NO_SHAPE = "assumed: no shape; only the radius of a wheel needs it"
PLAIN_XML = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=True)
MOST_BESIDE = 8_000_000  # bytes of a file that a mesh file names
BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}  # of a number in a glTF file
MOST_TEXT = 200  # letters of what is wrong: a decoder quotes the file
NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}  # of an entry there


class BrokenMesh(Exception):
    """A mesh file that cannot be shown; the text says why, in at most `MOST_TEXT` letters of one line."""

    def __init__(self, why: str) -> None:
        super().__init__(short(" ".join(printable(why).split()), MOST_TEXT))


@lru_cache(maxsize=16)
def vertices_of(file: Path, changed: int) -> Array:
    """(k, 3) vertices of a mesh file, read-only; (0, 3) when it cannot be read; wheels share one file.

    Args:
        file: The file.
        changed: When it was written last; a file written again is read again.
    """
    if damage_of(file):
        return np.zeros((0, 3))
    if file.suffix.lower() == ".stl" and (corners := stl_corners(file)) is not None:
        return corners
    if file.suffix.lower() == ".obj":
        return obj_vertices(file)
    if file.suffix.lower() == ".dae":
        return collada_corners(file) * unit_of(file)
    try:
        with warnings.catch_warnings(action="ignore"):  # of numbers that are not finite
            parts = [np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3) for mesh in meshes_of(file)]
        return np.concatenate(parts)
    except BrokenMesh:
        return np.zeros((0, 3))


def meshes_of(file: Path) -> list[Any]:
    """The meshes that a file shows, in its own unit, as trimesh has them: each in its place, with faces and material.

    Raises:
        BrokenMesh: It cannot be read, shows far too much, or holds no triangles.
    """
    import trimesh  # comes with yourdfpy; slow to import

    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # of textures that are not there
    if damage := damage_of(file):
        raise BrokenMesh(f"cannot be read ({damage})")
    try:
        kind = file.suffix.lower()[1:]
        beside: Any = Beside(file.parent)
        check = {"dae": collada_problem, "glb": gltf_problem, "gltf": gltf_problem}.get(kind)
        if problem := check(file) if check else "":
            raise BrokenMesh(f"cannot be read ({problem})")
        source = BytesIO(without_pictures(file)) if kind in ("glb", "gltf") else file
        loaded: Any = trimesh.load(source, file_type=kind, process=False, resolver=beside)
        if isinstance(loaded, trimesh.Scene):
            require_few(loaded)
        parts = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
    except BrokenMesh:
        raise
    except Exception as error:  # whatever a damaged file makes a decoder raise
        raise BrokenMesh(f"cannot be read ({str(error) or type(error).__name__})") from error
    parts = [mesh for mesh in parts if len(getattr(mesh, "faces", ()))]
    if not parts:
        raise BrokenMesh("holds no triangles")
    return parts


def require_few(scene: Any) -> None:
    """Refuse a scene that shows its meshes far too often, before they are copied (`BrokenMesh`)."""
    shown = [scene.graph[name][1] for name in scene.graph.nodes_geometry]
    if len(shown) > MOST_PARTS:
        raise BrokenMesh(f"shows more than {MOST_PARTS:,} parts")
    if 3 * sum(len(getattr(scene.geometry[one], "faces", ())) for one in shown) > MOST_CORNERS:
        raise BrokenMesh(f"shows more than {MOST_CORNERS // 3:,} triangles")


@dataclass(frozen=True)
class Beside:
    """Files beside a mesh file that it may name: materials and buffers of its own folder. No picture is ever opened."""

    folder: Path

    def get(self, name: str) -> bytes:
        """The content of a file.

        Raises:
            FileNotFoundError: There is none that it may have.
        """
        file = self.folder / name.strip()
        if file.parent != self.folder or file.suffix.lower() not in (".mtl", ".bin") or not file.is_file():
            raise FileNotFoundError(name)
        if file.stat().st_size > MOST_BESIDE:
            raise FileNotFoundError(f"{name}: more than {MOST_BESIDE // 1_000_000} MB")
        return file.read_bytes()

    __getitem__ = get


def unit_of(file: Path) -> float:
    """Metres in the unit of a COLLADA file, by which RViz and Gazebo scale it; 1 where none is stated."""
    if file.suffix.lower() != ".dae":
        return 1.0
    with file.open("rb") as stream:
        hit = UNIT.search(stream.read(CHUNK))
    value = read_numbers(hit[1].decode(errors="replace")) if hit else ()
    return value[0] if len(value) == 1 and value[0] > 0 else 1.0


def stl_corners(file: Path) -> Array | None:
    """(k, 3) corners of a binary STL file, None for the text form."""
    data = file.read_bytes()
    if data.lstrip().startswith(b"solid") and b"facet" in data[:CHUNK]:
        return None
    triangles = np.frombuffer(data, dtype=TRIANGLE, count=int.from_bytes(data[80:84], "little"), offset=84)
    return np.asarray(triangles["corners"].reshape(-1, 3), dtype=np.float64)


def obj_vertices(file: Path) -> Array:
    """(k, 3) vertices of an OBJ file; (0, 3) where one is no three numbers."""
    lines = VERTEX.findall(file.read_bytes())
    with warnings.catch_warnings(action="ignore"):  # where a word is no number it stops, or refuses all
        try:
            values = np.fromstring(b" ".join(lines), sep=" ")
        except ValueError:
            return np.zeros((0, 3))
    return values.reshape(-1, 3) if values.size == 3 * len(lines) else np.zeros((0, 3))


def collada_corners(file: Path) -> Array:
    """(k, 3) corners of the triangles and polygons that a COLLADA file shows, in its unit; (0, 3) where it is broken.

    As trimesh has them, which itself reads with pycollada, but takes three times as long to be imported.
    """
    import collada

    kinds = (collada.triangleset.TriangleSet, collada.polylist.Polylist)

    def shown(node: Any, pose: Array) -> Iterator[Array]:
        for part in node.geometry.primitives if isinstance(node, collada.scene.GeometryNode) else ():
            if isinstance(part, kinds) and part.vertex is not None and len(part.vertex_index):
                used = part.vertex[np.unique(part.vertex_index)]
                yield used.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        for child in (node.children or ()) if isinstance(node, collada.scene.Node) else ():
            yield from shown(child, pose @ node.matrix)

    try:
        with warnings.catch_warnings(action="ignore"):
            if not collada_problem(file):
                scene = collada.Collada(BytesIO(file.read_bytes()), ignore=[collada.common.DaeError]).scene
                found = [corners for node in scene.nodes for corners in shown(node, np.eye(4))]
                return np.concatenate([np.zeros((0, 3)), *found])
    except Exception:  # whatever a damaged file makes a decoder raise
        return np.zeros((0, 3))
    return np.zeros((0, 3))


def damage_of(file: Path) -> str:
    """The fault of a mesh file by its size, its head and its tail; empty when none is seen."""
    try:
        size = file.stat().st_size
        with file.open("rb") as stream:
            head = stream.read(CHUNK)
            stream.seek(max(size - CHUNK, 0))
            tail = stream.read(CHUNK)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    if not size:
        return "it is empty"
    if head.startswith(b"version https://git-lfs"):
        return POINTER
    most = (MOST_BYTES | OTHER_FORMATS).get(file.suffix.lower())
    if most is None:
        return "it is in a format that is not read: use STL, COLLADA or OBJ"
    if size > most:
        return f"it has more than {most // 1_000_000} MB"
    check = {".stl": stl_damage, ".dae": dae_damage, ".obj": obj_damage, ".glb": glb_damage}.get(file.suffix.lower())
    return check(head, tail, size) if check else ""


def stl_damage(head: bytes, tail: bytes, size: int) -> str:
    """Binary STL states its number of triangles, 50 bytes each; the text form ends with `endsolid`."""
    if head.lstrip().startswith(b"solid") and b"facet" in head:
        return "" if b"endsolid" in tail else "it ends before endsolid"
    if size < 84:
        return f"an STL file has at least 84 bytes, this one {size}"
    need = 84 + 50 * int.from_bytes(head[80:84], "little")
    if size < need:
        return f"its {(need - 84) // 50} triangles take {need} bytes, it has {size}"
    whole = head[84 : 84 + (min(need, len(head)) - 84) // 50 * 50]
    corners = np.frombuffer(whole, dtype=TRIANGLE)["corners"]
    return "" if np.isfinite(corners).all() else "a corner of its triangles is not finite"


def dae_damage(head: bytes, tail: bytes, size: int) -> str:
    """Collada is XML from `<COLLADA` to its end, without a DOCTYPE."""
    if b"<!DOCTYPE" in head:
        return "a DOCTYPE, whose entities could blow up"
    return "" if b"<COLLADA" in head and b"</COLLADA" in tail else "not a whole Collada file"


def obj_damage(head: bytes, tail: bytes, size: int) -> str:
    """An OBJ file lists vertices, `v x y z`."""
    return "" if head.startswith(b"v ") or b"\nv " in head + tail else "it has no vertices"


def glb_damage(head: bytes, tail: bytes, size: int) -> str:
    """A GLB file states its size and that of its first part, for which a reader makes room at once."""
    stated, first = (int.from_bytes(head[at : at + 4], "little") for at in (8, 12))
    if not head.startswith(b"glTF") or size < 20:
        return "not a whole GLB file"
    return f"it states {max(stated, first + 20)} bytes and has {size}" if max(stated, first + 20) > size else ""


# -- small files of large things ---------------------------------------------------------------------------------------


def collada_problem(file: Path) -> str:
    """A DOCTYPE; or nodes that stand for others, those for others, and so on: a small file of a billion nodes."""
    try:
        tree = etree.parse(file, PLAIN_XML)
        if tree.docinfo.doctype or tree.docinfo.internalDTD is not None:
            return "a DOCTYPE, whose entities could blow up"
        scenes = [node for scene in tree.iter("{*}visual_scene") for node in scene.iterchildren("{*}node")]
        unfolded = Unfolded(tree)
        parts, letters = sum(map(unfolded.size, scenes), np.zeros(2))
    except (etree.XMLSyntaxError, RecursionError) as error:
        return f"not a whole Collada file ({type(error).__name__})"
    if parts > MOST_PARTS:
        return f"it unfolds to more than {MOST_PARTS:,} parts"
    return f"it unfolds to more than {MOST_UNFOLDED // 1_000_000} MB" if letters > MOST_UNFOLDED else ""


class Unfolded:
    """Sizes of the nodes of a Collada file with all their copies."""

    def __init__(self, tree: etree._ElementTree) -> None:
        self.nodes = {f"#{node.get('id')}": node for node in tree.iter("{*}node")}
        self.letters = {f"#{one.get('id')}": sum(map(len, one.itertext())) for one in tree.iter("{*}geometry")}
        self.known: dict[str, Array] = {}

    def size(self, node: etree._Element) -> Array:
        """Parts of a node, and letters of their numbers, (2,)."""
        total = np.array([1.0, 0.0])
        for child in node.iterchildren("{*}node"):
            total += self.size(child)
        for instance in node.iterchildren("{*}instance_geometry", "{*}instance_controller"):
            total += (1.0, self.letters.get(instance.get("url", ""), 0))
        for instance in node.iterchildren("{*}instance_node"):
            name = instance.get("url", "")
            if name not in self.known:
                self.known[name] = np.full(2, np.inf)  # until it is known: a node that stands for itself has no end
                self.known[name] = self.size(self.nodes[name]) if name in self.nodes else np.zeros(2)
            total += self.known[name]
        return total


class GltfAccessor(msgspec.Struct):
    """Number and type of entries in a buffer, or of zeros."""

    count: Annotated[int, msgspec.Meta(ge=0)]
    componentType: int
    type: str


class GltfPrimitive(msgspec.Struct):
    """Triangles; what they are made of, as numbers of accessors."""

    attributes: dict[str, int]
    indices: int | None = None


class GltfMesh(msgspec.Struct):
    """Triangles that are shown together."""

    primitives: list[GltfPrimitive]


class GltfNode(msgspec.Struct):
    """A place with a mesh, or without."""

    mesh: int | None = None


class Gltf(msgspec.Struct):
    """The part of a glTF file that states its size."""

    accessors: list[GltfAccessor] = []
    meshes: list[GltfMesh] = []
    nodes: list[GltfNode] = []


def gltf_tree(file: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON of a glTF file, and what follows it in a GLB file."""
    data = file.read_bytes()
    if file.suffix.lower() == ".gltf":
        return parsed_json(data), b""
    end = 20 + int.from_bytes(data[12:16], "little")
    return parsed_json(data[20:end]), data[end:]


def gltf_problem(file: Path) -> str:
    """Accessors need no bytes of their own and may be used again and again: a small file of a billion triangles."""
    try:
        stated = msgspec.convert(gltf_tree(file)[0], Gltf)
        room = sum(one.count * BYTES[one.componentType] * NUMBERS[one.type] for one in stated.accessors)
    except (ValueError, KeyError) as error:
        return f"not a whole glTF file ({' '.join(str(error).split())})"
    counts: dict[int | None, int] = dict(enumerate(one.count for one in stated.accessors))
    parts = [len(mesh.primitives) for mesh in stated.meshes]
    corners = [
        sum(max(counts.get(at, 0) for at in (one.attributes.get("POSITION"), one.indices)) for one in mesh.primitives)
        for mesh in stated.meshes
    ]
    placed = [node.mesh for node in stated.nodes if node.mesh is not None and 0 <= node.mesh < len(parts)]
    if max(len(stated.nodes), sum(parts), sum(parts[at] for at in placed)) > MOST_PARTS:
        return f"it has more than {MOST_PARTS:,} parts"
    if max(sum(corners), sum(corners[at] for at in placed)) > MOST_CORNERS:
        return f"it shows more than {MOST_CORNERS // 3:,} triangles"
    return f"it states numbers of more than {MOST_STATED // 1_000_000} MB" if room > MOST_STATED else ""


def without_pictures(file: Path) -> bytes:
    """A glTF file without the pictures that it holds or names."""
    tree, rest = gltf_tree(file)
    tree.pop("images", None)
    text = json.dumps(tree).encode()
    if file.suffix.lower() == ".gltf":
        return text
    text += b" " * (-len(text) % 4)
    sizes = struct.pack("<4I", 2, 20 + len(text) + len(rest), len(text), int.from_bytes(b"JSON", "little"))
    return b"glTF" + sizes + text + rest
