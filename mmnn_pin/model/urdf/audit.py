"""The audit of a URDF: every check is a function to its findings, and `audit` runs them all.

First single elements: tags, attributes, numbers, shapes, mesh files. Then the mechanism: names and one tree of links,
joints that can move, bodies that can be accelerated. Links that are fixed to each other count as one body: a link alone
may have no mass or a degenerate inertia, what accelerates is the body that they make together. At last what is possible
but hardly meant: millimetres, degrees.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from lxml import etree

from ...elementary.matrices import product
from ...errors import few
from ...signals import Array
from .document import Joint, LinkTree, largest, number, number_problem, numbers, placement, read_numbers
from .finding import Finding, finding
from .meshes import NO_SHAPE, POINTER, damage_of
from .packages import FIND, MeshFile, locate

# What URDF knows inside each element: children, then attributes. Unknown names are extensions unless nearly known ones.
SCHEMA: dict[str, tuple[str, str]] = {
    "robot": ("link joint material transmission gazebo ros2_control sensor", "name version"),
    "link": ("inertial visual collision contact", "name type"),
    "inertial": ("origin mass inertia", ""),
    "visual": ("origin geometry material", "name"),
    "collision": ("origin geometry material verbose", "name"),
    "geometry": ("box cylinder sphere mesh capsule", ""),
    "material": ("color texture", "name"),
    "joint": ("origin parent child axis calibration dynamics limit mimic safety_controller", "name type"),
    "origin": ("", "xyz rpy"),
    "mass": ("", "value"),
    "inertia": ("", "ixx ixy ixz iyy iyz izz"),
    "parent": ("", "link"),
    "child": ("", "link"),
    "axis": ("", "xyz"),
    "limit": ("", "lower upper effort velocity acceleration jerk"),
    "dynamics": ("", "damping friction"),
    "calibration": ("", "rising falling reference_position"),
    "safety_controller": ("", "soft_lower_limit soft_upper_limit k_position k_velocity"),
    "mimic": ("", "joint multiplier offset"),
    "box": ("", "size"),
    "cylinder": ("", "radius length"),
    "sphere": ("", "radius"),
    "capsule": ("", "radius length"),
    "mesh": ("", "filename scale"),
    "color": ("", "rgba"),
    "texture": ("", "filename"),
}
MOST_LIMIT = 1e9  # no motor has an effort or a speed beyond [N m, rad/s]
KNOWN = {tag: (frozenset(children.split()), frozenset(keys.split())) for tag, (children, keys) in SCHEMA.items()}
# What may stand once in an element.
ONCE = {
    "link": ("inertial",),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry"),
    "collision": ("origin", "geometry"),
    "geometry": ("shape",),
}
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
SIZES = {"cylinder": ("radius", "length"), "capsule": ("radius", "length"), "sphere": ("radius",), "box": ("size",)}
LOOKS = {"visual", "collision", "material", "color", "texture"}  # a robot that lacks one moves as it would with it
GREY = "0.5 0.5 0.5 1"
MAX_JOINTS = 200  # moving ones; Pinocchio's memory grows with their cube
MAX_LINKS = 2000  # a chain of 4000 crashes Pinocchio
VERSIONS = ("1.0", "1.1", "1.2", "1")
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
NOT_UNIT = 1e-3  # axes are printed with a few digits
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
ROUNDING = 1e-3  # of the largest principal inertia: files print few digits
POSITIVE = 1e-9  # of the largest principal inertia: less is zero
HEAVY, DUST = 10_000.0, 1e-15  # [kg]
WIDE = 10.0  # radius of gyration [m]
LONG = 10.0  # [m]; no joint of a robot for a laboratory is further from the next, no part of it larger
FULL_TURN = 2 * math.pi + 0.01  # [rad]
TWO_TURNS, DEGREES = 4 * math.pi, 720.0  # a limit between the two is suspect; beyond it is meant as none
LENGTHS = {"origin": "xyz", "cylinder": "length", "sphere": "radius", "box": "size"}
XACRO_FIX = "expand it first: xacro FILE > robot.urdf"


def audit(tree: LinkTree, path: Path, package_dirs: Sequence[str | Path] = ()) -> list[Finding]:
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
    findings += [piece for check in ELEMENT_CHECKS for piece in check(elements)]
    if not unsound:  # bodies can be judged only in a sound tree
        findings += [*bad_bodies(tree), *no_inertials(tree), *gazebo_loops(root)]
    return [*findings, *bad_meshes(root, path, package_dirs)]


# -- what it holds -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Elements:
    """Elements of a file that URDF defines, without those of extensions; read out once, because lxml takes its time."""

    by_tag: dict[str, list[etree._Element]]  # elements by tag
    # element, tag, and key and text of its attributes, of every element that has some
    texts: list[tuple[etree._Element, str, list[tuple[str, str]]]]
    # element, tag and tag of the parent of what URDF does not have in that place
    unknown: list[tuple[etree._Element, str, str]]
    repeated: list[tuple[etree._Element, str, str]]  # the same of second copies of what may stand once

    def __getitem__(self, tag: str) -> list[etree._Element]:
        return self.by_tag[tag]

    @classmethod
    def of(cls, root: etree._Element) -> Elements:
        """The elements of a `<robot>` element."""
        own = cls({tag: [] for tag in KNOWN}, [], [], [])
        pending = [(root, "robot")]
        for element, tag in pending:
            own.by_tag[tag].append(element)
            if items := element.items():
                own.texts.append((element, tag, items))
            children, once = KNOWN[tag][0], ONCE.get(tag, ())
            seen = set()
            for child in element if len(element) else ():
                name = child.tag
                if name in children and name in KNOWN:
                    pending.append((child, name))
                else:
                    own.unknown.append((child, name, tag))
                kind = "shape" if tag == "geometry" and name in children else name
                if kind in once:
                    if kind in seen:
                        own.repeated.append((child, name, tag))
                    seen.add(kind)
        return own


def nearest(word: str, known: frozenset[str]) -> str:
    """The known word one edit away, or the same but for upper case; empty when there is none."""
    if word.lower() in known:
        return word.lower()
    return next((k for k in sorted(known) if one_edit(word, k)), "")


def one_edit(a: str, b: str) -> bool:
    """Whether one letter inserted, deleted, replaced, or two neighbours swapped turn one word into the other."""
    if abs(len(a) - len(b)) > 1 or min(len(a), len(b)) < 3:
        return False
    same = next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))
    rest, other = a[same:], b[same:]
    replaced, swapped = rest[1:] == other[1:], rest[:2] == other[1::-1] and rest[2:] == other[2:]
    return a != b and (replaced or rest[1:] == other or rest == other[1:] or (len(rest) > 1 and swapped))


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


def misspelt(elements: Elements) -> Iterator[Finding]:
    """Unknown tags and attributes one edit away from known ones, which a loader would ignore in silence."""
    for element, tag, parent in elements.unknown:
        children = KNOWN[parent][0]
        elsewhere = tag in KNOWN and not len(element)  # <inertia> with <mass> in it is meant as <inertial>
        if tag not in children and not elsewhere and (meant := nearest(tag, children)):
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
            where = "an <inertial> with <mass> and <inertia>" if places == ["<inertial>"] else " or ".join(places)
            yield finding("misplaced-tag", element, what, why, f"delete it, or move it into {where}")


def uncalled(elements: Elements) -> Iterator[Finding]:
    """Unknown tags that name a link: calls of macros that nobody expanded, ignored in silence."""
    links = {link.get("name") for link in elements["link"]}
    for element, tag, parent in elements.unknown:
        if parent == "robot" and not nearest(tag, KNOWN[parent][0]) and links & {*element.attrib.values()}:
            what, why = f"<{tag}> in <robot> is ignored", "it names a link: is it the call of a macro, not expanded?"
            fix = f"write <xacro:{tag}> in the xacro file that this one is from, and give that"
            yield finding("misplaced-tag", element, what, why, fix)


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
    yield from missing_values(elements)
    for element, tag, items in elements.texts:
        counts = NUMBERS.get(tag, {})
        for key, text in items:
            if key in counts and "$" not in text and element.get(key) is not None:
                yield from bad_number(element, key, text, counts[key])


def missing_values(elements: Elements) -> Iterator[Finding]:
    """Scales of meshes that are empty, which count as 1, and numbers that must be stated and are not."""
    for mesh in elements["mesh"]:
        if not mesh.get("scale", "1").strip():
            mesh.attrib.pop("scale")
            yield finding("mesh-scale", mesh, "scale of <mesh> is empty", "taken as 1 1 1", "state it, or delete it")
    for tag, needed in REQUIRED.items():
        for element, key in ((element, key) for element in elements[tag] for key in needed):
            if element.get(key) is None:
                yield finding("missing-value", element, f"{key} of <{tag}> is missing", why(tag), "state it")


def bad_number(element: etree._Element, key: str, text: str, count: int) -> Iterator[Finding]:
    """Text of an attribute that is not so many numbers; numbers end up plain, a bad colour grey."""
    tag, problem, plain = element.tag, number_problem(text, count), plainly(text)
    if problem and tag == "color":
        element.set(key, GREY)  # Pinocchio's parser drops the robot over it
        yield finding("color", element, f"{key} of <color> {problem}", "taken as grey", "give 4 numbers")
    elif problem:
        code = "vector-length" if "number(s)" in problem else "number"
        fix = f"give {count} finite number(s) in SI units"
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
    """The consequence of a bad number in an element."""
    dropped = "the whole inertial would be dropped"
    return {"mass": dropped, "inertia": dropped, "axis": "nothing tells the axis"}.get(tag, "")


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


def bad_meshes(root: etree._Element, urdf: Path, package_dirs: Sequence[str | Path]) -> Iterator[Finding]:
    """Meshes that cannot be used: each once, or once for all of a package that is not there, or of git-LFS."""
    named: dict[str, etree._Element] = {}
    for element in root.iterfind("link/*/geometry/mesh"):
        name = element.get("filename")
        if name is not None and not name.strip():
            yield finding("mesh-missing", element, "the mesh names no file", NO_SHAPE, "name it, or delete the shape")
        elif name and ("$" not in name or FIND.match(name)):
            named.setdefault(name, element)
    found = {name: locate(name, urdf, package_dirs) for name in named}
    together: dict[str, list[str]] = {}
    for name, mesh in found.items():
        pointer = mesh.file is not None and damage_of(mesh.file) == POINTER
        outside = mesh.problem * (mesh.problem == "outside")
        together.setdefault(mesh.package or POINTER * pointer or outside or name, []).append(name)
    for names in together.values():
        yield from mesh_finding(named[names[0]], names, found[names[0]], package_dirs)


def mesh_finding(
    element: etree._Element, names: list[str], mesh: MeshFile, package_dirs: Sequence[str | Path]
) -> Iterator[Finding]:
    """The finding about one mesh, or about all meshes that lie outside, are pointers, or are of one missing package."""
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    what = f"mesh '{names[0]}'{more}"
    given = f"; {' and '.join(map(str, package_dirs))} {'do' if len(package_dirs) > 1 else 'does'} not hold it"
    fix = "give the folder that holds the package with --package-dir" + given * bool(package_dirs)
    if "://" in names[0] and not mesh.package and mesh.problem == "missing":
        fix = "is it in another copy of the package? " + fix
    if mesh.package:
        what = f"package '{mesh.package}' of {len(names)} mesh file(s) is not found ('{names[0]}')"
        yield finding("mesh-missing", element, what, NO_SHAPE, fix)
    elif mesh.problem == "missing":
        yield finding("mesh-missing", element, f"{what} does not exist", NO_SHAPE, "put it there, or " + fix)
    elif mesh.problem == "remote":
        yield finding(
            "mesh-remote", element, f"{what} is remote", f"never fetched; {NO_SHAPE}", "copy it to the package"
        )
    elif mesh.problem == "outside":
        why = f"never opened; {NO_SHAPE}"
        theirs = re.search(r"([^/]+)/meshes/", names[0])
        other = f", or give the folder of package '{theirs[1]}' with --package-dir" if theirs else ""
        fix = f"copy the meshes into the URDF's package{other}"
        yield finding("mesh-outside", element, f"{what} {'lie' if more else 'lies'} outside the package", why, fix)
    elif mesh.file is not None and (damage := damage_of(mesh.file)) == POINTER:
        yield finding("mesh-missing", element, f"{what} is {damage}", NO_SHAPE, "git lfs pull")
    elif mesh.file is not None and damage:
        yield finding("mesh-corrupt", element, f"{what} is corrupt: {damage}", NO_SHAPE, "export it again")


# -- names and the tree ------------------------------------------------------------------------------------------------


def too_large(root: etree._Element) -> Iterator[Finding]:
    """More joints or links than can be handled."""
    moving = sum(joint.get("type") != "fixed" for joint in root.iterchildren("joint"))
    links = sum(1 for _ in root.iterchildren("link"))
    for count, most, kind in ((moving, MAX_JOINTS, "moving joints"), (links, MAX_LINKS, "links")):
        if count > most:
            fix = "make joints that need not move fixed, or load a part of the robot"
            yield finding("too-many", root, f"has {count} {kind}", f"more than {most} are not supported", fix)


def bad_names(root: etree._Element) -> Iterator[Finding]:
    """A robot, links and joints without a name, or two of the same name."""
    if root.get("name") is None:
        yield finding("empty-name", root, "has no name", "Pinocchio's parser refuses the file", "name it", of="robot")
    if (version := root.get("version")) is not None and version not in VERSIONS:
        what, fix = f"URDF version '{version}' is unknown", f"one of {', '.join(VERSIONS[:3])}"
        yield finding("version", root, what, "Pinocchio's parser refuses the file", fix)
    for tag in ("link", "joint"):
        lines: dict[str, int] = {}
        for element in root.iterchildren(tag):
            name, line = element.get("name") or "", element.sourceline
            if not name.strip():
                yield finding("empty-name", element, "has no name", "nothing could refer to it", "name it", f"<{tag}>")
            elif name in lines:
                what = f"{tag} '{name}' appears twice (first in line {lines[name]})"
                yield finding("duplicate-name", element, what, "one would hide the other", "rename one of the two", "")
            else:
                lines[name] = line


def bad_tree(root: etree._Element) -> Iterator[Finding]:
    """Missing links, two parents, loops, several roots."""
    links = {link.get("name", ""): link for link in root.iterchildren("link")}
    if not links:
        yield finding("no-links", root, "has no links", fix="describe at least one <link>")
        return
    parent: dict[str, str] = {}
    carrier: dict[str, etree._Element] = {}
    for joint in root.iterchildren("joint"):
        above, below = (end_of(joint, tag) for tag in ("parent", "child"))
        for tag, name in (("parent", above), ("child", below)):
            if name not in links or not name:
                end = joint.find(tag)
                what = f"{tag} link '{name}' does not exist" if name else f"{tag} link is missing"
                yield finding("missing-link", joint if end is None else end, what, "", "name an existing link")
        if below in parent:
            what = f"link '{below}' already hangs on joint '{carrier[below].get('name')}'"
            yield finding("two-parents", joint, what, "a URDF is a tree", "remove one of the joints")
        elif above and below:
            parent[below], carrier[below] = above, joint
    roots = [name for name in links if name not in parent]
    for name in roots[1:]:
        what = f"link '{name}' hangs on nothing, and neither does '{roots[0]}'"
        yield finding("two-roots", links[name], what, "a URDF has one root", "join them", "")
    for circle in circles(parent):
        what = f"link '{circle[0]}' hangs on itself in a circle of joints: {', '.join(map(repr, circle))}"
        at = min((carrier[name] for name in circle), key=lambda joint: joint.sourceline)
        yield finding("loop", at, what, "a URDF is a tree", "open the loop", "")


def gazebo_loops(root: etree._Element) -> Iterator[Finding]:
    """Joints in `<gazebo>` between links that already hang in the tree: a simulator closes a loop, URDF cannot."""
    links = {link.get("name", "") for link in root.iterchildren("link")}
    for joint in root.iterfind("gazebo//joint"):
        ends = [joint.find(tag) for tag in ("parent", "child")]
        above, below = ("" if e is None else e.get("link", e.text or "").strip().rpartition("::")[2] for e in ends)
        if above in links and below in links:
            what = f"joint '{joint.get('name')}' closes a loop: it holds '{below}' to '{above}'"
            why = "a URDF is a tree: the loop is taken as open, nothing of this joint is in the model"
            fix = "lock the joints of one branch (--lock JOINT), or let them <mimic> those of the other"
            yield finding("gazebo-loop", joint, what, why, fix)


def end_of(joint: etree._Element, tag: str) -> str:
    """Name of a joint's parent or child link, empty when it has none."""
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")


