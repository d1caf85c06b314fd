"""The URDF of a recording, and which of its meshes may be read.

A recording may come from a stranger, and its URDF may name any file. So a mesh is read where the user names its folder,
where the robot's own file still lies with the same URDF in it, and where that file is a xacro file that names the mesh,
itself or in a file that it includes. The xacro file is read as a text, not run.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from functools import partial
from itertools import islice
from pathlib import Path

import msgspec

from ..errors import InputError
from ..files import read_bytes
from ..model.base.overrides import Overrides
from ..model.loading import build
from ..model.robot import Robot
from ..model.urdf.document import Document, text_of
from ..model.urdf.expansion import read_text
from ..model.urdf.packages import FIND, locate, packages
from ..model.urdf.reading import MAX_BYTES, is_xacro, parse, parse_xml

UNSEEN = "elsewhere://"  # before the name of a mesh that is not looked for
INCLUDES = re.compile(r"<\s*(?:\w+:)?include\s[^<>]*?filename\s*=\s*[\"']([^\"'<>]+)[\"']")
MESHES = re.compile(r"[\"']([^\"'<>]+\.(?:stl|dae|obj|ply|off|glb|gltf|3mf))[\"']", re.IGNORECASE)
OPEN = re.compile(r"\$\{[^{}]*\}|\$\([^()]*\)")  # what xacro puts something in
FOLDER = re.compile(r"\$\(find(?:-pkg-share)?\s+([^)\s]+)\s*\)")
ANYTHING = r"(?:(?!\.\.).)*"  # but a way up
FILES = 100  # of one robot that are read
BUILT: dict[bytes, Robot] = {}  # the last robot of a recording with all its meshes: runs of one experiment share it


def robot_of(
    urdf: str, file: Path, overrides: Overrides, package_path: tuple[str, ...], folders: tuple[str, ...]
) -> Robot:
    """The robot of a recording; arguments and errors as `document_of` and `build` have them."""
    place = file.stat() if file.is_file() else None
    key = msgspec.json.encode((urdf, str(file), place and place.st_mtime_ns, overrides, package_path, folders))
    if key not in BUILT:
        robot = build(*document_of(urdf, file, overrides, package_path, folders))
        BUILT.clear()
        if any(finding.code.startswith("mesh") for finding in robot.findings):
            return robot  # who gives what is missing sees it the next time
        BUILT[key] = robot
    return BUILT[key]


def document_of(
    urdf: str, file: Path, overrides: Overrides, package_path: tuple[str, ...], folders: tuple[str, ...]
) -> tuple[Document, Overrides]:
    """The URDF of a recording and what is said about it, without what a recording alone does not open.

    Args:
        urdf: The text.
        file: Where the robot's own file was.
        overrides: What the recording says about it.
        package_path: Folders in which the run's environment had packages.
        folders: Folders that the user names.

    Raises:
        InputError: As `parse`.
    """
    text = urdf.encode()
    places = (*folders, *filter(os.path.isdir, (*overrides.package_dirs, *package_path)))
    if is_unchanged(file, text):
        stated = msgspec.structs.replace(overrides, package_dirs=places)
        return parse(text, file, overrides.strict, places), stated
    if names := own_names(file, places):
        stated = msgspec.structs.replace(overrides, package_dirs=places, controllers_file=None)
        return parse(sealed(text, partial(is_named, names=names)), file, overrides.strict, places), stated
    stated = msgspec.structs.replace(overrides, package_dirs=folders, controllers_file=None)
    file = Path(folders[0] if folders else os.devnull) / file.name
    return parse(sealed(text, partial(is_inside, file=file, folders=folders)), file, overrides.strict, folders), stated


def is_unchanged(file: Path, text: bytes) -> bool:
    """Whether a robot's own file lies there, with the robot of a text in it."""
    try:
        found = {sealed(data) for data in (read_bytes(file, MAX_BYTES), text)}
        # an older version left out the empty lines
        return len({tuple(parse(data, os.devnull).text.split()) for data in found}) == 1
    except (OSError, ValueError, InputError):
        return False


def sealed(data: bytes, seen: Callable[[str], bool] = lambda name: False) -> bytes:
    """A URDF whose meshes are not looked for, but those whose names may be."""
    root, _ = parse_xml(data)
    if root is None:
        return data
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        if not seen(name):
            mesh.set("filename", f"{UNSEEN}{name}")
    return text_of(root).encode()


def is_inside(name: str, file: Path, folders: tuple[str, ...]) -> bool:
    """Whether a mesh is found in some folders, when relative names start from a file."""
    roots = tuple(os.path.join(os.path.realpath(folder), "") for folder in folders)
    found = locate(name, file, folders).file if folders else None
    return found is not None and str(found).startswith(roots)


# -- what a xacro file names -------------------------------------------------------------------------------------------


def own_names(file: Path, places: tuple[str, ...] = ()) -> list[re.Pattern[str]]:
    """Names of meshes in a xacro file and in those that it includes, where it puts something in anything; or none.

    A package that they find by its name may have the names of its meshes in YAML files, as Universal Robots' has: all
    meshes in it count.

    Args:
        file: The file; one that is no xacro file names nothing.
        places: Folders that hold packages.
    """
    try:
        if not is_xacro(file, read_bytes(file, MAX_BYTES)):
            return []
        known = packages(file, places)
    except (OSError, ValueError):
        return []
    names, pending, seen = set(), [file], {file}
    while pending and len(seen) <= FILES:
        near = pending.pop()
        text = read_text(near)
        names |= {pattern for name in MESHES.findall(text) if (pattern := pattern_of(name, known))}
        names |= {f"package://{re.escape(package)}/{ANYTHING}" for package in FOLDER.findall(text)}
        new = {one for name in INCLUDES.findall(text) for one in included(name, near, known)} - seen
        seen, pending = seen | new, [*pending, *new]
    return [re.compile(pattern) for pattern in sorted(names)]


def included(name: str, file: Path, known: dict[str, str]) -> list[Path]:
    """Files that an `<include>` may mean; where xacro puts something in, all that fit."""
    hit = FIND.match(name)
    if hit and hit[1] not in known:
        return []
    folder, rest = (Path(known[hit[1]]), hit[2]) if hit else (file.parent, name)
    pattern = OPEN.sub("*", rest)
    if hit is None and Path(pattern).is_absolute():
        return []
    try:
        return [one for one in islice(folder.glob(pattern), FILES) if one.is_file()] if pattern else []
    except (OSError, ValueError, NotImplementedError):
        return []


def pattern_of(name: str, known: dict[str, str]) -> str:
    """Names that a mesh may have in the URDF, as an expression; empty for one that xacro may make any file of.

    Args:
        name: As a xacro file has it.
        known: Folders of packages.
    """
    parts = OPEN.split(FOLDER.sub(lambda hit: known.get(hit[1], f"package://{hit[1]}"), name))
    own = os.path.splitext(parts[-1].rpartition("/")[2])[0]  # letters of the file's own name
    placed = re.match(r"package://[^/]+/", parts[0])
    return ANYTHING.join(map(re.escape, parts)) if own or placed or len(parts) == 1 else ""


def is_named(name: str, names: list[re.Pattern[str]]) -> bool:
    """Whether one of some names is that of a mesh."""
    return any(one.fullmatch(name) for one in names)
