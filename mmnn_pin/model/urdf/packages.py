"""Files as people have them: ROS packages found without ROS, and meshes found in them.

A package is a folder of its name, or one whose `package.xml` says the name. It is looked for in the folders that are
given, in `ROS_PACKAGE_PATH` and `AMENT_PREFIX_PATH`, and in the folders above the file: near ones, and where it is not
there those up to the top of the workspace or repository. Nothing is fetched.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Literal

from ...files import opened

URDF_FOLDERS = {"urdf", "urdfs", "robot", "robots", "model", "models", "xacro"}
ABOVE, BELOW, VISITED = 2, 3, 1500  # levels searched above a package, levels below each of them, folders at most
MARKS = (".git", ".catkin_workspace", ".rosinstall", "colcon.meta")  # of workspaces and repositories
NAME = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")
FIND = re.compile(r"^(?:file://)?\$\(find(?:-pkg-share)?\s+([^)\s]+)\s*\)/*(.*)$")


# -- packages ----------------------------------------------------------------------------------------------------------


def upwards(folder: str) -> list[str]:
    """A folder and all above it."""
    return [folder, *map(str, Path(folder).parents)]


def environment() -> list[str]:
    """Folders that hold packages, as ROS 1 and ROS 2 have them in the environment."""
    ros = [place for place in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if place]
    ament = [os.path.join(p, "share") for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    return [os.path.abspath(place) for place in (*ros, *ament)]


def package_of(folder: str) -> str:
    """The package that a URDF in a folder belongs to."""
    marked = next((p for p in upwards(folder)[:4] if os.path.isfile(os.path.join(p, "package.xml"))), None)
    inner = os.path.basename(folder).lower() in URDF_FOLDERS
    return marked or (os.path.dirname(folder) if inner else folder)


def packages(urdf: Path, package_dirs: Sequence[str | Path] = ()) -> dict[str, str]:
    """Packages with a `package.xml` that can be seen from a file: name to folder, the nearest of each name.

    Args:
        urdf: The file.
        package_dirs: Folders that hold packages, or are one; they count first.
    """
    near, _ = above(urdf)
    return packages_at((*(os.path.abspath(place) for place in package_dirs), *environment(), *near))


def far_package(name: str, places: Sequence[str]) -> str | None:
    """The folder of a package in the first of some places that has it: looked for only where it is not seen near."""
    return next((found for place in places if (found := packages_at((place,)).get(name))), None)


def above(urdf: Path) -> tuple[list[str], list[str]]:
    """Folders above a file that are always looked through for packages, and those further up in its workspace."""
    folders = upwards(os.path.abspath(urdf.parent))[:-1]
    top = max((k for k, folder in enumerate(folders) if is_top(folder)), default=0)
    own = next((k for k, folder in enumerate(folders[:6]) if os.path.isfile(os.path.join(folder, "package.xml"))), 1)
    return folders[: own + 1 + ABOVE], folders[own + 1 + ABOVE : top + 1]


def is_top(folder: str) -> bool:
    """Whether a folder holds the packages of a workspace, or is a repository."""
    return os.path.basename(folder) == "src" or any(os.path.exists(os.path.join(folder, mark)) for mark in MARKS)


def files_below(folder: str | Path, endings: tuple[str, ...], folders: int = VISITED) -> Iterator[Path]:
    """Files in a folder and in those below it, so many folders at most, whose names end so."""
    for top, _, names in islice(os.walk(folder), folders):
        yield from (Path(top, name) for name in names if name.endswith(endings))


def packages_at(places: Sequence[str]) -> dict[str, str]:
    """Packages in some folders and a few levels below them: name to folder, the first of each name."""
    packages: dict[str, str] = {}
    for place in places:
        for name, folder in packages_in(place):
            packages.setdefault(name, folder)
    return packages


@lru_cache(maxsize=64)
def packages_in(place: str) -> tuple[tuple[str, str], ...]:
    """Names and folders of the packages in a folder and a few levels below it."""
    packages, pending = [], [(place, 0)]
    for visited, (folder, depth) in enumerate(pending):
        if visited > VISITED:
            break
        try:
            entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
        except OSError:
            continue
        manifest = next((entry.path for entry in entries if entry.name == "package.xml"), None)
        if manifest is not None:
            packages.append((name_of(manifest) or os.path.basename(folder), folder))
        elif depth < BELOW:
            pending += [(e.path, depth + 1) for e in entries if e.is_dir(follow_symlinks=False) and e.name[0] != "."]
    return tuple(packages)


def name_of(manifest: str) -> str:
    """Name that a `package.xml` states, empty where it states none."""
    try:
        with opened(manifest) as file:
            hit = NAME.search(file.read(65_536))
    except OSError:
        return ""
    return hit[1].decode(errors="replace") if hit else ""


# -- meshes ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class MeshFile:
    """Place of a mesh."""

    file: Path | None  # the file, None when it must not be opened or does not exist
    problem: Literal["", "missing", "remote", "outside"] = ""  # `missing`, `remote`, `outside`, empty when it is there
    package: str = ""  # name of its package when no package of that name was found


def locate(name: str, urdf: Path, package_dirs: Sequence[str | Path] = ()) -> MeshFile:
    """Find a mesh without opening it.

    `package://NAME/...`, `model://NAME/...` and `$(find NAME)/...` are looked for in the package NAME, in `models/` of
    others, too. Other names start from the URDF's folder; they may stay inside its package (the folder with a
    `package.xml`, else the one above `urdf/` or `robots/`, else the URDF's own), inside a package folder, or inside
    another package. An absolute name from another machine, `/home/THEM/ws/src/NAME/meshes/...`, is looked for in the
    package NAME that is seen here, else by its end, `meshes/...`, in the URDF's own.

    Args:
        name: The file name as the URDF states it.
        urdf: The URDF file.
        package_dirs: Folders that hold packages, or are one.
    """
    folder, given = os.path.abspath(urdf.parent), [os.path.abspath(place) for place in package_dirs]
    if hit := FIND.match(name):
        return in_package(f"{hit[1]}/{hit[2]}", urdf, folder, given)
    scheme, separator, rest = name.partition("://")
    if not separator:
        scheme, rest = "", name
    if scheme in ("package", "model"):
        return in_package(rest, urdf, folder, given)
    if scheme not in ("", "file"):
        return MeshFile(None, "remote")
    files = [os.path.join(base, rest) for base in (folder, *given)]  # an absolute name stays what it is
    mesh = first_inside(files, [package_of(folder), *given])
    if mesh.problem == "outside" and os.path.isabs(rest):
        seen = packages(urdf, given)
        mesh = first_inside([rest], list(seen.values()))
        return mesh if mesh.file else here(Path(os.path.normpath(rest)), seen, package_of(folder)) or mesh
    return mesh


def here(absolute: Path, seen: dict[str, str], own: str) -> MeshFile | None:
    """The file of a package that is seen, or of the own one, where the URDF names it by its place elsewhere."""
    named = next((folder for folder in absolute.parents if folder.name in seen), None)
    places = [(seen[named.name], absolute.relative_to(named))] if named else []
    places += [(own, absolute.relative_to(folder)) for folder in reversed(absolute.parents[1:])]
    meshes = (first_inside([os.path.join(package, place)], [package]) for package, place in places)
    return next((mesh for mesh in meshes if mesh.file), None)


def in_package(rest: str, urdf: Path, folder: str, given: list[str]) -> MeshFile:
    """A mesh named `PACKAGE/path`, in the first folder that holds it."""
    package, _, inner = rest.lstrip("/").partition("/")
    if package in ("", ".", ".."):
        return MeshFile(None, "outside")
    tops = (*given, *environment(), *upwards(folder))  # models of Gazebo are in `models/` of a package
    roots = [os.path.join(top, *inside, package) for top in tops for inside in ((), ("models",))]
    roots += [top for top in given if os.path.basename(top) == package or os.path.exists(os.path.join(top, inner))]
    roots = [root for root in roots if os.path.isdir(root)]
    meshes = [first_inside([os.path.join(root, inner)], [root, *given]) for root in roots]
    if not any(mesh.file for mesh in meshes):
        own = packages(urdf, given).get(package) or far_package(package, above(urdf)[1])
        roots += [own] if own else []
        meshes += [first_inside([os.path.join(own, inner)], [own])] if own else []
    if not roots:
        return MeshFile(None, "missing", package)
    return next((mesh for mesh in meshes if mesh.file), meshes[0])


def first_inside(files: list[str], allowed: list[str]) -> MeshFile:
    """The first of some files that exists within some folders, links followed."""
    folders = [os.path.join(os.path.realpath(folder), "") for folder in allowed]
    inside = [real for file in files if (real := os.path.realpath(file)).startswith(tuple(folders))]
    if not inside:
        return MeshFile(None, "outside")
    return next((MeshFile(Path(file)) for file in inside if os.path.isfile(file)), MeshFile(None, "missing"))