def circles(follows: dict[str, str]) -> Iterator[list[str]]:
    """Every circle in a graph where each name follows at most one other."""
    done: set[str] = set()
    for start in follows:
        chain: dict[str, None] = {}
        name = start
        while name in follows and name not in done and name not in chain:
            chain[name] = None
            name = follows[name]
        if name in chain:
            members = list(chain)
            yield members[members.index(name) :]
        done.update(chain)


# -- joints ------------------------------------------------------------------------------------------------------------


def bad_joints(root: etree._Element) -> Iterator[Finding]:
    """Faults of each joint taken alone."""
    for joint in root.iterchildren("joint"):
        kind = joint.get("type")
        if kind not in JOINT_TYPES:
            meant = nearest(kind or "", frozenset(JOINT_TYPES))
            fix = f"did you mean '{meant}'?" if meant else f"one of {', '.join(JOINT_TYPES)}"
            why = f"known are {', '.join(JOINT_TYPES)}" if meant else ""
            yield finding("joint-type", joint, f"type '{kind}' is unknown" if kind else "has no type", why, fix)
        if kind in ("revolute", "continuous", "prismatic", "planar"):
            yield from bad_axis(joint)
        yield from bad_limit(joint, kind or "")
        dynamics = joint.find("dynamics")
        for key in ("damping", "friction"):
            if number(dynamics, key, 0.0) < 0:
                why, fix = "it would feed energy into the robot", "give a value of at least 0"
                yield finding("negative-friction", dynamics, f"{key} is negative", why, fix)


