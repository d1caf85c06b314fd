"""Mesh files: found, inside their package, whole. Nothing is fetched, nothing outside is opened."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from lxml import etree

from .finding import Finding, finding

CHUNK = 65_536  # bytes looked at, at either end of a file
TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", 9), ("attributes", "<u2")])  # of a binary STL file
URDF_FOLDERS = {"urdf", "urdfs", "robot", "robots", "model", "models", "xacro"}
EMPTY = "assumed: no shape; only the radius of a wheel needs it"


@dataclass(frozen=True)
class Mesh:
    """Where a mesh is.

    Attributes:
        file: The file, None when it must not be opened or does not exist.
        problem: `missing`, `remote`, `outside`, empty when it is there.
        package: Name of its package when no folder of that name was found.
    """

    file: Path | None
    problem: Literal["", "missing", "remote", "outside"] = ""
    package: str = ""


def locate(name: str, urdf: Path, package_dirs: Sequence[str | Path] = ()) -> Mesh:
    """Find a mesh without opening it.

    `package://NAME/...` is looked for in the package folders and in every folder above the URDF. Other names start
    from the URDF's folder; they may stay inside its package (the folder with a `package.xml`, else the one above
    `urdf/` or `robots/`, else the URDF's own) or inside a package folder.

    Args:
        name: The file name as the URDF states it.
        urdf: The URDF file.
        package_dirs: Folders that hold packages, or are one.
    """
    scheme, separator, rest = name.partition("://")
    if not separator:
        scheme, rest = "", name
    folder, given = os.path.abspath(urdf.parent), [os.path.abspath(place) for place in package_dirs]
    if scheme in ("package", "model"):
        return in_package(rest, [*given, *upwards(folder)], given)
    if scheme not in ("", "file"):
        return Mesh(None, "remote")
    files = [os.path.join(base, rest) for base in (folder, *given)]  # an absolute name stays what it is
    return first_inside(files, [package_of(folder), *given])


def in_package(rest: str, tops: list[str], given: list[str]) -> Mesh:
    """A mesh named `PACKAGE/path`, in the first folder that holds it."""
    package, _, inner = rest.lstrip("/").partition("/")
    if package in ("", ".", ".."):
        return Mesh(None, "outside")
    roots = [os.path.join(top, package) for top in tops]
    roots += [top for top in given if os.path.basename(top) == package or os.path.exists(os.path.join(top, inner))]
    roots = [root for root in roots if os.path.isdir(root)]
    if not roots:
        return Mesh(None, "missing", package)
    found = [first_inside([os.path.join(root, inner)], [root, *given]) for root in roots]
    return next((mesh for mesh in found if mesh.file), found[0])


def first_inside(files: list[str], allowed: list[str]) -> Mesh:
    """The first of some files that exists within some folders, links followed."""
    folders = [os.path.join(os.path.realpath(folder), "") for folder in allowed]
    inside = [real for file in files if (real := os.path.realpath(file)).startswith(tuple(folders))]
    if not inside:
        return Mesh(None, "outside")
    return next((Mesh(Path(file)) for file in inside if os.path.isfile(file)), Mesh(None, "missing"))


def upwards(folder: str) -> list[str]:
    """A folder and all above it."""
    return [folder, *map(str, Path(folder).parents)]


def package_of(folder: str) -> str:
    """The package that a URDF in a folder belongs to."""
    marked = next((p for p in upwards(folder)[:4] if os.path.isfile(os.path.join(p, "package.xml"))), None)
    inner = os.path.basename(folder).lower() in URDF_FOLDERS
    return marked or (os.path.dirname(folder) if inner else folder)


def bad_meshes(root: etree._Element, urdf: Path, package_dirs: Sequence[str | Path]) -> Iterator[Finding]:
    """Meshes that cannot be used: each file once, a package that is not there once for all its files."""
    named: dict[str, etree._Element] = {}
    for element in root.iterfind("link/*/geometry/mesh"):
        name = element.get("filename")
        if name is not None and not name.strip():
            yield finding("mesh-missing", element, "the mesh names no file", EMPTY, "name it, or delete the shape")
        elif name and "$" not in name:
            named.setdefault(name, element)
    found = {name: locate(name, urdf, package_dirs) for name in named}
    absent: dict[str, list[str]] = {}
    for name, mesh in found.items():
        absent.setdefault(mesh.package, []).append(name)
    for name, mesh in found.items():
        if not mesh.package or absent[mesh.package][0] == name:
            yield from mesh_finding(named[name], absent[mesh.package] if mesh.package else [name], mesh)


def mesh_finding(element: etree._Element, names: list[str], mesh: Mesh) -> Iterator[Finding]:
    """What to say about one mesh, or about all meshes of one missing package."""
    what = f"mesh '{names[0]}'"
    fix = "give the folder that holds the package with --package-dir"
    if mesh.package:
        what = f"package '{mesh.package}' of {len(names)} mesh file(s) is not found ('{names[0]}')"
        yield finding("mesh-missing", element, what, EMPTY, fix)
    elif mesh.problem == "missing":
        yield finding("mesh-missing", element, f"{what} does not exist", EMPTY, "put it there, or " + fix)
    elif mesh.problem == "remote":
        yield finding("mesh-remote", element, f"{what} is remote", f"never fetched; {EMPTY}", "copy it to the package")
    elif mesh.problem == "outside":
        why = f"never opened; {EMPTY}"
        yield finding("mesh-outside", element, f"{what} is outside the package", why, "move it into the package")
    elif mesh.file is not None and (damage := damage_of(mesh.file)):
        yield finding("mesh-corrupt", element, f"{what} is corrupt: {damage}", EMPTY, "export it again")


def damage_of(file: Path) -> str:
    """What is wrong with a mesh file by its size, its head and its tail; empty when nothing is seen."""
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
    check = {".stl": stl_damage, ".dae": dae_damage, ".obj": obj_damage}.get(file.suffix.lower())
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
