"""Names, and whether links and joints make one tree: what cannot be told apart or does not hang together."""

from __future__ import annotations

from collections.abc import Iterator

from lxml import etree

from .finding import Finding, finding

MAX_JOINTS = 200  # moving ones; Pinocchio's memory grows with their cube
MAX_LINKS = 2000  # a chain of 4000 crashes Pinocchio
VERSIONS = ("1.0", "1.1", "1.2", "1")


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