def bad_axis(joint: etree._Element) -> Iterator[Finding]:
    """An axis that is zero, not a unit vector, or not stated."""
    axis = joint.find("axis")
    if axis is None and joint.get("type") != "planar":
        yield finding("no-axis", joint, "has no <axis>", "assumed 1 0 0, as URDF has it", "state it")
    if axis is None:
        return
    length = math.hypot(*numbers(axis, "xyz"))
    if length < 1e-9:
        yield finding("zero-axis", axis, "axis is zero", "the mass matrix would be singular", "give its direction")
    elif abs(length - 1) > NOT_UNIT:
        what = f"axis '{axis.get('xyz')}' has length {length:.4g}"
        yield finding("axis-not-unit", axis, what, "assumed: its direction alone", "give a unit vector")


def bad_limit(joint: etree._Element, kind: str) -> Iterator[Finding]:
    """Limits that are missing, reversed, empty, negative, or zero."""
    limit = joint.find("limit")
    limited = kind in ("revolute", "prismatic")
    if limit is None:
        if limited:
            yield finding("no-limit", joint, "<limit> is missing", f"a {kind} joint needs it", "add it")
        return
    lower, upper = number(limit, "lower", 0.0), number(limit, "upper", 0.0)
    if limited and lower > upper:
        what = f"lower limit {lower:g} is above the upper one, {upper:g}"
        yield finding("limit-order", limit, what, "no position is allowed", "swap them", joint=joint.get("name"))
    if limited and lower == upper:
        what = f"lower and upper limit are both {lower:g}"
        fix = "state lower and upper, or make the joint continuous or fixed"
        yield finding("limit-empty", limit, what, "taken as it is: the joint cannot move", fix)
    powerless = kind != "fixed" and limit.get("effort") is not None and number(limit, "effort", 0.0) == 0
    for key in ("effort", "velocity"):
        if number(limit, key, 0.0) < 0:
            limit.set(key, "0")  # Pinocchio's parser refuses a negative one
            why = "taken as no limit, which it is in SDF"
            yield finding("limit-negative", limit, f"{key} is negative", why, "give its magnitude, or delete it")
        elif number(limit, key, 0.0) > MOST_LIMIT:
            what, fix = f"{key} limit is {number(limit, key, 0.0):g}", "state the largest of the motor, or delete it"
            limit.set(key, "0")
            yield finding("limit-huge", limit, what, "taken as no limit", fix)
    if kind != "fixed" and limit.get("velocity") is not None and number(limit, "velocity", 0.0) == 0:
        yield finding("zero-velocity", limit, "velocity limit is 0", "assumed: no limit", "state the largest speed")
    if powerless:
        why = "assumed: no limit, a motor of 0 could not move it"
        yield finding("zero-effort", limit, "effort limit is 0", why, "state the largest torque or force")


