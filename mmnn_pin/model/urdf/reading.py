"""A URDF file, read strictly: what would make a loader guess, drop or crash is refused with its line.

Pinocchio's parser drops a whole `<inertial>` over one bad number and hides the reasons of its refusals on C++ stderr,
so the file is audited first (docs/reference/urdf-audit.md lists the codes). What passes is also what Pinocchio gets:
`Document.text` is the parsed tree written out again, free of declarations, comments and namespaces.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path

from lxml import etree

from ...errors import ConfigError
from ...files import read_bytes, reason
from .audit import XACRO_FIX, audit
from .document import Document, LinkTree
from .finding import AuditError, Finding, finding, settle
from .packages import VISITED, files_below

MAX_BYTES = 50_000_000
NAMED = 3  # files of a folder at most that are proposed in its place
NAMED_ALIKE = ("duplicate-name", "two-parents", "loop")  # what parts of one name lead to
MJCF = "convert it to URDF, e.g. with mjcf-urdf-simple-converter (PyPI)"
SDF = "convert it to URDF, e.g. with sdf2urdf of pysdf, or give the URDF or xacro file that it was made from"
# The first bytes of files that are not XML, and what they are.
USD = "export it as URDF, e.g. with Isaac Sim's URDF exporter"
# How files begin that are no text.
PICTURES = {
    b"\x89PNG": "a picture (PNG)",
    b"\xff\xd8\xff": "a picture (JPEG)",
    b"GIF8": "a picture (GIF)",
    b"%PDF": "a PDF",
    b"PK\x03\x04": "an archive (ZIP)",
    b"\x1f\x8b": "an archive (gzip)",
    b"\x89HDF": "an HDF5 file",
}
# What files with another root element are, and the way out.
OTHER_FORMATS = {
    "mujoco": ("MJCF (MuJoCo)", MJCF),
    "mujocoinclude": ("MJCF (MuJoCo)", MJCF),
    "sdf": ("SDF (Gazebo)", SDF),
    "model": ("SDF (Gazebo)", SDF),
    "gazebo": ("SDF (Gazebo)", SDF),
    "COLLADA": ("a COLLADA mesh", "give the URDF that uses it"),
    "package": (
        "a ROS package manifest",
        "give a URDF or xacro file of that package, often in its folder urdf/ or robots/",
    ),
    "launch": ("a ROS launch file", "give the URDF or xacro file that it loads"),
}
HEADS = {
    b"PXR-USDC": ("USD (binary)", USD),
    b"#usda": ("USD", USD),
    b"PK\x03\x04": ("a zip archive (USDZ?)", "unpack it; " + USD + " where it holds a USD file"),
    b"glTF": ("a glTF mesh", "give the URDF that uses it"),
    b"solid ": ("an STL mesh", "give the URDF that uses it"),
}
TAGS = 200_000  # of a file; reading more takes minutes and gigabytes
ATTRIBUTES = 200  # of a tag; the time to read them grows with the square
CROWDED = f"//*[@*[{ATTRIBUTES + 1}]]"
DEFAULT_NAMESPACE = "//*[namespace-uri() != '' and not(contains(name(), ':'))]"
XACRO = "//*[contains(namespace-uri(), 'xacro') or starts-with(name(), 'xacro:')]"
PREFIXED = re.compile(rb"<[^\s<>/:!?]+:")
LONG_TAG = re.compile(rb"<[^<>!?\n]+\n[^<>]*>")
EXPRESSION = re.compile(rb"[\"'][^\"']*\$[({](?!find)")  # of xacro, in the value of an attribute
DOCTYPE = re.compile(rb"<!--.*?(?:-->|\Z)|<!\[CDATA\[.*?(?:\]\]>|\Z)|(<!DOCTYPE)", re.DOTALL)


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
    """The files that may be meant by a path that cannot be read: beside it, or in a folder and those below it."""
    inside, found = path.is_dir(), list[Path]()
    folder = path if inside else path.parent
    with suppress(ValueError):
        around = files_below(folder, (".urdf", ".xacro"), VISITED if inside else 1)
        found = sorted((one for one in around if one.is_file() and one != path), key=lambda one: (len(one.parts), one))
    names = {one.name: one for one in found}
    meant = found[:NAMED] if inside else [names[name] for name in get_close_matches(path.name, names, 1)]
    said = " or ".join(f"'{one}'" for one in meant)
    return f"did you mean {said}?" if said else "name a URDF or xacro file; `mmnn list` has robots"


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


def is_xacro(path: Path, data: bytes) -> bool:
    """Whether a file needs expanding: it is called so, or has elements or expressions of xacro outside of comments."""
    first, *others = data.split(b"<!--")
    text = first + b"".join(part.partition(b"-->")[2] for part in others)
    root = text.find(b">", text.find(b"xmlns:xacro")) if b"xmlns:xacro" in text else -1
    return path.suffix == ".xacro" or b"<xacro:" in text or (root >= 0 and bool(EXPRESSION.search(text, root)))


def audit_xacro(
    data: bytes,
    path: Path,
    strict: bool,
    package_dirs: Sequence[str | Path],
    xacro: Sequence[str],
    without: Sequence[str],
) -> tuple[Document | None, tuple[Finding, ...]]:
    """Findings and document of a xacro file's content; raises `RobotError` where it cannot be expanded."""
    from .expansion import expand  # in a process of its own, seldom needed

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
    """Findings and document of a file's content.

    Args:
        data: The content.
        path: Name for messages, and the place that relative mesh paths start from.
        strict: As in `read`.
        package_dirs: As in `read`.
    """
    path = Path(path)
    root, pieces = parse_xml(data)
    if root is not None:
        pieces += audit(tree := LinkTree(root), path, package_dirs)
    findings = settle(pieces, path, strict)
    if root is None or any(f.severity == "error" and not f.joint for f in findings):
        return None, findings
    return Document.of(tree, path, hashlib.sha256(data).hexdigest(), findings), findings


