"""All checks over one `<robot>` element, in one pass."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from lxml import etree

from mmnn_pin.model.audit.bodies import bad_bodies
from mmnn_pin.model.audit.finding import Finding, finding
from mmnn_pin.model.audit.joints import bad_joints, bad_mimics
from mmnn_pin.model.audit.meshes import bad_meshes
from mmnn_pin.model.audit.numbers import bad_numbers, bad_shapes, incomplete, unexpanded
from mmnn_pin.model.audit.plausible import degrees, millimetres
from mmnn_pin.model.audit.reading import own_elements
from mmnn_pin.model.audit.tags import misspelt, repeated
from mmnn_pin.model.audit.tree import bad_names, bad_tree, too_large
from mmnn_pin.model.document import Document

OF_ROOT = (too_large, misspelt, repeated, bad_joints, bad_mimics)
OF_ELEMENTS = (unexpanded, bad_numbers, incomplete, bad_shapes, millimetres, degrees)


def audit(root: etree._Element, path: Path, package_dirs: Sequence[str | Path] = ()) -> list[Finding]:
    """All findings about a `<robot>` element; none of severity error when it may be loaded.

    Args:
        root: The element.
        path: Its file; relative meshes start from there.
        package_dirs: Folders that hold packages.
    """
    own, tree = own_elements(root), [*bad_names(root), *bad_tree(root)]
    findings = [*tree, *(found for check in OF_ROOT for found in check(root))]
    findings += [found for check in OF_ELEMENTS for found in check(own)]
    if not tree:  # bodies can be judged only in a sound tree
        findings += bad_bodies(document := Document(path, "", "", root))
        findings += no_inertials(document)
    return [*findings, *bad_meshes(root, path, package_dirs)]


def no_inertials(document: Document) -> Iterator[Finding]:
    """Links without `<inertial>` that are fixed to another or are the root: one finding for all."""
    bare = [
        link
        for name, link in document.links.items()
        if link.find("inertial") is None and not (name in document.carrier and document.carrier[name].moves)
    ]
    if bare:
        names = ", ".join(f"'{link.get('name')}'" for link in bare[:8]) + (", ..." if len(bare) > 8 else "")
        what = f"{len(bare)} link(s) without <inertial>: {names}"
        yield finding("no-inertial", bare[0], what, "assumed: massless", "none needed for mere frames", "")
