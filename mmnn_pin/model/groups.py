"""Joints that files name together: `ros2_control` systems, YAML files of controllers, and groups of an SRDF (MoveIt).

An SRDF is looked for beside the robot's file, in `srdf` and `config` of its package, and in the packages beside that
whose names speak of MoveIt. One that is of another robot says nothing, one that is broken is told.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from lxml import etree

from ..files import read_bytes
from .base.evidence import LONGEST, beside, mappings_of, siblings
from .urdf.packages import package_of
from .urdf.reading import parse_xml
from .urdf.shapes import AtRest

MOST = 40  # files that are looked at


@dataclass(frozen=True)
class Group:
    """Joints that a file names together."""

    name: str  # what it calls them
    joints: frozenset[str]  # the joints
    where: str  # where it stands
    parent: str = ""  # link to which they are mounted, where they are an end effector's; empty for others


def groups_of(rest: AtRest, controllers: str | None = None) -> tuple[tuple[Group, ...], tuple[Path, ...]]:
    """All groups of a robot's joints, and SRDF files that are broken.

    Args:
        rest: The robot at rest.
        controllers: File of its controllers, None to look beside its own.

    Raises:
        ConfigError: The controllers' file cannot be read.
    """
    found, known = list[Group](), rest.document.joints.keys()
    for system in rest.document.root.iterchildren("ros2_control"):
        joints = frozenset(joint.get("name", "") for joint in system.iterchildren("joint"))
        found.append(Group(system.get("name", ""), joints, f"<ros2_control>, line {system.sourceline}"))
    for file in [controllers] if controllers else [str(file) for file in beside(rest) if b"joints" in bytes_of(file)]:
        tables = {" ".join(path): table["joints"] for path, table in mappings_of(file).items() if "joints" in table}
        found += [Group(k, frozenset(v.items), f"{Path(file).name}, line {v.line}") for k, v in tables.items() if k]
    roots = {file: parse_xml(bytes_of(file))[0] for file in srdf_files(rest)}
    found += [group for file, root in roots.items() if root is not None for group in of_srdf(rest, file.name, root)]
    sound = tuple(group for group in found if group.joints and group.joints <= known)
    return sound, tuple(file for file, root in roots.items() if root is None)


def of_srdf(rest: AtRest, file: str, root: etree._Element) -> Iterator[Group]:
    """Groups and end effectors of an SRDF."""
    ends = {end.get("group", ""): end.get("parent_link", "") for end in root.iterchildren("end_effector")}
    for group in root.iterchildren("group"):
        parent = ends.get(name := group.get("name", ""), "")
        parent = parent if parent in rest.document.links else ""
        yield Group(name, frozenset(members(rest, group, parent)), f"{file}, line {group.sourceline}", parent)


def members(rest: AtRest, group: etree._Element, parent: str) -> Iterator[str]:
    """Moving joints of a group of an SRDF but that of the link which carries it; those that the robot lacks, too."""
    document = rest.document
    for part in group.iterchildren("joint", "passive_joint", "link", "chain"):
        name, joint = part.get("name", ""), document.joints.get(part.get("name", ""))
        if part.tag == "chain":
            above = {j.name for j in document.moving_ancestors(part.get("base_link", ""))}
            yield from (j.name for j in document.moving_ancestors(part.get("tip_link", "")) if j.name not in above)
        elif part.tag == "link":
            carrier = document.carrier.get(name) if name != parent else None
            yield from [carrier.name] if carrier is not None and carrier.moves else []
        elif joint is None or joint.moves:
            yield name


def srdf_files(rest: AtRest) -> list[Path]:
    """SRDF files that may be the robot's."""
    folder = rest.document.path.parent.absolute()
    package = Path(package_of(str(folder)))
    near = [folder, folder / "srdf", *(package / name for name in ("srdf", "config"))]
    near += [other / "config" for other in siblings(package) if "moveit" in other.name]
    return [file for place in dict.fromkeys(near) for file in sorted(place.glob("*.srdf"))][:MOST]


def bytes_of(file: Path) -> bytes:
    """Content of a file, none where it cannot be read."""
    try:
        return read_bytes(file, LONGEST)
    except (OSError, ValueError):
        return b""