def bad_mimics(root: etree._Element) -> Iterator[Finding]:
    """Mimics of a joint that is not there, of themselves, or in a circle."""
    mimics = {joint.get("name", ""): joint.find("mimic") for joint in root.iterchildren("joint")}
    masters = {name: mimic.get("joint", "") for name, mimic in mimics.items() if mimic is not None}
    for name, master in masters.items():
        if master and master not in mimics:
            what = f"mimics joint '{master}', which does not exist"
            yield finding("mimic-ghost", mimics[name], what, "nothing would move it", "name an existing joint")
        elif master == name:
            why = "nothing would move it"
            yield finding("mimic-self", mimics[name], "mimics itself", why, "name another joint, or delete <mimic>")
    for circle in circles({name: master for name, master in masters.items() if name != master}):
        at = min((mimics[name] for name in circle), key=lambda mimic: mimic.sourceline)
        what = f"joints mimic each other in a circle: {', '.join(map(repr, circle))}"
        yield finding("mimic-circle", at, what, "nothing would move them", "let one of them move on its own")


# -- bodies ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class BodyPart:
    """A link as a part of a body."""

    link: etree._Element  # its element
    mass: float  # [kg]
    frame: Array  # (4, 4) placement of its inertial in the frame of the body's first link
    inertia: Array  # (3, 3) about its centre of mass, along the axes of its frame [kg m^2]

    @classmethod
    def of(cls, link: etree._Element, pose: Array) -> BodyPart:
        """A link whose frame has the pose (4, 4)."""
        inertial = link.find("inertial")
        if inertial is None:
            return cls(link, 0.0, pose, np.zeros((3, 3)))
        parts = {part.tag: part for part in reversed(inertial)}  # of several the first one counts
        frame, element = product(pose, placement(parts.get("origin"))), parts.get("inertia")
        xx, xy, xz, yy, yz, zz = [number(element, key, 0.0) for key in INERTIA]
        inertia = np.array([xx, xy, xz, xy, yy, yz, xz, yz, zz]).reshape(3, 3)
        return cls(link, number(parts.get("mass"), "value", 0.0), frame, inertia)