# -- bytes to an element -----------------------------------------------------------------------------------------------


def parse_xml(data: bytes) -> tuple[etree._Element | None, list[Finding]]:
    """The `<robot>` element of a file without comments and default namespaces, None when there is none.

    Args:
        data: The file's bytes.
    """
    for head, (known, fix) in HEADS.items():
        if data.startswith(head):
            return None, [finding("not-urdf", 1, f"this is {known}, not a URDF", fix=fix)]
    if data.count(b"<") > TAGS:
        return None, [
            finding("too-many", 1, f"has more than {TAGS:,} tags", "no robot needs them", "simplify it", of="")
        ]
    if data.replace(b"\0", b"").count(b"xmlns") > ATTRIBUTES:  # in UTF-16, too
        what = f"declares more than {ATTRIBUTES} namespaces"
        return None, [finding("too-many", 1, what, "no robot needs them", "simplify it", of="")]
    root, findings = parsed(data)
    if root is not None and (found := root.xpath(CROWDED)):
        what = f"has more than {ATTRIBUTES} attributes"
        return None, [finding("too-many", found[0], what, "no robot needs them", "simplify it", of="")]
    line = doctype_line(data)
    if line or (root is not None and root.getroottree().docinfo.doctype):
        why = "entities could pull in other files or blow up"
        return None, [finding("doctype", line or 1, "has a DOCTYPE", why, "delete it")]
    if root is None:
        return None, findings
    set_start_lines(root, data)
    for element in root.xpath(DEFAULT_NAMESPACE) if b"xmlns=" in data or b"\0" in data else ():
        element.tag = local(element)
    xacros = root.xpath(XACRO) if PREFIXED.search(data) or b"\0" in data else []
    if xacros:
        more = f" (and {len(xacros) - 1} more)" if len(xacros) > 1 else ""
        what = f"<xacro:{local(xacros[0])}>{more} is xacro, not yet a URDF"
        return None, [finding("xacro", xacros[0], what, fix=XACRO_FIX, of="")]
    if root.tag != "robot":
        unknown = f"a file whose root is <{root.tag}>", "convert it to URDF (root element <robot>)"
        known, fix = OTHER_FORMATS.get(root.tag, unknown)
        what = f"this is {known}, not a URDF"
        return None, [finding("not-urdf", root, what, fix=fix, of="")]
    if findings:
        join_prefixes(root)
    return root, findings


