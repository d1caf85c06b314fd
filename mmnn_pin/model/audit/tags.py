"""Tags and attributes that are almost ones URDF knows, and second copies that loaders ignore."""

from __future__ import annotations

from collections.abc import Iterator

from lxml import etree

from mmnn_pin.model.audit.finding import Finding, finding
from mmnn_pin.model.audit.schema import KNOWN

ONCE = (
    "link/inertial",
    *(f"joint/{tag}" for tag in ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic")),
    *(f"link/inertial/{tag}" for tag in ("origin", "mass", "inertia")),
    *(f"link/*[self::visual or self::collision]/{tag}" for tag in ("origin", "geometry")),
)


def misspelt(root: etree._Element) -> Iterator[Finding]:
    """Unknown tags and attributes one edit away from known ones, which a loader would ignore in silence."""
    pending = [root]
    for element in pending:
        children, keys = KNOWN[element.tag]
        for child in element.iterchildren("*"):
            if child.tag in KNOWN and child.tag in children:
                pending.append(child)
            elif child.tag not in children and (meant := nearest(child.tag, children)):
                what = f"unknown tag <{child.tag}>, one edit away from <{meant}>"
                yield finding("misspelt-tag", child, what, "it would be ignored", f"write <{meant}>")
        for key in element.attrib:
            if key not in keys and (meant := nearest(key, keys)):
                what = f"unknown attribute '{key}' of <{element.tag}>, one edit away from '{meant}'"
                yield finding("misspelt-attribute", element, what, "it would be ignored", f"write '{meant}'")


def repeated(root: etree._Element) -> Iterator[Finding]:
    """Second copies of what may stand once, and materials defined twice."""
    for path in ONCE:
        for again in root.xpath(f"{path}[position() > 1]"):
            what = f"a second <{again.tag}> in <{again.getparent().tag}>"
            yield finding("repeated-tag", again, what, "the first one counts", "delete one of them")
    seen: set[str] = set()
    for material in root.iterchildren("material"):
        name = material.get("name", "")
        if name in seen:
            why = "Pinocchio's parser refuses the file"
            yield finding("duplicate-material", material, "is defined twice", why, "delete or rename one of them")
        seen.add(name)


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
