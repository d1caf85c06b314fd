"""A URDF file, read strictly: what would make a loader guess, drop or crash is refused with its line.

Pinocchio's parser drops a whole `<inertial>` over one bad number and hides the reasons of its refusals on C++ stderr,
so the file is audited first (see `mmnn_pin.model.urdf`; docs/urdf-audit.md lists the codes). What passes is also what
Pinocchio gets: `Document.text` is the parsed tree written out again, free of declarations, comments and namespaces.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from .checks import audit
from .document import Document, Joint, Tree, placement
from .finding import AuditError, Finding, finding, settle
from .joints import JOINT_TYPES
from .numbers import number_problem
from .reading import number, vector
from .xml import parse_xml

__all__ = [
    "JOINT_TYPES",
    "AuditError",
    "Document",
    "Finding",
    "Joint",
    "audit_data",
    "audit_file",
    "number",
    "number_problem",
    "parse",
    "placement",
    "read",
    "vector",
]

MAX_BYTES = 50_000_000


def read(path: str | Path, strict: bool = False, package_dirs: Sequence[str | Path] = ()) -> Document:
    """Read and audit a URDF file.

    Args:
        path: The file.
        strict: Whether impossible inertias and implausible sizes are errors rather than warnings.
        package_dirs: Folders that hold the packages of `package://` meshes.

    Raises:
        RobotError: The file cannot be read, is not a URDF, or the audit refuses it; its `findings` are all that was
            found, its message tells them one per line.
    """
    return accepted(*audit_file(path, strict, package_dirs))


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
    path: str | Path, strict: bool = False, package_dirs: Sequence[str | Path] = ()
) -> tuple[Document | None, tuple[Finding, ...]]:
    """Everything there is to say about a file, in one pass, and its document when nothing forbids to load it.

    Args:
        path: The file.
        strict: As in `read`.
        package_dirs: As in `read`.
    """
    path = Path(path)
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise ValueError("not a regular file")
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        problem = "no such file"
    except IsADirectoryError:
        problem = "is a folder, not a URDF file"
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
    except ValueError as error:
        problem = f"cannot be read ({error})"
    else:
        if len(data) <= MAX_BYTES:
            return audit_data(data, path, strict, package_dirs)
        problem = f"has more than {MAX_BYTES // 1_000_000} MB"
    return None, settle([finding("file", 1, problem)], path, strict)


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
    if root is None or any(f.severity == "error" for f in findings):
        return None, findings
    return Document.of(tree, path, hashlib.sha256(data).hexdigest(), findings), findings
