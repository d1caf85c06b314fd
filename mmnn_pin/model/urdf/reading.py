"""A URDF file, read strictly: what would make a loader guess, drop or crash is refused with its line.

Pinocchio's parser drops a whole `<inertial>` over one bad number and hides the reasons of its refusals on C++ stderr,
so the file is audited first (docs/reference/urdf-audit.md lists the codes). What passes is also what Pinocchio gets:
`Document.text` is the parsed tree written out again, free of declarations, comments and namespaces.

A check is a function from the `<robot>` element, or what it holds, to its findings; `audit` runs them all. Those of
single elements and files are here, those of joints, bodies and the tree that they make in `mechanism`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path

from lxml import etree

from ...errors import ConfigError
from ...files import read_bytes, reason
from .document import Document, Tree
from .expansion import expand, is_xacro
from .finding import AuditError, Finding, finding, settle
from .mechanism import (
    bad_bodies,
    bad_joints,
    bad_mimics,
    bad_names,
    bad_tree,
    degrees,
    gazebo_loops,
    millimetres,
    no_inertials,
    too_large,
)
from .meshes import bad_meshes
from .packages import FIND
from .xml import KNOWN, XACRO_FIX, Elements, nearest, number_problem, numbers, parse_xml, read_numbers, uncalled

MAX_BYTES = 50_000_000

NAMED_ALIKE = ("duplicate-name", "two-parents", "loop")  # what parts of one name lead to


# Attributes that hold numbers: how many, by element; those in REQUIRED must be there.
NUMBERS: dict[str, dict[str, int]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "safety_controller": dict.fromkeys(("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"), 1),
    "calibration": {"rising": 1, "falling": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "box": {"size": 3},
    "mesh": {"scale": 3},
    "color": {"rgba": 4},
}

REQUIRED: dict[str, tuple[str, ...]] = {
    "axis": ("xyz",),
    "mass": ("value",),
    "inertia": tuple(NUMBERS["inertia"]),
    "safety_controller": ("k_velocity",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "sphere": ("radius",),
    "box": ("size",),
    "mesh": ("filename",),
    "mimic": ("joint",),
}

GREY = "0.5 0.5 0.5 1"
SIZES = {"cylinder": ("radius", "length"), "capsule": ("radius", "length"), "sphere": ("radius",), "box": ("size",)}


def read(
    path: str | Path,
    strict: bool = False,
    package_dirs: Sequence[str | Path] = (),
    xacro: Sequence[str] = (),
    without: Sequence[str] = (),
) -> Document:
    """Read and audit a URDF file, or a xacro file that makes one.

    Args:
        path: The file.
        strict: Whether impossible inertias and implausible sizes are errors rather than warnings.
        package_dirs: Folders that hold the packages of `package://` meshes.
        xacro: Arguments of a xacro file, `NAME:=VALUE`.
        without: Macros of a xacro file whose calls are left out.

    Raises:
        RobotError: The file cannot be read, is not a URDF, or the audit refuses it; its `findings` are all that was
            found, its message tells them one per line.
    """
    return accepted(*audit_file(path, strict, package_dirs, xacro, without))


def parse(data: bytes, path: str | Path, strict: bool = False, package_dirs: Sequence[str | Path] = ()) -> Document:
    """Audit a URDF given as bytes.

    Args:
        data: The file's content.
        path: Name for messages, and the place that relative mesh paths start from.
        strict: As in `read`.
        package_dirs: As in `read`.

    Raises:
        RobotError: As in `read`.
    """
    return accepted(*audit_data(data, path, strict, package_dirs))


def accepted(document: Document | None, findings: tuple[Finding, ...]) -> Document:
    """The document of an audit.

    Raises:
        AuditError: There is none.
    """
    if document is None:
        raise AuditError(findings)
    return document


def audit_file(
    path: str | Path,
    strict: bool = False,
    package_dirs: Sequence[str | Path] = (),
    xacro: Sequence[str] = (),
    without: Sequence[str] = (),
) -> tuple[Document | None, tuple[Finding, ...]]:
    """Everything there is to say about a file, in one pass, and its document when nothing forbids to load it.

    An error that matters to one joint alone forbids nothing yet: that joint may stand still (see `excused`).

    Args:
        path: The file.
        strict: As in `read`.
        package_dirs: As in `read`.
        xacro: As in `read`.
        without: As in `read`.

    Raises:
        RobotError: A xacro file that cannot be expanded.
    """
    path = Path(path)
    data = content(path)
    if isinstance(data, str):
        return None, settle([finding("file", 1, data, fix=instead(path))], path, strict)
    if is_xacro(path, data):
        return audit_xacro(data, path, strict, package_dirs, xacro, without)
    if xacro or without:
        what = "arguments of xacro for a file with nothing to expand"
        raise ConfigError(what, why="nothing would use them", fix="leave them out", file=path)
    return audit_data(data, path, strict, package_dirs)


def instead(path: Path) -> str:
    """What else may be meant by a path that cannot be read."""
    names: list[str] = []
    with suppress(OSError, ValueError):
        there = (path if path.is_dir() else path.parent).iterdir()
        names = sorted(one.name for one in there if one.suffix in (".urdf", ".xacro"))
    near = names if path.is_dir() else get_close_matches(path.name, names)
    folder = path if path.is_dir() else path.parent
    return f"did you mean '{folder / near[0]}'?" if near else "name a URDF or xacro file; `mmnn list` has robots"


def content(path: Path) -> bytes | str:
    """All of a regular file of bearable size, or what is wrong with it."""
    try:
        return read_bytes(path, MAX_BYTES)
    except FileNotFoundError:
        return "no such file"
    except IsADirectoryError:
        return "is a folder, not a URDF file"
    except (OSError, ValueError) as error:  # a path with a null byte
        return f"cannot be read ({reason(error)})"


def audit_xacro(
    data: bytes,
    path: Path,
    strict: bool,
    package_dirs: Sequence[str | Path],
    xacro: Sequence[str],
    without: Sequence[str],
) -> tuple[Document | None, tuple[Finding, ...]]:
    """The same for the content of a xacro file; raises `RobotError` where it cannot be expanded."""
    made = expand(path, xacro, package_dirs, without)
    if len(made.data) > MAX_BYTES:
        return None, settle([finding("file", 1, f"expands to more than {MAX_BYTES // 1_000_000} MB")], path, strict)
    document, findings = audit_data(made.data, path, strict, package_dirs)
    if made.prefixes:
        way = f", or tell parts apart by {' or '.join(f'--xacro {name}:=arm_' for name in made.prefixes)}"
        findings = tuple(replace(f, fix=f.fix + way) if f.code in NAMED_ALIKE else f for f in findings)
    whole = (*settle(made.findings(without), path, strict), *findings)
    return document and replace(document, findings=whole), whole


def audit_data(
    data: bytes, path: str | Path, strict: bool = False, package_dirs: Sequence[str | Path] = ()
) -> tuple[Document | None, tuple[Finding, ...]]:
    """The same for a file's content.

    Args:
        data: The content.
        path: Name for messages, and the place that relative mesh paths start from.
        strict: As in `read`.
        package_dirs: As in `read`.
    """
    path = Path(path)
    root, found = parse_xml(data)
    if root is not None:
        found += audit(tree := Tree(root), path, package_dirs)
    findings = settle(found, path, strict)
    if root is None or any(f.severity == "error" and not f.joint for f in findings):
        return None, findings
    return Document.of(tree, path, hashlib.sha256(data).hexdigest(), findings), findings


def audit(tree: Tree, path: Path, package_dirs: Sequence[str | Path] = ()) -> list[Finding]:
    """All findings about a `<robot>` element; none of severity error when it may be loaded. Its numbers end up plain.

    Args:
        tree: The element.
        path: Its file; relative meshes start from there.
        package_dirs: Folders that hold packages.
    """
    root = tree.root
    if large := list(too_large(root)):
        return large
    turned = list(transposed(root))
    elements, unsound = Elements.of(root), [*bad_names(root), *bad_tree(root)]
    findings = [*turned, *unsound, *bad_joints(root), *bad_mimics(root)]
    findings += [found for check in ELEMENT_CHECKS for found in check(elements)]
    if not unsound:  # bodies can be judged only in a sound tree
        findings += [*bad_bodies(tree), *no_inertials(tree), *gazebo_loops(root)]
    return [*findings, *bad_meshes(root, path, package_dirs)]


# -- tags and attributes -----------------------------------------------------------------------------------------------


def transposed(root: etree._Element) -> Iterator[Finding]:
    """Products of inertia written with their letters the other way round, which mean the same; put right in place."""
    for element in root.iterfind("link/inertial/inertia"):
        for wrong, right in (("iyx", "ixy"), ("izx", "ixz"), ("izy", "iyz")):
            value = element.get(wrong)
            if value is not None and read_numbers(element.get(right, value)) == read_numbers(value):
                element.set(right, element.attrib.pop(wrong))
                what = f"'{wrong}' of <inertia> is taken as '{right}'"
                yield finding("transposed-inertia", element, what, "an inertia is symmetric", f"write '{right}'")
            elif value is not None:
                what = f"'{wrong}' and '{right}' of <inertia> differ"
                why = f"an inertia is symmetric: taken is '{right}', as URDF has it"
                yield finding("transposed-inertia", element, what, why, f"check it, delete '{wrong}'")
                element.attrib.pop(wrong)


LOOKS = {"visual", "collision", "material", "color", "texture"}  # a robot that lacks one moves as it would with it


def misspelt(elements: Elements) -> Iterator[Finding]:
    """Unknown tags and attributes one edit away from known ones, which a loader would ignore in silence."""
    for element, tag, parent in elements.unknown:
        children = KNOWN[parent][0]
        if tag not in children and (meant := nearest(tag, children)):
            code, why = ("misspelt-tag", "it would be ignored")
            if meant in LOOKS:
                code, why = ("misspelt-shape", "it is ignored")
            yield finding(code, element, f"unknown tag <{tag}>, one edit away from <{meant}>", why, f"write <{meant}>")
    for element, tag, items in elements.texts:
        keys = KNOWN[tag][1]
        unread = tag == "axis" and element.getparent().get("type") == "fixed"
        for key, _ in items:
            if key not in keys and not unread and (meant := nearest(key, keys)):
                what = f"unknown attribute '{key}' of <{tag}>, one edit away from '{meant}'"
                yield finding("misspelt-attribute", element, what, "it would be ignored", f"write '{meant}'")


def misplaced(elements: Elements) -> Iterator[Finding]:
    """Tags of URDF where URDF does not have them, which a loader ignores in silence."""
    for element, tag, parent in elements.unknown:
        if tag in KNOWN and parent != "robot":
            places = [f"<{other}>" for other, (children, _) in KNOWN.items() if tag in children]
            what, why = f"<{tag}> in <{parent}> is ignored", "URDF does not have it there"
            yield finding("misplaced-tag", element, what, why, f"move it into {' or '.join(places)}")


def repeated(elements: Elements) -> Iterator[Finding]:
    """Second copies of what may stand once, and materials defined twice."""
    for element, tag, parent in elements.repeated:
        what = f"a second shape, <{tag}>, in <geometry>" if parent == "geometry" else f"a second <{tag}> in <{parent}>"
        yield finding("repeated-tag", element, what, "the first one counts", "delete one of them")
    seen: set[str] = set()
    for material in elements["robot"][0].iterchildren("material"):
        name = material.get("name", "")
        if name in seen:
            why = "Pinocchio's parser refuses the file"
            yield finding("duplicate-material", material, "is defined twice", why, "delete or rename one of them")
        seen.add(name)


# -- numbers -----------------------------------------------------------------------------------------------------------


def unexpanded(elements: Elements) -> Iterator[Finding]:
    """`${...}` and `$(...)`, which xacro would have expanded."""
    for element, _, items in elements.texts:
        for key, text in items:
            if "$" in text and ("${" in text or "$(" in text) and not FIND.match(text):
                what = f"{key} '{text}' is an unexpanded xacro expression"
                yield finding("xacro", element, what, fix=XACRO_FIX)


def bad_numbers(elements: Elements) -> Iterator[Finding]:
    """Attributes that should hold finite numbers and do not; the others are left with single blanks, none around them.

    Pinocchio's parser drops a whole `<inertial>` over a blank after a mass, a tab or a no-break space.
    """
    yield from bare_limits(elements)
    for mesh in elements["mesh"]:
        if not mesh.get("scale", "1").strip():
            mesh.attrib.pop("scale")
            yield finding("mesh-scale", mesh, "scale of <mesh> is empty", "taken as 1 1 1", "state it, or delete it")
    for tag, needed in REQUIRED.items():
        for element in elements[tag]:
            for key in needed:
                if element.get(key) is None:
                    yield finding("missing-value", element, f"{key} of <{tag}> is missing", why(tag), "state it")
    for element, tag, items in elements.texts:
        counts = NUMBERS.get(tag, {})
        for key, text in items:
            if key not in counts or "$" in text or element.get(key) is None:
                continue
            problem, plain = number_problem(text, counts[key]), plainly(text)
            if problem and tag == "color":
                element.set(key, GREY)  # Pinocchio's parser drops the robot over it
                yield finding("color", element, f"{key} of <color> {problem}", "taken as grey", "give 4 numbers")
            elif problem:
                code = "vector-length" if "number(s)" in problem else "number"
                fix = f"give {counts[key]} finite number(s) in SI units"
                yield finding(code, element, f"{key} of <{tag}> {problem}", why(tag), fix)
            elif plain != text:
                element.set(key, plain)


def bare_limits(elements: Elements) -> Iterator[Finding]:
    """`<limit>` without effort or velocity: 0 is put there, which means none; Pinocchio's parser refuses it without."""
    for limit in elements["limit"]:
        joint = limit.getparent()
        for key in ("effort", "velocity"):
            if limit.get(key) is None:
                limit.set(key, "0")
                if joint.get("type") in ("continuous", "fixed"):
                    what = f"{key} of <limit> is missing"
                    yield finding("no-effort", limit, what, "assumed: no limit", "state it")
                else:
                    what, name = f"{key} of <limit> is missing", joint.get("name")
                    yield finding("missing-value", limit, what, why("limit"), "state it", joint=name)