def bad_bodies(tree: LinkTree) -> Iterator[Finding]:
    """Findings about all bodies, the root's included; needs a sound tree, bad numbers judge nothing."""
    whole: list[tuple[list[BodyPart], Joint | None]] = []
    for start, joint in [(tree.root_link, None), *((j.child, j) for j in tree.joints.values() if j.moves)]:
        parts = parts_of(tree, start)
        for part in parts:
            if part.mass < 0:
                what = f"mass {part.mass:g} kg is negative"
                yield finding("negative-mass", part.link, what, "nothing has such a mass", "give a mass above 0")
            elif 0 < part.mass < DUST:
                what, fix = f"mass {part.mass:g} kg is less than dust has", "give it in kg, or 0 to a mere frame"
                yield finding("tiny-mass", part.link, what, "nothing of a robot has such a mass", fix)
        mass = sum(part.mass for part in parts)
        if joint is not None and mass == 0 and not carries_mass(tree, joint):
            what = f"the body that joint '{joint.name}' moves has no mass, nor has what hangs on it"
            why, fix = "its acceleration could be infinite", "give it an <inertial>, or make the joint fixed"
            yield finding("zero-mass", tree.links[start], what, why, fix, joint=joint.name)
        elif mass > 0 and all(part.mass >= 0 for part in parts):
            whole.append((parts, joint))
    with np.errstate(over="ignore", invalid="ignore"):
        inertias = np.array([lumped(parts) for parts, _ in whole]).reshape(-1, 3, 3)
    finite = np.isfinite(inertias).all(axis=(1, 2))
    principal = np.linalg.eigvalsh(np.where(finite[:, None, None], inertias, np.eye(3)))
    for (parts, joint), values, judged in zip(whole, principal.tolist(), finite, strict=True):
        if judged:
            yield from bad_inertia(parts, joint, values)


