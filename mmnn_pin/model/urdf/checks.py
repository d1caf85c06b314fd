"""All checks over one `<robot>` element, in one pass."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from .bodies import bad_bodies
from .document import Tree
from .finding import Finding, finding
from .joints import bad_joints, bad_mimics
from .meshes import bad_meshes
from .numbers import bad_numbers, bad_shapes, incomplete, unexpanded
from .plausible import degrees, millimetres
from .reading import Own
from .tags import misplaced, misspelt, repeated
from .tree import bad_names, bad_tree, too_large

OF_ROOT = (bad_joints, bad_mimics)
OF_ELEMENTS = (misspelt, misplaced, repeated, unexpanded, bad_numbers, incomplete, bad_shapes, millimetres, degrees)


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
    own, unsound = Own.of(root), [*bad_names(root), *bad_tree(root)]
    findings = [*unsound, *(found for check in OF_ROOT for found in check(root))]
    findings += [found for check in OF_ELEMENTS for found in check(own)]
    if not unsound:  # bodies can be judged only in a sound tree
        findings += [*bad_bodies(tree), *no_inertials(tree)]
    return [*findings, *bad_meshes(root, path, package_dirs)]


def no_inertials(tree: Tree) -> Iterator[Finding]:
    """Links without `<inertial>` that are fixed to another or are the root: one finding for all."""
    bare = [
        link
        for name, link in tree.links.items()
        if link.find("inertial") is None and not (name in tree.carrier and tree.carrier[name].moves)
    ]
    if bare:
        names = ", ".join(f"'{link.get('name')}'" for link in bare[:8]) + (", ..." if len(bare) > 8 else "")
        what = f"{len(bare)} link(s) without <inertial>: {names}"
        yield finding("no-inertial", bare[0], what, "assumed: massless", "none needed for mere frames", "")
