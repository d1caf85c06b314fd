"""Tags and attributes that are almost ones URDF knows, and second copies that loaders ignore."""

from __future__ import annotations

from collections.abc import Iterator

from .finding import Finding, finding
from .reading import Own
from .schema import KNOWN


def misspelt(own: Own) -> Iterator[Finding]:
    """Unknown tags and attributes one edit away from known ones, which a loader would ignore in silence."""
    for element, tag, parent in own.strangers:
        children = KNOWN[parent][0]
        if tag not in children and (meant := nearest(tag, children)):
            what = f"unknown tag <{tag}>, one edit away from <{meant}>"
            yield finding("misspelt-tag", element, what, "it would be ignored", f"write <{meant}>")
    for element, tag, items in own.texts:
        keys = KNOWN[tag][1]
        for key, _ in items:
            if key not in keys and (meant := nearest(key, keys)):
                what = f"unknown attribute '{key}' of <{tag}>, one edit away from '{meant}'"
                yield finding("misspelt-attribute", element, what, "it would be ignored", f"write '{meant}'")


def misplaced(own: Own) -> Iterator[Finding]:
    """Tags of URDF where URDF does not have them, which a loader ignores in silence."""
    for element, tag, parent in own.strangers:
        if tag in KNOWN and parent != "robot":
            places = [f"<{other}>" for other, (children, _) in KNOWN.items() if tag in children]
            what, why = f"<{tag}> in <{parent}> is ignored", "URDF does not have it there"
            yield finding("misplaced-tag", element, what, why, f"move it into {' or '.join(places)}")


def repeated(own: Own) -> Iterator[Finding]:
    """Second copies of what may stand once, and materials defined twice."""
    for element, tag, parent in own.again:
        what = f"a second shape, <{tag}>, in <geometry>" if parent == "geometry" else f"a second <{tag}> in <{parent}>"
        yield finding("repeated-tag", element, what, "the first one counts", "delete one of them")
    seen: set[str] = set()
    for material in own["robot"][0].iterchildren("material"):
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