def no_inertials(tree: LinkTree) -> Iterator[Finding]:
    """Links without `<inertial>` that are fixed to another or are the root: one finding for all."""
    bare = [
        link
        for name, link in tree.links.items()
        if link.find("inertial") is None and not (name in tree.carrier and tree.carrier[name].moves)
    ]
    if bare:
        names = few([f"'{link.get('name')}'" for link in bare])
        what = f"{len(bare)} link(s) without <inertial>: {names}"
        yield finding("no-inertial", bare[0], what, "assumed: massless", "none needed for mere frames", "")


def carries_mass(tree: LinkTree, joint: Joint) -> bool:
    """Whether something with mass hangs on a body: then the mass matrix tells whether the body can be accelerated."""
    pending = tree.moving_children(joint.child)
    while pending:
        below = pending.pop()
        if any(part.mass for part in parts_of(tree, below.child)):
            return True
        pending += tree.moving_children(below.child)
    return False


def parts_of(tree: LinkTree, start: str) -> list[BodyPart]:
    """The links of the body that starts at a link."""
    poses, names = {start: np.eye(4)}, [start]
    for name in names:
        for joint in tree.children[name]:
            if not joint.moves:
                poses[joint.child] = poses[name] @ joint.origin
                names.append(joint.child)
    return [BodyPart.of(tree.links[name], pose) for name, pose in poses.items()]