@lru_cache(maxsize=8192)
def plainly(text: str) -> str:
    """Words with single blanks between them."""
    return " ".join(text.split())


def incomplete(elements: Elements) -> Iterator[Finding]:
    """`<inertial>` without mass or inertia, and empty `<dynamics>`, both of which loaders trip over."""
    for inertial in elements["inertial"]:
        for tag in ("mass", "inertia"):
            if inertial.find(tag) is None:
                yield finding("missing-value", inertial, f"<{tag}> is missing", why(tag), f"add <{tag}>")
    for dynamics in elements["dynamics"]:
        if dynamics.get("damping") is None and dynamics.get("friction") is None:
            reason, fix = "Pinocchio's parser refuses the joint", "state damping or friction, or delete it"
            yield finding("missing-value", dynamics, "<dynamics> states nothing", reason, fix)


def why(tag: str) -> str:
    """What a bad number in an element leads to."""
    return "the whole inertial would be dropped" if tag in ("mass", "inertia") else ""


# -- shapes and meshes -------------------------------------------------------------------------------------------------


def bad_shapes(elements: Elements) -> Iterator[Finding]:
    """Shapes without a size, with a negative one, or without a shape."""
    for holder in (*elements["visual"], *elements["collision"]):
        shapes = (body.tag for geometry in holder.iterchildren("geometry") for body in geometry)
        if not any(tag in SIZES or tag == "mesh" for tag in shapes):
            reason, fix = "it is left out", "give a box, cylinder, sphere or mesh"
            yield finding("no-shape", holder, f"<{holder.tag}> has no shape that URDF knows", reason, fix)
    for tag in (*SIZES, "mesh"):
        for body in elements[tag]:
            yield from bad_sizes(body)


def bad_sizes(body: etree._Element) -> Iterator[Finding]:
    """Negative and zero sizes of one shape."""
    for key in SIZES.get(body.tag, ()):
        least = min(numbers(body, key, (1.0,) * NUMBERS[body.tag][key]))
        what, fix = f"{key} of <{body.tag}> is '{body.get(key)}'", "give a positive size [m]"
        if least < 0:
            yield finding("negative-size", body, f"{what}: negative", "a size is at least 0", fix)
        elif least == 0:
            yield finding("zero-size", body, f"{what}: zero", "taken as it is", fix)
    if body.tag == "mesh" and 0 in numbers(body, "scale", (1.0, 1.0, 1.0)):
        yield finding("zero-size", body, "scale of <mesh> is zero", "taken as it is", "give a scale other than 0")


WORDS = (misspelt, misplaced, uncalled, repeated, unexpanded)
ELEMENT_CHECKS = (*WORDS, bad_numbers, incomplete, bad_shapes, millimetres, degrees)
