"""xacro to URDF, without ROS, in a process of its own that has a time and a memory that it must not exceed.

A xacro file is a program: its macros may call each other without end, its expressions are Python. So it runs where it
can be ended. Packages are found as `packages` finds them; what is left out for want of one is told.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from lxml import etree

from ...children import environment
from ...errors import ConfigError, RobotError, UnknownName, few
from ...files import read_bytes
from .audit import KNOWN
from .expanding import BYTES, INVALID, MACRO, NOT_DEFINED, SECONDS, giving
from .finding import Finding, finding
from .packages import above, files_below, package_of, packages

PATIENCE = 30.0  # how long it may wait for anything else [s]
FILES = 400  # looked at for one that calls a macro
MOST_KEPT = 8  # expansions of this process
KEPT: dict[str, tuple[dict[str, tuple[int, int] | None], tuple[dict[str, Any], bytes]]] = {}
CHILD = "from mmnn_pin.model.urdf.expanding import child; child()"


EXPANDED = finding("expanded", 1, "expanded by xacro: lines are those of the URDF that it makes")


class Unexpanded(RobotError):
    """A xacro file that cannot be expanded."""


class Expansion(NamedTuple):
    """The URDF of a xacro file, and what was done without."""

    data: bytes  # the URDF
    # packages, and files of packages, that it names, that are not there, and that it could do without
    absent: list[str]
    calls: list[str]  # macros that it calls without their prefix
    hanging: list[str]  # joints that hang on a macro which is left out
    renamed: dict[str, str]  # packages that are not there under their names, and the folders that are taken as them
    prefixes: list[str]  # arguments called prefixes that have no value

    def findings(self, without: Sequence[str]) -> list[Finding]:
        """Findings about the file, with the macros that the user leaves out."""
        notes = [EXPANDED]
        for name, folder in self.renamed.items():
            what, why = f"package '{name}' is not found", f"taken as it is {folder}, which has the file that is wanted"
            fix = "give the folder that holds it with --package-dir"
            notes.append(finding("xacro-package", 1, what, why, fix))
        if self.absent:
            what, why = (
                f"packages or files of them not found: {', '.join(self.absent)}",
                "what they would add is left out",
            )
            fix = "give the folder that holds them with --package-dir"
            notes.append(finding("xacro-package", 1, what, why, fix))
        if self.calls:
            what, why = (
                f"<{'>, <'.join(self.calls)}> without 'xacro:'",
                "taken as before ROS Jade: now xacro leaves them out",
            )
            notes.append(finding("xacro-prefix", 1, what, why, "write them with 'xacro:'"))
        if without:
            why = "you said --without; the robot lacks what these macros make"
            why += f", and what hangs on it: {few(self.hanging)}" if self.hanging else ""
            notes.append(finding("xacro-package", 1, f"left out: {', '.join(without)}", why))
        return notes


def arguments_of(given: Sequence[str]) -> dict[str, str]:
    """Arguments of a xacro file, written `NAME:=VALUE`.

    Raises:
        ConfigError: Something else is given, or a name twice.
    """
    table: dict[str, str] = {}
    for text in given:
        name, separator, value = text.partition(":=")
        if not (separator and name) or name in table:
            raise ConfigError(f"'{text}'", fix="write NAME:=VALUE, each name once", key="xacro")
        table[name] = value
    return table


def expand(
    path: Path,
    given: Sequence[str] = (),
    package_dirs: Sequence[str | Path] = (),
    without: Sequence[str] = (),
) -> Expansion:
    """The URDF that a xacro file expands to.

    Calls of macros without `xacro:` are taken as calls, as xacro did before ROS Jade: today's leaves them out.

    Args:
        path: The file.
        given: Arguments, `NAME:=VALUE`.
        package_dirs: Folders that hold packages.
        without: Macros whose calls are left out.

    Raises:
        ConfigError: Arguments that are none.
        UnknownName: An argument that no file declares or uses, a macro to leave out that is never called.
        Unexpanded: xacrodoc is not installed, or xacro refuses the file; the reason is in xacro's words.
    """
    job: dict[str, Any] = {"path": str(path), "arguments": arguments_of(given), "without": list(without), "calls": []}
    own = package_of(os.path.abspath(path.parent))
    job["far"] = above(path)[1]
    job["like"] = [*map(os.path.abspath, package_dirs), own]
    if find_spec("xacro") is None or find_spec("xacrodoc") is None:  # the extra `xacro`
        fix = f"pip install 'mmnn_pin[xacro]', or expand it yourself: xacro {path.name} > robot.urdf"
        raise Unexpanded("this is a xacro file, not yet a URDF", fix=fix, file=path, line=1)
    job["elements"] = sorted(KNOWN)
    job["known"] = packages(path, package_dirs)
    told, data = expanded(path, job)
    job["calls"] = told["calls"]
    if "error" in told:
        raise refusal(told, lambda macro: to_leave_out(path, job, macro))
    require_declared(path, job["arguments"], told["declared"])
    if unused := [name for name in without if name not in told["omitted"]]:
        raise UnknownName("macro", unused[0], told["called"], file=path, key="without")
    if b"<link" not in data:
        raise macros_only(path, data)
    data, hanging = pruned(data) if without else (data, [])
    return Expansion(data, told["absent"], job["calls"], hanging, told["renamed"], told["prefixes"])


def require_declared(path: Path, given: Iterable[str], declared: Sequence[str]) -> None:
    """Refuse arguments that no file of a robot declares or uses: xacro takes them in silence.

    Args:
        path: The file.
        given: Their names.
        declared: Names that are declared; of one that is made of others nothing is known, and nothing is refused.

    Raises:
        UnknownName: One that is not.
    """
    if any("$" in name for name in declared):
        return
    for name in given:
        if name not in declared:
            raise UnknownName("argument", name, declared or ["no argument at all"], file=path, key="xacro")


def to_leave_out(path: Path, job: dict[str, Any], macro: str) -> list[str]:
    """A macro, and others that xacro cannot expand either once its calls are left out; none where no robot is left."""
    names = [macro]
    while len(names) < MOST_LEFT_OUT:
        told, data = expanded(path, job | {"without": [*job["without"], *names]})
        if "error" not in told:
            return names if b"<link" in pruned(data)[0] else []
        more = [macro for macro in (lacking(told),) if macro and macro not in names]
        if not more and re.search(NOT_DEFINED, told["error"]) and not told["choices"]:
            return []  # what is lacked is in no call
        if not more:
            break  # what else is wrong is told when these are left out
        names += more
    return names


def lacking(told: dict[str, Any]) -> str:
    """The macro that xacro does not know, or that uses what is not defined; empty where it is another error."""
    unknown = UNKNOWN.search(told["error"])
    undefined = re.search(NOT_DEFINED, told["error"]) and not told["choices"] and told["absent"]
    return unknown[1] if unknown else next(iter(told["within"]), "") if undefined else ""


def pruned(data: bytes) -> tuple[bytes, list[str]]:
    """A URDF without the joints of which a link was left out, and without all that they carry; names of the joints."""
    try:
        root = etree.fromstring(data)
    except etree.XMLSyntaxError:
        return data, []
    names: list[str] = []
    links = {link.get("name"): link for link in root.iterchildren("link")}
    ends = [(joint, joint.find("parent"), joint.find("child")) for joint in root.iterchildren("joint")]
    hanging = [
        (joint, up.get("link"), down.get("link")) for joint, up, down in ends if up is not None and down is not None
    ]
    while lost := [entry for entry in hanging if entry[1] not in links or entry[2] not in links]:
        for joint, _, child in lost:
            root.remove(joint)
            names.append(joint.get("name") or "")
            if child in links:
                root.remove(links.pop(child))
        hanging = [entry for entry in hanging if entry not in lost]
    return bytes(etree.tostring(root)), names


def expanded(path: Path, job: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
    """The result of `run`, kept while the files that it opened, or missed, stay as they are; errors as there."""
    key = json.dumps([job, dict(os.environ)], sort_keys=True)
    kept = KEPT.get(key)
    if kept is None or kept[0] != stamps(kept[0]):
        told, data = run(path, job)
        kept = stamps(told.pop("opened")), (told, data)
        KEPT.pop(key, None)
        if "error" not in told:
            while len(KEPT) >= MOST_KEPT:
                KEPT.pop(next(iter(KEPT)))
            KEPT[key] = kept
    return kept[1]


def stamps(files: Iterable[str]) -> dict[str, tuple[int, int] | None]:
    """Time of change [ns] and size of files; None for one that is gone."""
    states: dict[str, tuple[int, int] | None] = {}
    for file in files:
        with contextlib.suppress(OSError):
            state = os.stat(file)
            states[file] = state.st_mtime_ns, state.st_size
        states.setdefault(file, None)
    return states


def run(path: Path, job: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
    """The report of the child process on a job, and the URDF that it makes.

    Raises:
        Unexpanded: It takes too long or too much.
    """
    command, variables = [sys.executable, "-P", "-c", CHILD], environment() | {"OPENBLAS_NUM_THREADS": "1"}
    given = json.dumps(job | {"parent": os.getpid()}).encode()
    try:
        ended = subprocess.run(command, input=given, capture_output=True, env=variables, timeout=PATIENCE, check=False)
    except subprocess.TimeoutExpired:
        why = f"it takes more than {PATIENCE:g} s: is the machine busy, or does it wait for a file?"
        raise Unexpanded(
            "xacro cannot expand it", why=why, fix="try again, or mend the file", file=path, line=1
        ) from None
    head, _, data = ended.stdout.partition(b"\n")
    if ended.returncode or not head:
        slow = ended.returncode == -signal.SIGXCPU
        why = f"it takes more than {BYTES / 1e9:g} GB, or ends the process that expands it"
        why = f"it takes more than {SECONDS} s: do its macros, or its expressions, go on without end?" if slow else why
        raise Unexpanded("xacro cannot expand it", why=why, fix="mend the file", file=path, line=1)
    return json.loads(head), data


UNKNOWN = re.compile(r"unknown macro name: xacro:(\S+)")
MOST_LEFT_OUT = 30  # macros at once

# What xacro says where a file cannot be expanded, and the way out; the group is the word that its line has.
WAYS_OUT = (
    (r"package://([^/'\" ]+)", "give the folder that holds package '{}' with --package-dir"),
    (r"Undefined substitution argument (\S+)", "give it: --xacro {}:=VALUE"),
    (
        r"No such file or directory:? .*?([^/'\" ]+)['\"]?(?: |$)",
        "bring '{}' to that place: it starts from the file's folder",
    ),
    (r"environment variable '([^']+)' is not set", "set it where you start: {}=VALUE mmnn ..."),
    (
        INVALID,
        "the macro has no '{}': give the version of its package that this file is made for with --package-dir",
    ),
    (
        NOT_DEFINED,
        "define '{}': give a file that includes this one, or the package that defines it",
    ),
    (UNKNOWN.pattern, "is the file that defines '{}' included?"),
    (r"Undefined parameters \[([^\]]+)\]", "give {} where the macro is called"),
    (r"(evaluated to \"[^\"]*\", which is not a boolean)", "write true or false there"),
    (r"(unbound prefix)", 'declare it: <robot xmlns:xacro="http://www.ros.org/wiki/xacro">'),
    (r"(maximum recursion depth exceeded)", "files or macros include each other without end: open the circle"),
)


def refusal(told: dict[str, Any], along: Callable[[str], list[str]]) -> Unexpanded:
    """The refusal of a file that could not be expanded, at the line where the cause is named.

    Args:
        told: What the child process tells: its `error` and the file that xacro was in, its `place`; packages that are
            `absent`, arguments that are `needed`, `choices` of arguments with which it defines what it lacks, and the
            macros that it was `within`.
        along: The macros whose calls can be left out together with those of one; none where they cannot.
    """
    place, text = Path(told["place"]), re.sub(r"^<class '[^']*'>: ", "", " ".join(told["error"].split()))
    text = text[: len(text) // 2] if text[: len(text) // 2] == text[len(text) // 2 + 1 :] else text  # said twice
    word, fix = way_out(text, told)
    text += f", in macro {' in '.join(map(repr, dict.fromkeys(told['within'])))}" if told["within"] else ""
    called = giving(word, read_text(place)) if "Invalid parameter" in text else ""
    macro = lacking(told) or called
    if macro and (names := along(macro)):
        them = "it" if len(names) == 1 else "them"
        fix += "" if fix.endswith("?") else ","
        fix += f" or leave {them} out: " + " ".join(f"--without {name}" for name in names)
    return Unexpanded("xacro cannot expand it", why=text, fix=fix, file=place, line=line_of(place, word))


def way_out(text: str, told: dict[str, Any]) -> tuple[str, str]:
    """The word of an error that its line has, and what to do."""
    hits = ((re.search(pattern, text), way) for pattern, way in WAYS_OUT)
    word, fix = next(((hit[1], way.format(hit[1])) for hit, way in hits if hit), ("", "mend the file"))
    if told["choices"]:
        return word, "give an argument with which it is: " + " or ".join(f"--xacro {one}" for one in told["choices"])
    absent, needed = told["absent"], told["needed"]
    if absent and (fix == "mend the file" or "unknown macro" in text or "is not defined" in text):
        version = " in the version that has it" if any("/" in name for name in absent) else ""
        fix = f"is it in what is not found ({', '.join(absent)})? "
        return word, fix + f"Give the folder of the package{version} with --package-dir"
    if "Undefined substitution" in text and len(needed) > 1:
        fix = "give them: " + " ".join(f"--xacro {name}:=VALUE" for name in needed)
    return word, fix


def line_of(path: Path, word: str) -> int:
    """First line of a file that has a word, 1 where none has."""
    with contextlib.suppress(OSError):
        for number, line in enumerate(read_bytes(path).split(b"\n"), 1):
            if word and word.encode() in line:
                return number
    return 1


def macros_only(path: Path, data: bytes) -> Unexpanded:
    """The refusal of a file that expands to no links, with one beside it that calls its macros."""
    macros, near = MACRO.findall(read_text(path)), package_of(str(path.parent.absolute()))
    others = sorted(file for file in files_below(near, (".xacro",)) if file.resolve() != path.resolve())[:FILES]
    if not macros:
        defined = {name for file in others for name in MACRO.findall(read_text(file))}
        bare = [name for name in re.findall(r"<([\w.-]+)", data.decode(errors="replace")) if name in defined]
        why = f"it calls macros without their prefix: <{bare[0]}>" if bare else "it expands to none"
        fix = f"write <xacro:{bare[0]}>, as xacro needs since ROS Jade" if bare else "describe at least one <link>"
        return Unexpanded("it has no links", why=why, fix=fix, file=path, line=line_of(path, (bare or [""])[0]))
    called = re.compile(rf"<xacro:({'|'.join(map(re.escape, macros))})[\s/>]")
    callers = [file for file in others if called.search(read_text(file))]
    example = f", such as {callers[0]}" if callers else ""
    why, fix = f"it only defines macros: {', '.join(macros[:8])}", f"give a file that calls them{example}"
    return Unexpanded("it has no links", why=why, fix=fix, file=path, line=1)


def read_text(file: Path) -> str:
    """The text of a file, empty where it cannot be read or is long."""
    try:
        return read_bytes(file).decode(errors="replace")
    except (OSError, ValueError):
        return ""