def bad_inertia(parts: list[BodyPart], joint: Joint | None, principal: list[float]) -> Iterator[Finding]:
    """An inertia that no body can have, or that a robot's hardly has; the root's may vanish, it may never turn."""
    low, middle, high = principal
    mass = sum(part.mass for part in parts)
    whose = "the root's body" if joint is None else f"the body that joint '{joint.name}' moves"
    values = f"principal inertias {low:.3g}, {middle:.3g}, {high:.3g} kg m^2"
    impossible = low < -POSITIVE * abs(high) or high < 0
    if impossible or (joint is not None and low <= POSITIVE * high):
        code, what = ("inertia-not-positive", "not positive definite") if impossible else ("zero-inertia", "zero")
        what = f"the inertia of {whose} is {what} ({values})"
        why, fix = "its acceleration could be infinite or against the torque", "compute it from the mesh and the mass"
        yield finding(code, to_blame(parts), what, why, fix, joint=None if joint is None else joint.name)
    elif high > low + middle + ROUNDING * high:
        what = f"the inertia of {whose} violates the triangle inequality ({values})"
        yield finding(
            "inertia-triangle", to_blame(parts), what, "no body has it; taken as it is", "compute it from the mesh"
        )
    if mass > HEAVY:
        what = f"the mass of {whose} is {mass:.4g} kg"
        yield finding("odd-mass", parts[0].link, what, "is the file in grams? taken as kg", "give kg")
    elif high > mass * WIDE**2:
        what = f"the inertia of {whose} is that of something {2 * (high / mass) ** 0.5:.3g} m wide ({values})"
        yield finding("odd-inertia", to_blame(parts), what, "is it in kg mm^2? taken as kg m^2", "give kg m^2")


