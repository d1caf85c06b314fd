"""The process that expands a xacro file: xacro itself, made to find packages without ROS and to do without some.

It is started by `expansion.run`, which says what it is asked and reads what it tells.
"""

from __future__ import annotations

import contextlib
import errno
import glob
import io
import json
import os
import re
import stat
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from ...children import end_with
from .packages import FIND, far_package

COMMENT = re.compile(r"<!--.*?(?:-->|\Z)", re.DOTALL)
MACRO = re.compile(r"<xacro:macro\s[^<>]*?name=[\"']([^\"']+)[\"']")
BARE = {"include", "macro", "property", "if", "unless", "insert_block"}  # elements of xacro that old files have bare
OWN, CALL = BARE | {"arg", "attribute", "call", "element"}, re.compile(r"<xacro:([\w.-]+)")
HOLDERS = {"robot", "link", "joint", "inertial", "visual", "collision", "geometry"} | {f"xacro:{name}" for name in BARE}
USED, STATED = re.compile(r"\$\(arg\s+([^)\s]+)\s*\)"), re.compile(r"<xacro:arg\s[^<>]*?name=[\"']([^\"']+)[\"']")
CALLED = re.compile(r"\barg\(\s*[\"']([^\"']+)[\"']\s*\)")  # in an expression
INVALID = r"Invalid parameter \"([^\"]+)\""
FIRST, ARGUMENT = re.compile(r"<robot\b[^>]*>"), re.compile(r"<xacro:arg\s[^>]*>")

GIVEN_IF = re.compile(  # what stands between two tags of a condition on one value
    r"<xacro:if\s+value=[\"']\$\{\s*(\w+)\s*==\s*['\"]([^'\"]+)['\"]\s*\}[\"']\s*>(.*?)</xacro:if>", re.DOTALL
)

PREFIX = re.compile(r"<xacro:arg\s+name=[\"']([^\"']*prefix[^\"']*)[\"']\s+default=[\"'][\"']\s*/>")
NOT_DEFINED = r"name '([^']+)' is not defined"
LARGEST = 100_000_000  # bytes of a file that an expansion opens
SECONDS, BYTES = 8, 1_000_000_000  # of processor time and memory that an expansion may take


def taken() -> int:
    """Address space of this process [bytes]: libraries reserve some for every core; 0 where that is not known."""
    with contextlib.suppress(OSError):
        return int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    return 0


