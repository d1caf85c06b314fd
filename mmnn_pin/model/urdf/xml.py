"""Bytes to a `<robot>` element: whole, well-formed, without DOCTYPE, and a URDF at all."""

from __future__ import annotations

import re

from lxml import etree

from .finding import Finding, finding

OTHER_FORMATS = {
    "mujoco": "MJCF (MuJoCo)",
    "mujocoinclude": "MJCF (MuJoCo)",
    "sdf": "SDF (Gazebo)",
    "model": "SDF (Gazebo)",
    "gazebo": "SDF (Gazebo)",
    "COLLADA": "a COLLADA mesh",
    "package": "a ROS package manifest",
    "launch": "a ROS launch file",
}
XACRO_FIX = "expand it first: xacro FILE > robot.urdf"
DEFAULT_NAMESPACE = "//*[namespace-uri() != '' and not(contains(name(), ':'))]"
XACRO = "//*[contains(namespace-uri(), 'xacro') or starts-with(name(), 'xacro:')]"
PREFIXED = re.compile(rb"<[^\s<>/:!?]+:")
LONG_TAG = re.compile(rb"<[^<>!?\n]+\n[^<>]*>")
DOCTYPE = re.compile(rb"<!--.*?-->|<!\[CDATA\[.*?\]\]>|(<!DOCTYPE)", re.DOTALL)


def parse_xml(data: bytes) -> tuple[etree._Element | None, list[Finding]]:
    """The `<robot>` element of a file without comments and default namespaces, None when there is none.

    Args:
        data: The file's bytes.
    """
    root, findings = parsed(data)
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
        known = OTHER_FORMATS.get(root.tag, f"a file whose root is <{root.tag}>")
        what, fix = f"this is {known}, not a URDF", "convert it to URDF (root element <robot>)"
        return None, [finding("not-urdf", root, what, fix=fix, of="")]
    return root, findings


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
    """Why the bytes are not XML: wrong encoding, cut off, or damaged."""
    if not data.strip():
        return finding("not-xml", 1, "the file is empty")
    if any(word in reason for word in ("encoding", "UTF")) or b"\x00" in data[:64]:
        line = undecodable_line(data) or line
        fix = 'save it as UTF-8, or declare its encoding: <?xml version="1.0" encoding="..."?>'
        return finding("encoding", line, f"its bytes are not in the encoding it declares ({reason})", fix=fix)
    if b"<robot" in data and b"</robot" not in data and not re.search(rb"<robot[^>]*/>", data):
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
