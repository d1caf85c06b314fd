"""Bytes to a `<robot>` element, and strictly read numbers out of it.

The element is whole, well-formed, without DOCTYPE, and a URDF at all. A bad number reads as nan, which judges nothing.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from lxml import etree

from ...signals import Array
from .finding import Finding, finding

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

MJCF = "convert it to URDF, e.g. with mjcf-urdf-simple-converter (PyPI)"

SDF = "convert it to URDF, e.g. with sdf2urdf of pysdf, or give the URDF or xacro file that it was made from"

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

# The first bytes of files that are not XML, and what they are.
USD = "export it as URDF, e.g. with Isaac Sim's URDF exporter"
HEADS = {
    b"PXR-USDC": ("USD (binary)", USD),
    b"#usda": ("USD", USD),
    b"PK\x03\x04": ("a zip archive (USDZ?)", "unpack it; " + USD + " where it holds a USD file"),
    b"glTF": ("a glTF mesh", "give the URDF that uses it"),
    b"solid ": ("an STL mesh", "give the URDF that uses it"),
    b"version https://git-lfs": ("a pointer to a file in Git LFS", "get the file itself: git lfs pull"),
}

TAGS = 200_000  # of a file; reading more takes minutes and gigabytes

ATTRIBUTES = 200  # of a tag; the time to read them grows with the square

CROWDED = f"//*[@*[{ATTRIBUTES + 1}]]"

XACRO_FIX = "expand it first: xacro FILE > robot.urdf"

DEFAULT_NAMESPACE = "//*[namespace-uri() != '' and not(contains(name(), ':'))]"

XACRO = "//*[contains(namespace-uri(), 'xacro') or starts-with(name(), 'xacro:')]"

PREFIXED = re.compile(rb"<[^\s<>/:!?]+:")

LONG_TAG = re.compile(rb"<[^<>!?\n]+\n[^<>]*>")

DOCTYPE = re.compile(rb"<!--.*?-->|<!\[CDATA\[.*?\]\]>|(<!DOCTYPE)", re.DOTALL)

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


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


def text_of(root: etree._Element) -> str:
    """A tree as text, every element on the line of the file that it came from.

    Comments are gone; where they stood are empty lines, so that what is found in the text has the lines of the file.
    """
    root, line, before = copy.deepcopy(root), 1, ""
    for event, element in etree.iterwalk(root, events=("start", "end")):
        if event == "end":
            line += (element.tail or "").count("\n") if element is not root else 0
            continue
        missing = "\n" * max(0, (element.sourceline or 0) - line)
        if element is root:
            before = missing
        elif (previous := element.getprevious()) is not None:
            previous.tail = missing + (previous.tail or "")
        else:
            parent = element.getparent()
            parent.text = missing + (parent.text or "")
        line += len(missing) + (element.text or "").count("\n")
    return before + etree.tostring(root, encoding="unicode")


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
    if kind := next((kind for start, kind in PICTURES.items() if data.startswith(start)), ""):
        return finding(
            "not-urdf", 1, f"this is {kind}, not a URDF", fix="name a URDF or xacro file; `mmnn list` has robots"
        )
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


# -- what it holds -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Elements:
    """What URDF defines of a file, not what extensions hold; read out once, because lxml takes its time.

    Attributes:
        by_tag: Elements by tag.
        texts: Element, tag, and key and text of its attributes, of every element that has some.
        unknown: Element, tag and tag of the parent of what URDF does not have in that place.
        repeated: The same of second copies of what may stand once.
    """

    by_tag: dict[str, list[etree._Element]]
    texts: list[tuple[etree._Element, str, list[tuple[str, str]]]]
    unknown: list[tuple[etree._Element, str, str]]
    repeated: list[tuple[etree._Element, str, str]]

    def __getitem__(self, tag: str) -> list[etree._Element]:
        return self.by_tag[tag]

    @classmethod
    def of(cls, root: etree._Element) -> Elements:
        """What a `<robot>` element holds."""
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


# -- numbers -----------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=8192)
def read_numbers(text: str) -> tuple[float, ...]:
    """Decimal numbers; nan for each word of another kind or beyond what a double holds."""
    values = (float(word) if NUMBER.fullmatch(word) else math.nan for word in text.split())
    return tuple(math.nan if math.isinf(value) else value for value in values)


@lru_cache(maxsize=8192)
def number_problem(text: str, count: int) -> str:
    """What is wrong with a list of numbers, empty when nothing is."""
    values = read_numbers(text)
    for word, value in zip(text.split(), values, strict=True):
        if math.isnan(value) and NUMBER.fullmatch(word):
            return f"is '{text}': '{word}' is beyond what a double holds"
        if math.isnan(value):
            between = word.endswith(",") or text.count(",") == count - 1 > 0
            hint = (
                (" (commas between numbers? write blanks)" if between else " (decimal comma?)") if "," in word else ""
            )
            return f"is '{text}': '{word}' is not a finite number{hint}"
    return "" if len(values) == count else f"is '{text}': {len(values)} number(s) where {count} are needed"


@lru_cache(maxsize=8192)
def largest(text: str | None) -> float:
    """Largest magnitude of some numbers, 0 where there are none or a bad one."""
    values = () if text is None else read_numbers(text)
    return 0.0 if any(math.isnan(value) for value in values) else max(map(abs, values), default=0.0)


def number(element: etree._Element | None, key: str, default: float) -> float:
    """A number of an attribute, the default where it is not stated, nan where it is bad."""
    text = None if element is None else element.get(key)
    if text is None:
        return default
    values = read_numbers(text)
    return values[0] if len(values) == 1 else math.nan


def numbers(
    element: etree._Element | None, key: str, default: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> tuple[float, ...]:
    """Numbers of an attribute, the default where they are not stated, nan where they are bad or not as many."""
    text = None if element is None else element.get(key)
    values = default if text is None else read_numbers(text)
    return values if len(values) == len(default) else (math.nan,) * len(default)


def vector(element: etree._Element | None, key: str, default: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Array:
    """The same as an array."""
    return np.array(numbers(element, key, default))


def uncalled(elements: Elements) -> Iterator[Finding]:
    """What nobody knows and names a link: the call of a macro that nobody expanded, ignored in silence."""
    links = {link.get("name") for link in elements["link"]}
    for element, tag, parent in elements.unknown:
        if parent == "robot" and not nearest(tag, KNOWN[parent][0]) and links & {*element.attrib.values()}:
            what, why = f"<{tag}> in <robot> is ignored", "it names a link: is it the call of a macro, not expanded?"
            fix = f"write <xacro:{tag}> in the xacro file that this one is from, and give that"
            yield finding("misplaced-tag", element, what, why, fix)