def lumped(parts: list[BodyPart]) -> Array:
    """(3, 3) inertia of a body about its centre of mass, by Huygens and Steiner; of one part along its own axes."""
    heavy = [part for part in parts if part.mass or part.inertia.any()]
    if len(heavy) == 1:
        return heavy[0].inertia
    masses, frames = np.array([part.mass for part in heavy]), np.array([part.frame for part in heavy])
    R, place = frames.reshape(-1, 4, 4)[:, :3, :3], frames.reshape(-1, 4, 4)[:, :3, 3]
    d = place - masses @ place / masses.sum()
    about = R @ np.array([part.inertia for part in heavy]).reshape(-1, 3, 3) @ R.transpose(0, 2, 1)
    return np.asarray(about.sum(axis=0) + (masses @ (d * d).sum(axis=1)) * np.eye(3) - (masses * d.T) @ d)


def to_blame(parts: list[BodyPart]) -> etree._Element:
    """The link whose elements inertia is furthest from a body's, the first with an inertial when none is."""

    def excess(part: BodyPart) -> float:
        if not np.isfinite(part.inertia).all():
            return 0.0
        low, middle, high = np.linalg.eigvalsh(part.inertia).tolist()
        return max(-low, high - low - middle) / max(abs(low), abs(high), 1e-300)

    stated = [part for part in parts if part.link.find("inertial") is not None] or parts
    return max(stated, key=excess).link


# -- what is hardly meant ----------------------------------------------------------------------------------------------


def millimetres(elements: Elements) -> Iterator[Finding]:
    """Lengths of more than `LONG`: one finding for the whole file, at the first of them."""
    long: list[tuple[etree._Element, str]] = []
    for tag, key in LENGTHS.items():
        long += [(e, key) for e in elements[tag] if largest(e.get(key)) > LONG]
    if long:
        element, key = min(long, key=lambda place: place[0].sourceline)
        more = f" (and {len(long) - 1} more)" if len(long) > 1 else ""
        what = f"{key} of <{element.tag}> is '{element.get(key)}' m{more}"
        yield finding("millimetres", element, what, "is the file in millimetres? taken as metres", "give metres")


def degrees(elements: Elements) -> Iterator[Finding]:
    """Limits and roll, pitch, yaw that look like degrees: of limits each, of angles one finding for the file."""
    for limit in elements["limit"]:
        most = max(abs(number(limit, key, 0.0)) for key in ("lower", "upper"))
        if limit.getparent().get("type") == "revolute" and TWO_TURNS < most <= DEGREES:
            what = f"limit of {most:g} rad is {most / (2 * math.pi):.3g} turns"
            yield finding("limit-degrees", limit, what, "is it in degrees? taken as radians", "give radians")
    turned = [o for o in elements["origin"] if largest(o.get("rpy")) > FULL_TURN]
    if turned:
        first = min(turned, key=lambda origin: origin.sourceline)
        more = f" (and so in {len(turned) - 1} more)" if len(turned) > 1 else ""
        what = f"rpy '{first.get('rpy')}' is more than a full turn{more}"
        yield finding("rpy-degrees", first, what, "is it in degrees? taken as radians", "give radians")


WORDS = (misspelt, misplaced, uncalled, repeated, unexpanded)
ELEMENT_CHECKS = (*WORDS, bad_numbers, incomplete, bad_shapes, millimetres, degrees)