def child() -> None:
    """Expand the file of a job on standard input; on standard output a line of JSON, then the URDF."""
    job, out = json.load(sys.stdin), sys.stdout
    end_with(job["parent"])
    import xacro
    import xacrodoc

    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        most = taken() + BYTES
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 2))
    opened: set[str] = set()

    def listen(event: str, given: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(given[0], str | bytes | os.PathLike):
            file = os.path.abspath(os.fsdecode(given[0]))
            opened.add(file)
            require_plain(file)

    sys.addaudithook(listen)
    told, data = attempt(xacro, xacrodoc, job)
    while new := [name for name in told["bare"] if name not in job["calls"]]:
        job["calls"] += new
        told, data = attempt(xacro, xacrodoc, job)
    code = tuple(os.path.abspath(place) for place in (sys.prefix, sys.base_prefix) if place)
    told |= {"calls": job["calls"], "opened": sorted(file for file in opened if not file.startswith(code))}
    out.write(json.dumps(told) + "\n")
    out.flush()
    out.buffer.write(data)


def require_plain(file: str) -> None:
    """Refuse to open what may never end: a pipe, a device, a file that is too large (`OSError`)."""
    try:
        state = os.stat(file)
    except OSError:
        return  # it is not there
    if not (stat.S_ISREG(state.st_mode) or stat.S_ISDIR(state.st_mode) or file == os.devnull):
        raise OSError(errno.EINVAL, "it is no plain file", file)
    if state.st_size > LARGEST:
        raise OSError(errno.EFBIG, f"it has more than {LARGEST // 1_000_000} MB", file)


def attempt(xacro: Any, xacrodoc: Any, job: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
    """One expansion of a job: what there is to tell of it, and the URDF, empty where xacro refuses."""
    told: dict[str, Any] = {"absent": set(), "omitted": set(), "needed": [], "bare": [], "choices": []}
    told |= {"renamed": {}, "within": [], "prefixes": []}
    data, lenient = b"", Lenient(xacro, xacrodoc, job, told)
    with lenient.in_place(), contextlib.redirect_stdout(io.StringIO()):
        try:
            given = asked_first(Path(job["path"]).read_text(errors="replace")) | job["arguments"]
            document = xacro.process_file(job["path"], mappings=given)
            text = bytes(document.toprettyxml(indent="  ", encoding="utf-8"))
            told["bare"], data = bare_calls(document, [*lenient.texts.values()], job["elements"]), text
        except MemoryError:
            raise
        except Exception as error:  # whatever a file, and the Python expressions in it, make xacro raise
            if isinstance(getattr(error, "exc", None), MemoryError):
                raise
            told |= diagnosis(xacro, error, lenient.texts, job)
    texts = lenient.texts.values()
    told["declared"] = sorted(set().union(*(named(texts, pattern) for pattern in (STATED, USED, CALLED))))
    told["called"] = sorted(named(texts, CALL) - OWN)
    told["prefixes"] = sorted(named(texts, PREFIX) - set(job["arguments"]))
    told["absent"], told["omitted"] = sorted(told["absent"]), sorted(told["omitted"])
    return told, data


def diagnosis(xacro: Any, error: Exception, texts: dict[str, str], job: dict[str, Any]) -> dict[str, Any]:
    """The facts of an error: its words, its file, what is needed, what could be chosen; see `expansion.refusal`."""
    text = (str(error).strip().splitlines() or [type(error).__name__])[0]
    place = next((file for file in reversed(xacro.filestack or ()) if file), job["path"])
    if hit := re.search(INVALID, text):
        place = next((file for file, content in texts.items() if giving(hit[1], content)), place)
    needed = named(texts.values(), USED) - named(texts.values(), STATED) - set(job["arguments"])
    bare = sorted({name for content in texts.values() for name in BARE if f"<{name} " in content})
    within = [macro.body.getAttribute("name") for macro in reversed(xacro.macrostack or ())]
    facts = {"error": text, "place": place, "needed": sorted(needed), "bare": bare, "within": within}
    if hit := re.search(NOT_DEFINED, text):
        facts["choices"] = choices(hit[1], [*texts.values()])
    return facts


def named(texts: Iterable[str], pattern: re.Pattern[str]) -> set[str]:
    """All that a pattern finds in some texts."""
    return {name for text in texts for name in pattern.findall(text)}


def asked_first(text: str) -> dict[str, str]:
    """Arguments that a file's first tag asks for before it states their defaults, as files of UR do: the defaults."""
    hit = FIRST.search(text)
    asked, defaults = USED.findall(hit[0]) if hit else [], dict[str, str]()
    for tag in ARGUMENT.findall(text) if asked else ():
        name, default = (re.search(rf"\s{key}=[\"']([^\"'$]*)[\"']", tag) for key in ("name", "default"))
        if name and default and name[1] in asked:
            defaults.setdefault(name[1], default[1])
    return defaults


def choices(name: str, texts: list[str]) -> list[str]:
    """Arguments, as `NAME:=VALUE`, with which files define a property that they define under conditions only."""
    stated = {argument for text in texts for argument in STATED.findall(text)}
    defined = re.compile(rf"<xacro:property\s[^>]*?name=[\"']{re.escape(name)}[\"']")
    given = [(arg, value) for text in texts for arg, value, inner in GIVEN_IF.findall(text) if defined.search(inner)]
    return list(dict.fromkeys(f"{arg}:={value}" for arg, value in given if arg in stated))


def bare_calls(document: Any, texts: list[str], elements: list[str]) -> list[str]:
    """Calls that are left in an expanded document for want of `xacro:`.

    Args:
        document: What xacro made.
        texts: What is in the files that it read.
        elements: Names of URDF's own elements.
    """
    calls = {*MACRO.findall("".join(texts).replace("<macro ", "<xacro:macro "))} - {*elements} | BARE
    return sorted({name for name in calls for _ in robots_own(document, name)})


def robots_own(document: Any, name: str) -> list[Any]:
    """Elements of a name that belong to the robot itself: a simulator's blocks have others called alike."""
    elements = []
    for element in document.getElementsByTagName(name):
        above = element.parentNode
        while above.parentNode is not None and above.tagName in HOLDERS | BARE:
            above = above.parentNode
        elements += [element] if above.parentNode is None else []
    return elements


class Lenient:
    """xacro that finds packages without ROS, and does without those that it does not need.

    A file that is not there is left out, or one of a package that is not: where a macro or property of it is used,
    xacro refuses all the same. A file that a build would install elsewhere in its package is taken where it is, if
    there is one alone.

    Args:
        xacro: The module.
        xacrodoc: The module that finds packages where ROS is installed.
        job: What to expand: `known`, folders of packages; `far`, where others may be; `like`, folders that may be a
            package under another name; `without`, macros to leave out; `calls`, macros called without their prefix.
        told: `absent` is filled with the packages that are not there, `omitted` with macros that are left out,
            `renamed` with packages and the folders that are taken as them.

    Attributes:
        texts: What is in the files that it has read.
    """

    def __init__(self, xacro: Any, xacrodoc: Any, job: dict[str, Any], told: dict[str, Any]) -> None:
        self.xacro, self.xacrodoc, self.job, self.told = xacro, xacrodoc, job, told
        self.known, self.texts = job["known"], dict[str, str]()
        self.parse, self.include_files = xacro.parse, xacro.get_include_files

    @contextlib.contextmanager
    def in_place(self) -> Iterator[None]:
        """Have xacro call this one meanwhile."""
        places: Any = sys.modules["xacro.substitution_args"]
        before = self.xacro.parse, self.xacro.get_include_files, places._eval_find, self.xacro.glob
        self.xacro.parse, self.xacro.get_include_files, places._eval_find = self.parsed, self.files, self.seek
        self.xacro.glob = SimpleNamespace(glob=matching)
        self.xacro.filestack = None
        try:
            yield
        finally:
            self.xacro.parse, self.xacro.get_include_files, places._eval_find, self.xacro.glob = before

    def seek(self, package: str) -> str:
        """The folder of a package; `package://NAME` where there is none, which is noted."""
        if package not in self.known and package not in self.told["absent"]:
            try:
                far = far_package(package, self.job["far"])
                self.known[package] = far or self.xacrodoc.packages.get_path(package)
            except self.xacrodoc.packages.PackageNotFoundError:
                self.told["absent"].add(package)
        return str(self.known.get(package, f"package://{package}"))

    def adopt(self, package: str, inner: str) -> None:
        """Take a folder as a package that is not there under its name, where it has the file that is wanted of it."""
        if self.seek(package).startswith("package://"):
            like = next((place for place in self.job["like"] if os.path.isfile(os.path.join(place, inner))), None)
            if like is not None and os.sep in inner:
                self.known[package] = like
                self.told["absent"].discard(package)
                self.told["renamed"][package] = like

    def parsed(self, given: Any, filename: str | None = None) -> Any:
        """A file as xacro parses it: calls with their prefix, includes that may fail, without what is left out."""
        document = self.parse(given, filename)
        with contextlib.suppress(OSError, TypeError):
            text = Path(filename or given).read_text(errors="replace")
            self.texts[str(filename or given)] = COMMENT.sub("", text)  # where no macro is defined
        for name in self.job["calls"]:
            for element in robots_own(document, name):
                element.tagName = element.nodeName = f"xacro:{name}"
        for element in document.getElementsByTagName("xacro:include"):
            if hit := FIND.match(element.getAttribute("filename")):
                self.include(element, hit[1], hit[2])
        for name in self.job["without"]:
            for element in (*document.getElementsByTagName(f"xacro:{name}"), *document.getElementsByTagName(name)):
                element.parentNode.removeChild(element)
                self.told["omitted"].add(name)
        return document

    def include(self, element: Any, package: str, inner: str) -> None:
        """Let an include of a package fail that is not there, or whose file is not."""
        self.adopt(package, inner)
        folder = self.seek(package)
        missing = folder.startswith("package://")
        plain = "$" not in inner and not set(inner) & {*"*[?"}
        if missing or (plain and not os.path.exists(elsewhere(os.path.join(folder, inner), self.known))):
            element.setAttribute("optional", "true")
            self.told["absent"] |= {package if missing else f"{package}/{inner}"}

    def files(self, name: str, symbols: Any) -> Iterator[str]:
        """The files that an include names."""
        for file in self.include_files(name, symbols):
            yield file if os.path.exists(file) else elsewhere(file, self.known)


def matching(name: str) -> list[str]:
    """The files that an include's pattern names; a file of that very name first: folders may have brackets."""
    return [name] if os.path.exists(name) else glob.glob(name)


def elsewhere(file: str, known: dict[str, str]) -> str:
    """The one file of the same package whose path ends like that of a missing one, else the missing one."""
    root = next((folder for folder in known.values() if file.startswith(os.path.join(folder, ""))), None)
    if root is None:
        return file
    tail = os.path.relpath(file, root)
    places = [str(place) for place in Path(root).rglob(os.path.basename(file)) if str(place).endswith(os.sep + tail)]
    return places[0] if len(places) == 1 else file


# -- why it cannot be expanded -----------------------------------------------------------------------------------------


def giving(parameter: str, text: str) -> str:
    """The macro that a file calls with a parameter, empty where there is none."""
    hit = re.search(rf"<xacro:([\w.-]+)\s[^<>]*?\b{re.escape(parameter)}=", text)
    return hit[1] if hit else ""