def join_prefixes(root: etree._Element) -> None:
    """Make plain names of those with prefixes that nobody declared: whoever reads the text again may be strict."""
    for element in root.iter(etree.Element):
        if ":" in element.tag and not element.tag.startswith("{"):
            element.tag = element.tag.replace(":", "_")
        for key in [key for key in element.attrib if ":" in key and not key.startswith("{")]:
            element.set(key.replace(":", "_"), element.attrib.pop(key))


def parsed(data: bytes, recover: bool = False) -> tuple[etree._Element | None, list[Finding]]:
    """Root element, entities unopened; a prefix that nobody declared is no reason to refuse."""
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, huge_tree=False, remove_comments=True, remove_pis=True, recover=recover
    )
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        if not recover and "Namespace prefix" in str(error):
            return parsed(data, recover=True)
        return None, [syntax_finding(data, str(error).split(", line ")[0].strip(), getattr(error, "lineno", None) or 1)]
    if not recover:
        return root, []
    real = [entry for entry in parser.error_log if entry.domain_name != "NAMESPACE"]
    if real or root is None:
        entry = (real or list(parser.error_log))[0]
        return None, [syntax_finding(data, entry.message, entry.line)]
    entry = parser.error_log[0]
    return root, [finding("namespace", entry.line, entry.message, "taken as an unknown extension", "declare it")]


def syntax_finding(data: bytes, reason: str, line: int) -> Finding:
    """The reason why bytes are not XML: wrong encoding, cut off, or damaged."""
    if not data.strip():
        return finding("not-xml", 1, "the file is empty")
    if kind := next((kind for start, kind in PICTURES.items() if data.startswith(start)), ""):
        return finding(
            "not-urdf", 1, f"this is {kind}, not a URDF", fix="name a URDF or xacro file; `mmnn list` has robots"
        )
    if any(word in reason for word in ("encoding", "UTF")) or b"\x00" in data[:64]:
        line = undecodable_line(data) or line
        fix = 'save it as UTF-8, or declare its encoding: <?xml version="1.0" encoding="..."?>'
        return finding("encoding", line, f"its bytes are not in the encoding it declares ({reason})", fix=fix)
    if b"<robot" in data and b"</robot" not in data and not re.search(rb"<robot[^<>]*/>", data):
        what = f"not well-formed XML ({reason}): it ends before </robot>"
        return finding("truncated", line, what, "cut off while it was written or copied?", "get the whole file")
    return finding("not-xml", line, f"not well-formed XML ({reason})", "damaged, or another format?")


def undecodable_line(data: bytes) -> int:
    """Line of the first bytes that are not UTF-8, 0 when all are."""
    try:
        data.decode()
    except UnicodeDecodeError as error:
        return data.count(b"\n", 0, error.start) + 1
    return 0


def doctype_line(data: bytes) -> int:
    """Line of a DOCTYPE outside comments, 0 when there is none."""
    if b"<!DOCTYPE" not in data:
        return 0
    at = next((match.start(1) for match in DOCTYPE.finditer(data) if match[1]), -1)
    return data.count(b"\n", 0, at) + 1 if at >= 0 else 0


def set_start_lines(root: etree._Element, data: bytes) -> None:
    """Number elements by the line their tag starts in; libxml2 gives the one it ends in."""
    if not LONG_TAG.search(data):
        return
    lines = data.split(b"\n")
    for element in root.iter("*"):
        name, line = element.tag.rpartition("}")[2].encode(), element.sourceline
        tag = b"<" + name if element.prefix is None else name
        start = line
        while 0 < start <= len(lines) and tag not in lines[start - 1] and line - start < 100:
            start -= 1
        if 0 < start < line <= len(lines) and tag in lines[start - 1]:
            element.sourceline = start


def local(element: etree._Element) -> str:
    """Tag without its namespace or prefix."""
    return str(element.tag).rpartition("}")[2].rpartition(":")[2]
